"""The transfer matrix of the finger from 75 presses, as Sato measured it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.sense.calibration import Calibration
from twin.show.panels import Curve, CurvePanel
from twin.study.calibrate import calibrate_by_presses
from twin.study.reproduce.bench import OUR_TRACKER, Bench
from twin.study.reproduce.entry import Entry
from twin.study.reproduce.fields import TOO
from twin.study.reproduce.record import Outcome, Record, causes, over


def site_errors(made: Calibration, wanted: Calibration) -> Floats:
    """Return (k,) the relative difference of two transfer matrices by site."""
    sites = len(made.site_mm)
    known = np.isfinite(made.transfer).all(axis=1) & np.isfinite(wanted.transfer).all(axis=1)
    one, other = (c.transfer[known].reshape(-1, sites, 3).transpose(1, 0, 2) for c in (made, wanted))
    return np.asarray(np.linalg.norm(one - other, axis=(1, 2)) / np.linalg.norm(other, axis=(1, 2)))


def calibrated(bench: Bench, overrides: Mapping[str, Any]) -> Calibration:
    """Return a variant of the finger's calibration by presses; every variant is made once."""
    rig = bench.rig("sato", overrides=overrides)
    return bench.once(("by presses", repr(sorted(overrides.items()))), lambda: calibrate_by_presses(rig.sensor))


QUIET: dict[str, Any] = {"ccd.noise": False}
OUR_WAY: dict[str, Any] = {"tracking.method": OUR_TRACKER}


def calibrated_without(bench: Bench, cause: Mapping[str, Any]) -> Calibration:
    """Return the calibration that a finger without a cause would have had; the quick form takes the paper's own."""
    return bench.rig("sato").calibration if bench.quick else calibrated(bench, cause)


def said(bench: Bench, cause: str) -> str:
    """Return what is switched off, in words: in the quick form it stays on in the calibration."""
    return cause.removesuffix(TOO) if bench.quick else cause


FEW: dict[str, Any] = {
    f"{table}.{key}": 1 for table in ("calibration.presses", "reconstruction.sites") for key in ("columns", "rows")
}
"""The quick form presses one point."""


def _calibration(bench: Bench) -> Outcome:
    """Calibrate, and calibrate again with one source of error off; every press is solved once."""
    few = FEW if bench.quick else {}
    made = calibrated(bench, few)
    bench.progress("once more without errors", 0.8)
    clean = {"ccd.preset": "ideal", "calibration.load_cell_n": 0.0, "tracking.method": OUR_TRACKER}
    exact = calibrated(bench, few | clean)
    off: dict[str, dict[str, Any]] = {
        "noise of the picture off": QUIET,
        "noise of the load cell off": {"calibration.load_cell_n": 0.0},
        "tracker: this project's instead of the paper's": OUR_WAY,
    }
    variants = {}
    for number, (name, overrides) in enumerate(off.items()):
        bench.progress(name, 0.85 + 0.05 * number)
        variants[name] = site_errors(calibrated(bench, few | overrides), exact)
    errors = site_errors(made, exact)
    variants["drawing instead of presses: the nominal finger's compliance"] = site_errors(
        bench.rig("sato", overrides=few | {"calibration.method": "compliance"}).calibration, exact
    )
    columns = made.transfer[np.isfinite(made.transfer).all(axis=1)]
    at = np.arange(len(errors)).reshape(made.grid)
    edge = np.unique(np.concatenate([at[0], at[-1], at[:, 0], at[:, -1]]))
    parts = {"points of the edge": edge, "inner points": np.setdiff1d(at.ravel(), edge)}
    records = [
        Record(
            quantity=f"error of H at the {len(rows)} {name}, against the same presses without noise", unit="",
            **over(errors[rows]), explained_by=causes({cause: float(e[rows].mean()) for cause, e in variants.items()}),
        )
        for name, rows in parts.items()
        if len(rows)
    ]  # fmt: skip
    records += [
        Record(
            quantity="presses", unit="", paper=None if bench.quick else 75.0, twin=3.0 * len(made.site_mm)
        ),
        Record(quantity="condition number of H", unit="", twin=float(np.linalg.cond(columns))),
        Record(quantity="noise of a shift, as the tracker has it", unit="px", twin=made.noise_px),
    ]  # fmt: skip
    curves = [
        Curve(label=name, x=np.arange(float(len(e))), y=np.sort(e), style="o-")
        for name, e in {"as published": errors, **variants}.items()
    ]
    panel = CurvePanel(
        title="Error of H by site, sorted", curves=curves, across="site", up="error over its size", logarithmic=True
    )
    return Outcome(records=records, panels=(panel,))


CALIBRATION = Entry(
    name="sato/calibration",
    title="The conversion matrix H from 25 presses in three directions",
    source="Sato, section II C, equations 3 to 5, and Figs. 4 and 5",
    protocol="A 3 mm sphere presses each of 25 points with 100 gf along z, then moves along x, then along y; "
    "pictures with noise, forces from a load cell with noise; h = u f^-1.",
    run=_calibration,
)
