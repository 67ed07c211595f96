"""`twin view`: a deformed body with its markers as a page, which shows on which patches the probe
sticks or slips."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.arrays import Ints, Points
from twin.display import vector
from twin.parts.load import Rectangles
from twin.show.body_view import BodyView
from twin.study.sensor import Sensor

if TYPE_CHECKING:
    from twin.world.contact.contact_state import ContactState
    from twin.world.elasticity.coated import CoveredCompliance
    from twin.world.elasticity.compliance import Compliance

_FINE, _ROUNDS = 0.35, 6
"""Triangles near the contact are quartered until their edges are below this share of its radius, in
so many rounds."""


def body_view(sensor: Sensor) -> BodyView:
    """Return a sensor's body under its scene's press, a frame for every step of the path.

    The surface and its motion are those of the coarsest mesh (half a per cent, which no eye sees),
    with smaller triangles where it is pressed; markers move with the asked accuracy.
    """
    scene = sensor.nominal
    states = _states(sensor)
    corners, triangles = _surface(sensor, states)
    markers = sensor.actual.markers
    return BodyView(
        title=scene.title or "Tactile sensor",
        corner_mm=corners,
        triangle=triangles,
        marker_mm=markers.points,
        marker_layer=markers.layer,
        layer_radius_mm={name: layer.diameter_mm / 2 for name, layer in scene.markers.items()},
        frames=tuple(_frame(sensor, corners, number, state) for number, state in enumerate(states)),
        picking=scene.body.own_surface is not None,
    )


def surface_view(file: Path) -> BodyView:
    """Return a closed STL file as it is, on whose page faces are picked as a body's regions.

    Raises
    ------
    InputError
        The file can't be read, or its surface isn't closed.
    """
    from twin.geometry.closed import Surface

    surface = Surface.read(str(file))
    extent = " x ".join(f"{side:.4g}" for side in np.ptp(surface.vertices, axis=0))
    said = (
        f"{extent} mm along x, y and z; -z is up. Click a face (a curved one in its middle), or "
        "turn it to the middle and press Enter: what picks it in a recipe is printed here."
    )
    return BodyView(
        title=file.name,
        corner_mm=surface.vertices,
        triangle=surface.triangles,
        marker_mm=np.zeros((0, 3)),
        marker_layer=np.zeros(0, str),
        layer_radius_mm={},
        frames=(BodyView.Frame.still("as in the file", said, len(surface.vertices), 0),),
        picking=True,
    )


def _states(sensor: Sensor) -> list[ContactState | None]:
    """Return None for the rest state and then the states at the end of every step."""
    if sensor.nominal.press is None:
        return [None]
    state = sensor.press()
    return [None, *(state.path or (state,))]


def _surface(sensor: Sensor, states: list[ContactState | None]) -> tuple[Points, Ints]:
    from trimesh.remesh import subdivide

    from twin.world.mesh.body_mesh import body_mesh

    body = sensor.actual.scene.body
    mesh = body_mesh(body, "sketch", progress=sensor.progress)
    # Each quadratic face as four plane triangles, corners numbered among those used.
    faces = mesh.faces
    triangles = np.concatenate(
        [faces[:, [0, 3, 5]], faces[:, [3, 1, 4]], faces[:, [5, 4, 2]], faces[:, [3, 4, 5]]]
    )
    used, numbers = np.unique(triangles, return_inverse=True)
    points = np.array(mesh.points[used])
    triangles = numbers.reshape(-1, 3)
    # Refine near the contacts: triangles about as large as a part of the contact's radius.
    pressed = [
        (np.average(patches.centre_mm, axis=0), one.contact_radius_mm)
        for state in states
        if state is not None
        for patches, one in _under_each(state)
    ]
    for _ in range(_ROUNDS):
        edges = points[triangles] - points[np.roll(triangles, 1, axis=1)]
        longest = np.linalg.norm(edges, axis=2).max(axis=1)
        middle = points[triangles].mean(axis=1)
        coarse = np.zeros(len(triangles), bool)
        for centre, radius in pressed:
            away = np.maximum(np.linalg.norm(middle - centre, axis=1) - 1.2 * radius, 0.0)
            coarse |= longest > _FINE * radius + 0.5 * away
        # cut in four; their neighbours stay whole, which a picture doesn't show
        points, triangles = subdivide(points, triangles, np.flatnonzero(coarse))
    return points, triangles


def _under_each(state: ContactState) -> list[tuple[Rectangles, ContactState]]:
    """Return the patches under every probe that touches, and its state."""
    touching = [one for one in (state, *state.also) if len(one.pressure_mpa)]
    patches = [term for term in state.load.terms if isinstance(term, Rectangles)]
    return list(zip(patches, touching, strict=True))


def _frame(
    sensor: Sensor, corners: Points, number: int, state: ContactState | None
) -> BodyView.Frame:
    markers = sensor.actual.markers.points
    rest = BodyView.Frame.still("rest", "At rest.", len(corners), len(markers))
    if state is None:
        return rest
    if not state.load.moving.terms:
        return replace(rest, name=str(number), said="The probe has left the body.")
    patches = sensor.rectangles(state.load)
    touching = [one for _, one in _under_each(state)] or [state]
    points = np.concatenate([_inside(sensor, corners), patches.centre_mm])
    surface = _drawn(sensor).displacement(points, sensor.rectangles(state.load.moving))
    if state.load.strained is not None:
        surface = surface + state.load.strained.displacement(points)
    return replace(
        rest,
        name=str(number),
        said=f"Step {number}: " + "; ".join(_said(one) for one in touching) + ".",
        displacement_mm=surface[: len(corners)],
        marker_displacement_mm=sensor.motion(state.load).displacement_mm,
        patch_mm=patches.corner_mm,
        patch_displacement_mm=surface[len(corners) :],
        traction_mpa=np.concatenate([one.traction_mpa for one in touching]),
        slip=np.concatenate([one.slip for one in touching]),
    )


def _said(state: ContactState) -> str:
    """Return what is under one probe."""
    slips = "no friction"
    if state.friction:
        slips = f"{100 * np.mean(state.slip):.0f} % of the contact slips"
    return (
        f"force {vector(state.force_n, 'N')}, indentation {state.indentation_mm:.3g} mm, "
        f"contact radius {state.contact_radius_mm:.3g} mm, largest pressure "
        f"{state.peak_pressure_mpa:.3g} MPa, {slips}"
    )


def _drawn(sensor: Sensor) -> Compliance | CoveredCompliance:
    """Return the compliance that moves the surface."""
    from twin.world.elasticity.compliance import Compliance

    scene = sensor.actual.scene
    if not isinstance(sensor.compliance, Compliance):
        return sensor.compliance
    return Compliance(
        scene.body, scene.material, level="sketch", table=False, progress=sensor.progress
    )


def _inside(sensor: Sensor, points: Points) -> Points:
    """Move points that the facets of a round body leave outside onto its boundary."""
    body = sensor.actual.scene.body
    for _ in range(3):
        distance = body.piece_distances(points)
        worst = distance.argmin(axis=1)
        short = np.minimum(distance[np.arange(len(points)), worst], 0.0)
        points = points - short[:, None] * body.piece_normals(points)[np.arange(len(points)), worst]
    return points
