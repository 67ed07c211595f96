"""Triangles of known bodies, and STL files of them, for tests."""

import numpy as np
import trimesh
from standard_bodies import write_stl

from twin.parts.body import Dome, Solid

HELD_ABOVE = {"normal": (0, 0, 1), "within_deg": 5}
SENSING_BELOW = {"normal": (0, 0, -1), "within_deg": 5}


def write_text_stl(path, corners):
    """Write triangles as a text STL file."""
    trimesh.Trimesh(**trimesh.triangles.to_kwargs(corners), process=False).export(path, file_type="stl_ascii")
    return path


def prism(outline, triangles, height):
    """Return an outline (n, 2), counterclockwise from +z, extruded from z = 0 to ``height``."""
    return np.array(trimesh.creation.extrude_triangulation(np.array(outline, float), triangles, height).triangles)


def box(width, length, height):
    """Return the 12 triangles of a box, centred in x and y, from z = 0 to ``height``."""
    a, b = width / 2, length / 2
    return prism([(-a, -b), (a, -b), (a, b), (-a, b)], [(0, 1, 2), (0, 2, 3)], height)


def bracket():
    """Return an L: a pad z = 0..4 over x = -6..6, a leg z = 4..12 over x = -6..0; 10 mm along y."""
    side = [(-6, 0), (6, 0), (6, 4), (0, 4), (0, 12), (-6, 12)]
    flat = prism(side, [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)], 10.0)
    turned = flat[:, :, [0, 2, 1]] - [0.0, 5.0, 0.0]  # (x, z of the outline, y), which mirrors: turn the triangles
    return turned[:, ::-1]


def facetted_dome(dome, edge_mm):
    """Return triangles of a dome with edges of about ``edge_mm``: the hull of points on rings."""
    longest = dome.radius_mm * np.arccos(1 - dome.height_mm / dome.radius_mm)
    rings = int(np.ceil(longest / edge_mm))
    charts = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        angle = 2 * np.pi * (np.arange(6 * ring) + ring % 2 / 2) / (6 * ring)
        charts.append(longest * ring / rings * np.column_stack([np.cos(angle), np.sin(angle)]))
    points = dome.chart_points(np.concatenate(charts))
    points[-6 * rings :, 2] = dome.height_mm
    return np.asarray(trimesh.convex.convex_hull(points).triangles)


def rounded_pad(edge_mm=None, width=24.0, length=16.0, height=7.0, fillet=2.0, segments=6):
    """Return a pad with rounded upright and lower edges: long strips, or cut to ``edge_mm``."""
    turn = np.radians(90 * np.arange(segments + 1) / segments)
    around = np.concatenate([turn + quarter * np.pi / 2 for quarter in range(4)])
    away = np.column_stack([np.cos(around), np.sin(around)])
    middles = np.repeat([(1, 1), (-1, 1), (-1, -1), (1, -1)], len(turn), axis=0) * (
        width / 2 - fillet,
        length / 2 - fillet,
    )
    rings = [*zip(fillet * np.sin(turn), fillet * (1 - np.cos(turn)), strict=True), (fillet, height)]
    points = np.concatenate([np.insert(middles + radius * away, 2, z, axis=1) for radius, z in rings])
    pad = trimesh.convex.convex_hull(points)
    return np.array((pad if edge_mm is None else pad.subdivide_to_size(edge_mm, max_iter=20)).triangles)


def solid_pad(folder, edge_mm=None):
    """Return the solid of the rounded pad, whose fillets are pressed up to 60 degrees."""
    file = write_stl(folder / "pad.stl", rounded_pad(edge_mm))
    return Solid(file=str(file), held=HELD_ABOVE, sensing={"normal": (0, 0, -1), "within_deg": 60})


def solid_holed(folder, chords=16, radius=2.0):
    """Return a pad of 16 x 12 x 8 mm with a hole along y in its middle, cut into ``chords``."""
    turn = 2 * np.pi * np.arange(chords) / chords - 0.75 * np.pi
    share = 4 * np.arange(chords // 4)[:, None] / chords
    corners = np.array([(-8.0, 0), (8, 0), (8, 8), (-8, 8)])
    outer = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    hole = radius * np.column_stack([np.cos(turn), np.sin(turn)]) + (0, 4)
    one = np.arange(chords)
    two = np.roll(one, -1)
    ring = np.concatenate([np.stack([one + chords, one, two], 1), np.stack([one + chords, two, two + chords], 1)])
    flat = prism(np.concatenate([outer, hole]), ring, 12.0)
    turned = (flat[:, :, [0, 2, 1]] - [0.0, 6.0, 0.0])[:, ::-1]
    held = {"plane": {"point_mm": (0, 0, 8), "normal": (0, 0, 1)}}
    sensing = {"plane": {"point_mm": (0, 0, 0), "normal": (0, 0, -1)}}
    return Solid(file=str(write_stl(folder / "holed.stl", turned)), held=held, sensing=sensing)


def wedge():
    """Return a wedge of 8 degrees, 30 mm long."""
    height = 30 * np.tan(np.radians(8))
    flat = prism([(0, 0), (30, height), (0, height)], [(0, 1, 2)], 10.0)
    return (flat[:, :, [0, 2, 1]] - [10.0, 5.0, 10 * np.tan(np.radians(8))])[:, ::-1]


def solid_box(folder, *size):
    """Return the solid of a box's STL file, pressed from below and held above."""
    return Solid(file=str(write_stl(folder / "box.stl", box(*size))), held=HELD_ABOVE, sensing=SENSING_BELOW)


def solid_dome(folder, edge_mm, radius=10.0, height=7.0):
    """Return the solid of a dome's STL file, and the dome."""
    dome = Dome(radius_mm=radius, height_mm=height)
    file = write_stl(folder / f"dome{edge_mm:g}.stl", facetted_dome(dome, edge_mm))
    sensing = {"normal": (0, 0, -1), "within_deg": 85}
    return Solid(file=str(file), held=HELD_ABOVE, sensing=sensing), dome


def solid_bracket(folder):
    """Return the solid of the bracket: its pad is pressed, the end of its leg is held."""
    return Solid(
        file=str(write_stl(folder / "bracket.stl", bracket())),
        held={"plane": {"point_mm": (0, 0, 12), "normal": (0, 0, 1)}},
        sensing=SENSING_BELOW,
    )
