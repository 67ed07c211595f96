"""Random presses on both sensors: none may fail to converge, none may leave a NaN.

``python -m benchmarks.presses [--count N] [--body block|finger]`` takes up where it was stopped, and presses again what
failed before; what it has found is in benchmarks/results/presses_BODY.json. Every press is drawn from its own number:
place, probe, size, force, friction and path. A press may be refused, where no answer exists (contact that runs over the
edge, a side force that friction can't carry), with the cause named; anything else is a failure, printed with its
number. So is a path that stops before its end, and a refusal for want of friction of a force that friction can carry
(`benchmarks.balance` tells).

On the block places lie in the window of its table. On the finger they lie in random regions of 5 mm, whose compliance
is solved once each, on the coarse mesh: what is tested is the contact, not the elasticity.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.__main__ import RESULTS, machine, table
from benchmarks.arguments import at_least
from benchmarks.balance import rightly_refused
from twin.errors import ContactError, InputError, NotSettled, TwinError
from twin.parts.body import Block, Body, Finger
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.parts.press import Cone, Cylinder, Pillar, Press, Probe, Sphere, Step
from twin.world.contact.contact import ContactState, press
from twin.world.elasticity.compliance import Compliance

BODIES: dict[str, Body] = {
    "block": Block(width_mm=100, length_mm=90, thickness_mm=40),
    "finger": Finger(radius_mm=8, barrel_mm=8, skirt_mm=2),
}
RUBBER = Material(youngs_modulus_mpa=0.5, poisson_ratio=0.5)
SITES, SITE_MM = 25, 2.5
"""Regions of the finger, and half their size."""

COUNT, SAVED_EVERY, SLOWEST, AGAIN_S = 5000, 50, 5, 2.0
REFUSALS = ("can't be balanced", "can carry", "slides", "lifted", "sinks in", "over the edge", "misses the sensing",
            "no patch lies", "pushed by", "cone's base", "every patch slips")  # fmt: skip
"""Words of refusals that name a cause."""
UNBALANCED = ("can't be balanced", "can carry", "every patch slips")
"""Those for want of friction, which are checked."""


@dataclass(frozen=True)
class Drawn:
    """A press by its number."""

    press: Press
    across: int


def drawn(body: str, number: int) -> Drawn:
    """Return the press of a number."""
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
    return Drawn(
        press=Press(probe=probe, at_mm=_place(body, number, rng), friction=friction, steps=_path(rng, push, friction)),
        across=int(rng.integers(8, 13)),
    )


def _place(body: str, number: int, rng: np.random.Generator) -> tuple[float, float]:
    if body == "block":
        return float(rng.uniform(-15, 15)), float(rng.uniform(-12, 12))
    x, y = site(number * SITES // COUNT)
    return float(x + rng.uniform(-1, 1)), float(y + rng.uniform(-1, 1))


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
    k = len(points)
    frames, half = BODIES[body].frames(points), np.full((k, 2), 0.1)
    compliance.surface(Rectangles(centre_mm=points, frames=frames, half_mm=half, force_n=np.zeros((k, 3))))


def outcome(body: str, compliance: Compliance, number: int) -> dict[str, Any]:
    """Return what became of one press; one that seems slow is solved again, as it may have been compiled for."""
    said = _outcome(body, compliance, number)
    if said.get("cpu_s", 0.0) > AGAIN_S:
        again = _outcome(body, compliance, number)
        said |= {"cpu_s": min(said["cpu_s"], again.get("cpu_s", math.inf))}
    return said


def _outcome(body: str, compliance: Compliance, number: int) -> dict[str, Any]:
    one = drawn(body, number)

    def solved(wanted: Press) -> ContactState:
        return press(
            wanted, BODIES[body], compliance, patches_across=one.across,
            youngs_modulus_mpa=RUBBER.youngs_modulus_mpa, poisson_ratio=RUBBER.poisson_ratio,
        )  # fmt: skip

    start = time.process_time()
    said = {"number": number, "probe": one.press.probe.kind, "friction": _law(one.press.friction)}
    try:
        state = solved(one.press)
    except NotSettled as failed:
        return said | {"failed": str(failed)[:200]}
    except (ContactError, InputError) as refused:
        words = next((words for words in REFUSALS if words in str(refused)), None)
        if words in UNBALANCED and not rightly_refused(one.press, BODIES[body], solved):
            return said | {"failed": f"refused, though friction can carry it: {refused}"[:200]}
        return said | ({"refused": words} if words else {"failed": str(refused)[:200]})
    except (TwinError, ArithmeticError, ValueError, np.linalg.LinAlgError) as failed:
        return said | {"failed": f"{type(failed).__name__}: {failed}"[:200]}
    if not state.complete:
        return said | {"failed": state.reason[:200]}
    states = (*state.path, state)
    finite = all(np.isfinite(s.traction_mpa).all() and np.isfinite(s.move_mm).all() for s in states)
    said |= {"residual": max(s.residual for s in states), "cpu_s": time.process_time() - start}
    return said if finite else said | {"failed": "a value is not finite"}


def _law(friction: float) -> str:
    return "none" if friction == 0 else "sticking" if math.isinf(friction) else "Coulomb"


def summary(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the table of a body's results, one row a probe and law of friction."""
    return [{"probe and friction": name, **group} for name, group in sorted(found["groups"].items())]


