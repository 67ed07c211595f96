"""Progress on stderr: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable


def progress_on_terminal() -> Callable[[str, float], None] | None:
    """Return a function that shows (what, share done), or None where stderr is not a terminal."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("starting", total=1.0)
    bar.start()

    def show(what: str, share: float) -> None:
        bar.update(task, description=what, completed=share)
        if share >= 1.0:
            bar.stop()

    return show
