"""Markers as ellipsoids: beads keep their shape, prints strain with the rubber."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import FINGER

from twin.errors import InputError
from twin.parts.markers import MarkerLayer, Prints, place
from twin.world.picture.ellipsoids import PRINT_THICKNESS, Ellipsoids

LAYERS = {
    "red": MarkerLayer(kind="print", depth_mm=0.5, pitch_mm=2.5, diameter_mm=0.5, columns=3, rows=3, colour=(1, 0, 0)),
    "blue": MarkerLayer(kind="bead", depth_mm=2, pitch_mm=2.5, diameter_mm=0.6, columns=2, rows=2, colour=(0, 0, 1)),
}


@pytest.fixture(name="markers")
def _markers():
    return place(FINGER, LAYERS)


def metric(axes):
    return np.einsum("nij,nkj->nik", axes, axes)


def test_at_rest_prints_lie_in_their_level_set_and_beads_are_round(markers):
    found = Ellipsoids.of(markers, LAYERS)
    normals = markers.normals[:9]
    across = np.einsum("ni,nij,nj->n", normals, metric(found.axes)[:9], normals)
    assert_allclose(np.sqrt(across), PRINT_THICKNESS * 0.25, rtol=1e-12)
    assert_allclose(np.linalg.det(found.axes[:9]), PRINT_THICKNESS * 0.25**3, rtol=1e-12)
    assert_allclose(metric(found.axes)[9:], np.broadcast_to(0.3**2 * np.eye(3), (4, 3, 3)), atol=1e-15)
    assert_array_equal(found.centres, markers.points)
    assert (found.colour[:9] == (1, 0, 0)).all()
    assert not found.axes.flags.writeable


def test_strain_stretches_prints_and_only_turns_beads(markers):
    gradient = np.random.default_rng(0).normal(0, 0.1, (13, 3, 3))
    moved = np.random.default_rng(1).normal(0, 0.1, (13, 3))
    rest, found = Ellipsoids.of(markers, LAYERS), Ellipsoids.of(markers, LAYERS, moved, gradient)
    assert_allclose(found.centres - rest.centres, moved, atol=1e-14)
    assert_allclose(found.axes[:9], (np.eye(3) + gradient[:9]) @ rest.axes[:9], atol=1e-14)
    assert_allclose(metric(found.axes)[9:], metric(rest.axes)[9:], atol=1e-14)
    # By the antisymmetric part: here a turn about z.
    spin = np.zeros((13, 3, 3))
    spin[:, 1, 0], spin[:, 0, 1] = 0.3, -0.3
    c, s = np.cos(0.3), np.sin(0.3)
    turned = Ellipsoids.of(markers, LAYERS, None, spin).axes[9] / 0.3
    assert_allclose(turned, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-14)


def test_prints_of_their_own_size_shade_and_absence(markers):
    size, shade = np.linspace(0.9, 1.1, 13), np.linspace(0.5, 1.2, 13)
    missing = np.arange(13) == 3
    found = Ellipsoids.of(markers, LAYERS, prints=Prints(size=size, shade=shade, missing=missing))
    plain = Ellipsoids.of(markers, LAYERS)
    assert_array_equal(found.present, ~missing)
    assert_allclose(found.axes[~missing], (plain.axes * size[:, None, None])[~missing])
    assert_allclose(found.colour, np.clip(plain.colour * shade[:, None], 0, 1))


def test_a_lost_marker_keeps_its_row_and_rows_must_match(markers):
    moved = np.zeros((13, 3))
    moved[4] = np.nan
    assert_array_equal(Ellipsoids.of(markers, LAYERS, moved).present, np.arange(13) != 4)
    with pytest.raises(InputError, match="one row per marker"):
        Ellipsoids.of(markers, LAYERS, moved[:12])
