"""Wrong vectors: Huber's estimate by modified residuals, then those far out left out altogether.

Kamiyama et al., section 5.1, say of the linear solution that it has "almost no robustness". Huber's loss is quadratic
up to a threshold and linear beyond; with a residual vector's excess over the threshold taken off the data, the plain
solve gives its minimum (Huber, Robust Statistics, 1981, sec. 7.8), so one factorisation serves all iterations.
Vectors count as a whole, both components. The scale is the median length of the residuals, which outliers hardly move.

Validity: up to a few per cent of wrong vectors spread over the picture; many beside each other look like a force.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Bools, Floats

THRESHOLD = 4.0
"""Residual length, over its scale, beyond which the loss is linear and, in the end, a vector is left out."""

RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two normal components, over their standard deviation."""


def excess(residual: Floats, share: Floats, freedom: float, *, leave_out: bool) -> tuple[Floats, Bools]:
    """Return what to take off the data, and which vectors it concerns.

    Parameters
    ----------
    residual
        (m,) whitened residuals of the data as measured.
    share
        (m,) information of the data over what whitening says, 0 for lost ones (see `twin.sense.reweigh`).
    freedom
        Degrees of freedom of the residual over m: residuals are shorter than the noise by its root.
    leave_out
        Take off the whole residual of a wrong vector rather than what is beyond the threshold.

    Returns
    -------
    excess
        (m,) whitened.
    wrong
        (m/2,) vectors beyond the threshold.
    """
    vectors, known = residual.reshape(-1, 2), share[::2] > 0
    length = np.sqrt(share[::2] * (vectors**2).sum(axis=1))
    scale = np.median(length[known]) / RAYLEIGH_MEDIAN / np.sqrt(max(freedom, 0.05))
    limit = THRESHOLD * scale
    wrong = np.asarray(length > limit)
    beyond = np.where(wrong, 1.0 if leave_out else 1.0 - limit / np.where(wrong, length, 1.0), 0.0)
    return (beyond[:, None] * vectors).ravel(), wrong
