"""Tutorials: the mechanism that runs their blocks; the pages themselves are run when the documentation is built."""

import json
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS))

import make_tutorials  # noqa: E402


def run(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "page.md").write_text(text)
    monkeypatch.setattr(make_tutorials, "SOURCES", tmp_path / "source")
    make_tutorials.make_tutorials(tmp_path / "made")
    return (tmp_path / "made" / "page.md").read_text()


def test_output_and_figures_stand_below_their_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imports = "from pathlib import Path\nimport matplotlib.pyplot as plt\n"
    code = imports + "plt.subplots()\nprint(Path('a.toml').read_text()[:8])\n"
    text = f"```toml\n# a.toml\nx = 1\n```\n\n```python\n{code}```\n\n```sh\ntwin --version\n```\n"
    page = run(text, tmp_path, monkeypatch)
    assert "```text\n# a.toml\n```" in page
    assert "(page_1.png)" in page
    assert (tmp_path / "made" / "page_1.png").stat().st_size > 1000
    assert "```text\n" in page.partition("twin --version")[2]
    notebook = json.loads((tmp_path / "made" / "page.ipynb").read_text())
    sources = ["".join(cell["source"]) for cell in notebook["cells"]]
    assert sources == ["%%writefile a.toml\n# a.toml\nx = 1", code.strip(), "!twin --version"]
    assert {cell["cell_type"] for cell in notebook["cells"]} == {"code"}


@pytest.mark.parametrize("block", ["```python\nassert False\n```\n", "```sh\ntwin run nowhere\n```\n"])
def test_a_block_that_fails_stops_the_build(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises((AssertionError, RuntimeError)):
        run(block, tmp_path, monkeypatch)


def test_every_page_is_in_the_sidebar() -> None:
    index = (DOCS / "index.md").read_text()
    pages = {page.stem for page in DOCS.glob("*.md")} - {"index"}
    pages |= {f"made/tutorials/{page.stem}" for page in (DOCS / "tutorials").glob("*.md")}
    assert not [page for page in pages if f"\n{page}\n" not in index]
