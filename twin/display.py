"""How results show themselves: one line of text, a table in a notebook, axes, a data frame.

The classes of results live in several wings, which may not import `twin.show`. They give plain
arrays to the functions here. matplotlib and pandas are imported when something is drawn or
tabulated, never before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, ClassVar

import numpy as np

from twin.arrays import Bools, Floats, Picture, Pixels, Points, eight_bits, mean_spacing, nice
from twin.errors import MissingCapability

_MAP = "PuOr_r"
"""Colours of the force along z: orange pushes into the body, purple pulls out, as in reports."""

_LAYERS = {"red": "#c8381e", "blue": "#1f5fbf"}
_OTHERS = ("#1b7a5a", "#7a4fb5", "#946c00")
"""Colours of marker layers by name, and of layers of other names in turn."""

_BAR = 0.75
"""Height of a colour bar over that of its panel."""

_LONGEST = 1.5
"""Length of the longest arrow over the mean distance of neighbours, at the most."""


def one_line(name: str, facts: Sequence[str]) -> str:
    """Return ``Name(fact, fact)``, without empty facts."""
    return f"{name}({', '.join(fact for fact in facts if fact)})"


def vector(values: Floats, unit: str, sd: Floats | None = None) -> str:
    """Return a vector to three digits, with its standard deviations: ``(0, 0, 1.25) N``; round-off
    of the largest is 0."""
    size = float(np.abs(values).max(initial=0.0))
    shown = ", ".join(f"{v:.3g}" if abs(v) > 1e-9 * size else "0" for v in values)
    return f"({shown}) {unit}" if sd is None else f"({shown}) +- {vector(sd, unit)}"


def html_table(title: str, rows: Mapping[str, str], picture: str = "") -> str:
    """Return a small table for notebooks; ``picture`` is the source of an image next to it."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows.items()
        if value
    )
    image = f'<img src="{picture}" alt="{escape(title)}" style="max-width:24em">' if picture else ""
    return f"<div><strong>{escape(title)}</strong><table>{cells}</table>{image}</div>"


