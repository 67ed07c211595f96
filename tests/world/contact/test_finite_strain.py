"""Presses at finite strain, on a slab of revolution and on whole bodies: against another code, and what is refused."""

import gc
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from standard_bodies import REFERENCE

import twin
from twin.errors import ContactError, NotSettled, TwinError
from twin.parts.body import Finger
from twin.parts.material import Material
from twin.parts.press import Cone, Cylinder, Object, Pillar, Sphere, Stl
from twin.world.contact import body_strain, mixed_rubber, round_slab, whole_body
from twin.world.contact.body_strain import BodyStrain
from twin.world.contact.finite_strain import measured_linearity
from twin.world.elasticity.factor import Factor

pytestmark = pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")


def truth_of(name):
    """Return what another code stored, and its places (n, 3)."""
    found = json.loads((REFERENCE / f"{name}.json").read_text())
    return found, places_of(found if "places_mm" in found else found["cases"][0])


def places_of(case):
    """Return the places (n, 3) that a case has."""
    places = np.array(case["places_mm"])
    return np.insert(places, 1, 0.0, axis=1) if places.shape[1] == 2 else places


TRUTH, PLACES = truth_of("neohooke")
ON_FINGER, IN_FINGER = truth_of("finger_neohooke")
DOMES = json.loads((REFERENCE / "dome_neohooke.json").read_text())["cases"]
ON_DOME, STUCK_ON_DOME = DOMES[:2], DOMES[-1]
PROBES = {"sphere": Sphere, "cylinder": Cylinder, "cone": Cone}
BALL = Sphere(diameter_mm=6)
STICKY = float("inf")
STIFFENING = {"law": "yeoh", "law_ratios": (0.4, 0.3)}


@pytest.fixture(autouse=True)
def _memory_of_one_test():
    """A sensor and its strained state refer to each other and hold up to 0.8 GB, which the collector finds late."""
    yield
    gc.collect()


def made(law="neo_hookean", name="block_bare", **overrides):
    return twin.Sensor(
        twin.load_scene(name, overrides={"material.youngs_modulus_mpa": 1.0, "material.law": law, **overrides})
    )


def largest(vectors):
    return np.linalg.norm(vectors, axis=1).max()


def off(case, more, places):
    """Return how far ``more`` is off what another code adds to its own linear displacement, and that itself, both over
    the largest linear displacement."""
    linear, bent = np.array(case["linear_mm"]), np.array(case["strained_mm"])
    change = bent - linear
    if change.shape[1] == 2:
        change = np.insert(change, 1, 0.0, axis=1)
    return largest(more.displacement(places) - change) / largest(linear), largest(change) / largest(linear)


def deeper(case):
    return case["indentation_mm"] / case["indentation_linear_mm"] - 1.0


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(
            case,
            marks=[] if case["force_n"] == 3.0 and case.get("edge_mm", 0.5) == 0.5 else [pytest.mark.slow],
            id=f"{case['kind']}-{case.get('edge_mm', 0)}-{case['force_n']}-{case.get('law', 'neo_hookean')}"
            + f"-{case.get('thickness_mm', 40)}",
        )
        for case in TRUTH["cases"]
        if "sticks" not in case
    ],
)
def test_difference_to_linear_theory_is_that_of_another_code(case):
    """The slab is round and ends 47.5 mm away, the block 45 and 50: that is part of the 0.04 %."""
    size = {key: case[key] for key in ("diameter_mm", "edge_mm", "apex_deg", "tip_mm") if key in case}
    press = twin.Press(probe=PROBES[case["kind"]](**size), force_n=(0, 0, case["force_n"]))
    thick = case.get("thickness_mm", 40.0)
    places = places_of(case)
    linear = made("linear", **{"body.thickness_mm": thick})
    straight = linear.press(press)
    rubber = {"material.law_ratios": case.get("ratios", ()), "body.thickness_mm": thick}
    sensor = made(case.get("law", "neo_hookean"), **rubber)
    state = sensor.press(press)
    left, missed = off(case, state.load.strained, places)
    rounded = 4e-4 if case.get("edge_mm") == 0.05 else 0.0  # solved with a rim of 0.1 mm
    assert left < 2.5e-4 + case["own_error"] + rounded < missed / 10
    assert left - case["own_error"] < state.error.strain.markers < 1e-3
    assert sensor.quick_motion(state.load).error_of(state) == state.error.markers > state.error.strain.markers
    assert state.indentation_mm / straight.indentation_mm - 1.0 == pytest.approx(deeper(case), abs=2e-3)
    touched = min(case["contact_mm"], case["diameter_mm"] / 2)  # another code's end passes a sharp rim by 1.5 %
    assert state.contact_radius_mm == pytest.approx(touched, rel=1e-2 if case["kind"] == "sphere" else 1.5e-2)
    assert state.force_n == pytest.approx([0.0, 0.0, case["force_n"]], abs=1e-9)
    assert state.move_mm[2] == pytest.approx(state.indentation_mm, rel=1e-9)
    added = sensor.displacement(places, state) - linear.displacement(places, straight)
    assert added == pytest.approx(state.load.strained.displacement(places), abs=1e-9)


@pytest.mark.parametrize("force", [pytest.param(3.0, marks=pytest.mark.slow), 6.0])
def test_stated_error_holds_wherever_in_an_element_the_contact_ends(force):
    """The mesh is made for another radius than the contact's; elements of equal size leave 0.02 to 0.17 %."""
    case = next(one for one in TRUTH["cases"] if one["kind"] == "sphere" and one["force_n"] == force)
    press = twin.Press(probe=BALL, force_n=(0, 0, force))
    linear, nominal = made("linear"), made().nominal
    state = linear.press(press)
    size = largest(linear.displacement(PLACES, state))
    rows = []
    for shift in (0.97, 0.99, 1.01, 1.03, 1.045):
        other = replace(state, contact_radius_mm=shift * state.contact_radius_mm)
        more = round_slab.SlabStrain(press, nominal.body, nominal.material, other, PLACES)
        left, _ = off(case, more, PLACES)
        assert left < more.error.markers + case["own_error"]
        assert more.error.markers < 4e-4
        rows.append((more.displacement(PLACES), more.error.markers, more.wider[0]))
    for field, stated, wider in rows[1:]:
        assert largest(field - rows[0][0]) < min(stated + rows[0][1], 1.5e-4) * size
        assert wider == pytest.approx(rows[0][2], rel=5e-3)


