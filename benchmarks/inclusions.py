"""What hard beads change: ``python -m benchmarks.inclusions`` stores the rows and writes the tables of the page.

Two answers to one question. An independent finite-element program (NGSolve, of the ``peers`` extra) resolves the beads
next to the load, as rigid bodies, in the whole block; closed forms (`twin.theory.inclusions`) take the same beads, and
then all 636 of them, which no mesh of reasonable size could resolve. With beads and without them the mesh is the
same, so that the mesh's own error cancels in the change, and unknowns of a bead are tied to its six motions, so that a
bead is exactly rigid. The load is even over the disc below the 5 mm pillar; two mirror planes leave a quarter.
Further rows say where the option of stiff markers (`twin.world.elasticity.stiff`) ends, and what it costs.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import ROOT
from benchmarks.__main__ import RESULTS, machine, table
from benchmarks.inclusions_mesh import bead_solutions
from twin.arrays import Floats, Points
from twin.parts.load import Rectangles, Traction
from twin.sense.reconstruct import reconstruct
from twin.sense.track import Found
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.theory.inclusions import BeadMotion, bead_motion, dipole_displacement, stresslet
from twin.world.elasticity.compliance import Compliance

PAGE = ROOT / "docs" / "inclusions.md"
STORED = RESULTS / "inclusions.json"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"

RADIUS_MM = 0.25
PILLAR_MM = 2.5
PUSH_N = 3.0
NOISE_PX = 0.03
"""Of the shifts that the reconstruction is given, the same draw with beads and without."""

RESOLVED = ((1.0, 2, 2.0), (1.0, 3, 2.0), (2.3, 2, 2.0), (2.3, 2, 3.0))
"""Reach of the resolved beads along x and y (mm), order of displacement, elements over a bead's curvature radius."""

CUTS = 3
"""Odd, so that one place of the spread layers is the bead's own."""

SOFTER = (0.5, 0.4975, 0.49, 0.47)
"""Poisson's ratios of the rubber around 4 resolved beads: the closed forms hold at 1/2."""

FACES_MM = (3.0, 6.0, 10.0, 20.0, 40.0)
"""Distances of a free face whose reflection of the push-back is left out."""

PITCHES_MM = (1.5, 1.25, 1.0)
STIFF = {"markers.red.stiff": True, "markers.blue.stiff": True}
SCENE = {"tolerance.preset": "none", "material.poisson_ratio": 0.5}
DIRECTIONS = {"along z": (0, 0, 1), "along x": (1, 0, 0)}


def run(quick: bool) -> list[dict[str, Any]]:
    """Return the rows: resolved beads against closed forms, then all beads; the quick form resolves 4 beads."""
    sensor = Sensor(load_scene("kamiyama_pillar", overrides=SCENE))
    rows = [_resolved_row(sensor, *case) for case in (RESOLVED[:1] if quick else RESOLVED)]
    for direction, force in DIRECTIONS.items():
        rows.append(_all_beads_row(sensor, direction, force))
    if quick:
        return rows
    rows += [_softer_row(poisson_ratio) for poisson_ratio in SOFTER]
    return rows + _face_rows(sensor) + [_pitch_row(pitch) for pitch in PITCHES_MM] + [_option_row()]


def page_tables() -> str:
    """Return the Markdown between the page's two result marks."""
    stored = json.loads(STORED.read_text())
    where = f"On {stored['machine']['processor']}, {stored['machine']['cores']} cores.\n"
    return "\n".join(["", *_tables(stored["rows"]), where])


