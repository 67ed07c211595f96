"""How sharp, how true and how fine an estimate is: widths, two points, linearity, and what an error consists of.

Plain functions of arrays: estimates from recorded data can be judged as well, and designs from their transfer alone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError
from twin.judge.resolve import full_width


def field_errors(estimate_n: Floats, truth_n: Floats, frames: Floats | None = None) -> dict[str, float | None]:
    """Return relative errors of a force field in the 2-norm: ``all``, ``normal`` and ``tangential``.

    Parameters
    ----------
    estimate_n, truth_n
        (k, 3) forces at the sites, N; truth as `twin.judge.score.into_cells` sums it.
    frames
        (k, 3, 3) sites' frames, the inward normal last; z is the normal if not given.

    Returns
    -------
    dict
        Each error over the size of the same part of the truth; None where that is zero.
    """
    truth = np.asarray(truth_n, float)
    if np.shape(estimate_n) != truth.shape or truth.ndim != 2 or truth.shape[1] != 3:
        raise InputError(f"forces must be (k, 3) at the same sites, got {np.shape(estimate_n)} and {truth.shape}")
    error = np.asarray(estimate_n, float) - truth
    if frames is not None:
        error, truth = (np.einsum("kij,kj->ki", frames, part) for part in (error, truth))
    parts = {"all": slice(0, 3), "normal": slice(2, 3), "tangential": slice(0, 2)}
    sizes = {name: float(np.linalg.norm(truth[:, part])) for name, part in parts.items()}
    floor = 1e-12 * sizes["all"]
    return {
        name: float(np.linalg.norm(error[:, part])) / sizes[name] if sizes[name] > floor else None
        for name, part in parts.items()
    }


def error_parts(
    estimator: Floats, transfer: Floats, exact: Floats, cells_n: Floats, shift_px: Floats, noise_px: float
) -> dict[str, float]:
    """Split the error of a linear estimate R M into where it comes from.

    R M - F = R e + R (M0 - H0 F) + R (H0 - H) F + (R H - 1) F: noise, discretisation (the load isn't uniform in the
    sites' cells), model (the calibration is wrong) and smoothing (the prior).

    Parameters
    ----------
    estimator
        (3k, 2n) R, N/px.
    transfer, exact
        (2n, 3k) H that the sensor believes in and H0 of the made sensor, px/N.
    cells_n
        (k, 3) true forces F in the sites' cells, N.
    shift_px
        (n, 2) M0, shifts without noise, px.
    noise_px
        Standard deviation of a shift's component, px.

    Returns
    -------
    dict
        Sizes of ``noise`` (expected), ``discretisation``, ``model``, ``smoothing`` and ``all`` (expected) over |F|.
    """
    force, shift = np.asarray(cells_n, float).ravel(), np.asarray(shift_px, float).ravel()
    size = float(np.linalg.norm(force))
    if size == 0:
        raise InputError("an error can't be split where the true field is zero")
    parts = {
        "discretisation": estimator @ (shift - exact @ force),
        "model": estimator @ ((exact - transfer) @ force),
        "smoothing": estimator @ (transfer @ force) - force,
    }
    noise = noise_px * float(np.linalg.norm(estimator))
    sure = float(np.linalg.norm(sum(parts.values())))
    out = {name: float(np.linalg.norm(part)) / size for name, part in parts.items()}
    return {"noise": noise / size, **out, "all": float(np.hypot(noise, sure)) / size}


def half_width(place_mm: Floats, value: Floats) -> float:
    """Return the full width at half maximum of a profile around its largest value, mm, by linear interpolation.

    inf where it doesn't fall to half on either side within the profile.

    Parameters
    ----------
    place_mm, value
        (m,) places in rising order, mm, and values.
    """
    width = full_width(np.asarray(place_mm, float), np.asarray(value, float))
    return width if np.isfinite(width) else float("inf")


def widths(push_n: Floats, grid: tuple[int, int], pitch_mm: float) -> tuple[float, float]:
    """Return the full widths at half maximum of a field along s and t through its largest site, mm.

    Parameters
    ----------
    push_n
        (k,) one component of the field, s outer and t inner.
    grid, pitch_mm
        (columns, rows) of the sites and their pitch.
    """
    picture = np.asarray(push_n, float).reshape(grid)
    column, row = np.unravel_index(int(np.argmax(picture)), grid)
    along, across = (np.asarray(pitch_mm * np.arange(count), float) for count in grid)
    return half_width(along, picture[:, row]), half_width(across, picture[column])


def dip(value: Floats, first: int, second: int) -> float:
    """Return how far a profile falls between two places, over the lower of the peaks there.

    0: one hump; 1: down to nothing between them. A sharper estimate than the data allow has a small width but no more
    dip, so it is told beside the width.

    Parameters
    ----------
    value
        (m,) profile.
    first, second
        Indices of the two places; a peak is the largest value within a quarter of their distance of either.
    """
    value = np.asarray(value, float)
    if not 0 <= first < second < len(value):
        raise InputError(f"two places of a profile of {len(value)} values in rising order, got {first} and {second}")
    reach = max((second - first) // 4, 0)
    starts = [max(at - reach, 0) for at in (first, second)]
    peaks = [
        start + int(np.argmax(value[start : at + reach + 1])) for start, at in zip(starts, (first, second), strict=True)
    ]
    height = float(min(value[peaks]))
    return 1.0 - float(value[peaks[0] : peaks[1] + 1].min()) / height if height > 0 else 0.0


def linearity(applied_n: Floats, estimated_n: Floats) -> Mapping[str, float]:
    """Return how linear estimates of a rising force are.

    Parameters
    ----------
    applied_n, estimated_n
        (m,) forces, N; at least three different ones.

    Returns
    -------
    dict
        ``slope`` and ``offset_n`` of the best straight line, ``nonlinearity`` (largest deviation from it over the
        range of estimates), ``resolution_n`` (standard deviation about it, as a force that was applied) and
        ``correlation``.
    """
    applied, estimated = np.asarray(applied_n, float), np.asarray(estimated_n, float)
    if applied.shape != estimated.shape or applied.ndim != 1 or len(np.unique(applied)) < 3:
        raise InputError("linearity needs at least three different forces and an estimate of each")
    slope, offset = np.polyfit(applied, estimated, 1)
    left = estimated - (offset + slope * applied)
    return {
        "slope": float(slope),
        "offset_n": float(offset),
        "nonlinearity": float(np.abs(left).max() / max(np.ptp(estimated), 1e-300)),
        "resolution_n": float(np.sqrt((left**2).sum() / (len(left) - 2)) / max(abs(slope), 1e-300)),
        "correlation": float(np.corrcoef(applied, estimated)[0, 1]),
    }
