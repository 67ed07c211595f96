"""The sparse solver: every solve is checked, singular systems are refused, both paths agree."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse import bmat, csr_matrix, eye, random_array

from twin.errors import SolveError
from twin.world.elasticity.factor import LIMIT, Factor


def saddle(pressures=30, displacements=90):
    rng = np.random.default_rng(5)
    spread = random_array((displacements, displacements), density=0.05, rng=rng)
    stiffness = spread @ spread.T + eye(displacements)
    divergence = random_array((pressures, displacements), density=0.2, rng=rng)
    matrix = csr_matrix(bmat([[stiffness, divergence.T], [divergence, None]]))
    return matrix, np.concatenate([np.zeros(displacements), np.ones(pressures)])


@pytest.mark.parametrize("solver", Factor.solvers())
def test_indefinite_system_is_solved_to_the_dense_answer(solver):
    matrix, scale = saddle()
    right = np.random.default_rng(1).normal(size=(len(scale), 3))
    before = Factor.made
    factor = Factor(matrix, scale, solver)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix.toarray(), right), rtol=1e-6, atol=1e-8)
    factor.solve(right[:, 0])
    assert factor.residual < LIMIT
    assert Factor.made == before + 1


@pytest.mark.parametrize("solver", Factor.solvers())
def test_singular_system_is_refused(solver):
    free = csr_matrix(np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]))
    with pytest.raises(SolveError, match="held"):
        Factor(free, np.zeros(3), solver).solve(np.array([1.0, 0.0, 0.0]))


def test_empty_row_and_infinite_load_are_refused():
    with pytest.raises(SolveError, match="empty rows"):
        Factor(csr_matrix(np.diag([1.0, 0.0])), np.zeros(2))
    with pytest.raises(SolveError, match="not finite"):
        Factor(csr_matrix(np.eye(2)), np.zeros(2)).solve(np.array([np.nan, 1.0]))


LIBRARIES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
MOTION = """
import sys
import numpy as np
from twin.parts.body import Block
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile

block = Block(width_mm=100, length_mm=90, thickness_mm=40)
stiff = Compliance(block, Material(youngs_modulus_mpa=1.0, poisson_ratio=0.5), level="nominal", table=False)
points = np.stack(np.meshgrid(np.linspace(-12, 12, 7), np.linspace(-8, 8, 3), [3.0, 6.0, 12.0]), axis=-1)
load = tile(Traction.rectangle((2, 1), (4, 3), (0.3, -0.5, 1.0)), block)
moved = stiff.displacement(points.reshape(-1, 3), load)
np.savez(sys.argv[1], moved=moved, residual=stiff.system.factor.residual)
"""


@pytest.mark.slow
def test_threads_change_no_answer(tmp_path):
    """In processes whose caches are empty, so that none finds a solved field."""
    found = {}
    for number in (1, 2, 4):
        told = {**os.environ, **dict.fromkeys(LIBRARIES, str(number)), "TWIN_CACHE": str(tmp_path / str(number))}
        file = tmp_path / f"{number}.npz"
        subprocess.run([sys.executable, "-c", MOTION, str(file)], env=told, check=True)
        with np.load(file) as answer:
            found[number] = answer["moved"]
            assert answer["residual"] < 1e-9
    for number in (2, 4):
        assert np.abs(found[number] - found[1]).max() <= 1e-10 * np.abs(found[1]).max()
