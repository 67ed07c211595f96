"""The main job writes what is wanted and nothing else, and survives pictures that show nothing."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from twin.errors import RecipeError, SomeFailed
from twin.results import RESULT_FILES, Estimate, RunResult, Truth
from twin.sense.track import Found
from twin.study.calibrate import calibration_of
from twin.study.run import run_to_folder

SMALL = {
    "camera.width_px": 160, "camera.height_px": 120, "camera.focal_px": 450,
    "markers.red.columns": 7, "markers.red.rows": 5, "markers.blue.columns": 6, "markers.blue.rows": 4,
    "reconstruction.sites.columns": 5, "reconstruction.sites.rows": 4,
}  # fmt: skip
"""A picture that even the slowest renderer makes at once."""


@pytest.mark.parametrize(
    ("want", "files"),
    [
        ({"displacement"}, {"truth.npz"}),
        ({"picture"}, {"rest.png", "pressed.png"}),
        ({"tracking"}, {"estimate.npz"}),
        ({"score"}, {"score.json"}),
        ({"report"}, {"report.html"}),
    ],
)
def test_only_wanted_files_are_written_and_old_ones_removed(want: set[str], files: set[str], tmp_path: Path) -> None:
    for name in RESULT_FILES:
        (tmp_path / name).write_text("of an earlier run")
    (tmp_path / "mine.txt").write_text("kept")
    run_to_folder(twin.load_scene("kamiyama_pillar", SMALL), tmp_path, want)
    assert {p.name for p in tmp_path.iterdir()} == files | {"scene.toml", "timings.json", "mine.txt"}


def test_a_picture_without_markers_leaves_truth_and_says_why(tmp_path: Path) -> None:
    scene = twin.load_scene("kamiyama_pillar", {**SMALL, "camera.width_px": 4, "camera.height_px": 4})
    with pytest.raises(SomeFailed) as failed:
        run_to_folder(scene, tmp_path, {"displacement", "picture", "tracking", "score"})
    assert "force       failed: only 0 of 59 markers were found" in str(failed.value)
    assert (tmp_path / "truth.npz").is_file()
    assert '"force": null' in (tmp_path / "score.json").read_text()


def test_the_estimate_states_every_marker_s_deviation_and_what_became_of_it() -> None:
    estimate = twin.run(twin.load_scene("kamiyama_pillar", SMALL), want={"tracking"}).estimate
    seen = np.isfinite(estimate.marker_shift_px[:, 0])
    assert len(seen) == len(estimate.marker_sd_px) == len(estimate.marker_state)
    np.testing.assert_array_equal(np.isfinite(estimate.marker_sd_px), seen)
    assert set(estimate.marker_state[seen]) <= {"seen", "strained", "partly hidden"}
    assert not set(estimate.marker_state[~seen]) & {"seen"}


@pytest.fixture(scope="module")
def truth() -> Truth:
    return twin.run(twin.load_scene("kamiyama_pillar", SMALL), want={"displacement"}).truth


def test_truth_is_what_the_design_page_says(truth: Truth) -> None:
    n, m = len(truth.marker_layer), len(truth.surface_mm)
    assert truth.marker_rest_mm.shape == truth.marker_displacement_mm.shape == (n, 3) == (59, 3)
    assert truth.marker_rest_px.shape == truth.marker_pressed_px.shape == (n, 2)
    assert truth.surface_force_n.shape == (m, 3)
    np.testing.assert_allclose(truth.surface_force_n.sum(axis=0), truth.total_force_n, atol=1e-6)
    np.testing.assert_allclose(truth.total_force_n, [0, 0, 3], atol=1e-6)


def test_a_push_moves_markers_outwards_and_a_shift_along_y_moves_them_up(truth: Truth) -> None:
    outward = np.einsum("ni,ni->n", truth.marker_rest_mm[:, :2], truth.marker_displacement_mm[:, :2])
    assert (outward[np.linalg.norm(truth.marker_rest_mm[:, :2], axis=1) > 1] > 0).all()
    sensor = twin.Sensor(twin.load_scene("kamiyama_pillar", SMALL))
    motion = sensor.motion(twin.Traction.disk((0, 0), 4, (0, 1, 0)))
    moved = sensor.project(sensor.actual.markers.points + motion.displacement_mm)
    assert (moved - sensor.project(sensor.actual.markers.points))[:, 1].max() < 0


def test_loads_add() -> None:
    one, two = twin.Traction.disk((0, 0), 1, (0, 0, 1)), twin.Traction.disk((1, 0), 1, (0, 0, 2))
    assert sum([one, two]) == one + two
    with pytest.raises(TypeError):
        one + 1


def test_a_calibration_file_is_looked_for_beside_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "mine.npz").write_bytes(b"")
    recipe = tmp_path / "mine.toml"
    recipe.write_text('base = "sato_press"\n[calibration]\nfile = "mine.npz"\n')
    assert twin.load_scene(recipe).calibration.file == str(tmp_path / "mine.npz")
    recipe.write_text('base = "sato_press"\n[calibration]\nfile = "none.npz"\n')
    with pytest.raises(RecipeError, match=r"calibration\.file = 'none\.npz'"):
        twin.load_scene(recipe)


def test_a_run_states_what_linearity_costs_under_this_very_press(tmp_path: Path) -> None:
    """Another code finds 0.8 % under a 5 mm pillar with a sharp rim at 3 N (tests/reference/neohooke.json)."""
    for force, hard in ((3.0, True), (0.05, False)):
        scene = twin.load_scene("kamiyama_pillar", {**SMALL, "press.force_n.z": force})
        summary = run_to_folder(scene, tmp_path, {"score"})
        elastic = json.loads((tmp_path / "score.json").read_text())["elastic"]
        assert "contact error" in json.loads((tmp_path / "timings.json").read_text())
        assert summary.count("note        linear theory is") == 1
        assert "-s material.law=neo_hookean" in summary
        assert "warning     linear" not in summary
        assert re.search(r"^time        [\d.]+ s", summary, re.MULTILINE)
        if hard:
            assert elastic["linearisation_error"] == pytest.approx(0.0083, rel=0.1)
        else:
            assert elastic["linearisation_error"] < 1e-3
        assert elastic["largest_strain"] == pytest.approx(force / 3.0 * 0.05, rel=0.3)
        assert elastic["largest_turn_deg"] > 0
        assert elastic["contact_over_probe_radius"] is None


def test_where_linearity_cannot_be_measured_the_estimate_is_labelled(tmp_path: Path) -> None:
    hard = {**SMALL, "press.force_n.z": 6.0, "press.friction": float("inf")}
    summary = run_to_folder(twin.load_scene("kamiyama_pillar", hard), tmp_path, {"score"})
    assert "warning     linear theory may be" in summary
    assert "press with less force" in summary
    validity = json.loads((tmp_path / "score.json").read_text())["facts"]["validity"]
    assert re.match(r"estimated: press.friction = inf", validity["linearisation_basis"])


def test_linearity_is_not_measured_where_no_score_is_wanted(tmp_path: Path) -> None:
    run_to_folder(twin.load_scene("kamiyama_pillar", SMALL), tmp_path, {"displacement"})
    assert "linearity" not in json.loads((tmp_path / "timings.json").read_text())


def test_a_step_that_is_refused_leaves_the_state_before_it(tmp_path: Path) -> None:
    from twin.errors import ContactError, SomeFailed
    from twin.world.contact.contact_state import ContactState

    path = [{"force_n": {"z": 0.5}}, {"force_n": {"x": 5.0, "z": 0.5}}]
    scene = twin.load_scene("kamiyama_pillar", {**SMALL, "press.friction": 0.5, "press.steps": path})
    with pytest.raises(SomeFailed, match=r"step 2 of 2 was refused.*friction.*what belongs to that state is in"):
        run_to_folder(scene, tmp_path, {"displacement", "score"})
    with np.load(tmp_path / "truth.npz") as truth:
        np.testing.assert_allclose(truth["total_force_n"], [0, 0, 0.5], atol=1e-8)
    assert "step 2 of 2" in json.loads((tmp_path / "score.json").read_text())["facts"]["contact"]["incomplete"]
    with pytest.raises(ContactError, match="friction") as refused:
        twin.run(scene, {"displacement"})
    assert isinstance(refused.value.last_state, ContactState)
    with pytest.raises(ContactError, match="friction"):  # the first step: nothing to keep
        run_to_folder(twin.load_scene("kamiyama_pillar", {**SMALL, "press.friction": 0.5, "press.steps": path[1:]}),
                      tmp_path / "none", {"displacement"})  # fmt: skip


def test_two_points_are_in_the_truth() -> None:
    result = twin.run(twin.load_scene("two_points"), {"displacement"})
    np.testing.assert_allclose(result.truth.total_force_n, [0, 0, 1.0], atol=1e-7)
    left = result.truth.surface_mm[:, 0] < 0
    assert result.truth.surface_force_n[left, 2].sum() == pytest.approx(0.5, abs=1e-7)
    assert len(result.touches) == 2


@pytest.mark.parametrize("name", ["sato_press", "sato_paper"])
def test_shipped_calibrations_are_of_the_scenes_that_name_them(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A new key of a scene must not make them look like another sensor's: calibrating again takes minutes."""
    monkeypatch.setattr("twin.study.sensor.Sensor.press", None)
    scene = twin.load_scene(name)
    found = calibration_of(twin.Sensor(scene))
    with np.load(scene.calibration.file) as kept:
        assert json.loads(str(kept["provenance"])) == found.facts


