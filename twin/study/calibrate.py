"""Calibrate a sensor: from the nominal design, or from presses on the made or a real one.

The sensor's software never sees the truth: the nominal methods use the nominal design on a mesh of
its own; ``sato`` and ``fitted`` use pictures of the made sensor and the forces that a noisy load
cell read, the first as they are, place by place, the second to fit the nominal design's parameters
(`twin.study.fitted_design`), for which five places do.

A simulated press (Sato, II C) is a sphere that sticks, along z, then x, then y: held by force along
z and by small motions sideways. docs/own_sensor.md has the files of a real sensor's recording.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, Progress
from twin.blas_threads import one_blas_thread
from twin.errors import ContactError, InputError, RecipeError
from twin.files import cache_folder, kept_if_possible, make_folder
from twin.parts.body import Block, Body
from twin.parts.load import Rectangles
from twin.parts.part import Purpose, hash_of
from twin.parts.press import Press, Sphere, Step
from twin.parts.scene import Scene
from twin.study.sensor import Sensor
from twin.theory.contact import hertz
from twin.theory.optics import project_with_jacobian

if TYPE_CHECKING:
    from twin.parts.scene import Sites
    from twin.sense.calibration import Calibration
    from twin.sense.fit_design import Presses
    from twin.sense.track import Found

BY_PRESSES = ("sato", "fitted")
PACKAGES = ("tactile-twin", "numpy", "scipy", "mitsuba")

FIVE = ((0.0, 0.0), (0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5))
"""Default places of method ``fitted``, over the half extents of the sites."""

SHEAR_SHARE = 0.25
"""Sideways motion of a calibration press over the contact radius: well inside what sticks."""

FOOTPRINT = 0.8
"""Half side of the square that stands for a calibration contact, over the contact radius."""

OWN_ERROR, OWN_THICKNESS = 0.004, 0.0025
"""Standard deviation of a fitted stiffness from what presses at all places share, relative: errors
of the nominal mesh and of the contact's shape. Nine fits were off by 0.0003 to 0.0064, 0.0034 RMS,
where noise leaves 0.0016 to 0.0030.
And of a fitted thickness: gel pads of 4 mm come out 0.011 mm too thin, 0.007 on a finer mesh."""

OWN_LEFT, MOST_OFF = 0.025, 0.99
"""Share of the motion that sound presses leave unexplained next to them (0.01 to 0.023 on gel pads
of 3.6 to 4.2 mm), by which totals are not off; and the largest error of a fitted scale that is
stated."""

LIGHTEST = 0.05
"""Smallest push at a place that a footprint follows from, over the largest."""

STAGE_MM, STAGE_OFF_MM = 0.5, 0.1
"""How far the origin of a recording's places may lie from the recipe's, as a standard deviation,
and from where on it is reported, mm. Layouts without a drawing count from where the camera looks:
0.5 mm beside the middle of a pad 3.5 mm thick, its modulus came out 14 % too small, now 3 %."""

FIRST_EXPOSURE = 1000
"""Calibration pictures are exposures from here on, so that they share no noise with any press."""

DESIGN_NOISE_PX = 0.03
"""Tracking noise that a calibration from the design alone assumes."""

TABLE = "presses.csv"
PLACES = ("x_mm", "y_mm", "z_mm")
FORCES = ("fx_n", "fy_n", "fz_n")
HELD = "held_s"
"""How long each press was held before its picture: a column that may be absent."""

SAME_PLACE_MM = 0.01
OFF_GRID = 0.25
"""Share of the pitch by which a press may miss its place of the grid (method sato)."""

SMALLEST_SHARE = 0.5
"""Share of the markers that the rest picture must show."""

DISAGREE = 0.1
"""Median error of presses predicted from the others, over their motion, from which to warn. Sound
recordings of gel pads have 0.01 to 0.02."""

MISTAKEN, SURE = 0.7, 0.8
"""Columns of the table are swapped or of the wrong sign where motion agrees with them as given less
than this times as well as with the mended ones, and with these by this correlation at least."""

SPREAD = 3.0
"""How much further apart than in the table motion shows the presses where its unit is wrong."""

UNSTATED = 1.5
"""Errors of the presses' total forces over the stated ones, root mean square, from which to
warn."""


@one_blas_thread()
def calibration_of(sensor: Sensor, *, kept: bool = True) -> Calibration:
    """Return the calibration by the scene's method; with ``kept`` a file is used while it
    matches, and presses are stored."""
    scene = sensor.nominal
    if scene.calibration.method not in BY_PRESSES:
        return _calibrate_by_design(sensor)
    if not kept:
        return _calibrate_by_presses(sensor)
    from twin.sense.calibration import read_calibration

    digest = _sensor_digest(scene)
    cached = cache_folder() / f"calibration-{digest[:32]}-{_as_computed(scene)}.npz"
    given = [Path(scene.calibration.file)] if scene.calibration.file else []
    for path in [*given, cached]:
        # A damaged file is named to who gave it; in the cache it is made again.
        damaged = (InputError,) if path == cached else ()
        with suppress(*damaged):
            if path.is_file() and (found := read_calibration(path)).facts.get("digest") == digest:
                return found
    if given and sensor.progress is None:
        print(
            f"twin: {given[0].name} was made for another sensor than this scene's; calibrating "
            "again, which takes minutes",
            file=sys.stderr,
        )
    made = _calibrate_by_presses(sensor)
    with kept_if_possible():
        made.write(cached)
    return made


def calibrate_to_file(
    scene: Scene, out: Path, progress: Progress | None = None, folder: Path | None = None
) -> str:
    """Calibrate a sensor by the scene's method, write the file ``out`` (.npz) and return a line
    about it.

    With ``folder``, the recording of a real sensor; else the scene's made sensor.

    Raises
    ------
    RecipeError
        The scene lacks a table.
    InputError
        Files that can't be used; fewer than half of the design's markers at rest.
    """

    if scene.reconstruction is None or scene.camera is None:
        table = "reconstruction" if scene.reconstruction is None else "camera"
        raise RecipeError(
            f"this scene has no [{table}] table: calibrating needs [camera], and [reconstruction] "
            "with its sites"
        )
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: a calibration file ends in .npz")
    make_folder(out.parent)
    sensor = Sensor(scene, progress)
    read: list[str] = []
    if folder is not None:
        made, text, read = _calibrate_from_folder(sensor, folder)
    else:
        made = calibration_of(sensor, kept=False)
        text = f"{len(made.transfer) // 2} markers"
    stored = scene.reconstruction.model_dump(exclude={"sites", "source", "assumed"})
    if made.relaxation is None:
        stored["frames_per_second"] = None
    made = _stating(made, {"reconstruction": stored})
    made.write(out)
    if progress is not None:
        progress("done", 1.0)
    line = f"{out}: {scene.calibration.method}, {len(made.site_mm)} sites, {text}"
    lines = [line, *_fitted_numbers(scene, json.loads(made.provenance))]
    method = scene.calibration.method
    if folder is not None and method not in BY_PRESSES and (folder / TABLE).is_file():
        lines.append(
            f"warning method {method} uses the rest picture alone, and none of the presses in "
            f"{TABLE}: --method fitted learns from them"
        )
    if method == "fitted" and folder is None and scene.light is not None:
        lines += [f"warning {text}" for text in scene.light.turns()]
    if method == "fitted" and len(made.left_out) > 1:
        lines += _agreement(made)
    return "\n".join(lines + read)


def _agreement(made: Calibration) -> list[str]:
    """Return how well each press is predicted from the others, and what to check if it is not."""
    from twin.study.fitted_design import FittedDesign

    usual, worst = float(np.median(made.left_out)), int(made.left_out.argmax())
    where = made.facts["frames"][worst] if "frames" in made.facts else f"place {worst + 1}"
    lines = [
        f"fitted  motion under a press, predicted from the other presses: {100 * usual:.0f} % off "
        f"(median), {100 * made.left_out[worst]:.0f} % at worst ({where})"
    ]
    if usual > DISAGREE:
        lines.append(
            "warning the presses do not fit this sensor well: its forces may be "
            f"{100 * usual:.0f} % off, as they state, or more; {FittedDesign.CHECK}"
        )
    return lines


def _read_back(
    made: Calibration, scene: Scene, found: Sequence[Found], force_n: Floats
) -> tuple[Calibration, list[str]]:
    """Return the calibration, stating by what share the total forces that it reads from its own
    presses are further off than it stated, and lines about them."""
    from twin.sense.reconstruct import reconstruct

    options = scene.inverse.options()
    elastic = _stating(made, {"relaxation": []})  # as ``force_n`` is
    fields = [reconstruct(one, elastic, **options) for one in found]
    stated = np.array([field.sd_total_n for field in fields])
    totals = np.array([field.total_force_n for field in fields]) - force_n
    cell = scene.calibration.load_cell_n
    allowed = np.hypot(stated, cell)

    def rms(values: Floats) -> Floats:
        return np.asarray(np.sqrt(np.mean(values**2, axis=0)))

    def line(what: str, values: Floats) -> str:
        parts = (f"F{axis} {one:.2g}" for axis, one in zip("xyz", rms(values), strict=True))
        return f"read    {what}: {', '.join(parts)} N (root mean square)"

    # of components that the load cell read well, and more than chance makes of this many presses
    size = np.maximum(rms(force_n), np.finfo(float).tiny)
    excess = np.sqrt(np.maximum(rms(totals) ** 2 - rms(allowed) ** 2, 0.0)) / size
    by_chance = 1.0 + (2.0 / len(found)) ** 0.5
    known = (size > SPREAD * cell) & (rms(totals) > by_chance * rms(allowed))
    share = np.where(known, np.minimum(excess, MOST_OFF), 0.0)
    made = _stating(made, {"read_error": share.tolist()})
    lines = [
        line("total force of these presses off by", totals),
        line(f"stated, with the load cell's {cell:g} N", np.hypot(allowed, share * force_n)),
    ]
    if options["push_only"] or options["friction"] is not None:
        sums = np.array([field.force_n.sum(axis=0) for field in fields]) - force_n
        lines.append(line("sites' sum, of sites that only push or obey friction, off by", sums))
    if (rms(totals / allowed) > UNSTATED).any():
        lines.append(
            f"warning total forces are further off than is stated. Often {TABLE} has the wrong "
            "sign of an axis or of one press, or a size in the recipe is wrong (thickness, depth, "
            "Poisson's ratio), which one layer of dots hardly shows. Trust a force no more than "
            "the lines above say"
        )
    return made, lines


def _fitted_numbers(scene: Scene, facts: dict[str, Any]) -> list[str]:
    """Return lines on the rubber and the layers that a fit found, and those of the drawing."""
    modulus, nu = scene.material.youngs_modulus_mpa, scene.material.poisson_ratio
    drawn = {
        "youngs_modulus": ("Young's modulus", modulus, modulus, " MPa"),
        "poisson_ratio": ("Poisson's ratio", nu, 1.0, ""),
        "thickness": ("thickness", scene.body.base_z_mm, 1.0, " mm"),
        **{
            f"depth_{name}": (f"depth of {name}", layer.depth_mm, 1.0, " mm")
            for name, layer in scene.markers.items()
        },
    }
    lines, none = [], {"deviation": 0.0}
    for name, found in facts.get("fitted", {}).items():
        if name in drawn:
            what, value, scale, unit = drawn[name]
            fitted = value + found["deviation"] * scale
            lines.append(f"fitted  {what} {fitted:.3g}{unit}, drawn {value:g}{unit}")
    x, y = (facts.get("fitted", {}).get(f"stage_{axis}", none)["deviation"] for axis in "xy")
    if math.hypot(x, y) > STAGE_OFF_MM:
        lines.append(
            f"fitted  the origin of {TABLE} lies at x {x:.2f}, y {y:.2f} mm of the recipe's, in "
            f"which places are given out: to have them as in {TABLE}, add {-x:.2f}, {-y:.2f} to "
            "offset_mm of the markers and to pupil_mm"
        )
    return lines


def _sensor_digest(scene: Scene) -> str:
    """Return a hash of what a calibration by presses depends on: the sensor, not the press."""
    others = {"title", "press", "tractions", "accuracy", "renderer", "dataset", "vary"}
    table = _by_linear_theory(scene).model_dump(mode="json", exclude=others)
    table["calibration"].pop("file")
    table["reconstruction"] = table["reconstruction"]["sites"]
    return hash_of(table)


def _as_computed(scene: Scene) -> str:
    """Return a hash of how exactly, and by which renderer, a calibration's presses are computed:
    those of one sensor are stored under it."""
    table = scene.model_dump(mode="json", include={"accuracy", "renderer"})
    return hash_of(table)[:16]


def _by_linear_theory(scene: Scene) -> Scene:
    """Return the scene with the law by which calibration presses are solved: the sensor's software
    is linear, and sticking probes at finite strain take 3 s each."""
    material = scene.material.model_copy(update={"law": "linear", "law_ratios": ()})
    return scene.model_copy(update={"material": material})


def _calibrate_by_design(sensor: Sensor) -> Calibration:
    scene, markers, room = sensor.nominal, sensor.nominal_markers, sensor.nominal.tolerance
    made_exactly, count = room.preset == "none", 3 * len(markers)
    deeper = 0.0 if made_exactly else room.depth_mm
    depths = [layer.depth_mm for layer in scene.markers.values()]
    step = min(deeper, min(depths, default=0.0) / 2)
    nearer = markers.points - step * markers.normals
    points = np.concatenate([markers.points, nearer]) if step else markers.points
    compliance = _nominal_compliance(sensor, points, sensor.sites)
    made = nominal_calibration(sensor, compliance[:count])
    if step:
        change = made.transfer - _through_camera(sensor, nearer, compliance[count:])
        made = replace(made, by_depth=(deeper / step * change).astype(np.float32))
    more = 0.0 if made_exactly else room.thickness_mm
    if scene.calibration.method == "halfspace":
        drawn = sensor.nominal_compliance.to_points(markers.points, sensor.sites)
        change = _through_camera(sensor, markers.points, drawn) - made.transfer
    elif more:
        change = _by_thickness(sensor, made, more)
    else:
        return made
    return replace(made, by_thickness=change.astype(np.float32))


def _by_thickness(sensor: Sensor, made: Calibration, more: float) -> Floats:
    """Return (2n, 3k) px/N: what the transfer matrix gains from a block ``more`` mm thicker.

    It is solved for at every other site, in half the time.
    """
    from twin.study.fitted_design import from_every_other_site

    thicker = Sensor(sensor.nominal.thicker(more), sensor.progress)

    def change(chosen: Bools) -> Floats:
        found = _nominal_transfer(thicker, sensor.sites[chosen])
        return found - made.transfer[:, np.repeat(chosen, 3)]

    return from_every_other_site(made.grid, change)


def nominal_calibration(sensor: Sensor, compliance: Floats) -> Calibration:
    """Return the calibration by a (3n, 3k) nominal compliance, mm/N, through the nominal camera."""
    scene = sensor.nominal
    points = sensor.nominal_markers.points
    made = _calibration(sensor, _through_camera(sensor, points, compliance), DESIGN_NOISE_PX)
    seen: dict[str, Any] = {"compliance": compliance, "camera": made.camera_text(*scene.optics)}
    return replace(made, marker_mm=points, **seen)


def _nominal_transfer(sensor: Sensor, sites: Rectangles) -> Floats:
    """Return (2n, 3k) px/N: the nominal design's compliance through its camera."""
    points = sensor.nominal_markers.points
    return _through_camera(sensor, points, _nominal_compliance(sensor, points, sites))


