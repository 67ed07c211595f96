"""Where lines through the body's surface meet a probe: the shapes of `twin.parts.probe` as surfaces.

A shape stands as its probe does before it moves: the lowest point at the origin, z into the body. Rounded shapes are in
`twin.world.contact.rounded`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.compiled import njit
from twin.parts.probe import Cone, Cylinder, Pillar, Probe, Sphere, Stl
from twin.world.contact.rounded import CONE, GRAZING, ROUND, SQUARE, Rounded

RIM = 1.005
"""A patch whose middle lies this share of the half width from the middle still belongs to a flat face."""


class Shape(Protocol):
    """A probe's surface."""

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """Return how far outwards, against ``along``, lines enter the probe, and its outward normal there.

        Parameters
        ----------
        points, along
            (k, 3) points, mm, and unit vectors, in the probe's own axes; a line comes from far along ``along``.

        Returns
        -------
        distance
            (k,) mm, negative where the point lies beyond the probe's surface; inf where the line misses it.
        normal
            (k, 3) outward unit normals of the probe; ``along`` where the line misses.
        """
        ...


@dataclass(frozen=True)
class Ball:
    """A sphere."""

    radius_mm: float

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `Shape`."""
        distance, normal = _meet_ball(points, along, self.radius_mm)
        return distance, normal


@njit(cache=True)
def _meet_ball(points: Floats, along: Floats, radius: float) -> tuple[Floats, Floats]:
    """See `Shape.met`."""
    distance, normal = np.full(len(points), np.inf), along.copy()
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2] + radius
        ahead = x * along[i, 0] + y * along[i, 1] + z * along[i, 2]
        inside = ahead * ahead - (x * x + y * y + z * z) + radius * radius
        if inside > (GRAZING * radius) ** 2:
            way = ahead - math.sqrt(inside)
            distance[i] = way
            normal[i, 0], normal[i, 1] = (x - way * along[i, 0]) / radius, (y - way * along[i, 1]) / radius
            normal[i, 2] = (z - way * along[i, 2]) / radius
    return distance, normal


@dataclass(frozen=True)
class Face:
    """A flat face with a sharp rim, which touches with its face."""

    probe: Cylinder | Pillar

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `Shape`; the sides above the rim are left out."""
        upright = np.maximum(along[:, 2], 1e-9)
        distance = points[:, 2] / upright
        over = points - distance[:, None] * along
        met = (along[:, 2] > GRAZING) & within_footprint(self.probe, over[:, :2])
        down = np.broadcast_to([0.0, 0.0, 1.0], along.shape)
        return np.where(met, distance, np.inf), np.where(met[:, None], down, along)


def within_footprint(probe: Cylinder | Pillar, offset_mm: Floats) -> Bools:
    """Return (k,) whether offsets (k, 2) from the axis lie under the flat face, its border included (see `RIM`)."""
    if isinstance(probe, Cylinder):
        return np.asarray(np.hypot(offset_mm[:, 0], offset_mm[:, 1]) <= probe.diameter_mm / 2 * RIM)
    return np.asarray(np.all(np.abs(offset_mm) <= np.array(probe.size_mm) / 2 * RIM, axis=1))


