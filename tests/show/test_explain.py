"""The numbers of a run in sentences."""

import copy

from twin.show.explain import LIMITS, explain

SCORE = {
    "elastic": {"largest_displacement_mm": 0.3, "force_error": 5e-17, "contact_over_probe_radius": None},
    "tracking": {"sd_px": 0.02, "matched": 0.95, "gross": 3, "over_bound": 5.0, "markers": 100},
    "force": {"total_force_error": 0.25, "field_error": None, "centre_error_mm": 0.1},
    "reasons": {"elastic.contact_over_probe_radius": "the probe is flat"},
}
ONE_LAYER = "[material]\npoisson_ratio = 0.5\n[markers.dots]\ndepth_mm = 0.5\n"


def found(score: dict, scene: str = "") -> dict:
    return {one.key: one for one in explain(score, scene)}


def test_a_number_has_a_sentence_its_unit_and_a_verdict() -> None:
    by_key = found(SCORE)
    assert by_key["elastic.largest_displacement_mm"].sentence == "The marker that moves most moves by 0.3 mm."
    assert by_key["elastic.largest_displacement_mm"].verdict == ""
    assert by_key["force.centre_error_mm"].unit == "mm"
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
        if name == "unmatched":
            continue
        for value, verdict in ((good, "good"), (fair, "fair"), (fair + 1.0, "poor")):
            assert found({stage: {name: value}})[key].verdict == verdict


def test_what_is_not_defined_has_its_reason_and_round_off_is_zero() -> None:
    by_key = found(SCORE)
    assert by_key["elastic.contact_over_probe_radius"].sentence.endswith("not defined, as the probe is flat.")
    assert "force.field_error" not in by_key
    assert "off by 0 %" in by_key["elastic.force_error"].sentence


def test_one_layer_explains_an_uncertain_push_only_where_it_is_the_cause() -> None:
    assert "one layer" in found(SCORE, ONE_LAYER)["force.total_force_error"].sentence
    assert "one layer" not in found(SCORE, ONE_LAYER + "[markers.deep]\n")["force.total_force_error"].sentence
    soft = ONE_LAYER.replace("0.5\n[", "0.3\n[")
    assert "one layer" not in found(SCORE, soft)["force.total_force_error"].sentence
    right = copy.deepcopy(SCORE)
    right["force"]["total_force_error"] = 0.01
    assert "one layer" not in found(right, ONE_LAYER)["force.total_force_error"].sentence


def test_lines_begin_with_the_verdict_and_end_with_the_limit() -> None:
    text = [one.line() for one in explain(SCORE)]
    assert "fair  The tracker found 95 % of the markers in full view. (good: 98 % or more)" in text
    assert text[0].startswith("-     The marker that moves most")
