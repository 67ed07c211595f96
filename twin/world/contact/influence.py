"""Compliance between contact patches, with two storages that solvers do not depend on; and the
linear systems of a contact.

**`Influence`** is what solvers know of the compliance C. **Matrix** (`DenseInfluence`): symmetric,
on any body.

**Lattice** (`LatticeInfluence`), for equal patches in a plane: u_i = sum over j of K(i - j) f_j,
plus a correction that is smooth in both places: its values at 6 or 8 Chebyshev nodes a side times
Lagrange's polynomials (`twin.world.elasticity.block_table`). On a lattice padded to 2 n - 1 places
a side the convolution is circular, with cosines and sines as eigenvectors. An elastic plane's
kernel is even along a side, or odd between the normal and a tangential axis (both between two
tangential ones), so that six real numbers a wave suffice. Products with matrices of waves replace
an FFT: faster on a few dozen patches a side, and the correction is a few more rows.

**Preconditioner**: the inverse of a half-space's compliance on the patches' lattice, wave by wave,
restricted to the patches in contact (E. A. H. Vollebregt, J. Optim. Theory Appl. 162 (2014) 931).
Six products reduce the residual to a thousandth. Graded cells have
the Cholesky factors of the matrix's normal and tangential blocks instead.

**Saddle-point systems** (`SaddlePoint`): C x + M q = right, B x = balance, for forces x on patches
and motions q of a rigid probe, are solved by GMRES with a constraint preconditioner: C is replaced
by an approximation, and the few rows and columns of the probe's balance are kept exactly, so that
the balance holds to round-off at every iteration (C. Keller, N. I. M. Gould and A. J. Wathen, SIAM
J. Matrix Anal. Appl. 21 (2000) 1300). Systems that GMRES does not solve are solved by elimination.

Validity: the exact influence of a uniform rectangle on the middle of another, and the table's
error.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.linalg import blas, lapack

from twin.arrays import Floats, Ints, Points, frozen
from twin.compiled import njit
from twin.parts.load import Rectangles
from twin.theory import halfspace
from twin.world.contact.surface_patches import Patches
from twin.world.elasticity.tensor_basis import SIZES, Axis

_HELD = 1e-12
"""Share of a depth that iteration leaves."""

MOST_PRODUCTS = 60
"""Products with C until GMRES gives up."""

_SINGULAR = 1e6
"""Condition number of the probe's own equations from which on elimination solves them."""


@dataclass(frozen=True, kw_only=True)
class SaddlePoint:
    """A saddle-point system.

    Attributes
    ----------
    product
        x (n,) to C x (n,).
    approx_solve
        y (n, ...) to about C^-1 y (n, ...).
    motion, pull
        (n, m) M and (m, n) B.
    """

    product: Callable[[Floats], Floats]
    approx_solve: Callable[[Floats], Floats]
    motion: Floats
    pull: Floats

    def solve(self, right: Floats, balance: Floats, share: float) -> tuple[Floats, Floats] | None:
        """Return x (n,) and q (m,) with a residual of ``share`` of the right-hand side; None where
        out of reach."""
        n = len(right)
        m = len(balance)
        wanted = np.concatenate([right, balance])
        largest = float(np.abs(wanted).max(initial=0.0))
        if largest == 0.0:
            return np.zeros(n), np.zeros(m)
        # Schur complement of the approximate C: the motions' own equations.
        under_motion = self.approx_solve(self.motion) if m else self.motion
        schur = self.pull @ under_motion
        if not np.isfinite(schur).all() or (m and np.linalg.cond(schur) > _SINGULAR):
            return None
        inverse = np.linalg.inv(schur)

        def preconditioned(y: Floats) -> Floats:
            x = self.approx_solve(y[:n, None])[:, 0]
            q = inverse @ (self.pull @ x - y[n:])
            return np.concatenate([x - under_motion @ q, q])

        def equations(y: Floats) -> Floats:
            return np.concatenate([self.product(y[:n]) + self.motion @ y[n:], self.pull @ y[:n]])

        found = _gmres(equations, preconditioned, wanted / largest, share)
        if found is None:
            return None
        solution = found * largest
        return solution[:n], solution[n:]

    @staticmethod
    def eliminate(
        matrix: Floats, motion: Floats, pull: Floats, right: Floats, balance: Floats
    ) -> tuple[Floats, Floats]:
        """Return x (n,) and q (m,) by elimination, C (n, n) being a matrix.

        Compliances and forces differ by the modulus, so both blocks are scaled to about one.

        Raises
        ------
        numpy.linalg.LinAlgError
            The system is singular.
        """
        n = len(right)
        m = len(balance)
        whole = np.zeros((n + m, n + m))
        whole[:n, :n] = matrix
        whole[:n, n:] = motion
        whole[n:, :n] = pull
        typical = float(np.mean(np.abs(np.diag(matrix))))
        scale = np.concatenate([np.full(n, typical**-0.5), np.full(m, typical**0.5)])
        whole *= scale
        whole *= scale[:, None]
        found = np.linalg.solve(whole, np.concatenate([right, balance]) * scale) * scale
        return found[:n], found[n:]


