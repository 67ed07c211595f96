"""The page on sweeps: ``python -m benchmarks.sweep_page`` puts the stored rows into docs/sweeps.md."""

from __future__ import annotations

import json
import re
from typing import Any

from benchmarks import ROOT
from benchmarks.__main__ import table
from benchmarks.sweep import STORED

PAGE = ROOT / "docs" / "sweeps.md"
MARKS = r"(<!-- results -->\n).*?(<!-- end of results -->)"


def page_tables() -> str:
    """Return the Markdown between the page's marks."""
    stored: dict[str, Any] = json.loads(STORED.read_text())
    rates = [row for row in stored["rows"] if "designs_per_s" in row]
    others = [row for row in stored["rows"] if "designs_per_s" not in row]
    parts = ["", table(rates), "", table(others), "", f"On {stored['machine']['processor']}.", ""]
    return "\n".join(parts)


def main() -> None:
    """Write the page."""
    text = PAGE.read_text()
    PAGE.write_text(re.sub(MARKS, lambda found: found.group(1) + page_tables() + found.group(2), text, flags=re.DOTALL))


if __name__ == "__main__":
    main()
