"""A body's mesh: from the cache, from those that ship with the program, one of these stretched, or
a new one.

A block is cut into tetrahedra by rule (`twin.world.mesh.bisection`); other bodies need the mesher,
fTetWild, whose mesh Mmg then remakes in the wanted sizes. All lengths are scaled together until the
number of unknowns is right. As the mesher is not deterministic, a mesh is made once, checked, and
kept under a key made of the geometry and the wanted sizes.

The mesher starts from closed triangles. Bodies given by formulas must be convex: theirs is the
convex hull of exact surface points, which only has to be near, as the result is snapped to the
level sets. A body that brings its own triangles may have dents; where fewer triangles describe it
as well, those are meshed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import asdict, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Ints, Points, Progress, coordinates, frozen
from twin.errors import InputError, MeshError
from twin.files import MESHES, PINNED, cache_folder, kept_if_possible
from twin.geometry.pieces import Pieces, TriangleTree
from twin.parts.body import CREASE_DEG, Block, Body
from twin.parts.part import identity
from twin.world.mesh.bisection import block_mesh
from twin.world.mesh.quadratic_mesh import Mesh, signed_volumes
from twin.world.mesh.quality import Quality, open_edges
from twin.world.mesh.sizing import Level, Sizing, WantedEdge
from twin.world.mesh.snap import snapped_mesh
from twin.world.mesh.tetrahedralise import Request, remeshed


def body_mesh(
    body: Body, level: Level, *, rebuild: bool = False, progress: Progress | None = None
) -> Mesh:
    """Return a body's mesh: the cached or shipped one if its key matches, else a shipped one
    stretched, else a new one.

    A stretched one saves the minute that meshing takes, and bodies of a sweep share its error. With
    ``rebuild`` a new one is made and put into the cache. Raises a `MeshError` if no mesh passes the
    quality gates, or the mesher fails.
    """
    sizing = Sizing.of(body, level)
    key = sizing.mesh_key(body)
    if (folder := PINNED.folder) is not None:
        path = folder / sizing.mesh_file(body)
        if path.is_file():
            return Mesh.read(path)
        if (stretched := _stretched(body, level, folder.glob("mesh-*.npz"))) is not None:
            return stretched
        raise MeshError(f"mesh of level {level}: not among the given ones, and no other is made")
    cached = cache_folder() / sizing.mesh_file(body)
    if not rebuild:
        for path in [cached, *sorted(MESHES.glob(f"*.{level}.npz"))]:
            found = _matching(path, key)
            if found is not None:
                return found
        shipped = MESHES.glob(f"*.{level}.npz")
        if (stretched := _stretched(body, level, shipped)) is not None:
            return stretched

    damaged = cached.exists()
    mesh, measured = build_mesh(body, sizing, progress=progress)
    provenance = {
        "key": key,
        "level": level,
        "body": body.geometry(),
        "sizing": asdict(sizing),
        "quality": asdict(measured),
    }
    with kept_if_possible():
        mesh.write(cached, provenance, first=not (rebuild or damaged))
    # another process may have been first: all that is made of this body is then made of that one's
    # mesh
    return _matching(cached, key) or mesh


def shipped_mesh(body: Body, level: Level) -> Mesh | None:
    """Return the mesh of exactly this body that ships with the program, None if there is none."""
    key = Sizing.of(body, level).mesh_key(body)
    found = (_matching(path, key) for path in sorted(MESHES.glob(f"*.{level}.npz")))
    return next((mesh for mesh in found if mesh is not None), None)


ALL_ALIKE = 2.4
"""Limits of shape of a stretched mesh over those of a new one: all of its elements are flattened
alike."""


def _stretched(body: Body, level: Level, paths: Iterable[Path]) -> Mesh | None:
    """Return a mesh of this level and of a body of this shape, stretched to this one, if it passes
    the quality gates. A block is any other block stretched along its axes; other shapes must be
    scaled copies."""
    for path in sorted(paths):
        mesh, provenance = Mesh.load(path)
        if provenance.get("level", level) != level:
            continue
        ratio = _ratio(identity(provenance["body"]), identity(body.geometry()))
        if ratio is not None:
            made = replace(mesh, points=frozen(mesh.points * ratio))
            if not Quality.of(made, body).failures(stricter=ALL_ALIKE):
                return made
    return None


def _ratio(one: dict[str, Any], other: dict[str, Any]) -> Points | None:
    """Return (3,) by what the first geometry must be stretched along x, y and z to be the other,
    None if it can't."""
    lengths = [key for key in one if key.endswith("_mm") and isinstance(one[key], int | float)]
    if set(one) != set(other) or any(one[key] != other[key] for key in one if key not in lengths):
        return None
    ratio = np.array([other[key] / one[key] for key in lengths])
    if one["shape"] != "block":
        return np.full(3, ratio[0]) if np.allclose(ratio, ratio[0], rtol=1e-9) else None
    by_key = dict(zip(lengths, ratio, strict=True))
    return np.array([by_key["width_mm"], by_key["length_mm"], by_key["thickness_mm"]])


