"""Progress and tables of frames on a terminal; plain lines, or nothing, where there is none."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.arrays import Progress

ROWS = 12
HEAD = ("frame", "markers", "Fx N", "Fy N", "Fz N", "± Fz N", "Tz N mm", "ms", "")


class LiveTable:
    """Shows rows as they come: the last few on a terminal, all of them as lines elsewhere."""

    def __init__(self) -> None:
        self._rows: deque[tuple[str, ...]] = deque(maxlen=ROWS)
        self._live: Any = None

    def __enter__(self) -> LiveTable:
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(refresh_per_second=8, transient=False)
            self._live.start()
        else:
            print("\t".join(HEAD[:-1]))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def add(self, row: Mapping[str, Any]) -> None:
        """Show one frame's row."""
        cells = (
            str(row["frame"]),
            str(row["markers"]),
            *(f"{row[key]:.4f}" for key in ("fx_n", "fy_n", "fz_n", "sd_fz_n")),
            f"{row['tz_nmm']:.4g}",
            f"{row['milliseconds']:.1f}",
        )
        if self._live is not None:
            self._rows.append((*cells, str(row["reason"])))
            self._live.update(self._table())
        else:
            print("\t".join(cells))

    def _table(self) -> Any:
        from rich.table import Table

        table = Table(*HEAD)
        for cells in self._rows:
            table.add_row(*cells)
        return table


def progress() -> Progress | None:
    """Return a function that shows (what, share done), or None where stderr is not a terminal."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    bar = Bar(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("starting", total=1.0)
    bar.start()

    def show(what: str, share: float) -> None:
        bar.update(task, description=what, completed=share)
        if share >= 1.0:
            bar.stop()

    return show
