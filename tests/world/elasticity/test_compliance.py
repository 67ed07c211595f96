"""Compliance against converged solutions of an independent program, and its own symmetries."""

import gc
import json
import math
import weakref
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import (
    BLOCK,
    BODIES,
    FINGER,
    REFERENCE,
    assert_near,
    asymmetry,
    rectangles,
    relative_error,
    traction_of,
)

from twin.errors import InputError
from twin.parts.body import Block
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.world.elasticity.block_table import MANY_LOADS
from twin.world.elasticity.cache import REMEMBERED, PointCache
from twin.world.elasticity.compliance import FEW, Compliance
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.interpolated import AdjointFields

FILES = {"block": "block_converged", "finger": "finger"}
BOUND = {
    ("block", "fine"): 6e-5,
    ("block", "standard"): 4e-4,
    ("block", "nominal"): 8e-4,
    ("finger", "sketch"): 3e-3,
    ("finger", "standard"): 2e-3,
    ("finger", "nominal"): 3e-3,
    ("finger", "fine"): 1e-3,
}
TRUTH = {name: np.load(REFERENCE / f"{file}.npz") for name, file in FILES.items()}
CASES = {name: json.loads(str(truth["cases"])) for name, truth in TRUTH.items()}
SQUARE = tile(Traction.rectangle((0, 0), (4, 4), (0, 0, 1)), BLOCK)
FEW_POINTS = np.array([[0.0, 0.5, 1.5], [-1.0, 1.0, 3.0]])


@cache
def compliance(name, level, nu, method="subtracted"):
    """Return one shared compliance each, so that the tests factor every matrix once."""
    material = Material(youngs_modulus_mpa=0.5, poisson_ratio=nu)
    return Compliance(BODIES[name], material, level=level, method=method, table=False)


def reference_error(stiff, name, case):
    """Return the error of the displacement, and the estimated over the true one."""
    points, tiles = TRUTH[name]["points"], tile(traction_of(case), BODIES[name])
    error = relative_error(stiff.displacement(points, tiles), TRUTH[name][case["key"]])
    return error, stiff.answer(points, tiles)[1] / error


def case(name, level, index, slow=True):
    marks = [pytest.mark.slow] if slow else []
    key = CASES[name][index]["key"]
    return pytest.param(name, level, index, marks=marks, id=f"{name} {level} {key}")


QUICK = [("block", "nominal", 0), ("block", "nominal", 3)]
QUICK += [("finger", "nominal", 2), ("finger", "sketch", 1)]
LEVELS = ("sketch", "coarse", "standard", "nominal")
SLOW = [(name, level, index) for name, cases in CASES.items() for index in range(len(cases)) for level in LEVELS]
SLOW += [("finger", "fine", index) for index in range(5)]
SLOW += [("block", "fine", index) for index, one in enumerate(CASES["block"]) if one["nu"] == 0.49]


@pytest.mark.parametrize(
    ("name", "level", "index"), [case(*each, slow=False) for each in QUICK] + [case(*e) for e in SLOW if e not in QUICK]
)
def test_displacement_is_the_reference_s_and_the_estimate_one_to_three_times_the_error(name, level, index):
    one = CASES[name][index]
    error, ratio = reference_error(compliance(name, level, one["nu"]), name, one)
    assert error < BOUND.get((name, level), math.inf)
    assert 1.0 < ratio < 3.0 or (name, level) == ("finger", "fine")


@pytest.mark.slow
@pytest.mark.parametrize("level", ["coarse", "standard"])
def test_on_the_flank_where_levels_err_alike_the_estimate_is_still_above_the_error(level):
    """Where cylinder meets sphere two levels differ by less than either is wrong."""
    points = TRUTH["finger"]["points"]
    load = tile(Traction.bump((0.4, -4.1), 1.0, (0, 1, 0)), FINGER)
    right = compliance("finger", "fine", 0.5).displacement(points, load)
    got, estimate = compliance("finger", level, 0.5).answer(points, load)
    assert 1.0 < estimate / relative_error(got, right) < 3.0


