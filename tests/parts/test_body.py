"""Shapes as level sets: distances, charts, frames and volumes agree with one another."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from standard_bodies import FINGER

from twin.errors import RecipeError
from twin.parts.body import Block, Body, Dome
from twin.parts.markers import MarkerLayer, MarkerSet

BODIES = [
    Block(width_mm=30, length_mm=20, thickness_mm=10),
    FINGER,
    Dome(radius_mm=12, height_mm=9),
    Dome(radius_mm=10, height_mm=10),
]


@pytest.fixture(params=BODIES, ids=lambda body: body.shape)
def body(request):
    return request.param


def test_volume_by_counting(body):
    low, high = map(np.array, body.bounds_mm)
    points = low + np.random.default_rng(1).random((400_000, 3)) * (high - low)
    assert body.contains(points).mean() * np.prod(high - low) == pytest.approx(body.volume_mm3, rel=5e-3)


def test_normals_are_gradients_of_the_distances(body):
    points = body.chart_points(np.random.default_rng(2).uniform(-6, 6, (50, 2)), 1.3)
    step = 1e-6
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        slope = (body.piece_distances(points + shift) - body.piece_distances(points - shift)) / (2 * step)
        assert_allclose(slope, body.piece_normals(points)[:, :, axis], atol=1e-7)


def test_the_surface_is_level_where_the_pieces_say_so(body):
    """A shape that answers without asking its pieces says the same."""
    said = [
        (body.is_level_around(x, y, reach), Body.is_level_around(body, x, y, reach))
        for x, y, reach in np.random.default_rng(6).uniform((-16, -11, 0), (16, 11, 8), (300, 3)).tolist()
    ]
    assert all(quick == by_pieces for quick, by_pieces in said)
    assert {quick for quick, _ in said} == ({True, False} if body.is_flat else {False})


def test_the_chart_has_an_inverse_and_the_depth(body):
    chart = np.random.default_rng(5).uniform(-7, 7, (200, 2))
    points = body.chart_points(chart, 0.4)
    assert_allclose(body.chart_of(points), chart, atol=1e-9)
    assert_allclose(body.depth(points), 0.4, atol=1e-12)


def test_chart_measures_arc_length_from_the_origin(body):
    line = np.linspace(0, 5, 2001)
    for direction in ([1, 0], [0, 1], [0.6, 0.8]):
        path = body.chart_points(line[:, None] * np.array(direction))
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(5, rel=1e-6)


def test_frames_are_right_handed_and_point_inwards(body):
    frames = body.frames(body.chart_points(np.random.default_rng(4).uniform(-6, 6, (50, 2))))
    assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)
    assert_allclose(np.linalg.det(frames), 1)
    assert (frames[:, 2, 2] > 0).all()


def test_markers_keep_the_order_layer_s_t():
    grid = {"kind": "print", "pitch_mm": 2, "diameter_mm": 0.5, "columns": 2, "rows": 2, "colour": (1, 0, 0)}
    layers = {"red": MarkerLayer(depth_mm=1, **grid), "blue": MarkerLayer(depth_mm=3, **grid)}
    markers = MarkerSet.place(BODIES[0], layers)
    assert markers.layer.tolist() == ["red"] * 4 + ["blue"] * 4
    assert markers.points[:4].tolist() == [[-1, -1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, 1]]
    assert markers.points[4:, 2].tolist() == [3] * 4


@pytest.mark.parametrize(
    ("depth", "pitch", "columns", "words"),
    [(1, 9, 5, "2 of 5 markers lie outside"), (0.2, 1, 1, "outside the body"), (1, 0.4, 2, "wider than their pitch")],
)
def test_markers_outside_the_body_and_beads_that_overlap_are_refused(depth, pitch, columns, words):
    grid = {"depth_mm": depth, "pitch_mm": pitch, "columns": columns, "rows": 1}
    with pytest.raises(RecipeError, match=words):
        MarkerSet.place(BODIES[0], {"red": MarkerLayer(diameter_mm=0.5, colour=(1, 0, 0), **grid)})


def test_a_layout_that_fits_the_turned_block_says_so():
    block = Block(width_mm=18, length_mm=24, thickness_mm=4)
    for columns, rows, turned in ((15, 11, True), (15, 15, False)):
        layer = MarkerLayer(
            kind="print", depth_mm=1, pitch_mm=1.5, diameter_mm=0.5, columns=columns, rows=rows, colour=(0, 0, 0)
        )
        with pytest.raises(RecipeError) as refused:
            MarkerSet.place(block, {"red": layer})
        assert ("exchange body.width_mm" in str(refused.value)) == turned


def test_the_fingers_back_is_free_unless_held():
    finger = FINGER
    assert [finger.pieces[k] for k in finger.held_pieces] == ["held"]
    assert [finger.pieces[k] for k in finger.model_copy(update={"back": "held"}).held_pieces] == ["back", "held"]


def test_a_dome_is_round_its_depth_is_exact_and_its_base_is_where_it_is_cut():
    dome = Dome(radius_mm=12, height_mm=9)
    rng = np.random.default_rng(6)
    points = rng.uniform([-11, -11, 0.3], [11, 11, 8.9], (300, 3))
    points = points[dome.contains(points, 0.2)]
    turn = rng.normal(size=(200_000, 3))
    cap = 12 * turn / np.linalg.norm(turn, axis=1, keepdims=True) + [0, 0, 12]
    cap = cap[cap[:, 2] <= 9]
    nearest = [np.min(np.linalg.norm(cap - point, axis=1)) for point in points]
    assert_allclose(dome.depth(points), nearest, atol=0.02)  # the samples are about 0.1 mm apart
    assert (dome.depth(points) <= np.array(nearest) + 1e-12).all()
    rim = dome.base_radius_mm * np.array([[1, 0], [0, -1], [0.6, 0.8]])
    assert_allclose(dome.surface_from_above(0.999999 * rim)[:, 2], 9, atol=1e-4)
    assert np.isnan(dome.surface_from_above(1.000001 * rim)[:, 2]).all()
    assert_allclose(dome.piece_distances(np.column_stack([rim, np.full(3, 9.0)])), 0, atol=1e-12)
