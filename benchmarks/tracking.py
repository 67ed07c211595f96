"""Tracking: error and time on drawn pictures, beside other programs; then the sensor's whole chain, frames a second.

Pictures are drawn by area (`benchmarks.discs`): 640 x 480, two layers, 130 counts of contrast, blur .7 px, 1.5 counts
of read noise and shot noise of a 20 000 electron well. Motion is a random walk of up to 5 px, re-drawn for every
picture. Times are of one thread's CPU, all work from the picture in memory to every marker's motion; others' programs
find spots in each layer's own channel, and the nearest to the place before is taken. Errors are of the shift from rest
to picture, per axis; the bound is Cramer and Rao's for the shift, all else known.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.discs import bound_px, expose, scene
from twin.blas_threads import one_thread
from twin.sense.reference import METHODS
from twin.sense.track import Tracker, analyse_rest

SIZE = (640, 480)
Layout = dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Design:
    """A drawn sensor: layers of (columns, rows) markers, pitch and diameter in px, sites of its force field."""

    name: str
    red: tuple[int, int]
    blue: tuple[int, int]
    pitch: float
    diameter: float
    sites: int

    def layout(self) -> Layout:
        """Return the rest positions, px, off the pixel grid as prints are."""
        random, places = np.random.default_rng(1), {}
        for name, (columns, rows) in (("red", self.red), ("blue", self.blue)):
            grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1).reshape(-1, 2)
            middle = (grid - (np.array([columns, rows]) - 1) / 2) * self.pitch + (np.array(SIZE) - 1) / 2
            places[name] = middle + random.uniform(-0.5, 0.5, middle.shape)
        return places


FLAT = Design(name="flat", red=(21, 16), blue=(20, 15), pitch=29.0, diameter=10.0, sites=320)
FINGER = Design(name="finger", red=(5, 5), blue=(6, 6), pitch=70.0, diameter=15.0, sites=25)


@one_thread()
def measure(quick: bool) -> list[dict[str, Any]]:
    """Return rows of error and time, then of the whole chain; the quick form draws fewer pictures."""
    rows: list[dict[str, Any]] = []
    for design in (FLAT,) if quick else (FLAT, FINGER):
        rows += _errors(design, 4 if quick else 10)
    for design in (FLAT, FINGER):
        rows += _chains(design, 8 if quick else 20, 200 if quick else 1000)
    return rows


def _errors(design: Design, count: int) -> Iterator[dict[str, Any]]:
    layout = design.layout()
    pictures, shifts = film(design, count)
    bound = np.sqrt(2) * bound_px(design.diameter)
    for name, follow in ways(pictures[0], layout, design.diameter):
        if follow is None:
            yield {"sensor": design.name, "way": f"{name}: not installed"}
            continue
        follow(pictures[0])
        errors, times, found = [], [], []
        for picture, shift in zip(pictures[1:], shifts[1:], strict=True):
            start = time.thread_time()
            measured = follow(picture)
            times.append(1e3 * (time.thread_time() - start))
            errors.append(measured - shift)
            found.append(np.isfinite(measured).all(axis=1))
        yield row(design.name, name, np.concatenate(errors), times, bound)


def row(sensor: str, way: str, error: np.ndarray, times: list[float], bound: float) -> dict[str, Any]:
    """Return a result row from (n, 2) errors in px, NaN where lost, and milliseconds."""
    length = np.hypot(*error.T)
    fine = error[np.isfinite(length) & (length < 1.0)]
    sd = float(fine.std()) if len(fine) else float("nan")
    return {
        "sensor": sensor, "way": way, "ms": float(np.median(times)), "ms_p99": float(np.quantile(times, 0.99)),
        "sd_px": sd, "over_bound": sd / bound, "bias_px": float(np.abs(fine.mean(axis=0)).max()),
        "matched": float(np.isfinite(length).mean()), "gross": int((length >= 1.0).sum()),
    }  # fmt: skip


def film(design: Design, count: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the pictures of a random walk (the first at rest) and the true (n, 2) shifts, px."""
    random, layout = np.random.default_rng(2), design.layout()
    marks = np.concatenate(list(layout.values()))
    pictures, shifts, shift = [], [], np.zeros_like(marks)
    for number in range(count + 1):
        if number:
            shift = np.clip(shift + random.normal(0, 1.0, 2) + random.normal(0, 0.2, shift.shape), -3.5, 3.5)
        moved = marks + shift
        cut = len(layout["red"])
        drawn = scene(SIZE, [(moved[:cut], 0), (moved[cut:], 2)], design.diameter)
        pictures.append(expose(drawn, number))
        shifts.append(shift.copy())
    return pictures, shifts


