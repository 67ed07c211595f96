"""Find the grids of markers in one rest picture, of a sensor of which no drawing is known.

Dots are what differs from the ground around them. Their colours, at most two, give a signal a
layer. In every signal spots are sought at a series of widths, and a lattice is grown through them:
from one spot outwards, each site predicted by an affine map of those around it, so that it may
turn, lean, and bend as under a wide-angle lens. The width whose lattice holds the most spots wins.
What stays off the lattice is dirt, or a reason to refuse.

Validity: dots at least 4 px wide that cover less than about a third of the ground, at least 3 x 3
of them, with fewer than half of a layer missing; a pitch that changes by less than about a fifth
from one dot to the next. A lattice of rows and columns with different pitches is taken as square.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import binary_dilation, distance_transform_edt, label, median_filter, zoom
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, Singles, frozen
from twin.display import html_table, new_axes, one_line, plot_layout
from twin.errors import InputError
from twin.sense.colour import Signal, Weights, as_picture, projections
from twin.sense.detect import CUT, Blobs

COARSE_PX = 60
"""Shorter side of the picture of which the ground is taken."""

GROUND_SHARE = 0.35
"""Width of the window of the ground's median, over the shorter side of the picture: a few pitches,
so that the dots are less than half of it."""

SURROUND, BLACK = 0.05, 0.1
"""Black around a sensor, such as its housing: it reaches the picture's frame, has the area of a
square of so much of the picture's shorter side, and less than so much of the brightest ground."""

LEAST_DN, LEAST_SNR = 8.0, 4.0
"""Least contrast of a dot, counts, and over the noise of a pixel."""

WIDTHS_PX = (4.0, 6.0, 9.0, 13.0, 19.0, 28.0, 42.0, 63.0)
"""Widths at which spots are sought; each serves dots from half to twice as wide."""

_SAMPLED = 3e6
"""Of larger pictures about so many counts are looked at for the dots' colours."""

FAINT = 0.15
"""Contrast of the faintest spot over that of the bright ones: vignetting leaves a quarter."""

SMALLEST, LARGEST = 0.3, 2.5
"""Area of a spot over the median one."""

MOST_SPOTS = 6000
"""More are texture, not dots."""

SEEDS = 16
"""Spots from which a lattice is grown, until one is good."""

ENOUGH, EVEN = 0.85, 0.07
"""A lattice is good that holds this share of the spots, with at most so large a median distance, in
pitches, between them and where their neighbours expect them."""

GATE, LAST_GATE = 0.28, 0.42
"""Largest distance between a site's prediction and its spot while a lattice grows, in pitches; and
in the end."""

STRAY, STRAY_SD = 0.08, 4.5
"""A spot that is farther than this from where its neighbours expect it is none of the lattice's: in
pitches, and in standard deviations of all spots of the lattice."""

BENT = 1.5
"""What a lens's bend adds to a misfit, over the square of how far aside the neighbours lie."""

LEAST_DOTS, LEAST_SHARE, LEAST_FILLED = 9, 0.6, 0.55
"""A lattice has at least so many dots, this share of the spots, and of its own sites."""

LARGEST_SCATTER, BY_HAND, MANY = 0.1, 0.18, 30
"""Median distance, in pitches, between the dots of a lattice and where their neighbours expect
them: at most the second where these are `MANY`, and `ENOUGH` of the spots. Measured: .02 to .06 on
drawn and rendered sensors, .12 to .18 where dots are put by hand (standard deviation .12 of the
pitch), .10 to .4 on dots without order, of which a lattice holds less than `ENOUGH`.
"""

OF_SCATTER = 1.25
"""That median over the dots' standard deviation along an axis: 1.177 for two normal numbers, times
1.06 as the neighbours scatter, too, whose weighted mean has .13 of a dot's variance."""


