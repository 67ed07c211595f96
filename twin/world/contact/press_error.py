"""The estimated error of a press.

The error has up to three parts:

**Body.** Where the surface would move by e more under the forces found (`displacement_errors` of a
compliance), the forces change by df and the probe's free motions by dq:

    C df - M dq = -e,    M^T df = 0 along each motion that is held by force

on the patches in contact, slipping ones along their drag; exact to first order.

**Patches.** The same press is solved on wider patches (on narrower ones where there are few), and
compared. Under a smooth probe patches cut the contact's border by chance, so the difference may
vanish. Under a sphere or a cone the error is that of Hertz's contact with the same border on the
same patches; else one proportional to the square of the width is added. The tractions' error comes
from how they bend from patch to patch, and takes no other solve.

**Parts of a path** (friction). The same press is solved in half as many parts.

Validity: the body's own estimate, to first order. Under a sharp rim or tip the traction grows
without bound. Linear theory's own error is separate (`Validity`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import ContactError
from twin.parts.load import Load, Rectangles
from twin.parts.material import plane_strain_modulus
from twin.parts.press import Cone, Pillar, Sphere
from twin.theory import halfspace
from twin.world.contact.contact_problem import LoadProgramme, ProbeSetup
from twin.world.contact.contact_state import ContactState, PressError, Share
from twin.world.contact.probe_gap import MOTIONS, TURN, X, Y, Z
from twin.world.contact.surface_patches import Box, Patches

_Solve = Callable[[LoadProgramme, int], tuple[list[ContactState], str]]
"""Takes a programme's path in so many parts a step; returns the states, and why it stopped."""

_FEWEST_COMPARED = 6
"""Patches in contact from which on tractions are estimated; patches across a contact at least."""

_FEW_ON_RIM, _OF_FINER = 14, 2.0
"""Patches across a rounded rim below which it is solved on 1.5 and 2 times as many, as 6 and 8 miss
it alike. Error over the larger change: the order may be the first."""

_MOST_RESPONDING = 600
"""Patches in contact from which on its response is computed on fewer, and what they cut isn't: the
time grows with their cube."""

_ORDER, _ORDER_SHARP, _ORDER_RIM, _ORDER_ROUNDED = 1.8, 1.3, 1.6, 2.1
_ALIKE = 1.3
"""Order of the error in the width of patches: of smooth contacts, under flat faces with sharp rims,
under rounded rims, and where patches are graded up to a place on these; and the least ratio of
widths that counts. At 8 to 16 against 40 error over the change with twice the width: 0.6 inclined
by 2 to 4 degrees (1.3 is 0.68), 0.07 to 0.28 on round rounded rims; less elsewhere."""

_ORDER_BELOW, _ORDER_BELOW_SQUARE = 1.55, 1.9
"""Order of the error of markers below upright faces with sharp rims; and where none is round and
other patches are twice as wide. Error over the change with twice the width, at 12 to 24 across
against 36, on a half-space and layers 0.5 to 1.3 widths thick: 0.14 to 0.61 below discs, whose rows
end in steps (0.52 is stated, and `_CUT_SHARP`), 0.14 to 0.34 below squares and oblongs (0.37). With
4/3 of it up to 1.77 below these (1.78)."""

_CUT = 0.38
"""Error of a smooth probe's force at a given depth, times the square of the patches across, on
thick rubber, where nothing better is known (`_Border.as_hertz`)."""

_AS_HERTZ, _LEFT, _LEFT_THIN = 1.2, 0.08, 2.0
"""Least error of the force under a sphere or a cone over `_Border.as_hertz`, what is added, times
the patches in contact, and how many times `thin` that grows. Measured under 22 balls and 18 cones
at 8 to 20 patches across against 40: up to 0.08 are missed; 0.21 on rubber thinner than the
contact's radius."""

_WHOLE = 0.75
"""Error of the force sideways where patches stick as a whole, over what their area is too large by:
about half on a half-space, where it grows with the radius, and all on a thin layer."""

_CUT_STUCK = 0.25
"""Least error of the force sideways where patches stick up to the border of a smooth contact, times
the patches across. Measured against Mindlin's: 0.0 to 0.35."""

_ASTRAY = 0.8
"""Error of the force where patches miss an object's sharp edges, over what the singularities there
make of it. Measured at 7 to 17 across: 0.35 to 0.8 under flat faces of any shape and turn."""

_OUTWARDS, _STEP, _HALVINGS, _FOLDED = 1.5, 0.1, 8, 3.0
"""How far beyond a patch's middle an object's edge is looked for, and the step over which its gap
is taken there, in patches; bisections; and how many times as fast as within a patch the gap grows
at an edge. Of a smooth border it is less than twice."""

_BETWEEN, _MOST_BETWEEN, _HOLDS_OFF = (4, 16), 40_000, 2.0
"""Places along each axis of a patch at which the object's height is looked at, and in all; and over
what width a fin narrower than a patch holds the rubber off its sides, over its height."""

_BENT = {True: 0.18, False: 0.34}
"""Error of the tractions over their second differences from patch to patch, both RMS; by whether
the probe is a ball, or a cone whose tip is rounder than a patch is wide or lies in its middle.
Linear interpolation leaves up to an eighth of a difference; between patches it misses a tip's peak.
Measured at 6 to 24 across against 36 to 40: 0.08 to 0.172 under balls, 0.09 to 0.155 under such
cones, up to 0.335 elsewhere."""

_CUT_WITHIN, _CUT_FREE, _OF_SMOOTH = 0.15, 0.5, 0.8
"""Error of the force under a flat face that a curved body bends away from, times the patches over
pi; under an object's smooth borders, over `_Border.by_chance`; and what of it sharp borders lack.
Measured under 28 objects at 8, 11 and 14 across against 36, and on a lying cylinder 6 patches wide:
up to 0.47."""

_CUT_FREE_THIN = 2.0
"""How many times `thin` both grow."""

_CUT_SHARP, _SMALLER = {True: 0.05, False: 0.008}, 0.02
"""Least error of the force under a flat face with a sharp rim at a given depth, times the patches
across, over `_growth`, by whether it is round; and by how much a contact is shrunk to see what that
does to markers under a given force. Measured at 8 to 24 across: up to 0.045 under discs, whose
rows end in steps, 0.005 under squares."""

