"""The one place that factors and solves sparse systems.

At nu = 1/2 the Taylor-Hood matrix is indefinite with a zero block, and factoring it needs pivoting,
which destroys the sparsity. Subtracting a tiny multiple of the pressure mass from that block makes
the matrix quasi-definite, so that any symmetric order factors without pivoting (R. J. Vanderbei
1995, SIAM J. Optim. 5); a few steps of refinement against the true matrix remove the shift's
effect. SciPy's SuperLU does this everywhere, in METIS's nested dissection of the nodes (G. Karypis
and V. Kumar 1998), which halves the time and the memory of its own order; Intel's Pardiso, where
``pypardiso`` is installed, factors in 0.4 of the time (8 000 and 23 000 nodes). Every residual is
checked, because sparse solvers have been seen to return garbage silently.

Single precision would factor in half of the time, but many right sides then take as much longer to
refine, and nothing refines `Factor.schur`: at nu = 1/2 presses at finite strain were up to 2 % off,
or did not settle."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import cached_property
from importlib.util import find_spec
from typing import Any, ClassVar, Literal

import numpy as np

from twin.arrays import Floats, Ints
from twin.blas_threads import hold_new_library
from twin.errors import MissingCapability, SolveError

Solver = Literal["auto", "superlu", "pardiso"]
Apply = Callable[[Floats], Floats]

SHIFT = 1e-6
"""Multiple of the pressure scale that is subtracted from the pressure block before factoring."""

GOAL, LIMIT, STEPS = 1e-12, 1e-9, 8
"""Relative residual at which refinement stops, above which a solve is refused, and the largest
number of steps."""

ROUNDING = 1e-4
"""Weight of the solution in the relative residual: where layers differ a million times in stiffness
the solution is a million times longer, and round-off alone exceeds the limit of the right side."""

LENIENCE = 1e3
"""How many times the residual may exceed its limit for a long solution at most: without this bound
a body that can drift is "solved" to 1e14 mm."""


class Factor:
    """A factored symmetric saddle-point matrix.

    Parameters
    ----------
    matrix
        (n, n) sparse symmetric matrix, both triangles stored.
    pressure_scale
        (n,) zero on displacement rows; on pressure rows the positive size of their Schur
        complement's diagonal.
    solver
        ``superlu`` is always there, ``pardiso`` needs pypardiso, ``auto`` takes the faster one that
        is there.
    node
        (n,) node that each unknown belongs to: the order keeps a node's unknowns together. Each its
        own if not given.
    last
        Unknowns that are eliminated last, by ``superlu``, for `schur`.

    Raises
    ------
    SolveError
        The matrix can't be factored.
    MissingCapability
        ``pardiso`` is requested and not installed.
    """

    made: ClassVar[int] = 0
    """How many matrices this process has factored."""

    @staticmethod
    def solvers() -> tuple[Solver, ...]:
        """Return the solvers of this machine, fastest first."""
        return ("pardiso", "superlu") if find_spec("pypardiso") else ("superlu",)

    def __init__(
        self,
        matrix: Any,
        pressure_scale: Floats,
        solver: Solver = "auto",
        *,
        node: Ints | None = None,
        last: Ints | None = None,
    ) -> None:
        from scipy.sparse import diags

        diagonal = np.abs(matrix.diagonal()) + pressure_scale
        if not np.all(np.isfinite(diagonal)) or np.any(diagonal <= 0.0):
            raise SolveError(
                f"the elastic system has {int(np.sum(~(diagonal > 0.0)))} empty rows: a node "
                "belongs to no element, check the mesh"
            )
        self._root = 1.0 / np.sqrt(diagonal)
        scaling = diags(self._root)
        self._matrix = (scaling @ matrix @ scaling).tocsr()
        shifted = self._matrix - diags(SHIFT * pressure_scale * self._root**2)
        if last is not None:
            solver = "superlu"
        self.solver: Solver = self.solvers()[0] if solver == "auto" else solver
        self.residual = 0.0
        Factor.made += 1
        if self.solver == "pardiso":
            self._apply = _pardiso(shifted)
        else:
            first = np.arange(len(diagonal))
            node = first if node is None else node
            first = first if last is None else np.delete(first, last)
            order = first[_dissection(shifted[first][:, first], node[first])]
            if last is not None:
                order = np.concatenate([order, last])
            self._apply, factor = _superlu(shifted, order)
            if last is not None:
                self.schur = _last_block(factor, len(last)) / np.outer(
                    self._root[last], self._root[last]
                )
                """(m, m) Stiffness of the ``last`` unknowns while nothing acts on the others."""

    @cached_property
    def compliance(self) -> Floats:
        """(m, m) How the ``last`` unknowns move by forces on them."""
        return np.asarray(np.linalg.inv(self.schur))

    def solve(self, right: Floats, goal: float = GOAL) -> Floats:
        """Return the solution (n, m) or (n,) for ``right`` of the same shape; `residual` keeps the
        worst one reached.

        Parameters
        ----------
        goal
            Relative residual at which refinement stops.

        Raises
        ------
        SolveError
            The relative residual stays above 1e-9, or the goal if that is larger, after refinement.
        """
        columns = self._root[:, None] * right.reshape(len(right), -1)
        size = np.max(np.abs(columns), axis=0, initial=0.0)
        if not np.all(np.isfinite(size)):
            raise SolveError(
                "the right-hand side of the elastic system is not finite: check the load"
            )
        columns = columns / np.where(
            size > 0.0, size, 1.0
        )  # first, so that squares in the norm don't leave the range
        length = np.linalg.norm(columns, axis=0)
        columns = columns / np.where(length > 0.0, length, 1.0)
        solution = self._apply(columns)
        remainder = columns - self._matrix @ solution
        worst = _worst(remainder, solution)
        for _ in range(STEPS):
            if not worst > goal:
                break
            better = solution + self._apply(remainder)
            remainder = columns - self._matrix @ better
            if not _worst(remainder, better) < worst:
                break
            solution, worst = better, _worst(remainder, better)
        self.residual = worst
        allowed = max(LIMIT, goal)
        if not worst <= allowed:
            raise SolveError(
                f"the elastic system was solved to a relative residual of {worst:.1e} only, "
                f"allowed is {allowed:.0e}: " + _cause(solution)
            )
        result: Floats = (self._root[:, None] * solution * length * size).reshape(right.shape)
        return result


def _worst(remainder: Floats, solution: Floats) -> float:
    """Return the largest relative residual of scaled systems whose right sides and matrix have
    norms of about 1."""
    if remainder.shape[1] == 0:
        return 0.0
    size = np.minimum(1.0 + ROUNDING * np.linalg.norm(solution, axis=0), LENIENCE)
    largest = float(np.max(np.linalg.norm(remainder, axis=0) / size))
    return largest if np.isfinite(largest) else np.inf


def _cause(solution: Floats) -> str:
    """Say why a scaled system was likely not solved: with right sides of norm 1 a sound body's
    solution is short."""
    length = float(np.max(np.linalg.norm(solution, axis=0)))
    if not length < LENIENCE / ROUNDING:
        return (
            f"some motion takes {length:.0e} times less force than others, so a part of the body "
            "is likely not held, or hangs on a single node or edge, or layers differ too much in "
            "stiffness (1e7 times still work)"
        )
    return (
        "an incompressible body that is held all round was likely given a motion that changes its "
        "volume, or elements are nearly flat"
    )


def _dissection(matrix: Any, node: Ints) -> Ints:
    """Return the (n,) order of the unknowns by nested dissection of the nodes' graph."""
    import pymetis
    from scipy.sparse import csr_matrix

    _, group = np.unique(node, return_inverse=True)
    gather = csr_matrix((np.ones(len(group), np.int32), (np.arange(len(group)), group)))
    pattern = csr_matrix(
        (np.ones(matrix.nnz, np.int32), matrix.indices, matrix.indptr), shape=matrix.shape
    )
    graph = (gather.T @ pattern @ gather).tocsr()
    graph.setdiag(0)
    graph.eliminate_zeros()
    if graph.nnz == 0:
        return np.arange(len(group))
    adjacency = pymetis.CSRAdjacency(graph.indptr.astype(np.int32), graph.indices.astype(np.int32))
    _, place = pymetis.nested_dissection(adjacency=adjacency)
    return np.argsort(np.asarray(place)[group], kind="stable")


