"""Presses on rubber that relaxes, against closed forms in time."""

from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from presses import STUCK, ball, down, pressed, punch, push
from standard_bodies import FINGER

from twin.errors import InputError
from twin.parts.press import Press, Sphere, Step
from twin.theory.contact import hertz
from twin.theory.relaxation import Relaxation
from twin.world.contact import load_step, pressing
from twin.world.contact.pressing import PathMemory

RUBBER = Relaxation(np.array([0.2, 0.1]), np.array([0.3, 2.0]))
DEPTH, RAMP = 0.1, 0.5
FULL = hertz(radius_mm=20, youngs_modulus_mpa=1, poisson_ratio=0.5, indentation_mm=DEPTH).force_n
ACROSS = 10


def moved(z, seconds):
    return Step(move_mm={"z": z}, seconds=seconds)


def times_of(press):
    return list(accumulate(step.seconds for step in press.path))


def elastic_force(state):
    return state.load.crept.terms[0].total_force_n


def test_a_sphere_that_comes_and_stays_follows_lee_and_radok():
    """P(t) = int G(t - s) d(elastic force at the depth of s): E. H. Lee, J. R. M. Radok, 1960."""
    press = ball(40, steps=(moved(DEPTH, RAMP), Step(seconds=0.25), Step(seconds=1.0)))
    state = pressed(press, across=ACROSS, relaxation=RUBBER)
    fast = pressed(ball(40, indentation_mm=DEPTH), across=ACROSS)
    edges = np.linspace(0.0, RAMP, 4001)
    middles = (edges[1:] + edges[:-1]) / 2
    growth = np.diff((edges / RAMP) ** 1.5)
    for one, now in zip(state.path, times_of(press), strict=True):
        share = RUBBER.modulus(now - middles) @ growth
        assert one.force_n[2] / fast.force_n[2] == pytest.approx(share, rel=1e-3)
        assert one.contact_radius_mm == pytest.approx(fast.contact_radius_mm, rel=0.04)
    assert state.force_n[2] < 0.9 * state.path[0].force_n[2]


def test_a_sphere_that_leaves_follows_ting():
    """While the contact shrinks, the force is that of the loading up to the time t1 at which the
    contact was as large, int_t1^t G(t - s) d(depth) = 0: T. C. T. Ting, J. Appl. Mech. 33 (1966)
    845."""
    count = 4
    away = [moved(-DEPTH / count, RAMP / count) for _ in range(count)]
    press = ball(40, steps=(moved(DEPTH, RAMP), *away))
    state = pressed(press, across=ACROSS, relaxation=RUBBER)
    edges = np.linspace(0.0, 2 * RAMP, 8001)
    middles = (edges[1:] + edges[:-1]) / 2
    depth = DEPTH * np.minimum(edges, 2 * RAMP - edges) / RAMP
    sunk = np.diff(depth)
    growth = np.diff(FULL * (np.maximum(depth, 0.0) / DEPTH) ** 1.5)
    for one, now in zip(state.path[1:], times_of(press)[1:], strict=True):
        past = np.flatnonzero(middles < now)
        back = np.cumsum((RUBBER.modulus(now - middles[past]) * sunk[past])[::-1])
        regained = np.flatnonzero(back >= 0.0)
        first = past[::-1][regained[0]] if len(regained) else 0
        wanted = RUBBER.modulus(now - middles[:first]) @ growth[:first]
        assert one.force_n[2] == pytest.approx(wanted, abs=2e-3 * FULL)
    assert state.force_n[2] == 0.0
    assert elastic_force(state)[2] > 0.005 * FULL  # a dent is left


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_under_a_force_the_contact_creeps(friction):
    """The elastic force of a growing contact is the force's convolution with the creep function."""
    steps = (push(0.2, seconds=RAMP), push(0.2, seconds=0.5), push(0.2, seconds=2.0))
    press = ball(40, steps=steps, friction=friction)
    state = pressed(press, across=ACROSS, relaxation=RUBBER)
    for one, now in zip(state.path, times_of(press), strict=True):
        crept = 0.2 * RUBBER.ramp_creep(now - RAMP, RAMP)
        assert one.force_n[2] == pytest.approx(0.2, rel=1e-8)
        assert elastic_force(one)[2] == pytest.approx(crept, rel=1e-3)
        like = hertz(radius_mm=20, youngs_modulus_mpa=1, poisson_ratio=0.5, force_n=crept)
        assert one.indentation_mm == pytest.approx(like.indentation_mm, rel=2e-3)