def _tables(rows: list[dict[str, Any]]) -> list[str]:
    """Return a titled Markdown table for every kind of row."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        kinds.setdefault(row["what"], []).append({k: v for k, v in row.items() if k != "what"})
    return [f"**{what}**\n\n{table(same)}\n" for what, same in kinds.items()]


def _resolved_row(sensor: Sensor, reach_mm: float, order: int, fineness: float) -> dict[str, Any]:
    start = time.process_time()
    solved = bead_solutions(_centres(sensor), RADIUS_MM, PILLAR_MM, reach_mm, order, fineness)
    seconds = time.process_time() - start
    whole, found = _mirrored(solved.centres)
    motion = _closed(sensor, whole, (0, 0, 1), rounds=2)
    modulus = sensor.actual.scene.material.youngs_modulus_mpa
    largest = _largest(motion.passive)
    change, closed = (solved.beads - solved.passive) / modulus, motion.change[found]
    return {
        "what": "Resolved beads next to the pillar, change of their motion in % of the largest displacement",
        "beads": len(whole),
        "order": order,
        "elements": solved.elements,
        "unknowns": solved.unknowns,
        "passive points off, %": 100 * _largest(solved.passive / modulus - motion.passive[found]) / largest,
        "finite elements, %": 100 * _largest(change) / largest,
        "closed form, %": 100 * _largest(closed) / largest,
        "largest difference, %": 100 * _largest(change - closed) / largest,
        "cpu_s": seconds,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def _all_beads_row(sensor: Sensor, direction: str, force: tuple[float, float, float]) -> dict[str, Any]:
    start = time.process_time()
    centres = _centres(sensor)
    first, second = (_closed(sensor, centres, force, rounds) for rounds in (1, 2))
    seconds = time.process_time() - start
    largest, moved = _largest(first.passive), first.passive
    layers = {name: sensor.nominal_markers.of(name) for name in ("red", "blue")}
    with_beads, without = (_reconstructed(sensor, moved + c) for c in (second.change, 0 * moved))
    axis = int(np.argmax(np.abs(force)))
    sideways = float(np.vdot(second.change[:, :2], moved[:, :2]) / np.vdot(moved[:, :2], moved[:, :2]))
    return {
        "what": "All beads, closed form, in % of the largest displacement; force in % of itself",
        "push": direction,
        "beads": len(centres),
        "alone, %": 100 * _largest(first.alone) / largest,
        "together, first order, %": 100 * _largest(first.change) / largest,
        "together, second order, %": 100 * _largest(second.change) / largest,
        "even layers of 1 + 5/2 phi, %": 100 * _largest(first.alone + _even_layers(sensor, force)) / largest,
        **{f"{name}, %": 100 * _largest(second.change[which]) / largest for name, which in layers.items()},
        "sideways motion, %": 100 * sideways,
        "total force, %": 100 * float(with_beads[:, axis].sum() / without[:, axis].sum() - 1),
        "force field, %": 100 * float(np.linalg.norm(with_beads - without) / np.linalg.norm(without)),
        "cpu_s": seconds,
    }


def _softer_row(poisson_ratio: float) -> dict[str, Any]:
    """Compare the option with resolved beads in rubber that gives way to pressure."""
    sensor = Sensor(load_scene("kamiyama_pillar", overrides={**SCENE, "material.poisson_ratio": poisson_ratio}))
    reach_mm, order, fineness = RESOLVED[1]
    solved = bead_solutions(_centres(sensor), RADIUS_MM, PILLAR_MM, reach_mm, order, fineness, poisson_ratio)
    whole, found = _mirrored(solved.centres)
    motion = _closed(sensor, whole, (0, 0, 1), rounds=1)
    change, largest = solved.beads - solved.passive, _largest(motion.passive)
    closed = motion.change[found]
    return {
        "what": "The closed form below Poisson's ratio 1/2: 4 resolved beads, in % of the largest displacement",
        "Poisson's ratio": poisson_ratio,
        "finite elements, %": 100 * _largest(change) / largest,
        "closed form, %": 100 * _largest(closed) / largest,
        "largest difference, %": 100 * _largest(change - closed) / largest,
    }


def _face_rows(sensor: Sensor) -> list[dict[str, Any]]:
    """Return what a free face reflects of the push-back when it is further away than the sensing surface."""
    centres, load = _centres(sensor), _load(sensor, (0, 0, 1))
    slopes = sensor.compliance.gradient(centres, load)
    dipoles = stresslet(0.5 * (slopes + slopes.swapaxes(1, 2)), RADIUS_MM, 1.0)
    largest = _largest(sensor.compliance.displacement(centres, load))
    own, least = np.arange(len(centres)), centres[:, 2].min()

    def together(distance_mm: float) -> Points:
        moved = centres + np.array([0.0, 0.0, distance_mm - least])
        return dipole_displacement(moved, moved, dipoles, 1.0, own)

    alone = together(1e4)
    return [
        {
            "what": "What a free face reflects of the push-back of all beads, in % of the largest displacement",
            "distance from the nearest beads, mm": distance,
            "over their depth": distance / least,
            "reflected, %": 100 * _largest(together(distance) - alone) / largest,
        }
        for distance in FACES_MM
    ]


def _pitch_row(pitch_mm: float) -> dict[str, Any]:
    overrides = {**SCENE, "markers.red.pitch_mm": pitch_mm, "markers.blue.pitch_mm": pitch_mm}
    sensor = Sensor(load_scene("kamiyama_pillar", overrides=overrides))
    first, second = (_closed(sensor, _centres(sensor), (0, 0, 1), rounds) for rounds in (1, 2))
    largest = _largest(first.passive)
    return {
        "what": "Denser beads, push along z, in % of the largest displacement",
        "pitch, mm": pitch_mm,
        "pitch over radius": pitch_mm / RADIUS_MM,
        "first order, %": 100 * _largest(first.change) / largest,
        "second order, %": 100 * _largest(second.change) / largest,
        "largest difference, %": 100 * _largest(first.change - second.change) / largest,
    }


def _option_row() -> dict[str, Any]:
    """Time the scene's markers under the pillar, passive and stiff, on a first and on a further press."""
    seconds: dict[str, list[float]] = {}
    for name, more in (("passive", {}), ("stiff", STIFF)):
        sensor = Sensor(load_scene("kamiyama_pillar", overrides={**SCENE, **more}))
        load = sensor.press().load
        sensor.displacement(_centres(sensor)[:1], load)
        seconds[name] = []
        for _ in range(4):
            start = time.process_time()
            sensor.motion(load)
            seconds[name].append(time.process_time() - start)
    return {
        "what": "The option's price: motion of 636 markers under a press of the pillar, processor seconds",
        **{f"{name}, first": times[0] for name, times in seconds.items()},
        **{f"{name}, next": min(times[1:]) for name, times in seconds.items()},
    }


