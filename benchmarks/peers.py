"""The same loads in other programs: error against time from the ready mesh, beside twin's own rows of the same run.

Two loads of 1 N on each body, along z and along x. Seconds are from the ready mesh to displacements at the reference's
points; the next load has its own solve and evaluation only. One core, but for the rows that say otherwise. The median
of three runs by CPU time; runs of more than two seconds are not repeated. A program that is absent gets a row that says
so.

A general program has no half-space to subtract, so its mesh must resolve the load: Netgen's, graded to the load's edge
and to the clamped rim, the same for every program. Each program is used as its users would:

* NGSolve: curved elements, static condensation, its own sparse Cholesky (on these systems MKL's Pardiso took twice as
  long, UMFPACK a third more);
* CalculiX (the command ``ccx``): quadratic tetrahedra C3D10, its default direct solver, one deck a load; writing the
  deck is left out of the time. It has no element with pressure unknowns, so Poisson's ratio stays below 1/2.

At Poisson's ratio 1/2 a millionth is taken off the pressure block: without it NGSolve's factorisation has returned
garbage.
"""

import gc
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.clock import Clock, Cost, empty_cache
from benchmarks.elasticity import compliance, warm_up
from benchmarks.reference import BODIES, YOUNGS_MODULUS_MPA, reference
from twin.arrays import Floats, Points
from twin.world.mesh.elements import quadrature, shapes, signed_volumes
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.quadratic_mesh import Mesh
from twin.world.mesh.sizing import WORLD, Level
from twin.world.mesh.snap import snapped_mesh

BUMP_MM, PATCH_MM = 2.0, 4.0
"""Radius of the finger's load and side of the block's, mm, both at the origin."""


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Wanted edge lengths, mm: at the load's edge, on the load, at the clamped rim, anywhere; and Netgen's grading.

    ``halved`` is how many times every edge is halved afterwards.
    """

    ring: float
    load: float
    rim: float
    far: float
    grading: float
    halved: int = 0


def netgen_mesh(body: str, edges: Edges) -> Any:
    """Return NGSolve's mesh of ``block`` or ``finger``, its boundary named load, free and held; not curved yet."""
    import ngsolve as ng
    from netgen.meshing import MeshingParameters
    from netgen.occ import OCCGeometry

    wanted = MeshingParameters(maxh=edges.far, grading=edges.grading)
    shape = _block(edges) if body == "block" else _finger(edges, wanted)
    mesh = ng.Mesh(OCCGeometry(shape).GenerateMesh(wanted))
    for _ in range(edges.halved):
        mesh.Refine()
    return mesh


def _block(edges: Edges) -> Any:
    from netgen.occ import Axes, Box, Glue, Pnt, WorkPlane, X, Z

    block, half = BODIES["block"], PATCH_MM / 2
    (x0, y0, z0), (x1, y1, z1) = block.bounds_mm
    patch = WorkPlane(Axes((-half, -half, 0), n=Z, h=X)).Rectangle(PATCH_MM, PATCH_MM).Face()
    patch.faces.name, patch.faces.maxh, patch.edges.maxh = "load", edges.load, edges.ring
    glued = Glue([Box(Pnt(x0, y0, z0), Pnt(x1, y1, z1)), patch])
    for face in glued.faces:
        if face.name != "load":
            face.name = "held" if abs(face.center.z - z1) < 1e-6 else "free"
        if face.name == "held":
            face.edges.maxh = edges.rim
    return glued


def _finger(edges: Edges, wanted: Any) -> Any:
    from netgen.occ import Box, Cylinder, HalfSpace, Pnt, Sphere, Vec, X, Z

    finger = BODIES["finger"]
    (x0, _, _), (_, _, base) = finger.bounds_mm
    radius = base - 2.0
    centre = Pnt(0, 0, radius)
    dome = (Sphere(centre, radius) + Cylinder(Pnt(x0, 0, radius), X, r=radius, h=-x0)) * HalfSpace(centre, Vec(0, 0, 1))
    foot = Cylinder(centre, Z, r=radius, h=base - radius) + Box(Pnt(x0, -radius, radius), Pnt(0, radius, base))
    shape = (dome + foot) * HalfSpace(Pnt(x0, 0, 0), Vec(-1, 0, 0))
    for face in shape.faces:
        middle = face.center
        held, back = abs(middle.z - base) < 1e-6, abs(middle.x - x0) < 1e-6
        face.name = "held" if held else ("free" if back else "load")
        if held:
            face.edges.maxh = edges.rim
    for share in (0.0, 0.35, 0.7, 1.0):
        for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False):
            x, y = share * BUMP_MM * np.cos(angle), share * BUMP_MM * np.sin(angle)
            z = radius - np.sqrt(radius**2 - y**2 - max(x, 0.0) ** 2)
            wanted.RestrictH(x=x, y=y, z=z, h=edges.ring if share == 1.0 else edges.load)
    return shape


