"""Coulomb's friction against partial slip in closed form, and what holds for any coefficient."""

import math
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from presses import (
    STUCK,
    HalfSpace,
    assert_coulomb,
    ball,
    centre_of,
    down,
    only,
    patch_areas,
    pressed,
    push,
    pushed,
    shear_of,
    sideways,
)
from standard_bodies import FINGER

import twin
from benchmarks import flat
from benchmarks.contact_theory import bonded_punch_stiffness, oblique_motion, sheared_motion, stick_radius, twisted
from twin.errors import ContactError, NotSettled
from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere, Step
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory.contact import hertz
from twin.world.contact import load_step
from twin.world.contact.contact_problem import FrictionalContact

BALL = Sphere(diameter_mm=30)
MU, PUSH = 0.5, 0.5
SLOW = pytest.mark.slow


class Yielding(HalfSpace):
    """A half-space on a support that gives way: a push moves all of it down and sideways alike."""

    def surface(self, rectangles):
        give = np.tile([1.0, 0.0, 1.0], len(rectangles))
        return super().surface(rectangles) + 0.5 * np.outer(give, give)


def rubbed(*steps, probe=BALL, friction=MU, increments=3, at_mm=(0, 0), **more):
    """Few increments: these loads grow without turning."""
    wanted = Press(probe=probe, at_mm=at_mm, friction=friction, steps=steps)
    return pressed(wanted, increments=increments, **more).path


def stuck_share(state):
    """Return the stuck radius averaged over direction, over the contact's."""
    area = patch_areas(state)
    return math.sqrt(area[~state.slip].sum() / area.sum())


def shear_motion(state, force, push_n=PUSH, nu=0.5):
    """Return Cattaneo's and Mindlin's motion under a side force, mm."""
    return sheared_motion(state.contact_radius_mm, force, push_n, MU, 1.0, nu)


@pytest.mark.parametrize("nu", [pytest.param(0.3, marks=SLOW), 0.5])
@pytest.mark.parametrize("share", [pytest.param(0.3, marks=SLOW), 0.6, 0.9])
def test_a_sheared_sphere_sticks_inside_and_slips_around(nu, share):
    """Cattaneo and Mindlin, who leave out the coupling of normal and tangential motion."""
    force = share * MU * PUSH
    surface = flat.HalfSpace(nu, coupled=False)
    steps = (pushed(), pushed(force))
    one, sheared = rubbed(*steps, on=surface, nu=nu, across=20, increments=2)
    assert not one.slip.any()
    assert sheared.move_mm[0] == pytest.approx(shear_motion(one, force, nu=nu), rel=0.01)
    assert stuck_share(sheared) == pytest.approx(stick_radius(1.0, force, PUSH, MU), rel=0.02)
    assert_coulomb(sheared, MU)
    # The traction across the force, left out in theory, over the traction along it.
    across, along = (np.abs(sheared.traction_mpa[:, axis]).max() for axis in (1, 0))
    assert across / along < (0.07 if nu == 0.3 else 0.13)


@pytest.mark.parametrize("share", [pytest.param(0.9, marks=SLOW), pytest.param(0.7, marks=SLOW), 0.4])
def test_a_twisted_sphere(share):
    a = hertz(radius_mm=15.0, youngs_modulus_mpa=1.0, poisson_ratio=0.5, force_n=PUSH).contact_radius_mm
    turn, torque = twisted(share * a, a, PUSH, MU, 1.0, 0.5)
    _, state = rubbed(pushed(), pushed(torque=torque), across=18, increments=2)
    assert math.radians(state.turn_deg) == pytest.approx(turn, rel=0.01)
    assert state.torque_nmm == pytest.approx(torque, rel=1e-8)
    assert stuck_share(state) == pytest.approx(share, abs=0.04)


