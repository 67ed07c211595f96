"""Coulomb's friction against partial slip in closed form, and what must hold for every coefficient."""

import math
from collections import Counter
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from test_contact import BLOCK, FINGER, HalfSpace, down, only, pressed

from twin.errors import ContactError, NotSettled, TwinError
from twin.parts.load import Rectangles
from twin.parts.press import Cone, Cylinder, Pillar, Press, Probe, Sphere, Step
from twin.theory.contact import oblique_motion
from twin.theory.friction import sheared_motion, stick_radius, twisted
from twin.world.contact import friction, refused
from twin.world.contact.contact import ContactState, press

BALL = Sphere(diameter_mm=30)
MU, PUSH = 0.5, 0.5


class Uncoupled(HalfSpace):
    """A half-space whose normal forces move nothing sideways and the other way round, as Mindlin's theory has it."""

    def surface(self, rectangles: Rectangles) -> np.ndarray:
        k = len(rectangles)
        whole = np.array(super().surface(rectangles)).reshape(k, 3, k, 3)
        whole[:, 2, :, :2] = whole[:, :2, :, 2] = 0.0
        return whole.reshape(3 * k, 3 * k)


class Yielding(HalfSpace):
    """A half-space on a support that gives way: a push moves all of the surface down and sideways alike."""

    def surface(self, rectangles: Rectangles) -> np.ndarray:
        give = np.tile([1.0, 0.0, 1.0], len(rectangles))
        return np.asarray(super().surface(rectangles) + 0.5 * np.outer(give, give))


def rubbed(*steps: Step, probe: Probe = BALL, friction: float = MU, **more: float) -> tuple[ContactState, ...]:
    """Few increments: these loads grow without turning, which one increment follows as well as many."""
    return pressed(Press(probe=probe, friction=friction, steps=steps), **{"increments": 3, **more}).path


def pushed(x: float = 0.0, y: float = 0.0, z: float = PUSH, torque: float | None = None) -> Step:
    return Step(force_n=(x, y, z), torque_nmm=torque)


def breaks(state: ContactState) -> float:
    """Return by how much the tractions leave Coulomb's cone, over the peak pressure (flat bodies)."""
    sideways = np.hypot(state.traction_mpa[:, 0], state.traction_mpa[:, 1])
    return float(np.max(sideways - state.friction * state.pressure_mpa)) / state.peak_pressure_mpa


def patch_area(state: ContactState) -> np.ndarray:
    return np.asarray(4.0 * np.prod(only(state).half_mm, axis=1))


# --- closed forms ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [pytest.param(0.3, marks=pytest.mark.slow), 0.5])
@pytest.mark.parametrize("share", [pytest.param(0.3, marks=pytest.mark.slow), 0.6, 0.9])
def test_a_sheared_sphere_sticks_inside_and_slips_around(nu: float, share: float) -> None:
    """Cattaneo and Mindlin, whose theory leaves out what couples normal and tangential motion (nothing at nu = 0.5)."""
    force = share * MU * PUSH
    whole = Press(probe=BALL, friction=MU, steps=(pushed(), pushed(force)))
    state = press(
        whole, BLOCK, Uncoupled(1.0, nu), patches_across=20, youngs_modulus_mpa=1.0, poisson_ratio=nu, increments=2
    )
    one, sheared = state.path
    a = one.contact_radius_mm
    assert not one.slip.any()
    assert sheared.move_mm[0] == pytest.approx(sheared_motion(a, force, PUSH, MU, 1.0, nu), rel=0.01)
    area = patch_area(sheared)
    sticks = math.sqrt(area[~sheared.slip].sum() / area.sum())  # a radius averaged over direction, as a is
    assert sticks == pytest.approx(stick_radius(1.0, force, PUSH, MU), rel=0.02)
    assert breaks(sheared) < 1e-8
    # The collinear residual: what the traction across the force, left out in theory, is of the traction along it.
    across, along = (np.abs(sheared.traction_mpa[:, axis]).max() for axis in (1, 0))
    assert across / along < (0.07 if nu == 0.3 else 0.13)


