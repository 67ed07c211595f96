"""scikit-fem on the reference cases: quadratic displacement, alone or with linear pressure.

As its users would: its own forms and bases, the lowest exact quadrature, clamps taken out, and SciPy's SuperLU in the
symmetric mode and order that suit such matrices (its default order takes several times as long). At Poisson's ratio 1/2
a millionth is taken off the pressure block, so that no pivoting is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.clock import Clock
from benchmarks.peers_ngsolve import OFF_PRESSURE
from benchmarks.peers_run import Answers, Problem, may_be_loaded, traction
from twin.arrays import Floats
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.mesh import Mesh


def answers(mesh: Mesh, problem: Problem, *, mixed: bool) -> Answers:
    """Solve both loads of a problem; the clock runs from the ready mesh."""
    import skfem

    grid = _grid(skfem, mesh, problem)
    clock = Clock()
    basis = skfem.Basis(grid, skfem.ElementVector(skfem.ElementTetP2()), intorder=2 if problem.body == "block" else 4)
    matrix = _matrix(skfem, grid, basis, problem, mixed)
    held = basis.get_dofs(lambda x: np.abs(x[2] - grid.p[2].max()) < 1e-6).all()
    free = np.setdiff1d(np.arange(matrix.shape[0]), held)
    solve = _solver(matrix, free)
    places = Locator(mesh).locate(problem.points)
    first = places.values(_nodal(skfem, mesh, basis, problem, 0, solve))
    costs = [clock.lap()]
    second = places.values(_nodal(skfem, mesh, basis, problem, 1, solve))
    costs.append(clock.lap())
    return Answers(unknowns=len(free), first=costs[0], next=costs[1], moved=(first, second))


def _grid(skfem: Any, mesh: Mesh, problem: Problem) -> Any:
    """Return scikit-fem's mesh: straight elements on the block, quadratic ones on the finger."""
    flat = skfem.MeshTet(mesh.points[: mesh.corners].T.copy(), mesh.tets[:, :4].T.copy())
    if problem.body == "block":
        return flat
    quadratic = skfem.MeshTet2.from_mesh(flat)
    numbers = quadratic.dofs.element_dofs
    nodes = quadratic.doflocs.copy()
    for corner in range(10):
        nodes[:, numbers[corner]] = mesh.points[mesh.tets[:, corner]].T
    return skfem.MeshTet2(nodes, quadratic.t)


def _matrix(skfem: Any, grid: Any, basis: Any, problem: Problem, mixed: bool) -> Any:
    from skfem.helpers import ddot, div, sym_grad, trace
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    if not mixed:
        return linear_elasticity(*lame_parameters(problem.youngs_modulus_mpa, problem.nu)).assemble(basis)
    shear = problem.youngs_modulus_mpa / (2 * (1 + problem.nu))
    softness = 3 * (1 - 2 * problem.nu) / problem.youngs_modulus_mpa + OFF_PRESSURE / shear
    pressure = basis.with_element(skfem.ElementTetP1())

    @skfem.BilinearForm
    def deviatoric(u: Any, v: Any, _: Any) -> Any:
        one, two = sym_grad(u), sym_grad(v)
        return 2 * shear * (ddot(one, two) - trace(one) * trace(two) / 3)

    @skfem.BilinearForm
    def divergence(u: Any, q: Any, _: Any) -> Any:
        return div(u) * q

    @skfem.BilinearForm
    def mass(p: Any, q: Any, _: Any) -> Any:
        return -softness * p * q

    gradient = divergence.assemble(basis, pressure)
    return skfem.bmat([[deviatoric.assemble(basis), gradient.T], [gradient, mass.assemble(pressure)]], "csr")


def _solver(matrix: Any, free: Any) -> Callable[[Floats], Floats]:
    """Return what takes forces on the displacements' unknowns to the solution; held unknowns stay zero."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    factor = splu(matrix[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

    def solve(force: Floats) -> Floats:
        right, out = np.zeros(matrix.shape[0]), np.zeros(matrix.shape[0])
        right[: len(force)] = force
        out[free] = factor.solve(right[free])
        return out

    return solve


def _nodal(skfem: Any, mesh: Mesh, basis: Any, problem: Problem, load: int, solve: Any) -> Floats:
    """Return the (N, 3) displacement of the mesh's nodes, mm."""
    top = basis.mesh.facets_satisfying(lambda x: may_be_loaded(problem.body, x.T), boundaries_only=True)
    faces = skfem.FacetBasis(basis.mesh, basis.elem, facets=top, intorder=6)
    axis = problem.axes[load]

    @skfem.LinearForm
    def pushed(v: Any, w: Any) -> Any:
        strength = traction(problem.body, w.x.reshape(3, -1).T).reshape(w.x.shape[1:])
        return strength * v[axis]

    right = pushed.assemble(faces)
    solution = solve(right / right.sum())
    out = np.zeros((len(mesh.points), 3))
    for node in range(10):
        for i in range(3):
            out[mesh.tets[:, node], i] = solution[basis.element_dofs[3 * node + i]]
    return out
