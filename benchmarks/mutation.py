"""Planted wrong lines: ``python -m benchmarks mutation FOLDER`` counts how many the quick tests catch.

cosmic-ray changes one operator, number, condition or loop of ``twin`` at a time, in a copy of the checkout with its own
caches. Tests that import or name what was changed come first, then those of its folder, then all other quick tests; the
first that fails ends the run. Every wrong line meets its own tests, up to a limit of processor time, before the
survivors meet all tests. A program that hangs counts as a survivor.

Every place of the code is as likely as any other of its wing; the order is random, the wings in turn, so those done so
far are a fair sample at any moment. Left out: annotations, decorators (without its cache or its compiler a function
returns the same), imports, messages (f-strings, what is raised, printed or asserted), and changes of an operator that
no float takes (shifts, bits), as any test would catch them. cosmic-ray and not mutmut, which wraps every function in a
switch that numba can't compile.

Results are kept after every run; the same command goes on. A survivor's ``judgement`` is written by hand into
benchmarks/results/mutation.json: it is kept, and the survivor not run again. ``--again``, after tests were added, runs
those anew that have none; "test added" is then the judgement of those that are caught.
"""

import ast
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from benchmarks import ROOT
from benchmarks.record import Count, Natural, Row, store, stored

WINGS = {
    "theory": 30,
    "world/contact": 30,
    "world/elasticity": 30,
    "world/picture": 30,
    "sense": 30,
    "judge": 20,
    "study": 30,
}
"""How many wrong lines of 200 are drawn of a folder of twin."""

CHANGES = {
    "ReplaceBinaryOperator": "Add_Sub Sub_Add Mul_Div Div_Mul Pow_Mul FloorDiv_Div Mod_Mul BitAnd_BitOr BitOr_BitAnd",
    "ReplaceComparisonOperator": "Eq_NotEq NotEq_Eq Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Is_IsNot "
    "IsNot_Is",
    "ReplaceUnaryOperator": "Delete_USub Delete_Not Delete_Invert",
    "": "AddNot ReplaceTrueWithFalse ReplaceFalseWithTrue ReplaceAndWithOr ReplaceOrWithAnd ReplaceBreakWithContinue "
    "ReplaceContinueWithBreak NumberReplacer ZeroIterationForLoop ExceptionReplacer",
}
"""cosmic-ray's operators that are used, by the first part of their names."""

LEFT_OUT = {"decorator", "import_name", "import_from", "raise_stmt", "assert_stmt", "fstring"}
"""Kinds of syntax that are left out with all within them."""

LEAVES = {"operator", "keyword", "number"}
BRANCHES = {"comparison", "factor", "not_test", "if_stmt", "while_stmt", "test", "for_stmt", "except_clause"}
PUNCTUATION = set("()[]{},:.=;")
"""Kinds of syntax that an operator of cosmic-ray changes, and what it never changes of them."""

UNCHANGED, SECONDS = "TWIN_UNCHANGED", "TWIN_SECONDS"
"""Environment variables that name the copy without wrong lines, and the file of the tests' seconds."""

QUICK_S = 0.5
"""Tests of less run before the others."""

ALL_S = 3600
"""Limit of processor time of all quick tests, s; they take a quarter of it."""


@dataclass(frozen=True, kw_only=True)
class WrongLine:
    """A changed line of a module of twin (``file``, in the checkout), and the module's whole text with it."""

    wing: str
    file: str
    line: int
    function: str
    before: str
    after: str
    source: str

    @property
    def key(self) -> str:
        """Return what tells it from others, also in a later checkout."""
        return hashlib.sha256(f"{self.file}\n{self.source}".encode()).hexdigest()[:16]


