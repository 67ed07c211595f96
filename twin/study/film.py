"""Films of a press: what the camera sees along its path.

`write_film` makes one animated picture for people. `film_to_folder` films at the camera's frame
rate while the press's steps take their seconds: pictures, and the truth of each in ``truth.npz``.
`Exposures` makes a picture while markers move: the mean of the light over the exposure, between
solved states along straight lines in time.
"""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, Picture, Pixels, Progress, Singles, eight_bits
from twin.blas_threads import one_blas_thread
from twin.errors import ContactError, InputError, RecipeError, SomeFailed
from twin.files import make_folder, png_bytes, read_arrays, write_whole
from twin.parts.load import Load
from twin.parts.press import Press, Step, Triple
from twin.parts.scene import Scene
from twin.study.sensor import Motion, Sensor

if TYPE_CHECKING:
    from twin.world.contact.contact_state import ContactState

PARTS = 8
"""Frames of a step of an animated picture."""

_FRAME_MS, _LAST_MS = 120, 1200
FILMS = {".gif": "GIF", ".png": "PNG", ".mp4": "H.264"}
"""GIF; animated PNG, which keeps every colour; or a video, which takes a tenth of the space."""

_SAME_S = 1e-9
"""Times are the same within this."""

MOST_FRAMES = 100_000

_WRITE_EVERY = 20.0
"""Truth is written again after this many times as long as writing it took."""

_KEPT = 8
"""States whose motion is kept."""


def _in_parts(press: Press, ends: Sequence[Sequence[float]]) -> Press:
    """Return the press with every step of its path, and of further probes', in parts. Forces and
    torques grow from those of the step before, motions, turns and seconds are shared out; what was
    held by motion before takes its force at once. A probe that is lifted by a force of 0 leaves at
    the end of the step. An oblique press without steps is left as it is. ``ends`` are for each step
    the shares of it, rising to 1, at which its parts end."""
    if press.direction is not None and not press.steps:
        return press
    before = Step(force_n=(0.0, 0.0, 0.0), torque_nmm=(0.0, 0.0, 0.0))
    steps = []
    for (last, step), shares in zip(pairwise((before, *press.path)), ends, strict=True):
        for begin, end in pairwise((0.0, *shares)):
            steps.append(
                Step(
                    force_n=_grown(last.force_n, step.force_n, end),
                    torque_nmm=_grown(last.torques_nmm, step.torques_nmm, end),
                    move_mm=_shared(step.move_mm, end - begin),
                    turn_deg=_shared(step.turns_deg, end - begin),
                    seconds=step.seconds * (end - begin),
                )
            )
    also = tuple(_in_parts(other, ends) for other in press.also)
    changes = {"steps": tuple(steps), "force_n": None, "indentation_mm": None, "also": also}
    return Press.model_validate(press.model_copy(update=changes).model_dump())


def _grown(last: Triple, now: Triple, share: float) -> Triple:
    x, y, z = (
        b if a is None or b is None else a + share * (b - a) for a, b in zip(last, now, strict=True)
    )
    return x, y, z


def _shared(now: Triple, share: float) -> Triple:
    x, y, z = (None if value is None else value * share for value in now)
    return x, y, z


def at_frames(press: Press, frames_per_second: float) -> tuple[Press, Floats]:
    """Return a press whose parts end at the frames' times, and when each part ends, s.

    Raises
    ------
    RecipeError
        The press takes no time, too many frames, or a step is held by force after one by motion:
        the force that it starts from is known only when it is solved.
    """
    ends_s = [0.0, *accumulate(step.seconds for step in press.path)]
    frames = np.arange(int(ends_s[-1] * frames_per_second + _SAME_S) + 1) / frames_per_second
    if not 1 < len(frames) <= MOST_FRAMES:
        raise RecipeError(
            f"press.steps: seconds sum to {ends_s[-1]:g}, which at {frames_per_second:g} frames a "
            f"second makes {len(frames)} pictures; 2 to {MOST_FRAMES:,} are filmed: give steps "
            "their time, as in press.steps = [{force_n = {z = 0.2}, seconds = 0.5}]"
        )
    for one in (press, *press.also):
        for number, (last, step) in enumerate(pairwise(one.path), start=2):
            forced = np.array(step.by_force) & ~np.array(last.by_force)
            if press.path[number - 1].seconds and forced.any():
                raise RecipeError(
                    f"press.steps: step {number} is held by force in a direction in which the one "
                    "before is held by motion, so that the forces between are not known; hold "
                    "both by force, or both by motion"
                )
    times = [
        [*frames[(frames > begin + _SAME_S) & (frames < end - _SAME_S)], end]
        for begin, end in pairwise(ends_s)
    ]
    shares = [
        [(time - begin) / (end - begin) if end > begin else 1.0 for time in inner]
        for inner, (begin, end) in zip(times, pairwise(ends_s), strict=True)
    ]
    return _in_parts(press, shares), np.concatenate(times)


