"""The renderer with Mitsuba: one Dr.Jit kernel (LLVM or CUDA), one lane a pixel.

The literal scene (camera and LEDs in air, dielectric plates between) gives black or noisy pictures,
so the optics are folded: camera rays start inside the body with Snell's exact directions, and LEDs
shine from their virtual images. Mitsuba holds all markers in one ``ellipsoids`` shape and finds
those on a ray; camera and shadow rays are traced on a fixed k x k grid in every pixel near a
marker. Moving markers rewrites that shape's numbers: nothing is rebuilt or recompiled. It must be
one shape: OptiX leaves out the rays into a second scene of the same kernel, with a line in the log.

Plain hits have hard edges: on a k x k grid the centroid of a disc of R px is off by 0.15 k^-1.5
R^-0.5 px, as much as the camera's noise. So rays look for ellipsoids that are larger by a
sub-pixel, and the share that the true one covers follows from the ray's distance to its silhouette:
ten times smaller errors for the same rays. Shadow rays meet the same larger ellipsoids, and are
dark where they meet the true one. Random samples instead of the grid make centroids 3 to 5 times
worse; stock path tracing instead of the sum over LEDs is some ten times slower at equal error.

Rays start just behind the markers that they may meet, because the intersection with an ellipsoid
loses digits in float32 when it is thin or far: rays from the base lose up to a third of a thin
print in the finger.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin.arrays import Floats, Singles
from twin.world.picture.backend import Variant
from twin.world.picture.camera_rays import View
from twin.world.picture.picture_job import INTO, OPAQUE, PictureJob

_NOWHERE = np.array([1e5, 1e5, -1.0, 1e-3, 1e-3, 1e-3, 0, 0, 0, 1], np.float32)
"""An ellipsoid that no ray meets."""

_INSIDE = 0.01
"""Share of the radius by which a shadow ray starts inside its marker: ellipsoids are met from
outside only."""

_STEP = 1e-3
"""Distance behind a hit at which a ray goes on, renderer units."""

_DEPTH = 6
"""Markers that a ray is followed through."""


class MitsubaTracer:
    """Renders jobs of one view with Mitsuba in a variant of its own, camera and shadow rays at
    once."""

    def __init__(self, variant: str, view: View, unit_mm: float, ambient: float) -> None:
        self._variant = variant
        self._mi = Variant.mitsuba(variant)
        self._dr: Any = importlib.import_module("drjit")
        self._shape = _Shape(self._mi)
        self._width = view.sees.shape[1]
        corners = view.corners / [unit_mm, unit_mm, 1, 1]
        self._corners = self._mi.Float(_aligned(corners.astype(np.float32).ravel()))
        self._ambient = ambient

    def shade(self, job: PictureJob) -> tuple[Singles, Singles]:
        """See `twin.world.picture.render.RENDERERS`."""
        if not len(job.pixels):
            return np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
        # Upload the scene: markers a little larger than they are, which all rays look for.
        Variant.mitsuba(self._variant)
        mi, dr = self._mi, self._dr
        k = job.subpixels
        pixel, begin, table = self._inputs(job)
        colours = mi.Float(_aligned(job.colour.astype(np.float32).ravel()))
        rows = _ellipsoid_rows(job)
        rows[:, 3:6] += job.pad[:, None]
        padded = self._shape.hold(rows)
        lit = self._irradiance(job, padded, table)
        even = 1.0 if len(job.even) == 1 else mi.Vector3f(*job.even.tolist())

        def one_marker(
            ray: Any, going: Any, last: Any, depth: Any, place: Any, light: Any, clear: Any
        ) -> Any:
            # The next marker along the ray; its coverage of the pixel gives its share of the
            # light.
            found = padded.ray_intersect_preliminary(ray, True, active=going)
            going = going & found.is_valid()
            marker = found.prim_index
            covers, centre, away, normal = self._meet(table, ray, marker, place, k, going)
            share = dr.select(going & (marker != last), covers * clear, 0)
            bright = (1 - self._ambient) * lit(
                marker, centre, away, normal, share > 0
            ) + self._ambient * even
            light = light + dr.gather(mi.Vector3f, colours, marker, going) * (bright * share)
            # Go on behind it with what light it leaves free, until nothing is left.
            onward = mi.Ray3f(dr.select(going, ray(found.t + _STEP), ray.o), ray.d)
            clear = clear - share
            going = going & (clear > OPAQUE)
            return onward, going, mi.UInt32(marker), depth + 1, place, light, clear

        def one_sample(sample: Any, light: Any, free: Any) -> Any:
            ray, place = self._ray(pixel, sample, k, begin)
            # All pixels at once, one sub-pixel after the other.
            none = mi.UInt32(len(job))
            state = (ray, mi.Bool(True), none, mi.UInt32(0), place, light, mi.Float(1))
            state = dr.while_loop(
                state, lambda _, going, last, depth, *__: going & (depth < _DEPTH), one_marker
            )
            return sample + 1, state[5], free + state[6]

        lanes = len(job.pixels)
        state = (mi.UInt32(0), dr.zeros(mi.Vector3f, lanes), dr.zeros(mi.Float, lanes))
        _, light, free = dr.while_loop(state, lambda sample, *_: sample < k * k, one_sample)
        dr.eval(light, free)
        share = np.float32(1 / (k * k))
        # Channel by channel: a whole vector is gathered by a kernel that is compiled for its
        # length.
        channels = np.stack([np.array(channel, np.float32) for channel in light], axis=1)
        return channels * share, np.array(free, np.float32) * share

    def _inputs(self, job: PictureJob) -> tuple[Any, Any, Any]:
        """Return the lanes' pixels and starts, and a table of 16 numbers per marker, read four at a
        time."""
        mi = self._mi
        m = job.metric
        s = np.linalg.inv(job.conjugate)
        six = m[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        three = s[:, [0, 0, 1], [0, 1, 1]]
        empty = np.zeros((len(job), 2))
        table: Floats = np.column_stack([job.centres, six, job.centres_px, three, empty])
        pixel = mi.UInt32(_aligned(job.pixels.astype(np.uint32)))
        begin = mi.Vector2f(*(mi.Float(_aligned(column)) for column in _starts(job).T))
        return pixel, begin, mi.Float(_aligned(table.astype(np.float32).ravel()))

    def _ray(self, pixel: Any, sample: Any, k: int, begin: Any) -> tuple[Any, Any]:
        """Return the ray of one sub-pixel of every lane, between those of the pixel's corners, and
        its place in px."""
        mi, dr = self._mi, self._dr
        row = pixel // self._width
        column = pixel - row * self._width
        corner = row * (self._width + 1) + column
        across = (mi.Float(sample % k) + 0.5) / k
        down = (mi.Float(sample // k) + 0.5) / k
        here, right, below, both = (
            dr.gather(mi.Vector4f, self._corners, corner + step)
            for step in (0, 1, self._width + 1, self._width + 2)
        )
        upper, lower = here + (right - here) * across, below + (both - below) * across
        ray = upper + (lower - upper) * down
        start = mi.Point3f(ray.x + ray.z * begin.x, ray.y + ray.w * begin.x, begin.y)
        place = mi.Vector2f(mi.Float(column) + across - 0.5, mi.Float(row) + down - 0.5)
        return mi.Ray3f(start, dr.normalize(mi.Vector3f(ray.z, ray.w, -1))), place

    def _pass_by(
        self, table: Any, ray: Any, marker: Any, active: Any
    ) -> tuple[Any, Any, Any, Any, Callable[[Any], Any]]:
        """Return how rays pass markers: the centre, the way from it to the ray's nearest point and
        its length, both in the marker's metric, the square of the ray's direction, and the metric
        as a function."""
        mi, dr = self._mi, self._dr
        one, two, three = (dr.gather(mi.Vector4f, table, marker * 4 + i, active) for i in range(3))
        centre = mi.Vector3f(one.x, one.y, one.z)

        def times(v: Any) -> Any:
            return mi.Vector3f(
                one.w * v.x + two.z * v.y + two.w * v.z,
                two.z * v.x + two.x * v.y + three.x * v.z,
                two.w * v.x + three.x * v.y + two.y * v.z,
            )

        # First to the point of the ray nearest the centre: float32 then loses nothing to the way
        # there.
        from_centre = mi.Vector3f(ray.o) - centre
        away = from_centre - ray.d * dr.dot(from_centre, ray.d)
        along = times(ray.d)
        square = dr.dot(ray.d, along)
        away = away - ray.d * (dr.dot(away, along) / square)
        return centre, away, dr.sqrt(dr.dot(away, times(away))), square, times

    def _meet(
        self, table: Any, ray: Any, marker: Any, place: Any, k: int, active: Any
    ) -> tuple[Any, Any, Any, Any]:
        """Return coverage, centre, way from centre to surface, and normal where rays meet or just
        miss markers."""
        mi, dr = self._mi, self._dr
        centre, away, miss, square, times = self._pass_by(table, ray, marker, active)
        three, four = (dr.gather(mi.Vector4f, table, marker * 4 + i, active) for i in (2, 3))
        off = place - mi.Vector2f(three.y, three.z)
        slope = mi.Vector2f(three.w * off.x + four.x * off.y, four.x * off.x + four.y * off.y)
        steepness = dr.norm(slope) * dr.rsqrt(dr.maximum(dr.dot(off, slope), 1e-12))
        covers = dr.select(
            miss < 0.5, 1, dr.clip(0.5 + k * (1 - miss) / dr.maximum(steepness, 1e-6), 0, 1)
        )
        within = dr.select(covers < 1, 1 - INTO * covers * steepness / k, miss)
        within = dr.clip(within, 0, 1)
        surface = away * (within / dr.maximum(miss, 1e-6)) - ray.d * dr.sqrt(
            (1 - within * within) / square
        )
        return covers, centre, surface, dr.normalize(times(surface))

    def _irradiance(self, job: PictureJob, padded: Any, table: Any) -> Any:
        """Return a function of markers and places on them that sums the light of all LEDs, shadows
        included: of a channel where all are alike, of three under coloured LEDs."""
        mi, dr = self._mi, self._dr
        leds = job.lamps.shape[1]
        lamps = mi.Float(_aligned(job.lamps[:, :, :4].astype(np.float32).ravel()))
        changes = mi.Float(_aligned(job.lamps[:, :, 4:].astype(np.float32).ravel()))
        shadowed = mi.Bool(_aligned(np.diff(job.occluder_first) > 0))
        coloured = len(job.tints) > 1
        tints = mi.Float(_aligned(job.tints.T.astype(np.float32).ravel()))

        def one_occluder(ray: Any, going: Any, depth: Any, dark: Any) -> Any:
            # A shadow is exact: the next marker darkens if the ray meets it without its padding.
            found = padded.ray_intersect_preliminary(ray, active=going)
            going = going & found.is_valid()
            miss = self._pass_by(table, ray, found.prim_index, going)[2]
            dark = dark | (going & (miss < 1))
            onward = mi.Ray3f(dr.select(going, ray(found.t + _STEP), ray.o), ray.d)
            return onward, going & ~dark, depth + 1, dark

        def one_led(
            led: Any, total: Any, marker: Any, centre: Any, away: Any, normal: Any, active: Any
        ) -> Any:
            # Inverse square times cosine, where the lamp is above the horizon.
            lamp = dr.gather(mi.Vector4f, lamps, marker * leds + led, active)
            towards = mi.Vector3f(lamp.x, lamp.y, lamp.z) - (centre + away)
            inverse = dr.rsqrt(dr.squared_norm(towards))
            cosine = dr.dot(normal, towards) * inverse
            facing = active & (cosine > 0)
            # Trace a shadow ray only where another marker may lie in between.
            doubt = facing & dr.gather(mi.Bool, shadowed, marker * leds + led, active)
            ray = mi.Ray3f(mi.Point3f(centre + away * (1 - _INSIDE)), towards * inverse)
            state = (ray, doubt, mi.UInt32(0), mi.Bool(False))
            dark = dr.while_loop(
                state, lambda _, going, depth, __: going & (depth < _DEPTH), one_occluder
            )[3]
            change = dr.gather(mi.Vector3f, changes, marker * leds + led, active)
            power = dr.maximum(lamp.w + dr.dot(change, away), 0)
            share = dr.select(facing & ~dark, power * cosine * inverse * inverse, 0)
            if coloured:
                share = dr.gather(mi.Vector3f, tints, led, active) * share
            return led + 1, total + share, marker, centre, away, normal, active

        def irradiance(marker: Any, centre: Any, away: Any, normal: Any, active: Any) -> Any:
            none = mi.Vector3f(0) if coloured else mi.Float(0)
            state = (mi.UInt32(0), none, marker, centre, away, normal, active)
            return dr.while_loop(state, lambda led, *rest: rest[-1] & (led < leds), one_led)[1]

        return irradiance


class _Shape:
    """A Mitsuba scene of ellipsoids; new numbers for as many of them replace the old."""

    def __init__(self, mi: Any) -> None:
        self._mi = mi
        self._scene: Any = None
        self._params: Any = None
        self._count = -1

    def hold(self, data: Singles) -> Any:
        """Return the scene with these (n, 10) ellipsoids."""
        mi = self._mi
        # Mitsuba takes a tensor of three rows for a colour first, and complains: three markers get
        # company far aside.
        data = np.concatenate([data, np.tile(_NOWHERE, (max(4 - len(data), 0), 1))])
        if len(data) != self._count:
            shape = {"type": "ellipsoids", "data": mi.TensorXf(data), "extent": 1.0}
            self._scene = mi.load_dict({"type": "scene", "markers": shape})
            self._params = mi.traverse(self._scene)
            self._count = len(data)
        else:
            self._params["markers.data"] = mi.Float(data.ravel())
            self._params.update()
        return self._scene


def _ellipsoid_rows(job: PictureJob) -> Singles:
    """Return (n, 10) centre, semi-axes and quaternion (x, y, z, w), Mitsuba's form of
    ellipsoids."""
    turned, sizes, _ = np.linalg.svd(job.axes)
    turned *= np.sign(np.linalg.det(turned))[:, None, None]  # an ellipsoid is its own mirror image
    turns = Rotation.from_matrix(turned).as_quat()
    return np.column_stack([job.centres, sizes, turns]).astype(np.float32)


def _starts(job: PictureJob) -> Singles:
    """Return (m, 2) where every pixel's rays start: distance from the base, and z."""
    start = np.maximum.reduceat(job.top[job.members], job.first[:-1])
    return np.column_stack([job.base - start, start]).astype(np.float32)


def _aligned(array: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of a flat array that begins at a multiple of 64 bytes. Dr.Jit reads numpy's
    memory where it lies, with other instructions where it lies unaligned, and would compile a
    kernel again for each kind."""
    room = np.empty(array.nbytes + 64, np.uint8)
    start = -room.ctypes.data % 64
    copy: NDArray[Any] = room[start : start + array.nbytes].view(array.dtype)
    copy[:] = array
    return copy
