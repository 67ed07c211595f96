"""A run's files, and what is printed of it."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from twin.errors import SomeFailed
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.results import RunResult, make_folder, refuse_others_files, remove_results, write_whole
from twin.study.run import WANTED, computed, only_wanted


def run_to_folder(scene: Scene, folder: Path, want: Collection[str], progress: Progress | None = None) -> str:
    """Run a scene, write its files into ``folder`` and return a summary of a few lines.

    Where a step of the press after the first is refused or does not converge, the files are those of the state before
    it, `SomeFailed` says so, and so do their facts.
    """
    make_folder(folder)
    refuse_others_files(folder)
    asked = frozenset(want)
    result = computed(scene, asked, by_name=asked != WANTED, keep_last=True, progress=progress)
    page = ""
    if "report" in want:
        from twin.show.report import report

        started = time.perf_counter()
        page = report(result)
        result = replace(result, timings={**result.timings, "report": time.perf_counter() - started})
    remove_results(folder)
    only_wanted(result, asked).write(folder)
    if page:
        write_whole(folder / "report.html", lambda f: f.write(page.encode()))
    if progress is not None:
        progress("done", 1.0)
    if (reason := result.facts.get("contact", {}).get("incomplete")) is not None:
        raise SomeFailed(f"press: {reason}; what belongs to that state is in {folder}")
    return _summary(result, folder)


def _summary(result: RunResult, folder: Path) -> str:
    lines = []
    score = result.score or {}
    contact = result.facts.get("contact")
    if contact is not None:
        lines.append(
            f"contact     {contact['force_n'][2]:.4g} N along z, indentation {contact['indentation_mm']:.3g} mm"
        )
    lines += [f"warning     {doubt}" for doubt in result.facts.get("validity", {}).get("warnings", ())]
    if "renderer" in result.facts:
        lines.append(f"renderer    {result.facts['renderer']}")
    tracking, force = score.get("tracking"), score.get("force")
    for stage in ("tracking", "force"):
        if score.get(stage) is None and "tracking" in result.timings and stage in score.get("reasons", {}):
            lines.append(f"{stage:11s} failed: {score['reasons'][stage]}")
    if tracking and tracking.get("sd_px") is not None:
        lines.append(f"tracking    SD {tracking['sd_px']:.3f} px, {100 * tracking['matched']:.1f} % matched")
    if force and force.get("total_force_error") is not None:
        lines.append(f"total force {100 * force['total_force_error']:.1f} % off")
    lines.append(f"time        {sum(result.timings.values()):.1f} s")
    lines.append(f"written to  {folder}")
    return "\n".join(lines)
