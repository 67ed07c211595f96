"""The tutorials: every block of shell and Python in them is run, with its output and figures put below it, and each is
also written as a notebook.

A block that fails stops the build of the documentation. `python docs/make_tutorials.py NAME` runs one alone.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib

from twin.cli import app

SOURCES = Path(__file__).parent / "tutorials"
BLOCK = re.compile(r"```(sh|python|toml)\n(.*?)```\n", re.DOTALL)
FILE = re.compile(r"# (\S+\.toml)\n")


def make_tutorials(folder: Path, names: tuple[str, ...] = ()) -> None:
    """Run the tutorials and write their pages and figures into ``folder``."""
    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    here = Path.cwd()
    for source in sorted(SOURCES.glob("*.md")):
        if names and source.stem not in names:
            continue
        with tempfile.TemporaryDirectory() as work:
            try:
                os.chdir(work)
                text = source.read_text(encoding="utf-8")
                page = _run(text, folder / source.stem)
            finally:
                os.chdir(here)
        (folder / f"{source.stem}.ipynb").write_text(json.dumps(_notebook(text), indent=1), encoding="utf-8")
        page += f"\nThis page as a notebook: {{download}}`{source.stem}.ipynb <{source.stem}.ipynb>`.\n"
        (folder / source.name).write_text(page, encoding="utf-8")


def _notebook(text: str) -> dict[str, object]:
    """Return a tutorial as a Jupyter notebook without outputs; its blocks are the same."""
    cells: list[dict[str, object]] = []
    for number, part in enumerate(BLOCK.split(text)):
        if number % 3 == 1:
            kind = part
            continue
        if number % 3 == 0:
            cell: dict[str, object] = {"cell_type": "markdown"}
        else:
            cell = {"cell_type": "code", "outputs": [], "execution_count": None}
            if kind == "toml":
                part = f"%%writefile {FILE.match(part)[1]}\n{part}"  # type: ignore[index]
            elif kind == "sh":
                part = "".join(f"!{line}\n" for line in part.splitlines())
        if part.strip():
            lines = part.strip().splitlines(keepends=True)
            cells.append({"id": f"cell-{number}", "metadata": {}, "source": lines} | cell)
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def _run(text: str, stem: Path) -> str:
    """Return a tutorial's page; figures are written to ``stem``_1.png, and so on."""
    names: dict[str, object] = {}
    figures: list[Path] = []

    def shown(block: re.Match[str]) -> str:
        kind, code = block.groups()
        if kind == "toml":  # a file whose name is its first line
            Path(FILE.match(code)[1]).write_text(code, encoding="utf-8")  # type: ignore[index]
            return block[0]
        said = _python(code, names) if kind == "python" else _shell(code)
        below = f"\n```text\n{said.rstrip()}\n```\n" if said.strip() else ""
        return block[0] + below + _drawn(stem, figures)

    return BLOCK.sub(shown, text)


def _python(code: str, names: dict[str, object]) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(code, "tutorial", "exec"), names)
    return out.getvalue()


def _shell(code: str) -> str:
    """Run commands of `twin`, a line each, and return what they print."""
    said = []
    for line in code.strip().splitlines():
        _, *arguments = shlex.split(line)
        command = [sys.executable, "-m", "twin", *arguments]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{line}: exit code {done.returncode}\n{done.stderr}")
        said.append(done.stdout)
    return "".join(said)


def _drawn(stem: Path, figures: list[Path]) -> str:
    """Save and close the open figures; return the lines that show them."""
    import matplotlib.pyplot as plt

    lines = []
    for number in plt.get_fignums():
        figures.append(stem.with_name(f"{stem.name}_{len(figures) + 1}.png"))
        plt.figure(number).savefig(figures[-1], dpi=110)
        lines.append(f"\n![Figure drawn by the code above]({figures[-1].name})\n")
    plt.close("all")
    return "".join(lines)


def make_commands(path: Path) -> None:
    """Write the page of the command line: the help of every command."""
    lines = ["# The command line", "", "What `twin COMMAND --help` prints.", ""]
    wide = {**os.environ, "COLUMNS": "100"}
    for name in sorted(name for name in app if not name.startswith("-")):
        command = [sys.executable, "-m", "twin", name, "--help"]
        said = subprocess.run(command, capture_output=True, text=True, check=True, env=wide).stdout
        lines += [f"## twin {name}", "", "```text", said.strip(), "```", ""]
    path.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    make_tutorials(Path(__file__).parent / "made" / "tutorials", tuple(sys.argv[1:]))
