"""One or several probes on one body: their patches in one row, their places one after the other.

Every probe adds its six motions to the place and sees its own patches only; the body's compliance couples them. So two
probes are no case of their own anywhere: the solvers see more patches and more motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Protocol

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.compiled import njit
from twin.errors import ContactError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.press import Probe
from twin.parts.probe import Cylinder, Pillar
from twin.world.contact.approach import approach
from twin.world.contact.between import Between, Dense
from twin.world.contact.cells import Face
from twin.world.contact.gap import ABOUT_X, MOTIONS, Approach, Z
from twin.world.contact.iterated import near_lattice
from twin.world.contact.lattice import lattice
from twin.world.contact.patches import Patches, Plane, joined
from twin.world.contact.probe_shape import rotation_of, tilt_of
from twin.world.contact.unilateral import Equilibrium


class SurfaceCompliance(Protocol):
    """A body's surface, solved: whatever can say how patches move under forces on patches.

    Attributes
    ----------
    one_material
        Whether a half-space's closed forms may tell how large a contact on it is.
    """

    one_material: bool

    def surface(self, rectangles: Rectangles) -> Floats:
        """Return (3k, 3k) displacements of the patch centres under unit forces on the patches, global axes, mm/N.

        Symmetric (Betti): products read one half of it.
        """
        ...

    def to_points(self, points: Points, rectangles: Rectangles) -> Floats:
        """Return (3n, 3k) displacements of points (n, 3) under unit forces on the patches, likewise."""
        ...


class PlaneSurface(Protocol):
    """A surface that tells its normal compliance in a plane by itself, for a tenth of the work of the whole."""

    def normal(self, rectangles: Rectangles) -> Floats | None:
        """Return the symmetric (k, k) normal displacements under unit normal forces on the patches, mm/N.

        None where they don't lie in one plane, or only the whole compliance is known.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A probe over a body.

    Attributes
    ----------
    body, compliance
        The undeformed body, and its surface's compliance.
    first
        The probe at first touch of the path; places count from there.
    across
        Patches across the contact.
    youngs_modulus_mpa, poisson_ratio
        For the first guess of the contact's size.
    """

    body: Body
    compliance: SurfaceCompliance
    first: Approach
    across: int
    youngs_modulus_mpa: float
    poisson_ratio: float

    @property
    def probe(self) -> Probe:
        """The rigid probe."""
        return self.first.probe

    @cached_property
    def face(self) -> Face:
        """The probe, if its flat face bounds the contact."""
        return self.probe if self.first.is_flat and isinstance(self.probe, Cylinder | Pillar) else None

    @property
    def name(self) -> str:
        """The probe and where it stands, for messages."""
        return f"{self.probe.kind} at ({', '.join(f'{c:.4g}' for c in self.first.axis_mm)}) mm"


@dataclass(frozen=True, kw_only=True)
class Control:
    """What holds the probes: for each one's six motions whether force (torque) does, and the force or place given."""

    by_force: Bools
    given: Floats

    @property
    def pushing(self) -> Bools:
        """Which components push by force: every z that is held so, with a force that isn't 0."""
        return np.asarray(self.by_force & every(Z, len(self.given)) & (self.given > 0.0))


def every(axis: int, count: int) -> Bools:
    """Return (count,) which components of a place are one axis of some probe."""
    return np.asarray(np.arange(count) % MOTIONS == axis)


def touch_at(setting: Setting, place: Floats) -> tuple[Plane, float]:
    """Return the grid's plane under a probe at a place (6,), and the z from first touch at which it would just touch.

    Raises
    ------
    InputError
        It would miss the sensing surface.
    """
    first, there = setting.first, _touching_there(setting, place)
    if setting.face is None:
        plane = Plane(origin_mm=there.touch_mm, axes=setting.body.frames(there.touch_mm[None])[0])
    elif not place[ABOUT_X:].any() and not any(first.tilt_deg):
        plane = Plane(origin_mm=there.axis_mm, axes=first.axes)
    else:
        side = rotation_of(place[ABOUT_X:]) @ tilt_of(first.tilt_deg)[:, 0]
        side = np.array([side[0], side[1], 0.0]) / np.hypot(side[0], side[1])
        own = np.stack([side, np.cross([0.0, 0.0, 1.0], side), [0.0, 0.0, 1.0]])
        plane = Plane(origin_mm=there.axis_mm, axes=own @ first.axes)
    return plane, _height(setting, there)


