"""Where answers break: each axis is walked outwards from the middle until an answer is wrong or refused.

A step holds when nothing that must be true of any answer is off by more than the bounds of its axis: the relative
residual; the imbalance of load and reaction; the asymmetry of the compliance, or under mirrored loads; and the
departure from what must come out. Where the program estimates its error, mirrored answers may differ by three times
that. ``python -m benchmarks stress`` stores the rows, ``python -m benchmarks.pages stress`` writes them into
docs/stress.md.

* Elasticity: the balance of a load is the sum of the tractions that the half-space's field leaves on all faces, against
  the load. The bodies are left unheld for that, so that the base counts as well.
* Tracking, on drawn pictures (`benchmarks.discs`): departure is the share of markers that are given a shift more than
  half a px wrong; what is not found is left out and said, which is no departure.
* Inverse: departure is the error of the total force.

Contact and pictures are refused or right to the ends of what a recipe allows: `benchmarks.extremes` and the tests of
``twin.world`` hold them there.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks import ROOT, discs
from benchmarks.clock import Clock, empty_cache
from benchmarks.inverse import case
from benchmarks.reference import BODIES
from benchmarks.tracking import FINGER, SIZE
from twin.arrays import Floats, Points
from twin.errors import SolveError, TwinError
from twin.files import MESHES
from twin.parts.body import Body
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.sense.reconstruct import reconstruct
from twin.sense.track import track
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.correction_loads import nodal_forces
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.fem import Layer, TaylorHood
from twin.world.mesh.cover_mesh import with_cover
from twin.world.mesh.quadratic_mesh import read_mesh

TOLD = 0.01
"""Estimated error above which the accuracy of every shipped scene is missed, so that a run warns."""

SLACK = 3.0
"""Two answers are compared, each of them off, and what the program says is an estimate."""

FIGURES = ("residual", "imbalance", "asymmetry", "departure")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """How far an answer is from what must be true of it; NaN where a figure says nothing.

    ``told`` is the error that the program itself estimates; an asymmetry within `SLACK` times that holds.
    """

    residual: float = np.nan
    imbalance: float = np.nan
    asymmetry: float = np.nan
    departure: float = np.nan
    told: float = np.nan

    def beyond(self, bounds: Measured) -> str:
        """Return which figures are above their bounds, in words, or an empty string."""
        wrong = []
        for name in FIGURES:
            mine, most = getattr(self, name), getattr(bounds, name)
            if name == "asymmetry" and not np.isnan(self.told):
                most = SLACK * self.told
            if not (np.isnan(most) or mine <= most):
                wrong.append(f"{name} {mine:.1e}")
        return ", ".join(wrong)

    def or_worse(self, other: Measured) -> Measured:
        """Return the larger of each figure."""
        return Measured(**{f.name: float(np.fmax(getattr(self, f.name), getattr(other, f.name))) for f in fields(self)})

    def columns(self) -> dict[str, float | str]:
        """Return the figures as cells; empty where there is none."""
        each = {name: getattr(self, name) for name in FIGURES}
        return {f"worst {name}": "" if np.isnan(value) else value for name, value in each.items()}


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One way to go to extremes: steps from mild to extreme, and what is measured at a step."""

    name: str
    steps: tuple[float, ...]
    attempt: Callable[[float], Measured]
    bounds: Measured


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row an axis; the quick form walks every fourth step of elasticity alone."""
    with empty_cache():
        return [row for stage in (["elasticity"] if quick else STAGES) for row in _walked(stage, quick)]


def _walked(stage: str, quick: bool) -> list[dict[str, Any]]:
    rows = []
    for axis in STAGES[stage]():
        clock = Clock()
        row = survey(axis, axis.steps[:: 4 if quick else 1])
        rows.append({"what": "Breaking points", "stage": stage, **row, "cpu_s": clock.lap().cpu})
    return rows


def survey(axis: Axis, steps: tuple[float, ...]) -> dict[str, Any]:
    """Walk an axis; return how far it holds, what comes first beyond, and the worst figures of the steps that hold."""
    held: list[float] = []
    worst = Measured()
    first_bad = ""
    refused = ""
    for step in steps:
        try:
            measured = axis.attempt(step)
        except TwinError as problem:
            refused = f"from {step:g} refused: {_short(problem)}"
            break
        wrong = measured.beyond(axis.bounds)
        if wrong:
            told = f"estimates {measured.told:.2g}" if measured.told > TOLD else "doesn't say so"
            first_bad = first_bad or f"at {step:g} degraded, the program {told}: {wrong}"
        elif not first_bad:
            held.append(step)
            worst = worst.or_worse(measured)
    return {
        "axis": axis.name,
        "tried": f"{steps[0]:g} to {steps[-1]:g}",
        "holds to": f"{held[-1]:g}" if held else "nowhere",
        "beyond": "; ".join(filter(None, (first_bad, refused))) or "not reached",
        **worst.columns(),
    }


def _short(problem: TwinError) -> str:
    text = re.sub(r"\s+", " ", str(problem)).replace("|", "/").replace(f"{ROOT}/", "")
    return text if len(text) <= 110 else text[:107].rsplit(" ", 1)[0] + " ..."


# elasticity, on the nominal meshes

PUSH = (0.3, -0.5, 1.0)
SOUND = Measured(residual=1e-9, imbalance=1e-5, asymmetry=1e-5)
"""Bounds of every elastic system: the program's own on the residual, and a hundred thousandth of the load."""

