"""Markers of pictures whose grids are known are found, numbered, and told from dirt; other pictures are refused.

Drawn by `benchmarks.discs`, which knows nothing of the program's renderer.
"""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import twin
from benchmarks.discs import cover, expose
from twin.errors import InputError

SIZE = (400, 300)
STEPS = {"square": np.eye(2), "hexagonal": np.array([[1, 0], [0.5, np.sqrt(0.75)]])}


def grid(
    lattice="square", pitch=26.0, angle=0.0, bend=0.0, lean=0.0, missing=0.0, jitter=0.0, middle=(0.0, 0.0), room=1e3
):
    """Sites (n, 2) and centres, px, of a grid seen askew (lean) through a lens that bends it towards the middle."""
    rng = np.random.default_rng(2)
    count = int(600 / pitch)
    sites = np.stack(np.meshgrid(*[np.arange(-count, count + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    turn = np.radians(angle)
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    places = sites @ STEPS[lattice] @ turned * pitch / 200 + np.asarray(middle) / 200
    places = places / (1 + lean * places[:, 1:])
    radius = np.linalg.norm(places, axis=1)
    keep = (radius < 1.4) & (bend * radius**2 < 0.17) & (rng.random(len(sites)) >= missing)
    places = places * (1 - bend * radius**2)[:, None] * 200 + (np.array(SIZE) - 1) / 2
    places += rng.normal(0, jitter * pitch, places.shape)
    keep &= ((places > -4) & (places < np.array(SIZE) + 3)).all(axis=1)
    keep &= np.hypot(*(places - [200, 150]).T) < room - 9
    return sites[keep], places[keep]


def drawn(places, diameter=10.0, dark=True, dirt=0, fading=0.0, psf=0.8, room=1e3):
    """The picture, black beyond ``room`` px from its middle."""
    rng = np.random.default_rng(3)
    share = cover(SIZE, places, diameter, psf)
    for _ in range(dirt):
        share += cover(SIZE, rng.uniform(10, 290, (1, 2)), diameter * rng.uniform(0.2, 1.7), psf)
    share = np.minimum(share, 1.0)
    light = 170.0 - 120.0 * share if dark else 30.0 + 130.0 * share
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    away = np.hypot(column - 200, row - 150)
    light *= (1 - fading * away**2 / 250**2) * (0.03 + 0.97 / (1 + np.exp(np.clip(away - room, -50, 50))))
    return expose(np.repeat(light[..., None], 3, axis=2), 1)


def whole(places, diameter=10.0):
    return ((places > diameter / 2 - 0.5) & (places < np.array(SIZE) - 0.5 - diameter / 2)).all(axis=1)


def numbers_follow(layer, sites, spot):
    """Whether columns and rows are the sites' up to one turn and shift."""
    index = np.array(layer.index)
    if layer.lattice == "hexagonal":
        index[:, 0] -= index[:, 1] // 2
    design = np.column_stack([sites[spot], np.ones(len(spot))])
    change, *_ = np.linalg.lstsq(design, index.astype(float), rcond=None)
    return np.abs(design @ change - index).max() < 1e-6 and abs(abs(np.linalg.det(change[:2])) - 1) < 1e-6


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"angle": 45.0},
        {"angle": 20.0, "missing": 0.3, "jitter": 0.02},
        {"bend": 0.25, "angle": 12.0},
        {"lean": 0.3, "angle": 33.0},
        {"lattice": "hexagonal", "angle": 17.0, "bend": 0.15, "missing": 0.2},
        {"lattice": "hexagonal", "lean": 0.2},
        {"jitter": 0.05},
        {"room": 130.0, "angle": 20.0, "pitch": 22.0},
    ],
)
def test_every_whole_dot_is_found_and_none_else(options):
    sites, places = grid(**options)
    (layer,) = twin.find_layout(drawn(places, fading=0.4, room=options.get("room", 1e3))).layers.values()
    off, spot = cKDTree(places).query(layer.centre_px)
    assert off.max() < 1.0
    assert len(set(spot)) == len(spot)
    assert not (set(np.flatnonzero(whole(places))) - set(spot))
    assert numbers_follow(layer, sites, spot)
    assert layer.lattice == options.get("lattice", "square")
    assert layer.polarity == "dark"
    assert layer.diameter_px == pytest.approx(10, rel=0.06)
    if not {"bend", "lean"} & set(options):
        assert layer.pitch_px == pytest.approx(options.get("pitch", 26), rel=0.01)
        turn = 90 if layer.lattice == "square" else 60
        assert (layer.angle_deg - options.get("angle", 0) + turn / 2) % turn == pytest.approx(turn / 2, abs=0.3)


def test_dots_by_hand_are_numbered_and_their_scatter_is_stated():
    sites, places = grid(jitter=0.12, angle=10.0)
    (layer,) = twin.find_layout(drawn(places)).layers.values()
    off, spot = cKDTree(places).query(layer.centre_px)
    assert off.max() < 1.0
    assert len(layer) > 0.98 * whole(places).sum()
    assert numbers_follow(layer, sites, spot)
    assert layer.scatter_px / layer.pitch_px == pytest.approx(0.12, rel=0.2)


def test_bright_dots_of_any_width():
    for diameter, pitch in ((5.0, 16.0), (24.0, 60.0)):
        _, places = grid(pitch=pitch)
        (layer,) = twin.find_layout(drawn(places, diameter, dark=False)).layers.values()
        assert (layer.polarity, len(layer)) == ("bright", int(whole(places, diameter).sum()))


def test_dirt_is_left_out():
    _, places = grid(missing=0.1)
    found = twin.find_layout(drawn(places, dirt=15))
    (layer,) = found.layers.values()
    off, _ = cKDTree(places).query(layer.centre_px)
    assert (off > 3).sum() <= 1
    assert len(found.stray_px) >= 5
    assert len(layer) > 0.9 * whole(places).sum()


def test_specks_do_not_hide_larger_dots():
    """Of 250 specks without order more lie on some lattice by chance than there are dots."""
    _, places = grid(pitch=48.0)
    specks = np.random.default_rng(4).uniform(5, [395, 295], (250, 2))
    share = np.maximum(cover(SIZE, places, 30.0, 0.8), np.minimum(cover(SIZE, specks, 4.0, 0.8), 1.0))
    (layer,) = twin.find_layout(expose(np.repeat(170.0 - 120.0 * share[..., None], 3, axis=2), 1)).layers.values()
    off, spot = cKDTree(places).query(layer.centre_px)
    assert off.max() < 1.5
    assert set(spot) == set(np.flatnonzero(whole(places, 30.0)))


def test_two_colours_are_two_layers_that_the_tracker_takes():
    _, red = grid(pitch=30.0, angle=5.0)
    _, blue = grid(pitch=28.0, angle=5.0, middle=(14.0, 14.0))
    picture = np.full((SIZE[1], SIZE[0], 3), 30.0)
    moved = np.array(picture)
    for channel, places in ((0, red), (2, blue)):
        picture[..., channel] += 130 * cover(SIZE, places, 8.0, 0.7)
        moved[..., channel] += 130 * cover(SIZE, places + np.array([1.5, -0.7]), 8.0, 0.7)
    rest = expose(picture, 1)
    found = twin.find_layout(rest)
    assert set(found.layers) == {"red", "blue"}
    for name, places in (("red", red), ("blue", blue)):
        off, spot = cKDTree(places).query(found.layers[name].centre_px)
        assert off.max() < 2.0, "where the other colour covers a part"
        assert not (set(np.flatnonzero(whole(places, 8.0))) - set(spot))
    tracked = twin.track(rest, expose(moved, 2), found.layout_px)
    assert tracked.seen.mean() > 0.9
    np.testing.assert_allclose(np.nanmedian(tracked.shift_px, axis=0), [1.5, -0.7], atol=0.02)


def test_pictures_without_a_grid_are_refused_with_the_cause():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="shows no dots"):
        twin.find_layout(expose(np.full((300, 400, 3), 120.0), 1))
    with pytest.raises(InputError, match="shows 3 dots"):
        twin.find_layout(drawn(rng.uniform(30, 270, (3, 2))))
    with pytest.raises(InputError, match=r"form no lattice.* give twin\.track their places"):
        twin.find_layout(drawn(rng.uniform(10, 290, (90, 2))))
    with pytest.raises(InputError, match="32x32"):
        twin.find_layout(np.zeros((20, 20, 3), np.uint8))


@pytest.mark.parametrize("count", [12, 20, 40, 100])
def test_dots_without_order_are_never_a_grid(count):
    places = np.random.default_rng(count).uniform(8, 292, (count, 2))
    with pytest.raises(InputError):
        twin.find_layout(drawn(places, 8.0))
