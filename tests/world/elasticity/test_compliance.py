"""Compliance against converged solutions of an independent program, and against its own symmetries."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError, OutOfBodyError
from twin.parts.body import Block, Finger
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import FEW, Compliance
from twin.world.elasticity.known import REMEMBERED
from twin.world.elasticity.solve import factorisations
from twin.world.elasticity.table import MANY_LOADS
from twin.world.elasticity.tile import join, tile

REFERENCE = Path(__file__).parents[2] / "reference"
FILES = {"block": "block_converged", "finger": "finger"}
BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
BODIES = {"block": BLOCK, "finger": FINGER}
BOUND = {
    ("block", "standard"): 4e-4,
    ("block", "nominal"): 8e-4,
    ("finger", "sketch"): 3e-3,
    ("finger", "standard"): 2e-3,
    ("finger", "nominal"): 3e-3,
    ("finger", "fine"): 1e-3,
}
TRUTH = {name: np.load(REFERENCE / f"{file}.npz") for name, file in FILES.items()}
CASES = {name: json.loads(str(truth["cases"])) for name, truth in TRUTH.items()}


@cache
def compliance(name, level, nu, method="subtracted"):
    """Return one shared compliance each, so that the tests factor every matrix once; tables have their own tests."""
    material = Material(youngs_modulus_mpa=0.5, poisson_ratio=nu)
    return Compliance(BODIES[name], material, level=level, method=method, table=False)


def reference_error(name, level, case, method="subtracted"):
    data = TRUTH[name]
    words = dict(case["load"])
    load = getattr(Traction, words.pop("kind"))(**words)
    body = BODIES[name]
    got = compliance(name, level, case["nu"], method).displacement(data["points"], tile(load, body))
    expected = data[case["key"]]
    return np.linalg.norm(got - expected, axis=1).max() / np.linalg.norm(expected, axis=1).max()


QUICK = [("block", "nominal", 0), ("block", "nominal", 3), ("finger", "nominal", 2), ("finger", "sketch", 1)]


@pytest.mark.parametrize(("name", "level", "index"), QUICK)
def test_reference_quick(name, level, index):
    assert reference_error(name, level, CASES[name][index]) < BOUND[name, level]


@pytest.mark.slow
@pytest.mark.parametrize("level", ["standard", "nominal"])
@pytest.mark.parametrize(("name", "case"), [(n, c) for n, cases in CASES.items() for c in cases])
def test_reference_all(name, level, case):
    assert reference_error(name, level, case) < BOUND[name, level]


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1, 2, 3, 4])
def test_a_tenth_of_a_percent_is_reached_on_the_finger(index):
    assert reference_error("finger", "fine", CASES["finger"][index]) < BOUND["finger", "fine"]


def estimate_ratio(stiff, name, case):
    """Return the estimated over the true error, and the true one."""
    data, words = TRUTH[name], dict(case["load"])
    tiles = tile(getattr(Traction, words.pop("kind"))(**words), stiff.body)
    wrong = np.linalg.norm(stiff.displacement(data["points"], tiles) - data[case["key"]], axis=1).max()
    error = wrong / np.linalg.norm(data[case["key"]], axis=1).max()
    return stiff.error_estimate(data["points"], tiles) / error, error


@pytest.mark.slow
@pytest.mark.parametrize("level", ["nominal", "sketch", "coarse", "standard"])
@pytest.mark.parametrize("name", ["block", "finger"])
def test_estimate_is_one_to_three_times_the_true_error(name, level):
    made = {}
    for case in CASES[name]:
        if case["nu"] not in made:
            material = Material(youngs_modulus_mpa=0.5, poisson_ratio=case["nu"])
            made[case["nu"]] = Compliance(BODIES[name], material, level=level, table=False)
        ratio, error = estimate_ratio(made[case["nu"]], name, case)
        assert 1.0 < ratio < 3.0, (case["key"], error)


@pytest.mark.slow
def test_on_the_flank_where_levels_err_alike_the_estimate_is_still_above_the_error():
    """Beside the line where cylinder meets sphere two levels' answers differ by less than either is wrong."""
    points = TRUTH["finger"]["points"]
    load = tile(Traction.bump((0.4, -4.1), 1.0, (0, 1, 0)), BODIES["finger"])
    right = compliance("finger", "fine", 0.5).displacement(points, load)
    for level in ("coarse", "standard"):
        got, told = compliance("finger", level, 0.5).answer(points, load)
        error = np.linalg.norm(got - right, axis=1).max() / np.linalg.norm(right, axis=1).max()
        assert 1.0 < told / error < 3.0


