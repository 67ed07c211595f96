"""Presses on a half-space against the closed forms, and what must hold on any body."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from presses import STUCK, HalfSpace, ball, centre_of, down, face, only, pressed, punch, push, radii_of, sideways
from standard_bodies import BLOCK, FINGER

from benchmarks.contact_theory import (
    bonded_punch_stiffness,
    oblique_motion,
    square_punch_stiffness,
    tangential_stiffness,
    torsional_stiffness,
)
from twin.errors import ContactError, InputError
from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere, Step
from twin.theory import halfspace
from twin.theory.contact import hertz
from twin.world.contact import contact_search, pressing
from twin.world.contact.active_set import Equilibrium
from twin.world.contact.contact_problem import ProbeSetup
from twin.world.contact.contact_state import ContactState
from twin.world.contact.probe_gap import Approach
from twin.world.contact.surface_patches import Box, Footprint, Patches, Plane


@pytest.mark.parametrize("nu", [0.3, 0.5])
@pytest.mark.parametrize("held", ["force", "motion"])
def test_hertz(nu, held):
    # Light, so that the parabola in Hertz's theory and the exact sphere here agree: a/R = 0.07.
    theory = hertz(radius_mm=20, youngs_modulus_mpa=0.8, poisson_ratio=nu, indentation_mm=0.1)
    path = {"force_n": (0, 0, theory.force_n)} if held == "force" else {"indentation_mm": 0.1}
    state = pressed(ball(40, **path), e=0.8, nu=nu, across=20)
    assert state.contact_radius_mm == pytest.approx(theory.contact_radius_mm, rel=0.006)
    assert state.peak_pressure_mpa == pytest.approx(theory.peak_pressure_mpa, rel=0.01)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.004)
    assert state.force_n[2] == pytest.approx(theory.force_n, rel=0.004)
    distance = radii_of(state)
    inner = distance < 0.85 * theory.contact_radius_mm
    near = 0.015 * theory.peak_pressure_mpa
    assert_allclose(state.pressure_mpa[inner], theory.pressure(distance[inner]), atol=near)
    work = state.force_n[2] * state.indentation_mm
    assert state.elastic_nmm == pytest.approx(0.4 * work, rel=1e-3)


@pytest.mark.parametrize(("diameter", "force"), [(1000.0, 1e-4), (300.0, 1e-5)])
def test_a_light_touch_of_a_large_sphere(diameter, force):
    """Round-off of the sphere's size is not small beside the indentation here."""
    theory = hertz(radius_mm=diameter / 2, youngs_modulus_mpa=1, poisson_ratio=0.5, force_n=force)
    state = pressed(ball(diameter, force_n=(0, 0, force)), across=10)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.01)


@pytest.mark.parametrize("side", [3.0, 40.0])
def test_square_pillar(side):
    state = pressed(face(side, indentation_mm=0.01 * side), e=0.3)
    stiffness = square_punch_stiffness(side, 0.3, 0.5)
    assert state.force_n[2] / (0.01 * side) == pytest.approx(stiffness, rel=0.005)
    assert state.area_mm2 == pytest.approx(side**2, rel=1e-12)


def test_stuck_punch_tangential_and_torsional_stiffness():
    moves = (sideways(0.05), Step(move_mm=(None, 0.1, None)), Step(turn_deg=-2.0))
    path = pressed(punch(5, friction=STUCK, steps=(down(0.1), *moves))).path
    first, _, both, turned = path
    assert np.abs(first.force_n[:2]).max() < 1e-10
    stiffness = tangential_stiffness(2.5, 1.0, 0.5)
    assert_allclose(both.force_n[:2], [0.05 * stiffness, 0.1 * stiffness], rtol=0.007)
    assert both.force_n[2] == pytest.approx(first.force_n[2], rel=1e-9)
    torque = -math.radians(2.0) * torsional_stiffness(2.5, 1.0, 0.5)
    assert turned.torque_nmm == pytest.approx(torque, rel=0.01)


@pytest.mark.parametrize("nu", [0.0, 0.3])
def test_stuck_punch_on_compressible_rubber(nu):
    state = pressed(punch(5, friction=STUCK, indentation_mm=0.1), nu=nu)
    assert state.force_n[2] == pytest.approx(0.1 * bonded_punch_stiffness(2.5, 1, nu), rel=0.012)


