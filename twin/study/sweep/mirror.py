"""Mirror symmetry: a symmetric design's transfer matrix falls into four blocks, each a quarter as wide and as high.

A block, centred grids of markers and sites and a camera on the axis don't change when x or y is mirrored. So fields
that are even or odd under each mirror don't mix: with orthonormal even and odd parts of sites and markers the matrix is
block diagonal, one block for each of the classes (+,+), (+,-), (-,+), (-,-), and only a quarter of the markers' rows is
needed to make them. Factorising four blocks of a quarter of the size costs a sixteenth.

Arrays here have grid axes (columns, rows) followed by an axis of components. A vector's component along the mirrored
axis changes its sign, in pictures too (column with x, row with y).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit
from twin.parts.block import Block
from twin.parts.camera import Camera
from twin.parts.scene import Scene

Signs = tuple[int, int]
"""Even (1) or odd (-1) under the mirrors of x and y; 0 where there is no mirror."""

_ROOT = float(np.sqrt(2.0))


def classes(mirrored: tuple[bool, bool]) -> list[Signs]:
    """Return the classes of a design that is or isn't symmetric along x and y."""
    x, y = ((1, -1) if each else (0,) for each in mirrored)
    return list(product(x, y))


def mirrored(scene: Scene) -> tuple[bool, bool]:
    """Return whether a scene's nominal design is symmetric under the mirrors of x and of y."""
    if not isinstance(scene.body, Block) or scene.camera is None:
        return (False, False)
    camera = scene.camera
    if any(camera.tilt_deg) or camera.principal_px is not None or _decentred(camera):
        return (False, False)
    along = [
        camera.pupil_mm[axis] == 0
        and all(layer.offset_mm[axis] == 0 for layer in scene.markers.values())
        and _lit_evenly(scene, axis)
        for axis in (0, 1)
    ]
    return (along[0], along[1])


def _lit_evenly(scene: Scene, axis: int) -> bool:
    """Return whether each LED has a mirror image along an axis, so that shadows have, too."""
    places = set(scene.light.positions_mm) if scene.light is not None else set()
    return all((*p[:axis], -p[axis], *p[axis + 1 :]) in places for p in places)


def _decentred(camera: Camera) -> bool:
    return camera.lens == "pinhole" and any(camera.distortion[2:4])


def component_signs(signs: Signs, count: int) -> list[Signs]:
    """Return the signs by which each of ``count`` components (x, y, then even ones) of a vector field goes."""
    flips = [(-1, 1), (1, -1), (1, 1)][:count]
    return [(signs[0] * flip[0], signs[1] * flip[1]) for flip in flips]


def fold(values: Floats, signs: Signs) -> Floats:
    """Return the orthonormal coefficients of a class.

    Parameters
    ----------
    values
        (columns, rows, components, ...) field.
    signs
        Of the class.

    Returns
    -------
    (r, ...) component by component.
    """
    return np.concatenate(
        [fold_one(values[:, :, number], each) for number, each in enumerate(component_signs(signs, values.shape[2]))]
    )


def fold_one(values: Floats, signs: Signs) -> Floats:
    """Return the (r, ...) coefficients of one component (columns, rows, ...) that goes by ``signs``."""
    part = _half(_half(values, 0, signs[0]), 1, signs[1])
    return np.asarray(part.reshape(-1, *part.shape[2:]))


def unfold(folded: Floats, signs: Signs, shape: tuple[int, int, int]) -> Floats:
    """Return the (columns, rows, components, ...) field of coefficients: the adjoint of `fold`, and its inverse within
    the class."""
    columns, rows, count = shape
    out = np.empty((columns, rows, count, *folded.shape[1:]))
    start = 0
    for number, (along, across) in enumerate(component_signs(signs, count)):
        size = _size(columns, along), _size(rows, across)
        part = folded[start : start + size[0] * size[1]].reshape(*size, *folded.shape[1:])
        start += size[0] * size[1]
        out[:, :, number] = _whole(_whole(part, 1, across, rows), 0, along, columns)
    return out