def curved(netgen: Any, body: str) -> Mesh:
    """Return the same tetrahedra with mid-side nodes on the true surface."""
    points = np.array([vertex.point for vertex in netgen.vertices])
    tets = np.array([[node.nr for node in element.vertices] for element in netgen.Elements()])
    turned = signed_volumes(points, tets) < 0
    tets[np.ix_(turned, [2, 3])] = tets[np.ix_(turned, [3, 2])]
    shape = BODIES[body]
    return snapped_mesh(shape, points, tets)


KEYS = {"block": ("R1z", "R1x"), "finger": ("apex_z", "apex_x")}
"""The two loads of a body: 1 N along z and along x, on a square of 4 mm (block) or as a bump 4 mm wide (finger)."""

KNOWN = (0.5, 0.49)
"""Poisson's ratios that the references have."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Two loads on one body, of one Poisson's ratio."""

    body: str
    nu: float
    axes: tuple[int, int] = (2, 0)
    youngs_modulus_mpa: float = YOUNGS_MODULUS_MPA

    @property
    def points(self) -> Points:
        """(n, 3) where displacements are wanted, mm."""
        return reference(self.body).points

    def right(self, load: int) -> Points:
        """Return (n, 3) the converged displacements, mm.

        Between the two ratios of the reference they are interpolated; the field is so smooth in nu that .4999 is then
        known to 1e-5.
        """
        fields = [reference(self.body).case(f"{KEYS[self.body][load]}_nu{nu:g}").right for nu in KNOWN]
        share = (KNOWN[0] - self.nu) / (KNOWN[0] - KNOWN[1])
        return np.asarray((1 - share) * fields[0] + share * fields[1])


@dataclass(frozen=True)
class Answers:
    """Unknowns, the costs from the ready mesh of the first and the next load, and (n, 3) displacements of both, mm."""

    unknowns: int
    costs: list[Cost]
    moved: list[Points]


def traction(body: str, places: Points) -> Floats:
    """Return the (q,) traction at surface places (q, 3) along the load, up to a factor."""
    if body == "block":
        return np.asarray((np.abs(places) <= PATCH_MM / 2 * np.array([1, 1, 0]) + 1e-9).all(axis=1), float)
    return np.asarray(np.maximum(0.0, 1.0 - np.sum((places / BUMP_MM) ** 2, axis=1)) ** 2)


def nodal_shares(body: str, mesh: Mesh) -> Floats:
    """Return the (N,) forces on the nodes of quadratic elements that a total of 1 N makes, N."""
    faces = mesh.faces[mesh.piece == 0]
    at, weights = quadrature(2)
    shape, slope = shapes(at)
    nodes = mesh.points[faces]
    places, one, two = (np.einsum("qa,fai->fqi", table, nodes) for table in (shape, slope[:, :, 0], slope[:, :, 1]))
    area = np.linalg.norm(np.cross(one, two), axis=2) * weights
    strength = traction(body, places.reshape(-1, 3)).reshape(area.shape) * area
    out = np.bincount(faces.ravel(), (strength @ shape).ravel(), len(mesh.points))
    return np.asarray(out / out.sum())


LIMIT_S = 300.0


def has_calculix() -> bool:
    """Tell whether CalculiX is installed."""
    return shutil.which("ccx") is not None


