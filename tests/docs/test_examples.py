"""The examples run as they stand; how notebooks are executed and shown."""

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.study.intrinsics import read_intrinsics

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Pressed:
    """Stands in for a dataset: shifts that are a linear picture of the force, in a known direction per marker."""

    def __init__(self, count: int) -> None:
        rng = np.random.default_rng(3)
        self.map = rng.normal(size=(3, 12, 2))
        self.force = rng.normal(size=(count, 3))

    def __iter__(self) -> Any:
        for force in self.force:
            shift = np.einsum("f,fmi->mi", force, self.map)
            yield {"status": "ok", "sensor": 0, "marker_pressed_px": 5.0 + shift, "force_n": force}

    def sensor(self, number: int) -> dict[str, Any]:
        assert number == 0
        return {
            "actual": '{"material": {"youngs_modulus_mpa": 1.0}}', "marker_layer": '[["red", 6], ["blue", 6]]',
            "marker_rest_px": np.full((12, 2), 5.0),
        }  # fmt: skip


def test_the_ridge_finds_a_force_that_shifts_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    read_force = example("read_force")
    monkeypatch.setattr(read_force.twin, "open_dataset", lambda folder: Pressed(400), raising=False)
    found = read_force.compare("anywhere")
    assert found["ridge"] < 0.02
    assert found["ridge"] < 0.5 * found["mean shift"] < found["mean force"]


@pytest.mark.slow
def test_the_ridge_reads_force_from_a_dataset_better_than_the_mean_shift(tmp_path: Path) -> None:
    import twin
    from twin.study.dataset.create import create_dataset

    columns = ["force_n", "marker_pressed_px"]
    scene = twin.load_scene("dataset_kamiyama", {"dataset.columns": columns, "accuracy.contact_patches": 8})
    create_dataset(scene, tmp_path / "d", 300)
    found = example("read_force").compare(str(tmp_path / "d"))
    assert found["ridge"] < 0.8 * found["mean shift"]


@pytest.fixture
def torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torch where it is installed, else as much of it as the example takes: batches of numpy arrays in turn."""
    if importlib.util.find_spec("torch") is not None:
        return

    class DataLoader:
        def __init__(self, data: Any, batch_size: int, collate_fn: Any, shuffle: bool, num_workers: int) -> None:
            del shuffle, num_workers
            self.data, self.size, self.batch = data, batch_size, collate_fn

        def __iter__(self) -> Any:
            rows = list(self.data)
            return (self.batch(rows[i : i + self.size]) for i in range(0, len(rows), self.size))

    modules = {name: ModuleType(name) for name in ("torch", "torch.utils", "torch.utils.data")}
    modules["torch"].__dict__.update(
        Tensor=np.ndarray, from_numpy=lambda array: SimpleNamespace(float=lambda: array.astype(np.float32))
    )
    modules["torch.utils.data"].__dict__.update(DataLoader=DataLoader)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)


class Rows(list[dict[str, Any]]):
    """Stands in for an opened dataset."""

    @property
    def columns(self) -> list[str]:
        return list(self[0])

    def sensor(self, number: int) -> dict[str, Any]:
        return {"picture": np.full((4, 5, 3), 2 * number, np.uint8)}


@pytest.mark.usefixtures("torch")
def test_torch_loads_pictures_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [
        {"picture": np.full((4, 5, 3), 51 * n, np.uint8), "force_n": np.full(3, n), "slip_share": n / 6, "sensor": n}
        for n in range(5)
    ]
    torch_loader = example("torch_loader")
    parts = {"all": Rows(rows), "test": Rows(rows[4:])}
    monkeypatch.setattr(torch_loader.twin, "open_dataset", lambda *_, split: parts[split], raising=False)
    (last,) = torch_loader.loader("anywhere", ["slip_share"], "test", workers=0)
    assert np.asarray(last["slip_share"]).tolist() == [np.float32(4 / 6)]
    batches = list(torch_loader.loader("anywhere", batch_size=2, workers=0))
    assert [tuple(batch["picture"].shape) for batch in batches] == [(2, 3, 4, 5), (2, 3, 4, 5), (1, 3, 4, 5)]
    forces = np.concatenate([np.asarray(batch["force_n"]) for batch in batches])
    assert sorted(forces[:, 0].tolist()) == [0, 1, 2, 3, 4]
    for batch in batches:
        np.testing.assert_allclose(np.asarray(batch["picture"])[:, 0, 0, 0] * 5, np.asarray(batch["force_n"])[:, 0])
        np.testing.assert_allclose(batch["rest"] * 51, 2 * np.asarray(batch["picture"]))


def test_a_checkerboard_tells_the_camera(tmp_path: Path) -> None:
    """Boards drawn through a known camera give its focal length and distortion."""
    cv2 = pytest.importorskip("cv2", reason="of the extra 'peers'")
    board = np.kron(np.indices((9, 12)).sum(0) % 2, np.ones((20, 20))) * 200 + 30
    board[:20], board[-20:], board[:, :20], board[:, -20:] = 230, 230, 230, 230
    matrix, distortion = np.array([[620, 0, 322], [0, 618, 236], [0, 0, 1.0]]), np.array([-0.12, 0.03, 0, 0, 0])
    column, row = np.meshgrid(np.arange(640.0), np.arange(480.0))
    seen = cv2.undistortPoints(np.stack([column, row], axis=-1).reshape(-1, 1, 2), matrix, distortion)[:, 0]
    rays, rng = np.c_[seen, np.ones(len(seen))], np.random.default_rng(1)
    for number in range(10):
        turn = cv2.Rodrigues(rng.normal(0, 0.3, 3))[0]
        origin, ray = -turn.T @ [*rng.normal((-6, -4.5), 1), 16], rays @ turn
        place = origin - origin[2] / ray[:, 2:] * ray
        at = (20 * place[:, :2] - 0.5).astype(np.float32).reshape(480, 640, 2)
        picture = cv2.remap(board.astype(np.uint8), at, None, cv2.INTER_LINEAR, borderValue=(150,))
        cv2.imwrite(str(tmp_path / f"{number}.png"), picture)
    example("checkerboard").calibrate(tmp_path, 9, 6, tmp_path / "camera.yaml")
    found = read_intrinsics(tmp_path / "camera.yaml")
    assert found["focal_px"] == pytest.approx(620, rel=0.01)
    assert found["distortion"][0] == pytest.approx(-0.12, abs=0.02)
    assert found["width_px"] == 640


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