class Exposures:
    """Pictures of a sensor whose markers move along straight lines between solved states.

    Parameters
    ----------
    sensor
        The sensor; its CCD has ``frames_per_second``.
    time_s
        (m,) times of the states; the markers are at rest at 0 before them.
    motion
        Returns the motion of the state of a number.
    """

    def __init__(self, sensor: Sensor, time_s: Floats, motion: Callable[[int], Motion]) -> None:
        self.sensor = sensor
        self.time_s: Floats = np.concatenate([[0.0], time_s])
        self._motion = motion
        self._known: dict[int, tuple[Motion, Pixels]] = {}

    def _state(self, number: int) -> tuple[Motion, Pixels]:
        """Return motion and places, px, of the markers in a state; number 0 is rest."""
        if number not in self._known:
            if len(self._known) >= _KEPT:
                self._known.pop(min(self._known))
            motion = self._motion(number - 1) if number else self.sensor.quick_motion(Load())
            places = self.sensor.actual.markers.points + motion.displacement_mm
            self._known[number] = motion, self.sensor.project(places)
        return self._known[number]

    def state_at(self, time_s: float) -> int:
        """Return the number of the last state that is not after a time."""
        return max(int(np.searchsorted(self.time_s, time_s + _SAME_S, side="right")) - 1, 0)

    def motion(self, time_s: float) -> Motion:
        """Return the motion at a time."""
        number = self.state_at(time_s)
        first, _ = self._state(number)
        if number + 1 == len(self.time_s) or time_s <= self.time_s[number] + _SAME_S:
            return first
        second, _ = self._state(number + 1)
        begin, end = self.time_s[number : number + 2]
        share = (time_s - begin) / (end - begin)
        cover = first.cover or second.cover
        if first.cover is not None and second.cover is not None:
            cover = first.cover.between(second.cover, share)
        return Motion(
            displacement_mm=(1 - share) * first.displacement_mm + share * second.displacement_mm,
            gradient=(1 - share) * first.gradient + share * second.gradient,
            error=max(first.error, second.error),
            cover=cover,
        )

    def speed_px_s(self, time_s: float, within_s: float) -> float:
        """Return the speed of the fastest marker at most so long before or after a time."""
        numbers = range(self.state_at(time_s - within_s), self.state_at(time_s + within_s) + 1)
        fastest = 0.0
        for number in numbers:
            if number + 1 < len(self.time_s) and self.time_s[number + 1] > self.time_s[number]:
                moved = np.hypot(*(self._state(number + 1)[1] - self._state(number)[1]).T)
                took = self.time_s[number + 1] - self.time_s[number]
                fastest = max(fastest, float(np.nanmax(moved, initial=0.0) / took))
        return fastest

    def light(self, time_s: float, frame: int = 0) -> Singles:
        """Return the (height, width, 3) light of an exposure whose middle is at a time."""
        from twin.world.picture.ccd import shutter

        sensor = self.sensor
        ccd = sensor.nominal.ccd.spelt_out()
        camera, _ = sensor.nominal.imaging
        speed = self.speed_px_s(time_s, (ccd.exposure_ms + ccd.readout_ms) / 2000)
        offset_s, weights = shutter(ccd, camera.height_px, speed)
        renderer = sensor.renderer_of(frame)
        light: Singles = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
        for offset, weight in zip(offset_s, weights.T, strict=True):
            motion = self.motion(time_s + offset)
            one = renderer.radiance(sensor.ellipsoids(motion), motion.cover)
            light += weight[:, None, None] * one
        return light

    @one_blas_thread()
    def picture(self, time_s: float, exposure: int, frame: int = 0) -> Picture:
        """Return the CCD picture of an exposure whose middle is at a time; ``exposure`` is the
        number of its noise, ``frame`` that by which `Light.lit` says which LEDs shine."""
        ccd = self.sensor.nominal.ccd.spelt_out()
        half_s = 0.5 / ccd.frames_per_second
        before = self.light(time_s - half_s, frame) if ccd.interlace else None
        return self.sensor.exposed(self.light(time_s, frame), exposure, before)


