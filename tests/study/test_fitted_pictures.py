"""The fitted twin through rendered pictures: contact, pictures, tracking, load cell, fit, against the made sensor."""

import csv

import numpy as np
import pytest
from PIL import Image

from twin.sense.calibration import read_calibration
from twin.sense.transfer import from_compliance
from twin.study.calibrate import calibrate_by_presses, calibration_of
from twin.study.calibration_presses import FOOTPRINT, calibration_press, hertz_radius
from twin.study.recipe import load_scene
from twin.study.recorded_presses import calibrate_from_folder
from twin.study.sensor import Sensor
from twin.study.sites import on_surface
from twin.theory.optics import projection_jacobian


def transfer_error(sensor, calibration):
    """Error of the transfer matrix against the made sensor's own body, markers and camera."""
    scene, points = sensor.actual.scene, sensor.actual.markers.points
    jacobian = projection_jacobian(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)
    exact = from_compliance(sensor.compliance.to_points(points, sensor.sites), jacobian)
    return np.linalg.norm(calibration.transfer - exact) / np.linalg.norm(exact)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "asked"),
    [("kamiyama_pillar", 11, 0.02), ("sato_press", 11, 0.02)],
)
def test_five_photographed_presses_tell_the_transfer_matrix(name, seed, asked):
    """Nothing is handed over but pictures, places and the load cell's forces."""
    told = {"seed": seed, "calibration.presses": None, "calibration.file": None}
    sensor = Sensor(load_scene(name, {**told, "calibration.method": "fitted"}))
    drawn = Sensor(load_scene(name, {**told, "calibration.method": "compliance"}))
    fitted = transfer_error(sensor, calibrate_by_presses(sensor))
    nominal = transfer_error(drawn, calibration_of(drawn))
    print(f"{name}, seed {seed}: fitted {100 * fitted:.2f} %, as drawn {100 * nominal:.2f} %")
    assert fitted < asked
    assert fitted < nominal


@pytest.mark.slow
def test_a_folder_of_photographed_presses_is_fitted(tmp_path):
    """`twin calibrate FOLDER --method fitted` as an owner of a sensor would: PNG files and a table, two places."""
    told = {"seed": 12, "calibration.presses": None, "calibration.file": None, "calibration.method": "fitted"}
    scene = load_scene("kamiyama_pillar", told)
    sensor = Sensor(scene)
    half_mm = FOOTPRINT * hertz_radius(scene, scene.calibration.press_force_n)
    places = on_surface(scene.body, np.array([(4.0, 3.0), (-5.0, -2.0)]), half_mm, "places")
    Image.fromarray(sensor.picture(None, exposure=50)).save(tmp_path / "rest.png")
    rows = [["frame", "x_mm", "y_mm", "z_mm", "fx_n", "fy_n", "fz_n"]]
    random = np.random.default_rng(0)
    for place, centre in enumerate(places.centre_mm):
        for number, state in enumerate(sensor.press(calibration_press(scene, places, place)).path):
            name = f"press-{place}-{number}.png"
            Image.fromarray(sensor.picture(sensor.motion(state.load), 51 + 3 * place + number)).save(tmp_path / name)
            force = state.force_n + random.normal(0, scene.calibration.load_cell_n, 3)
            rows.append([name, *centre[:2], "", *force])
    with open(tmp_path / "presses.csv", "w", newline="") as file:
        csv.writer(file).writerows(rows)
    assert "6 presses" in calibrate_from_folder(scene, tmp_path, tmp_path / "c.npz")
    fitted = transfer_error(sensor, read_calibration(tmp_path / "c.npz"))
    print(f"from a folder, two places: fitted {100 * fitted:.2f} %")
    assert fitted < 0.02
