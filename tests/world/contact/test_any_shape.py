"""Contacts of any shape, in any number of pieces: against ring loads in elliptic integrals, and Love's rectangles."""

import itertools
import math

import numpy as np
import pytest
import trimesh
from presses import centre_of, pressed, settled
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk
from standard_bodies import DOME, rectangles, write_stl

import twin
from benchmarks.flat import HalfSpace
from benchmarks.random_bodies import traction_change
from twin.geometry.closed import PROBE_SIZE_MM, Surface
from twin.geometry.objects import object_triangles
from twin.parts.press import Cone, Cylinder, Object, Pillar, Press, Sphere, Stl
from twin.study.recipe import validate_scene
from twin.theory import halfspace

DEPTH = 0.2
MODULUS = 1.0 / (1.0 - 0.5**2)
"""E / (1 - nu^2) of what `pressed` presses, MPa."""

AROUND = 2.0 * np.pi * np.arange(200) / 200
RADII = np.linspace(0.01, 3.6, 60)
SHAPES = {
    "torus": (
        np.c_[3.2 + 0.8 * np.cos(AROUND), 0.8 * np.sin(AROUND)],
        lambda r: 0.8 - np.sqrt(np.maximum(0.8**2 - (r - 3.2) ** 2, 0.0)),
        (2.45, 3.95),
    ),
    "cup with a dent": (
        np.r_[np.c_[RADII, -((RADII - 2.0) ** 2) / 4.0][::-1], [[0.01, -4.0], [3.6, -4.0]]],
        lambda r: (r - 2.0) ** 2 / 4.0,
        (0.0, 3.6),
    ),
    "annular punch": ([[1.5, -2.0], [3.0, -2.0], [3.0, 0.0], [1.5, 0.0]], np.zeros_like, (1.5, 3.0)),
}


def under_disc(r, a):
    """Return how deep a pressure of 1 MPa on discs of radii a sinks at distances r, E* = 1 (Johnson 1985, 3.29)."""
    r, a = np.broadcast_arrays(r, np.maximum(a, 1e-12))
    inside, m = 4.0 * a / np.pi * ellipe(np.minimum(r / a, 1.0) ** 2), np.minimum(a / r, 1.0) ** 2
    outside = 4.0 * r / np.pi * (ellipe(m) - (1.0 - m) * ellipk(np.minimum(m, 1.0 - 1e-15)))
    return np.where(r <= a, inside, outside)


def ring_force(height, inner, outer, count=400):
    """Return the force, N, of a round profile pressed by `DEPTH`: rings of even pressure, narrower at both ends."""
    edges = inner + (outer - inner) * (1.0 - np.cos(np.pi * np.linspace(0.0, 1.0, count + 1))) / 2.0
    middle = (edges[1:] + edges[:-1]) / 2.0
    sunk = under_disc(middle[:, None], edges[1:]) - under_disc(middle[:, None], edges[:-1])
    return MODULUS * float(np.pi * (edges[1:] ** 2 - edges[:-1] ** 2) @ settled(sunk, DEPTH - height(middle)))


@pytest.fixture(scope="module", params=SHAPES)
def ring(request, tmp_path_factory):
    """A probe whose contact is a ring, the force that it needs, and the largest error that it may state."""
    section, height, ends = SHAPES[request.param]
    swept = trimesh.creation.revolve(np.vstack([section, section[:1]]), sections=200)
    file = write_stl(tmp_path_factory.mktemp("rings") / "ring.stl", swept.triangles)
    return Stl(file=str(file)), ring_force(height, *ends), 0.1 if "punch" in request.param else 0.03


def test_rings_of_pressure_know_the_flat_punch():
    assert ring_force(np.zeros_like, 0.0, 3.0) == pytest.approx(2.0 * MODULUS * 3.0 * DEPTH, rel=1e-5)


def assert_force(force, press, across=16, *, within, least=1.0, most):
    """The force is right ``within`` a share; what is stated is ``least`` times that share or more, under ``most``."""
    state = pressed(press, across=across, on=HalfSpace(0.5))
    off = abs(state.force_n[2] / force - 1.0)
    assert off < within
    assert least * off <= state.error.force < (most(off) if callable(most) else most)


@pytest.mark.parametrize("across", [8, 16])
def test_the_force_of_a_ring_is_right_within_what_it_says(ring, across):
    probe, force, most = ring
    assert_force(force, Press(probe=probe, indentation_mm=DEPTH), across, within=0.3 / across, most=most)


