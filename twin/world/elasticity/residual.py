"""What the half-space field of a load leaves undone on the real body: tractions on its free faces, motion of its base.

The closed-form field of every rectangle is exact in the half-space of the rectangle's own plane. The body's other
faces cut through that half-space, so the smooth rest w must carry the tractions -sigma n there and undo the
displacement on the held face. Within a rectangle's own footprint traction and stress cancel, and nothing is added.

Why the tractions are read on the body's true surface: quadratic faces lie up to 6 um beside it on the finger. Seen from
so deep, a load narrower than that is a point force whose whole flux comes through the face, as a traction that cancels
the load. On the true surface the traction of a force F at distance r is about F / (R r) (R the radius of curvature),
which any quadrature bears, whatever the size of the load.

Validity: on a curved body a narrow twist is two nearly cancelling forces that grow like 1 / radius, and so do the
quadrature's errors: twists of 0.3 mm radius and less are 1 to 4 % off there.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.compiled import njit
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.theory.halfspace_kernels import GAUSS_2, rectangle_slopes
from twin.world.elasticity.distant import distant, distant_rows
from twin.world.elasticity.interfaces import Skin, add_exactly, skin
from twin.world.mesh.elements import triangle_quadrature, triangle_shapes
from twin.world.mesh.mesh import Mesh

NEAR = 2.2
"""Half diagonals within which a stress is in closed form; four point forces replace it further away, then one."""

GROWTH = 1.2
"""Largest size of a piece of face over its distance to the load."""

FINEST = 0.12
"""Size of the pieces under the load, over the load's radius."""

FINEST_INSIDE = 0.25
"""The same on interfaces, which lie a layer deeper."""

LEVELS = 40
"""Halvings of a face at most, down to 1e-11 mm: narrow loads at an edge need them, others stop by their own size."""

DISTANT, CELLS, MERGEABLE = 2.5, 6.0, 64
"""Load radii beyond which point forces stand for a load; if it has at least so many rectangles they are merged into
cells, so many across."""


def nodal_forces(
    mesh: Mesh,
    body: Body,
    load: Rectangles,
    columns: Floats,
    poisson_ratio: float,
    shares: Floats | None = None,
) -> Floats:
    """Return the (N, 3, m) nodal forces in N of the tractions that w must carry on free faces and interfaces.

    Parameters
    ----------
    mesh
        The body's mesh; faces of ``body.held_pieces`` are held, all others are free.
    body
        The body: its true surface is where tractions are read.
    load
        (k) rectangles; their own ``force_n`` is ignored.
    columns
        (k, 3, m) force of every rectangle in m load cases, N, global axes.
    poisson_ratio
        nu of the half-space, which is that of the material under the load.
    shares
        (regions,) shear modulus of every region of the mesh over that of the material under the load; 1 if not given.
    """
    surface = skin(mesh, body, np.ones(1) if shares is None else shares)
    surface = surface[~_in_plane(mesh.points[surface.faces], load) & (surface.weight != 0.0)]
    out = np.zeros((len(mesh.points), 3, columns.shape[2]))
    if len(surface.faces) == 0 or len(load) == 0:
        return out
    balls = _balls(load)
    columns = np.ascontiguousarray(columns)
    coarse, sums = _from_afar(load, columns)
    for inside in (False, True):
        chosen = surface[surface.inside == inside]
        if len(chosen.faces) == 0:
            continue
        points, areas, values, nodes = _quadrature(mesh.points, chosen, *balls, FINEST_INSIDE if inside else FINEST)
        away = np.min(np.linalg.norm(points[:, None] - balls[0], axis=2) / np.maximum(balls[1], 1e-300), axis=1)
        far = away > DISTANT
        for part, forces, loads in ((~far, columns, load), (far, sums, coarse)):
            add = add_exactly if inside else _add
            add(
                points[part], areas[part], values[part], nodes[part], loads.centre_mm, loads.frames, loads.half_mm,
                forces, poisson_ratio, out,
            )  # fmt: skip
    return out


def _quadrature(
    points: Points, surface: Skin, centres: Points, radii: Floats, finest: float
) -> tuple[Points, Floats, Floats, Ints]:
    """Return true surface places (q, 3), weighted area vectors (q, 3), shape functions (q, 6), face nodes (q, 6)."""
    faces = surface.faces
    face, triangles = _split(points, surface, centres, radii, finest)
    places, weights = triangle_quadrature()
    where = triangles[:, :1] + places[:, :1] * (triangles[:, 1:2] - triangles[:, :1])
    where = (where + places[:, 1:] * (triangles[:, 2:] - triangles[:, :1])).reshape(-1, 2)
    face = np.repeat(face, len(places))
    values, slopes = triangle_shapes(where)
    nodes = points[faces[face]]
    tangents = np.einsum("qam,qai->qmi", slopes, nodes)
    sides = triangles[:, 1:] - triangles[:, :1]
    share = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    share = share * surface.weight[face[:: len(places)]]
    areas = np.cross(tangents[:, 0], tangents[:, 1]) * (share[:, None] * weights).ravel()[:, None]
    places, normal = surface.nearest(np.einsum("qa,qai->qi", values, nodes), face)
    areas = np.sum(areas * normal, axis=1, keepdims=True) * normal
    return places, areas, values, faces[face]


