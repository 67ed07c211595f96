"""The one place that factors and solves sparse systems.

At nu = 1/2 the Taylor-Hood matrix is indefinite with a zero block, and factoring it needs pivoting,
which destroys the sparsity. Subtracting a tiny multiple of the pressure mass from that block makes
the matrix quasi-definite, so that any symmetric order factors without pivoting (R. J. Vanderbei
1995, SIAM J. Optim. 5); a few steps of refinement against the true matrix remove the shift's
effect. `_Fronts` does this everywhere. It takes 0.45 to 0.7 of SuperLU's time (98 000 and 9 000
unknowns); Intel's Pardiso, where ``pypardiso`` is installed, took 0.4. Every residual is
checked, because sparse solvers have been seen to return garbage silently."""

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

Solver = Literal["auto", "fronts", "pardiso"]
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

_SMALL, _PART = 120, 192
"""Unknowns of a branch of the elimination tree that is one front; rows of a triangle that are
computed together."""


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
        ``fronts`` is always there, ``pardiso`` needs pypardiso, ``auto`` takes that if it is there.
    node
        (n,) node that each unknown belongs to: the order keeps a node's unknowns together. Each its
        own if not given.
    last
        Unknowns that are eliminated last, by ``fronts``, for `schur`.

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
        return ("pardiso", "fronts") if find_spec("pypardiso") else ("fronts",)

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
            solver = "fronts"
        self.solver: Solver = self.solvers()[0] if solver == "auto" else solver
        self.residual = 0.0
        Factor.made += 1
        if self.solver == "pardiso":
            self._apply = _pardiso(shifted)
        else:
            every = np.arange(len(diagonal))
            none = every[:0] if last is None else last
            fronts = _Fronts(shifted, every if node is None else node, none)
            self._apply = fronts.apply
            if last is not None:
                self.schur = fronts.schur / np.outer(self._root[last], self._root[last])
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


class _Fronts:
    """A symmetric matrix (n, n) that needs no pivoting, factored front by front (I. S. Duff and
    J. K. Reid 1983, ACM Trans. Math. Softw. 9).

    A front is a dense matrix of unknowns that are eliminated together and of those that these leave
    something for. It takes what earlier fronts leave, and what it leaves itself goes to the front
    of the next unknown that is eliminated. METIS's nested dissection of the nodes (G. Karypis and
    V. Kumar 1998) gives the order. Most of the work on a body is products of large dense matrices.

    Parameters
    ----------
    matrix, node
        See `Factor`.
    last
        Unknowns that are eliminated after all fronts.

    Attributes
    ----------
    schur
        (m, m) what is left for the ``last`` unknowns.
    """

    def __init__(self, matrix: Any, node: Ints, last: Ints) -> None:
        from scipy.linalg import lapack

        self._solve = lapack.dgetrs
        first = np.delete(np.arange(len(node)), last)
        order, ends, takers = _dissection(matrix[first][:, first], node[first])
        self._order = np.concatenate([first[order], last])
        self._inner = len(first)
        ordered = matrix[self._order][:, self._order].tocsr()
        self._eliminated: list[tuple[int, int, Ints, Floats, Ints, Floats]] = []
        left: list[list[tuple[Ints, Floats]]] = [[] for _ in range(len(takers) + 1)]
        met = np.zeros(len(node), bool)
        number = np.zeros(len(node), np.intp)
        for front, taker in enumerate(takers):
            begin, end = int(ends[front]), int(ends[front + 1])
            size = end - begin
            # The front's unknowns: its own, then others that these meet.
            entries = slice(*ordered.indptr[[begin, end]])
            row = np.repeat(np.arange(size), np.diff(ordered.indptr[begin : end + 1]))
            column, value = ordered.indices[entries], ordered.data[entries]
            later = column >= begin
            row, column, value = row[later], column[later], value[later]
            for others, _ in (*left[front], (column, None)):
                met[others] = True
            met[begin:end] = False
            beyond = begin + np.flatnonzero(met[begin:])
            met[beyond] = False
            number[begin:end], number[beyond] = np.arange(size), np.arange(len(beyond))
            # Of both square blocks only the upper triangle counts.
            own, coupling = np.zeros((size, size)), np.zeros((len(beyond), size)).T
            inside = column < end
            own[row[inside], number[column[inside]]] = value[inside]
            inside = ~inside
            coupling[row[inside], number[column[inside]]] = value[inside]
            rest: Floats | None = None
            for others, block in left[front]:
                count = int(np.searchsorted(others, end))
                here, there = number[others[:count], None], number[others[count:]]
                own[here, here.T] += block[:count, :count]
                coupling[here, there] += block[:count, count:]
                if rest is None and len(there) == len(beyond):
                    rest = block[count:, count:]
            rest = np.zeros((len(beyond), len(beyond))) if rest is None else rest
            for others, block in left[front]:
                count = int(np.searchsorted(others, end))
                if not np.may_share_memory(block, rest):
                    _add_upper(rest, block[count:, count:], number[others[count:]])
            left[front] = []
            # Eliminate its own.
            lower = np.tril_indices(size, -1)
            own[lower] = own.T[lower]
            factors, pivots, failed = lapack.dgetrf(own.T, overwrite_a=True)
            if failed:
                raise SolveError("the elastic system is singular: is the body held anywhere?")
            carried, _ = self._solve(factors, pivots, coupling)
            for part in range(0, len(beyond), _PART):
                after = coupling[:, part : part + _PART].T @ carried[:, part:]
                rest[part : part + _PART, part:] -= after
            self._eliminated.append((begin, end, beyond, factors, pivots, carried))
            left[taker].append((beyond, rest))
        upper = ordered[self._inner :, self._inner :].toarray()
        for others, block in left[-1]:
            _add_upper(upper, block, others - self._inner)
        self.schur = np.triu(upper) + np.triu(upper, 1).T
        if len(last):
            self._last_factors, self._last_pivots, _ = lapack.dgetrf(self.schur)

    def apply(self, right: Floats) -> Floats:
        """Return the solution (n, m)."""
        found: Floats = right[self._order]
        for begin, end, beyond, _, _, carried in self._eliminated:
            found[beyond] -= carried.T @ found[begin:end]
        if len(self.schur):
            at_last = found[self._inner :]
            at_last[:] = self._solve(self._last_factors, self._last_pivots, at_last)[0]
        for begin, end, beyond, factors, pivots, carried in reversed(self._eliminated):
            own = self._solve(factors, pivots, found[begin:end])[0]
            found[begin:end] = own - carried @ found[beyond]
        out = np.empty_like(found)
        out[self._order] = found
        return out


