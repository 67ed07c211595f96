"""The noise of a marker's shift before any picture is made: the Cramer-Rao bound and what a tracker adds to it."""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.theory.centroid import centre_bound, pixel_sd

FULL_SCALE = 255.0

FACTOR = {"bead": 1.05, "print": 1.0}
"""Noise of a tracked shift over the bound of one even disc, by kind of marker: beads darken towards their rim, and
light is not even. Measured by ``python -m benchmarks sweep``."""

MODEL_PX = {"bead": 0.003, "print": 0.0015}
"""What pictures change besides moving (shading, strain, what `twin.study.sweep.shadows` does not tell of shadows), as a
standard deviation, px. Measured likewise."""


def can_tell(scene: Scene) -> bool:
    """Return whether the closed form knows this camera: one without mosaic, video and compression."""
    ccd = scene.ccd.spelt_out()
    return ccd.bayer == "none" and ccd.bandwidth_mhz is None and ccd.jpeg_quality is None and not ccd.interlace


def shift_sd(scene: Scene, layer: str, diameter_px: Floats) -> Floats:
    """Return (n,) standard deviations of a shift (two pictures), per axis, of markers of a layer, px.

    Raises
    ------
    RecipeError
        The camera is one that the closed form does not know.
    """
    kind = scene.markers[layer].kind
    return np.asarray(np.hypot(FACTOR[kind] * shift_bound(scene, layer, diameter_px), MODEL_PX[kind]))


def shift_bound(scene: Scene, layer: str, diameter_px: Floats) -> Floats:
    """Return (n,) the least standard deviations of a shift that the pictures' noise allows, per axis, px.

    Raises
    ------
    RecipeError
        The camera is one that the closed form does not know.
    """
    if not can_tell(scene):
        raise RecipeError(
            f"noise_px: there is no closed form of the noise of ccd.preset = '{scene.ccd.preset}' (mosaic, video or "
            "compression); give noise_px in the sweep, as twin run measures it (sd_px)"
        )
    psf_px = scene.ccd.spelt_out().psf_px
    assert psf_px is not None
    contrast, noise = pixel_noise(scene, layer, height=0.5)
    if contrast == 0:  # black markers tell nothing
        return np.full(np.shape(diameter_px), np.inf)
    return np.asarray(np.sqrt(2.0) * centre_bound(np.maximum(diameter_px, 1e-3), contrast, psf_px, noise))


def pixel_noise(scene: Scene, layer: str, height: float) -> tuple[float, float]:
    """Return the contrast of a layer's markers (0 where all are black), and the standard deviation of a pixel at a
    height of their rim (1 is inside), counts."""
    ccd = scene.ccd.spelt_out()
    assert ccd.full_well_e is not None
    assert ccd.read_noise_e is not None
    marker = scene.markers[layer]
    brightest = max(max(each.colour) for each in scene.markers.values())
    if brightest == 0:
        return 0.0, 1.0
    white = min(ccd.white_dn * ccd.exposure, FULL_SCALE) / brightest
    dark = max(scene.cover.albedo) if scene.cover is not None else 0.03
    ground, contrast = white * dark, white * max(max(marker.colour) - dark, 1e-3)
    if not ccd.noise:
        return contrast, 0.3
    return contrast, pixel_sd(height * contrast + ground, FULL_SCALE, ccd.full_well_e, ccd.read_noise_e)
