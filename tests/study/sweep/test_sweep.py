"""Sweeps end to end: the table, what a kill leaves, ranks, and the command."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w
from small_sweep import SET, TABLE, small

import twin
from benchmarks.sweep import ranked
from twin.errors import RecipeError
from twin.study.sweep import design_rows, fidelities, sweep_run
from twin.study.sweep.design_rows import Rows
from twin.study.sweep.sweep_report import write_report
from twin.study.sweep.sweep_run import Swept, run_sweep


def table(folder: Path) -> dict[str, list[object]]:
    """Return the table without the seconds, which are measured."""
    rows = pq.read_table(folder / "designs.parquet").to_pydict()
    return {k: [repr(v) for v in c] for k, c in rows.items() if "seconds" not in k}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep")
    done = run_sweep(*small(), folder)
    _, best = write_report(done, folder)
    assert [record["design"] for record in best] == done.order[:5].tolist()
    assert all(0.1 < record["two_point_mm"] < 100 and record["fidelity"] == "linear" for record in best)
    return folder


def test_every_design_is_a_row_with_its_figures(finished: Path) -> None:
    rows = pq.read_table(finished / "designs.parquet").to_pydict()
    assert rows["design"] == list(range(6))
    assert rows["status"] == ["ok"] * 6
    assert all(np.isfinite(v) and v > 0 for v in rows["linear_fwhm_mm"])
    width = dict(zip(zip(rows["markers.blue.depth_mm"], rows["markers.*.pitch_mm"], strict=True),
                     rows["linear_fwhm_mm"], strict=True))  # fmt: skip
    assert width[2.0, 1.2] < width[3.0, 1.8], "shallower and denser markers resolve more"
    lines = (finished / "designs.csv").read_text().splitlines()
    assert len(lines) == 7


def test_a_killed_sweep_resumes_to_the_same_table(finished: Path, tmp_path: Path) -> None:
    lines = (finished / "rows.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "rows.jsonl").write_bytes(b"".join(lines[:2]) + lines[2][:40])  # killed in the middle of the third
    (tmp_path / ".designs.parquet.1.part").write_bytes(b"half a file")
    done = run_sweep(*small(), tmp_path)
    assert "4 rows computed now" in " ".join(done.notes)
    assert table(tmp_path) == table(finished)
    assert not list(tmp_path.glob(".*.part"))


def command(sweep: Path, folder: Path, workers: str) -> subprocess.Popen[bytes]:
    """Start a sweep in a session of its own, so that a kill takes its workers too."""
    words = [sys.executable, "-m", "twin", "sweep", str(sweep), "--out", str(folder), "--workers", workers]
    environment = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parents[1])}
    return subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, start_new_session=True)


FULL = {"fidelity": ["closed", "linear", "full"], "confirm": {"full": 3}, "sensors": 1}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fidelity", "steps", "kills"),
    [({}, 40, (1, 33)), (FULL, 3, (6, 7, 8))],  # full: six linear rows, then pictures of one design after another
    ids=["linear", "pictures"],
)
def test_a_sweep_killed_at_any_time_resumes_to_the_same_table_on_any_number_of_workers(
    fidelity: dict[str, Any], steps: int, kills: tuple[int, ...], tmp_path: Path
) -> None:
    path, killed, whole = tmp_path / "mine.toml", tmp_path / "killed", tmp_path / "whole"
    axes = {"markers.*.pitch_mm": {"low": 1.2, "high": 1.8, "steps": steps}, "camera.focal_px": [1700.0, 1814.8]}
    path.write_text(tomli_w.dumps({**TABLE, "axes": axes, "derived": {}, **fidelity}))
    assert command(path, whole, "1").wait() == 0
    rows = killed / "rows.jsonl"
    for least in kills:
        running = command(path, killed, "2")
        while running.poll() is None and (not rows.is_file() or rows.read_bytes().count(b"\n") < least):
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
        assert not (killed / "designs.parquet").is_file(), "it was killed too late to test anything"
    assert command(path, killed, "2").wait() == 0
    assert table(killed) == table(whole)
    assert {row["status"] for row in pq.read_table(killed / "designs.parquet").to_pylist()} == {"ok"}
    for folder in ("shown", "best"):
        assert contents(killed / folder) == contents(whole / folder)


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of every file of a folder; none if it is not there."""
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*"))}