@pytest.mark.parametrize("case", CASES["block"], ids=lambda case: case["key"])
def test_table_knows_its_error_to_a_factor_of_three_and_factors_nothing(case):
    """The truth's table is 1.4e-5 to 4.3e-5 off, which only a truth that is good to 3e-6 can tell."""
    before = factorisations()
    material = Material(youngs_modulus_mpa=0.5, poisson_ratio=case["nu"])
    ratio, error = estimate_ratio(Compliance(BLOCK, material), "block", case)
    assert error < 5e-5
    assert 1.0 < ratio < 3.0
    nominal, _ = estimate_ratio(Compliance(BLOCK, material, level="nominal"), "block", case)
    assert 1.0 < nominal < 3.0
    assert factorisations() == before


@pytest.mark.slow
def test_finest_mesh_knows_its_error_to_a_factor_of_three():
    stiff = Compliance(BLOCK, Material(youngs_modulus_mpa=0.5, poisson_ratio=0.49), level="fine", table=False)
    for case in CASES["block"]:
        if case["nu"] == 0.49:
            ratio, error = estimate_ratio(stiff, "block", case)
            assert error < 6e-5
            assert 1.0 < ratio < 3.0, (case["key"], error)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 2])
def test_plain_taylor_hood_agrees_where_the_mesh_resolves_the_load(axis):
    """Without the half-space the mesh has to carry the load itself: a wide bump agrees, a narrow one less."""
    points = TRUTH["finger"]["points"]
    for radius, bound in ((4.0, 0.01), (2.0, 0.03)):
        tiles = tile(Traction.bump((0, 0), radius, tuple(np.eye(3)[axis])), FINGER)
        one, other = (
            compliance("finger", "standard", 0.5, method).displacement(points, tiles)
            for method in ("direct", "subtracted")
        )
        assert np.abs(one - other).max() < bound * np.abs(other).max()


def test_second_press_factors_nothing_and_moving_markers_neither():
    stiff = compliance("finger", "nominal", 0.5)
    points = np.array([[0.0, 0.0, 2.0], [1.0, 1.0, 3.0]])
    stiff.displacement(points, tile(Traction.bump((0, 0), 1.0, (0, 0, 1)), FINGER))
    before = factorisations()
    stiff.displacement(points, tile(Traction.bump((1, 1), 1.0, (0.2, 0, 1)), FINGER))
    stiff.displacement(points + 0.5, tile(Traction.bump((1, 1), 1.0, (0.2, 0, 1)), FINGER))
    assert factorisations() == before


@pytest.mark.parametrize(("name", "at"), [("block", (2.0, 1.0)), ("finger", (1.0, 0.5))])
def test_superposition_modulus_and_gradient(name, at):
    body, stiff = BODIES[name], compliance(name, "nominal", 0.5)
    rng = np.random.default_rng(4)
    points = body.chart_points(rng.uniform(-4, 4, (12, 2)), depth_mm=1.5)
    one = tile(Traction.rectangle(at, (0.5, 0.5), (0.2, 0.1, 1)), body, 0.25)
    two = tile(Traction.rectangle((-1.0, -2.0), (0.5, 0.5), (0, 1, 0)), body, 0.25)
    both = stiff.displacement(points, join([one, two]))
    parts = stiff.displacement(points, one) + stiff.displacement(points, two)
    np.testing.assert_allclose(both, parts, atol=2e-3 * np.abs(both).max())
    softer = Compliance(body, Material(youngs_modulus_mpa=0.25), stiff.mesh, level="nominal", table=False)
    softer.__dict__["system"] = stiff.system
    np.testing.assert_allclose(softer.displacement(points, one), 2 * stiff.displacement(points, one), rtol=1e-12)
    step = 1e-4
    slopes = [
        (stiff.displacement(points + step * e, one) - stiff.displacement(points - step * e, one)) / (2 * step)
        for e in np.eye(3)
    ]
    gradient = stiff.gradient(points, one)
    np.testing.assert_allclose(gradient, np.stack(slopes, axis=-1), atol=0.01 * np.abs(gradient).max())
    matrix = stiff.to_points(points, one)
    np.testing.assert_allclose(
        (matrix @ one.force_n.ravel()).reshape(-1, 3), stiff.displacement(points, one), atol=5e-3 * np.abs(both).max()
    )


