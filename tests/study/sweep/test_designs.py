"""Designs: which there are, what becomes of scenes, and what is said about bad sweeps."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from small_sweep import TABLE, small

from twin.errors import InputError, RecipeError
from twin.files import SCENES
from twin.parts.load import Rectangles
from twin.parts.sweep import Sweep
from twin.study.check import check_path
from twin.study.recipe import shipped_scenes
from twin.study.sweep.designs import Designs, load_sweep
from twin.study.sweep.fidelities import closed
from twin.study.sweep.loads import Bodies
from twin.study.sweep.sweep_run import estimate, run_sweep
from twin.theory.limit import Limit
from twin.theory.optics import project_with_jacobian
from twin.world.elasticity.block_table import Table


def test_a_grid_is_every_combination_with_what_follows() -> None:
    sweep, scene = small()
    designs = Designs.of(sweep, scene)
    assert len(designs) == sweep.size == 6
    assert designs.columns["markers.*.pitch_mm"] == [1.2, 1.5, 1.8] * 2
    assert designs.columns["markers.red.depth_mm"] == [5.0] * 3 + [6.0] * 3


def test_a_design_is_a_scene_with_its_values_in_every_layer_and_as_wide_as_before() -> None:
    sweep, scene = small()
    made = Designs.of(sweep, scene).scene_of(0)
    for name, layer in made.markers.items():
        was = scene.markers[name]
        assert layer.pitch_mm == 1.2
        assert layer.columns % 2 == was.columns % 2, "layers at half a pitch stay so"
        assert abs((layer.columns - 1) * 1.2 - (was.columns - 1) * 1.5) <= 1.2
    assert made.markers["red"].depth_mm == 5.0
    assert scene.markers["red"].depth_mm == 6.0, "the base is not touched"


def test_counts_follow_the_pitch_by_even_numbers_and_never_vanish() -> None:
    axes = {"markers.*.pitch_mm": [1.5, 1.0, 3.0, 100.0]}
    counts = {"markers.red.columns": 21, "markers.red.rows": 20}
    designs = Designs.of(*small(axes=axes, derived={}, set=counts))
    columns, rows = designs.marker_counts("red")
    assert (columns.tolist(), rows.tolist()) == ([21, 31, 11, 1], [20, 30, 10, 2])
    made = [designs.scene_of(number).markers["red"] for number in range(2)]
    assert [(layer.columns, layer.rows) for layer in made] == [(21, 20), (31, 30)]


@pytest.mark.parametrize("sampling", ["latin", "sobol", "random"])
def test_sampling_fills_the_axes_and_is_known_from_the_seed(sampling: str) -> None:
    axes = {"markers.blue.depth_mm": {"low": 1.0, "high": 4.0, "log": True}, "ccd.preset": ["ideal", "industrial"]}
    sweep, scene = small(axes=axes, derived={}, sampling=sampling, count=64)
    one, again = Designs.of(sweep, scene), Designs.of(sweep, scene)
    assert one.columns == again.columns
    depth = np.array(one.columns["markers.blue.depth_mm"])
    assert depth.min() >= 1
    assert depth.max() <= 4
    assert abs(np.mean(depth < 2) - 0.5) < 0.15, "half of them lie below the middle of the logarithm"
    assert {"ideal", "industrial"} == set(one.columns["ccd.preset"])


def test_impossible_designs_are_dropped_with_their_reason() -> None:
    axes = {"markers.*.diameter_mm": [0.5, 1.6], "markers.blue.depth_mm": [0.2, 3.0, 39.9]}
    sweep, scene = small(axes=axes, derived={})
    reason = closed(Designs.of(sweep, scene))[1].tolist()
    assert [bool(r) for r in reason] == [True, False, True, True, True, True]
    assert "sticks out" in reason[0]
    assert "thick" in reason[2]
    assert "neighbours touch" in reason[4]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"axes": {"markers.green.depth_mm": [1.0]}}, "no 'green'"),
        ({"axes": {"markers.blue.depth": [1.0]}}, "did you mean 'depth_mm'"),
        ({"axes": {"materal.youngs_modulus_mpa": [1.0]}}, "did you mean 'material'"),
        ({"axes": {"markers.blue.depth_mm": [1.0, "deep"]}}, "must be a number"),
        ({"axes": {"press.force_n": [1.0]}}, "no part of a sensor's design"),
        ({"derived": {"markers.red.depth_mm": {"follows": "markers.blue.deep"}}}, "no 'deep'"),
    ],
)
def test_keys_that_are_not_there_are_said_before_anything_is_done(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(RecipeError, match=said):
        Designs.of(*small(**{"derived": {}, **changes}))


@pytest.mark.parametrize(("values", "said"), [("[]", "at least 1"), ("[nan, 1.0]", "must be finite")])
def test_an_axis_without_numbers_is_refused_by_its_key(values: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(f'scene = "block_bare"\n[axes]\n"body.thickness_mm" = {values}\n')
    with pytest.raises(RecipeError, match=rf"axes\.body\.thickness_mm.*{said}"):
        load_sweep(tmp_path / "sweep.toml")


def test_a_single_layer_is_judged_by_the_full_chain_in_a_folder_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "pad.toml"
    path.write_text('scene = "gelpad_press"\n[axes]\n"markers.dots.depth_mm" = [0.5]\n')
    sweep, scene = load_sweep(path)
    assert sweep.ladder == ("full",)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "report.html").write_text("of a run")
    with pytest.raises(InputError, match=r"holds report\.html, which would be replaced"):
        run_sweep(sweep, scene, tmp_path / "run")
    for search in (partial(run_sweep, folder=tmp_path / "out"), estimate):
        with pytest.raises(RecipeError, match="--optimise searches by the closed form or linear information"):
            search(sweep, scene, optimise=True)
    (tmp_path / "data" / "meta").mkdir(parents=True)
    (tmp_path / "data" / "meta" / "info.json").write_text("{}")
    with pytest.raises(InputError, match="data: holds a dataset"):
        run_sweep(sweep, scene, tmp_path / "data")
    assert not (tmp_path / "out").exists()
    assert load_sweep(path, {"reconstruction.method": "smooth"})[0].ladder == ("closed", "linear")


def test_every_wrong_key_of_a_file_is_said_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'scene = "kamiyama_pillar"\n[axes]\n"markers.blue.depht_mm" = [1.0]\n"markers.green.depth_mm" = [1.0]\n'
        '[derived]\n"camera.zoom" = { follows = "camera.focal_px" }\n'
    )
    with pytest.raises(RecipeError) as problem:
        load_sweep(path)
    lines = str(problem.value).splitlines()
    assert len(lines) == 3
    assert all(line.startswith(f"{path}: ") for line in lines)
    assert f"{path}: axes.markers.blue.depht_mm: unknown key; did you mean 'depth_mm'?" in lines
    assert any("derived.camera.zoom: unknown key" in line for line in lines)
    path.write_text('scene = "kamiyama_pillar"\n[axes]\n"markers.red.depth_mm" = {low = 1, high = 2, count = 3}\n')
    with pytest.raises(RecipeError, match=r"count: unknown key; known are .*low, high, steps, log, whole"):
        load_sweep(path)
    path.write_text('scene = "kamiyama_pillar"\n[set]\n"camera.width" = 1\n[axes]\n"markers.red.depth_mm" = [1.0]\n')
    with pytest.raises(RecipeError, match=rf"{path}: set.camera.width: unknown key; did you mean"):
        load_sweep(path)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({**TABLE, "fidelty": ["closed"]}, "did you mean 'fidelity'"),
        ({**TABLE, "axes": {}}, "axes"),
        ({**TABLE, "axes": {"markers.blue.depth_mm": [-1, 2]}}, "axes.markers.blue.depth_mm = -1 mm: .*: 1e-06 to 100"),
        ({**TABLE, "axes": {"camera.width_px": {"low": 9, "high": 9e3, "whole": True}}}, "= 9000 px: .*: 1 to 8192"),
        (
            {**TABLE, "derived": {"markers.red.depth_mm": {"follows": "markers.blue.depth_mm", "plus": -9}}},
            "derived.markers.red.depth_mm = -",
        ),
        ({**TABLE, "axes": {"markers.blue.depth_mm": {"low": 3, "high": 1}}}, "must not be above"),
        ({**TABLE, "targets": {"twopoint": 2}}, "unknown metric"),
        ({**TABLE, "loads": {"size_mm": -1}}, "size_mm"),
        ({**TABLE, "loads": {"sise_mm": 1}}, "did you mean 'size_mm'"),
        ({**TABLE, "fidelity": ["exact"]}, "closed"),
        ({**TABLE, "axes": {"markers.red.columns": {"low": 3, "high": 9, "steps": 5}}}, "= 4.5: .*; set whole = true"),
    ],
)
def test_bad_sweeps_are_refused_with_file_and_key(table: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match=said) as problem:
        load_sweep(_written(table, tmp_path))
    assert "here.toml" in str(problem.value)


def _written(table: dict[str, Any], folder: Path) -> Path:
    (folder / "here.toml").write_text(tomli_w.dumps(table))
    return folder / "here.toml"


def test_what_a_sweep_does_not_model_is_refused() -> None:
    sweep, scene = small()
    with pytest.raises(RecipeError, match="every design would have to be pressed"):
        estimate(
            sweep, scene.model_copy(update={"calibration": scene.calibration.model_copy(update={"method": "sato"})})
        )


def test_shipped_sweeps_are_sound_and_are_not_scenes(tmp_path: Path) -> None:
    shipped = {path.stem for path in SCENES.glob("sweep_*.toml")}
    assert {"sweep_kamiyama_depth_pitch", "sweep_sato_pitch_diameter", "sweep_lens", "sweep_youngs_modulus"} <= shipped
    assert not shipped & set(shipped_scenes())
    for name in shipped:
        assert check_path(name)[0][1]["found"] == "ok"
        sweep, scene = load_sweep(name)
        designs = Designs.of(sweep, scene)
        assert (closed(designs)[1] == "").any()
        designs.scene_of(0)
        assert isinstance(sweep, Sweep)
    with pytest.raises(InputError, match="did you mean 'sweep_lens'"):
        load_sweep("sweep_lense")


def test_many_thicknesses_of_a_block_are_interpolated_between_their_ends_and_few_are_not() -> None:
    key = "body.thickness_mm"
    many, _ = small(axes={key: {"low": 30.0, "high": 50.0}}, derived={}, sampling="latin", count=40)
    assert Bodies.of(many).thickness_mm == (30.0, 50.0)
    few, _ = small(axes={key: {"low": 30.0, "high": 50.0, "steps": 5}}, derived={})
    assert Bodies.of(few).thickness_mm is None
    listed, _ = small(axes={key: [30.0 + n for n in range(20)]}, derived={})
    assert Bodies.of(listed).thickness_mm == (30.0, 49.0)
    axes = {"markers.blue.depth_mm": {"low": 1.0, "high": 2.0}}
    follows, _ = small(
        axes=axes, derived={key: {"follows": "markers.blue.depth_mm", "times": -10.0, "plus": 60.0}}, sampling="sobol"
    )
    assert Bodies.of(follows).thickness_mm == (40.0, 50.0)
    assert Bodies.of(small()[0]).thickness_mm is None


def test_a_body_between_the_ends_takes_the_table_of_their_range(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(Table, "between", lambda body, *of: asked.append((body.thickness_mm, *of)))
    bodies, scene = Bodies((30.0, 50.0)), small()[1]
    patches = Rectangles.on_surface(scene.body, np.zeros((1, 2)), 0.5, "patches")
    for _ in range(2):
        bodies.unit(scene, "nominal", patches)
    assert asked == [(40.0, "nominal", 30.0, 50.0)]
    assert (bodies.asked, bodies.made) == (2, 1), "a mesh of its own, once, as there is no table"


@pytest.mark.parametrize("focal_px", [1800.0, 3600.0])
def test_pixels_become_millimetres_by_the_projection(focal_px: float) -> None:
    """The noise in mm is that in px over the camera's scale, at each layer's depth."""
    axes = {"camera.focal_px": [focal_px, 2 * focal_px]}
    sweep, scene = small(axes=axes, derived={}, noise_px=0.05)
    found, _ = closed(Designs.of(sweep, scene))
    camera = scene.camera.model_copy(update={"focal_px": focal_px})
    depth = np.array([layer.depth_mm for layer in scene.markers.values()])
    middle = np.column_stack([*np.tile(camera.pupil_mm[:2], (len(depth), 1)).T, depth])
    index, base = scene.material.refractive_index, scene.body.base_z_mm
    px_per_mm = project_with_jacobian(middle, camera, index, base)[1][:, 0, 0]
    limit = Limit.of(
        depth_mm=depth[None],
        pitch_mm=np.array([[layer.pitch_mm for layer in scene.markers.values()]]),
        noise_mm=0.05 / px_per_mm[None],
        youngs_modulus_mpa=scene.material.youngs_modulus_mpa,
        poisson_ratio=scene.material.poisson_ratio,
        force_n=sweep.loads.force_n,
        radius_mm=sweep.loads.size_mm / np.sqrt(np.pi),
        sampling="squares",
    )
    assert found["two_point_mm"][0] == pytest.approx(limit.two_point_mm[0], rel=1e-6)
    assert found["fwhm_mm"][0] == pytest.approx(limit.fwhm_normal_mm[0], rel=1e-6)
    assert found["resolution_gf"][0] * 9.80665e-3 == pytest.approx(limit.force_sd_n[0], rel=1e-6)
    assert found["resolution_gf"][1] < 0.8 * found["resolution_gf"][0]