def _nominal_compliance(sensor: Sensor, points: Points, sites: Rectangles) -> Floats:
    """Return (3n, 3k) mm/N of (n, 3) points of the nominal design, mm."""
    scene = sensor.nominal
    if scene.calibration.method == "halfspace":
        return half_space_compliance(scene, points, sites)
    return sensor.nominal_compliance.to_points(points, sites)


def _through_camera(sensor: Sensor, points: Points, compliance: Floats) -> Floats:
    """Return (2n, 3k) px/N of the compliance of (n, 3) points, mm, in the nominal camera."""
    from twin.sense.calibration import from_compliance

    jacobian = project_with_jacobian(points, *sensor.nominal.optics)[1]
    return from_compliance(compliance, jacobian)


def half_space_compliance(scene: Scene, markers: Floats, sites: Rectangles) -> Floats:
    """Return (3n, 3k) mm/N by the papers' half-space formula (eqs. 1 and 2 with u_z, corrected),
    uniform rectangles; `RecipeError` where the sensing surface is not flat.
    """
    from twin.theory.halfspace import compliance

    if not isinstance(scene.body, Block):
        raise RecipeError(
            "calibration.method = 'halfspace': the formula holds on flat bodies only; use "
            "compliance or sato"
        )
    material = scene.material
    return compliance(markers, sites, material.youngs_modulus_mpa, material.poisson_ratio)


