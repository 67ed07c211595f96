"""The experimental bench of the papers' entries: sensors with their software, and records.

A `Chain` without overrides is *the* sensor of a paper, the same in every table and figure.
Overrides switch one modelled cause off or change one design number. Rest pictures, presses and
calibrations are kept; variants that differ in camera or software alone share the presses of one
body, because the press is most of the work on the finger.

The function of an entry states what is measured, the numbers taken from that, causes and ranges.
`Bench.compare` makes the runs and their records (`twin.study.reproduce.record`).
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeAlias, TypeVar

import numpy as np

from twin.arrays import Floats, Picture, Progress
from twin.judge.score import force_score, into_cells
from twin.parts.load import Load, Traction
from twin.parts.methods import CentreMethod, Method
from twin.parts.part import Purpose, hash_of
from twin.parts.press import Cylinder, Press, Sphere, Step
from twin.parts.scene import Scene
from twin.parts.sweep import GF
from twin.sense.calibration import Calibration
from twin.sense.reconstruct import Field, reconstruct
from twin.sense.track import Found
from twin.show.reproduction_page import Panel
from twin.study.calibrate import calibration_of, half_space_compliance
from twin.study.recipe import load_scene
from twin.study.reproduce.record import Numbers, Quantity, Record, Unprinted
from twin.study.sensor import Motion, Sensor
from twin.theory.optics import project_with_jacobian
from twin.world.contact.pressing import ContactState, PathMemory

if TYPE_CHECKING:
    from twin.sense.reference import Rest

T = TypeVar("T")

SCENES = {"kamiyama": "kamiyama_paper", "sato": "sato_paper"}
"""The scene of each paper's sensor."""

OUR_TRACKER: CentreMethod = "disc-fit"
"""This project's own tracker: the default of a scene."""

SENSOR_KEYS = ("body", "material", "cover", "markers", "camera", "light", "ccd", "tolerance")
"""What makes the sensor: the rest of a scene is the press and the software."""

DRAWING = ("body", "material", "cover", "markers", "camera", "calibration", "reconstruction")
"""What a calibration from the nominal design depends on."""

MECHANICAL = ("body", "material", "cover", "accuracy")
"""What of an actual scene decides how its body moves."""

TABLE = "accuracy.surface_table"
TABLED = ("sato",)
"""Papers on whose own made sensor loads are read from a table of the surface
(`twin.world.elasticity.interpolated`).

Why: 75 calibration presses alone cost twice what the table does, which then serves every other
press for next to nothing. The errors of H differ by 2 % of themselves from those of presses solved
one by one. The quick form presses too little for it."""

MADE = 10
"""Made sensors over which a number's spread is taken. Where fingers are pressed it is one, whose
calibration alone is 75 presses, and the spread is of as many runs of exposures and load cell."""

RANGED = 3
"""Trials over which the numbers of a range are averaged, at most."""

FITTED: dict[str, tuple[str, ...]] = {
    "kamiyama": (
        "ccd.read_noise_e = 112, to the mean of the four standard deviations of Table 1 (0.21 px) "
        "when the markers are moved and filmed again: the noise of the capture unit is in no paper",
    ),
    "sato": ("nothing is fitted: every number is the paper's or an assumption of the scene",),
}
"""What was fitted to each paper, once, and is used everywhere."""

NO_NOISE = "noise off"
OUR_TRACKER_INSTEAD = "tracker: this project's instead of the paper's"
"""Causes, in the words of the page."""

QUIET: dict[str, Any] = {"ccd.noise": False}

FAR = 50.0
"""Times the distance at which a lens sees almost in parallel."""

SPOT_MM = 0.5
"""Radius of the disc that stands for a narrow force."""

APART = 20_000
"""Exposures from one trial to the next on the same made sensor."""

PILLAR_N = 3.0
"""Force on the 5 mm pillar, in no paper: the same in every entry."""
PILLAR_PRESS = Press(probe=Cylinder(diameter_mm=5), force_n=(0.0, 0.0, PILLAR_N))
"""Press of Figs. 9 to 13: along z, at the middle."""


PRELOAD_GF = 200.0
"""Largest force of Sato's Fig. 8, along every axis."""

