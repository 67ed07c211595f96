"""Physics-based digital twin of camera-based tactile sensors.

The public names are loaded when they are first used, so that ``import twin`` and ``twin --help``
stay light.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.errors import AccuracyWarning, TwinError
    from twin.parts.load import Load, Traction
    from twin.parts.press import Cone, Cylinder, Object, Pillar, Press, Sphere, Step, Stl
    from twin.parts.scene import Scene
    from twin.sense.calibration import Calibration, read_calibration
    from twin.sense.find_layout import find_layout
    from twin.sense.reconstruct import reconstruct
    from twin.sense.track import Tracker, track
    from twin.study.dataset.reader import open_dataset
    from twin.study.environment import Environment, Observation
    from twin.study.intrinsics import read_intrinsics, write_intrinsics
    from twin.study.recipe import load_scene
    from twin.study.run import run
    from twin.study.sensor import Sensor

if "NUMBA_CACHE_DIR" not in os.environ and not os.access(os.path.dirname(__file__), os.W_OK):
    # numba keeps compiled code next to its source, else in the home folder, and refuses to work
    # where it can do neither
    from twin.files import cache_folder

    os.environ["NUMBA_CACHE_DIR"] = str(cache_folder() / "numba")

_NAMES = {
    "twin.errors": "AccuracyWarning TwinError",
    "twin.parts.load": "Load Traction",
    "twin.parts.press": "Cone Cylinder Object Pillar Press Sphere Step Stl",
    "twin.parts.scene": "Scene",
    "twin.sense.calibration": "Calibration read_calibration",
    "twin.sense.find_layout": "find_layout",
    "twin.sense.reconstruct": "reconstruct",
    "twin.sense.track": "Tracker track",
    "twin.study.dataset.reader": "open_dataset",
    "twin.study.environment": "Environment Observation",
    "twin.study.intrinsics": "read_intrinsics write_intrinsics",
    "twin.study.recipe": "load_scene",
    "twin.study.run": "run",
    "twin.study.sensor": "Sensor",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

__all__ = [
    "AccuracyWarning",
    "Calibration",
    "Cone",
    "Cylinder",
    "Environment",
    "Load",
    "Object",
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
    "find_layout",
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
