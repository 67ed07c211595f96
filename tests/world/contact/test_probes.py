"""Probes of every shape, from every side, moved in all ways, and several at once."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from presses import STUCK, ball, centre_of, down, hull, only, patch_areas, pressed, punch, push, pushed, radii_of
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from standard_bodies import BLOCK, FINGER, write_stl

from benchmarks.contact_theory import cone_indentation, punch_stiffness, rocking_stiffness, tangential_stiffness
from twin.errors import ContactError, NotSettled, RecipeError
from twin.parts.material import plane_strain_modulus
from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere, Step, Stl
from twin.theory import halfspace
from twin.theory.contact import cone_contact_radius, hertz
from twin.world.contact import load_step, pressing
from twin.world.contact.pressing import ContactState
from twin.world.contact.probe_gap import RIM, Approach

UPRIGHT = (0.0, 0.0, 0.0)


def sphere_triangles(radius, across):
    """A ball whose triangles are finest at +z."""
    points = [[0.0, 0.0, radius], [0.0, 0.0, -radius]]
    for angle in math.pi * (np.arange(1, across) / across) ** 1.7:
        count = max(48, round(70 * math.sin(angle)))
        turn = 2 * math.pi * (np.arange(count) + 0.3) / count
        across_axis = math.sin(angle) * np.array([np.cos(turn), np.sin(turn)])
        ring = np.column_stack([*across_axis, np.full(count, math.cos(angle))])
        points += (radius * ring).tolist()
    return hull(np.array(points))


SHAPES = {
    "sphere": Sphere(diameter_mm=3),
    "cylinder": Cylinder(diameter_mm=4, edge_mm=0.7),
    "pillar": Pillar(width_mm=3, length_mm=5, edge_mm=0.5),
    "cone": Cone(apex_deg=120, diameter_mm=6),
    "round cone": Cone(apex_deg=90, diameter_mm=6, tip_mm=0.8),
    "face": Pillar(width_mm=3),
}


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("tilt", [UPRIGHT, (12.0, -8.0, 30.0)])
def test_slopes_are_the_derivatives_of_gaps(name, tilt):
    rng = np.random.default_rng(3)
    frame = Press.frame_of((0.2, -0.1, 1.0))
    there = Approach.of(SHAPES[name], BLOCK, np.array([1.0, 2.0]), frame, tilt)
    points = there.touch_mm + rng.normal(scale=0.4, size=(90, 3)) * [1, 1, 0.1]
    normals = np.array([0.0, 0.0, 1.0]) + 0.1 * rng.normal(size=(90, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    place = np.array([0.1, -0.05, 0.2, 0.06, -0.04, 0.3])
    gap, slope = there.gap(points, normals, place)
    met = np.isfinite(gap)
    assert met.sum() > 8
    for component, step in enumerate(1e-6 * np.eye(6)):
        ahead, behind = (there.gap(points, normals, place + s * step)[0][met] for s in (1, -1))
        assert_allclose(slope[met, component], (ahead - behind) / 2e-6, atol=2e-5)


def shape_of(probe):
    return Approach(probe=probe, axis_mm=np.zeros(3), touch_mm=np.zeros(3), axes=np.eye(3)).shape


def test_round_shapes_meet_lines_where_balls_around_their_cores_do():
    """A rounded cylinder whose edge is its radius is a ball with a shaft, a cone's tip a ball."""
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 3))
    along = np.tile([0.0, 0.0, 1.0], (50, 1))
    sphere = shape_of(Sphere(diameter_mm=2)).met(points, along)
    rounded = Cylinder(diameter_mm=2, edge_mm=1.0)
    for probe in (rounded, Cone(apex_deg=60, diameter_mm=6, tip_mm=1.0)):
        distance, normal = shape_of(probe).met(points, along)
        assert_allclose(distance, sphere[0], atol=1e-12)
        assert_allclose(normal, sphere[1], atol=1e-10)
    at_rim = np.array([[RIM - 1e-3, 0, 0], [RIM + 1e-3, 0, 0]])
    flat, _ = shape_of(Cylinder(diameter_mm=2)).met(at_rim, along[:2])
    assert np.isfinite(flat).tolist() == [True, False]


