"""Rendering one picture: milliseconds beside the error of the markers' centroids, ours and Mitsuba's own integrator.

Centroids are of intensity in a window around each marker of the noise-free picture, the cover's light taken away. Ours
are compared with a picture of 12 x 12 rays per pixel, drawn by the splat, with shadows or without as they are.
Mitsuba's own are compared with one of many samples of itself, as it renders a simpler scene (a straight camera in the
body, one colour), so that only its sampling counts. Outlines are compared with those of 16 x 16 rays.

CPU milliseconds count all threads; methods are compared by them.
"""

from typing import Any

import numpy as np

from benchmarks.clock import repeated
from twin.parts.camera import PRESETS as CCD_PRESETS
from twin.parts.camera import Ccd
from twin.parts.markers import place
from twin.parts.scene import Scene
from twin.study.recipe import load_scene
from twin.theory.optics import project
from twin.world.picture.backend import Variant, choose_variant
from twin.world.picture.ccd import expose, fixed_pattern
from twin.world.picture.ellipsoids import Ellipsoids, ellipsoids
from twin.world.picture.lamps import lamps_at
from twin.world.picture.render import Renderer

SCENES = ("kamiyama_pillar", "sato_press")
PRESETS = ("industrial", *sorted(set(CCD_PRESETS) - {"industrial"}))
SPLAT = Variant(name="splat", library=None, reason="compared with the others")
REPEATS = 5
AT_LEAST_S = 0.25
"""CPU seconds spent on what is quicker: of a few milliseconds, five runs rarely meet one that nothing disturbs."""
FINEST = 12


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


def _stock(name: str, scene: Scene, markers: Ellipsoids, samples: tuple[int, ...], many: int) -> list[dict[str, Any]]:
    """Time Mitsuba's direct integrator on the folded scene: camera and LEDs at their paraxial images.

    Set up with care: samples are spread evenly over each pixel (multi-jittered; independent ones err 3 to 5 times as
    much), none are spent on reflected directions, which meet no point LED, and all LEDs light every sample, or each LED
    has a rendering of its own, so that none is drawn at random.
    """
    import mitsuba as mi

    mi.set_variant(choose_variant().name)

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
    scenery = {
        "type": "scene",
        "sensor": {
            "type": "perspective", "fov": float(view), "to_world": up, "near_clip": 10.0,
            "film": {"type": "hdrfilm", "width": camera.width_px, "height": camera.height_px,
                     "rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32"},
            "sampler": {"type": "multijitter"},
        },
        "markers": {"type": "ellipsoids", "data": mi.TensorXf(data), "extent": 1.0, "bsdf": {"type": "diffuse"}},
    }  # fmt: skip
    leds = {
        f"led{i}": {"type": "point", "position": list(map(float, place / unit)), "intensity": 1e5}
        for i, place in enumerate(lamps.place[0])
    }
    direct = {"type": "direct", "bsdf_samples": 0}
    together = [mi.load_dict({**scenery, **leds, "integrator": {**direct, "emitter_samples": len(leds)}})]
    apart = [mi.load_dict({**scenery, name: led, "integrator": {**direct, "emitter_samples": 1}})
             for name, led in leds.items()]  # fmt: skip

    def light(made: list[Any], spp: int, seed: int) -> np.ndarray:
        return np.asarray(sum(np.array(mi.render(one, spp=spp, seed=seed)) for one in made))

    white = Ellipsoids(centres=markers.centres, axes=markers.axes, colour=np.ones((len(markers), 3)))
    ahead = (eye - markers.centres[:, 2]) / (camera.focal_px * index)
    pixels = np.column_stack([markers.centres[:, 0] / ahead, -markers.centres[:, 1] / ahead]) + camera.centre_px
    # mi.render mirrors neither axis here; its first pixel is the top left one as well.
    at_once = min(many, 256)
    truth = _centroids(np.asarray(sum(light(apart, at_once, i) for i in range(many // at_once))), pixels, white)
    rows = []
    for method, made in (("mi.render direct", together), ("mi.render direct by LED", apart)):
        for spp in samples:
            cost, found = _timed(lambda: light(made, spp, 99))  # noqa: B023
            error = _centroids(found, pixels, white) - truth
            rows.append(_row(name, f"{method}, {spp} samples", round(spp**0.5), True, cost, error))
    return rows


def _exposures(name: str, scene: Scene, markers: Ellipsoids, presets: tuple[str, ...]) -> list[dict[str, Any]]:
    light = Renderer(scene, markers, SPLAT).radiance(markers)
    rows = []
    for preset in presets:
        ccd = Ccd.model_validate({"preset": preset})
        pattern = fixed_pattern(ccd, (light.shape[0], light.shape[1]), np.random.default_rng(1))
        cost, _ = _timed(lambda: expose(light, ccd, np.random.default_rng(0), pattern))  # noqa: B023
        rows.append({"scene": name, "method": f"ccd, {preset}", "milliseconds": cost[0], "cpu_ms": cost[1]})
    return rows


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
    costs = repeated(work, REPEATS)
    while sum(cost.cpu for cost in costs) < AT_LEAST_S:
        costs += repeated(work, 1)
    return (1000 * min(cost.wall for cost in costs), 1000 * min(cost.cpu for cost in costs)), result
