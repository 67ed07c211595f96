"""CalculiX on the reference cases: quadratic tetrahedra C3D10, by the command ``ccx``.

As its users would: one deck a load, linear static, its default direct solver (SPOOLES in Debian's package). It has no
element with pressure unknowns, so Poisson's ratio stays below 1/2. Writing the deck is left out of the time, reading it
isn't. Nodal forces are those of the traction on quadratic faces, for its own distributed loads act along the normal.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.clock import Clock, Cost
from benchmarks.peers_run import Answers, Problem, nodal_shares
from twin.arrays import Floats, Points
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.mesh import Mesh

LIMIT_S = 300.0


def found() -> bool:
    """Tell whether CalculiX is installed."""
    return shutil.which("ccx") is not None


def answers(mesh: Mesh, problem: Problem) -> Answers:
    """Solve both loads of a problem, each a run of its own; the clock runs from the written deck."""
    shares = nodal_shares(problem.body, mesh)
    held = np.flatnonzero(mesh.nodes_on([mesh.piece.max()]))
    moved: list[Points] = []
    costs: list[Cost] = []
    with tempfile.TemporaryDirectory(prefix="ccx-") as folder:
        for axis in problem.axes:
            name = Path(folder) / f"load{axis}"
            name.with_suffix(".inp").write_text(_deck(mesh, problem, shares, axis, held))
            clock = Clock()
            subprocess.run(
                ["ccx", name.name], cwd=folder, check=True, capture_output=True, timeout=LIMIT_S,
                env={**os.environ, "OMP_NUM_THREADS": "1", "CCX_NPROC_STIFFNESS": "1"},
            )  # fmt: skip
            nodal = _nodal(name.with_suffix(".dat"), len(mesh.points))
            moved.append(np.asarray(Locator(mesh).locate(problem.points).values(nodal)))
            costs.append(clock.lap())
    return Answers(
        unknowns=3 * (len(mesh.points) - len(held)), first=costs[0], next=costs[1], moved=(moved[0], moved[1])
    )


def _deck(mesh: Mesh, problem: Problem, shares: Floats, axis: int, held: np.ndarray) -> str:
    lines = ["*NODE, NSET=all"]
    lines += [f"{n + 1}, {x:.12g}, {y:.12g}, {z:.12g}" for n, (x, y, z) in enumerate(mesh.points)]
    lines += ["*ELEMENT, TYPE=C3D10, ELSET=body"]
    lines += [", ".join(str(n) for n in (e + 1, *(tet + 1))) for e, tet in enumerate(mesh.tets)]
    lines += ["*NSET, NSET=held", *(f"{n + 1}," for n in held)]
    lines += ["*BOUNDARY", "held, 1, 3", "*MATERIAL, NAME=rubber", "*ELASTIC"]
    lines += [f"{problem.youngs_modulus_mpa}, {problem.nu}", "*SOLID SECTION, ELSET=body, MATERIAL=rubber"]
    lines += ["*STEP", "*STATIC", "*CLOAD"]
    lines += [f"{n + 1}, {axis + 1}, {shares[n]:.12e}" for n in np.flatnonzero(shares)]
    lines += ["*NODE PRINT, NSET=all", "U", "*END STEP", ""]
    return "\n".join(lines)


def _nodal(path: Path, nodes: int) -> Floats:
    """Return the (N, 3) displacements of a result file, mm."""
    rows = np.array([line.split() for line in path.read_text().splitlines() if len(line.split()) == 4], float)
    out = np.zeros((nodes, 3))
    out[rows[:, 0].astype(int) - 1] = rows[:, 1:]
    return out
