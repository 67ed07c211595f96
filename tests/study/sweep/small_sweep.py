"""A sweep small enough for every test run."""

from typing import Any

import twin
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep

SET: dict[str, Any] = {
    "markers.red.columns": 7, "markers.red.rows": 6, "markers.blue.columns": 6, "markers.blue.rows": 5,
    "reconstruction.sites.columns": 5, "reconstruction.sites.rows": 4,
}  # fmt: skip

TABLE: dict[str, Any] = {
    "scene": "kamiyama_pillar",
    "set": SET,
    "fidelity": ["closed", "linear"],
    "axes": {
        "markers": {"blue": {"depth_mm": [2.0, 3.0]}},
        "markers.*.pitch_mm": {"low": 1.2, "high": 1.8, "steps": 3},
    },
    "derived": {"markers.red.depth_mm": {"follows": "markers.blue.depth_mm", "plus": 3.0}},
    "loads": {"size_mm": 2.0, "pair_mm": 4.0, "presses": 2},
}


def small(**changes: Any) -> tuple[Sweep, Scene]:
    sweep = Sweep.model_validate({**TABLE, **changes})
    return sweep, twin.load_scene(sweep.scene, sweep.set)
