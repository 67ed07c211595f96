"""A contact's grid is turned until it lies along the contact.

Cells across a contact are counted along the grid's two axes. A long contact that lies askew in its grid (the edge of a
pillar that is tilted and turned about its axis, a ridge of an STL probe) reaches few of them, and is only a few cells
wide: its force was half as large again as that of the same contact along the grid.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Bools, Floats
from twin.world.contact.cells import Box
from twin.world.contact.patches import Patches

_LONG, _ASKEW = 1.5, math.sin(math.radians(3.0))
"""Length over width from which a contact has a direction, and how far from an axis of the grid it may point."""

_ON_EVERY_SIDE = 0.15
"""Margin around a contact, over its size."""


def turn_along(patches: Patches, active: Bools) -> Floats | None:
    """Return the turn (3, 3) about the plane's normal that takes the grid's axes along and across a long contact.

    None where they lie so already, or the contact is about as long as it is wide.
    """
    middle, cell = patches.middle_mm[active], patches.cell_mm[active]
    weight = cell[:, 0] * cell[:, 1]
    away = middle - weight @ middle / weight.sum()
    spread = (weight * away.T) @ away / weight.sum() + np.diag(weight @ cell**2) / (3.0 * weight.sum())
    (narrow, wide), directions = np.linalg.eigh(spread)
    u, v = directions[:, 1]
    if wide < _LONG**2 * narrow or min(abs(u), abs(v)) < _ASKEW:
        return None
    along = np.array([u, v, 0.0]) if abs(u) >= abs(v) else np.array([v, -u, 0.0])  # the axis that is nearer
    along *= math.copysign(1.0, along[0])
    return np.stack([along, [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])


def turned_box(patches: Patches, active: Bools, turn: Floats) -> Box:
    """Return a box around the contact in a grid that is turned (3, 3) against the patches' own."""
    middle, reach = patches.middle_mm[active] @ turn[:2, :2].T, float(patches.cell_mm[active].max())
    (u0, v0), (u1, v1) = middle.min(axis=0) - reach, middle.max(axis=0) + reach
    return beside(Box(u0=float(u0), u1=float(u1), v0=float(v0), v1=float(v1)), reach, reach)


def beside(contact: Box, u: float, v: float) -> Box:
    """Return a box with a margin around a contact whose cells have half sizes ``u`` and ``v``."""
    return contact.grown(_ON_EVERY_SIDE * contact.size[0] + u, _ON_EVERY_SIDE * contact.size[1] + v)
