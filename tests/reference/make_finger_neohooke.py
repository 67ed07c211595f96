"""Makes finger_neohooke.json: what linear theory leaves out of a press on the finger, by NGSolve, by nothing of twin.

    python tests/reference/make_finger_neohooke.py     # needs ngsolve; half an hour

Half of the finger (radius 8, barrel 8, skirt 2 mm; E = 1 MPa, incompressible; held below, y = 0 a plane of symmetry)
under a rigid sphere of 3 mm that comes along z at the apex with a given force and no friction: once by linear theory,
the gap and the pressure along the undeformed normals, and once as neo-Hookean rubber, the sphere against the deformed
surface. Displacement of order 2, pressure of order 1, the sphere's depth an unknown. A penalty keeps the two apart,
raised in steps to 1000 MPa/mm. Stored: both displacements in mm at places inside, the indentations, and how far a
coarser mesh moves the difference of the two, over the largest displacement. The stored rows are of a solver that found
the depth apart, by steps of its own.
"""

import json
import math
from pathlib import Path

import ngsolve as ng
import numpy as np
from make_neohooke import half_mesh, linear_density, neo_hookean_density, newton
from netgen.occ import Box, Cylinder, HalfSpace, Pnt, Sphere, Vec, X, Z

RADIUS, BARREL, SKIRT, BALL = 8.0, 8.0, 2.0, 1.5
PENALTIES = (20.0, 60.0, 200.0, 1000.0)
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
    tip = Sphere(centre, RADIUS) * HalfSpace(Pnt(0, 0, 0), Vec(-1, 0, 0))
    top = Cylinder(Pnt(-BARREL, 0, RADIUS), X, RADIUS, BARREL) + tip
    top = top * Box(Pnt(-BARREL, 0, -1), Pnt(RADIUS + 1, RADIUS + 1, RADIUS))
    skirt = Box(Pnt(0, 0, RADIUS), Pnt(RADIUS + 1, RADIUS + 1, RADIUS + SKIRT))
    base = Cylinder(centre, Z, RADIUS, SKIRT) * skirt + Box(Pnt(-BARREL, 0, RADIUS), Pnt(0, RADIUS, RADIUS + SKIRT))
    names = {
        "held": lambda low, high: min(low.z, high.z) > RADIUS + SKIRT - 1e-3,
        "back": lambda low, high: max(low.x, high.x) < -BARREL + 1e-3,
        "touched": lambda low, high: min(low.z, high.z) < 1e-3,
    }
    dense = [(r, z, 0.06 * r * r) for r in np.arange(0.0, 2.6, 0.4) for z in np.arange(0.0, 2.2, 0.4)]
    return half_mesh(top + base, names, dense, fine, 1.3, maxh=2.5).Curve(ORDER)


def solve(state, force, linear, penalties):
    """Take Newton's steps from a state to the equilibrium under a force, with one penalty after the other."""
    space = state.space
    (u, p, d), (v, _, e) = space.TnT()
    form, penalty, grad = ng.BilinearForm(space), ng.Parameter(0.0), ng.Grad(u)
    touched, place = ng.ds("touched", bonus_intorder=12), ng.CF((ng.x, ng.y, ng.z))
    own = place - ng.CF((0.0, 0.0, d - BALL))
    if linear:
        density = linear_density(grad, p)
        core = ng.CF((ng.IfPos(ng.x, 0.0, ng.x), 0.0, RADIUS))
        inward = (core - place) / ng.Norm(core - place)
        ahead = own * inward
        root = ahead * ahead - own * own + BALL**2
        gap = ng.IfPos(root - 1e-3, ahead - ng.sqrt(ng.IfPos(root - 1e-3, root, 1e-3)), 10.0) + u * inward
        form += penalty * ng.IfPos(-gap, -gap, 0.0) * (inward[2] * e - inward * v) * touched
    else:
        f, own = ng.Id(3) + grad, own + u
        density = neo_hookean_density(ng.InnerProduct(f, f) - 3.0, ng.Det(f), p)
        gap = ng.sqrt(own * own) - BALL
        inside = ng.IfPos(-gap, gap, 0.0)
        form += ng.Variation(penalty / 2.0 * inside * inside * touched)
    # A tiny compressibility, 1e-7, is added: the saddle point is then regular.
    form += ng.Variation((density - 0.5e-7 * p * p) * ng.dx(bonus_intorder=4))
    area = ng.Integrate(ng.CF(1.0) * touched, space.mesh)
    form += -0.5 * force / area * e * touched
    for value in penalties:
        penalty.Set(value)
        newton(form, state)


def pair(mesh, force):
    """Return both displacements at the places, and both depths."""
    moves = ng.VectorH1(mesh, order=ORDER, dirichlet="held", dirichlety="held|mirror")
    space = moves * ng.H1(mesh, order=ORDER - 1) * ng.NumberSpace(mesh)
    print("unknowns", space.ndof, "elements", mesh.ne, flush=True)
    state = ng.GridFunction(space)
    moved, _, depth = state.components
    at = [mesh(*place) for place in places()]
    found = []
    for linear, start, penalties in ((True, 0.3, PENALTIES[::3]), (False, 0.06, PENALTIES)):
        depth.vec[0] += start
        solve(state, force, linear, penalties)
        found.append((np.array([moved(one) for one in at]), float(depth.vec[0])))
    (straight, linear_mm), (bent, deep_mm) = found
    return straight, bent, linear_mm, deep_mm


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
        print(force, "depth", depth, deep, coarse[2:], "own error", own, flush=True)
        strains = {"linear_mm": straight.round(7).tolist(), "strained_mm": bent.round(7).tolist()}
        depths = {"indentation_linear_mm": depth, "indentation_mm": deep}
        rows.append({"force_n": force, **strains, **depths, "own_error": own})
    body = {"shape": "finger", "radius_mm": RADIUS, "barrel_mm": BARREL, "skirt_mm": SKIRT}
    found = {"body": body, "diameter_mm": 2.0 * BALL, "places_mm": np.round(places(), 9).tolist(), "cases": rows}
    store.write_text(json.dumps(found, indent=0))


if __name__ == "__main__":
    with ng.TaskManager():
        main()
