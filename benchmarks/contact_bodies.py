"""What must hold of every press, measured on the sensors' own bodies: balance, complementarity, Coulomb's cone.

Everything but complementarity is worked out anew from the tractions that a state reports. Complementarity (no overlap,
no pull) is the residual that the solver states, which holds the gaps of all candidate patches.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import twin
from benchmarks.clock import Clock
from twin.parts.load import Rectangles
from twin.parts.press import Cylinder, Pillar, Press, Probe, Sphere, Step
from twin.world.contact.contact import ContactState

WEIGHT_N = 0.980665
"""100 gf."""

PLACES: dict[str, tuple[tuple[float, float], Probe, Probe]] = {
    "block": ((3.0, -5.0), Sphere(diameter_mm=10), Pillar(width_mm=4, length_mm=6)),
    "finger": ((-3.0, 1.0), Sphere(diameter_mm=3), Cylinder(diameter_mm=3)),
}
"""Where each body is pressed, and by what."""

MU = 0.5


def body_rows(quick: bool) -> list[dict[str, Any]]:
    """Return one row for every body, probe and path; the quick form takes the block only."""
    rows = []
    for body, (at, ball, flat) in PLACES.items():
        if quick and body == "finger":
            continue
        sensor = twin.Sensor(twin.load_scene(f"{body}_bare"))
        for probe in (ball, flat):
            for path, friction, steps in _paths(probe):
                wanted = Press(probe=probe, at_mm=at, friction=friction, steps=steps)
                clock = Clock()
                state = sensor.press(wanted)
                rows.append(
                    {"body": body, "probe": probe.kind, "path": path, "patches": len(state.pressure_mpa)}
                    | held(state, steps)
                    | {"cpu_s": clock.lap().cpu}
                )
    return rows


def _paths(probe: Probe) -> list[tuple[str, float, tuple[Step, ...]]]:
    weight = Step(force_n=(None, None, WEIGHT_N))
    side, torque = 0.4 * MU * WEIGHT_N, 0.05 * MU * WEIGHT_N
    shove, turn = Step(force_n=(side, 0.0, WEIGHT_N)), Step(force_n=(side, 0.0, WEIGHT_N), torque_nmm=torque)
    slide = Step(force_n=(None, None, WEIGHT_N), move_mm=(0.2, 0.1, None))
    return [
        ("100 gf, frictionless", 0.0, (weight,)),
        ("100 gf, frictionless, moved sideways", 0.0, (weight, slide)),
        (f"100 gf, mu = {MU}, sheared, twisted", MU, (weight, shove, turn)),
        ("100 gf, sticking, sheared", math.inf, (weight, shove)),
    ]


def held(state: ContactState, steps: tuple[Step, ...]) -> dict[str, Any]:
    """Return how far the last state of a path is from what must hold, over the weight or the peak pressure."""
    (patches,) = state.load.terms
    assert isinstance(patches, Rectangles)
    asked, peak = steps[-1].force_n, state.peak_pressure_mpa
    total = patches.force_n.sum(axis=0)
    missed = [abs(got - want) for got, want in zip(total, asked, strict=True) if want is not None]
    normal = patches.frames[:, 2]
    pressure = np.einsum("ki,ki->k", state.traction_mpa, normal)
    sideways = np.linalg.norm(state.traction_mpa - pressure[:, None] * normal, axis=1)
    out: dict[str, Any] = {
        "imbalance": max(missed) / WEIGHT_N,
        "complementarity": state.residual,
        "pull": max(0.0, -float(pressure.min())) / peak,
    }
    if state.friction == 0:
        out["tangential over normal"] = float(sideways.max()) / peak
    elif math.isfinite(state.friction):
        out["out of the cone"] = max(0.0, float(np.max(sideways - state.friction * pressure))) / peak
    return out
