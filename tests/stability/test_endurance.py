"""Long and interrupted work: five minutes of it stay flat, and what is killed is neither lost nor torn."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import endurance, kills
from twin.files import make_folder


@pytest.mark.slow
def test_mixed_work_in_one_process_stays_flat(tmp_path: Path) -> None:
    states = list(endurance.rounds(tmp_path, minutes=5.0, least=20))
    assert endurance.problems(states) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run", "dataset"])
def test_what_is_killed_at_any_moment_is_whole_and_goes_on(name: str) -> None:
    (row,) = kills.killed([name], 3)
    assert row["lost or torn"] == 0


def test_growth_is_noticed() -> None:
    flat = [{"memory_mb": 300.0 + k % 3, "threads": 4.0, "files": 9.0, "children": 0.0} for k in range(50)]
    assert endurance.problems(flat) == []
    leak = [{**each, "memory_mb": 300.0 + 5 * k, "files": 9.0 + k} for k, each in enumerate(flat)]
    assert [line.split()[0] for line in endurance.problems(leak)] == ["memory_mb", "files"]


def test_a_torn_file_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{")
    (tmp_path / "b.html").write_text("<html>")
    (tmp_path / ".c.png.1.part").write_bytes(b"")  # not under its own name yet
    assert [line.split(":")[0] for line in kills.torn(tmp_path)] == ["a.json", "b.html"]


def test_only_what_a_dead_writer_left_is_removed(tmp_path: Path) -> None:
    """Found by killing ``reproduce``: its half-written page stayed beside the finished one."""
    dead = subprocess.Popen([sys.executable, "-S", "-c", ""])
    dead.wait()
    kept = {"mine.part", ".mine.part", ".notes.old.part", f".b.html.{os.getpid()}.part"}
    for name in (*kept, f".a.html.{dead.pid}.part"):
        (tmp_path / name).write_text("<html>")
    make_folder(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == kept
