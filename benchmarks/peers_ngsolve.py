"""NGSolve on the reference cases: displacement alone, or Taylor-Hood of any order on curved elements.

As its users would: curved elements of the displacement's order, symmetric storage, static condensation where elements
have inner unknowns, its own sparse Cholesky (on these systems MKL's Pardiso took twice as long, UMFPACK a third more).
At Poisson's ratio 1/2 a millionth is taken off the pressure block: without it the factorisation has returned garbage.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np

from benchmarks.clock import Clock
from benchmarks.peers_mesh import BUMP_MM, PATCH_MM
from benchmarks.peers_run import Answers, Problem

OFF_PRESSURE = 1e-6


def answers(mesh: Any, problem: Problem, *, order: int, mixed: bool, cores: int = 1) -> Answers:
    """Solve both loads of a problem on a mesh curved to ``order``; the clock runs from the ready mesh."""
    import ngsolve as ng

    ng.SetNumThreads(cores)
    with nullcontext() if cores == 1 else ng.TaskManager():
        clock = Clock()
        form, space = _form(ng, mesh, problem, order, mixed)
        form.Assemble()
        free = space.FreeDofs(form.condense)
        inverse = form.mat.Inverse(free, inverse="sparsecholesky")
        first = _solved(ng, mesh, problem, 0, form, space, inverse, mixed)
        costs = [clock.lap()]
        second = _solved(ng, mesh, problem, 1, form, space, inverse, mixed)
        costs.append(clock.lap())
    return Answers(unknowns=sum(free), first=costs[0], next=costs[1], moved=(first, second))


def _form(ng: Any, mesh: Any, problem: Problem, order: int, mixed: bool) -> tuple[Any, Any]:
    shear = problem.youngs_modulus_mpa / (2 * (1 + problem.nu))
    moves = ng.VectorH1(mesh, order=order, dirichlet="held")
    if mixed:
        space = moves * ng.H1(mesh, order=order - 1)
        (u, p), (v, q) = space.TnT()
    else:
        space = moves
        u, v = space.TnT()
    strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    energy = 2 * shear * ng.InnerProduct(strain, virtual)
    if mixed:
        softness = 3 * (1 - 2 * problem.nu) / problem.youngs_modulus_mpa + OFF_PRESSURE / shear
        energy += -2 / 3 * shear * ng.div(u) * ng.div(v) + p * ng.div(v) + q * ng.div(u) - softness * p * q
    else:
        energy += 2 * shear * problem.nu / (1 - 2 * problem.nu) * ng.div(u) * ng.div(v)
    form = ng.BilinearForm(space, symmetric=True, condense=order >= 4)
    form += energy * ng.dx
    return form, space


def _solved(
    ng: Any, mesh: Any, problem: Problem, load: int, form: Any, space: Any, inverse: Any, mixed: bool
) -> np.ndarray:
    test = space.TestFunction()
    axis = problem.axes[load]
    pushed = (test[0] if mixed else test)[axis]
    surface = ng.ds("load", bonus_intorder=0 if problem.body == "block" else 8)
    if problem.body == "block":
        traction, total = 1.0 / PATCH_MM**2, 1.0
    else:
        squared = (ng.x**2 + ng.y**2 + ng.z**2) / BUMP_MM**2
        traction = ng.IfPos(1 - squared, (1 - squared) ** 2, 0)
        total = ng.Integrate(traction * surface, mesh)
    right = ng.LinearForm(space)
    right += traction / total * pushed * surface
    right.Assemble()
    answer = ng.GridFunction(space)
    if form.condense:
        right.vec.data += form.harmonic_extension_trans * right.vec
        answer.vec.data = inverse * right.vec
        answer.vec.data += form.harmonic_extension * answer.vec
        answer.vec.data += form.inner_solve * right.vec
    else:
        answer.vec.data = inverse * right.vec
    moved = answer.components[0] if mixed else answer
    x, y, z = problem.points.T
    return np.asarray(moved(mesh(x, y, z)))
