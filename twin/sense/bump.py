"""Tell a camera that was bumped between rest and press from a force: a shift that all markers share.

Under the prior of the smooth solve, shifts are forces' (H f, f drawn from N(0, Q^-1 / weight)) plus noise; a bump adds
the same two numbers to every marker. Generalised least squares gives those two and what they explain. The weight is
taken from the data less their median, so that a bump is not first taken for large forces.

Validity: forces that move all markers in view alike (a load much wider than the view) look like a bump; turns and zooms
of the camera are not looked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.sense.calibration import Calibration
from twin.sense.problem import problem_of
from twin.sense.track import Found
from twin.sense.weigh import automatic

LEAST_PX = 0.5
"""Bumps below this are not told from forces."""

EXPLAINS = 6.0
"""A bump must be this many of its own standard deviations long."""


@dataclass(frozen=True, kw_only=True)
class Bump:
    """A shift of the whole picture.

    Attributes
    ----------
    shift_px
        (2,) what all markers share, px (column, row).
    sd_px
        Its standard deviation, px.
    weight
        Whitened weight at which it was estimated; for the next picture of a sequence.
    """

    shift_px: Floats
    sd_px: float
    weight: float

    @property
    def certain(self) -> bool:
        """Whether it is too long to be noise or forces."""
        length = float(np.hypot(*self.shift_px))
        return length > LEAST_PX and length > EXPLAINS * self.sd_px


def camera_bump(found: Found, calibration: Calibration, weight: float | None = None) -> Bump:
    """Estimate the shift that all markers share beside the forces.

    Parameters
    ----------
    weight
        Of an earlier picture's `Bump`, to save the search for it.

    Raises
    ------
    InputError
        Motion and calibration don't belong together, or fewer than 2 markers are left.
    """
    problem = problem_of(found, calibration, "smooth")
    data, reweighed = problem.whiten(found.shift_px), problem.reweighed
    shared = np.column_stack([problem.whiten(np.tile(axis, (len(found.shift_px), 1))) for axis in np.eye(2)])
    if weight is None:
        usual = np.median(found.shift_px[problem.used], axis=0)
        weight = reweighed.weight(automatic, data - shared @ usual)
    left = shared - reweighed.predicted(reweighed.filled(shared, weight), weight)
    weighed = reweighed.share[:, None] * left
    normal = weighed.T @ shared
    estimate = np.asarray(np.linalg.solve(normal, weighed.T @ data), np.float64)
    scale = reweighed.noise_scale(data - shared @ estimate, weight)
    sd = scale * float(np.sqrt(np.linalg.inv(normal).diagonal().max()))
    return Bump(shift_px=estimate, sd_px=sd, weight=weight)
