"""Which marker is which: large motions, steps of the lattice, and sequences."""

import tracemalloc

import numpy as np
import pytest
from drawn import LAYOUT, SIZE, flat_layout, joined, picture
from numpy.testing import assert_allclose

from benchmarks.conditions import Card
from benchmarks.discs import expose, scene
from twin.errors import AccuracyWarning
from twin.sense.track import Tracker, track


@pytest.mark.parametrize("kind", ["bump", "radial", "uniform"])
def test_half_pitch_motion_is_matched(kind):
    """15 px at a pitch of 30 px with 5 % missing, and one that was never there: all matched, none invented."""
    layout, size = flat_layout(13, 11), (480, 400)
    points = joined(layout)
    away = points - [220.0, 190.0]
    bell = np.exp(-0.5 * (away**2).sum(axis=1) / 70.0**2)[:, None]
    shift = {"bump": 15.0 * bell * [0.9, 0.435], "radial": 15.0 * bell * away / 70.0 * 1.6,
             "uniform": np.tile([12.0, -9.0], (len(points), 1))}[kind]  # fmt: skip
    random = np.random.default_rng(2)
    rest, gone = random.uniform(-1, 1, points.shape), random.random(len(points)) < 0.05
    rest[100], gone[100] = np.nan, True
    pressed = np.where(gone[:, None], np.nan, rest + shift)
    found = track(picture(rest, 1, layout, size), picture(pressed, 2, layout, size), layout)
    assert np.isnan(found.rest_px[100]).all()
    assert not found.seen[gone].any()
    assert (found.states[gone] == "missing").mean() > 0.9
    assert np.isnan(found.sd_px[gone]).all()
    count, moved = len(layout["red"]), points + shift
    apart = np.linalg.norm(moved[:count, None] - moved[None, count:], axis=2)
    clear = np.concatenate([apart.min(axis=1), apart.min(axis=0)]) > 13.0
    error = np.linalg.norm(found.shift_px - shift, axis=1)
    assert found.seen[clear & ~gone].all()
    assert np.nanmax(error) < 0.5
    assert np.nanmax(error[clear]) < 0.15


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("share", "matched"), [(0.3, True), (0.42, False)])
def test_a_marker_that_leaves_its_lattice_alone_is_lost_beyond_a_third_of_a_pitch(share, matched, axis):
    shift, odd = np.zeros_like(joined(LAYOUT)), 21
    shift[odd, axis] = 30.0 * share
    rest, pressed = (picture(each, seed, diameter=8.0) for seed, each in enumerate((0.0, shift)))
    found = track(rest, pressed, LAYOUT)
    assert found.seen[odd] == matched
    assert np.delete(found.seen, odd).mean() > 0.95


def test_layout_may_be_off_by_shift_scale_and_tilt():
    turn, middle = np.deg2rad(1.0), np.array(SIZE) / 2
    map_ = 1.01 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    off = (joined(LAYOUT) - middle) @ map_.T + middle + [5.0, -4.0] - joined(LAYOUT)
    found = track(picture(off, 1), picture(off, 2), LAYOUT)
    assert np.nanmax(np.abs(found.rest_px - joined(LAYOUT) - off)) < 0.1
    assert found.seen.all()


@pytest.mark.parametrize("pitches", [(1.0, 0.0), (-1.1, 0.9), (0.15, 2.0)])
@pytest.mark.parametrize("holes", [0, 3])
def test_a_layout_may_be_off_by_rows_where_its_border_shows(pitches, holes):
    """Every marker but a row was taken for its neighbour, and the row was missing."""
    layout, size = {"red": flat_layout(9, 7, 30.0, (120.0, 110.0))["red"]}, (500, 420)
    shift = np.tile(30.0 * np.array(pitches), (len(joined(layout)), 1))
    shift[5 : 5 + 9 * holes : 9] = np.nan
    found = track(picture(shift, 1, layout, size), picture(shift, 2, layout, size), layout)
    assert_allclose(found.rest_px, joined(layout) + shift, atol=0.1)