_CUT_RIM = 0.2
"""The same under a flat face so inclined that it touches with its rim, times the patches across.
Measured at 8 to 20 across against 30 to 35 under twelve faces inclined by 16 to 30 degrees: up to
0.27, of which other patches tell all but 0.2."""

_CUT_CORNER, _ASKEW = 0.45, 0.02
"""The same where it touches with a corner, and the least ratio of its two tilts there. Measured
under ten pillars likewise: up to 0.44, once 0.8."""

_WALLS = 0.12
"""Error of the force as patches end at the rim of an inclined flat face, whose side wall touches
too, over the square of the inclination. Measured under a pillar at 15 degrees: 0.09."""

_ASIDE = 0.4
"""Least error of what a flat face pushes sideways under a given force along z, over that, times the
patches across. Measured next to an edge: 0.05 to 0.41."""

_ROUNDED = {True: 0.15, False: 0.25}
"""Least error of the force under a flat face with a rounded rim, on which patches end by chance,
times the patches across, over the flat share of the face's half width; by whether the face is
round. A square one's sides lie along patches. Measured at 8 to 27 across against 34 to 40: up to
0.17 and 0.25, beside `_CUT`."""

_CUT_ROUNDED, _OF_RIM = 0.8, 0.08
"""Error of the force under such a face at a given depth, times the square of the patches across,
where these are graded up to where contact ends; of a round one where so much of the contact's half
width (of the rubber's thickness, if that is less) is on the rim, and in proportion below. Measured
at 8 to 20 across against 32 to 37: up to 0.9 under square ones, 0.74 under a round one. On thin
rubber it is as many times that as the force grows faster with the face (`_growth`)."""

_UNSEEN = 0.4
"""How much of either may be left where finer patches change less. Measured: 0.24 at most."""

_STIFFER = 1.5
"""How much faster a sphere's force grows than its indentation, relatively; a cone's 2."""

_FELT = 1e-9
"""Least pull, for each newton on a patch, by which a probe feels a motion."""

_BELOW_MM = 0.3
"""Depth below the patches of the points that count where none are watched: displacement is promised
from there on."""


