"""The picture as light: markers by Mitsuba, seen through folded optics. The one module that uses Mitsuba and Dr.Jit.

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

Validity: markers at least a sub-pixel in radius; sharp focus; the cover's bulge under a press is not shown.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Floats, Pixels, frozen
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.world.exposure import white_level
from twin.world.frame import NOWHERE, WEIGHT, Frame, Singles, make_frame
from twin.world.lighting import brightest
from twin.world.markers import Ellipsoids
from twin.world.rays import RayByRay
from twin.world.variant import Variant, choose_variant
from twin.world.view import look
from twin.world.wavefront import Wavefront

_HIDDEN = 0.01
"""A smaller share of an outline that is seen counts as none: edges just behind edges leave such specks."""


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
        Of Mitsuba; None: the best that works here.
    subpixels
        k of the k x k rays per pixel; None: from ``accuracy.centroid_px``.
    shadows
        Whether markers shadow each other: without, pictures take half the time and centroids are up to 0.2 px off.

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
        shadows: bool = True,
    ) -> None:
        if scene.camera is None or scene.light is None or not scene.markers:
            raise RecipeError("camera: a scene without camera, light and markers has no picture: add these tables")
        self.scene = scene
        self.variant = variant or choose_variant()
        self.shadows = shadows
        self.subpixels = subpixels or subpixels_for(scene.accuracy.centroid_px)
        self._top, white = brightest(rest, scene)
        self._gain = white_level(scene.ccd) / white
        self._unit = float(np.median([layer.diameter_mm / 2 for layer in scene.markers.values()]))
        self._view = look(scene, self._top)
        self._mi = importlib.import_module("mitsuba")
        self._switch()
        self._tracer: Wavefront | RayByRay
        if self.variant.name == "scalar_rgb":
            self._tracer = RayByRay(self._mi, self._view, self._unit, scene.light.ambient)
        else:
            drjit = importlib.import_module("drjit")
            self._tracer = Wavefront(self._mi, drjit, self._view, self._unit, scene.light.ambient)
        self._padded, self._exact = _Shape(self._mi), _Shape(self._mi)

    def radiance(self, markers: Ellipsoids) -> Singles:
        """Return the (height, width, 3) light on the sensor, 1 filling its wells.

        The exposure is set at rest, where the brightest marker has ``ccd.white_dn`` (before blur and noise).
        """
        frame = self._frame(markers, self.subpixels)
        light = self._view.cover.copy()
        if len(frame.near.pixels):
            marks, free = self._tracer.shade(frame, self._padded.hold(frame.padded), self._exact.hold(frame.exact))
            rows, columns = np.divmod(frame.near.pixels, light.shape[1])
            vignette = self._view.vignette[rows, columns].astype(np.float32)
            light[rows, columns] = light[rows, columns] * free[:, None] + marks * vignette[:, None]
        light *= np.float32(self._gain)
        return light

    def outlines(self, markers: Ellipsoids, subpixels: int | None = None) -> Outlines:
        """Return centroid, share and area of what the picture shows of each marker, from the same hits.

        Parameters
        ----------
        markers
            The markers.
        subpixels
            Another k than the picture's.
        """
        k = subpixels or self.subpixels
        frame = self._frame(markers, k)
        near = frame.near
        seen, whole, moments = self._tracer.count(frame, self._padded.hold(frame.padded))
        area = seen / (k * k * WEIGHT)
        expected = whole / (k * k * WEIGHT)
        first_order = np.pi * np.sqrt(np.linalg.det(near.conjugate))
        expected = np.where(near.cut, np.maximum(expected, first_order), expected)
        seen = np.where(area >= _HIDDEN * expected, seen, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            centroid = np.rint(near.centres_px) + (moments / seen[:, None] + 0.5) / k - 0.5
            centroid = np.where(seen[:, None] > 0, centroid, np.nan)
            visible = np.where(seen > 0, np.minimum(area / expected, 1.0), 0.0)
        area = np.where(seen > 0, area, 0.0)
        for array in (centroid, visible, area):
            frozen(array)
        return Outlines(centroid_px=centroid, visible=visible, area_px=area)

    def _frame(self, markers: Ellipsoids, subpixels: int) -> Frame:
        self._switch()
        return make_frame(
            markers,
            self.scene,
            self._view,
            unit_mm=self._unit,
            full_power=self._top,
            subpixels=subpixels,
            shadows=self.shadows,
        )

    def _switch(self) -> None:
        """Switch Mitsuba to our variant: the switch is global, and another renderer may have turned it."""
        if self._mi.variant() != self.variant.name:
            self._mi.set_variant(self.variant.name)


class _Shape:
    """A Mitsuba scene that holds ellipsoids; new numbers for as many of them are written over the old."""

    def __init__(self, mi: Any) -> None:
        self._mi = mi
        self._scene: Any = None
        self._params: Any = None
        self._count = -1

    def hold(self, data: Singles) -> Any:
        """Return the scene with these (n, 10) ellipsoids."""
        mi = self._mi
        # Mitsuba takes a tensor of three rows for a colour first, and complains: three markers get company far aside.
        data = np.concatenate([data, np.tile(NOWHERE, (max(4 - len(data), 0), 1))])
        if len(data) != self._count:
            shape = {"type": "ellipsoids", "data": mi.TensorXf(data), "extent": 1.0}
            self._scene = mi.load_dict({"type": "scene", "markers": shape})
            self._params = mi.traverse(self._scene)
            self._count = len(data)
        else:
            numbers = data.ravel()
            self._params["markers.data"] = numbers if mi.variant().startswith("scalar") else mi.Float(numbers)
            self._params.update()
        return self._scene


def subpixels_for(centroid_px: float | str) -> int:
    """Return the k whose largest centroid error is ``centroid_px``; ``auto`` is 3, below the noise of one exposure.

    Notes
    -----
    Bound on the largest error of intensity centroids, measured for both sensors (picture benchmark), most of it from
    the edges of shadows, which are not smoothed: 0.08 px / k^1.6. Coverage centroids are four times better.
    """
    if isinstance(centroid_px, str):
        return 3
    wanted: float = (0.08 / centroid_px) ** (1 / 1.6)
    return min(max(math.ceil(wanted - 1e-9), 1), 16)