def _calibrate_by_presses(sensor: Sensor) -> Calibration:
    """Calibrate the made sensor by its pictures and the load cell under presses at every place.

    They go along z, then x, then y (Sato, II C); the nominal design fills in between places. By any
    `Material.law` these presses are solved by linear theory.
    """
    scene = sensor.nominal
    if scene.material.law != "linear":
        sensor = Sensor(_by_linear_theory(scene), sensor.progress)
    sites, grid = scene.inverse.sites, scene.calibration.presses
    if grid is None and scene.calibration.method == "sato":
        grid = sites
    half_mm = FOOTPRINT * _hertz_radius(scene, scene.calibration.press_force_n)
    chart = grid.chart() if grid is not None else np.array(FIVE) * np.array(sites.half_mm)
    places = Rectangles.on_surface(scene.body, chart, half_mm, "calibration.presses")
    presses = _press_everywhere(sensor, places)
    if scene.calibration.method == "fitted":
        return _fitted_calibration(sensor, places, presses)
    assert grid is not None
    return _measured_calibration(sensor, places, grid, presses)


def _press_everywhere(sensor: Sensor, places: Rectangles) -> Presses:
    """Press the made sensor in three directions at every place; return what was measured."""
    from twin.sense.track import Tracker, analyse_rest

    scene = sensor.nominal
    count = len(places)
    picture = sensor.picture(None, exposure=FIRST_EXPOSURE)
    rest = analyse_rest(picture, sensor.layout_px, method=scene.tracking.method)
    forces, found = [], []
    # Each place: one path of three states (along z, then x, then y), each with a picture and a
    # reading of the load cell of its own.
    for place in range(count):
        pressed = sensor.press(calibration_press(scene, places, place))
        if not pressed.complete:
            raise ContactError(f"calibration: press {place + 1} of {count}: {pressed.reason}")
        rng = Purpose.LOAD_CELL.stream(scene.seed, place)
        noise = scene.calibration.load_cell_n * rng.standard_normal((3, 3))
        for number, state in enumerate(pressed.path):
            exposure = FIRST_EXPOSURE + 1 + 3 * place + number
            found.append(Tracker.motion(rest, sensor.picture(sensor.motion(state.load), exposure)))
            forces.append(state.force_n + noise[:, number])
        if sensor.progress is not None:
            sensor.progress(f"calibrating, press {place + 1} of {count}", 0.9 * (place + 1) / count)
    return _measured(scene, np.repeat(np.arange(count), 3), np.stack(forces), found)