AT_LOAD = replace(SOUND, imbalance=0.01)
"""Quadrature is good to a few thousandths next to an edge; under mirrored loads the program's own estimate is asked."""

MIRRORS = {"block": np.array([-1.0, 1.0, 1.0]), "finger": np.array([1.0, -1.0, 1.0])}
"""Under which the bodies are symmetric."""

LEAST_DEPTH_MM, ASIDE = 0.3, 0.05
"""Least depth of points, and their least distance to all other faces over the body's height: next to a free side, where
no marker is, mirrored answers differ up to twice as much."""


def elastic_axes() -> list[Axis]:
    """Return the axes of covers and of loads at a place.

    A load's distances are from its middle; its width is twice that, so that it touches the edge.
    """
    gaps = (20.0, 10.0, 3.0, 1.0, 0.1, 1e-2, 1e-3, 2e-4, 1e-4, 5e-5)
    edge = partial(_of_place, "block", lambda gap: (50 - gap, 3.0, 0.0))
    corner = partial(_of_place, "block", lambda gap: (50 - gap, 45 - gap, 0.0))
    back = partial(_of_place, "finger", _beside_back)
    stiffer = (1.0, 1e3, 1e6, 1e7, 1e8, 1e9)
    softer = (1.0, 1e-3, 1e-6, 1e-9, 1e-12)
    return [
        Axis(name="cover, times stiffer", steps=stiffer, attempt=_of_cover, bounds=SOUND),
        Axis(name="cover, times as stiff", steps=softer, attempt=_of_cover, bounds=SOUND),
        Axis(name="block, load touching an edge, mm from its middle", steps=gaps, attempt=edge, bounds=AT_LOAD),
        Axis(name="block, load touching a corner", steps=gaps, attempt=corner, bounds=AT_LOAD),
        Axis(name="finger, load touching the back edge", steps=(4.0, *gaps[2:]), attempt=back, bounds=AT_LOAD),
        Axis(
            name="finger, load 0.5 mm wide, mm from its middle to the clamped rim (departure: motion of the clamp)",
            steps=(2.0, 1.5, 1.0, 0.75, 0.5, 0.3, 0.25),
            attempt=_of_rim,
            bounds=replace(AT_LOAD, departure=0.1),
        ),
    ]


def _of_cover(ratio: float) -> Measured:
    """Solve unit forces on two nodes of the block's sensing surface: residual, reaction and reciprocity."""
    mesh = with_cover(read_mesh(MESHES / "kamiyama_block.nominal.npz"), BODIES["block"], 0.2)
    system = TaylorHood(mesh, 0.5, layers=(Layer(modulus_ratio=ratio, poisson_ratio=0.5),))
    places = np.array([(0, 0, 0), (0.2, 0.1, 0)]) * np.ptp(mesh.points[:, 0])
    sites = [int(np.argmin(np.linalg.norm(mesh.points - place, axis=1))) for place in places]
    forces = np.zeros((len(mesh.points), 3, 6))
    for k, site in enumerate(sites):
        forces[site, :, 3 * k : 3 * k + 3] = np.eye(3)
    compliance = system.solve(forces)[sites].reshape(6, 6)
    return Measured(
        residual=system.factor.residual,
        imbalance=float(np.abs(system.reaction(forces) + np.tile(np.eye(3), 2)).max()),
        asymmetry=_relative(compliance.T, compliance),
    )


def _relative(one: Floats, other: Floats) -> float:
    """Return the largest difference over the largest entry."""
    return float(np.abs(one - other).max() / np.abs(other).max())


@cache
def _stiff(name: str) -> Compliance:
    return Compliance(BODIES[name], Material(youngs_modulus_mpa=1.0), level="nominal", table=False)


