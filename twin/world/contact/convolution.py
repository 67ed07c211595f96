"""Products with a compliance that depends on the offset between patches only, on a lattice of equal patches.

With patches at the points of a lattice, u_i = sum over j of K(i - j) f_j is a convolution. On a lattice padded with
zeros to 2 n - 1 places a side it is circular, and its eigenvectors are cosines and sines. An elastic plane's kernel has
parities: moved along and across itself it is even, and odd, along one side, between the normal and a tangential axis
and, along both, between two tangential ones. An even kernel multiplies a wave by a number; one that is odd along a side
makes sines of cosines there, and of sines cosines with the other sign. So six real numbers a wave are all there is.

Why the inverse: taken wave by wave on the padded lattice and cut to the patches in contact, it is the nearest thing to
the true inverse that costs no more than a product (E. A. H. Vollebregt, J. Optim. Theory Appl. 162 (2014) 931): with it
conjugate gradients need ten products for twelve digits, whatever the number of patches; without it, forty or more.

Why matrices of waves and no FFT: on a few dozen patches a side they are faster than any, in half as many calls, and a
smooth rest rides along as a few more rows of them: values of its polynomials in place of waves.

Why numba: mixing six real spectra with three fields is a dozen passes through memory in NumPy, and one here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from twin.arrays import Floats, Ints, frozen
from twin.compiled import njit

XX, XY, YY, XZ, YZ, ZZ = range(6)
_AXES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))

_OFF = 1e-6
"""Share of a step that a point of a lattice may be off."""


def on_lattice(place_mm: Floats, step_mm: Floats) -> Ints | None:
    """Return how many steps (k, 2) points in a plane (k, 2) are from the lowest; None where they are on no lattice."""
    steps = (place_mm - place_mm.min(axis=0)) / step_mm
    whole = np.rint(steps).astype(int)
    return None if np.abs(steps - whole).max() > _OFF else whole


def spectra_of(kernel: Floats, chosen: Sequence[int] = range(6)) -> Floats:
    """Return (c, nu, nv) the spectra xx, xy, yy, xz, yz, zz, or some, of a kernel (nu, nv, 3, 3) of offsets from 0 on.

    Of its parts only those on and above the diagonal are read, the others follow by reciprocity.
    """
    found = []
    for part in chosen:
        a, b = _AXES[part]
        u, v = (_summing(n, (a == axis) != (b == axis)) for axis, n in enumerate(kernel.shape[:2]))
        found.append(u @ kernel[..., a, b] @ v.T)
    return np.stack(found)


def inverse_of(spectra: Floats) -> Floats | None:
    """Return the inverses, wave by wave, of the tangential and of the normal part; None where one is not positive."""
    xx, xy, yy, _, _, zz = spectra
    det = xx * yy - xy * xy
    if not (det.min() > 0.0 and xx.min() > 0.0 and zz.min() > 0.0):
        return None
    none = np.zeros_like(zz)
    return np.stack([yy / det, -xy / det, xx / det, none, none, 1.0 / zz])


class Convolution:
    """A kernel on a lattice, and a smooth rest.

    Parameters
    ----------
    spectra
        (6, nu, nv) as of `spectra_of`; (1, nu, nv) of the normal part alone.
    precision
        Of the products.
    rest, sides
        (c m m, c m m) what polynomials of m terms along either side, whose values are ``sides`` (nu, m) and (nv, m),
        make of each other, c = 3 axes or the normal alone; None for none.
    """

    def __init__(
        self, spectra: Floats, precision: type[np.floating[Any]], rest: Floats | None = None,
        sides: tuple[Floats, Floats] | None = None,
    ) -> None:  # fmt: skip
        self._axes, self._shape = 3 if len(spectra) == 6 else 1, spectra.shape[1:]
        rows = [_waves(n) for n in self._shape]
        if rest is not None and sides is not None:
            rows = [np.concatenate([wave, side.T]) for wave, side in zip(rows, sides, strict=True)]
        self._u, self._v = (np.ascontiguousarray(row, precision) for row in rows)
        self._u_back, self._v_back = np.ascontiguousarray(self._u.T), np.ascontiguousarray(self._v.T)
        self._spectra = np.ascontiguousarray(spectra, precision)
        self._rest = np.zeros((0, 0), precision) if rest is None else np.ascontiguousarray(rest, precision)

    def product(self, field: Floats) -> Floats:
        """Return what a field (..., 3, nu, nv), or a normal one (..., nu, nv), becomes."""
        fields = field.reshape(-1, *self._shape)
        waves = ((self._u @ fields).reshape(-1, self._shape[1]) @ self._v_back).reshape(
            -1, self._axes, len(self._u), len(self._v)
        )
        out = np.empty_like(waves)
        (_mix if self._axes == 3 else _scale)(self._spectra, self._rest, waves, out)
        lines = (out.reshape(-1, len(self._v)) @ self._v).reshape(-1, len(self._u), self._shape[1])
        return np.asarray(self._u_back @ lines).reshape(field.shape)


@lru_cache(maxsize=64)
def _waves(n: int) -> Floats:
    """Return (2 n - 1, n) a constant, n - 1 cosines and n - 1 sines, orthonormal on 2 n - 1 places, at n of them."""
    angle = 2.0 * np.pi / (2 * n - 1) * np.outer(np.arange(n), np.arange(n))
    wave = np.concatenate([np.cos(angle), np.sin(angle[1:])]) * np.sqrt(2.0 / (2 * n - 1))
    wave[0] *= np.sqrt(0.5)
    return frozen(wave)


@lru_cache(maxsize=64)
def _summing(n: int, odd: bool) -> Floats:
    """Return (n, n) what sums a kernel, given at offsets from 0 on, over all offsets times a cosine (a sine if odd)."""
    angle = 2.0 * np.pi / (2 * n - 1) * np.outer(np.arange(n), np.arange(n))
    whole = 2.0 * (np.sin(angle) if odd else np.cos(angle))
    whole[:, 0] /= 2.0
    return frozen(whole)


@njit(cache=True)
def _partners(n: int) -> tuple[Ints, Ints, Floats]:
    """Return (2 n - 1,) each wave's frequency, the wave that an odd kernel makes it of, and with which sign."""
    size = 2 * n - 1
    frequency, partner, sign = np.zeros(size, np.int64), np.zeros(size, np.int64), np.zeros(size)
    for k in range(1, n):
        frequency[k], partner[k], sign[k] = k, k + n - 1, -1.0
        frequency[k + n - 1], partner[k + n - 1], sign[k + n - 1] = k, k, 1.0
    return frequency, partner, sign