class _Preconditioner(Protocol):
    """Approximate inverse of the compliance over its unit between k patches, restricted to some of
    them."""

    def force(self, rows: Ints, displacement: Floats) -> Floats:
        """Return (m, 3, n) forces on some patches that move these by about (m, 3, n)."""
        ...

    def push(self, rows: Ints, depth: Floats) -> Floats:
        """Return (n,) normal forces on some patches that move these by about (n,) along their
        normals."""
        ...


class Influence(ABC):
    """Compliance between k patches, in their own frames, mm/N.

    Attributes
    ----------
    unit
        The mean compliance of a patch to a force on itself, mm/N.
    """

    unit: float

    @abstractmethod
    def __len__(self) -> int: ...

    @property
    @abstractmethod
    def own(self) -> Floats:
        """(k,) normal displacement of each patch under a unit normal force on it."""

    @property
    @abstractmethod
    def _preconditioner(self) -> _Preconditioner: ...

    @abstractmethod
    def apply(self, force: Floats) -> Floats:
        """Return the (k, 3) displacements of the patches under forces (k, 3), mm."""

    @abstractmethod
    def normal_displacement(self, push: Floats) -> Floats:
        """Return the (k,) normal displacements under normal forces (k,), mm."""

    def product(self, rows: Ints, force: Floats) -> Floats:
        """Return the (3, n) displacements over the `unit` of some patches under forces (3, n) on
        them."""
        whole = np.zeros((len(self), 3))
        whole[rows] = force.T
        return np.ascontiguousarray(self.apply(whole)[rows].T) / self.unit

    @abstractmethod
    def block(self, rows: Ints) -> Floats:
        """Return the (n, 3, n, 3) compliance between some patches."""

    @abstractmethod
    def normal_block(self, rows: Ints, columns: Ints) -> Floats:
        """Return the (n, m) normal displacements of some patches under unit normal forces on
        others."""

    def approx_solve(self, rows: Ints, displacement: Floats) -> Floats:
        """Return (3, n, m) forces on some patches that move these by about (3, n, m) over the
        `unit`."""
        columns = displacement.transpose(2, 0, 1)
        return self._preconditioner.force(rows, columns).transpose(1, 2, 0)

    def approx_push(self, rows: Ints, depth: Floats) -> Floats:
        """Return (n,) normal forces on the patches ``rows`` (n,) that move them by about ``depth``
        (n,), mm."""
        return self._preconditioner.push(rows, depth / self.unit)

    def normal_system(self, rows: Ints, motion: Floats, pull: Floats) -> SaddlePoint:
        """Return the system of the normal forces on some patches, lengths over the `unit`."""

        def product(x: Floats) -> Floats:
            push = np.zeros(len(self))
            push[rows] = x
            return np.asarray(self.normal_displacement(push)[rows] / self.unit)

        def approx_solve(y: Floats) -> Floats:
            return self.unit * np.stack([self.approx_push(rows, column) for column in y.T], axis=1)

        return SaddlePoint(product=product, approx_solve=approx_solve, motion=motion, pull=pull)

    def pushes_for_depth(self, rows: Ints, depth: Floats) -> Floats:
        """Return (n,) the normal forces on some patches that move these by ``depth`` (n,), mm,
        along their normals."""
        n = len(rows)
        system = self.normal_system(rows, np.zeros((n, 0)), np.zeros((0, n)))
        found = system.solve(depth / self.unit, np.zeros(0), _HELD)
        if found is not None:
            return found[0]
        return np.asarray(np.linalg.solve(self.normal_block(rows, rows), depth))


