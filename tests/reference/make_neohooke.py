"""Makes neohooke.json: what linear theory leaves out of a press on a round slab, by NGSolve and by nothing of twin.

    python tests/reference/make_neohooke.py     # needs ngsolve; about half an hour

An axisymmetric slab (radius 47.5 mm, 40 mm thick or less, bonded below, E = 1 MPa, incompressible) carries a rigid
probe with a given force and no friction: once by linear theory, its gap along the undeformed normals, and once
as neo-Hookean, Mooney-Rivlin or Yeoh rubber, the probe against the deformed surface. Displacement of order 3
and pressure of order 2 (4 and 3 in the check). A penalty of 4000 MPa/mm keeps the two apart. Stored: both
displacements (r, z) in mm at r and z, the indentations, the radii of the contact (to about 1 % under a sphere:
Sneddon's exact sphere has 1.0627, 1.6394 and 2.0048 mm), and how far a second order moves the difference of the
two, over the largest displacement. The rows of the 6 mm sphere under 6 N and of rims of 0.1 and 0.05 mm are those of
other meshes and a penalty of 2000.
"""

import json
import math
from pathlib import Path

import ngsolve as ng
import numpy as np
from netgen.meshing import NgException
from netgen.occ import Glue, MoveTo, OCCGeometry

RADIUS, THICK, PENALTY = 47.5, 40.0, 4000.0
CASES = [
    {"kind": "sphere", "diameter_mm": 6.0, "force_n": 0.75, "reach": 1.3},
    {"kind": "sphere", "diameter_mm": 6.0, "force_n": 3.0, "reach": 2.2},
    {"kind": "sphere", "diameter_mm": 6.0, "force_n": 6.0, "reach": 2.8},
    {"kind": "cylinder", "diameter_mm": 5.0, "edge_mm": 0.5, "force_n": 3.0, "reach": 2.6},
    {"kind": "cylinder", "diameter_mm": 5.0, "edge_mm": 0.5, "force_n": 6.0, "reach": 2.6},
    {"kind": "cylinder", "diameter_mm": 5.0, "edge_mm": 0.1, "force_n": 3.0, "reach": 2.6},
    {"kind": "cylinder", "diameter_mm": 5.0, "edge_mm": 0.05, "force_n": 3.0, "reach": 2.6},
    {"kind": "cone", "diameter_mm": 12.0, "apex_deg": 130.0, "tip_mm": 1.0, "force_n": 1.0, "reach": 1.4},
    {"kind": "sphere", "diameter_mm": 6.0, "force_n": 3.0, "reach": 2.2, "law": "mooney_rivlin", "ratios": [0.6]},
    {"kind": "sphere", "diameter_mm": 6.0, "force_n": 3.0, "reach": 2.2, "law": "yeoh", "ratios": [0.3, 0.1]},
    {"kind": "sphere", "diameter_mm": 8.7, "force_n": 6.0, "reach": 2.9, "thick_mm": 4.0},
    {"kind": "cylinder", "diameter_mm": 6.0, "edge_mm": 0.06, "force_n": 3.0, "reach": 3.1, "thick_mm": 4.0},
]
PLACES = [(r, z) for z in (1.5, 3.0, 6.0) for r in (0.0, 0.75, 1.5, 2.25, 3.0, 4.5, 6.0, 9.0, 13.0)]


def places(case):
    """Return where (r, z) displacements are stored: in thin rubber nearer to the surface."""
    return [(r, z * min(1.0, case.get("thick_mm", THICK) / 8.0)) for r, z in PLACES]


def height(case, r):
    """How far the probe's surface lies above its lowest point at a distance r from its axis."""
    positive = lambda x: ng.IfPos(x, x, 0.0)  # noqa: E731
    if case["kind"] == "sphere":
        big = case["diameter_mm"] / 2
        return big - ng.sqrt(ng.IfPos(0.999 * big * big - r * r, big * big - r * r, 0.001 * big * big))
    if case["kind"] == "cylinder":
        edge = case["edge_mm"]
        over = positive(r - (case["diameter_mm"] / 2 - edge))
        return (
            edge
            - ng.sqrt(ng.IfPos(0.99 * edge**2 - over**2, edge**2 - over**2, 0.01 * edge**2))
            + 9 * positive(over - 0.99 * edge)
        )
    half, tip = math.radians(case["apex_deg"] / 2), case["tip_mm"]
    meet = tip * math.cos(half)
    ball = tip - ng.sqrt(ng.IfPos(meet * meet - r * r, tip * tip - r * r, tip * tip - meet * meet))
    return ng.IfPos(r - meet, tip - tip * math.sin(half) + (r - meet) / math.tan(half), ball)


