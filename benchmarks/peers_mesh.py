"""Meshes for other programs: graded to the load and to the clamped rim, by Netgen, the load's edge a mesh line.

A general program has no half-space to take off, so its mesh must resolve the load. The mesh is the same for every peer:
Netgen's own for NGSolve, and with curved quadratic tetrahedra in `Mesh` form for the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.reference import BODIES
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.snap import quadratic, signed_volumes, snapped

BUMP_MM, PATCH_MM = 2.0, 4.0
"""Radius of the finger's load and side of the block's, mm, both at the origin."""


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Wanted edge lengths, mm: at the load's edge, on the load, at the clamped rim, anywhere; and Netgen's grading.

    ``halved`` is how many times every edge is halved afterwards.
    """

    ring: float
    load: float
    rim: float
    far: float
    grading: float
    halved: int = 0


def netgen_mesh(body: str, edges: Edges) -> Any:
    """Return NGSolve's mesh of ``block`` or ``finger``, its boundary named load, free and held; not curved yet."""
    import ngsolve as ng
    from netgen.meshing import MeshingParameters
    from netgen.occ import OCCGeometry

    wanted = MeshingParameters(maxh=edges.far, grading=edges.grading)
    shape = _block(edges) if body == "block" else _finger(edges, wanted)
    mesh = ng.Mesh(OCCGeometry(shape).GenerateMesh(wanted))
    for _ in range(edges.halved):
        mesh.Refine()
    return mesh


def _block(edges: Edges) -> Any:
    from netgen.occ import Axes, Box, Glue, Pnt, WorkPlane, X, Z

    block, half = BODIES["block"], PATCH_MM / 2
    (x0, y0, z0), (x1, y1, z1) = block.bounds_mm
    patch = WorkPlane(Axes((-half, -half, 0), n=Z, h=X)).Rectangle(PATCH_MM, PATCH_MM).Face()
    patch.faces.name, patch.faces.maxh, patch.edges.maxh = "load", edges.load, edges.ring
    glued = Glue([Box(Pnt(x0, y0, z0), Pnt(x1, y1, z1)), patch])
    for face in glued.faces:
        if face.name != "load":
            face.name = "held" if abs(face.center.z - z1) < 1e-6 else "free"
        if face.name == "held":
            face.edges.maxh = edges.rim
    return glued


def _finger(edges: Edges, wanted: Any) -> Any:
    from netgen.occ import Box, Cylinder, HalfSpace, Pnt, Sphere, Vec, X, Z

    finger = BODIES["finger"]
    (x0, _, _), (_, _, base) = finger.bounds_mm
    radius = base - 2.0
    centre = Pnt(0, 0, radius)
    dome = (Sphere(centre, radius) + Cylinder(Pnt(x0, 0, radius), X, r=radius, h=-x0)) * HalfSpace(centre, Vec(0, 0, 1))
    foot = Cylinder(centre, Z, r=radius, h=base - radius) + Box(Pnt(x0, -radius, radius), Pnt(0, radius, base))
    shape = (dome + foot) * HalfSpace(Pnt(x0, 0, 0), Vec(-1, 0, 0))
    for face in shape.faces:
        middle = face.center
        held, back = abs(middle.z - base) < 1e-6, abs(middle.x - x0) < 1e-6
        face.name = "held" if held else ("free" if back else "load")
        if held:
            face.edges.maxh = edges.rim
    for share in (0.0, 0.35, 0.7, 1.0):
        for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False):
            x, y = share * BUMP_MM * np.cos(angle), share * BUMP_MM * np.sin(angle)
            z = radius - np.sqrt(radius**2 - y**2 - max(x, 0.0) ** 2)
            wanted.RestrictH(x=x, y=y, z=z, h=edges.ring if share == 1.0 else edges.load)
    return shape


def curved(netgen: Any, body: str) -> Mesh:
    """Return the same tetrahedra with mid-side nodes on the true surface."""
    points = np.array([vertex.point for vertex in netgen.vertices])
    tets = np.array([[node.nr for node in element.vertices] for element in netgen.Elements()])
    turned = signed_volumes(points, tets) < 0
    tets[np.ix_(turned, [2, 3])] = tets[np.ix_(turned, [3, 2])]
    shape = BODIES[body]
    on_surface, triangles, piece = snapped(shape, points, tets)
    return Mesh(**vars(quadratic(shape, on_surface, tets, triangles, piece)))
