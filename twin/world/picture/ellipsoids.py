"""The markers of a deformed body as ellipsoids, which is what the camera sees.

A strained ellipsoid is again an ellipsoid, and the renderer intersects it exactly. The motion of
the markers is given: that of points of the rubber, or of stiff beads
(`twin.world.elasticity.rigid_beads`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from twin.arrays import Bools, Floats, Ints, Points, Singles, frozen
from twin.errors import InputError
from twin.parts.markers import MarkerLayer, MarkerSet
from twin.parts.part import Purpose

_WAVES = 8
"""Plane waves that make a texture."""

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
    texture
        (n, k, 5) wave vectors on the unit ball, phases and amplitudes of the colour's brightness;
        None: all are even.
    """

    centres: Points
    axes: Floats
    colour: Floats
    gloss: Floats | None = None
    texture: Floats | None = None

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
            texture=None if self.texture is None else self.texture[which],
        )

    def shade(self, which: Ints, unit: Points) -> Singles:
        """Return (m,) factors of the texture on the brightness of markers of numbers ``which`` (m,)
        at places ``unit`` (m, 3) of the unit ball."""
        assert self.texture is not None
        total = np.ones(len(which), np.float32)
        x, y, z = unit.astype(np.float32).T
        for wave in self.texture.astype(np.float32).transpose(1, 2, 0):
            a, b, c, phase, size = wave.take(which, axis=1)
            total += size * np.cos(a * x + b * y + c * z + phase)
        return np.maximum(total, np.float32(0))

    @staticmethod
    def of(
        markers: MarkerSet,
        layers: Mapping[str, MarkerLayer],
        displacement: Points | None = None,
        gradient: Floats | None = None,
        prints: MarkerSet.Prints | None = None,
        seed: int = 1,
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
        seed
            Of the markers' textures.

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
        # A bead keeps its shape and turns with the rubber; a print strains with it.
        for name, layer in layers.items():
            rows = markers.of(name)
            normals = markers.normals[rows]
            if layer.kind == "bead":
                rest, moved = np.eye(3), _turn(g[rows])
            else:
                sizes = np.array([1.0, 1.0, PRINT_THICKNESS])
                rest, moved = _level_frames(normals) * sizes, np.eye(3) + g[rows]
            if prints is not None:
                rest = _oval(normals, prints.longer[rows], prints.way_rad[rows]) @ rest
            axes[rows] = layer.diameter_mm / 2 * (moved @ rest)
            colour[rows] = layer.colour
            gloss[rows] = layer.gloss or 0.0
        texture = None
        if any(layer.texture for layer in layers.values()):
            texture = _waves(n, seed).copy()
            for name, layer in layers.items():
                spread, grain = layer.texture or (0.0, 1.0)
                texture[markers.of(name), :, :3] *= np.pi / (2 * grain)
                texture[markers.of(name), :, 4] *= spread
        # Deviations of single markers: size, colour, or no marker at all.
        if prints is not None:
            axes *= prints.size[:, None, None]
            axes[prints.missing] = np.nan
            colour = np.clip(colour * prints.shade[:, None] * prints.tint, 0, 1)
        return Ellipsoids(
            centres=frozen(markers.points + u),
            axes=frozen(axes),
            colour=frozen(colour),
            gloss=frozen(gloss) if gloss.any() else None,
            texture=None if texture is None else frozen(texture),
        )


@lru_cache(maxsize=4)
def _waves(count: int, seed: int) -> Floats:
    """Return (count, k, 5) waves of `Ellipsoids.texture` of a length of about 1 and of a standard
    deviation of 1 in all."""
    rng = Purpose.PRINT.stream(seed, 2)
    way = rng.standard_normal((count, _WAVES, 3))
    way *= rng.uniform(0.7, 1.3, (count, _WAVES, 1)) / np.linalg.norm(way, axis=2, keepdims=True)
    phase = rng.uniform(0, 2 * np.pi, (count, _WAVES, 1))
    return np.concatenate([way, phase, np.full_like(phase, np.sqrt(2 / _WAVES))], axis=2)


def _oval(normals: Floats, longer: Floats, way_rad: Floats) -> Floats:
    """Return (m, 3, 3) maps that stretch by (m,) factors at (m,) angles across normals (m, 3), and
    compress by as much at right angles to that."""
    frames = _level_frames(normals)
    cosine, sine = np.cos(way_rad)[:, None], np.sin(way_rad)[:, None]
    along = cosine * frames[:, :, 0] + sine * frames[:, :, 1]
    across = cosine * frames[:, :, 1] - sine * frames[:, :, 0]
    parts = ((longer - 1, along), (1 / longer - 1, across))
    return np.eye(3) + sum(by[:, None, None] * d[:, :, None] * d[:, None] for by, d in parts)


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
