"""`twin reconstruct` on recorded files: kinds of input and output, failures that don't stop it, exit codes."""

import csv
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent.parent / "sense"))
from half_space_sensor import _sensor, disk, grid, jacobian, shifts

from benchmarks.discs import expose, scene
from twin.sense.calibration import write_calibration
from twin.study.frames import in_number

SIZE, OFFSET, FORCE = (320, 260), np.array([159.5, 129.5]), np.array([0.2, -0.1, 1.5])


def sensor():
    markers = np.vstack([grid(8, 6, 1.5, 6.0), grid(7, 5, 1.5, 3.0)])
    made = _sensor(markers, np.repeat(["red", "blue"], [48, 35]), (6, 5), 2.0, jacobian(markers, 100.0, 20.0))
    calibration = replace(made[2], layout_px=made[2].layout_px + OFFSET)
    return markers, made[1], calibration


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording: rest, four presses of growing force, their calibration."""
    place = tmp_path_factory.mktemp("recording")
    markers, seen, calibration = sensor()
    write_calibration(calibration, place / "flat.npz")
    points, forces = disk([0.5, 0.2], 4.0, FORCE)
    motion = shifts(markers, seen, points, forces)
    for number in range(5):
        moved = calibration.layout_px + 0.25 * number * motion
        image = expose(scene(SIZE, [(moved[:48], 0), (moved[48:], 2)], 10.0), number)
        Image.fromarray(image).save(place / ("rest.png" if number == 0 else f"press{number}.png"))
    return place


def twin(*arguments, cwd, data=None):
    return subprocess.run(
        [sys.executable, "-m", "twin", "reconstruct", *arguments], cwd=cwd, input=data, capture_output=True, timeout=300
    )


def rows(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def test_files_in_every_format_out(folder):
    frames = [f"press{i}.png" for i in range(1, 5)]
    Image.open(folder / "press2.png").save(folder / "two.bmp")
    Image.open(folder / "press2.png").save(folder / "two.jpg", quality=95)
    done = twin("rest.png", *frames, "two.bmp", "two.jpg", "--calibration", "flat.npz", "--out", "f.csv", cwd=folder)
    assert done.returncode == 0, done.stderr
    table = rows(folder / "f.csv")
    for share, row in zip((0.25, 0.5, 0.75, 1.0, 0.5, 0.5), table, strict=True):
        force = np.array([float(row[f"f{axis}_n"]) for axis in "xyz"])
        assert force == pytest.approx(share * FORCE, abs=0.15)
        assert int(row["markers"]) == 83
    assert float(table[3]["centre_x_mm"]) == pytest.approx(0.5, abs=0.3)
    for name in ("f.parquet", "f.npz"):
        assert twin("rest.png", *frames, "--calibration", "flat.npz", "--out", name, cwd=folder).returncode == 0
    import pyarrow.parquet as pq

    parquet, arrays = pq.read_table(folder / "f.parquet"), np.load(folder / "f.npz")
    assert len(json.loads(parquet.schema.metadata[b"site_mm"])) == 30
    field = np.array(parquet["force_n"].to_pylist()[3]).reshape(-1, 3)
    assert field.sum(axis=0) == pytest.approx([parquet[f"f{a}_n"][3].as_py() for a in "xyz"], abs=1e-4)
    assert arrays["force_n"][3] == pytest.approx(field, abs=1e-6)


def test_a_bad_frame_is_told_and_the_sequence_goes_on(folder):
    (folder / "broken.png").write_bytes((folder / "press1.png").read_bytes()[:3000])
    Image.new("RGB", SIZE, (30, 30, 30)).save(folder / "blank.png")
    Image.new("RGB", (64, 48)).save(folder / "small.png")
    Image.fromarray(np.zeros(SIZE[::-1], np.uint16)).save(folder / "deep.png")
    bad = ["broken.png", "blank.png", "small.png", "deep.png", "none.png"]
    done = twin("rest.png", "press4.png", *bad, "press4.png", "--calibration", "flat.npz", "--out", "b.csv", cwd=folder)
    assert done.returncode == 3
    table = rows(folder / "b.csv")
    assert [row["ok"] for row in table] == ["True", *["False"] * 5, "True"]
    words = ("can't be read", "markers were found", "camera mode", "8 bits", "no such picture")
    assert all(word in row["reason"] for word, row in zip(words, table[1:6], strict=True))
    assert float(table[6]["fz_n"]) == pytest.approx(float(table[0]["fz_n"]), abs=0.02)
    assert b"5 of 7 frames failed" in done.stderr


def test_a_bumped_camera_and_a_turned_picture_are_said(folder):
    image = np.array(Image.open(folder / "press2.png"))
    Image.fromarray(np.roll(image, 3, axis=1)).save(folder / "bumped.png")
    done = twin("rest.png", "bumped.png", "press2.png", "--calibration", "flat.npz", "--out", "c.csv", cwd=folder)
    assert done.returncode == 0
    bumped, fine = rows(folder / "c.csv")
    assert "bumped" in bumped["reason"]
    assert float(bumped["shared_x_px"]) == pytest.approx(3.0, abs=0.2)
    assert fine["reason"] == ""
    Image.fromarray(np.ascontiguousarray(np.rot90(image))[: SIZE[1], : SIZE[0]]).save(folder / "turned.png")
    assert twin("rest.png", "turned.png", "--calibration", "flat.npz", cwd=folder).returncode == 3


def test_raw_frames_from_a_pipe(folder):
    data = b"".join(np.array(Image.open(folder / f"press{i}.png")).tobytes() for i in (1, 4))
    options = ["--calibration", "flat.npz", "--size", f"{SIZE[0]}x{SIZE[1]}", "--format", "rgb24"]
    done = twin("rest.png", "-", *options, cwd=folder, data=data)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.decode().splitlines()
    assert len(lines) == 3
    assert float(lines[2].split("\t")[4]) == pytest.approx(FORCE[2], abs=0.15)
    cut = twin("rest.png", "-", *options, cwd=folder, data=data[:-100])
    assert cut.returncode == 3
    assert b"the pipe ended" in cut.stderr


def test_overlay_pictures(folder):
    done = twin("rest.png", "press4.png", "--calibration", "flat.npz", "--overlay", "drawn", cwd=folder)
    assert done.returncode == 0, done.stderr
    drawn = np.array(Image.open(folder / "drawn" / "000001_press4.png"))
    assert drawn.shape == (SIZE[1], SIZE[0], 3)
    assert (drawn == [120, 255, 120]).all(axis=2).sum() > 10
    options = ["--calibration", "flat.npz", "--overlay"]
    done = twin("rest.png", "press1.png", "press4.png", *options, "one.png", cwd=folder)
    assert done.returncode == 0, done.stderr
    pictures = [np.array(Image.open(folder / name)) for name in ("one.png", "one_000002.png")]
    changed = [float((np.abs(p.astype(int) - drawn) > 40).any(axis=2).mean()) for p in pictures]
    assert changed[1] < 0.02 < changed[0] + 0.02, "the second stands beside the first"
    done = twin("rest.png", "press4.png", *options, "one.jpg", cwd=folder)
    assert done.returncode == 2
    assert b".png" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["rest.png", "-", "--calibration", "flat.npz"], 2, "--size WxH"),
        (["rest.png", "-", "--calibration", "flat.npz", "--size", "0x3", "--format", "rgb24"], 2, "640x480"),
        (["rest.png", "press1.png", "--calibration", "flat.npz", "--out", "f.xls"], 2, ".parquet"),
        (["rest.png", "press1.png", "--calibration", "none.npz"], 2, "does not exist"),
        (["none.png", "press1.png", "--calibration", "flat.npz"], 2, "no such picture"),
        (["press1.png", "press1.png", "--calibration", "flat.npz", "--weight", "much"], 2, "--weight"),
        (["rest.png", "press1.png", "--calibration", "flat.npz", "--method", "best"], 2, "method"),
    ],
)
def test_what_can_not_be_used_is_said(folder, arguments, code, words):
    done = twin(*arguments, cwd=folder)
    assert done.returncode == code
    assert words in done.stderr.decode()
    assert "Traceback" not in done.stderr.decode()


def test_a_video_needs_the_extra_package(folder, monkeypatch):
    from twin.errors import MissingCapability
    from twin.study.frames import video_frames

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingCapability, match=r"pip install 'tactile-twin\[video\]'"):
        next(video_frames(folder / "film.mp4"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")  # its pipes
def test_a_film_in_and_a_film_out(folder):
    """A video file of the recording, written and read by the extra package."""
    pytest.importorskip("imageio_ffmpeg")
    from twin.study.frames import VideoWriter, video_frames

    film = VideoWriter(folder / "film.mp4", SIZE)
    for number in range(1, 5):
        film.add(np.array(Image.open(folder / f"press{number}.png")))
    film.close()
    options = ["--calibration", "flat.npz", "--out", "film.csv", "--overlay", "drawn.mp4"]
    done = twin("rest.png", "film.mp4", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    for share, row in zip((0.25, 0.5, 0.75, 1.0), rows(folder / "film.csv"), strict=True):
        force = np.array([float(row[f"f{axis}_n"]) for axis in "xyz"])
        assert force == pytest.approx(share * FORCE, abs=0.3)  # a lossy codec's noise
    drawn = list(video_frames(folder / "drawn.mp4"))
    assert [frame.problem for frame in drawn] == [""] * 4
    assert drawn[0].picture.shape == (SIZE[1], SIZE[0], 3)
    (folder / "cut.mp4").write_bytes((folder / "film.mp4").read_bytes()[:700])
    done = twin("rest.png", "cut.mp4", "--calibration", "flat.npz", cwd=folder)
    assert done.returncode == 3
    assert b"can't be read as a video" in done.stderr


def test_a_folder_is_read_as_it_was_counted():
    names = ["f9.png", "f10.png", "f099.png", "f0100.png", "g1_2.png", "g1_10.png", "rest.png"]
    assert [p.name for p in sorted(map(Path, reversed(names)), key=in_number)] == names
