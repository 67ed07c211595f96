"""The disc fit: templates of the markers at rest, fitted to every other picture.

Why a template: brightness that falls off to one side looks much like motion. Fitted in every
picture, that slope would cost half of the information in an 8 px marker. So it is fitted to the
rest picture (`twin.sense.rest_templates`), and centre, level, ground and scale alone to the others
(`twin.sense.template`): an error of the slope cancels in the shift.

A picture is measured in three steps. `DiscFit._fit` fits all markers; one that no longer looks as
at rest is fitted with an outline and blur of its own, or by the part of it that is in sight; a
layer with rough outlines by its markers' own pictures (`twin.sense.shape_fit`). `_judge` refuses
fits that don't look like the marker. `twin.sense.shift_error` states the standard deviations.

After a first picture fits start where the last ones ended; where too many of them fail the whole
picture is searched.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from twin.arrays import Bools, Floats, Ints, Picture, Pixels, for_kernel, medians, quantiles
from twin.compiled import njit
from twin.sense.centre import (
    AREA_RATIO,
    DIM,
    LEVEL_RATIO,
    MERGED,
    MISSING,
    OCCLUDED,
    PARTLY_HIDDEN,
    SEEN,
    STRAINED,
    Look,
    Seen,
)
from twin.sense.match import GATE, LEAST_SCORES, TRUST, Neighbourhood
from twin.sense.rest_templates import (
    USUAL,
    BareGround,
    LayerSignal,
    in_other_light,
)
from twin.sense.shape_fit import NORMAL_MEDIAN, Expected, OwnPictures, fit_shapes
from twin.sense.shift_error import (
    COVERED_SD_PX,
    NORMAL,
    ROUGHER,
    SD_FLOOR_PX,
    WHOLE_EDGE,
    ShiftErrors,
)
from twin.sense.soft_window import SoftWindow
from twin.sense.template import (
    BLUR,
    BRIGHT,
    CENTRE,
    CENTRE_X,
    CENTRE_Y,
    DIFFERENCE,
    DOUBTED,
    EDGE,
    FITS,
    FITTING,
    GROUND,
    LEAST_SPREAD,
    LEVEL,
    LIT,
    MARGIN_PX,
    MISFIT,
    OWN_PICTURE,
    OWN_SHAPE,
    PART_IN_SIGHT,
    PIXELS,
    RESHAPED,
    SCALE,
    SHAPE,
    SHORTFALL,
    SMALLER,
    SQUARES,
    STEP,
    THIRD,
    UNCOVERED,
    UNEVEN,
    UNUSUAL,
    VARIANCE,
    Templates,
    slope_terms,
)

BRIGHTER = 1.2
"""The counts from which on other layers show follow the picture's brightness where that has changed
by more than this factor: else a ground that is twice as bright passes for a layer."""

RELIT_LITTLE, RELIT_LEVEL, RELIT_LEAVES = 1.06, 1.15, 3.0
"""Where the markers' brightness has changed by more than the second factor, they are fitted again,
from brightness and ground as now: else what the light lacks counts as the model's misfit, and where
the model fits shaded markers badly, the robust fit ends in another place (.02 to .06 px off in .6
to .8 of the light). So they are from the first factor on, where squared residuals are at most the
third times those at rest: light of .9 to 1.1 leaves .9 to 2.1 times as much, defocus that takes a
twelfth of the brightness 5 times, JPEG 13 to 18 times."""

SMOOTHER = 0.88
"""Brightness, or both (`LayerSignal.brightness`), replaces a layer's colour where third harmonics
of edges at rest (`roughness_px`) are smaller by this factor."""

SHARPEST_PX, ROUGH_SHARP_PX, SHARP_PX = 0.73, 0.03, 0.85
"""Half width of a blur below which no edge is one of light on pixels: their own width blurs a
disc's to .75 px at least (fitted, with noise; by a box .76). Drawn dots without grey levels, and
sharp squares or crosses, end at the fit's limit of .7 px. Edges with a larger third harmonic are
such dots' up to the last one; lenses leave 1.2 px and more."""

SHARPEST_EDGE_PX = 1.0
"""Width of an edge (`OwnPictures.edge_px`) below which it is such dots': pixels that gather light
over their area leave .6 to .7 px (clean, JPEG 75, pale), with a blur of .3, .5 and .7 px .8, 1.1 to
1.2 and 1.4 to 1.7 px."""

CLEAR, SHADE_FOLLOWS = 1.1, 0.65
"""From which distance on, over the sum of their radii, a marker does not follow one in front of it.
Per axis and px of their relative motion, errors are the difference to that distance times the
blur's standard deviation over the radius (.4 to 1.6 times, 6 to 15 px wide), and the second number
times the shade's share."""

LEAST_EDGE = 0.5
"""Share of its edge by which a marker is measured; with less in sight it counts as hidden."""

ROUGH_PX, WIDE_PX, DIM_WIDE_PX = 0.07, 3.5, 7.0
"""Median third harmonic of edges at rest above which a layer's outlines are no ellipses: strain
turns a share of it into motion. Round dots have .003 to .03 px (8 to 44 px wide, JPEG 60, sharp or
pale), blue ones with half the resolution up to .064, on grained ground all up to .046; outlines off
by 1 % in each harmonic .09 to .18 (from 24 px on). Radius from which on an own picture shows it,
and that of a layer that hardly shows in the brightness: compression makes small ones as rough."""

