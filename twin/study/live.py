"""`twin run --live`: a scene's probe, moved by hand in a page, with what the sensor sees and feels as it moves.

A question holds where the probe is and how it is loaded; the answer is a short table in JSON and the CCD picture, both
as they are. Every question is a press of its own from first touch, in one step (`twin.study.environment`).
"""

from __future__ import annotations

import json
import math
import struct
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, InputError, RecipeError, TwinError
from twin.parts.press import Press, Step
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.study.environment import Environment, Observation

QUICK = (
    "accuracy.contact_patches=8", "accuracy.contact_increments=4", "accuracy.centroid_px=0.05",
    "accuracy.surface_table=true",
)  # fmt: skip
"""What a live scene is overridden with before anything the user asks for: marker displacements change by up to
0.8 % of the largest (measured against 16 patches in 8 parts), centroids by up to 0.03 px, for a third of the time on a
block; on a curved body for a twentieth, after half a minute or so for the table of its surface, which is kept."""

FRICTIONS = (0.0, 0.3, 0.6, 1.2, math.inf)

FRICTION = 1.2
"""Where the scene's press has none: what Sato's shear presses need."""


@dataclass(frozen=True, kw_only=True)
class Hand:
    """Where the probe is and how it is loaded.

    Attributes
    ----------
    at_mm
        (x, y) of the probe.
    push_n
        Force along z; none lifts the probe.
    side, twist
        (x, y) and about z: forces in N and torque in N mm, or with `by_motion` the probe's motion in mm and degrees
        while it pushes. All count along the axes of the scene's press.
    by_motion
        Held by motion: on a slope a probe that is held by forces alone slides off.
    friction
        0, without which neither side force nor torque is carried, up to inf, which sticks.
    """

    at_mm: tuple[float, float]
    push_n: float
    side: tuple[float, float]
    twist: float
    friction: float
    by_motion: bool

    @classmethod
    def of(cls, question: Mapping[str, Any], *, by_motion: bool) -> Hand:
        """Read a question.

        Raises
        ------
        InputError
            A number is missing, not a number, or out of range.
        """
        friction = math.inf if question.get("friction") == "inf" else _number(question, "friction", 100, "")
        if friction < 0:
            raise InputError(f"friction = {friction:g}: allowed are 0 to 100, or 'inf' for sticking")
        most, unit = (10, "mm") if by_motion else (1e3, "N")
        turn, turn_unit = (45, "degrees") if by_motion else (1e4, "N mm")
        return cls(
            at_mm=(_number(question, "x_mm", 1e3, "mm"), _number(question, "y_mm", 1e3, "mm")),
            push_n=_number(question, "push_n", 1e3, "N"),
            side=(_number(question, "side_x", most, unit), _number(question, "side_y", most, unit)),
            twist=_number(question, "twist", turn, turn_unit),
            friction=friction,
            by_motion=by_motion,
        )

    def told(self) -> dict[str, Any]:
        """Return it as a question."""
        return {
            "x_mm": self.at_mm[0], "y_mm": self.at_mm[1], "push_n": self.push_n, "side_x": self.side[0],
            "side_y": self.side[1], "twist": self.twist,
            "friction": "inf" if math.isinf(self.friction) else self.friction,
        }  # fmt: skip

    def step(self) -> Step:
        """Return the path's one step; without friction nothing but the push."""
        (x, y), push = self.side, self.push_n
        if self.friction == 0.0:
            return Step(force_n=(None, None, push))
        if self.by_motion:
            return Step(force_n=(None, None, push), move_mm=(x, y, None), turn_deg=self.twist)
        return Step(force_n=(x, y, push), torque_nmm=self.twist or None)

    def press(self, scene: Press) -> Press | None:
        """Return the press: the scene's probe and direction, our place and load; None where nothing pushes."""
        if self.push_n <= 0.0:
            return None
        return Press(
            probe=scene.probe, at_mm=self.at_mm, direction=scene.direction, tilt_deg=scene.tilt_deg,
            axes="global" if scene.direction is None else "probe", friction=self.friction, steps=(self.step(),),
        )  # fmt: skip


