"""Presses on a half-space against the closed forms, and what must hold on any body."""

import math
from itertools import pairwise

import numpy as np
import pytest

from twin.errors import ContactError, InputError
from twin.parts.body import Block, Body, Finger
from twin.parts.load import Rectangles
from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere, Step
from twin.parts.probe import Probe
from twin.theory import halfspace
from twin.theory.contact import (
    bonded_punch_stiffness,
    hertz,
    oblique_motion,
    punch_stiffness,
    square_punch_stiffness,
    tangential_stiffness,
    torsional_stiffness,
)
from twin.world.contact import contact, region, rubbing
from twin.world.contact.cells import Box
from twin.world.contact.contact import ContactState, press
from twin.world.contact.patches import Plane, candidate_patches

BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
STUCK = math.inf


class HalfSpace:
    """The compliance of a half-space under every patch's own tangent plane, made symmetric."""

    one_material = True

    def __init__(self, youngs_modulus_mpa: float = 1.0, poisson_ratio: float = 0.5) -> None:
        self.rubber = youngs_modulus_mpa, poisson_ratio

    def to_points(self, points: np.ndarray, rectangles: Rectangles) -> np.ndarray:
        return halfspace.compliance(points, rectangles, *self.rubber)

    def surface(self, rectangles: Rectangles) -> np.ndarray:
        found = halfspace.compliance(rectangles.centre_mm, rectangles, *self.rubber)
        return (found + found.T) / 2.0


def pressed(
    press_: Press, body: Body = BLOCK, e: float = 1.0, nu: float = 0.5, across: int = 16, **more: int
) -> ContactState:
    return press(press_, body, HalfSpace(e, nu), patches_across=across, youngs_modulus_mpa=e, poisson_ratio=nu, **more)


def down(move_z: float) -> Step:
    return Step(move_mm=(None, None, move_z))


def only(state: ContactState) -> Rectangles:
    (term,) = state.load.terms
    assert isinstance(term, Rectangles)
    return term


# --- closed forms ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [0.3, 0.5])
@pytest.mark.parametrize("held", ["force", "motion"])
def test_hertz(nu: float, held: str) -> None:
    # Light, so that the parabola in Hertz's theory and the exact sphere here agree: a/R = 0.07.
    theory = hertz(radius_mm=20.0, youngs_modulus_mpa=0.8, poisson_ratio=nu, indentation_mm=0.1)
    path = {"force_n": (0, 0, theory.force_n)} if held == "force" else {"indentation_mm": 0.1}
    state = pressed(Press(probe=Sphere(diameter_mm=40), **path), e=0.8, nu=nu, across=20)
    assert state.contact_radius_mm == pytest.approx(theory.contact_radius_mm, rel=0.006)
    assert state.peak_pressure_mpa == pytest.approx(theory.peak_pressure_mpa, rel=0.01)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.004)
    assert state.force_n[2] == pytest.approx(theory.force_n, rel=0.004)
    distance = np.hypot(*only(state).centre_mm[:, :2].T)
    inner = distance < 0.85 * theory.contact_radius_mm
    np.testing.assert_allclose(
        state.pressure_mpa[inner], theory.pressure(distance[inner]), atol=0.015 * theory.peak_pressure_mpa
    )


@pytest.mark.parametrize(("diameter", "force"), [(1000.0, 1e-4), (300.0, 1e-5)])
def test_a_light_touch_of_a_large_sphere(diameter: float, force: float) -> None:
    """Round-off of the sphere's size is not small beside the indentation here."""
    theory = hertz(radius_mm=diameter / 2, youngs_modulus_mpa=1.0, poisson_ratio=0.5, force_n=force)
    state = pressed(Press(probe=Sphere(diameter_mm=diameter), force_n=(0, 0, force)), across=10)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.01)


def test_a_cone_beside_the_fingers_crest_finds_its_contact() -> None:
    """A long contact that leans out of the grid's plane reached over one corner of grids that only moved after it."""
    wanted = Press(probe=Cone(apex_deg=133, diameter_mm=6.56), at_mm=(3.068, 1.945), force_n=(None, None, 0.2532))
    state = pressed(wanted, FINGER, e=0.5, across=9)
    assert state.force_n[2] == pytest.approx(0.2532, rel=1e-8)
    assert state.residual < 1e-8


