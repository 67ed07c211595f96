"""Rendering one picture: milliseconds beside the error of the markers' centroids, ours and Mitsuba's own integrator.

Centroids are of intensity in a window around each marker of the noise-free picture, the cover's light taken away. Ours
are compared with a picture of 12 x 12 rays per pixel, drawn by the splat, with shadows or without as they are.
Mitsuba's own are compared with one of many samples of itself, as it renders a simpler scene (a straight camera in the
body, one colour), so that only its sampling counts. Outlines are compared with those of 16 x 16 rays.

CPU milliseconds count all threads; methods are compared by them. First pictures and memory are those of processes of
their own.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import Any

import numpy as np

from twin.parts.ccd import PRESETS as CCD_PRESETS
from twin.parts.ccd import Ccd
from twin.parts.markers import place
from twin.parts.scene import Scene
from twin.study.recipe import load_scene
from twin.theory.optics import project
from twin.world.picture.exposure import expose, fixed_pattern
from twin.world.picture.lighting import lamps_at
from twin.world.picture.markers import Ellipsoids, ellipsoids
from twin.world.picture.render import Renderer, subpixels_for
from twin.world.picture.variant import Variant, choose_variant

SCENES = ("kamiyama_pillar", "sato_press")
PRESETS = ("industrial", *sorted(set(CCD_PRESETS) - {"industrial"}))
SPLAT = Variant(name="splat", library=None, reason="compared with the others")
REPEATS = 5
AT_LEAST_S = 0.25
"""CPU seconds spent on what is quicker: of a few milliseconds, five runs rarely meet one that nothing disturbs."""
PICTURES = 10_000
"""Made by one process, to see whether its memory grows."""
FINEST = 12
GOAL_PX = 0.01


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a method and setting; the quick form renders the flat sensor with two grids."""
    rows = []
    for name in SCENES[: 1 if quick else None]:
        scene = load_scene(name)
        markers = _markers(scene)
        rows += _ours(name, scene, markers, (1, 3) if quick else (1, 2, 3, 4, 6))
        if choose_variant().name != "splat" and scene.camera is not None and scene.camera.lens == "pinhole":
            rows += _stock(name, scene, markers, (16,) if quick else (4, 16, 64), 64 if quick else 1024)
        rows += _exposures(name, scene, markers, PRESETS[:2] if quick else PRESETS)
        rows += _parts(name, scene, markers)
    for way in [SPLAT] if choose_variant().name == "splat" else [SPLAT, choose_variant()]:
        rows += _processes(way, 20 if quick else PICTURES)
    return rows


def _ours(name: str, scene: Scene, markers: Ellipsoids, grids: tuple[int, ...]) -> list[dict[str, Any]]:
    pixels = _pixels(scene, markers)
    rows = []
    for shadows in (True, False):
        finest = Renderer(scene, markers, SPLAT, FINEST, shadows)
        cover = finest.radiance(markers.rows(slice(0, 0)))
        truth = _centroids(finest.radiance(markers) - cover, pixels, markers)
        whole = finest.outlines(markers, 16).centroid_px
        for variant in [SPLAT] if choose_variant().name == "splat" else [SPLAT, choose_variant()]:
            renderer = Renderer(scene, markers, variant, shadows=shadows)
            for k in grids:
                renderer.subpixels = k
                cost, light = _timed(lambda: renderer.radiance(markers))  # noqa: B023
                error = _centroids(light - cover, pixels, markers) - truth
                off = renderer.outlines(markers, k).centroid_px - whole
                row = _row(name, f"twin, {variant.name}", k, shadows, cost, error)
                rows.append({**row, "outline_max_px": float(np.nanmax(np.abs(off)))})
    return rows