def _gmres(
    product: Callable[[Floats], Floats],
    preconditioned: Callable[[Floats], Floats],
    right: Floats,
    share: float,
) -> Floats | None:
    """Return x with a residual of ``share`` of the right-hand side; None after `MOST_PRODUCTS`, or
    if not finite.

    Flexible GMRES without restart (Y. Saad, SIAM J. Sci. Comput. 14 (1993) 461): preconditioned
    vectors are kept, which saves one preconditioning. With SciPy's, presses with friction take up
    to 1.5 times as long.
    """
    size = len(right)
    basis = np.empty((MOST_PRODUCTS + 1, size))
    directions = np.empty((MOST_PRODUCTS, size))
    triangle = np.zeros((MOST_PRODUCTS, MOST_PRODUCTS))
    rotations: list[tuple[float, float]] = []
    goal = np.zeros(MOST_PRODUCTS + 1)
    length = float(np.linalg.norm(right))
    basis[0] = right / length
    goal[0] = length
    for done in range(1, MOST_PRODUCTS + 1):
        last = done - 1
        directions[last] = preconditioned(basis[last])
        image = product(directions[last])
        column = triangle[:done, last]
        for _ in range(2):  # Gram-Schmidt, the second time against round-off
            parts = basis[:done] @ image
            image = image - parts @ basis[:done]
            column += parts
        norm = float(np.linalg.norm(image))
        if not math.isfinite(norm):
            return None
        # The Hessenberg matrix becomes triangular by plane rotations, which turn the goal, too.
        for i, (cosine, sine) in enumerate(rotations):
            above, below = column[i : i + 2]
            column[i : i + 2] = cosine * above + sine * below, cosine * below - sine * above
        diagonal = math.hypot(column[last], norm)
        cosine, sine = (column[last] / diagonal, norm / diagonal) if diagonal else (1.0, 0.0)
        rotations.append((cosine, sine))
        column[last] = diagonal
        goal[done] = -sine * goal[last]
        goal[last] *= cosine
        if abs(goal[done]) <= share * length:
            weights = np.linalg.solve(triangle[:done, :done], goal[:done])
            return np.asarray(weights @ directions[:done])
        if norm == 0.0:
            return None
        basis[done] = image / norm
    return None


NODES = (6, max(SIZES[1:5]))
"""Chebyshev nodes along each side; the last are as many as the table's polynomials have terms."""

FEWEST = 150
"""Patches from which on products by waves are faster than with a matrix."""

_SMALL = 1e-9
"""Largest last term of the correction in Chebyshev polynomials, over a patch's own compliance: the
next is a tenth."""

_ROUND_OFF = 1e-9
"""Largest relative difference of sizes, and distance from the plane over a size, that counts as
none."""

_OFF = 1e-6
"""Share of a step that a point of a lattice may be off."""

_AXES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
_ZZ = 5


@runtime_checkable
class _PlaneCompliance(Protocol):
    """A surface whose compliance is a function of the offset plus a smooth correction."""

    def offset_part(self, points: Points, rectangle: Rectangles) -> Floats:
        """Return (3 n, 3) mm/N: the part that depends on the offset from the load's middle."""
        ...

    def smooth_part(self, patches: Rectangles, nodes: Rectangles) -> Floats | None:
        """Return (3 n, 3 n) mm/N: the correction between ``nodes``, global axes; None where it is
        no polynomial with the terms of `NODES` over all ``patches``."""
        ...


def _on_lattice(place_mm: Floats, step_mm: Floats) -> Ints | None:
    """Return how many steps (k, 2) points in a plane (k, 2) are from the lowest; None where they
    are on no lattice."""
    steps = (place_mm - place_mm.min(axis=0)) / step_mm
    whole = np.rint(steps).astype(int)
    return None if np.abs(steps - whole).max() > _OFF else whole


def _spectra_of(kernel: Floats, chosen: Sequence[int] = range(6)) -> Floats:
    """Return (c, nu, nv) the spectra xx, xy, yy, xz, yz, zz, or some, of a kernel (nu, nv, 3, 3) of
    offsets from 0 on; those below the diagonal follow by reciprocity."""
    found = []
    for part in chosen:
        a, b = _AXES[part]
        u, v = (_summing(n, (a == axis) != (b == axis)) for axis, n in enumerate(kernel.shape[:2]))
        found.append(u @ kernel[..., a, b] @ v.T)
    return np.stack(found)


def _inverse_of(spectra: Floats) -> Floats | None:
    """Return the inverses, wave by wave, of the tangential and of the normal part; None where one
    is not positive."""
    xx, xy, yy, _, _, zz = spectra
    det = xx * yy - xy * xy
    if not (det.min() > 0.0 and xx.min() > 0.0 and zz.min() > 0.0):
        return None
    none = np.zeros_like(zz)
    return np.stack([yy / det, -xy / det, xx / det, none, none, 1.0 / zz])


