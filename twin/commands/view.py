"""`twin view`: something to look at, from a scene or what a command wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import Overrides, load, progress

PAGES = (".html", ".htm")


def view(
    path: Annotated[str, Parameter(help="A scene (path or shipped name), or the folder of a run or of a dataset.")],
    *,
    out: Annotated[
        Path | None,
        Parameter(help="Page to write (default: view.html in the folder; DATASET.html here), or a film: .gif or .png."),
    ] = None,
    window: Annotated[bool, Parameter(negative="", help="Open a window (needs a display and OpenGL).")] = False,
    set_: Overrides = (),
) -> None:
    """Write a page that shows a body under its press and turns in the browser, without a server.

    The body is deformed, with its marker layers, tractions, and which patches stick or slip; every step of the press's
    path is a frame. Drag to turn, wheel to come nearer.

    An --out that ends in .gif or .png is an animated picture instead: what the camera sees along the path.

    With --window the same is shown in a window, with sliders for the step and for how large displacements are shown.

    Of a dataset it shows a sheet of samples, with the truth drawn in.

    Examples:
    twin view kamiyama_shear
    twin view out/kamiyama_pillar
    twin view kamiyama_shear --out shear.gif
    twin view kamiyama_shear --window
    """
    folder = Path(path)
    is_dataset = (folder / "meta" / "info.json").is_file()
    if window and (out is not None or is_dataset):
        from twin.errors import InputError

        raise InputError("--window shows a scene or a run's folder, and writes nothing: leave --out, or --window, away")
    if is_dataset:
        from twin.study.dataset.view import view_dataset

        print(view_dataset(folder, out or Path(f"{folder.name or 'dataset'}.html")))
        return
    from twin.errors import InputError
    from twin.results import make_folder
    from twin.study.film import KINDS, write_film
    from twin.study.sensor import Sensor
    from twin.study.view import view_scene

    if folder.is_dir() and not (folder / "scene.toml").is_file():
        raise InputError(f"{path}: holds neither scene.toml (of a run) nor meta/info.json (of a dataset)")
    page = out or (folder if folder.is_dir() else Path()) / "view.html"
    if page.suffix.lower() not in {*PAGES, *KINDS}:
        raise InputError(f"--out {page}: allowed are .html for a page, {' and '.join(sorted(KINDS))} for a film")
    scene = load(str(folder / "scene.toml") if folder.is_dir() else path, set_)
    told = progress()
    if window:
        from twin.show.window import require_window, show_body
        from twin.study.view import body_view

        require_window()
        shown = body_view(Sensor(scene, told))
        if told is not None:
            told("done", 1.0)
        show_body(shown)
        return
    make_folder(page.parent)
    if page.suffix.lower() in KINDS:
        print(write_film(Sensor(scene, told), page))
    else:
        print(view_scene(scene, page, Sensor(scene, told)))
    if told is not None:
        told("done", 1.0)
