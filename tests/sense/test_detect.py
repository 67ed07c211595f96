"""Spots of a signal: what is asked of the finder that no picture has."""

import numpy as np

from twin.sense.detect import find_blobs


def test_markers_wider_than_the_picture_take_no_memory() -> None:
    """Windows as wide as the markers are made: at 1e6 px they were larger than any machine's memory."""
    signal = np.zeros((60, 80), np.float32)
    signal[25:36, 35:46] = 100
    assert len(find_blobs(signal, 1e6, 10.0)) == len(find_blobs(signal, 80.0, 10.0))