@dataclass(frozen=True, kw_only=True)
class FoundLayout:
    """The layers of a rest picture.

    Attributes
    ----------
    layers
        By name: of the dots' colour.
    stray_px
        (s, 2) spots that look like dots and lie on no lattice: dirt, glints.
    """

    @dataclass(frozen=True, kw_only=True)
    class Layer:
        """The dots of one colour, and the lattice that they form.

        Attributes
        ----------
        centre_px
            (n, 2) centres, px (column, row), by column, then by row.
        index
            (n, 2) column, counted from the left, and row, counted from the bottom, of every dot:
            from 0 on. Odd rows of a hexagonal lattice lie half a pitch to the right.
        lattice
            ``square`` or ``hexagonal``.
        pitch_px
            Distance of neighbouring dots, px: the mean over the layer.
        scatter_px
            Standard deviation of the dots' places about where their neighbours expect them, per
            axis, px.
        diameter_px
            Median width of the dots, px.
        angle_deg
            Turn of the rows against the picture's, from column towards row, degrees.
        colour_dn, ground_dn
            (3,) counts of red, green and blue in the dots' middle, and around them.
        polarity
            ``bright`` or ``dark`` dots on their ground.
        weights
            (r, g, b) such that r R + g G + b B is large on the dots.
        """

        centre_px: Pixels
        index: Ints
        lattice: Literal["square", "hexagonal"]
        pitch_px: float
        scatter_px: float
        diameter_px: float
        angle_deg: float
        colour_dn: Floats
        ground_dn: Floats
        polarity: Literal["bright", "dark"]
        weights: Weights

        def __len__(self) -> int:
            return len(self.centre_px)

        def __repr__(self) -> str:
            facts = [
                f"{len(self)} {self.polarity} dots",
                f"{self.columns} columns x {self.rows} rows",
                f"{self.lattice}, pitch {self.pitch_px:.4g} px",
                f"diameter {self.diameter_px:.3g} px",
            ]
            return one_line("FoundLayer", facts)

        @property
        def columns(self) -> int:
            """Number of columns that show a dot or lie between two that do."""
            return int(self.index[:, 0].max()) + 1

        @property
        def rows(self) -> int:
            """Number of rows that show a dot or lie between two that do."""
            return int(self.index[:, 1].max()) + 1

    layers: dict[str, Layer]
    stray_px: Pixels

    @property
    def layout_px(self) -> dict[str, Pixels]:
        """Centres by layer, as `twin.track` takes them."""
        return {name: layer.centre_px for name, layer in self.layers.items()}

    def __repr__(self) -> str:
        return one_line("FoundLayout", [f"{n} {value}" for n, value in self._facts().items()])

    def _repr_html_(self) -> str:
        return html_table("Layout of a rest picture", self._facts())

    def _facts(self) -> dict[str, str]:
        facts = {name: repr(layer)[len("FoundLayer(") : -1] for name, layer in self.layers.items()}
        return facts | ({"stray": f"{len(self.stray_px)} spots"} if len(self.stray_px) else {})

    def plot(self, ax: Any = None, picture: Picture | None = None) -> Any:
        """Draw the dots that were found on matplotlib axes, and return these.

        Parameters
        ----------
        ax
            Axes to draw on; new ones if None.
        picture
            Drawn below the rings.
        """
        return plot_layout(new_axes(1, ax), self.layout_px, self.stray_px, picture)