@pytest.mark.parametrize(
    "stuck_share", [pytest.param(0.9, marks=pytest.mark.slow), pytest.param(0.7, marks=pytest.mark.slow), 0.4]
)
def test_a_twisted_sphere(stuck_share: float) -> None:
    a = pressed(Press(probe=BALL, force_n=(0, 0, PUSH)), across=18).contact_radius_mm
    turn, torque = twisted(stuck_share * a, a, PUSH, MU, 1.0, 0.5)
    _, state = rubbed(pushed(), pushed(torque=torque), across=18, increments=2)
    assert math.radians(state.turn_deg) == pytest.approx(turn, rel=0.03)
    assert state.torque_nmm == pytest.approx(torque, rel=1e-8)
    area = patch_area(state)
    assert math.sqrt(area[~state.slip].sum() / area.sum()) == pytest.approx(stuck_share, abs=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_a_dragged_sphere_slips_everywhere_and_follows(nu: float) -> None:
    one, slid, further = rubbed(
        Step(force_n={"z": PUSH}), Step(move_mm=(0.4, None, None)), Step(move_mm=(0.2, None, None)), nu=nu
    )
    for state in (slid, further):
        assert state.slip.all()
        sideways = np.hypot(state.traction_mpa[:, 0], state.traction_mpa[:, 1])
        np.testing.assert_allclose(sideways, MU * state.pressure_mpa, rtol=1e-8)
        forces = only(state).force_n
        assert np.hypot(forces[:, 0], forces[:, 1]).sum() == pytest.approx(MU * state.force_n[2], rel=1e-8)
        assert state.force_n[0] == pytest.approx(MU * state.force_n[2], rel=1e-4)
    middle = [only(s).force_n[:, 2] @ only(s).centre_mm[:, 0] / s.force_n[2] for s in (slid, further)]
    assert middle[1] - middle[0] == pytest.approx(0.2, rel=0.02)
    # Once all of it slips, friction takes mu P for every millimetre; what comes off within an increment isn't counted.
    assert further.dissipated_nmm - slid.dissipated_nmm == pytest.approx(0.2 * MU * PUSH, rel=0.05)
    assert one.dissipated_nmm <= 0.01 * slid.dissipated_nmm


# --- limits --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [pytest.param(0.3, marks=pytest.mark.slow), 0.5])
def test_much_friction_sticks(nu: float) -> None:
    steps = (pushed(), pushed(0.1), pushed(0.1, torque=0.05))
    stuck, much = (rubbed(*steps, friction=mu, nu=nu)[-1] for mu in (math.inf, 50.0))
    assert not much.slip.any()
    np.testing.assert_allclose(much.traction_mpa, stuck.traction_mpa, atol=1e-9 * stuck.peak_pressure_mpa)
    np.testing.assert_allclose(much.move_mm, stuck.move_mm, atol=1e-9)
    assert much.turn_deg == pytest.approx(stuck.turn_deg, rel=1e-9)


@pytest.mark.parametrize("probe", [BALL, Pillar(width_mm=4, length_mm=7)])
def test_little_friction_slides(probe: Probe) -> None:
    free, little = (rubbed(Step(force_n={"z": PUSH}), probe=probe, friction=mu, nu=0.3)[-1] for mu in (0.0, 1e-6))
    np.testing.assert_allclose(little.traction_mpa, free.traction_mpa, atol=3e-6 * free.peak_pressure_mpa)
    assert little.indentation_mm == pytest.approx(free.indentation_mm, rel=1e-6)


def test_the_mirror_image_of_a_path() -> None:
    path = rubbed(pushed(), pushed(0.15, 0.05, torque=0.04), pushed(-0.1, 0.1, 0.4, torque=0.0), nu=0.4)
    other = rubbed(pushed(), pushed(-0.15, 0.05, torque=-0.04), pushed(0.1, 0.1, 0.4, torque=0.0), nu=0.4)
    for one, image in zip(path, other, strict=True):
        np.testing.assert_allclose(image.move_mm, one.move_mm * [-1, 1, 1], atol=1e-9)
        assert image.slip.sum() == one.slip.sum()
        assert image.dissipated_nmm == pytest.approx(one.dissipated_nmm, abs=1e-10)


# --- history -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_order_of_pushing_and_shearing_counts() -> None:
    """Grown together below mu nothing slips, and the sphere goes further than when it is sheared after the push."""
    force = 0.6 * MU * PUSH
    together = rubbed(pushed(force), across=16, increments=8)[-1]
    _, after = rubbed(pushed(), pushed(force), across=16)
    a = after.contact_radius_mm
    assert not together.slip.any()
    assert together.move_mm[0] == pytest.approx(oblique_motion(a, force, 1.0, 0.5), rel=0.03)
    assert after.slip.any()
    assert together.dissipated_nmm < 0.01 * after.dissipated_nmm
    assert after.move_mm[0] == pytest.approx(sheared_motion(a, force, PUSH, MU, 1.0, 0.5), rel=0.01)


def test_more_push_under_shear_holds_what_has_slipped() -> None:
    """Mindlin and Deresiewicz: a push that grows under a constant side force moves nothing sideways."""
    light, force = 0.2, 0.07
    _, sheared, held = rubbed(pushed(z=light), pushed(force, z=light), pushed(force), across=16)
    assert sheared.move_mm[0] == pytest.approx(
        sheared_motion(sheared.contact_radius_mm, force, light, MU, 1.0, 0.5), rel=0.015
    )
    assert held.move_mm[0] == pytest.approx(sheared.move_mm[0], rel=0.005)
    assert not held.slip.any()
    assert held.dissipated_nmm == pytest.approx(sheared.dissipated_nmm)


def test_taking_the_side_force_back_leaves_a_share_of_the_motion() -> None:
    """Mindlin: unloading slips the other way, at twice the limit: d = d(Q) - 2 d((Q - 0) / 2)."""
    force = 0.8 * MU * PUSH
    _, sheared, back = rubbed(pushed(), pushed(force), pushed(), across=16)
    a = sheared.contact_radius_mm
    full, half = (sheared_motion(a, f, PUSH, MU, 1.0, 0.5) for f in (force, force / 2))
    assert back.move_mm[0] == pytest.approx(full - 2 * half, rel=0.04)
    assert back.dissipated_nmm > sheared.dissipated_nmm > 0


@pytest.mark.parametrize("friction", [MU, math.inf])
def test_a_sphere_that_is_lifted_over_is_pressed_anew_where_it_is(friction: float) -> None:
    small, again = Sphere(diameter_mm=5), Step(force_n={"z": 0.1})
    over = rubbed(down(0.1), Step(move_mm=(0.3, 0.1, -1)), again, probe=small, friction=friction)[-1]
    fresh = rubbed(again, probe=small, friction=friction)[-1]
    assert over.indentation_mm == pytest.approx(fresh.indentation_mm, rel=5e-3)
    middle = only(over).force_n[:, 2] @ only(over).centre_mm / over.force_n[2]
    np.testing.assert_allclose(middle, [0.3, 0.1, 0.0], atol=5e-3)
    np.testing.assert_allclose(over.force_n[:2], 0.0, atol=1e-3 * over.force_n[2])


def test_many_small_steps_are_taken_in_few_parts_each(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    parts = friction._parts

    def counted(*arguments: Any) -> int:
        taken.append(parts(*arguments))
        return taken[-1]

    monkeypatch.setattr(friction, "_parts", counted)
    side, torque = 0.6 * MU * PUSH, 0.1 * MU * PUSH
    ramps = [[pushed(z=PUSH * s), pushed(side * s), pushed(side, torque=torque * s)] for s in np.arange(1, 13) / 12]
    small = rubbed(*(ramp[stage] for stage in range(3) for ramp in ramps), across=12, increments=8)
    assert np.mean(taken) < 3
    large = rubbed(*ramps[-1], across=12, increments=8)
    for one, other in zip(small[11::12], large, strict=True):
        np.testing.assert_allclose(one.move_mm, other.move_mm, atol=2e-3 * np.abs(other.move_mm).max())
        assert one.turn_deg == pytest.approx(other.turn_deg, rel=0.01, abs=1e-9)
    assert large[1].slip.any()


@pytest.mark.parametrize(("jump", "settles"), [(6e-3, True), (6e-2, False)])
def test_a_slide_that_jumps_as_a_patch_comes_and_goes(
    jump: float, settles: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over half a patch: where a slide jumps less than the model can tell, either end is an answer."""
    there, slide = [False], friction._slide

    def jumping(grid: friction.FrictionGrid, *given: Any) -> np.ndarray:
        there[0] = not there[0]
        return slide(grid, *given) + there[0] * jump * float(grid.patches.half_mm.min())

    monkeypatch.setattr(friction, "_slide", jumping)
    drag = Step(force_n={"z": PUSH}, move_mm=(0.4, None, None))
    with nullcontext() if settles else pytest.raises(NotSettled, match="does not settle"):
        rubbed(drag, across=8, increments=1)


def test_a_slide_that_jumps_where_it_ends_is_met_in_between(monkeypatch: pytest.MonkeyPatch) -> None:
    """By 1.6 % of half a patch, down where the probe slid far and up where it did not: the middle is 0.8 % off both."""
    slide = friction._slide

    def jumping(grid: friction.FrictionGrid, memory: friction.Memory, *given: Any) -> np.ndarray:
        moved, jump = slide(grid, memory, *given), 1.6e-2 * float(grid.patches.half_mm.min())
        return moved + jump * (memory.slid_mm < moved + 0.5 * jump)

    monkeypatch.setattr(friction, "_slide", jumping)
    state = rubbed(Step(force_n={"z": PUSH}, move_mm=(0.4, None, None)), across=8, increments=1)[0]
    assert state.slip.any()
    assert state.residual <= 1e-8


# --- any body ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("probe", [Sphere(diameter_mm=3), Cylinder(diameter_mm=4)])
def test_a_press_on_the_finger(probe: Probe) -> None:
    steps = (Step(force_n=(0, 0, 0.3)), Step(force_n=(0.03, -0.05, 0.3)))
    state = pressed(Press(probe=probe, at_mm=(-3, 1), friction=MU, steps=steps), FINGER, nu=0.45)
    np.testing.assert_allclose(state.force_n, [0.03, -0.05, 0.3], atol=1e-8 * 0.3)
    assert state.residual <= 1e-8
    normal = only(state).frames[:, 2]
    sideways = np.linalg.norm(state.traction_mpa - state.pressure_mpa[:, None] * normal, axis=1)
    assert np.max(sideways - MU * state.pressure_mpa) <= 1e-8 * state.peak_pressure_mpa
    assert 0 < state.slip.sum() < len(state.slip)


@pytest.mark.parametrize("probe", [BALL, Pillar(width_mm=6, length_mm=4)])
def test_a_body_that_moves_sideways_as_a_whole_takes_the_probe_along(probe: Probe) -> None:
    """A probe that is free sideways feels nothing of it: the same tractions, at a place that has moved."""
    wanted = Press(probe=probe, friction=0.05, steps=(pushed(), pushed(0.01, 0.005)))
    fixed, moved = (
        press(wanted, BLOCK, surface, patches_across=10, youngs_modulus_mpa=1.0, poisson_ratio=0.5, increments=2)
        for surface in (HalfSpace(1.0, 0.5), Yielding(1.0, 0.5))
    )
    assert len(fixed.slip) == len(moved.slip)
    np.testing.assert_allclose(moved.traction_mpa, fixed.traction_mpa, atol=1e-6 * fixed.peak_pressure_mpa)
    give = 0.5 * (0.01 + PUSH)
    np.testing.assert_allclose(moved.move_mm - fixed.move_mm, [give, 0, give], atol=1e-6)


@pytest.mark.parametrize(
    ("words", "probe", "steps"),
    [
        ("with friction 0.5 less than 0.25 N", BALL, (pushed(), pushed(0.2, 0.2))),
        ("times what friction 0.5 can carry", BALL, (pushed(), pushed(torque=0.3))),
        ("times what friction 0.5 can carry", BALL, (pushed(), pushed(0.2, torque=0.15))),
        ("times what friction 0.5 can carry", BALL, (down(0.1), Step(force_n=(0.5, None, None)))),
        ("slides", Pillar(width_mm=4), (Step(force_n={"z": 0.5}), Step(move_mm=(0.6, None, None)))),
        ("slides", BALL, (Step(force_n={"z": 0.5}), Step(move_mm=(None, 8, None)))),
        ("lifted", Pillar(width_mm=4), (down(0.1), Step(move_mm=(3, None, -1)), down(1))),
    ],
)
def test_refusals(words: str, probe: Probe, steps: tuple[Step, ...]) -> None:
    with pytest.raises(ContactError, match=words):
        rubbed(*steps, probe=probe)


def test_a_force_at_the_edge_of_the_cone_is_refused_in_its_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The share is an estimate: where every patch slips, one that is just under 1 tells the cause as well."""
    monkeypatch.setattr(refused, "asked_share", lambda *_: 0.97)
    with pytest.raises(ContactError, match=r"are 0\.97 times what friction 0\.5 can carry on this surface"):
        rubbed(pushed(), pushed(torque=0.3))


def random_press(rng: np.random.Generator) -> Press:
    probe: Probe = (
        Sphere(diameter_mm=float(rng.uniform(2, 20))),
        Cylinder(diameter_mm=float(rng.uniform(1.5, 12))),
        Pillar(width_mm=float(rng.uniform(1.5, 8)), length_mm=float(rng.uniform(1.5, 15))),
    )[rng.integers(3)]
    friction, push = float(10 ** rng.uniform(-1.5, 0.5)), float(10 ** rng.uniform(-2, 0.3))
    side, angle = friction * push * rng.uniform(0, 1.1), rng.uniform(0, 2 * math.pi)
    x, y = float(side * math.cos(angle)), float(side * math.sin(angle))
    torque = float(friction * push * 0.3 * rng.uniform(-1, 1))
    drag = Step(force_n=(None, None, push), move_mm=(float(rng.normal(0, 0.1)), float(rng.normal(0, 0.1)), None))
    paths = (
        (pushed(x, y, push),),
        (pushed(x, y, push), pushed(x, y, push, torque)),
        (drag,),
        (Step(force_n=(None, None, push), turn_deg=float(rng.normal(0, 8))), pushed(x, y, 0.7 * push)),
        (pushed(x, y, push, torque), pushed(-x, -y, push, 0.0), pushed(0, 0, push / 2)),
    )
    at = float(rng.uniform(-40, 40)), float(rng.uniform(-35, 35))
    return Press(probe=probe, at_mm=at, friction=friction, steps=(pushed(z=push), *paths[rng.integers(5)]))


@pytest.mark.slow
@pytest.mark.parametrize("part", range(6))
def test_random_presses_end_in_balance_or_say_why_not(part: int) -> None:
    known = ("can be balanced", "can carry", "slides", "sinks in", "over the edge")
    said: Counter[str] = Counter()
    for number in range(50 * part, 50 * part + 50):
        rng = np.random.default_rng(number)
        try:
            state = pressed(random_press(rng), nu=(0.5, 0.45, 0.3)[number % 3], across=10)
        except TwinError as refused:
            said[next((words for words in known if words in str(refused)), f"{number}: {refused}")] += 1
            continue
        assert state.residual <= 1e-8, number
        assert np.isfinite(state.traction_mpa).all()
        assert breaks(state) <= 1e-8, number
    assert set(said) <= set(known), said
    assert said.total() <= 20, said


def test_a_tip_that_is_lifted_and_pressed_again_grips_as_before() -> None:
    push, lift = Step(force_n=(None, None, 0.1)), Step(force_n=(None, None, 0.0))
    cone = Press(probe=Cone(apex_deg=140, diameter_mm=6), at_mm=(0, 0), friction=0.4, steps=(push, lift, push))
    state = press(
        cone, FINGER, HalfSpace(0.5, 0.5), patches_across=9, youngs_modulus_mpa=0.5, poisson_ratio=0.5, increments=4
    )
    first, _, again = state.path
    np.testing.assert_allclose(first.traction_mpa, again.traction_mpa, atol=1e-8 * first.peak_pressure_mpa)
