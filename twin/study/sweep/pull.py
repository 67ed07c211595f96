"""How the tracker's fit answers to shadows on a marker. Compiled kernels only.

A marker's picture is fitted as the tracker does (`twin.sense.fit`): a blurred disc of brightness level + bulge f, f the
squared distance over the squared radius. With w(r) the weight that it gives a pixel whose residual is r, J the
picture's change with the centre and s its change with a neighbour's place, the fit that has settled at rest moves by

    (sum (w r)' J J^T)^-1 sum (w r)' J s^T,    w = (1 + r^2 / c^2)^-2,    (w r)' = (1 - 3 r^2 / c^2) / (1 + r^2 / c^2)^3

per motion of the neighbour (the influence function of an M-estimator, P. J. Huber, Robust Statistics, 1981, 3.2).

Residuals are linear in nine rows of numbers by pixel, so that all sums of a step are parts of one weighted product of
these rows with themselves.

Validity: that of `twin.study.sweep.shadows`; ground and size, which the tracker fits as well, are held.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Bools, Floats, Ints
from twin.compiled import njit
from twin.sense.fit import IMPERFECT, OUTLIER_SD, SHARE
from twin.sense.template import USUAL_BLUR_PX

TURNS = 3
"""Steps by which the fit to a marker at rest settles."""

ONE, COVER, RISE, ALONG, ALONG_RISE, ACROSS, ACROSS_RISE, SEEN, LIT, ROWS = range(10)
"""Rows of a marker's pixels: 1; the marker in even light of brightness 1, and that times f; its change along columns,
and that times f; along rows; the marker as it is; without shadows."""

SPREAD, MISFIT = range(2)
"""Of a fit: variance of the centre over that in full light, and squared residuals over what noise explains."""

UNMODELLED = 0.01
"""What the tracker's disc lacks of a marker in even light, root mean square over its brightness (measured: 0.011)."""


@njit(cache=True)
def pulls(
    layer: Ints, points: Floats, radius: Floats, radius_px: Floats, rounded: Bools, across: Floats, towards: Floats,
    way: Floats, shine: Floats, even: float, first: Ints, members: Ints, noise: Floats, blur: float,
) -> tuple[Floats, Ints, Ints, Floats]:  # fmt: skip
    """Return (n, 2) `SPREAD` and `MISFIT`, ones in layers without shadows; and markers (m,), neighbours (m,) and pulls
    (m, 2, 3), px/mm.

    Parameters
    ----------
    layer, points, radius, radius_px, rounded
        (n,) number of the layer, (n, 3) and (n,) mm, (n,) px, and whether markers are spheres.
    across, towards
        (n, 3, 2) mm/px, and (n, 3) unit vectors to the camera.
    way, shine, even
        (n, lamps, 3) unit vectors to the lamps, (n, lamps) brightness that each gives a surface across its light; and
        what comes from all sides. The brightest marker's middle is 1.
    first, members
        Of `twin.world.picture.occluders.Occluders`.
    noise
        (layers, 2) variance of a pixel of the ground, and of brightness 1.
    blur
        Half width of the biweight that stands for the blur, px.
    """
    n, lamps = shine.shape
    told, inside = np.ones((n, 2)), np.full(n, np.nan)
    shadowed = np.zeros(len(noise), np.bool_)
    for one in range(n):
        shadowed[layer[one]] |= first[one * lamps] < first[(one + 1) * lamps]
    looked = np.flatnonzero(shadowed[layer])
    views = [(np.empty((0, 0)), np.empty((0, 0, 0))) for _ in range(0)]
    for i in looked:
        views.append(_lit(
            points, radius, radius_px[i], rounded[i], across[i], towards[i], way[i], shine[i], even,
            first[i * lamps : (i + 1) * lamps + 1], members, blur, i, noise[layer[i]], inside[i : i + 1],
        ))  # fmt: skip
    found = noise[:, 1].copy()
    for number in range(len(noise)):
        alike = inside[(layer == number) & np.isfinite(inside)]
        if len(alike):
            found[number] = np.median(alike)
    marker, neighbour, count = np.empty(len(members), np.int64), np.empty(len(members), np.int64), 0
    pull = np.zeros((len(members), 2, 3))
    for at, i in enumerate(looked):
        rows, changes = views[at]
        told[i], answer = _settled(rows, noise[layer[i]], found[layer[i]])
        begin = count
        for k in range(len(changes)):
            j, row = members[first[i * lamps] + k], begin
            while row < count and neighbour[row] != j:
                row += 1
            if row == count:
                marker[count], neighbour[count], count = i, j, count + 1
            pull[row] += answer @ changes[k].T
    return told, marker[:count].copy(), neighbour[:count].copy(), pull[:count].copy()


