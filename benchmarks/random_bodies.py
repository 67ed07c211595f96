"""Random bodies under random objects: computed to what is asked, or refused with a cause.

``python -m benchmarks random_bodies [--count N] [--first K] [--finer]`` draws blocks (1:1 to 60:1), domes, fingers and
closed STL bodies (pads with fillets, caps, wedges, towers, brackets). It presses probes and closed STL objects on them,
with and without friction. Each case is drawn from its number alone, runs in a process of its own, and is ended after
`MOST_S`. Exit code 1 if any raises what is no `TwinError`, takes too long, leaves a number that is not finite or pieces
of force that don't add up. ``--finer`` solves each case again, to a third of the error asked for (or stated, where that
is less) and on twice the patches, and prints how far the first answer is off beside what it states: force, indentation,
tractions, and displacements under the same load (None where both have the same mesh).
"""

import contextlib
import json
import math
import multiprocessing
import resource
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial.transform import Rotation

from benchmarks.random_recipes import Table
from benchmarks.record import Count, Natural
from twin.arrays import Floats, Points
from twin.errors import TwinError
from twin.geometry.objects import object_triangles
from twin.parts.body import Body
from twin.parts.load import Load, Rectangles
from twin.study.recipe import validate_scene
from twin.study.sensor import Sensor
from twin.world.contact.contact_state import ContactState

COUNT, MOST_S, FINER_S = 60, 60, 60
"""Cases unless said; CPU seconds that one may take, and that its finer solution may take."""

LEAST = 1e-5
"""Least `accuracy.displacement` that a recipe may ask for."""

POINTS = 12
"""Points at which the field is compared."""

BODIES = ("thin", "thin", "thin", "block", "tall", "oblong", "dome", "finger",
          "pad", "pad", "cap", "wedge", "tower", "bracket")  # fmt: skip
PROBES = ("sphere", "sphere", "cylinder", "pillar", "cone", "tilted", "object", "torus", "cup", "blob", "rolled",
          "screw", "tube")  # fmt: skip
FRICTION = (0.0, 0.0, 0.3, 1.0, math.inf)

Random = np.random.Generator


def write_stl(path: Path, corners: Floats) -> str:
    """Write triangles (m, 3, 3) as a binary STL file; return its name."""
    trimesh.Trimesh(**trimesh.triangles.to_kwargs(corners), process=False).export(path)
    return str(path)


def hull(points: Floats) -> Floats:
    """Return the triangles of the convex hull of points, wound outwards."""
    return np.array(trimesh.convex.convex_hull(points).triangles)


def swept(section: Floats, count: int) -> Floats:
    """Return the triangles of a section (m, 2) of radius and height, counterclockwise, swept about z."""
    return np.array(trimesh.creation.revolve(np.vstack([section, section[:1]]), sections=count).triangles)


def blob(rng: Random) -> Floats:
    """Return a closed lumpy surface about the origin, of radius about 1."""
    count = int(rng.integers(200, 4000))
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + math.sqrt(5.0)) * k
    away = np.column_stack([np.sqrt(1.0 - z**2) * np.cos(turn), np.sqrt(1.0 - z**2) * np.sin(turn), z])
    waves = rng.normal(size=(4, 3)) * rng.uniform(1.0, 4.0)
    radius = 1.0 + rng.uniform(0.02, 0.12) * np.cos(away @ waves.T + rng.uniform(0, 6.28, 4)).sum(axis=1)
    corners: Floats = hull(away)
    own = radius[np.argmax(corners.reshape(-1, 3) @ away.T, axis=1)].reshape(-1, 3, 1)
    return np.asarray(corners * own)


