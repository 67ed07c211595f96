"""Progress on stderr: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import sys

from twin.progress import Progress


def progress_on_terminal() -> Progress | None:
    """Return a function that shows (what, share done), or None where stderr is not a terminal."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    bar = Bar(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("starting", total=1.0)
    bar.start()

    def show(what: str, share: float) -> None:
        bar.update(task, description=what, completed=share)
        if share >= 1.0:
            bar.stop()

    return show
