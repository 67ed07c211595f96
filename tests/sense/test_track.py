import numpy as np
import pytest
from marker_pictures import centre_bound_px, clean_picture, expose, flat_layout, render

from twin.errors import InputError
from twin.sense.track import analyse_rest, track, track_frame

FLAT = ((300, 240), flat_layout(9, 7), 10.0)
FINGER = ((500, 400), flat_layout(7, 5, 70.0, (45.0, 45.0)), 15.0)


def joined(layout):
    return np.concatenate(list(layout.values()))


def shaken(layout, by, seed):
    random = np.random.default_rng(seed)
    return {name: points + random.uniform(-by, by, points.shape) for name, points in layout.items()}


def bumped(layout, size, depth, width, middle):
    """Smooth motion of largest size ``size`` px: a shift under a bump plus a radial part."""
    moved = {}
    for name, points in layout.items():
        away = points - middle
        bell = np.exp(-0.5 * (away**2).sum(axis=1) / width**2)[:, None]
        moved[name] = size * bell * ([0.9, 0.435] if depth is None else away / width * depth)
    return moved


@pytest.mark.parametrize(("sensor", "shading"), [(FLAT, 0.0), (FLAT, 0.25), (FINGER, 0.0), (FINGER, 0.4)])
def test_shift_noise_and_bias(sensor, shading):
    """Re-rendered random sub-pixel shifts: bias, spread against the Cramer-Rao bound, and the stated sd."""
    size, layout, diameter = sensor
    actual = shaken(layout, 0.5, 1)
    errors, stated, rest_errors = [], [], []
    for draw in range(3):
        random = np.random.default_rng(50 + draw)
        shift = {name: random.uniform(-3, 3, points.shape) for name, points in layout.items()}
        rest = render(actual, {}, size=size, diameter=diameter, shading=shading, seed=2 * draw)
        pressed = render(actual, shift, size=size, diameter=diameter, shading=shading, seed=2 * draw + 1)
        found = track(rest, pressed, layout)
        assert found.seen.all()
        errors.append(found.shift_px - joined(shift))
        rest_errors.append(found.rest_px - joined(actual))
        stated.append(found.sd_px)
    error = np.concatenate(errors)
    spread = np.sqrt(np.mean(error.var(axis=0)))
    assert np.abs(error.mean(axis=0)).max() <= 0.01
    assert np.abs(np.concatenate(rest_errors).mean(axis=0)).max() <= 0.01
    bound = np.sqrt(2) * centre_bound_px(diameter)
    saturated = shading > 0.27  # the bright side reaches 255 counts
    assert 0.85 * bound < spread < (1.6 if saturated else 1.25) * bound
    stated_px = np.concatenate(stated)[:, None]
    assert np.mean((error / stated_px) ** 2) == pytest.approx(1.0, abs=0.4 if saturated else 0.25)


def test_soft_window_beats_the_papers_cells():
    size, layout, diameter = FLAT
    shift = {name: np.full(points.shape, 2.37) for name, points in layout.items()}
    rest = render(layout, {}, size=size, diameter=diameter, seed=1)
    pressed = render(layout, shift, size=size, diameter=diameter, seed=2)
    spread = {}
    for method in ("soft-window", "two-pass"):
        found = track(rest, pressed, layout, method=method)
        assert found.seen.all()
        assert np.abs(np.mean(found.shift_px - 2.37, axis=0)).max() < 0.05
        spread[method] = np.std(found.shift_px)
    assert spread["soft-window"] < 0.75 * spread["two-pass"]
    assert spread["two-pass"] < 0.3


def test_a_row_step_is_a_row_step():
    size, layout, diameter = FLAT
    shift = {name: np.tile([0.0, -3.0], (len(points), 1)) for name, points in layout.items()}
    rest, up = (render(layout, s, size=size, diameter=diameter, seed=i) for i, s in enumerate(({}, shift)))
    found = track(rest, up, layout)
    assert np.median(found.shift_px, axis=0) == pytest.approx([0.0, -3.0], abs=0.02)


@pytest.mark.parametrize("kind", ["bump", "radial", "uniform"])
def test_half_pitch_motion_is_matched(kind):
    layout = flat_layout(13, 11)
    size = (480, 400)
    middle = np.array([220.0, 190.0])
    if kind == "uniform":
        shift = {name: np.tile([12.0, -9.0], (len(points), 1)) for name, points in layout.items()}
    else:
        shift = bumped(layout, 15.0, 1.6 if kind == "radial" else None, 70.0, middle)
    actual = shaken(layout, 1.0, 2)
    rest = render(actual, {}, size=size, diameter=10, seed=1)
    clear = _unhidden(actual, shift, 13.0)
    found = track(rest, render(actual, shift, size=size, diameter=10, seed=2), layout)
    assert found.seen[clear].all()
    error = np.linalg.norm(found.shift_px - joined(shift), axis=1)
    assert np.nanmax(error) < 0.5
    assert np.nanmax(error[clear]) < 0.15


