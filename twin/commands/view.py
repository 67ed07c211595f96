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
    set_: Overrides = (),
) -> None:
    """Write a page that shows a body under its press and turns in the browser, without a server.

    The body is deformed, with its marker layers, tractions, and which patches stick or slip; every step of the press's
    path is a frame. Drag to turn, wheel to come nearer.

    An --out that ends in .gif or .png is an animated picture instead: what the camera sees along the path.

    Of a dataset it shows a sheet of samples, with the truth drawn in.

    Examples:
    twin view kamiyama_shear
    twin view out/kamiyama_pillar
    twin view kamiyama_shear --out shear.gif
    """
    folder = Path(path)
    if (folder / "meta" / "info.json").is_file():
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
    make_folder(page.parent)
    told = progress()
    if page.suffix.lower() in KINDS:
        print(write_film(Sensor(scene, told), page))
    else:
        print(view_scene(scene, page, Sensor(scene, told)))
    if told is not None:
        told("done", 1.0)