READ_GF = 30.0
"""The resolution of the magnitude that Sato prints."""

RESOLVED = 1.96 * 2**0.5
"""Differences of two readings above this many standard deviations of one are real at 95 %."""

FIRST_EXPOSURE = 2000
"""Of Sato's Fig. 8."""

Way = Literal["digital", "re-rendered"]
WAYS: tuple[Way, ...] = ("digital", "re-rendered")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One table or figure: what ``entries.toml`` declares of it, and the function that makes it."""

    @dataclass(frozen=True, kw_only=True)
    class Outcome:
        """Records, the drawings of the picture, and notes for the page."""

        records: Sequence[Record]
        panels: Sequence[Panel] = ()
        notes: Sequence[str] = ()

    name: str
    title: str
    source: str
    protocol: str
    cpu_seconds: int
    memory_gb: float | None = None
    long: bool = False
    quick: str = ""
    notes: Sequence[str] = ()
    run: Callable[[Bench], Outcome]


class _KeptSensor(Sensor):
    """A sensor whose levels of mesh, presses and motions are kept for all that share its body."""

    def __init__(self, scene: Scene, bench: Bench) -> None:
        super().__init__(scene, lambda what, _share: bench.progress(what))
        self._bench = bench

    @cached_property
    def _body(self) -> str:
        actual = self.actual.scene
        key = "".join(repr(getattr(actual, name)) for name in MECHANICAL)
        return hashlib.sha256(key.encode()).hexdigest()

    def _once(self, what: str, key: Any, work: Callable[[], T]) -> T:
        """Return ``work()``, done once for this body."""

        def quietly() -> T:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return work()

        return self._bench.once((what, self._body, key), quietly)

    @cached_property
    def ladder(self) -> Any:
        """The actual body's levels of mesh."""
        return self._bench.once(("ladder", self._body), lambda: super(_KeptSensor, self).ladder)

    def press(self, press: Press | None = None, memory: PathMemory | None = None) -> ContactState:
        """Solve a press once."""
        assert press is not None
        solve = super().press
        return self._once("press", press.model_dump_json(), lambda: solve(press, memory))

    def motion(self, load: Load) -> Motion:
        """Return how the actual markers move under a load, which is kept so that its id is."""
        markers = hashlib.sha256(self.actual.markers.points.tobytes()).hexdigest()
        move = super().motion
        return self._once("motion", (markers, id(load)), lambda: (load, move(load)))[1]


