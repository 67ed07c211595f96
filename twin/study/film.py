"""A press's path as an animated picture: what the camera sees from rest to the end of every step."""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path

from twin.arrays import Picture
from twin.errors import ContactError, InputError, RecipeError
from twin.parts.press import Press, Step, Triple
from twin.study.sensor import Sensor

PARTS = 8
"""Frames of a step."""

FRAME_MS, LAST_MS = 120, 1200
KINDS = {".gif": "GIF", ".png": "PNG"}
"""GIF, or animated PNG, which keeps every colour."""


def in_parts(press: Press, parts: int = PARTS) -> Press:
    """Return the same press with every step of its path, and of further probes', taken in equal parts.

    Forces and torques grow from those of the step before, motions and turns are shared out; a component that was held
    by motion before takes its force at once. The states at the ends of the steps stay what they are: friction's history
    is followed in parts anyway. An oblique press is left as it is, as its forces and motions mix.
    """
    if press.direction is not None:
        return press
    before, steps = Step(force_n=(0.0, 0.0, 0.0), torque_nmm=(0.0, 0.0, 0.0)), []
    for last, step in pairwise((before, *press.path)):
        for share in ((part + 1) / parts for part in range(parts)):
            steps.append(
                Step(
                    force_n=_grown(last.force_n, step.force_n, share),
                    torque_nmm=_grown(last.torques_nmm, step.torques_nmm, share),
                    move_mm=_shared(step.move_mm, parts),
                    turn_deg=_shared(step.turns_deg, parts),
                )
            )
    also = tuple(in_parts(other, parts) for other in press.also)
    told = {"steps": tuple(steps), "force_n": None, "indentation_mm": None, "also": also}
    return Press.model_validate(press.model_copy(update=told).model_dump())


def _grown(last: Triple, now: Triple, share: float) -> Triple:
    x, y, z = (b if a is None or b is None else a + share * (b - a) for a, b in zip(last, now, strict=True))
    return x, y, z


def _shared(now: Triple, parts: int) -> Triple:
    x, y, z = (None if value is None else value / parts for value in now)
    return x, y, z


def film_of(sensor: Sensor) -> list[Picture]:
    """Return the CCD pictures from rest along the path of the scene's press, each with noise of its own.

    Raises
    ------
    RecipeError
        The scene has no camera or no press.
    ContactError
        The path can't be taken to its end.
    """
    scene = sensor.nominal
    for table, there in (("camera", scene.camera), ("press", scene.press)):
        if there is None:
            raise RecipeError(f"this scene has no [{table}] table, so there is no film of its press")
    assert scene.press is not None
    if sensor.progress is not None:
        sensor.progress("contact", 0.1)
    state = sensor.press(in_parts(scene.press))
    if not state.complete:
        raise ContactError(f"press: {state.reason}")
    pictures = [sensor.picture(None)]
    for number, one in enumerate(state.path, start=1):
        if sensor.progress is not None:
            sensor.progress("pictures", 0.3 + 0.7 * number / len(state.path))
        pictures.append(sensor.picture(sensor.motion(one.load), number))
    return pictures


def write_film(sensor: Sensor, out: Path) -> str:
    """Write a scene's film as one animated picture and return a line about it.

    Raises
    ------
    InputError
        The file's name ends in neither .gif nor .png.
    """
    from PIL import Image

    from twin.results import write_whole

    kind = KINDS.get(out.suffix.lower())
    if kind is None:
        raise InputError(f"--out {out}: a film ends in {' or '.join(KINDS)}")
    frames = [Image.fromarray(picture) for picture in film_of(sensor)]
    times = [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    file = io.BytesIO()
    frames[0].save(file, kind, save_all=True, append_images=frames[1:], duration=times, loop=0)
    write_whole(out, lambda f: f.write(file.getvalue()))
    return f"written to {out}: {len(frames)} pictures"