@cache
def _loose(name: str) -> Body:
    """Return the body, held nowhere."""
    body = BODIES[name]
    kind: Any = type("Loose", (type(body),), {"held_pieces": property(lambda self: ())})
    made: Body = kind(**body.geometry())
    return made


@cache
def _points(name: str) -> Points:
    """Return points (n, 3) all over a body, 0.3 mm deep or deeper, and a twentieth of its height off other faces."""
    body = BODIES[name]
    low, high = (np.array(b) for b in body.bounds_mm)
    points = np.random.default_rng(0).uniform(low, high, (3000, 3))
    away = body.piece_distances(points)
    return points[(away[:, 0] >= LEAST_DEPTH_MM) & (away[:, 1:].min(axis=1) >= ASIDE * body.base_z_mm)]


def _measured(name: str, centre: Floats, width: float) -> Measured:
    """Press a square at a surface point (3,), and its mirror image at the mirrored point; compare their answers."""
    stiff, mirror, points = _stiff(name), MIRRORS[name], _points(name)
    load, mirrored = (_square(name, centre * sign, width, np.array(PUSH) * sign) for sign in (np.ones(3), mirror))
    here = stiff.displacement(points, load)
    residual = stiff.system.factor.residual
    there = stiff.displacement(points * mirror, mirrored) * mirror
    total = load.force_n.sum(axis=0)
    left = nodal_forces(stiff.mesh, _loose(name), load, load.force_n[:, :, None], 0.5).sum(axis=0)[:, 0]
    return Measured(
        residual=max(residual, stiff.system.factor.residual),
        imbalance=float(np.linalg.norm(left - total) / np.linalg.norm(total)),
        asymmetry=_relative(there, here),
        told=stiff.answer(points, load)[1],
    )


def _square(name: str, centre: Floats, width: float, force: Floats) -> Rectangles:
    return tile(Traction.rectangle(tuple(centre), (width, width), tuple(force)), BODIES[name])


def _of_place(name: str, centre: Callable[[float], tuple[float, ...]], gap: float) -> Measured:
    return _measured(name, np.array(centre(gap)), 2.0 * gap if gap < 5.0 else 4.0)


def _beside_back(gap: float) -> tuple[float, ...]:
    x, y, z = BODIES["finger"].chart_points(np.array([[gap - 8.0, 3.0]]))[0]
    return float(x), float(y), float(z)


def _of_rim(gap: float) -> Measured:
    centre = np.array([-3.0, 8.0, 10.0 - gap])
    load = _square("finger", centre, 0.5, np.array(PUSH))
    base = np.array([(x, y, 10.0) for x in np.linspace(-7.7, 0.0, 20) for y in np.linspace(-7.7, 7.7, 60)])
    clamped, points = (_stiff("finger").displacement(p, load) for p in (base, _points("finger")))
    still = np.linalg.norm(clamped, axis=1).max() / np.linalg.norm(points, axis=1).max()
    told = _stiff("finger").answer(np.concatenate([base, _points("finger")]), load)[1]
    return replace(_measured("finger", centre, 0.5), departure=float(still), told=told)


# tracking

WRONG_PX = 0.5
LAYOUT = FINGER.layout()
MARKS = np.concatenate(list(LAYOUT.values()))


def tracking_axes() -> list[Axis]:
    """Return the axes of tracking."""
    shares = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
    walks: list[tuple[str, tuple[float, ...], Callable[[float], Measured]]] = [
        ("motion of all markers, over the pitch", (0.0, 0.2, 0.4, 0.6, 0.8, 1.0), lambda s: _tracked(motion=s)),
        ("motion, each its own, over the pitch", (0.0, 0.1, 0.2, 0.3, 0.4, 0.5), lambda s: _tracked(scatter=s)),
        ("share of markers missing", shares, lambda s: _tracked(missing=s)),
        ("contrast down, counts", (130.0, 40.0, 20.0, 10.0, 5.0, 2.0, 0.0), lambda c: _tracked(contrast=c)),
        ("brightness up, counts (255 saturate)", (130.0, 200.0, 400.0, 2e3, 1e5), lambda c: _tracked(contrast=c)),
        ("blur, px", (0.7, 2.0, 4.0, 8.0), lambda b: _tracked(blur=b)),
        ("rows of pixels cut off the picture's end, set black", (0, 50, 200, 479), lambda n: _tracked(cut=int(n))),
        ("share of spurious spots", (0.0, 0.1, 0.5, 1.0), lambda s: _tracked(spurious=s)),
    ]
    return [Axis(name=n, steps=s, attempt=a, bounds=Measured(departure=0.02)) for n, s, a in walks]


