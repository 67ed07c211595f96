"""The table and the contact sheet of docs/picture_effects.md: kamiyama_pillar without and with each effect.

    python docs/make_effects.py && python -m benchmarks pages effects

Each effect is one whole run by the splat, of the same sensor and noise: found markers, their centres at rest against
the outlines' (``place``), their shifts, the total force and the field against the truth. The sheet, `effects.webp`,
has a part of every picture beside the same part without the effect.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import twin
from benchmarks.dark_figures import save_both
from benchmarks.record import store

SCENE = "kamiyama_pillar"
SPECKS = {"count": 1500, "size_mm": 0.15}
LINES = {"count": 100, "size_mm": 0.06, "length_mm": 8}
RIMS = {"count": 300, "size_mm": 0.6, "hollow": 0.7, "albedo": 0}
GLASS = {"index": 1.49, "thickness_mm": 10, "abbe_number": 50}
ROLLING = {"ccd.frames_per_second": 30, "ccd.readout_ms": 20}

EFFECTS: dict[str, dict[str, Any]] = {
    "none": {},
    "reddish LEDs": {"light.colours": [[1, 0.2, 0.1]] * 4},
    "LEDs in turns": {"light.lit": [[0, 1], [2, 3]]},
    "mirrored LEDs": {"light.positions_mm": [[11, y, 105] for y in (8, -8)], "light.radius_mm": 0.6},
    "dust": {"camera.dust": SPECKS},
    "scratches": {"camera.scratches": LINES},
    "bubbles": {"camera.bubbles": RIMS},
    "dust in rubber": {"camera.dust": {**SPECKS, "depth_mm": 10}},
    "bubbles in rubber": {"camera.bubbles": {**RIMS, "depth_mm": 10}},
    "shadows on cover": {"cover.shadows": True},
    "probe seen": {"cover.transmittance": 0.3, "press.albedo": [0.5, 0.4, 0.3]},
    "light outside": {"cover.transmittance": 0.3, "light.outside": [0.1, 0.1, 0.1]},
    "dispersion": {"material.abbe_number": 50, "camera.layers": [GLASS]},
    "gloss": {f"markers.{layer}.gloss": [1.59, 0.1] for layer in ("red", "blue")},
    "texture": {f"markers.{layer}.texture": [0.3, 0.2] for layer in ("red", "blue")},
    "uneven markers": {f"tolerance.print_{what}_pct": 10 for what in ("diameter", "oval", "shade", "colour")},
    "haze": {"ccd.haze": 0.3},
    "ghost": {"ccd.ghost": 0.1, "ccd.ghost_px": [12, 5]},
    "smear": {"ccd.smear": 0.05},
    "hot, dead pixels": {"ccd.hot_pixels": 60, "ccd.dead_pixels": 60},
    "rows, columns": {"ccd.row_noise_e": 120, "ccd.column_noise_e": 120},
    "flicker": {"ccd.flicker": 0.3, "ccd.exposure_ms": 3},
    "flicker, rolling": {"ccd.flicker": 0.3, "ccd.exposure_ms": 3, **ROLLING},
    "auto exposure": {"ccd.auto_exposure": 0.99},
    "white balance": {"ccd.white_balance": "grey"},
    "gamma after 8 bits": {"ccd.adc_bits": 8, "ccd.gamma": 2.2},
    "12 bits": {"ccd.bits": 12},
    "aperture 8 mm": {"camera.aperture_mm": 8.0},
    "JPEG 85": {"ccd.jpeg_quality": 85},
}
"""Keys of each effect, as the page names them."""

WIDE = ("scratches", "bubbles", "smear", "flicker", "flicker, rolling", "white balance", "mirrored LEDs")
"""Effects on the whole picture, of which a sixteenth is shown; of others a square."""

PRESSED = ("probe seen", "light outside")
"""Effects that are shown under the press."""


def measured(keys: dict[str, Any]) -> tuple[dict[str, Any], twin.RunResult]:
    """Return the row of one run, without its name, and the run."""
    overrides = {"renderer": "splat", **keys}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        result = twin.run(SCENE, want=["displacement", "picture", "tracking", "forces", "score"], overrides=overrides)
    truth, found, score = result.truth, result.estimate, result.score
    place = found.marker_rest_px - truth.marker_outline_rest_px
    moved = truth.marker_outline_pressed_px - truth.marker_outline_rest_px
    row: dict[str, Any] = {"found": int(np.isfinite(found.marker_shift_px).all(axis=1).sum())}
    for key, off in (("place_px", place), ("shift_px", found.marker_shift_px - moved)):
        row[key] = float(np.sqrt(np.nanmean(off**2)))
    row |= {f"{key} %": 100 * (score["force"][f"{key}_error"] or np.nan) for key in ("total_force", "field")}
    return row, result


def shown(result: twin.RunResult, name: str) -> np.ndarray:
    """Return the part of the picture that the sheet shows, brightened."""
    picture = result.pressed if name in PRESSED else result.rest
    part = picture[60:420:2, 80:560:2] if name in WIDE else picture[195:285, 260:380]
    return np.sqrt(part / float(np.iinfo(part.dtype).max))


def make_effects(path: Path, across: int = 3) -> None:
    """Store the table, and write the sheet."""
    rows = []
    pictures: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    plain = None
    for name, keys in EFFECTS.items():
        row, result = measured(keys)
        rows.append({"effect": name, **row})
        print(rows[-1], flush=True)
        plain = plain or result
        if result is not plain:
            pictures[name] = (shown(plain, name), shown(result, name))
    store("effects", rows)
    down = -(-len(pictures) // across)
    figure, axes = plt.subplots(down, 2 * across, figsize=(9, 1.32 * down), layout="constrained", dpi=110)
    for ax in axes.flat:
        ax.set_axis_off()
    for number, (name, pair) in enumerate(pictures.items()):
        own = axes[number // across, 2 * (number % across) :][:2]
        for ax, picture in zip(own, pair, strict=False):
            ax.imshow(picture)
        own[1].set_title(name, fontsize=8)
        own[0].set_title("without", fontsize=8)
    save_both(figure, path)


if __name__ == "__main__":
    make_effects(Path(__file__).parent / "effects.webp")
