"""Compliance by convolution against the matrix that it stands for, and systems with it by GMRES against elimination."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from presses import STUCK, HalfSpace, ball, pressed, punch, pushed
from standard_bodies import BLOCK, FINGER

from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.parts.press import Cone, Pillar, Press, Step
from twin.world.contact import load_step
from twin.world.contact.coulomb import solve_coulomb
from twin.world.contact.influence import DenseInfluence, LatticeInfluence, SaddlePoint
from twin.world.contact.surface_patches import Box, Footprint, Patches, Plane
from twin.world.elasticity.compliance import Compliance

lattice = LatticeInfluence.between


def plane(x, y):
    return Plane(origin_mm=np.array([x, y, 0.0]), axes=np.eye(3))


UPRIGHT = plane(4.0, -3.0)


LEVEL, SQUARE = plane(0.0, 0.0), Box(u0=-1, u1=1, v0=-1, v1=1)


def elastic(nu):
    return Compliance(BLOCK, Material(youngs_modulus_mpa=0.5, poisson_ratio=nu))


def patches(across=(16, 13)):
    box = Box(u0=-1.0, u1=1.5, v0=-0.9, v1=1.1)
    return Patches.under(BLOCK, None, UPRIGHT, box, across)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_a_lattice_is_its_matrix(nu):
    cut, body, rng = patches(), elastic(nu), np.random.default_rng(1)
    found, k = lattice(cut, body), len(cut)
    assert isinstance(found, LatticeInfluence)
    matrix = body.surface(cut.unloaded).reshape(k, 3, k, 3)
    dense = DenseInfluence(matrix)
    force, rows = rng.normal(size=(k, 3)), rng.permutation(k)[:20]
    columns = rng.permutation(k)[:30]

    def same(name, *given):
        # distant patches by quadrature: where its order changes, values differ by up to 4e-10
        wanted = getattr(dense, name)(*given)
        close = {"rtol": 0.0, "atol": 1e-8 * matrix.max()}
        assert_allclose(getattr(found, name)(*given), wanted, **close)
        return wanted

    same("block", rows)
    same("normal_block", rows, columns)
    same("normal_displacement", force[:, 2])
    largest = np.abs(same("apply", force)).max()
    some = found.product(rows, force[rows].T) * found.unit
    own = np.einsum("kalb,lb->ak", matrix[rows][:, :, rows], force[rows])
    assert_allclose(some, own, rtol=0.0, atol=3e-6 * largest)
    # the preconditioner is an inverse but for what couples normal and tangential motion, and the border
    back = found.approx_solve(rows, found.product(rows, force[rows].T)[..., None])[..., 0].T
    assert np.linalg.norm(back - force[rows]) < 0.3 * np.linalg.norm(force)
    # what stands for a matrix is symmetric (Betti): f . C g = g . C f
    other = rng.normal(size=(k, 3))
    forth, back = np.vdot(other, found.apply(force)), np.vdot(force, found.apply(other))
    assert forth == pytest.approx(back, rel=1e-11)


def test_what_is_no_lattice_has_none():
    cut, body = patches(), elastic(0.5)
    assert lattice(patches((6, 6)), body) is None  # few
    assert lattice(cut, object()) is None  # a body that doesn't know what depends on the offset
    far = Patches.under(BLOCK, None, plane(40.0, 0.0), SQUARE, (14, 14))
    assert lattice(far, body) is None  # beyond the table
    moved = np.array(cut.centre_mm)
    moved[3, 0] += 1e-3
    assert lattice(Patches(**{**vars(cut), "centre_mm": moved}), body) is None


@pytest.fixture
def on_both(monkeypatch):
    """Return the states of a press on a lattice and on a matrix, pair by pair."""
    made, plain = [], lattice

    def states(wanted, nu, across, **more):
        def walked(storage):
            monkeypatch.setattr(LatticeInfluence, "between", staticmethod(storage))
            state = pressed(wanted, on=elastic(nu), e=0.5, nu=nu, across=across, **more)
            return *state.path, *state.also

        fast = walked(lambda *given: made.append(plain(*given)) or made[-1])
        assert isinstance(made[-1], LatticeInfluence)
        return zip(fast, walked(lambda *_: None), strict=True)

    return states


AT = {"at_mm": (3, 2)}
RUBBED = (pushed(), pushed(0.1, 0.05, torque=0.03))
TURNED = Step(force_n={"z": 0.5}, move_mm=(1, 2, None), turn_deg=(0.3, 0.2, 20))
PRESSES = {
    "sphere": ball(6, force_n=(0, 0, 0.5), **AT),
    "held cone": Press(probe=Cone(apex_deg=130, diameter_mm=9, tip_mm=0.4), indentation_mm=0.3),
    "turned pillar, moved": Press(
        probe=Pillar(width_mm=5, edge_mm=0.7), steps=(Step(move_mm={"z": 0.2}), TURNED), **AT
    ),
    "rubbed": ball(6, friction=0.5, steps=RUBBED, **AT),
    "stuck": ball(6, friction=STUCK, steps=RUBBED, **AT),
}


@pytest.mark.parametrize("name", PRESSES)
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_a_press_is_the_same_on_a_lattice_and_on_a_matrix(nu, name, on_both):
    for each, same in on_both(PRESSES[name], nu, 12, increments=3):
        assert each.residual < 1e-9
        assert each.indentation_mm == pytest.approx(same.indentation_mm, rel=1e-8)
        assert_array_equal(each.slip, same.slip)
        near = 3e-8 * np.abs(same.traction_mpa).max()
        assert_allclose(each.traction_mpa, same.traction_mpa, atol=near)
        assert_allclose(each.force_n, same.force_n, atol=1e-8)
        assert_allclose(each.torques_nmm, same.torques_nmm, atol=1e-8)
        assert_allclose(each.move_mm, same.move_mm, rtol=3e-8, atol=1e-9)


PAIR = ((-1.3, 0.2), (1.3, 0.2))
TRIPLE = ((-1.3, 0.0), (1.3, 0.4), (0.1, 2.6))


@pytest.mark.parametrize("places", [PAIR, TRIPLE], ids=["two", "three"])
def test_balls_in_one_plane_share_a_lattice(places, on_both):
    """What one does to the other is that of a matrix between the same patches."""
    load = {"force_n": (0, 0, 0.05)}
    one, *others = (ball(2 + 0.2 * n, at_mm=at, **load) for n, at in enumerate(places))
    for each, other in on_both(one.model_copy(update={"also": tuple(others)}), 0.5, 10):
        assert each.indentation_mm == pytest.approx(other.indentation_mm, rel=1e-7)
        near = 3e-7 * other.peak_pressure_mpa
        assert_allclose(each.traction_mpa, other.traction_mpa, atol=near)


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_the_normal_part_of_a_compliance_is_that_of_the_whole(nu):
    """Graded cells under a sharp face, which no lattice holds; off the plane there is none."""
    face, box = Footprint(half_mm=(2.0, 1.5), is_round=False), Box(u0=-2, u1=2, v0=-1.5, v1=1.5)
    cut = Patches.under(BLOCK, face, UPRIGHT, box, (12, 10)).unloaded
    body = elastic(nu)
    assert_allclose(body.normal_surface(cut), body.surface(cut)[2::3, 2::3], rtol=1e-11)
    frames = cut.frames[:, [1, 0, 2]] * [[1.0], [-1.0], [1.0]]
    assert body.normal_surface(Rectangles(**{**vars(cut), "frames": frames})) is None


PATH = (pushed(z=0.3), pushed(0.05, 0.03, 0.3), pushed(0.05, 0.03, 0.3, torque=0.02))
ASIDE = {"at_mm": (-3, 1), "steps": PATH}


@pytest.mark.parametrize(
    ("body", "nu", "wanted"),
    [
        (BLOCK, 0.3, ball(3, friction=0.5, **ASIDE)),
        (BLOCK, 0.5, punch(2, friction=0.25, **ASIDE)),  # graded cells
        pytest.param(FINGER, 0.5, ball(3, friction=0.5, **ASIDE), marks=pytest.mark.slow),
    ],
)
def test_a_path_is_that_of_elimination(body, nu, wanted, monkeypatch):
    fast = pressed(wanted, body, nu=nu, across=10, increments=2)
    monkeypatch.setattr(SaddlePoint, "solve", lambda *_: None)
    slow = pressed(wanted, body, nu=nu, across=10, increments=2)
    assert 0 < slow.slip.sum() < len(slow.slip)
    for one, other in zip(fast.path, slow.path, strict=True):
        assert_array_equal(one.slip, other.slip)
        near = 1e-8 * other.peak_pressure_mpa
        assert_allclose(one.traction_mpa, other.traction_mpa, atol=near)
        assert_allclose(one.move_mm, other.move_mm, atol=1e-9)


def test_newtons_steps_are_few_where_patches_come_and_go_under_a_slide(monkeypatch):
    """A patch that touches in a part slides freely in it: its equation across has no compliance."""
    steps = []

    def counted(*given):
        found = solve_coulomb(*given)
        steps.append(found.steps)
        return found

    monkeypatch.setattr(load_step, "solve_coulomb", counted)
    way = (Step(move_mm={"z": 0.16}),) * 2 + (Step(move_mm={"x": 0.1}),) * 5
    state = pressed(ball(6, friction=0.3, steps=way), on=elastic(0.5), e=0.5, across=16)
    assert state.slip[state.traction_mpa[:, 2] > 0.0].all()
    assert max(steps) <= 10


def undone(back, force):
    return np.linalg.norm(back - force) < 0.3 * np.linalg.norm(force)


def test_two_balls_on_a_curved_body_have_an_inverse_each():
    """Their patches have the same places in planes of their own: one lattice would mix them up."""
    grids = [Patches.under(BLOCK, None, LEVEL, SQUARE, (8, 8)) for _ in range(2)]
    one = HalfSpace(1.0, 0.3).surface(grids[0].unloaded)
    n = 2 * len(one) // 3
    whole = np.kron(np.eye(2), one).reshape(n, 3, n, 3)
    influence = DenseInfluence(whole, grids, 0.3)
    force, rows = np.random.default_rng(5).normal(size=(n, 3)), np.arange(n)
    moved = influence.product(rows, force.T)
    assert undone(influence.approx_solve(rows, moved[..., None])[..., 0].T, force)
    push = influence.approx_push(rows, influence.normal_displacement(force[:, 2]))
    assert undone(push, force[:, 2])