class _Convolution:
    """A kernel on a lattice, its ``spectra`` as of `_spectra_of` or (1, nu, nv) of the normal part
    alone, and a smooth correction: (c m m, c m m) what polynomials of m terms along either side,
    with values ``sides`` (nu, m) and (nv, m), make of each other, c = 3 axes or the normal
    alone."""

    def __init__(
        self,
        spectra: Floats,
        correction: Floats | None = None,
        sides: tuple[Floats, Floats] | None = None,
    ) -> None:
        self._axes = 3 if len(spectra) == 6 else 1
        self._shape: tuple[int, ...] = spectra.shape[1:]
        rows = [_waves(n) for n in self._shape]
        if correction is not None and sides is not None:
            rows = [np.concatenate([wave, side.T]) for wave, side in zip(rows, sides, strict=True)]
        self._u, self._v = rows
        self._u_back = np.ascontiguousarray(self._u.T)
        self._v_back = np.ascontiguousarray(self._v.T)
        self._correction = np.zeros((0, 0)) if correction is None else correction
        self._odd_u, self._odd_v = (_odd_partner(n) for n in self._shape)
        # The normal part alone only scales waves: its spectrum is kept for each of them.
        self._spectra = (
            spectra[:, self._odd_u[0][:, None], self._odd_v[0]] if self._axes == 1 else spectra
        )

    def product(self, field: Floats) -> Floats:
        """Return what a field (..., 3, nu, nv), or a normal one (..., nu, nv), becomes."""
        u = len(self._u)
        v = len(self._v)
        fields = field.reshape(-1, *self._shape)
        lines = (self._u @ fields).reshape(-1, self._shape[1])
        waves = (lines @ self._v_back).reshape(-1, self._axes, u, v)
        out = np.empty_like(waves)
        if self._axes == 3:
            _mix(self._spectra, *self._odd_u, *self._odd_v, self._correction, waves, out)
        else:
            self._scale(waves, out)
        back = (out.reshape(-1, v) @ self._v).reshape(-1, u, self._shape[1])
        return np.asarray(self._u_back @ back).reshape(field.shape)

    def on_cells(self, cell: Ints, values: Floats) -> Floats:
        """Return the convolution (..., n) with values (..., n) of some cells, 0 in all others, in
        those cells."""
        field = np.zeros((*values.shape[:-1], self._shape[0] * self._shape[1]))
        field[..., cell] = values
        made = self.product(field.reshape(*values.shape[:-1], *self._shape))
        return np.asarray(made.reshape(field.shape)[..., cell])

    def _scale(self, waves: Floats, out: Floats) -> None:
        """Set ``out`` (b, 1, u, v) to waves and polynomials of a normal field times the spectrum
        and correction."""
        _, u, v = self._spectra.shape
        np.multiply(waves[:, :, :u, :v], self._spectra, out=out[:, :, :u, :v])
        if len(self._correction):
            out[:, :, u:] = 0.0
            out[:, :, :u, v:] = 0.0
            polynomials = waves[:, :, u:, v:]
            made = polynomials.reshape(len(waves), -1) @ self._correction.T
            out[:, :, u:, v:] = made.reshape(polynomials.shape)


@lru_cache(maxsize=64)
def _waves(n: int) -> Floats:
    """Return (2 n - 1, n) a constant, n - 1 cosines and n - 1 sines, orthonormal on 2 n - 1 places,
    at n of them."""
    angle = 2.0 * np.pi / (2 * n - 1) * np.outer(np.arange(n), np.arange(n))
    wave = np.concatenate([np.cos(angle), np.sin(angle[1:])]) * np.sqrt(2.0 / (2 * n - 1))
    wave[0] *= np.sqrt(0.5)
    return frozen(wave)


@lru_cache(maxsize=64)
def _summing(n: int, odd: bool) -> Floats:
    """Return (n, n) that sums a kernel, given at offsets from 0 on, over all offsets times a cosine
    (a sine if odd)."""
    angle = 2.0 * np.pi / (2 * n - 1) * np.outer(np.arange(n), np.arange(n))
    whole = 2.0 * (np.sin(angle) if odd else np.cos(angle))
    whole[:, 0] /= 2.0
    return frozen(whole)


@lru_cache(maxsize=64)
def _odd_partner(n: int) -> tuple[Ints, Ints, Floats]:
    """Return (2 n - 1,) each wave's frequency, the wave that an odd kernel makes it of, and with
    which sign."""
    k = np.arange(1, n)
    frequency = np.concatenate([[0], k, k])
    partner = np.concatenate([[0], k + n - 1, k])
    sign = np.concatenate([[0.0], np.full(n - 1, -1.0), np.ones(n - 1)])
    return frequency, partner, sign


