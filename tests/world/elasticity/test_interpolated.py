"""Tables of a curved surface: exact at the grid's patches, near solves between them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import FINGER, assert_near

from twin.errors import InputError
from twin.parts.body import Block, Finger
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.world.elasticity import compliance, interpolated
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.interpolated import PATCH, SurfaceTable
from twin.world.mesh.interpolate import Locator

RUBBER = Material(youngs_modulus_mpa=0.5, poisson_ratio=0.5)
HALF = 7.0
POINTS = FINGER.chart_points(np.array([[0.2, 0.1], [1.0, 0.5], [-2.0, 3.0], [3.0, -1.0]] * 2), np.repeat([0.5, 2.0], 4))


def finger(surface):
    return Compliance(FINGER, RUBBER, level="sketch", surface_table=surface)


def patch(chart, force=(0.2, -0.1, 1.0)):
    square = Rectangles.at(FINGER, FINGER.chart_points(np.array([chart], float)), PATCH * HALF)
    return replace(square, force_n=np.array([force], float))


@pytest.fixture(scope="module")
def small():
    """A finger with a table of few nodes, one that solves, and the table."""
    with pytest.MonkeyPatch.context() as change:
        change.setattr(interpolated, "NODES", 7)
        made, solved = finger(True), finger(False)
        made.displacement(POINTS, patch((0.0, 0.0)))
        yield made, solved, SurfaceTable(solved.system, FINGER)


def test_patches_of_the_grid_are_answered_as_if_solved(small):
    table, solved, _ = small
    for chart in ((0.0, 0.0), (HALF / 3, -HALF / 3)):
        expected = solved.displacement(POINTS, patch(chart))
        got = table.displacement(POINTS, patch(chart))
        assert np.abs(got - expected).max() < 1e-5 * np.abs(expected).max()
        slopes = solved.gradient(POINTS, patch(chart))
        assert np.abs(table.gradient(POINTS, patch(chart)) - slopes).max() < 1e-4 * np.abs(slopes).max()


def test_many_patches_at_once_and_one_load_are_the_same_answer(small):
    table, _, _ = small
    load = tile(Traction.disk((1.0, 0.5), 1.0, (0.3, 0, 1)), FINGER, 0.3)
    columns = table.to_points(POINTS, load)
    assert_allclose(columns @ load.force_n.ravel(), table.displacement(POINTS, load).ravel(), atol=1e-10, rtol=0)


def test_points_too_many_to_keep_are_answered_alike(small, monkeypatch):
    table, _, _ = small
    load = patch((1.3, 0.4))
    many = np.tile(POINTS, (interpolated.KEPT_POINTS // len(POINTS) + 1, 1))
    few = table.answer(POINTS, load)
    slopes = table.gradient(POINTS, load)

    def kept(*_):
        raise AssertionError("what reads the table at many points would fill the memory")

    monkeypatch.setattr(SurfaceTable, "reading", kept)
    monkeypatch.setattr(SurfaceTable, "slopes", kept)
    moved, error = table.answer(many, load)
    assert_allclose(moved[: len(POINTS)], few[0], atol=1e-5 * np.abs(moved).max(), rtol=0)
    assert error == pytest.approx(few[1], rel=1e-3)
    assert_near(table.gradient(many, load)[: len(POINTS)], slopes, 1e-4)


def test_what_the_table_does_not_cover_is_solved(small):
    table, solved, surface = small
    assert surface.covers(patch((6.9, 6.9)))
    assert not surface.covers(patch((7.1, 0.0)))
    twist = tile(Traction.twist((0, 0), 1.0, 1.0), FINGER, 0.4)
    assert surface.covers(twist)
    assert not surface.pushes(twist)
    assert_array_equal(table.displacement(POINTS, twist), solved.displacement(POINTS, twist))


def test_only_curved_bodies_with_room_around_the_window_have_one(monkeypatch):
    block = Compliance(Block(width_mm=40, length_mm=40, thickness_mm=20), RUBBER, level="sketch", surface_table=True)
    made = []

    def noted(*given):
        made.append(given)
        return SurfaceTable(*given)

    monkeypatch.setattr("twin.world.elasticity.compliance.SurfaceTable", noted)
    load = Traction.rectangle((0, 0), (1.0, 1.0), (0, 0, 1))
    block.displacement(np.array([[0.0, 0.0, 2.0]]), tile(load, block.body))
    finger(False).displacement(POINTS, patch((0.0, 0.0)))
    assert made == []
    short = Finger(radius_mm=8, barrel_mm=4, skirt_mm=2)
    with pytest.raises(InputError, match=r"accuracy\.surface_table = true: the window .* set it to false"):
        SurfaceTable(finger(False).system, short)


LOADS = [
    (Traction.bump((1.2, 0.8), 1.0, (0.3, 0.1, 1)), 2.5e-3),
    (Traction.bump((-2.5, 2.1), 2.0, (1, 0, 0)), 2.5e-3),
    (Traction.disk((2.6, 0.3), 1.0, (0, 0.5, 1)), 2.5e-3),
    (Traction.rectangle((0.3, -2.0), (2.0, 1.0), (0, 0, 1)), 2.5e-3),
    (Traction.rectangle((3.1, -1.0), (0.2, 0.2), (0.5, 0, 1)), 8e-3),
]


@pytest.mark.slow
def test_answers_between_the_patches_are_as_near_to_solves_as_they_say():
    chart = np.stack(np.meshgrid(np.linspace(-3, 3.5, 7), np.linspace(-3, 3, 7)), -1).reshape(-1, 2)
    points = np.vstack([FINGER.chart_points(chart, depth) for depth in (0.3, 0.5, 2.0)])
    table, solved = finger(True), finger(False)
    surface = SurfaceTable(solved.system, FINGER)
    reading = surface.reading(Locator(solved.mesh).locate(points))
    for traction, bound in LOADS:
        load = tile(traction, FINGER)
        expected = solved.displacement(points, load)
        size = np.linalg.norm(expected, axis=1).max()
        error = np.linalg.norm(table.displacement(points, load) - expected, axis=1).max() / size
        told = surface.displacement(reading, load)[1] / RUBBER.youngs_modulus_mpa / size
        assert error < bound
        assert error < told + 5e-4  # the solves themselves are that rough
        assert table.answer(points, load)[1] > told


NARROW = Block(width_mm=40, length_mm=8, thickness_mm=6)


def grid(columns, rows, half, turned=False):
    place = [half * (2 * np.arange(count) - count + 1) for count in (columns, rows)]
    x, y = (one.ravel() for one in np.meshgrid(*place))
    keep = np.abs(x / x.max()) + np.abs(y / y.max()) < 1.2 if turned else np.full(len(x), True)
    centre = np.column_stack([x, y, 0 * x])[keep]
    return replace(Rectangles.at(NARROW, centre, half), force_n=np.random.default_rng(3).uniform(0, 1, centre.shape))


BESIDE = [(grid(15, 15, 0.25), 4e-3), (grid(18, 18, 0.2, turned=True), 5e-4), (grid(100, 4, 0.15), 5e-4)]


@pytest.mark.parametrize(("patches", "least"), BESIDE)
def test_contacts_up_to_an_edge_or_longer_than_a_region_are_interpolated_as_if_solved(patches, least, monkeypatch):
    def fail(*_):
        raise AssertionError("every patch is solved")

    monkeypatch.setattr(compliance, "patch_corrections", fail)
    stiff = Compliance(NARROW, RUBBER, level="sketch", table=False)
    matrix = stiff.to_points(patches.centre_mm, patches, reused=True)
    solved = stiff.displacement(patches.centre_mm, patches)
    off = (matrix @ patches.force_n.ravel()).reshape(-1, 3) - solved
    assert np.abs(off).max() < least * np.abs(solved).max()