def test_corners_of_a_drawing_without_the_pictures_perspective_are_found():
    """They lie .6 of the spacing off the affine map that fits best: two were missing."""
    grid = flat_layout(13, 10, 1.0, (-6.0, -4.5))["red"]
    near = 1.0 + grid @ [0.004, 0.011]
    off = (grid * [27.0, 25.0] + grid[:, ::-1] * [1.5, -1.0]) / near[:, None] + [200.0, 150.0]
    layout = {"red": grid * 26.0 + [200.0, 150.0]}
    found = track(*(picture(off - joined(layout), seed, layout, (400, 300)) for seed in (1, 2)), layout)
    assert found.seen.all()
    assert_allclose(found.rest_px, off, atol=0.1)


@pytest.mark.parametrize("diagonals", [(0.5, 0.5), (-0.5, 0.5), (0.5, -0.45)])
def test_layers_between_each_other_are_not_exchanged_where_the_drawing_is_off_by_half_a_diagonal(diagonals):
    """Each layer was taken for the other one: colours were given to layers before their places were known."""
    layout, size = flat_layout(8, 6, 30.0, (60.0, 60.0)), (330, 270)
    shift = 30.0 * np.array(diagonals)
    found = track(picture(shift, 1, layout, size), picture(shift, 2, layout, size), layout)
    assert_allclose(found.rest_px, joined(layout) + shift, atol=0.1)
    assert found.seen.all()


def moved_inside(shift, layout=LAYOUT, size=SIZE):
    """Return the shift, NaN for markers that it takes out of the picture."""
    place = joined(layout) + shift
    inside = ((place > -5.0) & (place < np.array(size) + 4.0)).all(axis=1)
    return np.where(inside[:, None], shift, np.nan)


@pytest.mark.parametrize("pitches", [(1.0, 0.0), (0.0, -1.5), (1.5, 0.7), (2.0, 0.0), (-2.5, 0.0)])
def test_a_cold_jump_by_a_lattice_step_is_found_or_ambiguous(pitches):
    shift = moved_inside(np.tile(30.0 * np.array(pitches), (len(joined(LAYOUT)), 1)))
    found = track(picture(0.0, 1), picture(shift, 2), LAYOUT)
    assert np.nanmax(np.abs(found.shift_px - shift), initial=0.0) < 0.2
    assert np.isin(found.states[~found.seen], ["ambiguous", "missing"]).all()


@pytest.mark.parametrize("margin", [27.0, 78.0])
@pytest.mark.parametrize("pitches", [(1.0, 0.0), (1.07, -1.0), (2.0, 0.0), (-3.0, 0.0)])
def test_a_film_that_is_cut_by_steps_of_the_lattice_is_found_or_ambiguous(pitches, margin):
    """Each marker was taken for its neighbour, as one was near the place before, and none said so."""
    layout = flat_layout(8, 6, 30.0, (margin, margin))
    size = (round(210 + 2 * margin), round(150 + 2 * margin))
    tracker = Tracker(picture(0.0, 1, layout, size), layout)
    assert tracker.track(picture((2.0, 1.0), 2, layout, size)).seen.all()
    for number in range(2):
        shift = moved_inside(np.array([pitches]) * 30.0 + number * np.ones((len(joined(layout)), 2)), layout, size)
        found = tracker.track(picture(shift, 3 + number, layout, size))
        assert np.nanmax(np.abs(found.shift_px - shift), initial=0.0) < 0.2
        assert np.isin(found.states[~found.seen], ["ambiguous", "missing"]).all()
    assert margin == 27.0 or abs(pitches[0]) > 2.0 or found.seen.all()


