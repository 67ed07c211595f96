"""Where a probe touches a body: the grid of patches that fits the contact, found by solving on coarse grids first.

Why coarse grids first: a curved body, a flat face over a barrel, or a large contact are far from Hertz's disc, and a
fine grid over too large a region would waste patches. A frictionless solve on about a hundred patches tells the
region; the grid grows while contact reaches its border and shrinks while contact fills too little of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.press import Probe, Sphere
from twin.theory.contact import hertz
from twin.world.gap import MOTIONS, TURN, Approach, X, Y, Z, approach, half_extent
from twin.world.patches import Box, Patches, Plane, candidate_patches
from twin.world.unilateral import Equilibrium, Unilateral, solve

_COARSE, _ROUNDS, _MARGIN, _FILL = 10, 14, 0.13, 0.4


class SurfaceCompliance(Protocol):
    """A body's surface, solved: whatever can say how patches move under forces on patches."""

    def surface(self, rectangles: Rectangles) -> Floats:
        """Return (3k, 3k) displacements of the patch centres under unit forces on the patches, global axes, mm/N."""
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


@dataclass(frozen=True, kw_only=True)
class Control:
    """What holds the probe: for x, y, z and turn whether force (torque) does, and the force or the place given."""

    by_force: Bools
    given: Floats

    @property
    def pushing(self) -> Bools:
        """Which components push by force: z, if it does."""
        return np.asarray(self.by_force & (np.arange(len(self.by_force)) % MOTIONS == Z))


def touch_at(setting: Setting, place: Floats) -> tuple[Plane, float]:
    """Return the grid's plane under a probe at a place, and the z (from first touch) at which it would just touch."""
    x, y, z = setting.first.axis_mm
    there = approach(setting.probe, setting.body, (x + place[X], y + place[Y]), float(place[TURN]))
    if isinstance(setting.probe, Sphere):
        plane = Plane(origin_mm=there.touch_mm, axes=setting.body.frames(there.touch_mm[None])[0])
    else:
        cosine, sine = math.cos(place[TURN]), math.sin(place[TURN])
        axes = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        plane = Plane(origin_mm=np.array(there.axis_mm), axes=axes)
    return plane, there.axis_mm[2] - z


def local_compliance(setting: Setting, patches: Patches) -> Floats:
    """Return the (k, 3, k, 3) compliance between patches in their own frames, mm/N."""
    k = len(patches)
    loaded = patches.rectangles(np.zeros((k, 3)), np.ones(k, bool))
    compliance = np.asarray(setting.compliance.surface(loaded)).reshape(k, 3, k, 3)
    if not np.isfinite(compliance).all():
        raise ContactError(f"contact: the body's compliance is not finite on {k} patches: check mesh and material")
    turned = np.einsum("kai,kilj->kalj", patches.frames, compliance)
    return np.asarray(np.einsum("lbj,kalj->kalb", patches.frames, turned))


def carried(setting: Setting, patches: Patches, axis: Floats) -> Floats:
    """Return (k, 3, 4): motion of the probe's points at the patches, in their frames, per unit of x, y, z and turn."""
    arm = patches.centre_mm[:, :2] - (np.array(setting.first.axis_mm[:2]) + axis)
    turning = np.column_stack([-arm[:, 1], arm[:, 0], np.zeros(len(arm))])
    return np.concatenate([patches.frames, np.einsum("kai,ki->ka", patches.frames, turning)[:, :, None]], axis=2)


def frictionless_control(setting: Setting, patches: Patches, control: Control, place: Floats) -> Control:
    """Hold what a frictionless probe can't feel where it is, and refuse forces that it can't transmit.

    Raises
    ------
    ContactError
        A torque, or a lateral force on a face without slope, is asked of a frictionless probe.
    """
    by_force, given = control.by_force.copy(), control.given.copy()
    felt = np.abs(patches.frames[:, 2]).max(axis=0) > 1e-9
    felt[:2] &= isinstance(setting.probe, Sphere)
    for axis, name in ((X, "x"), (Y, "y"), (TURN, "the turn")):
        if not by_force[axis] or (axis != TURN and felt[axis]):
            continue
        if given[axis] != 0.0:
            raise ContactError(
                f"contact: {given[axis]:g} {'N mm of torque' if axis == TURN else f'N along {name}'} can't be balanced "
                f"by a frictionless {setting.probe.kind} here: give press.friction a value, or hold {name} by motion"
            )
        by_force[axis], given[axis] = False, place[axis]
    return Control(by_force=by_force, given=given)