def _measured(scene: Scene, place: Ints, force_n: Floats, found: Sequence[Found]) -> Presses:
    """Return presses with the motion that the tracker found under each."""
    from twin.sense.fit_design import Presses

    return Presses(
        place=place,
        force_n=force_n,
        shift_px=np.stack([each.shift_px for each in found]),
        rest_px=found[0].rest_px,
        load_cell_n=scene.calibration.load_cell_n,
        noise_px=float(np.nanmedian(np.concatenate([each.sd_px for each in found]))),
    )


def calibration_press(scene: Scene, places: Rectangles, index: int) -> Press:
    """Return the path of one calibration press: to the wanted force, then along x, then along y.

    The sphere's axis is set off so that it touches first at the place, whose rubber sticks to it
    and is carried along.
    """
    wanted = scene.calibration
    normal = places.frames[index, 2]
    radius = wanted.press_probe_mm / 2
    contact_radius = min(_hertz_radius(scene, wanted.press_force_n * float(normal[2])), radius)
    x, y = places.centre_mm[index, :2] - radius * normal[:2]
    shear = SHEAR_SHARE * contact_radius
    return Press(
        probe=Sphere(diameter_mm=wanted.press_probe_mm),
        at_mm=(float(x), float(y)),
        friction=np.inf,
        steps=(
            Step(force_n=(None, None, wanted.press_force_n)),
            Step(move_mm=(shear, None, None)),
            Step(move_mm=(-shear, shear, None)),
        ),
    )