def test_flat_punch_converges_to_its_stiffness() -> None:
    theory = 0.1 * punch_stiffness(2.5, 1.0, 0.5)
    probe = Press(probe=Cylinder(diameter_mm=5), indentation_mm=0.1)
    errors = [abs(pressed(probe, across=n).force_n[2] / theory - 1) for n in (8, 16, 32)]
    orders = [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert min(orders) > 1.2, (errors, orders)
    assert errors[1] < 0.006


def test_square_pillar() -> None:
    for side in (3.0, 40.0):
        state = pressed(Press(probe=Pillar(width_mm=side), indentation_mm=0.01 * side), e=0.3)
        assert state.force_n[2] / (0.01 * side) == pytest.approx(square_punch_stiffness(side, 0.3, 0.5), rel=0.005)
        assert state.area_mm2 == pytest.approx(side**2, rel=1e-12)


def test_stuck_punch_tangential_and_torsional_stiffness() -> None:
    steps = (down(0.1), Step(move_mm=(0.05, None, None)), Step(move_mm=(None, 0.1, None)), Step(turn_deg=-2.0))
    first, _, both, turned = pressed(Press(probe=Cylinder(diameter_mm=5), friction=STUCK, steps=steps)).path
    assert np.abs(first.force_n[:2]).max() < 1e-10
    stiffness = tangential_stiffness(2.5, 1.0, 0.5)
    np.testing.assert_allclose(both.force_n[:2], [0.05 * stiffness, 0.1 * stiffness], rtol=0.007)
    assert both.force_n[2] == pytest.approx(first.force_n[2], rel=1e-9)
    assert turned.torque_nmm == pytest.approx(-math.radians(2.0) * torsional_stiffness(2.5, 1.0, 0.5), rel=0.01)


@pytest.mark.parametrize("nu", [0.0, 0.3])
def test_stuck_punch_on_compressible_rubber(nu: float) -> None:
    state = pressed(Press(probe=Cylinder(diameter_mm=5), friction=STUCK, indentation_mm=0.1), nu=nu)
    assert state.force_n[2] == pytest.approx(0.1 * bonded_punch_stiffness(2.5, 1.0, nu), rel=0.012)


def test_stuck_sphere_pressed_then_sheared_then_twisted() -> None:
    steps = (Step(force_n=(0, 0, 0.5)), Step(force_n=(0.1, 0, 0.5)), Step(force_n=(0.1, 0, 0.5), torque_nmm=0.05))
    one, sheared, turned = pressed(Press(probe=Sphere(diameter_mm=30), friction=STUCK, steps=steps), across=20).path
    a = one.contact_radius_mm
    assert one.move_mm[0] == pytest.approx(0.0, abs=1e-12)
    assert sheared.move_mm[0] == pytest.approx(0.1 / tangential_stiffness(a, 1.0, 0.5), rel=0.01)
    assert math.radians(turned.turn_deg) == pytest.approx(0.05 / torsional_stiffness(a, 1.0, 0.5), rel=0.04)
    assert turned.torque_nmm == pytest.approx(0.05, rel=1e-8)
    np.testing.assert_allclose(turned.force_n, [0.1, 0, 0.5], atol=5e-9)


def test_new_patches_stick_from_where_they_touch() -> None:
    """A force that grows obliquely moves a stuck sphere by 3/2 of what the same force does at the final contact."""
    state = pressed(Press(probe=Sphere(diameter_mm=30), friction=STUCK, force_n=(0.05, 0, 0.5)), across=20)
    theory = oblique_motion(state.contact_radius_mm, 0.05, 1.0, 0.5)
    assert state.move_mm[0] == pytest.approx(theory, rel=0.03)


def test_a_stuck_sphere_is_stiffer_and_its_increments_have_converged() -> None:
    probe = Press(probe=Sphere(diameter_mm=10), friction=STUCK, indentation_mm=0.1)
    few, many = (pressed(probe, nu=0.3, increments=n).force_n[2] for n in (8, 24))
    free = pressed(Press(probe=Sphere(diameter_mm=10), indentation_mm=0.1), nu=0.3).force_n[2]
    assert few == pytest.approx(many, rel=2e-3)
    assert 1.01 < many / free < 1.03


def test_crossed_curvatures_of_probe_and_finger() -> None:
    """Mild ellipses: Hertz with the mean R = 1 / sqrt(1/Rx 1/Ry), the curvatures of both bodies added (section 4.2)."""
    state = pressed(Press(probe=Sphere(diameter_mm=3), at_mm=(-4, 0), force_n=(0, 0, 0.002)), FINGER)
    mean = 1 / math.sqrt((1 / 1.5) * (1 / 1.5 + 1 / 8))
    theory = hertz(radius_mm=mean, youngs_modulus_mpa=1.0, poisson_ratio=0.5, force_n=0.002)
    assert state.contact_radius_mm == pytest.approx(theory.contact_radius_mm, rel=0.01)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.01)
    centre = only(state).centre_mm
    assert np.ptp(centre[:, 0]) > np.ptp(centre[:, 1])


