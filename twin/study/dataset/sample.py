"""One sample, a worker's shard of them, and a sample computed again at the highest accuracy.

Every sample starts from the same state, whatever was computed before it: the solved fields that a
contact finds in memory, or how often points were used, may change last digits, so they are put
aside between samples. A worker knows the dataset by the job's files only (resolved scene, meshes,
info); it keeps the last sensor, with its factor and its renderer, for the shards that follow.

Highest accuracy means twice as many contact patches across and, in path, twice as many parts of
every step; the finest shipped mesh of the body where there is one (a standard block's table was
made on it); patches that are not gathered into point forces; and 12 x 12 rays per pixel.
"""

from __future__ import annotations

import io
import json
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, Picture
from twin.errors import ContactError, RecipeError, TwinError
from twin.files import PINNED, cache_folder, png_bytes
from twin.parts.load import Load, Rectangles
from twin.parts.part import Part, Purpose
from twin.parts.scene import Scene, Sites
from twin.parts.shape import StlFile
from twin.study.batch.draw import Table, with_values
from twin.study.batch.pool import Pool
from twin.study.dataset.columns import Column, in_cells
from twin.study.dataset.plan import MOST_STEPS, TEST_EACH, Plan
from twin.study.film import Exposures, at_frames
from twin.study.recipe import load_scene
from twin.study.sensor import Motion, Sensor

if TYPE_CHECKING:
    import pyarrow as pa

    from twin.parts.press import Press
    from twin.world.contact.contact_state import ContactState
    from twin.world.elasticity.compliance import Compliance
    from twin.world.picture.splat import Outlines

_Row = dict[str, Any]
_INTERNAL = (ArithmeticError, ValueError, LookupError, AssertionError, RuntimeError)
"""What a mistake of this program raises: it fails a sample, not the run."""

_MOST_PATCHES, _MOST_INCREMENTS = 40, 64

_BEST = 1e-4
"""Accuracy of displacements that takes the finest mesh."""

_WHOLE = 0.98
"""Share of an outline that must be seen for its centroid to be compared."""

_FINEST = 12
"""Rays per pixel and direction of the outlines that others are compared with."""


class _MadeSensor:
    """One sensor of a dataset, ready to be pressed, with the ``values`` drawn for it by dotted key.

    ``gather``: whether patches may be gathered into point forces (`Sensor.quick_motion`).
    """

    def __init__(self, plan: Plan, number: int, values: Table, *, gather: bool = True) -> None:
        self.plan = plan
        self.number = number
        self.values = values
        self.gather = gather
        self.seed = _sensor_seed(plan.scene.seed, number)
        drawn = plan.scene
        if values or plan.sensor_axes:
            drawn = with_values(plan.scene, values, plan.sensor_axes)
        self.sensor = Sensor(drawn.model_copy(update={"seed": self.seed}))

    @cached_property
    def row(self) -> _Row:
        """Its row of the sensors table."""
        sensor = self.sensor
        needs = self.plan.needs
        scene, markers = sensor.actual.scene, sensor.actual.markers
        layers = [[name, int((markers.layer == name).sum())] for name in scene.markers]
        row: _Row = {
            "sensor": self.number,
            "seed": self.seed,
            "actual": json.dumps(_actual(scene), sort_keys=True),
            "marker_layer": json.dumps(layers),
            "marker_rest_mm": markers.points,
            **self.plan.drawn_values(self.plan.sensor_axes, self.values),
        }
        if scene.camera is not None and "motion" in needs:
            row["marker_rest_px"] = sensor.project(markers.points)
        if "outlines" in needs:
            outlines = sensor.renderer.outlines(sensor.ellipsoids(None))
            row["marker_outline_rest_px"] = outlines.centroid_px
            row["marker_visible"] = outlines.visible
        if "picture" in needs:
            for group, picture in enumerate(sensor.rest_pictures):
                row[f"picture_{group}" if group else "picture"] = png_bytes(picture)
            camera, _ = scene.imaging
            f, (cx, cy) = camera.focal_px, camera.centre_px
            row["camera_matrix"] = np.array([f, 0, cx, 0, f, cy, 0, 0, 1.0])
        if "sites" in needs:
            body = sensor.nominal.body
            half_mm = self.grid.pitch_mm / 2
            cells = Rectangles.on_surface(body, self.grid.chart(), half_mm, "dataset.sites")
            row["site_mm"] = cells.centre_mm
        return row

    def motion(self, load: Load) -> Motion:
        """Return the motion of its markers under a load."""
        pictured = bool(self.plan.needs & {"picture", "outlines"})
        return self.sensor.quick_motion(load, pictured=pictured, gather=self.gather)

    @cached_property
    def compliance(self) -> Compliance:
        """Of its body, prepared for its markers."""
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
        return scene.inverse.sites