def _from_afar(load: Rectangles, columns: Floats) -> tuple[Rectangles, Floats]:
    """Return point forces (c) and their values (c, 3, m) that stand for a load at a distance.

    Four in every rectangle, for a wide one's spread counts far away too; those of a fine load are merged into cells.
    Loads of few rectangles, several cases at once, and neighbours that pull in opposite directions are not merged.
    """
    corners = np.array([(s, t) for t in GAUSS_2 for s in GAUSS_2])
    offsets = np.einsum("sa,ka,kai->ksi", corners, load.half_mm, load.frames[:, :2])
    centre = (load.centre_mm[:, None] + offsets).reshape(-1, 3)
    frames, forces = np.repeat(load.frames, 4, axis=0), np.repeat(columns / 4.0, 4, axis=0)
    merged = _merged(centre, frames, forces) if len(load) >= MERGEABLE and columns.shape[2] == 1 else None
    centre, frames, forces = merged or (centre, frames, forces)
    none = np.zeros((len(centre), 3))
    points = Rectangles(centre_mm=centre, frames=frames, half_mm=none[:, :2], force_n=none)
    return points, np.ascontiguousarray(forces)


def _merged(centre: Points, frames: Floats, forces: Floats) -> tuple[Points, Floats, Floats] | None:
    """Return fewer point forces: places, frames and values (c, 3, 1); None where neighbours cancel."""
    size = np.max(np.ptp(centre, axis=0)) / CELLS
    _, group = np.unique(np.round(centre / size).astype(int), axis=0, return_inverse=True)
    group = group.ravel()
    strength = np.linalg.norm(forces[:, :, 0], axis=1)
    weight = strength + 1e-12 * strength.max(initial=1.0)
    total = np.bincount(group, weight)

    def summed(array: Floats) -> Floats:
        return np.column_stack([np.bincount(group, array[:, i]) for i in range(3)])

    force = summed(forces[:, :, 0])
    if np.linalg.norm(force, axis=1).sum() < 0.98 * strength.sum():
        return None
    normal = summed(weight[:, None] * frames[:, 2])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    first = frames[np.unique(group, return_index=True)[1], 0]
    first = first - np.sum(first * normal, axis=1, keepdims=True) * normal
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    middle = summed(weight[:, None] * centre) / total[:, None]
    return middle, np.stack([first, np.cross(normal, first), normal], axis=1), force[:, :, None]


def _in_plane(nodes: Floats, load: Rectangles) -> Bools:
    """Tell which faces (f, 6, 3) lie in the plane of all rectangles: nothing is left there."""
    height = (nodes - load.centre_mm[0]) @ load.frames[0, 2]
    same = np.allclose(load.frames[:, 2], load.frames[0, 2], atol=1e-12, rtol=0.0) and np.allclose(
        (load.centre_mm - load.centre_mm[0]) @ load.frames[0, 2], 0.0, atol=1e-9
    )
    return np.asarray(np.all(np.abs(height) < 1e-9, axis=1) & same)


