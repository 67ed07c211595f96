"""Making the tables of `twin.world.elasticity.table`, storing them, and finding the one of a body.

w is solved for unit forces at Chebyshev places of the window, at Chebyshev nu, and read at Chebyshev points of the box.
Window, places and box are symmetric, so the forces of one quarter do: the others are mirrored, and twelve solves of
thirty are saved twice over. A block's tables are made when a contact on it asks for many compliances, and kept in the
cache; the standard block's are shipped. ``python -m twin.world.elasticity.tabulate`` makes the shipped ones anew.

A table comes in three roles: ``truth``; ``check``, from a coarser mesh, whose difference from it estimates its error;
and ``nominal``, the sensor's own.
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from twin.archive import read_arrays
from twin.arrays import Bools, Floats, Points, frozen
from twin.errors import InputError, TwinError
from twin.parts.body import Block, Body
from twin.parts.load import Rectangles
from twin.places import MESHES, cache_folder, is_pinned, pinned
from twin.progress import Progress
from twin.results import write_whole
from twin.theory import halfspace
from twin.world.elasticity.correction import correction
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.solve import Solver
from twin.world.elasticity.table import NU_RANGE, SIZES, Basis, Table
from twin.world.mesh.body_mesh import body_mesh, mesh_key
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.rim import SHARE, drawn_to_rim
from twin.world.mesh.sizing import Level, default_sizing

Role = Literal["truth", "check", "nominal"]
ROLES: tuple[Role, ...] = ("truth", "check", "nominal")

STANDARD = Block(width_mm=100, length_mm=90, thickness_mm=40)
SHIPPED: dict[Role, Level] = {"truth": "fine", "check": "standard", "nominal": "nominal"}
"""The meshes of the shipped tables."""

MADE: dict[Role, Level] = {"truth": "coarse", "check": "sketch", "nominal": "nominal"}
"""The meshes of other blocks' tables."""

WINDOW, BOX = (0.4, 0.4), (0.48, 0.45, 0.25)
"""Half window over half the block's width and length; half box over the same, and depth over thickness."""

STEP = 2e-6
"""Coefficients are stored as whole numbers of steps, this share of the largest: displacements are then 4e-6 off."""

USABLE = 5e-4
"""Largest `Table.error` with which a table is used: thin blocks need more polynomials than it has."""

CHECK = 4.0
"""How many times larger it may be in a check, which only tells an error: that of a coarser mesh is rougher."""

_CASE = ((0.37, -0.59), (0.31, 0.47, 1.0))
"""A load that no table is made of: its place in the window, and its force."""


