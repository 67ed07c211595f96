"""What ``twin scenes --new`` writes: a commented recipe of a soft pad, from the numbers that its
maker knows.

Whatever is not given follows from the size as on a pad of 25 x 25 x 4 mm with one layer of dots,
`gelpad_press`. The file is validated before it is written, and a file that is there is kept.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.errors import InputError
from twin.files import write_whole

SILICONE, ACRYLIC = 1.41, 1.49
"""Refractive indices."""

PLATE_MM = 3.0
"""Thickness of the plate, but for cameras that are close."""

SEEN = 0.95
"""Share of the picture that dots may lie in."""

TILT_DEG, PUPIL_MM, ALIGNED = 0.2, 0.05, 1 / 8
"""Tolerances of the camera, or less: it is turned and moved until dots lie where they are drawn, to
this share of the pitch. By a whole pitch no tracker knows which dot is which."""

MOST_SITES = 29
"""Columns or rows of the forces' grid, but on long strips."""

LEAST_DOTS = 3
"""Columns or rows of dots."""

WIDE, WIDE_PX = 0.36, 4.0
"""Usual diameter of a dot, over the pitch, and its least in the picture."""

FAR = 2.0
"""Distance of the lens, over the one that shows all dots, from which on a nearer one is named."""


@dataclass(frozen=True, kw_only=True)
class Pad:
    """What a maker knows of a pad. What is None or empty follows from the size.

    Attributes
    ----------
    size_mm
        Width (along the picture's rows), length and thickness of the pad, mm.
    modulus_mpa
        Young's modulus, MPa.
    depth_mm, pitch_mm, diameter_mm
        Of the dots, mm: one number, or two for two layers.
    camera_mm
        From the back of the pad to the lens, mm.
    fov_deg
        Full angle of the picture's width, degrees (default 39).
    sensor_mm
        Or: width of the camera's chip, mm,
    focal_mm
        and focal length of its lens, mm.
    resolution
        Width and height of the picture, px.
    """

    size_mm: tuple[float, float, float] = (25.0, 25.0, 4.0)
    modulus_mpa: float = 0.2
    depth_mm: Sequence[float] = ()
    pitch_mm: Sequence[float] = ()
    diameter_mm: Sequence[float] = ()
    camera_mm: float | None = None
    fov_deg: float | None = None
    sensor_mm: float | None = None
    focal_mm: float | None = None
    resolution: tuple[int, int] = (640, 480)

    def write(self, path: Path) -> tuple[Path, list[str]]:
        """Write a recipe; return its file, and lines about it with what is unlikely in it.
        `InputError` for numbers out of range, dots that don't fit, or a file of this name."""
        from twin.parts.markers import MarkerSet
        from twin.study.doubts import doubts
        from twin.study.recipe import validate_scene

        if not path.name:
            raise InputError(f"--new '{path}': give the name of a file, such as mine.toml")
        target = path if path.suffix == ".toml" else path.with_name(path.name + ".toml")
        if target.exists():
            raise InputError(f"{target}: is there already; give another name, or move it away")
        if not target.parent.is_dir():
            raise InputError(f"{target}: there is no folder {target.parent}; make it first")
        text, unseen = _recipe_of(self)
        table = tomllib.loads(text)
        scene = validate_scene(table, str(target))
        MarkerSet.place(scene.body, scene.markers)
        write_whole(target, text.encode())
        dots = [f"{layer.columns} x {layer.rows} {name}" for name, layer in scene.markers.items()]
        said = f"{target}: {', '.join(dots)}; now: twin run {target}"
        return target, [said, *unseen, *(f"warning: {line}" for line in doubts(scene))]


def _in_range(option: str, value: float, unit: str, low: float, high: float, remedy: str) -> None:
    if not low <= value <= high:
        raise InputError(
            f"--{option} {value:g} {unit}: allowed are {low:g} to {high:.4g} {unit}; {remedy}"
        )


def _layers(pad: Pad, focal: float) -> list[tuple[float, float, float]]:
    """Return depth, pitch and diameter of every layer, mm; ``focal`` is the lens's, px."""
    width, length, thickness = pad.size_mm
    count = max(len(pad.depth_mm), len(pad.pitch_mm), len(pad.diameter_mm), 1)
    if count > 2:
        raise InputError(f"{count} layers of dots: allowed are one or two, a number each")
    px_per_mm = min(
        SEEN * px / side for side, px in zip((width, length), pad.resolution, strict=True)
    )
    if pad.camera_mm is not None:
        px_per_mm = focal / (pad.camera_mm + thickness)
    usual = max(min(width, length) / 20, WIDE_PX / WIDE / px_per_mm)
    usual = min(usual, min(width, length) / 4)
    near = min(0.5, thickness / 4)
    found = []
    for number in range(count):
        pitch = _nth(pad.pitch_mm, number, usual)
        depth = _nth(pad.depth_mm, number, near * (1 + number))
        diameter = _nth(pad.diameter_mm, number, WIDE * pitch)
        _in_range("depth-mm", depth, "mm", 0.05, thickness - 0.05, "inside the pad")
        _in_range("pitch-mm", pitch, "mm", 0.1, min(width, length) / 3, "three dots must fit")
        _in_range("diameter-mm", diameter, "mm", 0.02, 0.9 * pitch, "dots must stand apart")
        found.append((depth, pitch, diameter))
    return found


