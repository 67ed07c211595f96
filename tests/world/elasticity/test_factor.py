"""The sparse solver: every solve is checked, singular systems are refused, both paths agree."""

import numpy as np
import pytest
from scipy.sparse import bmat, csr_matrix, eye, random_array

from benchmarks.stress_elastic import of_threads
from twin.errors import SolveError
from twin.world.elasticity.factor import LIMIT, Factor, available_solvers, factorisations


def saddle(pressures=30, displacements=90):
    rng = np.random.default_rng(5)
    spread = random_array((displacements, displacements), density=0.05, rng=rng)
    stiffness = spread @ spread.T + eye(displacements)
    divergence = random_array((pressures, displacements), density=0.2, rng=rng)
    matrix = csr_matrix(bmat([[stiffness, divergence.T], [divergence, None]]))
    return matrix, np.concatenate([np.zeros(displacements), np.ones(pressures)])


@pytest.mark.parametrize("solver", available_solvers())
def test_indefinite_system_is_solved_to_the_dense_answer(solver):
    matrix, scale = saddle()
    right = np.random.default_rng(1).normal(size=(len(scale), 3))
    before = factorisations()
    factor = Factor(matrix, scale, solver)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix.toarray(), right), rtol=1e-6, atol=1e-8)
    factor.solve(right[:, 0])
    assert factor.residual < LIMIT
    assert factorisations() == before + 1


@pytest.mark.parametrize("solver", available_solvers())
def test_singular_system_is_refused(solver):
    free = csr_matrix(np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]))
    with pytest.raises(SolveError, match="held"):
        Factor(free, np.zeros(3), solver).solve(np.array([1.0, 0.0, 0.0]))


def test_empty_row_and_infinite_load_are_refused():
    with pytest.raises(SolveError, match="empty rows"):
        Factor(csr_matrix(np.diag([1.0, 0.0])), np.zeros(2))
    with pytest.raises(SolveError, match="not finite"):
        Factor(csr_matrix(np.eye(2)), np.zeros(2)).solve(np.array([np.nan, 1.0]))


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 4])
def test_threads_change_no_answer(number):
    """In processes that find no solved fields: nodal forces on the block, markers of a press."""
    measured = of_threads(number)
    assert measured.departure < 1e-10
    assert measured.residual < 1e-9
