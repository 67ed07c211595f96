"""Axes of the picture: lens, place, size, number and strain of markers, picture size and exposure, on the splat.

Departure is that of a marker's visible outline, drawn, from the place that the closed form of the rays projects its
centre to, px; where a marker fills many pixels the lens bends it, so the bound grows with its radius. A picture must be
finite and hold what is asked of it; else its residual is infinite.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.stress_axes import Axis, Measured
from twin.parts.ccd import Ccd
from twin.parts.scene import Scene
from twin.study.recipe import load_scene
from twin.theory.optics import project, rays
from twin.world.picture.exposure import expose
from twin.world.picture.markers import Ellipsoids
from twin.world.picture.render import Renderer
from twin.world.picture.variant import Variant

SPLAT = Variant(name="splat", library=None, reason="on every machine")
DRAWN = Measured(residual=1e-6, departure=0.02)
"""Bounds: round trip from pixel to ray to pixel, px, and a drawn outline's place, px."""


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
        _axis("picture, px a side, up", (256.0, 1024.0, 2048.0, 8193.0), _size),
        _axis("markers", (1.0, 100.0, 1e3, 5e3, 2e4), _crowd),
        _axis("depth of a marker under the window, mm", (30.0, 5.0, 1.0, 0.3, 0.1, -1.0), _near),
        _axis("exposure up", (1.0, 10.0, 1e3, 1e4), _exposure),
        _axis("exposure down", (1.0, 1e-2, 1e-6, 1e-30, 0.0), _exposure),
    ]  # fmt: skip


def _axis(name: str, steps: tuple[float, ...], attempt: Any) -> Axis:
    return Axis(name=name, steps=steps, attempt=attempt, bounds=DRAWN)


def _scene(**camera: Any) -> Scene:
    keys = {"width_px": 120, "height_px": 90, **camera}
    return load_scene("kamiyama_pillar", {f"camera.{key}": value for key, value in keys.items()})


def _beads(places: Any, radius: float = 0.25) -> Ellipsoids:
    centres = np.atleast_2d(np.asarray(places, float))
    n = len(centres)
    return Ellipsoids(centres=centres, axes=np.tile(radius * np.eye(3), (n, 1, 1)), colour=np.full((n, 3), 0.7))


def _seen(scene: Scene, markers: Ellipsoids, allowed: float = 1.0) -> Measured:
    """Draw markers; return round trip and the largest departure of whole outlines, over ``allowed``."""
    assert scene.camera is not None
    optics = scene.camera, scene.material.refractive_index, scene.body.base_z_mm
    renderer = Renderer(scene, markers, SPLAT, subpixels=4)
    light, outlines = renderer.radiance(markers), renderer.outlines(markers)
    pixels = project(markers.centres, *optics)
    seen = np.isfinite(pixels).all(axis=1)
    start, way = rays(pixels[seen], *optics)
    along = np.sum((markers.centres[seen] - start) * way, axis=1)[:, None]
    trip = np.abs(project(start + along * way, *optics) - pixels[seen]).max(initial=0.0)
    whole = (outlines.visible > 0.999) & seen
    off = np.abs(outlines.centroid_px - pixels)[whole].max(initial=0.0)
    good = np.isfinite(light).all() and (light >= 0).all()
    return Measured(residual=float(trip) if good else math.inf, departure=float(off) / allowed)


def _field(degrees: float, lens: str) -> Measured:
    half = math.radians(degrees / 2)
    focal = 60 / (math.tan(half) if lens == "pinhole" else half)
    scene = _scene(lens=lens, focal_px=max(focal, 1.0 + 1e-9))
    width = 0.5 * 100 / max(focal, 60.0)
    places = [(x * width, y * width, 6.0) for x in (-20, 0, 20) for y in (-15, 0, 15)]
    return _seen(scene, _beads(places, min(0.25, 300.0 / focal)))


def _diameter(size_px: float) -> Measured:
    scene = _scene()
    # 20.35 px a mm at 6 mm; a wide marker is bent by the lens, in proportion to its radius
    return _seen(scene, _beads([(0.03, -0.02, 6.0)], size_px / 20.35 / 2), max(1.0, size_px / 20))


def _size(side: float) -> Measured:
    focal = 1814.8 * max(side, 1.0) / 640
    return _seen(
        _scene(width_px=int(side), height_px=int(side), focal_px=focal), _beads([(0, 0, 6.0)], 1.0), side / 20 + 1
    )


def _crowd(count: float) -> Measured:
    rng, n = np.random.default_rng(3), int(count)
    places = np.column_stack([rng.uniform(-2.5, 2.5, n), rng.uniform(-2, 2, n), rng.uniform(1, 12, n)])
    return _seen(_scene(), _beads(places, 0.02), 2.0)


def _near(depth: float) -> Measured:
    return _seen(_scene(), _beads([(0, 0, 40.0 - depth)], min(0.25, abs(depth) / 2)), 2.0)


def _exposure(factor: float) -> Measured:
    return _counts(Ccd(preset="ideal", exposure=factor, crosstalk=0.0), factor)


def _counts(ccd: Ccd, factor: float = 1.0) -> Measured:
    """Expose a grey wedge; brighter light must never give fewer counts, on average over rows."""
    wedge = np.tile(np.linspace(0, 1, 64, dtype=np.float32)[None, :, None] * np.float32(factor), (64, 1, 3))
    counts = expose(np.ascontiguousarray(wedge), ccd, np.random.default_rng(0)).mean(axis=(0, 2))
    smooth = np.convolve(counts, np.ones(16) / 16, mode="valid")
    return Measured(residual=0.0, departure=float(max(0.0, -np.diff(smooth, n=1).min())) / 50)
