"""The README's result tables, from benchmarks/results: ``python -m benchmarks.readme`` puts them in."""

from __future__ import annotations

import json
import re
from pathlib import Path

from benchmarks.__main__ import RESULTS, table

README = Path(__file__).parent.parent / "README.md"
TITLES = {
    "elasticity": "Elasticity, against the reference fields (error: largest over all points, relative)",
    "picture": "Picture, 640x480, against a converged picture",
    "chain": "Whole chain, one press",
}


def results_section() -> str:
    """Return the Markdown between the README's two result marks."""
    parts = []
    for stage, title in TITLES.items():
        stored = RESULTS / f"{stage}.json"
        if stored.is_file():
            result = json.loads(stored.read_text())
            machine = result["machine"]
            parts.append(
                f"**{title}.** On {machine['processor']}, {machine['cores']} cores.\n\n{table(result['rows'])}\n"
            )
    return "\n".join(["", *parts]) if parts else ""


if __name__ == "__main__":
    text = README.read_text()
    marks = r"(<!-- results -->\n).*?(<!-- end of results -->)"
    README.write_text(re.sub(marks, lambda m: m.group(1) + results_section() + m.group(2), text, flags=re.DOTALL))
