"""A whole body of rubber on a coarse mesh, pressed by rigid probes without friction: linear or at
finite strain.

**Rubber.** Quadratic displacement and linear pressure on tetrahedra; the stress is a
`twin.world.elasticity.strain_law.StrainLaw`, whose tangent at rest is linear theory.

**Contact.** Pressures at the integration points of the surface; g is a point's gap to the probe.

    pressure = -k g > 0, or pressure = 0 and g > 0;  the forces along each probe's way sum to the
    given one.

In the linear answer g is measured at the undeformed place along the surface's normal, where the
force acts, too, as `twin.world.contact.pressing` does. In the other one it is measured at the
deformed place, along the probe's way, with forces along the probe's normal. The springs k are a
film of rubber 10 um thick on the probe, in both answers: stiffer ones make the pressures of
neighbouring points alternate, and double the error that the mesh leaves. The probes' places are
unknowns.

**Steps.** `pressed_further` takes Newton's, with an active set of points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import NotSettled
from twin.parts.body import Body
from twin.parts.material import Material
from twin.world.contact.probe_gap import MOTIONS, Approach, Z
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.mixed_rubber import MixedRubber, gathered, summed
from twin.world.elasticity.strain_law import cofactor_slope, cofactors
from twin.world.mesh.elements import (
    inverses,
    tet_quadrature,
    tet_shapes,
    triangle_quadrature,
    triangle_shapes,
)
from twin.world.mesh.quadratic_mesh import Mesh

_SPRING = 100.0
_GAP_WEIGHT = 2.0
"""Pressure per overlap, and what a pressure is weighed against a gap with, over Young's modulus,
1/mm."""

_CHUNK = 256
"""Elements whose slopes are computed at once."""

_NUDGE_MM = 1e-4

_STEEPEST = 0.05
"""A probe's surface whose normal has a smaller part along its way doesn't touch."""

_KRYLOV = 20
_KRYLOV_RESIDUALS = 1e-3, 1e-2
"""Most iterations with a kept factor, and the relative residuals at which they end: of the forces
out of balance, and of those that follow the probe."""

_STRAINED = 0.03
"""Elements with no larger change of F, or pressure over the shear modulus, resist as at rest as far
as the slopes of Newton's steps go."""


