"""The pages on adding a part are followed, word by word, on a copy of the program, and their own check is run.

A copy, because what they tell to change is the program's source.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import twin

ROOT = Path(__file__).parents[2]
PACKAGE = Path(twin.__file__).parent
PAGES = sorted((ROOT / "docs").glob("add_*.md"))
BLOCK = re.compile(r"^```(diff|python)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
ADDED = {
    "add_body": "puck",
    "add_friction_law": "ShearStrength",
    "add_lens": "stereographic",
    "add_material": "gent",
    "add_method": "curved",
    "add_probe": "roller",
    "add_renderer": "discs",
    "add_tracker": "squared",
}
"""What each page adds."""

ONE_PAGE = 120
"""Lines of a page, its code included."""


def blocks(page: Path) -> list[tuple[str, str]]:
    return [(kind, text) for kind, text in BLOCK.findall(page.read_text())]


def patched(text: str, diff: str) -> str:
    """Return a file with one change: lines marked - and unmarked ones must stand there, once, in this order."""
    lines = diff.splitlines()
    old = "".join(line[1:] + "\n" for line in lines if line[:1] in (" ", "-"))
    new = "".join(line[1:] + "\n" for line in lines if line[:1] in (" ", "+"))
    assert all(line[:1] in (" ", "+", "-") for line in lines), "a line without its mark"
    assert text.count(old) == 1, f"this stands {text.count(old)} times in the file:\n{old}"
    return text.replace(old, new)


def follow(page: Path, root: Path) -> str:
    """Change the copy as the page says; return the check that it ends with."""
    check = ""
    for kind, text in blocks(page):
        head, _, rest = text.partition("\n")
        if kind == "diff":
            file = root / head.removeprefix("--- ")
            file.write_text(patched(file.read_text(), rest))
        elif head.startswith("# file: "):
            file = root / head.removeprefix("# file: ")
            assert not file.exists()
            file.write_text(rest)
        else:
            assert not check, "one check a page"
            check = text
    return check


def test_there_is_a_page_for_each() -> None:
    assert {page.stem for page in PAGES} == set(ADDED)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_changes_stands_there_and_fits_a_page(page: Path, tmp_path: Path) -> None:
    assert len(page.read_text().splitlines()) <= ONE_PAGE
    for kind, text in blocks(page):
        if kind == "diff":
            (tmp_path / text.partition("\n")[0].removeprefix("--- ")).parent.mkdir(parents=True, exist_ok=True)
            file = text.partition("\n")[0].removeprefix("--- twin/")
            shutil.copy(PACKAGE / file, tmp_path / "twin" / file)
    check = follow(page, tmp_path)
    assert "assert" in check
    for file in tmp_path.rglob("*.py"):
        compile(file.read_text(), str(file), "exec")


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_following_a_page_adds_what_it_says(page: Path, tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "twin")  # with what numba has compiled, as long as sources don't change
    for folder in ("meshes", "scenes"):
        if (ROOT / folder).is_dir() and not (tmp_path / "twin" / folder).exists():
            (tmp_path / folder).symlink_to(ROOT / folder)
    (tmp_path / "check.py").write_text(follow(page, tmp_path))
    told = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ran = subprocess.run([sys.executable, "check.py"], cwd=tmp_path, env=told, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr[-3000:]


def test_the_check_of_a_page_fails_where_nothing_was_added() -> None:
    for page in PAGES:
        check = [text for kind, text in blocks(page) if kind == "python" and not text.startswith("# file: ")]
        name = ADDED[page.stem]
        assert f'"{name}"' in check[0]
        used = "\n".join(file.read_text() for file in PACKAGE.rglob("*.py"))
        assert f'"{name}"' not in used, "the page adds what is there"
