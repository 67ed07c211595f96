"""Makes the files of neo-Hookean presses: what linear theory leaves out of them, by NGSolve, by nothing of twin.

    python tests/reference/make_neohooke.py slab   # or dome, finger, tilted, stuck, twisted; needs ngsolve; minutes

solves the presses that a file holds once more, at its places, once by linear theory, gap and pressure along the
undeformed normals, and once at finite strain, the rigid probe against the deformed surface; E = 1 MPa, held below. A
penalty keeps the two apart. Displacements (also stuck, twisted: forces, torques) are stored, and indentations in mm;
``own_error`` is how far a check on a coarser mesh moves what is stored, over the largest displacement.

* slab, dome: bodies of revolution (radius 47.5 mm, 40 mm thick or less; a part of a ball) under a force without
  friction; neo-Hookean, Mooney-Rivlin or Yeoh. A new press is a row with ``kind`` and size of the probe, ``force_n``,
  ``law``, ``ratios``, ``poisson_ratio``, the body's size, about how wide the contact gets (``reach``), and
  ``places_mm`` (r, z). Displacement of order 3 and pressure of order 2; penalty 4000 MPa/mm (dome: 2000). Stored too:
  the contact's radii (to about 1 % under a sphere: Sneddon's exact sphere has 1.0627, 1.6394 and 2.0048 mm). The
  check is of a higher order on the slab. The stored rows are those of meshes and solvers that differ a little from
  these; those of the 6 mm sphere under 6 N and of rims of 0.1 and 0.05 mm had a penalty of 2000, and the check of the
  presses with nu below 0.5 on slabs is of order 3 on a mesh 1.5 times as coarse. A cylinder that sticks (``sticks``)
  is pressed in steps: what has come to touch is held from then on, along the probe's surface there, by a spring as
  stiff.
* finger: half of it (y = 0 a plane of symmetry) under a sphere along z at the apex, without friction; order 2 and 1,
  the penalty raised in steps to 1000 MPa/mm. The stored rows are of a solver that found the depth apart.
* tilted: half of a block of 24 x 24 x 10 mm under a cylinder with a round rim that is tilted about y, without friction
  or sticking, as on the slab; the middle of its face stays at x = 0. Elements and penalty are the finger's. Stored of
  one that sticks: the force along x.
* stuck: half of a round slab of 28 mm radius under a 6 mm sphere that is moved into it and then along x, and sticks:
  a point that has come to touch is held from then on, in the plane of the sphere's surface there, by a spring to its
  place on the sphere; so is the gap, by 500 MPa/mm. Order 2 and 1. The linear displacements are under about the same
  forces, scaled to them. One mesh: on a coarser one the linear path does not converge, so how good it is itself is
  not known.
* twisted: the slab under a 6 mm sphere with Coulomb's friction, pressed by 1.5 N, then turned. How points move, and
  how far they turn, depends on radius and depth alone: plane elements of order 3 and 2. A spring of 1000 MPa/mm holds
  each point to its place on the sphere, as far as friction carries it; the place moves on after every part of the
  path. Stored: (outward, around, inward), and which share of the contact slips. The check has three parts of four.
"""

import itertools
import json
import math
import sys
from pathlib import Path

import ngsolve as ng
import numpy as np
from netgen.meshing import MeshingParameters, NgException
from netgen.occ import Box, Circle, Cylinder, Glue, HalfSpace, MoveTo, OCCGeometry, Pnt, Sphere, Vec, X, Z

RADIUS, THICK = 47.5, 40.0
TOUCHED = ng.ds("touched", bonus_intorder=10)
SHEAR = 1.0 / 3.0
FINGER_MM, FINGER_PENALTIES = (8.0, 8.0, 2.0), (20.0, 60.0, 200.0, 1000.0)
SLAB_MM, STUCK_SPRING, STUCK_LINEAR_MM = 28.0, 500.0, (0.609112, 0.264518)
TWIST_SPRING, TWIST_FORCE, TWIST_REACH = 1000.0, 1.5, 1.7


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


