"""Makes twisted_neohooke.json: a sphere that is pressed, turned about its axis and slips, by nothing of twin.

    python tests/reference/make_twisted_neohooke.py     # needs ngsolve; six minutes of one core

A round slab (radius 47.5 mm, 40 mm thick, held below, E = 1 MPa, incompressible) under a rigid sphere of 6 mm with
Coulomb's friction: pressed by a force, then turned. How points move, and how far they turn, depends on radius and depth
alone, so NGSolve's elements are plane: displacement and turn of order 3, pressure of order 2. Once as neo-Hookean
rubber, against the sphere, and once by linear theory, its gap along the undeformed normals. A penalty of 4000 MPa/mm
keeps the two apart, a spring of 1000 MPa/mm holds each point to its place on the sphere, as far as friction carries it.
That place moves on after every part of the path. Stored: by step, displacements in mm (outward, around, inward) at
radius and depth, force and torque, indentation, and which share of the contact slips. Own error: the same on elements
1.5 times as long, in three parts of four, over the largest displacement.
"""

import json
import math
from pathlib import Path

import ngsolve as ng
import numpy as np
from make_neohooke import RADIUS, THICK, at_points, box, meshed, neo_hookean_density, newton

BALL, REACH = 3.0, 1.7
SHEAR, PENALTY, SPRING = 1.0 / 3.0, 4000.0, 1000.0
FORCE, FRICTION, TURNS = 1.5, 0.5, (0.06, 0.12, 0.25)
RADII = (0.0, 0.5, 0.75, 1.0, 1.25, 1.5, 2.25, 3.0, 4.5, 6.0, 9.0)
PLACES = [(r, z) for z in (1.0, 1.5, 3.0, 6.0) for r in RADII]
ORDER = 3


def slab(fine):
    """The half section (r, depth), elements small under the sphere."""
    whole = box(RADIUS, THICK, 6.0)
    near = box(3.0 * REACH, 3.0 * REACH, 0.4 * REACH * fine)
    inner = box(1.1 * REACH, 0.35 * REACH, 0.05 * REACH * fine)
    return meshed([whole - near, near - inner, inner], THICK)


