"""Meshes for other programs: VTK's unstructured grids (.vtu), which ParaView and pyvista open."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin.errors import InputError
from twin.parts.body import Body
from twin.world.mesh.mesh import Mesh

VTK_QUADRATIC_TETRA = 24


def export_mesh(mesh: Mesh, body: Body, path: Path) -> None:
    """Write a mesh with the depth of its nodes below the sensing surface.

    Raises
    ------
    InputError
        The name does not end in .vtu, or the file can't be written.
    """
    if path.suffix != ".vtu":
        raise InputError(f"{path}: a mesh is exported as .vtu")
    import pyvista

    grid = pyvista.UnstructuredGrid({VTK_QUADRATIC_TETRA: np.asarray(mesh.tets)}, np.array(mesh.points))
    grid.point_data["depth_mm"] = body.depth(mesh.points)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        grid.save(path)
    except OSError as problem:
        raise InputError(f"{path}: can't be written ({problem.strerror or problem})") from None
