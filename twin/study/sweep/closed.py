"""The first fidelity: the design limit of every design in one go, and what rules designs out before anything is solved.

Pitch and noise widen the picture of a push together (`twin.theory.limit`), not the larger of them alone: with a floor
all designs of a sweep of usual pitches sat on it, and their depths and noise did not count.

Nothing here makes a scene: columns of numbers in, columns out (`twin.theory.limit`). The camera is taken on its axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.parts.sweep import GF
from twin.study.sweep.designs import Designs, kept_count
from twin.study.sweep.noise import shift_sd
from twin.study.sweep.view import View
from twin.theory.limit import design_limit


@dataclass(frozen=True, kw_only=True)
class Closed:
    """What the closed form says of m designs.

    Attributes
    ----------
    columns
        (m,) numbers by metric; NaN for designs that are dropped.
    reason
        (m,) why a design is dropped; empty otherwise.
    """

    columns: dict[str, Floats]
    reason: np.ndarray


def closed(designs: Designs) -> Closed:
    """Return the design limit of all designs.

    Raises
    ------
    RecipeError
        The noise can't be told.
    """
    scene, sweep, count = designs.scene, designs.sweep, len(designs)
    reason = np.full(count, "", dtype=object)
    depths, pitches, noises, markers = [], [], [], np.zeros(count)
    base_z = designs.numbers("body.thickness_mm", scene.body.base_z_mm)
    for name, layer in scene.markers.items():
        depth = designs.numbers(f"markers.{name}.depth_mm", layer.depth_mm)
        pitch = designs.numbers(f"markers.{name}.pitch_mm", layer.pitch_mm)
        diameter = designs.numbers(f"markers.{name}.diameter_mm", layer.diameter_mm)
        kept = sweep.keep_extent
        columns, rows = (
            kept_count(each, layer.pitch_mm, pitch)
            if kept and not designs.swept(f"markers.{name}.{key}")
            else designs.numbers(f"markers.{name}.{key}", each)
            for key, each in (("columns", layer.columns), ("rows", layer.rows))
        )
        markers += columns * rows
        radius = diameter / 2 if layer.kind == "bead" else np.zeros(count)
        _drop(reason, radius > depth, f"markers.{name}: larger than its depth, it sticks out of the surface")
        _drop(reason, depth + radius > base_z, f"markers.{name}: deeper than the body is thick")
        _drop(reason, diameter >= pitch, f"markers.{name}: diameter of its pitch or more, neighbours touch")
        scale = axis_scale(designs, depth)
        noise = np.full(count, sweep.noise_px) if sweep.noise_px else shift_sd(scene, name, diameter * scale)
        depths.append(depth)
        pitches.append(pitch)
        noises.append(noise / scale)
    good = np.flatnonzero(reason == "")
    names = ("fwhm_mm", "two_point_mm", "resolution_gf")
    found = {name: np.full(count, np.nan) for name in names}
    if len(good):
        limit = design_limit(
            depth_mm=np.column_stack(depths)[good], pitch_mm=np.column_stack(pitches)[good],
            noise_mm=np.column_stack(noises)[good],
            youngs_modulus_mpa=designs.numbers("material.youngs_modulus_mpa", scene.material.youngs_modulus_mpa)[good],
            poisson_ratio=designs.numbers("material.poisson_ratio", scene.material.poisson_ratio)[good],
            force_n=np.array(sweep.loads.force_n), radius_mm=np.array(sweep.loads.size_mm / np.sqrt(np.pi)),
            sampling="squares",
        )  # fmt: skip
        for name, values in zip(names, (limit.fwhm_normal_mm, limit.two_point_mm, limit.force_sd_n / GF), strict=True):
            found[name][good] = values
    found["total_force_error"] = found["resolution_gf"] * GF / sweep.loads.force_n
    pixels = designs.numbers("camera.width_px", 0.0 if scene.camera is None else scene.camera.width_px) * (
        designs.numbers("camera.height_px", 0.0 if scene.camera is None else scene.camera.height_px)
    )
    found["markers"] = markers
    found["cost"] = sweep.cost.base + sweep.cost.marker * markers + sweep.cost.megapixel * pixels / 1e6
    return Closed(columns=found, reason=reason)


def axis_scale(designs: Designs, depth_mm: Floats) -> Floats:
    """Return (m,) px/mm across the optical axis at depths: focal length over apparent distance (Snell, paraxial)."""
    scene = designs.scene
    camera = scene.camera
    if camera is None:
        return np.ones(len(depth_mm))
    base_z = designs.numbers("body.thickness_mm", scene.body.base_z_mm)
    index = designs.numbers("material.refractive_index", scene.material.refractive_index)
    layers = sum(layer.thickness_mm for layer in camera.layers)
    air: Floats = np.full(len(depth_mm), camera.pupil_mm[2]) - scene.body.base_z_mm - layers
    if designs.swept("camera.pupil_mm"):
        air = np.array([p[2] for p in designs.columns["camera.pupil_mm"]], float) - base_z - layers
    elif designs.swept("body.thickness_mm"):
        air = camera.pupil_mm[2] - base_z - layers
    apparent = air + sum(layer.thickness_mm / layer.index for layer in camera.layers) + (base_z - depth_mm) / index
    return np.asarray(designs.numbers("camera.focal_px", camera.focal_px) / np.maximum(apparent, 1e-6))


def dropped_by_view(view: View, overlap: float, seen: float) -> str:
    """Return why a design's picture rules it out; empty if it does not.

    Parameters
    ----------
    view
        How the nominal camera sees the design.
    overlap, seen
        See `twin.parts.sweep.Limits`.
    """
    if view.inside.mean() < seen:
        return f"only {100 * view.inside.mean():.0f} % of the markers are inside the picture"
    if view.hidden.mean() > overlap:
        return f"{100 * view.hidden.mean():.0f} % of the markers overlap another one in the picture"
    return ""


def _drop(reason: np.ndarray, bad: np.ndarray, why: str) -> None:
    reason[bad & (reason == "")] = why
