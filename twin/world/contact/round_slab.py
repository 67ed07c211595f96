"""What linear theory leaves out of a straight press on a block. It decays like the third power of
the distance, so that a block is solved as a slab of revolution as thick, in a few tenths of a
second.

**Rubber.** `twin.world.contact.mixed_rubber` on rectangles; displacements are radial and along z.

**Contact.** Pressures at the integration points of the surface; g is a point's gap to the probe
along z.

    pressure = -k g > 0, or pressure = 0 and g > 0;  the pressures sum to the given force.

In the linear solution g is measured at the undeformed place, as in `twin.world.contact.pressing`,
in the other one at the deformed place, with forces along the probe's normal. The springs k are a
film of rubber on the probe, a 3000th of the contact's radius thick, in both. The probe's place is
an unknown.

**Steps.** Newton's begin at the indentation and the contact of `pressing`, and for the other
solution at the linear one. In each the rubber is condensed to the nodes that may touch, and contact
is balanced there by an active set of points. The tangent at rest, whose factor both solutions
share, will mostly do, where the last steps are mixed; else every step takes the present one, and
one change of the active set.

**Mesh.** Pressure falls to 0 as a square root where the contact ends, so elements are small there:
their error then depends little on where in one it ends. Under a cylinder that is the rim; a sharp
one is solved as one rounded by a fiftieth of the diameter.

Validity: one rigid sphere, cylinder, or cone, pressed straight and without friction on a block, its
axis five contact radii or more from the sides; nu from 0.44.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import ContactError, NotSettled
from twin.parts.body import Block, Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.parts.press import Cone, Cylinder, Press, Sphere
from twin.world.contact.contact_state import ContactState, Share
from twin.world.contact.mixed_rubber import MixedRubber
from twin.world.contact.probe_gap import MOTIONS, Approach, Shape, Z
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.strain_law import LEAST_POISSON

_SPRING = 3000.0
_GAP_WEIGHT = 4.0
"""Pressure per overlap, and what a pressure is weighed against a gap with, times the contact's
radius over Young's modulus."""

_LEAST_EDGE = 0.02, 0.01
"""Least radius of a cylinder's rim, over its diameter and over the slab's thickness: a sharper one
is solved with the smaller of both."""

_FLAT = 0.75
"""Radius of a cylinder's flat middle over the contact's from which on the mesh follows the rim."""

_FROM_SIDES = 5.0
"""Least distance of the probe's axis from the block's sides over the contact's radius."""

_ENDS = np.array([0.96, 1.1])
_REACH = 1.6
_RIM_REACH = 1.2
"""Over the contact's radius by linear theory: where it may end at finite strain, and how far points
may touch; the latter under a cylinder over its radius."""

_AT_END = 4
_ON_RIM = 6
_RIM_LENGTH = 0.025
_GROWTH = 1.4
_LARGEST = 0.08
_DEEPEST = 0.2
"""Elements where the contact may end; the least along a cylinder's rim, and their largest length
over its radius; the growth of the others, the largest length inside, over the radius where the
contact may end, and height over the slab's, as thin rubber shears most where it is held."""

_FITTED = 4
_BEYOND = 0.05, 0.4
"""Least number of borders of elements from which the contact's end is extrapolated; the least and
largest share of the force beyond them."""

_COARSER, _FINER = 0.7, 1.4
_UNDER_RIM = 1.5
_ERROR_OVER_CHANGE = 1.5
_LEAST = Share(indentation=1e-5, markers=1e-5), Share(indentation=0.004, markers=0.001)
"""How many times as many elements the mesh has that solves for the size alone, or shows what a
rounder rim costs, and the one that estimates the error otherwise; and one under a cylinder, where
meshes may otherwise miss the same 0.05 %; error over the change to that mesh; and what is added: so
much, and shares of what linear theory leaves out, for what meshes have in common:
docs/validity.md."""

_TOLERANCE = 1e-5
_NEARLY = 1e-4
_STEPS = 20
"""Newton's steps end at one that moves nothing by more than this share of the largest displacement,
on the mesh that estimates the error by more than the other; their most."""

_BALANCES, _BALANCED = 60, 1e-9
"""Most iterations of a balance of contact, and the relative step at which they end."""

_RESIDUAL = 1e-9
"""Of a linear solution, relative."""

_NUDGE_MM = 1e-4

