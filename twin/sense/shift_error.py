"""What shifts are stated to be off by: their standard deviations, and what changed shade corrects.

A fit's own variance is that of noise in single pixels. `ShiftErrors.stated` adds what that does not
hold, in this order:

1. Noise that hangs together over pixels (compression, colour mosaics, rows, the ground's texture),
   by the third harmonics of the edges and by the bare ground: a factor that all markers share.
2. Shade that has moved over a marker, by the slope of brightness that the fit lacks: its centre is
   corrected by the usual share of that, and the rest is stated.
3. Parts that are hidden, by how the edge has changed since rest: when one side of it is left out,
   in its third harmonic, and, under compression, in its outline against the neighbours'.
4. Cuts that only make a marker look smaller, and, in a picture that is compressed unlike the rest
   picture, whatever makes light, size and fit worse than most markers'.

Each is stated as far as it exceeds chance. Variances add.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Picture, Pixels, medians, quantiles
from twin.sense.centre import COHERENT
from twin.sense.match import LEAST_SCORES, Neighbourhood
from twin.sense.rest_templates import USUAL, BareGround
from twin.sense.template import (
    DIFFERENCE,
    EDGE,
    LEVEL,
    MISFIT,
    ONE_SIDED,
    OUTLIER_SD,
    OWN_SHAPE,
    PART_IN_SIGHT,
    RESHAPED,
    SCALE,
    SHORTFALL,
    THIRD,
    TILTED,
    VAR_TILTED,
    Templates,
)

WHOLE_EDGE, COVERED_SD_PX = 0.9, 0.03
"""A marker with less of its edge in sight may be shadowed too: its standard deviation has this
added."""

CHANCE = 4.0
"""Standard deviations up to which a fit moves by chance when one side of the edge is left out
(`ONE_SIDED`): whole markers up to 3.4, with a tenth of the width hidden from 7.8 on."""

EVEN, LEVEL_TILT = 2.8, 3.5
"""Standard deviations up to which an edge's third harmonic, and the motion by a changed slope of
brightness, change by chance (49 of 50, 456 of 457). What exceeds this is stated, and corrected."""

SHRINKS = 0.5
"""Standard deviations of a radius up to which a marker has become smaller by chance. Of whole
markers it leaves 1.0 to 1.3 times their errors stated, of blurred ones that lack a hundredth .6 to
1.3 times; more of it would leave too little to those that lack a twentieth under JPEG."""

CONCAVE = 2.0
"""Margin of the motion by a hidden part that a third harmonic allows, for concave edges."""

SHADE_MOVES, SHADE_LEAVES = 0.4, 0.5
"""A straight edge of shade moves a fitted centre by .37 to .49 of what fitting the slope of
brightness, too, moves it back (least squares; radii 2.4 to 8 px, edges anywhere on the marker).
This is corrected. As a share of the same, what is left of narrow shades is .15 to .5."""

ROUGHER = 1.6
"""Squared residuals of most markers, over the usual ones, beyond which noise that the rest picture
has not hangs together over pixels."""

LACKING = 1.5
"""Where a picture is compressed more, or less, than at rest: light, size and fit that together are
worse than most markers' by more standard deviations (of whole markers one in five) may be due to a
hidden part, which moves a marker by about as many of its own."""

SINCE = 1.35
"""Errors where a picture is compressed and the rest picture is not, over those that the third
harmonics show, as outlines at rest are sharper. Measured: 1.1 to 1.8."""

COARSE_PX, COARSER = 1.3, 3.0
"""Radius, over the distance of the pixels that a mosaic has measured, up to which an edge has fewer
than eight of them along it: too few for a third harmonic. Largest factor by which errors are then
as large as by single pixels' noise; measured: 1 to 3."""

LEAST_COHERENCE, SURE = 0.8, 50
"""How many times less than from single pixels' noise errors may be, and from how many markers'
edges that is taken."""

SD_FLOOR_PX = 0.001
"""No centre is taken to be better than this: what a lens and a finite pixel leave even without
noise."""

NORMAL = 0.7413
"""A normal distribution's standard deviation, as a share of what lies between its quarters."""

