"""The full chain over several exposures of the same light; linear information loses nothing by mirror symmetry."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from small_sweep import SET, small

import twin
from twin.arrays import Floats
from twin.judge.score import dip
from twin.parts.scene import Scene, Sites
from twin.parts.sweep import Sweep
from twin.sense.calibration import Calibration
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Found
from twin.study.calibrate import nominal_calibration
from twin.study.doubts import View, shift_sd
from twin.study.sensor import Sensor
from twin.study.sweep.designs import Designs
from twin.study.sweep.fidelities import Shown, full, linear, resolved_by_sites
from twin.study.sweep.loads import Bodies, Pushes
from twin.theory.limit import DIP

METRICS = ("total_force_error", "fwhm_mm", "dip", "sd_px")
BODIES = Bodies()


def _figures(exposures: int, preset: str) -> dict[str, float]:
    sweep, design = _design(exposures, preset)
    return full(design, sweep, BODIES, Pushes.of(design.body, sweep.loads, (2.0, 1.5), 1))[0]


def _design(exposures: int, preset: str) -> tuple[Sweep, Scene]:
    axes = {"markers.blue.depth_mm": [2.0], "markers.*.pitch_mm": [1.6], "ccd.preset": [preset]}
    loads = {"size_mm": 2.0, "pair_mm": 4.0, "presses": 1, "exposures": exposures}
    sweep, scene = small(axes=axes, loads=loads)
    return sweep, Designs.of(sweep, scene).scene_of(0)


def test_without_noise_exposures_are_alike_and_leave_no_doubt() -> None:
    one, three = _figures(1, "ideal"), _figures(3, "ideal")
    for name in METRICS:
        assert three[name] == pytest.approx(one[name], rel=1e-9), name
    assert three["total_force_error_noise_se"] == pytest.approx(0.0, abs=1e-12)
    assert three["fwhm_noise_se_mm"] == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(one["total_force_error_noise_se"])
    assert np.isnan(one["fwhm_noise_se_mm"])


def test_noise_over_exposures_is_that_of_theory_and_its_standard_error_that_by_which_others_differ() -> None:
    few, many = _figures(4, "industrial"), _figures(8, "industrial")
    sweep, design = _design(8, "industrial")
    pushes = Pushes.of(design.body, sweep.loads, (2.0, 1.5), 1)
    expected = linear(design, View.of(design), sweep, BODIES, pushes)[0]["noise_px"]
    # were all exposures to share one zero, this would be less by the root of two
    assert many["noise_px"] == pytest.approx(expected, rel=0.15)
    for name, left in (("total_force_error", "total_force_error_noise_se"), ("fwhm_mm", "fwhm_noise_se_mm")):
        assert 0.0 < few[left] < 0.5 * few[name]
        # Student's t of the three degrees that four exposures have exceeds 5.84 in 1 of 100
        assert abs(few[name] - many[name]) < 5.84 * np.hypot(few[left], many[left]), name


@pytest.mark.slow
def test_loads_of_a_probe_are_presses_by_any_law_and_with_friction() -> None:
    ball = {"press.probe": {"kind": "sphere", "diameter_mm": 6.0}, "press.friction": 0.5}
    loads = {"probe": True, "force_n": 1.5, "presses": 1, "shear": 0.2}
    moved = {}
    for law in ("linear", "neo_hookean"):
        sweep, scene = small(set={**SET, **ball, "material.law": law}, fidelity=["full"], loads=loads)
        pushes = Pushes.of(scene.body, sweep.loads, (2.0, 1.5), 1)
        assert pushes.chosen(sweep.loads.pair_mm) == [0, 1]
        sensor = Sensor(scene)
        presses = [pushes.press(load, scene.press) for load in (0, 1)]
        moved[law] = [sensor.motion(sensor.press(press).load).displacement_mm for press in presses]
        for load, found in enumerate(moved[law]):
            own = twin.Press(
                probe=twin.Sphere(diameter_mm=6.0), friction=0.5, at_mm=tuple(pushes.patches.centre_mm[load, :2]),
                steps=[twin.Step(force_n=tuple(pushes.loads[load].sum(axis=0)))],
            )  # fmt: skip
            wanted = Sensor(scene).motion(Sensor(scene).press(own).load).displacement_mm
            assert np.abs(found - wanted).max() < 1e-9 * np.abs(wanted).max()
        if law == "linear":
            state = sensor.press(pushes.press(1, scene.press))
            off = sensor.validity(state, pushes.press(1, scene.press)).linearisation_error
    differ = np.linalg.norm(moved["neo_hookean"][1] - moved["linear"][1], axis=1).max()
    assert differ / np.linalg.norm(moved["linear"][1], axis=1).max() == pytest.approx(off, rel=0.15)


def dip_of(name: str) -> float:
    scene = twin.load_scene(name)
    sites = scene.reconstruction.sites
    with warnings.catch_warnings():  # a shipped scene reaches what it asks
        warnings.simplefilter("error", twin.AccuracyWarning)
        estimate = twin.run(scene, want={"forces"}).estimate
    push = estimate.force_n[:, 2].reshape(sites.columns, sites.rows)[:, sites.rows // 2]
    return dip(sites.axes()[0], push, 2.0)


@pytest.mark.slow
@pytest.mark.parametrize("body", ["kamiyama", "sato"])
def test_two_pillars_two_millimetres_apart_are_two(body: str) -> None:
    assert dip_of(f"{body}_two_points") >= DIP


def _linear(scene: Scene) -> tuple[dict[str, float], Shown]:
    sweep = small()[0]
    pushes = Pushes.of(scene.body, sweep.loads, (2.0, 1.5), 1)
    return linear(scene, View.of(scene), sweep, Bodies(), pushes)


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


def test_a_picture_takes_longer_by_as_much_for_every_further_column_of_sites() -> None:
    """By a product with the matrix, which has so many more entries."""
    recipe, time_ms = small()[1].reconstruction, []
    for columns in (5, 10, 15):
        sites = recipe.sites.model_copy(update={"columns": columns})
        wanted = {"reconstruction": recipe.model_copy(update={"sites": sites})}
        time_ms.append(_linear(small()[1].model_copy(update=wanted))[0]["frame_ms"])
    one, other = np.diff(time_ms)
    assert one == pytest.approx(other)
    assert one > 0


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
        rest_px=view.pixels, shift_px=shift, sd_px=noise, layer=calibration.layer, channels={}, method="disc-fit"
    )
    return _Software(figures, shown, found, calibration, noise)


def test_expected_fields_are_what_the_sensors_software_makes_of_noise_free_shifts(software):
    """Independent of the factors used here: the software's own solve, with the predicted weight."""
    field = reconstruct(software.found, software.calibration, weight=software.figures["weight"])
    largest = np.abs(field.force_n).max()
    np.testing.assert_allclose(software.shown["middle_n"], field.force_n, atol=0.02 * largest)


def test_the_predicted_weight_and_noise_of_the_total_are_those_of_many_noisy_pictures(software):
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
