"""The compiled kernels of the disc fit: the fast ways against the plain ones."""

from __future__ import annotations

import numpy as np
import pytest

from tests.sense.marker_pictures import BLUE, RED, clean_picture, expose, flat_layout
from twin.sense.gather import LANES, disc, gather, gather_inside, runs_of
from twin.sense.track import Tracker, analyse_rest


@pytest.mark.parametrize("others", [0, 1, 2])
@pytest.mark.parametrize("radius", [2.3, 7.86, 8.0, 17.2])
def test_pixels_row_by_row_are_those_one_by_one(radius, others):
    random = np.random.default_rng(3)
    image = random.integers(0, 256, (60, 70, 3), dtype=np.uint8)
    own = np.array([1.0, -0.25, 0.5, 3.0], np.float32)
    limits = np.array([[0.5, 0.25, 0.0, 100.0], [0.0, -1.0, 1.0, 30.0]], np.float32)[:others]
    offset = disc(radius)
    plain, fast = np.zeros((2, 2, offset.shape[1] + LANES), np.float32)
    inside = 0
    for column in range(0, 70, 3):
        for row in range(0, 60, 3):
            gather(image, own, limits, column, row, offset, plain[0, :-LANES], plain[1, :-LANES])
            took = gather_inside(image, tuple(own), limits, column, row, offset, runs_of(offset), fast[0], fast[1])
            reach = int(radius)
            whole = reach <= column < 70 - reach and reach <= row < 60 - reach
            assert whole or not took
            if took:
                inside += 1
                np.testing.assert_array_equal(fast[1, :-LANES], plain[1, :-LANES])
                seen = plain[1, :-LANES] > 0
                np.testing.assert_allclose(fast[0, :-LANES][seen], plain[0, :-LANES][seen], rtol=1e-6, atol=1e-4)
    assert inside >= 60  # the last rows' surplus may reach beyond the picture's end: those are taken one by one


@pytest.mark.slow
def test_markers_lead_those_after_them():
    layout = flat_layout()
    step = np.array([3.1, -2.4])

    def picture(shift, seed, lost=None):
        red = layout["red"] + shift
        if lost is not None:
            red = np.delete(red, lost, axis=0)
        return expose(clean_picture((340, 300), [(red, RED), (layout["blue"] + shift, BLUE)], diameter=10.0), seed)

    rest = picture(np.zeros(2), 0)
    group = analyse_rest(rest, layout).groups[0]
    start = np.ascontiguousarray(group.around.rest_px)
    image = picture(step, 1, lost=[0, 33])  # the very first, which leads the second, and one amidst
    settled = group.templates.fit(image, start + step, 24)[:, :2]
    alone, led = (group.templates.fit(image, start, 4, lead)[:, :2] for lead in (None, group.around.lead))
    here = np.setdiff1d(np.arange(len(start)), [0, 1, 2, 3, 33])
    off = [np.hypot(*(found - settled)[here].T) for found in (alone, led)]
    assert np.median(off[0]) > 0.02
    assert np.median(off[1]) < 0.001
    tracker = Tracker(rest, layout)
    tracker.track(rest)
    found = tracker.track(image)
    assert not found.seen[[0, 33]].any()
    assert found.seen.sum() == len(found.seen) - 2
    np.testing.assert_allclose(found.shift_px[found.seen], step + np.zeros((len(found.seen) - 2, 2)), atol=0.06)
