"""The search for a probe's contact, and the grids of patches that fit it.

**Search.** A curved body, a flat face over a barrel, or a large contact are far from Hertz's disc.
Frictionless solves on about a hundred patches find the contact; the grid grows while the contact
reaches its border and shrinks while the contact fills too little of it. On a flat surface a closed
form (Hertz, Sneddon, or the flat face) replaces the search.

**Contacts of any shape.** Contact without friction lies where the probe would overlap the body at
rest, as pressure only moves a surface inwards. Under a surface of triangles, and under any probe
that the search above misses (rings), this overlap at the depth found so far bounds the contact; its
mean width, 4 area / perimeter, gives the size of the patches.

A grid is turned along a long contact: one askew in its grid reaches few cells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError, NotSettled
from twin.parts.material import plane_strain_modulus
from twin.parts.press import PATCHES_ACROSS, Cone, Sphere
from twin.theory.contact import cone_contact_radius, hertz
from twin.world.contact.active_set import Equilibrium, UnilateralProblem, solve
from twin.world.contact.contact_problem import ContactProblem, Control, ProbeSetup
from twin.world.contact.probe_gap import ABOUT_X, TURN, X, Y, Z, half_extent
from twin.world.contact.surface_patches import Box, Patches, Plane

_LONG, _ASKEW = 1.5, math.sin(math.radians(3.0))
_LONG_OVERLAP, _ASKEW_OVERLAP = 1.2, math.sin(math.radians(0.1))
"""Length over width from which a contact has a direction, and how far from an axis of the grid it
may point; the same of an overlap, known better."""

_LINE, _OF_LINE = 10.0, 0.02
"""Length over width from which on an overlap is a line, which cells may miss; and how far its ends
may lie aside, over its width."""

_ON_EVERY_SIDE = 0.15
"""Margin around a contact, over its size."""


def _turn_along(
    middle: Floats, weight: Floats, long: float, askew: float, cell: Floats | None = None
) -> Floats | None:
    """Return the turn (3, 3) about the plane's normal that takes the grid's axes along and across a
    long contact, in which places (k, 2), the middles of cells of half sizes (k, 2), have weights
    (k,); None where they are no more ``askew``, or the contact is no more ``long``."""
    away = middle - weight @ middle / weight.sum()
    spread = (weight * away.T) @ away / weight.sum()
    if cell is not None:
        spread += np.diag(weight @ cell**2) / (3.0 * weight.sum())
    (narrow, wide), directions = np.linalg.eigh(spread)
    u, v = directions[:, 1]
    if cell is not None:
        askew = min(askew, _OF_LINE * math.sqrt(narrow / wide))
    if wide < long**2 * narrow or min(abs(u), abs(v)) < askew:
        return None
    along = (
        np.array([u, v, 0.0]) if abs(u) >= abs(v) else np.array([v, -u, 0.0])
    )  # the axis that is nearer
    along *= math.copysign(1.0, along[0])
    return np.stack([along, [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])


def _turned_box(patches: Patches, active: Bools, turn: Floats) -> Box:
    """Return a box around the contact in a grid that is turned (3, 3) against the patches' own."""
    middle = patches.middle_mm[active] @ turn[:2, :2].T
    lever_arm = float(patches.cell_mm[active].max())
    (u0, v0) = middle.min(axis=0) - lever_arm
    (u1, v1) = middle.max(axis=0) + lever_arm
    return _with_margin(
        Box(u0=float(u0), u1=float(u1), v0=float(v0), v1=float(v1)), lever_arm, lever_arm
    )


def _with_margin(contact: Box, u: float, v: float) -> Box:
    """Return a box with a margin around a contact whose cells have half sizes ``u`` and ``v``."""
    return contact.grown(_ON_EVERY_SIDE * contact.size[0] + u, _ON_EVERY_SIDE * contact.size[1] + v)


_COARSE = 10
_ROUNDS = 14
_FILL, _FITS = 0.4, 0.6
"""Least size of a contact over that of a coarse grid which fits it; and of one whose outline is to
be told by its pressures."""

_PATIENCE = 10
"""Tries after which a grid that holds the contact will do although the contact fills little of it,
as a corner's does."""

_TURNS = 3
"""How often a grid is turned along a contact at most."""

