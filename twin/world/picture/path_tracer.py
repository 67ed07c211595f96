"""The picture by Mitsuba's own path integrator: light between markers, cover and window included.

Markers and the deformed cover are triangle meshes with Mitsuba's BSDFs, the window is its
dielectric interfaces, and its integrator, sampler and film make the picture. Two plug-ins hand it
the optics. `_FoldedCamera` starts its rays inside the body, in the directions of Snell's law
(`twin.world.picture.camera_rays`). `_FoldedLeds` finds the way from a place in the body to a random
place on an LED through the flat window, by Newton's iteration on Snell's sum. A path integrator
that knows neither meets small LEDs behind glass by chance only: it needs some ten thousand paths a
pixel instead of 64 (docs/picture.md).

Import this module after Mitsuba's variant is set: its classes derive from that variant's.

Validity: geometric optics; LEDs are points or discs that lie across z; light that leaves through
the window is lost. `twin.world.picture.render` adds what has no path here: the even share of light,
and the LEDs' mirror images in the window.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import isqrt
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from twin.arrays import Singles
from twin.parts.camera import DISC_WEIGHTS
from twin.parts.scene import Scene
from twin.world.picture.camera_rays import View
from twin.world.picture.cover import Background, CoverMotion
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.stock_scene import Triangles, surfaces, window

_LENGTH = 12
"""Interactions that a path is followed through."""

_BELOW_MM = 0.02
"""Depth under the base at which camera rays start, behind the window's interface."""

_NEWTON = 6
"""Steps to the ray of an LED; Newton's iteration climbs to the root from the paraxial value."""

_SHORT = 0.999
"""Share of the way to the base that is tested for shadows: the base itself is no obstacle."""

_ANGLES = 4096
"""Intervals of the cosine in the table of an LED's emission."""

_WINDOW = 512
"""Cells a side in the table of where light may enter the body."""

_AT_ONCE = 5_000_000
"""Paths in one pass: memory for a picture of any size stays that of its results."""


