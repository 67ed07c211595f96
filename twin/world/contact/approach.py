"""Bringing a probe along its direction until it touches a body: where, and at which height."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.press import Press, Probe, frame_of
from twin.parts.probe import Pillar, Stl
from twin.world.contact.gap import Approach
from twin.world.contact.probe_shape import half_extent, rotation_of, shape_of

_LEVELS, _ACROSS = 14, 25
_STEPS = np.stack(np.meshgrid(*2 * [np.linspace(-1.0, 1.0, _ACROSS)]), axis=-1).reshape(-1, 2)
_ON_SURFACE_MM = 1e-3


def meeting(body: Body, direction: Floats) -> Callable[[Points], tuple[Floats, Bools]]:
    """Return what tells where lines along a direction (3,) first meet a body.

    Of (k, 3) points of the lines it returns (k,) how far along the direction the body is met, mm, NaN where it isn't,
    and (k,) whether on its sensing surface.
    """
    if direction[2] == 1.0:

        def from_above(points: Points) -> tuple[Floats, Bools]:
            seen = body.surface_from_above(points[:, :2])[:, 2] - points[:, 2]
            return seen, np.isfinite(seen)

        return from_above
    tree = None
    if body.own_surface is not None:
        from twin.geometry.nearest import box_tree, first_along

        vertices, triangles = body.own_surface
        tree = box_tree(vertices[triangles])

    def anywhere(points: Points) -> tuple[Floats, Bools]:
        if tree is None:
            distance = _met_by_pieces(body, points, direction)
        else:
            triangle, distance = first_along(tree, points, np.broadcast_to(direction, points.shape))
            distance = np.where(triangle >= 0, distance, np.nan)
        met = np.isfinite(distance)
        foot = points + np.where(met, distance, 0.0)[:, None] * direction
        return distance, met & (np.abs(body.depth(foot)) < 1e-6) & body.contains(foot, -1e-6)

    return anywhere


def _met_by_pieces(body: Body, points: Points, direction: Floats) -> Floats:
    """Find where lines enter a convex body: behind the last of its pieces, by Newton's steps from outside."""
    low, high = np.array(body.bounds_mm)
    far = 2.0 * float(np.abs(points).max() + np.linalg.norm(high - low) + np.abs(low).max())
    distance = np.full(len(points), -far)
    for _ in range(60):
        here = points + distance[:, None] * direction
        pieces = body.piece_distances(here)
        last = np.argmin(pieces, axis=1)
        left = pieces[np.arange(len(points)), last]
        steep = body.piece_normals(here)[np.arange(len(points)), last] @ direction
        step = np.where((steep > 1e-6) & (left < 0.0), -left / np.maximum(steep, 1e-6), 0.0)
        distance = distance + step
        if np.abs(step).max(initial=0.0) < 1e-13 * far:
            break
    return np.where(np.abs(left) <= 1e-9 * far, distance, np.nan)


def surface_place(body: Body, at_mm: tuple[float, ...]) -> Floats:
    """Return (3,) the place on the sensing surface that a press names.

    Raises
    ------
    InputError
        It is not on the sensing surface.
    """
    (x0, y0, z0), (x1, y1, z1) = body.bounds_mm
    if len(at_mm) == 2:
        found = body.surface_from_above(np.array([at_mm], float))[0]
        if np.isnan(found[2]):
            raise InputError(
                f"press.at_mm = ({at_mm[0]:g}, {at_mm[1]:g}) mm misses the sensing surface, which lies within x {x0:g} "
                f"to {x1:g} mm and y {y0:g} to {y1:g} mm: move at_mm over the body"
            )
        return np.asarray(found)
    place = np.array([at_mm], float)
    off = float(body.depth(place)[0])
    if abs(off) > _ON_SURFACE_MM or not body.contains(place, -_ON_SURFACE_MM)[0]:
        where = "inside the body" if body.contains(place, _ON_SURFACE_MM)[0] else "off the sensing surface"
        raise InputError(
            f"press.at_mm = ({', '.join(f'{c:g}' for c in at_mm)}) mm lies {where} (depth {off:.4g} mm, allowed up to "
            f"{_ON_SURFACE_MM:g} mm; the body lies within x {x0:g} to {x1:g}, y {y0:g} to {y1:g}, z {z0:g} to {z1:g} "
            "mm): give a place on the surface, or (x, y) alone"
        )
    return np.asarray(place[0])