@pytest.mark.parametrize("side", [0, 1])
def test_a_row_of_the_border_that_is_hidden_does_not_pass_for_a_step_out_of_the_picture(side):
    """From a cold start all markers were a pitch off where the row's place was at the picture's frame."""
    place = joined(LAYOUT)[:, side]
    red = np.arange(len(place)) < len(LAYOUT["red"])
    hidden = np.where(red, place == place[red].min(), place == place[~red].min())
    shift = np.where(hidden[:, None], np.nan, [3.0, 2.0])
    found = track(picture(0.0, 1), picture(shift, 2), LAYOUT)
    assert np.nanmax(np.abs(found.shift_px - shift), initial=0.0) < 0.2


@pytest.mark.parametrize(("shift", "beyond"), [((-13.5, 3.0), True), ((20.0, 3.0), False), ((3.0, -22.0), False)])
def test_half_a_pitch_is_told_from_a_hidden_column_by_what_comes_into_the_picture(shift, beyond):
    """Where the print goes on beyond the frame all were a pitch off; where it doesn't, good jumps were refused, and 54
    of 63 markers moved by .7 pitches a pitch off."""
    rows = {"red": flat_layout(9 if beyond else 8, 7, 30.0, (30.0, 38.0))["red"]}
    size = (267 if beyond else 270, 237)
    moved = np.tile(shift, (len(rows["red"]), 1))
    moved[:7] = np.nan if beyond else shift
    found = track(picture(0.0, 1, rows, size), picture(moved, 2, rows, size), {"red": rows["red"][:56]})
    assert np.nanmax(np.abs(found.shift_px - shift), initial=0.0) < 0.2
    assert beyond or found.seen.all()


@pytest.mark.parametrize("pitches", [1.0, 3.0, 4.0, 5.0])
def test_equal_rows_that_fill_the_picture_are_never_matched_a_step_off(pitches):
    """After four pitches the rows that had left passed for hidden ones of a layer that had not moved."""
    rows = {"red": flat_layout(15, 11, 30.0, (30.0, 30.0))["red"]}
    shift = moved_inside(np.tile([30.0 * pitches, 0.0], (len(rows["red"]), 1)), rows, (480, 360))
    found = track(picture(0.0, 1, rows, (480, 360)), picture(shift, 2, rows, (480, 360)), rows)
    assert np.nanmax(np.abs(found.shift_px - shift), initial=0.0) < 0.2
    assert pitches == 1.0 or (found.states == "ambiguous").mean() > 0.5


def test_a_cold_bump_that_tears_the_rows_is_ambiguous():
    """Eighty of 117 markers were a pitch off."""
    rows = {"red": flat_layout(13, 9, 30.0, (60.0, 60.0))["red"]}
    away = rows["red"] - [240.0, 180.0]
    shift = 45.0 * np.exp(-0.5 * (away**2).sum(axis=1) / 1e4)[:, None] * [1.0, 0.0]
    found = track(picture(0.0, 1, rows, (480, 360)), picture(shift, 2, rows, (480, 360)), rows)
    assert np.nanmax(np.abs(found.shift_px - shift), initial=0.0) < 0.2


def test_a_cold_stretch_is_not_matched_to_the_neighbours():
    layout, size = flat_layout(17, 13, 30.0, (60.0, 60.0)), (600, 480)
    shift = 0.12 * (joined(layout) - np.array([300.0, 240.0]))
    found = track(picture(0.0, 1, layout, size), picture(shift, 2, layout, size), layout)
    assert found.seen.mean() > 0.85
    assert np.nanmax(np.abs(found.shift_px - shift)) < 0.2


