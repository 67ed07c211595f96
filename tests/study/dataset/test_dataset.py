"""Datasets: the same bytes whatever happens on the way, truth that balances, failures that are rows."""

import io
import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w
from PIL import Image
from small_dataset import NO_PICTURE, contents, make, small_scene
from standard_bodies import write_stl

import twin
from twin.errors import InputError, RecipeError, TwinError
from twin.files import write_whole
from twin.study.batch.draw import with_values
from twin.study.batch.pool import only_writer
from twin.study.check import check_path
from twin.study.dataset import create
from twin.study.dataset.plan import Plan


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset") / "d"
    assert make(folder).failed == 0
    return folder


def test_a_finished_dataset_passes_its_check_and_has_what_was_asked_for(made: Path) -> None:
    assert "checksums and schema ok" in check_path(str(made))[0][0]
    data = twin.open_dataset(made)
    assert len(data) == 4
    assert set(NO_PICTURE) < set(data.columns)
    assert not {"picture", "marker_visible"} & set(data.columns)
    row = data[-1]
    np.testing.assert_allclose(row["force_n"][2], json.loads(row["press"])["force_n"][2], atol=1e-9)
    np.testing.assert_allclose(row["site_force_n"].sum(axis=0), row["force_n"], atol=1e-9)
    assert data.column("marker_displacement_mm").shape == (4, 59, 3)


def test_a_samples_truth_is_that_of_a_single_run(made: Path) -> None:
    """The dataset takes short cuts (gathered loads, no gradients); a sensor of its own must say the same."""
    data = twin.open_dataset(made)
    row, told = data[3], data.sensor(1)
    modulus = float(told["vary_material_youngs_modulus_mpa"])
    scene = small_scene(vary={}, material__youngs_modulus_mpa=modulus, seed=told["seed"])
    sensor = twin.Sensor(scene)
    state = sensor.press(twin.Press(**json.loads(row["press"])))
    motion = sensor.motion(state.load)
    size = np.abs(motion.displacement_mm).max()
    np.testing.assert_allclose(row["marker_displacement_mm"], motion.displacement_mm, atol=1e-5 * size)
    np.testing.assert_allclose(told["marker_rest_mm"], sensor.actual.markers.points, atol=1e-12)


def flip_a_bit(path: Path) -> None:
    """Damage a Parquet file so that it still opens, and only its checksum tells."""
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 3] ^= 1
    path.write_bytes(whole)
    pq.read_schema(path)


def test_what_was_damaged_later_is_made_again_and_never_taken_for_whole(made: Path, tmp_path: Path) -> None:
    """Files that still open, so that only their checksums tell; and those that no checksum of a shard covers."""
    folder = tmp_path / "d"
    shutil.copytree(made, folder)
    flip_a_bit(folder / "data" / "part-00001.parquet")
    (folder / "sensors" / "part-00000.parquet").unlink()
    scene = folder / "meta" / "scene.toml"
    scene.write_text(scene.read_text().replace("poisson_ratio = 0.5", "poisson_ratio = 0.4"))
    (folder / "meta" / "audit.json").write_text('{"of": 4')
    assert make(folder).made == 4
    assert contents(folder) == contents(made)
    mesh = next((folder / "meta").glob("mesh-*.npz"))
    mesh.write_bytes(mesh.read_bytes() + b"x")
    with pytest.raises(InputError, match=f"{mesh.name}: changed since the dataset was begun"):
        make(folder)
    assert make(made).made == 0


