"""A body under load as one page that turns in the browser: no server, nothing fetched, no OpenGL.

The page draws on a plain canvas, far triangles first, so that it works wherever a browser does.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.show.page import DARK, LIGHT

COLOURS = {"red": "#d0342c", "blue": "#2563c9"}
OTHER = "#6a737c"


@dataclass(frozen=True, kw_only=True)
class BodyFrame:
    """One state of the body.

    Attributes
    ----------
    name, said
        Label of the step and a sentence about it.
    displacement_mm
        (v, 3) of the surface's corners, mm.
    marker_displacement_mm
        (n, 3) of the markers, mm.
    patch_mm, patch_displacement_mm
        (k, 4, 3) corners of the patches in contact at rest and (k, 3) how they moved, mm.
    traction_mpa
        (k, 3) tractions on them.
    slip
        (k,) whether each slips on the probe.
    """

    name: str
    said: str
    displacement_mm: Points
    marker_displacement_mm: Points
    patch_mm: Floats
    patch_displacement_mm: Points
    traction_mpa: Floats
    slip: Bools


@dataclass(frozen=True, kw_only=True)
class BodyView:
    """A body, its markers and its states.

    Attributes
    ----------
    title
        What it is.
    corner_mm, triangle
        (v, 3) corners and (t, 3) outward triangles of the surface at rest.
    marker_mm, marker_layer, layer_radius_mm
        (n, 3) markers, (n,) their layers' names, and radius of a marker by layer.
    frames
        The states, in order; at least one.
    """

    title: str
    corner_mm: Points
    triangle: Ints
    marker_mm: Points
    marker_layer: np.ndarray
    layer_radius_mm: dict[str, float]
    frames: tuple[BodyFrame, ...]


def body_page(view: BodyView) -> str:
    """Return the page."""
    names = list(view.layer_radius_mm)
    middle, zoom = home(view)
    data = {
        "middle": middle,
        "zoom": zoom,
        "corner": _packed(view.corner_mm, "<f4"),
        "triangle": _packed(view.triangle, "<i4"),
        "marker": _packed(view.marker_mm, "<f4"),
        "layer": _packed(np.array([names.index(str(name)) for name in view.marker_layer], int), "<i4"),
        "layers": [{"colour": COLOURS.get(name, OTHER), "radius": view.layer_radius_mm[name]} for name in names],
        "frames": [_frame(frame) for frame in view.frames],
    }
    text = Template(Path(__file__).with_suffix(".html").read_text(encoding="utf-8"))
    return text.substitute(
        title=escape(view.title), light=LIGHT, dark=DARK, data=json.dumps(data).replace("<", "\\u003c")
    )


def home(view: BodyView) -> tuple[list[float], float]:
    """Return the point to look at, mm, and how near: the whole body, or what happens where that is a small part."""
    low, high = view.corner_mm.min(axis=0), view.corner_mm.max(axis=0)
    inside = np.concatenate([view.marker_mm, *(frame.patch_mm.reshape(-1, 3) for frame in view.frames)])
    if len(inside) == 0:
        return list((low + high) / 2), 1.0
    share = float(np.linalg.norm(np.ptp(inside, axis=0)) / np.linalg.norm(high - low))
    if share > 0.5:
        return list((low + high) / 2), 1.0
    return list((inside.min(axis=0) + inside.max(axis=0)) / 2), min(0.7 / max(share, 1e-9), 3.0)


def _frame(frame: BodyFrame) -> dict[str, Any]:
    moved = np.repeat(frame.patch_displacement_mm[:, None], 4, axis=1)
    return {
        "name": frame.name,
        "said": frame.said,
        "rubs": not bool(np.all(frame.slip)),
        "corner": _packed(frame.displacement_mm, "<f4"),
        "marker": _packed(frame.marker_displacement_mm, "<f4"),
        "patch": _packed(frame.patch_mm, "<f4"),
        "patchMoved": _packed(moved, "<f4"),
        "traction": _packed(frame.traction_mpa, "<f4"),
        "slip": _packed(frame.slip, "<i4"),
    }


def _packed(array: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, kind).tobytes()).decode()