def calculix_answers(mesh: Mesh, problem: Problem) -> Answers:
    """Solve both loads of a problem, each a run of its own; the clock runs from the written deck."""
    shares = nodal_shares(problem.body, mesh)
    held = np.flatnonzero(mesh.nodes_on([mesh.piece.max()]))
    moved, costs = [], []
    with tempfile.TemporaryDirectory(prefix="ccx-") as folder:
        for axis in problem.axes:
            name = Path(folder) / f"load{axis}"
            name.with_suffix(".inp").write_text(_deck(mesh, problem, shares, axis, held))
            clock = Clock()
            subprocess.run(
                ["ccx", name.name], cwd=folder, check=True, capture_output=True, timeout=LIMIT_S,
                env={**os.environ, "OMP_NUM_THREADS": "1", "CCX_NPROC_STIFFNESS": "1"},
            )  # fmt: skip
            lines = name.with_suffix(".dat").read_text().splitlines()
            rows = np.array([line.split() for line in lines if len(line.split()) == 4], float)
            nodal = np.zeros((len(mesh.points), 3))
            nodal[rows[:, 0].astype(int) - 1] = rows[:, 1:]
            moved.append(Locator(mesh).locate(problem.points).values(nodal))
            costs.append(clock.lap())
    return Answers(3 * (len(mesh.points) - len(held)), costs, moved)


def _deck(mesh: Mesh, problem: Problem, shares: Floats, axis: int, held: np.ndarray) -> str:
    lines = ["*NODE, NSET=all"]
    lines += [f"{n + 1}, {x:.12g}, {y:.12g}, {z:.12g}" for n, (x, y, z) in enumerate(mesh.points)]
    lines += ["*ELEMENT, TYPE=C3D10, ELSET=body"]
    lines += [", ".join(str(n) for n in (e + 1, *(tet + 1))) for e, tet in enumerate(mesh.tets)]
    lines += ["*NSET, NSET=held", *(f"{n + 1}," for n in held)]
    lines += ["*BOUNDARY", "held, 1, 3", "*MATERIAL, NAME=rubber", "*ELASTIC"]
    lines += [f"{problem.youngs_modulus_mpa}, {problem.nu}", "*SOLID SECTION, ELSET=body, MATERIAL=rubber"]
    lines += ["*STEP", "*STATIC", "*CLOAD"]
    lines += [f"{n + 1}, {axis + 1}, {shares[n]:.12e}" for n in np.flatnonzero(shares)]
    lines += ["*NODE PRINT, NSET=all", "U", "*END STEP", ""]
    return "\n".join(lines)


OFF_PRESSURE = 1e-6


def ngsolve_answers(mesh: Any, problem: Problem, *, order: int, mixed: bool, cores: int = 1) -> Answers:
    """Solve both loads of a problem on a mesh curved to ``order``; the clock runs from the ready mesh."""
    import ngsolve as ng

    moved, costs = [], []
    ng.SetNumThreads(cores)
    with nullcontext() if cores == 1 else ng.TaskManager():
        clock = Clock()
        form = _form(ng, mesh, problem, order, mixed)
        form.Assemble()
        free = form.space.FreeDofs(form.condense)
        inverse = form.mat.Inverse(free, inverse="sparsecholesky")
        for axis in problem.axes:
            moved.append(_solved(ng, problem, axis, form, inverse, mixed))
            costs.append(clock.lap())
    return Answers(sum(free), costs, moved)


def _form(ng: Any, mesh: Any, problem: Problem, order: int, mixed: bool) -> Any:
    shear = problem.youngs_modulus_mpa / (2 * (1 + problem.nu))
    moves = ng.VectorH1(mesh, order=order, dirichlet="held")
    if mixed:
        space = moves * ng.H1(mesh, order=order - 1)
        (u, p), (v, q) = space.TnT()
    else:
        space = moves
        u, v = space.TnT()
    strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    energy = 2 * shear * ng.InnerProduct(strain, virtual)
    if mixed:
        softness = 3 * (1 - 2 * problem.nu) / problem.youngs_modulus_mpa + OFF_PRESSURE / shear
        energy += -2 / 3 * shear * ng.div(u) * ng.div(v) + p * ng.div(v) + q * ng.div(u) - softness * p * q
    else:
        energy += 2 * shear * problem.nu / (1 - 2 * problem.nu) * ng.div(u) * ng.div(v)
    form = ng.BilinearForm(space, symmetric=True, condense=order >= 4)
    form += energy * ng.dx
    return form


