"""A scene of stock Mitsuba: what our renderers fold, as it stands in the world.

Camera and LEDs are in air, the window is dielectric interfaces, markers and cover are triangles.
Any path integrator can make the picture, with thousands of paths a pixel where
`twin.world.picture.path_tracer` takes 64: LEDs are found by chance only.

Stock Mitsuba has pinholes and thin lenses. Of any other lens it makes a finer and wider picture by
a pinhole, and `_LENS_FILE` has which place of that each pixel shows, and how bright.

Validity: LEDs that shine by the cosine. The rubber has no sides but the sensing surface at rest
behind which a probe is seen, and the even share of light (``light.ambient``) has no source, so it
is left out. A lens shows nothing beyond `_WIDEST` of its axis; triangles of a probe are what the
camera sees of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh

from twin.arrays import Floats, Ints, Points
from twin.errors import RecipeError
from twin.files import write_whole
from twin.parts.camera import Camera
from twin.parts.load import Load
from twin.parts.scene import Scene
from twin.theory.lens import lens_inverse
from twin.theory.optics import project, reflection
from twin.world.picture.cover import Background, CoverMotion, SeeThrough
from twin.world.picture.ellipsoids import Ellipsoids

_ABOVE_MM = 1e-3
"""Height of marks above the window."""

_BEFORE_MM = 0.05
"""How far a cover that lies on a probe stands before its own triangles."""

_SUBDIVISIONS = 3
"""Of an icosahedron: 1280 triangles a marker, whose outline is .2 % of the radius off."""

_CORNERS = 32
"""Of a round mark on the window."""

_FINER = 2
"""Pixels of the pinhole's picture for one of the lens's, along and across."""

_WIDEST = 4.0
"""Tangent of the largest angle to the axis that the pinhole's picture takes."""

_LENS_FILE = "lens.npz"
"""Columns and rows (2 height, 2 width) in the pinhole's picture, -1 for none, and light (height,
width)."""

_TAGS = {
    "path": "integrator",
    "perspective": "sensor",
    "thinlens": "sensor",
    "hdrfilm": "film",
    "box": "rfilter",
    "multijitter": "sampler",
    "dielectric": "bsdf",
    "diffuse": "bsdf",
    "blendbsdf": "bsdf",
    "roughconductor": "bsdf",
    "twosided": "bsdf",
    "mask": "bsdf",
    "area": "emitter",
    "mesh_attribute": "texture",
    "uniform": "texture",
}
"""Mitsuba's kind of each plug-in that is no shape."""

_VALUES = {int: "integer", float: "float", str: "string"}


_SKIN = 0.05
"""Share of the paths that a glossy skin mirrors, rather than the matt marker beneath it."""


@dataclass(frozen=True, kw_only=True)
class Triangles:
    """A surface of triangles.

    Attributes
    ----------
    places, normals
        (n, 3) corners, mm, and the surface's normals there.
    faces
        (k, 3) numbers of three corners.
    colours
        (n, 3) diffuse reflectance at the corners.
    gloss
        Refractive index and roughness of a smooth skin; None: matt.
    opacity
        Share of the light that doesn't pass.
    """

    places: Points
    normals: Floats
    faces: Ints
    colours: Floats
    gloss: tuple[float, float] | None = None
    opacity: float = 1.0

    def paint(self, scene: Scene) -> dict[str, Any]:
        """Return Mitsuba's tables of the surface's material."""
        colour = {"type": "mesh_attribute", "name": "vertex_color"}
        inner: dict[str, Any] = {"type": "diffuse", "reflectance": colour}
        if self.gloss is not None:
            index, roughness = self.gloss
            # A conductor that absorbs nothing mirrors as a dielectric does. Both parts are
            # brighter by what their shares of the blend take off.
            skin = {
                "type": "roughconductor",
                "distribution": "ggx",
                "alpha": roughness,
                "eta": _even(index / scene.material.refractive_index),
                "k": _even(0.0),
                "specular_reflectance": _even(1 / _SKIN),
            }
            inner = {"type": "blendbsdf", "weight": _SKIN, "matt": inner, "skin": skin}
        both = {"type": "twosided", "inner": inner}
        return (
            both if self.opacity == 1 else {"type": "mask", "opacity": self.opacity, "inner": both}
        )

    def as_ply(self, down_mm: float) -> bytes:
        """Return the surface as a binary PLY file, with z smaller by ``down_mm``."""
        names = ("x", "y", "z", "nx", "ny", "nz", "r", "g", "b")
        corners = np.column_stack([self.places - [0, 0, down_mm], self.normals, self.colours])
        faces = np.zeros(len(self.faces), np.dtype([("n", "u1"), ("of", "<i4", 3)]))
        faces["n"] = 3
        faces["of"] = self.faces
        head = [
            "ply\nformat binary_little_endian 1.0",
            f"element vertex {len(corners)}",
            *(f"property float {name}" for name in names),
            f"element face {len(faces)}",
            "property list uchar int vertex_indices\nend_header\n",
        ]
        return "\n".join(head).encode() + corners.astype("<f4").tobytes() + faces.tobytes()


