"""The job of one picture: markers, virtual lamps, and which of them meet in which pixel.

A job has everything that depends on where the markers are, in the renderer's units, whichever
renderer of `twin.world.picture.render` draws it. Two searches spare the renderer its own. Each
pixel has a list of the markers whose outlines come near, from the projection's Jacobian at each
centre. Each marker and lamp have a list of the markers that may stand between them: one marker in
three has another before an LED, and then mostly one or two.

Units: the median marker radius is 1, and z = 0 lies just behind all markers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Ints, Pixels, Singles
from twin.compiled import njit
from twin.parts.scene import Scene
from twin.theory.optics import project_with_jacobian
from twin.world.picture.camera_rays import View
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.lamps import Lamps

Indices = NDArray[np.int32]

WEIGHT = 4096
"""Whole-number weight of a fully covered sub-pixel."""

OPAQUE = 1e-3
"""Share of a ray that needs no following any more."""

INTO = 4 / 9
"""Depth into the covered strip of a sub-pixel at which its brightness is taken.

Its own ray may miss, and brightness falls towards the outline like a root, which has its mean
there. With the brightness of the outline itself, centroids were two to three times farther off for
the same rays."""

_ABSENT = (1e5, 1e5, -1.0)
"""Centre of a lost marker, far aside."""

_MARGIN = 1.05
"""How much larger an outline may be than its first-order ellipse, and a shadow than its sphere."""

_ROOM_PX = 1.2
"""Half a pixel's diagonal, and as much again for what a first-order outline leaves out."""

_EDGE_SEARCH = 1.2
"""Sub-pixels: a ray reaches half a diagonal, 0.71, and an ellipsoid grows by less than its axes
between them."""


