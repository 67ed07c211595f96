"""Bad libraries are refused without ending the process; memory is estimated."""

import glob
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from twin.errors import InputError, MissingCapability
from twin.study.check import examine
from twin.study.dataset.create import create_dataset
from twin.study.recipe import load_scene
from twin.study.run import run
from twin.study.sensor import Sensor
from twin.world.picture import backend
from twin.world.picture.backend import REMEDY, Variant

LARGE = {"camera.width_px": 8192, "camera.height_px": 8192}


@pytest.fixture(autouse=True)
def _own_surroundings(tmp_path, monkeypatch):
    monkeypatch.setattr(backend, "cache_folder", lambda: tmp_path)
    monkeypatch.delenv(backend.FORCE, raising=False)
    monkeypatch.setenv(backend.LIBRARY, "")
    monkeypatch.delenv(backend.DRIVER, raising=False)
    monkeypatch.setattr(backend, "DRIVERS", ())


def library(tmp_path, version=99):
    file = tmp_path / f"libLLVM.so.{version}"
    file.write_bytes(b"\x7fELF but no more")
    return str(file)


@pytest.fixture(name="verdicts")
def _verdicts(monkeypatch):
    """Exit codes and lines of the processes in which variants are tried."""
    lines = {"llvm_ad_rgb": (0, "good 19"), "cuda_ad_rgb": (0, "good 0")}

    def child(command, **_):
        code, line = lines[command[-1]]
        if line == "hangs":
            raise subprocess.TimeoutExpired(command, 120)
        return SimpleNamespace(returncode=code, stdout=line)

    run = SimpleNamespace(run=child, TimeoutExpired=subprocess.TimeoutExpired)
    monkeypatch.setattr(backend, "subprocess", run)
    return lines


def test_a_file_that_is_no_library_is_refused_and_remembered(tmp_path, monkeypatch):
    fake = library(tmp_path)
    for candidates in ([], [fake]):
        chosen = Variant.choose(candidates=candidates)
        assert chosen.name == "splat"
        assert REMEDY in chosen.reason
        assert "\n" not in chosen.reason
    assert list(json.loads((tmp_path / "llvm.json").read_text()).values()) == ["not a library of LLVM 16 or later"]
    monkeypatch.setattr(backend.subprocess, "run", lambda *_, **__: pytest.fail("tried twice"))
    assert Variant.choose(candidates=[fake]).name == "splat"
    Path(fake).write_bytes(b"another file of the same name")
    with pytest.raises(pytest.fail.Exception, match="tried twice"):
        Variant.choose(candidates=[fake])


def test_a_library_that_kills_its_process_leaves_ours_alive(tmp_path, monkeypatch):
    monkeypatch.setattr(backend, "PROBE", "import os; print('good', 19, flush=True); os.abort()")
    chosen = Variant.choose(candidates=[library(tmp_path)])
    assert chosen.name == "splat"
    assert "ends with code" in chosen.reason


def test_a_try_that_was_stopped_from_outside_is_repeated_before_it_is_stored(tmp_path, monkeypatch, verdicts):
    """A killed test run once left the verdict that a good library crashes, for good."""
    good, codes = library(tmp_path, 19), [-6, 0]
    child = lambda *_, **__: SimpleNamespace(returncode=codes.pop(0), stdout="good 19")  # noqa: E731
    monkeypatch.setattr(backend.subprocess, "run", child)
    assert Variant.choose(candidates=[good]).name == "llvm_ad_rgb"
    assert list(json.loads((tmp_path / "llvm.json").read_text()).values()) == ["good"]


@pytest.mark.parametrize(
    ("line", "why", "stored"),
    [("hangs", "could not be tried", False), ("old 18", "older than 19", True), ("wrong 19", "computes wrongly", True)],
)
def test_verdicts_are_stored_but_not_of_a_library_that_hangs(line, why, stored, tmp_path, verdicts):
    verdicts["llvm_ad_rgb"] = (0, line)
    chosen = Variant.choose(candidates=[library(tmp_path)])
    assert chosen.name == "splat"
    assert why in chosen.reason
    assert (tmp_path / "llvm.json").exists() == stored


def test_old_and_missing_libraries_are_refused_without_a_try(verdicts):
    for file, why in (("/nowhere/libLLVM-15.so.1", "older than 19"), ("/nowhere/libLLVM.so", "No such file")):
        assert why in Variant.choose(candidates=[file]).reason


def test_a_good_library_is_handed_to_drjit(tmp_path, verdicts):
    good = library(tmp_path, 19)
    (tmp_path / "llvm.json").write_text("{not json")  # a broken store is no obstacle
    assert Variant.choose(candidates=["/nowhere/libLLVM.so", good]).name == "llvm_ad_rgb"
    assert os.environ[backend.LIBRARY] == good