@pytest.mark.parametrize(
    ("probe", "force", "thick", "nu", "law"),
    [
        (Cylinder(diameter_mm=4.027, edge_mm=0.4027), 2.3655, 3.0, 0.49, {"law": "neo_hookean"}),
        (Sphere(diameter_mm=10.82), 12.04, 8.0, 0.5, {"law": "yeoh", "law_ratios": (0.637, 1.062)}),
        (Sphere(diameter_mm=6), 6.5, 20.0, 0.45, {"law": "yeoh", "law_ratios": (0.3, 1.5)}),
        (Cone(diameter_mm=8, apex_deg=125, tip_mm=0.6), 1.7, 8.0, 0.47, {"law": "mooney_rivlin", "law_ratios": (0.4,)}),
    ],
    ids=["cylinder on thin rubber", "stiffening rubber", "stiffening and compressible", "cone"],
)
def test_stated_error_is_one_to_four_times_what_a_much_finer_mesh_changes(probe, force, thick, nu, law, monkeypatch):
    """By a coarser mesh 0.03 % was stated where NGSolve found 0.05 and 0.06 % in the first two, and up to nine times
    what was left under cones."""
    sensor = made("linear", **{"body.thickness_mm": thick, "material.poisson_ratio": nu})
    press = twin.Press(probe=probe, force_n=(0, 0, force))
    state, body = sensor.press(press), sensor.nominal.body
    rubber = sensor.nominal.material.model_copy(update=law)
    size = state.contact_radius_mm
    places = size * np.array([[r, 0.0, z] for z in (0.4, 0.53) for r in (0.0, 0.3, 0.6, 1.0, 1.5)])
    before = Factor.made
    more = round_slab.SlabStrain(press, body, rubber, state, places)
    stated, field = more.error.markers, more.displacement(places)
    assert Factor.made - before == 2 or rubber.law == "yeoh"  # one of a mesh for both its solutions, in ten steps
    graded = round_slab.Slab.Grid.graded
    finer = staticmethod(lambda *given: graded(*given[:3], 2.0 * given[3], *given[4:]))
    monkeypatch.setattr(round_slab.Slab.Grid, "graded", finer)
    other = round_slab.SlabStrain(press, body, rubber, state, places)
    left = largest(other.displacement(places) - field) / largest(sensor.displacement(places, state))
    assert left < stated < min(4.0 * left, 1e-3)


def test_sharp_rim_is_the_limit_of_sharper_and_sharper_ones():
    """Another code's rim has 0.05 mm; points that touch at rest and never let go would make 0.8 % to 3.2 %."""
    case = next(one for one in TRUTH["cases"] if one.get("edge_mm") == 0.05)
    state = made().press(twin.Press(probe=Cylinder(diameter_mm=5), force_n=(0, 0, 3.0)))
    left, missed = off(case, state.load.strained, PLACES)
    assert left < 1.5e-3 < missed / 5
    assert left < state.error.strain.markers < 3e-3
    assert state.validity.linearisation_error == pytest.approx(0.0081, rel=0.2)


def test_rubber_thinner_than_its_contact_states_an_error_without_markers():
    """Places as deep as the contact is wide lie below it, where nothing moves."""
    press = twin.Press(probe=Cone(apex_deg=140, diameter_mm=14, tip_mm=1), force_n=(0, 0, 6.0))
    state = made(**{"body.thickness_mm": 2.0}).press(press)
    assert state.contact_radius_mm > 2.0
    assert 1e-4 < state.error.strain.markers < state.validity.linearisation_error < 0.5


@pytest.mark.slow
def test_load_steps_solve_a_press_that_fails_at_once():
    """Under 6 N on a fairly sharp cylinder Newton's steps from the linear solution do not converge."""
    press = twin.Press(probe=Cylinder(diameter_mm=5, edge_mm=0.2), force_n=(0, 0, 6.0))
    assert made().press(press).load.strained.indentation_mm > 0.02


def test_load_steps_end_where_one_step_does(monkeypatch):
    press = twin.Press(probe=Cylinder(diameter_mm=5, edge_mm=0.5), force_n=(0, 0, 3.0))
    field = made().press(press).load.strained.displacement(PLACES)
    settle = round_slab.SlabStrain.settled
    left = [1]

    def failing(self, slab, touch, state, force, *, linear, **to):
        if not linear and left:
            left.pop()
            raise NotSettled("contact: the first attempt")
        return settle(self, slab, touch, state, force, linear=linear, **to)

    monkeypatch.setattr(round_slab.SlabStrain, "settled", failing)
    steps = made().press(press).load.strained
    assert not left
    assert steps.displacement(PLACES) == pytest.approx(field, abs=1e-3 * largest(field))
    left.extend(range(9))  # another mesh fails altogether: asking for the error raised
    assert steps.linear_error < steps.error.markers < 2.0 * steps.linear_error


@pytest.mark.slow
def test_load_steps_on_a_whole_body_lead_to_the_slabs_solution_under_a_sharp_face(monkeypatch):
    """The first attempt fails, as it does under a square pillar that is pressed as hard."""
    settle, left = whole_body.RubberContact.settled, [1]

    def failing(self, state, by_force, given, to, *, linear):
        if not linear and left:
            left.pop()
            raise NotSettled("contact: the first attempt")
        return settle(self, state, by_force, given, to, linear=linear)

    monkeypatch.setattr(whole_body.RubberContact, "settled", failing)
    sides = {f"body.{name}_mm": length for name, length in (("width", 13.0), ("length", 13.0), ("thickness", 10.0))}
    sensor, press = made("linear", **sides), twin.Press(probe=Cylinder(diameter_mm=1.13), force_n=(0, 0, 0.25))
    state = sensor.press(press)
    size = state.contact_radius_mm
    places = size * np.array([[r, 0.0, z] for z in (0.6, 1.0, 2.0) for r in (0.0, 0.5, 1.0, 1.5, 2.5)])
    given = press, sensor.nominal.body, RUBBER, state, places
    slab, more = round_slab.SlabStrain(*given), BodyStrain(*given)
    assert not left
    missed = largest(more.displacement(places) - slab.displacement(places))
    assert missed < more.error.markers * largest(sensor.displacement(places, state))
    sunk = abs(more.indentation_mm - slab.indentation_mm) / state.indentation_mm
    assert sunk < more.error.indentation < 0.02


@pytest.mark.slow
def test_rubber_that_stiffens_is_pressed_deep_in_load_steps_as_by_another_code():
    """Yeoh's law, a/R 0.86: linear theory is 12.6 % too deep. NGSolve as in tests/reference, its slab 60 mm wide."""
    of = {"material.law_ratios": [0.0128, 0.32308], "body.thickness_mm": 2.11265}
    press = twin.Press(probe=Sphere(diameter_mm=3.11755), force_n=(0, 0, 4.874225))
    assert made("yeoh", **of).press(press).load.strained.indentation_mm == pytest.approx(0.90732 - 1.03841, abs=1e-3)


