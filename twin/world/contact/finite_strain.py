"""What linear theory leaves out of a straight press on a block: large strain, the turning of the
surface, and contact with the deformed instead of the undeformed surface.

The displacement under a press is

    linear answer (`twin.world.contact.pressing`)
        + [finite-strain answer - linear contact answer, both on one round slab],

under the same force. Near the probe a block is a slab as thick, and the difference decays like the
third power of the distance, so that the slab may end where it likes: it is solved as a body of
revolution, in a few tenths of a second.

**Rubber.** Quadratic displacement (radial, along z) and linear pressure on rectangles; the stress
is a `twin.world.elasticity.strain_law.StrainLaw`, whose tangent at rest is linear theory.

**Contact.** Pressures at the integration points of the surface; g is a point's gap to the probe
along z.

    pressure = -k g > 0, or pressure = 0 and g > 0;  the pressures sum to the given force.

In the linear answer g is measured at the undeformed place, as `pressing` does, in the other one at
the deformed place, with forces along the probe's normal. The springs k are a film of rubber 2 um
thick on the probe, in both answers. The probe's place is an unknown.

**Steps.** Newton's, both contacts by an active set; the linear answer begins at the indentation and
the contact of `pressing`, the other one at the linear answer.

A cylinder's rim is resolved; a sharp one is solved as one rounded by a fiftieth of the diameter.

Validity: one rigid sphere, cylinder, or cone, pressed straight and without
friction on a block, its axis five contact radii or more from the sides; nu from 0.45.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import ContactError, InputError, NotSettled, SolveError
from twin.parts.body import Block, Body
from twin.parts.material import Material, shear_modulus
from twin.parts.press import Press
from twin.parts.probe import Cone, Cylinder, Sphere
from twin.world.contact.contact_state import (
    ESTIMATED,
    MEASURED,
    ContactState,
    PressError,
    Share,
    Validity,
)
from twin.world.contact.probe_gap import Shape, Z, approach_of
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.strain_law import cofactor_slope, cofactors, strain_law

LEAST_POISSON = 0.45
"""The laws are tried for rubber, from here to 1/2."""

LEAST_EDGE = 0.02
"""Least radius of a cylinder's rim over its diameter: a sharper one is solved with this radius, on
which what linear theory leaves out hardly depends (docs/validity.md)."""

_ROUND_EDGE = 0.05
"""From this radius over the diameter, elements of equal size resolve a rim as they do a sphere."""

LEAST_BESIDE = 5.0
"""Least distance of the probe's axis from the block's sides over the contact's radius."""

_SPRING = 500.0
_GAP_WEIGHT = 2.0
"""Pressure per overlap, and what a pressure is weighed against a gap with, over Young's modulus,
1/mm."""

_REACH = 1.6
"""Points so far from the axis, over the contact's radius, may touch."""

_UNDER = 14
_GROWTH = 1.3
"""Elements from the axis to `_REACH`, and how much larger each is than the last one from there."""

_RIM_REACH = 1.2
_ON_RIM = 3
_RIM_GROWTH = 1.5
"""The same under a sharper cylinder: its reach over its radius, elements along its rim, and their
growth on both sides."""

_COARSER = 0.7
_ERROR_OVER_CHANGE = 1.0
_RIM_OVER_CHANGE = 2.0
"""How many times as many elements the mesh has that tells the error; error over the change to it,
and the same where the rim has its own mesh: less under all presses of
tests/reference/neohooke.json."""

_TOLERANCE = 1e-4
_STEPS = 20
"""Newton's steps end at one that moves nothing by more than this share of the largest displacement;
their largest number."""

LOAD_STEPS = 5
"""Equal steps of the force where Newton's steps fail from the linear answer."""

