"""Presses on curved bodies at finite strain: against another code's finger, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

import twin
from twin.errors import InputError, NotSettled
from twin.parts.body import Finger
from twin.parts.material import Material
from twin.parts.probe import Cylinder, Sphere
from twin.world.contact import body_strain
from twin.world.contact.finite_strain import measured_linearity
from twin.world.elasticity.factor import Factor

TRUTH = json.loads((Path(__file__).parents[2] / "reference" / "finger_neohooke.json").read_text())
PLACES = np.array(TRUTH["places_mm"])

pytestmark = pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")


def made(law="neo_hookean", name="finger_bare", **overrides):
    return twin.Sensor(
        twin.load_scene(name, overrides={"material.youngs_modulus_mpa": 1.0, "material.law": law, **overrides})
    )


def largest(vectors):
    return np.linalg.norm(vectors, axis=1).max()


@pytest.mark.slow
@pytest.mark.parametrize("case", TRUTH["cases"], ids=lambda case: f"{case['force_n']}")
def test_difference_to_linear_theory_is_that_of_another_code(case):
    """Both of the other code's displacements are its own: the linear one, too, is on another mesh."""
    press = twin.Press(probe=Sphere(diameter_mm=TRUTH["diameter_mm"]), force_n=(0, 0, case["force_n"]))
    states, moved = [], []
    for law in ("linear", "neo_hookean"):
        sensor = made(law)
        states.append(sensor.press(press))
        moved.append(sensor.displacement(PLACES, states[-1]))
    straight, bent = np.array(case["linear_mm"]), np.array(case["strained_mm"])
    most = largest(straight)
    missed = largest(bent - straight) / most
    off = largest((moved[1] - moved[0]) - (bent - straight)) / most
    assert off < missed / 4
    stated = body_strain.BodyStrain(press, sensor.nominal.body, sensor.nominal.material, states[0], PLACES).error
    assert off < stated.markers + case["own_error"] < 2e-2
    with pytest.warns(twin.AccuracyWarning, match="press with less force, as large strain is solved on a coarse"):
        assert states[1].error.strain.markers > sensor.nominal.accuracy.displacement
    deeper = (case["indentation_mm"] - case["indentation_linear_mm"]) / case["indentation_linear_mm"]
    assert states[1].indentation_mm / states[0].indentation_mm - 1.0 == pytest.approx(deeper, abs=5e-3)
    assert states[1].force_n[2] == pytest.approx(case["force_n"], rel=1e-9)
    assert states[1].move_mm[2] == pytest.approx(states[1].indentation_mm, rel=1e-9)


@pytest.mark.slow
def test_gradient_is_the_slope_of_the_displacement_and_steps_that_do_not_settle_are_refused(monkeypatch):
    press = twin.Press(probe=Sphere(diameter_mm=4), at_mm=(-3.0, 2.0), direction="normal", indentation_mm=0.3)
    linear = made("linear")
    state = linear.press(press)
    given = press, linear.nominal.body, made().nominal.material, state, np.zeros((0, 3))
    before = Factor.made
    more = body_strain.BodyStrain(*given)
    assert Factor.made - before <= 4  # six steps and more
    places = state.patches.centre_mm.mean(axis=0) + np.array([[0.1, 0.2, 1.0], [0.4, 0.0, 1.5], [2.0, 0.3, 2.0]])
    step = 1e-5 * np.eye(3)
    slope = [more.displacement(places + h) - more.displacement(places - h) for h in step]
    assert more.gradient(places) == pytest.approx(np.stack(slope, axis=2) / 2e-5, abs=1e-6)
    monkeypatch.setattr(body_strain, "MOST_STEPS", 1)
    with pytest.raises(NotSettled, match=r"neo_hookean.*did not converge in 1"):
        body_strain.BodyStrain(*given)


