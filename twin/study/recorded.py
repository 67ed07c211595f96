"""Recorded frames: reconstructed one by one, and written as a table.

A frame that can't be read or reconstructed is a row with its reason, so that a sequence goes on.
Nothing grows with the number of frames but the output. Output grows under a temporary name and gets
its own when closed, also after an interrupt; a killed program leaves the temporary file.
"""

from __future__ import annotations

import csv
import json
import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Picture, Pixels, Points, eight_bits, mean_spacing, nice
from twin.errors import InputError, SomeFailed, TwinError
from twin.files import make_folder, png_bytes, write_whole
from twin.parts.scene import Scene
from twin.sense.calibration import Calibration, read_calibration
from twin.sense.inverse import METHODS
from twin.sense.reconstruct import Bump, Field, check_options, reconstruct
from twin.sense.track import Found, Tracker
from twin.study.batch.pool import counted
from twin.study.frames import VIDEOS, Frame, VideoWriter, read_numbers, read_picture
from twin.theory.relaxation import Hereditary

_MISFIT, _MISFIT_PX = 5.0, 0.3
"""A frame is doubted whose motion fits the calibration worse than the tracker's noise by this
factor, and by more than this, px."""

_SURE, _DIFFER, _AT_EDGE = 3.0, 0.2, 0.75
"""A frame is doubted whose totals with and without bounds differ by more stated deviations and more
of themselves; and one whose outermost sites hold more of the force. Of 60 presses of six pads, two
at the end of their dots (0.98 of the force there) were 61 and 84 % too weak; the others stay below
0.61, and 2.6 deviations. Turned, mirrored and sheared motions are 3.2 to 22 apart."""

_FEW = 0.5
"""Share of the rest picture's markers below which a frame is doubted."""

_FEW_AT_REST = 0.9
"""Share of the calibration's markers in the rest picture below which all frames are doubted."""

_STRETCH, _APART, _SCATTER = 0.03, 0.015, 0.05
"""Largest stretch, turn or shear of a layer in the rest picture against the nominal design, largest
difference of it between two layers (another depth of one), and root mean square distance that is
left, over the pitch. 120 sensors within the shipped tolerances stay below .023, .011 and .021."""

_PRINTED = 1.5
"""Largest such distance over what errors of the print make, where those are larger."""

_SCATTER_MEASURED = 0.005
"""The same for measured rest places: another sensor of the design is .016 to .028 off."""

_LEAST_TO_COMPARE = 6
"""Markers of a layer that are compared: three determine the affine change."""

TABLES = (".parquet", ".csv", ".npz")
_GROUP = 256
"""Rows of a Parquet group, which are held in memory."""

_FIELD = "force_n"
"""The column of every site's force; in Parquet and npz only."""


