"""The block's truth, from two programs; the quadrature of both."""

import itertools
import json
import math

import numpy as np
import pytest
from block_truth import COARSE as COARSE_BRICKS
from block_truth import FOLDER, Bricks, Quarter, half_space

from benchmarks.reference import BODIES, reference
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.theory import halfspace
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.mesh.quadratic_mesh import quadrature


@pytest.mark.parametrize("axes", [2, 3])
def test_quadrature_is_exact_to_degree_five(axes):
    places, weights = quadrature(axes)
    for powers in itertools.product(range(6), repeat=axes):
        if sum(powers) <= 5:
            exact = math.prod(math.factorial(n) for n in powers) / math.factorial(sum(powers) + axes)
            assert weights @ np.prod(places**powers, axis=1) == pytest.approx(exact, rel=1e-12)


def away(one, other):
    """Return the largest difference of two fields over the largest displacement."""
    return np.linalg.norm(one - other, axis=1).max() / np.linalg.norm(other, axis=1).max()


def test_stored_truth_is_block_npz_within_what_that_says_of_itself():
    with np.load(FOLDER / "block.npz") as file:
        other = {key: file[key] for key in file.files}
    truth = reference("block")
    assert np.array_equal(truth.points, other["points"])
    for case, said in zip(truth.cases, json.loads(str(other["cases"])), strict=True):
        assert (case.key, case.nu, case.words) == (said["key"], said["nu"], said["load"])
        assert case.own_error < 3e-6
        assert away(case.right, other[case.key]) < said["error_estimate"]


@pytest.mark.parametrize("key", ["R1x_nu0.49", "R1z_nu0.5", "D1z_nu0.49", "W1t_nu0.49"])
def test_half_space_of_point_forces_is_the_closed_form(key):
    """Exactly for rectangles; disks and twists are cut into strips, which is all of the difference."""
    case, points = reference("block").case(key), reference("block").points[::20]
    closed = halfspace.displacement(points, case.load(BODIES["block"]), 0.5, case.nu)
    assert away(half_space(points, case.words, case.nu), closed) < (1e-12 if key.startswith("R") else 6e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_quarter_of_bricks_gives_the_stored_truth():
    """The coarse bricks of this test are 1e-5 off."""
    pytest.importorskip("ngsolve")
    truth, quarter = reference("block"), Quarter(Bricks(order=5, shares=(0.0, 0.5, 0.8, 1.0)), 0.5)
    for key in ("R1x_nu0.5", "R1z_nu0.5"):
        words, right = truth.case(key).words, truth.case(key).right
        assert away(half_space(truth.points, words, 0.5) + quarter.rest(truth.points, words), right) < 2e-5


def random_loads():
    """Yield kinds, and eight loads in words: rectangles, disks and twists anywhere within 10 mm."""
    random = np.random.default_rng(11)
    for kind in ("rectangle", "disk", "rectangle", "twist") * 2:
        push = random.normal(size=3)
        centre = [float(random.uniform(-10, 10)), float(random.uniform(-8, 8))]
        size = np.exp(random.uniform(*np.log((1.5, 12.0)), 2)).tolist()
        shape = {"size_mm": size} if kind == "rectangle" else {"radius_mm": size[0] / 2}
        load = {"torque_nmm": 10.0} if kind == "twist" else {"force_n": (push / np.linalg.norm(push)).tolist()}
        yield kind, {"centre_mm": centre, **shape, **load}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("nu", [0.5, 0.3, 0.1])
def test_the_block_tables_estimates_are_one_to_three_times_its_error(nu):
    """Of a narrow twist up to ten times. The truth is 2e-6 off; beside the middle all four symmetries take part."""
    pytest.importorskip("ngsolve")
    block, quarter = BODIES["block"], Quarter(COARSE_BRICKS, nu)
    stiff = Compliance(block, Material(youngs_modulus_mpa=0.5, poisson_ratio=nu))
    for kind, words in random_loads():
        points = reference("block").points + np.array([*words["centre_mm"], 0.0])
        points = points[(np.abs(points[:, :2]) < (16, 12)).all(axis=1)]
        got, estimate = stiff.answer(points, tile(getattr(Traction, kind)(**words), block))
        named = words | {"kind": kind}
        error = away(got, half_space(points, named, nu) + quarter.rest(points, named))
        assert error - 2e-6 < estimate < (11 if kind == "twist" else 3) * error, (kind, words)
