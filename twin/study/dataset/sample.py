"""One sample: from its number to a row of truth, doing only what its columns need.

Every sample starts from the same state, whatever was computed before it: what solved fields a contact finds in memory
may change its last digits, so they are put aside between samples.
"""

from __future__ import annotations

import json
import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Bools
from twin.errors import ContactError, RecipeError, TwinError
from twin.parts.part import Part
from twin.parts.pipeline import Sites
from twin.parts.scene import Scene
from twin.streams import Purpose
from twin.study.batch.draw import Table, with_values
from twin.study.dataset.columns import drawn_values
from twin.study.dataset.plan import MOST_STEPS, Plan, press_of
from twin.study.sensor import Motion, Sensor, on_grid

if TYPE_CHECKING:
    from twin.parts.load import Rectangles
    from twin.parts.press import Press
    from twin.world.contact_state import ContactState
    from twin.world.render import Outlines, Renderer

Row = dict[str, Any]

SPLIT = 6
"""Pieces per direction into which a patch is cut to be summed into cells."""


class MadeSensor:
    """One sensor of a dataset, ready to be pressed.

    Parameters
    ----------
    plan
        The dataset.
    number
        Of the sensor.
    values
        What is drawn for it, by dotted key.
    """

    def __init__(self, plan: Plan, number: int, values: Table) -> None:
        self.plan, self.number, self.values = plan, number, values
        self.seed = sensor_seed(plan.scene.seed, number)
        drawn = with_values(plan.scene, values, plan.sensor_axes) if values or plan.sensor_axes else plan.scene
        self.sensor = Sensor(drawn.model_copy(update={"seed": self.seed}))

    @cached_property
    def row(self) -> Row:
        """Its row of the sensors table."""
        sensor, needs = self.sensor, self.plan.needs
        scene, markers = sensor.actual.scene, sensor.actual.markers
        told: Row = {
            "sensor": self.number,
            "seed": self.seed,
            "actual": json.dumps(_actual(scene), sort_keys=True),
            "marker_layer": json.dumps([[name, int((markers.layer == name).sum())] for name in scene.markers]),
            "marker_rest_mm": markers.points,
            **drawn_values(self.plan.sensor_axes, self.values),
        }
        if scene.camera is not None and "motion" in needs:
            told["marker_rest_px"] = sensor.project(markers.points)
        if "outlines" in needs:
            outlines = self.renderer.outlines(sensor.ellipsoids(None))
            told |= {"marker_outline_rest_px": outlines.centroid_px, "marker_visible": outlines.visible}
        if "picture" in needs:
            from twin.png import png_bytes

            _ = self.renderer
            told["picture"] = png_bytes(sensor.picture(None))
            assert scene.camera is not None
            f, (cx, cy) = scene.camera.focal_px, scene.camera.centre_px
            told["camera_matrix"] = np.array([f, 0, cx, 0, f, cy, 0, 0, 1.0])
        if "sites" in needs:
            told["site_mm"] = self.cells.centre_mm
        return told

    @cached_property
    def grid(self) -> Sites:
        """The grid of sites."""
        scene = self.plan.scene
        if scene.dataset.sites is not None:
            return scene.dataset.sites
        assert scene.reconstruction is not None
        return scene.reconstruction.sites

    @cached_property
    def cells(self) -> Rectangles:
        """The cells of the sites."""
        return on_grid(self.sensor.nominal.body, self.grid, self.grid.pitch_mm / 2, "dataset.sites")

    @cached_property
    def renderer(self) -> Renderer:
        """The camera's view, traced by one thread."""
        from twin.world.render import one_thread

        renderer = self.sensor.renderer
        one_thread()
        return renderer


def sensor_seed(root: int, number: int) -> int:
    """Return the seed of a sensor, from the scene's seed and the sensor's number alone."""
    words = np.random.SeedSequence(root, spawn_key=(int(Purpose.SENSOR), number)).generate_state(1, np.uint64)
    return int(words[0] >> np.uint64(1))


def rows_of_sample(made: MadeSensor, sample: int, values: Table) -> list[Row]:
    """Return the rows of a sample: one, or one for every step; a failed sample is one row that says why."""
    plan = made.plan
    base: Row = {"index": sample, "step": 0, "sensor": made.number, "status": "ok"}
    base |= drawn_values(plan.press_axes, values)
    try:
        table = plan.press_table(values)
        base["press"] = json.dumps(table, sort_keys=True)
        press = press_of(table)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what warnings say is in the row's error estimates
            return [base | row for row in _rows(made, sample, press)]
    except TwinError as problem:
        told = str(problem)
    except (ArithmeticError, ValueError, LookupError, AssertionError, RuntimeError) as problem:
        told = f"internal error: {type(problem).__name__}: {problem}"
    return [base | {"status": "failed", "error": told}]


def failed_row(plan: Plan, sample: int, values: Table, why: str) -> Row:
    """Return the row of a sample that could not be made."""
    base: Row = {"index": sample, "step": 0, "sensor": plan.sensor_of(sample), "status": "failed", "error": why}
    return base | drawn_values(plan.press_axes, values)


