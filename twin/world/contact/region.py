"""Where a probe touches a body: the grid of patches that fits the contact, found by solving on coarse grids first.

Why coarse grids first: a curved body, a flat face over a barrel, or a large contact are far from Hertz's disc, and a
fine grid over too large a region would waste patches. A frictionless solve on about a hundred patches tells the
region; the grid grows while contact reaches its border, shrinks while contact fills too little of it, and turns along a
long contact (`twin.world.contact.alignment`). On a flat surface a sphere or a cone needs none of that: Hertz's or
Sneddon's disc is right, or so wrong that it shows; nor does a flat face, most of which touches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.arrays import Bools, Floats
from twin.compiled import njit
from twin.errors import ContactError, NotSettled
from twin.parts.probe import Cone, Sphere
from twin.theory.contact import cone_contact_radius, hertz
from twin.world.contact.alignment import beside, turn_along, turned_box
from twin.world.contact.cells import Box, is_even
from twin.world.contact.gap import ABOUT_X, TURN, X, Y, Z
from twin.world.contact.patches import Patches, Plane, all_level, candidate_patches
from twin.world.contact.probe_shape import half_extent
from twin.world.contact.pushed import ends_at, pushed
from twin.world.contact.together import Contacts, Control, Setting, every
from twin.world.contact.unilateral import Equilibrium, Unilateral, solve

_COARSE, _ROUNDS, _FILL = 10, 14, 0.4
_PATIENCE = 10
"""Tries after which a grid that holds the contact will do although the contact fills little of it: a corner's, whose
ends reach the border of any grid that fits it more closely."""

_TURNS = 3
"""How often a grid is turned along the contact at most: a corner's has no direction of its own."""

_MARGIN, _SPARE = 0.13, 1.6
"""Share of a contact by which its grid is larger on every side, and how many patches that is at least."""

_WIDER = 1.25
"""First coarse grid over the contact guessed."""

_INNER = 0.96
"""Half width of a box to be filled with patches over that of the contact: rather more patches across than asked."""

_CORNERS = ((-1, -1), (1, -1), (-1, 1), (1, 1))

_THIN = 0.15
"""Largest contact over a body's thickness for which closed forms of half-spaces tell its size."""

_FILLS = 0.85
"""Share of a region that was said to be in contact which is at least, or it isn't the region."""

_FINER, _WIDE = 1.5, 8.0
"""How many times as many cells several contacts on one lattice may have, and as many places it may."""

_NAMES = ("x", "y", "z", "the turn about x", "the turn about y", "the turn about z")