def steepness(case, r):
    """The sine of a probe's slope at a distance r from its axis."""
    if case.get("kind", "sphere") == "sphere":
        most, sine = 0.98, 2.0 * r / case["diameter_mm"]
    elif case["kind"] == "cone":
        most = math.cos(math.radians(case["apex_deg"] / 2.0))
        sine = r / case["tip_mm"]
    else:
        over = r - (case["diameter_mm"] / 2.0 - case["edge_mm"])
        most, sine = 0.98**0.5, ng.IfPos(over, over / case["edge_mm"], 0.0)
    return ng.IfPos(sine - most, most, sine)


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


def linear_density(grad, p, shear=SHEAR):
    """Energy per volume of incompressible rubber (E = 1 MPa) by linear theory; ``p`` is the pressure."""
    strain = 0.5 * (grad + grad.trans)
    return shear * ng.InnerProduct(strain, strain) + p * ng.Trace(grad)


def neo_hookean_density(first, ratio, p, shear=SHEAR):
    """The same at finite strain, of the first invariant less 3 and the ratio of volumes."""
    return shear / 2.0 * (first + (ratio - 1.0) ** 2) + (p - shear) * (ratio - 1.0)


class Held:
    """What is kept at points of the touched surface: which are held, and where on the probe."""

    def __init__(self, mesh, order):
        self.where = mesh.Boundaries("touched")
        points = ng.comp.IntegrationRuleSpaceSurface(mesh, order=order, definedon=self.where)
        self.ds = ng.ds(definedon=self.where, intrules=points.GetIntegrationRules())
        *self.anchor, self.on, self.value = (ng.GridFunction(points) for _ in range(5))

    def at_points(self, term):
        self.value.Interpolate(term, definedon=self.where)
        return self.value.vec.FV().NumPy().copy()

    def remember(self, touches, places, slips=False):
        """Hold what touches at its places; what was held before stays where it was, unless it slips."""
        touches, *found = (self.at_points(term) for term in (touches, *places))
        on = self.on.vec.FV().NumPy()
        new = (touches > 0.5) & (slips | (on < 0.5))
        for anchor, place in zip(self.anchor, found, strict=False):
            anchor.vec.FV().NumPy()[new] = place[new]
        on[:] = touches > 0.5


def half_mesh(body, names, places, fine, near, at=0.0, **settings):
    """Return the mesh of half a body (y = 0 a plane of symmetry), elements as small as ``fine`` within ``near`` of
    the places (r, z) around x = ``at``; ``names`` are tests of faces' lowest and highest corners by name, the first
    that holds counts."""
    names = {"mirror": lambda low, high: max(abs(low.y), abs(high.y)) < 1e-3, **names, "side": lambda *_: True}
    for face in body.faces:
        face.name = next(name for name, holds in names.items() if holds(*face.bounding_box))
    wanted = MeshingParameters(grading=0.35, **settings)
    for r, z, depth in places:
        for angle in np.linspace(0.0, math.pi, 9):
            size = fine * max(1.0, math.hypot(r, z) / near)
            wanted.RestrictH(at + r * math.cos(angle), r * math.sin(angle), z + depth, size)
    return ng.Mesh(OCCGeometry(body).GenerateMesh(wanted))


def newton(form, state, tolerance=1e-9, inverse="umfpack"):
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
        step.data = form.mat.Inverse(state.space.FreeDofs(), inverse=inverse) * right
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
            self.held = Held(mesh, 8)
            form += ng.Variation(self.spring(u, d) * weight * penalty / 2.0 * self.held.ds)
        area = ng.Integrate(weight * TOUCHED, mesh)
        form += -weight * self.force / area * e * TOUCHED
        self.form = form

    def spring(self, moved, depth):
        """The square of how far points that touch are from where they came to, along the probe's surface; by linear
        theory along the body's."""
        away = self.own(moved, depth) - ng.CF(tuple(self.held.anchor[:2]))
        if self.linear:
            down, out = self.normal()[0], self.normal()[1]
            along = away[0] * out - away[1] * down
        else:
            sine = steepness(self.case, self.held.anchor[0])
            along = away[0] * ng.sqrt(1.0 - sine * sine) - away[1] * sine
        return self.held.on * ng.IfPos(self.inside(moved, depth), 1.0, 0.0) * along * along

    def own(self, moved, depth):
        """Where points are from the probe's lowest point; by linear theory how much farther than it they moved."""
        return ng.CF((moved[0], moved[1] - depth)) + (0.0 if self.linear else 1.0) * ng.CF((ng.x, ng.y))

    def remember(self):
        """Hold what has come to touch."""
        u, depth = self.state.components[0], float(self.state.components[2].vec[0])
        self.held.remember(ng.IfPos(self.inside(u, depth), 1.0, 0.0), self.own(u, depth))

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


