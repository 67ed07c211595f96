"""The tutorials: each is executed as a notebook, and its page shows what the notebook printed and drew.

A block that fails stops the build of the documentation. `python docs/make_tutorials.py NAME` runs one alone.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from base64 import b64decode
from pathlib import Path
from typing import Any

import nbclient
import nbformat
from nbformat import v4

from twin.cli import app

SOURCES = Path(__file__).parent / "tutorials"
ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"```(sh|python|toml)\n(.*?)```\n", re.DOTALL)
FILE = re.compile(r"# (\S+\.toml)\n")
LONGEST_S = 600
"""Seconds after which a cell is given up: a first one also compiles, and machines differ."""

SETUP = """
from pathlib import Path
from IPython import get_ipython
from matplotlib.figure import Figure
from benchmarks.dark_figures import save_both

def _both(figure):
    name = f"figure_{len(list(Path().glob('figure_*_dark.png')))}.png"
    save_both(figure, Path(name), bbox_inches="tight", dpi=110)
    return Path(name).read_bytes()

%matplotlib inline
get_ipython().ast_node_interactivity = "none"
get_ipython().display_formatter.formatters["image/png"].for_type(Figure, _both)
"""
"""Run before a tutorial: figures are also saved as they look on dark pages."""


def make_tutorials(folder: Path, names: tuple[str, ...] = ()) -> None:
    """Execute the tutorials; write their notebooks, pages and figures into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for source in sorted(SOURCES.glob("*.md")):
        if names and source.stem not in names:
            continue
        text = source.read_text(encoding="utf-8")
        notebook = _notebook(text)
        with tempfile.TemporaryDirectory() as work:
            _execute(notebook, Path(work))
            page = _page(text, notebook, folder / source.stem, Path(work))
        nbformat.write(notebook, folder / f"{source.stem}.ipynb")
        page += f"\nThis page as a notebook: {{download}}`{source.stem}.ipynb <{source.stem}.ipynb>`.\n"
        (folder / source.name).write_text(page, encoding="utf-8")


def _notebook(text: str) -> Any:
    """Return a tutorial as a notebook: a cell for each block, one for the text between two."""
    cells = []
    for number, part in enumerate(BLOCK.split(text)):
        if number % 3 == 0 and part.strip():
            cells.append(v4.new_markdown_cell(part.strip()))
        elif number % 3 == 1:
            kind = part
        elif number % 3 == 2:
            before = {"python": "", "sh": "%%bash -e\n", "toml": "%%writefile {}\n"}[kind]
            if kind == "toml":
                before = before.format(FILE.match(part)[1])  # type: ignore[index]
            cells.append(v4.new_code_cell(before + part.rstrip()))
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def _execute(notebook: Any, work: Path) -> None:
    """Run every cell in a kernel of this environment, in the folder ``work``; the first that fails raises."""
    scripts = str(Path(sys.executable).parent)
    paths = {"PATH": os.pathsep.join((scripts, os.environ["PATH"])), "PYTHONPATH": str(ROOT)}
    notebook.cells.insert(0, v4.new_code_cell(SETUP))
    client = nbclient.NotebookClient(
        notebook,
        timeout=LONGEST_S,
        coalesce_streams=True,
        record_timing=False,
        resources={"metadata": {"path": work}},
    )
    client.execute(env={**os.environ, **paths})
    del notebook.cells[0]


def _page(text: str, notebook: Any, stem: Path, work: Path) -> str:
    """Return the page: what each cell printed and drew stands below it; figures are ``stem``_1.png, and so on."""
    outputs = iter([cell.outputs for cell in notebook.cells if cell.cell_type == "code"])
    count = 0

    def below(block: re.Match[str]) -> str:
        nonlocal count
        made = next(outputs)
        printed = "".join(o.text for o in made if o.output_type == "stream" and o.name == "stdout")
        shown = f"\n```text\n{printed.rstrip()}\n```\n" if printed.strip() and block[1] != "toml" else ""
        for picture in (o.data["image/png"] for o in made if "image/png" in o.get("data", {})):
            (work / f"figure_{count}_dark.png").replace(f"{stem}_{count + 1}_dark.png")
            count += 1
            Path(f"{stem}_{count}.png").write_bytes(b64decode(picture))
            shown += f"\n![Figure drawn by the code above]({stem.name}_{count}.png)\n"
        return block[0] + shown

    return BLOCK.sub(below, text)


def make_commands(path: Path) -> None:
    """Write the page of the command line: the help of every command."""
    lines = ["# The command line: help of every command", "", "What `twin --help` and `twin COMMAND --help` print."]
    wide = {**os.environ, "COLUMNS": "84"}
    for name in ["", *sorted(name for name in app if not name.startswith("-"))]:
        command = [sys.executable, "-m", "twin", *name.split(), "--help"]
        said = subprocess.run(command, capture_output=True, text=True, check=True, env=wide).stdout
        lines += ["", f"## twin {name}".rstrip(), "", "```text", said.strip(), "```"]
    path.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    make_tutorials(Path(__file__).parent / "made" / "tutorials", tuple(sys.argv[1:]))
