"""A flat sensor on a half-space, for tests: point forces in closed form, and a camera."""

import numpy as np
from standard_bodies import rectangles

from twin.sense.calibration import Calibration, from_compliance
from twin.sense.track import Found
from twin.theory import halfspace


def compliance(markers, points):
    """(3n, 3m) mm/N for point forces."""
    return halfspace.compliance(markers, rectangles(points, 0.0, 0.0), 1.0, 0.5)


def cell_compliance(markers, sites, pitch, cuts=6):
    """(3n, 3k) mm/N for uniform square cells, each of ``cuts`` x ``cuts`` points."""
    offsets = ((np.arange(cuts) + 0.5) / cuts - 0.5) * pitch
    return sum(compliance(markers, sites + np.array([a, b, 0.0])) for a in offsets for b in offsets) / cuts**2


def grid(columns, rows, pitch, z=0.0):
    x = (np.arange(columns) - (columns - 1) / 2) * pitch
    y = (np.arange(rows) - (rows - 1) / 2) * pitch
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack([xy, np.full(len(xy), z)])


def jacobian(markers, camera_z, px_per_mm):
    """(n, 2, 3) px/mm of a pinhole on the axis at ``camera_z``; rows grow with -y."""
    near = camera_z - markers[:, 2]
    scale = px_per_mm * camera_z / near
    j = np.zeros((len(markers), 2, 3))
    j[:, 0, 0], j[:, 1, 1] = scale, -scale
    j[:, 0, 2], j[:, 1, 2] = scale * markers[:, 0] / near, -scale * markers[:, 1] / near
    return j


def flat_sensor(columns=15, rows=12, pitch=2.0):
    """The flat paper's design: 636 markers, sites at ``pitch`` mm. Returns markers, jacobian, calibration."""
    markers = np.vstack([grid(21, 16, 1.5, 6.0), grid(20, 15, 1.5, 3.0)])
    layer = np.repeat(["red", "blue"], [336, 300])
    return _sensor(markers, layer, (columns, rows), pitch, jacobian(markers, 100.0, 20.0))


def finger_sensor():
    """The finger paper's design laid flat: 61 markers at 2.5 mm, 25 sites at 2.5 mm."""
    markers = np.vstack([grid(5, 5, 2.5, 0.5), grid(6, 6, 2.5, 2.0)])
    return _sensor(markers, np.repeat(["red", "blue"], [25, 36]), (5, 5), 2.5, jacobian(markers, 14.0, 30.0))


def _sensor(markers, layer, shape, pitch, seen):
    sites = grid(*shape, pitch)
    return (
        markers,
        seen,
        Calibration(
            layer=layer,
            layout_px=np.einsum("nij,nj->ni", seen, markers * [1, 1, 0]),
            site_mm=sites,
            site_frames=np.tile(np.eye(3), (len(sites), 1, 1)),
            site_area_mm2=np.full(len(sites), pitch**2),
            grid=shape,
            transfer=from_compliance(cell_compliance(markers, sites, pitch), seen),
        ),
    )


def disk(centre, diameter, force, cuts=16):
    """Points and forces of a uniform disk, finer than any site."""
    offsets = ((np.arange(cuts) + 0.5) / cuts - 0.5) * diameter
    xy = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    xy = xy[np.hypot(*xy.T) <= diameter / 2]
    return np.column_stack([xy + centre, np.zeros(len(xy))]), np.tile(np.array(force) / len(xy), (len(xy), 1))


def shifts(markers, seen, points, forces):
    """(n, 2) noise-free shifts, px."""
    motion = (compliance(markers, points) @ forces.ravel()).reshape(-1, 3)
    return np.einsum("nij,nj->ni", seen, motion)


def as_found(shift, calibration, sd=0.03, seed=None):
    """What tracking would hand over, with noise of ``sd`` px where seeded."""
    if seed is not None:
        shift = shift + np.random.default_rng(seed).normal(0, sd, shift.shape)
    return Found(
        rest_px=np.array(calibration.layout_px),
        shift_px=shift,
        sd_px=np.full(len(shift), sd),
        layer=calibration.layer,
        channels={},
        method="drawn",
    )


def pressed(sensor, centre, diameter, force, noise=0.05, seed=1):
    """What tracking would hand over under a uniform disk."""
    markers, seen, calibration = sensor
    return as_found(shifts(markers, seen, *disk(centre, diameter, force)), calibration, noise, seed)
