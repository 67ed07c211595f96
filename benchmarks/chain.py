"""The whole chain, one press a row: CPU seconds by stage beside the errors of tracking and force."""

from typing import Any

from twin.study.recipe import load_scene
from twin.study.run import run as run_scene

SCENES = ("kamiyama_pillar", "kamiyama_shear", "kamiyama_twist", "kamiyama_wide", "sato_press", "sato_shear")
NO_STAGE = ("design", "contact error", "linearity", "score")  # but for design: what a run states of itself


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return one row a scene; the quick form runs one scene of each sensor."""
    rows = []
    for name in ("kamiyama_pillar", "sato_press") if quick else SCENES:
        result = run_scene(load_scene(name))
        times = {f"{key.replace(' ', '_')}_s": s for key, s in result.cpu_s.items() if key not in NO_STAGE}
        row = {"scene": name} | times | {key: result.score["tracking"][key] for key in ("sd_px", "matched")}
        rows.append(row | {key: result.score["force"][key] for key in ("total_force_error", "centre_error_mm")})
    return rows
