"""Does it matter that the acrylic base is taken as rigid? ``python -m benchmarks.base`` solves it as a plate.

The plate (3000 MPa, nu 0.37) is glued below the base, as wide as it, and held at its sides only: the least support
that a sensor's frame can give it. What it changes is the difference of two solutions on the same mesh, rigid and
elastic, over the largest displacement of the markers. The difference varies as slowly as the base bends, so plain
Taylor-Hood is enough for it, however narrow the load. Markers are looked at where the sensors have them.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks.__main__ import RESULTS, machine, table
from benchmarks.arguments import command_line
from twin.parts.body import Block, Body, Finger
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.direct import consistent_forces
from twin.world.elasticity.fem import Layer, TaylorHood
from twin.world.elasticity.tile import tile
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.extrude import with_base
from twin.world.mesh.interpolate import Locator

ACRYLIC_MPA, ACRYLIC_NU = 3000.0, 0.37
RUBBER = Material(youngs_modulus_mpa=1.0, poisson_ratio=0.5)
BODIES: dict[str, tuple[Body, float, float, tuple[float, ...], float]] = {
    "block": (Block(width_mm=100, length_mm=90, thickness_mm=40), 10.0, 15.0, (3.0, 6.0), 2.5),
    "finger": (Finger(radius_mm=8, barrel_mm=8, skirt_mm=2), 1.0, 5.0, (0.5, 2.0), 1.0),
}
"""Body, plate thickness, half width of the marker grid, marker depths and radius of the load, mm."""


def run(quick: bool) -> list[dict[str, Any]]:
    """Return one row for every body, place and direction of the load; the quick form takes the block only."""
    rows = []
    for name, (body, thickness, half, depths, radius) in BODIES.items():
        if quick and name == "finger":
            continue
        mesh = with_base(body_mesh(body, "coarse"), body, thickness, sheets=1)
        layer = [Layer(modulus_ratio=ACRYLIC_MPA / RUBBER.youngs_modulus_mpa, poisson_ratio=ACRYLIC_NU)]
        plate = np.zeros(len(mesh.points), bool)
        plate[mesh.tets[mesh.region == 1]] = True
        side = mesh.nodes_on([len(body.pieces) + 1])
        rigid, elastic = (TaylorHood(mesh, 0.5, held=held, layers=layer) for held in (plate, side))
        grid = np.stack(np.meshgrid(*[np.linspace(-half, half, 11)] * 2), axis=-1).reshape(-1, 2)
        points = np.concatenate([body.chart_points(grid, depth) for depth in depths])
        points = points[body.contains(points, 0.3)]
        locator, bare = Locator(mesh), Compliance(body, RUBBER)
        places = locator.locate(points)
        for at in ((0.0, 0.0), (0.6 * half, 0.4 * half)):
            for force in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)):
                start = time.process_time()
                load = tile(Traction.bump(at, radius, force), body)
                forces = consistent_forces(body, mesh, locator, load)[:, :, None]
                moved = elastic.solve(forces)
                extra = np.linalg.norm(places.values(moved - rigid.solve(forces))[:, :, 0], axis=1).max()
                sunk = np.linalg.norm(moved[plate, :, 0], axis=1).max()
                largest = np.linalg.norm(bare.displacement(points, load), axis=1).max()
                rows.append(
                    {
                        "body": name,
                        "plate_mm": thickness,
                        "load at": f"({at[0]:g}, {at[1]:g}) mm, along {'z' if force[2] else 'x'}",
                        "largest marker displacement, mm/N": float(largest),
                        "changed by the plate, mm/N": float(extra),
                        "share": float(extra / largest),
                        "plate moves, mm/N": float(sunk),
                        "seconds": time.process_time() - start,
                    }
                )
    return rows


def main() -> int:
    """Print the table and store it."""
    quick = command_line("base", __doc__, quick=True).quick
    rows = run(quick)
    print(table(rows))
    if not quick:
        RESULTS.mkdir(exist_ok=True)
        (RESULTS / "base.json").write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