_MARGIN = 0.13
_SPARE = 1.6
"""Share of a contact by which its grid is larger on every side, and how many patches that is at
least."""

_WIDER = 1.25
"""First coarse grid over the contact guessed."""

_INNER = 0.96
"""Half width of a box to be filled with patches over that of the contact: rather more patches
across than asked."""

_CORNERS = ((-1, -1), (1, -1), (-1, 1), (1, 1))

_RASTER = 48
_FINEST = 192
"""Places along each side at which an overlap is looked for, at first and at most."""

_ONE_PIECE = 0.8
_NARROW = 3.0
"""Mean width over the shorter side of its box from which on an overlap counts as one piece (an
ellipse's is 1 or more), and the least mean width in steps of the raster."""

_COARSE_MOST = 400
_DENSE_MOST = 1500
"""Patches at most in the search, and where the compliance between them is stored as a matrix."""

_PIECES_MARGIN = 0.05
_BESIDE = 0.1
_NEAR = 0.1
"""Margin around a contact in pieces, and how far beside it, over its size, its overlap may lie
before a piece counts as missed; change of the depth, and of the place over the contact, that ends
the search."""

_GROWTH = 4.0
"""How many times as deep a probe may come in one try."""

_THIN = 0.15
"""Largest contact over a body's thickness for which closed forms of half-spaces give its size."""

_FINER = 1.5
_WIDE = 8.0
"""How many times as many cells several contacts on one lattice may have, and as many places it
may."""

_END_OF_CONE = 1.0 - 2.0 / math.pi
"""Overlap at rest where contact ends, over the indentation (Sneddon): under a sphere it is 1 / 2
(Hertz)."""

_NAMES = ("x", "y", "z", "the turn about x", "the turn about y", "the turn about z")


