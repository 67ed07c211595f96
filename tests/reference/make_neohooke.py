"""Makes neohooke.json and dome_neohooke.json: what linear theory leaves out of a press, by NGSolve, by nothing of twin.

    python tests/reference/make_neohooke.py slab     # needs ngsolve; minutes
    python tests/reference/make_neohooke.py dome

solves the presses that a file holds once more. A new one is a row of it with the press alone: ``kind`` and size of the
probe, ``force_n``, ``law``, ``ratios``, ``poisson_ratio``, the body's size, about how wide the contact gets
(``reach``), and ``places_mm`` (r, z).

An axisymmetric body, bonded below (E = 1 MPa), carries a rigid probe with a given force and no friction: once by linear
theory, its gap and its pressure along the undeformed normals, and once as neo-Hookean, Mooney-Rivlin or Yeoh rubber,
the probe against the deformed surface. The slab has a radius of 47.5 mm, is 40 mm thick or less; the dome is a part of
a ball. Displacement of order 3 and pressure of order 2. A penalty of 4000 MPa/mm (dome: 2000) keeps the two apart.
Stored: both displacements (r, z) in mm, the indentations, the radii of the contact (to about 1 % under a sphere:
Sneddon's exact sphere has 1.0627, 1.6394 and 2.0048 mm), and how far a check moves the difference of the two, over the
largest displacement: on a coarser mesh, on the slab of a higher order. The stored rows are those of meshes and solvers
that differ a little from these; those of the 6 mm sphere under 6 N and of rims of 0.1 and 0.05 mm had a penalty of
2000, and the check of the presses with nu below 0.5 on slabs is of order 3 on a mesh 1.5 times as coarse. A cylinder
that sticks (``sticks``) is pressed in steps: what has come to touch is held from then on, along the probe's surface
there, by a spring as stiff.
"""

import itertools
import json
import math
import sys
from pathlib import Path

import ngsolve as ng
import numpy as np
from netgen.meshing import MeshingParameters, NgException
from netgen.occ import Circle, Glue, MoveTo, OCCGeometry

RADIUS, THICK = 47.5, 40.0
TOUCHED = ng.ds("touched", bonus_intorder=10)
FILES = {"slab": "neohooke.json", "dome": "dome_neohooke.json"}


def height(case, r):
    """How far the probe's surface lies above its lowest point at a distance r from its axis."""
    positive = lambda x: ng.IfPos(x, x, 0.0)  # noqa: E731
    if case.get("kind", "sphere") == "sphere":
        big = case["diameter_mm"] / 2
        return big - ng.sqrt(ng.IfPos(0.999 * big * big - r * r, big * big - r * r, 0.001 * big * big))
    if case["kind"] == "cylinder":
        edge = case["edge_mm"]
        over = positive(r - (case["diameter_mm"] / 2 - edge))
        root = ng.sqrt(ng.IfPos(0.99 * edge**2 - over**2, edge**2 - over**2, 0.01 * edge**2))
        return edge - root + 9 * positive(over - 0.99 * edge)
    half, tip = math.radians(case["apex_deg"] / 2), case["tip_mm"]
    meet = tip * math.cos(half)
    ball = tip - ng.sqrt(ng.IfPos(meet * meet - r * r, tip * tip - r * r, tip * tip - meet * meet))
    return ng.IfPos(r - meet, tip - tip * math.sin(half) + (r - meet) / math.tan(half), ball)


def box(wide, deep, size, start=0.0):
    face = MoveTo(start, 0).Rectangle(wide, deep).Face()
    face.faces.maxh = size
    return face


def slab(case, fine):
    """The half section (r, depth), elements small where the contact ends: in nested boxes around a cylinder's rim."""
    thick, reach = case.get("thickness_mm", THICK), case["reach"]
    whole = box(RADIUS, thick, min(6.0, thick / 2.0))
    if case["kind"] == "cylinder":
        radius, edge = case["diameter_mm"] / 2.0, case["edge_mm"]
        near = box(4.0 * radius, min(3.0 * radius, thick), min(0.5 * radius, thick / 3.0) * fine)
        last = box(1.6 * radius, min(0.8 * radius, thick), 0.15 * radius * fine)
        parts, smallest, wide = [whole - near, near - last], edge / 8.0, 0.32 * radius
        while wide / 5.0 > smallest / 2.0:
            inside = box(2.0 * wide, wide, max(smallest, wide / 5.0) * fine, radius - edge / 2.0 - wide)
            parts.append(last - inside)
            last = inside
            wide /= 2.0
        return meshed([*parts, last], thick)
    near = box(3.0 * reach, min(3.0 * reach, thick), 0.5 * fine * reach)
    inner = box(1.25 * reach, 0.6 * reach, 0.08 * fine * reach)
    end = box(0.3 * reach, 0.15 * reach, 0.025 * fine * reach, 0.66 * reach)
    return meshed([whole - near, near - inner, inner - end, end], thick)


