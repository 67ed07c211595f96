"""Commands of a sensor's software: calibrate, and reconstruct recorded pictures."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

from cyclopts import Parameter

from twin.commands.options import Overrides, SceneName, load, scene_named
from twin.errors import InputError, SomeFailed
from twin.parts.methods import Method, WeightRule
from twin.show.terminal import LiveTable, progress

if TYPE_CHECKING:
    from twin.sense.calibration import Calibration

SHOWN = 5
"""Frames whose trouble is printed one by one; the table has all."""


def calibrate(
    folder: Annotated[
        Path | None,
        Parameter(
            help="Recording of a real sensor: rest.png, pictures, presses.csv (else the twin's)."
        ),
    ] = None,
    /,
    *,
    scene: SceneName,
    out: Annotated[Path, Parameter(help="Calibration file to write (.npz).")],
    method: Annotated[
        Literal["sato", "fitted", "compliance", "halfspace"] | None,
        Parameter(help="Default: the scene's."),
    ] = None,
    set_: Overrides = (),
) -> None:
    """Calibrate a scene's sensor, on the twin or from a recording, and write the calibration file.

    A recording is a folder with rest.png, a picture of every press, and presses.csv with the
    columns frame, x_mm, y_mm, z_mm (place on the outer surface), fx_n, fy_n, fz_n (load cell).
    Methods compliance and halfspace need rest.png only.

    Method sato presses the simulated sensor at every site in three directions, in pictures with
    noise; fitted presses five and fits the design's parameters to them.

    Examples:
    twin calibrate --scene sato_press --out sato.npz
    twin calibrate recording --scene kamiyama_pillar --method fitted --out mine.npz
    """
    from twin.study.calibrate import calibrate_to_file

    loaded = load(scene, (*set_, f"calibration.method={method}") if method else set_)
    with scene_named(scene):
        print(calibrate_to_file(loaded, out, progress(), folder))


def reconstruct(
    rest: Annotated[Path, Parameter(help="Picture without load: PNG, BMP or JPEG.")],
    frames: Annotated[
        tuple[str, ...],
        Parameter(
            help="Pictures, folders of them, videos; or - for raw frames from stdin.",
            allow_leading_hyphen=True,
            negative_iterable="",
        ),
    ],
    /,
    *,
    calibration: Annotated[Path, Parameter(help="Calibration file (see: twin calibrate).")],
    out: Annotated[
        Path | None, Parameter(help="Table to write: .parquet, .csv (totals only) or .npz.")
    ] = None,
    overlay: Annotated[
        Path | None,
        Parameter(
            help="Draw the motion into the frames: a .png, a folder of them, or a video (.mp4)."
        ),
    ] = None,
    size: Annotated[str | None, Parameter(help="Size of raw frames: 640x480.")] = None,
    format: Annotated[str | None, Parameter(help="Format of raw frames: rgb24 or gray8.")] = None,
    method: Annotated[
        Method, Parameter(help="How it is solved; local: forces only where some are found.")
    ] = "smooth",
    weight: Annotated[
        str, Parameter(help="The papers' omega, px2/N2, or auto, likelihood, gcv.")
    ] = "auto",
    push_only: Annotated[bool, Parameter(help="No site pulls.", negative="")] = False,
    friction: Annotated[
        float | None, Parameter(help="Friction coefficient that bounds every site's force.")
    ] = None,
    robust: Annotated[bool, Parameter(help="Leave wrong vectors out.", negative="")] = False,
    camera: Annotated[
        bool, Parameter(help="Follow the camera's bend (needed for large motion).", negative="")
    ] = False,
) -> None:
    """Track the markers of recorded frames and reconstruct the forces.

    Every frame is one row: total force and torque with standard deviations, centre of pressure,
    markers found, the shift that all markers share (a bumped camera), and in .parquet and .npz the
    force at every site. A frame that fails is a row with its reason, and the sequence goes on (exit
    code 3). Standard deviations are of the noise alone: errors of the calibration, such as of the
    rubber's modulus, come on top.

    Examples:
    twin reconstruct rest.png press*.png --calibration flat.npz --out forces.parquet
    twin reconstruct rest.png film.mp4 --calibration flat.npz --overlay drawn.mp4
    ... | twin reconstruct rest.png - --size 640x480 --format rgb24 --calibration flat.npz
    """
    from twin.sense.calibration import read_calibration
    from twin.sense.reconstruct import check_options
    from twin.study import recorded

    recorded.check_sources(frames, overlay, size, format)
    _keep_inputs((rest, calibration, *map(Path, frames)), out=out, overlay=overlay)
    known = read_calibration(calibration)
    chosen = _weight(weight)
    check_options(method, chosen, push_only, friction, camera, known)
    table = recorded.TableFile(out, known.site_mm) if out else None
    drawing = recorded.OverlayFile(overlay) if overlay else None
    count, failed, doubted = 0, 0, 0
    first, last = "", ""
    largest: dict[str, Any] = {}
    tally = recorded.Tally()
    results = recorded.reconstruct_frames(
        recorded.read_picture(rest),
        known,
        recorded.frames(frames, sys.stdin.buffer, size, format),
        method=method,
        weight=chosen,
        push_only=push_only,
        friction=friction,
        robust=robust,
        camera=camera,
    )
    print(f"calibration {_described(known)}", file=sys.stderr)
    try:
        with LiveTable() as live:
            for count, result in enumerate(results, start=1):
                row = result.row(len(known.site_mm))
                live.add(row)
                tally.add(result)
                if result.field is not None and _size(row) >= _size(largest):
                    largest = row
                if table:
                    table.add(row)
                if drawing:
                    drawing.add(count, result)
                if result.reason:
                    failed += result.field is None
                    doubted += result.field is not None
                    first = first or f"{result.name}: {result.reason}"
                    if failed + doubted <= SHOWN and result.reason != last:
                        kind = "failed" if result.field is None else "doubtful"
                        print(f"twin: {kind}: {result.name}: {result.reason}", file=sys.stderr)
                last = result.reason
    finally:
        for sink in (table, drawing):
            if sink:
                sink.close()
    if not count:
        raise InputError("there were no frames")
    to = sys.stdout if out else sys.stderr
    print(f"frames      {count}, {failed} failed, {doubted} doubtful", file=to)
    print(*tally.lines(), sep="\n", end="\n" if largest else "", file=to)
    if largest:
        parts = [f"F{a} {largest[f'f{a}_n']:.4g} ± {largest[f'sd_f{a}_n']:.2g}" for a in "xyz"]
        print(f"largest     {', '.join(parts)} N, in {largest['frame']}", file=to)
        if push_only or friction is not None:
            parts = [f"F{a} {largest[f'sum_f{a}_n']:.4g}" for a in "xyz"]
            print(
                f"sites' sum  {', '.join(parts)} N there; the total above is that of the "
                "unbounded solve",
                file=to,
            )
    if out:
        print(f"written to  {out}")
    if failed:
        raise SomeFailed(f"{failed} of {count} frames failed, the first trouble: {first}")


def _size(row: dict[str, Any]) -> float:
    """Return the size of a row's total force, N; 0 of no row."""
    return hypot(*(row[f"f{axis}_n"] for axis in "xyz")) if row else 0.0