def test_stuck_sphere_pressed_then_sheared_then_twisted():
    force = (0.1, 0, 0.5)
    steps = (Step(force_n=(0, 0, 0.5)), Step(force_n=force), Step(force_n=force, torque_nmm=0.05))
    one, sheared, turned = pressed(ball(30, friction=STUCK, steps=steps), across=20).path
    a = one.contact_radius_mm
    assert one.move_mm[0] == pytest.approx(0.0, abs=1e-12)
    assert sheared.move_mm[0] == pytest.approx(0.1 / tangential_stiffness(a, 1, 0.5), rel=0.01)
    turn = 0.05 / torsional_stiffness(a, 1.0, 0.5)
    assert math.radians(turned.turn_deg) == pytest.approx(turn, rel=0.04)
    assert turned.torque_nmm == pytest.approx(0.05, rel=1e-8)
    assert_allclose(turned.force_n, force, atol=5e-9)


def test_new_patches_stick_from_where_they_touch():
    """A force that grows obliquely: 3/2 of the motion that it gives at the final contact."""
    state = pressed(ball(30, friction=STUCK, force_n=(0.05, 0, 0.5)), across=20)
    theory = oblique_motion(state.contact_radius_mm, 0.05, 1.0, 0.5)
    assert state.move_mm[0] == pytest.approx(theory, rel=0.03)


def test_a_stuck_sphere_is_stiffer_and_its_increments_have_converged():
    probe = ball(10, friction=STUCK, indentation_mm=0.1)
    few, many = (pressed(probe, nu=0.3, across=10, increments=n).force_n[2] for n in (8, 24))
    free = pressed(ball(10, indentation_mm=0.1), nu=0.3, across=10).force_n[2]
    assert few == pytest.approx(many, rel=2e-3)
    assert 1.01 < many / free < 1.03


def test_crossed_curvatures_of_probe_and_finger():
    """Mild ellipses: Hertz with the mean R = 1 / sqrt(1/Rx 1/Ry), both bodies' curvatures added."""
    state = pressed(ball(3, at_mm=(-4, 0), force_n=(0, 0, 0.002)), FINGER)
    mean = 1 / math.sqrt((1 / 1.5) * (1 / 1.5 + 1 / 8))
    theory = hertz(radius_mm=mean, youngs_modulus_mpa=1, poisson_ratio=0.5, force_n=0.002)
    assert state.contact_radius_mm == pytest.approx(theory.contact_radius_mm, rel=0.01)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.01)
    centre = only(state).centre_mm
    assert np.ptp(centre[:, 0]) > np.ptp(centre[:, 1])


SHEARED = (push(0.3), Step(force_n=(0.05, -0.03, 0.3)))
PRESSES = {
    "sphere": (BLOCK, ball(3, force_n=(0, 0, 0.980665))),
    "pillar": (BLOCK, face(5, at_mm=(10, -5), force_n=(0, 0, 2))),
    "finger sphere": (FINGER, ball(3, at_mm=(-4, 4), steps=(push(0.3),))),
    "finger tip": (FINGER, ball(3, at_mm=(4, 2), steps=(down(0.3),))),
    "finger tip stuck": (FINGER, ball(3, at_mm=(3, 1), friction=STUCK, steps=SHEARED)),
    "finger cylinder": (FINGER, punch(10, at_mm=(-2, 0), steps=(push(1.0),))),
    # A long contact that leans: it reached over one corner of grids that only moved after it.
    "finger cone": (
        FINGER,
        Press(probe=Cone(apex_deg=133, diameter_mm=6.56), at_mm=(3.068, 1.945), force_n=(None, None, 0.5064)),
    ),
}


@pytest.mark.parametrize("name", PRESSES)
def test_equilibrium_and_complementarity(name):
    body, probe = PRESSES[name]
    state = pressed(probe, body, across=9)
    patches = only(state)
    assert_allclose(patches.force_n.sum(axis=0), state.force_n, atol=1e-12)
    for given, got in zip(probe.path[-1].force_n, state.force_n, strict=True):
        if given is not None:
            assert got == pytest.approx(given, abs=1e-8 * state.force_n[2])
    arm = patches.centre_mm - [*probe.at_mm, 0.0]
    torque = np.cross(arm, patches.force_n)[:, 2].sum()
    assert state.torque_nmm == pytest.approx(torque, abs=1e-10)
    assert state.residual <= 1e-8
    assert state.pressure_mpa.min() > 0
    assert np.abs(body.depth(patches.centre_mm)).max() < 1e-9
    normal = body.piece_normals(patches.centre_mm)[:, 0]
    assert_allclose(patches.frames[:, 2], normal, atol=1e-12)
    squares = patches.frames @ patches.frames.transpose(0, 2, 1)
    assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=1e-12)
    assert_allclose(np.linalg.det(patches.frames), 1.0)
    if probe.friction == 0:
        lateral = state.traction_mpa - state.pressure_mpa[:, None] * normal
        assert np.abs(lateral).max() < 1e-12
        assert state.slip.all()
    else:
        assert not state.slip.any()
    assert not state.load.terms[0].force_n.flags.writeable


