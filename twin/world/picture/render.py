"""The picture as light: markers by Mitsuba, or without it, seen through folded optics.

The one module that imports Mitsuba and Dr.Jit, and only for a variant of theirs.

The literal scene (camera and LEDs in air, dielectric plates between) gives black or noisy pictures, so the optics are
folded: camera rays start inside the body with Snell's exact directions, and LEDs shine from their virtual images.
Mitsuba holds all markers in one ``ellipsoids`` shape; camera and shadow rays are traced on a fixed k x k grid in every
pixel near a marker. Moving markers rewrites that shape's numbers: nothing is rebuilt or recompiled.

Why not plain hits: a hard edge on a k x k grid is off by 0.15 k^-1.5 R^-0.5 px in the centroid of a disc of R px, which
is as much as the camera's noise. So camera rays look for ellipsoids that are larger by a sub-pixel, and the share that
the true one covers follows from the ray's distance to its silhouette: ten times smaller errors for the same rays.

Why a fixed grid and no sampler: random samples make centroids 3 to 5 times worse. Why our own loop: the sum over LEDs
is analytic, so stock path tracing is some ten times slower at equal centroid error.

Units inside Mitsuba: the median marker radius is 1 and rays start just behind the markers that they may meet, because
the intersection with an ellipsoid loses digits in float32 when it is thin or far: rays from the base lose up to a third
of a thin print in the finger.

Validity: markers at least a sub-pixel in radius. Defocus is the mean of pictures through points of the pupil
(`twin.world.picture.defocus`); outlines are those through its middle.
"""

from __future__ import annotations

import importlib
import os
import sys
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Floats, Ints, Pixels, Singles, frozen
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.theory.optics import project, sight
from twin.world.picture.cover import Background, CoverMotion
from twin.world.picture.defocus import PUPIL_WEIGHTS, through_the_pupil
from twin.world.picture.exposure import white_level
from twin.world.picture.frame import WEIGHT, Frame, make_frame
from twin.world.picture.lighting import brightest
from twin.world.picture.maps import NONE, PictureTruth, marker_map
from twin.world.picture.markers import Ellipsoids
from twin.world.picture.rays import RayByRay
from twin.world.picture.splat import Shaded, Splat
from twin.world.picture.variant import FORCE, Variant, choose_variant
from twin.world.picture.view import compose, look
from twin.world.picture.wavefront import Wavefront

_HIDDEN = 0.01
"""A smaller share of an outline that is seen counts as none: edges just behind edges leave such specks."""

_ERROR_PX = {"splat": (0.0215, 0.0095, 0.0052, 0.0038), "traced": (0.033, 0.0148, 0.0107, 0.0096)}
"""The largest error of an intensity centroid for k = 1 to 4; beyond, the splat's falls as 1/k."""

_FINEST = 16
"""The largest k."""

_SHADOW_PX = 0.2
"""The most that a shadow moves a centroid."""


@dataclass(frozen=True, kw_only=True)
class Outlines:
    """Visible outlines of the markers, in their one order.

    Attributes
    ----------
    centroid_px
        (n, 2) coverage centroid of what is seen of each marker; NaN where nothing is.
    visible
        (n,) share of the whole outline that is seen: 1 free, 0 hidden, lost or outside the picture.
    area_px
        (n,) area that is seen, px^2.
    """

    centroid_px: Pixels
    visible: Floats
    area_px: Floats