def test_a_gpu_on_which_mitsuba_works_goes_first_and_another_is_passed_by(tmp_path, monkeypatch, verdicts):
    (tmp_path / "libcuda.so.1").write_bytes(b"")
    monkeypatch.setattr(backend, "DRIVERS", (str(tmp_path / "libcuda*"),))
    for code, name in ((-6, "splat"), (0, "cuda_ad_rgb")):
        (tmp_path / "llvm.json").unlink(missing_ok=True)
        verdicts["cuda_ad_rgb"] = (code, "good 0")
        assert Variant.choose(candidates=[]).name == name
    monkeypatch.setattr(backend, "DRIVERS", ())
    monkeypatch.setenv(backend.DRIVER, str(tmp_path / "libcuda.so.1"))  # the driver that the user names
    assert str(tmp_path) in Variant.choose(candidates=[]).reason
    assert Variant.choose("splat", candidates=[]).name == "splat"
    with pytest.raises(MissingCapability, match="libllvm19"):
        Variant.choose("llvm_ad_rgb", candidates=[])


def test_a_gpu_that_is_wanted_must_be_there(monkeypatch, verdicts):
    verdicts["cuda_ad_rgb"] = (1, "")
    monkeypatch.setenv(backend.FORCE, "cuda_ad_rgb")
    with pytest.raises(MissingCapability, match=r"ends with code 1.*unset TWIN_VARIANT"):
        Variant.choose()
    assert any("unset TWIN_VARIANT" in line for line in examine()[1])
    verdicts["cuda_ad_rgb"] = (0, "good 0")
    assert Variant.choose().name == "cuda_ad_rgb"


def test_the_environment_forces_a_variant(monkeypatch):
    monkeypatch.setenv(backend.FORCE, "splat")
    assert Variant.choose(candidates=[]).reason == "splat was chosen by name"
    monkeypatch.setenv(backend.FORCE, "vulkan")
    with pytest.raises(InputError, match="llvm_ad_rgb, cuda_ad_rgb, splat"):
        Variant.choose()


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted({os.path.realpath(p) for p in glob.glob("/usr/lib/*/libLLVM*.so*")}))
def test_every_library_of_this_machine_is_survived(file):
    called = f"backend.Variant.choose(candidates=[{file!r}]).name"
    command = f"from twin.world.picture import backend; backend.DRIVERS = (); print({called})"
    child = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, timeout=120)
    assert child.returncode == 0, child.stderr
    assert child.stdout.strip() == Variant.choose(candidates=[file]).name


@pytest.fixture(name="free")
def _free(tmp_path, monkeypatch):
    """A function that sets the free memory, kB, and the limit of a container, bytes."""

    def files(available_kb, limit="max"):
        (tmp_path / "meminfo").write_text(f"MemTotal: 9000 kB\nMemAvailable: {available_kb} kB\n")
        (tmp_path / "max").write_text(f"{limit}\n")

    monkeypatch.setattr(backend, "MEMORY_FILES", (tmp_path / "meminfo", tmp_path / "max"))
    return files


def test_a_pupil_takes_a_view_for_every_point_and_no_camera_takes_nothing(free):
    free(0)
    Variant.check_machine(load_scene("block_bare"))
    needed = []
    for aperture in (0, 0.5):
        with pytest.raises(MissingCapability) as refused:
            Variant.check_machine(load_scene("kamiyama_pillar", {**LARGE, "camera.aperture_mm": aperture}))
        needed.append(float(str(refused.value).split(" GB")[0].split()[-1]))
    assert 3.5 < needed[1] / needed[0] < 5


def test_a_picture_without_memory_is_refused_before_anything_is_computed(monkeypatch, tmp_path, free):
    monkeypatch.setattr(Sensor, "press", lambda *_, **__: pytest.fail("pressed"))
    for given in ((8_000_000,), (20_000_000, 8_192_000_000)):  # the least of what the system states
        free(*given)
        with pytest.raises(
            MissingCapability, match=r"camera.width_px = 8192.* about 9.3 GB.* 8.2 GB are free .*fewer pixels"
        ):
            run(load_scene("kamiyama_pillar", LARGE))
    with pytest.raises(MissingCapability, match=r"aperture_mm = 0 "):
        Sensor(load_scene("kamiyama_pillar", {**LARGE, "camera.aperture_mm": 0.5})).picture(None)
    free(100_000)
    scene = load_scene("dataset_kamiyama", {"dataset.samples_per_shard": 5})
    with pytest.raises(MissingCapability, match=r"4 pictures at once .*fewer --workers"):
        create_dataset(scene, tmp_path / "set", samples=20, workers=8)
    assert not (tmp_path / "set").exists()


def test_a_scene_of_many_pixels_runs_where_no_picture_is_wanted(free):
    free(1000)
    assert run(load_scene("kamiyama_pillar", {**LARGE, "press.friction": 0.0}), {"displacement"}).truth is not None
