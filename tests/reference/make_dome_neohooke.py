"""Makes dome_neohooke.json: what linear theory leaves out of a sphere on a dome's apex, by NGSolve, by nothing of twin.

    python tests/reference/make_dome_neohooke.py     # needs ngsolve; two minutes

An axisymmetric part of a ball, bonded below (E = 1 MPa), carries a rigid sphere with a given force and no friction, by
linear theory, its gap along the undeformed normals, and at finite strain. Displacement of order 3, pressure of order 2,
a penalty of 2000 MPa/mm. Stored is what make_neohooke.py stores, each case with its own places (r, z);
``own_error`` is how far a mesh 1.6 times as coarse moves the difference, over the largest displacement.
"""

import json
import math
from pathlib import Path

import ngsolve as ng
import numpy as np
from make_neohooke import energy, height
from netgen.occ import Circle, Glue, MoveTo, OCCGeometry

PENALTY = 2000.0
TOUCHED = ng.ds("touched", bonus_intorder=8)
YEOH = {"law": "yeoh", "ratios": [0.17, 0.05], "poisson_ratio": 0.5}
MOONEY = {"law": "mooney_rivlin", "ratios": [0.25], "poisson_ratio": 0.49}
CASES = [
    {"radius_mm": 14.0, "height_mm": 7.14, "diameter_mm": 8.68, "force_n": 5.392, "reach": 2.158, **YEOH},
    {"radius_mm": 5.0, "height_mm": 2.71, "diameter_mm": 3.74, "force_n": 1.0129, "reach": 0.9187, **MOONEY},
]


def places(case):
    """Return (r, z) inside, 0.4 to 2 contact radii deep."""
    reach, radius = case["reach"], case["radius_mm"]
    grid = [(r * reach, z * reach) for z in (0.4, 0.7, 1.2, 2.0) for r in (0.0, 0.3, 0.6, 0.9, 1.2, 1.6, 2.2, 3.0)]
    return [(r, z) for r, z in grid if math.hypot(r, z - radius) < radius - 0.25 * reach]


def dome(case, fine):
    """The half section (r, depth), elements small where the contact ends."""
    radius, deep, reach = case["radius_mm"], case["height_mm"], case["reach"]
    whole = Circle((0, radius), radius).Face() * MoveTo(0, 0).Rectangle(2 * radius, deep).Face()

    def box(wide, down, start=0.0):
        return MoveTo(start, 0).Rectangle(wide, down).Face() * whole

    near, inner = box(min(3 * reach, 0.9 * radius), min(3 * reach, 0.8 * deep)), box(1.4 * reach, 0.8 * reach)
    end = box(0.6 * reach, 0.25 * reach, 0.65 * reach)
    whole.faces.maxh = min(radius / 5, deep / 4) * fine
    near.faces.maxh, inner.faces.maxh, end.faces.maxh = (share * fine * reach for share in (0.35, 0.1, 0.03))
    glued = Glue([whole - near, near - inner, inner - end, end])
    for edge in glued.edges:
        ends = np.array([[vertex.p.x, vertex.p.y] for vertex in edge.vertices])
        if np.abs(ends[:, 1] - deep).max() < 1e-6:
            edge.name = "held"
        elif np.abs(ends[:, 0]).max() < 1e-6:
            edge.name = "axis"
        elif np.abs(np.hypot(ends[:, 0], ends[:, 1] - radius) - radius).max() < 1e-6:
            edge.name = "touched"
    mesh = ng.Mesh(OCCGeometry(glued, dim=2).GenerateMesh(maxh=radius, grading=0.35))
    mesh.Curve(4)
    return mesh