class Renderer:
    """Renders one sensor's markers again and again.

    Parameters
    ----------
    scene
        The actual scene; camera, light and markers are needed.
    rest
        The markers at rest, by which the exposure is set.
    variant
        How to render; None: the best for ``accuracy.centroid_px`` that works here.
    subpixels
        k of the k x k rays per pixel; None: from ``accuracy.centroid_px``.
    shadows
        Whether markers shadow each other: without, pictures cost less and centroids are up to 0.2 px off; None: unless
        ``accuracy.centroid_px`` allows for that.

    Raises
    ------
    RecipeError
        The scene has no camera, or no light reaches the markers.
    """

    def __init__(
        self,
        scene: Scene,
        rest: Ellipsoids,
        variant: Variant | None = None,
        subpixels: int | None = None,
        shadows: bool | None = None,
    ) -> None:
        if scene.camera is None or scene.light is None or not scene.markers:
            raise RecipeError("camera: a scene without camera, light and markers has no picture: add these tables")
        self.scene = scene
        wanted = scene.accuracy.centroid_px
        self.variant = variant or method_for(wanted)
        needed = isinstance(wanted, str) or wanted < centroid_error(1, False, self.variant.name)
        self.shadows = needed if shadows is None else shadows
        self.subpixels = subpixels or subpixels_for(wanted, self.variant.name)
        self._top, white = brightest(rest, scene)
        self._gain = white_level(scene.ccd) / white
        self._unit = float(np.median([layer.diameter_mm / 2 for layer in scene.markers.values()]))
        self._view = look(scene, self._top, self._gain)
        self._tracer = self._make_tracer(scene.light.ambient)
        self._pupils = [
            Renderer(scene.model_copy(update={"camera": camera}), rest, self.variant, self.subpixels, self.shadows)
            for camera in through_the_pupil(scene)
        ]

    def _make_tracer(self, ambient: float) -> Splat | Wavefront | RayByRay:
        """Return what traces rays in our variant."""
        if self.variant.name == "splat":
            return self._splat
        self._switch()
        mi = importlib.import_module("mitsuba")
        if self.variant.name == "scalar_rgb":
            return RayByRay(mi, self._view, self._unit, ambient)
        return Wavefront(mi, importlib.import_module("drjit"), self._view, self._unit, ambient)

    @cached_property
    def _splat(self) -> Splat:
        """What tells outlines, whatever traces the picture."""
        assert self.scene.light is not None
        return Splat(self._view, self._unit, self.scene.light.ambient)

    @property
    def centroid_error_px(self) -> float:
        """Bound on the error of intensity centroids in the noise-free picture, px."""
        return centroid_error(self.subpixels, self.shadows, self.variant.name)

    @cached_property
    def background(self) -> Background | None:
        """The cover's places whose motion `radiance` wants; None for a cover that stays at rest."""
        cover = self.scene.cover
        return Background(self.scene, self._top) if cover is not None and cover.deforms else None

    def radiance(self, markers: Ellipsoids, cover: CoverMotion | None = None) -> Singles:
        """Return the (height, width, 3) light on the sensor, 1 filling its wells.

        ``cover`` says how the places of `background` have moved; None: they are at rest.

        The exposure is set at rest, where the brightest marker has ``ccd.white_dn`` (before blur and noise).
        """
        factor = self.background.change(cover) if cover is not None and self.background is not None else None
        if not self._pupils:
            return self._render(markers, factor)
        light: Singles = np.zeros_like(self._view.cover)
        for weight, part in zip(PUPIL_WEIGHTS, self._pupils, strict=True):
            light += np.float32(weight) * part._render(markers, factor)
        return light

    def seen(self, markers: Ellipsoids, cover: CoverMotion | None = None) -> tuple[Singles, Outlines]:
        """Return `radiance` and `outlines`, of one preparation, and in one pass where the splat draws the picture."""
        if self._pupils:
            return self.radiance(markers, cover), self.outlines(markers)
        frame = self._frame(markers, self.subpixels)
        factor = self.background.change(cover) if cover is not None and self.background is not None else None
        if self._tracer is not self._splat:
            return self._traced(frame, factor), _outlines(frame, self._splat.look(frame, bright=False))
        shaded = self._splat.look(frame)
        return self._over_cover(frame, shaded.light, shaded.free, factor), _outlines(frame, shaded)

    def _render(self, markers: Ellipsoids, factor: Singles | None) -> Singles:
        return self._traced(self._frame(markers, self.subpixels), factor)

    def _traced(self, frame: Frame, factor: Singles | None) -> Singles:
        if not len(frame.near.pixels):
            return self._over_cover(frame, np.zeros((0, 3), np.float32), np.zeros(0, np.float32), factor)
        return self._over_cover(frame, *self._tracer.shade(frame), factor)

    def _over_cover(self, frame: Frame, marks: Singles, free: Singles, factor: Singles | None) -> Singles:
        light = self._view.cover.copy()
        if factor is not None:
            light *= factor[:, :, None]
        compose(light, frame.near.pixels, marks, free, self._view.vignette)
        if self._view.veil is not None:
            light += self._view.veil[:, :, None]
        return light

    def outlines(self, markers: Ellipsoids, subpixels: int | None = None) -> Outlines:
        """Return centroid, share and area of what the picture shows of each marker, in closed form.

        Parameters
        ----------
        markers
            The markers.
        subpixels
            Another k than the picture's.
        """
        frame = self._frame(markers, subpixels or self.subpixels, shadows=False)
        return _outlines(frame, self._splat.look(frame, bright=False))

    def truth(self, markers: Ellipsoids, rest: Ellipsoids, layer: Ints) -> PictureTruth:
        """Return the truth beside a picture of the markers.

        Parameters
        ----------
        markers, rest
            The markers now and at rest.
        layer
            (n,) numbers of the markers' layers.
        """
        camera = self.scene.camera
        assert camera is not None
        base = self.scene.body.base_z_mm
        optics = (camera, self.scene.material.refractive_index, base)
        marker, z_mm = marker_map(self._frame(markers, 1), self._splat.corners, base)
        here, there = self.outlines(markers), self.outlines(rest)
        centre = project(markers.centres, *optics)
        return PictureTruth(
            marker=frozen(marker),
            layer=frozen(np.where(marker >= 0, layer[marker], NONE).astype(np.int8)),
            z_mm=frozen(z_mm),
            centre_px=frozen(centre),
            outline_px=here.centroid_px,
            visible=here.visible,
            area_px=here.area_px,
            flow_px=frozen(centre - project(rest.centres, *optics)),
            outline_flow_px=frozen(here.centroid_px - there.centroid_px),
            depth_mm=frozen(base - markers.centres[:, 2]),
            sight=frozen(sight(markers.centres, *optics)),
            centroid_error_px=self.centroid_error_px,
        )

    def _frame(self, markers: Ellipsoids, subpixels: int, *, shadows: bool = True) -> Frame:
        self._switch()
        return make_frame(
            markers,
            self.scene,
            self._view,
            unit_mm=self._unit,
            full_power=self._top,
            subpixels=subpixels,
            shadows=self.shadows and shadows,
        )

    def _switch(self) -> None:
        """Switch Mitsuba to our variant: the switch is global, and another renderer may have turned it."""
        if self.variant.name != "splat":
            mi = importlib.import_module("mitsuba")
            if mi.variant() != self.variant.name:
                mi.set_variant(self.variant.name)


