"""A press's path as an animated picture, and filmed at the camera's frame rate with the truth of every frame."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

import twin
from twin.cli import main
from twin.errors import InputError, RecipeError, TwinError
from twin.files import make_folder, read_arrays
from twin.parts.press import Step
from twin.sense.calibration import read_calibration
from twin.sense.track import Tracker
from twin.study.calibrate import calibrate_to_file
from twin.study.film import PARTS, at_frames, film_to_folder, write_film
from twin.study.frames import VideoWriter, read_picture
from twin.study.sensor import Sensor
from twin.theory.relaxation import Hereditary

QUICK = {"accuracy.contact_patches": 6, "accuracy.centroid_px": 0.1, "camera.width_px": 320, "camera.height_px": 240,
         "camera.focal_px": 907.4, "ccd.noise": False}  # fmt: skip


READING = pytest.mark.filterwarnings(  # its package leaves pipes open
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning"
)


def frames_of(video: Path) -> list[np.ndarray]:
    facts, *frames = pytest.importorskip("imageio_ffmpeg").read_frames(str(video))
    return [np.frombuffer(data, np.uint8).reshape(*facts["size"][::-1], 3) for data in frames]


def test_a_path_in_parts_comes_to_the_same_ends() -> None:
    scene = twin.load_scene("kamiyama_shear", {"accuracy.contact_patches": 6})
    steps = tuple(step.model_copy(update={"seconds": 1.0}) for step in scene.press.path)
    press = scene.press.model_copy(update={"steps": steps, "force_n": None, "indentation_mm": None})
    sensor = Sensor(scene)
    whole, parted = sensor.press(), sensor.press(at_frames(press, 4)[0])
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


@READING
def test_a_film_as_h264_holds_the_pictures_of_the_animated_one(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    sensor = Sensor(twin.load_scene("kamiyama_pillar", QUICK | {"camera.width_px": 321}))
    for name in ("press.mp4", "press.png"):
        write_film(sensor, tmp_path / name)
    assert b"avc1" in (tmp_path / "press.mp4").read_bytes(), "H.264"
    film = frames_of(tmp_path / "press.mp4")
    assert len(film) == PARTS + 10, "the last one stays"
    with Image.open(tmp_path / "press.png") as shown:
        for seen, frame in zip(film, ImageSequence.Iterator(shown), strict=False):
            off = seen[:, :321].astype(int) - np.asarray(frame.convert("RGB"))
            assert np.abs(off).mean() < 5  # colours have half the resolution
    assert sorted(path.name for path in tmp_path.iterdir()) == ["press.mp4", "press.png"]


def test_a_video_that_fails_leaves_no_file(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    picture = np.zeros((48, 64, 3), np.uint8)

    def write(name: str, interrupt: bool = False) -> None:
        with VideoWriter(tmp_path / name, (64, 48)) as video:
            for _ in range(1000):
                video.add(picture)
                if interrupt:
                    raise KeyboardInterrupt

    with pytest.raises(TwinError, match=r"film\.webm: the video can't be written"):
        write("film.webm")  # a container that takes no H.264
    with pytest.raises(KeyboardInterrupt):
        write("film.mp4", interrupt=True)
    assert list(tmp_path.iterdir()) == []
    # What a killed process leaves goes with the next that writes there; what a living one writes stays.
    parts = [tmp_path / f".film.{process}.part.mp4" for process in (2**22 + 1, os.getpid())]
    for part in parts:
        part.touch()
    make_folder(tmp_path)
    assert list(tmp_path.iterdir()) == parts[1:]


STEPS = (
    Step(force_n=(None, None, 0.2), seconds=0.08),
    Step(force_n=(None, None, 0.2), move_mm=(0.5, None, None), seconds=0.1),
)
FILMED = {"accuracy.contact_patches": 6, "accuracy.contact_increments": 2, "ccd.frames_per_second": 25}


def sliding(**keys):
    scene = twin.load_scene("gelpad_slide", FILMED | keys)
    return scene.model_copy(update={"press": scene.press.model_copy(update={"steps": STEPS})})


def test_a_press_is_cut_at_every_frame() -> None:
    press, ends_s = at_frames(sliding().press, 25)
    np.testing.assert_allclose(ends_s, [0.04, 0.08, 0.12, 0.16, 0.18])
    np.testing.assert_allclose([step.force_n[2] for step in press.path], [0.1, 0.2, 0.2, 0.2, 0.2])
    np.testing.assert_allclose([step.move_mm[0] or 0.0 for step in press.path], [0, 0, 0.2, 0.2, 0.1])
    np.testing.assert_allclose(np.cumsum([step.seconds for step in press.path]), ends_s)


def test_a_film_has_the_truth_of_its_frames_and_the_tracker_reads_it_back(tmp_path: Path) -> None:
    scene = sliding()
    said = film_to_folder(scene, tmp_path / "film")
    assert "5 pictures in 0.16 s" in said
    truth = read_arrays(tmp_path / "film" / "truth.npz")
    np.testing.assert_allclose(truth["time_s"], [0, 0.04, 0.08, 0.12, 0.16])
    np.testing.assert_allclose(truth["force_n"][:, 2], [0, 0.1, 0.2, 0.2, 0.2], atol=1e-7)
    np.testing.assert_allclose(truth["probe_move_mm"][:, 0], [0, 0, 0, 0.2, 0.4], atol=1e-9)
    # At first all of it sticks; then it slips from the rim inwards, and the friction is used up at last.
    assert np.all(np.diff(truth["slip_share"][2:]) > 0)
    assert truth["slip_share"][2] < 0.1
    assert truth["slip_share"][4] > 0.9
    last = truth["patch_frame"] == 4
    np.testing.assert_allclose(truth["patch_force_n"][last].sum(axis=0), truth["force_n"][4], atol=1e-7)
    assert truth["patch_slip"][last].mean() == pytest.approx(truth["slip_share"][4], abs=1e-9)
    # What the software sees is where the markers are in the middle of each exposure.
    seen = [read_picture(path) for path in sorted((tmp_path / "film" / "frames").iterdir())]
    assert worst_rms(scene, tmp_path / "film", seen) < 0.03
    assert np.abs(truth["marker_outline_px"] - truth["marker_outline_rest_px"])[4].max() > 3


def worst_rms(scene, folder: Path, frames: list[np.ndarray], rests: list[np.ndarray] | None = None) -> float:
    """Return the largest root mean square error of tracking, px, over the frames of a film."""
    truth = read_arrays(folder / "truth.npz")
    assert len(frames) == len(truth["time_s"])
    tracker = Tracker(rests or read_picture(folder / "rest.png"), Sensor(scene).layout_px)
    worst = 0.0
    for number, picture in enumerate(frames):
        true = truth["marker_outline_px"][number] - truth["marker_outline_rest_px"]
        off = (tracker.track(picture).shift_px - true)[truth["marker_visible"][number] > 0.98]
        assert np.isfinite(off).mean() > 0.95
        worst = max(worst, float(np.sqrt(np.nanmean(off**2))))
    return worst


def test_frames_that_leds_light_in_turn_are_tracked_from_the_rest_pictures_of_their_groups(tmp_path: Path) -> None:
    scene = sliding(**{"light.lit": [[0, 1], [2, 3]], "ccd.noise": False})
    film_to_folder(scene, tmp_path)
    assert not (tmp_path / "rest.png").exists()
    rests, frames = (
        [read_picture(path) for path in sorted((tmp_path / name).iterdir())] for name in ("rest", "frames")
    )
    np.testing.assert_array_equal(read_arrays(tmp_path / "truth.npz")["lit"], [0, 1, 0, 1, 0])
    sensor = Sensor(scene)
    for group, rest in enumerate(rests):
        np.testing.assert_array_equal(rest, sensor.picture(None, frame=2 + group))
    for some in (rests, rests[:1]):  # by the other group's alone .034 px, where changed light was not followed
        assert worst_rms(scene, tmp_path, frames, some) < 0.02
    # The command reads the folder, and counts a frame that it can't read.
    calibrate_to_file(scene, tmp_path / "gel.npz")
    (tmp_path / "frames" / "000001.png").write_bytes(b"damaged")
    paths = [str(tmp_path / name) for name in ("rest", "frames")]
    with pytest.raises(SystemExit) as ended:
        main(["reconstruct", *paths, "--calibration", str(tmp_path / "gel.npz"), "--out", str(tmp_path / "f.npz")])
    assert ended.value.code == 3
    rows, truth = read_arrays(tmp_path / "f.npz"), read_arrays(tmp_path / "truth.npz")
    assert rows["ok"].tolist() == [True, False, True, True, True]
    off_n = np.column_stack([rows[f"f{axis}_n"] for axis in "xyz"]) - truth["force_n"]
    assert np.nanmax(np.abs(off_n[:, :2])) < 0.01


@READING
def test_a_film_as_a_video_has_the_same_truth(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    assert "frames.mp4" in film_to_folder(sliding(), tmp_path, h264=True)
    assert worst_rms(sliding(), tmp_path, frames_of(tmp_path / "frames.mp4")) < 0.06, "less than by PNG"
    assert not (tmp_path / "frames").exists()


def test_forces_on_a_film_of_rubber_that_relaxes_are_the_true_ones(tmp_path: Path) -> None:
    """Held and let go: read picture by picture, they rise as the rubber creeps, and remain.

    The recipe's `reconstruction.frames_per_second` reaches recordings and runs."""
    course = ((0.2, 0.2), (0.2, 1.4), (0.0, 0.2), (0.0, 0.2))
    steps = tuple(Step(force_n=(None, None, force), seconds=seconds) for force, seconds in course)
    keys = {"ccd.frames_per_second": 5, "ccd.noise": False, "tolerance": {"preset": "none"}}
    keys |= {"reconstruction.frames_per_second": 5, "reconstruction.push_only": False, "reconstruction.friction": None}
    scene = twin.load_scene("gelpad_creep", FILMED | keys)
    scene = scene.model_copy(update={"press": scene.press.model_copy(update={"steps": steps})})
    film_to_folder(scene, tmp_path)
    calibrate_to_file(scene, tmp_path / "gel.npz")
    rubber = read_calibration(tmp_path / "gel.npz").relaxation
    both = [str(tmp_path / name) for name in ("rest.png", "frames")]
    both += ["--calibration", str(tmp_path / "gel.npz"), "--out", str(tmp_path / "forces.npz")]

    def forces(*options: str) -> tuple[np.ndarray, np.ndarray]:
        with pytest.raises(SystemExit) as ended:
            main(["reconstruct", *both, *options])
        assert ended.value.code == 0
        rows = read_arrays(tmp_path / "forces.npz")
        return rows["fz_n"], rows["sd_fz_n"]

    truth = read_arrays(tmp_path / "truth.npz")
    np.testing.assert_allclose(truth["force_n"][:, 2], [0, *[0.2] * 8, 0, 0], atol=1e-7)
    creep = [rubber.ramp_creep(time_s - 0.2, 0.2) for time_s in truth["time_s"][1:]]
    back = [0.0] * 8 + [float(rubber.creep(time_s - 1.6)) for time_s in truth["time_s"][9:]]
    elastic = 0.2 * (np.array([0, *creep]) - [0, *back])
    assert elastic[8] > 0.225
    assert elastic[9] > 0.015
    # Each picture by itself is of rubber that may have relaxed or not: half-way, and so much is stated.
    half = rubber.share.sum() / 2
    alone, range_n = forces("--frames-per-second", "0")
    assert alone == pytest.approx((1 - half) * elastic, abs=0.006)
    assert np.all(range_n >= half / (1 - half) * np.abs(alone))
    found, stated = forces()
    assert found == pytest.approx(truth["force_n"][:, 2], abs=0.006)
    # The probe leaves at once between two pictures, and the software takes it to leave slowly.
    history = Hereditary(rubber)
    times = np.diff(truth["time_s"], prepend=0.0)
    slowly = [history.after(step, np.array([one]))[0] for step, one in zip(times, elastic, strict=True)]
    assert slowly[9:] == pytest.approx([-0.0047, -0.0026], abs=2e-4)
    assert found[9:] == pytest.approx(slowly[9:], abs=0.0015)
    assert np.all((np.abs(found[9:]) < stated[9:]) & (stated[9:] < 3 * np.abs(found[9:])))
    result = twin.run(scene, {"forces"})
    assert result.estimate.total_force_n[2] == pytest.approx(found[-1], abs=0.004)
    assert len(result.facts["course"]["time_s"]) == 11


