"""How centres are measured: spots, the paper's cells, and the compiled fit; each against the same done plainly."""

from __future__ import annotations

import numpy as np
import pytest
from drawn import flat_layout
from scipy.ndimage import map_coordinates, spline_filter

from benchmarks.discs import cover, expose, scene
from twin.sense.centre import Look
from twin.sense.colour import Flaws
from twin.sense.detect import Blobs
from twin.sense.paper_centroid import PaperCentroid
from twin.sense.shape_fit import NORMAL_MEDIAN, OwnPictures, compare_pictures
from twin.sense.template import CENTRE, DIMS_PX, IMPERFECT, LANES, OUTLIER_SD, disc, gather
from twin.sense.track import Tracker, analyse_rest


def test_markers_wider_than_the_picture_take_no_memory() -> None:
    """Windows as wide as the markers are made: at 1e6 px they were larger than any machine's memory."""
    signal = np.zeros((60, 80), np.float32)
    signal[25:36, 35:46] = 100
    assert len(Blobs.found_in(signal, 1e6, 10.0)) == len(Blobs.found_in(signal, 80.0, 10.0))


def cells(picture, starts, cell_px, weights, ground, least):
    """Centroids of the paper's cells around ``starts``, px."""
    shown = {"weights": weights, "floor_dn": 0.0, "ground_dn": ground, "contrast_dn": least, "diameter_px": 10.0}
    spots, nominal = Blobs.found_in(picture[..., 0] * 1.0, 10.0, 1e9), np.array(starts, float)
    look = Look(rows=np.arange(len(nominal)), nominal_px=nominal, picture_px=(1, 1), blobs=spots, **shown)
    (found,) = PaperCentroid.at_rest(picture, [look], cell_px, True)
    return found.around.rest_px


@pytest.mark.parametrize(("weights", "off_px"), [((1.0, 0.125, -0.875), 1e-10), ((1.0, 0.1, -0.9), 2e-5)])
@pytest.mark.parametrize("half", [1, 7, 8, 30, 50])
def test_centroids_are_those_of_plain_sums_up_to_every_border(half: int, weights, off_px: float) -> None:
    """Singles hold eighths of a count exactly; other weights are rounded."""
    rng = np.random.default_rng(half)
    picture = rng.integers(0, 256, (70, 83, 3), dtype=np.uint8)
    picture[:, :60][rng.random((70, 60)) > 0.03] = 0  # few pixels move a cell far
    starts = np.concatenate([rng.uniform(0, (82, 69), (40, 2)), [[0, 0], [82, 69], [0, 69], [82, 0], [75, 68]]])
    starts = np.concatenate([starts, [[82.0 + half, 30.0], [83.0 + half, 30.0], [-1.0 - half] * 2]])
    found = cells(picture, starts, 2.0 * half, weights, 20.0, 1.0)
    assert np.isnan(found[-2:]).all()
    signal = np.maximum(picture @ np.array(weights) - 20.0, 0.0)
    for at, centroid in zip(starts[:-2], found[:-2], strict=True):
        for _ in range(2):
            column, row = np.rint(at).astype(int)
            rows = np.arange(max(row - half, 0), min(row + half, 69) + 1)
            columns = np.arange(max(column - half, 0), min(column + half, 82) + 1)
            cell = signal[np.ix_(rows, columns)]
            if cell.max() < 1.0:
                at = np.full(2, np.nan)
                break
            at = np.array([(cell.sum(axis=0) * columns).sum(), (cell.sum(axis=1) * rows).sum()]) / cell.sum()
        np.testing.assert_allclose(centroid, at, rtol=0.0, atol=off_px)


def test_an_empty_cell_and_an_unknown_place_show_nothing() -> None:
    picture = np.full((40, 40, 3), 100, np.uint8)
    picture[5, 5] = 180, 100, 20
    found = cells(picture, [[6.0, 4.0], [30.0, 30.0], [np.nan, 5.0]], 8, (1.0, 0.0, -1.0), 0.0, 50.0)
    np.testing.assert_allclose(found[0], [5.0, 5.0])
    assert np.isnan(found[1:]).all()


