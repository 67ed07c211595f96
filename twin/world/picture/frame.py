"""One picture's job for the renderer, in its own units: marker matrices, lamps, and the pixels worth tracing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Singles
from twin.parts.scene import Scene
from twin.world.picture.lighting import lamps_at
from twin.world.picture.markers import Ellipsoids
from twin.world.picture.occluders import Occluders, occluders
from twin.world.picture.view import Near, View, near_markers

_ABSENT = (1e5, 1e5, -1.0)

NOWHERE = np.array([*_ABSENT, 1e-3, 1e-3, 1e-3, 0, 0, 0, 1], np.float32)
"""An ellipsoid that no ray meets."""

INSIDE = 0.01
"""How far inside its marker a shadow ray starts, share of the radius: ellipsoids are met from outside only."""

STEP = 1e-3
"""How far behind a hit a ray goes on, renderer units."""

DEPTH = 6
"""Markers that a ray is followed through."""

OPAQUE = 1e-3
"""Share of a ray that needs no following any more."""

INTO = 4 / 9
"""How far into the covered strip of a sub-pixel its brightness is taken.

Its own ray may miss, and brightness falls towards the outline like a root, which has its mean there. With the outline's
own brightness, that of the rim, centroids were two to three times farther off for the same rays.
"""

WEIGHT = 4096
"""Whole-number weight of a fully covered sub-pixel."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """What is traced: markers in units of ``unit_mm``, z = 0 behind all of them.

    Attributes
    ----------
    near
        Pixels near markers.
    base
        Height of the base.
    unit_mm
        Length of the unit.
    centres
        (n, 3) centres; lost markers lie far aside.
    axes
        (n, 3, 3) conjugate semi-axes in columns.
    metric
        (n, 3, 3) the matrix M of each ellipsoid (x - c)^T M (x - c) = 1.
    pad
        (n,) how much larger than the marker a search for its edge has to be.
    subpixels
        k of the k x k rays in a pixel.
    lamps
        (n, leds, 4) place and power of the LEDs' images per marker.
    occluders
        What may shadow what.
    colour
        (n, 3) reflectance.
    """

    near: Near
    base: float
    unit_mm: float
    centres: Floats
    axes: Floats
    metric: Floats
    pad: Floats
    subpixels: int
    lamps: Floats
    occluders: Occluders
    colour: Floats

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def shadowed(self) -> Bools:
        """(n, leds) whether a shadow ray is needed."""
        return self.occluders.flags

    @cached_property
    def starts(self) -> Singles:
        """(m, 2) where every pixel's rays start: distance from the base, and z."""
        near = self.near
        zero = _behind(near)
        highest = np.maximum.reduceat(near.top_mm[near.members], near.first[:-1]) if len(near.pixels) else np.zeros(0)
        start = (highest - zero) / self.unit_mm
        return np.column_stack([self.base - start, start]).astype(np.float32)

    @cached_property
    def exact(self) -> Singles:
        """(n, 10) centre, semi-axes and quaternion (x, y, z, w), as Mitsuba wants ellipsoids."""
        turned, sizes, _ = np.linalg.svd(self.axes)
        return np.column_stack([self.centres, sizes, quaternions(turned)]).astype(np.float32)

    @cached_property
    def padded(self) -> Singles:
        """Like ``exact``, but larger by what the search for edges needs."""
        data = self.exact.copy()
        data[:, 3:6] += self.pad[:, None]
        return data


def make_frame(
    markers: Ellipsoids,
    scene: Scene,
    view: View,
    *,
    unit_mm: float,
    full_power: float,
    subpixels: int,
    shadows: bool = True,
) -> Frame:
    """Prepare a picture of the markers.

    Parameters
    ----------
    markers
        The markers as they are now.
    scene, view
        The actual scene, and its camera's rays.
    unit_mm
        Length of the renderer's unit.
    full_power
        The irradiance that counts as 1.
    subpixels
        k of the k x k rays in a pixel.
    shadows
        Whether markers shadow each other.
    """
    base = scene.body.base_z_mm
    here = markers.present
    centres = np.where(here[:, None], markers.centres, [0.0, 0.0, base])
    axes = np.where(here[:, None, None], markers.axes, 1e-3 * np.eye(3))
    near = near_markers(markers, scene, view, subpixels)
    zero = _behind(near)
    lamps = lamps_at(centres, scene)
    radii = np.where(here, _longest(axes), np.nan)
    wanted = here[:, None] & (lamps.power > 0) & shadows
    shift = np.array([0.0, 0.0, zero])
    axes = axes / unit_mm
    inverse = np.linalg.inv(axes)
    return Frame(
        near=near,
        base=(base - zero) / unit_mm,
        unit_mm=unit_mm,
        centres=np.where(here[:, None], (centres - shift) / unit_mm, _ABSENT),
        axes=axes,
        metric=np.swapaxes(inverse, 1, 2) @ inverse,
        pad=near.pad_mm / unit_mm,
        subpixels=subpixels,
        lamps=np.concatenate(
            [(lamps.place - shift) / unit_mm, (lamps.power / (full_power * unit_mm**2))[:, :, None]], axis=2
        ),
        occluders=occluders(np.where(here[:, None], centres, np.nan), radii, lamps.place, wanted),
        colour=markers.colour,
    )


def _behind(near: Near) -> float:
    """Return a height z behind all markers, mm."""
    return float(np.max(near.top_mm, initial=0.0))


def _longest(axes: Floats) -> Floats:
    """Return a bound on (n,) ellipsoids' longest semi-axes: the root of the largest row sum of A^T A (Gershgorin)."""
    bound: Floats = np.sqrt(np.abs(np.swapaxes(axes, 1, 2) @ axes).sum(axis=2).max(axis=1))
    return bound


def quaternions(axes: Floats) -> Floats:
    """Return (n, 4) unit quaternions (x, y, z, w) of (n, 3, 3) orthogonal matrices; mirrored ones are mirrored back.

    Notes
    -----
    The symmetric matrix K of Bar-Itzhack (J. Guidance 23, 2000) has the quaternion as its leading eigenvector; one of
    its columns, the one of the largest diagonal entry, is parallel to it for an exact rotation.
    """
    r = axes * np.sign(np.linalg.det(axes))[:, None, None]
    k = np.empty((len(r), 4, 4))
    trace = np.trace(r, axis1=1, axis2=2)
    k[:, :3, :3] = r + np.swapaxes(r, 1, 2) + (1 - trace)[:, None, None] * np.eye(3)
    k[:, :3, 3] = k[:, 3, :3] = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], 1)
    k[:, 3, 3] = 1 + trace
    best = np.argmax(np.diagonal(k, axis1=1, axis2=2), axis=1)
    column = k[np.arange(len(r)), :, best]
    quaternion: Floats = column / np.linalg.norm(column, axis=1, keepdims=True)
    return quaternion