@njit(cache=True)
def _lit(  # type: ignore[no-untyped-def]
    points, radius, radius_px, rounded, across, towards, way, shine, even, first, members, blur, i, noise, inside
):  # fmt: skip
    """Return (`ROWS`, m) pixels of a marker, and (k, 3, m) how they change with the place of each of its ``members``;
    write the variance inside as the tracker finds it.

    That (`twin.sense.fit_rest.noise_variances`) is made of 2 x 2 differences, in which shadows' edges count.
    """
    rows, place, where = _disc(radius[i], radius_px, rounded, across, towards, blur)
    size, steep = len(where), radius_px / radius[i] / blur
    changes, dark = np.empty((first[-1] - first[0], 3, size)), np.empty((first[-1] - first[0], size))
    normal = place / radius[i] if rounded else towards.reshape(3, 1) * np.ones((1, size))
    seen, lit = np.full(size, even), np.full(size, even)
    for lamp in range(len(shine)):
        x, y, z = way[lamp]
        falls, clear = np.empty(size), np.ones(size)
        for p in range(size):
            falls[p] = shine[lamp] * max(normal[0, p] * x + normal[1, p] * y + normal[2, p] * z, 0.0)
        low, high = first[lamp] - first[0], first[lamp + 1] - first[0]
        for k in range(low, high):
            j = members[first[0] + k]
            _shade(points[j] - points[i], radius[j], x, y, z, place, steep, dark[k], changes[k])
            clear *= 1.0 - dark[k]
        for k in range(low, high):
            changes[k] *= rows[COVER] * falls * clear / np.maximum(1.0 - dark[k], 1e-6)
        seen += falls * clear
        lit += falls
    rows[SEEN], rows[LIT] = rows[COVER] * seen, rows[COVER] * lit
    reach = int(np.ceil(radius_px + blur))
    inner, total, count = max(radius_px - USUAL_BLUR_PX, 0.0) ** 2, 0.0, 0
    side, picture = 2 * reach + 1, np.zeros((2 * reach + 1) ** 2)
    picture[where] = rows[SEEN]
    for y in range(-reach, reach):
        for x in range(-reach, reach):
            if max(x * x, (x + 1) ** 2) + max(y * y, (y + 1) ** 2) < inner:
                p = (y + reach) * side + x + reach
                twist = picture[p] - picture[p + 1] - picture[p + side] + picture[p + side + 1]
                total, count = total + 0.25 * twist * twist + noise[0] + (noise[1] - noise[0]) * picture[p], count + 1
    inside[0] = total / count if count > 2 else np.nan
    return rows, changes


@njit(cache=True)
def _disc(
    radius: float, radius_px: float, rounded: bool, across: Floats, towards: Floats, blur: float
) -> tuple[Floats, Floats, Ints]:
    """Return a marker's pixels: (`ROWS`, m) but for its light; (3, m) what place on the marker each shows, from its
    centre, mm; and (m,) their numbers in a square around it, row by row."""
    reach = int(np.ceil(radius_px + blur))
    rows, place = np.ones((ROWS, (2 * reach + 1) ** 2)), np.zeros((3, (2 * reach + 1) ** 2))
    where, m = np.empty((2 * reach + 1) ** 2, np.int64), 0
    for row in range(-reach, reach + 1):
        for column in range(-reach, reach + 1):
            rho = max(np.sqrt(float(row * row + column * column)), 1e-9)
            cover, slope = _edge((radius_px - rho) / blur)
            if cover <= 0.0:
                continue
            # a pixel at the rim shows what lies inwards of it: the mean of a Gaussian's part on the marker
            inward, square = min(max(rho - blur * slope / (7.0 * cover), 0.0), radius_px) / rho, 0.0
            for k in range(3):
                place[k, m] = (across[k, 0] * column + across[k, 1] * row) * inward
                square += place[k, m] ** 2
            height = np.sqrt(max(radius * radius - square, 0.0)) if rounded else 0.0
            for k in range(3):
                place[k, m] += height * towards[k]
            f, steep = min((rho / radius_px) ** 2, 1.0), slope / blur / rho
            rows[COVER, m], rows[ALONG, m], rows[ACROSS, m] = cover, steep * column, steep * row
            for plain in (COVER, ALONG, ACROSS):
                rows[plain + 1, m] = rows[plain, m] * f
            where[m] = (row + reach) * (2 * reach + 1) + column + reach
            m += 1
    return rows[:, :m].copy(), place[:, :m].copy(), where[:m].copy()


@njit(cache=True)
def _shade(apart, radius, wx, wy, wz, place, steep, dark, change):  # type: ignore[no-untyped-def]
    """Write the (m,) share of a lamp's light that a neighbour takes from pixels, and (3, m) how the share that is left
    changes with its place, 1/mm; ``apart`` is from the marker to the neighbour, ``steep`` 1/mm of the edge."""
    if apart[0] * wx + apart[1] * wy + apart[2] * wz <= 0.0:
        dark[:], change[:] = 0.0, 0.0
        return
    for p in range(len(dark)):
        x, y, z = apart[0] - place[0, p], apart[1] - place[1, p], apart[2] - place[2, p]
        along = x * wx + y * wy + z * wz
        x, y, z = x - along * wx, y - along * wy, z - along * wz
        aside = np.sqrt(x * x + y * y + z * z)
        dark[p], slope = _edge((radius - aside) * steep)
        slope *= steep / max(aside, 1e-9)
        change[0, p], change[1, p], change[2, p] = slope * x, slope * y, slope * z