@njit(cache=True)
def _mix(
    m: Floats,
    of_u: Ints,
    other_u: Ints,
    sign_u: Floats,
    of_v: Ints,
    other_v: Ints,
    sign_v: Floats,
    correction: Floats,
    f: Floats,
    out: Floats,
) -> None:
    """Set ``out`` (b, 3, u, v) to what spectra and correction make of waves and polynomials ``f``;
    compiled, as NumPy takes a dozen passes through memory."""
    nu = len(of_u)
    nv = len(of_v)
    for b in range(f.shape[0]):
        for i in range(nu):
            p = other_u[i]
            su = sign_u[i]
            for j in range(nv):
                q = other_v[j]
                sv = sign_v[j]
                k = of_u[i]
                n = of_v[j]
                xy = su * sv * m[1, k, n]
                xz = su * m[3, k, n]
                yz = sv * m[4, k, n]
                out[b, 0, i, j] = (
                    m[0, k, n] * f[b, 0, i, j] + xy * f[b, 1, p, q] + xz * f[b, 2, p, j]
                )
                out[b, 1, i, j] = (
                    m[2, k, n] * f[b, 1, i, j] + xy * f[b, 0, p, q] + yz * f[b, 2, i, q]
                )
                out[b, 2, i, j] = (
                    m[5, k, n] * f[b, 2, i, j] - xz * f[b, 0, p, j] - yz * f[b, 1, i, q]
                )
    # The correction maps polynomials to polynomials; products of a polynomial with a wave carry
    # nothing.
    out[:, :, nu:] = 0.0
    out[:, :, :nu, nv:] = 0.0
    if len(correction):
        for b in range(len(f)):
            made = np.dot(correction, f[b, :, nu:, nv:].copy().reshape(-1))
            out[b, :, nu:, nv:] = made.reshape(f[b, :, nu:, nv:].shape)


class _LatticeInverse:
    """Approximate inverse of the compliance over its unit between patches at places (k, 2) of a
    lattice: its kernel's (6, nu, nv), wave by wave."""

    def __init__(self, place: Ints, inverse: Floats) -> None:
        self._cell = place[:, 0] * inverse.shape[2] + place[:, 1]
        self._inverse = inverse

    @cached_property
    def _whole(self) -> _Convolution:
        return _Convolution(self._inverse)

    @cached_property
    def _normal(self) -> _Convolution:
        return _Convolution(self._inverse[_ZZ:])

    def force(self, rows: Ints, displacement: Floats) -> Floats:
        return self._whole.on_cells(self._cell[rows], displacement)

    def push(self, rows: Ints, depth: Floats) -> Floats:
        return self._normal.on_cells(self._cell[rows], depth)