def test_the_surface_takes_the_shape_of_the_sphere():
    """Independent of the solver: displaced patch centres lie on the moved sphere."""
    state = pressed(ball(3, indentation_mm=0.3))
    patches, r = only(state), radii_of(state)
    u = halfspace.displacement(patches.centre_mm, patches, 1.0, 0.5)
    height = patches.centre_mm[:, 2] + u[:, 2]
    assert_allclose(height, 0.3 - (1.5 - np.sqrt(1.5**2 - r**2)), atol=1e-9)
    ring = np.linspace(0, 2 * math.pi, 12, endpoint=False)
    for radius in (1.15 * state.contact_radius_mm, 1.4):
        around = np.column_stack([radius * np.cos(ring), radius * np.sin(ring), np.zeros(12)])
        lifted = halfspace.displacement(around, patches, 1.0, 0.5)[:, 2]
        assert np.all(lifted > 0.3 - (1.5 - math.sqrt(1.5**2 - radius**2)))


def test_a_press_beyond_linear_theory_says_so():
    state = pressed(ball(3, force_n=(0, 0, 0.980665)))
    assert any("understates" in note for note in state.validity.notes)
    assert not state.validity.linear
    assert pressed(ball(30, force_n=(0, 0, 0.1))).validity.linear


def test_a_frictionless_slide_carries_no_shear_and_takes_the_contact_along():
    steps = (push(0.5), Step(move_mm=(3.0, -2.0, None)), Step(turn_deg=30))
    one, *after = pressed(ball(5, steps=steps)).path
    for state in after:
        # z is held, and every place has its own grid: the force keeps to the grid's error.
        assert_allclose(state.force_n, one.force_n, atol=5e-4 * one.force_n[2])
        assert np.abs(only(state).force_n[:, :2]).max() == 0.0
        assert_allclose(centre_of(state), [3.0, -2.0, 0.0], atol=1e-6)


def test_a_turned_pillar_presses_its_turned_footprint():
    probe = Pillar(width_mm=4, length_mm=12)
    steps = (down(0.05), Step(turn_deg=90))
    one, turned = pressed(Press(probe=probe, at_mm=(5, 0), steps=steps)).path
    a, b = np.ptp(only(one).centre_mm, axis=0), np.ptp(only(turned).centre_mm, axis=0)
    assert a[1] > 2 * a[0]
    assert b[0] == pytest.approx(a[1])
    assert turned.force_n[2] == pytest.approx(one.force_n[2], rel=1e-9)


LIFTED = Step(force_n=(None, None, 0.0))


@pytest.mark.parametrize("friction", [0.0, 0.5, STUCK])
@pytest.mark.parametrize("probe", [Sphere(diameter_mm=5), Cylinder(diameter_mm=4)])
@pytest.mark.parametrize("up", [down(-2.0), pytest.param(LIFTED, marks=pytest.mark.slow)])
def test_a_lift_returns_to_zero_and_the_next_push_starts_anew(friction, probe, up):
    def walked(*steps):
        return pressed(Press(probe=probe, friction=friction, steps=steps), across=10).path

    _, lifted, again = walked(down(0.1), up, push(0.2))
    assert lifted.load.terms == ()
    assert not lifted.force_n.any()
    assert lifted.indentation_mm == lifted.contact_radius_mm == 0.0
    (fresh,) = walked(push(0.2))
    assert again.indentation_mm == pytest.approx(fresh.indentation_mm, rel=1e-3)


def test_unloading_a_stuck_sheared_sphere_lets_go_from_the_outside():
    steps = tuple(Step(force_n=force) for force in ((0, 0, 0.5), (0.1, 0, 0.5), (0.1, 0, 0.1)))
    _, full, less = pressed(ball(10, friction=STUCK, steps=steps), across=10).path
    assert less.contact_radius_mm < 0.7 * full.contact_radius_mm
    assert less.move_mm[0] > full.move_mm[0]
    assert_allclose(less.force_n, [0.1, 0, 0.1], atol=1e-8)


