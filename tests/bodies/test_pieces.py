"""Distances to triangulated pieces: by brute force, by counting, on edges and in dents."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from stl_shapes import bracket, solid_box, solid_bracket, solid_dome

from twin.geometry.closed import Surface
from twin.geometry.pieces import TriangleTree
from twin.parts.body import Block


def spread(corners, count):
    """Return points all over triangles, with weights of a lattice: brute force."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    share = np.stack([count - i - j, i, j], axis=-1)[i + j <= count] / count
    return np.einsum("ls,tsi->tli", share, corners)


def in_bracket(points):
    x, y, z = points.T
    return (np.abs(y) <= 5) & (x >= -6) & (z >= 0) & np.where(z <= 4, x <= 6, (x <= 0) & (z <= 12))


@pytest.mark.slow
def test_the_nearest_place_is_nearest_and_its_feature_is_where_it_lies():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(200, 1, 3)) + 0.4 * rng.normal(size=(200, 3, 3))
    points = 2 * rng.normal(size=(300, 3))
    triangle, foot, feature = TriangleTree(corners).nearest(points)
    distance = np.linalg.norm(points - foot, axis=1)
    brute = np.linalg.norm(points[:, None, None] - spread(corners, 20)[None], axis=3)
    assert (distance <= brute.min(axis=(1, 2)) + 1e-12).all()
    assert_allclose(distance, brute.min(axis=(1, 2)), atol=0.02)
    a, b, c = (corners[triangle, k] for k in range(3))
    share = np.linalg.solve(np.stack([b - a, c - a, np.cross(b - a, c - a)], axis=2), (foot - a)[:, :, None])[:, :, 0]
    shares = np.column_stack([1 - share[:, 0] - share[:, 1], share[:, :2]])
    assert_allclose(share[:, 2], 0, atol=1e-10)
    assert (shares > -1e-10).all()
    zero = {0: [], 1: [1, 2], 2: [0, 2], 3: [0, 1], 4: [2], 5: [0], 6: [1]}
    for kind, which in zero.items():
        assert_allclose(shares[feature == kind][:, which], 0, atol=1e-10)
    assert set(feature) == set(range(7))


def test_the_first_triangle_from_below_is_the_lowest():
    rng = np.random.default_rng(2)
    corners = rng.uniform(-3, 3, size=(100, 1, 3)) + rng.normal(size=(100, 3, 3))
    xy = rng.uniform(-3, 3, (400, 2))
    triangle, z = TriangleTree(corners).first_along(
        np.column_stack([xy, np.zeros(400)]), np.tile([0.0, 0.0, 1.0], (400, 1))
    )
    for place, found, height in zip(xy, triangle, z, strict=True):
        a, b, c = (corners[:, k] for k in range(3))
        u, v = np.linalg.solve(np.stack([b - a, c - a], 2)[:, :2], (place - a[:, :2])[:, :, None])[:, :, 0].T
        heights = np.where((u >= 0) & (v >= 0) & (u + v <= 1), a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2], np.inf)
        if np.isinf(heights.min()):
            assert found == -1
            assert np.isinf(height)
        else:
            assert found == np.argmin(heights)
            assert height == pytest.approx(heights.min(), abs=1e-9)


def test_a_box_of_triangles_has_the_level_sets_of_the_block(tmp_path):
    solid = solid_box(tmp_path, 30, 20, 10)
    block = Block(width_mm=30, length_mm=20, thickness_mm=10)
    points = np.random.default_rng(3).uniform(-20, 20, (2000, 3))
    mine, theirs = solid.piece_distances(points), block.piece_distances(points)
    assert_allclose(mine[:, [0, -1]], theirs[:, [0, -1]], atol=1e-12)
    assert_allclose(np.sort(mine, axis=1), np.sort(theirs, axis=1), atol=1e-12)
    assert solid.is_convex
    assert solid.is_flat
    assert solid.volume_mm3 == pytest.approx(6000)
    assert solid.bounds_mm == block.bounds_mm