_WATCHED = 0.5, 1.0, 1.5
"""Depths over the contact's radius at which errors are looked for where a scene has no markers: at
one depth two meshes may agree by chance."""

_POINTS = 3
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(_POINTS)
"""Integration points on an element's side, -1 to 1."""

_ENTRIES = np.array([0, 2, 4, 6, 8])
"""Of F in the axes r, about and z those that are not 0: rr, rz, about, zr, zz."""


class FiniteStrain:
    """What linear theory leaves out of one state of a press.

    Parameters
    ----------
    axes
        The own axes (3, 3) of every probe.
    state
        The press by linear theory.
    watched
        (n, 3) points inside the body for which the error counts, mm.
    over_change, least
        The error over the change to another mesh; what is added to it; and what more, over what
        linear theory leaves out.

    Attributes
    ----------
    moved
        (p, 6) how much farther every probe moves than by linear theory, along and about its own
        axes, mm and radians.
    wider
        (p,) radius of its contact over that by linear theory.
    held_within
        How far the indentation may be off where a motion holds the probe, relative.
    """

    held_within = 5e-5

    @dataclass(frozen=True, kw_only=True)
    class Solutions:
        """The linear and the finite-strain solution on one coarse mesh, whose own error is in both
        and mostly cancels.

        Attributes
        ----------
        read
            Returns the values (n, 3) and the gradients du_i/dx_j (n, 3, 3) at points of a field of
            the nodes.
        linear_mm, change
            (N, axes) the linear displacement of the nodes, and what it leaves out, mm.
        moved, wider
            See `FiniteStrain`.
        """

        read: Callable[[Points, Floats], tuple[Points, Floats]]
        linear_mm: Floats
        change: Floats
        moved: Floats
        wider: Floats

    def __init__(
        self,
        axes: tuple[Floats, ...],
        state: ContactState,
        watched: Points,
        over_change: float,
        least: tuple[Share, Share],
    ) -> None:
        self.axes = axes
        self._state = state
        self._watched = watched
        self._over_change = over_change
        self._least = least
        self._pair = self._solved(False)
        self.moved, self.wider = self._pair.moved, self._pair.wider

    @property
    def indentation_mm(self) -> float:
        """How much deeper the first probe sinks than by linear theory, mm."""
        return float(self.moved[0, Z])

    def displacement(self, points: Points) -> Points:
        """Return (n, 3) what to add to the linear displacement of points (n, 3), mm."""
        return self._pair.read(points, self._pair.change)[0]

    def gradient(self, points: Points) -> Floats:
        """Return (n, 3, 3) what to add to the gradients du_i/dx_j."""
        return self._pair.read(points, self._pair.change)[1]

    def more_force_n(self, patches: Rectangles, probe: int) -> Floats:
        """Return (k, 3) what to add to the forces of a probe's patches."""
        return np.zeros_like(patches.force_n)

    @cached_property
    def linear_error(self) -> float:
        """How far linear theory is off at the watched points, over the largest displacement."""
        return MixedRubber.largest(self.displacement(self._watched)) / self._largest_mm

    @cached_property
    def _largest_mm(self) -> float:
        return MixedRubber.largest(self._pair.read(self._watched, self._pair.linear_mm)[0])

    @cached_property
    def _other(self) -> FiniteStrain.Solutions:
        """The solutions on another mesh; where these fail, as if it left nothing out."""
        try:
            return self._solved(True)
        except ContactError:
            pair = self._pair
            return replace(pair, change=0.0 * pair.change, moved=0.0 * pair.moved)

    def _solved(self, other: bool) -> FiniteStrain.Solutions:
        """Return the solutions on the mesh that counts, or on the one that estimates its error."""
        raise NotImplementedError

    @cached_property
    def error(self) -> Share:
        """How far this may be off, over the linear displacement: what another mesh changes, and
        what meshes have in common."""
        other = self._other
        missed = other.read(self._watched, other.change)[0] - self.displacement(self._watched)
        deep = np.array([one.indentation_mm for one in (self._state, *self._state.also)])
        sunk = float(np.max(np.abs((other.moved - self.moved)[:, Z]) / deep))
        change = Share(indentation=sunk, markers=MixedRubber.largest(missed) / self._largest_mm)
        least, shares = self._least
        return change.times(self._over_change).plus(least).plus(shares.times(self.linear_error))


