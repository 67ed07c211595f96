"""Commands for one scene and its files: run, mesh, scenes, check, doctor, view."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.options import Overrides, SceneName, Whole, file_name, load, scene_named
from twin.errors import InputError, did_you_mean
from twin.show.terminal import progress

PAGES = (".html", ".htm")
WANTED = ("displacement", "picture", "tracking", "forces", "score", "report")


def run(
    scene: SceneName,
    *,
    out: Annotated[
        Path | None,
        Parameter(
            help="Folder for the results (default out/<scene>, with the overrides behind the name)."
        ),
    ] = None,
    want: Annotated[
        tuple[str, ...],
        Parameter(help="What to compute (default all).", show_default=False, negative_iterable=""),
    ] = (),
    live: Annotated[
        bool,
        Parameter(help="Move the probe by hand in a page on this machine instead.", negative=""),
    ] = False,
    port: Annotated[
        Whole,
        Parameter(help="Port of the live page (default: any that is free).", show_default=False),
    ] = 0,
    set_: Overrides = (),
) -> None:
    """Compute one press through the whole twin.

    --want takes any of displacement, picture, tracking, forces, score, report, separated by commas.
    Only these, and what they need, are computed; other files are absent. Where a step of the press
    after the first has no equilibrium or doesn't converge, the results of the step before are
    saved, and the exit code is 3.

    With --live nothing is written: a page opens at the address that is printed, where keys, sliders
    or the pointer move and load the scene's probe, and picture and force field follow, with their
    errors. It listens on this machine only. Fewer contact patches and coarser pictures than the
    scene's are the default.

    Examples:
    twin run kamiyama_pillar
    twin run my_scene.toml -s press.force_n='{z=2}' --out out/two
    twin run sato_press --want displacement
    twin run kamiyama_pillar --live
    """
    if live:
        _live(scene, out, want, port, set_)
        return
    if port:
        raise InputError("--port: belongs to --live")
    from twin.study.recipe import find_scene
    from twin.study.run import run_to_folder

    wanted = _wanted(want)
    path = find_scene(scene)
    loaded = load(scene, set_)
    folder = out or Path("out") / file_name(path, set_)
    with scene_named(scene):
        print(run_to_folder(loaded, folder, wanted, progress=progress()))


def _live(
    scene: str, out: Path | None, want: Sequence[str], port: int, set_: Sequence[str]
) -> None:
    from twin.study.live import QUICK, run_live

    if out is not None or want:
        raise InputError("--live writes nothing and shows all there is: leave out --out and --want")
    with scene_named(scene):
        run_live(load(scene, (*QUICK, *set_)), port, progress())


def _wanted(names: Sequence[str]) -> frozenset[str]:
    given = [part.strip() for name in names for part in name.split(",") if part.strip()]
    for name in given:
        if name not in WANTED:
            hint = did_you_mean(name, WANTED, f"allowed are {', '.join(WANTED)}")
            raise InputError(f"--want {name}: unknown; {hint}")
    if names and not given:
        raise InputError(
            f"--want names nothing: give any of {', '.join(WANTED)}, or leave it out for all"
        )
    return frozenset(given or WANTED)


def mesh(
    scene: SceneName,
    *,
    rebuild: Annotated[
        bool, Parameter(help="Make the meshes again, even if shipped or cached.", negative="")
    ] = False,
    export: Annotated[
        Path | None, Parameter(help="Write the truth's mesh as .vtu for other programs.")
    ] = None,
    set_: Overrides = (),
) -> None:
    """Show the meshes of a scene's body, or make them again.

    Examples:
    twin mesh sato_press
    twin mesh sato_press --export finger.vtu
    """
    from twin.study.check import describe_meshes

    loaded = load(scene, set_)
    lines = describe_meshes(loaded, rebuild=rebuild, export=export, progress=progress())
    print("\n".join(lines))


def scenes() -> None:
    """List the shipped scenes."""
    from twin.study.recipe import load_scene, shipped_scenes

    for name in shipped_scenes():
        print(f"{name:20s} {load_scene(name).title}")


def check(
    file: Annotated[
        str,
        Parameter(
            help="Scene or sweep file, calibration (.npz), result folder or dataset; or a rest "
            "picture."
        ),
    ],
    second: Annotated[
        Path | None, Parameter(help="Another rest picture: is this camera good enough?")
    ] = None,
    /,
    *,
    scene: Annotated[
        str | None, Parameter(help="The pictures' sensor: a scene (path or shipped name).")
    ] = None,
    set_: Overrides = (),
) -> None:
    """Check a file or a folder and print everything that is wrong with it.

    Two rest pictures of a sensor and its scene: print noise, saturation, blur, compression, the
    errors of shifts and forces to expect, and whether the camera is good enough.

    Examples:
    twin check my_scene.toml
    twin check out/kamiyama_pillar
    twin check rest1.png rest2.png --scene my_scene.toml
    """
    if (second is None) != (scene is None):
        raise InputError(
            "two rest pictures and --scene belong together: twin check rest1.png rest2.png --scene "
            "SCENE"
        )
    if second is not None and scene is not None:
        from twin.study.camera_check import check_camera

        loaded = load(scene, set_)
        with scene_named(scene):
            print("\n".join(check_camera(Path(file), second, loaded)))
        return
    from twin.study.check import check_path

    print("\n".join(check_path(file)))


def doctor() -> None:
    """Print what is installed, which Mitsuba variant and solver are used, and where the caches are.

    Exit code 4 if the main job can't run on this machine.
    """
    from twin.errors import MissingCapability
    from twin.study.check import examine

    lines, missing = examine()
    print("\n".join(lines))
    if missing:
        raise MissingCapability("the main job can't run: " + "; ".join(missing))


def view(
    path: Annotated[
        str,
        Parameter(help="A scene (path or shipped name), or the folder of a run or of a dataset."),
    ],
    *,
    out: Annotated[
        Path | None,
        Parameter(
            help="Page to write (default: view.html in the run's folder; SCENE.html or "
            "DATASET.html here), or a film: .gif or .png."
        ),
    ] = None,
    window: Annotated[
        bool, Parameter(negative="", help="Open a window (needs a display and OpenGL).")
    ] = False,
    set_: Overrides = (),
) -> None:
    """Write a page that shows a body under its press and turns in the browser, without a server.

    The body is deformed, with its marker layers, tractions, and which patches stick or slip; every
    step of the press's path is a frame. Drag to turn, wheel to come nearer.

    An --out that ends in .gif or .png is an animated picture instead: what the camera sees along
    the path.

    With --window the same is shown in a window, with sliders for the step and for how large
    displacements are shown.

    Of a dataset it shows a sheet of samples, with the truth drawn in.

    Examples:
    twin view kamiyama_shear
    twin view out/kamiyama_pillar
    twin view kamiyama_shear --out shear.gif
    twin view kamiyama_shear --window
    """
    from twin.errors import InputError

    folder = Path(path)
    is_dataset = (folder / "meta" / "info.json").is_file()
    if window and (out is not None or is_dataset):
        raise InputError(
            "--window shows a scene or a run's folder, and writes nothing: leave --out, or "
            "--window, away"
        )
    if is_dataset:
        from twin.study.dataset.reader import view_dataset

        print(view_dataset(folder, out or Path(f"{folder.name or 'dataset'}.html")))
        return
    from twin.files import make_folder
    from twin.study.recipe import find_scene
    from twin.study.sensor import Sensor
    from twin.study.view import FILMS, view_scene, write_film

    if folder.is_dir() and not (folder / "scene.toml").is_file():
        raise InputError(
            f"{path}: holds neither scene.toml (of a run) nor meta/info.json (of a dataset)"
        )
    if folder.is_dir():
        page = out or folder / "view.html"
    else:
        page = out or Path(f"{file_name(find_scene(path), set_)}.html")
    if page.suffix.lower() not in {*PAGES, *FILMS}:
        raise InputError(
            f"--out {page}: allowed are .html for a page, {' and '.join(sorted(FILMS))} for a film"
        )
    scene = load(str(folder / "scene.toml") if folder.is_dir() else path, set_)
    bar = progress()
    sensor = Sensor(scene, bar)
    if window:
        from twin.show.body_view import require_window, show_body
        from twin.study.view import body_view

        require_window()
        shown = body_view(sensor)
        if bar is not None:
            bar("done", 1.0)
        show_body(shown)
        return
    make_folder(page.parent)
    write = write_film if page.suffix.lower() in FILMS else view_scene
    with scene_named(path):
        print(write(sensor, page))
    if bar is not None:
        bar("done", 1.0)
