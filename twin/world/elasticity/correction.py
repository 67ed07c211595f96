"""The correction w of the elastic field, u = known part + w, by Taylor-Hood on a small mesh.

The known part is the half-space field of the load, on thin flat bodies with that of an endless
bonded layer. A load's field is steep near the load, where the closed form is exact; what a finite
body adds is smooth: 7 000 unknowns with the subtraction beat 50 000 without. The closed form holds
where the body lies behind every load's plane. Under a cover of another modulus the half-space is
made of the cover; at the interface w is then as steep as the field.

The closed-form field of every rectangle is exact in the half-space of the rectangle's own plane.
The body's other faces cut through it, so the correction w must carry the tractions -sigma n there
and undo the displacement on the held face. Within a rectangle's own footprint traction and stress
cancel, and nothing is added.

In a layer of another material the half-space's strains make g times its stress, g the ratio of the
shear moduli: in balance within the region but not across its border, so an interface adds surface
integrals, and a material of another Poisson's ratio a change of volume (`_dilation`).

Tractions are evaluated on the body's true surface, where that of a force F at distance r is about
F / (R r) (R the radius of curvature), which any quadrature bears. Quadratic faces lie up to 6 um
off it on the finger, so deep that a narrow load's whole flux comes through the face.

Validity: on a curved body a narrow twist is two nearly cancelling forces that grow like 1 / radius,
and so do the quadrature's errors: twists of 0.3 mm radius and less are 1 to 4 % off there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, for_kernel
from twin.compiled import njit
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.theory import halfspace
from twin.theory.bonded_layer import BondedLayer
from twin.theory.halfspace import GAUSS_2, rectangle_slopes
from twin.world.elasticity.factor import GOAL
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.quadratic_mesh import TET_EDGES, Mesh, quadrature, shapes


def correction(
    system: TaylorHood,
    body: Body,
    loads: Sequence[Rectangles],
    columns: Sequence[Floats] | None = None,
    goal: float = GOAL,
) -> Floats:
    """Return w at the nodes, (N, 3, sum of m) in mm for E = 1 MPa; all load cases are solved
    together.

    Parameters
    ----------
    loads
        Loads of (k) rectangles, each in the plane of its own half-space.
    columns
        For every load (k, 3, m) forces in m load cases, N; if not given one case each, the load's
        own ``force_n``.
    goal
        See `twin.world.elasticity.factor.Factor.solve`, which raises a `SolveError`.
    """
    forces, held, swollen = unbalanced(system, body, loads, columns)
    return system.solve(forces, held, goal, swollen)


def unbalanced(
    system: TaylorHood,
    body: Body,
    loads: Sequence[Rectangles],
    columns: Sequence[Floats] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Return what drives w: nodal forces and given displacements (N, 3, m), and dilations (P, m);
    see `correction`."""
    mesh, top, surface = system.mesh, system.under_load, _Skin.of(system, body)
    shares = _shear_shares(system)
    swelling = (top.softness - shares * [of.softness for of in system.made_of])[mesh.region]
    layer = BondedLayer.of(body, top.poisson_ratio) if len(system.made_of) == 1 else None
    balanced = len(system.made_of) == 1 and layer is None and system.held.any()
    below = _Skin.of(system, body, held=True) if balanced else None
    forces, held, swollen = [], [], []
    for load, cases in zip(
        loads, columns or [load.force_n[:, :, None] for load in loads], strict=True
    ):
        balls = _balls(load)
        forces.append(_nodal_forces(surface, load, balls, cases, top.poisson_ratio, layer))
        if below is not None:
            _balance(surface, below, load, balls, cases, top.poisson_ratio, forces[-1])
        swollen.append(_dilation(mesh, system.pressure, swelling, load, cases, top.poisson_ratio))
        held.append(np.zeros_like(forces[-1]))
        if layer is None:  # else the known part is zero there
            known = halfspace.compliance(
                mesh.points[system.held], load, top.modulus_ratio, top.poisson_ratio
            )
            moved = known @ cases.reshape(-1, cases.shape[2])
            held[-1][system.held] = -moved.reshape(-1, 3, cases.shape[2])
    return (
        np.concatenate(forces, axis=2),
        np.concatenate(held, axis=2),
        np.concatenate(swollen, axis=1),
    )


FAR = 6.0
"""Half diagonals beyond which one point force stands for a rectangle."""


