"""How the chain grows: CPU seconds over markers, sites, pixels, samples and workers, and what more nodes add.

One process and thread each, warmed up; the scene is the flat sensor's. ``exponent`` is the power of the size, by least
squares in log-log axes over all rows of one stage. Nodes are dask workers with caches and folders of their own that
share nothing but the network; their CPU seconds are counted by process, as two cores can't show what ten machines do.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import twin
from benchmarks.clock import median_cpu_s
from benchmarks.dataset import FRICTIONLESS, TRUTH
from twin.blas_threads import one_thread
from twin.parts.scene import Scene
from twin.sense.reconstruct import reconstruct
from twin.sense.track import track
from twin.study.batch.pool import Scheduler
from twin.study.calibrate import nominal_calibration
from twin.study.dataset.create import create_dataset
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor

PITCHES = (2.4, 1.7, 1.2, 0.9)
"""Of both layers, whose extent stays: 240 to 1,700 markers."""

SITES = (6, 9, 13, 18)
"""Sites along either side."""

WIDTHS = (320, 640, 1280, 1920)
"""Picture widths; the view stays."""

SAMPLES = (100, 400, 1600)
"""Of datasets that one process makes."""

ON_NODES = (40, 360)
"""Samples of the two datasets that nodes make: what the larger one takes more is a sample's, without any start."""

NODES = (1, 2)
"""Workers, each a node of its own."""

Row = dict[str, Any]


def run(quick: bool) -> list[Row]:
    """Return rows by size and stage, then the exponents, then the nodes."""
    with one_thread():
        rows = [
            *_markers(PITCHES[:2] if quick else PITCHES), *_sites(SITES[:2] if quick else SITES),
            *_pixels(WIDTHS[:2] if quick else WIDTHS), *_samples(SAMPLES[:2] if quick else SAMPLES),
        ]  # fmt: skip
    nodes = [] if quick else cluster()
    rows += [row for row in nodes if "stage" in row]
    fitted = [
        {"axis": axis, "stage": stage, "exponent": exponent(mine, "cpu_ms")}
        for axis, stage in dict.fromkeys((row["axis"], row["stage"]) for row in rows)
        if len(mine := [r for r in rows if (r["axis"], r["stage"]) == (axis, stage)]) > 1
        and min(row["cpu_ms"] for row in mine) > 0
    ]
    return [*rows, *fitted, *(row for row in nodes if "stage" not in row)]


def _timed(axis: str, size: int, stages: dict[str, Callable[[], object]]) -> list[Row]:
    rows = []
    for stage, work in stages.items():
        work()
        rows.append({"axis": axis, "size": size, "stage": stage, "cpu_ms": 1e3 * median_cpu_s(work, 3)})
    return rows


def _markers(pitches: tuple[float, ...]) -> Iterator[Row]:
    for pitch in pitches:
        changes: dict[str, Any] = {}
        for name, columns, rows in (("red", 21, 16), ("blue", 20, 15)):
            counts = {key: 1 + round((n - 1) * 1.5 / pitch) for key, n in (("columns", columns), ("rows", rows))}
            layer = {"pitch_mm": pitch, "diameter_mm": 0.3, **counts}
            changes |= {f"markers.{name}.{key}": value for key, value in layer.items()}
        sensor = Sensor(load_scene("kamiyama_pillar", changes))
        load = sensor.press().load
        motion, rest = sensor.motion(load), sensor.picture(None)
        pressed = sensor.picture(motion)
        yield from _timed("markers", len(sensor.nominal_markers), {
            "displacement": lambda s=sensor, w=load: s.motion(w),
            "light": lambda s=sensor, m=motion: s.renderer.radiance(s.ellipsoids(m)),
            "tracking, both pictures": lambda s=sensor, a=rest, b=pressed: track(a, b, s.layout_px),
            "calibration": lambda s=sensor: _calibration(s),
        })  # fmt: skip


def _sites(counts: tuple[int, ...]) -> Iterator[Row]:
    for count in counts:
        sites = {"columns": count, "rows": count, "pitch_mm": 24.0 / count}
        changes = {f"reconstruction.sites.{key}": value for key, value in sites.items()}
        sensor = Sensor(load_scene("kamiyama_pillar", changes))
        found = track(sensor.picture(None), sensor.picture(sensor.press().load), sensor.layout_px)
        kept = _calibration(sensor)
        again = reconstruct(found, kept)
        yield from _timed("sites", count * count, {
            "calibration": lambda s=sensor: _calibration(s),
            "first frame": lambda s=sensor, f=found: reconstruct(f, _calibration(s)),
            "further frame": lambda f=found, c=kept, a=again: reconstruct(f, c, previous=a),
        })  # fmt: skip


def _calibration(sensor: Sensor) -> Any:
    compliance = sensor.nominal_compliance.to_points(sensor.nominal_markers.points, sensor.sites)
    return nominal_calibration(sensor, compliance)


def _pixels(widths: tuple[int, ...]) -> Iterator[Row]:
    from twin.world.picture.ccd import expose

    for width in widths:
        height = width * 3 // 4
        camera = {"width_px": width, "height_px": height, "focal_px": 1814.8 * width / 640}
        sensor = Sensor(load_scene("kamiyama_pillar", {f"camera.{key}": value for key, value in camera.items()}))
        motion = sensor.motion(sensor.press().load)
        light = sensor.renderer.radiance(sensor.ellipsoids(motion))
        rest, pressed = sensor.picture(None), sensor.picture(motion)
        yield from _timed("pixels", width * height, {
            "light": lambda s=sensor, m=motion: s.renderer.radiance(s.ellipsoids(m)),
            "CCD": lambda s=sensor, w=light: expose(w, s.nominal.ccd, np.random.default_rng(1), s.pattern),
            "tracking, both pictures": lambda s=sensor, a=rest, b=pressed: track(a, b, s.layout_px),
        })  # fmt: skip


