"""`twin reconstruct` on recorded files: kinds of input and output, failures that don't stop it; `calibrate DIR`."""

import csv
import io
import json
import struct
import subprocess
import sys
import zlib
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from half_space_sensor import _sensor, disk, grid, jacobian, shifts
from numpy.testing import assert_array_equal
from PIL import Image

from benchmarks.discs import expose, scene
from twin.cli import main
from twin.errors import InputError
from twin.files import png_bytes, read_arrays
from twin.parts.load import Rectangles
from twin.sense.calibration import read_calibration
from twin.sense.reconstruct import reconstruct
from twin.sense.track import track
from twin.study.calibrate import calibrate_to_file, calibration_of
from twin.study.frames import VIDEOS, read_picture
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory.relaxation import Relaxation

SIZE, OFFSET, FORCE = (320, 260), np.array([159.5, 129.5]), np.array([0.2, -0.1, 1.5])


def sensor(sites=(6, 5), pitch=2.0):
    markers = np.vstack([grid(8, 6, 1.5, 6.0), grid(7, 5, 1.5, 3.0)])
    made = _sensor(markers, np.repeat(["red", "blue"], [48, 35]), sites, pitch, jacobian(markers, 100.0, 20.0))
    calibration = replace(made[2], layout_px=made[2].layout_px + OFFSET)
    return markers, made[1], calibration


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording: rest, four presses of growing force, their calibration."""
    place = tmp_path_factory.mktemp("recording")
    markers, seen, calibration = sensor()
    calibration.write(place / "flat.npz")
    points, forces = disk([0.5, 0.2], 4.0, FORCE)
    motion = shifts(markers, seen, points, forces)
    for number in range(5):
        moved = calibration.layout_px + 0.25 * number * motion
        image = expose(scene(SIZE, [(moved[:48], 0), (moved[48:], 2)], 10.0), number)
        Image.fromarray(image).save(place / ("rest.png" if number == 0 else f"press{number}.png"))
    return place


def twin(*arguments, cwd):
    """Give the command in this process, which has loaded all that it needs."""
    out, err = io.StringIO(), io.StringIO()
    with chdir(cwd), redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main(["reconstruct", *arguments])
    return SimpleNamespace(returncode=ended.value.code, stdout=out.getvalue(), stderr=err.getvalue())


def test_forces_are_solved_for_as_the_calibrated_recipe_says(folder):
    stored = {"reconstruction": {"method": "norm", "push_only": True, "friction": 0.5}}
    known = replace(sensor()[2], provenance=json.dumps(stored))
    known.write(folder / "own.npz")
    both = ["rest.png", "press2.png", "--calibration", "own.npz"]
    assert "method norm, weight auto, friction up to 0.5, pushes only" in twin(*both, cwd=folder).stderr
    assert "method smooth, weight auto\n" in twin(*both, "--method", "smooth", "--no-push-only", cwd=folder).stderr
    assert "method pinv, weight auto\n" in twin(*both, "--method", "pinv", cwd=folder).stderr
    one = replace(known, layer=np.repeat("red", len(known.layer)))
    one.write(folder / "one.npz")
    said = twin("rest.png", "press2.png", "--calibration", "one.npz", cwd=folder).stderr
    assert "one layer of markers and method norm: forces into the surface come out far too small" in said
    for file in ("own.npz", "one.npz"):
        (folder / file).unlink()


def rows(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def test_files_in_every_format_out(folder):
    frames = [f"press{i}.png" for i in range(1, 5)]
    Image.open(folder / "press2.png").save(folder / "two.bmp")
    Image.open(folder / "press2.png").save(folder / "two.jpg", quality=95)
    done = twin("rest.png", *frames, "two.bmp", "two.jpg", "--calibration", "flat.npz", "--out", "f.csv", cwd=folder)
    assert done.returncode == 0, done.stderr
    said = done.stdout
    assert f"Fz {float(rows(folder / 'f.csv')[3]['fz_n']):.4g}" in said, "the largest force"
    assert [float(line.split("\t")[4]) for line in said.splitlines()[1:7]] == pytest.approx(
        [0.375, 0.75, 1.125, 1.5, 0.75, 0.75], abs=0.15
    )
    assert "83 markers, 30 sites" in done.stderr
    table = rows(folder / "f.csv")
    spread = [sum(float(row[f"sd_f{axis}_n"]) ** 2 for axis in "xyz") for row in table]
    assert f"error of a total force {np.sqrt(np.mean(spread)):.2g} N" in said
    shares = next(line for line in said.splitlines() if line.startswith("markers"))
    found = [float(part.split(" %")[0].split()[-1]) for part in shares.split(", ")]
    assert found[0] + found[1] > 99, "seen or strained"
    assert sum(found) == pytest.approx(100, abs=0.3)
    for share, row in zip((0.25, 0.5, 0.75, 1.0, 0.5, 0.5), table, strict=True):
        force = np.array([float(row[f"f{axis}_n"]) for axis in "xyz"])
        assert force == pytest.approx(share * FORCE, abs=0.15)
        assert int(row["markers"]) == 83
    assert float(table[3]["centre_x_mm"]) == pytest.approx(0.5, abs=0.3)
    for name in ("f.parquet", "f.npz"):
        assert twin("rest.png", *frames, "--calibration", "flat.npz", "--out", name, cwd=folder).returncode == 0
    import pyarrow.parquet as pq

    parquet = pq.read_table(folder / "f.parquet")
    assert len(json.loads(parquet.schema.metadata[b"site_mm"])) == 30
    field = np.array(parquet["force_n"].to_pylist()[3]).reshape(-1, 3)
    assert field.sum(axis=0) == pytest.approx([parquet[f"f{a}_n"][3].as_py() for a in "xyz"], abs=1e-4)
    with np.load(folder / "f.npz") as arrays:
        assert arrays["force_n"][3] == pytest.approx(field, abs=1e-6)


SHARES = (0, 0, 0, 0.1, 0.25, 0.5, 1.0, 0, 0.5, 1.0, 0.25, 0.05, 0)


@pytest.fixture(scope="module")
def long_recording():
    """At rest, a ramp, lifted, pressed again, a ramp down: rest picture, calibration, frames, each exposed anew."""
    markers, seen, calibration = sensor()
    motion = shifts(markers, seen, *disk([0.5, 0.2], 4.0, FORCE))
    rest, *frames = [
        expose(scene(SIZE, [(moved[:48], 0), (moved[48:], 2)], 10.0), number)
        for number, moved in enumerate(calibration.layout_px + share * motion for share in (0, *SHARES))
    ]
    return rest, calibration, frames


def felt(folder, rest, calibration, pictures, *options):
    """Return the table of pictures, by column; None stands for a picture that can't be read."""
    folder.mkdir(exist_ok=True)
    calibration.write(folder / "known.npz")
    for name, picture in (("rest", rest), *enumerate(pictures)):
        (folder / f"{name}.png").unlink(missing_ok=True)
        if picture is not None:
            Image.fromarray(picture).save(folder / f"{name}.png")
    names = [f"{number}.png" for number in range(len(pictures))]
    twin("rest.png", *names, "--calibration", "known.npz", "--out", "felt.npz", *options, cwd=folder)
    return read_arrays(folder / "felt.npz")


