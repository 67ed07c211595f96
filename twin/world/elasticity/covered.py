"""Compliance of a body under a cover of another modulus: a mesh of its own for every region that is pressed.

Why not one mesh: the half-space of the cover is right only above the interface. What is left of the field is as steep
there as the load itself, so elements must be about as small as the load, under the load. They are made by halving the
edges of the body's mesh (`twin.world.mesh.bisection`) and growing the cover on it (`twin.world.mesh.extrude`).

Under a cover stiffer than the body the half-space is subtracted: it bears what happens within the cover, whatever the
load's size. Under a softer one it is many times larger than the answer and its rest must cancel it, so plain
Taylor-Hood is better: measured, with a tenth of the body's modulus, 0.2 to 0.9 % instead of 1.7 to 8 %.

The error of an answer is estimated from its difference to that of another mesh, `COARSER` times as coarse under the
load and made from a coarser mesh of the body. Nothing is known of it before.

Validity: bumps 2 to 4 mm wide are 0.3 to 2 % off below covers of a tenth and of ten times the body's modulus, and on
the surface of stiffer ones; the surface of softer ones is up to 4 % off sideways and up to 18 % along the normal, as
the estimate says. Contact needs a solve for every patch: a press with 8 patches across takes a
minute of processor time, one with more grows with the square of their number.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from twin.arrays import Floats, Points
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.material import Cover, Material
from twin.progress import Progress
from twin.world.elasticity.compliance import Compliance, Method
from twin.world.elasticity.expected import unbounded
from twin.world.elasticity.fem import Layer, TaylorHood
from twin.world.elasticity.known import Known
from twin.world.elasticity.spread import patch_rests
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.extrude import with_cover
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.rim import drawn_to_rim
from twin.world.mesh.sizing import WORLD, Level

FINE = 0.6
"""Longest edge under a load over the load's radius plus the cover's thickness."""

GROWTH = 1.5
"""Growth of the longest edge with distance from the load."""

ACROSS = 3.0
"""Elements across the radius of a region of many patches, at most: finer ones would cost too much."""

ROOM = 1.5
"""How much larger than the load the region is whose mesh is made: the next load is often near."""

MANY = 20
"""Patches beyond which a solve for each of them is worth a word."""

COARSER = 1.5
"""Edges under a load in the mesh by whose answer the error is estimated, over those of the mesh that answers."""

STIFF_TRUST, SOFT_TRUST = 0.75, 0.55
"""Share of the two meshes' difference that is taken for the error, under covers stiffer and softer than the body."""

UNSEEN = 2e-3
"""Error that the two meshes share: both are halved in the same way, and both take the cover for one layer of prisms."""


def own_layer(material: Material, cover: Cover | None) -> Layer | None:
    """Return what a cover is made of where that is not what the body is made of, else None."""
    if cover is None:
        return None
    modulus = material.youngs_modulus_mpa if cover.youngs_modulus_mpa is None else cover.youngs_modulus_mpa
    nu = material.poisson_ratio if cover.poisson_ratio is None else cover.poisson_ratio
    same = modulus == material.youngs_modulus_mpa and nu == material.poisson_ratio
    return None if same else Layer(modulus_ratio=modulus / material.youngs_modulus_mpa, poisson_ratio=nu)


class Patch(Compliance):
    """The compliance of a covered body whose mesh is fine in one place.

    Parameters
    ----------
    body, material
        The body, cover included, and what its inside is made of.
    mesh, layer
        Mesh with the cover as region 1, and what that is made of.
    """

    def __init__(self, body: Body, material: Material, mesh: Mesh, layer: Layer) -> None:
        method: Method = "subtracted" if layer.modulus_ratio >= 1.0 else "direct"
        super().__init__(body, material, mesh, method=method, table=False)
        self._layer = layer

    @cached_property
    def system(self) -> TaylorHood:
        """The elastic system, factored at its first solve."""
        held = self.mesh.nodes_on(self.body.held_pieces)
        return TaylorHood(self.mesh, self.material.poisson_ratio, self._solver, held=held, layers=[self._layer])

    @property
    def _rubber(self) -> tuple[float, float]:
        return self._layer.modulus_ratio * self._modulus, self._layer.poisson_ratio

    def _solved_rests(self, known: Known, rectangles: Rectangles, reused: bool) -> Floats:
        """Return (n, 3, k, 3) patch by patch: near a patch its rest is too steep to be interpolated between patches."""
        return patch_rests(self.system, self.body, known.placed(self._locator), rectangles)


