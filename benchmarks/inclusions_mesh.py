"""Rigid beads resolved by finite elements of an independent program, with and without them on one mesh.

Taylor-Hood elements with curved bead surfaces on a quarter of the flat block. "With" is P^T K P:
the columns of P are the nodes outside the beads and the motions of every bead that the mirror planes allow. K is
factored with a little taken off the pressure block, and refined against the true matrix until the residual is small.

Validity: E = 1 MPa (displacements scale with 1/E), an even push along z over a disc at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from twin.arrays import Points

QUARTER_MM = (50.0, 45.0, 40.0)
SOFT = 1e-5
"""Share of the pressure's mass matrix that makes the factored matrix quasi-definite."""

RESIDUAL = 1e-10


@dataclass(frozen=True, kw_only=True)
class BeadSolutions:
    """Displacement in mm of resolved beads (n, 3) and of the passive points at their centres, for 1 N and 1 MPa."""

    centres: Points
    beads: Points
    passive: Points
    elements: int
    unknowns: int


def bead_solutions(
    centres: Points,
    radius_mm: float,
    disc_mm: float,
    reach_mm: float,
    order: int,
    fineness: float,
    poisson_ratio: float = 0.5,
) -> BeadSolutions:
    """Solve a quarter of the block with and without the beads at 0 <= x, y < ``reach_mm``.

    Parameters
    ----------
    centres
        (n, 3) all beads, mm, symmetric in x and y.
    disc_mm
        Radius of the pushed disc.
    order
        Of the displacement; the pressure has one less.
    fineness
        Elements along a radius of curvature: 1 gives 4 % of missing volume in a bead, 2 gives .2 %.
    poisson_ratio
        Of the rubber.
    """
    import ngsolve as ng

    ng.SetNumThreads(1)
    centres = np.array([c for c in centres if -1e-9 <= c[0] < reach_mm and -1e-9 <= c[1] < reach_mm])
    mesh = _mesh(centres, radius_mm, disc_mm, reach_mm, fineness)
    mesh.Curve(order)
    held = {"dirichletx": "mirror_x|held", "dirichlety": "mirror_y|held", "dirichletz": "held"}
    moves, presses = ng.VectorH1(mesh, order=order, **held), ng.H1(mesh, order=order - 1)
    both = moves * presses
    matrix, load, soft = _system(mesh, both, presses, disc_mm, poisson_ratio, ".*")
    free = np.flatnonzero(np.array(list(both.FreeDofs()), bool))
    plain = sparse.csr_matrix((np.ones(len(free)), (free, np.arange(len(free)))), shape=(both.ndof, len(free)))
    without = plain @ _solve(matrix, load, soft, plain)
    tied, column = _tie(mesh, moves, presses, both, centres)
    matrix, load, soft = _system(mesh, both, presses, disc_mm, poisson_ratio, "rubber")
    with_beads = _solve(matrix, load, soft, tied)
    field = ng.GridFunction(both)
    field.vec.FV().NumPy()[:] = without
    inside = centres + 1e-9 * (centres[:, :] < 1e-9)
    passive = np.array([field.components[0](mesh(*point)) for point in inside])
    beads = np.array([[with_beads[c] if c >= 0 else 0.0 for c in motion[:3]] for motion in column])
    return BeadSolutions(
        centres=centres, beads=beads, passive=passive, elements=mesh.ne, unknowns=plain.shape[1]
    )  # fmt: skip


def _mesh(centres: Points, radius_mm: float, disc_mm: float, reach_mm: float, fineness: float) -> Any:
    import ngsolve as ng
    from netgen.occ import Axes, Box, Glue, HalfSpace, OCCGeometry, Pnt, Sphere, Vec, WorkPlane, X, Y, Z

    block = Box(Pnt(0, 0, 0), Pnt(*QUARTER_MM))
    near = Box(Pnt(0, 0, 0), Pnt(reach_mm + 0.75, reach_mm + 0.75, 8))
    for solid in (block, near):
        solid.faces.Min(X).name, solid.faces.Min(Y).name = "mirror_x", "mirror_y"
        solid.solids.name = "rubber"
    block.faces.Max(Z).name = "held"
    near.maxh = 1.0
    flat = Axes((0, 0, 0), n=Z, h=X)
    disc = WorkPlane(flat).Circle(disc_mm).Face() * WorkPlane(flat).Rectangle(QUARTER_MM[0], QUARTER_MM[1]).Face()
    disc.faces.name, disc.faces.maxh = "load", 0.6
    beads = []
    for number, centre in enumerate(centres):
        bead = Sphere(Pnt(*centre), radius_mm)
        for axis, (way, name) in enumerate(((X, "mirror_x"), (Y, "mirror_y"))):
            if abs(centre[axis]) < 1e-9:
                bead = bead * HalfSpace(Pnt(0, 0, 0), Vec(*(-np.eye(3)[axis])))
                bead.faces.Min(way).name = name
        bead.solids.name, bead.maxh = f"bead{number}", radius_mm
        beads.append(bead)
    return ng.Mesh(
        OCCGeometry(Glue([block, near, disc, *beads])).GenerateMesh(
            maxh=12, grading=0.3, curvaturesafety=fineness, segmentsperedge=1, optsteps3d=2
        )
    )


