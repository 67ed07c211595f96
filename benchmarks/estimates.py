"""How good estimates of the error are away from the reference: ``python -m benchmarks.estimates``, a minute.

Disks on the block, against the truth's table, and bumps on the finger, against its finest mesh, at Poisson's ratio 0.5,
at other places and of other widths than the reference's loads. The finest mesh is itself up to 7e-4 off on the finger.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.__main__ import table
from benchmarks.elasticity import compliance
from benchmarks.reference import BODIES, reference
from twin.arrays import Points
from twin.parts.load import Rectangles, Traction
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.tile import tile
from twin.world.mesh.mesh import Level

LEVELS: tuple[Level, ...] = ("nominal", "sketch", "coarse", "standard")
DISKS_MM, BUMPS_MM = (1.5, 4.0, 8.0, 12.0), (2.0, 3.0, 4.0)
ON_BLOCK_MM = ((0.0, 0.0), (6.0, -4.0), (-9.0, 3.0), (2.0, 5.5))
ON_FINGER_MM = ((0.0, 0.0), (-3.0, 0.0), (-3.0, 3.0), (2.0, 2.0), (3.5, 0.0))
BOX_MM = (16.0, 12.0)
"""Half sides of where the block's table answers."""


def cases(body: str) -> Iterator[tuple[Points, Rectangles]]:
    """Yield points (n, 3) mm and a load, for all loads on a body."""
    points = reference(body).points
    for width in DISKS_MM if body == "block" else BUMPS_MM:
        for at in ON_BLOCK_MM if body == "block" else ON_FINGER_MM:
            for force in np.eye(3).tolist():
                if body == "finger":
                    yield points, tile(Traction.bump(at, width / 2, force), BODIES[body], width / 8)
                    continue
                near = points + np.array([*at, 0.0])
                near = near[(np.abs(near[:, :2]) < BOX_MM).all(axis=1)]
                yield near, tile(Traction.disk(at, width / 2, force), BODIES[body])


def ratios(body: str) -> dict[Level, list[float]]:
    """Return the estimated errors of a body's levels over the errors."""
    best: Compliance = compliance(body, 0.5, "subtracted", "fine", body == "block")
    made = {level: compliance(body, 0.5, "subtracted", level, False) for level in LEVELS}
    found: dict[Level, list[float]] = {level: [] for level in LEVELS}
    for points, load in cases(body):
        right = best.displacement(points, load)
        for level, stiff in made.items():
            got, told = stiff.answer(points, load)
            error = np.linalg.norm(got - right, axis=1).max() / np.linalg.norm(right, axis=1).max()
            found[level].append(told / float(error))
    return found


if __name__ == "__main__":
    rows = []
    for name in BODIES:
        for level, each in ratios(name).items():
            all_of = np.array(each)
            rows.append(
                {"body": name, "level": level, "loads": len(each), "least": all_of.min(), "median": np.median(all_of),
                 "most": all_of.max(), "below 1": np.mean(all_of < 1.0), "above 3": np.mean(all_of > 3.0)}
            )  # fmt: skip
    print(table(rows))