@pytest.mark.parametrize("one", CASES["block"], ids=lambda one: one["key"])
def test_table_knows_its_error_to_a_factor_of_three_and_factors_nothing(one):
    """The table is 1.4e-5 to 4.3e-5 off, which only a truth that is good to 3e-6 can show."""
    before = Factor.made
    material = Material(youngs_modulus_mpa=0.5, poisson_ratio=one["nu"])
    error, ratio = reference_error(Compliance(BLOCK, material), "block", one)
    assert error < 5e-5
    assert 1.0 < ratio < 3.0
    _, nominal = reference_error(Compliance(BLOCK, material, level="nominal"), "block", one)
    assert 1.0 < nominal < 3.0
    assert Factor.made == before


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize(("radius", "bound"), [(4.0, 0.01), (2.0, 0.03)])
def test_plain_taylor_hood_agrees_where_the_mesh_resolves_the_load(axis, radius, bound):
    """Without the half-space the mesh carries the load: a wide bump agrees, a narrow one less."""
    tiles = tile(Traction.bump((0, 0), radius, tuple(np.eye(3)[axis])), FINGER)
    one, other = (
        compliance("finger", "standard", 0.5, method).displacement(TRUTH["finger"]["points"], tiles)
        for method in ("direct", "subtracted")
    )
    assert np.abs(one - other).max() < bound * np.abs(other).max()


def test_second_press_factors_nothing_and_moving_markers_neither():
    stiff, points = compliance("finger", "nominal", 0.5), np.array([[0.0, 0, 2], [1, 1, 3]])
    stiff.displacement(points, tile(Traction.bump((0, 0), 1.0, (0, 0, 1)), FINGER))
    before, load = Factor.made, tile(Traction.bump((1, 1), 1.0, (0.2, 0, 1)), FINGER)
    stiff.displacement(points, load)
    stiff.displacement(points + 0.5, load)
    assert Factor.made == before


@pytest.mark.parametrize(("name", "at"), [("block", (2.0, 1.0)), ("finger", (1.0, 0.5))])
def test_superposition_gradient_and_matrix(name, at):
    body, stiff = BODIES[name], compliance(name, "nominal", 0.5)
    points = body.chart_points(np.random.default_rng(4).uniform(-4, 4, (12, 2)), depth_mm=1.5)
    one = tile(Traction.rectangle(at, (0.5, 0.5), (0.2, 0.1, 1)), body, 0.25)
    two = tile(Traction.rectangle((-1.0, -2.0), (0.5, 0.5), (0, 1, 0)), body, 0.25)
    both = stiff.displacement(points, Rectangles.joined([one, two]))
    assert_near(stiff.displacement(points, one) + stiff.displacement(points, two), both, 2e-3)
    slopes = [
        (stiff.displacement(points + move, one) - stiff.displacement(points - move, one)) / 2e-4
        for move in 1e-4 * np.eye(3)
    ]
    assert_near(np.stack(slopes, axis=-1), stiff.gradient(points, one), 0.01)
    moved = (stiff.to_points(points, one) @ one.force_n.ravel()).reshape(-1, 3)
    near = 5e-3 * np.abs(both).max()
    assert_allclose(moved, stiff.displacement(points, one), atol=near)


def test_contact_compliance_is_symmetric_positive_and_interpolated_well():
    stiff = compliance("finger", "nominal", 0.5)
    patches = tile(Traction.rectangle((1.0, 0.5), (2.0, 2.0), (0, 0, 1)), FINGER, 0.2)
    matrix = stiff.surface(patches)
    assert asymmetry(stiff, patches) < 0.02
    assert np.linalg.eigvalsh(matrix).min() > 0
    pressed = (matrix @ patches.force_n.ravel()).reshape(-1, 3)
    assert_near(pressed, stiff.displacement(patches.centre_mm, patches), 0.01)


def test_points_outside_and_loads_off_the_surface_are_refused():
    stiff = compliance("block", "nominal", 0.5)
    with pytest.raises(InputError, match="point 1"):
        stiff.displacement(np.array([[0.0, 0, 1], [0, 0, -0.1]]), SQUARE)
    with pytest.raises(InputError, match="not on the sensing surface"):
        stiff.displacement(FEW_POINTS, rectangles((0, 0, 1.0), 2.0, (0, 0, 1)))