def _parts(name: str, scene: Scene, markers: Ellipsoids) -> list[dict[str, Any]]:
    """Return rows for what a new place of all markers costs before rays are traced."""
    rows = []
    for variant in [SPLAT] if choose_variant().name == "splat" else [SPLAT, choose_variant()]:
        renderer = Renderer(scene, markers, variant)
        cost, frame = _timed(lambda: renderer._frame(markers, 3))  # noqa: B023
        rows.append(_plain(name, f"all new places prepared, {variant.name}", cost))
        if variant.name == "splat":
            renderer.subpixels = subpixels_for(GOAL_PX)
            cost, _ = _timed(lambda: renderer.seen(markers))  # noqa: B023
            rows.append(_plain(name, f"picture and outlines to {GOAL_PX} px, splat", cost))
        else:
            tracer: Any = renderer._tracer
            cost, _ = _timed(lambda: (tracer._padded.hold(frame.padded), tracer._exact.hold(frame.exact)))  # noqa: B023
            rows.append(_plain(name, "of it, markers moved in Mitsuba's scene", cost))
    return rows


def _processes(variant: Variant, pictures: int) -> list[dict[str, Any]]:
    """Return rows for the first picture of a fresh process, and for the memory of one that makes many."""
    told = subprocess.run(
        [sys.executable, "-m", "benchmarks.picture_process", variant.name, str(pictures)],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    found = json.loads(told.splitlines()[-1])
    first = {"scene": "kamiyama_pillar", "method": f"first picture of a process, {variant.name}"}
    many = {"scene": "64 x 48 px, 32 markers", "method": f"{pictures} pictures of a process, {variant.name}"}
    return [
        {**first, "milliseconds": found["first_ms"], "cpu_ms": found["first_cpu_ms"], "peak_mib": found["first_mib"]},
        {**many, "milliseconds": found["each_ms"], "cpu_ms": found["each_cpu_ms"], "peak_mib": found["last_mib"],
         "grown_mib": found["grown_mib"]},
    ]  # fmt: skip


def _stock(name: str, scene: Scene, markers: Ellipsoids, samples: tuple[int, ...], many: int) -> list[dict[str, Any]]:
    """Time Mitsuba's direct integrator on the folded scene: camera and LEDs at their paraxial images."""
    import mitsuba as mi

    mi.set_variant(choose_variant().name)

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
        cost, light = _timed(lambda: np.array(mi.render(made, spp=spp, seed=99)))  # noqa: B023
        error = _centroids(light, pixels, white) - truth
        rows.append(_row(name, f"mi.render direct, {spp} samples", round(spp**0.5), True, cost, error))
    return rows


def _exposures(name: str, scene: Scene, markers: Ellipsoids, presets: tuple[str, ...]) -> list[dict[str, Any]]:
    light = Renderer(scene, markers, SPLAT).radiance(markers)
    rows = []
    for preset in presets:
        ccd = Ccd.model_validate({"preset": preset})
        pattern = fixed_pattern(ccd, (light.shape[0], light.shape[1]), np.random.default_rng(1))
        cost, _ = _timed(lambda: expose(light, ccd, np.random.default_rng(0), pattern))  # noqa: B023
        rows.append(_plain(name, f"ccd, {preset}", cost))
    return rows


def _plain(name: str, method: str, cost: tuple[float, float]) -> dict[str, Any]:
    return {"scene": name, "method": method, "milliseconds": cost[0], "cpu_ms": cost[1]}


def _row(name: str, method: str, k: int, shadows: bool, cost: tuple[float, float], error: np.ndarray) -> dict[str, Any]:
    return {
        "scene": name,
        "method": method,
        "k": k,
        "shadows": shadows,
        "milliseconds": cost[0],
        "cpu_ms": cost[1],
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


def _timed(work: Any) -> tuple[tuple[float, float], Any]:
    """Return the least wall and CPU time of some runs after one that compiles, ms, and the result."""
    result = work()
    times: list[tuple[float, float]] = []
    while len(times) < REPEATS or sum(cpu for _, cpu in times) < 1000 * AT_LEAST_S:
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        times.append((1000 * (time.perf_counter() - wall), 1000 * (time.process_time() - cpu)))
    return (min(wall for wall, _ in times), min(cpu for _, cpu in times)), result