def columns(table, kind, unit="n"):
    return np.stack([table[f"{kind}{axis}_{unit}"] for axis in "xyz"], axis=1)


FREE = ("--method", "smooth", "--no-push-only")


@pytest.mark.parametrize("options", [FREE, (*FREE, "--weight", "likelihood"), (*FREE, "--weight", "gcv"), FREE[:2]])
def test_a_recording_that_starts_at_rest(long_recording, options, tmp_path):
    """Noise alone in the first frames must not set how strongly the frames after them are smoothed."""
    rest, calibration, frames = long_recording
    rng = np.random.default_rng(3)
    noisy = np.clip(np.rint(frames[-3] + rng.normal(0, 1, frames[-3].shape)), 0, 255).astype(np.uint8)
    table = felt(tmp_path, rest, calibration, [*frames, noisy], *options)
    share = np.array([*SHARES, SHARES[-3]])
    off, sd = columns(table, "f") - share[:, None] * FORCE, columns(table, "sd_f")
    assert set(table["reason"]) == {""}
    assert (np.linalg.norm(off, axis=1) < 0.05 * share * np.linalg.norm(FORCE) + 0.03).all()
    assert (np.abs(off) < 4 * sd)[share == 0].all(), "zero within its stated error"
    assert (sd[share == 0, 2] > 5e-4).all(), "a small force can't be excluded"


