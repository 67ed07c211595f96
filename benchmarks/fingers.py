"""Four fingers as a stream: their films through one process, decoded, tracked and reconstructed, beside the truth.

Four made fingers (other seeds of `sato_press`) are pressed with 1 N in a third of a second and filmed at the paper's 60
frames a second. Then one process takes ``frames`` of each at a time, on one thread or two, from memory or from H.264
files (with a rest picture that was encoded, too), and finds the forces of all together. ``ms`` is the CPU time of
tracking and forces of a frame of all four, ``wall_ms`` the clock's, ``sets_per_s`` how many such sets fit in a second;
``decode_ms`` is the wall time until they have come from ffmpeg's processes, which run beside: medians of the quickest
round, as other work only adds. Errors are against the films' truth, of markers in full sight and of the total force.
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
from twin.sense.track import Tracker
from twin.study.film import film_to_folder
from twin.study.frames import VideoWriter, read_picture

Opened = Callable[[], list[Iterator[np.ndarray]]]
METHODS = ("disc-fit", "two-pass")
IN_SIGHT = 0.98
WAYS = ({"frames": 1, "threads": 1}, {"frames": 8, "threads": 1}, {"frames": 8, "threads": 2})
ROUNDS = 12  # the first compiles, and the first 50 frames are looked at for a codec


@one_thread()
def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a way of tracking; the quick form has films of five frames."""
    calibration = twin.read_calibration(SCENES / "sato_calibration.npz")
    with tempfile.TemporaryDirectory() as folder:
        films = [Path(folder) / str(number) for number in range(4)]
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
        sources: dict[str, tuple[list[np.ndarray], Opened]] = {
            "memory": (rests, lambda: [iter(pictures) for pictures in shown]),
            "H.264": (coded, lambda: [_decoded(film / "frames.mp4") for film in films]),
        }
        return [
            _row(rest, opened, truths, calibration, {"from": name, "tracking": method, **way})
            for name, (rest, opened) in sources.items()
            for method in METHODS
            for way in WAYS
        ]


def _decoded(video: Path) -> Iterator[np.ndarray]:
    reader = imageio_ffmpeg.read_frames(str(video))
    width, height = next(reader)["size"]
    for data in reader:
        yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


def _row(
    rests: list[np.ndarray],
    opened: Opened,
    truths: list[dict[str, np.ndarray]],
    calibration: twin.Calibration,
    way: dict[str, Any],
) -> dict[str, Any]:
    trackers = [Tracker(rest, calibration.layout, method=way["tracking"]) for rest in rests]
    pool = ThreadPoolExecutor(way["threads"])
    count, rounds = len(truths[0]["time_s"]), []
    for _ in range(ROUNDS):
        readers, clock, motions, forces = opened(), [], [], []
        for first in range(0, count, way["frames"]):
            some, began = min(way["frames"], count - first), time.perf_counter()
            pictures = [[next(reader) for _ in range(some)] for reader in readers]
            seen, cpu = time.perf_counter(), time.process_time()
            step = map if way["threads"] == 1 else pool.map
            found = list(step(lambda tracker, film: [tracker.track(one) for one in film], trackers, pictures))
            fields = twin.reconstruct([one for each in found for one in each], calibration)
            times = [time.process_time() - cpu, time.perf_counter() - seen, seen - began]
            clock.append(1e3 / some * np.array(times))
            motions.append(np.array([[one.shift_px for one in each] for each in found]))
            forces.append(np.array([field.total_force_n for field in fields]).reshape(len(rests), some, 3))
        rounds.append(np.median(clock, axis=0).tolist())
    pool.shutdown()
    names = ("marker_outline_px", "marker_outline_rest_px", "marker_visible", "force_n")
    outline, at_rest, visible, force = (np.array([truth[name] for truth in truths]) for name in names)
    off_px = (np.concatenate(motions, axis=1) - (outline - at_rest[:, None]))[visible > IN_SIGHT]
    off_n = np.linalg.norm(np.concatenate(forces, axis=1) - force, axis=-1)
    spent, passed, decoding = min(rounds, key=lambda medians: medians[1])
    return {
        **way, "sets": count, "ms": spent, "wall_ms": passed, "sets_per_s": 1e3 / passed, "decode_ms": decoding,
        "rms_px": float(np.sqrt(np.nanmean(off_px**2))), "rms_n": float(np.sqrt(np.mean(off_n**2))),
    }  # fmt: skip
