"""The sensor as it was made: the drawing plus what its maker did not control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Chart, frozen
from twin.parts.markers import MarkerSet, Prints, place
from twin.parts.scene import Scene
from twin.parts.tolerance import CUT
from twin.streams import Purpose, stream


@dataclass(frozen=True, kw_only=True)
class Actual:
    """One made sensor.

    Attributes
    ----------
    scene
        The scene with the actual numbers in place of the nominal ones.
    jitter_mm
        (n, 2) print errors of the markers along the surface, mm.
    markers
        All markers at their actual rest places.
    prints
        What the maker did to single markers; None for nothing.
    """

    scene: Scene
    jitter_mm: Chart
    markers: MarkerSet
    prints: Prints | None = None


def make(nominal: Scene) -> Actual:
    """Draw the actual sensor of ``nominal`` from its tolerances and seed."""
    tolerance = nominal.tolerance
    count = sum(layer.columns * layer.rows for layer in nominal.markers.values())
    if tolerance.preset == "none":
        jitter = np.zeros((count, 2))
        return Actual(scene=nominal, jitter_mm=frozen(jitter), markers=place(nominal.body, nominal.markers))
    rng = stream(nominal.seed, Purpose.TOLERANCE)
    material = nominal.material.model_copy(
        update={
            "youngs_modulus_mpa": nominal.material.youngs_modulus_mpa
            * (1 + tolerance.youngs_modulus_pct / 100 * _deviation(rng)),
            "poisson_ratio": max(-0.5, nominal.material.poisson_ratio - tolerance.poisson_ratio * abs(_deviation(rng))),
        }
    )
    cover = nominal.cover
    if cover is not None and cover.youngs_modulus_mpa is not None:
        stiffer = material.youngs_modulus_mpa / nominal.material.youngs_modulus_mpa
        cover = cover.model_copy(update={"youngs_modulus_mpa": cover.youngs_modulus_mpa * stiffer})
    markers = {
        name: layer.model_copy(update={"depth_mm": layer.depth_mm + tolerance.depth_mm * _deviation(rng)})
        for name, layer in nominal.markers.items()
    }
    camera = nominal.camera
    if camera is not None:
        x, y, z = (c + tolerance.pupil_mm * _deviation(rng) for c in camera.pupil_mm)
        front = nominal.body.base_z_mm + sum(layer.thickness_mm for layer in camera.layers)
        a, b, c = (t + tolerance.tilt_deg * _deviation(rng) for t in camera.tilt_deg)
        focal = camera.focal_px * (1 + tolerance.focal_pct / 100 * _deviation(rng))
        k1, k2, *others = camera.distortion or (0.0, 0.0)
        k1 += tolerance.distortion * _deviation(rng) if tolerance.distortion else 0.0
        pose = {"pupil_mm": (x, y, max(z, front)), "tilt_deg": (a, b, c), "focal_px": focal}
        camera = camera.model_copy(update={**pose, "distortion": (k1, k2, *others)})
    scene = nominal.model_copy(update={"material": material, "cover": cover, "markers": markers, "camera": camera})
    noise = stream(nominal.seed, Purpose.PRINT).standard_normal((count, 2))
    jitter = tolerance.print_mm * np.clip(noise, -CUT, CUT)
    return Actual(
        scene=scene,
        jitter_mm=frozen(jitter),
        markers=place(nominal.body, markers, jitter),
        prints=_prints(nominal, count),
    )


def _prints(nominal: Scene, count: int) -> Prints | None:
    """Draw sizes, shades and losses of the markers, from a stream of their own."""
    tolerance = nominal.tolerance
    if tolerance.print_diameter_pct == tolerance.print_shade_pct == tolerance.missing == 0:
        return None
    rng = stream(nominal.seed, Purpose.PRINT, 1)
    size, shade = (1 + pct / 100 * np.clip(rng.standard_normal(count), -CUT, CUT)
                   for pct in (tolerance.print_diameter_pct, tolerance.print_shade_pct))  # fmt: skip
    missing = rng.random(count) < tolerance.missing
    return Prints(size=frozen(size), shade=frozen(shade), missing=frozen(missing))


def _deviation(rng: np.random.Generator) -> float:
    return float(np.clip(rng.standard_normal(), -CUT, CUT))


def shared_by_truth_and_estimate(scene: Scene) -> list[str]:
    """Return what the sensor's software knows exactly, because truth and nominal design share it."""
    shared = [
        "shape of the body, and that it is homogeneous, linear and bonded at its base",
        "number, order, pitch and diameter of the markers",
        "refractive indices and thicknesses of the layers in front of the camera",
        "closed-form half-space part of the elastic field (its finite-element correction lives on another mesh)",
    ]
    if not scene.tolerance.distortion:
        shared.append("lens model without distortion error")
    if not any(layer.stiff for layer in scene.markers.values()):
        shared.append("that markers are points which the rubber carries (beads in a block can be stiff)")
    if scene.tolerance.preset == "none":
        shared += ["every nominal number: tolerance.preset is none"]
    return shared