FREE = (Step(force_n=(0, 0, 0.5)),)


def test_a_ball_on_the_seam_of_the_finger_rolls_to_where_nothing_pushes_it():
    """All three forces given: the frictionless ball leaves the tip's slope for the barrel."""
    state = pressed(ball(3, steps=FREE), FINGER)
    assert_allclose(state.force_n, [0, 0, 0.5], atol=5e-9)
    radius = state.contact_radius_mm
    assert -1.2 * radius < state.move_mm[0] < -0.5 * radius


def test_without_friction_the_shorthand_is_a_guided_push():
    """No side force is given: the probe stays, and its guide takes the slope's side force."""
    state = pressed(ball(3, at_mm=(2, 0), force_n=(0, 0, 0.5)), FINGER)
    assert state.move_mm[:2].tolist() == [0, 0]
    assert state.force_n[2] == pytest.approx(0.5, rel=1e-8)
    assert state.force_n[0] < -0.02


DEEP = {"indentation_mm": 0.1}
TWISTED = (push(1.0, torque_nmm=1.0),)
LOST = (down(0.1), Step(force_n=(0.1, None, 0.0)))
ACROSS = {"at_mm": (-7.5, 0, 0), "direction": (1, 0, 0.1), "tilt_deg": (0, 15, 0)}
NEAR = (ball(3, at_mm=(1, 0), **DEEP),)


@pytest.mark.parametrize(
    ("body", "error", "words", "probe"),
    [
        (BLOCK, InputError, "misses", ball(3, at_mm=(60, 0), force_n=(0, 0, 1))),
        (BLOCK, ContactError, "over the edge", face(5, at_mm=(49, 0), force_n=(0, 0, 1))),
        (BLOCK, ContactError, "over the edge", ball(5, at_mm=(49.5, 0), force_n=(0, 0, 1))),
        (BLOCK, ContactError, "sinks in", ball(3, force_n=(0, 0, 50))),
        (BLOCK, ContactError, "sinks in", face(5, friction=STUCK, indentation_mm=25)),
        (BLOCK, ContactError, "along x can't be balanced", ball(3, force_n=(0.1, 0, 1))),
        (BLOCK, ContactError, "torque about z can't be balanced", face(3, steps=TWISTED)),
        (BLOCK, InputError, "can't pull", ball(3, steps=(down(0.1), push(-0.1)))),
        (BLOCK, ContactError, "touches nothing", ball(3, friction=STUCK, steps=LOST)),
        (FINGER, ContactError, "hold x", punch(10, steps=FREE)),
        (FINGER, ContactError, "mm sideways", ball(3, at_mm=(-4, 1), steps=FREE)),
        (FINGER, ContactError, "hold x", ball(3, at_mm=(-4, 4), steps=FREE)),
        (BLOCK, InputError, "from inside the body", ball(3, direction=(0, 0, -1.0), **DEEP)),
        (BLOCK, InputError, "inside the body", ball(3, at_mm=(0, 0, 3.0), **DEEP)),
        (BLOCK, InputError, "off the sensing surface", ball(3, at_mm=(0, 0, -2.0), **DEEP)),
        (BLOCK, InputError, "misses", ball(3, at_mm=(80, 0), direction=(0, 0.1, 1.0), **DEEP)),
        (BLOCK, InputError, "stand|apart, less than", ball(3, also=NEAR, **DEEP)),
        (FINGER, InputError, "off its sensing surface", punch(6, **ACROSS, **DEEP)),
        (BLOCK, ContactError, "cone's base", Press(probe=Cone(apex_deg=150, diameter_mm=2), force_n=(0, 0, 2))),
        (
            BLOCK,
            ContactError,
            "can carry|can be balanced",
            ball(3, direction="normal", friction=0.2, force_n=(0.1, 0, 0.2)),
        ),
    ],
)
def test_refusals(body, error, words, probe):
    with pytest.raises(error, match=words):
        pressed(probe, body)


def test_the_number_of_patches_has_a_range():
    with pytest.raises(InputError, match="6 to 40"):
        pressed(ball(3, force_n=(0, 0, 1)), across=100)


def test_a_grid_that_is_too_small_grows(monkeypatch):
    probe = ball(3, at_mm=(-2, 3), steps=(down(0.3),))
    whole = pressed(probe, FINGER)
    monkeypatch.setattr(contact_search, "_MARGIN", 0.01)
    assert pressed(probe, FINGER).force_n[2] == pytest.approx(whole.force_n[2], rel=5e-3)


