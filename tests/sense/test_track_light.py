"""Tracking in light that differs or changes, shadows, glints, noise that hangs together, and colours of layers."""

import numpy as np
import pytest
from drawn import LAYOUT, SIZE, flat_layout, joined, picture, wide
from scipy.ndimage import gaussian_filter

from benchmarks.conditions import Card, mosaic
from benchmarks.discs import bound_px, cover, expose, scene
from twin.sense.track import Tracker, analyse_rest, track


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


def test_hot_pixels_are_no_layers_colour():
    """Two dyes on bright ground: the colour farthest from all others was a hot pixel's, and a layer was lost."""
    random, pair = np.random.default_rng(0), []
    hot = (random.integers(0, SIZE[1], 100), random.integers(0, SIZE[0], 100), random.integers(0, 3, 100))
    for seed in range(2):
        red, green = (cover(SIZE, p + 0.4 * seed, 10.0, 0.7)[..., None] for p in LAYOUT.values())
        image = expose(200.0 - np.array([10, 140, 145]) * red - np.array([160, 110, 140]) * green, seed)
        image[hot] = 250
        pair.append(image)
    found = track(*pair, LAYOUT)
    assert found.seen.mean() > 0.97
    np.testing.assert_allclose(np.nanmedian(found.shift_px, axis=0), [0.4, 0.4], atol=0.02)


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
        (of_rows, 10.0, 0.01),
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
    found = [Tracker.motion(rest, camera(card.draw(s), 20 + i)) for i, s in enumerate(shifts)]
    error = np.concatenate([f.shift_px - s for f, s in zip(found, shifts, strict=True)])
    score = error / np.concatenate([f.sd_px for f in found])[:, None]
    assert np.isfinite(error).mean() > 0.99
    assert np.sqrt(np.nanmean(error**2)) < largest
    assert 0.65 < np.sqrt(np.nanmean(score**2)) < 1.3


@pytest.mark.parametrize(
    ("share", "period_px", "darker"), [(0.12, 45.0, 0.0), (0.04, 70.0, 0.0), (0.0, 45.0, 0.0), (0.12, 110.0, 22.0)]
)
def test_bands_of_a_light_that_flickers_move_no_marker(share, period_px, darker):
    """A rolling shutter: .1 px off, 2.3 times what was stated, a tenth of the markers unnoticed; where the ground is
    too dark to show bands, so much until the markers themselves did."""
    card, score = Card(10.0), []

    def lit(image, phase, seed):
        bands = 1.0 + share * np.sin(2 * np.pi * np.arange(len(image)) / period_px + phase)
        return expose(bands[:, None, None] * (image - darker), seed)

    rest = lit(card.draw(), 0.0, 1)
    tracker = Tracker(rest, card.layout)
    assert (tracker.rest.flaws.ground is None) == (share == 0.0 or darker > 0.0)
    assert (tracker.track(rest).shift_px == 0.0).all()
    assert not tracker.track(np.zeros_like(rest)).seen.any()
    tracker.forget()
    for seed in range(2, 5):
        shift = 3.0 * np.sin(card.marks[:, ::-1] / [80.0, 90.0] + seed)
        found = tracker.track(lit(card.draw(shift), 1.7 * seed, seed))
        assert found.seen.mean() > 0.99
        assert np.nanstd(found.shift_px - shift) < 0.013
        score.append((found.shift_px - shift) / found.sd_px[:, None])
    assert 0.5 < np.sqrt(np.nanmean(np.square(score))) < 1.3