def _balls(load: Rectangles) -> tuple[Points, Floats]:
    """Return centres (c, 3) and radii (c,) of balls around the separate groups of rectangles."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    reach = np.linalg.norm(load.half_mm, axis=1)
    pairs = cKDTree(load.centre_mm).sparse_distance_matrix(cKDTree(load.centre_mm), 3.0 * float(reach.max()) + 1e-9)
    number, group = connected_components(pairs)
    centres, radii = np.empty((number, 3)), np.empty(number)
    for i in range(number):
        of_group = load.centre_mm[group == i]
        centres[i] = of_group.mean(axis=0)
        radii[i] = np.max(np.linalg.norm(of_group - centres[i], axis=1) + reach[group == i])
    return centres, radii


def _split(points: Points, surface: Skin, centres: Points, radii: Floats, finest: float) -> tuple[Ints, Floats]:
    """Return the face (t,) and corners (t, 3, 2) of pieces of faces, small near the balls around the load."""
    faces = surface.faces
    face = np.arange(len(faces))
    triangles = np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (len(faces), 1, 1))
    done: list[tuple[Ints, Floats]] = []
    for level in range(LEVELS + 1):
        values = triangle_shapes(triangles.reshape(-1, 2))[0].reshape(-1, 3, 6)
        corners = np.einsum("tca,tai->tci", values, points[faces[face]])
        corners = surface.nearest(corners.reshape(-1, 3), np.repeat(face, 3))[0].reshape(-1, 3, 3)
        size = np.max(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
        away = np.linalg.norm(corners.mean(axis=1)[:, None] - centres, axis=2) - radii
        wanted = np.min(np.maximum(GROWTH * away, finest * radii), axis=1)
        big = (size > wanted) & (level < LEVELS)
        done.append((face[~big], triangles[~big]))
        if not np.any(big):
            break
        a, b, c = (triangles[big, i] for i in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(q, axis=1) for q in quarters])
        face = np.tile(face[big], 4)
    return np.concatenate([f for f, _ in done]), np.concatenate([t for _, t in done])


def _add(
    points: Floats,
    areas: Floats,
    values: Floats,
    nodes: Ints,
    centre: Floats,
    frames: Floats,
    half: Floats,
    columns: Floats,
    nu: float,
    out: Floats,
) -> None:
    """Add every point's traction, spread by the shape functions, to the nodal forces."""
    rows = np.stack([distant_rows(centre, frames, half, case) for case in np.moveaxis(columns, 2, 0)])
    _add_rows(points, areas, values, nodes, centre, frames, half, columns, rows, nu, out)


@njit(cache=True)
def _add_rows(
    points: Floats,
    areas: Floats,
    values: Floats,
    nodes: Ints,
    centre: Floats,
    frames: Floats,
    half: Floats,
    columns: Floats,
    rows: Floats,
    nu: float,
    out: Floats,
) -> None:
    cases = columns.shape[2]
    total, t = np.empty((3, cases)), np.empty((3, 3))
    d, u, n, g = np.empty((3, 3, 3)), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    away = np.empty(3)
    for q in range(len(points)):
        px, py, pz = points[q, 0], points[q, 1], points[q, 2]
        for case in range(cases):
            total[:, case] = distant(px, py, pz, areas[q, 0], areas[q, 1], areas[q, 2], rows[case], 1.0 - 2.0 * nu)
        for k in range(len(centre)):
            x, y, z = px - centre[k, 0], py - centre[k, 1], pz - centre[k, 2]
            r2 = x * x + y * y + z * z
            if r2 > rows[0, 3, k] or r2 == 0.0:
                continue
            away[0], away[1], away[2] = x, y, z
            if r2 > NEAR * NEAR * (half[k, 0] * half[k, 0] + half[k, 1] * half[k, 1]):
                _far(away, areas[q], frames[k], half[k], nu, t)
            else:
                _near(away, areas[q], frames[k], half[k], nu, t, d, u, n, g)
            for i in range(3):
                for case in range(cases):
                    force = (
                        t[i, 0] * columns[k, 0, case] + t[i, 1] * columns[k, 1, case] + t[i, 2] * columns[k, 2, case]
                    )
                    total[i, case] -= force
        for a in range(6):
            for i in range(3):
                for case in range(cases):
                    out[nodes[q, a], i, case] += values[q, a] * total[i, case]