def _hertz_radius(scene: Scene, force_n: float) -> float:
    """Return the nominal contact radius of the calibration sphere, mm."""
    return hertz(
        radius_mm=scene.calibration.press_probe_mm / 2,
        youngs_modulus_mpa=scene.material.youngs_modulus_mpa,
        poisson_ratio=scene.material.poisson_ratio,
        force_n=force_n,
    ).contact_radius_mm


def _measured_calibration(
    sensor: Sensor, places: Rectangles, grid: Sites, presses: Presses
) -> Calibration:
    """Return Sato's calibration: three presses at every place, the nominal design in between."""
    from scipy.linalg import block_diag

    from twin.sense.calibration import fill_between, from_presses, left_out

    scene = sensor.nominal
    count = len(places)
    forces = presses.force_n.reshape(count, 3, 3).transpose(0, 2, 1)
    transfer = from_presses(forces, presses.shift_px.reshape(count, 3, -1))
    there = _nominal_transfer(sensor, places)
    errors = left_out(transfer, there, grid.chart())
    # A force f c at a place, of its presses' forces f, is read as (f + e) c where the cell erred by
    # e: any component is off by the cell's deviation times |c|.
    by_cell = np.asarray(presses.load_cell_n * block_diag(*np.linalg.inv(forces)))
    sites = scene.inverse.sites.chart()
    if grid.chart().tolist() != sites.tolist():
        here = _nominal_transfer(sensor, sensor.sites)
        transfer = fill_between(transfer, there, here, grid.axes(), sites)
        none = np.zeros((3 * count, 3 * len(sites)))
        by_cell = fill_between(by_cell, np.zeros_like(by_cell), none, grid.axes(), sites)
    made = _calibration(sensor, transfer, presses.noise_px)
    made = replace(made, left_out=errors, by_load_cell=by_cell.astype(np.float32))
    return _with_facts(made, presses, {})


def _fitted_calibration(
    sensor: Sensor, places: Rectangles, presses: Presses, stage_mm: float = 0.0
) -> Calibration:
    """Return the calibration by the nominal design fitted to presses and to the rest picture; the
    origin of the presses' places may be off by ``stage_mm`` (standard deviation, mm)."""
    from twin.sense.fit_design import Fit
    from twin.study.fitted_design import FittedDesign

    scene = sensor.nominal
    # Footprint at a place by Hertz and its presses' mean push, at most as wide as the probe.
    pushed = np.einsum("ij,ij->i", presses.force_n, places.frames[presses.place, 2])
    force = np.bincount(presses.place, pushed) / np.bincount(presses.place)
    most = scene.calibration.press_probe_mm / 2
    least = LIGHTEST * float(np.linalg.norm(presses.force_n, axis=1).max())
    radius = np.array([min(_hertz_radius(scene, max(float(f), least)), most) for f in force])
    own_cover = scene.cover is not None and scene.cover.has_own_material
    covered = sensor.nominal_compliance.to_points if own_cover else None
    design = FittedDesign(scene, places, radius, covered, sensor.progress, stage_mm)
    found = Fit.of(design, presses)
    # The transfer matrix of the fitted design, at the scene's sites.
    markers, _ = design.markers_of(found.scaled, presses.rest_px)
    sites = scene.inverse.sites
    grid = (sites.columns, sites.rows)
    compliance = design.compliance(found.scaled, markers, sensor.sites, grid)
    transfer = design.transfer(found.scaled, markers, compliance)
    made = _calibration(sensor, transfer, float(np.hypot(presses.noise_px, found.model_px)))
    made = replace(
        made,
        left_out=found.left_out,
        compliance=compliance.astype(np.float32),
        marker_mm=markers,
        camera=made.camera_text(*design.optics_of(found.scaled)),
    )
    fitted = design.deviations(found)
    if "thickness" in fitted:
        own = OWN_THICKNESS * scene.body.base_z_mm
        fitted["thickness"]["sd"] = math.hypot(fitted["thickness"]["sd"], own)
    modulus = fitted.get("youngs_modulus", {"deviation": 0.0, "sd": 0.0})
    # What no parameter explains of the motion makes totals as much wrong, besides noise.
    noise = presses.noise_px / float(np.sqrt(np.nanmean(presses.shift_px**2)))
    left = float(np.median(found.left_out)) ** 2 - noise**2 - OWN_LEFT**2
    unexplained = math.sqrt(max(left, 0.0))
    facts = {
        "fitted": fitted,
        "model_px": found.model_px,
        "youngs_modulus_mpa": scene.material.youngs_modulus_mpa * (1 + modulus["deviation"]),
        "scale_error": min(math.hypot(modulus["sd"], OWN_ERROR, unexplained), MOST_OFF),
    }
    return _with_facts(made, presses, facts)


