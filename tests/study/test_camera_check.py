"""`twin check REST1 REST2 --scene S`: what it says of pictures whose noise, exposure and compression are known."""

import numpy as np
import pytest
from PIL import Image

import twin
from twin.errors import InputError, RecipeError
from twin.study.check import check_camera


@pytest.fixture(scope="module")
def pictures():
    scene = twin.load_scene("kamiyama_pillar")
    sensor = twin.Sensor(scene)
    return scene, [sensor.picture(None, exposure=i) for i in (1, 2)]


def said(scene, pair, place, suffix=".png", **options):
    names = [place / f"rest{i}{suffix}" for i in (1, 2)]
    for name, picture in zip(names, pair, strict=True):
        Image.fromarray(picture).save(name, **options)
    lines = check_camera(*names, scene)
    return {line.split()[0]: line for line in lines}


@pytest.mark.slow
def test_a_good_camera_and_what_spoils_it(pictures, tmp_path):
    scene, pair = pictures
    fine = said(scene, pair, tmp_path)
    assert fine["good"] == "good enough: yes"
    noise = np.std(pair[0].astype(float) - pair[1]) / np.sqrt(2)
    assert float(fine["noise"].split()[1]) == pytest.approx(noise, rel=0.05)
    measured, stated = (float(fine["shifts"].split()[i]) for i in (1, 4))
    assert 0.75 < measured / stated < 1.25
    assert "compression" in said(scene, pair, tmp_path, ".jpg", quality=70)["good"]
    bright = [np.clip(2.5 * p.astype(float), 0, 255).astype(np.uint8) for p in pair]
    assert "saturated" in said(scene, bright, tmp_path)["good"]
    copied = [pair[0], pair[0].copy()]
    copied[1][0, 0] ^= 1
    assert "hardly two exposures" in said(scene, copied, tmp_path)["good"]
    moved = [pair[0], np.roll(pair[1], 1, axis=1)]
    assert "mount the camera" in said(scene, moved, tmp_path)["good"]


def test_pictures_that_say_nothing_are_refused(tmp_path):
    name = tmp_path / "rest.png"
    Image.fromarray(np.full((480, 640, 3), 30, np.uint8)).save(name)
    with pytest.raises(InputError, match="same picture"):
        check_camera(name, name, twin.load_scene("kamiyama_pillar"))
    with pytest.raises(RecipeError, match="no \\[camera\\]"):
        check_camera(name, name, twin.load_scene("block_bare"))