def test_rotation_vectors():
    rotation = Approach.rotation_of(np.array([0.3, -0.7, 0.5]))
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1e-101, 1e-99])
def test_a_turn_next_to_nothing_turns_nothing(size):
    turn = np.array([size, 0.0, -size])
    assert_allclose(Approach.rotation_of(turn), np.eye(3), atol=1e-15)
    here = Approach.of(Sphere(diameter_mm=3), BLOCK, np.zeros(2))
    still, turned = (here.gap(np.zeros((1, 3)), np.eye(3)[2:], np.array([0, 0, 0, *t])) for t in (0 * turn, turn))
    for one, other in zip(turned, still, strict=True):
        assert_allclose(one, other, atol=1e-15)


def test_cone():
    """Love and Sneddon."""
    slope = math.tan(math.radians(15))
    radius = cone_contact_radius(0.05, 150.0, 1.0, 0.5)
    state = pressed(Press(probe=Cone(apex_deg=150, diameter_mm=10), force_n=(0, 0, 0.05)))
    assert state.contact_radius_mm == pytest.approx(radius, rel=0.01)
    assert state.indentation_mm == pytest.approx(cone_indentation(radius, 150.0), rel=0.002)
    assert state.validity.steepest_slope == pytest.approx(slope, rel=1e-6)
    assert state.validity.linear is False
    distance = radii_of(state)
    middle = (distance > 0.2 * radius) & (distance < 0.85 * radius)
    peak = 0.5 * plane_strain_modulus(1.0, 0.5) * slope
    theory = peak * np.arccosh(radius / distance[middle])
    assert_allclose(state.pressure_mpa[middle], theory, atol=0.03 * theory.max())


def axisymmetric(slope_at, force, largest):
    """Contact radius and indentation of any body of revolution (Sneddon 1965); E* = 4/3."""

    def depth(a):
        return a * quad(lambda t: slope_at(a * math.sin(t)), 0, math.pi / 2, limit=200)[0]

    def lacking(a):
        return 2 * 4 / 3 * (a * depth(a) - quad(depth, 0, a, limit=60)[0]) - force

    radius = brentq(lacking, 1e-3, largest, xtol=1e-6)
    return radius, depth(radius)


@pytest.mark.parametrize("depth", [0.5, 1.0, 1.5, 2.4])
def test_deep_sphere_is_as_wide_as_sneddons(depth):
    """a/R = 0.31 to 0.64, where the squared pressure is no quadratic of the place: that would be 0.7 to 4 % off."""
    radius = brentq(lambda a: a / 2 * math.log((5 + a) / (5 - a)) - depth, 0.1, 4.9)
    state = pressed(Press(probe=Sphere(diameter_mm=10), indentation_mm=depth))
    assert state.contact_radius_mm == pytest.approx(radius, rel=0.01)


@pytest.mark.parametrize("edge", [0.3, 1.0])
def test_rounded_punch(edge):
    """A flat middle and a rim that is a quarter of a torus."""
    flat = 2.5 - edge

    def slope(r):
        return max(r - flat, 0.0) / math.sqrt(max(edge**2 - max(r - flat, 0.0) ** 2, 1e-12))

    radius, depth = axisymmetric(slope, 0.5, 2.499)
    rounded = Press(probe=Cylinder(diameter_mm=5, edge_mm=edge), force_n=(0, 0, 0.5))
    state = pressed(rounded, across=28)
    assert state.indentation_mm == pytest.approx(depth, rel=0.002)
    assert state.contact_radius_mm == pytest.approx(radius, rel=0.05)  # counted in patches
    assert (radii_of(state) < flat / 2).any()
    assert state.peak_pressure_mpa < 0.7 * pressed(punch(5, force_n=(0, 0, 0.5))).peak_pressure_mpa


ROCKING = math.radians(1.0) * rocking_stiffness(2.5, 1.0, 0.5)


@pytest.mark.parametrize("given", [{"turn_deg": {"x": -1.0}}, {"torque_nmm": {"x": -ROCKING}}])
def test_a_punch_tilted_by_turn_or_torque(given):
    """A moment of 4/3 E* a^3 per radian, without changing the indentation."""
    one, state = pressed(punch(5, steps=(push(1.0), push(1.0, **given)))).path
    assert state.torques_nmm[0] == pytest.approx(-ROCKING, rel=0.016)
    assert state.turns_deg[0] == pytest.approx(-1.0, rel=0.016)
    assert state.move_mm[2] == pytest.approx(one.move_mm[2], rel=1e-6)
    assert state.move_mm[2] * punch_stiffness(2.5, 1.0, 0.5) == pytest.approx(1.0, rel=0.006)


