"""Near edges, in thin blocks and by a held back; where two meshes err alike, estimates are not below the error.

The displacements in `near_edges.json` are of meshes refined around the load:
`twin.world.mesh.bisection.refined` of the ``coarse`` mesh, its edges as long as the distance to
the nearest of the load's rectangles, but not below 0.2 mm (10 000 to 20 000 nodes), with elements
drawn to the rim. With edges 0.6 times as long, not below 0.12 mm, they differ by 2e-4 and 8e-4 on
the two small blocks. On the finger they are of its ``standard`` mesh, refined to 0.17 mm (29 000
nodes), under narrow loads as its `Ladder` refines it. Those of the twist are NGSolve's (order 4).

The column and the bar are meshed here, and meshes differ: of five meshes on each of the two levels,
all pairs, the estimate was 2.1 to 4.1 times the error on the column, and 1.5 to 4.4 times on the
bar, because the error itself was 0.5 to 0.9 % and 5 to 10 % of the largest displacement by the
mesh; hence the bound of five times.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from layered import Layered, bump_displacement
from standard_bodies import (
    BLOCK,
    FINGER,
    REFERENCE,
    assert_holder_balances,
    assert_near,
    asymmetry,
    rectangles,
    relative_error,
    traction_of,
)

from benchmarks.random_bodies import bracket, write_stl
from twin.arrays import frozen
from twin.parts.body import Block, Finger, Solid
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.coated import Ladder
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.error_law import missed_by_mesh, unbounded
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.sizing import Sizing, WantedEdge

STORED = json.loads((REFERENCE / "near_edges.json").read_text())
PAD = Block(width_mm=40, length_mm=40, thickness_mm=2)
RUBBER = Material(youngs_modulus_mpa=0.5, poisson_ratio=0.5)
MESHED = ("bar", "bar, towards its edge", "column", "twist at a corner")
CASES = [
    pytest.param(case, marks=[pytest.mark.slow] if name in MESHED else [], id=name)
    for name, case in STORED["free_edge"].items()
]


@pytest.mark.parametrize("case", CASES)
def test_estimates_near_a_free_edge_are_one_to_five_times_the_error(case):
    body = Block(**case["body"])
    kind, size = ("twist", "torque_nmm") if "torque_nmm" in case else ("disk", "force_n")
    load = tile(getattr(Traction, kind)(case["centre_mm"], case["radius_mm"], case[size]), body)
    stiff = Compliance(body, RUBBER, level=case["level"], table=False)
    got, estimate = stiff.answer(np.array(case["points_mm"]), load)
    error = relative_error(got, case["displacement_mm"])
    assert error > 0.002
    assert 1.0 < estimate / error < 5.0


@pytest.mark.parametrize(
    ("place", "row"), [(STORED[name], row) for name in ("finger_back", "finger_narrow") for row in STORED[name]["rows"]]
)
def test_estimates_on_the_finger_by_its_free_back_edge_and_under_narrow_shear_are_above_the_error(place, row):
    """They were 0.4 to 0.9 times the error by the edge, and 0.7 times under the narrower shear."""
    load = tile(Traction.bump(tuple(place["centre_mm"]), row["radius_mm"], tuple(row["force_n"])), FINGER)
    got, estimate = Compliance(FINGER, RUBBER, level="coarse").answer(np.array(place["points_mm"]), load)
    error = relative_error(got, row["displacement_mm"])
    assert error > 0.005
    assert 1.0 < estimate / error < 3.0


def test_far_from_edges_nothing_is_added():
    points = np.array([(0, 0, 0.1), (3, 1, 2.0)])
    load = tile(Traction.disk((10, 5), 1.0, (0, 1, 1)), BLOCK)
    assert not missed_by_mesh(BLOCK, points, load, lambda places: np.full(len(places), 10.0)).any()


@pytest.mark.slow
@pytest.mark.parametrize("row", STORED["whole_face"]["rows"], ids=["pressed", "along x", "along y"])
def test_a_uniform_load_on_a_whole_face_states_its_error(row):
    """Two meshes differ by 0.2 to 0.6 % where both are 2 % off: at the edges where the load ends."""
    bar = Block(width_mm=12, length_mm=40, thickness_mm=8)
    load = tile(Traction.rectangle((0, 0), (12, 40), tuple(row["force_n"])), bar)
    stiff = Compliance(bar, RUBBER, level="standard")
    got, estimate = stiff.answer(np.array(STORED["whole_face"]["points_mm"]), load)
    error = relative_error(got, row["displacement_mm"])
    assert error > 0.01
    assert 1.0 < estimate / error < 4.0


def test_a_wide_load_is_cut_at_the_edges_it_reaches_only():
    whole = tile(Traction.rectangle((0, 0), (40, 40), (0.3, 0.2, 1)), PAD)
    assert unbounded(PAD, whole) == 0.0  # it lies no deeper than its middle
    cut = whole.cut_at_edges(PAD, lambda places: np.full(len(places), 1.5))
    assert_near(cut.total_force_n, whole.total_force_n, 1e-12)
    assert_near(cut.total_torque_nmm, whole.total_torque_nmm, 1e-12)
    assert 4.0 * cut.half_mm.prod(axis=1).sum() == pytest.approx(40.0**2)
    gap = 20.0 - np.max(np.abs(cut.centre_mm[:, :2]) + cut.half_mm, axis=1)
    assert np.all(cut.half_mm.max(axis=1) <= np.maximum(gap, 1.5))
    assert len(cut) < 500
    inside = tile(Traction.rectangle((0, 0), (10, 10), (0, 0, 1)), PAD)
    assert inside.cut_at_edges(PAD, lambda places: np.zeros(len(places))) is inside


def beside_an_edge(nu):
    """Return a pad, its rubber, points, and loads with their displacements by NGSolve, themselves up to 3e-4 off."""
    pad, stored = Block(width_mm=25, length_mm=25, thickness_mm=4), dict(np.load(REFERENCE / "edge_pad.npz"))
    loads = [tile(Traction.bump((10.5, -4.0), 0.8, tuple(force)), pad) for force in stored["forces"]]
    moved = stored["displacement_mm"][list(stored["ratios"]).index(nu)]
    return pad, Material(youngs_modulus_mpa=1.0, poisson_ratio=nu), stored["points"], zip(loads, moved, strict=True)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_beside_an_edge_estimates_are_one_to_three_times_the_error_also_of_a_force_towards_it(nu):
    pad, rubber, points, rows = beside_an_edge(nu)
    stiff = Compliance(pad, rubber, level="coarse", table=False)
    for load, expected in rows:
        got, estimate = stiff.answer(points, load)
        assert 1.0 < estimate / relative_error(got, expected) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_beside_an_edge_the_accuracy_is_met_and_estimated(nu):
    """Without refinement 1.2 to 2.4 % off here."""
    pad, rubber, points, rows = beside_an_edge(nu)
    ladder = Ladder(pad, rubber, 1e-2)
    for load, expected in rows:
        got = ladder.displacement(points, load)
        error = relative_error(got.displacement_mm, expected)
        assert got.compliance.level == "coarse"
        assert error < 2e-3
        assert 1.0 < got.error / error < 3.0


@pytest.mark.slow
def test_elements_beside_an_edge_are_small_where_a_wide_load_is_near_it():
    """They were as small under all of it, and 137,000 unknowns."""
    across = (np.arange(12) + 0.5) / 3.0
    places = np.stack(np.meshgrid(8.2 + across, across, [0.0]), axis=-1).reshape(-1, 3)
    pad = Block(width_mm=25, length_mm=25, thickness_mm=4)
    got = Ladder(pad, RUBBER, 1e-2).displacement(np.array([(12.1, 2.0, 0.3)]), rectangles(places, 1 / 6, 1.0))
    assert got.error < 1e-2
    assert got.compliance.mesh.unknowns < 80_000


@pytest.mark.slow
def test_a_place_on_the_finger_costs_its_own_level():
    """Asked for 3e-3, the finger is solved on ``coarse``; estimates are one to three times the error."""
    with np.load(REFERENCE / "finger.npz") as file:
        stored = dict(file)
    ladder = Ladder(FINGER, Material(youngs_modulus_mpa=0.5, poisson_ratio=0.5), 3e-3)
    cases = [case for case in json.loads(str(stored["cases"])) if case["key"].startswith("apex") and case["nu"] == 0.5]
    assert len(cases) == 3
    for case in cases:
        load = tile(traction_of(case), FINGER)
        got = ladder.displacement(stored["points"], load)
        error = relative_error(got.displacement_mm, stored[case["key"]])
        assert got.compliance.level == "coarse"
        assert error < got.error < 3.0 * error
        assert got.error < 3e-3


@pytest.mark.slow
@pytest.mark.parametrize("at", [(-2.8, 1.1), (2.8, -1.7), (0.0, 0.0)])
def test_an_edge_folded_inwards_is_stated_where_two_meshes_differ_little(at, tmp_path):
    """An L held on its leg, against its ``fine`` mesh; where it was compared with the coarsest mesh,
    half of the error was stated with some meshes, and nine times the error with others.

    Of 25 pairs of meshes, the error is 0.57 to 0.69 %, 0.22 to 0.34 and 0.54 to 0.69 at the three
    places, the estimate 0.73 to 1.02 %, 0.89 to 1.37 and 0.71 to 1.17, 1.2 times the error at
    least. At the second place half of it is what a free edge may add.
    """
    corners, _ = bracket(np.random.default_rng([5, 1]))
    held, sensing = ({"normal": (0, 0, z), "within_deg": 5} for z in (1, -1))
    body = Solid(file=write_stl(tmp_path / "bracket.stl", corners), held=held, sensing=sensing)
    coarse, fine = (Compliance(body, RUBBER, level=level) for level in ("coarse", "fine"))
    points = np.array([(0, 0, 1), (1, 0, 0.6), (0, -1, 1.5), (-1, 0.5, 0.5)])
    points[:, :2] += at
    load = tile(Traction.bump(at, 1.2, (0, 0, 1)), body)
    got, estimate = coarse.answer(points, load)
    assert relative_error(got, fine.displacement(points, load)) < estimate < 0.02


POINTS = np.array([[x, 0.3 * x, z] for x in (0.0, 0.5, 1.0, 2.0, 3.0) for z in (0.1, 0.3, 0.5, 1.0, 1.6)])


def pad(nu):
    """A pad on the thick block's coarsest mesh, squeezed: no mesher is needed."""
    mesh = body_mesh(BLOCK, "sketch")
    squeezed = replace(mesh, points=frozen(mesh.points * [0.4, 40 / 90, 0.05]))
    return Compliance(PAD, Material(youngs_modulus_mpa=0.5, poisson_ratio=nu), squeezed)


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_inside_the_coarsest_mesh_is_exact(nu):
    stiff = pad(nu)
    rock = Layered(thickness_mm=2.0, layer=(0.5, nu), below=(1e9, 0.3))
    for radius, force in ((0.5, (0, 0, 1)), (1.5, (0, 0, 1)), (1.5, (1, 0, 0))):
        load = tile(Traction.bump((0, 0), radius, force), PAD, 0.04 * radius)
        got = stiff.displacement(POINTS, load)
        assert relative_error(got, bump_displacement(POINTS, rock, radius, force)) < 1e-4
        turned = stiff.gradient(POINTS[::7], load)
        moved = [stiff.displacement(POINTS[::7] + move, load) for move in (-1e-4 * np.eye(3)[0], 1e-4 * np.eye(3)[0])]
        assert np.abs((moved[1] - moved[0]) / 2e-4 - turned[:, :, 0]).max() < 1e-3 * np.abs(turned).max()


