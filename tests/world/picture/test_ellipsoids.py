"""Markers as ellipsoids: beads keep their shape, prints strain with the rubber."""

from __future__ import annotations

import numpy as np
import pytest

from twin.errors import InputError
from twin.parts.body import Finger
from twin.parts.markers import MarkerLayer, MarkerSet, Prints, place
from twin.world.picture.frame import quaternions
from twin.world.picture.markers import PRINT_THICKNESS, ellipsoids

LAYERS = {
    "red": MarkerLayer(kind="print", depth_mm=0.5, pitch_mm=2.5, diameter_mm=0.5, columns=3, rows=3, colour=(1, 0, 0)),
    "blue": MarkerLayer(kind="bead", depth_mm=2, pitch_mm=2.5, diameter_mm=0.6, columns=2, rows=2, colour=(0, 0, 1)),
}


@pytest.fixture(name="markers")
def _markers() -> MarkerSet:
    return place(Finger(radius_mm=8, barrel_mm=8, skirt_mm=2), LAYERS)


def metric(axes: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nkj->nik", axes, axes)


def test_at_rest_prints_lie_in_their_level_set_and_beads_are_round(markers: MarkerSet) -> None:
    found = ellipsoids(markers, LAYERS)
    normals = markers.normals[:9]
    across = np.einsum("ni,nij,nj->n", normals, metric(found.axes)[:9], normals)
    np.testing.assert_allclose(np.sqrt(across), PRINT_THICKNESS * 0.25, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found.axes[:9]), PRINT_THICKNESS * 0.25**3, rtol=1e-12)
    np.testing.assert_allclose(metric(found.axes)[9:], np.broadcast_to(0.3**2 * np.eye(3), (4, 3, 3)), atol=1e-15)
    np.testing.assert_array_equal(found.centres, markers.points)
    assert (found.colour[:9] == (1, 0, 0)).all()
    assert not found.axes.flags.writeable


def test_strain_stretches_prints_and_only_turns_beads(markers: MarkerSet) -> None:
    gradient = np.random.default_rng(0).normal(0, 0.1, (13, 3, 3))
    moved = np.random.default_rng(1).normal(0, 0.1, (13, 3))
    rest, found = ellipsoids(markers, LAYERS), ellipsoids(markers, LAYERS, moved, gradient)
    np.testing.assert_allclose(found.centres - rest.centres, moved, atol=1e-14)
    np.testing.assert_allclose(found.axes[:9], (np.eye(3) + gradient[:9]) @ rest.axes[:9], atol=1e-14)
    np.testing.assert_allclose(metric(found.axes)[9:], metric(rest.axes)[9:], atol=1e-14)


def test_a_bead_turns_by_the_antisymmetric_part(markers: MarkerSet) -> None:
    angle = 0.3
    spin = np.zeros((13, 3, 3))
    spin[:, 1, 0], spin[:, 0, 1] = angle, -angle
    turned = ellipsoids(markers, LAYERS, None, spin).axes[9] / 0.3
    c, s = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(turned, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-14)


def test_a_lost_marker_keeps_its_row(markers: MarkerSet) -> None:
    moved = np.zeros((13, 3))
    moved[4] = np.nan
    found = ellipsoids(markers, LAYERS, moved)
    assert len(found) == 13
    assert found.present.sum() == 12
    assert not found.present[4]


def test_prints_of_their_own_size_shade_and_absence(markers: MarkerSet) -> None:
    size, shade = np.linspace(0.9, 1.1, 13), np.linspace(0.5, 1.2, 13)
    missing = np.arange(13) == 3
    found = ellipsoids(markers, LAYERS, prints=Prints(size=size, shade=shade, missing=missing))
    plain = ellipsoids(markers, LAYERS)
    np.testing.assert_array_equal(found.present, ~missing)
    np.testing.assert_allclose(found.axes[~missing], (plain.axes * size[:, None, None])[~missing])
    np.testing.assert_allclose(found.colour, np.clip(plain.colour * shade[:, None], 0, 1))


def test_rows_must_match(markers: MarkerSet) -> None:
    with pytest.raises(InputError, match="one row per marker"):
        ellipsoids(markers, LAYERS, np.zeros((12, 3)))


def test_quaternions_turn_as_their_matrices() -> None:
    matrices, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(50, 3, 3)))
    half_turns = np.array([np.diag(d) for d in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1), (1, 1, 1), (-1, -1, -1))], float)
    matrices = np.concatenate([matrices, half_turns])
    matrices *= np.linalg.det(matrices)[:, None, None]
    q = quaternions(matrices)
    v, w = q[:, :3], q[:, 3]
    p = np.array([0.3, -0.5, 0.8])
    turned = p + 2 * w[:, None] * np.cross(v, p) + 2 * np.cross(v, np.cross(v, p))
    np.testing.assert_allclose(turned, matrices @ p, atol=1e-12)
