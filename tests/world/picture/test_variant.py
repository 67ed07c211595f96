"""The choice of a Mitsuba variant: bad libraries are refused without ending the process."""

from __future__ import annotations

import glob
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin.errors import InputError, MissingCapability
from twin.study.doctor import examine
from twin.world.picture import variant
from twin.world.picture.variant import REMEDY, choose_variant


@pytest.fixture(autouse=True)
def _own_surroundings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(variant, "cache_folder", lambda: tmp_path)
    monkeypatch.delenv(variant.FORCE, raising=False)
    monkeypatch.setenv(variant.LIBRARY, "")
    monkeypatch.delenv(variant.DRIVER, raising=False)
    monkeypatch.setattr(variant, "_DRIVERS", ())


def test_no_library_means_splat_with_a_remedy() -> None:
    chosen = choose_variant(candidates=[])
    assert chosen.name == "splat"
    assert REMEDY in chosen.reason
    assert "\n" not in chosen.reason


def test_a_file_that_is_no_library_is_refused_and_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "libLLVM.so.99"
    fake.write_bytes(b"\x7fELF but no more")
    assert choose_variant(candidates=[str(fake)]).name == "splat"
    assert list(json.loads((tmp_path / "llvm.json").read_text()).values()) == ["not a library of LLVM 16 or later"]

    def never(library: str, way: str) -> str:
        raise AssertionError(f"{library} was tried twice")

    monkeypatch.setattr(variant, "_try", never)
    assert choose_variant(candidates=[str(fake)]).name == "splat"
    fake.write_bytes(b"another file of the same name")
    with pytest.raises(AssertionError, match="tried twice"):
        choose_variant(candidates=[str(fake)])


def test_a_library_that_kills_its_process_leaves_ours_alive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "libLLVM.so.98"
    fake.write_bytes(b"")
    monkeypatch.setattr(variant, "_PROBE", "import os; print('good', 19, flush=True); os.abort()")
    chosen = choose_variant(candidates=[str(fake)])
    assert chosen.name == "splat"
    assert "ends with code" in chosen.reason


def test_a_hanging_library_is_given_up_but_not_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "libLLVM.so.97"
    fake.write_bytes(b"")
    monkeypatch.setattr(variant, "_try", lambda library, way: f"{variant._UNTRIED} (TimeoutExpired)")
    assert choose_variant(candidates=[str(fake)]).name == "splat"
    assert not (tmp_path / "llvm.json").exists()


def test_old_versions_are_refused_by_name_without_a_try(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(variant, "_try", lambda library, variant: "good")
    assert variant._verdict("/nowhere/libLLVM-15.so.1") == "older than 19"
    assert variant._named_version("/x/libLLVM.so.19.1") == 19
    assert variant._named_version("/x/libLLVM-22.so") == 22
    assert variant._named_version("/x/libLLVM.so") == 0
    assert "No such file" in variant._verdict("/nowhere/libLLVM.so")


def test_a_good_library_is_handed_to_drjit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = tmp_path / "libLLVM.so.19"
    good.write_bytes(b"")
    monkeypatch.setattr(variant, "_try", lambda library, variant: "good")
    chosen = choose_variant(candidates=["/nowhere/libLLVM.so", str(good)])
    assert chosen.name == "llvm_ad_rgb"
    assert os.environ[variant.LIBRARY] == str(good)


def test_a_broken_memory_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / "llvm.json").write_text("{not json")
    assert choose_variant(candidates=[str(tmp_path / "llvm.json")]).name == "splat"


def test_a_gpu_on_which_mitsuba_works_goes_first_and_another_is_passed_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = tmp_path / "libcuda.so.1"
    driver.write_bytes(b"")
    monkeypatch.setattr(variant, "_DRIVERS", (str(tmp_path / "libcuda*"),))
    for verdict, name in (("ends with code -6", "splat"), ("good", "cuda_ad_rgb")):
        (tmp_path / "llvm.json").unlink(missing_ok=True)
        monkeypatch.setattr(variant, "_try", lambda library, way, verdict=verdict: verdict)
        assert choose_variant(candidates=[]).name == name
    assert choose_variant("splat", candidates=[]).name == "splat"
    with pytest.raises(MissingCapability):
        choose_variant("llvm_ad_rgb", candidates=[])


def test_a_gpu_that_is_asked_for_must_be_there(monkeypatch: pytest.MonkeyPatch) -> None:
    verdicts = {"": "Mitsuba on it ends with code 1"}
    monkeypatch.setattr(variant, "_try", lambda library, way: verdicts[library])
    monkeypatch.setenv(variant.FORCE, "cuda_ad_rgb")
    with pytest.raises(MissingCapability, match=r"ends with code 1.*unset TWIN_VARIANT"):
        choose_variant()
    assert any("unset TWIN_VARIANT" in said for said in examine().missing)
    verdicts[""] = "good"
    assert choose_variant().name == "cuda_ad_rgb"


def test_the_driver_that_the_user_names_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = tmp_path / "libcuda.so.1"
    driver.write_bytes(b"")
    monkeypatch.setenv(variant.DRIVER, str(driver))
    monkeypatch.setattr(variant, "_try", lambda library, way: "good" if way == "cuda_ad_rgb" else "bad")
    chosen = choose_variant(candidates=[])
    assert chosen.name == "cuda_ad_rgb"
    assert str(driver) in chosen.reason


@pytest.mark.parametrize("name", ["scalar_rgb", "splat"])
def test_the_environment_forces_a_variant(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(variant.FORCE, name)
    assert choose_variant(candidates=[]).name == name


def test_forcing_what_is_not_there_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(MissingCapability, match="libllvm19"):
        choose_variant("llvm_ad_rgb", candidates=[])
    monkeypatch.setenv(variant.FORCE, "vulkan")
    with pytest.raises(InputError, match="scalar_rgb"):
        choose_variant()


@pytest.mark.slow
@pytest.mark.parametrize("library", sorted({os.path.realpath(p) for p in glob.glob("/usr/lib/*/libLLVM*.so*")}))
def test_every_library_of_this_machine_is_survived(library: str) -> None:
    verdict = variant._try(library)
    said = f"from twin.world.picture import variant; print(variant.choose_variant(candidates=[{library!r}]).name)"
    child = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, timeout=120)
    assert child.returncode == 0, child.stderr
    assert child.stdout.strip() == ("llvm_ad_rgb" if verdict == "good" else "splat")
