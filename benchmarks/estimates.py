"""How good estimates of the error are away from the reference: ``python -m benchmarks estimates``, six minutes.

Disks on the block, against the truth's table, and on the finger bumps, disks and rectangles, against its finest mesh
with finer quadrature under the load: at given places, axis by axis, and of random width, place and direction. Loads are
cut as the program cuts them. The finger's finest mesh is itself up to 6e-4 off.

The shares in `twin.world.elasticity.error_law` were chosen with the given loads in view, and on the finger with 60
other random ones; the random loads here set nothing.

``python -m benchmarks estimates --friction`` measures spheres with friction at finite strain against NGSolve and
against a finer mesh, in a quarter of an hour.
"""

import json
import math
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import ROOT
from benchmarks.clock import empty_cache
from benchmarks.elasticity import compliance
from benchmarks.record import Row, table
from benchmarks.reference import BODIES, reference
from twin.arrays import Points
from twin.errors import InputError
from twin.parts.load import Rectangles, Traction
from twin.parts.press import Press, Sphere, Step
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.world.contact import body_strain
from twin.world.contact.contact_state import ContactState
from twin.world.elasticity import correction
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.mesh.sizing import Level

LEVELS: tuple[Level, ...] = ("nominal", "sketch", "coarse", "standard")
DISKS_MM, BUMPS_MM = (1.5, 4.0, 8.0, 12.0), (2.0, 3.0, 4.0)
ON_BLOCK_MM = ((0.0, 0.0), (6.0, -4.0), (-9.0, 3.0), (2.0, 5.5))
ON_FINGER_MM = ((0.0, 0.0), (-3.0, 0.0), (-3.0, 3.0), (2.0, 2.0), (3.5, 0.0))
BOX_MM = (16.0, 12.0)
"""Half sides of where the block's table answers."""


RANDOM, SEED = {"block": 36, "finger": 60}, {"block": 7, "finger": 2026}
ON_FINGER, EDGE_MM = ("bump", "disk", "rectangle"), 6.5
"""Kinds of random loads, in turn, and how far from the origin they reach; Poisson's ratio alternates between `BOTH`."""
BOTH = (0.5, 0.3)


@dataclass(frozen=True, kw_only=True)
class Pushed:
    """A load: its kind, width, place and force, and Poisson's ratio of the body."""

    kind: str
    width_mm: float
    at_mm: tuple[float, float]
    force_n: list[float]
    nu: float = 0.5

    def on(self, body: str) -> Rectangles:
        """Return the load on a body, cut as the program does."""
        size = (self.width_mm, self.width_mm) if self.kind == "rectangle" else self.width_mm / 2
        return tile(getattr(Traction, self.kind)(self.at_mm, size, self.force_n), BODIES[body])


def _given(body: str) -> Iterator[Pushed]:
    """Yield loads axis by axis."""
    block = body == "block"
    for width, at in product(DISKS_MM, ON_BLOCK_MM) if block else product(BUMPS_MM, ON_FINGER_MM):
        for force in np.eye(3).tolist():
            yield Pushed(kind="disk" if block else "bump", width_mm=width, at_mm=at, force_n=force)


def _random(body: str) -> Iterator[Pushed]:
    """Yield loads of 1 N, all at random."""
    rng, found = np.random.default_rng(SEED[body]), 0
    while found < RANDOM[body]:
        force = rng.normal(size=3)
        force /= np.linalg.norm(force)
        kind, nu = "disk", 0.5
        if body == "block":
            width = float(np.exp(rng.uniform(np.log(DISKS_MM[0]), np.log(DISKS_MM[-1]))))
            at = float(rng.uniform(-10, 10)), float(rng.uniform(-8, 8))
        else:
            kind, nu = ON_FINGER[found % 3], BOTH[found % 2]
            width = float(rng.uniform(1.2, 6))
            at = float(rng.uniform(-EDGE_MM, EDGE_MM)), float(rng.uniform(-EDGE_MM, EDGE_MM))
            if at[0] > 0 and np.hypot(*at) > EDGE_MM:
                continue
        pushed = Pushed(kind=kind, width_mm=width, at_mm=at, force_n=force.tolist(), nu=nu)
        try:
            pushed.on(body)
        except InputError:  # partly off the sensing surface
            continue
        found += 1
        yield pushed


LOADS = {"given": _given, "random": _random}


def cases(body: str, loads: str = "given") -> Iterator[tuple[float, Points, Rectangles]]:
    """Yield Poisson's ratio, points (n, 3) mm and a load, for all ``given`` or ``random`` loads on a body."""
    points = reference(body).points
    for pushed in LOADS[loads](body):
        if body == "finger":
            yield pushed.nu, points, pushed.on(body)
            continue
        near = points + np.array([*pushed.at_mm, 0.0])
        near = near[(np.abs(near[:, :2]) < BOX_MM).all(axis=1)]
        yield pushed.nu, near, pushed.on(body)