def object_corners(kind: str, rng: Random) -> Floats:
    """Return the triangles of an object about the origin, a few mm to 40 mm wide."""
    size = float(10 ** rng.uniform(0.5, 1.6))
    around = np.linspace(0.0, 2.0 * np.pi, int(rng.integers(24, 120)), endpoint=False)
    count = int(rng.integers(24, 200))
    if kind == "torus":
        share = rng.uniform(0.1, 0.45)
        found = swept(np.column_stack([1.0 + share * np.cos(around), share * np.sin(around)]), count)
    elif kind == "cup":
        radii = np.linspace(0.01, 1.0, 40)
        dent = rng.uniform(0.2, 0.6) * (radii - rng.uniform(0.2, 0.6)) ** 2
        found = swept(np.vstack([np.column_stack([radii, -dent]), [[1.0, -1.5], [0.01, -1.5]]])[::-1], count)
    elif kind == "tube":
        inner = rng.uniform(0.2, 0.9)
        found = swept(np.array([[inner, -1.0], [1.0, -1.0], [1.0, 0.0], [inner, 0.0]]), count)
    elif kind == "rolled":
        length, turn = rng.uniform(0.3, 2.0), np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
        ring = np.column_stack([0.0 * turn, np.cos(turn), np.sin(turn)])
        along = np.array([length, 0.0, 0.0])
        found = hull(np.concatenate([ring - along, ring + along]))
    elif kind == "screw":
        found = object_triangles("screw", 2.0)
    else:
        found = blob(rng) @ Rotation.random(random_state=rng).as_matrix().T
    return np.asarray(found * size / 2.0)


def fillet_pad(rng: Random) -> tuple[Floats, float]:
    """Return the triangles of a pad with rounded edges, its face z = 0, and its height."""
    width, length, height = (float(v) for v in rng.uniform((12, 10, 3), (40, 30, 10)))
    fillet = float(rng.uniform(0.3, 0.9) * min(height, 0.35 * length, 4.0))
    turn = np.linspace(0.0, np.pi / 2.0, int(rng.integers(4, 14)))
    tilt, angle = (each.ravel() for each in np.meshgrid(turn, turn, indexing="ij"))
    ball = np.column_stack([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), 1.0 - np.cos(tilt)])
    points = [width / 2 - fillet, length / 2 - fillet, 0.0] + fillet * ball
    upper = points[tilt == turn[-1]] * [1, 1, 0] + [0, 0, height]
    quarter = np.vstack([points, upper])
    signs = np.array([[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]])
    return hull((quarter[None] * signs[:, None]).reshape(-1, 3)), height


def cap(rng: Random) -> tuple[Floats, float]:
    """Return the triangles of a ball's or an ellipsoid's cap on its base, its apex the origin, and its height."""
    radius = float(rng.uniform(6, 25))
    height = float(radius * rng.uniform(0.4, 0.9))
    rings = int(rng.integers(8, 30))
    points = [np.zeros((1, 3))]
    for ring in range(1, rings + 1):
        tilt = math.acos(1.0 - height / radius) * ring / rings
        angle = 2.0 * np.pi * (np.arange(6 * ring) + ring % 2 / 2) / (6 * ring)
        around = math.sin(tilt) * np.column_stack([np.cos(angle), np.sin(angle)])
        points.append(radius * np.insert(around, 2, 1.0 - math.cos(tilt), axis=1))
    return hull(np.concatenate(points) * [1.0, rng.uniform(0.7, 1.3), 1.0]), height


def bracket(rng: Random) -> tuple[Floats, float]:
    """Return the triangles of an L, pad below and leg above, and its height."""
    a, b, pad, height, depth = (float(v) for v in rng.uniform((6, 4, 3, 8, 8), (12, 8, 5, 16, 14)))
    outline = np.array([(-a, 0), (b, 0), (b, pad), (0, pad), (0, height), (-a, height)])
    flat = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    x, z, y = np.moveaxis(trimesh.creation.extrude_triangulation(outline, flat, depth).triangles, 2, 0)
    return np.stack([x, y - depth / 2, z], axis=2)[:, ::-1], height  # the swap of axes mirrors