class PathTracer:
    """Path-traces one sensor's pictures.

    Parameters
    ----------
    scene
        The actual scene, with camera and light.
    views
        The camera's rays, or those through each point of its pupil, with their exposure.
    top
        The irradiance that counts as 1, of `twin.world.picture.lamps.Lamps.brightest`.
    paths
        Paths a pixel.
    """

    def __init__(self, scene: Scene, views: Sequence[View], top: float, paths: int) -> None:
        camera, _ = scene.imaging
        self._scene = scene
        self._top = top
        self._background = None if scene.cover is None else Background(scene, top)
        self._shape = (camera.height_px, camera.width_px, 3)
        size = camera.width_px * camera.height_px
        # The sampler takes squares: it would round other counts up, and say so for each pass.
        self._paths = max(min(isqrt(_AT_ONCE // size), isqrt(paths - 1) + 1), 1) ** 2
        self._passes = -(-paths // self._paths)
        # The window's interfaces send some light back into the body.
        interfaces = {
            name: {**table, "to_world": mi.ScalarTransform4f(table["to_world"])}
            for name, table in window(scene)[0].items()
        }
        self._fixed = self._optics(views) | interfaces

    def radiance(self, markers: Ellipsoids, cover: CoverMotion | None = None) -> Singles:
        """Return the (height, width, 3) light of the LEDs on the sensor, 1 filling its wells."""
        parts = surfaces(self._scene, markers, self._background, cover)
        meshes = {name: _mesh(surface, self._scene) for name, surface in parts.items()}
        made = mi.load_dict(self._fixed | meshes)
        film = np.zeros(self._shape, np.float32)
        for number in range(self._passes):
            film += np.array(mi.render(made, spp=self._paths, seed=number)) / self._passes
        # A white surface under irradiance E sends back E / pi.
        return (film * (np.pi / self._top)).astype(np.float32)

    def _optics(self, views: Sequence[View]) -> dict[str, Any]:
        """Return integrator, camera and LEDs."""
        camera, _ = self._scene.imaging
        film = {
            "type": "hdrfilm",
            "width": camera.width_px,
            "height": camera.height_px,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        }
        parts = mi.Properties("folded_camera")
        parts["film"] = mi.load_dict(film)
        parts["sampler"] = mi.load_dict({"type": "multijitter", "sample_count": self._paths})
        # Paths end early where little light is left: most end on the black cover.
        paths = {"type": "path", "max_depth": _LENGTH, "rr_depth": 1}
        return {
            "type": "scene",
            "integrator": paths,
            "sensor": _FoldedCamera(parts, views, self._scene.body.base_z_mm),
            "leds": _FoldedLeds(mi.Properties("folded_leds"), self._scene),
        }


class _FoldedCamera(mi.Sensor):
    """Mitsuba's sensor: rays between those through the corners of a pixel, inside the body.

    Parameters
    ----------
    parts
        Mitsuba's properties, with film and sampler.
    views
        The camera's rays, or those through each point of its pupil; paths choose one.
    base_z_mm
        Height of the base.
    """

    def __init__(self, parts: Any, views: Sequence[View], base_z_mm: float) -> None:
        super().__init__(parts)
        height, width = views[0].sees.shape
        self._size = width, height
        corners = [view.corners.astype(np.float32).ravel() for view in views]
        light = [(view.vignette * view.sees).ravel() for view in views]
        self._corners = mi.Float(np.concatenate(corners))
        self._light = mi.Float(np.concatenate(light))
        self._chosen = np.cumsum(DISC_WEIGHTS)[:-1].tolist() if len(views) > 1 else []
        self._start = base_z_mm - _BELOW_MM

    def sample_ray(
        self, _time: Any, _wavelength: Any, place: Any, aperture: Any, active: Any = True
    ) -> Any:
        """Return the ray through a place in the picture, both from 0 to 1, and its light."""
        width, height = self._size
        x = place.x * width
        y = place.y * height
        column = dr.minimum(mi.UInt32(x), width - 1)
        row = dr.minimum(mi.UInt32(y), height - 1)
        point = mi.UInt32(0)
        for share in self._chosen:
            point += mi.UInt32(dr.select(aperture.x > share, 1, 0))
        # The ray between those of the pixel's corners.
        corner = (point * (height + 1) + row) * (width + 1) + column
        here, right, below, both = (
            dr.gather(mi.Vector4f, self._corners, corner + step, active)
            for step in (0, 1, width + 1, width + 2)
        )
        across = x - mi.Float(column)
        upper = here + (right - here) * across
        lower = below + (both - below) * across
        ray = upper + (lower - upper) * (y - mi.Float(row))
        start = mi.Point3f(ray.x + ray.z * _BELOW_MM, ray.y + ray.w * _BELOW_MM, self._start)
        light = dr.gather(mi.Float, self._light, (point * height + row) * width + column, active)
        return mi.Ray3f(start, dr.normalize(mi.Vector3f(ray.z, ray.w, -1))), mi.Color3f(light)

    def sample_ray_differential(self, *sample: Any) -> Any:
        """Return `sample_ray`; no texture needs its neighbours."""
        ray, light = self.sample_ray(*sample)
        return mi.RayDifferential3f(ray), light

    def to_string(self) -> str:
        """Return a name for Mitsuba's messages."""
        return "FoldedCamera"


class _FoldedLeds(mi.Emitter):
    """Mitsuba's emitter: all LEDs, seen from places in the body through the flat window.

    Parameters
    ----------
    parts
        Mitsuba's properties.
    scene
        With camera and light.

    Notes
    -----
    The irradiance is that of `twin.world.picture.lamps.Lamps.at`, here at each place that a
    path meets instead of each marker's centre.
    """

    def __init__(self, parts: Any, scene: Scene) -> None:
        super().__init__(parts)
        self.m_flags = mi.EmitterFlags.DeltaPosition
        camera, light = scene.imaging
        places = np.array(light.positions_mm)
        self._count = len(places)
        within = scene.body.contains(places, 0.0)
        self._leds = mi.Float(np.column_stack([places, within]).astype(np.float32).ravel())
        self._radius = light.radius_mm
        self._powers = mi.Float((self._count * light.powers).astype(np.float32).ravel())
        self._index = scene.material.refractive_index
        self._base = scene.body.base_z_mm
        self._layers = [(layer.thickness_mm, layer.index) for layer in camera.layers]
        self._back = self._base + sum(thickness for thickness, _ in self._layers)
        emission = light.emission(np.linspace(-1, 1, _ANGLES + 1))
        self._emission = mi.Float(emission.astype(np.float32))
        # Where light may enter the body, cell by cell of its base.
        low, high = (np.array(corner[:2]) for corner in scene.body.bounds_mm)
        axes = (np.arange(_WINDOW) + 0.5) / _WINDOW
        x, y = np.meshgrid(low[0] + (high[0] - low[0]) * axes, low[1] + (high[1] - low[1]) * axes)
        cells = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, self._base)])
        self._enters = mi.Bool(scene.body.contains(cells, -1e-6))
        self._low = low.tolist()
        self._per_mm = (_WINDOW / (high - low)).tolist()

    def sample_direction(self, seen_from: Any, sample: Any, active: Any = True) -> Any:
        """Return the way to a place on one of the LEDs, both chosen at random, and its light."""
        at = sample.x * self._count
        which = dr.minimum(mi.UInt32(at), self._count - 1)
        led = dr.gather(mi.Vector4f, self._leds, which, active)
        within = led.w > 0
        if self._radius > 0:
            aside = mi.warp.square_to_uniform_disk(mi.Point2f(at - mi.Float(which), sample.y))
            led.x += self._radius * aside.x
            led.y += self._radius * aside.y
        place = mi.Vector3f(seen_from.p)
        # An LED in the body is seen straight on.
        way = mi.Vector3f(led.x, led.y, led.z) - place
        distance = dr.norm(way)
        straight = way / distance
        # Another one through the window: the sine of the ray in the body gives its direction.
        reach = dr.sqrt(way.x * way.x + way.y * way.y)
        depth = dr.maximum(self._base - place.z, 0)
        p, slope = self._tangent(reach, depth, led.z - self._back)
        in_air = dr.rsqrt(1 + p * p)
        sine = p * in_air / self._index
        cosine = dr.sqrt(1 - sine * sine)
        sideways = dr.maximum(reach, 1e-6)
        bent = mi.Vector3f(way.x / sideways * sine, way.y / sideways * sine, cosine)
        over = dr.select(reach > 1e-6, p / sideways, 1 / slope)
        spread = in_air * in_air * in_air * over / (slope * cosine)
        light = self._passed(p) * spread * self._lets_in(place + bent * (depth / cosine), active)
        # Either of them.
        towards = dr.select(within, straight, bent)
        light = dr.select(within, 1 / (distance * distance), light)
        light *= self._emitted(dr.select(within, straight.z, in_air), active)
        found: Any = dr.zeros(mi.DirectionSample3f, dr.width(light))
        found.d = towards
        found.dist = dr.select(within, distance, depth / cosine) * _SHORT
        found.p = seen_from.p + towards * found.dist
        found.n = -towards
        found.time = seen_from.time
        found.pdf = mi.Float(1)
        found.delta = mi.Bool(True)
        found.emitter = mi.EmitterPtr(self)
        power = dr.gather(mi.Color3f, self._powers, which, active)
        arrives = mi.Bool(active) & (place.z < self._base) & (light > 0)
        return found, power * dr.select(arrives, light, 0)

    def _tangent(self, reach: Any, depth: Any, air: Any) -> tuple[Any, Any]:
        """Return `twin.theory.optics.air_tangents` and the derivative of the way aside there."""
        stack = [(depth, self._index), *self._layers]

        def sideways(p: Any) -> tuple[Any, Any]:
            moved = air * p
            slope = mi.Float(air)
            for thickness, index in stack:
                inverse = dr.rsqrt(index * index + (index * index - 1) * p * p)
                moved = moved + thickness * p * inverse
                slope = slope + thickness * index * index * inverse * inverse * inverse
            return moved, slope

        p = reach / sideways(mi.Float(0))[1]
        for _ in range(_NEWTON):
            moved, slope = sideways(p)
            p = p + (reach - moved) / slope
        return p, sideways(p)[1]

    def _passed(self, p: Any) -> Any:
        """Return `twin.theory.optics.transmission`."""
        sine2 = p * p / (1 + p * p)
        share = mi.Float(1)
        for one, two in pairwise([self._index, *(index for _, index in self._layers), 1.0]):
            a = dr.sqrt(one * one - sine2)
            b = dr.sqrt(two * two - sine2)
            across = (a - b) / (a + b)
            along = (two * two * a - one * one * b) / (two * two * a + one * one * b)
            straight = 1 - ((one - two) / (one + two)) ** 2
            share = share * (1 - (across * across + along * along) / 2) / straight
        return share

    def _lets_in(self, crossing: Any, active: Any) -> Any:
        """Return 1 where light that crosses the base enters the body, else 0."""
        column = (crossing.x - self._low[0]) * self._per_mm[0]
        row = (crossing.y - self._low[1]) * self._per_mm[1]
        inside = active & (column >= 0) & (column < _WINDOW) & (row >= 0) & (row < _WINDOW)
        cell = mi.UInt32(dr.clip(row, 0, _WINDOW - 1)) * _WINDOW
        cell += mi.UInt32(dr.clip(column, 0, _WINDOW - 1))
        return dr.select(dr.gather(mi.Bool, self._enters, cell, inside), 1, 0)

    def _emitted(self, cosine: Any, active: Any) -> Any:
        """Return `twin.parts.camera.Light.emission`, from its table."""
        at = dr.clip((cosine + 1) / 2, 0, 1) * _ANGLES
        first = dr.minimum(mi.UInt32(at), _ANGLES - 1)
        one = dr.gather(mi.Float, self._emission, first, active)
        two = dr.gather(mi.Float, self._emission, first + 1, active)
        return one + (two - one) * (at - mi.Float(first))

    def eval(self, *_: Any) -> Any:
        """Return no light: a point is never met."""
        return mi.Color3f(0)

    def eval_direction(self, *_: Any) -> Any:
        """Return no light: a point is never met."""
        return mi.Color3f(0)

    def pdf_direction(self, *_: Any) -> Any:
        """Return 0: a point is never met."""
        return mi.Float(0)

    def to_string(self) -> str:
        """Return a name for Mitsuba's messages."""
        return "FoldedLeds"


def _mesh(surface: Triangles, scene: Scene) -> Any:
    """Return Mitsuba's mesh of a surface in its colours."""
    parts = mi.Properties()
    parts["bsdf"] = mi.load_dict(surface.paint(scene))
    counts = len(surface.places), len(surface.faces)
    mesh = mi.Mesh("mesh", *counts, has_vertex_normals=True, props=parts)
    colours: Any = surface.colours.astype(np.float32).ravel()
    mesh.add_attribute("vertex_color", 3, colours)
    numbers = mi.traverse(mesh)
    numbers["vertex_positions"] = surface.places.astype(np.float32).ravel()
    numbers["vertex_normals"] = surface.normals.astype(np.float32).ravel()
    numbers["faces"] = surface.faces.astype(np.uint32).ravel()
    numbers.update()
    return mesh
