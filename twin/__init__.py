"""Physics-based digital twin of camera-based tactile sensors.

The public names are loaded when they are first used, so that ``import twin`` and ``twin --help`` stay light.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.errors import TwinError
    from twin.parts.load import Load, Traction
    from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere, Step, Stl
    from twin.parts.scene import Scene
    from twin.sense.calibration import Calibration, read_calibration
    from twin.sense.reconstruct import reconstruct
    from twin.sense.track import Tracker, track
    from twin.study.dataset.reader import open_dataset
    from twin.study.environment import Environment, Observation
    from twin.study.intrinsics import read_intrinsics, write_intrinsics
    from twin.study.recipe import load_scene
    from twin.study.run import run
    from twin.study.sensor import Sensor

if "NUMBA_CACHE_DIR" not in os.environ and not os.access(os.path.dirname(__file__), os.W_OK):
    # numba keeps compiled code beside its source, else in the home folder, and refuses to work where it can do neither
    from twin.places import cache_folder

    os.environ["NUMBA_CACHE_DIR"] = str(cache_folder() / "numba")

_HOMES = {
    "Calibration": "twin.sense.calibration",
    "Cone": "twin.parts.press",
    "Cylinder": "twin.parts.press",
    "Environment": "twin.study.environment",
    "Load": "twin.parts.load",
    "Observation": "twin.study.environment",
    "Pillar": "twin.parts.press",
    "Press": "twin.parts.press",
    "Scene": "twin.parts.scene",
    "Sensor": "twin.study.sensor",
    "Sphere": "twin.parts.press",
    "Step": "twin.parts.press",
    "Stl": "twin.parts.press",
    "Tracker": "twin.sense.track",
    "Traction": "twin.parts.load",
    "TwinError": "twin.errors",
    "load_scene": "twin.study.recipe",
    "open_dataset": "twin.study.dataset.reader",
    "read_calibration": "twin.sense.calibration",
    "read_intrinsics": "twin.study.intrinsics",
    "reconstruct": "twin.sense.reconstruct",
    "run": "twin.study.run",
    "track": "twin.sense.track",
    "write_intrinsics": "twin.study.intrinsics",
}

__all__ = [
    "Calibration",
    "Cone",
    "Cylinder",
    "Environment",
    "Load",
    "Observation",
    "Pillar",
    "Press",
    "Scene",
    "Sensor",
    "Sphere",
    "Step",
    "Stl",
    "Tracker",
    "Traction",
    "TwinError",
    "load_scene",
    "open_dataset",
    "read_calibration",
    "read_intrinsics",
    "reconstruct",
    "run",
    "track",
    "write_intrinsics",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("tactile-twin")
    raise AttributeError(f"module 'twin' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
