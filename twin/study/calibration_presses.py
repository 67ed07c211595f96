"""The presses that calibrate a sensor: at every place along z, then x, then y (Sato, II C), and what is read of them.

The probe is a sphere that sticks. It is held by force along z and by small motions sideways; pictures and the readings
of a noisy load cell are all that leaves this module, as they would leave a laboratory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from twin.errors import ContactError
from twin.parts.press import Press, Sphere, Step
from twin.parts.scene import Scene
from twin.streams import Purpose, stream
from twin.study.sensor import Sensor
from twin.theory.contact import hertz

if TYPE_CHECKING:
    from twin.parts.load import Rectangles
    from twin.sense.fit_design import Presses

SHEAR_SHARE = 0.25
"""Sideways motion of a calibration press over the contact radius: well inside what sticks."""

FOOTPRINT = 0.8
"""Half side of the square that stands for a calibration contact, over the contact radius."""

FIRST_EXPOSURE = 1000
"""Calibration pictures are exposures from here on, so that they share no noise with any press."""


def press_everywhere(sensor: Sensor, places: Rectangles) -> Presses:
    """Press the made sensor in three directions at every place; return what was measured."""
    from twin.sense.fit_design import Presses
    from twin.sense.track import analyse_rest, track_frame

    scene, count = sensor.nominal, len(places)
    picture = sensor.picture(None, exposure=FIRST_EXPOSURE)
    rest = analyse_rest(picture, sensor.layout_px, method=scene.tracking.method)
    forces, shifts, spread, at_rest = [], [], [], []
    for place in range(count):
        pressed = sensor.press(calibration_press(scene, places, place))
        if not pressed.complete:
            raise ContactError(f"calibration: press {place + 1} of {count}: {pressed.reason}")
        states = pressed.path
        noise = scene.calibration.load_cell_n * stream(scene.seed, Purpose.LOAD_CELL, place).standard_normal((3, 3))
        for number, state in enumerate(states):
            picture = sensor.picture(sensor.motion(state.load), FIRST_EXPOSURE + 1 + 3 * place + number)
            found = track_frame(rest, picture)
            forces.append(state.force_n + noise[:, number])
            shifts.append(found.shift_px)
            spread.append(found.sd_px)
            at_rest.append(found.rest_px)
        if sensor.progress is not None:
            sensor.progress(f"calibrating, press {place + 1} of {count}", 0.9 * (place + 1) / count)
    return Presses(
        place=np.repeat(np.arange(count), 3), force_n=np.stack(forces), shift_px=np.stack(shifts), rest_px=at_rest[0],
        load_cell_n=scene.calibration.load_cell_n, noise_px=float(np.nanmedian(np.concatenate(spread))),
    )  # fmt: skip


def calibration_press(scene: Scene, places: Rectangles, index: int) -> Press:
    """Return the path of one calibration press: down to the wanted force, then a small motion along x, then along y.

    The sphere's axis is set off so that under load it stands over the place along the surface's normal there, whatever
    the slope: its centre is then a radius less the expected indentation away.
    """
    wanted, normal = scene.calibration, places.frames[index, 2]
    radius = wanted.press_probe_mm / 2
    contact_radius = min(hertz_radius(scene, wanted.press_force_n * float(normal[2])), radius)
    x, y = places.centre_mm[index, :2] - (radius - contact_radius**2 / radius) * normal[:2]
    shear = SHEAR_SHARE * contact_radius
    return Press(
        probe=Sphere(diameter_mm=wanted.press_probe_mm),
        at_mm=(float(x), float(y)),
        friction=np.inf,
        steps=(
            Step(force_n=(None, None, wanted.press_force_n)),
            Step(move_mm=(shear, None, None)),
            Step(move_mm=(-shear, shear, None)),
        ),
    )


def hertz_radius(scene: Scene, force_n: float) -> float:
    """Return the nominal contact radius of the calibration sphere, mm."""
    return hertz(
        radius_mm=scene.calibration.press_probe_mm / 2,
        youngs_modulus_mpa=scene.material.youngs_modulus_mpa,
        poisson_ratio=scene.material.poisson_ratio,
        force_n=force_n,
    ).contact_radius_mm