@dataclass(frozen=True, kw_only=True)
class PictureJob:
    """One picture of n markers: lengths in units of ``unit_mm``, z = 0 behind all markers.

    Attributes
    ----------
    pixels
        (m,) flat numbers, row * width + column, of the pixels near outlines: first those near one
        outline only, marker by marker and ascending, then those near several, ascending.
    isolated
        (n + 1,) where each marker's own pixels begin in ``pixels``; those near several begin at the
        last.
    first, members
        (m + 1,) where each pixel's markers begin in ``members``, which has their numbers ascending.
    centres_px
        (n, 2) projected centres; 0 where the camera doesn't see the place.
    conjugate
        (n, 2, 2) matrix C of each outline to first order, x^T C^-1 x = 1 about the projected
        centre, px^2; the unit matrix where the camera doesn't see the place.
    jacobian
        (n, 2, 3) the projection's Jacobian there, px/mm; of two unit rows where the camera doesn't
        see the place.
    cut
        (n,) whether the outline may cross the picture's edge.
    subpixels
        k of the k x k rays in a pixel.
    unit_mm, behind_mm
        Length of the unit, and the height of z = 0.
    base
        Height of the base.
    centres, axes, metric
        (n, 3) centres, (n, 3, 3) conjugate semi-axes in columns, and (n, 3, 3) the matrices M of
        the ellipsoids (x - c)^T M (x - c) = 1. Lost markers lie far aside.
    pad, top
        (n,) how much larger than a marker a search for its edge has to be, and a height just behind
        each marker, -inf where it isn't seen.
    lamps
        (n, leds, 7) place and power of the LEDs' images per marker, and the power's change along x,
        y and z.
    tints, even
        (k, leds) shares of these powers by channel, and the (k,) colour of the even light: of
        `Light.tints`, k = 1 for white light.
    occluder_first, occluder_members
        `occluders` of each marker and lamp.
    colour
        (n, 3) reflectance.
    """

    pixels: Ints
    isolated: Ints
    first: Indices
    members: Indices
    centres_px: Pixels
    conjugate: Floats
    jacobian: Floats
    cut: Bools
    subpixels: int
    unit_mm: float
    behind_mm: float
    base: float
    centres: Floats
    axes: Floats
    metric: Floats
    pad: Floats
    top: Floats
    lamps: Floats
    tints: Floats
    even: Floats
    occluder_first: Indices
    occluder_members: Indices
    colour: Floats

    def __len__(self) -> int:
        return len(self.centres)

    @staticmethod
    def of(
        markers: Ellipsoids,
        scene: Scene,
        view: View,
        *,
        unit_mm: float,
        full_power: float,
        subpixels: int,
        shadows: bool = True,
    ) -> PictureJob:
        """Prepare a picture.

        Parameters
        ----------
        markers, scene, view
            The markers as they are now, the actual scene, and its camera's rays.
        unit_mm
            Length of the renderer's unit.
        full_power
            The irradiance that counts as 1.
        subpixels
            k of the k x k rays in a pixel.
        shadows
            Whether markers shadow each other.
        """
        # Lost markers keep their row: they get a tiny ellipsoid that nothing sees.
        base = scene.body.base_z_mm
        here = markers.present
        centres = np.where(here[:, None], markers.centres, [0.0, 0.0, base])
        axes = np.where(here[:, None, None], markers.axes, 1e-3 * np.eye(3))

        # Outlines to first order: J maps the ellipsoid's semi-axes to the picture.
        centres_px, jacobian = project_with_jacobian(markers.centres, *scene.optics)
        seen = here & np.isfinite(centres_px).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
        centres_px = np.where(seen[:, None], centres_px, 0.0)
        jacobian = np.where(seen[:, None, None], jacobian, np.eye(2, 3))
        mapped = jacobian @ axes
        conjugate = np.where(seen[:, None, None], mapped @ np.swapaxes(mapped, 1, 2), np.eye(2))
        half = _MARGIN * np.sqrt(np.diagonal(conjugate, axis1=1, axis2=2)) + _ROOM_PX
        size = np.array([view.sees.shape[1], view.sees.shape[0]])
        cut = seen & ((centres_px < half) | (centres_px + half > size - 1)).any(axis=1)
        pixels, isolated, first, members = _near_pixels(
            centres_px, conjugate, half, seen, view.sees
        )

        # Mitsuba's rays start just behind the markers, and its search for edges needs larger ones.
        stretch = np.sqrt(_least_eigenvalues(jacobian @ np.swapaxes(jacobian, 1, 2)))
        pad_mm = np.where(seen, _EDGE_SEARCH / subpixels / stretch, 0.0)
        thick = np.sqrt(np.sum(axes[:, 2] ** 2, axis=1))
        top_mm = np.where(seen, np.minimum(centres[:, 2] + 1.02 * (thick + pad_mm), base), -np.inf)
        behind_mm = float(np.max(top_mm, initial=0.0))

        # Lamps and shadows: which markers may lie between a marker and each lamp.
        lamps = Lamps.at(centres, scene, changing=True)
        assert lamps.change is not None
        place = (lamps.place - [0.0, 0.0, behind_mm]) / unit_mm
        full = full_power * unit_mm**2
        power = lamps.power[:, :, None] / full
        tints, even = scene.imaging[1].tints()
        # Gershgorin's bound on the largest eigenvalue of A^T A: the longest semi-axis, squared.
        gram = np.swapaxes(axes, 1, 2) @ axes
        longest = np.sqrt(np.abs(gram).sum(axis=2).max(axis=1, initial=0.0))
        wanted = here[:, None] & (lamps.power > 0) & shadows
        occluder_first, occluder_members = PictureJob.occluders(
            np.where(here[:, None], centres, np.nan), longest, lamps.place, wanted
        )
        # Lengths are in units of ``unit_mm``, so that single precision is enough.
        scaled = axes / unit_mm
        return PictureJob(
            pixels=pixels,
            isolated=isolated,
            first=first,
            members=members,
            centres_px=centres_px,
            conjugate=conjugate,
            jacobian=jacobian,
            cut=cut,
            subpixels=subpixels,
            unit_mm=unit_mm,
            behind_mm=behind_mm,
            base=(base - behind_mm) / unit_mm,
            centres=np.where(here[:, None], (centres - [0.0, 0.0, behind_mm]) / unit_mm, _ABSENT),
            axes=scaled,
            metric=_metric(scaled),
            pad=pad_mm / unit_mm,
            top=(top_mm - behind_mm) / unit_mm,
            lamps=np.concatenate([place, power, lamps.change * (unit_mm / full)], axis=2),
            tints=tints,
            even=even,
            occluder_first=occluder_first,
            occluder_members=occluder_members,
            colour=markers.colour,
        )

    @staticmethod
    def occluders(
        centres: Floats, radii: Floats, places: Floats, wanted: Bools
    ) -> tuple[Indices, Indices]:
        """Return, for each marker and lamp, the markers that may shadow it; too many when in doubt,
        never too few.

        ``centres`` (n, 3) and ``radii`` (n,) are spheres around the markers, none where not finite;
        ``places`` (n, lamps, 3) lamps as each marker sees them; ``wanted`` (n, lamps) the pairs
        that matter. The list of marker i and lamp l, number i * lamps + l, begins at that entry of
        the first result (n * lamps + 1,) in the second.

        Two markers are in each other's way only if the second's centre is within both radii of the
        way to the lamp, and not farther than the lamp. The way is cut where it leaves the heights
        of all markers. A grid of about one marker a cell spares a search through all.
        """
        n, lamps = wanted.shape
        first = np.zeros(n * lamps + 1, np.int32)
        here = np.flatnonzero(np.isfinite(centres).all(axis=1) & np.isfinite(radii))
        if len(here) == 0 or lamps == 0:
            return first, np.zeros(0, np.int32)
        # Sort the markers into the cells of a square grid.
        side = int(np.ceil(np.sqrt(len(here))))
        low = centres[here, :2].min(axis=0)
        per_mm = side / np.maximum(centres[here, :2].max(axis=0) - low, 1e-9)
        column, row = np.minimum(((centres[here, :2] - low) * per_mm).astype(int), side - 1).T
        cell = row * side + column
        order = np.argsort(cell, kind="stable")
        begin = np.searchsorted(cell[order], np.arange(side * side + 1))
        grid = (low[0], low[1], per_mm[0], per_mm[1])
        # The number of members is not known before: count once, and again with enough room.
        spheres = np.column_stack([centres, radii])
        members = np.empty(max(4 * n, 16), np.int32)
        while True:
            used = _occluder_lists(
                spheres, here[order], begin, side, grid, places, wanted, first, members
            )
            if used <= len(members):
                return first, members[:used].copy()
            members = np.empty(used, np.int32)

    def texture(self, markers: Ellipsoids, width: int) -> Singles:
        """Return (m,) factors of the markers' textures on the light of the pixels, of a picture of
        ``width`` px; of the marker whose middle is nearest, in its own size, where several meet."""
        pixel = np.repeat(np.arange(len(self.pixels)), np.diff(self.first))
        marker = self.members
        row, column = np.divmod(self.pixels[pixel], width)
        aside = np.column_stack([column, row]) - self.centres_px[marker]
        mapped = self.jacobian @ markers.axes
        # The place on the unit ball: the least that is seen there, and up to the camera.
        inverse = np.swapaxes(mapped, 1, 2) @ np.linalg.inv(self.conjugate)
        unit = np.einsum("mij,mj->mi", inverse[marker], aside)
        away = np.sqrt(np.sum(unit**2, axis=1))
        own = self.isolated[-1]
        order = own + np.lexsort([away[own:], pixel[own:]])
        chosen = np.concatenate([np.arange(own), order[self.first[own:-1] - own]])
        unit, away, marker = unit[chosen], away[chosen], marker[chosen]
        up = np.cross(mapped[:, 0], mapped[:, 1])
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        up *= np.where(np.einsum("ni,ni->n", markers.axes[:, 2], up) < 0, -1.0, 1.0)[:, None]
        unit = unit / np.maximum(away, 1.0)[:, None]
        unit += np.sqrt(np.maximum(1 - away**2, 0.0))[:, None] * up[marker]
        return markers.shade(marker, unit)


