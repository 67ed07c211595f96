"""Which mesh a displacement comes from: the levels of a body, and bodies under a cover.

**Levels.** `Ladder` begins with the cheapest level that may reach the requested accuracy
(`EXPECTED` in `twin.world.elasticity.error_law`), goes on to finer ones while the estimated error
is too large, and returns the result with the least error.

**Places.** What a load leaves out of balance on a free face is as wide as their distance, and on a
curved surface as the load itself. Where a level's elements are longer than that, and what they miss
is much of the error, its mesh is refined there (`LOCAL`): cheaper than a finer mesh of the whole
body, and more exact.

**Cover.** Every region of a covered body that is pressed has a mesh of its own
(`twin.world.mesh.cover_mesh`): the half-space of the cover is right above the interface only, and
what it leaves is as steep there as the load, so elements under the load must be about as small.
Under a softer cover the half-space field is many times larger than the result, and the correction
would have to cancel it: plain Taylor-Hood is better there (a tenth of the body's modulus: 0.2 to
0.9 % off, instead of 1.7 to 8 %). The error is estimated from the difference to another mesh,
`COARSER` times as coarse under the load; there is no estimate before the solve.

Validity: under bumps 2 to 4 mm wide, points below covers of a tenth and of ten times the body's
modulus, and on the surface of stiffer ones, are 0.3 to 2 % off. The surface of softer covers is up
to 4 % off sideways and up to 18 % along the normal, and the estimate shows it. Contact needs a
solve for every patch: minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Floats, Points, Progress
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.world.elasticity.cache import PointCache
from twin.world.elasticity.compliance import Compliance, Method
from twin.world.elasticity.error_law import EXPECTED, unbounded
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.interpolated import patch_corrections
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.cover_mesh import with_cover
from twin.world.mesh.quadratic_mesh import Mesh
from twin.world.mesh.sizing import WORLD, Level, Sizing
from twin.world.mesh.snap import drawn_to_rim

FINE = 0.6
"""Longest edge under a load over the load's radius plus the cover's thickness."""

GROWTH = 1.5
"""Growth of the longest edge with distance from the load."""

ACROSS = 3.0
"""Elements across the radius of a region of many patches, at most: finer ones would cost too
much."""

ROOM = 1.5
"""How much larger than the load the region is whose mesh is made: the next load is often near."""

MANY = 20
"""Patches beyond which a solve for each of them is worth a word."""

COARSER = 1.5
"""Edges under a load in the coarser mesh by which the error is estimated, over those of the
mesh."""

STIFF_TRUST, SOFT_TRUST = 0.75, 0.55
"""Share of the two meshes' difference that is taken for the error, under covers stiffer and softer
than the body."""

UNSEEN = 2e-3
"""Error that the two meshes share: both take the cover for one layer of prisms."""

LOCAL: dict[Level, float] = {"sketch": 1.5, "coarse": 1.0, "standard": 0.7, "fine": 0.55}
"""Longest edge where a level is refined for a load, over the distance from the load, or the width
of what the load leaves out of balance where that is more."""

BESIDE, WITHIN = 0.6, 0.75
"""That width, over the distance of a free face from the load, and over the load's radius on curved
surfaces."""

SHORTEST = 0.04
"""Least such width, over the load's extent: a long load has so many elements beside it."""

PLACES = 4
"""Places for which refined meshes are kept."""

LOCALLY = 0.25
"""Share of a level's error, by what its elements miss beside a load, from which on it is refined
there: far from the load, and next to held faces, a finer level does more for less."""

HOPE = 0.25
"""Least error of a level, over the expected one: wide loads have less."""


