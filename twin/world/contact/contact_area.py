"""The area of a contact under a smooth probe, from where its squared pressures vanish."""

from __future__ import annotations

import math

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit
from twin.parts.probe import Cone, Sphere
from twin.world.contact.inner import inner
from twin.world.contact.patches import Patches
from twin.world.contact.together import Setting
from twin.world.contact.unilateral import Equilibrium

_RAYS, _ALONG, _STRIDE, _NEAR, _FAR = 60, 240, 8, 0.3, 1.5
"""Rays from a contact's middle along which its end is sought, steps along each, how many are taken at once where the
end is further on, and where over its size."""

_EVEN = 1.0 + 1e-9
"""Pressures of patches that lie alike are equal up to this."""

_OWN = 1e-9
"""Share of a term that those before it don't make up, from which on it counts."""

_FEWEST, _APART = 12, 0.15
"""Patches from which on a fit is made, and how far it may be from their sum."""


def contact_area(setting: Setting, patches: Patches, equilibrium: Equilibrium) -> float:
    """Return the area of the contact, mm2.

    Notes
    -----
    Under any smooth probe the squared pressure vanishes linearly at the contact's border. Hertz's is a quadratic of the
    place everywhere, a cone's is near the border, with a fourth-order term; where the fit vanishes, the contact ends.
    Validity: contacts near an ellipse, a sphere with a/R below about 0.6 (0.3 % of the radius, a cone 0.5 %, at 16
    patches across); the fit is dropped for the sum of the patches, which is 1 to 4 % off, where the two differ by more
    than 15 %, below 12 patches, and under any other probe.
    """
    cone = isinstance(setting.probe, Cone)
    smooth = cone or isinstance(setting.probe, Sphere)
    return float(_area(patches.middle_mm, patches.cell_mm, patches.half_mm, equilibrium.force_n, equilibrium.active,
                       smooth, cone))  # fmt: skip


@njit(cache=True)
def _area(
    middle: Floats, cell: Floats, half: Floats, force: Floats, active: Bools, smooth: bool, fourth: bool
) -> float:
    """Return the area of the patches in contact, or of the fit to their squared pressures, mm2."""
    rows = np.flatnonzero(active)
    counted, flat, pressure, place = 0.0, 0.0, np.empty(len(rows)), np.empty((len(rows), 2))
    for n, i in enumerate(rows):
        area = 4.0 * half[i, 0] * half[i, 1]
        counted += area
        flat += 4.0 * cell[i, 0] * cell[i, 1]
        pressure[n], place[n, 0], place[n, 1] = force[i, 2] / area, middle[i, 0], middle[i, 1]
    if not smooth or len(rows) < _FEWEST:
        return counted
    used = np.arange(len(rows))
    if fourth:
        rising = np.sort(pressure)
        used = np.flatnonzero(pressure <= _EVEN * (rising[(len(rows) - 1) // 2] + rising[len(rows) // 2]) / 2.0)
    found, size = _fitted(place, pressure, used, fourth)
    fitted = math.pi * _squared_radius(found, size) * counted / flat
    return fitted if abs(fitted / counted - 1.0) < _APART else counted


@njit(cache=True)
def _fitted(place: Floats, pressure: Floats, used: Ints, fourth: bool) -> tuple[Floats, float]:
    """Return (6,) or (7,) coefficients of the polynomial nearest to squared pressures, and the size it is scaled by.

    Of 1, u, v, u^2, u v, v^2 and, with ``fourth``, (u^2 + v^2)^2, of those pressures alone that are ``used``. By
    orthogonalising each term to those before it, twice over in effect, as the right-hand side is a term itself. A term
    that those before it make up, as on patches in two rows, is left out.
    """
    n = len(pressure)
    middle = place.sum(axis=0) / n
    size, most = 0.0, pressure.max()
    for i in range(n):
        size = max(size, abs(place[i, 0] - middle[0]), abs(place[i, 1] - middle[1]))
    count = 7 if fourth else 6
    terms, triangle = np.empty((count + 1, len(used))), np.zeros((count + 1, count + 1))
    for i in range(len(used)):
        u, v = (place[used[i], 0] - middle[0]) / size, (place[used[i], 1] - middle[1]) / size
        terms[0, i], terms[1, i], terms[2, i] = 1.0, u, v
        terms[3, i], terms[4, i], terms[5, i] = u * u, u * v, v * v
        if fourth:
            terms[6, i] = (u * u + v * v) ** 2
        terms[count, i] = (pressure[used[i]] / most) ** 2
    whole = np.array([math.sqrt(inner(term, term)) for term in terms])
    for a in range(count):
        own = math.sqrt(inner(terms[a], terms[a]))
        triangle[a, a] = own if own > _OWN * whole[a] else math.inf
        for i in range(len(used)):
            terms[a, i] /= triangle[a, a]
        for b in range(a + 1, count + 1):
            triangle[a, b] = inner(terms[a], terms[b])
            for i in range(len(used)):
                terms[b, i] -= triangle[a, b] * terms[a, i]
    found = np.zeros(count)
    for a in range(count - 1, -1, -1):
        found[a] = (triangle[a, count] - (triangle[a, a + 1 : count] * found[a + 1 :]).sum()) / triangle[a, a]
    return found, size


@njit(cache=True)
def _at(radius: float, constant: float, first: float, second: float, fourth: float) -> float:
    return constant + radius * (first + radius * (second + radius**2 * fourth))


@njit(cache=True)
def _squared_radius(found: Floats, size: float) -> float:
    """Return the mean square of how far from the middle a polynomial of `_fitted` vanishes, mm2; inf if it doesn't."""
    total, step = 0.0, (_FAR - _NEAR) / (_ALONG - 1)
    fourth = found[6] if len(found) > 6 else 0.0
    for ray in range(_RAYS):
        angle = ray * 2.0 * math.pi / _RAYS
        cosine, sine = math.cos(angle), math.sin(angle)
        first = found[1] * cosine + found[2] * sine
        second = found[3] * cosine**2 + found[4] * cosine * sine + found[5] * sine**2
        bend = (_STRIDE * step) ** 2 / 4.0 * (abs(second) + 6.0 * abs(fourth) * _FAR**2)
        steps, here = 0, _at(_NEAR, found[0], first, second, fourth)
        while here >= 0.0 and steps < _ALONG - 1:
            ahead = _at(_NEAR + (steps + _STRIDE) * step, found[0], first, second, fourth)
            if min(here, ahead) > bend:  # it can't bend below 0 in between
                steps, here = steps + _STRIDE, ahead
            else:
                steps += 1
                here = _at(_NEAR + steps * step, found[0], first, second, fourth)
        if here >= 0.0 or steps == 0:
            return math.inf
        radius = _NEAR + steps * step
        before = _at(radius - step, found[0], first, second, fourth)
        total += (radius - step * here / (here - before)) ** 2
    return size**2 * total / _RAYS
