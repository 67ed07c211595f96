"""Numeric libraries take one thread inside of the package, in commands and in Python, and their own outside of it."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  has a BLAS library of its own
from threadpoolctl import threadpool_info, threadpool_limits

import twin
from twin.blas_threads import one_blas_thread

SMALL = {"accuracy.contact_patches": 6, "accuracy.displacement": 0.02, "camera.width_px": 160, "camera.height_px": 120}
LOAD = twin.Traction.disk((0, 0), 2, (0, 0, 0.5))


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def seen_inside(call: Callable[[], Any]) -> set[int]:
    """Return BLAS's threads at the first calls of the package's own functions inside of ``call``."""
    found, left = set[int](), [20]

    def look(frame: FrameType, event: str, _: object) -> None:
        name = frame.f_globals.get("__name__", "")
        if event == "call" and left[0] and name.startswith("twin.") and name != "twin.blas_threads":
            left[0] -= 1
            found.update(threads())

    before = sys.getprofile()
    sys.setprofile(look)
    try:
        call()
    finally:
        sys.setprofile(before)
    return found


@pytest.mark.parametrize("name", ["displacement", "motion", "press", "picture", "run", "step", "track"])
def test_a_python_programs_calls_take_one_thread_and_leave_its_own(name: str) -> None:
    scene = twin.load_scene("kamiyama_pillar", SMALL)
    sensor = twin.Sensor(scene)
    environment, layout = twin.Environment(scene), sensor.layout_px
    track, run = twin.track, twin.run  # loaded here
    rest = np.zeros((120, 160, 3), np.uint8)
    calls: dict[str, Callable[[], Any]] = {
        "displacement": lambda: sensor.displacement([[1.0, 0.0, 3.0]], LOAD),
        "motion": lambda: sensor.motion(LOAD),
        "press": sensor.press,
        "picture": lambda: sensor.picture(None),
        "run": lambda: run(scene, want={"displacement"}),
        "step": lambda: environment.step(None),
        "track": lambda: track(rest, rest, layout),
    }

    def called() -> None:
        try:
            calls[name]()
        except twin.TwinError:  # a picture without markers
            assert name in ("step", "track")

    with threadpool_limits(2):
        own = threads()
        inside = seen_inside(called)
        assert threads() == own
    if name == "run":  # its first lines compute nothing
        inside -= own
    assert inside == {1}


def test_nested_and_interleaved_calls_restore_the_number_when_the_last_ends() -> None:
    first, second = one_blas_thread(), one_blas_thread()
    with threadpool_limits(2):
        own = threads()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads() == {1}
        second.__exit__(None, None, None)
        assert threads() == own


@pytest.mark.parametrize(
    ("options", "environment", "wanted"),
    [
        ([], {}, 1),
        ([], {"OPENBLAS_NUM_THREADS": "2"}, 2),
        ([], {"TWIN_THREADS": "2"}, 2),
        (["--threads", "2"], {"OPENBLAS_NUM_THREADS": "1"}, 2),
    ],
)
def test_a_command_takes_one_thread_unless_the_user_chose(options, environment, wanted):
    code = (
        "import sys\nfrom twin.cli import main\ntry:\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
        "import numpy, threadpoolctl\nfrom twin.blas_threads import one_blas_thread\n"
        "outside = threadpoolctl.threadpool_info()\nwith one_blas_thread():\n"
        "    inside = threadpoolctl.threadpool_info()\n"
        "print(outside[0]['num_threads'], inside[0]['num_threads'])"
    )
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")}
    clean["PYTHONPATH"] = str(Path(twin.__file__).parent.parent)
    done = subprocess.run(
        [sys.executable, "-c", code, "scenes", *options], env={**clean, **environment}, capture_output=True, text=True
    )
    most = os.cpu_count() or 1
    limit = min(wanted, most) if "OPENBLAS_NUM_THREADS" not in environment or options else 1
    assert done.stdout.splitlines()[-1] == f"{min(wanted, most)} {limit}", done.stderr


def test_a_number_of_threads_that_is_none_is_refused(says, monkeypatch):
    monkeypatch.setenv("TWIN_THREADS", "1")  # restored afterwards
    for options in (["--threads", "0"], ["--threads=many"], ["--threads"]):
        assert "--threads" in says(2, "scenes", *options)
