"""Stages run in processes of their own, and a failure is neither hidden nor the end of the rest."""

import ast
import importlib.util
import re
from types import SimpleNamespace

import pytest

from benchmarks import ROOT
from benchmarks.__main__ import CHECKS, STAGES, STUDIES, main


def test_every_stage_is_run_once_and_a_failure_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def run(command: list[str], check: bool) -> SimpleNamespace:
        asked.append(command[-1])
        return SimpleNamespace(returncode=int(command[-1] == STAGES[0]))

    monkeypatch.setattr("subprocess.run", run)
    monkeypatch.setattr("sys.argv", ["benchmarks"])
    assert main() == 1
    assert asked == list(STAGES)


def test_what_benchmarks_import_where_they_need_it_exists() -> None:
    """Imports within functions fail only when they run, which for damaged files and killed jobs is seldom."""
    for file in (ROOT / "benchmarks").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("twin"):
                module = importlib.import_module(str(node.module))
                missing = [a.name for a in node.names if not hasattr(module, a.name)]
                missing = [name for name in missing if importlib.util.find_spec(f"{node.module}.{name}") is None]
                assert not missing, f"{file}: {node.module} has no {missing}"


@pytest.mark.parametrize("words", [["nothing"], ["chain", "--nope"], ["kills", "--count", "0"], ["frozen", "other"]])
def test_unknown_names_and_options_are_refused(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", *words])
    assert main() == 2


def test_every_benchmark_has_a_function_that_measures() -> None:
    named = {*STAGES, *STUDIES, *CHECKS}
    texts = {file.stem: file.read_text() for file in (ROOT / "benchmarks").glob("*.py")}
    assert named == {name for name, text in texts.items() if re.search(r"^def measure\(", text, re.MULTILINE)}