class LatticeInfluence(Influence):
    """A compliance of equal patches on a lattice, as a convolution.

    Parameters
    ----------
    place
        (k, 2) whole numbers of steps of each patch along the lattice's sides.
    kernel
        (nu, nv, 3, 3) compliance by offset; one to the other side has its parity.
    inverse
        (6, nu, nv) as of `_inverse_of`, of the compliance over its unit.
    correction
        (3, M, 3, M) smooth correction between M = m x m nodes; None for none.
    """

    def __init__(
        self, place: Ints, kernel: Floats, inverse: Floats, correction: Floats | None
    ) -> None:
        self._inverse = inverse
        self._place = place
        self._kernel = kernel
        self._shape = kernel.shape[:2]
        self._cell = place[:, 0] * kernel.shape[1] + place[:, 1]
        self.unit = float(np.mean(np.diag(kernel[0, 0])))
        self._correction = None
        self._nodes = NODES[0]
        if correction is not None:
            self._correction = np.ascontiguousarray(correction.reshape(3 * correction.shape[1], -1))
            self._nodes = math.isqrt(correction.shape[1])

    def __len__(self) -> int:
        return len(self._cell)

    @classmethod
    def between(cls, patches: Patches, compliance: object) -> LatticeInfluence | None:
        """Return the compliance between patches; None where they are no lattice, or few."""
        if len(patches) < FEWEST or not isinstance(compliance, _PlaneCompliance):
            return None
        frame = patches.frames[0]
        step = 2.0 * patches.half_mm[0]
        equal = np.ptp(patches.half_mm, axis=0).max() <= _ROUND_OFF * step.min()
        if not equal or np.any(np.ptp(patches.frames, axis=0)):
            return None
        middle = (patches.centre_mm - patches.centre_mm[0]) @ frame.T
        place = _on_lattice(middle[:, :2], step)
        if place is None or np.abs(middle[:, 2]).max() > _ROUND_OFF * step.min():
            return None
        origin = patches.centre_mm[0] + middle[:, :2].min(axis=0) @ frame[:2]
        shape = place.max(axis=0) + 1
        kernel = _kernel(compliance, shape, patches, step)
        inverse = _inverse_of(_spectra_of(kernel / np.mean(np.diag(kernel[0, 0]))))
        if inverse is None:
            return None
        correction: Floats | None = None
        for m in NODES:
            at_nodes = [_nodes(int(n), m) * side for n, side in zip(shape, step, strict=True)]
            correction = _correction(patches, compliance, at_nodes, origin)
            if correction is None:
                return None
            if _last_term(correction, m) <= _SMALL * float(kernel[0, 0].max()):
                break
        smooth = correction if correction is not None and correction.any() else None
        return cls(place, kernel, inverse, smooth)

    @cached_property
    def own(self) -> Floats:
        """(k,) own normal compliances; the correction, a hundredth of them, is left out."""
        return np.full(len(self), self._kernel[0, 0, 2, 2])

    @cached_property
    def _preconditioner(self) -> _LatticeInverse:
        return _LatticeInverse(self._place, self._inverse)

    @cached_property
    def _sides(self) -> tuple[Floats, Floats]:
        """(nu, m) and (nv, m) Lagrange's polynomials of the nodes along either side."""
        u, v = (
            Axis.lagrange(_nodes(n, self._nodes)).basis(np.arange(float(n))) for n in self._shape
        )
        return u, v

    @cached_property
    def _whole(self) -> _Convolution:
        return _Convolution(_spectra_of(self._kernel), self._correction, self._sides)

    @cached_property
    def _normal(self) -> _Convolution:
        correction = None if self._correction is None else self._normal_correction
        return _Convolution(_spectra_of(self._kernel, (_ZZ,)), correction, self._sides)

    def apply(self, force: Floats) -> Floats:
        return self._whole.on_cells(self._cell, force.T).T

    def normal_displacement(self, push: Floats) -> Floats:
        return self._normal.on_cells(self._cell, push)

    def product(self, rows: Ints, force: Floats) -> Floats:
        return self._whole.on_cells(self._cell[rows], force) / self.unit

    def block(self, rows: Ints) -> Floats:
        n = len(rows)
        part = self._by_offset.reshape(-1, 3, 3)[self._offsets(rows, rows)]
        block = np.ascontiguousarray(part.transpose(0, 2, 1, 3))
        if self._correction is not None:
            m = len(self._correction) // 3
            weights = self._weights[rows]
            half = np.tensordot(weights, self._correction.reshape(3, m, 3, m), (1, 1))
            block += (half @ weights.T).transpose(0, 1, 3, 2).reshape(n, 3, n, 3)
        return block

    @cached_property
    def _by_offset(self) -> Floats:
        """(2 nu - 1, 2 nv - 1, 3, 3) the kernel by signed offset, odd where one of its axes is the
        offset's."""
        u, v = (np.arange(1 - n, n) for n in self._shape)
        signs = np.ones((len(u), len(v), 3))
        signs[u < 0, :, 0] = -1.0
        signs[:, v < 0, 1] = -1.0
        return (
            self._kernel[np.abs(u)[:, None], np.abs(v)] * signs[..., :, None] * signs[..., None, :]
        )

    def normal_block(self, rows: Ints, columns: Ints) -> Floats:
        part = self._by_offset[..., 2, 2].reshape(-1)[self._offsets(rows, columns)]
        if self._correction is not None:
            part = part + self._weights[rows] @ self._normal_correction @ self._weights[columns].T
        return np.asarray(part)

    def _offsets(self, rows: Ints, columns: Ints) -> Ints:
        """Return (n, m) where the signed offsets between patches are in the flattened
        `_by_offset`."""
        nu, nv = self._shape
        line = self._place[:, 0] * (2 * nv - 1) + self._place[:, 1]
        zero = (nu - 1) * (2 * nv - 1) + nv - 1
        return np.asarray(line[rows][:, None] - line[columns] + zero)

    @cached_property
    def _normal_correction(self) -> Floats:
        assert self._correction is not None
        first = 2 * len(self._correction) // 3
        return np.ascontiguousarray(self._correction[first:, first:])

    @cached_property
    def _weights(self) -> Floats:
        """(k, M) how much each node counts at each patch."""
        u, v = (side[self._place[:, axis]] for axis, side in enumerate(self._sides))
        return np.asarray(
            (u[:, :, None] * v[:, None, :]).reshape(len(self), u.shape[1] * v.shape[1])
        )


