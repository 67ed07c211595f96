"""Filling the transfer matrix between calibrated places."""

from __future__ import annotations

import numpy as np
import pytest

from twin.errors import InputError
from twin.parts.pipeline import Sites
from twin.sense.transfer import fill_between

PRESSES = Sites(columns=3, rows=4, pitch_mm=2.0)
SITES = Sites(columns=5, rows=7, pitch_mm=1.0)


def response(chart: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """A sharply peaked response of five readings to forces at places, times a slowly varying factor."""
    readings = np.linspace(-2, 2, 5)
    peak = 1 / (0.3 + (chart[:, 0] - readings[:, None]) ** 2 + chart[:, 1] ** 2)
    return (peak * scale)[:, :, None] * np.array([1.0, -0.5, 2.0])


def flat(transfer: np.ndarray) -> np.ndarray:
    return transfer.reshape(len(transfer), -1)


def test_a_constant_error_of_the_nominal_design_is_mended_between_the_presses() -> None:
    there, here = PRESSES.chart(), SITES.chart()
    offset = np.arange(5)[:, None, None] * 0.01
    nominal_there, nominal_here = response(there, np.ones(len(there))), response(here, np.ones(len(here)))
    filled = fill_between(flat(nominal_there + offset), flat(nominal_there), flat(nominal_here), PRESSES.axes(), here)
    np.testing.assert_allclose(filled, flat(nominal_here + offset), atol=1e-12)


def test_measured_columns_are_kept_where_a_site_was_pressed() -> None:
    there, here = PRESSES.chart(), SITES.chart()
    measured = flat(response(there, 1 + 0.1 * there[:, 0]))
    nominal_there, nominal_here = flat(response(there, np.ones(len(there)))), flat(response(here, np.ones(len(here))))
    filled = fill_between(measured, nominal_there, nominal_here, PRESSES.axes(), here)
    for press, place in enumerate(there):
        site = int(np.argmin(np.linalg.norm(here - place, axis=1)))
        np.testing.assert_allclose(
            filled[:, 3 * site : 3 * site + 3], measured[:, 3 * press : 3 * press + 3], atol=1e-12
        )


def test_unmeasured_rows_stay_unmeasured() -> None:
    there, here = PRESSES.chart(), SITES.chart()
    measured = flat(response(there, np.ones(len(there))))
    measured[2] = np.nan
    nominal = flat(response(here, np.ones(len(here))))
    filled = fill_between(measured, flat(response(there, np.ones(len(there)))), nominal, PRESSES.axes(), here)
    assert np.isnan(filled[2]).all()
    assert np.isfinite(filled[[0, 1, 3, 4]]).all()


def test_shapes_are_checked() -> None:
    with pytest.raises(InputError, match="same shape"):
        fill_between(np.zeros((4, 9)), np.zeros((4, 36)), np.zeros((4, 9)), PRESSES.axes(), SITES.chart())
