"""Makes dome.npz, edge_pad.npz and covered_finger.npz: linear displacements under bumps, by NGSolve 6.2.

    python tests/reference/make_linear.py dome [FILE]     # or edge_pad, covered_finger; needs the extra `peers`

Taylor-Hood elements, curved where the body is, without any half-space; the mesh is fine under the load and towards the
clamped rim. Every field is solved on two meshes, of which the finer one is stored. The difference of the two, over the
largest displacement, is stored as the reference's own error (of the covered finger it is 0.08 % and 0.04 %). Each
body takes about five minutes.

* dome: the round dome, two bumps along x and z, three Poisson's ratios; order 4.
* edge_pad: a 25 x 25 x 4 mm pad loaded 2 mm from its edge, along all axes; order 4.
* covered_finger: a finger under a cover ten times stiffer, one bump along z and x; order 3.
"""

import json
import sys
from pathlib import Path

import ngsolve as ng
import numpy as np
from netgen.meshing import MeshingParameters
from netgen.occ import Box, Cylinder, Glue, HalfSpace, OCCGeometry, Pnt, Sphere, Vec, X, Z

from twin.parts.body import Dome, Finger


def displacements(mesh, order, materials, bump, on, forces, points, deviatoric=False):
    """Return (forces, n, 3) displacements in mm of points under a traction in the shape of ``bump``.

    ``materials`` are Young's modulus and Poisson's ratio by name, each with a pressure of its own. A little is taken
    off the pressure block for the factorisation, and the answer refined against the true matrix. ``deviatoric``: shear
    resists the strain without its change of volume.
    """
    moves = ng.VectorH1(mesh, order=order, dirichlet="held")
    pressures = [ng.Compress(ng.H1(mesh, order=order - 1, definedon=mesh.Materials(name))) for name in materials]
    space = ng.ProductSpace(moves, *pressures)
    (u, *p), (v, *q) = space.TnT()
    strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    if deviatoric:
        strain -= ng.div(u) / 3 * ng.Id(3)
    exact, shifted = (ng.BilinearForm(space, symmetric=True) for _ in range(2))
    for number, (name, (modulus, nu)) in enumerate(materials.items()):
        shear, here = modulus / 2 / (1 + nu), ng.dx(definedon=mesh.Materials(name))
        squeezed = p[number] * q[number]
        form = 2 * shear * ng.InnerProduct(strain, virtual) - ng.div(u) * q[number] - ng.div(v) * p[number]
        form -= (1 - 2 * nu) * (1 + nu) / (modulus * nu) * squeezed
        exact += form * here
        shifted += (form - 1e-5 / shear * squeezed) * here
    exact.Assemble()
    inverse = shifted.Assemble().mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    free, total = ng.Projector(space.FreeDofs(), True), ng.Integrate(bump * on, mesh)
    found = []
    for force in forces:
        load = ng.LinearForm(bump / total * sum(f * v[i] for i, f in enumerate(force)) * on).Assemble()
        answer, right = ng.GridFunction(space), load.vec.CreateVector()
        right.data = free * load.vec
        for _ in range(12):
            answer.vec.data += inverse * right
            right.data = free * (load.vec - exact.mat * answer.vec)
        assert ng.Norm(right) < 1e-8 * ng.Norm(load.vec)
        found.append([answer.components[0](mesh(*point)) for point in points])
    return np.array(found)


def bump_at(centre, radius):
    """Return (1 - r^2 / radius^2)^2 within a radius of a place."""
    squared = sum((a - c) ** 2 for a, c in zip((ng.x, ng.y, ng.z), centre, strict=True))
    return ng.IfPos(radius**2 - squared, (1 - squared / radius**2) ** 2, 0)


def own_error(coarse, fine):
    """Return the largest difference over the largest displacement of fields (..., n, 3)."""
    return np.linalg.norm(fine - coarse, axis=-1).max(axis=-1) / np.linalg.norm(fine, axis=-1).max(axis=-1)


