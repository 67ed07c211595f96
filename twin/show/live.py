"""A table of the latest frames that grows on a terminal, or plain lines where there is none."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping
from types import TracebackType
from typing import Any

ROWS = 12
HEAD = ("frame", "markers", "Fx N", "Fy N", "Fz N", "Tz N mm", "ms", "")


class LiveTable:
    """Shows rows as they come: the last few on a terminal, all of them as lines elsewhere if ``lines``."""

    def __init__(self, lines: bool) -> None:
        self._lines = lines
        self._rows: deque[tuple[str, ...]] = deque(maxlen=ROWS)
        self._live: Any = None

    def __enter__(self) -> LiveTable:
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(refresh_per_second=8, transient=False)
            self._live.start()
        elif self._lines:
            print("\t".join(HEAD[:-1]))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def add(self, row: Mapping[str, Any]) -> None:
        """Show one frame's row."""
        cells = (
            str(row["frame"]), str(row["markers"]),
            *(f"{row[key]:.4g}" for key in ("fx_n", "fy_n", "fz_n", "tz_nmm")), f"{row['milliseconds']:.1f}",
        )  # fmt: skip
        if self._live is not None:
            self._rows.append((*cells, str(row["reason"])))
            self._live.update(self._table())
        elif self._lines:
            print("\t".join(cells))

    def _table(self) -> Any:
        from rich.table import Table

        table = Table(*HEAD)
        for cells in self._rows:
            table.add_row(*cells)
        return table
