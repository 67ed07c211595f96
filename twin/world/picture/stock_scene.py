"""A scene of stock Mitsuba: what our renderers fold, as it stands in the world.

Camera and LEDs are in air, the window is dielectric interfaces, markers and cover are triangles.
Any path integrator can make the picture, with thousands of paths a pixel where
`twin.world.picture.path_tracer` takes 64: LEDs are found by chance only.

Validity: a pinhole or thin lens without distortion; LEDs that shine by the cosine. The rubber has
no sides, and the even share of light (``light.ambient``) has no source, so it is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh

from twin.arrays import Floats, Ints, Points
from twin.errors import RecipeError
from twin.files import write_whole
from twin.parts.camera import Camera
from twin.parts.scene import Scene
from twin.theory.optics import reflection
from twin.world.picture.cover import Background, CoverMotion
from twin.world.picture.ellipsoids import Ellipsoids

_LED_MM = 1.0
"""Radius of the disc that stands for an LED without one: chance never finds a point."""

_SUBDIVISIONS = 3
"""Of an icosahedron: 1280 triangles a marker, whose outline is .2 % of the radius off."""

_TAGS = {
    "path": "integrator",
    "perspective": "sensor",
    "thinlens": "sensor",
    "hdrfilm": "film",
    "box": "rfilter",
    "multijitter": "sampler",
    "dielectric": "bsdf",
    "diffuse": "bsdf",
    "roughplastic": "bsdf",
    "twosided": "bsdf",
    "area": "emitter",
    "mesh_attribute": "texture",
}
"""Mitsuba's kind of each plug-in that is no shape."""

_VALUES = {int: "integer", float: "float", str: "string"}


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
    """

    places: Points
    normals: Floats
    faces: Ints
    colours: Floats
    gloss: tuple[float, float] | None = None

    def paint(self, scene: Scene) -> dict[str, Any]:
        """Return Mitsuba's tables of the surface's material."""
        colour = {"type": "mesh_attribute", "name": "vertex_color"}
        inner: dict[str, Any] = {"type": "diffuse", "reflectance": colour}
        if self.gloss is not None:
            inner = {
                "type": "roughplastic",
                "distribution": "ggx",
                "diffuse_reflectance": _rgb(self.colours[0]),
                "int_ior": self.gloss[0],
                "ext_ior": scene.material.refractive_index,
                "alpha": self.gloss[1],
            }
        return {"type": "twosided", "inner": inner}

    def as_ply(self, down_mm: float = 0.0) -> bytes:
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


def _marker_triangles(markers: Ellipsoids) -> Triangles:
    """Return all markers that are there as one surface, in the gloss of the first."""
    ball = trimesh.creation.icosphere(subdivisions=_SUBDIVISIONS)
    # A ball of triangles within the sphere shows too little: enlarged to the sphere's area.
    unit = np.asarray(ball.vertices) * np.sqrt(4 * np.pi / ball.area)
    places = markers.centres[:, None] + unit @ np.swapaxes(markers.axes, 1, 2)
    normals = unit @ np.linalg.inv(markers.axes)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    faces = ball.faces[None] + len(unit) * np.arange(len(markers))[:, None, None]
    gloss = None if markers.gloss is None else tuple(markers.gloss[0].tolist())
    colours = np.repeat(markers.colour, len(unit), axis=0)
    if markers.texture is not None and not (gloss and gloss[0]):  # `roughplastic` is even
        which = np.repeat(np.arange(len(markers)), len(unit))
        colours *= markers.shade(which, np.tile(unit, (len(markers), 1)))[:, None]
    return Triangles(
        places=places.reshape(-1, 3),
        normals=normals.reshape(-1, 3),
        faces=faces.reshape(-1, 3),
        colours=colours,
        gloss=gloss if gloss and gloss[0] else None,
    )


def surfaces(
    scene: Scene, markers: Ellipsoids, background: Background | None, cover: CoverMotion | None
) -> dict[str, Triangles]:
    """Return markers and cover by name.

    Markers are one surface, or with gloss one for each of its kinds and colours.

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
        look = np.column_stack([there.gloss, there.colour * (there.gloss[:, :1] > 0)])
        kinds, which = np.unique(look, axis=0, return_inverse=True)
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
    name: str,
    scene: Scene,
    exposure: float,
    markers: Ellipsoids,
    cover: CoverMotion | None = None,
) -> Path:
    """Write ``name``.xml and its PLY files into a folder; return the XML file.

    Parameters
    ----------
    folder, name
        The folder, which exists, and the files' first word.
    scene
        With camera and light.
    exposure
        Of `twin.world.picture.render.Renderer.exposure`: pixels are then in its units.
    markers, cover
        The markers, and how the places of the cover's `Background` have moved.

    Raises
    ------
    RecipeError
        Stock Mitsuba has no such lens, or no such LED.
    """
    check_stock(scene)
    camera, light = scene.imaging
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
    radius = light.radius_mm or _LED_MM
    index = scene.material.refractive_index
    radiance = (1 - light.ambient) * exposure * (index / through / radius) ** 2
    for n, (place, power) in enumerate(zip(light.positions_mm, light.powers, strict=True)):
        table[f"led{n}"] = {
            "type": "disk",
            "to_world": _matrix(radius * np.diag([1, -1, -1]), (*place[:2], place[2] - down)),
            "emitter": {"type": "area", "radiance": _rgb(radiance * power)},
        }
    background = Background(scene, 1.0) if scene.cover is not None else None
    for part, surface in surfaces(scene, markers, background, cover).items():
        file = f"{name}_{part}"
        table[file] = {"type": "ply", "filename": f"{file}.ply", "bsdf": surface.paint(scene)}
        write_whole(folder / f"{file}.ply", surface.as_ply(down))
    # The tables in Mitsuba's XML.
    root = ElementTree.Element("scene", version="3.0.0")
    for key, value in table.items():
        _add(root, key, value, "id")
    ElementTree.indent(root)
    made = ElementTree.tostring(root, encoding="unicode") + "\n"
    write_whole(folder / f"{name}.xml", made.encode())
    return folder / f"{name}.xml"


def check_stock(scene: Scene) -> None:
    """Raise a `RecipeError` where stock Mitsuba lacks the lens or the LEDs of a scene."""
    camera, light = scene.imaging
    off = np.abs(
        np.subtract(camera.centre_px, [(camera.width_px - 1) / 2, (camera.height_px - 1) / 2])
    )
    problems = {
        f"camera.lens = {camera.lens}": camera.lens != "pinhole",
        f"camera.distortion = {camera.distortion}": any(camera.distortion),
        f"camera.aspect = {camera.aspect:g}": camera.aspect != 1,
        f"camera.vignetting = {camera.vignetting:g}": camera.vignetting > 0,
        "camera.principal_px beside the middle, with an aperture": camera.aperture_mm > 0
        and off.max() > 1e-9,
        f"light.exponent = {light.exponent:g}": light.profile is None and light.exponent != 1,
        "light.profile": light.profile is not None,
    }
    if lacking := [key for key, there in problems.items() if there]:
        raise RecipeError(
            f"{', '.join(lacking)}: stock Mitsuba has no plug-in for it. It has pinhole and thin "
            "lenses, and LEDs that shine by the cosine (light.exponent = 1): change the keys, or "
            "take renderer = 'path', which has them all"
        )


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