def _sensor_seed(root: int, number: int) -> int:
    """Return the seed of a sensor, from the scene's seed and its number alone."""
    sequence = np.random.SeedSequence(root, spawn_key=(int(Purpose.SENSOR), number))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def _rows_of_sample(made: _MadeSensor, sample: int, values: Table) -> list[_Row]:
    """Return the rows of a sample: one, or one per step."""
    plan = made.plan
    base: _Row = {"index": sample, "step": 0, "sensor": made.number, "status": "ok"}
    base |= plan.drawn_values(plan.press_axes, values)
    try:
        table = plan.press_table(values)
        base["press"] = json.dumps(StlFile.bare(table), sort_keys=True)
        made.compliance.forget()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the row's error estimates hold the same
            press = plan.press_of(table)
            if isinstance(press, Load):
                return [base | _truth_of(made, press, exposure=1 + sample * MOST_STEPS)]
            return [base | row for row in _rows(made, sample, press)]
    except TwinError as problem:
        error = str(problem)
    except _INTERNAL as problem:
        error = f"internal error: {type(problem).__name__}: {problem}"
    return [base | {"status": "failed", "error": error}]


def _rows(made: _MadeSensor, sample: int, press: Press) -> list[_Row]:
    plan = made.plan
    every = plan.scene.dataset.every_step
    press, ends_s = _at_rate(plan, press)
    state = _pressed(made, press)
    states = state.path if every and state.path else (state,)
    # Exposures and truth share the states' motions.
    motions = lru_cache(maxsize=8)(lambda number: made.motion(states[number].load))
    film = None if ends_s is None else Exposures(made.sensor, ends_s, motions)
    if len(states) > MOST_STEPS:
        raise RecipeError(f"press.steps: {len(states)} steps; allowed are {MOST_STEPS}")
    rows = []
    for step, one in enumerate(states):
        number = step if every else len(press.path) - 1
        row: _Row = {
            "step": number,
            "probe_move_mm": one.move_mm,
            "probe_turn_deg": one.turn_deg,
            "indentation_mm": one.indentation_mm,
            "contact_area_mm2": one.area_mm2,
            "peak_pressure_mpa": one.peak_pressure_mpa,
            "contact_residual": one.residual,
            "linearisation_error": one.validity.linearisation_error,
            "surface_slip": one.slips,
            "slip_share": one.slip_share,
            "split": "test" if sample % TEST_EACH == TEST_EACH - 1 else "train",
        }
        picture = None
        if film is not None:
            row["time_s"] = film.time_s[step + 1]
            picture = partial(film.picture, film.time_s[step + 1])
        # the error of tractions costs half as much again as the contact
        if any(column.name == "traction_error" for column in plan.columns) and one.error:
            row["traction_error"] = one.error.traction
        exposure = 1 + sample * MOST_STEPS + number
        own = partial(motions, step)
        rows.append(row | _truth_of(made, one, own, exposure, picture))
    return rows


def _at_rate(plan: Plan, press: Press) -> tuple[Press, Floats | None]:
    """Return the press in frames and their times, s, where every step is kept of a camera that
    films; else the press, and None."""
    rate = plan.scene.ccd.frames_per_second
    if rate is None or not plan.scene.dataset.every_step:
        return press, None
    return at_frames(press, rate)


