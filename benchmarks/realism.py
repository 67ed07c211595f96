"""Is `dataset_realistic` of use? A reader of force, trained on ideal and on realistic pictures, tested on real ones.

Readers are ridge regressions from pictures to the total force. ``change``: where brightness changed along its own
slope, in squares of ``SQUARE_PX`` pixels, in grey over the rest picture's mean. ``flow``: solved for the motion
in each square (Lucas and Kanade, 1981), which no exposure changes. Both training sets have the same loads and differ in
their pictures alone: the ideal set leaves out all of ``[vary]`` but the loads. Tests are of other loads and other
sensors: ideal, realistic, and realistic by paths (`renderer = "path"`).
Loads are bumps of traction, which cost no contact, in place of the recipe's presses.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from twin import open_dataset
from twin.parts.scene import Scene
from twin.study.dataset.create import create_dataset
from twin.study.recipe import load_scene

KEYS = {
    "dataset.columns": ["force_n", "picture"],
    "dataset.samples_per_sensor": 8,
    "tractions": [{"kind": "bump", "centre_mm": [0.0, 0.0], "radius_mm": 2.0, "force_n": [0.0, 0.0, 0.2]}],
}
LOADS = {
    "tractions.0.centre_mm": {"low": [-5.0, -4.0], "high": [5.0, 4.0]},
    "tractions.0.radius_mm": {"low": 1.5, "high": 2.5},
    "tractions.0.force_n": {"normal_n": {"low": 0.05, "high": 0.3}, "ratio": {"low": 0.0, "high": 0.5}},
}
PATHS = {"renderer": "path", "accuracy.paths": 16, "dataset.samples_per_sensor": 4}
SQUARE_PX, BLUR_PX = 24, 1.5
TRAINED, TESTED, BY_PATHS = 160, 48, 12
"""Numbers of loads."""


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return a row for each test; the quick form has few presses and no paths."""
    counts = (16, 8, 0) if quick else (TRAINED, TESTED, BY_PATHS)
    with tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder:
        for name, (scene, count) in sets(*counts).items():
            if count:
                create_dataset(scene, Path(folder) / name, count, workers=2)
        return compare(Path(folder))


def sets(trained: int, tested: int, by_paths: int) -> dict[str, tuple[Scene, int]]:
    """Return scene and size of every set; those of a test have another seed."""
    return {
        "ideal": (_scene({}, ideal=True), trained),
        "realistic": (_scene({}), trained),
        "test-ideal": (_scene({"seed": 2}, ideal=True), tested),
        "test-realistic": (_scene({"seed": 2}), tested),
        "test-paths": (_scene({"seed": 2, **PATHS}), by_paths),
    }


def _scene(overrides: dict[str, Any], *, ideal: bool = False) -> Scene:
    """Return the recipe with loads in place of presses; an ideal one varies nothing else."""
    scene = load_scene("dataset_realistic", {**KEYS, **overrides})
    others = {} if ideal else {k: v for k, v in scene.vary.items() if not k.startswith("press.")}
    loads = load_scene("dataset_realistic", {**KEYS, "vary": LOADS}).vary
    return scene.model_copy(update={"vary": {**others, **loads}})


def compare(folder: Path) -> list[dict[str, Any]]:
    """Return the rms error of the force, N, of both readers in every test that the folder has."""
    sets = {path.name: _read(path) for path in sorted(folder.iterdir())}
    rows = []
    for number, inputs in enumerate(("change", "flow")):
        readers = {name: _trained(sets[name][number], sets[name][2]) for name in ("ideal", "realistic")}
        for test in (name for name in sets if name.startswith("test-")):
            forces = sets[test][2]
            row: dict[str, Any] = {"reader": inputs, "test": test[5:], "loads": len(forces)}
            row |= {f"by_{name}_n": _error(sets[test][number], forces, reader) for name, reader in readers.items()}
            rows.append({**row, "mean_force_n": float(np.sqrt(np.sum(np.var(forces, axis=0))))})
    return rows


def _read(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (n, features) of the pictures for both readers, and (n, 3) forces."""
    data = open_dataset(folder)
    changes, flows, forces = [], [], []
    for sample in data:
        if sample["status"] == "ok":
            rest, now = (
                gaussian_filter(picture.mean(axis=2), BLUR_PX)
                for picture in (data.sensor(sample["sensor"])["picture"], sample["picture"])
            )
            down, across = np.gradient((rest + now) / 2 / rest.mean())
            change = (now - rest) / rest.mean()
            aa, ad, dd, ac, dc = (
                _squares(one * two)
                for one, two in ((across, across), (across, down), (down, down), (across, change), (down, change))
            )
            # The motion that makes the change by least squares; little is made of squares without a slope.
            aa, dd = (each + 0.1 * np.median(aa + dd) for each in (aa, dd))
            motion = np.stack([ad * dc - dd * ac, ad * ac - aa * dc]) / (aa * dd - ad * ad)
            changes.append(np.stack([ac, dc]).ravel())
            flows.append(motion.ravel())
            forces.append(sample["force_n"])
    return np.array(changes), np.array(flows), np.array(forces)


def _squares(picture: np.ndarray) -> np.ndarray:
    rows, columns = (size // SQUARE_PX for size in picture.shape)
    cut = picture[: rows * SQUARE_PX, : columns * SQUARE_PX]
    return cut.reshape(rows, SQUARE_PX, columns, SQUARE_PX).mean(axis=(1, 3))


def _ridge(x: np.ndarray, y: np.ndarray, weight: float) -> tuple[np.ndarray, np.ndarray]:
    mean = x.mean(axis=0)
    slope = (x - mean).T @ np.linalg.solve((x - mean) @ (x - mean).T + weight * np.eye(len(x)), y - y.mean(axis=0))
    return slope, y.mean(axis=0) - mean @ slope


def _trained(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ridge whose weight does best on the last fifth."""
    fit = slice(0, int(0.8 * len(x)))
    rest = slice(fit.stop, len(x))
    weights = np.sum((x - x.mean(axis=0)) ** 2) / len(x) * 10.0 ** np.arange(-6, 2.5, 0.5)
    return _ridge(x, y, min(weights, key=lambda w: _error(x[rest], y[rest], _ridge(x[fit], y[fit], w))))


def _error(x: np.ndarray, y: np.ndarray, reader: tuple[np.ndarray, np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.sum((x @ reader[0] + reader[1] - y) ** 2, axis=1))))
