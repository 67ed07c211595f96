"""Random presses on both sensors: none may fail to converge, none may leave a NaN.

``python -m benchmarks presses [--count N] [--body block|finger]`` takes up where it was stopped, and presses again what
failed before; what it has found is in benchmarks/results/presses_BODY.json. Every press is drawn from its own number:
place, probe, size, force, friction and path. A press may be refused, where no answer exists (contact that runs over the
edge, a side force that friction can't carry), with the cause named; anything else is a failure, printed with its
number, and so is a path that stops before its end.

On the block places lie in the window of its table. On the finger they lie in random regions of 5 mm, whose compliance
is solved once each, on the coarse mesh: what is tested is the contact, not the elasticity.

A refusal for want of friction is right where the force lies well outside the cone about the force of a press without
friction, which is the mean of the body's normals over the contact. Near the cone's edge that doesn't say: there the
probe is dragged, held sideways by motion, along the part of the force that friction has to carry. Of all forces
that friction can carry the one of a slide along v gains most along v (the inequality of limit analysis, as in
`twin.world.contact.load_step`): what is asked beyond the largest force along v can't be balanced.
"""

import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from benchmarks.record import Count, machine, read, table, write
from benchmarks.reference import BODIES
from twin.arrays import Floats
from twin.errors import ContactError, InputError, NotSettled, TwinError
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.parts.press import Cone, Cylinder, Pillar, Press, Probe, Sphere, Step
from twin.world.contact.pressing import ContactState, press
from twin.world.elasticity.compliance import Compliance

NEAR = 0.15
"""How far off the edge of the cone, over its size, the mean normal is not relied on."""

_DRAGS = 12


@dataclass(frozen=True, kw_only=True)
class Asked:
    """``share``: the force's tangential part over what friction carries of its normal one; ``ahead``: (2,) its way."""

    share: float
    ahead: Floats


def asked(press: Press, solve: Callable[[Press], ContactState]) -> Asked | None:
    """Return what the last step of a press asks of friction; None where it gives no force sideways."""
    last = press.steps[-1].force_n
    if last is None or not 0.0 < press.friction < math.inf or any(given is None for given in last):
        return None
    bare = solve(press.model_copy(update={"friction": 0.0, "steps": (Step(force_n=(None, None, last[2])),)})).force_n
    force, normal = np.array(last, float), bare / np.linalg.norm(bare)
    push = float(force @ normal)
    rest = force - push * normal
    size = float(np.linalg.norm(rest))
    return Asked(share=size / (press.friction * push), ahead=rest[:2] / max(float(np.hypot(*rest[:2])), 1e-300))


def rightly_refused(press: Press, solve: Callable[[Press], ContactState]) -> bool:
    """Return whether no equilibrium exists under the forces of a press's last step; ``solve`` solves another press."""
    if (wanted := asked(press, solve)) is None or wanted.share < 1.0 - NEAR:
        return False
    if wanted.share > 1.0 + NEAR:
        return True
    force = press.steps[-1].force_n
    before = solve(press.model_copy(update={"steps": press.steps[:-1]}))
    x, y = 4.0 * press.friction * before.indentation_mm / _DRAGS * wanted.ahead
    drag = (Step(force_n=(None, None, force[2]), move_mm=(float(x), float(y), None)),) * _DRAGS
    try:
        path = solve(press.model_copy(update={"steps": (*press.steps[:-1], *drag)})).path
    except ContactError as stopped:  # dragged out of its patches: what came before counts
        path = stopped.last_state.path if stopped.last_state else ()
    dragged = path[len(press.steps) - 1 :]
    reached = [float(state.force_n[:2] @ wanted.ahead) for state in dragged]
    slid = any(bool(state.slip.all()) for state in dragged)
    return slid and float(np.array(force[:2], float) @ wanted.ahead) > max(reached)


RUBBER = Material(youngs_modulus_mpa=0.5, poisson_ratio=0.5)
SITES, SITE_MM = 25, 2.5
"""Regions of the finger, and half their size."""

