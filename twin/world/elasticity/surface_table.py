"""The smooth rest of a curved body, for loads anywhere on its surface, from a grid of patches solved once.

A new load costs the tractions that its half-space field leaves on the body's faces, some tenths of a second. Where many
loads follow (a dataset, a live page) the rest w of small patches is solved at the nodes of a grid over the middle of
the sensing surface, its force along the axes of the patch, and interpolated in the patch's place by cubic splines:
every load and every contact in that window is a product then. The half-space part stays in closed form. What is kept
are the coefficients of B-splines, of which four by four reach a patch: a contact reads those around it alone.

The error of interpolation is told for every load, from the answer of every other node. Measured on the reference
finger (`tests/world/elasticity/test_surface_table.py`), it is a few parts in ten thousand of the largest displacement
under loads 2 to 4 mm wide, up to two in a thousand, and five under single patches.

Validity: patches on the true surface, in the window, no wider than the grid's spacing. Twists, whose forces nearly
cancel, are left to a solve.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import InputError
from twin.parts.body import Body
from twin.parts.load import Rectangles
from twin.progress import Progress
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.spread import solved
from twin.world.elasticity.store import field_key, kept
from twin.world.mesh.interpolate import Places, Weighted
from twin.world.mesh.sizing import default_sizing

NODES = 19
"""Nodes of the grid along each side; odd, so that every other one is a grid, too."""

PATCH = 1 / 70
"""Half side of the patches that are solved, over the window's half side."""

CLEAR = 0.05
"""Least distance of the window from the body's other faces, over its half side."""

CANCEL = 0.5
"""A load whose total force is less than this share of its forces' sizes is not interpolated."""

KEPT_POINTS = 1000
"""Points for which readings are kept, at most: they take 26 kB a point, gradients three times that."""

ALL = slice(None)

SHARE = 0.4
"""Share of the difference to the grid of every other node that is taken for the error of interpolation."""


class SurfaceTable:
    """Rests of patches on a grid over the sensing surface, for any load within it.

    Parameters
    ----------
    system, body
        The elastic system and the curved body it belongs to.
    progress
        Told about the solves.

    Raises
    ------
    InputError
        The window comes too near to another face of the body.
    """

    def __init__(self, system: TaylorHood, body: Body, progress: Progress | None = None) -> None:
        self._system, self._body = system, body
        self._half = np.array(default_sizing(body, "standard").window_mm)
        self._axes = [np.linspace(-half, half, NODES) for half in self._half]
        self._weights = {step: [_weights(axis, step) for axis in self._axes] for step in (1, 2)}
        chart = np.stack(np.meshgrid(*self._axes, indexing="ij"), axis=-1).reshape(-1, 2)
        points = body.chart_points(chart)
        clear = float(body.piece_distances(points)[:, 1:].min())
        if not clear > CLEAR * self._half.min():
            raise InputError(
                f"accuracy.surface_table = true: the window that would be tabled, {2 * self._half[0]:.3g} x "
                f"{2 * self._half[1]:.3g} mm of the sensing surface around the origin, comes within {clear:.3g} mm of "
                f"another face or runs over it (allowed: {CLEAR * self._half.min():.3g} mm and more): set it to false"
            )
        probes = Rectangles(
            centre_mm=points,
            frames=body.frames(points),
            half_mm=np.full((len(points), 2), PATCH * self._half.min()),
            force_n=np.zeros((len(points), 3)),
        )
        self._fields = kept(
            field_key(system, body, probes.centre_mm, probes.half_mm),
            lambda: _coefficients(_all_solved(system, body, probes, progress), self._axes),
            single=True,
        )
        self._grid = self._fields.reshape(-1, 3, NODES, NODES, 3)

    def covers(self, load: Rectangles) -> bool:
        """Tell whether all patches lie on the true surface in the window and are small enough."""
        if not (load.half_mm.max(initial=0.0) <= self._half.min() / (NODES - 1)):
            return False
        if not (np.abs(self._body.chart_of(load.centre_mm)) <= self._half).all():
            return False
        upright: Bools = np.sum(load.frames[:, 2] * self._body.frames(load.centre_mm)[:, 2], axis=1) > 1.0 - 1e-9
        return bool(upright.all())

    def pushes(self, load: Rectangles) -> bool:
        """Tell whether the load's forces add up, instead of cancelling each other as those of a twist do."""
        sizes = np.linalg.norm(load.force_n, axis=1).sum()
        return bool(np.linalg.norm(load.force_n.sum(axis=0)) >= CANCEL * sizes)

    def reading(self, places: Weighted) -> Floats:
        """Return (n, 3, s, t, axis): the coefficients of w at ``places`` (n), mm for unit forces and 1 MPa."""
        return self._read(places, places.weights[:, :, None])[:, :, 0]

    def slopes(self, places: Places) -> Floats:
        """Return (n, 3, 3, s, t, axis): `reading` and, on the third axis, its derivative along x, y and z."""
        return self._read(places, places.slopes)

    def _read(self, places: Weighted, weights: Floats, s: slice = ALL, t: slice = ALL) -> Floats:
        """Return (n, 3, m, s, t, axis) of some of the grid's rows ``s`` and columns ``t``, by weights (n, k, m)."""
        fields = self._grid[:, :, s, t]
        out = np.empty((len(places.nodes), weights.shape[2], math.prod(fields.shape[1:])))
        for start in range(0, len(out), 64):
            part = slice(start, start + 64)
            used, column = np.unique(places.nodes[part], return_inverse=True)
            rows = np.asarray(fields[used], float).reshape(len(used), -1)
            column = column.reshape(-1, places.nodes.shape[1])
            for axis in range(weights.shape[2]):
                matrix = np.zeros((len(column), len(used)))
                np.put_along_axis(matrix, column, weights[part, :, axis], axis=1)
                out[part, axis] = matrix @ rows
        each = out.reshape(len(out), weights.shape[2], *fields.shape[1:])
        return np.ascontiguousarray(each.swapaxes(1, 2))

    def displacement(self, reading: Floats, load: Rectangles) -> tuple[Points, float]:
        """Return (n, 3) w in mm for E = 1 MPa under ``load``, and the largest error of interpolation, mm."""
        w, every_other = (np.tensordot(reading, self._moments(load, step), axes=3) for step in (1, 2))
        return w, SHARE * float(np.linalg.norm(w - every_other, axis=1).max(initial=0.0))

    def field(self, load: Rectangles, step: int = 1) -> Floats:
        """Return the (N, 3) nodal field of w, mm for E = 1 MPa, in float32's digits; for more points than are kept."""
        return np.tensordot(self._grid, self._moments(load, step).astype(np.float32), axes=3).astype(float)

    def gradient(self, slopes: Floats, load: Rectangles) -> Floats:
        """Return (n, 3, 3) dw_i/dx_j for E = 1 MPa under ``load``."""
        return np.asarray(np.tensordot(slopes, self._moments(load, 1), axes=3))

    def rests(self, places: Places, rectangles: Rectangles) -> Floats:
        """Return (n, 3, k, 3): w in mm/N at ``places`` for E = 1 MPa per unit global force on each rectangle."""
        along = self._splines(rectangles, 1)
        s, t = (_span(one) for one in along)
        weight = (along[0][:, s, None] * along[1][:, None, t]).reshape(len(rectangles), -1)
        frames = self._body.frames(rectangles.centre_mm)
        turned = np.einsum("kp,kaj->pakj", weight, frames).reshape(-1, 3 * len(rectangles))
        values = self._read(places, places.weights[:, :, None], s, t).reshape(3 * len(places.nodes), -1)
        return np.asarray(values @ turned).reshape(-1, 3, len(rectangles), 3)

    def _moments(self, load: Rectangles, step: int) -> Floats:
        """Return (s, t, axis): how strongly the load pulls on each patch of the grid, or of every other one."""
        own = np.einsum("kij,kj->ki", self._body.frames(load.centre_mm), load.force_n)
        return np.asarray(np.einsum("ks,kt,ka->sta", *self._splines(load, step), own, optimize=True))

    def _splines(self, load: Rectangles, step: int) -> list[Floats]:
        """Return (k, s) and (k, t): the weights of the coefficients at the patches."""
        chart = self._body.chart_of(load.centre_mm)
        return [weights(chart[:, axis]) for axis, weights in enumerate(self._weights[step])]