def _hold_unfelt_motions(
    contacts: ContactProblem, contact_jacobian: Floats, control: Control, pose: Floats
) -> Control:
    """Hold what frictionless probes can't feel where it is; a ContactError where a torque about the
    axis, or a lateral force on a face without slope, is given."""
    if not np.any(control.by_force & ~contacts.along_z):
        return control
    by_force = control.by_force.copy()
    given = control.given.copy()
    gap, slope = contacts.gap(pose)
    moves = np.abs(slope[np.isfinite(gap)]).max(axis=0, initial=0.0) > 1e-9
    felt = moves & (np.abs(contact_jacobian[:, 2]).max(axis=0) > 1e-9)
    for component in np.flatnonzero(by_force & ~felt):
        axis = component % len(_NAMES)
        setup = contacts.setups[component // len(_NAMES)]
        if axis == Z:
            continue
        if given[component] != 0.0:
            what = (
                f"{given[component]:g} N along {_NAMES[axis]}"
                if axis < Z
                else (f"{given[component]:g} N mm of torque about {_NAMES[axis][-1]}")
            )
            raise ContactError(
                f"contact: {what} can't be balanced by a frictionless {setup.probe.kind} here: "
                f"give press.friction a value, or hold {_NAMES[axis]} by motion"
            )
        by_force[component] = False
        given[component] = pose[component]
    return Control(by_force=by_force, given=given)


def _guess_box(setup: ProbeSetup, force_z: float | None, depth: float) -> tuple[Box, float]:
    """Return a first box around the contact and a first guess of the indentation, from Hertz or
    Sneddon."""
    a, b = half_extent(setup.probe, setup.first.tilt_deg)
    if setup.face is not None:
        stiff = 2.0 * math.sqrt(a * b) * setup.youngs_modulus_mpa
        return _square(a, b), depth if force_z is None else force_z / stiff
    radius, depth = _disc(setup, force_z, depth)
    return _square(_WIDER * radius, _WIDER * radius), depth


def _square(a: float, b: float) -> Box:
    return Box(u0=-a, u1=a, v0=-b, v1=b)


def _disc(setup: ProbeSetup, force_z: float | None, depth: float) -> tuple[float, float]:
    """Return radius and indentation of a contact as if on a half-space; at most what the probe's
    size allows."""
    probe = setup.probe
    a, _ = half_extent(probe, setup.first.tilt_deg)
    rubber = setup.youngs_modulus_mpa, setup.poisson_ratio
    if isinstance(probe, Cone):
        slope = 1.0 / math.tan(math.radians(probe.apex_deg / 2))
        radius = 2.0 * depth / (math.pi * slope)
        if force_z is not None:
            radius = cone_contact_radius(force_z, probe.apex_deg, *rubber)
        if radius > probe.tip_mm * math.cos(math.radians(probe.apex_deg / 2)):
            return min(radius, a), math.pi / 2 * min(radius, a) * slope
        a = probe.tip_mm
    like = hertz(
        radius_mm=a,
        youngs_modulus_mpa=rubber[0],
        poisson_ratio=rubber[1],
        force_n=force_z,
        indentation_mm=None if force_z is not None else depth,
    )
    return min(like.contact_radius_mm, 0.7 * a), min(like.indentation_mm, 0.5 * a)


def closed_form_contact(
    setup: ProbeSetup, control: Control, start: Floats, plane: Plane, touch_z: float
) -> tuple[Box, Floats] | None:
    """Return what `find_contact` does without a search, for an upright sphere, cone or flat face on
    a flat surface.

    Under a flat face it is the face, of a rounded rim as much as touches under the force, which a
    solve on coarse patches gives; under a sphere or a cone a closed form gives it.
    """
    axes = setup.first.axes
    face = setup.face
    if (face is None and not isinstance(setup.probe, Sphere | Cone)) or any(setup.first.tilt_deg):
        return None
    pose = np.where(control.by_force, start, control.given)
    by_force = control.by_force.tolist()
    if any(pose[ABOUT_X:TURN].tolist()) or any(by_force[:Z]) or not setup.compliance.one_material:
        return None  # it may slide away from there, or is as large as a cover makes it
    given = float(control.given[Z])
    box, depth = _guess_box(setup, given if by_force[Z] else None, given - touch_z)
    low, high = setup.body.bounds_mm
    if face is None:
        radius = box.u1 / _WIDER
        if radius <= 0.0 or radius > _THIN * (high[2] - low[2]):
            return None
        box = _square(_INNER * radius, _INNER * radius)
    wider = box.grown((_WIDER - 1.0) * box.u1, (_WIDER - 1.0) * box.v1)
    if axes[2, 2] != 1.0 or not plane.is_level(setup.body, wider):
        middle = setup.first.axis_mm + np.array([*pose[:Z], touch_z]) @ axes
        around = middle + np.array(_CORNERS) * (wider.u1, wider.v1) @ axes[:2]
        if np.abs(setup.body.depth(around)).max() > 1e-12:
            return None
    if by_force[Z]:
        pose[Z] = touch_z + depth
    if face is not None and face.edge_mm > 0.0:
        box = _on_rim(setup, control, plane, box, pose, touch_z)
    return box, pose


def _on_rim(
    setup: ProbeSetup, control: Control, plane: Plane, box: Box, pose: Floats, touch_z: float
) -> Box:
    """Return what touches of an upright flat face with a rounded rim; as far as the rim's middle
    where a torque may incline it, or most of it is rim."""
    face = setup.face
    assert face is not None
    pressed = None
    if not control.by_force[ABOUT_X:TURN].any():
        force = float(control.given[Z])
        if not control.by_force[Z]:
            patches = setup.patches(plane, box, _counts(_COARSE, box, box))
            contacts = ContactProblem((setup,), (patches,))
            found = solve_frictionless(contacts, control, pose, np.array([touch_z]))
            force = float(found.total[Z])
        pressed = face.pressed(
            force / plane_strain_modulus(setup.youngs_modulus_mpa, setup.poisson_ratio)
        )
    if pressed is None:
        return box.grown(-face.edge_mm / 2, -face.edge_mm / 2)
    return _square(*pressed.half_mm)._replace(face=pressed)


def solve_frictionless(
    contacts: ContactProblem, control: Control, pose: Floats, touch_z: Floats
) -> Equilibrium:
    """Solve the frictionless contact on given patches, from a guess of the place; ``touch_z`` (p,)
    of each probe."""
    k = len(contacts.patches)
    contact_jacobian = contacts.contact_jacobian(pose)
    held = _hold_unfelt_motions(contacts, contact_jacobian, control, pose)
    problem = UnilateralProblem(
        influence=contacts.normal_influence,
        gap=contacts.gap,
        contact_jacobian=contact_jacobian,
        by_force=held.by_force,
        given=held.given,
        pushing=held.pushing,
        area_mm2=contacts.patches.area_mm2,
        friction=np.zeros(k),
        offset=np.zeros((k, 2)),
        sideways=False,
    )
    ends = [_END_OF_CONE if isinstance(one.probe, Cone) else 0.5 for one in contacts.setups]
    least = ends * (pose[Z :: len(_NAMES)] - touch_z)
    found = solve(problem, contacts.gap(pose)[0] < -least[contacts.owner], pose)
    load = float(np.abs(found.force_n[:, 2]).sum())
    lever_arm = problem.lever_arm
    for number, (setup, rows, motions) in enumerate(contacts.rows):
        _check_slide(
            setup, contacts.grids[number], found, rows, pose[motions] - found.pose[motions]
        )
        missed = np.where(control.by_force, np.abs(found.total - control.given) / lever_arm, 0.0)[
            motions
        ]
        if missed.max() > 1e-6 * max(load, 1e-12):
            axis = int(np.argmax(missed))
            unit = "N" if axis < Z else "N mm"
            raise ContactError(
                f"contact: the frictionless {setup.probe.kind} is pushed by "
                f"{found.total[motions][axis]:.3g} {unit} along {_NAMES[axis]} by the slope of the "
                f"surface, against the {control.given[motions][axis]:g} {unit} given: hold "
                f"{_NAMES[axis]} by motion (leave it out of force_n), or give press.friction a "
                "value"
            )
    return found


def _check_slide(
    setup: ProbeSetup, patches: Patches, found: Equilibrium, rows: slice, moved: Floats
) -> None:
    """Raise a ContactError when the equilibrium is further away than the contact is wide: the probe
    slides off."""
    active = found.active[rows]
    if not active.any():
        return
    slide = float(np.hypot(moved[X], moved[Y]))
    width = max(patches.bounds(active).size)
    if slide > width:
        raise ContactError(
            f"contact: the frictionless {setup.probe.kind} slides {slide:.2g} mm sideways before "
            f"its lateral forces balance; allowed is the contact's width, {width:.2g} mm: hold x "
            "and y by motion (leave them out of force_n), or give press.friction a value"
        )


def _counts(across: int, box: Box, contact: Box, most: float = math.inf) -> tuple[int, int]:
    """Return cells along u and v: ``across`` squared over the contact, more along its longer
    side; square ones, ``most`` at most, over a contact in pieces."""
    if math.isfinite(contact.width_mm):
        u = v = min(across / contact.width_mm, math.sqrt(most / math.prod(box.size)))
    else:
        shape = (contact.size[0] / contact.size[1]) ** 0.25
        u, v = across * shape / contact.size[0], across / shape / contact.size[1]
    u, v = u * box.size[0], v * box.size[1]
    return max(4, math.ceil(u - 1e-6)), max(4, math.ceil(v - 1e-6))


def fitted_grids(
    setups: Sequence[ProbeSetup], planes: Sequence[Plane], contacts: Sequence[Box]
) -> tuple[Patches, ...]:
    """Cut the final grids around known contacts: on one lattice where they lie in one plane and are
    about as fine."""
    grids = _grids(setups, planes, contacts, math.inf)
    if sum(map(len, grids)) > _DENSE_MOST and any(math.isfinite(one.width_mm) for one in contacts):
        together = ContactProblem(tuple(setups), grids)
        if together.influence_on_lattice is None:
            grids = _grids(setups, planes, contacts, _DENSE_MOST / len(setups))
    return grids


def _grids(
    setups: Sequence[ProbeSetup], planes: Sequence[Plane], contacts: Sequence[Box], most: float
) -> tuple[Patches, ...]:
    """Return what `fitted_grids` does, with at most so many patches for each contact in pieces."""
    boxes = []
    counts = []
    for setup, contact in zip(setups, contacts, strict=True):
        pieces = math.isfinite(contact.width_mm)
        margin = max(_PIECES_MARGIN if pieces else _MARGIN, _SPARE / setup.across)
        box = contact.grown(*(margin * size for size in contact.size)).clipped(setup.face)
        allowed = min(most, setup.most * (setup.across / PATCHES_ACROSS) ** 2)
        count = _counts(setup.across, box, contact, allowed)
        box, count = box.aligned(count, setup.body.base_z_mm)
        boxes.append(box)
        counts.append(count)
    if len(boxes) > 1:
        boxes, counts = _on_one_lattice(setups, planes, boxes, counts)
    return tuple(map(ProbeSetup.patches, setups, planes, boxes, counts))


def _on_one_lattice(
    setups: Sequence[ProbeSetup],
    planes: Sequence[Plane],
    boxes: list[Box],
    counts: list[tuple[int, int]],
) -> tuple[list[Box], list[tuple[int, int]]]:
    """Return boxes and counts whose cells are those of one lattice, as fine as the finest; as they
    are if none serves.

    A whole number of cells lies between the middles of the first two, which keep theirs; further
    ones move by up to half a cell.
    """
    first = planes[0]
    away = np.array([first.axes @ (plane.origin_mm - first.origin_mm) for plane in planes])
    even = all(
        box.is_even(one.face, count) for one, box, count in zip(setups, boxes, counts, strict=True)
    )
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
    ends = np.stack([low, high], axis=2).reshape(-1, 4).tolist()
    return [Box(*one) for one in ends], [(int(u), int(v)) for u, v in cells]


def find_contact(
    setup: ProbeSetup,
    control: Control,
    start: Floats,
    plane: Plane,
    touch_z: float,
    *,
    may_turn: bool = True,
) -> tuple[Plane, Box, Floats]:
    """Find the contact of one probe by frictionless solves on coarse grids; return its plane, its
    box, and the place.

    The plane is the one given, turned so that its axes lie along and across a long contact, if it
    ``may_turn``.
    """
    find = _find_overlap if setup.is_free_form else _find_on_grids
    plane, contact, pose = find(setup, control, start, plane, touch_z, may_turn=may_turn)
    if setup.face is None and not isinstance(setup.probe, Sphere | Cone):
        at = pose

        def gap_at(places: Floats) -> Floats:
            points, normals, on_body = plane.projected(setup.body, places)
            return np.where(on_body, setup.first.gap(points, normals, at)[0], np.nan)

        # coarse cells end up to one within an edge, or beyond it
        counts = _counts(_COARSE, contact, contact, _COARSE_MOST)
        u, v = (size / count for size, count in zip(contact.size, counts, strict=True))
        contact = contact.with_edges(gap_at, contact.grown(u, v))
    return plane, contact, pose


def _find_on_grids(
    setup: ProbeSetup,
    control: Control,
    start: Floats,
    plane: Plane,
    touch_z: float,
    *,
    may_turn: bool,
) -> tuple[Plane, Box, Floats]:
    """Find a contact as `find_contact`, on grids that grow and shrink until one fits it."""
    force_z = float(control.given[Z]) if control.by_force[Z] else None
    upright = float(plane.axes[2] @ setup.first.axes[2])
    # on a slope the normal force is larger than its part along z, and the probe sinks further along
    # z than along n
    normal_force = None if force_z is None else force_z / upright
    box, depth = _guess_box(setup, normal_force, (float(control.given[Z]) - touch_z) * upright)
    pose = np.where(control.by_force, start, control.given)
    if control.by_force[Z]:
        pose[Z] = touch_z + depth / upright
    turns = _TURNS if may_turn and setup.face is None else 0
    for tried in range(_ROUNDS):
        whole = box.clipped(setup.face)
        patches = setup.patches(plane, whole, _counts(_COARSE, whole, whole))
        contacts = ContactProblem((setup,), (patches,))
        found = solve_frictionless(contacts, control, pose, np.array([touch_z]))
        pose = found.pose
        if not found.active.any():
            if setup.face is None:
                return _find_overlap(setup, control, start, plane, touch_z, may_turn=may_turn)
            box = _about_nearest(contacts, whole, pose)
            continue
        if setup.face is not None and found.active.all():
            return plane, whole, pose
        outline = _within_outline(setup, patches, found)
        contact = outline or patches.bounds(found.active)
        weight = found.active * patches.area_mm2
        if (
            turns
            and (turn := _turn_along(patches.middle_mm, weight, _LONG, _ASKEW, patches.cell_mm))
            is not None
        ):
            turns -= 1
            plane = Plane(origin_mm=plane.origin_mm, axes=turn @ plane.axes)
            box = _turned_box(patches, found.active, turn)
        elif np.any(found.active & patches.border):
            # It grows on all sides: a round grid that only moves after a contact on a slope never
            # holds its corner.
            larger = whole.grown(0.1 * whole.size[0], 0.1 * whole.size[1])
            box = contact.grown(0.3 * contact.size[0], 0.3 * contact.size[1])
            box = box if setup.face is None and box.is_long else box.joined(larger)
        elif tried < _PATIENCE and min(
            c / w for c, w in zip(contact.size, whole.size, strict=True)
        ) < (_FILL if outline is None else _FITS):
            box = _with_margin(contact, *patches.cell_mm[found.active].max(axis=0))
        else:
            return plane, contact, pose
    setup.check_inside(patches, found, float(pose[Z]) - touch_z)
    raise NotSettled(
        f"contact: no grid fits the contact of the {setup.probe.kind} after {_ROUNDS} tries (last: "
        f"{whole.size[0]:.3g} by {whole.size[1]:.3g} mm): press harder, hold x, y and the turns by "
        "motion, or round the probe where it touches (edge_mm, tip_mm)"
    )


def _within_outline(setup: ProbeSetup, patches: Patches, found: Equilibrium) -> Box | None:
    """Return the box that is to be filled with patches where a smooth probe's pressures tell its
    contact's outline."""
    cone = isinstance(setup.probe, Cone)
    if not (cone or isinstance(setup.probe, Sphere)):
        return None
    rows = np.flatnonzero(found.active)
    flat = 4.0 * np.prod(patches.cell_mm[rows], axis=1)
    pressure = found.force_n[rows, 2] / patches.area_mm2[rows]
    outline = patches.outline(patches.middle_mm[rows], flat, pressure, bent=cone)
    if outline is None:
        return None
    low, high = outline.min(axis=0), outline.max(axis=0)
    spare = (1.0 - _INNER) / 2.0 * (high - low)
    (u0, v0), (u1, v1) = (low + spare).tolist(), (high - spare).tolist()
    return Box(u0, u1, v0, v1)


def _find_overlap(
    setup: ProbeSetup,
    control: Control,
    start: Floats,
    plane: Plane,
    touch_z: float,
    *,
    may_turn: bool,
) -> tuple[Plane, Box, Floats]:
    """Find a contact of any shape, as `find_contact`, from the probe's overlap with the body at
    rest, at the depth that the solve before leads to."""
    upright = float(plane.axes[2] @ setup.first.axes[2])
    pose = np.where(control.by_force, start, control.given)
    if control.by_force[Z]:
        pose[Z] = touch_z + _disc(setup, float(control.given[Z]) / upright, 0.0)[1] / upright
    turns = _TURNS if may_turn else 0
    for _ in range(_ROUNDS):
        plane, cells, inside, width, turn = _overlap(setup, plane, pose, may_turn=turns > 0)
        if turns and turn is not None and math.isinf(width):
            turns -= 1
            plane = Plane(origin_mm=plane.origin_mm, axes=turn @ plane.axes)
            continue
        contact = cells.bounds(inside)._replace(width_mm=width)
        whole = _with_margin(contact, *cells.cell_mm.max(axis=0))
        counts = _counts(_COARSE, whole, contact, _COARSE_MOST)
        patches = setup.patches(plane, whole, counts)
        contacts = ContactProblem((setup,), (patches,))
        found = solve_frictionless(contacts, control, pose, np.array([touch_z]))
        if not found.active.any():
            return plane, contact, pose
        before = pose
        pose = found.pose.copy()
        depth = before[Z] - touch_z
        pose[Z] = touch_z + np.clip(pose[Z] - touch_z, depth / _GROWTH, depth * _GROWTH)
        near = np.abs(pose - before)[:Z] <= _NEAR * max(contact.size)
        if abs(pose[Z] - before[Z]) <= _NEAR * depth and near.all():
            touched = patches.bounds(found.active)._replace(width_mm=width)
            if np.any(found.active & patches.border):
                # it may reach further, but hardly by more than a patch
                touched = touched.grown(*(2.0 * patches.cell_mm.max(axis=0)))
                return plane, touched, pose
            # Coarse patches may miss a small piece beside the others.
            around = touched.grown(*(_BESIDE * size for size in touched.size))
            missed = math.isfinite(width) and around.joined(contact) != around
            return plane, touched.joined(contact) if missed else touched, pose
    raise NotSettled(
        f"contact: the depth of the {setup.name} did not settle in {_ROUNDS} tries (last: "
        f"{pose[Z] - touch_z:.3g} mm): press by motion, or harder"
    )


def _overlap(
    setup: ProbeSetup, plane: Plane, pose: Floats, *, may_turn: bool
) -> tuple[Plane, Patches, Bools, float, Floats | None]:
    """Return the plane, cells over the probe's overlap with the body at rest, which of them lie in
    it, the mean width of its pieces, mm (inf of one that fills its box), and the turn along it.

    Where nothing overlaps, what is nearest counts. What is too narrow for the cells is sought on
    the probe's own surface, and cut in a plane along it, if that ``may_turn``.
    """
    first = setup.first
    a, b = half_extent(setup.probe, first.tilt_deg)
    reach = a * np.abs(plane.axes[:2] @ first.axes[0]) + b * np.abs(plane.axes[:2] @ first.axes[1])
    u, v = plane.axes[:2] @ (first.axis_mm + pose[:Z] @ first.axes[:Z] - plane.origin_mm)
    whole = Box(u0=u, u1=u, v0=v, v1=v, width_mm=0.0).grown(*(1.1 * reach))
    count = _RASTER
    own: Floats | None = None  # points of the probe's surface in the overlap, in the plane
    while True:
        cells = setup.patches(plane, whole, (count, count))
        gap = first.gap(cells.centre_mm, cells.frames[:, 2], pose)[0]
        inside = gap <= max(0.0, float(gap.min()))
        step = np.array(whole.size) / count
        found = cells.bounds(inside)
        at = np.rint((cells.middle_mm[inside] - (whole.u0, whole.v0)) / step - 0.5).astype(int)
        mask = np.zeros((count + 2, count + 2), bool)
        mask[at[:, 0] + 1, at[:, 1] + 1] = True
        edge = sum(np.count_nonzero(np.diff(mask, axis=axis)) * step[1 - axis] for axis in range(2))
        area = float(np.count_nonzero(mask) * step.prod())
        width = 16.0 / math.pi * area / float(edge)  # a disc's is its diameter
        closer = found.grown(*(2.0 * step))
        missed = not np.any(gap <= 0.0)
        if own is None and (missed or width < _NARROW * step.max()):
            points, apart = first.overlapping(setup.body, pose)
            own = (points - plane.origin_mm) @ plane.axes[:2].T
            turn = None
            if may_turn and len(own):
                turn = _turn_along(own, np.ones(len(own)), _LINE, _ASKEW)
            if turn is not None:
                plane = Plane(origin_mm=plane.origin_mm, axes=turn @ plane.axes)
                own = own @ turn[:2, :2].T
            if len(own) and (missed or turn is not None):
                whole = _around(own).grown(apart, apart)._replace(width_mm=0.0)
                continue
        if own is not None and len(own):
            closer = closer.joined(_around(own))
        if math.prod(closer.size) < 0.5 * math.prod(whole.size):
            whole = closer._replace(width_mm=0.0)
        elif width < _NARROW * step.max() and count < _FINEST:
            count *= 2
        else:
            break
    weight = inside * cells.area_mm2 * np.maximum(-gap, 1e-12)
    turn = _turn_along(cells.middle_mm, weight, _LONG_OVERLAP, _ASKEW_OVERLAP, cells.cell_mm)
    narrow = min(found.size)
    if turn is not None:
        along = cells.middle_mm[inside] @ turn[:2, :2].T
        narrow = min(narrow, float((np.ptp(along, axis=0) + step).min()))
    return plane, cells, inside, math.inf if width > _ONE_PIECE * narrow else width, turn


def _around(points: Floats) -> Box:
    """Return the box around points (n, 2)."""
    (u0, v0), (u1, v1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return Box(u0, u1, v0, v1)


def _about_nearest(contacts: ContactProblem, whole: Box, pose: Floats) -> Box:
    """Return a box half as large about the patches nearest to the probe: under a face on a slope,
    its rim."""
    gap = contacts.gap(pose)[0]
    nearest = contacts.patches.middle_mm[gap <= gap.min() + 1e-12].mean(axis=0)
    u, v = (size / 4 for size in whole.size)
    return Box(u0=nearest[0] - u, u1=nearest[0] + u, v0=nearest[1] - v, v1=nearest[1] + v)