def reconstruct_recording(
    rest: Path,
    sources: Sequence[str],
    calibration: Path,
    *,
    out: Path | None = None,
    overlay: Path | None = None,
    size: str | None = None,
    layout: str | None = None,
    frames_per_second: float | None = None,
    times: Path | None = None,
    **options: Any,
) -> Iterator[str | tuple[str, dict[str, Any]]]:
    """Reconstruct recorded frames: yield a line and a record of each and lines of a summary, write
    table and drawings.

    Parameters
    ----------
    rest, sources, calibration
        Picture without load, or a folder of one a group of LEDs; pictures, folders, videos, or
        ``-`` for raw frames; file.
    out, overlay
        Table (.parquet, .csv, .npz); where motion is drawn: .png, folder, video.
    size, layout
        Of raw frames: 640x480; rgb24 or gray8.
    frames_per_second, times
        Of rubber that relaxes: rate, 0 for none, or a CSV file of frame, time_s.
    options
        As `twin.sense.reconstruct.reconstruct`; None, also for the rate: the calibration's.

    Raises
    ------
    InputError
        Something is given that can't be used, or there are no frames.
    SomeFailed
        Frames failed; the others are written.
    """
    # Check everything before the first frame is read, so that a wrong option costs nothing.
    _keep_inputs((rest, calibration, *map(Path, sources)), out=out, overlay=overlay)
    pictures = Frame.read(sources, sys.stdin.buffer, size, layout)
    known = read_calibration(calibration)
    options = _options(known, options)
    bounded = options["push_only"] or options["friction"] is not None
    check_options(
        options["method"],
        options["weight"],
        options["push_only"],
        options["friction"],
        options["camera"],
        known,
    )
    clock, in_time = _clock_of(known, frames_per_second, times)
    # Frames come one at a time: results are written as they come, and memory stays bounded.
    table = _TableFile(out, known.site_mm) if out else None
    drawing = _OverlayFile(overlay) if overlay else None
    results = _reconstruct_frames(_rest_pictures(rest), known, pictures, clock=clock, **options)
    print(f"calibration {known}", file=sys.stderr)
    print(f"forces      {_described_options(options)}{in_time}", file=sys.stderr)
    if known.relaxation is not None and clock is None:
        print(
            "twin: the rubber of this calibration relaxes, and each frame is read by itself: "
            "forces rise while held and remain when gone, within the stated deviations; give "
            "--frames-per-second",
            file=sys.stderr,
        )
    if len(known.layers) == 1 and not METHODS[options["method"]].local:
        print(
            f"twin: one layer of markers and method {options['method']}: forces into the surface "
            "come out far too small, as the stated deviations say; take --method local",
            file=sys.stderr,
        )
    relaxing = ""
    if known.relaxation is not None:
        relaxing = "how far the rubber has relaxed"
        if clock is not None:
            relaxing = "rubber that relaxes between frames"
    summary = _Summary(known, relaxing)
    try:
        with _LiveTable() as live:
            yield live.head
            for result in results:
                row = result.row(len(known.site_mm))
                yield live.line(row), {key: value for key, value in row.items() if key != _FIELD}
                summary.add(result, row)
                if table:
                    table.add(row)
                if drawing:
                    drawing.add(summary.count, result)
    finally:
        for sink in (table, drawing):
            if sink:
                sink.close()
    # What became of the frames in all.
    if not summary.count:
        raise InputError("there were no frames")
    if out:
        yield from summary.lines(bounded)
        yield f"written to  {out}"
    else:
        print("\n".join(summary.lines(bounded)), file=sys.stderr)
    if summary.failed:
        raise SomeFailed(f"{summary.failed} of {summary.count} frames failed")


def _rest_pictures(path: Path) -> list[Picture]:
    """Return the pictures without load: of a folder all, as frames are lit in turn."""
    if not path.is_dir():
        return [read_picture(path)]
    found = []
    for frame in Frame.read([str(path)], sys.stdin.buffer, None, None):
        if frame.picture is None:
            name = "" if frame.name == str(path) else f"{frame.name}: "
            raise InputError(f"{path}: {name}{frame.problem}")
        found.append(frame.picture)
    return found


@dataclass(frozen=True, kw_only=True)
class _FrameResult:
    """A frame's motion and forces, None where it failed; why it failed or is doubted; the shift
    that all markers share; computing seconds without reading."""

    name: str
    picture: Picture | None
    found: Found | None
    field: Field | None
    reason: str
    bump: Bump | None
    seconds: float

    def row(self, sites: int) -> dict[str, Any]:
        """Return the table's row, NaN where it failed: ``fx_n`` is of the linear estimate,
        ``sum_fx_n`` of the sites, which may be held to pushes or to friction cones."""
        nothing = np.full(3, np.nan)
        field = self.field
        vectors = {
            "f{}_n": field.total_force_n if field else nothing,
            "t{}_nmm": field.total_torque_nmm if field else nothing,
            "sum_f{}_n": field.force_n.sum(axis=0) if field else nothing,
            "sd_f{}_n": field.sd_total_n if field else nothing,
            "centre_{}_mm": _centre(field) if field else nothing[:2],
            "shared_{}_px": self.bump.shift_px if self.bump else nothing[:2],
        }
        return {
            "frame": self.name,
            "ok": field is not None,
            "reason": self.reason,
            "markers": int(self.found.seen.sum()) if self.found else 0,
            **{
                name.format(axis): float(value)
                for name, vector in vectors.items()
                for axis, value in zip("xyz", vector, strict=False)
            },
            "noise_px": float(field.noise_px) if field else np.nan,
            "milliseconds": 1e3 * self.seconds,
            _FIELD: field.force_n if field else np.full((sites, 3), np.nan),
        }


