"""Frictionless contact on a plane in one loop: its conditions, which one solution meets, and the other solver."""

import numpy as np
import pytest

from twin import Cone, Cylinder, Pillar, Press, Sphere, Step
from twin.arrays import Bools, Floats
from twin.parts.body import Block
from twin.parts.material import Material
from twin.world.contact import pushed, region
from twin.world.contact.contact import ContactState, press
from twin.world.contact.contact_area import _ALONG, _FAR, _NEAR, _RAYS, _fitted, _squared_radius
from twin.world.contact.unilateral import TOLERANCE
from twin.world.elasticity.compliance import Compliance

BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
BODY = Compliance(BLOCK, Material(youngs_modulus_mpa=0.5, poisson_ratio=0.5))


@pytest.mark.parametrize("by_force", [(True,), (False,), (True, False), (True, True)])
@pytest.mark.parametrize("seed", range(4))
def test_its_conditions_are_met(seed: int, by_force: tuple[bool, ...]) -> None:
    """A definite matrix has one solution to them: what meets them is the answer."""
    rng, k, p = np.random.default_rng(seed), 30, len(by_force)
    root = rng.normal(size=(k, k))
    normal, gap = root @ root.T + 3.0 * np.eye(k), rng.uniform(0.0, 2.0, k)
    gap[3] = np.inf
    owner, given = np.arange(k) % p, rng.uniform(0.2, 1.5, p)
    active, force, depth, sunk = rng.random(k) < 0.3, rng.random(k), np.empty(p), np.empty(k)
    held = np.array(by_force)
    assert pushed.settle(normal, gap, owner, held, given, active, force, depth, sunk)
    opening = normal @ force + gap - depth[owner]
    np.testing.assert_allclose(sunk, normal @ force, atol=1e-11)
    assert active.any()
    assert not active[3]
    np.testing.assert_allclose(opening[active], 0.0, atol=1e-10)
    assert opening[~active].min() > -1e-10
    assert force.min() > -1e-10
    assert not force[~active].any()
    total = np.bincount(owner, force)
    np.testing.assert_allclose(np.where(held, total, depth), given, rtol=1e-11)
    assert pushed._residual(gap, depth, owner, held, given, active, force, sunk) < 1e-9
    wrong = force * 1.001
    assert pushed._residual(gap, depth, owner, held, given, active, wrong, normal @ wrong) > 1e-5


def test_what_is_not_finite_is_no_answer() -> None:
    """A compliance that isn't known, or a push on what can't be met: the general solver says what is wrong."""
    k, held = 6, np.array([True])
    for what in ("own", "all", "gap", "nan gap"):
        normal, gap = np.eye(k) + 0.1, np.linspace(0.0, 1.0, k)
        if what == "own":
            normal[4, 4] = np.nan
        elif what == "all":
            normal[:] = np.nan
        elif what == "gap":
            gap[:] = np.inf
        else:
            gap[4] = np.nan
        owner, given, active = np.zeros(k, int), np.ones(1), np.zeros(k, bool)
        force, depth, sunk = np.zeros(k), np.empty(1), np.empty(k)
        settled = pushed.settle(normal, gap, owner, held, given, active, force, depth, sunk)
        residual = pushed._residual(gap, depth, owner, held, given, active, force, sunk)
        assert not (settled and residual <= TOLERANCE), what


