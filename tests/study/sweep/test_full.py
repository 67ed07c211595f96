"""The full chain over several exposures of the same light; two pillars 2 mm apart are told apart."""

import warnings
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_sweep import small

import twin
import twin.sense.reconstruct as solve
from twin.judge.resolution import DIP, dip
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep
from twin.study.doubts import View
from twin.study.sweep import fidelities
from twin.study.sweep.designs import Designs
from twin.study.sweep.fidelities import cost, full, linear
from twin.study.sweep.loads import Bodies, Pushes
from twin.world.picture import ccd
from twin.world.picture.render import Renderer

METRICS = ("total_force_error", "fwhm_mm", "dip", "sd_px")
BODIES = Bodies()


def _figures(exposures: int, preset: str) -> dict[str, float]:
    sweep, design = _design(exposures, preset)
    return full(design, sweep, BODIES, Pushes.of(design.body, sweep.loads, (2.0, 1.5), 1))[0]


def _design(exposures: int, preset: str) -> tuple[Sweep, Scene]:
    axes = {"markers.blue.depth_mm": [2.0], "markers.*.pitch_mm": [1.6], "ccd.preset": [preset]}
    loads = {"size_mm": 2.0, "pair_mm": 4.0, "presses": 1, "exposures": exposures}
    sweep, scene = small(axes=axes, loads=loads)
    return sweep, Designs.of(sweep, scene).scene_of(0)


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
    pushes = Pushes.of(design.body, sweep.loads, (2.0, 1.5), 1)
    expected = linear(design, View.of(design), sweep, BODIES, pushes)[0]["noise_px"]
    # were all exposures to share one zero, this would be less by the root of two
    assert many["noise_px"] == pytest.approx(expected, rel=0.15)
    for name, left in (("total_force_error", "total_force_error_noise_se"), ("fwhm_mm", "fwhm_noise_se_mm")):
        assert 0.0 < few[left] < 0.5 * few[name]
        # Student's t of the three degrees that four exposures have exceeds 5.84 in 1 of 100
        assert abs(few[name] - many[name]) < 5.84 * np.hypot(few[left], many[left]), name


def test_the_cost_of_a_design_is_estimated_from_one_exposure(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that only light, exposures and reconstructions move on, so that no other work counts."""
    clock = [0.0]

    def costly(function: Callable[..., Any], cpu_s: float) -> Callable[..., Any]:
        def counted(*arguments: Any, **options: Any) -> Any:
            clock[0] += cpu_s
            return function(*arguments, **options)

        return counted

    monkeypatch.setattr(fidelities, "time", SimpleNamespace(process_time=lambda: clock[0]))
    for owner, name, cpu_s in ((Renderer, "radiance", 7.0), (ccd, "expose", 1.0), (solve, "reconstruct", 3.0)):
        monkeypatch.setattr(owner, name, costly(getattr(owner, name), cpu_s))
    sweep, design = _design(4, "industrial")
    pushes = Pushes.of(design.body, sweep.loads, (2.0, 1.5), 1)
    told = cost(design, sweep, BODIES, pushes)
    estimated = clock[0]
    full(design, sweep, BODIES, pushes)
    assert told["cpu_s"] == pytest.approx(clock[0] - estimated)


# --- the designs that sweeps found tell two pillars 2 mm apart, through contact, pictures and tracker


def dip_of(name: str) -> float:
    scene = twin.load_scene(name)
    sites = scene.reconstruction.sites
    with warnings.catch_warnings():  # a shipped scene reaches what it asks
        warnings.simplefilter("error", twin.AccuracyWarning)
        estimate = twin.run(scene, want={"forces"}).estimate
    push = estimate.force_n[:, 2].reshape(sites.columns, sites.rows)[:, sites.rows // 2]
    return dip(sites.axes()[0], push, 2.0)


@pytest.mark.slow
@pytest.mark.parametrize("body", ["kamiyama", "sato"])
def test_two_pillars_two_millimetres_apart_are_two(body: str) -> None:
    assert dip_of(f"{body}_two_points") >= DIP
