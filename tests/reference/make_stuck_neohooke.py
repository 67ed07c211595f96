"""Makes stuck_neohooke.json: what linear theory leaves out of a sphere that sticks, by NGSolve, by nothing of twin.

    python tests/reference/make_stuck_neohooke.py     # needs ngsolve; a quarter of an hour

Half of a round slab (radius 28 mm, 40 mm thick, held below, E = 1 MPa, incompressible; y = 0 a plane of symmetry)
under a rigid sphere of 6 mm that is moved into it and then along x, and sticks: once as neo-Hookean rubber, and once by
linear theory, its gap along the undeformed normals, under about the same forces. A point that has come to touch is held
from then on, in the plane of the sphere's surface there, by a spring to its place on the sphere; so is the gap, by
500 MPa/mm. Displacement of order 2, pressure of order 1. Stored: both displacements in mm at places inside after
either step, the linear ones scaled to the same forces, the forces, and the motions. One mesh: on a coarser one the
linear path does not converge, so how good it is itself is not known.
"""

import json
from pathlib import Path

import ngsolve as ng
import numpy as np
from make_neohooke import at_points, half_mesh, linear_density, neo_hookean_density
from netgen.occ import Box, Cylinder, Pnt, Z

BALL, RADIUS, THICK = 3.0, 28.0, 40.0
SPRING = 500.0
DEEP_MM, ASIDE_MM = 0.62, 0.25
LINEAR_MM = 0.609112, 0.264518
PARTS, LINEAR_PARTS = (8, 4), (4, 1)
FINE_MM = 0.5
PLACES = [
    (x, y, z)
    for z in (1.0, 1.5, 3.0, 6.0)
    for x in (-6, -4, -2.5, -1.5, -0.75, 0, 0.75, 1.5, 2.5, 4, 6)
    for y in (0.0, 0.75, 1.5, 3.0)
]


def slab(fine):
    """The half y >= 0, elements small under the sphere."""
    body = Cylinder(Pnt(0, 0, 0), Z, RADIUS, THICK) * Box(Pnt(-RADIUS - 1, 0, 0), Pnt(RADIUS + 1, RADIUS + 1, THICK))
    names = {"touched": lambda low, high: high.z < 1e-3, "held": lambda low, high: low.z > THICK - 1e-3}
    dense = [(r, z, 0.0) for r in np.arange(0.0, 2.9, 0.4) for z in np.arange(0.0, 2.4, 0.4)]
    return half_mesh(body, names, dense, fine, 1.8, maxh=9.0)