def test_every_way_to_ask_gives_the_same_field():
    stiff, near = pad(0.5), POINTS + np.array([16.0, 2.0, 0.0])
    patches = tile(Traction.rectangle((17.0, 3.0), (2, 2), (0.2, -0.1, 1)), PAD, 0.5)
    field = stiff.displacement(near, patches)
    matrix = stiff.to_points(near, patches)
    assert relative_error((matrix @ patches.force_n.ravel()).reshape(-1, 3), field) < 2e-3
    assert asymmetry(stiff, patches) < 1e-2


FREE = FINGER
HELD = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2, back="held")


@pytest.fixture(scope="module")
def mesh():
    return body_mesh(FREE, "nominal")


def test_only_a_held_back_asks_for_another_mesh():
    sizing = Sizing.of(FREE, "nominal")
    told = {**FREE.model_dump(), "back": "free"}
    assert sizing.mesh_key(Finger(**told)) == sizing.mesh_key(FREE) != sizing.mesh_key(HELD)


def test_rim_runs_around_a_held_back():
    free, held = (WantedEdge(body, Sizing.of(body, "nominal")).rim_mm for body in (FREE, HELD))
    assert np.any(held[np.abs(held[:, 0] + 8.0) < 1e-9, 2] < 0.5)
    assert not np.any(free[:, 2] < 9.9)


