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

from twin.arrays import Bools, Floats
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
        camera.pupil_mm[axis] == 0 and all(layer.offset_mm[axis] == 0 for layer in scene.markers.values())
        for axis in (0, 1)
    ]
    return (along[0], along[1])


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
    parts = []
    for number, (along, across) in enumerate(component_signs(signs, values.shape[2])):
        part = _half(_half(values[:, :, number], 0, along), 1, across)
        parts.append(part.reshape(-1, *part.shape[2:]))
    return np.concatenate(parts)


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

    def rows_of(self, values: Floats, signs: Signs) -> Floats:
        """Return (r, ...) rows of a class's block from (columns, rows, 2, ...) of the markers that stand for all.

        Each is worth the root of the number of its images; on a mirror only even components are left.
        """
        parts = []
        for number, each in enumerate(component_signs(signs, 2)):
            part = values[:, :, number]
            for axis, (sign, count) in enumerate(zip(each, (self.columns, self.rows), strict=True)):
                if sign:
                    part = np.take(part, np.arange(_size(count, sign)), axis=axis)
                    worth = np.full(part.shape[axis], _ROOT)
                    if sign > 0 and count % 2:
                        worth[-1] = 1.0
                    part = part * worth.reshape([-1 if a == axis else 1 for a in range(part.ndim)])
            parts.append(part.reshape(-1, *part.shape[2:]))
        return np.concatenate(parts)


def _size(count: int, sign: int) -> int:
    return count if sign == 0 else (count + 1) // 2 if sign > 0 else count // 2


def _half(values: Floats, axis: int, sign: int) -> Floats:
    if sign == 0:
        return values
    turned = np.moveaxis(values, axis, 0)
    count = len(turned)
    half = count // 2
    both = (turned[:half] + sign * turned[: count - 1 - half : -1]) / _ROOT
    if sign > 0 and count % 2:
        both = np.concatenate([both, turned[half : half + 1]])
    return np.asarray(np.moveaxis(both, 0, axis))


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
