"""The command line: arguments in, exit codes out; every decision lives elsewhere.

Heavy packages are imported inside the commands, so that ``twin --help`` answers at once.
"""

from __future__ import annotations

import importlib.metadata
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

from cyclopts import App, CycloptsError, Parameter

from twin.errors import InputError, TwinError

app = App(
    name="twin",
    version=lambda: importlib.metadata.version("tactile-twin"),
    help="Physics-based digital twin of camera-based tactile sensors.",
    help_epilogue="Example: twin run kamiyama_pillar -s press.force_n='{z=5}' --out out/five",
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
    result_action="return_none",
)

SceneName = Annotated[str, Parameter(help="Path of a scene file, or the name of a shipped scene (see: twin scenes).")]
Overrides = Annotated[
    tuple[str, ...],
    Parameter(
        name=["-s", "--set"],
        help="Override any scene key: -s material.poisson_ratio=0.49",
        show_default=False,
        negative_iterable="",
    ),
]
WANTED = ("displacement", "picture", "tracking", "forces", "score", "report")


@app.command(help_epilogue="Examples: twin run kamiyama_pillar; twin run my_scene.toml -s press.force_n='{z=2}'")
def run(
    scene: SceneName,
    *,
    out: Annotated[Path | None, Parameter(help="Folder for the results (default out/<scene>).")] = None,
    want: Annotated[
        tuple[str, ...], Parameter(help="What to compute (default all).", show_default=False, negative_iterable="")
    ] = (),
    set_: Overrides = (),
) -> None:
    """Take one press through the whole twin.

    What can be wanted: displacement, picture, tracking, forces, score, report; several, separated by commas. Only
    what is wanted, and what it needs, is computed; unwanted files are absent.

    Examples: twin run kamiyama_pillar; twin run sato_press --want displacement --out here; twin run my_scene.toml -s
    press.force_n='{z=2}'.
    """
    from twin.study.recipe import find_scene
    from twin.study.run import run_to_folder

    wanted = _wanted(want)
    path = find_scene(scene)
    loaded = _load(scene, set_)
    folder = out or Path("out") / path.stem
    summary = run_to_folder(loaded, folder, wanted, progress=_progress())
    print(summary)


@app.command(help_epilogue="Example: twin mesh sato_press --rebuild")
def mesh(
    scene: SceneName,
    *,
    rebuild: Annotated[bool, Parameter(help="Make the meshes anew, even if shipped or cached.", negative="")] = False,
    export: Annotated[Path | None, Parameter(help="Write the truth's mesh as .vtu for other programs.")] = None,
    set_: Overrides = (),
) -> None:
    """Show the meshes of a scene's body, or make them anew."""
    from twin.study.meshes import describe_meshes

    for line in describe_meshes(_load(scene, set_), rebuild=rebuild, export=export, progress=_progress()):
        print(line)


@app.command(help_epilogue="Example: twin calibrate --scene sato_press --out scenes/sato_calibration.npz")
def calibrate(
    *,
    scene: SceneName,
    out: Annotated[Path, Parameter(help="Calibration file to write (.npz).")],
    method: Annotated[str | None, Parameter(help="sato, compliance or halfspace (default: the scene's).")] = None,
    set_: Overrides = (),
) -> None:
    """Calibrate a scene's sensor on the twin and write the calibration file.

    Method sato presses the simulated sensor at every site in three directions, in pictures with noise.
    """
    from twin.study.calibrate import calibrate_to_file

    overrides = (*set_, f"calibration.method={method}") if method else set_
    print(calibrate_to_file(_load(scene, overrides), out, progress=_progress()))


@app.command
def scenes() -> None:
    """List the shipped scenes."""
    from twin.study.recipe import load_scene, shipped_scenes

    for name in shipped_scenes():
        print(f"{name:20s} {load_scene(name).title}")


@app.command(help_epilogue="Examples: twin check my_scene.toml; twin check out/kamiyama_pillar")
def check(file: Annotated[str, Parameter(help="Scene file, calibration (.npz) or result folder.")]) -> None:
    """Check a file or a result folder and say everything that is wrong with it."""
    from twin.study.check import check_path

    for line in check_path(file):
        print(line)


@app.command
def doctor() -> None:
    """Say what is installed, which Mitsuba variant and solver are used, and where the caches are.

    Exit code 4 if the main job can't run on this machine.
    """
    from twin.study.doctor import examine

    report = examine()
    print("\n".join(report.lines))
    if report.missing:
        from twin.errors import MissingCapability

        raise MissingCapability("the main job can't run: " + "; ".join(report.missing))


def _load(scene: str, overrides: Sequence[str]) -> Any:
    from twin.study.recipe import load_scene, parse_override

    return load_scene(scene, dict(parse_override(text) for text in overrides))


def _wanted(names: Sequence[str]) -> frozenset[str]:
    import difflib

    given = [part.strip() for name in names for part in name.split(",") if part.strip()]
    for name in given:
        if name not in WANTED:
            near = difflib.get_close_matches(name, WANTED, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"allowed are {', '.join(WANTED)}"
            raise InputError(f"--want {name}: unknown; {hint}")
    return frozenset(given or WANTED)


def _progress() -> Any:
    from twin.show.progress import progress_on_terminal

    return progress_on_terminal()


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line on stderr, without the place in the source."""
    print(f"twin: warning: {message}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with the code that `twin.errors` lists."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            app(list(arguments) if arguments is not None else None, exit_on_error=False, print_error=False)
        sys.stdout.flush()
        code = 0
    except CycloptsError as problem:
        print(f"twin: {problem}\nSee: twin --help", file=sys.stderr)
        code = 2
    except TwinError as problem:
        print(f"twin: {problem}", file=sys.stderr)
        code = problem.exit_code
    except KeyboardInterrupt:
        print("twin: interrupted; files written so far are whole", file=sys.stderr)
        code = 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except Exception as problem:  # the promise: never a traceback for users, always one for developers
        if os.environ.get("TWIN_DEBUG"):
            raise
        print(f"twin: internal error: {type(problem).__name__}: {problem}", file=sys.stderr)
        print("Set TWIN_DEBUG=1 to see where, and please report it.", file=sys.stderr)
        code = 1
    sys.exit(code)