FINER_LOADS = {"FINEST": correction.FINEST / 2.0, "CELLS": correction.CELLS * 2.0}
"""Half the pieces of face under a load, and half the cells that it is merged into far from it."""


def ratios(body: str) -> dict[tuple[str, Level], list[float]]:
    """Return the estimated errors over the errors, by kind of loads and by level."""

    @cache
    def stiff(nu: float, level: Level, table: bool = False) -> Compliance:
        return compliance(body, nu, "subtracted", level, table)

    found: dict[tuple[str, Level], list[float]] = {key: [] for key in product(LOADS, LEVELS)}
    for loads in LOADS:
        for nu, points, load in cases(body, loads):
            with patch.multiple(correction, **FINER_LOADS), empty_cache():
                right = stiff(nu, "fine", body == "block").displacement(points, load)
            for level in LEVELS:
                got, told = stiff(nu, level).answer(points, load)
                error = np.linalg.norm(got - right, axis=1).max() / np.linalg.norm(right, axis=1).max()
                found[loads, level].append(told / float(error))
    return found


def _row(body: str, loads: str, level: str, found: list[float]) -> Row:
    ratio = np.array(found)
    sizes = {"number": len(ratio), "least": ratio.min(), "median": np.median(ratio), "most": ratio.max()}
    shares = {"below 1": np.mean(ratio < 1.0), "above 3": np.mean(ratio > 3.0)}
    return {"body": body, "loads": loads, "level": level, **sizes, **shares}


@dataclass(frozen=True, kw_only=True)
class Rubbed:
    """A sphere that is pressed on a bare body with a force, N, for E = 1 MPa, and then taken on."""

    scene: str = "block_bare"
    diameter_mm: float = 6.0
    friction: float
    push_n: float
    then: dict[str, Any]


RUBBED = (
    Rubbed(friction=0.5, push_n=1.5, then={"force_n": {"x": 0.6}}),
    Rubbed(friction=0.5, push_n=1.5, then={"move_mm": {"x": 0.6}}),
    Rubbed(scene="finger_bare", diameter_mm=3.0, friction=0.5, push_n=0.5, then={"force_n": {"x": 0.2}}),
    Rubbed(scene="finger_bare", diameter_mm=3.0, friction=math.inf, push_n=0.5, then={"force_n": {"x": 0.2}}),
    Rubbed(friction=math.inf, push_n=1.5, then={"force_n": {"x": 1.5}}),
    Rubbed(friction=math.inf, push_n=1.5, then={"turn_deg": {"z": 20.0}}),
    Rubbed(scene="finger_bare", diameter_mm=3.0, friction=math.inf, push_n=0.1, then={"turn_deg": {"z": 20.0}}),
)

LAWS = "linear", "neo_hookean"
FINER = body_strain._Fineness(0.47, 0.65, 0.3, (4, 2))
"""The mesh that spheres with friction are compared with."""


def _sensors(scene: str) -> tuple[Sensor, ...]:
    overrides = {"material.youngs_modulus_mpa": 1.0, "tolerance.preset": "none"}
    return tuple(Sensor(load_scene(scene, {**overrides, "material.law": law})) for law in LAWS)


def _left(state: ContactState, places: Points, true: Points, size: float) -> Row:
    """Return how far linear theory and the program are off what large strain adds at places, over the largest
    displacement, and what is stated where those are watched."""
    more = state.load.strained
    assert isinstance(more, body_strain.BodyStrain)
    off, left = (float(np.linalg.norm(each, axis=1).max()) / size for each in (true, more.displacement(places) - true))
    there = copy(more)
    there._watched = places
    for name in ("error", "linear_error", "_largest_mm"):
        vars(there).pop(name, None)
    stated = there.error.markers
    stuck = (1.0 - state.slip_share) * body_strain._STUCK_OVER_CUBE * there.linear_error**3
    row: Row = {"linear_off": off, "left": left, "stated": stated, "ratio": stated / left}
    return row | {"without_cube": stated - stuck}


def _held(state: ContactState, linear: float, got: float, true: float) -> Row:
    """Return the same of a force or torque that a motion holds."""
    assert state.error is not None
    off, left, stated = abs(linear / true - 1.0), abs(got / true - 1.0), state.error.strain.force
    return {"held_linear_off": off, "held_left": left, "held_stated": stated, "held_ratio": stated / left}


