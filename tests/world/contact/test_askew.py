"""Contacts that no grid fits at once: edges and corners of tilted probes, ridges askew, rims on a slope."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from test_contact import only, pressed
from test_probes import write_stl

from twin.arrays import Bools, Floats, Points
from twin.parts.body import Dome
from twin.parts.load import Rectangles
from twin.parts.press import Press
from twin.parts.probe import Cylinder, Pillar, Stl
from twin.theory.halfspace_normal import normal_compliance

WIDTH, LENGTH, DEPTH = 4.0, 2.5, 0.1


def turned(tilt_deg: tuple[float, float, float]) -> Floats:
    """About x, then y, then z, all of which stay where they are."""
    (a, b, c), (d, e, f) = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    about_x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    about_y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    about_z = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def lowest(vertices: Points, xy: Floats) -> Floats:
    """Largest z of a convex solid over places (n, 2): where vertical lines leave its faces' half-spaces."""
    planes = ConvexHull(vertices).equations
    down, up = planes[planes[:, 2] > 1e-9], planes[planes[:, 2] < -1e-9]
    least = -(down[:, 3:] + down[:, :2] @ xy.T) / down[:, 2:3]
    most = -(up[:, 3:] + up[:, :2] @ xy.T) / up[:, 2:3]
    z = least.min(axis=0)
    return np.asarray(np.where(z >= most.max(axis=0), z, -np.inf))


def force_of(vertices: Points, low: Floats, high: Floats, across: int) -> float:
    """Force on a half-space under a convex solid DEPTH deep: dense active set on an even grid, E = 1, nu = 1/2."""
    sides = (high - low) / across
    xy = low + (np.stack(np.meshgrid(*2 * [np.arange(across)], indexing="ij"), -1).reshape(-1, 2) + 0.5) * sides
    over = lowest(vertices, xy) - vertices[:, 2].max() + DEPTH
    xy, over = xy[over > 0], over[over > 0]
    n = len(xy)
    cells = Rectangles(
        centre_mm=np.column_stack([xy, np.zeros(n)]), frames=np.tile(np.eye(3), (n, 1, 1)),
        half_mm=np.tile(sides / 2, (n, 1)), force_n=np.zeros((n, 3)),
    )  # fmt: skip
    compliance = normal_compliance(cells, 1.0, 0.5)
    assert compliance is not None
    active: Bools = np.ones(n, bool)
    for _ in range(100):
        force = np.zeros(n)
        force[active] = np.linalg.solve(compliance[np.ix_(active, active)], over[active])
        wrong = (active & (force < 0)) | (~active & (compliance @ force < over - 1e-12))
        if not wrong.any():
            return float(force.sum())
        active ^= wrong
    raise AssertionError("the active set does not settle")


def pillar(tilt_deg: tuple[float, float, float], edge_mm: float = 0.0) -> float:
    probe = Pillar(width_mm=WIDTH, length_mm=LENGTH, edge_mm=edge_mm)
    return float(pressed(Press(probe=probe, tilt_deg=tilt_deg, indentation_mm=DEPTH)).force_n[2])


@pytest.mark.parametrize("tilt", [(40.0, 40.0, 0.0), (25.0, 18.0, 40.0)])
def test_a_sharp_corner_pushes_with_its_sides_too(tilt: tuple[float, float, float]) -> None:
    """Without the sides, which are steep but not upright, a corner was a quarter too weak, or not found at all."""
    box = np.array(list(itertools.product((-WIDTH / 2, WIDTH / 2), (-LENGTH / 2, LENGTH / 2), (-30, 0))))
    box = box @ turned(tilt).T
    corner = box[np.argmax(box[:, 2]), :2]
    right = force_of(box, corner - 0.25, corner + 0.25, 48)
    assert pillar(tilt) == pytest.approx(right, rel=0.03)


def test_a_sharp_edge_is_the_limit_of_rounded_ones() -> None:
    assert pillar((40.0, 40.0, 0.0)) == pytest.approx(pillar((40.0, 40.0, 0.0), edge_mm=1e-4), rel=0.03)


@pytest.mark.parametrize(("lean", "turn"), [(30.0, 45.0), (21.0, 30.0), (45.0, 10.0)])
def test_an_edge_pushes_as_hard_however_it_is_turned(lean: float, turn: float) -> None:
    """Half as hard again was found at 30 and 45 degrees, nothing at the others."""
    assert pillar((lean, 0.0, turn)) == pytest.approx(pillar((lean, 0.0, 0.0)), rel=0.03)


def test_a_ridge_that_lies_askew_in_its_file_is_found(tmp_path: Path) -> None:
    def ridge(angle: float) -> float:
        ends = np.array([[-1.5, 0, 0], [1.5, 0, 0]])
        roof = np.array(list(itertools.product((-1.5, 1.5), (-1.0, 1.0), (-1.0,))))
        hull = ConvexHull(np.vstack([ends, roof]))
        corners = hull.simplices
        a, b, c = (hull.points[corners[:, k]] for k in range(3))
        inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c - 3 * hull.points.mean(axis=0)) < 0
        corners[inwards] = corners[inwards][:, ::-1]
        file = write_stl(tmp_path / f"{angle:g}.stl", hull.points @ turned((0, 0, angle)).T, corners)
        return float(pressed(Press(probe=Stl(file=str(file)), indentation_mm=DEPTH)).force_n[2])

    assert ridge(40.0) == pytest.approx(ridge(0.0), rel=0.05)


def test_a_rim_that_just_touches_a_slope_is_found() -> None:
    """No patch of the first grids is reached by a hair's indentation: they shrank around the face's middle."""
    at, depth = (0.0, -0.732), 1e-3
    wanted = Press(probe=Cylinder(diameter_mm=1.573, edge_mm=0.4214), at_mm=at, indentation_mm=depth)
    state = pressed(wanted, Dome(radius_mm=10, height_mm=7), across=9)
    flat, slope = 1.573 / 2 - 0.4214, math.asin(0.732 / 10.0)
    middle = only(state).force_n[:, 2] @ only(state).centre_mm / state.force_n[2]
    assert state.indentation_mm == pytest.approx(depth)
    assert math.hypot(*(middle[:2] - at)) == pytest.approx(flat, abs=0.4214 * math.sin(2 * slope) + 0.05)