def find_layout(rest_image: Picture) -> FoundLayout:
    """Find the markers, and the lattice of each of their layers, in one picture without load.

    Parameters
    ----------
    rest_image
        (h, w, 3) or (h, w) counts.

    Raises
    ------
    InputError
        It shows no dots, or dots that form no lattice.

    Examples
    --------
    >>> import numpy as np, twin
    >>> row, column = np.mgrid[:120, :160]
    >>> away = np.hypot((row + 10) % 20 - 10, (column + 10) % 20 - 10)  # from the nearest dot
    >>> rest = np.where(away < 4, 40, 180).astype(np.uint8)
    >>> found = twin.find_layout(rest)
    >>> layer = found.layers["black"]
    >>> layer.columns, layer.rows, layer.lattice, round(layer.pitch_px)
    (7, 5, 'square', 20)
    >>> found
    FoundLayout(black 35 dark dots, 7 columns x 5 rows, square, pitch 20 px, diameter 7.57 px)
    >>> motion = twin.track(rest, rest, found.layout_px)
    """
    picture = as_picture(rest_image, "the rest picture")
    if min(picture.shape[:2]) < 32:
        height, width = picture.shape[:2]
        raise InputError(
            f"the rest picture is {width}x{height} px: a layout is found in 32x32 or more"
        )
    away, noise = _contrast(picture)
    best: list[_Layer] = []
    most = 0
    for weights in _colourings(away, noise):
        layers = [_best_lattice(away, w, noise) for w in weights]
        fine = [layer for layer in layers if layer.believed]
        if sum(map(len, fine)) > 1.1 * sum(map(len, best)):
            best = fine
        most = max(most, *(len(layer.spots) for layer in layers))
        if len(fine) == len(weights) and _explained(away, noise, fine) > ENOUGH:
            best = fine
            break
    if not best:
        raise InputError(_refusal(away, noise, most))
    return _described(picture, best)


def _contrast(picture: Picture) -> tuple[Singles, float]:
    """Return what a picture has besides its ground, (h, w, 3) counts, and the noise of a pixel.

    Where dots are dark the ground's shading is taken off: an LED's colour then doesn't look like
    the dots'. Black around the sensor doesn't count: with the dots next to it it is more than half
    of a median's window.
    """
    away, ground = _less_ground(picture, np.zeros(picture.shape[:2], bool))
    every = _every(away)
    steps = np.abs(np.diff(away[:: 2 * every], axis=1))
    noise = float(max(1.4826 * np.median(steps) / np.sqrt(2.0), 0.2))
    low, high = np.quantile(away[::every, ::every].sum(axis=2), [0.002, 0.998])
    if low < -0.25 * high:
        parts, _ = label(picture.max(axis=2) < BLACK * np.quantile(ground.max(axis=2), 0.9))
        at_frame = np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]])
        wide = np.bincount(parts.ravel()) > (SURROUND * min(parts.shape)) ** 2
        surround = wide[parts] & np.isin(parts, at_frame) & (parts > 0)
        if surround.any():
            away, ground = _less_ground(picture, surround)
            low, high = np.quantile(away.sum(axis=2), [0.002, 0.998])
    if low + high < 0:
        usual = np.median(ground, axis=(0, 1))
        away *= np.clip(usual / np.maximum(ground, 1.0), 0.25, 4.0)
    return away, noise