def _reconstruct_frames(
    rests: list[Picture],
    calibration: Calibration,
    sequence: Iterable[Frame],
    *,
    clock: _Clock | None = None,
    **options: Any,
) -> Iterator[_FrameResult]:
    """Yield the result of every frame. With ``clock`` forces are those of the calibration's rubber
    as it relaxes; over frames that fail, displacements are taken to change linearly."""
    # The rest picture must show the markers of the calibrated sensor.
    calibration.require_size(rests[0])
    width = calibration.diameter_px
    tracker = Tracker(rests, calibration.layout, diameter_px=width if np.isfinite(width) else None)
    known: Bools = np.asarray(np.isfinite(tracker.rest.rest_px).all(axis=1))
    if known.sum() < 2:
        raise InputError(
            f"the rest picture shows {int(known.sum())} of the calibration's {len(known)} "
            "markers: is it this sensor's, upright, of the calibration's size, and exposed?"
        )
    doubt = _other_sensor(tracker.rest.rest_px, calibration)
    before: Field | None = None
    rubber = calibration.relaxation
    history = None if clock is None or rubber is None else Hereditary(rubber)
    last_s: float | None = None
    # Each frame starts from the field of the one before. After a failure nothing is carried over.
    for number, frame in enumerate(sequence):
        started = time.perf_counter()
        found = None
        field = None
        bump = None
        reason = frame.problem
        if frame.picture is not None:
            try:
                found = tracker.track(frame.picture, number)
                time_s = None if clock is None else clock(number, frame.name)
                since_s = 0.0 if time_s is None or last_s is None else time_s - last_s
                if since_s < 0.0:
                    raise InputError(f"its time, {time_s:g} s, is before the last frame's")
                before = field = reconstruct(
                    found,
                    calibration,
                    previous=before,
                    history=history,
                    after_s=since_s,
                    **options,
                )
                last_s = time_s
                bump = Bump.of(found, calibration)
                doubts = [doubt, *_doubts(found, field, bump, int(known.sum()), calibration.grid)]
                reason = "; ".join(filter(None, doubts))
            except InputError as problem:
                reason = str(problem)
                before = None
                field = None
                tracker.forget()
        yield _FrameResult(
            name=frame.name,
            picture=frame.picture,
            found=found if field else None,
            field=field,
            reason=reason,
            bump=bump if field else None,
            seconds=time.perf_counter() - started,
        )


_Clock = Callable[[int, str], float]
"""Returns the time of a frame, s, from its number and its name."""