def from_cylinder(case, own):
    """Return how far places of its own axes are outside a rounded cylinder, and its normal there."""
    edge, out = case["edge_mm"], ng.sqrt(own[0] * own[0] + own[1] * own[1] + 1e-20)
    over, below = out - (case["diameter_mm"] / 2.0 - edge), own[2] + edge
    far, deep = ng.IfPos(over, over, 0.0), ng.IfPos(below, below, 0.0)
    size, most = ng.sqrt(far * far + deep * deep + 1e-20), ng.IfPos(over - below, over, below)
    normal = ng.CF((far * own[0] / out, far * own[1] / out, deep)) / size
    return ng.IfPos(most, size, most) - edge, normal


class HalfPress:
    """A press on half a body, by linear theory or not; the probe's depth is an unknown."""

    def __init__(self, case, mesh, order, linear):
        self.case, self.mesh, self.linear, self.tilted = case, mesh, linear, "tilt_deg" in case
        moves = ng.VectorH1(mesh, order=order, dirichlet="held", dirichlety="held|mirror")
        space = moves * ng.H1(mesh, order=order - 1) * ng.NumberSpace(mesh)
        self.state, self.penalty, self.force = ng.GridFunction(space), ng.Parameter(0.0), ng.Parameter(case["force_n"])
        self.held, self.place = Held(mesh, 10), ng.CF((ng.x, ng.y, ng.z))
        (u, p, d), (v, _, e) = space.TnT()
        form, grad = ng.BilinearForm(space, symmetric=True), ng.Grad(u)
        if linear:
            density, inward = linear_density(grad, p), self.rest()
            gap = self.gap(u, d)
            form += self.penalty * ng.IfPos(-gap, -gap, 0.0) * (inward[2] * e - inward * v) * self.held.ds
        else:
            f, gap = ng.Id(3) + grad, self.gap(u, d)
            density = neo_hookean_density(ng.InnerProduct(f, f) - 3.0, ng.Det(f), p)
            inside = ng.IfPos(-gap, gap, 0.0)
            form += ng.Variation(self.penalty / 2.0 * inside * inside * self.held.ds)
        if case.get("sticks"):
            away = self.pulled(u, d)
            pulled = self.held.on * ng.IfPos(-gap, 1.0, 0.0) * away * away
            form += ng.Variation(self.penalty / 2.0 * pulled * self.held.ds)
        # A tiny compressibility, 1e-7, is added: the saddle point is then regular.
        form += ng.Variation((density - 0.5e-7 * p * p) * ng.dx(bonus_intorder=4))
        area = ng.Integrate(ng.CF(1.0) * ng.ds("touched"), mesh)
        form += -0.5 * self.force / area * e * ng.ds("touched")
        self.form = form

    def own(self, moved, depth):
        """Return places in the probe's axes from its middle or its face's; by linear theory, ways if it is tilted."""
        if not self.tilted:
            return self.place + moved - ng.CF((0.0, 0.0, depth - self.case["diameter_mm"] / 2.0))
        if self.linear:
            return ng.CF((moved[0], moved[1], 0.0))
        return self.in_cylinder(self.place + moved, depth)

    def in_cylinder(self, place, depth):
        """Return places in the axes of a cylinder tilted about y that touched at depth 0."""
        edge, angle = self.case["edge_mm"], math.radians(self.case["tilt_deg"])
        sine, cosine = math.sin(angle), math.cos(angle)
        low = abs(sine) * (self.case["diameter_mm"] / 2.0 - edge) + edge * (1.0 - cosine)
        x, y, z = place[0], place[1], place[2] - depth + low
        return ng.CF((cosine * x - sine * z, y, sine * x + cosine * z))

    def rest(self):
        """Return the normals into the rubber; where it is flat, find the gaps along them by Newton's steps."""
        if not self.tilted:
            core = ng.CF((ng.IfPos(ng.x, 0.0, ng.x), 0.0, FINGER_MM[0]))
            return (core - self.place) / ng.Norm(core - self.place)
        self.rest_gap, angle = ng.GridFunction(self.held.value.space), math.radians(self.case["tilt_deg"])
        far, normal = from_cylinder(self.case, self.in_cylinder(ng.CF((ng.x, ng.y, -self.rest_gap)), 0.0))
        steep = normal[2] * math.cos(angle) - normal[0] * math.sin(angle)
        for _ in range(60):
            gap = self.held.at_points(self.rest_gap + far / ng.IfPos(steep - 0.1, steep, 0.1))
            self.rest_gap.vec.FV().NumPy()[:] = np.minimum(gap, 5.0)
        return ng.CF((0.0, 0.0, 1.0))

    def gap(self, moved, depth):
        """Return how far the surface is from the probe."""
        if self.tilted:
            if self.linear:
                return self.rest_gap - depth + moved[2]
            return from_cylinder(self.case, self.own(moved, depth))[0]
        ball = self.case["diameter_mm"] / 2.0
        if not self.linear:
            own = self.own(moved, depth)
            return ng.sqrt(own * own) - ball
        inward, own = self.rest(), self.own(0.0 * moved, depth)
        ahead = own * inward
        root = ahead * ahead - own * own + ball**2
        return ng.IfPos(root - 1e-3, ahead - ng.sqrt(ng.IfPos(root - 1e-3, root, 1e-3)), 10.0) + moved * inward

    def pulled(self, moved, depth):
        """Return how far points are from their places on the probe, along its surface."""
        anchor = ng.CF(tuple(self.held.anchor))
        normal = ng.CF((0.0, 0.0, 1.0)) if self.linear else from_cylinder(self.case, anchor)[1]
        away = self.own(moved, depth) - anchor
        return away - (away * normal) * normal

    def found(self, penalties, parts=1):
        """Return displacements at the places, the depth, and if it sticks the force along x, with one penalty after
        the other; parts of a press that sticks hold what has come to touch."""
        moved, _, depth = self.state.components
        for part in range(1, parts + 1):
            self.force.Set(self.case["force_n"] * (part / parts) ** 2)
            for value in penalties if part == 1 else penalties[-1:]:
                self.penalty.Set(value)
                newton(self.form, self.state, 1e-8, "sparsecholesky")
            deep = float(depth.vec[0])
            if self.case.get("sticks"):
                touches, own = ng.IfPos(-self.gap(moved, deep), 1.0, 0.0), self.own(moved, deep)
                self.held.remember(touches, own)
        reached = np.array([moved(self.mesh(*place)) for place in self.case["places_mm"]]), deep
        return (*reached, self.side(moved, deep)) if self.case.get("sticks") else reached

    def side(self, moved, depth):
        """Return the force along x, N."""
        gap, away, angle = self.gap(moved, depth), self.pulled(moved, depth), math.radians(self.case["tilt_deg"])
        force = -self.held.on * ng.IfPos(-gap, 1.0, 0.0) * away
        if self.linear:
            across = force[0]
        else:
            force = force + ng.IfPos(-gap, -gap, 0.0) * from_cylinder(self.case, self.own(moved, depth))[1]
            across = math.cos(angle) * force[0] + math.sin(angle) * force[2]
        return 2.0 * float(ng.Integrate(self.penalty * across * self.held.ds, self.mesh))