class Sphere:
    """The sphere's path on one mesh, by linear theory or not."""

    def __init__(self, mesh, linear):
        moves = ng.VectorH1(mesh, order=2, dirichlet="held", dirichlety="held|mirror")
        self.space = moves * ng.H1(mesh, order=1)
        self.mesh, self.linear, self.count = mesh, linear, moves.ndof
        self.state = ng.GridFunction(self.space)
        self.aside, self.deep, self.stiff = (ng.Parameter(x) for x in (0.0, 0.0, 1.0))
        self.where = mesh.Boundaries("touched")
        points = ng.comp.IntegrationRuleSpaceSurface(mesh, order=5, definedon=self.where)
        self.ds = ng.ds(definedon=self.where, intrules=points.GetIntegrationRules())
        self.anchor = [ng.GridFunction(points) for _ in range(3)]
        self.on = ng.GridFunction(points)
        self.value = ng.GridFunction(points)
        (u, p), form = self.space.TrialFunction(), ng.BilinearForm(self.space, symmetric=True)
        grad = ng.Grad(u)
        if linear:
            density = linear_density(grad, p)
            self.normal = ng.CF((0.0, 0.0, 1.0))
        else:
            f = ng.Id(3) + grad
            density = neo_hookean_density(ng.InnerProduct(f, f) - 3.0, ng.Det(f), p)
            held = ng.CF(tuple(self.anchor))
            self.normal = held / ng.sqrt(held * held + 1e-12)
        # The saddle point is factored without pivots: a tiny compressibility, 1e-7, is added.
        form += ng.Variation((density - 0.5e-7 * p * p) * ng.dx(bonus_intorder=3))
        gap = self.gap(u)
        inside = ng.IfPos(-gap, gap, 0.0)
        form += ng.Variation(self.stiff * SPRING / 2.0 * inside * inside * self.ds)
        pulled = self.pulled(u)
        form += ng.Variation(self.stiff * self.on * ng.IfPos(-gap, 1, 0) * SPRING / 2.0 * (pulled * pulled) * self.ds)
        self.form = form

    def own(self, moved):
        """Places from the sphere's middle."""
        return ng.CF((ng.x, ng.y, ng.z)) + moved - ng.CF((self.aside, 0.0, self.deep - BALL))

    def gap(self, moved):
        if not self.linear:
            own = self.own(moved)
            return ng.sqrt(own * own) - BALL
        r2 = ng.x * ng.x + ng.y * ng.y
        rise = BALL - ng.sqrt(ng.IfPos(BALL**2 * 0.98 - r2, BALL**2 - r2, 0.02 * BALL**2))
        return rise + moved[2] - self.deep

    def pulled(self, moved):
        """How far points are from their places on the sphere, along its surface."""
        away = self.own(moved) - ng.CF(tuple(self.anchor))
        return away - (away * self.normal) * self.normal

    def newton(self, tolerance):
        right, step = self.state.vec.CreateVector(), self.state.vec.CreateVector()
        for _ in range(40):
            self.form.AssembleLinearization(self.state.vec)
            self.form.Apply(self.state.vec, right)
            step.data = self.form.mat.Inverse(self.space.FreeDofs(), inverse="sparsecholesky") * right
            size = float(np.abs(step.FV().NumPy()[: self.count]).max())
            self.state.vec.data -= min(1.0, 0.15 / max(size, 1e-30)) * step
            if size < tolerance:
                return
        raise RuntimeError(f"left {size}")

    def remember(self):
        """Hold what has come to touch."""
        moved = self.state.components[0]
        on = self.on.vec.FV().NumPy()
        touches = at_points(ng.IfPos(-self.gap(moved), 1.0, 0.0), self.value, self.where) > 0.5
        own = self.own(moved)
        for axis in range(3):
            here = at_points(own[axis], self.value, self.where)
            held = self.anchor[axis].vec.FV().NumPy()
            held[touches & (on < 0.5)] = here[touches & (on < 0.5)]
        on[:] = touches

    def reached(self):
        """Return the force along x and z, N, and the displacements, mm."""
        moved = self.state.components[0]
        gap = self.gap(moved)
        inside = ng.IfPos(-gap, gap, 0.0)
        normal = self.normal
        if not self.linear:
            own = self.own(moved)
            normal = own / ng.sqrt(own * own)
        force = -SPRING * inside * normal
        force -= SPRING * self.on * ng.IfPos(-gap, 1, 0) * self.pulled(moved)
        total = [2.0 * ng.Integrate(force[k] * self.ds, self.mesh) for k in (0, 2)]
        return total, np.array([[*moved(self.mesh(*place))] for place in PLACES])

    def take(self, deep, aside, parts):
        """Return what is reached by pressing, and by moving along x from there."""
        for part in range(1, parts[0] + 1):
            self.deep.Set(deep * (part / parts[0]) ** 2)
            for stiff, tolerance in ((0.05, 1e-2), (0.25, 3e-3), (1.0, 3e-6)):
                self.stiff.Set(stiff)
                self.newton(tolerance)
            self.remember()
            print("pressed", part, self.reached()[0], flush=True)
        found = [self.reached()]
        for part in range(1, parts[1] + 1):
            self.aside.Set(aside * part / parts[1])
            self.newton(3e-6)
            self.remember()
            print("moved", part, self.reached()[0], flush=True)
        return [*found, self.reached()]


def both(fine):
    """Return the steps at finite strain, and by linear theory under the same forces."""
    mesh = slab(fine)
    bent = Sphere(mesh, linear=False).take(DEEP_MM, ASIDE_MM, PARTS)
    straight = Sphere(mesh, linear=True).take(*LINEAR_MM, LINEAR_PARTS)
    press = bent[0][0][1] / straight[0][0][1]
    side = bent[1][0][0] / straight[1][0][0]
    assert abs(press - 1.0) < 0.03, press
    assert abs(side - 1.0) < 0.05, side
    pressed = press * straight[0][1]
    added = side * (straight[1][1] - straight[0][1])
    more = bent[1][0][1] / bent[0][0][1]
    linear = [pressed, more * pressed + added]
    motion = LINEAR_MM[0] * press ** (2.0 / 3.0), LINEAR_MM[1] * side
    return bent, linear, motion


def main():
    bent, linear, motion = both(FINE_MM)
    steps = []
    for (force, strained), straight in zip(bent, linear, strict=True):
        most = np.linalg.norm(straight, axis=1).max()
        print("force", force, "off", np.linalg.norm(strained - straight, axis=1).max() / most)
        steps.append(
            {"force_n": force, "linear_mm": straight.round(7).tolist(), "strained_mm": strained.round(7).tolist()}
        )
    store = {
        "diameter_mm": 2.0 * BALL,
        "places_mm": PLACES,
        "motion_mm": [DEEP_MM, ASIDE_MM],
        "motion_linear_mm": motion,
        "steps": steps,
    }
    Path(__file__).with_name("stuck_neohooke.json").write_text(json.dumps(store, indent=0))


if __name__ == "__main__":
    main()
