"""The bench that every experiment is set up on: the made sensors, their pictures, and what is kept between entries.

An experiment asks for a sensor by its paper and seed. Without overrides that is *the* sensor of the paper, the same in
every table and figure; overrides make a variant, in which one modelled cause is switched off or one design number is
another. Rest pictures, presses and calibrations are kept, so that two entries on one press solve it once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from twin.arrays import Floats, Picture
from twin.parts.load import Load
from twin.parts.part import without_later
from twin.parts.press import Press
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.sense.rest import Method
from twin.study.calibrate import calibration_of
from twin.study.motion import Motion
from twin.study.recipe import load_scene
from twin.study.reproduce.kept import KeptSensor, Mechanics
from twin.theory.optics import projection_jacobian

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration
    from twin.sense.rest import Rest
    from twin.sense.track import Found
    from twin.world.contact.contact import ContactState

T = TypeVar("T")

SCENES = {"kamiyama": "kamiyama_paper", "sato": "sato_paper"}
"""The scene of each paper's sensor."""

OUR_TRACKER: Method = "disc-fit"
"""This project's own tracker: the default of a scene."""

SENSOR_KEYS = ("body", "material", "cover", "markers", "camera", "light", "ccd", "tolerance")
"""What makes the sensor: the rest of a scene is the press and the software."""

DRAWING = ("body", "material", "cover", "markers", "camera", "calibration", "reconstruction")
"""What a calibration from the nominal design depends on."""

TABLE = "accuracy.surface_table"
TABLED = ("sato",)
"""Papers on whose own made sensor loads are read off a table of the surface (`twin.world.elasticity.surface_table`).

Why: 75 calibration presses alone cost twice what the table does, which then serves every other press for next to
nothing. Measured at the 25 points, the errors of H differ by 2 % of themselves from those of presses solved one by one.
The quick form presses so little that it is cheaper without."""

MADE = 3
"""Made sensors, over which a number's spread is told. Where fingers are pressed it is one: its calibration alone is 75
presses, and the spread is of as many runs of exposures and load cell."""

FITTED: dict[str, tuple[str, ...]] = {
    "kamiyama": (
        "ccd.read_noise_e = 112, to the mean of the four standard deviations of Table 1 (0.21 px) when the markers "
        "are moved and filmed again: the noise of the capture unit is in no paper",
    ),
    "sato": ("nothing is fitted: every number is the paper's or an assumption of the scene",),
}
"""What was fitted to each paper, once, and is used everywhere."""


class Rig:
    """One made sensor on the bench, with what was measured on it."""

    def __init__(
        self,
        scene: Scene,
        sensor: KeptSensor,
        drawn: dict[str, Calibration],
        pressed: Callable[[ContactState], None],
        moved: Callable[[Motion], None],
    ) -> None:
        self.scene = scene
        self.sensor = sensor
        self._drawn = drawn
        self._pressed = pressed
        self._moved = moved
        self._rests: dict[tuple[str, int], Rest] = {}

    def press(self, press: Press) -> ContactState:
        """Solve a press, or return it again; what it strains is noted."""
        state = self.sensor.press(press)
        self._pressed(state)
        return state

    def motion(self, state: ContactState) -> Motion:
        """Return how a press moves the markers."""
        return self.moved_by(state.load)

    def moved_by(self, load: Load) -> Motion:
        """Return how a load moves the markers; how far off that may be is noted."""
        motion = self.sensor.motion(load)
        self._moved(motion)
        return motion

    def picture(self, motion: Motion | None, exposure: int) -> Picture:
        """Expose the markers at rest or moved."""
        return self.sensor.picture(motion, exposure)

    def rest(self, method: Method, exposure: int = 0) -> Rest:
        """Analyse a rest picture once."""
        from twin.sense.track import analyse_rest

        key = (method, exposure)
        if key not in self._rests:
            picture = self.picture(None, exposure)
            self._rests[key] = analyse_rest(picture, self.sensor.layout_px, method=method)
        return self._rests[key]

    def track(self, picture: Picture, method: Method | None = None) -> Found:
        """Track the markers from rest to a picture, with the paper's tracker if not told otherwise."""
        from twin.sense.track import track_frame

        return track_frame(self.rest(method or self.scene.tracking.method), picture)

    def seen(self, state: ContactState, exposure: int = 1, method: Method | None = None) -> Found:
        """Take a press through picture and tracker."""
        return self.track(self.picture(self.motion(state), exposure), method)

    @cached_property
    def calibration(self) -> Calibration:
        """The calibration that the scene asks for; one for all sensors of one drawing, if it is made from that."""
        if self.scene.calibration.method == "sato":
            return calibration_of(self.sensor)
        drawing = self.scene.model_dump(mode="json", include=set(DRAWING))
        drawing["reconstruction"] = drawing["reconstruction"]["sites"]
        key = json.dumps(drawing, sort_keys=True)
        if key not in self._drawn:
            self._drawn[key] = calibration_of(self.sensor)
        return self._drawn[key]

    @cached_property
    def image_scale(self) -> Floats:
        """(n, 2, 3) px/mm at the actual markers."""
        made = self.sensor.actual
        camera = made.scene.camera
        assert camera is not None
        scene = made.scene
        return projection_jacobian(made.markers.points, camera, scene.material.refractive_index, scene.body.base_z_mm)

    def shifted(self, shift_px: tuple[float, float]) -> Motion:
        """Return the motion along x and y that moves every marker's centre by ``shift_px`` in the picture."""
        points = self.sensor.actual.markers.points
        wanted = self.sensor.project(points) + np.array(shift_px)
        moved = np.zeros_like(points)
        for _ in range(3):
            missing = wanted - self.sensor.project(points + moved)
            moved[:, :2] += np.linalg.solve(self.image_scale[:, :, :2], missing[:, :, None])[:, :, 0]
        return Motion(displacement_mm=moved, gradient=np.zeros((len(points), 3, 3)), error=0.0)


