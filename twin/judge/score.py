"""Truth against estimate, in the fields of score.json, and the resolution of an estimate: the width
of a point force's image, and the least distance of two that are resolved.

Inputs are plain arrays, so that recorded data can be scored as well, and designs by their transfer
matrix alone. A score that is not defined is None, and ``reasons`` holds the reason; nothing in it
is ever NaN or infinite.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from twin.arrays import Bools, Floats, Pixels, Points
from twin.errors import InputError

GROSS_PX = 1.0
"""A shift wrong by more than this is a mistaken marker, not noise: counted apart, and left out of
bias and sd."""

TIE_MM = 1e-6
"""Sites that differ by less in their distance to a surface piece share it."""

LEAST_PART = 0.03
"""A field's normal or tangential part that is a smaller share of it has no error of its own: on a
slope a push without friction has a few percent along the surface of the sites."""

LEAST_PUSH = 0.1
"""The centre of pressure is defined where the push along z is at least this share of the force."""

CENTRE_SHARE = 0.2
"""Sites with less than this share of the largest push don't count for the estimate's centre: far
away they hold noise alone, with long levers."""

Score = dict[str, Any]


def score(
    *,
    elastic: Mapping[str, Any] | None = None,
    tracking: Score | None = None,
    force: Score | None = None,
) -> Score:
    """Return score.json: the three stages, and all their reasons under full names in one table."""
    reasons: dict[str, str] = {}
    result: Score = {}
    for name, part in (("elastic", elastic), ("tracking", tracking), ("force", force)):
        if part is None:
            result[name] = None
            reasons[name] = "not requested, or the scene has nothing to score"
            continue
        own = dict(part)
        for key, reason in own.pop("reasons", {}).items():
            reasons[f"{name}.{key}"] = reason
        result[name] = own
    _check_finite(result, "score")
    return {**result, "reasons": reasons}


def _check_finite(value: Any, where: str) -> None:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _check_finite(inner, f"{where}.{key}")
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            _check_finite(inner, f"{where}[{index}]")
    elif isinstance(value, float | np.floating) and not np.isfinite(value):
        raise InputError(f"{where} = {value}: a score must be finite, or None with a reason")


def tracking_score(
    shift_px: Pixels,
    true_shift_px: Pixels,
    visible: Bools | None = None,
    *,
    bound_px: Floats | None = None,
) -> Score:
    """Score marker motion.

    Parameters
    ----------
    shift_px, true_shift_px
        (n, 2) measured shifts, px, NaN where not found; true ones, of the visible outline's
        centroid where there is one.
    visible
        (n,) whether the marker is fully visible in both pictures; all are if not given.
    bound_px
        (n,) least standard deviation of a shift that the pictures' noise allows, per axis, px.

    Returns
    -------
    dict
        Over the visible markers: ``bias_px`` (length of the mean error), ``bias_axes_px``,
        ``sd_px`` (of the two-frame shift, per axis, about the mean), ``sd_axes_px``, ``matched``
        (share found), ``gross`` (number of errors above 1 px; left out of bias and sd),
        ``markers``. The same for the others under ``occluded``. Over all: ``false_positives``
        (markers given a shift though nothing of them is in a picture); ``bound_px`` (root mean
        square over the visible markers) and ``over_bound`` (sd over it). ``reasons``.
    """
    shift, true = np.asarray(shift_px, float), np.asarray(true_shift_px, float)
    if shift.shape != true.shape or shift.ndim != 2 or shift.shape[1] != 2:
        raise InputError(
            f"shifts must be (n, 2) px in the same marker order, got {shift.shape} and {true.shape}"
        )
    seen: Bools = np.ones(len(shift), np.bool_)
    if visible is not None:
        seen = np.array(visible, np.bool_, ndmin=1)
    if seen.shape != (len(shift),):
        raise InputError(f"visible must be ({len(shift)},), got {seen.shape}")
    # Markers in full sight and hidden ones are scored apart.
    front = np.flatnonzero(seen)
    back = np.flatnonzero(seen == 0)
    result, reasons = _tracking_part(shift[front], true[front])
    result["occluded"], behind = _tracking_part(shift[back], true[back])
    if len(back):
        reasons |= {f"occluded.{key}": reason for key, reason in behind.items()}
    else:
        reasons["occluded"] = "no marker is hidden"
        result["occluded"] = None
    # A shift without a true shift is a false positive.
    found, real = np.isfinite(shift).all(axis=1), np.isfinite(true).all(axis=1)
    result["false_positives"] = int((found & ~real).sum())
    # Root mean square of the Cramer-Rao bounds of the markers in full sight.
    result["bound_px"] = result["over_bound"] = None
    least = np.asarray(bound_px, float)[front] if bound_px is not None else np.zeros(0)
    least = least[np.isfinite(least)]
    if len(least):
        # of markers without contrast the squares overflow
        result["bound_px"] = math.hypot(*least) / math.sqrt(len(least))
    else:
        reasons["bound_px"] = (
            "no closed form of this camera's noise is known, or no marker is in full sight"
        )
    if len(least) and result["sd_px"] is not None:
        result["over_bound"] = result["sd_px"] / result["bound_px"]
    else:
        reasons["over_bound"] = reasons.get("sd_px") or reasons["bound_px"]
    return {**result, "reasons": reasons}


def _tracking_part(shift: Pixels, true: Pixels) -> tuple[Score, dict[str, str]]:
    error = shift - true
    found: Bools = np.asarray(np.isfinite(shift).all(axis=1), np.bool_)
    usable = np.asarray(found & np.isfinite(true).all(axis=1))
    length = np.linalg.norm(np.where(usable[:, None], error, 0.0), axis=1)
    # Gross errors are counted, and left out of bias and standard deviation.
    fine = error[usable & (length <= GROSS_PX)]
    result: Score = {
        "bias_px": None,
        "bias_axes_px": None,
        "sd_px": None,
        "sd_axes_px": None,
        "matched": float(found.mean()) if len(shift) else None,
        "gross": int((length > GROSS_PX).sum()),
        "markers": len(shift),
    }
    reasons = {}
    if not len(shift):
        reasons["matched"] = "there are no such markers"
    if len(fine):
        mean = fine.mean(axis=0)
        result |= {"bias_px": float(np.linalg.norm(mean)), "bias_axes_px": [float(v) for v in mean]}
    else:
        reasons["bias_px"] = "no marker was found within 1 px of its true place"
    if len(fine) > 1:
        result["sd_px"] = float(np.sqrt(fine.var(axis=0, ddof=1).mean()))
        result["sd_axes_px"] = [float(v) for v in fine.std(axis=0, ddof=1)]
    else:
        reasons["sd_px"] = "fewer than two markers were found within 1 px of their true places"
    return result, reasons


class _Totals(Protocol):
    @property
    def force_n(self) -> Floats: ...
    @property
    def total_force_n(self) -> Floats: ...
    @property
    def total_torque_nmm(self) -> Floats: ...


class _Forces(_Totals, Protocol):
    """A reconstructed field, or the estimate of a run; its totals are those of the linear solve."""

    @property
    def site_mm(self) -> Points: ...
    @property
    def sd_force_n(self) -> Floats: ...
    @property
    def sd_total_n(self) -> Floats: ...
    @property
    def sd_torque_nmm(self) -> Floats: ...


class _Patches(_Totals, Protocol):
    """What really presses, such as `twin.parts.load.Rectangles`."""

    @property
    def centre_mm(self) -> Points: ...


_FORCE_SCORES = (
    "field_error",
    "field_stated",
    "field_error_normal",
    "field_error_tangential",
    "total_force_error",
    "total_force_stated",
    "total_force_error_axes",
    "sites_force_error",
    "torque_error",
    "torque_error_nmm",
    "torque_stated_nmm",
    "centre_error_mm",
)


def force_score(field: _Forces, patches: _Patches, frames: Floats | None = None) -> Score:
    """Score a reconstructed force field.

    Parameters
    ----------
    field, patches
        Estimate with the standard deviations that it states; truth.
    frames
        (k, 3, 3) the sites' frames, the inward normal last; z is the normal if not given.

    Returns
    -------
    dict
        ``field_error`` |f^ - f|/|f| in the 2-norm, the truth summed into the cell of its nearest
        site; ``field_error_normal`` and ``field_error_tangential``, the same of these parts, each
        over its own size, None for one under `LEAST_PART`; ``total_force_error`` |F^ - F|/|F| and
        ``total_force_error_axes``, (F^ - F)/|F|; ``sites_force_error``, the same of the sum of the
        sites' forces, which is not F^ where they are held to bounds; ``torque_error`` |T^ - T| /
        max(|T|, |F| 1 mm) and ``torque_error_nmm`` |T^ - T|; ``centre_error_mm``, the distance in
        (x, y) of the push's centres, sum fz (x, y)/sum fz (of the estimate only the sites above a
        fifth of the largest push). ``field_stated``, ``total_force_stated`` and
        ``torque_stated_nmm``: what the estimate states of these errors, the root of the sum of its
        variances, of the first two over |f| and |F|. ``reasons``.
    """
    result: Score = dict.fromkeys(_FORCE_SCORES)
    reasons: dict[str, str] = {}
    truth, estimate = np.asarray(patches.force_n, float), np.asarray(field.force_n, float)
    surface_mm, site_mm = patches.centre_mm, field.site_mm
    _same_points(surface_mm, truth, "surface")
    _same_points(site_mm, estimate, "site")
    force = np.asarray(patches.total_force_n, float)
    torque = np.asarray(patches.total_torque_nmm, float)
    totals = (field.total_force_n, field.total_torque_nmm, force, torque)
    if not all(np.isfinite(v).all() for v in (estimate, truth, *totals, site_mm, surface_mm)):
        return {
            **result,
            "reasons": dict.fromkeys(result, "truth or estimate hold numbers that are not finite"),
        }
    # Error of the field: the truth is summed into the cells of the estimate's sites.
    cells = into_cells(site_mm, surface_mm, truth)
    size = float(np.linalg.norm(force))
    for part, value in _field_errors(estimate - cells, cells, frames).items():
        key = "field_error" if part == "all" else f"field_error_{part}"
        result[key] = value
        if value is None:
            reasons[key] = (
                "the true field is zero"
                if part == "all"
                else f"less than {LEAST_PART:.0%} of the true field is in its {part} part"
            )
    # What the estimate states of its errors.
    stated = {
        "field_stated": (field.sd_force_n, float(np.linalg.norm(cells))),
        "total_force_stated": (field.sd_total_n, size),
        "torque_stated_nmm": (field.sd_torque_nmm, 1.0),
    }
    for key, (sd, whole) in stated.items():
        if whole > 0:
            result[key] = float(np.linalg.norm(sd) / whole)
        else:
            reasons[key] = "the true force is zero"
    # Error of the totals, from the linear solve and from the sum over the sites.
    error = field.total_force_n - force
    if size > 0:
        result["total_force_error"] = float(np.linalg.norm(error) / size)
        result["total_force_error_axes"] = [float(v) for v in error / size]
        result["sites_force_error"] = float(np.linalg.norm(estimate.sum(axis=0) - force) / size)
    else:
        for key in ("total_force_error", "total_force_error_axes", "sites_force_error"):
            reasons[key] = "the true total force is zero"
    scale = max(float(np.linalg.norm(torque)), size * 1.0)
    result["torque_error_nmm"] = float(np.linalg.norm(field.total_torque_nmm - torque))
    if scale > 0:
        result["torque_error"] = result["torque_error_nmm"] / scale
    else:
        reasons["torque_error"] = "the true total force and torque are zero"
    apart = _centre_error(site_mm, estimate[:, 2], surface_mm, truth[:, 2], size)
    if isinstance(apart, str):
        reasons["centre_error_mm"] = apart
    else:
        result["centre_error_mm"] = apart
    return {**result, "reasons": reasons}


def _centre_error(
    site_mm: Points, push_n: Floats, surface_mm: Points, true_push_n: Floats, size_n: float
) -> float | str:
    """Return the distance of the centres of pressure, mm, or why there is none.

    Sites with a small part of the largest push are left out, because noise far out would move the
    centre.
    """
    push_n = np.clip(push_n, 0.0, None)
    if size_n == 0 or true_push_n.sum() < LEAST_PUSH * size_n:
        return "the true force hardly pushes along z, so it has no centre of pressure"
    if push_n.max(initial=0.0) <= 0:
        return "the estimate pushes nowhere along z"
    push_n = np.where(push_n >= CENTRE_SHARE * push_n.max(), push_n, 0.0)
    found, true = _centre(site_mm, push_n), _centre(surface_mm, true_push_n)
    return float(np.linalg.norm(found - true))


def _field_errors(error: Floats, truth: Floats, frames: Floats | None) -> dict[str, float | None]:
    """Return a field's relative error in all and by part; None where the truth's part is too
    small."""
    if frames is not None:
        error, truth = (np.einsum("kij,kj->ki", frames, part) for part in (error, truth))
    parts = {"all": slice(0, 3), "normal": slice(2, 3), "tangential": slice(0, 2)}
    sizes = {name: float(np.linalg.norm(truth[:, part])) for name, part in parts.items()}
    floor = LEAST_PART * sizes["all"]
    return {
        name: float(np.linalg.norm(error[:, part])) / sizes[name] if sizes[name] > floor else None
        for name, part in parts.items()
    }


def into_cells(site_mm: Points, surface_mm: Points, surface_force_n: Floats) -> Floats:
    """Return (k, 3) the surface forces summed into the cells of their nearest sites, N; pieces on a
    border are shared evenly, so that a symmetric press stays symmetric."""
    from scipy.spatial import cKDTree

    cells = np.zeros((len(site_mm), 3))
    if not len(surface_mm):
        return cells
    distance, nearest = cKDTree(site_mm).query(surface_mm, k=min(4, len(site_mm)))
    distance, nearest = distance.reshape(len(surface_mm), -1), nearest.reshape(len(surface_mm), -1)
    share = (distance <= distance[:, :1] + TIE_MM).astype(float)
    share /= share.sum(axis=1, keepdims=True)
    for column, site in zip(share.T, nearest.T, strict=True):
        np.add.at(cells, site, column[:, None] * surface_force_n)
    return cells


def _centre(points: Points, push: Floats) -> Floats:
    return np.asarray(push @ np.asarray(points)[:, :2] / push.sum())


def _same_points(points: Points, forces: Floats, what: str) -> None:
    if np.shape(points) != forces.shape or forces.ndim != 2 or forces.shape[1] != 3:
        raise InputError(
            f"{what} points and forces must both be (n, 3), got {np.shape(points)} and "
            f"{forces.shape}"
        )


def full_width(x: Floats, y: Floats, *, at_least: bool = False) -> float:
    """Return the full width at half maximum of a sampled peak, crossings interpolated linearly; NaN
    if open, or with ``at_least`` the length of the row."""
    top = int(np.argmax(y))
    half = 0.5 * float(y[top])
    open_width = float(x[-1] - x[0]) if at_least else float("nan")
    if half <= 0:
        return open_width
    left = next((k for k in range(top, 0, -1) if y[k - 1] < half), None)
    right = next((k for k in range(top, len(y) - 1) if y[k + 1] < half), None)
    if left is None or right is None:
        return open_width
    low = x[left] - (x[left] - x[left - 1]) * (y[left] - half) / (y[left] - y[left - 1])
    high = x[right] + (x[right + 1] - x[right]) * (y[right] - half) / (y[right] - y[right + 1])
    return float(high - low)


def dip(x: Floats, y: Floats, apart: float) -> float:
    """Return how far a profile, (n,) places rising and pushes, falls between two equal pushes at
    -apart/2 and apart/2, over the lower of the peaks.

    Peaks are looked for within a quarter of the distance around their places; 0 where a place has
    none, or where nothing was sampled between them.
    """
    near = [np.abs(x - side * apart / 2) <= apart / 4 + 1e-9 for side in (-1, 1)]
    between = np.abs(x) < apart / 4 - 1e-9
    if not (near[0].any() and near[1].any() and between.any()):
        return 0.0
    peak = min(float(y[near[0]].max()), float(y[near[1]].max()))
    return max(0.0, 1.0 - float(y[between].min()) / peak) if peak > 0 else 0.0


def two_point_distance(apart: Floats, dips: Floats) -> float:
    """Return the least of (n,) rising distances, at least the first, from which on all dip by
    `twin.theory.limit.DIP`, interpolated; infinite if none does."""
    from twin.theory.limit import DIP

    enough = dips >= DIP
    if not enough[-1]:
        return float("inf")
    first = len(enough) - int(np.argmin(enough[::-1])) if not enough.all() else 0
    if first == 0:
        return float(apart[0])
    share = (DIP - dips[first - 1]) / (dips[first] - dips[first - 1])
    return float(apart[first - 1] + share * (apart[first] - apart[first - 1]))
