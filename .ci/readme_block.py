"""Print the README's block that is marked ``<!-- block: NAME -->``, so that CI runs what newcomers
type."""

from __future__ import annotations

import re
import sys
from pathlib import Path

text = (Path(__file__).parent.parent / "README.md").read_text()
found = re.findall(rf"<!-- block: {sys.argv[1]} -->\s*```sh\n(.*?)```", text, re.DOTALL)
if len(found) != 1:
    sys.exit(f"README.md: {len(found)} blocks are marked '{sys.argv[1]}', expected one")
print(found[0])