@SLOW
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_a_dragged_sphere_slips_everywhere_and_follows(nu):
    one, slid, further, held = rubbed(push(PUSH), sideways(0.4), sideways(0.2), sideways(0.0), nu=nu)
    assert not held.slip.any()  # at its bound, but it does not move
    for state in (slid, further):
        assert state.slip.all()
        assert_allclose(shear_of(state), MU * state.pressure_mpa, rtol=1e-8)
        drag = np.hypot(*only(state).force_n[:, :2].T).sum()
        assert drag == pytest.approx(MU * state.force_n[2], rel=1e-8)
        assert state.force_n[0] == pytest.approx(MU * state.force_n[2], rel=1e-4)
    assert centre_of(further)[0] - centre_of(slid)[0] == pytest.approx(0.2, rel=0.02)
    # Once all of it slips, friction takes mu P for every millimetre.
    lost = further.dissipated_nmm - slid.dissipated_nmm
    assert lost == pytest.approx(0.2 * MU * PUSH, rel=0.05)
    assert one.dissipated_nmm <= 0.01 * slid.dissipated_nmm


@pytest.mark.parametrize("nu", [pytest.param(0.3, marks=SLOW), 0.5])
def test_much_friction_sticks(nu):
    steps = (pushed(), pushed(0.1), pushed(0.1, torque=0.05))
    stuck, much = (rubbed(*steps, friction=mu, nu=nu)[-1] for mu in (STUCK, 50.0))
    assert not much.slip.any()
    near = 1e-9 * stuck.peak_pressure_mpa
    assert_allclose(much.traction_mpa, stuck.traction_mpa, atol=near)
    assert_allclose(much.move_mm, stuck.move_mm, atol=1e-9)
    assert much.turn_deg == pytest.approx(stuck.turn_deg, rel=1e-9)


@pytest.mark.parametrize("probe", [BALL, Pillar(width_mm=4, length_mm=7)])
def test_little_friction_slides(probe):
    free, little = (rubbed(push(PUSH), probe=probe, friction=mu, nu=0.3)[-1] for mu in (0.0, 1e-6))
    near = 3e-6 * free.peak_pressure_mpa
    assert_allclose(little.traction_mpa, free.traction_mpa, atol=near)
    assert little.indentation_mm == pytest.approx(free.indentation_mm, rel=1e-6)


def test_the_mirror_image_of_a_path():
    def walked(sign):
        sheared = pushed(0.15 * sign, 0.05, torque=0.04 * sign)
        return rubbed(pushed(), sheared, pushed(-0.1 * sign, 0.1, 0.4, torque=0.0), nu=0.4)

    for one, image in zip(walked(1), walked(-1), strict=True):
        assert_allclose(image.move_mm, one.move_mm * [-1, 1, 1], atol=1e-9)
        assert image.slip.sum() == one.slip.sum()
        assert image.dissipated_nmm == pytest.approx(one.dissipated_nmm, abs=1e-10)


@SLOW
def test_the_order_of_pushing_and_shearing_counts():
    """Grown together below mu nothing slips, and the sphere goes further than sheared after."""
    force = 0.6 * MU * PUSH
    together = rubbed(pushed(force), across=16, increments=8)[-1]
    _, after = rubbed(pushed(), pushed(force), across=16)
    expected = oblique_motion(after.contact_radius_mm, force, 1.0, 0.5)
    assert not together.slip.any()
    assert together.move_mm[0] == pytest.approx(expected, rel=0.03)
    assert after.slip.any()
    assert together.dissipated_nmm < 0.01 * after.dissipated_nmm
    assert after.move_mm[0] == pytest.approx(shear_motion(after, force), rel=0.01)


def test_more_push_under_shear_holds_what_has_slipped():
    """Mindlin and Deresiewicz: a push that grows under a side force moves nothing sideways."""
    light, force = 0.2, 0.07
    steps = (pushed(z=light), pushed(force, z=light), pushed(force))
    _, sheared, held = rubbed(*steps, across=16)
    assert sheared.move_mm[0] == pytest.approx(shear_motion(sheared, force, light), rel=0.015)
    assert held.move_mm[0] == pytest.approx(sheared.move_mm[0], rel=0.005)
    assert not held.slip.any()
    assert held.dissipated_nmm == pytest.approx(sheared.dissipated_nmm)


