"""Recipes: what is shipped loads, what is wrong is named with file, key, value, unit and range, all at once."""

import json
import re
import runpy
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import trimesh
from standard_bodies import REFERENCE, write_stl

from twin import files
from twin.errors import InputError, RecipeError
from twin.study.check import check_path
from twin.study.recipe import load_scene, parse_overrides, shipped_scenes, validate_scene

SCENES = sorted(shipped_scenes())
SCHEMA_FILE = files.SCENES / "scene.schema.json"
MAKE_SCHEMA = Path(__file__).parents[2] / "docs" / "make_schema.py"


def test_a_file_that_an_editor_marked_as_utf8_is_read(tmp_path: Path) -> None:
    (tmp_path / "marked.toml").write_bytes(b'\xef\xbb\xbfbase = "block_bare"\r\nseed = 3\r\n')
    assert load_scene(tmp_path / "marked.toml").seed == 3
    (tmp_path / "other.toml").write_text("seed = 3", encoding="utf-16")
    with pytest.raises(RecipeError, match=r"no text in UTF-8; save the file in this encoding"):
        load_scene(tmp_path / "other.toml")


def test_a_folder_of_results_does_not_hide_the_scene_of_its_name(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "gelpad_press").mkdir()
    monkeypatch.chdir(tmp_path)
    assert load_scene("gelpad_press") == load_scene(shipped_scenes()["gelpad_press"])


def test_what_is_given_later_varies_no_more(tmp_path: Path) -> None:
    """It was drawn nevertheless, and what was given had no effect."""
    (tmp_path / "own.toml").write_text(
        'base = "dataset_kamiyama"\npress.friction = 0.6\n[vary."press.at_mm"]\nlow = [0, 0]\nhigh = [1, 1]\n'
    )
    own = load_scene(tmp_path / "own.toml")
    assert own.press.friction == 0.6
    assert set(load_scene("dataset_kamiyama").vary) - set(own.vary) == {"press.friction"}
    assert own.vary["press.at_mm"].high == (1, 1)
    steps = load_scene("dataset_slide").model_dump(include={"press": {"steps"}})["press"]["steps"]
    fixed = load_scene("dataset_slide", {"press.steps": steps, "press.probe": {"kind": "sphere", "diameter_mm": 5.0}})
    assert set(fixed.vary) == {"press.at_mm", "press.friction"}
    assert "press.probe" not in load_scene("dataset_kamiyama", {"press.probe.diameter_mm": 5.0}).vary
    both = {"press.friction": 0.5, "vary.press.friction": {"low": 0.4, "high": 0.6}}
    assert load_scene("dataset_kamiyama", both).vary["press.friction"].low == 0.4


@pytest.mark.parametrize("name", SCENES)
def test_resolved_scene_reads_back_the_same(name: str) -> None:
    scene = load_scene(name)
    assert validate_scene(tomllib.loads(scene.to_toml()), name) == scene


@pytest.mark.parametrize("name", SCENES)
def test_every_number_has_a_source_or_says_that_it_is_assumed(name: str) -> None:
    told = [line for line, _ in check_path(name) if line.startswith("numbers without source or assumed")]
    # the ten-line scene shows how little a user has to write
    little = ["numbers without source or assumed: press.at_mm, press.force_n, press.probe.diameter_mm"]
    assert told == (little if name == "first_press" else [])


def test_a_number_without_provenance_is_noticed(tmp_path: Path) -> None:
    recipe = tmp_path / "mine.toml"
    recipe.write_text('base = "kamiyama_pillar"\n[markers.red]\ndepth_mm = 5.5\n')
    assert check_path(str(recipe))[-1][0] == "numbers without source or assumed: markers.red.depth_mm"


