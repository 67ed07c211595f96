"""Probes of every shape, from every side, moved in all ways, and several at once: closed forms and invariance."""

import itertools
import math
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from test_contact import BLOCK, FINGER, HalfSpace, only, pressed

from twin.arrays import Floats
from twin.errors import ContactError, InputError, NotSettled, RecipeError
from twin.parts.press import Press, Step, frame_of
from twin.parts.probe import Cone, Cylinder, Pillar, Probe, Sphere, Stl
from twin.theory import halfspace
from twin.theory.contact import (
    cone_contact_radius,
    cone_indentation,
    hertz,
    plane_strain_modulus,
    punch_stiffness,
    rocking_stiffness,
    tangential_stiffness,
)
from twin.world.contact import contact, friction
from twin.world.contact.approach import approach
from twin.world.contact.contact import ContactState, press
from twin.world.contact.probe_shape import RIM, rotation_of, shape_of, turning_of

BALL = Sphere(diameter_mm=3)


def write_stl(path: Path, vertices: Floats, triangles: Floats) -> Path:
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", len(triangles)))
        for corners in vertices[triangles]:
            file.write(struct.pack("<12fH", 0, 0, 0, *corners.reshape(-1), 0))
    return path


def sphere_triangles(radius: float, across: int = 60) -> tuple[Floats, np.ndarray]:
    """A ball whose triangles are finest at +z."""
    from scipy.spatial import ConvexHull

    points = [[0.0, 0.0, radius], [0.0, 0.0, -radius]]
    for angle in math.pi * (np.arange(1, across) / across) ** 1.7:
        count = max(48, round(70 * math.sin(angle)))
        turn = 2 * math.pi * (np.arange(count) + 0.3) / count
        ring = [math.sin(angle) * np.cos(turn), math.sin(angle) * np.sin(turn), np.full(count, math.cos(angle))]
        points += (radius * np.column_stack(ring)).tolist()
    vertices = np.array(points)
    triangles = ConvexHull(vertices).simplices
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return vertices, triangles


# --- shapes --------------------------------------------------------------------------------------------------------

SHAPES: dict[str, Probe] = {
    "sphere": Sphere(diameter_mm=3),
    "cylinder": Cylinder(diameter_mm=4, edge_mm=0.7),
    "pillar": Pillar(width_mm=3, length_mm=5, edge_mm=0.5),
    "cone": Cone(apex_deg=120, diameter_mm=6),
    "round cone": Cone(apex_deg=90, diameter_mm=6, tip_mm=0.8),
    "face": Pillar(width_mm=3),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (12.0, -8.0, 30.0)])
