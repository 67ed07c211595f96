"""Tracking of strained, blurred, hidden, cut, uneven and drawn markers."""

from functools import partial

import numpy as np
import pytest
from drawn import LAYOUT, SIZE, WIDTHS, flat_layout, joined, picture
from scipy.ndimage import gaussian_filter

from benchmarks.conditions import Card, hidden, jpeg, stretches
from benchmarks.discs import cover, expose, scene
from twin import Sensor, load_scene
from twin.sense.track import Tracker, analyse_rest, track


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


@pytest.mark.parametrize(("diameter", "shade", "most_px"), [(10.0, 0.0, 0.04), (6.0, 0.0, 0.08), (10.0, 0.4, 0.08)])
def test_a_marker_behind_another_layer_does_not_follow_it_unstated(diameter, shade, most_px):
    """Blue dots, some in a shade of their own, before red ones that move otherwise. Markers behind were .10 px off (10
    px wide, chi 1.4 to 2.4), those in front stated .03 px though nothing hides them."""
    stated, errors = [], []
    pitch = 2.9 * diameter
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(7), indexing="ij"), -1).reshape(-1, 2) * pitch + 2 * diameter
    size = (int(pitch * 8 + 4 * diameter), int(pitch * 6 + 4 * diameter))

    def drawn(rear, front):
        red, blue = cover(size, rear, 0.95 * diameter, 0.7), cover(size, front, diameter, 0.7)
        lit = 1.0 - shade * np.clip(cover(size, front, 1.25 * diameter, 1.4), 0.0, 1.0)
        whole = np.full((*size[::-1], 3), 12.0)
        whole[..., 0] += 150.0 * red * (1.0 - blue) * lit
        whole[..., 2] += 150.0 * blue
        return whole

    for seed in range(2):
        random = np.random.default_rng(seed)
        rear = grid + random.uniform(-0.5, 0.5, grid.shape)
        angle, away = random.uniform(0, 2 * np.pi, len(grid)), random.uniform(0.3, 1.1, len(grid)) * diameter
        front = grid + np.stack([np.cos(angle), np.sin(angle)], -1) * away[:, None]
        moved = random.uniform(-0.6, 0.6, (2, 1, 2))
        found = track(
            expose(drawn(rear, front), 2 * seed),
            expose(drawn(rear + moved[0], front + moved[1]), 2 * seed + 1),
            {"red": rear, "blue": front},
        )
        errors.append((found.shift_px.reshape(2, -1, 2) - moved)[..., None])
        stated.append(found.sd_px.reshape(2, -1))
    error, sd = np.concatenate(errors, axis=1)[..., 0], np.concatenate(stated, axis=1)
    assert np.isfinite(sd).mean(axis=1) == pytest.approx([1.0, 1.0], abs=0.2)
    rms = np.sqrt(np.nanmean(error**2, axis=(1, 2)))
    chi = np.sqrt(np.nanmean((error / sd[..., None]) ** 2, axis=(1, 2)))
    assert rms[0] < most_px
    assert chi[0] < 1.4
    assert rms[1] < 0.16 / diameter
    assert chi[1] < 1.2
    assert np.nanmedian(sd[1]) < 0.16 / diameter


