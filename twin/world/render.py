"""The picture as light: markers by Mitsuba, seen through folded optics. The one module that uses Mitsuba and Dr.Jit.

The literal scene (camera and LEDs in air, dielectric plates between) gives black or noisy pictures, so the optics are
folded: camera rays start inside the body with Snell's exact directions, and LEDs shine from their virtual images.
Mitsuba holds one ``ellipsoids`` shape with all markers; its intersections and shadow rays are evaluated on a fixed
k x k grid in every pixel near a marker. Moving markers rewrites that shape's numbers: nothing is rebuilt or recompiled.

Why a fixed grid and no sampler: the same number of random samples makes centroids 3 to 5 times worse. Why our own loop:
the sum over LEDs is analytic, so stock path tracing is some ten times slower at equal centroid error.

Units inside Mitsuba: the median marker radius is 1 and rays start just behind the markers, because the intersection
with an ellipsoid loses digits in float32 when it is small or far. Ellipsoids are hit from outside only, so shadow rays
start a little inside their marker and never meet it again.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Pixels, frozen
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.world.exposure import white_level
from twin.world.frame import Frame, Singles, make_frame
from twin.world.lighting import brightest
from twin.world.markers import Ellipsoids
from twin.world.variant import Variant, choose_variant
from twin.world.view import View, look

_INSIDE = 0.01
_LAYERS_THROUGH = 6


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


class _Tracer(Protocol):
    def load(self, frame: Frame) -> None: ...
    def shade(self, frame: Frame, k: int) -> tuple[Singles, Singles]: ...
    def count(self, frame: Frame, k: int) -> tuple[Ints, Ints, Ints]: ...


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

    Raises
    ------
    RecipeError
        The scene has no camera, or no light reaches the markers.
    """

    def __init__(
        self, scene: Scene, rest: Ellipsoids, variant: Variant | None = None, subpixels: int | None = None
    ) -> None:
        if scene.camera is None or scene.light is None or not scene.markers:
            raise RecipeError("camera: a scene without camera, light and markers has no picture: add these tables")
        self.scene = scene
        self.variant = variant or choose_variant()
        self.subpixels = subpixels or subpixels_for(scene.accuracy.centroid_px)
        self._top, white = brightest(rest, scene)
        self._gain = white_level(scene.ccd) / white
        self._unit = float(np.median([layer.diameter_mm / 2 for layer in scene.markers.values()]))
        self._view = look(scene, self._top)
        tracer = _Scalar if self.variant.name == "scalar_rgb" else _Wavefront
        self._tracer: _Tracer = tracer(self.variant.name, self._view, self._unit, scene.light.ambient)

    def radiance(self, markers: Ellipsoids) -> Singles:
        """Return the (height, width, 3) light on the sensor, 1 filling its wells.

        The exposure is set at rest, where the brightest marker has ``ccd.white_dn`` (before blur and noise).
        """
        frame = self._load(markers)
        light = self._view.cover.copy()
        if len(frame.near.pixels):
            marks, free = self._tracer.shade(frame, self.subpixels)
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
        frame = self._load(markers)
        k = subpixels or self.subpixels
        seen, whole, moments = self._tracer.count(frame, k)
        with np.errstate(divide="ignore", invalid="ignore"):
            centroid = frame.near.places + (moments / seen[:, None] + 0.5) / k - 0.5
            expected = np.where(frame.near.cut, np.maximum(whole, frame.near.area_px * k**2), whole)
            visible = np.where(seen > 0, np.minimum(seen / expected, 1.0), 0.0)
        area = seen / k**2
        for array in (centroid, visible, area):
            frozen(array)
        return Outlines(centroid_px=centroid, visible=visible, area_px=area)

    def _load(self, markers: Ellipsoids) -> Frame:
        frame = make_frame(markers, self.scene, self._view, self._unit, self._top)
        self._tracer.load(frame)
        return frame


def subpixels_for(centroid_px: float | str) -> int:
    """Return the k whose largest centroid error is ``centroid_px``; ``auto`` is 3, below the noise of one exposure.

    Notes
    -----
    Largest error measured for markers of 10 px: 0.06 px / k^1.9 (see the picture benchmark).
    """
    if isinstance(centroid_px, str):
        return 3
    wanted: float = (0.06 / centroid_px) ** (1 / 1.9)
    return min(max(math.ceil(wanted - 1e-9), 1), 16)


