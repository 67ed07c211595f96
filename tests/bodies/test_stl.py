"""STL files are never trusted: every bad one ends with exit code 2 and a message that says what is wrong with it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from stl_shapes import box, bracket, facetted_dome, write_stl, write_text_stl

from twin.cli import main
from twin.errors import InputError
from twin.geometry.closed import closed_surface
from twin.geometry.stl import read_triangles
from twin.parts.body import Dome

BOX = box(12, 10, 8)

SCENE = """
[body]
shape = "solid"
file = "{file}"
[body.held]
normal = [0, 0, 1]
[body.sensing]
normal = [0, 0, -1]
[material]
youngs_modulus_mpa = 1.0
"""


def truncated(path):
    write_stl(path, BOX)
    path.write_bytes(path.read_bytes()[:-60])


def longer_than_declared(path):
    write_stl(path, BOX, count=5)


def four_thousand_million_triangles(path):
    write_stl(path, BOX, count=4_000_000_000)


def too_many_triangles(path):
    count = 500_000
    path.write_bytes(b" " * 80 + count.to_bytes(4, "little"))
    with path.open("r+b") as file:
        file.truncate(84 + 50 * count)


def not_a_number(path):
    corners = BOX.copy()
    corners[3, 1, 2] = np.nan
    write_stl(path, corners)


def infinite(path):
    corners = BOX.copy()
    corners[0] = np.inf
    write_stl(path, corners)


def a_hole(path):
    write_stl(path, BOX[1:])


def two_bodies(path):
    write_stl(path, np.concatenate([BOX, BOX + np.array([20, 0, 0])]))


def a_hollow(path):
    write_stl(path, np.concatenate([BOX, (box(6, 5, 4) + np.array([0, 0, 2]))[:, ::-1]]))


def inside_out(path):
    write_stl(path, BOX[:, ::-1])


def one_triangle_turned(path):
    corners = BOX.copy()
    corners[5] = corners[5][::-1]
    write_stl(path, corners)


def a_sheet(path):
    write_stl(path, box(12, 10, 0.1))


def without_thickness(path):
    write_stl(path, np.concatenate([BOX[:2], BOX[:2, ::-1]]))


def one_mm(path):
    write_stl(path, box(1, 1, 1))


def ten_metres(path):
    write_stl(path, box(10_000, 10, 8))


def a_needle(path):
    corners = BOX.copy()
    a, b, c = corners[0]
    split = [[a, b, (a + b) / 2], [a, (a + b) / 2, c], [(a + b) / 2, b, c]]
    write_stl(path, np.concatenate([corners[1:], split]))


def empty(path):
    path.write_bytes(b"")


def a_picture(path):
    path.write_bytes(bytes(range(256)) * 40)


def missing(path):
    pass


def truncated_text(path):
    write_text_stl(path, BOX)
    path.write_text(path.read_text()[:-200])


def text_with_words_for_numbers(path):
    write_text_stl(path, BOX)
    path.write_text(path.read_text().replace("vertex 6", "vertex six", 1))


BAD = [
    (truncated, "declares 12 triangles, which take 684 bytes, but has 624"),
    (longer_than_declared, "declares 5 triangles"),
    (four_thousand_million_triangles, "declares 4000000000 triangles"),
    (too_many_triangles, "500000 triangles .allowed: 4 to 400000"),
    (not_a_number, "1 of 12 triangles have corners that are not finite, the first is number 3"),
    (infinite, "not finite"),
    (a_hole, "not watertight: 3 edges"),
    (two_bodies, "2 separate surfaces"),
    (a_hollow, "2 separate surfaces"),
    (inside_out, "wound inwards"),
    (one_triangle_turned, "wound against each other"),
    (a_sheet, "mean thickness .* is 0.0982 mm .allowed: at least 0.5"),
    (without_thickness, "not watertight|no area|thickness|separate"),
    (one_mm, "longest side is 1 mm .allowed: 5 to 500 mm"),
    (ten_metres, "longest side is 10000 mm"),
    (a_needle, "no area|not watertight"),
    (empty, "0 bytes are no STL"),
    (a_picture, "declares .* truncated or no STL"),
    (missing, "there is no such file"),
    (truncated_text, "truncated or no STL"),
    (text_with_words_for_numbers, "no number .*six"),
]


@pytest.mark.parametrize(("make", "words"), BAD, ids=lambda value: getattr(value, "__name__", ""))
def test_a_bad_file_ends_with_exit_code_2_and_says_what_is_wrong(tmp_path, capsys, make, words):
    make(tmp_path / "thing.stl")
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.format(file="thing.stl"))
    with pytest.raises(SystemExit) as ended:
        main(["mesh", str(scene)])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert "thing.stl" in said
    assert "Traceback" not in said
    assert re.search(words, said), said


def test_binary_and_text_give_the_same_triangles(tmp_path):
    corners = np.asarray(facetted_dome(Dome(radius_mm=10, height_mm=7), 3.0), np.float32).astype(float)
    binary = read_triangles(write_stl(tmp_path / "b.stl", corners))
    text = read_triangles(write_text_stl(tmp_path / "t.stl", corners))
    np.testing.assert_array_equal(binary, corners)
    np.testing.assert_allclose(text, corners, rtol=1e-8, atol=1e-8)


def test_a_binary_file_whose_header_says_solid_is_read(tmp_path):
    path = write_stl(tmp_path / "s.stl", BOX)
    path.write_bytes(b"solid made by a program" + path.read_bytes()[23:])
    np.testing.assert_array_equal(read_triangles(path), BOX)


@pytest.mark.parametrize(("corners", "volume", "vertices"), [(BOX, 960, 8), (bracket(), 960, 12)])
def test_a_good_surface_is_welded_and_its_volume_is_exact(corners, volume, vertices):
    surface = closed_surface(corners, "it")
    assert surface.volume_mm3 == pytest.approx(volume, rel=1e-12)
    assert len(surface.vertices) == vertices
    assert len(surface.triangles) == len(corners)


def test_corners_that_differ_by_rounding_are_welded():
    dome = facetted_dome(Dome(radius_mm=10, height_mm=7), 1.0)
    noise = np.random.default_rng(1).uniform(-1e-6, 1e-6, dome.shape)
    exact = closed_surface(dome, "it")
    rounded = closed_surface(dome + noise, "it")
    assert len(rounded.vertices) == len(exact.vertices)
    assert rounded.volume_mm3 == pytest.approx(exact.volume_mm3, rel=1e-6)
    with pytest.raises(InputError, match="not watertight"):
        closed_surface(dome + 1e3 * noise, "it")
