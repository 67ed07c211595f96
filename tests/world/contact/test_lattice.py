"""Compliance between equal patches by convolution, against the matrix that it stands for."""

import numpy as np
import pytest

from twin import Press, Sphere, Step
from twin.arrays import Floats
from twin.parts.body import Block
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.theory import halfspace
from twin.world.contact import region, together, unilateral
from twin.world.contact.between import Dense
from twin.world.contact.cells import Box
from twin.world.contact.contact import ContactState, press
from twin.world.contact.convolution import Convolution, _mix, inverse_of, spectra_of
from twin.world.contact.lattice import Lattice, lattice
from twin.world.contact.patches import Patches, Plane, candidate_patches
from twin.world.elasticity.compliance import Compliance

BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
UPRIGHT = Plane(origin_mm=np.array([4.0, -3.0, 0.0]), axes=np.eye(3))


def elastic(nu: float) -> Compliance:
    return Compliance(BLOCK, Material(youngs_modulus_mpa=0.5, poisson_ratio=nu))


def patches(across: tuple[int, int] = (14, 11)) -> Patches:
    return candidate_patches(BLOCK, None, UPRIGHT, Box(u0=-1.0, u1=1.5, v0=-0.9, v1=1.1), across)


def everyone(cut: Patches) -> Rectangles:
    return cut.unloaded


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_a_lattice_is_its_matrix(nu: float) -> None:
    cut, body, rng = patches(), elastic(nu), np.random.default_rng(1)
    found, k = lattice(cut, body), len(cut)
    assert isinstance(found, Lattice)
    matrix = body.surface(everyone(cut)).reshape(k, 3, k, 3)
    dense = Dense(matrix)
    force, rows, columns = rng.normal(size=(k, 3)), rng.permutation(k)[:20], rng.permutation(k)[:30]
    # distant patches by quadrature: at the distances where its order changes either value may come, 4e-10 apart
    close = {"rtol": 0.0, "atol": 1e-8 * matrix.max()}
    np.testing.assert_allclose(found.part(rows), dense.part(rows), **close)
    np.testing.assert_allclose(found.normal_part(rows, columns), dense.normal_part(rows, columns), **close)
    np.testing.assert_allclose(found.moved(force), dense.moved(force), **close)
    np.testing.assert_allclose(found.sunk(force[:, 2]), dense.sunk(force[:, 2]), **close)
    assert found.make_room(rows)
    single = {"rtol": 0.0, "atol": 3e-6 * np.abs(dense.moved(force)).max()}
    np.testing.assert_allclose(found.felt(force).T, dense.moved(force)[rows], **single)
    some = found.product(force[rows].T.astype(np.float32)) * found.unit
    np.testing.assert_allclose(some, np.einsum("kalb,lb->ak", matrix[rows][:, :, rows], force[rows]), **single)
    # what stands for a matrix is symmetric (Betti): f . C g = g . C f
    other = rng.normal(size=(k, 3))
    assert np.vdot(other, found.moved(force)) == pytest.approx(np.vdot(force, found.moved(other)), rel=1e-11)


def test_a_finite_body_is_not_left_out() -> None:
    cut, body = patches(), elastic(0.5)
    found, push = lattice(cut, body), np.ones(len(cut))
    assert found is not None
    alone = halfspace.compliance(cut.centre_mm, everyone(cut), 0.5, 0.5)[2::3, 2::3] @ push
    assert 0.01 < np.abs(found.sunk(push) - alone).max() / alone.max() < 0.3


def kernel_of(shape: tuple[int, int]) -> Floats:
    place = np.stack([*np.meshgrid(*map(np.arange, shape), indexing="ij"), np.zeros(shape)], axis=-1).reshape(-1, 3)
    one = Rectangles(centre_mm=np.zeros((1, 3)), frames=np.eye(3)[None], half_mm=np.full((1, 2), 0.5),
                     force_n=np.zeros((1, 3)))  # fmt: skip
    return halfspace.compliance(place, one, 1.0, 0.3).reshape(*shape, 3, 3)


def test_the_inverse_convolution_undoes_each_wave() -> None:
    """On fields of one frequency, wherever it lies among cosines and sines; mixed axes and signs included."""
    spectra = spectra_of(kernel_of((9, 12)))
    spectra[[3, 4]] = 0.0  # the inverse leaves out what couples normal and tangential motion
    found = inverse_of(spectra)
    assert found is not None
    waves = np.random.default_rng(0).normal(size=(1, 3, 17, 23))
    there, back, none = np.empty_like(waves), np.empty_like(waves), np.zeros((0, 0))
    _mix(spectra, none, waves, there)
    _mix(found, none, there, back)
    np.testing.assert_allclose(back, waves, atol=1e-11)


