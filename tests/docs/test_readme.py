"""The README's Python blocks run."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_python_block_runs(number: int) -> None:
    exec(compile(BLOCKS[number], f"README.md, block {number + 1}", "exec"), {})


def test_there_is_a_block_to_run() -> None:
    assert BLOCKS


def test_no_text_asks_to_install_what_no_index_has() -> None:
    """The distribution is on no package index: extras are installed by their own names, or from a checkout."""
    texts = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "twin").rglob("*.py")]
    assert not [str(path) for path in texts if "install 'tactile-twin" in path.read_text()]
