"""Run by an interpreter that has tamaas, in a process of its own: ``python contact_tamaas.py IN.npz OUT.npz``.

IN holds the height of a rigid profile over its lowest point at the middles of n by n cells, (n, n) mm; the side of the
square they fill, mm; the half-space's plane-strain modulus, MPa; the total force, N; and the tolerance. OUT gets the
(n, n) pressures, MPa, the indentation, mm, and CPU seconds, not of the imports: of model, solution and what the
indentation is read off, and of the solution alone, its model, operator and solver at hand. Each is the median of up to
nine runs, each with a model of its own.

tamaas (https://gitlab.com/tamaas/tamaas, AGPL-3.0) is periodic by default; its non-periodic Boussinesq operator (DCFFT)
takes the profile as alone on a half-space.
"""

import sys
import time

import numpy as np
import tamaas as tm

RUNS, ENOUGH_S = 9, 1.0


def solved(
    height: np.ndarray, side: float, modulus: float, force: float, tolerance: float
) -> tuple[np.ndarray, float, float, float]:
    """Return pressures, indentation, and CPU seconds of all and of the solution alone."""
    start = time.process_time()
    model = tm.ModelFactory.createModel(tm.model_type.basic_2d, [side, side], list(height.shape))
    model.E, model.nu = modulus, 0.0
    tm.ModelFactory.registerNonPeriodic(model, "dcfft")
    solver = tm.PolonskyKeerRey(model, -height, tolerance)
    solver.setIntegralOperator("dcfft")
    solver.max_iter = 5000
    ready = time.process_time()
    solver.solve(force / side**2)
    solution = time.process_time() - ready
    pressure = np.array(model.traction)
    moved = np.zeros_like(pressure)
    model.operators["dcfft"](pressure, moved)
    touching = pressure > 0
    return pressure, float(np.mean((moved + height)[touching])), time.process_time() - start, solution


if __name__ == "__main__":
    tm.set_log_level(tm.LogLevel.error)
    given = np.load(sys.argv[1])
    scalars = [float(given[key]) for key in ("side", "modulus", "force", "tolerance")]
    small = np.add.outer(*[np.linspace(-1.0, 1.0, 16) ** 2] * 2)
    solved(small, 2.0, 1.0, 0.5, 1e-6)  # what the first run loads isn't counted
    runs = []
    while len(runs) < RUNS and sum(run[2] for run in runs) < ENOUGH_S:
        runs.append(solved(np.ascontiguousarray(given["height"]), *scalars))
    whole, solution = np.median([run[2:] for run in runs], axis=0)
    np.savez(sys.argv[2], pressure=runs[0][0], indentation=runs[0][1], cpu_s=whole, solution_s=solution)
