"""The command line: exit codes, messages that help, nothing heavy for help, nothing lost."""

import inspect
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from twin.cli import app, main
from twin.errors import InputError
from twin.study.recipe import load_scene
from twin.study.run import run

TWIN = [sys.executable, "-m", "twin"]


def twin(*arguments: str, cwd: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*TWIN, *arguments], capture_output=True, text=True, cwd=cwd, env={**os.environ, **environment}, timeout=300
    )


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run kamiyama_pillar -s press.force_n=3", "press.force_n = 3 N: must name its components"),
        ("run kamiyama_pillar -s accuracy.displacement=0", "(allowed: 1e-05 to 0.2 or 'auto')"),
        ("run sweep_lens", "sweep_lens.toml: is a sweep over many designs"),
        ("export sato_press --format mitsuba --out x -s light.exponent=2", "light.exponent = 2: stock"),
        ("export data --format coco --out x -s seed=2", "-s: belongs to a scene"),
        ("run FOLDER", "is a folder"),
        ("view FOLDER", "holds neither scene.toml"),
        ("view kamiyama_pillar --out x.pdf", "allowed are .html for a page, .gif, .png, .mp4 for a film"),
        ("view kamiyama_pillar --out FILE/x.html", "FILE: the output folder can't be made"),
        ("run block_bare --out FILE", "output folder can't be made"),
        ("run block_bare --out slide.h5", "slide.h5: the output is a folder, and .h5 a file's ending"),
        ("run gelpad_slide --film --out slide.mp4", "slide.mp4: the output is a folder, and .mp4 a file's ending"),
        ("view PICTURE", "twin view the folder of a run or of a dataset"),
        ("mesh sato_press --mend", "See: twin mesh --help"),
        ("run kamiyama_pillar more", "what is 'more'? The command takes no more"),
        ("check PICTURE", "PICTURE: is a picture (PNG), and a scene or a sweep is a text file"),
        ("check BODY.stl", "BODY.stl: is a surface (STL), and a scene or a sweep is a text file (TOML); name it"),
        ("view BODY.step", "BODY.step: is a STEP file, and a scene or a sweep is a text file (TOML); export"),
        ("scenes --new a --size-mm 30 20", "--size-mm needs 3 values: Width"),
        ("run", "SCENE is missing: Path of a scene file"),
        ("run kamiyama_pillar --out", "--out needs a value: Folder for the results"),
        ("run kamiyama_pillar --want ,", "--want names nothing: give any of displacement"),
        (
            "run kamiyama_pillar -s camera.width_px=true",
            "width_px = 'true': must be a whole number (allowed: 1 to 8192 px)",
        ),
        ("run kamiyama_pillar -s press.at_mm=[0]", "press.at_mm.1: missing; give a value\n"),
        ("check gelpad_press -s press.probe={}", "press.probe: give a table with kind = 'sphere' or"),
        ("check gelpad_press -s \"press.probe={kind='object'}\"", "missing; give 'letter' or 'gear' or"),
        ("run kamiyama_pillar -s press.at_mm=[1,2,3,4]", "at_mm = [1, 2, 3, 4] mm: must be a list of at most 3"),
        ('run kamiyama_pillar -s "press.at_mm=[.5, 0]"', "[.5, 0] is no list or table as TOML writes it"),
        ("run kamiyama_pillar -s press.direction=down", "must be a list, such as [1, 1, 1] or 'normal'\n"),
        ("run kamiyama_pillar -s press.albedo=0.5", "press.albedo = 0.5: must be a list, such as [1, 1, 1]\n"),
        ("run kamiyama_pillar -s ccd.white_balance=[1,1,0]", "ccd.white_balance.2 = 0: must be greater than 0"),
        ("run kamiyama_pillar -s light.positions_mm=3", "such as [[1, 1, 1], [1, 1, 1]]\n"),
        ("run kamiyama_pillar --out RECORDING", "RECORDING: holds rest.png, which would be replaced"),
        ("run LINK", "scene 'LINK': is no file to read, but a folder, a device, or a link to nowhere"),
        ("check TABLE.csv", "a scene or a sweep is a text file, NAME.toml"),
        ("run LONGNAME", "there is no such file"),
        ("run ~nobody_of_this_name/a.toml", "there is no such file"),
        ("reproduce --seed 1.5", "'1.5' is no whole number"),
        ("reproduce Sato", "there is no entry 'Sato': did you mean 'sato'?"),
        ("dataset dataset_kamiyama --samples 9999999999999", "allowed are 1 to 1,000,000,000"),
        ("dataset dataset_kamiyama --samples 0", "allowed are 1 to"),
        ("dataset dataset_kamiyama --samples 3 --columns ,", "--columns names nothing"),
        ("dataset dataset_kamiyama --samples 2 --scheduler tls://here:1", "needs --tls-ca, --tls-cert, --tls-key"),
        ("dataset dataset_kamiyama --samples 2 --scheduler tls://a:1 --tls-ca FILE", "needs --tls-cert, --tls-key"),
        ("dataset dataset_kamiyama --samples 2 --scheduler tcp://a:1 --tls-ca FILE", "must start with tls://"),
        ("dataset dataset_kamiyama --samples 2 --scheduler tls://a:1 --tls-key NONE", "NONE: there is no such file"),
        ("dataset dataset_kamiyama --samples 2 --tls-ca FILE", "belong to --scheduler"),
        ("dataset dataset_kamiyama --samples 3 --columns forse_n", "did you mean 'force_n'"),
        ("sweep nothing", "no sweep 'nothing'"),
        ("sweep kamiyama_pillar", "kamiyama_pillar.toml: is a scene, not a sweep"),
        ("reconstruct REST PRESSED --calibration C --size 64x48", "belong to raw frames"),
        ("reconstruct REST PRESSED --calibration C --overlay PRESSED", "is what is read"),
        ("reconstruct REST FOLDER --calibration C --overlay FOLDER", "is what is read"),
        ("reconstruct REST FOLDER --calibration C --overlay FOLDER/a.png", "is what is read"),
        ("reconstruct REST PRESSED --calibration C.npz --out ./C.npz", "is what is read"),
        ("rnu", ["rnu", 'Did you mean "run"']),
        ("explain FOLDER", ["no such file", "give the score.json of a run"]),
        ("explain PICTURE", "can't be read as JSON"),
        ("explain EMPTY.json", "EMPTY.json: holds no number of a run"),
        ('scenes --new ""', "--new '.': give the name of a file"),
        ("run block_bare --open --want score", "--want leaves the report out"),
        ("run kamiyama_piller", "did you mean 'kamiyama_pillar'"),
        ("run minne.toml", "did you mean 'mine.toml'"),
        ("run nowhere/at_all.toml", ["no scene", "shipped ones are"]),
        ("run block_bare --ouut x", ["--ouut", "--out"]),
        ("run block_bare --want dispalcement", "did you mean 'displacement'"),
        ("run block_bare --want picture", "[camera]"),
        (
            "run kamiyama_pillar -s press.force_n.z=1 -s press.steps=[]",
            ["press.steps are given together", "leave the others"],
        ),
        ("check kamiyama_pillar -s seed=1 -s seed=2", "seed is given twice, as 1 and 2"),
        (
            "run sato_press -s press.force_n.z=1 -s press.force_n={x=1}",
            "comes after -s press.force_n.z and replaces it: put",
        ),
        ("run kamiyama_pillar -s markers.red.depth_mm=39.9", ["markers.red", "outside the body"]),
        ("run kamiyama_pillar -s seed", "key.path=value"),
        ("check nowhere", "no scene 'nowhere'"),
        ("check DEEP.toml", "press: the sphere would sink in by 2.5 mm, allowed is up to 2 mm (half the body's thick"),
        ("dataset NAN.toml --samples 3", "NAN.toml: vary.press.at_mm.low.0 = nan mm: must be a finite number\n"),
        ("check gelpad_press -s press.at_mm=[500,0]", "at (500, 0, 0) mm misses the sensing surface"),
        ("check gelpad_press -s seed=1e30", "seed = 1e+30: must be a whole number (allowed: 0 to"),
        ("check gelpad_press -s base=other", "base: unknown key; a scene file names its base"),
        ("check gelpad_press -s body.file=a.stl", "body.file: unknown key; it belongs to shape = 'solid'"),
        ("check gelpad_press -s \"body={shape='block'}\"", "the recipe 'gelpad', which also holds [material]"),
        ("check mine.toml", "mine.toml: is empty: begin with base = 'gelpad_press'"),
        ("check COMMA.toml", "(at line 2, column 32); numbers have a point, such as 0.15, not a comma"),
        ("check PICTURE", "twin check REST1 REST2 --scene SCENE two of a sensor at rest"),
        ("check gelpad_press -s tolerance.depth_mm=5", "as drawn they fit: or reduce tolerance.depth_mm"),
        ("check gelpad_press -s reconstruction.sites.pitch_mm=10", "sites: some lie outside the sensing"),
        ("check gelpad_press -s markers.Dots.depth_mm=1", "no markers.Dots; did you mean 'dots'?\n"),
        ("check kamiyama_pillar -s markers.dots.depth_mm=1", "markers.dots; its layers are red, blue"),
        ("dataset OFF.toml --samples 3 --dry-run", "vary: the first 8 presses all fail, the first: the sphere at"),
        ("check gelpad_press -s \"markers.dots.depth_mm='4 mm'\"", "depth_mm = '4 mm': must be a number (allowed"),
        ("check dataset_kamiyama -s dataset.every_step=yes", "every_step = 'yes': must be true or false"),
        ("check BOX.toml", "body.sensing.box: low_mm.z = 1 mm must not be above high_mm.z = -1 mm"),
        (
            "check gelpad_press -s vary.press.indentation_mm.high=9 -s vary.press.indentation_mm.low=8",
            "fail, the first: press: the sphere would sink in",
        ),
        (
            "sweep sweep_lens --dry-run -s markers.red.depth_mm=39.9",
            "None of 32 designs is possible: markers.red: deeper",
        ),
        ("sweep COMMA.toml", "not valid TOML"),
        ("sweep OFF.toml", "OFF.toml: is a scene, not a sweep"),
        ("calibrate --layout-from NONE --pitch-mm -1", "--pitch-mm -1 mm: allowed are 0.01 to 100 mm"),
        ("scenes --pitch-mm 2", "--pitch-mm belongs to a new recipe: give --new NAME"),
        ("view BODY.stl -s seed=2", "BODY.stl: -s belongs to a scene"),
        ("reconstruct REST GONE*.png --calibration C", "GONE*.png: there is no such picture, folder"),
        ("reconstruct REST FOLDER --calibration C", "FOLDER: the folder holds no pictures (.png"),
        ("calibrate --scene sato_press --out x.txt", ".npz"),
        ("check DAMAGED", "truth.npz: can't be read"),
        ("check DIGITS.toml", "not valid TOML"),
        ("run block_bare -s seed=DIGITS", "-s seed"),
        ("calibrate --scene block_bare --out x.npz", ["block_bare: ", "[reconstruction]"]),
    ],
)
def test_wrong_input_is_told_in_the_users_terms(line, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("FOLDER").mkdir()
    Path("FILE").touch()
    Path("TABLE.csv").write_text("0.1\n")
    Path("mine.toml").touch()
    Path("COMMA.toml").write_text('base = "gelpad_press"\nmaterial.youngs_modulus_mpa = 0,15\n')
    off = '[vary]\n"press.at_mm" = {low = [50, 50], high = [60, 60]}\n'
    Path("OFF.toml").write_text('base = "gelpad_press"\n' + off)
    Path("NAN.toml").write_text('base = "gelpad_press"\n' + off.replace("50, ", "nan, "))
    deep = '[press]\nprobe = {kind = "sphere", diameter_mm = 9}\nsteps = [{move_mm = {z = 1}}, {move_mm = {z = 1.5}}]\n'
    Path("DEEP.toml").write_text('base = "gelpad_press"\n' + deep)
    box = "sensing.box = {low_mm = [-9, -9, 1], high_mm = [9, 9, -1]}\nheld.normal = [0, 0, 1]\n"
    Path("BOX.toml").write_text(f'base = "gelpad_press"\n[body]\nshape = "solid"\nfile = "BODY.stl"\n{box}[material]\n')
    Path("PICTURE").write_bytes(b"\x89PNG\r\n")
    Path("BODY.stl").write_bytes(bytes(84))
    Path("BODY.step").write_bytes(b"ISO-10303-21;")
    Path("LINK").symlink_to("NOWHERE")
    Path("EMPTY.json").write_text('{"elastic": [], "tracking": null, "force": 3}')
    Path("RECORDING").mkdir()
    Path("RECORDING/rest.png").touch()
    Path("DAMAGED").mkdir()
    Path("DAMAGED/truth.npz").write_bytes(b"PK\x03\x04 cut short")
    Path("DIGITS.toml").write_text("seed = " + "9" * 5000)
    line = line.replace("LONGNAME", "long" * 100).replace("=DIGITS", "=" + "9" * 5000)
    for name in ("OMP", "OPENBLAS", "MKL", "NUMBA"):  # which commands with workers would set for good
        monkeypatch.setenv(f"{name}_NUM_THREADS", os.environ.get(f"{name}_NUM_THREADS", "1"))
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SystemExit) as done:
        main(shlex.split(line))
    told = capsys.readouterr().err
    assert done.value.code == 2
    for word in [words] if isinstance(words, str) else words:
        assert word in told
    assert "internal error" not in told
    assert told.count("displacement = ") <= 1
    assert told.count("vary.") <= 1
    assert sorted(tmp_path.rglob("*")) == before


