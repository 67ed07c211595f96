"""Other programs and the block's truth: their loads, their absence, and that they agree where they should."""

import itertools
import json
import math

import numpy as np
import pytest
from block_truth import COARSE as COARSE_BRICKS
from block_truth import FOLDER, Bricks, Quarter, half_space

from benchmarks import peers
from benchmarks.peers import BUMP_MM, Edges, Problem, curved, netgen_mesh, nodal_shares
from benchmarks.reference import BODIES, reference
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.theory import halfspace
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.elements import quadrature

COARSE = Edges(ring=1.3, load=1.3, rim=25, far=25, grading=0.5)


@pytest.mark.parametrize("axes", [2, 3])
def test_quadrature_is_exact_to_degree_five(axes):
    places, weights = quadrature(axes)
    for powers in itertools.product(range(6), repeat=axes):
        if sum(powers) <= 5:
            exact = math.prod(math.factorial(n) for n in powers) / math.factorial(sum(powers) + axes)
            assert weights @ np.prod(places**powers, axis=1) == pytest.approx(exact, rel=1e-12)


def test_nodal_forces_balance_the_bump():
    """Their sum, their torque and their second moment are the traction's own, integrated in closed form on a plane.

    Over the sphere's cap the area is larger than on the plane by less than a tenth of (bump / sphere)^2.
    """
    mesh = body_mesh(BODIES["finger"], "fine")
    force = nodal_shares("finger", mesh)
    assert force.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.abs(force @ mesh.points[:, :2]).max() < 0.01 * BUMP_MM
    square = force @ np.sum(mesh.points**2, axis=1)
    assert square == pytest.approx(BUMP_MM**2 / 4, rel=0.02)


@pytest.mark.parametrize("body", ["block", "finger"])
@pytest.mark.parametrize("nu", [0.5, 0.49])
def test_problem_is_the_reference_where_the_reference_is(body, nu):
    problem = Problem(body=body, nu=nu)
    for load, key in enumerate(("R1z", "R1x") if body == "block" else ("apex_z", "apex_x")):
        case = reference(body).case(f"{key}_nu{nu:g}")
        np.testing.assert_allclose(problem.right(load), case.right, atol=1e-15)
        assert np.argmax(np.abs(case.words["force_n"])) == problem.axes[load]


@pytest.mark.parametrize("absent", ["ngsolve", "ccx"])
def test_an_absent_program_gets_a_row_that_says_so(monkeypatch, absent):
    monkeypatch.setattr(peers, "find_spec", lambda name: None if name == absent else True)
    monkeypatch.setattr(peers, "has_calculix", lambda: absent != "ccx")
    row = next(peers.peer_rows("block", quick=True))
    assert "absent" in row["remark"] or "not installed" in row["remark"]
    name = {"ngsolve": "NGSolve", "ccx": "CalculiX"}[absent]
    assert name in row["program"] or name in row["remark"]
    assert not any(way.program.startswith(name) for way in peers.ways())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_programs_agree_on_the_same_quadratic_elements():
    """Straight elements, the load's edge a mesh line: the discrete problem is the same, so the answers are."""
    pytest.importorskip("ngsolve")
    if not peers.has_calculix():
        pytest.skip("CalculiX, the second program, is not installed")
    mesh = netgen_mesh("block", COARSE)
    mesh.Curve(1)
    nodes, problem, found = curved(mesh, "block"), Problem(body="block", nu=0.49), {}
    for way in peers.ways():
        if way.nu == 0.49 and way.element.startswith("P2"):
            found[way.program] = way.solve(mesh if way.order else nodes, problem).moved
    assert len(found) > 1
    one, *others = found.values()
    for other in others:
        for load in range(2):
            np.testing.assert_allclose(other[load], one[load], atol=2e-6 * np.abs(one[load]).max())


# --- the block's truth ----------------------------------------------------------------------------


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