class SlabStrain(FiniteStrain):
    """What linear theory leaves out of a press, on a slab of revolution.

    Parameters
    ----------
    press, body, material
        The press; `solves` is True for it. The law is not linear.
    state, watched
        See `FiniteStrain`.
    coarse
        Whether a coarser mesh and no load steps do: half of the time, for the size alone.

    Raises
    ------
    ContactError
        Newton's steps don't converge.
    """

    _pair: _Pair

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
        approach = Approach.of_press(press, body)
        place = approach.axis_mm + state.move_mm
        self._axis = place[:Z]
        self._approach = approach
        self._rim = None
        self._material = material
        self._coarse = coarse
        across, along, thick = np.ptp(body.bounds_mm, axis=0)
        self._thick_mm = float(thick)
        self._estimating = _FINER
        probe = press.probe
        self._finer = 1.0
        if isinstance(probe, Cylinder):
            self._finer = 1.0 if coarse else _UNDER_RIM
            flat = probe.diameter_mm / 2.0 - probe.edge_mm
            self._rim = probe if flat > _FLAT * state.contact_radius_mm else None
            if probe.edge_mm < self._least_edge_mm(probe):
                self._estimating = _COARSER
        if len(watched) == 0:  # without markers: _WATCHED radii deep, from the axis to thrice one
            size = state.contact_radius_mm
            deep, away = np.meshgrid(np.multiply(_WATCHED, size), size * np.linspace(0.0, 3.0, 13))
            watched = np.tile([*self._axis, 0.0], (deep.size, 1))
            watched[:, 0] += away.ravel()
            watched[:, 2] = np.minimum(deep.ravel(), self._thick_mm / 2.0)

        # The other slab ends at the block's nearest side.
        self._radii_mm = (math.sqrt(across * along / math.pi), _to_side_mm(body, place))
        super().__init__((approach.axes,), state, watched, _ERROR_OVER_CHANGE, _LEAST)

    @staticmethod
    def solves(
        press: Press, body: Body, material: Material, state: ContactState | None = None
    ) -> bool:
        """Return whether a press is solved on a slab; without a state, whether it may be."""
        kind = (
            not press.also
            and isinstance(body, Block)
            and isinstance(press.probe, Sphere | Cylinder | Cone)
            and press.friction == 0.0
            and not any(press.tilt_deg)
            and press.direction in (None, (0, 0, 1))
            and material.poisson_ratio >= LEAST_POISSON
        )
        if not kind or state is None:
            return kind
        away = _to_side_mm(body, Approach.of_press(press, body).axis_mm + state.move_mm)
        return not np.any(state.turns_deg) and away >= _FROM_SIDES * state.contact_radius_mm

    def _least_edge_mm(self, probe: Cylinder) -> float:
        return float(np.min(np.multiply(_LEAST_EDGE, (probe.diameter_mm, self._thick_mm))))

    def _solved(self, other: bool) -> _Pair:
        """Return both solutions on a slab."""
        state = self._state
        fineness = self._estimating if other else _COARSER if self._coarse else 1.0
        share = self._finer * fineness
        size = state.contact_radius_mm
        approach = self._approach
        if self._rim is None:
            low, high = _ENDS * size
            reach, count = _REACH * size, _AT_END
        else:
            # A coarser solution's sharp rim is twice as round: it shows what the rounding costs.
            edge = self._rim.edge_mm
            least = self._least_edge_mm(self._rim)
            if edge < least:
                edge = 2.0 * least if fineness < 1.0 else least
                approach = approach.with_edge(edge)
            high = self._rim.diameter_mm / 2.0
            low, reach = high - edge, _RIM_REACH * high
            count = max(_ON_RIM, math.ceil(edge / (_RIM_LENGTH * high)))
        grid = Slab.Grid.graded(
            (low, high), count, reach, share, self._radii_mm[other], self._thick_mm
        )
        slab = Slab(grid, self._material)
        touch = _Touch(grid, approach.shape, size)
        force = float(state.force_n[Z]) / self._material.youngs_modulus_mpa
        if other and fineness > 1.0:  # from the solutions on the mesh that counts
            start = self._pair.on(slab, touch, self._pair.linear)
            linear = self.settled(slab, touch, start, force, linear=True, to=_NEARLY)
            start = self._pair.on(slab, touch, self._pair.finite)
            finite = self.settled(slab, touch, start, force, linear=False, to=_NEARLY)
        else:
            none = np.zeros(len(touch.rest_mm))
            start = _Balance(np.zeros(slab.size), state.indentation_mm, none, touch.rest_mm < size)
            linear = self.settled(slab, touch, start, force, linear=True)

            def settle(state: _Balance, share: float, *, linear: bool) -> _Balance:
                to = _TOLERANCE if share == 1.0 else _NEARLY
                return self.settled(slab, touch, state, share * force, linear=linear, to=to)

            finite = slab.loaded(settle, linear, at_once=self._coarse)
        linear_mm = slab.displacement(linear.unknowns)
        moved = np.zeros((1, MOTIONS))
        moved[0, Z] = finite.pose - linear.pose
        finite_mm = slab.displacement(finite.unknowns)
        wider = touch.end_mm(finite.pressure, finite_mm) / touch.end_mm(linear.pressure)
        return _Pair(
            read=partial(grid.read_about, self._axis),
            linear_mm=linear_mm,
            change=finite_mm - linear_mm,
            moved=moved,
            wider=np.array([wider]),
            touch=touch,
            linear=linear,
            finite=finite,
        )

    def settled(
        self,
        slab: Slab,
        touch: _Touch,
        state: _Balance,
        force: float,
        *,
        linear: bool,
        to: float = _TOLERANCE,
    ) -> _Balance:
        """Take Newton's steps until one moves nothing."""

        def after(state: _Balance, stiffness: Factor) -> _Balance:
            internal = slab.internal(state.unknowns, linear=linear)
            loose = state.unknowns + slab.moved_by(stiffness, -internal, _RESIDUAL)
            push = np.zeros(slab.size)
            # With the present tangent one step of contact converges as fast as the rubber does.
            most = _BALANCES if stiffness is slab.rest_stiffness else 1
            now, push[slab.nodal] = touch.balanced(
                slab, state, loose[slab.nodal], stiffness, force, most, linear=linear
            )
            return replace(now, unknowns=loose + slab.moved_by(stiffness, push, _RESIDUAL))

        def renewed(state: _Balance) -> _Balance:
            return after(state, slab.stiffness(slab.tangent(state.unknowns)))

        if linear:
            state = after(state, slab.rest_stiffness)
        else:
            try:
                state = slab.mixed(after, state, _STEPS, to)
            except NotSettled:
                state = slab.newton(renewed, state, _STEPS, to)
        last = touch.rest_mm[-_POINTS:][state.pressure[-_POINTS:] > 0.0]
        MixedRubber.check_reach(last * math.inf, _REACH)
        return state