class Rig:
    """One made sensor on the bench, with what was measured on it."""

    def __init__(self, scene: Scene, bench: Bench) -> None:
        self.scene = scene
        self.sensor = _KeptSensor(scene, bench)
        self._bench = bench
        self._rests: dict[str, Rest] = {}

    def press(self, press: Press) -> ContactState:
        """Solve a press, or return it again; its strain is noted."""
        state = self.sensor.press(press)
        self._bench.note(state=state)
        return state

    def motion(self, load: Load) -> Motion:
        """Return how a load moves the markers; its error is noted."""
        motion = self.sensor.motion(load)
        self._bench.note(error=motion.error)
        return motion

    def half_space_motion(self, load: Load) -> Motion:
        """Return how a load would move the actual markers, beads, in a half-space: the papers'
        formula."""
        points = self.sensor.actual.markers.points
        pieces = self.sensor.rectangles(load)
        compliance = half_space_compliance(self.sensor.actual.scene, points, pieces)
        return _unstrained((compliance @ pieces.force_n.ravel()).reshape(-1, 3))

    def shifted(self, shift_px: tuple[float, float]) -> Motion:
        """Return the motion along x and y that moves every marker by ``shift_px`` in the
        picture."""
        points = self.sensor.actual.markers.points
        wanted = self.sensor.project(points) + np.array(shift_px)
        moved = np.zeros_like(points)
        scale = self.image_scale[:, :, :2]
        for _ in range(3):
            missing = wanted - self.sensor.project(points + moved)
            moved[:, :2] += np.linalg.solve(scale, missing[:, :, None])[:, :, 0]
        return _unstrained(moved)

    def picture(self, motion: Motion | None, exposure: int) -> Picture:
        """Expose the markers at rest or moved."""
        return self.sensor.picture(motion, exposure)

    def rest(self, method: CentreMethod | None = None) -> Rest:
        """Analyse a rest picture once, by default for the paper's tracker."""
        from twin.sense.track import analyse_rest

        tracker = method or self.scene.tracking.method
        if tracker not in self._rests:
            picture = self.picture(None, 0)
            self._rests[tracker] = analyse_rest(picture, self.sensor.layout_px, method=tracker)
        return self._rests[tracker]

    def track(self, picture: Picture, method: CentreMethod | None = None) -> Found:
        """Track the markers from rest to a picture, by default with the paper's tracker."""
        from twin.sense.track import Tracker

        return Tracker.motion(self.rest(method), picture)

    @cached_property
    def calibration(self) -> Calibration:
        """The scene's calibration; one for all sensors of one drawing, if it is made from that."""
        if self.scene.calibration.method == "sato":
            return calibration_of(self.sensor)
        drawing = self.scene.model_dump(mode="json", include=set(DRAWING))
        drawing["reconstruction"] = drawing["reconstruction"]["sites"]
        key = ("drawn", json.dumps(drawing, sort_keys=True))
        return self._bench.once(key, lambda: calibration_of(self.sensor))

    @cached_property
    def image_scale(self) -> Floats:
        """(n, 2, 3) px/mm at the actual markers."""
        made = self.sensor.actual
        return _image_scale(made.scene, made.markers.points)

    def above(self, chart_mm: tuple[float, float]) -> tuple[float, float]:
        """Return (x, y) of the surface point with these arc lengths s and t, mm."""
        x, y, _ = self.scene.body.chart_points(np.array([chart_mm]))[0]
        return float(x), float(y)

    def far_away(self) -> dict[str, Any]:
        """Return overrides of a camera that sees almost in parallel, at equal scale and effect of
        tilt."""
        camera, body = self.scene.imaging[0], self.scene.body
        x, y, z = camera.pupil_mm
        away = FAR * (z - body.base_z_mm)
        return {
            "camera.pupil_mm": [x, y, body.base_z_mm + away],
            "tolerance.tilt_deg": self.scene.tolerance.tilt_deg / FAR,
            "camera.focal_px": camera.focal_px * (away + body.base_z_mm) / z,
        }

    def rest_numbers(self, paper_px: float | None = None, near: float | None = None) -> Numbers:
        """Return the width of markers in the picture at rest, and the share of them that is
        found."""
        rest = self.rest(OUR_TRACKER)
        width = Quantity("width of a marker in the picture", "px", paper=paper_px, near=near)
        return {
            width: float(np.mean([group.look.diameter_px for group in rest.groups])),
            Quantity("share of markers found"): float(np.isfinite(rest.rest_px).all(axis=1).mean()),
        }


def _unstrained(moved_mm: Floats) -> Motion:
    """Return the motion of (n, 3) displacements without strain."""
    gradient = np.zeros((len(moved_mm), 3, 3))
    return Motion(displacement_mm=moved_mm, gradient=gradient, error=0.0)


def _image_scale(scene: Scene, points: Floats) -> Floats:
    return project_with_jacobian(points, *scene.optics)[1]


