"""Presses at finite strain: against another code's slab, closed forms of the law, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

import twin
from twin.errors import NotSettled, TwinError
from twin.parts.material import Material
from twin.parts.probe import Cone, Cylinder, Object, Pillar, Sphere
from twin.world.contact import finite_strain
from twin.world.elasticity.strain_law import cofactor_slope, cofactors, strain_law

TRUTH = json.loads((Path(__file__).parents[2] / "reference" / "neohooke.json").read_text())
PLACES = np.array([[r, 0.0, z] for r, z in TRUTH["places_mm"]])
PROBES = {"sphere": Sphere, "cylinder": Cylinder, "cone": Cone}


def made(law="neo_hookean", name="block_bare", **overrides):
    return twin.Sensor(
        twin.load_scene(name, overrides={"material.youngs_modulus_mpa": 1.0, "material.law": law, **overrides})
    )


def largest(vectors):
    return np.linalg.norm(vectors, axis=1).max()


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(
            case,
            marks=[] if case["force_n"] == 3.0 else [pytest.mark.slow],
            id=f"{case['kind']}-{case.get('edge_mm', 0)}-{case['force_n']}-{case.get('law', 'neo_hookean')}",
        )
        for case in TRUTH["cases"]
    ],
)
@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_difference_to_linear_theory_is_that_of_another_code(case):
    """The slab is round and ends 47.5 mm away, the block 45 and 50: that is part of the 0.1 %."""
    size = {key: case[key] for key in ("diameter_mm", "edge_mm", "apex_deg", "tip_mm") if key in case}
    press = twin.Press(probe=PROBES[case["kind"]](**size), force_n=(0, 0, case["force_n"]))
    states, moved = [], []
    for law in ("linear", case.get("law", "neo_hookean")):
        ratios = () if law == "linear" else case.get("ratios", ())
        sensor = made(law, **{"material.law_ratios": ratios})
        states.append(sensor.press(press))
        moved.append(sensor.displacement(PLACES, states[-1])[:, [0, 2]])
    straight, bent = np.array(case["linear_mm"]), np.array(case["strained_mm"])
    most = largest(straight)
    missed = largest(bent - straight) / most
    off = largest((moved[1] - moved[0]) - (bent - straight)) / most
    assert off < 1e-3 < missed / 5
    assert off < states[1].error.strain.markers + case["own_error"] < 1e-2
    deeper = (case["indentation_mm"] - case["indentation_linear_mm"]) / case["indentation_linear_mm"]
    found = states[1].indentation_mm / states[0].indentation_mm - 1.0
    assert found == pytest.approx(deeper, abs=2e-3)
    if "contact_mm" in case:
        assert states[1].contact_radius_mm == pytest.approx(case["contact_mm"], rel=1.5e-2)
    assert states[1].force_n == pytest.approx([0.0, 0.0, case["force_n"]], abs=1e-9)
    assert states[1].move_mm[2] == pytest.approx(states[1].indentation_mm, rel=1e-9)


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_sharp_rim_is_the_limit_of_sharper_and_sharper_ones():
    """Another code's rim has 0.05 mm; points that touch at rest and never let go would make 0.8 % to 3.2 %."""
    case = next(one for one in TRUTH["cases"] if one.get("edge_mm") == 0.05)
    straight, bent = np.array(case["linear_mm"]), np.array(case["strained_mm"])
    state = made().press(twin.Press(probe=Cylinder(diameter_mm=5), force_n=(0, 0, 3.0)))
    moved = state.load.strained.displacement(PLACES)[:, [0, 2]]
    off = largest(moved - (bent - straight)) / largest(straight)
    assert off < 1.5e-3 < largest(bent - straight) / largest(straight) / 5
    assert off < state.error.strain.markers < 3e-3
    assert state.validity.linearisation_error == pytest.approx(0.0081, rel=0.2)


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_load_steps_end_where_one_step_does(monkeypatch):
    press = twin.Press(probe=Cylinder(diameter_mm=5, edge_mm=0.2), force_n=(0, 0, 3.0))
    once = made().press(press).load.strained
    settle = finite_strain.FiniteStrain.settled
    left = [1]

    def failing(self, slab, touch, state, force, *, linear):
        if not linear and left:
            left.pop()
            raise NotSettled("contact: the first attempt")
        return settle(self, slab, touch, state, force, linear=linear)

    monkeypatch.setattr(finite_strain.FiniteStrain, "settled", failing)
    steps = made().press(press).load.strained
    assert not left
    field = once.displacement(PLACES)
    assert steps.displacement(PLACES) == pytest.approx(field, abs=1e-3 * largest(field))


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_press_that_fails_at_once_is_solved_in_load_steps(monkeypatch):
    """Under 6 N on a fairly sharp cylinder Newton's steps from the linear answer do not converge."""
    press = twin.Press(probe=Cylinder(diameter_mm=5, edge_mm=0.2), force_n=(0, 0, 6.0))
    assert made().press(press).load.strained.indentation_mm > 0.02
    monkeypatch.setattr(finite_strain, "LOAD_STEPS", 1)
    with pytest.raises(TwinError, match="did not converge, nor did they in 1 load"):
        made().press(press)


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_press_elsewhere_and_of_other_units_is_the_same_press():
    """Moved along the face; E, force 1 and 1 or 0.2 and 0.2."""
    press = twin.Press(probe=Sphere(diameter_mm=6), force_n=(0, 0, 3.0))
    there = twin.Press(probe=Sphere(diameter_mm=6), force_n=(0, 0, 0.6), at_mm=(6.0, -5.0))
    one, other = made(), made(**{"material.youngs_modulus_mpa": 0.2})
    states = one.press(press), other.press(there)
    more = [state.load.strained for state in states]
    moved = PLACES + np.array([6.0, -5.0, 0.0])
    assert more[1].displacement(moved) == pytest.approx(more[0].displacement(PLACES), abs=1e-6)
    step = 1e-5 * np.eye(3)
    inside = moved[1:9] + np.array([0.0, 0.3, 0.1])
    slope = [more[1].displacement(inside + h) - more[1].displacement(inside - h) for h in step]
    assert more[1].gradient(inside) == pytest.approx(np.stack(slope, axis=2) / 2e-5, abs=1e-7)


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_every_step_of_a_path_has_its_own_strain():
    steps = tuple(twin.Step(force_n=(None, None, force)) for force in (1.0, 3.0, 1.0))
    path = made().press(twin.Press(probe=Sphere(diameter_mm=6), steps=steps)).path
    once = made().press(twin.Press(probe=Sphere(diameter_mm=6), force_n=(0, 0, 1.0)))
    assert [path[0].indentation_mm, path[2].indentation_mm] == pytest.approx([once.indentation_mm] * 2, rel=1e-6)
    assert path[1].indentation_mm > 1.5 * path[0].indentation_mm


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_probe_held_by_a_motion_carries_the_force_of_another_code():
    """There the probe is this much deeper under 3 N than by linear theory."""
    case = next(one for one in TRUTH["cases"] if one["kind"] == "sphere" and one["force_n"] == 3.0)
    sphere = Sphere(diameter_mm=6)
    straight = made("linear").press(twin.Press(probe=sphere, at_mm=(3.0, 2.0), force_n=(0, 0, 3.0)))
    deep = straight.indentation_mm * case["indentation_mm"] / case["indentation_linear_mm"]
    sensor = made()
    held = sensor.press(twin.Press(probe=sphere, steps=(twin.Step(move_mm=(3.0, 2.0, deep)),)))
    assert held.indentation_mm == pytest.approx(deep, rel=1e-4)
    assert held.force_n[2] == pytest.approx(3.0, rel=2e-3)
    assert 0.0 < held.error.strain.force < 1e-2
    assert held.error.strain.indentation == 0.0
    forced = sensor.press(twin.Press(probe=sphere, at_mm=(3.0, 2.0), force_n=(0, 0, float(held.force_n[2]))))
    places = PLACES + np.array([3.0, 2.0, 0.0])
    moved = [sensor.displacement(places, state) for state in (forced, held)]
    assert largest(moved[1] - moved[0]) < 1e-4 * largest(moved[0])


