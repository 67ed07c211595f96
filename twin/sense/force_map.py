"""The linear inverse as one matrix, for live use: forces of a frame, or of several sensors, by one product.

Its weight is fixed beforehand. Lost markers are left out exactly: their data are filled in with what the other
markers' own reconstruction predicts there, which gives the same forces as a solve without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Pixels
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
        (3k, 2n) N/px, single precision.
    predicted
        (2n, 2n) shifts that the reconstruction predicts from measured ones.
    """

    matrix: NDArray[np.float32]
    predicted: Floats

    def forces(self, shift_px: Pixels) -> NDArray[np.float32]:
        """Return (k, 3) forces, N, of (n, 2) shifts, px; NaN rows are lost markers."""
        data = np.asarray(shift_px, np.float32).ravel()
        if not np.isfinite(data.sum()):
            data = self._filled(np.asarray(shift_px, float).ravel())
        return (self.matrix @ data).reshape(-1, 3)

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
    return ForceMap(matrix=np.ascontiguousarray(matrix, np.float32), predicted=predicted)


def forces_of_all(maps: Sequence[ForceMap], shifts_px: Sequence[Pixels]) -> NDArray[np.float32]:
    """Return (sensors, k, 3) forces, N, of several sensors of one design, each with its own map."""
    return np.stack([one.forces(shift) for one, shift in zip(maps, shifts_px, strict=True)])


def _put(where: NDArray[np.bool_], values: Floats) -> Floats:
    out = np.zeros(len(where))
    out[where] = values
    return out
