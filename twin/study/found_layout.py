"""What ``twin calibrate --layout-from`` writes: the markers of a rest picture as tables of a
recipe, and a picture that shows which dots were found.

A picture alone has no millimetres. They come from the pitch that the maker drew, or from a scene
whose camera and layers are known; without either these keys are left out, as comments, and a recipe
with such a table is refused until they are given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from twin.arrays import Picture, eight_bits
from twin.errors import InputError, RecipeError
from twin.files import Fact, fact, make_folder, png_bytes, write_whole
from twin.parts.scene import Scene
from twin.sense.find_layout import FoundLayout, find_layout
from twin.study.batch.pool import counted
from twin.study.doubts import View
from twin.study.frames import read_picture

LARGEST_MM = 100.0
"""Of a pitch or a depth."""

INK = ((0, 230, 118), (255, 171, 0), (0, 176, 255), (255, 64, 129))
"""Colours in which layers are drawn."""

BY_HAND = 0.05
"""Standard deviation of dots' places, over the pitch, from which on it is a tolerance to state."""

NUMBERED_PX = 26.0
"""Pitch from which on every dot has its numbers; else those at the edge of the grid."""

LEAST_WIDTH_PX = 1200
"""A narrower picture is enlarged, so that numbers can be read."""


def layout_to_files(
    picture: Path,
    out: Path | None,
    overlay: Path | None,
    *,
    pitch_mm: Sequence[float] = (),
    depth_mm: Sequence[float] = (),
    scene: Scene | None = None,
) -> list[Fact]:
    """Find the markers of a rest picture; write their tables (.toml) and an overlay (.png) unless
    these are None; return a fact for every layer, and where the files are.

    Pitches and depths are one for all layers, or one each, in the order of these lines; or the
    scene, the sensor's design, gives names, depths and the scale. `InputError` for a picture
    without a lattice of dots, and for files or numbers that can't be used.
    """
    # Refuse what can't be used before anything is searched.
    for option, path, suffix in (("out", out, ".toml"), ("overlay", overlay, ".png")):
        if path is not None and path.suffix.lower() != suffix:
            raise InputError(f"--{option} {path}: must end in {suffix}")
        if path is not None and path.resolve() == picture.resolve():
            raise InputError(f"--{option} {path}: is what is read; give another name")
    if scene is not None and (pitch_mm or depth_mm):
        raise InputError("--scene gives pitches and depths: leave --pitch-mm and --depth-mm out")
    for option, values in (("pitch-mm", pitch_mm), ("depth-mm", depth_mm)):
        for value in values:
            if not 0.01 <= value <= LARGEST_MM:
                raise InputError(f"--{option} {value:g} mm: allowed are 0.01 to {LARGEST_MM:g} mm")
    if scene is not None and scene.camera is None:
        raise RecipeError("this scene has no [camera] table, so it gives no pitch in a picture")
    image = read_picture(picture)
    height, width = image.shape[:2]
    if scene is not None and scene.camera is not None:
        drawn_px = (scene.camera.width_px, scene.camera.height_px)
        if drawn_px != (width, height):
            raise InputError(
                f"{picture}: is {width}x{height} px, the scene's camera {drawn_px[0]}x"
                f"{drawn_px[1]} px: mend camera.width_px and height_px (focal_px grows with them)"
            )
    # Find the dots, and what is known of their layers in mm.
    try:
        found = find_layout(image)
    except InputError as problem:
        raise InputError(f"{picture}: {problem}") from None
    drawn = (
        _drawn(found, scene)
        if scene is not None
        else _given(found, (height, width), pitch_mm, depth_mm)
    )
    # Write the files, and state what was found.
    files: dict[Path, bytes] = {}
    if out is not None:
        files[out] = _recipe(found, drawn, picture.name, image).encode()
    if overlay is not None:
        files[overlay] = png_bytes(_draw_layout(image, found))
    for path, content in files.items():
        make_folder(path.parent)
        write_whole(path, content)
    facts = _facts(found, drawn, scene)
    if files:
        names = list(map(str, files))
        line, record = fact("written", ", ".join(names))
        facts.append((line, {**record, "files": names}))
    return facts


_IN_A_LAYER = ("columns", "rows", "pitch_px", "diameter_px", "angle_deg")
"""What is told of a layer's grid."""