@pytest.mark.parametrize(
    ("press", "scene", "words"),
    [
        ({"friction": 0.5}, {}, "friction"),
        ({"probe": Pillar(width_mm=4), "tilt_deg": (3.0, 0.0, 0.0)}, {}, "upright probes"),
        ({"probe": Cylinder(diameter_mm=5), "force_n": (0, 0, 9.0)}, {}, "did not converge"),
        ({"probe": Object(shape="ring", width_mm=8.0)}, {}, "press.probe.kind = object"),
        ({}, {"material.poisson_ratio": 0.4}, "poisson_ratio"),
    ],
)
@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_what_is_not_solved_is_refused_with_its_cause(press, scene, words):
    given = {"probe": Sphere(diameter_mm=6), "force_n": (0, 0, 1.0)} | press
    with pytest.raises(TwinError, match=f"material.law = neo_hookean.*{words}"):
        made(**scene).press(twin.Press(**given))


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_loads_that_no_press_made_are_refused():
    sensor = made()
    load = twin.Traction.disk((0, 0), 2.0, (0, 0, 1.0))
    with pytest.raises(TwinError, match="one press at a time"):
        sensor.displacement(PLACES, load)
    state = sensor.press(twin.Press(probe=Sphere(diameter_mm=6), force_n=(0, 0, 1.0)))
    with pytest.raises(TwinError, match="one press at a time"):
        sensor.displacement(PLACES, state.load + load)


