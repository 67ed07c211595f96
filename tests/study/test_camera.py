"""Intrinsics in OpenCV's files, checks of two rest pictures, and EMVA 1288 of the program's own flat fields."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import twin
from twin.errors import InputError, RecipeError
from twin.files import png_bytes
from twin.parts.camera import PRESETS, Camera, Ccd
from twin.study.check import check_camera, check_path
from twin.study.intrinsics import read_intrinsics, write_intrinsics
from twin.study.photon_transfer import photon_transfer
from twin.study.recipe import load_scene
from twin.world.picture.ccd import Pattern, expose

REFERENCE = Path(__file__).parents[1] / "reference"
KNOWN = {
    "lens": "pinhole", "focal_px": 500.0, "aspect": 1.02, "principal_px": (331.5, 228.25),
    "distortion": (-0.1, 0.02, 0.003, -0.002, 0.01), "width_px": 640, "height_px": 480,
}  # fmt: skip


@pytest.mark.parametrize("name", ["opencv_camera.yml", "opencv_camera.json"])
def test_opencvs_own_files_are_read(name: str) -> None:
    assert read_intrinsics(REFERENCE / name) == KNOWN


@pytest.mark.parametrize("name", ["made.yml", "made.json"])
@pytest.mark.parametrize(("lens", "distortion"), [("pinhole", (-0.1, 0.02)), ("equidistant", (0.1, 0.2, 0.3, 0.4)),
                                                  ("pinhole", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0))])  # fmt: skip
def test_what_is_written_is_read_back(name: str, lens: str, distortion: tuple[float, ...], tmp_path: Path) -> None:
    camera = Camera(lens=lens, focal_px=431.25, aspect=0.9, distortion=distortion, pupil_mm=(0, 0, 60), width_px=320)
    write_intrinsics(camera, tmp_path / name)
    keys = read_intrinsics(tmp_path / name)
    assert keys["distortion"][: len(distortion)] == distortion
    assert not any(keys["distortion"][len(distortion) :])
    assert keys["focal_px"] == 431.25
    assert keys["aspect"] == pytest.approx(0.9)
    assert keys["principal_px"] == camera.centre_px
    assert (keys["lens"], keys["width_px"], keys["height_px"]) == (lens, 320, 480)


@pytest.mark.parametrize("name", ["camera.json", "camera.yml"])
def test_a_file_that_an_editor_marked_as_utf8_is_read(name: str, tmp_path: Path) -> None:
    write_intrinsics(Camera(focal_px=500, pupil_mm=(0, 0, 60)), tmp_path / name)
    plain = read_intrinsics(tmp_path / name)
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + (tmp_path / name).read_bytes())
    assert read_intrinsics(tmp_path / name) == plain


def test_ros_files_are_read(tmp_path: Path) -> None:
    file = tmp_path / "ros.yaml"
    file.write_text(
        "image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [230, 0, 319.5, 0, 230, 239.5, 0, 0, 1]\ndistortion_model: equidistant\n"
        "distortion_coefficients: {rows: 1, cols: 4, data: [0.1, 0, 0, 0]}\n"
    )
    assert read_intrinsics(file)["lens"] == "equidistant"


def test_a_scene_takes_its_camera_from_a_file() -> None:
    scene = load_scene("kamiyama_pillar", {"camera.intrinsics": str(REFERENCE / "opencv_camera.yml")})
    assert scene.camera.focal_px == 500
    assert scene.camera.distortion == KNOWN["distortion"]
    assert scene.camera.pupil_mm == (0, 0, 108.85)
    assert scene.camera.source["focal_px"] == "file opencv_camera.yml"  # type: ignore[index]
    head, *lines = [line for line, _ in check_path(str(REFERENCE / "opencv_camera.yml"))]
    assert '[camera] intrinsics = "opencv_camera.yml"' in head
    assert tomllib.loads("\n".join(lines))["focal_px"] == 500


@pytest.mark.parametrize(("text", "named"), [
    ("", "table"), ("a: [1", "not valid"), ("camera_matrix: 3", "3 x 3"), ("a: 1", "no camera_matrix"),
    ("camera_matrix: [1, 0, 0, 0, .nan, 0, 0, 0, 1]", "finite"),
    ("camera_matrix: [1, 5, 0, 0, 1, 0, 0, 0, 1]", "fx, 0, cx"),
    ("camera_matrix: [9, 0, 0, 0, 9, 0, 0, 0, 1]\nD: [0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]", "more than 8"),
    ("camera_matrix: !!python/object:os.system [1]", "not valid"),
])  # fmt: skip
def test_bad_files_are_refused_by_name(text: str, named: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.yml"
    file.write_text(text)
    with pytest.raises(InputError, match=named) as caught:
        read_intrinsics(file)
    assert "bad.yml" in str(caught.value)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="can't be read"):
        read_intrinsics(tmp_path / "none.yml")
    with pytest.raises(InputError, match="can't be written"):
        write_intrinsics(Camera(focal_px=500, pupil_mm=(0, 0, 60)), tmp_path / "no" / "where.yml")


@pytest.fixture(scope="module")
def pictures():
    scene = twin.load_scene("kamiyama_pillar")
    sensor = twin.Sensor(scene)
    return scene, [sensor.picture(None, exposure=i) for i in (1, 2)]


def said(scene, pair, place, suffix=".png", **options):
    names = [place / f"rest{i}{suffix}" for i in (1, 2)]
    for name, picture in zip(names, pair, strict=True):
        Image.fromarray(picture).save(name, **options)
    return {record["name"]: record for _, record in check_camera(*names, scene)}


@pytest.mark.slow
def test_a_good_camera_and_what_spoils_it(pictures, tmp_path):
    scene, pair = pictures
    fine = said(scene, pair, tmp_path)
    assert fine["good enough"]["found"] == "yes"
    noise = np.std(pair[0].astype(float) - pair[1]) / np.sqrt(2)
    assert fine["noise"]["noise_counts"] == pytest.approx(noise, rel=0.05)
    assert 0.75 < fine["shifts"]["measured_px"] / fine["shifts"]["stated_px"] < 1.25
    compressed = said(scene, pair, tmp_path, ".jpg", quality=70)["good enough"]["found"]
    assert compressed.startswith("yes; without compression")
    bright = [np.clip(2.5 * p.astype(float), 0, 255).astype(np.uint8) for p in pair]
    assert "saturated" in said(scene, bright, tmp_path)["good enough"]["found"]
    copied = [pair[0], pair[0].copy()]
    copied[1][0, 0] ^= 1
    assert "hardly two exposures" in said(scene, copied, tmp_path)["good enough"]["found"]
    moved = [pair[0], np.roll(pair[1], 1, axis=1)]
    assert "mount the camera" in said(scene, moved, tmp_path)["good enough"]["found"]
    touched = pair[1].copy()
    touched[220:260, 300:340] = pair[1][220:260, 299:339]
    answer = said(scene, [pair[0], touched], tmp_path)["good enough"]["found"]
    assert "markers moved against the others" in answer
    assert "mount the camera" not in answer


def test_counts_of_16_bits_are_those_of_8_bits(pictures, tmp_path):
    """All of a picture passed for saturated, and its noise was 257 times as large."""
    scene, pair = pictures
    places = [tmp_path / f"deep{i}.png" for i in (1, 2)]
    for place, picture in zip(places, pair, strict=True):
        place.write_bytes(png_bytes(picture.astype(np.uint16) * 257))
    deep = {record["name"]: record for _, record in check_camera(*places, scene)}
    assert deep["noise"] == pytest.approx(said(scene, pair, tmp_path)["noise"])


def test_pictures_that_say_nothing_are_refused(tmp_path):
    name = tmp_path / "rest.png"
    Image.fromarray(np.full((480, 640, 3), 30, np.uint8)).save(name)
    with pytest.raises(InputError, match="same picture"):
        check_camera(name, name, twin.load_scene("kamiyama_pillar"))
    with pytest.raises(RecipeError, match="no \\[camera\\]"):
        check_camera(name, name, twin.load_scene("block_bare"))
    Image.fromarray(np.full((240, 320, 3), 30, np.uint8)).save(tmp_path / "small.png")
    with pytest.raises(InputError, match=r"rest\.png, .*small\.png: "):
        check_camera(name, tmp_path / "small.png", twin.load_scene("kamiyama_pillar"))


@pytest.mark.parametrize("preset", [name for name, values in PRESETS.items() if values["noise"]])
def test_a_presets_chip_has_the_electrons_that_it_states(preset):
    full = Ccd(preset=preset).spelt_out()
    found = photon_transfer(full)
    dark = np.sqrt(full.read_noise_e**2 + full.dark_current_e_s * full.exposure_ms / 1000)
    # the black level takes a few of the 255 counts
    assert found.gain_dn_e == pytest.approx(252 / full.full_well_e, rel=0.01)
    assert found.dark_variance_dn2 >= 0.24
    assert found.dark_noise_e == pytest.approx(dark, rel=0.03)
    assert 0.94 * full.full_well_e < found.saturation_e < 1.01 * full.full_well_e
    assert found.snr_max == pytest.approx(np.sqrt(found.saturation_e))
    assert found.linearity_pct < 0.02
    assert found.prnu_pct == pytest.approx(full.prnu_pct, abs=0.06)
    assert found.dsnu_e == pytest.approx(full.dsnu_e, abs=0.7)


@pytest.mark.parametrize("preset", [name for name, values in PRESETS.items() if values["noise"]])
def test_pixels_of_a_preset_have_the_moments_of_emva_1288s_model(preset):
    """Its equations 2.3 to 2.11 by hand, for each pixel over a stack; the program's own way has pairs and a fit."""
    raw = {"gamma": 1.0, "psf_px": 0.0, "bayer": "none", "interlace": False, "crosstalk": 0.0}
    raw |= {"bandwidth_mhz": "off", "jpeg_quality": "off", "quantum_efficiency": (1.0, 1.0, 1.0)}
    full = Ccd(preset=preset).spelt_out().model_copy(update=raw)
    # Black levels a quarter of a count apart: on their mean rounding adds a variance of 1/12 to noise of half a count.
    chips = [full.model_copy(update={"black_dn": black}) for black in (4.0, 4.25, 4.5, 4.75)]
    rng = np.random.default_rng(4)
    pattern = Pattern.drawn(full, (96, 96), rng)
    per_electron = (255 - 4.375) / full.full_well_e
    gathered = full.dark_current_e_s * full.exposure_ms / 1000
    for share in (0.0, 0.02, 0.1, 0.3, 0.6, 0.85):
        light = np.full((96, 96, 3), share, np.float32)
        stacks = np.array([[expose(light, chip, rng, pattern) for _ in range(8)] for chip in chips], float)
        electrons = share * full.full_well_e + gathered
        noise = per_electron**2 * (electrons + full.read_noise_e**2) + 1 / 12
        assert stacks.var(axis=1, ddof=1).mean() == pytest.approx(noise, rel=0.013)
        assert stacks.mean() - 4.375 == pytest.approx(per_electron * electrons, abs=0.04)
        spread = np.hypot(full.prnu_pct / 100 * share * full.full_well_e, full.dsnu_e)
        patterned = stacks.mean(axis=(0, 1)).var() - noise / 32
        assert patterned == pytest.approx((per_electron * spread) ** 2, rel=0.04, abs=0.002)


