"""Results as text and sentences, in notebooks, as drawings and as tables."""

import copy
import re
import sys
from operator import methodcaller
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import twin
from twin.results import Estimate, RunResult, Truth
from twin.sense.reconstruct import Field
from twin.show.explain import LIMITS, explain
from twin.show.report import report
from twin.show.reproduction_page import Panel


def run_result(*, forces: bool = True) -> RunResult:
    """Return a made-up run: 3 by 3 markers and sites, 2 N on the middle one."""
    x, y = (a.ravel() for a in np.meshgrid([-2.0, 0.0, 2.0], [-2.0, 0.0, 2.0]))
    places = np.column_stack([x, y, np.zeros(9)])
    force = np.zeros((9, 3))
    force[4, 2] = 2.0
    pixels = 50 + 10 * places[:, :2]
    total, none = np.array([0.0, 0.0, 2.0]), np.zeros((0, 2))
    truth = Truth(
        marker_rest_mm=places,
        marker_displacement_mm=0.01 * places,
        marker_layer=np.repeat(["red", "blue", "dots"], 3),
        marker_rest_px=pixels,
        marker_pressed_px=pixels,
        marker_outline_rest_px=none,
        marker_outline_pressed_px=none,
        marker_visible=np.ones(9, bool),
        surface_mm=np.array([[0.3, 0.0, 0.0], [-0.3, 0.0, 0.0]]),
        surface_force_n=np.array([[0.0, 0.0, 1.5], [0.0, 0.0, 0.5]]),
        total_force_n=total,
        total_torque_nmm=np.zeros(3),
    )
    shift = 0.01 * (pixels - 50)
    shift[0] = np.nan
    estimate = Estimate(
        marker_rest_px=pixels,
        marker_shift_px=shift,
        marker_sd_px=np.full(len(shift), 0.01),
        marker_state=np.array(["seen"] * len(shift)),
        site_mm=places if forces else np.zeros((0, 3)),
        force_n=force if forces else np.zeros((0, 3)),
        total_force_n=total,
        total_torque_nmm=np.zeros(3),
        sd_force_n=0.1 + 0.0 * force if forces else np.zeros((0, 3)),
        sd_total_n=np.array([0.01, 0.01, 0.04]),
        sd_torque_nmm=np.zeros(3),
    )
    score = {"tracking": {"sd_px": 0.0123}, "force": {"total_force_error": 0.021, "centre_error_mm": None}}
    return RunResult(scene_toml="", truth=truth, estimate=estimate, score=score)


def in_notebook(result) -> str:
    """Return what a notebook shows of a result."""
    shown = methodcaller("_repr_html_")(result)
    assert isinstance(shown, str)
    return shown


def test_a_result_says_in_a_line_what_it_came_to() -> None:
    result = run_result()
    assert repr(result) == "RunResult(true force (0, 0, 2) N, marker noise 0.012 px, total force error 2.1 %)"
    total = "(0, 0, 2) +- (0.01, 0.01, 0.04) N"
    assert repr(result.estimate) == f"Estimate(markers 8 of 9 seen, sites 9, total force {total})"
    assert repr(result.truth) == "Truth(markers 9, pieces pressed 2, total force (0, 0, 2) N)"
    for part in (result.truth, result.estimate):
        assert "total force" in in_notebook(part)
    assert repr(RunResult(scene_toml="")) == "RunResult()"
    assert "total force error" in in_notebook(result)


def test_a_scene_and_its_sensor_name_body_markers_and_camera() -> None:
    scene = twin.load_scene("gelpad_press")
    assert repr(scene) == str(scene)
    for word in ("25 x 25 x 4 mm", "143 dots 0.5 mm deep", "640 x 480 px", "sphere"):
        assert word in repr(scene)
        assert word in in_notebook(scene)
    assert repr(twin.Sensor(scene)) == f"Sensor({scene!r})"


def test_true_forces_are_summed_into_the_sites() -> None:
    result = run_result()
    summed = result.truth.force_at(result.estimate.site_mm)
    np.testing.assert_array_equal(summed, result.estimate.force_n)