# --- what must hold for every press --------------------------------------------------------------------------------

PRESSES = {
    "sphere": (BLOCK, Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 0.980665))),
    "pillar": (BLOCK, Press(probe=Pillar(width_mm=5, length_mm=20), at_mm=(10, -5), force_n=(0, 0, 2))),
    "finger sphere": (FINGER, Press(probe=Sphere(diameter_mm=3), at_mm=(-4, 4), steps=(Step(force_n={"z": 0.3}),))),
    "finger tip": (FINGER, Press(probe=Sphere(diameter_mm=3), at_mm=(4, 2), steps=(down(0.3),))),
    "finger tip stuck": (
        FINGER,
        Press(probe=Sphere(diameter_mm=3), at_mm=(3, 1), friction=STUCK,
              steps=(Step(force_n={"z": 0.3}), Step(force_n=(0.05, -0.03, 0.3)))),
    ),
    "finger cylinder": (
        FINGER, Press(probe=Cylinder(diameter_mm=10), at_mm=(-2, 0), steps=(Step(force_n={"z": 1.0}),)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PRESSES)
def test_equilibrium_and_complementarity(name: str) -> None:
    body, probe = PRESSES[name]
    state = pressed(probe, body)
    patches = only(state)
    np.testing.assert_allclose(patches.force_n.sum(axis=0), state.force_n, atol=1e-12)
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
    np.testing.assert_allclose(patches.frames[:, 2], normal, atol=1e-12)
    np.testing.assert_allclose(
        patches.frames @ patches.frames.transpose(0, 2, 1), np.tile(np.eye(3), (len(patches), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(patches.frames), 1.0)
    if probe.friction == 0:
        lateral = state.traction_mpa - state.pressure_mpa[:, None] * normal
        assert np.abs(lateral).max() < 1e-12
        assert state.slip.all()
    else:
        assert not state.slip.any()
    assert not state.load.terms[0].force_n.flags.writeable


def test_the_surface_takes_the_shape_of_the_sphere() -> None:
    """Independent of the solver: displaced patch centres lie on the moved sphere, its exact shape."""
    state = pressed(Press(probe=Sphere(diameter_mm=3), indentation_mm=0.3))
    patches = only(state)
    u = halfspace.displacement(patches.centre_mm, patches, 1.0, 0.5)
    height = patches.centre_mm[:, 2] + u[:, 2]
    r = np.hypot(*patches.centre_mm[:, :2].T)
    np.testing.assert_allclose(height, 0.3 - (1.5 - np.sqrt(1.5**2 - r**2)), atol=1e-9)
    ring = np.linspace(0, 2 * math.pi, 12, endpoint=False)
    for radius in (1.15 * state.contact_radius_mm, 1.4):
        around = np.column_stack([radius * np.cos(ring), radius * np.sin(ring), np.zeros(12)])
        lifted = halfspace.displacement(around, patches, 1.0, 0.5)[:, 2]
        assert np.all(lifted > 0.3 - (1.5 - math.sqrt(1.5**2 - radius**2)))


def test_a_known_weight_gives_its_weight() -> None:
    state = pressed(Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 100 * 0.00980665)))
    assert only(state).force_n.sum(axis=0) == pytest.approx([0, 0, 0.980665], abs=1e-9)
    assert any("understates" in warning for warning in state.validity.warnings)
    assert pressed(Press(probe=Sphere(diameter_mm=30), force_n=(0, 0, 0.1))).validity.warnings == ()


def test_a_frictionless_slide_carries_no_shear_and_takes_the_contact_along() -> None:
    steps = (Step(force_n={"z": 0.5}), Step(move_mm=(3.0, -2.0, None)), Step(turn_deg=30))
    one, moved, turned = pressed(Press(probe=Sphere(diameter_mm=5), steps=steps)).path
    for state in (moved, turned):
        # z is held, and every place has its own grid: the force keeps to the grid's error.
        np.testing.assert_allclose(state.force_n, one.force_n, atol=5e-4 * one.force_n[2])
        assert np.abs(only(state).force_n[:, :2]).max() == 0.0
        middle = only(state).force_n[:, 2] @ only(state).centre_mm / state.force_n[2]
        np.testing.assert_allclose(middle, [3.0, -2.0, 0.0], atol=1e-6)


def test_a_turned_pillar_presses_its_turned_footprint() -> None:
    steps = (down(0.05), Step(turn_deg=90))
    one, turned = pressed(Press(probe=Pillar(width_mm=4, length_mm=12), at_mm=(5, 0), steps=steps)).path
    a, b = only(one).centre_mm - [5, 0, 0], only(turned).centre_mm - [5, 0, 0]
    assert np.ptp(a[:, 1]) > 2 * np.ptp(a[:, 0])
    assert np.ptp(b[:, 0]) == pytest.approx(np.ptp(a[:, 1]))
    assert turned.force_n[2] == pytest.approx(one.force_n[2], rel=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.5, pytest.param(STUCK, marks=pytest.mark.slow)])