def window_of(body: Block) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Return half sizes of the window, and half sizes and depth of the box, mm."""
    a, b = body.width_mm / 2.0, body.length_mm / 2.0
    return (WINDOW[0] * a, WINDOW[1] * b), (BOX[0] * a, BOX[1] * b, BOX[2] * body.thickness_mm)


def find_table(
    body: Body, role: Role, *, make: bool = False, solver: Solver = "auto", progress: Progress | None = None,
    usable: float = USABLE,
) -> Table | None:  # fmt: skip
    """Return the shipped table of this body, else the cached one, else (if wanted) a new one, else None.

    Warns, and goes on without it, if a file is damaged; a table that would be too inaccurate counts as absent.

    Parameters
    ----------
    body
        Only blocks have tables.
    role
        See the module.
    make
        Whether to make, and cache, a table that is not there: some seconds.
    solver
        For making.
    progress
        Told about the making.
    usable
        Largest `Table.error` with which it counts as there.
    """
    if not isinstance(body, Block):
        return None
    usable *= CHECK if role == "check" else 1.0
    standard = _size(body) == _size(STANDARD)
    path = shipped_path(role) if standard else cached_path(body, role)
    if is_pinned():
        return _usable(held, usable) if (held := pinned(path.name)) else None
    if standard:
        return _usable(path, usable)
    if make and not path.exists():
        mesh = drawn_to_rim(body_mesh(body, MADE[role], progress=progress), body)
        table = make_table(body, mesh, solver, progress)
        with suppress(TwinError):  # a full disk costs the table, for which solves stand in
            write_table(table, path)
    return _usable(path, usable)


def table_level(body: Body, role: Role) -> Level:
    """Return which mesh the table of this body is made of."""
    return SHIPPED[role] if isinstance(body, Block) and _size(body) == _size(STANDARD) else MADE[role]


def shipped_path(role: Role) -> Path:
    """Return where the shipped table of the standard block is."""
    return MESHES / f"kamiyama_block.{role}.table.npz"


def cached_path(body: Block, role: Role) -> Path:
    """Return where the table of another block is kept."""
    key = mesh_key(body, default_sizing(body, MADE[role]))
    told = json.dumps([key, SHARE, SIZES, NU_RANGE, WINDOW, BOX, STEP])
    return cache_folder() / f"table-{hashlib.sha256(told.encode()).hexdigest()[:32]}.npz"


def _size(body: Block) -> tuple[float, float, float]:
    return body.width_mm, body.length_mm, body.thickness_mm


def _usable(path: Path, most: float) -> Table | None:
    if not path.exists():
        return None
    try:
        table = read_table(path)
    except InputError as problem:  # the table only saves time, so a damaged one must not stop a run
        warnings.warn(f"{problem}; solving without the table, which takes a few seconds longer", stacklevel=2)
        return None
    return table if table.error <= most else None


def make_table(body: Block, mesh: Mesh, solver: Solver = "auto", progress: Progress | None = None) -> Table:
    """Solve for all forces and nu of a block's table, and measure its error under a load that it is not made of."""
    window, box = window_of(body)
    places = [w * chebpts1(size) for w, size in zip(window, SIZES[1:3], strict=True)]
    quarter = [place[place > -1e-12] for place in places]
    loads = [_point_force(body, x, y) for x in quarter[0] for y in quarter[1]]
    at = [half * chebpts1(size) for half, size in zip(box, SIZES[3:], strict=True)]
    at[2] = (at[2] + box[2]) / 2.0
    points = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1).reshape(-1, 3)
    matrix = Locator(mesh).locate(points).matrix(len(mesh.points))
    samples = np.empty((SIZES[0], SIZES[1], SIZES[2], 3, 3, *SIZES[3:]))
    low, high = NU_RANGE
    for n, nu in enumerate((low + high + (high - low) * chebpts1(SIZES[0])) / 2.0):
        if progress:
            progress(f"table of the block's response, nu = {nu:.2f}", n / SIZES[0])
        system = TaylorHood(mesh, float(nu), solver)
        fields = correction(system, body, loads, [np.eye(3)[None]] * len(loads), 1e-7)
        values = (matrix @ fields.reshape(len(fields), -1)).reshape(*SIZES[3:], 3, len(quarter[0]), len(quarter[1]), 3)
        samples[n] = _mirrored(np.transpose(values, (4, 5, 6, 3, 0, 1, 2)))
    for axis, size in zip((0, 1, 2, 5, 6, 7), SIZES, strict=True):
        inverse = np.linalg.inv(chebvander(chebpts1(size), size - 1))
        samples = np.moveaxis(np.tensordot(inverse, samples, axes=(1, axis)), 0, axis)
    coefficients = np.where(_kept(), samples, 0.0)
    table = Table(coefficients=coefficients, window_mm=window, box_mm=box, digest=mesh.digest(), error=0.0)
    return Table(**{**vars(table), "error": _error(table, body, system)})


def _mirrored(quarter: Floats) -> Floats:
    """Return (x', y', force, displacement, x, y, z) for all places of the force from those with x', y' >= 0.

    The field of a mirrored force is the mirrored field: components across the mirror change sign, of force and field.
    """
    whole = quarter
    for axis, size in ((0, SIZES[1]), (1, SIZES[2])):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        other = np.flip(whole, axis=4 + axis) * sign[:, None, None, None, None] * sign[:, None, None, None]
        other = np.flip(other, axis=axis)
        keep = size - whole.shape[axis]
        whole = np.concatenate([np.take(other, range(keep), axis=axis), whole], axis=axis)
    return whole


def _kept() -> Bools:
    """Return which coefficients the two mirror planes allow."""
    n, a, b, f, d, i, j, _ = np.ogrid[tuple(slice(s) for s in (*SIZES[:3], 3, 3, *SIZES[3:]))]
    even_x = (a + i + (f == 0) + (d == 0)) % 2 == 0
    even_y = (b + j + (f == 1) + (d == 1)) % 2 == 0
    return np.broadcast_to(even_x & even_y & (n >= 0), (*SIZES[:3], 3, 3, *SIZES[3:]))