def _solved(ng: Any, problem: Problem, axis: int, form: Any, inverse: Any, mixed: bool) -> Points:
    space, mesh = form.space, form.space.mesh
    test = space.TestFunction()
    pushed = (test[0] if mixed else test)[axis]
    surface = ng.ds("load", bonus_intorder=0 if problem.body == "block" else 8)
    if problem.body == "block":
        traction, total = 1.0 / PATCH_MM**2, 1.0
    else:
        squared = (ng.x**2 + ng.y**2 + ng.z**2) / BUMP_MM**2
        traction = ng.IfPos(1 - squared, (1 - squared) ** 2, 0)
        total = ng.Integrate(traction * surface, mesh)
    right = ng.LinearForm(space)
    right += traction / total * pushed * surface
    right.Assemble()
    answer = ng.GridFunction(space)
    if form.condense:
        right.vec.data += form.harmonic_extension_trans * right.vec
        answer.vec.data = inverse * right.vec
        answer.vec.data += form.harmonic_extension * answer.vec
        answer.vec.data += form.inner_solve * right.vec
    else:
        answer.vec.data = inverse * right.vec
    moved = answer.components[0] if mixed else answer
    x, y, z = problem.points.T
    return np.asarray(moved(mesh(x, y, z)))


REPEATS, LONG_S = 3, 2.0

MESHES: dict[str, dict[str, Edges]] = {
    "block": {
        "a": Edges(ring=1.3, load=1.3, rim=25, far=25, grading=0.5),
        "b": Edges(ring=0.7, load=2, rim=20, far=20, grading=0.5),
        "c": Edges(ring=0.5, load=1, rim=6, far=20, grading=0.6),
        "d": Edges(ring=1, load=1.3, rim=8, far=20, grading=0.7),
        "e": Edges(ring=0.5, load=1, rim=4, far=20, grading=0.5),
        "f": Edges(ring=0.35, load=0.7, rim=4, far=15, grading=0.4),
        "g": Edges(ring=0.35, load=0.7, rim=4, far=15, grading=0.4, halved=1),
    },
    "finger": {
        "a": Edges(ring=1.2, load=1.2, rim=3, far=5, grading=0.5),
        "b": Edges(ring=0.8, load=1, rim=2, far=4, grading=0.4),
        "c": Edges(ring=0.8, load=1, rim=1, far=4, grading=0.5),
        "d": Edges(ring=0.8, load=1, rim=1.5, far=3, grading=0.4),
        "e": Edges(ring=0.5, load=0.7, rim=1, far=2.5, grading=0.4),
        "f": Edges(ring=0.35, load=0.5, rim=0.7, far=2, grading=0.4),
        "g": Edges(ring=0.35, load=0.5, rim=0.7, far=2, grading=0.4, halved=1),
    },
}
"""Coarse to fine; found by trying some twenty, and kept where an element has its best error for its time. ``g`` is for
linear elements alone."""