BARREL_MM2 = 3.0 * 8 * (math.asin(6.5 / 8) - math.asin(3.5 / 8))


@pytest.mark.parametrize(("at", "area"), [((-4.0, 5.0), BARREL_MM2), ((3.0, 2.0), None)])
def test_patches_tile_the_curved_surface(at, area):
    """Under a square of 3 mm: exactly on the barrel; on the tip against the slope integrated."""
    plane = Plane(origin_mm=np.array([*at, 0.0]), axes=np.eye(3))
    box = Box(u0=-1.5, u1=1.5, v0=-1.5, v1=1.5)
    patches = Patches.under(FINGER, Footprint(half_mm=(1.5, 1.5), is_round=False), plane, box, (16, 16))
    if area is None:
        steps = (np.arange(400) + 0.5) / 400 * 3 - 1.5
        x, y = np.meshgrid(at[0] + steps, at[1] + steps)
        area = float((8 / np.sqrt(64 - x**2 - y**2)).mean()) * 9
    beyond = 4.0 * np.prod(patches.cell_mm, axis=1).sum() / 9.0  # cells end a little beyond a sharp rim
    assert 1.0 < beyond < 1.01
    assert patches.area_mm2.sum() / beyond == pytest.approx(area, rel=2e-3)


@pytest.mark.slow
def test_a_probe_sheared_harder_than_it_is_pressed_peels_off_its_trailing_side():
    wanted = ball(6, friction=STUCK, steps=(push(0.05), sideways(0.1)))
    one, sheared = pressed(wanted, nu=0.3).path
    assert sheared.residual <= 1e-8
    assert sheared.force_n[0] > one.force_n[2]
    moment, before = (s.force_n[2] * centre_of(s)[0] for s in (sheared, one))
    assert abs(moment) > 10 * abs(before)


@pytest.mark.parametrize(
    ("probe", "force_n", "across"),
    [
        (Sphere(diameter_mm=5), 0.05, 16),
        (Cone(apex_deg=150, diameter_mm=8), 0.05, 16),
        (Cylinder(diameter_mm=4), 0.05, 16),
        (Pillar(width_mm=2, length_mm=5), 0.05, 16),
        (Cylinder(diameter_mm=4, edge_mm=0.5), 0.5, 28),
    ],
)
def test_a_contact_of_a_closed_form_is_the_one_that_is_searched(probe, force_n, across, monkeypatch):
    wanted = Press(probe=probe, at_mm=(1, 2), force_n=(None, None, force_n))
    known = pressed(wanted, across=across)
    monkeypatch.setattr(pressing, "closed_form_contact", lambda *_: None)
    searched = pressed(wanted, across=across)
    assert known.indentation_mm == pytest.approx(searched.indentation_mm, rel=2e-3)
    assert known.contact_radius_mm == pytest.approx(searched.contact_radius_mm, rel=0.03)


@pytest.fixture
def searches(monkeypatch):
    """Return a list that grows by one with each search for a contact."""
    made, find = [], pressing.find_contact

    def finding(*given, **named):
        made.append(given)
        return find(*given, **named)

    monkeypatch.setattr(pressing, "find_contact", finding)
    return made


def test_a_contact_that_a_closed_form_misses_is_searched(searches):
    """With a modulus eight times too small the disc is twice too large."""
    wanted = ball(5, at_mm=(0, 0), force_n=(None, None, 0.05))
    soft = pressed(wanted, on=HalfSpace(1.0), e=0.125, across=12)
    assert len(searches) == 1
    known = pressed(wanted, across=12)
    assert len(searches) == 1
    assert soft.indentation_mm == pytest.approx(known.indentation_mm, rel=5e-3)


def test_under_a_cover_of_another_material_contacts_with_friction_are_searched(searches):
    class Layered(HalfSpace):
        one_material = False

    rough = ball(5, at_mm=(0, 0), force_n=(None, None, 0.05), friction=0.5)
    for surface, expected in ((HalfSpace(), 0), (Layered(), 1)):
        pressed(rough, on=surface, across=8)
        assert len(searches) == expected