def _superlu(matrix: Any, order: Ints) -> tuple[Apply, Any]:
    from scipy.sparse.linalg import splu

    ordered = matrix[order][:, order].tocsc()
    try:
        factor = splu(
            ordered, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError as problem:
        raise SolveError(
            f"the elastic system is singular ({problem}): is the body held anywhere?"
        ) from problem

    def apply(right: Floats) -> Floats:
        out = np.empty_like(right)
        out[order] = factor.solve(np.ascontiguousarray(right[order]))
        return out

    return apply, factor


def _last_block(factor: Any, count: int) -> Floats:
    """Return the Schur complement (m, m) of the last unknowns, the product of the factors' last
    blocks."""
    for moved in (factor.perm_r, factor.perm_c):
        if not np.array_equal(moved, np.arange(len(moved))):
            raise SolveError("the elastic system was factored in another order than asked for")
    lower: Floats = factor.L[-count:, -count:].toarray()
    upper: Floats = factor.U[-count:, -count:].toarray()
    return lower @ upper


def _pardiso(matrix: Any) -> Apply:
    from scipy.sparse import triu

    try:
        from pypardiso import PyPardisoSolver
    except ImportError as problem:
        raise MissingCapability(
            "the solver pardiso needs pypardiso: pip install pypardiso, or use the solver superlu"
        ) from problem
    from pypardiso.pardiso_wrapper import PyPardisoError

    hold_new_library()
    upper = triu(matrix).tocsr()
    pardiso = PyPardisoSolver(mtype=-2)
    try:
        pardiso.factorize(upper)
    except (PyPardisoError, ValueError) as problem:
        raise SolveError(
            f"the elastic system can't be factored ({problem}): is the body held anywhere?"
        ) from problem

    def apply(right: Floats) -> Floats:
        return np.asarray(pardiso.solve(upper, right)).reshape(right.shape)

    weakref.finalize(apply, pardiso.free_memory, True)
    return apply
