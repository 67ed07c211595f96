"""Every number of a probe and a press at the ends of what a file can hold: refused as this program does, or computed.

Once a rim of 8.5e-207 mm, whose square is 0, stopped a scene with a division by zero.
"""

import contextlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.flat import BLOCK, HalfSpace
from twin.errors import TwinError
from twin.parts.press import Cone, Cylinder, Pillar, Press, Sphere, Step
from twin.parts.probe import Probe
from twin.world.contact.contact import ContactState, press

EXTREMES = (5e-324, 8.5e-207, 1e-160, 1e-30, 1e-12, 1e-6, 1e3, 1e6, 1e160, 1.7e308)

PROBES: dict[str, Callable[[float], Probe]] = {
    "sphere.diameter_mm": lambda v: Sphere(diameter_mm=v),
    "cylinder.diameter_mm": lambda v: Cylinder(diameter_mm=v),
    "cylinder.edge_mm": lambda v: Cylinder(diameter_mm=4, edge_mm=v),
    "pillar.width_mm": lambda v: Pillar(width_mm=v),
    "pillar.length_mm": lambda v: Pillar(width_mm=4, length_mm=v),
    "pillar.edge_mm": lambda v: Pillar(width_mm=4, edge_mm=v),
    "cone.diameter_mm": lambda v: Cone(apex_deg=140, diameter_mm=v),
    "cone.tip_mm": lambda v: Cone(apex_deg=140, diameter_mm=8, tip_mm=v),
}
SHAPES = (
    Sphere(diameter_mm=3), Pillar(width_mm=4, edge_mm=0.5), Cone(apex_deg=140, diameter_mm=8),
)  # fmt: skip
PUSH = Step(force_n=(None, None, 0.1))
PRESSES: dict[str, Callable[[float], dict[str, Any]]] = {
    "at_mm": lambda v: {"at_mm": (v, 0.0), "force_n": (0, 0, 0.1)},
    "direction": lambda v: {"direction": (v, 0.0, 1.0), "indentation_mm": 0.1},
    "length of direction": lambda v: {"direction": (0.0, 0.0, v), "indentation_mm": 0.1},
    "tilt_deg": lambda v: {"tilt_deg": (v, 0.0, v), "force_n": (0, 0, 0.1)},
    "force_n": lambda v: {"force_n": (0, 0, v)},
    "indentation_mm": lambda v: {"indentation_mm": v},
    "move_mm": lambda v: {"steps": (PUSH, Step(move_mm=(v, None, None)))},
    "force_n, rubbed": lambda v: {"force_n": (0, 0, v), "friction": 0.5},
    "friction": lambda v: {"steps": (PUSH, Step(force_n=(0.01, None, 0.1))), "friction": v},
    "force_n.x": lambda v: {"steps": (PUSH, Step(force_n=(v, None, 0.1))), "friction": 0.5},
    "turn_deg": lambda v: {"steps": (PUSH, Step(turn_deg=v)), "friction": 0.5},
    "torque_nmm": lambda v: {"steps": (PUSH, Step(torque_nmm=v)), "friction": 0.5},
}


def _is_told(key: str, value: float, make: Callable[[], Press]) -> None:
    """Press, and see that an error says the number's range, or that the answer is finite and carries its force."""
    with contextlib.suppress(TwinError):
        state = press(
            make(), BLOCK, HalfSpace(0.45), patches_across=6, youngs_modulus_mpa=1.0, poisson_ratio=0.45, increments=2
        )
        _is_finite(key, value, state)


def _is_finite(key: str, value: float, state: ContactState) -> None:
    numbers = [
        state.indentation_mm, *state.force_n, *state.torques_nmm, state.area_mm2, state.peak_pressure_mpa,
        *state.pressure_mpa, state.elastic_nmm, state.dissipated_nmm, state.validity.mean_strain,
    ]  # fmt: skip
    assert np.isfinite(numbers).all(), (key, value)
    assert state.force_n[2] > 0.0 or (key == "indentation_mm" and value <= 1e-12), (key, value)  # not pressed at all
    assert state.residual <= 1e-8, (key, value)


@pytest.mark.parametrize("key", PROBES)
def test_extreme_sizes_of_a_probe_are_told_or_computed(key: str) -> None:
    for value in EXTREMES:
        _is_told(key, value, lambda value=value: Press(probe=PROBES[key](value), force_n=(0, 0, 0.1)))  # type: ignore[misc]


@pytest.mark.parametrize("key", PRESSES)
def test_extreme_numbers_of_a_press_are_told_or_computed(key: str) -> None:
    for shape in SHAPES:
        for value in EXTREMES:
            _is_told(key, value, lambda shape=shape, value=value: Press(probe=shape, **PRESSES[key](value)))  # type: ignore[misc]


def test_rims_and_tips_too_small_to_see_are_sharp() -> None:
    """What is refused nowhere must be the limit: a rim or tip of 1e-100 mm presses as one of 1e-12 mm does."""
    for make in (PROBES["cylinder.edge_mm"], PROBES["pillar.edge_mm"], PROBES["cone.tip_mm"]):
        small, tiny = (
            press(
                Press(probe=make(size), force_n=(0, 0, 0.1)), BLOCK, HalfSpace(0.45), patches_across=8,
                youngs_modulus_mpa=1.0, poisson_ratio=0.45,
            ).indentation_mm
            for size in (1e-12, 1e-100)
        )  # fmt: skip
        assert math.isclose(small, tiny, rel_tol=1e-9)