def guess_box(setting: Setting, force_z: float | None, depth: float) -> tuple[Box, float]:
    """Return a first box around the contact and a first guess of the indentation, from Hertz."""
    a, b = half_extent(setting.probe)
    if not isinstance(setting.probe, Sphere):
        stiff = 2.0 * math.sqrt(a * b) * setting.youngs_modulus_mpa
        return Box(u0=-a, u1=a, v0=-b, v1=b), depth if force_z is None else force_z / stiff
    like = hertz(
        radius_mm=a, youngs_modulus_mpa=setting.youngs_modulus_mpa, poisson_ratio=setting.poisson_ratio,
        force_n=force_z, indentation_mm=None if force_z is not None else depth,
    )  # fmt: skip
    half = 1.25 * min(like.contact_radius_mm, 0.7 * a)
    return Box(u0=-half, u1=half, v0=-half, v1=half), min(like.indentation_mm, 0.5 * a)


def solve_frictionless(
    setting: Setting, patches: Patches, control: Control, place: Floats, touch_z: float
) -> Equilibrium:
    """Solve the frictionless contact on given patches, from a guess of the place."""
    k = len(patches)

    def gap(q: Floats) -> tuple[Floats, Floats]:
        return setting.first.gap(patches.centre_mm, patches.frames[:, 2], q)

    held = frictionless_control(setting, patches, control, place)
    problem = Unilateral(
        compliance=local_compliance(setting, patches), gap=gap, carried=carried(setting, patches, place[:2]),
        by_force=held.by_force, given=held.given, pushing=held.pushing, friction=np.zeros(k), offset=np.zeros((k, 2)),
    )  # fmt: skip
    active = gap(place)[0] < -0.5 * (place[Z] - touch_z)
    found = solve(problem, active, place)
    _check_slide(setting, patches, found, place)
    missed = np.where(control.by_force, np.abs(found.total - control.given), 0.0)[:2]
    if missed.max() > 1e-6 * max(abs(float(found.total[Z])), 1e-12):
        axis = "xy"[int(np.argmax(missed))]
        raise ContactError(
            f"contact: the frictionless {setting.probe.kind} is pushed by {found.total['xy'.index(axis)]:.3g} N along "
            f"{axis} by the slope of the surface, against the {control.given['xy'.index(axis)]:g} N given: hold {axis} "
            "by motion (leave it out of force_n), or give press.friction a value"
        )
    return found


def _check_slide(setting: Setting, patches: Patches, found: Equilibrium, start: Floats) -> None:
    """Raise a ContactError when the equilibrium is further away than the contact is wide: the probe slides off."""
    if not found.active.any():
        return
    slide = float(np.hypot(*(found.place - start)[:2]))
    width = max(patches.bounds(found.active).size)
    if slide > width:
        raise ContactError(
            f"contact: the frictionless {setting.probe.kind} slides {slide:.2g} mm sideways before its lateral forces "
            f"balance; allowed is the contact's width, {width:.2g} mm: hold x and y by motion (leave them out of "
            "force_n), or give press.friction a value"
        )


def _aspect(size: tuple[float, float]) -> float:
    return math.sqrt(size[0] / size[1])


def _counts(across: int, box: Box, contact: Box) -> tuple[int, int]:
    """Return cells along u and v: ``across`` squared over the contact, more along its longer side."""
    shape = math.sqrt(_aspect(contact.size))
    u, v = box.size[0] / contact.size[0], box.size[1] / contact.size[1]
    return max(4, math.ceil(across * shape * u - 1e-6)), max(4, math.ceil(across / shape * v - 1e-6))


