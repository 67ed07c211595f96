"""Marker motion between the rest picture and another: `track`; through a sequence of pictures:
`Tracker`.

Everything about the rest picture is computed once and serves a whole sequence. Markers keep their
rows; one that can't be measured is NaN, with a state that names the reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Picture, Pixels, frozen, medians
from twin.blas_threads import one_blas_thread
from twin.display import Table, new_axes, plot_shifts
from twin.errors import AccuracyWarning, InputError
from twin.parts.methods import CentreMethod
from twin.sense.centre import AMBIGUOUS, MISSING, PARTLY_HIDDEN, SEEN, STATES, STRAINED
from twin.sense.colour import Flaws, Weights, as_picture
from twin.sense.match import GATE
from twin.sense.reference import Rest, analyse_rest

CACHE_LINE = 64
"""Bytes that memory hands over at once. Reading a picture once in order before markers are fitted
here and there takes a third of the time that it saves."""

FILM = 3.0
"""Errors of a film over those that the shape of its markers shows: its codec moves blocks of the
picture before by motion vectors in steps of a quarter of a pixel, and drops small corrections. That
moves a marker as a whole, in steps that no single picture shows. Measured: 1.1 to 4 (H.264 and
MPEG-4, .8 to 8 bits a pixel)."""

REPEATING = 4.0
"""The same of a film that repeats blocks of the picture before. Measured in grey ones: 1.7 to 5."""

ROUGH_PX = 0.004
"""A codec leaves edges rough by more than this (crf 12, 10 Mbit/s: .0043 to .0068). Smoother ones
are those of a camera without noise, which repeats its ground, too (.0004 to .0035)."""

COMPARED = 50
"""So many of a sequence's first pictures are compared with the one before, to find a codec."""

_ENDLESS = (
    "the markers' lattice goes on to the borders of the rest picture, where a motion of all of it "
    "by whole pitches looks like none: a first picture is taken to be within 0.6 pitches of rest. "
    "If markers stop within the picture, draw all of them in the layout"
)

STEPPED, DIAGONAL = 0.8, 1.6
"""Share of the markers lost since the last picture that a step of the lattice, shorter than so many
spacings, must explain: then the whole picture is searched."""

__all__ = ["STATES", "Found", "Tracker", "analyse_rest", "track"]