def _facts(found: FoundLayout, drawn: list[_Drawn], scene: Scene | None) -> list[Fact]:
    """Return a fact for every layer, one for its pitch by the scene's camera, and one for what
    isn't on any grid."""
    facts = [
        fact(
            name,
            f"{{dots}} {layer.polarity} dots, {{columns}} columns x {{rows}} rows, "
            f"{layer.lattice}, pitch {{pitch_px:.4g}} px, diameter {{diameter_px:.3g}} px, turned "
            "by {angle_deg:.2g} deg, dots {scatter:.2g} of the pitch off their places (standard "
            "deviation)",
            {
                "dots": len(layer),
                **{key: getattr(layer, key) for key in _IN_A_LAYER},
                "scatter": layer.scatter_px / layer.pitch_px,
            },
        )
        for name, layer in found.layers.items()
    ]
    if scene is not None and scene.camera is not None:
        for layer, own in zip(found.layers.values(), drawn, strict=True):
            wanted = scene.markers[own.name].pitch_mm
            assert own.pitch_mm is not None
            further_mm = scene.camera.focal_px * (wanted - own.pitch_mm) / layer.pitch_px
            facts.append(
                fact(
                    own.name,
                    "pitch {pitch_mm:.4g} mm by the scene's camera, drawn {drawn_mm:g} mm: equal "
                    "with focal_px = {focal_px:.4g} or, if focal_px is measured, with the lens at "
                    "pupil_mm z of about {pupil_z_mm:.4g}",
                    {
                        "pitch_mm": own.pitch_mm,
                        "drawn_mm": wanted,
                        "focal_px": scene.camera.focal_px * own.pitch_mm / wanted,
                        "pupil_z_mm": scene.camera.pupil_mm[2] + further_mm,
                    },
                )
            )
    stray = len(found.stray_px)
    if stray:
        text = "{spots} spots on no grid (dirt, glints): rings without numbers"
        facts.append(fact("other", text, {"spots": stray}))
    return facts


@dataclass(frozen=True, kw_only=True)
class _Drawn:
    """What is known of a layer in mm, None where not, and of what the scale is from."""

    name: str
    kind: str
    pitch_mm: float | None
    diameter_mm: float | None
    depth_mm: float | None
    offset_mm: tuple[float, float] | None
    scale: str


def _given(
    found: FoundLayout,
    size: tuple[int, ...],
    pitch_mm: Sequence[float],
    depth_mm: Sequence[float],
) -> list[_Drawn]:
    """Return what the command line gives of every layer."""
    count = len(found.layers)
    lists: list[list[float | None]] = []
    for option, values in (("pitch-mm", pitch_mm), ("depth-mm", depth_mm)):
        if len(values) not in (0, 1, count):
            raise InputError(
                f"--{option} has {len(values)} numbers, and the picture shows "
                f"{counted(count, 'layer')} ({', '.join(found.layers)}): give one for all, or one "
                "each"
            )
        lists.append(list(values) if len(values) == count else [*values, None][:1] * count)
    middle_px = (np.array([size[1], size[0]]) - 1) / 2
    drawn = []
    for (name, layer), pitch, depth in zip(found.layers.items(), *lists, strict=True):
        per_px = None if pitch is None else pitch / layer.pitch_px
        x, y = (layer.centre_px.mean(axis=0) - middle_px) * (per_px or 0.0)
        drawn.append(
            _Drawn(
                name=name,
                kind="print",
                pitch_mm=pitch,
                diameter_mm=None if per_px is None else layer.diameter_px * per_px,
                depth_mm=depth,
                offset_mm=None if per_px is None else (float(x), float(-y)),
                scale="given by --pitch-mm",
            )
        )
    return drawn


def _drawn(found: FoundLayout, scene: Scene) -> list[_Drawn]:
    """Return what a scene draws of every layer that was found, the scale being the picture's."""
    view = View.of(scene)
    names = list(scene.markers)
    if len(names) < len(found.layers):
        raise InputError(
            f"the picture shows {len(found.layers)} layers of dots ({', '.join(found.layers)}), "
            f"the scene draws {len(names)}: leave --scene out, and give --pitch-mm"
        )
    places = [view.pixels[view.markers.layer == name] for name in names]
    layers = list(found.layers.values())
    # of every layer and every drawn one, how far a dot is from the nearest marker
    near = [[cKDTree(drawn).query(layer.centre_px) for drawn in places] for layer in layers]
    off = np.array([[np.median(distance) for distance, _ in row] for row in near])
    orders = permutations(range(len(names)), len(layers))
    best = min(orders, key=lambda order: off[np.arange(len(layers)), list(order)].sum())
    drawn = []
    for layer, row, number in zip(layers, near, best, strict=True):
        own, rows = scene.markers[names[number]], view.markers.layer == names[number]
        nominal = places[number].reshape(own.columns, own.rows, 2)
        steps = [np.linalg.norm(np.diff(nominal, axis=k), axis=-1).ravel() for k in (0, 1)]
        per_px = own.pitch_mm / float(np.mean(np.concatenate(steps)))
        width = layer.diameter_px / float(np.median(view.diameter_px[rows]))
        seen = places[number]  # all of them, or those that are nearest: then off by pitches, too
        seen = seen if len(layer) == len(seen) else seen[row[number][1]]
        x, y = (layer.centre_px.mean(axis=0) - seen.mean(axis=0)) * per_px
        drawn.append(
            _Drawn(
                name=names[number],
                kind=own.kind,
                pitch_mm=layer.pitch_px * per_px,
                diameter_mm=own.diameter_mm * width,
                depth_mm=own.depth_mm,
                offset_mm=(own.offset_mm[0] + float(x), own.offset_mm[1] - float(y)),
                scale="the scene's camera",
            )
        )
    return drawn