def _truth_of(
    made: _MadeSensor,
    pressed: Load | ContactState,
    motion_of: Callable[[], Motion] | None = None,
    exposure: int | None = None,
    picture: Callable[[int, int], Picture] | None = None,
) -> _Row:
    """Return the columns' values under a load; pictures and outlines only with an exposure.
    ``motion_of`` computes the markers' motion; ``picture`` that of an exposure over motion, in the
    light of a frame, the load's own by default."""
    sensor = made.sensor
    needs = made.plan.needs
    state = None if isinstance(pressed, Load) else pressed
    load = pressed if isinstance(pressed, Load) else pressed.load
    groups = [sensor.rectangles(Load((term,))) for term in load.terms] or [sensor.rectangles(load)]
    patches = Rectangles.joined(groups)
    row: _Row = {
        "force_n": patches.total_force_n,
        "torque_nmm": patches.total_torque_nmm,
        "surface_mm": patches.centre_mm,
        "surface_force_n": patches.force_n,
    }
    if "sites" in needs:
        slips = [one.slip for one in (state, *state.also) if len(one.slip)] if state else None
        found = in_cells(made.grid, sensor.actual.scene.body, groups, slips)
        row |= dict(zip(("site_force_n", "site_contact", "site_slip"), found, strict=True))
    pictured = bool(needs & {"picture", "outlines"})
    if not pictured and "motion" not in needs:
        return row
    motion = made.motion(load) if motion_of is None else motion_of()
    moved, error = motion.displacement_mm, motion.error_of(state)
    row |= {"marker_displacement_mm": moved, "displacement_error": error}
    if sensor.nominal.camera is not None:
        row["marker_pressed_px"] = sensor.project(sensor.actual.markers.points + moved)
    return (
        row | _seen(made, motion, exposure, picture) if pictured and exposure is not None else row
    )


def _seen(
    made: _MadeSensor, motion: Motion, exposure: int, moving: Callable[[int, int], Picture] | None
) -> _Row:
    sensor = made.sensor
    needs = made.plan.needs
    row: _Row = {}
    outlines: Outlines | None = None
    if "picture" in needs:
        step = (exposure - 1) % MOST_STEPS
        if moving is not None:
            picture = moving(exposure, step)
        elif "outlines" in needs:
            picture, outlines = sensor.seen(motion, exposure, step)
        else:
            picture = sensor.picture(motion, exposure, step)
        row |= {"lit": step % len(sensor.renderers), "picture": png_bytes(picture)}
    if "outlines" in needs:
        outlines = outlines or sensor.renderer.outlines(sensor.ellipsoids(motion))
        row["marker_outline_pressed_px"] = outlines.centroid_px
        row["marker_visible"] = outlines.visible
    return row


def _actual(scene: Scene) -> Table:
    """Return the plain numbers of a sensor as it was made."""
    parts: dict[str, Part | None] = {
        "material": scene.material,
        "camera": scene.camera,
        "light": scene.light,
        "ccd": scene.ccd.spelt_out(),
    }
    bare = {"source", "assumed"}
    table: Table = {
        k: p.model_dump(mode="json", exclude=bare) for k, p in parts.items() if p is not None
    }
    table["markers"] = {
        k: layer.model_dump(mode="json", exclude=bare) for k, layer in scene.markers.items()
    }
    return table


@dataclass(frozen=True)
class _ShardBytes:
    """A finished shard: its files' contents, how many samples failed, and the first reason.

    There are no sensors if all of its samples are pressed on those of earlier shards.
    """

    samples: bytes
    sensors: bytes | None
    failed: int
    reason: str


class _Workshop:
    """What a process keeps of one dataset."""

    def __init__(self, folder: Path) -> None:
        info = json.loads((folder / "info.json").read_text())
        self.content: str = info["content"]
        self.plan = Plan(load_scene(folder / "scene.toml"), info["samples"])
        self._made: _MadeSensor | None = None

    def sensor(self, number: int) -> _MadeSensor:
        """Return a made sensor; the last one is kept."""
        if self._made is None or self._made.number != number:
            values = self.plan.sensor_values(range(number, number + 1))[0]
            self._made = _MadeSensor(self.plan, number, values)
        return self._made