@pytest.mark.parametrize("shape", [(12, 12), (9, 13), (1, 5)])
def test_the_normal_part_alone_is_that_of_the_whole(shape: tuple[int, int]) -> None:
    spectra, field = spectra_of(kernel_of(shape)), np.zeros((3, *shape))
    field[2] = np.random.default_rng(0).normal(size=shape)
    whole = Convolution(spectra, np.float64).product(field)[2]
    np.testing.assert_allclose(Convolution(spectra[5:], np.float64).product(field[2]), whole, atol=1e-12)
    single = Convolution(spectra[5:], np.float32).product(field[2].astype(np.float32))
    np.testing.assert_allclose(single, whole, atol=1e-5 * np.abs(whole).max())


def test_what_is_no_lattice_has_none() -> None:
    cut, body = patches(), elastic(0.5)
    assert lattice(patches((6, 6)), body) is None  # few
    assert lattice(cut, object()) is None  # a body that can't say what depends on the offset
    far = candidate_patches(
        BLOCK,
        None,
        Plane(origin_mm=np.array([40.0, 0.0, 0.0]), axes=np.eye(3)),
        Box(u0=-1, u1=1, v0=-1, v1=1),
        (14, 14),
    )
    assert lattice(far, body) is None  # beyond the table
    moved = np.array(cut.centre_mm)
    moved[3, 0] += 1e-3
    assert lattice(Patches(**{**vars(cut), "centre_mm": moved}), body) is None


@pytest.mark.parametrize("friction", [0.0, 0.5, np.inf])
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_a_press_is_the_same_either_way(nu: float, friction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = [Step(force_n=(None, None, 0.5))] if friction == 0.0 else [
        Step(force_n=(0, 0, 0.5)), Step(force_n=(0.1, 0.05, 0.5), torque_nmm=0.03)
    ]  # fmt: skip
    wanted, body = Press(probe=Sphere(diameter_mm=6), at_mm=(3, 2), friction=friction, steps=tuple(steps)), elastic(nu)

    def pressed() -> ContactState:
        return press(wanted, BLOCK, body, patches_across=12, youngs_modulus_mpa=0.5, poisson_ratio=nu, increments=3)

    at_once = pressed()
    monkeypatch.setattr(region, "pushed", lambda *_: None)
    fast = pressed() if friction == 0.0 else at_once
    assert len(fast.slip) > unilateral.FEW
    monkeypatch.setattr(together, "lattice", lambda *_: None)
    plain = pressed()
    assert at_once.indentation_mm == pytest.approx(plain.indentation_mm, rel=1e-8)
    assert fast.residual < 1e-9
    assert fast.indentation_mm == pytest.approx(plain.indentation_mm, rel=1e-8)
    np.testing.assert_array_equal(fast.slip, plain.slip)
    np.testing.assert_allclose(fast.traction_mpa, plain.traction_mpa, atol=3e-8 * np.abs(plain.traction_mpa).max())
    np.testing.assert_allclose(fast.torques_nmm, plain.torques_nmm, atol=1e-8)


@pytest.mark.parametrize("at", [((-1.3, 0.2), (1.3, 0.2)), ((-1.3, 0.0), (1.3, 0.4), (0.1, 2.6))], ids=["two", "three"])
def test_balls_in_one_plane_share_a_lattice(
    at: tuple[tuple[float, float], ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What one does to the other is that of a matrix between the same patches."""
    made, plain = [], together.lattice
    monkeypatch.setattr(together, "lattice", lambda *given: made.append(plain(*given)) or made[-1])
    one, *others = (
        Press(probe=Sphere(diameter_mm=2 + 0.2 * number), at_mm=place, force_n=(0, 0, 0.05))
        for number, place in enumerate(at)
    )
    wanted, body = one.model_copy(update={"also": tuple(others)}), elastic(0.5)

    def pressed() -> ContactState:
        return press(wanted, BLOCK, body, patches_across=10, youngs_modulus_mpa=0.5, poisson_ratio=0.5)

    at_once = pressed()
    monkeypatch.setattr(region, "pushed", lambda *_: None)
    fast = pressed()
    assert isinstance(made[-1], Lattice)
    monkeypatch.setattr(together, "lattice", lambda *_: None)
    matrix = pressed()
    for each, other in zip((fast, *fast.also, at_once, *at_once.also), 2 * (matrix, *matrix.also), strict=True):
        assert each.indentation_mm == pytest.approx(other.indentation_mm, rel=1e-7)
        np.testing.assert_allclose(each.traction_mpa, other.traction_mpa, atol=3e-7 * other.peak_pressure_mpa)