def test_taking_the_side_force_back_leaves_a_share_of_the_motion():
    """Mindlin: unloading slips the other way, at twice the limit: d = d(Q) - 2 d((Q - 0) / 2)."""
    force = 0.8 * MU * PUSH
    _, sheared, back = rubbed(pushed(), pushed(force), pushed(), across=16)
    left = shear_motion(sheared, force) - 2 * shear_motion(sheared, force / 2)
    assert back.move_mm[0] == pytest.approx(left, rel=0.04)
    assert back.dissipated_nmm > sheared.dissipated_nmm > 0


@pytest.mark.parametrize(
    ("probe", "friction", "near"),
    [(Sphere(diameter_mm=5), MU, 5e-3), (Sphere(diameter_mm=5), STUCK, 5e-3), (Pillar(width_mm=4), MU, 1e-9)],
)
@pytest.mark.parametrize(
    ("lift", "again", "alone"),
    [
        (Step(move_mm=(0.3, 0.1, -1)), push(0.1), push(0.1)),
        (Step(move_mm=(0.3, 0.1, -1)), down(1), down(0.1)),
        (push(0.0, move_mm=(0.3, 0.1, None)), push(0.1), push(0.1)),
    ],
)
def test_a_probe_that_is_lifted_over_is_pressed_anew_where_it_comes_down(probe, friction, near, lift, again, alone):
    kinds = {"probe": probe, "friction": friction}
    over = rubbed(down(0.1), lift, again, **kinds)[-1]
    fresh = rubbed(alone, **kinds)[-1]
    assert over.indentation_mm == pytest.approx(fresh.indentation_mm, rel=near)
    assert over.force_n[2] == pytest.approx(fresh.force_n[2], rel=2 * near)
    assert_allclose(centre_of(over), [0.3, 0.1, 0.0], atol=near)
    assert_allclose(over.force_n[:2], 0.0, atol=1e-3 * over.force_n[2])


def test_many_small_steps_are_taken_in_few_parts_each(monkeypatch):
    """Each part is solved under a `Control` of its own; a step that changes nothing takes none."""
    steps, step, control = [], load_step.load_step, load_step.Control

    def counted_step(*arguments):
        steps.append(0)
        return step(*arguments)

    def counted_part(**arguments):
        steps[-1] += 1
        return control(**arguments)

    monkeypatch.setattr(load_step, "load_step", counted_step)
    monkeypatch.setattr(load_step, "Control", counted_part)
    side, torque = 0.6 * MU * PUSH, 0.1 * MU * PUSH

    def ramp(s):
        return pushed(z=PUSH * s), pushed(side * s), pushed(side, torque=torque * s)

    ramps = [ramp(s) for s in np.arange(1, 13) / 12]
    stages = (each[stage] for stage in range(3) for each in ramps)
    small = rubbed(*stages, across=12, increments=8)
    taken = np.array(steps[1:])  # the first one makes the contact
    assert np.mean(taken[taken > 0]) < 3
    assert (taken > 1).any()
    large = rubbed(*ramps[-1], across=12, increments=8)
    for one, other in zip(small[11::12], large, strict=True):
        near = 2e-3 * np.abs(other.move_mm).max()
        assert_allclose(one.move_mm, other.move_mm, atol=near)
        assert one.turn_deg == pytest.approx(other.turn_deg, rel=0.01, abs=1e-9)
    assert large[1].slip.any()


DRAG = push(PUSH, move_mm=(0.4, None, None))


@pytest.mark.parametrize("jump", [6e-3, 6e-2])
def test_a_slide_that_jumps_as_a_patch_comes_and_goes(jump, monkeypatch):
    """Over half a patch. The forces are those of a slide that doesn't, to what the model resolves."""
    (smooth,) = rubbed(DRAG, across=8, increments=1)
    there, slide = [False], FrictionalContact.slid

    def jumping(grid, *given):
        there[0] = not there[0]
        return slide(grid, *given) + there[0] * jump * float(grid.patches.half_mm.min())

    monkeypatch.setattr(FrictionalContact, "slid", jumping)
    (state,) = rubbed(DRAG, across=8, increments=1)
    assert_allclose(state.force_n, smooth.force_n, atol=1e-3 * PUSH)