class Shader(Protocol):
    """A renderer of jobs, made for one `View`."""

    def shade(self, job: PictureJob) -> tuple[Singles, Singles]:
        """Return (m, 3) light from markers in the job's pixels, 1 for white in the brightest
        marker's place, and (m,) the share of each pixel that they leave free."""


@njit(cache=True)
def _occluder_lists(
    spheres: Floats,
    order: Ints,
    begin: Ints,
    side: int,
    grid: tuple[float, float, float, float],
    places: Floats,
    wanted: Bools,
    first: Indices,
    members: Indices,
) -> int:
    """Write the lists of `occluders`, as far as ``members`` has room; return the room needed.
    ``order`` has the markers cell by cell, ``begin`` where each cell begins in it; ``grid`` the
    cells' corner and their number in a mm, for x and y."""
    # The layer of space in which there are markers at all.
    lowest = highest = spheres[order[0], 2]
    largest = 0.0
    for i in order:
        lowest = min(lowest, spheres[i, 2])
        highest = max(highest, spheres[i, 2])
        largest = max(largest, spheres[i, 3])
    bottom = lowest - 2 * _MARGIN * largest
    top = highest + 2 * _MARGIN * largest
    last = side - 1.0
    used = 0
    lamps = wanted.shape[1]
    for pair in range(len(first) - 1):
        i = pair // lamps
        lamp = pair % lamps
        if wanted[i, lamp]:
            x = spheres[i, 0]
            y = spheres[i, 1]
            z = spheres[i, 2]
            radius = spheres[i, 3]
            dx, dy, dz = places[i, lamp, 0] - x, places[i, lamp, 1] - y, places[i, lamp, 2] - z
            # Follow the way to the lamp only as far as there are markers.
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            end = 1.0
            if dz > 0:
                end = min(end, (top - z) / dz)
            elif dz < 0:
                end = min(end, (bottom - z) / dz)
            # The cells of the grid under the way, widened by the two radii.
            room = _MARGIN * (radius + largest)
            left = (x + min(dx * end, 0.0) - room - grid[0]) * grid[2]
            right = (x + max(dx * end, 0.0) + room - grid[0]) * grid[2]
            low = (y + min(dy * end, 0.0) - room - grid[1]) * grid[3]
            high = (y + max(dy * end, 0.0) + room - grid[1]) * grid[3]
            left_cell = int(max(min(left, last), 0.0))
            right_cell = int(max(min(right, last), 0.0))
            dx, dy, dz = dx / length, dy / length, dz / length
            # Keep the markers whose sphere comes nearer to the way than the two radii.
            for row in range(int(max(min(low, last), 0.0)), int(max(min(high, last), 0.0)) + 1):
                for at in range(begin[row * side + left_cell], begin[row * side + right_cell + 1]):
                    other = order[at]
                    wx, wy, wz = spheres[other, 0] - x, spheres[other, 1] - y, spheres[other, 2] - z
                    along = wx * dx + wy * dy + wz * dz
                    reach = _MARGIN * (radius + spheres[other, 3])
                    aside = wx * wx + wy * wy + wz * wz - along * along
                    near = along > -reach and along < length + reach and aside < reach * reach
                    if near and other != i:
                        if used < len(members):
                            members[used] = other
                        used += 1
        first[pair + 1] = used
    return used