LAWS = {
    "neo_hookean": Material(law="neo_hookean"),
    "mooney_rivlin": Material(law="mooney_rivlin", law_ratios=(0.6,)),
    "yeoh": Material(law="yeoh", law_ratios=(-0.1, 0.04)),
}
every_law = pytest.mark.parametrize("law", [strain_law(material) for material in LAWS.values()], ids=LAWS)


def energy_slopes(name, first, second):
    """Return dW/dI1 and dW/dI2 for a shear modulus of 1, by the textbook's constants."""
    if name == "mooney_rivlin":
        c1 = 0.5 / 1.6
        return c1, 0.6 * c1
    if name == "yeoh":
        return 0.5 * (1.0 - 0.2 * (first - 3.0) + 0.12 * (first - 3.0) ** 2), 0.0
    return 0.5, 0.0


def stress_at(law, gradient, pressure):
    """Return P for a shear modulus of 1."""
    cofactor, ratio = cofactors(gradient)
    return law.stress(gradient, cofactor, ratio) + pressure * cofactor


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("stretch", [0.5, 0.9, 1.0, 1.4, 2.0])
def test_uniaxial_stress_is_the_closed_form(name, stretch):
    """Nominal stress 2 (l - l^-2) (W1 + W2 / l) of incompressible rubber, the sides free (Treloar 1975)."""
    law = strain_law(LAWS[name])
    gradient = np.diag([stretch, stretch**-0.5, stretch**-0.5])
    cofactor, _ = cofactors(gradient)
    sides = stress_at(law, gradient, 0.0)[1, 1]
    stress = stress_at(law, gradient, -sides / cofactor[1, 1])
    first, second = energy_slopes(name, stretch**2 + 2.0 / stretch, 2.0 * stretch + stretch**-2)
    expected = 2.0 * (stretch - stretch**-2) * (first + second / stretch)
    assert stress == pytest.approx(np.diag([expected, 0.0, 0.0]), abs=1e-12)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("shear", [0.1, 1.0])