def test_a_slide_without_an_end_is_refused(monkeypatch):
    calls, slide = [0], FrictionalContact.slid

    def ever_on(grid, *given):
        calls[0] += 1
        return slide(grid, *given) + 0.1 * calls[0] * float(grid.patches.half_mm.min())

    monkeypatch.setattr(FrictionalContact, "slid", ever_on)
    with pytest.raises(NotSettled, match="does not settle"):
        rubbed(DRAG, across=8, increments=1)


STEEP = Press(
    probe=Cone(apex_deg=114.2, diameter_mm=1.4),
    at_mm=(-1.81, -2.68),
    friction=0.163,
    steps=(Step(force_n=(None, None, 0.0686)),),
)
SPUN = Press(
    probe=Cone(apex_deg=138, diameter_mm=4.9),
    at_mm=(-0.4, 3.1),
    friction=0.28,
    steps=(
        Step(force_n=(None, None, 0.0914)),
        Step(force_n=(None, None, 0.0914), move_mm=(0.0045, 0.05, None)),
        Step(force_n=(None, None, 0.0914), turn_deg=6),
    ),
)


@pytest.mark.parametrize(("wanted", "across"), [(STEEP, 12), pytest.param(SPUN, 8, marks=SLOW)])
def test_a_slide_on_a_curved_surface_ends_where_friction_carries_the_forces_again(wanted, across):
    """One patch holds behind that place, none before it: two states with the same forces."""
    state, finer = (pressed(wanted, FINGER, across=across, increments=parts) for parts in (8, 40))
    assert state.complete
    assert finer.complete
    assert_coulomb(state, wanted.friction)
    assert_allclose(state.force_n, finer.force_n, atol=0.01 * finer.force_n[2])


def test_a_slide_that_jumps_where_it_ends_is_met_in_between(monkeypatch):
    """By 1.6 % of half a patch, down where the probe slid far and up where not: 0.8 % off both."""
    slide = FrictionalContact.slid
    last = [np.zeros((1, 2))]

    def jumping(grid, *given):
        moved = slide(grid, *given)
        jump = 1.6e-2 * float(grid.patches.half_mm.min())
        last[0] = moved + jump * (last[0] < moved + 0.5 * jump)
        return last[0]

    monkeypatch.setattr(FrictionalContact, "slid", jumping)
    (state,) = rubbed(DRAG, across=8, increments=1)
    assert state.slip.any()
    assert state.residual <= 1e-8


@pytest.mark.parametrize("probe", [Sphere(diameter_mm=3), Cylinder(diameter_mm=4)])
def test_a_press_on_the_finger(probe):
    steps = (Step(force_n=(0, 0, 0.3)), Step(force_n=(0.03, -0.05, 0.3)))
    wanted = Press(probe=probe, at_mm=(-3, 1), friction=MU, steps=steps)
    state = pressed(wanted, FINGER, nu=0.45)
    assert_allclose(state.force_n, [0.03, -0.05, 0.3], atol=1e-8 * 0.3)
    assert state.residual <= 1e-8
    assert_coulomb(state, MU)
    assert 0 < state.slip.sum() < len(state.slip)


@pytest.mark.parametrize("probe", [BALL, Pillar(width_mm=6, length_mm=4)])
def test_a_body_that_moves_sideways_as_a_whole_takes_the_probe_along(probe):
    """A probe that is free sideways feels nothing of it: the same tractions, at another place."""
    wanted = {"probe": probe, "friction": 0.05, "across": 10, "increments": 2}
    steps = (pushed(), pushed(0.01, 0.005))
    fixed, moved = (rubbed(*steps, on=on(), **wanted)[-1] for on in (HalfSpace, Yielding))
    assert len(fixed.slip) == len(moved.slip)
    near = 1e-6 * fixed.peak_pressure_mpa
    assert_allclose(moved.traction_mpa, fixed.traction_mpa, atol=near)
    give = 0.5 * (0.01 + PUSH)
    assert_allclose(moved.move_mm - fixed.move_mm, [give, 0, give], atol=1e-6)


