"""Makes finger_neohooke.json: what linear theory leaves out of a press on the finger, by NGSolve, by nothing of twin.

    python tests/reference/make_finger_neohooke.py     # needs ngsolve; half an hour

Half of the finger (radius 8, barrel 8, skirt 2 mm; E = 1 MPa, incompressible; held below, y = 0 a plane of symmetry)
under a rigid sphere of 3 mm that comes along z at the apex with a given force and no friction: once by linear theory,
the gap and the pressure along the undeformed normals, and once as neo-Hookean rubber, the sphere against the deformed
surface. Displacement of order 2, pressure of order 1. A penalty keeps the two apart, raised in steps to
1000 MPa/mm. Stored: both
displacements in mm at places inside, the indentations, and how far a coarser mesh moves the difference of the two,
over the largest displacement.
"""

import json
import math
import sys
from pathlib import Path

import netgen.meshing
import ngsolve as ng
import numpy as np
from netgen.occ import Box, Cylinder, HalfSpace, OCCGeometry, Pnt, Sphere, Vec, X, Z

RADIUS, BARREL, SKIRT, BALL = 8.0, 8.0, 2.0, 1.5
PENALTIES, SHEAR = (20.0, 60.0, 200.0, 1000.0), 1.0 / 3.0
FORCES = (0.980665,)
ORDER = 2
FINE_MM = (0.1, 0.14)


def places():
    """Places (n, 3) at depths of layers of markers, y >= 0: the finger's chart, unrolled from its apex."""
    found = []
    for depth in (0.5, 1.0, 2.0, 3.0):
        for s in (-5.0, -2.5, -1.25, -0.6, 0.0, 0.6, 1.25, 2.5, 5.0):
            for t in (0.0, 0.6, 1.25, 2.5, 5.0):
                rho = math.hypot(s, t) if s > 0 else t
                r = RADIUS - depth
                share = r * math.sin(rho / RADIUS) / rho if rho > 0 else 1.0
                found.append((share * s if s > 0 else s, share * t, RADIUS - r * math.cos(rho / RADIUS)))
    return found


def finger(fine):
    """The half y >= 0 of the finger, elements small under the apex."""
    centre = Pnt(0, 0, RADIUS)
    top = Cylinder(Pnt(-BARREL, 0, RADIUS), X, RADIUS, BARREL) + Sphere(centre, RADIUS) * HalfSpace(
        Pnt(0, 0, 0), Vec(-1, 0, 0)
    )
    top = top * Box(Pnt(-BARREL, 0, -1), Pnt(RADIUS + 1, RADIUS + 1, RADIUS))
    base = Cylinder(centre, Z, RADIUS, SKIRT) * Box(
        Pnt(0, 0, RADIUS), Pnt(RADIUS + 1, RADIUS + 1, RADIUS + SKIRT)
    ) + Box(Pnt(-BARREL, 0, RADIUS), Pnt(0, RADIUS, RADIUS + SKIRT))
    body = top + base
    for face in body.faces:
        low, high = face.bounding_box
        if max(abs(low.y), abs(high.y)) < 1e-3:
            face.name = "mirror"
        elif min(low.z, high.z) > RADIUS + SKIRT - 1e-3:
            face.name = "held"
        elif max(low.x, high.x) < -BARREL + 1e-3:
            face.name = "back"
        elif min(low.z, high.z) < 1e-3:
            face.name = "touched"
        else:
            face.name = "side"
    settings = netgen.meshing.MeshingParameters(maxh=2.5, grading=0.35)
    for r in np.arange(0.0, 2.6, 0.4):
        for z in np.arange(0.0, 2.2, 0.4):
            for angle in np.linspace(0.0, math.pi, 9):
                size = fine * max(1.0, math.hypot(r, z) / 1.3)
                settings.RestrictH(r * math.cos(angle), r * math.sin(angle), z + 0.06 * r * r, size)
    mesh = ng.Mesh(OCCGeometry(body).GenerateMesh(settings))
    return mesh.Curve(ORDER)