def finger(_, fine):
    """The half y >= 0 of the finger, elements small under the apex."""
    radius, barrel, skirt = FINGER_MM
    centre = Pnt(0, 0, radius)
    tip = Sphere(centre, radius) * HalfSpace(Pnt(0, 0, 0), Vec(-1, 0, 0))
    top = Cylinder(Pnt(-barrel, 0, radius), X, radius, barrel) + tip
    top = top * Box(Pnt(-barrel, 0, -1), Pnt(radius + 1, radius + 1, radius))
    below = Box(Pnt(0, 0, radius), Pnt(radius + 1, radius + 1, radius + skirt))
    base = Cylinder(centre, Z, radius, skirt) * below + Box(Pnt(-barrel, 0, radius), Pnt(0, radius, radius + skirt))
    names = {
        "held": lambda low, high: min(low.z, high.z) > radius + skirt - 1e-3,
        "back": lambda low, high: max(low.x, high.x) < -barrel + 1e-3,
        "touched": lambda low, high: min(low.z, high.z) < 1e-3,
    }
    dense = [(r, z, 0.06 * r * r) for r in np.arange(0.0, 2.6, 0.4) for z in np.arange(0.0, 2.2, 0.4)]
    return half_mesh(top + base, names, dense, fine, 1.3, maxh=2.5).Curve(2)


