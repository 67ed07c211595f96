"""Elasticity: error against converged solutions of an independent program, beside seconds and unknowns.

Every way of answering on every reference case. The clock starts with the mesh in memory and the load in words. The
first load of a way and Poisson's ratio pays for the factor; a next load, for its own tiles and solve only. Compiled
code is warmed up before, and nothing solved earlier is read from the cache.
"""

import gc
from functools import cache
from typing import Any

from benchmarks.clock import Clock, empty_cache
from benchmarks.reference import BODIES, YOUNGS_MODULUS_MPA, Case, reference
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance, Method
from twin.world.mesh.sizing import WORLD, Level

TABLES: dict[str, Level] = {"table, truth": "standard", "table, nominal": "nominal"}
"""Ways of the block without a solve; a truth's table is one and the same for every level."""

LEVELS: tuple[Level, ...] = ("nominal", *WORLD)
QUICK: tuple[Level, ...] = ("nominal", "sketch", "coarse")


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a case and way; the quick form takes three cases of each body and leaves out the slow ways."""
    rows = []
    for body in BODIES:
        ways: list[tuple[str, Method, Level, bool]] = []
        if body == "block":
            ways += [(name, "subtracted", level, True) for name, level in TABLES.items()]
        ways += [(f"subtracted, {level}", "subtracted", level, False) for level in (QUICK if quick else LEVELS)]
        if not quick:
            ways += [(f"direct, {level}", "direct", level, False) for level in LEVELS]
        for way in ways:
            warm_up(body, way[1], way[3])
            with empty_cache():
                rows += way_rows(body, *way, quick)
            gc.collect()
    return rows


def way_rows(body: str, way: str, method: Method, level: Level, table: bool, quick: bool) -> list[dict[str, Any]]:
    """Return the rows of one way, one a case."""
    truth, made, rows = reference(body), dict[float, Compliance](), []
    for case in truth.cases[:3] if quick else truth.cases:
        first = case.nu not in made
        if first:
            made[case.nu] = compliance(body, case.nu, method, level, table)
        stiff = made[case.nu]
        clock = Clock()
        load = case.load(BODIES[body])
        moved = stiff.displacement(truth.points, load)
        cost = clock.lap()
        error, at_markers = truth.errors(moved, case.right)
        row = {"body": body, "case": case.key, "way": way, "unknowns": 0 if table else stiff.mesh.unknowns}
        row |= {"load": "first" if first else "next", "wall_s": cost.wall, "cpu_s": cost.cpu}
        row |= {"error": error, "marker_error": at_markers}
        if method == "subtracted":
            row["estimate"] = stiff.answer(truth.points, load)[1]
        rows.append(row)
    return rows


def compliance(body: str, nu: float, method: Method, level: Level, table: bool) -> Compliance:
    """Return a new compliance with its mesh, or its table, in memory and nothing solved."""
    material = Material(youngs_modulus_mpa=YOUNGS_MODULUS_MPA, poisson_ratio=nu)
    made = Compliance(BODIES[body], material, level=level, method=method, table=table)
    if not table:
        _ = made.mesh
    return made


@cache
def warm_up(body: str, method: Method, table: bool) -> None:
    """Answer once and forget it: compiled code and libraries are loaded afterwards."""
    case: Case = reference(body).cases[-1]
    with empty_cache():
        stiff = compliance(body, case.nu, method, "standard" if table else "sketch", table)
        stiff.displacement(reference(body).points, case.load(BODIES[body]))
