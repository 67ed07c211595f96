"""The whole chain, one press a row: seconds by stage beside the errors of tracking and force."""

from typing import Any

from twin.study.recipe import load_scene
from twin.study.run import run as run_scene

SCENES = ("kamiyama_pillar", "kamiyama_shear", "kamiyama_twist", "kamiyama_wide", "sato_press", "sato_shear")


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a scene; the quick form runs one scene of each sensor."""
    rows = []
    for name in ("kamiyama_pillar", "sato_press") if quick else SCENES:
        result = run_scene(load_scene(name))
        tracking, force = result.score["tracking"], result.score["force"]
        seconds = result.timings
        rows.append(
            {
                "scene": name,
                "contact_s": seconds["contact"],
                "displacement_s": seconds["displacement"],
                "pictures_s": seconds["rest picture"] + seconds["pressed picture"] + seconds["outlines"],
                "tracking_s": seconds["tracking"],
                "calibration_s": seconds["calibration"],
                "forces_s": seconds["reconstruction"],
                "sd_px": tracking["sd_px"],
                "matched": tracking["matched"],
                "total_force_error": force["total_force_error"],
                "centre_error_mm": force["centre_error_mm"],
            }
        )
    return rows