class Covered:
    """The elastic response of a body under a cover of another modulus; its methods are those of `Compliance`.

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
    """Closed forms of a half-space don't tell how large a contact on it is: see `SurfaceCompliance`."""

    def __init__(
        self,
        body: Body,
        material: Material,
        thickness_mm: float,
        layer: Layer,
        *,
        level: Level = "coarse",
        fine: float = FINE,
        progress: Progress | None = None,
    ) -> None:
        self.body, self.material, self.thickness_mm, self.layer = body, material, thickness_mm, layer
        self._level: Level = level
        self._fine = fine
        self._progress = progress
        self._patches: list[tuple[Points, float, float, Patch]] = []

    @cached_property
    def coarser(self) -> Covered:
        """The same on coarser meshes, by whose answer the error is estimated."""
        rank = WORLD.index("coarse" if self._level == "nominal" else self._level)
        return Covered(
            self.body,
            self.material,
            self.thickness_mm,
            self.layer,
            level=WORLD[max(rank - 1, 0)],
            fine=COARSER * self._fine,
            progress=self._progress,
        )

    def patch(self, load: Rectangles, *, each: bool = False) -> Patch:
        """Return the compliance whose mesh is fine under ``load``: one made before, or a new one.

        Fine enough for all rectangles together, or for ``each`` of them as far as `ACROSS` allows.
        """
        low, high = load.centre_mm.min(axis=0), load.centre_mm.max(axis=0)
        centre = (low + high) / 2.0
        reach = np.linalg.norm(load.centre_mm - centre, axis=1) + np.linalg.norm(load.half_mm, axis=1)
        radius = float(reach.max())
        room, size = ROOM * radius, radius
        if each:
            size = float(np.linalg.norm(load.half_mm, axis=1).mean())
        edge = max(self._fine * (size + self.thickness_mm), room / ACROSS if each else 0.0)
        for other, space, finest, made in self._patches:
            if np.linalg.norm(centre - other) + radius <= space and finest <= 1.4 * edge:
                return made
        bare = body_mesh(self.body, self._level, progress=self._progress)
        fine = refined(
            bare,
            self.body,
            lambda points: edge + GROWTH * np.maximum(np.linalg.norm(points - centre, axis=1) - room, 0.0),
        )
        mesh = drawn_to_rim(with_cover(fine, self.body, self.thickness_mm), self.body)
        self._patches.append((centre, room, edge, Patch(self.body, self.material, mesh, self.layer)))
        return self._patches[-1][3]

    def displacement(self, points: Points, load: Rectangles) -> Points:
        """See `Compliance.displacement`."""
        return self.patch(load).displacement(points, load) if len(load) else np.zeros((len(points), 3))

    def answer(self, points: Points, load: Rectangles) -> tuple[Points, float]:
        """Return `displacement`, and its estimated largest error over the largest displacement; raises like it.

        A share of the difference to the answer of `coarser`, plus `UNSEEN`: against the layered half-space and an
        independent code one to four times the true error (`tests/world/elasticity/test_covered.py`).
        """
        moved = self.displacement(points, load)
        size = np.linalg.norm(moved, axis=1).max(initial=0.0)
        if size == 0.0:
            return moved, 0.0
        differ = np.linalg.norm(moved - self.coarser.displacement(points, load), axis=1).max()
        trust = STIFF_TRUST if self.layer.modulus_ratio >= 1.0 else SOFT_TRUST
        return moved, float(trust * differ / size) + UNSEEN + unbounded(self.body, load)

    def forget(self) -> None:
        """Forget the meshes of the places pressed so far."""
        self._patches.clear()
        if "coarser" in self.__dict__:
            self.coarser.forget()

    def gradient(self, points: Points, load: Rectangles) -> Floats:
        """See `Compliance.gradient`; within the cover and outside it, not across."""
        return self.patch(load).gradient(points, load) if len(load) else np.zeros((len(points), 3, 3))

    def to_points(self, points: Points, rectangles: Rectangles) -> Floats:
        """See `Compliance.to_points`."""
        if self._progress and len(rectangles) > MANY:
            self._progress(f"compliance of {len(rectangles)} patches on the cover, one by one: minutes", 0.0)
        return self.patch(rectangles, each=True).to_points(points, rectangles)

    def surface(self, rectangles: Rectangles) -> Floats:
        """See `Compliance.surface`."""
        return self.patch(rectangles, each=True).surface(rectangles)
