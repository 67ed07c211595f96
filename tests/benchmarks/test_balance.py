"""What tells a right refusal for want of friction: the cone about the normal, and near its edge a drag."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.presses import asked, rightly_refused
from twin.parts.body import Block, Finger
from twin.parts.press import Cone, Pillar, Press, Probe, Sphere, Step

FLAT = Block(width_mm=40, length_mm=40, thickness_mm=20)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
MU = 0.5


def shoved(share: float) -> Press:
    steps = (Step(force_n=(None, None, 1.0)), Step(force_n=(share * MU * 0.6, -share * MU * 0.8, 1.0)))
    return Press(probe=Sphere(diameter_mm=5), at_mm=(0, 0), friction=MU, steps=steps)


def carrying(least: float) -> Any:
    """Return a contact that carries ``least`` sideways, over mu, once it is dragged."""

    def solve(press: Press) -> Any:
        ways = [np.array([0.0 if way is None else way for way in step.move_mm[:2]]) for step in press.steps]
        states = [
            SimpleNamespace(
                force_n=np.array([*(least * MU * way / (np.hypot(*way) or 1.0)), 1.0]),
                slip=np.array([bool(way.any())]), indentation_mm=0.1,
            )
            for way in ways
        ]  # fmt: skip
        return SimpleNamespace(path=states, **vars(states[-1]))

    return solve


@pytest.mark.parametrize(("share", "carried", "right"), [
    (0.5, 0.0, False), (2.0, 9.0, True), (0.98, 1.0, False), (1.02, 1.0, True), (1.02, 1.05, False), (0.98, 0.9, True),
])  # fmt: skip
def test_only_what_friction_cannot_carry_is_rightly_refused(share: float, carried: float, right: bool) -> None:
    assert rightly_refused(shoved(share), FLAT, carrying(carried)) is right


@pytest.mark.parametrize(("probe", "radius"), [
    (Sphere(diameter_mm=2), 1.0), (Cone(apex_deg=150, diameter_mm=0.2), 0.0), (Pillar(width_mm=4, length_mm=6), None),
])  # fmt: skip
def test_the_normal_is_that_of_the_point_met_first(probe: Probe, radius: float | None) -> None:
    """A sphere of radius r at y beside a cylinder of radius R meets it where sin = y / (R + r), a flat at its crest."""
    sine = 0.0 if radius is None else 2.0 / (8.0 + radius)
    press = Press(probe=probe, at_mm=(-4, 2), friction=MU, steps=(Step(force_n=(0.0, 0.0, 1.0)),))
    wanted = asked(press, FINGER)
    assert wanted.share * MU == pytest.approx(np.tan(np.arcsin(sine)), abs=6e-3)
