"""STL files are never trusted: every bad one is refused with a cause; distances to the pieces of whole ones."""

import re
import tracemalloc

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import DOME, write_stl
from stl_shapes import (
    box,
    bracket,
    facetted_dome,
    solid_box,
    solid_bracket,
    solid_dome,
    solid_holed,
    solid_pad,
    write_text_stl,
)

from twin.errors import InputError
from twin.geometry.closed import Surface
from twin.geometry.pieces import TriangleTree
from twin.parts.body import Block, Solid

BOX = box(12, 10, 8)

SCENE = """
[body]
shape = "solid"
file = "thing.stl"
[body.held]
normal = [0, 0, 1]
[body.sensing]
normal = [0, 0, -1]
[material]
youngs_modulus_mpa = 1.0
"""


def changed(row, value):
    """Return the box with one number, corner or triangle replaced."""
    corners = BOX.copy()
    corners[row] = value
    return corners


def zeros_of_triangles(count):
    return b" " * 80 + count.to_bytes(4, "little") + bytes(50 * count)


def with_a_needle():
    a, b, c = BOX[0]
    split = [[a, b, (a + b) / 2], [a, (a + b) / 2, c], [(a + b) / 2, b, c]]
    return np.concatenate([BOX[1:], split])


def as_text(path, edit):
    write_text_stl(path, BOX)
    path.write_text(edit(path.read_text()))


OBJ = "# made by a program\no box\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
FACET = b"facet outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet\n"
CORNERS_ONLY = b"solid thing\n" + b"vertex 0 0 0\n" * 1_500_000 + b"endsolid thing\n"
MANY_FACETS = b"solid thing\n" + FACET * 450_000 + b"endsolid thing\n"
HOLLOW = (box(6, 5, 4) + np.array([0, 0, 2]))[:, ::-1]
SHAPES = {
    "not a number": (
        changed((3, 1, 2), np.nan),
        "1 of 12 triangles have corners that are not finite, the first is number 3",
    ),
    "infinite": (changed(0, np.inf), "not finite"),
    "hole": (BOX[1:], "not watertight: 3 edges"),
    "two bodies": (np.concatenate([BOX, BOX + np.array([20, 0, 0])]), "2 separate surfaces"),
    "hollow": (np.concatenate([BOX, HOLLOW]), "2 separate surfaces"),
    "inside out": (BOX[:, ::-1], "wound inwards"),
    "one turned": (changed(5, BOX[5][::-1]), "wound against each other"),
    "sheet": (box(12, 10, 0.1), "mean thickness .* is 0.0982 mm .allowed: at least 0.5"),
    "no thickness": (np.concatenate([BOX[:2], BOX[:2, ::-1]]), "not watertight|no area|thickness|separate"),
    "one mm": (box(1, 1, 1), "longest side is 1 mm .allowed: 5 to 500 mm.*if it is in inches, it is 25.4 mm"),
    "metres": (box(0.03, 0.02, 0.008), "if it is in metres, it is 30 mm long; export it in millimetres"),
    "ten metres": (box(10_000, 10, 8), "longest side is 10000 mm"),
    "needle": (with_a_needle(), "no area|not watertight"),
}
FILES = {
    "truncated": (
        lambda path: write_stl(path, BOX).write_bytes(path.read_bytes()[:-60]),
        "declares 12 triangles, which take 684 bytes, but has 624",
    ),
    "longer": (lambda path: write_stl(path, BOX, count=5), "declares 5 triangles"),
    "4e9 triangles": (lambda path: write_stl(path, BOX, count=4_000_000_000), "declares 4000000000 triangles"),
    "too many": (lambda path: path.write_bytes(zeros_of_triangles(500_000)), "500000 triangles .allowed: 4 to 400000"),
    "empty": (lambda path: path.write_bytes(b""), "0 bytes are no STL"),
    "picture": (lambda path: path.write_bytes(bytes(range(256)) * 40), "declares .* truncated or no STL"),
    "missing": (lambda _: None, "there is no such file"),
    "obj": (
        lambda path: path.write_text(OBJ),
        r"is an OBJ file, but an STL .* trimesh.load.'thing.stl', force='mesh'.\.export",
    ),
    "truncated text": (lambda path: as_text(path, lambda text: text[:-200]), "truncated or no STL"),
    "corners only": (lambda path: path.write_bytes(CORNERS_ONLY), "more than 0 corners for 0 whole triangles"),
    "too many in text": (lambda path: path.write_bytes(MANY_FACETS), "450000 triangles .allowed: 4 to 400000"),
    "words": (lambda path: as_text(path, lambda text: text.replace("vertex 6", "vertex six", 1)), "no number .*six"),
}