def test_a_run_is_drawn_in_three_panels_of_one_scale() -> None:
    motion, recovered, true = run_result().plot()
    assert "times as long" in motion.get_title()
    assert [text.get_text() for text in motion.get_legend().get_texts()] == ["red layer", "blue layer", "dots layer"]
    scales = [panel.collections[0].get_clim() for panel in (recovered, true)]
    assert scales == [(-2.0, 2.0), (-2.0, 2.0)]
    assert recovered.get_title() == "recovered forces"
    panel = Panel.field("least norm", run_result().estimate, 1.0)
    page = Panel.svg([panel])
    assert page.count(b">least norm<") == 1, "titles lay over one another"
    wide = re.compile(rb'<svg[^>]* width="([^"]+)"')
    assert wide.search(Panel.svg([panel, panel]))[1] == wide.search(page)[1], "on a phone words were 4 px high"
    assert len(run_result(forces=False).plot()) == 2
    with pytest.raises(twin.TwinError, match="neither marker motion nor forces"):
        RunResult(scene_toml="").plot()


def test_a_found_layout_is_named_and_ringed() -> None:
    row, column = np.mgrid[:120, :160]
    rest = np.where(np.hypot((row + 10) % 20 - 10, (column + 10) % 20 - 10) < 4, 40, 180).astype(np.uint8)
    found = twin.find_layout(rest)
    for word in ("black", "35 dark dots", "7 columns x 5 rows", "square", "pitch 20 px"):
        assert word in repr(found)
        assert word in in_notebook(found)
    ax = Figure().subplots()
    assert found.plot(ax, rest) is ax
    np.testing.assert_array_equal(np.transpose(ax.lines[0].get_data()), found.layers["black"].centre_px)
    assert len(ax.images) == 1
    assert "35 markers" in ax.get_legend().get_texts()[0].get_text()


def test_arrows_are_at_most_a_pitch_and_a_half_long() -> None:
    panel = run_result(forces=False).plot()[0]
    arrows = [drawn for drawn in panel.collections if hasattr(drawn, "U")]
    longest = max(float(np.hypot(a.U, a.V).max()) for a in arrows)
    assert 6.0 < longest <= 20.0  # the markers are 20 px apart, their mean share of the area is 13 px


def test_a_state_is_drawn_patch_by_patch_and_tabulated() -> None:
    sensor = twin.Sensor(twin.load_scene("block_bare", {"accuracy.contact_patches": 8}))
    state = sensor.press(twin.Press(probe=twin.Sphere(diameter_mm=6), force_n=(0, 0, 1)))
    assert repr(state).startswith("ContactState(force (0, 0, 1) N, indentation ")
    patches = len(state.pressure_mpa)
    assert repr(state.load) == f"Load({patches} patches with (0, 0, 1) N)"
    twist = twin.Traction.twist(centre_mm=(1, 0), radius_mm=2, torque_nmm=3)
    assert repr(twist) == "Load(twist at (1, 0) mm with 3 N mm)"
    number = r"[\d.e-]+ %"
    shares = f"force {number}, indentation {number}, traction {number}, markers {number}"
    assert re.fullmatch(rf"PressError\({shares}\)", repr(state.error))
    ax = Figure().subplots()
    assert state.plot(ax) is ax
    assert len(ax.collections[0].get_paths()) == len(state.pressure_mpa)
    table = state.columns()
    areas = 4 * state.patches.half_mm.prod(axis=1)
    np.testing.assert_allclose((table["pressure_mpa"] * areas).sum(), 1.0, rtol=1e-6)


def test_tables_need_pandas_and_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = run_result().truth
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(twin.TwinError, match="pip install pandas"):
        truth.to_pandas()
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    assert list(truth.to_pandas()) == list(truth.columns())


def test_run_takes_a_name_with_overrides_and_names_the_nearest(tmp_path) -> None:
    result = twin.run("first_press", {"displacement"}, overrides={"press.force_n": {"z": 1.5}})
    assert result.cpu_s.keys() == result.timings.keys()
    assert result.cpu_s["contact"] > 0
    np.testing.assert_allclose(result.truth.total_force_n, [0, 0, 1.5], atol=1e-9)
    with pytest.raises(twin.TwinError, match="did you mean 'first_press'"):
        twin.run("first_pres")
    with pytest.raises(twin.TwinError, match="did you mean 'poisson_ratio'"):
        twin.run("first_press", overrides={"material.poison_ratio": 0.3})
    with pytest.raises(twin.TwinError, match="overrides belong to"):
        twin.run(twin.load_scene("first_press"), overrides={"seed": 2})


SCORE = {
    "elastic": {"largest_displacement_mm": 0.3, "force_error": 5e-17, "contact_over_probe_radius": None},
    "tracking": {"sd_px": 0.02, "matched": 0.95, "gross": 3, "over_bound": 5.0, "markers": 100},
    "force": {"total_force_error": 0.25, "field_error": None, "centre_error_mm": 0.1},
    "reasons": {"elastic.contact_over_probe_radius": "the probe is flat"},
}


