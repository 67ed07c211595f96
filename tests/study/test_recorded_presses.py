"""`twin calibrate DIR`: what a recording must hold, and that its own rest picture is what the calibration goes by."""

import numpy as np
import pytest
from PIL import Image

from benchmarks.discs import expose, scene
from twin.errors import InputError
from twin.sense.calibration import read_calibration
from twin.study.recipe import load_scene
from twin.study.recorded_presses import calibrate_from_folder, read_presses
from twin.study.sensor import Sensor

HEAD = "frame,x_mm,y_mm,z_mm,fx_n,fy_n,fz_n\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "there is none"),
        (HEAD, "no presses"),
        ("frame,x_mm\na.png,1\n", "lacks the columns y_mm"),
        (HEAD + "a.png,1,2,,0,0,one\n", "line 2: fz_n = 'one'"),
        (HEAD + "a.png,1,nan,0,0,0,1\n", "y_mm = 'nan'"),
        (HEAD + ",1,2,0,0,0,1\n", "frame is empty"),
        (b"\xff\xfe\x00\x01", "can't be read|lacks"),
    ],
)
def test_a_bad_table_is_told_by_line_and_column(tmp_path, text, words):
    if text is not None:
        data = text if isinstance(text, bytes) else text.encode()
        (tmp_path / "presses.csv").write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_presses(tmp_path)


def test_a_table_is_read(tmp_path):
    (tmp_path / "presses.csv").write_text(HEAD + "a.png, 1, 2, , 0.1, 0, 1\nb.png,1,2,0,0,0,2\n")
    table = read_presses(tmp_path)
    assert table.frames == ("a.png", "b.png")
    assert np.isnan(table.place_mm[0, 2])
    assert table.force_n.tolist() == [[0.1, 0, 1], [0, 0, 2]]


def test_the_recorded_rest_picture_gives_the_layout(tmp_path):
    wanted = load_scene("kamiyama_pillar", {"calibration.method": "halfspace"})
    layout = Sensor(wanted).layout_px
    random = np.random.default_rng(0)
    made = {name: points + random.uniform(-1, 1, points.shape) for name, points in layout.items()}
    drawn = scene((640, 480), [(made["red"], 0), (made["blue"], 2)], 10.0)
    Image.fromarray(expose(drawn, 1)).save(tmp_path / "rest.png")
    line = calibrate_from_folder(wanted, tmp_path, tmp_path / "c.npz")
    assert "halfspace" in line
    calibration = read_calibration(tmp_path / "c.npz")
    assert np.abs(calibration.layout_px - np.concatenate(list(made.values()))).max() < 0.1
    Image.fromarray(np.full((480, 640, 3), 30, np.uint8)).save(tmp_path / "rest.png")
    with pytest.raises(InputError, match="0 of the design's"):
        calibrate_from_folder(wanted, tmp_path, tmp_path / "c.npz")