def test_slopes_are_the_derivatives_of_gaps(name: str, tilt: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(3)
    there = approach(SHAPES[name], BLOCK, np.array([1.0, 2.0]), frame_of((0.2, -0.1, 1.0)), tilt)
    points = there.touch_mm + rng.normal(scale=0.4, size=(90, 3)) * [1, 1, 0.1]
    normals = np.array([0.0, 0.0, 1.0]) + 0.1 * rng.normal(size=(90, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    place = np.array([0.1, -0.05, 0.2, 0.06, -0.04, 0.3])
    gap, slope = there.gap(points, normals, place)
    met = np.isfinite(gap)
    assert met.sum() > 8
    for component in range(6):
        ahead, behind = place.copy(), place.copy()
        ahead[component] += 1e-6
        behind[component] -= 1e-6
        numeric = (there.gap(points, normals, ahead)[0][met] - there.gap(points, normals, behind)[0][met]) / 2e-6
        np.testing.assert_allclose(slope[met, component], numeric, atol=2e-5)


def test_round_shapes_meet_lines_where_balls_around_their_cores_do() -> None:
    """A rounded cylinder whose edge is its radius is a ball with a shaft, a cone's tip a ball: met below alike."""
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 3))
    along = np.tile([0.0, 0.0, 1.0], (50, 1))
    ball = shape_of(Sphere(diameter_mm=2)).met(points, along)
    for probe in (Cylinder(diameter_mm=2, edge_mm=1.0), Cone(apex_deg=60, diameter_mm=6, tip_mm=1.0)):
        distance, normal = shape_of(probe).met(points, along)
        np.testing.assert_allclose(distance, ball[0], atol=1e-12)
        np.testing.assert_allclose(normal, ball[1], atol=1e-10)
    flat, _ = shape_of(Cylinder(diameter_mm=2)).met(np.array([[RIM - 1e-3, 0, 0], [RIM + 1e-3, 0, 0]]), along[:2])
    assert np.isfinite(flat).tolist() == [True, False]


@pytest.mark.parametrize("kind", [Cylinder(diameter_mm=2), Pillar(width_mm=2)])
@pytest.mark.parametrize("edge", [5e-324, 8.5e-207, 1e-160, 1e-30])
def test_a_rim_too_narrow_to_square_is_as_good_as_sharp(kind: Cylinder | Pillar, edge: float) -> None:
    """Found by random scenes: the square of such a height is 0, and the nearest point's direction was divided by it."""
    points = np.column_stack([np.linspace(-1.1, 1.1, 23), np.zeros(23), np.zeros(23)])
    along = np.tile([0.0, 0.0, 1.0], (23, 1))
    distance, normal = shape_of(kind.model_copy(update={"edge_mm": edge})).met(points, along)
    sharp, down = shape_of(kind).met(points, along)
    np.testing.assert_allclose(distance, sharp, atol=1e-12)
    np.testing.assert_allclose(normal, down, atol=1e-12)


def test_rotation_vectors() -> None:
    turn, change = np.array([0.3, -0.7, 0.5]), 1e-6 * np.array([1.0, 2.0, -1.0])
    rotation = rotation_of(turn)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    turned = rotation_of(turn + change) @ rotation.T
    small = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
    np.testing.assert_allclose(small, turning_of(turn) @ change, atol=1e-11)


# --- closed forms on a half-space ----------------------------------------------------------------------------------


def test_cone() -> None:
    """Love and Sneddon."""
    radius = cone_contact_radius(0.05, 150.0, 1.0, 0.5)
    state = pressed(Press(probe=Cone(apex_deg=150, diameter_mm=10), force_n=(0, 0, 0.05)))
    assert state.contact_radius_mm == pytest.approx(radius, rel=0.01)
    assert state.indentation_mm == pytest.approx(cone_indentation(radius, 150.0), rel=0.002)
    assert state.validity.steepest_slope == pytest.approx(math.tan(math.radians(15)), rel=1e-6)
    assert state.validity.linear is False
    distance = np.hypot(*only(state).centre_mm[:, :2].T)
    middle = (distance > 0.2 * radius) & (distance < 0.85 * radius)
    theory = 0.5 * plane_strain_modulus(1.0, 0.5) * math.tan(math.radians(15)) * np.arccosh(radius / distance[middle])
    np.testing.assert_allclose(state.pressure_mpa[middle], theory, atol=0.03 * theory.max())


def axisymmetric(slope_at: object, force: float, largest: float) -> tuple[float, float]:
    """Contact radius and indentation of any body of revolution (Sneddon 1965), from its profile's slope; E* = 4/3."""

    def depth(a: float) -> float:
        return a * float(quad(lambda t: slope_at(a * math.sin(t)), 0, math.pi / 2, limit=200)[0])  # type: ignore[operator]

    def pushed(a: float) -> float:
        return 2 * 4 / 3 * (a * depth(a) - float(quad(depth, 0, a, limit=60)[0]))

    radius = float(brentq(lambda a: pushed(a) - force, 1e-3, largest, xtol=1e-6))
    return radius, depth(radius)


@pytest.mark.parametrize("edge", [0.3, 1.0])
def test_rounded_punch(edge: float) -> None:
    """A flat middle and a rim that is a quarter of a torus."""
    flat = 2.5 - edge

    def slope(r: float) -> float:
        return 0.0 if r <= flat else (r - flat) / math.sqrt(max(edge**2 - (r - flat) ** 2, 1e-12))

    radius, depth = axisymmetric(slope, 0.5, 2.499)
    state = pressed(Press(probe=Cylinder(diameter_mm=5, edge_mm=edge), force_n=(0, 0, 0.5)), across=28)
    assert state.indentation_mm == pytest.approx(depth, rel=0.002)
    assert state.contact_radius_mm == pytest.approx(radius, rel=0.05)  # counted in patches
    inner = np.hypot(*only(state).centre_mm[:, :2].T) < flat / 2
    sharp = pressed(Press(probe=Cylinder(diameter_mm=5), force_n=(0, 0, 0.5)))
    assert state.peak_pressure_mpa < 0.7 * sharp.peak_pressure_mpa
    assert inner.any()


@pytest.mark.parametrize("held", ["turn", "torque", "tilted before"])
def test_tilted_punch(held: str) -> None:
    """A moment of 4/3 E* a^3 per radian, about either axis, without changing the indentation."""
    stiffness, angle = rocking_stiffness(2.5, 1.0, 0.5), 1.0
    moment = math.radians(angle) * stiffness
    probe = Cylinder(diameter_mm=5)
    if held == "tilted before":
        state = pressed(Press(probe=probe, tilt_deg=(0, angle, 0), steps=(Step(force_n={"z": 1.0}),)))
        assert state.torques_nmm[1] == pytest.approx(moment, rel=0.016)
        assert state.torques_nmm[0] == pytest.approx(0.0, abs=1e-9)
        return
    given = {"turn_deg": {"x": -angle}} if held == "turn" else {"torque_nmm": {"x": -moment}}
    steps = (Step(force_n={"z": 1.0}), Step(force_n={"z": 1.0}, **given))
    one, state = pressed(Press(probe=probe, steps=steps)).path
    assert state.torques_nmm[0] == pytest.approx(-moment, rel=0.016)
    assert state.turns_deg[0] == pytest.approx(-angle, rel=0.016)
    assert state.move_mm[2] == pytest.approx(one.move_mm[2], rel=1e-6)
    assert state.move_mm[2] * punch_stiffness(2.5, 1.0, 0.5) == pytest.approx(1.0, rel=0.006)


def test_tilted_punch_converges() -> None:
    moment = math.radians(1.0) * rocking_stiffness(2.5, 1.0, 0.5)
    probe = Press(probe=Cylinder(diameter_mm=5), tilt_deg=(1, 0, 0), force_n=(0, 0, 1))
    errors = [abs(pressed(probe, across=n).torques_nmm[0] / moment - 1) for n in (8, 16, 32)]
    assert all(math.log2(a / b) > 1.1 for a, b in itertools.pairwise(errors)), errors


def test_a_steeply_tilted_punch_touches_with_its_rounded_rim() -> None:
    state = pressed(Press(probe=Cylinder(diameter_mm=5, edge_mm=1), tilt_deg=(30, 0, 0), force_n=(0, 0, 0.02)))
    # the rim's lowest place, tilted about x: y = -(1.5 cos 30 + ...) on the side that went down
    middle = only(state).force_n[:, 2] @ only(state).centre_mm / 0.02
    assert abs(middle[1]) == pytest.approx(1.5 * math.cos(math.radians(30)) + 0.5, abs=0.02)
    assert middle[0] == pytest.approx(0.0, abs=1e-9)


def test_a_stuck_ball_is_turned_about_x_like_it_is_moved() -> None:
    """Turning a stuck ball about a place on the surface moves nothing but by its turn: no force for a small contact."""
    steps = (Step(force_n={"z": 0.1}), Step(force_n={"z": 0.1}, turn_deg={"x": 0.2}))
    probe = Sphere(diameter_mm=30)
    state = pressed(Press(probe=probe, friction=math.inf, steps=steps))
    a = state.contact_radius_mm
    moment = math.radians(0.2) * rocking_stiffness(a, 1.0, 0.5)
    assert state.torques_nmm[0] == pytest.approx(moment, rel=0.02)
    assert abs(state.force_n[1]) < 0.02 * math.radians(0.2) * 15 * tangential_stiffness(a, 1.0, 0.5)


# --- the same problem, stated otherwise ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (40.0, -20.0, 70.0)])
def test_an_stl_ball_is_a_ball_however_it_is_turned(tmp_path: Path, tilt: tuple[float, float, float]) -> None:
    vertices, triangles = sphere_triangles(20.0, 120)
    # finest where it will touch once it is tilted
    turned = vertices @ shape_rotation(tilt)
    file = write_stl(tmp_path / "ball.stl", turned, triangles)
    theory = hertz(radius_mm=20.0, youngs_modulus_mpa=1.0, poisson_ratio=0.5, force_n=1.0)
    state = pressed(Press(probe=Stl(file=str(file)), tilt_deg=tilt, force_n=(0, 0, 1)), across=12)
    smooth = pressed(Press(probe=Sphere(diameter_mm=40), force_n=(0, 0, 1)), across=12)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.01)
    assert state.indentation_mm == pytest.approx(smooth.indentation_mm, rel=0.01)
    assert state.peak_pressure_mpa == pytest.approx(smooth.peak_pressure_mpa, rel=0.03)


