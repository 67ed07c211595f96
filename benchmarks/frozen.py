"""What must not change while the code is rebuilt: ``python -m benchmarks frozen store|compare``.

``store`` computes a fixed set of results through public names and keeps them in ``tests/reference/frozen.npz``.
``compare`` computes them again and prints every array that differs by more than 1e-9 of its largest
value, or every picture of which a pixel differs by more than one count. Where a difference is an
improvement, the changelog explains it and ``store`` is run again.

On another kind of processor, or with other kernels of BLAS, sums are taken in another order: a few
pixels land on the next count, fields kept in single precision differ in their last digit, and inverses
that choose their weight pass that on. There `ELSEWHERE` is allowed.

The set: every shipped scene with a press (scores, truth, two windows and the block means of its pictures), random
presses on both bodies, tracked pairs of pictures, reconstructions by every method, the rows of a small dataset, and the
rows of a linear sweep. Pictures are drawn by the closed form, so that the set doesn't depend on the machine's LLVM.
"""

import json
import math
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.linalg  # noqa: F401 - its BLAS is one of those that are named
from llvmlite.binding import get_host_cpu_name
from threadpoolctl import threadpool_info

FILE = Path(__file__).parent.parent / "tests" / "reference" / "frozen.npz"
RELATIVE = 1e-9
"""Largest difference of a number, over the largest value of its array."""

CONDITION = 1e-6
"""The same of a condition number: rounding changes it by machine epsilon times itself."""

COUNTS = 1
"""Largest difference of a pixel, counts."""

MEAN_COUNTS = 0.1
"""Largest difference of the mean of a block of 256 pixels, counts."""

ELSEWHERE = {"scene": 1e-2, "pair": 0.2, "dataset": 1e-6, "presses": 1e-9, "sweep": 1e-6}
"""`RELATIVE` by part where `arithmetic` isn't that of the stored results. Measured between an Intel Xeon
and an AMD EPYC with two kinds of kernels: 2e-3, 8e-2 (one field by ``norm``, whose weight has a flat
optimum; 7e-3 without), 3e-8, 5e-12 and 4e-8."""

ARITHMETIC = "arithmetic"
"""The stored entry that holds `arithmetic`."""

SCENES = [
    "block_bare",
    "dome_press",
    "first_press",
    "kamiyama_paper",
    "kamiyama_pillar",
    "kamiyama_shear",
    "kamiyama_twist",
    "kamiyama_two_points",
    "kamiyama_wide",
    "sato_paper",
    "sato_press",
    "sato_shear",
    "sato_two_points",
    "two_points",
]
INVERSES: dict[str, dict[str, Any]] = {
    "pinv": {"method": "pinv"},
    "norm": {"method": "norm"},
    "smooth": {"method": "smooth"},
    "local": {"method": "local"},
    "push_only": {"push_only": True},
    "cone": {"friction": 0.8},
    "robust": {"robust": True},
}
PRESSES, PAIRS, SAMPLES = 100, 20, 8
"""Presses on each body, tracked pairs, rows of each dataset."""

PRESS_COLUMNS: dict[str, Callable[[Any], float]] = {
    **{f"force_{axis}": lambda state, i=i: state.force_n[i] for i, axis in enumerate("xyz")},
    "torque": lambda state: state.torque_nmm,
    "indentation": lambda state: state.indentation_mm,
    "radius": lambda state: state.contact_radius_mm,
    "peak": lambda state: state.peak_pressure_mpa,
    "area": lambda state: state.area_mm2,
    "elastic": lambda state: state.elastic_nmm,
    "traction_squared": lambda state: (state.traction_mpa**2).sum(),
    "slipping": lambda state: state.slip.sum(),
}
"""What is kept of a press; of one that is refused, NaN."""

CLOCK = ("seconds", "_ms")
"""Endings of columns that depend on the clock."""

WINDOW = 96
"""Width of the windows that are kept of a picture, px."""


def frozen() -> Iterator[tuple[str, Any]]:
    """Yield every result's name and value."""
    for part in (_scenes, _presses, _pairs, _dataset, _sweep):
        yield from part()