def test_help_names_every_command_and_an_example() -> None:
    done = twin("--help")
    assert done.returncode == 0
    assert all(word in done.stdout for word in ["run", "mesh", "calibrate", "scenes", "check", "doctor", "Example"])


COMMANDS = sorted(name for name in app if not name.startswith("-"))


@pytest.mark.parametrize("command", sorted({*COMMANDS} - {"scenes", "doctor"}))
def test_every_command_has_examples_that_it_understands(command: str) -> None:
    _, *examples = app[command].help_epilogue.splitlines()
    assert examples
    for example in examples:
        program, *arguments = shlex.split(example.split("| ")[-1])
        understood, bound, _ = app.parse_args(arguments, exit_on_error=False, print_error=False)
        assert (program, understood.__name__) == ("twin", command)
        assert bound.arguments


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_paragraphs_that_a_terminal_can_wrap(command: str) -> None:
    paragraphs = app[command].help.split("\n\n")
    assert all(paragraph and "\n" not in paragraph for paragraph in paragraphs)


def test_displacement_alone_loads_no_renderer_and_writes_no_picture(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom twin.cli import main\n"
        f"try: main(['run', 'kamiyama_pillar', '--want', 'displacement', '--out', {str(tmp_path)!r}])\n"
        "except SystemExit as done: assert done.code == 0\n"
        "print([m for m in ('mitsuba', 'drjit', 'pytetwild', 'pyvista', 'trimesh', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.toml", "timings.json", "truth.npz"]
    with np.load(tmp_path / "truth.npz") as truth:
        np.testing.assert_allclose(truth["surface_force_n"].sum(axis=0), truth["total_force_n"], atol=1e-6)
        assert truth["total_force_n"][2] == pytest.approx(3.0, rel=1e-6)
    assert twin("check", str(tmp_path)).returncode == 0


