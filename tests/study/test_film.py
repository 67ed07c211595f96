"""A press's path as an animated picture."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

import twin
from twin.errors import InputError, RecipeError
from twin.study.sensor import Sensor
from twin.study.view import PARTS, in_parts, write_film

QUICK = {"accuracy.contact_patches": 6, "accuracy.centroid_px": 0.1, "camera.width_px": 320, "camera.height_px": 240,
         "camera.focal_px": 907.4, "ccd.noise": False}  # fmt: skip


def test_a_path_in_parts_comes_to_the_same_ends() -> None:
    scene = twin.load_scene("kamiyama_shear", {"accuracy.contact_patches": 6})
    sensor = Sensor(scene)
    whole, parted = sensor.press(), sensor.press(in_parts(scene.press, 4))
    assert len(parted.path) == 4 * len(whole.path)
    for number, end in enumerate(whole.path, start=1):
        same = parted.path[4 * number - 1]
        np.testing.assert_allclose(same.force_n, end.force_n, atol=1e-6)
        assert same.indentation_mm == pytest.approx(end.indentation_mm, rel=0.01)
    pushes = [state.force_n[2] for state in parted.path[:4]]
    np.testing.assert_allclose(np.diff(pushes), pushes[0], rtol=1e-5)


def test_the_film_begins_at_rest_and_moves_on(tmp_path: Path) -> None:
    sensor = Sensor(twin.load_scene("kamiyama_pillar", QUICK))
    for name, kind in (("press.gif", "GIF"), ("press.png", "PNG")):
        write_film(sensor, tmp_path / name)
        with Image.open(tmp_path / name) as shown:
            assert (shown.format, shown.n_frames) == (kind, PARTS + 1)
            pictures = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(shown)]
    rest = sensor.picture(None).astype(int)
    changed = [int(np.abs(picture.astype(int) - rest).sum()) for picture in pictures]
    assert changed[0] == 0
    assert np.all(np.diff(changed) > 0), "the further it is pressed, the more the picture differs"


def test_what_has_no_film_is_said(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match="camera"):
        write_film(Sensor(twin.load_scene("finger_bare")), tmp_path / "film.gif")
    with pytest.raises(InputError, match=r"\.gif or \.png"):
        write_film(Sensor(twin.load_scene("kamiyama_pillar")), tmp_path / "film.avi")