def energy(case, first, second):
    """Twice the energy over the shear modulus, of I1 - 3 and I2 - 3."""
    law, ratios = case.get("law", "neo_hookean"), case.get("ratios", ())
    if law == "mooney_rivlin":
        return (first + ratios[0] * second) / (1.0 + ratios[0])
    if law == "yeoh":
        return first + ratios[0] * first * first + ratios[1] * first * first * first
    return first


def box(w, d, start=0.0):
    return MoveTo(start, 0).Line(w).Rotate(90).Line(d).Rotate(90).Line(w).Close().Face()


def slab(case, fine):
    """The half section (r, depth), elements small where the contact ends: in nested boxes around a cylinder's rim."""
    thick = case.get("thick_mm", THICK)
    whole = box(RADIUS, thick)
    whole.faces.maxh = min(6.0, thick / 2.0)
    if case["kind"] == "cylinder":
        radius, edge = case["diameter_mm"] / 2.0, case["edge_mm"]
        near, last = box(4.0 * radius, min(3.0 * radius, thick)), box(1.6 * radius, min(0.8 * radius, thick))
        near.faces.maxh, last.faces.maxh = min(0.5 * radius, thick / 3.0) * fine, 0.15 * radius * fine
        parts, smallest, wide = [whole - near, near - last], edge / 8.0, 0.32 * radius
        while wide / 5.0 > smallest / 2.0:
            inside = box(2.0 * wide, wide, radius - edge / 2.0 - wide)
            inside.faces.maxh = max(smallest, wide / 5.0) * fine
            parts.append(last - inside)
            last = inside
            wide /= 2.0
        return meshed([*parts, last], thick)
    reach = case["reach"]
    near, inner = box(3.0 * reach, min(3.0 * reach, thick)), box(1.25 * reach, 0.6 * reach)
    end = box(0.3 * reach, 0.15 * reach, 0.66 * reach)
    near.faces.maxh, inner.faces.maxh, end.faces.maxh = (share * fine * reach for share in (0.5, 0.08, 0.025))
    return meshed([whole - near, near - inner, inner - end, end], thick)


def meshed(parts, thick):
    glued = Glue(parts)
    for edge in glued.edges:
        low, high = edge.bounding_box
        if max(abs(low.y), abs(high.y)) < 1e-3:
            edge.name = "touched"
        elif max(abs(low.x), abs(high.x)) < 1e-3:
            edge.name = "axis"
        elif abs(low.y - thick) < 1e-3 and abs(high.y - thick) < 1e-3:
            edge.name = "held"
    return ng.Mesh(OCCGeometry(glued, dim=2).GenerateMesh(maxh=6.0, grading=0.4))


def solve(case, mesh, order, linear, start):
    """Return displacement, indentation and the unknowns; ``start`` are the unknowns to begin with."""
    moves = ng.VectorH1(mesh, order=order, dirichletx="held|axis", dirichlety="held")
    space = moves * ng.H1(mesh, order=order - 1) * ng.NumberSpace(mesh)
    (u, p, d), r = space.TrialFunction(), ng.x
    grad, mu, weight = ng.Grad(u), 1.0 / 3.0, 2.0 * math.pi * ng.x
    hoop = u[0] / r
    form = ng.BilinearForm(space, symmetric=True)
    if linear:
        trace = grad[0, 0] + grad[1, 1] + hoop
        e = 0.5 * (grad + grad.trans)
        form += ng.Variation(
            weight * (mu * (ng.InnerProduct(e, e) + hoop * hoop) + p * trace) * ng.dx(bonus_intorder=2)
        )
        gap = height(case, r) + u[1] - d
    else:
        f = ng.Id(2) + grad
        ratio = ng.Det(f) * (1 + hoop)
        inner = ng.InnerProduct(f, f) + (1 + hoop) * (1 + hoop) - 3.0
        second = (1 + hoop) * (1 + hoop) * ng.InnerProduct(f, f) + ng.Det(f) * ng.Det(f) - 3.0
        w = mu / 2.0 * energy(case, inner, second) + (p - mu) * (ratio - 1.0) + mu / 2.0 * (ratio - 1.0) ** 2
        form += ng.Variation(weight * w * ng.dx(bonus_intorder=4))
        gap = height(case, r + u[0]) + u[1] - d
    inside = ng.IfPos(-gap, gap, 0.0)
    form += ng.Variation(weight * PENALTY / 2.0 * inside * inside * ng.ds("touched", bonus_intorder=10))
    pull = -case["force_n"] / (math.pi * RADIUS**2)
    form += ng.Variation(weight * pull * d * ng.ds("touched"))
    state = ng.GridFunction(space)
    if start is not None:
        state.vec.data = start.vec
    right, step, old = (state.vec.CreateVector() for _ in range(3))

    def left():
        form.Apply(state.vec, right)
        free = space.FreeDofs()
        values = np.array(right.FV().NumPy())
        return float(np.linalg.norm(values[[i for i in range(space.ndof) if free[i]]]))

    size = left()
    for _ in range(200):
        form.AssembleLinearization(state.vec)
        form.Apply(state.vec, right)
        step.data = form.mat.Inverse(space.FreeDofs(), inverse="umfpack") * right
        old.data, share = state.vec, 1.0
        for _ in range(12):
            state.vec.data = old - share * step
            now = left()
            if now < max(1.2 * size, 1e-9):
                break
            share /= 2.0
        size = now
        if size < 1e-9 and share == 1.0:
            break
    else:
        raise RuntimeError(f"left {size}")
    u = state.components[0]
    at = np.array([[*u(mesh(max(r, 1e-6), z))] for r, z in places(case)])
    depth = float(state.components[2].vec[0])
    return at, depth, state, contact_radius(case, mesh, u, depth, linear)