def linear(case, mesh):
    """Return displacements at the places, depth and the contact's radius at rest: the depth is sought by secants."""
    form, space, weight, (u, p) = start(case, mesh, False)
    radius, ball, depth, r = case["radius_mm"], case["diameter_mm"] / 2.0, ng.Parameter(0.0), ng.x
    grad, hoop, shear = ng.Grad(u), u[0] / r, 0.5 / (1.0 + case["poisson_ratio"])
    strain = 0.5 * (grad + grad.trans)
    density = shear * (ng.InnerProduct(strain, strain) + hoop * hoop) + p * (ng.Trace(grad) + hoop)
    form += ng.Variation(weight * (density - softness(case) / 2.0 * p * p) * ng.dx(bonus_intorder=2))
    normal = ng.CF((-r / radius, (radius - ng.y) / radius))
    below = ng.y - depth + ball
    ahead = r * normal[0] + below * normal[1]
    root = ahead * ahead - r * r - below * below + ball * ball
    rest = ng.IfPos(root - 1e-3, ahead - ng.sqrt(ng.IfPos(root - 1e-3, root, 1e-3)), 10.0)

    def inside(moved):
        gap = rest + moved * normal
        return ng.IfPos(-gap, -gap, 0.0)

    form += ng.Variation(weight * PENALTY / 2.0 * inside(u) * inside(u) * TOUCHED)
    state = ng.GridFunction(space)
    right, step = state.vec.CreateVector(), state.vec.CreateVector()
    free = np.array([bool(one) for one in space.FreeDofs()])

    def force(deep):
        depth.Set(deep)
        for _ in range(60):
            form.AssembleLinearization(state.vec)
            form.Apply(state.vec, right)
            if np.linalg.norm(right.FV().NumPy()[free]) < 1e-9:
                break
            step.data = form.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky") * right
            state.vec.data -= step
        else:
            raise RuntimeError("Newton's steps do not converge")
        pressure = weight * PENALTY * normal[1] * inside(state.components[0])
        return ng.Integrate(pressure, mesh, ng.BND, definedon=mesh.Boundaries("touched"), order=14)

    depths = [0.48 * case["reach"], 0.5 * case["reach"]]
    forces = [force(deep) for deep in depths]
    while abs(forces[-1] / case["force_n"] - 1.0) > 1e-7:
        slope = (depths[-1] - depths[-2]) / (forces[-1] - forces[-2])
        depths.append(depths[-1] + slope * (case["force_n"] - forces[-1]))
        forces.append(force(depths[-1]))
    moved = state.components[0]
    return read(case, mesh, moved), depths[-1], end(case, mesh, moved, inside(moved), deformed=False)


def strained(case, mesh):
    """Return the same at finite strain, the depth an unknown, in steps of the force."""
    form, space, weight, (u, p, d) = start(case, mesh, True)
    grad, hoop, shear = ng.Grad(u), u[0] / ng.x, 0.5 / (1.0 + case["poisson_ratio"])
    f = ng.Id(2) + grad
    ratio = ng.Det(f) * (1 + hoop)
    first = ng.InnerProduct(f, f) + (1 + hoop) * (1 + hoop) - 3.0
    second = (1 + hoop) * (1 + hoop) * ng.InnerProduct(f, f) + ng.Det(f) * ng.Det(f) - 3.0
    share = case["ratios"][0] / (1.0 + case["ratios"][0]) if case["law"] == "mooney_rivlin" else 0.0
    bend = 4.0 * case["ratios"][0] * (case["law"] == "yeoh") - 1.0 + share
    density = shear / 2.0 * energy(case, first, second) + p * (ratio - 1.0) - softness(case) / 2.0 * p * p
    density -= shear * ((1.0 + share) * (ratio - 1.0) + bend / 2.0 * (ratio - 1.0) * (ratio - 1.0))
    form += ng.Variation((weight * density).Compile() * ng.dx(bonus_intorder=2))

    def inside(moved, deep):
        gap = height({"kind": "sphere", **case}, ng.x + moved[0]) + ng.y + moved[1] - deep
        return ng.IfPos(-gap, -gap, 0.0)

    form += ng.Variation(weight * PENALTY / 2.0 * inside(u, d) * inside(u, d) * TOUCHED)
    state = ng.GridFunction(space)
    state.components[2].vec[0] = 0.05 * case["reach"]
    right, step, old, one, column, alone, along = (state.vec.CreateVector() for _ in range(7))
    last = space.ndof - 1
    moves = ng.BitArray(space.FreeDofs())
    moves[last] = False
    free = np.array([bool(bit) for bit in moves])
    one.FV().NumPy()[:] = 0.0
    one.FV().NumPy()[last] = 1.0

    def left(force):
        form.Apply(state.vec, right)
        right.FV().NumPy()[last] -= force
        return float(np.hypot(np.linalg.norm(right.FV().NumPy()[free]), right.FV().NumPy()[last]))

    for force in case["force_n"] * np.array([0.05, 0.2, 0.45, 0.7, 1.0]):
        size = left(force)
        for _ in range(60):
            form.AssembleLinearization(state.vec)
            left(force)
            inverse = form.mat.Inverse(moves, inverse="sparsecholesky")
            column.data = form.mat * one
            alone.data, along.data = inverse * right, inverse * column
            row = np.where(free, column.FV().NumPy(), 0.0)
            down = right.FV().NumPy()[last] - row @ alone.FV().NumPy()
            down /= column.FV().NumPy()[last] - row @ along.FV().NumPy()
            step.data = alone - down * along
            step.FV().NumPy()[last] = down
            old.data, part = state.vec, 1.0
            for _ in range(10):
                state.vec.data = old - part * step
                now = left(force)
                if now < max(1.2 * size, 1e-9):
                    break
                part /= 2.0
            size = now
            if size < 1e-8 and part == 1.0:
                break
        else:
            raise RuntimeError(f"left {size}")
    moved, deep = state.components[0], float(state.components[2].vec[0])
    return read(case, mesh, moved), deep, end(case, mesh, moved, inside(moved, deep), deformed=True)


