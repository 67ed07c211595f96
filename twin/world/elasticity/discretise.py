"""Loads as plane rectangles, which the elastic solution takes; and many of these as few.

On a flat face a rectangle stays one rectangle, exactly; disks and twists become strips whose ends
follow the circle, bumps a fine grid. On a curved body every footprint is cut along the normal at
its centre into a grid of tiles, each in its own tangent plane on the true surface. Totals of force
and torque are exact; the grain of the tiles dies out within a tile's width below the surface, like
exp(-2 pi depth / width). A bump of 44 mm radius in tiles of .88 mm, the widest, moves points .3 mm
deep 2e-5 of the largest off.

`gathered` replaces hundreds of patches on a flat face by few point forces for points deep under
them: the field of a point force is interpolated in the force's place at Chebyshev nodes (W. Fong
and E. Darve, J. Comput. Phys. 228 (2009) 8712). From a depth z, m nodes over a half length a are
off by about rho^-m, rho = z/a + sqrt(1 + (z/a)^2) (Bernstein's ellipse).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from twin.arrays import Bools, Floats, Ints, Points, coordinates, frozen, grid_points
from twin.errors import InputError
from twin.parts.body import Block, Body
from twin.parts.load import Load, Rectangles, Traction

STRIPS = 128
"""Strips across a flat disk."""

ACROSS, WIDEST_MM = {"rectangle": 24, "disk": 40, "twist": 40, "bump": 20}, 0.2
"""Tiles across a footprint, and their largest side, unless a spacing is given."""

MOST = 10_000
"""Tiles in a grid at most, unless a spacing is given: 100 across a footprint wider than 20 mm."""

SAMPLES = 5
"""Samples per side of a tile that weigh its share of the footprint."""

ON_SURFACE_MM = 1e-3
"""How far off the sensing surface a 3-D centre may be; it is then moved onto it."""

STEEPEST = 0.7
"""How steeply a body may rise over a load's plane, height over distance (45 degrees): the
half-space's field goes on there, but is singular straight over the load where nu < 1/2."""


EDGE_MM, OVERHANG = 1e-4, 0.25
"""How near to another face a rectangle's centre may be, and which share of its half side may hang
over that face: what is nearer or hangs over pushes partly on nothing, and the half-space's
tractions would not add up to the load."""


def tile(load: Load, body: Body, spacing_mm: float | None = None) -> Rectangles:
    """Return the load as rectangles on the outer surface of a body; rectangles in it stay.

    ``spacing_mm`` is the largest side of the tiles on curved surfaces and under bumps; it follows
    from the footprint's width if not given.

    Raises
    ------
    InputError
        A footprint lies partly off the sensing surface, or its centre is not on it.
    """
    parts = [
        term if isinstance(term, Rectangles) else _tile_one(term, body, spacing_mm)
        for term in load.terms
    ]
    return Rectangles.joined(parts)


def _footprint_centre(traction: Traction, body: Body) -> Points:
    """Return the (3,) surface point at the centre of a footprint; `InputError` where no sensing
    surface is there."""
    centre = np.array(traction.centre_mm, float)
    if len(centre) == 2:
        centre = body.surface_from_above(centre[None])[0]
    if not np.isfinite(centre).all():
        low, high = body.bounds_mm
        raise InputError(
            f"{traction.kind} traction: there is no sensing surface above centre_mm = "
            f"{traction.centre_mm}; the body "
            f"spans x {low[0]:g} to {high[0]:g} and y {low[1]:g} to {high[1]:g} mm"
        )
    distances = body.piece_distances(centre[None])[0]
    if abs(distances[0]) > ON_SURFACE_MM or distances[1:].min() < 0.0:
        raise InputError(
            f"{traction.kind} traction: centre_mm = {traction.centre_mm} is "
            f"{abs(distances[0]):.3g} mm off the sensing surface (allowed {ON_SURFACE_MM:g} mm): "
            "give (x, y), or a point on the surface"
        )
    return np.asarray(
        centre - distances[0] * body.piece_normals(centre[None])[0, 0] if distances[0] else centre
    )


