"""The gallery: pictures and pages of shipped scenes, made by running them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import twin
from twin.files import write_whole
from twin.show.body_view import body_page
from twin.study.view import body_view


@dataclass(frozen=True)
class Exhibit:
    """A scene and what to look at in it."""

    scene: str
    said: str


EXHIBITS = (
    Exhibit("kamiyama_pillar", "Flat sensor, 5 mm pillar: markers move away from it, the deeper red ones less."),
    Exhibit("kamiyama_twist", "The same sensor under a pillar that turns about its axis."),
    Exhibit("sato_press", "The finger under a 3 mm sphere, seen through its fisheye lens with LEDs beside it."),
    Exhibit("gelpad_press", "A gel pad 4 mm thick with one layer of printed dots, under a 6 mm sphere."),
)


OBJECTS = ("letter", "gear", "screw", "brick", "grating", "ring")
PICTURE_PX, PICTURE_MM = 240, 10.0


def make_gallery(folder: Path) -> None:
    """Write ``gallery.md``, its pictures, a page of the deformed body for each exhibit, and what objects press."""
    (folder / "pages").mkdir(parents=True, exist_ok=True)
    lines = ["# Gallery", "", "Made when this documentation was built, by `twin run` and `twin view`.", ""]
    for exhibit in EXHIBITS:
        sensor = twin.Sensor(twin.load_scene(exhibit.scene))
        state = sensor.press()
        for name, picture in (("rest", sensor.picture(None)), ("pressed", sensor.picture(state.load))):
            _save(picture, folder / f"{exhibit.scene}_{name}.png")
        page = body_page(body_view(sensor))
        write_whole(folder / "pages" / f"{exhibit.scene}.html", lambda f, page=page: f.write(page.encode()))
        lines += [
            f"## {sensor.nominal.title}", "", exhibit.said, "",
            f"![at rest]({exhibit.scene}_rest.png){{width=\"49%\"}} "
            f"![pressed]({exhibit.scene}_pressed.png){{width=\"49%\"}}", "",
            f"Turn it in the browser: <a href=\"{{root}}{exhibit.scene}.html\">the deformed body</a> "
            f"(`twin view {exhibit.scene}`).", "",
        ]  # fmt: skip
    lines += [
        "## Everyday objects", "",
        "Contact pressures under the objects of the recipes `object_letter` to "
        f"`object_ring` ({PICTURE_MM:g} mm across, brightness is the root of the pressure). "
        "`dataset_objects` presses all of them.", "",
    ]  # fmt: skip
    for name in OBJECTS:
        state = twin.Sensor(twin.load_scene(f"object_{name}")).press()
        _save(_pressures(state), folder / f"object_{name}.png")
        lines += [f'![{name}](object_{name}.png){{width="32%"}}']
    lines += [""]
    text = "\n".join(lines).replace("{root}", "../")
    (folder / "gallery.md").write_text(text, encoding="utf-8")


def _pressures(state: Any) -> np.ndarray:
    """Return a grey picture of the pressures, x to the right and y upwards."""
    (load,) = state.load.terms
    low, high = (
        np.rint((load.centre_mm[:, :2] + sign * load.half_mm) / PICTURE_MM * PICTURE_PX + PICTURE_PX / 2).astype(int)
        for sign in (-1, 1)
    )
    grey = np.zeros((PICTURE_PX, PICTURE_PX), np.uint8)
    shade = 255.0 * np.sqrt(np.minimum(state.pressure_mpa / np.quantile(state.pressure_mpa, 0.98), 1.0))
    for (u0, v0), (u1, v1), value in zip(np.maximum(low, 0), high, shade, strict=True):
        grey[v0 : max(v1, v0 + 1), u0 : max(u1, u0 + 1)] = value
    return np.repeat(grey[::-1, :, None], 3, axis=2)


def _save(picture: twin.arrays.Picture, path: Path) -> None:  # type: ignore[name-defined]
    from PIL import Image

    write_whole(path, lambda f: Image.fromarray(picture).save(f, "PNG"))
