"""`twin reconstruct`: the sensor's software alone, on recorded pictures."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from twin.parts.methods import Method

if TYPE_CHECKING:
    from twin.study.recorded import Answer

TOLD = 5
"""Frames whose trouble is told one by one; the others are counted, and the table has them all."""


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
    out: Annotated[Path | None, Parameter(help="Table to write: .parquet, .csv (totals only) or .npz.")] = None,
    overlay: Annotated[
        Path | None, Parameter(help="Draw the motion into the frames: a .png, a folder of them, or a video (.mp4).")
    ] = None,
    size: Annotated[str | None, Parameter(help="Size of raw frames: 640x480.")] = None,
    format: Annotated[str | None, Parameter(help="Format of raw frames: rgb24 or gray8.")] = None,
    method: Annotated[Method, Parameter(help="How it is solved; local: forces only where some are found.")] = "smooth",
    weight: Annotated[str, Parameter(help="The papers' omega, px2/N2, or auto, likelihood, gcv.")] = "auto",
    push_only: Annotated[bool, Parameter(help="No site pulls.", negative="")] = False,
    friction: Annotated[float | None, Parameter(help="Friction coefficient that bounds every site's force.")] = None,
    robust: Annotated[bool, Parameter(help="Leave wrong vectors out.", negative="")] = False,
    camera: Annotated[bool, Parameter(help="Follow the camera's bend (needed for large motion).", negative="")] = False,
) -> None:
    """Track the markers of recorded frames and reconstruct the forces.

    Every frame is one row: total force and torque with standard deviations, centre of pressure, markers found, the
    shift that all markers share (a bumped camera), and in .parquet and .npz the force at every site. A frame that
    fails is a row with its reason, and the sequence goes on (exit code 3).

    Examples:
    twin reconstruct rest.png press*.png --calibration flat.npz --out forces.parquet
    twin reconstruct rest.png film.mp4 --calibration flat.npz --overlay drawn.mp4
    ffmpeg -i /dev/video0 -f rawvideo -pix_fmt rgb24 - | twin reconstruct rest.png - --size 640x480 --format rgb24 --calibration flat.npz
    """  # noqa: E501
    from twin.errors import InputError, SomeFailed
    from twin.sense.calibration import read_calibration
    from twin.sense.reconstruct import check_options
    from twin.show.live import LiveTable
    from twin.study.frames import VIDEOS, ffmpeg, raw_layout, read_picture
    from twin.study.frames import frames as read_frames
    from twin.study.recorded import answers
    from twin.study.table_files import TableFile

    if any(Path(source).suffix.lower() in VIDEOS for source in (*frames, str(overlay or ""))):
        ffmpeg()
    if "-" in frames:
        raw_layout(size, format)
    elif size is not None or format is not None:
        raise InputError("--size and --format belong to raw frames: give - in place of the pictures")
    _keep_inputs((rest, calibration, *map(Path, frames)), out=out, overlay=overlay)
    known = read_calibration(calibration)
    chosen = _weight(weight)
    check_options(method, chosen, push_only, friction, camera, known)
    options: dict[str, Any] = {
        "method": method, "weight": chosen, "push_only": push_only, "friction": friction, "robust": robust,
        "camera": camera,
    }  # fmt: skip
    table = TableFile(out, known.site_mm) if out else None
    drawing = _Drawing(overlay) if overlay else None
    failed, doubted, count, first = 0, 0, 0, ""
    sequence = answers(read_picture(rest), known, read_frames(frames, sys.stdin.buffer, size, format), **options)
    try:
        with LiveTable(lines=out is None) as live:
            for answer in sequence:
                row = answer.row(len(known.site_mm))
                count += 1
                live.add(row)
                if table:
                    table.add(row)
                if drawing and answer.picture is not None:
                    drawing.add(count, answer)
                if answer.reason:
                    failed, doubted = failed + (answer.field is None), doubted + (answer.field is not None)
                    first = first or f"{answer.name}: {answer.reason}"
                    if failed + doubted <= TOLD:
                        kind = "failed" if answer.field is None else "doubtful"
                        print(f"twin: {kind}: {answer.name}: {answer.reason}", file=sys.stderr)
    finally:
        for sink in (table, drawing):
            if sink:
                sink.close()
    if not count:
        raise InputError("there were no frames")
    print(f"frames      {count}, {failed} failed, {doubted} doubtful", file=sys.stdout if out else sys.stderr)
    if out:
        print(f"written to  {out}")
    if failed:
        raise SomeFailed(f"{failed} of {count} frames failed, the first trouble: {first}")


def _keep_inputs(inputs: Sequence[Path], **outputs: Path | None) -> None:
    """Refuse to write over what is read, or between it: a folder's drawings would be its next frames."""
    from twin.errors import InputError

    read = {os.path.realpath(path) for path in inputs}
    for option, path in outputs.items():
        if path is None:
            continue
        places = {path, path.parent} if option == "overlay" else {path}
        if read & {os.path.realpath(place) for place in places}:
            raise InputError(f"--{option} {path}: is what is read, or in a folder that is; give another name")


def _weight(text: str) -> float | str:
    from twin.errors import InputError

    if text in ("auto", "likelihood", "gcv"):
        return text
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not 0 <= number < float("inf"):
        raise InputError(f"--weight {text}: must be a number >= 0 of px2/N2, or auto, likelihood or gcv")
    return number


class _Drawing:
    """The overlay's files."""

    def __init__(self, target: Path) -> None:
        from twin.errors import InputError
        from twin.results import make_folder
        from twin.study.frames import PICTURES, VIDEOS

        suffix = target.suffix.lower()
        self.target, self._film, self._one = target, suffix in VIDEOS, suffix == ".png"
        if suffix in PICTURES and not self._one:
            raise InputError(f"--overlay {target}: pictures are drawn as .png; give that, a folder, or a video (.mp4)")
        make_folder(target.parent if self._film or self._one else target)
        self._writer: Any = None

    def add(self, number: int, answer: Answer) -> None:
        import numpy as np

        from twin.png import png_bytes
        from twin.results import write_whole
        from twin.show.overlay import overlay
        from twin.study.frames import VideoWriter

        assert answer.picture is not None
        found, field = answer.found, answer.field
        text = answer.reason or "no result"
        if field is not None:
            x, y, z = field.total_force_n
            text = f"{answer.name}  Fx {x:.3f}  Fy {y:.3f}  Fz {z:.3f} N   {answer.reason}"
        none = np.zeros((0, 2))
        drawn = overlay(
            answer.picture, found.rest_px if found else none, found.shift_px if found else none,
            found.seen if found else np.zeros(0, bool), text,
        )  # fmt: skip
        if self._film:
            height, width = drawn.shape[:2]
            self._writer = self._writer or VideoWriter(self.target, (width, height))
            self._writer.add(drawn)
            return
        path = self.target / f"{number:06d}_{Path(answer.name.replace(':', '_')).stem}.png"
        if self._one:  # frames after the first stand beside it
            path = self.target if number == 1 else self.target.with_stem(f"{self.target.stem}_{number:06d}")
        write_whole(path, lambda file: file.write(png_bytes(drawn)))

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
