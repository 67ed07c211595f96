"""A Mitsuba scene of ellipsoids whose numbers are written over, not built anew."""

from __future__ import annotations

from typing import Any

import numpy as np

from twin.arrays import Singles
from twin.world.picture.frame import NOWHERE


class Shape:
    """A Mitsuba scene that holds ellipsoids; new numbers for as many of them are written over the old."""

    def __init__(self, mi: Any) -> None:
        self._mi = mi
        self._scene: Any = None
        self._params: Any = None
        self._count = -1

    def hold(self, data: Singles) -> Any:
        """Return the scene with these (n, 10) ellipsoids."""
        mi = self._mi
        # Mitsuba takes a tensor of three rows for a colour first, and complains: three markers get company far aside.
        data = np.concatenate([data, np.tile(NOWHERE, (max(4 - len(data), 0), 1))])
        if len(data) != self._count:
            shape = {"type": "ellipsoids", "data": mi.TensorXf(data), "extent": 1.0}
            self._scene = mi.load_dict({"type": "scene", "markers": shape})
            self._params = mi.traverse(self._scene)
            self._count = len(data)
        else:
            numbers = data.ravel()
            self._params["markers.data"] = numbers if mi.variant().startswith("scalar") else mi.Float(numbers)
            self._params.update()
        return self._scene
