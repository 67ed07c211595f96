"""Axes of the picture, on the splat, and of the sensor's software: tracking, then forces.

Departure of a picture is that of a marker's visible outline, drawn, from the middle of the hull of its surface's
points, each projected in closed form, px; where an axis says so it is another, brought to px of the outline. A picture
must be finite and hold what is asked of it; else its residual is infinite. Tracking runs on drawn pictures
(`benchmarks.discs`): departure is the share of markers that are given a shift more than half a px wrong; what is not
found is left out and said, which is no departure. For forces it is the error of the total.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from benchmarks import ROOT, discs
from benchmarks.inverse import case
from benchmarks.picture import SPLAT
from benchmarks.stress_elastic import Axis, Measured
from benchmarks.tracking import FINGER, SIZE
from twin.arrays import Floats, Pixels
from twin.errors import SolveError
from twin.parts.camera import Ccd
from twin.parts.scene import Scene
from twin.sense.reconstruct import reconstruct
from twin.sense.track import track
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory.optics import project, rays
from twin.world.picture.ccd import expose
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.render import Renderer

DRAWN = Measured(residual=1e-6, departure=0.02)
"""Bounds: round trip from pixel to ray to pixel, px, and a drawn outline's place, px."""

PX_A_MM = 20.35
"""Of the block's camera, 6 mm deep."""

BALL = np.random.default_rng(4).normal(size=(4000, 3))
BALL /= np.linalg.norm(BALL, axis=1, keepdims=True)


def picture_axes() -> list[Axis]:
    """Return the axes of the picture."""
    return [
        _axis("field of view, pinhole, deg", (10.0, 30.0, 60.0, 90.0, 120.0, 150.0, 170.0),
              lambda d: _field(d, "pinhole")),
        _axis("field of view, equidistant, deg", (10.0, 60.0, 120.0, 170.0, 180.0, 200.0),
              lambda d: _field(d, "equidistant")),
        _axis("marker diameter down, px", (20.0, 5.0, 2.0, 1.0, 0.5, 0.1), _diameter),
        _axis("marker diameter up, px", (20.0, 40.0, 60.0, 100.0), _diameter),
        _axis("picture, px a side, down", (64.0, 8.0, 2.0, 1.0, 0.0), _size),
        _axis("picture, px a side, up", (256.0, 1024.0, 4096.0, 8193.0), _size),
        _axis("markers", (0.0, 1.0, 100.0, 1e3, 5e3, 2e4), _crowd),
        _axis("depth of a marker under the window, mm", (30.0, 5.0, 1.0, 0.3, 0.1, -1.0), _near),
        _axis("marker behind the window, mm", (0.01, 1.0, 10.0, 100.0, 1e6), _behind),
        _axis("marker beyond the picture's edge, radii (departure: of its share that is seen)",
              (-1.0, -0.5, 0.0, 0.5, 0.9, 1.0, 10.0, 1e3), _outside),
        _axis("overlap of two markers, diameters (departure: of their common area)",
              (0.0, 0.25, 0.5, 0.9, 0.99, 1.0), _overlap),
        _axis("strain of a print", (0.1, 0.5, 1.0, 3.0, 10.0), _strained),
        _axis("LED in the body above a marker's middle, mm (departure: of its light)",
              (20.0, 5.0, 1.0, 0.5, 0.3, 0.2, 0.0), _inner_light),
        _axis("markers in front of an LED in the body (departure: of the light on the last)", (1.0, 2.0, 10.0, 100.0),
              _shaded),
        _axis("exposure up", (1.0, 10.0, 1e3, 1e4), _exposure),
        _axis("exposure down", (1.0, 1e-2, 1e-6, 1e-30, 0.0), _exposure),
        Axis(name="pictures of a process without a home (departure: MiB grown)", steps=(100.0, 1e4), attempt=_many,
             bounds=replace(DRAWN, departure=5.0)),
    ]  # fmt: skip


def _axis(name: str, steps: tuple[float, ...], attempt: Any) -> Axis:
    return Axis(name=name, steps=steps, attempt=attempt, bounds=DRAWN)


def _scene(**camera: Any) -> Scene:
    keys = {"width_px": 120, "height_px": 90, **camera}
    return load_scene("kamiyama_pillar", {f"camera.{key}": value for key, value in keys.items()})


def _beads(places: Any, radius: Any = 0.25) -> Ellipsoids:
    centres = np.atleast_2d(np.asarray(places, float))
    axes = np.broadcast_to(radius, len(centres))[:, None, None] * np.eye(3)
    return Ellipsoids(centres=centres, axes=axes, colour=np.full((len(centres), 3), 0.7))