def test_a_check_holds_for_the_scene_with_its_overrides() -> None:
    with pytest.raises(RecipeError, match=r"ccd.haze = 2: must be less than"):
        check_path("kamiyama_pillar", {"ccd.haze": 2})
    cone = {"press.probe": {"kind": "cone", "apex_deg": 120.0, "diameter_mm": 6.0}}
    with pytest.raises(InputError, match=r"law = neo_hookean: press.probe.tip_mm = 0: a cone with friction"):
        check_path("kamiyama_shear", {"material.law": "neo_hookean", **cone})
    with pytest.raises(RecipeError, match=r"ccd.haze = 2: must be less than"):
        check_path("sweep_kamiyama_depth_pitch", {"ccd.haze": 2})
    with pytest.raises(InputError, match=r"-s ccd.haze=... changes a scene, and this is none"):
        check_path(str(REFERENCE / "opencv_camera.yml"), {"ccd.haze": 0.1})


@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_satisfy_the_schema(name: str) -> None:
    check = jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text()))
    assert not list(check.iter_errors(tomllib.loads(shipped_scenes()[name].read_text())))


def test_schema_file_is_in_step_with_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.files.SCENES", tmp_path)
    runpy.run_path(str(MAKE_SCHEMA), run_name="__main__")
    assert SCHEMA_FILE.read_text() == (tmp_path / SCHEMA_FILE.name).read_text(), "run: python docs/make_schema.py"


def test_schema_refuses_a_misspelt_key() -> None:
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"markers": {"red": {"depht_mm": 3}}}, json.loads(SCHEMA_FILE.read_text()))


def test_one_scene_is_ten_lines_long() -> None:
    assert len(shipped_scenes()["first_press"].read_text().splitlines()) == 10


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("material.poisson_ratio", 0.7, ["material.poisson_ratio", "0.7", "-0.5 to 0.5"]),
        ("material.poisson_ratio", float("nan"), ["material.poisson_ratio", "nan", "finite"]),
        ("markers.red.depth_mm", -1, ["markers.red.depth_mm", "-1 mm", "0.000001 mm", "1e-06 to 100 mm"]),
        ("markers.red.depht_mm", 1, ["markers.red.depht_mm", "did you mean 'depth_mm'"]),
        ("cmaera.width_px", 4, ["cmaera", "did you mean 'camera'"]),
        ("press.friction", -0.3, ["press.friction", "-0.3", "0 (frictionless)"]),
        ("press.probe.kind", "ball", ["press.probe.kind", "'ball'", "'sphere'"]),
        ("press.force_n", {"z": -1}, ["press", "push is +z"]),
        ("press.force_n", {"z": "much"}, ["press.force_n.z = 'much': must be a number in N"]),
        ("press.move_mm", {"z": 1}, ["press.move_mm", "belongs to a step", "{move_mm = {z = 1}}]"]),
        ("press.seconds", 1, ["press.seconds", "belongs to a step", "{seconds = 1}]"]),
        ("picture.noise", 1, ["picture: unknown key"]),
        ("body", {}, ["body: give a table with shape = 'block'"]),
        ("camera.intrinsics", 3, ["camera.intrinsics: ", "3: can't be read"]),
        ("camera.intrinsics", "no.yml", ["camera.intrinsics: ", "no.yml: can't be read"]),
        ("body.shape", "cube", ["body.shape", "'cube'", "'block'"]),
        ("camera.fov_deg", 39, ["give focal_px", "--fov-deg"]),
        ("ccd.preset", "idael", ["ccd.preset", "'ideal'"]),
        ("camera.pupil_mm", [0, 0, 3], ["camera.pupil_mm", "z >= 50"]),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(key: str, value: object, expected: list[str]) -> None:
    with pytest.raises(RecipeError) as caught:
        load_scene("kamiyama_pillar", {key: value})
    assert all(word in str(caught.value) for word in ["override of kamiyama_pillar: ", *expected]), str(caught.value)
    assert len(caught.value.problems) == 1


def test_all_problems_of_a_file_come_at_once() -> None:
    with pytest.raises(RecipeError) as caught:
        load_scene("kamiyama_pillar", {"material.poisson_ratio": 2, "markers.blue.pitch_mm": 0, "nonsense": 1})
    assert len(caught.value.problems) == 3