COUNT, SAVED_EVERY, SLOWEST, AGAIN_S = 5000, 50, 5, 2.0
REFUSALS = ("can't be balanced", "can carry", "slides", "lifted", "sinks in", "over the edge", "misses the sensing",
            "no patch lies", "pushed by", "cone's base", "every patch slips")  # fmt: skip
"""Words of refusals that name a cause."""
UNBALANCED = ("can't be balanced", "can carry", "every patch slips")
"""Those for want of friction, which are checked."""


def drawn(body: str, number: int) -> tuple[Press, int]:
    """Return the press of a number, and its patches across the contact."""
    rng = np.random.default_rng([number, len(body)])
    largest = 6.0 if body == "block" else 2.0
    push = float(10 ** rng.uniform(-1.7, 0.3 if body == "block" else -0.3))
    size = float(largest * 10 ** rng.uniform(-0.5, 0.3))
    probe: Probe = (
        Sphere(diameter_mm=2 * size),
        Cylinder(diameter_mm=size),
        Pillar(width_mm=size, length_mm=float(size * rng.uniform(0.5, 1.5))),
        Cone(apex_deg=float(rng.uniform(100, 160)), diameter_mm=2 * size),
    )[rng.integers(4)]
    friction = (0.0, math.inf, *[float(10 ** rng.uniform(-1.3, 0.3))] * 3)[rng.integers(5)]
    if body == "block":
        at = float(rng.uniform(-15, 15)), float(rng.uniform(-12, 12))
    else:
        x, y = site(number * SITES // COUNT)
        at = float(x + rng.uniform(-1, 1)), float(y + rng.uniform(-1, 1))
    press = Press(probe=probe, at_mm=at, friction=friction, steps=_path(rng, push, friction))
    return press, int(rng.integers(8, 13))


def site(index: int) -> tuple[float, float]:
    """Return the middle (x, y) of a region of the finger."""
    rng = np.random.default_rng([7, index])
    return float(rng.uniform(-5, 2.5)), float(rng.uniform(-2.5, 2.5))


def _path(rng: np.random.Generator, push: float, friction: float) -> tuple[Step, ...]:
    first = Step(force_n=(None, None, push))
    if friction == 0:
        slid = Step(force_n=(None, None, push * 0.7), move_mm=(float(rng.normal(0, 0.1)), None, None))
        return ((first,), (first, slid))[rng.integers(2)]
    most, angle = min(friction, 1.0) * push, float(rng.uniform(0, 2 * math.pi))
    share = float(rng.uniform(0, 0.7))
    x, y = share * most * math.cos(angle), share * most * math.sin(angle)
    shove, drag = Step(force_n=(x, y, push)), Step(force_n=(None, None, push), move_mm=(0.05 * x / push, 0.05, None))
    twist = Step(force_n=(None, None, push), turn_deg=float(rng.normal(0, 4)))
    less, lift = Step(force_n=(None, None, 0.5 * push)), Step(force_n=(None, None, 0.0))
    paths = ((first,), (first, shove), (first, twist), (first, drag, twist), (first, drag, less), (first, lift, first))
    return paths[rng.integers(len(paths))]


def compliance_of(body: str) -> Compliance:
    """Return the compliance that presses are solved on."""
    return Compliance(BODIES[body], RUBBER, level="coarse")


def prepare(body: str, compliance: Compliance, number: int) -> None:
    """Solve the region of a press on the finger, so that every press in it finds it solved."""
    if body == "block":
        return
    steps = np.linspace(-SITE_MM, SITE_MM, 15)
    offset = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    points = BODIES[body].surface_from_above(np.array(site(number * SITES // COUNT)) + offset)
    points = points[np.isfinite(points).all(axis=1)]
    half, force = np.full((len(points), 2), 0.1), np.zeros((len(points), 3))
    compliance.surface(Rectangles(centre_mm=points, frames=BODIES[body].frames(points), half_mm=half, force_n=force))


def outcome(body: str, compliance: Compliance, number: int) -> dict[str, Any]:
    """Return what became of one press; one that seems slow is solved again, as it may have been compiled for."""
    one, across = drawn(body, number)
    rubber = {"youngs_modulus_mpa": RUBBER.youngs_modulus_mpa, "poisson_ratio": RUBBER.poisson_ratio}
    solved = partial(press, body=BODIES[body], compliance=compliance, patches_across=across, **rubber)
    start = time.process_time()
    law = "none" if one.friction == 0 else "sticking" if math.isinf(one.friction) else "Coulomb"
    said = {"number": number, "group": f"{one.probe.kind}, {law}"}
    try:
        state = solved(one)
    except NotSettled as failed:
        return said | {"failed": str(failed)[:200]}
    except (ContactError, InputError) as refused:
        words = next((words for words in REFUSALS if words in str(refused)), None)
        if words in UNBALANCED and not rightly_refused(one, solved):
            return said | {"failed": f"refused, though friction can carry it: {refused}"[:200]}
        return said | ({"refused": words} if words else {"failed": str(refused)[:200]})
    except (TwinError, ArithmeticError, ValueError, np.linalg.LinAlgError) as failed:
        return said | {"failed": f"{type(failed).__name__}: {failed}"[:200]}
    if not state.complete:
        return said | {"failed": state.reason[:200]}
    states = (*state.path, state)
    finite = all(np.isfinite(s.traction_mpa).all() and np.isfinite(s.move_mm).all() for s in states)
    cpu_s = time.process_time() - start
    if cpu_s > AGAIN_S:
        start = time.process_time()
        solved(one)
        cpu_s = min(cpu_s, time.process_time() - start)
    said |= {"residual": max(s.residual for s in states), "cpu_s": cpu_s}
    return said if finite else said | {"failed": "a value is not finite"}


def run(body: str, count: int, stored: dict[str, Any]) -> dict[str, Any]:
    """Take presses up to a count; return the results so far, which are also stored on the way.

    What failed before is taken out of them, and pressed again by today's program.
    """
    found = stored or {"machine": machine(), "done": 0, "groups": {}, "refused": {}, "failed": [], "slowest": []}
    compliance, here = compliance_of(body), -1
    failed, found["failed"] = found["failed"], []
    for one in failed:
        found["groups"][one["group"]]["presses"] -= 1
        found["groups"][one["group"]]["failed"] -= 1
    for number in (*(one["number"] for one in failed), *range(found["done"], count)):
        if (place := number * SITES // COUNT) != here:
            here = place
            prepare(body, compliance, number)
        _count(found, outcome(body, compliance, number))
        if found["done"] % SAVED_EVERY == 0:
            write(f"presses_{body}", found)
    write(f"presses_{body}", found)
    return found


def _count(found: dict[str, Any], one: dict[str, Any]) -> None:
    found["done"] = max(found["done"], one["number"] + 1)
    none = {"presses": 0, "solved": 0, "failed": 0, "mean_s": 0.0, "slowest_s": 0.0, "largest_residual": 0.0}
    group = found["groups"].setdefault(one["group"], none)
    group["presses"] += 1
    if "failed" in one:
        found["failed"].append(one)
        group["failed"] += 1
        print(one, file=sys.stderr)
    elif "refused" in one:
        found["refused"] = dict(Counter(found["refused"]) + Counter([one["refused"]]))
    else:
        group["solved"] += 1
        group["mean_s"] += (one["cpu_s"] - group["mean_s"]) / group["solved"]
        group["slowest_s"] = max(group["slowest_s"], one["cpu_s"])
        group["largest_residual"] = max(group["largest_residual"], one["residual"])
        found["slowest"] = sorted([*found["slowest"], one], key=lambda o: -o["cpu_s"])[:SLOWEST]


def measure(*, count: Count = COUNT, body: Literal["block", "finger"] | None = None) -> int:
    """Run or take up so many presses on each body, print what was found; exit code 1 if any failed."""
    bad = 0
    for name in [body] if body else sorted(BODIES):
        found = run(name, count, read(f"presses_{name}"))
        print(f"\n{name}: {found['done']} presses, {len(found['failed'])} failed, refused: {found['refused']}\n")
        print(table([{"probe and friction": group, **row} for group, row in sorted(found["groups"].items())]))
        print(f"\nslowest: {found['slowest'][:1]}")
        bad += len(found["failed"])
    return int(bad > 0)