_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Gauss's places and weights on an element's side, -1 to 1."""


def _shapes(place: Floats) -> tuple[Floats, Floats, Floats]:
    """Return quadratic shapes (n, 3), their slopes, and linear shapes (n, 2) at places (n,), -1 to
    1."""
    x = place
    values = np.column_stack([x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0])
    slopes = np.column_stack([x - 0.5, -2.0 * x, x + 0.5])
    return values, slopes, np.column_stack([1.0 - x, 1.0 + x]) / 2.0


@dataclass(frozen=True)
class _Rim:
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
class _Grid:
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


class _Slab:
    """Rubber of E = 1 MPa in the shape of a slab of revolution, held below.

    Its unknowns are two displacements of every node, mm, then the pressures of the corners, MPa.
    """

    def __init__(self, grid: _Grid, material: Material) -> None:
        self.grid = grid
        poisson_ratio = material.poisson_ratio
        self._law = strain_law(material)
        self._shear = shear_modulus(1.0, poisson_ratio)
        self._softness = (1.0 - 2.0 * poisson_ratio) / (2.0 * self._shear * poisson_ratio)
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
        self._scale = _gathered(self._row[:, 18:], quarter, self.size)
        corner_node = number[::2, ::2].ravel()
        self._node = np.concatenate([np.repeat(number.ravel(), 2), corner_node])

    def displacement(self, unknowns: Floats) -> Floats:
        """Return the displacement (N, 2) of the nodes, along r and z."""
        return unknowns[: self._moves].reshape(-1, 2)

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
        return _gathered(self._row, both, self.size)

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
        return _summed(block, self._row, self.size)

    @cached_property
    def at_rest(self) -> Any:
        """The tangent of linear theory."""
        return self.tangent(np.zeros(self.size))

    def solve(self, matrix: Any, right: Floats) -> Floats:
        """Return the solution (n, m) of a tangent for ``right`` (n, m); 0 where it is held."""
        out = np.zeros_like(right)
        free = self._free
        factor = Factor(matrix[free][:, free], self._scale[free], node=self._node[free])
        out[free] = factor.solve(right[free], 1e-9)
        return out


def _gathered(rows: Ints, parts: Floats, size: int) -> Floats:
    """Return the (size,) sum of parts at ``rows``, of as many numbers."""
    return np.bincount(rows.ravel(), parts.ravel(), size).astype(float)


def _summed(blocks: Floats, rows: Ints, size: int) -> Any:
    """Return the sparse (size, size) sum of blocks (m, r, r) at rows (m, r)."""
    from scipy.sparse import csr_matrix

    wide = rows.shape[1]
    i = np.repeat(rows, wide, axis=1).ravel()
    j = np.tile(rows, (1, wide)).ravel()
    return csr_matrix((blocks.ravel(), (i, j)), shape=(size, size))


_NUDGE_MM = 1e-4


class _Touch:
    """The integration points (q,) of the slab's surface that a probe may touch."""

    def __init__(self, grid: _Grid, shape: Shape) -> None:
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
class _Balance:
    """A state: the slab's unknowns, the probe's place along z, mm, the (q,) pressures over Young's
    modulus, and the points at which they were sought."""

    unknowns: Floats
    place: float
    pressure: Floats
    active: Bools


def _stepped(
    slab: _Slab, touch: _Touch, state: _Balance, force: float, *, linear: bool
) -> _Balance:
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
        return _gathered(row, spread, slab.size)

    spring = _SPRING * push[:, :, None] * push[:, None, :]
    spring[:, 0, 0] -= state.pressure[on] * curvature[on]
    spring *= area[:, None, None]
    block = np.einsum("qa,qb,qij->qaibj", weight, weight, spring).reshape(len(on), 6, 6)
    own = right + nodal(-(_SPRING * gap[on] * area)[:, None] * push)
    follow = nodal(-(_SPRING * area)[:, None] * push)
    springs = _summed(block, row, slab.size)
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
    return _Balance(unknowns, state.place + motion, pressure, active)


def _line(first: float, even: int, end: float) -> Floats:
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


def _rim_grid(
    edge: float, outside: float, share: float, radius_mm: float, thick_mm: float
) -> _Grid:
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
    return _Grid(r_mm, _graded(first, growth, thick_mm), touching)


@dataclass(frozen=True)
class _Pair:
    """The linear and the finite-strain answer on one slab."""

    grid: _Grid
    linear: Floats
    finite: Floats
    deeper_mm: float
    wider: float

    @cached_property
    def change(self) -> Floats:
        """(N, 2) what linear theory leaves out at the nodes, mm."""
        return self.finite - self.linear