def _clock_of(
    known: Calibration, rate: float | None, times: Path | None
) -> tuple[_Clock | None, str]:
    """Return when frames were taken, and that in words; None where each is read by itself."""
    if rate is not None and times is not None:
        raise InputError("--times and --frames-per-second: give one of them")
    if rate is None and times is None:
        rate = _stored_options(known).frames_per_second
    if rate is not None and not (isinstance(rate, int | float) and 0 <= rate <= 1e6):
        raise InputError(f"--frames-per-second {rate}: must lie above 0 and up to 1e6, or be 0")
    if not rate and times is None:
        return None, ""
    if known.relaxation is None:
        raise InputError(
            f"--{'times' if times else 'frames-per-second'}: this calibration doesn't say how its "
            "rubber relaxes. Calibrate a recipe with [[material.relaxation]] (by presses, state "
            "how long each was held, held_s), or leave the option out"
        )
    if times is not None:
        names, table = read_numbers(times, ("time_s",))
        by_name: dict[str, float] = dict(zip(names, table[:, 0].tolist(), strict=True))

        def looked_up(_: int, name: str) -> float:
            if name not in by_name:
                raise InputError(f"{times} has no line for this frame")
            return by_name[name]

        return looked_up, f", of rubber that relaxes, at the times in {times}"
    per_s = float(rate or 0.0)
    return lambda number, _: number / per_s, f", of rubber that relaxes, {rate:g} frames a second"


def _other_sensor(rest_px: Pixels, calibration: Calibration) -> str:
    """Return why a rest picture's (n, 2) markers, px, are another sensor's, or nothing. Layers are
    compared up to a shift (a remounted camera) and a small affine change (other depths, a turned
    camera)."""
    remedy = (
        "is the calibration this sensor's, and the rest picture without load, upright and of its "
        "camera mode? Make one for this sensor with twin calibrate"
    )
    seen: Bools = np.asarray(np.isfinite(rest_px).all(axis=1))
    if seen.mean() < _FEW_AT_REST:
        return (
            f"the rest picture shows only {int(seen.sum())} of the calibration's {len(seen)} "
            f"markers: {remedy}"
        )
    allowed = max(_SCATTER, _PRINTED * np.sqrt(2.0) * calibration.print_error)
    if calibration.facts.get("rest") == "measured":
        allowed = _SCATTER_MEASURED
    stretches: list[Floats] = []
    for name in calibration.layers:
        rows = np.flatnonzero((calibration.layer == name) & seen)
        if len(rows) < _LEAST_TO_COMPARE:
            continue
        layout = calibration.layout_px[rows]
        pitch = float(np.median(cKDTree(layout).query(layout, k=2)[0][:, 1]))
        place = np.column_stack([layout - layout.mean(axis=0), np.ones(len(rows))])
        affine, *_ = np.linalg.lstsq(place, rest_px[rows], rcond=None)
        stretches.append(affine[:2] - np.eye(2))
        stretch = float(np.linalg.norm(stretches[-1], 2))
        apart = max(float(np.linalg.norm(stretches[-1] - other, 2)) for other in stretches)
        away = rest_px[rows] - place @ affine
        scatter = float(np.sqrt(np.mean((away**2).sum(axis=1)))) / pitch
        if stretch > _STRETCH or apart > _APART or scatter > allowed:
            if scatter > _SCATTER and stretch <= _STRETCH:
                remedy = f"does the lens distort (camera.intrinsics), or look askew? Else: {remedy}"
            return (
                f"the rest picture's {name} markers are not where the calibration has them "
                f"(stretched or turned by {100 * stretch:.2g} %, {100 * apart:.2g} % unlike "
                f"another layer, {scatter * pitch:.2g} px scattered): {remedy}"
            )
    return ""