def _described(known: Calibration) -> str:
    """Return the sensor that a calibration is of, so that a wrong one is noticed."""
    stiffness = known.facts.get("youngs_modulus_mpa")
    parts = [
        str(known.facts.get("scene") or "of an unnamed sensor"),
        f"method {known.method}",
        *([f"E {stiffness} MPa"] if stiffness is not None else []),
        f"{len(known.layer)} markers",
        f"{len(known.site_mm)} sites",
    ]
    return ", ".join(parts)


def _keep_inputs(inputs: Sequence[Path], **outputs: Path | None) -> None:
    """Refuse output over an input, or between inputs: drawings in a folder would be its next
    frames."""
    read = {os.path.realpath(path) for path in inputs}
    for option, path in outputs.items():
        if path is None:
            continue
        places = {path, path.parent} if option == "overlay" else {path}
        if read & {os.path.realpath(place) for place in places}:
            raise InputError(
                f"--{option} {path}: is what is read, or in a folder that is; give another name"
            )


def _weight(text: str) -> float | WeightRule:
    if text in get_args(WeightRule):
        return cast(WeightRule, text)
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not 0 <= number < float("inf"):
        raise InputError(
            f"--weight {text}: must be a number >= 0 of px2/N2, or auto, likelihood or gcv"
        )
    return number
