"""What one reproduced figure says: a number of the paper, the twin's, and what the difference comes from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

CLOSE = 0.15
"""Share of the paper's number within which twin and paper agree whatever the spread: the papers round and read off
plots."""

MOST = 0.5
"""Share of the paper's number beyond which nothing agrees, however wide the runs are spread."""

DIGITS = 6
"""Significant digits kept of every number: the last ones of a sum depend on the processor."""

ROUND_OFF = 1e-9
"""Numbers below this are round-off: they differ from one processor to the next."""


@dataclass(frozen=True, kw_only=True)
class Cause:
    """The same quantity with one modelled cause switched off.

    Attributes
    ----------
    cause
        What was switched off, or put in its place.
    value
        What a run of its own then gives, in the record's unit.
    """

    cause: str
    value: float


@dataclass(frozen=True, kw_only=True)
class Record:
    """One quantity of one table or figure.

    Attributes
    ----------
    quantity, unit
        What it is; "" is a plain number.
    paper
        The paper's number; None where it prints none.
    twin
        The twin's, the mean over ``n`` runs.
    spread
        Standard deviation over these runs; None for one run.
    n
        Number of runs; they differ in seed (made sensor and noise) or, where the quantity says so, in noise alone.
    explained_by
        The causes that were switched off, one by one.
    timed
        Whether it is a time or a rate, which no two runs share.
    ours
        Whether it is this project's software on the paper's hardware: the paper's number stands beside it, and isn't
        what should come out.
    near
        Absolute difference from the paper within which the two agree; by default `CLOSE` of the paper's number.
    """

    quantity: str
    unit: str
    twin: float
    paper: float | None = None
    spread: float | None = None
    n: int = 1
    explained_by: tuple[Cause, ...] = ()
    timed: bool = False
    near: float | None = None
    ours: bool = False

    @property
    def tolerance(self) -> float:
        """Difference from the paper within which the two are said to agree."""
        size = abs(self.paper or 0.0)
        least = self.near if self.near is not None else CLOSE * size
        return max(least, min(2.0 * (self.spread or 0.0), MOST * size))

    @property
    def verdict(self) -> str:
        """Agreement with the paper: agrees, explained by the cause that closes the gap best, or not explained."""
        if self.paper is None:
            return "the paper gives no number"
        if self.timed:
            return "a time of another machine"
        if self.ours:
            return "this project's software on the paper's hardware"
        if not np.isfinite(self.twin):
            return "not defined in the twin"
        gap = abs(self.twin - self.paper)
        if gap <= self.tolerance:
            return "agrees"
        closing = [c for c in self.explained_by if np.isfinite(c.value)]
        best = min(closing, key=lambda c: abs(c.value - self.paper), default=None)  # type: ignore[operator]
        if best is not None and abs(best.value - self.paper) <= min(self.tolerance, 0.5 * gap):
            return f"explained by: {best.cause}"
        if best is not None and abs(best.value - self.paper) < 0.5 * gap:
            return f"partly explained by: {best.cause}"
        return "disagrees, and no modelled cause explains it"

    def row(self) -> dict[str, Any]:
        """Return the record as it stands in results.json."""
        table = asdict(self)
        del table["near"]
        table["explained_by"] = [{"cause": c.cause, "value": rounded(c.value)} for c in self.explained_by]
        table |= {key: rounded(table[key]) for key in ("twin", "paper", "spread")}
        return {**table, "difference": self._difference(), "verdict": self.verdict}

    def _difference(self) -> float | None:
        return None if self.paper is None else rounded(self.twin - self.paper)


def rounded(value: float | None) -> float | None:
    """Return a number with `DIGITS` significant digits; None for what is not finite."""
    if value is None or not np.isfinite(value):
        return None
    if abs(value) < ROUND_OFF:
        return 0.0
    return float(f"{value:.{DIGITS}g}")


def over(values: Iterable[float]) -> dict[str, Any]:
    """Return ``twin``, ``spread`` and ``n`` of a record from the values of its runs."""
    known = np.array([v for v in values if np.isfinite(v)], float)
    if not len(known):
        return {"twin": float("nan"), "spread": None, "n": 0}
    spread = float(known.std(ddof=1)) if len(known) > 1 else None
    return {"twin": float(known.mean()), "spread": spread, "n": len(known)}


def causes(values: Mapping[str, float]) -> tuple[Cause, ...]:
    """Return the causes from their values by name."""
    return tuple(Cause(cause=name, value=float(value)) for name, value in values.items())


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What an entry's runs came to.

    Attributes
    ----------
    records
        The numbers.
    panels
        The drawings of its picture (`twin.show.panels`).
    notes
        Sentences that belong beside them.
    """

    records: Sequence[Record]
    panels: Sequence[Any] = ()
    notes: Sequence[str] = ()