@pytest.mark.parametrize(
    ("probe", "tilt"),
    [
        (Object(shape="letter", width_mm=6.0), (0, 0, 17)),
        (Object(shape="gear", width_mm=6.0), (8, 5, 17)),
        (Cylinder(diameter_mm=3.0), (4, 1, 0)),
        (Pillar(width_mm=3.0), (0, 0, 0)),
        (Pillar(width_mm=3.0, length_mm=2.4, edge_mm=0.32), (0, 0, 0)),
    ],
)
def test_edges_have_their_share_in_the_error(probe, tilt):
    coarse, fine = (
        pressed(Press(probe=probe, tilt_deg=tilt, indentation_mm=0.15), across=n, on=HalfSpace(0.5)) for n in (7, 32)
    )
    off = abs(coarse.force_n[2] / fine.force_n[2] - 1.0)
    assert off <= coarse.error.force < max(5.0 * off, 0.0015)  # an upright square's is right to 0.03 %
    off = traction_change(coarse.load, fine.load)
    assert off <= coarse.error.traction < max(5.0 * off, 0.7)  # without bound at a sharp rim


@pytest.mark.parametrize("across", [8, 9, 12])
@pytest.mark.parametrize(
    "probe", [Cylinder(diameter_mm=4), Pillar(width_mm=4), Sphere(diameter_mm=10), Cone(apex_deg=140, diameter_mm=12)]
)
def test_what_patches_leave_to_finer_ones_is_stated_of_tractions(probe, across):
    """Balls at 8 and 9 patches across stated 0.43 times that, compared with 6."""
    coarse, fine = (pressed(Press(probe=probe, indentation_mm=0.1), across=n) for n in (across, 3 * across))
    off = traction_change(fine.load, coarse.load)
    assert off <= coarse.error.traction < 3.0 * off


def test_a_ring_pressed_by_force_sinks_as_deep(ring):
    probe, force, _ = ring
    state = pressed(Press(probe=probe, force_n=(0.0, 0.0, force)), on=HalfSpace(0.5))
    off = abs(state.indentation_mm / DEPTH - 1.0)
    assert off < 0.01
    assert off <= state.error.indentation < 0.05


def test_friction_hardly_changes_a_ring_at_half(ring):
    """At nu = 1/2 normal forces move a flat surface nowhere sideways."""
    probe, force, _ = ring
    state = pressed(Press(probe=probe, indentation_mm=DEPTH, friction=0.4), across=12, on=HalfSpace(0.5))
    assert state.force_n[2] == pytest.approx(force, rel=0.02)
    assert np.abs(state.force_n[:2]).max() < 1e-3 * force


def test_an_inclined_ring_touches_far_from_its_axis():
    """It was refused as if it had slid there."""
    ring, tilt = Object(shape="ring"), (0.0, 10.0, 0.0)
    smooth, rubbed = (
        pressed(Press(probe=ring, tilt_deg=tilt, indentation_mm=0.1, friction=friction), across=8, on=HalfSpace(0.5))
        for friction in (0.0, 0.4)
    )
    assert rubbed.force_n[2] == pytest.approx(smooth.force_n[2], rel=0.02)


VOLUMES = {
    "letter": 16 * 1.6**2 * 8 / 3,
    "gear": np.pi * (3.5**2 - 1.5**2) * 2.0,
    "screw": np.pi * (1.75**2 + 0.25**2 / 2.0) * 8.0,
    "brick": (7.8 * 5.2 * 3.0 + 6 * np.pi * 0.8**2 * 0.6) * (8.0 / 7.8) ** 3,
    "grating": (7.5**2 + 8 * 0.5 * 7.5) * (8.0 / 7.5) ** 3,
    "ring": 2.0 * np.pi * 3.2 * np.pi * 0.8**2,
}
"""mm3, 8 mm wide; teeth of the gear, as wide as their gaps, add half of a ring."""


@pytest.mark.parametrize("shape", VOLUMES)
def test_an_object_is_closed_and_as_large_as_told(shape):
    surface = Surface.welded(object_triangles(shape, 8.0), shape, PROBE_SIZE_MM)
    assert surface.volume_mm3 == pytest.approx(VOLUMES[shape], rel=0.03)
    assert np.ptp(surface.vertices[:, 0]) == pytest.approx(8.0)
    low, high = surface.vertices[:, :2].min(axis=0), surface.vertices[:, :2].max(axis=0)
    np.testing.assert_allclose(low, -high, atol=1e-9)


