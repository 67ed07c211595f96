"""Highlights: the LEDs' mirror images in the smooth skins of markers, in closed form.

A skin is a rough mirror of small facets whose slopes have the GGX distribution (Walter et al.,
"Microfacet models for refraction through rough surfaces", 2007), as `roughplastic` of Mitsuba has.
A facet mirrors an LED into the camera where its normal halves the angle between the two. So a
highlight is light from a point's surroundings, in amounts that the curvature of the surface gives:
R E / (4 K) into each unit of solid angle, R the share mirrored at half that angle, E the irradiance
across the light's way and K the Gaussian curvature. It is drawn as samples of the facets' normals,
each in the pixel where its place is seen, which is the mean over each pixel's square.

Validity: what a skin mirrors is not taken from what is below it (0.4 % of index 1.59 in silicone);
facets mirror neither other markers nor even light; a highlight is hidden as a whole or not at all.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, Singles
from twin.compiled import njit
from twin.parts.scene import Scene
from twin.theory.optics import project_with_jacobian, reflection
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.lamps import Lamps
from twin.world.picture.picture_job import Indices, occluders

_AROUND, _RINGS = 8, 7
"""Normals of facets for each LED: so many around, and from steep to flat; those of one ring for
each point of a disc."""

_GOLDEN = (np.sqrt(5) - 1) / 2
"""By this share of a step each ring is turned against the one before."""


def highlights(markers: Ellipsoids, scene: Scene, top: float) -> Singles:
    """Return the (height, width, 3) light of highlights before the camera's vignetting and gain, 1
    for white in the brightest marker's place.

    Parameters
    ----------
    markers, scene
        The markers as they are now, some with `gloss`, and the actual scene.
    top
        The irradiance that counts as 1, of `twin.world.picture.lamps.Lamps.brightest`.
    """
    camera, light = scene.imaging
    assert markers.gloss is not None
    places_px, jacobian = project_with_jacobian(markers.centres, *scene.optics)
    seen = np.isfinite(places_px).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    which = np.flatnonzero(markers.present & (markers.gloss[:, 0] > 0) & seen)
    index, roughness = markers.gloss[which].T[:, :, None]
    centres, axes = markers.centres[which], markers.axes[which]
    lamps = Lamps.at(centres, scene)

    # The place where the surface itself mirrors each LED; the ray to the camera moves no pixel.
    view = np.cross(jacobian[which, 0], jacobian[which, 1])
    view = _unit(view * np.where(view[:, 2:] < 0, -1, 1))[:, None]
    place = np.repeat(centres[:, None], lamps.place.shape[1], axis=1)
    for _ in range(2):
        towards = lamps.place - place
        normal = _unit(_unit(towards) + view)
        # An ellipsoid has the normal m at A A^T m / |A^T m| from its centre.
        turned = normal @ axes
        turned /= np.linalg.norm(turned, axis=2, keepdims=True)
        place = centres[:, None] + turned @ np.swapaxes(axes, 1, 2)
    distance = np.linalg.norm(towards, axis=2)
    cosine = np.sum(towards * normal, axis=2) / distance
    free = _unhidden(markers, which, place, lamps.place, centres + 100 * view[:, 0])
    # What facets shadow and hide of each other is off (Smith), as at the middle of a highlight.
    slant = np.sqrt(1 / np.clip(cosine, 1e-3, 1) ** 2 - 1)
    mirrored = reflection(slant, 1.0, index / scene.material.refractive_index)
    open_both_ways = (2 / (1 + np.sqrt(1 + (roughness * slant) ** 2))) ** 2
    power = np.pi / 4 * mirrored * lamps.power / (distance**2 * top) * free * open_both_ways

    # A pixel's light is what comes from the area that it sees.
    local = jacobian[which]
    area = np.sqrt(np.linalg.det(local @ np.swapaxes(local, 1, 2)))
    power *= (area * np.linalg.det(axes) ** 2)[:, None]
    # Normals of facets about that place's, in rings, each standing for the same share of them.
    rings = np.arange(_RINGS if light.radius_mm == 0 else 1)
    turn = 2 * np.pi / _AROUND * (np.arange(_AROUND) + _GOLDEN * rings[:, None])
    around = np.stack([np.cos(turn), np.sin(turn)], axis=2)
    one = _unit(np.cross(normal, [1.0, 0.0, 0.0]))
    frames = np.stack([one, np.cross(normal, one), normal, towards], axis=2)
    tints = np.broadcast_to(light.tints()[0], (3, power.shape[1]))
    picture = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
    seen_at = (view[:, 0], axes, places_px[which], local)
    _draw(around, roughness[:, 0], frames, power, *seen_at, tints, picture)
    return (1 - np.float32(light.ambient)) * picture


@njit(cache=True, nogil=True)
def _draw(
    around: Floats,
    roughness: Floats,
    frames: Floats,
    power: Floats,
    view: Points,
    axes: Floats,
    middles: Floats,
    local: Floats,
    tints: Floats,
    picture: Singles,
) -> None:
    """Add every highlight's samples to the (height, width, 3) ``picture``, each in the pixel where
    the surface has its normal.

    ``around`` (rings, samples, 2) are directions of unit length. The rows of
    ``frames`` (n, leds, 4, 3) are two tangents, the normal and the way to the LED; ``local`` is the
    projection's Jacobian at the markers' ``middles``.
    """
    height, width, _ = picture.shape
    facet = np.empty(3)
    turned = np.empty(3)
    for i, led in np.ndindex(power.shape):
        if power[i, led] <= 0:
            continue
        frame = frames[i, led]
        # Semi-axes in the picture.
        mapped = local[i] @ axes[i]
        for ring in range(len(around)):
            q = (ring + 0.5) / len(around)
            tangent = roughness[i] * np.sqrt(q / (1 - q))
            cosine = 1 / np.sqrt(1 + tangent * tangent)
            share = power[i, led] / (cosine * around[..., 0].size)
            for number in range(around.shape[1]):
                s = tangent * around[ring, number, 0]
                t = tangent * around[ring, number, 1]
                lit = 0.0
                seen = 0.0
                for c in range(3):
                    facet[c] = cosine * (frame[2, c] + s * frame[0, c] + t * frame[1, c])
                    lit += facet[c] * frame[3, c]
                    seen += facet[c] * view[i, c]
                if lit <= 0 or seen <= 0:
                    continue
                square = 0.0
                for c in range(3):
                    turned[c] = 0.0
                    for d in range(3):
                        turned[c] += axes[i, d, c] * facet[d]
                    square += turned[c] * turned[c]
                inverse = 1 / np.sqrt(square)
                column = middles[i, 0] + 0.5
                row = middles[i, 1] + 0.5
                for c in range(3):
                    column += mapped[0, c] * turned[c] * inverse
                    row += mapped[1, c] * turned[c] * inverse
                x = int(np.floor(column))
                y = int(np.floor(row))
                if 0 <= x < width and 0 <= y < height:
                    for c in range(3):
                        picture[y, x, c] += np.float32(share / (square * square) * tints[c, led])


def _unit(vectors: Floats) -> Floats:
    """Return vectors of length 1."""
    unit: Floats = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    return unit


def _unhidden(
    markers: Ellipsoids, which: Ints, place: Floats, leds: Floats, camera: Points
) -> Bools:
    """Return (n, leds) whether no other marker stands between a (n, leds, 3) place on a marker of
    ``which`` and its LED, or its (n, 3) place of the camera."""
    count = leds.shape[1]
    targets = np.zeros((len(markers), count + 1, 3))
    targets[which] = np.concatenate([leds, camera[:, None]], axis=1)
    wanted = np.zeros((len(markers), count + 1), bool)
    wanted[which] = True
    sizes = np.linalg.norm(markers.axes, axis=(1, 2))
    first, members = occluders(markers.centres, sizes, targets, wanted)
    free = np.ones((len(which), count), bool)
    row_of = np.zeros(len(markers), int)
    row_of[which] = np.arange(len(which))
    pair = np.repeat(np.arange(len(first) - 1), np.diff(first))
    row, column = row_of[pair // (count + 1)], pair % (count + 1)
    for led in range(count):
        near = (column == led) | (column == count)
        i, other, target = row[near], members[near], targets[which[row[near]], column[near]]
        free[i[_blocks(markers, other, place[i, led], target)], led] = False
    return free


def _blocks(markers: Ellipsoids, others: Indices, start: Points, end: Points) -> Bools:
    """Return whether the line between two places, (m, 3) each, meets each of (m,) markers."""
    metric = np.linalg.inv(markers.axes[others])
    begin = np.einsum("mij,mj->mi", metric, start - markers.centres[others])
    way = np.einsum("mij,mj->mi", metric, end - start)
    part = np.clip(-np.sum(begin * way, axis=1) / np.sum(way**2, axis=1), 0, 1)
    return np.asarray(np.sum((begin + part[:, None] * way) ** 2, axis=1) < 1)