def _mirrored(quarter: Points) -> tuple[Points, list[int]]:
    """Return the (n, 3) beads of all four quarters, and where those of one stand among them."""
    whole = np.unique(np.concatenate([quarter * [a, b, 1] for a in (1, -1) for b in (1, -1)]).round(9), axis=0)
    return whole, [int(np.abs(whole - centre).sum(axis=1).argmin()) for centre in quarter]


def _centres(sensor: Sensor) -> Points:
    """Return the (n, 3) places of the beads as designed."""
    return sensor.nominal_markers.points


def _closed(sensor: Sensor, centres: Points, force: tuple[float, float, float], rounds: int) -> BeadMotion:
    load = _load(sensor, force)
    body: Compliance = sensor.compliance
    shear = sensor.actual.scene.material.youngs_modulus_mpa / 3
    return bead_motion(
        lambda p: body.displacement(p, load), lambda p: body.gradient(p, load), centres, RADIUS_MM, shear, rounds
    )


def _even_layers(sensor: Sensor, force: tuple[float, float, float]) -> Points:
    """Return (n, 3) what the beads' push-back does when it is spread evenly over their layers, CUTS^2 places a bead."""
    scene, compliance, load = sensor.actual.scene, sensor.compliance, _load(sensor, force)
    centres = _centres(sensor)
    pitch = min(layer.pitch_mm for layer in scene.markers.values())
    steps = (np.arange(CUTS) - (CUTS - 1) / 2) * pitch / CUTS
    offsets = np.array([(a, b, 0.0) for a in steps for b in steps])
    places = (centres[:, None] + offsets).reshape(-1, 3)
    slopes = compliance.gradient(places, load)
    shear = scene.material.youngs_modulus_mpa / 3
    dipoles = stresslet(0.5 * (slopes + slopes.swapaxes(1, 2)), RADIUS_MM, shear) / CUTS**2
    own = np.arange(len(centres)) * CUTS**2 + CUTS**2 // 2
    return dipole_displacement(centres, places, dipoles, shear, own)


def _load(sensor: Sensor, force: tuple[float, float, float]) -> Rectangles:
    return sensor.rectangles(Traction.disk(centre_mm=(0, 0), radius_mm=PILLAR_MM, force_n=force))


def _reconstructed(sensor: Sensor, moved: Points) -> Floats:
    """Return the (k, 3) forces that the sensor's software finds, N, from marker motion (n, 3) in mm for 1 N."""
    rest = sensor.nominal_markers.points
    at_rest = sensor.project(rest)
    noise = np.random.default_rng(0).normal(0.0, NOISE_PX, at_rest.shape)
    found = Found(
        rest_px=at_rest, shift_px=sensor.project(rest + PUSH_N * moved) - at_rest + noise,
        sd_px=np.full(len(rest), NOISE_PX), layer=sensor.nominal_markers.layer, channels={}, method="given",
    )  # fmt: skip
    return reconstruct(found, calibration_of(sensor)).force_n


def _largest(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def main() -> int:
    """Run, print, store and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.inclusions", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="4 beads on a coarse mesh, written nowhere")
    quick = parser.parse_args().quick
    rows = run(quick)
    print("\n".join(_tables(rows)))
    if not quick:
        STORED.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")
        write_page(PAGE)
    return 0


def write_page(page: Path) -> None:
    """Put the stored rows between the page's marks."""
    text = page.read_text()
    page.write_text(re.sub(MARKS, lambda m: m.group(1) + page_tables() + m.group(2), text, flags=re.DOTALL))


if __name__ == "__main__":
    sys.exit(main())
