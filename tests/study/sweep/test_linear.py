"""The linear information: mirror symmetry loses nothing, and the estimator is the sensor's own."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import qmc
from small_sweep import small

from twin.arrays import Floats
from twin.parts.scene import Scene, Sites
from twin.parts.sweep import Sweep
from twin.sense.calibration import Calibration
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Found
from twin.streams import Purpose, stream
from twin.study.calibrate import nominal_calibration
from twin.study.doubts import View, shift_sd
from twin.study.sensor import Sensor
from twin.study.sweep.fidelities import Shown, linear, resolved_by_sites
from twin.study.sweep.loads import Bodies, Pushes


def _linear(scene: Scene) -> tuple[dict[str, float], Shown]:
    sweep = small()[0]
    pushes = Pushes.of(scene.body, sweep.loads, (2.0, 1.5), 1)
    return linear(scene, View.of(scene), sweep, Bodies(), pushes)


def test_presses_are_at_the_places_of_a_scrambled_halton_sequence() -> None:
    sweep, scene = small()
    loads = sweep.loads.model_copy(update={"presses": 40})
    pushes = Pushes.of(scene.body, loads, (2.0, 1.5), 3)
    u = qmc.Halton(3, scramble=True, rng=stream(3, Purpose.SAMPLING, 1)).random(40)
    assert np.allclose(pushes.patches.centre_mm[1:41, :2], (2 * u[:, :2] - 1) * (2.0, 1.5), atol=1e-12)


@pytest.mark.parametrize("columns", [6, 7])
def test_mirror_symmetry_changes_no_figure(columns: int) -> None:
    """A pupil off the axis by less than the rounding of a marker's place leaves no mirror."""
    _, scene = small()
    scene = scene.model_copy(
        update={
            "markers": {name: layer.model_copy(update={"columns": columns}) for name, layer in scene.markers.items()}
        }
    )
    x, y, z = scene.camera.pupil_mm
    assert (x, y) == (0, 0)
    fast, field = _linear(scene)
    for pupil in ((1e-12, 0.0, z), (0.0, 1e-12, z), (1e-12, 1e-12, z)):
        aside = scene.camera.model_copy(update={"pupil_mm": pupil})
        slow, whole = _linear(scene.model_copy(update={"camera": aside}))
        for name, value in fast.items():
            assert value == pytest.approx(slow[name], rel=1e-6), (pupil, name)
        np.testing.assert_allclose(field["middle_n"], whole["middle_n"], atol=1e-9)


@dataclass
class _Software:
    """The small sweep's sensor and the shifts of the push in the middle, solved apart from it."""

    figures: dict[str, float]
    shown: Shown
    found: Found
    calibration: Calibration
    noise_px: Floats


@pytest.fixture(scope="module")
def software() -> _Software:
    sweep, scene = small()
    scene = scene.model_copy(update={"tolerance": scene.tolerance.model_copy(update={"preset": "none"})})
    figures, shown = _linear(scene)
    sensor, view = Sensor(scene), View.of(scene)
    points = view.markers.points
    compliance = sensor.nominal_compliance.to_points(points, sensor.sites)
    pushes, bodies = Pushes.of(scene.body, sweep.loads, (2.0, 1.5), 1), Bodies()
    moved = bodies.moved(scene, "truth", points, pushes.patches) @ pushes.loads[0].ravel()
    shift = sensor.project(points + moved.reshape(-1, 3)) - sensor.project(points)
    noise = np.zeros(len(points))
    for name in scene.markers:
        noise[view.markers.of(name)] = shift_sd(scene, name, view.diameter_px[view.markers.of(name)])
    calibration = nominal_calibration(sensor, compliance)
    found = Found(
        rest_px=view.pixels,
        shift_px=shift,
        sd_px=noise,
        layer=calibration.layer,
        channels={},
        method="disc-fit",
    )
    return _Software(figures, shown, found, calibration, noise)


def test_expected_fields_are_what_the_sensors_software_makes_of_noise_free_shifts(
    software: _Software,
) -> None:
    """Independent of the factors used here: the software's own solve, with the predicted weight."""
    field = reconstruct(software.found, software.calibration, weight=software.figures["weight"])
    largest = np.abs(field.force_n).max()
    np.testing.assert_allclose(software.shown["middle_n"], field.force_n, atol=0.02 * largest)


def test_the_predicted_weight_and_noise_of_the_total_are_those_of_many_noisy_pictures(
    software: _Software,
) -> None:
    found, noise, rng = software.found, software.noise_px[:, None], np.random.default_rng(7)
    totals, weights = [], []
    for number in range(150):
        shift = found.shift_px + noise * rng.standard_normal(found.shift_px.shape)
        noisy = replace(found, shift_px=shift)
        field = reconstruct(noisy, software.calibration, weight=software.figures["weight"])
        totals.append(field.total_force_n[2])
        if number < 30:
            weights.append(reconstruct(noisy, software.calibration).weight)
    assert np.median(weights) == pytest.approx(software.figures["weight"], rel=0.15)
    assert np.std(totals) / 9.80665e-3 == pytest.approx(software.figures["resolution_gf"], rel=0.2)


@pytest.mark.parametrize(("pitch", "least"), [(2.0, 2.6), (0.75, 1.15)])
def test_two_pushes_are_resolved_by_sites_from_where_a_site_lies_between_them(pitch: float, least: float) -> None:
    """By hand: at 2 mm pushes of 1 mm need a site under each, from 3 mm on; at .75 mm 1.5 mm apart
    dip by 2/3, 1 mm apart not at all. Between two distances the dip is interpolated to .2."""
    grid = Sites(columns=15, rows=12, pitch_mm=pitch)
    assert resolved_by_sites(grid, Sweep.Loads(size_mm=1.0, pair_mm=2.0)) == pytest.approx(least)
    assert resolved_by_sites(Sites(columns=3, rows=3, pitch_mm=9.0), Sweep.Loads(pair_mm=2.0)) == np.inf
