"""What `twin check`, `twin mesh` and `twin doctor` find out, as the lines that they print.

`check_path` checks a scene, sweep, calibration, folder of results or dataset, and raises an error
that lists every problem. `describe_meshes` lists the meshes of a body and their quality. `examine`
lists what this machine has.
"""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import importlib.util
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np

from twin.arrays import Floats, Progress
from twin.errors import InputError, MissingCapability, RecipeError
from twin.files import MESHES, SCENES, cache_folder, read_arrays
from twin.parts.part import Part
from twin.parts.scene import Scene
from twin.study.doubts import doubts
from twin.study.recipe import find_scene, load_scene


def check_path(name: str) -> list[str]:
    """Check a scene or a sweep (path or shipped name), a calibration file, a result folder or a
    dataset.

    Raises
    ------
    RecipeError, InputError
        Something is wrong with it.
    """
    path = Path(name)
    if (path / "meta" / "info.json").is_file():
        from twin.study.dataset.audit import check_dataset

        return check_dataset(path)
    if path.is_dir():
        return _check_results(path)
    if path.suffix == ".npz":
        from twin.sense.calibration import read_calibration

        calibration = read_calibration(path)
        return [
            f"{path}: calibration of {len(calibration.site_mm)} sites, "
            f"{len(calibration.transfer) // 2} markers: ok"
        ]
    from twin.study.sensor import make
    from twin.study.sweep.designs import is_sweep

    if is_sweep(find_scene(name)):
        from twin.study.sweep.sweep_run import looked_over

        return looked_over(find_scene(name))
    scene = load_scene(name)
    make(scene)
    _mesh_own_body(scene)
    lines = [f"{find_scene(name)}: ok"]
    lines += [f"warning: {doubt}" for doubt in doubts(scene)]
    bare = unsourced(scene)
    if bare:
        lines.append(f"numbers without source or assumed: {', '.join(bare)}")
    return lines


def _mesh_own_body(scene: Scene) -> None:
    """Mesh a body that is given by a file of its own, which may be refused."""
    if scene.body.own_surface is None:
        return
    from twin.study.sensor import Sensor
    from twin.world.mesh.body_mesh import body_mesh

    sensor = Sensor(scene)
    body_mesh(scene.body, sensor.compliance.level)
    if scene.reconstruction is not None:
        body_mesh(scene.body, "nominal")


def unsourced(part: Part, path: str = "") -> list[str]:
    """Return the dotted keys of all numbers given in a recipe without provenance."""
    found = [f"{path}{key}" for key in part.unsourced()]
    for key in type(part).model_fields:
        value = getattr(part, key)
        named = (
            value.items()
            if isinstance(value, dict)
            else enumerate(value)
            if isinstance(value, tuple)
            else ()
        )
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
        raise InputError(
            f"{folder}: holds neither scene.toml nor truth.npz, so it is no result folder"
        )
    try:
        truth = read_arrays(
            truth_file, ("total_force_n", "surface_force_n", "marker_displacement_mm")
        )
        total, pieces, displacement = (
            _vectors(truth[name], axes)
            for name, axes in (
                ("total_force_n", 1),
                ("surface_force_n", 2),
                ("marker_displacement_mm", 2),
            )
        )
    except KeyError as problem:
        raise InputError(f"{truth_file}: holds no {problem}; run the scene again") from None
    except (OSError, ValueError) as problem:
        raise InputError(f"{truth_file}: can't be read ({problem})") from None
    miss = float(np.abs(pieces.sum(axis=0) - total).max())
    if not miss <= 1e-6 * max(1.0, float(np.abs(total).max())):
        raise RecipeError(
            f"surface_force_n sums to {miss:.2g} N away from total_force_n", str(truth_file)
        )
    if not np.isfinite(displacement).all():
        raise RecipeError("marker_displacement_mm is not finite", str(truth_file))
    return [
        *lines,
        f"{truth_file}: forces balance to {miss:.1e} N, {len(displacement)} displacements "
        f"finite: ok",
    ]