def _marker_triangles(markers: Ellipsoids, hollow: float = 0.0) -> Triangles:
    """Return all markers that are there as one surface, in the gloss of the first; without what
    lies within a share ``hollow`` of the radius of the line through the middle along z."""
    ball = trimesh.creation.icosphere(subdivisions=_SUBDIVISIONS)
    # A ball of triangles within the sphere shows too little: enlarged to the sphere's area.
    unit = np.asarray(ball.vertices) * np.sqrt(4 * np.pi / ball.area)
    places = markers.centres[:, None] + unit @ np.swapaxes(markers.axes, 1, 2)
    normals = unit @ np.linalg.inv(markers.axes)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    rim = np.linalg.norm(ball.triangles_center[:, :2], axis=1) >= hollow
    faces = ball.faces[rim][None] + len(unit) * np.arange(len(markers))[:, None, None]
    gloss = (0.0, 0.0) if markers.gloss is None else tuple(markers.gloss[0].tolist())
    glossy = gloss[0] > 0
    colours = np.repeat(markers.colour, len(unit), axis=0)
    if markers.texture is not None:
        which = np.repeat(np.arange(len(markers)), len(unit))
        colours *= markers.shade(which, np.tile(unit, (len(markers), 1)))[:, None]
    return Triangles(
        places=places.reshape(-1, 3),
        normals=normals.reshape(-1, 3),
        faces=faces.reshape(-1, 3),
        colours=colours / (1 - _SKIN) if glossy else colours,
        gloss=gloss if glossy else None,
    )


def surfaces(
    scene: Scene, markers: Ellipsoids, background: Background | None, cover: CoverMotion | None
) -> dict[str, Triangles]:
    """Return markers and cover by name.

    Markers are one surface, or with gloss one for each of its kinds.

    Parameters
    ----------
    scene, markers
        The actual scene, and the markers as they are now.
    background, cover
        The cover that the camera sees, None without one, and how its places have moved.
    """
    there = markers.rows(markers.present)
    if there.gloss is None:
        found = {"markers": _marker_triangles(there)}
    else:
        kinds, which = np.unique(there.gloss, axis=0, return_inverse=True)
        found = {
            f"markers{n}": _marker_triangles(there.rows(which.ravel() == n))
            for n in range(len(kinds))
        }
    if background is not None:
        assert scene.cover is not None
        places = background.points
        normals = background.normals
        if cover is not None and background.deforms:
            places = places + cover.displacement_mm[: len(places)]
            normals = cover.turned(normals)
        found["cover"] = Triangles(
            places=places,
            normals=normals,
            faces=background.triangles,
            colours=np.tile(scene.cover.albedo, (len(places), 1)),
        )
    return found


def _all_surfaces(
    scene: Scene, markers: Ellipsoids, cover: CoverMotion | None
) -> dict[str, Triangles]:
    """Return `surfaces`, marks in the rubber and on the window, and probes behind clear rubber with
    the sensing surface at rest, by name."""
    background = Background(scene, 1.0)
    found = surfaces(scene, markers, background if scene.cover is not None else None, cover)
    if scene.cover is not None and scene.cover.transmittance > 0:
        # What is let through sends nothing back.
        opacity = 1 - scene.cover.transmittance
        one = found.pop("cover")
        if opacity > 0:
            found["cover"] = replace(one, colours=one.colours / opacity, opacity=opacity)
    for n, (marks, shapes) in enumerate(background.specks(cover)):
        found[f"specks{n}"] = _marker_triangles(shapes, marks.hollow)
    for n, marks in enumerate(scene.imaging[0].on_window):
        found[f"marks{n}"] = _on_window(marks, scene)
    probes = () if cover is None else cover.probes
    for n, probe in enumerate(probes):
        found[f"probe{n}"] = _seen_through(scene, probe)
    if probes:
        found["surface"] = surface = _seen_through(scene, None)
        if "cover" in found and found["cover"].opacity < 1:
            found["cover_beside"] = _beside_picture(surface, found["cover"], scene)
    return {name: surface for name, surface in found.items() if len(surface.faces)}


