"""Where lights behind flat layers stand for whom looks from inside the body, ray by ray in numba.

The same formulas as everywhere else, `twin.theory.optics`, compiled: a picture needs one ray for each marker and LED,
which as whole arrays took longer than all that is done about the markers themselves.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twin.arrays import Floats, Points
from twin.compiled import njit
from twin.parts.camera import Layer
from twin.theory import optics
from twin.theory.stack import tangent

_reflection = njit()(optics.reflection)


def images(
    points: Points, lights: Points, layers: tuple[Layer, ...], index: float, base_z_mm: float
) -> tuple[Points, Floats, Points, Floats]:
    """Return where each of the lights in air seems to stand, from each of the points in the body.

    Parameters
    ----------
    points
        (n, 3) in the body, mm.
    lights
        (m, 3) in air, behind the layers, mm.
    layers, index, base_z_mm
        The layers, the body's refractive index, and the height of its base.

    Returns
    -------
    place
        (n, m, 3) a virtual source there of ``power`` makes the irradiance that the light does, mm.
    power
        (n, m) of a light of intensity 1 in all directions.
    crossing
        (n, m, 3) where its ray enters the body, mm.
    leaving
        (n, m) cosine of the angle to z at which it leaves the light. All are NaN where no ray leads there.

    Notes
    -----
    A cone dp of a light's rays, of intensity 1, fills a ring dr of the body: the flux through a surface across the ray
    is E = sin(a) sin(a) da / (r dr cos(b)), a and b the angles in air and body, times Fresnel's transmission.
    """
    stack = np.array([(layer.thickness_mm, layer.index) for layer in layers]).reshape(-1, 2)
    found: tuple[Points, Floats, Points, Floats] = _images(
        np.ascontiguousarray(points, float), np.ascontiguousarray(lights, float), stack, index, base_z_mm
    )
    return found


@njit(cache=True, nogil=True)
def _images(points: Points, lights: Points, stack: Floats, index: float, base: float) -> Any:
    n, m = len(points), len(lights)
    place, crossing = np.empty((n, m, 3)), np.empty((n, m, 3))
    power, leaving = np.empty((n, m)), np.empty((n, m))
    back = base + stack[:, 0].sum()
    for i in range(n):
        x, y, z = points[i]
        depth = max(base - z, 0.0)
        for j in range(m):
            across, along = lights[j, 0] - x, lights[j, 1] - y
            reach = np.sqrt(across * across + along * along)
            p, slope = tangent(reach, depth, index, stack, max(lights[j, 2] - back, 0.0))
            # p over the reach tends to 1 over the slope on the axis; the way aside is nothing there.
            over, aside = (p / reach, 1 / reach) if reach > 1e-9 else (1 / slope, 1.0)
            cosine_air = 1 / np.sqrt(1 + p * p)
            sine = p * cosine_air / index
            cosine = np.sqrt(1 - sine * sine)
            distance = index / np.sqrt(cosine_air**3 * over / (slope * cosine))
            ux, uy = across * sine * aside, along * sine * aside
            place[i, j] = x + ux * distance, y + uy * distance, z + cosine * distance
            there = depth / cosine
            crossing[i, j] = x + ux * there, y + uy * there, z + depth
            leaving[i, j] = cosine_air
            # The image's distance squared times the spread is the index squared.
            power[i, j] = index * index * _transmission(p, index, stack)
    return place, power, crossing, leaving


@njit(cache=True, nogil=True)
def _transmission(p: float, index: float, stack: Floats) -> float:
    share, one = 1.0, index
    for layer in range(len(stack) + 1):
        two = stack[layer, 1] if layer < len(stack) else 1.0
        share *= (1 - _reflection(p, one, two)) / (1 - ((one - two) / (one + two)) ** 2)
        one = two
    return share