def half_pair(case, order, mesh):
    """Return displacements and depth by linear theory, and at finite strain, which begins there."""
    straight, bent = (HalfPress(case, mesh, order, linear) for linear in (True, False))
    parts = 4 if case.get("sticks") else 1
    straight.state.components[2].vec[0] = bent.state.components[2].vec[0] = 0.3 if parts == 1 else 0.03
    found = straight.found(FINGER_PENALTIES[::3], parts)
    if parts == 1:
        bent.state.vec.data = straight.state.vec
        bent.state.components[2].vec[0] += 0.0 if bent.tilted else 0.06
    return found, bent.found(FINGER_PENALTIES, parts)


def tilted_block(case, fine):
    """The half y >= 0 of a block of 24 x 24 x 10 mm, elements small where a tilted cylinder touches."""
    names = {
        "held": lambda low, high: min(low.z, high.z) > 10.0 - 1e-3,
        "touched": lambda low, high: max(low.z, high.z) < 1e-3,
    }
    near, at = case["reach"], case["touch_mm"]
    wide = [(r, z, 0.0) for r in np.linspace(0.0, near, 6) for z in (0.0, 0.3, 0.8)]
    return half_mesh(Box(Pnt(-12, 0, 0), Pnt(12, 12, 10)), names, wide, fine, 99.0, at, maxh=3.0)


def once_more(stored, pair, make, check):
    """Solve every press of a file, and a check of it on a mesh that is so much coarser."""
    for row in stored["cases"]:
        case = {key: stored[key] for key in ("diameter_mm", "places_mm") if key in stored} | row
        (straight, bent), coarse = (pair(case, order, make(case, fine)) for order, fine in check)
        most = np.linalg.norm(straight[0], axis=1).max()
        other = coarse[1][0] - coarse[0][0] - (bent[0] - straight[0])
        what, unit = ("side", "n") if "tilt_deg" in case else ("contact", "mm")
        for name, (moved, depth, *more) in (("_linear", straight), ("", bent)):
            row["linear_mm" if name else "strained_mm"] = moved.round(7).tolist()
            row |= {f"indentation{name}_mm": depth} | {f"{what}{name}_{unit}": each for each in more}
        row["own_error"] = float(np.linalg.norm(other, axis=1).max() / most)
        print({key: value for key, value in row.items() if not isinstance(value, list)}, flush=True)


