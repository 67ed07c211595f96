"""The transfer matrix, px/N: from a nominal body's compliance seen through the camera, or from
measured presses.

Both give (2n, 3k): rows marker by marker (column, row), columns site by site (force along global x,
y, z).
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError

LARGEST_CONDITION = 1e3
"""Of a site's matrix of measured forces, each press scaled to 1 N: beyond it the three directions
aren't distinguished."""


def from_compliance(compliance: Floats, jacobian: Floats) -> Floats:
    """Return the transfer matrix of a body of known compliance.

    Parameters
    ----------
    compliance
        (3n, 3k) marker displacement per site force, mm/N, marker by marker and site by site, axes
        x, y, z.
    jacobian
        (n, 2, 3) derivative of every marker's place in the picture, px/mm: the projection of all
        three axes, z included (the flat paper's section 2.5).

    Returns
    -------
    (2n, 3k) px/N
    """
    compliance, jacobian = np.asarray(compliance, float), np.asarray(jacobian, float)
    markers = len(jacobian)
    good = (
        jacobian.shape == (markers, 2, 3)
        and compliance.ndim == 2
        and compliance.shape[0] == 3 * markers
    )
    if not good or compliance.shape[1] % 3:
        raise InputError(
            f"compliance must be (3n, 3k) and jacobian (n, 2, 3), got {compliance.shape} and "
            f"{jacobian.shape}"
        )
    return np.asarray(
        np.matmul(jacobian, compliance.reshape(markers, 3, -1)).reshape(2 * markers, -1)
    )


def from_presses(forces_n: Floats, shifts_px: Floats) -> Floats:
    """Return the transfer matrix from measured presses, h_n = u_n f_n^-1 (finger paper, eqs. 3-5).

    The measured forces are used as they are: a press along x or y follows one along z and still
    carries it.

    Parameters
    ----------
    forces_n
        (k, 3, 3) f_n of every site: ``[:, m, n]`` is the force along m under the n-th press, N (eq.
        3).
    shifts_px
        (k, 3, 2N) movement of the markers under the n-th press, px; NaN where a marker was lost.

    Returns
    -------
    (2N, 3k) px/N, NaN for a marker at a site where it was lost.

    Raises
    ------
    InputError
        The presses of a site don't span three directions, or there are none.
    """
    forces, shifts = np.asarray(forces_n, float), np.asarray(shifts_px, float)
    sites = len(forces)
    if (
        forces.shape != (sites, 3, 3)
        or shifts.ndim != 3
        or shifts.shape[:2] != (sites, 3)
        or shifts.shape[2] % 2
    ):
        raise InputError(
            f"forces must be (k, 3, 3) and shifts (k, 3, 2N), got {forces.shape} and {shifts.shape}"
        )
    if not np.isfinite(forces).all():
        raise InputError("the measured forces of calibration presses must be finite, N")
    if not sites:
        raise InputError("there are no calibration presses")
    length = np.linalg.norm(forces, axis=1, keepdims=True)
    spread = np.linalg.cond(forces / np.where(length > 0.0, length, 1.0))
    if (worst := float(spread.max())) > LARGEST_CONDITION:
        raise InputError(
            f"site {int(spread.argmax())}: the measured forces of its presses have condition "
            f"number {worst:.3g} (allowed up to {LARGEST_CONDITION:.0f}): press along z, then also "
            "along x and along y"
        )
    seen = np.isfinite(shifts.reshape(sites, 3, -1, 2)).all(axis=(1, 3)).repeat(2, axis=1)
    columns = np.linalg.solve(forces.transpose(0, 2, 1), np.nan_to_num(shifts))
    columns = np.where(seen[:, None], columns, np.nan)
    return np.asarray(columns.transpose(2, 0, 1).reshape(shifts.shape[2], -1))


def fill_between(
    measured: Floats,
    nominal_at_presses: Floats,
    nominal_at_sites: Floats,
    press_axes_mm: tuple[Floats, Floats],
    site_chart_mm: Floats,
) -> Floats:
    """Return the transfer matrix at any sites, from one measured on a coarser grid and the nominal
    body's at both.

    What the nominal design gets wrong (stiffness, depths, camera pose) changes slowly from place to
    place, unlike the response itself; so the difference is interpolated linearly and the nominal
    response carries the shape. Beyond the pressed grid the difference of its border is used.

    Parameters
    ----------
    measured, nominal_at_presses
        (2N, 3p) px/N at the pressed places, s outer and t inner.
    nominal_at_sites
        (2N, 3k) px/N at the wanted sites.
    press_axes_mm
        The s and the t of the pressed grid, mm.
    site_chart_mm
        (k, 2) surface coordinates of the wanted sites, mm.

    Returns
    -------
    (2N, 3k) px/N; rows that were not measured are NaN.
    """
    from scipy.interpolate import RegularGridInterpolator

    rows = len(measured)
    columns = [len(axis) for axis in press_axes_mm]
    if (
        measured.shape != nominal_at_presses.shape
        or measured.shape[1] != 3 * columns[0] * columns[1]
    ):
        raise InputError(
            f"measured and nominal transfer at {columns[0]} x {columns[1]} presses must have the "
            f"same shape, got "
            f"{measured.shape} and {nominal_at_presses.shape}"
        )
    difference = (measured - nominal_at_presses).reshape(rows, *columns, 3).transpose(1, 2, 0, 3)
    inside = np.clip(
        site_chart_mm, [axis[0] for axis in press_axes_mm], [axis[-1] for axis in press_axes_mm]
    )
    between = RegularGridInterpolator(press_axes_mm, difference, method="linear")(inside)
    return np.asarray(nominal_at_sites + between.transpose(1, 0, 2).reshape(rows, -1))


def left_out(measured: Floats, nominal: Floats, chart_mm: Floats) -> Floats:
    """Return (p,) errors of every pressed place's transfer as predicted from the others, over its
    size.

    The prediction is the nominal response plus the others' differences to it, interpolated (linear
    radial functions). Empty for fewer than four places.

    Parameters
    ----------
    measured, nominal
        (2N, 3p) px/N at the pressed places; markers that were not measured hold NaN.
    chart_mm
        (p, 2) surface coordinates of the places, mm.
    """
    from scipy.interpolate import RBFInterpolator

    places = len(chart_mm)
    if places < 4:
        return np.zeros(0)
    known = np.isfinite(measured).all(axis=1)
    truth = measured[known].reshape(-1, places, 3).transpose(1, 0, 2).reshape(places, -1)
    drawn = nominal[known].reshape(-1, places, 3).transpose(1, 0, 2).reshape(places, -1)
    out = np.zeros(places)
    for place in range(places):
        others = np.arange(places) != place
        flat = bool((np.ptp(chart_mm[others], axis=0) > 0).all())
        between = RBFInterpolator(
            chart_mm[others], (truth - drawn)[others], kernel="linear", degree=0 if flat else -1
        )(chart_mm[place : place + 1])[0]
        out[place] = np.linalg.norm(drawn[place] + between - truth[place]) / np.linalg.norm(
            truth[place]
        )
    return out
