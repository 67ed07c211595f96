"""What presses cost, warm: one equilibrium of 500 patches, a path of 200 steps, the first press on a body.

Equilibria are timed alone, as they come up within presses on the sensors' own bodies, the compliance between patches at
hand: with friction *warm* the last seven increments of a shear, each from the increments before it, and *cold* a push
and shear at once, from the push without friction and with nothing kept but the compliance. Each is the best of three,
as other work on the machine slows large products.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import twin
from benchmarks.clock import Clock, empty_cache, recorded
from twin.parts.press import Press, Sphere, Step
from twin.world.contact import contact, friction
from twin.world.contact.contact import press
from twin.world.contact.unilateral import Equilibrium, Unilateral

SPEED = "Speed, CPU seconds"
FORCE_N, MU = {"block": 1.0, "finger": 0.4}, 0.5
PROBES = {"block": (Sphere(diameter_mm=10), (1.0, 2.0)), "finger": (Sphere(diameter_mm=3), (-3.0, 1.0))}
TRIES, STEPS, LATEST = 3, 200, 7
ASKED = {
    "frictionless equilibrium": 0.005,
    "friction, cold": 0.030,
    "friction, warm": 0.015,
    f"path of {STEPS} steps": 3.0,
}
FIRST = {"block": 0.5, "finger": 10.0}
"""What issue 4 asks for, s."""


def speed_rows(quick: bool) -> list[dict[str, Any]]:
    """Return one row for every body, kind of work and number of patches; the quick form takes few patches."""
    rows = []
    for body in ("block",) if quick else ("block", "finger"):
        rows += [first_press(body)]
        for across in (12,) if quick else (16, 24):
            rows += equilibria(body, across)
        for across in (12,) if quick else (16, 24) if body == "block" else (16,):
            rows.append(path(body, across, 24 if quick else STEPS))
    return [{"what": SPEED, **row} for row in rows]


def _sensor(body: str, across: int) -> twin.Sensor:
    return twin.Sensor(twin.load_scene(f"{body}_bare", overrides={"accuracy.contact_patches": across}))


def _press(body: str, *steps: Step, mu: float = MU) -> Press:
    probe, at = PROBES[body]
    return Press(probe=probe, at_mm=at, friction=mu, steps=steps)


def _pushed(body: str, x: float = 0.0, torque: float | None = None, push: float = 1.0) -> Step:
    force = FORCE_N[body]
    return Step(force_n=(x * force, 0.0, push * force), torque_nmm=torque)


def _best(work: Callable[..., Any], arguments: tuple[Any, ...]) -> float:
    best = np.inf
    for _ in range(TRIES):
        start = time.process_time()
        work(*arguments)
        best = min(best, time.process_time() - start)
    return best


def _row(body: str, what: str, patches: int, cpu_s: float, residual: float) -> dict[str, Any]:
    asked = FIRST[body] if what == "first press" else ASKED.get(what, "")
    return {"body": body, "work": what, "patches": patches, "cpu_s": cpu_s, "asked_s": asked, "residual": residual}


def equilibria(body: str, across: int) -> list[dict[str, Any]]:
    """Return the rows of single equilibria: without friction, with it from scratch, and from the increment before."""
    sensor, force = _sensor(body, across), FORCE_N[body]
    with recorded(contact, "solve_frictionless") as calls:
        state = sensor.press(_press(body, Step(force_n=(None, None, force)), mu=0.0))
    seconds = _best(contact.solve_frictionless, calls[-1])
    rows = [_row(body, "frictionless equilibrium", len(state.slip), seconds, state.residual)]
    with recorded(friction, "solve_coulomb") as calls:
        state = sensor.press(_press(body, _pushed(body), _pushed(body, 0.6 * MU)))
    seconds = float(np.mean([_best(friction.solve_coulomb, call) for call in calls[-LATEST:]]))
    rows.append(_row(body, "friction, warm", len(state.slip), seconds, state.residual))
    with recorded(friction, "solve_coulomb") as calls:
        state = press(
            _press(body, _pushed(body, 0.6 * MU)), sensor.nominal.body, sensor.compliance, patches_across=across,
            youngs_modulus_mpa=0.5, poisson_ratio=0.5, increments=1,
        )  # fmt: skip
    rows.append(_row(body, "friction, cold", len(state.slip), _best(_anew, calls[-1]), state.residual))
    return rows


def _anew(problem: Unilateral, *guess: Any) -> Equilibrium:
    """Solve by a new solver, which makes again whatever it keeps."""
    return friction.solve_coulomb(replace(problem, solver=problem.between.solver(problem.carried)), *guess)


def path(body: str, across: int, steps: int) -> dict[str, Any]:
    """Return the row of a press, shear and twist in many small steps."""
    sensor, part, torque = _sensor(body, across), steps // 3, 0.05 * MU * FORCE_N[body]
    grow = np.arange(1, part + 1) / part
    walk = [
        *(_pushed(body, push=float(s)) for s in grow),
        *(_pushed(body, x=float(0.6 * MU * s)) for s in grow),
        *(_pushed(body, x=0.6 * MU, torque=float(torque * s)) for s in np.arange(1, steps - 2 * part + 1) / part),
    ]
    sensor.press(_press(body, walk[0]))
    clock = Clock()
    state = sensor.press(_press(body, *walk))
    residual = max(one.residual for one in state.path)
    return _row(body, f"path of {steps} steps", len(state.slip), clock.lap().cpu, residual)


def first_press(body: str) -> dict[str, Any]:
    """Return the row of the first press on a body, its compliance included, compiled code warm."""
    probe, (x, y) = PROBES[body]
    force = (0.0, 0.0, FORCE_N[body])
    with empty_cache():
        _sensor("block", 8).press(Press(probe=Sphere(diameter_mm=3), at_mm=(0, 0), force_n=(0, 0, 0.1)))
        sensor = _sensor(body, 16)
        clock = Clock()
        state = sensor.press(Press(probe=probe, at_mm=(x, y), force_n=force))
        return _row(body, "first press", len(state.slip), clock.lap().cpu, state.residual)