def _system(
    mesh: Any, both: Any, presses: Any, disc_mm: float, poisson_ratio: float, squeezed: str
) -> tuple[Any, Any, Any]:
    """Return matrix, load (1 N over the whole disc) and what is taken off the pressure block.

    ``squeezed`` names the solids whose volume gives way to pressure: a rigid bead's doesn't.
    """
    import ngsolve as ng

    (u, p), (v, q) = both.TnT()
    form = ng.BilinearForm(both, symmetric=False)
    strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    twice_shear = 1 / (1 + poisson_ratio)
    give = (1 - 2 * poisson_ratio) / (poisson_ratio * twice_shear)
    form += (twice_shear * ng.InnerProduct(strain, virtual) - p * ng.div(v) - q * ng.div(u)) * ng.dx
    form += -give * p * q * ng.dx(definedon=mesh.Materials(squeezed))
    load = ng.LinearForm(both)
    load += v[2] / (np.pi * disc_mm**2) * ng.ds("load")
    mass = ng.BilinearForm(presses)
    p, q = presses.TnT()
    mass += p * q * ng.dx
    for part in (form, load, mass):
        part.Assemble()
    softness = np.zeros(both.ndof)
    softness[both.ndof - presses.ndof :] = SOFT * _csr(mass.mat).diagonal()
    return _csr(form.mat), load.vec.FV().NumPy().copy(), sparse.diags(softness)


def _csr(matrix: Any) -> Any:
    rows, columns, values = (np.array(part) for part in matrix.COO())
    return sparse.csr_matrix((values, (rows, columns)), shape=(matrix.height, matrix.width))


def _tie(mesh: Any, moves: Any, presses: Any, both: Any, centres: Points) -> tuple[Any, np.ndarray]:
    """Return P (unknowns of ``both`` by reduced unknowns) and (beads, 6) its columns of every bead, -1 where held."""
    import ngsolve as ng

    free = np.array(list(both.FreeDofs()), bool)
    live = free.copy()
    live[moves.ndof :] &= np.array(list(presses.GetDofs(mesh.Materials("rubber"))), bool)
    x, y, z = ng.x, ng.y, ng.z
    function, motions = ng.GridFunction(moves), []
    for motion in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, -z, y), (z, 0, -x), (-y, x, 0)]:
        function.Set(ng.CF(motion))
        motions.append(function.vec.FV().NumPy().copy())
    rigid = np.array(motions).T
    column, blocks, used = np.full((len(centres), 6), -1), [], 0
    for number, centre in enumerate(centres):
        mine = np.flatnonzero(np.array(list(moves.GetDofs(mesh.Materials(f"bead{number}"))), bool))
        own = rigid[mine]
        own[:, 3:] -= own[:, :3] @ np.cross(np.eye(3), centre).T
        live[mine] = False
        for motion in range(6):
            if np.abs(own[~free[mine], motion]).max(initial=0.0) < 1e-9:
                blocks.append((mine, np.full(len(mine), used), own[:, motion]))
                column[number, motion] = used
                used += 1
    kept = np.flatnonzero(live)
    blocks.append((kept, used + np.arange(len(kept)), np.ones(len(kept))))
    rows, columns, values = (np.concatenate(part) for part in zip(*blocks, strict=True))
    tied = sparse.csr_matrix((values, (rows, columns)), shape=(both.ndof, used + len(kept)))
    tied.data[np.abs(tied.data) < 1e-13] = 0.0
    tied.eliminate_zeros()
    return tied, column


def _solve(matrix: Any, load: np.ndarray, soft: Any, tied: Any) -> np.ndarray:
    """Return the reduced unknowns of P^T K P q = P^T f.

    Raises
    ------
    RuntimeError
        The residual does not fall below its bound.
    """
    from ngsolve import la

    true, force = (tied.T @ matrix @ tied).tocsr(), tied.T @ load
    softened = (true - tied.T @ soft @ tied).tocoo()
    size = len(force)
    given = la.SparseMatrixd.CreateFromCOO(
        softened.row.astype(np.int32), softened.col.astype(np.int32), softened.data, size, size
    )
    inverse = given.Inverse(inverse="sparsecholesky")
    step, wrong, answer = given.CreateColVector(), given.CreateColVector(), np.zeros(size)
    for _ in range(20):
        residual = force - true @ answer
        if np.abs(residual).max() < RESIDUAL * np.abs(force).max():
            return answer
        wrong.FV().NumPy()[:] = residual
        step.data = inverse * wrong
        answer = answer + step.FV().NumPy()
    raise RuntimeError(f"residual {np.abs(residual).max():.1e} N after 20 refinements: the factorisation failed")
