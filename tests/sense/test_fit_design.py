"""A design that can be written down: half-space, pinhole, three unknowns, and the print."""

import dataclasses

import numpy as np
import pytest
from half_space_sensor import compliance, grid

from twin.errors import InputError
from twin.sense.calibration import left_out
from twin.sense.fit_design import Fit, Presses

PLACES = np.array([[0.0, 0, 0], [3, 3, 0], [-3, 3, 0], [3, -3, 0], [-3, -3, 0]])
SIZES = np.array([0.03, 0.05, 0.01])
DRAWN = np.vstack([grid(5, 5, 2.5, 0.8), grid(6, 6, 2.5, 2.0)])
RED = np.arange(61) < 25


class Drawing:
    names = ("modulus", "red depth", "focal")
    print_mm = 0.03

    def __init__(self, aside_mm=(0.0, 0.0), unsure_px=0.0):
        self.places = np.add(PLACES, [*aside_mm, 0.0])
        self.unsure = unsure_px
        self.predictions = 0

    def markers(self, scaled, prints):
        found = DRAWN.copy()
        found[:, :2] += prints
        found[RED, 2] += SIZES[1] * scaled[1]
        return found

    def seen(self, points, scaled):
        return 300.0 * (1 + SIZES[2] * scaled[2]) * points[:, :2] * [1, -1] / (14.0 - points[:, 2:])

    def unsure_px(self, presses):
        return np.broadcast_to(self.unsure, presses.shift_px.shape[:2])

    def predict(self, scaled, rest_px, place, force_n):
        self.predictions += 1
        flat = self.markers(scaled, 0.0)
        size = (self.seen(flat + np.eye(3)[0], scaled) - self.seen(flat, scaled))[:, :1]
        seen = np.isfinite(rest_px).all(axis=1)
        prints = np.where(seen[:, None], (rest_px - self.seen(flat, scaled)) / size * [1, -1], 0.0)
        markers = self.markers(scaled, prints)
        shifts, slopes = [], []
        for where, force in zip(place, force_n, strict=True):

            def shift(f, aside, at=self.places[where]):
                by_force = compliance(markers, (at + aside)[None]) / (1 + SIZES[0] * scaled[0])
                return self.seen(markers + (by_force @ f).reshape(-1, 3), scaled) - self.seen(markers, scaled)

            here = shift(force, np.zeros(3))
            shifts.append(here)
            by_force = [(shift(force + 1e-5 * d, np.zeros(3)) - here) / 1e-5 for d in np.eye(3)]
            by_place = [(shift(force, 1e-5 * d) - here) / 1e-5 for d in np.eye(3)[:2]]
            slopes.append(np.stack([*by_force, np.zeros_like(here), *by_place], axis=2))
        return prints, np.stack(shifts), np.stack(slopes)


