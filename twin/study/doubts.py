"""Warnings about a scene: values that can be computed, but that no real sensor has.

`doubts` returns them, each with key, value, usual range and remedy. Such scenes are not refused;
mostly a length was given in m, a modulus in kPa or a force in mN. What can't exist at all is
refused where it is read (`twin.parts`).

`View.of` has the places and sizes of the markers in the nominal picture, `shift_sd` and
`View.noise_bound` the expected noise of their shifts.

Validity: usual ranges are those of rubbers, markers and cameras of tactile sensors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Pixels
from twin.errors import RecipeError
from twin.parts.camera import FULL_SCALE
from twin.parts.markers import MarkerSet
from twin.parts.scene import Scene
from twin.parts.vary import CUT
from twin.theory.optics import centre_bound, project_with_jacobian

_FACTOR = {"bead": 1.05, "print": 1.0}
"""Noise of a tracked shift over the bound of one even disc, by kind of marker: beads darken towards
their rim, and light is not even. Measured by ``python -m benchmarks sweep``."""

_MODEL_PX = {"bead": 0.003, "print": 0.0015}
"""Change of a marker's picture apart from its motion (shading, strain, residual shadows), as a
standard deviation, px. Measured likewise."""

_RUBBER_MPA = (0.003, 50.0)
"""Young's modulus from the softest silicone gels, some kPa, to the hardest rubbers: Shore A 95 is
44 MPa (A. N. Gent 1958)."""

LEAST_PX = 3.0
"""Width of a marker in the picture below which no pixel shows it alone: a pixel's diagonal and
twice a blur of 0.7 px."""

_SPARSE = 0.8
"""Pitch of a single layer over the rubber's thickness above which a warning is due. On five pads
below (49 presses) errors of the total are 1.0 times those stated (root mean square); at 1.0
(9 presses) those along the surface are 1.8 times, up to 4."""

_MOST_OUTSIDE, _MOST_HIDDEN = 0.5, 0.5
"""Share of the markers outside the picture, and of those inside behind others."""

_WIDEST = 0.5
"""Of a marker in the picture, over the shorter side of the picture."""

_BODY_MM = (2.0, 500.0)
"""Longest side of a body."""

_NARROWEST_MM = 0.1
"""A probe narrower than this is a needle."""

_MOST_PRESSURE = 1.0
"""Force over the square of a probe's width and Young's modulus; no shipped press reaches 0.3."""

_SITES_MM = (0.1, 10.0)
"""Pitch of the sites: a tenth of the least depth of markers, and the width of a finger."""

_MOST_FRICTION = 5.0
"""Of rubber on anything, stuck contact excepted."""

_EXPOSED_DN = (20.0, 510.0)
"""Usual counts of the brightest marker: from a tenth of the usual to twice the largest count."""


def _knows_noise(scene: Scene) -> bool:
    """Return whether the closed form of the noise holds: no mosaic, video or compression."""
    ccd = scene.ccd.spelt_out()
    return (
        ccd.bayer == "none" and ccd.bandwidth_mhz == ccd.jpeg_quality == "off" and not ccd.interlace
    )


def shift_sd(scene: Scene, layer: str, diameter_px: Floats) -> Floats:
    """Return (n,) standard deviations, px per axis, of a shift (two pictures) of a layer's markers.

    Raises
    ------
    RecipeError
        The closed form does not hold for this camera.
    """
    kind = scene.markers[layer].kind
    bound = _shift_bound(scene, layer, diameter_px)
    return np.asarray(np.hypot(_FACTOR[kind] * bound, _MODEL_PX[kind]))


def _shift_bound(scene: Scene, layer: str, diameter_px: Floats) -> Floats:
    """Return the Cramer-Rao bound of `shift_sd`, (n,), px per axis; raises as that does."""
    if not _knows_noise(scene):
        raise RecipeError(
            f"noise_px: there is no closed form of the noise of ccd.preset = '{scene.ccd.preset}' "
            "(mosaic, video or compression); give noise_px in the sweep, as twin run measures it "
            "(sd_px)"
        )
    psf_px = scene.ccd.spelt_out().psf_px
    assert psf_px is not None
    contrast, noise = _edge_noise(scene, layer)
    if contrast == 0:  # black markers
        return np.full(np.shape(diameter_px), np.inf)
    bound = centre_bound(np.maximum(diameter_px, 1e-3), contrast, psf_px, noise)
    return np.asarray(np.sqrt(2.0) * bound)


def _edge_noise(scene: Scene, layer: str, channel: int | None = None) -> tuple[float, float]:
    """Return a layer's contrast (0 where everything is black) and the standard deviation of a
    pixel half on the marker, counts; in the brightest channel of each, or in one."""
    ccd = scene.ccd.spelt_out()
    colour = scene.markers[layer].colour
    albedo = scene.cover.albedo if scene.cover is not None else (0.03, 0.03, 0.03)
    brightest = max(*albedo, *(max(each.colour) for each in scene.markers.values()))
    if brightest == 0:
        return 0.0, 1.0
    white = min(ccd.white_dn * ccd.exposure, FULL_SCALE) / brightest
    ground = white * (max(albedo) if channel is None else albedo[channel])
    inside = white * (max(colour) if channel is None else colour[channel])
    contrast = max(abs(inside - ground), 1e-3 * white)
    if not ccd.noise:
        return contrast, 0.3
    return contrast, ccd.pixel_sd((inside + ground) / 2)


@dataclass(frozen=True, kw_only=True)
class View:
    """The nominal markers in the nominal camera's picture.

    Attributes
    ----------
    markers, pixels, jacobian, diameter_px
        All markers, their (n, 2) places, px, (n, 2, 3) Jacobians, px/mm, and (n,) widths, px.
    inside, hidden
        (n,) whether the whole marker lies in the picture, and whether it overlaps one that is
        nearer to the camera, or another of its layer.
    """

    markers: MarkerSet
    pixels: Pixels
    jacobian: Floats
    diameter_px: Floats
    inside: Bools
    hidden: Bools

    @property
    def usable(self) -> Bools:
        """(n,) markers that a tracker can measure."""
        return np.asarray(self.inside & ~self.hidden)

    @classmethod
    def of(cls, scene: Scene) -> View:
        """Return the nominal markers in the nominal camera's picture.

        Raises a `RecipeError` without a camera, or where a marker lies outside the body.
        """
        from scipy.spatial import cKDTree

        if scene.camera is None:
            raise RecipeError("this scene has no [camera] table: designs are seen by a camera")
        camera = scene.camera
        markers = MarkerSet.place(scene.body, scene.markers)
        pixels, jacobian = project_with_jacobian(markers.points, *scene.optics)
        # Width in the picture: the square root of the determinant is the mean magnification.
        across = np.sqrt(np.abs(np.linalg.det(jacobian[:, :, :2])))
        width = np.array([scene.markers[str(name)].diameter_mm for name in markers.layer]) * across
        half = width[:, None] / 2
        end = (camera.width_px - 0.5, camera.height_px - 0.5)
        with np.errstate(invalid="ignore"):
            inside = ((pixels - half > -0.5) & (pixels + half < end)).all(axis=1)
        inside &= np.isfinite(jacobian).all(axis=(1, 2))
        # Of two markers that overlap in the picture, the one nearer to the surface is hidden: the
        # camera looks from behind.
        hidden = np.zeros(len(markers), bool)
        known = np.flatnonzero(inside)
        if len(known) > 1:
            pairs = cKDTree(pixels[known]).query_pairs(
                float(width[known].max()), output_type="ndarray"
            )
            a, b = known[pairs[:, 0]], known[pairs[:, 1]]
            near = np.linalg.norm(pixels[a] - pixels[b], axis=1) < (width[a] + width[b]) / 2
            a, b = a[near], b[near]
            hidden[np.where(markers.points[a, 2] < markers.points[b, 2], a, b)] = True
        return cls(
            markers=markers,
            pixels=pixels,
            jacobian=jacobian,
            diameter_px=width,
            inside=inside,
            hidden=hidden,
        )

    @staticmethod
    def noise_bound(scene: Scene) -> Floats | None:
        """Return the (n,) Cramer-Rao bounds of all nominal markers' shifts, px per axis, NaN where
        none is known; None where the closed form does not hold."""
        if scene.camera is None or not _knows_noise(scene) or not scene.ccd.spelt_out().noise:
            return None
        view = View.of(scene)
        bound = np.full(len(view.markers), np.nan)
        for name in scene.markers:
            rows = view.markers.layer == name
            # The information of the picture's channels adds up: their noise is independent.
            ratios = [np.divide(*_edge_noise(scene, name, each)) for each in (None, 0, 1, 2)]
            more = max(math.hypot(*ratios[1:]) / ratios[0], 1.0) if ratios[0] else 1.0
            one_channel = _shift_bound(scene, name, np.nan_to_num(view.diameter_px[rows]))
            bound[rows] = one_channel / more
        return np.where(np.isfinite(view.diameter_px), bound, np.nan)


def doubts(scene: Scene) -> list[str]:
    """Return a line for every value of a scene that is possible, but that no real sensor has."""
    found = [*_of_body(scene), *_of_markers(scene), *_of_press(scene)]
    return found + (list(_of_picture(scene)) if scene.camera is not None else [])


def _of_body(scene: Scene) -> Iterator[str]:
    moduli = {"material": scene.material.youngs_modulus_mpa}
    if scene.cover is not None and scene.cover.youngs_modulus_mpa is not None:
        moduli["cover"] = scene.cover.youngs_modulus_mpa
    for table, modulus in moduli.items():
        if not _RUBBER_MPA[0] <= modulus <= _RUBBER_MPA[1]:
            yield (
                f"{table}.youngs_modulus_mpa = {modulus:g} MPa: rubbers have {_range(_RUBBER_MPA)} "
                "MPa; 1 MPa = 1000 kPa = 1e6 Pa, so check the unit"
            )
    size = float(np.max(np.ptp(np.array(scene.body.bounds_mm), axis=0)))
    if not _BODY_MM[0] <= size <= _BODY_MM[1]:
        yield (
            f"body: its longest side is {size:.4g} mm, usual are {_range(_BODY_MM)} mm; lengths "
            "are in mm"
        )


def _of_markers(scene: Scene) -> Iterator[str]:
    tolerance = scene.tolerance
    for name, layer in scene.markers.items():
        many = max(layer.columns, layer.rows) > 1
        if many and layer.kind == "print" and layer.diameter_mm >= layer.pitch_mm:
            yield (
                f"markers.{name}.diameter_mm = {layer.diameter_mm:g} mm: the prints merge at "
                f"pitch_mm = {layer.pitch_mm:g} mm, and none can be found; take less than the pitch"
            )
        if scene.cover is not None and layer.depth_mm <= scene.cover.thickness_mm:
            yield (
                f"markers.{name}.depth_mm = {layer.depth_mm:g} mm: within the cover of "
                f"{scene.cover.thickness_mm:g} mm (cover.thickness_mm), which hides them; place "
                "them deeper"
            )
        sparse = layer.pitch_mm > _SPARSE * (scene.body.layer_mm or math.inf)
        if many and sparse and scene.reconstruction is not None and len(scene.markers) == 1:
            yield (
                f"markers.{name}.pitch_mm = {layer.pitch_mm:g} mm: sparse on rubber "
                f"{scene.body.layer_mm:g} mm thick (usual: up to {_SPARSE:g} of it); on such pads "
                "forces along the surface are 1.8 times as far off as stated; take a smaller pitch"
            )
        if scene.renderer == "path" and layer.gloss and layer.texture:
            yield (
                f"markers.{name}.texture: renderer = 'path' draws none below gloss; "
                "leave one out, or take another renderer"
            )
        if tolerance.preset == "none":
            continue
        if CUT * tolerance.depth_mm > layer.depth_mm:
            yield (
                f"tolerance.depth_mm = {tolerance.depth_mm:g} mm: {CUT:g} times that is more than "
                f"the depth of markers.{name} ({layer.depth_mm:g} mm); take at most "
                f"{layer.depth_mm / CUT:.3g} mm"
            )
        if many and CUT * tolerance.print_mm > layer.pitch_mm / 2:
            yield (
                f"tolerance.print_mm = {tolerance.print_mm:g} mm: {CUT:g} times that is more than "
                f"half the pitch of markers.{name} ({layer.pitch_mm:g} mm), so that neighbours "
                f"change places; take at most {layer.pitch_mm / 2 / CUT:.3g} mm"
            )


def _of_press(scene: Scene) -> Iterator[str]:
    if scene.reconstruction is not None:
        pitch = scene.reconstruction.sites.pitch_mm
        if not _SITES_MM[0] <= pitch <= _SITES_MM[1]:
            yield (
                f"reconstruction.sites.pitch_mm = {pitch:g} mm: usual are {_range(_SITES_MM)} mm; "
                "sites lie where forces are looked for, closer than the markers are deep"
            )
    for number, press in enumerate(scene.presses):
        key = f"press.also {number}" if number else "press"
        if press.width_mm < _NARROWEST_MM:
            yield (
                f"{key}.probe: {press.width_mm:g} mm wide, a needle (usual: "
                f"{_NARROWEST_MM:g} mm and more); lengths are in mm"
            )
        force = max(math.hypot(*(f or 0.0 for f in step.force_n)) for step in press.path)
        mean = force / press.width_mm**2 / scene.material.youngs_modulus_mpa
        if mean > _MOST_PRESSURE:
            yield (
                f"{key}.force_n: {force:g} N over {press.width_mm:g} mm is {mean:.2g} times "
                f"Young's modulus (usual: up to {_MOST_PRESSURE:g}); 1 gf is 0.00981 N"
            )
        if _MOST_FRICTION < press.friction < math.inf:
            yield (
                f"{key}.friction = {press.friction:g}: rubber reaches {_MOST_FRICTION:g} at most; "
                "it is a coefficient, no angle or percentage; give inf for a probe that sticks"
            )


def _of_picture(scene: Scene) -> Iterator[str]:
    view = View.of(scene)
    camera, _ = scene.imaging
    remedy = "check camera.focal_px (in px), pupil_mm (in mm), width_px and height_px"
    widest = _WIDEST * min(camera.width_px, camera.height_px)
    for name in scene.markers:
        own = view.markers.layer == name
        outside = 1.0 - float(view.inside[own].mean())
        if outside > _MOST_OUTSIDE:
            yield (
                f"markers.{name}: {100 * outside:.0f} % of them lie outside the picture (allowed "
                f"without a warning: {100 * _MOST_OUTSIDE:.0f} %); {remedy}, or take fewer or "
                "closer ones (columns, rows, pitch_mm)"
            )
        hidden = float(view.hidden[own & view.inside].mean()) if (own & view.inside).any() else 0.0
        if hidden > _MOST_HIDDEN:
            yield (
                f"markers.{name}: {100 * hidden:.0f} % of them overlap another marker in the "
                f"picture (allowed without a warning: {100 * _MOST_HIDDEN:.0f} %); change "
                "diameter_mm or offset_mm"
            )
        known = view.diameter_px[own & np.isfinite(view.diameter_px)]
        typical = float(np.median(known)) if len(known) else LEAST_PX
        if not LEAST_PX <= typical <= widest:
            yield (
                f"markers.{name}.diameter_mm: {typical:.3g} px wide in the picture (usual: "
                f"{LEAST_PX:g} to {widest:g} px); {remedy}, or change the diameter"
            )
    white = scene.ccd.white_dn * scene.ccd.exposure
    if not _EXPOSED_DN[0] <= white <= _EXPOSED_DN[1]:
        yield (
            f"ccd.white_dn * ccd.exposure = {white:.4g} counts for the brightest marker: a "
            f"picture has 0 to 255 (usual: {_range(_EXPOSED_DN)}); exposure is a factor, 1 is right"
        )


def _range(limits: tuple[float, float]) -> str:
    return f"{limits[0]:g} to {limits[1]:g}"
