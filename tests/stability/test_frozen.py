"""The results that must not change while the code is rebuilt."""

import os
import subprocess
import sys

import pytest


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