@dataclass(frozen=True, eq=False)
class Triangles:
    """The closed surface of an STL file, (m, 3, 3) corners wound outwards."""

    corners: Floats

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `Shape`."""
        from twin.geometry.nearest import first_along

        triangle, distance = first_along(_tree_of(self), points, -along)
        a, b, c = (self.corners[np.maximum(triangle, 0), k] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        met = (triangle >= 0) & (np.einsum("ki,ki->k", normal, along) > GRAZING)
        return np.where(met, distance, np.inf), np.where(met[:, None], normal, along)


@lru_cache(maxsize=8)
def _tree_of(shape: Triangles):  # type: ignore[no-untyped-def]
    from twin.geometry.nearest import box_tree

    return box_tree(shape.corners)


@dataclass(frozen=True, eq=False)
class Tilted:
    """A shape turned about its origin; ``rotation`` (3, 3) takes its own axes to the outer ones."""

    shape: Shape
    rotation: Floats

    def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
        """See `Shape`."""
        distance, normal = self.shape.met(points @ self.rotation, along @ self.rotation)
        return distance, normal @ self.rotation.T


FLAT_TILT_DEG = 20.0
"""A flat face that is tilted less touches with its face, one that is tilted more with its rim."""

_NO_TURN = 1e-100
"""A turn so small, radians, turns nothing, and its square is 0."""


def rotation_of(turn: Floats) -> Floats:
    """Return the (3, 3) rotation about a vector (3,) by its length, radians (Rodrigues)."""
    if np.max(np.abs(turn)) < _NO_TURN:
        return np.eye(3)
    angle = float(np.linalg.norm(turn))
    x, y, z = turn / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


def turning_of(turn: Floats) -> Floats:
    """Return the (3, 3) matrix that takes a change of a rotation vector to the turn that it makes (left Jacobian)."""
    if np.max(np.abs(turn)) < _NO_TURN:
        return np.eye(3)
    angle = float(np.linalg.norm(turn))
    cross = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    if angle < 1e-6:
        return np.asarray(np.eye(3) + cross / 2.0)
    first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def tilt_of(tilt_deg: tuple[float, float, float]) -> Floats:
    """Return the rotation by angles about x, then y, then z."""
    whole = np.eye(3)
    for axis, angle in enumerate(tilt_deg if any(tilt_deg) else ()):
        whole = rotation_of(math.radians(angle) * np.eye(3)[axis]) @ whole
    return whole


def is_flat(probe: Probe, tilt_deg: tuple[float, float, float]) -> bool:
    """Return whether a probe touches with a flat face."""
    if not isinstance(probe, Cylinder | Pillar):
        return False
    return not any(tilt_deg) or bool(tilt_of(tilt_deg)[2, 2] >= math.cos(math.radians(FLAT_TILT_DEG)))


def shape_of(probe: Probe, tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Shape:
    """Return the surface of a probe, tilted before it comes."""
    if isinstance(probe, Sphere):
        return Ball(probe.diameter_mm / 2)  # looks the same however it is turned
    if isinstance(probe, Stl):
        return _triangles(probe.file, probe.sha256, tuple(map(tuple, tilt_of(tilt_deg))))
    shape: Shape
    if isinstance(probe, Cone):
        # the ball that rounds the tip touches the plane z = 0 with its lowest point
        half = math.radians(probe.apex_deg / 2)
        shape = Rounded(CONE, (math.sin(half), math.cos(half), -probe.tip_mm), probe.tip_mm)
    elif probe.edge_mm == 0.0 and is_flat(probe, tilt_deg):
        shape = Face(probe)
    else:
        a, b = half_extent(probe)
        kind, edge = ROUND if isinstance(probe, Cylinder) else SQUARE, probe.edge_mm
        shape = Rounded(kind, (a - edge, b - edge, -edge), edge)
    return Tilted(shape, tilt_of(tilt_deg)) if any(tilt_deg) else shape


@lru_cache(maxsize=8)
def _triangles(file: str, _sha256: str, tilt: tuple[tuple[float, ...], ...]) -> Triangles:
    """Return an STL file's surface, turned about its origin, its lowest point (largest z) moved to z = 0."""
    from twin.geometry.closed import PROBE_SIZE_MM, read_surface

    surface = read_surface(file, PROBE_SIZE_MM)
    vertices = surface.vertices @ np.array(tilt).T
    vertices[:, 2] -= vertices[:, 2].max()
    return Triangles(vertices[surface.triangles])


def half_extent(probe: Probe, tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[float, float]:
    """Return the probe's half sizes along its own first and second axis, mm: of a tilted one, of a box around it."""
    if isinstance(probe, Pillar):
        a, b = probe.size_mm[0] / 2, probe.size_mm[1] / 2
        return (a, b) if not any(tilt_deg) else (math.hypot(a, b), math.hypot(a, b))
    if isinstance(probe, Sphere | Cylinder | Cone):
        return probe.diameter_mm / 2, probe.diameter_mm / 2
    shape = shape_of(probe, tilt_deg)
    assert isinstance(shape, Triangles)
    reach = np.abs(shape.corners[..., :2]).max(axis=(0, 1))
    return float(reach[0]), float(reach[1])