def _error(table: Table, body: Block, system: TaylorHood) -> float:
    (x, y), force = _CASE
    nu = system.poisson_ratio
    load = _point_force(body, x * table.window_mm[0], y * table.window_mm[1], force, table.box_mm[2] / 4.0)
    share = np.random.default_rng(1).uniform([-1.0, -1.0, 0.05], 1.0, (200, 3))
    points = share * np.array(table.box_mm)
    solved = Locator(system.mesh).locate(points).values(correction(system, body, [load])[:, :, 0])
    at_nu = table.at(nu)
    wrong = np.linalg.norm(at_nu.displacement(Basis(points=points, box_mm=table.box_mm), load) - solved, axis=1).max()
    moved = halfspace.displacement(points, load, 1.0, nu) + solved
    return float(wrong / np.linalg.norm(moved, axis=1).max())


def _point_force(
    body: Body, x: float, y: float, force: tuple[float, float, float] = (0.0, 0.0, 0.0), half_mm: float = 0.0
) -> Rectangles:
    centre: Points = body.surface_from_above(np.array([[x, y]]))
    return Rectangles(
        centre_mm=centre,
        frames=np.array(body.frames(centre)),
        half_mm=np.full((1, 2), half_mm),
        force_n=np.array([force]),
    )


def write_table(table: Table, path: Path) -> None:
    """Write the coefficients that symmetry allows, in steps, and what they are made of.

    Why byte by byte: nearly all of the steps are few, so their upper bytes are zeros, which compress to nothing.
    """
    allowed = table.coefficients[_kept()]
    step = STEP * float(np.abs(allowed).max())
    steps = np.rint(allowed / step).astype(np.int32)
    folded = ((steps << 1) ^ (steps >> 31)).astype("<u4")
    words = json.dumps(
        {
            "digest": table.digest,
            "sizes": SIZES,
            "nu_range": NU_RANGE,
            "window_mm": table.window_mm,
            "box_mm": table.box_mm,
            "error": table.error,
            "step": step,
        }
    )
    planes = np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 4).T)
    write_whole(path, lambda file: np.savez_compressed(file, planes=planes, words=np.array(words)))


def read_table(path: Path) -> Table:
    """Read a table.

    Raises
    ------
    InputError
        The file is not a table of this program's sizes.
    """
    try:
        file = read_arrays(path, ("words", "planes"))
        words = json.loads(str(file["words"]))
        planes, step = file["planes"], float(words["step"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as problem:
        raise InputError(f"{path} is not a table of the rest ({problem}): make it anew") from problem
    if words.get("sizes") != list(SIZES) or words.get("nu_range") != list(NU_RANGE):
        raise InputError(f"{path} was made for other sizes: make it anew with python -m twin.world.elasticity.tabulate")
    allowed = _kept()
    if planes.shape != (4, np.count_nonzero(allowed)) or planes.dtype != np.uint8 or not np.isfinite(step):
        raise InputError(f"{path} is not a table of the rest (its arrays don't fit together): make it anew")
    folded = np.ascontiguousarray(planes.T).view("<u4").ravel()
    coefficients = np.zeros(allowed.shape)
    coefficients[allowed] = step * ((folded >> 1).astype(np.int64) ^ -(folded & 1).astype(np.int64))
    frozen(coefficients)
    return Table(
        coefficients=coefficients,
        window_mm=tuple(words["window_mm"]),
        box_mm=tuple(words["box_mm"]),
        digest=words["digest"],
        error=words["error"],
    )


def main(roles: list[str]) -> None:
    """Make the shipped tables of the named roles, all if none is named."""
    for role in ROLES:
        if not roles or role in roles:
            mesh = drawn_to_rim(body_mesh(STANDARD, SHIPPED[role]), STANDARD)
            write_table(make_table(STANDARD, mesh), shipped_path(role))
            told = read_table(shipped_path(role))
            print(f"{shipped_path(role)}: {shipped_path(role).stat().st_size} bytes, error {told.error:.1e}")


if __name__ == "__main__":
    main(sys.argv[1:])