def _near_pixels(
    centres: Pixels, conjugate: Floats, half: Floats, there: Bools, wanted: Bools
) -> tuple[Ints, Ints, Indices, Indices]:
    """Return ``pixels``, ``isolated``, ``first`` and ``members`` of `PictureJob`.

    ``half`` (n, 2) are half sizes of boxes about the ellipses, ``there`` (n,) the markers that
    count, ``wanted`` (height, width) the pixels that do.
    """
    n = len(centres)
    height, width = wanted.shape
    a, b, c = conjugate[:, 0, 0], conjugate[:, 0, 1], conjugate[:, 1, 1]
    # Rows of each ellipse's box, one after the other: a row of picture and marker each.
    low = np.clip(np.ceil(centres - half), 0, [width, height]).astype(int)
    high = np.clip(np.floor(centres + half) + 1, 0, [width, height]).astype(int)
    marker, row = _ranges(low[:, 1], np.where(there, high[:, 1], low[:, 1]))
    # A point within the room of a stretched ellipse is within this in the ellipse's own metric:
    # x^T C^-1 x = reach^2 in a row is x = shear y +- narrow sqrt(c reach^2 - y^2).
    reach = _MARGIN + _ROOM_PX / np.sqrt(_least_eigenvalues(conjugate))
    shear = b / c
    narrow = np.sqrt(a * c - b * b) / c
    y = row - centres[marker, 1]
    square = (c * reach * reach)[marker] - y * y
    chord = np.where(square >= 0, narrow[marker] * np.sqrt(np.maximum(square, 0.0)), -1.0)
    middle = centres[marker, 0] + shear[marker] * y
    first_column = np.maximum(np.ceil(middle - chord), low[marker, 0]).astype(int)
    end_column = np.minimum(np.floor(middle + chord) + 1, high[marker, 0]).astype(int)
    run, column = _ranges(first_column, end_column)
    pixel = row[run] * width + column
    marker = marker[run]
    good = wanted.ravel()[pixel]
    pixel, marker = pixel[good], marker[good]
    # Pixels of one marker first, then the others in the order of pixels.
    alone = (np.bincount(pixel, minlength=height * width) == 1)[pixel]
    isolated = np.concatenate([[0], np.cumsum(np.bincount(marker[alone], minlength=n))])
    shared = np.flatnonzero(~alone)
    shared = shared[np.argsort(pixel[shared], kind="stable")]
    starts = np.flatnonzero(np.diff(pixel[shared], prepend=-1))
    own = np.arange(isolated[-1])
    return (
        np.concatenate([pixel[alone], pixel[shared][starts]]),
        isolated,
        np.concatenate([own, isolated[-1] + starts, [len(pixel)]]).astype(np.int32),
        np.concatenate([marker[alone], marker[shared]]).astype(np.int32),
    )


def _ranges(begin: Ints, end: Ints) -> tuple[Ints, Ints]:
    """Return all numbers of n ranges, one range after the other, and which range each is of."""
    count = np.maximum(end - begin, 0)
    which = np.repeat(np.arange(len(begin)), count)
    offset = begin - (np.cumsum(count) - count)
    return which, np.arange(len(which)) + offset[which]


def _least_eigenvalues(matrices: Floats) -> Floats:
    """Return (n,) smaller eigenvalues of (n, 2, 2) symmetric matrices."""
    a, b, c = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    least: Floats = (a * c - b * b) / ((a + c) / 2 + np.sqrt(((a - c) / 2) ** 2 + b * b))
    return least


def _metric(axes: Floats) -> Floats:
    """Return (n, 3, 3) matrices M = (A A^T)^-1 of axes A, from A's cofactors."""
    one, two, three = np.moveaxis(axes, 2, 0)
    cofactors = np.stack([np.cross(two, three), np.cross(three, one), np.cross(one, two)], axis=1)
    determinant = np.einsum("ni,ni->n", one, cofactors[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = cofactors / determinant[:, None, None]
    metric: Floats = np.swapaxes(inverse, 1, 2) @ inverse
    return metric
