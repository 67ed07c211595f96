"""Extreme values: every number of a scene at the ends of its range and at the ends of what a float can hold.

``python -m benchmarks extremes [SCENE ...]`` sets one number at a time, of small scenes that use every table, to its
least and its largest allowed value, to the smallest float there is, and to others that are far from anything of this
world (`FAR`). Each such scene must be computed, with finite answers and balanced forces, or be refused with a cause: no
traceback, no warning of numpy, no endless work. Random draws seldom come this far. Exit code 1 if any fails.
"""

import copy
import math
import sys
import time
import tomllib
import typing
import warnings
from collections import Counter
from collections.abc import Collection, Iterator
from typing import Any, Literal

from benchmarks.random_recipes import Table, bounds, put, rules_of, slots
from benchmarks.random_scenes import Tally, assert_sound
from twin.errors import TwinError
from twin.parts.scene import Scene
from twin.study.recipe import load_scene, validate_scene
from twin.study.run import run

FAR = (0.0, 5e-324, 1e-200, 1e-12, 1e12, -1e12, 1e300, -1e300)
"""The smallest float, and others that nothing of this world needs, mm, N, MPa, degrees or pixels."""

MOST_CPU_S = 60.0
"""No scene of these small ones may take longer."""

DEAR = {"width_px": 640, "height_px": 640, "columns": 40, "rows": 40}
"""What costs in proportion is tried up to this: the same happens a thousand times more often."""

SMALL: Table = {
    "accuracy": {"displacement": 0.1, "contact_patches": 6, "contact_increments": 2, "centroid_px": 0.5},
    "camera.width_px": 80, "camera.height_px": 60, "camera.aperture_mm": 0.5, "camera.vignetting": 1.0,
    "light.radius_mm": 0.5,
    "ccd": {
        "psf_px": 0.5, "read_noise_e": 5.0, "full_well_e": 1e4, "gamma": 0.9, "dark_current_e_s": 10.0,
        "exposure_ms": 10.0, "prnu_pct": 1.0, "dsnu_e": 1.0, "black_dn": 2.0, "jpeg_quality": 90,
        "quantum_efficiency": [0.5, 0.6, 0.5], "bandwidth_mhz": [4.0, 2.0, 2.0],
    },
    "reconstruction": {"sites": {"columns": 3, "rows": 3, "pitch_mm": 1.0}, "friction": 1.0},
    **{f"markers.{layer}.{key}": 3 for layer in ("red", "blue") for key in ("columns", "rows")},
}  # fmt: skip
SCENES: dict[str, tuple[str, Table]] = {
    "block": ("kamiyama_pillar", {
        "camera.focal_px": 225.0, "camera.principal_px": [39.5, 29.5],
        "camera.distortion": [0.01, 0.0, 1e-3, 1e-3, 0.0],
        "press": {
            "probe": {"kind": "pillar", "width_mm": 4.0, "length_mm": 3.0, "edge_mm": 0.5}, "friction": 0.5,
            "tilt_deg": [0.5, 0.5, 10.0],
            "steps": [
                {"move_mm": {"x": 0.0, "y": 0.0, "z": 0.1}, "turn_deg": {"x": 0.0, "y": 0.0, "z": 1.0}},
                {"force_n": {"x": 0.02, "y": 0.02, "z": 0.5}, "torque_nmm": {"x": 0.0, "y": 0.0, "z": 0.1}},
            ],
        },
    }),
    "finger": ("sato_press", {
        "camera.focal_px": 30.0, "press.at_mm": [-0.5, 0.0, 0.0], "press.direction": [0.1, 0.1, 1.0],
        "press.force_n": None, "press.indentation_mm": 0.05, "press.friction": 0.5, "calibration": {},
    }),
    "dome": ("dome_press", {
        "camera.focal_px": 40.0, "light.profile": [[0.0, 1.0], [40.0, 0.5], [90.0, 0.0]],
        "press.probe": {"kind": "cone", "apex_deg": 140.0, "diameter_mm": 6.0, "tip_mm": 0.5},
        "press.force_n": {"z": 0.2},
    }),
    "tractions": ("kamiyama_pillar", {
        "camera.focal_px": 225.0, "calibration.method": "halfspace",
        "tractions": [
            {"kind": "rectangle", "centre_mm": [1.0, 0.5], "size_mm": [2.0, 1.0], "force_n": [0.1, 0.1, 0.5]},
            {"kind": "bump", "centre_mm": [-2.0, 0.5], "radius_mm": 1.5, "force_n": [0.1, 0.1, 0.5]},
            {"kind": "twist", "centre_mm": [0.0, 0.5], "radius_mm": 1.0, "torque_nmm": 0.5},
        ],
    }),
}  # fmt: skip
"""Shipped scenes made small, so that together they hold every number that a run reads."""