class Stuck:
    """The path of a sphere that sticks on one mesh, by linear theory or not."""

    def __init__(self, stored, mesh, linear):
        self.stored, self.mesh, self.linear = stored, mesh, linear
        moves = ng.VectorH1(mesh, order=2, dirichlet="held", dirichlety="held|mirror")
        self.space = moves * ng.H1(mesh, order=1)
        self.count, self.state, self.held = moves.ndof, ng.GridFunction(self.space), Held(mesh, 5)
        self.aside, self.deep, self.stiff = (ng.Parameter(x) for x in (0.0, 0.0, 1.0))
        (u, p), form = self.space.TrialFunction(), ng.BilinearForm(self.space, symmetric=True)
        grad = ng.Grad(u)
        if linear:
            density, self.normal = linear_density(grad, p), ng.CF((0.0, 0.0, 1.0))
        else:
            f, held = ng.Id(3) + grad, ng.CF(tuple(self.held.anchor))
            density = neo_hookean_density(ng.InnerProduct(f, f) - 3.0, ng.Det(f), p)
            self.normal = held / ng.sqrt(held * held + 1e-12)
        # The saddle point is factored without pivots: a tiny compressibility, 1e-7, is added.
        form += ng.Variation((density - 0.5e-7 * p * p) * ng.dx(bonus_intorder=3))
        gap, pulled = self.gap(u), self.pulled(u)
        square = ng.IfPos(-gap, gap * gap, 0.0) + self.held.on * ng.IfPos(-gap, pulled * pulled, 0.0)
        self.form = form
        self.form += ng.Variation(self.stiff * STUCK_SPRING / 2.0 * square * self.held.ds)

    def own(self, moved):
        """Places from the sphere's middle."""
        middle = ng.CF((self.aside, 0.0, self.deep - self.stored["diameter_mm"] / 2.0))
        return ng.CF((ng.x, ng.y, ng.z)) + moved - middle

    def gap(self, moved):
        if self.linear:
            return height(self.stored, ng.sqrt(ng.x * ng.x + ng.y * ng.y)) + moved[2] - self.deep
        own = self.own(moved)
        return ng.sqrt(own * own) - self.stored["diameter_mm"] / 2.0

    def pulled(self, moved):
        """How far points are from their places on the sphere, along its surface."""
        away = self.own(moved) - ng.CF(tuple(self.held.anchor))
        return away - (away * self.normal) * self.normal

    def settle(self, tolerance):
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

    def reached(self):
        """Return the force along x and z, N, and the displacements, mm."""
        moved = self.state.components[0]
        gap, own = self.gap(moved), self.own(moved)
        normal = self.normal if self.linear else own / ng.sqrt(own * own)
        force = ng.IfPos(-gap, -gap, 0.0) * normal - self.held.on * ng.IfPos(-gap, 1, 0) * self.pulled(moved)
        total = [2.0 * STUCK_SPRING * ng.Integrate(force[k] * self.held.ds, self.mesh) for k in (0, 2)]
        return total, np.array([[*moved(self.mesh(*place))] for place in self.stored["places_mm"]])

    def take(self, deep, aside, parts):
        """Return what is reached by pressing, and by moving along x from there."""
        found = []
        for part in range(1, sum(parts) + 1):
            pressing = part <= parts[0]
            self.deep.Set(deep * (min(part, parts[0]) / parts[0]) ** 2)
            self.aside.Set(aside * max(part - parts[0], 0) / parts[1])
            softer = ((0.05, 1e-2), (0.25, 3e-3)) if pressing else ()
            for stiff, tolerance in (*softer, (1.0, 3e-6)):
                self.stiff.Set(stiff)
                self.settle(tolerance)
            moved = self.state.components[0]
            self.held.remember(ng.IfPos(-self.gap(moved), 1.0, 0.0), self.own(moved))
            found.append(self.reached())
            print("pressed" if pressing else "moved", part, found[-1][0], flush=True)
        return found[parts[0] - 1], found[-1]


def half_slab(fine):
    """The half y >= 0 of a round slab, elements small under the sphere."""
    wide = SLAB_MM + 1
    body = Cylinder(Pnt(0, 0, 0), Z, SLAB_MM, THICK) * Box(Pnt(-wide, 0, 0), Pnt(wide, wide, THICK))
    names = {"touched": lambda low, high: high.z < 1e-3, "held": lambda low, high: low.z > THICK - 1e-3}
    dense = [(r, z, 0.0) for r in np.arange(0.0, 2.9, 0.4) for z in np.arange(0.0, 2.4, 0.4)]
    return half_mesh(body, names, dense, fine, 1.8, maxh=9.0)


