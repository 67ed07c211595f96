"""Every public name has an example, and the examples run."""

import doctest

import pytest

import twin

LONG = {"Environment", "Observation", "reconstruct"}
"""Examples with pictures."""

NAMES = [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in twin.__all__]


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_public_name_runs(name: str) -> None:
    finder = doctest.DocTestFinder(recurse=False)
    (found,) = finder.find(getattr(twin, name), name, globs={})
    assert found.examples, "help() shows no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    lines: list[str] = []
    runner.run(found, out=lines.append)
    assert not runner.failures, "".join(lines)
