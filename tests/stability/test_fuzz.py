"""Hostile files: every reader under ``python -m benchmarks fuzz``, and what was found by it, one by one."""

import fcntl
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import fuzz
from benchmarks.fuzz_files import LAUGHS, READERS, Reader, npy_header, png, png_bomb
from twin.errors import InputError
from twin.files import read_arrays, write_json
from twin.study.batch.pool import only_writer
from twin.study.check import check_path
from twin.study.dataset.plan import FORMAT
from twin.study.dataset.reader import DatasetReader, open_dataset
from twin.study.frames import read_picture
from twin.study.intrinsics import read_intrinsics


@pytest.mark.slow
def test_no_reader_crashes_hangs_or_writes_elsewhere(tmp_path: Path) -> None:
    """In a process of its own: what is forked beside the threads of other tests would wait for them for ever."""
    command = [sys.executable, "-m", "benchmarks", "fuzz", "--rounds", "1", "--out", str(tmp_path / "fuzz.json")]
    done = subprocess.run(command, cwd=Path(fuzz.__file__).parents[1], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "fuzz.json").read_text())["rows"]
    assert {row["reader"] for row in rows} == set(READERS)
    assert sum(row["attempts"] for row in rows) > 250


def test_the_guards_of_an_attempt_see_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A child that crashes, writes beside its folder, or says nothing is each told apart."""
    deeds = {
        "ended with code -6": os.abort,
        "something outside": lambda: (tmp_path / "box" / "outside" / "new").write_text("") and None,
        "internal error": lambda: 1 / 0,
        "and no word": lambda: os.execl("/bin/sh", "sh", "-c", "exit 2"),
    }
    for words, deed in deeds.items():
        shutil.rmtree(tmp_path / "box", ignore_errors=True)
        for name in ("inside", "outside"):
            (tmp_path / "box" / name).mkdir(parents=True)
        monkeypatch.setattr("twin.study.check.check_path", lambda *_, deed=deed: [str(deed())])
        one = fuzz.attempt(Reader("any", ("check", "block_bare"), ()), tmp_path / "box")
        assert words in one.wrong, (words, one)


@pytest.mark.parametrize("members", [{"a": (10**6, 10**6)}, {"a": (-1,)}, {"b": (3,)}])
def test_an_archive_that_lies_about_its_arrays_is_refused(tmp_path: Path, members: dict[str, tuple[int, ...]]) -> None:
    import zipfile

    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for name, shape in members.items():
            archive.writestr(f"{name}.npy", npy_header(shape) + bytes(8))
    with pytest.raises(ValueError, match=r"."):
        read_arrays(tmp_path / "a.npz")


def test_an_archive_is_not_unpacked_beyond_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "a.npz", zeros=np.zeros(1000))
    assert read_arrays(tmp_path / "a.npz")["zeros"].shape == (1000,)
    assert read_arrays(tmp_path / "a.npz", ["none"]) == {}
    monkeypatch.setattr("twin.files.LARGEST_BYTES", 5000)
    with pytest.raises(ValueError, match="unpacks to"):
        read_arrays(tmp_path / "a.npz")


def test_pipes_are_refused_and_not_waited_for(tmp_path: Path) -> None:
    for name in ("a.npz", "a.png", "a.yaml"):
        os.mkfifo(tmp_path / name)
    with pytest.raises(ValueError, match="no file"):
        read_arrays(tmp_path / "a.npz")
    with pytest.raises(InputError, match="no file"):
        read_picture(tmp_path / "a.png")
    with pytest.raises(InputError, match="no file"):
        read_intrinsics(tmp_path / "a.yaml")


def test_yaml_that_multiplies_itself_is_refused(tmp_path: Path) -> None:
    (tmp_path / "lens.yaml").write_text(LAUGHS)
    with pytest.raises(InputError, match="refers to itself"):
        read_intrinsics(tmp_path / "lens.yaml")


def test_a_picture_in_a_dataset_is_bounded() -> None:
    assert DatasetReader.decoded(png_bomb(20)).shape == (20, 20, 3)
    with pytest.raises(ValueError, match=r"more than|decompression bomb"):
        DatasetReader.decoded(png(9000, 9000))


def test_a_lock_is_not_taken_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "writer.lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="can't be written"), only_writer(tmp_path, tmp_path / "writer.lock"):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_a_lock_is_gone_with_its_holder_and_one_just_removed_is_none(tmp_path, monkeypatch):
    path, taken, really = tmp_path / "writer.lock", [], fcntl.flock

    def late(handle: int, how: int) -> None:
        really(handle, how)
        if not taken:
            path.unlink()  # as the holder before does, between this one's opening and locking
        taken.append(handle)

    monkeypatch.setattr(fcntl, "flock", late)
    with only_writer(tmp_path, path), pytest.raises(InputError, match="another process"), only_writer(tmp_path, path):
        pass
    assert len(taken) == 2
    assert not path.exists()


@pytest.mark.parametrize("info", [[], {}, {"format": FORMAT}, {"format": FORMAT, "columns": "x", "sensor_columns": []}])
def test_a_dataset_without_its_description_is_refused(tmp_path: Path, info: object) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text("[]" if info == [] else "")
    if info:
        write_json(tmp_path / "meta" / "info.json", info)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"info\.json"):
        open_dataset(tmp_path)


def test_a_damaged_shard_is_named(tmp_path: Path) -> None:
    for name in ("meta", "data"):
        (tmp_path / name).mkdir()
    column = {"name": "index", "kind": "integer"}
    told = {"format": FORMAT, "columns": [column], "sensor_columns": [], "samples": 1, "content": ""}
    write_json(tmp_path / "meta" / "info.json", told)
    (tmp_path / "data" / "part-00000.parquet").write_bytes(b"PAR1 cut short")
    with pytest.raises(InputError, match="can't be read"):
        DatasetReader(tmp_path)


def test_results_of_other_shapes_are_refused(tmp_path: Path) -> None:
    arrays = {"total_force_n": np.zeros(3), "surface_force_n": np.zeros(7), "marker_displacement_mm": np.zeros((1, 3))}
    np.savez(tmp_path / "truth.npz", **arrays)
    with pytest.raises(InputError, match="has shape"):
        check_path(str(tmp_path))