def _vectors(array: np.ndarray, axes: int) -> Floats:
    """Return vectors (3,) or (n, 3) as numbers; raise ValueError if they are none."""
    if array.dtype.kind not in "fi" or array.ndim != axes or array.shape[-1] != 3:
        raise ValueError(
            f"an array of {array.dtype} has shape {array.shape}, must be numbers, (n, 3) or (3,)"
        )
    return np.asarray(array, float)


def describe_meshes(
    scene: Scene, *, rebuild: bool, export: Path | None = None, progress: Progress | None = None
) -> list[str]:
    """Return a line for each of the body's meshes: size and worst quality; make them again, or
    export, if asked."""
    from twin.world.mesh.body_mesh import body_mesh
    from twin.world.mesh.quality import quality
    from twin.world.mesh.sizing import Level

    lines = []
    levels: tuple[Level, ...] = (
        "standard",
        "nominal",
    )  # what most scenes need; the others are made on request
    for level in levels:
        mesh = body_mesh(scene.body, level, rebuild=rebuild, progress=progress)
        if export is not None and level == "standard":
            from twin.world.mesh.quadratic_mesh import export_mesh

            export_mesh(mesh, scene.body, export)
        worst = quality(mesh, scene.body)
        failures = worst.failures()
        state = (
            "; ".join(failures)
            or f"smallest dihedral angle {worst.least_dihedral_deg:.1f} deg, volume and surface ok"
        )
        lines.append(
            f"{level:8s} {len(mesh.tets)} tetrahedra, {len(mesh.points)} nodes, {mesh.unknowns} "
            f"unknowns; {state}"
        )
    if progress is not None:
        progress("done", 1.0)
    return lines


NEEDED = (
    "numpy",
    "scipy",
    "numba",
    "mitsuba",
    "drjit",
    "pytetwild",
    "trimesh",
    "pyvista",
    "pydantic",
)
OPTIONAL = {"pypardiso": "faster factorisation on x86-64: pip install pypardiso"}

GL = ("GL", "EGL")
"""Looked for by loading them: the list that the system keeps of its libraries also has those that
were taken away."""

LOADING_S = 20.0
"""How long a library is waited for."""


def examine() -> tuple[list[str], list[str]]:
    """Return facts about this machine, a line each, and what the main job lacks here.

    No package that could crash on this machine is loaded.
    """
    lines = [
        f"python      {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    ]
    missing = []
    for name in NEEDED:
        version = _version(name)
        lines.append(f"{name:11s} {version or 'MISSING'}")
        if version is None:
            missing.append(f"{name} is not installed: pip install tactile-twin")
    for name, use in OPTIONAL.items():
        lines.append(f"{name:11s} {_version(name) or 'not installed (optional): ' + use}")
    if not missing:
        from twin.world.elasticity.factor import available_solvers
        from twin.world.picture.backend import choose_variant

        try:
            variant = choose_variant()
            lines.append(f"renderer    {variant.name}: {variant.reason}")
        except MissingCapability as problem:
            missing.append(str(problem))
        lines.append(f"solver      {', '.join(available_solvers())}")
    lines.append(
        f"GL          "
        f"{'found' if _loads(*GL) else 'not found: only interactive 3-D windows need it'}"
    )
    lines.append(f"cache       {cache_folder()}")
    if not (SCENES.is_dir() and MESHES.is_dir()):
        missing.append(f"the recipes are missing ({SCENES.parent}): install with pip install -e")
    lines.append(f"recipes     {SCENES.parent}")
    return lines, missing


def _loads(*names: str) -> bool:
    """Tell whether libraries can be loaded: in a process of its own, as a broken one may end it."""
    found = [ctypes.util.find_library(name) for name in names]
    code = "import ctypes, sys\nfor name in sys.argv[1:]: ctypes.CDLL(name)"
    command = [sys.executable, "-c", code, *(name for name in found if name)]
    try:
        return (
            all(found)
            and subprocess.run(command, capture_output=True, timeout=LOADING_S).returncode == 0
        )
    except (OSError, subprocess.TimeoutExpired):
        return False


def _version(name: str) -> str | None:
    if importlib.util.find_spec(name) is None:
        return None
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "unknown version"