@pytest.mark.parametrize("others", [0, 1, 2])
@pytest.mark.parametrize("radius", [2.3, 7.86, 8.0, 17.2])
def test_pixels_are_projected_and_uncovered_as_written_down(radius, others):
    """Row by row, or one by one at the picture's border, against NumPy: pixels beside those where another layer shows
    are as bright as without the share that it covers."""
    image = np.random.default_rng(3).integers(0, 256, (60, 70, 3), dtype=np.uint8)
    limits = np.array([[0.5, 0.25, 0.0, 150.0, 20.0, 0.003], [0.0, -1.0, 1.0, 170.0, -30.0, 0.002]], np.float32)[
        :others
    ]
    offset, runs, _ = disc(int(radius**2))
    signal, use = np.zeros((2, offset.shape[1] + LANES), np.float32)
    own = np.array([1.0, -0.25, 0.5, 3.0], np.float32)
    sites = np.array([[1.0, 0.0], [0.0, 1.0]] if others else np.ones((2, 2)), np.float32)
    within = offset[0] < 1000
    for column in range(0, 70, 3):
        for row in range(0, 60, 3):
            gather(image, tuple(own), limits, sites, column, row, offset, runs, signal, use)
            x, y = column + offset[0, within], row + offset[1, within]
            inside = (x >= 0) & (y >= 0) & (x < 70) & (y < 60)
            pixels = image[np.where(inside, y, 0), np.where(inside, x, 0)].astype(float)
            hidden = inside & (pixels @ limits[:, :3].T > limits[:, 3]).any(axis=1)
            apart = np.abs(x[:, None] - x[hidden]), np.abs(y[:, None] - y[hidden])
            beside = (np.maximum(*apart) <= DIMS_PX).any(axis=1)
            bright = pixels @ own[:3] - own[3]
            for other in limits:
                cover = np.fmax((pixels @ other[:3] - other[4]) * other[5], 0.0)
                bright = np.where(beside, bright / (1.0 - cover), bright)
            seen = inside & ~hidden & (sites[y % 2, x % 2] > 0)
            np.testing.assert_array_equal(use[: offset.shape[1]][within] > 0, seen)
            np.testing.assert_allclose(signal[: offset.shape[1]][within][seen], bright[seen], rtol=1e-5, atol=1e-3)


def test_markers_lead_those_after_them():
    """A step of half a marker's width is followed from the last places alone, also next to lost markers, the very first
    one included; and markers that have moved by more than their width are found by those before, which moved less."""
    layout, step = flat_layout(), np.array([4.8, -3.6])

    def picture(shift, seed, lost=()):
        red, blue = np.delete(layout["red"], lost, axis=0), layout["blue"]
        return expose(scene((340, 300), [(red + shift(red), 0), (blue + shift(blue), 2)], 10.0), seed)

    tracker, image = Tracker(picture(np.zeros_like, 0), layout), picture(lambda at: step, 2, lost=[0, 33])
    tracker.track(picture(np.zeros_like, 1))
    found = tracker.track(image)
    assert found.spurious_px is None
    assert np.flatnonzero(~found.seen).tolist() == [0, 33]
    np.testing.assert_allclose(found.shift_px[found.seen], np.tile(step, (len(found.seen) - 2, 1)), atol=0.06)

    def stretched(at):
        return np.array([12.0, 0.0]) * (at[:, :1] - 40) / 270

    group, image = tracker.rest.groups[0], picture(stretched, 2)
    goal = layout["red"] + stretched(layout["red"])
    led, alone = (group.templates.fit(image, group.start_px, lead)[:, :2] for lead in (group.around.lead, None))
    np.testing.assert_allclose(led, goal, atol=0.06)
    assert (np.abs(alone - goal) < 0.06).all(axis=1).mean() < 0.8


@pytest.mark.parametrize("size", [(40, 30), (41, 31), (2, 1)])
@pytest.mark.parametrize("first", [(0, 0), (1, 0), (1, 1)])
def test_repeated_colours_are_those_of_plain_shares(size, first):
    """Of the four pixels that meet at a corner of blocks: 9, 3, 3 and 1 sixteenth of the colour."""
    picture = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    mended = Flaws(blocks=first, bad=(np.zeros(0, int),) * 3).mended(picture)
    bright = (picture.astype(int) @ [77, 150, 29] >> 8)[..., None]
    colour = picture - bright
    for axis, begin in enumerate(first[::-1]):
        place = np.arange(size[axis])
        beside = np.clip(place + np.where((place - begin) % 2, 1, -1), 0, size[axis] - 1)
        colour = 3 * colour + np.take(colour, beside, axis)
    np.testing.assert_array_equal(mended, np.clip(bright + (colour + 8 >> 4), 0, 255))


