"""Planted wrong lines: ``python -m benchmarks mutation FOLDER`` counts how many the quick tests catch.

cosmic-ray changes one operator, number, condition or loop of ``twin`` at a time, in a checkout of the last commit under
FOLDER, and runs the quick tests of what was changed, then all others; the first that fails ends the run. Wrong lines
are drawn at random, every place of a part of the code as likely as any other, and the parts taken in turn, so that
those done so far are a fair sample at any moment. Left out: annotations, decorators (without its cache or its compiler
a function returns the same), imports, messages (f-strings, what is raised, printed or asserted), and changes of an
operator that no float takes (shifts, bits), as any test would catch them. A program that hangs counts as a survivor.
cosmic-ray and not mutmut, which wraps every function in a switch that numba can't compile.

cosmic-ray's session in FOLDER keeps what can be changed, benchmarks/results/mutation.json what came of it; the same
command goes on. A survivor's ``judgement`` is written into the latter by hand, and kept. ``--again``, after tests were
added and committed, runs survivors anew that have none; "test added" is then the judgement of those that are caught.
"""

import ast
import os
import random
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

from benchmarks import ROOT
from benchmarks.clock import Clock
from benchmarks.record import Count, Natural, Row, store, stored

PARTS = {
    "theory": 30,
    "world/contact": 30,
    "world/elasticity": 30,
    "world/picture": 30,
    "sense": 30,
    "judge": 20,
    "study": 30,
}
"""How many wrong lines of 200 are drawn of a folder of twin."""

OPERATORS = re.compile(
    "core/(ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|Pow_Mul|FloorDiv_Div|Mod_Mul|BitAnd_BitOr|BitOr_BitAnd)"
    "|ReplaceComparisonOperator_(Eq_NotEq|NotEq_Eq|Lt_LtE|Lt_GtE|LtE_Lt|LtE_Gt|Gt_GtE|Gt_LtE|GtE_Gt|GtE_Lt|Is_IsNot"
    "|IsNot_Is)|ReplaceUnaryOperator_Delete_(USub|Not|Invert)|AddNot|Replace(True|False|And|Or|Break|Continue)With.*"
    "|NumberReplacer|ZeroIterationForLoop|ExceptionReplacer)"
)
"""cosmic-ray's operators that are used."""

LIMIT_S = 3600
"""Limit of a run of all quick tests, s; they take a quarter of it."""


Place = tuple[int, int]


def left_out(file: Path) -> Iterator[tuple[Place, Place]]:
    """Yield where, from line and column to line and column, a module doesn't run or only words a message."""
    for node in ast.walk(ast.parse(file.read_text())):
        parts: list[Any] = []
        says = isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "warn", "warnings.warn", "progress")
        if says or isinstance(node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom | ast.JoinedStr):
            parts = [node]
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            parts = [*node.decorator_list, getattr(node, "returns", None)]
        elif isinstance(node, ast.arg | ast.AnnAssign):
            parts = [node.annotation]
        for part in filter(None, parts):
            yield (part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)


