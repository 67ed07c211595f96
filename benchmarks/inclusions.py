"""What hard beads change: ``python -m benchmarks inclusions`` stores the rows and writes the tables of the page.

Two answers to one question. An independent finite-element program (NGSolve, of the ``peers`` extra) resolves the beads
next to the load in the whole block; closed forms (`twin.theory.inclusions`) take the same beads, and then all 636 of
them, which no mesh of reasonable size could resolve. With beads and without them the mesh is the same, so that its own
error cancels in the change. The load is even over the disc below the 5 mm pillar; two mirror planes leave a quarter.
Further rows say where the option of stiff markers (`twin.world.elasticity.rigid_beads`) ends, and what it costs.

The elements are Taylor-Hood, with curved bead surfaces; a bead is rubber that is stiffer by `RIGID`. E = 1 MPa there:
displacements scale with 1/E.
"""

import resource
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.bead_motion import BeadMotion, bead_motion
from benchmarks.clock import Clock, repeated
from twin.arrays import Floats, Points
from twin.parts.load import Rectangles, Traction
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Found
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.world.elasticity.compliance import Compliance

QUARTER_MM = (50.0, 45.0, 40.0)
RIGID = 1e5
"""Shear modulus of a resolved bead over the rubber's."""

SOFT = 1e-7
"""What is taken off the pressure's block, over a shear modulus: the factorisation pivots on its diagonal."""


@dataclass(frozen=True, kw_only=True)
class BeadSolutions:
    """Displacement in mm of resolved beads (n, 3) and of the passive points at their centres, for 1 N and 1 MPa."""

    centres: Points
    beads: Points
    passive: Points
    elements: int
    unknowns: int


def bead_solutions(
    centres: Points,
    radius_mm: float,
    disc_mm: float,
    reach_mm: float,
    order: int,
    fineness: float,
    poisson_ratio: float = 0.5,
) -> BeadSolutions:
    """Solve a quarter of the block with and without the beads (n, 3), mm, at 0 <= x, y < ``reach_mm``.

    ``disc_mm`` is the radius of the pushed disc; ``order`` is the displacement's, the pressure has one less. A
    ``fineness`` of 1 gives 4 % of missing volume in a bead, 2 gives .2 %.
    """
    import ngsolve as ng

    ng.SetNumThreads(1)
    centres = np.array([c for c in centres if -1e-9 <= c[0] < reach_mm and -1e-9 <= c[1] < reach_mm])
    mesh = _mesh(centres, radius_mm, disc_mm, reach_mm, fineness)
    mesh.Curve(order)
    held = {"dirichletx": "mirror_x|held", "dirichlety": "mirror_y|held", "dirichletz": "held"}
    both = ng.VectorH1(mesh, order=order, **held) * ng.H1(mesh, order=order - 1)
    (u, p), (v, q) = both.TnT()
    load = ng.LinearForm(both)
    load += v[2] / (np.pi * disc_mm**2) * ng.ds("load")
    load.Assemble()
    inside = centres + 1e-9 * (centres < 1e-9)
    moved = []
    for stiffer in (1.0, RIGID):
        shear = mesh.MaterialCF({"bead.*": stiffer}, default=1.0) / (2 * (1 + poisson_ratio))
        give = (1 - 2 * poisson_ratio) / (2 * poisson_ratio * shear)
        form = ng.BilinearForm(both, symmetric=True)
        strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
        energy = 2 * shear * ng.InnerProduct(strain, virtual) - p * ng.div(v) - q * ng.div(u) - give * p * q
        form += (energy - SOFT / shear * p * q) * ng.dx
        form.Assemble()
        found = ng.GridFunction(both)
        found.vec.data = form.mat.Inverse(both.FreeDofs(), inverse="sparsecholesky") * load.vec
        moved.append(np.array([found.components[0](mesh(*point)) for point in inside]))
    unknowns = sum(both.FreeDofs())
    return BeadSolutions(centres=centres, passive=moved[0], beads=moved[1], elements=mesh.ne, unknowns=unknowns)