class Rubber(MixedRubber):
    """Rubber of E = 1 MPa in the shape of a mesh, held on the body's held pieces.

    Its unknowns are three displacements of every node, mm, then the pressures of the corners, MPa.
    """

    _axes = 3
    _residual = 1e-6

    def __init__(self, mesh: Mesh, body: Body, material: Material) -> None:
        super().__init__(material)
        self._factors: dict[bool, Factor] = {}
        self.mesh = mesh
        places, weights = tet_quadrature()
        slopes = tet_shapes(places)[1]
        self._shares = np.column_stack([1.0 - places.sum(axis=1), places])
        jacobian = np.einsum("mai,qaj->mqij", mesh.points[mesh.tets], slopes, optimize=True)
        inverse, determinant = inverses(jacobian)
        self._volume = determinant * weights
        self._slopes = slopes @ inverse
        self._moves = 3 * len(mesh.points)
        self.size = self._moves + mesh.corners
        moved = (3 * mesh.tets[:, :, None] + np.arange(3)).reshape(-1, 30)
        self._row = np.hstack([moved, self._moves + mesh.tets[:, :4]])
        held = np.zeros(self.size, bool)
        held[: self._moves] = np.repeat(mesh.nodes_on(body.held_pieces), 3)
        self._free = np.flatnonzero(~held)
        tenth = np.repeat(self._volume.sum(axis=1) / 20.0 / self._shear, 4)
        self._scale = gathered(self._row[:, 30:], tenth, self.size)
        nodes = np.arange(len(mesh.points))
        self._node = np.concatenate([np.repeat(nodes, 3), nodes[: mesh.corners]])

    def followed(self, matrix: Any, right: Floats, *, linear: bool) -> Floats:
        """Return the solution (n, 1 + p) of a tangent for what is out of balance and for what
        follows every probe; 0 where it is held.

        The last factor, one of linear theory and one at finite strain, is kept as the
        preconditioner of GMRES. Where that needs too many iterations, the matrix is factored.
        """
        free = self._free
        own = matrix[free][:, free]
        out = np.zeros_like(right)
        kept = self._factors.get(linear)
        found = None
        if kept is not None:
            balance, follow = _KRYLOV_RESIDUALS
            residuals = balance, *[follow] * (right.shape[1] - 1)
            found = kept.solve_near(own, right[free], residuals, _KRYLOV)
        if found is None:
            factor = Factor(own, self._scale[free], node=self._node[free])
            self._factors[linear] = factor
            found = factor.solve(right[free], self._residual)
        out[free] = found
        return out

    def _strained(self, unknowns: Floats, some: Ints) -> tuple[Floats, Floats, Floats, Floats]:
        """Return F, cof F, J and the pressure at the integration points of some elements."""
        own = unknowns[self._row[some]]
        moved = own[:, None, :30].reshape(-1, 1, 10, 3)
        gradient = moved.swapaxes(2, 3) @ self._slopes[some] + np.eye(3)
        return gradient, *cofactors(gradient), own[:, 30:] @ self._shares.T

    def resistance(self, unknowns: Floats) -> Floats:
        """Return the forces with which the rubber resists, and what is amiss with its volume."""
        every = np.arange(len(self._row))
        gradient, cofactor, ratio, pressure = self._strained(unknowns, every)
        stress = self._shear * self._law.stress(gradient, cofactor, ratio)
        stress += pressure[..., None, None] * cofactor
        stress *= self._volume[..., None, None]
        force = (self._slopes @ stress.swapaxes(2, 3)).sum(axis=1).reshape(-1, 30)
        swollen = ((ratio - 1.0 - self._softness * pressure) * self._volume) @ self._shares
        both = np.hstack([force, swollen])
        return gathered(self._row, both, self.size)

    @cached_property
    def _rest_blocks(self) -> Floats:
        return self._blocks(np.zeros(self.size), np.arange(len(self._row)))

    def tangent(self, unknowns: Floats) -> Any:
        """Return the sparse symmetric slope of `resistance`; that at rest where the strain is
        small."""
        gradient, _, _, pressure = self._strained(unknowns, np.arange(len(self._row)))
        change = np.abs(gradient - np.eye(3)).max(axis=(1, 2, 3))
        change = np.maximum(change, np.abs(pressure).max(axis=1) / self._shear)
        strained = np.flatnonzero(change > _STRAINED)
        blocks = self._rest_blocks.copy()
        blocks[strained] = self._blocks(unknowns, strained)
        return summed(blocks, self._row, self.size)

    def _blocks(self, unknowns: Floats, some: Ints) -> Floats:
        """Return the slopes (m, 34, 34) of some elements (m,)."""
        block = np.empty((len(some), 34, 34))
        for start in range(0, len(some), _CHUNK):
            part = slice(start, start + _CHUNK)
            block[part] = self._chunk_blocks(unknowns, some[part])
        return block

    def _chunk_blocks(self, unknowns: Floats, some: Ints) -> Floats:
        """Return the slopes (m, 34, 34) of some elements."""
        gradient, cofactor, ratio, pressure = self._strained(unknowns, some)
        volume = self._volume[some]
        slopes = self._slopes[some]
        count, places = volume.shape
        cofactor_change = cofactor_slope(gradient)
        slope = self._shear * self._law.slope(gradient, cofactor, ratio, cofactor_change)
        slope += pressure[..., None, None, None, None] * cofactor_change
        slope *= volume[..., None, None, None, None]
        # d P_ik / d F_jl between the shapes a and b: first a's slope along k, then b's along l
        turned = slope.transpose(0, 1, 3, 2, 4, 5).reshape(count, places, 3, 27)
        half = (slopes @ turned).reshape(count, places, 90, 3).transpose(0, 2, 1, 3)
        along = slopes.transpose(0, 1, 3, 2).reshape(count, places * 3, 10)
        stiff = (half.reshape(count, 90, places * 3) @ along).reshape(count, 10, 3, 3, 10)
        block = np.empty((count, 34, 34))
        block[:, :30, :30] = stiff.transpose(0, 1, 2, 4, 3).reshape(count, 30, 30)
        weighted = volume[..., None] * self._shares
        swelling = (slopes @ cofactor.swapaxes(2, 3)).reshape(count, places, 30)
        by_volume = swelling.swapaxes(1, 2) @ weighted
        block[:, :30, 30:] = by_volume
        block[:, 30:, :30] = by_volume.swapaxes(1, 2)
        block[:, 30:, 30:] = -self._softness * (self._shares.T @ weighted)
        return block


