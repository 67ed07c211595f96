"""From marker motion to the force field: `reconstruct`.

Why the totals come from the same linear solve: sums of a field under Fz >= 0 or a friction cone are biased, those of
the linear estimate hardly are. Why the differences go on past the edge of the grid, to sites without force: those
inside it don't see a force that is the same everywhere, and as that hardly moves a marker in incompressible rubber,
nothing else would hold it. With them the penalty is a proper prior. Measured on the flat design (636 markers, 15 x 12
sites, .04 px noise, 12 exposures, 5 mm pillar, mean and standard deviation of the total push's error): centre -1.0 +-
1.6 % (differences inside only: -1.2 +- 1.8 %), corner 2.4 +- 2.1 % (5.8 +- 2.0 %).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np

from twin.arrays import Bools, Floats, Points, frozen
from twin.errors import InputError
from twin.sense.calibration import Calibration
from twin.sense.track import Found
from twin.sense.weigh import Factors, automatic_weight, factorise, filtered, noise_scale

Method = Literal["smooth", "norm", "pinv"]

EVEN_NOISE = 2.0
"""Markers whose noise differs by less than this factor (10 % to 90 %) are weighed alike, so that a factorisation
serves a whole sequence."""

KEPT = 8
_kept: WeakKeyDictionary[Calibration, dict[tuple[str, bytes], Factors]] = WeakKeyDictionary()


@dataclass(frozen=True, kw_only=True)
class Field:
    """The reconstructed force field.

    Attributes
    ----------
    site_mm
        (k, 3) sites, mm.
    force_n
        (k, 3) force at every site, N, global axes; a push is +z.
    total_force_n, total_torque_nmm
        (3,) sum of the forces, and of their moments about the origin (positive about z from x to y).
    weight
        The papers' omega that was used, px^2/N^2; 0 for the pseudo-inverse.
    noise_px
        Noise of a shift's component as the fit has it, px: measurement and model error together.
    sd_total_n
        (3,) standard deviation of the total force, given the prior, N.
    used
        (n,) which markers took part.
    method
        How it was solved.
    """

    site_mm: Points
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats
    weight: float
    noise_px: float
    sd_total_n: Floats
    used: Bools
    method: str


def reconstruct(
    found: Found, calibration: Calibration, method: Method = "smooth", weight: float | Literal["auto"] = "auto"
) -> Field:
    """Reconstruct the forces that moved the markers.

    Parameters
    ----------
    found
        Marker motion, in the calibration's marker order; lost markers are left out.
    calibration
        Sites and transfer matrix.
    method
        ``smooth``: small differences between neighbouring sites (flat paper, eq. 11, in two dimensions and per
        component); ``norm``: small forces (eq. 14); ``pinv``: plain pseudo-inverse, which diverges with noise.
    weight
        The papers' omega, px^2/N^2, or ``auto``: see `weigh.automatic_weight`.

    Raises
    ------
    InputError
        Motion and calibration don't belong together, or fewer than 2 markers are left.
    """
    if method not in ("smooth", "norm", "pinv"):
        raise InputError(f"method = {method!r}: allowed are 'smooth', 'norm' and 'pinv'")
    if weight != "auto" and not (np.isfinite(weight) and weight >= 0):
        raise InputError(f"weight = {weight} px^2/N^2: allowed are finite numbers >= 0, or 'auto'")
    used = _usable(found, calibration)
    shift = found.shift_px[used].ravel()
    noise = _noise(found.sd_px[used], calibration.noise_px)
    factors = _factors(calibration, method, used, noise)
    data = shift / np.repeat(noise, 2)
    mean_square = float(1.0 / np.mean(1.0 / noise**2))
    if method == "pinv":
        whitened = 0.0
    elif weight == "auto":
        whitened = automatic_weight(factors, data)
    else:
        whitened = float(weight) / (2.0 * mean_square)
    force = (factors.back @ (filtered(factors, whitened) * (factors.left.T @ data))).reshape(-1, 3)
    scale = noise_scale(factors, data, whitened) if whitened > 0 else 1.0
    torque = np.cross(calibration.site_mm, force).sum(axis=0)
    result = Field(
        site_mm=calibration.site_mm, force_n=force, total_force_n=force.sum(axis=0), total_torque_nmm=torque,
        weight=2.0 * mean_square * whitened, noise_px=scale * mean_square**0.5,
        sd_total_n=scale * _spread(factors, whitened), used=used, method=method,
    )  # fmt: skip
    for array in (result.force_n, result.total_force_n, result.total_torque_nmm, result.sd_total_n, result.used):
        frozen(array)
    return result


def _usable(found: Found, calibration: Calibration) -> Bools:
    if not np.array_equal(found.layer, calibration.layer):
        raise InputError(
            f"the tracked markers ({len(found.layer)}) aren't the calibration's ({len(calibration.layer)}): "
            "track with calibration.layout"
        )
    calibrated = np.isfinite(calibration.transfer).all(axis=1).reshape(-1, 2).all(axis=1)
    used = np.asarray(found.seen & calibrated)
    if used.sum() < 2:
        raise InputError(
            f"only {int(used.sum())} of {len(used)} markers were found in both pictures, at least 2 are needed: check "
            "exposure, layout and channels"
        )
    return used


def _noise(sd_px: Floats, usual_px: float) -> Floats:
    """Return (u,) noise per marker, px, the same for all where it hardly differs."""
    noise = np.where(np.isfinite(sd_px) & (sd_px > 0), sd_px, usual_px)
    low, high = np.quantile(noise, [0.1, 0.9])
    if high <= EVEN_NOISE * low and noise.max() <= 2 * EVEN_NOISE * low:
        return np.full(len(noise), np.sqrt(np.mean(noise**2)))
    return np.asarray(noise)


def _factors(calibration: Calibration, method: str, used: Bools, noise: Floats) -> Factors:
    """Factorise, or take a kept factorisation: with even noise it only scales."""
    kept = _kept.setdefault(calibration, {})
    even = bool(np.all(noise == noise[0]))
    pattern = (noise / noise.mean()).round(6) if not even else np.ones(1)
    key = (method, used.tobytes() + pattern.tobytes())
    if key not in kept:
        rows = calibration.transfer.reshape(len(used), 2, -1)[used].reshape(2 * int(used.sum()), -1)
        relative = noise / noise.mean()
        while len(kept) >= KEPT:
            kept.pop(next(iter(kept)))
        kept[key] = factorise(rows / np.repeat(relative, 2)[:, None], _penalty(calibration, method))
    factors = kept[key]
    size = float(noise.mean())
    return Factors(left=factors.left, singular=factors.singular / size, back=factors.back, total=factors.total)


def _penalty(calibration: Calibration, method: str) -> Floats:
    """Return the (3k, 3k) matrix Q of the papers' (w/2) F^T Q F."""
    columns, rows = calibration.grid
    if method != "smooth":
        return np.eye(3 * columns * rows)
    along, across = _differences(columns), _differences(rows)
    chain = np.kron(along.T @ along, np.eye(rows)) + np.kron(np.eye(columns), across.T @ across)
    return np.asarray(np.kron(chain, np.eye(3)), np.float64)


def _differences(count: int) -> Floats:
    """Return (count + 1, count) differences of a row of sites with one of zero force beyond either end."""
    return np.asarray(np.diff(np.eye(count + 2), axis=0)[:, 1:-1], float)


def _spread(factors: Factors, weight: float) -> Floats:
    """Return (3,) standard deviation of the totals at unit noise: posterior, or plain propagation for weight 0."""
    cut = filtered(factors, weight)
    share = 1.0 / (factors.singular**2 + weight) if weight > 0 else cut**2
    return np.asarray(np.sqrt((factors.total**2 * share).sum(axis=1)))
