"""Long and interrupted work, stored results, extreme values, full disks, odd names and other locales."""

import errno
import hashlib
import math
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from benchmarks import endurance, kills
from benchmarks.extremes import SCENES, cases, extremes, outcome, scene_of
from benchmarks.random_recipes import Table
from twin.errors import RecipeError, TwinError
from twin.files import make_folder, temporary_folder, write_whole
from twin.study.recipe import validate_scene


@pytest.mark.slow
def test_mixed_work_in_one_process_stays_flat(tmp_path: Path) -> None:
    """Thirty rounds; the command works for an hour."""
    states = list(endurance.rounds(tmp_path, minutes=0.0, least=30))
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


@pytest.mark.slow
def test_results_are_those_that_were_stored(tmp_path):
    """After a change that improves a result, run ``python -m benchmarks frozen store``.

    In a process and a cache of its own: fields that other work has kept would serve, 1e-8 off.
    """
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "frozen", "compare"],
        env={**os.environ, "TWIN_CACHE": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", SCENES)
def test_every_extreme_value_is_taken_or_refused_by_name(name: str) -> None:
    told = [(key, value, _problem(recipe)) for key, value, recipe in cases(name)]
    taken = sum(problem == "" for _, _, problem in told)
    assert 0.3 * len(told) < taken < len(told)
    # A body may be refused by its shape's name, or because the camera would stand in it.
    unnamed = [one for one in told if one[2] and one[0].split(".")[0] not in one[2] and "camera.pupil_mm" not in one[2]]
    assert not unnamed


def _problem(recipe: Table) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            validate_scene(recipe, "changed")
        except RecipeError as problem:
            return str(problem)
    return ""


def test_the_ends_of_a_range_are_tried() -> None:
    field = type(scene_of("block").material).model_fields["poisson_ratio"]
    assert {-0.5, 0.0, 5e-324, 0.5} <= set(extremes(field.metadata, float))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["block", "tractions"])
def test_extreme_loads_and_pictures_are_computed_or_refused(name: str) -> None:
    """Every other case of tables that need no mesh; the command tries all, and looks at the time too."""
    tried = [case for case in cases(name) if case[0].startswith(("camera.tilt", "ccd.", "press.steps", "tractions"))]
    became = {f"{key} = {value!r}": outcome(recipe, math.inf) for key, value, recipe in tried[::2]}
    assert not {key: what for key, what in became.items() if what.startswith("failed")}


SMALL: dict[str, Any] = {
    "markers.red.columns": 3, "markers.red.rows": 3, "markers.blue.columns": 2, "markers.blue.rows": 2,
    "accuracy.contact_patches": 6, "press.friction": 0.0, "dataset.samples_per_shard": 2,
    "vary": {"press.at_mm": {"low": [-3.0, -2.0], "high": [3.0, 2.0]}},
    "dataset.columns": ["force_n", "surface_force_n", "marker_displacement_mm"],
}  # fmt: skip
RUN = ("run", "small.toml", "--want", "displacement", "--out", "out")
DATASET = ("dataset", "small.toml", "--samples", "6", "--out", "out")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "small.toml").write_text(twin.load_scene("kamiyama_pillar", SMALL).to_toml(), encoding="utf-8")
    return tmp_path


def started(folder: Path, *words: str, before: str = "", **environment: str | None) -> subprocess.Popen[str]:
    """Start the command in a folder, after a line of the shell's; an environment variable of None is taken out."""
    told = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parent.parent), "OMP_NUM_THREADS": "1"}
    told |= {key: value for key, value in environment.items() if value is not None}
    told = {key: value for key, value in told.items() if environment.get(key, "") is not None}
    line = f'{before} exec "$0" -m twin "$@"'
    return subprocess.Popen(
        ["bash", "-c", line, sys.executable, *words], cwd=folder, env=told, text=True, encoding="utf-8",
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def said(command: subprocess.Popen[str]) -> tuple[int, str]:
    out, problem = command.communicate()
    assert "Traceback" not in problem
    assert "internal error" not in problem
    return command.returncode, out + problem


def twin_in(folder: Path, *words: str, before: str = "", **environment: str | None) -> tuple[int, str]:
    return said(started(folder, *words, before=before, **environment))


def contents(folder: Path) -> dict[str, str]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def moved(folder: Path) -> np.ndarray:
    with np.load(folder / "truth.npz") as told:
        return told["marker_displacement_mm"]


def test_compiled_code_has_a_place_where_neither_package_nor_home_can_be_written(tmp_path: Path) -> None:
    words = "import os; os.access = lambda *_: False; import twin; print(os.environ['NUMBA_CACHE_DIR'])"
    told = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    told |= {"PYTHONPATH": str(Path(twin.__file__).parent.parent), "TWIN_CACHE": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "-c", words], env=told, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(tmp_path / "cache" / "numba")


def test_a_library_that_finds_the_disk_full_is_told_without_a_traceback(monkeypatch, capsys):
    from twin import cli

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/tmp/somewhere")

    monkeypatch.delenv("TWIN_DEBUG", raising=False)
    monkeypatch.setattr(cli, "app", full)
    with pytest.raises(SystemExit) as left:
        cli.main(["run"])
    assert left.value.code == 1
    assert "/tmp/somewhere: can't be written (No space left on device)" in capsys.readouterr().err


@pytest.mark.parametrize(("number", "code"), [(errno.ENOSPC, 1), (errno.EROFS, 1), (errno.EACCES, 2)])
def test_a_full_disk_is_code_1_and_a_wrong_place_code_2(tmp_path: Path, number: int, code: int) -> None:
    def write(_: object) -> None:
        raise OSError(number, os.strerror(number))

    with pytest.raises(TwinError, match="can't be written") as refused:
        write_whole(tmp_path / "file", write)
    assert refused.value.exit_code == code


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="files have no largest size there")
@pytest.mark.parametrize("kilobytes", [1, 20, 100])
def test_on_a_full_disk_a_dataset_ends_and_goes_on_to_the_same_bytes(folder: Path, kilobytes: int) -> None:
    """No room for the scene; for the first mesh; for the second."""
    code, words = twin_in(folder, *DATASET, before=f"ulimit -f {kilobytes};")
    assert code == 1
    assert "can't be written (File too large)" in words
    assert twin_in(folder, *DATASET)[0] == 0
    assert twin_in(folder, *DATASET[:-1], "whole")[0] == 0
    assert contents(folder / "out") == contents(folder / "whole")