RUBBER = Relaxation(np.array([0.2, 0.1]), np.array([0.05, 0.6]))
CREPT = json.dumps({"relaxation": [[0.2, 0.05], [0.1, 0.6]]})


@pytest.mark.parametrize("failed", [(), (6, 7)])
def test_forces_of_rubber_that_relaxes_are_the_integral_over_those_before(long_recording, failed, tmp_path):
    """f(t) = int G(t - s) dq(s), q linear between the frames that are found; the first comes suddenly."""
    rest, calibration, pictures = long_recording
    pictures = [None if number in failed else one for number, one in enumerate(pictures)][3:]

    def values(table):
        parts = [columns(table, "f"), columns(table, "t", "nmm"), columns(table, "sum_f")]
        return np.hstack([*parts, table["force_n"].reshape(len(pictures), -1)])

    elastic = values(felt(tmp_path, rest, calibration, pictures, *FREE))
    known = replace(calibration, provenance=CREPT)
    table = felt(tmp_path, rest, known, pictures, *FREE, "--frames-per-second", "10")
    found, good = values(table), np.flatnonzero(table["ok"])
    assert len(good) == len(pictures) - len(failed)
    at, q = good / 10.0, elastic[good]
    for k, number in enumerate(good):
        wanted = RUBBER.modulus(at[k]) * q[0]
        for j in range(k):
            share = (np.arange(2000) + 0.5) / 2000
            mean = RUBBER.modulus(at[k] - at[j] - share * (at[j + 1] - at[j])).mean()
            wanted = wanted + mean * (q[j + 1] - q[j])
        assert found[number] == pytest.approx(wanted, abs=1e-6)
    assert abs(found[-1, 2]) > 10 * abs(q[-1, 2]), "markers at rest so soon after a press are pulled back"


def test_a_recording_in_time(folder):
    known = replace(sensor()[2], provenance=CREPT)
    known.write(folder / "crept.npz")
    both = ["rest.png", "press4.png", "press4.png", "--calibration", "crept.npz", "--out", "crept.csv"]
    done = twin(*both, cwd=folder)
    assert "rise while held and remain when gone, within the stated deviations; give --frames" in done.stderr
    unknown = [float(row["fz_n"]) for row in rows(folder / "crept.csv")]
    assert float(rows(folder / "crept.csv")[0]["sd_fz_n"]) > 0.15 / 0.85 * abs(unknown[0])
    elastic = [force / 0.85 for force in unknown]  # half-way between not relaxed and relaxed by 0.3
    done = twin(*both, "--frames-per-second", "0.01", cwd=folder)
    assert ", of rubber that relaxes, 0.01 frames a second\n" in done.stderr
    assert "give --frames" not in done.stderr
    first, second = [float(row["fz_n"]) for row in rows(folder / "crept.csv")]
    assert first == pytest.approx(elastic[0], rel=1e-6)
    assert second == pytest.approx(0.7 * elastic[1], rel=1e-5)
    # The same by the recipe's rate, and by the times of frames, of which one more has none.
    facts = json.loads(CREPT) | {"reconstruction": {"method": "smooth", "frames_per_second": 0.01}}
    replace(known, provenance=json.dumps(facts)).write(folder / "crept.npz")
    done = twin(*both, cwd=folder)
    assert ", of rubber that relaxes, 0.01 frames a second\n" in done.stderr
    assert [float(row["fz_n"]) for row in rows(folder / "crept.csv")] == [first, second]
    twin(*both, "--frames-per-second", "0", cwd=folder)
    assert [float(row["fz_n"]) for row in rows(folder / "crept.csv")] == unknown
    (folder / "times.csv").write_text("frame,time_s\npress1.png,107\npress4.png,7\n")
    both[1:3] = ["press4.png", "press1.png", "press2.png", "press4.png"]
    done = twin(*both, "--times", "times.csv", cwd=folder)
    assert done.returncode == 3
    table = rows(folder / "crept.csv")
    assert float(table[0]["fz_n"]) == pytest.approx(elastic[0], rel=1e-6)
    assert float(table[1]["fz_n"]) == pytest.approx(0.7 * elastic[0] / 4, rel=0.1), "a quarter of the motion"
    assert "times.csv has no line for this frame" in table[2]["reason"]
    assert "its time, 7 s, is before the last frame's" in table[3]["reason"]
    for name in ("crept.npz", "crept.csv", "times.csv"):
        (folder / name).unlink()