def drawn_body(kind: str, rng: Random, folder: Path) -> tuple[Table, float, float]:
    """Return a body's table, half the width of what can be pressed, and its height, mm."""
    if kind in ("thin", "block", "tall", "oblong"):
        if kind == "thin":
            thick = float(10 ** rng.uniform(0.0, 1.0))
            width = thick * float(np.exp(rng.uniform(math.log(4), math.log(60))))
            length = width * float(rng.uniform(0.3, 1.0))
        elif kind == "block":
            thick = float(10 ** rng.uniform(0.7, 1.6))
            width, length = (thick * float(v) for v in rng.uniform(1.0, 4.0, 2))
        elif kind == "tall":
            width, length = (float(v) for v in rng.uniform(6, 16, 2))
            thick = float(rng.uniform(1.5, 4.0) * max(width, length))
        else:
            width, length, thick = (float(v) for v in rng.uniform((40, 6, 2), (100, 12, 10)))
        width, length = max(width, 5.0), max(length, 5.0)
        made = {"shape": "block", "width_mm": width, "length_mm": length, "thickness_mm": thick}
        return made, min(width, length) / 2.0, thick
    if kind == "dome":
        radius = float(rng.uniform(5, 40))
        height = float(radius * rng.uniform(0.35, 1.0))
        return {"shape": "dome", "radius_mm": radius, "height_mm": height}, 0.6 * radius, height
    if kind == "finger":
        radius, barrel, skirt = (float(v) for v in rng.uniform((4, 5, 1), (15, 25, 6)))
        made = {"shape": "finger", "radius_mm": radius, "barrel_mm": barrel, "skirt_mm": skirt}
        return made, 0.5 * radius, radius + skirt
    within, lift = {"pad": 60.0, "cap": 85.0, "wedge": 2.0}.get(kind, 5.0), 0.0
    if kind == "pad":
        corners, height = fillet_pad(rng)
    elif kind == "cap":
        corners, height = cap(rng)
    elif kind == "bracket":
        corners, height = bracket(rng)
    elif kind == "wedge":
        a, b, height, slope = (float(v) for v in rng.uniform((8, 6, 4, -12), (20, 15, 10, 12)))
        lift = math.tan(math.radians(slope))
        square = np.array([[x, y, 0.0] for x in (-a, a) for y in (-b, b)])
        corners = hull(np.vstack([square, square + np.outer(height + a * abs(lift) + lift * square[:, 0], [0, 0, 1])]))
    else:  # a tower of many sides, narrower above
        sides, height = int(rng.integers(5, 40)), float(rng.uniform(10, 40))
        angle, radius = 2.0 * np.pi * np.arange(sides) / sides, float(rng.uniform(4, 12))
        ring = radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        corners = hull(np.vstack([ring, ring * rng.uniform(0.8, 1.3) + [0, 0, height]]))
    half = float(0.5 * np.ptp(corners[..., :2][corners[..., 2] < 0.3 * height], axis=0).min())
    made = {"shape": "solid", "file": write_stl(folder / "body.stl", corners)}
    made["held"] = {"normal": [-lift, 0.0, 1.0], "within_deg": 5.0}
    made["sensing"] = {"normal": [0.0, 0.0, -1.0], "within_deg": within}
    return made, half, height


def drawn_press(kind: str, rng: Random, folder: Path, half: float, height: float, modulus: float) -> Table:
    """Return a press's table: a probe that fits on the body, where it is pressed, how deep and along which path."""
    size = float(half * rng.uniform(0.1, 0.8))
    tilt = [0.0, 0.0, 0.0]
    if kind == "sphere":
        probe: Table = {"kind": "sphere", "diameter_mm": 2.0 * size}
    elif kind == "cylinder":
        edge = float(rng.choice([0.0, 0.1 * size]))
        probe = {"kind": "cylinder", "diameter_mm": size, "edge_mm": edge}
    elif kind in ("pillar", "tilted"):
        probe = {"kind": "pillar", "width_mm": size, "length_mm": size * float(rng.uniform(0.4, 1.2))}
        if kind == "tilted":
            tilt = [float(v) for v in rng.uniform(-30, 30, 3)]
    elif kind == "cone":
        probe = {"kind": "cone", "apex_deg": float(rng.uniform(90, 165)), "diameter_mm": 2.0 * size}
    elif kind == "object":
        shape = str(rng.choice(["letter", "gear", "brick", "grating", "ring", "screw"]))
        probe = {"kind": "object", "shape": shape, "width_mm": 1.5 * size}
    else:
        probe = {"kind": "stl", "file": write_stl(folder / "probe.stl", object_corners(kind, rng))}
    at = [float(v) for v in rng.uniform(-1, 1, 2) * max(0.0, 0.7 * half - 0.6 * size) * 0.7]
    depth = float(rng.uniform(0.01, 0.12) * min(size, height))
    friction = float(rng.choice(FRICTION))
    steps: list[Table] = [{"move_mm": {"z": depth}}]
    if rng.random() < 0.3:
        steps = [{"force_n": {"z": modulus * size * depth}}]
    if friction and rng.random() < 0.5:
        steps.append(
            {"move_mm": {"x": float(rng.normal(0, 0.3 * depth)), "y": 0.0}, "turn_deg": float(rng.normal(0, 1))}
        )
    made = {"probe": probe, "at_mm": at, "tilt_deg": tilt, "friction": friction, "steps": steps}
    return made | ({"direction": "normal", "axes": "probe"} if rng.random() < 0.3 else {})