def _with_facts(made: Calibration, presses: Presses, facts: dict[str, Any]) -> Calibration:
    """Add facts, and the rest places in the presses' rest picture, to a calibration."""
    layout = np.where(np.isfinite(presses.rest_px), presses.rest_px, made.layout_px)
    return _stating(replace(made, layout_px=layout), facts | {"rest": "measured"})


def _stating(made: Calibration, facts: dict[str, Any]) -> Calibration:
    """Return a calibration with more facts, or other ones, in its provenance."""
    return replace(made, provenance=json.dumps(made.facts | facts))


def _calibration(sensor: Sensor, transfer: Floats, noise_px: float) -> Calibration:
    from importlib.metadata import version

    from twin.sense.calibration import Calibration
    from twin.world.elasticity.error_law import EXPECTED

    scene, sites, layout = sensor.nominal, sensor.sites, sensor.layout_px
    grid = scene.inverse.sites
    method, room = scene.calibration.method, scene.tolerance
    mesh = EXPECTED[scene.body.is_flat, "nominal"].inside
    pitch_mm = min(layer.pitch_mm for layer in scene.markers.values())
    drawn = method not in BY_PRESSES and room.preset != "none"
    facts = {
        "digest": _sensor_digest(scene),
        "method": method,
        "scene": scene.title,
        "youngs_modulus_mpa": scene.material.youngs_modulus_mpa,
        "relaxation": [(term.share, term.time_s) for term in scene.material.relaxation],
        "scale_error": scene.scale_error if drawn else 0.0,
        "camera_error": [room.pupil_mm, room.tilt_deg] if drawn else [0.0, 0.0],
        "print_error": min(room.print_mm / pitch_mm, 0.9) if drawn else 0.0,
        "mesh_error": mesh if method == "compliance" else 0.0,
        "picture_px": scene.camera and [scene.camera.width_px, scene.camera.height_px],
        "seed": scene.seed,
        "versions": {name: version(name) for name in PACKAGES},
    }
    # the condition of the rows that were calibrated
    singular = np.linalg.svd(transfer[np.isfinite(transfer).all(axis=1)], compute_uv=False)
    return Calibration(
        layer=np.repeat(list(layout), [len(p) for p in layout.values()]),
        layout_px=np.concatenate(list(layout.values())),
        site_mm=sites.centre_mm,
        site_frames=sites.frames,
        site_area_mm2=4 * sites.half_mm.prod(axis=1),
        grid=(grid.columns, grid.rows),
        transfer=transfer,
        noise_px=noise_px,
        method=scene.calibration.method,
        provenance=json.dumps(facts),
        condition=float(singular[0] / max(singular[-1], singular[0] * np.finfo(float).eps)),
        left_out=np.zeros(0),
    )


def _rest_picture(folder: Path) -> Path:
    """Return the path of a recording's picture without load."""
    from twin.study.frames import PICTURES

    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; it holds rest.png and {TABLE}")
    found = [path for suffix in PICTURES if (path := folder / f"rest{suffix}").is_file()]
    if len(found) != 1:
        names = ", ".join(f"rest{suffix}" for suffix in PICTURES)
        raise InputError(f"{folder}: must hold one of {names}, the picture without load")
    return found[0]


