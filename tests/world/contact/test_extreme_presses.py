"""Every number of a probe and a press at the ends of what a file can hold: refused or computed.

Once a rim of 8.5e-207 mm, whose square is 0, stopped a scene with a division by zero.
"""

import contextlib
import math
import warnings

import numpy as np
import pytest
from presses import STUCK, assert_coulomb, pressed, push, sideways

import twin
from benchmarks.flat import HalfSpace
from twin.errors import TwinError
from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere, Step

EXTREMES = (5e-324, 8.5e-207, 1e-160, 1e-30, 1e-12, 1e-6, 1e3, 1e6, 1e160, 1.7e308)

PROBES = {
    "sphere.diameter_mm": lambda v: Sphere(diameter_mm=v),
    "cylinder.diameter_mm": lambda v: Cylinder(diameter_mm=v),
    "cylinder.edge_mm": lambda v: Cylinder(diameter_mm=4, edge_mm=v),
    "pillar.width_mm": lambda v: Pillar(width_mm=v),
    "pillar.length_mm": lambda v: Pillar(width_mm=4, length_mm=v),
    "pillar.edge_mm": lambda v: Pillar(width_mm=4, edge_mm=v),
    "cone.diameter_mm": lambda v: Cone(apex_deg=140, diameter_mm=v),
    "cone.tip_mm": lambda v: Cone(apex_deg=140, diameter_mm=8, tip_mm=v),
}
SHAPES = (Sphere(diameter_mm=3), Pillar(width_mm=4, edge_mm=0.5), Cone(apex_deg=140, diameter_mm=8))
LOAD = {"force_n": (0, 0, 0.1)}
DEEP = {"indentation_mm": 0.1}


def after_a_push(**step):
    return {"steps": (push(0.1), Step(**step)), "friction": 0.5}


PRESSES = {
    "at_mm": lambda v: {"at_mm": (v, 0.0), **LOAD},
    "direction": lambda v: {"direction": (v, 0.0, 1.0), **DEEP},
    "length of direction": lambda v: {"direction": (0.0, 0.0, v), **DEEP},
    "tilt_deg": lambda v: {"tilt_deg": (v, 0.0, v), **LOAD},
    "force_n": lambda v: {"force_n": (0, 0, v)},
    "indentation_mm": lambda v: {"indentation_mm": v},
    "move_mm": lambda v: {"steps": (push(0.1), sideways(v))},
    "force_n, rubbed": lambda v: {"force_n": (0, 0, v), "friction": 0.5},
    "friction": lambda v: after_a_push(force_n=(0.01, None, 0.1)) | {"friction": v},
    "force_n.x": lambda v: after_a_push(force_n=(v, None, 0.1)),
    "turn_deg": lambda v: after_a_push(turn_deg=v),
    "torque_nmm": lambda v: after_a_push(torque_nmm=v),
}
CASES = [(key, lambda v, make=make: [{"probe": make(v), **LOAD}]) for key, make in PROBES.items()]
CASES += [
    (key, lambda v, make=make: [{"probe": shape, **make(v)} for shape in SHAPES]) for key, make in PRESSES.items()
]


def on_half_space(wanted, across, nu=0.45, **more):
    return pressed(wanted, on=HalfSpace(nu), nu=nu, across=across, **more)


@pytest.mark.parametrize(("key", "keys_of"), CASES, ids=[key for key, _ in CASES])
def test_extreme_numbers_are_refused_or_computed(key, keys_of):
    """An error of this program, or an answer that is finite and carries its force."""
    for value in EXTREMES:
        made = []
        with contextlib.suppress(TwinError):
            made = keys_of(value)
        for keys in made:
            with contextlib.suppress(TwinError):
                state = on_half_space(Press(**keys), 6, increments=2)
                _assert_finite(key, value, state)


def _assert_finite(key, value, state):
    sizes = [state.indentation_mm, state.area_mm2, state.peak_pressure_mpa]
    work = [state.elastic_nmm, state.dissipated_nmm, state.validity.mean_strain]
    numbers = [*sizes, *state.force_n, *state.torques_nmm, *state.pressure_mpa, *work]
    assert np.isfinite(numbers).all(), (key, value)
    not_pressed = key == "indentation_mm" and value <= 1e-12
    assert state.force_n[2] > 0.0 or not_pressed, (key, value)
    assert state.residual <= 1e-8, (key, value)


@pytest.mark.parametrize("key", ["cylinder.edge_mm", "pillar.edge_mm", "cone.tip_mm"])
def test_rims_and_tips_too_small_to_see_are_sharp(key):
    """A rim or tip of 1e-100 mm presses as one of 1e-12 mm does."""
    small, tiny = (on_half_space(Press(probe=PROBES[key](size), **LOAD), 8).indentation_mm for size in (1e-12, 1e-100))
    assert math.isclose(small, tiny, rel_tol=1e-9)


@pytest.mark.parametrize("patches", [10, pytest.param(16, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("probe", "steps"),
    [
        (Pillar(width_mm=4, edge_mm=0.5), (push(0.0039), sideways(0.047))),
        (Sphere(diameter_mm=20), (push(0.033, move_mm=(0.225, None, None)),)),
    ],
)
def test_friction_beyond_any_material_sticks(probe, steps, patches):
    """Stick and slip of patches at the border did not settle under a light press moved sideways."""
    keys = {"material.poisson_ratio": 0.3, "accuracy.contact_patches": patches}
    sensor = twin.Sensor(twin.load_scene("block_bare", keys))
    wanted = [Press(probe=probe, friction=mu, steps=steps) for mu in (1e5, STUCK)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        much, stuck = map(sensor.press, wanted)
    assert much.complete
    assert stuck.complete
    assert (much.friction, stuck.friction) == (1e5, STUCK)  # as asked, not as solved
    np.testing.assert_allclose(much.force_n, stuck.force_n, atol=1e-12)


@pytest.mark.parametrize("across", [8, pytest.param(12, marks=pytest.mark.slow)])
def test_a_light_press_moved_far_sideways_under_much_friction_settles(across):
    """The border carries a hundredth of its drag as normal force: Newton's steps alone swung."""
    steps = (push(0.02), Step(move_mm=(0.0533, 0.0399, None)))
    wanted = Press(probe=Pillar(width_mm=3, edge_mm=0.5), friction=100, steps=steps)
    state = on_half_space(wanted, across, nu=0.3, increments=4)
    assert state.complete
    assert_coulomb(state, 100)
