"""The picture against stock Mitsuba: a camera and LEDs in air, plates of glass and rubber, a path integrator.

Nothing is folded there: rays are refracted, reflected and lost at every interface, light goes between markers and back
from the interfaces, and LEDs are found by chance only, which takes many thousand paths a pixel. Places come from
markers that glow, brightness from the middles of markers of the scene's colours under discs of light, each in its own
channel. What our pictures leave out (light between markers, reflections to and fro) is in the difference.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np

from benchmarks.picture import SPLAT
from twin.arrays import Floats, Ints, Pixels
from twin.parts.markers import MarkerSet
from twin.parts.scene import Scene
from twin.study.recipe import load_scene
from twin.world.picture.backend import Variant
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.render import Renderer
from twin.world.picture.stock_scene import write_stock_scene

CORE = 3
"""Half width, px, of the window in the middle of a marker that tells its brightness."""

EDGE = 25
"""Markers so near the edge of the picture, px, are left out."""

LIGHT = {"light.radius_mm": 8.0, "light.ambient": 0.0}
"""Discs so wide that chance finds them. The plate mirrors one into a corner of the flat sensor's picture."""

NEAR = {
    **LIGHT, "light.radius_mm": 1.0, "camera.lens": "pinhole", "camera.focal_px": 200,
    "markers.red.kind": "bead", "markers.blue.kind": "bead",
}  # fmt: skip
"""The finger's LEDs a few markers away, seen by a lens that Mitsuba has."""

SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "kamiyama_pillar": ("kamiyama_pillar", LIGHT),
    "kamiyama_wide": ("kamiyama_wide", LIGHT),
    "sato_press, beads, pinhole": ("sato_press", NEAR),
}

SAMPLES_A_PASS = 4096


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a scene: differences of places, px, and of brightness after one scale; needs Mitsuba's LLVM."""
    rows = []
    for name in list(SCENES)[: 1 if quick else None]:
        base, keys = SCENES[name]
        scene = load_scene(base, {**keys, "tolerance.preset": "none"})
        rows.append({"scene": name, **_compared(scene, *((3, 4096) if quick else (8, 32768)))})
    return rows


def _compared(scene: Scene, count: int, samples: int) -> dict[str, Any]:
    """Return how far places and brightness of ``count`` markers, from the middle outwards, are from the referee's.

    Brightness takes so many samples a pixel, places take `SAMPLES_A_PASS`.
    """
    markers = Ellipsoids.of(MarkerSet.place(scene.body, scene.markers), scene.markers)
    bare = scene.model_copy(update={"cover": None})
    renderer = Renderer(bare, markers, SPLAT, subpixels=8)
    outlines, light = renderer.outlines(markers), renderer.radiance(markers).astype(float)
    chosen = _some(scene, outlines.visible, outlines.centroid_px, count)
    off, ours, theirs, noise = [], [], [], []
    for i in chosen:
        nearest = np.rint(outlines.centroid_px[i]).astype(int)
        own = int(np.argmax(markers.colour[i]))
        half = int(2 * np.sqrt(outlines.area_px[i] / np.pi)) + 4
        glow = path_traced(scene, markers, nearest, half, SAMPLES_A_PASS, glowing=i)[0][:, :, own]
        off.append(nearest - half + _centroid(glow) - outlines.centroid_px[i])
        seen, error = (p[:, :, own] for p in path_traced(scene, markers, nearest, CORE, samples))
        (column, row), colour = nearest - CORE, markers.colour[i, own]
        ours.append(light[row : row + 2 * CORE + 1, column : column + 2 * CORE + 1, own].mean() / colour)
        theirs.append(seen.mean() / colour)
        noise.append(np.sqrt((error**2).sum()) / seen.sum())
    scale = np.sum(ours) / np.sum(theirs)
    brightness = np.array(theirs) * scale / np.array(ours) - 1
    return {
        "markers": len(chosen),
        "samples": samples,
        "place_rms_px": float(np.sqrt(np.mean(np.square(off)))),
        "place_max_px": float(np.abs(off).max()),
        "brightness_rms": float(np.sqrt(np.mean(brightness**2))),
        "brightness_max": float(np.abs(brightness).max()),
        "brightness_noise": float(np.sqrt(np.mean(np.square(noise)))),
    }


def path_traced(
    scene: Scene, markers: Ellipsoids, middle: Ints, half: int, samples: int, glowing: int | None = None
) -> tuple[Floats, Floats]:
    """Return a square of 2 ``half`` + 1 px of the referee's picture around a pixel, and its standard errors.

    With ``glowing`` that marker shines and the rest is black, else all are lit by the scene's LEDs. Standard errors
    come from the differences of passes.
    """
    import mitsuba as mi

    mi.set_variant(Variant.choose("llvm_ad_rgb").name)
    with TemporaryDirectory() as folder:
        made = mi.load_file(str(_written(Path(folder), scene, markers, middle - half, 2 * half + 1, glowing)))
    passes = [np.array(mi.render(made, spp=SAMPLES_A_PASS, seed=n)) for n in range(samples // SAMPLES_A_PASS)]
    stack = np.array(passes, float)
    return stack.mean(axis=0), stack.std(axis=0, ddof=min(len(stack) - 1, 1)) / np.sqrt(len(stack))


def _written(folder: Path, scene: Scene, markers: Ellipsoids, corner: Ints, size: int, glowing: int | None) -> Path:
    """Write the scene as the program exports it, for a part of the picture; return the file."""
    if glowing is not None:
        markers = replace(markers, colour=np.where(np.arange(len(markers))[:, None] == glowing, np.ones(3), 0.0))
    (file,) = write_stock_scene(folder, scene.model_copy(update={"cover": None}), 1.0, {"scene": (markers, None)})
    tree = ElementTree.parse(file)
    film = tree.find("sensor/film")
    assert film is not None
    crop = {"offset_x": int(corner[0]), "offset_y": int(corner[1]), "width": size, "height": size}
    for key, value in crop.items():
        ElementTree.SubElement(film, "integer", name=f"crop_{key}", value=str(value))
    if glowing is not None:
        # One marker shines in the dark: its colour is its light, and nothing is sent back.
        root = tree.getroot()
        for led in [shape for shape in root if shape.get("id", "").startswith("led")]:
            root.remove(led)
        shape = root.find("shape[@id='scene_markers']")
        paint = root.find("shape[@id='scene_markers']/bsdf/bsdf")
        assert shape is not None
        assert paint is not None
        colour = paint[0]
        paint.remove(colour)
        ElementTree.SubElement(paint, "rgb", name="reflectance", value="0 0 0")
        ElementTree.SubElement(shape, "emitter", type="area").append(colour)
        colour.set("name", "radiance")
    tree.write(file)
    return file


def _some(scene: Scene, visible: Floats, places: Pixels, count: int) -> list[int]:
    """Return markers that are seen whole, from the middle of the picture to its corners."""
    size = np.array([scene.camera.width_px, scene.camera.height_px])
    inside = ((places > EDGE) & (places < size - 1 - EDGE)).all(axis=1)
    free = np.flatnonzero((visible > 0.999) & inside)
    away = np.linalg.norm(places[free] - scene.camera.centre_px, axis=1)
    order = free[np.argsort(away)]
    return [int(order[j]) for j in np.linspace(0, len(order) - 1, count).astype(int)]


def _centroid(picture: Floats) -> Floats:
    """Return column and row of a square's centroid."""
    steps = np.arange(picture.shape[0])
    return np.array([picture.sum(axis=0) @ steps, picture.sum(axis=1) @ steps]) / picture.sum()
