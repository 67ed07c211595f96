"""How much force and torque friction can carry: the limit load of a contact whose pressure is known.

A side force and a torque are balanced by some friction forces of at most mu f_n if and only if no motion v of the probe
gains more work from them than friction would take, sum of mu f_n |v at the patch| (the bound from above of limit
analysis; S. Goyal, A. Ruina and J. Papadopoulos, Wear 143 (1991) 307). The worst of many motions tells the share.

Validity: the pressure is the frictionless one. On a flat body at Poisson's ratio 0.5 shear does not change it; with
other ratios, or on a slope, the limit is a few per cent off, so it explains a failure and does not refuse by itself.
"""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Bools, Floats

Z = 2
_MOTIONS = 4000


def _motions(count: int) -> Floats:
    """Return (n, count) unit vectors, spread evenly."""
    if count == 1:
        return np.array([[1.0], [-1.0]])
    turn = np.arange(_MOTIONS) * math.pi * (3.0 - math.sqrt(5.0))
    if count == 2:
        turn = np.arange(_MOTIONS) * 2.0 * math.pi / _MOTIONS
        return np.column_stack([np.cos(turn), np.sin(turn)])
    height = 1.0 - 2.0 * (np.arange(_MOTIONS) + 0.5) / _MOTIONS
    around = np.sqrt(1.0 - height**2)
    return np.column_stack([around * np.cos(turn), around * np.sin(turn), height])


def asked_share(carried: Floats, normal_n: Floats, friction: float, by_force: Bools, given: Floats) -> float:
    """Return the given side forces and torque over the largest of their kind that friction can carry.

    Parameters
    ----------
    carried
        (k, 3, 4) motion of the probe's points at the patches, in their frames, per unit of x, y, z and turn.
    normal_n
        (k,) normal forces, N.
    friction
        Coefficient of friction.
    by_force, given
        (4,) which of x, y, z and turn are held by force, and the forces and the torque.

    Returns
    -------
    0 when nothing is asked; above 1 there is no balance.
    """
    free = np.flatnonzero(by_force & (np.arange(4) != Z))
    if len(free) == 0 or not normal_n.any() or math.isinf(friction):
        return 0.0
    arm = float(np.abs(carried[:, :2, 3]).max()) or 1.0
    size = np.array([1.0, 1.0, 1.0, 1.0 / arm])[free]
    motion = _motions(len(free)) * size
    asked = (given - np.einsum("k,kd->d", normal_n, carried[:, 2]))[free]
    pushing = normal_n > 0
    moved = np.einsum("kad,md->mka", carried[pushing][:, :2, free], motion)
    taken = friction * np.hypot(moved[..., 0], moved[..., 1]) @ normal_n[pushing]
    return float(np.max(motion @ asked / np.maximum(taken, 1e-300)))
