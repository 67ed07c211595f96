"""What `twin check` and `twin doctor` find out.

`check_path` checks a scene, sweep, calibration, folder of results or dataset, and raises an error
that lists every problem. `examine` returns what this machine has. `check_camera` is what two rest
pictures say about a camera: noise, exposure, focus, compression, and the errors of shifts and
forces that follow.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, coordinates
from twin.errors import InputError, MissingCapability, RecipeError
from twin.files import MESHES, SCENES, Fact, cache_folder, fact, read_arrays
from twin.parts.body import CREASE_DEG, Body
from twin.parts.part import Part
from twin.parts.scene import Scene
from twin.study.doubts import doubts
from twin.study.recipe import find_scene, load_scene, read_recipe

if TYPE_CHECKING:
    from twin.sense.track import Found


def check_path(name: str, overrides: Mapping[str, Any] | None = None) -> list[Fact]:
    """Check a scene or a sweep (path or shipped name; ``overrides`` change keys of the scene), a
    calibration file, OpenCV's file of a camera, a result folder or a dataset.

    Raises
    ------
    RecipeError, InputError
        Something is wrong with it, or there is no scene that overrides could change.
    """
    facts = _check_other(Path(name))
    if facts is not None and overrides:
        raise InputError(f"{name}: -s {min(overrides)}=... changes a scene, and this is none")
    return _check_recipe(name, overrides) if facts is None else facts


def _check_other(path: Path) -> list[Fact] | None:
    """Check what is no recipe; None for a recipe."""
    if (path / "meta" / "info.json").is_file():
        from twin.study.dataset.audit import check_dataset

        return check_dataset(path)
    if path.is_dir():
        return _check_results(path)
    if path.suffix == ".npz":
        from twin.sense.calibration import read_calibration

        calibration = read_calibration(path)
        sizes = {"sites": len(calibration.site_mm), "markers": len(calibration.transfer) // 2}
        text = "calibration of {sites} sites, {markers} markers: ok"
        return [fact(str(path), text, sizes, ": ")]
    if path.suffix.lower() in (".yaml", ".yml", ".json"):
        from twin.study.intrinsics import read_intrinsics

        keys = read_intrinsics(path).items()
        means = f'ok; [camera] intrinsics = "{path.name}" in a recipe means'
        values = [fact(key, json.dumps(value), {"value": value}, " = ") for key, value in keys]
        return [fact(str(path), means, mark=": "), *values]
    return None


def _check_recipe(name: str, overrides: Mapping[str, Any] | None) -> list[Fact]:
    from twin.study.sensor import Sensor

    file = find_scene(name)
    if file.suffix == ".toml" and "axes" in read_recipe(file):
        from twin.study.sweep.designs import load_sweep
        from twin.study.sweep.sweep_run import estimate

        return [
            fact(str(file), "ok", mark=": "),
            *estimate(*load_sweep(file, overrides), workers=0),
        ]
    scene = load_scene(name, overrides)
    sensor = Sensor(scene)
    sensor.actual  # noqa: B018  refuses a marker outside the body
    if scene.press is not None or scene.tractions:
        sensor.check_law(None if scene.tractions else scene.press)
    if scene.press is not None:
        from twin.world.contact.probe_gap import Approach

        for press in scene.presses:
            Approach.of_press(press, scene.body).check_depth(press, scene.body)
    if scene.reconstruction is not None:
        sensor.sites  # noqa: B018  refuses sites off the sensing surface
    if scene.body.own_surface is not None:  # its mesh may be refused
        from twin.world.mesh.body_mesh import body_mesh

        body_mesh(scene.body, sensor.compliance.level)
        if scene.reconstruction is not None:
            body_mesh(scene.body, "nominal")
    warnings = (*doubts(scene), *_check_dataset(scene))
    facts = [
        fact(str(file), "ok", mark=": "),
        *(fact("warning", doubt, mark=": ") for doubt in warnings),
    ]
    facts += _chords(scene.body)
    if bare := ", ".join(_unsourced(scene)):
        facts.append(fact("numbers without source or assumed", bare, mark=": "))
    return facts


_BLUNT_DEG = 40.0
"""Edges from `CREASE_DEG` up to this angle may be chords of a curved face, too."""


def _chords(body: Body) -> list[Fact]:
    """Return how far an STL body's triangles lie off its curved faces, and which edges may be
    chords."""
    found = []
    if body.chord_mm:
        text = "triangles lie up to {chord_mm:.2g} mm off them, and are bent to fit"
        found.append(fact("curved faces", text, {"chord_mm": body.chord_mm}, ": "))
    if body.own_surface is not None:
        from twin.geometry.pieces import Pieces

        angles, ends = Pieces.edge_angles(*body.own_surface)
        turned = np.abs(180.0 - angles)
        blunt = ends[(turned >= CREASE_DEG) & (turned < _BLUNT_DEG)].mean(axis=1)
        if len(blunt):
            text = (
                "edges of {crease_deg:g} to {blunt_deg:g} deg, as at ({place}) mm, count as sharp; "
                "where they are chords of a curved face, export it finer"
            )
            limits = {"crease_deg": CREASE_DEG, "blunt_deg": _BLUNT_DEG}
            place = coordinates(blunt[0])
            found.append(fact("warning", text, {**limits, "place": place}, ": "))
    return found


def _check_dataset(scene: Scene) -> list[str]:
    """Refuse what `twin dataset` refuses of a scene for datasets; return what it warns of."""
    if not (scene.vary or "dataset" in scene.model_fields_set):
        return []
    from twin.study.dataset.plan import Plan

    plan = Plan(scene, 2)
    plan.check()
    return [each for each in (plan.alike, plan.misses) if each]


def _unsourced(part: Part, path: str = "") -> list[str]:
    """Return the dotted keys of numbers given in a recipe without provenance."""
    found = [f"{path}{key}" for key in part.unsourced()]
    for key in type(part).model_fields:
        value = getattr(part, key)
        named = dict(enumerate(value)) if isinstance(value, tuple) else value
        children = named.items() if isinstance(named, dict) else [("", value)]
        for name, child in children:
            if isinstance(child, Part):
                found += _unsourced(child, f"{path}{key}.{name}".strip(".") + ".")
    return found


def _check_results(folder: Path) -> list[Fact]:
    facts = []
    if (folder / "scene.toml").is_file():
        facts += check_path(str(folder / "scene.toml"))[:1]
    # Without a truth, the recipe alone is checked.
    truth_file = folder / "truth.npz"
    if not truth_file.is_file():
        if facts:
            return facts
        raise InputError(
            f"{folder}: holds neither scene.toml nor truth.npz, so it is no result folder; a "
            "recording is checked where it is used: twin calibrate FOLDER --scene SCENE"
        )
    try:
        axes = {"total_force_n": 1, "surface_force_n": 2, "marker_displacement_mm": 2}
        truth = read_arrays(truth_file, tuple(axes))
        total, pieces, displacement = (_vectors(truth[name], axes[name]) for name in axes)
    except KeyError as problem:
        raise InputError(f"{truth_file}: holds no {problem}; run the scene again") from None
    except (OSError, ValueError) as problem:
        raise InputError(f"{truth_file}: can't be read ({problem})") from None
    # The forces on the surface must sum to the total force.
    miss = float(np.abs(pieces.sum(axis=0) - total).max())
    if not miss <= 1e-6 * max(1.0, float(np.abs(total).max())):
        raise RecipeError(
            f"surface_force_n sums to {miss:.2g} N away from total_force_n", str(truth_file)
        )
    if not np.isfinite(displacement).all():
        raise RecipeError("marker_displacement_mm is not finite", str(truth_file))
    text = "forces balance to {balance_n:.1e} N, {displacements} displacements finite: ok"
    sizes = {"balance_n": miss, "displacements": len(displacement)}
    return [*facts, fact(str(truth_file), text, sizes, ": ")]


def _vectors(array: np.ndarray, axes: int) -> Floats:
    """Return vectors (3,) or (n, 3) as numbers; raise ValueError if they are none."""
    if array.dtype.kind not in "fi" or array.ndim != axes or array.shape[-1] != 3:
        raise ValueError(
            f"an array of {array.dtype} has shape {array.shape}, must be numbers, (n, 3) or (3,)"
        )
    return np.asarray(array, float)


NEEDED = (
    "numpy",
    "scipy",
    "numba",
    "mitsuba",
    "drjit",
    "pytetwild",
    "mmgpy",
    "trimesh",
    "pyvista",
    "pydantic",
)
OPTIONAL = {"pypardiso": "faster factorisation on x86-64: pip install pypardiso"}


def examine() -> tuple[dict[str, str], list[str]]:
    """Return facts about this machine by name, and what the main job lacks here.

    No package that could crash on this machine is loaded.
    """
    facts = {
        "python": f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    }
    missing = []
    for name in NEEDED:
        version = _version(name)
        facts[name] = version or "MISSING"
        if version is None:
            missing.append(f"{name} is not installed: pip install tactile-twin")
    for name, use in OPTIONAL.items():
        facts[name] = _version(name) or f"not installed (optional): {use}"
    if not missing:
        from twin.world.elasticity.factor import Factor
        from twin.world.picture.backend import Variant

        try:
            variant = Variant.choose()
            facts["renderer"] = f"{variant.name}: {variant.reason}"
        except MissingCapability as problem:
            missing.append(str(problem))
        facts["solver"] = ", ".join(Factor.solvers())
    facts["cache"] = str(cache_folder())
    if not (SCENES.is_dir() and MESHES.is_dir()):
        missing.append(f"the recipes are missing ({SCENES.parent}): install with pip install -e")
    facts["recipes"] = str(SCENES.parent)
    return facts, missing


def _version(name: str) -> str | None:
    if importlib.util.find_spec(name) is None:
        return None
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "unknown version"


SATURATED_DN = 254
"""Counts from which on a pixel is saturated: compression takes one off."""

FEW = 0.9
"""Share of the markers that must be found."""

BLURRED = 0.25
"""Blur's standard deviation over the markers' width above which their edge is mostly blur."""

UNTRUE = 1.5
"""The largest ratio of measured to stated errors of pictures that differ by noise alone."""

SHARED_NOISE = 0.25
"""The ratio of measured to stated errors below which two pictures must have noise in common."""

MOVED = 5.0
"""Standard errors of the mean motion above which the sensor, or the camera, has moved."""

TOUCHED, TOUCHED_MARKERS = 8.0, 3
"""Standard deviations of a shift from which a marker has moved against the others, and how many
such markers are no accident of dust or glint."""


def check_camera(first: Path, second: Path, scene: Scene) -> list[Fact]:
    """Return facts about a camera, the last one whether it is good enough and why not.

    Two exposures of a sensor that nothing touches differ by noise alone, so the motion that the
    tracker finds between them is its error, to be compared with the one that it states. The scene
    is the sensor's nominal design.

    Raises
    ------
    RecipeError, InputError
        No camera in the scene; pictures of another size, the same one twice, without markers.
    """
    from twin.sense.centre import COHERENT
    from twin.sense.colour import as_picture
    from twin.sense.disc_fit import DiscFit
    from twin.sense.track import Tracker, analyse_rest
    from twin.study.frames import read_picture
    from twin.study.sensor import SATURATED, Sensor

    if scene.camera is None:
        raise RecipeError("this scene has no [camera] table: two rest pictures can't be compared")
    sensor = Sensor(scene)
    one, two = read_picture(first), read_picture(second)
    if np.array_equal(one, two):
        raise InputError(f"{second}: is the same picture as {first}: expose the sensor twice")
    try:
        rest = analyse_rest(one, sensor.layout_px)
        found = Tracker.motion(rest, two, np.zeros_like(rest.rest_px))
    except InputError as problem:
        raise InputError(f"{first}, {second}: {problem}") from None
    seen = found.seen
    if seen.sum() < 2:
        raise InputError(
            f"{first}, {second}: show {int(seen.sum())} of the scene's {len(seen)} markers: are "
            "they this sensor's, upright, of its camera mode, and exposed?"
        )
    # Measure what the tracker states, blur, width, saturation and noise.
    stated = float(np.median(found.sd_px[seen]))
    assert found.usual_sd_px is not None
    coherence = float(np.median(found.usual_sd_px[seen] / rest.usual_sd_px[seen]))
    fits = [group for group in rest.groups if isinstance(group, DiscFit)]
    blur = max((float(np.nanmedian(fit.templates.blur_px)) for fit in fits), default=0.0)
    width = min(group.look.diameter_px for group in rest.groups)
    counts = [as_picture(each, "the picture").astype(float) for each in (one, two)]
    full = max(float((each >= SATURATED_DN).any(axis=2).mean()) for each in counts)
    noise = float(np.std(counts[0] - counts[1]) / np.sqrt(2.0))  # of one picture
    # Compare each with its limit.
    problems = []
    if seen.mean() < FEW:
        problems.append(
            f"only {100 * seen.mean():.3g} % of the markers are found: twin calibrate "
            f"--layout-from {first} --scene SCENE states which dots it shows, and which camera fits"
        )
    if full > SATURATED:
        problems.append(f"{100 * full:.2g} % of the pixels are saturated: expose less")
    if blur > BLURRED * width:
        problems.append(f"edges are blurred by {blur:.2g} px in markers {width:.3g} px wide: focus")
    problems += _motion_problems(found, stated)
    answer = "no: " + "; ".join(problems) if problems else "yes"
    if coherence > COHERENT and seen.mean() >= FEW:  # else markers may be taken for others
        answer += (
            f"; without compression or a colour mosaic errors would be {coherence:.2g} times "
            "smaller"
        )
    size = {"seen": int(seen.sum()), "markers": len(seen), "width_px": width}
    light = {"noise_counts": noise, "saturated_pct": 100 * full}
    shift = {"measured_px": found.scatter_px, "stated_px": stated}
    pixels = "errors of shifts {ratio:.2g} times those by noise of single pixels"
    dark = "{noise_counts:.2g} counts, {saturated_pct:.2g} % of the pixels saturated"
    sds = "{measured_px:.2g} px measured, {stated_px:.2g} px stated (standard deviation)"
    return [
        fact("markers", "{seen} of {markers} found, {width_px:.3g} px wide", size),
        fact("noise", dark, light),
        fact("blur", "{blur_px:.2g} px (standard deviation, lens and pixel)", {"blur_px": blur}),
        fact("compression", pixels, {"ratio": coherence}, ": "),
        fact("shifts", sds, shift),
        *_force_noise(sensor.nominal, found),
        fact("good enough", answer, mark=": "),
    ]


def _motion_problems(found: Found, stated_px: float) -> list[str]:
    """Return what is wrong with shifts where nothing should have moved."""
    seen, measured = found.seen, found.scatter_px
    common = np.median(found.shift_px[seen], axis=0)
    problems = []
    if measured > UNTRUE * stated_px:
        problems.append(
            f"shifts differ by {measured:.2g} px, not by the stated {stated_px:.2g} px: does the "
            "light flicker, or something move?"
        )
    if measured < SHARED_NOISE * stated_px:
        problems.append(
            f"shifts differ by {measured:.2g} px only, the stated error is {stated_px:.2g} px: the "
            "pictures are hardly two exposures; switch off averaging over frames"
        )
    if np.hypot(*common) > max(MOVED * 1.25 * stated_px / np.sqrt(seen.sum()), 0.01):
        problems.append(
            f"all markers moved by {common[0]:.2g}, {common[1]:.2g} px: mount the camera tighter"
        )
    alone = np.hypot(*(found.shift_px[seen] - common).T)
    moved = alone > TOUCHED * max(measured, stated_px)
    if moved.sum() >= TOUCHED_MARKERS:
        problems.append(
            f"{int(moved.sum())} markers moved against the others, by up to {alone.max():.2g} px: "
            "did something touch the sensor in one of the pictures?"
        )
    return problems


def _force_noise(scene: Scene, found: Found) -> list[Fact]:
    """Return what a total force is known to; nothing where the scene reconstructs none."""
    from twin.sense.reconstruct import reconstruct
    from twin.study.calibrate import calibration_of
    from twin.study.sensor import Sensor

    if scene.reconstruction is None:
        return []
    design = scene.calibration.model_copy(update={"method": "compliance"})
    nominal = Sensor(scene.model_copy(update={"calibration": design}))
    field = reconstruct(found, calibration_of(nominal))
    sds = dict(zip(("fx_n", "fy_n", "fz_n"), field.sd_total_n.tolist(), strict=True))
    text = "Fx {fx_n:.2g}, Fy {fy_n:.2g}, Fz {fz_n:.2g} N of noise in a total without load"
    return [fact("force", text, sds)]
