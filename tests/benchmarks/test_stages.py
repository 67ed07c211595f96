"""Several stages at a time: all run, told in their order, and a failure is neither hidden nor the end of the rest."""

import ast
import importlib.util
import sys
from pathlib import Path

import pytest

from benchmarks import ROOT
from benchmarks.__main__ import ALONE, STAGES, main, together


def _saying(code: str) -> list[str]:
    return [sys.executable, "-S", "-c", code]


def test_they_overlap_and_are_told_in_order(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    there = f"os.path.exists({str(tmp_path / 'b')!r})"
    waits = f"import os, time\nfor _ in range(3000): {there} or time.sleep(.01)\nassert {there}\nprint('first')"
    goes = f"open({str(tmp_path / 'b')!r}, 'w').close()\nprint('second')"
    assert together([_saying(waits), _saying(goes)], 2) == 0
    assert capfd.readouterr().out == "first\nsecond\n"


def test_one_that_fails_is_said_and_the_rest_go_on(capfd: pytest.CaptureFixture[str]) -> None:
    assert together([_saying("raise SystemExit(3)"), _saying("print('still')")], 1) == 1
    told = capfd.readouterr()
    assert told.out == "still\n"
    assert "exit code 3" in told.err


def test_every_stage_is_run_once_those_alone_last(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[list[str], int]] = []
    monkeypatch.setattr(
        "benchmarks.__main__.together", lambda commands, n: asked.append(([c[-1] for c in commands], n)) or 0
    )
    monkeypatch.setattr("sys.argv", ["benchmarks", "--jobs", "3"])
    assert main() == 0
    assert [n for _, n in asked] == [3, 1]
    assert sorted(asked[0][0] + asked[1][0]) == sorted(STAGES)
    assert set(asked[1][0]) == set(ALONE)


def test_what_benchmarks_import_where_they_need_it_exists() -> None:
    """Imports within functions fail only when they run, which for damaged files and killed jobs is seldom."""
    for file in (ROOT / "benchmarks").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("twin"):
                module = importlib.import_module(str(node.module))
                missing = [a.name for a in node.names if not hasattr(module, a.name)]
                missing = [name for name in missing if importlib.util.find_spec(f"{node.module}.{name}") is None]
                assert not missing, f"{file}: {node.module} has no {missing}"


@pytest.mark.parametrize("wrong", [["--jobs", "0"], ["nothing"]])
def test_wrong_arguments_are_refused(wrong: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", *wrong])
    with pytest.raises(SystemExit, match="2"):
        main()
