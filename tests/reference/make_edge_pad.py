"""How edge_pad.npz was made: fields of a 25 x 25 x 4 mm pad loaded 2 mm from its edge, by NGSolve 6.2.

    python tests/reference/make_edge_pad.py tests/reference/edge_pad.npz

Taylor-Hood elements of order 4 (pressure 3), without any half-space; tetrahedra fine under the load and at the clamped
rim near it. E = 1 MPa. Solved on two meshes; the finer one is stored and the difference of the two, over the largest
displacement, is `error`: 1e-3, mostly the coarser one's. Needs ngsolve (the extra `peers`) and five minutes.
"""

import sys

import ngsolve as ng
import numpy as np
from netgen.meshing import MeshingParameters
from netgen.occ import Box, OCCGeometry, Pnt

SIDE, HEIGHT, CENTRE, RADIUS, ORDER = 25.0, 4.0, (10.5, -4.0), 0.8, 4
FORCES = ((0, 0, 1), (1, 0, 0), (0, 1, 0))
RATIOS = (0.3, 0.45, 0.5)
MESHES = ((0.33, 0.1, 1.0), (0.5, 0.14, 1.3))
"""Edges under the load over its radius, at the rim below it and far away over the height; the finer mesh first."""


def pad_mesh(share, rim, coarse):
    """Return the mesh."""
    half = SIDE / 2
    body = Box(Pnt(-half, -half, 0), Pnt(half, half, HEIGHT))
    for face in body.faces:
        face.name = {0.0: "top", HEIGHT: "held"}.get(round(face.center.z, 6), "free")
    wanted = MeshingParameters(maxh=coarse * HEIGHT, grading=0.4)
    for part in (0, 0.5, 1, 1.4):
        for turn in np.linspace(0, 2 * np.pi, 20, endpoint=False):
            x, y = CENTRE + part * RADIUS * np.array([np.cos(turn), np.sin(turn)])
            wanted.RestrictH(x=x, y=y, z=0, h=share * RADIUS)
    along = np.linspace(-half, half, 120)
    for x, y in [(s, t) for s in along for t in (-half, half)] + [(s, t) for t in along for s in (-half, half)]:
        away = np.hypot(x - CENTRE[0], y - CENTRE[1])
        if away < 3 * HEIGHT:
            wanted.RestrictH(x=x, y=y, z=HEIGHT, h=rim * HEIGHT * max(0.5, away / HEIGHT))
    return ng.Mesh(OCCGeometry(body).GenerateMesh(wanted))


def fields(mesh, nu, points):
    """Return the (3, n, 3) displacements under the three forces."""
    mu, softness = 0.5 / (1 + nu), (1 - 2 * nu) * (1 + nu) / nu
    space = ng.VectorH1(mesh, order=ORDER, dirichlet="held") * ng.H1(mesh, order=ORDER - 1)
    (u, p), (v, q) = space.TnT()
    strain, test = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    form = 2 * mu * ng.InnerProduct(strain, test) - ng.div(u) * q - ng.div(v) * p - softness * p * q
    exact = ng.BilinearForm(form * ng.dx, symmetric=True).Assemble()
    shifted = ng.BilinearForm((form - 1e-5 / mu * p * q) * ng.dx, symmetric=True).Assemble()
    inverse = shifted.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    free = ng.Projector(space.FreeDofs(), True)
    squared = (ng.x - CENTRE[0]) ** 2 + (ng.y - CENTRE[1]) ** 2 + ng.z**2
    bump = ng.IfPos(RADIUS**2 - squared, (1 - squared / RADIUS**2) ** 2, 0)
    top, found = ng.ds("top", bonus_intorder=14), []
    total = ng.Integrate(bump * top, mesh)
    for force in FORCES:
        load = ng.LinearForm(bump / total * sum(f * v[i] for i, f in enumerate(force)) * top).Assemble()
        answer, right = ng.GridFunction(space), load.vec.CreateVector()
        for _ in range(10):
            right.data = free * (load.vec - exact.mat * answer.vec)
            answer.vec.data += inverse * right
        right.data = free * (load.vec - exact.mat * answer.vec)
        assert ng.Norm(right) < 1e-8 * ng.Norm(load.vec)
        found.append([answer.components[0](mesh(*point)) for point in points])
    return np.array(found)


def main(path):
    """Write the reference."""
    around = np.array([(0, 0), (0.5, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1.6, 0.5), (-1.7, -0.8), (2.5, 1)])
    depths = (0.1, 0.15, 0.3, 0.6, 1.2, 2.4)
    points = np.array([(*(CENTRE + RADIUS * at), depth) for depth in depths for at in around])
    points = points[points[:, 0] < SIDE / 2 - 0.098]
    fine, coarse = (np.array([fields(pad_mesh(*sizes), nu, points) for nu in RATIOS]) for sizes in MESHES)
    size = np.linalg.norm(fine, axis=3).max(axis=2)
    error = (np.linalg.norm(fine - coarse, axis=3).max(axis=2) / size).max(axis=1)
    np.savez_compressed(path, points=points, forces=FORCES, ratios=RATIOS, displacement_mm=fine, error=error)


if __name__ == "__main__":
    main(sys.argv[1])