def shape_rotation(tilt: tuple[float, float, float]) -> Floats:
    from twin.world.contact.probe_shape import tilt_of

    return tilt_of(tilt)


def round_the_barrel(angle: float, fr: float, probe: Probe) -> tuple[Floats, Floats, float]:
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    steps = (
        Step(force_n={"z": 0.3}),
        Step(force_n={"z": 0.3}, move_mm={"x": 0.02, "y": 0.03}, turn_deg={"z": 2.0, "x": 0.5}),
    )
    wanted = Press(
        probe=probe, at_mm=(-4.0, 8 * s, 8 - 8 * c), direction=(0.0, -s, c), axes="probe", friction=fr, steps=steps
    )
    state = pressed(wanted, FINGER, nu=0.45, across=10, increments=3)
    back = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return back @ state.force_n, back @ state.torques_nmm, state.indentation_mm


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("probe", [BALL, Pillar(width_mm=3, length_mm=2, edge_mm=0.4)], ids=["ball", "pillar"])
def test_a_press_turned_about_the_barrel_is_the_same_press(friction: float, probe: Probe) -> None:
    straight, turned = (round_the_barrel(angle, friction, probe) for angle in (0.0, 50.0))
    for one, other in zip(straight, turned, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-5, atol=1e-6)


def test_axes_along_a_global_axis_may_be_global() -> None:
    """On the finger's side the push is against y; in the probe's own axes it is z."""
    place = (-4.0, 8.0, 8.0)
    own = Press(probe=BALL, at_mm=place, direction="normal", axes="probe", steps=(Step(force_n={"z": 0.2}),))
    same = Press(probe=BALL, at_mm=place, direction=(0, -1, 0), steps=(Step(force_n={"y": -0.2}),))
    one, other = pressed(own, FINGER, across=8), pressed(same, FINGER, across=8)
    np.testing.assert_allclose(other.force_n, one.force_n, atol=1e-12)
    assert other.force_n[1] == pytest.approx(-0.2, abs=1e-9)
    assert only(one).centre_mm[:, 1].min() > 7.5