def _seen(scene: Scene, markers: Ellipsoids) -> Measured:
    """Draw markers; return round trip and the largest departure of whole outlines."""
    assert scene.camera is not None
    optics = scene.camera, scene.material.refractive_index, scene.body.base_z_mm
    renderer = Renderer(scene, markers if len(markers) else _beads([(0, 0, 6.0)]), SPLAT, subpixels=4)
    light, outlines = renderer.radiance(markers), renderer.outlines(markers)
    pixels = project(markers.centres, *optics)
    seen = np.isfinite(pixels).all(axis=1)
    start, way = rays(pixels[seen], *optics)
    along = np.sum((markers.centres[seen] - start) * way, axis=1)[:, None]
    trip = np.abs(project(start + along * way, *optics) - pixels[seen]).max(initial=0.0)
    whole = np.flatnonzero((outlines.visible > 0.999) & seen)
    if len(whole) > 50:
        whole = whole[:: len(whole) // 50]
    off = [np.abs(outlines.centroid_px[i] - _hull(markers, int(i), scene)[0]).max() for i in whole]
    good = np.isfinite(light).all() and (light >= 0).all()
    return Measured(residual=float(trip) if good else math.inf, departure=float(np.max(off, initial=0.0)))


def _hull(markers: Ellipsoids, i: int, scene: Scene) -> tuple[Pixels, float]:
    """Return the centroid and area of one marker's outline: the hull of its surface's projected points."""
    assert scene.camera is not None
    surface = markers.centres[i] + BALL @ markers.axes[i].T
    places = project(surface, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)
    hull = ConvexHull(places)
    x, y = (places[hull.vertices] - places[hull.vertices[0]]).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    moments = np.array([((x + np.roll(x, -1)) * cross).sum(), ((y + np.roll(y, -1)) * cross).sum()])
    return places[hull.vertices[0]] + moments / (3 * cross.sum()), float(hull.volume)


def _field(degrees: float, lens: str) -> Measured:
    """Draw beads as wide as the body allows: in a wide field they are small."""
    half = math.radians(degrees / 2)
    focal = 240 / (math.tan(half) if lens == "pinhole" else half)
    scene = _scene(width_px=480, height_px=360, lens=lens, focal_px=max(focal, 1.0 + 1e-9))
    width = min(0.8, 200 / focal)
    places = [(x * width, y * width, 6.0) for x in (-20, 0, 20) for y in (-15, 0, 15)]
    return _seen(scene, _beads(places, min(2.5, 300.0 / focal)))


def _diameter(size_px: float) -> Measured:
    return _seen(_scene(), _beads([(0.03, -0.02, 6.0)], size_px / PX_A_MM / 2))


def _size(side: float) -> Measured:
    focal = 1814.8 * max(side, 1.0) / 640
    return _seen(_scene(width_px=int(side), height_px=int(side), focal_px=focal), _beads([(0, 0, 6.0)], 1.0))


def _crowd(count: float) -> Measured:
    rng, n = np.random.default_rng(3), int(count)
    places = np.column_stack([rng.uniform(-2.5, 2.5, n), rng.uniform(-2, 2, n), rng.uniform(1, 12, n)])
    return _seen(_scene(), _beads(places.reshape(n, 3), 0.02))


def _near(depth: float) -> Measured:
    return _seen(_scene(), _beads([(0, 0, 40.0 - depth)], min(0.25, abs(depth) / 2)))


def _behind(height: float) -> Measured:
    """Draw one behind the base, which must not be seen, in front of one that must."""
    outlines = Renderer(_scene(), _beads([(0, 0, 6.0)]), SPLAT).outlines(_beads([(0, 0, 40 + height), (0, 0, 6.0)]))
    return Measured(
        residual=0.0 if outlines.visible[0] == 0 and outlines.visible[1] > 0.999 else math.inf, departure=0.0
    )


def _outside(radii: float) -> Measured:
    """Draw one whose middle stands so many radii beyond the right edge; a circle's segment is seen."""
    scene, radius = _scene(), 0.25
    x = (119.5 - 59.5) / PX_A_MM
    for _ in range(5):  # to the edge, by what a mm is there
        markers = _beads([(x + radii * radius, 0, 6.0)], radius)
        x += (119.5 + radii * radius * PX_A_MM - _place(markers, scene)) / PX_A_MM
    outlines = Renderer(scene, _beads([(0, 0, 6.0)]), SPLAT, subpixels=8).outlines(markers)
    _, area = _hull(markers, 0, scene)
    out = min(max((_place(markers, scene) - 119.5) / math.sqrt(area / math.pi), -1.0), 1.0)
    share = (math.acos(out) - out * math.sqrt(1 - out**2)) / math.pi
    return Measured(residual=0.0, departure=abs(float(outlines.visible[0]) - share) * math.sqrt(area / math.pi) / 2)


def _place(markers: Ellipsoids, scene: Scene) -> float:
    assert scene.camera is not None
    place = project(markers.centres, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)
    return float(place[0, 0])


def _overlap(share: float) -> Measured:
    """Draw two at one depth, a part of a diameter into each other; discs' common area is known."""
    scene, radius = _scene(), 0.25
    markers = _beads([(-radius * (1 - share), 0, 6.0), (radius * (1 - share), 0, 6.0)], radius)
    outlines = Renderer(scene, markers, SPLAT, subpixels=8).outlines(markers)
    _, area = _hull(markers, 0, scene)
    common = 2 / math.pi * (math.acos(1 - share) - (1 - share) * math.sqrt(1 - (1 - share) ** 2))
    off = float(outlines.area_px.sum()) - area * (2 - common)
    return Measured(residual=0.0, departure=abs(off) / (2 * math.pi * math.sqrt(area / math.pi)))


def _strained(strain: float) -> Measured:
    """Draw a print that is drawn out along x and thinner across."""
    stretch = np.diag([1 + strain, (1 + strain) ** -0.5, (1 + strain) ** -0.5])
    disc = stretch @ np.diag([0.25, 0.25, 0.025])
    print_ = Ellipsoids(centres=np.array([[0.03, -0.02, 6.0]]), axes=disc[None], colour=np.full((1, 3), 0.7))
    return _seen(_scene(), print_)


def _inner_light(above: float) -> Measured:
    """Light the pole of a bead from straight above, the picture's middle; inside the bead it must stay dark."""
    scene = _scene(width_px=121, height_px=91)
    assert scene.light is not None
    led = {"positions_mm": ((0.0, 0.0, 6.0 + above),), "ambient": 0.0}
    renderer = Renderer(
        scene.model_copy(update={"cover": None, "light": scene.light.model_copy(update=led)}),
        _beads([(0, 0, 3.0)]), SPLAT, subpixels=1,
    )  # fmt: skip
    light = renderer.radiance(_beads([(0, 0, 6.0)]))
    if not np.isfinite(light).all():
        return Measured(residual=math.inf)
    lit = float(light[45, 60, 0])
    if above <= 0.25:
        return Measured(residual=0.0, departure=lit)
    return Measured(residual=0.0, departure=abs(lit * renderer._top * (above - 0.25) ** 2 / 0.7 / renderer._gain - 1))


def _shaded(count: float) -> Measured:
    """Put beads between an LED in the body and the last one, beside the camera's way to it: it must be dark."""
    scene, n = _scene(), int(count)
    assert scene.light is not None
    led, last = np.array([1.5, 0.0, 20.0]), np.array([0.0, 0.0, 6.0])
    lit = {"positions_mm": (tuple(led),), "ambient": 0.0}
    scene = scene.model_copy(update={"cover": None, "light": scene.light.model_copy(update=lit)})
    between = led + (last - led) * np.linspace(0.2, 0.8, n)[:, None]
    renderer = Renderer(scene, _beads([last]), SPLAT)
    shaded = renderer.radiance(_beads(np.vstack([last, between]), [0.25, *[0.3] * n]))
    column, row = np.rint(renderer.outlines(_beads([last])).centroid_px[0]).astype(int)
    return Measured(residual=0.0 if np.isfinite(shaded).all() else math.inf, departure=float(shaded[row, column, 0]))


def _many(count: float) -> Measured:
    """Make pictures in a process that can write nowhere."""
    env = {**os.environ, "HOME": "/proc/nowhere", "TWIN_CACHE": "/proc/nowhere", "XDG_CACHE_HOME": "/proc/nowhere"}
    told = subprocess.run(
        [sys.executable, "-m", "benchmarks.picture_process", "splat", str(int(count))],
        capture_output=True, text=True, cwd=ROOT, env=env,
    )  # fmt: skip
    if told.returncode != 0:
        return Measured(residual=math.inf)
    return Measured(residual=0.0, departure=float(json.loads(told.stdout.splitlines()[-1])["grown_mib"]))


def _exposure(factor: float) -> Measured:
    """Expose a grey wedge; brighter light must never give fewer counts, on average over rows."""
    ccd = Ccd(preset="ideal", exposure=factor, crosstalk=0.0)
    wedge = np.tile(np.linspace(0, 1, 64, dtype=np.float32)[None, :, None] * np.float32(factor), (64, 1, 3))
    counts = expose(np.ascontiguousarray(wedge), ccd, np.random.default_rng(0)).mean(axis=(0, 2))
    smooth = np.convolve(counts, np.ones(16) / 16, mode="valid")
    return Measured(residual=0.0, departure=float(max(0.0, -np.diff(smooth, n=1).min())) / 50)


MADE_UP, WRONG_PX = Measured(departure=0.02), 0.5
OFF = Measured(departure=0.1)
LAYOUT = FINGER.layout()
MARKS = np.concatenate(list(LAYOUT.values()))


Walks = list[tuple[str, tuple[float, ...], Callable[[float], Measured]]]


def tracking_axes() -> list[Axis]:
    """Return the axes of tracking."""
    shares = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
    tracking: Walks = [
        ("motion of all markers, over the pitch", (0.0, 0.2, 0.4, 0.6, 0.8, 1.0), lambda s: _tracked(motion=s)),
        ("motion, each its own, over the pitch", (0.0, 0.1, 0.2, 0.3, 0.4, 0.5), lambda s: _tracked(scatter=s)),
        ("share of markers missing", shares, lambda s: _tracked(missing=s)),
        ("contrast down, counts", (130.0, 40.0, 20.0, 10.0, 5.0, 2.0, 0.0), lambda c: _tracked(contrast=c)),
        ("brightness up, counts (255 saturate)", (130.0, 200.0, 400.0, 2e3, 1e5), lambda c: _tracked(contrast=c)),
        ("blur, px", (0.7, 2.0, 4.0, 8.0), lambda b: _tracked(blur=b)),
        (
            "rows of pixels cut off the picture's end, set black",
            (0.0, 50.0, 200.0, 479.0),
            lambda n: _tracked(cut=int(n)),
        ),
        ("share of spurious spots", (0.0, 0.1, 0.5, 1.0), lambda s: _tracked(spurious=s)),
    ]
    return [Axis(name=n, steps=s, attempt=a, bounds=MADE_UP) for n, s, a in tracking]


def inverse_axes() -> list[Axis]:
    """Return the axes of the inverse problem."""
    inverse: Walks = [
        ("weight up (departure: error of the total)", (1.0, 1e3, 1e6, 1e9, 1e12, 1e300), lambda w: _solved(weight=w)),
        ("weight down", (1.0, 1e-3, 1e-6, 1e-12, 1e-300, 0.0), lambda w: _solved(weight=w)),
        ("weight by itself, noise of a shift, px", (0.05, 0.2, 1.0, 5.0, 50.0), lambda n: _solved(noise=n)),
        (
            "share of vectors wrong by 10 px, robust",
            (0.0, 0.02, 0.1, 0.2, 0.4),
            lambda s: _solved(wrong=s, robust=True),
        ),
        ("share of vectors wrong by 10 px, not robust", (0.0, 0.02, 0.1), lambda s: _solved(wrong=s)),
        ("share of vectors lost", (0.0, 0.2, 0.5, 0.9, 0.99, 1.0), lambda s: _solved(lost=s)),
        ("shifts, times", (1.0, 1e3, 1e9, 1e100), lambda k: _solved(scale=k)),
    ]
    return [Axis(name=n, steps=s, attempt=a, bounds=OFF) for n, s, a in inverse]


def _drawn(places: Floats, contrast: float = 130.0, blur: float = 0.7, seed: int = 0) -> np.ndarray:
    cut = len(LAYOUT["red"])
    drawn = discs.scene(SIZE, [(places[:cut], 0), (places[cut:], 2)], FINGER.diameter, blur, contrast)
    return discs.expose(drawn, seed)


def _tracked(
    *, motion: float = 0.0, scatter: float = 0.0, missing: float = 0.0, contrast: float = 130.0, blur: float = 0.7,
    cut: int = 0, spurious: float = 0.0,
) -> Measured:  # fmt: skip
    random = np.random.default_rng(5)
    shift = motion * FINGER.pitch * np.array([0.8, 0.6]) + random.uniform(-1, 1, MARKS.shape) * scatter * FINGER.pitch
    places = np.where(random.random(len(MARKS))[:, None] < missing, np.nan, MARKS + shift)
    picture = _drawn(places, contrast, blur, 1)
    if cut:
        picture[-cut:] = 0
    for x, y in random.uniform((20, 20), (620, 460), (round(spurious * len(MARKS)), 2)).astype(int):
        picture[y - 5 : y + 5, x - 5 : x + 5, random.integers(0, 3)] = 160
    rest = _drawn(MARKS, contrast, blur, 0)
    found = track(rest, picture, LAYOUT).shift_px
    gone = ~np.isfinite(places).all(axis=1)
    given = np.isfinite(found).all(axis=1)
    wrong = given & (gone | (np.hypot(*(found - shift).T) > WRONG_PX))
    return Measured(departure=float(wrong.mean()))


@cache
def _sensor() -> tuple[Any, Any]:
    sensor = Sensor(load_scene("kamiyama_pillar"))
    return calibration_of(sensor), case(sensor, calibration_of(sensor), 3)


def _solved(
    *, noise: float = 0.0, wrong: float = 0.0, lost: float = 0.0, scale: float = 1.0, robust: bool = False,
    weight: float | str = "auto",
) -> Measured:  # fmt: skip
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