def _doubts(found: Found, field: Field, bump: Bump, known: int, grid: tuple[int, int]) -> list[str]:
    """Return the evidence against a frame's forces."""
    doubts = []
    if bump.certain:
        column, row = bump.shift_px
        doubts.append(
            f"the whole picture moved by {column:.1f}, {row:.1f} px: was the camera bumped? Take "
            "a new rest picture"
        )
    usual = float(np.nanmedian(found.sd_px))
    if field.noise_px > max(_MISFIT * usual, _MISFIT_PX):
        doubts.append(
            f"the motion fits no forces (misfit {field.noise_px:.2f} px, tracking {usual:.3f} "
            "px): is it this sensor's calibration, and the picture upright?"
        )
    total, bounded = field.total_force_n, field.force_n.sum(axis=0)
    apart = total - bounded
    # The deviations state this difference, too, by which the picture is judged here.
    sure = _SURE * np.sqrt(np.maximum(field.sd_total_n**2 - apart**2, 0.0))
    largest = max(np.linalg.norm(total), np.linalg.norm(bounded))
    if (abs(apart) > sure).any() and np.linalg.norm(apart) > _DIFFER * largest:
        doubts.append(
            f"no pushes within the friction make this motion: they sum to Fz {bounded[2]:.2g} "
            f"N, without bounds Fz is {total[2]:.2g} N: is the picture this sensor's, and does "
            "nothing stick to it?"
        )
    size = np.linalg.norm(field.force_n, axis=1).reshape(grid)
    inside = size[1:-1, 1:-1]
    few = 2 * inside.size < size.size
    if not few and inside.sum() < (1 - _AT_EDGE) * size.sum() and (np.abs(total) > sure).any():
        doubts.append(
            "the force lies at the edge of the sites, beyond which none is looked for: press "
            "further in, or let reconstruction.sites and the dots reach further"
        )
    if found.seen.sum() < _FEW * known:
        doubts.append(f"only {int(found.seen.sum())} of {known} markers were found")
    return doubts


def _centre(field: Field) -> np.ndarray:
    """Return the (x, y) centre of pressure, mm; NaN without a significant push along z."""
    force, torque = field.total_force_n, field.total_torque_nmm
    if not force[2] > 3.0 * field.sd_total_n[2]:
        return np.full(2, np.nan)
    height = float(field.site_mm[:, 2].mean())
    return np.array(
        [(height * force[0] - torque[1]) / force[2], (torque[0] + height * force[1]) / force[2]]
    )


