"""A body under load in a window that turns: what the page of `twin.show.body` shows, drawn by OpenGL.

The window comes only where there are a display and an OpenGL that draws. Whether it does is tried in a process of its
own, as a broken one ends the process that asks it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import MissingCapability
from twin.show.body import COLOURS, OTHER, BodyFrame, BodyView, home

STICKS, SLIPS, TRACTION = COLOURS["blue"], "#e58a1f", "#1a7f4b"
BODY = "#9aa4ae"
MOST_TIMES = 20.0
"""How many times larger than they are displacements can be shown."""

ARROW = 0.12
"""Length of the largest traction's arrow over the size of what is seen."""

TRYING_S = 60.0
_TRY = """
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


def require_window() -> None:
    """Raise `MissingCapability` where no window can be opened: without a display, or an OpenGL that draws."""
    instead = "without --window a page is written that turns in any browser"
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise MissingCapability(f"--window needs a display (the environment variable DISPLAY is not set): {instead}")
    try:
        wanted = (
            [X11] if sys.platform == "linux" else []
        )  # else a picture without a window is drawn, if a display fails
        tried = subprocess.run([sys.executable, "-c", _TRY, *wanted], capture_output=True, timeout=TRYING_S)
    except subprocess.TimeoutExpired:
        raise MissingCapability(f"--window: OpenGL does not answer within {TRYING_S:g} s: {instead}") from None
    if tried.returncode:
        raise MissingCapability(
            "--window needs a display that answers and OpenGL, which does not draw here (on Debian: apt install libgl1 "
            f"libglx-mesa0): {instead}"
        )


def show_body(view: BodyView, picture: Path | None = None) -> None:
    """Show a body until its window is closed.

    Sliders choose the step of the path and how many times larger displacements are shown than they are.

    Parameters
    ----------
    view
        What is shown.
    picture
        A file to draw the last step to, without any window.
    """
    import pyvista

    plotter: Any = pyvista.Plotter(off_screen=picture is not None, title=view.title, window_size=[1100, 800])
    step, times = len(view.frames) - 1, 1.0

    def to_step(value: float) -> None:
        nonlocal step
        step = round(value)
        _draw(plotter, pyvista, view, view.frames[step], times)

    def to_times(value: float) -> None:
        nonlocal times
        times = value
        _draw(plotter, pyvista, view, view.frames[step], times)

    to_step(step)
    middle, zoom = home(view)
    plotter.view_vector((0.5, -1.0, -0.7), viewup=(0, 0, -1))
    plotter.set_focus(middle)
    plotter.camera.zoom(zoom)
    if picture is not None:
        plotter.screenshot(picture)
        plotter.close()
        return
    if len(view.frames) > 1:
        plotter.add_slider_widget(
            to_step, [0, len(view.frames) - 1], value=step, title="step", fmt="%.0f", pointa=(0.05, 0.08),
            pointb=(0.40, 0.08),
        )  # fmt: skip
    plotter.add_slider_widget(
        to_times, [0.0, MOST_TIMES], value=times, title="displacement, times", fmt="%.1f", pointa=(0.60, 0.08),
        pointb=(0.95, 0.08),
    )  # fmt: skip
    plotter.show()


def _draw(plotter: Any, pyvista: Any, view: BodyView, frame: BodyFrame, times: float) -> None:
    """Put a state into the window, in place of the one before."""
    triangles = np.insert(view.triangle, 0, 3, axis=1).ravel()
    body = pyvista.PolyData(view.corner_mm + times * frame.displacement_mm, triangles)
    plotter.add_mesh(body, color=BODY, opacity=0.35, name="body", reset_camera=False)
    moved = view.marker_mm + times * frame.marker_displacement_mm
    for name, radius in view.layer_radius_mm.items():
        balls = pyvista.PolyData(moved[view.marker_layer == name]).glyph(
            geom=pyvista.Sphere(radius=radius, theta_resolution=12, phi_resolution=8), scale=False, orient=False
        )
        plotter.add_mesh(balls, color=COLOURS.get(name, OTHER), name=f"layer {name}", reset_camera=False)
    for name in ("sticks", "slips", "traction"):
        plotter.remove_actor(name, reset_camera=False)
    corners = frame.patch_mm + times * frame.patch_displacement_mm[:, None]
    for name, chosen, colour in (("sticks", ~frame.slip, STICKS), ("slips", frame.slip, SLIPS)):
        if chosen.any():
            squares = np.insert(np.arange(4 * int(chosen.sum())).reshape(-1, 4), 0, 4, axis=1).ravel()
            patches = pyvista.PolyData(corners[chosen].reshape(-1, 3), squares)
            plotter.add_mesh(patches, color=colour, name=name, reset_camera=False)
    largest = float(np.linalg.norm(frame.traction_mpa, axis=1).max(initial=0.0))
    if largest > 0:
        length = ARROW * float(np.ptp(view.corner_mm, axis=0).max()) / (home(view)[1] * largest)
        arrows = pyvista.PolyData(corners.mean(axis=1))
        arrows["traction"] = frame.traction_mpa
        arrows = arrows.glyph(orient="traction", scale="traction", factor=length)
        plotter.add_mesh(arrows, color=TRACTION, name="traction", reset_camera=False)
    keys = "blue patches stick, orange slip; arrows: traction on the body"
    plotter.add_text(f"{frame.said}\n{keys if len(frame.slip) else ''}", font_size=9, name="said")
