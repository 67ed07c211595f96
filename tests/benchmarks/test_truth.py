"""The block's truth: its half-space, its quarter of bricks, and what is stored of it, against others."""

import json

import numpy as np
import pytest

from benchmarks.reference import BODIES, reference
from benchmarks.truth import FOLDER, Bricks, Quarter, half_space
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.theory import halfspace
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile


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
def test_quarter_of_bricks_gives_the_stored_truth_and_loads_beside_the_middle():
    """The coarse bricks of this test are 1e-5 off. Beside the middle all four symmetries take part."""
    pytest.importorskip("ngsolve")
    truth, quarter = reference("block"), Quarter(Bricks(order=5, shares=(0.0, 0.5, 0.8, 1.0)), 0.5)

    def whole(words):
        return half_space(truth.points, words, 0.5) + quarter.rest(truth.points, words)

    for key in ("R1x_nu0.5", "R1z_nu0.5"):
        assert away(whole(truth.case(key).words), truth.case(key).right) < 2e-5
    words = {"centre_mm": [8.0, -5.0], "size_mm": [3.0, 2.0], "force_n": [0.5, -0.3, 1.0]}
    load = tile(Traction.rectangle(**words), BODIES["block"])
    table = Compliance(BODIES["block"], Material(youngs_modulus_mpa=0.5)).displacement(truth.points, load)
    assert away(whole(words | {"kind": "rectangle"}), table) < 1e-4
