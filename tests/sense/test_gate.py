"""How far a marker may lie from where its neighbours expect it."""

import numpy as np
import pytest
from drawn import flat_layout, joined, picture

from twin.sense.track import track

SIZE, PITCH, ODD = (380, 320), 30.0, 34


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("share", "matched"), [(0.3, True), (0.42, False)])
def test_a_marker_that_leaves_its_lattice_alone_is_lost_beyond_a_third_of_a_pitch(share, matched, axis):
    layout = flat_layout()
    shift = np.zeros_like(joined(layout))
    shift[ODD, axis] = share * PITCH
    rest, pressed = (picture(each, seed, layout, SIZE, 8.0) for seed, each in enumerate((0.0, shift)))
    found = track(rest, pressed, layout)
    assert found.seen[ODD] == matched
    assert np.delete(found.seen, ODD).mean() > 0.95