def _mitsuba(name: str) -> Any:
    """Return Mitsuba, switched to a variant: the switch is global, so every entry sets it."""
    mitsuba = importlib.import_module("mitsuba")
    if mitsuba.variant() != name:
        mitsuba.set_variant(name)
    return mitsuba


def _build(mitsuba: Any, data: Singles) -> tuple[Any, Any]:
    """Return a Mitsuba scene with one shape that holds all ellipsoids, and its editable numbers."""
    shape = {"type": "ellipsoids", "data": mitsuba.TensorXf(data), "extent": 1.0}
    scene = mitsuba.load_dict({"type": "scene", "markers": shape})
    return scene, mitsuba.traverse(scene)


class _Wavefront:
    """Tracing in one Dr.Jit kernel (LLVM or CUDA): a symbolic loop over the sub-pixel grid, one lane per pixel."""

    def __init__(self, name: str, view: View, unit_mm: float, ambient: float) -> None:
        self._name = name
        mi = _mitsuba(name)
        self._width = view.sees.shape[1]
        self._corners = mi.Float((view.corners / [unit_mm, unit_mm, 1, 1]).astype(np.float32).ravel())
        self._ambient = ambient
        self._scene: Any = None
        self._params: Any = None
        self._size = 0

    def load(self, frame: Frame) -> None:
        mi = _mitsuba(self._name)
        if len(frame) != self._size:
            self._scene, self._params = _build(mi, frame.data)
            self._size = len(frame)
            return
        self._params["markers.data"] = mi.Float(frame.data.ravel())
        self._params.update()

    def _ray(self, mi: Any, dr: Any, pixel: Any, sample: Any, k: int, begin: Any) -> Any:
        """Return the ray of one sub-pixel of every lane, by interpolation between the pixel's corners."""
        row = pixel // self._width
        corner = row * (self._width + 1) + (pixel - row * self._width)
        across = (mi.Float(sample % k) + 0.5) / k
        down = (mi.Float(sample // k) + 0.5) / k
        here, right, below, both = (
            dr.gather(mi.Vector4f, self._corners, corner + step) for step in (0, 1, self._width + 1, self._width + 2)
        )
        upper, lower = here + (right - here) * across, below + (both - below) * across
        ray = upper + (lower - upper) * down
        start = mi.Point3f(ray.x + ray.z * begin.x, ray.y + ray.w * begin.x, begin.y)
        return mi.Ray3f(start, dr.normalize(mi.Vector3f(ray.z, ray.w, -1)))

    def shade(self, frame: Frame, k: int) -> tuple[Singles, Singles]:
        mi = _mitsuba(self._name)
        dr = importlib.import_module("drjit")
        scene, leds = self._scene, frame.lamps.shape[1]
        pixel = mi.UInt32(frame.near.pixels.astype(np.uint32))
        centres, metric = mi.Float(frame.centres.ravel()), mi.Float(frame.metric.ravel())
        lamps, colours = mi.Float(frame.lamps.ravel()), mi.Float(frame.colour.ravel())
        shadowed = mi.Bool(frame.shadowed.ravel())
        begin, ambient = mi.Vector2f(frame.starts.T.copy()), self._ambient

        def one_led(led: Any, total: Any, marker: Any, point: Any, inside: Any, normal: Any, hit: Any) -> Any:
            lamp = dr.gather(mi.Vector4f, lamps, marker * leds + led, hit)
            towards = mi.Vector3f(lamp.x, lamp.y, lamp.z) - point
            inverse = dr.rsqrt(dr.squared_norm(towards))
            cosine = dr.dot(normal, towards) * inverse
            facing = hit & (cosine > 0)
            doubt = facing & dr.gather(mi.Bool, shadowed, marker * leds + led, hit)
            dark = scene.ray_test(mi.Ray3f(inside, towards * inverse), doubt)
            share = dr.select(facing & ~dark, lamp.w * cosine * inverse * inverse, 0)
            return led + 1, total + share, marker, point, inside, normal, hit

        def one_sample(sample: Any, light: Any, free: Any) -> Any:
            ray = self._ray(mi, dr, pixel, sample, k, begin)
            found = scene.ray_intersect_preliminary(ray, True)
            hit, marker = found.is_valid(), found.prim_index
            point = mi.Vector3f(ray(found.t))
            centre = dr.gather(mi.Vector3f, centres, marker, hit)
            away = point - centre
            m = [dr.gather(mi.Float, metric, marker * 9 + i, hit) for i in range(9)]
            normal = dr.normalize(
                mi.Vector3f(*(m[3 * i] * away.x + m[3 * i + 1] * away.y + m[3 * i + 2] * away.z for i in range(3)))
            )
            inside = mi.Point3f(centre + away * (1 - _INSIDE))
            state = (mi.UInt32(0), mi.Float(0), marker, point, inside, normal, hit)
            total = dr.while_loop(state, lambda led, *_: led < leds, one_led)[1]
            colour = dr.gather(mi.Vector3f, colours, marker, hit)
            bright = dr.select(hit, (1 - ambient) * total + ambient, 0)
            return sample + 1, light + dr.select(hit, colour * bright, 0), free + dr.select(hit, mi.Float(0), 1)

        state = (mi.UInt32(0), mi.Vector3f(0), dr.zeros(mi.Float, len(frame.near.pixels)))
        _, light, free = dr.while_loop(state, lambda sample, *_: sample < k * k, one_sample)
        dr.eval(light, free)
        share = np.float32(1 / (k * k))
        return np.array(light, np.float32).T * share, np.array(free, np.float32) * share

    def count(self, frame: Frame, k: int) -> tuple[Ints, Ints, Ints]:
        mi = _mitsuba(self._name)
        dr = importlib.import_module("drjit")
        scene, n = self._scene, len(frame)
        pixel = mi.UInt32(frame.near.pixels.astype(np.uint32))
        places = mi.Int32(frame.near.places.astype(np.int32).ravel())
        begin = mi.Vector2f(frame.starts.T.copy())
        tallies = dr.zeros(mi.Int32, 4 * n)

        def one_hit(ray: Any, going: Any, last: Any, depth: Any, column: Any, row: Any) -> Any:
            found = scene.ray_intersect_preliminary(ray, True, active=going)
            going = going & found.is_valid()
            marker = found.prim_index
            first = going & (depth == 0)
            dr.scatter_add(tallies, mi.Int32(1), marker * 4, going & (marker != last))
            dr.scatter_add(tallies, mi.Int32(1), marker * 4 + 1, first)
            for axis, place in enumerate((column, row)):
                middle = dr.gather(mi.Int32, places, marker * 2 + axis, first) * k
                dr.scatter_add(tallies, place - middle, marker * 4 + 2 + axis, first)
            onward = mi.Ray3f(dr.select(going, ray(found.t + _INSIDE), ray.o), ray.d)
            return onward, going, mi.UInt32(marker), depth + 1, column, row

        def one_sample(sample: Any) -> Any:
            ray = self._ray(mi, dr, pixel, sample, k, begin)
            row = mi.Int32(pixel // self._width)
            column = mi.Int32(pixel) - row * self._width
            state = (
                ray,
                mi.Bool(True),
                mi.UInt32(n),
                mi.UInt32(0),
                column * k + mi.Int32(sample % k),
                row * k + mi.Int32(sample // k),
            )
            dr.while_loop(state, lambda _, going, last, depth, *__: going & (depth < _LAYERS_THROUGH), one_hit)
            return (sample + 1,)

        if len(frame.near.pixels):
            start = dr.zeros(mi.UInt32, len(frame.near.pixels))
            dr.while_loop((start,), lambda sample: sample < k * k, one_sample)
            dr.eval(tallies)
        whole, seen, columns, rows = np.array(tallies).astype(np.int64).reshape(n, 4).T
        return seen, whole, np.column_stack([columns, rows])


class _Scalar:
    """Tracing ray by ray in Mitsuba's scalar variant, which runs everywhere; the arithmetic around it is numpy's."""

    def __init__(self, name: str, view: View, unit_mm: float, ambient: float) -> None:
        self._name = name
        self._corners = view.corners / [unit_mm, unit_mm, 1, 1]
        self._ambient = ambient
        self._scene: Any = None
        self._params: Any = None
        self._size = 0

    def load(self, frame: Frame) -> None:
        mi = _mitsuba(self._name)
        if len(frame) != self._size:
            self._scene, self._params = _build(mi, frame.data)
            self._size = len(frame)
            return
        self._params["markers.data"] = frame.data.ravel()
        self._params.update()

    def _rays(self, frame: Frame, k: int, sample: int) -> tuple[Floats, Floats]:
        """Return (m, 3) starts and directions of one sub-pixel of every pixel."""
        row, column = np.divmod(frame.near.pixels, self._corners.shape[1] - 1)
        across, down = (sample % k + 0.5) / k, (sample // k + 0.5) / k
        c = self._corners
        upper = c[row, column] * (1 - across) + c[row, column + 1] * across
        lower = c[row + 1, column] * (1 - across) + c[row + 1, column + 1] * across
        ray = upper * (1 - down) + lower * down
        starts = np.column_stack([ray[:, :2] + ray[:, 2:] * frame.starts[:, :1], frame.starts[:, 1]])
        along = np.column_stack([ray[:, 2:], -np.ones(len(ray))])
        return starts, along / np.linalg.norm(along, axis=1, keepdims=True)

    def _hits(self, starts: Floats, along: Floats) -> tuple[Ints, Floats]:
        """Return the (m,) first marker on each ray, -1 for none, and the distance."""
        mi = _mitsuba(self._name)
        intersect, ray, point, vector = self._scene.ray_intersect_preliminary, mi.Ray3f, mi.Point3f, mi.Vector3f
        found = [
            intersect(ray(point(*o), vector(*d)), True) for o, d in zip(starts.tolist(), along.tolist(), strict=True)
        ]
        distance = np.array([f.t for f in found], float)
        marker = np.array([f.prim_index for f in found], np.int64)
        return np.where(np.isfinite(distance), marker, -1), distance

    def _blocked(self, starts: Floats, along: Floats) -> NDArray[np.bool_]:
        mi = _mitsuba(self._name)
        test, ray, point, vector = self._scene.ray_test, mi.Ray3f, mi.Point3f, mi.Vector3f
        pairs = zip(starts.tolist(), along.tolist(), strict=True)
        return np.array([test(ray(point(*o), vector(*d))) for o, d in pairs], bool)

    def shade(self, frame: Frame, k: int) -> tuple[Singles, Singles]:
        light = np.zeros((len(frame.near.pixels), 3))
        free = np.zeros(len(frame.near.pixels))
        for sample in range(k * k):
            starts, along = self._rays(frame, k, sample)
            marker, distance = self._hits(starts, along)
            hit = np.flatnonzero(marker >= 0)
            marker = marker[hit]
            points = starts[hit] + along[hit] * distance[hit, None]
            away = points - frame.centres[marker]
            normal = np.einsum("nij,nj->ni", frame.metric[marker].reshape(-1, 3, 3), away)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            total = np.zeros(len(hit))
            for led in range(frame.lamps.shape[1]):
                lamp = frame.lamps[marker, led]
                towards = lamp[:, :3] - points
                length = np.linalg.norm(towards, axis=1)
                cosine = np.einsum("ni,ni->n", normal, towards) / length
                lit = cosine > 0
                doubt = np.flatnonzero(lit & frame.shadowed[marker, led])
                inside = points[doubt] - away[doubt] * _INSIDE
                lit[doubt] = ~self._blocked(inside, towards[doubt] / length[doubt, None])
                total += np.where(lit, lamp[:, 3] * cosine / length**2, 0.0)
            light[hit] += frame.colour[marker] * ((1 - self._ambient) * total + self._ambient)[:, None]
            free += 1
            free[hit] -= 1
        return (light / k**2).astype(np.float32), (free / k**2).astype(np.float32)

    def count(self, frame: Frame, k: int) -> tuple[Ints, Ints, Ints]:
        n = len(frame)
        seen, whole, moments = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros((n, 2), np.int64)
        row, column = np.divmod(frame.near.pixels, self._corners.shape[1] - 1)
        for sample in range(k * k):
            starts, along = self._rays(frame, k, sample)
            last = np.full(len(starts), -1)
            place = np.column_stack([column * k + sample % k, row * k + sample // k])
            for depth in range(_LAYERS_THROUGH):
                marker, distance = self._hits(starts, along)
                hit = marker >= 0
                marker = marker[hit]
                whole += np.bincount(marker[marker != last[hit]], minlength=n)
                if depth == 0:
                    seen += np.bincount(marker, minlength=n)
                    np.add.at(moments, marker, place[hit] - k * frame.near.places[marker])
                starts, along = starts[hit] + along[hit] * (distance[hit, None] + _INSIDE), along[hit]
                last = marker
                if not len(starts):
                    break
        return seen, whole, moments