def test_press_elsewhere_of_other_units_and_of_another_size_is_the_same_press():
    """Moved along the face; E, force 1 and 1 or 0.2 and 0.2; all lengths an eighth: nothing has a length of its own."""
    press = twin.Press(probe=BALL, force_n=(0, 0, 3.0))
    there = twin.Press(probe=BALL, force_n=(0, 0, 0.6), at_mm=(6.0, -5.0))
    states = made().press(press), made(**{"material.youngs_modulus_mpa": 0.2}).press(there)
    more = [state.load.strained for state in states]
    moved = PLACES + np.array([6.0, -5.0, 0.0])
    assert more[1].displacement(moved) == pytest.approx(more[0].displacement(PLACES), abs=1e-6)
    step = 1e-5 * np.eye(3)
    inside = moved[1:9] + np.array([0.0, 0.3, 0.1])
    slope = [more[1].displacement(inside + h) - more[1].displacement(inside - h) for h in step]
    assert more[1].gradient(inside) == pytest.approx(np.stack(slope, axis=2) / 2e-5, abs=1e-7)
    block = made().nominal.body
    sides = {f"body.{name}_mm": getattr(block, f"{name}_mm") / 8 for name in ("width", "length", "thickness")}
    ball = twin.Press(probe=Sphere(diameter_mm=0.75), force_n=(0, 0, 3.0 / 64))
    small = made(**sides).press(ball).load.strained
    assert 8 * small.displacement(PLACES / 8) == pytest.approx(more[0].displacement(PLACES), abs=2e-5)


def test_every_step_of_a_path_has_its_own_strain():
    steps = tuple(twin.Step(force_n=(None, None, force)) for force in (1.0, 3.0, 1.0))
    path = made().press(twin.Press(probe=BALL, steps=steps)).path
    once = made().press(twin.Press(probe=BALL, force_n=(0, 0, 1.0)))
    assert [path[0].indentation_mm, path[2].indentation_mm] == pytest.approx([once.indentation_mm] * 2, rel=1e-6)
    assert path[1].indentation_mm > 1.5 * path[0].indentation_mm


def test_probe_held_by_a_motion_carries_the_force_of_another_code():
    """There the probe is this much deeper under 3 N than by linear theory."""
    case = next(one for one in TRUTH["cases"] if one["kind"] == "sphere" and one["force_n"] == 3.0)
    straight = made("linear").press(twin.Press(probe=BALL, at_mm=(3.0, 2.0), force_n=(0, 0, 3.0)))
    deep = straight.indentation_mm * (1.0 + deeper(case))
    sensor = made()
    held = sensor.press(twin.Press(probe=BALL, steps=(twin.Step(move_mm=(3.0, 2.0, deep)),)))
    assert held.indentation_mm == pytest.approx(deep, rel=1e-4)
    assert held.force_n[2] == pytest.approx(3.0, rel=2e-3)
    assert 0.0 < held.error.strain.force < 1e-2
    assert held.error.strain.indentation == 0.0
    forced = sensor.press(twin.Press(probe=BALL, at_mm=(3.0, 2.0), force_n=(0, 0, float(held.force_n[2]))))
    places = PLACES + np.array([3.0, 2.0, 0.0])
    moved = [sensor.displacement(places, state) for state in (forced, held)]
    assert largest(moved[1] - moved[0]) < 1e-4 * largest(moved[0])


