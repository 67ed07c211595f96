"""Tracking on pictures by area sampling: the bound, stated variances, matching, sequences, states, hard pictures."""

import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from drawn import LAYOUT, SIZE, flat_layout, joined, picture
from scipy.ndimage import gaussian_filter

from benchmarks.conditions import Card, film, hidden, jpeg, mosaic, stretches
from benchmarks.discs import bound_px, cover, expose, scene
from twin import Sensor, load_scene
from twin.errors import AccuracyWarning, InputError
from twin.sense.track import Tracker, analyse_rest, track, track_frame

WIDTHS = [8.0, 10.0, pytest.param(15.0, marks=pytest.mark.slow)]


def wide(diameter):
    """Return layout and size of a picture of markers of this diameter."""
    pitch = max(30.0, 2.3 * diameter)
    return flat_layout(8, 6, pitch, (pitch, pitch)), (int(9 * pitch), int(7 * pitch))


def lit_by_marker(share, diameter, pitch):
    """Brightness falling by ``share`` over a radius, along a direction that differs by marker."""

    def shade(dx, dy, x, y):
        angle = 1.9 * np.rint(2 * x / pitch) + 5.3 * np.rint(2 * y / pitch)
        return 1 + 2 * share / diameter * (np.cos(angle) * dx + np.sin(angle) * dy)

    return shade


@pytest.mark.parametrize(
    ("diameter", "contrast", "shading"),
    [(10.0, 130.0, 0.0), (10.0, 130.0, 0.25), (15.0, 180.0, 0.4)]
    + [pytest.param(d, 130.0, 0.0, marks=pytest.mark.slow) for d in (8.0, 12.0, 15.0, 20.0)],
)
def test_spread_bias_and_stated_variance(diameter, contrast, shading):
    """Re-rendered shifts up to 5 px: at most 1.25 x the Cramer-Rao bound, and chi-square says that sd_px is true; less
    so where the bright side reaches 255 counts."""
    layout, size = wide(diameter)
    random, saturated = np.random.default_rng(3), contrast > 130
    drawn = {"contrast": contrast, "shade": lit_by_marker(shading, diameter, layout["red"][0, 0]) if shading else None}
    errors, stated, at_rest = [], [], []
    for draw in range(2):
        shift = random.uniform(-3.5, 3.5, joined(layout).shape)
        pair = [picture(s, 10 * draw + i, layout, size, diameter, **drawn) for i, s in enumerate((0.0, shift))]
        found = track(*pair, layout)
        assert found.seen.all()
        at_rest.append(found.rest_px - joined(layout))
        errors.append(found.shift_px - shift)
        stated.append(found.sd_px)
    error, stated = np.concatenate(errors), np.concatenate(stated)[:, None]
    bound = np.sqrt(2) * bound_px(diameter, contrast=contrast)
    assert np.abs(np.concatenate(at_rest).mean(axis=0)).max() <= 0.01
    assert 0.85 * bound < error.std() <= min((1.6 if saturated else 1.25) * bound, 0.02)
    assert np.abs(error.mean(axis=0)).max() <= 0.005 / 2 + 3 * bound / np.sqrt(len(error))
    chance = 4 * np.sqrt(2 / error.size) + (0.25 if saturated else 0.1)
    assert (error**2 / stated**2).mean() == pytest.approx(1.0, abs=chance)


CAMERAS = {"jpeg": jpeg, "mosaic": mosaic, "both": lambda image: jpeg(mosaic(image))}


@pytest.mark.parametrize("diameter", [10.0, 15.0])
@pytest.mark.parametrize("camera", CAMERAS)
def test_stated_variance_of_compressed_and_mosaic_pictures(camera, diameter):
    """Errors that hang together over pixels: the stated deviation was 5 to 9 times too small."""
    (layout, size), random = wide(diameter), np.random.default_rng(3)
    rest = analyse_rest(CAMERAS[camera](picture(0.0, 0, layout, size, diameter)), layout)
    scores = []
    for draw in range(3):
        shift = random.uniform(-3.5, 3.5, joined(layout).shape)
        found = track_frame(rest, CAMERAS[camera](picture(shift, 1 + draw, layout, size, diameter)))
        assert found.seen.all()
        scores.append((found.shift_px - shift) / found.sd_px[:, None])
    assert 1 / 1.5 < np.sqrt(np.mean(np.square(scores))) < 1.5
    # what leaves as little as white noise was a traceback
    assert replace(rest.groups[0].templates, usual_misfit=1.0).smooths_third == 1.0


@pytest.mark.parametrize(("diameter", "largest"), [(4.0, 1.5), (5.0, 1.4), (6.0, 1.2)])
def test_small_compressed_dots_state_a_true_deviation(diameter, largest):
    """Smooth noise moves small dots more than it bends their edges: blue ones were off by 1.5 to 1.9 deviations."""
    card, scores = Card(diameter), []
    for seed in range(10, 18):
        rest, shift = analyse_rest(jpeg(expose(card.draw(), 100 * seed + 1)), card.layout), card.shifts(10 + seed)
        found = track_frame(rest, jpeg(expose(card.draw(shift), 20 + seed)), np.zeros_like(shift))
        scores.append(((found.shift_px - shift) / found.sd_px[:, None])[card.count :])
    assert np.sqrt(np.nanmean(np.square(scores))) < largest


def test_compressed_markers_are_measured_by_their_brightness():
    """JPEG keeps colours at half the resolution: in red or blue alone .06 px."""
    card, shift = Card(15.0), Card(15.0).shifts(3)
    found = track(jpeg(expose(card.draw(), 1)), jpeg(expose(card.draw(shift), 2)), card.layout)
    error = found.shift_px - shift
    for layer, largest in ((slice(card.count), 0.035), (slice(card.count, None), 0.052)):
        assert np.sqrt(np.mean(error[layer] ** 2)) < largest
        assert np.sqrt(np.mean((error / found.sd_px[:, None])[layer] ** 2)) < 1.6


@pytest.mark.parametrize("diameter", [10.0, 15.0])
@pytest.mark.parametrize(("before", "after"), [(0, 85), (0, 60), (60, 0), (95, 60)])
def test_pairs_of_different_encoders(before, after, diameter):
    """Of a clean rest picture and a JPEG most markers passed for partly hidden (half at 60); shapes sharper than at
    rest stated a third of their errors. Qualities of 0 are PNG."""
    card, errors, stated = Card(diameter), [], []
    for seed in range(2):
        shift = card.shifts(500 + seed)
        pair = [expose(card.draw(moved), seed + k) for k, moved in enumerate((0.0, shift))]
        pair = [jpeg(p, quality) if quality else p for p, quality in zip(pair, (before, after), strict=True)]
        found = track(*pair, card.layout)
        errors.append(found.shift_px - shift)
        stated.append(found.sd_px[:, None])
    error, sd = np.concatenate(errors), np.concatenate(stated)
    seen = np.isfinite(error[:, 0])
    assert seen.mean() > 0.93
    assert np.sqrt(np.mean((error / sd)[seen] ** 2)) < 1.5
    assert ((np.abs(error) > 5 * sd) & (np.abs(error) > 0.1)).sum() < 3
    assert np.median(sd[seen]) < 0.1


def test_hidden_parts_are_stated_where_a_picture_is_compressed_and_the_rest_picture_is_not():
    """Errors were 2.1 times those stated of markers of which 14 % is hidden, 1.2 times of the others."""
    card, hides, whole = Card(10.0), [], []
    some = np.arange(len(card.marks)) % 5 == 0
    for seed in range(3):
        shift = card.shifts(700 + seed)
        drawn = hidden(card, card.draw(shift), shift, np.flatnonzero(some), 0.14, seed)
        found = track(expose(card.draw(), seed), jpeg(expose(drawn, 50 + seed), 60), card.layout)
        score = (found.shift_px - shift) / found.sd_px[:, None]
        assert found.seen[some].mean() > 0.7
        hides.append(score[some])
        whole.append(score[~some])
    assert np.sqrt(np.nanmean(np.square(hides))) < 1.8
    assert 0.8 < np.sqrt(np.nanmean(np.square(whole))) < 1.5


