"""Rendering one picture: milliseconds beside the error of the markers' centroids.

Centroids are of intensity in a window around each marker of the noise-free picture, the cover's light taken away. They
are compared with a picture of 12 x 12 rays per pixel, drawn by the splat, with shadows or without as they are; outlines
with those of 16 x 16 rays.

CPU milliseconds count all threads; methods are compared by them.
"""

from typing import Any

import numpy as np

from benchmarks.clock import repeated
from twin.parts.camera import PRESETS as CCD_PRESETS
from twin.parts.camera import Ccd
from twin.parts.markers import MarkerSet
from twin.parts.scene import Scene
from twin.study.recipe import load_scene
from twin.theory.optics import project
from twin.world.picture.backend import Variant
from twin.world.picture.ccd import Pattern, expose
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.render import Renderer

SCENES = ("kamiyama_pillar", "sato_press")
PRESETS = ("industrial", *sorted(set(CCD_PRESETS) - {"industrial"}))
SPLAT = Variant(name="splat", library=None, reason="compared with the others")
REPEATS = 5
AT_LEAST_S = 0.25
"""CPU seconds spent on what is quicker: of a few milliseconds, five runs rarely meet one that nothing disturbs."""
FINEST = 12


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a method and setting; the quick form renders the flat sensor with two grids."""
    rows = []
    for name in SCENES[: 1 if quick else None]:
        scene = load_scene(name)
        markers = _markers(scene)
        rows += _ours(name, scene, markers, (1, 3) if quick else (1, 2, 3, 4, 6))
        rows += _exposures(name, scene, markers, PRESETS[:2] if quick else PRESETS)
    return rows


def _ours(name: str, scene: Scene, markers: Ellipsoids, grids: tuple[int, ...]) -> list[dict[str, Any]]:
    pixels = _pixels(scene, markers)
    rows = []
    for shadows in (True, False):
        finest = Renderer(scene, markers, SPLAT, FINEST, shadows)
        cover = finest.radiance(markers.rows(slice(0, 0)))
        truth = _centroids(finest.radiance(markers) - cover, pixels, markers)
        whole = finest.outlines(markers, 16).centroid_px
        for variant in [SPLAT] if Variant.choose().name == "splat" else [SPLAT, Variant.choose()]:
            renderer = Renderer(scene, markers, variant, shadows=shadows)
            for k in grids:
                renderer.subpixels = k
                cost, light = _timed(lambda: renderer.radiance(markers))  # noqa: B023
                error = _centroids(light - cover, pixels, markers) - truth
                off = renderer.outlines(markers, k).centroid_px - whole
                row = {"scene": name, "method": f"twin, {variant.name}", "k": k, "shadows": shadows, **cost}
                row["centroid_rms_px"] = float(np.sqrt(np.mean(error**2)))
                row["centroid_max_px"] = float(np.abs(error).max())
                rows.append({**row, "outline_max_px": float(np.nanmax(np.abs(off)))})
    return rows


def _exposures(name: str, scene: Scene, markers: Ellipsoids, presets: tuple[str, ...]) -> list[dict[str, Any]]:
    light = Renderer(scene, markers, SPLAT).radiance(markers)
    rows = []
    for preset in presets:
        ccd = Ccd.model_validate({"preset": preset})
        pattern = Pattern.drawn(ccd, (light.shape[0], light.shape[1]), np.random.default_rng(1))
        cost, _ = _timed(lambda: expose(light, ccd, np.random.default_rng(0), pattern))  # noqa: B023
        rows.append({"scene": name, "method": f"ccd, {preset}", **cost})
    return rows


def _markers(scene: Scene) -> Ellipsoids:
    """Return the markers with print errors, so that they meet the pixel grid in all ways."""
    count = sum(layer.columns * layer.rows for layer in scene.markers.values())
    jitter = np.random.default_rng(1).normal(0, 0.03, (count, 2))
    return Ellipsoids.of(MarkerSet.place(scene.body, scene.markers, jitter), scene.markers)


def _pixels(scene: Scene, markers: Ellipsoids) -> np.ndarray:
    return project(markers.centres, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)


def _centroids(light: np.ndarray, pixels: np.ndarray, markers: Ellipsoids, half: int = 9) -> np.ndarray:
    """Return (n, 2) centroids of each marker's own colour around its place, px."""
    found = np.empty((len(pixels), 2))
    for i, (column, row) in enumerate(np.rint(pixels).astype(int)):
        left, top = max(column - half, 0), max(row - half, 0)
        window = light[top : row + half + 1, left : column + half + 1, np.argmax(markers.colour[i])]
        total = window.sum()
        found[i] = left + (window.sum(axis=0) @ np.arange(window.shape[1])) / total, 0
        found[i, 1] = top + (window.sum(axis=1) @ np.arange(window.shape[0])) / total
    return found


def _timed(work: Any) -> tuple[dict[str, float], Any]:
    """Return the least wall and CPU time of some runs after one that compiles, ms, and the result."""
    result = work()
    costs = repeated(work, REPEATS)
    while sum(cost.cpu for cost in costs) < AT_LEAST_S:
        costs += repeated(work, 1)
    wall, cpu = (1000 * min(getattr(cost, kind) for cost in costs) for kind in ("wall", "cpu"))
    return {"milliseconds": wall, "cpu_ms": cpu}, result