@pytest.mark.parametrize("name", [*SHAPES, *FILES])
def test_a_bad_file_ends_with_exit_code_2_and_says_what_is_wrong(tmp_path, says, name):
    path = tmp_path / "thing.stl"
    if name in SHAPES:
        corners, words = SHAPES[name]
        write_stl(path, corners)
    else:
        make, words = FILES[name]
        make(path)
    (tmp_path / "scene.toml").write_text(SCENE)
    said = says(2, "mesh", str(tmp_path / "scene.toml"))
    assert "thing.stl" in said
    assert "Traceback" not in said
    assert re.search(words, said), said


def test_binary_and_text_give_the_same_triangles(tmp_path):
    corners = np.asarray(facetted_dome(DOME, 3.0), np.float32).astype(float)
    exact = Surface.welded(corners, "it")
    for write, near in ((write_stl, 0.0), (write_text_stl, 1e-8)):
        made = Surface.read(str(write(tmp_path / "it.stl", corners)))
        assert_array_equal(made.triangles, exact.triangles)
        assert_allclose(made.vertices, exact.vertices, rtol=near, atol=near)


@pytest.mark.parametrize("content", [CORNERS_ONLY, MANY_FACETS], ids=["corners", "facets"])
def test_a_text_file_is_counted_before_it_is_parsed(tmp_path, content):
    (tmp_path / "thing.stl").write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError):
            Surface.read(str(tmp_path / "thing.stl"))
        most = tracemalloc.get_traced_memory()[1]
        assert most < len(content) + 1e6, "no more than the file itself"
    finally:
        tracemalloc.stop()


def test_a_binary_file_whose_header_says_solid_is_read(tmp_path):
    path = write_stl(tmp_path / "s.stl", BOX)
    path.write_bytes(b"solid made by a program" + path.read_bytes()[23:])
    assert_array_equal(Surface.read(str(path)).vertices, Surface.welded(BOX, "it").vertices)


@pytest.mark.parametrize(("corners", "volume", "vertices"), [(BOX, 960, 8), (bracket(), 960, 12)])
def test_a_good_surface_is_welded_and_its_volume_is_exact(corners, volume, vertices):
    surface = Surface.welded(corners, "it")
    assert surface.volume_mm3 == pytest.approx(volume, rel=1e-12)
    assert len(surface.vertices) == vertices
    assert len(surface.triangles) == len(corners)


def test_corners_that_differ_by_rounding_are_welded():
    dome = facetted_dome(DOME, 1.0)
    noise = np.random.default_rng(1).uniform(-1e-6, 1e-6, dome.shape)
    exact = Surface.welded(dome, "it")
    rounded = Surface.welded(dome + noise, "it")
    assert len(rounded.vertices) == len(exact.vertices)
    assert rounded.volume_mm3 == pytest.approx(exact.volume_mm3, rel=1e-6)
    with pytest.raises(InputError, match="not watertight"):
        Surface.welded(dome + 1e3 * noise, "it")


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
    """Of bent triangles on the surface that they stand for, and in the planes beyond it."""
    solid, step = make(tmp_path), 1e-6
    low, high = map(np.array, solid.bounds_mm)
    points = np.random.default_rng(5).uniform(low - 2, high + 2, (400, 3))
    if solid.chord_mm:
        points = solid.chart_points(points[:, :2] / 2)
    slope = np.stack(
        [
            (solid.piece_distances(points + d) - solid.piece_distances(points - d)) / (2 * step)
            for d in step * np.eye(3)
        ],
        axis=2,
    )
    wrong = np.linalg.norm(slope - solid.piece_normals(points), axis=2) > 1e-5
    assert wrong.mean() < 0.01  # where two triangles are equally near, there is no gradient


