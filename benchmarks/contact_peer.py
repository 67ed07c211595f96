"""Presses that aren't Hertz's, against tamaas, an independent code of contact on a half-space.

tamaas (2.9, from PyPI, AGPL-3.0) runs in a process of its own (`benchmarks/contact_tamaas.py`), by the interpreter
that the environment variable TAMAAS_PYTHON names: ``python -m venv V && V/bin/pip install tamaas``. Both are given the
same rigid profile and total force. The truth is tamaas on a grid of 512 x 512.

Seconds are medians of a warm process's runs, each from a probe to its pressures, indentation, force and torques; twin
also finds where the contact is and how large (tamaas is given a square that fits it), and area, energy and validity.
Why so many runs: of nine that take a fifth of a millisecond each, most are still warming up.
"""

import os
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.clock import median_cpu_s
from benchmarks.flat import BLOCK, HalfSpace
from benchmarks.pages import PEER, SAID
from twin.arrays import Floats
from twin.parts.load import Rectangles
from twin.parts.material import plane_strain_modulus
from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere
from twin.world.contact.pressing import ContactState, press

SCRIPT = Path(__file__).with_name("contact_tamaas.py")
NU, FAR_MM = 0.5, 5.0
GRIDS, TRUTH, ACROSS = (8, 12, 16, 24, 32, 64, 128), 512, (6, 8, 10, 14, 20, 28, 40)
QUICK_GRIDS, QUICK_TRUTH, QUICK_ACROSS = (32, 64), 128, (10, 14)
RUNS, ENOUGH_S = 199, 1.0
"""Runs at most whose median is taken, and seconds after which there are enough."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A profile and a force: as a press, and as heights (n, n) in mm over (n, n) places x and y."""

    name: str
    press: Press
    height: Callable[[Floats, Floats], Floats]
    side_mm: float
    force_n: float


def _ball(x: Floats, y: Floats, radius: float) -> Floats:
    return np.asarray(radius - np.sqrt(np.maximum(radius**2 - x**2 - y**2, 0.0)))


def _rim(out: Floats, edge: float) -> Floats:
    """Return the height of a rounded rim at places ``out`` mm beyond where the flat face ends."""
    return np.where(out < edge, edge - np.sqrt(np.maximum(edge**2 - np.maximum(out, 0.0) ** 2, 0.0)), FAR_MM)


def _beside(x: Floats, y: Floats, half: float) -> Floats:
    return np.hypot(np.maximum(np.abs(x) - half, 0.0), np.maximum(np.abs(y) - half, 0.0))


SLOPE = float(np.tan(np.radians(15.0)))
CASES = (
    Case(
        name="cone of 150 degrees", press=Press(probe=Cone(apex_deg=150, diameter_mm=8), force_n=(0, 0, 0.5)),
        height=lambda x, y: np.hypot(x, y) * SLOPE, side_mm=2.3, force_n=0.5,
    ),
    Case(
        name="two balls of 2.2 mm, 2.4 mm apart", press=Press(
            probe=Sphere(diameter_mm=2.2), at_mm=(-1.2, 0), force_n=(0, 0, 0.1),
            also=(Press(probe=Sphere(diameter_mm=2.2), at_mm=(1.2, 0), force_n=(0, 0, 0.1)),),
        ),
        height=lambda x, y: np.minimum(_ball(x + 1.2, y, 1.1), _ball(x - 1.2, y, 1.1)), side_mm=3.4, force_n=0.2,
    ),
    Case(
        name="cylinder of 4 mm, rim of 0.5 mm",
        press=Press(probe=Cylinder(diameter_mm=4, edge_mm=0.5), force_n=(0, 0, 1)),
        height=lambda x, y: _rim(np.hypot(x, y) - 1.5, 0.5), side_mm=4.0, force_n=1.0,
    ),
    Case(
        name="pillar of 4 mm, rim of 0.5 mm", press=Press(probe=Pillar(width_mm=4, edge_mm=0.5), force_n=(0, 0, 1)),
        height=lambda x, y: _rim(_beside(x, y, 1.5), 0.5), side_mm=4.0, force_n=1.0,
    ),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Found:
    """What is compared: indentation, mm; pressure's mean weighted with itself, MPa; CPU seconds, s."""

    indentation_mm: float
    pressure_mpa: float
    cpu_s: float


def peer_rows(quick: bool) -> list[dict[str, Any]]:
    """Return the rows of both programs; one that says so where there is no tamaas."""
    python = os.environ.get("TAMAAS_PYTHON")
    if not python:
        return [{"what": SAID, "remark": "set TAMAAS_PYTHON to an interpreter that has tamaas"}]
    rows = []
    for case in CASES[:1] if quick else CASES:
        truth = tamaas(python, case, QUICK_TRUTH if quick else TRUTH)
        ours(case, 10)
        grids, across = (QUICK_GRIDS, QUICK_ACROSS) if quick else (GRIDS, ACROSS)
        for program, sizes in (("tamaas", grids), ("twin", across)):
            for size in sizes:
                found = tamaas(python, case, size) if program == "tamaas" else ours(case, size)
                error = abs(found.indentation_mm / truth.indentation_mm - 1)
                rows.append(
                    {"what": PEER, "case": case.name, "program": program, "cells": size, "cpu_s": found.cpu_s,
                     "indentation error": error,
                     "pressure error": abs(found.pressure_mpa / truth.pressure_mpa - 1)}
                )  # fmt: skip
    return rows


def tamaas(python: str, case: Case, cells: int) -> Found:
    """Return tamaas's answer on a grid of cells x cells."""

    def profile() -> Floats:
        middles = (np.arange(cells) + 0.5) / cells * case.side_mm - case.side_mm / 2
        return case.height(*np.meshgrid(middles, middles, indexing="ij"))

    height, profile_s = profile(), median_cpu_s(profile, RUNS, ENOUGH_S)
    with tempfile.TemporaryDirectory() as folder:
        given, got = Path(folder, "given.npz"), Path(folder, "got.npz")
        np.savez(
            given, height=height, side=case.side_mm, modulus=plane_strain_modulus(1.0, NU), force=case.force_n,
            tolerance=1e-9,
        )  # fmt: skip
        subprocess.run([python, str(SCRIPT), str(given), str(got)], check=True)
        answer = np.load(got)
        pressure = answer["pressure"]
        weighted = float((pressure**2).sum() / pressure.sum())
        return Found(
            indentation_mm=float(answer["indentation"]), pressure_mpa=weighted,
            cpu_s=profile_s + float(answer["cpu_s"]),
        )  # fmt: skip


def ours(case: Case, across: int) -> Found:
    """Return this program's answer."""

    def pressed() -> ContactState:
        return press(case.press, BLOCK, HalfSpace(NU), patches_across=across, youngs_modulus_mpa=1.0, poisson_ratio=NU)

    state = pressed()
    seconds = median_cpu_s(pressed, RUNS, ENOUGH_S)
    terms = [term for term in state.load.terms if isinstance(term, Rectangles)]
    force = np.concatenate([term.force_n[:, 2] for term in terms])
    area = np.concatenate([4.0 * np.prod(term.half_mm, axis=1) for term in terms])
    weighted = float((force**2 / area).sum() / force.sum())
    return Found(indentation_mm=state.indentation_mm, pressure_mpa=weighted, cpu_s=seconds)