def _nth(values: Sequence[float], number: int, usual: float) -> float:
    """Return a layer's number: its own, the only one that is given, or the usual one."""
    if not values:
        return usual
    return values[min(number, len(values) - 1)]


def _fov(pad: Pad) -> float:
    """Return the full angle of the picture's width, degrees."""
    if (pad.sensor_mm is None) != (pad.focal_mm is None):
        raise InputError("--sensor-mm and --focal-mm belong together: the chip's width, the lens")
    if pad.sensor_mm is None or pad.focal_mm is None:
        return 39.0 if pad.fov_deg is None else pad.fov_deg
    if pad.fov_deg is not None:
        raise InputError("give --fov-deg, or --sensor-mm and --focal-mm, not both")
    _in_range("sensor-mm", pad.sensor_mm, "mm", 0.5, 50, "the width of the chip")
    _in_range("focal-mm", pad.focal_mm, "mm", 0.5, 200, "as printed on the lens")
    return math.degrees(2 * math.atan(pad.sensor_mm / 2 / pad.focal_mm))


def _room(side: float, diameter: float) -> float:
    """Return how far from the pad's middle dots may lie, mm: a border stays free."""
    return side / 2 - max(0.06 * side, diameter)


def _distance_to_see_all(pad: Pad, layers: list[tuple[float, float, float]], focal: float) -> float:
    """Return the distance of the lens from the pad's back, mm, from which all dots are seen."""
    *sides, thickness = pad.size_mm
    way = max(
        (_room(side, diameter) + diameter) * 2 * focal / px / SEEN - (thickness - depth) / SILICONE
        for depth, _, diameter in layers
        for side, px in zip(sides, pad.resolution, strict=True)
    )
    # the plate shortens the way by refraction
    distance = way + (1 - 1 / ACRYLIC) * min(PLATE_MM, way / (3 + 1 / ACRYLIC))
    return max(6.0, math.ceil(10 * distance) / 10)


def _layer_tables(
    pad: Pad, layers: list[tuple[float, float, float]], distance: float, plate: float, focal: float
) -> tuple[str, tuple[float, float], list[str]]:
    """Return the tables of the layers, what the dots of the first one span along x and y, mm, and a
    line on how many more of it fit on the pad. There are as many dots as the camera sees."""
    *sides, thickness = pad.size_mm
    extent = (0.0, 0.0)
    text, unseen = "", []
    for number, (depth, pitch, diameter) in enumerate(layers):
        # what the camera sees at this depth, refraction shortening the way
        way = distance - plate + plate / ACRYLIC + (thickness - depth) / SILICONE
        seen = [SEEN * way * px / 2 / focal - diameter for px in pad.resolution]
        room = [_room(side, diameter) for side in sides]
        half = [min(pair) for pair in zip(seen, room, strict=True)]
        most, (columns, rows) = (
            [min(int(2 * h / pitch + 1e-9) + 1, 200) - number for h in each]
            for each in (room, half)
        )
        if min(columns, rows) < LEAST_DOTS:
            raise InputError(
                f"--pitch-mm {pitch:g} mm: only {max(columns, 0)} x {max(rows, 0)} dots fit "
                f"into {2 * half[0]:.3g} x {2 * half[1]:.3g} mm that the camera sees of the pad "
                f"(allowed: {LEAST_DOTS} x {LEAST_DOTS} and more); reduce the pitch, increase "
                "--fov-deg, or move the camera away (--camera-mm)"
            )
        if number == 0:
            extent = (pitch * (columns - 1), pitch * (rows - 1))
            if most != [columns, rows]:
                short = [(r + diameter) / (s + diameter) for r, s in zip(room, seen, strict=True)]
                all_at = math.ceil(distance + way * (max(short) - 1) + 1)
                wide, high = (2 * s + diameter for s in seen)
                unseen.append(
                    f"the pad has room for {most[0]} x {most[1]} dots, but the picture shows only "
                    f"{wide:.3g} x {high:.3g} mm of it; --camera-mm {all_at} shows all"
                )
        name, colour, shares = "dots", "black", [0.03, 0.03, 0.03]
        if len(layers) == 2:
            name = colour = ("red", "blue")[number]
            shares = ([0.75, 0.08, 0.06], [0.06, 0.10, 0.75])[number]
        text += f"""
[markers.{name}]
kind = "print"        # flat dots; "bead" for small spheres
depth_mm = {depth:.4g}        # below the surface that is pressed
pitch_mm = {pitch:.4g}
diameter_mm = {diameter:.4g}
columns = {columns}          # along x: as many as the camera sees
rows = {rows}             # along y
colour = {shares}  # reflectance in red, green, blue
assumed = "{colour} dots, as given to twin scenes --new"
"""
    return text, extent, unseen


