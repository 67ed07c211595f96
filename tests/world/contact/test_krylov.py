"""Newton steps by iteration and by a kept inverse against elimination, on a contact's own systems."""

from dataclasses import replace

import numpy as np
import pytest
from test_contact import BLOCK, FINGER, HalfSpace

from twin.arrays import Floats, Ints
from twin.parts.body import Body
from twin.parts.press import Cylinder, Press, Sphere, Step
from twin.world.contact import between, coulomb, iterated, released
from twin.world.contact.between import Inverted
from twin.world.contact.cells import Box
from twin.world.contact.contact import ContactState, press
from twin.world.contact.iterated import Iterated, near_lattice
from twin.world.contact.krylov import Krylov
from twin.world.contact.linear import LinearSolver, LinearSystem
from twin.world.contact.patches import Plane, candidate_patches
from twin.world.contact.pattern import Pattern
from twin.world.contact.released import Released


def random_pattern(rng: np.random.Generator, n: int, touching: Ints | None = None) -> Pattern:
    if touching is None:
        touching = np.sort(rng.choice(2 * n, n, replace=False))
    n = len(touching)
    slips, turn = rng.random(n) < 0.5, rng.uniform(0, 2 * np.pi, n)
    ahead = np.where(slips[:, None], np.column_stack([np.cos(turn), np.sin(turn)]), [1.0, 0.0])
    share = np.where(slips, 10 ** rng.uniform(-6, 0, n), 1.0)
    return Pattern(touching=touching, slips=slips, ahead=ahead, mu=np.where(slips, 0.4, 0.0), share=share)


def test_forces_and_what_is_seen_of_them_are_adjoint() -> None:
    rng = np.random.default_rng(0)
    pattern = random_pattern(rng, 7)
    x, u = rng.normal(size=pattern.size), rng.normal(size=(3, 7))
    assert np.vdot(pattern.forces(x), u) == pytest.approx(np.vdot(x, pattern.pulled(u)))
    np.testing.assert_allclose(pattern.seen(pattern.forces(x)), x)
    two = rng.normal(size=(pattern.size, 2))
    np.testing.assert_array_equal(pattern.forces(two)[..., 1], pattern.forces(two[:, 1]))


class Matrix:
    """Products with a matrix, and the inverses of its normal and its tangential part, in double precision."""

    precision, finest, unit = np.float64, 1e-10, 1.0

    def __init__(self, compliance: Floats) -> None:
        self._whole = compliance

    def make_room(self, touching: Ints) -> bool:
        self._touching = touching
        self._part = self._whole[touching][:, :, touching].transpose(1, 0, 3, 2)
        return True

    def felt(self, force: Floats) -> Floats:
        return np.einsum("kalb,lb->ak", self._whole[self._touching], force)

    def product(self, force: Floats) -> Floats:
        return np.einsum("akbl,bl->ak", self._part, force)

    def roughly(self, displacement: Floats) -> Floats:
        n = displacement.shape[1]
        along = np.linalg.solve(self._part[:2, :, :2].reshape(2 * n, 2 * n), displacement[:2].reshape(2 * n, -1))
        normal = np.linalg.solve(self._part[2, :, 2], displacement[2])
        return np.concatenate([along.reshape(2, n, -1), normal[None]])


@pytest.mark.parametrize("motions", [0, 3])
@pytest.mark.parametrize("kept", [False, True])
def test_iteration_and_a_kept_inverse_agree_with_elimination(motions: int, kept: bool) -> None:
    rng = np.random.default_rng(1)
    n, k = 40, 80
    place = rng.uniform(0, 8, (k, 2))
    away = np.hypot(*(place[:, None] - place).T)
    near = 1 / np.sqrt(away**2 + 0.2)  # a smooth kernel like that of elasticity, with some coupling between axes
    mixed = np.array([[1.0, 0.1, 0.05], [0.1, 0.9, -0.05], [0.05, -0.05, 1.1]])
    compliance = 3e-3 * np.einsum("kl,ab->kalb", near + 2 * np.eye(k), mixed)
    carried = rng.normal(size=(k, 3, 5))
    solver = Released(compliance, carried) if kept else Krylov(Matrix(compliance))
    pattern = random_pattern(rng, n)
    for _ in range(3):
        system = random_system(rng, pattern, carried, motions)
        right, balance = 3e-3 * rng.normal(size=pattern.size), rng.normal(size=motions)
        exact = coulomb._eliminated(compliance, system, right, balance)
        found = solved(solver, compliance, system, right, balance)
        for now, wanted in zip(found, exact, strict=True):
            np.testing.assert_allclose(now, wanted, atol=1e-7 * np.abs(wanted).max(initial=0.0))
        pattern = random_pattern(rng, n, np.sort(rng.choice(pattern.touching, n - 4, replace=False)))  # four leave