class _LocalModel(Compliance):
    """The compliance of a covered body on a mesh that is fine in one place, the cover (made of
    ``layer``) being its region 1."""

    one_material = False

    def __init__(self, body: Body, material: Material, mesh: Mesh, layer: TaylorHood.Layer) -> None:
        method: Method = "subtracted" if layer.modulus_ratio >= 1.0 else "direct"
        super().__init__(body, material, mesh, method=method, table=False)
        self._layer = layer

    @cached_property
    def system(self) -> TaylorHood:
        """The elastic system, factored at its first solve."""
        held = self.mesh.nodes_on(self.body.held_pieces)
        return TaylorHood(self.mesh, self.material.poisson_ratio, held=held, layers=[self._layer])

    @property
    def _rubber(self) -> tuple[float, float]:
        return self._layer.modulus_ratio * self._modulus, self._layer.poisson_ratio

    def _solved_corrections(
        self, points: PointCache, rectangles: Rectangles, reused: bool, moving: bool
    ) -> Floats:
        """Return (n, 3, k, 3) patch by patch: near a patch its correction is too steep to be
        interpolated between patches."""
        places = points.placed(self._locator)
        return patch_corrections(self.system, self.body, places, rectangles, moving=moving)


class CoveredCompliance:
    """The elastic response of a body under a cover of another modulus; its methods are those of
    `Compliance`.

    Parameters
    ----------
    body, material
        The body, cover included, and what its inside is made of.
    thickness_mm, layer
        The cover's thickness, mm, and what it is made of.
    level
        Mesh of the body that the regions' meshes are made from.
    fine
        Longest edge under a load over the load's radius plus the cover's thickness.
    progress
        Told when the body's mesh has to be made.
    """

    one_material = False
    """Closed forms of a half-space don't tell how large a contact on it is: see
    `SurfaceCompliance`."""

    def __init__(
        self,
        body: Body,
        material: Material,
        thickness_mm: float,
        layer: TaylorHood.Layer,
        *,
        level: Level = "coarse",
        fine: float = FINE,
        progress: Progress | None = None,
    ) -> None:
        self.body = body
        self.material = material
        self.thickness_mm = thickness_mm
        self.layer = layer
        self.level: Level = level
        self._fine = fine
        self._progress = progress
        self._models: list[tuple[Points, float, float, _LocalModel]] = []

    @cached_property
    def _coarser(self) -> CoveredCompliance:
        """The same on coarser meshes, by whose result the error is estimated."""
        rank = WORLD.index("coarse" if self.level == "nominal" else self.level)
        return CoveredCompliance(
            self.body,
            self.material,
            self.thickness_mm,
            self.layer,
            level=WORLD[max(rank - 1, 0)],
            fine=COARSER * self._fine,
            progress=self._progress,
        )

    def local_model(self, load: Rectangles, *, each: bool = False) -> _LocalModel:
        """Return the model, an old or a new one, whose mesh is fine enough under ``load``: for all
        rectangles together, or for ``each`` of them as far as `ACROSS` allows."""
        low, high = load.centre_mm.min(axis=0), load.centre_mm.max(axis=0)
        centre = (low + high) / 2.0
        reach = np.linalg.norm(load.centre_mm - centre, axis=1) + np.linalg.norm(
            load.half_mm, axis=1
        )
        radius = float(reach.max())
        room, size = ROOM * radius, radius
        if each:
            size = float(np.linalg.norm(load.half_mm, axis=1).mean())
        edge = max(self._fine * (size + self.thickness_mm), room / ACROSS if each else 0.0)
        for other, space, finest, made in self._models:
            if np.linalg.norm(centre - other) + radius <= space and finest <= 1.4 * edge:
                return made
        bare = body_mesh(self.body, self.level, progress=self._progress)
        fine = refined(
            bare,
            self.body,
            lambda points: (
                edge + GROWTH * np.maximum(np.linalg.norm(points - centre, axis=1) - room, 0.0)
            ),
        )
        mesh = drawn_to_rim(with_cover(fine, self.body, self.thickness_mm), self.body)
        model = _LocalModel(self.body, self.material, mesh, self.layer)
        self._models.append((centre, room, edge, model))
        return model

    def displacement(self, points: Points, load: Rectangles) -> Points:
        """See `Compliance.displacement`."""
        if len(load) == 0:
            return np.zeros((len(points), 3))
        return self.local_model(load).displacement(points, load)

    def answer(self, points: Points, load: Rectangles) -> tuple[Points, float]:
        """Return `displacement`, and its estimated largest error over the largest displacement;
        raises like it.

        A share of the difference to the result on a coarser mesh, plus `UNSEEN`: one to four times
        the true error against the layered half-space and an independent code.
        """
        moved, errors = self.displacement_errors(points, load)
        largest = np.linalg.norm(errors, axis=2).max(axis=1, initial=0.0)
        size = np.linalg.norm(moved, axis=1).max(initial=0.0)
        return moved, float(largest.sum() / size) if size else 0.0

    def displacement_errors(self, points: Points, load: Rectangles) -> tuple[Points, Floats]:
        """See `Compliance.displacement_errors`."""
        moved = self.displacement(points, load)
        if not moved.any():
            return moved, np.zeros((0, len(moved), 3))
        trust = STIFF_TRUST if self.layer.modulus_ratio >= 1.0 else SOFT_TRUST
        differ = moved - self._coarser.displacement(points, load)
        return moved, np.stack([trust * differ, (UNSEEN + unbounded(self.body, load)) * moved])

    def forget(self) -> None:
        """Forget the meshes of the places pressed so far."""
        self._models.clear()
        if "_coarser" in self.__dict__:
            self._coarser.forget()

    def gradient(self, points: Points, load: Rectangles) -> Floats:
        """See `Compliance.gradient`; within the cover and outside it, not across."""
        if len(load) == 0:
            return np.zeros((len(points), 3, 3))
        return self.local_model(load).gradient(points, load)

    def to_points(self, points: Points, rectangles: Rectangles) -> Floats:
        """See `Compliance.to_points`."""
        if self._progress and len(rectangles) > MANY:
            self._progress(
                f"compliance of {len(rectangles)} patches on the cover, one by one: minutes", 0.0
            )
        return self.local_model(rectangles, each=True).to_points(points, rectangles)

    def surface(self, rectangles: Rectangles) -> Floats:
        """See `Compliance.surface`."""
        return self.local_model(rectangles, each=True).surface(rectangles)