def test_mirror(friction: float) -> None:
    steps = (Step(force_n={"z": 0.4}), Step(move_mm=(0.05, 0.1, None), turn_deg=3))
    mirrored = (steps[0], Step(move_mm=(0.05, -0.1, None), turn_deg=-3))
    one = pressed(Press(probe=Sphere(diameter_mm=3), at_mm=(2, 1.5), friction=friction, steps=steps), FINGER, nu=0.4)
    other = pressed(
        Press(probe=Sphere(diameter_mm=3), at_mm=(2, -1.5), friction=friction, steps=mirrored), FINGER, nu=0.4
    )
    np.testing.assert_allclose(other.force_n * [1, -1, 1], one.force_n, rtol=2e-3, atol=1e-4)
    assert other.torque_nmm == pytest.approx(-one.torque_nmm, rel=0.02, abs=1e-4)
    assert other.contact_radius_mm == pytest.approx(one.contact_radius_mm, rel=5e-3)


def test_units_scale() -> None:
    """Ten times the modulus and the force: the same place, contact and ten times the pressure."""
    soft = pressed(Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 0.2)))
    hard = pressed(Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 2.0)), e=10.0)
    assert hard.indentation_mm == pytest.approx(soft.indentation_mm, rel=1e-9)
    np.testing.assert_allclose(hard.pressure_mpa, 10 * soft.pressure_mpa, rtol=1e-8)


@pytest.mark.parametrize("friction", [0.0, 0.5, STUCK])
@pytest.mark.parametrize("probe", [Sphere(diameter_mm=5), Cylinder(diameter_mm=4)])
@pytest.mark.parametrize("up", [down(-2.0), pytest.param(Step(force_n=(None, None, 0.0)), marks=pytest.mark.slow)])
def test_a_lift_returns_to_zero_and_the_next_push_starts_anew(
    friction: float, probe: Sphere | Cylinder, up: Step
) -> None:
    path = pressed(Press(probe=probe, friction=friction, steps=(down(0.1), up, Step(force_n={"z": 0.2})))).path
    assert path[1].load.terms == ()
    assert not path[1].force_n.any()
    assert path[1].indentation_mm == path[1].contact_radius_mm == 0.0
    fresh = pressed(Press(probe=probe, friction=friction, steps=(Step(force_n={"z": 0.2}),)))
    assert path[2].indentation_mm == pytest.approx(fresh.indentation_mm, rel=1e-3)


