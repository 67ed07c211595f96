"""Covers of another modulus: the layered half-space on a flat body, scaling, no cover."""

import numpy as np
import pytest
from layered import Layered, bump_displacement
from standard_bodies import BLOCK, FINGER, REFERENCE, assert_near, asymmetry, relative_error

from twin.parts.load import Traction
from twin.parts.material import Cover, Material
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory import halfspace
from twin.world.elasticity.coated import CoveredCompliance
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.fem import TaylorHood

RUBBER = Material(youngs_modulus_mpa=1.0, poisson_ratio=0.5)
AROUND = np.stack(np.meshgrid([-3, -1, -0.4, 0, 0.3, 1], [-2, 0, 0.5, 1.5]), -1).reshape(-1, 2)


def covered(body, cover, material=RUBBER):
    return CoveredCompliance(
        body, material, cover.thickness_mm, TaylorHood.Layer.of_cover(material, cover), level="sketch"
    )


def flat_error(stiff, cover, radius, force, depths):
    """Return error and estimate; the truth: layered half-space plus what a bare block adds."""
    points = np.vstack([np.column_stack([AROUND, np.full(len(AROUND), z)]) for z in depths])
    load = tile(Traction.bump((0, 0), radius, force), BLOCK)
    bare = Compliance(BLOCK, RUBBER).displacement(points, load) - halfspace.displacement(points, load, 1.0, 0.5)
    nu = 0.5 if cover.poisson_ratio is None else cover.poisson_ratio
    flat = Layered(thickness_mm=cover.thickness_mm, layer=(cover.youngs_modulus_mpa, nu), below=(1.0, 0.5))
    truth = bump_displacement(points, flat, radius, force) + bare
    moved, estimate = stiff.answer(points, load)
    error = np.linalg.norm(moved - truth, axis=1)
    return error.max() / np.linalg.norm(truth, axis=1).max(), estimate


CASES = [(10.0, None, 1.0, 1.6e-2), (10.0, 0.4, 1.0, 1.6e-2), (0.1, None, 1.0, 2e-2), (10.0, None, 2.0, 1.6e-2)]


@pytest.mark.slow
@pytest.mark.parametrize(("modulus", "nu", "radius", "bound"), CASES)
def test_flat_cover_is_a_layered_half_space(modulus, nu, radius, bound):
    cover = Cover(thickness_mm=0.2, youngs_modulus_mpa=modulus, poisson_ratio=nu)
    stiff = covered(BLOCK, cover)
    for force in ((0, 0, 1), (1, 0, 0)):
        error, estimate = flat_error(stiff, cover, radius, force, (0.3, 0.5, 1.0))
        assert error < bound
        assert error < estimate < 4 * error
        error, estimate = flat_error(stiff, cover, radius, force, (0.0, 0.1))
        assert error < (0.2 if modulus < 1 else bound)
        assert error < estimate < 4 * error


@pytest.mark.slow
def test_moduli_scale_and_equal_ones_are_no_cover():
    cover = Cover(thickness_mm=0.2, youngs_modulus_mpa=10.0, poisson_ratio=0.45)
    double = Cover(thickness_mm=0.2, youngs_modulus_mpa=20.0, poisson_ratio=0.45)
    load = tile(Traction.bump((1.0, 0.5), 1.0, (0.2, 0, 1)), FINGER)
    points = FINGER.chart_points(np.array([[1.0, 0.5], [0.0, 0.0]]), 1.0)
    once = covered(FINGER, cover).displacement(points, load)
    twice = covered(FINGER, double, Material(youngs_modulus_mpa=2.0)).displacement(points, load)
    np.testing.assert_allclose(twice, once / 2, rtol=1e-8)
    bare = Compliance(FINGER, RUBBER, level="nominal").displacement(points, load)
    assert 0.5 < np.linalg.norm(once) / np.linalg.norm(bare) < 0.98
    assert TaylorHood.Layer.of_cover(RUBBER, Cover(youngs_modulus_mpa=1.0, poisson_ratio=0.5)) is None
    assert TaylorHood.Layer.of_cover(RUBBER, Cover()) is TaylorHood.Layer.of_cover(RUBBER, None) is None


def test_only_a_cover_of_another_material_changes_the_sensor():
    same = load_scene("kamiyama_pillar", overrides={"tolerance.preset": "none", "cover.youngs_modulus_mpa": 1.0})
    assert isinstance(Sensor(same).compliance, Compliance)
    other = load_scene("kamiyama_pillar", overrides={"cover.youngs_modulus_mpa": 5.0})
    sensor = Sensor(other)
    assert isinstance(sensor.compliance, CoveredCompliance)
    assert isinstance(sensor.nominal_compliance, CoveredCompliance)
    assert sensor.compliance.layer.modulus_ratio == pytest.approx(5.0)


@pytest.mark.slow
def test_a_region_is_made_once_and_patches_on_it_are_reciprocal():
    stiff = covered(FINGER, Cover(thickness_mm=0.2, youngs_modulus_mpa=10.0))
    patches = tile(Traction.rectangle((1.0, 0.5), (1.2, 1.2), (0, 0, 1)), FINGER, 0.4)
    matrix = stiff.surface(patches)
    patch = stiff.local_model(patches, each=True)
    assert patch is not None
    assert asymmetry(patch, patches) < 0.03  # the edge of the mesh is as large as a patch here
    assert np.linalg.eigvalsh(matrix).min() > 0
    assert stiff.local_model(patches, each=True) is patch
    pressed = (matrix @ patches.force_n.ravel()).reshape(-1, 3)
    whole = patch.displacement(patches.centre_mm, patches)
    assert_near(pressed, whole, 0.02)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["normal", "sideways"])
def test_finger_agrees_with_an_independent_code(case):
    """NGSolve, order 3 on curved elements of both: bump 1 mm, cover ten times stiffer."""
    with np.load(REFERENCE / "covered_finger.npz") as file:
        points, expected = file["points"], file[case]
    stiff = CoveredCompliance(
        FINGER, RUBBER, 0.2, TaylorHood.Layer.of_cover(RUBBER, Cover(youngs_modulus_mpa=10.0)), level="nominal"
    )
    force = (0, 0, 1) if case == "normal" else (1, 0, 0)
    got, estimate = stiff.answer(points, tile(Traction.bump((1.0, 0.5), 1.0, force), FINGER))
    error = relative_error(got, expected)
    assert error < 1e-2
    assert error < estimate < 4 * error