def require_on_surface(body: Body, load: Rectangles, *, half_space: bool = True) -> None:
    """Raise an `InputError` unless every rectangle is made of finite numbers and lies on the
    sensing surface.

    Where the sensing surface is curved, corners in the tangent plane may hang over its end a little
    (`OVERHANG`). With ``half_space`` the body must lie behind the plane of every rectangle too.
    """
    for what, values, unit in (
        ("force", load.force_n, "N"),
        ("centre", load.centre_mm, "mm"),
        ("half side", load.half_mm, "mm"),
        ("frame", load.frames.reshape(-1, 9), ""),
    ):
        finite = np.isfinite(values)
        if not finite.all():
            first = int(np.argmin(finite.all(axis=1)))
            raise InputError(
                f"rectangle {first}: its {what} {values[first]} {unit} is not finite: check the "
                "load"
            )
    distances = body.piece_distances(load.within(body))
    inside = distances[:, 1:].min(axis=1)
    off = (np.abs(distances[:, 0]) > ON_SURFACE_MM) | (inside < -ON_SURFACE_MM)
    if off.any():
        raise InputError(
            f"{_named(load, int(np.argmax(off)))} is not on the sensing surface (allowed "
            f"{ON_SURFACE_MM:g} mm off): the load would miss the body"
        )
    if (inside < EDGE_MM).any():
        first = int(np.argmin(inside))
        face = body.pieces[1 + int(np.argmin(distances[first, 1:]))]
        raise InputError(
            f"{_named(load, first)} is {inside[first]:.2g} mm from the body's {face} face "
            f"(allowed: {EDGE_MM:g} mm and "
            "more): on an edge a part of the load would miss the body; move it inwards"
        )
    fits = (inside >= np.hypot(*load.half_mm.T)).all()
    out = np.zeros(len(load)) if fits else _overhang(body, load)
    if np.any(out > OVERHANG):
        first = int(np.argmax(out))
        raise InputError(
            f"{_named(load, first)} hangs over the end of the sensing surface by {out[first]:.2g} "
            f"of its half side (allowed: {OVERHANG:g}): move it inwards or make it smaller"
        )
    if half_space:
        _require_half_space(body, load)


def _require_half_space(body: Body, load: Rectangles) -> None:
    """Raise an `InputError` where the body rises too steeply over the plane of a rectangle."""
    if body.is_convex or len(load) == 0:
        return
    out = body.stands_out(load.centre_mm, load.frames[:, 2])
    worst = int(np.argmax(out))
    if out[worst] > STEEPEST:
        place = coordinates(load.centre_mm[worst])
        raise InputError(
            f"the body rises over the surface's tangent plane at ({place}) mm by {out[worst]:.3g} "
            f"of the distance (allowed: {STEEPEST:g}), too steeply for the half-space's field: "
            "press where nothing stands out (press.at_mm); in Python, Compliance(..., "
            "method='direct') does without that field on a mesh that is fine under the load"
        )


_SIGNS = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])


def _overhang(body: Body, load: Rectangles) -> Floats:
    """Return (k,) how far each rectangle's corners are outside the other faces, over its half side
    there."""
    corners = load.centre_mm[:, None] + _SIGNS @ (load.half_mm[:, :, None] * load.frames[:, :2])
    out = (
        -body.piece_distances(corners.reshape(-1, 3))[:, 1:]
        .min(axis=1)
        .reshape(len(load), -1)
        .min(axis=1)
    )
    return np.asarray(out / np.maximum(load.half_mm.max(axis=1), ON_SURFACE_MM))


def _named(load: Rectangles, index: int) -> str:
    place = coordinates(load.centre_mm[index])
    return f"rectangle {index} at ({place}) mm"