def approach_of(press: Press, body: Body) -> Approach:
    """Bring a press's probe along its direction until it touches the body.

    Raises
    ------
    InputError
        The place is not on the sensing surface, the probe would come from inside the body, or it misses the surface.
    """
    flat_z = press.direction is None or press.direction == (0.0, 0.0, 1.0)
    if flat_z and len(press.at_mm) == 2:
        return approach(press.probe, body, np.array([*press.at_mm, 0.0]), np.eye(3), press.tilt_deg)
    place = surface_place(body, press.at_mm)
    inward = body.piece_normals(place[None])[0, 0]
    along = inward if press.direction == "normal" else np.array(press.direction or (0.0, 0.0, 1.0), float)
    axes = frame_of(tuple(along))
    along = axes[2]
    if along @ inward <= 0.05:
        raise InputError(
            f"press.direction = ({', '.join(f'{c:.3g}' for c in along)}) at ({', '.join(f'{c:.3g}' for c in place)}) "
            f"mm comes from inside the body, or along its surface (its inward normal is "
            f"({', '.join(f'{c:.3g}' for c in inward)})): turn it inwards, or use 'normal'"
        )
    return approach(press.probe, body, place, axes, press.tilt_deg)


def approach(
    probe: Probe, body: Body, at_mm: Floats, axes: Floats | None = None,
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0), turn: Floats | None = None,
) -> Approach:  # fmt: skip
    """Bring a probe along its own z onto a body until it touches.

    Parameters
    ----------
    probe, body
        The rigid probe and the undeformed body.
    at_mm
        (3,) any point of the probe's axis; (2,) is one along z.
    axes
        (3, 3) the probe's own axes as rows; the global ones if not given.
    tilt_deg, turn
        Its turn before the press, and the (3,) rotation vector since, radians.

    Raises
    ------
    InputError
        The probe misses the sensing surface.

    Notes
    -----
    The smallest height of the surface over the probe is found on grids that shrink around the minimum; ties (a flat
    face on a flat body, or along a barrel) are averaged. Where the surface is as high everywhere under an upright
    probe, its lowest point is the one.
    """
    axes = np.eye(3) if axes is None else axes
    at = np.zeros(3)
    at[: len(at_mm)] = at_mm
    turned = None if turn is None else rotation_of(turn)
    a, b = half_extent(probe, tilt_deg)
    reach = math.hypot(a, b)
    upright = not isinstance(probe, Stl) and not any(tilt_deg) and (turned is None or turned[2, 2] == 1.0)
    if upright and axes[2, 2] == 1.0 and body.is_level_around(float(at[0]), float(at[1]), reach):
        at[2] = 0.0
        return Approach(probe=probe, axis_mm=at, touch_mm=at, axes=axes, tilt_deg=tilt_deg, level=True)
    turned = np.eye(3) if turned is None else turned
    meets, half = meeting(body, axes[2]), np.full(2, reach) if isinstance(probe, Pillar) else np.array((a, b))
    centre, height, touch, on_sensing = np.zeros(2), np.inf, np.full(2, np.nan), True
    shape, along = shape_of(probe, tilt_deg), np.broadcast_to(turned[2], (_ACROSS**2, 3))
    for _ in range(_LEVELS):
        offset = centre + _STEPS * half
        surface, sensing = meets(at + offset @ axes[:2])
        if upright and sensing.all() and np.all(surface == surface[0]):
            height, touch = float(surface[0]), np.zeros(2)
            break
        rise = shape.met(np.column_stack([offset, np.zeros(len(offset))]) @ turned, along)[0]
        height_here = surface + np.where(np.isfinite(rise), rise, np.nan)
        height_here = np.where(np.isfinite(height_here), height_here, np.inf)
        lowest = float(height_here.min())
        if not math.isfinite(lowest):
            break
        ties = height_here <= lowest + (1e-12 if axes[2, 2] == 1.0 else 1e-10)
        middle = offset[ties].mean(axis=0)
        if lowest < height:
            height, touch, on_sensing = lowest, middle, bool(sensing[ties].any())
        centre, half = touch, half / 3
    name = f"the {probe.kind} at ({', '.join(f'{c:g}' for c in at_mm)}) mm"
    if not math.isfinite(height):
        (x0, y0, _), (x1, y1, _) = body.bounds_mm
        raise InputError(
            f"{name} misses the sensing surface, which lies within "
            f"x {x0:g} to {x1:g} mm and y {y0:g} to {y1:g} mm: move at_mm or the step's motion over the body"
        )
    met = at + touch @ axes[:2]
    point = met + meets(met[None])[0][0] * axes[2]
    if not on_sensing or not np.isfinite(point).all():
        raise InputError(
            f"{name} first touches the body off its sensing surface, near "
            f"({', '.join(f'{c:.3g}' for c in np.nan_to_num(point))}) mm: move at_mm, or change direction or tilt_deg"
        )
    return Approach(probe=probe, axis_mm=at + height * axes[2], touch_mm=point, axes=axes, tilt_deg=tilt_deg)
