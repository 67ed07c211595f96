"""What a path with friction refuses: forces beyond what friction can carry, and slides beyond the patches."""

from __future__ import annotations

import numpy as np

from twin.errors import ContactError
from twin.world.contact.capacity import asked_share
from twin.world.contact.first_guess import nearest, without_friction
from twin.world.contact.friction_grid import FrictionGrid, Memory
from twin.world.contact.gap import TURN, X, Y, Z
from twin.world.contact.probe_shape import half_extent
from twin.world.contact.together import Control

SLIDE_LIMIT = 0.05
"""How far a flat face may slide as a whole, over its smaller width."""

KNOWN_TO = 0.05
"""How well `twin.world.contact.capacity` knows what friction can carry, over the whole."""

_RUBBED = [X, Y, Z, TURN]
"""The components of a probe's place that `twin.world.contact.capacity` knows."""


def explain(
    grid: FrictionGrid, memory: Memory, control: Control, problem_found: ContactError, least: float = 1.0
) -> None:
    """Raise a ContactError that names the cause when ``least`` times what friction can carry is asked, or more."""
    place = np.where(control.by_force, memory.place, control.given)
    near = nearest(grid, memory, place)
    pushed = without_friction(grid, grid.problem(memory, control), memory, control, near)
    for number, (_, rows, motions) in enumerate(grid.contacts.rows):
        carried, friction = grid.carried[rows, :, motions][..., _RUBBED], float(grid.friction[number])
        held, given = control.by_force[motions][_RUBBED], control.given[motions][_RUBBED]
        share = asked_share(carried, pushed.force_n[rows, 2], friction, held, given)
        if share >= least:
            asked = [f"{value:.4g}" for value in np.where(held, given, 0.0)]
            raise ContactError(
                f"contact: the forces ({', '.join(asked[:3])}) N and the torque {asked[3]} N mm can't be balanced: "
                f"sideways and about z they are {share:.4g} times what friction {friction:g} can carry on this surface "
                f"(allowed is less than 1 times, known to {KNOWN_TO:g}), so that the probe slides: ask for less, push "
                "harder, raise press.friction, or hold x, y and the turn by motion"
            ) from problem_found


def refuse_slide(grid: FrictionGrid, memory: Memory) -> None:
    """Raise a ContactError when the probe slid, or was lifted over, to where there are no patches."""
    for (setting, _, _), patches, moved in zip(grid.contacts.rows, grid.contacts.grids, memory.slid_mm, strict=True):
        slid = float(np.hypot(*moved))
        if setting.face is None:
            under = (patches.centre_mm - setting.first.axis_mm) @ setting.first.axes[:Z].T - moved
            off, allowed = float(np.hypot(*under.T).min()), 4.0 * float(patches.half_mm.max())
            what = "beyond the patches, which lie around where it touched first"
        else:
            off, allowed = slid, SLIDE_LIMIT * 2 * min(half_extent(setting.face))
            what = "as a whole, while the patches under a flat face stay where they are"
        if off > allowed:
            raise ContactError(
                f"contact: the {setting.probe.kind} slides (or is lifted) by {slid:.3g} mm, {what} (off by {off:.3g} "
                f"mm, allowed {allowed:.3g} mm): move it less, raise press.friction, or press it anew where it ends"
            )