def _distant_rows(centre: Floats, frames: Floats, half: Floats, force: Floats) -> Floats:
    """Return (13, k) rows for `_distant` of rectangles under forces (k, 3)."""
    normal = frames[:, 2]
    along = np.sum(normal * force, axis=1)
    limit = FAR**2 * np.sum(half**2, axis=1)
    flat = force - along[:, None] * normal
    return np.ascontiguousarray(np.vstack([centre.T, limit, force.T, normal.T, flat.T]))


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _distant(
    px: float, py: float, pz: float, ax: float, ay: float, az: float, rows: Floats, k: float
) -> tuple[float, float, float]:
    """Return minus the traction times area of all distant rectangles at the place p, on the area
    vector a.

    A point force's stress is radial, -3 (f . x) x x / (2 pi r^5), plus k = 1 - 2 nu times a plane
    part without a component along the normal n (Boussinesq, Cerruti; H is the potential of
    `twin.theory.halfspace`): the traction 1 / (2 pi) [A_i (x . f) / r^3 - H_imj A_m f_j], i and m
    in the plane. With s = 1 / (r + z), H_imj = p (d_im x_j + d_ij x_m + d_mj x_i) - w x_i x_m x_j
    and H_imz = d_im s / r - v x_i x_m.
    """
    tx, ty, tz = 0.0, 0.0, 0.0
    radial, plane = 1.5 / math.pi, 0.5 * k / math.pi
    for t in range(rows.shape[1]):
        x, y, z = px - rows[0, t], py - rows[1, t], pz - rows[2, t]
        r2 = x * x + y * y + z * z
        far = r2 > rows[3, t]
        r2 = r2 if far else 1.0
        over_r = (1.0 if far else 0.0) / math.sqrt(r2)
        r3 = over_r * over_r * over_r
        c = radial * (x * ax + y * ay + z * az) * r3 * over_r * over_r
        c *= x * rows[4, t] + y * rows[5, t] + z * rows[6, t]
        tx += c * x
        ty += c * y
        tz += c * z
    if k == 0.0:
        return tx, ty, tz
    for t in range(rows.shape[1]):
        x, y, z = px - rows[0, t], py - rows[1, t], pz - rows[2, t]
        r2 = x * x + y * y + z * z
        far = r2 > rows[3, t]
        r2 = r2 if far else 1.0
        weight = plane if far else 0.0
        nx, ny, nz, fx, fy, fz = (
            rows[7, t],
            rows[8, t],
            rows[9, t],
            rows[10, t],
            rows[11, t],
            rows[12, t],
        )
        deep, a_n = x * nx + y * ny + z * nz, ax * nx + ay * ny + az * nz
        f_n = (rows[4, t] - fx) * nx + (rows[5, t] - fy) * ny + (rows[6, t] - fz) * nz
        flat_f, flat_a = x * fx + y * fy + z * fz, x * ax + y * ay + z * az - deep * a_n
        both = ax * fx + ay * fy + az * fz
        over_r = 1.0 / math.sqrt(r2)
        s = 1.0 / (1.0 / over_r + deep)
        p = over_r * s * s
        w, v = p * over_r * (over_r + 2.0 * s), over_r * s * over_r * (over_r + s)
        on_a = (flat_f + deep * f_n) * over_r * over_r * over_r - p * flat_f - f_n * s * over_r
        on_f = -p * flat_a
        on_x = flat_a * (w * flat_f + v * f_n) - p * both
        on_n = on_a * a_n + on_x * deep
        tx -= weight * (on_a * ax + on_f * fx + on_x * x - on_n * nx)
        ty -= weight * (on_a * ay + on_f * fy + on_x * y - on_n * ny)
        tz -= weight * (on_a * az + on_f * fz + on_x * z - on_n * nz)
    return tx, ty, tz


_SKINS: WeakKeyDictionary[TaylorHood, dict[bool, _Skin]] = WeakKeyDictionary()
"""The skin of every system that was loaded, and that which is held."""


