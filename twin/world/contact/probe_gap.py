"""Rigid probes as surfaces, the gap from a body's surface to them, and first touch.

**Shapes** stand as the probe does before it moves: lowest point at the origin, z into the body. A
rounded convex probe is a sharp body with a ball rolled around it. The distance to the sharp body
has a closed form and is convex along a line, so that Newton's steps from outside can't pass the
first intersection.

**Poses** are q = (x, y, z, about x, about y, turn): mm from first touch and radians, along and
about the probe's own axes, whose z is its direction of approach. The turns are one rotation vector
about its lowest point.

**Gaps** are measured along the normal of each surface point, the direction in which the pressure
acts, to the exact shape of the probe (not its parabola).

**First touch.** `approach` moves a probe along its z until it touches the body.

Validity: gaps are exact for any turn, but in linear theory forces act along normals of the surface
at rest (docs/validity.md: 2 % off under a cylinder that is tilted by 10 degrees).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.compiled import njit
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.press import Cone, Cylinder, Object, Pillar, Press, Probe, Sphere, Stl

if TYPE_CHECKING:
    from twin.geometry.pieces import TriangleTree

GRAZING = 1e-3
"""A line that meets a probe at a smaller sine than this doesn't meet it."""

CONE, ROUND, SQUARE = range(3)
_NEWTON = 60

_TINY_MM = 1e-150
"""What lies nearer to the sharp body lies on it: the squares of smaller lengths are 0, and nothing
divides by them."""


@dataclass(frozen=True)
class _Rounded:
    """All places nearer than ``radius_mm`` to a sharp convex body.

    Attributes
    ----------
    sharp, sizes
        An endless `CONE` that opens towards -z, with sine and cosine of its half angle and its
        apex's height; or a `ROUND` or `SQUARE` shaft, with its half widths along x and y and the
        height at which it ends flat. mm.
    radius_mm
        Of the ball.
    """

    sharp: int
    sizes: tuple[float, float, float]
    radius_mm: float

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        points, along = np.ascontiguousarray(points), np.ascontiguousarray(along)
        distance, normal = _enter(points, along, self.sharp, self.sizes, self.radius_mm)
        return distance, normal


@njit(cache=True)
def _enter(
    points: Floats, along: Floats, sharp: int, sizes: tuple[float, float, float], radius: float
) -> tuple[Floats, Floats]:
    distance = np.empty(len(points))
    normal = along.copy()
    largest = 0.0
    for i in range(len(points)):
        largest = max(largest, abs(points[i, 0]), abs(points[i, 1]), abs(points[i, 2]))
    far = 10.0 * (1.0 + radius + largest)
    for i in range(len(points)):
        e0, e1, e2 = along[i]
        way = -far
        left = 0.0
        met = False
        for _ in range(_NEWTON):
            x = points[i, 0] - way * e0
            y = points[i, 1] - way * e1
            z = points[i, 2] - way * e2
            left, n0, n1, n2 = _distance(x, y, z, sharp, sizes)
            left -= radius
            steep = n0 * e0 + n1 * e1 + n2 * e2
            met = steep > GRAZING
            if not met:
                break
            way += left / steep
            if abs(left / steep) < 1e-13 * far:
                break
        if met and abs(left) <= 1e-9 * far:
            distance[i] = way
            normal[i, 0] = n0
            normal[i, 1] = n1
            normal[i, 2] = n2
        else:
            distance[i] = math.inf
    return distance, normal