def test_bent_triangles_stand_for_the_curved_face_that_was_cut_into_them(tmp_path):
    """The flat ones lay up to 0.067 and 0.017 mm below the dome, their normals up to 6 degrees off its own."""
    for edge, off, off_deg in ((2.0, 4e-4, 0.06), (1.0, 3e-5, 0.02)):
        solid, dome = solid_dome(tmp_path, edge)
        assert solid.chord_mm > 0.015 * edge**2
        points = dome.chart_points(np.random.default_rng(6).uniform(-6, 6, (3000, 2)))
        assert np.abs(solid.depth(points)).max() < off
        turned = np.einsum("ni,ni->n", solid.piece_normals(points)[:, 0], dome.piece_normals(points)[:, 0])
        assert np.degrees(np.arccos(turned.clip(-1, 1))).max() < off_deg
        assert_allclose(solid.surface_from_above(points[:, :2]), points, atol=2 * off)
        inside = dome.chart_points(np.random.default_rng(7).uniform(-4, 4, (500, 2)), 2.0)
        assert_allclose(solid.depth(inside), 2.0, atol=7e-4 * edge**2)
        assert solid.volume_mm3 == pytest.approx(dome.volume_mm3, rel=4e-4 * edge**2)


def test_flat_faces_between_fillets_stay_flat_and_strips_straight(tmp_path):
    """The pad's fillets of 2 mm are strips of 15 degrees, whose triangles lie 0.017 mm off them."""
    solid, rng = solid_pad(tmp_path), np.random.default_rng(8)
    turn, along = np.radians(rng.uniform(0, 60, 300)), rng.uniform(-5.9, 5.9, 300)
    fillet = np.column_stack([10 + 2 * np.sin(turn), along, 2 - 2 * np.cos(turn)])
    assert np.abs(solid.depth(fillet)).max() < 2e-4
    flat = np.column_stack([1.6 * along, along, np.zeros(300)])
    assert np.abs(solid.depth(flat)).max() < 1e-12
    side = np.column_stack([np.full(300, 12.0), along, 2 + np.abs(along) / 2])
    assert np.abs(solid.piece_distances(side).min(axis=1)).max() < 1e-6


def test_between_chord_and_arc_a_flat_face_goes_on_in_a_body_with_a_dent_too(tmp_path):
    """Points of the plane z = 6 there were taken for others far away, and nodes for none of any mesh that passes."""
    profile = np.array([(0, 6), (9, 6), (9, 3), (4, 3), (4, 0), (0, 0)], float)[::-1]
    stepped = trimesh.creation.revolve(profile, sections=24).triangles
    file = str(write_stl(tmp_path / "stepped.stl", np.asarray(stepped)))
    ends = [{"plane": {"point_mm": (0, 0, z), "normal": (0, 0, way)}} for z, way in ((6, 1), (0, -1))]
    solid = Solid(file=file, held=ends[0], sensing=ends[1])
    assert solid.pieces[-1] == "held"
    turn = np.linspace(0, 2 * np.pi, 200)
    for radius in (8.9, 8.95, 8.99, 9.0):
        place = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(200, 6.0)])
        assert np.abs(solid.piece_distances(place)[:, -1]).max() < 1e-9
        assert np.abs(solid.piece_distances(place).min(axis=1)).max() < 1e-3


def test_the_wall_of_a_hole_is_bent_into_the_rubber_and_ends_at_the_flat_sides(tmp_path):
    """A hole of 2 mm radius along y, cut into 16 chords that lie up to 0.038 mm inside of it."""
    solid, rng = solid_holed(tmp_path), np.random.default_rng(9)
    turn, along = rng.uniform(0, 2 * np.pi, 400), rng.uniform(-6, 6, 400)
    along[:100] = np.where(along[:100] > 0, 6.0, -6.0)
    away = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    middle = np.column_stack([0 * along, along, 0 * along + 4.0])
    for radius in (1.97, 2.0, 2.03):
        distance = solid.piece_distances(middle + radius * away)
        wall = distance[:, np.abs(distance).max(axis=0) < 0.04]
        assert wall.shape[1] == 1
        assert np.abs(wall[:, 0] - (radius - 2.0)).max() < 1.5e-3
    assert solid.contains(middle + 2.005 * away, -1e-9).all()
    assert not solid.contains(middle + 1.995 * away).any()


def test_a_surface_knows_its_dents(tmp_path):
    solid = solid_bracket(tmp_path)
    on = np.array([[0.0, 0, 0], [6, 0, 2], [3, 0, 4]])
    assert_allclose(solid.stands_out(on, np.array([[0.0, 0, 1], [-1, 0, 0], [0, 0, -1]])), [0, 0, 8 / np.sqrt(98)])
    assert Surface.welded(bracket(), "it").volume_mm3 == pytest.approx(960)