def test_other_settings_and_other_scenes_are_written_under_other_names(tmp_path, monkeypatch):
    run, view = app["run"].default_command, app["view"].default_command

    monkeypatch.chdir(tmp_path)
    folders: list[Path] = []
    monkeypatch.setattr("twin.study.run.run_to_folder", lambda _, folder, *rest, **more: folders.append(folder) or "")
    forces = ("press.force_n={z=2}", "press.force_n={z=4}", "press.force_n={z= 4}")
    for overrides in ((), ("seed=3",), ("seed=3", "tolerance.preset=none"), *((force,) for force in forces)):
        run("kamiyama_pillar", set_=overrides)
        run("kamiyama_pillar", set_=overrides)
    assert folders[::2] == folders[1::2], "the same settings go to the same folder"
    assert len(set(folders)) == 6
    assert [folder.name for folder in folders[:6:2]] == [
        "kamiyama_pillar",
        "kamiyama_pillar,seed=3",
        "kamiyama_pillar,seed=3,tolerance.preset=none",
    ]
    assert all(re.fullmatch(r"[\w.=,+-]+", folder.name) for folder in folders)
    monkeypatch.setattr("twin.study.view.body_view", lambda _: SimpleNamespace(page=lambda: "a page"))
    for scene, overrides in (("first_press", ()), ("block_bare", ()), ("block_bare", ("seed=3",))):
        view(scene, set_=overrides)
    pages = {page.name for page in tmp_path.glob("*.html")}
    assert pages == {"first_press.html", "block_bare.html", "block_bare,seed=3.html"}


