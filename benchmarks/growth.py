"""Growth: seconds and memory of twin's factor and solve, from ten thousand unknowns to three hundred thousand.

The program's own meshes of both bodies, bisected to more and more unknowns, in its own solver that is always there.
Every size runs in a process of its own, so that its peak memory is its own. Sizes stop where one takes more than three
minutes or 12 GiB, and a row says so.
"""

from __future__ import annotations

import multiprocessing
import resource
from typing import Any

import numpy as np

from benchmarks.clock import Clock
from benchmarks.peers_run import nodal_shares
from benchmarks.reference import BODIES
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.mesh import Mesh
from twin.world.mesh.sizing import WantedEdge, default_sizing

SIZES = (10_000, 30_000, 100_000, 300_000)
QUICK = SIZES[:2]
TRIES = 5
FINER = 4.0
"""Unknowns after halving over those that the sizing foretells, 3.4 to 5.3: halving stops below the wanted edges.
A first guess without it makes a mesh four times too large."""
MOST_S, MOST_GIB = 180.0, 12.0
PATIENCE_S = 900.0
"""A child is given up after that much wall time: a busy machine is slower than its CPU seconds."""


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a body and size."""
    rows = []
    for body in BODIES:
        for size in QUICK if quick else SIZES:
            row = {"body": body} | _apart(body, size)
            rows.append(row)
            if "remark" in row:
                break
    return rows


def _apart(body: str, size: int) -> dict[str, Any]:
    """Return what `measured` says, from a process of its own."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_tell, args=(there, body, size))
    child.start()
    there.close()
    try:
        row = here.recv() if here.poll(PATIENCE_S) else {"unknowns": size, "remark": f"more than {PATIENCE_S:g} s"}
    except EOFError:
        row = {"unknowns": size, "remark": "out of memory"}
    child.kill()
    child.join()
    if row.get("factor_cpu_s", 0.0) > MOST_S or row.get("peak_gib", 0.0) > MOST_GIB:
        row["remark"] = f"last size: more than {MOST_S:g} s or {MOST_GIB:g} GiB"
    return dict(row)


def _tell(there: Any, body: str, size: int) -> None:
    there.send(measured(body, size))


def measured(body: str, size: int) -> dict[str, Any]:
    """Return unknowns, CPU seconds of assembly, factor and solve, and this process's peak memory above its start."""
    held = BODIES[body].held_pieces
    for mesh in (body_mesh(BODIES[body], "sketch"), mesh_of(body, size)):  # the first loads the compiled code
        force = np.zeros((len(mesh.points), 3, 1))
        force[:, 2, 0] = nodal_shares(body, mesh)
        before, clock = _peak_gib(), Clock()
        system = TaylorHood(mesh, 0.5, "superlu", held=mesh.nodes_on(held))
        factor = system.factor
        factored = clock.lap()
        system.solve(force)
        solved = clock.lap()
    return {
        "unknowns": mesh.unknowns,
        "tetrahedra": len(mesh.tets),
        "factor_cpu_s": factored.cpu,
        "solve_cpu_s": solved.cpu,
        "wall_s": factored.wall + solved.wall,
        "peak_gib": _peak_gib() - before,
        "residual": factor.residual,
    }


def mesh_of(body: str, size: int) -> Mesh:
    """Return a mesh of about ``size`` unknowns, graded like the program's own."""
    shape = BODIES[body]
    sizing, start = default_sizing(shape, "standard"), body_mesh(shape, "sketch")
    wanted, scale = WantedEdge(shape, sizing), (size / (FINER * sizing.unknowns)) ** (-1 / 3)
    for _ in range(TRIES):
        mesh = refined(start, shape, lambda points, scale=scale: scale * wanted(points))
        ratio = mesh.unknowns / size
        if 0.85 < ratio < 1.15:
            break
        scale *= ratio ** (1 / 3)
    return mesh


def _peak_gib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
