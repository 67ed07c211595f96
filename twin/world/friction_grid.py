"""The patches of a press with friction: one grid for its whole path, what they remember, and their gaps.

Why gaps of two kinds: a patch that has touched moves with the probe in all three directions, from where it touched.
For one that has not, the exact shape of the probe counts as it comes down, while sideways the surface near a probe goes
along with it and the gap changes only by the slope of the surface. What the probe slides as a whole is taken off: a
sphere that slid meets the body elsewhere.

Validity: one slide for all patches, taken as the least slip of those in contact; a flat face has no patches to slide to
(`twin.world.friction`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats
from twin.parts.press import Sphere
from twin.world.gap import TURN, X, Y, Z
from twin.world.krylov import Krylov
from twin.world.patches import Patches
from twin.world.region import Setting, carried, local_compliance


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Where each patch touched, or slipped to, and the state that the probe and the body are in.

    Attributes
    ----------
    touched
        (k,) patches in contact.
    closed_mm
        (k,) gap of those at place 0, had they always moved with the probe.
    offset_mm
        (k, 2) tangential displacement of those at place 0, likewise.
    place
        (4,) the probe's place.
    total
        (4,) the force and torque on it.
    displacement_mm, force_n
        (k, 3) displacements of the patches and forces on them, in their frames.
    slid_mm
        (2,) how far the probe slid as a whole, along x and y.
    dissipated_nmm
        Work that friction has taken so far, N mm.
    """

    touched: Bools
    closed_mm: Floats
    offset_mm: Floats
    place: Floats
    total: Floats
    displacement_mm: Floats
    force_n: Floats
    slid_mm: Floats
    dissipated_nmm: float = 0.0


@dataclass(frozen=True, kw_only=True)
class FrictionGrid:
    """Patches, and what of them stays the same along the path."""

    setting: Setting
    patches: Patches
    compliance: Floats
    carried: Floats
    friction: float

    @cached_property
    def krylov(self) -> Krylov:
        """The solver of linear systems on these patches, with what it keeps along the path."""
        return Krylov(self.compliance)

    def _slid_gap(self, slid_mm: Floats, along_z: float) -> tuple[Floats, Floats]:
        """Return gaps and slopes of a probe that was lowered, and slid but not carried the surface along."""
        normals = self.patches.frames[:, 2]
        centre = self.patches.centre_mm
        if isinstance(self.setting.probe, Sphere):
            centre = centre - [slid_mm[0], slid_mm[1], 0.0]
        gap, slope = self.setting.first.gap(centre, normals, np.array([0.0, 0.0, along_z, 0.0]))
        return gap + normals[:, :2] @ slid_mm, slope

    def gap(self, memory: Memory, place: Floats) -> tuple[Floats, Floats]:
        """Return (k,) gaps and (k, 4) slopes at a place."""
        gap, slope = self._slid_gap(memory.slid_mm, float(place[Z]))
        normal = self.carried[:, 2]
        sideways = [X, Y, TURN]
        slope[:, sideways] = -normal[:, sideways]
        gap = gap - normal[:, sideways] @ place[sideways]
        stuck = memory.touched
        gap[stuck] = memory.closed_mm[stuck] + self.moved_gap(memory.slid_mm)[stuck] - normal[stuck] @ place
        slope[stuck] = -normal[stuck]
        return gap, slope

    def moved_gap(self, slid_mm: Floats) -> Floats:
        """Return (k,) by how much a slide changes the gaps; inf where the probe slid away."""
        if not slid_mm.any():
            return np.zeros(len(self.patches))
        before = self._slid_gap(np.zeros(2), 0.0)[0]
        after = self._slid_gap(slid_mm, 0.0)[0]
        return np.where(np.isfinite(before), after - np.where(np.isfinite(before), before, 0.0), 0.0)


def friction_grid(setting: Setting, patches: Patches, friction: float) -> FrictionGrid:
    """Prepare patches for a path."""
    return FrictionGrid(
        setting=setting, patches=patches, compliance=local_compliance(setting, patches),
        carried=carried(setting, patches, np.zeros(2)), friction=friction,
    )  # fmt: skip


def at_first_touch(grid: FrictionGrid) -> Memory:
    """Return the memory of a probe that just touches: patches under a flat face on a flat body stick at once."""
    k = len(grid.patches)
    nothing = Memory(
        touched=np.zeros(k, bool), closed_mm=np.zeros(k), offset_mm=np.zeros((k, 2)), place=np.zeros(4),
        total=np.zeros(4), displacement_mm=np.zeros((k, 3)), force_n=np.zeros((k, 3)), slid_mm=np.zeros(2),
    )  # fmt: skip
    gap, _ = grid.gap(nothing, nothing.place)
    return replace(nothing, touched=gap <= 1e-9, closed_mm=np.where(gap <= 1e-9, gap, 0.0))


def let_go(memory: Memory, place: Floats) -> Memory:
    """Return the memory of a probe that has been lifted off: it touches anew over the place where it then is."""
    return replace(
        memory, touched=np.zeros_like(memory.touched), place=place, total=np.zeros(4),
        displacement_mm=np.zeros_like(memory.displacement_mm), force_n=np.zeros_like(memory.force_n),
        slid_mm=place[:2].copy(),
    )  # fmt: skip
