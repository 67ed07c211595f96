"""`twin calibrate`: a scene's sensor, calibrated on the twin or from a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from twin.commands.common import Overrides, SceneName, load, progress


def calibrate(
    folder: Annotated[
        Path | None,
        Parameter(help="Recording of a real sensor: rest.png, pictures, presses.csv (else the twin's)."),
    ] = None,
    /,
    *,
    scene: SceneName,
    out: Annotated[Path, Parameter(help="Calibration file to write (.npz).")],
    method: Annotated[
        Literal["sato", "fitted", "compliance", "halfspace"] | None, Parameter(help="Default: the scene's.")
    ] = None,
    set_: Overrides = (),
) -> None:
    """Calibrate a scene's sensor, on the twin or from a recording, and write the calibration file.

    A recording is a folder with rest.png, a picture of every press, and presses.csv with the columns frame, x_mm, y_mm,
    z_mm (place on the outer surface), fx_n, fy_n, fz_n (load cell). Methods compliance and halfspace need rest.png
    only.

    Method sato presses the simulated sensor at every site in three directions, in pictures with noise; fitted
    presses five and fits the design's parameters to them.

    Examples:
    twin calibrate --scene sato_press --out sato.npz
    twin calibrate recording --scene kamiyama_pillar --method fitted --out mine.npz
    """
    from twin.study.calibrate import calibrate_to_file
    from twin.study.recorded_presses import calibrate_from_folder

    overrides = (*set_, f"calibration.method={method}") if method else set_
    loaded = load(scene, overrides)
    if folder is not None:
        print(calibrate_from_folder(loaded, folder, out, progress=progress()))
        return
    print(calibrate_to_file(loaded, out, progress=progress()))