def test_a_wrong_override_is_not_blamed_on_the_file(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "kamiyama_pillar"\n')
    with pytest.raises(RecipeError, match=r"^override of .*mine\.toml: material\.poisson_ratio = 2\b"):
        load_scene(mine, {"material.poisson_ratio": 2, "seed": 3})
    with pytest.raises(RecipeError, match=r"^override of .*mine\.toml: no body recipe 'nowhere'"):
        load_scene(mine, {"body.recipe": "nowhere"})
    mine.write_text('base = "kamiyama_pillar"\nseed = -1\n')
    with pytest.raises(RecipeError, match=rf"^{re.escape(str(mine))}: seed = -1\b"):
        load_scene(mine, {"material.poisson_ratio": 0.3})
    with pytest.raises(RecipeError, match=r"mine\.toml and its overrides: material\.poisson_ratio = 2\b"):
        load_scene(mine, {"material.poisson_ratio": 2})


def test_the_renderer_is_found_under_picture_too(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "kamiyama_pillar"\n[picture]\nrenderer = "path"\n')
    assert load_scene(mine).renderer == "path"
    assert load_scene(mine, {"picture.renderer": "splat"}).renderer == "splat"
    with pytest.raises(RecipeError, match=r"renderer = 'raster': must be 'auto'"):
        load_scene(mine, {"picture.renderer": "raster"})
    mine.write_text('base = "kamiyama_pillar"\nrenderer = "path"\npicture = {renderer = "splat"}\n')
    with pytest.raises(RecipeError, match=r"picture: unknown key"):
        load_scene(mine)


def test_overrides_win_and_lose_the_old_provenance() -> None:
    scene = load_scene("kamiyama_pillar", {"markers.red.depth_mm": 5})
    assert scene.markers["red"].depth_mm == 5
    assert scene.markers["red"].source == {k: v for k, v in scene.markers["red"].source.items() if k != "depth_mm"}
    assert scene.markers["red"].assumed["depth_mm"] == "override"


@pytest.mark.parametrize("scene", ["sato_press", "sato_shear"])
@pytest.mark.parametrize("override", [{"press.force_n.z": 0.3}, {"press.force_n": {"z": 0.3}}])
def test_one_component_of_a_force_can_be_overridden(scene: str, override: dict[str, object]) -> None:
    press = load_scene(scene, override).press
    assert press.path[0].force_n == (None, None, 0.3)
    assert len(press.path) == 1
    assert press.assumed["force_n"] == "override"


def test_another_probe_replaces_the_one_of_the_base(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "kamiyama_pillar"\n[press.probe]\nkind = "pillar"\nwidth_mm = 3\n')
    probe = load_scene(mine).press.probe
    assert (probe.kind, probe.size_mm) == ("pillar", (3, 3))


def test_a_base_may_have_a_base_and_its_files_lie_beside_it(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    trimesh.creation.cone(3, 4).export(tmp_path / "below" / "cone.stl")
    middle = tmp_path / "below" / "middle.toml"
    middle.write_text(
        'base = "kamiyama_shear"\n[press.probe]\nkind = "stl"\nfile = "cone.stl"\n[material]\npoisson_ratio = 0.4\n'
    )
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "below/middle.toml"\n[material]\nyoungs_modulus_mpa = 0.3\n')
    scene = load_scene(mine)
    assert (scene.material.poisson_ratio, scene.material.youngs_modulus_mpa) == (0.4, 0.3)
    assert scene.press.probe.file == str(tmp_path / "below" / "cone.stl")
    assert scene.markers == load_scene("kamiyama_pillar").markers


def test_a_scene_is_no_base_of_itself(tmp_path: Path) -> None:
    (tmp_path / "one.toml").write_text('base = "two.toml"\n')
    (tmp_path / "two.toml").write_text('base = "one.toml"\n')
    with pytest.raises(RecipeError, match="can't be its own base"):
        load_scene(tmp_path / "one.toml")


@pytest.mark.parametrize("text", ["[body\n", "a = " + "[" * 5000, "\x00"])
def test_broken_toml_is_a_recipe_error(tmp_path: Path, text: str) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(text)
    with pytest.raises(RecipeError, match=r"mine\.toml: not valid TOML"):
        load_scene(mine)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.b=1", ("a.b", 1)),
        ("a=[1, 2]", ("a", [1, 2])),
        ("ccd.preset=ideal", ("ccd.preset", "ideal")),
        ("f = inf", ("f", float("inf"))),
    ],
)
def test_overrides_are_toml_or_bare_strings(text: str, expected: tuple[str, object]) -> None:
    assert parse_overrides([text]) == dict([expected])


def test_a_body_in_place_of_the_base_s_recipe_must_bring_its_material(tmp_path):
    other = 'base = "sato_press"\n[body]\nshape = "dome"\nradius_mm = 10\nheight_mm = 7\n'
    (tmp_path / "scene.toml").write_text(other)
    with pytest.raises(RecipeError, match=r"body.shape = 'dome' replaces .* 'sato_press'.*\[material\]"):
        load_scene(tmp_path / "scene.toml")
    (tmp_path / "scene.toml").write_text(other + "[material]\nyoungs_modulus_mpa = 0.7\n")
    assert load_scene(tmp_path / "scene.toml").material.youngs_modulus_mpa == 0.7


PRESSES = {
    "cone": 'force_n = {z = 0.1}\n[press.probe]\nkind = "cone"\napex_deg = 140\ndiameter_mm = 6\ntip_mm = 0.2\n',
    "rim": "indentation_mm = 0.1\ntilt_deg = {x = 2, z = 30}\n"
    '[press.probe]\nkind = "pillar"\nwidth_mm = 4\nedge_mm = 0.3\n',
    "normal": 'direction = "normal"\naxes = "probe"\nat_mm = [1, 2, 0]\n[press.probe]\nkind = "cylinder"\n'
    "diameter_mm = 4\n[[press.steps]]\nforce_n = {z = 1}\ntorque_nmm = {x = 0.0, y = 0.1}\nturn_deg = {z = 2}\n",
    "also": 'force_n = {z = 0.1}\n[press.probe]\nkind = "sphere"\ndiameter_mm = 3\n'
    '[[press.also]]\nat_mm = [6, 0]\nindentation_mm = 0.1\nprobe = {kind = "sphere", diameter_mm = 2}\n',
    "stl": 'force_n = {z = 0.1}\n[press.probe]\nkind = "stl"\nfile = "mine.stl"\n',
}


@pytest.mark.parametrize("name", PRESSES)
def test_every_kind_of_press_is_read_written_and_fits_the_schema(name: str, tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]], np.float32)
    write_stl(tmp_path / "mine.stl", corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]])
    recipe = tmp_path / "mine.toml"
    recipe.write_text(f'base = "block_bare"\n[press]\n{PRESSES[name]}')
    scene = load_scene(recipe)
    assert scene.press is not None
    (tmp_path / "again.toml").write_text(scene.to_toml())
    assert load_scene(tmp_path / "again.toml") == scene
    jsonschema.validate(tomllib.loads(scene.to_toml()), json.loads(SCHEMA_FILE.read_text()))
    if name == "stl":
        (tmp_path / "mine.stl").unlink()
        with pytest.raises(RecipeError, match=r"press.probe.file.*no such file"):
            load_scene(recipe)


def test_what_is_missing_is_described(tmp_path: Path) -> None:
    write_stl(tmp_path / "mine.stl", np.zeros((4, 3, 3)))
    solid = '[body]\nshape = "solid"\nfile = "mine.stl"\n[material]\nyoungs_modulus_mpa = 0.2\n'
    (tmp_path / "mine.toml").write_text(f"{solid}[press]\nforce_n = {{z = 1}}\n")
    with pytest.raises(RecipeError) as told:
        load_scene(tmp_path / "mine.toml")
    assert "body.held: missing; give a table with keys of plane, box, normal, within_deg" in str(told.value)
    assert "press.probe: missing; give a table with kind = 'sphere' or 'cylinder' or 'pillar'" in str(told.value)