def _mesh(centres: Points, radius_mm: float, disc_mm: float, reach_mm: float, fineness: float) -> Any:
    import ngsolve as ng
    from netgen.occ import Axes, Box, Glue, HalfSpace, OCCGeometry, Pnt, Sphere, Vec, WorkPlane, X, Y, Z

    block = Box(Pnt(0, 0, 0), Pnt(*QUARTER_MM))
    near = Box(Pnt(0, 0, 0), Pnt(reach_mm + 0.75, reach_mm + 0.75, 8))
    for solid in (block, near):
        solid.faces.Min(X).name, solid.faces.Min(Y).name = "mirror_x", "mirror_y"
        solid.solids.name = "rubber"
    block.faces.Max(Z).name = "held"
    near.maxh = 1.0
    flat = Axes((0, 0, 0), n=Z, h=X)
    disc = WorkPlane(flat).Circle(disc_mm).Face() * WorkPlane(flat).Rectangle(QUARTER_MM[0], QUARTER_MM[1]).Face()
    disc.faces.name, disc.faces.maxh = "load", 0.6
    beads = []
    for number, centre in enumerate(centres):
        bead = Sphere(Pnt(*centre), radius_mm)
        for axis, (way, name) in enumerate(((X, "mirror_x"), (Y, "mirror_y"))):
            if abs(centre[axis]) < 1e-9:
                bead = bead * HalfSpace(Pnt(0, 0, 0), Vec(*(-np.eye(3)[axis])))
                bead.faces.Min(way).name = name
        bead.solids.name, bead.maxh = f"bead{number}", radius_mm
        beads.append(bead)
    glued = OCCGeometry(Glue([block, near, disc, *beads]))
    wanted = {"maxh": 12, "grading": 0.3, "curvaturesafety": fineness, "segmentsperedge": 1, "optsteps3d": 2}
    return ng.Mesh(glued.GenerateMesh(**wanted))


RADIUS_MM = 0.25
PILLAR_MM = 2.5
PUSH_N = 3.0
NOISE_PX = 0.03
"""Of the shifts that the reconstruction is given, the same draw with beads and without."""

RESOLVED = ((1.0, 2, 2.0), (1.0, 3, 2.0), (2.3, 2, 2.0), (2.3, 2, 3.0))
"""Reach of the resolved beads along x and y (mm), order of displacement, elements over a bead's curvature radius."""

SOFTER = (0.5, 0.4975, 0.49, 0.47)
"""Poisson's ratios of the rubber around 4 resolved beads: the closed forms hold at 1/2."""

