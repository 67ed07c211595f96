"""STL files are never trusted: every bad one gives exit code 2 and says what is wrong."""

import re
import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import DOME, write_stl
from stl_shapes import box, bracket, facetted_dome, write_text_stl

from twin.cli import main
from twin.errors import InputError
from twin.geometry.closed import Surface

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
def test_a_bad_file_ends_with_exit_code_2_and_says_what_is_wrong(tmp_path, capsys, name):
    path = tmp_path / "thing.stl"
    if name in SHAPES:
        corners, words = SHAPES[name]
        write_stl(path, corners)
    else:
        make, words = FILES[name]
        make(path)
    (tmp_path / "scene.toml").write_text(SCENE)
    with pytest.raises(SystemExit) as ended:
        main(["mesh", str(tmp_path / "scene.toml")])
    said = capsys.readouterr().err
    assert ended.value.code == 2
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