def test_a_frame_does_not_depend_on_those_before_it(long_recording):
    rest, calibration, frames = long_recording
    at_rest, pressed = (track(rest, frames[at], calibration.layout) for at in (0, 6))
    alone = reconstruct(pressed, calibration)
    after = reconstruct(pressed, calibration, previous=reconstruct(at_rest, calibration))
    assert after.force_n == pytest.approx(alone.force_n)
    assert after.weight == alone.weight


def test_another_sensors_calibration_is_doubted(long_recording, tmp_path):
    """Another pitch, half of a layer's markers, another depth of one layer, another sensor of the same design."""
    rest, calibration, frames = long_recording
    layout, middle = calibration.layout_px, calibration.layout_px.mean(axis=0)
    blue = (calibration.layer == "blue")[:, None]
    rng = np.random.default_rng(4)
    assert felt(tmp_path, rest, calibration, frames[6:7])["reason"] == [""]
    measured = replace(calibration, provenance='{"rest": "measured"}')
    assert felt(tmp_path, rest, measured, frames[6:7])["reason"] == [""]
    others = [
        replace(calibration, layout_px=middle + 1.05 * (layout - middle)),
        replace(calibration, layout_px=np.where(blue, middle + 1.02 * (layout - middle), layout)),
        replace(measured, layout_px=layout + rng.normal(0, 0.6, layout.shape)),
    ]
    for other in others:
        assert all("twin calibrate" in reason for reason in felt(tmp_path, rest, other, frames[5:7])["reason"])
    aside = 0.06 * np.hypot(*(layout[1] - layout[0])) * (-1.0) ** np.arange(len(layout))
    for error in (0.0, 0.045):
        told = json.dumps({"print_error": error})
        rough = replace(calibration, layout_px=layout + aside[:, None] * [1, 0], provenance=told)
        (reason,) = felt(tmp_path, rest, rough, frames[6:7])["reason"]
        assert ("scattered" in reason) == (error == 0.0)
    half = replace(calibration, layout_px=layout + np.where(blue, [200.0, 0.0], 0.0))
    assert "calibration's 83 markers" in felt(tmp_path, rest, half, frames[6:7])["reason"][0]
    sized = replace(calibration, provenance=json.dumps({"picture_px": list(rest.shape[1::-1])}))
    assert felt(tmp_path, rest, sized, frames[6:7])["reason"] == [""]
    Image.fromarray(rest[:-2]).save(tmp_path / "rest.png")
    done = twin("rest.png", "0.png", "--calibration", "known.npz", cwd=tmp_path)
    assert done.returncode == 2
    assert "320 x 258 pixels, the calibration is of a camera of 320 x 260" in done.stderr


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
    words = ("can't be read", "markers were found", "camera mode", "12 bits", "no such picture")
    assert all(word in row["reason"] for word, row in zip(words, table[1:6], strict=True))
    assert float(table[6]["fz_n"]) == pytest.approx(float(table[0]["fz_n"]), abs=0.02)
    assert done.stderr.endswith("5 of 7 frames failed\n")
    assert done.stderr.count("can't be read") == 1


