"""Products with a compliance that depends on the offset between patches only, on a lattice of equal patches, by FFT.

With patches at the points of a lattice, u_i = sum over j of K(i - j) f_j is a convolution. Padded with as many zeros,
it is a product in Fourier space (circular convolution theorem). An elastic plane's kernel has parities: moved along and
across itself it is even, and between the normal and a tangential axis odd. So its spectrum is one real symmetric 3 x 3
matrix M a wave, K^ = D M D* with D = diag(1, 1, -i), and so is the spectrum of its inverse.

Why the inverse: taken wave by wave on the padded lattice and cut to the patches in contact, it is the nearest thing to
the true inverse that costs no more than a product (E. A. H. Vollebregt, J. Optim. Theory Appl. 162 (2014) 931): with it
conjugate gradients need ten products for twelve digits, whatever the number of patches; without it, forty or more.

Why numba: six real spectra times three complex fields are a dozen passes through memory in NumPy, and one here.

Why the normal part has transforms of its own: its kernel is even along either side, so that cosines and sines are its
waves and its spectrum is real (`Even`). On a few dozen patches a side, matrices of these are faster than any FFT.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from scipy import fft

from twin.arrays import Floats, Ints
from twin.compiled import njit

Complexes: TypeAlias = Any
"""Complex arrays."""

XX, XY, YY, XZ, YZ, ZZ = range(6)


class Convolution:
    """A kernel on a padded lattice, in Fourier space.

    Parameters
    ----------
    spectra
        (6, Lu, Lv/2 + 1) the matrices M: xx, xy, yy, xz, yz, zz.
    padded
        (Lu, Lv) size of the padded lattice.
    """

    def __init__(self, spectra: Floats, padded: tuple[int, int]) -> None:
        self.padded, self._spectra = padded, spectra

    @cached_property
    def single(self) -> Convolution:
        """The same in single precision, for fields that are."""
        return Convolution(self._spectra.astype(np.float32), self.padded)

    @classmethod
    def of_kernel(cls, kernel: Floats) -> Convolution:
        """Return the convolution with a kernel (Lu, Lv, 3, 3) whose offsets wrap around: -1 is the last."""
        spectrum = fft.rfft2(kernel, axes=(0, 1))
        even, odd = spectrum.real, spectrum.imag
        spectra = [even[..., 0, 0], even[..., 0, 1], even[..., 1, 1], odd[..., 0, 2], odd[..., 1, 2], even[..., 2, 2]]
        return cls(np.ascontiguousarray(spectra), (kernel.shape[0], kernel.shape[1]))

    @property
    def inverse(self) -> Convolution | None:
        """The inverses, wave by wave, of the tangential and of the normal part; None where one is not positive."""
        xx, xy, yy, _, _, zz = self._spectra
        det = xx * yy - xy * xy
        if not (det.min() > 0.0 and xx.min() > 0.0 and zz.min() > 0.0):
            return None
        none = np.zeros_like(zz)
        return Convolution(np.stack([yy / det, -xy / det, xx / det, none, none, 1.0 / zz]), self.padded)

    def product(self, field: Floats) -> Floats:
        """Return the convolution of a vector field (..., 3, nu, Lv), 0 where the lattice is padded."""
        waves = self._forward(field)
        _multiply(self._spectra, waves.reshape(-1, *waves.shape[-3:]))
        return self._back(waves, field.shape[-2])

    def normal(self, shape: tuple[int, int], precision: type[np.floating[Any]]) -> Even:
        """Return the normal part of the convolution, for normal fields of a shape (nu, nv)."""
        return Even(self._spectra[ZZ], self.padded, shape, precision)

    def _forward(self, field: Floats) -> Complexes:
        nu, (lu, lv) = field.shape[-2], self.padded
        waves = np.zeros((*field.shape[:-2], lu, lv // 2 + 1), np.result_type(field, np.complex64))
        waves[..., :nu, :] = fft.rfft(field, axis=-1)
        return fft.fft(waves, axis=-2, overwrite_x=True)

    def _back(self, waves: Complexes, nu: int) -> Floats:
        lines = fft.ifft(waves, axis=-2, overwrite_x=True)[..., :nu, :]
        return np.asarray(fft.irfft(lines, self.padded[1], axis=-1))


class Even:
    """A scalar kernel that is even along both sides of a padded lattice, in waves that are cosines and sines.

    Parameters
    ----------
    spectrum
        (Lu, Lv/2 + 1) the kernel's real spectrum.
    padded
        (Lu, Lv) size of the padded lattice.
    shape
        (nu, nv) size of the fields.
    precision
        Of the products.
    """

    def __init__(
        self, spectrum: Floats, padded: tuple[int, int], shape: tuple[int, int], precision: type[np.floating[Any]]
    ) -> None:
        (u, of_u), (v, of_v) = (_waves(n, length) for n, length in zip(shape, padded, strict=True))
        self._u, self._v = u.astype(precision), v.astype(precision)
        self._u_back, self._v_back = np.ascontiguousarray(self._u.T), np.ascontiguousarray(self._v.T)
        self._size = spectrum[np.ix_(of_u, of_v)].astype(precision)

    def product(self, field: Floats) -> Floats:
        """Return the convolution with a field (nu, nv)."""
        waves = self._u @ field @ self._v_back
        waves *= self._size
        return np.asarray(self._u_back @ waves @ self._v)


def _waves(count: int, length: int) -> tuple[Floats, Ints]:
    """Return (L, n) orthonormal cosines, then sines, of L places at the first n of them, and (L,) their frequencies."""
    k = np.concatenate([np.arange(length // 2 + 1), np.arange(1, (length + 1) // 2)])
    angle = 2.0 * np.pi / length * np.outer(k, np.arange(count))
    is_sine = np.arange(length) > length // 2
    once = (2 * k % length == 0) & ~is_sine
    wave = np.where(is_sine[:, None], np.sin(angle), np.cos(angle))
    return wave * np.where(once, length**-0.5, (length / 2.0) ** -0.5)[:, None], k


def padded_size(shape: tuple[int, int]) -> tuple[int, int]:
    """Return sizes of at least 2 n - 1 for which transforms are fast."""
    return int(fft.next_fast_len(2 * shape[0] - 1, True)), int(fft.next_fast_len(2 * shape[1] - 1, True))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _multiply(m: Floats, f: Complexes) -> None:
    """Replace (b, 3, Lu, Lh) fields by D M D* times them."""
    for b in range(f.shape[0]):
        for i in range(f.shape[2]):
            for j in range(f.shape[3]):
                x, y, z = f[b, 0, i, j], f[b, 1, i, j], f[b, 2, i, j]
                xz, yz = m[3, i, j], m[4, i, j]
                turned, along = complex(-z.imag, z.real), xz * x + yz * y
                f[b, 0, i, j] = m[0, i, j] * x + m[1, i, j] * y + xz * turned
                f[b, 1, i, j] = m[1, i, j] * x + m[2, i, j] * y + yz * turned
                f[b, 2, i, j] = m[5, i, j] * z + complex(along.imag, -along.real)
