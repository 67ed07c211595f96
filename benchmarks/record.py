"""Results as rows: stored in benchmarks/results, printed as tables; and the numbers that options take."""

import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

Row = dict[str, Any]
Count = Annotated[int, Parameter(validator=Number(gte=1))]
Natural = Annotated[int, Parameter(validator=Number(gte=0))]
"""Whole numbers of options: from 1, and from 0."""

RESULTS = Path(__file__).parent / "results"


def read(name: str) -> dict[str, Any]:
    """Return all that is stored under a name, nothing if it never ran."""
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text()) if path.is_file() else {}


def write(name: str, found: dict[str, Any]) -> None:
    """Store results under a name."""
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n")


def stored(name: str) -> list[Row]:
    """Return the rows that are stored under a name."""
    return list(read(name).get("rows", []))


def store(name: str, rows: list[Row], **more: Any) -> None:
    """Store rows with the machine that they were measured on."""
    write(name, {"machine": machine(), **more, "rows": rows})


def table(rows: Sequence[Row]) -> str:
    """Return rows as a Markdown table."""
    if not rows:
        return "(no rows)"
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = [[_heading(column) for column in columns], ["---"] * len(columns)]
    lines += [[_cell(row.get(column, "")) for column in columns] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


UNITS = {"s": "s", "ms": "ms", "px": "px", "mm": "mm", "n": "N", "kb": "kB", "gib": "GiB"}


def _heading(column: str) -> str:
    """Return a column's name as words, its unit last."""
    words = column.replace("cpu_", "CPU_").split("_")
    if len(words) == 1 or words[-1] not in UNITS or "per" in words:
        return " ".join(words)
    return f"{' '.join(words[:-1])}, {UNITS[words[-1]]}"


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def machine() -> dict[str, Any]:
    """Return what the figures were measured on."""
    facts = Path("/proc/cpuinfo")
    lines = facts.read_text().splitlines() if facts.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": names[0] if names else platform.processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
    }