TWICE_WITHOUT_ROOM = """
from pathlib import Path
from twin.files import kept_if_possible, write_whole
for number in range(2):
    with kept_if_possible():
        write_whole(Path("gone") / f"{number}.npy", b"")
"""


def test_a_cache_without_room_is_printed_once_and_changes_no_result(tmp_path: Path) -> None:
    told = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parent.parent)}
    command = [sys.executable, "-c", TWICE_WITHOUT_ROOM]
    done = subprocess.run(command, cwd=tmp_path, env=told, capture_output=True, text=True, check=True)
    assert done.stderr.count("can't be written") == done.stderr.count("TWIN_CACHE") == 1


@pytest.mark.slow
def test_a_run_on_a_full_disk_leaves_no_torn_file(folder: Path) -> None:
    code, words = twin_in(folder, *RUN, before="ulimit -f 2;")
    assert code == 1
    assert "can't be written (File too large)" in words
    assert [path.name for path in (folder / "out").iterdir() if path.suffix == ".npz" or ".part" in path.name] == []


@pytest.mark.slow
def test_a_home_that_cannot_be_written_costs_no_run(folder: Path) -> None:
    code, words = twin_in(folder, *RUN, HOME="/dev/null", TWIN_CACHE=None, XDG_CACHE_HOME=None)
    assert code == 0
    assert "indentation" in words
    assert len(moved(folder / "out"))


@pytest.mark.slow
@pytest.mark.parametrize("locale", ["C", "de_DE", "de_DE.ISO-8859-1", "ja_JP.SJIS"])
def test_names_with_spaces_and_other_letters_in_any_locale(folder: Path, locale: str) -> None:
    """A locale that the machine lacks falls back to C, as it does for users."""
    odd = folder / "Daten für 触覚"
    odd.mkdir()
    text = (folder / "small.toml").read_text(encoding="utf-8").replace('title = "', 'title = "Säule 触, ', 1)
    (odd / "Szene ä.toml").write_text(text, encoding="utf-8")
    where = {"LC_ALL": locale, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "utf-8"}
    assert twin_in(odd, *DATASET[:1], "Szene ä.toml", "--samples", "2", "--out", "der Satz", **where)[0] == 0
    assert twin_in(odd, "check", "der Satz", **where)[0] == 0
    assert twin.load_scene(odd / "der Satz" / "meta" / "scene.toml").title.startswith("Säule 触, ")


@pytest.mark.slow
def test_two_at_once_on_one_new_cache_say_the_same(folder: Path) -> None:
    fine = ("-s", "accuracy.displacement=1e-3", "-s", "body.thickness_mm=20")  # a block without a shipped table
    both = [started(folder, *RUN[:-1], name, *fine, TWIN_CACHE=str(folder / "cache")) for name in ("a", "b")]
    assert [said(each)[0] for each in both] == [0, 0]
    one, other = moved(folder / "a"), moved(folder / "b")
    assert np.abs(one - other).max() < 1e-6 * np.abs(one).max()  # each may have made its own table, rounded otherwise
    assert not list((folder / "cache").rglob("*.part"))


def test_temporary_folders_of_killed_processes_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    gone = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    left, alive = tmp_path / f"twin-job-{gone.stdout.strip()}-a", tmp_path / f"twin-job-{os.getpid()}-b"
    left.mkdir()
    alive.mkdir()
    with temporary_folder("twin-job") as folder:
        assert sorted(tmp_path.iterdir()) == sorted([alive, folder])
    assert list(tmp_path.iterdir()) == [alive]