@pytest.mark.parametrize("diameter", [10.0, 15.0])
def test_a_glint_that_was_not_there_at_rest_is_no_slope_of_brightness(diameter):
    """Five times the error was stated (15 px)."""
    card = Card(diameter)

    def glint(dx, dy, x, y):
        return 1 + 0.8 * np.exp(-0.5 * ((dx - 0.2 * diameter) ** 2 + dy**2))

    shift = card.shifts(7)
    found = track(expose(card.draw(), 1), expose(card.draw(shift, shade=glint), 2), card.layout)
    error = np.sqrt(np.mean((found.shift_px - shift) ** 2))
    assert error < np.sqrt(np.mean(found.sd_px**2)) < 3.8 * error


@pytest.mark.parametrize(
    ("diameter", "camera", "ratio"), [(20.0, partial(jpeg, quality=95), 1.3), (15.0, np.asarray, 1.0)]
)
def test_markers_that_strain_unlike_their_neighbours_do_not_pass_for_hidden(diameter, camera, ratio):
    """One in nine is stretched, or smaller by 3 %: 70 and 50 times the error were stated."""
    card, shift = Card(diameter), Card(diameter).shifts(3)
    some = np.arange(len(card.marks)) % 9 == 0
    stretch = np.tile(np.eye(2), (len(card.marks), 1, 1))
    random = np.random.default_rng(5)
    stretch[some] = stretches(int(some.sum()), ratio, random) if ratio > 1.0 else 0.97 * np.eye(2)
    pair = [expose(card.draw(), 1), expose(card.draw(shift, stretch=stretch), 2)]
    found = track(*(camera(picture_) for picture_ in pair), card.layout)
    error = np.sqrt(np.mean((found.shift_px - shift)[some] ** 2))
    assert error / 1.5 < np.sqrt(np.mean(found.sd_px[some] ** 2)) < 13 * error


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["ideal", "industrial", "kamiyama_ntsc", "sato_60fps"])
def test_a_pressed_pad_states_a_true_deviation_under_every_camera(camera):
    """Without noise 20 to 30 times the error was stated, of strained markers up to 300 times."""
    sensor = Sensor(load_scene("gelpad_press", {"ccd.preset": camera, "press.force_n": {"z": 1.0}}))
    tracker, rest = Tracker(sensor.picture(None), sensor.layout_px), sensor.actual.markers.points
    state = sensor.press()
    shift = sensor.project(rest + sensor.motion(state.load).displacement_mm) - sensor.project(rest)
    for _ in range(2):
        found = tracker.track(sensor.picture(state.load))
        error, strained = found.shift_px - shift, found.states == "strained"
        assert found.seen.all()
        assert strained.sum() > 10
        assert 0.5 < np.sqrt(np.mean((error / found.sd_px[:, None]) ** 2)) < 1.5
        assert np.sqrt(np.mean(found.sd_px[strained] ** 2)) < 0.06


def test_light_from_one_side_does_not_shift_the_centres():
    """Brightness falling by a third across a marker, more at the picture's edges, as near lamps make it."""

    def lit(dx, dy, x, y):
        return 1 + 0.06 * ((x / 132 - 1) * dx + (y / 102 - 1) * dy)

    shift = np.tile([3.3, -2.6], (len(joined(LAYOUT)), 1))
    found = track(picture(0.0, 1, shade=lit), picture(shift, 2, shade=lit), LAYOUT)
    error = found.shift_px - shift
    assert np.abs(error.mean(axis=0)).max() < 0.005
    assert error.std() < 1.25 * np.sqrt(2) * bound_px(10.0)


def test_a_shadow_that_moves_with_the_marker_does_not_shift_its_centre():
    """From another start than at rest the fit went back half as far: .0037 px off without any motion."""
    card, mean = Card(12.0), []
    for seed in range(4):
        pair = [expose(card.draw(shade=lambda dx, *_: 1 - 0.6 * (dx < -4.2)), 10 * seed + k) for k in (1, 7)]
        mean.append(track(*pair, card.layout).shift_px.mean(axis=0))
    assert np.abs(np.mean(mean, axis=0)).max() < 0.0015


def test_soft_window_beats_the_papers_cells():
    """Which take the difference of red and blue."""
    spread = {}
    for method in ("soft-window", "two-pass"):
        found = track(picture(0.0, 1), picture(2.37, 2), LAYOUT, method=method)
        assert found.seen.all()
        assert np.abs(np.mean(found.shift_px - 2.37, axis=0)).max() < 0.05
        spread[method] = np.std(found.shift_px)
    assert found.channels == {"red": (1.0, 0.0, -1.0), "blue": (-1.0, 0.0, 1.0)}
    assert spread["soft-window"] < 0.75 * spread["two-pass"]
    assert spread["two-pass"] < 0.3


def test_centroids_that_follow_their_cells_state_how_much_of_a_small_motion_they_lack():
    """Clipped noise fills the cell, which small motion doesn't move; a fit has no cell."""
    found = track(picture(0.0, 1), picture(0.3, 2), LAYOUT, method="two-pass")
    lacking = 1.0 - np.mean(found.shift_px) / 0.3
    assert lacking > 0.04
    assert found.gain_error == pytest.approx(lacking, rel=0.6)
    fitted = track(picture(0.0, 1), picture(0.3, 2), LAYOUT)
    assert fitted.gain_error == 0
    assert not fitted.drift_px.any()
    # cells that start far off don't arrive at rest: the same picture moves
    aside = {name: places - [6.0, 0.0] for name, places in LAYOUT.items()}
    for layout, least in ((LAYOUT, 0.0), (aside, 0.02)):
        again = track(picture(0.0, 1), picture(0.0, 1), layout, method="two-pass")
        assert again.drift_px == pytest.approx(again.shift_px)
        assert np.abs(again.drift_px).max() >= least


@pytest.mark.parametrize("quality", [0, 95, 60])
def test_the_papers_centroid_states_what_shifts_scatter(quality):
    """.07 px was stated of all pictures, for errors of .05 to .4 px. A quality of 0 is PNG."""
    card, scores = Card(10.0), []
    for seed in range(2):
        shift = 2.5 * np.sin(card.marks[:, ::-1] / [80.0, 90.0] + seed)
        pair = [expose(card.draw(moved), 10 * seed + k) for k, moved in enumerate((0.0, shift))]
        found = track(*(jpeg(p, quality) if quality else p for p in pair), card.layout, method="two-pass")
        scores.append((found.shift_px - shift) / found.sd_px[:, None])
    assert 1 / 3 < np.sqrt(np.nanmean(np.square(scores))) < 1.2


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


def test_covered_markers_are_lost_or_doubted():
    """A red marker slides over a blue one: the blue's cut outline must not pass as motion."""
    slide = np.zeros_like(joined(LAYOUT))
    slide[21] = [9.0, 9.0]
    count, moved = len(LAYOUT["red"]), joined(LAYOUT) + slide
    drawn = scene(SIZE, [(moved[count:], 2)], 10.0)
    hidden = scene(SIZE, [(moved[21:22], 1)], 10.0, contrast=1.0)[..., 1:2] - 30.0
    drawn = drawn * (1 - hidden) + 30.0 * hidden + scene(SIZE, [(moved[:count], 0)], 10.0) - 30.0
    found = track(picture(0.0, 1), expose(drawn, 2), LAYOUT)
    error = np.linalg.norm(found.shift_px - slide, axis=1)
    assert (~(error > 5 * found.sd_px)).all()
    assert found.seen.sum() >= len(found.seen) - 2