def touch_z_at(setting: Setting, place: Floats) -> float:
    """Return the second of what `touch_at` does."""
    return _height(setting, _touching_there(setting, place))


def _height(setting: Setting, there: Approach) -> float:
    """Return the z from first touch of the path at which a probe just touches where it was brought."""
    first = setting.first
    return 0.0 if there is first else float((there.axis_mm - first.axis_mm) @ first.axes[2])


def _touching_there(setting: Setting, place: Floats) -> Approach:
    first, (x, y, _, *turns) = setting.first, place.tolist()
    if not (x or y or any(turns)):
        return first
    over = first.axis_mm + place[:Z] @ first.axes[:Z]
    return approach(setting.probe, setting.body, over, first.axes, first.tilt_deg, place[ABOUT_X:])


@dataclass(frozen=True, eq=False)
class Contacts:
    """Probes and the patches under each of them.

    Attributes
    ----------
    settings
        The p probes.
    grids
        Their patches.
    """

    settings: tuple[Setting, ...]
    grids: tuple[Patches, ...]

    @cached_property
    def patches(self) -> Patches:
        """The patches of all probes, k in all."""
        return joined(self.grids)

    @cached_property
    def rows(self) -> tuple[tuple[Setting, slice, slice], ...]:
        """Every probe with its piece of the patches and of the place."""
        ends = list(accumulate(map(len, self.grids), initial=0))
        return tuple(
            (setting, slice(first, end), slice(MOTIONS * number, MOTIONS * (number + 1)))
            for number, (setting, (first, end)) in enumerate(zip(self.settings, pairwise(ends), strict=True))
        )

    @cached_property
    def owner(self) -> Ints:
        """(k,) which probe each patch belongs to."""
        if len(self.grids) == 1:
            return np.zeros(len(self.patches), int)
        return np.repeat(np.arange(len(self.grids)), [len(grid) for grid in self.grids])

    @cached_property
    def between(self) -> Between:
        """The compliance between patches: a convolution where they are a lattice in a plane, else a matrix."""
        found = lattice(self.patches, self.settings[0].compliance)
        if found is not None:
            return found
        return Dense(self.compliance, lambda: near_lattice(self.patches, self.settings[0].poisson_ratio))

    @cached_property
    def compliance(self) -> Floats:
        """(k, 3, k, 3) compliance between patches in their own frames, mm/N."""
        patches, k = self.patches, len(self.patches)
        body = self.settings[0].compliance
        loads = [grid.unloaded for grid in self.grids]
        if len(loads) == 1:
            whole = np.asarray(body.surface(loads[0]))
        else:  # probe by probe, as what is solved for one probe's patches serves them all but not those far away
            whole = np.concatenate([body.to_points(patches.centre_mm, load) for load in loads], axis=1)
            whole = (whole + whole.T) / 2.0
        compliance = whole.reshape(k, 3, k, 3)
        if not np.isfinite(compliance).all():
            raise ContactError(f"contact: the body's compliance is not finite on {k} patches: check mesh and material")
        return _in_own_frames(compliance, patches.frames)

    @cached_property
    def normal(self) -> Floats | None:
        """(k, k) normal compliance alone, mm/N, where it is known without the rest."""
        normal = getattr(self.settings[0].compliance, "normal", None)  # a `PlaneSurface`, told by name: that is fast
        return None if normal is None else normal(self.patches.unloaded)

    def carried(self, place: Floats) -> Floats:
        """Return (k, 3, 6 p): motion of the probes' points at the patches, in their frames, per unit of the place.

        Turns are about the probes' axes at a place, at the height of first touch.
        """
        whole = np.zeros((len(self.patches), 3, len(place)))
        for (setting, rows, motions), grid in zip(self.rows, self.grids, strict=True):
            axes = setting.first.axes
            arm = grid.centre_mm - setting.first.axis_mm - place[motions][:Z] @ axes[:Z]
            _carry(axes, arm, np.array(grid.frames, order="C"), whole[rows, :, motions])
        return whole

    def gap(self, place: Floats) -> tuple[Floats, Floats]:
        """Return (k,) gaps, mm, and their (k, 6 p) slopes at a place."""
        if len(self.grids) == 1:
            return self.gap_under(0, place)
        gap, slope = np.zeros(len(self.patches)), np.zeros((len(self.patches), len(place)))
        for number, (_, rows, motions) in enumerate(self.rows):
            gap[rows], slope[rows, motions] = self.gap_under(number, place[motions])
        return gap, slope

    def gap_under(self, number: int, place: Floats) -> tuple[Floats, Floats]:
        """Return the gaps of the patches under one probe at its place (6,), and their slopes.

        A probe that comes along the normals of all its patches changes their gaps by as much as it comes, and nothing
        else: what it was at its last place sideways is kept.
        """
        grid, first = self.grids[number], self.settings[number].first
        normals = grid.frames[:, 2]
        if not self.upright[number]:
            return first.gap(grid.centre_mm, normals, place)
        at_touch = place.copy()
        at_touch[Z] = 0.0
        key, (gap, slope) = self._last.get(number, (b"", (place, place)))
        if key != at_touch.tobytes():
            gap, slope = first.gap(grid.centre_mm, normals, at_touch)
            self._last[number] = at_touch.tobytes(), (gap, slope)
        return gap - place[Z], slope

    @cached_property
    def upright(self) -> list[bool]:
        """Whether each probe comes along the normals of all its patches."""
        pairs = zip(self.settings, self.grids, strict=True)
        return [_all_along(grid.frames, setting.first.axes) for setting, grid in pairs]

    @cached_property
    def _last(self) -> dict[int, tuple[bytes, tuple[Floats, Floats]]]:
        return {}