def circle(count):
    """Return (count, 2) even places on the unit circle."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)])


DOME = Dome(radius_mm=10, height_mm=7)
DOME_BUMP, DOME_PLACES = 2.0, {"apex": (0.0, 0.0), "side": (5.0, 0.0)}
"""Radius of the bumps, mm, and arc lengths (s, t) of their centres."""


def dome_mesh(fine, rim, coarse):
    """Return the curved mesh: edges ``fine`` under both bumps, ``rim`` at the clamped rim, ``coarse`` elsewhere, mm."""
    body = Sphere(Pnt(0, 0, 10), 10) * HalfSpace(Pnt(0, 0, 7), Vec(0, 0, 1))
    for face in body.faces:
        face.name = "held" if abs(face.center.z - 7) < 1e-6 else "sensing"
    wanted = MeshingParameters(maxh=coarse, grading=0.35)
    rings = np.vstack([np.zeros((1, 2)), *(share * DOME_BUMP * circle(24) for share in (0.35, 0.7, 1.0))])
    for centre in DOME_PLACES.values():
        for x, y, z in DOME.chart_points(rings + centre):
            wanted.RestrictH(x=x, y=y, z=z, h=fine)
    for x, y in DOME.base_radius_mm * circle(200):
        wanted.RestrictH(x=x, y=y, z=7, h=rim)
    return ng.Mesh(OCCGeometry(body).GenerateMesh(wanted)).Curve(4)


def dome(path, sizes=((0.75, 0.7, 3.0), (0.5, 0.45, 2.2))):
    """Write the dome's fields: 5 x 5 and 4 x 4 markers at two depths, and 150 points at random."""
    rng = np.random.default_rng(20)
    five, four = (np.stack(np.meshgrid(*[2.5 * (np.arange(n) - (n - 1) / 2)] * 2, indexing="ij"), -1).reshape(-1, 2)
                  for n in (5, 4))  # fmt: skip
    charts = rng.uniform(-7, 7, (150, 2))
    places = [(five, 0.5), (four, 2.0), (charts, rng.uniform(0.3, 4, 150))]
    points = np.concatenate([DOME.chart_points(*each) for each in places])
    points = points[points[:, 2] < 6.9]
    on, cases, data = ng.ds("sensing", bonus_intorder=12), [], {}
    meshes = [dome_mesh(*each) for each in sizes]
    for nu in (0.5, 0.49, 0.3):
        for name, chart in DOME_PLACES.items():
            centre, forces = DOME.chart_points(np.array([chart]))[0], {"x": (1, 0, 0), "z": (0, 0, 1)}
            bump = bump_at(centre, DOME_BUMP)
            coarse, fine = (
                displacements(mesh, 4, {"default": (0.5, nu)}, bump, on, forces.values(), points) for mesh in meshes
            )
            for (axis, force), error, field in zip(forces.items(), own_error(coarse, fine), fine, strict=True):
                key = f"{name}_{axis}_nu{nu:g}"
                load = {"kind": "bump", "centre_mm": centre.tolist(), "radius_mm": DOME_BUMP, "force_n": force}
                cases.append({"key": key, "nu": nu, "load": load, "error_estimate": float(error)})
                data[key] = field
    np.savez_compressed(path, points=points, cases=json.dumps(cases), **data)


SIDE, HEIGHT, EDGE_PLACE, EDGE_BUMP = 25.0, 4.0, (10.5, -4.0), 0.8


def pad_mesh(share, rim, coarse):
    """Return the mesh: edges under the load over its radius, at the rim below it and far away over the height."""
    half = SIDE / 2
    body = Box(Pnt(-half, -half, 0), Pnt(half, half, HEIGHT))
    for face in body.faces:
        face.name = {0.0: "top", HEIGHT: "held"}.get(round(face.center.z, 6), "free")
    wanted = MeshingParameters(maxh=coarse * HEIGHT, grading=0.4)
    for part in (0, 0.5, 1, 1.4):
        for x, y in EDGE_PLACE + part * EDGE_BUMP * circle(20):
            wanted.RestrictH(x=x, y=y, z=0, h=share * EDGE_BUMP)
    along = np.linspace(-half, half, 120)
    for x, y in [(s, t) for s in along for t in (-half, half)] + [(s, t) for t in along for s in (-half, half)]:
        away = np.hypot(x - EDGE_PLACE[0], y - EDGE_PLACE[1])
        if away < 3 * HEIGHT:
            wanted.RestrictH(x=x, y=y, z=HEIGHT, h=rim * HEIGHT * max(0.5, away / HEIGHT))
    return ng.Mesh(OCCGeometry(body).GenerateMesh(wanted))