def test_simple_shear_is_the_closed_form(name, shear):
    """Cauchy's stresses 2 (W1 + W2) g, and 2 W1 g^2 and -2 W2 g^2 as differences of normal ones (Rivlin 1948)."""
    gradient = np.eye(3)
    gradient[0, 1] = shear
    cauchy = stress_at(strain_law(LAWS[name]), gradient, 0.3) @ gradient.T
    first, second = energy_slopes(name, 3.0 + shear**2, 3.0 + shear**2)
    assert cauchy[0, 1] == pytest.approx(2.0 * (first + second) * shear, rel=1e-12)
    assert cauchy[0, 0] - cauchy[2, 2] == pytest.approx(2.0 * first * shear**2, rel=1e-11)
    assert cauchy[1, 1] - cauchy[2, 2] == pytest.approx(-2.0 * second * shear**2, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("name", ["neo_hookean", "mooney_rivlin"])
def test_torsion_of_a_cylinder_is_the_closed_form(name):
    """Torque pi t a^4 (W1 + W2) and axial force -pi t^2 a^4 (W1 + 2 W2) / 2 at t a = 1 (Rivlin 1949)."""
    law = strain_law(LAWS[name])
    twist, radius = 0.5, 2.0
    at, weight = np.polynomial.legendre.leggauss(8)
    r = radius * (1.0 + at) / 2.0
    weight = weight * radius / 2.0
    gradient = np.zeros((len(r), 3, 3)) + np.eye(3)  # axes: r, about, z
    gradient[:, 1, 2] = twist * r
    cauchy = stress_at(law, gradient, 0.0) @ gradient.transpose(0, 2, 1)
    # radial balance d(srr)/dr = (stt - srr) / r with a free side; sums of srr by parts
    hoop = cauchy[:, 1, 1] - cauchy[:, 0, 0]
    axial = cauchy[:, 2, 2] - cauchy[:, 0, 0]
    first, second = energy_slopes(name, 3.0, 3.0)
    torque = 2.0 * np.pi * (weight * r**2) @ cauchy[:, 1, 2]
    assert torque == pytest.approx(np.pi * twist * radius**4 * (first + second), rel=1e-10)
    force = 2.0 * np.pi * (weight * r) @ (axial - hoop / 2.0)
    assert force == pytest.approx(-np.pi / 2.0 * twist**2 * radius**4 * (first + 2.0 * second), rel=1e-10)


@every_law
def test_law_turns_with_the_frame_and_is_linear_theory_at_rest(law):
    rng = np.random.default_rng(5)
    gradient = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    assert stress_at(law, turn @ gradient, 0.7) == pytest.approx(turn @ stress_at(law, gradient, 0.7), abs=1e-12)
    assert stress_at(law, turn, 0.0) == pytest.approx(np.zeros((3, 3)), abs=1e-12)
    cofactor, ratio = cofactors(np.eye(3))
    small = rng.standard_normal((3, 3))
    slope = law.slope(np.eye(3), cofactor, ratio, cofactor_slope(np.eye(3)))
    assert np.einsum("ijkl,kl->ij", slope, small) == pytest.approx(small + small.T, abs=1e-12)


@every_law
def test_slope_of_the_law_is_that_of_its_stress(law):
    gradient = np.eye(3) + 0.3 * np.random.default_rng(6).standard_normal((3, 3))
    cofactor, ratio = cofactors(gradient)
    cofactor_change = cofactor_slope(gradient)
    slope = law.slope(gradient, cofactor, ratio, cofactor_change) + 0.7 * cofactor_change
    for k, m in np.ndindex(3, 3):
        nudge = np.zeros((3, 3))
        nudge[k, m] = 1e-6
        change = (stress_at(law, gradient + nudge, 0.7) - stress_at(law, gradient - nudge, 0.7)) / 2e-6
        assert slope[:, :, k, m] == pytest.approx(change, abs=1e-8)


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


@pytest.mark.filterwarnings("ignore::twin.errors.AccuracyWarning")
def test_stiffening_rubber_is_pressed_in_less_and_mooney_rivlin_of_ratio_0_is_neo_hookes():
    press = twin.Press(probe=Sphere(diameter_mm=6), force_n=(0, 0, 3.0))
    depths = {}
    for name, law, ratios in [
        ("neo", "neo_hookean", ()),
        ("same", "mooney_rivlin", (0.0,)),
        ("mooney", "mooney_rivlin", (0.6,)),
        ("yeoh", "yeoh", (0.3, 0.1)),
    ]:
        depths[name] = made(law, **{"material.law_ratios": ratios}).press(press).indentation_mm
    assert depths["same"] == pytest.approx(depths["neo"], rel=1e-12)
    assert depths["yeoh"] < depths["neo"] - 2e-3
    assert abs(depths["mooney"] - depths["neo"]) > 1e-3