def random_system(rng: np.random.Generator, pattern: Pattern, carried: Floats, motions: int) -> LinearSystem:
    """Return a system with jumps of slipping patches along their drags, and of one that left."""
    touching, free = pattern.touching, np.arange(motions) + 1
    jump = np.zeros((len(carried), 3))
    jump[touching, :2] = np.where(pattern.slips, rng.normal(size=len(touching)), 0.0)[:, None] * pattern.ahead
    jump[rng.choice(np.setdiff1d(np.arange(len(carried)), touching))] = rng.normal(size=3)
    held = carried[touching][:, :, free].transpose(1, 0, 2)
    slope = -held[2] + np.where(rng.random((len(touching), 1)) < 0.5, rng.normal(size=(len(touching), motions)), 0.0)
    return LinearSystem(
        pattern=pattern, jump=jump, shift=3e-3 * (1 - pattern.share), free=free, carried=held, slope=slope,
        reach=10 ** rng.uniform(0, 1, motions),
    )  # fmt: skip


def solved(
    solver: LinearSolver, compliance: Floats, system: LinearSystem, right: Floats, balance: Floats
) -> list[Floats]:
    """Return a solution; every one leaves a little: mend what is left, as Newton's steps do."""
    found = [np.zeros(system.pattern.size), np.zeros(len(balance))]
    for _ in range(4):
        left = right - _rows(compliance, system, found)
        change = solver.solve(system, left, balance - system.pull.T @ found[0], 1e-3)
        assert change is not None
        found = [now + part for now, part in zip(found, change, strict=True)]
        right, system = right - system.seen(moved(compliance, system)), replace(system, jump=0.0 * system.jump)
    return found


def moved(compliance: Floats, system: LinearSystem) -> Floats:
    """Return (3, n) how the jump moves the patches in contact."""
    return np.einsum("kalb,lb->ak", compliance[system.pattern.touching], system.jump)


def _rows(compliance: Floats, system: LinearSystem, found: list[Floats]) -> Floats:
    pattern, rows = system.pattern, system.pattern.touching
    part = compliance[rows][:, :, rows]
    seen = system.seen(np.einsum("kalb,bl->ak", part, pattern.forces(found[0])))
    seen[pattern.aside] += system.shift * found[0][pattern.aside]
    return seen + system.motion @ found[1]


def test_an_inverse_serves_sets_that_lost_and_gained_patches() -> None:
    rng = np.random.default_rng(2)
    place = rng.uniform(0, 8, (60, 2))
    normal = 1 / np.sqrt(np.sum((place[:, None] - place) ** 2, axis=2) + 0.2) + 2 * np.eye(60)
    first, depth = np.arange(0, 50), rng.normal(size=60)
    inverted, made = Inverted(normal), set()
    for rows in (first, first[7:], np.r_[4:53], np.r_[0:3, 9:52], np.r_[3:33]):  # the last is too small a part
        found = inverted.pushes(rows, depth[rows])
        made.add(id(inverted._inverse))
        wanted = np.linalg.solve(normal[np.ix_(rows, rows)], depth[rows])
        np.testing.assert_allclose(found, wanted, atol=3e-6 * np.abs(wanted).max())
    assert len(made) == 2


def test_a_gathered_part_of_a_matrix_serves_sets_that_lost_and_gained_patches() -> None:
    rng = np.random.default_rng(4)
    k, middle = 40, Plane(origin_mm=np.zeros(3), axes=np.eye(3))
    near = near_lattice(candidate_patches(BLOCK, None, middle, Box(u0=-1, u1=1, v0=-1, v1=1), (8, 8)), 0.5)
    assert near is not None
    root = rng.normal(size=(3 * k, 3 * k))
    matrix = 1e-3 * (root + root.T).reshape(k, 3, k, 3)
    matrix += 2e-2 * np.eye(3 * k).reshape(k, 3, k, 3)
    part, force = iterated._OnMatrix(matrix, near), rng.normal(size=(k, 3))
    for rows in (np.arange(5, 25), np.r_[7:26, 30], np.r_[0:7, 9:26], np.arange(8, 14)):  # the last is too small a part
        assert part.make_room(rows)
        moved = np.einsum("kalb,lb->ak", matrix[rows], force)
        np.testing.assert_allclose(part.felt(force), moved, atol=3e-6 * np.abs(moved).max())
        own = np.einsum("kalb,bl->ak", matrix[rows][:, :, rows], force[rows].T)
        found = part.product(force[rows].T.astype(np.float32)) * part.unit
        np.testing.assert_allclose(found, own, atol=3e-6 * np.abs(own).max())
    assert len(part._kept) == 6