def _matching(path: Path, key: str) -> Mesh | None:
    """Return the mesh in ``path`` if it is whole and made for ``key``; a broken cache entry counts
    as absent."""
    if not path.exists():
        return None
    try:
        mesh, provenance = Mesh.load(path)
    except InputError:
        return None
    return mesh if provenance.get("key") == key else None


WITHIN = 0.0125
"""Tolerance of fewer triangles over the finest wanted edge: a quarter of the mesher's own envelope
(`_ENVELOPE`)."""

FEWEST_TRIANGLES = 500
REGULARISATION = 1e-4


def fewer(vertices: Points, triangles: Ints, within_mm: float) -> tuple[Points, Ints]:
    """Return the coarsest closed surface, ``vertices`` (n, 3) and ``triangles`` (m, 3), that is
    nowhere farther than ``within_mm`` from the given one, at the corners of either; the given one
    if none is found.

    Edges are contracted in the order of the quadric error that this makes (M. Garland and P. S.
    Heckbert 1997), by VTK's filter with its regularisation, without which plane faces take minutes.
    The mesher takes 81 s for 25,000 triangles of a pad, and 4 s for 800.
    """
    import pyvista
    from vtkmodules.vtkFiltersCore import vtkQuadricDecimation

    given = pyvista.PolyData.from_regular_faces(vertices, triangles)
    tree = TriangleTree(vertices[triangles])
    count = FEWEST_TRIANGLES
    while count < len(triangles):
        contract = vtkQuadricDecimation()
        contract.SetInputData(given)
        contract.SetTargetReduction(1.0 - count / len(triangles))
        contract.SetRegularize(True)
        contract.SetRegularization(REGULARISATION)
        contract.Update()
        made = pyvista.wrap(contract.GetOutput())
        corners, faces = (
            np.asarray(made.points, np.float64),
            np.asarray(made.regular_faces, np.int64),
        )
        if open_edges(faces) == 0:
            there = np.linalg.norm(
                TriangleTree(corners[faces]).nearest(vertices)[1] - vertices, axis=1
            ).max()
            back = np.linalg.norm(tree.nearest(corners)[1] - corners, axis=1).max()
            if max(there, back) <= within_mm:
                return corners, faces
        count *= 2
    return vertices, triangles


def outer_surface(body: Body, spacing_mm: float) -> tuple[Points, Ints]:
    """Return vertices (n, 3), mm, and outward triangles (m, 3) of a body's surface: its own or
    fewer ones within `WITHIN` of the spacing, or the hull of points ``spacing_mm`` apart on it.

    Raises a `MeshError` if these are not closed, or their volume differs by more than 1 % from the
    body's.
    """
    if body.own_surface is not None:
        return fewer(*body.own_surface, WITHIN * spacing_mm)
    import trimesh

    samples = body.surface_samples(spacing_mm)
    near = np.abs(body.piece_distances(samples)) < 2 * spacing_mm
    points = [samples]
    for size in (2, 3):
        for pieces in combinations(range(len(body.pieces)), size):
            candidates = samples[np.all(near[:, pieces], axis=1)]
            on = np.zeros((len(candidates), len(body.pieces)), dtype=bool)
            on[:, pieces] = True
            meeting = body.onto_sheets(candidates, on)
            points.append(meeting[body.contains(meeting, -1e-9)])
    rounded = np.unique(np.round(np.concatenate(points), 9), axis=0)
    hull = trimesh.convex.convex_hull(rounded)
    if not (hull.is_watertight and hull.is_winding_consistent):
        raise MeshError(
            f"the {_body_name(body)}'s surface triangles are not closed; this needs a convex body"
        )
    if abs(hull.volume / body.volume_mm3 - 1) > 0.01:
        raise MeshError(
            f"the convex hull of the {_body_name(body)}'s surface holds {hull.volume:.6g} mm3, the "
            f"body {body.volume_mm3:.6g} mm3 (allowed: 1 % apart); only convex bodies can be meshed"
        )
    return np.asarray(hull.vertices, np.float64), np.asarray(hull.faces, np.int64)


def _body_name(body: Body) -> str:
    """Return the body's kind in words, for messages."""
    return type(body).__name__.lower()


LIMIT_S, LIMIT_UNKNOWNS = 60.0, 28000
"""Processor time of all tries for a mesh of so many unknowns, s; larger meshes may take more, in
proportion."""

START_UNKNOWNS = 4000
"""Unknowns of the mesher's own mesh, about: it is the slow step, and only has to be near."""

SAME_START, MOST_TRIES = 8, 30
"""Tries from one mesh of the mesher's, and tries in all."""