def _places(file: Path) -> dict[tuple[int, int], list[tuple[str, int]]]:
    """Return the operators, with their counts up to there, that can change each place (line, column) of a module."""
    from cosmic_ray.ast import ast_nodes, get_ast_from_path
    from cosmic_ray.plugins import get_operator

    names = [f"core/{kind}{'_' * bool(kind)}{name}" for kind, all_of in CHANGES.items() for name in all_of.split()]
    operators, counts = {name: get_operator(name)() for name in names}, dict.fromkeys(names, 0)
    found: dict[tuple[int, int], list[tuple[str, int]]] = {}
    for node in ast_nodes(get_ast_from_path(file)):
        if node.type not in LEAVES | BRANCHES or getattr(node, "value", "") in PUNCTUATION:
            continue
        for name, operator in operators.items():
            for place, _ in operator.mutation_positions(node):
                if not _is_left_out(node):
                    found.setdefault(place, []).append((name, counts[name]))
                counts[name] += 1
    return found


def _is_left_out(node: object) -> bool:
    """Tell whether a piece of syntax is within what does not run or only words a message."""
    while (above := node.parent) is not None:  # type: ignore[attr-defined]
        called = above.children[0].get_code().strip() if above.type in ("power", "atom_expr") else ""
        annotates = above.type == "tfpdef" or (above.type == "funcdef" and above.annotation is node)
        annotates |= above.type == "annassign" and above.children[1] is node
        if above.type in LEFT_OUT or annotates or called in ("print", "warn", "warnings.warn", "progress"):
            return True
        node = above
    return False


