"""The page on architecture names files that exist, and names that they define."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
ROWS = re.findall(r"^\| (.+) \| (`twin/[^|]+`) \| (.*) \|$", PAGE, re.MULTILINE)


def test_what_is_to_be_opened_is_there():
    assert len(ROWS) > 15
    for change, files, names in ROWS:
        source = "\n".join((ROOT / file).read_text() for file in re.findall(r"`([^`]+)`", files))
        for name in re.findall(r"`(\w+)`", names):
            assert re.search(rf"^(class|def) {name}\b|^{name}\b[^\n]* =", source, re.MULTILINE), (change, files, name)


def test_the_way_of_a_press_names_files():
    for file in re.findall(r"\b((?:study|sense|judge|show)/\w+\.py)\b", PAGE):
        assert (ROOT / "twin" / file).is_file(), file
