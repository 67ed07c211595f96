"""Compliance: how far every point of a body moves under forces on its surface. The central noun of the world.

A body is factored once, at the first load that needs it; every further press, marker layout or calibration is a
product. The default method is the half-space field of the load in closed form plus the smooth rest of the finite body
(`twin.world.elasticity.correction`); ``direct`` is plain Taylor-Hood, kept as an independent check.

Errors are told twice: `Compliance.expected_error` before anything is solved, from the load's place, which is what a
mesh is chosen by (`twin.world.elasticity.ladder`); and `Compliance.error_estimate` afterwards, from the difference to
another level's answer.

Validity: linear elasticity, small strain, quasi-static. The rest is smooth on the scale of the mesh; loads nearer to
a free edge than an element are less accurate, which both say. Within a tenth of the body's height of a held face there
is no bound, and both say that by an error of one and more.
"""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import Literal

import numpy as np

from twin.arrays import Floats, Points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.progress import Progress
from twin.theory import halfspace
from twin.theory.halfspace_normal import normal_compliance
from twin.world.elasticity.correction import correction
from twin.world.elasticity.direct import consistent_forces, direct_columns
from twin.world.elasticity.expected import DIRECT, EXPECTED, estimated_error, expected_error, finest_error, unbounded
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.half_space import require_half_space
from twin.world.elasticity.known import REMEMBERED, Known, Memory
from twin.world.elasticity.solve import Solver
from twin.world.elasticity.spread import Readings, Region, patch_rests, worth_a_region
from twin.world.elasticity.store import field_key, kept
from twin.world.elasticity.surface_table import KEPT_POINTS, SHARE, SurfaceTable
from twin.world.elasticity.symmetric import make_symmetric
from twin.world.elasticity.table import Basis, Table, TableAtNu
from twin.world.elasticity.tables import Tables
from twin.world.elasticity.tabulate import table_level
from twin.world.elasticity.tile import require_on_surface
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.recovery import Recovery
from twin.world.mesh.rim import drawn_to_rim
from twin.world.mesh.sizing import Level

Method = Literal["subtracted", "direct"]

FEW = 3
"""Points are read by adjoint solves where patches are more than this many times as many."""