def _tile_one(traction: Traction, body: Body, spacing_mm: float | None) -> Rectangles:
    centre = _footprint_centre(traction, body)
    frame = body.frames(centre[None])[0]
    half = np.array(traction.size_mm) / 2.0
    flat = body.is_flat
    if not flat or body.piece_distances(centre[None])[0, 1:].min() < math.hypot(*half):
        rim = (_SQUARE if traction.kind == "rectangle" else _CIRCLE) * half
        on_rim = onto_surface(rim, centre, frame, body, traction)
        flat = flat or float(np.max(np.abs(body.piece_normals(on_rim)[:, 0] - frame[2]))) < 1e-12
    if flat and traction.kind == "rectangle":
        return _plane(centre, frame, np.zeros((1, 2)), half[None], np.array([traction.force_n]))
    if flat and traction.kind == "disk":
        offset, sides = _strips(half[0])
        share = sides[:, 0] * sides[:, 1]
        return _plane(centre, frame, offset, sides, np.outer(share / share.sum(), traction.force_n))
    if flat and traction.kind == "twist":
        return _flat_twist(traction, centre, frame, half[0])
    if body.is_flat:
        number = int(_number(traction, half, spacing_mm)[0])
        unit = _unit_bump(number)
        sides = unit.half_mm * half[0]
        return _plane(
            centre,
            frame,
            unit.centre_mm[:, :2] * half[0],
            sides,
            unit.force_n[:, 2:] * traction.force_n,
        )
    return _grid(traction, centre, frame, half, body, spacing_mm)


def _square() -> Floats:
    s = np.linspace(-1.0, 1.0, 9)
    sides = [np.column_stack([s, np.full(9, o)]) for o in (-1.0, 1.0)]
    return np.concatenate([*sides, *(side[:, ::-1] for side in sides)])


_ANGLE = 2.0 * math.pi * np.arange(32) / 32
_SQUARE, _CIRCLE = _square(), np.column_stack([np.cos(_ANGLE), np.sin(_ANGLE)])
"""(r, 2) points on the edge of a footprint of half size 1."""


def onto_surface(
    offsets: Floats, centre: Points, frame: Floats, body: Body, traction: Traction
) -> Points:
    """Return the (n, 3) surface points met along the centre's normal, ``offsets`` (n, 2) from the
    centre."""
    points = centre + offsets @ frame[:2]
    for _ in range(0 if body.is_flat else 50):
        distance = body.piece_distances(points)[:, 0]
        slope = body.piece_normals(points)[:, 0] @ frame[2]
        step = -distance / np.where(slope > 0.05, slope, np.nan)
        points = points + step[:, None] * frame[2]
        if not np.max(np.abs(step)) > 1e-12:
            break
    inside: Bools = np.asarray(
        body.piece_distances(points).min(axis=1) >= -1e-9
    )  # not where there is no surface: NaN
    if not inside.all():
        place = coordinates(centre)
        raise InputError(
            f"{traction.kind} traction of {traction.size_mm[0]:g} x {traction.size_mm[1]:g} mm at "
            f"({place}) mm lies partly off the sensing surface: move it inwards or make it smaller"
        )
    return np.asarray(points)


def _plane(
    centre: Points, frame: Floats, offsets: Floats, half: Floats, force: Floats
) -> Rectangles:
    frames = np.empty((len(offsets), 3, 3))
    frames[:] = frame
    return Rectangles(
        centre_mm=centre + offsets @ frame[:2],
        frames=frames,
        half_mm=np.array(half),
        force_n=np.array(force, float),
    )


def _strips(radius: float) -> tuple[Floats, Floats]:
    """Return offsets (n, 2) and half sides (n, 2) of strips along the first axis that fill a disk,
    area exact."""
    angle = np.linspace(-math.pi / 2, math.pi / 2, STRIPS + 1)
    edge = radius * np.sin(angle)
    width = np.diff(edge)
    area = radius**2 * np.diff(angle + np.sin(2 * angle) / 2) / 2 * 2
    offsets = np.column_stack([np.zeros(STRIPS), (edge[1:] + edge[:-1]) / 2])
    return offsets, np.column_stack([area / width / 2, width / 2])