def test_16_bit_colours_are_read_whole(tmp_path):
    """Pillow opens such a file as an ordinary RGB picture."""
    deep = np.random.default_rng(1).integers(2**16, size=(5, 7, 3), dtype=np.uint16)
    for name, picture in (("colour", deep), ("grey", deep[:, :, 1])):
        (tmp_path / f"{name}.png").write_bytes(png_bytes(picture))
        assert_array_equal(read_picture(tmp_path / f"{name}.png"), picture)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 5, 4, 16, 2, 0, 0, 0))
    up = (b"\2" + b"\0\1" * 15) * 3  # each line is the one above, and 1
    rows_of = chunk(b"IDAT", zlib.compress(b"\0" + b"\x12\x34" * 15 + up))
    (tmp_path / "deep.png").write_bytes(b"\x89PNG\r\n\x1a\n" + head + rows_of + chunk(b"IEND", b""))
    with Image.open(tmp_path / "deep.png") as opened:
        assert opened.mode == "RGB"
    assert_array_equal(read_picture(tmp_path / "deep.png")[:, 2, 1], 0x1234 + np.arange(4))
    whole = (tmp_path / "deep.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[:-30])
    # A file whose parts are whole, but which has too few pixels; and one of another kind of colour.
    few = chunk(b"IDAT", zlib.compress(b"\0" + b"\x12\x34" * 15))
    (tmp_path / "few.png").write_bytes(whole[: 8 + len(head)] + few + chunk(b"IEND", b""))
    odd = chunk(b"IHDR", struct.pack(">IIBBBBB", 5, 4, 16, 3, 0, 0, 0))
    (tmp_path / "odd.png").write_bytes(whole[:8] + odd + rows_of + chunk(b"IEND", b""))
    ninth = chunk(b"IDAT", zlib.compress(b"\t" + b"\x12\x34" * 15 + up))
    (tmp_path / "way.png").write_bytes(whole[: 8 + len(head)] + ninth + chunk(b"IEND", b""))
    for name in ("cut", "few", "odd", "way"):
        with pytest.raises(InputError, match="read"):
            read_picture(tmp_path / f"{name}.png")
    # A checksum that is wrong, or a part that nobody knows, ends libpng, and with it the program.
    wrong = rows_of[:-1] + bytes([rows_of[-1] ^ 1])
    (tmp_path / "sum.png").write_bytes(whole[: 8 + len(head)] + chunk(b"ABCD", b"x") + wrong + chunk(b"IEND", b""))
    assert_array_equal(read_picture(tmp_path / "sum.png"), read_picture(tmp_path / "deep.png"))


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_how_a_phone_was_held_turns_no_picture(tmp_path, orientation):
    """Held over a sensor it takes any way for upright, another for the next picture."""
    stored = np.random.default_rng(2).integers(256, size=(16, 24, 3)).astype(np.uint8)
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(stored).save(tmp_path / "phone.jpg", exif=exif, quality=95)
    Image.fromarray(stored).save(tmp_path / "plain.jpg", quality=95)
    assert_array_equal(read_picture(tmp_path / "phone.jpg"), read_picture(tmp_path / "plain.jpg"))


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


@pytest.mark.parametrize(("at", "twist", "words"), [(0.5, 0, ""), (6.9, 0, "at the edge of the sites"),
                                                    (0.5, 0.4, "no pushes within the friction")])  # fmt: skip
def test_a_motion_that_no_push_makes_and_a_press_beside_the_sites_are_doubted(tmp_path, at, twist, words):
    """``twist``: shear of the whole picture, px a pixel of the layout, without a force into the surface."""
    markers, seen, calibration = sensor((12, 9), 1.2)
    layout = calibration.layout_px
    moved = layout + 0.5 * shifts(markers, seen, *disk([at, 0.2], 2.0, FORCE)) * (twist == 0)
    moved[:, 0] += 0.05 * twist * (layout[:, 1] - layout[:, 1].mean())
    pictures = [expose(scene(SIZE, [(p[:48], 0), (p[48:], 2)], 10.0), k) for k, p in enumerate((layout, moved))]
    bounds = ("--method", "local", "--push-only", "--friction", "0.5")
    reason = str(felt(tmp_path, pictures[0], calibration, pictures[1:], *bounds)["reason"][0])
    assert words in reason if words else not reason, reason


def test_raw_frames_from_a_pipe(folder):
    data = b"".join(np.array(Image.open(folder / f"press{i}.png")).tobytes() for i in (1, 4))
    command = [sys.executable, "-m", "twin", "reconstruct", "rest.png", "-", "--calibration", "flat.npz"]
    command += ["--size", f"{SIZE[0]}x{SIZE[1]}", "--format", "rgb24"]
    done = subprocess.run(command, cwd=folder, input=data, capture_output=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.decode().splitlines()
    assert len(lines) == 3
    assert float(lines[2].split("\t")[4]) == pytest.approx(FORCE[2], abs=0.15)
    cut = subprocess.run(command, cwd=folder, input=data[:-100], capture_output=True)
    assert cut.returncode == 3
    assert b"the pipe ended" in cut.stderr


def test_overlay_pictures(folder):
    (folder / "drawn").mkdir()
    (folder / "drawn" / "000002_older.png").touch()
    done = twin("rest.png", "press4.png", "--calibration", "flat.npz", "--overlay", "drawn", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert len(list((folder / "drawn").iterdir())) == 1, "drawings of another recording are replaced"
    assert "--overlay drawn: the 1 drawing there, 000002_older.png and so on, will be replaced" in done.stderr
    drawn = np.array(Image.open(folder / "drawn" / "000001_press4.png"))
    assert drawn.shape == (SIZE[1], SIZE[0], 3)
    lines = int((drawn == [120, 255, 120]).all(axis=2).sum())
    assert lines > 300, "motion is drawn many times as long as it is"
    options = ["--calibration", "flat.npz", "--overlay"]
    done = twin("rest.png", "press1.png", "press4.png", *options, "one.png", cwd=folder)
    assert done.returncode == 0, done.stderr
    pictures = [np.array(Image.open(folder / name)) for name in ("one.png", "one_000002.png")]
    changed = [float((np.abs(p.astype(int) - drawn) > 40).any(axis=2).mean()) for p in pictures]
    assert changed[1] < 0.02 < changed[0] + 0.02, "the second stands beside the first"
    done = twin("rest.png", "press4.png", *options, "one.tif", cwd=folder)
    assert done.returncode == 2
    assert ".png" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["rest.png", "-", "--calibration", "flat.npz"], 2, "--size WxH"),
        (["rest.png", "-", "--calibration", "flat.npz", "--size", "0x3", "--format", "rgb24"], 2, "640x480"),
        (["rest.png", "press1.png", "--calibration", "flat.npz", "--out", "f.xls"], 2, ".parquet"),
        (["rest.png", "press1.png", "--calibration", "none.npz"], 2, "does not exist"),
        (["none.png", "press1.png", "--calibration", "flat.npz"], 2, "no such picture"),
        (["press1.png", "press1.png", "--calibration", "flat.npz", "--weight", "much"], 2, "weight = 'much': allowed"),
        (["rest.png", "press1.png", "--calibration", "flat.npz", "--method", "best"], 2, "method"),
        (["rest.png", "press1.png", "--calibration", "flat.npz", "--frames-per-second", "30"], 2, "how its rubber"),
        (["rest.png", "press1.png", "--calibration", "flat.npz", "--frames-per-second", "-1"], 2, "above 0"),
    ],
)
def test_what_can_not_be_used_is_said(folder, arguments, code, words):
    done = twin(*arguments, cwd=folder)
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_a_video_needs_the_extra_package(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    done = twin("rest.png", "film.mp4", "--calibration", "flat.npz", cwd=folder)
    assert done.returncode == 4
    assert "pip install imageio-ffmpeg" in done.stderr


@pytest.mark.parametrize("kind", ["EPS", "GIF", "TIFF", "PPM"])
def test_only_pictures_of_the_allowed_formats_are_decoded_whatever_their_name(tmp_path, kind):
    """Pillow chooses the decoder by content: an EPS file starts Ghostscript."""

    Image.new("RGB", (8, 8)).save(tmp_path / "frame_001.png", kind)
    with pytest.raises(InputError, match="allowed are PNG, BMP and JPEG"):
        read_picture(tmp_path / "frame_001.png")


def write_film(path, pictures):
    package = pytest.importorskip("imageio_ffmpeg")
    height, width = pictures[0].shape[:2]
    film = package.write_frames(str(path), (width, height), fps=60, macro_block_size=1, quality=8)
    film.send(None)
    for picture in pictures:
        film.send(np.ascontiguousarray(picture))
    film.close()


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")  # its pipes
def test_a_list_of_films_under_the_name_of_a_film_reads_no_other_file(folder):
    films = [f"other{kind}" for kind in sorted({*VIDEOS} - {".webm"})]  # that has another codec in the same container
    for name in films:
        write_film(folder / name, [np.zeros((48, 64, 3), np.uint8)] * 3)
    (folder / "list.mp4").write_text("ffconcat version 1.0\nfile other.mp4\n")
    (folder / "hls.mp4").write_text("#EXTM3U\n#EXTINF:1,\nother.mpg\n#EXT-X-ENDLIST\n")
    twin("rest.png", *films, "list.mp4", "hls.mp4", "--calibration", "flat.npz", "--out", "films.csv", cwd=folder)
    table = rows(folder / "films.csv")
    assert [row["frame"] for row in table] == [
        *(f"{film}:{n}" for film in films for n in range(3)),
        "list.mp4",
        "hls.mp4",
    ]
    assert ["can't be read as a video" in row["reason"] for row in table] == [False] * 3 * len(films) + [True, True]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")  # its pipes
def test_a_film_in_and_a_film_out(folder):
    """A video file of the recording, written and read by the extra package."""
    write_film(folder / "film.mp4", [read_picture(folder / f"press{number}.png") for number in range(1, 5)])
    options = ["--calibration", "flat.npz", "--out", "film.csv", "--overlay", "drawn.mp4"]
    done = twin("rest.png", "film.mp4", *options, cwd=folder)
    assert done.returncode == 0, done.stderr
    for share, row in zip((0.25, 0.5, 0.75, 1.0), rows(folder / "film.csv"), strict=True):
        force = np.array([float(row[f"f{axis}_n"]) for axis in "xyz"])
        assert force == pytest.approx(share * FORCE, abs=0.3)  # a lossy codec's noise
    import imageio_ffmpeg

    facts, *drawn = imageio_ffmpeg.read_frames(str(folder / "drawn.mp4"))
    assert (facts["size"], len(drawn)) == (SIZE, 4)
    (folder / "cut.mp4").write_bytes((folder / "film.mp4").read_bytes()[:700])
    done = twin("rest.png", "cut.mp4", "--calibration", "flat.npz", cwd=folder)
    assert done.returncode == 3
    assert "can't be read as a video" in done.stderr


def test_a_folder_is_read_as_it_was_counted(folder):
    names = ["f9.png", "f10.png", "f099.png", "f0100.png", "g1_2.png", "g1_10.png", "rest.png"]
    (folder / "counted").mkdir()
    for name in reversed(names):
        (folder / "counted" / name).touch()
    twin("rest.png", "counted", "--calibration", "flat.npz", "--out", "counted.csv", cwd=folder)
    assert [row["frame"] for row in rows(folder / "counted.csv")] == names


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
    Image.new("RGB", (64, 48)).save(folder / "small.bmp")
    Image.new("RGB", (640, 480)).save(folder / "dark.png")
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
        # commas for points shift the cells: here x = 1, y = 5, fz = 5; lines of empty cells end a spreadsheet's table
        (HEAD + "rest.png,1,5,2,5,0,0,0,5\n", "line 2: has more cells than the first line. Numbers have a point"),
        (HEAD + "rest.png,0,0,,0,0,1,,\n,,,,,,\n,,,,,,,,\n", "no marker moves in rest.png"),
        (HEAD.strip() + ",held_s\na.png,0,0,,0,0,1,-1\n", "line 2: held_s = '-1' must .* s, from 0"),
        (b"\xff\xfe\x00\x01", "can't be read|lacks"),
        # a force in grams, in a table with blanks and without z
        (HEAD + "rest.png, 0, 0, , 0, 0, 200\n", r"press 1 has 200 N.*Forces are in N"),
        (HEAD + "rest.png,0,0,,0,0,1\nrest.png,100,0,,0,0,1\n", r"press 2 at x_mm = 100, .* within x -?\d"),
        (HEAD + "rest.png,100,0,0,0,0,1\n", r"press 1 at x_mm = 100, .* within x -?\d"),
        (HEAD + "rest.png,0,0,9,0,0,1\n", "press 1 at x_mm = 0, y_mm = 0, z_mm = 9 misses"),
        (HEAD + "rest.png,0,0,0\n", "line 2: fx_n is missing"),
        (HEAD + "rest.png,0,0,0,0,0,0\n", "press 1 has no force; give what the load cell reads"),
        (HEAD + "rest.png,0,0,0,0.1,0,-1\nrest.png,1,0,0,0,0,-3\n", "every press pulls .the largest by fz_n = -3 N"),
        (HEAD + "rest.png,0,0,0,0,0,1\n", "no marker moves in rest.png: is it the rest picture"),
        (HEAD + "rest.png,0,0,0,0,0,1\nrest.png,1,0,0,0,0,1\n", "two lines name rest.png"),
        (HEAD + "dark.png,0,0,0,0,0,1\n", "dark.png: fewer than 2 markers were found: is it blurred"),
        (HEAD + "small.bmp,0,0,0,0,0,1\n", "small.bmp: the picture is 64x48 px, the rest picture 640x480"),
    ],
)
def test_a_bad_table_is_told_by_line_and_column(recording, text, words):
    wanted, folder = recording
    (folder / "presses.csv").unlink(missing_ok=True)
    if text is not None:
        (folder / "presses.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=words):
        calibrate_to_file(wanted, folder / "c.npz", folder=folder)


def test_a_table_that_the_pictures_contradict_is_refused(tmp_path):
    """Markers go aside around three places, most at the middle, and with the sideways force."""
    wanted = load_scene("kamiyama_pillar", {"calibration.method": "fitted"})
    layout = Sensor(wanted).layout_px
    chart = np.concatenate([layer.chart() for layer in wanted.markers.values()])
    rest, cut = np.concatenate(list(layout.values())), len(layout["red"])
    scale = np.ptp(rest[:cut, 0]) / np.ptp(chart[:cut, 0])  # px/mm
    rows = []
    for number, (x, y, fx, fy) in enumerate(
        [(6, 2, 0, 0), (6, 2, 0.4, 0), (-6, 4, 0, 0.4), (-6, 4, 0, 0), (1, -5, 0, 0), (1, -5, 0.2, -0.3)]
    ):
        away = chart - (x, y)
        size = np.exp(-(away**2).sum(axis=1, keepdims=True) / 8)
        moved = rest + scale * size * (0.05 * away + (0.4 * fx, 0.4 * fy)) * (1, -1)
        drawn = scene((640, 480), [(moved[:cut], 0), (moved[cut:], 2)], 10.0)
        Image.fromarray(expose(drawn, 1 + number)).save(tmp_path / f"p{number}.png")
        rows.append((x, y, fx, fy))
    drawn_at_rest(wanted)[0].save(tmp_path / "rest.png")
    for order, factors, words in (
        ((1, 0, 2, 3), (1, 1, 1, 1), "x_mm and y_mm are swapped"),
        ((0, 1, 2, 3), (1, -1, 1, 1), "y_mm has the wrong sign"),
        ((0, 1, 2, 3), (1e-3, 1e-3, 1, 1), r"presses lie \S+ mm apart, here 0.00\d+: give x_mm, y_mm in mm"),
        ((0, 1, 3, 2), (1, 1, 1, 1), "fx_n and fy_n are swapped"),
        ((0, 1, 2, 3), (1, 1, -1, 1), "fx_n has the wrong sign"),
        ((0, 1, 2, 3), (1, -1, 1, -1), "y_mm has the wrong sign; fy_n has the wrong sign"),
    ):
        lines = [
            f"p{number}.png,{x:g},{y:g},,{fx:g},{fy:g},1"
            for number, (x, y, fx, fy) in enumerate(np.array(rows)[:, order] * factors)
        ]
        (tmp_path / "presses.csv").write_text(HEAD + "\n".join(lines))
        with pytest.raises(InputError, match=f"by the motion in the pictures, {words}$"):
            calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)