@READING
@pytest.mark.parametrize("h264", [False, True])
def test_an_interrupted_film_goes_on_to_the_same_bytes(tmp_path: Path, h264: bool) -> None:
    if h264:
        pytest.importorskip("imageio_ffmpeg")
    folder = tmp_path / "film"
    filmed: list[str] = []

    def stop(what: str, _: float) -> None:
        filmed.append(what.partition(" of")[0])
        if what.startswith("picture 3"):
            assert len(read_arrays(folder / "truth.npz")["time_s"]) >= 1, "a killed process would keep it"
            raise KeyboardInterrupt

    def files(of: Path) -> dict[str, bytes]:
        return {str(path.relative_to(of)): path.read_bytes() for path in of.rglob("*") if path.is_file()}

    folder.mkdir()
    (folder / "frames.mp4").touch()
    with pytest.raises(KeyboardInterrupt):
        film_to_folder(sliding(), folder, stop, h264=h264)
    assert not (folder / "frames.mp4").exists(), "an older film"
    assert [path.name for path in sorted((folder / "frames").iterdir())] == ["000000.png", "000001.png"]
    assert len(read_arrays(folder / "truth.npz")["time_s"]) == 2
    (folder / "frames" / "000002.png").write_bytes(b"without its truth")
    filmed.clear()
    film_to_folder(sliding(), folder, lambda what, _: filmed.append(what.partition(" of")[0]), h264=h264)
    assert "picture 3" in filmed
    assert "picture 2" not in filmed
    film_to_folder(sliding(), tmp_path / "whole", h264=h264)
    assert files(folder) == files(tmp_path / "whole")
    # Another scene's frames, or those of another program, are not kept.
    other = sliding().model_copy(update={"seed": 7})
    with pytest.raises(KeyboardInterrupt):
        film_to_folder(other, folder, stop, h264=h264)
    truth = read_arrays(folder / "truth.npz")
    truth["force_n"][-1] += 1e-9
    np.savez_compressed(folder / "truth.npz", **truth)
    filmed.clear()
    with pytest.raises(KeyboardInterrupt):
        film_to_folder(other, folder, stop, h264=h264)
    assert "picture 1" in filmed