def dome(case, fine):
    """The half section (r, depth), elements small where the contact ends."""
    radius, deep, reach = case["radius_mm"], case["height_mm"], case["reach"]
    whole = Circle((0, radius), radius).Face() * box(2 * radius, deep, radius)
    near = box(min(3 * reach, 0.9 * radius), min(3 * reach, 0.8 * deep), reach) * whole
    inner = box(1.4 * reach, 0.8 * reach, reach) * whole
    end = box(0.6 * reach, 0.25 * reach, reach, 0.65 * reach) * whole
    whole.faces.maxh = min(radius / 5, deep / 4) * fine
    near.faces.maxh, inner.faces.maxh, end.faces.maxh = (share * fine * reach for share in (0.35, 0.1, 0.03))
    mesh = meshed([whole - near, near - inner, inner - end, end], deep, lambda r, z: np.hypot(r, z - radius) - radius)
    mesh.Curve(4)
    return mesh


def meshed(parts, deep, below=lambda r, z: z):
    """Return the mesh of a half section, its border named; ``below`` tells how far points are from the surface."""
    glued = Glue(parts)
    for edge in glued.edges:
        r, z = np.array([[vertex.p.x, vertex.p.y] for vertex in edge.vertices]).T
        for name, off in (("held", z - deep), ("axis", r), ("touched", below(r, z))):
            if np.abs(off).max() < 1e-6:
                edge.name = name
    return ng.Mesh(OCCGeometry(glued, dim=2).GenerateMesh(maxh=6.0, grading=0.4))


def linear_density(grad, p, shear=1.0 / 3.0):
    """Energy per volume of incompressible rubber (E = 1 MPa) by linear theory; ``p`` is the pressure."""
    strain = 0.5 * (grad + grad.trans)
    return shear * ng.InnerProduct(strain, strain) + p * ng.Trace(grad)


def neo_hookean_density(first, ratio, p, shear=1.0 / 3.0):
    """The same at finite strain, of the first invariant less 3 and the ratio of volumes."""
    return shear / 2.0 * (first + (ratio - 1.0) ** 2) + (p - shear) * (ratio - 1.0)


def at_points(value, store, where):
    """Return a term's values at the points of a boundary at which ``store`` keeps numbers."""
    store.Interpolate(value, definedon=where)
    return store.vec.FV().NumPy().copy()


def half_mesh(body, names, places, fine, near, **settings):
    """Return the mesh of half a body (y = 0 a plane of symmetry), elements as small as ``fine`` within ``near`` of
    the places (r, z); ``names`` are tests of faces' lowest and highest corners by name, the first that holds counts."""
    names = {"mirror": lambda low, high: max(abs(low.y), abs(high.y)) < 1e-3, **names, "side": lambda *_: True}
    for face in body.faces:
        face.name = next(name for name, holds in names.items() if holds(*face.bounding_box))
    wanted = MeshingParameters(grading=0.35, **settings)
    for r, z, depth in places:
        for angle in np.linspace(0.0, math.pi, 9):
            size = fine * max(1.0, math.hypot(r, z) / near)
            wanted.RestrictH(r * math.cos(angle), r * math.sin(angle), z + depth, size)
    return ng.Mesh(OCCGeometry(body).GenerateMesh(wanted))


def newton(form, state, tolerance=1e-9):
    """Take Newton's steps from a state to where no more force than ``tolerance`` is left."""
    free = np.array([bool(one) for one in state.space.FreeDofs()])
    right, step, old = (state.vec.CreateVector() for _ in range(3))

    def left():
        form.Apply(state.vec, right)
        return float(np.linalg.norm(right.FV().NumPy()[free]))

    size = left()
    for _ in range(200):
        form.AssembleLinearization(state.vec)
        left()
        step.data = form.mat.Inverse(state.space.FreeDofs(), inverse="umfpack") * right
        old.data, share = state.vec, 1.0
        for _ in range(12):
            state.vec.data = old - share * step
            now = left()
            if now < max(1.2 * size, tolerance):
                break
            share /= 2.0
        size = now
        if size < tolerance and share == 1.0:
            return
    raise RuntimeError(f"left {size}")