class Bench:
    """All rigs of a reproduction. A paper's made sensors have ``seed`` and the following ones;
    ``quick`` is one made sensor a paper, and less of everything. ``renderer`` is that of scenes."""

    def __init__(
        self,
        *,
        seed: int = 1,
        quick: bool = False,
        renderer: str = "auto",
        progress: Progress | None = None,
    ) -> None:
        self.seed = seed
        self.quick = quick
        self.renderer = renderer
        self.used: set[str] = set()
        self._progress = progress
        self._share = (0.0, 1.0)
        self._done = 0.0
        self._entry = ""
        self._rigs: dict[str, Rig] = {}
        self._kept: dict[Any, Any] = {}
        self._worst: ContactState | None = None
        self._least_exact = 0.0

    def begin(self, entry: str, share: float, width: float) -> None:
        """Begin an entry, which is a part of the whole."""
        self._entry = entry
        self._share = (share, width)
        self.used.clear()
        self._worst, self._least_exact = None, 0.0
        self.progress("", 0.0)

    def note(self, *, state: ContactState | None = None, error: float = 0.0) -> None:
        """Remember the hardest press and the largest error of the motion of the present entry."""
        self._least_exact = max(self._least_exact, error)
        if state is not None and (
            self._worst is None
            or state.validity.linearisation_error > self._worst.validity.linearisation_error
        ):
            self._worst = state

    @property
    def validity(self) -> str:
        """What mesh and linear theory cost in the present entry's hardest press; empty without a
        load."""
        words = []
        if self._least_exact:
            words.append(
                f"Marker motion is up to {100 * self._least_exact:.2g} % of its largest off, by "
                "the mesh's own estimate."
            )
        if self._worst is not None:
            doubt = self._worst.validity
            ratio = doubt.contact_over_probe_radius
            radius = f"contact radius / probe radius {ratio:.2f}, " if ratio is not None else ""
            words.append(
                f"Hardest press: {radius}mean pressure / Young's modulus {doubt.mean_strain:.2g}; "
                f"linear theory may be up to {100 * doubt.linearisation_error:.2g} % of the "
                "largest displacement off."
            )
        return " ".join(words)

    def progress(self, what: str, share: float | None = None) -> None:
        """Report what is done and how far the present entry is; as far as before by default."""
        if share is not None:
            start, width = self._share
            self._done = min(0.999, start + width * min(share, 1.0))
        if self._progress is not None:
            self._progress(f"{self._entry} {what}".strip(), self._done)

    def trials(self, paper: str, *, pressed: bool = True) -> tuple[Trial, ...]:
        """Return the runs of a spread: made sensors, or exposures of one where the finger is
        ``pressed``."""
        if self.quick:
            return (Trial(seed=self.seed),)
        if paper == "sato" and pressed:
            return tuple(Trial(exposures=APART * number) for number in range(MADE))
        return tuple(Trial(seed=self.seed + number) for number in range(MADE))

    def compare(
        self,
        measure: Measure[T],
        numbers: Callable[[T], Numbers],
        chain: Chain,
        causes: Mapping[str, Chain | Measure[T] | Reading[T]] | None = None,
        trials: Sequence[Trial] | None = None,
        ranges: Mapping[Unprinted, Callable[[float], Chain | Measure[T]]] | None = None,
        label: str = "",
    ) -> tuple[list[Record], list[T], dict[str, T]]:
        """Measure a chain in several trials (by default the paper's), and once with every cause
        off.

        Parameters
        ----------
        measure, numbers
            Make a run, and take the numbers from it.
        causes
            What replaces the chain, the measurement or the reading of the runs, by the cause that
            it switches off.
        ranges
            What replaces chain or measurement at a value of what isn't printed, over `RANGED`
            trials.
        label
            Begins the name of every quantity.

        Returns
        -------
        The records, the runs, and the runs with causes off by name.
        """
        trials = trials or self.trials(chain.paper)

        def run(way: Chain | Measure[T], trial: Trial) -> T:
            return measure(way, trial) if isinstance(way, Chain) else way(chain, trial)

        runs: list[T] = []
        for trial in trials:
            self.progress(f"run {len(runs) + 1} of {len(trials)}")
            runs.append(measure(chain, trial))
        off: dict[str, T] = {}
        without: dict[str, Numbers] = {}
        for name, way in (causes or {}).items():
            self.progress(name)
            if isinstance(way, Reading):
                without[name] = _mean_numbers([way.numbers(found) for found in runs])
            else:
                off[name] = run(way, ONCE)
                without[name] = numbers(off[name])
        ranged: dict[Unprinted, list[Numbers]] = {}
        for what, at in (ranges or {}).items():
            self.progress(what.name)
            ranged[what] = [
                _mean_numbers([numbers(run(way, trial)) for trial in trials[:RANGED]])
                for way in map(at, what.values)
            ]
        records = Record.of_runs([numbers(found) for found in runs], without, ranged, label)
        return records, runs, off

    @staticmethod
    @cache
    def sensor_hash(paper: str) -> str:
        """Return the hash of a paper's resolved sensor, without press, software and seed."""
        return _hash(load_scene(SCENES[paper]))

    def rig(
        self, paper: str, seed: int | None = None, overrides: Mapping[str, Any] | None = None
    ) -> Rig:
        """Return a made sensor: the paper's own, or a variant of it."""
        own = {"seed": self.seed if seed is None else seed, "renderer": self.renderer}
        given = {**own, **(overrides or {})}
        if self._tabled(paper, given):
            given[TABLE] = True
        scene = load_scene(SCENES[paper], given)
        if _hash(scene) == Bench.sensor_hash(paper):
            self.used.add(paper)
        key = json.dumps([paper, given], sort_keys=True, default=str)
        if key not in self._rigs:
            self._rigs[key] = Rig(scene, self)
        return self._rigs[key]

    def _tabled(self, paper: str, given: Mapping[str, Any]) -> bool:
        """Return whether loads on this sensor are products with the table of its body."""
        changed = {key.split(".")[0] for key in given} & {"tolerance", "body", "material"}
        own = given["seed"] == self.seed and not changed
        return paper in TABLED and not self.quick and own

    def once(self, key: Any, work: Callable[[], T]) -> T:
        """Return ``work()``, done at the first call with this key."""
        if key not in self._kept:
            self._kept[key] = work()
        found: T = self._kept[key]
        return found

    def pressing(self, press: Press, exposure: int = 1) -> Callable[[Chain, Trial], Shot]:
        """Return the measurement that is the shot of a press."""
        return lambda chain, trial: chain.shot(self, press, trial, exposure)

    def by_presses(self, overrides: Mapping[str, Any]) -> Calibration:
        """Return a variant of the finger's calibration by presses; every variant is made once."""
        rig = self.rig("sato", overrides=overrides)
        key = ("by presses", repr(sorted(overrides.items())))
        return self.once(key, lambda: calibration_of(rig.sensor, kept=False))