def _recipe(found: FoundLayout, drawn: Sequence[_Drawn], name: str, image: Picture) -> str:
    """Return the text of the tables."""
    height, width = image.shape[:2]
    ground = np.mean([layer.ground_dn for layer in found.layers.values()], axis=0)
    lines = [
        f"# The markers of {name} ({width} x {height} px), found by twin calibrate --layout-from.",
        "# Paste these tables into a recipe, instead of its own [markers] tables.",
        f"# The ground between the dots, for [cover]: albedo = {_shares(ground)}",
    ]
    for layer, own in zip(found.layers.values(), drawn, strict=True):
        lines += ["", *_table(layer, own, name)]
    return "\n".join(lines) + "\n"


def _table(layer: FoundLayout.Layer, own: _Drawn, name: str) -> list[str]:
    """Return the lines of a layer's table; of a hexagonal one as comments."""
    full = layer.columns * layer.rows
    where = f"{name}: {len(layer)} dots on {full} places of the grid"
    lines = [
        f"[markers.{own.name}]",
        f'kind = "{own.kind}"  # print: flat dots; bead: spheres cast into the body',
    ]
    if own.depth_mm is None:
        lines.append("# depth_mm =    # below the outer surface: no picture shows it, fill it in")
    else:
        lines.append(f"depth_mm = {own.depth_mm:g}")
    if own.pitch_mm is None or own.diameter_mm is None or own.offset_mm is None:
        lines += [
            f"# pitch_mm =    # {layer.pitch_px:.4g} px in the picture: fill it in",
            f"# diameter_mm = # {layer.diameter_px / layer.pitch_px:.3g} times the pitch",
        ]
    else:
        x, y = own.offset_mm
        lines += [
            f"pitch_mm = {own.pitch_mm:.4g}  # {layer.pitch_px:.4g} px",
            f"diameter_mm = {own.diameter_mm:.3g}  # {layer.diameter_px:.3g} px",
            f"offset_mm = [{x:.2f}, {y:.2f}]",
            f'source.pitch_mm = "{own.scale}"',
            f'source.diameter_mm = "{name}, by the same scale"',
            "assumed.offset_mm = \"the camera looks at the body's middle; without --scene through "
            "the picture's, not principal_px\"",
        ]
    lines += [
        f"columns = {layer.columns}",
        f"rows = {layer.rows}",
        f"colour = {_shares(layer.colour_dn)}",
        f'source.columns = "{where}"',
        f'source.rows = "{where}"',
        f'assumed.kind = "{"flat dots" if own.kind == "print" else "as drawn"}"',
        f'assumed.colour = "counts of {name} over 255"',
    ]
    if own.depth_mm is not None:
        lines.append('assumed.depth_mm = "as given or drawn: no picture shows it"')
    if own.pitch_mm is not None and layer.scatter_px > BY_HAND * layer.pitch_px:
        off = own.pitch_mm * layer.scatter_px / layer.pitch_px
        lines.append(f"# dots lie off their places; in [tolerance]: print_mm = {off:.2g}")
    if abs(layer.angle_deg) > 0.5:
        turn = f"tilt_deg = [0, 0, {layer.angle_deg:.1f}]"
        lines.append(f"# rows are turned in the picture; in [camera]: {turn}")
    if layer.lattice == "square":
        return lines
    return [
        "# A hexagonal grid: recipes hold square ones only, so this table is a comment. Python's",
        "# twin.find_layout(rest).layout_px gives its dots to twin.track.",
        *(f"# {line}" for line in lines),
    ]


def _shares(counts: np.ndarray) -> str:
    shares = np.clip(np.asarray(counts) / 255, 0.02, 1.0)
    return "[" + ", ".join(f"{share:.2f}" for share in shares) + "]"


def _draw_layout(picture: Picture, found: FoundLayout) -> Picture:
    """Return a picture with a ring around every dot, in its layer's colour, with column,row below
    it; rings without numbers are spots on no grid."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(eight_bits(picture)).convert("RGB")
    scale = max(1, round(LEAST_WIDTH_PX / image.width))
    image = image.resize((image.width * scale, image.height * scale), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(image)

    def ring(place: np.ndarray, radius: float, ink: tuple[int, int, int]) -> None:
        x, y = (place + 0.5) * scale - 0.5
        reach = radius * scale + 2
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), outline=ink, width=2)

    for number, (name, layer) in enumerate(found.layers.items()):
        ink = INK[number % len(INK)]
        often = layer.pitch_px * scale >= NUMBERED_PX * 2
        for place, (column, row) in zip(layer.centre_px, layer.index, strict=True):
            ring(place, layer.diameter_px / 2, ink)
            if often or column == 0 or row == 0:
                x, y = (place + 0.5) * scale
                text = f"{column},{row}"
                y += layer.diameter_px / 2 * scale + 2
                draw.text(
                    (x, y), text, fill=ink, anchor="mt", stroke_width=1, stroke_fill=(0, 0, 0)
                )
        legend = f"{name}: {len(layer)} dots, column,row"
        draw.text((4, 4 + 14 * number), legend, fill=ink, stroke_width=1, stroke_fill=(0, 0, 0))
    for place in found.stray_px:
        ring(place, 6.0, (60, 60, 255))
    return np.array(image)
