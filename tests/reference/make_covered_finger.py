"""How covered_finger.npz was made: a finger under a cover ten times stiffer, by an independent code (NGSolve 6.2).

    python tests/reference/make_covered_finger.py tests/reference/covered_finger.npz

Taylor-Hood elements of order 3 (pressure 2, one for each material) on curved elements of body and cover, without any
half-space: a bump of 1 mm radius and 1 N at (1, 0.5) mm on the true surface, fine elements around it. E = 1 and 10 MPa,
nu = 0.5 in both. Solved on two meshes; the finer one is stored, and the two differ by 0.08 % (normal) and 0.04 %
(sideways) of the largest displacement. Needs ngsolve (the extra `peers`) and some minutes.
"""

import sys

import ngsolve as ng
import numpy as np
from netgen.occ import Box, Cylinder, Glue, OCCGeometry, Pnt, Sphere, X, Z

from twin.parts.body import Finger

RADIUS, COVER, RATIO, ORDER, BUMP, AT = 8.0, 0.2, 10.0, 3, 1.0, (1.0, 0.5)
NEAR_MM, COARSE_MM, FINE_MM = 2.0, 2.0, (0.4, 0.32)
OFFSETS = np.array([[-2, 0], [-0.8, 0.3], [0, 0], [0.6, -0.5], [1.5, 1], [0, 3]])
DEPTHS = (0.05, 0.3, 0.5, 1.0, 2.0, 4.0)


def solid(radius):
    """Return all points within ``radius`` of the finger's core, down to the base."""
    round_top = Cylinder(Pnt(-8, 0, RADIUS), X, r=radius, h=8) + Sphere(Pnt(0, 0, RADIUS), radius)
    tip = Cylinder(Pnt(0, 0, RADIUS), Z, r=radius, h=2) * Box(Pnt(0, -20, 0), Pnt(20, 20, 20))
    skirt = Box(Pnt(-8, -radius, RADIUS), Pnt(0, radius, RADIUS + 2)) + tip
    return round_top * Box(Pnt(-8, -20, -1), Pnt(20, 20, RADIUS)) + skirt


def layered_mesh(centre, fine):
    """Return the curved mesh of body and cover, its elements ``fine`` within `NEAR_MM` of the load."""
    core, ball = solid(RADIUS - COVER), Sphere(Pnt(*centre), NEAR_MM)
    cover = solid(RADIUS) - core
    shape = Glue([core - ball, core * ball, cover - ball, cover * ball])
    for part, name, size in zip(
        shape.solids, ("body", "body", "cover", "cover"), (COARSE_MM, fine, COARSE_MM, fine), strict=True
    ):
        part.mat(name)
        part.maxh = size
    for face in shape.faces:
        if abs(face.center.z - RADIUS - 2) < 1e-6:
            face.name = "held"
    return ng.Mesh(OCCGeometry(shape).GenerateMesh(maxh=COARSE_MM, grading=0.4)).Curve(ORDER)


def fields(mesh, centre, points):
    """Return {case: (n, 3) displacements in mm} under the bump along z and along x."""
    pressures = [
        ng.Compress(ng.H1(mesh, order=ORDER - 1, definedon=mesh.Materials(name))) for name in ("body", "cover")
    ]
    space = ng.VectorH1(mesh, order=ORDER, dirichlet="held") * pressures[0] * pressures[1]
    (u, p1, p2), (v, q1, q2) = space.TnT()
    exact, shifted = ng.BilinearForm(space, symmetric=True), ng.BilinearForm(space, symmetric=True)
    for name, modulus, p, q in (("body", 1.0, p1, q1), ("cover", RATIO, p2, q2)):
        shear, here = modulus / 3.0, ng.dx(definedon=mesh.Materials(name))
        deviator = ng.Sym(ng.Grad(u)) - ng.div(u) / 3 * ng.Id(3)
        form = (2 * shear * ng.InnerProduct(deviator, ng.Sym(ng.Grad(v))) + p * ng.div(v) + q * ng.div(u)) * here
        exact += form
        shifted += form
        shifted += -1e-5 / shear * p * q * here
    exact.Assemble()
    shifted.Assemble()
    inverse = shifted.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    free = ng.Projector(space.FreeDofs(), True)
    squared = sum((a - c) ** 2 for a, c in zip((ng.x, ng.y, ng.z), centre, strict=True))
    right_of, above = ng.IfPos(ng.x, ng.x, 0), ng.IfPos(RADIUS - ng.z, RADIUS - ng.z, 0)
    outside = ng.IfPos(ng.sqrt(right_of**2 + ng.y**2 + above**2) - RADIUS + COVER / 2, 1, 0)
    bump = ng.IfPos(BUMP**2 - squared, (1 - squared / BUMP**2) ** 2, 0) * outside
    total = ng.Integrate(bump, mesh, ng.BND, order=20)
    found = {}
    for name, axis in (("normal", 2), ("sideways", 0)):
        load = ng.LinearForm(bump / total * v[axis] * ng.ds(bonus_intorder=8)).Assemble()
        answer, right = ng.GridFunction(space), load.vec.CreateVector()
        for _ in range(12):
            right.data = free * (load.vec - exact.mat * answer.vec)
            answer.vec.data += inverse * right
        right.data = free * (load.vec - exact.mat * answer.vec)
        assert ng.Norm(right) < 1e-9 * ng.Norm(load.vec)
        displacement = answer.components[0]
        found[name] = np.array([displacement(mesh(*point)) for point in points])
    return found


def main(path, sizes=FINE_MM):
    """Solve on both meshes and store the finer answer."""
    body = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
    centre = body.surface_from_above(np.array([AT]))[0]
    chart = body.chart_of(centre[None])[0] + OFFSETS
    points = np.vstack([body.chart_points(chart, depth) for depth in DEPTHS])
    coarse, fine = (fields(layered_mesh(centre, size), centre, points) for size in sizes)
    for name, field in fine.items():
        differ = np.linalg.norm(coarse[name] - field, axis=1).max() / np.linalg.norm(field, axis=1).max()
        print(f"{name}: the two meshes differ by {differ:.1e}")
    np.savez_compressed(path, points=points, **fine)


if __name__ == "__main__":
    main(sys.argv[1])