def test_what_has_no_film_or_no_frames_is_said(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match="camera"):
        write_film(Sensor(twin.load_scene("finger_bare")), tmp_path / "film.gif")
    with pytest.raises(InputError, match=r"\.gif, \.png, \.mp4"):
        write_film(Sensor(twin.load_scene("kamiyama_pillar")), tmp_path / "film.avi")
    scene = sliding()
    still = scene.model_copy(update={"ccd": scene.ccd.model_copy(update={"frames_per_second": None})})
    with pytest.raises(RecipeError, match="frames_per_second: a film needs it"):
        film_to_folder(still, tmp_path)
    with pytest.raises(RecipeError, match=r"seconds sum to 0, .* makes 1 pictures"):
        film_to_folder(twin.load_scene("gelpad_press", {"ccd.frames_per_second": 30}), tmp_path)
    held = (Step(move_mm=(None, None, 0.2), seconds=1.0), STEPS[0])
    with pytest.raises(RecipeError, match="step 2 is held by force in a direction in which the one before"):
        at_frames(scene.press.model_copy(update={"steps": held}), 30)
    (tmp_path / "rest.png").write_bytes(b"mine")
    with pytest.raises(InputError, match=r"holds rest\.png, which no film wrote"):
        film_to_folder(scene, tmp_path)