@pytest.mark.parametrize(
    ("probe", "refused", "words"),
    [
        (BALL, (0.3, 0.0, 1.0), "balanced"),
        pytest.param(
            Cylinder(diameter_mm=5),
            (None, None, 9.0),
            "neo_hookean.*did not converge in 20.*press with less force",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_step_that_is_refused_leaves_the_state_before_it_with_its_strain(probe, refused, words, monkeypatch):
    """Without friction nothing holds the first one aside; the other one fails at finite strain only, in one step."""
    monkeypatch.setattr(mixed_rubber, "LOAD_STEPS", (1.0, 1.0, 1.0))
    steps = (twin.Step(force_n=(None, None, 1.0)), twin.Step(force_n=refused))
    sensor = made()
    with pytest.raises(ContactError, match=words) as caught:
        sensor.press(twin.Press(probe=probe, steps=steps))
    last = caught.value.last_state
    assert not last.complete
    assert "step 2 of 2 was refused" in last.reason
    once = sensor.press(twin.Press(probe=probe, force_n=(0, 0, 1.0)))
    assert sensor.displacement(PLACES, last) == pytest.approx(sensor.displacement(PLACES, once), abs=1e-9)


def test_loads_that_no_press_made_are_refused():
    sensor = made()
    load = twin.Traction.disk((0, 0), 2.0, (0, 0, 1.0))
    state = sensor.press(twin.Press(probe=BALL, force_n=(0, 0, 1.0)))
    for other in (load, state.load + load):
        with pytest.raises(TwinError, match="one press at a time"):
            sensor.displacement(PLACES, other)


@pytest.mark.parametrize(
    ("law", "ratios", "words"),
    [
        ("neo_hookean", (0.1,), "takes none"),
        ("mooney_rivlin", (), "takes C2/C1"),
        ("mooney_rivlin", (-0.2,), "0 to 10"),
        ("yeoh", (0.1,), "C2/C1 and C3/C1"),
        ("yeoh", (-0.5, 0.01), "soften away"),
    ],
)
def test_ratios_that_a_law_lacks_or_cannot_have_are_refused(law, ratios, words):
    with pytest.raises(TwinError, match=words):
        made(law, **{"material.law_ratios": ratios})


def test_stiffening_rubber_is_pressed_in_less_and_mooney_rivlin_of_ratio_0_is_neo_hookes():
    press = twin.Press(probe=BALL, force_n=(0, 0, 3.0))
    laws = [("neo_hookean", ()), ("mooney_rivlin", (0.0,)), ("mooney_rivlin", (0.6,)), ("yeoh", (0.3, 0.1))]
    neo, same, mooney, yeoh = (
        made(law, **{"material.law_ratios": ratios}).press(press).indentation_mm for law, ratios in laws
    )
    assert same == pytest.approx(neo, rel=1e-12)
    assert yeoh < neo - 2e-3
    assert abs(mooney - neo) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("case", ON_FINGER["cases"], ids=lambda case: f"{case['force_n']}")
def test_finger_is_another_codes_and_so_is_the_linearity_that_the_linear_law_measures(case):
    """Both of the other code's displacements are its own: the linear one, too, is on another mesh."""
    press = twin.Press(probe=Sphere(diameter_mm=ON_FINGER["diameter_mm"]), force_n=(0, 0, case["force_n"]))
    linear, sensor = made("linear", "finger_bare"), made(name="finger_bare")
    straight, state = linear.press(press), sensor.press(press)
    left, missed = off(case, state.load.strained, IN_FINGER)
    assert left < missed / 10
    body, material = sensor.nominal.body, sensor.nominal.material
    stated = BodyStrain(press, body, material, straight, IN_FINGER).error
    assert left < stated.markers < 2 * left + case["own_error"]
    with pytest.warns(twin.AccuracyWarning, match="press with less force, as large strain is solved on a coarse"):
        assert state.error.markers > sensor.nominal.accuracy.displacement
    assert state.indentation_mm / straight.indentation_mm - 1.0 == pytest.approx(deeper(case), abs=1e-3)
    assert state.force_n[2] == pytest.approx(case["force_n"], rel=1e-9)
    assert state.move_mm[2] == pytest.approx(state.indentation_mm, rel=1e-9)
    if case is ON_FINGER["cases"][0]:
        found = measured_linearity(press, body, linear.nominal.material, straight, IN_FINGER)
        assert found.linearisation_basis == "measured"
        assert found.linearisation_error == pytest.approx(missed, rel=0.25)
        assert not found.warnings


@pytest.mark.slow
@pytest.mark.parametrize("case", ON_DOME, ids=lambda case: case["law"])
def test_sphere_on_a_dome_is_another_codes_all_around_and_so_is_its_contact_radius(case):
    """The other code's dome is one of revolution, the mesh is not: places lie in four half planes.

    Edges 0.85 of the contact's radius long left 1.1 and 0.9 %, more than was stated; the spread of the pressure at rest
    made the radius 5 % too small.
    """
    press = twin.Press(probe=Sphere(diameter_mm=case["diameter_mm"]), force_n=(0, 0, case["force_n"]))
    shape = {f"body.{key}": case[key] for key in ("radius_mm", "height_mm")}
    rubber = {"material.poisson_ratio": case["poisson_ratio"], **shape}
    straight = made("linear", "dome_bare", **rubber).press(press)
    material = made(case["law"], "dome_bare", **rubber, **{"material.law_ratios": case["ratios"]}).nominal.material
    body = made("linear", "dome_bare", **rubber).nominal.body
    r, z = np.array(case["places_mm"]).T
    angles = np.radians([0.0, 90.0, 180.0, 270.0])
    places = np.concatenate([np.column_stack([r * np.cos(a), r * np.sin(a), z]) for a in angles])
    more = BodyStrain(press, body, material, straight, places)
    change = np.array(case["strained_mm"]) - np.array(case["linear_mm"])
    wanted = np.concatenate([np.outer(change[:, 0], [np.cos(a), np.sin(a), 0.0]) for a in angles])
    wanted[:, 2] = np.tile(change[:, 1], 4)
    size = largest(np.array(case["linear_mm"]))
    off_by = more.displacement(places) - wanted
    left = largest(off_by) / size
    assert left < 7e-3 < largest(wanted) / size / 7
    # On a body of revolution nothing goes to one side; a coarse mesh's uneven pressure pushed it by 1.4e-3 and 1.8e-3.
    assert largest(off_by.reshape(len(angles), -1, 3).mean(axis=0)[:, :2]) / size < 1.3e-3
    # The body's coarsest mesh differs from machine to machine: 1.4 to 2.7 on six each.
    assert left < more.error.markers < 3.5 * left
    assert more.indentation_mm / case["indentation_linear_mm"] == pytest.approx(deeper(case), abs=1.5e-3)
    assert more.wider[0] == pytest.approx(case["contact_mm"] / case["contact_linear_mm"], rel=8e-3)


@pytest.mark.slow
def test_probe_held_along_a_normal_carries_less_force_its_gradient_is_a_slope_and_failing_steps_raise(monkeypatch):
    """By linear theory it carries as much less as the square root of the cube of its depth."""
    press = twin.Press(probe=Sphere(diameter_mm=4), at_mm=(-3.0, 2.0), direction="normal", indentation_mm=0.3)
    sensor = made(name="finger_bare")
    straight, held = made("linear", "finger_bare").press(press), sensor.press(press)
    assert held.indentation_mm == pytest.approx(0.3, rel=5e-4)
    strained = held.load.strained.indentation_mm
    assert 0.005 < strained < 0.02
    expected = (1.0 - strained / 0.3) ** 1.5
    assert held.force_n == pytest.approx(expected * straight.force_n, rel=1e-2, abs=1e-9)
    given = press, sensor.nominal.body, sensor.nominal.material, straight, np.zeros((0, 3))
    before = Factor.made
    more = BodyStrain(*given)
    assert Factor.made - before <= 4  # six steps and more
    places = straight.patches.centre_mm.mean(axis=0) + np.array([[0.1, 0.2, 1.0], [0.4, 0.0, 1.5], [2.0, 0.3, 2.0]])
    slope = [more.displacement(places + h) - more.displacement(places - h) for h in 1e-5 * np.eye(3)]
    assert more.gradient(places) == pytest.approx(np.stack(slope, axis=2) / 2e-5, abs=1e-6)
    monkeypatch.setattr(whole_body, "MOST_STEPS", 1)
    monkeypatch.setattr(body_strain, "LAST_STEP", 0.0)
    with pytest.raises(NotSettled, match=r"neo_hookean.*did not converge in 1"):
        BodyStrain(*given)


@pytest.mark.slow
@pytest.mark.parametrize(("edge_mm", "friction"), [(0.1, 0.0), (0.06, 0.0), (0.5, STICKY)])
def test_whole_block_under_a_flat_face_is_another_codes_slab(edge_mm, friction):
    """A cylinder on the mesh of pillars, where its rim is rounded: on the second case's 4 mm of rubber 2 % are left."""
    case = next(
        one for one in TRUTH["cases"] if one.get("edge_mm") == edge_mm and ("sticks" in one) == (friction > 0.0)
    )
    probe = Cylinder(diameter_mm=case["diameter_mm"], edge_mm=edge_mm)
    press = twin.Press(probe=probe, force_n=(0, 0, case["force_n"]), friction=friction)
    thick = case.get("thickness_mm", 40.0)
    linear = made("linear", **{"body.thickness_mm": thick})
    state = linear.press(press)
    places = places_of(case)
    more = BodyStrain(press, linear.nominal.body, made().nominal.material, state, places)
    left, missed = off(case, more, places)
    assert left < 0.55 * missed
    assert left < more.error.markers < (8.0 if friction else 4.0) * left
    sunk = abs(more.indentation_mm / state.indentation_mm - deeper(case))
    assert sunk < more.error.indentation
    assert sunk < (2e-3 if thick == 40.0 else 1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("probe", "force", "thick", "nu", "law"),
    [
        (Cone(diameter_mm=6.48, apex_deg=130, tip_mm=0.324), 1.098, 2.0, 0.47, STIFFENING),
        (Sphere(diameter_mm=4.08), 3.159, 2.0, 0.47, STIFFENING),
        (Sphere(diameter_mm=4), 0.3, 10.0, 0.49, {"law": "neo_hookean"}),
        (Sphere(diameter_mm=4), 1.5, 8.0, 0.46, {"law": "neo_hookean"}),
    ],
)
def test_whole_block_states_how_far_it_is_from_a_slab_of_revolution(probe, force, thick, nu, law):
    """More was left than stated: of the cone's displacement, as its tip strains rubber that stiffens, and of the
    spheres' depths, the first's on rubber thinner than its contact is wide."""
    press = twin.Press(probe=probe, force_n=(0, 0, force))
    linear = made("linear", **{"body.thickness_mm": thick, "material.poisson_ratio": nu})
    state = linear.press(press)
    places = np.array([[r, 0.0, z] for z in (0.4, 0.8) for r in (0.0, 0.5, 1.0, 2.0)])
    material = linear.nominal.material.model_copy(update=law)
    given = press, linear.nominal.body, material, state, places
    slab, whole = round_slab.SlabStrain(*given), BodyStrain(*given)
    missed = whole.displacement(places) - slab.displacement(places)
    left = largest(missed) / largest(linear.displacement(places, state))
    sunk = abs(whole.indentation_mm - slab.indentation_mm) / state.indentation_mm
    assert left < whole.error.markers < 4.0 * left
    assert sunk < whole.error.indentation < 6.0 * sunk


@pytest.mark.slow
@pytest.mark.parametrize(
    ("probe", "force", "size", "law"),
    [
        (Cone(diameter_mm=5, apex_deg=118), 0.36, (25, 25, 4), {"law": "yeoh", "law_ratios": (0.3, 0.3)}),
        (Cone(diameter_mm=8, apex_deg=114), 0.79, (100, 90, 40), {"law": "mooney_rivlin", "law_ratios": (0.4,)}),
        (Cylinder(diameter_mm=1.85, edge_mm=0.222), 0.38, (24, 16, 7), {"law": "neo_hookean"}),
    ],
    ids=["sharp tip on rubber that stiffens", "sharp tip", "close to a flat face"],
)
def test_whole_block_states_what_it_misses_close_to_a_sharp_probe(probe, force, size, law):
    """Half as much as is left was stated under sharp tips."""
    press = twin.Press(probe=probe, force_n=(0, 0, force))
    sides = zip(("width_mm", "length_mm", "thickness_mm"), size, strict=True)
    linear = made("linear", **{f"body.{side}": length for side, length in sides})
    state, material = linear.press(press), linear.nominal.material.model_copy(update=law)
    places = state.contact_radius_mm * np.array([[r, 0.0, z] for z in (0.5, 1.0) for r in (0.0, 0.25, 0.5, 0.75, 1.0)])
    given = press, linear.nominal.body, material, state, places
    slab, whole = round_slab.SlabStrain(*given), BodyStrain(*given)
    missed = whole.displacement(places) - slab.displacement(places)
    left = largest(missed) / largest(linear.displacement(places, state))
    assert left < whole.error.markers < 4.0 * left


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "case"),
    [("block_bare", TRUTH["cases"][-1]), ("dome_bare", STUCK_ON_DOME)],
    ids=["cone", "sphere on a dome"],
)
def test_round_probe_that_sticks_is_another_codes(name, case):
    """The whole displacement: by linear theory the other code measures gaps of points that stick at other places."""
    size = {key: case[key] for key in ("diameter_mm", "apex_deg", "tip_mm") if key in case}
    press = twin.Press(probe=PROBES[case["kind"]](**size), force_n=(0, 0, case["force_n"]), friction=STICKY)
    shape = {f"body.{key}": case[key] for key in ("radius_mm", "height_mm") if key in case}
    linear = made("linear", name, **{"material.poisson_ratio": case.get("poisson_ratio", 0.5)} | shape)
    state, places = linear.press(press), places_of(case)
    rubber = linear.nominal.material.model_copy(update={"law": "neo_hookean"})
    more = BodyStrain(press, linear.nominal.body, rubber, state, places)
    straight = linear.displacement(places, state)
    missed = np.insert(np.array(case["strained_mm"]), 1, 0.0, axis=1) - straight
    left = largest(missed - more.displacement(places)) / largest(straight)
    assert 5.0 * left < largest(missed) / largest(straight)
    assert left + case["own_error"] < more.error.markers < 5.0 * left
    sunk = abs(state.indentation_mm + more.indentation_mm - case["indentation_mm"]) / state.indentation_mm
    assert sunk < more.error.indentation < 5e-3


@pytest.mark.slow
def test_two_far_spheres_that_rub_are_held_aside_as_one_is():
    """26 mm away the other one takes 2 % of the force off, as it drags the rubber along."""
    steps = twin.Step(force_n=(None, None, 1.0)), twin.Step(force_n=(None, None, 1.0), move_mm=(0.25, None, None))
    given = {"probe": Sphere(diameter_mm=5), "steps": steps, "friction": 0.5}
    sensor = made()
    one = sensor.press(twin.Press(at_mm=(-13, 0), **given))
    two = sensor.press(twin.Press(at_mm=(-13, 0), also=(twin.Press(at_mm=(13, 0), **given),), **given))
    probes = two, two.also[0]
    for each in probes:
        assert each.force_n == pytest.approx(one.force_n, rel=0.05, abs=2e-3)
        assert each.move_mm[:2] == pytest.approx([0.25, 0.0], abs=1e-9)
    total = sum(term.force_n.sum(axis=0) for term in two.load.terms)
    assert total == pytest.approx(probes[0].force_n + probes[1].force_n, abs=1e-9)
    near = [[x, y, z] for x in (-2.0, 0.0, 2.0) for y in (0.0, 1.0) for z in (1.0, 2.0)]
    changes = [
        state.load.strained.displacement(np.array([x, 0.0, 0.0]) + near)
        for state, x in ((one, -13.0), (two, -13.0), (two, 13.0))
    ]
    assert largest(changes[0]) > 0.01
    for change in changes[1:]:
        assert change == pytest.approx(changes[0], abs=5e-3 * 0.3)


@pytest.mark.slow
def test_two_far_spheres_sink_as_one_does():
    """The slab of revolution solves the one; 16 mm away the other moves the surface by a per cent of the depth."""
    ball = Sphere(diameter_mm=3)
    other = twin.Press(probe=ball, at_mm=(8, 0), force_n=(0, 0, 0.5))
    sensor = made()
    two = sensor.press(twin.Press(probe=ball, at_mm=(-8, 0), force_n=(0, 0, 0.5), also=(other,)))
    one = sensor.press(twin.Press(probe=ball, at_mm=(-8, 0), force_n=(0, 0, 0.5)))
    strained = one.load.strained
    assert two.load.strained.moved[:, 2] == pytest.approx([strained.indentation_mm] * 2, rel=0.15)
    assert two.also[0].move_mm[2] == pytest.approx(two.also[0].indentation_mm, rel=1e-9)
    assert two.also[0].validity.linearisation_basis == "measured"
    assert two.also[0].validity.notes == two.validity.notes
    places = np.array([[-8.0, 0.0, 1.0], [-8.5, 0.3, 1.5]])
    most = 5e-3 * largest(sensor.displacement(places, one))
    assert two.load.strained.displacement(places) == pytest.approx(strained.displacement(places), abs=most)


@pytest.mark.slow
def test_sphere_that_sticks_and_is_sheared_is_another_codes():
    """Pressed, then pulled along x; the other code holds its own points to its own sphere."""
    truth, places = truth_of("stuck_neohooke")
    (_, pushed), (pulled, pushed_too) = (step["force_n"] for step in truth["steps"])
    steps = (twin.Step(force_n=(0.0, 0.0, pushed)), twin.Step(force_n=(pulled, 0.0, pushed_too)))
    press = twin.Press(probe=Sphere(diameter_mm=truth["diameter_mm"]), friction=STICKY, steps=steps)
    straight, bent = made("linear").press(press), made().press(press)
    for before, after, step in zip(straight.path, bent.path, truth["steps"], strict=True):
        assert after.force_n == pytest.approx(before.force_n, abs=1e-9)
        left, missed = off(step, after.load.strained, places)
        assert left < missed / 5
        assert left < after.error.strain.markers < 2e-2
    for axis, asked, linear in ((2, 0, 0), (0, 1, 1)):
        wanted = truth["motion_mm"][asked] / truth["motion_linear_mm"][linear] - 1.0
        found = bent.path[asked].move_mm[axis] / straight.path[asked].move_mm[axis] - 1.0
        assert found == pytest.approx(wanted, abs=1.5e-2)


@pytest.mark.slow
def test_motion_to_where_a_force_took_the_probe_holds_it_by_that_force():
    """By linear theory it is 7 % less there. The patches carry the whole."""
    pulled = sheared(STICKY, 0.55)[1][1]
    aside = twin.Step(force_n=(None, None, 1.5), move_mm=(pulled.move_mm[0], 0.0, None))
    steps = (twin.Step(force_n=(0.0, 0.0, 1.5)), aside)
    press = twin.Press(probe=BALL, friction=STICKY, steps=steps)
    straight, bent = made("linear").press(press), made().press(press)
    missed, left = (abs(state.force_n[0] / 0.55 - 1.0) for state in (straight, bent))
    assert left < missed / 10
    assert bent.force_n[1:] == pytest.approx([0.0, 1.5], abs=5e-3)
    patches = bent.patches
    assert patches.total_force_n == pytest.approx(bent.force_n, abs=1e-9)
    assert np.cross(patches.centre_mm, patches.force_n).sum(axis=0)[2] == pytest.approx(bent.torque_nmm, abs=1e-9)
    assert bent.traction_mpa * 4.0 * patches.half_mm.prod(axis=1)[:, None] == pytest.approx(patches.force_n)
    moved = made().displacement(PLACES, bent) - made("linear").displacement(PLACES, straight)
    assert moved == pytest.approx(bent.load.strained.displacement(PLACES), abs=1e-9)


@pytest.mark.slow
def test_sphere_that_is_turned_and_slips_is_another_codes():
    """The force along its way is given, and its turn; linear theory's torque is 10 to 15 % off."""
    truth, places = truth_of("twisted_neohooke")
    steps = [twin.Step(force_n=(None, None, 1.5), turn_deg=turn) for turn in np.diff([0.0, *truth["turns_deg"]])]
    press = twin.Press(probe=Sphere(diameter_mm=truth["diameter_mm"]), friction=truth["friction"], steps=steps)
    for law, name in (("linear", "linear"), ("neo_hookean", "strained")):
        sensor = made(law)
        path = sensor.press(press).path
        for number, (state, step) in enumerate(zip(path, truth[name], strict=True)):
            wanted = np.array(step["moved_mm"])
            missed = sensor.displacement(places, state) - wanted
            assert largest(missed) < 3e-3 * largest(wanted)
            if number == 0:
                continue
            assert np.abs(missed[:, 1]).max() < 0.02 * np.abs(wanted[:, 1]).max()
            assert state.slip.mean() == pytest.approx(truth["linear"][number]["slipping"], abs=0.05)
            off = abs(step["torque_nmm"] / state.torque_nmm - 1.0)
            assert off < 1e-2
            if law == "neo_hookean":
                assert off < state.error.force < 3.0 * off


@pytest.mark.slow
def test_torque_just_below_what_friction_holds_turns_a_sphere_as_by_another_code():
    """By linear theory it holds 0.59 N mm; a coarse mesh holds less. The other code's torques lie on a cubic."""
    truth, _ = truth_of("twisted_neohooke")
    steps = (twin.Step(force_n=(None, None, 1.5)), twin.Step(force_n=(None, None, 1.5), torque_nmm=0.53))
    state = made().press(twin.Press(probe=BALL, friction=truth["friction"], steps=steps))
    torques = [step["torque_nmm"] for step in truth["strained"]]
    at = np.polynomial.Polynomial.fit(truth["turns_deg"], torques, 3)
    assert state.torque_nmm == pytest.approx(0.53, abs=1e-9)
    assert at(state.turn_deg) == pytest.approx(0.53, rel=1e-2)


def sheared(friction, *side, push=1.5, diameter=6.0, name="block_bare"):
    """Return the path of a sphere that is pressed, then pulled along x, by linear theory and with large strain."""
    steps = tuple(twin.Step(force_n=(x, 0.0, push)) for x in (0.0, *side))
    press = twin.Press(probe=Sphere(diameter_mm=diameter), friction=friction, steps=steps)
    return made("linear", name).press(press).path, made(name=name).press(press).path


@pytest.mark.slow
def test_pad_that_is_turned_with_its_press_moves_its_sphere_as_much():
    moves = []
    for sides, side in (((20.0, 26.0), (0.3, 0.0)), ((26.0, 20.0), (0.0, 0.3))):
        sensor = made(name="gelpad_press", **{"body.width_mm": sides[0], "body.length_mm": sides[1]})
        steps = (twin.Step(force_n=(None, None, 1.0)), twin.Step(force_n=(*side, 1.0)))
        path = sensor.press(twin.Press(probe=BALL, friction=0.5, steps=steps)).path
        moves += [path[1].move_mm if side[0] else path[1].move_mm[[1, 0, 2]]]
    assert moves[1] == pytest.approx(moves[0], rel=1e-2, abs=5e-4)  # the mesh is not turned


@pytest.mark.slow
def test_coulomb_friction_lies_between_sliding_freely_and_sticking():
    straight = twin.Press(probe=BALL, steps=(twin.Step(force_n=(None, None, 1.5)),))
    body, material = made().nominal.body, made().nominal.material
    state = made("linear").press(straight)
    free = BodyStrain(straight, body, material, state, PLACES).displacement(PLACES)
    size = largest(made("linear").displacement(PLACES, state))
    little = made().press(straight.model_copy(update={"friction": 1e-4})).load.strained.displacement(PLACES)
    assert largest(little - free) < 2e-3 * size
    much, stuck = (sheared(friction, 0.3)[1][1].load.strained for friction in (200.0, STICKY))
    assert largest(much.displacement(PLACES) - stuck.displacement(PLACES)) < 1e-3 * size
    assert largest(little - stuck.displacement(PLACES)) > 5e-3 * size


@pytest.mark.slow
def test_what_large_strain_adds_to_partial_slip_vanishes_with_the_strain():
    """An eighth of the forces is half the contact's radius, so half the strain."""
    added = []
    for share in (1.0, 1.0 / 8.0, 1.0 / 64.0):
        linear, bent = (path[1] for path in sheared(0.5, 0.6 * share, push=1.5 * share))
        assert 0.5 < linear.slip.mean() < 0.8
        added.append(1.0 - bent.move_mm[0] / linear.move_mm[0])
        assert bent.force_n == pytest.approx(linear.force_n, abs=1e-9)
    assert added[0] > 0.08
    assert added[1] < 0.65 * added[0]
    assert added[2] < 0.65 * added[1]


@pytest.mark.slow
def test_closed_path_with_friction_loses_work_as_by_linear_theory():
    """The side force goes to and fro; its work is what friction takes, at small strain as much as by linear theory."""
    push = 1.5 / 64.0
    side = push / 3.0 * np.array([1, 0.5, 0, -0.5, -1, -0.5, 0, 0.5, 1])
    work = []
    for path in sheared(0.5, *side, push=push):
        moved = np.array([state.move_mm[0] for state in path[1:]])
        work.append(np.sum((side[1:] + side[:-1]) / 2.0 * np.diff(moved)))
        assert moved[-1] == pytest.approx(moved[0], rel=0.02)
    assert 0.0 < work[1] == pytest.approx(work[0], rel=0.15)


@pytest.mark.slow
def test_slide_ends_like_a_shorter_one_and_like_one_in_steps():
    """The linear solution on the mesh lagged behind or lost contact: its slide counts from the rubber carried along. In
    steps, contact did not come to balance: Newton's steps kept the secant of slip for good."""
    found = []
    for ways in ((1.2,), (0.1, 0.2, 0.3, 0.6)):
        steps = tuple(twin.Step(force_n=(None, None, 1.5), move_mm=(way, None, None)) for way in (None, *ways))
        state = made().press(twin.Press(probe=BALL, friction=0.5, steps=steps))
        places = PLACES + state.move_mm * [1.0, 1.0, 0.0]
        found.append((state.load.strained.displacement(places), state.load.strained.indentation_mm))
    (last, deep), (other, deeper_mm) = found
    assert largest(other - last) < 0.01 * state.indentation_mm
    assert deeper_mm == pytest.approx(deep, abs=0.005)


@pytest.mark.slow
@pytest.mark.parametrize(("push", "turn"), [(1.0, (0.0, -15.0, 0.0)), (0.125, (10.0, 0.0, 0.0))])
def test_sphere_rolls_freely_by_less_than_its_turn_as_its_contact_is_curved(push, turn):
    """Rubber laid on a sphere is stretched along it, and the sphere's surface is the slower the closer to its axis: r^2
    / (2 R^2) together, averaged over the contact, by the area or by Hertz's pressure. By linear theory it is 0."""
    radius = BALL.diameter_mm / 2.0
    steps = (
        twin.Step(force_n=(0.0, 0.0, push)),
        twin.Step(force_n=(0.0, 0.0, push), turn_deg=tuple(one or None for one in turn)),
    )
    pressed, rolled = made().press(twin.Press(probe=BALL, friction=0.5, steps=steps)).path
    angle = np.radians(np.abs(turn).max())
    along, across = (0, 1) if turn[1] else (1, 0)
    went = rolled.move_mm[along] + radius * math.sin(angle)  # its middle; what moves is its lowest point at first
    curved = (rolled.contact_radius_mm / radius) ** 2
    assert 0.19 * curved < 1.0 - went / (radius * angle) < 0.26 * curved
    assert rolled.move_mm[across] == pytest.approx(0.0, abs=1e-3)
    depth = rolled.move_mm[2] + radius * (1.0 - math.cos(angle))
    assert depth == pytest.approx(pressed.indentation_mm, rel=5e-3)
    assert rolled.contact_radius_mm == pytest.approx(pressed.contact_radius_mm, rel=1.5e-2)
    assert rolled.force_n == pytest.approx([0.0, 0.0, push], abs=2e-3 * push)


@pytest.mark.slow
def test_probe_that_is_held_after_a_slide_stays_where_it_slid_to():
    """All its points lie at the bound of friction: contact did not come to balance."""
    sensor = made(name="gelpad_slide", **{"material.youngs_modulus_mpa": 0.2})
    press = sensor.nominal.press
    _, slid, held = sensor.press(press.model_copy(update={"steps": press.steps[:3]})).path
    assert held.force_n == pytest.approx(slid.force_n, rel=1e-3, abs=1e-5)
    places = slid.move_mm * [1.0, 1.0, 0.0] + [[x, y, 1.0] for x in (-1.0, 0.0, 1.0) for y in (0.0, 1.0)]
    moved = [state.load.strained.displacement(places) for state in (slid, held)]
    assert moved[1] == pytest.approx(moved[0], abs=2e-3 * slid.indentation_mm)


FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
RUBBER = Material(law="neo_hookean")
ROLLED = {
    "steps": (twin.Step(force_n=(None, None, 0.5)), twin.Step(force_n=(None, None, 0.5), turn_deg=(0.0, 1.0, 0.0))),
    "force_n": None,
}
GUIDED = {"steps": (twin.Step(force_n=(None, None, 0.5), torque_nmm=0.0),), "force_n": None}


def tilted_ball(folder):
    """Return a tilted ball of triangles, whose normals are up to 2 degrees off."""
    trimesh.creation.icosphere(subdivisions=5, radius=3.0).export(folder / "ball.stl")
    return {"probe": Stl(file=str(folder / "ball.stl")), "tilt_deg": (20, -10, 5)}


@pytest.mark.slow
def test_ball_of_triangles_rubs_slides_and_turns_as_a_sphere_does(tmp_path):
    steps = [{}, {"move_mm": (0.15, None, None)}, {"turn_deg": 6.0}, {"move_mm": (0.85, None, None)}]
    steps = tuple(twin.Step(force_n=(None, None, 1.5 if step else 0.75), **step) for step in steps)
    sensor = made()
    ball, sphere = (
        sensor.press(twin.Press(**probe, friction=0.5, steps=steps)).path
        for probe in (tilted_ball(tmp_path), {"probe": BALL})
    )
    for one, other in zip(ball, sphere, strict=True):
        assert one.force_n == pytest.approx(other.force_n, abs=1e-3)
        missed = largest(one.load.strained.displacement(PLACES) - other.load.strained.displacement(PLACES))
        assert missed < min(2e-3, one.error.strain.markers) * other.indentation_mm


@pytest.mark.slow
def test_tilted_ball_of_triangles_is_another_codes_sphere(tmp_path):
    """Its chords are 0.05 % of the indentation off."""
    case = next(one for one in TRUTH["cases"] if one["kind"] == "sphere" and one["force_n"] == 3.0)
    sensor, press = made("linear"), twin.Press(**tilted_ball(tmp_path), force_n=(0, 0, 3.0))
    more = BodyStrain(press, sensor.nominal.body, RUBBER, sensor.press(press), PLACES)
    left, missed = off(case, more, PLACES)
    assert left + case["own_error"] < more.error.markers < min(3.5 * left, missed / 2)
    assert more.indentation_mm / case["indentation_linear_mm"] == pytest.approx(deeper(case), abs=1.5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1, 2], ids=["15 degrees", "25 degrees", "15 degrees, sticks"])