class Table:
    """A result with `columns` of equal length, and a line of text or a short table about it."""

    _title: ClassVar[str]

    def __repr__(self) -> str:
        return one_line(type(self).__name__, [f"{k} {v}" for k, v in self._rows().items() if v])

    def _rows(self) -> Mapping[str, str]:
        """Return the facts of both by name; empty ones are left out."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return html_table(self._title, self._rows())

    def columns(self) -> dict[str, Any]:
        """Return the columns by name."""
        raise NotImplementedError

    def to_pandas(self) -> Any:
        """Return `columns` as a pandas ``DataFrame``.

        Raises
        ------
        MissingCapability
            pandas isn't installed.
        """
        try:
            import pandas
        except ImportError:
            raise MissingCapability(
                "to_pandas() needs pandas, which is not installed: pip install pandas. "
                ".columns() returns the same table as a dict of arrays"
            ) from None
        return pandas.DataFrame(self.columns())


class ForceTable(Table):
    """A result with forces on k sites, and a row for each of them."""

    site_mm: Points
    force_n: Points
    sd_force_n: Floats

    def columns(self) -> dict[str, Floats]:
        """Return a row for every site: place, mm, force, N, and its standard deviation, N."""
        parts = {"{}_mm": self.site_mm, "f{}_n": self.force_n, "sd_f{}_n": self.sd_force_n}
        return {
            name.format(axis): part[:, number]
            for name, part in parts.items()
            for number, axis in enumerate("xyz")
        }

    def plot(self, ax: Any = None) -> Any:
        """Draw the forces on matplotlib axes, new ones if none are given, and return these."""
        return plot_forces(new_axes(1, ax), self.site_mm, self.force_n, "recovered forces")


def new_axes(count: int, ax: Any = None) -> Any:
    """Return ``ax``, or the axes of a new figure with ``count`` panels side by side; one panel is
    returned alone.
    """
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    size = (4.6 * count, 3.8)
    return plt.subplots(1, count, figsize=size, layout="constrained")[1]


def plot_shifts(
    ax: Any,
    rest_px: Pixels,
    shift_px: Pixels,
    layer: np.ndarray,
    picture: Picture | None = None,
    factor: float | None = None,
) -> Any:
    """Draw the motion of markers in the picture as arrows, longer by a stated factor.

    Parameters
    ----------
    ax
        matplotlib axes to draw on.
    rest_px, shift_px
        (n, 2) centres at rest and shifts, px; NaN where lost.
    layer
        (n,) layer names; empty if unknown.
    picture
        Drawn below the arrows.
    factor
        How many times as long the arrows are drawn; if None, as long as the distance of neighbours
        allows.
    """
    good = np.isfinite(rest_px).all(axis=1) & np.isfinite(shift_px).all(axis=1)
    lengths = np.hypot(*shift_px[good].T)
    if factor is None:
        longest = float(lengths.max(initial=0.0))
        wanted = _LONGEST * mean_spacing(rest_px[good])
        factor = max(1.0, nice(wanted / longest)) if longest else 1.0
    names = layer if len(layer) == len(rest_px) else np.full(len(rest_px), "markers")
    spare = iter(_OTHERS * (1 + len(set(names.tolist()))))
    for name in dict.fromkeys(names.tolist()):
        rows = good & (names == name)
        ax.quiver(
            *rest_px[rows].T,
            *(factor * shift_px[rows]).T,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.004,
            color=_LAYERS.get(name) or next(spare),
            label=f"{name} layer" if name != "markers" else name,
        )
    if picture is None:
        _show_ends(ax, rest_px[good], factor * shift_px[good])
    _in_px(ax, picture)
    ax.set_title(f"marker motion, drawn {factor:g} times as long")
    if len(set(names[good].tolist())) > 1:
        ax.legend(loc="upper right", frameon=picture is not None)
    return ax


def plot_layout(
    ax: Any, layout_px: Mapping[str, Pixels], stray_px: Pixels, picture: Picture | None = None
) -> Any:
    """Ring the markers of each layer in the picture, and cross the spots that are none.

    Parameters
    ----------
    ax
        matplotlib axes to draw on.
    layout_px, stray_px
        (n, 2) centres by layer, and of other spots, px.
    picture
        Drawn below the rings.
    """
    spare = iter(_OTHERS * (1 + len(layout_px)))
    for name, centres in layout_px.items():
        colour = _LAYERS.get(name) or next(spare)
        label = f"{name} layer, {len(centres)} markers"
        ax.plot(*centres.T, "o", mfc="none", mec=colour, ms=8, label=label)
    if len(stray_px):
        ax.plot(*stray_px.T, "x", color="#1d2126", ms=6, label="on no lattice")
    _in_px(ax, picture)
    # Above the axes, where it covers no marker.
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    return ax


def plot_forces(
    ax: Any, site_mm: Points, force_n: Floats, title: str, largest_n: float | None = None
) -> Any:
    """Draw a force field seen along z: colour is the force along z, arrows are along x and y.

    Parameters
    ----------
    ax
        matplotlib axes to draw on.
    site_mm, force_n
        (k, 3) places and forces, mm and N.
    title
        Of the axes.
    largest_n
        Force along z at the ends of the colours, N; that of this field if None.
    """
    top = largest_n or float(np.abs(force_n[:, 2]).max(initial=0.0)) or 1.0
    shown = ax.scatter(
        *site_mm[:, :2].T, c=force_n[:, 2], cmap=_MAP, vmin=-top, vmax=top, marker="s", s=40
    )
    along = float(np.hypot(force_n[:, 0], force_n[:, 1]).max(initial=0.0))
    if along > 0:
        # noise under a straight push must look small: a tenth of the normal force at least
        scale = max(along, 0.1 * top) / (_LONGEST * mean_spacing(site_mm))
        ax.quiver(
            *site_mm[:, :2].T,
            *force_n[:, :2].T,
            angles="xy",
            scale_units="xy",
            scale=scale,
            width=0.004,
        )
        _show_ends(ax, site_mm[:, :2], force_n[:, :2] / scale)
    ax.figure.colorbar(shown, ax=ax, label="force along z (N)", shrink=_BAR)
    _in_mm(ax, title)
    return ax


_DISTINCT = 0.95
"""Share of the patches whose pressures have colours of their own."""


def plot_patches(ax: Any, corner_mm: Floats, pressure_mpa: Floats, slip: Bools) -> Any:
    """Draw the pressures of contact patches, slipping ones with a dot.

    Parameters
    ----------
    ax
        matplotlib axes to draw on.
    corner_mm
        (k, 4, 3) corners, mm.
    pressure_mpa, slip
        (k,) pressures, MPa, and whether each patch slips.
    """
    from matplotlib.collections import PolyCollection

    drawn = PolyCollection(list(corner_mm[:, :, :2]), array=pressure_mpa, cmap="viridis")
    if len(pressure_mpa):  # the few highest, at sharp edges, would leave no colours to the others
        drawn.set_clim(0.0, float(np.quantile(pressure_mpa, _DISTINCT)))
    ax.add_collection(drawn)
    ax.autoscale_view()
    if slip.any() and not slip.all():
        ax.plot(*corner_mm[slip].mean(axis=1)[:, :2].T, "w.", ms=2, label="slips")
        ax.legend(loc="upper right", facecolor="#666666", labelcolor="white")
    ax.figure.colorbar(drawn, ax=ax, label="pressure (MPa)", extend="max", shrink=_BAR)
    _in_mm(ax, f"contact, {len(pressure_mpa)} patches")
    return ax


def _show_ends(ax: Any, start: Floats, arrow: Floats) -> None:
    """Widen the axes to the ends of (n, 2) arrows."""
    ax.update_datalim(start + arrow)
    ax.autoscale_view()


def _in_px(ax: Any, picture: Picture | None) -> None:
    if picture is None:
        ax.invert_yaxis()
    else:
        ax.imshow(eight_bits(picture), cmap="gray")  # of one channel; colours are shown as they are
    ax.set_aspect("equal")
    ax.set_xlabel("column (px)")
    ax.set_ylabel("row (px)")


def _in_mm(ax: Any, title: str) -> None:
    ax.set_aspect("equal")
    ax.set_xlabel("x (mm)")
    ax.set_ylabel("y (mm)")
    ax.set_title(title)