@dataclass(frozen=True)
class _Skin:
    """Faces (f, 6) of a system's mesh and the true surfaces behind them: the sheet (f,) of the
    body's surface that each lies on and how far below it, how many times the half-space's traction
    is out of balance there, and whether each is an interface."""

    body: Body
    points: Points
    faces: Ints
    sheet: Ints
    depth_mm: Floats
    weight: Floats
    inside: Bools

    @classmethod
    def of(cls, system: TaylorHood, body: Body, *, held: bool = False) -> _Skin:
        """Return the free faces, or those ``held``, weighted by their region's share of the
        half-space's stress, and the interfaces."""
        known = _SKINS.setdefault(system, {})
        if held not in known:
            known[held] = cls._made(system, body, held)
        return known[held]

    @classmethod
    def _made(cls, system: TaylorHood, body: Body, held: bool) -> _Skin:
        mesh, shares = system.mesh, _shear_shares(system)
        outside = np.isin(mesh.piece, body.held_pieces) == held
        faces = mesh.faces[outside]
        sheet = body.sheets_of(mesh.points[faces], mesh.piece[outside])
        weight = shares[mesh.regions_behind(faces)]
        if not mesh.region.any():
            none = np.zeros(len(faces))
            return cls(body, mesh.points, faces, sheet, none, weight, none > 0.0)
        inner, sides = _interfaces(mesh)
        depth = body.depth(mesh.points[inner[:, :3].ravel()]).reshape(-1, 3)
        level = np.ptp(depth, axis=1) < 1e-9
        below = body.sheets_of(mesh.points[inner], np.where(level, 0, len(body.pieces) - 1))
        return cls(
            body,
            mesh.points,
            np.concatenate([faces, inner]),
            np.concatenate([sheet, below]),
            np.concatenate([np.zeros(len(faces)), np.where(level, depth.mean(axis=1), 0.0)]),
            np.concatenate([weight, shares[sides[:, 0]] - shares[sides[:, 1]]]),
            np.arange(len(faces) + len(inner)) >= len(faces),
        )

    def nearest(self, points: Points, face: Ints) -> tuple[Points, Floats]:
        """Return the nearest points (q, 3) on the surfaces of ``face`` (q,), and the inward normals
        (q, 3) there."""
        for _ in range(2):
            distance, normal = self.body.from_sheets(points, self.sheet[face])
            points = points - (distance - self.depth_mm[face])[:, None] * normal
        return points, normal

    def surface_points(self, face: Ints, places: Floats) -> Points:
        """Return (t, c, 3) points on the true surface, c of each face (t,) at ``places`` (t, c,
        2)."""
        values = shapes(places.reshape(-1, 2))[0].reshape(*places.shape[:2], 6)
        flat = np.einsum("tca,tai->tci", values, self.points[self.faces[face]])
        each = np.repeat(face, places.shape[1])
        distance, normal = self.body.from_sheets(flat.reshape(-1, 3), self.sheet[each])
        off = (distance - self.depth_mm[each])[:, None] * normal
        return np.asarray(flat - off.reshape(flat.shape))

    @cached_property
    def whole_corners(self) -> Points:
        """(f, 3, 3) those of the whole faces."""
        return self.surface_points(*_whole(len(self.faces)))

    @cached_property
    def whole_quadrature(self) -> tuple[Points, Floats, Floats]:
        """The `quadrature` of the whole faces."""
        return self.quadrature(*_whole(len(self.faces)))

    @cached_property
    def spread(self) -> tuple[Floats, Floats]:
        """Rigid motions of the nodes (N, 3, 6), and forces spread evenly over the faces that add up
        to unit forces and torques."""
        _, areas, values = self.whole_quadrature
        size = np.linalg.norm(areas, axis=2)[..., None] * values
        weight = np.bincount(self.faces.ravel(), size.sum(axis=1).ravel(), len(self.points))
        turned = np.cross(np.eye(3)[None], self.points[:, None])
        rigid = np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=1)
        rigid = rigid.swapaxes(1, 2)
        evenly = weight[:, None, None] * rigid
        return rigid, evenly @ np.linalg.inv(np.einsum("nia,nib->ab", rigid, evenly))

    def quadrature(self, face: Ints, triangles: Floats) -> tuple[Points, Floats, Floats]:
        """Return true surface places (t, g, 3), weighted area vectors (t, g, 3) and shape functions
        (t, g, 6) of pieces of faces."""
        places, weights = quadrature(2)
        where = triangles[:, :1] + places[:, :1] * (triangles[:, 1:2] - triangles[:, :1])
        where = (where + places[:, 1:] * (triangles[:, 2:] - triangles[:, :1])).reshape(-1, 2)
        each = np.repeat(face, len(places))
        values, slopes = shapes(where)
        nodes = self.points[self.faces[each]]
        tangents = np.einsum("qam,qai->qmi", slopes, nodes)
        sides = triangles[:, 1:] - triangles[:, :1]
        share = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        share = (share * self.weight[face])[:, None] * weights
        areas = np.cross(tangents[:, 0], tangents[:, 1]) * share.reshape(-1, 1)
        on_surface, normal = self.nearest(np.einsum("qa,qai->qi", values, nodes), each)
        areas = np.sum(areas * normal, axis=1, keepdims=True) * normal
        of_piece = (len(face), len(places))
        return (
            on_surface.reshape(*of_piece, 3),
            areas.reshape(*of_piece, 3),
            values.reshape(*of_piece, 6),
        )


