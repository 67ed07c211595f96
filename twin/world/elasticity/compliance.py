"""How far every point of a body moves under forces on its surface, and how accurately.

A body is factored once, at the first load that needs it; every further press, marker layout or
calibration is a product. The default method is the half-space field of the load in closed form plus
the smooth correction of the finite body (`twin.world.elasticity.correction`); ``direct`` is plain
Taylor-Hood. `Compliance.expected_error` is known before anything is solved, from the load's place;
the estimate of `Compliance.answer` afterwards, from the difference to another level's result.

Validity: linear elasticity, small strain, quasi-static. The correction is smooth on the scale of
the mesh; loads nearer to a free edge than an element are less accurate, and both errors grow there.
Within a tenth of the body's height of a held face there is no bound: both are one and more.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np

from twin.arrays import Floats, Points, Progress, grid_points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.theory import halfspace
from twin.theory.bonded_layer import BondedLayer
from twin.world.elasticity.block_table import Table, Tables
from twin.world.elasticity.cache import (
    REMEMBERED,
    PointCache,
    PointCaches,
    cached_field,
    field_key,
)
from twin.world.elasticity.correction import correction
from twin.world.elasticity.discretise import require_on_surface
from twin.world.elasticity.error_law import (
    DIRECT,
    EXPECTED,
    error_shares,
    expected_error,
    missed_by_mesh,
)
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.interpolated import (
    KEPT_POINTS,
    SHARE,
    AdjointFields,
    EdgeRegion,
    Region,
    SurfaceTable,
    patch_corrections,
)
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator, Recovery
from twin.world.mesh.quadratic_mesh import Mesh
from twin.world.mesh.sizing import Level
from twin.world.mesh.snap import drawn_to_rim

Method = Literal["subtracted", "direct"]

FEW = 3
"""Points are read by adjoint solves where patches are more than this many times as many."""


WEAKER = 0.5
"""Displacement of a point, over that of a half-space, below which what elements miss beside a load
is as much weaker there: a held face lies near, or the load is far away on a thin body."""


class Compliance:
    """The elastic response of one body.

    Parameters
    ----------
    body, material
        What it is. Young's modulus only scales the result.
    mesh
        Its mesh; if not given, that of ``level`` (see `twin.world.mesh.sizing.Level`).
    level
        Truth and sensor never share one.
    method
        ``subtracted`` or ``direct``.
    table
        Whether a table of the body may replace solves (never with a given mesh), or the table.
    compared
        Of a given mesh: the same body on the mesh by which the error is estimated.
    surface_table
        Whether to make a `SurfaceTable` of a curved body at its first load: a minute or two.
    progress
        Called when a mesh or a table of the surface has to be made.
    """

    one_material = True

    def __init__(
        self,
        body: Body,
        material: Material,
        mesh: Mesh | None = None,
        *,
        level: Level = "standard",
        method: Method = "subtracted",
        table: bool | Table = True,
        compared: Compliance | None = None,
        surface_table: bool = False,
        progress: Progress | None = None,
    ) -> None:
        self.body = body
        self.material = material
        self.level: Level = level
        self.method: Method = method
        self._given_mesh = mesh
        self._given_compared = compared
        self._progress = progress
        self._use_surface = surface_table
        self._fields: dict[tuple[bytes, ...], Floats] = {}
        self._point_caches = PointCaches(body)
        self._sound: Rectangles | None = None
        self._region: Region | None = None
        self._tables = Tables(
            body,
            material.poisson_ratio,
            nominal=level == "nominal",
            use=table if mesh is None and method == "subtracted" else False,
            progress=progress,
        )

    @cached_property
    def mesh(self) -> Mesh:
        """The mesh of the correction: as given, or the level's with its elements at the clamped rim
        drawn to it."""
        if self._given_mesh is not None:
            return self._given_mesh
        made = body_mesh(self.body, self.level, progress=self._progress)
        return drawn_to_rim(made, self.body)

    @cached_property
    def system(self) -> TaylorHood:
        """The elastic system, factored at its first solve."""
        held = self.mesh.nodes_on(self.body.held_pieces)
        return TaylorHood(self.mesh, self.material.poisson_ratio, held=held)

    @cached_property
    def _bonded_layer(self) -> BondedLayer | None:
        """The layer whose field is known."""
        if not (self._subtracted and self.one_material):
            return None
        return BondedLayer.of(self.body, self.material.poisson_ratio)

    def _layer_beside(self, table: Table.AtNu | None) -> BondedLayer | None:
        """Return the layer whose field a correction, solved or by ``table``, leaves out."""
        return self._bonded_layer if table is None or self._tables.beyond_layer else None

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.mesh)

    @cached_property
    def _recovery(self) -> Recovery:
        return Recovery(self.mesh)

    @cached_property
    def _surface_table(self) -> SurfaceTable | None:
        of_use = not self.body.is_flat and self._given_mesh is None and self._subtracted
        if not (self._use_surface and of_use):
            return None
        return SurfaceTable(self.system, self.body, self._progress)

    def _surface_for(self, load: Rectangles) -> SurfaceTable | None:
        table = self._surface_table
        return table if table is not None and table.covers(load) and table.pushes(load) else None

    @cached_property
    def _compared(self) -> Compliance | None:
        """The same body on the level by which the error is estimated; None where the mesh was
        given alone."""
        if self._given_mesh is not None:
            return self._given_compared
        return Compliance(
            self.body,
            self.material,
            level=EXPECTED[self.body.is_flat, self.level].compared(self.body),
            method=self.method,
            table=False,
            surface_table=self._use_surface,
            progress=self._progress,
        )

    def displacement(self, points: Points, load: Rectangles) -> Points:
        """Return the (n, 3) displacement in mm of ``points`` (n, 3) in the body under ``load``.

        Raises
        ------
        InputError
            A point is outside the body; a rectangle is not on the sensing surface or hangs over
            its end, or its force is not finite.
        SolveError
            See `twin.world.elasticity.factor.Factor.solve`.
        """
        known = self._checked(points, load)
        if len(known) == 0 or not np.any(load.force_n):
            return np.zeros_like(known.points)
        table = self._tables.covering(known, load)
        return self._whole(known, load, self._correction(known, load, table)[0], table)

    def _whole(
        self, known: PointCache, load: Rectangles, w: Points, table: Table.AtNu | None
    ) -> Points:
        """Return the displacement (n, 3) from its correction ``w``, solved or by ``table``."""
        if not self._subtracted:
            return w
        moved = w + halfspace.displacement(known.points, load, *self._rubber)
        if (layer := self._layer_beside(table)) is not None:
            moved += layer.displacement(known.points, load, self._modulus)
        return moved

    def _correction(
        self, known: PointCache, load: Rectangles, table: Table.AtNu | None
    ) -> tuple[Points, float]:
        """Return the correction (n, 3), everything with the direct method; and the error of
        interpolation, mm."""
        if table:
            return table.displacement(known, load) / self._modulus, 0.0
        if surface := self._surface_for(load):
            w, lost = self._interpolated(surface, known, load)
            return w / self._modulus, lost / self._modulus
        return known.placed(self._locator).values(self._field(load)) / self._modulus, 0.0

    def _interpolated(
        self, surface: SurfaceTable, known: PointCache, load: Rectangles
    ) -> tuple[Points, float]:
        """Return the correction (n, 3) for E = 1 MPa, and the largest error of interpolation,
        mm."""
        places = known.placed(self._locator)
        if len(known) > KEPT_POINTS:
            w, every_other = (places.values(surface.field(load, step)) for step in (1, 2))
            return w, SHARE * _largest(w - every_other)
        reading = known.once("surface", lambda: surface.reading(places))
        return surface.displacement(reading, load)

    def gradient(self, points: Points, load: Rectangles) -> Floats:
        """Return (n, 3, 3) du_i/dx_j at ``points`` (n, 3): strain and turn. Raises like
        `displacement`."""
        known = self._checked(points, load)
        if len(known) == 0 or not np.any(load.force_n):
            return np.zeros((len(known), 3, 3))
        if table := self._tables.covering(known, load):
            w = table.gradient(known, load)
        elif surface := self._surface_for(load):
            places = known.placed(self._locator)
            if len(known) > KEPT_POINTS:
                w = places.gradients(surface.field(load))
            else:
                w = surface.gradient(known.once("slopes", lambda: surface.slopes(places)), load)
        else:
            w = known.placed(self._locator).gradients(self._field(load))
        if (layer := self._layer_beside(table)) is not None:
            w = w + layer.gradient(known.points, load, 1.0)
        w = w / self._modulus
        if not self._subtracted:
            return w
        return w + halfspace.gradient(known.points, load, *self._rubber)

    def to_points(
        self,
        points: Points,
        rectangles: Rectangles,
        *,
        reused: bool = False,
        moving: bool = False,
    ) -> Floats:
        """Return the (3 n, 3 k) displacement in mm/N of ``points`` (n, 3) per unit global force on
        each rectangle.

        The rectangles' own ``force_n`` is ignored. With ``reused`` more patches in the same place
        will follow, with ``moving`` other points for the same patches. Raises like `displacement`.
        """
        known = self._checked(points, rectangles)
        shape = (3 * len(known), 3 * len(rectangles))
        if 0 in shape:
            return np.zeros(shape)
        if not self._subtracted:
            units = [
                replace(rectangles[i : i + 1], force_n=force[None])
                for i in range(len(rectangles))
                for force in np.eye(3)
            ]
            fields = _direct_fields(self.system, self.body, self._locator, units)
            return (known.placed(self._locator).values(fields) / self._modulus).reshape(shape)
        if table := self._table_of_many(known, rectangles, reused=reused):
            w = table.corrections(known, rectangles).reshape(shape)
        else:
            w = self._solved_corrections(known, rectangles, reused, moving).reshape(shape)
        if (layer := self._layer_beside(table)) is not None:
            w += layer.compliance(known.points, rectangles, 1.0)
        whole = halfspace.compliance(known.points, rectangles, *self._rubber)
        w /= self._modulus
        whole += w
        return whole

    def _table_of_many(
        self, known: PointCache, rectangles: Rectangles, *, reused: bool
    ) -> Table.AtNu | None:
        """Return the table that covers patches and points; it is made where that is worth it."""
        table = self._tables.covering(known, rectangles)
        if table is None and Region.pays(rectangles, reused=reused):
            self._tables.make()
            table = self._tables.covering(known, rectangles)
        return table

    def _solved_corrections(
        self, known: PointCache, rectangles: Rectangles, reused: bool, moving: bool
    ) -> Floats:
        """Return (n, 3, k, 3) by the fewest solves: a region for patches close together, or for
        many that more will follow, else by patch or by point."""
        places = known.placed(self._locator)
        if self._surface_table is not None and self._surface_table.covers(rectangles):
            return self._surface_table.corrections(places, rectangles)
        if moving:
            return patch_corrections(self.system, self.body, places, rectangles, moving=True)
        near = Region.pays(rectangles, reused=reused)
        if near or EdgeRegion.pays(rectangles, reused=reused):
            if self._region is None or not self._region.covers(rectangles):
                self._region = _region(self.system, self.body, rectangles, near)
            return self._region.corrections(places, rectangles)
        if FEW * len(known) >= len(rectangles):
            return patch_corrections(self.system, self.body, places, rectangles)
        adjoint = self._point_caches.make_sole(
            known, "adjoint", lambda: AdjointFields(self.system, self.body, places)
        )
        return adjoint.corrections(rectangles)

    def surface(self, rectangles: Rectangles) -> Floats:
        """Return the symmetric (3 k, 3 k) displacement in mm/N of the rectangles' centres per unit
        force on each.

        Betti's theorem makes it symmetric for small patches. Raises like `displacement`.
        """
        matrix = self.to_points(rectangles.centre_mm, rectangles, reused=True)
        return (matrix + matrix.T) / 2.0

    def normal_surface(self, rectangles: Rectangles) -> Floats | None:
        """Return the normal part (k, k) of `surface`, mm/N: a ninth of the work, and all that
        frictionless contact needs. None off a plane that a table covers."""
        if not self._subtracted or np.any(rectangles.frames - np.eye(3)):
            return None
        known = self._checked(rectangles.centre_mm, rectangles)
        table = self._table_of_many(known, rectangles, reused=True)
        if table is None or known.points[:, 2].any():
            return None
        matrix = table.normal_corrections(known, rectangles) / self._modulus
        matrix += halfspace.normal_compliance(rectangles, *self._rubber)
        if (layer := self._layer_beside(table)) is not None:
            whole = layer.compliance(known.points, rectangles, self._modulus)
            matrix += whole[2::3, 2::3]
        return (matrix + matrix.T) / 2.0

    def offset_part(self, points: Points, rectangle: Rectangles) -> Floats:
        """Return (3 n, 3) mm/N: what tables leave out, at ``points`` (n, 3) under a unit force on
        one rectangle."""
        known = halfspace.compliance(points, rectangle, *self._rubber)
        if self._bonded_layer is not None and self._tables.beyond_layer:
            known += self._bonded_layer.compliance(points, rectangle, self._modulus)
        return known

    def smooth_part(self, patches: Rectangles, nodes: Rectangles) -> Floats | None:
        """Return (3 n, 3 n) mm/N: the correction at the middles of ``nodes`` under unit forces on
        them.

        None where no table covers all ``patches``, between which the nodes must lie: the correction
        is a polynomial only there. A table that would cover them is made, so that a contact has the
        same patches whatever lies in the cache.
        """
        if not self._subtracted:
            return None
        known = self._checked(patches.centre_mm, patches)
        self._tables.make_for(patches)
        table = self._tables.covering(known, patches)
        if table is None:
            return None
        matrix = table.corrections(PointCache(nodes.centre_mm), nodes)
        return matrix.reshape(3 * len(nodes), -1) / self._modulus

    def answer(self, points: Points, load: Rectangles) -> tuple[Points, float]:
        """Return `displacement` and its estimated largest error over the largest displacement.

        The parts of the error are those of `twin.world.elasticity.error_law`; on all reference
        cases the estimate is one to three times the true error. Raises like `displacement`.
        """
        moved, errors = self._moved_and_errors(points, load)
        return moved, sum(map(_largest, errors)) / _largest(moved) if errors else 0.0

    def displacement_errors(self, points: Points, load: Rectangles) -> tuple[Points, Floats]:
        """Return `displacement` (n, 3) and the parts (c, n, 3) of its estimated error, mm, each
        with its sign.

        The lengths of the parts add up to what `answer` estimates. What is linear in the
        displacement, as the forces of a contact are, has the error that each part of its own
        causes. Raises like `displacement`.
        """
        moved, errors = self._moved_and_errors(points, load)
        parts = [part for part in errors if len(part) == len(moved)]
        return moved, np.stack(parts) if parts else np.zeros((0, len(moved), 3))

    def _moved_and_errors(self, points: Points, load: Rectangles) -> tuple[Points, list[Points]]:
        """Return the displacement (n, 3), and the parts of its error: displacements (m, 3), mm,
        whose largest lengths add up to it; none under no load."""
        known = self._checked(points, load)
        if len(known) == 0 or not load.force_n.any():
            return np.zeros_like(known.points), []
        table = self._tables.covering(known, load)
        w, lost = self._correction(known, load, table)
        moved = self._whole(known, load, w, table)
        level, size = self.level, _largest(moved)
        if table and self._tables.check is not None:
            level = self._tables.level
            other = self._tables.check.displacement(known, load) / self._modulus
        elif table is None and self._compared is not None:
            other = self._compared._correction(
                self._compared._checked(known.points, load), load, None
            )[0]
        else:
            return moved, [self.expected_error(load, table) * moved]
        direct = not self._subtracted
        missed = None if table or direct else self._missed(known, load, moved)
        trust, rough, unseen = error_shares(
            self.body,
            level,
            load,
            size * self._modulus,
            direct=direct,
            refined=self._given_compared is not None,
            table=("nominal" if self.level == "nominal" else "truth") if table else None,
            between=self._tables.between * _largest(w) / size if table else 0.0,
            at_edge=missed is not None and bool(missed.any()),
        )
        parts = [trust * (w - other), (unseen + lost / size) * moved]
        if rough and not (table or direct):
            parts.append(rough * self._rough(known, load, w))
        if missed is not None:
            parts.append(missed)
        return moved, parts

    def _missed(self, known: PointCache, load: Rectangles, moved: Points) -> Points:
        """Return `missed_by_mesh` (n, 3), mm, less where the body moves less than `WEAKER` of what
        a half-space does."""
        missed = missed_by_mesh(self.body, known.points, load, self._locator.edges) / self._modulus
        if not missed.any():
            return missed
        free = np.linalg.norm(halfspace.displacement(known.points, load, *self._rubber), axis=1)
        share = np.linalg.norm(moved, axis=1) / np.maximum(free, 1e-300)
        return np.asarray(missed * np.minimum(share / WEAKER, 1.0)[:, None])

    def missed(self, points: Points, load: Rectangles, moved: Points) -> float:
        """Return the part of the error of `answer`, which gave ``moved`` (n, 3), mm, that a mesh
        refined beside the load would not have. Raises like `displacement`."""
        known = self._checked(points, load)
        if len(known) == 0 or not load.force_n.any() or self._tables.covering(known, load):
            return 0.0
        return _largest(self._missed(known, load, moved)) / _largest(moved)

    def _rough(self, known: PointCache, load: Rectangles, w: Points) -> Points:
        """Return the difference (m, 3) of the correction ``w`` (n, 3) to a smoother reading of the
        same field, mm."""
        smooth, surface = known.smoothed(self._recovery), self._surface_for(load)
        if surface is None:
            read = smooth.values(self._field(load))
        elif len(known) > KEPT_POINTS:
            read = smooth.values(surface.field(load))
        else:
            reading = known.once("rough", lambda: surface.reading(smooth))
            read = surface.displacement(reading, load)[0]
        return np.asarray(read / self._modulus - w[known.every])

    def forget(self) -> None:
        """Forget what the last loads left behind: later results don't depend, in last digits, on
        them."""
        self._region = None
        self._point_caches.forget()

    def keep(self, points: Points) -> None:
        """Expect many loads at ``points`` (n, 3): what reads them is made at the first, and
        outlives `forget`."""
        self._point_caches.keep(points)

    def expected_error(self, load: Rectangles, table: Table.AtNu | None = None) -> float:
        """Return the error to be expected before anything is solved, with a ``table`` that of its
        mesh: see `twin.world.elasticity.error_law`."""
        if not self._subtracted:
            return DIRECT
        tabled = table is not None and self.level != "nominal"
        return expected_error(self.body, self._tables.level if tabled else self.level, load)

    @property
    def _subtracted(self) -> bool:
        return self.method == "subtracted"

    @property
    def _modulus(self) -> float:
        return self.material.youngs_modulus_mpa

    @property
    def _rubber(self) -> tuple[float, float]:
        return self.material.youngs_modulus_mpa, self.material.poisson_ratio

    def _checked(self, points: Points, load: Rectangles) -> PointCache:
        known = self._point_caches.of(points)
        if len(load) and load is not self._sound:
            require_on_surface(self.body, load, half_space=self._subtracted)
            self._sound = load
        return known

    def _field(self, load: Rectangles) -> Floats:
        """Return the nodal field (N, 3) for E = 1 MPa: the correction, or everything with the
        direct method."""
        parts = (load.centre_mm, load.frames, load.half_mm, load.force_n)
        key = tuple(part.tobytes() for part in parts)
        if key not in self._fields:
            while len(self._fields) >= REMEMBERED:
                self._fields.pop(next(iter(self._fields)))
            self._fields[key] = cached_field(
                field_key(self.system, self.body, *parts, np.array(self._subtracted)),
                lambda: self._solve(load),
                self.mesh.points.shape,
            )
        return self._fields[key]

    def _solve(self, load: Rectangles) -> Floats:
        if self._subtracted:
            return correction(self.system, self.body, [load])[:, :, 0]
        return _direct_fields(self.system, self.body, self._locator, [load])[:, :, 0]


PIECE_MM, MOST_PIECES = 0.5, 60
"""Largest distance of the points at which a rectangle acts, and most of them along one side."""


def _direct_fields(
    system: TaylorHood, body: Body, locator: Locator, loads: Sequence[Rectangles]
) -> Floats:
    """Return (N, 3, m) displacement fields in mm for E = 1 MPa under m loads, without a half-space:
    for soft covers, and as an independent check, of loads wider than the mesh's faces. Each
    rectangle acts at a grid of points, moved onto the surface; totals are kept. `InputError` where
    a load misses the surface."""
    forces = [_consistent_forces(body, system.mesh, locator, load) for load in loads]
    return system.solve(np.stack(forces, axis=2))


def _consistent_forces(body: Body, mesh: Mesh, locator: Locator, load: Rectangles) -> Floats:
    """Return the (N, 3) nodal forces, N, that do the same work as ``load`` on the elements'
    fields."""
    points, forces = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for centre, frame, half, force in zip(
        load.centre_mm, load.frames, load.half_mm, load.force_n, strict=True
    ):
        counts = np.clip(np.ceil(2.0 * half / PIECE_MM), 1, MOST_PIECES)
        sides = [(np.arange(n) + 0.5) / n * 2.0 * h - h for n, h in zip(counts, half, strict=True)]
        offsets = grid_points(*sides)
        points.append(centre + offsets @ frame[:2])
        forces.append(np.tile(force / len(offsets), (len(offsets), 1)))
    places = np.concatenate(points)
    places = places - body.depth(places)[:, None] * body.piece_normals(places)[:, 0]
    spread = locator.locate(places).matrix(len(mesh.points))
    nodal = np.asarray(spread.T @ np.concatenate(forces))
    total, wanted = nodal.sum(axis=0), load.force_n.sum(axis=0)
    if not np.allclose(total, wanted, rtol=1e-9, atol=1e-9 * float(np.abs(load.force_n).sum())):
        raise InputError(
            f"the load puts {total} N on the mesh, wanted are {wanted} N: it misses the surface"
        )
    return nodal


def _region(system: TaylorHood, body: Body, rectangles: Rectangles, near: bool) -> Region:
    """Return a region around rectangles that lie near each other; else, or where it would run over
    the end of the surface, one within them."""
    if near:
        with contextlib.suppress(InputError):
            return Region(system, body, rectangles)
    return EdgeRegion(system, body, rectangles)


def _largest(moved: Points) -> float:
    """Return the largest of the lengths of (n, 3) displacements, mm."""
    return float(np.linalg.norm(moved, axis=1).max())
