"""The fitted twin through rendered pictures: contact, pictures, tracking, load cell, fit, against the made sensor."""

import csv
import re

import numpy as np
import pytest
from PIL import Image

from benchmarks.budget import own_transfer
from twin.parts.load import Rectangles
from twin.sense.calibration import read_calibration
from twin.study import calibrate
from twin.study.calibrate import calibrate_by_presses, calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor


def transfer_error(sensor, calibration):
    """Error of the transfer matrix against the made sensor's own body, markers and camera."""
    exact = own_transfer(sensor, sensor.sites)
    return np.linalg.norm(calibration.transfer - exact) / np.linalg.norm(exact)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kamiyama_pillar", "sato_press"])
def test_five_photographed_presses_tell_the_transfer_matrix(name):
    """Nothing is handed over but pictures, places and the load cell's forces."""
    told = {"seed": 11, "calibration.presses": None, "calibration.file": None}
    sensor = Sensor(load_scene(name, {**told, "calibration.method": "fitted"}))
    drawn = Sensor(load_scene(name, {**told, "calibration.method": "compliance"}))
    fitted = transfer_error(sensor, calibrate_by_presses(sensor))
    nominal = transfer_error(drawn, calibration_of(drawn))
    assert fitted < 0.012
    assert fitted < 0.8 * nominal  # on the finger 0.0070 and 0.0112


@pytest.mark.slow
def test_a_folder_of_photographed_presses_is_fitted(tmp_path):
    """`twin calibrate FOLDER --method fitted` as an owner of a sensor would: PNG files and a table, two places."""
    told = {"seed": 12, "calibration.presses": None, "calibration.file": None, "calibration.method": "fitted"}
    scene = load_scene("kamiyama_pillar", told)
    sensor = Sensor(scene)
    places = Rectangles.on_surface(scene.body, np.array([(4.0, 3.0), (-5.0, -2.0)]), 0.5, "places")
    Image.fromarray(sensor.picture(None, exposure=50)).save(tmp_path / "rest.png")
    rows = [["frame", "x_mm", "y_mm", "z_mm", "fx_n", "fy_n", "fz_n"]]
    random = np.random.default_rng(0)
    for place, centre in enumerate(places.centre_mm):
        for number, state in enumerate(sensor.press(calibrate.calibration_press(scene, places, place)).path):
            name = f"press-{place}-{number}.png"
            Image.fromarray(sensor.picture(sensor.motion(state.load), 51 + 3 * place + number)).save(tmp_path / name)
            force = state.force_n + random.normal(0, scene.calibration.load_cell_n, 3)
            rows.append([name, *centre[:2], "", *force])
    with open(tmp_path / "presses.csv", "w", newline="") as file:
        csv.writer(file).writerows(rows)
    told = calibrate.calibrate_to_file(scene, tmp_path / "c.npz", folder=tmp_path)
    assert "6 presses" in told
    modulus = float(re.search(r"Young's modulus (\S+) ", told)[1])
    assert modulus == pytest.approx(sensor.actual.scene.material.youngs_modulus_mpa, rel=0.01), told
    assert transfer_error(sensor, read_calibration(tmp_path / "c.npz")) < 0.02