def _mean_numbers(runs: Sequence[Numbers]) -> Numbers:
    """Return the mean of every quantity over runs."""
    return {quantity: float(np.mean([run[quantity] for run in runs])) for quantity in runs[0]}


def _hash(scene: Scene) -> str:
    table = scene.model_dump(mode="json", include=set(SENSOR_KEYS))
    return hash_of(table)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One of several runs: a made sensor, and the number of its first exposure."""

    seed: int | None = None
    exposures: int = 0


ONCE = Trial()
Measure: TypeAlias = "Callable[[Chain, Trial], T]"


@dataclass(frozen=True)
class Reading(Generic[T]):
    """Another way to take numbers from the same runs."""

    numbers: Callable[[T], Numbers]


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A press, what the tracker found in its picture, and the reconstructed field."""

    rig: Rig
    state: ContactState
    found: Found
    field: Field

    @property
    def truth(self) -> Field:
        """The press's forces summed into the cells of the sites."""
        pieces = self.rig.sensor.rectangles(self.state.load)
        force = into_cells(self.field.site_mm, pieces.centre_mm, pieces.force_n)
        return replace(self.field, force_n=force)

    def score(self, name: str) -> float:
        """Return one number of the judge's score of the field; NaN where it is not defined."""
        score = force_score(self.field, self.rig.sensor.rectangles(self.state.load))
        return float("nan") if score[name] is None else float(score[name])


