"""What tracking needs of a way to measure markers' centres: `CentreEstimator`.

An estimator is made once from the rest picture, for the markers that share a signal, and measures
their motion in every other picture. Those that a scene may name are listed in
`twin.sense.reference.METHODS`; each is one class in one file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Floats, Ints, Picture, Pixels
from twin.sense.colour import Weights
from twin.sense.detect import Blobs
from twin.sense.match import Neighbourhood

STATES = (
    "seen",
    "missing",
    "dim",
    "merged",
    "occluded",
    "partly hidden",
    "ambiguous",
    "strained",
)
"""What a marker can be: measured; without a spot, or out of the picture; too dark; one spot with
another; hidden or unlike itself; part of it hidden, or out of the picture; measured, but maybe its
neighbour, as from a cold start two shifts by steps of the layout's lattice fit alike; measured,
with another outline or blur than at rest. "seen" and "strained" markers have a shift, and those
partly hidden ones whose visible part is enough."""

COHERENT = 1.5
"""Smaller coherence may be due to a few markers' moving shadows: it does not raise the limits up to
which an edge has changed by chance."""

SEEN, MISSING, DIM, MERGED, OCCLUDED, PARTLY_HIDDEN, AMBIGUOUS, STRAINED = range(len(STATES))

AREA_RATIO = (0.6, 1.7)
"""Allowed change of a marker's area against rest: less is partly hidden, more has merged."""

LEVEL_RATIO = (0.3, 3.0)
"""Allowed change of a marker's brightness against rest."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """A first look at one signal of the rest picture, and the markers that it shows.

    Attributes
    ----------
    rows, nominal_px
        Which of the sensor's markers these are, and (n, 2) where they are drawn, px.
    weights, floor_dn, ground_dn
        Projection of the picture, the counts below which it is cut off, and the ground taken off.
    diameter_px, contrast_dn
        Typical marker width, and the least contrast of a spot.
    picture_px
        (height, width) of the picture.
    blobs
        The spots that could be markers.
    hole_px
        Where markers are rings, how wide holes are filled before spots are looked for, px; else 0.
    """

    rows: Ints
    nominal_px: Pixels
    weights: Weights
    floor_dn: float
    ground_dn: float
    diameter_px: float
    contrast_dn: float
    picture_px: tuple[int, int]
    blobs: Blobs
    hole_px: int = 0


@dataclass(frozen=True, kw_only=True)
class Seen:
    """What one signal of a picture shows; rows are its markers, fields as in
    `twin.sense.track.Found`.

    ``coherence`` is how many times as large as by single pixels' noise the errors are; ``light``
    (n,) the logarithm of what the markers' brightness has changed by, where that is not the same
    for neighbours, else NaN; None where it is not measured.
    """

    shift_px: Pixels
    sd_px: Floats
    state: NDArray[np.uint8]
    spurious_px: Pixels | None = None
    coherence: float = 1.0
    light: Floats | None = None


@dataclass(frozen=True, kw_only=True)
class CentreEstimator:
    """The markers that share a signal (one layer's, unless colours can't be separated), and how
    their centres are measured.

    Attributes
    ----------
    look
        Their signal.
    around
        Rest positions and neighbours, px; NaN where not found.
    sd_px, usual_sd_px
        (n,) standard deviation of the rest position, and of the shift to a picture that looks the
        same, px.
    gain_error
        Standard deviation of a factor that all shifts share, from 1.
    drift_px
        (n, 2) motion that the rest picture shows against itself, px.
    front, follows
        (n,) row, among all markers, of the one in another layer that may hide this one, and the
        share of that one's relative motion that its shift may hold, per axis. None where none does.
    """

    look: Look
    around: Neighbourhood
    sd_px: Floats
    usual_sd_px: Floats
    gain_error: float = 0.0
    drift_px: Floats | float = 0.0
    front: Ints | None = None
    follows: Floats | float = 0.0

    @property
    def roughness_px(self) -> float:
        """How far edges at rest lie outside the model's in their third harmonic: the median, px;
        infinite where that is not measured."""
        return math.inf

    @property
    def endless(self) -> bool:
        """Whether the lattice goes on beyond the layout, and no border of it is in sight: then a
        first picture does not tell a motion by its steps from none."""
        return False

    @classmethod
    def at_rest(
        cls, picture: Picture, looks: list[Look], spacing_px: float, given: bool
    ) -> Sequence[CentreEstimator]:
        """Measure the rest picture.

        Parameters
        ----------
        picture
            (h, w, 3) counts.
        looks
            Its signals.
        spacing_px
            Distance of neighbouring markers, px.
        given
            Whether the projections were given, and are to be used as they are.
        """
        raise NotImplementedError

    def measure(self, picture: Picture, start_px: Pixels | None) -> Seen:
        """Measure the motion of the markers between rest and ``picture``.

        Parameters
        ----------
        picture
            (h, w, 3), of the rest picture's size.
        start_px
            (n, 2) shifts in the picture before, px, NaN where unknown; None searches the whole.
        """
        raise NotImplementedError

    def search(self, picture: Picture, start_px: Pixels | None) -> Seen:
        """Measure as `measure` does, but look at the whole picture whatever the last one showed."""
        return self.measure(picture, start_px)
