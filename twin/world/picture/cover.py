"""What lies behind the markers and in the rubber: the cover, probes seen through it, specks.

A press tilts the black cover and moves it towards the camera, so that it takes other light. Both
are smooth, so they are computed on a coarse grid of rays and multiply the picture of the cover at
rest. Where LEDs stand all around the lens, a bulge changes even a grey cover by a count or less.
Markers' shadows on the cover are ellipses for each LED, drawn as markers are.

Through rubber without a cover, or with one that passes light, the camera sees probes and the
surroundings. A ray goes straight on into a probe that stands below the surface at rest; elsewhere
it leaves the rubber there, as Snell's law bends it, through a gap of air.

Validity: the change is first order in the displacement; detail finer than the grid, at the rim of a
contact, is smoothed; shadows are first order in a marker's size over its distance from the LED;
the cover takes none unless `Cover.shadows`, as it is nearly black, and probes take none.
Light reaches probes as if the rubber went on to them, outlines are sharp to a pixel, and what
stands in the rubber counts as touching it. Behind the gap a probe is brighter than in touch, by the
index squared, as all of its light that enters the rubber comes within the critical angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from twin.arrays import Bools, Floats, Ints, Pixels, Points, Singles
from twin.parts.body import Body
from twin.parts.camera import Camera
from twin.parts.load import Load
from twin.parts.scene import Scene
from twin.theory.optics import project, rays, reflection
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.lamps import Lamps

_STEP_PX = 16
"""Distance between the rays of the grid."""

_BEYOND = 0.05
"""Share of the picture's size that the grid goes on beyond each border, where a wide pupil's blur
mixes what lies there into the picture."""

_WITHIN_MM = 1e-6
"""How far beyond the body's sides its motion is known."""

_HALVINGS = 6
"""Of the way to the body's edge between two of them: to a third of a pixel."""

_THIN = 0.05
"""Thickness of a shadow over its width."""

_CELLS = 400
"""Cells along and across what the camera sees of a probe, as triangles."""


@dataclass(frozen=True, kw_only=True)
class CoverMotion:
    """How the places of a `Background` that move have moved, and what stands behind them.

    Attributes
    ----------
    displacement_mm
        (m, 3) displacements, mm.
    gradient
        (m, 3, 3) displacement gradients du_i/dx_j.
    probes
        The probes that pictures show.
    """

    displacement_mm: Points
    gradient: Floats
    probes: tuple[Load.Placed, ...] = ()

    def between(self, other: CoverMotion, share: float) -> CoverMotion:
        """Return the motion at a share of the way to another."""
        both = zip(self.probes, other.probes, strict=False)
        return CoverMotion(
            displacement_mm=(1 - share) * self.displacement_mm + share * other.displacement_mm,
            gradient=(1 - share) * self.gradient + share * other.gradient,
            probes=tuple(a.between(b, share) for a, b in both) or other.probes,
        )

    def turned(self, normals: Floats) -> Floats:
        """Return (k, 3) unit normals of the deformed surface, F^-T n with F = I + du/dx, at the
        first k places."""
        deformed = np.swapaxes(np.eye(3) + self.gradient[: len(normals)], 1, 2)
        moved = np.asarray(np.linalg.solve(deformed, normals[:, :, None])[:, :, 0], np.float64)
        unit: Floats = moved / np.linalg.norm(moved, axis=1, keepdims=True)
        return unit