def test_the_recorded_rest_picture_gives_the_layout(tmp_path):
    terms = [{"share": 0.1, "time_s": 0.3}]
    wanted = load_scene("kamiyama_pillar", {"calibration.method": "halfspace", "material.relaxation": terms})
    picture, places_px = drawn_at_rest(wanted, 1.0)
    picture.save(tmp_path / "rest.png")
    line = calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)
    assert "halfspace" in line
    assert "presses" not in line
    (tmp_path / "presses.csv").write_text(HEAD)
    line = calibrate_to_file(wanted, tmp_path / "c.npz", folder=tmp_path)
    assert "none of the presses in presses.csv: --method fitted learns from them" in line
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
    right = calibrate_to_file(fitted, tmp_path / "f.npz", folder=tmp_path)
    assert "warning" not in right
    modulus = read_calibration(tmp_path / "f.npz").facts["youngs_modulus_mpa"]
    assert modulus == pytest.approx(stiffer * crept * fitted.material.youngs_modulus_mpa, rel=0.01)
    assert "read    total force of these presses off by: Fx 0." in right
    assert not read_calibration(tmp_path / "f.npz").read_error.any()
    pulled = [lines[0], *(",".join([*row.split(",")[:6], "-3"]) for row in lines[1:])]
    (tmp_path / "presses.csv").write_text("\n".join(pulled) + "\n")
    with pytest.raises(InputError, match="every press pulls"):
        calibrate_to_file(fitted, tmp_path / "f.npz", folder=tmp_path)
    (tmp_path / "presses.csv").write_text("\n".join([*pulled[:-1], lines[-1]]) + "\n")
    said = calibrate_to_file(fitted, tmp_path / "f.npz", folder=tmp_path)
    assert "the presses do not fit this sensor" in said
    assert "total forces are further off than is stated" in said
    assert read_calibration(tmp_path / "f.npz").scale_error > 0.5, said