def _rows(made: MadeSensor, sample: int, press: Press) -> list[Row]:
    plan, sensor = made.plan, made.sensor
    sensor.compliance.forget()
    state = sensor.press(press, with_error="traction_error" in {c.name for c in plan.columns})
    if not state.complete:
        raise ContactError(f"press: {state.reason}")
    every = plan.scene.dataset.every_step
    states = state.path if every and state.path else (state,)
    if len(states) > MOST_STEPS:
        raise RecipeError(f"press.steps: {len(states)} steps; allowed are {MOST_STEPS}")
    last = len(press.path) - 1
    rows = []
    for step, one in enumerate(states):
        number = step if every else last
        rows.append({"step": number} | truth_of(made, one, 1 + sample * MOST_STEPS + number))
    return rows


def truth_of(made: MadeSensor, state: ContactState, exposure: int | None = None) -> Row:
    """Return what columns are made of under a state; without an exposure what is seen is left out."""
    sensor, needs = made.sensor, made.plan.needs
    patches = sensor.rectangles(state.load)
    slip = np.concatenate([one.slip for one in (state, *state.also)])
    row = {
        "force_n": patches.force_n.sum(axis=0),
        "torque_nmm": np.cross(patches.centre_mm, patches.force_n).sum(axis=0),
        "probe_move_mm": state.move_mm,
        "probe_turn_deg": state.turn_deg,
        "indentation_mm": state.indentation_mm,
        "contact_area_mm2": state.area_mm2,
        "peak_pressure_mpa": state.peak_pressure_mpa,
        "contact_residual": state.residual,
        "traction_error": state.error.traction if state.error is not None else None,
        "linearisation_error": state.validity.linearisation_error,
        "surface_mm": patches.centre_mm,
        "surface_force_n": patches.force_n,
        "surface_slip": slip,
    }
    if "sites" in needs:
        row |= _on_sites(made, patches, slip)
    if not needs & {"motion", "picture", "outlines"}:
        return row
    looked_at = bool(needs & {"picture", "outlines"})
    motion = sensor.motion_of_patches(patches, strained=looked_at and sensor.markers_strain)
    row |= {"marker_displacement_mm": motion.displacement_mm, "displacement_error": motion.error}
    if sensor.nominal.camera is not None:
        row["marker_pressed_px"] = sensor.project(sensor.actual.markers.points + motion.displacement_mm)
    if looked_at and exposure is not None:
        row |= _seen(made, motion, exposure)
    return row


def _seen(made: MadeSensor, motion: Motion, exposure: int) -> Row:
    from twin.png import png_bytes

    sensor, renderer = made.sensor, made.renderer
    if "picture" not in made.plan.needs:
        return _told_by(renderer.outlines(sensor.ellipsoids(motion)))
    if "outlines" not in made.plan.needs:
        return {"picture": png_bytes(sensor.picture(motion, exposure=exposure))}
    picture, outlines = sensor.seen(motion, exposure)
    return {"picture": png_bytes(picture), **_told_by(outlines)}


def _told_by(outlines: Outlines) -> Row:
    return {"marker_outline_pressed_px": outlines.centroid_px, "marker_visible": outlines.visible}


def _on_sites(made: MadeSensor, patches: Rectangles, slip: Bools) -> Row:
    """Sum tractions, contact and slip into the cells of the sites.

    Raises
    ------
    ContactError
        The contact reaches beyond the sites.
    """
    grid, body = made.grid, made.sensor.actual.scene.body
    inside = (np.arange(SPLIT) + 0.5) / SPLIT * 2.0 - 1.0
    corners = np.stack(np.meshgrid(inside, inside, indexing="ij"), axis=-1).reshape(-1, 2)
    pieces = np.einsum("qs,ks,ksi->kqi", corners, patches.half_mm, patches.frames[:, :2])
    chart = body.chart_of((patches.centre_mm[:, None] + pieces).reshape(-1, 3))
    count = np.array([grid.columns, grid.rows])
    place = chart / grid.pitch_mm + count / 2.0
    if len(chart) and (over := float(np.maximum(-place, place - count).max()) * grid.pitch_mm) > 1e-6:
        raise ContactError(
            f"contact: it reaches {over:.3g} mm beyond the sites; enlarge [dataset.sites] or press further inside"
        )
    column, row = np.clip(np.floor(place).astype(int), 0, count - 1).T
    cell, cells = column * grid.rows + row, grid.columns * grid.rows
    area = 4.0 * patches.half_mm.prod(axis=1)
    columns = (*patches.force_n.T, area, area * slip)
    sums = [np.bincount(cell, np.repeat(values / SPLIT**2, SPLIT**2), cells) for values in columns]
    touched = sums[3] > 0
    return {
        "site_force_n": np.column_stack(sums[:3]),
        "site_contact": np.minimum(sums[3] / grid.pitch_mm**2, 1.0),
        "site_slip": np.divide(sums[4], sums[3], out=np.zeros(cells), where=touched),
    }


def _actual(scene: Scene) -> Table:
    """Return the plain numbers of a sensor as it was made."""
    parts: dict[str, Part | None] = {
        "material": scene.material, "camera": scene.camera, "light": scene.light, "ccd": scene.ccd.spelt_out(),
    }  # fmt: skip
    bare = {"source", "assumed"}
    table: Table = {k: p.model_dump(mode="json", exclude=bare) for k, p in parts.items() if p is not None}
    table["markers"] = {k: layer.model_dump(mode="json", exclude=bare) for k, layer in scene.markers.items()}
    return table
