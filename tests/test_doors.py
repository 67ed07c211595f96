"""Who may import whom: parts and theory stay light, world and sense never meet, heavy packages have one home."""

import ast
import importlib.metadata
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import twin

PACKAGE = Path(twin.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
HOMES = {
    "mitsuba": {"world/picture/backend.py", "world/picture/path_tracer.py"},
    "drjit": {"world/picture/backend.py", "world/picture/path_tracer.py"},
    "pytetwild": {"world/mesh/tetrahedralise.py"},
    "mmgpy": {"world/mesh/tetrahedralise.py"},
    "pypardiso": {"world/elasticity/factor.py"},
    "scipy.sparse.linalg": {"world/elasticity/factor.py"},
    "pyvista": {"world/mesh/quadratic_mesh.py", "world/mesh/body_mesh.py"},
    "trimesh": {"study/view.py", "world/mesh/body_mesh.py", "world/picture/stock_scene.py"},
    "numba": {"compiled.py", "world/picture/backend.py"},
    "pickle": set(),
}


@cache
def imports(file: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def wing(file: Path) -> str:
    parts = file.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else ""


ROOMS = {"mesh": set(), "elasticity": {"mesh"}, "contact": {"mesh", "elasticity"}, "picture": set()}
"""What each room of the world may import of the others."""


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_rooms_of_the_world_build_on_one_another(room: str) -> None:
    others = [f"twin.world.{other}." for other in ROOMS if other != room and other not in ROOMS[room]]
    files = sorted((PACKAGE / "world" / room).glob("*.py"))
    assert len(files) > 5
    for file in files:
        crossing = {name for name in imports(file) if any(f"{name}.".startswith(other) for other in others)}
        assert not crossing, f"{file.name} imports {crossing}"


@pytest.mark.parametrize(
    ("from_wing", "forbidden"),
    [
        ("world", ["sense", "judge", "study", "show"]),
        ("sense", ["world", "judge", "study", "show"]),
        ("judge", ["world", "sense", "study", "show"]),
        ("show", ["world", "sense", "judge", "study"]),
        ("parts", ["world", "sense", "judge", "study", "show", "theory"]),
        ("theory", ["world", "sense", "judge", "study", "show"]),
        ("geometry", ["world", "sense", "judge", "study", "show", "parts", "theory"]),
    ],
)
def test_doors_between_the_wings(from_wing: str, forbidden: list[str]) -> None:
    files = [file for file in FILES if wing(file) == from_wing]
    assert files
    for file in files:
        crossing = {name for name in imports(file) if any(name.startswith(f"twin.{door}") for door in forbidden)}
        assert not crossing, f"{file.name} imports {crossing}"


def test_no_files_import_each_other_in_a_circle() -> None:
    """Data flow one way: imports within functions and for types count too; `twin` itself only lists names."""
    names = {".".join(("twin", *file.relative_to(PACKAGE).with_suffix("").parts)): file for file in FILES}
    waiting = {name: imports(file) & names.keys() - {name} for name, file in names.items()}
    while free := [name for name, wanted in waiting.items() if not wanted & waiting.keys()]:
        for name in free:
            del waiting[name]
    assert not waiting, f"in a circle, or above one: {sorted(waiting)}"


@pytest.mark.parametrize("package", sorted(HOMES))
def test_heavy_packages_have_one_home(package: str) -> None:
    users = {
        file.relative_to(PACKAGE).as_posix()
        for file in FILES
        if any(name == package or name.startswith(f"{package}.") for name in imports(file))
    }
    assert users <= HOMES[package]


@pytest.mark.parametrize("folder", ["parts", "theory"])
def test_descriptions_and_closed_forms_are_light(folder: str) -> None:
    allowed = {"numpy", "scipy.special", "pydantic", "tomli_w", "twin", "numba"} | set(sys.stdlib_module_names)
    for file in (f for f in FILES if wing(f) == folder):
        heavy = {n for n in imports(file) if n not in allowed and not any(n.startswith(f"{a}.") for a in allowed)}
        assert not heavy, f"{file.name} imports {heavy}"


@pytest.mark.parametrize(
    "code", ["import twin", "from twin.cli import app", "import twin; twin.Press, twin.load_scene"]
)
def test_importing_loads_no_heavy_package(code: str) -> None:
    heavy = ["mitsuba", "drjit", "pytetwild", "mmgpy", "pyvista", "trimesh", "scipy", "numba", "matplotlib"]
    check = f"{code}; import sys; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_version_is_the_distribution_s() -> None:
    assert twin.__version__ == importlib.metadata.version("tactile-twin")
