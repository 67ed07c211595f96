"""Drawings as data: what a reproduced figure shows, before anything is drawn. Drawn by `twin.show.drawn`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from twin.arrays import Floats, Picture, Pixels, Points


@dataclass(frozen=True, kw_only=True)
class PicturePanel:
    """A CCD picture, with marks on it.

    Attributes
    ----------
    picture
        (h, w, 3) uint8.
    marks_px
        (n, 2) places marked on it, px.
    """

    title: str
    picture: Picture
    marks_px: Pixels | None = None


@dataclass(frozen=True, kw_only=True)
class ArrowPanel:
    """Arrows in the picture.

    Attributes
    ----------
    tails_px, shifts_px
        (n, 2) places and shifts, px.
    colours
        (n,) colour of every arrow.
    magnified
        Times the arrows are longer than the shifts.
    """

    title: str
    tails_px: Pixels
    shifts_px: Pixels
    colours: Sequence[str]
    magnified: float


@dataclass(frozen=True, kw_only=True)
class HistogramPanel:
    """Histograms of samples by label, ``bounds`` apart into ``bins``; dashed lines at ``marked``."""

    title: str
    samples: Mapping[str, Floats]
    across: str
    bounds: tuple[float, float]
    bins: int = 40
    marked: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A line, or dots, through (n,) points."""

    label: str
    x: Floats
    y: Floats
    style: str = "-"
    colour: str | None = None


@dataclass(frozen=True, kw_only=True)
class CurvePanel:
    """Curves over one axis; ``level`` is a named horizontal line."""

    title: str
    curves: Sequence[Curve]
    across: str
    up: str
    levels: Mapping[str, float] = field(default_factory=dict)
    logarithmic: bool = False


@dataclass(frozen=True, kw_only=True)
class FieldPanel:
    """Forces on sites: colour is the force along z, arrows those along the surface; the dashed contour is the contact.

    Attributes
    ----------
    site_mm, force_n
        (k, 3) sites, mm, and forces, N.
    side_mm
        Side of the square drawn for a site.
    outline_mm
        (m, 2) border of the true contact, mm.
    """

    title: str
    site_mm: Points
    force_n: Floats
    side_mm: float
    outline_mm: Floats | None = None


@dataclass(frozen=True, kw_only=True)
class BarPanel:
    """Named lengths; ``marks`` are a value to set against each, called ``marked``."""

    title: str
    values: Mapping[str, float]
    across: str
    marks: Mapping[str, float] = field(default_factory=dict)
    marked: str = ""


Panel = PicturePanel | ArrowPanel | HistogramPanel | CurvePanel | FieldPanel | BarPanel
