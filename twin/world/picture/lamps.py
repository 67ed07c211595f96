"""The light that each LED sends to places in the body.

The LEDs stand in air behind the base, where refraction bends and spreads their light, or in the
body, where it does neither. Each place sees an LED in air at a virtual image, which is exact at a
marker's centre. Across one marker the LED stays there, and its power changes linearly, so that the
light does as it should. (In the finger LEDs shine in at grazing angles: one paraxial image would
light markers that Snell's law keeps dark, and an even power moves centroids by up to 0.13 px.)

Validity: LEDs are points or seven points on a disc; single scattering plus an even ambient share,
no light between markers; LEDs in the body are not seen themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Points
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.theory.optics import air_tangents, sideways, transmission
from twin.world.picture.ellipsoids import Ellipsoids


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """Virtual point sources: the irradiance of a surface at x with normal n is power (n . l) /
    |l|^3, l = place - x.

    Attributes
    ----------
    place
        (n, leds, 3) mm.
    power
        (n, leds) 0 where the LED's light does not arrive.
    change
        (n, leds, 3) of the power along x, y and z, 1/mm; none where it isn't wanted, and of LEDs
        in the body.
    """

    place: Floats
    power: Floats
    change: Floats | None = None

    @staticmethod
    def at(points: Points, scene: Scene, *, changing: bool = False) -> Lamps:
        """Return each LED's virtual image for each of (n, 3) points in the body, with the change of
        its power around them if that is wanted.

        Raises
        ------
        RecipeError
            An LED lies within a layer or outside the body.
        """
        _, light = scene.imaging
        leds, share = light.points()
        within = scene.body.contains(leds, 0.0)
        place = np.empty((len(points), len(leds), 3))
        power = np.empty((len(points), len(leds)))
        change = np.zeros((len(points), len(leds), 3))
        if within.any():
            towards = points[:, None] - leds[within]
            cosine = -towards[:, :, 2] / np.maximum(np.linalg.norm(towards, axis=2), 1e-9)
            place[:, within] = leds[within]
            power[:, within] = light.emission(cosine)
        if not within.all():
            place[:, ~within], power[:, ~within], change[:, ~within] = _refracted(
                points, leds[~within], scene, changing=changing
            )
        return Lamps(
            place=place,
            power=power * share,
            change=change * share[:, None] if changing else None,
        )

    @staticmethod
    def brightest(rest: Ellipsoids, scene: Scene) -> tuple[float, float]:
        """Return the largest irradiance on a marker at rest, and the most light in a channel that
        leaves one.

        The second number is in units of what white paper sends back in the brightest marker's
        place. Both fix the exposure at rest: a press doesn't change the camera's gain.

        Raises
        ------
        RecipeError
            No LED reaches any marker.
        """
        _, light = scene.imaging
        markers = rest.rows(rest.present)
        lamps = Lamps.at(markers.centres, scene)
        towards = lamps.place - markers.centres[:, None]
        unit = towards / np.linalg.norm(towards, axis=2, keepdims=True)
        total = np.sum(unit * (lamps.power / np.sum(towards**2, axis=2))[:, :, None], axis=1)
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
        candidates = [total, *np.moveaxis(unit, 1, 0)]
        # A flat marker shows its face, a round one also the side that is turned to the light.
        turned, sizes, _ = np.linalg.svd(markers.axes)
        face = turned[:, :, 2] * np.where(turned[:, 2, 2] < 0, -1.0, 1.0)[:, None]
        flat = sizes[:, 2] < 0.5 * sizes[:, 0]

        def best(lights: Lamps) -> Floats:
            round_ones = [lights.irradiance(markers.centres, normals) for normals in candidates]
            flat_ones = lights.irradiance(markers.centres, face)
            return np.where(flat, flat_ones, np.max(round_ones, axis=0, initial=0.0))

        top = float(best(lamps).max(initial=0.0))
        if top <= 0:
            raise RecipeError(
                "light.positions_mm: no LED reaches any marker: move the LEDs over the base"
            )
        tints, even = light.tints()
        direct = np.column_stack([best(lamps.times(tint)) / top for tint in tints])
        bright = markers.colour * ((1 - light.ambient) * direct + light.ambient * even)
        return top, max(float(np.max(bright @ scene.ccd.response.T)), 1e-6)

    def times(self, shares: Floats) -> Lamps:
        """Return the lamps with (leds,) shares of their powers."""
        return Lamps(place=self.place, power=self.power * shares)

    def irradiance(self, points: Points, normals: Floats) -> Floats:
        """Return (n,) unshadowed irradiance at points with unit normals."""
        return np.asarray(self.irradiances(points, normals).sum(axis=1))

    def irradiances(self, points: Points, normals: Floats) -> Floats:
        """Return the (n, leds) parts of `irradiance`."""
        towards = self.place - points[:, None]
        cosine = np.maximum(np.einsum("nli,ni->nl", towards, normals), 0.0)
        return np.asarray(self.power * cosine / np.linalg.norm(towards, axis=2) ** 3)


_STEP_MM = 1e-4
"""Distance over which the change of a power is taken."""


def _refracted(
    points: Points, leds: Points, scene: Scene, *, changing: bool
) -> tuple[Floats, Floats, Floats]:
    """Return (n, leds, 3) places, (n, leds) powers, and the (n, leds, 3) changes of these, of the
    images of (leds, 3) LEDs in air, of intensity 1.

    A cone dp of an LED's rays, of intensity 1, fills a ring dr of the body: the flux through a
    surface across the ray is E = sin(a) sin(a) da / (r dr cos(b)), a and b the angles in air and
    body, times Fresnel's transmission. The power that gives E at x in the place P is E |P - x|^2.
    """
    camera, index, base = scene.optics
    layers = camera.layers
    back = base + camera.window_mm
    if (leds[:, 2] < back - 1e-9).any():
        raise RecipeError(
            f"light.positions_mm: z = {leds[:, 2].min():.6g} mm must be at least {back:.6g} mm, "
            "behind the base and the layers, or in the body: move the LED back"
        )
    shape = len(points), len(leds)
    aside = (leds[None, :, :2] - points[:, None, :2]).reshape(-1, 2)
    reach = np.sqrt(aside[:, 0] ** 2 + aside[:, 1] ** 2)
    depth = np.repeat(np.maximum(base - points[:, 2], 0.0), len(leds))
    air = np.tile(np.maximum(leds[:, 2] - back, 0.0), len(points))
    emission = scene.imaging[1].emission
    # On the axis p / reach tends to 1 / slope, and the direction aside is zero.
    off = reach > 1e-9
    distance_aside = np.where(off, reach, 1.0)

    def spread(p: Floats, reach: Floats, depth: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        _, slope = sideways(p, depth, index, layers, air)
        cosine_air = 1 / np.sqrt(1 + p * p)
        sine = p * cosine_air / index
        cosine = np.sqrt(1 - sine * sine)
        over = np.where(off, p / np.where(off, reach, 1.0), 1 / slope)
        return cosine_air**3 * over / (slope * cosine), slope, sine, cosine

    def sent(p: Floats) -> Floats:
        return np.asarray(transmission(p, index, layers) * emission(1 / np.sqrt(1 + p * p)))

    with np.errstate(divide="ignore", invalid="ignore"):  # where no ray leads to the LED
        p = air_tangents(reach, depth, index, layers, air)
        thin, slope, sine, cosine = spread(p, reach, depth)
        distance = index / np.sqrt(thin)
        ray = np.column_stack([aside * (sine / distance_aside)[:, None], cosine])
        start = np.repeat(points, len(leds), axis=0)
        place = start + ray * distance[:, None]
        # The ray has to enter the body through its base.
        across = start[:, :2] + ray[:, :2] * (depth / cosine)[:, None]
        crossing = np.column_stack([across, start[:, 2] + depth])
    # The image's distance squared times the spread is the index squared.
    power = index * index * sent(p)
    arrives = np.isfinite(power) & scene.body.contains(np.nan_to_num(crossing), -1e-6)
    change = np.zeros_like(place)
    if changing:
        with np.errstate(divide="ignore", invalid="ignore"):
            # The same ray, further aside and deeper: how p changes follows from Snell's sum.
            further = p + _STEP_MM / slope
            deeper = p - _STEP_MM * p / np.sqrt(index**2 + (index**2 - 1) * p * p) / slope
            aside_change = sent(further) * spread(further, reach + _STEP_MM, depth)[0]
            depth_change = sent(deeper) * spread(deeper, reach, depth + _STEP_MM)[0]
            light = sent(p) * thin
            change[:, :2] = -aside * ((aside_change - light) / distance_aside)[:, None]
            change[:, 2] = light - depth_change
            change *= (distance**2 / _STEP_MM)[:, None]
            change -= 2 * light[:, None] * (place - start)
        change = np.where((arrives & off)[:, None], change, 0.0)
    power = np.where(arrives, power, 0.0)
    place = np.where(arrives[:, None], place, [0.0, 0.0, 2 * base])
    return place.reshape(*shape, 3), power.reshape(shape), change.reshape(*shape, 3)