@dataclass(frozen=True, kw_only=True)
class _DisplacementResult:
    """Displacements (n, 3), mm, their estimated largest error over the largest displacement, and
    the compliance of the level that they were taken from."""

    displacement_mm: Points
    error: float
    compliance: Compliance | CoveredCompliance


class Ladder:
    """The levels of one body, each made when first needed.

    Parameters
    ----------
    body, material
        What it is.
    asked
        Largest error over the largest displacement.
    covered
        The body's only level where its cover is of another modulus.
    surface_table
        Whether the cheapest level that is expected to do has a `SurfaceTable`.
    progress
        Called when a mesh or a table has to be made.
    """

    def __init__(
        self,
        body: Body,
        material: Material,
        asked: float,
        *,
        covered: CoveredCompliance | None = None,
        surface_table: bool = False,
        progress: Progress | None = None,
    ) -> None:
        self._body = body
        self._material = material
        self._asked = asked
        self._covered = covered
        self._surface_table = surface_table
        self._progress = progress
        self._rungs: dict[Level, Compliance] = {}
        self._places: list[tuple[Level, Points, Floats, Compliance]] = []

    def _at(self, level: Level) -> Compliance:
        """Return the compliance on one level."""
        if level not in self._rungs:
            self._rungs[level] = Compliance(
                self._body,
                self._material,
                level=level,
                surface_table=self._surface_table and level == self._cheapest,
                progress=self._progress,
            )
        return self._rungs[level]

    @cached_property
    def _cheapest(self) -> Level:
        flat = self._body.is_flat
        return next((r for r in WORLD[1:] if EXPECTED[flat, r].inside <= self._asked), WORLD[-1])

    @property
    def base(self) -> Compliance | CoveredCompliance:
        """The cheapest level that is expected to do."""
        return self._covered or self._at(self._cheapest)

    def displacement(self, points: Points, load: Rectangles) -> _DisplacementResult:
        """Return the (n, 3) displacement of ``points`` under ``load``, from as fine a level as it
        takes; exactly 0 on held faces. Arguments and errors as in `Compliance.displacement`."""
        free = ~self._body.holds(points)
        inside = points if free.all() else points[free]

        def solved(rung: Compliance | CoveredCompliance) -> _DisplacementResult:
            moved = np.zeros((len(points), 3))
            moved[free], error = rung.answer(inside, load)
            return _DisplacementResult(displacement_mm=moved, error=error, compliance=rung)

        if self._covered:
            return solved(self._covered)
        found: list[_DisplacementResult] = []
        for level in WORLD[1:]:
            law = EXPECTED[self._body.is_flat, level]
            if HOPE * law.inside > self._asked and level != WORLD[-1]:
                continue
            bare = self._at(level)
            found.append(solved(bare))
            if found[-1].error > self._asked:
                centres, widths = self._steep(level, load)
                moved = found[-1].displacement_mm[free]
                if len(centres) and bare.missed(inside, load, moved) > LOCALLY * found[-1].error:
                    found.append(solved(self._refined(level, centres, widths)))
            if found[-1].error <= self._asked:
                break
        return min(found, key=lambda one: one.error)

    def _steep(self, level: Level, load: Rectangles) -> tuple[Points, Floats]:
        """Return the places (k, 3) of rectangles that leave more out of balance beside them than
        the level's elements follow, and its width (k,), mm."""
        body = self._body
        if len(load) == 0:
            return load.centre_mm, np.zeros(0)
        edge = Sizing.of(body, level).fine_mm
        size = float(np.linalg.norm(np.ptp(load.centre_mm, axis=0), axis=0)) / 2.0
        size += float(load.half_mm.max(initial=0.0))
        width = np.full(len(load), np.inf)
        if free := body.edge_pieces:
            away = body.piece_distances(load.within(body))[:, free].min(axis=1)
            width = BESIDE * np.maximum(away, load.half_mm.max(axis=1))
        if not body.is_flat and body.own_surface is None:  # triangles are no finer than they are
            width = np.minimum(width, WITHIN * size)
        steep = width < edge
        return load.centre_mm[steep], np.maximum(width[steep], SHORTEST * size)

    def _refined(self, level: Level, centres: Points, widths: Floats) -> Compliance:
        """Return the compliance of a level whose mesh is refined around places (k, 3), made before
        or new."""
        for of, around, finest, made in self._places:
            near = np.linalg.norm(centres[:, None] - around, axis=2) <= widths[:, None] / 2.0
            if of == level and (near & (finest <= 1.25 * widths[:, None])).any(axis=1).all():
                return made
        less = EXPECTED[self._body.is_flat, level].compared(self._body)
        other = Compliance(
            self._body, self._material, self._mesh_around(less, level, centres, widths), level=less
        )
        made = Compliance(
            self._body,
            self._material,
            self._mesh_around(level, level, centres, widths),
            level=level,
            compared=other,
        )
        self._places = [*self._places, (level, centres, widths, made)][-PLACES:]
        return made

    def _mesh_around(self, base: Level, level: Level, centres: Points, widths: Floats) -> Mesh:
        """Return the mesh of ``base``, refined around places (k, 3) as `LOCAL` says of ``level``,
        or `COARSER` times less; those of like widths, to a factor of 2, together."""
        from scipy.spatial import cKDTree

        octave = np.floor(np.log2(widths / widths.min()))
        alike = [octave == number for number in np.unique(octave)]
        trees = [(cKDTree(centres[rows]), widths[rows].min()) for rows in alike]
        share = LOCAL[level] * (1.0 if base == level else COARSER)

        def longest(points: Points) -> Floats:
            away = [np.maximum(tree.query(points)[0], width) for tree, width in trees]
            return np.asarray(share * np.min(away, axis=0))

        bare = body_mesh(self._body, base, progress=self._progress)
        return drawn_to_rim(refined(bare, self._body, longest), self._body)