RIDGE_DEG, _BELOW_CREASES = 40.0, 0.8
"""Angle between faces at which an edge of the mesher's mesh is kept, and how far that is below the
flattest edge between pieces: the mesher rounds edges a little."""

SPARE = 1.5
"""A sound mesh of so many times more or fewer unknowns than wanted is taken rather than none."""

FINER = 1.05
"""After a try of the right size that fails the gates, so many times as many unknowns are aimed at:
fillets need elements that are not much wider."""

_FEWEST, _MOST = 0.8, 1.25
"""Allowed range of the number of unknowns over the wanted one."""

_POWER = 2.3
"""The number of unknowns falls about with this power of the edge lengths; too high a power only
converges slower."""

_ENVELOPE = 0.05
"""How far the raw surface may stray, in finest wanted edges: snapping mends it, and half of it
gives the finger half as many unknowns again."""


def build_mesh(
    body: Body, sizing: Sizing, *, progress: Progress | None = None
) -> tuple[Mesh, Quality]:
    """Make a mesh of a body with the proportions and about the number of unknowns of a sizing.

    Raises
    ------
    MeshError
        If no try passes the gates with about the wanted number of unknowns: cause, place and
        remedy.
    """
    if isinstance(body, Block):
        mesh = block_mesh(body, sizing)
        return mesh, Quality.of(mesh, body)
    _refuse_sharp(body)
    allowed_s = LIMIT_S * max(1.0, sizing.unknowns / LIMIT_UNKNOWNS)
    end_s = _spent_s() + allowed_s
    tries = _Tries(body, sizing)
    for number in range(MOST_TRIES):
        left_s = end_s - _spent_s()
        if tries.failures and left_s < 1.0:
            break
        found = tries.next(number, max(left_s, 1.0), progress)
        if found is not None:
            return found
    if tries.spare:  # sound, but of another size than wanted
        return min(tries.spare, key=lambda pair: abs(math.log(pair[1].unknowns / sizing.unknowns)))
    raise MeshError(
        f"none of {len(tries.failures)} meshes of the {_body_name(body)} passed the gates within "
        f"{allowed_s:.0f} s of processor time, the last one: {tries.failures[-1]}; the place to "
        f"look at is ({tries.place}) mm: take out what is thin, narrow or pointed there (walls, "
        "slits, steps, needles much smaller than the body), or draw it larger"
    )


class _Tries:
    """Meshes of one body at one scale of all lengths after another.

    Attributes
    ----------
    failures
        What each try lacked so far.
    place
        Where to look after the last one, mm.
    spare
        Sound meshes of another size than wanted.
    """

    def __init__(self, body: Body, sizing: Sizing) -> None:
        self.failures: list[str] = []
        self.place = ""
        self.spare: list[tuple[Mesh, Quality]] = []
        self._body = body
        self._sizing = sizing
        self._finest_mm = min(sizing.fine_mm, sizing.rim_mm)
        self._surface = outer_surface(body, self._finest_mm)
        self._wanted = WantedEdge(body, sizing)
        self._ridge_deg = _ridge_deg(body)
        self._start: tuple[Points, Ints] | None = None
        self._scale = 1.0
        self._aim = float(sizing.unknowns)
        self._sizes: list[tuple[float, float]] = []

    def next(
        self, number: int, left_s: float, progress: Progress | None
    ) -> tuple[Mesh, Quality] | None:
        """Return the mesh of try ``number`` if it is sound and of the wanted size; else keep what
        it lacks, and set the next scale."""
        try:
            mesh = self._made(number, left_s)
        except MeshError as problem:
            self.failures.append(str(problem))
            self.place = _narrowest(*self._surface)
            return None
        measured = Quality.of(mesh, self._body)
        ratio = measured.unknowns / self._aim
        faults = self._faults(mesh, measured, ratio)
        if progress:
            verdict = (
                "; ".join(faults) or f"good, smallest angle {measured.least_dihedral_deg:.1f} deg"
            )
            progress(
                f"mesh of the {_body_name(self._body)}, try {number + 1}: {measured.unknowns} "
                f"unknowns, {verdict}",
                0.0 if faults else 1.0,
            )
        if not faults:
            return mesh, measured
        self.failures.append("; ".join(faults))
        self.place = coordinates(_worst_place(mesh, crowded=ratio > _MOST))
        return None

    def _made(self, number: int, left_s: float) -> Mesh:
        """Return the mesher's mesh, remade in the wanted sizes and snapped to the surface."""
        # The mesher is slow: several tries begin with one mesh of its own.
        if self._start is None or number % SAME_START == 0:
            self._start = _start(self._body, self._sizing, self._surface, left_s, number)
        edge_mm = self._scale * self._wanted(self._start[0])
        within_mm = _ENVELOPE * self._scale * self._finest_mm
        return snapped_mesh(
            self._body, *remeshed(*self._start, edge_mm, within_mm, self._ridge_deg)
        )

    def _faults(self, mesh: Mesh, measured: Quality, ratio: float) -> list[str]:
        """Return what a mesh of ``ratio`` times the unknowns aimed at lacks; set the next scale."""
        faults = measured.failures()
        if not faults and 1 / SPARE <= measured.unknowns / self._sizing.unknowns <= SPARE:
            self.spare.append((mesh, measured))
        if not _FEWEST <= ratio <= _MOST:
            # Of another size: the next scale follows from the sizes found so far.
            faults = [f"{measured.unknowns} unknowns (wanted: {self._aim:.0f})", *faults]
            self._sizes.append((self._scale, ratio))
            self._scale = _next_scale(self._sizes)
        elif faults:
            # Of the right size, but not sound: a little finer.
            self._aim *= FINER
            self._scale *= FINER ** (-1 / _POWER)
            self._sizes.clear()
        return faults


