"""Highlights: the LEDs' mirror images in the smooth skins of markers, in closed form.

A skin is a rough mirror of small facets whose slopes have the GGX distribution (Walter et al.,
"Microfacet models for refraction through rough surfaces", 2007), as `ggx` of Mitsuba has.
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
from twin.theory.optics import reflection
from twin.world.picture.camera_rays import View
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.picture_job import Indices, PictureJob

_AROUND, _RINGS = 8, 7
"""Normals of facets for each LED: so many around, and from steep to flat; those of one ring for
each point of a disc."""

_GOLDEN = (np.sqrt(5) - 1) / 2
"""By this share of a step each ring is turned against the one before."""


def add_highlights(
    picture: Singles, markers: Ellipsoids, job: PictureJob, scene: Scene, view: View
) -> None:
    """Add the light of highlights to a (height, width, 3) picture.

    Parameters
    ----------
    picture
        In which 1 is the light that fills the wells.
    markers, job
        The markers as they are now, some with `gloss`, and the job that shades them: LEDs that it
        has shadowed are hidden from highlights, too.
    scene, view
        The actual scene, and its camera's rays.
    """
    _, light = scene.imaging
    assert markers.gloss is not None
    seen = np.isfinite(job.top)
    which = np.flatnonzero(markers.present & (markers.gloss[:, 0] > 0) & seen)
    index, roughness = markers.gloss[which].T[:, :, None]
    centres, axes, local = markers.centres[which], markers.axes[which], job.jacobian[which]
    leds = job.lamps[which, :, :3] * job.unit_mm + [0.0, 0.0, job.behind_mm]
    strength = (1 - light.ambient) * job.unit_mm**2 * job.lamps[which, :, 3]

    # The place where the surface itself mirrors each LED; the ray to the camera moves no pixel.
    across = np.cross(local[:, 0], local[:, 1])
    to_camera = _unit(across * np.where(across[:, 2:] < 0, -1, 1))[:, None]
    place = centres[:, None]
    for _ in range(2):
        towards = leds - place
        normal = _unit(_unit(towards) + to_camera)
        # An ellipsoid has the normal m at A A^T m / |A^T m| from its centre.
        place = centres[:, None] + _unit(normal @ axes) @ np.swapaxes(axes, 1, 2)
    distance = np.linalg.norm(towards, axis=2)
    cosine = np.einsum("nlc,nlc->nl", towards, normal) / distance
    free = _unhidden(markers, job, which, place, leds, centres + 100 * to_camera[:, 0])
    # What facets shadow and hide of each other is off (Smith), as at the middle of a highlight.
    slant = np.sqrt(1 / np.clip(cosine, 1e-3, 1) ** 2 - 1)
    mirrored = reflection(slant, 1.0, index / scene.material.refractive_index)
    open_both_ways = (2 / (1 + np.sqrt(1 + (roughness * slant) ** 2))) ** 2
    power = np.pi / 4 * mirrored * strength / distance**2 * free * open_both_ways

    # A pixel's light is what comes from the area that it sees.
    power *= (np.linalg.norm(across, axis=1) * np.linalg.det(axes) ** 2)[:, None]
    # Normals of facets about that place's, in rings, each standing for the same share of them.
    rings = np.arange(_RINGS if light.radius_mm == 0 else 1)
    turn = 2 * np.pi / _AROUND * (np.arange(_AROUND) + _GOLDEN * rings[:, None])
    around = np.stack([np.cos(turn), np.sin(turn)], axis=2)
    tints = np.broadcast_to(job.tints, (3, power.shape[1]))
    seen_at = (job.centres_px[which], local @ axes, tints, view.vignette)
    ways = (axes, towards, to_camera[:, 0])
    _draw(around, roughness[:, 0], normal, *ways, power, *seen_at, picture)


@njit(cache=True)
def _draw(
    around: Floats,
    roughness: Floats,
    normals: Floats,
    axes: Floats,
    towards: Floats,
    to_camera: Floats,
    power: Floats,
    middles: Floats,
    mapped: Floats,
    tints: Floats,
    vignette: Singles,
    picture: Singles,
) -> None:
    """Add every highlight's samples to the (height, width, 3) ``picture``, each in the pixel where
    the surface has its normal.

    ``around`` (rings, samples, 2) are unit directions, ``normals`` (n, leds, 3) those about which
    facets' normals lie, ``axes`` (n, 3, 3) the semi-axes as columns, ``towards`` (n, leds, 3) and
    ``to_camera`` (n, 3) ways, ``mapped`` (n, 2, 3) the semi-axes in the picture about ``middles``.
    """
    height, width, _ = picture.shape
    samples = around.shape[0] * around.shape[1]
    frame = np.empty((3, 3))
    ways = np.empty((3, 5))
    parts = np.empty((3, 5))
    for i, led in np.ndindex(power.shape):
        if power[i, led] <= 0:
            continue
        # Two tangents and the normal, and what each has along the semi-axes, to LED and camera.
        a, b, c = normals[i, led]
        slope = max(np.sqrt(b * b + c * c), 1e-300)
        frame[0] = 0.0, c / slope, -b / slope
        frame[1] = -slope, a * b / slope, a * c / slope
        frame[2] = a, b, c
        ways[:, :3], ways[:, 3], ways[:, 4] = axes[i], towards[i, led], to_camera[i]
        for row, column in np.ndindex(3, 5):
            parts[row, column] = 0.0
            for k in range(3):
                parts[row, column] += frame[row, k] * ways[k, column]
        one, two, normal = parts
        for ring in range(around.shape[0]):
            q = (ring + 0.5) / around.shape[0]
            tangent = roughness[i] * np.sqrt(q / (1 - q))
            # Lengths count relative to the facet's part along the normal.
            cosine = 1 / np.sqrt(1 + tangent * tangent)
            share = power[i, led] / (cosine**5 * samples)
            for number in range(around.shape[1]):
                s = tangent * around[ring, number, 0]
                t = tangent * around[ring, number, 1]
                lit = normal[3] + s * one[3] + t * two[3]
                seen = normal[4] + s * one[4] + t * two[4]
                if lit <= 0 or seen <= 0:
                    continue
                a = normal[0] + s * one[0] + t * two[0]
                b = normal[1] + s * one[1] + t * two[1]
                c = normal[2] + s * one[2] + t * two[2]
                square = a * a + b * b + c * c
                inverse = 1 / np.sqrt(square)
                column = (mapped[i, 0, 0] * a + mapped[i, 0, 1] * b + mapped[i, 0, 2] * c) * inverse
                row = (mapped[i, 1, 0] * a + mapped[i, 1, 1] * b + mapped[i, 1, 2] * c) * inverse
                x = int(np.floor(middles[i, 0] + column + 0.5))
                y = int(np.floor(middles[i, 1] + row + 0.5))
                if 0 <= x < width and 0 <= y < height:
                    bright = share * inverse**4 * vignette[y, x]
                    for channel in range(3):
                        picture[y, x, channel] += np.float32(bright * tints[channel, led])


def _unit(vectors: Floats) -> Floats:
    """Return vectors of length 1."""
    square = np.einsum("...i,...i->...", vectors, vectors)[..., None]
    unit: Floats = vectors / np.sqrt(np.maximum(square, 1e-300))
    return unit


def _unhidden(
    markers: Ellipsoids, job: PictureJob, which: Ints, place: Floats, leds: Floats, camera: Points
) -> Bools:
    """Return (n, leds) whether no other marker stands between a (n, leds, 3) place on a marker of
    ``which`` and its LED, or its (n, 3) place of the camera."""
    count = leds.shape[1]
    row_of = np.full(len(markers), -1)
    row_of[which] = np.arange(len(which))
    free = np.ones((len(which), count), bool)
    # The LEDs' lists of the job.
    pair = np.repeat(np.arange(len(job.occluder_first) - 1), np.diff(job.occluder_first))
    row, led = row_of[pair // count], pair % count
    ours = row >= 0
    row, led, other = row[ours], led[ours], job.occluder_members[ours]
    metric: Floats = job.metric / job.unit_mm**2
    balls = (markers.centres, metric)
    hidden = _blocks(balls, other, place[row, led], leds[row, led])
    free[row[hidden], led[hidden]] = False
    # A list for the camera.
    targets = np.zeros((len(markers), 1, 3))
    targets[which, 0] = camera
    wanted = (row_of >= 0)[:, None]
    sizes = np.linalg.norm(markers.axes, axis=(1, 2))
    first, members = PictureJob.occluders(markers.centres, sizes, targets, wanted)
    row = row_of[np.repeat(np.arange(len(markers)), np.diff(first))]
    hidden = _blocks(balls, members[:, None], place[row], camera[row, None])
    member, led = np.nonzero(hidden)
    free[row[member], led] = False
    return free


def _blocks(balls: tuple[Points, Floats], others: Indices, start: Points, end: Points) -> Bools:
    """Return whether the line between two places, (..., 3) each, meets each of (...) markers.

    ``balls`` are all centres, and the metrics in which the markers are balls of radius 1.
    """
    centres, metric = balls[0][others], balls[1][others]
    begin, way = start - centres, end - start
    # Squares of (begin + part way) in the metric.
    steep = np.einsum("...ij,...i,...j->...", metric, way, way)
    slope = np.einsum("...ij,...i,...j->...", metric, begin, way)
    square = np.einsum("...ij,...i,...j->...", metric, begin, begin)
    part = np.clip(-slope / steep, 0, 1)
    return np.asarray(square + part * (2 * slope + part * steep) < 1)