_workshop = lru_cache(maxsize=1)(_Workshop)


@contextmanager
def _working(folder: Path) -> Iterator[_Workshop]:
    """Work on the dataset of a job's folder: with its meshes only, and with fields of its own, as
    those in the cache may have been summed by several threads."""
    shop = _workshop(folder)
    before = os.environ.get("TWIN_CACHE")
    base = cache_folder()
    os.environ["TWIN_CACHE"] = str(base if base.name == "one-thread" else base / "one-thread")
    cache_folder.cache_clear()
    try:
        with PINNED.to(folder):
            yield shop
    finally:
        if before is None:
            os.environ.pop("TWIN_CACHE", None)
        else:
            os.environ["TWIN_CACHE"] = before
        cache_folder.cache_clear()


def make_shard(folder: Path, shard: int) -> _ShardBytes:
    """Return a shard's files."""
    with _working(folder) as shop:
        plan = shop.plan
        numbers, firsts = plan.of_shard(shard), plan.sensors_of(shard)
        rows: list[_Row] = []
        sensors: dict[int, _Row] = {}
        failed, reason = 0, ""
        for sample, values in zip(numbers, plan.press_values(numbers), strict=True):
            Pool.end_if_too_long()
            number = plan.sensor_of(sample)
            try:
                made = shop.sensor(number)
                if number in firsts and number not in sensors:
                    sensors[number] = made.row
                new = _rows_of_sample(made, sample, values)
            except TwinError as problem:  # the drawn sensor itself can't be made
                seed = _sensor_seed(plan.scene.seed, number)
                sensors.setdefault(number, {"sensor": number, "seed": seed})
                row: _Row = {"index": sample, "step": 0, "sensor": number, "status": "failed"}
                row["error"] = f"sensor {number}: {problem}"
                new = [row | plan.drawn_values(plan.press_axes, values)]
            if new[0]["status"] == "failed":
                failed = failed + 1
                reason = reason or f"sample {sample}: {new[0]['error']}"
            rows += new
        words = {"twin.content": shop.content, "twin.samples": f"{numbers.start}-{numbers.stop}"}
        ours = [row for number, row in sensors.items() if number in firsts]
        return _ShardBytes(
            samples=_parquet(rows, plan.row_columns, words),
            sensors=_parquet(ours, plan.sensor_columns, words) if ours else None,
            failed=failed,
            reason=reason,
        )