def test_tilted_punch_converges():
    probe = punch(5, tilt_deg=(1, 0, 0), force_n=(0, 0, 1))
    errors = [abs(pressed(probe, across=n).torques_nmm[0] / ROCKING - 1) for n in (8, 16, 32)]
    assert all(math.log2(a / b) > 1.1 for a, b in pairwise(errors)), errors


def test_a_steeply_tilted_punch_touches_with_its_rounded_rim():
    probe = Cylinder(diameter_mm=5, edge_mm=1)
    state = pressed(Press(probe=probe, tilt_deg=(30, 0, 0), force_n=(0, 0, 0.02)))
    x, y, _ = centre_of(state)  # the rim's lowest place, on the side that went down
    assert abs(y) == pytest.approx(1.5 * math.cos(math.radians(30)) + 0.5, abs=0.02)
    assert x == pytest.approx(0.0, abs=1e-9)


def test_a_stuck_ball_is_turned_about_x_like_it_is_moved():
    """Turning a stuck ball about a place on the surface gives no force for a small contact."""
    steps = (push(0.1), push(0.1, turn_deg={"x": 0.2}))
    state = pressed(ball(30, friction=STUCK, steps=steps))
    a, turn = state.contact_radius_mm, math.radians(0.2)
    assert state.torques_nmm[0] == pytest.approx(turn * rocking_stiffness(a, 1.0, 0.5), rel=0.02)
    assert abs(state.force_n[1]) < 0.02 * turn * 15 * tangential_stiffness(a, 1.0, 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [UPRIGHT, (40.0, -20.0, 70.0)])
def test_an_stl_ball_is_a_ball_however_it_is_turned(tmp_path, tilt):
    vertices, triangles = sphere_triangles(20.0, 120)
    # finest where it will touch once it is tilted
    turned = vertices @ Rotation.from_euler("xyz", tilt, degrees=True).as_matrix()
    file = write_stl(tmp_path / "ball.stl", turned[triangles])
    theory = hertz(radius_mm=20, youngs_modulus_mpa=1, poisson_ratio=0.5, force_n=1)
    load = {"force_n": (0, 0, 1)}
    state = pressed(Press(probe=Stl(file=str(file)), tilt_deg=tilt, **load), across=12)
    smooth = pressed(ball(40, **load), across=12)
    assert state.indentation_mm == pytest.approx(theory.indentation_mm, rel=0.01)
    assert state.indentation_mm == pytest.approx(smooth.indentation_mm, rel=0.01)
    assert state.peak_pressure_mpa == pytest.approx(smooth.peak_pressure_mpa, rel=0.03)


def round_the_barrel(angle, friction, probe):
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    moved = push(0.3, move_mm={"x": 0.02, "y": 0.03}, turn_deg={"z": 2.0, "x": 0.5})
    wanted = Press(
        probe=probe,
        at_mm=(-4.0, 8 * s, 8 - 8 * c),
        direction=(0.0, -s, c),
        axes="probe",
        friction=friction,
        steps=(push(0.3), moved),
    )
    state = pressed(wanted, FINGER, nu=0.45, across=10, increments=3)
    back = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return back @ state.force_n, back @ state.torques_nmm, state.indentation_mm


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("probe", [Sphere(diameter_mm=3), Pillar(width_mm=3, length_mm=2, edge_mm=0.4)])
def test_a_press_turned_about_the_barrel_is_the_same_press(friction, probe):
    straight, turned = (round_the_barrel(angle, friction, probe) for angle in (0.0, 50.0))
    for one, other in zip(straight, turned, strict=True):
        assert_allclose(other, one, rtol=1e-5, atol=1e-6)


def test_axes_along_a_global_axis_may_be_global():
    """On the finger's side the push is against y; in the probe's own axes it is z."""
    at = {"at_mm": (-4.0, 8.0, 8.0)}
    own = ball(3, **at, direction="normal", axes="probe", steps=(push(0.2),))
    same = ball(3, **at, direction=(0, -1, 0), steps=(Step(force_n={"y": -0.2}),))
    one, other = (pressed(wanted, FINGER, across=8) for wanted in (own, same))
    assert_allclose(other.force_n, one.force_n, atol=1e-12)
    assert other.force_n[1] == pytest.approx(-0.2, abs=1e-9)
    assert only(one).centre_mm[:, 1].min() > 7.5