FACE = Pillar(width_mm=4)
CARRY = "times what friction 0.5 can carry"


@pytest.mark.parametrize(
    ("words", "probe", "steps"),
    [
        ("with friction 0.5 less than 0.25 N", BALL, (pushed(), pushed(0.2, 0.2))),
        (CARRY, BALL, (pushed(), pushed(torque=0.3))),
        (CARRY, BALL, (pushed(), pushed(0.2, torque=0.15))),
        (CARRY, BALL, (down(0.1), Step(force_n=(0.5, None, None)))),
        ("is not level", FACE, (push(0.5), sideways(60))),
        ("8 times the contact's width", BALL, (push(0.5), Step(move_mm=(None, 40, None)))),
    ],
)
def test_refusals(words, probe, steps):
    with pytest.raises(ContactError, match=words):
        rubbed(*steps, probe=probe)


@pytest.mark.parametrize(
    ("probe", "at_mm", "friction", "force_n"),
    [
        (Pillar(width_mm=1.26, length_mm=1.22), (-4.54, 0.87), 0.125, (0.0183, 0.011, 0.498)),
        (Cylinder(diameter_mm=1.39), (0.03, -0.23), 0.053, (0.006, -0.0014, 0.246)),
        (Cylinder(diameter_mm=2.76), (1.56, 0.84), 0.0521, (-0.0008, -0.0004, 0.05)),
    ],
)
def test_a_flat_face_that_slides_off_a_slope_is_told_so_and_how_it_holds(probe, at_mm, friction, force_n):
    """What friction has to carry, of the force less that of a press without it, grows on the way down."""

    def finger(steps, **other):
        given = {"probe": probe, "at_mm": at_mm, "friction": friction, "steps": steps}
        return pressed(Press(**given | other), FINGER, e=0.5, across=10)

    def shoved(force, **other):
        return finger((push(force[2]), Step(force_n=tuple(force))), **other)

    with pytest.raises(ContactError, match=r"flat face of the .* slides off, .* falls away by") as refused:
        shoved(force_n)
    shares, place, force = [], np.array(at_mm), np.array(force_n)
    for _ in range(6):
        bare = finger((push(force[2]),), at_mm=tuple(place), friction=0.0)
        lacking = force[:2] - bare.force_n[:2]
        shares.append(float(np.hypot(*lacking)) / (friction * force[2]))
        place = place + 0.1 * lacking / np.hypot(*lacking)
        if len(shares) == 1:
            slope = bare.force_n
    assert shares[0] > 1.0
    assert (np.diff(shares) > 0.0).all()
    text = str(refused.value)
    said = [float(value) for value in re.findall(r"[-+.\de]+", re.search(r"slope's own \((.*?)\) N", text)[1])]
    assert_allclose(said, slope[:2], atol=0.05 * friction * force[2])
    enough = float(re.search(r"press.friction over ([.\d]+)", text)[1])
    assert friction < enough < 1.5 * friction
    for held in (shoved(force, friction=1.05 * enough), shoved((*(force[:2] + 2.0 * np.array(said)) / 3.0, force[2]))):
        assert held.complete
        assert not held.slip.all()


@pytest.mark.parametrize(
    ("probe", "move", "near"),
    [
        (Sphere(diameter_mm=3.5), 0.05, 5e-3),
        (Sphere(diameter_mm=3.5), 0.5, 2e-2),
        (Cylinder(diameter_mm=8), 0.05, 2e-2),
    ],
)
def test_hardly_any_friction_on_a_slope_is_like_none(probe, move, near):
    """All patches slip down the finger's flank; some can't be met along their normals at the height of first touch."""
    steps = (push(0.1), push(0.1, move_mm=(0, move, None)))
    free, little = (
        pressed(Press(probe=probe, at_mm=(0.4, 2.6), friction=mu, steps=steps), FINGER, across=10, increments=3)
        for mu in (0.0, 1e-6)
    )
    assert little.indentation_mm == pytest.approx(free.indentation_mm, rel=near)
    assert_allclose(little.force_n, free.force_n, atol=near * free.force_n[2])