class _TableFile:
    """A table written row by row, with the (k, 3) ``sites``, mm; its suffix is its format."""

    def __init__(self, path: Path, sites: Points) -> None:
        self._kind = path.suffix.lower()
        if self._kind not in TABLES:
            raise InputError(f"--out {path}: the table's suffix must be one of {', '.join(TABLES)}")
        make_folder(path.parent)
        self.path, self._sites = path, sites
        self._part = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._rows: list[dict[str, Any]] = []
        self._writer: Any = None
        self._file: Any = None

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row; every row has the same keys."""
        try:
            if self._kind == ".csv":
                self._add_csv(row)
                return
            self._rows.append(dict(row))
            if self._kind == ".parquet" and len(self._rows) >= _GROUP:
                self._flush_parquet()
        except OSError as problem:
            raise TwinError.unwritable(self.path, problem) from None

    def close(self) -> None:
        """Finish the file and give it its name; without rows there is none."""
        try:
            if self._kind == ".parquet" and self._rows:
                self._flush_parquet()
            if self._kind == ".npz" and self._rows:
                columns = {
                    key: np.array(
                        [row[key] for row in self._rows], np.float32 if key == _FIELD else None
                    )
                    for key in self._rows[0]
                }
                with open(self._part, "wb") as file:
                    np.savez_compressed(file, allow_pickle=False, site_mm=self._sites, **columns)
            for sink in (self._writer if self._kind == ".parquet" else None, self._file):
                if sink is not None:
                    sink.close()
            if self._part.exists():
                os.replace(self._part, self.path)
        except OSError as problem:
            raise TwinError.unwritable(self.path, problem) from None
        finally:
            self._part.unlink(missing_ok=True)

    def _add_csv(self, row: Mapping[str, Any]) -> None:
        plain = {key: value for key, value in row.items() if key != _FIELD}
        if self._writer is None:
            # closed by close()
            self._file = open(self._part, "w", newline="", encoding="utf-8")  # noqa: SIM115
            self._writer = csv.DictWriter(self._file, list(plain))
            self._writer.writeheader()
        self._writer.writerow(
            {k: "" if isinstance(v, float) and v != v else v for k, v in plain.items()}
        )
        self._file.flush()

    def _flush_parquet(self) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        arrays = {}
        for key in self._rows[0]:
            values = [row[key] for row in self._rows]
            if key == _FIELD:
                flat = [np.asarray(value, np.float32).ravel() for value in values]
                arrays[key] = pa.array(flat, pa.list_(pa.float32()))
            else:
                arrays[key] = pa.array(values)
        table = pa.table(arrays)
        if self._writer is None:
            facts = {
                "site_mm": json.dumps(np.asarray(self._sites).tolist()),
                "units": "N, mm, px; force_n: site by site x, y, z",
            }
            self._writer = pq.ParquetWriter(self._part, table.schema.with_metadata(facts))
        self._writer.write_table(table.cast(self._writer.schema))
        self._rows = []


_SHOWN = 5
"""Frames whose trouble is printed one by one; the table has all."""


class _Summary:
    """What became of the frames and their markers, the causes of the force error, and the first
    trouble."""

    def __init__(self, known: Calibration, relaxing: str) -> None:
        factor = f"the calibration's factor ({100 * known.scale_error:.2g} %)"
        causes = {
            factor: known.scale_error > 0,
            "how far off it read its own presses": known.read_error.any(),
            "the layers' depths": known.by_depth.size > 0,
            "the load cell of the calibration": known.by_load_cell.size > 0,
            relaxing: bool(relaxing),
        }
        others = [cause for cause, stated in causes.items() if stated]
        self.causes = ", ".join(["of the markers' noise", *others]) + ("" if others else " alone")
        self.count, self.failed = 0, 0
        self._doubted = 0
        self._last = ""
        self._largest: dict[str, Any] = {}
        self._layer, self._one_layer = known.layer, ""
        self._states: dict[str, int] = {}
        self._squares: list[float] = []

    def add(self, result: _FrameResult, row: dict[str, Any]) -> None:
        """Count a frame; print its trouble."""
        self.count += 1
        if result.found is not None and result.field is not None:
            states = np.unique(result.found.states, return_counts=True)
            for state, count in zip(*states, strict=True):
                self._states[str(state)] = self._states.get(str(state), 0) + int(count)
            self._squares.append(float((result.field.sd_total_n**2).sum()))
            if _size(row) >= _size(self._largest):
                self._largest = row
                self._one_layer = result.field.one_layer(self._layer)
        if result.reason:
            kind = "failed" if result.field is None else "doubtful"
            self.failed += kind == "failed"
            self._doubted += kind == "doubtful"
            if self.failed + self._doubted <= _SHOWN and result.reason != self._last:
                print(f"twin: {kind}: {result.name}: {result.reason}", file=sys.stderr)
        self._last = result.reason

    def lines(self, bounded: bool) -> list[str]:
        """Return counts of frames, shares of markers' states, the root mean square of total forces'
        deviations, and the largest force; ``bounded``: sites are held to pushes or friction
        cones."""
        lines = [f"frames      {self.count}, {self.failed} failed, {self._doubted} doubtful"]
        if not self._largest:
            return lines
        markers = sum(self._states.values())
        share = {state: self._states.get(state, 0) / markers for state in _BY_STATE}
        share["lost"] = 1.0 - sum(share.values())
        shares = ", ".join(f"{100 * abs(part):.3g} % {state}" for state, part in share.items())
        expected = float(np.sqrt(sum(self._squares) / len(self._squares)))
        row = self._largest
        parts = [f"F{a} {row[f'f{a}_n']:.4g} ± {row[f'sd_f{a}_n']:.2g}" for a in "xyz"]
        lines += [
            f"markers     {shares}",
            f"expected    error of a total force {expected:.2g} N, {self.causes}",
            f"largest     {', '.join(parts)} N, in {row['frame']}",
        ]
        if bounded:
            parts = [f"F{a} {row[f'sum_f{a}_n']:.4g}" for a in "xyz"]
            lines.append(
                f"sites' sum  {', '.join(parts)} N there, of sites that only push or obey "
                "friction; the total above is solved without these bounds"
            )
        if self._one_layer:
            lines.append(f"push        uncertain, as ± Fz says: {self._one_layer}")
        return lines


def _size(row: dict[str, Any]) -> float:
    """Return the size of a row's total force, N; 0 of no row."""
    return math.hypot(*(row[f"f{axis}_n"] for axis in "xyz")) if row else 0.0


