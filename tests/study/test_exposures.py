"""What a camera that takes its time sees of markers that move: one dot at a constant speed, against arithmetic."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin.parts.camera import Ccd
from twin.parts.scene import Scene
from twin.study.film import Exposures
from twin.study.sensor import Motion, Sensor
from twin.world.picture.ccd import shutter

BLOCK = Path(__file__).parents[1] / "reference" / "small_block.toml"
SPEED_MM_S = 6.0


def one_dot(**ccd):
    recipe = tomllib.loads(BLOCK.read_text())
    recipe["markers"] = {"red": recipe["markers"]["red"] | {"columns": 1, "rows": 1}}
    recipe["light"]["ambient"] = 1.0
    recipe["accuracy"] = {"centroid_px": 1e-3}
    return Sensor(Scene.model_validate(recipe | {"ccd": {"preset": "ideal", **ccd}}))


def moved(sensor, x_mm):
    points = sensor.actual.markers.points
    along = np.tile([x_mm, 0.0, 0.0], (len(points), 1))
    return Motion(displacement_mm=along, gradient=np.zeros((len(points), 3, 3)), error=0.0)


def moving(sensor):
    """Return a dot that leaves its place at time 0 along x, and stays at a millimetre."""
    return Exposures(sensor, np.array([1 / SPEED_MM_S]), lambda _: moved(sensor, 1.0))


def dot_of(sensor, light):
    """Return rows' light of the dot alone, its rows' centroids, and mean and variance along a row, px."""
    empty = sensor.renderer.radiance(sensor.ellipsoids(moved(sensor, 500.0)))
    dot = np.abs((light - empty)[:, :, 0]).astype(float)
    columns = np.arange(dot.shape[1])
    rows = dot.sum(axis=1)
    mean = (dot @ columns).sum() / rows.sum()
    variance = (dot @ (columns - mean) ** 2).sum() / rows.sum()
    return rows, dot @ columns / np.maximum(rows, 1e-12), mean, variance


def test_a_dot_is_as_long_as_it_moves_in_an_exposure_and_its_centre_is_that_of_the_middle():
    sensor = one_dot(exposure_ms=20.0, frames_per_second=25)
    film = moving(sensor)
    ends = [sensor.project(sensor.actual.markers.points + moved(sensor, x).displacement_mm) for x in (0.0, 1.0)]
    speed = (ends[1] - ends[0])[0, 0] * SPEED_MM_S
    times = np.linspace(0.07, 0.09, 9)  # how wide a still dot is changes with its place among the pixels
    still = [sensor.renderer.radiance(sensor.ellipsoids(film.motion(time))) for time in times]
    middles, widths = np.array([dot_of(sensor, light)[2:] for light in still]).T
    _, _, centre, blurred = dot_of(sensor, film.light(0.08))
    assert speed * 0.02 > 2
    assert centre == pytest.approx(middles[4], abs=0.005)
    assert blurred - widths.mean() == pytest.approx((speed * 0.02) ** 2 / 12, rel=0.02)


def test_a_rolling_shutter_shears_a_dot_by_what_it_moves_from_row_to_row():
    sensor = one_dot(exposure_ms=1.0, readout_ms=30.0, frames_per_second=25)
    film = moving(sensor)
    speed = film.speed_px_s(0.08, 0.0)
    still = sensor.renderer.radiance(sensor.ellipsoids(film.motion(0.08)))
    light, here, _, _ = dot_of(sensor, still)
    _, sheared, _, _ = dot_of(sensor, film.light(0.08))
    seen = light > 0.2 * light.max()
    rows = np.flatnonzero(seen)
    late_s = 0.03 * (rows / (len(light) - 1) - 0.5)
    assert len(rows) >= 8
    assert np.ptp(late_s * speed) > 0.2
    assert_allclose((sheared - here)[seen], late_s * speed, atol=0.01)


def test_before_and_after_the_path_nothing_moves():
    sensor = one_dot(exposure_ms=20.0, frames_per_second=25)
    film = moving(sensor)
    for time_s, x_mm in ((-1.0, 0.0), (2.0, 1.0)):
        still = sensor.renderer.radiance(sensor.ellipsoids(moved(sensor, x_mm)))
        assert_allclose(film.light(time_s), still, rtol=1e-6)
    _, _, centre, _ = dot_of(sensor, film.light(0.0))
    _, _, rest, _ = dot_of(sensor, sensor.renderer.radiance(sensor.ellipsoids(None)))
    speed = film.speed_px_s(0.0, 0.0)
    assert centre - rest == pytest.approx(speed * 0.005 / 2, rel=0.05), "it moves in the second half only"


@pytest.mark.parametrize("readout_ms", [0.0, 12.0])
@pytest.mark.parametrize("speed", [0.0, 5.0, 400.0])
def test_every_row_gathers_its_light_in_its_own_exposure(readout_ms, speed):
    ccd = Ccd(preset="ideal", exposure_ms=8.0, readout_ms=readout_ms, frames_per_second=50)
    offset, weights = shutter(ccd, 31, speed)
    assert_allclose(weights.sum(axis=1), 1, rtol=1e-5)
    late = readout_ms / 1000 * (np.arange(31) / 30 - 0.5)
    assert_allclose(weights @ offset, late if speed else 0 * late, atol=1e-8)
    assert np.all(np.diff(offset) * speed <= 0.3 + 1e-9)


def test_an_interlaced_frame_has_a_field_of_half_a_frame_before():
    sensor = one_dot(exposure_ms=1.0, frames_per_second=25, interlace=True)
    film = moving(sensor)
    now, before = (dot_of(sensor, film.light(t))[2] for t in (0.08, 0.06))
    picture = film.picture(0.08, 1).astype(float)[:, :, 0]
    dot = np.abs(picture - np.median(picture))
    dot[dot < 5] = 0
    columns = np.arange(dot.shape[1])
    fields = [(dot[k::2] @ columns).sum() / dot[k::2].sum() for k in (0, 1)]
    assert now - before > 1
    assert_allclose(fields, [before, now], atol=0.1)