def mirror_error(name, level, centre, size, flip):
    """Return how far the answer is off the mirrored load's, over axes and depths, and its bound."""
    body, stiff, flip = BODIES[name], compliance(name, level, 0.5), np.array(flip)
    place = body.chart_points(np.array([centre], float))[0]
    steps = [-3, -1, 0, 1, 3]
    around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) + centre
    points = np.vstack([body.chart_points(around, depth) for depth in (0.5, 3.0)])
    points, errors = points[body.contains(points, 0.3)], []
    for force in np.eye(3):
        load, mirrored = (
            tile(Traction.rectangle(tuple(place * m), (size, size), tuple(force * m)), body) for m in (1, flip)
        )
        there = stiff.displacement(points * flip, mirrored) * flip
        errors.append(relative_error(there, stiff.displacement(points, load)))
    return max(errors), stiff.expected_error(load)


EDGES = [
    ("block", (40, 0), 4, (-1, 1, 1)),
    ("block", (45, 0), 4, (-1, 1, 1)),
    ("block", (0, 38), 4, (1, -1, 1)),
    ("finger", (-6, 4), 1, (1, -1, 1)),
    ("finger", (-6.5, 2), 1, (1, -1, 1)),
]


@pytest.mark.parametrize(("name", "centre", "size", "flip"), EDGES)
def test_expected_error_covers_the_mirror_error_near_edges(name, centre, size, flip):
    error, estimate = mirror_error(name, "nominal", centre, size, flip)
    assert error < estimate < 20 * error


def test_expected_error_grows_towards_edges_and_is_the_measured_bound_inside():
    def estimate(name, centre, size):
        body = BODIES[name]
        place = tuple(body.chart_points(np.array([centre]))[0])
        load = tile(Traction.rectangle(place, (size, size), (0, 0, 1)), body)
        return compliance(name, "standard", 0.5).expected_error(load)

    assert estimate("block", (0.0, 0.0), 4.0) == pytest.approx(4e-4)
    assert estimate("finger", (0.0, 0.0), 1.0) == pytest.approx(4e-3)
    growing = [estimate("block", (x, 0.0), 4.0) for x in (20.0, 35.0, 40.0, 45.0)]
    assert growing == sorted(growing)
    assert growing[-1] > 0.05


@pytest.mark.parametrize(("z", "bounded"), [(8.3, True), (9.3, False), (9.7, False)])
def test_next_to_the_clamped_rim_there_is_no_bound_and_estimates_say_so(z, bounded):
    """The rim is at z = 10; the skirt begins at z = 8, where a load has a bound."""
    load = tile(Traction.rectangle((-3.0, -8.0, z), (0.4, 0.4), (0, 0.2, 0)), FINGER)
    stiff = compliance("finger", "nominal", 0.5)
    estimate = stiff.answer(np.array([[-3.0, -7.5, 8.5]]), load)[1]
    for error in (stiff.expected_error(load), estimate):
        assert error < 0.1 if bounded else error > 1.0


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_a_rectangle_wider_than_the_body_is_thick_moves_it_as_its_quarters_do(share):
    """At nu = 0 a pressure p on the whole face moves a depth z by p (thickness - z) / E."""
    body, points = Block(width_mm=20, length_mm=20, thickness_mm=10), np.array([[0.0, 0, 1], [5, 4, 3], [9, 9, 5]])
    stiff = Compliance(body, Material(youngs_modulus_mpa=0.5, poisson_ratio=0.0), level="sketch", table=False)
    q = 5 * share
    whole = rectangles((0, 0, 0.0), 2 * q, (0, 0, 4))
    quarters = rectangles([(x, y, 0.0) for x in (-q, q) for y in (-q, q)], q, (0, 0, 1))
    moved = stiff.displacement(points, whole)
    assert_near(moved, stiff.displacement(points, quarters), 5e-3)
    if share == 1.0:
        assert_near(moved, np.outer(10 - points[:, 2], [0, 0, 0.01 / 0.5]), 5e-3)


@pytest.mark.parametrize("name", ["block", "finger"])
@pytest.mark.parametrize("table", [True, False])
def test_no_points_give_no_displacements(name, table):
    body, nowhere = BODIES[name], np.zeros((0, 3))
    usual = Compliance(body, Material(youngs_modulus_mpa=0.5))
    stiff = usual if table else compliance(name, "nominal", 0.5)
    load = tile(Traction.bump((0, 0), 1.0, (0, 0, 1)), body)
    assert stiff.answer(nowhere, load)[1] == 0.0
    assert stiff.displacement(nowhere, load).shape == (0, 3)
    assert stiff.gradient(nowhere, load).shape == (0, 3, 3)
    assert stiff.to_points(nowhere, load).shape == (0, 3 * len(load))