def fitted_patches(setting: Setting, plane: Plane, contact: Box) -> Patches:
    """Cut the final grid around a known contact."""
    box = contact.grown(*(_MARGIN * size for size in contact.size)).clipped(setting.probe)
    return candidate_patches(setting.body, setting.probe, plane, box, _counts(setting.across, box, contact))


def find_contact(setting: Setting, control: Control, start: Floats, plane: Plane, touch_z: float) -> tuple[Box, Floats]:
    """Return the box of the contact in the plane and the probe's place, from frictionless solves on coarse grids."""
    force_z = float(control.given[Z]) if control.by_force[Z] else None
    upright = float(plane.axes[2, 2])
    # on a slope the normal force is larger than its part along z, and the probe sinks further along z than along n
    normal_force = None if force_z is None else force_z / upright
    box, depth = guess_box(setting, normal_force, (float(control.given[Z]) - touch_z) * upright)
    place = np.where(control.by_force, start, control.given)
    if control.by_force[Z]:
        place[Z] = touch_z + depth / upright
    for _ in range(_ROUNDS):
        whole = box.clipped(setting.probe)
        patches = candidate_patches(setting.body, setting.probe, plane, whole, _counts(_COARSE, whole, whole))
        check_somewhere(setting, patches)
        found = solve_frictionless(setting, patches, control, place, touch_z)
        place = found.place
        if not found.active.any():
            box = Box(u0=whole.u0 / 2, u1=whole.u1 / 2, v0=whole.v0 / 2, v1=whole.v1 / 2)
            continue
        contact = patches.bounds(found.active)
        if np.any(found.active & patches.border):
            box = contact.grown(0.3 * contact.size[0], 0.3 * contact.size[1])
        elif min(c / w for c, w in zip(contact.size, whole.size, strict=True)) < _FILL:
            cells = patches.cell_mm[found.active].max(axis=0)
            box = contact.grown(0.15 * contact.size[0] + cells[0], 0.15 * contact.size[1] + cells[1])
        else:
            return contact, place
    check_inside(setting, patches, found, float(place[Z]) - touch_z)
    raise ContactError(
        f"contact: no grid fits the contact of the {setting.probe.kind} after {_ROUNDS} tries (last: "
        f"{whole.size[0]:.3g} by {whole.size[1]:.3g} mm): the press is too light to resolve, or not held in place"
    )


def check_somewhere(setting: Setting, patches: Patches) -> None:
    """Raise a ContactError when no patch lies on the sensing surface."""
    if len(patches) == 0:
        x, y, _ = setting.first.axis_mm
        raise ContactError(
            f"contact: under the {setting.probe.kind} at ({x:g}, {y:g}) mm no patch lies on the sensing surface: "
            "move it away from the edge"
        )


def check_inside(setting: Setting, patches: Patches, found: Equilibrium, depth: float) -> None:
    """Refuse contact that runs over the edge of the surface, or a probe that sinks in.

    Raises
    ------
    ContactError
        With place, value and allowed range.
    """
    over = found.active & patches.edge
    if over.any():
        place = patches.centre_mm[over][0]
        raise ContactError(
            f"contact: runs over the edge of the sensing surface at ({', '.join(f'{c:.3g}' for c in place)}) mm: "
            "press further inside, or with less force or a smaller probe"
        )
    low, high = setting.body.bounds_mm
    limit = (high[2] - low[2]) / 2
    what = "half the body's thickness"
    if isinstance(setting.probe, Sphere) and setting.probe.diameter_mm / 2 < limit:
        limit, what = setting.probe.diameter_mm / 2, "the probe's radius"
    if depth > limit:
        raise ContactError(
            f"contact: the {setting.probe.kind} sinks in by {depth:.3g} mm, allowed is up to {limit:.3g} mm ({what}): "
            "press with less force, or with a larger probe, or on a stiffer body"
        )