def test_oblique_pushes_need_axes_of_their_own():
    oblique = {"direction": (0.0, 0.6, 0.8)}
    with pytest.raises(RecipeError, match='axes = "probe"'):
        ball(3, **oblique, steps=(Step(force_n=(None, None, 1.0)),))
    state = pressed(ball(3, **oblique, force_n=(0.0, 0.6, 0.8)), across=8)
    assert state.force_n[2] == pytest.approx(1 / 0.8, rel=1e-6)  # no shear without friction


def test_three_stuck_turns_superpose_on_a_face():
    """Sticking is linear: the answer to all six motions is the sum of the answers to each."""
    moves = (
        {"move_mm": {"x": 0.01}},
        {"move_mm": {"y": -0.02}},
        {"turn_deg": {"z": 0.3}},
        {"turn_deg": {"x": 0.1, "y": -0.05}},
    )
    probe = Pillar(width_mm=4, length_mm=3)

    def moved(*given):
        steps = (Step(move_mm={"z": 0.2}), *(Step(**move) for move in given))
        state = pressed(Press(probe=probe, friction=STUCK, steps=steps), nu=0.4, across=8)
        return np.concatenate([state.force_n, state.torques_nmm])

    base = moved({})
    added = base + sum(moved(move) - base for move in moves)
    assert_allclose(moved(*moves), added, atol=1e-8)


@pytest.mark.parametrize("apart", [4.0, 40.0])
def test_two_points_superpose(apart):
    """Each is lowered by what the other's load does at its place (small contacts, far apart)."""
    one, other = (ball(3, at_mm=(x, 0.0), force_n=(0, 0, 0.05)) for x in (-apart / 2, apart / 2))
    alone = pressed(ball(3, force_n=(0, 0, 0.05)), across=24)
    state = pressed(one.model_copy(update={"also": (other,)}), across=24)
    there = np.array([[apart, 0.0, 0.0]])
    lowered = halfspace.displacement(there, only(alone), 1.0, 0.5)[0, 2]
    assert state.indentation_mm - alone.indentation_mm == pytest.approx(lowered, rel=0.003)
    assert state.also[0].indentation_mm == pytest.approx(state.indentation_mm, rel=1e-9)
    assert len(state.load.terms) == 2
    total = sum(term.force_n.sum(axis=0) for term in state.load.terms)
    assert_allclose(total, [0, 0, 0.1], atol=1e-9)


def test_two_probes_with_friction_far_apart_are_two_presses():
    steps = (Step(force_n=(0, 0, 0.05)), Step(force_n=(0.01, 0.005, 0.05)))
    alone = ball(3, friction=0.5, steps=steps, at_mm=(-40, 0))
    lifting = (Step(move_mm={"z": 0.05}), push(0.0))
    other = punch(2, friction=0.3, steps=lifting, at_mm=(40, 0))
    both = pressed(alone.model_copy(update={"also": (other,)}), across=8, increments=2)
    apart = pressed(alone, across=8, increments=2)
    assert both.move_mm[0] == pytest.approx(apart.move_mm[0], rel=0.02)
    assert_allclose(both.force_n, [0.01, 0.005, 0.05], atol=1e-9)
    assert both.slip.sum() == apart.slip.sum()
    lifted, first = both.also[0], both.path[0].also[0]
    assert first.force_n[2] == pytest.approx(0.05 * punch_stiffness(1.0, 1.0, 0.5), rel=0.02)
    assert lifted.force_n.tolist() == [0.0, 0.0, 0.0]
    assert len(both.load.terms) == 1


@pytest.mark.parametrize("mixed", [(STUCK, 0.5), (0.5, STUCK)])
def test_a_probe_that_sticks_beside_one_that_slips(mixed):
    """Sticking is the law with an unbounded coefficient: beside a slipping probe, a large one's.

    As large as to hold the rim's patches too, which carry next to no pressure.
    """
    steps = (pushed(), pushed(0.1, 0.05, torque=0.03))

    def both(*frictions):
        one, other = (ball(6, at_mm=(x, 0), friction=mu, steps=steps) for x, mu in zip((-4, 4), frictions, strict=True))
        wanted = one.model_copy(update={"also": (other,)})
        return pressed(wanted, across=8, nu=0.3, increments=2)

    state, much = both(*mixed), both(*(min(mu, 999.0) for mu in mixed))
    for one, other, mu in zip((state, *state.also), (much, *much.also), mixed, strict=True):
        assert_allclose(one.move_mm, other.move_mm, rtol=1e-8)
        assert_allclose(one.traction_mpa, other.traction_mpa, atol=1e-8)
        assert_array_equal(one.slip, other.slip)
        assert one.slip.any() == (mu == 0.5)