def _flat_twist(traction: Traction, centre: Points, frame: Floats, radius: float) -> Rectangles:
    """Return strips along the first axis for the traction's first component -t, and across for the
    second, s."""
    offsets, half = _strips(radius)
    arm = offsets[:, 1]
    area = half[:, 0] * half[:, 1]
    force = 0.5 * traction.torque_nmm * area * arm / np.sum(area * arm**2)
    along = _plane(centre, frame, offsets, half, np.outer(-force, frame[0]))
    across = _plane(centre, frame, offsets[:, ::-1], half[:, ::-1], np.outer(force, frame[1]))
    return Rectangles.joined([along, across])


def _number(traction: Traction, half: Floats, spacing_mm: float | None) -> Ints:
    """Return (2,) numbers of tiles along and across a footprint."""
    fine = min(2.0 * float(np.max(half)) / ACROSS[traction.kind], WIDEST_MM)
    spacing = spacing_mm or max(fine, 2.0 * math.sqrt(half[0] * half[1] / MOST) * (1.0 + 1e-9))
    return np.asarray(np.maximum(np.ceil(2.0 * half / spacing).astype(int), 4))


@lru_cache(maxsize=64)
def _unit_bump(number: int) -> Rectangles:
    """Return the tiles of a bump of radius 1 mm and force 1 N along z: on a plane all others are
    this one, scaled."""
    bump = Traction(kind="bump", centre_mm=(0.0, 0.0), size_mm=(2.0, 2.0), force_n=(0.0, 0.0, 1.0))
    plane = Block(width_mm=5.0, length_mm=5.0, thickness_mm=5.0)
    return _grid(bump, np.zeros(3), np.eye(3), np.ones(2), plane, 2.0 / number * (1.0 + 1e-9))


def _grid(
    traction: Traction,
    centre: Points,
    frame: Floats,
    half: Floats,
    body: Body,
    spacing_mm: float | None,
) -> Rectangles:
    """Return tiles in their own tangent planes; weights are integrals over the true area."""
    number = _number(traction, half, spacing_mm)
    side = 2.0 * half / number
    s, t = ((np.arange(n) + 0.5) * d - h for n, d, h in zip(number, side, half, strict=True))
    offsets = grid_points(s, t)
    inner = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    within = grid_points(inner, inner) * side
    cells = np.arange(len(offsets))
    if traction.kind != "rectangle":
        cells = np.flatnonzero(np.hypot(*offsets.T) < half[0] + np.hypot(*side) / 2)
        offsets = offsets[cells]
    samples = (offsets[:, None] + within).reshape(-1, 2)
    used: Bools = np.asarray(
        _density(traction, np.column_stack([samples, np.zeros(len(samples))]), half) > 0.0
    )
    points = np.full((len(samples), 3), np.nan)
    points[used] = onto_surface(samples[used], centre, frame, body, traction)
    from_centre = (points[used] - centre) @ frame.T
    density, weighted = np.zeros((len(samples), 1)), np.zeros((len(samples), 3))
    density[used, 0] = _density(traction, from_centre, half) / (
        body.piece_normals(points[used])[:, 0] @ frame[2]
    )
    weighted[used] = density[used] * _direction(traction, from_centre, frame)
    loaded: Bools = np.asarray(density.reshape(len(offsets), -1).max(axis=1) > 0.0)
    force = weighted.reshape(len(offsets), -1, 3).mean(axis=1)
    if traction.kind == "bump":
        force = _sharpened(force, cells, number)
    cover = used.reshape(len(offsets), -1).mean(axis=1)[loaded]
    middles = onto_surface(
        _pulled_in(offsets[loaded], samples, used, loaded), centre, frame, body, traction
    )
    force = _exact(traction, force[loaded], (middles - centre) @ frame.T, frame)
    return _tangent_tiles(middles, frame, np.sqrt(cover)[:, None] * side, force, body)