@dataclass(frozen=True, kw_only=True)
class Chain:
    """A sensor with its software.

    Attributes
    ----------
    paper, overrides
        The sensor: a paper's scene with other values.
    tracker, method, options
        Of tracking, by default the scene's, and of the inverse, whose weight is automatic.
    calibrated_by
        Another method than the scene's, where ``no camera`` leaves the motion along z out; or
        overrides of the sensor that presses are made on.
    half_space
        Whether a half-space is filmed in the block's place.
    """

    paper: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    tracker: CentreMethod | None = None
    method: Method = "norm"
    options: Mapping[str, Any] = field(default_factory=dict)
    calibrated_by: str | Mapping[str, Any] | None = None
    half_space: bool = False

    def rig(self, bench: Bench, trial: Trial = ONCE) -> Rig:
        """Return the sensor."""
        return bench.rig(self.paper, trial.seed, self.overrides)

    def calibration(self, bench: Bench, rig: Rig) -> Calibration:
        """Return the calibration; the quick form makes none by presses but the paper's own."""
        wanted = self.calibrated_by
        own = rig.scene.calibration.method
        if wanted is None or wanted == own:
            return rig.calibration
        if wanted == "no camera":
            return bench.once(("no camera", id(rig.calibration)), lambda: _without_depth(rig))
        if isinstance(wanted, str):
            return bench.rig(self.paper, rig.scene.seed, {"calibration.method": wanted}).calibration
        return bench.rig(self.paper).calibration if bench.quick else bench.by_presses(wanted)

    def solved(self, bench: Bench, rig: Rig, found: Found) -> Field:
        """Reconstruct what was tracked."""
        how = self.calibration(bench, rig)
        return reconstruct(found, how, method=self.method, **self.options)

    def film(self, rig: Rig, load: Load, exposure: int) -> Found:
        """Expose the markers under a load, and track them; the error of their motion is not
        noted."""
        move = rig.half_space_motion if self.half_space else rig.sensor.motion
        return rig.track(rig.picture(move(load), exposure), self.tracker)

    def shot(self, bench: Bench, press: Press, trial: Trial = ONCE, exposure: int = 1) -> Shot:
        """Press, film, track and solve; what is tracked is kept."""
        rig = self.rig(bench, trial)
        state = rig.press(press)
        rig.motion(state.load)  # kept; its error is noted for this entry too
        number = exposure + trial.exposures
        key = ("shot", id(rig), id(state), number, self.tracker, self.half_space)
        found = bench.once(key, lambda: self.film(rig, state.load, number))
        return Shot(rig=rig, state=state, found=found, field=self.solved(bench, rig, found))

    def narrow(
        self,
        bench: Bench,
        at_mm: tuple[float, ...],
        force_n: float,
        exposure: int,
        trial: Trial = ONCE,
    ) -> Field:
        """Push narrow forces at places along x and return the reconstructed field."""
        rig = self.rig(bench, trial)

        def work() -> Motion:
            spots = [Traction.disk((x, 0.0), SPOT_MM, (0.0, 0.0, force_n)) for x in at_mm]
            return rig.motion(sum(spots[1:], start=spots[0]))

        motion = bench.once(("narrow", id(rig), at_mm, force_n), work)
        found = rig.track(rig.picture(motion, exposure + trial.exposures), self.tracker)
        return self.solved(bench, rig, found)


def _without_depth(rig: Rig) -> Calibration:
    """Return the half-space calibration whose camera doesn't see motion along z (Kamiyama, before
    2.5)."""
    from twin.sense.calibration import from_compliance

    scene = rig.scene
    points = rig.sensor.nominal_markers.points
    flat = _image_scale(scene, points) * (1.0, 1.0, 0.0)
    compliance = half_space_compliance(scene, points, rig.sensor.sites)
    return replace(rig.calibration, transfer=from_compliance(compliance, flat))


def sphere_press(place_mm: tuple[float, float], gram_force: float) -> Press:
    """Return a press of the 3 mm sphere along z at a place (x, y) above the surface, sticking."""
    force = (None, None, gram_force * GF)
    return Press(probe=Sphere(diameter_mm=3), at_mm=place_mm, force_n=force, friction=np.inf)


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """One paper's test: displacement along x, px; which exposure is displaced digitally, 0 being
    the rest picture itself; (average, standard deviation) by layer and axis, px."""

    sensor: str
    shift_px: int
    exposure: int
    paper: Mapping[tuple[str, str], tuple[float, float]]

    def tracked(self, bench: Bench, way: Way, chain: Chain, trial: Trial = ONCE) -> Found:
        """Shift the markers and track them, once for all entries."""
        rig = chain.rig(bench, trial)

        def work() -> Found:
            if way == "re-rendered":
                picture = rig.picture(rig.shifted((self.shift_px, 0.0)), 8)
            else:  # moved to the right by whole pixels; the left edge is drawn out
                kept = rig.picture(None, self.exposure)[:, : -self.shift_px]
                picture = np.pad(kept, ((0, 0), (self.shift_px, 0), (0, 0)), mode="edge")
            return rig.track(picture, chain.tracker)

        key = ("shifted", id(rig), way, self.exposure, chain.tracker)
        return bench.once(key, work)

    @staticmethod
    def samples(found: Found, layer: str) -> Floats:
        """Return (m, 2) the shifts of a layer's tracked markers, px, x to the right and y up."""
        shift = found.shift_px[found.layer == layer]
        return np.asarray(shift[np.isfinite(shift).all(axis=1)] * (1, -1))


