"""The linear inverse as one matrix, for live use: forces of a frame by one product.

Its weight is fixed beforehand. Its entries are whole numbers of 16 bits, a unit for every row: the product waits
for the matrix to be read, so half the bytes take half the time. Rounding moves the forces by less than two thousandths
of their standard deviation (root mean square; at one site of 20 loads a hundredth at most), the total by less than a
millinewton (weights from 1 to 60 px^2/N^2 on the flat design at .05 px, loads of 1 to 4 N).

Why not a product of two smaller matrices: at the weights in use half of the directions still count. With 250 of them
forces are 5 % off, and with the 400 that bring it to a thousandth it reads as much.

Lost markers are left out exactly: their data are filled in with what the other markers' own reconstruction predicts
there, which gives the same forces as a solve without them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Pixels
from twin.compiled import njit
from twin.errors import InputError
from twin.parts.methods import Method
from twin.sense.calibration import Calibration
from twin.sense.problem import penalty
from twin.sense.weigh import factorise, filtered


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceMap:
    """Forces of all sites from all shifts.

    Attributes
    ----------
    matrix
        (3k, 2n) in units.
    unit
        (3k,) N/px, of every row.
    predicted
        (2n, 2n) shifts that the reconstruction predicts from measured ones.
    """

    matrix: NDArray[np.int16]
    unit: NDArray[np.float32]
    predicted: Floats

    def forces(self, shift_px: Pixels) -> NDArray[np.float32]:
        """Return (k, 3) forces, N, of (n, 2) shifts, px; NaN rows are lost markers.

        Raises
        ------
        InputError
            Not as many shifts as the map has markers, or no marker was found.
        """
        shift = np.asarray(shift_px, np.float64).ravel()
        if len(shift) != self.matrix.shape[1]:
            raise InputError(f"shifts of {len(shift) // 2} markers for a map of {self.matrix.shape[1] // 2}")
        data = np.empty(len(shift), np.float32)
        if not _narrowed(shift, data):
            data = self._filled(shift)
        out = np.empty(len(self.matrix), np.float32)
        _product(self.matrix, self.unit, data, out)
        return out.reshape(-1, 3)

    def _filled(self, data: Floats) -> NDArray[np.float32]:
        lost = ~np.isfinite(data.reshape(-1, 2)).all(axis=1).repeat(2)
        seen = ~lost
        if not seen.any():
            raise InputError("no marker was found, so there is nothing to reconstruct from")
        within = np.eye(int(lost.sum())) - self.predicted[np.ix_(lost, lost)]
        from_seen = self.predicted[np.ix_(lost, seen)] @ data[seen]
        return np.where(lost, _put(lost, np.asarray(np.linalg.solve(within, from_seen), float)), data).astype(
            np.float32
        )


def force_map(calibration: Calibration, weight: float, method: Method = "smooth") -> ForceMap:
    """Return the map of one sensor for a weight (the papers' omega, px^2/N^2, such as a `Field` has); equal noise.

    Raises
    ------
    InputError
        The weight is not finite and above 0, or the method is not linear.
    """
    if method == "local":
        raise InputError("method = 'local' is not linear in the shifts, so it has no map: use 'smooth' or 'norm'")
    if not (np.isfinite(weight) and weight > 0):
        raise InputError(f"weight = {weight} px^2/N^2: a map needs a finite one above 0")
    rows = np.repeat(calibration.calibrated, 2)
    factors = factorise(calibration.transfer[rows], penalty(calibration, method))
    matrix = np.zeros((calibration.transfer.shape[1], len(rows)))
    matrix[:, rows] = (factors.back * filtered(factors, weight / 2.0)) @ factors.left.T
    predicted = np.zeros((len(rows), len(rows)))
    predicted[rows] = calibration.transfer[rows] @ matrix
    return in_units(matrix, predicted)


def in_units(matrix: Floats, predicted: Floats) -> ForceMap:
    """Return the map of a (3k, 2n) matrix, N/px, and of the (2n, 2n) shifts that it predicts."""
    unit = np.abs(matrix).max(axis=1) / np.iinfo(np.int16).max
    unit[unit == 0] = 1.0
    return ForceMap(
        matrix=np.rint(matrix / unit[:, None]).astype(np.int16), unit=unit.astype(np.float32), predicted=predicted
    )


@njit(cache=True)
def _narrowed(shift, data):  # type: ignore[no-untyped-def]
    """Copy shifts into ``data``; whether all are finite."""
    total = 0.0
    for at in range(len(shift)):
        data[at] = shift[at]
        total += 0.0 * shift[at]
    return total == 0.0


@njit(cache=True, fastmath=True)
def _product(matrix, unit, data, out):  # type: ignore[no-untyped-def]
    """Put the product into ``out``; eight rows at a time, far from each other.

    Memory hands over eight straight reads at a time in half the time of one. Where eight parts overlap, rows are
    worked out twice.
    """
    size = (len(matrix) + 7) // 8
    apart = len(matrix) - size
    for first in range(size):
        a, b, c, d = first, first + apart // 7, first + 2 * apart // 7, first + 3 * apart // 7
        e, f, g, h = first + 4 * apart // 7, first + 5 * apart // 7, first + 6 * apart // 7, first + apart
        at_a = at_b = at_c = at_d = at_e = at_f = at_g = at_h = np.float32(0.0)
        for column in range(len(data)):
            value = data[column]
            at_a += matrix[a, column] * value
            at_b += matrix[b, column] * value
            at_c += matrix[c, column] * value
            at_d += matrix[d, column] * value
            at_e += matrix[e, column] * value
            at_f += matrix[f, column] * value
            at_g += matrix[g, column] * value
            at_h += matrix[h, column] * value
        out[a], out[b], out[c], out[d] = at_a * unit[a], at_b * unit[b], at_c * unit[c], at_d * unit[d]
        out[e], out[f], out[g], out[h] = at_e * unit[e], at_f * unit[f], at_g * unit[g], at_h * unit[h]


def _put(where: NDArray[np.bool_], values: Floats) -> Floats:
    out = np.zeros(len(where))
    out[where] = values
    return out