def test_tilted_cylinder_is_another_codes(number):
    """Tilted about y, and as much about x: the mesh is not turned."""
    truth, places = truth_of("tilted_neohooke")
    case, push = truth["cases"][number], twin.Step(force_n=(None, None, 1.0))
    free = {"friction": STICKY, "steps": (push,)} if "sticks" in case else {"force_n": (0, 0, 1.0)}
    cylinder = Cylinder(diameter_mm=case["diameter_mm"], edge_mm=case["edge_mm"])
    sensor = made(**{"body.width_mm": 24.0, "body.length_mm": 24.0, "body.thickness_mm": 10.0})
    linear, bent = np.array(case["linear_mm"]), np.array(case["strained_mm"])
    for tilt, turned in (((0, 1, 0), np.eye(3)), ((-1, 0, 0), np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]))):
        tilt_deg = tuple(case["tilt_deg"] * np.array(tilt, float))
        state = sensor.press(twin.Press(probe=cylinder, tilt_deg=tilt_deg, **free))
        more = state.load.strained
        left = largest(more.displacement(places @ turned) @ turned.T - bent + linear) / largest(linear)
        assert left < state.error.strain.markers < largest(bent - linear) / largest(linear) / 2
        sunk = more.indentation_mm - case["indentation_mm"] + case["indentation_linear_mm"]
        assert abs(sunk) < state.error.strain.indentation * state.indentation_mm
        if "sticks" in case:
            assert (turned @ state.force_n)[0] == pytest.approx(case["side_n"], abs=state.error.force)


