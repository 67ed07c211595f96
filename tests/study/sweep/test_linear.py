"""The linear information: mirror symmetry loses nothing, and the estimator is the sensor's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_sweep import small

from twin.parts.pipeline import Sites
from twin.parts.sweep import Loads
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Found
from twin.study.calibrate import nominal_calibration
from twin.study.sensor import Sensor
from twin.study.sweep import linear as under_test
from twin.study.sweep.linear import linear, noise_of
from twin.study.sweep.loads import Bodies, pushes_of
from twin.study.sweep.mirror import classes, fold, mirrored, unfold
from twin.study.sweep.shadows import shadows_of
from twin.study.sweep.sites import told_by_sites
from twin.study.sweep.view import view_of


def test_folding_is_orthonormal_and_unfolding_its_inverse() -> None:
    rng = np.random.default_rng(3)
    field = rng.standard_normal((5, 4, 3, 2))
    parts = {signs: fold(field, signs) for signs in classes((True, True))}
    assert sum(len(p) for p in parts.values()) == 5 * 4 * 3
    assert sum((p**2).sum() for p in parts.values()) == pytest.approx((field**2).sum())
    again = sum(unfold(p, signs, (5, 4, 3)) for signs, p in parts.items())
    np.testing.assert_allclose(again, field, atol=1e-14)


def test_a_vector_field_that_is_mirrored_lies_in_one_class() -> None:
    x = np.linspace(-2, 2, 5)[:, None] + 0 * np.zeros((5, 4))
    push = np.stack([x, 0 * x, 1 + x**2], axis=2)  # outwards along x, even along z: even under both mirrors
    sizes = {signs: float(np.abs(fold(push, signs)).max()) for signs in classes((True, True))}
    assert [signs for signs, size in sizes.items() if size > 1e-12] == [(1, 1)]


def test_mirror_symmetry_changes_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep, scene = small()
    pushes, bodies = pushes_of(scene.body, sweep.loads, (2.0, 1.5), 1), Bodies()
    fast, field = linear(scene, view_of(scene), sweep, bodies, pushes)
    monkeypatch.setattr(under_test, "mirrored", lambda scene: (False, False))
    slow, whole = linear(scene, view_of(scene), sweep, bodies, pushes)
    for name, value in fast.items():
        assert value == pytest.approx(slow[name], rel=1e-6), name
    np.testing.assert_allclose(field.force_n, whole.force_n, atol=1e-9)


def test_leds_on_one_side_leave_no_mirror_across_them() -> None:
    scene = small()[1]
    assert mirrored(scene) == (True, True)
    assert scene.light is not None
    aside = [place for place in scene.light.positions_mm if place[0] > 0]
    changed = scene.light.model_copy(update={"positions_mm": tuple(aside)})
    assert mirrored(scene.model_copy(update={"light": changed})) == (False, True)


def test_expected_fields_are_what_the_sensors_software_makes_of_noise_free_shifts() -> None:
    """Independent of the factors used here: the software's own solve, with the weight that was predicted."""
    sweep, scene = small()
    pushes, bodies = pushes_of(scene.body, sweep.loads, (2.0, 1.5), 1), Bodies()
    view = view_of(scene)
    figures, shown = linear(scene, view, sweep, bodies, pushes)
    sensor = Sensor(scene)
    calibration = nominal_calibration(sensor, sensor.nominal_compliance.to_points(view.markers.points, sensor.sites))
    shadows = shadows_of(scene, view)
    assert shadows is not None
    shift = np.add(*under_test._shifts(scene, shadows, 0, bodies, pushes))[:, :, 0]
    found = _found(view.pixels, shift, noise_of(scene, view, sweep) * shadows.doubt, calibration.layer)
    field = reconstruct(found, calibration, weight=figures["weight"])
    np.testing.assert_allclose(shown.force_n, field.force_n, atol=0.02 * np.abs(field.force_n).max())


def test_the_predicted_noise_of_the_total_is_that_of_many_noisy_pictures() -> None:
    sweep, scene = small()
    pushes, bodies = pushes_of(scene.body, sweep.loads, (2.0, 1.5), 1), Bodies()
    view = view_of(scene)
    figures, _ = linear(scene, view, sweep, bodies, pushes)
    sensor = Sensor(scene)
    calibration = nominal_calibration(sensor, sensor.nominal_compliance.to_points(view.markers.points, sensor.sites))
    shadows = shadows_of(scene, view)
    assert shadows is not None
    shift = np.add(*under_test._shifts(scene, shadows, 0, bodies, pushes))[:, :, 0]
    noise, rng = noise_of(scene, view, sweep) * shadows.doubt, np.random.default_rng(7)
    found = _found(view.pixels, shift, noise, calibration.layer)
    totals = []
    for _ in range(150):
        noisy = replace(found, shift_px=shift + noise[:, None] * rng.standard_normal(shift.shape))
        totals.append(reconstruct(noisy, calibration, weight=figures["weight"]).total_force_n[2])
    assert np.std(totals) / 9.80665e-3 == pytest.approx(figures["resolution_gf"], rel=0.2)


@pytest.mark.parametrize(("pitch", "told"), [(2.0, 2.6), (0.75, 1.15)])
def test_two_pushes_are_told_by_sites_from_where_a_site_lies_between_them(pitch: float, told: float) -> None:
    """By hand: at 2 mm pushes of 1 mm need a site under each, from 3 mm on; at .75 mm 1.5 mm apart dip by 2/3, 1 mm
    apart not at all. Between two distances the dip is interpolated to .2."""
    grid = Sites(columns=15, rows=12, pitch_mm=pitch)
    assert told_by_sites(grid, Loads(size_mm=1.0, pair_mm=2.0)) == pytest.approx(told)
    assert told_by_sites(Sites(columns=3, rows=3, pitch_mm=9.0), Loads(pair_mm=2.0)) == np.inf


def _found(pixels: np.ndarray, shift: np.ndarray, sd: np.ndarray, layer: np.ndarray) -> Found:
    return Found(rest_px=pixels, shift_px=shift, sd_px=sd, layer=layer, channels={}, method="disc-fit")