def _refuse_filmless(scene: Scene) -> None:
    for table, there in (("camera", scene.camera), ("press", scene.press)):
        if there is None:
            raise RecipeError(
                f"this scene has no [{table}] table, so there is no film of its press"
            )


def write_film(sensor: Sensor, out: Path) -> str:
    """Write a scene's film, eight frames a step, as one file of `FILMS`; return a line about it.

    Raises
    ------
    InputError
        The file's name has another ending.
    MissingCapability
        A video, and the extra package is not installed.
    RecipeError
        The scene has no camera or no press.
    ContactError
        The path can't be taken to its end.
    """
    from PIL import Image

    from twin.study.frames import VideoWriter

    kind = FILMS.get(out.suffix.lower())
    if kind is None:
        raise InputError(f"--out {out}: a film ends in {', '.join(FILMS)}")
    if kind == "H.264":
        VideoWriter.require()
    scene = sensor.nominal
    _refuse_filmless(scene)
    assert scene.press is not None
    progress = sensor.progress or _silent
    progress("contact", 0.1)
    shares = [(part + 1) / PARTS for part in range(PARTS)]
    state = sensor.press(_in_parts(scene.press, [shares] * len(scene.press.path)))
    if not state.complete:
        raise ContactError(f"press: {state.reason}")
    pictures = [sensor.picture(None)]
    for number, one in enumerate(state.path, start=1):
        progress("pictures", 0.3 + 0.7 * number / len(state.path))
        pictures.append(sensor.picture(sensor.motion(one.load), number, number))
    if kind == "H.264":
        height, width, _ = pictures[0].shape
        with VideoWriter(out, (width, height), 1000 / _FRAME_MS) as video:
            for picture in [*pictures, *[pictures[-1]] * (_LAST_MS // _FRAME_MS - 1)]:
                video.add(picture)
    else:
        frames = [Image.fromarray(eight_bits(picture)) for picture in pictures]
        times = [_FRAME_MS] * (len(frames) - 1) + [_LAST_MS]
        file = io.BytesIO()
        frames[0].save(file, kind, save_all=True, append_images=frames[1:], duration=times, loop=0)
        write_whole(out, file.getvalue())
    return f"written to {out}: {len(pictures)} pictures"


def _silent(_: str, __: float) -> None:
    """Show no progress."""


def film_to_folder(
    scene: Scene, folder: Path, progress: Progress | None = None, *, h264: bool = False
) -> str:
    """Film a scene's press; return a few lines about it.

    `twin.commands.run` lists the files; of the truth see `_truth`. After an interrupt, or a kill,
    the same call solves the press again, keeps the frames whose truth is there (`_kept`), and ends
    with the same bytes. With ``h264`` all are encoded at the end, and the rest picture, too: halved
    colours move coloured markers by .2 px.

    Raises
    ------
    MissingCapability
        A video, and the extra package is not installed.
    RecipeError
        The scene has no camera, no press, no ``ccd.frames_per_second``, or see `at_frames`.
    InputError
        The folder has files that no film has written.
    SomeFailed
        The press has no equilibrium in some step: what is before it is filmed.
    """
    film = _Filming(scene, folder, progress or _silent, h264)
    film.press()
    film.prepare_folder()
    film.take_pictures()
    if h264:
        film.encode()
    return film.summary()


class _Filming:
    """The stages of `film_to_folder`, in the order in which they are called.

    Attributes
    ----------
    pictures, video
        Where the frames, and the encoded film, lie.
    rows
        The truth of the frames that were taken.
    count
        Number of frames.
    """

    def __init__(self, scene: Scene, folder: Path, progress: Progress, h264: bool) -> None:
        """Refuse what can't be filmed."""
        from twin.study.frames import VideoWriter

        if h264:
            VideoWriter.require()
        _refuse_filmless(scene)
        rate = scene.ccd.frames_per_second
        if rate is None:
            raise RecipeError("ccd.frames_per_second: a film needs it; give, for example, 30")
        self.scene, self.folder, self.progress, self.h264 = scene, folder, progress, h264
        self.rate = rate
        self.pictures = folder / "frames"
        self.video = folder / "frames.mp4"
        names = ("rest.png", "rest", "scene.toml", "truth.npz")
        known = [name for name in names if (folder / name).exists()]
        if known and not self.pictures.is_dir() and not self.video.is_file():
            raise InputError(
                f"--out {folder}: holds {', '.join(known)}, which no film wrote; give another "
                "folder"
            )

    def press(self) -> None:
        """Solve the press at every frame's time, once the folder is there."""
        assert self.scene.press is not None
        press, ends_s = at_frames(self.scene.press, self.rate)
        make_folder(self.folder)
        make_folder(self.pictures)
        self.sensor = sensor = Sensor(self.scene, self.progress)
        self.progress("contact", 0.02)
        self.state = sensor.press(press)
        self.states = states = self.state.path
        sensor.keep_markers()  # digits must not follow from how many frames are there
        self.exposures = Exposures(
            sensor, ends_s[: len(states)], lambda number: sensor.quick_motion(states[number].load)
        )
        self.count = int(self.exposures.time_s[-1] * self.rate + _SAME_S) + 1

    def prepare_folder(self) -> None:
        """Keep what an interrupted film left, remove the rest of an older one, and write the scene
        and its rest pictures."""
        from twin.study.frames import VideoWriter

        folder, groups = self.folder, self.scene.imaging[1].lit
        rests = folder / "rest"
        self.rows = _kept(folder, self.scene, self._row_of)[: self.count]
        numbered = sorted(self.pictures.glob("[0-9]" * 6 + ".png"))
        stale = [] if self.rows else [folder / "truth.npz"]
        rest_files = (folder / "rest.png", *rests.glob("*.png"))
        for old in (*stale, self.video, *numbered[len(self.rows) :], *rest_files):
            old.unlink(missing_ok=True)
        write_whole(folder / "scene.toml", self.scene.to_toml().encode())
        if groups:
            make_folder(rests)
        for number, rest in enumerate(self.sensor.rest_pictures):
            if self.h264:
                rest = VideoWriter.encoded(rest, self.video)
            name = rests / f"{number:06d}.png" if groups else folder / "rest.png"
            write_whole(name, png_bytes(rest))

    def take_pictures(self) -> None:
        """Take the pictures that are missing. A killed film keeps its truth up to the last write,
        which takes a twentieth of the time."""
        written = time.monotonic()
        took = 0.0
        try:
            for number in range(len(self.rows), self.count):
                done = 0.1 + 0.89 * number / self.count
                self.progress(f"picture {number + 1} of {self.count}", done)
                picture = self.exposures.picture(number / self.rate, number + 1, number)
                write_whole(self._frame(number), png_bytes(picture))
                self.rows.append(self._row_of(number))
                if (begun := time.monotonic()) - written > _WRITE_EVERY * took:
                    self._write_truth()
                    written = time.monotonic()
                    took = written - begun
        finally:
            if self.rows:
                self._write_truth()

    def encode(self) -> None:
        """Make a video of the pictures, which go."""
        from twin.study.frames import VideoWriter, read_picture

        camera = self.scene.camera
        assert camera is not None
        size_px = (camera.width_px, camera.height_px)
        with VideoWriter(self.video, size_px, self.rate) as video:
            for number in range(self.count):
                video.add(read_picture(self._frame(number)))
        shutil.rmtree(self.pictures)

    def summary(self) -> str:
        """Return a few lines; raise `SomeFailed` where the press ended early."""
        self.progress("done", 1.0)
        if not self.state.complete:
            raise SomeFailed(
                f"press: {self.state.reason}; the {self.count} pictures before are in {self.folder}"
            )
        truth, seconds = self.truth, self.rows[-1]["time_s"]
        off, beyond = (
            100 * np.max(truth[f"{of}_error"]) for of in ("displacement", "linearisation")
        )
        largest = np.nanmax(np.linalg.norm(truth["marker_px"] - truth["marker_rest_px"], axis=2))
        return "\n".join(
            [
                f"film        {self.count} pictures in {seconds:.3g} s, {self.rate:g} a second; "
                f"markers move up to {largest:.3g} px",
                f"truth       displacements {off:.1g} % of the largest off; linear theory "
                f"{beyond:.1g} %",
                f"written to  {self.video if self.h264 else self.pictures}, with the truth in "
                f"{self.folder / 'truth.npz'}",
            ]
        )

    def _frame(self, number: int) -> Path:
        return self.pictures / f"{number:06d}.png"

    def _row_of(self, number: int) -> dict[str, Any]:
        """Return the truth of a frame."""
        time_s = number / self.rate
        at = self.exposures.state_at(time_s)
        row = _row(self.sensor, self.exposures.motion(time_s), self.states[at - 1] if at else None)
        groups = self.scene.imaging[1].lit
        return row | {"time_s": time_s} | ({"lit": number % len(groups)} if groups else {})

    def _write_truth(self) -> None:
        self.truth = _truth(self.sensor, self.rows)
        write_whole(self.folder / "truth.npz", lambda file: np.savez_compressed(file, **self.truth))


def _row(sensor: Sensor, motion: Motion, state: ContactState | None) -> dict[str, Any]:
    """Return the truth of one frame; None for a state is rest."""
    nothing = np.zeros(3)
    outlines = sensor.renderer.outlines(sensor.ellipsoids(motion))
    row: dict[str, Any] = {
        "marker_displacement_mm": motion.displacement_mm,
        "marker_px": sensor.project(sensor.actual.markers.points + motion.displacement_mm),
        "marker_outline_px": outlines.centroid_px,
        "marker_visible": outlines.visible,
        "displacement_error": motion.error_of(state),
        "probe_move_mm": nothing if state is None else state.move_mm,
        "linearisation_error": 0.0 if state is None else state.validity.linearisation_error,
    }
    for name in ("indentation_mm", "area_mm2", "dissipated_nmm"):
        row[name] = 0.0 if state is None else getattr(state, name)
    patches = sensor.rectangles(Load() if state is None else state.load)
    return row | {
        "force_n": patches.total_force_n,
        "torque_nmm": patches.total_torque_nmm,
        "slip_share": 0.0 if state is None else state.slip_share,
        "patch_mm": patches.centre_mm,
        "patch_force_n": patches.force_n,
        "patch_slip": np.zeros(0, bool) if state is None else state.slips,
    }


def _kept(
    folder: Path, scene: Scene, row_of: Callable[[int], dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the truth of the frames that an interrupted film of the scene left: none unless the
    last row is what this program finds for that frame."""
    try:
        if (folder / "scene.toml").read_bytes() != scene.to_toml().encode():
            return []
        truth = read_arrays(folder / "truth.npz")
        count = len(truth["time_s"])
        last = row_of(count - 1)
        ends = np.searchsorted(truth["patch_frame"], np.arange(1, count))
        columns = [
            np.split(truth[name], ends) if name.startswith("patch") else truth[name]
            for name in last
        ]
        rows = [dict(zip(last, row, strict=True)) for row in zip(*columns, strict=True)]
        if not all(np.array_equal(value, rows[-1][name]) for name, value in last.items()):
            return []
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return []
    there = [(folder / "frames" / f"{number:06d}.png").is_file() for number in range(count)]
    return rows[: [*there, False].index(False)]


def _truth(sensor: Sensor, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the arrays of ``truth.npz``: a row a frame, but the patches of all frames one after
    the other, with their frames in ``patch_frame``."""
    markers = sensor.actual.markers
    truth: dict[str, Any] = {
        "marker_rest_mm": markers.points,
        "marker_rest_px": sensor.project(markers.points),
        "marker_outline_rest_px": sensor.renderer.outlines(sensor.ellipsoids(None)).centroid_px,
        "marker_layer": markers.layer,
        "patch_frame": np.repeat(np.arange(len(rows)), [len(row["patch_mm"]) for row in rows]),
    }
    for name in rows[0]:
        join = np.concatenate if name.startswith("patch") else np.stack
        truth[name] = join([row[name] for row in rows])
    return truth
