"""The smooth rest for many small patches in one region, from a few: a contact's compliance in a few dozen solves.

Where a patch is moved within a contact, its rest w changes smoothly; so w is solved for probe patches at the nodes of
a Chebyshev grid over the region, and interpolated in the patch's place, the force being held in the patch's own frame.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial.chebyshev import chebpts1

from twin.arrays import Floats, Points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles, Traction
from twin.world.correction import correction
from twin.world.fem import TaylorHood
from twin.world.interpolate import Places
from twin.world.tile import onto_surface

GRAIN_MM = 1.2
"""Region per node beyond the first three; on the reference finger the field of a whole contact is then .3 % off."""

MOST = 9
"""Nodes per direction at most."""

BATCH = 32
"""Patches per block of right-hand sides, which bounds the memory."""


def patch_rests(
    system: TaylorHood, body: Body, places: Places, rectangles: Rectangles, grain_mm: float = GRAIN_MM
) -> Floats:
    """Return (n, 3, k, 3): w in mm/N at ``places`` (n), for E = 1 MPa, per unit global force on each rectangle.

    Parameters
    ----------
    system, body
        The elastic system and the body it belongs to.
    places
        Where w is read.
    rectangles
        (k) patches.
    grain_mm
        Wanted distance of the probes.

    Notes
    -----
    Few patches, or patches all over the body, are solved one by one: interpolation has to save solves to be used.
    """
    centre = rectangles.centre_mm.mean(axis=0)
    centre = centre - body.depth(centre[None])[0] * body.piece_normals(centre[None])[0, 0]
    frame = body.frames(centre[None])[0]
    offsets = (rectangles.centre_mm - centre) @ frame[:2].T
    low, high = offsets.min(axis=0), offsets.max(axis=0)
    number = [min(3 + math.ceil((b - a) / grain_mm), MOST) for a, b in zip(low, high, strict=True)]
    sparse = max(b - a for a, b in zip(low, high, strict=True)) > 2.0 * MOST * grain_mm
    if sparse or len(rectangles) <= 1.2 * number[0] * number[1]:
        return _one_by_one(system, places, rectangles)
    nodes = [
        (a + b) / 2 + max((b - a) / 2, grain_mm / 4) * chebpts1(n) for a, b, n in zip(low, high, number, strict=True)
    ]
    try:
        probes = _probes(nodes, centre, frame, body, rectangles)
    except InputError:
        return _one_by_one(system, places, rectangles)
    rests = _one_by_one(system, places, probes, local=True)
    weight = np.einsum("ka,kb->kab", _lagrange(nodes[0], offsets[:, 0]), _lagrange(nodes[1], offsets[:, 1]))
    out: Floats = np.einsum(
        "nijc,kj,kcg->nikg", rests, weight.reshape(len(rectangles), -1), rectangles.frames, optimize=True
    )
    return out


def _probes(nodes: list[Floats], centre: Points, frame: Floats, body: Body, rectangles: Rectangles) -> Rectangles:
    offsets = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 2)
    half = rectangles.half_mm.mean(axis=0)
    whole = Traction(
        kind="rectangle", centre_mm=tuple(centre), size_mm=(float(np.ptp(nodes[0])), float(np.ptp(nodes[1])))
    )
    points = onto_surface(offsets, centre, frame, body, whole)
    return Rectangles(
        centre_mm=points,
        frames=body.frames(points),
        half_mm=np.tile(half, (len(points), 1)),
        force_n=np.zeros((len(points), 3)),
    )


def _one_by_one(system: TaylorHood, places: Places, rectangles: Rectangles, local: bool = False) -> Floats:
    """Return (n, 3, k, 3), per unit force along the global axes, or along the axes of each patch's frame."""
    out = np.empty((len(places.nodes), 3, len(rectangles), 3))
    matrix = places.matrix(len(system.mesh.points))
    for start in range(0, len(rectangles), BATCH):
        batch = range(start, min(start + BATCH, len(rectangles)))
        fields = correction(
            system, [single(rectangles, i) for i in batch], [_axes(rectangles, i, local) for i in batch]
        )
        values = matrix @ fields.reshape(len(fields), -1)
        out[:, :, start : batch.stop] = values.reshape(len(out), 3, len(batch), 3)
    return out


def _axes(rectangles: Rectangles, index: int, local: bool) -> Floats:
    return (rectangles.frames[index].T if local else np.eye(3))[None]


def single(rectangles: Rectangles, index: int) -> Rectangles:
    """Return one of the rectangles."""
    part = slice(index, index + 1)
    return Rectangles(
        centre_mm=rectangles.centre_mm[part],
        frames=rectangles.frames[part],
        half_mm=rectangles.half_mm[part],
        force_n=rectangles.force_n[part],
    )


def _lagrange(nodes: Floats, at: Floats) -> Floats:
    """Return (k, n) Lagrange polynomials of the nodes at k places."""
    away = at[:, None, None] - nodes[None, None, :]
    between = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(between, 1.0)
    ratio = away / between
    index = np.arange(len(nodes))
    ratio[:, index, index] = 1.0
    return np.asarray(ratio.prod(axis=2))
