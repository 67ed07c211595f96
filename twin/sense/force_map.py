"""The linear inverse as one matrix, for live use: forces of a frame, or of several sensors, by one product.

Its weight is fixed beforehand. Its entries are whole numbers of 16 bits, a unit for every row: the product waits
for the matrix to be read, so half the bytes take half the time. Rounding moves the forces by less than a thousandth of
their standard deviation (measured, weights from .05 to 8 on the flat design at .05 px).

Lost markers are left out exactly: their data are filled in with what the other markers' own reconstruction predicts
there, which gives the same forces as a solve without them.
"""

from __future__ import annotations

from collections.abc import Sequence
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
        """Return (k, 3) forces, N, of (n, 2) shifts, px; NaN rows are lost markers."""
        data = np.asarray(shift_px, np.float32).ravel()
        if not np.isfinite(data.sum()):
            data = self._filled(np.asarray(shift_px, float).ravel())
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


@njit(cache=True, fastmath=True)
def _product(matrix, unit, data, out):  # type: ignore[no-untyped-def]
    """Put the product into ``out``; three rows, a site's, at a time, so that the data are read less often."""
    for row in range(0, len(matrix), 3):
        x, y, z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for column in range(len(data)):
            value = data[column]
            x += np.float32(matrix[row, column]) * value
            y += np.float32(matrix[row + 1, column]) * value
            z += np.float32(matrix[row + 2, column]) * value
        out[row], out[row + 1], out[row + 2] = x * unit[row], y * unit[row + 1], z * unit[row + 2]


def forces_of_all(maps: Sequence[ForceMap], shifts_px: Sequence[Pixels]) -> NDArray[np.float32]:
    """Return (sensors, k, 3) forces, N, of several sensors of one design, each with its own map."""
    return np.stack([one.forces(shift) for one, shift in zip(maps, shifts_px, strict=True)])


def _put(where: NDArray[np.bool_], values: Floats) -> Floats:
    out = np.zeros(len(where))
    out[where] = values
    return out
