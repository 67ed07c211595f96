"""How far the patches of a press may be off: the same press on patches twice as wide, and what that changes.

Why wider patches and not narrower ones: they cost a tenth of the press itself. Where the press converges with order 1
or more, halving the width once more changes less than this did, so the change bounds the error of the finer one.

Validity: under a sharp rim or tip the traction grows without bound, and the change of the tractions says so.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Floats
from twin.parts.load import Rectangles
from twin.world.contact.contact_state import ContactState, PatchError

_FEWEST = 6


def patch_error(fine: ContactState, coarse: ContactState) -> PatchError:
    """Return how much a state changes with patches twice as wide."""
    peak, radius = fine.peak_pressure_mpa or 1.0, fine.contact_radius_mm or 1.0
    force = float(np.abs(fine.force_n).max()) or 1.0
    return PatchError(
        traction=_traction_change(fine, coarse),
        peak_pressure=abs(coarse.peak_pressure_mpa - peak) / peak,
        contact_radius=abs(coarse.contact_radius_mm - radius) / radius,
        indentation=abs(coarse.indentation_mm - fine.indentation_mm) / (abs(fine.indentation_mm) or 1.0),
        force=float(np.abs(coarse.force_n - fine.force_n).max()) / force,
    )


def _traction_change(fine: ContactState, coarse: ContactState) -> float:
    """Return the RMS change of the tractions over their RMS, the coarse ones interpolated to the finer patches."""
    from scipy.interpolate import LinearNDInterpolator

    if min(len(fine.traction_mpa), len(coarse.traction_mpa)) < _FEWEST:
        return 1.0
    one, other = fine.load.terms[0], coarse.load.terms[0]
    assert isinstance(one, Rectangles)
    assert isinstance(other, Rectangles)
    here, there = _flattened(one, one), _flattened(other, one)
    expected = LinearNDInterpolator(there, coarse.traction_mpa)(here)
    known = np.isfinite(expected).all(axis=1)
    weight = np.prod(one.half_mm, axis=1)[known, None]
    changed = float(np.sum(weight * (expected[known] - fine.traction_mpa[known]) ** 2))
    return float(np.sqrt(changed / np.sum(weight * fine.traction_mpa[known] ** 2))) if known.any() else 1.0


def _flattened(rectangles: Rectangles, reference: Rectangles) -> Floats:
    """Return (k, 2) centres in the plane that the reference's centres lie nearest to."""
    middle = reference.centre_mm.mean(axis=0)
    _, _, axes = np.linalg.svd(reference.centre_mm - middle, full_matrices=False)
    return np.asarray((rectangles.centre_mm - middle) @ axes[:2].T)
