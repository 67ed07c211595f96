"""The same loads in other programs: error against time from the ready mesh, beside twin's own rows of the same run.

Two loads of 1 N on each body, along z and along x. Every program gets meshes made for these loads, of several
resolutions, and its best elements and solver; plain linear (P1) and quadratic (P2) displacement have rows of their own,
for they lock as Poisson's ratio nears 1/2. Seconds are from the ready mesh to displacements at the reference's points:
assembly, factor, solve and evaluation; the next load has its own solve and evaluation only. One core, but for the rows
that say otherwise. The median of three runs by CPU time; runs of more than two seconds are not repeated.

A program that is absent gets a row that says so.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

from benchmarks import peers_calculix, peers_ngsolve, peers_skfem
from benchmarks.clock import Clock, empty_cache
from benchmarks.elasticity import compliance, warm_up
from benchmarks.peers_mesh import Edges, curved, netgen_mesh
from benchmarks.peers_run import KEYS, Answers, Problem
from benchmarks.reference import BODIES, reference
from twin.world.mesh.sizing import WORLD, Level

REPEATS, LONG_S = 3, 2.0

MESHES: dict[str, dict[str, Edges]] = {
    "block": {
        "a": Edges(ring=1.3, load=1.3, rim=25, far=25, grading=0.5),
        "b": Edges(ring=0.7, load=2, rim=20, far=20, grading=0.5),
        "c": Edges(ring=0.5, load=1, rim=6, far=20, grading=0.6),
        "d": Edges(ring=1, load=1.3, rim=8, far=20, grading=0.7),
        "e": Edges(ring=0.5, load=1, rim=4, far=20, grading=0.5),
        "f": Edges(ring=0.35, load=0.7, rim=4, far=15, grading=0.4),
        "g": Edges(ring=0.35, load=0.7, rim=4, far=15, grading=0.4, halved=1),
    },
    "finger": {
        "a": Edges(ring=1.2, load=1.2, rim=3, far=5, grading=0.5),
        "b": Edges(ring=0.8, load=1, rim=2, far=4, grading=0.4),
        "c": Edges(ring=0.8, load=1, rim=1, far=4, grading=0.5),
        "d": Edges(ring=0.8, load=1, rim=1.5, far=3, grading=0.4),
        "e": Edges(ring=0.5, load=0.7, rim=1, far=2.5, grading=0.4),
        "f": Edges(ring=0.35, load=0.5, rim=0.7, far=2, grading=0.4),
        "g": Edges(ring=0.35, load=0.5, rim=0.7, far=2, grading=0.4, halved=1),
    },
}
"""Coarse to fine; found by trying some twenty, and kept where an element has its best error for its time. ``g`` is for
linear elements alone."""


@dataclass(frozen=True, kw_only=True)
class Way:
    """A program's element at one Poisson's ratio on some of the meshes; ``quadratic`` if it wants them as `Mesh`."""

    program: str
    element: str
    nu: float
    meshes: str
    solve: Callable[[Any, Problem], Answers]
    order: int = 0


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a program, element and mesh; the quick form takes the coarsest meshes and repeats nothing."""
    rows = []
    for body in BODIES:
        rows += twin_rows(body, quick)
        rows += list(peer_rows(body, quick))
    return rows


def ways() -> list[Way]:
    """Return what is tried of every program that is installed."""
    found = []
    if find_spec("ngsolve"):
        for order, meshes in ((2, "abef"), (3, "abcde"), (4, "abcde")):
            name, solve = f"Taylor-Hood {order}/{order - 1}", partial(peers_ngsolve.answers, order=order, mixed=True)
            found.append(Way(program="NGSolve", element=name, nu=0.5, meshes=meshes, solve=solve, order=order))
            if (cores := os.cpu_count() or 1) > 1 and order > 2:
                name_all, all_cores = f"NGSolve, {cores} cores", partial(solve, cores=cores)
                found.append(Way(program=name_all, element=name, nu=0.5, meshes=meshes, solve=all_cores, order=order))
        for order, meshes in ((1, "aefg"), (2, "aef"), (3, "abcde"), (4, "abcde")):
            alone = partial(peers_ngsolve.answers, order=order, mixed=False)
            for nu in (0.49, 0.4999) if order < 3 else (0.49,):
                found.append(
                    Way(program="NGSolve", element=f"P{order}", nu=nu, meshes=meshes, solve=alone, order=order)
                )
    if find_spec("skfem"):
        both, alone = (partial(peers_skfem.answers, mixed=mixed) for mixed in (True, False))
        found.append(Way(program="scikit-fem", element="Taylor-Hood 2/1", nu=0.5, meshes="aef", solve=both))
        found.append(Way(program="scikit-fem", element="P2", nu=0.49, meshes="aef", solve=alone))
    if peers_calculix.found():
        found.append(Way(program="CalculiX", element="P2 (C3D10)", nu=0.49, meshes="aef", solve=peers_calculix.answers))
    return found


