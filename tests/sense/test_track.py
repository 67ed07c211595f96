"""Tracking on pictures by area sampling: the bound, stated variances, other centroids, and what can not be used."""

import numpy as np
import pytest
from drawn import LAYOUT, SIZE, joined, picture, wide

from benchmarks.conditions import Card, jpeg
from benchmarks.discs import bound_px, expose, scene
from twin.errors import InputError
from twin.sense.track import Tracker, track


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
        ((rest, rest, {"red": 9000 + LAYOUT["red"]}), "outside the picture of"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            track(*arguments)
    for options, words in (({"diameter_px": -1.0}, "diameter_px"), ({"polarity": "up"}, "polarity"),
                           ({"method": "best"}, "method"), ({"channels": {"red": (1, 0, 0)}}, "channels")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            track(rest, rest, LAYOUT, **options)


def test_strange_spots_are_told_and_taken_for_no_marker():
    extra = {"red": np.vstack([LAYOUT["red"], [[58.0, 40.0]]]), "blue": LAYOUT["blue"]}
    drawn = expose(scene(SIZE, [(extra["red"], 0), (extra["blue"], 2)], 10.0), 5)
    found = track(picture(0.0, 1), drawn, LAYOUT)
    assert found.spurious_px is not None
    assert np.abs(found.spurious_px - [58.0, 40.0]).max(axis=1).min() < 0.5
    assert np.nanmax(np.abs(found.shift_px)) < 0.1


@pytest.mark.parametrize("psf", [0.7, 1.6])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_rest_picture_itself_shows_no_motion_at_all(psf, seed):
    rest = picture(0.0, seed, psf=psf)
    tracker = Tracker(rest, LAYOUT)
    for _ in range(3):
        assert (tracker.track(rest).shift_px == 0.0).all()


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
