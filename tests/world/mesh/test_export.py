"""The exported mesh opens elsewhere as what it is."""

from __future__ import annotations

from pathlib import Path

import pytest
import pyvista

from twin.errors import InputError
from twin.parts.body import Finger
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.export import export_mesh

FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)


def test_the_exported_mesh_has_the_bodys_volume(tmp_path: Path) -> None:
    mesh = body_mesh(FINGER, "nominal")
    export_mesh(mesh, FINGER, tmp_path / "deep" / "finger.vtu")
    grid = pyvista.read(tmp_path / "deep" / "finger.vtu")
    assert grid.n_cells == len(mesh.tets)
    assert grid.volume == pytest.approx(FINGER.volume_mm3, rel=0.02)  # straight tetrahedra cut the curved corners
    assert grid.point_data["depth_mm"].min() == pytest.approx(0, abs=1e-9)


def test_another_file_type_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"exported as \.vtu"):
        export_mesh(body_mesh(FINGER, "nominal"), FINGER, tmp_path / "finger.stl")