def drawn(number: int, folder: Path) -> tuple[str, Table]:
    """Return what a case is and its recipe."""
    rng = np.random.default_rng([2026, number])
    body, probe = BODIES[number % len(BODIES)], PROBES[number % len(PROBES)]
    modulus, nu = float(10 ** rng.uniform(-1, 0.5)), float(rng.choice([0.3, 0.4, 0.49, 0.5]))
    made, half, height = drawn_body(body, rng, folder)
    press = drawn_press(probe, rng, folder, half, height, modulus)
    accuracy = {"displacement": float(rng.choice([1e-2, 2e-2])), "contact_patches": 12}
    material = {"youngs_modulus_mpa": modulus, "poisson_ratio": nu}
    recipe = {"seed": 1, "body": made, "material": material, "press": press, "accuracy": accuracy}
    return f"{probe} on {body}", recipe | {"tolerance": {"preset": "none"}}


def points_under(body: Body, state: ContactState) -> Points:
    """Return points within two radii of a contact, from 0.1 mm deep."""
    rng = np.random.default_rng(1)
    middle = np.mean([term.centre_mm.mean(axis=0) for term in state.load.terms if isinstance(term, Rectangles)], axis=0)
    reach = 2.0 * state.contact_radius_mm
    chart = body.chart_of(middle[None]) + rng.uniform(-reach, reach, (40 * POINTS, 2))
    points = body.chart_points(chart, rng.uniform(0.1, 1.0 + reach, len(chart)))
    depth = body.piece_distances(points)
    return points[(depth > 0.0999).all(axis=1) & body.contains(points, -0.0999)][:POINTS]


def traction_change(one: Load, other: Load) -> float:
    """Return the RMS difference of two loads' tractions over their RMS, on the patches of the first."""
    (a, *_), (b, *_) = ([term for term in load.terms if isinstance(term, Rectangles)] for load in (one, other))
    here, there = (term.force_n / term.half_mm.prod(axis=1)[:, None] for term in (a, b))
    middle = b.centre_mm.mean(axis=0)
    plane = np.linalg.svd(b.centre_mm - middle, full_matrices=False)[2][:2].T
    known = LinearNDInterpolator((b.centre_mm - middle) @ plane, there)((a.centre_mm - middle) @ plane)
    inside = np.isfinite(known).all(axis=1)
    weight = a.half_mm.prod(axis=1)[inside, None]
    return float(np.sqrt((weight * (here - known)[inside] ** 2).sum() / (weight * here[inside] ** 2).sum()))


def solved(recipe: Table, known: tuple[Load, Points] | None = None) -> tuple[dict[str, Any], Load, Points]:
    """Press, and return what the press says of itself, its load, and points under it.

    The field at these points, or that of a known load at known ones, is in what is said.
    """
    said: dict[str, Any] = {}
    began = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sensor = Sensor(validate_scene(recipe, "drawn"))
        state = sensor.press()
        said["press_s"] = time.process_time() - began
        body = sensor.actual.scene.body
        error = state.error
        assert error is not None
        said["error_s"] = time.process_time() - began
        patches = [term for term in state.load.terms if isinstance(term, Rectangles)]
        load, points = known or (state.load, points_under(body, state))
        found = sensor.ladder.displacement(points, sensor.rectangles(load.moving))
    said |= {
        "cpu_s": time.process_time() - began,
        "force_n": state.force_n.tolist(), "indentation_mm": state.indentation_mm, "complete": state.complete,
        "reason": state.reason, "points": points.tolist(), "moved_mm": found.displacement_mm.tolist(),
        "stated": [error.force, error.indentation, error.traction, found.error],
        "of_body": [error.body.force, error.body.indentation, error.body.traction],
        "of_patches": [error.patches.force, error.patches.indentation, error.patches.traction],
        "warned": sorted({f"{w.category.__name__}: {w.message}" for w in caught}),
    }  # fmt: skip
    pieces = np.sum([term.force_n.sum(axis=0) for term in patches], axis=0)
    if not np.allclose(pieces, state.force_n, atol=1e-6 * np.linalg.norm(state.force_n)):
        raise AssertionError(f"pieces {pieces} N do not add up to {state.force_n} N")
    numbers = [*said["force_n"], said["indentation_mm"], *np.ravel(said["moved_mm"])]
    numbers += said["stated"] if state.complete else []  # of a path that stopped, nothing is stated
    if not np.isfinite(numbers).all():
        raise AssertionError(f"not finite: {numbers}")
    return said, state.load, points