@pytest.fixture
def made(monkeypatch):
    """Return references to all that is made of a class: dead ones hold no memory any more."""
    found = []

    def watch(where, kind):
        def noted(*given, **named):
            one = kind(*given, **named)
            found.append(weakref.ref(one))
            return one

        monkeypatch.setattr(f"twin.world.elasticity.{where}", noted)
        return found

    return watch


@pytest.mark.slow
def test_adjoint_and_primal_solves_agree_and_few_points_take_the_adjoint(made):
    """Two points and nine separate patches: three solves a point give what those a patch give."""
    fields = made("compliance.AdjointFields", AdjointFields)
    apart = tile(Traction.rectangle((0, 0), (6.0, 6.0), (0, 0, 1)), FINGER, 2.0)
    stiff = compliance("finger", "nominal", 0.5)
    assert len(apart) > FEW * len(FEW_POINTS)
    by_point = stiff.to_points(FEW_POINTS, apart)
    assert_array_equal(stiff.to_points(FEW_POINTS, apart), by_point)
    assert [field() is not None for field in fields] == [True]
    stiff.to_points(FEW_POINTS + np.array([0.0, 0.0, 0.5]), apart)
    assert [field() is not None for field in fields] == [False, True]
    chart = np.random.default_rng(3).uniform(-3, 3, (len(apart), 2))
    many = np.vstack([FEW_POINTS, FINGER.chart_points(chart, 1.0)])
    by_patch = stiff.to_points(many, apart)[: by_point.shape[0]]
    assert len(fields) == 2
    assert_near(by_point, by_patch, 2e-6)


def test_kept_points_outlive_others_and_answer_alike_from_the_first_load_on(made):
    """What reads a table at points used often is made late, unless it is known beforehand."""
    known_sets = made("cache.PointCache", PointCache)
    points = np.array([[0.0, 0.5, 3.0], [-1.0, 1.0, 6.0]])
    stiff = Compliance(BLOCK, Material(youngs_modulus_mpa=0.5))
    stiff.keep(points)
    first = stiff.displacement(points, SQUARE)
    for shift in range(1, 2 * REMEMBERED):
        stiff.displacement(points + 0.01 * shift, SQUARE)
        assert_array_equal(stiff.displacement(points, SQUARE), first)
    assert len(known_sets) == 2 * REMEMBERED
    stiff.forget()
    gc.collect()
    alive = [known() is not None for known in known_sets]
    assert alive == [True] + [False] * (2 * REMEMBERED - 1)
    for _ in range(2 * MANY_LOADS):
        assert_array_equal(stiff.displacement(points, SQUARE), first)
    assert len(known_sets) == 2 * REMEMBERED
    stiff.displacement(points + 0.01, SQUARE)
    assert len(known_sets) == 2 * REMEMBERED + 1


def test_points_are_compared_by_value_and_a_changed_array_is_checked_again(made):
    known_sets = made("cache.PointCache", PointCache)
    stiff, points = compliance("block", "nominal", 0.5), FEW_POINTS.copy()
    first = stiff.displacement(points, SQUARE)
    count = len(known_sets)
    assert_array_equal(stiff.displacement(points.copy(), SQUARE), first)
    assert len(known_sets) == count
    points[0, 0] = 2.0
    change = np.abs(stiff.displacement(points, SQUARE) - first)[0].max()
    assert change > 1e-3 * np.abs(first).max()
    for bad in (np.nan, -1.0):
        points[1, 2] = bad
        with pytest.raises(InputError, match="point 1"):
            stiff.displacement(points, SQUARE)


def test_the_surface_is_the_mean_of_its_compliance_and_the_transpose():
    stiff = compliance("block", "nominal", 0.5)
    centres = [(x, y) for x in np.linspace(-8, 8, 10) for y in np.linspace(-6, 6, 9)]  # 270 rows
    patches = Rectangles.joined([tile(Traction.rectangle(c, (1, 1), (0, 0, 1)), BLOCK) for c in centres])
    whole = stiff.to_points(patches.centre_mm, patches, reused=True)
    assert_array_equal(stiff.surface(patches), (whole + whole.T) / 2)