LONGER, MOST = 1.15, 0.9
"""The longer axis of a strained marker over its mean radius; and the share of the markers whose
growth is kept off the ground between them."""


@dataclass(frozen=True, kw_only=True)
class ShiftErrors:
    """How far shifts may be off that the fits of a picture give, for markers that share a signal.

    Attributes
    ----------
    picture
        (h, w, 3) counts.
    templates, around, rest_sd_px, bare, rougher
        Those of `twin.sense.disc_fit.DiscFit`; the standard deviations are its ``sd_px``.
    fitted
        (n, `twin.sense.template.COLUMNS`) the fits.
    shift_px
        (n, 2) the shifts by them; NaN where refused.
    """

    picture: Picture
    templates: Templates
    around: Neighbourhood
    rest_sd_px: Floats
    bare: BareGround | None
    rougher: bool
    fitted: Floats
    shift_px: Pixels

    def stated(self) -> tuple[Pixels, Floats, float]:
        """Return (n, 2) what is to be added to the shifts, px; (n,) their standard deviations then,
        per axis, px; and how many times as large as by single pixels' noise the errors are."""
        templates, coherence = self.templates, self._coherence
        hangs_together = coherence > COHERENT
        shaded = self._shaded(coherence if hangs_together else 1.0)
        if hangs_together and not self.rougher:  # else it is in `SINCE`
            coherence *= templates.smooths_third
        sd = coherence * self._noise_sd
        more = self._unseen_cut(sd, coherence) + 2.0 * SD_FLOOR_PX**2
        if templates.coherent and (self.rougher or not 1.0 / ROUGHER < self._noisier < ROUGHER):
            more += np.fmax(self._lacking() ** 2 - LACKING**2, 0.0) * sd**2
        more += SHADE_LEAVES**2 * _square(shaded)
        sd = np.sqrt(self._edge_sd(sd, coherence) ** 2 + more)
        since = SINCE if self.rougher else 1.0
        return SHADE_MOVES * shaded, since * sd, since * coherence

    @cached_property
    def _noise_sd(self) -> Floats:
        """(n,) standard deviations of the shifts by the noise in single pixels, px."""
        sd = np.hypot(self.templates.centre_sds(self.fitted), self.rest_sd_px)
        sd[np.isnan(self.shift_px[:, 0])] = np.nan
        return sd

    @cached_property
    def _in_part(self) -> Bools:
        """(n,) which markers are measured by the part of them that is in sight."""
        return np.asarray(self.fitted[:, RESHAPED] == PART_IN_SIGHT)

    @cached_property
    def _noisier(self) -> float:
        """By how much usual squared residuals are larger than at rest."""
        return quantiles(self.fitted[:, MISFIT], USUAL)[0] / self.templates.usual_misfit

    @cached_property
    def _uneven(self) -> Floats:
        """(n,) squared change of the edges' third harmonics since rest, px^2."""
        return _square(self.fitted[:, THIRD] - self.templates.third)

    @cached_property
    def _coherence(self) -> float:
        """How many times as large as by single pixels' noise the errors of centres are, by the
        edges or the bare ground."""
        factor = 1.0
        share = self.templates.measured  # edges sampled too coarsely err alike
        if self.templates.coherent or self.bare or share < 1.0:
            factor = self._coherence_of_edges()
        if share < 1.0 and self.templates.usual_radius_px * np.sqrt(share) < COARSE_PX:
            of_motion = self.around.scatter(self.shift_px, self._noise_sd)
            factor = max(1.0 if of_motion is None else min(of_motion, COARSER), factor)
        if self.bare:
            own = self.fitted[:, RESHAPED] == OWN_SHAPE
            growth = quantiles(self.fitted[:, SCALE] * np.where(own, LONGER, 1.0), MOST)[0]
            of_ground = self.bare.coherence(
                self.picture, self.templates, self.shift_px, self._noise_sd, growth
            )
            factor = max(of_ground, factor)
        return factor

    def _coherence_of_edges(self) -> float:
        """Return the same by the edges alone.

        Why: compression and colour mosaics leave errors that hang together over pixels, which the
        variance in single pixels does not show. They move the edge in its third harmonic as in the
        first, the motion, but for small markers (`Templates.smooths_third`). Neither motion, size
        nor strain moves the third, and what a marker's own outline or shadow lacks of the model is
        the same at rest.
        """
        moved = np.abs(self.fitted[:, THIRD] - self.templates.third)
        counts = np.isfinite(self._noise_sd) & np.isfinite(moved[:, 0])
        if 2 * int(counts.sum()) < LEAST_SCORES:
            return 1.0
        score = moved[counts] / self._noise_sd[counts, None]
        # Less noise than in single pixels, where shading passes for it, is shown by all of many
        # edges.
        least = 1.0
        if counts.sum() >= SURE:
            least = min(max(float(np.sqrt(np.mean(score**2))), LEAST_COHERENCE), 1.0)
        return max(float(np.sqrt(Neighbourhood.bounded_squares(score.reshape(-1, 1))[0])), least)

    def _shaded(self, chances: float) -> Pixels:
        """Return (n, 2) how far centres would move, px, were their slopes of brightness fitted too,
        as far as that has changed since rest by more than chance: shade has moved over the marker.
        ``chances`` is by how much these are larger than by single pixels' noise."""
        fitted, rest = self.fitted, self.templates.rest
        tilted = fitted[:, TILTED] - rest[:, TILTED]
        chance = fitted[:, VAR_TILTED] * max(self._noisier, 1.0) + rest[:, VAR_TILTED]
        share = 1.0 - chance * (LEVEL_TILT * chances) ** 2 / np.fmax(_square(tilted), 1e-12)
        if not self.templates.coherent:  # own shapes, of another noise: maybe compressed since
            share[fitted[:, RESHAPED] == OWN_SHAPE] = 0.0
        share = share[:, None]
        return np.where(share > 0.0, tilted * share, 0.0)

    def _edge_sd(self, sd: Floats, coherence: float) -> Floats:
        """Return the standard deviations ``sd`` (n,) by the noise, with what a covered or shadowed
        edge adds."""
        fitted, templates, part = self.fitted, self.templates, self._in_part
        beyond = self._beyond_one_sided(coherence if coherence > COHERENT else 1.0)
        if part.any():
            # residuals of a part in sight count in its deviation already, and not twice
            counted = min(coherence, max(np.sqrt(templates.usual_misfit), 1.0))
            sd = coherence * np.where(part, self._noise_sd / counted, self._noise_sd)
            # an outline that is irregular at rest misleads where only a part of it is in sight
            sides = templates.rest[part, ONE_SIDED:RESHAPED]
            beyond[part] = np.nan_to_num(np.abs(sides)).max(axis=1) ** 2
        # A third harmonic of the edge that it did not have at rest: something hidden.
        beyond += np.fmax(self._uneven - (EVEN * sd) ** 2, 0.0) * templates.third_weakened**2
        # Where noise hangs together nothing hidden can be told from it: what differs is stated.
        if templates.coherent:
            differs = np.fmax(fitted[:, DIFFERENCE], 0.0)
            beyond += np.fmin(differs**2, self._most_moved(sd, differs))
        covered = np.where(fitted[:, EDGE] < WHOLE_EDGE, COVERED_SD_PX, 0.0)
        return np.asarray(np.sqrt(sd**2 + covered**2 + beyond))

    def _beyond_one_sided(self, chances: float) -> Floats:
        """Return (n,) how far, squared, px^2, the centre moves when one side of its edge is left
        out, beyond chance, see `_shaded`; NaN without a rest position."""
        fitted, rest, rest_sd = self.fitted, self.templates.rest, self.rest_sd_px
        beyond = np.where(np.isnan(rest_sd), np.nan, 0.0)
        looked = np.flatnonzero(np.isfinite(fitted[:, ONE_SIDED]))
        if len(looked):
            moved = fitted[looked, ONE_SIDED:RESHAPED] - rest[looked, ONE_SIDED:RESHAPED]
            square = np.fmax.reduce(moved**2, axis=1, initial=0.0)
            chance = 2.0 * (CHANCE * chances * rest_sd[looked]) ** 2
            beyond[looked] = np.maximum(square - chance, 0.0)
        return beyond

    def _most_moved(self, sd: Floats, shrunk: Floats) -> Floats:
        """Return (n,) the largest variance of a shift, per axis, px^2, by a part of the edge that
        is hidden, and that makes the mean radius smaller by ``shrunk`` (n,) px.

        A straight cut of the half angle q, q^3 = 3 pi shrunk / radius, moves the edge in its third
        harmonic by 1 - .8 q^2 times as much as in its first, which is motion: so the third
        harmonic, and what hides in its noise ``sd`` (n,), bound the motion. Concave ones move it by
        less.
        """
        templates = self.templates
        angle = np.cbrt(3.0 * np.pi * shrunk / templates.radius_px)
        share = np.fmax(1.0 - 0.8 * angle**2, 1e-3)
        third = np.sqrt(self._uneven) + EVEN * sd
        return np.asarray(0.5 * (CONCAVE * third * templates.third_weakened / share) ** 2)

    def _unseen_cut(self, sd: Floats, coherence: float) -> Floats:
        """Return (n,) the variance of shifts, per axis, px^2, of a cut that looks like less size.

        What hides a narrow part on one side moves a fitted centre by twice as much as it makes the
        mean radius smaller, as the first harmonic is twice the mean. Where blur hides the uneven
        edge nothing else shows: a marker that has shrunk more than its neighbours, beyond chance,
        may have moved less than measured. ``sd`` (n,) is the shifts' by the noise.
        """
        fitted, rest = self.fitted, self.templates.rest
        shrunk = fitted[:, SCALE] / rest[:, SCALE]
        if coherence > COHERENT:  # compression may dim a marker instead: what is lost is light
            shrunk *= np.sqrt(fitted[:, LEVEL] / rest[:, LEVEL])
        shrunk = self.templates.radius_px * (1.0 - shrunk)
        shrunk[~np.isfinite(sd)] = np.nan
        low, middle, high = quantiles(shrunk, 0.25, 0.5, 0.75)
        limit = np.fmax(NORMAL * (high - low), sd / np.sqrt(2.0))
        away = shrunk - middle
        if NORMAL * (high - low) > np.sqrt(2.0) * quantiles(sd, 0.5)[0]:  # not by noise alone
            rows = np.flatnonzero(away > SHRINKS * sd / np.sqrt(2.0))
            by_others = self.around.usual(away[:, None], np.isfinite(away), rows)
            usual, spread = (np.nan_to_num(each[:, 0]) for each in by_others)
            away[rows] -= usual
            limit[rows] = np.fmax(spread, sd[rows] / np.sqrt(2.0))
        away[self._in_part] = 0.0
        beyond = np.fmax(np.fmax(away, 0.0) ** 2 - (SHRINKS * limit) ** 2, 0.0)
        return np.asarray(np.fmin(2.0 * beyond, self._most_moved(sd, np.sqrt(beyond))))

    def _lacking(self) -> Floats:
        """Return (n,) by how many standard deviations light, size and fit together are worse than
        most markers'; 0 for parts in sight, at most `OUTLIER_SD` by each."""
        fitted, rest = self.fitted, self.templates.rest
        scale = fitted[:, SCALE] / rest[:, SCALE]
        light = fitted[:, LEVEL] / rest[:, LEVEL] * scale**2
        worse = np.column_stack([-light, -scale, np.log(fitted[:, MISFIT]), fitted[:, SHORTFALL]])
        worse[self._in_part] = np.nan
        worse -= medians(worse)
        spread = np.fmax(1.4826 * medians(np.abs(worse)), 1e-9)
        bounded = np.fmin(np.fmax(worse / spread, 0.0), OUTLIER_SD)
        return np.asarray(np.sqrt((bounded**2).sum(axis=1)))


def _square(vectors: Floats) -> Floats:
    """Return (n,) the squared lengths of vectors (n, 2)."""
    return np.asarray(vectors[:, 0] ** 2 + vectors[:, 1] ** 2)