def _less_ground(picture: Picture, surround: Bools) -> tuple[Singles, Singles]:
    """Return what a picture has besides its ground, and that, (h, w, 3) counts; the ``surround``
    (h, w) of the sensor has nothing, and the ground of what is next to it."""
    height, width = picture.shape[:2]
    step = max(1, min(height, width) // COARSE_PX)
    coarse = picture[::step, ::step].astype(np.float32)
    if surround.any():
        around = binary_dilation(surround[::step, ::step])
        near = distance_transform_edt(around, return_distances=False, return_indices=True)
        coarse = coarse[tuple(near)]
    window = max(3, round(GROUND_SHARE * min(coarse.shape[:2])))
    middle = median_filter(coarse, size=(window, window, 1), mode="nearest")
    scale = (height / coarse.shape[0], width / coarse.shape[1], 1)
    ground = zoom(middle, scale, order=1, mode="nearest", grid_mode=True)[:height, :width]
    away = picture - ground
    away[binary_dilation(surround, iterations=2)] = 0.0
    return away, ground


def _every(away: Singles) -> int:
    """Return which rows and columns, every so many, are looked at."""
    return max(1, int(np.sqrt(away.size / _SAMPLED)))


def _colourings(away: Singles, noise: float) -> Iterator[list[Weights]]:
    """Return projections to try: of two colours apart, of one alone, with more and more faint
    pixels taken for dots."""
    every = _every(away)
    windows = sliding_window_view(away, (3, 3), axis=(0, 1))[::every, ::every]
    middle = np.partition(windows.reshape(*windows.shape[:3], 9), 4, axis=3)[..., 4]
    away = away[1:-1:every, 1:-1:every]
    strength = np.linalg.norm(middle, axis=2)
    before = np.inf
    for share in (0.9999, 0.998, 0.985):
        top = float(np.quantile(strength, share))
        if top > before / 1.2:
            continue
        before = top
        if top < max(LEAST_DN, LEAST_SNR * noise):
            return
        samples = away[(strength > max(0.3 * top, 3.0 * noise)) & away.any(axis=2)]
        samples = samples[:: max(1, len(samples) // 4000)].astype(float)
        pair = projections(samples, 2)
        if len(pair) == 2 and 0.03 < np.mean(samples @ pair[0] > 0.0) < 0.97:
            yield pair
        yield projections(samples, 1)


@dataclass(frozen=True, kw_only=True)
class _Layer:
    """Spots of one signal, their (b, 2) sites, which are on the lattice, and whether it is one."""

    weights: Weights
    spots: Blobs
    index: Ints
    on: Bools
    believed: bool

    def __len__(self) -> int:
        return int(self.on.sum())


def _best_lattice(away: Singles, weights: Weights, noise: float) -> _Layer:
    """Return the lattice that holds most of a signal's spots, at whatever width they are found."""
    signal = np.ascontiguousarray(away @ np.asarray(weights, np.float32))
    own = noise * float(np.linalg.norm(weights))
    opposed = min(weights) < -0.2 * max(weights) and max(weights) > 0
    floor = -max(LEAST_DN, 5.0 * own) if opposed else -np.inf
    signal = np.maximum(signal, np.float32(floor))
    contrast = max(LEAST_DN, LEAST_SNR * own)
    widths = [w for w in WIDTHS_PX if w < 0.2 * min(signal.shape)]
    layers = [_lattice_at(signal, width, contrast, floor, weights) for width in widths]
    best = max(layers, key=lambda layer: (layer.believed, len(layer), len(layer.spots)))
    if len(best):
        width = float(np.median(best.spots.diameter_px[best.on]))
        again = _lattice_at(signal, width, contrast, floor, weights)
        best = max(again, best, key=lambda layer: (layer.believed, len(layer)))
    return best


def _lattice_at(
    signal: Signal, width_px: float, contrast: float, floor: float, weights: Weights
) -> _Layer:
    """Return the lattice of the spots that are about as wide as ``width_px``."""
    blobs = Blobs.found_in(signal, width_px, contrast, floor)
    keep = blobs.whole & (blobs.diameter_px > 0.5 * width_px) & (blobs.diameter_px < 2.0 * width_px)
    if keep.any():
        keep &= blobs.level_dn > FAINT * np.quantile(blobs.level_dn[keep], 0.9)
        usual = float(np.median(blobs.area_px[keep]))
        keep &= (blobs.area_px > SMALLEST * usual) & (blobs.area_px < LARGEST * usual)
        # cut by the frame: nearer to it than most of their radius
        room = CUT * np.sqrt(usual / np.pi) - 0.5
        end = np.array([signal.shape[1], signal.shape[0]]) - 1
        keep &= ((blobs.centre_px > room) & (blobs.centre_px < end - room)).all(axis=1)
    spots = Blobs(**{f.name: getattr(blobs, f.name)[keep] for f in fields(Blobs)})
    index, on = np.zeros((len(spots), 2), np.int64), np.zeros(len(spots), bool)
    if LEAST_DOTS <= len(spots) <= MOST_SPOTS:
        index, on = _grow(spots.centre_px)
    believed = _believable(spots.centre_px, index, on)
    if believed:  # with the dots that lie farthest off their sites
        tree = cKDTree(spots.centre_px)
        while _add(spots.centre_px, tree, index, on, 1, LAST_GATE):
            pass
        _drop_strays(spots.centre_px, index, on)
    return _Layer(weights=weights, spots=spots, index=index, on=on, believed=believed)


def _believable(points: Pixels, index: Ints, on: Bools) -> bool:
    """Return whether spots form a lattice, and not by chance."""
    count, own = int(on.sum()), index[on]
    if count < max(LEAST_DOTS, LEAST_SHARE * len(on)) or min(np.ptp(own, axis=0)) < 2:
        return False
    spans = [np.ptp(own[own[:, 1] == row, 0]) + 1 for row in np.unique(own[:, 1])]
    if count < LEAST_FILLED * sum(spans):
        return False
    largest = BY_HAND if count >= max(MANY, ENOUGH * len(on)) else LARGEST_SCATTER
    return _scatter(own, points[on]) < largest


def _scatter(sites: Ints, places: Pixels) -> float:
    """Return the median of `_misfit` over a lattice."""
    return float(np.median(_misfit(sites, places, 0.0)))


def _misfit(sites: Ints, places: Pixels, bent: float) -> Floats:
    """Return (n,) how far spots are from where their neighbours expect them, in pitches; with
    ``bent`` less where these lie to one side, from which a bent lattice can only be continued."""
    expected, pitch, aside = _predict(sites, places, sites, own=True)
    off = np.linalg.norm(expected - places, axis=1) / pitch
    return np.asarray(off / (1.0 + bent * aside**2))


# the lattice through a cloud of spots


def _grow(points: Pixels) -> tuple[Ints, Bools]:
    """Return (b, 2) lattice sites of spots, and which spots are on the lattice."""
    tree = cKDTree(points)
    order = np.argsort(np.linalg.norm(points - np.median(points, axis=0), axis=1))
    spread = np.linspace(0, len(points) - 1, SEEDS // 2).astype(int)
    seeds = np.unique(np.concatenate([np.arange(SEEDS // 2), spread]))
    best = np.zeros((len(points), 2), np.int64), np.zeros(len(points), bool)
    for seed in order[seeds]:
        steps = _first_steps(points, tree, int(seed))
        if steps is None:
            continue
        grown = _spread(points, tree, int(seed), steps)
        if grown[1].sum() > best[1].sum():
            best = grown
        on = best[1]
        # dots by hand may also fit a lattice with a column more or less, but fewer of them
        if on.sum() >= ENOUGH * len(points) and _scatter(best[0][on], points[on]) < EVEN:
            break
    return best


def _first_steps(points: Pixels, tree: cKDTree, seed: int) -> Floats | None:
    """Return the two shortest independent steps to neighbours on either side, (2, 2) px."""
    _, near = tree.query(points[seed], k=min(17, len(points)))
    steps = points[near[1:]] - points[seed]
    length = np.linalg.norm(steps, axis=1)
    apart = np.linalg.norm(steps[:, None] + steps[None], axis=2).min(axis=1)
    steps = steps[apart < 0.25 * length]
    for one in steps[:2]:
        for two in steps:
            sine = abs(one[0] * two[1] - one[1] * two[0])
            if sine > 0.5 * np.linalg.norm(one) * np.linalg.norm(two):
                return np.array([one, two])
    return None


NEAR = np.array(list(product(range(-2, 3), repeat=2)))
AROUND = {reach: NEAR[np.abs(NEAR).max(axis=1) == reach] for reach in (1, 2)}
"""Sites at a distance of so many steps."""


def _spread(points: Pixels, tree: cKDTree, seed: int, steps: Floats) -> tuple[Ints, Bools]:
    """Grow a lattice from a spot and its first steps; return sites and which spots are on it."""
    index = np.zeros((len(points), 2), np.int64)
    on = np.zeros(len(points), bool)
    on[seed] = True
    for k, step in enumerate(steps):
        for sign in (1, -1):
            off, spot = tree.query(points[seed] + sign * step)
            if off < GATE * np.linalg.norm(step) and not on[spot]:
                on[spot] = True
                index[spot, k] = sign
    # over a gap only where nothing else is left
    while any(_add(points, tree, index, on, reach, GATE) for reach in (1, 2)):
        pass
    _drop_strays(points, index, on)
    return index, on


def _drop_strays(points: Pixels, index: Ints, on: Bools) -> None:
    """Take spots off the lattice, in place, that lie too far from where neighbours expect them."""
    for _ in range(3):
        rows = np.flatnonzero(on)
        if len(rows) < LEAST_DOTS:
            break
        off = _misfit(index[rows], points[rows], BENT)
        stray = off > max(STRAY, STRAY_SD * 0.85 * float(np.median(off)))
        if not stray.any():
            break
        on[rows[stray]] = False


def _add(points: Pixels, tree: cKDTree, index: Ints, on: Bools, reach: int, gate: float) -> int:
    """Give the sites around the lattice their spots, in place; return how many were added."""
    taken = index[on]
    sites = np.unique((taken[:, None] + AROUND[reach]).reshape(-1, 2), axis=0)
    known = {(int(i), int(j)) for i, j in taken}
    sites = np.array([site for site in sites if (int(site[0]), int(site[1])) not in known])
    if not len(sites):
        return 0
    place, pitch, _ = _predict(taken, points[on], sites)
    off, spot = tree.query(place)
    added = 0
    for k in np.argsort(off / pitch):
        if off[k] > gate * pitch[k]:
            break
        if not on[spot[k]]:
            on[spot[k]] = True
            index[spot[k]] = sites[k]
            added += 1
    return added


def _predict(
    sites: Ints, places: Pixels, wanted: Ints, own: bool = False
) -> tuple[Pixels, Floats, Floats]:
    """Return where sites are expected, px, the pitch there, and how many steps aside the mean of
    the neighbours lies: by the lattice's affine map, and the local one of what that leaves, drawn
    weakly to none. ``own`` leaves a site itself out."""
    # the affine map of the whole lattice
    design = np.column_stack([sites, np.ones(len(sites))])
    whole, *_ = np.linalg.lstsq(design, places, rcond=None)
    rest = places - design @ whole
    # of every wanted site the neighbours, weighted by their distance
    count = min(12 + own, len(sites))
    distance, near = cKDTree(sites).query(wanted, k=count, p=2)
    distance, near = distance.reshape(len(wanted), -1), near.reshape(len(wanted), -1)
    weight = np.where(distance < 3.7, 1.0 / np.maximum(distance, 0.5) ** 3, 0.0)
    weight[distance == 0] = 0.0
    total = np.maximum(weight.sum(axis=1), 1e-9)
    middle = np.einsum("nk,nkd->nd", weight, sites[near] - wanted[:, None]) / total[:, None]
    mean = np.einsum("nk,nkd->nd", weight, rest[near]) / total[:, None]
    off = sites[near] - wanted[:, None] - middle[:, None]
    normal = np.einsum("nk,nkd,nke->nde", weight, off, off) + 0.1 * np.eye(2)
    right = np.einsum("nk,nkd,nke->nde", weight, off, rest[near] - mean[:, None])
    slope = np.linalg.solve(normal, right)
    place = np.column_stack([wanted, np.ones(len(wanted))]) @ whole + mean
    place -= np.einsum("nd,nde->ne", middle, slope)
    local = whole[:2] + slope
    pitch = np.linalg.norm(local, axis=2).min(axis=1)
    return place, np.maximum(pitch, 1e-6), np.linalg.norm(middle, axis=1)


def _explained(away: Singles, noise: float, layers: list[_Layer]) -> float:
    """Return the share of the strong pixels that lie in the dots of layers."""
    strength = np.linalg.norm(away, axis=2)
    strong = strength > max(0.4 * np.quantile(strength, 0.985), 4.0 * noise)
    places = np.argwhere(strong)[:, ::-1]
    places = places[:: max(1, len(places) // 4000)]
    inside = np.zeros(len(places), bool)
    for layer in layers:
        if len(layer) and len(places):
            width = float(np.median(layer.spots.diameter_px[layer.on]))
            off, _ = cKDTree(layer.spots.centre_px[layer.on]).query(places)
            inside |= off < 0.75 * width
    return float(inside.mean()) if len(inside) else 0.0


def _refusal(away: Singles, noise: float, most: int) -> str:
    strength = np.linalg.norm(away, axis=2)
    top = float(np.quantile(strength, 0.998))
    least = max(LEAST_DN, LEAST_SNR * noise)
    if most < LEAST_DOTS:
        return (
            f"the rest picture shows {most or 'no'} dots: a layout needs {LEAST_DOTS} or more of "
            f"one colour, 4 px wide or more, whole, and {least:.3g} counts off their ground (the "
            f"picture's contrast is {top:.3g}); expose more, focus, or come nearer"
        )
    return (
        f"the rest picture shows {most} spots, but they form no lattice: a layer is rows and "
        "columns (or hexagons) of dots at most 0.12 of the pitch off their places (standard "
        "deviation), fewer than half of them missing; is this a picture without load, and are the "
        "dots in focus? Dots without order: give twin.track their places, {name: (n, 2) px}"
    )


def _described(picture: Picture, found: list[_Layer]) -> FoundLayout:
    """Return layers with names, ordered sites and sizes."""
    layers: dict[str, FoundLayout.Layer] = {}
    for one in sorted(found, key=len, reverse=True):
        layer = _layer(picture, one)
        name = _colour_name(layer)
        count = sum(key.split("-")[0] == name for key in layers)
        layers[f"{name}-{count + 1}" if count else name] = layer
    stray = np.concatenate([layer.spots.centre_px[~layer.on] for layer in found])
    return FoundLayout(layers=layers, stray_px=frozen(stray))


def _layer(picture: Picture, one: _Layer) -> FoundLayout.Layer:
    centres, sites = one.spots.centre_px[one.on], one.index[one.on]
    sites, lattice, angle = _oriented(sites, centres)
    order = np.lexsort((sites[:, 1], sites[:, 0]))
    centres, sites = centres[order], sites[order]
    width = float(np.median(one.spots.diameter_px[one.on]))
    pitch = _pitch(centres, sites, lattice)
    scatter = pitch / OF_SCATTER * _scatter(one.index[one.on], one.spots.centre_px[one.on])
    colour, ground = _counts(picture, centres, width)
    kind: Literal["bright", "dark"] = "bright" if colour.sum() > ground.sum() else "dark"
    return FoundLayout.Layer(
        centre_px=frozen(centres),
        index=frozen(sites),
        lattice=lattice,
        pitch_px=pitch,
        scatter_px=scatter,
        diameter_px=width,
        angle_deg=angle,
        colour_dn=frozen(colour),
        ground_dn=frozen(ground),
        polarity=kind,
        weights=one.weights,
    )


HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
"""Steps of a hexagonal lattice, in pitches."""


def _oriented(sites: Ints, centres: Pixels) -> tuple[Ints, Literal["square", "hexagonal"], float]:
    """Return sites by column and row of the picture, the kind of lattice, and its turn, degrees."""
    design = np.column_stack([sites, np.ones(len(sites))])
    affine, *_ = np.linalg.lstsq(design, centres * [1.0, -1.0], rcond=None)  # y upwards
    steps = affine[:2]
    change = np.eye(2, dtype=np.int64)  # rows: the new steps in the old ones
    # Gauss's reduction: the shortest steps
    while True:
        one, two = change @ steps
        if two @ two < one @ one:
            change = change[::-1]
            continue
        times = round(float(one @ two / (one @ one)))
        if times == 0:
            break
        change = np.array([change[0], change[1] - times * change[0]])
    if (change @ steps)[0] @ (change @ steps)[1] < 0:
        change[1] *= -1
    square = _strain(change @ steps)
    hexagonal = _strain(np.linalg.solve(HEXAGON, change @ steps))
    lattice: Literal["square", "hexagonal"] = "hexagonal" if hexagonal < square else "square"
    # of all equal pairs of steps the one along columns and up
    if lattice == "square":
        turns = [np.array([[1, 0], [0, 1]]), np.array([[0, 1], [-1, 0]])]
        pairs = [s * t @ change for t in turns for s in (1, -1)]
        flip = np.array([[1], [-1]])
        pairs = [p if np.linalg.det(p @ steps) > 0 else p * flip for p in pairs]
    else:
        six = np.array([[1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]]) @ change
        turned = six if np.linalg.det(change @ steps) > 0 else six[::-1]
        pairs = [np.array([turned[k], turned[(k + 1) % 6]]) for k in range(6)]
    best = max(pairs, key=lambda p: float((p @ steps)[0, 0] / np.linalg.norm((p @ steps)[0])))
    along = (best @ steps)[0]
    new = np.rint(sites @ np.linalg.inv(best)).astype(np.int64)
    new -= new.min(axis=0)
    if lattice == "hexagonal":
        new[:, 0] += new[:, 1] // 2
        new[:, 0] -= new[:, 0].min()
    return new, lattice, float(np.degrees(np.arctan2(-along[1], along[0])))


def _strain(steps: Floats) -> float:
    """Return how far two steps are from equal and perpendicular ones: log of the ratio of axes."""
    values = np.linalg.svd(steps, compute_uv=False)
    return float(np.log(values[0] / max(values[1], 1e-12)))


def _pitch(centres: Pixels, sites: Ints, lattice: str) -> float:
    """Return the mean distance of neighbours, px."""
    at = {(int(i), int(j)): k for k, (i, j) in enumerate(sites)}
    lengths = []
    for (i, j), k in at.items():
        beside = [(i + 1, j), (i, j + 1)]
        if lattice == "hexagonal":
            beside.append((i + (1 if j % 2 else -1), j + 1))
        lengths += [np.linalg.norm(centres[at[n]] - centres[k]) for n in beside if n in at]
    return float(np.mean(lengths))


def _counts(picture: Picture, centres: Pixels, width: float) -> tuple[Floats, Floats]:
    """Return the median counts in the dots' middles, and of the ground around them, (3,) each."""
    height, across = picture.shape[:2]
    column, row = np.rint(centres).astype(int).T
    inside = picture[np.clip(row, 0, height - 1), np.clip(column, 0, across - 1)]
    angle = np.arange(8) * np.pi / 4
    ring = (0.5 * width + 3.0) * np.column_stack([np.cos(angle), np.sin(angle)])
    x, y = np.rint(centres[:, None] + ring).astype(int).reshape(-1, 2).T
    near = (x >= 0) & (y >= 0) & (x < across) & (y < height)
    around = picture[y[near], x[near]]
    return np.median(inside, axis=0).astype(float), np.median(around, axis=0).astype(float)


def _colour_name(layer: FoundLayout.Layer) -> str:
    """Return a word for the dots' colour."""
    colour, ground = layer.colour_dn, layer.ground_dn
    bright = layer.polarity == "bright"
    shown = np.maximum(colour - ground, 0.0) if bright else colour / np.maximum(ground, 1.0)
    strong = shown > 0.6 * shown.max()
    if layer.polarity == "dark" and shown.max() < 0.5:
        return "black"
    names = {
        (1, 0, 0): "red",
        (0, 1, 0): "green",
        (0, 0, 1): "blue",
        (1, 1, 0): "yellow",
        (0, 1, 1): "cyan",
        (1, 0, 1): "magenta",
    }
    red, green, blue = (int(one) for one in strong)
    return names.get((red, green, blue), "white" if bright else "grey")