class Bench:
    """All rigs of a reproduction.

    Parameters
    ----------
    seed
        Root seed; a paper's made sensors have this and the following ones.
    quick
        One made sensor a paper, and less of everything.
    progress
        Told about every piece of work.
    """

    def __init__(self, *, seed: int = 1, quick: bool = False, progress: Progress | None = None) -> None:
        self.seed = seed
        self.quick = quick
        self._told = progress
        self._share = (0.0, 1.0)
        self._entry = ""
        self._rigs: dict[str, Rig] = {}
        self._bodies: dict[str, Mechanics] = {}
        self._drawn: dict[str, Calibration] = {}
        self.kept: dict[Any, Any] = {}
        self.used: set[str] = set()
        self._worst: ContactState | None = None
        self._least_exact = 0.0

    def begin(self, entry: str, share: float, width: float) -> None:
        """Say which entry runs, and which part of the whole it is."""
        self._entry, self._share = entry, (share, width)
        self.used.clear()
        self._worst, self._least_exact = None, 0.0
        self.progress("", 0.0)

    @property
    def validity(self) -> str:
        """What the mesh, and linear theory in the hardest press, cost in the present entry; empty without a load."""
        mesh = (
            f"Marker motion is up to {100 * self._least_exact:.2g} % of its largest off, by the mesh's own estimate. "
            if self._least_exact
            else ""
        )
        if self._worst is None:
            return mesh.strip()
        doubt = self._worst.validity
        ratio = doubt.contact_over_probe_radius
        radius = f"contact radius / probe radius {ratio:.2f}, " if ratio is not None else ""
        return (
            f"{mesh}Hardest press: {radius}mean pressure / Young's modulus {doubt.mean_strain:.2g}; linear theory "
            f"may be up to {100 * doubt.linearisation_error:.2g} % of the largest displacement off."
        )

    def _pressed(self, state: ContactState) -> None:
        if self._worst is None or state.validity.linearisation_error > self._worst.validity.linearisation_error:
            self._worst = state

    def _moved(self, motion: Motion) -> None:
        self._least_exact = max(self._least_exact, motion.error)

    def progress(self, what: str, share: float) -> None:
        """Tell how far the present entry is."""
        if self._told is not None:
            start, width = self._share
            self._told(f"{self._entry} {what}".strip(), min(0.999, start + width * min(share, 1.0)))

    def seeds(self, paper: str, *, pressed: bool = True) -> tuple[int, ...]:
        """Return the seeds of the made sensors; ``pressed`` says whether a probe touches them."""
        count = 1 if self.quick or (paper == "sato" and pressed) else MADE
        return tuple(self.seed + k for k in range(count))

    def rig(self, paper: str, seed: int | None = None, overrides: Mapping[str, Any] | None = None) -> Rig:
        """Return a made sensor: the paper's own, or a variant of it."""
        given = {"seed": self.seed if seed is None else seed, **(overrides or {})}
        if self._tabled(paper, given):
            given[TABLE] = True
        scene = load_scene(SCENES[paper], given)
        if _hash(scene) == sensor_hash(paper):
            self.used.add(paper)
        key = json.dumps([paper, given], sort_keys=True, default=str)
        if key not in self._rigs:
            sensor = KeptSensor(scene, self._bodies, lambda what, _share: self.progress(what, 0.0))
            self._rigs[key] = Rig(scene, sensor, self._drawn, self._pressed, self._moved)
        return self._rigs[key]

    def _tabled(self, paper: str, given: Mapping[str, Any]) -> bool:
        """Return whether loads on this sensor are products with a table of its body, which all entries share."""
        return paper in TABLED and not self.quick and given["seed"] == self.seed and not any(
            key.split(".")[0] in ("tolerance", "body", "material") for key in given
        )  # fmt: skip

    def once(self, key: Any, work: Callable[[], T]) -> T:
        """Return ``work()``, done at the first call with this key."""
        if key not in self.kept:
            self.kept[key] = work()
        found: T = self.kept[key]
        return found


@cache
def sensor_hash(paper: str) -> str:
    """Return the hash of a paper's resolved sensor: what is built, without press, software and seed."""
    return _hash(load_scene(SCENES[paper]))


def _hash(scene: Scene) -> str:
    table = scene.model_dump(mode="json", include=set(SENSOR_KEYS))
    return hashlib.sha256(json.dumps(_bare(table), sort_keys=True).encode()).hexdigest()


def _bare(value: Any) -> Any:
    """Drop sources and assumptions: they say where a number comes from, not what is built."""
    if isinstance(value, dict):
        return {k: _bare(v) for k, v in without_later(value).items() if k not in {"source", "assumed"}}
    return [_bare(v) for v in value] if isinstance(value, list) else value