def test_inside_is_inside_and_distances_are_to_the_triangles_of_a_body_with_a_dent(tmp_path):
    solid = solid_bracket(tmp_path)
    assert not solid.is_convex
    points = np.random.default_rng(4).uniform([-8, -7, -2], [8, 7, 14], (3000, 3))
    assert_array_equal(solid.contains(points), in_bracket(points))
    inside = points[in_bracket(points)]
    brute = np.linalg.norm(inside[:200, None, None] - spread(bracket(), 60)[None], axis=3).min(axis=(1, 2))
    nearest_face = solid.piece_distances(inside[:200]).min(axis=1)
    assert_allclose(nearest_face, brute, atol=0.1)
    assert (nearest_face <= brute + 1e-12).all()
    corners = bracket()
    middle = corners.mean(axis=1)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    facing = np.einsum("tki,ti->tk", solid.piece_normals(middle), outward) < -1 + 1e-9
    of_piece = facing & (np.abs(solid.piece_distances(middle)) < 1e-9)
    assert_array_equal(of_piece.sum(axis=1), 1)  # every triangle belongs to one piece
    for k in range(len(solid.pieces)):
        own = spread(corners[of_piece[:, k]], 60)
        brute = np.linalg.norm(inside[:200, None, None] - own[None], axis=3).min(axis=(1, 2))
        assert_allclose(solid.piece_distances(inside[:200])[:, k], brute, atol=0.1)


def test_a_piece_goes_on_in_its_last_plane_beyond_its_edge(tmp_path):
    solid, dome = solid_dome(tmp_path, 1.0)
    rim = np.array([dome.base_radius_mm, 0.0, dome.height_mm])
    slope = np.array([dome.height_mm - dome.radius_mm, 0, -dome.base_radius_mm]) / dome.radius_mm
    beyond = rim - 0.3 * slope  # 0.3 mm further along the sphere's tangent, out of the body through its base
    sensing, held = solid.piece_distances(beyond[None])[0]
    assert held < -0.25
    assert abs(sensing) < 0.3 * np.sin(0.06) + 0.01  # facets of 1 mm are turned by up to 0.05 rad


@pytest.mark.parametrize("make", [lambda f: solid_bracket(f), lambda f: solid_dome(f, 1.5)[0]], ids=["bracket", "dome"])
def test_normals_are_gradients_of_the_distances(tmp_path, make):
    solid, step = make(tmp_path), 1e-6
    low, high = map(np.array, solid.bounds_mm)
    points = np.random.default_rng(5).uniform(low - 2, high + 2, (400, 3))
    slope = np.stack(
        [
            (solid.piece_distances(points + d) - solid.piece_distances(points - d)) / (2 * step)
            for d in step * np.eye(3)
        ],
        axis=2,
    )
    wrong = np.linalg.norm(slope - solid.piece_normals(points), axis=2) > 1e-5
    assert wrong.mean() < 0.01  # where two triangles are equally near, there is no gradient


def test_a_facetted_dome_is_as_far_from_the_true_one_as_the_chords_say(tmp_path):
    off = []
    for edge in (2.0, 1.0):
        solid, dome = solid_dome(tmp_path, edge)
        points = dome.chart_points(np.random.default_rng(6).uniform(-6, 6, (3000, 2)))
        off.append(np.abs(solid.depth(points)).max())
        assert off[-1] < 1.7 * edge**2 / (6 * dome.radius_mm)
        inside = dome.chart_points(np.random.default_rng(7).uniform(-4, 4, (500, 2)), 2.0)
        assert_allclose(solid.depth(inside), 2.0, atol=off[-1] + 1e-9)
    assert 3 < off[0] / off[1] < 5


def test_a_surface_knows_its_dents(tmp_path):
    solid = solid_bracket(tmp_path)
    on = np.array([[0.0, 0, 0], [6, 0, 2], [3, 0, 4]])
    assert_allclose(solid.stands_out(on, np.array([[0.0, 0, 1], [-1, 0, 0], [0, 0, -1]])), [0, 0, 8])
    assert Surface.welded(bracket(), "it").volume_mm3 == pytest.approx(960)