def _sharpened(force: Floats, cells: Ints, number: Ints) -> Floats:
    """Return the forces (n, 3) of grid ``cells`` less a twelfth of their Laplacian: a tile averages
    a smooth traction and spreads it evenly, which widens it by side^2 / 12 each; the error left is
    of fourth order in the side."""
    grid = np.zeros((number[0] + 2, number[1] + 2, 3))
    place = np.unravel_index(cells, tuple(number))
    inside = (place[0] + 1, place[1] + 1)
    grid[inside] = force
    laplacian = np.zeros_like(grid)
    laplacian[1:-1, 1:-1] = (
        grid[2:, 1:-1] + grid[:-2, 1:-1] + grid[1:-1, 2:] + grid[1:-1, :-2] - 4 * grid[1:-1, 1:-1]
    )
    return np.asarray((grid - laplacian / 12.0)[inside])


def _pulled_in(offsets: Floats, samples: Floats, used: Bools, loaded: Bools) -> Floats:
    """Return the loaded tiles' centres (n, 2), in the middle of the loaded part where the
    footprint's edge cuts one."""
    weight = used.reshape(len(loaded), -1)[loaded].astype(float)
    places = samples.reshape(len(loaded), -1, 2)[loaded]
    middle = np.einsum("ns,nsi->ni", weight, places) / weight.sum(axis=1, keepdims=True)
    return np.where(weight.min(axis=1, keepdims=True) > 0.0, offsets, middle)


def _density(traction: Traction, local: Floats, half: Floats) -> Floats:
    """Return (n,) the traction's size over true area, up to a factor, at (n, 3) places in the
    centre's frame."""
    across = np.hypot(local[:, 0], local[:, 1])
    if traction.kind == "rectangle":
        return np.ones(len(local))
    if traction.kind == "bump":
        squared = np.sum(local**2, axis=1) / half[0] ** 2
        return np.asarray(np.maximum(0.0, 1.0 - squared) ** 2)
    inside = (across < half[0]).astype(float)
    return np.asarray(inside * across if traction.kind == "twist" else inside)


def _direction(traction: Traction, local: Floats, frame: Floats) -> Floats:
    """Return (n, 3) global directions; a twist turns about the normal at the footprint's centre."""
    if traction.kind != "twist":
        return np.tile(traction.force_n, (len(local), 1))
    turned = np.column_stack([-local[:, 1], local[:, 0], np.zeros(len(local))])
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return np.asarray(turned / np.where(length > 0.0, length, 1.0) @ frame)


def _exact(traction: Traction, force: Floats, local: Floats, frame: Floats) -> Floats:
    """Return the tiles' forces with exact totals: force, or for a twist torque without force."""
    if traction.kind != "twist":
        total = float(np.sum(force @ np.array(traction.force_n)))
        squared = float(np.dot(traction.force_n, traction.force_n))
        return force * (squared / total) if squared > 0.0 else force
    force = force - force.mean(axis=0)
    along = force @ frame.T
    torque = float(np.sum(local[:, 0] * along[:, 1] - local[:, 1] * along[:, 0]))
    return np.asarray(force * (traction.torque_nmm / torque))


def _tangent_tiles(
    middles: Points, frame: Floats, side: Floats, force: Floats, body: Body
) -> Rectangles:
    """Return rectangles in the tangent planes at ``middles`` that cover a grid cell each when seen
    along the normal."""
    normal = body.piece_normals(middles)[:, 0]
    cosine = normal @ frame[2]
    first = frame[0] - (normal @ frame[0] / cosine)[:, None] * frame[2]
    stretch = np.linalg.norm(first, axis=1)
    first = first / stretch[:, None]
    frames = np.stack([first, np.cross(normal, first), normal], axis=1)
    half = np.column_stack([side[:, 0] * stretch, side[:, 1] / (cosine * stretch)]) / 2.0
    return Rectangles(centre_mm=middles, frames=frames, half_mm=half, force_n=force)


_GOAL = 1e-3
"""What the bound on the error over the largest displacement is held to; true errors are below a
hundredth of it."""

_SMALL = 8.0
"""A patch whose half side is so many times smaller than the depth takes two Gauss points along
it."""


