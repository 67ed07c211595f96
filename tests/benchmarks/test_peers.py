"""Other programs are used rightly: their loads, their absence, and that they agree where they should."""

import itertools
import math

import numpy as np
import pytest

from benchmarks import peers
from benchmarks.peers import BUMP_MM, PLACES, WEIGHTS, Edges, Problem, curved, netgen_mesh, nodal_shares
from benchmarks.reference import BODIES, reference
from twin.world.mesh.body_mesh import body_mesh

COARSE = Edges(ring=1.3, load=1.3, rim=25, far=25, grading=0.5)


def test_quadrature_is_exact_to_degree_five():
    for i, j in itertools.product(range(6), repeat=2):
        if i + j > 5:
            continue
        exact = math.factorial(i) * math.factorial(j) / math.factorial(i + j + 2)
        assert WEIGHTS @ (PLACES[:, 0] ** i * PLACES[:, 1] ** j) == pytest.approx(exact, rel=1e-12)


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