def test_unloading_a_stuck_sheared_sphere_lets_go_from_the_outside() -> None:
    steps = (Step(force_n=(0, 0, 0.5)), Step(force_n=(0.1, 0, 0.5)), Step(force_n=(0.1, 0, 0.1)))
    _, full, less = pressed(Press(probe=Sphere(diameter_mm=10), friction=STUCK, steps=steps)).path
    assert less.contact_radius_mm < 0.7 * full.contact_radius_mm
    assert less.move_mm[0] > full.move_mm[0]
    np.testing.assert_allclose(less.force_n, [0.1, 0, 0.1], atol=1e-8)


def test_a_ball_on_the_seam_of_the_finger_rolls_to_where_nothing_pushes_it() -> None:
    """All three forces given: the frictionless ball leaves the tip's slope for the barrel, and says so in its move."""
    state = pressed(Press(probe=Sphere(diameter_mm=3), steps=(Step(force_n=(0, 0, 0.5)),)), FINGER)
    np.testing.assert_allclose(state.force_n, [0, 0, 0.5], atol=5e-9)
    assert -1.2 * state.contact_radius_mm < state.move_mm[0] < -0.5 * state.contact_radius_mm


def test_without_friction_the_shorthand_is_a_guided_push() -> None:
    """No side force is given, so the probe stays over its place and the slope's side force is its guide's."""
    state = pressed(Press(probe=Sphere(diameter_mm=3), at_mm=(2, 0), force_n=(0, 0, 0.5)), FINGER)
    assert state.move_mm[:2].tolist() == [0, 0]
    assert state.force_n[2] == pytest.approx(0.5, rel=1e-8)
    assert state.force_n[0] < -0.02


FREE = (Step(force_n=(0, 0, 0.5)),)

# --- refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "error", "words", "probe"),
    [
        (BLOCK, InputError, "misses", Press(probe=Sphere(diameter_mm=3), at_mm=(60, 0), force_n=(0, 0, 1))),
        (BLOCK, ContactError, "over the edge", Press(probe=Pillar(width_mm=5), at_mm=(49, 0), force_n=(0, 0, 1))),
        (BLOCK, ContactError, "over the edge", Press(probe=Sphere(diameter_mm=5), at_mm=(49.5, 0), force_n=(0, 0, 1))),
        (BLOCK, ContactError, "sinks in", Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 50))),
        (BLOCK, ContactError, "sinks in", Press(probe=Pillar(width_mm=5), friction=STUCK, indentation_mm=25)),
        (BLOCK, ContactError, "along x can't be balanced", Press(probe=Sphere(diameter_mm=3), force_n=(0.1, 0, 1))),
        (BLOCK, ContactError, "torque about z can't be balanced",
         Press(probe=Pillar(width_mm=3), steps=(Step(force_n={"z": 1.0}, torque_nmm=1.0),))),
        (BLOCK, InputError, "can't pull",
         Press(probe=Sphere(diameter_mm=3), steps=(down(0.1), Step(force_n={"z": -0.1})))),
        (BLOCK, ContactError, "touches nothing",
         Press(probe=Sphere(diameter_mm=3), friction=STUCK, steps=(down(0.1), Step(force_n=(0.1, None, 0.0))))),
        (FINGER, ContactError, "hold x", Press(probe=Cylinder(diameter_mm=10), steps=FREE)),
        (FINGER, ContactError, "mm sideways", Press(probe=Sphere(diameter_mm=3), at_mm=(-4, 1), steps=FREE)),
        (FINGER, ContactError, "hold x", Press(probe=Sphere(diameter_mm=3), at_mm=(-4, 4), steps=FREE)),
    ],
)  # fmt: skip
def test_refusals(body: Body, error: type[Exception], words: str, probe: Press) -> None:
    with pytest.raises(error, match=words):
        pressed(probe, body)


def test_the_number_of_patches_has_a_range() -> None:
    with pytest.raises(InputError, match="6 to 40"):
        pressed(Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 1)), across=100)


# --- grids ---------------------------------------------------------------------------------------------------------


