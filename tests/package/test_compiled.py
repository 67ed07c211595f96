"""Kept machine code follows the sources that it was made of, in other modules too, and nothing else."""

import io
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from textwrap import dedent
from types import FunctionType, SimpleNamespace

import pytest
from numba.core import event

import twin
import twin.compiled
import twin.theory.halfspace
import twin.world.elasticity.correction
import twin.world.elasticity.fem

HELPER = "from twin.compiled import njit\nSIZE = 2.0\n\n@njit(cache=True)\ndef helper(x):\n    return SIZE * x\n"
CALLER = """from twin.compiled import njit
from twin.inner import (
    helper,
)

@njit(cache=True)
def caller(x):
    return helper(x) + 1.0
"""
SAY = "from twin.outer import caller; print(caller(3.0), sum(caller.stats.cache_hits.values()))"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Make a package of the same name, of a caller, its helper, and a module that neither knows."""
    folder = tmp_path / "twin"
    folder.mkdir()
    shutil.copy(twin.compiled.__file__, folder / "compiled.py")
    for name, text in (("__init__", ""), ("inner", HELPER), ("outer", CALLER), ("other", "")):
        (folder / f"{name}.py").write_text(text)
    return folder


def said(package: Path) -> list[str]:
    """Return the caller's answer in a new process, and how many functions it found kept."""
    place = package.parent
    told = {**os.environ, "PYTHONPATH": str(place)}
    return subprocess.check_output([sys.executable, "-c", SAY], cwd=place, env=told, text=True).split()


def test_a_helper_changed_in_another_module_changes_its_callers(package: Path) -> None:
    assert said(package) == ["7.0", "0"]
    (package / "other.py").write_text("CHANGED = 1\n")
    assert said(package) == ["7.0", "1"]
    (package / "inner.py").write_text(HELPER.replace("2.0", "5.0"))
    assert said(package) == ["16.0", "0"]


@pytest.mark.parametrize(("kind", "size"), [("nbi", 0), ("nbi", 90), ("nbc", 0), ("nbc", 900)])
def test_stored_code_that_is_cut_short_is_compiled_again(package: Path, kind: str, size: int) -> None:
    said(package)
    for file in package.rglob(f"outer.caller*.{kind}"):
        os.truncate(file, size)
    assert [said(package) for _ in range(2)] == [["7.0", "0"], ["7.0", "1"]]


def test_two_processes_that_store_two_signatures_at_once_leave_each_others_code(package: Path) -> None:
    """The second one has read the index before the first writes it: as if there were none."""
    said(package)
    for index in package.rglob("outer.caller*.nbi"):
        index.unlink()
    told = {**os.environ, "PYTHONPATH": str(package.parent)}
    other = "from twin.outer import caller; caller(3)"
    subprocess.run([sys.executable, "-c", other], cwd=package.parent, env=told, check=True)
    assert len(list(package.rglob("outer.caller*.nbc"))) == 2


@pytest.mark.parametrize("threads", [1, 2])
def test_where_compiling_takes_long_a_second_process_compiles_what_comes_later(package: Path, threads: int) -> None:
    """Not on one thread: there it would take the time of the first."""
    done = package.parent / "done"
    (package / "other.py").write_text(f"open({str(done)!r}, 'w').close()\n")
    first = """
        import twin.compiled
        from twin.outer import caller
        twin.compiled.SHOWN_AFTER_S = 1e-9
        with twin.compiled.COMPILING.compiled_ahead("twin.other"):
            caller(3.0)
            twin.compiled.COMPILING.wait_for_second()
    """
    told = {**os.environ, "PYTHONPATH": str(package.parent), "NUMBA_NUM_THREADS": str(threads)}
    subprocess.run([sys.executable, "-c", dedent(first)], cwd=package.parent, env=told, check=True)
    assert done.exists() == (threads > 1)


def test_the_sources_of_a_module_hold_all_that_it_took_from_others() -> None:
    """Against what Python itself says of the things in a module's name space: where each was made."""
    import twin.sense.track
    import twin.world.contact.pressing
    import twin.world.picture.render

    compared = 0
    for module in [sys.modules[name] for name in sorted(sys.modules) if name.startswith("twin.")]:
        file = module.__file__
        if file and any(hasattr(thing, "py_func") for thing in vars(module).values()):
            found = twin.compiled.sources(file)
            taken = [getattr(thing, "py_func", thing) for thing in vars(module).values()]
            homes = {each.__module__ for each in taken if isinstance(each, FunctionType | type)}
            homes = {name for name in homes if name.startswith("twin.")}
            assert {sys.modules[name].__file__ for name in homes} <= found
            compared += len(homes) > 1
    assert compared > 3


def test_without_its_sources_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(_: str) -> str:
        raise FileNotFoundError

    monkeypatch.setattr(twin.compiled, "digest", lost)
    compiled = twin.compiled.njit(cache=True)(lambda number: number + 1)
    assert compiled(2) == 3
    assert compiled.stats.cache_path is None


def test_the_first_run_says_once_that_it_compiles_also_off_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", stderr := io.StringIO())
    monkeypatch.setattr(twin.compiled, "SHOWN_AFTER_S", 1e-9)
    told = type(twin.compiled.COMPILING)()
    for home in ("elsewhere", "twin.somewhere", "twin.somewhere"):
        function = SimpleNamespace(py_func=SimpleNamespace(__module__=home))
        inner = event.Event("numba:compile", event.EventStatus.START, {"dispatcher": function})
        for each in (told.on_start, told.on_start, told.on_end, told.on_end):
            each(inner)
        assert stderr.getvalue().count("compiling") == (home != "elsewhere")


@pytest.mark.slow
def test_what_is_compiled_here_and_what_was_kept_give_the_same_answers(tmp_path: Path) -> None:
    """Bit for bit, through the whole chain: sums in any order were once made in another one by first runs."""
    told = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for name in ("first", "second"):
        command = [sys.executable, "-m", "twin", "run", "kamiyama_pillar", "--out", str(tmp_path / name)]
        subprocess.run(command, env=told, check=True, capture_output=True)
    found = {path.name: path.read_bytes() for path in (tmp_path / "first").iterdir() if path.suffix in (".npz", ".png")}
    assert {"truth.npz", "pressed.png"} <= set(found)
    differing = [name for name, data in found.items() if (tmp_path / "second" / name).read_bytes() != data]
    assert differing == []
    # Strided columns made numba compile the two longest kernels twice: 15 s of a first run.
    kept = Counter(path.name.rsplit(".", 3)[0] for path in (tmp_path / "kept").rglob("disc_fit*.nbc"))
    assert kept
    assert set(kept.values()) == {1}
