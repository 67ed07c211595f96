"""The default tracker on pictures by area sampling: the bound, stated variances, sequences, flags, hard pictures."""

import tracemalloc

import numpy as np
import pytest
from marker_pictures import flat_layout

from benchmarks.discs import bound_px, expose, scene
from twin.errors import InputError
from twin.sense.track import Tracker, analyse_rest, track, track_frame

SIZE, LAYOUT = (264, 204), flat_layout(8, 6, 30.0, (27.0, 27.0))


def joined(layout):
    return np.concatenate(list(layout.values()))


def picture(shift=0.0, seed=None, layout=LAYOUT, size=SIZE, diameter=10.0, **options):
    """Both layers moved by ``shift`` (a number, a vector, or one row a marker)."""
    count = len(layout["red"])
    moved = joined(layout) + shift
    drawn = scene(size, [(moved[:count], 0), (moved[count:], 2)], diameter, **options)
    return drawn if seed is None else expose(drawn, seed)


@pytest.mark.parametrize(
    "diameter", [10.0, *(pytest.param(d, marks=pytest.mark.slow) for d in (8.0, 12.0, 15.0, 20.0))]
)
def test_spread_bias_and_stated_variance(diameter):
    """Re-rendered shifts up to 5 px: at most 1.25 x the Cramer-Rao bound, and chi-square says that sd_px is true."""
    pitch = max(30.0, 2.3 * diameter)
    layout, size = flat_layout(8, 6, pitch, (pitch, pitch)), (int(9 * pitch), int(7 * pitch))
    random = np.random.default_rng(3)
    errors, stated = [], []
    for draw in range(2):
        shift = random.uniform(-3.5, 3.5, joined(layout).shape)
        pair = [picture(s, 10 * draw + i, layout, size, diameter) for i, s in enumerate((0.0, shift))]
        found = track(*pair, layout)
        assert found.seen.all()
        errors.append(found.shift_px - shift)
        stated.append(found.sd_px)
    error, stated = np.concatenate(errors), np.concatenate(stated)[:, None]
    bound = np.sqrt(2) * bound_px(diameter)
    assert 0.85 * bound < error.std() <= min(1.25 * bound, 0.02)
    assert np.abs(error.mean(axis=0)).max() <= 0.005 / 2 + 3 * bound / np.sqrt(len(error))
    assert (error**2 / stated**2).mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / error.size) + 0.1)


def test_light_from_one_side_does_not_shift_the_centres():
    """Brightness falling by a third across a marker, more at the picture's edges, as near lamps make it."""

    def lit(dx, dy, x, y):
        return 1 + 0.06 * ((x / 132 - 1) * dx + (y / 102 - 1) * dy)

    shift = np.tile([3.3, -2.6], (len(joined(LAYOUT)), 1))
    found = track(picture(0.0, 1, shade=lit), picture(shift, 2, shade=lit), LAYOUT)
    error = found.shift_px - shift
    assert np.abs(error.mean(axis=0)).max() < 0.005
    assert error.std() < 1.25 * np.sqrt(2) * bound_px(10.0)


def test_large_motion_with_missing_markers():
    """15 px at a pitch of 30 px with 5 % missing: all matched, none invented."""
    layout = flat_layout(13, 10, 30.0, (40.0, 40.0))
    size, random = (450, 360), np.random.default_rng(0)
    away = joined(layout) - [220.0, 175.0]
    shift = 15.0 * np.exp(-0.5 * (away**2).sum(axis=1) / 90**2)[:, None] * [0.9, 0.43]
    gone = random.random(len(shift)) < 0.05
    found = track(
        picture(0.0, 1, layout, size), picture(np.where(gone[:, None], np.nan, shift), 2, layout, size), layout
    )
    error = np.linalg.norm(found.shift_px - shift, axis=1)
    assert found.seen[~gone].all()
    assert not found.seen[gone].any()
    assert (found.states[gone] == "missing").all()
    assert np.nanmax(error) < 0.2


def test_states_say_what_is_wrong():
    drawn = picture()
    red = LAYOUT["red"].astype(int)
    column, row = red[10]
    spot = (slice(row - 8, row + 9), slice(column - 8, column + 9), 0)
    drawn[spot] = 30 + 0.15 * (drawn[spot] - 30)
    column, row = red[20]
    drawn[row - 8 : row + 9, column : column + 9, 0] = 30.0
    shift = np.zeros_like(joined(LAYOUT))
    shift[30] = np.nan
    rest = picture(0.0, 1)
    found = track(rest, expose(drawn, 2), LAYOUT)
    assert found.states[10] == "dim"
    assert found.states[20] == "occluded"
    lost = track(rest, picture(shift, 3), LAYOUT)
    assert lost.states[30] == "missing"
    close = np.zeros_like(shift)
    close[40] = LAYOUT["red"][41] - LAYOUT["red"][40] - [0.0, 8.0]
    merged = track(rest, picture(close, 4), LAYOUT)
    assert not merged.seen[[40, 41]].any()
    assert "merged" in merged.states[[40, 41]]