KAMIYAMA = Protocol(
    sensor="kamiyama",
    shift_px=3,
    exposure=0,
    paper={
        ("blue", "x"): (3.09, 0.19),
        ("blue", "y"): (0.05, 0.22),
        ("red", "x"): (3.02, 0.25),
        ("red", "y"): (0.06, 0.19),
    },
)
SATO = Protocol(
    sensor="sato",
    shift_px=5,
    exposure=7,
    paper={
        ("red", "x"): (4.87, 0.14),
        ("red", "y"): (0.03, 0.14),
        ("blue", "x"): (4.95, 0.13),
        ("blue", "y"): (0.00, 0.10),
    },
)


@dataclass(frozen=True, kw_only=True)
class ForceLine:
    """Readings against applied forces, gf, and the straight line through them."""

    applied_gf: Floats
    measured_gf: Floats

    @property
    def fit(self) -> Floats:
        """(2,) slope and offset of the least-squares line."""
        return np.polyfit(self.applied_gf, self.measured_gf, 1)

    @property
    def squares(self) -> float:
        """Sum of the squared differences from the line, gf^2."""
        return float(((self.measured_gf - np.polyval(self.fit, self.applied_gf)) ** 2).sum())

    @property
    def resolution_gf(self) -> float:
        """Smallest difference of applied force that two single readings resolve at 95 %."""
        deviation = np.sqrt(self.squares / (len(self.applied_gf) - 2))
        return float(RESOLVED * deviation / abs(self.fit[0]))

    @property
    def widest_gf(self) -> float:
        """Largest difference of a reading from the applied force."""
        return float(np.abs(self.measured_gf - self.applied_gf).max())

    @classmethod
    def of(
        cls,
        bench: Bench,
        chain: Chain,
        axis: int,
        steps: int,
        repeats: int,
        first: int = FIRST_EXPOSURE,
        aside_mm: float = 0.0,
    ) -> ForceLine:
        """Take the 10 mm cylinder's path through pictures and the inverse, ``repeats`` times, each
        with noise of its own: 200 gf down and then sideways, or down in steps; it sticks. The first
        repeat is at the apex, the others ``aside_mm`` from it, each to another side."""
        levels = [PRELOAD_GF * (k + 1) / steps * GF for k in range(steps)]
        down = PRELOAD_GF * GF
        if axis == 2:
            path = [Step(force_n=(None, None, level)) for level in levels]
        else:
            path = [Step(force_n=(None, None, down))]
            for level in levels:
                x, y = (level if k == axis else None for k in range(2))
                path.append(Step(force_n=(x, y, down)))
        rig = chain.rig(bench)
        sides = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
        places = [(x * aside_mm, y * aside_mm) for x, y in sides]
        press = Press(probe=Cylinder(diameter_mm=10), friction=np.inf, steps=tuple(path))
        pressed = {
            place: rig.press(press.model_copy(update={"at_mm": place})).path[-steps:]
            for place in dict.fromkeys(places[:repeats])
        }
        applied, measured = [], []
        for repeat in range(repeats):
            for number, state in enumerate(pressed[places[repeat % len(places)]]):
                exposure = first + 1000 * axis + 100 * repeat + number
                rig.motion(state.load)  # kept; its error is noted
                field = chain.solved(bench, rig, chain.film(rig, state.load, exposure))
                noise = Purpose.LOAD_CELL.stream(rig.scene.seed, exposure).standard_normal()
                cell = rig.scene.calibration.load_cell_n * noise
                applied.append((state.force_n[axis] + cell) / GF)
                measured.append(field.total_force_n[axis] / GF)
        return cls(applied_gf=np.array(applied), measured_gf=np.array(measured))
