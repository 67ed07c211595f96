"""Architecture, README, docstrings, the recipe reference and the page on an own sensor hold what they say."""

import doctest
import importlib.util
import re
import shlex
from pathlib import Path

import pytest

import twin
from twin.files import png_bytes
from twin.parts.scene import Scene

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
ROWS = re.findall(r"^\| (.+) \| (`twin/[^|]+`) \| (.*) \|$", PAGE, re.MULTILINE)


def test_what_is_to_be_opened_is_there():
    assert len(ROWS) > 15
    for change, files, names in ROWS:
        source = "\n".join((ROOT / file).read_text() for file in re.findall(r"`([^`]+)`", files))
        for name in ".".join(re.findall(r"`([\w.]+)[^`]*`", names)).split("."):
            defined = rf"^ *(class|def) {name}\b|^ *{name}\b[^\n]*[=:]"
            assert re.search(defined, source, re.MULTILINE), (change, files, name)


def test_the_way_of_a_press_names_files():
    for file in re.findall(r"\b((?:study|sense|judge|show)/\w+\.py)\b", PAGE):
        assert (ROOT / "twin" / file).is_file(), file


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


LONG = {"Environment", "Observation", "reconstruct"}
"""Examples with pictures."""

NAMES = [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in twin.__all__]


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_public_name_runs(name: str) -> None:
    finder = doctest.DocTestFinder(recurse=False)
    (found,) = finder.find(getattr(twin, name), name, globs={})
    assert found.examples, "help() shows no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    lines: list[str] = []
    runner.run(found, out=lines.append)
    assert not runner.failures, "".join(lines)


DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def recipes(tmp_path_factory: pytest.TempPathFactory) -> str:
    spec = importlib.util.spec_from_file_location("make_recipes", DOCS / "make_recipes.py")
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    path = tmp_path_factory.mktemp("docs") / "recipes.md"
    maker.make_recipes(path)
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("key", [key for key in Scene.model_fields if key not in {"source", "assumed"}])
def test_every_key_of_a_scene_is_there(recipes: str, key: str) -> None:
    assert f"| `{key}` |" in recipes


def test_a_key_has_unit_range_and_meaning(recipes: str) -> None:
    (row,) = [line for line in recipes.splitlines() if line.startswith("| `poisson_ratio` |") and "0.5" in line][:1]
    assert "≤ 0.5" in row
    (row,) = [line for line in recipes.splitlines() if line.startswith("| `apex_deg` |")]
    assert "| deg |" in row
    assert "≥ 20, ≤ 178" in row


def test_links_lead_somewhere(recipes: str) -> None:
    wanted = {part.split(")")[0] for part in recipes.split("](#")[1:]}
    there = {line[1:-2] for line in recipes.splitlines() if line.startswith("(recipe-")}
    assert wanted <= there


def test_a_width_is_quoted_or_the_site_shows_it_as_text() -> None:
    sources = [*DOCS.glob("*.md"), *DOCS.glob("*.py")]
    assert not [path.name for path in sources if re.search(r"\{+width=[^\"\\]", path.read_text(encoding="utf-8"))]


OWN_SENSOR = (Path(__file__).parents[2] / "docs" / "own_sensor.md").read_text()
COMMANDS = "".join(re.findall(r"^```sh\n(.*?)^```$", OWN_SENSOR, re.M | re.S)).replace("\\\n", "").splitlines()


def test_the_commands_of_the_page_run(tmp_path, monkeypatch, says):
    monkeypatch.chdir(tmp_path)
    told = []
    for command in COMMANDS:
        if "rest1.png" in command and not Path("rest1.png").exists():
            sensor = twin.Sensor(twin.load_scene("mine.toml"))
            Path("rest1.png").write_bytes(png_bytes(sensor.picture(None)))
        if "rest2.png" in command:
            continue  # `tests/study/test_camera.py`: it solves the body for the error of forces
        told.append(says(0, *shlex.split(command)[1:]))
    assert ": ok" in told[1]
    assert "without source" not in told[1]
    assert "324 dark dots, 18 columns x 18 rows, square" in told[2]
    assert {"markers.toml", "markers.png"} <= {path.name for path in tmp_path.iterdir()}