@pytest.mark.parametrize(("body", "nu"), [(BLOCK, 0.3), pytest.param(FINGER, 0.5, marks=pytest.mark.slow)])
def test_a_path_is_the_same_either_way(body: Body, nu: float, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = (
        Step(force_n=(0, 0, 0.3)),
        Step(force_n=(0.05, 0.03, 0.3)),
        Step(force_n=(0.05, 0.03, 0.3), torque_nmm=0.02),
    )
    wanted = Press(probe=Sphere(diameter_mm=3), at_mm=(-3, 1), friction=0.5, steps=steps)

    def walked() -> ContactState:
        return press(
            wanted, body, HalfSpace(1.0, nu), patches_across=10, youngs_modulus_mpa=1.0, poisson_ratio=nu, increments=2
        )

    fast = walked()
    assert len(fast.slip) > coulomb._FEW
    monkeypatch.setattr(coulomb, "_FEW", 10**6)
    slow = walked()
    assert 0 < slow.slip.sum() < len(slow.slip)
    for one, other in zip(fast.path, slow.path, strict=True):
        np.testing.assert_array_equal(one.slip, other.slip)
        np.testing.assert_allclose(one.traction_mpa, other.traction_mpa, atol=1e-8 * other.peak_pressure_mpa)
        np.testing.assert_allclose(one.move_mm, other.move_mm, atol=1e-9)


def test_a_matrix_is_iterated_on_until_an_inverse_pays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(iterated, "MANY", coulomb._FEW)
    monkeypatch.setattr(between, "MANY", coulomb._FEW)
    solvers: list[Iterated] = []
    made, inverses = Iterated.__init__, list[int]()
    monkeypatch.setattr(Iterated, "__init__", lambda self, *given: (made(self, *given), solvers.append(self))[0])
    inverted = released.full_inverse
    monkeypatch.setattr(released, "full_inverse", lambda part: inverted(inverses.append(len(part)) or part))
    sheared = Step(force_n=(0.05, 0.03, 0.3))
    wanted = Press(probe=Sphere(diameter_mm=3), at_mm=(-3, 1), friction=0.5, steps=(sheared,))

    def pressed(increments: int) -> ContactState:
        return press(
            wanted, FINGER, HalfSpace(1.0, 0.3), patches_across=11, youngs_modulus_mpa=1.0, poisson_ratio=0.3,
            increments=increments,
        )  # fmt: skip

    pressed(1)
    assert len(solvers) == 1
    assert not inverses
    many = pressed(6)
    few = len(inverses)
    assert few > 0
    monkeypatch.setattr(iterated, "_PAYS", 0.0)
    kept = pressed(6)
    assert len(inverses) - few >= few
    np.testing.assert_allclose(many.traction_mpa, kept.traction_mpa, atol=1e-8 * kept.peak_pressure_mpa)


def test_patches_of_unequal_cells_have_no_lattice_near() -> None:
    face, upright = Cylinder(diameter_mm=2), Plane(origin_mm=np.zeros(3), axes=np.eye(3))
    graded = candidate_patches(BLOCK, face, upright, Box(u0=-1, u1=1, v0=-1, v1=1), (12, 12))
    equal = candidate_patches(BLOCK, None, upright, Box(u0=-1, u1=1, v0=-1, v1=1), (12, 12))
    assert near_lattice(graded, 0.5) is None
    near = near_lattice(equal, 0.5)
    assert near is not None
    whole = HalfSpace(1.0, 0.5).surface(equal.unloaded)
    force = np.random.default_rng(3).normal(size=(len(equal), 3))
    moved = (whole @ force.reshape(-1) / whole.diagonal().mean()).reshape(-1, 3).T.astype(np.float32)
    back = near.forces(np.arange(len(equal)), moved[..., None])[..., 0].T
    assert np.linalg.norm(back - force) < 0.3 * np.linalg.norm(force)