def test_a_lattice_without_border_is_ambiguous_after_half_a_step():
    layout = flat_layout(13, 11, 30.0, (-60.0, -60.0))
    inside = ((joined(layout) > 6.0) & (joined(layout) < np.array(SIZE) - 7.0)).all(axis=1)
    red = np.arange(len(inside)) < len(layout["red"])
    known = {"red": joined(layout)[inside & red], "blue": joined(layout)[inside & ~red]}

    def drawn(step, seed):
        moved = np.where((joined(layout) + step > -4.0).all(axis=1)[:, None], joined(layout) + step, np.nan)
        moved = np.where((moved < np.array(SIZE) + 3.0).all(axis=1)[:, None], moved, np.nan)
        return expose(scene(SIZE, [(moved[red], 0), (moved[~red], 2)], 10.0), seed)

    rest = drawn(0.0, 1)
    small = track(rest, drawn(np.array([4.0, -3.0]), 2), known)
    assert small.seen.mean() > 0.85
    assert np.nanmax(np.abs(small.shift_px - [4.0, -3.0])) < 0.2
    half = track(rest, drawn(np.array([15.5, 0.0]), 3), known)
    assert not half.seen.any()
    assert (half.states == "ambiguous").mean() > 0.8


@pytest.mark.parametrize("pitches", [(1.0, 0.0), (-1.0, 1.0), (2.0, 0.0), (2.0, 1.0)])
@pytest.mark.parametrize("holes", [0, 3])
def test_a_lattice_that_goes_on_beyond_its_layout_is_followed_to_its_border(pitches, holes):
    """Each marker was taken for its neighbour: a spot showed for every marker, and one marker for every spot."""
    size = (390, 330)
    whole = flat_layout(10, 8, 30.0, (60.0, 60.0))
    rows = joined(whole)
    inside = ((rows > 100.0) & (rows < [290.0, 230.0])).all(axis=1)
    red = np.arange(len(rows)) < len(whole["red"])
    layout = {"red": rows[inside & red], "blue": rows[inside & ~red]}
    shift = moved_inside(np.tile(30.0 * np.array(pitches), (len(rows), 1)), whole, size)
    hidden = np.flatnonzero(inside)[5 : 5 + 9 * holes : 9]
    seen = [moved_inside(np.zeros_like(rows), whole, size), shift]
    seen[1][hidden] = np.nan
    found = track(*(picture(s, 1 + k, whole, size) for k, s in enumerate(seen)), layout)
    assert np.nanmax(np.abs(found.shift_px - 30.0 * np.array(pitches)), initial=0.0) < 0.2
    assert holes or abs(pitches[0]) > 1.0 or found.seen.mean() >= 0.99
    assert np.isin(found.states[~found.seen], ["ambiguous", "missing"]).all()


@pytest.mark.parametrize("pitches", [(0.0, 0.0), (1.0, 1.0), (1.3, 0.2)])
def test_an_ambiguous_layer_is_found_by_the_other(pitches):
    """A layer without a border in sight, and one of another pitch with one."""
    whole = {
        "red": flat_layout(7, 5, 38.0, (70.0, 80.0))["red"],
        "blue": flat_layout(18, 16, 30.0, (-75.0, -75.0))["red"],
    }
    blue, size = whole["blue"], (390, 330)
    layout = {"red": whole["red"], "blue": blue[((blue > 90.0) & (blue < [300.0, 240.0])).all(axis=1)]}
    shift = 30.0 * np.array(pitches)
    moves = [moved_inside(np.tile(s, (len(joined(whole)), 1)), whole, size) for s in (np.zeros(2), shift)]
    found = track(*(picture(m, 1 + k, whole, size) for k, m in enumerate(moves)), layout)
    assert found.seen.all()
    assert np.abs(found.shift_px - shift).max() < 0.2


def test_a_lattice_that_fills_the_picture_is_followed_from_rest_and_warned_of():
    """A jump by a pitch looks like none there; a layout without the cut markers must not lose all of them."""
    whole, size = flat_layout(16, 14, 30.0, (-45.0, -45.0)), (390, 330)
    layout = {name: p[((p > 100.0) & (p < [290.0, 230.0])).all(axis=1)] for name, p in whole.items()}
    moves = [moved_inside(np.full((len(joined(whole)), 2), m), whole, size) for m in np.arange(0.0, 46.0, 5.0)]
    rest, *later = (picture(m, 1 + k, whole, size) for k, m in enumerate(moves))
    with pytest.warns(AccuracyWarning, match="goes on to the borders"):
        assert np.abs(track(rest, later[0], layout).shift_px - 5.0).max() < 0.2
    with pytest.warns(AccuracyWarning, match="goes on to the borders"):
        tracker = Tracker(rest, layout)
    for number, frame in enumerate(later):
        assert np.abs(tracker.track(frame).shift_px - 5.0 * (number + 1)).max() < 0.2