def test_mirror_symmetry_of_the_block():
    stiff = compliance("block", "nominal", 0.5)
    points = np.random.default_rng(6).uniform([-15, -12, 0.5], [15, 12, 9], (30, 3))
    flip = np.array([-1.0, 1.0, 1.0])
    here = stiff.displacement(points, tile(Traction.rectangle((5, 3), (2, 4), (0.5, 0.2, 1)), BLOCK))
    there = stiff.displacement(points * flip, tile(Traction.rectangle((-5, 3), (2, 4), (-0.5, 0.2, 1)), BLOCK))
    np.testing.assert_allclose(there * flip, here, atol=3e-3 * np.abs(here).max())


def test_contact_compliance_is_symmetric_positive_and_interpolated_well():
    stiff = compliance("finger", "nominal", 0.5)
    patches = tile(Traction.rectangle((1.0, 0.5), (2.0, 2.0), (0, 0, 1)), FINGER, 0.2)
    matrix = stiff.surface(patches)
    assert stiff.asymmetry < 0.02
    assert np.linalg.eigvalsh(matrix).min() > 0
    pressed = (matrix @ patches.force_n.ravel()).reshape(-1, 3)
    whole = stiff.displacement(patches.centre_mm, patches)
    np.testing.assert_allclose(pressed, whole, atol=0.01 * np.abs(whole).max())


def test_points_outside_and_loads_off_the_surface_are_refused():
    stiff = compliance("block", "nominal", 0.5)
    load = tile(Traction.rectangle((0, 0), (2, 2), (0, 0, 1)), BLOCK)
    with pytest.raises(OutOfBodyError, match="point 1"):
        stiff.displacement(np.array([[0.0, 0, 1], [0, 0, -0.1]]), load)
    sunk = Rectangles(
        centre_mm=load.centre_mm + np.array([0, 0, 1.0]), frames=load.frames, half_mm=load.half_mm, force_n=load.force_n
    )
    with pytest.raises(InputError, match="not on the sensing surface"):
        stiff.displacement(np.array([[0.0, 0, 1]]), sunk)


def mirror_error(name, level, centre, size, flip):
    """Return how far the answer is from the answer of the mirrored load, over axes and deep and shallow points."""
    body, stiff, flip = BODIES[name], compliance(name, level, 0.5), np.array(flip)
    place = body.chart_points(np.array([centre], float))[0]
    around = np.stack(np.meshgrid([-3, -1, 0, 1, 3], [-3, -1, 0, 1, 3]), axis=-1).reshape(-1, 2) + centre
    points = np.vstack([body.chart_points(around, depth) for depth in (0.5, 3.0)])
    points, error = points[body.contains(points, 0.3)], 0.0
    for force in np.eye(3):
        load, mirrored = (
            tile(Traction.rectangle(tuple(place * m), (size, size), tuple(force * m)), body) for m in (1, flip)
        )
        here, there = stiff.displacement(points, load), stiff.displacement(points * flip, mirrored) * flip
        error = max(error, np.linalg.norm(here - there, axis=1).max() / np.linalg.norm(here, axis=1).max())
    return error, stiff.expected_error(load)


EDGES = [("block", (40, 0), 4, (-1, 1, 1)), ("block", (45, 0), 4, (-1, 1, 1)), ("block", (0, 38), 4, (1, -1, 1)),
         ("finger", (-6, 4), 1, (1, -1, 1)), ("finger", (-6.5, 2), 1, (1, -1, 1))]  # fmt: skip


@pytest.mark.parametrize(("name", "centre", "size", "flip"), EDGES)
def test_expected_error_covers_the_mirror_error_near_edges(name, centre, size, flip):
    error, estimate = mirror_error(name, "nominal", centre, size, flip)
    assert error < estimate < 20 * error


def test_expected_error_grows_towards_edges_and_is_the_measured_bound_inside():
    def estimate(name, level, centre, size=1.0):
        load = Traction.rectangle(tuple(BODIES[name].chart_points(np.array([centre]))[0]), (size, size), (0, 0, 1))
        return compliance(name, level, 0.5).expected_error(tile(load, BODIES[name]))

    assert estimate("block", "standard", (0.0, 0.0), 4.0) == pytest.approx(4e-4)
    assert estimate("finger", "standard", (0.0, 0.0)) == pytest.approx(4e-3)
    growing = [estimate("block", "standard", (x, 0.0), 4.0) for x in (20.0, 35.0, 40.0, 45.0)]
    assert growing == sorted(growing)
    assert growing[-1] > 0.05