def test_a_check_names_the_first_files_of_each_problem_and_counts_the_others(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(made, folder)
    flip_a_bit(folder / "data" / "part-00001.parquet")
    for number in range(5):
        (folder / "data" / f"stray-{number}.parquet").write_bytes(b"")
    with pytest.raises(RecipeError) as told:
        check_path(str(folder))
    strays = [f"data/stray-{number}.parquet: not in SHA256SUMS" for number in range(3)]
    changed = "data/part-00001.parquet: changed since it was written (its checksum differs)"
    assert told.value.problems == [*strays, "2 more: not in SHA256SUMS", changed]


@pytest.mark.parametrize("kind", ["data", "sensors"])
def test_what_was_damaged_before_the_end_is_made_again_too(kind: str, made: Path, tmp_path: Path) -> None:
    """A run that ends early leaves shards without SHA256SUMS; one changed bit leaves Parquet files that open."""
    folder = tmp_path / "d"

    def stop(what: str, share: float) -> None:
        if "samples," in what and share > 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(folder, progress=stop)
    assert not (folder / "meta" / "SHA256SUMS").exists()
    with pytest.raises(InputError, match="not finished"):
        check_path(str(folder))
    (folder / "data" / ".part-00001.parquet.77.part").write_bytes(b"half")
    (folder / "data" / "part-00001.parquet").unlink(missing_ok=True)
    flip_a_bit(folder / kind / "part-00000.parquet")
    assert make(folder).made == 4
    assert contents(folder) == contents(made)


def test_a_body_without_markers_is_no_trouble_and_columns_that_are_always_there_may_be_named(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    vary = {"press.at_mm": {"low": [-3.0, -2.0], "high": [3.0, 2.0]}}
    press = {"probe": {"kind": "sphere", "diameter_mm": 6.0}, "force_n": [0.0, 0.0, 0.5], "friction": 0.0}
    columns = ["index", "force_n", "marker_displacement_mm"]
    scene = twin.load_scene("block_bare", {"press": press, "vary": vary, "dataset.columns": columns})
    assert make(folder, 2, scene).failed == 0
    assert twin.open_dataset(folder)[1]["marker_displacement_mm"].shape == (0, 3)
    assert "no columns whose forces should balance, no columns to project" in check_path(str(folder))[-1][0]


def test_a_probes_own_file_travels_with_the_dataset_wherever_it_lay(tmp_path: Path) -> None:
    """Given outright or as one of several: the bytes know it by its content, and `meta/` has it for every worker."""
    base, tip = [(4, 4, -2), (-4, 4, -2), (-4, -4, -2), (4, -4, -2)], (0, 0, 0)  # a blunt pyramid
    sides = [(base[i], base[(i + 1) % 4], tip) for i in range(4)]
    corners = [*sides, (base[2], base[1], base[0]), (base[3], base[2], base[0])]
    for place in ("here", "there"):
        (tmp_path / place).mkdir()
        write_stl(tmp_path / place / "tip.stl", np.array(corners, float))
        probe = {"kind": "stl", "file": "tip.stl"}
        table = {"base": "kamiyama_pillar", "press": {"probe": probe, "friction": 0.0, "force_n": [0.0, 0.0, 0.3]},
                 "accuracy": {"contact_patches": 6}, "vary": {"press.probe": {"choice": [probe, probe]}}}  # fmt: skip
        (tmp_path / place / "scene.toml").write_text(tomli_w.dumps(table))
        scene = twin.load_scene(tmp_path / place / "scene.toml", {"dataset.columns": ["force_n"]})
        assert make(tmp_path / place / "d", 1, scene).failed == 0
        shutil.move(tmp_path / place / "tip.stl", tmp_path / "gone.stl")
    row = twin.open_dataset(tmp_path / "here" / "d")[0]
    name = json.loads(row["press"])["probe"]["file"]
    assert name == json.loads(row["vary_press_probe"])["file"]
    assert (tmp_path / "here" / "d" / "meta" / name).is_file()
    assert contents(tmp_path / "here" / "d") == contents(tmp_path / "there" / "d")


def test_a_larger_dataset_begins_with_the_smaller_one(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "d"
    make(folder, 3)
    make(folder, 4)
    assert contents(folder) == contents(made)
    with pytest.raises(InputError, match="--samples 4 or more"):
        make(folder, 3)


@pytest.mark.parametrize("sampling", ["stratified", "random"])
def test_a_sample_is_known_from_seed_and_number_alone(sampling: str) -> None:
    plan = Plan(small_scene(dataset__sampling=sampling), 100)
    many = plan.press_values(range(40, 60))
    assert plan.press_values(range(47, 48))[0] == many[7]
    assert plan.press_values(range(0, 50))[45] == many[5]
    assert Plan(small_scene(dataset__sampling=sampling, seed=2), 100).press_values(range(40, 60)) != many


@pytest.mark.parametrize("sampling", ["stratified", "random"])
def test_what_is_drawn_for_sensors_tells_nothing_of_the_presses(sampling: str) -> None:
    vary = {"press.friction": {"low": 0.0, "high": 1.0}, "material.youngs_modulus_mpa": {"low": 1.0, "high": 2.0}}
    plan = Plan(small_scene(vary=vary, dataset__sampling=sampling), 64)
    presses = [values["press.friction"] for values in plan.press_values(range(64))]
    sensors = [values["material.youngs_modulus_mpa"] - 1.0 for values in plan.sensor_values(range(64))]
    assert not np.isclose(presses, sensors).any()
    assert abs(np.corrcoef(presses, sensors)[0, 1]) < (0.4 if sampling == "random" else 0.1)


def test_stratified_draws_are_more_even_than_random_ones() -> None:
    spread = {}
    for sampling in ("stratified", "random"):
        values = Plan(small_scene(dataset__sampling=sampling), 64).press_values(range(64))
        x = np.array([v["press.at_mm"][0] for v in values])
        spread[sampling] = np.histogram(x, bins=16, range=(-3, 3))[0].std()
    assert spread["stratified"] == 0.0
    assert spread["random"] > 1.0


def test_a_failing_sample_is_a_row_with_its_error_and_in_no_part(tmp_path: Path) -> None:
    far = {"press.at_mm": {"choice": [[0.0, 0.0], [60.0, 0.0]]}}
    done = make(tmp_path / "d", 8, small_scene(vary=far, dataset__samples_per_sensor=1))
    assert 0 < done.failed < 8
    data = twin.open_dataset(tmp_path / "d")
    bad = [row for row in data if row["status"] == "failed"]
    assert len(bad) == done.failed
    assert all("misses" in row["error"] or "outside" in row["error"] for row in bad), bad[0]["error"]
    assert all(row["force_n"] is None for row in bad)
    assert len(data.column("force_n")) == 8 - done.failed
    good = [row["index"] for row in data if row["status"] == "ok"]
    tests = [index for index in good if index in (1, 6)]  # a sensor each: every fifth from the second on
    assert tests
    parts = {"all": good, "test": tests, "train": [index for index in good if index not in tests]}
    for name, numbers in parts.items():
        part = twin.open_dataset(tmp_path / "d", ["index"], split=name)
        assert len(part) == len(numbers)
        assert [row["index"] for row in part] == part.column("index").tolist() == numbers


@pytest.mark.slow
def test_large_strain_is_in_the_motion_of_a_samples_markers(tmp_path: Path) -> None:
    law = {"material__law": "neo_hookean"}
    found = {}
    for name, given in (("straight", {}), ("bent", law)):
        make(tmp_path / name, 1, small_scene((*NO_PICTURE, "linearisation_error", "displacement_error"), **given))
        found[name] = twin.open_dataset(tmp_path / name)[0]
    scene = twin.load_scene(tmp_path / "bent" / "meta" / "scene.toml")
    assert scene.material.law == "neo_hookean"
    moved = {name: np.asarray(row["marker_displacement_mm"]) for name, row in found.items()}
    off = np.linalg.norm(moved["bent"] - moved["straight"], axis=1).max()
    most = np.linalg.norm(moved["straight"], axis=1).max()
    assert off == pytest.approx(found["bent"]["linearisation_error"] * most, rel=0.2)
    assert found["bent"]["displacement_error"] > 5e-5 + found["straight"]["displacement_error"]
    assert "Large strain is included" in (tmp_path / "bent" / "README.md").read_text()
    assert "linear: no rate" in (tmp_path / "straight" / "README.md").read_text()


def test_contact_beyond_the_sites_fails_instead_of_losing_force(tmp_path: Path) -> None:
    sites = {"columns": 3, "rows": 3, "pitch_mm": 0.5}
    done = make(tmp_path / "d", 1, small_scene(dataset__sites=sites))
    assert done.failed == 1
    assert "beyond the sites" in done.reason


def test_a_mistake_of_the_program_fails_its_sample_and_not_the_run(tmp_path, monkeypatch):
    def mistaken(*_: object, **__: object) -> None:
        raise ValueError("five")

    monkeypatch.setattr(twin.Sensor, "press", mistaken)
    done = make(tmp_path / "d", 1)
    assert (done.failed, done.reason) == (1, "sample 0: internal error: ValueError: five")


def test_two_writers_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    lock = only_writer(folder, folder / "meta" / "writer.lock")
    with lock, pytest.raises(InputError, match="another process"):
        make(folder)
    folder.mkdir()
    (folder / "README.md").write_text("mine")
    with pytest.raises(InputError, match=r"has README.md but no meta/info.json"):
        make(folder)
    assert [each.name for each in folder.iterdir()] == ["README.md"], "a refused dataset leaves nothing"


def test_another_scene_columns_or_versions_are_refused(made: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"another scene \(material\.poisson_ratio 0\.\d+ then, 0\.49 now\)"):
        make(made, scene=small_scene(material__poisson_ratio=0.49))
    with pytest.raises(InputError, match="other columns"):
        make(made, scene=small_scene(columns=("force_n",)))
    assert not (made / "meta" / "writer.lock").exists()
    shutil.copytree(made, tmp_path / "d")
    told = tmp_path / "d" / "meta" / "info.json"
    told.write_text(told.read_text().replace('"numpy": "', '"numpy": "9.'))
    with pytest.raises(InputError, match=r"other versions \(numpy 9\."):
        make(tmp_path / "d")


def test_a_full_disk_leaves_whole_files_and_the_same_command_goes_on(made, tmp_path, monkeypatch):
    def full(path: Path, write: object) -> None:
        if path.name == "part-00001.parquet" and path.parent.name == "data":
            raise TwinError(f"{path}: can't be written (No space left on device)")
        write_whole(path, write)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(create, "write_whole", full)
        with pytest.raises(TwinError, match="No space left"):
            make(tmp_path / "d")
    make(tmp_path / "d")
    assert contents(tmp_path / "d") == contents(made)


@pytest.mark.parametrize(
    ("key", "ends", "words"),
    [
        ("body.thickness_mm", (1, 2), "body can't vary"),
        ("press.probe.width_mm", (1, 2), r"vary\.press\.probe\.width_mm: unknown key; it belongs to kind = 'pillar'$"),
        (
            "press.at_mm",
            ((-1e300, 0.0), (1e300, 0.0)),
            r"first: press\.at_mm\.0 = .* must be less than or equal to 10000 mm$",
        ),
        ("press.at_m", (1, 2), "unknown key; did you mean 'at_mm'"),
        ("press.steps.3.torque_nmm", (1, 2), "no place in a list of 0"),
        ("markers.green.depth_mm", (1, 2), "no 'green'; known there are red, blue"),
        ("material.youngs_modulus", (1, 2), "youngs_modulus: unknown key; did you mean 'youngs_modulus_mpa'"),
        ("material.poisson_ratio", (0.45, 0.6), "high ends of the ranges.*poisson_ratio"),
        ("material.poisson_ratio", (-0.7, 0.45), "low ends of the ranges.*poisson_ratio"),
    ],
)
def test_what_can_not_vary_is_refused_by_name_by_dataset_and_check(key, ends, words, tmp_path):
    scene = small_scene(vary={key: dict(zip(("low", "high"), ends, strict=True))})
    recipe = tmp_path / "scene.toml"
    recipe.write_text(scene.to_toml())
    for refuse in (lambda: make(tmp_path / "d", 1, scene), lambda: check_path(str(recipe))):
        with pytest.raises(RecipeError, match=words):
            refuse()
    assert not (tmp_path / "d").exists()


def test_pictures_are_png_that_other_readers_open(tmp_path: Path) -> None:
    scene = small_scene(columns=("picture", "marker_visible", "marker_outline_pressed_px", "marker_pressed_px"))
    make(tmp_path / "d", 3, scene)
    data = twin.open_dataset(tmp_path / "d")
    table = pq.read_table(tmp_path / "d" / "data")
    raw = table["picture"][0].as_py()
    with Image.open(io.BytesIO(raw)) as image:
        image.verify()
    first, rest = data[0]["picture"], data.sensor(0)["picture"]
    assert first.shape == (120, 160, 3)
    assert 1 < np.abs(first.astype(int) - rest).max() < 200
    assert (data[1]["picture"] != first).any()
    shown = data[0]["marker_visible"] > 0.98
    apart = data[0]["marker_outline_pressed_px"] - data[0]["marker_pressed_px"]
    assert np.abs(apart[shown]).max() < 0.1


def test_a_reader_reads_what_is_asked_for_and_travels_to_other_processes(made: Path) -> None:
    data = twin.open_dataset(made, ["force_n"])
    assert set(data[0]) == {"force_n"}
    assert data[0]["force_n"].flags.writeable  # torch warns of arrays that are not
    copy = pickle.loads(pickle.dumps(data))
    np.testing.assert_array_equal(copy[1]["force_n"], data[1]["force_n"])
    for ask in (lambda: twin.open_dataset(made, ["froce"]), lambda: data.table(["froce"])):
        with pytest.raises(InputError, match="no column froce; did you mean 'force_n'"):
            ask()
    with pytest.raises(IndexError):
        data[4]
    with pytest.raises(InputError, match="split = 'tset': must be one of train, test, all"):
        twin.open_dataset(made, split="tset")
    with pytest.raises(InputError, match="no dataset"):
        twin.open_dataset(made / "data")


def test_steps_that_leds_light_in_turn_say_by_which_group(tmp_path: Path) -> None:
    steps = [{"force_n": {"z": 0.1 * number}} for number in (1, 2, 3)]
    keys = {"vary": {}, "press__steps": steps, "dataset__every_step": True, "light__lit": [[0, 1], [2, 3], [1]]}
    make(tmp_path / "d", 1, small_scene((), **keys))
    data = twin.open_dataset(tmp_path / "d")
    assert [row["lit"] for row in data] == [0, 1, 2]
    made = data.sensor(0)
    rests = [made[name] for name in ("picture", "picture_1", "picture_2")]
    for row in data:  # lightly pressed, a picture is most like the rest picture of its group
        off = [np.abs(row["picture"].astype(int) - rest).mean() for rest in rests]
        assert np.argmin(off) == row["lit"]
    with pytest.raises(RecipeError, match=r"light\.lit can't vary"):
        make(tmp_path / "e", 1, small_scene(vary={"light.lit": {"choice": [[[0]], [[1]]]}}))


def test_every_step_of_a_path_can_be_kept(tmp_path: Path) -> None:
    steps = [{"force_n": {"z": 0.5}}, {"force_n": {"x": 0.1, "y": 0.0, "z": 0.5}}]
    scene = small_scene(
        press__steps=steps, press__friction=0.8, dataset__every_step=True,
        vary={"press.steps.1.force_n": {"normal_n": 0.5, "ratio": 0.3}},
    )  # fmt: skip
    make(tmp_path / "d", 1, scene)
    data = twin.open_dataset(tmp_path / "d")
    assert [(row["index"], row["step"]) for row in data] == [(0, 0), (0, 1)]
    assert np.hypot(*data[1]["force_n"][:2]) == pytest.approx(0.15, rel=1e-6)
    np.testing.assert_allclose(data[0]["force_n"][:2], 0, atol=1e-9)
    with pytest.raises(InputError, match=r"no sample to test: it takes .* two made sensors"):
        twin.open_dataset(tmp_path / "d", split="test")


@pytest.mark.slow
def test_a_sequence_is_filmed_and_stays_together(tmp_path: Path) -> None:
    steps = [{"force_n": {"z": 0.5}, "seconds": 0.04}, {"move_mm": {"x": 0.3}, "force_n": {"z": 0.5}, "seconds": 0.04}]
    columns = ("time_s", "split", "slip_share", "force_n", "surface_slip", "marker_displacement_mm", "picture")
    still, moving = (
        small_scene(
            columns, press__steps=steps, press__friction=0.5, dataset__every_step=True, dataset__samples_per_shard=1,
            vary={"press.at_mm": {"low": [0.0, 0.0], "high": [0.5, 0.5]}}, accuracy__centroid_px=0.1, ccd__noise=False,
            press__probe={"kind": "sphere", "diameter_mm": 6}, ccd__frames_per_second=50, ccd__exposure_ms=exposure_ms,
            camera__focal_px=1800.0, accuracy__contact_increments=2,
        )
        for exposure_ms in (0.001, 20.0)
    )  # fmt: skip
    make(tmp_path / "still", 5, still)
    make(tmp_path / "moving", 1, moving)
    rows = list(twin.open_dataset(tmp_path / "still"))
    assert {row["index"] for row in twin.open_dataset(tmp_path / "still", split="test")} == {4}
    assert [(row["index"], row["split"]) for row in rows[3::4]] == [*[(n, "train") for n in range(4)], (4, "test")]
    np.testing.assert_allclose([row["time_s"] for row in rows[:4]], [0.02, 0.04, 0.06, 0.08])
    np.testing.assert_allclose([row["force_n"][2] for row in rows[:4]], [0.25, 0.5, 0.5, 0.5], rtol=1e-6)
    shares = [row["slip_share"] for row in rows[:4]]
    assert shares[1] < 0.1
    assert 0.1 < shares[2] < shares[3]
    # Exposures take time: the truth is the same, the picture another one.
    blurred = list(twin.open_dataset(tmp_path / "moving"))
    for one, other in zip(rows[:4], blurred, strict=True):
        np.testing.assert_allclose(one["marker_displacement_mm"], other["marker_displacement_mm"], atol=1e-12)
    assert 0 < np.abs(rows[2]["picture"].astype(int) - blurred[2]["picture"]).max() < 60


def test_several_probes_count_together(tmp_path: Path) -> None:
    scene = small_scene(
        columns=("force_n", "site_force_n", "surface_slip", "surface_force_n", "traction_error"), vary={},
        press__also=[{"probe": {"kind": "sphere", "diameter_mm": 4}, "at_mm": [4.0, 0.0], "force_n": {"z": 0.5}}],
        press__force_n={"z": 0.5}, press__at_mm=[-4.0, 0.0],
    )  # fmt: skip
    assert make(tmp_path / "d", 1, scene).reason == ""
    row = twin.open_dataset(tmp_path / "d")[0]
    assert row["force_n"][2] == pytest.approx(1.0, rel=1e-6)
    assert row["site_force_n"][:, 2].sum() == pytest.approx(1.0, rel=1e-6)
    assert len(row["surface_slip"]) == len(row["surface_force_n"])
    assert 0 < row["traction_error"] < 1


def test_samples_that_are_all_the_same_press_are_said(tmp_path: Path) -> None:
    scene = small_scene(columns=("force_n",), vary={"material.youngs_modulus_mpa": {"low": 0.8, "high": 1.2}})
    with pytest.warns(UserWarning, match=r"all 4 samples are the same one, on 2 made sensors.*press\.at_mm"):
        make(tmp_path / "d", 4, scene)
    assert twin.open_dataset(tmp_path / "d").column("force_n").std(axis=0).max() < 1e-12
    assert "on one made sensor" in Plan(scene, 3).alike
    assert Plan(scene, 1).alike == Plan(small_scene(), 4).alike == ""


def test_time_is_estimated_once_from_cpu_seconds_of_samples_and_sensors(monkeypatch, tmp_path: Path) -> None:
    cpu = [0.0]
    monkeypatch.setattr("twin.study.batch.pool.cache_folder", lambda: tmp_path)

    def takes(*seconds: float) -> Callable[[Path, int], SimpleNamespace]:
        def work(folder: Path, number: int) -> SimpleNamespace:
            cpu[0] += seconds[number % len(seconds)]
            return SimpleNamespace(samples=b"", sensors=b"", failed=0, reason="")

        return work

    monkeypatch.setattr(create, "time", SimpleNamespace(process_time=lambda: cpu[0]))
    monkeypatch.setattr(create, "make_shard", takes(12.0, 6.0, 5.0))  # begins, three samples, one of a new sensor
    monkeypatch.setattr(create, "audit_sample", takes(2.0))
    told, records = zip(*create.estimate(small_scene(columns=("force_n",)), 300, workers=2), strict=True)
    assert "300 on 100 sensors, in 150 files" in told[0]
    assert "about 8 min with 2 workers" in told[-1]
    assert "2 s of CPU a sample" in told[-1]
    assert "6 s to begin, 3 s for each further sensor" in told[-1]
    assert records[-1]["seconds"] == 6 + (300 * 2 + 99 * 3 + 3 * 2) / 2
    spent = cpu[0]
    more = [line for line, _ in create.estimate(small_scene(columns=("force_n",)), 600, workers=2)]
    assert "about 15 min with 2 workers" in more[-1]
    assert "(of 3 tried, made before)" in more[-1]
    assert cpu[0] == spent
    few = [line for line, _ in create.estimate(small_scene(columns=("force_n",), vary={}), 3)]
    assert "about 14 s with 1 worker" in few[-2]
    assert "the same one" in few[-1]


@pytest.mark.parametrize("u", [0.0, 0.5, 1 - 1e-9])
def test_what_the_realistic_dataset_draws_is_allowed_and_changes_pictures_alone(u: float) -> None:
    """All axes at their low end, middle and high end: a range beyond a key's would fail every other sensor."""
    scene = twin.load_scene("dataset_realistic")
    axes = Plan(scene, 1).sensor_axes
    drawn = with_values(scene, {key: axis.at(np.full(axis.takes, u)) for key, axis in axes.items()})
    push = twin.Traction.disk(centre_mm=(1, 0), radius_mm=1.5, force_n=(0.05, 0, 0.2))
    plain, real = twin.Sensor(scene), twin.Sensor(drawn)
    np.testing.assert_array_equal(real.actual.markers.points, plain.actual.markers.points)
    np.testing.assert_array_equal(real.motion(push).displacement_mm, plain.motion(push).displacement_mm)
    assert np.abs(real.picture(push).astype(float) - plain.picture(push)).mean() > 5
