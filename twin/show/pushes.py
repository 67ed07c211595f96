"""The force field: truth beside estimate on the same sites, in the same colours, to the same scale."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.arrays import Floats, Points
from twin.results import RunResult, Truth
from twin.show import plots
from twin.show.words import cleaned, digits, finite, table

CHUNK = 512
"""Pieces of the truth whose distances to all sites are held at once."""


def pushes(result: RunResult) -> str:
    """Return drawings, profile and resultants of the force field; only resultants if there are no sites."""
    truth, found = result.truth, result.estimate
    if found is None or len(found.site_mm) == 0:
        return _resultants(result)
    fields: list[tuple[str, Floats]] = []
    if truth is not None and len(truth.surface_mm):
        fields.append(("truth", truth_by_site(truth, found.site_mm)))
    if len(found.force_n) == len(found.site_mm):
        fields.append(("estimate", found.force_n))
    if not fields:
        return _resultants(result)
    return _maps(result, found.site_mm, fields) + _profile(found.site_mm, fields) + _resultants(result)


def truth_by_site(truth: Truth, sites: Points) -> Floats:
    """Return (k, 3) true forces, N, each piece of the contact added to its nearest site, as the judge does."""
    total = np.zeros((len(sites), 3))
    for start in range(0, len(truth.surface_mm), CHUNK):
        pieces = truth.surface_mm[start : start + CHUNK]
        squared = ((pieces[:, None] - sites[None]) ** 2).sum(axis=2)
        np.add.at(total, squared.argmin(axis=1), truth.surface_force_n[start : start + CHUNK])
    return total


def cell_side(sites: Points) -> float:
    """Return the side of the square drawn for a site, mm: the least distance of two sites seen along z."""
    if len(sites) < 2:
        return 1.0
    apart = np.hypot(*(sites[:, None, :2] - sites[None, :, :2]).transpose(2, 0, 1))
    apart[apart < 1e-6] = np.inf
    least = float(apart.min())
    return least if np.isfinite(least) else 1.0


def _maps(result: RunResult, sites: Points, fields: list[tuple[str, Floats]]) -> str:
    side = cell_side(sites)
    (left, low), (right, high) = sites[:, :2].min(axis=0), sites[:, :2].max(axis=0)
    axes = plots.Axes.equal(left - side, right + side, low - side, high + side)
    normal = max(float(np.abs(f[:, 2]).max()) for _, f in fields)
    along = max(float(np.hypot(f[:, 0], f[:, 1]).max()) for _, f in fields)
    # a tenth of the normal force at least: under a frictionless press the estimate's noise must look like noise
    per_cell = plots.nice(max(along, 0.1 * normal) / 1.5)
    outline = _contact(result)
    panels = []
    for name, force in fields:
        content = plots.cells(axes, sites[:, :2], side, force[:, 2], normal)
        if outline is not None:
            content += plots.circle(axes, *outline, "contact")
        content += plots.dots(axes, sites[:, :2], "site", 0.9)
        content += plots.arrows(axes, sites[:, :2], force[:, :2] * side / per_cell, "force")
        peak = int(np.argmax(np.abs(force[:, 2])))
        where = f"({digits(float(sites[peak, 0]))}, {digits(float(sites[peak, 1]))}) mm"
        say = f"Force field, {name}: largest force along z {digits(float(force[peak, 2]))} N at {where}"
        svg = plots.drawing(axes, content, "x (mm)", "y (mm)", say)
        panels.append(f"<figure>{svg}<figcaption>{name.capitalize()}</figcaption></figure>")
    top = digits(normal)
    bar = f'<div class="ramp"><span>−{top} N</span><span class="colours"></span><span>{top} N</span></div>'
    circle = " The dashed circle is as large as the true contact." if outline is not None else ""
    note = (
        f"Colour is the force along z on each site (orange pushes into the body, purple pulls out); arrows are the "
        f"force along x and y, one cell ({digits(side)} mm) long for {digits(per_cell)} N.{circle}"
    )
    if len(fields) == 2:
        note += " The truth is summed into the cells of the estimate."
    return f'<div class="two">{"".join(panels)}</div>{bar}<p class="note">{note}</p>'


def _contact(result: RunResult) -> tuple[tuple[float, float], float] | None:
    """Return centre and radius of the true contact, mm, if the run tells a radius."""
    contact, truth = result.facts.get("contact"), result.truth
    radius = finite((contact if isinstance(contact, Mapping) else result.facts).get("contact_radius_mm"))
    if truth is None or not len(truth.surface_mm) or radius is None or radius <= 0:
        return None
    low, high = truth.surface_mm[:, :2].min(axis=0), truth.surface_mm[:, :2].max(axis=0)
    x, y = ((low + high) / 2).tolist()
    return (x, y), radius


def _profile(sites: Points, fields: list[tuple[str, Floats]]) -> str:
    """Return the force along z on the row of sites through the strongest one; empty for fewer than three sites."""
    strongest = int(np.argmax(np.abs(fields[0][1][:, 2])))
    row = np.flatnonzero(np.abs(sites[:, 1] - sites[strongest, 1]) < cell_side(sites) / 2)
    row = row[np.argsort(sites[row, 0])]
    if len(row) < 3:
        return ""
    x = sites[row, 0]
    values = np.concatenate([f[row, 2] for _, f in fields])
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    margin = 0.08 * (high - low) or 1.0
    axes = plots.Axes(
        left=float(x[0]) - 0.5, right=float(x[-1]) + 0.5, bottom=low - margin, top=high + margin, height=200
    )
    zero = np.array([[axes.left, 0.0], [axes.right, 0.0]])
    content = plots.line(axes, zero, "zero")
    for name, force in fields:
        points = np.column_stack([x, force[row, 2]])
        content += plots.line(axes, points, f"profile {name}") + plots.dots(axes, points, f"profile-dot {name}", 2.4)
    at = digits(float(sites[strongest, 1]))
    keys = " ".join(f'<span class="key {name}-line">{name}</span>' for name, _ in fields)
    svg = plots.drawing(axes, content, "x (mm)", "force along z (N)", f"Force along z on the sites at y = {at} mm")
    return f'<figure class="single">{svg}<figcaption>Through the contact, y = {at} mm. {keys}</figcaption></figure>'


def _resultants(result: RunResult) -> str:
    heads, columns = [], []
    for name, arrays in (("truth", result.truth), ("estimate", result.estimate)):
        if arrays is not None and len(arrays.total_force_n) == 3 and len(arrays.total_torque_nmm) == 3:
            force = arrays.total_force_n.tolist()
            arm_mm = 1.0  # a torque below a billionth of the force times a millimetre is round-off
            scale = arm_mm * max(abs(f) for f in force)
            numbers = cleaned(force) + cleaned(arrays.total_torque_nmm.tolist(), scale)
            heads.append(name)
            columns.append([f'<data value="{n!r}">{digits(n)}</data>' for n in numbers])
    if not columns:
        return ""
    names = [f"force along {a}, N" for a in "xyz"] + [f"torque about {a}, N mm" for a in "xyz"]
    rows = [(name, list(cells)) for name, cells in zip(names, zip(*columns, strict=True), strict=True)]
    return table("Total force, and torque about the origin", heads, rows)