@pytest.mark.slow
def test_cylinder_tilted_back_on_an_oblique_way_is_another_codes_upright_one():
    """Frictionless, it stands where it ends: the way begins beside that."""
    case = next(one for one in TRUTH["cases"] if one.get("edge_mm") == 0.5 and one["force_n"] == 3.0)
    aside = np.tan(np.radians(10.0))
    press = twin.Press(
        probe=Cylinder(diameter_mm=5, edge_mm=0.5),
        at_mm=(-case["indentation_mm"] * aside, 0.0, 0.0),
        direction=(aside, 0.0, 1.0),
        tilt_deg=(0, -10, 0),
        axes="probe",
        force_n=(0, 0, 3.0 * np.cos(np.radians(10.0))),
    )
    sensor = made("linear")
    more = BodyStrain(press, sensor.nominal.body, RUBBER, sensor.press(press), PLACES)
    left, _ = off(case, more, PLACES)
    assert left < more.error.markers < 3.0 * left
    assert more.indentation_mm * np.cos(np.radians(10.0)) == pytest.approx(
        case["indentation_mm"] - case["indentation_linear_mm"], abs=2e-3 * case["indentation_linear_mm"]
    )


@pytest.mark.slow
def test_probe_that_steps_turn_is_one_that_was_tilted():
    pillar, size = Pillar(width_mm=3, length_mm=4, edge_mm=0.4), {"body.thickness_mm": 10.0}
    sensor, places = made("linear", **size), np.array([[x, y, 1.5] for x in (-1.5, 0.0, 1.5) for y in (0.0, 1.5)])
    tilted = twin.Press(probe=pillar, tilt_deg=(0, 12, 0), force_n=(0, 0, 1.0))
    turned = twin.Step(force_n=(None, None, 1.0), turn_deg=(0, 12, 0))
    turned = twin.Press(probe=pillar, axes="probe", steps=(turned,))
    one, other = (
        BodyStrain(press, sensor.nominal.body, RUBBER, sensor.press(press), places) for press in (tilted, turned)
    )
    apart = largest(one.displacement(places) - other.displacement(places))
    assert apart < one.error.markers * largest(sensor.displacement(places, sensor.press(tilted)))
    assert other.indentation_mm == pytest.approx(one.indentation_mm, rel=0.05)