def test_next_to_the_clamped_rim_there_is_no_bound_and_estimates_say_so():
    """The rim is at z = 10; the barrel's skirt begins at z = 8, where a load is 2 mm from it and has a bound."""

    def pressed(z):
        load = Traction.rectangle((-3.0, -8.0, z), (0.4, 0.4), (0, 0.2, 0))
        return tile(load, BODIES["finger"])

    stiff, points = compliance("finger", "nominal", 0.5), np.array([[-3.0, -7.5, 8.5]])
    assert stiff.expected_error(pressed(8.3)) < 0.1
    assert stiff.error_estimate(points, pressed(8.3)) < 0.1
    for z in (9.3, 9.7):
        assert stiff.expected_error(pressed(z)) > 1.0
        assert stiff.error_estimate(points, pressed(z)) > 1.0


@pytest.mark.parametrize("name", ["block", "finger"])
def test_no_points_give_no_displacements(name):
    body, material = BODIES[name], Material(youngs_modulus_mpa=0.5)
    load, nowhere = tile(Traction.bump((0, 0), 1.0, (0, 0, 1)), body), np.zeros((0, 3))
    for stiff in (Compliance(body, material), compliance(name, "nominal", 0.5)):
        assert stiff.error_estimate(nowhere, load) == 0.0
        assert stiff.displacement(nowhere, load).shape == (0, 3)
        assert stiff.gradient(nowhere, load).shape == (0, 3, 3)
        assert stiff.to_points(nowhere, load).shape == (0, 3 * len(load))


@pytest.mark.slow
def test_adjoint_and_primal_solves_agree_and_few_points_take_the_adjoint(monkeypatch):
    """Two points and nine separate patches: three solves a point give what three solves a patch give."""
    few, body = np.array([[0.0, 0.5, 1.5], [-1.0, 1.0, 3.0]]), FINGER
    apart = tile(Traction.rectangle((0, 0), (6.0, 6.0), (0, 0, 1)), body, 2.0)
    stiff = compliance("finger", "nominal", 0.5)
    assert len(apart) > FEW * len(few)
    by_point = stiff.to_points(few, apart)
    assert stiff._memory.of(few).readings is not None
    others = few + np.array([0.0, 0.0, 0.5])
    stiff.to_points(others, apart)
    assert stiff._memory.of(few).readings is None
    assert stiff._memory.of(others).readings is not None
    many = np.vstack([few, body.chart_points(np.random.default_rng(3).uniform(-3, 3, (len(apart), 2)), 1.0)])
    by_patch = stiff.to_points(many, apart)[: 3 * len(few)]
    np.testing.assert_allclose(by_point, by_patch, atol=2e-6 * np.abs(by_patch).max())


def test_kept_points_outlive_others_and_answer_alike_from_the_first_load_on():
    """What reads a table at points asked about often is made late, unless it is known beforehand."""
    points = np.array([[0.0, 0.5, 3.0], [-1.0, 1.0, 6.0]])
    load = tile(Traction.rectangle((0, 0), (4, 4), (0, 0, 1)), BODIES["block"])
    stiff = Compliance(BODIES["block"], Material(youngs_modulus_mpa=0.5))
    stiff.keep(points)
    known = stiff._memory.of(points)
    first = stiff.displacement(points, load)
    for shift in range(1, 2 * REMEMBERED):
        stiff.displacement(points + 0.01 * shift, load)
        np.testing.assert_array_equal(stiff.displacement(points, load), first)
    stiff.forget()
    assert stiff._memory.of(points) is known
    assert stiff._memory.of(points + 0.01)._bases == {}
    for _ in range(2 * MANY_LOADS):
        np.testing.assert_array_equal(stiff.displacement(points, load), first)


def test_points_are_compared_by_value_and_a_changed_array_is_checked_again():
    stiff, points = compliance("block", "nominal", 0.5), np.array([[0.0, 0.5, 1.5], [-1.0, 1.0, 3.0]])
    load = tile(Traction.rectangle((0, 0), (4, 4), (0, 0, 1)), BODIES["block"])
    first = stiff.displacement(points, load)
    assert stiff._memory.of(points.copy()) is stiff._memory.of(points)
    points[0, 0] = 2.0
    assert np.abs(stiff.displacement(points, load) - first)[0].max() > 1e-3 * np.abs(first).max()
    points[1, 2] = np.nan
    with pytest.raises(OutOfBodyError, match="point 1"):
        stiff.displacement(points, load)
    points[1, 2] = -1.0
    with pytest.raises(OutOfBodyError, match="point 1"):
        stiff.displacement(points, load)