@dataclass(frozen=True, kw_only=True)
class Way:
    """A program's element at one Poisson's ratio on some of the meshes; ``quadratic`` if it wants them as `Mesh`."""

    program: str
    element: str
    nu: float
    meshes: str
    solve: Callable[[Any, Problem], Answers]
    order: int = 0


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a program, element and mesh; the quick form takes the coarsest meshes and repeats nothing."""
    rows = []
    for body in BODIES:
        rows += twin_rows(body, quick)
        rows += list(peer_rows(body, quick))
    return rows


def ways() -> list[Way]:
    """Return what is tried of every program that is installed."""
    found = []
    if find_spec("ngsolve"):
        for order, meshes in ((2, "abef"), (3, "abcde"), (4, "abcde")):
            name, solve = f"Taylor-Hood {order}/{order - 1}", partial(ngsolve_answers, order=order, mixed=True)
            found.append(Way(program="NGSolve", element=name, nu=0.5, meshes=meshes, solve=solve, order=order))
            if (cores := os.cpu_count() or 1) > 1 and order > 2:
                name_all, all_cores = f"NGSolve, {cores} cores", partial(solve, cores=cores)
                found.append(Way(program=name_all, element=name, nu=0.5, meshes=meshes, solve=all_cores, order=order))
        for order, meshes in ((1, "aefg"), (2, "aef"), (3, "abcde"), (4, "abcde")):
            name, solve = f"P{order}", partial(ngsolve_answers, order=order, mixed=False)
            for nu in (0.49, 0.4999) if order < 3 else (0.49,):
                found.append(Way(program="NGSolve", element=name, nu=nu, meshes=meshes, solve=solve, order=order))
    if has_calculix():
        found.append(Way(program="CalculiX", element="P2 (C3D10)", nu=0.49, meshes="aef", solve=calculix_answers))
    return found


def peer_rows(body: str, quick: bool) -> Iterator[dict[str, Any]]:
    """Yield a row for every way and mesh, and for every program that is absent."""
    if not find_spec("ngsolve"):  # the meshes of all peers are made by its mesher
        yield {"body": body, "program": "other programs", "remark": "not run: NGSolve, whose mesher is used, is absent"}
        return
    if not has_calculix():
        yield {"body": body, "program": "CalculiX", "remark": "not installed"}
    todo = ways()
    for name, edges in MESHES[body].items():
        if quick and name != "a":
            continue
        here = [way for way in todo if name in way.meshes]
        mesh = netgen_mesh(body, edges)
        nodes = None if all(way.order for way in here) else curved(mesh, body)
        for way in here:
            problem = Problem(body=body, nu=way.nu)
            mesh.Curve(max(way.order, 1))
            start = {
                "body": body, "nu": f"{way.nu:g}", "program": way.program, "element": way.element,
                "mesh": f"{name}, {mesh.ne} tetrahedra",
            }  # fmt: skip
            try:
                yield start | measured(problem, partial(way.solve, mesh if way.order else nodes, problem), quick)
            except (subprocess.SubprocessError, MemoryError) as trouble:
                yield start | {"remark": f"failed: {trouble}"}
            gc.collect()


def twin_rows(body: str, quick: bool) -> Iterator[dict[str, Any]]:
    """Yield twin's own rows: every level of mesh, and the block's table."""
    ways: list[tuple[str, Level, bool]] = [("twin", level, False) for level in (WORLD[:2] if quick else WORLD)]
    if body == "block":
        ways.append(("twin, table", "standard", True))
    for program, level, table in ways:
        warm_up(body, "subtracted", table)
        for nu in (0.5, 0.49):
            problem = Problem(body=body, nu=nu)
            start = {
                "body": body, "nu": f"{nu:g}", "program": program,
                "element": "table" if table else "half-space + Taylor-Hood 2/1", "mesh": "" if table else level,
            }  # fmt: skip
            yield start | measured(problem, partial(_twin_answers, problem, level, table), quick)
            gc.collect()


def _twin_answers(problem: Problem, level: Level, table: bool) -> Answers:
    moved, costs = [], []
    with empty_cache():
        stiff = compliance(problem.body, problem.nu, "subtracted", level, table)
        clock = Clock()
        for key in KEYS[problem.body]:
            case = reference(problem.body).case(f"{key}_nu{problem.nu:g}")
            moved.append(stiff.displacement(problem.points, case.load(BODIES[problem.body])))
            costs.append(clock.lap())
        return Answers(0 if table else stiff.mesh.unknowns, costs, moved)


def measured(problem: Problem, solve: Callable[[], Answers], quick: bool) -> dict[str, Any]:
    """Return unknowns, costs of the median run, and errors under both loads."""
    runs = [solve()]
    while len(runs) < (1 if quick or runs[0].costs[0].cpu > LONG_S else REPEATS):
        runs.append(solve())
    middle = sorted(runs, key=lambda each: each.costs[0].cpu)[len(runs) // 2]
    errors = [reference(problem.body).errors(moved, problem.right(n))[0] for n, moved in enumerate(middle.moved)]
    next_cpu_s = sorted(each.costs[1].cpu for each in runs)[len(runs) // 2]
    print(".", end="", flush=True, file=sys.stderr)
    row = {"unknowns": middle.unknowns, "cpu_s": middle.costs[0].cpu, "wall_s": middle.costs[0].wall}
    return row | {"next_cpu_s": next_cpu_s, "error_z": errors[0], "error_x": errors[1]}
