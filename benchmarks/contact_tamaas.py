"""Run by an interpreter that has tamaas, in a process of its own: ``python contact_tamaas.py IN.npz OUT.npz``.

IN holds the height of a rigid profile over its lowest point at the middles of n by n cells, (n, n) mm; the side of the
square they fill, mm; the half-space's plane-strain modulus, MPa; the total force, N; and the tolerance. OUT gets the
(n, n) pressures, MPa, the indentation, mm, the total force, N, and torques about x and y at the middle, N mm, and CPU
seconds, not of the imports: of model, solution, what the indentation is read off and what the pressures add up to, and
of the solution alone, its model, operator and solver at hand. Each is the median of up to 199 runs, each with a
model of its own.

tamaas (https://gitlab.com/tamaas/tamaas, AGPL-3.0) is periodic by default; its non-periodic Boussinesq operator (DCFFT)
takes the profile as alone on a half-space.
"""

import sys
import time

import numpy as np
import tamaas as tm

RUNS, ENOUGH_S = 199, 1.0


def solved(
    height: np.ndarray, side: float, modulus: float, force: float, tolerance: float
) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Return pressures, indentation, force and torques about x and y, and CPU seconds."""
    start = time.process_time()
    model = tm.ModelFactory.createModel(tm.model_type.basic_2d, [side, side], list(height.shape))
    model.E, model.nu = modulus, 0.0
    tm.ModelFactory.registerNonPeriodic(model, "dcfft")
    solver = tm.PolonskyKeerRey(model, -height, tolerance)
    solver.setIntegralOperator("dcfft")
    solver.max_iter = 5000
    solver.solve(force / side**2)
    pressure = np.array(model.traction)
    moved = np.zeros_like(pressure)
    model.operators["dcfft"](pressure, moved)
    touching = pressure > 0
    indentation = float(np.mean((moved + height)[touching]))
    cell = side / len(pressure)
    middles = (np.arange(len(pressure)) + 0.5) * cell - side / 2
    along_x, along_y = pressure.sum(axis=1), pressure.sum(axis=0)
    resultant = cell**2 * np.array([along_x.sum(), along_y @ middles, -along_x @ middles])
    return pressure, indentation, resultant, time.process_time() - start


if __name__ == "__main__":
    tm.set_log_level(tm.LogLevel.error)
    given = np.load(sys.argv[1])
    scalars = [float(given[key]) for key in ("side", "modulus", "force", "tolerance")]
    small = np.add.outer(*[np.linspace(-1.0, 1.0, 16) ** 2] * 2)
    solved(small, 2.0, 1.0, 0.5, 1e-6)  # what the first run loads isn't counted
    runs = []
    while len(runs) < RUNS and sum(run[3] for run in runs) < ENOUGH_S:
        runs.append(solved(np.ascontiguousarray(given["height"]), *scalars))
    pressure, indentation, resultant, _ = runs[0]
    cpu_s = np.median([run[3] for run in runs])
    np.savez(sys.argv[2], pressure=pressure, indentation=indentation, resultant=resultant, cpu_s=cpu_s)