def drawn(session: Any, number: int, seed: int) -> list[Any]:
    """Return cosmic-ray's work for so many wrong lines in random order, the parts in turn by their shares."""
    places: dict[str, dict[Any, list[Any]]] = {part: {} for part in PARTS}
    silent = {}
    for item in session.work_items:
        (change,) = item.mutations
        file = change.module_path
        if file not in silent:
            silent[file] = list(left_out(file))
        runs = not any(start <= change.start_pos < end for start, end in silent[file])
        if runs and OPERATORS.fullmatch(change.operator_name):
            part = next(part for part in PARTS if file.is_relative_to(f"twin/{part}"))
            places[part].setdefault((str(file), change.start_pos), []).append(item)
    queue = []
    for part, share in PARTS.items():
        rng = random.Random(f"{seed} {part}")
        wanted = -(-share * number // sum(PARTS.values()))
        found = sorted(places[part])
        for i, place in enumerate(rng.sample(found, min(wanted, len(found)))):
            choices = sorted(places[part][place], key=lambda item: item.mutations[0].operator_name)
            queue.append(((i + rng.random()) / share, rng.choice(choices)))
    return [item for _, item in sorted(queue, key=lambda pair: pair[0])][:number]


def opened(folder: Path) -> Any:
    """Return the session in a folder, made with a checkout of the last commit where there is none."""
    from cosmic_ray.commands import init
    from cosmic_ray.work_db import WorkDB

    code = folder / "code"
    if not code.is_dir():
        subprocess.run(["git", "worktree", "add", "--detach", str(code)], cwd=ROOT, check=True)
    last = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    subprocess.run(["git", "checkout", "-q", "--", "twin"], cwd=code, check=True)  # a killed run leaves its wrong line
    subprocess.run(["git", "checkout", "-q", last.strip(), "--", "tests"], cwd=code, check=True)
    session = WorkDB(str(folder / "session.sqlite"), WorkDB.Mode.create)
    if not session.num_work_items:
        with chdir(code):
            init([file for part in PARTS for file in sorted(Path("twin", part).rglob("*.py"))], session, {})
    return session


def planted(item: Any, command: str, key: str) -> Row:
    """Run the tests with a wrong line; return its row."""
    from cosmic_ray.mutating import mutate_and_test

    clock, (change,) = Clock(), item.mutations
    part = next(part for part in PARTS if change.module_path.is_relative_to(f"twin/{part}"))
    result = mutate_and_test(item.mutations, f"{command} tests/{part} tests", LIMIT_S)
    changed = {line[0]: line[1:].strip() for line in result.diff.splitlines() if re.match(r"[-+](?![-+])", line)}
    caught = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", result.output, re.MULTILINE)
    return {
        "key": key,
        "wing": part,
        "file": str(change.module_path),
        "line": change.start_pos[0],
        "function": change.definition_name,
        "before": changed["-"],
        "after": changed["+"],
        "caught by": caught[1] if caught else "",
        "met": "some" if result.output == "timeout" else "all",
        "cpu_s": round(clock.lap().cpu, 1),
        "judgement": "",
    }


def measure(folder: Path, *, number: Count = 200, seed: Natural = 0, again: bool = False) -> None:
    """Plant wrong lines, run tests, and store the table.

    Parameters
    ----------
    folder
        Where the checkout and cosmic-ray's session go.
    number, seed
        Wrong lines, and the seed that they are drawn with.
    again
        Run those anew that survived and nobody judged.
    """
    from cosmic_ray.testing import run_tests

    folder = folder.resolve()
    session, code = opened(folder), folder / "code"
    os.environ |= {"PYTHONPATH": str(code), "TWIN_CACHE": str(folder / "cache")}
    command = f"{sys.executable} -m pytest -n 0 -p no:cacheprovider -x"
    with chdir(code):
        wanted = {_key(item): item for item in drawn(session, number, seed)}
        done = {row["key"]: row for row in stored("mutation") if row["key"] in wanted}
        if not done and "FAILED" in (told := run_tests(f"{command} tests", LIMIT_S)[1]):
            raise SystemExit(f"tests fail without a wrong line:\n{told[-3000:]}")
        if again:
            done = {key: row for key, row in done.items() if row["caught by"] or row["judgement"]}
        for key in [key for key in wanted if key not in done]:
            done[key] = planted(wanted[key], command, key)
            # a judgement may have been written meanwhile
            judged = {(row["file"], row["before"], row["after"]): row["judgement"] for row in stored("mutation")}
            for row in done.values():
                row["judgement"] = judged.get((row["file"], row["before"], row["after"]), "")
            store("mutation", list(done.values()), seed=seed, drawn=number)
            caught = sum(bool(row["caught by"]) for row in done.values())
            print(f"{len(done)} of {len(wanted)} met, {caught} caught. {done[key]}", flush=True)


def _key(item: Any) -> str:
    """Return what a wrong line is known by within a session."""
    (change,) = item.mutations
    return f"{change.module_path}:{change.start_pos} {change.operator_name}"