def test_oblique_pushes_need_axes_of_their_own() -> None:
    given = {"probe": BALL, "direction": (0.0, 0.6, 0.8)}
    with pytest.raises(RecipeError, match='axes = "probe"'):
        Press(**given, steps=(Step(force_n=(None, None, 1.0)),))
    guided = Press(**given, force_n=(0.0, 0.6, 0.8))
    assert pressed(guided, across=8).force_n[2] == pytest.approx(1 / 0.8, rel=1e-6)  # no shear without friction


def test_three_stuck_turns_superpose_on_a_face() -> None:
    """Sticking is linear: the answer to all six motions is the sum of the answers to each."""
    moves = (
        {"move_mm": {"x": 0.01}},
        {"move_mm": {"y": -0.02}},
        {"turn_deg": {"z": 0.3}},
        {"turn_deg": {"x": 0.1, "y": -0.05}},
    )
    start = Step(move_mm={"z": 0.2})
    probe = {"probe": Pillar(width_mm=4, length_mm=3), "friction": math.inf}

    def moved(*steps: Step) -> tuple[Floats, Floats]:
        state = pressed(Press(**probe, steps=(start, *steps)), nu=0.4, across=8)
        return state.force_n, state.torques_nmm

    base = moved(Step())
    alone = [moved(Step(**move)) for move in moves]
    together = moved(*(Step(**move) for move in moves))
    for part in (0, 1):
        added = base[part] + sum(one[part] - base[part] for one in alone)
        np.testing.assert_allclose(together[part], added, atol=1e-8)


# --- several probes ------------------------------------------------------------------------------------------------


def two(apart: float, **more: object) -> Press:
    def at(x: float) -> dict[str, object]:
        return {"probe": BALL, "at_mm": (x, 0.0), "force_n": (0, 0, 0.05), **more}

    return Press(**at(-apart / 2), also=(Press(**at(apart / 2)),))


