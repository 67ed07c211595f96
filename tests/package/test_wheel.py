"""The built wheel alone, without the checkout: it carries recipes and meshes, and passes quick tests."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import twin

ROOT = Path(__file__).parents[2]
NEWEST = max(
    (
        line.removeprefix("Programming Language :: Python :: ")
        for line in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
        if line.startswith("Programming Language :: Python :: ")
    ),
    key=lambda version: [int(part) for part in version.split(".")],
)
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel of what the container file copies, and unpack it away from the checkout."""
    folder, source = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("source")
    for line in re.findall(r"^COPY (.*) /src", (ROOT / "Containerfile").read_text(), re.MULTILINE):
        for name in line.split():
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy(ROOT / name, source / name)
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=source, check=True, capture_output=True,
    )  # fmt: skip
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def _python(site: Path, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], cwd=cwd, env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_it_carries_every_recipe_and_mesh(site: Path, tmp_path: Path) -> None:
    said = _python(site, "-c", "import twin; print(twin.__file__)", cwd=tmp_path)
    assert Path(said.stdout.strip()).is_relative_to(site), "the checkout answered, not the wheel"
    for folder in ("meshes", "scenes"):
        carried = {path.name for path in (site / "twin" / folder).iterdir()}
        assert carried == {path.name for path in (ROOT / folder).iterdir() if path.is_file()}


def test_every_package_folder_is_in_it(site: Path) -> None:
    package = Path(twin.__file__).parent
    wanted = {path.relative_to(package) for path in package.rglob("*.py")}
    assert wanted == {path.relative_to(site / "twin") for path in (site / "twin").rglob("*.py")}


def test_the_main_job_runs_from_it(site: Path, tmp_path: Path) -> None:
    ran = _python(site, "-m", "twin", "run", "block_bare", "--want", "displacement", "--out", "here", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "here" / "truth.npz").is_file()


def test_quick_tests_pass_from_it(site: Path, tmp_path: Path) -> None:
    for folder in ("tests", "benchmarks"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    reading = [f"tests/{name}" for name in ("parts", "judge")]
    ran = _python(site, "-m", "pytest", "-q", "-n0", *reading, cwd=tmp_path)
    assert ran.returncode == 0, ran.stdout[-3000:]


def test_the_newest_python_that_is_claimed_gives_the_same_result(site: Path, tmp_path: Path) -> None:
    """Install the wheel and what it needs for that Python, where this machine has it."""
    if f"{sys.version_info.major}.{sys.version_info.minor}" == NEWEST:
        pytest.skip("all tests run by this one")
    installed = sorted((Path.home() / ".pyenv" / "versions").glob(f"{NEWEST}.*/bin/python"))
    python = installed[-1] if installed else shutil.which(f"python{NEWEST}")
    if python is None:
        pytest.skip(f"no Python {NEWEST} here")
    (wheel,) = site.parent.glob("*.whl")
    subprocess.run([python, "-m", "venv", tmp_path / "its"], check=True)
    subprocess.run([tmp_path / "its/bin/pip", "install", "-q", wheel], check=True)
    bare = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    cache = {"TWIN_CACHE": str(tmp_path / "cache")}
    ran = subprocess.run(
        [tmp_path / "its/bin/twin", "run", "first_press", "--out", "here"],
        cwd=tmp_path, env=bare | cache, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    theirs = json.loads((tmp_path / "here" / "score.json").read_text())["force"]
    ours = twin.run("first_press").score["force"]
    assert theirs["field_error"] == pytest.approx(ours["field_error"], rel=1e-9)