@pytest.fixture(scope="module")
def somewhere():
    """A state of a probe that did not turn; refusals on a whole body look at nothing else of it."""
    return made("linear").press(twin.Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 0.5)))


def test_a_scene_of_the_lowest_poisson_ratio_is_solved_as_casting_leaves_it():
    sensor = made(name="kamiyama_pillar", **{"material.poisson_ratio": 0.45})
    assert sensor.actual.scene.material.poisson_ratio < 0.45
    sensor.check_law(twin.Press(probe=Cylinder(diameter_mm=5), force_n=(0, 0, 3.0)))


@pytest.mark.parametrize(
    ("press", "rubber", "words"),
    [
        ({"friction": 0.5, "also": (twin.Press(probe=BALL, force_n=(0, 0, 1.0)),)}, {}, "with the same friction"),
        ({"friction": 0.5, "probe": Cone(apex_deg=130, diameter_mm=3)}, {}, "tip_mm = 0: a cone with friction"),
        ({"friction": 0.5, "probe": Cone(apex_deg=130, diameter_mm=3, tip_mm=0.02)}, {}, "tip_mm: a cone with"),
        ({"friction": 0.5, "probe": Cylinder(diameter_mm=3)}, {}, "while a fifth of it sticks"),
        ({"friction": STICKY, "force_n": None, "indentation_mm": 0.1}, {}, "where a force presses it"),
        ({"friction": 0.5, "probe": Cylinder(diameter_mm=3), **ROLLED}, {}, "with friction a sphere that rolls"),
        ({"friction": 0.5, "tilt_deg": (9.0, 0.0, 0.0), **ROLLED}, {}, "neither tilted before"),
        ({"probe": Cylinder(diameter_mm=3), "tilt_deg": (3.0, 0.0, 0.0)}, {}, "touches with its rim, solved from 0.15"),
        ({"probe": Pillar(width_mm=0.6)}, {}, "to 0.2 .less force., or with a rim of 0.06 mm it is solved"),
        (GUIDED, {}, "torques across its direction.*guided along it"),
        ({"at_mm": (1, 1), "direction": "normal"}, {}, 'force_n = .*across its direction.*axes = "probe"'),
        ({}, {"poisson_ratio": 0.4}, "poisson_ratio: as made below 0.44"),  # not the drawn number
    ],
)
def test_what_is_not_solved_on_a_whole_body_is_refused_with_its_cause(press, rubber, words, somewhere):
    given = twin.Press(**{"probe": Sphere(diameter_mm=3), "force_n": (0, 0, 0.5)} | press)
    with pytest.raises(TwinError, match=f"material.law = neo_hookean.*{words}"):
        BodyStrain(given, FINGER, RUBBER.model_copy(update=rubber), somewhere, IN_FINGER)


@pytest.mark.parametrize(
    ("press", "words"),
    [
        ({"friction": 0.5, "indentation_mm": 0.3, "force_n": None}, "friction"),
        ({"probe": Object(shape="ring", width_mm=8.0)}, "long or hollow"),
        ({"probe": Object(shape="gear", width_mm=8.0)}, "edges, steps or borders lie under the contact"),
    ],
)
def test_press_that_is_not_solved_is_refused_with_its_cause(press, words):
    sensor, given = made(), twin.Press(**({"probe": BALL, "force_n": (0, 0, 1.0)} | press))
    for deed in (sensor.press, sensor.check_law) if "friction" in press else (sensor.press,):
        with pytest.raises(TwinError, match=f"material.law = neo_hookean.*{words}"):
            deed(given)


def test_linearity_that_is_not_measured_on_a_curved_body_stays_estimated_and_says_why(somewhere):
    press = twin.Press(probe=Sphere(diameter_mm=3), friction=0.5, force_n=(0, 0, 0.5))
    found = measured_linearity(press, FINGER, Material(), somewhere, IN_FINGER)
    assert found.linearisation_basis.startswith("estimated: press.friction = 0.5")
    assert found.linearisation_error == somewhere.validity.linearisation_error