def _to_side_mm(body: Body, place: Floats) -> float:
    """Return how far a place is from the nearest side of a block, mm."""
    low, high = np.array(body.bounds_mm)
    return float(np.concatenate([place - low, high - place])[[0, 1, 3, 4]].min())


def _shapes(place: Floats) -> tuple[Floats, Floats, Floats]:
    """Return quadratic shapes (n, 3), their slopes, and linear shapes (n, 2) at places (n,), -1 to
    1."""
    x = place
    values = np.column_stack([x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0])
    slopes = np.column_stack([x - 0.5, -2.0 * x, x + 0.5])
    return values, slopes, np.column_stack([1.0 - x, 1.0 + x]) / 2.0


class Slab(MixedRubber):
    """Rubber in the shape of a slab of revolution, held below."""

    @dataclass(frozen=True, eq=False)
    class Grid:
        """Rectangles between ``r_mm`` (I + 1,) and ``z_mm`` (J + 1,).

        The first ``touching`` of them along r may touch the probe.
        """

        r_mm: Floats
        z_mm: Floats
        touching: int

        @classmethod
        def graded(
            cls,
            finest_mm: tuple[float, float],
            count: int,
            reach_mm: float,
            share: float,
            radius_mm: float,
            thick_mm: float,
        ) -> Slab.Grid:
            """Return a grid with ``count`` elements at the surface between two radii, its finest.

            Elements up to ``reach_mm`` may touch the probe; ``share`` multiplies their numbers.
            """
            low, high = finest_mm
            count = round(share * count)
            first = (high - low) / count
            growth = 1.0 + (_GROWTH - 1.0) / share
            inner = low - _growing(first, growth, low, _LARGEST * high / share)[::-1]
            between = low + first * np.arange(1, count + 1)
            outer = high + _growing(first, growth, radius_mm - high)[1:]
            r_mm = np.concatenate([inner, between, outer])
            touching = int(np.searchsorted(r_mm, reach_mm))
            z_mm = _growing(first, growth, thick_mm, _DEEPEST * thick_mm / share)
            return cls(r_mm, z_mm, touching)

        @cached_property
        def shape(self) -> tuple[int, int]:
            """Nodes along r and z."""
            return 2 * len(self.r_mm) - 1, 2 * len(self.z_mm) - 1

        @cached_property
        def places(self) -> Floats:
            """Nodes (N, 2): r and z, mm."""
            lines = [
                np.interp(np.arange(count) / 2.0, np.arange(len(line)), line)
                for count, line in zip(self.shape, (self.r_mm, self.z_mm), strict=True)
            ]
            return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)

        def read(self, points: Floats) -> tuple[Ints, Floats, Floats]:
            """Return the nodes (n, 9) of the elements at points (n, 2), their shapes (n, 9), and
            the slopes of these (n, 9, 2)."""
            parts = []
            for line, place in zip((self.r_mm, self.z_mm), points.T, strict=True):
                cell = np.clip(np.searchsorted(line, place, side="right") - 1, 0, len(line) - 2)
                half = (line[cell + 1] - line[cell]) / 2.0
                value, slope, _ = _shapes((place - line[cell]) / half - 1.0)
                parts.append((2 * cell[:, None] + np.arange(3), value, slope / half[:, None]))
            (along_r, at_r, slope_r), (along_z, at_z, slope_z) = parts

            def crossed(r: Floats, z: Floats) -> Floats:
                return (r[:, :, None] * z[:, None, :]).reshape(-1, 9)

            nodes = self.shape[1] * along_r[:, :, None] + along_z[:, None, :]
            slopes = np.stack([crossed(slope_r, at_z), crossed(at_r, slope_z)], axis=2)
            return nodes.reshape(-1, 9), crossed(at_r, at_z), slopes

        def read_about(self, axis: Floats, points: Points, field: Floats) -> tuple[Points, Floats]:
            """Return the values (n, 3) and gradients (n, 3, 3) of a field (N, 2) at points (n, 3).

            The slab stands about an axis (x, y); beyond its rim the values are 0.
            """
            away = points[:, :Z] - axis
            r = np.linalg.norm(away, axis=1)
            out = np.where(r[:, None] > 0.0, away / np.maximum(r, 1e-300)[:, None], [1.0, 0.0])
            place = np.column_stack([r, points[:, Z]])
            nodes, shapes, slopes = self.read(np.minimum(place, [self.r_mm[-1], self.z_mm[-1]]))
            own = np.einsum("na,nai->ni", shapes, field[nodes])
            own[r > self.r_mm[-1]] = 0.0
            along = np.einsum("nai,naj->nij", field[nodes], slopes)
            axes = np.zeros((len(points), 3, 3))  # rows: r, about, z
            axes[:, 0, :Z] = out
            axes[:, 1, 0] = -out[:, 1]
            axes[:, 1, 1] = out[:, 0]
            axes[:, 2, 2] = 1.0
            gradient = np.zeros((len(points), 3, 3))
            gradient[:, ::2, ::2] = along
            gradient[:, 1, 1] = np.where(r > 0, own[:, 0] / np.maximum(r, 1e-12), along[:, 0, 0])
            values = np.column_stack([out * own[:, :1], own[:, 1]])
            return values, np.asarray(axes.transpose(0, 2, 1) @ gradient @ axes)

    _axes = 2

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
        # What each of an element's 18 displacements adds to `_ENTRIES` of F
        part = np.zeros((*r.shape, 9, 2, len(_ENTRIES)))
        part[..., 0, :2] = slopes
        part[..., 0, 2] = values / r[..., None]
        part[..., 1, 3:] = slopes
        self._part = part.reshape(*r.shape, 18, len(_ENTRIES))
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
        self._hold(held, number[: 2 * grid.touching + 1, 0])
        quarter = np.repeat(self._volume.sum(axis=1) / 18.0 / self._shear, 4)
        self._scale = MixedRubber.gathered(self._row[:, 18:], quarter, self.size)
        corner_node = number[::2, ::2].ravel()
        self._node = np.concatenate([np.repeat(number.ravel(), 2), corner_node])

    def carried(self, grid: Slab.Grid, unknowns: Floats) -> Floats:
        """Return the unknowns of a slab of another grid on this one's."""
        from scipy.interpolate import RegularGridInterpolator

        count = len(grid.places)
        within = np.minimum(self.grid.places, grid.places[-1])
        nodes, values, _ = grid.read(within)
        moved = np.einsum("na,nai->ni", values, unknowns[: 2 * count].reshape(-1, 2)[nodes])
        pressure = unknowns[2 * count :].reshape(len(grid.r_mm), -1)
        corners = within.reshape(*self.grid.shape, 2)[::2, ::2].reshape(-1, 2)
        known = RegularGridInterpolator((grid.r_mm, grid.z_mm), pressure)
        return np.concatenate([moved.ravel(), known(corners)])

    def _gradient(self, moved: Floats, some: Ints) -> Floats:
        part = self._part[some]
        gradient = np.zeros((*part.shape[:2], 9))
        gradient[..., _ENTRIES] = (moved[:, None, None] @ part)[:, :, 0]
        return gradient.reshape(*part.shape[:2], 3, 3) + np.eye(3)

    def _forces(self, stress: Floats) -> Floats:
        flat = stress.reshape(*stress.shape[:2], 9, 1)[:, :, _ENTRIES]
        return np.asarray((self._part @ flat).sum(axis=1)[..., 0])

    def _stiffness(self, slope: Floats, some: Ints) -> Floats:
        part = self._part[some]
        count, places = part.shape[:2]
        own = slope.reshape(count, places, 9, 9)[:, :, _ENTRIES[:, None], _ENTRIES]
        half = (part @ own).transpose(0, 2, 1, 3).reshape(count, 18, -1)
        return np.asarray(half @ part.swapaxes(2, 3).reshape(count, -1, 18))

    def _swelling(self, cofactor: Floats, some: Ints) -> Floats:
        flat = cofactor.reshape(*cofactor.shape[:2], 9, 1)[:, :, _ENTRIES]
        return np.asarray((self._part[some] @ flat)[..., 0])


