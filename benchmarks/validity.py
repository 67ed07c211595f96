"""What linearity costs: neo-Hookean rubber under the papers' presses against linear theory on the same elements.

``python -m benchmarks validity [PART ...]`` presses every probe at an eighth, a quarter, half and all of its load and
stores the rows. Both carry the same total force, so their difference holds everything that linear theory leaves out:
large strain, the turning of the surface, and the contact that is found on the undeformed surface. Needs felupe, of the
extra ``peers``.

The program's meshes carry the smooth rest that is left when the half-space is subtracted, so they are coarse where a
load presses; plain elements need them fine there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.neohooke import Contact, Rubber, press
from benchmarks.record import store, stored, table
from twin.arrays import Floats, Points
from twin.parts.press import Cylinder, Probe, Sphere
from twin.study.recipe import load_scene
from twin.study.sensor import Sensor
from twin.world.contact.probe_gap import Approach
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator
from twin.world.mesh.quadratic_mesh import Mesh

GRAM = 0.00980665
"""Newton per gram-force."""

LEVELS = (0.125, 0.25, 0.5, 1.0)
DEEP_MM = 0.3

X, Z = 0, 2


@dataclass(frozen=True, kw_only=True)
class Case:
    """One press: a scene for body and markers, a probe, its force at full load, N, and the mesh below it."""

    name: str
    scene: str
    probe: Probe
    push_n: float
    shear_n: float = 0.0
    at_mm: tuple[float, float] = (0.0, 0.0)
    edge_mm: float
    reach_mm: float
    growth: float = 1.3


CASES = (
    Case(name="sato_press", scene="sato_press", probe=Sphere(diameter_mm=3), push_n=100 * GRAM, edge_mm=0.35,
         reach_mm=0.6),
    Case(name="sato_shear", scene="sato_shear", probe=Sphere(diameter_mm=3), push_n=100 * GRAM, shear_n=0.3,
         edge_mm=0.35, reach_mm=0.6),
    Case(name="Sato, Fig. 8, along z", scene="sato_press", probe=Cylinder(diameter_mm=10), push_n=200 * GRAM,
         edge_mm=1.2, reach_mm=1.2),
    Case(name="Sato, Fig. 8, along x", scene="sato_press", probe=Cylinder(diameter_mm=10), push_n=200 * GRAM,
         shear_n=200 * GRAM, edge_mm=1.2, reach_mm=1.2),
    Case(name="Sato, Fig. 9", scene="sato_press", probe=Sphere(diameter_mm=3), push_n=200 * GRAM, edge_mm=0.35,
         reach_mm=1.2),
    Case(name="kamiyama_pillar", scene="kamiyama_pillar", probe=Cylinder(diameter_mm=5), push_n=3.0, edge_mm=1.2,
         reach_mm=3.0, growth=1.0),
    Case(name="6 mm sphere on the block", scene="kamiyama_pillar", probe=Sphere(diameter_mm=6), push_n=3.0, edge_mm=1.0,
         reach_mm=2.0, growth=1.0),
)  # fmt: skip


def studies() -> dict[str, Callable[[], Iterator[dict[str, Any]]]]:
    """Return the parts of the study by name: every case, and the first one on a finer mesh."""
    found: dict[str, Callable[[], Iterator[dict[str, Any]]]] = {}
    for case in CASES:
        found[case.name] = partial(_pressed, case, LEVELS)
    first = CASES[0]
    found[f"{first.name}, finer mesh"] = partial(_pressed, first, LEVELS[::3], finer=0.7)
    return found


def below(case: Case, finer: float = 1.0) -> Mesh:
    """Return the body's nominal mesh, refined around the part of the surface that the probe can touch."""
    body = load_scene(case.scene).body
    x, y = case.at_mm
    half = case.probe.diameter_mm / 2 if case.probe.kind == "cylinder" and case.scene.startswith("sato") else 0.0
    line = np.column_stack([np.linspace(x - half, x + 0.2 * half, 31), np.full(31, y)])
    middle = body.surface_from_above(line)

    def wanted(points: Points) -> Floats:
        away = np.min(np.linalg.norm(points[:, None] - middle[None], axis=2), axis=1)
        return np.asarray(finer * case.edge_mm + case.growth * np.maximum(away - case.reach_mm, 0.0))

    return refined(body_mesh(body, "nominal"), body, wanted)