def _whole(count: int) -> tuple[Ints, Floats]:
    """Return ``count`` faces (f,), and the corners (f, 3, 2) of each as its own only piece."""
    return np.arange(count), np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (count, 1, 1))


def _shear_shares(system: TaylorHood) -> Floats:
    """Return (regions,) the shear modulus of every region over that of the material under the
    load."""
    return np.array([of.shear_ratio / system.under_load.shear_ratio for of in system.made_of])


_Quadrature: TypeAlias = tuple[Points, Floats, Floats, Ints]
"""True surface places (q, 3), weighted area vectors (q, 3), shape functions (q, 6), face nodes (q,
6)."""


def _add_exactly(
    at: _Quadrature, load: Rectangles, columns: Floats, poisson_ratio: float, out: Floats
) -> None:
    """Add every point's traction -sigma n to the nodal forces (N, 3, m) in closed form: under a
    load an interface carries all of it, where a free face carries next to nothing."""
    points, areas, values, nodes = at
    for case in range(columns.shape[2]):
        one = replace(load, force_n=columns[:, :, case])
        traction = -np.einsum("qij,qj->qi", halfspace.stress(points, one, poisson_ratio), areas)
        np.add.at(out[:, :, case], nodes, values[:, :, None] * traction[:, None])


def _interfaces(mesh: Mesh) -> tuple[Ints, Ints]:
    """Return the faces (f, 6) between regions, normals out of the first, and the two regions (f,
    2)."""
    corners, owner = mesh.outward_faces()
    key = np.sort(corners, axis=1)
    _, first, inverse, count = np.unique(
        key, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    other = np.zeros(len(first), np.int64)
    other[inverse.ravel()] = np.arange(len(key))  # the last one of each pair
    region = mesh.region[owner]
    between = (count == 2) & (region[first] != region[other])
    chosen = first[between]
    return _with_middles(mesh, corners[chosen], owner[chosen]), np.column_stack(
        [region[chosen], region[other[between]]]
    )


def _with_middles(mesh: Mesh, corners: Ints, owner: Ints) -> Ints:
    """Return faces (f, 6) with the middle nodes of their elements' edges."""
    edges = TET_EDGES
    ends = np.sort(mesh.tets[owner][:, edges], axis=2)
    sides = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    which = np.argmax(np.all(sides[:, :, None] == ends[:, None], axis=3), axis=2)
    return np.hstack([corners, np.take_along_axis(mesh.tets[owner, 4:], which, axis=1)])


NEAR = 2.2
"""Half diagonals within which a stress is in closed form; four point forces replace it further
away, then one."""

GROWTH = 1.2
"""Largest size of a piece of face over its distance to the load."""

FINEST = 0.12
"""Size of the pieces under the load, over the load's radius."""

FINEST_INSIDE = 0.25
"""The same on interfaces, which lie a layer deeper."""

LEVELS = 40
"""Halvings of a face at most, down to 1e-11 mm: narrow loads at an edge need them, others stop by
their own size."""

DISTANT, CELLS, MERGEABLE = 2.5, 6.0, 64
"""Load radii beyond which point forces stand for a load; if it has at least so many rectangles they
are merged into cells, so many across."""


def _nodal_forces(
    surface: _Skin,
    load: Rectangles,
    balls: tuple[Points, Floats],
    columns: Floats,
    poisson_ratio: float,
    layer: BondedLayer | None,
) -> Floats:
    """Return the (N, 3, m) nodal forces in N of the tractions that w must carry on free faces and
    interfaces.

    Parameters
    ----------
    surface
        The free faces and interfaces; tractions are read on the body's true surface.
    load
        (k) rectangles; their own ``force_n`` is ignored.
    columns
        (k, 3, m) force of every rectangle in m load cases, N, global axes.
    poisson_ratio
        nu of the half-space, which is that of the material under the load.
    layer
        The layer whose correction of the half-space is known too, if any; its traction is as much
        out of balance.
    """
    out = np.zeros((len(surface.points), 3, columns.shape[2]))
    if len(load) == 0:
        return out
    unbalanced = ~_in_plane(surface.points[surface.faces], load) & (surface.weight != 0.0)
    columns = for_kernel(columns)
    afar = _from_afar(load, columns)
    for inside in (False, True):
        chosen = np.flatnonzero(unbalanced & (surface.inside == inside))
        if len(chosen) == 0:
            continue
        at = _quadrature(surface, chosen, *balls, FINEST_INSIDE if inside else FINEST)
        _add_parts(at, balls, (load, columns), afar, poisson_ratio, out, exactly=inside)
        if layer is not None:
            points, areas, values, nodes = at
            forces = layer.tractions(points, areas, load, columns)
            np.subtract.at(out, nodes, values[:, :, None, None] * forces[:, None])
    return out


def _add_parts(
    at: _Quadrature,
    balls: tuple[Points, Floats],
    near: tuple[Rectangles, Floats],
    afar: tuple[Rectangles, Floats],
    nu: float,
    out: Floats,
    *,
    exactly: bool = False,
) -> None:
    """Add to the nodal forces (N, 3, m) the tractions of a load at places ``near`` it, and of the
    point forces that stand for it at those ``afar``."""
    distance = np.linalg.norm(at[0][:, None] - balls[0], axis=2)
    far = np.min(distance / np.maximum(balls[1], 1e-300), axis=1) > DISTANT
    add = _add_exactly if exactly else _add
    for part, (load, columns) in ((~far, near), (far, afar)):
        points, areas, values, nodes = at
        add((points[part], areas[part], values[part], nodes[part]), load, columns, nu, out)


def _balance(
    surface: _Skin,
    below: _Skin,
    load: Rectangles,
    balls: tuple[Points, Floats],
    columns: Floats,
    nu: float,
    out: Floats,
) -> None:
    """Make nodal forces (N, 3, m) of free faces balance the load and the half-space's tractions on
    the held ones ``below``: by quadrature they are off by 1e-4 of the load, which bends a tall
    body."""
    on_held = np.zeros_like(out)
    columns = for_kernel(columns)
    at = _quadrature(below, np.arange(len(below.faces)), *balls, FINEST)
    _add_parts(at, balls, (load, columns), _from_afar(load, columns, merge=False), nu, on_held)
    rigid, evenly = surface.spread
    arm = np.cross(load.centre_mm[:, :, None], columns, axis=1)
    given = np.concatenate([columns, arm], axis=1).sum(axis=0)
    missing = given - np.einsum("nia,nim->am", rigid, on_held + out)
    out += np.einsum("nia,am->nim", evenly, missing)


def _quadrature(
    surface: _Skin, chosen: Ints, centres: Points, radii: Floats, finest: float
) -> _Quadrature:
    """Return the quadrature of some faces, cut into pieces that are small near the load."""
    whole, face, triangles = _split(surface, chosen, centres, radii, finest)
    cut = surface.quadrature(face, triangles)
    points, areas, values = (
        np.concatenate([one[whole], other]).reshape(-1, one.shape[2])
        for one, other in zip(surface.whole_quadrature, cut, strict=True)
    )
    each = np.repeat(np.concatenate([whole, face]), cut[0].shape[1])
    return points, areas, values, surface.faces[each]


def _from_afar(
    load: Rectangles, columns: Floats, *, merge: bool = True
) -> tuple[Rectangles, Floats]:
    """Return point forces (c) and their values (c, 3, m) that stand for a load at a distance: four
    in every rectangle, for a wide one's spread counts far away too; those of a fine load merged
    into cells, unless neighbours pull in opposite directions."""
    corners = np.array([(s, t) for t in GAUSS_2 for s in GAUSS_2])
    offsets = np.einsum("sa,ka,kai->ksi", corners, load.half_mm, load.frames[:, :2])
    centre = (load.centre_mm[:, None] + offsets).reshape(-1, 3)
    frames, forces = np.repeat(load.frames, 4, axis=0), np.repeat(columns / 4.0, 4, axis=0)
    merged = (
        _merged(centre, frames, forces)
        if merge and len(load) >= MERGEABLE and columns.shape[2] == 1
        else None
    )
    centre, frames, forces = merged or (centre, frames, forces)
    none = np.zeros((len(centre), 3))
    points = Rectangles(centre_mm=centre, frames=frames, half_mm=none[:, :2], force_n=none)
    return points, np.ascontiguousarray(forces)


def _merged(centre: Points, frames: Floats, forces: Floats) -> tuple[Points, Floats, Floats] | None:
    """Return fewer point forces: places, frames and values (c, 3, 1); None where neighbours
    cancel."""
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
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    reach = np.linalg.norm(load.half_mm, axis=1)
    one, other = (
        cKDTree(load.centre_mm)
        .query_pairs(3.0 * float(reach.max()) + 1e-9, output_type="ndarray")
        .T
    )
    near = coo_array((np.ones(len(one)), (one, other)), shape=(len(load), len(load)))
    number, group = connected_components(near, directed=False)
    centres, radii = np.empty((number, 3)), np.empty(number)
    for i in range(number):
        of_group = load.centre_mm[group == i]
        centres[i] = of_group.mean(axis=0)
        radii[i] = np.max(np.linalg.norm(of_group - centres[i], axis=1) + reach[group == i])
    return centres, radii


def _split(
    surface: _Skin, chosen: Ints, centres: Points, radii: Floats, finest: float
) -> tuple[Ints, Ints, Floats]:
    """Return which of the ``chosen`` faces stay whole, and of the others the face (t,) and corners
    (t, 3, 2) of pieces, small near the balls around the load."""

    def fitting(corners: Points) -> Bools:
        size = np.max(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
        away = np.linalg.norm(corners.mean(axis=1)[:, None] - centres, axis=2) - radii
        wanted = np.min(np.maximum(GROWTH * away, finest * radii), axis=1)
        return np.asarray(size <= wanted)

    corners = surface.whole_corners[chosen]
    fits = fitting(corners)
    whole, face, corners = chosen[fits], chosen[~fits], corners[~fits]
    _, triangles = _whole(len(face))
    done: list[tuple[Ints, Floats]] = []
    for level in range(LEVELS):
        middles = (triangles + np.roll(triangles, -1, axis=1)) / 2.0
        corners = _quarters(corners, surface.surface_points(face, middles))
        triangles = _quarters(triangles, middles)
        face = np.tile(face, 4)
        fits = fitting(corners) | (level == LEVELS - 1)
        done.append((face[fits], triangles[fits]))
        face, triangles, corners = face[~fits], triangles[~fits], corners[~fits]
        if len(face) == 0:
            break
    return whole, np.concatenate([f for f, _ in done]), np.concatenate([t for _, t in done])


def _quarters(corners: Floats, middles: Floats) -> Floats:
    """Return the corners (4 t, 3, d) of the quarters of triangles (t, 3, d) by the ``middles`` of
    their sides 01, 12, 20."""
    (a, b, c), (ab, bc, ca) = corners.swapaxes(0, 1), middles.swapaxes(0, 1)
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(q, axis=1) for q in quarters])


