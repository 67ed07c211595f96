"""How sharp, how true and how fine an estimate is: widths, two points, linearity, and what an error consists of.

Plain functions of arrays: estimates from recorded data can be judged as well, and designs from their transfer alone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError
from twin.theory.limit import DIP


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


def full_width(x: Floats, y: Floats) -> float:
    """Return the full width at half of the maximum of a sampled peak, crossings interpolated linearly; NaN if open."""
    top = int(np.argmax(y))
    half = 0.5 * float(y[top])
    if half <= 0:
        return float("nan")
    left = next((k for k in range(top, 0, -1) if y[k - 1] < half), None)
    right = next((k for k in range(top, len(y) - 1) if y[k + 1] < half), None)
    if left is None or right is None:
        return float("nan")
    low = x[left] - (x[left] - x[left - 1]) * (y[left] - half) / (y[left] - y[left - 1])
    high = x[right] + (x[right + 1] - x[right]) * (y[right] - half) / (y[right] - y[right + 1])
    return float(high - low)


def widths(push_n: Floats, grid: tuple[int, int], pitch_mm: float) -> tuple[float, float]:
    """Return the full widths at half maximum of a field along s and t through its largest site, mm; inf if open.

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
    found = full_width(along, picture[:, row]), full_width(across, picture[column])
    return tuple(width if np.isfinite(width) else float("inf") for width in found)  # type: ignore[return-value]


def dip(x: Floats, y: Floats, apart: float) -> float:
    """Return how far a profile falls between two equal pushes at -apart/2 and apart/2, over the lower of the peaks.

    Peaks are looked for within a quarter of the distance around their places; 0 where a place has none, or where
    nothing was sampled between them.

    Parameters
    ----------
    x, y
        (n,) places, rising, and pushes, in any unit.
    apart
        Distance of the two pushes, in the unit of x.
    """
    near = [np.abs(x - side * apart / 2) <= apart / 4 + 1e-9 for side in (-1, 1)]
    between = np.abs(x) < apart / 4 - 1e-9
    if not (near[0].any() and near[1].any() and between.any()):
        return 0.0
    peak = min(float(y[near[0]].max()), float(y[near[1]].max()))
    return max(0.0, 1.0 - float(y[between].min()) / peak) if peak > 0 else 0.0


def two_point_distance(apart: Floats, dips: Floats) -> float:
    """Return the least distance from which on all larger ones dip by `DIP`, interpolated; infinite if none does.

    Parameters
    ----------
    apart, dips
        (n,) distances, rising, and the dips there. The first distance is the least answer.
    """
    enough = dips >= DIP
    if not enough[-1]:
        return float("inf")
    first = len(enough) - int(np.argmin(enough[::-1])) if not enough.all() else 0
    if first == 0:
        return float(apart[0])
    share = (DIP - dips[first - 1]) / (dips[first] - dips[first - 1])
    return float(apart[first - 1] + share * (apart[first] - apart[first - 1]))


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