@njit(cache=True)
def _settled(rows: Floats, noise: Floats, inside: float) -> tuple[Floats, Floats]:
    """Return `SPREAD` and `MISFIT` of a fit at rest, and (2, m) by how many px brightness of each pixel moves it.

    ``noise`` is as it is, ``inside`` that in the marker as the tracker finds it.
    """
    told, parts = np.empty(2), np.zeros(ROWS)  # residuals are parts @ rows
    more, believed, size = noise[1] - noise[0], inside - noise[0], rows.shape[1]
    square = np.zeros(size)
    sums = rows @ rows.T
    level, bulge = _levels(sums, LIT)
    xx, xy, yy = _moments(sums, level, bulge)
    full = (xx + yy) / (xx * yy - xy * xy) * (noise[0] + 0.5 * more * (level + bulge))
    level, bulge = _levels(sums, SEEN)
    wide, x, y = 1e9, 0.0, 0.0
    for _turn in range(TURNS):
        parts[SEEN], parts[COVER], parts[RISE] = 1.0, -level, -bulge
        parts[ALONG], parts[ALONG_RISE] = -x * level, -x * bulge
        parts[ACROSS], parts[ACROSS_RISE] = -y * level, -y * bulge
        square = parts @ rows
        square *= square / wide
        sums = (rows * (1.0 / ((1.0 + square) * (1.0 + square)))) @ rows.T
        n, rr, lit = sums[ONE, ONE], parts @ sums @ parts, level * sums[ONE, COVER] + bulge * sums[ONE, RISE]
        xx, xy, yy = _moments(sums, level, bulge)
        determinant = max(xx * yy - xy * xy, 1e-12)
        told[SPREAD] = (xx + yy) / determinant * (noise[0] + 0.5 * believed * (1.0 + bulge / level)) / full
        told[MISFIT] = rr + noise[0] * n + more * lit + n * (UNMODELLED * level) ** 2
        told[MISFIT] /= noise[0] * n + believed * lit / level
        wide = OUTLIER_SD**2 * (max(inside, SHARE * rr / n) + (IMPERFECT * level) ** 2)
        left = sums[:, SEEN] - level * sums[:, COVER] - bulge * sums[:, RISE]
        x, y = level * left[ALONG] + bulge * left[ALONG_RISE], level * left[ACROSS] + bulge * left[ACROSS_RISE]
        x, y = (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant
        level, bulge = _levels(sums, SEEN)
    steer = (1.0 - 3.0 * square) / ((1.0 + square) * (1.0 + square) * (1.0 + square))
    along, down = level * rows[ALONG] + bulge * rows[ALONG_RISE], level * rows[ACROSS] + bulge * rows[ACROSS_RISE]
    xx, xy, yy = (steer * along * along).sum(), (steer * along * down).sum(), (steer * down * down).sum()
    determinant = max(xx * yy - xy * xy, 1e-12)
    along, down = steer * along, steer * down
    answer = np.empty((2, size))
    answer[0], answer[1] = (yy * along - xy * down) / determinant, (xx * down - xy * along) / determinant
    return told, answer


@njit(cache=True, inline="always")
def _levels(sums, picture):  # type: ignore[no-untyped-def]
    """Return level and bulge of the picture in a row."""
    determinant = max(sums[COVER, COVER] * sums[RISE, RISE] - sums[COVER, RISE] ** 2, 1e-12)
    level = (sums[RISE, RISE] * sums[COVER, picture] - sums[COVER, RISE] * sums[RISE, picture]) / determinant
    bulge = (sums[COVER, COVER] * sums[RISE, picture] - sums[COVER, RISE] * sums[COVER, picture]) / determinant
    return max(level, 1e-3), bulge


@njit(cache=True, inline="always")
def _moments(sums, level, bulge):  # type: ignore[no-untyped-def]
    """Return the sums of J J^T: xx, xy, yy."""
    flat, both, round_ = level * level, level * bulge, bulge * bulge
    xx = flat * sums[ALONG, ALONG] + 2 * both * sums[ALONG, ALONG_RISE] + round_ * sums[ALONG_RISE, ALONG_RISE]
    yy = flat * sums[ACROSS, ACROSS] + 2 * both * sums[ACROSS, ACROSS_RISE] + round_ * sums[ACROSS_RISE, ACROSS_RISE]
    mixed = sums[ALONG, ACROSS_RISE] + sums[ALONG_RISE, ACROSS]
    return xx, flat * sums[ALONG, ACROSS] + both * mixed + round_ * sums[ALONG_RISE, ACROSS_RISE], yy


@njit(cache=True, inline="always")
def _edge(inside):  # type: ignore[no-untyped-def]
    """Return the integral of a biweight, which stands for a blurred edge, and its slope."""
    v = min(max(inside, -1.0), 1.0)
    v2 = v * v
    return 0.5 + v * (15 / 16 - v2 * (10 / 16 - v2 * 3 / 16)), 15 / 16 * (1 - v2) ** 2
