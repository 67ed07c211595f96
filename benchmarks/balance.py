"""Whether a refusal for want of friction is right: the given force against the cone of friction, worked out apart.

A refusal is right where the force lies well outside the cone about the body's normal at the point that the probe
meets first. Near the cone's edge that normal doesn't tell, as contact is wide and the body curved: there the probe is
dragged, held sideways by motion, along the part of the force that friction has to carry. Of all forces that friction
can carry the one of a slide along v gains most along v (the inequality of limit analysis, as in
`twin.world.contact.capacity`): what is asked beyond the largest force along v can't be balanced.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.errors import ContactError
from twin.parts.body import Body
from twin.parts.press import Cone, Pillar, Press, Probe, Sphere, Step, Stl
from twin.world.contact.contact import ContactState

NEAR = 0.15
"""How far off the edge of the cone, over its size, the normal at first touch is not relied on."""

_ACROSS, _DRAGS = 81, 12


@dataclass(frozen=True, kw_only=True)
class Asked:
    """``share``: the force's tangential part over what friction carries of its normal one; ``ahead``: (2,) its way."""

    share: float
    ahead: Floats


def asked(press: Press, body: Body) -> Asked | None:
    """Return what the last step of a press asks of friction; None where it gives no force sideways."""
    last = press.steps[-1].force_n
    if last is None or not 0.0 < press.friction < math.inf or any(given is None for given in last):
        return None
    force, normal = np.array(last, float), _normal(press, body)
    push = float(force @ normal)
    rest = force - push * normal
    size = float(np.linalg.norm(rest))
    return Asked(share=size / (press.friction * push), ahead=rest[:2] / max(float(np.hypot(*rest[:2])), 1e-300))


def _normal(press: Press, body: Body) -> Floats:
    """Return the body's normal where an upright probe meets it first."""
    offset, height = _underside(press.probe)
    points = body.surface_from_above(np.array(press.at_mm) + offset)
    first = int(np.nanargmin(points[:, 2] + height))
    return np.asarray(body.frames(points[first : first + 1])[0, 2])


def _underside(probe: Probe) -> tuple[Floats, Floats]:
    """Return points (n, 2) under a probe, and its heights there over its lowest point."""
    assert not isinstance(probe, Stl)
    x, y = (probe.width_mm, probe.length_mm) if isinstance(probe, Pillar) else (probe.diameter_mm, probe.diameter_mm)
    steps = np.linspace(-0.5, 0.5, _ACROSS)
    offset = np.stack(np.meshgrid(x * steps, y * steps), axis=-1).reshape(-1, 2)
    away = np.hypot(*offset.T)
    if not isinstance(probe, Pillar):
        offset, away = offset[away <= x / 2], away[away <= x / 2]
    if isinstance(probe, Sphere):
        return offset, x / 2 - np.sqrt((x / 2) ** 2 - away**2)
    return offset, away / math.tan(math.radians(probe.apex_deg / 2)) if isinstance(probe, Cone) else 0.0 * away


def rightly_refused(press: Press, body: Body, solve: Callable[[Press], ContactState]) -> bool:
    """Return whether no equilibrium exists under the forces of a press's last step; ``solve`` solves another press."""
    if (wanted := asked(press, body)) is None or wanted.share < 1.0 - NEAR:
        return False
    if wanted.share > 1.0 + NEAR:
        return True
    force = press.steps[-1].force_n
    assert force is not None
    before = solve(press.model_copy(update={"steps": press.steps[:-1]}))
    x, y = 4.0 * press.friction * before.indentation_mm / _DRAGS * wanted.ahead
    drag = (Step(force_n=(None, None, force[2]), move_mm=(float(x), float(y), None)),) * _DRAGS
    try:
        path = solve(press.model_copy(update={"steps": (*press.steps[:-1], *drag)})).path
    except ContactError as stopped:  # dragged out of its patches: what came before counts
        path = stopped.last_state.path if stopped.last_state else ()
    reached = [float(state.force_n[:2] @ wanted.ahead) for state in path[len(press.steps) - 1 :]]
    slid = bool(path) and bool(path[-1].slip.all())
    return slid and float(np.array(force[:2], float) @ wanted.ahead) > max(reached)