@njit(cache=True)
def _far(away: Floats, area: Floats, frame: Floats, half: Floats, nu: float, t: Floats) -> None:
    """Set t[i, j] to sigma n dA per unit force j, four point forces standing for the rectangle.

    A point force's stress is radial, -3 (f . x) x x / (2 pi r^5), plus (1 - 2 nu) times a plane part that has no
    component along the normal (Boussinesq, Cerruti; H is the potential of `twin.theory.halfspace_kernels`).
    """
    t[:] = 0.0
    for s in range(4):
        first, second = half[0] * GAUSS_2[s % 2], half[1] * GAUSS_2[s // 2]
        x = away[0] - first * frame[0, 0] - second * frame[1, 0]
        y = away[1] - first * frame[0, 1] - second * frame[1, 1]
        z = away[2] - first * frame[0, 2] - second * frame[1, 2]
        r2 = x * x + y * y + z * z
        c = -0.375 / math.pi * (x * area[0] + y * area[1] + z * area[2]) / (r2 * r2 * math.sqrt(r2))
        t[0, 0] += c * x * x
        t[1, 1] += c * y * y
        t[2, 2] += c * z * z
        t[0, 1] += c * x * y
        t[0, 2] += c * x * z
        t[1, 2] += c * y * z
    t[1, 0], t[2, 0], t[2, 1] = t[0, 1], t[0, 2], t[1, 2]
    if nu != 0.5:
        for s in range(4):
            first, second = half[0] * GAUSS_2[s % 2], half[1] * GAUSS_2[s // 2]
            _add_plane_part(away, area, frame, first, second, 0.25 * (1.0 - 2.0 * nu), t)


@njit(cache=True)
def _add_plane_part(
    away: Floats, area: Floats, frame: Floats, first: float, second: float, weight: float, t: Floats
) -> None:
    """Add weight / (2 pi) [x_j A_i / r^3 - H_ijx A_x - H_ijy A_y], i in the plane, turned to global axes."""
    x = frame[0, 0] * away[0] + frame[0, 1] * away[1] + frame[0, 2] * away[2] - first
    y = frame[1, 0] * away[0] + frame[1, 1] * away[1] + frame[1, 2] * away[2] - second
    z = max(frame[2, 0] * away[0] + frame[2, 1] * away[1] + frame[2, 2] * away[2], 0.0)
    ax = frame[0, 0] * area[0] + frame[0, 1] * area[1] + frame[0, 2] * area[2]
    ay = frame[1, 0] * area[0] + frame[1, 1] * area[1] + frame[1, 2] * area[2]
    over_r = 1.0 / math.sqrt(x * x + y * y + z * z)
    c, r3 = weight * 0.5 / math.pi, over_r * over_r * over_r
    s = 1.0 / (1.0 / over_r + z)
    p = over_r * s * s
    q, v = p * over_r * (over_r + 2.0 * s), over_r * s * over_r * (over_r + s)
    hxxx, hxxy = x * (3.0 * p - x * x * q), y * (p - x * x * q)
    hxyy, hyyy = x * (p - y * y * q), y * (3.0 * p - y * y * q)
    hxxz, hyyz, hxyz = over_r * s - x * x * v, over_r * s - y * y * v, -x * y * v
    rows = (
        (x * ax * r3 - hxxx * ax - hxxy * ay, y * ax * r3 - hxxy * ax - hxyy * ay, z * ax * r3 - hxxz * ax - hxyz * ay),
        (x * ay * r3 - hxxy * ax - hxyy * ay, y * ay * r3 - hxyy * ax - hyyy * ay, z * ay * r3 - hxyz * ax - hyyz * ay),
    )
    for j in range(3):
        on_x = c * (rows[0][0] * frame[0, j] + rows[0][1] * frame[1, j] + rows[0][2] * frame[2, j])
        on_y = c * (rows[1][0] * frame[0, j] + rows[1][1] * frame[1, j] + rows[1][2] * frame[2, j])
        for i in range(3):
            t[i, j] += frame[0, i] * on_x + frame[1, i] * on_y


@njit(cache=True)
def _near(
    away: Floats,
    area: Floats,
    frame: Floats,
    half: Floats,
    nu: float,
    t: Floats,
    d: Floats,
    u: Floats,
    n: Floats,
    g: Floats,
) -> None:
    """Set t[i, j] to sigma n dA per unit force j in closed form; d, u, n, g are scratch.

    In the rectangle's own footprint the applied traction is taken off, and what is left is small.
    """
    x = frame[0, 0] * away[0] + frame[0, 1] * away[1] + frame[0, 2] * away[2]
    y = frame[1, 0] * away[0] + frame[1, 1] * away[1] + frame[1, 2] * away[2]
    z = max(frame[2, 0] * away[0] + frame[2, 1] * away[1] + frame[2, 2] * away[2], 0.0)
    a, b, k = half[0], half[1], 1.0 - 2.0 * nu
    rectangle_slopes(x, y, z, a, b, k, d, n)
    for i in range(3):
        u[i, 0] = frame[i, 0] * area[0] + frame[i, 1] * area[1] + frame[i, 2] * area[2]
    inside = abs(x) <= a and abs(y) <= b and z * z <= a * a + b * b
    for i in range(3):
        for j in range(3):
            g[i, j] = -nu / math.pi * n[j] * u[i, 0]
            for m in range(3):
                g[i, j] += 0.25 / math.pi * (d[i, j, m] + d[m, j, i]) * u[m, 0]
        if inside:
            g[i, i] += 0.25 * u[2, 0] / (a * b)
    _turn(g, frame, u, t)


@njit(cache=True)
def _turn(g: Floats, frame: Floats, u: Floats, t: Floats) -> None:
    """Set ``t`` to the tensor ``g`` of the rectangle's frame in global axes; ``u`` is scratch."""
    for i in range(3):
        for j in range(3):
            u[i, j] = g[i, 0] * frame[0, j] + g[i, 1] * frame[1, j] + g[i, 2] * frame[2, j]
    for i in range(3):
        for j in range(3):
            t[i, j] = frame[0, i] * u[0, j] + frame[1, i] * u[1, j] + frame[2, i] * u[2, j]