CORNERED_PX = 0.6
"""The same of the fourth harmonic. Squares 24 px wide have 1.7 px, round dots up to .46 (15 px wide
under JPEG 60, blurred by 1.6 px), mostly below .1."""

UNLIKE = 0.12
"""Root mean square of what a fit leaves beyond what usual fits leave, as a share of the marker's
brightness, above which it is no picture of that marker. Noise that hangs together over pixels (a
capture unit's colour) is usual."""

HIDES = 0.28
"""A marker that lacks more of its light somewhere, and whose edge fits worse than at rest (`FITS`),
is partly hidden. Shadows in the shipped finger lack up to .26; where a tenth of a marker's width is
hidden, .31 (10 px wide) and .55 (15 px) are lacking."""

RESHAPES = 1.25
"""A marker has an outline and blur of its own if what that fit leaves exceeds the usual by less. Of
markers 10 px wide of which a fiftieth is hidden one in 40 leaves less, with more hidden none."""

MOVED = 4.0
"""Standard deviations by which a shape of its own moves a marker's centre by chance. Of 818 markers
7 were moved by more, most of them hidden by another layer but for a rim: errors were .6 to 1.2
times as large, up to 41 standard deviations. Without noise strain alone moves whole ones by more,
so a single layer's don't count."""

SHARPER = 0.7
"""Least share of the blur at rest that a shape of its own has where the rest picture is compressed.
"""

STRETCHED, BLURRED = 1.4, 2.5
"""Largest growth of a marker's semi-axis, and of the blur, that a shape of its own reaches to."""

KNOWN_OUTLINE, KNOWN_LEVEL, OPEN_LEVEL = 0.005, 0.02, 0.2
"""Least standard deviations of a marker's outline and brightness about its neighbours', as shares
of radius and brightness; and of the brightness of one that the frame cut at rest."""

SHADOW_MOVES = 4.0
"""A marker is not partly hidden while its squared residuals exceed the usual ones by less than this
factor times what they did at rest: a shadow that moves is missed twice."""

DIFFERS = 2.5
"""Standard deviations from its neighbours' beyond which an outline is not their common strain."""

LEAST_PART, WORST_PART_PX, PART_SETTLED_PX = 0.2, 0.1, 0.05
"""A partly hidden marker is measured by at least this share of its edge's information, to at least
this standard deviation, by a fit whose last step was smaller than the last."""

PART_ROUGHER = 1.3
"""Errors of parts in sight under compression, over those that residuals show: a marker's own
pattern, a glint for one, pulls where it fills more of what is left."""

UNSETTLED_PX = 0.3
"""A fit whose last step was larger has found nothing."""

SAME_PLACE = 0.5
"""Two markers of a layer nearer than this share of their width are one spot."""

SHRUNK = 0.9
"""At the picture's frame a marker that has become smaller than this may be cut."""

WORST_FITS, WORSE = 0.98, 1.5
"""A marker cut by the frame may leave so many times as much as this share of the whole ones: where
it is also compressed, its brightness beyond the frame is not known."""

LEAST_LIGHT = 3.0
"""Standard deviations by which a marker may have more light than it seems to."""

DIMS = 1.5
"""Standard deviations up to which a part in sight has less light than others by chance."""

LOST_MOVES = 0.7
"""By which share of its radius a marker's centre moves at least, over the share of its light that
something straight hides: of a disc's area by .86 to .9, of fits under JPEG by .65 to .9."""

MORE_UNUSUAL = 1.12
"""Largest factor by which residuals are usual where most markers have changed their shape: larger
outlines reach over more of the ground's texture."""


