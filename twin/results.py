"""The result of a run: frozen arrays under the names of the files, and the files' names."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from twin.arrays import Bools, Floats, Picture, Pixels, Points
from twin.display import (
    ForceTable,
    Table,
    html_table,
    new_axes,
    one_line,
    plot_forces,
    plot_shifts,
    vector,
)
from twin.errors import InputError
from twin.files import make_folder, png_bytes, write_json, write_whole


@dataclass(frozen=True, kw_only=True, repr=False)
class Truth(Table):
    """What really happened (``truth.npz``); n markers in their one order, m surface pieces under
    load.

    Attributes
    ----------
    marker_rest_mm, marker_displacement_mm
        (n, 3) rest places and displacements, mm.
    marker_layer
        (n,) layer names.
    marker_rest_px, marker_pressed_px
        (n, 2) projected centres, px; empty without a camera.
    marker_outline_rest_px, marker_outline_pressed_px
        (n, 2) coverage centroids of the visible outlines, px, NaN where hidden; empty without
        pictures.
    marker_visible
        (n,) whether the whole outline is seen, at rest and pressed; empty without pictures.
    surface_mm, surface_force_n
        (m, 3) places and forces of the pieces of the contact, mm and N.
    total_force_n, total_torque_nmm
        (3,) resultants, N and N mm about the origin.
    """

    _title: ClassVar[str] = "What happened"

    marker_rest_mm: Points
    marker_displacement_mm: Points
    marker_layer: np.ndarray
    marker_rest_px: Pixels
    marker_pressed_px: Pixels
    marker_outline_rest_px: Pixels
    marker_outline_pressed_px: Pixels
    marker_visible: Bools
    surface_mm: Points
    surface_force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats

    def _rows(self) -> dict[str, str]:
        return {
            "markers": str(len(self.marker_rest_mm)),
            "pieces pressed": str(len(self.surface_mm)),
            "total force": vector(self.total_force_n, "N"),
        }

    def force_at(self, site_mm: Points) -> Floats:
        """Return (k, 3) true forces, N, summed into the cells of their nearest sites, as scored."""
        from twin.judge.score import into_cells

        return into_cells(site_mm, self.surface_mm, self.surface_force_n)

    def columns(self) -> dict[str, np.ndarray]:
        """Return a row for every marker: layer, rest place and displacement, mm."""
        names = {"x_mm": 0, "y_mm": 1, "z_mm": 2}
        rest = {name: self.marker_rest_mm[:, axis] for name, axis in names.items()}
        moved = {f"u{name}": self.marker_displacement_mm[:, axis] for name, axis in names.items()}
        return {"layer": self.marker_layer, **rest, **moved}

    def plot(self, ax: Any = None) -> Any:
        """Draw the true forces of the contact on matplotlib axes, and return these."""
        return plot_forces(new_axes(1, ax), self.surface_mm, self.surface_force_n, "true forces")


@dataclass(frozen=True, kw_only=True, repr=False)
class Estimate(ForceTable):
    """What the sensor's software made of the pictures (``estimate.npz``); k sites, markers in the
    truth's order.

    Attributes
    ----------
    marker_rest_px, marker_shift_px
        (n, 2) tracked rest places and shifts, px, NaN where not found.
    marker_sd_px, marker_state
        (n,) stated standard deviations of the shifts along each axis, px, NaN where there is none;
        (n,) what became of the markers, such as ``seen`` or ``partly hidden``.
    site_mm, force_n
        (k, 3) sites and forces, mm and N; empty if no forces were wanted.
    total_force_n, total_torque_nmm
        (3,) resultants of the linear solve, N and N mm about the origin; empty if no forces were
        wanted.
    sd_force_n, sd_total_n, sd_torque_nmm
        Stated standard deviations of these three, of their shapes and units.
    """

    _title: ClassVar[str] = "What the sensor's software found"

    marker_rest_px: Pixels
    marker_shift_px: Pixels
    marker_sd_px: Floats
    marker_state: np.ndarray
    site_mm: Points
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats
    sd_force_n: Floats
    sd_total_n: Floats
    sd_torque_nmm: Floats

    def _rows(self) -> dict[str, str]:
        seen = int(np.isfinite(self.marker_shift_px).all(axis=1).sum())
        rows = {"markers": f"{seen} of {len(self.marker_shift_px)} seen"}
        if len(self.site_mm):
            rows["sites"] = str(len(self.site_mm))
            rows["total force"] = vector(self.total_force_n, "N", self.sd_total_n)
        return rows


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """Everything that a run computed; what was not wanted is None.

    Attributes
    ----------
    scene_toml
        The resolved scene.
    truth, estimate
        See their classes.
    rest, pressed
        CCD pictures.
    score
        Errors by stage: ``elastic``, ``tracking``, ``force``, ``reasons``.
    touches
        What is under each probe that touches.
    facts
        What the report adds to the numbers: contact, calibration, validity, what truth and
        estimate share, why one layer of markers leaves a push uncertain.
    timings, cpu_s
        Seconds by stage, in order; and seconds of the processor, which hold on a busy machine.
    """

    @dataclass(frozen=True, kw_only=True)
    class Touch:
        """The contact under one probe, for pictures; k patches in contact.

        Attributes
        ----------
        probe
            Its kind.
        place_mm, half_mm
            (k, 2) centres along the surface from the contact's middle, and half sizes.
        pressure_mpa, shear_mpa
            (k,) pressures and (k, 2) tractions along the surface, on the body.
        slip
            (k,) whether each patch slips.
        friction
            Coefficient; 0 frictionless, inf sticking.
        expected
            (n, 2) distance from the middle and pressure by a closed form; empty where there is
            none.
        expected_name
            Name of the closed form.
        """

        probe: str
        place_mm: Floats
        half_mm: Floats
        pressure_mpa: Floats
        shear_mpa: Floats
        slip: Bools
        friction: float
        expected: Floats
        expected_name: str

        def __repr__(self) -> str:
            force = self.pressure_mpa @ (4 * self.half_mm.prod(axis=1))
            return one_line("Touch", [self.probe, f"{len(self.slip)} patches", f"{force:.3g} N"])

    scene_toml: str
    truth: Truth | None = None
    estimate: Estimate | None = None
    rest: Picture | None = None
    pressed: Picture | None = None
    score: dict[str, Any] | None = None
    touches: tuple[Touch, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        return one_line("RunResult", [f"{k} {v}" for k, v in self._rows().items() if v])

    def _repr_html_(self) -> str:
        source = ""
        if self.pressed is not None:
            source = f"data:image/png;base64,{base64.b64encode(png_bytes(self.pressed)).decode()}"
        return html_table("Result of a run", self._rows(), source)

    def _rows(self) -> dict[str, str]:
        """Return what the run came to, by name; empty where it was not computed."""
        score = self.score or {}
        tracking, force = score.get("tracking") or {}, score.get("force") or {}
        sd, total = tracking.get("sd_px"), force.get("total_force_error")
        centre, truth = force.get("centre_error_mm"), self.truth
        return {
            "true force": vector(truth.total_force_n, "N") if truth is not None else "",
            "marker noise": f"{sd:.2g} px" if sd is not None else "",
            "total force error": f"{100 * total:.2g} %" if total is not None else "",
            "centre error": f"{centre:.2g} mm" if centre is not None else "",
        }

    def summary(self) -> str:
        """Return the lines that ``twin run`` prints: contact, warnings, errors and times."""
        score, facts = self.score or {}, self.facts
        lines = []
        if (contact := facts.get("contact")) is not None:
            lines.append(
                f"contact     {contact['force_n'][2]:.4g} N along z, indentation "
                f"{contact['indentation_mm']:.3g} mm"
            )
        validity = facts.get("validity", {})
        warned = (*validity.get("warnings", ()), *facts.get("warnings", ()))
        lines += [f"warning     {warning}" for warning in warned]
        lines += [f"note        {note}" for note in validity.get("notes", ())]
        if "renderer" in facts:
            lines.append(f"renderer    {facts['renderer']}")
        if "tracking" in self.timings:
            for stage in ("tracking", "force"):
                if score.get(stage) is None and stage in score.get("reasons", {}):
                    lines.append(f"{stage:11s} failed: {score['reasons'][stage]}")
        tracking, force = score.get("tracking"), score.get("force")
        if tracking and tracking.get("matched") is not None:
            sd = tracking.get("sd_px")
            spread = f"SD {sd:.3f} px" if sd is not None else "no SD, too few markers"
            lines.append(f"tracking    {spread}, {100 * tracking['matched']:.1f} % matched")
        if force:
            lines += self._force_lines(force)
        long = [f"{name} {seconds:.1f}" for name, seconds in self.timings.items() if seconds >= 0.1]
        total = f"time        {sum(self.timings.values()):.1f} s"
        return "\n".join([*lines, ": ".join(filter(None, (total, ", ".join(long))))])

    def _force_lines(self, force: dict[str, Any]) -> list[str]:
        """Return the errors of total force, centre and field that are defined."""
        lines = []
        if force["total_force_error"] is not None:
            lines.append(
                f"total force {_share(force['total_force_error'], 1)} off, "
                f"{_share(force['total_force_stated'], 1)} stated"
            )
            if self.estimate is not None and len(self.estimate.force_n):
                sites = self.estimate.force_n.sum(axis=0)
                total = self.estimate.total_force_n
                sd = self.estimate.sd_total_n
                bounded = not np.allclose(sites, total, rtol=1e-6, atol=1e-9)
                lines[-1] += f": Fz {total[2]:.4g} ± {sd[2]:.2g} N"
                if bounded:
                    lines[-1] += ", solved without bounds"
                    lines.append(
                        f"sites' sum  {_share(force['sites_force_error'], 1)} off: Fz "
                        f"{sites[2]:.4g} N, of sites that only push or obey friction"
                    )
                if cause := self.facts.get("one_layer"):
                    lines.append(f"push        uncertain, as ± says: {cause}")
        if force["centre_error_mm"] is not None:
            lines.append(f"centre      {force['centre_error_mm']:.3g} mm off")
        if force["field_error"] is not None:
            lines.append(
                f"force field {_share(force['field_error'], 0)} off, "
                f"{_share(force['field_stated'], 0)} stated"
            )
        return lines

    def plot(self) -> Any:
        """Draw what the run computed in a new matplotlib figure.

        Returns
        -------
        Array of the axes of up to three panels: the pressed picture with the motion of its
        markers, the recovered forces, and the true forces, with one scale of
        colours.

        Raises
        ------
        InputError
            The run computed nothing that can be drawn.
        """
        truth, estimate = self.truth, self.estimate
        sites = estimate.site_mm if estimate is not None else np.zeros((0, 3))
        pieces = truth.surface_mm if truth is not None else np.zeros((0, 3))
        fields: list[tuple[str, Points, Floats]] = []
        if estimate is not None and len(sites):
            fields.append(("recovered forces", sites, estimate.force_n))
        if truth is not None and len(pieces) and len(sites):
            fields.append(("true forces, by site", sites, truth.force_at(sites)))
        elif truth is not None and len(pieces):
            fields.append(("true forces, by contact patch", pieces, truth.surface_force_n))
        count = (estimate is not None) + len(fields)
        if not count:
            raise InputError("plot(): this run computed neither marker motion nor forces")
        panels = np.atleast_1d(new_axes(count))
        if estimate is not None:
            layer = truth.marker_layer if truth is not None else np.zeros(0, str)
            rest, shift = estimate.marker_rest_px, estimate.marker_shift_px
            plot_shifts(panels[0], rest, shift, layer, self.pressed)
        largest = max((float(np.abs(force[:, 2]).max()) for _, _, force in fields), default=0.0)
        for panel, (title, places, force) in zip(panels[-len(fields) :], fields, strict=False):
            plot_forces(panel, places, force, title, largest)
        return panels

    @staticmethod
    def on_disk(folder: Path) -> dict[str, Any]:
        """Return the files of a run by name, its score and its seconds by stage (None without)."""
        files = {name: str(folder / name) for name in RESULT_FILES if (folder / name).is_file()}
        read = {
            name: json.loads(Path(files[f"{name}.json"]).read_text(encoding="utf-8"))
            if f"{name}.json" in files
            else None
            for name in ("score", "timings")
        }
        return {"folder": str(folder), "files": files, **read}

    @staticmethod
    def scored(path: Path) -> tuple[dict[str, Any], str]:
        """Return the score of a run, by its file or the run's folder, and its scene's text.

        Raises
        ------
        InputError
            There is none, or it can't be read.
        """
        file = path / "score.json" if path.is_dir() else path
        remedy = "give the score.json of a run, or the run's folder"
        if not file.is_file():
            raise InputError(f"{file}: there is no such file; {remedy}")
        try:
            score = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as problem:
            raise InputError(f"{file}: can't be read as JSON ({problem}); {remedy}") from None
        if not isinstance(score, dict) or not {"elastic", "tracking", "force"} <= score.keys():
            raise InputError(f"{file}: is no score.json; {remedy}")
        scene = file.parent / "scene.toml"
        return score, scene.read_text(encoding="utf-8") if scene.is_file() else ""

    def write(self, folder: Path) -> None:
        """Write all files but the report into ``folder``, and remove those of an earlier run.

        Raises
        ------
        TwinError
            The folder can't be written, or the disk is full.
        """
        make_folder(folder)
        for name in RESULT_FILES:
            (folder / name).unlink(missing_ok=True)
        write_json(folder / MARK, self.timings)
        write_whole(folder / "scene.toml", self.scene_toml.encode())
        for name, arrays in (("truth", self.truth), ("estimate", self.estimate)):
            if arrays is not None:
                table = {f.name: getattr(arrays, f.name) for f in fields(arrays)}
                path = folder / f"{name}.npz"
                write_whole(path, lambda f, t=table: np.savez(f, **t))  # type: ignore[misc]
        for name, picture in (("rest", self.rest), ("pressed", self.pressed)):
            if picture is not None:
                write_whole(folder / f"{name}.png", png_bytes(picture))
        if self.score is not None:
            write_json(folder / "score.json", {**self.score, "facts": self.facts})


def _share(error: float, digits: int) -> str:
    """Return an error over the size of what is true; in percent up to ten times."""
    return f"{100 * error:.{digits}f} %" if error < 10 else f"{error:.0f} times its size"


MARK = "timings.json"
"""Written first and removed last: it marks the files below as those of a run."""

RESULT_FILES = (
    "rest.png",
    "pressed.png",
    "truth.npz",
    "estimate.npz",
    "score.json",
    "scene.toml",
    "report.html",
    MARK,
)
