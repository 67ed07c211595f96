"""`twin calibrate DIR`: what a recording must hold, and that its own rest picture is what the calibration goes by."""

import numpy as np
import pytest
from PIL import Image

from benchmarks.discs import expose, scene
from twin.errors import InputError
from twin.parts.load import Rectangles
from twin.sense.calibration import read_calibration
from twin.study.calibrate import calibrate_to_file, calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor

HEAD = "frame,x_mm,y_mm,z_mm,fx_n,fy_n,fz_n\n"


def drawn_at_rest(wanted, shift=0.0, seed=1):
    """Return a picture of the design's markers at their places, each up to ``shift`` px off, and these places."""
    random = np.random.default_rng(0)
    made = {
        name: points + random.uniform(-shift, shift, points.shape) for name, points in Sensor(wanted).layout_px.items()
    }
    drawn = scene((640, 480), [(made["red"], 0), (made["blue"], 2)], 10.0)
    return Image.fromarray(expose(drawn, seed)), np.concatenate(list(made.values()))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    wanted = load_scene("kamiyama_pillar", {"calibration.method": "fitted"})
    drawn_at_rest(wanted)[0].save(folder / "rest.png")
    return wanted, folder


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "there is none"),
        (HEAD, "holds no frames"),
        ("frame,x_mm\na.png,1\n", "lacks the columns y_mm"),
        (HEAD + "a.png,1,2,,0,0,one\n", "line 2: fz_n = 'one'"),
        (HEAD + "a.png,1,nan,0,0,0,1\n", "y_mm = 'nan'"),
        (HEAD + "a.png,0,0,,0,0,1e300\n", "line 2: fz_n"),
        (HEAD + ",1,2,0,0,0,1\n", "frame is empty"),
        (HEAD.strip() + ",held_s\na.png,0,0,,0,0,1,-1\n", "line 2: held_s = '-1' must .* s, from 0"),
        (b"\xff\xfe\x00\x01", "can't be read|lacks"),
        # a force in grams, in a table with blanks and without z
        (HEAD + "rest.png, 0, 0, , 0, 0, 200\n", r"press 1 has 200 N.*Forces are in N"),
        (HEAD + "rest.png,0,0,,0,0,1\nrest.png,100,0,,0,0,1\n", r"press 2 at x_mm = 100, .* within x -?\d"),
        (HEAD + "rest.png,100,0,0,0,0,1\n", r"press 1 at x_mm = 100, .* within x -?\d"),
    ],
)
def test_a_bad_table_is_told_by_line_and_column(recording, text, words):
    wanted, folder = recording
    (folder / "presses.csv").unlink(missing_ok=True)
    if text is not None:
        (folder / "presses.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=words):
        calibrate_to_file(wanted, folder / "c.npz", folder=folder)


def test_the_recorded_rest_picture_gives_the_layout(tmp_path):
    terms = [{"share": 0.1, "time_s": 0.3}]
    wanted = load_scene("kamiyama_pillar", {"calibration.method": "halfspace", "material.relaxation": terms})
    picture, places_px = drawn_at_rest(wanted, 1.0)
    picture.save(tmp_path / "rest.png")
    line = calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)
    assert "halfspace" in line
    calibration = read_calibration(tmp_path / "c.npz")
    assert np.abs(calibration.layout_px - places_px).max() < 0.1
    assert calibration.facts["reconstruction"]["method"] == wanted.reconstruction.method
    assert calibration.relaxation is not None
    assert (calibration.relaxation.share, calibration.relaxation.time_s) == ([0.1], [0.3])
    drawn_at_rest(wanted, 1.0, 2)[0].save(tmp_path / "rest.jpg", quality=95)
    with pytest.raises(InputError, match=r"must hold one of rest\.png"):
        calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)
    (tmp_path / "rest.png").unlink()
    calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)
    Image.fromarray(np.full((480, 640, 3), 30, np.uint8)).save(tmp_path / "rest.jpg")
    with pytest.raises(InputError, match="0 of the design's"):
        calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)
    with pytest.raises(InputError, match="there is no such folder"):
        calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path / "none")