def frictionless_control(contacts: Contacts, carried: Floats, control: Control, place: Floats) -> Control:
    """Hold what frictionless probes can't feel where it is, and refuse forces that they can't transmit.

    Raises
    ------
    ContactError
        A torque about its axis, or a lateral force on a face without slope, is asked of a frictionless probe.
    """
    if not np.any(control.by_force & ~every(Z, len(control.by_force))):
        return control
    by_force, given = control.by_force.copy(), control.given.copy()
    gap, slope = contacts.gap(place)
    moves = np.abs(slope[np.isfinite(gap)]).max(axis=0, initial=0.0) > 1e-9
    felt = moves & (np.abs(carried[:, 2]).max(axis=0) > 1e-9)
    for component in np.flatnonzero(by_force & ~felt):
        axis, setting = component % len(_NAMES), contacts.settings[component // len(_NAMES)]
        if axis == Z:
            continue
        if given[component] != 0.0:
            what = (
                f"{given[component]:g} N along {_NAMES[axis]}"
                if axis < Z
                else (f"{given[component]:g} N mm of torque about {_NAMES[axis][-1]}")
            )
            raise ContactError(
                f"contact: {what} can't be balanced by a frictionless {setting.probe.kind} here: give press.friction a "
                f"value, or hold {_NAMES[axis]} by motion"
            )
        by_force[component], given[component] = False, place[component]
    return Control(by_force=by_force, given=given)


def guess_box(setting: Setting, force_z: float | None, depth: float) -> tuple[Box, float]:
    """Return a first box around the contact and a first guess of the indentation, from Hertz or Sneddon."""
    a, b = half_extent(setting.probe, setting.first.tilt_deg)
    if setting.face is not None:
        stiff = 2.0 * math.sqrt(a * b) * setting.youngs_modulus_mpa
        return _square(a, b), depth if force_z is None else force_z / stiff
    radius, depth = _disc(setting, force_z, depth)
    return _square(_WIDER * radius, _WIDER * radius), depth


def _square(a: float, b: float) -> Box:
    return Box(u0=-a, u1=a, v0=-b, v1=b)


def _disc(setting: Setting, force_z: float | None, depth: float) -> tuple[float, float]:
    """Return radius and indentation of a contact as if on a half-space; at most what the probe's size allows."""
    probe = setting.probe
    a, _ = half_extent(probe, setting.first.tilt_deg)
    rubber = setting.youngs_modulus_mpa, setting.poisson_ratio
    if isinstance(probe, Cone):
        slope = 1.0 / math.tan(math.radians(probe.apex_deg / 2))
        radius = 2.0 * depth / (math.pi * slope)
        if force_z is not None:
            radius = cone_contact_radius(force_z, probe.apex_deg, *rubber)
        if radius > probe.tip_mm * math.cos(math.radians(probe.apex_deg / 2)):
            return min(radius, a), math.pi / 2 * min(radius, a) * slope
        a = probe.tip_mm
    like = hertz(
        radius_mm=a, youngs_modulus_mpa=rubber[0], poisson_ratio=rubber[1],
        force_n=force_z, indentation_mm=None if force_z is not None else depth,
    )  # fmt: skip
    return min(like.contact_radius_mm, 0.7 * a), min(like.indentation_mm, 0.5 * a)


def known_contact(
    setting: Setting, control: Control, start: Floats, plane: Plane, touch_z: float
) -> tuple[Box, Floats] | None:
    """Return what `find_contact` does without a search, for an upright sphere, cone or flat face on a flat surface.

    Under a flat face it is the face, up to the middle of its rim; under a sphere or a cone a closed form says it.
    """
    axes, face = setting.first.axes, setting.face
    if (face is None and not isinstance(setting.probe, Sphere | Cone)) or any(setting.first.tilt_deg):
        return None
    place, by_force = np.where(control.by_force, start, control.given), control.by_force.tolist()
    if any(place[ABOUT_X:TURN].tolist()) or any(by_force[:Z]) or not setting.compliance.one_material:
        return None  # it may slide away from there, or is as large as a cover makes it
    given = float(control.given[Z])
    box, depth = guess_box(setting, given if by_force[Z] else None, given - touch_z)
    low, high = setting.body.bounds_mm
    if face is None:
        radius = box.u1 / _WIDER
        if radius <= 0.0 or radius > _THIN * (high[2] - low[2]):
            return None
        box = _square(_INNER * radius, _INNER * radius)
    wider = box.grown((_WIDER - 1.0) * box.u1, (_WIDER - 1.0) * box.v1)
    if axes[2, 2] != 1.0 or not all_level(setting.body, plane, wider):
        middle = setting.first.axis_mm + np.array([*place[:Z], touch_z]) @ axes
        around = middle + np.array(_CORNERS) * (wider.u1, wider.v1) @ axes[:2]
        if np.abs(setting.body.depth(around)).max() > 1e-12:
            return None
    if by_force[Z]:
        place[Z] = touch_z + depth
    return box if face is None else box.grown(-face.edge_mm / 2, -face.edge_mm / 2), place


def fills(contact: Box, box: Box) -> bool:
    """Return whether a contact is as large as it was said to be."""
    return min(found / said for found, said in zip(contact.size, box.size, strict=True)) >= _FILLS


def solve_frictionless(contacts: Contacts, control: Control, place: Floats, touch_z: Floats) -> Equilibrium:
    """Solve the frictionless contact on given patches, from a guess of the place; ``touch_z`` (p,) of each probe."""
    if found := pushed(contacts, control, place, touch_z):
        return found
    k = len(contacts.patches)
    carried = contacts.carried(place)
    held = frictionless_control(contacts, carried, control, place)
    problem = Unilateral(
        compliance=contacts.between, gap=contacts.gap, carried=carried, by_force=held.by_force, given=held.given,
        pushing=held.pushing, friction=np.zeros(k), offset=np.zeros((k, 2)), sideways=False,
    )  # fmt: skip
    least = ends_at(contacts) * (place[Z :: len(_NAMES)] - touch_z)
    found = solve(problem, contacts.gap(place)[0] < -least[contacts.owner], place)
    load, reach = float(np.abs(found.force_n[:, 2]).sum()), problem.reach
    for number, (setting, rows, motions) in enumerate(contacts.rows):
        _check_slide(setting, contacts.grids[number], found, rows, place[motions] - found.place[motions])
        missed = np.where(control.by_force, np.abs(found.total - control.given) / reach, 0.0)[motions]
        if missed.max() > 1e-6 * max(load, 1e-12):
            axis = int(np.argmax(missed))
            unit = "N" if axis < Z else "N mm"
            raise ContactError(
                f"contact: the frictionless {setting.probe.kind} is pushed by {found.total[motions][axis]:.3g} {unit} "
                f"along {_NAMES[axis]} by the slope of the surface, against the "
                f"{control.given[motions][axis]:g} {unit} given: hold {_NAMES[axis]} "
                "by motion (leave it out of force_n), or give press.friction a value"
            )
    return found


def _check_slide(setting: Setting, patches: Patches, found: Equilibrium, rows: slice, moved: Floats) -> None:
    """Raise a ContactError when the equilibrium is further away than the contact is wide: the probe slides off."""
    active = found.active[rows]
    if not active.any():
        return
    slide = float(np.hypot(moved[X], moved[Y]))
    width = max(patches.bounds(active).size)
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


def fitted_grids(settings: Sequence[Setting], planes: Sequence[Plane], contacts: Sequence[Box]) -> tuple[Patches, ...]:
    """Cut the final grids around known contacts: on one lattice where they lie in one plane and are about as fine."""
    boxes = [
        contact.grown(*(max(_MARGIN, _SPARE / setting.across) * size for size in contact.size)).clipped(setting.face)
        for setting, contact in zip(settings, contacts, strict=True)
    ]
    counts = [_counts(*each) for each in zip([setting.across for setting in settings], boxes, contacts, strict=True)]
    if len(boxes) > 1:
        boxes, counts = _on_one_lattice(settings, planes, boxes, counts)
    grids = []
    for setting, plane, box, count in zip(settings, planes, boxes, counts, strict=True):
        grids.append(candidate_patches(setting.body, setting.face, plane, box, count))
        check_somewhere(setting, grids[-1])
    return tuple(grids)


def _on_one_lattice(
    settings: Sequence[Setting], planes: Sequence[Plane], boxes: list[Box], counts: list[tuple[int, int]]
) -> tuple[list[Box], list[tuple[int, int]]]:
    """Return boxes and counts whose cells are those of one lattice, as fine as the finest; as they are if none serves.

    A whole number of cells lies between the middles of the first two, which keep theirs; further ones move by up to
    half a cell.
    """
    first = planes[0]
    away = np.array([first.axes @ (plane.origin_mm - first.origin_mm) for plane in planes])
    even = all(is_even(one.face, box, count) for one, box, count in zip(settings, boxes, counts, strict=True))
    if not even or any(np.any(plane.axes != first.axes) for plane in planes) or np.any(away[:, 2]):
        return boxes, counts
    sizes = np.array([box.size for box in boxes])
    middle = away[:, :2] + [((box.u0 + box.u1) / 2, (box.v0 + box.v1) / 2) for box in boxes]
    step = (sizes / counts).min(axis=0)
    apart = np.abs(middle[1] - middle[0])
    step = np.where(apart > step, apart / np.maximum(np.ceil(apart / step - 1e-6), 1.0), step)
    most = np.ceil(sizes / step - 1e-6)
    cells = most + (most - most[0]) % 2 + (np.arange(len(boxes)) > 1)[:, None]
    first_cell = np.rint((middle - middle[0]) / step - (cells - cells[0]) / 2)
    whole = (first_cell + cells).max(axis=0) - first_cell.min(axis=0)
    every = cells.prod(axis=1).sum()
    if every > _FINER * np.prod(counts, axis=1).sum() or whole.prod() > _WIDE * every:
        return boxes, counts
    low = middle[0] - cells[0] * step / 2 + first_cell * step - away[:, :2]
    high = low + cells * step
    return (
        [Box(u0=a, u1=b, v0=c, v1=d) for (a, c), (b, d) in zip(low.tolist(), high.tolist(), strict=True)],
        [(int(u), int(v)) for u, v in cells],
    )


def find_contact(
    setting: Setting, control: Control, start: Floats, plane: Plane, touch_z: float, *, may_turn: bool = True
) -> tuple[Plane, Box, Floats]:
    """Find the contact of one probe by frictionless solves on coarse grids; return its plane, its box, and the place.

    The plane is the one given, turned so that its axes lie along and across a long contact, if it ``may_turn``.
    """
    force_z = float(control.given[Z]) if control.by_force[Z] else None
    upright = float(plane.axes[2] @ setting.first.axes[2])
    # on a slope the normal force is larger than its part along z, and the probe sinks further along z than along n
    normal_force = None if force_z is None else force_z / upright
    box, depth = guess_box(setting, normal_force, (float(control.given[Z]) - touch_z) * upright)
    place = np.where(control.by_force, start, control.given)
    if control.by_force[Z]:
        place[Z] = touch_z + depth / upright
    turns = _TURNS if may_turn and setting.face is None else 0
    for tried in range(_ROUNDS):
        whole = box.clipped(setting.face)
        patches = candidate_patches(setting.body, setting.face, plane, whole, _counts(_COARSE, whole, whole))
        check_somewhere(setting, patches)
        contacts = Contacts((setting,), (patches,))
        found = solve_frictionless(contacts, control, place, np.array([touch_z]))
        place = found.place
        if not found.active.any():
            box = _about_nearest(contacts, whole, place)
            continue
        if setting.face is not None and found.active.all():
            return plane, whole, place
        contact = patches.bounds(found.active)
        if turns and (turn := turn_along(patches, found.active)) is not None:
            turns -= 1
            plane = Plane(origin_mm=plane.origin_mm, axes=turn @ plane.axes)
            box = turned_box(patches, found.active, turn)
        elif np.any(found.active & patches.border):
            # It grows on all sides: a round grid that only moves after a contact on a slope never holds its corner.
            larger = whole.grown(0.1 * whole.size[0], 0.1 * whole.size[1])
            box = contact.grown(0.3 * contact.size[0], 0.3 * contact.size[1])
            box = box if setting.face is None and box.is_long else box.joined(larger)
        elif tried < _PATIENCE and min(c / w for c, w in zip(contact.size, whole.size, strict=True)) < _FILL:
            box = beside(contact, *patches.cell_mm[found.active].max(axis=0))
        else:
            return plane, contact, place
    check_inside(setting, patches, found, float(place[Z]) - touch_z)
    raise NotSettled(
        f"contact: no grid fits the contact of the {setting.probe.kind} after {_ROUNDS} tries (last: "
        f"{whole.size[0]:.3g} by {whole.size[1]:.3g} mm): press harder, hold x, y and the turns by motion, or "
        "round the probe where it touches (edge_mm, tip_mm)"
    )


def _about_nearest(contacts: Contacts, whole: Box, place: Floats) -> Box:
    """Return a box half as large about the patches that are nearest to the probe: under a face on a slope, its rim."""
    gap = contacts.gap(place)[0]
    nearest = contacts.patches.middle_mm[gap <= gap.min() + 1e-12].mean(axis=0)
    u, v = (size / 4 for size in whole.size)
    return Box(u0=nearest[0] - u, u1=nearest[0] + u, v0=nearest[1] - v, v1=nearest[1] + v)


def check_somewhere(setting: Setting, patches: Patches) -> None:
    """Raise a ContactError when no patch lies on the sensing surface."""
    if len(patches) == 0:
        raise ContactError(
            f"contact: under the {setting.name} no patch lies on the sensing surface: move it away from the edge"
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
    probe = setting.probe
    if isinstance(probe, Sphere) and probe.diameter_mm / 2 < limit:
        limit, what = probe.diameter_mm / 2, "the probe's radius"
    if depth > limit:
        raise ContactError(
            f"contact: the {probe.kind} sinks in by {depth:.3g} mm, allowed is up to {limit:.3g} mm ({what}): "
            "press with less force, or with a larger probe, or on a stiffer body"
        )
    if isinstance(probe, Cone):
        axes, pivot = setting.first.axes, setting.first.axis_mm
        width = 2.0 * _farthest(patches.centre_mm, found.active, pivot, axes, found.place)
        if width > probe.diameter_mm:
            raise ContactError(
                f"contact: it reaches {width:.3g} mm across, over the cone's base of {probe.diameter_mm:g} mm: press "
                "with less force, or give a larger probe.diameter_mm"
            )


@njit(cache=True)
def _farthest(centre: Floats, active: Bools, pivot: Floats, axes: Floats, place: Floats) -> float:
    """Return how far the chosen centres (k, 3) are at most from a probe's axis at its place, mm; 0 of none."""
    farthest = 0.0
    for i in np.flatnonzero(active):
        x, y, z = centre[i, 0] - pivot[0], centre[i, 1] - pivot[1], centre[i, 2] - pivot[2]
        u = x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2] - place[0]
        v = x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2] - place[1]
        farthest = max(farthest, math.hypot(u, v))
    return farthest
