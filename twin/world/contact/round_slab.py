"""A coarse slab of rubber, a body of revolution, pressed by a rigid probe along its axis, without
friction: linear or at finite strain.

**Rubber.** Quadratic displacement (radial, along z) and linear pressure on rectangles; the stress
is a `twin.world.elasticity.strain_law.StrainLaw`, whose tangent at rest is linear theory.

**Contact.** Pressures at the integration points of the surface; g is a point's gap to the probe
along z.

    pressure = -k g > 0, or pressure = 0 and g > 0;  the pressures sum to the given force.

In the linear answer g is measured at the undeformed place, as `twin.world.contact.pressing` does,
in the other one at the deformed place, with forces along the probe's normal. The springs k are a
film of rubber 2 um thick on the probe, in both answers. The probe's place is an unknown.

**Steps.** `stepped` takes Newton's, with an active set of points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import NotSettled
from twin.parts.material import Material
from twin.world.contact.probe_gap import Shape, Z
from twin.world.elasticity.mixed_rubber import MixedRubber, gathered, summed
from twin.world.elasticity.strain_law import cofactor_slope, cofactors

_SPRING = 500.0
_GAP_WEIGHT = 2.0
"""Pressure per overlap, and what a pressure is weighed against a gap with, over Young's modulus,
1/mm."""

_GROWTH = 1.3
"""How much larger each element is than the last one, away from those of equal size."""

_RIM_REACH = 1.2
_ON_RIM = 3
_RIM_GROWTH = 1.5
"""Under a cylinder's rim: the reach of points that may touch over its radius, elements along the
rim, and their growth on both sides."""

GAUSS_POINTS = 3
"""Integration points on an element's side."""

_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)
"""Gauss's places and weights on an element's side, -1 to 1."""


def _shapes(place: Floats) -> tuple[Floats, Floats, Floats]:
    """Return quadratic shapes (n, 3), their slopes, and linear shapes (n, 2) at places (n,), -1 to
    1."""
    x = place
    values = np.column_stack([x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0])
    slopes = np.column_stack([x - 0.5, -2.0 * x, x + 0.5])
    return values, slopes, np.column_stack([1.0 - x, 1.0 + x]) / 2.0


@dataclass(frozen=True)
class RoundedRim:
    """A cylinder's flat face of a radius with a rounded rim: `Shape` for lines along z."""

    flat_mm: float
    edge_mm: float

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `twin.world.contact.probe_gap.Shape`."""
        r = np.hypot(points[:, 0], points[:, 1])
        over = np.maximum(r - self.flat_mm, 0.0) / self.edge_mm
        met = over < 1.0 - 1e-6
        rise = np.sqrt(1.0 - np.where(met, over, 0.0) ** 2)
        height = points[:, Z] + self.edge_mm * (1.0 - rise)
        aside = np.where(met, over, 0.0) / np.maximum(r, 1e-300)
        normal = np.column_stack([aside * points[:, 0], aside * points[:, 1], rise])
        return np.where(met, height, np.inf), np.where(met[:, None], normal, along)


@dataclass(frozen=True, eq=False)
class Grid:
    """Rectangles between ``r_mm`` (I + 1,) and ``z_mm`` (J + 1,).

    The first ``touching`` of them along r may touch the probe.
    """

    r_mm: Floats
    z_mm: Floats
    touching: int

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Nodes along r and z."""
        return 2 * len(self.r_mm) - 1, 2 * len(self.z_mm) - 1

    def read(self, points: Floats) -> tuple[Ints, Floats, Floats]:
        """Return the nodes (n, 9) of the elements at points (n, 2), their shapes (n, 9), and the
        slopes of these (n, 9, 2)."""
        node = []
        value = []
        slope = []
        for line, place in zip((self.r_mm, self.z_mm), points.T, strict=True):
            cell = np.clip(np.searchsorted(line, place, side="right") - 1, 0, len(line) - 2)
            half = (line[cell + 1] - line[cell]) / 2.0
            own = _shapes((place - line[cell]) / half - 1.0)
            node.append(2 * cell[:, None] + np.arange(3))
            value.append(own[0])
            slope.append(own[1] / half[:, None])
        across = self.shape[1]
        nodes = (node[0][:, :, None] * across + node[1][:, None, :]).reshape(-1, 9)
        values = (value[0][:, :, None] * value[1][:, None, :]).reshape(-1, 9)
        along_r = (slope[0][:, :, None] * value[1][:, None, :]).reshape(-1, 9)
        along_z = (value[0][:, :, None] * slope[1][:, None, :]).reshape(-1, 9)
        return nodes, values, np.stack([along_r, along_z], axis=2)


