"""Elasticity: error against converged solutions of an independent program, beside seconds and unknowns.

The first press of a method pays for everything (mesh, factor), the others for their own load only.
"""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np

from twin.parts.body import Block, Body, Finger
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.places import ROOT
from twin.world.compliance import Compliance, Method
from twin.world.mesh import Level
from twin.world.tile import tile

BODIES: dict[str, Body] = {
    "block": Block(width_mm=100, length_mm=90, thickness_mm=40),
    "finger": Finger(radius_mm=8, barrel_mm=8, skirt_mm=2),
}
WAYS: dict[str, tuple[Method, Level, bool]] = {
    "table, truth": ("subtracted", "standard", True),
    "table, nominal": ("subtracted", "nominal", True),
    "subtracted, truth": ("subtracted", "standard", False),
    "subtracted, nominal": ("subtracted", "nominal", False),
    "direct, truth": ("direct", "standard", False),
    "direct, nominal": ("direct", "nominal", False),
}
"""Names of the ways, each with its method, its mesh, and whether the shipped table is used; only the block has one."""


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row a case and method; the quick form takes three cases of each body."""
    rows = []
    for name, body in BODIES.items():
        with np.load(ROOT / "tests" / "reference" / f"{name}.npz") as file:
            data = {key: file[key] for key in file.files}
        cases = json.loads(str(data["cases"]))
        for way, (method, level, table) in WAYS.items():
            if (table and name != "block") or (quick and method == "direct"):
                continue
            made: dict[float, Compliance] = {}
            for case in cases[:3] if quick else cases:
                start = time.perf_counter()
                nu = case["nu"]
                first = nu not in made
                if first:
                    material = Material(youngs_modulus_mpa=0.5, poisson_ratio=nu)
                    made[nu] = Compliance(body, material, level=level, method=method, table=table)
                words = dict(case["load"])
                load = tile(getattr(Traction, words.pop("kind"))(**words), body)
                moved = made[nu].displacement(data["points"], load)
                seconds = time.perf_counter() - start
                wrong = np.linalg.norm(moved - data[case["key"]], axis=1).max()
                rows.append(
                    {
                        "case": f"{name} {case['key']}",
                        "method": way + (", first press" if first else ""),
                        "unknowns": 0 if table else made[nu].mesh.unknowns,
                        "seconds": seconds,
                        "error": float(wrong / np.linalg.norm(data[case["key"]], axis=1).max()),
                    }
                )
    return rows