class Estimates:
    """The errors of the states of one path, computed on the first use of one.

    Parameters
    ----------
    programme, states, increments, solve
        The path, the states at the ends of its steps, and how it was taken.
    watched
        Points inside the body, and what is to be done with estimates; None for the contact alone.
    """

    @dataclass(frozen=True, kw_only=True)
    class Watched:
        """Points whose displacement's error is of interest, and what takes the estimates.

        Attributes
        ----------
        points
            (n, 3), mm; if there are none, those 0.3 mm below the contact count.
        error
            Returns the estimated error of displacement there under a load, over the largest
            displacement.
        judge
            Called with every estimate.
        """

        points: Points
        error: Callable[[Load], float]
        judge: Callable[[PressError], None]

    def __init__(
        self,
        programme: LoadProgramme,
        states: list[ContactState],
        increments: int,
        solve: _Solve,
        watched: Watched | None,
    ) -> None:
        self._job = programme
        self._states = states
        self._increments = increments
        self._solve = solve
        self._watched = watched
        self._points = np.zeros((0, 3)) if watched is None else watched.points
        self._known: dict[int, list[_Border]] = {}
        self._motions: dict[int, Floats] = {}  # of the probes, by step, as the body errs

    def of(self, state: ContactState, step: int) -> PressError:
        """Return the error of the state at the end of a step."""
        if not state.load.terms:
            return self._recovering(state, step)
        others = self._others(step) if state.complete else []
        patches = increments = Share.unknown()
        if others:
            borders = self._borders(state, step)
            changed = Share()
            for number, other in others:
                change, factor = self._change(state, other), _OF_FINER
                markers = factor
                if not self._resolves_rims:
                    factor, markers = self._error_over_change(state, number, other, borders)
                known = replace(change.times(factor), markers=markers * change.markers)
                by_chance = self._sideways_by_chance(state, other, step, borders)
                known = known.at_least(Share(force=by_chance))
                changed = changed.at_least(known)
            patches = self._cut(state, step, changed)
        if not self._job.friction.any() and self._job.relaxation is None:
            increments = Share()
        elif others and step < len(self._fewer):
            fewer = self._fewer[step]
            whole = self._coarser[1][step]
            pairs = zip((whole, *whole.also), (fewer, *fewer.also), strict=True)
            traction = max(_traction_change(a, b) for a, b in pairs)
            increments = replace(self._change(whole, fewer), traction=traction)
            increments = increments.times(1.0 if self._increments > 1 else 2.0)
        error = PressError.of(body=self._body(state, step), patches=patches, increments=increments)
        if self._watched is not None:
            known = error if state.complete else PressError.of(body=error.body)
            self._watched.judge(known)
        return error

    def judge_at_once(self, state: ContactState, step: int) -> None:
        """Judge a state by what its patches alone leave, which takes no other solve."""
        if self._watched is None or not state.load.terms:
            return
        self._watched.judge(PressError.of(patches=self._cut(state, step, Share())))

    def _recovering(self, state: ContactState, step: int) -> PressError:
        """Return the error where no probe touches: of the motion that relaxing rubber still has."""
        body = patches = increments = Share()
        if state.load.moving.terms and self._watched is not None:
            others = self._others(step)
            body = Share(markers=self._watched.error(state.load))
            if not others or step >= len(self._fewer):
                patches = Share.unknown()
            else:
                same = [s for _, s in others]
                moved, whole, slow, *changed = (
                    self._half_space(s.load, self._points)
                    for s in (state, self._coarser[1][step], self._fewer[step], *same)
                )
                patches = Share(markers=max(_over(one - moved, moved) for one in changed))
                increments = Share(markers=_over(slow - whole, moved))
        error = PressError.of(body=body, patches=patches, increments=increments)
        if self._watched is not None:
            self._watched.judge(error)
        return error

    def _borders(self, state: ContactState, step: int) -> list[_Border]:
        """Return where each probe's contact ends at the end of a step."""
        if step not in self._known:
            pairs = zip(self._job.setups, (state, *state.also), strict=True)
            self._known[step] = [_Border(setup, one) for setup, one in pairs]
        return self._known[step]

    def _error_over_change(
        self, state: ContactState, number: int, other: ContactState, borders: list[_Border]
    ) -> tuple[float, float]:
        """Return the error over the change with ``number`` patches across, and that of markers: as
        much wider as those are fewer, but under objects, whose largest number of patches may end
        both alike."""
        wider = self._job.setups[0].across / number
        if any(one.is_free_form for one in self._job.setups):
            wider = _patch_mm(other) / _patch_mm(state)
        ratio = max(wider, 1.0 / wider, _ALIKE)
        order = below = _ORDER
        if any(one.setup.is_free_form and one.ends_sharply > 0.0 for one in borders if one.touches):
            below = _ORDER_BELOW
        if any(one.face is not None for one in self._job.setups):
            order = below = _ORDER_SHARP
            if not any(one.has_inclined_face for one in self._job.setups):
                is_round = any(one.face and one.face.is_round for one in self._job.setups)
                below = _ORDER_BELOW if is_round or ratio < 2.0 else _ORDER_BELOW_SQUARE
                if all(one.is_rounded for one in borders if one.touches):
                    order = below = _ORDER_RIM
            if all(one.is_graded and one.is_rounded for one in borders if one.touches):
                order = below = _ORDER_ROUNDED
        of_force, of_markers = 1.0 / (ratio ** np.array([order, below]) - 1.0) + (wider < 1.0)
        return float(of_force), float(of_markers)

    @cached_property
    def _resolves_rims(self) -> bool:
        """Whether there is a rounded rim under few patches."""
        rounded = any(one.face and one.face.edge_mm > 0.0 for one in self._job.setups)
        return rounded and self._job.setups[0].across < _FEW_ON_RIM

    @cached_property
    def _compared(self) -> list[tuple[int, list[ContactState]]]:
        """How many other patches are across, and the states on these: twice as wide, or narrower
        where those are too few, don't fit on the body, or miss a rim."""
        across = self._job.setups[0].across
        enough = [n for n in (across // 2, 3 * across // 4, 2 * across) if n >= _FEWEST_COMPARED]
        found: list[tuple[int, list[ContactState]]] = []
        for number in (3 * across // 2, 2 * across) if self._resolves_rims else enough:
            if states := self._on_other_patches(self._increments, number):
                found.append((number, states))
                if not self._resolves_rims:
                    break
        return found

    def _others(self, step: int) -> list[tuple[int, ContactState]]:
        """Return the states at a step's end on other patches, and how many are across."""
        return [(n, states[step]) for n, states in self._compared if step < len(states)]

    @cached_property
    def _coarser(self) -> tuple[int, list[ContactState]]:
        """The coarser of both, for what takes many solves."""
        own = self._job.setups[0].across, self._states
        return min([own, *self._compared[:1]], key=lambda one: one[0])

    @cached_property
    def _fewer(self) -> list[ContactState]:
        """The same in half as many parts; in twice as many where there is one only."""
        increments = self._increments // 2 if self._increments > 1 else 2
        return self._on_other_patches(increments, self._coarser[0])

    @cached_property
    def _few(self) -> list[ContactState]:
        """The states on as few patches as can be compared."""
        return self._on_other_patches(self._increments, _FEWEST_COMPARED)

    def _on_other_patches(self, increments: int, across: int) -> list[ContactState]:
        others = tuple(replace(one, across=across) for one in self._job.setups)
        try:
            return self._solve(replace(self._job, setups=others), increments)[0]
        except ContactError:
            return []

    def _change(self, one: ContactState, other: ContactState) -> Share:
        """Return what changes from one state to another, over what it is in the first."""
        pairs = list(zip((one, *one.also), (other, *other.also), strict=True))
        points = self._watched_below(one)
        moved = self._moved(one.load, points)
        return Share(
            force=max(_over(b.force_n - a.force_n, a.force_n) for a, b in pairs),
            indentation=max(
                _over(b.indentation_mm - a.indentation_mm, a.indentation_mm) for a, b in pairs
            ),
            markers=_over(self._moved(other.load, points) - moved, moved),
        )

    def _of_size(self, state: ContactState) -> float:
        """Return what a contact of another size but the same force changes at the markers, over
        what its force changes at a given depth: 1 close below it, less further away."""
        body = self._job.setups[0].body
        smaller, power = [], 1.0
        for one in (state, *state.also):
            if (term := one.patches) is None:
                continue
            middle = term.centre_mm.mean(axis=0)
            centre = middle + (1.0 - _SMALLER) * (term.centre_mm - middle)
            smaller.append(replace(term, centre_mm=centre, half_mm=(1.0 - _SMALLER) * term.half_mm))
            if body.is_flat:
                power = max(power, _growth(one.contact_radius_mm / body.base_z_mm))
        # On a curved surface the smaller contact would lie beside it.
        field = self._moved if body.is_flat else self._half_space
        points = self._watched_below(state)
        moved = field(state.load, points)
        return _over(field(Load(tuple(smaller)), points) - moved, moved) / (_SMALLER * power)

    def _watched_below(self, state: ContactState) -> Points:
        """Return the points that are watched, or those below the patches."""
        if len(self._points):
            return self._points
        patches = _joined(state.load)
        return patches.centre_mm + _BELOW_MM * patches.frames[:, 2]

    def _cut(self, state: ContactState, step: int, changed: Share) -> Share:
        """Return what patches leave: what other patches change, and where they cut the borders of
        contacts, which may change nothing by chance."""
        across = self._job.setups[0].across
        borders = self._borders(state, step)
        error = max(one.cut_error for one in borders)
        for setup in self._job.setups:
            if setup.has_inclined_face:
                incline = math.acos(min(1.0, float(setup.first.tilt[2, 2])))
                tilts = np.sort(np.abs(setup.first.tilt_deg[:2]))
                corner = isinstance(setup.probe, Pillar) and tilts[0] > _ASKEW * tilts[1]
                rim = (_CUT_CORNER if corner else _CUT_RIM) / across
                if setup.face is not None:
                    rim = _WALLS * math.tan(incline) ** 2
                error = max(error, rim)
        edge = rounded = 0.0
        for one in borders:
            face = one.setup.face
            if face is None or not one.touches:
                continue
            if not one.is_rounded:
                grown = _growth(one.half_width_mm / one.setup.body.base_z_mm)
                edge = max(edge, _CUT_SHARP[face.is_round] * grown / across)
                continue
            flat = 1.0 - face.edge_mm / min(face.half_mm)
            if one.is_graded:
                on_rim = 1.0 - flat * min(face.half_mm) / one.half_width_mm
                wide = one.half_width_mm / one.setup.body.base_z_mm
                cut = _CUT_ROUNDED * _growth(wide)
                if face.is_round:
                    cut *= min(1.0, on_rim * max(1.0, wide) / _OF_RIM)
                rounded = max(rounded, cut / across**2)
            else:
                edge = max(edge, (_ROUNDED[face.is_round] * flat + _CUT / across) / across)
        if self._resolves_rims and changed != Share():
            edge, rounded = _UNSEEN * max(edge, rounded), 0.0
        edge = max(edge, *(border.force_error for border in borders))
        deep, pushed = self._placed(state, step)
        border = Share(
            indentation=deep * max(error / _STIFFER, rounded), force=pushed * max(error, rounded)
        )
        aside = max(one.stuck_astray(self._moved_along(n, step)) for n, one in enumerate(borders))
        least = Share(indentation=deep * edge, force=math.hypot(pushed * edge, aside))
        if deep > 0.0 and any(setup.face is not None for setup in self._job.setups):
            least = least.at_least(Share(force=pushed * _ASIDE / across))
        border, least = (replace(one, markers=one.force) for one in (border, least))
        if deep * edge > 0.0 and changed != Share():
            least = replace(least, markers=least.force + deep * edge * self._of_size(state))
        sideways = max(
            self._stuck_border(number, border, step) for number, border in enumerate(borders)
        )
        whole = changed.plus(border)
        if all(one.as_hertz is not None for one in borders if one.touches):
            forces = changed if self._job.friction.any() else Share()
            whole = replace(forces.at_least(border), markers=whole.markers)
        whole = whole.at_least(least).plus(Share(force=sideways, markers=sideways))
        return replace(whole, traction=max(border.traction_error for border in borders))

    def _forced(self, step: int) -> int | None:
        """Return the last step up to this one whose depth a force gave."""
        forced = (one.by_force[Z::MOTIONS].all() for one in self._job.steps[: step + 1])
        return max((number for number, found in enumerate(forced) if found), default=None)

    def _placed(self, state: ContactState, step: int) -> tuple[float, float]:
        """Return how much of the error that a force has at a given place is the indentation's, and
        how much the force's. What a force placed, here or in a step before, has the given force at
        another depth; what motion added since is off as if all were placed by it."""
        number = self._forced(step)
        if number is None:
            return 0.0, 1.0
        last = state if number == step else self._states[number]
        by_force = self._job.steps[number].by_force.reshape(-1, MOTIONS)[:, : Z + 1]
        deep = pushed = 0.0
        for number, (now, then) in enumerate(
            zip((state, *state.also), (last, *last.also), strict=True)
        ):
            axes = self._job.setups[number].first.axes
            given = np.where(by_force[number], axes @ then.force_n, 0.0) @ axes
            deep = max(deep, _over(then.indentation_mm, now.indentation_mm))
            pushed = max(pushed, _over(now.force_n - given, now.force_n))
        return deep, pushed

    def _moved_along(self, number: int, step: int) -> Floats:
        """Return the axes (3, 3) along which motion holds a probe sideways, 0 for the others: what
        is held by force is as it should be."""
        held = self._job.steps[step].by_force[MOTIONS * number :][:Z, None]
        return np.where(held, 0.0, self._job.setups[number].first.axes[:Z])

    def _sideways_by_chance(
        self, state: ContactState, other: ContactState, step: int, borders: list[_Border]
    ) -> float:
        """Return what other patches change of the forces sideways under objects that stick, over
        the forces: as straight pieces of their borders are cut by chance, it has no order."""
        changes = [0.0]
        pairs = zip(borders, (state, *state.also), (other, *other.also), strict=True)
        for number, (border, one, two) in enumerate(pairs):
            if border.setup.is_free_form and border.stuck > 0.0:
                sideways = self._moved_along(number, step) @ (two.force_n - one.force_n)
                changes.append(_over(sideways, one.force_n))
        return max(changes)

    def _stuck_border(self, number: int, border: _Border, step: int) -> float:
        """Return the error of the force sideways, over it, as patches that a smooth probe's border
        cuts stick as a whole: what their area is too large by."""
        setup, state = border.setup, border.state
        if not (border.is_smooth or setup.is_free_form) or len(state.pressure_mpa) == 0:
            return 0.0
        counted = float(_areas(border.load).sum())
        axes = self._moved_along(number, step)
        excess = _WHOLE * abs(counted / state.area_mm2 - 1.0)
        least = _CUT_STUCK * math.sqrt(math.pi / len(state.pressure_mpa)) / 2.0
        if setup.is_free_form:  # its area is counted: patches stick as far as its edges are smooth
            least *= math.sqrt(border.longer) * (1.0 - border.ends_sharply)
        alike = max(excess, least) * _over(axes @ state.force_n, state.force_n)
        by_chance = least * _over(border.by_pieces(axes), state.force_n)
        return border.stuck * math.hypot(alike, by_chance)

    def _moved(self, load: Load, points: Points) -> Points:
        """Return (n, 3) how far a load moves points of the body, or of a half-space (E = 1 MPa)
        where its field isn't known there, mm: on thin rubber that tells too little."""
        setup = self._job.setups[0]
        field: Any = getattr(setup.compliance, "displacement", None)
        if field is None or not setup.body.contains(points).all():
            return self._half_space(load, points)
        return np.asarray(field(points, _joined(load.moving)))

    def _half_space(self, load: Load, points: Points) -> Points:
        """Return (n, 3) how far a load moves points of a half-space of E = 1 MPa, mm."""
        moved = np.zeros_like(points)
        for term in load.moving.terms:
            assert isinstance(term, Rectangles)
            moved += halfspace.displacement(points, term, 1.0, self._job.setups[0].poisson_ratio)
        return moved

    def _responded(
        self, state: ContactState, step: int
    ) -> tuple[_Response, list[tuple[Rectangles, Floats]], Points, Floats]:
        """Return the contact's response to the body's errors, on few patches if it can: what
        responds, the changes of its load and of the probes' places, and, of its patches, the motion
        and the errors (c, n, 3), mm."""
        used = state
        if state.complete:
            used = _alike(state, self._coarser[1], step)
            if len(used.slips) > _MOST_RESPONDING:
                used = _alike(used, self._few, step)
        response = _Response(self._job, step, used)
        errors_of: Any = getattr(self._job.setups[0].compliance, "displacement_errors", None)
        moved, errors = errors_of(response.patches.centre_mm, _joined(state.load))
        placed = np.zeros((len(errors), response.motions))
        last = self._forced(step)
        if last is not None and last < step and self._states[last].load.terms:
            if last not in self._motions:
                self._responded(self._states[last], last)
            if np.shape(self._motions[last]) == placed.shape:
                placed = self._motions[last]
        found = response.to(errors, placed)
        self._motions[step] = np.array([motions.ravel() for _, motions in found])
        return response, found, moved, errors

    def _body(self, state: ContactState, step: int) -> Share:
        """Return the error of the body's mesh or table."""
        if not hasattr(self._job.setups[0].compliance, "displacement_errors"):
            return Share()  # a closed form has no mesh
        response, found, moved, errors = self._responded(state, step)
        patches = response.patches
        probes = [one for one in (state, *state.also) if len(one.pressure_mpa)]
        markers = sum(_over(part, moved) for part in errors)
        if len(self._points) and self._watched is not None:
            markers = self._watched.error(state.load)
            markers += sum(
                _over(
                    self._half_space(Load((load,)), self._points),
                    self._half_space(Load((patches,)), self._points),
                )
                for load, _ in found
            )
        return Share(
            force=max(
                sum(_over(response.total(load)[number], probe.force_n) for load, _ in found)
                for number, probe in enumerate(probes)
            ),
            indentation=max(
                sum(_over(motion[number, Z], probe.indentation_mm) for _, motion in found)
                for number, probe in enumerate(probes)
            ),
            traction=sum(_rms_traction(load) for load, _ in found) / _rms_traction(patches),
            markers=markers,
        )


class _Response:
    """How the contact of a state responds to motions of the surface, to first order.

    Parameters
    ----------
    programme, step
        What holds the probes.
    state
        Its n patches in contact, of all probes that touch.

    Attributes
    ----------
    patches, motions
        These, and how many motions the probes have.
    """

    def __init__(self, programme: LoadProgramme, step: int, state: ContactState) -> None:
        patches = self.patches = _joined(state.load)
        touching = [(n, one) for n, one in enumerate((state, *state.also)) if len(one.pressure_mpa)]
        self._ends = np.cumsum([0, *(len(one.pressure_mpa) for _, one in touching)])
        n = len(patches)
        probes = len(touching)
        contact_jacobian = np.zeros((n, 3, MOTIONS * probes))
        by_force = np.zeros(MOTIONS * probes, bool)
        friction = np.zeros(n)
        for pose, (number, one) in enumerate(touching):
            rows = slice(*self._ends[pose : pose + 2])
            own = slice(MOTIONS * pose, MOTIONS * (pose + 1))
            first = programme.setups[number].first
            aside = one.move_mm - (one.move_mm @ first.axes[Z]) * first.axes[Z]
            contact_jacobian[rows, :, own] = first.jacobian(
                patches.centre_mm[rows], patches.frames[rows], aside
            )
            by_force[own] = programme.steps[step].of_probe(number).by_force
            friction[rows] = programme.effective_friction[number]
        slips = np.concatenate([one.slip for _, one in touching])
        slips &= np.isfinite(friction)
        own_force = np.einsum("kij,kj->ki", patches.frames, patches.force_n)
        # a patch that sticks has three unknowns, one that slips a push that brings its drag along
        along = own_force[slips] / np.maximum(own_force[slips, 2:], 1e-300)
        mask = np.ones((n, 3), bool)
        mask[slips, :2] = False
        unknown, axis = np.nonzero(mask)
        self._force = np.zeros((n, 3, len(unknown)))
        self._force[unknown, axis, np.arange(len(unknown))] = 1.0
        self._force[slips, :2, np.flatnonzero(slips[unknown])] = along[:, :2]
        self._unknown = unknown
        self._axis = axis
        loads = [term for term in state.load.terms if isinstance(term, Rectangles)]
        compliance = programme.setups[0].compliance_between(loads, patches.frames)
        felt = np.abs(contact_jacobian[unknown, axis]).max(axis=0) > _FELT
        self._free = np.flatnonzero(by_force & felt)
        self._count = count = len(unknown)
        force = self._force.reshape(3 * n, count)
        jacobian = contact_jacobian[..., self._free]
        own_rows = compliance.reshape(n, 3, 3 * n)[unknown, axis]
        self._matrix = np.block(
            [
                [own_rows @ force, -jacobian[unknown, axis]],
                [jacobian.reshape(3 * n, -1).T @ force, np.zeros(2 * jacobian.shape[2:])],
            ]
        )
        self._jacobian = contact_jacobian[unknown, axis]
        self.motions = MOTIONS * probes

    def to(self, moved: Floats, placed: Floats) -> list[tuple[Rectangles, Floats]]:
        """Return the change of the load, and the probes' motions (p, 6), as the surface moves more:
        for each of (c, n, 3) motions, mm, and of (c, 6 p) of the probes, which those keep that are
        held by motion."""
        held = placed.copy()
        held[:, self._free] = 0.0
        own = np.einsum("kij,ckj->kic", self.patches.frames, moved)
        right = np.zeros((len(self._matrix), len(moved)))
        right[: self._count] = self._jacobian @ held.T - own[self._unknown, self._axis]
        scale = np.sqrt(np.abs(np.diag(self._matrix)[: self._count]).mean())
        scales = np.repeat([1.0 / scale, scale], [self._count, len(self._free)])
        scaled = self._matrix * scales[:, None] * scales
        solution = np.linalg.lstsq(scaled, scales[:, None] * right, rcond=1e-12)[0]
        found = []
        for one, motion in zip((scales[:, None] * solution).T, held, strict=True):
            force = self._force @ one[: self._count]
            motion[self._free] = one[self._count :]
            change = np.einsum("kij,ki->kj", self.patches.frames, force)
            found.append((replace(self.patches, force_n=change), motion.reshape(-1, MOTIONS)))
        return found

    def total(self, load: Rectangles) -> Floats:
        """Return (p, 3) the forces of the probes that touch, N."""
        return np.add.reduceat(load.force_n, self._ends[:-1], axis=0)


def _growth(wide: float) -> float:
    """Return the power of its radius with which the force under a flat face grows at a given depth:
    1 on thick rubber, 4 where the radius is many times the thickness (``wide``) of incompressible
    rubber, by Shull's formula (2002)."""
    return 1.0 + (4.0 * wide + 12.0 * wide**3) / (3.0 + 4.0 * wide + 4.0 * wide**3)


def _patch_mm(state: ContactState) -> float:
    """Return the root mean square side of the patches in contact, mm."""
    return math.sqrt(state.area_mm2 / max(1, len(state.pressure_mpa)))


@dataclass(frozen=True, eq=False)
class _Border:
    """Where one probe's contact ends."""

    setup: ProbeSetup
    state: ContactState

    @cached_property
    def load(self) -> Rectangles:
        """The patches in contact, with their forces."""
        return _joined(Load(self.state.load.terms[:1]))

    @property
    def is_smooth(self) -> bool:
        """Whether pressures vanish towards it under a probe of closed form."""
        return isinstance(self.setup.probe, Sphere | Cone)

    @property
    def touches(self) -> bool:
        """Whether there is any."""
        return len(self.state.pressure_mpa) > 0

    @property
    def stuck(self) -> float:
        """The share of its patches that stick."""
        if not (self.touches and self.state.friction > 0.0):
            return 0.0
        return float((~self.state.slip[self.patches]).mean())

    @property
    def thin(self) -> float:
        """The cube of its radius over the body's thickness, at most 1."""
        return min(1.0, self.state.contact_radius_mm / self.setup.body.base_z_mm) ** 3

    @property
    def is_rounded(self) -> bool:
        """Whether it lies on the rounded rim of a flat face."""
        return self.setup.face is not None and self.setup.face.edge_mm > 0.0

    @property
    def is_graded(self) -> bool:
        """Whether the patches of a flat surface were made to end with the contact."""
        return self.setup.body.is_flat and bool(np.ptp(self.load.half_mm, axis=0).any())

    @property
    def half_width_mm(self) -> float:
        """The least half width of the patches in contact under a flat face."""
        load = self.load
        away = load.centre_mm - load.centre_mm.mean(axis=0)
        aside = np.abs((load.frames[:, :2] @ away[..., None])[..., 0])
        return float((aside + load.half_mm).max(axis=0).min())

    @cached_property
    def _sides(self) -> tuple[Floats, Floats, Ints]:
        """Of the four sides of k patches: the directions outwards (k, 4, 3), the patches' extents
        (k, 4), mm, and the patches beyond (k, 4), -1 where none touches."""
        from scipy.spatial import cKDTree

        load = self.load
        along = np.concatenate([load.frames[:, :2], -load.frames[:, :2]], axis=1)
        side = 2.0 * np.tile(load.half_mm, (1, 2))
        apart, beyond = cKDTree(load.centre_mm).query(
            load.centre_mm[:, None] + side[..., None] * along
        )
        return along, side, np.where(apart > side / 2.0, -1, beyond)

    @cached_property
    def open_sides(self) -> tuple[Ints, Floats, Floats]:
        """Of the m sides of patches beyond which none touches: the patch (m,), the direction
        outwards (m, 3), and the patch's extent along it (m,), mm."""
        along, side, beyond = self._sides
        patch, way = np.nonzero(beyond < 0)
        return patch, along[patch, way], side[patch, way]

    @cached_property
    def patches(self) -> Bools:
        """(k,) whether patches in contact lack one of their four neighbours."""
        return np.asarray((self._sides[2] < 0).any(axis=1))

    @property
    def _place(self) -> Floats:
        """(6,) where the probe is against the patches, along and about its own axes: what sticks
        to it goes along sideways, and turns with it."""
        state, axes = self.state, self.setup.first.axes
        pose = np.concatenate([axes @ state.move_mm, axes @ np.radians(state.turns_deg)])
        if state.friction > 0.0 and not state.slip.all():
            pose[[X, Y, TURN]] = 0.0
        return pose

    @cached_property
    def _sharp_ends(self) -> tuple[Bools, Floats]:
        """Of the open sides, at which the object ends or folds, and how far from the patch's middle
        it ends, over its extent: pressures don't show it where a contact is few patches wide."""
        patch, along, side = self.open_sides
        load, first, pose = self.load, self.setup.first, self._place

        def gap_at(shares: Floats) -> Floats:
            """Return the gaps at shares of the sides outwards from the middles of patches."""
            places = load.centre_mm[patch] + (shares * side)[:, None] * along
            return first.gap(places, load.frames[patch, 2], pose)[0]

        # 1. Where the object's overlap with the body at rest ends, within a patch and a half.
        low, high = np.zeros(len(patch)), np.full(len(patch), _OUTWARDS)
        ends = (gap_at(low) < 0.0) & (gap_at(high) > 0.0)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2.0
            outside = gap_at(middle) > 0.0
            low, high = np.where(outside, low, middle), np.where(outside, middle, high)
        # 2. There the gap grows many times as fast as within. (It is endless off the object.)
        at_end = np.where(ends, gap_at(low), 0.0)
        inner = at_end - gap_at(low - 1.0)
        outer = (gap_at(high + _STEP) - at_end) / _STEP
        return ends & (outer > _FOLDED * np.maximum(inner, 0.0)), low

    @property
    def ends_sharply(self) -> float:
        """The share of it at which the object ends or folds."""
        sharp, _ = self._sharp_ends
        return float(np.count_nonzero(sharp)) / max(1, len(sharp))

    def _astray(self, along_mpa: Floats) -> float:
        """Return the error of the force along c axes, over the force, as patches miss an object's
        sharp edges, in all and by chance.

        Parameters
        ----------
        along_mpa
            (k, c) traction of the patches along these axes.

        Notes
        -----
        p = k / sqrt(distance) at such an edge, and so are the tractions t along it where patches
        stick. A rigid face that is larger by dA at its edge has 2 pi k_p k_t dA / (E' depth) more
        force: k_p^2 of its pressure, by the energy that dA releases (Irwin), and likewise sideways,
        as under a disc k_t and k_p are in proportion to its stiffnesses along and across itself,
        8 G a / (2 - nu) and 4 G a / (1 - nu) (Johnson 1985, 7.2 and 3.8): the mean over its edge
        of what is sheared along and across it.
        """
        sharp, end = self._sharp_ends
        patch, _, side = self.open_sides
        at_edge = sharp & (end < 1.0)  # else the next one could touch, too
        beyond = Box.beyond_edge(side, self.setup.body.base_z_mm)
        missed = at_edge * (end - (0.5 - beyond)) * _areas(self.load)[patch]
        product = self.state.pressure_mpa[patch, None] * along_mpa[patch]
        product *= (side / (4.0 * (1.0 - beyond)))[:, None]  # k_p k_t
        off = 2.0 * math.pi * missed[:, None] * product / self._stiff_work
        return _ASTRAY * float(np.linalg.norm(off.sum(axis=0)) + np.linalg.norm(off))

    def stuck_astray(self, axes: Floats) -> float:
        """Return what patches that stick miss there of an object's force along axes (c, 3)."""
        if not (self.touches and self.setup.is_free_form):
            return 0.0
        state = self.state
        return self._astray(np.where(state.slip[:, None], 0.0, state.traction_mpa) @ axes.T)

    @property
    def _between(self) -> float:
        """The error of the force as patches know the object's height at their middles alone: by
        what they miss of it on average, steps and all, or by fins that no middle lies on."""
        load, first, pose = self.load, self.setup.first, self._place
        along, side, _ = self._sides
        count = int(np.clip(_MOST_BETWEEN // len(load), *_BETWEEN))
        shares = np.concatenate([[0.0, -1.0, 1.0], (np.arange(count) + 0.5) / count - 0.5])
        inward = np.repeat(load.frames[:, 2], len(shares), axis=0)
        off, fin, wide = np.zeros((3, len(load)))
        for axis in range(2):
            way = (shares * side[:, axis, None])[..., None] * along[:, axis, None]
            places = (load.centre_mm[:, None] + way).reshape(-1, 3)
            overlap = -first.gap(places, inward, pose)[0].reshape(len(load), -1)
            own, before, after = overlap[:, :3].T
            ends = ~(overlap > 0.0).all(axis=1)  # `_sharp_ends` sees to those
            with np.errstate(invalid="ignore"):
                bend = before + after - 2.0 * own  # of a parabola a 24th is missed, at most an 8th
                missed = overlap[:, 3:].mean(axis=1) - own - bend / 24.0
                peak = overlap[:, 3:].max(axis=1) - overlap[:, :3].max(axis=1) - np.abs(bend) / 8.0
            off += np.where(ends, 0.0, missed)
            # what is no narrower than half a patch shows on average
            higher = ~ends & (peak > np.maximum(fin, 2.0 * np.abs(missed)))
            fin[higher], wide[higher] = peak[higher], side[higher, axis]
        area = _areas(load)
        whole = float(area @ np.maximum(own, 0.0))
        if whole <= 0.0:
            return 0.0
        on_average = abs(float(area @ off)) + float(np.linalg.norm(area * off))
        reach = np.maximum(1.0, _HOLDS_OFF * fin / np.maximum(wide, 1e-300))
        return max(on_average, float(area @ (fin * reach))) / whole

    @property
    def _stiff_work(self) -> float:
        """E' times force times indentation, to which the squares of pressures are compared."""
        setup, state = self.setup, self.state
        modulus = plane_strain_modulus(setup.youngs_modulus_mpa, setup.poisson_ratio)
        return modulus * state.indentation_mm * float(np.linalg.norm(state.force_n))

    @property
    def cut_error(self) -> float:
        """The error of a smooth probe's force as patches cut its border."""
        count = len(self.state.pressure_mpa)
        if count == 0 or not self.is_smooth:
            return 0.0
        if self.as_hertz is None:
            return _CUT * (1.0 + self.thin) * math.pi / 4.0 / count
        return _AS_HERTZ * abs(self.as_hertz) + _LEFT * (1.0 + _LEFT_THIN * self.thin) / count

    @cached_property
    def as_hertz(self) -> float | None:
        """That error with its sign; None where pressures don't show the border, or the patches are
        many.

        Hertz's contact with the same border, on the same patches of a half-space, has a force that
        is known. What patches lack lies at the border, where p = k sqrt(distance): it is in
        proportion to k^2 / (E' force indentation).
        """
        from scipy.special import elliprd, elliprf

        pressure = self.state.pressure_mpa
        if not (self.is_smooth and 0 < len(pressure) <= _MOST_RESPONDING):
            return None
        load = self.load
        area = _areas(load)
        away = load.centre_mm - load.centre_mm.mean(axis=0)
        frame = load.frames[np.argmin(np.linalg.norm(away, axis=1))]
        place = away @ frame[:2].T
        ends = Patches.outline(place, area, pressure, bent=isinstance(self.setup.probe, Cone))
        if ends is None:
            return None
        # 1. The ellipse through these ends: its middle, axes and half lengths.
        x, y = ends.T
        terms = np.column_stack([x, y, x * x, x * y, y * y])
        linear_x, linear_y, xx, xy, yy = np.linalg.lstsq(terms, np.ones(len(x)), rcond=None)[0]
        form = np.array([[xx, xy / 2.0], [xy / 2.0, yy]])
        middle = -np.linalg.solve(form, [linear_x, linear_y]) / 2.0
        inverse_squared, axes = np.linalg.eigh(form / (1.0 + middle @ form @ middle))
        if inverse_squared[0] <= 0.0:
            return None
        a, b = 1.0 / inverse_squared
        # 2. How deep pressures of 1 MPa in the middle press it (Johnson 1985, 3.41; E' = 1 MPa).
        u, v = ((place - middle) @ axes).T ** 2
        depth = math.sqrt(a * b) * elliprf(0.0, a, b)
        bowl = math.sqrt(a * b) / 3.0 * (u * elliprd(0.0, b, a) + v * elliprd(0.0, a, b))
        flat = replace(
            load,
            centre_mm=np.insert(place, 2, 0.0, axis=1),
            frames=np.tile(np.eye(3), (len(load), 1, 1)),
        )
        force = np.linalg.solve(halfspace.normal_compliance(flat, 1.0, 0.0), depth - bowl)
        missed = float(force.sum()) / (math.pi * math.sqrt(a * b) / 1.5) - 1.0
        # 3. The same share of this contact's force.
        rim = self.patches
        steeper = float(pressure[rim] @ pressure[rim] / np.sum((force / area)[rim] ** 2))
        whole = self._stiff_work
        share = steeper * float(force.sum()) * depth / whole if whole > 0.0 else 1.0
        return missed * max(1.0, share)  # less in rubber that has relaxed, whose modulus is less

    @property
    def longer(self) -> float:
        """Its length over that of a disc of as many patches, at least 1."""
        count = len(self.state.pressure_mpa)
        return max(1.0, len(self.open_sides[0]) * math.sqrt(math.pi / count) / 8.0)

    @cached_property
    def _pieces(self) -> Ints:
        """(m,) which straight piece of it along the grid each open side lies on: a piece is cut
        alike, different ones by chance."""
        patch, way, extent = self.open_sides
        load = self.load
        axes = load.frames[len(load) // 2, :2]
        outwards = np.rint(way @ axes.T).astype(int)
        away = np.sum((load.centre_mm[patch] - load.centre_mm[0]) @ axes.T * outwards, axis=1)
        lines = np.column_stack([outwards, np.rint(away / extent).astype(int)])
        return np.unique(lines, axis=0, return_inverse=True)[1].ravel()

    @property
    def by_chance(self) -> float:
        """The square of a patch's extent over the contact's width, as a disc's radius, with all of
        a straight border along the grid cut alike, and as many such pieces by chance."""
        patch, _, extent = self.open_sides
        area = _areas(self.load)
        length = area[patch] / extent
        width = 8.0 / math.pi * area.sum()  # times the length of the border
        alike = float(np.linalg.norm(np.bincount(self._pieces, length)))
        return float(length @ extent**2) * alike / float(width**2)

    def by_pieces(self, axes: Floats) -> float:
        """Return the force along axes (c, 3), N, that its tractions would be on the whole contact,
        alike within a piece and by chance from one to the next: where a probe was turned, those of
        its two ends cancel, but not what cutting each does."""
        patch, _, extent = self.open_sides
        area = _areas(self.load)
        length = area[patch] / extent
        along = length[:, None] * (self.state.traction_mpa[patch] @ axes.T)
        pieces = np.array([np.bincount(self._pieces, one) for one in along.T])
        return float(np.linalg.norm(pieces) / length.sum() * area.sum())

    @property
    def force_error(self) -> float:
        """The error of the force as patches cut a border within an upright flat face, or an
        object's, and miss its sharp edges."""
        setup, face = self.setup, self.setup.face
        if not self.touches:
            return 0.0
        pushed = self.state.pressure_mpa[:, None]
        if setup.has_inclined_face:  # a square one's rim may lie askew to the patches
            return self._astray(pushed) if isinstance(setup.probe, Pillar) else 0.0
        within = face and not setup.body.is_flat and self.state.area_mm2 < 0.99 * face.area_mm2
        if not (within or setup.is_free_form):
            return 0.0
        grown = 1.0 + _CUT_FREE_THIN * self.thin
        if within:
            return _CUT_WITHIN * grown * math.pi / len(self.load)
        smooth = 1.0 - _OF_SMOOTH * self.ends_sharply**2
        cut = _CUT_FREE * grown * smooth * self.by_chance
        return cut + self._astray(pushed) + self._between

    @property
    def traction_error(self) -> float:
        """The RMS error of tractions over their RMS, from their second differences; beyond the
        border they vanish."""
        if len(self.state.slip) < _FEWEST_COMPARED:
            return float(self.touches)
        *_, beyond = self._sides
        traction = np.vstack([self.state.traction_mpa, np.zeros(3)])
        bent = traction[beyond[:, :2]] + traction[beyond[:, 2:]] - 2.0 * traction[:-1, None]
        area = _areas(self.load)
        share = math.sqrt(
            (area @ bent.reshape(-1, 6) ** 2).sum() / (area @ traction[:-1] ** 2).sum()
        )
        probe = self.setup.probe
        smooth = isinstance(probe, Sphere)
        if isinstance(probe, Cone):
            first = self.setup.first
            away = self.load.centre_mm - first.axis_mm - self.state.move_mm
            from_tip = float(np.linalg.norm(np.cross(away, first.axes[Z]), axis=1).min())
            tip = probe.tip_mm * math.cos(math.radians(probe.apex_deg / 2))
            side = _patch_mm(self.state)
            smooth = tip > side or from_tip < side / 4.0
        return share * _BENT[smooth]


def _alike(one: ContactState, states: list[ContactState], step: int) -> ContactState:
    """Return the state at the end of a step if the same probes touch as in ``one``, else that."""
    for other in states[step : step + 1]:
        pairs = zip((one, *one.also), (other, *other.also), strict=True)
        if all((len(a.slip) > 0) == (len(b.slip) > 0) for a, b in pairs):
            return other
    return one


def _joined(load: Load) -> Rectangles:
    return Rectangles.joined([term for term in load.terms if isinstance(term, Rectangles)])


def _over(change: Floats | float, whole: Floats | float) -> float:
    """Return the largest length of changes (n, 3), or of one, over the largest of what changes; 0
    of nothing."""
    most = float(np.linalg.norm(np.atleast_2d(change), axis=1).max(initial=0.0))
    return most / (float(np.linalg.norm(np.atleast_2d(whole), axis=1).max(initial=0.0)) or 1.0)


def _areas(load: Rectangles) -> Floats:
    """Return (n,) the areas of patches, mm2."""
    return np.asarray(4.0 * np.prod(load.half_mm, axis=1))


def _rms_traction(load: Rectangles) -> float:
    """Return the root mean square traction of patches, weighted with their areas, MPa."""
    area = _areas(load)
    return float(np.sqrt(np.sum(np.sum(load.force_n**2, axis=1) / area) / area.sum()))


def _traction_change(one: ContactState, other: ContactState) -> float:
    """Return the RMS change of the tractions over their RMS, the coarse ones interpolated to the
    finer patches."""
    from scipy.interpolate import LinearNDInterpolator

    coarse, fine = sorted((one, other), key=lambda state: len(state.slip))
    if len(coarse.slip) < _FEWEST_COMPARED:
        return 1.0
    patches, others = (_joined(Load(state.load.terms[:1])) for state in (fine, coarse))
    here = _flattened(patches, patches)
    expected = LinearNDInterpolator(_flattened(others, patches), coarse.traction_mpa)(here)
    known = np.isfinite(expected[:, 0])
    weight = known * _areas(patches)
    changed = weight @ (np.nan_to_num(expected) - fine.traction_mpa) ** 2
    whole = weight @ fine.traction_mpa**2
    return float(np.sqrt(changed.sum() / whole.sum())) if known.any() else 1.0


def _flattened(rectangles: Rectangles, reference: Rectangles) -> Floats:
    """Return (k, 2) centres in the plane that the reference's centres lie nearest to."""
    middle = reference.centre_mm.mean(axis=0)
    _, _, axes = np.linalg.svd(reference.centre_mm - middle, full_matrices=False)
    return np.asarray((rectangles.centre_mm - middle) @ axes[:2].T)