def under_rectangles(x, y, a, b):
    """Return (k, k) mm/MPa, how deep rectangles of half sizes a, b sink under even pressures (Love 1929)."""
    sunk = np.zeros((len(x), len(x)))
    for p, q in np.ndindex(2, 2):
        dx, dy = x[:, None] - x + (1 - 2 * p) * a, y[:, None] - y + (1 - 2 * q) * b
        sunk += (-1) ** (p + q) * (dx * np.arcsinh(dy / np.abs(dx)) + dy * np.arcsinh(dx / np.abs(dy)))
    return sunk / (np.pi * MODULUS)


def cells(*ends):
    """Return middles x, y and half sizes a, b of the cells between ends along both axes."""
    sides = [(e[1:] + e[:-1]) / 2 for e in ends], [np.diff(e) / 2 for e in ends]
    return [each.ravel() for side in sides for each in np.meshgrid(*side)]


def inclined_force(tilt_deg, depth):
    """Return the force, N, on a pillar of 4 mm, inclined, side wall included, on 60 by 28 rectangles."""
    slope = np.tan(np.radians(tilt_deg))
    low, high = -1.2 * depth * slope, min(depth / slope, 4.0 * np.cos(np.radians(tilt_deg)))
    along = np.concatenate([np.linspace(low, 0.0, 5), high * np.linspace(0.0, 1.0, 56)[1:] ** 1.5])
    across = -2.0 * np.cos(np.pi * np.linspace(0.0, 1.0, 29))  # on 14 it is 0.2 % too small
    x, y, a, b = cells(along, across)
    wanted, sunk = depth - np.where(x > 0.0, x * slope, -x / slope), under_rectangles(x, y, a, b)
    return float(4.0 * a * b @ settled(sunk, wanted))


@pytest.mark.parametrize(("tilt", "depth"), [(2.0, 0.1), (5.0, 0.15), (15.0, 0.3), (30.0, 0.3)])
def test_an_inclined_face_is_pressed_by_its_rim(tilt, depth):
    press = Press(probe=Pillar(width_mm=4.0), tilt_deg=(0.0, tilt, 0.0), indentation_mm=depth)
    assert_force(inclined_force(tilt, depth), press, within=0.01, least=1 / 3, most=0.02)


def grating_force(cells):
    """Return the force, N, on eight ridges of 0.5 by 7.5 mm, each cut into ``cells`` by 24 rectangles."""
    ends = np.concatenate([k + 0.25 - 0.25 * np.cos(np.pi * np.linspace(0, 1, cells + 1)) for k in range(8)])
    ends, along = ends.reshape(8, -1), -3.75 * np.cos(np.pi * np.linspace(0.0, 1.0, 25))
    x, y = (s.ravel() for s in np.meshgrid((ends[:, 1:] + ends[:, :-1]) / 2, (along[1:] + along[:-1]) / 2))
    a, b = (s.ravel() for s in np.meshgrid(np.diff(ends, axis=1) / 2, np.diff(along) / 2))
    return float(4.0 * a * b @ np.linalg.solve(under_rectangles(x, y, a, b), np.full(len(x), DEPTH)))


@pytest.mark.parametrize("across", [6, 12])
def test_a_grating_is_cut_where_its_ridges_end(across):
    """Ridges whose sides cells don't follow were up to 5 % too narrow, beyond what was stated."""
    press = Press(probe=Object(shape="grating", width_mm=7.5), indentation_mm=DEPTH)
    assert_force(grating_force(6), press, across, within=0.16 / across, least=1 / 3, most=lambda off: 4.0 * off)


def letter_force(count):
    """Return the force, N, on a letter of 5 by 5 strokes of 1.2 mm, each cut into count by count graded rectangles."""
    strokes = np.argwhere([[mark == "#" for mark in row] for row in ("#####", "#...#", "#####", "#...#", "#...#")])
    ends = 0.6 - 0.6 * np.cos(np.pi * np.linspace(0.0, 1.0, count + 1))
    u, v, a, b = cells(ends, ends)
    x, y = (np.add.outer(1.2 * strokes[:, k], side).ravel() for k, side in enumerate((u, v)))
    a, b = np.tile(a, len(strokes)), np.tile(b, len(strokes))
    pressure = np.linalg.solve(under_rectangles(x, y, a, b), np.full(len(x), DEPTH))
    assert pressure.min() > 0.0, "all of a flat face touches"
    return float(4.0 * a * b @ pressure)


