"""The columns of a dataset: content, unit, and what has to be computed for each.

Two tables: ``samples`` (DIR/data) has a row for every sample, or for every step of it; ``sensors``
(DIR/sensors) one for every made sensor, with what all its samples share.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from twin.arrays import Bools, Floats
from twin.errors import ContactError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.parts.part import unit_of
from twin.parts.scene import Sites

if TYPE_CHECKING:
    import pyarrow as pa

Need = Literal["load", "contact", "motion", "picture", "outlines", "sites"]
Kind = Literal["integer", "number", "text", "png", "numbers", "vectors", "pixels", "flags"]
"""``numbers``, ``flags``: a list; ``vectors``: lists of (x, y, z); ``pixels``: of (column, row)."""

_SPLIT = 6
"""Pieces per direction of a patch: of its longer side, or of a cell where that is smaller."""


@dataclass(frozen=True)
class Column:
    """A column: name with its unit as suffix, kind, a line for people, and what it needs.

    With ``by_name`` it is kept only if it is named, as it costs much or is of sequences.
    """

    name: str
    kind: Kind
    what: str
    needs: frozenset[Need] = frozenset()
    by_name: bool = False

    def described(self) -> dict[str, str]:
        """Return its entry in info.json."""
        name = self.name
        unit = unit_of(self.name)
        return {"name": name, "kind": self.kind, "unit": unit, "what": self.what}

    @staticmethod
    def arrow_type(kind: Kind) -> pa.DataType:
        """Return the Arrow type of values of a kind."""
        import pyarrow as pa

        types = {
            "integer": pa.int64(),
            "number": pa.float64(),
            "text": pa.string(),
            "png": pa.binary(),
            "numbers": pa.list_(pa.float64()),
            "flags": pa.list_(pa.bool_()),
            "vectors": pa.list_(pa.list_(pa.float64(), 3)),
            "pixels": pa.list_(pa.list_(pa.float64(), 2)),
        }
        return types[kind]


def _columns(*rows: tuple[str, Kind, str, str]) -> tuple[Column, ...]:
    """Return columns of (name, kind, needs, what)."""
    return tuple(
        Column(
            name=name,
            kind=kind,
            what=what,
            needs=frozenset(needs.split()),  # type: ignore[arg-type]
            by_name=name in ("traction_error", "time_s", "slip_share", "split", "lit"),
        )
        for name, kind, needs, what in rows
    )


_PRESS = "the whole press as JSON: probe, place, path, friction; or the tractions given instead"
_INDENTED = "indentation of the probe, from first touch at its present place"
_RESIDUAL = "largest relative error of gap, sign, friction and balance"
_LINEARISED = (
    "error of linear theory over the largest displacement: the largest to expect; with another "
    "material.law the one found"
)
_SITES = "tractions summed over the cells of the sites; sums to force_n"
_MOTION_ERROR = "estimated largest error over the largest displacement; linear: load given"
_ACTUAL = "its actual material, layers and camera as JSON (the nominal ones are in meta)"
_LAYERS = "marker layers in order, as JSON: [[name, count], ...]"
_OUTLINES = "coverage centroids of the visible outlines"

ALWAYS = _columns(
    ("index", "integer", "", "number of the sample"),
    ("step", "integer", "", "step of the press's path, or frame, that this row is the end of"),
    ("sensor", "integer", "", "row of the sensors table"),
    ("status", "text", "", "ok or failed"),
    ("error", "text", "", "why it failed"),
    ("press", "text", "", _PRESS),
)

SAMPLE = _columns(
    ("force_n", "numbers", "load", "total force on the body, x, y, z"),
    ("torque_nmm", "numbers", "load", "total torque about the origin"),
    ("probe_move_mm", "numbers", "contact", "motion of the probe since first touch"),
    ("probe_turn_deg", "number", "contact", "turn of the probe about its axis"),
    ("indentation_mm", "number", "contact", _INDENTED),
    ("contact_area_mm2", "number", "contact", "area of the contact"),
    ("peak_pressure_mpa", "number", "contact", "largest pressure of a patch"),
    ("contact_residual", "number", "contact", _RESIDUAL),
    ("traction_error", "number", "contact", "estimated error of the tractions, rms over rms"),
    ("linearisation_error", "number", "contact", _LINEARISED),
    ("site_force_n", "vectors", "sites", _SITES),
    ("site_contact", "numbers", "sites", "share of each cell that is in contact"),
    ("site_slip", "numbers", "sites contact", "share of each cell's contact that slips"),
    ("time_s", "number", "contact", "time since first touch, of frames"),
    ("split", "text", "contact", "train, or test: every fifth sample, whole"),
    ("slip_share", "number", "contact", "share of the contact's area that slips: 1 slides"),
    ("surface_mm", "vectors", "load", "centres of the contact's patches"),
    ("surface_force_n", "vectors", "load", "force on each patch"),
    ("surface_slip", "flags", "contact", "whether each patch slips"),
    ("marker_displacement_mm", "vectors", "motion", "displacement of the marker centres"),
    ("displacement_error", "number", "motion", _MOTION_ERROR),
    ("marker_pressed_px", "pixels", "motion", "projected marker centres under the press"),
    ("marker_outline_pressed_px", "pixels", "outlines", _OUTLINES),
    ("marker_visible", "numbers", "outlines", "visible share of each outline, 0 to 1"),
    ("lit", "integer", "picture", "group of LEDs (light.lit) that is lit in the picture"),
    ("picture", "png", "picture", "CCD picture under the press"),
)

SENSOR = _columns(
    ("sensor", "integer", "", "number of the sensor"),
    ("seed", "integer", "", "seed of its tolerances, print and noise"),
    ("actual", "text", "", _ACTUAL),
    ("marker_layer", "text", "", _LAYERS),
    ("marker_rest_mm", "vectors", "", "marker centres at rest"),
    ("marker_rest_px", "pixels", "motion", "projected marker centres at rest"),
    ("marker_outline_rest_px", "pixels", "outlines", f"{_OUTLINES} at rest"),
    ("marker_visible", "numbers", "outlines", "visible share of each outline at rest"),
    ("camera_matrix", "numbers", "picture", "pinhole matrix in air by row: f 0 cx 0 f cy 0 0 1"),
    ("site_mm", "vectors", "sites", "sites of site_force_n"),
    ("picture", "png", "picture", "CCD picture at rest"),
)


def in_cells(
    grid: Sites, body: Body, groups: Sequence[Rectangles], slips: Sequence[Bools] | None
) -> tuple[Floats, Floats, Floats]:
    """Return (c, 3) forces, (c,) shares of cells in contact and (c,) shares of contact that slip.

    Parameters
    ----------
    grid, body
        The cells, over the body's surface.
    groups, slips
        Patches, those of similar sizes together, and which of each group slip (None: none).

    Raises
    ------
    ContactError
        The contact reaches beyond the sites.
    """
    count = np.array([grid.columns, grid.rows])
    sums = np.zeros((5, grid.columns * grid.rows))
    for number, group in enumerate(groups):
        if not len(group):
            continue
        # Cut every patch into equal pieces that are small against a cell and against the patches.
        sides = 2.0 * group.half_mm.max(axis=0)
        longest = min(grid.pitch_mm, sides.max())
        first, second = (
            (np.arange(n) + 0.5) / n * 2.0 - 1.0
            for n in (math.ceil(_SPLIT * side / longest - 1e-9) for side in sides)
        )
        square = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
        # Place the pieces in the chart of the sensing surface.
        half = group.half_mm[:, :, None] * group.frames[:, :2]
        area = 4.0 * group.half_mm.prod(axis=1)
        slip = area * slips[number] if slips is not None else np.zeros(len(area))
        values = np.column_stack([group.force_n, area, slip]) / len(square)
        if body.is_flat:
            places = body.chart_of(group.centre_mm)[:, None] + square @ half[:, :, :2]
        else:  # the pieces of a plane patch are places of their own on the surface
            points = group.centre_mm[:, None] + square @ half
            places = body.chart_of(points.reshape(-1, 3))
        cells = places.reshape(-1, 2) / grid.pitch_mm + count / 2.0
        over = float(np.maximum(-cells, cells - count).max()) * grid.pitch_mm
        if over > 1e-6:
            raise ContactError(
                f"contact: it reaches {over:.3g} mm beyond the sites; enlarge [dataset.sites] or "
                "press further inside"
            )
        # Sum force, area and slipping area by cell.
        column, row = np.clip(np.floor(cells).astype(np.int64), 0, count - 1).T
        for total, value in zip(sums, values.T, strict=True):
            weights = np.repeat(value, len(square))
            total += np.bincount(column * grid.rows + row, weights, sums.shape[1])
    touched = sums[3]
    slipping = np.divide(sums[4], touched, out=np.zeros_like(touched), where=touched > 0.0)
    return sums[:3].T.copy(), np.minimum(touched / grid.pitch_mm**2, 1.0), slipping
