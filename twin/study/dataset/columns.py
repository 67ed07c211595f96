"""The columns of a dataset: what each holds, in which unit, and what has to be computed for it.

Two tables: ``samples`` (DIR/data) has a row for every sample, or for every step of it; ``sensors`` (DIR/sensors) one
for every made sensor, with what all its samples share.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from twin.errors import RecipeError, did_you_mean
from twin.parts.scene import Scene
from twin.parts.vary import Choice, Distribution, ForceCone, Normal, Uniform
from twin.study.dataset.portable import bare

if TYPE_CHECKING:
    import pyarrow as pa

Need = Literal["load", "contact", "motion", "picture", "outlines", "sites"]
Kind = Literal["integer", "number", "text", "flag", "png", "numbers", "vectors", "pixels", "flags"]


@dataclass(frozen=True)
class Column:
    """A column.

    Attributes
    ----------
    name
        With its unit as suffix, where it has one.
    kind
        ``numbers``, ``flags``: a list; ``vectors``: a list of (x, y, z); ``pixels``: a list of (column, row).
    what
        One line for people.
    needs
        What has to be computed for it.
    by_name
        Whether it is kept only if it is asked for by name, as it costs much.
    """

    name: str
    kind: Kind
    what: str
    needs: frozenset[Need] = frozenset()
    by_name: bool = False


def _column(name: str, kind: Kind, what: str, *needs: Need) -> Column:
    return Column(name, kind, what, frozenset(needs))


ALWAYS = (
    _column("index", "integer", "number of the sample"),
    _column("step", "integer", "step of the press's path that this row is the end of, from 0"),
    _column("sensor", "integer", "row of the sensors table"),
    _column("status", "text", "ok or failed"),
    _column("error", "text", "why it failed"),
    _column("press", "text", "the whole press as JSON: probe, place, path, friction; or the tractions given instead"),
)

SAMPLE = (
    _column("force_n", "numbers", "total force on the body, x, y, z", "load"),
    _column("torque_nmm", "numbers", "total torque about the origin", "load"),
    _column("probe_move_mm", "numbers", "motion of the probe since first touch", "contact"),
    _column("probe_turn_deg", "number", "turn of the probe about its axis", "contact"),
    _column("indentation_mm", "number", "how far the probe is in, from first touch at its present place", "contact"),
    _column("contact_area_mm2", "number", "area of the contact", "contact"),
    _column("peak_pressure_mpa", "number", "largest pressure of a patch", "contact"),
    _column("contact_residual", "number", "largest relative error of gap, sign, friction and balance", "contact"),
    replace(
        _column("traction_error", "number", "change of tractions with patches twice as wide, rms over rms", "contact"),
        by_name=True,  # half as much again as the contact itself
    ),
    _column("linearisation_error", "number", "what linear theory may cost, over the largest displacement", "contact"),
    _column("site_force_n", "vectors", "tractions summed over the cells of the sites; sums to force_n", "sites"),
    _column("site_contact", "numbers", "share of each cell that is in contact", "sites"),
    _column("site_slip", "numbers", "share of each cell's contact that slips", "sites", "contact"),
    _column("surface_mm", "vectors", "centres of the contact's patches", "load"),
    _column("surface_force_n", "vectors", "force on each patch", "load"),
    _column("surface_slip", "flags", "whether each patch slips", "contact"),
    _column("marker_displacement_mm", "vectors", "displacement of the marker centres", "motion"),
    _column(
        "displacement_error",
        "number",
        "estimated largest error over the largest displacement, tractions given",
        "motion",
    ),
    _column("marker_pressed_px", "pixels", "projected marker centres under the press", "motion"),
    _column("marker_outline_pressed_px", "pixels", "coverage centroids of the visible outlines", "outlines"),
    _column("marker_visible", "numbers", "share of each outline that is seen, 0 to 1", "outlines"),
    _column("picture", "png", "CCD picture under the press", "picture"),
)

SENSOR = (
    _column("sensor", "integer", "number of the sensor"),
    _column("seed", "integer", "seed of its tolerances, print and noise"),
    _column("actual", "text", "its actual material, layers and camera as JSON (the nominal ones are in meta)"),
    _column("marker_layer", "text", "marker layers in order, as JSON: [[name, count], ...]"),
    _column("marker_rest_mm", "vectors", "marker centres at rest"),
    _column("marker_rest_px", "pixels", "projected marker centres at rest", "motion"),
    _column("marker_outline_rest_px", "pixels", "coverage centroids of the visible outlines at rest", "outlines"),
    _column("marker_visible", "numbers", "share of each outline that is seen at rest", "outlines"),
    _column("camera_matrix", "numbers", "pinhole matrix in air, row by row: f 0 cx 0 f cy 0 0 1", "picture"),
    _column("site_mm", "vectors", "sites of site_force_n", "sites"),
    _column("picture", "png", "CCD picture at rest", "picture"),
)


def chosen_columns(scene: Scene, names: Iterable[str]) -> tuple[Column, ...]:
    """Return the sample columns of these names, in their one order; if none is named all that the scene has.

    Those that are always there may be named too.

    Raises
    ------
    RecipeError
        A name is unknown, or the scene lacks what it needs.
    """
    asked = list(dict.fromkeys(names))
    always = {column.name for column in ALWAYS}
    wanted = [name for name in asked if name not in always]
    has: set[Need] = {"load", "motion"}
    if not scene.tractions:
        has.add("contact")
    if scene.camera is not None:
        has |= {"picture", "outlines"}
    if scene.dataset.sites is not None or scene.reconstruction is not None:
        has.add("sites")
    known = {column.name: column for column in SAMPLE}
    problems = []
    for name in wanted:
        if name not in known:
            hint = did_you_mean(name, known, f"known are {', '.join(known)}")
            problems.append(f"columns: no '{name}'; {hint}")
        elif not _available(known[name], scene, has):
            lacking = known[name].needs - has
            if "contact" in lacking:
                problems.append(f"columns: '{name}' is known of a press only, and this scene gives [[tractions]]")
                continue
            table = "[dataset.sites]" if "sites" in lacking else "[camera]"
            problems.append(f"columns: '{name}' needs a {table} table, which this scene lacks")
    if problems:
        raise RecipeError(problems)
    return tuple(c for c in SAMPLE if (c.name in wanted if asked else _available(c, scene, has) and not c.by_name))


def _available(column: Column, scene: Scene, has: set[Need]) -> bool:
    return column.needs <= has and (scene.camera is not None or column.kind != "pixels")


def sensor_columns(samples: Iterable[Column], scene: Scene) -> tuple[Column, ...]:
    """Return the columns of the sensors table that go with these sample columns."""
    needs = {need for column in samples for need in column.needs}
    return tuple(c for c in SENSOR if c.needs <= needs and (scene.camera is not None or c.kind != "pixels"))


def drawn_columns(axes: Mapping[str, Distribution]) -> tuple[Column, ...]:
    """Return a column for every key that varies: a number, numbers, or JSON for anything else."""
    return tuple(Column(_name(key), _kind(axes[key]), f"drawn {key}") for key in sorted(axes))


def drawn_values(axes: Mapping[str, Distribution], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return drawn values under the names of their columns."""
    import numpy as np

    row: dict[str, Any] = {}
    for key, value in values.items():
        kind = _kind(axes[key])
        text = json.dumps(bare(value), sort_keys=True) if kind == "text" else None
        row[_name(key)] = text or (np.array(value, float) if kind == "numbers" else float(value))
    return row


