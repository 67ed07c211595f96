"""The markers of a deformed body as ellipsoids, which is what the camera sees.

A strained ellipsoid is again an ellipsoid, and the renderer intersects it exactly. The motion of
the markers is given: that of points of the rubber, or of stiff beads
(`twin.world.elasticity.rigid_beads`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Points, frozen
from twin.errors import InputError
from twin.parts.markers import MarkerLayer, MarkerSet

PRINT_THICKNESS = 0.1
"""Thickness of a print over its diameter (assumed: silk-screen ink about 0.05 mm thick)."""


@dataclass(frozen=True, kw_only=True)
class Ellipsoids:
    """Marker shapes in their one order: all points centre + axes @ u with |u| <= 1.

    Attributes
    ----------
    centres
        (n, 3) mm; NaN for a lost marker, which keeps its row.
    axes
        (n, 3, 3) mm, a semi-axis vector in every column (conjugate, not always orthogonal).
    colour
        (n, 3) diffuse reflectance, red, green, blue.
    gloss
        (n, 2) refractive index and roughness of a smooth skin, 0 for none; None: none has one.
    """

    centres: Points
    axes: Floats
    colour: Floats
    gloss: Floats | None = None

    def __len__(self) -> int:
        return len(self.centres)

    @cached_property
    def present(self) -> Bools:
        """(n,) which markers exist."""
        numbers = np.concatenate([self.centres, self.axes.reshape(-1, 9)], axis=1)
        return np.asarray(np.all(np.isfinite(numbers), axis=1))

    def rows(self, which: Bools | slice) -> Ellipsoids:
        """Return some of the markers."""
        return Ellipsoids(
            centres=self.centres[which],
            axes=self.axes[which],
            colour=self.colour[which],
            gloss=None if self.gloss is None else self.gloss[which],
        )

    @staticmethod
    def of(
        markers: MarkerSet,
        layers: Mapping[str, MarkerLayer],
        displacement: Points | None = None,
        gradient: Floats | None = None,
        prints: MarkerSet.Prints | None = None,
    ) -> Ellipsoids:
        """Return markers that move with the body.

        A bead moves by u and turns by the antisymmetric part of the gradient; a print is a thin
        disc in its level set, mapped by F = I + du/dx.

        Parameters
        ----------
        markers, layers
            The markers at rest, and their layers by name.
        displacement
            (n, 3) displacement u of the centres, mm; NaN marks a lost marker; None at rest.
        gradient
            (n, 3, 3) displacement gradients du_i/dx_j there; None: markers are carried without
            turning or straining.
        prints
            How single markers differ from their layer; None: not at all.

        Raises
        ------
        InputError
            Arrays of another length than the markers.
        """
        n = len(markers)
        u = np.zeros((n, 3)) if displacement is None else np.asarray(displacement, float)
        g = np.zeros((n, 3, 3)) if gradient is None else np.asarray(gradient, float)
        if u.shape != (n, 3) or g.shape != (n, 3, 3):
            raise InputError(
                f"displacement {u.shape} and gradient {g.shape} must be ({n}, 3) and ({n}, 3, 3): "
                "one row per marker"
            )
        axes = np.zeros((n, 3, 3))
        colour = np.zeros((n, 3))
        gloss = np.zeros((n, 2))
        # A bead stays a sphere and turns with the rubber; a print strains with it.
        for name, layer in layers.items():
            rows = markers.of(name)
            radius = layer.diameter_mm / 2
            if layer.kind == "bead":
                axes[rows] = radius * _turn(g[rows])
            else:
                sizes = radius * np.array([1.0, 1.0, PRINT_THICKNESS])
                disc = _level_frames(markers.normals[rows]) * sizes
                axes[rows] = (np.eye(3) + g[rows]) @ disc
            colour[rows] = layer.colour
            gloss[rows] = layer.gloss or 0.0
        # Deviations of single markers: size, shade, or no marker at all.
        if prints is not None:
            axes *= prints.size[:, None, None]
            axes[prints.missing] = np.nan
            colour = np.clip(colour * prints.shade[:, None], 0, 1)
        return Ellipsoids(
            centres=frozen(markers.points + u),
            axes=frozen(axes),
            colour=frozen(colour),
            gloss=frozen(gloss) if gloss.any() else None,
        )


def _turn(gradient: Floats) -> Floats:
    """Return (n, 3, 3) rotations by the axial vector of the gradients' antisymmetric parts
    (Rodrigues' formula)."""
    spin = (gradient - np.swapaxes(gradient, 1, 2)) / 2
    angle = np.sqrt(np.sum(spin**2, axis=(1, 2)) / 2)[:, None, None]
    turn: Floats = (
        np.eye(3)
        + np.sinc(angle / np.pi) * spin
        + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * (spin @ spin)
    )
    return turn


def _level_frames(normals: Floats) -> Floats:
    """Return (n, 3, 3) orthonormal frames with the normal in the last column."""
    other = np.where(np.abs(normals[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.cross(other, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first), normals], axis=2)