def softness(case):
    """The compressibility, and 1e-7 more: the saddle point is factored without pivots."""
    nu = case["poisson_ratio"]
    return (1.0 - 2.0 * nu) * (1.0 + nu) / nu + 1e-7


def start(case, mesh, sinks):
    moves = ng.VectorH1(mesh, order=3, dirichletx="held|axis", dirichlety="held")
    space = moves * ng.H1(mesh, order=2)
    if sinks:
        space *= ng.NumberSpace(mesh)
    return ng.BilinearForm(space, symmetric=True), space, 2.0 * math.pi * ng.x, space.TrialFunction()


def read(case, mesh, moved):
    return np.array([[*moved(mesh(max(r, 1e-6), z))] for r, z in places(case)])


def end(case, mesh, moved, inside, *, deformed):
    """Return where the contact ends: the force beyond r, to the power 2/3, is extrapolated over r^2."""
    radius = case["radius_mm"]
    angle = np.linspace(1e-5, 2.2 * case["reach"] / radius, 3001)
    rest = radius * np.sin(angle) * (1 - 1e-9)
    points = [mesh(r, radius - radius * math.cos(a) * (1 - 1e-9)) for r, a in zip(rest, angle, strict=True)]
    beyond = np.cumsum((np.array([inside(one) for one in points]) * rest)[::-1])[::-1]
    share = beyond / beyond[0]
    near = (share > 0.01) & (share < 0.5)
    ends = np.polynomial.Polynomial.fit(rest[near] ** 2, share[near] ** (2 / 3), 2).roots()
    found = math.sqrt(ends[np.argmin(np.abs(ends - rest[near][-1] ** 2))].real)
    if not deformed:
        return found
    return float(np.interp(found, rest, rest + [moved(one)[0] for one in points]))


def main():
    rows = []
    for case in CASES:
        (straight, bent), coarse = (
            [linear(case, mesh), strained(case, mesh)] for mesh in (dome(case, 1.0), dome(case, 1.6))
        )
        most = np.linalg.norm(straight[0], axis=1).max()
        other = coarse[1][0] - coarse[0][0] - (bent[0] - straight[0])
        row = {
            **case,
            "places_mm": np.round(places(case), 9).tolist(),
            "linear_mm": straight[0].round(7).tolist(),
            "strained_mm": bent[0].round(7).tolist(),
            "indentation_linear_mm": straight[1],
            "indentation_mm": bent[1],
            "contact_linear_mm": straight[2],
            "contact_mm": bent[2],
            "own_error": float(np.linalg.norm(other, axis=1).max() / most),
        }
        print({key: value for key, value in row.items() if not isinstance(value, list)}, flush=True)
        rows.append(row)
    Path(__file__).with_name("dome_neohooke.json").write_text(json.dumps({"cases": rows}, indent=0))


if __name__ == "__main__":
    ng.SetNumThreads(1)
    main()