@njit(cache=True)
def _distance(
    x: float, y: float, z: float, sharp: int, sizes: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """Return the distance to the sharp body, negative inside, and its gradient."""
    rho = math.hypot(x, y)
    out_x, out_y = (x / rho, y / rho) if rho > 0.0 else (0.0, 0.0)
    if sharp == CONE:
        sine = sizes[0]
        cosine = sizes[1]
        up = z - sizes[2]
        if rho * sine > up * cosine:
            return rho * cosine + up * sine, cosine * out_x, cosine * out_y, sine
        away = max(math.hypot(rho, up), 1e-300)  # the apex is nearest
        return away, x / away, y / away, up / away
    below = z - sizes[2]
    if sharp == ROUND:
        with_margin = rho - sizes[0]
        b = -math.inf
        a_x = out_x
        a_y = out_y
        b_y = 0.0
    else:
        with_margin = abs(x) - sizes[0]
        b = abs(y) - sizes[1]
        a_x = np.sign(x)
        a_y = 0.0
        b_y = np.sign(y)
    if max(with_margin, b, below) <= _TINY_MM:
        if with_margin >= b and with_margin >= below:
            return with_margin, a_x, a_y, 0.0
        return (b, 0.0, b_y, 0.0) if b >= below else (below, 0.0, 0.0, 1.0)
    p = max(with_margin, 0.0)
    q = max(b, 0.0)
    r = max(below, 0.0)
    away = math.sqrt(p * p + q * q + r * r)
    return away, p * a_x / away, (p * a_y + q * b_y) / away, r / away


RIM = 1.005
"""A patch whose middle lies this share of the half width from the middle still belongs to a flat
face that is upright; an inclined one's rim would sink in deeper than it is pressed."""


class Shape(Protocol):
    """A probe's surface."""

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """Return how far outwards, against ``along``, lines enter the probe, and its outward normal
        there.

        Parameters
        ----------
        points, along
            (k, 3) points, mm, and unit vectors, in the probe's own axes; a line comes from far
            along ``along``.

        Returns
        -------
        distance
            (k,) mm, negative where the point lies beyond the probe's surface; inf where the line
            misses it.
        normal
            (k, 3) outward unit normals of the probe; ``along`` where the line misses.
        """
        ...


@dataclass(frozen=True)
class _Ball:
    """A sphere."""

    radius_mm: float

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        radius = self.radius_mm
        x, y, z = points.T
        z = z + radius
        ahead = x * along[:, 0] + y * along[:, 1] + z * along[:, 2]
        inside = ahead * ahead - (x * x + y * y + z * z) + radius * radius
        met = inside > (GRAZING * radius) ** 2
        way = ahead - np.sqrt(np.where(met, inside, 0.0))
        normal = (np.column_stack([x, y, z]) - way[:, None] * along) / radius
        return np.where(met, way, np.inf), np.where(met[:, None], normal, along)


@dataclass(frozen=True)
class _Face:
    """A flat face with a sharp rim, which touches with its face.

    ``rim`` is the share of the half width up to which places belong to it: see `RIM`.
    """

    probe: Cylinder | Pillar
    rim: float = 1.0

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `Shape`; the sides above the rim are left out."""
        upright = np.maximum(along[:, 2], 1e-9)
        distance = points[:, 2] / upright
        over = points - distance[:, None] * along
        met = (along[:, 2] > GRAZING) & _within_footprint(self.probe, over[:, :2] / self.rim)
        down = np.broadcast_to([0.0, 0.0, 1.0], along.shape)
        return np.where(met, distance, np.inf), np.where(met[:, None], down, along)


def _within_footprint(probe: Cylinder | Pillar, offset_mm: Floats) -> Bools:
    """Return (k,) whether offsets (k, 2) from the axis lie under the flat face, its border
    included."""
    if isinstance(probe, Cylinder):
        return np.asarray(np.hypot(offset_mm[:, 0], offset_mm[:, 1]) <= probe.diameter_mm / 2)
    return np.asarray(np.all(np.abs(offset_mm) <= np.array(probe.size_mm) / 2, axis=1))


_SAMPLED, _SEEN = 24.0, 0.5
"""Reach of a surface of triangles over how far its samples lie apart, and the sine up to which what
faces away is sampled, too, as the probe may turn."""


@dataclass(frozen=True, eq=False)
class _Triangles:
    """The closed surface of an STL file, (m, 3, 3) corners wound outwards."""

    corners: Floats

    @cached_property
    def reach_mm(self) -> float:
        """Distance of the farthest corner from the origin."""
        return float(np.linalg.norm(self.corners, axis=2).max())

    @cached_property
    def samples(self) -> Points:
        """(n, 3) points of what faces the body, so close that none of its narrow parts lies between
        them: corners, and the middles of sides that are halved until they are short."""
        corners = self.corners
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        towards = facing[:, 2] > -_SEEN * np.linalg.norm(facing, axis=1)
        left, found = corners[towards], [corners.reshape(-1, 3)]
        while len(left):
            side = np.linalg.norm(left - np.roll(left, -1, axis=1), axis=2)
            longest = side.argmax(axis=1)
            split = side.max(axis=1) > self.sampled_mm
            left, longest = left[split], longest[split, None, None]
            a, b, c = (np.take_along_axis(left, (longest + k) % 3, axis=1) for k in range(3))
            middle = (a + b) / 2.0
            found.append(middle[:, 0])
            left = np.concatenate([np.hstack([a, middle, c]), np.hstack([middle, b, c])])
        return np.unique(np.concatenate(found), axis=0)

    @property
    def sampled_mm(self) -> float:
        """How far these lie apart at most, mm."""
        return self.reach_mm / _SAMPLED

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        triangle, distance = _tree_of(self).first_along(points, -along)
        a, b, c = (self.corners[np.maximum(triangle, 0), k] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        met = (triangle >= 0) & (np.einsum("ki,ki->k", normal, along) > GRAZING)
        return np.where(met, distance, np.inf), np.where(met[:, None], normal, along)


@lru_cache(maxsize=8)
def _tree_of(shape: _Triangles) -> TriangleTree:
    from twin.geometry.pieces import TriangleTree

    return TriangleTree(shape.corners)


@dataclass(frozen=True, eq=False)
class _Smooth:
    """The heights z of a surface over a square of its own x and y, as cubic splines."""

    heights: Any
    off_mm: float  # largest distance of a sample

    @classmethod
    def of(cls, shape: Shape, low: Floats, high: Floats, cells: int, deep_mm: float) -> _Smooth:
        """Fit the heights of a shape between two corners (2,), mm, by least squares with so many
        cells along a side; where it isn't met they go on as they like. Samples higher than
        ``deep_mm`` don't count in the distance, which is infinite where others aren't met."""
        from scipy.interpolate import NdBSpline, make_lsq_spline

        lines = np.linspace(low, high, _SAMPLES * cells + 1).T
        knots = [
            np.concatenate([[a] * 3, np.linspace(a, b, cells + 1), [b] * 3])
            for a, b in zip(low, high, strict=True)
        ]
        flat = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
        points = np.column_stack([flat, np.zeros(len(flat))])
        known = -shape.met(points, np.broadcast_to([0.0, 0.0, 1.0], points.shape))[0]
        met = np.isfinite(known)
        wanted = np.where(met, known, known[met].min(initial=0.0))
        for _ in range(1 if met.all() else _FILLINGS):
            half = make_lsq_spline(lines[0], wanted.reshape(len(lines[0]), -1), knots[0]).c
            whole = make_lsq_spline(lines[1], half.T, knots[1]).c.T
            heights = NdBSpline(tuple(knots), whole, 3)
            fitted = heights(flat)
            wanted = np.where(met, known, fitted)
        close = fitted > -deep_mm
        off = np.where(met, np.abs(known - fitted), np.inf)[close]
        return cls(heights, float(off.max(initial=0.0)))

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `Shape`."""
        knots = self.heights.t
        low, high = np.array([[line[0], line[-1]] for line in knots]).T
        way = np.zeros(len(points))
        for _ in range(_SMOOTH_STEPS):
            here = points - way[:, None] * along
            inside = np.all((here[:, :2] >= low) & (here[:, :2] <= high), axis=1)
            flat = np.clip(here[:, :2], low, high)
            slope = [self.heights(flat, nu=nu) for nu in ((1, 0), (0, 1))]
            normal = np.column_stack([-slope[0], -slope[1], np.ones(len(flat))])
            steep = np.einsum("ki,ki->k", normal, along)
            step = (here[:, 2] - self.heights(flat)) / np.maximum(steep, GRAZING)
            way += step
            if np.abs(step[inside]).max(initial=0.0) < _SMOOTH_MM:
                break
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        met = inside & (steep > GRAZING) & (np.abs(step) < _SMOOTH_MM)
        return np.where(met, way, np.inf), np.where(met[:, None], normal, along)


@dataclass(frozen=True, eq=False)
class _Tilted:
    """A shape turned about its origin; ``rotation`` (3, 3) takes its own axes to the outer ones."""

    shape: Shape
    rotation: Floats

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        distance, normal = self.shape.met(points @ self.rotation, along @ self.rotation)
        return distance, normal @ self.rotation.T


_SAMPLES, _FILLINGS, _SMOOTH_STEPS, _SMOOTH_MM = 4, 8, 12, 1e-9
"""Samples of a height in a cell of splines along an axis, how often places without one are filled,
and Newton's steps to where a line meets the splines, which is known so well."""

FLAT_TILT_DEG = 20.0
"""A flat face that is tilted less touches with its face, one that is tilted more with its rim."""

_NO_TURN = 1e-100
"""A turn so small, radians, turns nothing, and its square is 0."""


def _tilt_of(tilt_deg: tuple[float, float, float]) -> Floats:
    """Return the rotation by angles about x, then y, then z."""
    whole = np.eye(3)
    for axis, angle in enumerate(tilt_deg if any(tilt_deg) else ()):
        whole = Approach.rotation_of(math.radians(angle) * np.eye(3)[axis]) @ whole
    return whole


def _is_flat(probe: Probe, tilt_deg: tuple[float, float, float]) -> bool:
    """Return whether a probe touches with a flat face."""
    if not isinstance(probe, Cylinder | Pillar):
        return False
    return not any(tilt_deg) or bool(
        _tilt_of(tilt_deg)[2, 2] >= math.cos(math.radians(FLAT_TILT_DEG))
    )


def _shape_of(
    probe: Probe, tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0), rim: float = 1.0
) -> Shape:
    """Return the surface of a probe, tilted before it comes; ``rim`` of a flat face as in
    `_Face`."""
    if isinstance(probe, Sphere):
        return _Ball(probe.diameter_mm / 2)  # looks the same however it is turned
    if isinstance(probe, Stl):
        return _stl_shape(probe.file, probe.sha256, tilt_deg)
    if isinstance(probe, Object):
        return _object_shape(probe.shape, probe.width_mm, tilt_deg)
    shape: Shape
    if isinstance(probe, Cone):
        # the ball that rounds the tip touches the plane z = 0 with its lowest point
        half = math.radians(probe.apex_deg / 2)
        shape = _Rounded(CONE, (math.sin(half), math.cos(half), -probe.tip_mm), probe.tip_mm)
    elif probe.edge_mm == 0.0 and _is_flat(probe, tilt_deg):
        shape = _Face(probe, rim)
    else:
        a, b = half_extent(probe)
        kind = ROUND if isinstance(probe, Cylinder) else SQUARE
        edge = probe.edge_mm
        shape = _Rounded(kind, (a - edge, b - edge, -edge), edge)
    return _Tilted(shape, _tilt_of(tilt_deg)) if any(tilt_deg) else shape