class Background:
    """The places of the cover that a coarse grid of rays meets.

    Parameters
    ----------
    scene
        With camera, light and cover.
    top
        The irradiance that counts as 1.
    """

    def __init__(self, scene: Scene, top: float) -> None:
        camera, _ = scene.imaging
        self._scene, self._top = scene, top
        self._size = (camera.height_px, camera.width_px)
        more = _BEYOND if camera.aperture_mm else 0.0
        self._columns, self._rows = (
            np.linspace(
                -more * size - 0.5,
                (1 + more) * size - 0.5,
                max(int((1 + 2 * more) * size) // _STEP_PX, 1) + 1,
            )
            for size in (camera.width_px, camera.height_px)
        )
        nodes = np.stack(np.meshgrid(self._columns, self._rows), axis=-1).reshape(-1, 2)
        origins, directions = rays(nodes, *scene.optics)
        points, normals = np.full((2, len(nodes), 3), np.nan)
        if scene.cover is not None:
            depth = scene.cover.thickness_mm
            points, normals = _places_at(origins, directions, scene.body, depth, _WITHIN_MM)
            self._draw_to_edge(nodes, points, normals, depth)
        self.deforms = scene.cover is not None and scene.cover.moves
        """Whether pictures show how a press moves the cover."""
        self._met = np.isfinite(points[:, 0])
        self._along = directions[self._met]
        self.normals: Floats = normals[self._met]
        """(m, 3) inward normals there."""
        self.points: Points = points[self._met]
        """(m, 3) places on the cover's inner side at rest, mm."""

    def _draw_to_edge(
        self, nodes: Pixels, points: Points, normals: Floats, depth_mm: float
    ) -> None:
        """Give nodes that just miss the cover the last place met towards their nearest neighbour
        that doesn't: triangles then end at the body's edge."""
        met = np.isfinite(points[:, 0]).reshape(len(self._rows), len(self._columns))
        if met.all() or not met.any():
            return
        steps, nearest = distance_transform_edt(~met, return_indices=True)
        late = np.flatnonzero((steps > 0) & (steps < 2))
        known = np.ravel_multi_index(tuple(nearest), met.shape).ravel()[late]
        inside, outside = nodes[known], nodes[late]
        points[late], normals[late] = points[known], normals[known]
        for _ in range(_HALVINGS):
            middle = (inside + outside) / 2
            found, turned = _places_at(
                *rays(middle, *self._scene.optics), self._scene.body, depth_mm, _WITHIN_MM
            )
            there = np.isfinite(found[:, 0])
            points[late[there]], normals[late[there]] = found[there], turned[there]
            inside[there], outside[~there] = middle[there], middle[~there]

    @staticmethod
    def moves(scene: Scene) -> bool:
        """Return whether pictures show the motion of a cover, or of specks in the rubber."""
        deforms = scene.cover is not None and scene.cover.moves
        return deforms or bool(scene.imaging[0].in_rubber)

    @cached_property
    def _specks(self) -> list[tuple[Camera.Marks, Points]]:
        """Marks in the rubber, and their places at rest."""
        camera, _ = self._scene.imaging
        body = self._scene.body
        found = []
        for marks in camera.in_rubber:
            assert marks.depth_mm is not None
            places = body.surface_from_above(marks.lines(*body.bounds_mm).mean(axis=1))
            places = places[np.isfinite(places).all(axis=1)]
            places = places + marks.depth_mm * body.piece_normals(places)[:, 0]
            found.append((marks, places[body.contains(places, marks.size_mm / 2)]))
        return found

    @cached_property
    def moving(self) -> Points:
        """(m, 3) places whose motion pictures show, mm: of a cover that deforms, and of specks."""
        cover = self.points if self.deforms else self.points[:0]
        return np.concatenate([cover, *(places for _, places in self._specks)])

    def specks(self, motion: CoverMotion | None) -> list[tuple[Camera.Marks, Ellipsoids]]:
        """Return marks in the rubber and their shapes after a motion; None: at rest."""
        found = []
        last = len(self.points) if self.deforms else 0
        for marks, places in self._specks:
            first, last = last, last + len(places)
            axes = np.tile(marks.size_mm / 2 * np.eye(3), (len(places), 1, 1))
            if motion is not None:
                places = places + motion.displacement_mm[first:last]
                axes = axes + motion.gradient[first:last] @ axes
            colour = np.full((len(places), 3), marks.albedo)
            found.append((marks, Ellipsoids(centres=places, axes=axes, colour=colour)))
        return found

    @property
    def triangles(self) -> Ints:
        """(k, 3) numbers of the places that make up triangles between the grid's rays."""
        return _between(self._met.reshape(len(self._rows), len(self._columns)))

    def shadows(self, markers: Ellipsoids, motion: CoverMotion | None) -> list[Ellipsoids]:
        """Return the shadows of markers on the cover for each LED, as thin ellipsoids that lie on
        it; none unless the cover shows them.

        Notes
        -----
        From the LED's image P, a marker of centre c and semi-axes a has its shadow about the place
        q where the ray from P through c meets the cover, of normal n: its semi-axes are those of
        |q - P| / |c - P| (a - d (n . a) / (n . d)), d the ray's direction.
        """
        scene = self._scene
        if scene.cover is None or not scene.cover.shadows or scene.imaging[1].ambient == 1:
            return []
        present = markers.rows(markers.present)
        lamps = Lamps.at(present.centres, scene)
        found = []
        for source, power in zip(np.moveaxis(lamps.place, 1, 0), lamps.power.T, strict=True):
            along = present.centres - source
            near = np.linalg.norm(along, axis=1)
            along /= near[:, None]
            places, normals = _places_at(
                present.centres, along, scene.body, scene.cover.thickness_mm
            )
            lit = (power > 0) & np.isfinite(places[:, 0])
            places, normals, along = places[lit], normals[lit], along[lit]
            if motion is not None and lit.any():
                ahead, turned = self._moved_at(places, motion)
                places = places + along * (ahead / np.sum(along * normals, axis=1))[:, None]
                normals = turned
            grown = np.linalg.norm(places - source[lit], axis=1) / near[lit]
            axes = present.axes[lit]
            across = (
                np.einsum("ni,nij->nj", normals, axes) / np.sum(along * normals, axis=1)[:, None]
            )
            axes = grown[:, None, None] * (axes - along[:, :, None] * across[:, None])
            turns, sizes, _ = np.linalg.svd(axes)
            sizes[:, 2] = _THIN * sizes[:, 1]
            shapes = present.rows(lit)
            found.append(replace(shapes, centres=places, axes=turns * sizes[:, None]))
        return found

    def _moved_at(self, places: Points, motion: CoverMotion) -> tuple[Floats, Floats]:
        """Return how far the cover has moved inwards at (n, 3) places of it, mm, and its (n, 3)
        unit normals then, between the grid's rays."""
        known = np.column_stack([self._ahead(motion), motion.turned(self.normals)])
        grid = known[self._nearest].reshape(len(self._rows), len(self._columns), 4)
        column, row = project(places, *self._scene.optics).T
        at = [
            np.interp(value, nodes, np.arange(len(nodes)))
            for value, nodes in ((row, self._rows), (column, self._columns))
        ]
        found = np.stack(
            [map_coordinates(grid[:, :, k], at, order=1, mode="nearest") for k in range(4)]
        )
        return found[0], (found[1:] / np.linalg.norm(found[1:], axis=0)).T

    def _ahead(self, motion: CoverMotion) -> Floats:
        """Return (m,) how far `points` have moved inwards, mm."""
        displacement_mm = motion.displacement_mm[: len(self.points)]
        return np.asarray(np.einsum("ni,ni->n", displacement_mm, self.normals))

    @cached_property
    def _nearest(self) -> Ints:
        """(r * c,) number of the place met that is nearest to each of the grid's rays."""
        met = self._met.reshape(len(self._rows), len(self._columns))
        _, nearest = distance_transform_edt(~met, return_indices=True)
        return np.asarray(_numbered(met)[tuple(nearest)].ravel())

    @cached_property
    def _lit_at_rest(self) -> tuple[Floats, Floats]:
        return _lit_by(self.points, self.normals, self._scene, self._top)

    def change(self, motion: CoverMotion | None, hidden: Sequence[Singles] = ()) -> Singles:
        """Return (height, width, k) factors on the light of the cover at rest, k of `Light.tints`.

        Parameters
        ----------
        motion
            How it has moved; None: it is at rest.
        hidden
            The (height, width) share of each pixel that lies in `shadows`, for each LED.

        Notes
        -----
        A ray meets the moved surface where it has come (u . n) / (d . n) farther along its
        direction d.
        """
        each, even = self._lit_at_rest
        before = np.maximum(each.sum(axis=0) + even, 1e-12)
        if motion is not None:
            ahead = self._ahead(motion) / np.einsum("ni,ni->n", self._along, self.normals)
            moved = self.points + self._along * ahead[:, None]
            each, even = _lit_by(moved, motion.turned(self.normals), self._scene, self._top)
        factor = np.ones((len(self._met), before.shape[1]))
        factor[self._met] = (each.sum(axis=0) + even) / before
        bright = self._between_rays(factor)
        if hidden and len(self.points):
            for light, share in zip(each, hidden, strict=True):
                bright -= self._between_rays((light / before)[self._nearest]) * share[:, :, None]
        return bright

    def _between_rays(self, values: Floats) -> Singles:
        """Return (height, width, k) values between the grid's rays, from (r * c, k) there."""
        grid = values.T.reshape(-1, len(self._rows), len(self._columns))
        smooth = stretch(self._rows, self._size[0]) @ grid @ stretch(self._columns, self._size[1]).T
        return np.moveaxis(smooth, 0, 2).astype(np.float32)


def cover_light(origins: Points, directions: Floats, scene: Scene, top: float) -> Floats:
    """Return (n, 3) light from the cover along rays inside the body; 0 where a ray leaves the body
    or there is none.

    Parameters
    ----------
    origins, directions
        (n, 3) rays from the base plane, mm; NaN rays see nothing.
    scene
        With camera and light.
    top
        The irradiance that counts as 1, of `twin.world.picture.lamps.Lamps.brightest`.
    """
    light = np.zeros((len(origins), 3))
    if scene.cover is not None:
        points, normals = _places_at(origins, directions, scene.body, scene.cover.thickness_mm)
        seen = np.isfinite(points[:, 0])
        bright = _brightness(points[seen], normals[seen], scene, top)
        light[seen] = bright * np.asarray(scene.cover.albedo)
    return light


def stretch(nodes: Floats, size: int) -> Floats:
    """Return the (size, nodes) matrix of linear interpolation from nodes to pixels."""
    return np.stack(
        [np.interp(np.arange(size), nodes, column) for column in np.eye(len(nodes))], axis=1
    )


class SeeThrough:
    """What the camera sees behind the sensing surface, through clear rubber.

    Parameters
    ----------
    sees
        (height, width) of `twin.world.picture.camera_rays.View`.
    scene
        With camera and light.
    top
        The irradiance that counts as 1.
    """

    def __init__(self, sees: Bools, scene: Scene, top: float) -> None:
        self._sees, self._scene, self._top = sees, scene, top

    @property
    def is_bright(self) -> bool:
        """Whether there is light without a probe."""
        return any(self._scene.imaging[1].outside)

    @cached_property
    def _exits(self) -> tuple[Ints, _Exits]:
        """(n,) flat numbers of the pixels whose rays leave the body at rest, and these rays."""
        seen = np.argwhere(self._sees)[:, ::-1].astype(float)
        met, exits = _Exits.of(seen, self._scene)
        return np.flatnonzero(self._sees)[met], exits

    def light(self, probes: tuple[Load.Placed, ...]) -> Singles:
        """Return the (height, width, 3) light from there before vignetting and gain."""
        pixels, exits = self._exits
        cover = self._scene.cover
        through = 1.0 if cover is None else cover.transmittance
        passed = exits.passed
        seen = (through * passed)[:, None] * np.array(self._scene.imaging[1].outside)
        nearest = np.full(len(seen), np.inf)
        for probe in probes:
            hit, way, rubber, points, normals = exits.meet(probe, nearest)
            nearest[hit] = way
            bright = _brightness(points, normals, self._scene, self._top)
            # Radiance grows by the index squared as it enters the rubber.
            entering = (self._scene.material.refractive_index * passed[hit]) ** 2
            share = through**2 * np.where(rubber, 1.0, entering)
            seen[hit] = share[:, None] * bright * np.array(probe.albedo)
        picture = np.zeros((*self._sees.shape, 3), np.float32)
        picture.reshape(-1, 3)[pixels] = seen
        return picture

    @staticmethod
    def triangles(scene: Scene, probe: Load.Placed | None) -> tuple[Points, Floats, Ints]:
        """Return (n, 3) places, (n, 3) normals and (k, 3) triangles of what the camera sees of a
        probe; None: of the sensing surface at rest, with normals into the rubber."""
        camera, _ = scene.imaging
        # Light that reaches a probe crosses the surface outside the picture, too.
        more = 1.5 if probe is None else 0.0
        columns, rows = (
            np.linspace(-more * size - 0.5, (1 + more) * size - 0.5, _CELLS + 1)
            for size in (camera.width_px, camera.height_px)
        )
        places, normals, met = _seen_at(columns, rows, scene, probe)
        if probe is not None and met.any():  # once more, in the part of the picture that shows it
            columns = _around(columns, met, 0)
            rows = _around(rows, met, 1)
            places, normals, met = _seen_at(columns, rows, scene, probe)
        return places, normals, _between(met)


def _seen_at(
    columns: Floats, rows: Floats, scene: Scene, probe: Load.Placed | None
) -> tuple[Points, Floats, Bools]:
    """Return the (n, 3) places and normals that rays through a grid of the picture meet, and which
    (r, c) of them do; for a probe or the surface as in `SeeThrough.triangles`."""
    nodes = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    met, exits = _Exits.of(nodes, scene)
    places = exits.places
    if probe is None:
        normals = scene.body.piece_normals(places)[:, 0]
    else:
        hit, _, _, places, normals = exits.meet(probe, np.full(len(places), np.inf))
        met[np.delete(np.flatnonzero(met), hit)] = False
    return places, normals, met.reshape(len(rows), len(columns))


def _around(nodes: Floats, met: Bools, across: int) -> Floats:
    """Return as many nodes of one axis of a grid, from one before the first that has any ``met``
    (r, c) to one behind the last; ``across`` is the other axis."""
    there = np.flatnonzero(met.any(axis=across))
    first, last = max(there[0] - 1, 0), min(there[-1] + 1, len(nodes) - 1)
    return np.linspace(nodes[first], nodes[last], len(nodes))


def _between(met: Bools) -> Ints:
    """Return (k, 3) triangles between neighbours of a grid of rays, of which some meet a surface:
    numbers among those, row by row."""
    number = _numbered(met)
    here, right = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    below, both = number[1:, :-1].ravel(), number[1:, 1:].ravel()
    halves = [np.column_stack([here, below, right]), np.column_stack([right, below, both])]
    triangles = np.concatenate(halves)
    return triangles[(triangles >= 0).all(axis=1)]


def _numbered(met: Bools) -> Ints:
    """Return (r, c) numbers of the rays of a grid that are ``met``, row by row; -1 for others."""
    return np.where(met, np.cumsum(met).reshape(met.shape) - 1, -1)


@dataclass(frozen=True)
class _Exits:
    """Rays that leave a body at rest through its sensing surface.

    Attributes
    ----------
    places
        (n, 3) where they do, mm.
    along, air
        (n, 3) unit vectors before and after it.
    passed
        (n,) shares of the light that pass.
    """

    places: Points
    along: Floats
    air: Floats
    passed: Floats

    @staticmethod
    def of(pixels: Pixels, scene: Scene) -> tuple[Bools, _Exits]:
        """Return which of (n, 2) places in the picture have such a ray, and these rays."""
        origins, along = rays(pixels, *scene.optics)
        places, normals = _places_at(origins, along, scene.body, 0.0)
        met = np.isfinite(places[:, 0])
        places, along, normals = places[met], along[met], normals[met]
        # Snell's law into the air; a ray that is mirrored back sees nothing.
        index = scene.material.refractive_index
        cosine = -np.sum(along * normals, axis=1)
        square = 1 - index**2 * (1 - cosine**2)
        in_air = np.sqrt(np.maximum(square, 0.0))
        air = index * along + (index * cosine - in_air)[:, None] * normals
        slant = np.sqrt(1 - in_air**2) / np.maximum(in_air, 1e-6)
        passed = np.where(square > 0, 1 - reflection(slant, index, 1.0), 0.0)
        return met, _Exits(places, along, air, passed)

    def meet(
        self, probe: Load.Placed, within_mm: Floats
    ) -> tuple[Ints, Floats, Bools, Points, Floats]:
        """Return which rays meet a probe less than (n,) ``within_mm`` behind their places: their
        numbers, how far behind, whether the probe stands in the rubber there, the places on it,
        and its normals."""
        ahead, normals = probe.met(self.places, -self.along)
        behind, their_normals = probe.met(self.places, -self.air)
        rubber = ahead <= 0
        way = np.where(rubber, ahead, np.where((behind > 0) & (self.passed > 0), behind, np.inf))
        hit = np.flatnonzero(way < within_mm)
        way, rubber = way[hit], rubber[hit]
        onward = np.where(rubber[:, None], self.along[hit], self.air[hit])
        facing = np.where(rubber[:, None], normals[hit], their_normals[hit])
        return hit, way, rubber, self.places[hit] + way[:, None] * onward, facing


def _places_at(
    origins: Points, directions: Floats, body: Body, depth_mm: float, beyond_mm: float = 1e-3
) -> tuple[Points, Floats]:
    """Return (n, 3) places where rays inside a body at rest meet a level set of the depth, mm, and
    its inward normals; NaN for none, and for those farther beyond its sides.

    The depth is an exact distance: rays march by it.
    """
    points, normals = np.full((len(origins), 3), np.nan), np.full((len(origins), 3), np.nan)
    seen = np.flatnonzero(
        np.isfinite(origins).all(axis=1) & body.contains(np.nan_to_num(origins), -1e-6)
    )
    start, along = origins[seen], directions[seen]
    distance = np.zeros(len(start))
    gap = np.zeros(len(start))
    for _ in range(80):
        gap = body.depth(start + along * distance[:, None]) - depth_mm
        distance += gap
        if not np.any(np.abs(gap) > 1e-4):
            break
    places = start + along * distance[:, None]
    hits = (body.piece_distances(places)[:, 1:] > -beyond_mm).all(axis=1) & (np.abs(gap) < 1e-2)
    points[seen[hits]] = places[hits]
    normals[seen[hits]] = body.piece_normals(places[hits])[:, 0]
    return points, normals


def _brightness(points: Points, normals: Floats, scene: Scene, top: float) -> Floats:
    """Return (n, k) light that white places of the cover send back, a share of even light
    included."""
    each, even = _lit_by(points, normals, scene, top)
    bright: Floats = each.sum(axis=0) + even
    return bright


def _lit_by(points: Points, normals: Floats, scene: Scene, top: float) -> tuple[Floats, Floats]:
    """Return (leds, n, k) light of each LED that white places of the cover send back, and the (k,)
    even light."""
    _, light = scene.imaging
    tints, even = light.tints()
    each = Lamps.at(points, scene).irradiances(points, normals) / top
    direct = (1 - light.ambient) * each.T[:, :, None] * tints.T[:, None]
    return direct, light.ambient * even