@njit(cache=True)
def _all_along(frames: Floats, axes: Floats) -> bool:
    """Return whether the normals of frames (k, 3, 3) are all the last of the axes (3, 3)."""
    for i in range(len(frames)):
        for j in range(3):
            if frames[i, 2, j] != axes[2, j]:
                return False
    return True


@njit(cache=True)
def _carry(axes: Floats, arm: Floats, frames: Floats, out: Floats) -> None:
    """Set ``out`` (k, 3, 6) to how points at arms (k, 3) move in their frames along and about axes (rows of (3, 3))."""
    for i in range(len(arm)):
        x, y, z = arm[i]
        for m in range(3):
            a, b, c = axes[m]
            p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
            for j in range(3):
                u, v, w = frames[i, j]
                out[i, j, m], out[i, j, 3 + m] = u * a + v * b + w * c, u * p + v * q + w * r


def _in_own_frames(compliance: Floats, frames: Floats) -> Floats:
    """Return a compliance (k, 3, k, 3), given in global axes, in the patches' frames (k, 3, 3)."""
    k = len(frames)
    if not np.any(frames - np.eye(3)):
        return compliance
    half = np.matmul(frames, compliance.reshape(k, 3, 3 * k)).reshape(3 * k, 3 * k)
    turned = np.matmul(frames, np.ascontiguousarray(half.T).reshape(k, 3, 3 * k)).reshape(3 * k, 3 * k)
    return np.ascontiguousarray(turned.T).reshape(k, 3, k, 3)


def of_one(found: Equilibrium, rows: slice, motions: slice) -> Equilibrium:
    """Return one probe's part of an equilibrium."""
    if len(found.place) == MOTIONS:
        return found
    return Equilibrium(
        force_n=found.force_n[rows], displacement_mm=found.displacement_mm[rows], place=found.place[motions],
        active=found.active[rows], total=found.total[motions], slipping=found.slipping[rows], residual=found.residual,
        steps=found.steps,
    )  # fmt: skip


def all_controls(controls: Sequence[Control]) -> Control:
    """Return what holds several probes, one after the other."""
    if len(controls) == 1:
        return controls[0]
    return Control(
        by_force=np.concatenate([one.by_force for one in controls]),
        given=np.concatenate([one.given for one in controls]),
    )