@pytest.mark.parametrize("apart", [4.0, 40.0])
def test_two_points_superpose(apart: float) -> None:
    """Each is lowered by what the other's load does at its place (small contacts, far apart)."""
    alone = pressed(Press(probe=BALL, force_n=(0, 0, 0.05)), across=24)
    state = pressed(two(apart), across=24)
    sunk = halfspace.displacement(np.array([[apart, 0.0, 0.0]]), only(alone), 1.0, 0.5)[0, 2]
    assert state.indentation_mm - alone.indentation_mm == pytest.approx(sunk, rel=0.003)
    assert state.also[0].indentation_mm == pytest.approx(state.indentation_mm, rel=1e-9)
    assert len(state.load.terms) == 2
    np.testing.assert_allclose(sum(term.force_n.sum(axis=0) for term in state.load.terms), [0, 0, 0.1], atol=1e-9)


def test_two_points_are_reciprocal() -> None:
    """Betti: what a push on one does to the other held by force is what it does the other way round."""
    probes = (Cylinder(diameter_mm=1.0), Pillar(width_mm=2.0, length_mm=1.0))
    base = (0.05, 0.2)

    def places(extra: tuple[float, float]) -> list[float]:
        one, other = (
            {"probe": probe, "at_mm": (x, 0.3 * x), "force_n": (0, 0, force + more)}
            for probe, x, force, more in zip(probes, (-1.0, 1.0), base, extra, strict=True)
        )
        state = pressed(Press(**one, also=(Press(**other),)), across=10)
        return [state.indentation_mm, state.also[0].indentation_mm]

    rest = places((0.0, 0.0))
    cross = [places((0.01, 0.0))[1] - rest[1], places((0.0, 0.01))[0] - rest[0]]
    assert cross[0] == pytest.approx(cross[1], rel=1e-3)  # collocation is symmetric up to the size of a patch
    assert cross[0] > 0


def test_two_probes_with_friction_far_apart_are_two_presses() -> None:
    one = {"probe": BALL, "friction": 0.5, "steps": (Step(force_n=(0, 0, 0.05)), Step(force_n=(0.01, 0.005, 0.05)))}
    other = {"probe": Cylinder(diameter_mm=2), "friction": 0.3,
             "steps": (Step(move_mm={"z": 0.05}), Step(force_n={"z": 0.0}))}  # fmt: skip
    both = pressed(Press(**one, at_mm=(-40, 0), also=(Press(**other, at_mm=(40, 0)),)), across=8, increments=2)
    apart = pressed(Press(**one, at_mm=(-40, 0)), across=8, increments=2)
    assert both.move_mm[0] == pytest.approx(apart.move_mm[0], rel=0.02)
    np.testing.assert_allclose(both.force_n, [0.01, 0.005, 0.05], atol=1e-9)
    assert both.slip.sum() == apart.slip.sum()
    lifted, first = both.also[0], both.path[0].also[0]
    assert first.force_n[2] == pytest.approx(0.05 * punch_stiffness(1.0, 1.0, 0.5), rel=0.02)
    assert lifted.force_n.tolist() == [0.0, 0.0, 0.0]
    assert len(both.load.terms) == 1


# --- what a result says --------------------------------------------------------------------------------------------


def test_elastic_energy_of_a_ball_is_two_fifths_of_force_times_indentation() -> None:
    state = pressed(Press(probe=Sphere(diameter_mm=40), force_n=(0, 0, 0.5)))
    assert state.elastic_nmm == pytest.approx(0.4 * 0.5 * state.indentation_mm, rel=1e-3)


def test_the_error_of_the_patches_bounds_what_they_are_off() -> None:
    theory = hertz(radius_mm=20.0, youngs_modulus_mpa=1.0, poisson_ratio=0.5, force_n=0.5)
    for across in (12, 24):
        state = pressed(Press(probe=Sphere(diameter_mm=40), force_n=(0, 0, 0.5)), across=across, with_error=True)
        patches, told = only(state), state.error
        assert told is not None
        expected = theory.pressure(np.hypot(*patches.centre_mm[:, :2].T))
        weight = np.prod(patches.half_mm, axis=1)
        off = math.sqrt(float(weight @ (state.pressure_mpa - expected) ** 2) / float(weight @ expected**2))
        assert off < told.traction < 10 * off
        assert abs(state.indentation_mm / theory.indentation_mm - 1) < max(told.indentation, 5e-4)
    assert pressed(Press(probe=BALL, force_n=(0, 0, 0.1))).error is None


