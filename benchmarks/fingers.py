"""Four fingers as a stream: their films through one process, decoded, tracked and reconstructed, beside the truth.

Four made fingers (other seeds of `sato_press`) are pressed with 1 N in a third of a second and filmed at the paper's 60
frames a second. Then one process takes a frame of each at a time, on one thread or two, from memory as a camera gives
them or from H.264 files (with a rest picture that was encoded, too). ``ms`` is the CPU time of tracking and forces of
all, ``wall_ms`` the clock's, ``sets_per_s`` how many such sets fit into a second by it; ``decode_ms`` is the wall time
until four frames have come from ffmpeg's processes, which run beside it. Errors are against the films' truth, of the
markers in full sight and of the total force. A calibration of the design serves all four.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np

import twin
from twin.blas_threads import one_thread
from twin.files import SCENES
from twin.sense.reconstruct import Field
from twin.sense.track import Found, Tracker
from twin.study.film import film_to_folder
from twin.study.frames import VideoWriter, read_picture

FINGERS, METHODS, IN_SIGHT, ROUNDS = 4, ("disc-fit", "two-pass"), 0.98, 3
"""The films run ``ROUNDS`` times: the first round compiles."""


@one_thread()
def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a way of tracking; the quick form has films of five frames."""
    calibration = twin.read_calibration(SCENES / "sato_calibration.npz")
    with tempfile.TemporaryDirectory() as folder:
        films = [Path(folder) / str(number) for number in range(FINGERS)]
        for number, film in enumerate(films):
            step = {"force_n": {"z": 0.980665}, "seconds": 0.07 if quick else 0.34}
            keys = {"seed": number + 1, "ccd.frames_per_second": 60, "press.steps": [step]}
            film_to_folder(twin.load_scene("sato_press", keys), film)
        shown = [[read_picture(path) for path in sorted((film / "frames").iterdir())] for film in films]
        rests = [read_picture(film / "rest.png") for film in films]
        truths = [dict(np.load(film / "truth.npz")) for film in films]
        for film, pictures in zip(films, shown, strict=True):
            with VideoWriter(film / "frames.mp4", pictures[0].shape[1::-1]) as writer:
                for picture in pictures:
                    writer.add(picture)
        coded = [VideoWriter.encoded(rest, film / "rest.mp4") for rest, film in zip(rests, films, strict=True)]
        sources: dict[str, tuple[list[np.ndarray], Callable[[], list[Iterator[np.ndarray]]]]] = {
            "memory": (rests, lambda: [iter(pictures) for pictures in shown]),
            "H.264": (coded, lambda: [_decoded(film / "frames.mp4") for film in films]),
        }
        return [
            _row(rest, opened, truths, calibration, {"frames": name, "tracking": method, "threads": threads})
            for name, (rest, opened) in sources.items()
            for method in METHODS
            for threads in (1, 2)
        ]


def _decoded(video: Path) -> Iterator[np.ndarray]:
    reader = imageio_ffmpeg.read_frames(str(video))
    width, height = next(reader)["size"]
    for data in reader:
        yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


def _row(
    rests: list[np.ndarray],
    opened: Callable[[], list[Iterator[np.ndarray]]],
    truths: list[dict[str, np.ndarray]],
    calibration: twin.Calibration,
    way: dict[str, Any],
) -> dict[str, Any]:
    trackers = [Tracker(rest, calibration.layout, method=way["tracking"]) for rest in rests]
    pool = ThreadPoolExecutor(way["threads"])

    def forces(tracker: Tracker, frame: np.ndarray) -> tuple[Found, Field]:
        found = tracker.track(frame)
        return found, twin.reconstruct(found, calibration)

    for _ in range(ROUNDS):
        readers = opened()
        spent, passed, decoding, off_px, off_n = [], [], [], [], []
        for number in range(len(truths[0]["time_s"])):
            began = time.perf_counter()
            frames = [next(reader) for reader in readers]
            decoding.append(1e3 * (time.perf_counter() - began))
            began, cpu = time.perf_counter(), time.process_time()
            pairs = list((map if way["threads"] == 1 else pool.map)(forces, trackers, frames))
            spent.append(1e3 * (time.process_time() - cpu))
            passed.append(1e3 * (time.perf_counter() - began))
            for truth, (one, field) in zip(truths, pairs, strict=True):
                moved = truth["marker_outline_px"][number] - truth["marker_outline_rest_px"]
                off_px.append((one.shift_px - moved)[truth["marker_visible"][number] > IN_SIGHT])
                off_n.append(field.total_force_n - truth["force_n"][number])
    pool.shutdown()
    middle = float(np.median(passed))
    return {
        **way, "sets": len(spent), "ms": float(np.median(spent)), "wall_ms": middle, "sets_per_s": 1e3 / middle,
        "decode_ms": float(np.median(decoding)), "rms_px": float(np.sqrt(np.nanmean(np.concatenate(off_px) ** 2))),
        "rms_n": float(np.sqrt(np.mean(np.sum(np.square(off_n), axis=1)))),
    }  # fmt: skip