def found(score: dict, scene: str = "") -> dict:
    return {one.key: one for one in explain(score, scene)}


def test_a_number_has_a_sentence_its_unit_and_a_verdict() -> None:
    by_key = found(SCORE)
    assert by_key["elastic.largest_displacement_mm"].sentence == "The marker that moves most moves by 0.3 mm."
    assert by_key["elastic.largest_displacement_mm"].verdict == ""
    assert by_key["force.centre_error_mm"].unit == "mm"
    assert (by_key["tracking.matched"].unit, by_key["tracking.over_bound"].unit) == ("1", "")
    page = report(RunResult(scene_toml="", score=SCORE))
    for shown in (">5</data>", ">95 %</data>", ">0.1 mm</data>", ">3</data>"):
        assert shown in page, "in the units of its sentences"
    verdicts = {key: one.verdict for key, one in by_key.items() if one.verdict}
    assert verdicts == {
        "elastic.force_error": "good",
        "tracking.matched": "fair",
        "tracking.sd_px": "good",
        "tracking.over_bound": "poor",
        "tracking.gross": "poor",
        "force.total_force_error": "poor",
        "force.centre_error_mm": "good",
    }


def test_verdicts_change_at_the_printed_limits() -> None:
    for key, (good, fair) in LIMITS.items():
        stage, name = key.split(".")
        if name == "matched":
            continue
        for value, verdict in ((good, "good"), (fair, "fair"), (fair + 1.0, "poor")):
            assert found({stage: {name: value}})[key].verdict == verdict


def test_what_is_not_defined_has_its_reason_and_round_off_is_zero() -> None:
    by_key = found(SCORE)
    assert by_key["elastic.contact_over_probe_radius"].sentence.endswith("not defined, as the probe is flat.")
    assert "force.field_error" not in by_key
    assert "off by 0 %" in by_key["elastic.force_error"].sentence


def test_large_strain_is_left_out_only_by_the_linear_law() -> None:
    score = {"elastic": {"linearisation_error": 0.03}}
    left_out, included = (
        found(score, f'[material]\nlaw = "{law}"\n')["elastic.linearisation_error"] for law in ("linear", "yeoh")
    )
    assert (left_out.verdict, included.verdict) == ("fair", "")
    assert "leaves out" in left_out.sentence
    assert "which is included" in included.sentence


def pushed(sideways_n: float, push_n: float, sd_n: tuple[float, float, float]) -> Field:
    """Return a field of nothing but totals."""
    none = np.zeros((0, 3))
    return Field(
        site_mm=none, force_n=none, sd_force_n=none, used=np.zeros(0, bool), wrong=np.zeros(0, bool),
        total_force_n=np.array([sideways_n, 0.0, push_n]), total_torque_nmm=np.zeros(3),
        sd_total_n=np.array(sd_n), sd_torque_nmm=np.zeros(3),
        weight=1.0, noise_px=0.01, method="smooth",
    )  # fmt: skip


def test_one_layer_is_named_only_where_it_leaves_the_push_uncertain() -> None:
    unsure = pushed(0.0, 0.045, (0.001, 0.001, 0.006))
    assert "one layer of dots" in unsure.one_layer(np.array(["dots", "dots"]))
    assert unsure.one_layer(np.array(["red", "blue"])) == ""
    for sure in (
        pushed(0.0, 0.045, (0.001, 0.001, 0.002)),
        pushed(0.5, 0.045, (0.001, 0.001, 0.006)),
        pushed(0.0, 0.045, (0.004, 0.004, 0.006)),
    ):
        assert sure.one_layer(np.array(["dots"])) == ""


def test_a_cause_is_explained_beside_the_stated_error() -> None:
    score = copy.deepcopy(SCORE)
    score["force"]["total_force_stated"] = 0.2
    assert "uncertain" not in found(score)["force.total_force_stated"].sentence
    score["facts"] = {"one_layer": "one layer of dots"}
    assert "is uncertain: one layer of dots." in found(score)["force.total_force_stated"].sentence


def test_lines_begin_with_the_verdict_and_end_with_the_limit() -> None:
    text = [one.line() for one in explain(SCORE)]
    assert "fair  The tracker found 95 % of the markers in full view. (good: 98 % or more)" in text
    assert text[0].startswith("-     The marker that moves most")
