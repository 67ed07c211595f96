"""Contacts that no grid fits at once: corners of tilted probes, ridges askew, rims on slopes."""

import itertools
import math

import numpy as np
import pytest
from presses import centre_of, hull, pressed, settled
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from standard_bodies import DOME, rectangles, write_stl

from twin.parts.press import Press
from twin.parts.probe import Cylinder, Pillar, Stl
from twin.theory import halfspace

WIDTH, LENGTH, DEPTH = 4.0, 2.5, 0.1
CORNER = (40.0, 40.0, 0.0)


def turned(points, tilt_deg):
    """Turn about x, then y, then z, all of which stay where they are."""
    return Rotation.from_euler("xyz", tilt_deg, degrees=True).apply(points)


def lowest(vertices, xy):
    """Largest z of a convex solid over (n, 2): where vertical lines leave its half-spaces."""
    planes = ConvexHull(vertices).equations
    down, up = planes[planes[:, 2] > 1e-9], planes[planes[:, 2] < -1e-9]
    least, most = (-(p[:, 3:] + p[:, :2] @ xy.T) / p[:, 2:3] for p in (down, up))
    z = least.min(axis=0)
    return np.where(z >= most.max(axis=0), z, -np.inf)


def force_of(vertices, low, high, across):
    """Force under a convex solid DEPTH deep: active set on an even grid, E = 1, nu = 1/2."""
    sides = (high - low) / across
    grid = np.stack(np.meshgrid(*2 * [np.arange(across)], indexing="ij"), -1).reshape(-1, 2)
    xy = low + (grid + 0.5) * sides
    over = lowest(vertices, xy) - vertices[:, 2].max() + DEPTH
    xy, over = xy[over > 0], over[over > 0]
    cells = rectangles(np.column_stack([xy, np.zeros(len(xy))]), sides / 2, 0.0)
    compliance = halfspace.compliance(cells.centre_mm, cells, 1.0, 0.5)[2::3, 2::3]
    return settled(compliance, over).sum()


def pillar(tilt_deg, edge_mm=0.0):
    probe = Pillar(width_mm=WIDTH, length_mm=LENGTH, edge_mm=edge_mm)
    return pressed(Press(probe=probe, tilt_deg=tilt_deg, indentation_mm=DEPTH)).force_n[2]


@pytest.mark.parametrize("tilt", [CORNER, (25.0, 18.0, 40.0)])
def test_a_sharp_corner_pushes_with_its_sides_too(tilt):
    """Without the steep sides a corner was a quarter too weak, or not found at all."""
    sides = ((-WIDTH / 2, WIDTH / 2), (-LENGTH / 2, LENGTH / 2), (-30, 0))
    box = turned(list(itertools.product(*sides)), tilt)
    corner = box[np.argmax(box[:, 2]), :2]
    right = force_of(box, corner - 0.25, corner + 0.25, 48)
    assert pillar(tilt) == pytest.approx(right, rel=0.03)


def test_a_sharp_edge_is_the_limit_of_rounded_ones():
    assert pillar(CORNER) == pytest.approx(pillar(CORNER, edge_mm=1e-4), rel=0.03)


@pytest.mark.parametrize(("lean", "turn"), [(30.0, 45.0), (21.0, 30.0), (45.0, 10.0)])
def test_an_edge_pushes_as_hard_however_it_is_turned(lean, turn):
    """Half as hard again was found at 30 and 45 degrees, nothing at the others."""
    assert pillar((lean, 0.0, turn)) == pytest.approx(pillar((lean, 0.0, 0.0)), rel=0.03)


def test_a_ridge_that_lies_askew_in_its_file_is_found(tmp_path):
    ends = [(-1.5, 0, 0), (1.5, 0, 0)]
    vertices, triangles = hull([*ends, *itertools.product((-1.5, 1.5), (-1.0, 1.0), (-1.0,))])

    def ridge(angle):
        askew = turned(vertices, (0.0, 0.0, angle))
        file = write_stl(tmp_path / f"{angle:g}.stl", askew[triangles])
        return pressed(Press(probe=Stl(file=str(file)), indentation_mm=DEPTH)).force_n[2]

    assert ridge(40.0) == pytest.approx(ridge(0.0), rel=0.05)


def test_a_rim_that_just_touches_a_slope_is_found():
    """A hair's indentation reaches no patch of the first grids: they shrank around the middle."""
    probe = Cylinder(diameter_mm=1.573, edge_mm=0.4214)
    wanted = Press(probe=probe, at_mm=(0.0, -0.732), indentation_mm=1e-3)
    state = pressed(wanted, DOME, across=9)
    flat, slope = 1.573 / 2 - 0.4214, math.asin(0.732 / 10.0)
    assert state.indentation_mm == pytest.approx(1e-3)
    away = math.hypot(*(centre_of(state)[:2] - wanted.at_mm[:2]))
    assert away == pytest.approx(flat, abs=0.4214 * math.sin(2 * slope) + 0.05)
