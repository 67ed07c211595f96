"""The README's moving picture, `press.gif`: a pillar pressed into the flat sensor at one place after the other.

    python docs/make_film.py

Every frame is computed: contact, camera picture with noise, tracking of the markers, force field.
"""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import twin
from twin.display import plot_shifts

SCENE = "kamiyama_pillar"
FORCES_N = (0.75, 1.5, 2.25, 3.0)
PLACES_MM = (-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0)
FRAME_MS = 250
LARGEST_N = 0.5
"""Force along z at the end of the colours."""

TIMES = 40.0
"""How many times as long the motion of markers is drawn."""

GAIN = 2.5
"""How many times as bright the camera's picture is shown."""


def make_film(path: Path) -> None:
    """Write the film."""
    matplotlib.rcParams.update({"font.size": 9, "font.family": "DejaVu Sans"})
    scene = twin.load_scene(SCENE)
    assert scene.press is not None
    environment = twin.Environment(scene)
    # The first frame shows a full press: it is what stands where nothing moves.
    steps = [(x, FORCES_N[-1]) for x in PLACES_MM]
    steps += [(PLACES_MM[-1], force) for force in (FORCES_N[1], 0.0)]
    steps += [(PLACES_MM[0], force) for force in FORCES_N[:-1]]
    frames = []
    for x, force in steps:
        press = None
        if force:
            press = twin.Press(probe=scene.press.probe, at_mm=(x, 0.0), force_n=(0.0, 0.0, force))
        frames.append(_frame(environment, environment.step(press), force))
    frames = [frame.quantize(128, dither=Image.Dither.NONE) for frame in frames]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, optimize=True)


def _frame(environment: twin.Environment, seen: twin.Observation, force_n: float) -> Image.Image:
    figure = Figure(figsize=(9.6, 2.9), dpi=100, layout="constrained")
    camera, motion, field = figure.subplots(1, 3)
    camera.imshow(np.minimum(GAIN * seen.picture.astype(float), 255).astype(np.uint8))
    camera.set_axis_off()
    camera.set_title(f"camera, pressed with {force_n:.2f} N")
    layout = environment.sensor.layout_px
    rest = np.concatenate(list(layout.values()))
    layer = np.repeat(list(layout), [len(places) for places in layout.values()])
    plot_shifts(motion, rest, seen.marker_shift_px, layer, factor=TIMES)
    height, width = seen.picture.shape[:2]
    motion.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[], xlabel="", ylabel="")
    motion.set_title(f"tracked marker motion, {TIMES:g} times")
    motion.get_legend().remove()
    shown = field.scatter(
        *seen.site_mm[:, :2].T, c=seen.force_n[:, 2], s=60, marker="s", cmap="PuOr_r", vmin=-LARGEST_N, vmax=LARGEST_N
    )
    field.set(xticks=[], yticks=[], aspect="equal")
    field.set_title(f"recovered force field, total {abs(seen.total_force_n[2]):.2f} N")
    figure.colorbar(shown, ax=field, label="force into the body (N)")
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return Image.open(file).convert("RGB")


if __name__ == "__main__":
    make_film(Path(__file__).with_name("press.gif"))