def test_the_shipped_calibration_knows_its_load_cell() -> None:
    """A push such as the first press of the middle place is as far off as that press's reading, along any axis."""
    scene = twin.load_scene("sato_press")
    found = calibration_of(twin.Sensor(scene))
    push = np.zeros((len(found.site_mm), 3))
    push[len(push) // 2, 2] = scene.calibration.press_force_n
    stated = np.linalg.norm(found.by_load_cell @ push.ravel())
    assert stated == pytest.approx(scene.calibration.load_cell_n, rel=0.1)


def test_a_stored_calibration_is_of_the_accuracy_that_is_asked_for() -> None:
    """Two recipes of different accuracy shared one."""
    one_place = {"columns": 1, "rows": 1, "pitch_mm": 1.0}
    changed = {"calibration.presses": one_place, "reconstruction.sites": one_place, "renderer": "splat"}

    def transfer(patches: int) -> np.ndarray:
        keys = {**changed, "calibration.method": "sato", "accuracy.contact_patches": patches}
        return calibration_of(twin.Sensor(twin.load_scene("gelpad_press", keys))).transfer

    coarse, fine, again = transfer(8), transfer(12), transfer(8)
    np.testing.assert_array_equal(coarse, again)
    assert np.abs(coarse - fine).max() > 1e-6


TRACKING = {"sd_px": 0.01, "matched": 1.0, "markers": 200}
FORCE = {
    "total_force_error": 0.055,
    "total_force_stated": 0.061,
    "sites_force_error": 0.2,
    "centre_error_mm": 0.0315,
    "field_error": 0.44,
    "field_stated": 0.51,
}


def summary_of(sites: list[float], **facts: str) -> str:
    force = np.array([[0.0, 0.0, push] for push in sites])
    estimate = Estimate(
        marker_rest_px=np.zeros((0, 2)),
        marker_shift_px=np.zeros((0, 2)),
        marker_sd_px=np.zeros(0),
        marker_state=np.zeros(0, str),
        site_mm=np.zeros((len(sites), 3)),
        force_n=force,
        total_force_n=np.array([0.0, 0.0, -0.045]),
        total_torque_nmm=np.zeros(3),
        sd_force_n=np.zeros_like(force),
        sd_total_n=np.array([0.001, 0.001, 0.002]),
        sd_torque_nmm=np.zeros(3),
    )
    score = {"tracking": TRACKING, "force": FORCE}
    return RunResult(scene_toml="", estimate=estimate, score=score, facts=facts, timings={"tracking": 1.0}).summary()


def test_total_centre_and_field_are_printed() -> None:
    text = summary_of([0.005, -0.05])
    for figure in ("5.5 % off, 6.1 % stated", "0.0315 mm off", "44 % off, 51 % stated"):
        assert figure in text
    assert "sites' sum" not in text, "without bounds it is the total"
    assert "warning" not in text
    assert "Fz -0.045 ± 0.002 N\n" in text
    assert "push" not in text


def test_a_push_that_one_layer_hardly_shows_is_explained() -> None:
    line = "push        uncertain, as ± says: one layer of dots"
    assert line in summary_of([-0.045], one_layer="one layer of dots")


def test_under_bounds_both_totals_are_printed() -> None:
    text = summary_of([0.5, 0.187])
    assert "0.687 N" in text
    assert "-0.045 ± 0.002 N, solved without bounds" in text


def test_few_markers_are_warned_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nearly_blind(*given: Any, **options: Any) -> Found:
        found = track(*given, **options)
        return replace(found, shift_px=np.where(np.arange(59)[:, None] == 20, found.shift_px, np.nan))

    track = twin.track
    monkeypatch.setattr("twin.sense.track.track", nearly_blind)
    with pytest.raises(SomeFailed) as failed:
        run_to_folder(twin.load_scene("kamiyama_pillar", SMALL), tmp_path, {"tracking", "score"})
    text = str(failed.value)
    assert re.search(r"warning     only 1 of the \d+ markers in full sight .* \(of all, \d+ [a-z]+", text)
    assert "tracking    no SD" in text