@lru_cache(maxsize=8)
def _stl_shape(file: str, _sha256: str, tilt_deg: tuple[float, float, float]) -> _Triangles:
    """Return the surface of an STL file, tilted."""
    from twin.geometry.closed import PROBE_SIZE_MM, Surface

    surface = Surface.read(file, PROBE_SIZE_MM)
    return _tilted(surface.vertices[surface.triangles], tilt_deg)


@lru_cache(maxsize=8)
def _object_shape(shape: str, width_mm: float, tilt_deg: tuple[float, float, float]) -> _Triangles:
    """Return the surface of an object, tilted."""
    from twin.geometry.objects import object_triangles

    return _tilted(object_triangles(shape, width_mm), tilt_deg)


def _tilted(corners: Floats, tilt_deg: tuple[float, float, float]) -> _Triangles:
    """Return triangles (m, 3, 3) turned about the origin, their lowest point (largest z) moved to
    z = 0."""
    corners = corners @ _tilt_of(tilt_deg).T
    corners[..., 2] -= corners[..., 2].max()
    return _Triangles(corners)


def half_extent(
    probe: Probe, tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[float, float]:
    """Return the probe's half sizes along its own first and second axis, mm: of a tilted one, of a
    box around it."""
    if isinstance(probe, Pillar):
        a, b = probe.size_mm[0] / 2, probe.size_mm[1] / 2
        return (math.hypot(a, b),) * 2 if any(tilt_deg) else (a, b)
    if isinstance(probe, Sphere | Cylinder | Cone):
        return (probe.diameter_mm / 2,) * 2
    shape = _shape_of(probe, tilt_deg)
    assert isinstance(shape, _Triangles)
    reach = np.abs(shape.corners[..., :2]).max(axis=(0, 1))
    return float(reach[0]), float(reach[1])


X, Y, Z, ABOUT_X, ABOUT_Y, TURN = range(6)
MOTIONS = 6

_IDENTITY = np.eye(3)


@dataclass(frozen=True, kw_only=True)
class Approach:
    """A probe that just touches a body.

    Attributes
    ----------
    probe, tilt_deg
        The rigid probe, and its turn about its own axes before it comes.
    axes
        (3, 3) its own axes as rows; the last one is the direction of approach.
    axis_mm
        (3,) the place of its lowest point (before it was tilted) at first touch; torques count
        about it.
    touch_mm
        (3,) surface point that is touched first (the middle of them if there are many).
    level
        Whether it is known that the surface is as high everywhere under the probe.
    """

    probe: Probe
    axis_mm: Floats
    touch_mm: Floats
    axes: Floats
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    level: bool = False
    smooth: Shape | None = None

    @cached_property
    def shape(self) -> Shape:
        """The probe's surface."""
        rim = 1.0 if any(self.tilt_deg[:Z]) else RIM
        return self.smooth or _shape_of(self.probe, self.tilt_deg, rim)

    def held_turned(self, turn: Floats) -> Approach:
        """Return the probe as one that was tilted by a turn (3,), a rotation vector about its own
        axes, before it came: without friction it is the same at equal places."""
        from scipy.spatial.transform import Rotation

        if not turn.any():
            return self
        whole = Rotation.from_matrix(Approach.rotation_of(turn) @ self.tilt)
        x, y, z = whole.as_euler("xyz", degrees=True).tolist()
        return replace(self, tilt_deg=(x, y, z))

    def smoothed(
        self, low: Floats, high: Floats, deep_mm: float, cells: int
    ) -> tuple[Approach, float]:
        """Return a probe whose triangles are smooth between two corners (2,) of its own x and y,
        mm, as `_Smooth` of so many cells, and how far these lie off the triangles where the probe
        is ``deep_mm`` high at most, infinite where it ends there; another probe as it is."""
        if not isinstance(self.shape, _Triangles):
            return self, 0.0
        smooth = _Smooth.of(self.shape, low, high, cells, deep_mm)
        return replace(self, smooth=smooth), smooth.off_mm

    def overlapping(self, body: Body, pose: Floats) -> tuple[Points, float]:
        """Return points (n, 3) of a probe of triangles at a pose (6,) that lie inside a body at
        rest, and how far they lie apart, mm; none of another probe, or where none does."""
        if not isinstance(self.shape, _Triangles):
            return np.zeros((0, 3)), 0.0
        turned = self.axes.T @ Approach.rotation_of(pose[ABOUT_X:])
        points = self.axis_mm + pose[: Z + 1] @ self.axes + self.shape.samples @ turned.T
        (low, high) = np.array(body.bounds_mm)
        points = points[np.all((points > low) & (points < high), axis=1)]
        return points[body.depth(points) > 0.0], self.shape.sampled_mm

    def check_depth(self, press: Press, body: Body) -> None:
        """Raise `InputError` if a press's motions lead it deeper than a probe may sink in."""
        (_, _, low), (_, _, high) = body.bounds_mm
        limit, what = Press.deepest_mm(press.probe, high - low)
        depth = 0.0
        for by_force, given in press.in_own_axes(self.axes):
            if by_force[Z]:
                return
            depth += given[Z]
            if depth > limit:
                raise InputError(
                    f"press: the {press.probe.kind} would sink in by {depth:.3g} mm, allowed is up "
                    f"to {limit:.3g} mm ({what}): reduce press.indentation_mm (or move_mm in the "
                    "steps)"
                )

    @cached_property
    def is_flat(self) -> bool:
        """Whether the probe touches with a flat face, so that its footprint bounds the contact."""
        return _is_flat(self.probe, self.tilt_deg)

    @cached_property
    def is_round(self) -> bool:
        """Whether the probe touches with a round tip."""
        upright = not any(self.tilt_deg[:Z])
        return isinstance(self.probe, Sphere) or (isinstance(self.probe, Cone) and upright)

    @cached_property
    def has_face(self) -> bool:
        """Whether the probe ends in a flat face, however it is tilted."""
        return isinstance(self.probe, Cylinder | Pillar)

    def own(self, points: Points) -> Points:
        """Return points (n, 3) in the own axes of the tilted probe at first touch."""
        return np.asarray((points - self.axis_mm) @ self.axes.T @ self.tilt)

    def beyond_face(self, points: Points) -> Floats:
        """Return (n,) how far points lie outside the outline of a flat face at first touch, seen
        along its normal, mm; inside it, minus the distance."""
        own = np.abs(self.own(points)[:, :Z])
        half = np.array(half_extent(self.probe))
        if isinstance(self.probe, Cylinder):
            return np.asarray(np.hypot(*own.T) - half[0])
        out = np.linalg.norm(np.maximum(own - half, 0.0), axis=1)
        return np.asarray(np.where(out > 0.0, out, np.max(own - half, axis=1)))

    @cached_property
    def tilt(self) -> Floats:
        """(3, 3) the rotation of the probe before it comes."""
        return _tilt_of(self.tilt_deg)

    def jacobian(self, points: Points, frames: Floats, aside: Floats) -> Floats:
        """Return (k, 3, 6) how the probe's points at points (k, 3) move, in frames (k, 3, 3),
        along and about its axes, which have moved ``aside`` (3,)."""
        about = np.cross(self.axes[None], (points - self.axis_mm - aside)[:, None])
        motions = np.concatenate([np.broadcast_to(self.axes, about.shape), about], axis=1)
        return np.asarray(frames @ motions.transpose(0, 2, 1))

    def gap(self, points: Points, normals: Floats, pose: Floats) -> tuple[Floats, Floats]:
        """Return gaps along the outward normals and their derivatives with respect to the probe's
        place.

        Parameters
        ----------
        points, normals
            (k, 3) points of the undeformed surface, mm, and their unit inward normals.
        pose
            (6,) q.

        Returns
        -------
        gap
            (k,) mm; negative where the probe would overlap the undeformed body, inf where it can't
            be met.
        slope
            (k, 6) d gap / d place.
        """
        own = (points - self.axis_mm) @ self.axes.T - pose[: Z + 1]
        along = normals @ self.axes.T
        turn = pose[ABOUT_X:]
        if not turn.any():
            gap, normal = self.shape.met(own, along)
            return gap, _slopes(own, along, gap, normal, _IDENTITY, _IDENTITY)
        turned = Approach.rotation_of(turn)
        gap, normal = self.shape.met(own @ turned, along @ turned)
        return gap, _slopes(own, along, gap, normal, turned, Approach.turning_of(turn))

    @staticmethod
    def of_press(press: Press, body: Body) -> Approach:
        """Bring a press's probe along its direction until it touches the body.

        Raises
        ------
        InputError
            The place is not on the sensing surface, the probe would come from inside the body, or
            it misses the surface.
        """
        flat_z = press.direction is None or press.direction == (0.0, 0.0, 1.0)
        if flat_z and len(press.at_mm) == 2:
            return Approach.of(
                press.probe, body, np.array([*press.at_mm, 0.0]), np.eye(3), press.tilt_deg
            )
        place = _point_on_surface(body, press.at_mm)
        inward = body.piece_normals(place[None])[0, 0]
        along = (
            inward
            if press.direction == "normal"
            else np.array(press.direction or (0.0, 0.0, 1.0), float)
        )
        axes = Press.frame_of(tuple(along))
        along = axes[2]
        if along @ inward <= 0.05:
            raise InputError(
                f"press.direction = ({', '.join(f'{c:.3g}' for c in along)}) at "
                f"({', '.join(f'{c:.3g}' for c in place)}) mm comes from inside the body, or along "
                f"its surface (its inward normal is ({', '.join(f'{c:.3g}' for c in inward)})): "
                "turn it inwards, or use 'normal'"
            )
        return Approach.of(press.probe, body, place, axes, press.tilt_deg)

    @staticmethod
    def of(
        probe: Probe,
        body: Body,
        at_mm: Floats,
        axes: Floats | None = None,
        tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
        turn: Floats | None = None,
    ) -> Approach:
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
        The smallest height of the surface over the probe is found on grids that shrink around the
        minimum; ties (a flat face on a flat body, or along a barrel) are averaged. Where the
        surface is as high everywhere under an upright probe, its lowest point is the one.
        """
        axes = np.eye(3) if axes is None else axes
        at = np.zeros(3)
        at[: len(at_mm)] = at_mm
        turned = np.eye(3) if turn is None else Approach.rotation_of(turn)
        half = np.array(half_extent(probe, tilt_deg))
        lever_arm = float(math.hypot(*half))
        shape = _shape_of(probe, tilt_deg)
        brought = partial(Approach, probe=probe, axes=axes, tilt_deg=tilt_deg)

        # On a level surface along z the height of touch is known.
        upright = not isinstance(probe, Stl | Object) and not any(tilt_deg) and turned[2, 2] == 1.0
        along_z = axes[2, 2] == 1.0
        x, y = at[:2].tolist()
        if upright and along_z and body.is_level_around(x, y, lever_arm):
            at[2] = 0.0
            return brought(axis_mm=at, touch_mm=at, level=True)
        if isinstance(shape, _Triangles) and along_z and body.is_level_around(x, y, shape.reach_mm):
            at[2] = -float((shape.corners @ turned[2]).max())
            return brought(axis_mm=at, touch_mm=at)

        # Else it is searched for.
        meets = _surface_intersection(body, axes[2])
        if isinstance(probe, Pillar):
            half = np.full(2, lever_arm)
        height, touch, on_sensing = _first_touch(
            lambda offset: meets(at + offset @ axes[:2]),
            lambda offset: shape.met(
                np.column_stack([offset, np.zeros(len(offset))]) @ turned,
                np.broadcast_to(turned[2], (len(offset), 3)),
            )[0],
            half,
            1e-12 if along_z else 1e-10,
            upright=upright,
        )
        name = f"the {probe.kind} at ({', '.join(f'{c:g}' for c in at_mm)}) mm"
        if not math.isfinite(height):
            (x0, y0, _), (x1, y1, _) = body.bounds_mm
            raise InputError(
                f"{name} misses the sensing surface, which lies within x {x0:g} to {x1:g} mm and y "
                f"{y0:g} to {y1:g} mm: move at_mm or the step's motion over the body"
            )
        met = at + touch @ axes[:2]
        point = met + meets(met[None])[0][0] * axes[2]
        if not on_sensing or not np.isfinite(point).all():
            raise InputError(
                f"{name} first touches the body off its sensing surface, near "
                f"({', '.join(f'{c:.3g}' for c in np.nan_to_num(point))}) mm: move at_mm, or "
                "change direction or tilt_deg"
            )
        return brought(axis_mm=at + height * axes[2], touch_mm=point)

    def with_edge(self, edge_mm: float) -> Approach:
        """Return a probe at first touch whose face has a rim of another radius."""
        return replace(self, probe=self.probe.model_copy(update={"edge_mm": edge_mm}))

    @staticmethod
    def rotation_of(turn: Floats) -> Floats:
        """Return the (3, 3) rotation about a vector (3,) by its length, radians (Rodrigues)."""
        if np.max(np.abs(turn)) < _NO_TURN:
            return np.eye(3)
        angle = float(np.linalg.norm(turn))
        cross = _cross(turn / angle)
        return np.asarray(
            np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
        )

    @staticmethod
    def turning_of(turn: Floats) -> Floats:
        """Return the (3, 3) matrix that takes a change of a rotation vector to the turn that it
        makes (left Jacobian)."""
        if np.max(np.abs(turn)) < _NO_TURN:
            return np.eye(3)
        angle = float(np.linalg.norm(turn))
        cross = _cross(turn)
        if angle < 1e-6:
            return np.asarray(np.eye(3) + cross / 2.0)
        first = (1.0 - math.cos(angle)) / angle**2
        second = (angle - math.sin(angle)) / angle**3
        return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def _cross(turn: Floats) -> Floats:
    """Return the (3, 3) matrix of the cross product with a vector from the left."""
    x, y, z = turn
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@dataclass(frozen=True, kw_only=True)
class PlacedProbe:
    """A probe at its pose, as pictures show it; see `twin.parts.load.Load.Placed`."""

    first: Approach
    pose: Floats
    albedo: tuple[float, float, float]

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """Return how far outwards lines enter the probe, and its normals there."""
        first = self.first
        turned = first.axes.T @ Approach.rotation_of(self.pose[ABOUT_X:])
        place = first.axis_mm + self.pose[: Z + 1] @ first.axes
        shape = _shape_of(first.probe, first.tilt_deg)
        distance, normal = shape.met((points - place) @ turned, along @ turned)
        return distance, normal @ turned.T

    def between(self, other: PlacedProbe, share: float) -> PlacedProbe:
        """Return the same probe on its way to the place of another."""
        return replace(self, pose=self.pose + share * (other.pose - self.pose))


@njit(cache=True)
def _slopes(
    own: Floats, along: Floats, gap: Floats, normal: Floats, turned: Floats, turning: Floats
) -> Floats:
    """Return (k, 6) the gap's derivatives where a line meets the probe: a motion dc of the probe at
    the place that is met changes the gap by -(e . dc) / (e . n), e its normal there."""
    slope = np.zeros((len(gap), 6))
    for i in range(len(gap)):
        if not math.isfinite(gap[i]):
            continue
        a = own[i, 0] - gap[i] * along[i, 0]
        b = own[i, 1] - gap[i] * along[i, 1]
        c = own[i, 2] - gap[i] * along[i, 2]
        u = normal[i, 0]
        v = normal[i, 1]
        w = normal[i, 2]
        x = turned[0, 0] * u + turned[0, 1] * v + turned[0, 2] * w
        y = turned[1, 0] * u + turned[1, 1] * v + turned[1, 2] * w
        z = turned[2, 0] * u + turned[2, 1] * v + turned[2, 2] * w
        steep = x * along[i, 0] + y * along[i, 1] + z * along[i, 2]
        about = b * z - c * y, c * x - a * z, a * y - b * x
        slope[i, 0] = -x / steep
        slope[i, 1] = -y / steep
        slope[i, 2] = -z / steep
        for j in range(3):
            slope[i, 3 + j] = (
                -(about[0] * turning[0, j] + about[1] * turning[1, j] + about[2] * turning[2, j])
                / steep
            )
    return slope


_LEVELS = 14
_ACROSS = 25
_STEPS = np.stack(np.meshgrid(*2 * [np.linspace(-1.0, 1.0, _ACROSS)]), axis=-1).reshape(-1, 2)
_ON_SURFACE_MM = 1e-3

_BENT_STEPS, _STEEP = 5, 0.1
"""Steps from a triangle to the curved face behind it, and the least slope against a line."""


def _first_touch(
    meets: Callable[[Floats], tuple[Floats, Bools]],
    rises: Callable[[Floats], Floats],
    half: Floats,
    equal: float,
    *,
    upright: bool,
) -> tuple[float, Floats, bool]:
    """Return where a probe first touches: the height, infinite where it misses, the place (2,)
    across its way, and whether that is on the sensing surface.

    Parameters
    ----------
    meets, rises
        Take places (k, 2) across the way to the height of the surface there and whether it is a
        sensing one, and to how far the probe's own surface lies behind its tip.
    half
        (2,) the half sides of the grid to begin with.
    equal
        Heights that differ by no more are ties.
    """
    height = np.inf
    centre = np.zeros(2)
    touch = np.full(2, np.nan)
    on_sensing = True
    for _ in range(_LEVELS):
        offset = centre + _STEPS * half
        surface, sensing = meets(offset)
        if upright and sensing.all() and np.all(surface == surface[0]):
            return float(surface[0]), np.zeros(2), on_sensing
        here = surface + rises(offset)
        here = np.where(np.isfinite(here), here, np.inf)
        lowest = float(here.min())
        if not math.isfinite(lowest):
            break
        ties = here <= lowest + equal
        if lowest < height:
            height = lowest
            touch = offset[ties].mean(axis=0)
            on_sensing = bool(sensing[ties].any())
        # The next grid is finer, around the lowest place so far.
        centre = touch
        half = half / 3
    return height, touch, on_sensing


def _surface_intersection(
    body: Body, direction: Floats
) -> Callable[[Points], tuple[Floats, Bools]]:
    """Return a function of (k, 3) points that computes how far along a direction (3,) a body is
    first met, mm, NaN where it isn't, and whether on its sensing surface."""
    if direction[2] == 1.0:

        def from_above(points: Points) -> tuple[Floats, Bools]:
            seen = body.surface_from_above(points[:, :2])[:, 2] - points[:, 2]
            return seen, np.isfinite(seen)

        return from_above
    tree = None
    if body.own_surface is not None:
        from twin.geometry.pieces import TriangleTree

        vertices, triangles = body.own_surface
        tree = TriangleTree(vertices[triangles])

    def anywhere(points: Points) -> tuple[Floats, Bools]:
        if tree is None:
            distance = _met_by_pieces(body, points, direction)
        else:
            lines = np.broadcast_to(direction, points.shape)
            triangle, distance = tree.first_along(points, lines)
            distance = np.where(triangle >= 0, distance, np.nan)
        met = np.isfinite(distance)
        foot = points + np.where(met, distance, 0.0)[:, None] * direction
        # from triangles to the curved face that they stand for
        for _ in range(_BENT_STEPS if body.chord_mm else 0):
            depth = body.depth(foot)
            steep = np.maximum(body.piece_normals(foot)[:, 0] @ direction, _STEEP)
            step = np.where(met & (np.abs(depth) < 2.0 * body.chord_mm), -depth / steep, 0.0)
            distance, foot = distance + step, foot + step[:, None] * direction
        return distance, met & (np.abs(body.depth(foot)) < 1e-6) & body.contains(foot, -1e-6)

    return anywhere


def _met_by_pieces(body: Body, points: Points, direction: Floats) -> Floats:
    """Find where lines enter a convex body: behind the last of its pieces, by Newton's steps from
    outside."""
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


def _point_on_surface(body: Body, at_mm: tuple[float, ...]) -> Floats:
    """Return (3,) the place on the sensing surface that a press names; `InputError` where it is not
    on that."""
    (x0, y0, z0), (x1, y1, z1) = body.bounds_mm
    if len(at_mm) == 2:
        found = body.surface_from_above(np.array([at_mm], float))[0]
        if np.isnan(found[2]):
            raise InputError(
                f"press.at_mm = ({at_mm[0]:g}, {at_mm[1]:g}) mm misses the sensing surface, which "
                f"lies within x {x0:g} to {x1:g} mm and y {y0:g} to {y1:g} mm: move at_mm over the "
                "body"
            )
        return np.asarray(found)
    place = np.array([at_mm], float)
    off = float(body.depth(place)[0])
    if abs(off) > _ON_SURFACE_MM or not body.contains(place, -_ON_SURFACE_MM)[0]:
        where = (
            "inside the body"
            if body.contains(place, _ON_SURFACE_MM)[0]
            else "off the sensing surface"
        )
        raise InputError(
            f"press.at_mm = ({', '.join(f'{c:g}' for c in at_mm)}) mm lies {where} (depth "
            f"{off:.4g} mm, allowed up to {_ON_SURFACE_MM:g} mm; the body lies within x {x0:g} to "
            f"{x1:g}, y {y0:g} to {y1:g}, z {z0:g} to {z1:g} mm): give a place on the surface, or "
            "(x, y) alone"
        )
    return np.asarray(place[0])