def test_what_a_recipe_adds_to_a_chip_is_found():
    noisy = Ccd(read_noise_e=60.0, dark_current_e_s=1e5, row_noise_e=40.0, column_noise_e=50.0, dsnu_e=30.0, gamma=2.2,
                adc_bits=6, hot_pixels=9, quantum_efficiency=(0.5, 0.7, 1), jpeg_quality=60, bayer="rggb")  # fmt: skip
    found = photon_transfer(noisy)
    assert found.dark_noise_e == pytest.approx(np.sqrt(60**2 + 1000 + 40**2), rel=0.03)
    assert found.dsnu_e == pytest.approx(np.hypot(30, 50), rel=0.05)
    assert found.linearity_pct < 0.05


def test_noise_that_eight_bits_hide_is_said_to_be_hidden():
    hidden = Ccd(full_well_e=60000.0)
    found = photon_transfer(hidden)
    dark = {record["name"]: record["found"] for _, record in found.facts(hidden)}["dark noise"]
    assert "unknown electrons, stated 32; variance" in dark
    assert "too little, hidden by rounding" in dark
    assert np.isnan(found.dark_noise_e)
    assert photon_transfer(Ccd(read_noise_e=5.0)).gain_dn_e == pytest.approx(254 / 20000, rel=0.01)
    with pytest.raises(RecipeError, match="bits = 8: rounding hides the noise"):
        photon_transfer(Ccd(full_well_e=1e7))


@pytest.mark.parametrize("bits", [10, 12])
def test_more_bits_show_the_noise_that_eight_hide(bits):
    found = photon_transfer(Ccd(full_well_e=60000.0, bits=bits))
    assert found.gain_dn_e == pytest.approx((2**bits - 1) / 60000, rel=0.01)
    assert found.dark_noise_e == pytest.approx(32, rel=0.02)
    assert found.dark_variance_dn2 == pytest.approx((32 * found.gain_dn_e) ** 2 + 1 / 12, rel=0.02)
    assert found.linearity_pct < 0.01


def test_a_camera_without_noise_is_refused():
    with pytest.raises(RecipeError, match="noise = false: electrons are counted by their noise"):
        photon_transfer(Ccd(preset="ideal"))
