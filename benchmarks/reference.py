"""The converged fields that errors are measured against (tests/reference), and how far an answer is from them.

An error is the largest difference over all points, over the largest displacement there. Some points lie 0.3 to 0.5 mm
deep, under the edges of the load, where markers never are: so the markers' own error is told too.
"""

import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from benchmarks import ROOT
from twin.arrays import Points
from twin.parts.body import Block, Body, Finger
from twin.parts.load import Rectangles, Traction
from twin.world.elasticity.discretise import tile

YOUNGS_MODULUS_MPA = 0.5

FILES = {"block": "block_converged", "finger": "finger"}
"""The block's loads were solved again, nearer to the truth: `tests/block_truth.py`."""

BODIES: dict[str, Body] = {
    "block": Block(width_mm=100, length_mm=90, thickness_mm=40),
    "finger": Finger(radius_mm=8, barrel_mm=8, skirt_mm=2),
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """One load: its name, Poisson's ratio, the load in words, and the (n, 3) displacements that are right, mm.

    ``own_error`` is the reference's, over the largest displacement: the difference of its two best meshes.
    """

    key: str
    nu: float
    words: dict[str, Any]
    right: Points
    own_error: float

    def load(self, body: Body) -> Rectangles:
        """Return the load on the body."""
        words = dict(self.words)
        return tile(getattr(Traction, words.pop("kind"))(**words), body)


@dataclass(frozen=True, kw_only=True)
class Reference:
    """All cases of a body at the same points (n, 3), mm; the first ``markers`` of them are markers."""

    points: Points
    markers: int
    cases: tuple[Case, ...]

    def case(self, key: str) -> Case:
        """Return the case of that name."""
        return next(case for case in self.cases if case.key == key)

    def errors(self, answer: Points, right: Points) -> tuple[float, float]:
        """Return the largest error over the largest displacement: at all points, and at the markers alone."""
        away, size = np.linalg.norm(answer - right, axis=1), np.linalg.norm(right, axis=1)
        of = slice(self.markers)
        return float(away.max() / size.max()), float(away[of].max() / size[of].max())


@cache
def reference(name: str) -> Reference:
    """Return the reference of ``block`` or ``finger``."""
    with np.load(ROOT / "tests" / "reference" / f"{FILES[name]}.npz") as file:
        data = {key: file[key] for key in file.files}
    return Reference(
        points=data["points"],
        markers=int(data["slice_blue"][1]),
        cases=tuple(
            Case(
                key=case["key"],
                nu=case["nu"],
                words=case["load"],
                right=data[case["key"]],
                own_error=case["error_estimate"],
            )
            for case in json.loads(str(data["cases"]))
        ),
    )
