"""The page on linearity: its tables are the stored results; the study's referee knows a closed form."""

from __future__ import annotations

import re

import numpy as np
import pytest

from benchmarks.validity_page import MARKS, PAGE, page_tables
from twin.parts.body import Block
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import quadratic, snapped


def test_tables_are_the_stored_rows() -> None:
    section = re.search(MARKS, PAGE.read_text(), re.DOTALL)
    assert section is not None
    shown = section.group(0).removeprefix("<!-- results -->\n").removesuffix("<!-- end of results -->")
    assert shown == page_tables(), "run: python -m benchmarks.validity_page"


def cube() -> Mesh:
    """A block of 6 x 6 x 6 mm in 6 x 27 tetrahedra around the corners of 3 x 3 x 3 cells."""
    ticks = np.linspace(0.0, 6.0, 4)
    points = np.stack(np.meshgrid(ticks - 3, ticks - 3, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(64).reshape(4, 4, 4)
    steps = np.array([[(0, 0, 0), a, b, (1, 1, 1)] for a, b in (
        ((1, 0, 0), (1, 1, 0)), ((1, 1, 0), (0, 1, 0)), ((0, 1, 0), (0, 1, 1)),
        ((0, 1, 1), (0, 0, 1)), ((0, 0, 1), (1, 0, 1)), ((1, 0, 1), (1, 0, 0)),
    )])  # fmt: skip
    corner = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 1, 3) + steps
    tets = number[tuple(np.moveaxis(corner, -1, 0))].reshape(-1, 4)
    body = Block(width_mm=6, length_mm=6, thickness_mm=6)
    on_surface, triangles, piece = snapped(body, points, tets)
    return Mesh(**vars(quadratic(body, on_surface, tets, triangles, piece)))


def test_referee_squeezes_a_bar_as_the_closed_form_does() -> None:
    """Uniform stretch l: nominal stress (l - 1/l^2)/3 on the pressed face, nothing on the sides or inside."""
    pytest.importorskip("felupe", reason="an independent program, of the extra 'peers'")
    from benchmarks.neohooke import Rubber

    mesh, stretch = cube(), 0.8
    rubber, points, corners = Rubber(mesh), mesh.points, mesh.corners
    moved = points * [stretch**-0.5 - 1, stretch**-0.5 - 1, stretch - 1]
    # felupe splits the volume off: its pressure is what is left of the deviatoric stress along the free sides
    pressure = (stretch**2 - 1 / stretch) / 3 / 3
    unknowns = np.concatenate([moved.ravel(), np.full(corners, pressure), np.full(corners, 1 + pressure / 1e4)])
    force = rubber.displacement(rubber.resistance(unknowns))
    face = np.isclose(points[:, 2], 0)
    assert force[face].sum(axis=0)[2] == pytest.approx(-36 * (stretch - stretch**-2) / 3, rel=1e-3)
    both = face | np.isclose(points[:, 2], 6)
    assert np.abs(force[~both]).max() < 1e-3 * np.abs(force).max()