@pytest.mark.parametrize(("tilt", "across", "within"), [(0.0, 16, 0.001), (30.0, 16, 0.02), (0.0, 8, 0.002)])
def test_a_letter_is_pressed_however_it_is_turned(tilt, across, within):
    coarse, fine = letter_force(4), letter_force(7)
    force = fine + (fine - coarse) / ((7 / 4) ** 2 - 1)  # order 2; 1.7317 N from 7, 10 and 13
    assert force == pytest.approx(1.7317, rel=1e-3)
    press = Press(probe=Object(shape="letter", width_mm=6.0), tilt_deg=(0.0, 0.0, tilt), indentation_mm=DEPTH)
    assert_force(force, press, across, within=within, most=0.025)


@pytest.mark.parametrize(("angle", "across"), [(0.0, 8), (0.0, 16), (1.0, 12), (45.0, 11)])
def test_a_lying_cylinder_is_pressed_however_it_is_turned(angle, across, tmp_path):
    """It was 0.5 to 2.2 % too weak; askew it stated down to 0.4 times that."""
    turn = trimesh.transformations.euler_matrix(0.0, np.pi / 2, np.radians(angle))
    file = write_stl(tmp_path / "lying.stl", trimesh.creation.cylinder(3.0, 6.0, 1440, transform=turn).triangles)
    x, y, a, b = cells(3.0 * np.sin(np.pi / 2 * np.linspace(-1, 1, 49)), np.linspace(-0.8, 0.8, 33))
    force = float(4.0 * a * b @ settled(under_rectangles(x, y, a, b), DEPTH - 3.0 + np.sqrt(9.0 - y**2)))
    lying = Press(probe=Stl(file=str(file)), indentation_mm=DEPTH)
    assert_force(force, lying, across, within=0.04 / across, most=0.1 / across)


def knife_force(across):
    """Return the force, N, on a knife's edge of 0.04 by 3 mm, cut into 4 across by across graded rectangles."""
    ends = [half * np.sin(np.pi / 2 * np.linspace(-1.0, 1.0, 4 * n + 1)) for half, n in ((0.02, across), (1.5, 9))]
    x, y, a, b = cells(*ends)
    return float(4.0 * a * b @ np.linalg.solve(under_rectangles(x, y, a, b), np.full(len(x), DEPTH)))


@pytest.mark.parametrize(("turn", "across"), [(0.0, 8), (0.0, 16), (10.0, 8), (45.0, 16)])
def test_the_edge_of_a_knife_is_pressed_however_it_is_turned(turn, across, tmp_path):
    """Its sides lay beyond where edges were looked for, 6 % of its force was missed; turned, it touched nothing."""
    assert knife_force(4) == pytest.approx(knife_force(6), rel=5e-4)
    blade = trimesh.creation.box((0.04, 3.0, 3.0), trimesh.transformations.rotation_matrix(np.radians(turn), (0, 0, 1)))
    knife = Press(probe=Stl(file=str(write_stl(tmp_path / "knife.stl", blade.triangles))), indentation_mm=DEPTH)
    assert_force(knife_force(6), knife, across, within=0.04 / across, most=lambda off: 3.0 * off)


def fin_force(wide, at, cuts):
    """Return the force, N, on a face of 4 by 4 mm with a fin half as high as `DEPTH`, on graded rectangles."""

    def graded(low, high, count):
        return (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * np.linspace(0.0, 1.0, count + 1))

    low, high = at - wide / 2, at + wide / 2
    ends = np.unique(np.r_[graded(-2.0, low, 3 * cuts), graded(low, high, cuts), graded(high, 2.0, 3 * cuts)])
    x, y, a, b = cells(ends, graded(-2.0, 2.0, 5 * cuts))
    wanted = np.where(np.abs(x - at) < wide / 2, DEPTH, DEPTH / 2)
    return float(4.0 * a * b @ settled(under_rectangles(x, y, a, b), wanted))


