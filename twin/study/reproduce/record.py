"""The papers' numbers and the twin's: a number, its spread over runs, and the verdict.

A gap is explained by a cause that was switched off, or by values of what no paper prints;
`Record.settled` compares these over all numbers of a paper.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

CLOSE = 0.15
"""Share of the paper's number within which twin and paper agree whatever the spread: the papers
round and read off plots."""

MOST = 0.5
"""Share of the paper's number beyond which nothing agrees, however wide the runs are spread."""

DIGITS, ROUND_OFF = 6, 1e-9
"""Significant digits kept of every number, and the size below which it is round-off: the last
digits depend on the processor."""


@dataclass(frozen=True)
class Quantity:
    """A number that an entry takes from each of its runs.

    Attributes
    ----------
    name, unit
        What it is; "" is a plain number.
    paper, near
        The paper's number, None where it prints none, and the difference within which the two
        agree; by default `CLOSE` of the number.
    timed
        Whether it is a time or a rate, which no two runs share.
    ours
        Whether it is this project's software on the paper's hardware: the paper's number is shown,
        and isn't what should come out.
    runs
        What its runs are, in the plural.
    """

    name: str
    unit: str = ""
    paper: float | None = None
    near: float | None = None
    timed: bool = False
    ours: bool = False
    runs: str = "runs"

    def labelled(self, label: str) -> Quantity:
        """Return the quantity with a label before its name."""
        return replace(self, name=f"{label}: {self.name}") if label else self


Numbers = Mapping[Quantity, float]


@dataclass(frozen=True)
class Unprinted:
    """A quantity that numbers depend on and no paper prints ("" is the unit of a plain number),
    with rising values from one end of what is plausible to the other, and why the ends are there.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    why: str

    @property
    def words(self) -> str:
        """Name and plausible range."""
        return f"{self.name} ({self.between((self.values[0], self.values[-1]))} is plausible)"

    def between(self, *parts: Interval) -> str:
        """Return the words for parts of the range."""
        words = " or ".join(f"{low:.3g} to {high:.3g}" for low, high in parts)
        return f"{words} {self.unit}".rstrip()


Interval = tuple[float, float]


def _agreeing(
    values: Sequence[float], numbers: Sequence[float], paper: float, tolerance: float
) -> tuple[Interval, ...]:
    """Return intervals of values whose numbers, on straight lines between runs, are near the
    paper's."""
    found: list[Interval] = []
    for start, end, one, other in zip(
        values[:-1], values[1:], numbers[:-1], numbers[1:], strict=True
    ):
        # The part of this straight piece, from 0 to 1, that lies within the tolerance.
        below, above = paper - tolerance - one, paper + tolerance - one
        slope = other - one
        if slope:
            low, high = sorted((below / slope, above / slope))
        else:
            low, high = (0.0, 1.0) if below <= 0.0 <= above else (1.0, 0.0)
        low, high = max(low, 0.0), min(high, 1.0)
        if low > high:
            continue
        first, last = start + low * (end - start), start + high * (end - start)
        if found and np.isclose(found[-1][1], first):
            first = found.pop()[0]
        found.append((first, last))
    return tuple(found)


def _common(one: Sequence[Interval], other: Sequence[Interval]) -> list[Interval]:
    """Return what two lists of intervals have in common."""
    pairs = [(max(a, c), min(b, d)) for a, b in one for c, d in other]
    return [(low, high) for low, high in pairs if low <= high]


