"""One picture's job for the renderer, in its own units: marker matrices, lamps, and the pixels worth tracing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Singles
from twin.compiled import njit
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
    longest, placed, axes, metric = _placed(centres, axes, here, zero, unit_mm)
    wanted = here[:, None] & (lamps.power > 0) & shadows
    return Frame(
        near=near,
        base=(base - zero) / unit_mm,
        unit_mm=unit_mm,
        centres=placed,
        axes=axes,
        metric=metric,
        pad=near.pad_mm / unit_mm,
        subpixels=subpixels,
        lamps=np.concatenate(
            [(lamps.place - [0.0, 0.0, zero]) / unit_mm, (lamps.power / (full_power * unit_mm**2))[:, :, None]], axis=2
        ),
        occluders=occluders(np.where(here[:, None], centres, np.nan), longest, lamps.place, wanted),
        colour=markers.colour,
    )


def _behind(near: Near) -> float:
    """Return a height z behind all markers, mm."""
    return float(np.max(near.top_mm, initial=0.0))


@njit(cache=True, nogil=True)
def _placed(
    centres: Floats, axes: Floats, here: Bools, behind: float, unit: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return bounds on ellipsoids' longest semi-axes, mm; and in renderer units centres, axes and matrices M.

    Notes
    -----
    The bound is the root of the largest row sum of A^T A (Gershgorin); M = (A A^T)^-1 from the cofactors of A.
    """
    n = len(centres)
    longest, placed, scaled, metric = np.empty(n), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3))
    cofactor = np.empty((3, 3))
    for i in range(n):
        a = axes[i]
        largest = 0.0
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += abs(a[0, j] * a[0, k] + a[1, j] * a[1, k] + a[2, j] * a[2, k])
                scaled[i, j, k] = a[j, k] / unit
            largest = max(largest, total)
        longest[i] = np.sqrt(largest)
        for j in range(3):
            m, o = (j + 1) % 3, (j + 2) % 3
            for k in range(3):
                p, q = (k + 1) % 3, (k + 2) % 3
                cofactor[j, k] = scaled[i, m, p] * scaled[i, o, q] - scaled[i, m, q] * scaled[i, o, p]
        determinant = 0.0
        for k in range(3):
            determinant += scaled[i, 0, k] * cofactor[0, k]
        for j in range(3):
            for k in range(3):
                total = 0.0
                for m in range(3):
                    total += cofactor[j, m] * cofactor[k, m]
                metric[i, j, k] = total / determinant**2
        if here[i]:
            placed[i] = centres[i, 0] / unit, centres[i, 1] / unit, (centres[i, 2] - behind) / unit
        else:
            placed[i] = _ABSENT
    return longest, placed, scaled, metric


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