class _Touch:
    """The integration points (q,) of the slab's surface that a probe may touch, and the springs
    between them, for a contact of a size."""

    def __init__(self, grid: Slab.Grid, shape: Shape, size_mm: float) -> None:
        self.grid = grid
        self.spring = _SPRING / size_mm
        self.gap_weight = _GAP_WEIGHT / size_mm
        r = grid.r_mm[: grid.touching + 1]
        half = np.diff(r) / 2.0
        self.rest_mm = (r[:-1, None] + half[:, None] * (1.0 + _PLACES)).ravel()
        self.area_mm2 = 2.0 * math.pi * self.rest_mm * (half[:, None] * _WEIGHTS).ravel()
        points = np.column_stack([self.rest_mm, np.zeros(len(self.rest_mm))])
        nodes, values, _ = grid.read(points)
        nodes, values = nodes.reshape(-1, 3, 3)[:, :, 0], values.reshape(-1, 3, 3)[:, :, 0]
        self.number, local = np.unique(nodes, return_inverse=True)
        self.weights = np.zeros((len(nodes), len(self.number)))
        np.put_along_axis(self.weights, local.reshape(nodes.shape), values, axis=1)
        self._border_mm = r
        self._shape = shape

    def gaps(self, moved: Floats, place: float, *, linear: bool) -> tuple[Floats, Floats, Floats]:
        """Return gaps along z (q,), their slopes by the points' places (q, 2), and how these change
        with r (q,), where the nodes that may touch (m, 2) moved to: the linear ones at the
        undeformed places."""
        shift = self.weights @ moved
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

    def balanced(
        self,
        slab: Slab,
        state: _Balance,
        loose: Floats,
        stiffness: Factor,
        force: float,
        most: int,
        *,
        linear: bool,
    ) -> tuple[_Balance, Floats]:
        """Return the state in which contact balances the slab condensed to the nodes that may
        touch, and the forces on these (m,); ``loose`` is where they are without contact."""
        free = slab.nodal_free
        moved = state.unknowns[slab.nodal]
        spring = self.spring
        for _ in range(most):
            gap, push, curvature = self.gaps(moved.reshape(-1, 2), state.pose, linear=linear)
            weighed = state.pressure - self.gap_weight * (gap + state.pressure / spring)
            active = weighed > 0.0 if state.pressure.any() else state.active
            active = active & np.isfinite(gap)
            if not active.any():
                raise NotSettled(
                    "contact: at finite strain the probe touches nothing: press further"
                )
            on = np.flatnonzero(active)
            weight, area = self.weights[on], self.area_mm2[on]
            closing = (weight[:, :, None] * push[on, None, :]).reshape(len(on), -1)
            matrix = closing.T @ ((spring * area)[:, None] * closing)
            bent = area * state.pressure[on] * curvature[on]
            matrix[::2, ::2] -= weight.T @ (bent[:, None] * weight)
            # The nodes' way and the probe's, which the force holds
            follow = (spring * area) @ closing
            amiss = -closing.T @ (spring * area * gap[on])
            amiss[free] -= stiffness.schur @ (moved - loose)[free]
            border = follow[free]
            whole = np.block(
                [
                    [stiffness.schur + matrix[np.ix_(free, free)], -border[:, None]],
                    [-border, np.array([[spring * area.sum()]])],
                ]
            )
            found = np.linalg.solve(whole, np.append(amiss[free], force + spring * area @ gap[on]))
            step, motion = np.zeros(len(moved)), float(found[-1])
            step[free] = found[:-1]
            moved = moved + step
            pressure = np.zeros(len(active))
            pressure[on] = -spring * (gap[on] + closing @ step - motion)
            settled = np.array_equal(active, state.active)
            state = replace(state, pose=state.pose + motion, pressure=pressure, active=active)
            largest = max(np.abs(moved).max(), abs(state.pose))
            settled &= max(np.abs(step).max(), abs(motion)) < _BALANCED * largest
            if settled or most == 1:
                bearing = np.zeros(len(moved))
                bearing[free] = stiffness.schur @ (moved - loose)[free]
                return state, bearing
        raise NotSettled("contact: at finite strain the probe does not come to balance")

    def end_mm(self, pressure: Floats, displacement: Floats | None = None) -> float:
        """Return how far from the axis the contact ends, mm: at rest, or after a displacement.

        Close to the end the force beyond r is nearly as (a^2 - r^2)^1.5. Its power 2/3 is
        extrapolated over r^2 by a parabola: a sum has less noise than the pressures.
        """
        ring = (pressure * self.area_mm2).reshape(-1, _POINTS).sum(axis=1)
        beyond = np.append(np.cumsum(ring[::-1])[::-1], 0.0) / ring.sum()
        least, most = _BEYOND
        last = np.flatnonzero(beyond > least)
        last = last[-max(_FITTED, int(np.sum(beyond[last] < most))) :]
        squared = self._border_mm[last] ** 2
        ends = np.polynomial.Polynomial.fit(squared, beyond[last] ** (2.0 / 3.0), 2).roots()
        end = math.sqrt(ends[np.argmin(np.abs(ends - squared[-1]))].real)
        if displacement is None:
            return end
        aside = self.weights @ displacement[self.number, 0]
        return end + float(np.interp(end, self.rest_mm, aside))