SIZE = 2.0
LATTICE = np.stack(np.meshgrid(*2 * [np.linspace(-1, 1, 21)]), axis=-1).reshape(-1, 2)
U, V = LATTICE[np.linalg.norm(LATTICE, axis=1) <= 1.0].T
"""Places on a disc of `SIZE`, over it; their mean is the middle."""
SQUARE = U**2 + V**2
BALL, CONE = Sphere(diameter_mm=40), Cone(apex_deg=150, diameter_mm=20)


def area_of(probe, place, cell, pressure):
    """Return the area of a contact whose equal patches (k, 2) have known pressures, mm2."""
    k = len(place)
    half = np.full((k, 2), cell / 2)
    frames, never = np.tile(np.eye(3), (k, 1, 1)), np.zeros(k, bool)
    grid = {"centre_mm": np.c_[place, np.zeros(k)], "frames": frames, "half_mm": half, "middle_mm": place}
    patches = Patches(**grid, cell_mm=half, border=never, edge=never)
    force = np.zeros((k, 3))
    force[:, 2] = pressure * cell**2
    moved = {"displacement_mm": np.zeros((k, 3)), "pose": np.zeros(6), "total": np.zeros(6)}
    found = Equilibrium(force_n=force, active=~never, slipping=never, residual=0.0, steps=1, **moved)
    rubber = {"youngs_modulus_mpa": 1.0, "poisson_ratio": 0.5}
    first = Approach.of(probe, BLOCK, np.zeros(2))
    setup = ProbeSetup(body=BLOCK, compliance=HalfSpace(), first=first, across=16, most=1000, **rubber)
    slope = np.tile([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], (k, 1))
    return ContactState.touching(setup, patches, found, touch_z_mm=0.0, friction=0.0, slope=slope).area_mm2


def area(squared, probe=BALL, chosen=slice(None)):
    """Return the area over that of a disc of `SIZE`."""
    place = SIZE * np.column_stack([U, V])[chosen]
    return area_of(probe, place, 0.1 * SIZE, np.sqrt(squared[chosen])) / (math.pi * SIZE**2)


@pytest.mark.parametrize("probe", [BALL, CONE])
def test_the_area_is_of_the_nearest_polynomial(probe):
    """By least squares, which do not see what is orthogonal to all terms; a cone's reads the outer half alone."""
    squared = 1.0 - (U / 1.05) ** 2 - (V / 1.1) ** 2 + 0.05 * U * V + 0.03 * U - 0.01 * SQUARE**2
    exact = area(squared, probe)
    used = squared <= np.median(squared) if probe is CONE else np.ones(len(U), bool)
    terms = np.column_stack([np.ones(len(U)), U, V, U * U, U * V, V * V, SQUARE**2])[used]
    basis = np.linalg.qr(terms)[0]
    noise = np.random.default_rng(0).uniform(-1, 1, len(terms))
    unseen = noise - basis @ (basis.T @ noise)
    unseen *= 0.2 * squared.min() / np.abs(unseen).max()
    noisy = squared.copy()
    noisy[used] += unseen
    noisy[~used] += 1.0
    assert area(noisy, probe) == pytest.approx(exact, rel=1e-9)
    assert area(squared - 0.03 * SQUARE, probe) < 0.99 * exact


@pytest.mark.parametrize("probe", [BALL, CONE])
def test_a_term_that_others_make_up_is_left_out(probe):
    """Of two rows v^2 is one, so that rounding of the places would decide on the area."""
    rng = np.random.default_rng(1)
    place = np.array([(a, b) for a in range(8) for b in range(2)], float)
    for _ in range(50):
        pressure = np.sqrt(1.0 - ((place[:, 0] - 3.5) / 4.0) ** 2) + rng.uniform(0.0, 0.1, len(place))
        exact, near = (area_of(probe, place + off * rng.normal(size=place.shape), 1.0, pressure) for off in (0, 1e-12))
        assert near == pytest.approx(exact, rel=1e-6)


def test_a_contact_ends_where_its_polynomial_first_vanishes():
    """On an ellipse (mean squared radius: product of its half axes); at the first of two ends; else patches count."""
    ellipse = 1.0 - (U / 1.02) ** 2 - (V / 1.1) ** 2
    assert area(ellipse) == pytest.approx(1.02 * 1.1, rel=1e-4)
    once, again = 0.7, 1.2
    both = (SQUARE - once**2) * (SQUARE - again**2)
    assert area(both, CONE, SQUARE < 0.68**2) == pytest.approx(once**2, rel=1e-4)
    assert area(1.0 + 0.1 * SQUARE) == pytest.approx(len(U) * 0.01 / math.pi)