def stuck(stored):
    """Solve the steps at finite strain, and by linear theory under the same forces."""
    mesh = half_slab(0.5)
    bent = Stuck(stored, mesh, linear=False).take(*stored["motion_mm"], (8, 4))
    straight = Stuck(stored, mesh, linear=True).take(*STUCK_LINEAR_MM, (4, 1))
    press, side = bent[0][0][1] / straight[0][0][1], bent[1][0][0] / straight[1][0][0]
    assert abs(press - 1.0) < 0.03, press
    assert abs(side - 1.0) < 0.05, side
    pressed, added = press * straight[0][1], side * (straight[1][1] - straight[0][1])
    linear = [pressed, bent[1][0][1] / bent[0][0][1] * pressed + added]
    stored["motion_linear_mm"] = STUCK_LINEAR_MM[0] * press ** (2.0 / 3.0), STUCK_LINEAR_MM[1] * side
    stored["steps"] = [
        {"force_n": force, "linear_mm": straight.round(7).tolist(), "strained_mm": strained.round(7).tolist()}
        for (force, strained), straight in zip(bent, linear, strict=True)
    ]


class Twisted:
    """The path of a sphere that is pressed and turned on one mesh, by linear theory or not."""

    def __init__(self, stored, mesh, linear):
        self.stored, self.mesh, self.linear, self.held = stored, mesh, linear, Held(mesh, 8)
        moves = ng.VectorH1(mesh, order=3, dirichletx="held|axis", dirichlety="held")
        space = moves * ng.H1(mesh, order=3, dirichlet="held") * ng.H1(mesh, order=2) * ng.NumberSpace(mesh)
        self.state = ng.GridFunction(space)
        self.state.components[3].vec[0] = 0.1
        self.turned, self.friction, self.push = (ng.Parameter(x) for x in (0.0, stored["friction"], 0.0))
        (u, t, p, d), (v, s, _, e) = space.TnT()
        weight, r = 2.0 * math.pi * ng.x, ng.x
        grad, slope, hoop = ng.Grad(u), ng.Grad(t), u[0] / ng.x
        form = ng.BilinearForm(space)
        if linear:
            energy = linear_density(grad, p) + SHEAR * (hoop * hoop + 0.5 * r * r * (slope * slope)) + p * hoop
        else:
            f = ng.Id(2) + grad
            ratio = ng.Det(f) * (1.0 + hoop)
            first = ng.InnerProduct(f, f) + (1.0 + hoop) ** 2 + (r + u[0]) ** 2 * (slope * slope) - 3.0
            energy = neo_hookean_density(first, ratio, p)
        form += ng.Variation(weight * energy * ng.dx(bonus_intorder=4))
        found = self.contact(u, t, d)
        pull, around = found["pull"], found["around"]
        form += weight * (pull[1] * e - pull * v - around * self.radius(u) * s) * self.held.ds
        form += -weight * self.push / (math.pi * RADIUS**2) * e * ng.ds("touched")
        self.form = form

    def radius(self, u):
        """How far points are from the axis."""
        return ng.x if self.linear else ng.x + u[0]

    def contact(self, u, t, d):
        """What acts on the rubber per area, how far friction carries, and the places on the sphere to remember."""
        ball, (outward, inward, turn) = self.stored["diameter_mm"] / 2.0, self.held.anchor
        if self.linear:
            gap, normal, own = height(self.stored, ng.x) + u[1] - d, ng.CF((0.0, 1.0)), u
        else:
            own = ng.CF((ng.x + u[0], ng.y + u[1] - d + ball))
            size = ng.sqrt(own * own)
            gap, normal = size - ball, own / size
        angle, along = t - self.turned, ng.CF((normal[1], -normal[0]))
        away = (own - ng.CF((outward, inward))) * along
        around = self.radius(u) * (angle - turn)
        far = ng.sqrt(away * away + around * around + 1e-18)
        pressure = 4000.0 * ng.IfPos(-gap, -gap, 0.0)
        most = self.friction * pressure / TWIST_SPRING
        share = self.held.on * ng.IfPos(far - most, most / far, 1.0)
        touches = ng.IfPos(-gap, 1.0, 0.0)
        back = own - share * away * along
        return {
            "pull": pressure * normal - TWIST_SPRING * share * away * along,
            "around": -TWIST_SPRING * share * around,
            "touches": touches,
            "slips": self.held.on * touches * ng.IfPos(1.0 - 1e-7 - share, 1.0, 0.0),
            "kept": (back[0], back[1], angle - share * around / (self.radius(u) + 1e-9)),
        }

    def reached(self):
        """Return what is stored of a step; hold what touches where it is, where it slips as far as friction carries."""
        u, t, _, depth = self.state.components
        d = float(depth.vec[0])
        found = self.contact(u, t, d)

        def total(value):
            return float(ng.Integrate(2.0 * math.pi * ng.x * value * self.held.ds, self.mesh))

        moved = []
        for r, z in self.stored["places_mm"]:
            here = self.mesh(max(r, 1e-6), z)
            (out, down), turn = u(here), t(here)
            far = r if self.linear else r + out
            ahead = (out, far * turn) if self.linear else (far * math.cos(turn) - r, far * math.sin(turn))
            moved.append([*ahead, down])
        row = {
            "force_n": total(found["pull"][1]),
            "torque_nmm": total(found["around"] * self.radius(u)),
            "indentation_mm": d,
            "slipping": total(found["slips"]) / total(found["touches"]),
            "moved_mm": np.round(moved, 7).tolist(),
        }
        self.held.remember(found["touches"], found["kept"], slips=True)
        return row

    def take(self, parts):
        """Return what is stored of the press and of every turn."""
        for part in range(1, parts[0] + 1):
            self.push.Set(TWIST_FORCE * (part / parts[0]) ** 1.5)
            newton(self.form, self.state)
            found = [self.reached()]
        for past, turn in itertools.pairwise(np.radians(self.stored["turns_deg"])):
            for part in range(1, parts[1] + 1):
                self.turned.Set(past + (turn - past) * part / parts[1])
                # All sticks at first; then friction carries less and less.
                for more in (1e4, 8.0, 3.0, 1.5, 1.0):
                    self.friction.Set(self.stored["friction"] * more)
                    newton(self.form, self.state, 1e-9 if more == 1.0 else 1e-5)
                reached = self.reached()
            found.append(reached)
        return found