@dataclass(frozen=True)
class _Balance:
    """A state: the slab's unknowns, the probe's pose along z, mm, the (q,) pressures over Young's
    modulus, and the points at which they were sought."""

    unknowns: Floats
    pose: float
    pressure: Floats
    active: Bools


@dataclass(frozen=True, kw_only=True)
class _Pair(FiniteStrain.Solutions):
    """Both solutions on a slab, from which those on another may start."""

    touch: _Touch
    linear: _Balance
    finite: _Balance

    def on(self, slab: Slab, touch: _Touch, state: _Balance) -> _Balance:
        """Return one of these solutions on another slab."""
        pressure = np.interp(touch.rest_mm, self.touch.rest_mm, state.pressure, right=0.0)
        unknowns = slab.carried(self.touch.grid, state.unknowns)
        return replace(state, unknowns=unknowns, pressure=pressure, active=pressure > 0.0)


def _growing(first: float, growth: float, end: float, most: float = math.inf) -> Floats:
    """Return places from 0 to ``end``: elements from a length on, each ``growth`` times as long as
    the last one and not longer than ``most``, all shrunk to end there."""
    lengths = [first]
    while sum(lengths) < end:
        lengths.append(min(growth * lengths[-1], most))
    places = np.concatenate([[0.0], np.cumsum(lengths)])
    return np.asarray(places * (end / places[-1]))