_ROWS = 12
"""Rows that stay on a terminal."""

_HEAD = ("frame", "markers", "Fx N", "Fy N", "Fz N", "± Fz N", "Tz N mm", "ms", "")


class _LiveTable:
    """Shows the last few rows on a terminal; elsewhere they are lines, with ``head`` above."""

    def __init__(self) -> None:
        self._rows: deque[tuple[str, ...]] = deque(maxlen=_ROWS)
        self._live: Any = None

    def __enter__(self) -> _LiveTable:
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(refresh_per_second=8, transient=False)
            self._live.start()
        self.head = "" if self._live else "\t".join(_HEAD[:-1])
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def line(self, row: Mapping[str, Any]) -> str:
        """Return one frame's row as a line; on a terminal show it instead."""
        cells = (
            str(row["frame"]),
            str(row["markers"]),
            *(f"{row[key]:.4f}" for key in ("fx_n", "fy_n", "fz_n", "sd_fz_n")),
            f"{row['tz_nmm']:.4g}",
            f"{row['milliseconds']:.1f}",
        )
        if self._live is None:
            return "\t".join(cells)
        self._rows.append((*cells, str(row["reason"])))
        self._live.update(self._table())
        return ""

    def _table(self) -> Any:
        from rich.table import Table

        table = Table(*_HEAD)
        for cells in self._rows:
            table.add_row(*cells)
        return table


def _stored_options(known: Calibration) -> Scene.Reconstruction:
    """Return the options in the calibration's recipe."""
    stored = known.facts.get("reconstruction")
    return Scene.Reconstruction.model_construct(**(stored if isinstance(stored, dict) else {}))