def test_held_nodes_stay_and_reactions_balance(mesh):
    system = TaylorHood(mesh, 0.5, held=mesh.nodes_on(HELD.held_pieces))
    forces = np.zeros((len(mesh.points), 3, 3))
    forces[int(np.argmin(np.linalg.norm(mesh.points, axis=1)))] = np.eye(3)
    moved = system.solve(forces)
    assert not np.any(moved[np.abs(mesh.points[:, 0] + 8.0) < 1e-9])
    assert_holder_balances(system, 1e-8)


@pytest.mark.slow
def test_a_held_back_stiffens_most_near_it(mesh):
    """Work of the same load: less with the back held, by more the nearer the load is."""
    saved = []
    for x in (-5.0, -2.0, 3.0):
        load = tile(Traction.bump((x, 0.0), 1.0, (0.0, 0.0, 1.0)), FREE)
        point = np.array([[x, 0.0, FREE.surface_from_above(np.array([[x, 0.0]]))[0, 2] + 1.0]])
        free, held = (Compliance(body, Material(), mesh).displacement(point, load)[0, 2] for body in (FREE, HELD))
        saved.append(1.0 - held / free)
    assert saved == sorted(saved, reverse=True)
    assert saved[0] > 0.05
    assert 0.0 < saved[2] < 0.02
