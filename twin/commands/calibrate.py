"""`twin calibrate`: a scene's sensor, calibrated on the twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import Overrides, SceneName, load, progress


def calibrate(
    *,
    scene: SceneName,
    out: Annotated[Path, Parameter(help="Calibration file to write (.npz).")],
    method: Annotated[
        str | None, Parameter(help="sato, fitted, compliance or halfspace (default: the scene's).")
    ] = None,
    set_: Overrides = (),
) -> None:
    """Calibrate a scene's sensor on the twin and write the calibration file.

    Method sato presses the simulated sensor at every site in three directions, in pictures with noise; fitted
    presses five and fits the design's parameters to them.
    """
    from twin.study.calibrate import calibrate_to_file

    overrides = (*set_, f"calibration.method={method}") if method else set_
    print(calibrate_to_file(load(scene, overrides), out, progress=progress()))