def _nodes(count: int, m: int) -> Floats:
    """Return (m,) Chebyshev nodes over the places 0, ..., count - 1."""
    half = max(count - 1, 1) / 2.0
    return np.asarray(half - half * np.cos((np.arange(m) + 0.5) * np.pi / m))


def _last_term(correction: Floats, m: int) -> float:
    """Return the largest coefficient of the highest polynomial along any side of a correction (3,
    M, 3, M)."""
    last = np.cos((m - 1) * (np.arange(m) + 0.5) * np.pi / m) * 2.0 / m
    sides = correction.reshape(3, m, m, 3, m, m)
    return max(float(np.abs(np.tensordot(last, sides, (0, axis))).max()) for axis in (1, 2))


def _kernel(compliance: _PlaneCompliance, shape: Ints, patches: Patches, step: Floats) -> Floats:
    """Return (nu, nv, 3, 3) the compliance by offset, in the patches' frame."""
    frame = patches.frames[0]
    away = [np.arange(count) * side for count, side in zip(shape, step, strict=True)]
    flat = np.stack(np.meshgrid(*away, indexing="ij"), axis=-1).reshape(-1, 2)
    one = patches.rectangles(np.zeros((1, 3)), np.zeros(1, int))
    kernel = compliance.offset_part(patches.centre_mm[0] + flat @ frame[:2], one).reshape(
        *shape, 3, 3
    )
    return np.asarray(frame @ kernel @ frame.T)


def _correction(
    patches: Patches, compliance: _PlaneCompliance, along: list[Floats], origin: Floats
) -> Floats | None:
    """Return (3, M, 3, M) the symmetric correction between the nodes, in the patches' frame."""
    frame = patches.frames[0]
    flat = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
    count = len(flat)
    at_nodes = Rectangles(
        centre_mm=origin + flat @ frame[:2],
        frames=np.tile(frame, (count, 1, 1)),
        half_mm=np.tile(patches.half_mm[0], (count, 1)),
        force_n=np.zeros((count, 3)),
    )
    found = compliance.smooth_part(patches.unloaded, at_nodes)
    if found is None:
        return None
    turned = frame @ found.reshape(count, 3, count, 3).swapaxes(1, 2) @ frame.T
    flat_correction = turned.transpose(2, 0, 3, 1).reshape(3 * count, 3 * count)
    return np.asarray((flat_correction + flat_correction.T).reshape(3, count, 3, count) / 2.0)


_EQUAL = 1e-6
"""Largest relative difference of cells that count as equal."""


class _BlockInverse:
    """The inverses of the normal and of the tangential block of a compliance (k, 3, k, 3) over a
    unit, by Cholesky."""

    def __init__(self, compliance: Floats, unit: float) -> None:
        self._compliance = compliance
        self._unit = unit

    @cached_property
    def _normal(self) -> Floats | None:
        return self._factor(self._compliance[:, -1, :, -1])

    @cached_property
    def _tangential(self) -> Floats | None:
        k = len(self._compliance)
        return self._factor(
            self._compliance[:, :2, :, :2].transpose(1, 0, 3, 2).reshape(2 * k, 2 * k)
        )

    def _factor(self, block: Floats) -> Floats | None:
        factor, wrong = lapack.dpotrf(block / self._unit, lower=1, clean=0)
        return None if wrong else factor

    def force(self, rows: Ints, displacement: Floats) -> Floats:
        m = len(displacement)
        whole = np.zeros((m, 3, len(self._compliance)))
        whole[..., rows] = displacement
        tangential = _factored_solve(self._tangential, whole[:, :2].reshape(m, -1))
        tangential = tangential.reshape(m, 2, -1)
        normal = _factored_solve(self._normal, whole[:, 2])
        return np.concatenate([tangential, normal[:, None]], axis=1)[..., rows]

    def push(self, rows: Ints, depth: Floats) -> Floats:
        whole = np.zeros((1, len(self._compliance)))
        whole[0, rows] = depth
        return np.asarray(_factored_solve(self._normal, whole)[0, rows])


def _factored_solve(factor: Floats | None, right: Floats) -> Floats:
    """Return the solutions (m, n) for right-hand sides (m, n); NaN for a matrix that is not
    definite."""
    if factor is None:
        return np.full_like(right, np.nan)
    return np.asarray(lapack.dpotrs(factor, right.T, lower=1)[0].T)