def _weights(axis: Floats, step: int) -> Callable[[Floats], Floats]:
    """Return what the coefficients of an axis' splines weigh at places; with ``step`` 2 as every other node has it."""
    splines = _splines_of(axis)
    if step == 1:
        return splines
    every_other = _splines_of(axis[::step])
    from_nodes = np.linalg.solve(every_other(axis[::step]), splines(axis[::step]))
    return lambda places: np.asarray(every_other(places) @ from_nodes)


def _splines_of(nodes: Floats) -> Callable[[Floats], Floats]:
    """Return the cubic B-splines that interpolate at nodes, as one function of places: (n, nodes)."""
    from scipy.interpolate import BSpline

    knots = np.concatenate([np.full(4, nodes[0]), nodes[2:-2], np.full(4, nodes[-1])])
    made: Callable[[Floats], Floats] = BSpline(knots, np.eye(len(nodes)), 3)
    return made


def _span(weights: Floats) -> slice:
    """Return the columns between the first and the last that hold anything."""
    held = np.flatnonzero(weights.any(axis=0))
    return slice(int(held[0]), int(held[-1]) + 1)


def _coefficients(fields: Floats, axes: list[Floats]) -> Floats:
    """Return what the axes' splines are multiplied with to pass through ``fields`` (N, 3, 3 k) of the nodes."""
    from_nodes = [np.linalg.inv(_splines_of(axis)(axis)).astype(np.float32) for axis in axes]
    for start in range(0, len(fields), 1000):
        part = fields[start : start + 1000].reshape(-1, *(len(axis) for axis in axes), 3)
        along = np.einsum("us,nsta->nuta", from_nodes[0], part, optimize=True)
        along = np.einsum("vt,nuta->nuva", from_nodes[1], along, optimize=True)
        fields[start : start + 1000] = along.reshape(-1, *fields.shape[1:])
    return fields


def _all_solved(system: TaylorHood, body: Body, probes: Rectangles, progress: Progress | None) -> Floats:
    """Return the (N, 3, 3 k) rests of all patches, float32."""
    parts = []
    for part, fields in solved(system, body, probes, probes.frames.transpose(0, 2, 1)):
        parts.append(fields.astype(np.float32))
        if progress is not None:
            progress("table of the sensing surface", part.stop / len(probes))
    return np.concatenate(parts, axis=2)