class SurfaceTouch:
    """The integration points (q,) of the sensing surface that a probe may touch.

    Parameters
    ----------
    mesh, body
        The body and its mesh.
    approach
        The probe at first touch; ``lift`` (q,) is the force along its way per pressure.
    aside_mm
        (2,) how far it has moved since, along its own x and y.
    centre, reach_mm
        (3,) and mm: faces with points so near to the centre may touch.
    """

    def __init__(
        self,
        mesh: Mesh,
        body: Body,
        approach: Approach,
        aside_mm: Floats,
        centre: Floats,
        reach_mm: float,
    ) -> None:
        faces = mesh.faces[mesh.piece == 0]
        places, share = triangle_quadrature()
        values, slopes = triangle_shapes(places)
        corner = mesh.points[faces]
        points = np.einsum("qa,fai->fqi", values, corner)
        near = np.linalg.norm(points - centre, axis=2).min(axis=1) <= reach_mm
        along = np.einsum("qaj,fai->fqji", slopes, corner[near])
        area = np.linalg.norm(np.cross(along[:, :, 0], along[:, :, 1]), axis=2) * share
        self.rest_mm = points[near].reshape(-1, 3)
        self.area_mm2 = area.ravel()
        self.nodes = np.repeat(faces[near], len(places), axis=0)
        self.weights = np.tile(values, (int(near.sum()), 1))
        self.inward = body.piece_normals(self.rest_mm)[:, 0]
        self._approach = approach
        self.lift = self.inward @ approach.axes[Z]
        self._aside = aside_mm

    def gaps(
        self, displacement: Floats, deep: float, *, linear: bool
    ) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return the gaps of the points under a probe so deep.

        Returns
        -------
        gap
            (q,) mm; inf where the probe can't be met.
        push
            (q, 3) its slope by the points' places: the direction of the force per pressure.
        bend
            (q, 3, 3) the slope of ``push`` by the points' places, 1/mm.
        per_depth
            (q,) the gap's slope by the probe's depth.
        lift
            (q,) the force along the probe's way per pressure.
        """
        shift = np.einsum("qa,qai->qi", self.weights, displacement[self.nodes])
        axes = self._approach.axes
        none = np.zeros((len(shift), 3, 3))
        if linear:
            pose = np.zeros(MOTIONS)
            pose[:Z] = self._aside
            pose[Z] = deep
            gap, slope = self._approach.gap(self.rest_mm, self.inward, pose)
            gap = gap + np.einsum("qi,qi->q", self.inward, shift)
            return gap, self.inward, none, slope[:, Z], self.lift
        own = (self.rest_mm + shift - self._approach.axis_mm) @ axes.T
        own = own - np.array([*self._aside, deep])
        upright = np.broadcast_to([0.0, 0.0, 1.0], own.shape)

        def met(points: Points) -> tuple[Floats, Floats]:
            gap, normal = self._approach.shape.met(points, upright)
            gap = np.where(normal[:, Z] > _STEEPEST, gap, np.inf)
            return gap, normal / np.maximum(normal[:, Z:], _STEEPEST)

        gap, push = met(own)
        for axis in range(Z):
            nudge = _NUDGE_MM * np.eye(3)[axis]
            (above, more), (below, less) = met(own + nudge), met(own - nudge)
            sound = np.isfinite(gap) & np.isfinite(above) & np.isfinite(below)
            none[sound, :, axis] = ((more - less) / (2.0 * _NUDGE_MM))[sound]
        bend = axes.T @ none @ axes
        return gap, push @ axes, bend, np.full(len(gap), -1.0), np.ones(len(gap))

    def spread_mm(self, pressure: Floats) -> float:
        """Return the root mean square distance of the pressure from its middle, mm."""
        force = pressure * self.area_mm2
        middle = force @ self.rest_mm / force.sum()
        return float(np.sqrt(force @ ((self.rest_mm - middle) ** 2).sum(axis=1) / force.sum()))


@dataclass(frozen=True)
class Equilibrated:
    """A state: the rubber's unknowns, the (p,) probes' depths, mm, and of the points (q,) that may
    touch, those of one probe after the other, the pressures over Young's modulus, and whether they
    were sought."""

    unknowns: Floats
    deep: Floats
    pressure: Floats
    active: Bools


def rows_of(touches: Sequence[SurfaceTouch]) -> list[slice]:
    """Return where the points of each probe are among those of all."""
    ends = np.cumsum([0, *(len(touch.rest_mm) for touch in touches)])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def pressed_further(
    rubber: Rubber,
    touches: Sequence[SurfaceTouch],
    state: Equilibrated,
    force: Floats,
    *,
    linear: bool,
) -> Equilibrated:
    """Return the state after one Newton step of rubber, probes and pressures together.

    ``force`` (p,) are those along the probes' ways over Young's modulus, mm2.
    """
    # Which points touch?
    moved = rubber.displacement(state.unknowns)
    near = [
        touch.gaps(moved, float(deep), linear=linear)
        for touch, deep in zip(touches, state.deep, strict=True)
    ]
    gap, push, bend, per_depth, lift = (np.concatenate(part) for part in zip(*near, strict=True))
    weighed = state.pressure - _GAP_WEIGHT * (gap + state.pressure / _SPRING)
    active = weighed > 0.0 if state.pressure.any() else state.active
    active = active & np.isfinite(gap)
    if not all(active[rows].any() for rows in rows_of(touches)):
        raise NotSettled("contact: at finite strain the probe touches nothing: press further")
    on = np.flatnonzero(active)
    gap, push, per_depth, lift = gap[on], push[on], per_depth[on], lift[on]
    weight = np.concatenate([touch.weights for touch in touches])[on]
    area = np.concatenate([touch.area_mm2 for touch in touches])[on]
    nodes = np.concatenate([touch.nodes for touch in touches])[on]
    row = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(on), 18)
    owner = np.repeat(np.arange(len(touches)), [len(touch.rest_mm) for touch in touches])[on]
    own_probe = (owner[:, None] == np.arange(len(touches))).astype(float)

    def nodal(forces: Floats) -> Floats:
        spread = np.einsum("qa,qi->qai", weight, forces)
        return np.bincount(row.ravel(), spread.ravel(), rubber.size).astype(float)

    # Rubber on springs, once under what is out of balance and once per depth of every probe.
    spring = _SPRING * push[:, :, None] * push[:, None, :]
    spring -= state.pressure[on, None, None] * bend[on]
    spring *= area[:, None, None]
    block = np.einsum("qa,qb,qij->qaibj", weight, weight, spring).reshape(len(on), 18, 18)
    tangent = rubber.at_rest if linear else rubber.tangent(state.unknowns)
    right = -(tangent @ state.unknowns) if linear else -rubber.resistance(state.unknowns)
    own = right + nodal(-(_SPRING * area * gap)[:, None] * push)
    follow = [nodal(-(_SPRING * area * per_depth * one)[:, None] * push) for one in own_probe.T]
    springs = summed(block, row, rubber.size)
    found = rubber.followed(tangent + springs, np.column_stack([own, *follow]), linear=linear)

    # The probes move until the pressures carry the forces.
    def closed(step: Floats) -> Floats:
        return np.asarray(np.einsum("qi,qa,qai->q", push, weight, rubber.displacement(step)[nodes]))

    still = -_SPRING * (gap + closed(found[:, 0]))
    by_probe = np.column_stack([closed(one) for one in found[:, 1:].T])
    per_motion = -_SPRING * (per_depth[:, None] * own_probe + by_probe)
    carried = (area * lift)[:, None] * own_probe
    motion = np.linalg.solve(carried.T @ per_motion, force - carried.T @ still)
    pressure = np.zeros(len(active))
    pressure[on] = still + per_motion @ motion
    unknowns = state.unknowns + found[:, 0] + found[:, 1:] @ motion
    return Equilibrated(unknowns, state.deep + motion, pressure, active)