PRESSES = {
    "sphere": Press(probe=Sphere(diameter_mm=8), at_mm=(3, 2), force_n=(0, 0, 0.7)),
    "held cone": Press(probe=Cone(apex_deg=130, diameter_mm=9, tip_mm=0.4), indentation_mm=0.3),
    "sharp face": Press(probe=Cylinder(diameter_mm=5), at_mm=(-3, 2), force_n=(0, 0, 0.7)),
    "turned pillar, moved": Press(
        probe=Pillar(width_mm=5, edge_mm=0.4), at_mm=(3, 2),
        steps=(
            Step(move_mm=(None, None, 0.2)), Step(force_n={"z": 0.5}, move_mm=(1, 2, None), turn_deg=(0.3, 0.2, 20)),
        ),
    ),
    "two, one held": Press(
        probe=Sphere(diameter_mm=3), at_mm=(-1.5, 0), force_n=(0, 0, 0.1),
        also=(Press(probe=Sphere(diameter_mm=3), at_mm=(1.5, 0), indentation_mm=0.1),),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PRESSES)
def test_a_press_is_that_of_the_solver_for_all_cases(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which takes other patches' sets, another linear solver, the whole compliance and the gaps of every place."""
    taken, plain = [], region.pushed
    monkeypatch.setattr(region, "pushed", lambda *given: taken.append(plain(*given)) or taken[-1])

    def pressed() -> ContactState:
        return press(PRESSES[name], BLOCK, BODY, patches_across=10, youngs_modulus_mpa=0.5, poisson_ratio=0.5)

    fast = pressed()
    assert taken
    assert None not in taken
    monkeypatch.setattr(region, "pushed", lambda *_: None)
    slow = pressed()
    for one, other in zip((*fast.path, *fast.also), (*slow.path, *slow.also), strict=True):
        size = abs(other.force_n[2])
        assert one.indentation_mm == pytest.approx(other.indentation_mm, rel=1e-9)
        np.testing.assert_allclose(one.force_n, other.force_n, atol=1e-9 * size)
        np.testing.assert_allclose(one.torques_nmm, other.torques_nmm, atol=1e-8 * size)
        np.testing.assert_allclose(one.pressure_mpa, other.pressure_mpa, atol=3e-9 * other.peak_pressure_mpa)
        for what in ("area_mm2", "elastic_nmm", "move_mm"):
            np.testing.assert_allclose(getattr(one, what), getattr(other, what), rtol=3e-9)
        assert one.validity.steepest_slope == pytest.approx(other.validity.steepest_slope, rel=1e-7, abs=1e-7)


def test_others_are_left_to_the_solver_for_all_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """A probe that is held by side forces: what it feels of them has to be found."""
    taken, plain = [], region.pushed
    monkeypatch.setattr(region, "pushed", lambda *given: taken.append(plain(*given)) or taken[-1])
    free = Press(probe=Sphere(diameter_mm=8), steps=(Step(force_n=(0, 0, 0.5)),))
    state = press(free, BLOCK, BODY, patches_across=8, youngs_modulus_mpa=0.5, poisson_ratio=0.5)
    assert state.force_n[2] == pytest.approx(0.5)
    assert taken
    assert not any(taken)


def test_the_area_is_of_the_nearest_polynomial() -> None:
    rng = np.random.default_rng(0)
    place, pressure = rng.normal(size=(80, 2)), rng.uniform(0.1, 1.0, 80)

    def terms(chosen: Bools, size: float) -> Floats:
        u, v = ((place - place.mean(axis=0)) / size)[chosen].T
        return np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v, (u * u + v * v) ** 2])

    for fourth in (False, True):
        chosen = pressure <= np.median(pressure) if fourth else np.ones(80, bool)
        found, size = _fitted(place, pressure, np.flatnonzero(chosen), fourth)
        wanted = np.linalg.lstsq(terms(chosen, size)[:, : 6 + fourth], (pressure[chosen] / pressure.max()) ** 2)[0]
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("fourth", [False, True])
def test_a_term_that_others_make_up_is_left_out(fourth: bool) -> None:
    """Of two rows v^2 is one: the polynomial is no less near to the pressures."""
    place = np.array([(a, b) for a in range(6) for b in range(2)], float)
    pressure = np.random.default_rng(1).uniform(0.1, 1.0, 12)
    found, size = _fitted(place, pressure, np.arange(12), fourth)
    u, v = ((place - place.mean(axis=0)) / size).T
    terms = np.column_stack([np.ones(12), u, v, u * u, u * v, v * v, (u * u + v * v) ** 2])[:, : 6 + fourth]
    squared = (pressure / pressure.max()) ** 2
    np.testing.assert_allclose(terms @ found, terms @ np.linalg.lstsq(terms, squared)[0], atol=1e-12)
    assert np.abs(found).max() < 1e3
    one_row = _fitted(place[::2], pressure[::2], np.arange(6), fourth)[0]
    assert np.isfinite(one_row).all()


def test_a_contact_ends_where_its_polynomial_first_vanishes() -> None:
    """Long strides pass over no place where it dips below 0, however briefly: as told by all places, one by one."""
    rng, dips = np.random.default_rng(2), 0
    radius, angle = np.linspace(_NEAR, _FAR, _ALONG), np.arange(_RAYS) * 2.0 * np.pi / _RAYS
    for _ in range(300):
        once = rng.uniform(0.4, 1.3)  # near to a double root there along every ray
        found = np.array([once**4 - rng.uniform(-1e-3, 1e-3), 0.0, 0.0, -2 * once**2, 0.0, -2 * once**2, 1.0])
        found[1:3] = rng.normal(0.0, 1e-4, 2)
        u, v = radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]
        height = found[0] + found[1] * u + found[2] * v + found[3] * (u * u + v * v) + (u * u + v * v) ** 2
        below = height < 0.0
        first, rays = below.argmax(axis=1), np.arange(_RAYS)
        if not below.any(axis=1).all():
            assert _squared_radius(found, 1.0) == np.inf
            continue
        here, before = height[rays, first], height[rays, first - 1]
        ends = radius[first] - (_FAR - _NEAR) / (_ALONG - 1) * here / (here - before)
        assert _squared_radius(found, 1.0) == pytest.approx(float((ends**2).mean()), rel=1e-9)
        dips += int((height[:, -1] > 0.0).all())
    assert dips > 50