def _seen_through(scene: Scene, probe: Load.Placed | None) -> Triangles:
    """Return `twin.world.picture.cover.SeeThrough.triangles` with their colour."""
    places, normals, faces = SeeThrough.triangles(scene, probe)
    colours = np.tile((1.0, 1.0, 1.0) if probe is None else probe.albedo, (len(places), 1))
    if probe is not None and scene.cover is not None:
        # A cover that the probe touches lies on it, in front of itself at rest.
        touched = scene.body.depth(places) > 0
        inwards = scene.body.piece_normals(places[touched])[:, 0]
        places[touched] += (scene.cover.thickness_mm + _BEFORE_MM) * inwards
        colours[touched] *= scene.cover.transmittance**2
        colours[touched] += scene.cover.albedo
    return Triangles(places=places, normals=normals, faces=faces, colours=colours)


def _beside_picture(surface: Triangles, cover: Triangles, scene: Scene) -> Triangles:
    """Return the cover at rest where the camera doesn't see it: light comes in to probes there."""
    assert scene.cover is not None
    camera = scene.imaging[0]
    middles = project(surface.places[surface.faces].mean(axis=1), *scene.optics)
    within = (middles > -0.5) & (middles < [camera.width_px - 0.5, camera.height_px - 0.5])
    return replace(
        cover,
        places=surface.places + scene.cover.thickness_mm * surface.normals,
        normals=surface.normals,
        faces=surface.faces[~within.all(axis=1)],
        colours=np.tile(cover.colours[:1], (len(surface.places), 1)),
    )


def _on_window(marks: Camera.Marks, scene: Scene) -> Triangles:
    """Return marks just above the window's outer face: straight bands with round ends."""
    camera, _, height = scene.optics
    height += camera.window_mm + _ABOVE_MM
    lines = marks.lines(*scene.body.bounds_mm)
    half = (lines[:, 1] - lines[:, 0]) / 2
    along = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-300)
    along[~half.any(axis=1)] = [1.0, 0.0]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    step = 2 * np.pi / _CORNERS
    angle = step * (np.arange(_CORNERS) + 0.5)
    # A polygon of the circle's area, and within it that of what is clear.
    round_ends = np.cos(angle)[:, None] * along[:, None] + np.sin(angle)[:, None] * across[:, None]
    ends = lines.mean(axis=1)[:, None] + np.sign(np.cos(angle))[:, None] * half[:, None]
    outer = marks.size_mm / 2 * np.sqrt(step / np.sin(step))
    rings = np.concatenate([ends + outer * round_ends, ends + marks.hollow * outer * round_ends], 1)
    here = np.arange(_CORNERS)
    following = (here + 1) % _CORNERS
    halves = [
        np.column_stack([here, following, here + _CORNERS]),
        np.column_stack([following, following + _CORNERS, here + _CORNERS]),
    ]
    faces = np.concatenate(halves) + 2 * _CORNERS * np.arange(marks.count)[:, None, None]
    places = np.pad(rings.reshape(-1, 2), ((0, 0), (0, 1)), constant_values=height)
    return Triangles(
        places=places,
        normals=np.tile([0.0, 0.0, 1.0], (len(places), 1)),
        faces=faces.reshape(-1, 3),
        colours=np.full((len(places), 3), marks.albedo),
    )