def ways(rest: np.ndarray, layout: Layout, diameter: float) -> Iterator[tuple[str, Callable[..., Any] | None]]:
    """Yield every way of tracking as a function from a picture to (n, 2) shifts, px; None if it is not installed."""
    tracker = Tracker(rest, layout)
    yield "twin disc-fit, sequence", lambda picture: tracker.track(picture).shift_px
    for method in METHODS:
        analysed = analyse_rest(rest, layout, method=method)
        yield f"twin {method}, cold", lambda picture, a=analysed: Tracker.motion(a, picture).shift_px
    yield "OpenCV SimpleBlobDetector", _peer(rest, layout, _opencv_blobs(diameter)) if find_spec("cv2") else None
    yield "OpenCV connected components", _peer(rest, layout, _opencv_parts) if find_spec("cv2") else None
    yield "trackpy locate", _peer(rest, layout, _trackpy(diameter)) if find_spec("trackpy") else None


def _peer(rest: np.ndarray, layout: Layout, locate: Callable[[np.ndarray], np.ndarray]) -> Callable[..., Any]:
    """Return a tracker from a function that finds (b, 2) spots in one channel."""
    channels = [np.ascontiguousarray(rest[..., i]) for i in (0, 2)]
    starts = [_nearest(p, locate(c)) for p, c in zip(layout.values(), channels, strict=True)]
    last = [start.copy() for start in starts]

    def follow(picture: np.ndarray) -> np.ndarray:
        moved = []
        for number, channel in enumerate((0, 2)):
            at = _nearest(last[number], locate(np.ascontiguousarray(picture[..., channel])))
            last[number] = np.where(np.isfinite(at), at, last[number])
            moved.append(at - starts[number])
        return np.concatenate(moved)

    return follow


def _nearest(places: np.ndarray, spots: np.ndarray) -> np.ndarray:
    if not len(spots):
        return np.full_like(places, np.nan)
    distance, index = cKDTree(spots).query(places)
    return np.where((distance < 10.0)[:, None], spots[index], np.nan)


def _opencv_blobs(diameter: float) -> Callable[[np.ndarray], np.ndarray]:
    import cv2

    wanted = cv2.SimpleBlobDetector_Params()
    wanted.filterByColor, wanted.blobColor = True, 255
    wanted.filterByArea, wanted.minArea, wanted.maxArea = True, 0.3 * diameter**2, 2.0 * diameter**2
    wanted.filterByCircularity = wanted.filterByConvexity = wanted.filterByInertia = False
    wanted.minThreshold, wanted.maxThreshold, wanted.thresholdStep = 60.0, 140.0, 10.0
    detector = cv2.SimpleBlobDetector_create(wanted)
    return lambda image: np.array([spot.pt for spot in detector.detect(image)]).reshape(-1, 2)


def _opencv_parts(image: np.ndarray) -> np.ndarray:
    import cv2

    _, mask = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, _, stats, centres = cv2.connectedComponentsWithStats(mask)
    return np.asarray(centres[1:][stats[1:, cv2.CC_STAT_AREA] > 10])


def _trackpy(diameter: float) -> Callable[[np.ndarray], np.ndarray]:
    import trackpy

    trackpy.quiet()
    width = int(diameter * 1.4) // 2 * 2 + 1
    return lambda image: (
        trackpy.locate(image, width, minmass=500, engine="numba", characterize=False)[["x", "y"]].values
    )


def _chains(design: Design, frames: int, repeats: int) -> Iterator[dict[str, Any]]:
    """Time tracking in a sequence and the linear force field; the map is drawn at random, for its size alone."""
    pictures, _ = film(design, frames)
    layout = design.layout()
    count = 2 * sum(map(len, layout.values()))
    random = np.random.default_rng(0)
    force = random.normal(0, 1e-3, (3 * design.sites, count)).astype(np.float32)
    there_and_back = [*pictures, *reversed(pictures)]
    for sensors in (1, 4) if design is FINGER else (1,):
        trackers = [Tracker(pictures[0], layout) for _ in range(sensors)]
        whole, field = [], []
        for number in range(repeats):
            picture = there_and_back[number % len(there_and_back)]
            start = time.thread_time()
            shifts = [tracker.track(picture).shift_px for tracker in trackers]
            middle = time.thread_time()
            for shift in shifts:
                force @ np.nan_to_num(shift, nan=0.0).ravel().astype(np.float32)
            end = time.thread_time()
            whole.append(1e3 * (end - start))
            field.append(1e3 * (end - middle))
        median, worst = np.median(whole[10:]), np.quantile(whole[10:], 0.99)
        name = f"chain, {design.sites} sites" + (f", {sensors} sensors" if sensors > 1 else "")
        yield {"sensor": design.name, "way": name, "ms": float(median), "ms_p99": float(worst),
               "forces_ms": float(np.median(field[10:])), "frames_per_s": float(1e3 / median),
               "frames_per_s_p99": float(1e3 / worst)}  # fmt: skip