@pytest.mark.parametrize(
    ("wide", "at", "across"), [(0.04, 0.37, 8), (0.04, 0.37, 24), (0.04, 0.0, 16), (0.4, 0.151, 16)]
)
def test_a_fin_between_the_middles_of_patches_is_stated(wide, at, across, tmp_path):
    """None lay on it, on any grid: 4 % of the force was missed where 0.04 to 0.3 % was stated."""
    force = fin_force(wide, at, 4)
    assert force == pytest.approx(fin_force(wide, at, 3), rel=5e-3)
    low, high, up = at - wide / 2, at + wide / 2, DEPTH / 2
    outline = [(-2, -2), (2, -2), (2, 0), (high, 0), (high, up), (low, up), (low, 0), (-2, 0)]
    flat = [(0, 1, 2), (0, 2, 3), (0, 3, 6), (0, 6, 7), (3, 4, 5), (3, 5, 6)]
    solid = trimesh.creation.extrude_triangulation(np.array(outline, float), flat, 4.0).triangles - [0.0, 0.0, 2.0]
    file = write_stl(tmp_path / "fin.stl", solid[:, ::-1, [0, 2, 1]])
    press = Press(probe=Stl(file=str(file)), indentation_mm=DEPTH)
    assert_force(force, press, across, within=0.08, most=lambda off: 7.0 * off)  # where other patches see it


@pytest.mark.parametrize(("depth", "across", "within"), [(0.1, 8, 0.055), (0.2, 12, 0.035)])
def test_the_rim_of_a_lying_cylinder_is_cut_and_bent_between_patches(depth, across, within, tmp_path):
    """Both add up: 4.8 % was missed where 2.5 was stated; 9.5 %, on half as many patches as were asked for."""
    turn = trimesh.transformations.euler_matrix(0.0, np.pi / 2, 0.0)
    file = write_stl(tmp_path / "rim.stl", trimesh.creation.cylinder(3.0, 3.0, sections=96, transform=turn).triangles)
    rim = Press(probe=Stl(file=str(file)), tilt_deg=(-13.0, 15.0, -2.0), indentation_mm=depth)
    finer = pressed(rim, across=36, on=HalfSpace(0.5)).force_n[2]
    assert_force(finer, rim, across, within=within, least=0.9, most=lambda off: 3.0 * off)


@pytest.mark.slow
def test_a_contact_has_the_same_patches_whatever_lies_in_the_cache(tmp_path, monkeypatch):
    """A wide object on a thin block, before and after another press has made the block's table."""
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path))
    press = twin.Press(probe=twin.Object(shape="grating", width_mm=9.9), indentation_mm=0.08)
    table = {
        "body": {"shape": "block", "width_mm": 20, "length_mm": 18, "thickness_mm": 1.2},
        "material": {"youngs_modulus_mpa": 1.0, "poisson_ratio": 0.49},
    }

    def pressed(across):
        scene = validate_scene({**table, "accuracy": {"contact_patches": across}}, "thin block")
        return twin.Sensor(scene).press(press)

    first = pressed(12)
    pressed(16)
    again = pressed(12)
    assert len(first.pressure_mpa) == len(again.pressure_mpa) > 1500
    assert first.force_n[2] == pytest.approx(again.force_n[2], rel=1e-6)


WIDTH, LENGTH, DEEP = 4.0, 2.5, 0.1
CORNER = (40.0, 40.0, 0.0)


def turned(points, tilt_deg):
    """Turn about x, then y, then z, all of which stay where they are."""
    return Rotation.from_euler("xyz", tilt_deg, degrees=True).apply(points)


def lowest(vertices, xy):
    """Largest z of a convex solid over (n, 2): where vertical lines leave its half-spaces."""
    planes = ConvexHull(vertices).equations
    down, up = planes[planes[:, 2] > 1e-9], planes[planes[:, 2] < -1e-9]
    least, most = (-(p[:, 3:] + p[:, :2] @ xy.T) / p[:, 2:3] for p in (down, up))
    z = least.min(axis=0)
    return np.where(z >= most.max(axis=0), z, -np.inf)