def _add(at: _Quadrature, load: Rectangles, columns: Floats, nu: float, out: Floats) -> None:
    """Add every point's traction, spread by the shape functions, to the nodal forces."""
    half, columns = for_kernel(load.half_mm), for_kernel(columns)
    rows = np.stack(
        [
            _distant_rows(load.centre_mm, load.frames, half, case)
            for case in np.moveaxis(columns, 2, 0)
        ]
    )
    _add_rows(*at, load.centre_mm, load.frames, half, columns, rows, nu, out)


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
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
            total[:, case] = _distant(
                px, py, pz, areas[q, 0], areas[q, 1], areas[q, 2], rows[case], 1.0 - 2.0 * nu
            )
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
                        t[i, 0] * columns[k, 0, case]
                        + t[i, 1] * columns[k, 1, case]
                        + t[i, 2] * columns[k, 2, case]
                    )
                    total[i, case] -= force
        for a in range(6):
            for i in range(3):
                for case in range(cases):
                    out[nodes[q, a], i, case] += values[q, a] * total[i, case]


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _far(away: Floats, area: Floats, frame: Floats, half: Floats, nu: float, t: Floats) -> None:
    """Set t[i, j] to sigma n dA per unit force j, four point forces standing for the rectangle.

    The stress is that of `_distant`; its plane part adds weight / (2 pi) [x_j A_i / r^3 - H_ijx A_x
    - H_ijy A_y], i in the plane, turned to global axes.
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
    if nu == 0.5:
        return
    weight = 0.25 * (1.0 - 2.0 * nu)
    x0 = frame[0, 0] * away[0] + frame[0, 1] * away[1] + frame[0, 2] * away[2]
    y0 = frame[1, 0] * away[0] + frame[1, 1] * away[1] + frame[1, 2] * away[2]
    z = frame[2, 0] * away[0] + frame[2, 1] * away[1] + frame[2, 2] * away[2]
    ax = frame[0, 0] * area[0] + frame[0, 1] * area[1] + frame[0, 2] * area[2]
    ay = frame[1, 0] * area[0] + frame[1, 1] * area[1] + frame[1, 2] * area[2]
    # Sum the plane part's two rows in the rectangle's frame.
    xx, xy, xz, yx, yy, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    c = weight * 0.5 / math.pi
    for s in range(4):
        x, y = x0 - half[0] * GAUSS_2[s % 2], y0 - half[1] * GAUSS_2[s // 2]
        over_r = 1.0 / math.sqrt(x * x + y * y + z * z)
        r3 = over_r * over_r * over_r
        over = 1.0 / (1.0 / over_r + z)
        p = over_r * over * over
        q, v = p * over_r * (over_r + 2.0 * over), over_r * over * over_r * (over_r + over)
        hxxx, hxxy = x * (3.0 * p - x * x * q), y * (p - x * x * q)
        hxyy, hyyy = x * (p - y * y * q), y * (3.0 * p - y * y * q)
        hxxz, hyyz, hxyz = over_r * over - x * x * v, over_r * over - y * y * v, -x * y * v
        xx += c * (x * ax * r3 - hxxx * ax - hxxy * ay)
        xy += c * (y * ax * r3 - hxxy * ax - hxyy * ay)
        xz += c * (z * ax * r3 - hxxz * ax - hxyz * ay)
        yx += c * (x * ay * r3 - hxxy * ax - hxyy * ay)
        yy += c * (y * ay * r3 - hxyy * ax - hyyy * ay)
        yz += c * (z * ay * r3 - hxyz * ax - hyyz * ay)
    for j in range(3):
        on_x = xx * frame[0, j] + xy * frame[1, j] + xz * frame[2, j]
        on_y = yx * frame[0, j] + yy * frame[1, j] + yz * frame[2, j]
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
    """Set t[i, j] to sigma n dA per unit force j in closed form; d, u, n, g are scratch. In the
    rectangle's own footprint the applied traction is taken off, and what is left is small: on the
    face that it presses, not on a held or free one below."""
    x = frame[0, 0] * away[0] + frame[0, 1] * away[1] + frame[0, 2] * away[2]
    y = frame[1, 0] * away[0] + frame[1, 1] * away[1] + frame[1, 2] * away[2]
    z = frame[2, 0] * away[0] + frame[2, 1] * away[1] + frame[2, 2] * away[2]
    a, b, k = half[0], half[1], 1.0 - 2.0 * nu
    rectangle_slopes(x, y, z, a, b, k, d, n)
    for i in range(3):
        u[i, 0] = frame[i, 0] * area[0] + frame[i, 1] * area[1] + frame[i, 2] * area[2]
    inside = u[2, 0] < 0.0 and abs(x) <= a and abs(y) <= b and z * z <= a * a + b * b
    for i in range(3):
        for j in range(3):
            g[i, j] = -nu / math.pi * n[j] * u[i, 0]
            for m in range(3):
                g[i, j] += 0.25 / math.pi * (d[i, j, m] + d[m, j, i]) * u[m, 0]
        if inside:
            g[i, i] += 0.25 * u[2, 0] / (a * b)
    # from the rectangle's frame to global axes
    for i in range(3):
        for j in range(3):
            u[i, j] = g[i, 0] * frame[0, j] + g[i, 1] * frame[1, j] + g[i, 2] * frame[2, j]
    for i in range(3):
        for j in range(3):
            t[i, j] = frame[0, i] * u[0, j] + frame[1, i] * u[1, j] + frame[2, i] * u[2, j]


_DILATION_GROWTH, _DILATION_FINEST, _DILATION_LEVELS = 1.0, 0.3, 12
"""Largest size of a piece of an element over its distance to the load, and over the load's size
near it."""

_A, _B = 0.5854101966249685, 0.1381966011250105
_RULE = np.where(np.eye(4, dtype=bool), _A, _B)
"""Shares of four points, exact to degree 2."""

_EIGHTH = np.array(
    [
        (0, 4, 6, 7),
        (4, 1, 5, 8),
        (6, 5, 2, 9),
        (7, 8, 9, 3),
        (4, 5, 6, 7),
        (4, 5, 7, 8),
        (5, 6, 7, 9),
        (5, 7, 8, 9),
    ]
)
"""Corners of the eight parts of a quadratic tetrahedron, of its ten nodes."""

_NODES = np.array([(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)])


def _dilation(
    mesh: Mesh,
    pressure: Ints,
    share: Floats,
    load: Rectangles,
    columns: Floats,
    poisson_ratio: float,
) -> Floats:
    """Return (P, m) integrals of -share p q for every pressure unknown's q, mm3.

    ``pressure`` (e, 4) are the elements' unknowns, ``share`` (e,) is 1 / kappa - g / kappa', 1/MPa,
    zero where the half-space fits; the other arguments are those of `_nodal_forces`.
    """
    out = np.zeros((int(pressure.max()) + 1, columns.shape[2]))
    wrong = np.flatnonzero(share)
    if len(wrong) == 0 or len(load) == 0:
        return out
    element, shares = _pieces(mesh, wrong, load)
    corners = np.einsum("pc,ecs->eps", _RULE, shares)
    values, slopes = shapes(corners.reshape(-1, 4)[:, 1:])
    element = np.repeat(element, len(_RULE))
    nodes = mesh.points[mesh.tets[element]]
    points = np.einsum("qa,qai->qi", values, nodes)
    part = np.abs(np.linalg.det(shares[:, 1:, 1:] - shares[:, :1, 1:]))
    volume = (
        np.linalg.det(np.einsum("qai,qaj->qij", nodes, slopes)) / 24.0 * np.repeat(part, len(_RULE))
    )
    tension = np.empty((len(points), columns.shape[2]))
    for case in range(columns.shape[2]):
        stress = halfspace.stress(points, replace(load, force_n=columns[:, :, case]), poisson_ratio)
        tension[:, case] = np.trace(stress, axis1=1, axis2=2) / 3.0
    weighted = (
        -(share[element] * volume)[:, None, None] * corners.reshape(-1, 4, 1) * tension[:, None]
    )
    np.add.at(out, pressure[element], weighted)
    return out


def _pieces(mesh: Mesh, elements: Ints, load: Rectangles) -> tuple[Ints, Floats]:
    """Return elements (p,) and the barycentric shares (p, 4, 4) of pieces of them, small near the
    load."""
    from scipy.spatial import cKDTree

    tree, reach = cKDTree(load.centre_mm), float(np.linalg.norm(load.half_mm, axis=1).max())
    shares = np.tile(np.eye(4), (len(elements), 1, 1))
    done: list[tuple[Ints, Floats]] = []
    for level in range(_DILATION_LEVELS + 1):
        values = shapes(shares.reshape(-1, 4)[:, 1:])[0].reshape(-1, 4, 10)
        corner = np.einsum("eca,eai->eci", values, mesh.points[mesh.tets[elements]])
        size = np.max(
            [
                np.linalg.norm(corner[:, a] - corner[:, b], axis=1)
                for a in range(4)
                for b in range(a)
            ],
            axis=0,
        )
        away = np.maximum(tree.query(corner.mean(axis=1))[0] - reach, 0.0)
        big = (size > np.maximum(_DILATION_GROWTH * away, _DILATION_FINEST * reach)) & (
            level < _DILATION_LEVELS
        )
        big &= size > _DILATION_GROWTH * np.abs(away)
        done.append((elements[~big], shares[~big]))
        if not np.any(big):
            break
        nodes = (shares[big][:, _NODES[:, 0]] + shares[big][:, _NODES[:, 1]]) / 2.0
        shares = nodes[:, _EIGHTH].reshape(-1, 4, 4)
        elements = np.repeat(elements[big], len(_EIGHTH))
    return np.concatenate([e for e, _ in done]), np.concatenate([s for _, s in done])