def measured(truth, seed, noise=0.05, cell=0.005, places=range(5), aside_mm=(0.0, 0.0)):
    random = np.random.default_rng(seed)
    design = Drawing(aside_mm)
    prints = random.normal(0, design.print_mm, (61, 2))
    rest = design.seen(design.markers(truth, prints), truth)
    place = np.repeat(list(places), 3)
    force = np.tile([[0, 0, 1.0], [0.3, 0, 1.0], [0, 0.3, 1.0]], (len(place) // 3, 1))
    told, shift, _ = design.predict(truth, rest, place, force)
    assert told == pytest.approx(prints, abs=1e-12)
    return Presses(
        place=place, force_n=force + random.normal(0, cell, force.shape),
        shift_px=shift + random.normal(0, noise, shift.shape), rest_px=rest, load_cell_n=cell, noise_px=noise,
    )  # fmt: skip


def test_parameters_are_found_within_their_stated_deviations():
    random = np.random.default_rng(1)
    off = []
    for seed in range(12):
        truth = random.normal(0, 1, 3)
        design = Drawing()
        found = Fit.of(design, measured(truth, seed))
        assert design.predictions < 25, "differences are taken twice, not at every step"
        spread = np.sqrt(np.diag(found.covariance))
        off.append((found.scaled - truth) / spread)
        assert (spread[:2] < [0.2, 0.3]).all(), "the presses tell more than the drawing"
        assert found.residual_px == pytest.approx(0.05, rel=0.1)
        assert found.model_px < 0.03
    assert 0.6 < np.std(off) < 1.5


def test_presses_beside_their_places_do_not_count_as_another_rubber():
    """A stage that is .02 mm off leaves no error of the model, and the rubber as it is."""
    truth = np.array([1.0, -0.7, 0.4])
    quiet = {"noise": 1e-3, "cell": 0.0}
    aside = dataclasses.replace(measured(truth, 3, aside_mm=(0.02, -0.02), **quiet), noise_px=1e-3)
    found = Fit.of(Drawing(), aside)
    assert found.scaled == pytest.approx(truth, abs=0.03)
    assert found.model_px < 2e-3


def test_shifts_that_the_design_leaves_open_count_less():
    """Wrong by what is stated there: the rubber stays as it is, and no error of the model is left."""
    truth = np.array([1.0, -0.7, 0.4])
    told = measured(truth, 3, noise=1e-3, cell=0.0)
    near = np.linalg.norm(DRAWN[:, None, :2] - PLACES[told.place, :2], axis=2).T < 2.0
    assert 0.05 < near.mean() < 0.3
    shift = told.shift_px * np.where(near, 1.1, 1.0)[:, :, None]
    told = dataclasses.replace(told, shift_px=shift, noise_px=1e-3)
    unsure = np.where(near, 0.1 * np.abs(told.shift_px).max(axis=2), 0.0)
    found = Fit.of(Drawing(unsure_px=unsure), told)
    assert found.scaled == pytest.approx(truth, abs=0.05)
    assert found.model_px < 2e-3
    misled = Fit.of(Drawing(), told)
    assert np.abs(misled.scaled - truth).max() > 0.5


def test_no_noise_no_error_and_what_the_design_cannot_express_is_model_error():
    truth = np.array([1.0, -0.7, 0.4])
    quiet = dataclasses.replace(measured(truth, 3, noise=1e-4, cell=0.0), noise_px=1e-4)
    assert Fit.of(Drawing(), quiet).scaled == pytest.approx(truth, abs=0.05)
    noisy = measured(np.zeros(3), 5)
    bent = noisy.shift_px + 0.3 * np.sin(40 * np.arange(61 * 2)).reshape(61, 2)
    found = Fit.of(Drawing(), dataclasses.replace(noisy, shift_px=bent))
    assert found.model_px == pytest.approx(0.3 / np.sqrt(2), rel=0.15)


def test_leaving_a_place_out_tells_a_place_that_is_different():
    told = measured(np.array([0.5, 0.5, 0.5]), 6)
    even = Fit.of(Drawing(), told)
    assert even.left_out.shape == (5,)
    wrong = told.shift_px.copy()
    wrong[told.place == 2] *= 1.3
    odd = Fit.of(Drawing(), dataclasses.replace(told, shift_px=wrong))
    assert odd.left_out[2] > 1.7 * np.delete(odd.left_out, 2).max()
    assert odd.left_out[2] > 2 * even.left_out[2]


def test_lost_markers_and_a_single_place():
    truth = np.array([0.8, -0.5, 0.0])
    told = measured(truth, 7, places=[0])
    told.shift_px[1, 10:14] = np.nan
    told.rest_px[30] = np.nan
    told.shift_px[:, 30] = np.nan
    found = Fit.of(Drawing(), told)
    assert found.scaled[:2] == pytest.approx(truth[:2], abs=0.6)


def test_wrong_presses():
    told = measured(np.zeros(3), 8)
    for change, words in (
        ({"force_n": told.force_n[:, :2]}, "must be"), ({"force_n": told.force_n * np.nan}, "finite"),
        ({"shift_px": told.shift_px * np.nan}, "no marker"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            Fit.of(Drawing(), dataclasses.replace(told, **change))


def test_left_out_places_of_measured_transfer():
    """A difference to the drawing that is linear in the place is predicted exactly; one odd place is told."""
    chart = np.stack(np.meshgrid([-2.0, 0, 2], [-2.0, 0, 2], indexing="ij"), -1).reshape(-1, 2)
    random = np.random.default_rng(2)
    nominal = random.normal(0, 1, (20, 27))
    measured_h = nominal + 0.05 * np.ones((20, 27))
    assert left_out(measured_h, nominal, chart) == pytest.approx(np.zeros(9), abs=1e-9)
    measured_h[:, 12:15] += 1.0
    assert np.argmax(left_out(measured_h, nominal, chart)) == 4
    assert left_out(measured_h[:, :9], nominal[:, :9], chart[:3]).shape == (0,)