@pytest.mark.slow
def test_recorded_presses_tell_how_stiff_the_sensor_is(tmp_path):
    """Pictures drawn for a sensor that is a tenth stiffer than its drawing: the calibration must come out so."""
    stiffer, grid = 1.1, {"columns": 2, "rows": 1, "pitch_mm": 4.0}
    sites = {f"reconstruction.sites.{key}": value for key, value in grid.items()}
    sites["material.relaxation"] = [{"share": 0.1, "time_s": 0.3}]
    wanted = load_scene("kamiyama_pillar", {"calibration.method": "sato", "calibration.press_force_n": 3.0, **sites})
    sensor = Sensor(wanted)
    places = Rectangles.on_surface(wanted.body, wanted.reconstruction.sites.chart(), 1.0, "places")
    by_design = load_scene("kamiyama_pillar", {"calibration.method": "compliance", **sites})
    transfer = calibration_of(Sensor(by_design)).transfer / stiffer
    layout, lines = sensor.layout_px, [HEAD.strip()]
    cut = len(layout["red"])
    rest = np.concatenate(list(layout.values()))

    def draw(name, moved, seed):
        drawn = scene((640, 480), [(moved[:cut], 0), (moved[cut:], 2)], 10.0)
        Image.fromarray(expose(drawn, seed)).save(tmp_path / name)

    draw("rest.png", rest, 0)
    for place, centre in enumerate(places.centre_mm):
        for step, force in enumerate(np.array([[0.0, 0, 3], [1.5, 0, 3], [0, 1.5, 3]])):
            name = f"press{place}{step}.png"
            draw(name, rest + (transfer[:, 3 * place : 3 * place + 3] @ force).reshape(-1, 2), 1 + 3 * place + step)
            lines.append(",".join([name, *(f"{v:g}" for v in (*centre, *force))]))
    (tmp_path / "presses.csv").write_text("\n".join(lines) + "\n")
    assert "sato" in calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)
    nominal = stiffer * transfer

    def softness(made):
        size = (nominal**2).sum(axis=0)
        return (made.transfer * nominal).sum(axis=0) / size

    made = read_calibration(tmp_path / "c.npz")
    assert made.relaxation is None, "how long presses were held isn't known"
    assert softness(made) == pytest.approx(1 / stiffer, rel=0.03)
    # Held for 0.5 s, the rubber has crept: at once it would have moved less under these forces.
    held = [lines[0] + ",held_s", *(f"{line},0.5" for line in lines[1:])]
    (tmp_path / "presses.csv").write_text("\n".join(held) + "\n")
    calibrate_to_file(wanted, tmp_path / "held.npz", folder=tmp_path)
    known = read_calibration(tmp_path / "held.npz")
    crept = float(sensor.relaxation.creep(0.5))
    assert crept > 1.07
    assert softness(known) == pytest.approx(softness(made) / crept, rel=1e-6)
    assert known.relaxation is not None
    # The fit states how it predicts presses that it hasn't seen, and warns where it can't: forces of the wrong sign.
    design = {**sites, "calibration.method": "fitted", "calibration.press_force_n": 3.0}
    fitted = load_scene("kamiyama_pillar", design)
    assert "warning" not in calibrate_to_file(fitted, tmp_path / "f.npz", folder=tmp_path)
    pulled = [lines[0], *(",".join([*row.split(",")[:6], "-3"]) for row in lines[1:])]
    (tmp_path / "presses.csv").write_text("\n".join(pulled) + "\n")
    said = calibrate_to_file(fitted, tmp_path / "f.npz", folder=tmp_path)
    assert "predicted from the other presses: 1" in said
    assert "the presses do not fit this sensor" in said
