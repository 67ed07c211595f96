"""Check files and result folders: every problem at once, or a line that says what was checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin.archive import read_arrays
from twin.arrays import Floats
from twin.errors import InputError, RecipeError
from twin.parts.part import Part
from twin.study.recipe import find_scene, load_scene


def check_path(name: str) -> list[str]:
    """Check a scene or a sweep (path or shipped name), a calibration file, a result folder or a dataset.

    Raises
    ------
    RecipeError, InputError
        Something is wrong with it.
    """
    path = Path(name)
    if (path / "meta" / "info.json").is_file():
        from twin.study.dataset.check import check_dataset

        return check_dataset(path)
    if path.is_dir():
        return _check_results(path)
    if path.suffix == ".npz":
        from twin.sense.calibration import read_calibration

        calibration = read_calibration(path)
        return [
            f"{path}: calibration of {len(calibration.site_mm)} sites, {len(calibration.transfer) // 2} markers: ok"
        ]
    from twin.study.actual import make
    from twin.study.sweep.recipe import is_sweep

    if is_sweep(find_scene(name)):
        from twin.study.sweep.estimate import looked_over

        return looked_over(find_scene(name))
    scene = load_scene(name)
    make(scene)
    lines = [f"{find_scene(name)}: ok"]
    told = unsourced(scene)
    if told:
        lines.append(f"numbers without source or assumed: {', '.join(told)}")
    return lines


def unsourced(part: Part, path: str = "") -> list[str]:
    """Return the dotted keys of all numbers given in a recipe without provenance."""
    found = [f"{path}{key}" for key in part.unsourced()]
    for key in type(part).model_fields:
        value = getattr(part, key)
        named = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, tuple) else ()
        children = {f"{key}.{name}": child for name, child in named} if named else {key: value}
        for name, child in children.items():
            if isinstance(child, Part):
                found += unsourced(child, f"{path}{name}.")
    return found


def _check_results(folder: Path) -> list[str]:
    lines = []
    if (folder / "scene.toml").is_file():
        lines += check_path(str(folder / "scene.toml"))[:1]
    truth_file = folder / "truth.npz"
    if not truth_file.is_file():
        if lines:
            return lines
        raise InputError(f"{folder}: holds neither scene.toml nor truth.npz, so it is no result folder")
    try:
        truth = read_arrays(truth_file, ("total_force_n", "surface_force_n", "marker_displacement_mm"))
        total, pieces, displacement = (
            _vectors(truth[name], axes)
            for name, axes in (("total_force_n", 1), ("surface_force_n", 2), ("marker_displacement_mm", 2))
        )
    except KeyError as problem:
        raise InputError(f"{truth_file}: holds no {problem}; run the scene again") from None
    except (OSError, ValueError) as problem:
        raise InputError(f"{truth_file}: can't be read ({problem})") from None
    miss = float(np.abs(pieces.sum(axis=0) - total).max())
    if not miss <= 1e-6 * max(1.0, float(np.abs(total).max())):
        raise RecipeError(f"surface_force_n sums to {miss:.2g} N away from total_force_n", str(truth_file))
    if not np.isfinite(displacement).all():
        raise RecipeError("marker_displacement_mm is not finite", str(truth_file))
    return [*lines, f"{truth_file}: forces balance to {miss:.1e} N, {len(displacement)} displacements finite: ok"]


def _vectors(array: np.ndarray, axes: int) -> Floats:
    """Return vectors (3,) or (n, 3) as numbers; raise ValueError if they are none."""
    if array.dtype.kind not in "fi" or array.ndim != axes or array.shape[-1] != 3:
        raise ValueError(f"an array of {array.dtype} has shape {array.shape}, must be numbers, (n, 3) or (3,)")
    return np.asarray(array, float)