@njit(cache=True)
def _mix(m: Floats, rest: Floats, f: Floats, out: Floats) -> None:
    """Set ``out`` (b, 3, Lu, Lv) to what the spectra and the rest make of fields of waves and polynomials."""
    of_u, other_u, sign_u = _partners(m.shape[1])
    of_v, other_v, sign_v = _partners(m.shape[2])
    for b in range(f.shape[0]):
        for i in range(len(of_u)):
            p, su = other_u[i], sign_u[i]
            for j in range(len(of_v)):
                q, sv = other_v[j], sign_v[j]
                k, n = of_u[i], of_v[j]
                xy, xz, yz = su * sv * m[1, k, n], su * m[3, k, n], sv * m[4, k, n]
                out[b, 0, i, j] = m[0, k, n] * f[b, 0, i, j] + xy * f[b, 1, p, q] + xz * f[b, 2, p, j]
                out[b, 1, i, j] = m[2, k, n] * f[b, 1, i, j] + xy * f[b, 0, p, q] + yz * f[b, 2, i, q]
                out[b, 2, i, j] = m[5, k, n] * f[b, 2, i, j] - xz * f[b, 0, p, j] - yz * f[b, 1, i, q]
    _add_rest(rest, len(of_u), len(of_v), f, out)


@njit(cache=True)
def _scale(m: Floats, rest: Floats, f: Floats, out: Floats) -> None:
    """Do as `_mix` for the normal part alone, (b, 1, Lu, Lv)."""
    of_u, of_v = _partners(m.shape[1])[0], _partners(m.shape[2])[0]
    for b in range(f.shape[0]):
        for i in range(len(of_u)):
            for j in range(len(of_v)):
                out[b, 0, i, j] = m[0, of_u[i], of_v[j]] * f[b, 0, i, j]
    _add_rest(rest, len(of_u), len(of_v), f, out)


@njit(cache=True)
def _add_rest(rest: Floats, lu: int, lv: int, f: Floats, out: Floats) -> None:
    """Set what lies beyond the waves: products of polynomials to what the rest makes of them, those with waves to 0."""
    out[:, :, lu:] = 0.0
    out[:, :, :lu, lv:] = 0.0
    if len(rest):
        for b in range(len(f)):
            made = np.dot(rest, f[b, :, lu:, lv:].copy().reshape(-1))
            out[b, :, lu:, lv:] = made.reshape(f[b, :, lu:, lv:].shape)
