"""The first fidelity: the closed-form design limit of every design.

Columns of numbers in, columns out (`twin.theory.limit`): no scene is made, so a hundred thousand
designs take a second. The camera is taken on its axis. Pitch and noise widen the point response
together, not the larger of them alone.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.parts.sweep import GF
from twin.study.doubts import shift_sd
from twin.study.sweep.designs import Designs, kept_count
from twin.theory.limit import design_limit


def closed(designs: Designs) -> tuple[dict[str, Floats], np.ndarray]:
    """Return the closed form's figures of m designs.

    Returns
    -------
    (m,) numbers by metric, NaN for designs that are dropped; and (m,) why a design is dropped,
    empty otherwise.

    Raises
    ------
    RecipeError
        The noise of this camera has no closed form.
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
        for bad, why in (
            (radius > depth, "larger than its depth, it sticks out of the surface"),
            (depth + radius > base_z, "deeper than the body is thick"),
            (diameter >= pitch, "diameter of its pitch or more, neighbours touch"),
        ):
            reason[bad & (reason == "")] = f"markers.{name}: {why}"
        scale = _axis_scale(designs, depth)
        if sweep.noise_px:
            noise = np.full(count, sweep.noise_px)
        else:
            noise = shift_sd(scene, name, diameter * scale)
        depths.append(depth)
        pitches.append(pitch)
        noises.append(noise / scale)
    good, material = np.flatnonzero(reason == ""), scene.material
    found = {name: np.full(count, np.nan) for name in ("fwhm_mm", "two_point_mm", "resolution_gf")}
    if len(good):
        modulus = designs.numbers("material.youngs_modulus_mpa", material.youngs_modulus_mpa)
        ratio = designs.numbers("material.poisson_ratio", material.poisson_ratio)
        limit = design_limit(
            depth_mm=np.column_stack(depths)[good],
            pitch_mm=np.column_stack(pitches)[good],
            noise_mm=np.column_stack(noises)[good],
            youngs_modulus_mpa=modulus[good],
            poisson_ratio=ratio[good],
            force_n=np.array(sweep.loads.force_n),
            radius_mm=np.array(sweep.loads.size_mm / np.sqrt(np.pi)),
            sampling="squares",
        )
        found["fwhm_mm"][good] = limit.fwhm_normal_mm
        found["two_point_mm"][good] = limit.two_point_mm
        found["resolution_gf"][good] = limit.force_sd_n / GF
    found["total_force_error"] = found["resolution_gf"] * GF / sweep.loads.force_n
    width, height = (
        (0, 0) if scene.camera is None else (scene.camera.width_px, scene.camera.height_px)
    )
    pixels = designs.numbers("camera.width_px", width) * designs.numbers("camera.height_px", height)
    cost = sweep.cost
    found["markers"] = markers
    found["cost"] = cost.base + cost.marker * markers + cost.megapixel * pixels / 1e6
    return found, reason


def _axis_scale(designs: Designs, depth_mm: Floats) -> Floats:
    """Return (m,) px/mm across the optical axis at depths: focal length over apparent distance
    (Snell, paraxial)."""
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
    apparent = (
        air
        + sum(layer.thickness_mm / layer.index for layer in camera.layers)
        + (base_z - depth_mm) / index
    )
    return np.asarray(
        designs.numbers("camera.focal_px", camera.focal_px) / np.maximum(apparent, 1e-6)
    )