def _calibrate_from_folder(sensor: Sensor, folder: Path) -> tuple[Calibration, str, list[str]]:
    """Return the calibration of the sensor in a folder's pictures, its markers in words, and lines
    on the forces that it reads from presses."""
    from twin.sense.track import Tracker
    from twin.study.frames import read_numbers, read_picture

    scene, progress = sensor.nominal, sensor.progress
    # The rest picture must show most of the design's markers.
    rest = _rest_picture(folder)
    tracker = Tracker(read_picture(rest), sensor.layout_px, method=scene.tracking.method)
    rest_px = tracker.rest.rest_px
    known = np.asarray(np.isfinite(rest_px).all(axis=1))
    text = f"{int(known.sum())} of {len(known)} markers"
    read: list[str] = []
    if known.mean() < SMALLEST_SHARE:
        raise InputError(
            f"{rest}: shows {int(known.sum())} of the design's {len(known)} markers; is it this "
            "scene's sensor, upright and of its camera's size? twin calibrate --layout-from "
            f"{rest} --scene SCENE states which focal length or distance of the lens fits it"
        )
    # Without presses the design itself gives the transfer; otherwise every press is tracked from
    # rest.
    if scene.calibration.method not in BY_PRESSES:
        made = _calibrate_by_design(sensor)
    else:
        columns = (*PLACES, *FORCES, HELD)
        names, table = read_numbers(folder / TABLE, columns, blank=("z_mm",), absent=(HELD,))
        places_mm, force_n, held_s = table[:, :3], table[:, 3:6], table[:, 6]
        if sensor.relaxation is not None and np.isfinite(held_s).all():
            force_n = force_n * sensor.relaxation.creep(np.maximum(held_s, 0.0))[:, None]
        count = len(names)
        found = []
        for number, name in enumerate(names, start=1):
            tracker.forget()
            try:
                found.append(tracker.track(read_picture(folder / name)))
            except InputError as problem:
                cause = str(problem).removeprefix(f"{folder / name}: ")
                raise InputError(f"{folder / name}: {cause}") from None
            if found[-1].seen.sum() < 2:
                raise InputError(
                    f"{folder / name}: fewer than 2 markers were found: is it blurred, dark, or of "
                    f"another sensor? Take it again, or leave its line of {TABLE} out"
                )
            if progress is not None:
                progress(f"tracking, press {number} of {count}", 0.3 * number / count)
        presses = _measured(scene, np.zeros(count, np.int64), force_n, found)
        made = _by_presses(sensor, names, places_mm, presses)
        if scene.calibration.method == "fitted":
            made, read = _read_back(made, scene, found, force_n)
        text += f", {count} presses"
        if sensor.relaxation is not None and not np.isfinite(held_s).all():
            # How far the rubber had relaxed under each press isn't known.
            made = _stating(made, {"relaxation": []})
            text += f"; {TABLE} has no {HELD}, so how the rubber relaxes is left out"
    if scene.calibration.method != "fitted":
        made = replace(made, layout_px=np.where(known[:, None], rest_px, made.layout_px))
    return made, text, read


def _check_forces(scene: Scene, force_n: Floats, inward: Floats) -> None:
    """Refuse (q, 3) forces that would press the ball deeper than half the body: grams, say; and
    those that all pull, against the (q, 3) inward normals."""
    size = np.linalg.norm(force_n, axis=1)
    low, high = scene.body.bounds_mm
    radius = scene.calibration.press_probe_mm / 2
    most = int(size.argmax())
    if size.min() == 0:
        raise InputError(
            f"{TABLE}: press {int(size.argmin()) + 1} has no force; give what the load cell reads, "
            "N, or leave its line out"
        )
    if np.all(np.einsum("ij,ij->i", force_n, inward) <= 0):
        raise InputError(
            f"{TABLE}: every press pulls (the largest by fz_n = {force_n[most, 2]:.4g} N): forces "
            "are those on the sensor, and z points into it; change the load cell's signs"
        )
    depth = _hertz_radius(scene, float(size[most])) ** 2 / radius
    if depth > max((high[2] - low[2]) / 2, radius):
        raise InputError(
            f"{TABLE}: press {most + 1} has {size[most]:.4g} N, which by Hertz' law would press a "
            f"ball of {2 * radius:g} mm {depth:.3g} mm into a body {high[2] - low[2]:g} mm thick. "
            "Forces are in N (1 gf = 0.00981 N); if they are, mend material.youngs_modulus_mpa or "
            "calibration.press_probe_mm"
        )


def _compare_with_motion(scene: Scene, charts: Points, presses: Presses) -> None:
    """Refuse a table of presses at (q, 2) ``charts`` that the motion of the markers contradicts.

    A press lies about where markers move most; sideways forces move them along.
    """
    drawn = np.concatenate([layer.chart() for layer in scene.markers.values()])
    shift = np.nan_to_num(presses.shift_px)
    weight = (shift**2).sum(axis=2)
    seen = (weight @ drawn) / weight.sum(axis=1, keepdims=True)
    apart, given = (float(np.hypot(*at.std(axis=0))) for at in (seen, charts))
    wide = 2 * _hertz_radius(scene, scene.calibration.press_force_n)
    doubts = []
    if apart > SPREAD * given + wide:
        doubts.append(f"presses lie {apart:.2g} mm apart, here {given:.2g}: give x_mm, y_mm in mm")
    elif given > wide:
        doubts += _mistaken(seen, charts, np.zeros(len(charts), np.int64), ("x_mm", "y_mm"))
    # Motion along the drawing's axes; of presses at one place, where there are some, differences.
    known = np.isfinite(presses.rest_px).all(axis=1)
    affine = np.column_stack([drawn, np.ones(len(drawn))])[known]
    to_px = np.linalg.lstsq(affine, presses.rest_px[known], rcond=None)[0][:2]
    aside, place = presses.force_n[:, :2], presses.place
    if len(np.unique(place)) == len(place):
        place = np.zeros_like(place)
    if aside.std(axis=0).max() > SPREAD * presses.load_cell_n:
        moved = np.linalg.solve(to_px.T, shift.mean(axis=1).T).T
        doubts += _mistaken(moved, aside, place, ("fx_n", "fy_n"))
    if doubts:
        raise InputError(f"{TABLE}: by the motion in the pictures, {'; '.join(doubts)}")