class Sphere:
    """The sphere's path on one mesh, by linear theory or not."""

    def __init__(self, mesh, linear):
        self.mesh, self.linear = mesh, linear
        moves = ng.VectorH1(mesh, order=ORDER, dirichletx="held|axis", dirichlety="held")
        turn = ng.H1(mesh, order=ORDER, dirichlet="held")
        self.space = moves * turn * ng.H1(mesh, order=ORDER - 1) * ng.NumberSpace(mesh)
        self.state = ng.GridFunction(self.space)
        self.state.components[3].vec[0] = 0.1
        self.turned, self.friction, self.push = ng.Parameter(0.0), ng.Parameter(FRICTION), ng.Parameter(0.0)
        where = mesh.Boundaries("touched")
        points = ng.comp.IntegrationRuleSpaceSurface(mesh, order=2 * ORDER + 2, definedon=where)
        self.where, self.ds = where, ng.ds(definedon=where, intrules=points.GetIntegrationRules())
        self.anchor = [ng.GridFunction(points) for _ in range(3)]
        self.on, self.value = ng.GridFunction(points), ng.GridFunction(points)
        (u, t, p, d), (v, s, _, e) = self.space.TnT()
        weight, r = 2.0 * math.pi * ng.x, ng.x
        grad, slope, hoop = ng.Grad(u), ng.Grad(t), u[0] / ng.x
        form = ng.BilinearForm(self.space)
        if linear:
            strain = 0.5 * (grad + grad.trans)
            energy = SHEAR * (ng.InnerProduct(strain, strain) + hoop * hoop + 0.5 * r * r * (slope * slope))
            energy += p * (grad[0, 0] + grad[1, 1] + hoop)
        else:
            f = ng.Id(2) + grad
            ratio = ng.Det(f) * (1.0 + hoop)
            first = ng.InnerProduct(f, f) + (1.0 + hoop) ** 2 + (r + u[0]) ** 2 * (slope * slope) - 3.0
            energy = neo_hookean_density(first, ratio, p)
        form += ng.Variation(weight * energy * ng.dx(bonus_intorder=4))
        found = self.contact(u, t, d)
        pull, around = found["pull"], found["around"]
        form += weight * (pull[1] * e - pull * v - around * self.radius(u) * s) * self.ds
        form += -weight * self.push / (math.pi * RADIUS**2) * e * ng.ds("touched")
        self.form = form

    def radius(self, u):
        """How far points are from the axis."""
        return ng.x if self.linear else ng.x + u[0]

    def contact(self, u, t, d):
        """What acts on the rubber per area, how far friction carries, and the places on the sphere to remember."""
        if self.linear:
            r2 = ng.x * ng.x
            rise = BALL - ng.sqrt(ng.IfPos(0.98 * BALL**2 - r2, BALL**2 - r2, 0.02 * BALL**2))
            gap, normal, own = rise + u[1] - d, ng.CF((0.0, 1.0)), u
        else:
            own = ng.CF((ng.x + u[0], ng.y + u[1] - d + BALL))
            size = ng.sqrt(own * own)
            gap, normal = size - BALL, own / size
        angle, along = t - self.turned, ng.CF((normal[1], -normal[0]))
        away = (own - ng.CF((self.anchor[0], self.anchor[1]))) * along
        around = self.radius(u) * (angle - self.anchor[2])
        far = ng.sqrt(away * away + around * around + 1e-18)
        pressure = PENALTY * ng.IfPos(-gap, -gap, 0.0)
        most = self.friction * pressure / SPRING
        share = self.on * ng.IfPos(far - most, most / far, 1.0)
        touches = ng.IfPos(-gap, 1.0, 0.0)
        back = own - share * away * along
        return {
            "pull": pressure * normal - SPRING * share * away * along,
            "around": -SPRING * share * around,
            "touches": touches,
            "slips": self.on * touches * ng.IfPos(1.0 - 1e-7 - share, 1.0, 0.0),
            "kept": (back[0], back[1], angle - share * around / (self.radius(u) + 1e-9)),
        }

    def now(self):
        u, t, _, d = self.state.components
        return u, t, float(d.vec[0])

    def remember(self):
        """Hold what touches where it is on the sphere, where it slips as far as friction carries it."""
        found = self.contact(*self.now())
        touches, *kept = (at_points(one, self.value, self.where) for one in (found["touches"], *found["kept"]))
        touches = touches > 0.5
        for held, now in zip(self.anchor, kept, strict=True):
            held.vec.FV().NumPy()[touches] = now[touches]
        self.on.vec.FV().NumPy()[:] = touches

    def reached(self):
        """Return what is stored of a step."""
        u, t, d = self.now()
        found = self.contact(u, t, d)

        def total(value):
            return float(ng.Integrate(2.0 * math.pi * ng.x * value * self.ds, self.mesh))

        moved = []
        for r, z in PLACES:
            here = self.mesh(max(r, 1e-6), z)
            (out, down), turn = u(here), t(here)
            if self.linear:
                moved.append([out, r * turn, down])
            else:
                moved.append([(r + out) * math.cos(turn) - r, (r + out) * math.sin(turn), down])
        return {
            "force_n": total(found["pull"][1]),
            "torque_nmm": total(found["around"] * self.radius(u)),
            "indentation_mm": d,
            "slipping": total(found["slips"]) / total(found["touches"]),
            "moved_mm": np.round(moved, 7).tolist(),
        }

    def take(self, parts):
        """Return what is stored of the press and of every turn."""
        for part in range(1, parts[0] + 1):
            self.push.Set(FORCE * (part / parts[0]) ** 1.5)
            newton(self.form, self.state)
            found = [self.reached()]
            self.remember()
        past = 0.0
        for turn in TURNS:
            for part in range(1, parts[1] + 1):
                self.turned.Set(past + (turn - past) * part / parts[1])
                # All sticks at first; then friction carries less and less.
                for more in (1e4, 8.0, 3.0, 1.5, 1.0):
                    self.friction.Set(FRICTION * more)
                    newton(self.form, self.state, 1e-9 if more == 1.0 else 1e-5)
                reached = self.reached()
                self.remember()
            past = turn
            found.append(reached)
        return found


def main():
    linear, bent = (Sphere(slab(1.0), one).take((8, 4)) for one in (True, False))
    coarse = Sphere(slab(1.5), False).take((6, 3))
    own = []
    for fine, other in zip(bent, coarse, strict=True):
        here, there = np.array(fine["moved_mm"]), np.array(other["moved_mm"])
        own.append(float(np.linalg.norm(here - there, axis=1).max() / np.linalg.norm(here, axis=1).max()))
    store = {
        "diameter_mm": 2.0 * BALL,
        "friction": FRICTION,
        "turns_deg": [0.0, *np.degrees(TURNS).tolist()],
        "places_mm": PLACES,
        "own_error": own,
        "linear": linear,
        "strained": bent,
    }
    Path(__file__).with_name("twisted_neohooke.json").write_text(json.dumps(store))


if __name__ == "__main__":
    main()