def test_an_unwritable_cache_is_replaced_by_a_temporary_one_with_a_warning(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = twin("doctor", TWIN_CACHE=str(tmp_path / "file" / "cache"))
    assert "can't be written" in done.stderr
    assert done.returncode == 0


INTERRUPTED = """
import os, signal, twin.study.check as doctor
from twin.cli import main
def interrupted():
    try: os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt: raise {0}
doctor.examine = interrupted
main(["doctor"])
"""
WHILE_LOADING = """
import os, runpy, signal, sys
class Interrupted:
    def find_spec(name, *_): name == "cyclopts" and os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupted)
runpy.run_module("twin", run_name="__main__")
"""


@pytest.mark.parametrize("code", [INTERRUPTED.format(""), INTERRUPTED.format("ImportError"), WHILE_LOADING])
def test_an_interrupt_is_told_as_one_even_where_a_library_hides_it_or_is_loading(code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "twin: interrupted; files written so far are whole\n")


@pytest.mark.parametrize("columns", ["0", "1", "2"])
def test_help_ends_however_narrow_the_terminal(columns: str) -> None:
    assert "press.force_n" in twin("run", "--help", COLUMNS=columns).stdout


def shell(line: str) -> subprocess.CompletedProcess[str]:
    """Run a line in a shell, ``twin`` in it being the command."""
    return subprocess.run(
        ["sh", "-c", line.replace("twin", shlex.join(TWIN))], capture_output=True, text=True, timeout=300
    )


@pytest.mark.skipif(os.name == "nt", reason="a POSIX shell's redirections")
@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("twin scenes >&-", 0, ""),
        ("twin scenes >/dev/full", 1, "standard output"),
        ("cd FOLDER && rmdir FOLDER && twin check x.toml", 2, "the folder that it was started in is gone"),
    ],
)
def test_no_output_and_no_folder_are_no_internal_error(line: str, code: int, said: str, tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    ended = shell(line.replace("FOLDER", str(tmp_path / "gone")))
    assert ended.returncode == code, ended.stderr
    assert said in ended.stderr
    assert "internal" not in ended.stderr


def test_a_renderer_of_no_known_name_is_refused_before_the_press_is_solved(monkeypatch):
    monkeypatch.setenv("TWIN_VARIANT", "nonsense")
    told: list[str] = []
    with pytest.raises(InputError, match="TWIN_VARIANT is 'nonsense'"):
        run(load_scene("kamiyama_pillar"), {"picture"}, lambda stage, _: told.append(stage))
    assert told == ["design"]


def test_a_run_prints_json_and_explain_reads_its_folder(tmp_path: Path) -> None:
    """No picture, as the scene has no camera."""
    probe = ["-s", "press.probe.kind=sphere", "-s", "press.probe.diameter_mm=6", "-s", "press.force_n={z=1}"]
    done = twin("run", "block_bare", *probe, "--out", str(tmp_path / "run"), "--json")
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    (record,) = printed["rows"]
    assert record["score"] == json.loads((tmp_path / "run" / "score.json").read_text())
    assert record["score"]["tracking"] is None
    assert printed["lines"][0].startswith("contact     1 N")
    assert {Path(path).name for path in record["files"].values()} >= {"score.json", "report.html", "scene.toml"}
    assert not {path.name for path in (tmp_path / "run").iterdir()} & {"rest.png", "pressed.png", "estimate.npz"}
    explained = twin("explain", str(tmp_path / "run"))
    assert explained.returncode == 0
    assert "held by its force" in explained.stdout
    rows = json.loads(twin("explain", str(tmp_path / "run" / "score.json"), "--json").stdout)["rows"]
    assert {"key", "value", "unit", "sentence", "verdict"} == set(rows[0])


def in_json(*arguments: str) -> dict:
    """What a command prints with --json, which has the same keys for all commands."""
    printed = json.loads(twin(*arguments, "--json").stdout, parse_constant=pytest.fail)
    assert list(printed) == ["command", "ok", "lines", "rows", "notes", "problems"]
    return printed


def test_check_scenes_and_doctor_print_json(tmp_path: Path) -> None:
    wrong = tmp_path / "scene.toml"
    wrong.write_text('base = "block_bare"\n[material]\npoison_ratio = 0.3\n')
    assert twin("check", str(wrong), "--json").returncode == 2
    bad = in_json("check", str(wrong))
    assert not bad["ok"]
    assert "did you mean 'poisson_ratio'" in bad["problems"][0]
    assert twin("check", "block_bare").stdout.rstrip().endswith("ok")
    assert in_json("check", "block_bare")["rows"][0]["found"] == "ok"
    scenes = in_json("scenes")["rows"]
    assert {"name", "title", "path"} == set(scenes[0])
    assert "kamiyama_pillar" in {scene["name"] for scene in scenes}
    assert {"name": "numpy", "found": np.__version__} in in_json("doctor")["rows"]
    new = in_json("scenes", "--new", str(tmp_path / "mine"))
    assert Path(new["rows"][0]["file"]).is_file()
    assert "twin run" in new["lines"][0]


def test_every_command_takes_json(capsys: pytest.CaptureFixture[str]) -> None:
    commands = [app[name].default_command for name in app if not name.startswith("-")]
    assert len(commands) > 10
    assert not [c.__name__ for c in commands if "json_" not in inspect.signature(c).parameters]
    app["mesh"].default_command("block_bare", json_=True)
    printed = json.loads(capsys.readouterr().out)
    assert printed["ok"]
    assert f"{printed['rows'][0]['tetrahedra']} tetrahedra" in printed["lines"][0]
    with pytest.raises(InputError):
        app["export"].default_command("nowhere", format="coco", out=Path("o"), json_=True)
    printed = json.loads(capsys.readouterr().out)
    assert (printed["command"], printed["ok"]) == ("export", False)
    assert "nowhere" in printed["problems"][0]


@pytest.mark.slow
def test_json_holds_the_table_and_the_notes_that_the_screen_shows(tmp_path: Path) -> None:
    """A frame that is missing has no numbers: null, as NaN is no JSON."""
    calibration, rest = tmp_path / "flat.npz", tmp_path / "rest.png"
    assert twin("run", "first_press", "--want", "picture", "--out", str(tmp_path)).returncode == 0
    assert twin("calibrate", "--scene", "first_press", "--out", str(calibration)).returncode == 0
    done = twin("reconstruct", str(rest), str(rest), "nowhere.png", "--calibration", str(calibration), "--json")
    assert done.returncode == 3
    printed = json.loads(done.stdout, parse_constant=pytest.fail)
    seen, missing = printed["rows"]
    assert abs(seen["fz_n"]) < 0.1
    assert missing["fz_n"] is None
    assert not missing["ok"]
    assert printed["lines"][1].split("\t")[4] == f"{seen['fz_n']:.4f}"
    assert [line for line in printed["notes"] if line.startswith("frames      2, 1 failed")]
    assert "frames      2, 1 failed" in done.stderr