def window(scene: Scene, down_mm: float = 0.0) -> tuple[dict[str, Any], float]:
    """Return Mitsuba's tables of the window's interfaces, from the rubber outwards, with z smaller
    by ``down_mm``; and the share of straight light that all of them pass."""
    camera, below, height = scene.optics
    low, high = scene.body.bounds_mm
    half = max(b - a for a, b in zip(low, high, strict=True))
    middle = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
    layers = [(layer.thickness_mm, layer.index) for layer in camera.layers]
    table = {}
    through = 1.0
    for n, (thickness, above) in enumerate([*layers, (0.0, 1.0)]):
        through *= 1 - float(reflection(0.0, below, above))
        table[f"interface{n}"] = {
            "type": "rectangle",
            "to_world": _matrix(half * np.eye(3), (*middle, height - down_mm)),
            "bsdf": {"type": "dielectric", "int_ior": below, "ext_ior": above},
        }
        height += thickness
        below = above
    return table, through


def write_stock_scene(
    folder: Path,
    scene: Scene,
    exposure: float,
    states: Mapping[str, tuple[Ellipsoids, CoverMotion | None]],
) -> list[Path]:
    """Write an XML file of each state, its PLY files and, for what is no pinhole or thin lens,
    `_LENS_FILE` into a folder, which exists; return the XML files.

    Parameters
    ----------
    scene
        With camera and light; its LEDs are discs.
    exposure
        Of `twin.world.picture.render.Renderer.exposure`: pixels are then in its units.
    states
        By the files' first word: the markers, and how the places of the cover's `Background` have
        moved; the probes that the camera sees.

    Raises
    ------
    RecipeError
        Stock Mitsuba has no such LEDs.
    """
    check_stock(scene)
    camera, light = scene.imaging
    if not camera.is_plain:
        camera = _write_lens(folder, camera)
    # Mitsuba starts a ray behind an interface by a share of its coordinates: near 0 that is least.
    down = scene.window_middle_mm
    interfaces, through = window(scene, down)
    table: dict[str, Any] = {
        "integrator": {"type": "path", "max_depth": 24, "rr_depth": 100},
        "sensor": _sensor(scene, camera, down),
        **interfaces,
    }
    # An LED of intensity 1 as a disc, times what makes a pixel's light 1 where it fills the well:
    # the program counts brightness before the window spreads it, and relative to straight light.
    radius = light.radius_mm
    index = scene.material.refractive_index
    radiance = (1 - light.ambient) * exposure * (index / through / radius) ** 2
    for n, (place, power) in enumerate(zip(light.positions_mm, light.powers, strict=True)):
        table[f"led{n}"] = {
            "type": "disk",
            "to_world": _matrix(radius * np.diag([1, -1, -1]), (*place[:2], place[2] - down)),
            "emitter": {"type": "area", "radiance": _rgb(radiance * power)},
        }
    files = []
    for name, (markers, cover) in states.items():
        here = dict(table)
        for part, surface in _all_surfaces(scene, markers, cover).items():
            file = f"{name}_{part}"
            # Beneath the sensing surface there is air.
            air = {"type": "dielectric", "int_ior": 1.0, "ext_ior": index}
            painted = air if part == "surface" else surface.paint(scene)
            here[file] = {"type": "ply", "filename": f"{file}.ply", "bsdf": painted}
            write_whole(folder / f"{file}.ply", surface.as_ply(down))
        # The tables in Mitsuba's XML.
        root = ElementTree.Element("scene", version="3.0.0")
        for key, value in here.items():
            _add(root, key, value, "id")
        ElementTree.indent(root)
        made = ElementTree.tostring(root, encoding="unicode") + "\n"
        files.append(folder / f"{name}.xml")
        write_whole(files[-1], made.encode())
    return files


def check_stock(scene: Scene) -> None:
    """Raise a `RecipeError` where stock Mitsuba lacks the LEDs of a scene."""
    _, light = scene.imaging
    problems = {
        f"light.exponent = {light.exponent:g}": light.profile is None and light.exponent != 1,
        "light.profile": light.profile is not None,
    }
    if lacking := [key for key, there in problems.items() if there]:
        raise RecipeError(
            f"{', '.join(lacking)}: stock Mitsuba has no plug-in for it. Its LEDs shine by the "
            "cosine (light.exponent = 1): change the keys, or take renderer = 'path', which has all"
        )