@pytest.mark.parametrize("friction", [0.3, STUCK])
def test_a_sphere_that_comes_along_the_normal_stays_where_it_touched(friction):
    """Whatever its own axes are: rubber that sticks is carried along, so that its contact does not wander."""
    slanted = (math.sin(0.35), 0.0, math.cos(0.35))
    upright, askew, touching = (
        pressed(Press(probe=BALL, friction=friction, direction=along, steps=(down(depth),)), across=12)
        for along, depth in ((None, 0.2), (slanted, 0.2), (slanted, 1e-4))
    )
    assert_allclose(askew.force_n, upright.force_n, atol=5e-3 * upright.force_n[2])
    assert_allclose(centre_of(askew), centre_of(touching), atol=5e-3)


@pytest.mark.parametrize(("force", "degrees"), [(0.3, 8.0), (5e-3, 30.0)])
def test_a_sphere_rolls_over_incompressible_rubber_without_a_side_force(force, degrees):
    """Turned about its lowest point, it rolls to where its middle goes: 0.6, and three contact widths, on."""
    start, end = rubbed(push(force), push(force, turn_deg=(0.0, degrees, 0.0)), probe=Sphere(diameter_mm=6))
    way = 3.0 * math.sin(math.radians(degrees))
    assert_allclose(end.force_n, [0.0, 0.0, force], atol=2e-3 * force)
    assert_allclose(centre_of(end) - centre_of(start), [-way, 0.0, 0.0], atol=2.5e-2 * way)
    assert end.indentation_mm == pytest.approx(start.indentation_mm, rel=4e-2)
    assert end.contact_radius_mm == pytest.approx(start.contact_radius_mm, rel=4e-2)


@pytest.mark.parametrize(("probe", "near"), [(BALL, 8e-3), (FACE, 1e-9)])
def test_a_long_slide_ends_like_a_short_one_further_on(probe, near):
    """Once all slips, what presses is the same wherever it slid to, by friction times the push."""
    short, far = (rubbed(down(0.1), sideways(x), probe=probe, across=8, increments=8)[-1] for x in (1.0, 7.0))
    assert far.slip.all()
    assert_allclose(far.force_n, short.force_n, atol=near * short.force_n[2])
    assert_allclose(far.force_n[0], MU * far.force_n[2], rtol=2e-3)
    assert_allclose(centre_of(far) - centre_of(short), [6.0, 0.0, 0.0], atol=0.03)
    assert far.peak_pressure_mpa == pytest.approx(short.peak_pressure_mpa, rel=10 * near)


def test_a_face_that_slides_is_pressed_by_the_rubber_that_it_is_on():
    """On a block with free sides, towards one of which the rubber is softer."""
    coarse = {"accuracy.contact_patches": 10, "accuracy.displacement": 0.1}
    sensor = Sensor(load_scene("block_bare", overrides=coarse))
    slide = Press(probe=FACE, friction=MU, steps=(down(0.1), sideways(36)))
    slid = sensor.press(slide)
    there, middle = (
        sensor.press(Press(probe=FACE, at_mm=at, friction=MU, steps=(down(0.1), sideways(0.2))))
        for at in (tuple(centre_of(slid)[:2]), (0, 0))
    )
    assert_allclose(slid.force_n, there.force_n, atol=1e-3 * slid.force_n[2])
    assert slid.force_n[2] < 0.99 * middle.force_n[2]


def test_a_slide_there_and_back_takes_friction_times_the_way():
    there, back = rubbed(down(0.1), sideways(6), sideways(-6), probe=FACE, across=10, increments=8)[1:]
    carried = 6.0 - centre_of(there)[0]  # the rubber goes along so far before all slips, and back twice
    way = 2 * 6.0 - 3 * carried
    assert back.dissipated_nmm == pytest.approx(MU * back.force_n[2] * way, rel=2e-3)
    assert_allclose(back.force_n, there.force_n * [-1, 1, 1], atol=1e-9)


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_a_ball_that_slides_back_goes_on_from_where_it_turned_and_is_lifted(friction):
    """It ended at step 14 and at step 18, as how far it slid jumped when all of it slipped back."""
    steps = [step for step in (down(0.06), sideways(0.08), sideways(-0.08), down(-0.06)) for _ in range(5)]
    wanted = Press(probe=Sphere(diameter_mm=6), friction=friction, steps=steps)
    state = twin.Sensor(twin.load_scene("block_bare")).press(wanted)
    assert state.complete
    there, back = state.path[9], state.path[14]
    assert_allclose(np.abs([there.force_n[0], back.force_n[0]]), friction * back.force_n[2], rtol=0.3)
    assert there.force_n[0] * back.force_n[0] < 0.0
    assert_allclose(state.force_n, 0.0, atol=1e-9)


