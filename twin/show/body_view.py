"""The deformed body in 3D, as a page that turns in any browser.

`BodyView.page` is the page of ``twin view``, `BodyView.hand_page` that of ``twin run --live``, in
which the probe is moved by hand. Both draw on a plain canvas, far triangles first, and load nothing
from elsewhere.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.show.html_page import DARK, LIGHT

COLOURS = {"red": "#d0342c", "blue": "#2563c9"}
OTHER = "#6a737c"


@dataclass(frozen=True, kw_only=True)
class BodyView:
    """A body with its states in order: (v, 3) corners and (t, 3) outward triangles at rest, (n, 3)
    markers, mm, with (n,) layer names, and radii by layer. With ``picking`` a click gives the
    recipe's lines that pick a face of a body from a file."""

    @dataclass(frozen=True, kw_only=True)
    class Frame:
        """One state, mm and MPa: a label, a sentence, displacements of v corners and n markers, and
        k patches in contact: (k, 4, 3) corners at rest, (k, 3) displacements, tractions, and (k,)
        whether each slips."""

        name: str
        said: str
        displacement_mm: Points
        marker_displacement_mm: Points
        patch_mm: Floats
        patch_displacement_mm: Points
        traction_mpa: Floats
        slip: Bools

        @classmethod
        def still(cls, name: str, said: str, corners: int, markers: int) -> BodyView.Frame:
            """Return a state in which nothing moves or touches."""
            return cls(
                name=name,
                said=said,
                displacement_mm=np.zeros((corners, 3)),
                marker_displacement_mm=np.zeros((markers, 3)),
                patch_mm=np.zeros((0, 4, 3)),
                patch_displacement_mm=np.zeros((0, 3)),
                traction_mpa=np.zeros((0, 3)),
                slip=np.zeros(0, bool),
            )

    title: str
    corner_mm: Points
    triangle: Ints
    marker_mm: Points
    marker_layer: np.ndarray
    layer_radius_mm: dict[str, float]
    frames: tuple[Frame, ...]
    picking: bool = False

    def page(self) -> str:
        """Return the page of ``twin view``."""
        middle, zoom = _home(self)
        names = list(self.layer_radius_mm)
        data = {
            "middle": middle,
            "zoom": zoom,
            "corner": _packed(self.corner_mm, "<f4"),
            "triangle": _packed(self.triangle, "<i4"),
            "marker": _packed(self.marker_mm, "<f4"),
            "layer": _packed(
                np.array([names.index(str(name)) for name in self.marker_layer], int), "<i4"
            ),
            "layers": [
                {"colour": COLOURS.get(name, OTHER), "radius": self.layer_radius_mm[name]}
                for name in names
            ],
            "frames": [_frame(frame) for frame in self.frames],
            "pick": self.picking,
        }
        return _filled("body_view.html", self.title, data)

    @staticmethod
    def hand_page(facts: Mapping[str, Any]) -> str:
        """Return the live page, with what it must know once (`twin.study.live.LivePress.facts`)."""
        return _filled("hand_page.html", str(facts["title"]), facts)


def _filled(template: str, title: str, data: Mapping[str, Any]) -> str:
    text = Template(Path(__file__).with_name(template).read_text(encoding="utf-8"))
    packed = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
    return text.substitute(title=escape(title), light=LIGHT, dark=DARK, data=packed)


def _home(view: BodyView) -> tuple[list[float], float]:
    """Return the point to look at, mm, and how near: the whole body, or a small pressed part."""
    low, high = view.corner_mm.min(axis=0), view.corner_mm.max(axis=0)
    inside = np.concatenate(
        [view.marker_mm, *(frame.patch_mm.reshape(-1, 3) for frame in view.frames)]
    )
    if len(inside) == 0:
        return list((low + high) / 2), 1.0
    share = float(np.linalg.norm(np.ptp(inside, axis=0)) / np.linalg.norm(high - low))
    if share > 0.5:
        return list((low + high) / 2), 1.0
    return list((inside.min(axis=0) + inside.max(axis=0)) / 2), min(0.7 / max(share, 1e-9), 3.0)


def _frame(frame: BodyView.Frame) -> dict[str, Any]:
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
