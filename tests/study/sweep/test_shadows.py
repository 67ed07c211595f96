"""Shadows of neighbours: what the linear information says of them is what the tracker does in pictures."""

from __future__ import annotations

import numpy as np
import pytest
from small_sweep import small

from twin.arrays import Floats
from twin.parts.scene import Scene
from twin.sense.track import analyse_rest, track_frame
from twin.study.motion import Motion
from twin.study.sensor import Sensor
from twin.study.sweep.designs import designs_of
from twin.study.sweep.shadows import shadows_of
from twin.study.sweep.view import view_of


def _scene(**changes: float) -> Scene:
    """Layers 3.3 mm apart: the shadows of red markers fall on the rims of blue ones."""
    axes = {"markers.blue.depth_mm": [1.2], "markers.red.depth_mm": [4.5], "markers.*.pitch_mm": [1.6]}
    more = {"markers.*.diameter_mm": [0.45], "tolerance.preset": ["none"]}
    swept = {key: [value] for key, value in changes.items()}
    return designs_of(*small(axes={**axes, **more, **swept}, derived={})).scene_of(0)


def _moved(scene: Scene) -> Floats:
    """Red markers move by up to .02 mm, differently in every place; blue ones stay."""
    markers = view_of(scene).markers
    moved = 0.02 * np.sin(markers.points + np.arange(3.0))
    moved[markers.of("blue")] = 0.0
    return np.asarray(moved)


def test_the_tracker_takes_moving_shadows_for_motion_and_doubts_as_predicted() -> None:
    scene = _scene()
    view, moved = view_of(scene), _moved(scene)
    blue, red = view.markers.of("blue"), view.markers.of("red")
    shadows = shadows_of(scene, view)
    assert shadows is not None
    predicted = shadows.pulled(moved[:, :, None])[:, :, 0]
    sensor = Sensor(scene)
    rest = analyse_rest(sensor.picture(None, exposure=0), sensor.layout_px)
    motion = Motion(displacement_mm=moved, gradient=np.zeros((len(moved), 3, 3)), error=0.0)
    found = track_frame(rest, sensor.picture(motion, exposure=1))
    assert np.abs(predicted[blue]).max() > 0.01
    assert np.abs(predicted[red]).max() == 0.0
    assert np.corrcoef(predicted[blue].ravel(), found.shift_px[blue].ravel())[0, 1] > 0.8
    assert np.std(predicted[blue]) == pytest.approx(np.std(found.shift_px[blue]), rel=0.3)
    told = np.median(found.sd_px[blue]) / np.median(found.sd_px[red])
    assert np.median(shadows.doubt[red]) == 1.0
    assert np.median(shadows.doubt[blue]) == pytest.approx(told, rel=0.25)


def test_no_lamps_no_shadows_and_equal_motion_pulls_nothing() -> None:
    assert shadows_of(_scene(**{"light.ambient": 1.0}), view_of(_scene())) is None
    shadows = shadows_of(_scene(), view_of(_scene()))
    assert shadows is not None
    together = np.ones((len(shadows.doubt), 3, 1))
    np.testing.assert_allclose(shadows.pulled(together), 0.0, atol=1e-12)