def gathered(points: Points, load: Rectangles) -> Rectangles:
    """Return a load of fewer point forces with the same field at ``points`` (n, 3), or the load
    itself where it is on a curved surface or too near to the points for gathering to pay."""
    if len(load) < 16 or len(points) == 0 or not np.all(load.frames[:, 2, 2] > 1.0 - 1e-12):
        return load
    if np.ptp(load.centre_mm[:, 2]) > 1e-9:
        return load
    reach = np.einsum("ks,ksi->ki", load.half_mm, np.abs(load.frames[:, :2, :2]))
    low, high = (
        (load.centre_mm[:, :2] - reach).min(axis=0),
        (load.centre_mm[:, :2] + reach).max(axis=0),
    )
    deep = float(points[:, 2].min() - load.centre_mm[0, 2])
    counts = [_nodes(deep, (b - a) / 2.0) for a, b in zip(low, high, strict=True)]
    if 2 * math.prod(counts) > 5 * len(load):
        return load
    # Enough Gauss points to share out a long patch exactly: the nodes' polynomials are of degree
    # sum(counts) - 2.
    orders = [
        2 if deep >= _SMALL * side else max(2, math.ceil(sum(counts) / 2))
        for side in load.half_mm.max(axis=0)
    ]
    places, weights = zip(*(_gauss(order) for order in orders), strict=True)
    centre, half, forces = load.centre_mm[:, :2], load.half_mm, load.force_n
    if load.frames[
        :, 0, 1
    ].any():  # turned patches are shared out as the Gauss points that they are made of
        square = grid_points(*places)
        weight = np.multiply.outer(*weights).ravel() / 4.0
        along = square @ (load.half_mm[:, :, None] * load.frames[:, :2, :2])
        centre = (centre[:, None] + along).reshape(-1, 2)
        forces = (forces[:, None] * weight[:, None]).reshape(-1, 3)
        half = np.zeros_like(centre)
        (places, weights) = zip(_gauss(1), _gauss(1), strict=True)
    middle, reach = (low + high) / 2.0, (high - low) / 2.0
    means = []  # of the Chebyshev polynomials over the patches' sides
    for i in (0, 1):
        at = (centre[:, i] - middle[i]) / reach[i]
        values = chebvander(
            at[:, None] + (half[:, i] / reach[i])[:, None] * places[i], counts[i] - 1
        )
        means.append(np.einsum("kgn,g->kn", values, weights[i] / 2.0))
    # what each node carries of every patch, times the patches' forces
    first, second = (mean @ _lagrange(count) for mean, count in zip(means, counts, strict=True))
    shared = first.T @ (second[:, :, None] * forces[:, None]).reshape(len(forces), -1)
    total = math.prod(counts)
    nodes = np.empty((*counts, 3))
    nodes[:, :, 0] = (middle[0] + reach[0] * chebpts1(counts[0]))[:, None]
    nodes[:, :, 1] = middle[1] + reach[1] * chebpts1(counts[1])
    nodes[:, :, 2] = load.centre_mm[0, 2]
    frames = np.empty((total, 3, 3))
    frames[:] = load.frames[0]
    return Rectangles(
        centre_mm=nodes.reshape(-1, 3),
        frames=frames,
        half_mm=np.zeros((total, 2)),
        force_n=shared.reshape(-1, 3),
    )


def _nodes(deep: float, half: float) -> int:
    ratio = deep / max(half, 1e-9)
    return (
        2 + math.ceil(-math.log(_GOAL) / math.log(ratio + math.hypot(1.0, ratio)))
        if deep > 0
        else 10**6
    )


@lru_cache(maxsize=64)
def _lagrange(count: int) -> Floats:
    """Return (count, count) Chebyshev coefficients of the polynomials that are 1 at one node and 0
    at the others."""
    at_nodes = chebvander(chebpts1(count), count - 1).T * (2.0 / count)
    at_nodes[0] /= 2.0
    return frozen(np.asarray(at_nodes, float))


@lru_cache(maxsize=64)
def _gauss(order: int) -> tuple[Floats, Floats]:
    places, weights = np.polynomial.legendre.leggauss(order)
    return frozen(places), frozen(weights)
