"""What a transfer matrix can tell, without any picture: singular values, expected estimate and its noise.

The same estimator as the sensor's (`twin.sense.weigh`): with the whitened transfer matrix H and the penalty Q = L L^T,
the eigenvalues S^2 of L^-1 H^T H L^-T = V S^2 V^T give every weight's answer. Taking them from the smaller H^T H costs
digits only where S is below 1e-6 of the largest, far below any noise. By mirror symmetry there are up to four such
problems of a quarter of the size (`twin.study.sweep.mirror`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg

from twin.arrays import Floats
from twin.parts.pipeline import Reconstruction
from twin.sense.problem import PENALTIES
from twin.sense.weigh import RULES, Spectrum
from twin.study.sweep.mirror import Signs, component_signs, fold, fold_one, unfold

LEAST = 1e-12
"""Squared singular values below this share of the largest are round-off."""


@dataclass(frozen=True, kw_only=True)
class Sector:
    """One class's factors.

    Attributes
    ----------
    signs
        Of the class.
    squared
        (r,) S^2.
    vectors
        (r, r) V.
    roots
        L^-1 by component of the force, as the penalty mixes none: (r_c, r_c) each.
    whitened
        (m, r) H L^-T.
    """

    signs: Signs
    squared: Floats
    vectors: Floats
    roots: tuple[Floats, ...]
    whitened: Floats

    def back(self, reduced: Floats) -> Floats:
        """Return the class's (r, q) forces L^-T V of (r, q) reduced unknowns."""
        out = self.vectors @ reduced
        for part, root in _parts(self.roots):
            out[part] = root.T @ out[part]
        return out

    def seen(self, rows: Floats) -> Floats:
        """Return (q, r) what (q, r) rows over the class's forces make of reduced unknowns."""
        return _through(self.roots, rows) @ self.vectors


@dataclass(frozen=True, kw_only=True)
class Information:
    """A design's linear problem.

    Attributes
    ----------
    blocks
        By class.
    grid
        (columns, rows) of the sites.
    count
        Number of data (2 for every marker used).
    """

    blocks: tuple[Sector, ...]
    grid: tuple[int, int]
    count: int

    @property
    def singular(self) -> Floats:
        """(r,) singular values in the penalty's metric, the largest first."""
        return np.asarray(np.sqrt(np.sort(np.concatenate([b.squared for b in self.blocks]))[::-1]))

    def reduced(self, data: Sequence[Floats]) -> list[Floats]:
        """Return by class the (r, loads) products V^T L^-1 H^T d of whitened, folded (m, loads) data."""
        return [b.vectors.T @ (b.whitened.T @ d) for b, d in zip(self.blocks, data, strict=True)]

    def spectrum(self, reduced: Sequence[Floats], energy: float) -> Spectrum:
        """Return the spectrum to expect on average over the loads and the noise.

        Parameters
        ----------
        reduced
            See `reduced`; of noise-free data.
        energy
            Mean over the loads of |d|^2 without noise.
        """
        squared = np.concatenate([block.squared for block in self.blocks])
        told = np.concatenate([np.mean(b**2, axis=1) for b in reduced])
        seen = squared > LEAST * squared.max(initial=0.0)
        parts = np.where(seen, told / np.where(seen, squared, 1.0), 0.0)
        noise = max(self.count - len(squared), 0)
        rest = max(energy - float(parts.sum()), 0.0) + noise
        return Spectrum(squared=squared, energy=parts + 1.0, rest=rest, count=self.count)

    def weight(self, wanted: Reconstruction, seen: Spectrum, mean_noise: float) -> float:
        """Return the whitened weight that the sensor's software would use.

        Parameters
        ----------
        wanted
            Method and weight of the scene.
        seen
            What is expected of the data.
        mean_noise
            Mean of the markers' noise, px, for a weight that the scene gives in px^2/N^2.
        """
        if wanted.method == "pinv":
            return 0.0
        if isinstance(wanted.weight, str):
            return RULES[wanted.weight](seen)
        return float(wanted.weight) / (2.0 * mean_noise**2)

    def forces(self, reduced: Sequence[Floats], weight: float) -> Floats:
        """Return (k, 3, loads) expected forces, N."""
        shape = (*self.grid, 3)
        out: Floats = np.zeros(())
        for block, b in zip(self.blocks, reduced, strict=True):
            x = block.back(self._inverse(block, weight)[:, None] * b)
            out = out + unfold(x, block.signs, shape)
        return np.asarray(out.reshape(self.grid[0] * self.grid[1], 3, -1))

    def noise(self, rows: Floats, weight: float) -> Floats:
        """Return (q, q) covariance of ``rows`` (q, 3k) times the estimate, by the noise alone."""
        total = np.zeros((len(rows), len(rows)))
        for block in self.blocks:
            folded = fold(rows.T.reshape(*self.grid, 3, -1), block.signs)
            seen = block.seen(folded.T)
            total += (seen * (block.squared * self._inverse(block, weight) ** 2)) @ seen.T
        return total

    def _inverse(self, block: Sector, weight: float) -> Floats:
        if weight > 0:
            return np.asarray(1.0 / (block.squared + weight))
        cut = LEAST * max(b.squared.max(initial=0.0) for b in self.blocks)
        seen = block.squared > cut
        return np.where(seen, 1.0 / np.where(seen, block.squared, 1.0), 0.0)


def information(
    transfers: Sequence[Floats], signs: Sequence[Signs], grid: tuple[int, int], method: str, count: int
) -> Information:
    """Factorise whitened transfer matrices, one (m, r) by class.

    Parameters
    ----------
    transfers, signs
        By class: the matrix between orthonormal parts, and the class.
    grid
        (columns, rows) of the sites.
    method
        See `twin.sense.problem.penalty`.
    count
        Number of data in all.
    """
    blocks = []
    for transfer, each in zip(transfers, signs, strict=True):
        roots = tuple(_inverse_factor(grid, method, part) for part in component_signs(each, 3))
        whitened = _through(roots, transfer)
        squared, vectors = np.linalg.eigh(whitened.T @ whitened)
        sector = Sector(
            signs=each, squared=np.maximum(squared, 0.0), vectors=vectors, roots=roots, whitened=whitened
        )  # fmt: skip
        blocks.append(sector)
    return Information(blocks=tuple(blocks), grid=grid, count=count)


def _parts(roots: tuple[Floats, ...]) -> Iterator[tuple[slice, Floats]]:
    """Yield each component's places among a class's forces, and its L^-1."""
    start = 0
    for root in roots:
        yield slice(start, start + len(root)), root
        start += len(root)


def _through(roots: tuple[Floats, ...], rows: Floats) -> Floats:
    """Return (m, r) rows times L^-T."""
    out = np.empty(rows.shape)
    for part, root in _parts(roots):
        np.matmul(rows[:, part], root.T, out=out[:, part])
    return out


@lru_cache(maxsize=64)
def _inverse_factor(grid: tuple[int, int], method: str, signs: Signs) -> Floats:
    """Return L^-1 of the penalty's part on a component that goes by ``signs``; its condition is small."""
    half = fold_one(PENALTIES[method](*grid).reshape(*grid, -1), signs)
    folded = fold_one(half.T.reshape(*grid, -1), signs)
    lower = np.linalg.cholesky((folded + folded.T) / 2)
    return np.asarray(scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True), np.float64)