def _parquet(
    rows: list[dict[str, Any]], columns: Sequence[Column], words: Mapping[str, str]
) -> bytes:
    """Return rows as a Parquet file with a line about every column; missing values are null,
    pictures are stored as they are, a few to a row group."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field(c.name, c.arrow_type(c.kind), metadata={"what": c.what}) for c in columns]
    schema = pa.schema(fields, metadata=dict(words))
    arrays = [_array([row.get(field.name) for row in rows], field.type) for field in schema]

    # names of a column's leaves: of itself, of a list, of a list of vectors
    leaves = {
        f"{column.name}{tail}": "NONE" if column.kind == "png" else "ZSTD"
        for column in columns
        for tail in ("", ".list.element", ".list.element.list.element")
    }
    file = io.BytesIO()
    pq.write_table(
        pa.Table.from_arrays(arrays, schema=schema),
        file,
        compression=leaves,
        use_dictionary=False,
        write_statistics=False,
        row_group_size=8 if any(c.kind == "png" for c in columns) else 1024,
        version="2.6",
    )
    return file.getvalue()


def _array(values: list[Any], kind: pa.DataType) -> pa.Array:
    """Return one column; lists are made without a Python object per number."""
    import pyarrow as pa

    if not pa.types.is_list(kind):
        return pa.array(values, kind)
    present = [np.ascontiguousarray(v) for v in values if v is not None]
    # A list that is missing has no start: a mask for it would load pyarrow.compute.
    ends = np.cumsum([0, *(0 if v is None else len(v) for v in values)], dtype=np.int32)
    starts = pa.array(ends, mask=np.array([*(v is None for v in values), False]))
    inner = kind.value_type
    size = inner.list_size if pa.types.is_fixed_size_list(inner) else 1
    numbers = np.concatenate([v.reshape(-1) for v in present]) if present else np.zeros(0)
    flat: Any = pa.array(numbers, inner.value_type if size > 1 else inner)
    if size > 1:
        flat = pa.FixedSizeListArray.from_arrays(flat, type=inner)
    return pa.ListArray.from_arrays(starts, flat, type=kind)


def audit_sample(folder: Path, sample: int) -> dict[str, float]:
    """Return the differences of one sample; nothing if it fails."""
    with _working(folder) as shop:
        plan = shop.plan
        values = plan.press_values(range(sample, sample + 1))[0]
        made = shop.sensor(plan.sensor_of(sample))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return _differences(made, values)
        except (TwinError, *_INTERNAL):  # that it could not be made more finely ends no run
            return {}


def _differences(made: _MadeSensor, values: Table) -> dict[str, float]:
    plan = made.plan
    finer = _finer(made)
    for each in (made, finer):
        each.compliance.forget()
    press = plan.press_of(plan.press_table(values))
    out: dict[str, float] = {}
    if isinstance(press, Load):
        load = press
        usual, best = _truth_of(made, load), _truth_of(finer, load)
    else:
        press, ends_s = _at_rate(plan, press)
        states = _pressed(made, press), _pressed(finer, press)
        if ends_s is not None:  # the hardest push: at its end a sequence touches nothing
            pushes = [float(np.linalg.norm(one.force_n)) for one in states[0].path]
            hardest = int(np.argmax(pushes))
            states = states[0].path[hardest], states[1].path[hardest]
        load = states[0].load
        usual, best = (
            _truth_of(one, state) for one, state in zip((made, finer), states, strict=True)
        )
        out["indentation"] = _relative(states[0].indentation_mm, states[1].indentation_mm)
    if "site_force_n" in usual and not plan.scene.tractions:
        out["site_force"] = _relative(usual["site_force_n"], best["site_force_n"])
    if "marker_displacement_mm" in usual and np.any(usual["marker_displacement_mm"]):
        ours, true = usual["marker_displacement_mm"], best["marker_displacement_mm"]
        largest = float(np.linalg.norm(true, axis=1).max())
        out["displacement"] = float(np.linalg.norm(ours - true, axis=1).max()) / largest
        out["estimate"] = float(usual["displacement_error"])
    if "outlines" in plan.needs:
        shapes = made.sensor.ellipsoids(made.sensor.quick_motion(load))
        one = made.sensor.renderer.outlines(shapes)
        other = made.sensor.renderer.outlines(shapes, _FINEST)
        seen = (one.visible > _WHOLE) & (other.visible > _WHOLE)
        if seen.any():
            out["outline_px"] = float(np.abs(one.centroid_px - other.centroid_px)[seen].max())
    return out


def _pressed(made: _MadeSensor, press: Press) -> ContactState:
    state = made.sensor.press(press)
    if not state.complete:
        raise ContactError(f"press: {state.reason}")
    return state


def _relative(one: Floats | float, other: Floats | float) -> float:
    return float(
        np.linalg.norm(np.subtract(one, other)) / max(float(np.linalg.norm(other)), 1e-300)
    )


def _finer(made: _MadeSensor) -> _MadeSensor:
    """Return the same sensor at the highest accuracy, of bodies that ship with one on the finest
    mesh."""
    from twin.world.mesh.sizing import WORLD, Sizing

    scene = made.plan.scene
    changes: dict[str, Any] = {
        "contact_patches": min(_MOST_PATCHES, 2 * scene.contact_patches),
        "contact_increments": min(_MOST_INCREMENTS, 2 * scene.accuracy.contact_increments),
        "surface_table": False,
    }
    finest_mesh = Sizing.of(scene.body, WORLD[-1]).mesh_file(scene.body)
    if PINNED.folder is not None and (PINNED.folder / finest_mesh).is_file():
        changes["displacement"] = _BEST
    finest = scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update=changes)})
    return _MadeSensor(Plan(finest, made.plan.samples), made.number, made.values, gather=False)