def _write_lens(folder: Path, camera: Camera) -> Camera:
    """Write `_LENS_FILE`, and return the pinhole camera of whose picture it is."""
    columns, rows = (
        (np.arange(_FINER * size) + 0.5) / _FINER - 0.5
        for size in (camera.width_px, camera.height_px)
    )
    places = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    into = lens_inverse(places, camera)
    ahead = np.where(-into[:, 2] > 1e-12, -into[:, 2], np.nan)
    across = into[:, :2] / ahead[:, None] * [1, -1]
    across[~(np.linalg.norm(across, axis=1) < _WIDEST)] = np.nan
    focal = _FINER * camera.focal_px * max(camera.aspect, 1.0)
    width, height = (
        2 * int(np.ceil(focal * most) + 1) for most in np.nanmax(np.abs(across), axis=0)
    )
    found = across * focal + [(width - 1) / 2, (height - 1) / 2]
    shape = len(rows), len(columns)
    light = np.nan_to_num(np.clip(-into[:, 2], 0, 1) ** camera.vignetting).reshape(shape)
    light = light.reshape(camera.height_px, _FINER, camera.width_px, _FINER).mean(axis=(1, 3))
    maps = np.nan_to_num(found, nan=-1.0).reshape(*shape, 2).astype(np.float32)
    tables = {"columns": maps[..., 0], "rows": maps[..., 1], "light": light.astype(np.float32)}
    write_whole(folder / _LENS_FILE, lambda file: np.savez_compressed(file, **tables))
    plain = {"width_px": width, "height_px": height, "focal_px": focal, "principal_px": None}
    return camera.model_copy(update=plain)


def _sensor(scene: Scene, camera: Camera, down: float) -> dict[str, Any]:
    """Return the camera, its film and its sampler."""
    width, height = camera.width_px, camera.height_px
    column, row = camera.centre_px
    # Mitsuba's axes are left, up and forward; ours are right, up and backward.
    axes = camera.tilt_matrix() * [-1, 1, -1]
    table: dict[str, Any] = {
        "type": "perspective",
        "fov": float(2 * np.rad2deg(np.arctan(width / 2 / camera.focal_px))),
        "near_clip": 0.1,
        "to_world": _matrix(axes, (*camera.pupil_mm[:2], camera.pupil_mm[2] - down)),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "multijitter", "sample_count": 4096},
    }
    if camera.aperture_mm == 0:
        table["principal_point_offset_x"] = ((width - 1) / 2 - column) / width
        table["principal_point_offset_y"] = ((height - 1) / 2 - row) / height
        return table
    # What is sharp lies as deep in air as it appears through the window.
    base = scene.body.base_z_mm
    depth = (base - camera.focus_z_mm) / scene.material.refractive_index + camera.air_gap_mm(base)
    depth += sum(layer.thickness_mm / layer.index for layer in camera.layers)
    lens = {"type": "thinlens", "aperture_radius": camera.aperture_mm / 2, "focus_distance": depth}
    return table | lens


def _even(value: float) -> dict[str, Any]:
    """Return Mitsuba's table of one value for all colours, which may lie above 1."""
    return {"type": "uniform", "value": value}


def _rgb(colour: Floats) -> dict[str, Any]:
    """Return Mitsuba's table of a (3,) colour."""
    return {"type": "rgb", "value": colour.tolist()}


def _matrix(axes: Floats, place: tuple[float, float, float]) -> Floats:
    """Return the (4, 4) matrix from a part's own coordinates to the scene's."""
    matrix = np.eye(4)
    matrix[:3, :3] = axes
    matrix[:3, 3] = place
    return matrix


def _add(parent: ElementTree.Element, key: str, value: Any, names: str = "name") -> None:
    """Add a value under its key: a plug-in, a matrix, a colour or a single value."""
    if isinstance(value, Mapping) and (kind := value["type"]) == "rgb":
        ElementTree.SubElement(parent, kind, name=key, value=" ".join(map(str, value["value"])))
    elif isinstance(value, Mapping):
        one = ElementTree.SubElement(parent, _TAGS.get(kind, "shape"), {"type": kind, names: key})
        for inner, each in value.items():
            if inner != "type":
                _add(one, inner, each)
    elif isinstance(value, np.ndarray):
        matrix = ElementTree.SubElement(parent, "transform", name=key)
        ElementTree.SubElement(matrix, "matrix", value=" ".join(map(repr, value.ravel().tolist())))
    else:
        ElementTree.SubElement(parent, _VALUES[type(value)], name=key, value=str(value))