def _scenes() -> Iterator[tuple[str, Any]]:
    import twin

    for name in SCENES:
        result = twin.run(twin.load_scene(name))
        for group, values in _numbers(result.score).items():
            yield f"scene/{name}/score/{group}", values
        truth = result.truth
        yield f"scene/{name}/displacement_mm", truth.marker_displacement_mm
        yield f"scene/{name}/outline_px", truth.marker_outline_pressed_px
        force = truth.surface_force_n
        yield f"scene/{name}/force_n", np.stack([force.sum(axis=0), (force**2).sum(axis=0)])
        if result.estimate is not None:
            yield f"scene/{name}/shift_px", result.estimate.marker_shift_px
            yield f"scene/{name}/estimate_n", result.estimate.force_n
        for which, picture in (("rest", result.rest), ("pressed", result.pressed)):
            if picture is not None:
                yield from _picture(f"scene/{name}/{which}", picture)


def _picture(name: str, picture: np.ndarray) -> Iterator[tuple[str, Any]]:
    """Yield two windows of a picture and the means of its blocks of 16 x 16 pixels."""
    height, width = picture.shape[:2]
    for place, (row, column) in {"middle": (height // 2, width // 2), "corner": (0, 0)}.items():
        top, left = (max(0, at - WINDOW // 2) for at in (row, column))
        yield f"{name}/window/{place}", picture[top : top + WINDOW, left : left + WINDOW]
    blocks = picture[: height // 16 * 16, : width // 16 * 16].astype(float)
    yield f"{name}/means", blocks.reshape(height // 16, 16, width // 16, 16, 3).mean(axis=(1, 3))


def _presses() -> Iterator[tuple[str, Any]]:
    import twin
    from benchmarks.presses import drawn

    for body, scene in (("block", "block_bare"), ("finger", "finger_bare")):
        sensor = twin.Sensor(twin.load_scene(scene, {"accuracy.contact_patches": 10}))
        states = []
        for number in range(PRESSES):
            try:
                states.append(sensor.press(drawn(body, number)[0]))
            except twin.TwinError:
                states.append(None)
        for name, figure in PRESS_COLUMNS.items():
            yield f"presses/{body}/{name}", np.array([np.nan if s is None else figure(s) for s in states], float)


def _pairs() -> Iterator[tuple[str, Any]]:
    import twin
    from twin.study.calibrate import calibration_of

    rng = np.random.default_rng(20)
    for name in ("kamiyama_pillar", "sato_press"):
        scene = twin.load_scene(name)
        sensor = twin.Sensor(scene)
        calibration = calibration_of(sensor)
        rest = sensor.picture(None, exposure=0)
        for pair in range(PAIRS // 2):
            place = rng.uniform(-2, 2, 2)
            radius = float(rng.uniform(0.8, 2))
            force = (*rng.normal(0, 0.1, 2).tolist(), float(rng.uniform(0.2, 1)))
            load = twin.Traction.disk(tuple(place.tolist()), radius, force)
            found = twin.track(rest, sensor.picture(load, exposure=pair + 1), sensor.layout_px)
            yield f"pair/{name}/{pair}/shift_px", found.shift_px
            yield f"pair/{name}/{pair}/sd_px", found.sd_px
            for inverse in INVERSES if pair < 2 else ("smooth",):
                field = twin.reconstruct(found, calibration, **INVERSES[inverse])
                yield f"pair/{name}/{pair}/{inverse}", field.force_n


def _dataset() -> Iterator[tuple[str, Any]]:
    import twin
    from twin.study.dataset.create import create_dataset

    columns = ["force_n", "torque_nmm", "site_force_n", "marker_displacement_mm", "picture"]
    overrides = {"dataset.samples_per_shard": SAMPLES // 2, "dataset.columns": columns}
    for name in ("dataset_kamiyama", "dataset_sato"):
        with tempfile.TemporaryDirectory() as folder:
            create_dataset(twin.load_scene(name, overrides), Path(folder) / "data", SAMPLES)
            rows = twin.open_dataset(Path(folder) / "data")
            for number in range(SAMPLES):
                for key, value in rows[number].items():
                    array = np.asarray(value)
                    if array.dtype == np.uint8 and array.ndim == 3:
                        yield from _picture(f"dataset/{name}/{number}/{key}", array)
                    elif array.dtype.kind in "fiub" and not key.endswith(CLOCK):
                        yield f"dataset/{name}/{number}/{key}", array


def _sweep() -> Iterator[tuple[str, Any]]:
    import pyarrow.parquet as pq

    from twin.study.sweep.designs import load_sweep
    from twin.study.sweep.sweep_run import run_sweep

    with tempfile.TemporaryDirectory() as folder:
        sweep, scene = load_sweep("sweep_lens")
        run_sweep(sweep, scene, Path(folder) / "sweep")
        rows = pq.read_table(Path(folder) / "sweep" / "designs.parquet").to_pydict()
    for key, values in rows.items():
        column = np.array([np.nan if value is None else value for value in values])
        if column.dtype.kind in "fiub" and not key.endswith(CLOCK):
            yield f"sweep/{key}", column.astype(float)


def _numbers(score: Any) -> dict[str, Any]:
    """Return the finite numbers of a score's groups; what depends on the clock isn't among them."""
    plain = json.loads(json.dumps(score, default=lambda each: getattr(each, "__dict__", str(each))))
    return {
        group: np.array([v for v in values.values() if isinstance(v, int | float)], float)
        for group, values in plain.items()
        if isinstance(values, dict) and group in ("elastic", "tracking", "force")
    }


def compare(stored: dict[str, np.ndarray]) -> list[str]:
    """Return a line for every result that differs from the stored one."""
    problems = []
    seen = {ARITHMETIC}
    here = str(stored[ARITHMETIC]) == arithmetic()
    for name, value in frozen():
        seen.add(name)
        now = np.asarray(value)
        if name not in stored:
            problems.append(f"{name}: new")
        elif stored[name].shape != now.shape:
            problems.append(f"{name}: shape {stored[name].shape} became {now.shape}")
        elif (far := _difference(name, stored[name], now)) > (limit := _limit(name, now, here)):
            problems.append(f"{name}: differs by {far:.3g}, allowed {limit:g}")
    return problems + [f"{name}: missing" for name in sorted(set(stored) - seen)]


def _limit(name: str, now: np.ndarray, here: bool) -> float:
    if now.dtype == np.uint8:
        return COUNTS
    if name.endswith("means"):
        return MEAN_COUNTS
    if name.endswith("condition"):
        return CONDITION
    return RELATIVE if here else ELSEWHERE[name.split("/")[0]]


def _difference(name: str, before: np.ndarray, now: np.ndarray) -> float:
    """Return the largest difference: counts of a picture, else over the largest value; inf if NaN moved."""
    before = before.astype(float)
    now = now.astype(float)
    if (np.isnan(before) != np.isnan(now)).any():
        return math.inf
    far = float(np.nanmax(np.abs(before - now), initial=0.0))
    if "/window/" in name or name.endswith("means"):
        return far
    return far / float(np.nanmax(np.abs(before), initial=0.0) or 1.0)


def arithmetic() -> str:
    """Return what sums are taken by: the processor, as LLVM calls it, and the kernels of BLAS."""
    kernels = {str(library.get("architecture")) for library in threadpool_info() if library["user_api"] == "blas"}
    return " ".join([get_host_cpu_name(), *sorted(kernels)])


def read() -> dict[str, np.ndarray]:
    """Return what is stored."""
    with np.load(FILE) as archive:
        return dict(archive.items())


def measure(what: Literal["store", "compare"]) -> int:
    """Store or compare; return 1 where something differs."""
    os.environ["TWIN_VARIANT"] = "splat"
    if what == "store":
        found = {name: np.asarray(value) for name, value in frozen()}
        np.savez_compressed(FILE, **found, **{ARITHMETIC: np.array(arithmetic())})
        print(f"stored {FILE} ({FILE.stat().st_size / 1e6:.1f} MB)")
        return 0
    problems = compare(read())
    print("\n".join(problems) or "nothing differs")
    return 1 if problems else 0