@pytest.mark.slow
def test_probe_held_by_a_motion_along_the_normal_carries_less_force_than_by_linear_theory():
    """By linear theory it carries as much less as the square root of the cube of its depth."""
    press = twin.Press(probe=Sphere(diameter_mm=4), at_mm=(-3.0, 2.0), direction="normal", indentation_mm=0.3)
    straight, held = made("linear").press(press), made().press(press)
    assert held.indentation_mm == pytest.approx(0.3, rel=5e-4)
    strained = held.load.strained.indentation_mm
    assert 0.005 < strained < 0.02
    expected = (1.0 - strained / 0.3) ** 1.5
    assert held.force_n == pytest.approx(expected * straight.force_n, rel=1e-2, abs=1e-9)


@pytest.mark.slow
def test_whole_block_under_a_flat_face_is_another_codes_slab():
    """A cylinder, whose slab `test_finite_strain` has, on the mesh that square pillars and several probes get."""
    truth = json.loads((Path(__file__).parents[2] / "reference" / "neohooke.json").read_text())
    case = next(one for one in truth["cases"] if one.get("edge_mm") == 0.1)
    places = np.array([[r, 0.0, z] for r, z in truth["places_mm"]])
    press = twin.Press(probe=Cylinder(diameter_mm=5, edge_mm=0.1), force_n=(0, 0, case["force_n"]))
    linear = made("linear", "block_bare")
    material = made(name="block_bare").nominal.material
    state = linear.press(press)
    more = body_strain.BodyStrain(press, linear.nominal.body, material, state, places)
    straight, bent = np.insert(case["linear_mm"], 1, 0, 1), np.insert(case["strained_mm"], 1, 0, 1)
    off = largest(more.displacement(places) - (bent - straight)) / largest(straight)
    assert off < 0.5 * largest(bent - straight) / largest(straight)
    assert off < more.error.markers < 4.0 * off
    deeper = case["indentation_mm"] / case["indentation_linear_mm"] - 1.0
    assert more.indentation_mm / state.indentation_mm == pytest.approx(deeper, abs=2e-3)


@pytest.mark.slow
def test_two_far_spheres_sink_as_one_does():
    """The slab of revolution solves the one; 16 mm away the other moves the surface by a per cent of the depth."""
    ball = Sphere(diameter_mm=3)
    other = twin.Press(probe=ball, at_mm=(8, 0), force_n=(0, 0, 0.5))
    sensor = made(name="block_bare")
    two = sensor.press(twin.Press(probe=ball, at_mm=(-8, 0), force_n=(0, 0, 0.5), also=(other,)))
    one = sensor.press(twin.Press(probe=ball, at_mm=(-8, 0), force_n=(0, 0, 0.5)))
    strained = one.load.strained.indentation_mm
    assert two.load.strained.moved[:, 2] == pytest.approx([strained] * 2, rel=0.15)
    assert two.also[0].move_mm[2] == pytest.approx(two.also[0].indentation_mm, rel=1e-9)
    places = np.array([[-8.0, 0.0, 1.0], [-8.5, 0.3, 1.5]])
    assert two.load.strained.displacement(places) == pytest.approx(
        one.load.strained.displacement(places), abs=5e-3 * largest(sensor.displacement(places, one))
    )


@pytest.fixture(scope="module")
def somewhere():
    """A state of a probe that did not turn; the refusals below look at nothing else of it."""
    sensor = made("linear", "block_bare")
    return sensor.press(twin.Press(probe=Sphere(diameter_mm=3), force_n=(0, 0, 0.5)))


FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
RUBBER = Material(law="neo_hookean")
SHEARED = (twin.Step(force_n=(None, None, 0.5)), twin.Step(force_n=(None, None, 0.5), move_mm=(0.1, None, None)))
GUIDED = {"steps": (twin.Step(force_n=(None, None, 0.5), torque_nmm=0.0),), "force_n": None}


