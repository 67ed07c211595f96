"""The README's Python blocks run."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_the_python_block_prints_what_its_comment_shows(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (start,) = re.findall(r"print\(state\)  # (.*?)\.\.\.", block)
    exec(compile(block, "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith(start)


def test_no_text_asks_to_install_what_no_index_has() -> None:
    """The distribution is on no package index: extras are installed by their own names, or from a checkout."""
    texts = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "twin").rglob("*.py")]
    assert not [str(path) for path in texts if "install 'tactile-twin" in path.read_text()]
