"""One sample: from its number to a row of truth, doing only what its columns need.

Every sample starts from the same state, whatever was computed before it: which solved fields a contact finds in memory,
or how often points were asked about, may change last digits, so that is put aside between samples.
"""

from __future__ import annotations

import json
import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Bools
from twin.errors import ContactError, RecipeError, TwinError
from twin.parts.load import Load
from twin.parts.part import Part
from twin.parts.pipeline import Sites
from twin.parts.scene import Scene
from twin.streams import Purpose
from twin.study.batch.draw import Table, with_values
from twin.study.dataset.columns import drawn_values
from twin.study.dataset.plan import MOST_STEPS, Plan, load_of, press_of
from twin.study.dataset.portable import bare
from twin.study.motion import Motion
from twin.study.sensor import Sensor
from twin.study.sites import on_grid

if TYPE_CHECKING:
    from twin.parts.load import Rectangles
    from twin.parts.press import Press
    from twin.world.contact.contact_state import ContactState
    from twin.world.elasticity.compliance import Compliance
    from twin.world.picture.render import Outlines, Renderer

Row = dict[str, Any]

INTERNAL = (ArithmeticError, ValueError, LookupError, AssertionError, RuntimeError)
"""What a mistake of this program's raises: it fails a sample, not the run."""


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
    gather
        Whether patches may be gathered into point forces: see `Sensor.motion_of_patches`.
    """

    def __init__(self, plan: Plan, number: int, values: Table, *, gather: bool = True) -> None:
        self.plan, self.number, self.values, self.gather = plan, number, values, gather
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
    def compliance(self) -> Compliance:
        """Of its body, which knows its markers."""
        from twin.world.elasticity.compliance import Compliance

        found = self.sensor.compliance
        assert isinstance(found, Compliance), "a cover of its own modulus was refused"
        found.keep(self.sensor.actual.markers.points)
        return found

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
        from twin.world.picture.render import one_thread

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
        base["press"] = json.dumps(bare(table), sort_keys=True)
        made.compliance.forget()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what warnings say is in the row's error estimates
            if plan.scene.tractions:
                return [base | truth_of(made, load_of(table), exposure=1 + sample * MOST_STEPS)]
            return [base | row for row in _rows(made, sample, press_of(table))]
    except TwinError as problem:
        told = str(problem)
    except INTERNAL as problem:
        told = f"internal error: {type(problem).__name__}: {problem}"
    return [base | {"status": "failed", "error": told}]


def failed_row(plan: Plan, sample: int, values: Table, why: str) -> Row:
    """Return the row of a sample that could not be made."""
    base: Row = {"index": sample, "step": 0, "sensor": plan.sensor_of(sample), "status": "failed", "error": why}
    return base | drawn_values(plan.press_axes, values)


def _rows(made: MadeSensor, sample: int, press: Press) -> list[Row]:
    plan, sensor = made.plan, made.sensor
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
        exposure = 1 + sample * MOST_STEPS + number
        rows.append({"step": number} | _contact(one) | truth_of(made, one.load, slips_of(one), exposure))
    return rows


def slips_of(state: ContactState) -> list[Bools]:
    """Return whether each patch of every term of a load slips on its probe."""
    return [one.slip for one in (state, *state.also) if len(one.slip)]


def _contact(state: ContactState) -> Row:
    """Return what is known of a press only."""
    return {
        "probe_move_mm": state.move_mm,
        "probe_turn_deg": state.turn_deg,
        "indentation_mm": state.indentation_mm,
        "contact_area_mm2": state.area_mm2,
        "peak_pressure_mpa": state.peak_pressure_mpa,
        "contact_residual": state.residual,
        "traction_error": state.error.traction if state.error is not None else None,
        "linearisation_error": state.validity.linearisation_error,
        "surface_slip": np.concatenate([np.zeros(0, bool), *slips_of(state)]),
    }


def truth_of(made: MadeSensor, load: Load, slips: list[Bools] | None = None, exposure: int | None = None) -> Row:
    """Return what columns are made of under a load; without an exposure what is seen is left out.

    ``slips`` says which patches of each of the load's terms slip; None for tractions without a probe.
    """
    from twin.world.elasticity.tile import join

    sensor, needs = made.sensor, made.plan.needs
    groups = [sensor.rectangles(Load((term,))) for term in load.terms] or [sensor.rectangles(load)]
    patches = join(groups)
    moment = patches.centre_mm.T @ patches.force_n
    row: Row = {
        "force_n": patches.force_n.sum(axis=0),
        "torque_nmm": np.array([moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]]),
        "surface_mm": patches.centre_mm,
        "surface_force_n": patches.force_n,
    }
    if "sites" in needs:
        from twin.study.dataset.cells import in_cells

        found = in_cells(made.grid, sensor.actual.scene.body, groups, slips)
        row |= dict(zip(("site_force_n", "site_contact", "site_slip"), found, strict=True))
    if not needs & {"motion", "picture", "outlines"}:
        return row
    looked_at = bool(needs & {"picture", "outlines"})
    strained = looked_at and sensor.markers_strain
    motion = sensor.motion_of_patches(*groups, strained=strained, gather=made.gather)
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


def _actual(scene: Scene) -> Table:
    """Return the plain numbers of a sensor as it was made."""
    parts: dict[str, Part | None] = {
        "material": scene.material, "camera": scene.camera, "light": scene.light, "ccd": scene.ccd.spelt_out(),
    }  # fmt: skip
    bare = {"source", "assumed"}
    table: Table = {k: p.model_dump(mode="json", exclude=bare) for k, p in parts.items() if p is not None}
    table["markers"] = {k: layer.model_dump(mode="json", exclude=bare) for k, layer in scene.markers.items()}
    return table