@pytest.mark.parametrize("seed", [2, 7])
def test_strained_markers_of_which_another_layer_leaves_a_rim_doubt_shapes_that_move_them(seed):
    """Up to 1.4 px off at 39 standard deviations: the rim left in sight, and not the marker, was an ellipse."""
    random, size = np.random.default_rng(seed), (420, 330)
    sites = np.stack(np.meshgrid(np.arange(14), np.arange(11), indexing="ij"), axis=-1).reshape(-1, 2) * 28.0
    sites += np.array([28.0, 25.0])
    red = sites + random.uniform(-0.5, 0.5, sites.shape)
    most, turn = random.uniform(size=len(red)) < 0.3, random.uniform(0.0, 2 * np.pi, len(red))
    away = np.where(most, random.uniform(2.0, 3.4, len(red)), random.uniform(6.0, 12.0, len(red)))
    blue = sites + np.column_stack([np.cos(turn), np.sin(turn)]) * away[:, None]

    def drawn(red, blue, stretch=None):
        behind, hides = cover(size, red, 9.0, 0.7, stretch=stretch), cover(size, blue, 10.0, 0.7)
        shadow = 1.0 - 0.4 * np.clip(cover(size, blue + np.array([1.5, 1.0]), 12.0, 1.5), 0.0, 1.0)
        whole = np.full((*behind.shape, 3), 12.0)
        whole[..., 0] += 150.0 * behind * (1.0 - hides) * shadow
        whole[..., 2] += 150.0 * hides
        return whole

    stretch = np.tile(stretches(1, 1.2, random), (len(red), 1, 1))
    shift = np.array([-0.3, 0.3])
    pair = (drawn(red, blue), drawn(red + shift, blue + shift / 3, stretch))
    found = track(*(expose(one, seed + k) for k, one in enumerate(pair)), {"red": red, "blue": blue})
    strained = np.flatnonzero(found.states[: len(red)] == "strained")
    assert len(strained) > 40
    score = (found.shift_px[strained] - shift) / found.sd_px[strained, None]
    assert np.sqrt(np.mean(score**2)) < 1.5
    assert np.abs(score).max() < 7.0


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
    [(12, 0.03, None), (24, 0.02, None)]
    + [pytest.param(*one, marks=pytest.mark.slow) for one in ((24, 0.02, jpeg), (40, 0.03, None))],
)
def test_dots_with_rough_outlines(diameter, wave, camera):
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


def test_triangles_behind_a_lens_are_not_drawn_sharp_and_do_not_pass_for_stretched_where_a_part_is_hidden():
    """An ellipse's blur of them is too small. So the centroid of all their light was taken: 4 px off in a shadow."""
    marks = flat_layout(8, 6, 34.0, (30.0, 30.0))["red"]
    size, shift, hidden = (298, 230), np.array([0.7, -0.4]), np.arange(len(marks)) % 5 == 2

    def drawn(moved, light, hides, seed):
        def triangle(dx, dy, x, y):
            inside = np.max([dx * np.cos(a) + dy * np.sin(a) for a in np.deg2rad([80, 200, 320])], axis=0) < 5.0
            marker = int(np.hypot(*(marks + moved - [x, y]).T).argmin())
            return inside & (dx < 2.5) if hides and hidden[marker] else inside

        across = 1.0 - light / (1.0 + np.exp((size[0] / 2 - np.arange(size[0])) / 12.0))[None, :, None]
        grey = (150.0 - 125.0 * cover(size, marks + moved, 26.0, 0.7, triangle))[..., None]
        return expose(grey * across * np.ones(3), seed)

    found = track(drawn(0.0, 0.0, False, 1), drawn(shift, 0.4, True, 2), {"dots": marks})
    error = np.hypot(*(found.shift_px - shift).T)
    assert found.seen[~hidden].mean() > 0.97
    assert np.sqrt(np.nanmean(error[~hidden] ** 2)) < 0.04
    assert np.nanmax(error / found.sd_px) < 5
    assert np.nanmax(error[hidden], initial=0.0) < 0.3


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
    found = Tracker.motion(analyse_rest(expose(card.draw(), 1), card.layout), expose(drawn, 2), shift + 0.5)
    hidden = np.arange(len(card.marks)) % 9 == 0
    score = np.hypot(*(found.shift_px - shift).T) / found.sd_px
    assert found.seen[~hidden].mean() > 0.98
    assert (found.states[hidden] == "partly hidden").mean() > 0.9
    assert np.nanmax(score[~hidden]) < 5
    assert np.nanmax(score[hidden], initial=0.0) < 5


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


def test_markers_that_the_frame_cuts_and_that_fit_no_outline_are_left_out():
    """Once refused at rest, they divided by zero later."""
    card = Card(10.0, 0.33 / 3.0)

    def flat(dx, dy, x, y):
        return np.hypot(dx, dy * (1.3 if min(x, y) < 8.0 else 1.0)) < 4.6

    rest = analyse_rest(expose(card.draw(shade=flat), 1), card.layout)
    known = np.isfinite(rest.rest_px[:, 0])
    assert 0.02 < 1.0 - known.mean() < 0.2
    found = Tracker.motion(rest, expose(card.draw(0.5, shade=flat), 2), np.zeros_like(rest.rest_px))
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