def force_of(vertices, low, high, across, deep=DEEP):
    """Force under a convex solid so deep: active set on an even grid, E = 1, nu = 1/2."""
    sides = (high - low) / across
    grid = np.stack(np.meshgrid(*2 * [np.arange(across)], indexing="ij"), -1).reshape(-1, 2)
    xy = low + (grid + 0.5) * sides
    over = lowest(vertices, xy) - vertices[:, 2].max() + deep
    xy, over = xy[over > 0], over[over > 0]
    cells = rectangles(np.column_stack([xy, np.zeros(len(xy))]), sides / 2, 0.0)
    compliance = halfspace.compliance(cells.centre_mm, cells, 1.0, 0.5)[2::3, 2::3]
    return settled(compliance, over).sum()


def pillar(tilt_deg, edge_mm=0.0):
    probe = Pillar(width_mm=WIDTH, length_mm=LENGTH, edge_mm=edge_mm)
    return pressed(Press(probe=probe, tilt_deg=tilt_deg, indentation_mm=DEEP)).force_n[2]


@pytest.mark.parametrize("tilt", [CORNER, (25.0, 18.0, 40.0)])
def test_a_sharp_corner_pushes_with_its_sides_too(tilt):
    """Without the steep sides a corner was a quarter too weak, or not found at all."""
    sides = ((-WIDTH / 2, WIDTH / 2), (-LENGTH / 2, LENGTH / 2), (-30, 0))
    box = turned(list(itertools.product(*sides)), tilt)
    corner = box[np.argmax(box[:, 2]), :2]
    right = force_of(box, corner - 0.25, corner + 0.25, 48)
    assert pillar(tilt) == pytest.approx(right, rel=0.03)


@pytest.mark.parametrize(
    ("tilt", "depth", "across"),
    [((8.5, 7.7, 0.4), 0.02, 8), ((-11.3, -9.9, -21.1), 0.014, 12), ((5.9, 6.0, -7.0), 0.03, 16)],
)
def test_a_corner_that_is_hardly_inclined_sinks_as_deep_as_it_is_pressed(tilt, depth, across):
    """The face counted 0.5 % wider than it is: up to 36 % too much force, where 1 to 3 % was stated."""
    box = turned(list(itertools.product((-WIDTH / 2, WIDTH / 2), (-LENGTH / 2, LENGTH / 2), (-30, 0))), tilt)
    corner = np.argmax(box[:, 2])
    away = box[corner ^ np.array([0, 1, 2, 4])] - box[corner]  # along its three edges
    ends = box[corner, :2] + away[:, :2] * depth / np.maximum(-away[:, 2:], depth)
    right = force_of(box, ends.min(axis=0), ends.max(axis=0), 60, depth)
    press = Press(probe=Pillar(width_mm=WIDTH, length_mm=LENGTH), tilt_deg=tilt, indentation_mm=depth)
    assert_force(right, press, across, within=0.06, most=0.15)


def test_a_sharp_edge_is_the_limit_of_rounded_ones():
    assert pillar(CORNER) == pytest.approx(pillar(CORNER, edge_mm=1e-4), rel=0.03)


@pytest.mark.parametrize(("lean", "turn"), [(30.0, 45.0), (21.0, 30.0), (45.0, 10.0)])
def test_an_edge_pushes_as_hard_however_it_is_turned(lean, turn):
    """Half as hard again was found at 30 and 45 degrees, nothing at the others."""
    assert pillar((lean, 0.0, turn)) == pytest.approx(pillar((lean, 0.0, 0.0)), rel=0.03)


def test_a_rim_that_just_touches_a_slope_is_found():
    """A hair's indentation reaches no patch of the first grids: they shrank around the middle."""
    probe = Cylinder(diameter_mm=1.573, edge_mm=0.4214)
    wanted = Press(probe=probe, at_mm=(0.0, -0.732), indentation_mm=1e-3)
    state = pressed(wanted, DOME, across=9)
    flat, slope = 1.573 / 2 - 0.4214, math.asin(0.732 / 10.0)
    assert state.indentation_mm == pytest.approx(1e-3)
    away = math.hypot(*(centre_of(state)[:2] - wanted.at_mm[:2]))
    assert away == pytest.approx(flat, abs=0.4214 * math.sin(2 * slope) + 0.05)


def test_no_number_of_patches_misses_the_thread_that_a_screw_ends_with():
    """It is narrower than the coarse patches by which the contact is found."""
    screw = Press(probe=Object(shape="screw", width_mm=2.627), indentation_mm=0.153)
    forces = [pressed(screw, across=across, nu=0.3).force_n[2] for across in (12, 16, 20)]
    assert forces == pytest.approx([forces[0]] * 3, rel=4e-3)
