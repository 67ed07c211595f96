"""The table of a block of any thickness, from the tables of a few: a sweep of thicknesses meshes and solves those only.

In coordinates that are stretched with the block (a depth over the thickness) the rest w of a point force varies
smoothly with the thickness, so that the coefficients of `twin.world.elasticity.table` do. They are interpolated between
Chebyshev places of the range that is asked for. All tables come from one mesh that is stretched
(`twin.world.mesh.body_mesh.body_mesh`), so that its error varies smoothly too, far below what the thickness changes.

Validity: blocks of one width and length, ranges up to `WIDEST`; what `twin.world.elasticity.table` says. Where a table
of a range is too inaccurate to be used (thin blocks) there is none between them either.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from twin.arrays import Floats
from twin.parts.body import Block
from twin.world.elasticity.table import Table
from twin.world.elasticity.tabulate import Role, find_table, window_of

NARROW, FEW, MANY = 1.7, 4, 6
"""Tables of a range whose ends differ by less than the first factor, and of wider ones: even numbers, so that none is
the middle, where the shipped table of a finer mesh may be."""

GOOD = 1e-3
"""Largest error of the displacement with which a table between tables is used."""

REST = 0.3
"""Largest share of w in a marker's displacement, roughly."""

WIDEST = 3.0
"""Largest ratio of the thicknesses of a range."""


def places_mm(low_mm: float, high_mm: float) -> Floats:
    """Return the thicknesses of a range that tables are made for."""
    count = FEW if high_mm <= NARROW * low_mm else MANY
    return np.asarray((low_mm + high_mm + (high_mm - low_mm) * chebpts1(count)) / 2.0)


def table_between(body: Block, role: Role, low_mm: float, high_mm: float) -> Table | None:
    """Return the table of a block by interpolation; None where there is none to be had.

    Parameters
    ----------
    body
        Of a thickness in the range.
    role
        See `twin.world.elasticity.tabulate`.
    low_mm, high_mm
        The range of thicknesses, whose tables are made, some seconds each, and cached.
    """
    if not low_mm <= body.thickness_mm <= high_mm or not low_mm < high_mm <= WIDEST * low_mm:
        return None
    told = _tables(body.width_mm, body.length_mm, role, low_mm, high_mm)
    if told is None:
        return None
    modes, digest, error = told
    place = (2.0 * body.thickness_mm - low_mm - high_mm) / (high_mm - low_mm)
    weight = chebvander(np.array([place]), len(modes) - 1)[0]
    window, box = window_of(body)
    return Table(
        coefficients=np.tensordot(weight, modes, axes=1), window_mm=window, box_mm=box, digest=digest, error=error
    )


@lru_cache(maxsize=8)
def _tables(
    width_mm: float, length_mm: float, role: Role, low_mm: float, high_mm: float
) -> tuple[Floats, str, float] | None:
    """Return the coefficients of a range as polynomials in the thickness, the mesh's digest and the error to expect."""
    tables = []
    for thickness in places_mm(low_mm, high_mm):
        body = Block(width_mm=width_mm, length_mm=length_mm, thickness_mm=float(thickness))
        table = find_table(body, role, make=True, usable=GOOD)
        if table is None:
            return None
        tables.append(table)
    count = len(tables)
    inverse = np.linalg.inv(chebvander(chebpts1(count), count - 1))
    modes = np.tensordot(inverse, np.stack([t.coefficients for t in tables]), axes=1)
    # what the next polynomial would add is about as much less than the last as that is than the one before
    last, before = (float(np.abs(m).max()) for m in (modes[-1], modes[-2]))
    error = max(t.error for t in tables) + REST * last * min(1.0, last / before) / float(np.abs(modes[0]).max())
    return (modes, tables[0].digest, error) if error <= GOOD else None