def test_a_force_that_is_held_by_motion_relaxes_exactly():
    steps = (Step(force_n={"z": 1.0}), Step(move_mm={"x": 0.05}), Step(seconds=0.7))
    press = punch(4, steps=steps, friction=STUCK)
    _, sheared, later = pressed(press, across=8, relaxation=RUBBER).path
    assert sheared.force_n[0] > 0.1
    relaxed = RUBBER.modulus(0.7)
    assert later.force_n == pytest.approx(relaxed * sheared.force_n, abs=1e-9)
    assert later.traction_mpa == pytest.approx(relaxed * sheared.traction_mpa, abs=1e-9)
    assert later.load.crept.terms[0].total_force_n == pytest.approx(sheared.force_n, abs=1e-9)


def test_what_slips_is_held_by_the_force_that_is_left():
    """Friction falls with the pressure, so that nothing slips in a hold; and the relaxed force
    bounds what is sheared afterwards."""
    steps = (moved(DEPTH, 0.0), Step(move_mm={"x": 0.01}), Step(seconds=50.0), Step(move_mm={"x": 0.05}))
    press = ball(40, steps=steps, friction=0.3)
    _, sheared, held, slid = pressed(press, across=6, relaxation=RUBBER).path
    assert held.force_n == pytest.approx(0.7 * sheared.force_n, rel=1e-3)
    assert slid.slip.all()
    assert slid.force_n[0] == pytest.approx(0.3 * slid.force_n[2], rel=1e-4)
    assert slid.force_n[2] == pytest.approx(held.force_n[2], rel=0.02)


def test_a_swinging_face_loses_what_the_loss_modulus_tells():
    frequency, count, swing = 4.0, 24, 0.01
    place = 0.05 + swing * np.sin(2.0 * np.pi * np.arange(3 * count + 1) / count)
    each = 2.0 * np.pi / frequency / count
    steps = tuple(moved(step, each) for step in np.diff(place))
    press = punch(4, steps=(moved(place[0], 0.0), Step(seconds=50.0), *steps))
    path = pressed(press, across=6, relaxation=RUBBER).path
    force = np.array([one.force_n[2] for one in path])[-count - 1 :]
    lost = np.sum((force[1:] + force[:-1]) / 2 * np.diff(place[-count - 1 :]))
    stiffness = path[0].force_n[2] / place[0]
    loss = -(RUBBER.share / (1.0 + 1j * frequency * RUBBER.time_s)).sum().imag
    wanted = np.pi * stiffness * swing**2 * loss
    assert lost == pytest.approx(wanted, rel=0.03)


def test_a_slide_does_not_depend_on_its_steps():
    """Relaxing rubber creeps under a probe that slides; a steady motion in few or in many steps has
    the same end, where friction is mu times the force that is left."""

    soft = Relaxation(np.array([0.25, 0.15]), np.array([0.3, 4.0]))

    def slid(count):
        way = [Step(move_mm={"x": 0.3 / count}, seconds=1.5 / count) for _ in range(count)]
        press = ball(6, steps=(moved(0.2, 1.5), *way), friction=0.6)
        return pressed(press, across=8, relaxation=soft)

    few, many = slid(3), slid(15)
    assert few.complete
    assert many.complete
    assert many.slip.all()
    assert many.force_n[0] == pytest.approx(0.6 * many.force_n[2], rel=1e-3)
    assert few.force_n == pytest.approx(many.force_n, abs=3e-4 * many.force_n[2])


def test_relaxation_alone_asks_for_parts_without_friction(monkeypatch):
    solutions = []
    solve = load_step.solve
    monkeypatch.setattr(load_step, "solve", lambda *of: solutions.append(of) or solve(*of))

    def needed(*steps):
        solutions.clear()
        return pressed(ball(40, steps=steps), across=ACROSS, relaxation=RUBBER).force_n[2], len(solutions)

    (along, once), (same, ten) = needed(moved(DEPTH, RAMP)), needed(*[moved(DEPTH / 10, RAMP / 10)] * 10)
    assert ten < 4 * once  # 25, as the whole step is solved first; 61 with parts for new patches
    assert same == pytest.approx(along, rel=5e-4)
    assert needed(*[moved(DEPTH / 10, 1e-4 * RAMP)] * 10)[1] <= once + 10