@dataclass(frozen=True, kw_only=True)
class DiscFit(SoftWindow):
    """Fits of templates, started from spots or from the last picture's fits.

    Attributes
    ----------
    templates, start_px
        What is fitted, and (n, 2) where the fits start at rest, px. Those in other pictures start
        as far from their expected places, so that the rest picture itself shows no motion at all.
    bare
        Bare ground whose noise hangs together over pixels; None where it doesn't.
    brightness_dn
        Median of the rest picture's brightness, counts.
    pictures
        Own pictures at rest of a layer's markers whose outlines are no ellipses (`ROUGH_PX`).
    rougher
        Whether this is for a picture whose noise hangs together over pixels, unlike at rest.
    """

    templates: Templates
    start_px: Pixels
    brightness_dn: float
    bare: BareGround | None = None
    pictures: OwnPictures | None = None
    rougher: bool = False

    @classmethod
    def at_rest(
        cls, picture: Picture, looks: list[Look], spacing_px: float, given: bool
    ) -> Sequence[SoftWindow]:
        spots = SoftWindow.at_rest(picture, looks, spacing_px, given)
        places = [spot.spot_px for spot in spots]
        marks = np.concatenate(places)
        groups: list[SoftWindow] = []
        signals = LayerSignal.of_layers(picture, looks, places, given)
        for spot, signal in zip(spots, signals, strict=True):
            if spot.look.hole_px:
                groups.append(spot.of_sharp(picture))
                continue
            group = cls._by(picture, spot, signal, marks)
            if group.templates.coherent and len(signal.others):
                rival = cls._by(picture, spot, signal.smeared, marks)
                # colours that are smeared fit better so
                left = [float(medians(one.templates.rest[:, MISFIT])) for one in (group, rival)]
                group = rival if left[1] < left[0] else group
            # Compression keeps more of the brightness than of the colours: is that the better one?
            bright = signal.by_brightness if group.templates.coherent else None
            if bright is not None:
                rival = cls._by(picture, spot, bright, marks)
                if rival.roughness_px < SMOOTHER * group.roughness_px:
                    group = replace(rival, templates=replace(rival.templates, coherent=True))
            if group._is_sharp:
                groups.append(spot.of_sharp(picture))
                continue
            bare = BareGround.of(picture, group.templates, group.around.rest_px, marks)
            group = replace(group, bare=bare)
            groups.append(group._behind([spots[rival] for rival in signal.hiding], signal.shade))
        return groups

    def _behind(self, fronts: Sequence[SoftWindow], shade: float) -> DiscFit:
        """Return this with what lies in front of its markers, of the layers ``fronts``, which take
        the share ``shade`` of the light around theirs.

        What is left of a marker at rest gives an outline that is not known on the hidden side,
        and the shade ends there, so the fit follows the edge of what hides it.
        """
        places = np.concatenate([np.empty((0, 2)), *(front.spot_px for front in fronts)])
        known, mine = np.isfinite(places[:, 0]), self.around.rest_px
        if not known.any():
            return self
        row = np.concatenate([front.look.rows for front in fronts])[known]
        wide = np.repeat(
            [front.look.diameter_px for front in fronts], [len(front.spot_px) for front in fronts]
        )[known]
        away, near = cKDTree(places[known]).query(np.nan_to_num(mine))
        ux, uy = (mine - places[known][near]).T / np.fmax(away, 1e-9)
        xx, xy, yy = self.templates.shape[:, :3].T
        usual = self.templates.usual_radius_px
        # its middle, were it whole, from its far side
        away += np.hypot(xx * ux + xy * uy, xy * ux + yy * uy) - usual
        near_by = np.clip(CLEAR - away / (usual + 0.5 * wide[near]), 0.0, CLEAR)
        share = medians(self.templates.blur_px) / usual + SHADE_FOLLOWS * shade
        return replace(self, front=row[near], follows=share * np.nan_to_num(near_by))

    @property
    def roughness_px(self) -> float:
        third = np.abs(self.templates.third)
        return float(np.nanmedian(third)) if np.isfinite(third).any() else np.inf

    @property
    def _is_sharp(self) -> bool:
        """Whether edges at rest are sharper than light leaves them on pixels."""
        if self.pictures:  # the blur of an ellipse is not that of another outline
            return self.pictures.edge_px(self.templates) < SHARPEST_EDGE_PX
        blur = medians(self.templates.shape[:, BLUR])
        return not blur > (SHARP_PX if self.roughness_px > ROUGH_SHARP_PX else SHARPEST_PX)

    @classmethod
    def _by(
        cls, picture: Picture, spots: SoftWindow, signal: LayerSignal, marks: Pixels
    ) -> DiscFit:
        """Make the templates of one layer's ``spots``, and take the centres of their fits for the
        rest positions."""
        templates, start = signal.make_templates(
            picture, spots.spot_px, spots.cut, spots.look.diameter_px, marks
        )
        around = Neighbourhood.of(start, spots.around.spacing_px)
        known = vars(spots) | {
            "around": around,
            "start_px": start,
            "brightness_dn": _brightness(picture),
        }
        # Markers that the frame cuts are fitted by their part in sight.
        fitted = templates.fit(picture, start, around.lead)
        here = cls(**known | {"templates": replace(templates, rest=fitted.copy())})
        cut = here._cut(fitted, start)
        if cut.any():
            fitted[cut] = here._fit(picture, start, around.lead)[cut]
        templates = replace(templates, rest=fitted.copy())
        # Rest positions, their standard deviations, and those of shifts to a picture alike.
        good = (fitted[:, EDGE] > LEAST_EDGE) & (fitted[:, LEVEL] >= spots.look.contrast_dn)
        good &= ~cut | (fitted[:, RESHAPED] == PART_IN_SIGHT)
        sd = templates.centre_sds(fitted)
        good &= np.isfinite(sd)
        sd[~good] = np.nan
        if cut.any() and (good & ~cut).any():
            # what whole outlines' third harmonics exceed the noise by is unknown of those cut
            square = np.nanmedian(templates.third[good & ~cut] ** 2) / NORMAL_MEDIAN
            noise = np.nanmedian(fitted[good & ~cut, VARIANCE])
            sd[cut] = np.hypot(sd[cut], np.sqrt(max(square - 2.0 * noise, 0.0)))
        pictures = None
        wide_px = WIDE_PX if signal.bright else DIM_WIDE_PX
        rough = good & ~cut & (templates.radius_px > wide_px)
        rows = np.flatnonzero(rough)
        if len(rows) and (
            here.roughness_px > ROUGH_PX
            or medians(OwnPictures.fourth_harmonics(picture, templates, rows)) > CORNERED_PX
        ):
            pictures = OwnPictures.of(picture, templates, rows)
            itself = fitted.copy()
            pictures.fit(picture, templates, itself, around)
            sd[rough] = np.sqrt(itself[rough, VARIANCE].mean(axis=1))
        covered = np.where(fitted[:, EDGE] < WHOLE_EDGE, COVERED_SD_PX, 0.0)
        rest_px = np.where(good[:, None], fitted[:, CENTRE], np.nan)
        return cls(
            **known
            | {
                "around": replace(around, rest_px=rest_px),
                "sd_px": sd,
                "usual_sd_px": np.sqrt(2.0 * (sd**2 + SD_FLOOR_PX**2) + covered**2),
                "templates": templates,
                "pictures": pictures,
            }
        )

    def measure(self, picture: Picture, start_px: Pixels | None) -> Seen:
        if start_px is not None and (warm := self._from_last(picture, start_px)):
            return warm
        return self.search(picture, start_px)

    def search(self, picture: Picture, start_px: Pixels | None) -> Seen:
        blobs, spot, state, spurious = self._search(picture, start_px)
        free = ~np.isin(np.arange(len(blobs)), spot)
        more = self.around.complete(blobs.centre_px, spot, free)
        spot = np.where((state == DIM) | (state == MERGED), spot, more)
        moved = (blobs.centre_px[spot] if len(blobs) else np.nan) - self.spot_px
        place = np.where((spot >= 0)[:, None], self.start_px + moved, np.nan)
        suited, fitted = self._as_bright(picture)._suited(picture, place)
        return replace(suited._judged(picture, fitted, state), spurious_px=spurious)

    def _as_bright(self, picture: Picture) -> DiscFit:
        """Return this with the counts from which on other layers show in such light as now."""
        if not len(self.templates.others):
            return self
        gain = _brightness(picture) / max(self.brightness_dn, 1.0)
        if 1.0 / BRIGHTER < gain < BRIGHTER:
            return self
        others = self.templates.others.copy()
        others[:, 3:UNCOVERED] *= np.float32(gain)
        return replace(self, templates=replace(self.templates, others=others))

    def _suited(self, picture: Picture, start_px: Pixels) -> tuple[DiscFit, Floats]:
        """Return the fits of all markers, and what judges them: by what is usual in this picture
        where most of them leave more than noise and shapes of their own explain, as where it is
        compressed and the rest picture is not."""
        templates, lead = self.templates, self.around.lead
        fitted = self._fit(picture, start_px, lead)
        if templates.coherent or np.count_nonzero(fitted[:, DOUBTED] > 0.0) < 2 * LEAST_SCORES:
            return self, fitted  # nearly always
        if not quantiles(fitted[:, MISFIT], 0.5)[0] > ROUGHER * templates.usual_misfit:
            return self, fitted
        usual, rest = quantiles(fitted[:, MISFIT], USUAL)[0], templates.rest.copy()
        rest[:, FITTING] *= min(quantiles(fitted[:, FITTING] / rest[:, FITTING], 0.5)[0], 1.0)
        now = replace(templates, coherent=True, usual_misfit=usual, rest=rest)
        suited = replace(self, templates=now, rougher=True)
        return suited, suited._fit(picture, start_px, lead)

    def _fit(self, picture: Picture, start_px: Pixels, lead: Ints | None = None) -> Floats:
        """Return (n, `COLUMNS`) fits of all markers, also of those that don't look as at rest."""
        templates = self.templates
        fitted = templates.fit(picture, start_px, lead)
        gain = float(medians(fitted[:, LEVEL] / templates.rest[:, LEVEL]))
        if self._in_other_light(fitted, max(gain, 1.0 / gain)):
            shape, ground = templates.shape.copy(), templates.ground.copy()
            shape[:, BRIGHT] *= gain
            ground[:, 0] += medians(fitted[:, GROUND] - templates.rest[:, GROUND])
            templates = replace(templates, shape=shape, ground=ground)
            fitted = templates.fit(picture, start_px, lead)
        relit = in_other_light(picture, templates, fitted, self.around, self._light_at_rest)
        light = fitted[:, LIT].copy()
        if relit:
            templates, fitted = relit
        cut = self._cut(fitted, start_px)
        if self.pictures:
            self.pictures.fit(picture, templates, fitted, self.around)
            cut &= fitted[:, RESHAPED] != OWN_PICTURE
        if np.fmax.reduce(fitted[:, DOUBTED]) > 0.0 or cut.any():  # seldom
            fitted = self._refit(picture, templates, fitted, cut, start_px)
        fitted[:, LIT] = light
        return fitted

    def _in_other_light(self, fitted: Floats, gain: float) -> bool:
        """Return whether light has changed the markers' brightness by the factor ``gain``, and not
        compression or a blur, which leave more than it does."""
        if not gain > RELIT_LITTLE:
            return False  # nearly always
        left = medians(fitted[:, MISFIT] / self.templates.rest[:, MISFIT])
        return bool(gain > RELIT_LEVEL or left < RELIT_LEAVES)

    def _refit(
        self, picture: Picture, templates: Templates, fitted: Floats, cut: Bools, start_px: Pixels
    ) -> Floats:
        """Return the fits with those replaced that no longer look as at rest: by a shape of their
        own, or, of markers unlike their neighbours or ``cut`` (n,) by the frame, the part in
        sight."""
        fitted[cut, MISFIT] = np.nan
        odd, doubted = self._unusual(fitted, fitted[:, MISFIT], templates.usual_misfit)
        doubted |= cut
        if not (odd | doubted).any():
            return fitted
        # If most markers are unusual, the noise may have grown: then they are fitted again.
        places = for_kernel(fitted[:, CENTRE])
        if 2 * odd.sum() > np.isfinite(places[:, 0]).sum():
            templates = replace(templates, noise=BareGround.noise_now(picture, templates, places))
            fitted = templates.fit(picture, places)
            odd, doubted = self._unusual(fitted, fitted[:, MISFIT], templates.usual_misfit)
        # Outlines as they are now: those at rest, grown, or a shape of their own.
        radius = templates.radius_px
        growth = (fitted[:, SCALE] - 1.0) * radius
        outline = templates.shape[:, [0, 1, 2, BLUR]].copy()
        outline[:, :3] += growth[:, None] * [1.0, 0.0, 1.0]
        misfit = fitted[:, MISFIT].copy()
        if odd.any():
            templates, misfit = self._fit_own_shapes(
                picture, templates, fitted, odd, places, outline
            )
        taken = fitted[:, RESHAPED] == OWN_SHAPE
        # What most markers of this picture lack of the model hides none of them.
        now = max(quantiles(misfit, USUAL)[0], templates.usual_misfit)
        templates = replace(templates, usual_misfit=now)
        doubted &= taken | cut | self._unusual(fitted, misfit, now)[1]
        if doubted.any():
            near = np.hypot(*(fitted[:, CENTRE] - start_px).T) < radius
            fitted[cut & ~near, CENTRE] = start_px[cut & ~near]
            self._fit_parts(picture, templates, fitted, doubted, cut, outline)
        return fitted

    def _fit_own_shapes(
        self,
        picture: Picture,
        templates: Templates,
        fitted: Floats,
        odd: Bools,
        places: Pixels,
        outline: Floats,
    ) -> tuple[Templates, Floats]:
        """Fit ``odd`` markers at ``places`` (n, 2) with an outline and blur of their own; where
        that leaves no more than the noise it replaces what ``fitted`` and ``outline`` hold. The
        slopes of brightness are those at rest, as blur and outline are even about the centre.

        Returns
        -------
        The templates with what is usual in this picture, and (n,) the least that a fit has left.
        """
        # Outline, blur and centre of every odd marker, looked at as far as its neighbours allow.
        known, rows = templates.shape, np.flatnonzero(odd)
        radius = np.full(len(known), np.nan)
        radius[rows] = np.sqrt(known[rows, 0] * known[rows, 2] - known[rows, 1] ** 2)
        bulge, blur = self.templates.usual_shape[5:7].tolist()
        largest = float(np.fmax.reduce(radius))
        clear = max(self.around.spacing_px - largest - blur, largest + blur)
        reach = min(STRETCHED * largest + BLURRED * blur, clear) + MARGIN_PX
        t = templates
        sloping = slope_terms(places, picture.shape) @ t.ground_slopes.T + t.ground[:, 1:3]
        others = t.others_at(t.others, places, picture.shape)
        seen = (picture, t.own, others, t.sites, sloping, places)
        shape = fit_shapes(*seen, radius, reach, t.noise, blur, bulge, free_blur=True)
        shape[:, 3:6] = known[:, 3:6]
        # These shapes are templates of a fit like all others.
        own = for_kernel(shape[:, :SHAPE])
        reshaped = replace(templates, shape=own, reach_px=reach)
        again = reshaped.fit(picture, for_kernel(shape[:, SHAPE : SHAPE + 2]))
        left = again[rows, MISFIT]
        if 2 * len(rows) > np.isfinite(places[:, 0]).sum() and np.isfinite(left).any():
            usual = float(np.nanquantile(left, USUAL))
            least = templates.usual_misfit
            usual = min(max(usual, least), MORE_UNUSUAL * least)
            templates = replace(templates, usual_misfit=usual)
        misfit = np.fmin(fitted[:, MISFIT], again[:, MISFIT])
        # Sizes stay relative to the shape at rest.
        taken = again[:, MISFIT] < RESHAPES * templates.usual_misfit
        if templates.coherent:  # errors at rest show less by a sharper outline than they are
            taken &= shape[:, BLUR] > SHARPER * known[:, BLUR]
        area, before = (t[:, 0] * t[:, 2] - t[:, 1] ** 2 for t in (shape, known))
        if len(templates.others):
            # A shape is even about the centre. Where it moves this, another layer leaves a rim.
            moved = ((again[:, CENTRE] - fitted[:, CENTRE]) ** 2).sum(axis=1)
            sds = templates.centre_sds(again), templates.centre_sds(fitted)
            chance = MOVED**2 * np.square(sds).sum(axis=0)
            again[:, VARIANCE] += 0.5 * np.fmax(moved - chance, 0.0)[:, None]
        fitted[taken] = again[taken]
        fitted[taken, SCALE] *= np.sqrt(area / before)[taken]
        fitted[taken, RESHAPED] = OWN_SHAPE
        outline[taken] = shape[taken][:, [0, 1, 2, BLUR]]
        return templates, misfit

    @cached_property
    def _light_at_rest(self) -> tuple[bool, Floats, Floats]:
        """What `in_other_light` needs of the rest picture."""
        at_rest = self.templates.rest
        ground = at_rest[:, GROUND] + self.templates.own[3]
        whole = ground + at_rest[:, LEVEL]
        shows = bool(medians(np.abs(whole)) > medians(np.abs(ground)))
        bright = whole if shows else ground
        logarithm = np.log(np.fmax(np.abs(bright), 1.0))
        return shows, bright, self.around.slopes(logarithm, at_rest[:, CENTRE])[0]

    def _cut(self, fitted: Floats, start_px: Pixels) -> Bools:
        """Return (n,) which markers the picture's frame cuts: less of the edge is in sight, or it
        has shrunk, and the frame is nearer than the edge."""
        height, width = self.look.picture_px
        cut = ~((fitted[:, EDGE] >= WHOLE_EDGE) & (fitted[:, SCALE] >= SHRUNK))
        rows = np.flatnonzero(cut)
        if not len(rows):
            return cut
        place = np.stack([fitted[rows, CENTRE], start_px[rows]])
        gap = np.fmin(place + 0.5, [width - 0.5, height - 0.5] - place)
        gap = np.fmin.reduce(gap, axis=(0, 2))
        cut[rows] = gap < self.templates.radius_px[rows]
        return cut

    def _unusual(self, fitted: Floats, misfit: Floats, now: float) -> tuple[Bools, Bools]:
        """Return which markers no longer look as at rest; and which may be partly hidden: of these,
        and of those whose edge fits worse than others', is uneven, or that have become smaller.

        ``misfit`` (n,) is the least that a fit has left, ``now`` what is usual in this picture.
        """
        templates, scale = self.templates, fitted[:, SCALE]
        odd = misfit > UNUSUAL * np.fmax(templates.rest[:, MISFIT], now)
        fitting = templates.rest[:, FITTING]
        fits = fitted[:, FITTING] / np.where(fitting > 0.0, fitting, np.nan)  # 0: refused at rest
        # one that has grown beyond what is looked at seems dim: no ground around it is in sight
        odd |= (scale * templates.radius_px + templates.shape[:, BLUR] > templates.reach_px) & (
            fits < FITS
        )
        low, middle, high = quantiles(scale, 0.25, 0.5, 0.75)
        least = middle - SMALLER * max(NORMAL * (high - low), LEAST_SPREAD)
        doubted = odd | (fits < FITS * min(quantiles(fits, 0.5)[0], 1.0)) | (scale < least)
        if not templates.coherent:
            square = ((fitted[:, THIRD] - templates.third) ** 2).sum(axis=1)
            doubted |= square > 2.0 * UNEVEN**2 * (fitted[:, VARIANCE].sum(axis=1))
        other = fitted[:, RESHAPED] != OWN_PICTURE
        lacked = np.fmax(templates.rest[:, MISFIT] - RESHAPES * templates.usual_misfit, 0.0)
        return odd & other, doubted & other & (misfit > now + SHADOW_MOVES * lacked)

    def _fit_parts(
        self,
        picture: Picture,
        templates: Templates,
        fitted: Floats,
        doubted: Bools,
        cut: Bools,
        outline: Floats,
    ) -> None:
        """Fit by the part in sight, in place, ``doubted`` markers that differ from their neighbours
        and of which a part is hidden, and those ``cut`` off; ``outline`` (n, 4) are semi-axes and
        blur, px."""
        known = np.isfinite(fitted[:, LEVEL])
        fine = known & ((fitted[:, RESHAPED] == OWN_SHAPE) | ~doubted)
        rows, expected = self._expected(templates, fitted, fine, doubted, cut, outline)
        if not len(rows):
            return
        radius, start = templates.radius_px, fitted[rows, CENTRE]
        part = expected.fit_visible(picture, templates, rows, start)
        # A fit that leaves no more than the noise, finds something hidden, and is certain, is good.
        worst = quantiles(fitted[fine, MISFIT], WORST_FITS)[0] if fine.any() else 0.0

        def judged(part: Floats) -> tuple[Bools, Bools]:
            limit = RESHAPES + 3.0 * np.sqrt(2.0 / np.maximum(part[:, PIXELS], 1.0))
            limit *= templates.usual_misfit
            like = part[:, MISFIT] < np.where(cut[rows], WORSE * np.fmax(limit, worst), limit)
            near = np.hypot(*(part[:, CENTRE] - start).T) < 2.0 * radius[rows]
            hides = like & (cut[rows] | (part[:, SHORTFALL] > 0.0)) & near
            good = hides & (part[:, FITTING] > LEAST_PART) & (part[:, STEP] < PART_SETTLED_PX)
            good &= (part[:, VARIANCE] < WORST_PART_PX**2).all(axis=1)
            # an outline that lacks as much by itself misleads where only a part of it is in sight
            return hides, good & (cut[rows] | ~(templates.rest[rows, SHORTFALL] > HIDES))

        hides, good = judged(part)
        failed = ~(good | cut[rows]) & (part[:, SHORTFALL] > 0.0)
        if failed.any():  # too much may be hidden for a start at the middle of the rest
            some = expected.only(failed)
            place = some.likeliest(picture, templates, rows[failed], start[failed])
            again = part.copy()
            again[failed] = some.fit_visible(picture, templates, rows[failed], place)
            found = judged(again)[1] & failed
            part[found] = again[found]
            hides, good = hides | found, good | found
        moved = np.hypot(*(part[:, CENTRE] - start).T)
        # `_judge` refuses what hides too much; good fits it takes for whole ones.
        refused = rows[hides | cut[rows]]
        fitted[refused, SHORTFALL], fitted[refused, FITTING] = 1.0, 0.0
        part[:, [SCALE, FITTING]], part[:, SHORTFALL] = 1.0, 0.0
        part[:, DIFFERENCE] = 0.0
        if templates.coherent:  # a part was left out, but is it the one that is hidden?
            lost = self._light_lost(fitted, fine, -DIMS)[rows] * ~cut[rows]
            lacks = np.fmax(LOST_MOVES * radius[rows] * lost - moved, 0.0)
            part[:, DIFFERENCE] = lacks / np.sqrt(2.0)
            part[~cut[rows], VARIANCE] *= PART_ROUGHER**2
        part[:, EDGE] = np.where(part[:, EDGE] < WHOLE_EDGE, LEAST_EDGE, 1.0)
        part[:, RESHAPED] = PART_IN_SIGHT
        fitted[rows[good]] = part[good]

    def _expected(
        self,
        templates: Templates,
        fitted: Floats,
        fine: Bools,
        doubted: Bools,
        cut: Bools,
        outline: Floats,
    ) -> tuple[Ints, Expected]:
        """Return which markers to fit by the part in sight, and what they should look like by their
        ``fine`` (n,) neighbours; under compression `DIFFERENCE` is filled. For the rest see
        `_fit_parts`."""
        # Which markers have another outline than their neighbours, as shares of the one at rest?
        taken, known = fitted[:, RESHAPED] == OWN_SHAPE, np.isfinite(fitted[:, LEVEL])
        rows = np.flatnonzero((known if templates.coherent else known & doubted) | cut)
        radius = templates.radius_px
        measured = np.column_stack(
            [
                (outline[:, :3] - templates.shape[:, :3]) / radius[:, None],
                fitted[:, LEVEL] / templates.level,
                outline[:, 3] / templates.shape[:, BLUR],
            ]
        )
        usual, spread = self.around.usual(measured, fine, rows)
        unknown = np.isnan(usual[:, 0])
        usual[unknown], spread[unknown] = [0.0, 0.0, 0.0, 1.0, 1.0], 0.0
        axes_sd = np.hypot(KNOWN_OUTLINE, spread[:, :3].max(axis=1))
        away = np.abs(measured[rows, :3] - usual[:, :3]).max(axis=1)
        beyond = np.sqrt(np.fmax(away**2 - (DIFFERS * axes_sd) ** 2, 0.0))
        if templates.coherent:  # what hides a part also takes its light
            most = self._light_lost(fitted, fine, LEAST_LIGHT)[rows]
            fitted[rows, DIFFERENCE] = radius[rows] * np.fmin(beyond, most)
        few = doubted[rows] & ((beyond > 0.0) | ~taken[rows]) | cut[rows]
        # What their neighbours lead to expect of these, were they whole.
        rows, usual, axes_sd, spread = rows[few], usual[few], axes_sd[few], spread[few]
        unknown = self.cut[rows]
        if unknown.any():
            whole = np.delete(templates.shape, np.flatnonzero(self.cut), axis=0)[:, :3]
            apart = medians(np.abs(whole - medians(whole))).max()
            axes_sd = np.hypot(axes_sd, unknown * 1.4826 * apart / radius[rows])
        level = templates.level[rows] * usual[:, 3]
        return rows, Expected(
            axes=templates.shape[rows, :3] + usual[:, :3] * radius[rows, None],
            axes_sd=axes_sd * radius[rows],
            level=level,
            level_sd=np.hypot(np.where(unknown, OPEN_LEVEL, KNOWN_LEVEL), spread[:, 3]) * level,
            blur=templates.shape[rows, BLUR] * usual[:, 4],
            bare=cut[rows],
        )

    def _light_lost(self, fitted: Floats, fine: Bools, chance: float) -> Floats:
        """Return (n,) by which share markers have less light than the ``fine`` ones (n,), plus
        ``chance`` standard deviations: brightness times area, since rest."""
        rest = self.templates.rest
        light = fitted[:, LEVEL] * fitted[:, SCALE] ** 2 / (rest[:, LEVEL] * rest[:, SCALE] ** 2)
        low, middle, high = quantiles(np.where(fine, light, np.nan), 0.25, 0.5, 0.75)
        return np.asarray(np.fmax(1.0 - (light - chance * NORMAL * (high - low)) / middle, 0.0))

    def _from_last(self, picture: Picture, last_px: Pixels) -> Seen | None:
        """Fit around the last places, then once more where the neighbours' motion predicts; None
        where too many are lost."""
        known, gate = self.around.rest_px, GATE * self.around.spacing_px
        start = self.start_px + last_px
        count = int(np.isfinite(known[:, 0]).sum())
        if not count or np.isfinite(start[:, 0]).sum() < (1.0 - TRUST) * count:
            return None
        nothing = np.full(len(known), MISSING, np.uint8)
        suited, fitted = self._suited(picture, start)
        seen = suited._judged(picture, fitted, nothing)
        shift, sd, state = seen.shift_px, seen.sd_px, seen.state
        expected, certain = self.around.predict(shift)
        with np.errstate(invalid="ignore"):
            astray = np.hypot(*(shift - expected).T) > gate
        again = np.flatnonzero(certain & (astray | ~np.isfinite(shift[:, 0])))
        if len(again):
            shift[astray & certain] = np.nan
            start = np.full_like(known, np.nan)
            start[again] = self.start_px[again] + expected[again]
            refit = suited._fit(picture, start)
            second = suited._judged(picture, refit, nothing)
            rows = again[np.hypot(*(second.shift_px[again] - expected[again]).T) < gate]
            kept = np.isfinite(shift[:, 0])
            if kept.any() and len(rows):
                taken = cKDTree((known + shift)[kept])
                apart, _ = taken.query(known[rows] + second.shift_px[rows])
                rows = rows[apart > SAME_PLACE * self.look.diameter_px]
            shift[rows], sd[rows] = second.shift_px[rows], second.sd_px[rows]
            state[rows] = second.state[rows]
            lost = again[np.isnan(shift[again, 0])]
            measured = np.isin(second.state[lost], (SEEN, STRAINED))
            state[lost] = np.where(measured, MISSING, second.state[lost])
            sd[lost] = np.nan
        return seen if np.isfinite(shift[:, 0]).sum() >= (1.0 - TRUST) * count else None

    def _judged(self, picture: Picture, fitted: Floats, state: NDArray[np.uint8]) -> Seen:
        """Return the motion by the accepted fits, and the states of the others."""
        templates = self.templates
        if self.rougher:  # parts are measured by an edge that is blurred since
            part = fitted[:, RESHAPED] == PART_IN_SIGHT
            fitted[part, SHORTFALL], fitted[part, FITTING] = 1.0, 0.0
        shift, state = np.empty((len(fitted), 2)), state.copy()
        _judge(
            fitted,
            self.around.rest_px,
            templates.level,
            templates.usual_misfit,
            templates.rest[:, FITTING],
            self.look.diameter_px,
            self.look.contrast_dn,
            self.look.picture_px,
            shift,
            state,
        )
        errors = ShiftErrors(
            picture=picture,
            templates=templates,
            around=self.around,
            rest_sd_px=self.sd_px,
            bare=self.bare,
            rougher=self.rougher,
            fitted=fitted,
            shift_px=shift,
        )
        correction, sd, coherence = errors.stated()
        state[(state == SEEN) & (fitted[:, RESHAPED] == OWN_SHAPE)] = STRAINED
        state[(state == SEEN) & (fitted[:, RESHAPED] == PART_IN_SIGHT)] = PARTLY_HIDDEN
        return Seen(
            shift_px=shift + correction,
            sd_px=sd,
            state=state,
            coherence=coherence,
            light=fitted[:, LIT],
        )