def test_rows_are_computed_once_whatever_the_order(finished: Path, tmp_path: Path) -> None:
    (tmp_path / "rows.jsonl").write_bytes((finished / "rows.jsonl").read_bytes())
    same = {"markers.blue.depth_mm": [3.0], "markers.*.pitch_mm": [1.8, 1.2]}
    done = run_sweep(*small(axes=same), tmp_path)
    assert not any("computed now" in note for note in done.notes), "both designs were in the sweep before"
    whole = pq.read_table(finished / "designs.parquet").to_pydict()
    assert done.columns["linear_fwhm_mm"].tolist() == [whole["linear_fwhm_mm"][5], whole["linear_fwhm_mm"][3]]


def test_a_changed_sensor_is_computed_anew(finished: Path, tmp_path: Path) -> None:
    (tmp_path / "rows.jsonl").write_bytes((finished / "rows.jsonl").read_bytes())
    sweep, scene = small(loads={"size_mm": 2.5, "pair_mm": 4.0, "presses": 2})
    done = run_sweep(sweep, scene, tmp_path)
    assert "6 rows computed now" in " ".join(done.notes)


def test_designs_that_cant_be_are_rows_with_their_reason(tmp_path: Path) -> None:
    changes = {"axes": {"markers.*.pitch_mm": [1.5], "camera.focal_px": [1814.8, 9000.0]}, "derived": {}}
    by_local = {"set": {**SET, "reconstruction.method": "local"}}
    done = run_sweep(*small(**changes, **by_local), tmp_path)
    assert done.status.tolist() == ["ok", "dropped"]
    assert "inside the picture" in done.error[1]
    lines, _ = write_report(done, tmp_path)
    assert lines[0].startswith("Confirm design 0 by pictures: "), "what is linear can't judge this method"
    kept = [json.loads(line)["row"]["status"] for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert sorted(kept) == ["dropped", "ok"]


def test_the_best_designs_are_scenes_and_the_page_has_no_outside(finished: Path) -> None:
    files = sorted((finished / "best").glob("*.toml"))
    assert len(files) == 5
    scene = twin.load_scene(files[0])
    assert scene.press is not None
    assert not scene.markers["red"].unsourced()
    page = (finished / "report.html").read_text()
    assert "http" not in page.split("</style>")[1]
    assert page.count("<svg") >= 5
    assert "Make design " in page
    assert "(asked: " in page
    assert "depth of blue (mm)" in page
    assert "error of the total force (%)" in page
    assert "two_point_mm" not in page.split("<details>")[0], "no key stands in a sentence"


def test_rows_and_pictures_that_are_damaged_are_none(finished: Path, tmp_path: Path) -> None:
    lines = (finished / "rows.jsonl").read_bytes().splitlines(keepends=True)
    wrong = json.dumps({"key": json.loads(lines[4])["key"], "row": {"x": 1}}).encode() + b"\n"
    (tmp_path / "rows.jsonl").write_bytes(b"".join(lines[:4]) + wrong + lines[5])
    assert "2 rows computed now" in " ".join(run_sweep(*small(), tmp_path).notes)
    (tmp_path / "shown").mkdir()
    (tmp_path / "shown" / "c.npz").write_bytes(b"no picture")
    assert Rows.shown(tmp_path, "c") is None
    assert Rows.shown(tmp_path, "a") is None


def test_a_full_disk_is_not_kept_as_a_designs_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    changes = {"axes": {"markers.blue.depth_mm": [2.0]}, "fidelity": ["linear"]}
    with monkeypatch.context() as patch:
        patch.setattr(fidelities, "linear", full)
        with pytest.raises(OSError, match="No space left"):
            run_sweep(*small(**changes), tmp_path)
    assert run_sweep(*small(**changes), tmp_path).failed == 0


def test_what_is_over_its_target_counts_ten_times_what_is_under_it(tmp_path: Path) -> None:
    targets = {"two_point_mm": 2.3, "resolution_gf": 0.09}
    done = run_sweep(*small(fidelity=["closed"], targets=targets), tmp_path)
    off = np.array([np.log(done.columns[f"closed_{name}"] / target) for name, target in targets.items()])
    assert (off > 0).any(axis=1).tolist() == (off < 0).any(axis=1).tolist() == [True, True], off
    np.testing.assert_allclose(done.score, np.where(off > 0, off, 0.1 * off).sum(axis=0))
    assert done.order.tolist() == np.argsort(done.score).tolist()
    dropped = run_sweep(*small(fidelity=["closed"], axes={"markers.*.diameter_mm": [1.6, 0.5]}, derived={}), tmp_path)
    assert (dropped.score[0], dropped.order.tolist()) == (np.inf, [1])
    del dropped.columns["closed_total_force_error"]  # as in the full chain, which has no two_point_mm
    (verdict, *_), _ = write_report(dropped, tmp_path)
    assert "Not judged at this fidelity: force error (asked: 5 %)." in verdict


def test_fronts_and_the_agreement_of_fidelities() -> None:
    front = Swept.front([np.array([1.0, 2.0, 3.0, np.nan]), np.array([3.0, 1.0, 2.0, 0.0])])
    assert front.tolist() == [True, True, False, False]
    rank, ratio, count = Swept.agreement(np.array([1.0, 2.0, 4.0, np.nan]), np.array([2.0, 4.0, 8.0, 1.0]))
    assert (rank, ratio, count) == (pytest.approx(1.0), 2.0, 3)


def test_a_search_finds_what_the_grid_does_not_have(tmp_path: Path) -> None:
    """Three axes, for which SciPy takes 32 designs a generation, not 24: all are counted."""
    axes = {"markers.blue.depth_mm": {"low": 1.0, "high": 5.0}, "markers.*.pitch_mm": {"low": 1.0, "high": 2.4}}
    axes["material.youngs_modulus_mpa"] = {"low": 0.5, "high": 1.0}
    changes = {"axes": axes, "fidelity": ["closed"], "sampling": "sobol", "count": 320, "loads": {"size_mm": 1.0}}
    sweep, scene = small(**changes, targets={"two_point_mm": 1.0})
    found = run_sweep(sweep, scene, tmp_path, optimise=True)
    random = run_sweep(sweep.model_copy(update={"sampling": "random", "count": 20}), scene, tmp_path)
    assert found.score[found.order[0]] <= random.score[random.order[0]]
    best = found.designs.values(int(found.order[0]))
    assert 256 < len(found.designs) <= 320, "the population takes four fifths, the gradient no more than the rest"
    assert [best[key] for key in axes][:2] == pytest.approx([1.0, 1.0])


@pytest.mark.slow
def test_the_closed_form_ranks_designs_as_the_linear_information_does() -> None:
    """Markers of the flat sensor at random depths, pitches and sizes."""
    rows = ranked("flat", 30)
    assert rows["two_point_mm"]["rank correlation"] > 0.8
    assert 0.85 < rows["two_point_mm"]["median"] < 1.15


def test_sites_that_hold_designs_back_are_said_and_rank_nothing(tmp_path: Path) -> None:
    coarse = {"size_mm": 1.0, "pair_mm": 2.0, "presses": 2}
    changes = {"loads": coarse, "axes": {"markers.*.pitch_mm": [1.5, 1.6]}, "derived": {}}
    done = run_sweep(*small(**changes), tmp_path)
    assert len(done.warnings) == 1
    assert "set reconstruction.sites.pitch_mm = 0.75" in done.warnings[0]
    assert "columns = 12 and rows = 9 (now 5 and 4) to cover the same 8 x 6 mm" in done.warnings[0]
    assert not any(note.startswith("least distance") for note in done.notes)
    write_report(done, tmp_path)
    assert "reconstruction.sites.pitch_mm = 0.75" in (tmp_path / "report.html").read_text()
    sweep, scene = small(**changes, targets={"two_point_mm": 4.0})
    assert sweep.loads.pair_mm == 2.0
    del coarse["pair_mm"]
    assert small(**changes, targets={"two_point_mm": 4.0})[0].loads.pair_mm == 4.0, "as far apart as asked"
    done = run_sweep(sweep, scene, tmp_path)
    assert not done.warnings, "fine enough sites need not be finer"
    assert "All of them reach the 4 mm wanted" in done.notes[0]


def test_one_axis_and_nothing_possible_still_make_a_page(tmp_path: Path) -> None:
    done = run_sweep(*small(axes={"markers.*.diameter_mm": [1.6]}, derived={}), tmp_path)
    (said,), best = write_report(done, tmp_path)
    assert not best
    assert said.startswith("None of 1 designs is possible: ")
    assert "markers.red: diameter of its pitch or more" in said
    assert "None of 1 designs is possible" in (tmp_path / "report.html").read_text()


def test_time_is_estimated_once_from_cpu_seconds_of_several_designs(tmp_path, monkeypatch):
    cpu = [0.0]

    folders = set()

    def row(scene: Any, view: Any, sweep: Any, bodies: Any, pushes: Any) -> tuple[dict[str, float], None]:
        cpu[0] += 2.0 if id(bodies) in folders else 5.0  # the first begins
        folders.add(id(bodies))
        return {}, None

    clock = SimpleNamespace(process_time=lambda: cpu[0], perf_counter=lambda: 0.0)
    monkeypatch.setattr(design_rows, "time", clock)
    monkeypatch.setattr(fidelities, "linear", row)
    monkeypatch.setattr("twin.study.batch.pool.cache_folder", lambda: tmp_path)
    told = sweep_run.estimate(*small(), workers=2)[-1][0]
    assert "6 designs, about 9 s with 2 workers" in told
    assert "2 s of CPU a design (an estimate from 4 designs), 3 s to begin" in told
    alone = sweep_run.estimate(*small(axes={"markers.*.pitch_mm": [1.5]}, derived={}))[-1][0]
    assert "1 design, about 5 s with 1 worker," in alone
    spent = cpu[0]
    again = sweep_run.estimate(*small(), workers=2)[-1][0]
    assert "2 s of CPU a design (an estimate from 4 designs, made before), 3 s to begin" in again
    assert cpu[0] == spent
    sensors: list[int] = []

    def pictured(scene: Any, few: Any, bodies: Any, pushes: Any) -> tuple[dict[str, float], dict[str, Any]]:
        sensors.append(few.sensors)
        return {}, row(scene, None, few, bodies, pushes)[1] or {}

    monkeypatch.setattr(fidelities, "full", pictured)
    told = sweep_run.estimate(*small(fidelity=["full"], sensors=5, confirm={"full": 2}), workers=1)[-1][0]
    assert "6 designs, about 150 s" in told, "all take the first fidelity: 6 times 5 times 5, with what begins"
    assert sensors == [1]


def test_the_command_says_what_it_would_do(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps({**TABLE, "axes": {"markers.*.pitch_mm": [1.5, 1.8]}}))
    environment = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parents[1])}
    said = subprocess.run(
        [sys.executable, "-m", "twin", "sweep", str(path), "--dry-run"], capture_output=True, text=True, check=False,
        env=environment,
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    assert "designs     2 (grid)" in said.stdout


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": {"material.law": ["linear", "yeoh"]}}, "set loads.probe = true and fidelity"),
        ({"loads": {"probe": True, "shear": 0.0}}, "only the full chain presses a probe"),
        ({"loads": {"probe": True}, "fidelity": ["full"]}, "the probe would slide, as press.friction = 0"),
    ],
)
def test_loads_that_a_fidelity_does_not_have_are_refused_with_a_remedy(changes, words) -> None:
    with pytest.raises(RecipeError, match=words):
        sweep_run.estimate(*small(**changes))