STIFF = {"markers.red.stiff": True, "markers.blue.stiff": True}
SCENE = {"tolerance.preset": "none", "material.poisson_ratio": 0.5}
DIRECTIONS = {"along z": (0, 0, 1), "along x": (1, 0, 0)}


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return the rows: resolved beads against closed forms, then all beads; the quick form resolves 4 beads."""
    sensor = Sensor(load_scene("kamiyama_pillar", overrides=SCENE))
    what = "Resolved beads next to the pillar, change of their motion in % of the largest displacement"
    rows = [{"what": what, **_resolved(sensor, *case)} for case in (RESOLVED[:1] if quick else RESOLVED)]
    for direction, force in DIRECTIONS.items():
        rows.append(_all_beads_row(sensor, direction, force))
    if quick:
        return rows
    rows += [_softer_row(poisson_ratio) for poisson_ratio in SOFTER]
    return [*rows, _option_row()]


def _resolved(sensor: Sensor, reach_mm: float, order: int, fineness: float, rounds: int = 2) -> dict[str, Any]:
    rubber, clock = sensor.actual.scene.material, Clock()
    centres = _centres(sensor)
    solved = bead_solutions(centres, RADIUS_MM, PILLAR_MM, reach_mm, order, fineness, rubber.poisson_ratio)
    seconds, modulus = clock.lap().cpu, rubber.youngs_modulus_mpa
    quarters = np.concatenate([solved.centres * [a, b, 1] for a in (1, -1) for b in (1, -1)])
    whole = np.unique(quarters.round(9), axis=0)
    found = [int(np.abs(whole - centre).sum(axis=1).argmin()) for centre in solved.centres]
    motion = _closed(sensor, whole, (0, 0, 1), rounds)
    largest = _largest(motion.passive)
    change, closed = (solved.beads - solved.passive) / modulus, motion.change[found]
    return {
        "beads": len(whole),
        "order": order,
        "elements": solved.elements,
        "unknowns": solved.unknowns,
        "passive points off, %": 100 * _largest(solved.passive / modulus - motion.passive[found]) / largest,
        "finite elements, %": 100 * _largest(change) / largest,
        "closed form, %": 100 * _largest(closed) / largest,
        "largest difference, %": 100 * _largest(change - closed) / largest,
        "cpu_s": seconds,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def _all_beads_row(sensor: Sensor, direction: str, force: tuple[float, float, float]) -> dict[str, Any]:
    clock = Clock()
    centres = _centres(sensor)
    first, second = (_closed(sensor, centres, force, rounds) for rounds in (1, 2))
    seconds = clock.lap().cpu
    largest, moved = _largest(first.passive), first.passive
    layers = {name: sensor.nominal_markers.of(name) for name in ("red", "blue")}
    with_beads, without = (_reconstructed(sensor, moved + c) for c in (second.change, 0 * moved))
    axis = int(np.argmax(np.abs(force)))
    sideways = float(np.vdot(second.change[:, :2], moved[:, :2]) / np.vdot(moved[:, :2], moved[:, :2]))
    return {
        "what": "All beads, closed form, in % of the largest displacement; force in % of itself",
        "push": direction,
        "beads": len(centres),
        "alone, %": 100 * _largest(first.alone) / largest,
        "together, first order, %": 100 * _largest(first.change) / largest,
        "together, second order, %": 100 * _largest(second.change) / largest,
        **{f"{name}, %": 100 * _largest(second.change[which]) / largest for name, which in layers.items()},
        "sideways motion, %": 100 * sideways,
        "total force, %": 100 * float(with_beads[:, axis].sum() / without[:, axis].sum() - 1),
        "force field, %": 100 * float(np.linalg.norm(with_beads - without) / np.linalg.norm(without)),
        "cpu_s": seconds,
    }


def _softer_row(poisson_ratio: float) -> dict[str, Any]:
    """Compare the option with resolved beads in rubber that gives way to pressure."""
    sensor = Sensor(load_scene("kamiyama_pillar", overrides={**SCENE, "material.poisson_ratio": poisson_ratio}))
    what = "The closed form below Poisson's ratio 1/2: 4 resolved beads, in % of the largest displacement"
    found = _resolved(sensor, *RESOLVED[1], rounds=1)
    kept = {key: found[key] for key in ("finite elements, %", "closed form, %", "largest difference, %")}
    return {"what": what, "Poisson's ratio": poisson_ratio, **kept}


def _option_row() -> dict[str, Any]:
    """Time the scene's markers under the pillar, passive and stiff, on a first and on a further press."""
    seconds: dict[str, list[float]] = {}
    for name, more in (("passive", {}), ("stiff", STIFF)):
        sensor = Sensor(load_scene("kamiyama_pillar", overrides={**SCENE, **more}))
        load = sensor.press().load
        sensor.displacement(_centres(sensor)[:1], load)
        seconds[name] = [cost.cpu for cost in repeated(partial(sensor.motion, load), 4)]
    return {
        "what": "The option's price: motion of 636 markers under a press of the pillar, processor seconds",
        **{f"{name}, first": times[0] for name, times in seconds.items()},
        **{f"{name}, next": min(times[1:]) for name, times in seconds.items()},
    }


def _centres(sensor: Sensor) -> Points:
    """Return the (n, 3) places of the beads as designed."""
    return sensor.nominal_markers.points


def _closed(sensor: Sensor, centres: Points, force: tuple[float, float, float], rounds: int) -> BeadMotion:
    given = {"load": _load(sensor, force)}
    body: Compliance = sensor.compliance
    moved, slopes = (partial(each, **given) for each in (body.displacement, body.gradient))
    return bead_motion(moved, slopes, centres, RADIUS_MM, sensor.actual.scene.material.youngs_modulus_mpa / 3, rounds)


def _load(sensor: Sensor, force: tuple[float, float, float]) -> Rectangles:
    return sensor.rectangles(Traction.disk(centre_mm=(0, 0), radius_mm=PILLAR_MM, force_n=force))


def _reconstructed(sensor: Sensor, moved: Points) -> Floats:
    """Return the (k, 3) forces that the sensor's software finds, N, from marker motion (n, 3) in mm for 1 N."""
    rest = sensor.nominal_markers.points
    at_rest = sensor.project(rest)
    noise = np.random.default_rng(0).normal(0.0, NOISE_PX, at_rest.shape)
    found = Found(
        rest_px=at_rest, shift_px=sensor.project(rest + PUSH_N * moved) - at_rest + noise,
        sd_px=np.full(len(rest), NOISE_PX), layer=sensor.nominal_markers.layer, channels={}, method="given",
    )  # fmt: skip
    return reconstruct(found, calibration_of(sensor)).force_n


def _largest(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())