def peer_rows(body: str, quick: bool) -> Iterator[dict[str, Any]]:
    """Yield a row for every way and mesh, and for every program that is absent."""
    present = {"NGSolve": find_spec("ngsolve"), "scikit-fem": find_spec("skfem"), "CalculiX": peers_calculix.found()}
    if not present["NGSolve"]:  # the meshes of all peers are made by its mesher
        yield {"body": body, "program": "other programs", "remark": "not run: NGSolve, whose mesher is used, is absent"}
        return
    for program in [name for name, there in present.items() if not there]:
        yield {"body": body, "program": program, "remark": "not installed"}
    todo = ways()
    for name, edges in MESHES[body].items():
        if quick and name != "a":
            continue
        here = [way for way in todo if name in way.meshes]
        mesh = netgen_mesh(body, edges)
        nodes = None if all(way.order for way in here) else curved(mesh, body)
        for way in here:
            problem = Problem(body=body, nu=way.nu)
            mesh.Curve(max(way.order, 1))
            start = {
                "body": body, "nu": f"{way.nu:g}", "program": way.program, "element": way.element,
                "mesh": f"{name}, {mesh.ne} tetrahedra",
            }  # fmt: skip
            try:
                yield start | measured(problem, partial(way.solve, mesh if way.order else nodes, problem), quick)
            except (subprocess.SubprocessError, MemoryError) as trouble:
                yield start | {"remark": f"failed: {trouble}"}
            gc.collect()


def twin_rows(body: str, quick: bool) -> Iterator[dict[str, Any]]:
    """Yield twin's own rows: every level of mesh, and the block's table."""
    ways: list[tuple[str, Level, bool]] = [("twin", level, False) for level in (WORLD[:2] if quick else WORLD)]
    if body == "block":
        ways.append(("twin, table", "standard", True))
    for program, level, table in ways:
        warm_up(body, "subtracted", level, table)
        for nu in (0.5, 0.49):
            problem = Problem(body=body, nu=nu)
            start = {
                "body": body, "nu": f"{nu:g}", "program": program,
                "element": "table" if table else "half-space + Taylor-Hood 2/1", "mesh": "" if table else level,
            }  # fmt: skip
            yield start | measured(problem, partial(_twin_answers, problem, level, table), quick)
            gc.collect()


def _twin_answers(problem: Problem, level: Level, table: bool) -> Answers:
    truth, body = reference(problem.body), BODIES[problem.body]
    cases = [truth.case(f"{key}_nu{problem.nu:g}") for key in KEYS[problem.body]]
    with empty_cache():
        stiff = compliance(problem.body, problem.nu, "subtracted", level, table)
        clock = Clock()
        first = stiff.displacement(problem.points, cases[0].load(body))
        costs = [clock.lap()]
        second = stiff.displacement(problem.points, cases[1].load(body))
        costs.append(clock.lap())
        unknowns = 0 if table else stiff.mesh.unknowns
    return Answers(unknowns=unknowns, first=costs[0], next=costs[1], moved=(first, second))


def measured(problem: Problem, solve: Callable[[], Answers], quick: bool) -> dict[str, Any]:
    """Return unknowns, costs of the median run, and errors under both loads."""
    runs = [solve()]
    while len(runs) < (1 if quick or runs[0].first.cpu > LONG_S else REPEATS):
        runs.append(solve())
    middle = sorted(runs, key=lambda each: each.first.cpu)[len(runs) // 2]
    errors = [reference(problem.body).errors(moved, problem.right(n)) for n, moved in enumerate(middle.moved)]
    row = {
        "unknowns": middle.unknowns,
        "cpu_s": middle.first.cpu,
        "wall_s": middle.first.wall,
        "next_cpu_s": sorted(each.next.cpu for each in runs)[len(runs) // 2],
        "error_z": errors[0][0],
        "error_x": errors[1][0],
        "marker_error_z": errors[0][1],
        "marker_error_x": errors[1][1],
    }
    print(".", end="", flush=True, file=sys.stderr)
    return row