class Compliance:
    """The elastic response of one body.

    Parameters
    ----------
    body, material
        What it is. Young's modulus only scales the answer.
    mesh
        Its mesh; the one of ``level`` is read or made when it is first needed if not given.
    level
        See `twin.world.mesh.sizing.Level`: truth and sensor never share one.
    method
        ``subtracted`` or ``direct``.
    solver
        See `twin.world.elasticity.solve.Factor`.
    table
        Whether a table of the body, shipped or cached, may replace solves; a given mesh has none. Or the table to use.
    surface_table
        Whether to make, and keep, a `SurfaceTable` of a curved body, at its first load: a minute or two, for many.
    progress
        Told when a mesh or a table of the surface has to be made.
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
        solver: Solver = "auto",
        table: bool | Table = True,
        surface_table: bool = False,
        progress: Progress | None = None,
    ) -> None:
        self.body = body
        self.material = material
        self.level: Level = level
        self.method: Method = method
        self.asymmetry = 0.0
        self._given_mesh = mesh
        self._progress = progress
        self._solver: Solver = solver
        self._use_surface = surface_table
        self._fields: dict[str, Floats] = {}
        self._memory = Memory(body)
        self._sound: Rectangles | None = None
        self._region: Region | None = None
        self._tables = Tables(
            body,
            material.poisson_ratio,
            nominal=level == "nominal",
            use=table if mesh is None and method == "subtracted" else False,
            solver=solver,
            progress=progress,
        )

    @cached_property
    def mesh(self) -> Mesh:
        """The mesh of the rest: as given, or the level's with its elements at the clamped rim drawn to it."""
        if self._given_mesh is not None:
            return self._given_mesh
        made = body_mesh(self.body, self.level, progress=self._progress)
        return drawn_to_rim(made, self.body)

    @cached_property
    def system(self) -> TaylorHood:
        """The elastic system, factored at its first solve."""
        held = self.mesh.nodes_on(self.body.held_pieces)
        return TaylorHood(self.mesh, self.material.poisson_ratio, self._solver, held=held)

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.mesh)

    @cached_property
    def _recovery(self) -> Recovery:
        return Recovery(self.mesh)

    @cached_property
    def _surface_table(self) -> SurfaceTable | None:
        if not self._use_surface or self.body.is_flat or self._given_mesh is not None or not self._subtracted:
            return None
        return SurfaceTable(self.system, self.body, self._progress)

    def _surface_for(self, load: Rectangles) -> SurfaceTable | None:
        table = self._surface_table
        return table if table is not None and table.covers(load) and table.pushes(load) else None

    def make_table(self) -> None:
        """Make, and keep in the cache, the tables of a block that has none: some seconds for all loads ever after."""
        self._tables.make()

    @cached_property
    def compared(self) -> Compliance | None:
        """The same body on the level by whose answer the error is estimated; None where the mesh was given."""
        if self._given_mesh is not None:
            return None
        return Compliance(
            self.body,
            self.material,
            level=EXPECTED[self.body.is_flat, self.level].against,
            method=self.method,
            solver=self._solver,
            table=False,
            surface_table=self._use_surface,
            progress=self._progress,
        )

    def displacement(self, points: Points, load: Rectangles) -> Points:
        """Return the (n, 3) displacement in mm of ``points`` (n, 3) in the body under ``load``.

        Raises
        ------
        OutOfBodyError
            A point is outside the body.
        InputError
            A rectangle is not on the sensing surface or hangs over its end, or its force is not finite.
        SolveError
            See `twin.world.elasticity.solve.Factor.solve`.
        """
        known = self._checked(points, load)
        if len(known) == 0 or not np.any(load.force_n):
            return np.zeros_like(known.points)
        return self._whole(known, load, self._rest(known, load, self._tables.covering(known, load))[0])

    def _whole(self, known: Known, load: Rectangles, rest: Points) -> Points:
        return rest + halfspace.displacement(known.points, load, *self._rubber) if self._subtracted else rest

    def _rest(self, known: Known, load: Rectangles, table: TableAtNu | None) -> tuple[Points, float]:
        """Return (n, 3) what the half-space lacks, everything with the direct method; and interpolation's error, mm."""
        if table:
            return table.displacement(known.basis(table.box_mm), load) / self._modulus, 0.0
        if surface := self._surface_for(load):
            rest, lost = self._interpolated(surface, known, load)
            return rest / self._modulus, lost / self._modulus
        return known.placed(self._locator).values(self._field(load)) / self._modulus, 0.0

    def _interpolated(self, surface: SurfaceTable, known: Known, load: Rectangles) -> tuple[Points, float]:
        """Return the rest (n, 3) for E = 1 MPa, and the largest error of interpolation, mm."""
        places = known.placed(self._locator)
        if len(known) > KEPT_POINTS:
            rest, every_other = (places.values(surface.field(load, step)) for step in (1, 2))
            return rest, SHARE * _largest(rest - every_other)
        if known.reading is None:
            known.reading = surface.reading(places)
        return surface.displacement(known.reading, load)

    def gradient(self, points: Points, load: Rectangles) -> Floats:
        """Return (n, 3, 3) du_i/dx_j at ``points`` (n, 3): strain and turn. Raises like `displacement`."""
        known = self._checked(points, load)
        if len(known) == 0 or not np.any(load.force_n):
            return np.zeros((len(known), 3, 3))
        if table := self._tables.covering(known, load):
            rest = table.gradient(known.basis(table.box_mm), load)
        elif surface := self._surface_for(load):
            if len(known) > KEPT_POINTS:
                rest = known.placed(self._locator).gradients(surface.field(load))
            else:
                if known.slopes is None:
                    known.slopes = surface.slopes(known.placed(self._locator))
                rest = surface.gradient(known.slopes, load)
        else:
            rest = known.placed(self._locator).gradients(self._field(load))
        rest = rest / self._modulus
        return rest + halfspace.gradient(known.points, load, *self._rubber) if self._subtracted else rest

    def to_points(self, points: Points, rectangles: Rectangles, *, reused: bool = False) -> Floats:
        """Return the (3 n, 3 k) displacement in mm/N of ``points`` (n, 3) per unit global force on each rectangle.

        The rectangles' own ``force_n`` is ignored. With ``reused`` more patches in the same place will follow. Raises
        like `displacement`.
        """
        known = self._checked(points, rectangles)
        shape = (3 * len(known), 3 * len(rectangles))
        if 0 in shape:
            return np.zeros(shape)
        if not self._subtracted:
            fields = direct_columns(self.system, self.body, self._locator, rectangles)
            return (known.placed(self._locator).values(fields) / self._modulus).reshape(shape)
        if worth_a_region(rectangles, reused=reused):
            self.make_table()
        if table := self._tables.covering(known, rectangles):
            rest = table.rests(known.basis(table.box_mm), rectangles).reshape(shape)
        else:
            rest = self._solved_rests(known, rectangles, reused).reshape(shape)
        whole = halfspace.compliance(known.points, rectangles, *self._rubber)
        rest /= self._modulus
        whole += rest
        return whole

    def _solved_rests(self, known: Known, rectangles: Rectangles, reused: bool) -> Floats:
        """Return (n, 3, k, 3) by the fewest solves: a region for patches close together, else by patch or by point."""
        places = known.placed(self._locator)
        if self._surface_table is not None and self._surface_table.covers(rectangles):
            return self._surface_table.rests(places, rectangles)
        if worth_a_region(rectangles, reused=reused):
            if self._region is not None and self._region.covers(rectangles):
                return self._region.rests(places, rectangles)
            try:
                self._region = Region(self.system, self.body, rectangles)
                return self._region.rests(places, rectangles)
            except InputError:  # so near to the end of the surface that the region would run over it
                pass
        if FEW * len(known) >= len(rectangles):  # fields, unlike readings, serve points that move
            return patch_rests(self.system, self.body, places, rectangles)
        if known.readings is None:
            self._memory.forget_readings()
            known.readings = Readings(self.system, self.body, places)
        return known.readings.rests(rectangles)

    def surface(self, rectangles: Rectangles) -> Floats:
        """Return the symmetric (3 k, 3 k) displacement in mm/N of the rectangles' centres per unit force on each.

        Betti's theorem makes it symmetric for small patches; `asymmetry` keeps how far, relative to the largest
        entry, it was from that before it was made so. Raises like `displacement`.
        """
        matrix = self.to_points(rectangles.centre_mm, rectangles, reused=True)
        self.asymmetry = make_symmetric(matrix)
        return matrix

    def normal(self, rectangles: Rectangles) -> Floats | None:
        """Return the symmetric (k, k) normal displacements of rectangles under unit normal forces on each, mm/N.

        What `surface` says of them, alone. None where no table knows the rest there, or they lie in no one plane.
        """
        if not self._subtracted:
            return None
        if not self._tables.found and worth_a_region(rectangles, reused=True):
            self.make_table()
        table = self._tables.spanning(rectangles)
        if table is None:
            return None
        found = normal_compliance(rectangles, *self._rubber)
        if found is not None:
            rest = table.normal_rests(rectangles)
            found += (rest + rest.T) / (2.0 * self._modulus)
        return found

    def offset_part(self, points: Points, rectangle: Rectangles) -> Floats:
        """Return (3 n, 3) mm/N: the half-space field at ``points`` (n, 3) under a unit force on one rectangle."""
        return halfspace.compliance(points, rectangle, *self._rubber)

    def smooth_part(self, patches: Rectangles, nodes: Rectangles) -> Floats | None:
        """Return (3 n, 3 n) mm/N: the rest at the middles of ``nodes`` under unit forces on them.

        None where no table covers all ``patches`` and their middles, between which the nodes must lie: the rest is a
        polynomial only there.
        """
        if not self._subtracted:
            return None
        if worth_a_region(patches, reused=True):
            self.make_table()
        table = self._tables.covering(self._checked(patches.centre_mm, patches), patches)
        if table is None:
            return None
        basis = Basis(points=nodes.centre_mm, box_mm=table.box_mm)
        return table.rests(basis, nodes).reshape(3 * len(nodes), -1) / self._modulus

    def error_estimate(self, points: Points, load: Rectangles) -> float:
        """Return the estimated largest error of `displacement` at ``points`` over the largest displacement there.

        A share of the difference to another level's answer (or to the check table's), on curved bodies one of the
        difference to a smoother reading of the same field (`twin.world.mesh.recovery`), plus what neither sees
        (`twin.world.elasticity.expected`): on all reference cases the estimate is one to three times the true error.

        Validity: the law of `expected_error` where the mesh was given. Raises like `displacement`.
        """
        return self.answer(points, load)[1]

    def answer(self, points: Points, load: Rectangles, *, enough: float = 0.0) -> tuple[Points, float]:
        """Return `displacement` and its `error_estimate` together. Raises like `displacement`.

        An `expected_error` of no more than ``enough`` is told in place of the estimate, which takes another answer.
        """
        known = self._checked(points, load)
        if len(known) == 0 or not load.force_n.any():
            return np.zeros_like(known.points), 0.0
        table = self._tables.covering(known, load)
        rest, lost = self._rest(known, load, table)
        moved = self._whole(known, load, rest)
        if enough and (expected := self._expected(load, table)) <= enough:
            return moved, expected
        return moved, self._estimate(known, load, table, rest, lost, _largest(moved))

    def _estimate(
        self, known: Known, load: Rectangles, table: TableAtNu | None, rest: Points, lost: float, size: float
    ) -> float:
        """Return the error over the largest displacement, ``size``, from what `_rest` returned."""
        level = self.level
        if table:
            check = self._tables.check
            if check is None:
                return self._expected(load, table)
            level = table_level(self.body, "truth")
            other = check.displacement(known.basis(check.box_mm), load) / self._modulus
        elif self.compared is not None:
            other = self.compared._rest(self.compared._checked(known.points, load), load, None)[0]
        else:
            return self._expected(load, table)
        direct = not self._subtracted
        rough = 0.0 if table or direct or self.body.is_flat else self._rough(known, load, rest) / size
        nominal = table is not None and self.level == "nominal"
        differ = _largest(rest - other) / size
        if self.body.is_flat and level == "fine" and not nominal:
            between = self._tables.between * _largest(rest) / size if table else None
            return finest_error(differ, load, size * self._modulus, between) + unbounded(self.body, load)
        return (
            estimated_error(self.body, level, differ, load, rough=rough, nominal=nominal, direct=direct) + lost / size
        )

    def _rough(self, known: Known, load: Rectangles, rest: Points) -> float:
        """Return the largest difference of the ``rest`` (n, 3) to a smoother reading of the same field, mm."""
        smooth, surface = known.smoothed(self._recovery), self._surface_for(load)
        if surface is None:
            read = smooth.values(self._field(load))
        elif len(known) > KEPT_POINTS:
            read = smooth.values(surface.field(load))
        else:
            if known.rough_reading is None:
                known.rough_reading = surface.reading(smooth)
            read = surface.displacement(known.rough_reading, load)[0]
        return _largest(read / self._modulus - rest[known.every])

    def forget(self) -> None:
        """Forget what the last loads left behind: answers then don't depend, in last digits, on those before them."""
        self._region = None
        self._memory.forget()

    def keep(self, points: Points) -> None:
        """Expect many loads at ``points`` (n, 3): what reads them is made at the first, and outlives `forget`."""
        self._memory.keep(points)

    def expected_error(self, load: Rectangles, points: Points | None = None) -> float:
        """Return the error to be expected before anything is solved: see `twin.world.elasticity.expected`.

        At ``points`` that a table answers it is that of the mesh which the table was made of.
        """
        table = None if points is None else self._tables.covering(self._checked(points, load), load)
        return self._expected(load, table)

    def _expected(self, load: Rectangles, table: TableAtNu | None) -> float:
        if not self._subtracted:
            return DIRECT
        tabled = table is not None and self.level != "nominal"
        return expected_error(self.body, table_level(self.body, "truth") if tabled else self.level, load)

    @property
    def _subtracted(self) -> bool:
        return self.method == "subtracted"

    @property
    def _modulus(self) -> float:
        return self.material.youngs_modulus_mpa

    @property
    def _rubber(self) -> tuple[float, float]:
        return self.material.youngs_modulus_mpa, self.material.poisson_ratio

    def _checked(self, points: Points, load: Rectangles) -> Known:
        known = self._memory.of(points)
        if len(load) and load is not self._sound:
            require_on_surface(self.body, load)
            if self._subtracted:
                require_half_space(self.body, load)
            self._sound = load
        return known

    def _field(self, load: Rectangles) -> Floats:
        """Return the nodal field (N, 3) for E = 1 MPa: the rest, or everything with the direct method."""
        parts = (load.centre_mm, load.frames, load.half_mm, load.force_n)
        key = _digest(*parts)
        if key not in self._fields:
            while len(self._fields) >= REMEMBERED:
                self._fields.pop(next(iter(self._fields)))
            self._fields[key] = kept(
                field_key(self.system, self.body, *parts, np.array(self._subtracted)), lambda: self._solve(load)
            )
        return self._fields[key]

    def _solve(self, load: Rectangles) -> Floats:
        if self._subtracted:
            return correction(self.system, self.body, [load])[:, :, 0]
        forces = consistent_forces(self.body, self.mesh, self._locator, load)
        return self.system.solve(forces[:, :, None])[:, :, 0]


def _digest(*arrays: Floats) -> str:
    sha = hashlib.sha1(usedforsecurity=False)
    for array in arrays:
        sha.update(repr(array.shape).encode())
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def _largest(moved: Points) -> float:
    """Return the largest of the lengths of (n, 3) displacements, mm."""
    return float(np.linalg.norm(moved, axis=1).max())