@pytest.mark.parametrize(
    ("press", "rubber", "words"),
    [
        ({"friction": 0.5}, {}, "friction = 0.5: friction 0 and inf are solved"),
        ({"friction": float("inf"), "force_n": None, "indentation_mm": 0.1}, {}, "where a force presses it"),
        ({"friction": float("inf"), "steps": SHEARED, "force_n": None}, {}, "forces and torques move it"),
        ({"probe": Cylinder(diameter_mm=3), "tilt_deg": (3.0, 0.0, 0.0)}, {}, "upright probes"),
        ({"friction": float("inf")}, {}, "a sphere that sticks to a block is solved"),
        (GUIDED, {}, "guided along their way"),
        ({}, {"poisson_ratio": 0.4}, "poisson_ratio"),
    ],
)
def test_what_is_not_solved_on_curved_bodies_is_refused_with_its_cause(press, rubber, words, somewhere):
    given = twin.Press(**{"probe": Sphere(diameter_mm=3), "force_n": (0, 0, 0.5)} | press)
    material = RUBBER.model_copy(update=rubber)
    with pytest.raises(InputError, match=f"material.law = neo_hookean.*{words}"):
        body_strain.BodyStrain(given, FINGER, material, somewhere, PLACES)


@pytest.mark.slow
def test_sphere_that_sticks_and_is_sheared_is_another_codes():
    """Pressed, then pulled along x; the other code holds its own points to its own sphere."""
    truth = json.loads((Path(__file__).parents[2] / "reference" / "stuck_neohooke.json").read_text())
    places = np.array(truth["places_mm"])
    forces = [(0.0, 0.0, truth["steps"][0]["force_n"][1])]
    forces.append((truth["steps"][1]["force_n"][0], 0.0, truth["steps"][1]["force_n"][1]))
    steps = tuple(twin.Step(force_n=force) for force in forces)
    press = twin.Press(probe=Sphere(diameter_mm=truth["diameter_mm"]), friction=float("inf"), steps=steps)
    straight, bent = made("linear", "block_bare").press(press), made(name="block_bare").press(press)
    for before, after, step in zip(straight.path, bent.path, truth["steps"], strict=True):
        assert after.force_n == pytest.approx(before.force_n, abs=1e-9)
        linear = np.array(step["linear_mm"])
        most, change = largest(linear), np.array(step["strained_mm"]) - linear
        more = after.load.strained
        off = largest(more.displacement(places) - change) / most
        assert off < largest(change) / most / 5
        assert off < more.error.markers < 2e-2
    for axis, asked, linear in ((2, 0, 0), (0, 1, 1)):
        wanted = truth["motion_mm"][asked] / truth["motion_linear_mm"][linear] - 1.0
        found = bent.path[asked].move_mm[axis] / straight.path[asked].move_mm[axis] - 1.0
        assert found == pytest.approx(wanted, abs=1.5e-2)


@pytest.mark.slow
def test_linearity_of_a_curved_body_is_that_of_another_code():
    case = TRUTH["cases"][0]
    press = twin.Press(probe=Sphere(diameter_mm=TRUTH["diameter_mm"]), force_n=(0, 0, case["force_n"]))
    sensor = made("linear")
    state = sensor.press(press)
    found = measured_linearity(press, sensor.nominal.body, sensor.nominal.material, state, PLACES)
    straight, bent = np.array(case["linear_mm"]), np.array(case["strained_mm"])
    assert found.linearisation_basis == "measured"
    assert found.linearisation_error == pytest.approx(largest(bent - straight) / largest(straight), rel=0.25)
    assert not found.warnings


def test_linearity_that_is_not_measured_on_a_curved_body_stays_estimated_and_says_why(somewhere):
    press = twin.Press(probe=Sphere(diameter_mm=3), friction=0.5, force_n=(0, 0, 0.5))
    found = measured_linearity(press, FINGER, Material(), somewhere, PLACES)
    assert found.linearisation_basis.startswith("estimated: press.friction = 0.5")
    assert found.linearisation_error == somewhere.validity.linearisation_error