def test_rough_dots_are_fitted_each_by_itself():
    """All took the steps of the one that settled last: three in five were in vain."""
    random, marks = np.random.default_rng(2), 20.0 + 30.0 * np.mgrid[0:5, 0:2].reshape(2, -1).T
    waves = random.normal(0.0, 0.05, (len(marks), 5, 2))

    def drawn(moved, seed):
        def rough(dx, dy, x, y):
            marker = int(np.hypot(*(moved - [x, y]).T).argmin())
            turns = np.exp(1j * np.arange(3, 8) * np.arctan2(dy, dx)[..., None])
            return np.hypot(dx, dy) < 7.0 * (1 + turns.real @ waves[marker, :, 0] + turns.imag @ waves[marker, :, 1])

        grey = 190.0 - 140.0 * cover((160, 70), moved, 22.0, 0.8, rough)
        return expose(np.repeat(grey[..., None], 3, axis=2), seed)

    (group,) = analyse_rest(drawn(marks, 1), {"dots": marks}).groups
    own, templates = group.pictures, group.templates
    picture = drawn(marks + random.uniform(-1.0, 1.0, marks.shape), 2)
    fitted = templates.fit(picture, templates.rest[:, CENTRE].copy())
    fitted[0, CENTRE] += 3.0  # takes more steps
    assert len(own.rows) == len(marks)

    def centres(some):
        terms = [of_blur[some] for of_blur in own.terms]
        part = OwnPictures(rows=own.rows[some], place=own.place[some], use=own.use[some], terms=terms)
        part.fit(picture, templates, found := fitted.copy(), group.around)
        return found[own.rows[some], CENTRE]

    alone = np.concatenate([centres(slice(k, k + 1)) for k in range(len(marks))])
    np.testing.assert_allclose(centres(slice(None)), alone, rtol=0.0, atol=1e-9)


def test_own_pictures_are_compared_as_with_plain_splines_and_products_also_beyond_the_frame():
    random = np.random.default_rng(3)
    view, shown = random.normal(100.0, 20.0, (40, 50)), random.random((40, 50)) > 0.1
    centre, warp = np.array([[25.0, 20.0], [2.0, 3.0], [48.0, 38.0]]), np.eye(2) + random.normal(0.0, 0.05, (3, 2, 2))
    aside, use = random.uniform(-15.0, 15.0, (3, 400, 2)), random.random((3, 400)) > 0.1
    terms, light = random.normal(0.0, 1.0, (3, 400, 11)).astype(np.float32), random.normal(0.0, 1.0, (3, 5))
    noise, level, astray = np.full(3, 40.0), np.full(3, 50.0), np.full(3, 3.0)
    used, (left, trust), scale, sums = np.zeros_like(use), np.zeros((2, 3, 400)), np.ones(3), np.empty((3, 12, 11))
    knots, go = spline_filter(view), np.arange(3)
    known, fit, errors = (aside, use, terms), (warp, centre, light), (noise, level, astray)
    compare_pictures(knots, shown, go, known, fit, errors, (used, left, trust), scale, sums)

    place = aside @ warp.swapaxes(1, 2) + centre[:, None]
    column, row = np.rint(place).astype(int).transpose(2, 0, 1)
    inside = (column >= 0) & (column < 50) & (row >= 0) & (row < 40)
    assert not inside.all()
    counts = use & inside & shown[np.clip(row, 0, 39), np.clip(column, 0, 49)]
    np.testing.assert_array_equal(used, counts)
    off = map_coordinates(knots, place.transpose(2, 0, 1)[::-1], prefilter=False, mode="nearest")
    off -= np.einsum("kmi,ki->km", terms[:, :, 6:], light)
    usual = [np.median(one[some] ** 2 / 40.0) / NORMAL_MEDIAN for one, some in zip(off, counts, strict=True)]
    limit = OUTLIER_SD**2 * (40.0 * np.fmax(usual, 1.0) + (IMPERFECT * 50.0) ** 2) + 3.0
    trusted = counts / (1.0 + off**2 / limit[:, None]) ** 2
    every = np.concatenate([terms, off[:, :, None]], axis=2)
    found, goal = (scale, left, trust, sums), (usual, off, trusted, np.einsum("km,kmi,kmj->kij", trusted, every, terms))
    for one, plain in zip(found, goal, strict=True):
        np.testing.assert_allclose(one, plain, rtol=1e-9, atol=1e-9)