class _JoinedInverse:
    """The inverses of several probes' patches, each by itself: between the patches' ``ends``."""

    def __init__(self, parts: Sequence[_Preconditioner], ends: Ints) -> None:
        self._parts = parts
        self._ends = ends

    def force(self, rows: Ints, displacement: Floats) -> Floats:
        pieces = [
            one.force(rows[piece] - first, np.ascontiguousarray(displacement[..., piece]))
            for one, first, piece in self._pieces(rows)
        ]
        return np.concatenate(pieces, axis=-1)

    def push(self, rows: Ints, depth: Floats) -> Floats:
        pushes = [
            one.push(rows[piece] - first, depth[piece]) for one, first, piece in self._pieces(rows)
        ]
        return np.concatenate(pushes)

    def _pieces(self, rows: Ints) -> list[tuple[_Preconditioner, int, slice]]:
        """Return every probe's inverse, its first patch, and its piece of the ascending
        ``rows``."""
        cuts = np.searchsorted(rows, self._ends)
        pieces = [slice(low, high) for low, high in pairwise(cuts.tolist())]
        return list(zip(self._parts, self._ends[:-1].tolist(), pieces, strict=True))


def _half_space_inverse(patches: Patches, poisson_ratio: float) -> _LatticeInverse | None:
    """Return the preconditioner of one probe's patches; None where their cells are not equal."""
    cell = 2.0 * patches.cell_mm[0]
    if np.ptp(patches.cell_mm, axis=0).max() > _EQUAL * cell.min():
        return None
    place = _on_lattice(patches.middle_mm, cell)
    if place is None:
        return None
    shape = (place.max(axis=0) + 1).tolist()
    half = patches.half_mm.mean(axis=0)
    steps = np.stack(np.meshgrid(*(np.arange(n) for n in shape), [0.0], indexing="ij"), axis=-1)
    one = Rectangles(
        centre_mm=np.zeros((1, 3)),
        frames=np.eye(3)[None],
        half_mm=half[None],
        force_n=np.zeros((1, 3)),
    )
    away = steps.reshape(-1, 3) * [*2.0 * half, 1.0]
    kernel = halfspace.compliance(away, one, 1.0, poisson_ratio).reshape(*shape, 3, 3)
    inverse = _inverse_of(_spectra_of(kernel / np.mean(np.diag(kernel[0, 0]))))
    return None if inverse is None else _LatticeInverse(place, inverse)


class DenseInfluence(Influence):
    """A compliance that is stored as a symmetric ``matrix`` (k, 3, k, 3), mm/N; of the methods for
    normal forces alone (k, 1, k, 1) will do.

    Its preconditioner is made of the patches under each probe and the body's Poisson's ratio, or of
    the matrix.
    """

    def __init__(
        self, matrix: Floats, grids: Sequence[Patches] = (), poisson_ratio: float = 0.5
    ) -> None:
        k = len(matrix)
        self._matrix = matrix
        self._of = grids, poisson_ratio
        self.unit = float(np.einsum("iaia->", matrix)) / (k * matrix.shape[1])

    def __len__(self) -> int:
        return len(self._matrix)

    @cached_property
    def own(self) -> Floats:
        return np.array(np.diagonal(self._matrix[:, -1, :, -1]))

    @cached_property
    def _normal(self) -> Floats:
        return np.ascontiguousarray(self._matrix[:, -1, :, -1])

    @cached_property
    def _preconditioner(self) -> _Preconditioner:
        grids, poisson_ratio = self._of
        if not grids:
            return _BlockInverse(self._matrix, self.unit)
        parts: list[_Preconditioner] = []
        ends = np.cumsum([0, *map(len, grids)])
        for grid, (first, end) in zip(grids, pairwise(ends.tolist()), strict=True):
            found = _half_space_inverse(grid, poisson_ratio)
            own = self._matrix[first:end, :, first:end]
            parts.append(found or _BlockInverse(own, self.unit))
        return parts[0] if len(parts) == 1 else _JoinedInverse(parts, ends)

    def apply(self, force: Floats) -> Floats:
        size = 3 * len(self)
        moved = blas.dsymv(1.0, self._matrix.reshape(size, size).T, force.reshape(-1))
        return np.asarray(moved).reshape(-1, 3)

    def normal_displacement(self, push: Floats) -> Floats:
        return np.asarray(blas.dsymv(1.0, self._normal.T, push))

    def block(self, rows: Ints) -> Floats:
        size = 3 * len(self)
        flat = (3 * rows[:, None] + np.arange(3)).reshape(-1)
        part = self._matrix.reshape(size, size)[np.ix_(flat, flat)]
        return np.asarray(part.reshape(len(rows), 3, len(rows), 3))

    def normal_block(self, rows: Ints, columns: Ints) -> Floats:
        return np.asarray(self._normal[np.ix_(rows, columns)])