def test_colours_are_told_apart_by_the_layout_not_the_name():
    swapped = {"red": LAYOUT["blue"], "blue": LAYOUT["red"]}
    found = track(picture(0.0, 1), picture(0.0, 1), swapped)
    assert found.channels["red"][2] > 0.5 > found.channels["red"][0]
    assert found.channels["blue"][0] > 0.5 > found.channels["blue"][2]
    assert np.nanmax(np.abs(found.rest_px - joined(swapped))) < 0.1
    assert found.seen.all()


@pytest.mark.parametrize(
    ("diameter", "pitch", "dyes"),
    [
        (10.0, 24.0, np.eye(3)),  # hardly any ground beside a marker
        (16.0, 40.0, np.array([[1.0, 0.3, 0.1], [0.9, 0.8, 0.2], [0.1, 0.3, 0.9]])),  # red shows in yellow's contrast
        (6.0, 40.0, -0.2 * np.eye(3)),  # darker than the ground
    ],
)
def test_three_colours_of_markers_are_three_layers(diameter, pitch, dyes):
    random, size = np.random.default_rng(11), (round(10 * pitch), round(8 * pitch))
    places = flat_layout(9, 7, pitch, (0.6 * pitch, 0.6 * pitch))["red"]
    offsets = pitch * np.array([(0.0, 0.0), (0.5, 0.1), (0.1, 0.5)])
    layout = {str(k): places + off + random.uniform(-0.5, 0.5, places.shape) for k, off in enumerate(offsets)}
    shift = random.uniform(-3.5, 3.5, (3, *places.shape))
    pair = []
    for seed, moved in enumerate((np.zeros(3), shift)):
        shares = [cover(size, p + m, diameter, 0.7)[..., None] for p, m in zip(layout.values(), moved, strict=True)]
        pair.append(expose(30.0 + 130.0 * sum(s * dye for s, dye in zip(shares, dyes, strict=True)), seed))
    found = track(*pair, layout)
    error = found.shift_px - np.concatenate(shift)
    assert found.seen.mean() > 0.97
    assert np.nanmean((error / found.sd_px[:, None]) ** 2) < 1.3


