"""Rubber at finite strain on any mesh: quadratic displacement and linear pressure as unknowns, sums
over elements, and Newton's steps. The stress is a `twin.world.elasticity.strain_law.StrainLaw`,
whose tangent at rest is linear theory.

`twin.world.contact.round_slab` and `twin.world.contact.whole_body` are the two meshes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.errors import ContactError, NotSettled, SolveError
from twin.parts.material import Material, shear_modulus
from twin.world.elasticity.factor import Factor
from twin.world.elasticity.strain_law import cofactor_slope, cofactors, strain_law

LOAD_STEPS = 0.2, 1.5, 0.01
"""First step of the force where Newton's steps fail from the linear solution, over the force, how
each grows from the one before, and the least to which it is halved where they fail again."""

_MIXED, _MIXED_TO = 5, 0.2
"""How many changes are mixed, and how much shorter the last mixed step is than Newton's, after
which less is left."""


class _Solved(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def unknowns(self) -> Floats: ...

    @property
    def pose(self) -> Any: ...

    @property
    def pressure(self) -> Floats: ...


State = TypeVar("State", bound=_Solved)


class _Settle(Protocol[State]):
    def __call__(self, state: State, share: float, *, linear: bool) -> State: ...


def _onward(state: State, before: State | None, share: float) -> State:
    """Return a state extrapolated by a share of its change since the state before, or since
    rest."""

    def on(name: str) -> Any:
        now = getattr(state, name)
        return now + share * (now - (getattr(before, name) if before else 0.0))

    return replace(state, **{name: on(name) for name in ("unknowns", "pose", "pressure")})


class MixedRubber:
    """Rubber of E = 1 MPa, held at some nodes.

    Its unknowns are the displacements of every node, mm, then the pressures of the corners, MPa. A
    mesh gives ``_axes`` (displacements of a node), ``_moves`` (the number of displacements),
    ``_row`` (m, r) (the unknowns of an element, last the pressures), ``_volume`` (m, q) and
    ``_shares`` (q, corners) of the integration points, ``_scale`` and ``_node`` (`Factor`'s
    arguments for all unknowns), the methods that raise NotImplementedError, for some elements (m,),
    and calls `_hold`.

    Attributes
    ----------
    nodal
        (m,) Displacements of the nodes that may touch.
    nodal_free
        (m,) Which of them are not held: to these stiffnesses are condensed (`Factor.schur`).
    """

    _axes: int
    _moves: int
    _row: Ints
    _volume: Floats
    _shares: Floats
    nodal: Ints
    nodal_free: Bools
    _free: Ints
    _scale: Floats
    _node: Ints
    size: int

    def __init__(self, material: Material) -> None:
        nu = material.poisson_ratio
        self._law_name = material.law
        self._law = strain_law(material)
        self._shear = shear_modulus(1.0, nu)
        apart = 1.0 - 2.0 * nu
        self._softness = apart / (self._shear * (2.0 * nu - self._law.bulk * apart))

    def _hold(self, held: Bools, touching: Ints) -> None:
        """Hold some of the unknowns (n,); ``touching`` (k,) are the nodes that may touch."""
        self._free = np.flatnonzero(~held)
        self.nodal = (self._axes * touching[:, None] + np.arange(self._axes)).ravel()
        self.nodal_free = ~held[self.nodal]

    def displacement(self, unknowns: Floats) -> Floats:
        """Return the displacement (N, axes) of the nodes, mm."""
        return unknowns[: self._moves].reshape(-1, self._axes)

    def resistance(self, unknowns: Floats) -> Floats:
        """Return the forces with which the rubber resists, and what is amiss with its volume."""
        every = np.arange(len(self._row))
        gradient, cofactor, ratio, pressure = self._strained(unknowns, every)
        stress = self._shear * self._law.stress(gradient, cofactor, ratio)
        stress += pressure[..., None, None] * cofactor
        stress *= self._volume[..., None, None]
        swollen = ((ratio - 1.0 - self._softness * pressure) * self._volume) @ self._shares
        return MixedRubber.gathered(
            self._row, np.hstack([self._forces(stress), swollen]), self.size
        )

    def internal(self, unknowns: Floats, *, linear: bool) -> Floats:
        """Return the forces with which the rubber resists, by linear theory or at finite strain."""
        return np.asarray(self.at_rest @ unknowns) if linear else self.resistance(unknowns)

    def tangent(self, unknowns: Floats) -> Any:
        """Return the sparse symmetric slope of `resistance`."""
        blocks = self._blocks(unknowns, np.arange(len(self._row)))
        return MixedRubber.summed(blocks, self._row, self.size)

    def stiffness(self, tangent: Any) -> Factor:
        """Return the factor of the free unknowns' tangent, condensed to those that may touch."""
        free = self._free
        last = np.searchsorted(free, self.nodal[self.nodal_free]) if len(self.nodal) else None
        return Factor(tangent[free][:, free], self._scale[free], node=self._node[free], last=last)

    @cached_property
    def rest_stiffness(self) -> Factor:
        """That of linear theory."""
        return self.stiffness(self.at_rest)

    def moved_by(self, stiffness: Factor, forces: Floats, residual: float) -> Floats:
        """Return the changes of the unknowns under forces, (n,) or (n, m)."""
        out = np.zeros_like(forces)
        out[self._free] = stiffness.solve(forces[self._free], residual)
        return out

    @cached_property
    def at_rest(self) -> Any:
        """The tangent of linear theory."""
        return self.tangent(np.zeros(self.size))

    def _gradient(self, moved: Floats, some: Ints) -> Floats:
        """Return F (m, q, 3, 3) from the displacements."""
        raise NotImplementedError

    def _forces(self, stress: Floats) -> Floats:
        """Return (m, r) the forces of the stress (m, q, 3, 3) times the volume."""
        raise NotImplementedError

    def _stiffness(self, slope: Floats, some: Ints) -> Floats:
        """Return (m, r, r) the slopes of the forces from that of the stress."""
        raise NotImplementedError

    def _swelling(self, cofactor: Floats, some: Ints) -> Floats:
        """Return (m, q, r) the slopes of J by the displacements."""
        raise NotImplementedError

    def _strained(self, unknowns: Floats, some: Ints) -> tuple[Floats, Floats, Floats, Floats]:
        """Return F, cof F, J and the pressure at the integration points of some elements."""
        own = unknowns[self._row[some]]
        corners = self._shares.shape[1]
        gradient = self._gradient(own[:, :-corners], some)
        return gradient, *cofactors(gradient), own[:, -corners:] @ self._shares.T

    def _blocks(self, unknowns: Floats, some: Ints) -> Floats:
        """Return the slopes (m, r, r) of some elements (m,)."""
        gradient, cofactor, ratio, pressure = self._strained(unknowns, some)
        volume = self._volume[some]
        cofactor_change = cofactor_slope(gradient)
        slope = self._shear * self._law.slope(gradient, cofactor, ratio, cofactor_change)
        slope += pressure[..., None, None, None, None] * cofactor_change
        slope *= volume[..., None, None, None, None]
        weighted = volume[..., None] * self._shares
        by_volume = self._swelling(cofactor, some).swapaxes(1, 2) @ weighted
        moves = by_volume.shape[1]
        size = self._row.shape[1]
        block = np.empty((len(some), size, size))
        block[:, :moves, :moves] = self._stiffness(slope, some)
        block[:, :moves, moves:] = by_volume
        block[:, moves:, :moves] = by_volume.swapaxes(1, 2)
        block[:, moves:, moves:] = -self._softness * (self._shares.T @ weighted)
        return block

    @staticmethod
    def gathered(rows: Ints, parts: Floats, size: int) -> Floats:
        """Return the (size,) sum of parts at ``rows``, of as many numbers."""
        return np.bincount(rows.ravel(), parts.ravel(), size).astype(float)

    @staticmethod
    def summed(blocks: Floats, rows: Ints, size: int) -> Any:
        """Return the sparse (size, size) sum of blocks (m, r, r) at rows (m, r)."""
        from scipy.sparse import csr_matrix

        # A sum of rows of the blocks, as a product: it takes a third of the time of sorting pairs
        count, wide = rows.size, rows.shape[1]
        ends = np.arange(0, wide * count + 1, wide)
        columns = np.repeat(rows, wide, axis=0).ravel()
        every = csr_matrix((blocks.ravel(), columns, ends), shape=(count, size))
        gather = csr_matrix((np.ones(count), (rows.ravel(), np.arange(count))), (size, count))
        return gather @ every

    @staticmethod
    def largest(vectors: Floats) -> float:
        """Return the length of the longest of vectors (n, axes)."""
        return float(np.linalg.norm(vectors, axis=1).max())

    @staticmethod
    def check_reach(away: Floats, reach: float) -> None:
        """Raise a ContactError where points touch that are as far ``away`` as any that may.

        Both are distances over the contact's radius by linear theory.
        """
        if away.max(initial=0.0) > reach:
            raise ContactError(
                f"contact: at finite strain it grows beyond {reach:g} times its size by linear "
                "theory: press with less force, or set material.law = linear"
            )

    @staticmethod
    def mixing(seen: int, most: int) -> Callable[[Floats], Floats]:
        """Return what takes the place (n,) where a step ended, and returns where to begin the next
        one: there steps that tend to a place likely change nothing.

        The ends of the last ``most`` steps and one are mixed so that what they changed cancels best
        (D. G. Anderson 1965, J. ACM 12), by the ``seen`` first numbers of a place.
        """
        begun: deque[Floats] = deque(maxlen=most + 1)
        ended: deque[Floats] = deque(maxlen=most + 1)

        def start(place: Floats) -> Floats:
            if begun:
                ended.append(place)
            if len(ended) > 1:
                ends = np.array(ended)
                change = (ends - np.array(begun))[:, :seen]
                share = np.linalg.lstsq(np.diff(change, axis=0).T, change[-1], 1e-8)[0]
                place = place - share @ np.diff(ends, axis=0)
            begun.append(place)
            return place

        return start

    def mixed(
        self, after: Callable[[State, Factor], State], state: State, steps: int, tolerance: float
    ) -> State:
        """Return the state at finite strain after steps of `newton` by the stiffness at rest, of
        which ``after`` takes one. The last ones are mixed: to factor a tangent takes as long as
        five to ten such steps. They end at ``_MIXED_TO`` of the tolerance."""
        mix = MixedRubber.mixing(self._moves, _MIXED)

        def begin(state: State) -> State:
            return replace(state, unknowns=mix(state.unknowns))

        def at_rest(state: State) -> State:
            return after(state, self.rest_stiffness)

        return self.newton(at_rest, state, steps, _MIXED_TO * tolerance, begin)

    @staticmethod
    def loaded(settle: _Settle[State], linear: State, *, at_once: bool = False) -> State:
        """Return the finite-strain solution: from the linear one, else, unless ``at_once``, in load
        steps. ``settle`` returns the solution that begins at a state, under a share of the force.
        """
        try:
            return settle(linear, 1.0, linear=False)
        except NotSettled:
            if at_once:
                raise
        step, growth, least = LOAD_STEPS
        state = settle(_onward(linear, None, step - 1.0), step, linear=True)
        before: State | None = state
        gone, done = step, 0.0
        while done < 1.0:
            step = min(step, 1.0 - done)
            try:
                after = settle(_onward(state, before, step / gone), done + step, linear=False)
            except NotSettled:
                step /= 2.0
                if step < least:
                    raise
            else:
                before, state = (state, after) if done else (None, after)
                gone, done, step = step, done + step, growth * step
        return state

    @np.errstate(over="ignore", invalid="ignore")
    def newton(
        self,
        after: Callable[[State], State],
        state: State,
        steps: int,
        tolerance: float,
        begin: Callable[[State], State] | None = None,
    ) -> State:
        """Take Newton's steps until one moves no node by more than ``tolerance`` of the largest
        displacement. Each begins where the last one ended, or where ``begin`` puts it. Numbers may
        overflow in steps that diverge.

        Raises
        ------
        NotSettled
            ``steps`` don't suffice, or one fails.
        """
        problem: Exception | None = None
        try:
            for _ in range(steps):
                state = state if begin is None else begin(state)
                before = self.displacement(state.unknowns)
                state = after(state)
                moved = self.displacement(state.unknowns)
                step = MixedRubber.largest(moved - before) / MixedRubber.largest(moved)
                if step < tolerance:
                    return state
                if not math.isfinite(step):
                    break
        except (NotSettled, SolveError) as found:
            problem = found
        harder = ""
        if self._softness:  # a made sensor's ratio differs from the recipe's by its tolerance
            harder = "material.poisson_ratio = 0.5 (and tolerance.poisson_ratio = 0) or "
        raise NotSettled(
            f"contact: at finite strain (material.law = {self._law_name}) Newton's steps did not "
            f"converge in {steps}: press with less force, with a larger or rounder probe "
            f"(press.probe.edge_mm of a flat face), or set {harder}material.law = linear"
        ) from problem