def run(body: str, count: int, stored: dict[str, Any] | None) -> dict[str, Any]:
    """Take presses up to a count; return the results so far, which are also stored on the way."""
    found = stored or {"machine": machine(), "done": 0, "groups": {}, "refused": {}, "failed": [], "slowest": []}
    compliance, here = compliance_of(body), -1
    for one in _taken_back(found):
        _count(found, outcome(body, compliance, one["number"]))
    for number in range(found["done"], count):
        if (place := number * SITES // COUNT) != here:
            here = place
            prepare(body, compliance, number)
        _count(found, outcome(body, compliance, number))
        if found["done"] % SAVED_EVERY == 0:
            file(body).write_text(json.dumps(found, indent=1) + "\n")
    file(body).write_text(json.dumps(found, indent=1) + "\n")
    return found


def _taken_back(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Take what failed out of the results, to be pressed again by today's program."""
    failed, found["failed"] = found["failed"], []
    for one in failed:
        group = found["groups"][_group(one)]
        group["presses"] -= 1
        group["failed"] -= 1
    return list(failed)


def _group(one: dict[str, Any]) -> str:
    return f"{one['probe']}, {one['friction']}"


def _count(found: dict[str, Any], one: dict[str, Any]) -> None:
    found["done"] = max(found["done"], one["number"] + 1)
    name = _group(one)
    group = found["groups"].setdefault(
        name, {"presses": 0, "solved": 0, "failed": 0, "mean_s": 0.0, "slowest_s": 0.0, "largest_residual": 0.0}
    )
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


def file(body: str) -> Any:
    """Return where a body's results are stored."""
    return RESULTS / f"presses_{body}.json"


def main() -> int:
    """Run or take up the presses, print what was found; exit code 1 if any failed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.presses", description=__doc__)
    parser.add_argument("--count", type=at_least(1), default=COUNT, help=f"presses on each body (default {COUNT})")
    parser.add_argument("--body", choices=sorted(BODIES), help="one body only")
    parser.add_argument("--anew", action="store_true", help="forget what was found before")
    arguments = parser.parse_args()
    bad = 0
    for body in [arguments.body] if arguments.body else sorted(BODIES):
        kept = file(body)
        stored = json.loads(kept.read_text()) if kept.is_file() and not arguments.anew else None
        found = run(body, arguments.count, stored)
        print(f"\n{body}: {found['done']} presses, {len(found['failed'])} failed, refused: {found['refused']}\n")
        print(table(summary(found)))
        print(f"\nslowest: {found['slowest'][:1]}")
        bad += len(found["failed"])
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
