"""Where the half-space part of a field holds: the body must lie behind the tangent plane of every load.

The closed-form field of a load fills the half-space behind the load's plane and nothing else. A convex body lies there
whatever is pressed; a body with dents may, too (a flat pad on a bracket), so what counts is the load, not the body.
"""

from __future__ import annotations

import numpy as np

from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles

STANDS_OUT_MM = 1e-3
"""How far a body may reach over a load's plane: corners in a file are rounded."""


def require_half_space(body: Body, load: Rectangles) -> None:
    """Raise an `InputError` unless the body lies behind the plane of every rectangle."""
    if body.is_convex or len(load) == 0:
        return
    out = body.stands_out(load.centre_mm, load.frames[:, 2])
    worst = int(np.argmax(out))
    if out[worst] > STANDS_OUT_MM:
        place = ", ".join(f"{c:.4g}" for c in load.centre_mm[worst])
        raise InputError(
            f"the body reaches {out[worst]:.3g} mm over the surface's tangent plane at ({place}) mm (allowed: "
            f"{STANDS_OUT_MM:g} mm), so the half-space part of the field does not hold there: press where nothing "
            "stands out, or use Compliance(..., method='direct'), which needs a mesh that is fine under the load"
        )
