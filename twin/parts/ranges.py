"""Ranges that many keys share: wider than any sensor needs, and narrow enough that their squares are still numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

LEAST_MM, LEAST_MPA = 1e-6, 1e-6
"""The least length and the least stiffness: a nanometre, one pascal."""

Place = Annotated[float, Field(ge=-1e4, le=1e4, allow_inf_nan=False)]
"""A coordinate or a motion, mm: ten metres either way."""

Force = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
"""A component of a force or of a torque, N or N mm."""

Angle = Annotated[float, Field(ge=-3600, le=3600, allow_inf_nan=False)]
"""Degrees: ten turns either way."""

Share = Annotated[float, Field(ge=0, le=1)]
"""Of light: reflectances and shares of a colour."""

Size = Annotated[float, Field(ge=LEAST_MM, le=1000)]
"""How wide, long or thick something is, mm: from a nanometre to a metre."""

Pixel = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
"""A coordinate in a picture, px."""

Coefficient = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
"""Of a lens's distortion, whatever its power."""
