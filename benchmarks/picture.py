"""Rendering one picture: milliseconds beside the error of the markers' centroids, ours and Mitsuba's own integrator.

Centroids are of intensity in a window around each marker of the noise-free picture, the cover's light taken away. Ours
are compared with a picture of 12 x 12 rays per pixel with shadows; Mitsuba's own with one of many samples of itself, as
it renders a simpler scene (a straight camera in the body, one colour), so that only its sampling counts.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from twin.parts.markers import place
from twin.parts.scene import Scene
from twin.study.recipe import load_scene
from twin.theory.optics import project
from twin.world.exposure import expose
from twin.world.lighting import lamps_at
from twin.world.markers import Ellipsoids, ellipsoids
from twin.world.render import Renderer
from twin.world.variant import choose_variant

SCENES = ("kamiyama_pillar", "sato_press")
REPEATS = 5
FINEST = 12


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a method and setting; the quick form renders the flat sensor with two grids."""
    rows = []
    for name in SCENES[: 1 if quick else None]:
        scene = load_scene(name)
        markers = _markers(scene)
        rows += _ours(name, scene, markers, (1, 3) if quick else (1, 2, 3, 4, 6))
        if choose_variant().name != "scalar_rgb" and scene.camera is not None and scene.camera.lens == "pinhole":
            rows += _stock(name, scene, markers, (16,) if quick else (4, 16, 64), 64 if quick else 1024)
        rows.append(_exposure(name, scene, markers))
    return rows


def _ours(name: str, scene: Scene, markers: Ellipsoids, grids: tuple[int, ...]) -> list[dict[str, Any]]:
    pixels = _pixels(scene, markers)
    renderer = Renderer(scene, markers)
    cover = renderer.radiance(markers.rows(slice(0, 0)))
    finest = Renderer(scene, markers, subpixels=4 if renderer.variant.name == "scalar_rgb" else FINEST)
    truth = _centroids(finest.radiance(markers) - cover, pixels, markers)
    rows = []
    for shadows in (True, False):
        renderer = Renderer(scene, markers, shadows=shadows)
        for k in grids:
            renderer.subpixels = k
            milliseconds, light = _timed(lambda: renderer.radiance(markers))  # noqa: B023
            error = _centroids(light - cover, pixels, markers) - truth
            rows.append(_row(name, f"twin, {renderer.variant.name}", k, shadows, milliseconds, error))
    return rows


def _stock(name: str, scene: Scene, markers: Ellipsoids, samples: tuple[int, ...], many: int) -> list[dict[str, Any]]:
    """Time Mitsuba's direct integrator on the folded scene: camera and LEDs at their paraxial images."""
    import mitsuba as mi

    assert scene.camera is not None
    camera, base = scene.camera, scene.body.base_z_mm
    index = scene.material.refractive_index
    air = camera.pupil_mm[2] - base - sum(layer.thickness_mm for layer in camera.layers)
    eye = base + index * (air + sum(layer.thickness_mm / layer.index for layer in camera.layers))
    unit = 0.25
    view = 2 * np.rad2deg(np.arctan(camera.width_px / 2 / (camera.focal_px * index)))
    up = mi.ScalarTransform4f().look_at(origin=[0, 0, eye / unit], target=[0, 0, 0], up=[0, 1, 0])
    data = np.column_stack([markers.centres, np.full((len(markers), 3), unit)]) / unit
    data = np.column_stack([data, np.tile([0, 0, 0, 1], (len(markers), 1))]).astype(np.float32)
    lamps = lamps_at(markers.centres.mean(axis=0)[None], scene)
    literal = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "sensor": {
            "type": "perspective", "fov": float(view), "to_world": up, "near_clip": 10.0,
            "film": {"type": "hdrfilm", "width": camera.width_px, "height": camera.height_px,
                     "rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32"},
            "sampler": {"type": "independent"},
        },
        "markers": {"type": "ellipsoids", "data": mi.TensorXf(data), "extent": 1.0, "bsdf": {"type": "diffuse"}},
        **{f"led{i}": {"type": "point", "position": list(map(float, p / unit)), "intensity": 1e5}
           for i, p in enumerate(lamps.place[0])},
    }  # fmt: skip
    made = mi.load_dict(literal)
    white = Ellipsoids(centres=markers.centres, axes=markers.axes, colour=np.ones((len(markers), 3)))
    ahead = (eye - markers.centres[:, 2]) / (camera.focal_px * index)
    pixels = np.column_stack([markers.centres[:, 0] / ahead, -markers.centres[:, 1] / ahead]) + camera.centre_px
    # mi.render mirrors neither axis here; its first pixel is the top left one as well.
    truth = _centroids(sum(np.array(mi.render(made, spp=64, seed=i)) for i in range(many // 64)), pixels, white)
    rows = []
    for spp in samples:
        milliseconds, light = _timed(lambda: np.array(mi.render(made, spp=spp, seed=99)))  # noqa: B023
        error = _centroids(light, pixels, white) - truth
        rows.append(_row(name, f"mi.render direct, {spp} samples", round(spp**0.5), True, milliseconds, error))
    return rows


def _exposure(name: str, scene: Scene, markers: Ellipsoids) -> dict[str, Any]:
    light = Renderer(scene, markers).radiance(markers)
    milliseconds, _ = _timed(lambda: expose(light, scene.ccd, np.random.default_rng(0)))
    return {"scene": name, "method": "ccd", "k": "", "shadows": "", "milliseconds": milliseconds,
            "centroid_rms_px": "", "centroid_max_px": ""}  # fmt: skip


def _row(name: str, method: str, k: int, shadows: bool, milliseconds: float, error: np.ndarray) -> dict[str, Any]:
    return {
        "scene": name,
        "method": method,
        "k": k,
        "shadows": shadows,
        "milliseconds": milliseconds,
        "centroid_rms_px": float(np.sqrt(np.mean(error**2))),
        "centroid_max_px": float(np.abs(error).max()),
    }


def _markers(scene: Scene) -> Ellipsoids:
    """Return the markers with print errors, so that they meet the pixel grid in all ways."""
    count = sum(layer.columns * layer.rows for layer in scene.markers.values())
    jitter = np.random.default_rng(1).normal(0, 0.03, (count, 2))
    return ellipsoids(place(scene.body, scene.markers, jitter), scene.markers)


def _pixels(scene: Scene, markers: Ellipsoids) -> np.ndarray:
    assert scene.camera is not None
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


def _timed(work: Any) -> tuple[float, Any]:
    """Return the shortest of a few runs after one that compiles, ms, and the result."""
    result = work()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return 1000 * min(times), result
