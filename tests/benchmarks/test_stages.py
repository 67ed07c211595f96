"""Stages run in processes of their own and hide no failure; fronts of programs; right refusals for want of friction."""

import ast
import importlib.util
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import ROOT
from benchmarks.__main__ import CHECKS, STAGES, STUDIES, main
from benchmarks.flat import HalfSpace
from benchmarks.pages import front, seconds_to
from benchmarks.presses import asked, rightly_refused
from twin.parts.body import Finger
from twin.parts.press import Cone, Pillar, Press, Probe, Sphere, Step
from twin.world.contact.pressing import press as pressed


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


SIZES = st.floats(1e-6, 1e3)
RUNS = st.lists(st.tuples(SIZES, SIZES), max_size=12)


@settings(deadline=None)
@given(RUNS)
def test_no_run_beats_the_front_and_every_other_run_is_beaten(runs):
    best = front(runs)
    for seconds, error in best:
        assert not any(s <= seconds and e <= error and (s, e) != (seconds, error) for s, e in runs)
    for seconds, error in runs:
        assert any(s <= seconds and e <= error for s, e in best)


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_interpolation_is_exact_for_a_power_law(power):
    """Half the error for twice the power of time, in whatever order the runs come, with worse runs in between."""
    runs = [(0.1 * error**-power, error) for error in (0.05, 0.002, 0.0004, 0.01)]
    assert seconds_to([*runs, (1e4, 0.5)], 0.003) == pytest.approx(0.1 * 0.003**-power, rel=1e-12)


def test_a_goal_beyond_the_best_run_is_not_reached_and_one_below_the_first_costs_the_first():
    runs = [(1.0, 0.01), (10.0, 0.001)]
    assert seconds_to(runs, 0.0009) is None
    assert seconds_to(runs, 0.5) == 1.0
    assert seconds_to([], 0.5) is None


FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
MU = 0.5


def shoved(share: float) -> Press:
    steps = (Step(force_n=(None, None, 1.0)), Step(force_n=(share * MU * 0.6, -share * MU * 0.8, 1.0)))
    return Press(probe=Sphere(diameter_mm=5), at_mm=(0, 0), friction=MU, steps=steps)


def carrying(least: float) -> Any:
    """Return a contact that carries ``least`` sideways, over mu, once it is dragged."""

    def solve(press: Press) -> Any:
        ways = [np.array([0.0 if way is None else way for way in step.move_mm[:2]]) for step in press.steps]
        states = [
            SimpleNamespace(
                force_n=np.array([*(least * MU * way / (np.hypot(*way) or 1.0)), 1.0]),
                slip=np.array([bool(way.any())]), indentation_mm=0.1,
            )
            for way in ways
        ]  # fmt: skip
        return SimpleNamespace(path=states, **vars(states[-1]))

    return solve


@pytest.mark.parametrize(("share", "carried", "right"), [
    (0.5, 0.0, False), (2.0, 9.0, True), (0.98, 1.0, False), (1.02, 1.0, True), (1.02, 1.05, False), (0.98, 0.9, True),
])  # fmt: skip
def test_only_what_friction_cannot_carry_is_rightly_refused(share: float, carried: float, right: bool) -> None:
    assert rightly_refused(shoved(share), carrying(carried)) is right


@pytest.mark.parametrize(("probe", "sine"), [
    (Sphere(diameter_mm=2), 2.0 / 9.0), (Cone(apex_deg=100, diameter_mm=2), 2.0 / 8.0),
    (Pillar(width_mm=4, length_mm=6), 0.0), (Pillar(width_mm=1, length_mm=0.2), 1.9 / 8.0),
])  # fmt: skip
def test_what_friction_is_asked_for_counts_from_a_press_without_it(probe: Probe, sine: float) -> None:
    """Over a cylinder of radius R: 0 at the crest, else y / R under what touches at y; a ball's middle is R + r off."""
    press = Press(probe=probe, at_mm=(-4, 2), friction=MU, steps=(Step(force_n=(0.0, 0.0, 1e-4)),))
    rubber = {"youngs_modulus_mpa": 1.0, "poisson_ratio": 0.5}
    wanted = asked(press, lambda one: pressed(one, FINGER, HalfSpace(0.5), patches_across=8, **rubber))
    assert wanted.share * MU == pytest.approx(np.tan(np.arcsin(sine)), abs=6e-3)