def _add_upper(whole: Floats, block: Floats, place: Ints) -> None:
    """Add the upper triangle of a block (m, m) to a matrix at ascending places (m,); what lies
    below the diagonal of the matrix doesn't count."""
    for part in range(0, len(place), _PART):
        here = place[part : part + _PART, None]
        whole[here, place[part:]] += block[part : part + _PART, part:]


def _dissection(matrix: Any, node: Ints) -> tuple[Ints, Ints, list[int]]:
    """Return the (n,) order of the unknowns in which the nodes' graph is dissected again and again,
    where in it fronts (f) begin and end (f + 1,), and the front that takes what each leaves; -1 if
    none does."""
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
    count = graph.shape[0]
    order = place = np.arange(count)
    if graph.nnz:
        starts, near = graph.indptr.astype(np.int32), graph.indices.astype(np.int32)
        adjacency = pymetis.CSRAdjacency(starts, near)
        order, place = (np.asarray(one) for one in pymetis.nested_dissection(adjacency=adjacency))

    # The elimination tree: a node's parent is the next one that it leaves something for (J. W. H.
    # Liu 1990, SIAM J. Matrix Anal. Appl. 11).
    ordered = graph[order][:, order].tocsr()
    starts, near = ordered.indptr.tolist(), ordered.indices.tolist()
    parent, root = [-1] * count, [-1] * count
    for one in range(count):
        for other in near[starts[one] : starts[one + 1]]:
            while -1 < other < one:
                above, root[other] = root[other], one
                if above == -1:
                    parent[other] = one
                other = above
    # A front is a small branch of it, or nodes of large branches one above the other.
    below = np.bincount(group)[order].tolist()
    large = [0] * count
    for one, above in enumerate(parent):
        if above >= 0:
            below[above] += below[one]
            large[above] += below[one] > _SMALL
    top = list(range(count))
    for one in range(count - 1, -1, -1):
        above = parent[one]
        if above >= 0 and (below[above] <= _SMALL or (below[one] > _SMALL and large[above] == 1)):
            top[one] = top[above]
    tops, front = np.unique(top, return_inverse=True)
    takers = [int(front[parent[one]]) if parent[one] >= 0 else -1 for one in tops.tolist()]
    mine = front[place[group]]
    ends = np.concatenate([[0], np.cumsum(np.bincount(mine))])
    return np.lexsort((place[group], mine)), ends, takers


def _pardiso(matrix: Any) -> Apply:
    from scipy.sparse import triu

    try:
        from pypardiso import PyPardisoSolver
    except ImportError as problem:
        raise MissingCapability(
            "the solver pardiso needs pypardiso: pip install pypardiso, or use the solver fronts"
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