def _unhidden(layout, shift, apart):
    """Markers that stay apart from the other layer's."""
    moved = {name: points + shift[name] for name, points in layout.items()}
    red, blue = moved["red"], moved["blue"]
    gap = np.linalg.norm(red[:, None] - blue[None], axis=2)
    return np.concatenate([gap.min(axis=1), gap.min(axis=0)]) > apart


def test_layout_may_be_off_by_shift_scale_and_tilt():
    size, layout, diameter = FLAT
    middle = np.array([150.0, 120.0])
    turn = np.deg2rad(1.0)
    map_ = 1.01 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    actual = {name: (points - middle) @ map_.T + middle + [5.0, -4.0] for name, points in layout.items()}
    found = track(*(render(actual, {}, size=size, diameter=diameter, seed=i) for i in (1, 2)), layout)
    assert np.nanmax(np.abs(found.rest_px - joined(actual))) < 0.1
    assert found.seen.all()


def test_missing_markers_are_flagged_and_none_invented():
    size, layout, diameter = FLAT
    shift = bumped(layout, 10.0, None, 60.0, np.array([150.0, 120.0]))
    gone = np.zeros(len(joined(layout)), bool)
    gone[[5, 6, 24, 31, 80, 81, 100]] = True
    never = np.zeros_like(gone)
    never[[0, 40, 90]] = True
    names = list(layout)
    cuts = np.cumsum([len(p) for p in layout.values()])[:-1]

    def without(which):
        points = joined(layout).copy()
        points[which] = np.nan
        return dict(zip(names, np.split(points, cuts), strict=True))

    rest = render(without(never), {}, size=size, diameter=diameter, seed=1)
    pressed = render(without(gone | never), shift, size=size, diameter=diameter, seed=2)
    found = track(rest, pressed, layout)
    assert np.isnan(found.rest_px[never]).all()
    assert not found.seen[gone | never].any()
    assert np.isnan(found.sd_px[gone]).all()
    assert found.seen[~gone & ~never].mean() > 0.97
    error = np.linalg.norm(found.shift_px - joined(shift), axis=1)
    assert np.nanmax(error) < 0.5


def test_dimmed_and_merged_markers_are_lost():
    size, layout, diameter = FLAT
    rest = render(layout, {}, size=size, diameter=diameter, seed=1)
    picture = render(layout, {}, size=size, diameter=diameter)
    column, row = layout["red"][10].astype(int)
    spot = (slice(row - 8, row + 9), slice(column - 8, column + 9))
    picture[spot] = 8 + 0.12 * (picture[spot] - 8)
    merging = {name: np.zeros_like(points) for name, points in layout.items()}
    merging["red"][30] = [0.0, 22.0]
    found = track(rest, expose(picture, 2), layout)
    assert not found.seen[10]
    assert found.seen.sum() == len(found.seen) - 1
    merged = track(rest, render(layout, merging, size=size, diameter=diameter, seed=3), layout)
    assert not merged.seen[30]
    assert not merged.seen[31]


def test_covered_markers_are_lost_or_doubted():
    """A red marker slides over a blue one: the blue's cut outline must not pass as motion."""
    size, layout, diameter = FLAT
    slide = {name: np.zeros_like(points) for name, points in layout.items()}
    slide["red"][24] = [9.0, 9.0]
    rest = render(layout, {}, size=size, diameter=diameter, seed=1)
    found = track(rest, render(layout, slide, size=size, diameter=diameter, seed=2), layout)
    error = np.linalg.norm(found.shift_px - joined(slide), axis=1)
    assert (~(error > 5 * found.sd_px)).all()
    assert found.seen.sum() >= len(found.seen) - 2


def test_colours_are_told_apart_by_the_layout_not_the_name():
    size, layout, diameter = FLAT
    rest = render(layout, {}, size=size, diameter=diameter, seed=1)
    swapped = {"red": layout["blue"], "blue": layout["red"]}
    found = track(rest, rest, swapped)
    assert found.channels["red"][2] > 0.5 > found.channels["red"][0]
    assert found.channels["blue"][0] > 0.5 > found.channels["blue"][2]
    assert np.nanmax(np.abs(found.rest_px - joined(swapped))) < 0.1
    assert found.seen.all()


def test_wrong_channels_find_nothing_rather_than_something():
    size, layout, diameter = FLAT
    rest = render(layout, {}, size=size, diameter=diameter, seed=1)
    given = {"red": (1.0, 0.0, -1.0), "blue": (-1.0, 0.0, 1.0)}
    assert track(rest, rest, layout, channels=given).seen.all()
    plain = {"red": (1.0, 0.0, 0.0), "blue": (0.0, 0.0, 1.0)}
    assert track(rest, rest, layout, channels=plain).seen.all()