def _options(known: Calibration, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a reconstruction: as given, else as in the calibration's recipe."""
    own = _stored_options(known).options()
    if given["push_only"] is False or given["method"] == "pinv":
        own |= {"push_only": False, "friction": None}
    own["camera"] &= known.has_camera
    return own | {name: value for name, value in given.items() if value is not None}


def _described_options(options: Mapping[str, Any]) -> str:
    """Return how forces are solved for, in words."""
    parts = [f"method {options['method']}", f"weight {options['weight']}"]
    parts += [] if options["friction"] is None else [f"friction up to {options['friction']:g}"]
    parts += [
        words
        for name, words in (
            ("push_only", "pushes only"),
            ("robust", "wrong vectors left out"),
            ("camera", "the camera's bend followed"),
        )
        if options[name]
    ]
    return ", ".join(parts)


def _keep_inputs(inputs: Sequence[Path], **outputs: Path | None) -> None:
    """Refuse output over an input, or between inputs: drawings there would be the next frames."""
    read = {os.path.realpath(path) for path in inputs}
    for option, path in outputs.items():
        if path is None:
            continue
        places = {path, path.parent} if option == "overlay" else {path}
        if read & {os.path.realpath(place) for place in places}:
            raise InputError(
                f"--{option} {path}: is what is read, or in a folder that is; give another name"
            )


_LOST, _TEXT = (255, 210, 0), (255, 255, 255)
_BY_STATE = {
    "seen": (120, 255, 120),
    "strained": (90, 220, 255),
    "partly hidden": (255, 130, 40),
    "ambiguous": (255, 90, 255),
}
"""Colours of markers by their state; others are lost."""


_MOST_TIMES = 20.0
_LONGEST = 1.5
"""How many times as long motion is drawn at most, and the longest line over the mean distance of
markers; the factor of a sequence never grows, so that its frames can be compared."""


class _OverlayFile:
    """Frames with the motion drawn in: a .png, a folder of them, or a video."""

    def __init__(self, target: Path) -> None:
        suffix = target.suffix.lower()
        self._target = target
        self._film = suffix in VIDEOS
        self._one = suffix == ".png"
        if suffix[1:].isalpha() and not (self._film or self._one or target.is_dir()):
            raise InputError(
                f"--overlay {target}: pictures are drawn as .png; give that, a folder, or a video "
                "(.mp4)"
            )
        if self._film:
            VideoWriter.require()
        make_folder(target.parent if self._film or self._one else target)
        self._writer: VideoWriter | None = None
        self._times = _MOST_TIMES
        # removed with the first frame, as a job without any leaves them
        self._older = [] if self._film or self._one else sorted(target.glob("[0-9]" * 6 + "_*.png"))
        if self._older:
            print(
                f"twin: --overlay {target}: the {counted(len(self._older), 'drawing')} there, "
                f"{self._older[0].name} and so on, will be replaced",
                file=sys.stderr,
            )

    def add(self, number: int, result: _FrameResult) -> None:
        """Draw frame ``number``, counted from 1; one that can't be read is left out. In a folder
        the first one takes the place of earlier drawings."""
        while self._older:
            self._older.pop().unlink(missing_ok=True)
        if result.picture is None:
            return
        found, field = result.found, result.field
        text = result.reason or "no result"
        if field is not None:
            x, y, z = field.total_force_n
            text = f"{result.name}  Fx {x:.3f}  Fy {y:.3f}  Fz {z:.3f} N   {result.reason}"
        if found is not None and found.seen.any():
            longest = float(np.hypot(*found.shift_px[found.seen].T).max())
            wanted = _LONGEST * mean_spacing(found.rest_px[found.seen])
            self._times = min(self._times, max(1.0, nice(wanted / max(longest, 1e-9))))
        drawn = _overlay(result.picture, found, f"motion x {self._times:g}  {text}", self._times)
        if self._film:
            height, width = drawn.shape[:2]
            self._writer = self._writer or VideoWriter(self._target, (width, height))
            self._writer.add(drawn)
            return
        path = self._target
        if not self._one:
            path = path / f"{number:06d}_{Path(result.name.replace(':', '_')).stem}.png"
        elif number > 1:
            path = path.with_stem(f"{path.stem}_{number:06d}")
        write_whole(path, png_bytes(drawn))

    def close(self) -> None:
        """Finish a video."""
        if self._writer is not None:
            self._writer.close()


def _overlay(picture: Picture, found: Found | None, text: str, times: float) -> Picture:
    """Return an (h, w, 3) or (h, w) picture in colour with a line of text, and a line for every
    marker's motion, ``times`` as long; those without a shift are circles. Colours show the
    states."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(eight_bits(picture)).convert("RGB")
    draw = ImageDraw.Draw(image)
    rows = (found.rest_px, found.shift_px, found.seen, found.states) if found else ()
    for (x, y), (dx, dy), fine, state in zip(*rows, strict=True):
        if not np.isfinite(x + y):
            continue
        colour = _BY_STATE.get(str(state), _LOST)
        if fine:
            motion = (x, y, x + times * dx, y + times * dy)
            draw.line(motion, fill=(0, 0, 0), width=4)  # so that it shows on bright grounds too
            draw.line(motion, fill=colour, width=2)
            draw.point((x, y), fill=_TEXT)
        else:
            draw.ellipse((x - 4, y - 4, x + 4, y + 4), outline=colour)
    draw.rectangle((0, 0, image.width, 13), fill=(0, 0, 0))
    draw.text((3, 1), text, fill=_TEXT)
    return np.array(image)