@dataclass(frozen=True)
class Quarter:
    """Which markers of a layer stand for all.

    Attributes
    ----------
    columns, rows
        Of the layer.
    mirrored
        Which mirrors there are.
    """

    columns: int
    rows: int
    mirrored: tuple[bool, bool]

    @property
    def shape(self) -> tuple[int, int]:
        """(columns, rows) of the markers that stand for all."""
        return tuple((n + 1) // 2 if m else n for n, m in zip((self.columns, self.rows), self.mirrored, strict=True))  # type: ignore[return-value]

    def taken(self) -> Bools:
        """Return (columns, rows) which markers stand for all."""
        mask = np.zeros((self.columns, self.rows), bool)
        mask[: self.shape[0], : self.shape[1]] = True
        return mask


def blocks_of(
    compliance: Floats, jacobian: Floats, layers: list[Quarter], grid: tuple[int, int], signs: list[Signs]
) -> list[Floats]:
    """Return by class the (m, r) block of a transfer matrix.

    A marker that stands for others is worth the root of the number of its images; on a mirror only even components are
    left. All classes are made at once, since sums and differences of mirrored sites serve several.

    Parameters
    ----------
    compliance
        (3 n, 3 k) mm/N of the markers that stand for all.
    jacobian
        (n, 2, 3) from their motion to data.
    layers
        The n markers, layer by layer.
    grid
        (columns, rows) of the k sites.
    signs
        The classes.
    """
    mirrored = (signs[0][0] != 0, signs[0][1] != 0)
    counts = np.array([(each.columns, each.rows) for each in layers])
    rows = np.array([[[_sizes(q, part) for part in component_signs(s, 2)] for q in map(tuple, counts)] for s in signs])
    columns = np.array([[_sizes(grid, part) for part in component_signs(s, 3)] for s in signs])
    high, wide = rows.prod(axis=-1).reshape(len(signs), -1).sum(axis=1), columns.prod(axis=-1).sum(axis=1)
    out = np.empty((len(signs), high.max(), wide.max()))
    _into_blocks(compliance, jacobian, counts, grid, mirrored, np.array(signs), rows, columns, out)
    return [out[s, : high[s], : wide[s]] for s in range(len(signs))]


def _sizes(counts: tuple[int, int], signs: Signs) -> tuple[int, int]:
    return _size(counts[0], signs[0]), _size(counts[1], signs[1])


@njit(cache=True)
def _into_blocks(
    compliance: Floats, jacobian: Floats, counts: Ints, grid: tuple[int, int], mirrored: tuple[bool, bool],
    signs: Ints, rows: Ints, columns: Ints, out: Floats,
) -> None:  # fmt: skip
    """Write the classes' blocks; ``rows`` (classes, layers, 2, 2) and ``columns`` (classes, 3, 2) are their sizes."""
    nx, ny = grid
    sums = np.empty((3, 2, 2, nx, ny))  # by component: even or odd along x and along y
    row_at = np.zeros(len(signs), np.int64)
    root, turned, begin = np.sqrt(2.0), np.array([[-1, 1], [1, -1], [1, 1]]), 0
    for layer in range(len(counts)):
        shape = (counts[layer] + 1) // 2
        for axis in range(2):
            if not mirrored[axis]:
                shape[axis] = counts[layer, axis]
        for i in range(shape[0]):
            for j in range(shape[1]):
                q = begin + i * shape[1] + j
                for a in range(2):
                    j0, j1, j2 = jacobian[q, a, 0], jacobian[q, a, 1], jacobian[q, a, 2]
                    _sums(compliance[3 * q : 3 * q + 3], j0, j1, j2, nx, ny, mirrored, sums)
                    for s in range(len(signs)):
                        row = row_at[s] + (rows[s, layer, 0, 0] * rows[s, layer, 0, 1] if a == 1 else 0)
                        high, wide = rows[s, layer, a]
                        if i >= high or j >= wide:
                            continue  # an odd component on its mirror
                        worth = 1.0
                        if mirrored[0] and 2 * i + 1 != counts[layer, 0]:
                            worth *= root
                        if mirrored[1] and 2 * j + 1 != counts[layer, 1]:
                            worth *= root
                        row += i * wide + j
                        start = 0
                        for c in range(3):
                            along = 1 if signs[s, 0] * turned[c, 0] < 0 else 0
                            across = 1 if signs[s, 1] * turned[c, 1] < 0 else 0
                            size = columns[s, c]
                            for m in range(size[0]):
                                for n in range(size[1]):
                                    out[s, row, start + n] = worth * sums[c, along, across, m, n]
                                start += size[1]
        for s in range(len(signs)):
            for a in range(2):
                row_at[s] += rows[s, layer, a, 0] * rows[s, layer, a, 1]
        begin += shape[0] * shape[1]


@njit(cache=True)
def _sums(
    three: Floats, j0: float, j1: float, j2: float, nx: int, ny: int, mirrored: tuple[bool, bool], out: Floats
) -> None:
    """Write the orthonormal sums and differences of a datum's row over mirrored sites."""
    root = np.sqrt(0.5)
    high, wide = ((nx + 1) // 2 if mirrored[0] else nx), ((ny + 1) // 2 if mirrored[1] else ny)
    for m in range(high):
        x_pair = mirrored[0] and 2 * m + 1 != nx
        for n in range(wide):
            y_pair = mirrored[1] and 2 * n + 1 != ny
            here, right = 3 * (m * ny + n), 3 * ((nx - 1 - m) * ny + n)
            above, across = 3 * (m * ny + ny - 1 - n), 3 * ((nx - 1 - m) * ny + ny - 1 - n)
            for c in range(3):
                p = j0 * three[0, here + c] + j1 * three[1, here + c] + j2 * three[2, here + c]
                even, odd, even_above, odd_above = p, 0.0, 0.0, 0.0
                if x_pair:
                    t = j0 * three[0, right + c] + j1 * three[1, right + c] + j2 * three[2, right + c]
                    even, odd = root * (p + t), root * (p - t)
                if y_pair:
                    p = j0 * three[0, above + c] + j1 * three[1, above + c] + j2 * three[2, above + c]
                    even_above = p
                    if x_pair:
                        t = j0 * three[0, across + c] + j1 * three[1, across + c] + j2 * three[2, across + c]
                        even_above, odd_above = root * (p + t), root * (p - t)
                    out[c, 0, 0, m, n], out[c, 0, 1, m, n] = root * (even + even_above), root * (even - even_above)
                    out[c, 1, 0, m, n], out[c, 1, 1, m, n] = root * (odd + odd_above), root * (odd - odd_above)
                else:
                    out[c, 0, 0, m, n], out[c, 1, 0, m, n] = even, odd


def _size(count: int, sign: int) -> int:
    return count if sign == 0 else (count + 1) // 2 if sign > 0 else count // 2


def _half(values: Floats, axis: int, sign: int) -> Floats:
    if sign == 0:
        return values
    count, before = values.shape[axis], (slice(None),) * axis
    half = count // 2
    low, high = values[(*before, slice(half))], values[(*before, slice(None, count - 1 - half, -1))]
    both = (low + sign * high) / _ROOT
    if sign > 0 and count % 2:
        both = np.concatenate([both, values[(*before, slice(half, half + 1))]], axis=axis)
    return np.asarray(both)


def _whole(part: Floats, axis: int, sign: int, count: int) -> Floats:
    if sign == 0:
        return part
    half = count // 2
    low = np.take(part, np.arange(half), axis=axis) / _ROOT
    pieces = [low]
    if count % 2:
        alone = np.zeros([1 if a == axis else n for a, n in enumerate(part.shape)])
        pieces.append(np.take(part, [half], axis=axis) if sign > 0 else alone)
    pieces.append(sign * np.flip(low, axis=axis))
    return np.concatenate(pieces, axis=axis)