def test_a_step_that_does_not_converge_leaves_the_last_good_state(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = (Step(force_n=(0, 0, 0.5)), Step(force_n=(0.1, 0, 0.5)), Step(force_n=(0.2, 0, 0.5)))
    wanted = Press(probe=Sphere(diameter_mm=30), friction=0.5, steps=steps)
    whole = pressed(wanted, across=8, increments=2)
    assert whole.complete
    real = friction.solve_coulomb

    def stuck(problem: friction.Unilateral, *given: Floats) -> object:
        if problem.given[0] > 0.16:
            raise NotSettled("contact: it does not settle")
        return real(problem, *given)

    monkeypatch.setattr(friction, "solve_coulomb", stuck)
    state = pressed(wanted, across=8, increments=2)
    assert not state.complete
    assert "step 3 of 3" in state.reason
    assert "does not settle" in state.reason
    assert state.force_n[0] == pytest.approx(0.15)  # half of the step was taken
    np.testing.assert_allclose(state.path[1].force_n, whole.path[1].force_n, atol=1e-12)
    with pytest.raises(NotSettled):
        pressed(Press(probe=Sphere(diameter_mm=30), friction=0.5, force_n=(0.2, 0, 0.5)), across=8, increments=1)


def test_a_frictionless_step_that_does_not_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    real = contact.solve_frictionless

    def stuck(*given: object) -> object:
        if given[1].given[2] > 0.15:  # type: ignore[attr-defined]
            raise NotSettled("contact: it does not settle")
        return real(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(contact, "solve_frictionless", stuck)
    state = pressed(Press(probe=BALL, steps=(Step(force_n={"z": 0.1}), Step(force_n={"z": 0.2}))), across=8)
    assert (state.complete, len(state.path)) == (False, 1)
    assert state.force_n[2] == pytest.approx(0.1)


# --- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("comes from inside the body", {"direction": (0, 0, -1.0)}),
        ("inside the body", {"at_mm": (0, 0, 3.0)}),
        ("off the sensing surface", {"at_mm": (0, 0, -2.0)}),
        ("misses the sensing surface", {"at_mm": (80, 0), "direction": (0, 0.1, 1.0)}),
        ("stand|apart, less than", {"also": (Press(probe=BALL, at_mm=(1, 0), indentation_mm=0.1),)}),
    ],
)
def test_places_that_can_not_be_pressed(words: str, given: dict[str, object]) -> None:
    with pytest.raises(InputError, match=words):
        pressed(Press(probe=BALL, indentation_mm=0.1, **given))


def test_a_probe_that_meets_the_back_first_is_told() -> None:
    with pytest.raises(InputError, match="off its sensing surface"):
        pressed(
            Press(probe=Cylinder(diameter_mm=6), at_mm=(-7.5, 0, 0), direction=(1, 0, 0.1), tilt_deg=(0, 15, 0),
                  indentation_mm=0.1), FINGER,
        )  # fmt: skip


def test_a_cone_that_sinks_to_its_base_is_told() -> None:
    with pytest.raises(ContactError, match="cone's base"):
        pressed(Press(probe=Cone(apex_deg=150, diameter_mm=2), force_n=(0, 0, 2)))


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("diameter_mm = 0 mm", {"probe": {"kind": "cone", "apex_deg": 90, "diameter_mm": 0}}),
        ("edge_mm", {"probe": {"kind": "cylinder", "diameter_mm": 2, "edge_mm": 1.5}}),
        ("as wide as the base", {"probe": {"kind": "cone", "apex_deg": 90, "diameter_mm": 2, "tip_mm": 2}}),
        ("0 .frictionless. to", {"friction": -0.1}),
        ("tilt_deg", {"tilt_deg": (80, 0, 0)}),
        ("direction", {"direction": (0, 0, 0)}),
        ("direction", {"direction": (1e300, 0, 1.0)}),
        ("direction", {"direction": (0, math.nan, 1.0)}),
        ("must be greater than 0: along", {"direction": (0, -1.0, 0), "steps": (Step(force_n={"y": 1.0}),)}),
        ("as many", {"also": ({"probe": BALL, "steps": (Step(move_mm={"z": 1}), Step())},)}),
        ("both given about x", {"steps": ({"force_n": {"z": 1}, "turn_deg": {"x": 1}, "torque_nmm": {"x": 1}},)}),
        ("can't be read", {"probe": {"kind": "stl", "file": "nowhere.stl"}}),
        ("finite number", {"also": ({"probe": BALL, "at_mm": (math.nan, 0), "indentation_mm": 1},)}),
    ],
)
def test_recipes_that_are_refused(words: str, given: dict[str, object]) -> None:
    whole = {"probe": BALL} | ({} if "steps" in given else {"indentation_mm": 0.1}) | given
    with pytest.raises(RecipeError, match=words):
        Press(**whole)