def test_strange_spots_are_told_and_taken_for_no_marker():
    extra = {"red": np.vstack([LAYOUT["red"], [[58.0, 40.0]]]), "blue": LAYOUT["blue"]}
    drawn = expose(scene(SIZE, [(extra["red"], 0), (extra["blue"], 2)], 10.0), 5)
    found = track(picture(0.0, 1), drawn, LAYOUT)
    assert found.spurious_px is not None
    assert np.abs(found.spurious_px - [58.0, 40.0]).max(axis=1).min() < 0.5
    assert np.nanmax(np.abs(found.shift_px)) < 0.1


def test_a_sequence_goes_anywhere():
    """Small steps to more than a pitch away, one marker hidden on the way; then a jump of half a pitch."""
    tracker = Tracker(picture(0.0, 1), LAYOUT)
    for number in range(1, 12):
        shift = np.tile([3.0 * number, 1.5 * number], (len(joined(LAYOUT)), 1))
        if 3 < number < 7:
            shift[20] = np.nan
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


def test_warm_and_cold_agree():
    rest = analyse_rest(picture(0.0, 1), LAYOUT)
    image = picture(2.2, 2)
    cold = track_frame(rest, image)
    warm = track_frame(rest, image, np.full_like(cold.shift_px, 1.0))
    assert warm.spurious_px is None
    assert warm.shift_px == pytest.approx(cold.shift_px, abs=0.003)


def test_the_papers_tracker_takes_the_difference_of_red_and_blue():
    found = track(picture(0.0, 1), picture(1.0, 2), LAYOUT, method="two-pass")
    assert found.channels == {"red": (1.0, 0.0, -1.0), "blue": (-1.0, 0.0, 1.0)}
    assert np.abs(np.nanmean(found.shift_px - 1.0, axis=0)).max() < 0.05


HARD = {
    "blank": lambda p: np.full_like(p, 30),
    "saturated": lambda p: np.full_like(p, 255),
    "black": lambda p: np.zeros_like(p),
    "noise": lambda p: np.random.default_rng(0).integers(0, 255, p.shape, np.uint8),
}


@pytest.mark.parametrize("kind", HARD)
def test_pictures_without_markers_yield_none(kind):
    rest = picture(0.0, 1)
    spoilt = HARD[kind](rest)
    tracker = Tracker(rest, LAYOUT)
    for image in (spoilt, rest, spoilt):
        found = tracker.track(image)
        assert found.seen.all() if image is rest else found.seen.mean() < 0.05
    blind = Tracker(spoilt, LAYOUT)
    assert np.isfinite(blind.rest.rest_px).all(axis=1).mean() < 0.2


def test_half_the_markers_gone_and_half_the_picture_cropped():
    rest, image = picture(0.0, 1), picture(0.7, 2)
    gone = np.random.default_rng(1).random(len(joined(LAYOUT))) < 0.5
    found = track(rest, picture(np.where(gone[:, None], np.nan, 0.7), 3), LAYOUT)
    assert (found.seen == ~gone).all()
    half = image.copy()
    half[:, : SIZE[0] // 2] = 30
    found = track(rest, half, LAYOUT)
    right = joined(LAYOUT)[:, 0] + 0.7 > SIZE[0] / 2 + 6
    assert found.seen[right].all()
    assert not found.seen[joined(LAYOUT)[:, 0] < SIZE[0] / 2 - 6].any()
    with pytest.raises(InputError, match="camera mode"):
        track(rest, image[:, : SIZE[0] // 2], LAYOUT)


def test_a_finger_crossing_the_edge_hides_only_what_it_covers():
    rest, image = picture(0.0, 1), picture(0.7, 2)
    image[60:, 200:] = 120
    found = track(rest, image, LAYOUT)
    clear = (joined(LAYOUT)[:, 0] < 190) | (joined(LAYOUT)[:, 1] < 50)
    covered = (joined(LAYOUT)[:, 0] > 206) & (joined(LAYOUT)[:, 1] > 66)
    assert found.seen[clear].all()
    assert not found.seen[covered].any()


@pytest.mark.parametrize("kind", ["float", "nan", "16 bit", "four channels"])
def test_pixels_of_another_kind_are_refused(kind):
    rest = picture(0.0, 1)
    wrong = {"float": rest / 255.0, "nan": np.where(rest > 100, np.nan, rest), "16 bit": rest.astype(np.uint16) * 256,
             "four channels": np.dstack([rest, rest[..., :1]])}[kind]  # fmt: skip
    with pytest.raises(InputError, match=r"8-bit|channels"):
        track(rest, wrong, LAYOUT)


def test_two_frames_swapped_change_nothing_but_their_order():
    frames = [picture(s, i) for i, s in enumerate((0.0, 2.0, 4.0, 6.0))]
    straight, swapped = Tracker(frames[0], LAYOUT), Tracker(frames[0], LAYOUT)
    a = [straight.track(f).shift_px for f in frames]
    b = [swapped.track(frames[i]).shift_px for i in (0, 2, 1, 3)]
    for i, j in enumerate((0, 2, 1, 3)):
        assert b[i] == pytest.approx(a[j], abs=0.01)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_frames():
    frames = [picture(0.02 * i, i) for i in range(20)]
    tracker = Tracker(frames[0], LAYOUT)
    for image in frames:
        tracker.track(image)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for number in range(3000):
        tracker.track(frames[number % 20])
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 300_000