@dataclass(frozen=True, kw_only=True)
class Record:
    """One quantity of one table or figure: the mean of ``n`` runs and their standard deviation
    (None for one), which differ in seed (made sensor and noise) or, if they are exposures, in noise
    alone; the number by cause switched off, and at the values of what isn't printed."""

    quantity: Quantity
    twin: float
    spread: float | None = None
    n: int = 1
    explained_by: Mapping[str, float] = field(default_factory=dict)
    ranges: Mapping[Unprinted, Sequence[float]] = field(default_factory=dict)

    @property
    def tolerance(self) -> float:
        """Difference from the paper within which the two agree."""
        size = abs(self.quantity.paper or 0.0)
        least = self.quantity.near if self.quantity.near is not None else CLOSE * size
        return max(least, min(2.0 * (self.spread or 0.0), MOST * size))

    @property
    def verdict(self) -> str:
        """Agreement with the paper: agrees, explained, ruled out over a range, or not explained."""
        paper = self.quantity.paper
        if paper is None:
            return "the paper gives no number"
        if self.quantity.timed:
            return "a time of another machine"
        if self.quantity.ours:
            return "this project's software on the paper's hardware"
        if not np.isfinite(self.twin):
            return "not defined in the twin"
        gap = abs(self.twin - paper)
        if gap <= self.tolerance:
            return "agrees"
        left = {c: abs(v - paper) for c, v in self.explained_by.items() if np.isfinite(v)}
        best = min(left, key=left.__getitem__, default="")
        if best and left[best] <= min(self.tolerance, 0.5 * gap):
            return f"explained by: {best}"
        for what, within in self.intervals.items():
            if within:
                return f"explained by: {what.words}, {what.between(*within)} gives it"
        if best and left[best] < 0.5 * gap:
            return f"partly explained by: {best}"
        if self.ranges:
            bounds = "; ".join(
                f"{what.words} gives {min(numbers):.3g} to {max(numbers):.3g}"
                for what, numbers in self.ranges.items()
            )
            return f"ruled out: {bounds}"
        return "disagrees, and no modelled cause explains it"

    @property
    def intervals(self) -> dict[Unprinted, tuple[Interval, ...]]:
        """What every range must be for the paper's number."""
        paper = self.quantity.paper
        if paper is None:
            return {}
        return {
            what: _agreeing(what.values, numbers, paper, self.tolerance)
            for what, numbers in self.ranges.items()
        }

    @staticmethod
    def of_runs(
        runs: Sequence[Numbers],
        off: Mapping[str, Numbers] | None = None,
        ranges: Mapping[Unprinted, Sequence[Numbers]] | None = None,
        label: str = "",
    ) -> list[Record]:
        """Return the records of several runs; ones in which a quantity is not defined don't count.
        ``off`` has the numbers with one cause switched off, by name, ``ranges`` those at the values
        of what isn't printed; ``label`` begins the name of every quantity."""
        records = []
        for quantity in runs[0]:
            values = np.array([run[quantity] for run in runs], float)
            known = values[np.isfinite(values)]
            records.append(
                Record(
                    quantity=quantity.labelled(label),
                    twin=float(known.mean()) if len(known) else float("nan"),
                    spread=float(known.std(ddof=1)) if len(known) > 1 else None,
                    n=len(known),
                    explained_by={
                        name: float(run[quantity])
                        for name, run in (off or {}).items()
                        if quantity in run
                    },
                    ranges={
                        what: [float(run[quantity]) for run in numbers]
                        for what, numbers in (ranges or {}).items()
                        if quantity.paper is not None and quantity in numbers[0]
                    },
                )
            )
        return records

    def row(self) -> dict[str, Any]:
        """Return the record as it stands in results.json."""
        what = self.quantity
        return {
            "quantity": what.name,
            "unit": what.unit,
            "twin": _rounded(self.twin),
            "paper": _rounded(what.paper),
            "spread": _rounded(self.spread),
            "n": self.n,
            "runs": what.runs,
            "explained_by": [
                {"cause": cause, "value": _rounded(value)}
                for cause, value in self.explained_by.items()
            ],
            "ranges": [
                {
                    "name": what.name,
                    "unit": what.unit,
                    "why": what.why,
                    "values": list(what.values),
                    "numbers": [_rounded(number) for number in self.ranges[what]],
                    "intervals": [[_rounded(end) for end in part] for part in within],
                }
                for what, within in self.intervals.items()
            ],
            "timed": what.timed,
            "ours": what.ours,
            "difference": None if what.paper is None else _rounded(self.twin - what.paper),
            "verdict": self.verdict,
        }

    @staticmethod
    def settled(
        rows: Sequence[Mapping[str, Any]],
    ) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Compare what isn't printed over all numbers of a paper, given by `row` with the entry's
        name.

        Returns
        -------
        The records, where a number that is explained by a quantity of which others want another
        value is explained in part only; and a row for each such quantity: its paper, name, unit,
        reason and plausible range, the intervals that each number allows, and those that all allow
        at once. Numbers that no value gives allow any.
        """
        found: dict[tuple[str, str], dict[str, Any]] = {}
        for row in rows:
            for what in row["ranges"]:
                if not what["intervals"]:
                    continue
                paper, entry = row["name"].split("/")
                start = {
                    "paper": paper,
                    **{key: what[key] for key in ("name", "unit", "why")},
                    "plausible": [what["values"][0], what["values"][-1]],
                    "at_once": [(what["values"][0], what["values"][-1])],
                    "allowed": [],
                }
                kept = found.setdefault((paper, what["name"]), start)
                number = f"{entry}, {row['quantity']}"
                kept["allowed"].append({"number": number, "intervals": what["intervals"]})
                kept["at_once"] = _common(kept["at_once"], what["intervals"])
        apart = {key for key, kept in found.items() if not kept["at_once"]}
        out = []
        for row in rows:
            verdict = str(row["verdict"])
            names = [name for paper, name in apart if row["name"].startswith(paper)]
            if any(verdict.startswith(f"explained by: {name}") for name in names):
                verdict = f"partly {verdict}, but not all numbers that depend on it at once"
            out.append({**row, "verdict": verdict})
        return out, list(found.values())


def _rounded(value: float | None) -> float | None:
    """Return a number with `DIGITS` significant digits; None for what is not finite."""
    if value is None or not np.isfinite(value):
        return None
    return 0.0 if abs(value) < ROUND_OFF else float(f"{value:.{DIGITS}g}")
