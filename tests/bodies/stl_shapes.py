"""Triangles of known bodies, and STL files of them, for tests."""

from itertools import pairwise

import numpy as np
import trimesh
from standard_bodies import write_stl

from twin.parts.body import Dome, Solid

HELD_ABOVE = {"normal": (0, 0, 1), "within_deg": 5}
SENSING_BELOW = {"normal": (0, 0, -1), "within_deg": 5}


def write_text_stl(path, corners):
    """Write triangles as a text STL file."""
    lines = ["solid thing"]
    for triangle in corners:
        lines += [" facet normal 0 0 0", "  outer loop"]
        lines += [f"   vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle]
        lines += ["  endloop", " endfacet"]
    path.write_text("\n".join([*lines, "endsolid thing", ""]))
    return path


def prism(outline, triangles, height):
    """Return an outline (n, 2), counterclockwise from +z, extruded from z = 0 to ``height``."""
    flat = np.array(outline, float)
    low, high = (np.column_stack([flat, np.full(len(flat), z)]) for z in (0.0, height))
    faces = [low[list(t)][::-1] for t in triangles] + [high[list(t)] for t in triangles]
    ring = [*range(len(flat)), 0]
    for a, b in pairwise(ring):
        faces += [np.array([low[a], low[b], high[b]]), np.array([low[a], high[b], high[a]])]
    return np.array(faces)


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
    middles = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (width / 2 - fillet, length / 2 - fillet)
    rings = []
    for radius, z in [*zip(fillet * np.sin(turn), fillet * (1 - np.cos(turn)), strict=True), (fillet, height)]:
        angles = [turn + quarter * np.pi / 2 for quarter in range(4)]
        arcs = [radius * np.column_stack([np.cos(angle), np.sin(angle)]) for angle in angles]
        flat = np.concatenate([middle + arc for middle, arc in zip(middles, arcs, strict=True)])
        rings.append(np.column_stack([flat, np.full(len(flat), z)]))
    faces = []
    for low, high in pairwise(rings):
        after = np.roll(np.arange(len(low)), -1)
        faces += [np.stack([low, high[after], low[after]], axis=1), np.stack([low, high, high[after]], axis=1)]
    corner = rings[0][:: segments + 1]
    faces.append(np.array([corner[[0, 2, 1]], corner[[0, 3, 2]]]))
    top = rings[-1]
    faces.append(np.array([top[[0, k, k + 1]] for k in range(1, len(top) - 1)]))
    corners = np.concatenate(faces)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = np.einsum("mi,mi->m", normal, corners.mean(axis=1) - [0, 0, height / 2]) < 0
    corners[inwards] = corners[inwards][:, ::-1]
    corners = corners[np.linalg.norm(normal, axis=1) > 1e-9]
    if edge_mm is None:
        return corners
    vertices, triangles = trimesh.remesh.subdivide_to_size(
        corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), max_edge=edge_mm, max_iter=20
    )
    return np.asarray(vertices[triangles])


def solid_pad(folder, edge_mm=None):
    """Return the solid of the rounded pad, whose fillets are pressed up to 60 degrees."""
    file = write_stl(folder / "pad.stl", rounded_pad(edge_mm))
    return Solid(file=str(file), held=HELD_ABOVE, sensing={"normal": (0, 0, -1), "within_deg": 60})


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
