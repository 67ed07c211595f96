"""What a press left under its probes, for the report: plain arrays, beside the closed form where there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from twin.parts.load import Rectangles
from twin.parts.press import Press, Sphere, frame_of
from twin.parts.probe import Cylinder
from twin.parts.scene import Scene
from twin.results import Touch
from twin.theory.contact import hertz, punch_pressure

if TYPE_CHECKING:
    from twin.world.contact.contact import ContactState

_POINTS = 80


def touches(scene: Scene, press: Press, state: ContactState) -> tuple[Touch, ...]:
    """Return what is under each probe that touches the body."""
    found = []
    terms = iter(state.load.terms)
    for one, own in zip((press, *press.also), (state, *state.also), strict=True):
        if not len(own.pressure_mpa):
            continue
        term = next(terms)
        assert isinstance(term, Rectangles)
        found.append(_touch(scene, one, own, term))
    return tuple(found)


def _touch(scene: Scene, press: Press, state: ContactState, patches: Rectangles) -> Touch:
    middle = np.average(patches.centre_mm, axis=0, weights=state.pressure_mpa)
    inward = patches.frames[np.argmin(np.linalg.norm(patches.centre_mm - middle, axis=1)), 2]
    axes = frame_of(tuple(inward))
    expected, name = np.zeros((0, 2)), ""
    if scene.body.is_flat and state.pressure_mpa.any():
        push = float(patches.force_n.sum(axis=0) @ inward)
        rubber = scene.material.youngs_modulus_mpa, scene.material.poisson_ratio
        probe = press.probe
        if isinstance(probe, Sphere):
            theory = hertz(
                radius_mm=probe.diameter_mm / 2, youngs_modulus_mpa=rubber[0], poisson_ratio=rubber[1], force_n=push
            )
            distance = np.linspace(0.0, 1.2 * theory.contact_radius_mm, _POINTS)
            expected, name = np.column_stack([distance, theory.pressure(distance)]), "Hertz"
        elif isinstance(probe, Cylinder) and probe.edge_mm == 0.0 and not any(press.tilt_deg):
            distance = np.linspace(0.0, 0.995 * probe.diameter_mm / 2, _POINTS)
            pressure = punch_pressure(distance, probe.diameter_mm / 2, push)
            expected, name = np.column_stack([distance, pressure]), "flat punch on a half-space"
    return Touch(
        probe=press.probe.kind,
        place_mm=(patches.centre_mm - middle) @ axes[:2].T,
        half_mm=np.array(patches.half_mm),
        pressure_mpa=np.array(state.pressure_mpa),
        shear_mpa=np.array(state.traction_mpa @ axes[:2].T),
        slip=np.array(state.slip),
        friction=state.friction,
        expected=expected,
        expected_name=name,
    )
