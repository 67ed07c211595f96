"""The full chain over several exposures of the same light."""

from __future__ import annotations

import numpy as np
import pytest
from small_sweep import small

from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.sweep.designs import designs_of
from twin.study.sweep.full import full
from twin.study.sweep.linear import linear, noise_of
from twin.study.sweep.loads import Bodies, pushes_of
from twin.study.sweep.view import view_of

METRICS = ("total_force_error", "fwhm_mm", "dip", "sd_px")
BODIES = Bodies()


def _figures(exposures: int, preset: str) -> dict[str, float]:
    sweep, design = _design(exposures, preset)
    return full(design, sweep, BODIES, pushes_of(design.body, sweep.loads, (2.0, 1.5), 1))[0]


def _design(exposures: int, preset: str) -> tuple[Sweep, Scene]:
    axes = {"markers.blue.depth_mm": [2.0], "markers.*.pitch_mm": [1.6], "ccd.preset": [preset]}
    loads = {"size_mm": 2.0, "pair_mm": 4.0, "presses": 1, "exposures": exposures}
    sweep, scene = small(axes=axes, loads=loads)
    return sweep, designs_of(sweep, scene).scene_of(0)


def test_without_noise_exposures_are_alike_and_leave_no_doubt() -> None:
    one, three = _figures(1, "ideal"), _figures(3, "ideal")
    for name in METRICS:
        assert three[name] == pytest.approx(one[name], rel=1e-9), name
    assert three["total_force_error_noise_se"] == pytest.approx(0.0, abs=1e-12)
    assert three["fwhm_noise_se_mm"] == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(one["total_force_error_noise_se"])
    assert np.isnan(one["fwhm_noise_se_mm"])


def test_noise_over_exposures_is_that_of_theory_and_its_standard_error_that_by_which_others_differ() -> None:
    few, many = _figures(4, "industrial"), _figures(8, "industrial")
    sweep, design = _design(8, "industrial")
    # were all exposures to share one zero, this would be less by the root of two
    assert many["noise_px"] == pytest.approx(np.median(noise_of(design, view_of(design), sweep)), rel=0.15)
    for name, left in (("total_force_error", "total_force_error_noise_se"), ("fwhm_mm", "fwhm_noise_se_mm")):
        assert 0.0 < few[left] < 0.5 * few[name]
        assert abs(few[name] - many[name]) < 4.0 * np.hypot(few[left], many[left]), name


def test_shifts_are_off_by_what_the_linear_information_says_where_shadows_pull_them() -> None:
    """Shadows of red markers move blue ones, 3.5 mm nearer to the surface, by more than noise; even light has none."""
    shadowed, even = ({"light.ambient": [ambient]} for ambient in (0.1, 1.0))
    off = {}
    for name, light in (("shadowed", shadowed), ("even", even)):
        sweep, scene = small(
            axes={"markers.blue.depth_mm": [1.2], "markers.red.depth_mm": [4.7], "markers.*.pitch_mm": [1.4], **light},
            derived={}, loads={"size_mm": 2.0, "pair_mm": 4.0, "presses": 2, "force_n": 1.0}, limits={"overlap": 1.0},
        )  # fmt: skip
        design = designs_of(sweep, scene).scene_of(0)
        pushes = pushes_of(design.body, sweep.loads, (2.0, 1.5), 1)
        told = linear(design, view_of(design), sweep, BODIES, pushes)[0]["sd_px"]
        seen = full(design, sweep, BODIES, pushes)[0]["sd_px"]
        assert told == pytest.approx(seen, rel=0.2), name
        off[name] = seen
    assert off["shadowed"] > 2.0 * off["even"]