def _changed(wing: str, file: Path, operator: str, count: int) -> WrongLine | None:
    """Return a module with one change; None where that is no Python or means the same."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    text = file.read_text()
    source = mutate_code(text, get_operator(operator)(), count)
    try:
        if source is None or ast.dump(ast.parse(source)) == ast.dump(ast.parse(text)):
            return None
    except SyntaxError:
        return None
    pairs = list(zip(text.splitlines(), source.splitlines(), strict=False))
    line = next(i for i, (old, new) in enumerate(pairs) if old != new)
    holders = [
        node.name
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.lineno <= line + 1 <= (node.end_lineno or 0)
    ]
    before, after = (each.strip() for each in pairs[line])
    return WrongLine(
        wing=wing,
        file=str(file.relative_to(ROOT)),
        line=line + 1,
        function=".".join(holders),
        before=before,
        after=after,
        source=source,
    )


def drawn(number: int, seed: int) -> list[WrongLine]:
    """Return wrong lines in random order, the wings in turn by their shares."""
    queues: list[tuple[float, WrongLine]] = []
    for wing, share in WINGS.items():
        rng, wanted = random.Random(f"{seed} {wing}"), -(-share * number // sum(WINGS.values()))
        places = [
            (file, place, choices)
            for file in sorted((ROOT / "twin" / wing).rglob("*.py"))
            for place, choices in sorted(_places(file).items())
        ]
        rng.shuffle(places)
        made = (_changed(wing, file, *rng.choice(choices)) for file, _, choices in places)
        found = [each for each, _ in zip(filter(None, made), range(wanted), strict=False)]
        queues += [((i + rng.random()) / share, each) for i, each in enumerate(found)]
    return [each for _, each in sorted(queues, key=lambda pair: pair[0])][:number]


def _kept_draw(folder: Path, number: int, seed: int) -> list[WrongLine]:
    """Return `drawn`, which takes a minute, from a file of this state of the code where there is one."""
    sources = b"".join(file.read_bytes() for file in sorted((ROOT / "twin").rglob("*.py")))
    path = folder / f"drawn-{number}-{seed}-{hashlib.sha256(sources).hexdigest()[:16]}.json"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps([vars(wrong) for wrong in drawn(number, seed)]))
    return [WrongLine(**wrong) for wrong in json.loads(path.read_text())]


class Tests:
    """The quick tests in a copy of the checkout, which the wrong lines are planted in."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.whole = folder, folder / "whole"
        names = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for name in names:
            _place((ROOT / name).read_bytes(), self.whole / name)
        for stale in {str(f.relative_to(self.whole)) for f in self.whole.rglob("*.py")} - set(names):
            (self.whole / stale).unlink()
        self.texts = {str(f.relative_to(self.whole)): f.read_text() for f in self.whole.glob("tests/**/test_*.py")}

    def order(self, wrong: WrongLine, own: bool) -> list[str]:
        """Return the files of tests that a wrong line meets, its ``own`` ones or all, the shortest first."""
        module = wrong.file.removesuffix(".py").replace("/", ".")
        package, name = module.rsplit(".", 1)
        patterns = [rf"{re.escape(module)}\b", rf"from {re.escape(package)} import[^\n]*\b{name}\b"]
        patterns += [rf"\b{each}\b" for each in wrong.function.split(".")[:1] if each and not each.startswith("_")]
        named, mirror = re.compile("|".join(patterns)), str(Path(wrong.file).parent).replace("twin", "tests", 1) + "/"
        ranks: list[list[str]] = [[], [], []]
        for file, text in sorted(self.texts.items(), key=lambda item: (not item[0].startswith(mirror), len(item[1]))):
            ranks[0 if named.search(text) else 1 if file.startswith(mirror) else 2].append(file)
        return ranks[0] + ranks[1] if own else ranks[0] + ranks[1] + ranks[2]

    def catch(self, wrong: WrongLine, files: list[str], limit_s: int) -> tuple[str, float, bool]:
        """Return which test catches a wrong line ("" for none), the processor time, s, and whether the limit did not
        end it."""
        place = self.folder / "wrong"
        shutil.rmtree(place, ignore_errors=True)
        # links: what is written anew, as caches are, leaves the whole copy as it is
        shutil.copytree(
            self.whole, place, copy_function=os.link, ignore=shutil.ignore_patterns("table-*", "calibration-*")
        )
        _place(wrong.source.encode(), place / wrong.file)
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        code, told = self.run(place, [*files, "-x"], limit_s, keeps_code=not _is_compiled(wrong))
        spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        failed = _failed(told)
        if failed or code in (-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGFPE):
            return failed[0] if failed else f"signal {-code}", spent, True
        if code not in (0, 5, -signal.SIGKILL):
            raise SystemExit(f"pytest ended with {code}:\n{told[-3000:]}")
        return "", spent, code != -signal.SIGKILL

    def failing_anyway(self, tests: list[str]) -> list[str]:
        """Return those of some tests that fail without any wrong line."""
        code, told = self.run(self.whole, tests, ALL_S, keeps_code=False) if tests else (0, "")
        if code not in (0, 1):
            raise SystemExit(f"pytest ended with {code}:\n{told[-3000:]}")
        return _failed(told)

    def run(self, place: Path, arguments: list[str], limit_s: int, keeps_code: bool) -> tuple[int, str]:
        """Run tests in a copy, within a limit of processor time; return exit code and output."""
        told = {SECONDS: str(self.folder / "seconds.tsv")} | ({UNCHANGED: str(self.whole)} if keeps_code else {})

        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))

        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "pytest",
                "-n",
                "0",
                "-p",
                "no:cacheprovider",
                "-p",
                "benchmarks.mutation",
                *arguments,
            ],
            cwd=place,
            env={**os.environ, "PYTHONPATH": str(place), "TWIN_CACHE": str(place / ".cache"), **told},
            preexec_fn=limit,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        return done.returncode, done.stdout


def _failed(told: str) -> list[str]:
    """Return the tests that pytest's summary says failed."""
    return re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", told, re.MULTILINE)


def _is_compiled(wrong: WrongLine) -> bool:
    """Tell whether a wrong line may be in machine code: in a compiled function, or a constant that one may hold."""
    above = [
        node
        for node in ast.walk(ast.parse(wrong.source))
        if isinstance(node, ast.FunctionDef) and node.lineno <= wrong.line <= (node.end_lineno or 0)
    ]
    said = [ast.unparse(each) for node in above for each in node.decorator_list]
    wrapped = [rf"njit\([^)]*\)\({node.name}\)" for node in above]
    return not above or any("njit" in each for each in said) or any(re.search(w, wrong.source) for w in wrapped)


# As a plugin of pytest, in the copy with a wrong line:


def pytest_collection_modifyitems(items: list[Any]) -> None:
    """Run the tests first that were quick in earlier runs."""
    told = Path(os.environ[SECONDS])
    lines = [line.split("\t") for line in told.read_text().splitlines()] if told.is_file() else []
    seconds = {test: float(s) for s, test in lines}
    items.sort(key=lambda item: seconds.get(item.nodeid, QUICK_S) >= QUICK_S)