def test_strong_bands_hide_no_dark_dots():
    """Not a marker was found at rest, so no bare ground either that shows the bands."""
    axes = np.arange(18.0, 306.0, 22.0), np.arange(18.0, 226.0, 22.0)
    first = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    layout = {"red": first, "blue": first[(first < [295, 215]).all(axis=1)] + 11.0}
    row, column = (np.mgrid[0:960, 0:1280] - 1.5) / 4

    def lit(shift, phase, seed):
        light = np.ones((960, 1280, 3))
        for name, dark in (("red", (0.7, 0.2, 0.1)), ("blue", (0.1, 0.3, 0.75))):
            for x, y in layout[name] + shift:
                near = np.s_[int(4 * y) - 20 : int(4 * y) + 20, int(4 * x) - 20 : int(4 * x) + 20]
                light[near] -= (np.hypot(column[near] - x, row[near] - y) < 4.0)[..., None] * dark
        light = gaussian_filter(light.reshape(240, 4, 320, 4, 3).mean(axis=(1, 3)), (0.7, 0.7, 0.0))
        light *= 120.0 + 24.0 * np.sin(2 * np.pi * np.arange(240) / 70 + phase)[:, None, None]
        return np.rint(light + np.random.default_rng(seed).normal(0, 1.2, light.shape)).clip(0, 255).astype(np.uint8)

    found = track(lit(0.0, 0.0, 1), lit([1.3, -0.8], 2.1, 2), layout)
    assert found.seen.all()
    error = found.shift_px - [1.3, -0.8]
    assert np.sqrt(np.mean(error**2)) < 0.04
    assert np.sqrt(np.mean(np.square(error / found.sd_px[:, None]))) < 1.3


@pytest.mark.parametrize("diameter", [3.5, 4.5])
def test_small_dots_of_a_mosaic_state_what_coarse_edges_do_not_show(diameter):
    """Some were off by 6.4 and 5.3 stated deviations: seven pixels of an edge show no third harmonic."""
    card = Card(diameter)
    rest = analyse_rest(of_a_mosaic(card.draw(), 1), card.layout)
    for seed, step in enumerate(((1.3, -0.7), (-2.1, 0.4), (0.6, 2.3))):
        shift = np.array(step) + 0.01 * (card.marks - card.marks.mean(axis=0))
        found = Tracker.motion(rest, of_a_mosaic(card.draw(shift), 20 + seed))
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


def test_two_colours_on_bright_ground_are_seen_where_light_falls_to_a_fifth():
    """The ground of the far end showed as the other layer, which hid a quarter of the markers."""
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(7), indexing="ij"), -1).reshape(-1, 2) * 38.0 + 24.0
    layout = {"red": grid, "green": grid + 19.0}
    x = np.linspace(-1.0, 1.0, 410)
    light = np.exp(-0.8 * (x + 1.0))[None, :, None]

    def drawn(shift):
        whole = np.full((300, 410, 3), 200.0)
        for places, dye in zip(layout.values(), ([190.0, 60.0, 50.0], [40.0, 90.0, 60.0]), strict=True):
            share = cover((410, 300), places + shift, 11.0, 0.7)[..., None]
            whole = whole * (1.0 - share) + share * np.array(dye)
        return whole * light

    found = track(expose(drawn(0.0), 0), expose(drawn(np.array([0.7, -0.5])), 1), layout)
    error = found.shift_px - [0.7, -0.5]
    whole = (found.rest_px > 8.0).all(axis=1) & (found.rest_px < [401.0, 291.0]).all(axis=1)
    inside = (np.concatenate(list(layout.values())) < [401.0, 291.0]).all(axis=1)
    assert found.seen[inside].mean() > 0.98
    assert np.sqrt(np.nanmean((error / found.sd_px[:, None])[whole] ** 2)) < 1.3


def test_wide_dots_are_found_where_light_falls_off_to_a_quarter():
    """All were missing: what vignetting left of the ground passed for bright markers."""
    grid = np.stack(np.meshgrid(np.arange(7), np.arange(5), indexing="ij"), -1).reshape(-1, 2) * 55.0 + 32.0
    y, x = np.mgrid[-1.0:1.0:284j, -1.0:1.0:394j]
    light = (1.0 - 0.36 * (x**2 + y**2))[..., None]
    pair = [
        expose((150.0 - 125.0 * cover((394, 284), grid + shift, 25.0, 0.7)[..., None]) * light * np.ones(3), seed)
        for seed, shift in enumerate((0.0, [0.8, -0.6]))
    ]
    found = track(*pair, {"dots": grid})
    error = found.shift_px - [0.8, -0.6]
    assert found.seen.all()
    assert np.sqrt((error**2).mean()) < 0.008
    assert np.sqrt(np.mean((error / found.sd_px[:, None]) ** 2)) < 1.3