def _worst_place(mesh: Mesh, *, crowded: bool) -> Points:
    """Return (3,) the middle of the element with the smallest dihedral angle, or of the smallest
    one, mm."""
    tets = mesh.tets[:, :4]
    figure = (
        signed_volumes(mesh.points, tets)
        if crowded
        else Quality.dihedral_angles(mesh.points, tets).min(axis=1)
    )
    return np.asarray(mesh.points[tets[np.argmin(figure)]].mean(axis=0))


def _spent_s() -> float:
    """Return the processor time of this process and its children that have ended, s."""
    return sum(os.times()[:4])


SHARPEST_DEG = 12.0
"""Least angle of a wedge: elements there have no larger one, and good ones need a part of it."""


def _refuse_sharp(body: Body) -> None:
    """Refuse at once a wedge so sharp that no element in it can pass the gates."""
    if body.own_surface is None:
        return
    angles, ends = Pieces.edge_angles(*body.own_surface)
    worst = np.unravel_index(np.argmin(angles), angles.shape)
    angle, place = angles[worst], ends[worst].mean(axis=0)
    if angle < SHARPEST_DEG:
        raise MeshError(
            f"the surface of the {_body_name(body)} has an edge of {angle:.3g} deg at "
            f"({coordinates(place)}) mm, and none below {SHARPEST_DEG:g} deg is meshed: "
            "blunt the edge, or cut the body there"
        )


def _ridge_deg(body: Body) -> float:
    """Return the angle between faces at which an edge is kept as the mesh is improved: below that
    of each edge at which pieces of the body end."""
    if body.own_surface is None:
        return RIDGE_DEG
    turned = np.abs(180.0 - Pieces.edge_angles(*body.own_surface)[0])
    creases = turned[turned >= CREASE_DEG]
    return min(RIDGE_DEG, _BELOW_CREASES * float(creases.min(initial=180.0)))


def _narrowest(vertices: Points, triangles: Ints) -> str:
    """Return where the surface's triangles are narrowest: there its features are smallest."""
    corners = vertices[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    return coordinates(corners[np.argmin(area / sides.max(axis=1))].mean(axis=0))


def _next_scale(tried: list[tuple[float, float]]) -> float:
    """Return the scale to try next, from scales and the unknowns they gave over the wanted ones: by
    a power law, then between the best too fine scale and the best too coarse one."""
    over, under = [t for t in tried if t[1] > 1], [t for t in tried if t[1] <= 1]
    if not over or not under:
        scale, ratio = tried[-1]
        return float(scale * ratio ** (1 / _POWER))
    (one, above), (other, below) = min(over, key=lambda t: t[1]), max(under, key=lambda t: t[1])
    share = math.log(above) / (math.log(above) - math.log(below))
    return math.exp((1 - share) * math.log(one) + share * math.log(other))


def _start(
    body: Body, sizing: Sizing, surface: tuple[Points, Ints], processor_s: float, seed: int
) -> tuple[Points, Ints]:
    """Return a mesh (n, 3) mm and (m, 4) near the body's surface, made in so much processor
    time; another ``seed`` gives another one."""
    coarser = (sizing.unknowns / START_UNKNOWNS) ** (1 / _POWER)
    sizing = sizing.scaled(max(1.0, coarser))
    points, tets, edge_mm = WantedEdge(body, sizing).background()
    diagonal = float(np.linalg.norm(np.ptp(np.array(body.bounds_mm), axis=0)))
    request = Request(
        vertices=surface[0],
        triangles=surface[1],
        background_points=points,
        background_tets=tets,
        background_edge_mm=edge_mm,
        coarse_mm=sizing.coarse_mm,
        envelope=_ENVELOPE * min(sizing.fine_mm, sizing.rim_mm) / diagonal,
    )
    return request.solve(processor_s=processor_s, seed=seed)
