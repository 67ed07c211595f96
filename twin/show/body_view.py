"""The deformed body in 3D: as a page that turns in any browser, or in a window.

`BodyView.page` is the page of ``twin view``, `BodyView.hand_page` that of ``twin run --live``, in
which the probe is moved by hand. Both draw on a plain canvas, far triangles first, and load nothing
from elsewhere. `BodyView.show` opens a window; `BodyView.require_window` tests for display and
OpenGL in a child process, because a broken OpenGL ends the process that calls it.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points
from twin.errors import MissingCapability
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
    def require_window() -> None:
        """Raise `MissingCapability` without a display, or an OpenGL that draws."""
        instead = "without --window a page is written that turns in any browser"
        if sys.platform == "linux" and not os.environ.get("DISPLAY"):
            raise MissingCapability(
                f"--window needs a display (the environment variable DISPLAY is not set): {instead}"
            )
        try:
            wanted = (
                [X11] if sys.platform == "linux" else []
            )  # else a picture without a window is drawn, if a display fails
            tried = subprocess.run(
                [sys.executable, "-c", TRIAL, *wanted], capture_output=True, timeout=TRIAL_S
            )
        except subprocess.TimeoutExpired:
            raise MissingCapability(
                f"--window: OpenGL does not answer within {TRIAL_S:g} s: {instead}"
            ) from None
        if tried.returncode:
            raise MissingCapability(
                "--window needs a display that works and OpenGL, which does not draw here (on "
                f"Debian: apt install libgl1 libglx-mesa0): {instead}"
            )

    def show(self, picture: Path | None = None) -> None:
        """Show a body until its window is closed, or draw its last step to a file ``picture``."""
        import pyvista

        plotter: Any = pyvista.Plotter(
            off_screen=picture is not None, title=self.title, window_size=[1100, 800]
        )
        step = len(self.frames) - 1
        times = 1.0

        # The two sliders redraw the body at another step, or at another magnification.
        def to_step(value: float) -> None:
            nonlocal step
            step = round(value)
            _draw(plotter, pyvista, self, self.frames[step], times)

        def to_times(value: float) -> None:
            nonlocal times
            times = value
            _draw(plotter, pyvista, self, self.frames[step], times)

        # Look from the side of the base, and from below the sensing surface.
        to_step(step)
        middle, zoom = _home(self)
        plotter.view_vector((0.5, -1.0, -0.7), viewup=(0, 0, -1))
        plotter.set_focus(middle)
        plotter.camera.zoom(zoom)
        if picture is not None:
            plotter.screenshot(picture)
            plotter.close()
            return
        if len(self.frames) > 1:
            plotter.add_slider_widget(
                to_step,
                [0, len(self.frames) - 1],
                value=step,
                title="step",
                fmt="%.0f",
                pointa=(0.05, 0.08),
                pointb=(0.40, 0.08),
            )
        plotter.add_slider_widget(
            to_times,
            [0.0, MOST_TIMES],
            value=times,
            title="displacement, times",
            fmt="%.1f",
            pointa=(0.60, 0.08),
            pointb=(0.95, 0.08),
        )
        plotter.show()

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


STICKS = COLOURS["blue"]
SLIPS = "#e58a1f"
TRACTION = "#1a7f4b"
BODY = "#9aa4ae"
MOST_TIMES = 20.0
"""How many times larger than they are displacements can be shown."""

ARROW = 0.12
"""Length of the largest traction's arrow over the size of what is seen."""

TRIAL_S = 60.0
TRIAL = """
import sys
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderWindow
window = vtkRenderWindow()
window.SetShowWindow(False)
window.Render()
sys.exit(sys.argv[1:] not in ([], [window.GetClassName()]))
"""
"""Ends with 0 if OpenGL draws, by the kind of window that is named, if one is."""

X11 = "vtkXOpenGLRenderWindow"


def _draw(plotter: Any, pyvista: Any, view: BodyView, frame: BodyView.Frame, times: float) -> None:
    """Put a state into the window, in place of the one before."""
    triangles = np.insert(view.triangle, 0, 3, axis=1).ravel()
    body = pyvista.PolyData(view.corner_mm + times * frame.displacement_mm, triangles)
    plotter.add_mesh(body, color=BODY, opacity=0.35, name="body", reset_camera=False)
    moved = view.marker_mm + times * frame.marker_displacement_mm
    for name, radius in view.layer_radius_mm.items():
        balls = pyvista.PolyData(moved[view.marker_layer == name]).glyph(
            geom=pyvista.Sphere(radius=radius, theta_resolution=12, phi_resolution=8),
            scale=False,
            orient=False,
        )
        plotter.add_mesh(
            balls, color=COLOURS.get(name, OTHER), name=f"layer {name}", reset_camera=False
        )
    for name in ("sticks", "slips", "traction"):
        plotter.remove_actor(name, reset_camera=False)
    corners = frame.patch_mm + times * frame.patch_displacement_mm[:, None]
    for name, chosen, colour in (("sticks", ~frame.slip, STICKS), ("slips", frame.slip, SLIPS)):
        if chosen.any():
            squares = np.insert(
                np.arange(4 * int(chosen.sum())).reshape(-1, 4), 0, 4, axis=1
            ).ravel()
            patches = pyvista.PolyData(corners[chosen].reshape(-1, 3), squares)
            plotter.add_mesh(patches, color=colour, name=name, reset_camera=False)
    largest = float(np.linalg.norm(frame.traction_mpa, axis=1).max(initial=0.0))
    if largest > 0:
        length = ARROW * float(np.ptp(view.corner_mm, axis=0).max()) / (_home(view)[1] * largest)
        arrows = pyvista.PolyData(corners.mean(axis=1))
        arrows["traction"] = frame.traction_mpa
        arrows = arrows.glyph(orient="traction", scale="traction", factor=length)
        plotter.add_mesh(arrows, color=TRACTION, name="traction", reset_camera=False)
    keys = "blue patches stick, orange slip; arrows: traction on the body"
    plotter.add_text(f"{frame.said}\n{keys if len(frame.slip) else ''}", font_size=9, name="said")