def twisted_slab(fine):
    """The half section (r, depth), elements small under the sphere."""
    near = box(3.0 * TWIST_REACH, 3.0 * TWIST_REACH, 0.4 * TWIST_REACH * fine)
    inner = box(1.1 * TWIST_REACH, 0.35 * TWIST_REACH, 0.05 * TWIST_REACH * fine)
    return meshed([box(RADIUS, THICK, 6.0) - near, near - inner, inner], THICK)


def twisted(stored):
    """Solve the path by linear theory and at finite strain, and this on a coarser mesh."""
    for name, linear in (("linear", True), ("strained", False)):
        stored[name] = Twisted(stored, twisted_slab(1.0), linear).take((8, 4))
    coarse = Twisted(stored, twisted_slab(1.5), False).take((6, 3))
    stored["own_error"] = []
    for fine, other in zip(stored["strained"], coarse, strict=True):
        here, there = np.array(fine["moved_mm"]), np.array(other["moved_mm"])
        off = np.linalg.norm(here - there, axis=1).max() / np.linalg.norm(here, axis=1).max()
        stored["own_error"].append(float(off))


MAKERS = {
    "slab": ("neohooke", lambda stored: once_more(stored, pair, slab, ((3, 1.0), (4, 1.4)))),
    "dome": ("dome_neohooke", lambda stored: once_more(stored, pair, dome, ((3, 1.0), (3, 1.6)))),
    "finger": ("finger_neohooke", lambda stored: once_more(stored, half_pair, finger, ((2, 0.1), (2, 0.14)))),
    "tilted": ("tilted_neohooke", lambda stored: once_more(stored, half_pair, tilted_block, ((2, 0.31), (2, 0.4)))),
    "stuck": ("stuck_neohooke", stuck),
    "twisted": ("twisted_neohooke", twisted),
}


if __name__ == "__main__":
    ng.SetNumThreads(1)
    name, make = MAKERS[sys.argv[1]]
    file = Path(__file__).with_name(f"{name}.json")
    stored = json.loads(file.read_text())
    make(stored)
    file.write_text(json.dumps(stored) + "\n")