def _mistaken(seen: Floats, given: Floats, group: Ints, names: tuple[str, str]) -> list[str]:
    """Return which of two columns (q, 2) are swapped or of the wrong sign, as far as what was
    ``seen`` (q, 2) is sure about it; differences from the mean of each (q,) group count."""
    mean = np.equal.outer(group, group) / np.bincount(group)[group]
    seen, given = seen - mean @ seen, given - mean @ given
    size = max(float(np.linalg.norm(seen) * np.linalg.norm(given)), np.finfo(float).tiny)
    agree = {}
    for swapped in (False, True):
        for signs in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
            mended = (given[:, ::-1] if swapped else given) * signs
            agree[swapped, signs] = float((seen * mended).sum()) / size
    swapped, signs = max(agree, key=lambda key: agree[key])
    best = agree[swapped, signs]
    if best < SURE or agree[False, (1, 1)] > MISTAKEN * best:
        return []
    turned = [name for name, sign in zip(names, signs, strict=True) if sign < 0]
    words = [f"{' and '.join(names)} are swapped"] if swapped else []
    return words + [f"{name} has the wrong sign" for name in turned]


def _require_places(body: Body, places_mm: Points, on_surface: Bools) -> None:
    """Refuse a table of presses whose places are not all on the surface."""
    if on_surface.all():
        return
    first = int(np.flatnonzero(~on_surface)[0])
    (x0, y0, z0), (x1, y1, z1) = body.bounds_mm
    x, y, z = places_mm[first]
    height = "" if np.isnan(z) else f", z_mm = {z:g}"
    raise InputError(
        f"{TABLE}: press {first + 1} at x_mm = {x:g}, y_mm = {y:g}{height} misses the sensing "
        f"surface of the body, which lies within x {x0:g} to {x1:g}, y {y0:g} to {y1:g} and z "
        f"{z0:g} to {z1:g} mm: mend the place, or its unit"
    )


def _by_presses(
    sensor: Sensor, names: Sequence[str], places_mm: Points, presses: Presses
) -> Calibration:
    """Return the calibration by presses at (q, 3) places of the surface, mm, in named pictures."""
    scene = sensor.nominal
    given = np.isfinite(places_mm[:, 2:])
    points = np.where(given, places_mm, scene.body.surface_from_above(places_mm[:, :2]))
    _require_places(scene.body, places_mm, np.isfinite(points[:, 2]))
    _check_forces(scene, presses.force_n, scene.body.frames(points)[:, 2])
    charts = scene.body.chart_of(points)
    # A place further off than the ball's radius isn't on this surface.
    near = np.abs(scene.body.depth(points)) <= scene.calibration.press_probe_mm / 2
    inside = scene.body.contains(scene.body.chart_points(charts), -1e-6)
    _require_places(scene.body, places_mm, np.asarray(inside & near))
    if twice := [name for number, name in enumerate(names) if name in names[:number]]:
        raise InputError(f"{TABLE}: two lines name {twice[0]}; each press has its own picture")
    for name, shift in zip(names, presses.shift_px, strict=True):
        if not np.nan_to_num(shift).any():
            raise InputError(
                f"{TABLE}: no marker moves in {name}: is it the rest picture? Name the press's own"
            )
    half_mm = FOOTPRINT * _hertz_radius(scene, scene.calibration.press_force_n)
    # Fitted: any places. Presses nearly at one place share it.
    rounded = np.rint(charts / SAME_PLACE_MM).astype(np.int64)
    _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    presses = replace(presses, place=which.ravel().astype(np.int64))
    _compare_with_motion(scene, charts, presses)
    if scene.calibration.method == "fitted":
        places = Rectangles.on_surface(scene.body, charts[first], half_mm, TABLE)
        made = _fitted_calibration(sensor, places, presses, STAGE_MM)
        return _stating(made, {"frames": [names[k] for k in first]})
    # Sato's way: three presses at every place of a grid, in any order.
    grid = scene.calibration.presses or scene.inverse.sites
    wanted = grid.chart()
    distance = np.linalg.norm(charts[:, None] - wanted[None], axis=2)
    nearest = distance.argmin(axis=1)
    if (far := distance.min(axis=1)).max() > OFF_GRID * grid.pitch_mm:
        raise InputError(
            f"{TABLE}: press {int(far.argmax()) + 1} is {far.max():.2f} mm from the nearest place "
            f"of the scene's grid of presses (up to {OFF_GRID * grid.pitch_mm:.2f} mm): mend "
            "[calibration.presses] or use --method fitted"
        )
    counts = np.bincount(nearest, minlength=len(wanted))
    if (counts != 3).any():
        bad = int(np.flatnonzero(counts != 3)[0])
        raise InputError(
            f"{TABLE}: the place at {wanted[bad].tolist()} mm has {counts[bad]} presses; method "
            f"sato needs 3 at each of the grid's {len(wanted)} places (along z, x and y). Fewer "
            "or others: --method fitted"
        )
    order = np.argsort(nearest, kind="stable")
    force, shift = presses.force_n[order], presses.shift_px[order]
    presses = replace(presses, place=nearest[order], force_n=force, shift_px=shift)
    places = Rectangles.on_surface(scene.body, wanted, half_mm, TABLE)
    return _measured_calibration(sensor, places, grid, presses)
