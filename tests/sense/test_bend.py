"""Reconstructing through the bent camera (``camera=True``), against the projection itself."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from half_space_sensor import as_found, cell_compliance, finger_sensor

from twin.parts.camera import Camera
from twin.sense.reconstruct import reconstruct
from twin.sense.transfer import from_compliance
from twin.theory.optics import project, projection_jacobian

INDEX, BASE_MM = 1.41, 10.0


@pytest.mark.parametrize("options", [{}, {"push_only": True}, {"friction": 0.8}])
def test_large_motion_through_the_camera(options):
    """Where markers move by tens of pixels the linear map is off by percents, and most of that is taken away."""
    markers, _, calibration = finger_sensor()
    camera = Camera(focal_px=300, pupil_mm=(0, 0, 14))
    compliance = cell_compliance(markers, calibration.site_mm, 2.5, 2)
    bent = dataclasses.replace(
        calibration,
        layout_px=project(markers, camera, INDEX, BASE_MM),
        transfer=from_compliance(compliance, projection_jacobian(markers, camera, INDEX, BASE_MM)),
        compliance=compliance.astype(np.float32), marker_mm=markers,
        camera=json.dumps({"camera": camera.model_dump(mode="json"), "body_index": INDEX, "base_z_mm": BASE_MM}),
    )  # fmt: skip
    near = np.exp(-((calibration.site_mm[:, :2] - [0.6, -0.4]) ** 2).sum(axis=1) / 2 / 3.0**2)
    force = (near / near.sum())[:, None] * np.array([2.0, 1.2, 16.0])
    moved = markers + (compliance @ force.ravel()).reshape(-1, 3)
    shift = project(moved, camera, INDEX, BASE_MM) - project(markers, camera, INDEX, BASE_MM)
    assert np.abs(shift - (bent.transfer @ force.ravel()).reshape(-1, 2)).max() > 0.5, "the camera bends"
    found = as_found(shift, bent, 0.003, 1)
    errors = []
    for follow in (False, True):
        field = reconstruct(found, bent, camera=follow, **options)
        errors.append(np.linalg.norm(field.force_n.sum(axis=0) - force.sum(axis=0)) / np.linalg.norm(force.sum(axis=0)))
    assert errors[0] > 0.01
    assert errors[1] < 0.3 * errors[0], errors