def test_a_sequence_goes_anywhere():
    """Small steps to more than a pitch away, one to seven hidden on the way; then a jump of half a pitch."""
    tracker = Tracker(picture(0.0, 1), LAYOUT)
    for number in range(1, 12):
        shift = np.tile([3.0 * number, 1.5 * number], (len(joined(LAYOUT)), 1))
        if 3 < number < 7:
            shift[20] = np.nan
        if number in (4, 5):  # no reason to start anew
            shift[:48:8] = np.nan
        found = tracker.track(picture(shift, number))
        inside = ((joined(LAYOUT) + shift < np.array(SIZE) - 7) & np.isfinite(shift)).all(axis=1)
        assert found.seen[inside].all()
        assert not found.seen[np.isnan(shift[:, 0])].any()
        assert np.nanmax(np.abs(found.shift_px - shift)) < 0.15
    jump = shift - [14.0, 3.0]
    found = tracker.track(picture(jump, 50))
    assert found.seen.mean() > 0.9
    assert np.nanmax(np.abs(found.shift_px - jump)) < 0.15
    assert found.spurious_px is not None


def test_fast_steps_are_followed_out_of_the_picture():
    """Half a pitch a frame: where markers leave, the grid looks alike a pitch off, and was taken for that."""
    size, layout = (240, 180), flat_layout(8, 6, 30.0, (15.0, 15.0))
    tracker = Tracker(picture(0.0, 1, layout, size), layout)
    for number in range(1, 8):
        shift = moved_inside(np.tile([14.0 * number - 8.0, 0.0], (len(joined(layout)), 1)), layout, size)
        found = tracker.track(picture(shift, 1 + number, layout, size))
        whole = (joined(layout) + shift < np.array(size) - 7.0).all(axis=1)
        assert found.seen[whole].all() or number == 2
        assert np.nanmax(np.abs(found.shift_px - shift)) < 0.15


def test_warm_and_cold_agree_in_any_order():
    frames = [picture(s, i) for i, s in enumerate((0.0, 2.0, 4.0, 6.0))]
    tracker = Tracker(frames[0], LAYOUT)
    for place, number in enumerate((0, 2, 1, 3)):
        warm, cold = tracker.track(frames[number]), Tracker.motion(tracker.rest, frames[number])
        assert (warm.spurious_px is None) == (place > 0)
        assert warm.shift_px == pytest.approx(cold.shift_px, abs=0.003)


def test_markers_leave_the_picture_and_come_back():
    card = Card(10.0, 0.23)
    tracker = Tracker(expose(card.draw(), 1), card.layout)
    leaving = card.marks[:, 0] < 10.0
    for number, away in enumerate((-4.0, -8.0, -13.0, -8.0, -4.0, 0.0)):
        found = tracker.track(expose(card.draw([away, 1.0]), 2 + number))
        assert found.seen[~leaving].all()
        assert found.seen[leaving].all() == (away > -13.0)
        assert (np.abs(found.shift_px - [away, 1.0]) < 5.0 * found.sd_px[:, None])[found.seen].all()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_frames():
    frames = [picture(0.02 * i, i) for i in range(20)]
    tracker = Tracker(frames[0], LAYOUT)
    tracemalloc.start()
    for number in range(1000):  # what is made once is made
        tracker.track(frames[number % 20])
    before = tracemalloc.get_traced_memory()[0]
    for number in range(3000):
        tracker.track(frames[number % 20])
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 30_000