def test_one_grid_is_sought_for_the_hardest_of_the_pushes_that_follow_each_other(monkeypatch):
    sought = []
    seek = pressing.closed_form_contact
    monkeypatch.setattr(pressing, "closed_form_contact", lambda *of: sought.append(of) or seek(*of))

    def grids(*steps, memory=None):
        sought.clear()
        state = pressed(ball(40, steps=steps), across=8, relaxation=RUBBER, memory=memory)
        return len(sought), state

    rising = [push(0.05 * (1 + number), seconds=0.2) for number in range(4)]
    count, at_once = grids(*rising)
    assert count == 1
    assert grids(*rising, push(0.1, seconds=0.1), push(0.15, seconds=0.1))[0] == 1
    # a motion counts from where the force before it has led
    assert grids(*rising, push(0.1, seconds=0.1), moved(0.01, 0.1))[0] == 3
    assert grids(moved(0.05, 0.1), moved(0.05, 0.1), moved(-0.02, 0.1))[0] == 1
    memory = PathMemory()
    for number in range(len(rising)):
        _, step_by_step = grids(*rising[: number + 1], memory=memory)
    assert np.array_equal(step_by_step.traction_mpa, at_once.traction_mpa)


def test_a_dent_recovers_and_is_felt_by_the_next_touch():
    steps = (push(0.2, seconds=3.0), push(0.0), Step(seconds=0.5), push(0.2))
    press = ball(40, steps=steps, friction=0.5)
    held, lifted, later, again = pressed(press, across=8, relaxation=RUBBER).path
    assert lifted.force_n[2] == later.force_n[2] == 0.0
    # After the force has gone, the creep function less what has recovered.
    left = 0.2 * (RUBBER.ramp_creep(0.0, 3.0) - 1.0)
    assert elastic_force(lifted)[2] == pytest.approx(left, rel=0.01)
    gone = 0.2 * (RUBBER.ramp_creep(0.5, 3.0) - float(RUBBER.creep(0.5)))
    assert elastic_force(later)[2] == pytest.approx(gone, rel=0.02)
    fresh = pressed(ball(40, steps=(push(0.2),), friction=0.5), across=8)
    assert fresh.indentation_mm < again.indentation_mm < held.indentation_mm


def test_without_time_nothing_relaxes():
    press = punch(4, steps=(push(0.3), push(0.3, move_mm={"x": 0.05})), friction=0.5)
    relaxing = pressed(press, across=6, relaxation=RUBBER)
    elastic = pressed(press, across=6)
    assert np.array_equal(relaxing.traction_mpa, elastic.traction_mpa)
    assert relaxing.load.crept is None


def test_a_probe_without_friction_meets_its_exact_shape_on_a_curved_body():
    """In time one grid serves a path; rubber that hardly relaxes must have the forces of grids of
    each step's own."""
    press = Press(probe=Sphere(diameter_mm=3), at_mm=(1, 4), steps=(moved(0.2, 1.0), moved(0.2, 1.0)))
    stiff = replace(RUBBER, share=np.array([1e-9, 1e-9]))
    elastic, relaxing = (pressed(press, FINGER, across=8, relaxation=each) for each in (None, stiff))
    assert relaxing.force_n == pytest.approx(elastic.force_n, rel=1e-6)


def test_the_stated_error_holds_the_true_one():
    press = ball(40, steps=(push(0.2, seconds=RAMP), push(0.2, seconds=2.0)))
    state = pressed(press, across=12, relaxation=RUBBER, increments=4)
    crept = 0.2 * RUBBER.ramp_creep(2.0, RAMP)
    like = hertz(radius_mm=20, youngs_modulus_mpa=1, poisson_ratio=0.5, force_n=crept)
    assert abs(state.indentation_mm / like.indentation_mm - 1.0) < state.error.indentation < 0.02


def test_what_cant_be_taken_in_time_is_refused():
    press = ball(40, steps=(down(DEPTH), Step(move_mm={"x": 0.1}, seconds=1.0)))
    with pytest.raises(InputError, match=r"give press\.friction a value"):
        pressed(press, across=8, relaxation=RUBBER)