def _number(table: Mapping[str, Any], key: str, most: float, unit: str) -> float:
    value = table.get(key, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise InputError(f"{key} = {value!r}: allowed are numbers from {-most:g} to {most:g} {unit}".rstrip())
    return float(value)


class LivePress:
    """A scene under a hand.

    Parameters
    ----------
    scene
        With camera, reconstruction and a press, whose probe is moved.
    progress
        Told about work that takes longer.

    Raises
    ------
    RecipeError
        The scene lacks one of them.
    """

    def __init__(self, scene: Scene, progress: Progress | None = None) -> None:
        self.environment = Environment(scene, progress)
        if scene.press is None:
            raise RecipeError("this scene has no [press] table: --live moves the scene's probe, so give it one")
        self.scene, self.moved = scene, scene.press
        self.rest = self.environment.reset()

    def start(self) -> Hand:
        """Return where the hand begins: the scene's place, push and friction; `FRICTION` where it has none."""
        x, y = self.moved.at_mm[:2]
        return Hand(
            at_mm=(x, y), push_n=self.moved.path[0].force_n[2] or 1.0, side=(0.0, 0.0), twist=0.0,
            friction=self.moved.friction or FRICTION, by_motion=not self.scene.body.is_flat,
        )  # fmt: skip

    def facts(self) -> dict[str, Any]:
        """Return what the page must know once: grid of sites, markers at rest, ranges of the sliders."""
        scene, begin = self.scene, self.start()
        assert scene.reconstruction is not None
        assert scene.camera is not None
        grid, push = scene.reconstruction.sites, begin.push_n
        half = np.array(grid.half_mm) + grid.pitch_mm / 2
        side, twist = (0.3, 5.0) if begin.by_motion else (_round(push), _round(push))
        sensor = self.environment.sensor
        return {
            "title": scene.title or "Tactile sensor",
            "width": scene.camera.width_px, "height": scene.camera.height_px,
            "columns": grid.columns, "rows": grid.rows, "pitch": grid.pitch_mm,
            "site": np.round(grid.chart(), 4).tolist(),
            "marker": np.round(sensor.project(sensor.actual.markers.points), 2).tolist(),
            "layer": [list(scene.markers).index(str(name)) for name in sensor.actual.markers.layer],
            "layers": list(scene.markers),
            "probe": self.moved.probe.kind,
            "start": begin.told(),
            "side": ["move", "mm", "turn", "°"] if begin.by_motion else ["force", "N", "twist", "N mm"],
            "range": {
                "x_mm": [-half[0], half[0]], "y_mm": [-half[1], half[1]], "push_n": [0.0, _round(2 * push)],
                "side_x": [-side, side], "side_y": [-side, side], "twist": [-twist, twist],
            },
            "friction": ["inf" if math.isinf(mu) else mu for mu in sorted({*FRICTIONS, begin.friction})],
            "note": "The first of the scene's probes is moved alone." if self.moved.also else "",
        }  # fmt: skip

    def answer(self, question: Mapping[str, Any]) -> bytes:
        """Return what the sensor sees and feels: the table's length (4 bytes, little-endian), the table, the picture.

        Raises
        ------
        InputError
            The question is not one, or the probe misses the body.
        ContactError
            There is no equilibrium.
        """
        hand = Hand.of(question, by_motion=not self.scene.body.is_flat)
        started = time.perf_counter()
        try:
            press = hand.press(self.moved)
        except ValueError as problem:  # the scene's probe comes in a way that can't be loaded so
            raise InputError(f"press: {problem}") from None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what they say is in the table
                seen = self.environment.step(press)
        except ContactError as problem:
            raise ContactError(_shorter(problem)) from None
        table = self._table(hand, seen) | {"milliseconds": 1e3 * (time.perf_counter() - started)}
        text = json.dumps(_plain(table), allow_nan=False).encode()
        return struct.pack("<I", len(text)) + text + seen.picture.tobytes()

    def _table(self, hand: Hand, seen: Observation) -> dict[str, Any]:
        truth = seen.truth
        known: Bools = np.asarray(np.isfinite(seen.marker_shift_px).all(axis=1))
        off = (seen.marker_shift_px - truth.marker_shift_px)[known]
        state = truth.state
        contact = None
        if state is not None and len(state.pressure_mpa):
            body, patches = self.environment.sensor.actual.scene.body, self.environment.sensor.rectangles(state.load)
            middle = np.average(patches.centre_mm, axis=0, weights=np.maximum(state.pressure_mpa, 0) + 1e-12)
            contact = {
                "place": body.chart_of(middle[None])[0], "radius_mm": state.contact_radius_mm,
                "indentation_mm": state.indentation_mm, "peak_pressure_mpa": state.peak_pressure_mpa,
                "slip": float(np.mean(state.slip)) if state.friction else None,
                "warnings": state.validity.warnings,
            }  # fmt: skip
        return {
            "hand": hand.told(),
            "shift": np.round(np.where(known[:, None], seen.marker_shift_px, 0.0), 3), "known": known.astype(int),
            "true": np.round(truth.force_n, 6), "found": np.round(seen.force_n, 6),
            "true_total": [*truth.total_force_n, truth.total_torque_nmm[2]],
            "found_total": [*seen.total_force_n, seen.total_torque_nmm[2]],
            "error": seen.error | {
                "displacement": truth.displacement_error,
                "tracking_px": float(np.sqrt(np.mean(off**2))) if len(off) else None,
            },
            "matched": float(known.mean()), "contact": contact,
        }  # fmt: skip


def _round(value: float) -> float:
    """Return the value to one digit, upwards."""
    digit = 10.0 ** math.floor(math.log10(value))
    return math.ceil(value / digit - 1e-9) * digit


def _shorter(problem: TwinError) -> str:
    return str(problem).removeprefix("press: ")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, np.ndarray):
        plain: Floats = value
        return plain.tolist()
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def run_live(scene: Scene, port: int = 0, progress: Progress | None = None) -> None:
    """Serve a scene's live page until Ctrl-C; print its address.

    Raises
    ------
    RecipeError
        The scene has no camera, reconstruction or press.
    InputError
        The port can't be had.
    """
    from twin.show.hand import hand_page
    from twin.study.batch.job import one_thread
    from twin.study.loopback import Loopback, may_listen

    may_listen(port)
    with one_thread():  # the steps' small products lose more than they gain by a second thread
        live = LivePress(scene, progress)
        live.answer(live.start().told())
        page = Loopback(hand_page(live.facts()), live.answer, port)
        if progress is not None:
            progress("done", 1.0)
        print(f"open {page.address}\nCtrl-C ends it", flush=True)
        try:
            page.serve()
        except KeyboardInterrupt:
            print("closed", flush=True)