def exponent(rows: Sequence[Row], of: str) -> float:
    """Return the power of the size that a column grows with, by least squares in log-log axes."""
    sizes, values = np.log([[row["size"], row[of]] for row in rows]).T
    return float(np.polyfit(sizes, values, 1)[0])


def _dataset(samples_per_shard: int) -> Scene:
    """Return what the cheapest samples are made of: truth without pictures or friction."""
    return load_scene(
        "dataset_kamiyama",
        {"dataset.columns": TRUTH, "dataset.samples_per_shard": samples_per_shard, **FRICTIONLESS},
    )


def _samples(counts: tuple[int, ...]) -> Iterator[Row]:
    for turn, count in enumerate((counts[0], *counts)):
        with tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder:
            started = time.process_time()
            create_dataset(_dataset(50), Path(folder) / "d", count)
            spent = time.process_time() - started
        if turn:  # the first one warms up
            yield {"axis": "samples", "size": count, "stage": "dataset, one process", "cpu_ms": 1e3 * spent}


def cluster() -> list[Row]:
    """Return what some nodes spend on datasets of two sizes, what of it a sample takes, and what many would do.

    A node spends a start and so much a sample, the head (client and scheduler) so much a sample for handing out and
    collecting: n nodes make ``samples_per_s`` n times one node's, as long as the head keeps up.
    """
    on_nodes(1, 4)  # what the head does once: imports, the body's files
    rows, starts, heads, alls = list[Row](), list[float](), list[float](), list[float]()
    few, many = ON_NODES
    for nodes in NODES:
        head, each = zip(*(on_nodes(nodes, samples) for samples in ON_NODES), strict=True)
        for k, samples in enumerate(ON_NODES):
            rows.append({"axis": "nodes", "size": nodes, "samples": samples, "head_cpu_s": head[k],
                         "nodes_cpu_s": [round(one, 2) for one in each[k]]})  # fmt: skip
        heads.append((head[1] - head[0]) / (many - few))
        alls.append((sum(each[1]) - sum(each[0])) / (many - few))
        starts.append((sum(each[0]) - few * alls[-1]) / nodes)
        told = {
            "all workers, a sample": alls[-1],
            "a worker, a sample of all": alls[-1] / nodes,
            "head, a sample": heads[-1],
        }
        rows += [{"axis": "workers", "size": nodes, "stage": s, "cpu_ms": 1e3 * spent} for s, spent in told.items()]
    head, node, start = (float(np.mean(of)) for of in (heads, alls, starts))
    most = node / head if head > 0 else float("inf")
    rows.append({"axis": "on paper", "start_s": start, "node_ms_a_sample": 1e3 * node,
                 "head_ms_a_sample": 1e3 * head, "nodes_kept_busy": most})  # fmt: skip
    for nodes in (1, 2, 10, 100):
        seconds = start + 1e5 * max(node / nodes, head)
        rows.append({"axis": "on paper", "size": nodes, "samples": 100_000, "seconds": seconds,
                     "share of ideal": 1e5 * node / nodes / seconds})  # fmt: skip
    return rows


def on_nodes(nodes: int, samples: int) -> tuple[float, list[float]]:
    """Return CPU seconds of the head (this process and the scheduler) and of each node for a dataset."""
    import psutil

    scene = _dataset(4)
    with (
        tempfile.TemporaryDirectory(prefix="twin-benchmark-") as folder,
        _cluster(nodes, Path(folder)) as (address, at),
    ):
        before, mine = [_spent(psutil.Process(pid)) for pid in at], time.process_time()
        create_dataset(scene, Path(folder) / "d", samples, scheduler=Scheduler(address=address))
        mine = time.process_time() - mine
        after = [_spent(psutil.Process(pid)) for pid in at]
    spent = [b - a for a, b in zip(before, after, strict=True)]
    return mine + spent[0], spent[1:]


def _spent(process: Any) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


@contextmanager
def _cluster(nodes: int, folder: Path) -> Iterator[tuple[str, list[int]]]:
    """Start a scheduler and nodes, each with a cache of its own; give its address and their process ids."""
    from distributed import Client

    told = folder / "scheduler.json"
    root = str(Path(twin.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": root, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    module = [sys.executable, "-m"]
    scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    running = [subprocess.Popen([*module, *scheduler, "--scheduler-file", str(told)], env=environment, **quiet)]  # type: ignore[call-overload]
    try:
        for _ in range(1200):
            if told.is_file():
                break
            time.sleep(0.1)
        for number in range(nodes):
            worker = ["distributed.cli.dask_worker", "--scheduler-file", str(told), "--no-nanny", "--nthreads", "1",
                      "--no-dashboard", "--local-directory", str(folder / f"node{number}")]  # fmt: skip
            own = {**environment, "TWIN_CACHE": str(folder / f"cache{number}")}
            running.append(subprocess.Popen([*module, *worker], env=own, **quiet))  # type: ignore[call-overload]
        address = json.loads(told.read_text())["address"]
        with Client(address, timeout=120) as client:  # type: ignore[no-untyped-call]
            client.wait_for_workers(nodes, timeout=240)  # type: ignore[no-untyped-call]
        yield address, [process.pid for process in running]
    finally:
        for process in running[::-1]:
            process.kill()
            process.wait()