@pytest.mark.parametrize("across", [12, 24])
def test_the_error_of_the_patches_bounds_what_they_are_off(across):
    theory = hertz(radius_mm=20, youngs_modulus_mpa=1, poisson_ratio=0.5, force_n=0.5)
    state = pressed(ball(40, force_n=(0, 0, 0.5)), across=across)
    expected, weight = theory.pressure(radii_of(state)), patch_areas(state)
    off = math.sqrt(weight @ (state.pressure_mpa - expected) ** 2 / (weight @ expected**2))
    assert off < state.error.traction < 10 * off
    wrong = abs(state.indentation_mm / theory.indentation_mm - 1)
    assert wrong < max(state.error.indentation, 5e-4)


def test_a_step_that_does_not_converge_leaves_the_last_good_state(monkeypatch):
    steps = tuple(pushed(x) for x in (0.0, 0.1, 0.2))
    wanted = ball(30, friction=0.5, steps=steps)
    whole = pressed(wanted, across=8, increments=2)
    assert whole.complete
    real = load_step.solve_coulomb

    def stuck(problem, *given):
        if problem.given[0] > 0.16:
            raise NotSettled("contact: it does not settle")
        return real(problem, *given)

    monkeypatch.setattr(load_step, "solve_coulomb", stuck)
    state = pressed(wanted, across=8, increments=2)
    assert not state.complete
    assert "step 3 of 3" in state.reason
    assert "does not settle" in state.reason
    assert state.force_n[0] == pytest.approx(0.15)  # half of the step was taken
    assert_allclose(state.path[1].force_n, whole.path[1].force_n, atol=1e-12)
    with pytest.raises(NotSettled):
        pressed(ball(30, friction=0.5, force_n=(0.2, 0, 0.5)), across=8, increments=1)


def test_a_frictionless_step_that_does_not_converge(monkeypatch):
    real = pressing.solve_frictionless

    def stuck(*given):
        if given[1].given[2] > 0.15:
            raise NotSettled("contact: it does not settle")
        return real(*given)

    monkeypatch.setattr(pressing, "solve_frictionless", stuck)
    state = pressed(ball(3, steps=(push(0.1), push(0.2))), across=8)
    assert (state.complete, len(state.path)) == (False, 1)
    assert state.force_n[2] == pytest.approx(0.1)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_refused_step_leaves_the_states_before_it(friction):
    wanted = ball(4, friction=friction, steps=(push(0.1), down(2.5)))
    with pytest.raises(ContactError, match="sinks in") as refused:
        pressed(wanted, across=8, increments=2)
    state = refused.value.last_state
    assert isinstance(state, ContactState)
    assert not state.complete
    assert "step 2 of 2" in state.reason
    assert state.force_n[2] == pytest.approx(0.1)
    assert len(state.path) == 1
    with pytest.raises(ContactError, match="sinks in") as refused:
        pressed(ball(4, friction=friction, indentation_mm=2.5), across=8, increments=2)
    assert refused.value.last_state is None


AWAY = {"direction": (0, -1.0, 0), "steps": (Step(force_n={"y": 1.0}),)}
TWICE = {"force_n": {"z": 1}, "turn_deg": {"x": 1}, "torque_nmm": {"x": 1}}
TWO_STEPS = {"probe": SHAPES["sphere"], "steps": (Step(move_mm={"z": 1}), Step())}
NOWHERE = {"probe": SHAPES["sphere"], "at_mm": (math.nan, 0), "indentation_mm": 1}


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
        ("must be greater than 0: along", AWAY),
        ("as many", {"also": (TWO_STEPS,)}),
        ("both given about x", {"steps": (TWICE,)}),
        ("can't be read", {"probe": {"kind": "stl", "file": "nowhere.stl"}}),
        ("finite number", {"also": (NOWHERE,)}),
    ],
)
def test_recipes_that_are_refused(words, given):
    path = {} if "steps" in given else {"indentation_mm": 0.1}
    with pytest.raises(RecipeError, match=words):
        Press(**{"probe": SHAPES["sphere"], **path, **given})
