"""A sweep's noise in mm is its noise in px over the camera's scale, at each layer's depth."""

import numpy as np
import pytest
from small_sweep import small

from twin.study.sweep.designs import Designs
from twin.study.sweep.fidelities import closed
from twin.theory.limit import design_limit
from twin.theory.optics import project_with_jacobian

NOISE_PX = 0.05


@pytest.mark.parametrize("focal_px", [1800.0, 3600.0])
def test_pixels_become_millimetres_by_the_projection(focal_px):
    axes = {"camera.focal_px": [focal_px, 2 * focal_px]}
    sweep, scene = small(axes=axes, derived={}, noise_px=NOISE_PX)
    found, _ = closed(Designs.of(sweep, scene))
    camera = scene.camera.model_copy(update={"focal_px": focal_px})
    depth = np.array([layer.depth_mm for layer in scene.markers.values()])
    middle = np.column_stack([*np.tile(camera.pupil_mm[:2], (len(depth), 1)).T, depth])
    index, base = scene.material.refractive_index, scene.body.base_z_mm
    px_per_mm = project_with_jacobian(middle, camera, index, base)[1][:, 0, 0]
    limit = design_limit(
        depth_mm=depth[None],
        pitch_mm=np.array([[layer.pitch_mm for layer in scene.markers.values()]]),
        noise_mm=NOISE_PX / px_per_mm[None],
        youngs_modulus_mpa=scene.material.youngs_modulus_mpa,
        poisson_ratio=scene.material.poisson_ratio,
        force_n=sweep.loads.force_n,
        radius_mm=sweep.loads.size_mm / np.sqrt(np.pi),
        sampling="squares",
    )
    assert found["two_point_mm"][0] == pytest.approx(limit.two_point_mm[0], rel=1e-6)
    assert found["fwhm_mm"][0] == pytest.approx(limit.fwhm_normal_mm[0], rel=1e-6)
    assert found["resolution_gf"][0] * 9.80665e-3 == pytest.approx(limit.force_sd_n[0], rel=1e-6)
    assert found["resolution_gf"][1] < 0.8 * found["resolution_gf"][0]