def edge_pad(path, sizes=((0.5, 0.14, 1.3), (0.33, 0.1, 1.0))):
    """Write the pad's fields (ratio, force, n, 3) of E = 1 MPa, and the errors by ratio."""
    around = np.array([(0, 0), (0.5, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1.6, 0.5), (-1.7, -0.8), (2.5, 1)])
    depths, ratios, forces = (0.1, 0.15, 0.3, 0.6, 1.2, 2.4), (0.3, 0.45, 0.5), ((0, 0, 1), (1, 0, 0), (0, 1, 0))
    points = np.array([(*(EDGE_PLACE + EDGE_BUMP * at), depth) for depth in depths for at in around])
    points = points[points[:, 0] < SIDE / 2 - 0.098]
    bump, on = bump_at((*EDGE_PLACE, 0.0), EDGE_BUMP), ng.ds("top", bonus_intorder=14)
    coarse, fine = (
        np.array([displacements(mesh, 4, {"default": (1.0, nu)}, bump, on, forces, points) for nu in ratios])
        for mesh in (pad_mesh(*each) for each in sizes)
    )
    error = own_error(coarse, fine).max(axis=1)
    np.savez_compressed(path, points=points, forces=forces, ratios=ratios, displacement_mm=fine, error=error)


COVER_MM, NEAR_MM, FAR_MM = 0.2, 2.0, 2.0


def solid(radius):
    """Return all points within ``radius`` of the finger's core, down to the base."""
    round_top = Cylinder(Pnt(-8, 0, 8), X, r=radius, h=8) + Sphere(Pnt(0, 0, 8), radius)
    tip = Cylinder(Pnt(0, 0, 8), Z, r=radius, h=2) * Box(Pnt(0, -20, 0), Pnt(20, 20, 20))
    skirt = Box(Pnt(-8, -radius, 8), Pnt(0, radius, 10)) + tip
    return round_top * Box(Pnt(-8, -20, -1), Pnt(20, 20, 8)) + skirt


def layered_mesh(centre, fine):
    """Return the curved mesh of body and cover, its elements ``fine`` within `NEAR_MM` of the load."""
    core, ball = solid(8.0 - COVER_MM), Sphere(Pnt(*centre), NEAR_MM)
    cover = solid(8.0) - core
    shape = Glue([core - ball, core * ball, cover - ball, cover * ball])
    kinds = (("body", FAR_MM), ("body", fine), ("cover", FAR_MM), ("cover", fine))
    for part, (name, size) in zip(shape.solids, kinds, strict=True):
        part.mat(name)
        part.maxh = size
    for face in shape.faces:
        if abs(face.center.z - 10) < 1e-6:
            face.name = "held"
    return ng.Mesh(OCCGeometry(shape).GenerateMesh(maxh=FAR_MM, grading=0.4)).Curve(3)


def covered_finger(path, sizes=(0.4, 0.32)):
    """Write the fields of a bump of 1 mm radius and 1 N at (1, 0.5) mm; E = 1 and 10 MPa, nu = 0.5 in both."""
    body = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
    centre = body.surface_from_above(np.array([(1.0, 0.5)]))[0]
    chart = body.chart_of(centre[None])[0] + [[-2, 0], [-0.8, 0.3], [0, 0], [0.6, -0.5], [1.5, 1], [0, 3]]
    points = np.vstack([body.chart_points(chart, depth) for depth in (0.05, 0.3, 0.5, 1.0, 2.0, 4.0)])
    right_of, above = ng.IfPos(ng.x, ng.x, 0), ng.IfPos(8.0 - ng.z, 8.0 - ng.z, 0)
    outside = ng.IfPos(ng.sqrt(right_of**2 + ng.y**2 + above**2) - 8.0 + COVER_MM / 2, 1, 0)
    bump, on = bump_at(centre, 1.0) * outside, ng.ds(bonus_intorder=8)
    materials, forces = {"body": (1.0, 0.5), "cover": (10.0, 0.5)}, ((0, 0, 1), (1, 0, 0))
    coarse, fine = (
        displacements(layered_mesh(centre, size), 3, materials, bump, on, forces, points, True) for size in sizes
    )
    print("the two meshes differ by", own_error(coarse, fine))
    np.savez_compressed(path, points=points, normal=fine[0], sideways=fine[1])


if __name__ == "__main__":
    name = sys.argv[1]
    make = {"dome": dome, "edge_pad": edge_pad, "covered_finger": covered_finger}[name]
    make(sys.argv[2] if len(sys.argv) > 2 else Path(__file__).with_name(f"{name}.npz"))