UNREAD = {"vary", "dataset", "title"}
"""What a single run doesn't read."""

ALIKE = UNREAD | {"seed", "cover", "ccd", "accuracy", "tolerance"}
LEFT = {
    "block": UNREAD, "finger": ALIKE, "dome": ALIKE,
    "tractions": {key for key in Scene.model_fields if key not in ("tractions", "calibration")},
}  # fmt: skip
"""Tables that are left as they are: unread, or as in the block."""


def scene_of(name: str) -> Scene:
    """Return a scene of `SCENES`."""
    shipped, overrides = SCENES[name]
    return load_scene(shipped, {**SMALL, **overrides})


def numbers(
    scene: Scene, left: Collection[str] = UNREAD
) -> Iterator[tuple[tuple[Any, ...], typing.Sequence[Any], type]]:
    """Yield where every number of a scene is, its field's rules, and whether it is a float or an int."""
    for slot in slots(scene):
        if slot.field is None or slot.path[0] in left:
            continue
        for inner, value in _leaves(slot.value):
            if type(value) in (int, float):
                yield (*slot.path, *inner), [] if inner else rules_of(slot.field), type(value)


def _leaves(value: Any) -> Iterator[tuple[tuple[int, ...], Any]]:
    if isinstance(value, tuple):
        for number, one in enumerate(value):
            yield from (((number, *inner), leaf) for inner, leaf in _leaves(one))
    else:
        yield (), value


def extremes(rules: typing.Sequence[Any], kind: type, dear: float = math.inf) -> list[float | int]:
    """Return the values at which a number is tried: the ends of its range, and what of `FAR` lies within it."""
    low, high = bounds(rules)
    least, most = (-math.inf if low is None else low), min(math.inf if high is None else high, dear)
    ends = [end for end, given in ((least, low), (most, high)) if given is not None]
    return sorted({kind(v) for v in (*ends, *(FAR if kind is float else (0, 10**12))) if least <= v <= most})


def cases(name: str) -> Iterator[tuple[str, float | int, Table]]:
    """Yield the key that is changed, its value and the recipe, of a scene of `SCENES`."""
    scene = scene_of(name)
    plain = tomllib.loads(scene.to_toml())
    for path, rules, kind in numbers(scene, LEFT[name]):
        for value in extremes(rules, kind, DEAR.get(str(path[-1]), math.inf)):
            changed = copy.deepcopy(plain)
            put(changed, _in_tables(path, plain), value)
            yield ".".join(map(str, path)), value, changed


def _in_tables(path: tuple[Any, ...], plain: Any) -> tuple[Any, ...]:
    """Return a path as the recipe spells it: a vector with gaps is a table of x, y and z there."""
    found = []
    for name in path:
        found.append("xyz"[name] if isinstance(name, int) and isinstance(plain, dict) else name)
        plain = plain[found[-1]]
    return tuple(found)


def outcome(recipe: Table, most_cpu_s: float = MOST_CPU_S) -> str:
    """Compute a scene; return what became of it, ``failed: ...`` where it was neither computed in time nor refused."""
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an answer may be poor, and say so
            warnings.simplefilter("error", RuntimeWarning)
            scene = validate_scene(recipe, "changed")
            assert_sound(scene, run(scene), Tally())
    except TwinError as refused:
        return f"refused: {refused}"
    except Exception as problem:
        return f"failed: {type(problem).__name__}: {problem}"
    took = time.process_time() - began
    return "computed" if took < most_cpu_s else f"failed: took {took:.0f} s"


def measure(*scenes: Literal["block", "finger", "dome", "tractions"]) -> int:
    """Try every case of the scenes, print what became of them; exit code 1 if any failed.

    Parameters
    ----------
    scenes
        All by default.
    """
    failed = 0
    for name in scenes or SCENES:
        became: Counter[str] = Counter()
        for key, value, recipe in cases(name):
            what = outcome(recipe)
            became[what.split(":")[0]] += 1
            if what.startswith("failed"):
                print(f"{name}: {key} = {value!r}: {what}", file=sys.stderr)
        print(f"{name}: {', '.join(f'{count} {what}' for what, count in became.most_common())}")
        failed += became["failed"]
    return int(bool(failed))
