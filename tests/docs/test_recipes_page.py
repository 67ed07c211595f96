"""The recipe reference is made from the descriptions: every table and key is on it, with what is allowed."""

import importlib.util
import re
from pathlib import Path

import pytest

from twin.parts.scene import Scene

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    spec = importlib.util.spec_from_file_location("make_recipes", DOCS / "make_recipes.py")
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    path = tmp_path_factory.mktemp("docs") / "recipes.md"
    maker.make_recipes(path)
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("key", [key for key in Scene.model_fields if key not in {"source", "assumed"}])
def test_every_key_of_a_scene_is_there(page: str, key: str) -> None:
    assert f"| `{key}` |" in page


def test_a_key_has_unit_range_and_meaning(page: str) -> None:
    (row,) = [line for line in page.splitlines() if line.startswith("| `poisson_ratio` |") and "0.5" in line][:1]
    assert "≤ 0.5" in row
    (row,) = [line for line in page.splitlines() if line.startswith("| `apex_deg` |")]
    assert "| deg |" in row
    assert "≥ 20, ≤ 178" in row


def test_links_lead_somewhere(page: str) -> None:
    wanted = {part.split(")")[0] for part in page.split("](#")[1:]}
    there = {line[1:-2] for line in page.splitlines() if line.startswith("(recipe-")}
    assert wanted <= there


def test_a_width_is_quoted_or_the_site_shows_it_as_text() -> None:
    sources = [*DOCS.glob("*.md"), *DOCS.glob("*.py")]
    assert not [path.name for path in sources if re.search(r"\{+width=[^\"\\]", path.read_text(encoding="utf-8"))]