@pytest.mark.parametrize("red", [(1.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_given_channels_are_used(red):
    rest, channels = picture(0.0, 1), {"red": red, "blue": red[::-1]}
    found = track(rest, rest, LAYOUT, channels=channels)
    assert found.seen.all()
    assert found.channels == channels


@pytest.mark.parametrize("polarity", [None, "dark"])
def test_dark_markers_on_bright_ground(polarity):
    found = track(255 - picture(0.0, 1), 255 - picture(0.0, 2), LAYOUT, polarity=polarity)
    assert found.seen.all()
    assert np.nanmax(np.abs(found.rest_px - joined(LAYOUT))) < 0.1


@pytest.mark.parametrize("dark", [True, False])
def test_markers_in_light_that_falls_to_a_sixth_are_found(dark):
    """The ground varies by more than the markers differ from it."""
    size, layout = (630, 120), {"dots": flat_layout(20, 3, 30.0, (30.0, 30.0))["red"]}
    light = np.linspace(1.0, 0.17, size[0])[None, :, None]
    pair = []
    for seed, shift in enumerate((0.0, [1.3, -0.6])):
        share = cover(size, layout["dots"] + shift, 10.0, 0.7)[..., None] * np.ones(3)
        pair.append(expose(light * (220.0 - 100.0 * share if dark else 120.0 + 100.0 * share), seed))
    found = track(*pair, layout)
    assert found.seen.mean() > 0.95
    np.testing.assert_allclose(np.nanmedian(found.shift_px, axis=0), [1.3, -0.6], atol=0.02)


@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("change", ["shadow", "blob", "lamp"])
def test_light_that_changes_in_a_part_of_the_picture_moves_no_marker(change, dark):
    """Errors were 1.6 to 3.5 times those stated, and up to a quarter of the markers wrong unnoticed."""
    size, layout = (330, 270), {"dots": flat_layout(10, 8, 28.0, (39.0, 37.0))["red"]}
    across, down = np.meshgrid(np.linspace(-0.5, 0.5, size[0]), np.linspace(-0.5, 0.5, size[1]))
    score, error = [], []
    for seed in range(3):
        random = np.random.default_rng(seed)
        shift, (x, y), turn = (
            random.uniform(-2.5, 2.5, (80, 2)),
            random.uniform(-0.2, 0.2, 2),
            random.uniform(0.0, 6.28),
        )
        light = {
            "shadow": 1.0 - 0.4 / (1.0 + np.exp(-(across * np.cos(turn) + down * np.sin(turn)) / 0.06)),
            "blob": 1.0 - 0.3 * np.exp(-((across - x) ** 2 + (down - y) ** 2) / 0.05),
            "lamp": 0.4 + 0.6 * np.exp(-((across - x) ** 2 + (down - y) ** 2) / 0.4),
        }[change]
        pair = []
        for number, (moved, lit) in enumerate(((0.0, 1.0), (shift, light))):
            share = cover(size, layout["dots"] + moved, 11.0, 0.7)[..., None] * np.ones(3)
            drawn = 190.0 - 150.0 * share if dark else 45.0 + 170.0 * share
            pair.append(expose(drawn * np.broadcast_to(lit, share.shape[:2])[..., None], 2 * seed + number))
        found = track(*pair, layout)
        error.append(found.shift_px - shift)
        score.append(error[-1] / found.sd_px[:, None])
    assert np.isfinite(error).mean() > 0.99
    assert np.sqrt(np.nanmean(np.square(error))) < 0.016
    assert 0.5 < np.sqrt(np.nanmean(np.square(score))) < 1.3
    assert np.nanmax(np.abs(score)) < 5.0


def test_a_pad_that_fills_less_than_half_of_the_picture_has_a_ground_of_its_own():
    """Wide black dots on a white pad before black: half of all pixels are not the markers' ground."""
    size, layout = (900, 390), {"dots": flat_layout(5, 5, 65.0, (320.0, 65.0))["red"]}
    light = np.full((390, 900, 1), 4.0)
    light[:, 255:645] = 200.0
    places = layout["dots"] + np.random.default_rng(5).normal(0, 1.0, layout["dots"].shape)
    pair = [expose(light * (1 - 0.92 * cover(size, places + s, 24.0, 0.84)[..., None]) * np.ones(3), i) for i, s in
            enumerate((0.0, [1.3, -0.6]))]  # fmt: skip
    found = track(*pair, layout)
    assert found.seen.all()
    assert np.nanstd(found.shift_px - [1.3, -0.6]) < 1.5 * np.nanmedian(found.sd_px) < 0.02


def test_layers_in_a_grey_picture():
    """One layer, and two that no colour tells apart."""
    for layout in ({"beads": LAYOUT["red"]}, LAYOUT):
        grey = [expose(scene(SIZE, [(joined(layout), 1)], 10.0), i)[..., 1] for i in (1, 2)]
        found = track(*grey, layout)
        assert found.seen.all()
        assert np.nanstd(found.shift_px) < 0.03
        assert np.nanmax(np.abs(found.rest_px - joined(layout))) < 0.1


@pytest.mark.parametrize(("second", "glare"), [((35, 35, 35), 0), ((20, 0, -80), 0), ((-140, -140, -140), 90)])
def test_a_layer_far_paler_than_the_other_is_found_and_glare_is_none(second, glare):
    """Black dots and white, yellow or black ones on light grey. White ones, and black ones beside glare, were lost."""
    random, (x, y) = np.random.default_rng(6), np.meshgrid(*map(np.arange, SIZE))
    light = 160.0 + glare * np.exp(-((x - 200.0) ** 2 + (y - 130.0) ** 2) / 1250.0)[..., None]
    shift, pair = {name: random.normal(0.0, 0.5, p.shape) for name, p in LAYOUT.items()}, []
    for seed in range(2):
        dark, other = (cover(SIZE, p + seed * shift[name], 10.0, 0.7)[..., None] for name, p in LAYOUT.items())
        pair.append(expose(light - 140.0 * dark + np.array(second) * other, seed))
    found = track(*pair, LAYOUT)
    error = found.shift_px - joined(shift)
    assert found.seen.mean() > 0.98
    assert np.nanmean(error**2) < 0.02**2
    assert np.nanmean((error / found.sd_px[:, None]) ** 2) < 1.4


@pytest.mark.parametrize(("shape", "radius"), [("disc", 2.5), ("disc", 5.0), ("square", 5.3), ("cross", 8.0)])
def test_drawn_dots_without_grey_levels(shape, radius):
    """Motion by whole pixels is exact, by parts of one as good as a centroid. By the fit half were refused as partly
    hidden, and crosses were .4 px off."""
    marks, size = flat_layout(8, 6, 25.3, (24.0, 24.0))["red"], (226, 176)
    x, y = np.meshgrid(*map(np.arange, size))
    motion = (marks - marks.mean(axis=0)) * [0.03, -0.02] + [1.37, -0.81]

    def dots(shift):
        dx, dy = (np.abs(at[..., None] - to) for at, to in zip((x, y), (marks + shift).T, strict=True))
        inside = {
            "disc": np.hypot(dx, dy) < radius,
            "square": np.fmax(dx, dy) < radius,
            "cross": (np.fmax(dx, dy) < radius) & (np.fmin(dx, dy) < 0.35 * radius),
        }[shape].any(axis=2)
        return np.where(inside[..., None], (200, 30, 20), (20, 20, 20)).astype(np.uint8)

    rest, layout = dots(0.0), {"red": marks}
    np.testing.assert_allclose(
        track(rest, dots((2, -1)), layout).shift_px, np.tile([2.0, -1.0], (len(marks), 1)), atol=1e-6
    )
    found = track(rest, dots(motion), layout)
    error = found.shift_px - motion
    assert found.seen.all()
    assert np.sqrt(np.mean(error**2)) < (0.2 if shape == "disc" else 0.5)
    assert 0.5 < np.sqrt(np.mean((error / found.sd_px[:, None]) ** 2)) < 2.0


@pytest.mark.parametrize("quality", [60, 75, 90])
@pytest.mark.parametrize("line", [2.0, 12.0])
def test_drawn_dots_and_rings_state_what_a_jpeg_leaves_of_them(quality, line):
    """From even ground away from them, which a JPEG makes flat: up to 12 times too little."""
    size, layout = (500, 380), {"dots": flat_layout(8, 6, 56.0, (53.3, 49.7))["red"]}
    x, y = np.meshgrid(*map(np.arange, size))
    motion = (layout["dots"] - 200.0) * [0.02, -0.015] + [1.37, -0.81]
    pair = []
    for seed, moved in enumerate((0.0, motion)):
        away = np.min([np.hypot(x - a, y - b) for a, b in layout["dots"] + moved], axis=0)
        inside = (away < 12.0) & (away >= 12.0 - line)
        pair.append(jpeg(expose(np.where(inside, 200.0, 40.0)[..., None] * np.ones(3), seed), quality))
    found = track(*pair, layout)
    error = found.shift_px - motion
    assert found.seen.all()
    assert 0.25 < np.sqrt(np.mean((error / found.sd_px[:, None]) ** 2)) < 1.5


@pytest.mark.parametrize(("apart", "count", "frame"), [(22.0, (8, 6), 40), (22.0, (2, 2), 40), (150.0, (2, 2), 0)])
def test_dark_dots_are_found_where_a_dark_frame_fills_more_of_the_picture_or_they_are_far_apart(apart, count, frame):
    (x, y), size = np.meshgrid(np.arange(320), np.arange(240)), np.array([320, 240])
    places = flat_layout(*count, apart, (0.0, 0.0))["red"]
    places = places - places.mean(axis=0) + size / 2

    def view(shift):
        ground = np.where((abs(x - 160) < 160 - frame) & (abs(y - 120) < 120 - frame), 190.0, 5.0)
        cover = [np.clip(4.5 - np.hypot(x - a, y - b), 0, 1) for a, b in places + shift]
        grey = ground + (30.0 - ground) * np.max(cover, axis=0)
        noise = np.random.default_rng(int(shift[0])).normal(0, 1, grey.shape)
        return (
            np.repeat(np.rint(gaussian_filter(grey, 0.8) + noise)[:, :, None], 3, axis=2).clip(0, 255).astype(np.uint8)
        )

    found = track(view((0.0, 0.0)), view((1.0, -2.0)), {"dots": places})
    assert found.seen.all()
    np.testing.assert_allclose(found.shift_px, np.tile([1.0, -2.0], (len(places), 1)), atol=0.06)


def test_rings_have_no_shift_without_a_deviation():
    """A disc's fit to wide rings may end where its variance is negative: such shifts had a NaN for their deviation."""
    (x, y), places = np.meshgrid(np.arange(640), np.arange(480)), flat_layout(7, 5, 72.0, (103.5, 95.5))["red"]

    def rings(seed):
        away = np.min([np.hypot(x - a, y - b) for a, b in places + 0.4 * seed], axis=0)
        grey = 40.0 + 180.0 * (np.clip(20.5 - away, 0, 1) - np.clip(14.0 - away, 0, 1))
        noise = np.random.default_rng(seed).normal(0, 1, (480, 640, 3))
        return np.rint(gaussian_filter(grey, 1.0)[..., None] + noise).clip(0, 255).astype(np.uint8)

    found = track(rings(0), rings(1), {"rings": places})
    assert np.array_equal(found.seen, found.sd_px > 0)


@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize(("diameter", "line"), [(8.0, 1.0), (12.0, 1.5), (16.0, 3.0), (24.0, 2.0)])
def test_rings_are_found_and_measured(diameter, line, dark):
    """Of 32 kinds 25 were not found, as their middles are the ground's."""
    size, layout = (400, 340), {"rings": flat_layout(7, 6, 2.0 * diameter + 6.0, (40.0, 40.0))["red"]}
    motion = np.random.default_rng(3).uniform(-2.5, 2.5, layout["rings"].shape)
    pair = []
    for seed, moved in enumerate((0.0, motion)):
        outer, inner = (cover(size, layout["rings"] + moved, d, 0.7) for d in (diameter, diameter - 2.0 * line))
        share = (outer - inner)[..., None] * np.ones(3)
        pair.append(expose(200.0 - 160.0 * share if dark else 40.0 + 160.0 * share, seed))
    found = track(*pair, layout)
    assert found.seen.all()
    assert 0.6 < np.sqrt(np.mean(((found.shift_px - motion) / found.sd_px[:, None]) ** 2)) < 1.3
    assert np.median(found.sd_px) < 0.08


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_markers(count):
    layout = {"beads": np.array([[60.0, 50.0], [110.0, 52.0], [75.0, 95.0]])[:count]}
    pair = [expose(scene((160, 140), [(layout["beads"] + s, 1)], 10.0), i) for i, s in enumerate(([0, 0], [4, -3]))]
    found = track(*pair, layout)
    assert found.shift_px == pytest.approx(np.tile([4.0, -3.0], (count, 1)), abs=0.06)


@pytest.mark.parametrize("method", ["soft-window", "two-pass"])
@pytest.mark.parametrize("noise", [False, True])
def test_blank_pictures_yield_nothing(noise, method):
    blank, rest = np.full((SIZE[1], SIZE[0], 3), 30.0), picture(0.0, 1)
    blank = expose(blank, 5) if noise else blank.astype(np.uint8)
    for first, second in ((blank, blank), (rest, blank), (blank, rest)):
        found = track(first, second, LAYOUT, method=method)
        assert not found.seen.any()
        assert np.isnan(found.sd_px).all()
        assert first is rest or np.isnan(found.rest_px).all()


def test_order_and_results_are_fixed():
    rest, count = picture(0.0, 1), len(LAYOUT["red"])
    found, again = track(rest, rest, LAYOUT), track(rest, rest, {"blue": LAYOUT["blue"], "red": LAYOUT["red"]})
    assert list(dict.fromkeys(again.layer)) == ["blue", "red"]
    assert again.rest_px == pytest.approx(np.concatenate([found.rest_px[count:], found.rest_px[:count]]))
    with pytest.raises(ValueError, match="read-only"):
        found.shift_px[0] = 0


def test_a_picture_stretched_to_16_bits_has_the_same_shifts():
    pictures = picture(0.0, 1), picture(0.4, 2)
    one, two = track(*pictures, LAYOUT), track(*(p.astype(np.uint16) * 257 for p in pictures), LAYOUT)
    assert two.shift_px == pytest.approx(one.shift_px, abs=1e-4)
    assert two.sd_px == pytest.approx(one.sd_px, rel=1e-3)


def test_unusable_arguments():
    rest = picture(0.0, 1)
    for arguments, words in (
        ((rest / 255, rest, LAYOUT), "8 or 16"), ((rest, np.where(rest > 100, np.nan, rest), LAYOUT), "8 or 16"),
        ((rest, rest.astype(np.uint16), LAYOUT), "by 64"), ((rest, rest[:, : SIZE[0] // 2], LAYOUT), "mode"),
        ((rest, np.dstack([rest, rest[..., :1]]), LAYOUT), "channels"), ((rest, rest, {}), "no layers"),
        ((rest, rest, {"red": np.full((3, 2), np.nan)}), "finite"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            track(*arguments)
    for options, words in (({"diameter_px": -1.0}, "diameter_px"), ({"polarity": "up"}, "polarity"),
                           ({"method": "best"}, "method"), ({"channels": {"red": (1, 0, 0)}}, "channels")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            track(rest, rest, LAYOUT, **options)


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
    assert found.states[20] == "partly hidden"
    lost = track(rest, picture(shift, 3), LAYOUT)
    assert lost.states[30] == "missing"
    close = np.zeros_like(shift)
    close[40] = LAYOUT["red"][41] - LAYOUT["red"][40] - [0.0, 10.0]
    merged = track(rest, picture(close, 4), LAYOUT)
    assert "merged" in merged.states[[40, 41]]
    # The other layer has not moved, so the two are lost, and no more of their layer.
    assert np.flatnonzero(~merged.seen).tolist() == [40, 41]


@pytest.mark.parametrize("share", [0.1, 0.2, 0.35])
@pytest.mark.parametrize(
    ("diameter", "psf"), [(8.0, 0.7), (10.0, 0.7), pytest.param(15.0, 0.7, marks=pytest.mark.slow), (8.0, 1.3)]
)
def test_a_marker_partly_hidden_in_the_grounds_colour_is_measured_by_the_part_in_sight(diameter, psf, share):
    """The centre of the part in sight was stated as the marker's, up to 13 standard deviations off."""
    card, hidden = Card(diameter), np.arange(0, 143, 5)
    shift, drawn = card.shifts(3), card.draw(card.shifts(3), psf=psf)
    for marker, turn in zip(hidden, np.random.default_rng(4).uniform(0.0, 2 * np.pi, len(hidden)), strict=True):
        seen = lambda dx, dy, x, y, t=turn: dx * np.cos(t) + dy * np.sin(t) < diameter * (0.5 - share)  # noqa: E731
        centre = card.marks[marker : marker + 1] + shift[marker]
        whole, part = (cover(card.size, centre, diameter, psf, s) for s in (None, seen))
        drawn[..., 0 if marker < card.count else 2] += 130.0 * (part - whole)
    found = track(expose(card.draw(psf=psf), 1), expose(drawn, 2), card.layout)
    clear = np.setdiff1d(np.arange(143), hidden)
    assert found.seen[clear].all()
    assert (found.states[hidden] == "partly hidden").mean() > 0.9
    seen = hidden[found.seen[hidden]]
    assert len(seen) > 0.9 * len(hidden) or share == 0.35 or psf > 1.0
    error = (found.shift_px - shift)[seen]
    if len(seen):
        assert np.median(np.abs(error)) < 0.1
        assert np.sqrt(np.mean((error / found.sd_px[seen, None]) ** 2)) < 1.5
        assert (np.hypot(*error.T) < np.maximum(5 * found.sd_px[seen], 0.1)).all()


@pytest.mark.parametrize(("width", "seed", "kept"), [(10.0, 0, 0.4), (10.0, 2, 0.5), (10.0, 3, 0.25), (15.0, 0, 0.9)])
def test_a_marker_of_which_half_is_hidden_is_measured_by_the_other_half(width, seed, kept):
    """Spots of half a marker were taken for others: all were ambiguous (seed 2), or one was 1.2 px off (3)."""
    card, some = Card(width), np.arange(0, 143, 5)
    shift = card.shifts(10 + seed)
    drawn = hidden(card, card.draw(shift), shift, some, 0.5, seed)
    found = track(expose(card.draw(), 1), expose(drawn, 20 + seed), card.layout)
    assert np.delete(found.seen, some).all()
    assert (found.states[some] == "partly hidden").all()
    error, sd = (found.shift_px - shift)[some], found.sd_px[some, None]
    assert found.seen[some].mean() > kept
    assert np.nanmedian(np.abs(error)) < 0.04
    assert np.sqrt(np.nanmean((error / sd) ** 2)) < 1.2
    assert not (np.abs(error) > np.maximum(5 * sd, 0.05)).any()


@pytest.mark.parametrize(
    ("diameter", "psf", "area", "camera", "largest"),
    [
        (10.0, 1.6, 0.01, np.asarray, 1.8),
        (15.0, 1.6, 0.01, np.asarray, 1.5),
        (10.0, 1.6, 0.02, np.asarray, 1.3),
        (8.0, 1.6, 0.02, np.asarray, 1.8),
        (8.0, 0.7, 0.14, partial(jpeg, quality=60), 2.2),
        (15.0, 0.7, 0.31, partial(jpeg, quality=60), 1.05),
        (8.0, 0.7, 0.31, CAMERAS["both"], 2.4),
    ],
)
def test_what_hides_a_part_unfound_is_stated(diameter, psf, area, camera, largest):
    """Strips of blurred markers were off by 3.7 stated deviations, hidden parts under JPEG by 1.8 to 3.1."""
    card, some = Card(diameter), np.arange(0, 143, 5)
    shift = card.shifts(10)
    drawn = hidden(card, card.draw(shift, psf), shift, some, area, 0, psf)
    found = track(camera(expose(card.draw(psf=psf), 1)), camera(expose(drawn, 20)), card.layout)
    assert np.sqrt(np.nanmean(((found.shift_px - shift) / found.sd_px[:, None])[some] ** 2)) < largest


@pytest.mark.parametrize(("diameter", "largest"), [(6.0, 0.1), (10.0, 0.13), (15.0, 0.15)])
def test_centres_follow_little_of_a_shadow_that_moves_over_the_markers(diameter, largest):
    """A quarter of the light is missing left of an edge, in any direction: .116, .151 and .168 px, uncorrected."""
    card = Card(diameter)
    shift = card.shifts(3)

    def picture(moved, edge, seed):
        def shade(dx, dy, x, _y):
            return 1.0 - 0.25 * (dx * np.cos(x) + dy * np.sin(x) < edge * diameter)

        return expose(card.draw(moved, shade=shade), seed)

    found = track(picture(0.0, -0.4, 1), picture(shift, -0.1, 2), card.layout)
    error = found.shift_px - shift
    assert found.seen.all()
    assert np.sqrt(np.mean(error**2)) < largest
    assert np.sqrt(np.mean((error / found.sd_px[:, None]) ** 2)) < 1.8


def test_a_shadow_that_moves_over_a_marker_is_stated():
    """On one marker in three lies the edge of a shadow, which moves by up to 2 px between the pictures."""
    layout, size = wide(15.0)
    edge = np.linspace(-1.0, 1.0, 9)[np.arange(len(joined(layout))) % 9]

    def shadowed(moved, shift):
        def shade(dx, dy, x, y):
            number = int(np.hypot(*(joined(layout) + shift - (x, y)).T).argmin())
            across = dx * np.cos(number) + dy * np.sin(number) - 6.0 * edge[number] - moved[number]
            return 1.0 - 0.3 * (number % 3 == 0) * np.clip(0.5 + across / 6.0, 0.0, 1.0)

        return shade

    score, off = [], []
    for seed in range(3):
        random = np.random.default_rng(seed)
        moved, shift = random.uniform(-2.0, 2.0, len(edge)), random.uniform(-2.5, 2.5, (len(edge), 2))
        pair = [
            picture(s, seed, layout, size, 15.0, shade=shadowed(m, s), contrast=150.0)
            for s, m in ((0.0, 0.0 * moved), (shift, moved))
        ]
        found = track(*pair, layout)
        error = (found.shift_px - shift)[found.seen]
        score.append(error / found.sd_px[found.seen, None])
        off.append(np.abs(error) > 0.05)
        assert found.seen.mean() > 0.97
    score, off = np.concatenate(score), np.concatenate(off)
    assert np.sqrt((score**2).mean()) < 0.9  # 0.99, and one of them wrong, by third harmonics and sides alone
    assert not ((np.abs(score) > 5.0) & off).any()


@pytest.mark.parametrize("diameter", WIDTHS)
@pytest.mark.parametrize("change", [{"ratio": 1.3}, {"ratio": 1.8}, {"psf": 1.3}, {"psf": 2.0}], ids=str)
def test_strained_and_defocused_markers_are_kept_at_a_true_deviation(diameter, change):
    """They were lost, or stated 5 times too large."""
    card, shift = Card(diameter), Card(diameter).shifts(3)
    turned = stretches(len(card.marks), change.get("ratio", 1.0), np.random.default_rng(5))
    drawn = card.draw(shift, psf=change.get("psf", 0.7), stretch=turned)
    found = track(expose(card.draw(), 1), expose(drawn, 2), card.layout)
    assert found.seen.mean() >= 0.99
    assert (found.states == "strained").mean() > 0.9
    assert np.nanmedian(found.sd_px) < 0.03
    assert 0.8 < np.sqrt(np.nanmean(((found.shift_px - shift) / found.sd_px[:, None]) ** 2)) < 1.2


@pytest.mark.parametrize("diameter", [10.0, 24.0, pytest.param(44.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("ratio", "growth"), [(1.3, 1.0), (1.0, 1.18)])
def test_dark_dots_that_change_their_shape_are_kept_under_light_from_one_side(diameter, ratio, growth):
    """Of wide ones on a ground whose slope and noise the model lacked 98 of 100 passed for partly hidden."""
    card = Card(diameter)
    card.layout = {"dots": card.layout["red"]}
    card.marks = card.layout["dots"]
    width, height = card.size
    across, down = np.linspace(0, 1, width), np.linspace(0, 1, height)[:, None]
    light = 1.3 / (1 + ((across + 0.1) / 0.7) ** 2 + ((down - 0.1) / 1.2) ** 2)  # one lamp: 5 times darker far off
    stretch = growth * stretches(len(card.marks), ratio, np.random.default_rng(5))
    shift = np.random.default_rng(3).uniform(-3.5, 3.5, card.marks.shape)

    def dark(moved, stretch):
        covered = cover(card.size, card.marks + moved, diameter, 0.7, None, stretch)
        return (180 * (1 - 0.95 * covered) * light)[..., None] * np.ones(3)

    found = track(expose(dark(0.0, None), 1), expose(dark(shift, stretch), 2), card.layout)
    error = found.shift_px - shift
    assert found.seen.mean() > 0.89
    assert np.sqrt(np.nanmean(error**2)) < 0.008
    assert 0.4 < np.sqrt(np.nanmean((error / found.sd_px[:, None]) ** 2)) < 1.2


def uneven(diameter, rough, hides=None):
    """Return prints with an outline of their own each; where ``hides`` is true of the place a quarter is hidden."""

    def shade(dx, dy, x, y):
        first, angle = np.random.default_rng(round(1000 * x + y)), np.arctan2(dy, dx)
        edge, turn = first.normal(0, rough, (4, 2)), first.uniform(0, 2 * np.pi)
        waves = sum(e[0] * np.cos(k * angle) + e[1] * np.sin(k * angle) for k, e in enumerate(edge, 2))
        seen = np.hypot(dx, dy) < 0.46 * diameter * (1 + waves)
        if hides is not None and hides(x + y):
            seen = seen & (dx * np.cos(turn) + dy * np.sin(turn) < 0.25 * diameter)
        return 1.5 * seen

    return shade


@pytest.mark.parametrize(("diameter", "rough"), [(10.0, 0.05), (12.0, 0.05), (12.0, 0.08)])
def test_uneven_prints_do_not_pass_for_partly_hidden(diameter, rough):
    """A second picture at rest: one fit trusted all pixels, the other none that miss, so that 2 in 100 were refused."""
    card, shade = Card(diameter), uneven(diameter, rough)
    found = track(expose(card.draw(shade=shade), 1), expose(card.draw(shade=shade), 7), card.layout)
    assert found.seen.all()
    assert 0.8 < np.sqrt(np.mean((found.shift_px / found.sd_px[:, None]) ** 2)) < 1.25


@pytest.mark.parametrize("diameter", [10.0, 12.0])
def test_very_uneven_prints_that_are_partly_hidden_have_no_wrong_shift(diameter):
    """What they lack by themselves was taken for hidden: of 48 one to three were off by five stated deviations."""

    def third(place):
        return np.rint((place + 1) / 30) % 3 == 0

    card = Card(diameter)
    rest, later = (card.draw(shade=uneven(diameter, 0.09, h)) for h in (None, third))
    found = track(expose(rest, 1), expose(later, 7), card.layout)
    hidden = third(card.marks.sum(axis=1))
    assert found.seen[~hidden].mean() > 0.98
    assert found.seen[hidden].any()
    assert np.nanmax(np.abs(found.shift_px) / found.sd_px[:, None]) < 5


@pytest.mark.parametrize(
    ("diameter", "wave", "camera"),
    [(24, 0.02, None)] + [pytest.param(*one, marks=pytest.mark.slow) for one in ((24, 0.02, jpeg), (40, 0.03, None))],
)
def test_wide_dots_with_rough_outlines(diameter, wave, camera):
    """Strained, in other light: by ellipses a third had no shift, and one in ten was off by five deviations."""
    marks = (np.stack(np.meshgrid(np.arange(7), np.arange(6), indexing="ij"), -1).reshape(-1, 2) + 0.9) * 1.7 * diameter
    waves = np.random.default_rng(diameter).normal(0.0, wave, (len(marks), 7, 2))
    size, strain = (round(13.2 * diameter), round(11.5 * diameter)), np.array([[1.05, 0.02], [-0.03, 0.97]])
    hidden = np.arange(len(marks)) % 7 == 1
    shift = (marks - marks.mean(axis=0)) @ (strain - np.eye(2)).T + [1.3, -0.7]

    def drawn(moved, stretch, light, hides, seed):
        def rough(dx, dy, x, y):
            marker = int(np.hypot(*(marks + moved - [x, y]).T).argmin())
            back = np.linalg.inv(stretch)
            u, v = back[0, 0] * dx + back[0, 1] * dy, back[1, 0] * dx + back[1, 1] * dy
            turns = np.exp(1j * np.arange(2, 9) * np.arctan2(v, u)[..., None])
            seen = np.hypot(u, v) < diameter * (
                0.5 + 0.5 * (turns.real @ waves[marker, :, 0] + turns.imag @ waves[marker, :, 1])
            )
            return seen & (dx < 0.25 * diameter) if hides and hidden[marker] else seen

        across = 1.0 - light * np.arange(size[0])[None, :, None] / size[0]
        grey = (190.0 - 140.0 * cover(size, marks + moved, 1.6 * diameter, 0.8, rough))[..., None]
        picture_ = expose(grey * across * np.ones(3), seed)
        return picture_ if camera is None else camera(picture_)

    rest = drawn(0.0, np.eye(2), 0.0, False, 1)
    found = track(rest, drawn(shift, strain, 0.3, True, 2), {"dots": marks})
    score = (found.shift_px - shift)[~hidden] / found.sd_px[~hidden, None]
    assert found.seen[~hidden].mean() > 0.97
    assert (found.states[hidden] == "partly hidden").all()
    assert np.sqrt(np.nanmean(score**2)) < 1.4
    assert np.nanmedian(found.sd_px[~hidden]) < (0.02 if camera is None else 0.04)
    assert np.abs(track(rest, rest, {"dots": marks}).shift_px).max() < 1e-6


def test_squares_behind_a_lens_are_no_ellipses():
    """Their outline has no third harmonic: by ellipses they were .14 px off, and one in four by five deviations."""

    def square(dx, dy, x, y):
        return np.clip(0.5 + 10.0 * (11.0 - np.fmax(np.abs(dx), np.abs(dy))), 0.0, 1.0)

    card = Card(32.0)
    shift = 0.02 * (card.marks - card.marks.mean(axis=0)) + [0.4, -0.3]
    found = track(expose(card.draw(shade=square), 1), expose(card.draw(shift, shade=square), 2), card.layout)
    error = found.shift_px - shift
    assert found.seen.all()
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.sqrt(np.mean((error / found.sd_px[:, None]) ** 2)) < 1.5


def test_a_strained_marker_that_is_partly_hidden_does_not_pass_for_a_smaller_one():
    card = Card(10.0)
    shift, random = card.shifts(3), np.random.default_rng(5)
    drawn, turned = card.draw(shift, stretch=stretches(len(card.marks), 1.4, random)), stretches(1, 1.4, random)
    for marker in range(0, len(card.marks), 9):
        seen = lambda dx, dy, x, y, turn=marker: dx * np.cos(turn) + dy * np.sin(turn) < 3.5  # noqa: E731
        centre = card.marks[marker : marker + 1] + shift[marker]
        channel = 0 if marker < card.count else 2
        around = drawn[:, :, channel]
        near = (np.abs(np.indices(around.shape)[::-1] - centre[0][:, None, None]) < 14).all(axis=0)
        around[near] = 30 + 130 * cover(card.size, centre, 10.0, 0.7, seen, turned)[near]
    found = track_frame(analyse_rest(expose(card.draw(), 1), card.layout), expose(drawn, 2), shift + 0.5)
    hidden = np.arange(len(card.marks)) % 9 == 0
    score = np.hypot(*(found.shift_px - shift).T) / found.sd_px
    assert found.seen[~hidden].mean() > 0.98
    assert (found.states[hidden] == "partly hidden").mean() > 0.9
    assert np.nanmax(score[~hidden]) < 5
    assert np.nanmax(score[hidden], initial=0.0) < 5


def of_rows(image, seed):
    """Noise that is the same for a whole row."""
    return expose(image + np.random.default_rng(seed).normal(0.0, 3.0, (len(image), 1, 1)), seed)


def with_hot_pixels(image, seed):
    hot = np.random.default_rng(7).random(image.shape) < 1e-3
    return np.where(hot, 255, expose(image, seed)).astype(np.uint8)


def in_other_light(image, seed):
    """The lamp stands to the right at rest, and below later."""
    height, width = image.shape[:2]
    light = np.linspace(0.5, 1.5, width)[:, None] if seed == 1 else np.linspace(0.5, 1.5, height)[:, None, None]
    return expose(image * light, seed)


def of_a_mosaic(image, seed):
    return mosaic(expose(image, seed))


@pytest.mark.parametrize(
    ("camera", "diameter", "largest"),
    [
        (of_rows, 10.0, 0.04),
        (with_hot_pixels, 10.0, 0.01),
        (in_other_light, 10.0, 0.013),
        (of_a_mosaic, 6.0, 0.04),
        (of_a_mosaic, 10.0, 0.024),
    ],
)
def test_noise_of_rows_hot_pixels_and_other_light_are_stated(camera, diameter, largest):
    """Ratios were 1.6 and 3.4, hot pixels lost a layer; a mosaic at 10 px .042 px off, by interpolated pixels."""
    card = Card(diameter)
    rest = analyse_rest(camera(card.draw(), 1), card.layout)
    shifts = [card.shifts(seed) for seed in (3, 4, 5)]
    found = [track_frame(rest, camera(card.draw(s), 20 + i)) for i, s in enumerate(shifts)]
    error = np.concatenate([f.shift_px - s for f, s in zip(found, shifts, strict=True)])
    score = error / np.concatenate([f.sd_px for f in found])[:, None]
    assert np.isfinite(error).mean() > 0.99
    assert np.sqrt(np.nanmean(error**2)) < largest
    assert 0.65 < np.sqrt(np.nanmean(score**2)) < 1.3


@pytest.mark.parametrize("diameter", [3.5, 4.5])
def test_small_dots_of_a_mosaic_state_what_coarse_edges_do_not_show(diameter):
    """Some were off by 6.4 and 5.3 stated deviations: seven pixels of an edge show no third harmonic."""
    card = Card(diameter)
    rest = analyse_rest(of_a_mosaic(card.draw(), 1), card.layout)
    for seed, step in enumerate(((1.3, -0.7), (-2.1, 0.4), (0.6, 2.3))):
        shift = np.array(step) + 0.01 * (card.marks - card.marks.mean(axis=0))
        found = track_frame(rest, of_a_mosaic(card.draw(shift), 20 + seed))
        score = (found.shift_px - shift)[found.seen] / found.sd_px[found.seen, None]
        assert found.seen.mean() > 0.95
        assert np.abs(score).max() < 5
        assert np.sqrt(np.mean(score**2)) < 1.3


@pytest.mark.parametrize("width", [3.0, 8.0])
@pytest.mark.parametrize(
    ("moved", "stays", "largest"), [((0, 0), True, 0.01), ((3, -2), True, 0.032), ((3, -2), False, 0.01)]
)
def test_grained_ground_states_a_true_deviation(width, moved, stays, largest):
    """Four to ten times the error was stated, and as much where nothing had moved, or the grains with the markers."""
    card = Card(10.0)
    rest = expose(card.draw(grain=card.grain(5.0, width)), 1)
    grain = card.grain(5.0, width, (0, 0) if stays else moved)
    found = track(rest, expose(card.draw(np.array(moved), grain=grain), 2), card.layout)
    error = found.shift_px - moved
    assert found.seen.mean() > 0.99
    assert np.sqrt(np.nanmean(error**2)) < largest
    assert 0.65 < np.sqrt(np.nanmean((error / found.sd_px[:, None]) ** 2)) < 1.2


@pytest.mark.parametrize(("gain", "ground", "least"), [(0.6, 0.0, 0.7), (1.5, 0.0, 0.7), (2.2, 20.0, 0.4)])
def test_brighter_and_darker_pictures_state_a_true_deviation(gain, ground, least):
    """Also where the ground becomes as bright as the other layer's markers were, and markers saturate."""
    card, shift = Card(10.0), Card(10.0).shifts(3)
    shown = expose(card.draw(shift, gain=gain) + gain * ground, 2)
    found = track(expose(card.draw() + ground, 1), shown, card.layout)
    assert found.seen.all()
    assert least < np.sqrt(np.mean(((found.shift_px - shift) / found.sd_px[:, None]) ** 2)) < 1.3


def test_strange_spots_are_told_and_taken_for_no_marker():
    extra = {"red": np.vstack([LAYOUT["red"], [[58.0, 40.0]]]), "blue": LAYOUT["blue"]}
    drawn = expose(scene(SIZE, [(extra["red"], 0), (extra["blue"], 2)], 10.0), 5)
    found = track(picture(0.0, 1), drawn, LAYOUT)
    assert found.spurious_px is not None
    assert np.abs(found.spurious_px - [58.0, 40.0]).max(axis=1).min() < 0.5
    assert np.nanmax(np.abs(found.shift_px)) < 0.1


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
        warm, cold = tracker.track(frames[number]), track_frame(tracker.rest, frames[number])
        assert (warm.spurious_px is None) == (place > 0)
        assert warm.shift_px == pytest.approx(cold.shift_px, abs=0.003)


@pytest.mark.parametrize("psf", [0.7, 1.6])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_rest_picture_itself_shows_no_motion_at_all(psf, seed):
    rest = picture(0.0, seed, psf=psf)
    tracker = Tracker(rest, LAYOUT)
    for _ in range(3):
        assert (tracker.track(rest).shift_px == 0.0).all()


@pytest.mark.parametrize("polarity", ["bright", "dark"])
def test_dots_that_touch_the_frame_are_measured(polarity):
    layout = {"dots": flat_layout()["red"] + [-35.5, 0.0]}  # the first column's edge is the frame's
    moved = [0.0, 1.3]

    def drawn(shift, seed):
        image = expose(scene((300, 290), [(layout["dots"] + shift, 1)], 10.0), seed)[..., 1]
        return image if polarity == "bright" else 255 - image

    found = track(drawn(0.0, 1), drawn(moved, 2), layout)
    assert found.seen.all()
    assert (np.abs(found.shift_px - moved) < 5.0 * found.sd_px[:, None]).all()


@pytest.mark.parametrize("crop", [0, 1])
def test_an_h264_film_states_a_true_deviation(crop):
    """Errors were .05 (red) and .16 px (blue), up to 3.8 times those stated; a tenth was off unnoticed."""
    card = Card(10.0)
    phase = card.marks[:, ::-1] / [80.0, 90.0]
    shifts = [1.5 * np.stack([np.sin(phase[:, 0] + n), np.cos(phase[:, 1])], -1) for n in range(2)]
    shifts.append(card.shifts(3))
    first, *later = film([expose(card.draw(s), i) for i, s in enumerate([0.0, *shifts])])
    layout = {name: places - crop for name, places in card.layout.items()}
    tracker = Tracker(first[crop:, crop:], layout)
    for frame, shift in zip(later, shifts, strict=True):
        tracker.forget()
        found = tracker.track(frame[crop:, crop:])
        error = found.shift_px - shift
        assert found.seen.mean() > 0.98
        assert np.sqrt(np.nanmean(error**2)) < 0.08
        assert 0.35 < np.sqrt(np.nanmean((error / found.sd_px[:, None]) ** 2)) < 1.4
        assert not (np.abs(error) > np.maximum(5 * found.sd_px[:, None], 0.05)).any()


def test_a_grey_film_is_known_by_the_blocks_that_it_repeats():
    """Errors were 3.5 times those stated; pictures under JPEG by themselves, a still one, and those of a camera without
    noise are no film."""
    card = Card(10.0)
    shifts = [
        0.3 * n * np.stack([np.sin(card.marks[:, 1] / 80.0), np.cos(card.marks[:, 0] / 90.0)], -1) for n in range(5)
    ]
    white = [np.repeat(expose(card.draw(s), i).max(axis=2, keepdims=True), 3, axis=2) for i, s in enumerate(shifts)]
    frames = [np.repeat(p[:, :, 1:2], 3, axis=2) for p in film(white, "2M")]
    tracker = Tracker(frames[0], {"white": card.marks})
    found = [tracker.track(frame) for frame in frames[1:]]
    assert tracker.rest.film
    score = np.concatenate([(f.shift_px - s) / f.sd_px[:, None] for f, s in zip(found[1:], shifts[2:], strict=True)])
    assert 0.4 < np.sqrt(np.nanmean(score**2)) < 1.6
    fading = np.indices(white[0].shape)[1] // 40  # a ground so dark that its noise is rounded away
    dark = [jpeg(np.where(p < 80, fading, p).astype(np.uint8)) for p in white]
    grained = [card.draw(s, grain=card.grain(8.0, 12.0)) for s in shifts]
    dim = [jpeg((20 + 0.75 * expose(p, i)).astype(np.uint8), 60) for i, p in enumerate(grained)]
    clean = [np.rint(card.draw(s)).astype(np.uint8).max(axis=2) for s in shifts]
    for pictures in ([jpeg(p) for p in white], dark, dim, [white[0]] * 3, clean):
        alone = Tracker(pictures[0], {"white": card.marks})
        for picture_ in pictures[1:]:
            alone.track(picture_)
        assert not alone.rest.film


def test_markers_that_the_frame_cuts_and_that_fit_no_outline_are_left_out():
    """Once refused at rest, they divided by zero later."""
    card = Card(10.0, 0.33 / 3.0)

    def flat(dx, dy, x, y):
        return np.hypot(dx, dy * (1.3 if min(x, y) < 8.0 else 1.0)) < 4.6

    rest = analyse_rest(expose(card.draw(shade=flat), 1), card.layout)
    known = np.isfinite(rest.rest_px[:, 0])
    assert 0.02 < 1.0 - known.mean() < 0.2
    found = track_frame(rest, expose(card.draw(0.5, shade=flat), 2), np.zeros_like(rest.rest_px))
    assert found.seen[known].all()
    assert not found.seen[~known].any()


@pytest.mark.parametrize("diameter", WIDTHS)
@pytest.mark.parametrize("margin", [0.33, 0.15])
def test_markers_cut_by_the_frame_are_kept_at_a_true_deviation(diameter, margin):
    """They were dropped, all of them."""
    card = Card(diameter, margin * diameter / max(30.0, 2.3 * diameter))
    shift = np.random.default_rng(3).uniform(-1.0, 1.0, card.marks.shape)
    near = (np.minimum(card.marks, np.array(card.size) - card.marks) < 0.6 * diameter).any(axis=1)
    rest = expose(card.draw(), 1)
    found = track(rest, expose(card.draw(shift), 2), card.layout)
    assert found.seen.mean() > 0.99
    assert (found.states[near] == "partly hidden").mean() > 0.9
    for rows in (near, ~near):
        chi = np.sqrt(np.nanmean(((found.shift_px - shift)[rows] / found.sd_px[rows, None]) ** 2))
        assert 0.3 < chi < 1.3
    assert np.nanmax(np.abs(track(rest, rest, card.layout).shift_px)) == 0.0


def test_markers_leave_the_picture_and_come_back():
    card = Card(10.0, 0.23)
    tracker = Tracker(expose(card.draw(), 1), card.layout)
    leaving = card.marks[:, 0] < 10.0
    for number, away in enumerate((-4.0, -8.0, -13.0, -8.0, -4.0, 0.0)):
        found = tracker.track(expose(card.draw([away, 1.0]), 2 + number))
        assert found.seen[~leaving].all()
        assert found.seen[leaving].all() == (away > -13.0)
        assert (np.abs(found.shift_px - [away, 1.0]) < 5.0 * found.sd_px[:, None])[found.seen].all()


HARD = {
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


def test_what_is_gone_cropped_or_covered_is_lost_and_nothing_else():
    """Half of the markers, half of the picture, and a finger that crosses its edge."""
    rest, (x, y) = picture(0.0, 1), joined(LAYOUT).T
    gone = np.random.default_rng(1).random(len(x)) < 0.5
    found = track(rest, picture(np.where(gone[:, None], np.nan, 0.7), 3), LAYOUT)
    assert (found.seen == ~gone).all()
    half, crossed = picture(0.7, 2), picture(0.7, 2)
    half[:, : SIZE[0] // 2] = 30
    crossed[60:, 200:] = 120
    for image, clear, covered in (
        (half, x + 0.7 > SIZE[0] / 2 + 6, x < SIZE[0] / 2 - 6),
        (crossed, (x < 190) | (y < 50), (x > 206) & (y > 66)),
    ):
        found = track(rest, image, LAYOUT)
        assert found.seen[clear].all()
        assert not found.seen[covered].any()


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
