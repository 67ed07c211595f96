"""Tutorials: how notebooks are executed and shown; those of the pages run when the documentation is built."""

import json
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what executes a page and returns the folder of what it made."""
    for package in ("nbclient", "ipykernel"):
        pytest.importorskip(package, reason="of the extra 'docs'", exc_type=ImportError)
    monkeypatch.syspath_prepend(str(DOCS))
    import make_tutorials

    def made(text: str) -> Path:
        source = tmp_path / "source"
        source.mkdir()
        (source / "page.md").write_text(text)
        monkeypatch.setattr(make_tutorials, "SOURCES", source)
        make_tutorials.make_tutorials(tmp_path / "made")
        return tmp_path / "made"

    return made


@pytest.mark.filterwarnings("ignore")  # of the kernel's own
def test_output_and_figures_stand_below_their_block(run: Any) -> None:
    imports = "from pathlib import Path\nimport matplotlib.pyplot as plt\n"
    code = imports + "plt.plot([0, 1], color='black')\nprint(Path('a.toml').read_text()[:8])\n"
    made = run(f"```toml\n# a.toml\nx = 1\n```\n\n```python\n{code}```\n\n```sh\ntwin --version\n```\n")
    page = (made / "page.md").read_text()
    assert "```text\n# a.toml\n```" in page
    assert "(page_1.png)" in page
    light, dark = ((made / f"page_1{end}.png").read_bytes() for end in ("", "_dark"))
    assert len(light) > 1000
    assert len(dark) > 1000
    assert light != dark
    assert "```text\n" in page.partition("twin --version")[2]
    notebook = json.loads((made / "page.ipynb").read_text())
    sources = ["".join(cell["source"]) for cell in notebook["cells"]]
    assert sources == ["%%writefile a.toml\n# a.toml\nx = 1", code.strip(), "%%bash -e\ntwin --version"]
    assert all(cell["outputs"] for cell in notebook["cells"]), "a notebook keeps what it printed"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("block", ["```python\nassert False\n```\n", "```sh\ntwin run nowhere\ntwin --version\n```\n"])
def test_a_block_that_fails_stops_the_build(block: str, run: Any) -> None:
    from nbclient.exceptions import CellExecutionError

    with pytest.raises(CellExecutionError, match=r"AssertionError|exit status 2"):
        run(block)


def test_measured_figures_have_a_dark_one() -> None:
    pictures = {path.stem for path in DOCS.glob("*.png")}
    light = {name for name in pictures if not name.endswith("_dark")}
    assert light
    assert {f"{name}_dark" for name in light} == pictures - light


def test_every_page_is_in_the_sidebar() -> None:
    index = (DOCS / "index.md").read_text()
    pages = {page.stem for page in DOCS.glob("*.md")} - {"index"}
    pages |= {f"made/tutorials/{page.stem}" for page in (DOCS / "tutorials").glob("*.md")}
    assert not [page for page in pages if f"\n{page}\n" not in index]