def test_dark_markers_on_bright_ground():
    size, layout, diameter = FLAT
    negative = [255 - render(layout, {}, size=size, diameter=diameter, seed=i) for i in (1, 2)]
    for polarity in (None, "dark"):
        found = track(*negative, layout, polarity=polarity)
        assert found.seen.all()
        assert np.nanmax(np.abs(found.rest_px - joined(layout))) < 0.1


def test_one_grey_layer():
    layout = {"beads": flat_layout(9, 7)["red"]}
    grey = [
        expose(clean_picture((300, 240), [(layout["beads"], (180.0,) * 3)], diameter=10), i)[..., 1] for i in (1, 2)
    ]
    found = track(*grey, layout)
    assert found.seen.all()
    assert np.nanstd(found.shift_px) < 0.03


def test_two_layers_in_a_grey_picture():
    size, layout, diameter = FLAT
    grey = [
        expose(clean_picture(size, [(p, (180.0,) * 3) for p in layout.values()], diameter=diameter), i)[..., 1]
        for i in (1, 2)
    ]
    found = track(*grey, layout)
    assert found.seen.all()
    assert np.nanmax(np.abs(found.rest_px - joined(layout))) < 0.1


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_markers(count):
    layout = {"beads": np.array([[60.0, 50.0], [110.0, 52.0], [75.0, 95.0]])[:count]}
    moved = layout["beads"] + [4.0, -3.0]
    pictures = [expose(clean_picture((160, 140), [(p, (180.0,) * 3)], diameter=10), i)
                for i, p in enumerate((layout["beads"], moved))]  # fmt: skip
    found = track(*pictures, layout)
    assert found.shift_px == pytest.approx(np.tile([4.0, -3.0], (count, 1)), abs=0.06)


@pytest.mark.parametrize("method", ["soft-window", "two-pass"])
@pytest.mark.parametrize("noise", [False, True])
def test_blank_pictures_yield_nothing(noise, method):
    size, layout, diameter = FLAT
    blank = np.full((size[1], size[0], 3), 8.0)
    blank = expose(blank, 5) if noise else blank.astype(np.uint8)
    rest = render(layout, {}, size=size, diameter=diameter, seed=1)
    for first, second in ((blank, blank), (rest, blank), (blank, rest)):
        found = track(first, second, layout, method=method)
        assert not found.seen.any()
        assert np.isnan(found.sd_px).all()
    assert np.isnan(track(blank, blank, layout, method=method).rest_px).all()


def test_a_sequence_starts_from_the_previous_picture():
    size, layout, diameter = FLAT
    rest = analyse_rest(render(layout, {}, size=size, diameter=diameter, seed=0), layout)
    start = None
    for frame in range(1, 6):
        shift = {name: np.tile([7.0 * frame, 0.0], (len(points), 1)) for name, points in layout.items()}
        inside = joined(layout)[:, 0] + 7.0 * frame < size[0] - 10
        picture = render(layout, shift, size=size, diameter=diameter, seed=frame)
        found = track_frame(rest, picture, start)
        start = found.shift_px
        assert found.seen[inside].all()
        assert np.nanmax(np.abs(found.shift_px - [7.0 * frame, 0.0])) < 0.2


def test_order_and_results_are_fixed():
    size, layout, diameter = FLAT
    rest = render(layout, {}, size=size, diameter=diameter, seed=1)
    turned = {"blue": layout["blue"], "red": layout["red"]}
    found, again = track(rest, rest, layout), track(rest, rest, turned)
    assert list(dict.fromkeys(again.layer)) == ["blue", "red"]
    assert again.rest_px == pytest.approx(np.concatenate([found.rest_px[63:], found.rest_px[:63]]))
    with pytest.raises(ValueError, match="read-only"):
        found.shift_px[0] = 0


def test_unusable_arguments():
    size, layout, diameter = FLAT
    picture = render(layout, {}, size=size, diameter=diameter, seed=1)
    for arguments, words in (
        (((picture / 255), picture, layout), "8-bit"),
        ((picture, picture[:-2], layout), "camera mode"),
        ((picture, picture, {}), "no layers"),
        ((picture, picture, {"red": np.full((3, 2), np.nan)}), "finite"),
    ):
        with pytest.raises(InputError, match=words):
            track(*arguments)
    for options, words in (({"diameter_px": -1.0}, "diameter_px"), ({"polarity": "up"}, "polarity"),
                           ({"method": "best"}, "method"), ({"channels": {"red": (1, 0, 0)}}, "channels")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            track(picture, picture, layout, **options)