def test_an_open_stl_is_refused(tmp_path: Path) -> None:
    vertices, triangles = sphere_triangles(2.0, 10)
    file = write_stl(tmp_path / "open.stl", vertices, triangles[1:])
    with pytest.raises(RecipeError, match="not watertight"):
        Stl(file=str(file))


def test_yielding_to_more_than_friction_carries_names_the_cause() -> None:
    with pytest.raises(ContactError, match=r"can carry|can be balanced"):
        press(
            Press(probe=BALL, direction="normal", friction=0.2, force_n=(0.1, 0, 0.2)), BLOCK, HalfSpace(),
            patches_across=8, youngs_modulus_mpa=1.0, poisson_ratio=0.5,
        )  # fmt: skip


@pytest.mark.parametrize("mixed", [(math.inf, 0.5), (0.5, math.inf)])
def test_a_probe_that_sticks_beside_one_that_slips(mixed: tuple[float, float]) -> None:
    """Sticking is the law with an unbounded coefficient: beside a probe that slips it is what a large one gives.

    As large as to hold the rim's patches too, which feel next to no pressure.
    """
    steps = (Step(force_n=(0, 0, 0.5)), Step(force_n=(0.1, 0.05, 0.5), torque_nmm=0.03))

    def both(frictions: tuple[float, ...]) -> ContactState:
        one, other = (
            Press(probe=Sphere(diameter_mm=6), at_mm=(x, 0), friction=mu, steps=steps)
            for x, mu in zip((-4, 4), frictions, strict=True)
        )
        return pressed(one.model_copy(update={"also": (other,)}), across=8, nu=0.3, increments=2)

    state, much = both(mixed), both(tuple(min(mu, 1e4) for mu in mixed))
    for one, other, mu in zip((state, *state.also), (much, *much.also), mixed, strict=True):
        np.testing.assert_allclose(one.move_mm, other.move_mm, rtol=1e-8)
        np.testing.assert_allclose(one.traction_mpa, other.traction_mpa, atol=1e-8)
        np.testing.assert_array_equal(one.slip, other.slip)
        assert one.slip.any() == (mu == 0.5)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_refused_step_leaves_the_states_before_it(friction: float) -> None:
    wanted = Press(
        probe=Sphere(diameter_mm=4),
        friction=friction,
        steps=(Step(force_n={"z": 0.1}), Step(move_mm=(None, None, 2.5))),
    )
    with pytest.raises(ContactError, match="sinks in") as refused:
        pressed(wanted, across=8, increments=2)
    state = refused.value.last_state
    assert isinstance(state, ContactState)
    assert not state.complete
    assert "step 2 of 2" in state.reason
    assert state.force_n[2] == pytest.approx(0.1)
    assert len(state.path) == 1
    with pytest.raises(ContactError, match="sinks in") as refused:
        pressed(Press(probe=Sphere(diameter_mm=4), friction=friction, indentation_mm=2.5), across=8, increments=2)
    assert refused.value.last_state is None


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1e-101, 1e-99])
def test_a_turn_next_to_nothing_turns_nothing(size: float) -> None:
    turn = np.array([size, 0.0, -size])
    np.testing.assert_allclose(rotation_of(turn), np.eye(3), atol=1e-15)
    np.testing.assert_allclose(turning_of(turn), np.eye(3), atol=1e-15)
