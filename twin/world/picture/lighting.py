"""Light in the body: what each LED sends to each marker, and how bright the cover is.

The LEDs stand in air behind the base, where refraction bends and spreads their light, so that a marker sees each LED
from another direction and distance than in air; or in the body, where they are what they are. Both are exact at the
marker's centre here; across one marker the LED is a point source at its virtual image, which is what the renderer
shades and shadows with.

Why per marker and not one paraxial image per LED: in the finger LEDs shine in at grazing angles, where the paraxial
image would light markers that Snell's law keeps dark.

Validity: LEDs are points or seven points on a disc; single scattering plus an even ambient share, no interreflection;
LEDs in the body are not seen themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Points
from twin.errors import RecipeError
from twin.parts.scene import Scene
from twin.world.picture.exposure import response_matrix
from twin.world.picture.images import images
from twin.world.picture.markers import Ellipsoids


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """Virtual point sources: the irradiance of a surface at x with normal n is power (n . l) / |l|^3, l = place - x.

    Attributes
    ----------
    place
        (n, leds, 3) mm.
    power
        (n, leds) 0 where the LED's light does not arrive.
    """

    place: Floats
    power: Floats


def lamps_at(points: Points, scene: Scene) -> Lamps:
    """Return each LED's virtual image for each of (n, 3) points in the body.

    Raises
    ------
    RecipeError
        An LED lies within a layer or beside the body.
    """
    assert scene.light is not None
    leds, share = scene.light.points()
    within = scene.body.contains(leds, 0.0)
    place, power = np.empty((len(points), len(leds), 3)), np.empty((len(points), len(leds)))
    if within.any():
        towards = points[:, None] - leds[within]
        cosine = -towards[:, :, 2] / np.maximum(np.linalg.norm(towards, axis=2), 1e-9)
        place[:, within], power[:, within] = leds[within], scene.light.emission(cosine)
    if not within.all():
        place[:, ~within], power[:, ~within] = _refracted(points, leds[~within], scene)
    return Lamps(place=place, power=power * share)


def _refracted(points: Points, leds: Points, scene: Scene) -> tuple[Floats, Floats]:
    """Return (n, leds, 3) places and (n, leds) powers of the images of (leds, 3) LEDs in air, of power 1."""
    assert scene.camera is not None
    assert scene.light is not None
    layers, index, base = scene.camera.layers, scene.material.refractive_index, scene.body.base_z_mm
    back = base + sum(layer.thickness_mm for layer in layers)
    if (leds[:, 2] < back - 1e-9).any():
        raise RecipeError(
            f"light.positions_mm: z = {leds[:, 2].min():.6g} mm must be at least {back:.6g} mm, "
            "behind the base and the layers, or in the body: move the LED back"
        )
    place, power, crossing, leaving = images(points, leds, layers, index, base)
    arrives = np.isfinite(power) & scene.body.contains(np.nan_to_num(crossing).reshape(-1, 3), -1e-6).reshape(
        power.shape
    )
    power = np.where(arrives, power * scene.light.emission(leaving), 0.0)
    return np.where(arrives[:, :, None], place, [0.0, 0.0, 2 * base]), power


def irradiance(points: Points, normals: Floats, lamps: Lamps) -> Floats:
    """Return (n,) unshadowed irradiance at points with unit normals."""
    towards = lamps.place - points[:, None]
    cosine = np.maximum(np.einsum("nli,ni->nl", towards, normals), 0.0)
    total: Floats = np.sum(lamps.power * cosine / np.linalg.norm(towards, axis=2) ** 3, axis=1)
    return total


def brightest(rest: Ellipsoids, scene: Scene) -> tuple[float, float]:
    """Return the largest irradiance on a marker at rest, and the most light in a channel that leaves one.

    The second number counts in units of what white paper gives off in the brightest marker's place. The exposure is
    fixed by both once, at rest, so that a press doesn't change the camera's gain.

    Raises
    ------
    RecipeError
        No LED reaches any marker.
    """
    assert scene.light is not None
    markers = rest.rows(rest.present)
    lamps = lamps_at(markers.centres, scene)
    towards = lamps.place - markers.centres[:, None]
    unit = towards / np.linalg.norm(towards, axis=2, keepdims=True)
    total = np.sum(unit * (lamps.power / np.sum(towards**2, axis=2))[:, :, None], axis=1)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    candidates = [total, *np.moveaxis(unit, 1, 0)]
    best = np.max([irradiance(markers.centres, normals, lamps) for normals in candidates], axis=0, initial=0.0)
    # A flat marker shows its face, a round one also the side that is turned to the light.
    turned, sizes, _ = np.linalg.svd(markers.axes)
    face = turned[:, :, 2] * np.where(turned[:, 2, 2] < 0, -1.0, 1.0)[:, None]
    best = np.where(sizes[:, 2] < 0.5 * sizes[:, 0], irradiance(markers.centres, face, lamps), best)
    top = float(best.max(initial=0.0))
    if top <= 0:
        raise RecipeError("light.positions_mm: no LED reaches any marker: move the LEDs over the base")
    ambient = scene.light.ambient
    colours = np.max(markers.colour @ response_matrix(scene.ccd).T, axis=1)
    return top, max(float(np.max(colours * ((1 - ambient) * best / top + ambient))), 1e-6)


def cover_light(origins: Points, directions: Floats, scene: Scene, top: float) -> Floats:
    """Return (n, 3) light from the cover along rays inside the body; 0 where a ray leaves the body or there is none.

    Parameters
    ----------
    origins, directions
        (n, 3) rays from the base plane, mm; NaN rays see nothing.
    top
        The irradiance that counts as 1, of `brightest`.

    Notes
    -----
    The cover takes no shadows, as it is nearly black.
    """
    light = np.zeros((len(origins), 3))
    if scene.cover is not None:
        points, normals = cover_places(origins, directions, scene)
        seen = np.isfinite(points[:, 0])
        bright = cover_brightness(points[seen], normals[seen], scene, top)
        light[seen] = bright[:, None] * np.asarray(scene.cover.albedo)
    return light


def cover_places(origins: Points, directions: Floats, scene: Scene) -> tuple[Points, Floats]:
    """Return (n, 3) places where rays inside the body meet the cover at rest, mm, and its inward normals; NaN for none.

    Notes
    -----
    The cover's inner side is a level set of the depth, an exact distance: rays are marched by it.
    """
    assert scene.cover is not None
    points, normals = np.full((len(origins), 3), np.nan), np.full((len(origins), 3), np.nan)
    seen = np.flatnonzero(np.isfinite(origins).all(axis=1) & scene.body.contains(np.nan_to_num(origins), -1e-6))
    start, along = origins[seen], directions[seen]
    way, room = np.zeros(len(start)), np.zeros(len(start))
    for _ in range(80):
        room = scene.body.depth(start + along * way[:, None]) - scene.cover.thickness_mm
        way += room
        if not np.any(np.abs(room) > 1e-4):
            break
    places = start + along * way[:, None]
    hits = (scene.body.piece_distances(places)[:, 1:] > -1e-3).all(axis=1) & (np.abs(room) < 1e-2)
    points[seen[hits]] = places[hits]
    normals[seen[hits]] = scene.body.piece_normals(places[hits])[:, 0]
    return points, normals


def cover_brightness(points: Points, normals: Floats, scene: Scene, top: float) -> Floats:
    """Return (n,) light that white places of the cover would give off, a share of even light included."""
    assert scene.light is not None
    ambient = scene.light.ambient
    bright: Floats = (1 - ambient) * irradiance(points, normals, lamps_at(points, scene)) / top + ambient
    return bright