def test_a_grid_that_is_too_small_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    probe = Press(probe=Sphere(diameter_mm=3), at_mm=(-2, 3), steps=(down(0.3),))
    whole = pressed(probe, FINGER)
    monkeypatch.setattr(region, "_MARGIN", 0.01)
    assert pressed(probe, FINGER).force_n[2] == pytest.approx(whole.force_n[2], rel=5e-3)


@pytest.mark.parametrize(
    ("at", "area"), [((-4.0, 5.0), 3.0 * 8 * (math.asin(6.5 / 8) - math.asin(3.5 / 8))), ((3.0, 2.0), None)]
)
def test_patches_tile_the_curved_surface(at: tuple[float, float], area: float | None) -> None:
    """Under a square of 3 mm: exactly on the barrel; on the tip against the slope integrated over the footprint."""
    plane = Plane(origin_mm=np.array([*at, 0.0]), axes=np.eye(3))
    box = Box(u0=-1.5, u1=1.5, v0=-1.5, v1=1.5)
    patches = candidate_patches(FINGER, Pillar(width_mm=3), plane, box, (16, 16))
    if area is None:
        steps = (np.arange(400) + 0.5) / 400 * 3 - 1.5
        x, y = np.meshgrid(at[0] + steps, at[1] + steps)
        area = float((8 / np.sqrt(64 - x**2 - y**2)).mean()) * 9
    assert patches.area_mm2.sum() == pytest.approx(area, rel=2e-3)


@pytest.mark.slow
def test_a_probe_sheared_harder_than_it_is_pressed_peels_off_its_trailing_side() -> None:
    steps = (Step(force_n={"z": 0.05}), Step(move_mm=(0.1, None, None)))
    one, sheared = pressed(Press(probe=Sphere(diameter_mm=6), friction=STUCK, steps=steps), nu=0.3).path
    assert sheared.residual <= 1e-8
    assert sheared.force_n[0] > one.force_n[2]
    front = only(sheared).force_n[:, 2] @ only(sheared).centre_mm[:, 0]
    assert abs(front) > 10 * abs(only(one).force_n[:, 2] @ only(one).centre_mm[:, 0])


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
def test_a_contact_that_a_closed_form_tells_is_the_one_that_is_searched(
    probe: Probe, force_n: float, across: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = Press(probe=probe, at_mm=(1, 2), force_n=(None, None, force_n))
    told = pressed(wanted, across=across)
    monkeypatch.setattr(contact, "known_contact", lambda *_: None)
    searched = pressed(wanted, across=across)
    assert told.indentation_mm == pytest.approx(searched.indentation_mm, rel=2e-3)
    assert told.contact_radius_mm == pytest.approx(searched.contact_radius_mm, rel=0.03)


def test_a_contact_that_a_closed_form_misses_is_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Told a rubber eight times softer than it is, the disc is twice too large."""
    wanted, searches = Press(probe=Sphere(diameter_mm=5), at_mm=(0, 0), force_n=(None, None, 0.05)), list[object]()
    find = contact.find_contact

    def finding(*given: object) -> object:
        searches.append(given)
        return find(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(contact, "find_contact", finding)
    soft = press(wanted, BLOCK, HalfSpace(1.0), patches_across=12, youngs_modulus_mpa=0.125, poisson_ratio=0.5)
    assert len(searches) == 1
    known = pressed(wanted, across=12)
    assert len(searches) == 1
    assert soft.indentation_mm == pytest.approx(known.indentation_mm, rel=5e-3)


def test_under_a_cover_of_another_material_contacts_with_friction_are_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    class Layered(HalfSpace):
        one_material = False

    searches, find = list[object](), rubbing.find_contact

    def finding(*given: object, **named: object) -> object:
        searches.append(given)
        return find(*given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(rubbing, "find_contact", finding)
    rough = Press(probe=Sphere(diameter_mm=5), at_mm=(0, 0), force_n=(None, None, 0.05), friction=0.5)
    for surface, expected in ((HalfSpace(1.0), 0), (Layered(1.0), 1)):
        press(rough, BLOCK, surface, patches_across=8, youngs_modulus_mpa=1.0, poisson_ratio=0.5)
        assert len(searches) == expected