def _drawn(places: Floats, contrast: float, blur: float, seed: int) -> np.ndarray:
    cut = len(LAYOUT["red"])
    drawn = discs.scene(SIZE, [(places[:cut], 0), (places[cut:], 2)], FINGER.diameter, blur, contrast)
    return discs.expose(drawn, seed)


def _tracked(
    *,
    motion: float = 0.0,
    scatter: float = 0.0,
    missing: float = 0.0,
    contrast: float = 130.0,
    blur: float = 0.7,
    cut: int = 0,
    spurious: float = 0.0,
) -> Measured:
    random = np.random.default_rng(5)
    shift = motion * FINGER.pitch * np.array([0.8, 0.6]) + random.uniform(-1, 1, MARKS.shape) * scatter * FINGER.pitch
    places = np.where(random.random(len(MARKS))[:, None] < missing, np.nan, MARKS + shift)
    picture = _drawn(places, contrast, blur, 1)
    if cut:
        picture[-cut:] = 0
    for x, y in random.uniform((20, 20), (620, 460), (round(spurious * len(MARKS)), 2)).astype(int):
        picture[y - 5 : y + 5, x - 5 : x + 5, random.integers(0, 3)] = 160
    found = track(_drawn(MARKS, contrast, blur, 0), picture, LAYOUT).shift_px
    gone = ~np.isfinite(places).all(axis=1)
    given = np.isfinite(found).all(axis=1)
    wrong = given & (gone | (np.hypot(*(found - shift).T) > WRONG_PX))
    return Measured(departure=float(wrong.mean()))


# the inverse problem


def inverse_axes() -> list[Axis]:
    """Return the axes of the inverse problem."""
    robust = partial(_solved, robust=True)
    walks: list[tuple[str, tuple[float, ...], Callable[[float], Measured]]] = [
        ("weight up (departure: error of the total)", (1.0, 1e3, 1e6, 1e9, 1e12, 1e300), lambda w: _solved(weight=w)),
        ("weight down", (1.0, 1e-3, 1e-6, 1e-12, 1e-300, 0.0), lambda w: _solved(weight=w)),
        ("weight by itself, noise of a shift, px", (0.05, 0.2, 1.0, 5.0, 50.0), lambda n: _solved(noise=n)),
        ("share of vectors wrong by 10 px, robust", (0.0, 0.02, 0.1, 0.2, 0.4), lambda s: robust(wrong=s)),
        ("share of vectors wrong by 10 px, not robust", (0.0, 0.02, 0.1), lambda s: _solved(wrong=s)),
        ("share of vectors lost", (0.0, 0.2, 0.5, 0.9, 0.99, 1.0), lambda s: _solved(lost=s)),
        ("shifts, times", (1.0, 1e3, 1e9, 1e100), lambda k: _solved(scale=k)),
    ]
    return [Axis(name=n, steps=s, attempt=a, bounds=Measured(departure=0.1)) for n, s, a in walks]


@cache
def _sensor() -> tuple[Any, Any]:
    sensor = Sensor(load_scene("kamiyama_pillar"))
    return calibration_of(sensor), case(sensor, calibration_of(sensor), 3)


def _solved(
    *,
    noise: float = 0.0,
    wrong: float = 0.0,
    lost: float = 0.0,
    scale: float = 1.0,
    robust: bool = False,
    weight: float | str = "auto",
) -> Measured:
    calibration, (found, _, force, _) = _sensor()
    random = np.random.default_rng(8)
    shift = np.array(found.shift_px) * scale + random.normal(0, noise, found.shift_px.shape)
    bad = random.permutation(len(shift))[: round(wrong * len(shift))]
    shift[bad] += random.choice([-10.0, 10.0], (len(bad), 2))
    shift[random.permutation(len(shift))[: round(lost * len(shift))]] = np.nan
    given = replace(found, shift_px=shift, sd_px=np.full(len(shift), max(noise, 0.05) * scale))
    answer = reconstruct(given, calibration, weight=weight, robust=robust)
    if not np.isfinite(answer.total_force_n).all():
        raise SolveError("the total is not finite")
    return Measured(departure=float(np.linalg.norm(answer.total_force_n / scale - force) / np.linalg.norm(force)))


STAGES: dict[str, Callable[[], list[Axis]]] = {
    "elasticity": elastic_axes,
    "tracking": tracking_axes,
    "inverse": inverse_axes,
}
"""Stages with the function that returns their axes."""
