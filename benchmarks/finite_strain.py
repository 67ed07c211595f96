"""Finite strain against NGSolve: what is left of what linear theory leaves out, and what is stated.

Every frictionless press of tests/reference/*neohooke.json is solved for the places stored there; on a dome, whose mesh
is not one of revolution, in four half planes. NGSolve has a linear displacement of its own, so that the difference of
its two is compared, over its largest linear one; that of the indentation over the linear indentation. The time is that
of the difference and its stated error, from the linear solution of the press.
"""

import gc
import json
import math
import time
from typing import Any

import numpy as np

import twin
from benchmarks import ROOT
from benchmarks.record import Row
from twin.arrays import Floats, Points
from twin.blas_threads import one_thread
from twin.world.contact.body_strain import BodyStrain
from twin.world.contact.round_slab import SlabStrain

FILES = {"block": "neohooke", "dome": "dome_neohooke", "finger": "finger_neohooke"}


@one_thread()
def measure(quick: bool) -> list[Row]:
    """Return one row a press; the quick form has the first one alone."""
    cases = []
    for body, file in FILES.items():
        stored = json.loads((ROOT / "tests" / "reference" / f"{file}.json").read_text())
        usual = {"kind": "sphere", "law": "neo_hookean", "ratios": [], "poisson_ratio": 0.5}
        cases += [(body, {**usual, **stored, **case}) for case in stored["cases"] if "sticks" not in case]
    return [_row(body, case) for body, case in cases[: 1 if quick else None]]


def _row(body: str, case: dict[str, Any]) -> Row:
    gc.collect()  # up to .8 GB of the last press
    size = {key: case[key] for key in ("diameter_mm", "edge_mm", "apex_deg", "tip_mm") if key in case}
    press = twin.Press(probe={"kind": case["kind"], **size}, force_n=(0, 0, case["force_n"]))
    shape = {f"body.{key}": case[key] for key in ("radius_mm", "height_mm", "thickness_mm") if key in case}
    named = " ".join([body, *(f"{value:.3g}" for value in shape.values())])
    if body == "block":  # its area is that of NGSolve's round slab
        side = math.sqrt(math.pi) * shape.pop("body.radius_mm")
        shape |= {"body.width_mm": side, "body.length_mm": side}
    rubber = {"material.youngs_modulus_mpa": 1.0, "material.poisson_ratio": case["poisson_ratio"]}
    sensor = twin.Sensor(twin.load_scene(f"{body}_bare", shape | rubber))
    state = sensor.press(press)
    material = sensor.nominal.material.model_copy(update={"law": case["law"], "law_ratios": tuple(case["ratios"])})
    places, linear, bent = (_around(np.array(case[f"{name}_mm"]), body) for name in ("places", "linear", "strained"))
    begun = time.process_time()
    solve = SlabStrain if SlabStrain.solves(press, sensor.nominal.body, material, state) else BodyStrain
    more = solve(press, sensor.nominal.body, material, state, places)
    stated = more.error
    seconds = time.process_time() - begun
    missed, left, whole = (
        float(np.linalg.norm(one, axis=1).max())
        for one in (bent - linear, more.displacement(places) - (bent - linear), linear)
    )
    sunk = case["indentation_linear_mm"]
    deeper = case["indentation_mm"] / sunk - 1.0
    return {
        "body, mm": named,
        "probe, mm": " ".join([case["kind"], *(f"{value:.3g}" for value in size.values())]),
        "law": " ".join([case["law"].replace("_", "-"), *map(str, case["ratios"])]),
        "nu": case["poisson_ratio"],
        "force, N": case["force_n"],
        "contact, mm": state.contact_radius_mm,
        "linear theory off, %": 100 * missed / whole,
        "left, %": 100 * left / whole,
        "stated, %": 100 * stated.markers,
        "NGSolve off, %": 100 * case["own_error"],
        "indentation: linear theory off, %": 100 * abs(deeper),
        "indentation: left, %": 100 * abs(more.indentation_mm / sunk - deeper),
        "indentation: stated, %": 100 * stated.indentation,
        "CPU s": seconds,
    }


def _around(values: Floats, body: str) -> Points:
    """Return places or displacements (n, 3) of those in a half plane (n, 2)."""
    if values.shape[1] == 3:
        return values
    along, down = values.T
    ways = [(1, 0), (0, 1), (-1, 0), (0, -1)] if body == "dome" else [(1, 0)]
    return np.concatenate([np.column_stack([along * x, along * y, down]) for x, y in ways])