def pytest_runtest_logreport(report: Any) -> None:
    """Note the seconds of a test."""
    if report.when == "call" and report.passed:
        with open(os.environ[SECONDS], "a") as file:
            file.write(f"{report.duration:.3f}\t{report.nodeid}\n")


def pytest_configure() -> None:
    """Take the machine code that was stored before a line was changed that is in none of it.

    Without this all compiled functions of a changed module, and of those that import it, would be compiled again: half
    the time of a run.
    """
    if UNCHANGED not in os.environ:
        return
    from numba.core.caching import _SourceFileBackedLocatorMixin as Locator

    from twin import compiled

    place, whole = os.getcwd(), os.environ[UNCHANGED]
    stamp, read = Locator.get_source_stamp, compiled._read

    def stamp_before(self: Any) -> Any:
        return stamp(SimpleNamespace(_py_file=self._py_file.replace(place, whole)))

    Locator.get_source_stamp = stamp_before
    compiled._read = lambda file: read(file.replace(place, whole))


def _place(content: bytes, path: Path) -> None:
    """Write a file unless it has this content; other names of the old one keep theirs."""
    if path.is_file() and path.read_bytes() == content:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    path.write_bytes(content)


def runs(wanted: list[WrongLine], tests: Tests, done: dict[str, Row], own_s: int) -> Iterator[str]:
    """Plant wrong lines and update their rows, yielding a line about each: ``own_s`` seconds of its own tests for every
    one, then all tests for the survivors that nobody has judged."""
    for own in (True, False):
        for wrong in wanted:
            row = done.get(wrong.key, {"caught by": "", "met": "", "cpu_s": 0.0, "judgement": ""})
            if row["caught by"] or row["judgement"] or row["met"].endswith("all") or (own and row["met"]):
                continue
            caught, spent, ended = tests.catch(wrong, tests.order(wrong, own), own_s if own else ALL_S)
            done[wrong.key] = {
                "key": wrong.key,
                "wing": wrong.wing,
                "file": wrong.file,
                "line": wrong.line,
                "function": wrong.function,
                "before": wrong.before,
                "after": wrong.after,
                "caught by": caught,
                "met": f"{'' if ended else 'some of '}{'its own' if own else 'all'}",
                "cpu_s": round(row["cpu_s"] + spent, 1),
                "judgement": "",
            }
            yield f"{wrong.file}:{wrong.line} {wrong.after!r}: {caught or 'survived'} ({spent:.0f} CPU s)"
        # a test that fails anyway has caught nothing
        named = {row["caught by"] for row in done.values() if "::" in row["caught by"]}
        for test in tests.failing_anyway(sorted(named)):
            for key in [key for key, row in done.items() if row["caught by"] == test]:
                yield f"{test} fails without a wrong line: {done.pop(key)['file']} is to run again"


def measure(folder: Path, *, number: Count = 200, seed: Natural = 0, own: Count = 60, again: bool = False) -> None:
    """Plant wrong lines, run tests, and store the table.

    Parameters
    ----------
    folder
        Where the copies of the checkout go.
    number, seed
        Wrong lines, and the seed that they are drawn with.
    own
        CPU seconds of a line's own tests at first.
    again
        Begin again with those that survived and nobody judged.
    """
    wanted = _kept_draw(folder, number, seed)
    done = {row["key"]: row for row in stored("mutation")}
    if again:
        done = {key: row for key, row in done.items() if row["caught by"] or row["judgement"]}
    for line in runs(wanted, Tests(folder.resolve()), done, own):
        # a judgement may have been written meanwhile
        judged = {row["key"]: row["judgement"] for row in stored("mutation")}
        rows = [{**done[w.key], "judgement": judged.get(w.key, "")} for w in wanted if w.key in done]
        store("mutation", rows, seed=seed, drawn=number)
        caught = sum(bool(row["caught by"]) for row in rows)
        print(f"{len(rows)} of {len(wanted)} met, {caught} caught. {line}", flush=True)
