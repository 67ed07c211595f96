"""The whole chain, one press a row: seconds by stage beside the errors of tracking and force."""

from typing import Any

from twin.study.recipe import load_scene
from twin.study.run import run as run_scene

SCENES = ("kamiyama_pillar", "kamiyama_shear", "kamiyama_twist", "kamiyama_wide", "sato_press", "sato_shear")
STAGES = ("contact", "displacement", "pictures", "tracking", "calibration", "forces")


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a scene; the quick form runs one scene of each sensor."""
    rows = []
    for name in ("kamiyama_pillar", "sato_press") if quick else SCENES:
        result = run_scene(load_scene(name))
        seconds = dict(result.timings)
        seconds["pictures"] = seconds["rest picture"] + seconds["pressed picture"] + seconds["outlines"]
        seconds["forces"] = seconds["reconstruction"]
        row = {"scene": name, **{f"{stage}_s": seconds[stage] for stage in STAGES}}
        row |= {key: result.score["tracking"][key] for key in ("sd_px", "matched")}
        rows.append(row | {key: result.score["force"][key] for key in ("total_force_error", "centre_error_mm")})
    return rows