@dataclass(frozen=True, kw_only=True, repr=False)
class Found(Table):
    """Marker motion in one picture; rows are the markers, layers concatenated in the layout's
    order.

    Attributes
    ----------
    rest_px
        (N, 2) centres in the rest picture, px; NaN where not found.
    shift_px
        (N, 2) motion since, px (column, row); NaN where lost.
    sd_px
        (N,) standard deviation of the shift, per axis, px; NaN where lost.
    layer
        (N,) layer names.
    channels
        Projection (r, g, b) that was used for every layer.
    method
        How centres were measured.
    state
        (N,) index into `STATES`.
    usual_sd_px
        (N,) standard deviation of the shift where picture and rest picture look alike, px; NaN
        where not found at rest, None where not known.
    spurious_px
        (s, 2) spots that look like markers and are none's, px; None where the whole picture was not
        searched.
    gain_error
        Standard deviation of a factor that all shifts share, from 1.
    drift_px
        (N, 2) motion that the rest picture shows against itself, px: in all shifts, more or less.
    """

    _title: ClassVar[str] = "Marker motion"

    rest_px: Pixels
    shift_px: Pixels
    sd_px: Floats
    layer: NDArray[np.str_]
    channels: dict[str, Weights]
    method: str
    state: NDArray[np.uint8] | None = None
    spurious_px: Pixels | None = None
    usual_sd_px: Floats | None = None
    gain_error: float = 0.0
    drift_px: Floats | float = 0.0

    def __post_init__(self) -> None:
        if self.state is None:
            object.__setattr__(self, "state", np.where(self.seen, SEEN, MISSING).astype(np.uint8))

    @property
    def states(self) -> NDArray[np.str_]:
        """(N,) what was found of every marker, one of `STATES`."""
        return np.array(STATES)[self.state]

    @cached_property
    def seen(self) -> Bools:
        """(N,) which markers have a shift."""
        return np.asarray(np.isfinite(self.shift_px).all(axis=1))

    @cached_property
    def all_seen(self) -> bool:
        """Whether every marker has a shift."""
        return bool(self.seen.all())

    def _rows(self) -> dict[str, str]:
        rows = {"markers": f"{int(self.seen.sum())} of {len(self.seen)} seen"}
        if self.seen.any():
            longest = np.hypot(*self.shift_px[self.seen].T).max()
            rows["longest shift"] = f"{longest:.3g} px"
            rows["median SD"] = f"{np.median(self.sd_px[self.seen]):.2g} px"
        names, counts = np.unique(self.states[~self.seen], return_counts=True)
        lost = [f"{count} {name}" for name, count in zip(names, counts, strict=True)]
        return rows | ({"without a shift": ", ".join(lost)} if lost else {})

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return a row for every marker: layer, rest place, shift and its standard deviation, px,
        and state."""
        return {
            "layer": self.layer,
            "column_px": self.rest_px[:, 0],
            "row_px": self.rest_px[:, 1],
            "shift_column_px": self.shift_px[:, 0],
            "shift_row_px": self.shift_px[:, 1],
            "sd_px": self.sd_px,
            "state": self.states,
        }

    def plot(self, ax: Any = None, picture: Picture | None = None) -> Any:
        """Draw the shifts, longer by a stated factor, on matplotlib axes, and return these.

        Parameters
        ----------
        ax
            Axes to draw on; new ones if None.
        picture
            Drawn below the arrows.
        """
        return plot_shifts(new_axes(1, ax), self.rest_px, self.shift_px, self.layer, picture)

    @property
    def scatter_px(self) -> float:
        """Standard deviation of the shifts about their median, per axis, px; robust to outliers:
        1.4826 times the median absolute deviation."""
        shift = self.shift_px[self.seen]
        return float(1.4826 * np.median(np.abs(shift - np.median(shift, axis=0))))


@one_blas_thread()
def track(
    rest_image: Picture,
    image: Picture,
    layout: Mapping[str, Pixels],
    *,
    diameter_px: float | None = None,
    polarity: str | None = None,
    channels: Mapping[str, Weights] | None = None,
    method: CentreMethod = "disc-fit",
) -> Found:
    """Measure every marker's motion between two pictures.

    Parameters
    ----------
    rest_image, image
        (h, w, 3) uint8 pictures at rest and pressed.
    layout
        Nominal rest positions (n, 2) by layer, px; may be off by several px, as a whole by up to
        half the pitch.
    diameter_px
        Typical marker width, px; measured in the rest picture if not given.
    polarity
        ``bright`` or ``dark`` markers on their ground; found in the rest picture if not given.
    channels
        (r, g, b) by layer such that r R + g G + b B is large on its markers; estimated if not
        given.
    method
        ``disc-fit``; ``soft-window`` centroid; or the flat paper's ``two-pass`` cell centroid.

    Raises
    ------
    InputError
        Pictures, layout or options that can't be used.

    Examples
    --------
    >>> import numpy as np
    >>> import twin
    >>> away = np.hypot(*(np.mgrid[0:120, 0:160] % 20 - 10))
    >>> dots = (20 + 200 * np.clip(5.5 - away, 0, 1)).astype(np.uint8)
    >>> layout = twin.find_layout(dots).layout_px
    >>> found = twin.track(dots, np.roll(dots, 2, axis=1), layout)
    >>> round(float(np.median(found.shift_px[:, 0])), 1)
    2.0
    """
    tracker = Tracker(
        rest_image,
        layout,
        diameter_px=diameter_px,
        polarity=polarity,
        channels=channels,
        method=method,
    )
    return tracker.track(image)


class Tracker:
    """Follows the markers through a sequence of pictures, each from where they were in the one
    before.

    Motion from picture to picture may be up to about half the markers' width where only places
    around the last ones are looked at, and up to 0.6 of the pitch where that fails and the whole
    picture is searched; in total there is no limit but the picture. Nothing grows with the number
    of pictures. The first picture may be any; where the markers' lattice goes on beyond the layout,
    and no border of it is in sight, it follows the rest picture.

    Parameters
    ----------
    rest_image, layout, options
        As for `track`. Of LEDs that take turns a list of rest pictures, one in the light of each
        group: frame k is compared with picture k modulo their number.

    Raises
    ------
    InputError
        Pictures, layout or options that can't be used; a later picture of another size than the
        rest picture's.

    Warns
    -----
    AccuracyWarning
        The lattice of every layer goes on beyond the layout, and no border of any is in sight.

    Examples
    --------
    >>> import numpy as np
    >>> import twin
    >>> away = np.hypot(*(np.mgrid[0:120, 0:160] % 20 - 10))
    >>> dots = (20 + 200 * np.clip(5.5 - away, 0, 1)).astype(np.uint8)
    >>> layout = twin.find_layout(dots).layout_px
    >>> tracker = twin.Tracker(dots, layout)
    >>> found = [tracker.track(np.roll(dots, moved, axis=1)) for moved in (1, 2)]
    >>> [round(float(np.median(one.shift_px[:, 0])), 1) for one in found]
    [1.0, 2.0]
    """

    @one_blas_thread()
    def __init__(
        self,
        rest_image: Picture | Sequence[Picture],
        layout: Mapping[str, Pixels],
        *,
        diameter_px: float | None = None,
        polarity: str | None = None,
        channels: Mapping[str, Weights] | None = None,
        method: CentreMethod = "disc-fit",
    ) -> None:
        several = isinstance(rest_image, list | tuple)
        images = list(rest_image) if several else [np.asarray(rest_image)]
        if not images:
            raise InputError("rest_image: the list is empty; give one picture for each group")
        self._rests = [
            analyse_rest(
                one,
                layout,
                diameter_px=diameter_px,
                polarity=polarity,
                channels=channels,
                method=method,
            )
            for one in images
        ]
        self._frame = -1
        # Without a border in sight, motion by the lattice's own steps looks like none.
        self._first_px: Pixels | None = None
        if all(group.endless for group in self.rest.groups):
            AccuracyWarning.issue(_ENDLESS)
            self._first_px = np.zeros_like(self.rest.rest_px)
        self._last_px = self._first_px
        self._seen = np.zeros(len(self.rest.rest_px), np.bool_)
        self._before = [as_picture(one, "the rest picture").copy() for one in images]
        rough = min(group.roughness_px for group in self.rest.groups) > ROUGH_PX
        self._left_to_compare = COMPARED if rough else 0

    @property
    def rest(self) -> Rest:
        """What is known of the rest picture that the last frame was compared with; at first of the
        first one."""
        return self._rests[max(self._frame, 0) % len(self._rests)]

    @one_blas_thread()
    def track(self, image: Picture, frame: int | None = None) -> Found:
        """Measure the motion between rest and the next picture of the sequence; ``frame`` is its
        number from 0, where some were left out."""
        self._frame = self._frame + 1 if frame is None else frame
        if self._left_to_compare and not self.rest.film:
            picture = as_picture(image, "the picture")
            own = self._frame % len(self._rests)
            before = self._before[own]
            if picture.shape == before.shape:
                film = Flaws.repeats_blocks(before, picture)
                self._rests[own] = replace(self.rest, film=film)
                before[:] = picture
            self._left_to_compare -= 1
        found = self.motion(self.rest, image, self._last_px)
        if self._may_have_jumped(found):
            found = self.motion(self.rest, image, self._last_px, whole=True)
        self._seen = found.seen
        self._last_px = found.shift_px if found.all_seen else self._starts(found)
        return found

    def _may_have_jumped(self, found: Found) -> bool:
        """Return whether the markers that are lost since the last picture are those that find none
        where all have moved by steps of their lattice: the border's, and those next to lost ones.
        """
        if self._last_px is None or found.all_seen:
            return False
        gone = self._seen & ~found.seen
        if np.count_nonzero(gone) < 2:
            return False
        for group in self.rest.groups:
            rows, around = group.look.rows, group.around
            lost, seen = np.flatnonzero(gone[rows]), found.seen[rows]
            for partner in around.partner:
                has = partner >= 0
                step = np.nanmedian(around.rest_px[partner[has]] - around.rest_px[has], axis=0)
                near = np.hypot(*step) < DIAGONAL * around.spacing_px
                alone = ~has | ~seen[partner]
                if near and len(lost) > 1 and alone[lost].mean() >= STEPPED:
                    return True
        return False

    def _starts(self, found: Found) -> Pixels | None:
        """Return (N, 2) shifts to start from in the next picture, px: for lost markers the last
        known ones, but those of the nearest marker, of any layer, where this has moved on. None
        where all are ambiguous, as these could be a pitch off."""
        seen = found.seen
        if not seen.any():
            return None if np.any(found.state == AMBIGUOUS) else self._last_px
        last = np.full_like(found.shift_px, np.nan) if self._last_px is None else self._last_px
        last = np.where(seen[:, None], found.shift_px, last)
        markers = cKDTree(found.rest_px[seen])
        for group in self.rest.groups:
            rows = group.look.rows[~seen[group.look.rows]]
            rows = rows[np.isfinite(found.rest_px[rows, 0])]
            _, near = markers.query(found.rest_px[rows])
            expected = found.shift_px[seen][near]
            away = np.hypot(*(last[rows] - expected).T)
            moved = ~(away < GATE * group.around.spacing_px)
            last[rows[moved]] = expected[moved]
        return last

    def forget(self) -> None:
        """Search the whole next picture, as after a cut in the sequence; markers of a lattice
        without a border in sight start from rest."""
        self._last_px = self._first_px

    @staticmethod
    def motion(
        rest: Rest, image: Picture, start_px: Pixels | None = None, *, whole: bool = False
    ) -> Found:
        """Measure the motion of every marker between the analysed rest picture and ``image``.

        Parameters
        ----------
        start_px
            (N, 2) shifts of the previous picture of a sequence, px, NaN where unknown; None starts
            cold.
        whole
            Search the whole picture, too, for a jump by a step of the markers' lattice.

        Raises
        ------
        InputError
            The picture isn't one that the rest picture's camera mode gives.
        """
        picture = as_picture(image, "the picture")
        if picture.shape[:2] != rest.size_px:
            raise InputError(
                f"the picture is {picture.shape[1]}x{picture.shape[0]} px, the rest picture "
                f"{rest.size_px[1]}x{rest.size_px[0]} px: both must come from the same camera "
                "mode, turned the same way"
            )
        if start_px is not None and np.shape(start_px) != rest.rest_px.shape:
            raise InputError(
                f"start_px must be {rest.rest_px.shape} px, one row a marker, got "
                f"{np.shape(start_px)}"
            )
        picture = rest.flaws.mended(picture)
        if rest.flaws.ground is None:
            # light that flickers may show on markers alone
            found, light = _measured(rest, picture, start_px, whole)
            even = None
            if light is not None:
                now_px = rest.rest_px + found.shift_px
                even = Flaws.as_rows_at_rest(picture, light, now_px, rest.layer)
            if even is None:
                return found  # nearly always
            again, _ = _measured(rest, even, found.shift_px)
            return replace(again, spurious_px=found.spurious_px)
        # A light that flickers has dark and bright rows in every picture, which show on the ground.
        shift_px = np.zeros_like(rest.rest_px) if start_px is None else start_px
        for _ in range(2):
            even = rest.flaws.without_bands(picture, rest.rest_px + shift_px, *rest.ground_px)
            found, _ = _measured(rest, even, start_px, whole)
            if not found.seen.any():
                break
            shift_px = found.shift_px
        return found


def _measured(
    rest: Rest, picture: Picture, start_px: Pixels | None, whole: bool = False
) -> tuple[Found, Floats | None]:
    """Measure the motion as `Tracker.motion` does, in a ``picture`` less the camera's flaws, and
    (N,) what the light has changed by, see `Seen`."""
    shift = np.full(rest.rest_px.shape, np.nan)
    sd, light = np.full(len(shift), np.nan), None
    state = np.full(len(rest.rest_px), MISSING, np.uint8)
    usual = rest.usual_sd_px.copy()
    spurious: list[Pixels] | None = []
    picture.reshape(-1)[::CACHE_LINE].max()  # a straight read, which memory foresees
    for group in rest.groups:
        rows = group.look.rows
        start = None if start_px is None else np.asarray(start_px, float)[rows]
        seen = (group.search if whole else group.measure)(picture, start)
        halved = rest.flaws.blocks is not None and seen.coherence > 1.0
        film = FILM if halved else 1.0
        if rest.film:  # that edges look alike proves nothing where a codec repeats them
            film = REPEATING / min(seen.coherence, 1.0)
        shift[rows], sd[rows], state[rows] = seen.shift_px, film * seen.sd_px, seen.state
        if seen.light is not None:
            light = np.full(len(shift), np.nan) if light is None else light
            light[rows] = seen.light
        usual[rows] *= film * seen.coherence
        spurious = (
            None if spurious is None or seen.spurious_px is None else [*spurious, seen.spurious_px]
        )
    for group in rest.groups:
        if group.front is not None:  # partly hidden by another layer, a marker follows that one
            rows = group.look.rows
            away = np.hypot(*(shift[rows] - shift[group.front]).T)
            unknown = np.isnan(away)
            if unknown.any():
                away[unknown] = np.nan_to_num(medians(away))
            sd[rows] = np.hypot(sd[rows], group.follows * away)
    lost = np.isnan(shift[:, 0])
    # From a cold start a layer that is ambiguous has moved as the markers of one that is not.
    other = state != AMBIGUOUS
    if start_px is None and not other.all() and 2 * (~lost).sum() > other.sum():
        _, near = cKDTree(rest.rest_px[~lost]).query(np.nan_to_num(rest.rest_px))
        return _measured(rest, picture, shift[~lost][near])
    sd[lost] = np.nan
    state[~lost & (state != STRAINED) & (state != PARTLY_HIDDEN)] = SEEN
    for array in (shift, sd, state, usual):
        frozen(array)
    found = Found(
        rest_px=rest.rest_px,
        shift_px=shift,
        sd_px=sd,
        layer=rest.layer,
        channels=rest.channels,
        method=rest.method,
        state=state,
        spurious_px=None if spurious is None else frozen(np.concatenate(spurious)),
        usual_sd_px=usual,
        gain_error=rest.gain_error,
        drift_px=rest.drift_px,
    )
    return found, light