class Slab(MixedRubber):
    """Rubber of E = 1 MPa in the shape of a slab of revolution, held below.

    Its unknowns are two displacements of every node, mm, then the pressures of the corners, MPa.
    """

    _axes = 2
    _residual = 1e-9

    def __init__(self, grid: Grid, material: Material) -> None:
        super().__init__(material)
        self.grid = grid
        half = [np.diff(line) / 2.0 for line in (grid.r_mm, grid.z_mm)]
        at = [
            (line[:-1, None] + part[:, None] * (1.0 + _PLACES)).ravel()
            for line, part in zip((grid.r_mm, grid.z_mm), half, strict=True)
        ]
        weight = [(part[:, None] * _WEIGHTS).ravel() for part in half]
        points = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1)
        i, j = len(half[0]), len(half[1])
        count = len(_PLACES)

        def by_element(field: Floats) -> Floats:
            rest = field.shape[2:]
            grouped = field.reshape(i, count, j, count, *rest).swapaxes(1, 2)
            return grouped.reshape(i * j, count * count, *rest)

        points = by_element(points)
        r = points[..., 0]
        self._volume = 2.0 * math.pi * r * by_element(np.multiply.outer(*weight))
        nodes, values, slopes = grid.read(points.reshape(-1, 2))
        values = values.reshape(*r.shape, 9)
        slopes = slopes.reshape(*r.shape, 9, 2)
        # F in the axes r, about and z: what each of an element's 18 displacements adds to it
        part = np.zeros((*r.shape, 9, 2, 3, 3))
        part[..., 0, 0, :] = slopes[..., [0, 0, 1]] * [1.0, 0.0, 1.0]
        part[..., 0, 1, 1] = values / r[..., None]
        part[..., 1, 2, :] = slopes[..., [0, 0, 1]] * [1.0, 0.0, 1.0]
        self._part = part.reshape(*r.shape, 18, 9)
        linear = _shapes(_PLACES)[2]
        self._shares = np.einsum("ra,zb->rzab", linear, linear).reshape(-1, 4)
        nodes = nodes.reshape(*r.shape, 9)[:, 0]
        wide = j + 1
        first = (np.arange(i)[:, None] * wide + np.arange(j)).reshape(-1, 1)
        corners = first + np.array([0, 1, wide, wide + 1])
        self._moves = 2 * grid.shape[0] * grid.shape[1]
        self.size = self._moves + (i + 1) * wide
        moved = (2 * nodes[:, :, None] + np.arange(2)).reshape(-1, 18)
        self._row = np.hstack([moved, self._moves + corners])
        number = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape)
        held = np.zeros(self.size, bool)
        held[2 * number[0]] = True
        held[2 * number[:, -1]] = held[2 * number[:, -1] + 1] = True
        self._free = np.flatnonzero(~held)
        quarter = np.repeat(self._volume.sum(axis=1) / 18.0 / self._shear, 4)
        self._scale = gathered(self._row[:, 18:], quarter, self.size)
        corner_node = number[::2, ::2].ravel()
        self._node = np.concatenate([np.repeat(number.ravel(), 2), corner_node])

    def _strained(self, unknowns: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return F, cof F, J and the pressure at the integration points of the elements."""
        own = unknowns[self._row]
        added = np.einsum("md,mqdk->mqk", own[:, :18], self._part, optimize=True)
        gradient = added.reshape(*added.shape[:2], 3, 3) + np.eye(3)
        return gradient, *cofactors(gradient), own[:, 18:] @ self._shares.T

    def resistance(self, unknowns: Floats) -> Floats:
        """Return the forces with which the rubber resists, and what is amiss with its volume."""
        gradient, cofactor, ratio, pressure = self._strained(unknowns)
        stress = self._shear * self._law.stress(gradient, cofactor, ratio)
        stress += pressure[..., None, None] * cofactor
        stress *= self._volume[..., None, None]
        flat = stress.reshape(*stress.shape[:2], 9)
        force = np.einsum("mqdk,mqk->md", self._part, flat, optimize=True)
        swollen = ((ratio - 1.0 - self._softness * pressure) * self._volume) @ self._shares
        both = np.hstack([force, swollen])
        return gathered(self._row, both, self.size)

    def tangent(self, unknowns: Floats) -> Any:
        """Return the sparse symmetric slope of `resistance`."""
        gradient, cofactor, ratio, pressure = self._strained(unknowns)
        cofactor_change = cofactor_slope(gradient)
        slope = self._shear * self._law.slope(gradient, cofactor, ratio, cofactor_change)
        slope += pressure[..., None, None, None, None] * cofactor_change
        slope *= self._volume[..., None, None, None, None]
        count, places = self._volume.shape
        part = self._part
        half = part @ slope.reshape(count, places, 9, 9)
        block = np.empty((count, 22, 22))
        flat = (count, -1, 18)
        block[:, :18, :18] = half.transpose(0, 2, 1, 3).reshape(count, 18, -1) @ part.swapaxes(
            2, 3
        ).reshape(flat)
        weighted = self._volume[..., None] * self._shares
        along = (part @ cofactor.reshape(count, places, 9, 1))[..., 0]
        volume = along.swapaxes(1, 2) @ weighted
        block[:, :18, 18:] = volume
        block[:, 18:, :18] = volume.swapaxes(1, 2)
        block[:, 18:, 18:] = -self._softness * (self._shares.T @ weighted)
        return summed(block, self._row, self.size)


_NUDGE_MM = 1e-4


class Touch:
    """The integration points (q,) of the slab's surface that a probe may touch."""

    def __init__(self, grid: Grid, shape: Shape) -> None:
        r = grid.r_mm[: grid.touching + 1]
        half = np.diff(r) / 2.0
        self.rest_mm = (r[:-1, None] + half[:, None] * (1.0 + _PLACES)).ravel()
        self.area_mm2 = 2.0 * math.pi * self.rest_mm * (half[:, None] * _WEIGHTS).ravel()
        points = np.column_stack([self.rest_mm, np.zeros(len(self.rest_mm))])
        nodes, values, _ = grid.read(points)
        self.nodes = nodes.reshape(-1, 3, 3)[:, :, 0]
        self.weights = values.reshape(-1, 3, 3)[:, :, 0]
        self._shape = shape

    def gaps(
        self, displacement: Floats, place: float, *, linear: bool
    ) -> tuple[Floats, Floats, Floats]:
        """Return gaps along z (q,), their slopes by the points' places (q, 2), and how these change
        with r (q,): the linear ones at the undeformed places."""
        shift = np.einsum("qa,qai->qi", self.weights, displacement[self.nodes])
        r = self.rest_mm if linear else self.rest_mm + shift[:, 0]
        upright = np.broadcast_to([0.0, 0.0, 1.0], (len(r), 3))

        def met(r_mm: Floats) -> tuple[Floats, Floats]:
            points = np.column_stack([r_mm, np.zeros(len(r)), shift[:, 1] - place])
            gap, normal = self._shape.met(points, upright)
            return gap, normal[:, 0] / normal[:, Z]

        gap, slope = met(r)
        if linear:
            return gap, upright[:, 1:], np.zeros(len(r))
        curvature = (met(r + _NUDGE_MM)[1] - met(r - _NUDGE_MM)[1]) / (2.0 * _NUDGE_MM)
        curvature = np.where(np.isfinite(gap), curvature, 0.0)
        return gap, np.column_stack([slope, np.ones(len(r))]), curvature

    def rms_radius(self, pressure: Floats) -> float:
        """Return the root mean square distance of the pressure from the axis, mm."""
        force = pressure * self.area_mm2
        return math.sqrt(float(force @ self.rest_mm**2 / force.sum()))


@dataclass(frozen=True)
class Balance:
    """A state: the slab's unknowns, the probe's place along z, mm, the (q,) pressures over Young's
    modulus, and the points at which they were sought."""

    unknowns: Floats
    place: float
    pressure: Floats
    active: Bools


def stepped(slab: Slab, touch: Touch, state: Balance, force: float, *, linear: bool) -> Balance:
    """Return the state after one Newton step of slab, probe and pressures together."""
    gap, push, curvature = touch.gaps(slab.displacement(state.unknowns), state.place, linear=linear)
    weighed = state.pressure - _GAP_WEIGHT * (gap + state.pressure / _SPRING)
    active = weighed > 0.0 if state.pressure.any() else state.active
    active = active & np.isfinite(gap)
    if not active.any():
        raise NotSettled("contact: at finite strain the probe touches nothing: press further")
    on = np.flatnonzero(active)
    tangent = slab.at_rest if linear else slab.tangent(state.unknowns)
    right = -(tangent @ state.unknowns) if linear else -slab.resistance(state.unknowns)
    weight = touch.weights[on]
    area = touch.area_mm2[on]
    push = push[on]
    row = (2 * touch.nodes[on][:, :, None] + np.arange(2)).reshape(len(on), 6)

    def nodal(forces: Floats) -> Floats:
        spread = np.einsum("qa,qi->qai", weight, forces)
        return gathered(row, spread, slab.size)

    spring = _SPRING * push[:, :, None] * push[:, None, :]
    spring[:, 0, 0] -= state.pressure[on] * curvature[on]
    spring *= area[:, None, None]
    block = np.einsum("qa,qb,qij->qaibj", weight, weight, spring).reshape(len(on), 6, 6)
    own = right + nodal(-(_SPRING * gap[on] * area)[:, None] * push)
    follow = nodal(-(_SPRING * area)[:, None] * push)
    springs = summed(block, row, slab.size)
    both = slab.solve(tangent + springs, np.column_stack([own, follow]))

    def closed(step: Floats) -> Floats:
        moved = slab.displacement(step)[touch.nodes[on]]
        return np.asarray(np.einsum("qi,qa,qai->q", push, weight, moved))

    still = -_SPRING * (gap[on] + closed(both[:, 0]))
    per_motion = _SPRING * (1.0 + closed(both[:, 1]))
    motion = float((force - area @ still) / (area @ per_motion))
    pressure = np.zeros(len(active))
    pressure[on] = still + motion * per_motion
    unknowns = state.unknowns + both[:, 0] - motion * both[:, 1]
    return Balance(unknowns, state.place + motion, pressure, active)


def graded_line(first: float, even: int, end: float) -> Floats:
    """Return places from 0 to ``end``: ``even`` elements of a length, then each larger than the
    last."""
    lengths = [first] * even
    while sum(lengths) < end:
        lengths.append(lengths[-1] * _GROWTH)
    places = np.concatenate([[0.0], np.cumsum(lengths)])
    grown = places[even:] - places[even]
    stretched = grown * (end - places[even]) / grown[-1]
    return np.concatenate([places[:even], places[even] + stretched])


def _graded(first: float, growth: float, end: float) -> Floats:
    """Return places from 0 to ``end``: elements of about ``first``, each larger than the last."""
    lengths = [first]
    while sum(lengths) < end:
        lengths.append(lengths[-1] * growth)
    places = np.concatenate([[0.0], np.cumsum(lengths)])
    return np.asarray(places * end / places[-1])


def rim_grid(edge: float, outside: float, share: float, radius_mm: float, thick_mm: float) -> Grid:
    """Return a grid that is finest under a cylinder's rim, where the contact ends.

    ``edge`` and ``outside`` are the radii of the rim and of the cylinder, ``share`` the relative
    number of elements; the slab has ``radius_mm`` and ``thick_mm``.
    """
    flat = outside - edge
    count = max(2, round(share * _ON_RIM))
    first = edge / count
    growth = 1.0 + (_RIM_GROWTH - 1.0) / share
    inner = flat - _graded(first, growth, flat)[::-1]
    rim = flat + first * np.arange(1, count + 1)
    outer = outside + _graded(first, growth, radius_mm - outside)[1:]
    r_mm = np.concatenate([inner, rim, outer])
    touching = int(np.searchsorted(r_mm, _RIM_REACH * outside))
    return Grid(r_mm, _graded(first, growth, thick_mm), touching)