def finer_recipe(recipe: Table, stated: float) -> Table:
    """Return a recipe with twice the patches and a third of the error, of that stated where it is less than asked.

    A third of what is asked alone would leave many a body its mesh, and each answer would be compared with itself.
    """
    displacement, patches = recipe["accuracy"].values()
    finer = max(LEAST, min(displacement, stated) / 3.0)
    return {**recipe, "accuracy": {"displacement": finer, "contact_patches": 2 * patches}}


def compared(one: dict[str, Any], load: Load, points: Points, finer: Table) -> dict[str, Any]:
    """Solve a case on a finer recipe; return how far its answer was off."""
    other, finer_load, _ = solved(finer, (load, points))
    u, v = np.array(one["moved_mm"]), np.array(other["moved_mm"])
    force = np.array(other["force_n"])
    off = [
        float(np.linalg.norm(np.subtract(one["force_n"], force)) / np.linalg.norm(force)),
        abs(one["indentation_mm"] / other["indentation_mm"] - 1.0),
        traction_change(finer_load, load),
        float(np.abs(u - v).max() / np.abs(v).max()) if np.any(u != v) else None,
    ]
    return {"off": off, "finer_stated": other["stated"], "finer_cpu_s": other["cpu_s"]}


def _child(number: int, finer: bool, send: Callable[[Table], None]) -> None:
    """Send what becomes of a case: where it is to be solved ``finer``, before that and with how far it was off."""
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_S, resource.RLIM_INFINITY))
    with tempfile.TemporaryDirectory() as folder:
        said: Table = {"number": number}
        try:
            said["what"], recipe = drawn(number, Path(folder))
            said |= {"body": recipe["body"], "press": recipe["press"], "material": recipe["material"]}
            one, load, points = solved(recipe)
            said |= {"result": "computed" if one["complete"] else "stopped"} | one | {"asked": recipe["accuracy"]}
            if finer and one["complete"]:
                send(said)
                resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time()) + FINER_S,) * 2)
                said |= compared(one, load, points, finer_recipe(recipe, one["stated"][3]))
        except TwinError as refused:
            said |= {"result": "refused", "why": f"{type(refused).__name__}: {refused}"}
        except Exception as problem:
            said |= {"result": "failed", "why": f"{type(problem).__name__}: {problem}"}
            said["trace"] = traceback.format_exc()
        send(said)


def judged(number: int, finer: bool) -> Table:
    """Return what became of a case that runs in a process of its own, and is ended where it takes too long."""
    ours, theirs = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=_child, args=(number, finer, theirs.send))
    began = time.monotonic()
    process.start()
    theirs.close()
    said: Table = {"number": number, "result": "failed", "why": f"died, or took over {MOST_S} CPU s"}
    with contextlib.suppress(EOFError):
        while True:
            said = ours.recv()
    process.join()
    return said | {"wall_s": time.monotonic() - began}


def measure(*, count: Count = COUNT, first: Natural = 0, finer: bool = False, out: Path | None = None) -> int:
    """Try cases, print what became of each; exit code 1 if any failed.

    Parameters
    ----------
    count, first
        How many, and the number of the first.
    finer
        Solve each again, finer, and compare.
    out
        File that what is found is added to, a line a case.
    """
    became: Counter[str] = Counter()
    shown = ("number", "what", "result", "why", "reason", "wall_s", "stated", "off")
    for number in range(first, first + count):
        said = judged(number, finer)
        became[said["result"]] += 1
        print({key: said[key] for key in shown if said.get(key)}, flush=True)
        if out:
            with out.open("a") as file:
                file.write(json.dumps(said) + "\n")
    print(dict(became))
    return int(became["failed"] > 0)