def _sites(pad: Pad, pitch: float, extent: tuple[float, float]) -> tuple[float, int, int]:
    """Return pitch, columns and rows of the sites of forces, over the dots but no further apart
    than a press is wide on thin rubber: by sites 1.75 to 3 mm apart on 3 mm forces were 40 to 60 %
    off, by 0.9 mm 2 to 23.
    """
    *sides, thickness = pad.size_mm
    site = min(pitch, 0.3 * thickness)
    site = max(site, min(max(extent) / (MOST_SITES - 1), min(sides) / 3, 10))
    columns, rows = (
        min(int(own / site + 1e-6) + 1, int(side / site + 1e-6), 64)
        for own, side in zip(extent, sides, strict=True)
    )
    return site, columns, rows


def _recipe_of(pad: Pad) -> tuple[str, list[str]]:
    """Return the text of a recipe, and lines on what the camera doesn't use; `InputError` for
    numbers out of range, or dots that don't fit.
    """
    from twin.parts.scene import Scene

    width, length, thickness = pad.size_mm
    sides = (width, length)
    for side in sides:
        _in_range("size-mm", side, "mm", 5, 250, "width and length of the pad come first")
    _in_range("size-mm", thickness, "mm", 1, 100, "the thickness comes last")
    _in_range("modulus-mpa", pad.modulus_mpa, "MPa", 0.003, 50, "1 MPa = 1000 kPa")
    for pixels in pad.resolution:
        _in_range("resolution", pixels, "px", 64, 8192, "width and height of the picture")
    fov = _fov(pad)
    _in_range("fov-deg", fov, "deg", 5, 120, "the full angle of the picture's width")
    # The camera behind its plate, the dots that it sees, and LEDs around it.
    focal = pad.resolution[0] / 2 / math.tan(math.radians(fov / 2))
    layers = _layers(pad, focal)
    near = _distance_to_see_all(pad, layers, focal)
    distance = near if pad.camera_mm is None else pad.camera_mm
    _in_range("camera-mm", distance, "mm", 2, 1000, "from the back of the pad to the lens")
    plate = min(PLATE_MM, distance / 4)
    tables, extent, unseen = _layer_tables(pad, layers, distance, plate, focal)
    if distance > FAR * near:
        unseen.append(
            f"the dots fill only {100 * near / distance:.0f} % of the picture's width or height; "
            f"--camera-mm {near:g} fills it"
        )
    height = thickness + distance
    led = round(max(1.0, 0.48 * min(sides)), 3)
    led_z = round(height - 0.08 * (distance - plate), 3)
    # A press by Hertz' law, for rubber that keeps its volume.
    probe = 0.24 * min(sides)
    depth = min(0.12 * thickness, 0.08 * probe)
    force = 16 / 9 * pad.modulus_mpa * math.sqrt(probe / 2) * depth**1.5
    site, site_columns, site_rows = _sites(pad, layers[0][1], extent)
    coat = min(0.1, layers[0][0] / 5)
    ground = [0.35] * 3 if len(layers) == 1 else [0.03] * 3
    corners = [[x, y, led_z] for x in (led, -led) for y in (led, -led)]
    slack = min(0.03, min(depth_mm for depth_mm, *_ in layers) / 5)
    deepest = max(depth_mm for depth_mm, *_ in layers)
    room = Scene.Tolerance(depth_mm=slack).most_of_thickness_mm(thickness, deepest)
    thickness_sd = min(0.02 * thickness, 0.9 * room)
    closest = min(pitch for _, pitch, _ in layers)
    pupil = min(PUPIL_MM, ALIGNED * closest)
    tilt = min(TILT_DEG, math.degrees(ALIGNED * closest / height))
    printed = min(0.03, closest / 20)
    text = (
        Path(__file__)
        .with_suffix(".txt")
        .read_text(encoding="utf-8")
        .format(
            acrylic=ACRYLIC,
            coat=coat,
            corners=corners,
            depth=depth,
            distance=distance,
            focal=focal,
            force=force,
            fov=fov,
            ground=ground,
            height=height,
            length=length,
            pad=pad,
            plate=plate,
            printed=printed,
            probe=probe,
            pupil=pupil,
            silicone=SILICONE,
            site=site,
            site_columns=site_columns,
            site_rows=site_rows,
            slack=slack,
            tables=tables,
            thickness=thickness,
            thickness_sd=thickness_sd,
            tilt=tilt,
            width=width,
            x=0.04 * width,
            y=0.02 * length,
        )
    )
    return text, unseen