class Press:
    """A press of a case on one mesh, by linear theory or not; the probe's depth is an unknown."""

    def __init__(self, case, mesh, order, linear):
        self.case, self.mesh, self.linear, self.force = case, mesh, linear, ng.Parameter(0.0)
        moves = ng.VectorH1(mesh, order=order, dirichletx="held|axis", dirichlety="held")
        space = moves * ng.H1(mesh, order=order - 1) * ng.NumberSpace(mesh)
        self.state = ng.GridFunction(space)
        (u, p, d), (v, _, e) = space.TnT()
        nu, weight, hoop, grad = case.get("poisson_ratio", 0.5), 2.0 * math.pi * ng.x, u[0] / ng.x, ng.Grad(u)
        shear, form, penalty = 0.5 / (1.0 + nu), ng.BilinearForm(space), 2000.0 if "radius_mm" in case else 4000.0
        if linear:
            strain = 0.5 * (grad + grad.trans)
            density = shear * (ng.InnerProduct(strain, strain) + hoop * hoop) + p * (ng.Trace(grad) + hoop)
            normal = self.normal()
            form += weight * penalty * self.inside(u, d) * (normal[1] * e - normal * v) * TOUCHED
        else:
            density = strained(case, shear, ng.Id(2) + grad, 1.0 + hoop, p)
            form += ng.Variation(weight * penalty / 2.0 * self.inside(u, d) * self.inside(u, d) * TOUCHED)
        # incompressible rubber is made softer by 1e-7
        softness = (1.0 - 2.0 * nu) * (1.0 + nu) / nu + 1e-7
        form += ng.Variation((weight * (density - softness / 2.0 * p * p)).Compile() * ng.dx(bonus_intorder=4))
        if case.get("sticks"):
            form += ng.Variation(self.spring(u, d) * weight * penalty / 2.0 * self.ds)
        area = ng.Integrate(weight * TOUCHED, mesh)
        form += -weight * self.force / area * e * TOUCHED
        self.form = form

    def spring(self, moved, depth):
        """The square of how far points that touch are from where they came to, along the cylinder's surface."""
        points = ng.comp.IntegrationRuleSpaceSurface(self.mesh, order=8, definedon=self.mesh.Boundaries("touched"))
        self.ds = ng.ds(definedon=self.mesh.Boundaries("touched"), intrules=points.GetIntegrationRules())
        self.held = [ng.GridFunction(points) for _ in range(3)]
        r, z, on = self.held
        over = r - (self.case["diameter_mm"] / 2.0 - self.case["edge_mm"])
        sine = 0.0 if self.linear else ng.IfPos(over, over / self.case["edge_mm"], 0.0)
        cosine = ng.sqrt(1.0 - ng.IfPos(sine - 0.99, 0.98, sine * sine))
        here = self.own(moved, depth)
        away = (here[0] - r) * cosine - (here[1] - z) * sine
        return on * ng.IfPos(self.inside(moved, depth), 1.0, 0.0) * away * away

    def own(self, moved, depth):
        """Where points are from the probe's lowest point; by linear theory how far they moved along r."""
        return (moved[0], 0.0 * ng.x) if self.linear else (ng.x + moved[0], ng.y + moved[1] - depth)

    def remember(self):
        """Hold what has come to touch."""
        u, depth, found = self.state.components[0], float(self.state.components[2].vec[0]), []
        for value in (*self.own(u, depth), ng.IfPos(self.inside(u, depth), 1.0, 0.0)):
            at = ng.GridFunction(self.held[0].space)
            at.Interpolate(value, definedon=self.mesh.Boundaries("touched"))
            found.append(at.vec.FV().NumPy())
        r, z, on = (one.vec.FV().NumPy() for one in self.held)
        new = (found[2] > 0.5) & (on < 0.5)
        r[new], z[new], on[:] = found[0][new], found[1][new], found[2]

    def normal(self):
        """The undeformed normal, into the rubber."""
        if "radius_mm" not in self.case:
            return ng.CF((0.0, 1.0))
        radius = self.case["radius_mm"]
        return ng.CF((-ng.x / radius, (radius - ng.y) / radius))

    def inside(self, moved, depth):
        """How far the surface is inside the probe."""
        if not self.linear:
            gap = height(self.case, ng.x + moved[0]) + ng.y + moved[1] - depth
        elif "radius_mm" not in self.case:
            gap = height(self.case, ng.x) + moved[1] - depth
        else:  # along the normals to the sphere
            normal, ball = self.normal(), self.case["diameter_mm"] / 2.0
            below = ng.y - depth + ball
            ahead = ng.x * normal[0] + below * normal[1]
            root = ahead * ahead - ng.x * ng.x - below * below + ball * ball
            rest = ng.IfPos(root - 1e-3, ahead - ng.sqrt(ng.IfPos(root - 1e-3, root, 1e-3)), 10.0)
            gap = rest + moved * normal
        return ng.IfPos(-gap, -gap, 0.0)

    def solve(self, force):
        """Take Newton's steps to the equilibrium under a force."""
        self.force.Set(force)
        newton(self.form, self.state)

    def found(self):
        """Return displacements at the places, the depth, and the radius of the contact, mm."""
        u, depth = self.state.components[0], float(self.state.components[2].vec[0])
        at = np.array([[*u(self.mesh(max(r, 1e-6), z))] for r, z in self.case["places_mm"]])
        return at, depth, self.contact_radius(u, depth)

    def contact_radius(self, u, depth):
        """Return how far from the axis the surface that touches reaches, deformed (linear: at rest), mm.

        Where pressure falls to 0 as a square root, the force beyond r does so as the power 3/2 of the distance to the
        end. The force smooths what the penalty leaves in the pressure, so a parabola through its power 2/3 over r^2
        ends there.
        """
        rest, z = np.linspace(1e-6, self.case["reach"], 4001), np.zeros(4001)
        if "radius_mm" in self.case:
            radius = self.case["radius_mm"]
            angle = 2.2 * rest / radius
            rest, z = radius * np.sin(angle) * (1 - 1e-9), radius - radius * np.cos(angle) * (1 - 1e-9)
        points = [self.mesh(*place) for place in zip(rest, z, strict=True)]
        inside = self.inside(u, depth)
        beyond = np.cumsum((np.array([inside(one) for one in points]) * rest)[::-1])[::-1]
        share = beyond / beyond[0]
        near = (share > 0.01) & (share < 0.5)
        ends = np.polynomial.Polynomial.fit(rest[near] ** 2, share[near] ** (2 / 3), 2).roots()
        end = math.sqrt(ends[np.argmin(np.abs(ends - rest[near][-1] ** 2))].real)
        return end if self.linear else float(np.interp(end, rest, rest + [u(one)[0] for one in points]))


