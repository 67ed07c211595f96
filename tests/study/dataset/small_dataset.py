"""A dataset that is made in a second or two: few markers, coarse contact, a picture of 160 x 120."""

import hashlib
from pathlib import Path
from typing import Any

import twin
from twin.parts.scene import Scene
from twin.study.dataset.create import create_dataset

SMALL: dict[str, Any] = {
    "camera.width_px": 160, "camera.height_px": 120, "camera.focal_px": 450,
    "markers.red.columns": 7, "markers.red.rows": 5, "markers.blue.columns": 6, "markers.blue.rows": 4,
    "accuracy.contact_patches": 6, "dataset.samples_per_shard": 2, "dataset.samples_per_sensor": 3,
    "press.friction": 0.0,
    "vary": {
        "press.at_mm": {"low": [-3.0, -2.0], "high": [3.0, 2.0]},
        "press.force_n": {"normal_n": {"low": 0.2, "high": 1.0}},
        "press.probe": {"choice": [{"kind": "sphere", "diameter_mm": {"low": 4, "high": 8}},
                                   {"kind": "cylinder", "diameter_mm": 4}]},
        "material.youngs_modulus_mpa": {"low": 0.8, "high": 1.2},
    },
}  # fmt: skip
NO_PICTURE = ("force_n", "torque_nmm", "site_force_n", "surface_force_n", "marker_displacement_mm", "marker_pressed_px")


def small_scene(columns: tuple[str, ...] = NO_PICTURE, **overrides: Any) -> Scene:
    """Return the small scene with these columns and further overrides (dots written as two underscores)."""
    dotted = {key.replace("__", "."): value for key, value in overrides.items()}
    return twin.load_scene("kamiyama_pillar", {**SMALL, "dataset.columns": list(columns), **dotted})


def make(folder: Path, samples: int = 4, scene: Scene | None = None, **how: Any) -> Any:
    """Make a small dataset without pictures."""
    return create_dataset(scene or small_scene(), folder, samples, **how)


def contents(folder: Path) -> dict[str, str]:
    """Return the digest of every file of a dataset (two long files that differ would take pytest hours to compare)."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
