"""With what power of the number of unknowns a cost grows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def exponent(rows: Sequence[dict[str, Any]], of: str) -> float:
    """Return the power of ``unknowns`` that the column ``of`` grows with, by least squares in log-log axes."""
    sizes, values = np.log([[row["unknowns"], row[of]] for row in rows]).T
    return float(np.polyfit(sizes, values, 1)[0])