class FiniteStrain:
    """What linear theory leaves out of one state of a press.

    Parameters
    ----------
    press
        The press; see the module for what is allowed.
    body, material
        Its `Material.law` is not linear.
    state
        The press by linear theory: a state in its path.
    watched
        (n, 3) points inside the body for which the error counts, mm.
    coarse
        Whether a coarser mesh and no load steps do: half of the time, for the size alone.

    Attributes
    ----------
    indentation_mm
        How much deeper the probe sinks than by linear theory, mm.
    wider
        Radius of the contact over that by linear theory.

    Raises
    ------
    InputError
        The press is not of the kind that is solved at finite strain.
    ContactError
        Newton's steps don't converge: cause and remedy.
    """

    def __init__(
        self,
        press: Press,
        body: Body,
        material: Material,
        state: ContactState,
        watched: Points,
        *,
        coarse: bool = False,
    ) -> None:
        self._press = press
        self._approach = approach_of(press, body)
        self._axis = (self._approach.axis_mm + state.move_mm)[:Z]
        self._material = material
        self._state = state
        low, high = np.array(body.bounds_mm)
        beside = np.concatenate([self._axis - low[:Z], high[:Z] - self._axis])
        self._beside_mm = float(beside.min())
        self._thick_mm = float(high[Z] - low[Z])
        if problem := _unsolved(press, body, material, state, self._beside_mm):
            raise InputError(
                f"material.law = {material.law}: {problem} at finite strain; change it, or set "
                "material.law = linear"
            )
        self._coarse = coarse
        self._watched = watched if len(watched) else self._below_contact()
        sides = (high - low)[:Z]
        share = _COARSER if coarse else 1.0
        self._pair = self._solved(share, math.sqrt(float(sides[0] * sides[1]) / math.pi))
        self.indentation_mm = self._pair.deeper_mm
        self.wider = self._pair.wider

    def displacement(self, points: Points) -> Points:
        """Return (n, 3) what to add to the linear displacement of points (n, 3), mm."""
        return self._at(points, self._pair.grid, self._pair.change)

    def gradient(self, points: Points) -> Floats:
        """Return (n, 3, 3) what to add to the gradients du_i/dx_j."""
        place, out = self._places(points)
        nodes, values, slopes = self._pair.grid.read(place)
        change = self._pair.change[nodes]
        gradient = np.einsum("nai,naj->nij", change, slopes)
        aside = np.einsum("na,na->n", values, change[:, :, 0])
        about = np.where(place[:, 0] > 0, aside / np.maximum(place[:, 0], 1e-12), gradient[:, 0, 0])
        axes = np.zeros((len(points), 3, 3))  # rows: r, about, z
        axes[:, 0, :Z] = out
        axes[:, 1, 0] = -out[:, 1]
        axes[:, 1, 1] = out[:, 0]
        axes[:, 2, 2] = 1.0
        own = np.zeros((len(points), 3, 3))
        own[:, ::2, ::2] = gradient
        own[:, 1, 1] = about
        return np.asarray(axes.transpose(0, 2, 1) @ own @ axes)

    @property
    def _rim(self) -> Cylinder | None:
        """The cylinder whose rim needs a mesh of its own."""
        probe = self._press.probe
        if isinstance(probe, Cylinder) and probe.edge_mm < _ROUND_EDGE * probe.diameter_mm:
            return probe
        return None

    @cached_property
    def error(self) -> Share:
        """How far this may be off, over the linear answer: what a coarser mesh changes, in a slab
        that ends at the block's nearest side."""
        other = self._solved(_COARSER, self._beside_mm)
        moved = self._at(self._watched, other.grid, other.change)
        there = _largest(moved - self.displacement(self._watched)) / _largest(self._linear_there)
        sunk = abs(other.deeper_mm - self.indentation_mm) / self._state.indentation_mm
        factor = _RIM_OVER_CHANGE if self._rim else _ERROR_OVER_CHANGE
        return Share(indentation=factor * sunk, markers=factor * there + _TOLERANCE)

    @cached_property
    def linear_error(self) -> float:
        """How far linear theory is off at the watched points, over the largest displacement."""
        return _largest(self.displacement(self._watched)) / _largest(self._linear_there)

    @cached_property
    def _linear_there(self) -> Points:
        """The slab's linear displacement of the watched points: the scale of errors."""
        return self._at(self._watched, self._pair.grid, self._pair.linear)

    def _below_contact(self) -> Points:
        """Return places as deep as the contact is wide, from its axis to thrice its radius."""
        deep = self._state.contact_radius_mm
        away = deep * np.linspace(0.0, 3.0, 13)
        return np.column_stack(
            [self._axis[0] + away, 0.0 * away + self._axis[1], 0.0 * away + deep]
        )

    def _places(self, points: Points) -> tuple[Floats, Floats]:
        """Return (n, 2) places along r and z, and the (n, 2) unit vectors away from the axis."""
        away = points[:, :Z] - self._axis
        r = np.linalg.norm(away, axis=1)
        out = np.where(r[:, None] > 0.0, away / np.maximum(r, 1e-300)[:, None], [1.0, 0.0])
        return np.column_stack([r, points[:, Z]]), out

    def _at(self, points: Points, grid: _Grid, field: Floats) -> Points:
        """Return the (n, 3) values of a slab's field (N, 2) at points (n, 3), 0 beyond its rim."""
        place, out = self._places(points)
        nodes, values, _ = grid.read(np.minimum(place, [grid.r_mm[-1], grid.z_mm[-1]]))
        own = np.einsum("na,nai->ni", values, field[nodes])
        own[place[:, 0] > grid.r_mm[-1]] = 0.0
        return np.column_stack([out * own[:, :1], own[:, 1]])

    def _solved(self, share: float, radius_mm: float) -> _Pair:
        """Return both answers on a slab of a radius, in so large a share of the elements."""
        state = self._state
        size = state.contact_radius_mm
        shape = self._approach.shape
        if self._rim is not None:
            outside = self._rim.diameter_mm / 2.0
            edge = self._rim.edge_mm
            least = LEAST_EDGE * self._rim.diameter_mm
            if edge < least:
                # The coarser answer has a rim twice as round: it shows what the rounding costs.
                edge = least if share == 1.0 else 2.0 * least
                shape = _Rim(outside - edge, edge)
            grid = _rim_grid(edge, outside, share, radius_mm, self._thick_mm)
        else:
            count = round(share * _UNDER)
            edge = _REACH * size / count
            under = _line(edge, count // 2, self._thick_mm)
            grid = _Grid(_line(edge, count, radius_mm), under, count)
        slab = _Slab(grid, self._material)
        touch = _Touch(grid, shape)
        force = float(state.force_n[Z]) / self._material.youngs_modulus_mpa
        none = np.zeros(len(touch.rest_mm))
        start = _Balance(np.zeros(slab.size), state.indentation_mm, none, touch.rest_mm < size)
        linear = self.settled(slab, touch, start, force, linear=True)
        finite = self._finite(slab, touch, linear, force)
        return _Pair(
            grid=grid,
            linear=slab.displacement(linear.unknowns),
            finite=slab.displacement(finite.unknowns),
            deeper_mm=finite.place - linear.place,
            wider=touch.rms_radius(finite.pressure) / touch.rms_radius(linear.pressure),
        )

    def _finite(self, slab: _Slab, touch: _Touch, linear: _Balance, force: float) -> _Balance:
        """Return the finite-strain answer: from the linear one at once, else in load steps."""
        try:
            return self.settled(slab, touch, linear, force, linear=False)
        except (NotSettled, SolveError):
            if self._coarse:
                raise
            first = 1.0 / LOAD_STEPS
            state = replace(
                linear,
                unknowns=first * linear.unknowns,
                place=first * linear.place,
                pressure=first * linear.pressure,
            )
        try:
            for part in np.linspace(first, 1.0, LOAD_STEPS):
                state = self.settled(slab, touch, state, part * force, linear=False)
        except (NotSettled, SolveError) as problem:
            raise NotSettled(
                f"contact: at finite strain (material.law = {self._material.law}) Newton's steps "
                f"did not converge, nor did they in {LOAD_STEPS} load steps: press with less "
                "force, with a rounder probe, or set material.law = linear"
            ) from problem
        return state

    def settled(
        self, slab: _Slab, touch: _Touch, state: _Balance, force: float, *, linear: bool
    ) -> _Balance:
        """Take Newton's steps until one moves nothing."""
        for _ in range(_STEPS):
            after = _stepped(slab, touch, state, force, linear=linear)
            moved = slab.displacement(after.unknowns)
            step = _largest(moved - slab.displacement(state.unknowns)) / _largest(moved)
            state = after
            if step < _TOLERANCE or not math.isfinite(step):
                break
        if not step < _TOLERANCE:
            raise NotSettled(
                f"contact: at finite strain (material.law = {self._material.law}) Newton's steps "
                f"did not converge in {_STEPS}: press with less force, with a rounder probe, or "
                "set material.law = linear"
            )
        if np.any(state.pressure[-len(_PLACES) :] > 0.0):
            raise ContactError(
                f"contact: at finite strain it grows beyond {_REACH:g} times its size by linear "
                "theory: press with less force, or set material.law = linear"
            )
        return state


def _largest(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def _unsolved(
    press: Press, body: Body, material: Material, state: ContactState, beside_mm: float
) -> str:
    """Return why a press isn't solved at finite strain, and what is; empty if it is."""
    problem = ""
    nearest = LEAST_BESIDE * state.contact_radius_mm
    if press.also:
        problem = "press.also: one probe at a time is solved"
    elif not isinstance(body, Block):
        problem = f"body.shape = {body.geometry()['shape']}: blocks are solved"
    elif not isinstance(press.probe, Sphere | Cylinder | Cone):
        problem = f"press.probe.kind = {press.probe.kind}: spheres, cylinders, cones are solved"
    elif press.friction > 0.0:
        problem = f"press.friction = {press.friction:g}: friction 0 is solved"
    elif np.any(state.turns_deg) or any(press.tilt_deg) or press.direction not in (None, (0, 0, 1)):
        problem = "press: probes that come along z and don't turn are solved"
    elif material.poisson_ratio < LEAST_POISSON:
        problem = (
            f"material.poisson_ratio = {material.poisson_ratio:g}: {LEAST_POISSON:g} to 0.5 is "
            "solved"
        )
    elif beside_mm < nearest:
        problem = (
            f"press.at_mm: {beside_mm:.3g} mm from a side of the block, {nearest:.3g} mm or more "
            f"({LEAST_BESIDE:g} times the contact's radius) are solved"
        )
    return problem


def measured_linearity(
    press: Press, body: Body, material: Material, state: ContactState, watched: Points
) -> Validity:
    """Return a state's validity with how far linear theory is off under this very press.

    Neo-Hookean rubber is pressed on a coarse mesh (about .3 s). Where that can't be done the
    estimate stays, and `Validity.linearisation_basis` says why.
    """
    validity = state.validity
    if not state.load.terms:
        return replace(validity, linearisation_basis=f"{ESTIMATED}: nothing touches")
    rubber = material.model_copy(update={"law": "neo_hookean"})
    try:
        more = FiniteStrain(press, body, rubber, state, watched, coarse=True)
    except InputError as problem:
        cause = str(problem).removeprefix("material.law = neo_hookean: ").split(" at finite")[0]
        return replace(validity, linearisation_basis=f"{ESTIMATED}: {cause} at finite strain")
    except (ContactError, SolveError):
        cause = "Newton's steps at finite strain did not converge"
        return replace(validity, linearisation_basis=f"{ESTIMATED}: {cause}")
    deeper = more.indentation_mm / state.indentation_mm
    note = (
        f"linear theory is {100 * more.linear_error:.2g} % of the largest displacement off here, "
        f"and its indentation {100 * abs(deeper):.2g} % too {'small' if deeper > 0 else 'large'}; "
        "-s material.law=neo_hookean includes it"
    )
    return replace(
        validity,
        linearisation_error=more.linear_error,
        linearisation_basis=MEASURED,
        warnings=(),
        notes=(note,),
    )


def at_finite_strain(
    press: Press,
    body: Body,
    material: Material,
    state: ContactState,
    watched: Points,
    judge: Callable[[PressError], None],
) -> ContactState:
    """Return the state of a press, and of every step of its path, with what linear theory leaves
    out.

    Loads and the pressures of patches stay those of the linear answer, on the undeformed surface;
    `Load.strained` is the difference. ``judge`` is called with every estimated error; the others
    are those of `FiniteStrain`, with what it raises.
    """
    controls = press.in_own_axes(approach_of(press, body).axes)
    path = []
    for one, (by_force, _) in zip(state.path, controls, strict=False):
        if not by_force[Z]:
            raise InputError(
                f"material.law = {material.law}: press: probes that are held by a force along z "
                "are solved at finite strain; give force_n.z, or set material.law = linear"
            )
        if not one.load.terms:
            path.append(one)
            continue
        more = FiniteStrain(press, body, material, one, watched)
        path.append(_strained(one, more, material.law, judge))
    return replace(path[-1], path=tuple(path), complete=state.complete, reason=state.reason)


def _strained(
    state: ContactState, more: FiniteStrain, law: str, judge: Callable[[PressError], None]
) -> ContactState:
    """Return a state with what linear theory leaves out of it."""
    deeper = more.indentation_mm

    def estimate(_: ContactState) -> PressError:
        linear = state.error
        assert linear is not None
        error = PressError.of(
            body=linear.body,
            patches=linear.patches,
            increments=linear.increments,
            strain=more.error,
        )
        judge(error)
        return error

    note = (
        f"large strain is included (material.law = {law}): linear theory is "
        f"{100 * more.linear_error:.2g} % of the largest displacement off, and the indentation "
        f"{100 * deeper / state.indentation_mm:.2g} % larger than by it"
    )
    return replace(
        state,
        load=replace(state.load, strained=more),
        indentation_mm=state.indentation_mm + deeper,
        move_mm=state.move_mm + np.array([0.0, 0.0, deeper]),
        contact_radius_mm=state.contact_radius_mm * more.wider,
        area_mm2=state.area_mm2 * more.wider**2,
        peak_pressure_mpa=state.peak_pressure_mpa / more.wider**2,
        validity=replace(
            state.validity,
            linearisation_error=more.linear_error,
            linearisation_basis=MEASURED,
            warnings=(),
            notes=(note,),
        ),
        estimate=estimate,
    )