def _rubbed(case: Rubbed) -> Iterator[Row]:
    """Yield what a sphere with friction leaves out of either step, at places 1 to 3 mm deep, against a finer mesh."""
    sensors = _sensors(case.scene)
    first, then = {"z": case.push_n}, dict(case.then)
    then["force_n"] = first | then.get("force_n", {})
    steps = (Step(force_n=first), Step(**then))
    press_ = Press(probe=Sphere(diameter_mm=case.diameter_mm), friction=case.friction, steps=steps)
    body = sensors[0].nominal.body
    across = case.diameter_mm / 6.0 * np.array([0.0, 0.75, 1.5, 2.5, 4.0])
    flat = np.array([(s * x, y) for s in (-1, 1) for x in across for y in across])
    top = body.surface_from_above(flat)
    inward = body.piece_normals(top)[:, 0]
    places = np.concatenate([top + deep * inward for deep in (1.0, 1.5, 3.0)])
    straight = sensors[0].press(press_).path
    path = sensors[1].press(press_).path
    with patch.object(body_strain, "_FINE", FINER):
        truth = sensors[1].press(press_).path
    for number, (linear, state, finer) in enumerate(zip(straight, path, truth, strict=True)):
        size = np.linalg.norm(sensors[0].displacement(places, linear), axis=1).max()
        true = finer.load.strained.displacement(places)
        row = {"scene": case.scene, "diameter_mm": case.diameter_mm, "friction": case.friction}
        row["path"] = f"pressed, {case.push_n:g} N" if number == 0 else f"then {case.then}"
        row |= {"slipping": float(np.mean(linear.slip)), **_left(state, places, true, size)}
        if number and "move_mm" in case.then:
            row |= _held(state, *(float(one.force_n[0]) for one in (linear, state, finer)))
        if number and "turn_deg" in case.then:
            row |= _held(state, *(one.torque_nmm for one in (linear, state, finer)))
        yield row


def _stored(name: str) -> tuple[dict[str, Any], Points]:
    found = json.loads((ROOT / "tests" / "reference" / f"{name}.json").read_text())
    places = np.array(found["places_mm"])
    return found, np.insert(places, 1, 0.0, axis=1) if places.shape[1] == 2 else places


def stuck() -> Iterator[Row]:
    """Yield the same of a sphere that sticks and is pulled aside, against NGSolve, then moved to where the force took
    it, against that force."""
    truth, places = _stored("stuck_neohooke")
    (_, first), (side, push) = (step["force_n"] for step in truth["steps"])
    sensors = _sensors("block_bare")

    def paths(then: Step) -> list[tuple[ContactState, ...]]:
        steps = (Step(force_n=(0.0, 0.0, first)), then)
        press_ = Press(probe=Sphere(diameter_mm=truth["diameter_mm"]), friction=math.inf, steps=steps)
        return [sensor.press(press_).path for sensor in sensors]

    _, path = paths(Step(force_n=(side, 0.0, push)))
    for state, step in zip(path, truth["steps"], strict=True):
        before, after = np.array(step["linear_mm"]), np.array(step["strained_mm"])
        row: Row = {"force_n": step["force_n"]}
        yield row | _left(state, places, after - before, float(np.linalg.norm(before, axis=1).max()))
    there = Step(force_n=(None, None, push), move_mm=(float(path[1].move_mm[0]), 0.0, None))
    linear, moved = (one[1] for one in paths(there))
    yield {"force_n": "by a motion"} | _held(moved, float(linear.force_n[0]), float(moved.force_n[0]), side)


def turned() -> Iterator[Row]:
    """Yield the same of a sphere that is pressed, turned and slips, against NGSolve: of the whole displacement."""
    truth, places = _stored("twisted_neohooke")
    steps = tuple(Step(force_n=(None, None, 1.5), turn_deg=turn) for turn in np.diff([0.0, *truth["turns_deg"]]))
    press_ = Press(probe=Sphere(diameter_mm=truth["diameter_mm"]), friction=truth["friction"], steps=steps)
    sensors = _sensors("block_bare")
    straight, path = (sensor.press(press_).path for sensor in sensors)
    for number, (linear, state, step) in enumerate(zip(straight, path, truth["strained"], strict=True)):
        moved = np.array(step["moved_mm"]) - sensors[0].displacement(places, linear)
        size = float(np.linalg.norm(step["moved_mm"], axis=1).max())
        row: Row = {"turn_deg": truth["turns_deg"][number], "slipping": float(np.mean(linear.slip))}
        row |= _left(state, places, moved, size)
        if number:
            row |= _held(state, linear.torque_nmm, state.torque_nmm, step["torque_nmm"])
        yield row


def measure(*, friction: bool = False) -> None:
    """Print the table; with ``friction`` that of spheres with friction at finite strain."""
    if friction:
        for rows in (stuck(), turned(), *(_rubbed(case) for case in RUBBED)):
            print(table(list(rows)), flush=True)
        return
    rows: list[Row] = []
    for name in BODIES:
        rows += [_row(name, loads, level, found) for (loads, level), found in ratios(name).items()]
    print(table(rows))
