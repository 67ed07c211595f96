"""Tracing a picture in one Dr.Jit kernel (LLVM or CUDA): one lane per pixel, symbolic loops inside.

Mitsuba finds the ellipsoids on a ray; how much of a sub-pixel one covers follows from the ray's distance to its
silhouette. So edges are smooth and centroids need few rays: see `coverage`.

The modules ``mi`` and ``dr`` are handed in, switched to their variant, by the one module that imports them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Singles
from twin.world.picture.frame import DEPTH, INSIDE, INTO, OPAQUE, STEP, Frame
from twin.world.picture.shape import Shape
from twin.world.picture.view import View


class Wavefront:
    """Camera rays and shadow rays for all pixels at once."""

    def __init__(self, mi: Any, dr: Any, view: View, unit_mm: float, ambient: float) -> None:
        self._mi, self._dr = mi, dr
        self._padded, self._exact = Shape(mi), Shape(mi)
        self._width = view.sees.shape[1]
        self._corners = mi.Float(aligned((view.corners / [unit_mm, unit_mm, 1, 1]).astype(np.float32).ravel()))
        self._ambient = ambient

    def shade(self, frame: Frame) -> tuple[Singles, Singles]:
        """Return (m, 3) light from markers in the frame's pixels, and (m,) the share of each that they leave free."""
        mi, dr = self._mi, self._dr
        k = frame.subpixels
        pixel, begin, table = self._inputs(frame)
        colours = mi.Float(aligned(frame.colour.astype(np.float32).ravel()))
        padded = self._padded.hold(frame.padded)
        lit = self._irradiance(frame, self._exact.hold(frame.exact))

        def one_marker(ray: Any, going: Any, last: Any, depth: Any, place: Any, light: Any, clear: Any) -> Any:
            found = padded.ray_intersect_preliminary(ray, True, active=going)
            going = going & found.is_valid()
            marker = found.prim_index
            covers, centre, away, normal = self._meet(table, ray, marker, place, k, going)
            share = dr.select(going & (marker != last), covers * clear, 0)
            bright = (1 - self._ambient) * lit(marker, centre, away, normal, share > 0) + self._ambient
            light = light + dr.gather(mi.Vector3f, colours, marker, going) * (bright * share)
            onward = mi.Ray3f(dr.select(going, ray(found.t + STEP), ray.o), ray.d)
            clear = clear - share
            return onward, going & (clear > OPAQUE), mi.UInt32(marker), depth + 1, place, light, clear

        def one_sample(sample: Any, light: Any, free: Any) -> Any:
            ray, place = self._ray(pixel, sample, k, begin)
            state = (ray, mi.Bool(True), mi.UInt32(len(frame)), mi.UInt32(0), place, light, mi.Float(1))
            state = dr.while_loop(state, lambda _, going, last, depth, *__: going & (depth < DEPTH), one_marker)
            return sample + 1, state[5], free + state[6]

        state = (
            mi.UInt32(0),
            dr.zeros(mi.Vector3f, len(frame.near.pixels)),
            dr.zeros(mi.Float, len(frame.near.pixels)),
        )
        _, light, free = dr.while_loop(state, lambda sample, *_: sample < k * k, one_sample)
        dr.eval(light, free)
        share = np.float32(1 / (k * k))
        # Channel by channel: a whole vector is gathered by a kernel that is compiled for its length.
        channels = np.stack([np.array(channel, np.float32) for channel in light], axis=1)
        return channels * share, np.array(free, np.float32) * share

    def _inputs(self, frame: Frame) -> tuple[Any, Any, Any]:
        """Return the lanes' pixels and starts, and one table of 16 numbers per marker, read four at a time."""
        mi = self._mi
        m, s = frame.metric, np.linalg.inv(frame.near.conjugate)
        columns: list[Any] = [frame.centres, m[:, 0, 0], m[:, 1, 1], m[:, 2, 2], m[:, 0, 1], m[:, 0, 2], m[:, 1, 2]]
        columns += [frame.near.centres_px, s[:, 0, 0], s[:, 0, 1], s[:, 1, 1], np.zeros((len(frame), 2))]
        table: Floats = np.column_stack(columns)
        pixel = mi.UInt32(aligned(frame.near.pixels.astype(np.uint32)))
        begin = mi.Vector2f(*(mi.Float(aligned(column)) for column in frame.starts.T))
        return pixel, begin, mi.Float(aligned(table.astype(np.float32).ravel()))

    def _ray(self, pixel: Any, sample: Any, k: int, begin: Any) -> tuple[Any, Any]:
        """Return the ray of one sub-pixel of every lane, between those of the pixel's corners, and its place in px."""
        mi, dr = self._mi, self._dr
        row = pixel // self._width
        column = pixel - row * self._width
        corner = row * (self._width + 1) + column
        across = (mi.Float(sample % k) + 0.5) / k
        down = (mi.Float(sample // k) + 0.5) / k
        here, right, below, both = (
            dr.gather(mi.Vector4f, self._corners, corner + step) for step in (0, 1, self._width + 1, self._width + 2)
        )
        upper, lower = here + (right - here) * across, below + (both - below) * across
        ray = upper + (lower - upper) * down
        start = mi.Point3f(ray.x + ray.z * begin.x, ray.y + ray.w * begin.x, begin.y)
        place = mi.Vector2f(mi.Float(column) + across - 0.5, mi.Float(row) + down - 0.5)
        return mi.Ray3f(start, dr.normalize(mi.Vector3f(ray.z, ray.w, -1))), place

    def _meet(self, table: Any, ray: Any, marker: Any, place: Any, k: int, active: Any) -> tuple[Any, Any, Any, Any]:
        """Return coverage, centre, way from centre to surface, and normal where rays meet or just miss markers."""
        mi, dr = self._mi, self._dr
        one, two, three, four = (dr.gather(mi.Vector4f, table, marker * 4 + i, active) for i in range(4))
        centre = mi.Vector3f(one.x, one.y, one.z)

        def times(v: Any) -> Any:
            return mi.Vector3f(
                one.w * v.x + two.z * v.y + two.w * v.z,
                two.z * v.x + two.x * v.y + three.x * v.z,
                two.w * v.x + three.x * v.y + two.y * v.z,
            )

        # First to the point of the ray nearest the centre: float32 then loses nothing to the way there.
        from_centre = mi.Vector3f(ray.o) - centre
        away = from_centre - ray.d * dr.dot(from_centre, ray.d)
        along = times(ray.d)
        square = dr.dot(ray.d, along)
        away = away - ray.d * (dr.dot(away, along) / square)
        miss = dr.sqrt(dr.dot(away, times(away)))
        off = place - mi.Vector2f(three.y, three.z)
        slope = mi.Vector2f(three.w * off.x + four.x * off.y, four.x * off.x + four.y * off.y)
        steepness = dr.norm(slope) * dr.rsqrt(dr.maximum(dr.dot(off, slope), 1e-12))
        covers = dr.select(miss < 0.5, 1, dr.clip(0.5 + k * (1 - miss) / dr.maximum(steepness, 1e-6), 0, 1))
        within = dr.select(covers < 1, 1 - INTO * covers * steepness / k, miss)
        within = dr.clip(within, 0, 1)
        surface = away * (within / dr.maximum(miss, 1e-6)) - ray.d * dr.sqrt((1 - within * within) / square)
        return covers, centre, surface, dr.normalize(times(surface))

    def _irradiance(self, frame: Frame, exact: Any) -> Any:
        """Return a function of markers and places on them that sums the light of all LEDs, shadows included."""
        mi, dr = self._mi, self._dr
        leds = frame.lamps.shape[1]
        lamps, shadowed = (
            mi.Float(aligned(frame.lamps.astype(np.float32).ravel())),
            mi.Bool(aligned(frame.shadowed.ravel())),
        )

        def one_led(led: Any, total: Any, marker: Any, centre: Any, away: Any, normal: Any, active: Any) -> Any:
            lamp = dr.gather(mi.Vector4f, lamps, marker * leds + led, active)
            towards = mi.Vector3f(lamp.x, lamp.y, lamp.z) - (centre + away)
            inverse = dr.rsqrt(dr.squared_norm(towards))
            cosine = dr.dot(normal, towards) * inverse
            facing = active & (cosine > 0)
            doubt = facing & dr.gather(mi.Bool, shadowed, marker * leds + led, active)
            start = mi.Point3f(centre + away * (1 - INSIDE))
            dark = exact.ray_test(mi.Ray3f(start, towards * inverse), doubt)
            share = dr.select(facing & ~dark, lamp.w * cosine * inverse * inverse, 0)
            return led + 1, total + share, marker, centre, away, normal, active

        def irradiance(marker: Any, centre: Any, away: Any, normal: Any, active: Any) -> Any:
            state = (mi.UInt32(0), mi.Float(0), marker, centre, away, normal, active)
            return dr.while_loop(state, lambda led, *rest: rest[-1] & (led < leds), one_led)[1]

        return irradiance


def aligned(array: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of a flat array that begins at a multiple of 64 bytes.

    Dr.Jit reads numpy's memory where it lies, with other instructions where it lies unaligned: a kernel would be
    compiled anew whenever another one of its arrays happens to.
    """
    room = np.empty(array.nbytes + 64, np.uint8)
    start = -room.ctypes.data % 64
    copy: NDArray[Any] = room[start : start + array.nbytes].view(array.dtype)
    copy[:] = array
    return copy