def strained(case, shear, f, ring, p):
    """Energy per volume of the plane gradient ``f`` and the stretch around the axis, without what is softened."""
    law, ratios = case.get("law", "neo_hookean"), case.get("ratios", ())
    ratio = ng.Det(f) * ring
    first = ng.InnerProduct(f, f) + ring * ring - 3.0
    second = ring * ring * ng.InnerProduct(f, f) + ng.Det(f) * ng.Det(f) - 3.0
    energy, share, bend = first, 0.0, -1.0
    if law == "mooney_rivlin":
        energy, share = (first + ratios[0] * second) / (1.0 + ratios[0]), ratios[0] / (1.0 + ratios[0])
        bend += share
    elif law == "yeoh":
        energy, bend = first + ratios[0] * first * first + ratios[1] * first * first * first, 4.0 * ratios[0] - 1.0
    at_rest = shear * ((1.0 + share) * (ratio - 1.0) + bend / 2.0 * (ratio - 1.0) * (ratio - 1.0))
    return shear / 2.0 * energy + p * (ratio - 1.0) - at_rest


def pair(case, order, mesh):
    """Return displacements, depth and contact radius by linear theory, and at finite strain."""
    straight, bent = (Press(case, mesh, order, linear) for linear in (True, False))
    first = min(0.3, case["force_n"] / 6.0, 0.3 * case["reach"])
    straight.state.components[2].vec[0] = first
    if case.get("sticks"):
        straight.state.components[2].vec[0] = bent.state.components[2].vec[0] = first / 15.0
        for press, part in itertools.product((straight, bent), range(1, 7)):
            press.solve(case["force_n"] * (part / 6.0) ** 2)
            press.remember()
        return straight.found(), bent.found()
    for share in (0.25, 1.0):
        straight.solve(share * case["force_n"])
    bent.state.vec.data = straight.state.vec
    try:
        bent.solve(case["force_n"])
    except (RuntimeError, NgException):  # from rest, in load steps
        bent.state.vec[:] = 0.0
        bent.state.components[2].vec[0] = first
        for share in (0.05, 0.1, 0.2, 0.45, 0.7, 1.0):
            bent.solve(share * case["force_n"])
    return straight.found(), bent.found()


def main(body):
    file = Path(__file__).with_name(FILES[body])
    stored = json.loads(file.read_text())
    make, check = {"slab": (slab, (4, 1.4)), "dome": (dome, (3, 1.6))}[body]
    for case in stored["cases"]:
        (straight, bent), coarse = pair(case, 3, make(case, 1.0)), pair(case, check[0], make(case, check[1]))
        most = np.linalg.norm(straight[0], axis=1).max()
        other = coarse[1][0] - coarse[0][0] - (bent[0] - straight[0])
        for name, (moved, depth, radius) in (("_linear", straight), ("", bent)):
            case["linear_mm" if name else "strained_mm"] = moved.round(7).tolist()
            case |= {f"indentation{name}_mm": depth, f"contact{name}_mm": radius}
        case["own_error"] = float(np.linalg.norm(other, axis=1).max() / most)
        print({key: value for key, value in case.items() if not isinstance(value, list)}, flush=True)
    file.write_text(json.dumps(stored) + "\n")


if __name__ == "__main__":
    ng.SetNumThreads(1)
    main(sys.argv[1])