def solve(mesh, force, linear, state, depth, penalty):
    """Take Newton's steps from ``state`` and ``depth`` to the equilibrium under a force; return the depth."""
    space = state.space
    (u, p), (v, _) = space.TnT()
    grad, form = ng.Grad(u), ng.BilinearForm(space, symmetric=True)
    push = ng.LinearForm(space)
    at = ng.Parameter(depth)
    place = ng.CF((ng.x, ng.y, ng.z))
    if linear:
        strain = 0.5 * (grad + grad.trans)
        form += ng.Variation((SHEAR * ng.InnerProduct(strain, strain) + p * ng.Trace(grad)) * ng.dx(bonus_intorder=2))
        core = ng.CF((ng.IfPos(ng.x, 0.0, ng.x), 0.0, RADIUS))
        inward = (core - place) / ng.Norm(core - place)
        own = place - ng.CF((0.0, 0.0, at - BALL))
        ahead = own * inward
        root = ahead * ahead - own * own + BALL**2
        met = ng.IfPos(root - 1e-3, 1.0, 0.0)
        root = ng.sqrt(ng.IfPos(root - 1e-3, root, 1e-3))
        rest = ahead - root + (1.0 - met) * 10.0
        to_probe = (own - (ahead - root) * inward) / BALL
        per_depth = -to_probe[2] / (to_probe * inward)

        def gap_of(moved):
            return rest + moved * inward

        def toward(_):
            return inward
    else:
        f = ng.Id(3) + grad
        ratio = ng.Det(f)
        density = SHEAR / 2.0 * (ng.InnerProduct(f, f) - 3.0) + (p - SHEAR) * (ratio - 1.0)
        form += ng.Variation((density + SHEAR / 2.0 * (ratio - 1.0) ** 2) * ng.dx(bonus_intorder=4))

        def gap_of(moved):
            own = place + moved - ng.CF((0.0, 0.0, at - BALL))
            return ng.sqrt(own * own) - BALL

        def toward(moved):
            own = place + moved - ng.CF((0.0, 0.0, at - BALL))
            return own / ng.sqrt(own * own)

    # The saddle point is factored without pivots: a tiny compressibility, 1e-7, is added.
    form += ng.Variation(-0.5e-7 * p * p * ng.dx)
    touched = ng.ds("touched", bonus_intorder=6)
    gap = gap_of(u)
    inside = ng.IfPos(-gap, gap, 0.0)
    form += ng.Variation(penalty / 2.0 * inside * inside * touched)
    now = state.components[0]
    here = gap_of(now)
    on = ng.IfPos(-here, penalty, 0.0)
    normal = toward(now)
    slope = per_depth if linear else -normal[2]
    push += -on * slope * (v * normal) * touched
    right, step = state.vec.CreateVector(), state.vec.CreateVector()
    if not linear:  # how the normal turns when the sphere moves: the curvature's part of `push`
        bend = (here / BALL) / (1.0 + here / BALL)
        push += on * bend * (v[2] - normal[2] * (v * normal)) * touched
    follow, change = state.vec.CreateVector(), ng.GridFunction(space)
    boundary = mesh.Boundaries("touched")
    for _ in range(40):
        form.AssembleLinearization(state.vec)
        form.Apply(state.vec, right)
        push.Assemble()
        inverse = form.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
        step.data = inverse * right
        follow.data = inverse * push.vec

        def carried(vector):
            """How the force along z grows with a displacement."""
            change.vec.data = vector
            moved = change.components[0]
            grown = -on * (moved * normal) * normal[2]
            if not linear:
                grown += -on * bend * (moved[2] - (moved * normal) * normal[2])
            return ng.Integrate(grown, mesh, ng.BND, definedon=boundary, order=14)

        pull = ng.Integrate(-on * here * normal[2], mesh, ng.BND, definedon=boundary, order=14)
        stiff = -on * slope * normal[2]
        if not linear:
            stiff += on * bend * (1.0 - normal[2] * normal[2])
        own = ng.Integrate(stiff, mesh, ng.BND, definedon=boundary, order=14)
        down = (force / 2.0 - pull + carried(step)) / (own + carried(follow))
        step.data = -1.0 * step + down * follow
        share = min(1.0, 0.3 / max(abs(down), 1e-12))
        state.vec.data += share * step
        at.Set(at.Get() + share * down)
        size = np.abs(step.FV().NumPy()[: now.space.ndof]).max()
        if size < 1e-6:
            return at.Get()
    raise RuntimeError("Newton's steps do not converge")


def pair(mesh, force):
    """Return both displacements at the places, and both depths."""
    moves = ng.VectorH1(mesh, order=ORDER, dirichlet="held", dirichlety="held|mirror")
    space = moves * ng.H1(mesh, order=ORDER - 1)
    print("unknowns", space.ndof, "elements", mesh.ne, flush=True)
    state = ng.GridFunction(space)
    depth = 0.3
    for penalty in PENALTIES[::3]:
        depth = solve(mesh, force, True, state, depth, penalty)
    at = [mesh(*place) for place in places()]
    straight = np.array([state.components[0](one) for one in at])
    deep = depth + 0.06
    for penalty in PENALTIES:
        deep = solve(mesh, force, False, state, deep, penalty)
    return straight, np.array([state.components[0](one) for one in at]), depth, deep


def main():
    store = Path(__file__).with_name("finger_neohooke.json")
    rows = []
    meshes = [finger(fine) for fine in FINE_MM]
    for force in FORCES:
        straight, bent, depth, deep = pair(meshes[0], force)
        coarse = pair(meshes[1], force)
        most = float(np.linalg.norm(straight, axis=1).max())
        other = (coarse[1] - coarse[0]) - (bent - straight)
        own = float(np.linalg.norm(other, axis=1).max() / most)
        missed = float(np.linalg.norm(bent - straight, axis=1).max() / most)
        print(force, "depth", depth, deep, coarse[2:], "missed", missed, "own error", own, flush=True)
        rows.append(
            {
                "force_n": force,
                "linear_mm": straight.round(7).tolist(),
                "strained_mm": bent.round(7).tolist(),
                "indentation_linear_mm": depth,
                "indentation_mm": deep,
                "own_error": own,
            }
        )
        body = {"shape": "finger", "radius_mm": RADIUS, "barrel_mm": BARREL, "skirt_mm": SKIRT}
        found = {"body": body, "diameter_mm": 2.0 * BALL, "places_mm": np.round(places(), 9).tolist(), "cases": rows}
        store.write_text(json.dumps(found, indent=0))


if __name__ == "__main__":
    with ng.TaskManager():
        sys.exit(main())