def contact_radius(case, mesh, u, depth, linear):
    """Return how far from the axis the surface that touches reaches, deformed (linear: at rest), mm.

    Where pressure falls to 0 as a square root, the force beyond r does so as the power 3/2 of the distance to the end.
    The force smooths what the penalty leaves in the pressure, so a parabola through its power 2/3 over r^2 ends there.
    """
    rest = np.linspace(1e-6, case["reach"], 4001)
    moved = np.array([u(mesh(r, 0.0)) for r in rest])
    at = rest if linear else rest + moved[:, 0]
    surface = ng.Mesh(ng.unit_square.GenerateMesh(maxh=2.0))
    above = height(case, 1.2 * case["reach"] * ng.x)
    gap = np.array([above(surface(r / (1.2 * case["reach"]), 0.5)) for r in at]) + moved[:, 1] - depth
    beyond = np.cumsum((np.maximum(-gap, 0.0) * rest)[::-1])[::-1]
    share = beyond / beyond[0]
    near = (share > 0.01) & (share < 0.5)
    ends = np.polynomial.Polynomial.fit(rest[near] ** 2, share[near] ** (2 / 3), 2).roots()
    end = ends[np.argmin(np.abs(ends - rest[near][-1] ** 2))].real
    return float(np.interp(math.sqrt(end), rest, at))


def pair(case, order, mesh):
    start = None
    space_guess = case["force_n"] / 6.0
    for share in (0.25, 1.0):
        one = {**case, "force_n": share * case["force_n"]}
        if start is None:
            first = ng.GridFunction(
                ng.VectorH1(mesh, order=order, dirichletx="held|axis", dirichlety="held")
                * ng.H1(mesh, order=order - 1)
                * ng.NumberSpace(mesh)
            )
            first.components[2].vec[0] = min(0.3, space_guess)
            start = first
        straight, depth, start, edge = solve(one, mesh, order, True, start)
    try:
        bent, deep, _, wide = solve(case, mesh, order, False, start)
    except (RuntimeError, NgException):  # from rest, in load steps
        last = first
        for share in (0.1, 0.25, 0.5, 0.75, 1.0):
            bent, deep, last, wide = solve({**case, "force_n": share * case["force_n"]}, mesh, order, False, last)
    return straight, bent, depth, deep, edge, wide


def main():
    store = Path(__file__).with_name("neohooke.json")
    rows = json.loads(store.read_text())["cases"] if store.exists() else []
    key = "kind", "diameter_mm", "edge_mm", "force_n", "law"
    done = [[row.get(name) for name in key] for row in rows]
    for case in CASES:
        if [case.get(name) for name in key] in done:
            continue
        meshes = slab(case, 1.0), slab(case, 1.4)
        straight, bent, depth, deep, edge, wide = pair(case, 3, meshes[0])
        coarse = pair(case, 4, meshes[1])
        most = float(np.linalg.norm(straight, axis=1).max())
        other = (coarse[1] - coarse[0]) - (bent - straight)
        row = {
            **case,
            "linear_mm": straight.round(7).tolist(),
            "strained_mm": bent.round(7).tolist(),
            "indentation_linear_mm": depth,
            "indentation_mm": deep,
            "contact_linear_mm": edge,
            "contact_mm": wide,
            "own_error": float(np.linalg.norm(other, axis=1).max() / most),
        }
        off = float(np.linalg.norm(bent - straight, axis=1).max() / most)
        print(
            case["kind"],
            case["force_n"],
            "depth",
            depth,
            deep,
            coarse[2:],
            "off",
            off,
            "own",
            row["own_error"],
            flush=True,
        )
        rows.append(row)
        store.write_text(
            json.dumps({"places_mm": PLACES, "radius_mm": RADIUS, "thickness_mm": THICK, "cases": rows}, indent=0)
        )


if __name__ == "__main__":
    main()