def _brightness(picture: Picture) -> float:
    """Return the median of the brightness of some of the pixels, counts."""
    return float(np.median(picture[::8, ::8].mean(axis=2)))


@njit(cache=True)
def _judge(fitted, rest, level, usual_misfit, fitting, diameter, contrast, size, shift, state):
    """Fill ``shift`` (n, 2), NaN where a fit is refused, and ``state`` (n,) where there was a fit.

    The other arguments are those of `Templates` and `Look`.
    """
    count, radius = len(fitted), 0.5 * diameter
    place_x, place_y = np.empty(count), np.empty(count)
    good = np.empty(count, np.int64)
    kept = 0
    for k in range(count):
        shift[k, 0], shift[k, 1] = np.nan, np.nan
        fit = fitted[k]
        if not math.isfinite(fit[LEVEL]):
            continue
        x, y, bright = fit[CENTRE_X], fit[CENTRE_Y], fit[LEVEL]
        mean_square = fit[SQUARES] / fit[PIXELS]
        area, against_rest = fit[SCALE] ** 2, bright / level[k]
        usual = max(usual_misfit, 1.0) / max(fit[MISFIT], 1e-9)
        unlike = math.sqrt(max(mean_square * (1.0 - usual), 0.0)) / bright
        if fit[EDGE] < LEAST_EDGE:
            inside = (
                radius - 0.5 < x < size[1] - 0.5 - radius
                and radius - 0.5 < y < size[0] - 0.5 - radius
            )
            state[k] = OCCLUDED if inside else MISSING
        elif against_rest < LEVEL_RATIO[0] or bright < contrast:
            state[k] = DIM
        elif area > AREA_RATIO[1] or against_rest > LEVEL_RATIO[1]:
            state[k] = MERGED
        elif fit[SHORTFALL] > HIDES and fit[FITTING] < FITS * fitting[k]:
            state[k] = PARTLY_HIDDEN
        elif area < AREA_RATIO[0] or unlike > UNLIKE or fit[STEP] > UNSETTLED_PX:
            state[k] = OCCLUDED
        else:
            state[k] = SEEN
            place_x[kept], place_y[kept], good[kept] = x, y, k
            kept += 1
    near = (SAME_PLACE * diameter) ** 2
    for i in range(kept):
        alone = 0
        for j in range(kept):
            alone += (place_x[i] - place_x[j]) ** 2 + (place_y[i] - place_y[j]) ** 2 <= near
        k = good[i]
        if alone > 1:
            state[k] = MERGED
            continue
        shift[k, 0], shift[k, 1] = place_x[i] - rest[k, 0], place_y[i] - rest[k, 1]