def _name(key: str) -> str:
    return f"vary_{key.replace('.', '_')}"


def _kind(axis: Distribution) -> Literal["number", "numbers", "text"]:
    if isinstance(axis, ForceCone):
        return "numbers"
    if isinstance(axis, Uniform | Normal):
        return "numbers" if isinstance(axis.low if isinstance(axis, Uniform) else axis.mean, tuple) else "number"
    if not isinstance(axis, Choice):
        return "number"
    if all(_is_number(value) for value in axis.choice):
        return "number"
    lists = all(isinstance(v, list | tuple) and all(_is_number(n) for n in v) for v in axis.choice)
    return "numbers" if lists else "text"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def schema(columns: Iterable[Column], metadata: Mapping[str, str]) -> pa.Schema:
    """Return the Arrow schema of columns, each with a line that says what it is."""
    import pyarrow as pa

    fields = [pa.field(c.name, arrow_type(c.kind), metadata={"what": c.what}) for c in columns]
    return pa.schema(fields, metadata=dict(metadata))


def arrow_type(kind: Kind) -> pa.DataType:
    """Return the Arrow type of a column's values."""
    import pyarrow as pa

    types = {
        "integer": pa.int64(), "number": pa.float64(), "text": pa.string(), "flag": pa.bool_(), "png": pa.binary(),
        "numbers": pa.list_(pa.float64()), "flags": pa.list_(pa.bool_()),
        "vectors": pa.list_(pa.list_(pa.float64(), 3)), "pixels": pa.list_(pa.list_(pa.float64(), 2)),
    }  # fmt: skip
    return types[kind]


def to_arrow(rows: list[dict[str, Any]], table_schema: pa.Schema) -> pa.Table:
    """Return rows as an Arrow table; a value that a row lacks is null."""
    import pyarrow as pa

    arrays = [_array([row.get(field.name) for row in rows], field.type) for field in table_schema]
    return pa.Table.from_arrays(arrays, schema=table_schema)


def _array(values: list[Any], kind: pa.DataType) -> pa.Array:
    """Return one column, lists without a Python object per number."""
    import numpy as np
    import pyarrow as pa

    if not pa.types.is_list(kind):
        return pa.array(values, kind)
    present = [np.ascontiguousarray(v) for v in values if v is not None]
    lengths = np.array([0 if v is None else len(v) for v in values])
    offsets = pa.array(np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32))
    inner = kind.value_type
    size = inner.list_size if pa.types.is_fixed_size_list(inner) else 1
    plain = inner.value_type if size > 1 else inner
    numbers = np.concatenate([v.reshape(-1) for v in present]) if present else np.zeros(0)
    flat: Any = pa.array(numbers, plain)
    if size > 1:
        flat = pa.FixedSizeListArray.from_arrays(flat, type=inner)
    mask = pa.array([v is None for v in values])
    return pa.ListArray.from_arrays(offsets, flat, type=kind, mask=mask)