def _pressed(case: Case, levels: tuple[float, ...], finer: float = 1.0) -> Iterator[dict[str, Any]]:
    scene = load_scene(case.scene, {"tolerance.preset": "none"})
    body, modulus = scene.body, scene.material.youngs_modulus_mpa
    mesh, start = below(case, finer), Approach.of(case.probe, scene.body, np.array(case.at_mm))
    markers = Sensor(scene).actual.markers.points
    locator = Locator(mesh)
    at_markers = locator.locate(markers)
    rubbers = {linear: Rubber(mesh, linear) for linear in (True, False)}
    pushed: dict[bool, tuple[Floats, Floats]] = {}
    past = 1.0
    for level in levels:
        begun = time.process_time()
        before, pushed, ends = pushed, {}, []
        for linear, rubber in rubbers.items():
            contact = Contact.on(mesh, body, start, linear)
            if linear and not before:
                guess, contact.moved_mm[Z] = rubber.rest, _first_guess(case, level / modulus)
            elif linear:
                guess = rubber.rest + level / past * (before[True][0] - rubber.rest)
                contact.moved_mm = _first_guess(case, level) / _first_guess(case, past) * before[True][1]
            else:
                guess, contact.moved_mm = pushed[True][0], pushed[True][1].copy()
                if before:
                    guess = guess + level / past * (before[False][0] - before[True][0])
                    contact.moved_mm += level / past * (before[False][1] - before[True][1])
            unknowns = press(rubber, contact, guess, {Z: case.push_n * level / modulus})
            pushed[linear] = unknowns, contact.moved_mm.copy()
            if case.shear_n:
                contact.stick(rubber.displacement(unknowns))
                both = {Z: case.push_n * level / modulus, X: case.shear_n * level / modulus}
                unknowns = press(rubber, contact, unknowns, both)
            ends.append((unknowns, contact))
        past = level
        (straight, touched), (bent, indented) = ends
        lin, real = (rubbers[True].displacement(unknowns) for unknowns in (straight, bent))
        size = np.linalg.norm(at_markers.values(real), axis=1)
        off = np.linalg.norm(at_markers.values(lin) - at_markers.values(real), axis=1)
        yield {
            "case": case.name if finer == 1.0 else f"{case.name}, finer mesh",
            "level": level,
            "push_n": case.push_n * level,
            "shear_n": case.shear_n * level,
            **_contact_figures(case, touched, lin),
            "error_max": float(off.max() / size.max()),
            "error_rms": float(np.sqrt((off**2).sum() / (size**2).sum())),
            "indentation_error": float(touched.moved_mm[Z] / indented.moved_mm[Z] - 1.0),
            **_strains(at_markers, locator, touched, lin, real),
            "unknowns": mesh.unknowns,
            "seconds": time.process_time() - begun,
        }


def _first_guess(case: Case, level: float) -> float:
    """Return the indentation by Hertz, or of a flat punch, for a total force of ``level`` times the case's."""
    radius, force = case.probe.diameter_mm / 2, case.push_n * level
    if case.probe.kind == "sphere":
        return float((9 / 16 * force / np.sqrt(radius)) ** (2 / 3))
    return float(3 / 8 * force / radius)


def _contact_figures(case: Case, contact: Contact, lin: Floats) -> dict[str, Any]:
    push, radius = contact.springs(lin)[0], case.probe.diameter_mm / 2
    area = float(contact.area_mm2[np.linalg.norm(push, axis=1) > 0].sum())
    if case.probe.kind != "sphere" and not np.ptp(contact.rest_mm[:, Z]):
        area = np.pi * radius**2  # flat on flat: the whole face touches, though springs beside its edge may stand off
    return {
        "contact_over_probe_radius": float(np.sqrt(area / np.pi) / radius) if case.probe.kind == "sphere" else None,
        "mean_strain": float(push[:, Z].sum() / area),
    }


def _strains(
    at_markers: Locator.Places, locator: Locator, contact: Contact, lin: Floats, real: Floats
) -> dict[str, float]:
    """Return largest strains: of linear theory and real, at the markers and below the contact; and the largest turn."""
    touching = np.linalg.norm(contact.springs(lin)[0], axis=1) > 0
    deep = locator.locate(contact.rest_mm[touching] + DEEP_MM * contact.inward[touching])
    out = {}
    for name, places in (("markers", at_markers), ("deep", deep)):
        slope = places.gradients(lin)
        strain = np.linalg.eigvalsh((slope + slope.transpose(0, 2, 1)) / 2)
        whole = np.eye(3) + places.gradients(real)
        left, stretch, right = np.linalg.svd(whole)
        out[f"strain_{name}"] = float(np.abs(strain).max())
        out[f"stretch_{name}"] = float(stretch.max() - 1.0)
        cosine = (np.trace(left @ right, axis1=1, axis2=2) - 1.0) / 2.0
        out[f"turn_{name}_deg"] = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max())
    return out


def measure(*parts: str) -> None:
    """Run parts, all by default, print their rows and put them into the stored file."""
    known = studies()
    if unknown := sorted(set(parts) - set(known)):
        raise SystemExit(f"unknown {', '.join(unknown)}: choose from {', '.join(known)}")
    for name in parts or known:
        rows = list(known[name]())
        print(f"\n{table(rows)}", flush=True)
        order = list(known)
        rows += [row for row in stored("validity") if row["case"] != name]
        store("validity", sorted(rows, key=lambda row: (order.index(row["case"]), row["level"])))
