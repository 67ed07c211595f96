"""How dome.npz was made: converged displacement fields of the round dome by an independent code (NGSolve 6.2).

    python tests/reference/make_dome.py tests/reference/dome.npz

Taylor-Hood elements of order 4 (pressure 3) on curved elements, without any half-space: the load is a traction on the
true sphere, the mesh is fine under it and towards the clamped rim. Every case is solved on two meshes; the finer one is
stored and the difference of the two is its `error_estimate`. Needs ngsolve (the extra `peers`) and some minutes.
"""

import json
import sys
import time

import ngsolve as ng
import numpy as np
from netgen.occ import HalfSpace, OCCGeometry, Pnt, Sphere, Vec

RADIUS, HEIGHT, MODULUS, BUMP = 10.0, 7.0, 0.5, 2.0
ORDER = 4
PLACES = {"apex": (0.0, 0.0), "side": (5.0, 0.0)}
"""Arc lengths (s, t) of the bumps' centres."""


def place(chart, depth=0.0):
    """Return (n, 3) points at arc lengths (s, t) and depths."""
    s, t = np.atleast_2d(chart).T
    rho = np.hypot(s, t)
    r = RADIUS - depth
    share = np.where(rho > 0, r * np.sin(rho / RADIUS) / np.where(rho > 0, rho, 1), 0)
    return np.column_stack([share * s, share * t, RADIUS - r * np.cos(rho / RADIUS)])


def dome_mesh(fine, rim, coarse):
    """Return the curved mesh: edges ``fine`` under both bumps, ``rim`` at the clamped rim, ``coarse`` elsewhere, mm."""
    ball = Sphere(Pnt(0, 0, RADIUS), RADIUS)
    body = ball * HalfSpace(Pnt(0, 0, HEIGHT), Vec(0, 0, 1))
    for face in body.faces:
        face.name = "held" if abs(face.center.z - HEIGHT) < 1e-6 else "sensing"
    geometry = OCCGeometry(body)
    from netgen.meshing import MeshingParameters

    wanted = MeshingParameters(maxh=coarse, grading=0.35)
    for centre in PLACES.values():
        rings = [(0.0, 0.0)] + [(q * BUMP * np.cos(a), q * BUMP * np.sin(a)) for q in (0.35, 0.7, 1.0)
                                for a in np.linspace(0, 2 * np.pi, 24, endpoint=False)]  # fmt: skip
        for x, y, z in place(np.array(rings) + centre, 0.0):
            wanted.RestrictH(x=x, y=y, z=z, h=fine)
    base = np.sqrt(HEIGHT * (2 * RADIUS - HEIGHT))
    for angle in np.linspace(0, 2 * np.pi, 200, endpoint=False):
        wanted.RestrictH(x=base * np.cos(angle), y=base * np.sin(angle), z=HEIGHT, h=rim)
    return ng.Mesh(geometry.GenerateMesh(wanted)).Curve(ORDER)


def fields(mesh, nu, points):
    """Return {case: (n, 3) displacements} of all bumps in directions x and z for one Poisson ratio."""
    mu = MODULUS / 2 / (1 + nu)
    over_lambda = (1 - 2 * nu) * (1 + nu) / (MODULUS * nu)
    space = ng.VectorH1(mesh, order=ORDER, dirichlet="held") * ng.H1(mesh, order=ORDER - 1)
    (u, p), (v, q) = space.TnT()
    strain, test = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    form = 2 * mu * ng.InnerProduct(strain, test) - ng.div(u) * q - ng.div(v) * p - over_lambda * p * q
    exact = ng.BilinearForm(form * ng.dx).Assemble()
    shifted = ng.BilinearForm((form - 1e-5 / mu * p * q) * ng.dx).Assemble()
    inverse = shifted.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
    free = ng.Projector(space.FreeDofs(), True)
    found = {}
    for name, centre in PLACES.items():
        x, y, z = place(centre)[0]
        squared = (ng.x - x) ** 2 + (ng.y - y) ** 2 + (ng.z - z) ** 2
        bump = ng.IfPos(BUMP**2 - squared, (1 - squared / BUMP**2) ** 2, 0)
        surface = ng.ds("sensing", bonus_intorder=12)
        total = ng.Integrate(bump * surface, mesh)
        for axis, letter in ((0, "x"), (2, "z")):
            load = ng.LinearForm(bump / total * v[axis] * surface).Assemble()
            answer = ng.GridFunction(space)
            right = load.vec.CreateVector()
            for _ in range(12):
                right.data = free * (load.vec - exact.mat * answer.vec)
                answer.vec.data += inverse * right
            right.data = free * (load.vec - exact.mat * answer.vec)
            left = ng.Norm(right) / ng.Norm(load.vec)
            assert left < 1e-9, f"relative residual {left}"
            displacement = answer.components[0]
            found[f"{name}_{letter}_nu{nu:g}"] = np.array([displacement(mesh(*point)) for point in points])
    return found


def main(path):
    """Write the reference."""
    rng = np.random.default_rng(20)
    grid = [np.stack(np.meshgrid(*[pitch * (np.arange(n) - (n - 1) / 2)] * 2, indexing="ij"), -1).reshape(-1, 2)
            for n, pitch in ((5, 2.5), (4, 2.5))]  # fmt: skip
    charts = rng.uniform(-7, 7, (150, 2))
    points = np.concatenate([place(grid[0], 0.5), place(grid[1], 2.0), place(charts, rng.uniform(0.3, 4, 150))])
    points = points[points[:, 2] < HEIGHT - 0.1]
    results: list[dict] = []
    for sizes in ((0.75, 0.7, 3.0), (0.5, 0.45, 2.2)):
        mesh = dome_mesh(*sizes)
        found, started = {}, time.process_time()
        for nu in (0.5, 0.49, 0.3):
            found |= fields(mesh, nu, points)
        print(sizes, mesh.ne, "elements", time.process_time() - started, "CPU s", flush=True)
        results.append(found)
    cases, data = [], {}
    for key, u in results[1].items():
        error = np.linalg.norm(u - results[0][key], axis=1).max() / np.linalg.norm(u, axis=1).max()
        name, letter, nu = key.split("_")
        load = {"kind": "bump", "centre_mm": place(PLACES[name])[0].tolist(), "radius_mm": BUMP,
                "force_n": [1, 0, 0] if letter == "x" else [0, 0, 1]}  # fmt: skip
        cases.append({"key": key, "nu": float(nu[2:]), "load": load, "error_estimate": float(error)})
        data[key] = u
        print(key, "error estimate", error)
    np.savez_compressed(path, points=points, cases=json.dumps(cases), **data)


if __name__ == "__main__":
    main(sys.argv[1])