def carried_share(torque, x=0.0):
    """Return the limit load's share that a refusal states, of a torque over what a sphere's friction carries, 3 pi / 16
    mu P a, and a side force over mu P."""
    radius = pressed(ball(30, force_n=(0, 0, PUSH))).contact_radius_mm
    most = 3.0 * math.pi / 16.0 * MU * PUSH * radius
    with pytest.raises(ContactError, match=CARRY) as refused:
        rubbed(pushed(), pushed(x * MU * PUSH, torque=torque * most))
    return float(re.search(r"are (\S+) times", str(refused.value))[1])


@pytest.mark.parametrize(("torque", "x", "near"), [(1.3, 0.0, 1.3), (-1.3, 0.0, 1.3), (0.95, 0.7, 1.2)])
def test_a_refusal_states_what_friction_can_carry(torque, x, near):
    assert carried_share(torque, x) == pytest.approx(near, rel=0.03 if x == 0.0 else 0.1)


def test_a_force_at_the_edge_of_the_cone_is_refused_in_its_terms(monkeypatch):
    """The share is an estimate: where every patch slips, one just under 1 names the cause too."""
    law = load_step.LAW

    class Larger:
        def bound(self, *given):
            return 1.3 / 0.975 * law.bound(*given)

    monkeypatch.setattr(load_step, "LAW", Larger())
    assert 0.95 < carried_share(1.3) < 1.0


def test_a_tip_that_is_lifted_and_pressed_again_grips_as_before():
    steps = (push(0.1), push(0.0), push(0.1))
    cone = Cone(apex_deg=140, diameter_mm=6)
    wanted = Press(probe=cone, at_mm=(0, 0), friction=0.4, steps=steps)
    first, _, again = pressed(wanted, FINGER, e=0.5, across=9, increments=4).path
    near = 1e-8 * first.peak_pressure_mpa
    assert_allclose(first.traction_mpa, again.traction_mpa, atol=near)


@pytest.mark.parametrize("friction", [0.5, STUCK])
def test_the_work_of_a_path_is_stored_or_lost(friction):
    moves = ((0.0, 0.0, 0.1), (0.03, 0.0, 0.0), (0.0, 0.0, -0.07))
    parts = [tuple(part / 16 for part in move) for move in moves for _ in range(16)]
    steps = tuple(Step(move_mm=part) for part in parts)
    path = pressed(ball(10, friction=friction, steps=steps), nu=0.45).path
    force = np.array([np.zeros(3), *(state.force_n for state in path)])
    place = np.array([np.zeros(3), *(state.move_mm for state in path)])
    work = np.sum((force[1:] + force[:-1]) / 2.0 * np.diff(place, axis=0))
    assert path[-1].elastic_nmm + path[-1].dissipated_nmm == pytest.approx(work, rel=0.01)
    assert path[-1].dissipated_nmm > 0.3 * work


def test_the_radius_of_a_stuck_sphere_is_that_of_its_stiffness():
    steps = tuple(Step(move_mm=(0.0, 0.0, 0.01)) for _ in range(10))
    state = pressed(ball(10, friction=STUCK, steps=steps), nu=0.3)
    # its force goes with the indentation to the power 3/2
    stiffness = 1.5 * state.force_n[2] / state.indentation_mm
    radius = stiffness / bonded_punch_stiffness(1.0, 1.0, 0.3)
    assert state.contact_radius_mm == pytest.approx(radius, rel=6e-3)