def _outlines(frame: Frame, shaded: Shaded) -> Outlines:
    near, k = frame.near, frame.subpixels
    area = shaded.seen / (k * k * WEIGHT)
    expected = shaded.whole / (k * k * WEIGHT)
    first_order = np.pi * np.sqrt(np.linalg.det(near.conjugate))
    expected = np.where(near.cut, np.maximum(expected, first_order), expected)
    seen = np.where(area >= _HIDDEN * expected, shaded.seen, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        centroid = np.rint(near.centres_px) + (shaded.moments / seen[:, None] + 0.5) / k - 0.5
        centroid = np.where(seen[:, None] > 0, centroid, np.nan)
        visible = np.where(seen > 0, np.minimum(area / expected, 1.0), 0.0)
    area = np.where(seen > 0, area, 0.0)
    for array in (centroid, visible, area):
        frozen(array)
    return Outlines(centroid_px=centroid, visible=visible, area_px=area)


def one_thread() -> None:
    """Trace in one thread from here on: many processes that render beside each other are faster so."""
    if (drjit := sys.modules.get("drjit")) is not None:
        drjit.set_thread_count(1)


def subpixels_for(centroid_px: float | str, method: str = "splat") -> int:
    """Return the k whose largest centroid error is ``centroid_px``; ``auto`` is 3, below the noise of one exposure."""
    if isinstance(centroid_px, str):
        return 3
    enough = (k for k in range(1, _FINEST) if centroid_error(k, True, method) <= centroid_px)
    return next(enough, _FINEST)


def centroid_error(subpixels: int, shadows: bool, method: str = "splat") -> float:
    """Return a bound on the error of intensity centroids, px.

    Notes
    -----
    Measured for both sensors (picture benchmark), most of it from the edges of shadows. Those of Mitsuba's rays are
    hard, so that finer grids than 4 x 4 were not always better there. Without shadows centroids are up to 0.2 px off.
    """
    bounds = _ERROR_PX["splat" if method == "splat" else "traced"]
    beyond = min(len(bounds) / subpixels, 1.0) if method == "splat" else 1.0
    return bounds[min(subpixels, len(bounds)) - 1] * beyond + (0.0 if shadows else _SHADOW_PX)


def method_for(centroid_px: float | str) -> Variant:
    """Return how to render at a given accuracy: the cheapest way for a number, Mitsuba where it can for ``auto``."""
    if isinstance(centroid_px, str) or os.environ.get(FORCE):
        return choose_variant()
    return Variant(name="splat", library=None, reason=f"cheapest for accuracy.centroid_px = {centroid_px:g}")
