"""Under the probe: where it sticks and where it slips, and its pressure beside the closed form."""

from __future__ import annotations

import numpy as np

from twin.results import RunResult, Touch
from twin.show import plots
from twin.show.maps import around, figure, longest
from twin.show.words import digits


def touch(result: RunResult) -> str:
    """Return the drawings under every probe; empty if nothing touches."""
    return "".join(f'<div class="two">{_map(one)}{_pressure(one)}</div>' for one in result.touches)


def _map(one: Touch) -> str:
    axes = plots.Axes.equal(*around(one.place_mm))
    per_unit = axes.per_unit
    stuck = ~one.slip
    boxes = []
    for (x, y), (a, b), slips in zip(
        axes.place(one.place_mm).tolist(), (one.half_mm * per_unit).tolist(), one.slip.tolist(), strict=True
    ):
        style = "push" if slips else "dot blue"
        boxes.append(
            f'<rect class="{style}" x="{x - a:.2f}" y="{y - b:.2f}" width="{2 * a:.2f}" height="{2 * b:.2f}" '
            'fill-opacity="0.6"/>'
        )
    largest = longest(one.shear_mpa)
    content = "".join(boxes)
    if one.friction > 0 and largest > 0:
        length = 4.0 * float(np.median(one.half_mm)) / largest
        content += plots.arrows(axes, one.place_mm, one.shear_mpa * length, "force")
    share = float(np.prod(one.half_mm, axis=1)[stuck].sum() / np.prod(one.half_mm, axis=1).sum())
    if one.friction == 0:
        caption = f"Patches under the {one.probe}; without friction all of them slide."
    else:
        law = "sticking" if np.isinf(one.friction) else f"friction {digits(one.friction)}"
        caption = (
            f"Under the {one.probe}, {law}: blue sticks ({digits(100 * share)} % of the area), orange slips. Arrows "
            f"are the shear on the body, the longest {digits(largest)} N/mm²."
        )
    say = f"Map of stick and slip under the {one.probe}, {len(one.slip)} patches, {int(stuck.sum())} stick"
    return figure(plots.drawing(axes, content, "along the surface (mm)", "across that (mm)", say), caption)


def _pressure(one: Touch) -> str:
    distance = np.hypot(one.place_mm[:, 0], one.place_mm[:, 1])
    theory = one.expected
    shown = theory[theory[:, 1] <= 1.3 * one.pressure_mpa.max()]
    right = float(max(distance.max(), shown[:, 0].max(initial=0.0))) * 1.05
    top = float(max(one.pressure_mpa.max(), shown[:, 1].max(initial=0.0))) * 1.08
    axes = plots.Axes(left=0.0, right=right, bottom=0.0, top=top, height=260)
    content = plots.line(axes, shown, "profile truth") if len(shown) else ""
    content += plots.dots(axes, np.column_stack([distance, one.pressure_mpa]), "profile-dot estimate", 2.0)
    keys = '<span class="key estimate-line">this press</span>'
    if len(shown):
        keys += f' <span class="key truth-line">{one.expected_name}, same force</span>'
    peak = digits(float(one.pressure_mpa.max()))
    say = f"Pressure of every patch against its distance from the middle, at most {peak} N/mm²"
    svg = plots.drawing(axes, content, "from the contact's middle (mm)", "pressure (N/mm²)", say)
    return figure(svg, f"Pressure of each patch. {keys}")
