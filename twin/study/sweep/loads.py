"""What pushes on every design of a sweep, and the compliances: the same places for all designs.

Only markers, camera, noise and inverse differ between most designs. So the compliance of a body is
made once for Young's modulus 1 MPa (it only scales) by body, Poisson's ratio, role and patches, and
a design costs products.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import InputError, RecipeError
from twin.parts.body import Block, Body
from twin.parts.load import Rectangles
from twin.parts.material import Material
from twin.parts.part import Purpose
from twin.parts.press import Press
from twin.parts.scene import Scene
from twin.parts.sweep import Sweep

if TYPE_CHECKING:
    from twin.world.elasticity.block_table import Table
    from twin.world.elasticity.compliance import Compliance
    from twin.world.mesh.sizing import Level

PAIRS = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 4.0)
"""Distances of two pushes over the sweep's ``pair_mm``."""

REGION = 0.6
"""Half sides of the presses' region over those of the sites."""

MANY_BODIES = 12
"""Thicknesses of a block from which on they are interpolated."""


@dataclass(frozen=True, kw_only=True)
class Pushes:
    """The patches of a sweep on one body, and the loads that they make up.

    Attributes
    ----------
    patches
        k squares: the middle first, then the presses, then the pairs.
    loads
        (loads, k, 3) force of every patch, N: the middle alone, each press, each pair.
    presses, pair_mm
        Number of presses, and distances of the pairs; none with a probe.
    probe
        Whether the scene's probe presses in place of the patches.
    """

    patches: Rectangles
    loads: Floats
    presses: int
    pair_mm: Floats
    probe: bool

    def chosen(self, pair_mm: float) -> list[int]:
        """Return the loads of the full chain: the middle, the presses, and the pair nearest to a
        distance."""
        pair = [1 + self.presses + self.nearest(pair_mm)] if len(self.pair_mm) else []
        return [*range(1 + self.presses), *pair]

    def nearest(self, pair_mm: float) -> int:
        """Return the number of the pair whose distance is nearest to one."""
        return int(np.argmin(np.abs(self.pair_mm - pair_mm)))

    def rectangles(self, load: int) -> Rectangles:
        """Return the patches that push under a load."""
        force = self.loads[load]
        used = np.any(force != 0, axis=1)
        return replace(self.patches[used], force_n=force[used])

    def press(self, load: int, own: Press) -> Press:
        """Return the press of a scene's probe by the force of a load, in place of its patch."""
        place = int(np.argmax(np.any(self.loads[load] != 0, axis=1)))
        return Press(
            probe=own.probe,
            friction=own.friction,
            albedo=own.albedo,
            at_mm=tuple(self.patches.centre_mm[place]),
            direction=tuple(self.patches.frames[place, 2]),
            force_n=tuple(self.loads[load, place]),
        )

    @staticmethod
    def region_of(sweep: Sweep, scene: Scene) -> tuple[float, float]:
        """Return the half sides of the presses' region, mm; `InputError` where nothing gives it."""
        if sweep.loads.region_mm is not None:
            return sweep.loads.region_mm
        if scene.reconstruction is None:
            raise InputError(
                "loads.region_mm: the scene has no [reconstruction] sites to take it from; give it"
            )
        s, t = scene.reconstruction.sites.half_mm
        return REGION * s, REGION * t

    @classmethod
    def on_design(cls, sweep: Sweep, scene: Scene, design: Scene) -> Pushes:
        """Return the pushes on a design's body, in the region that the sweep's scene has."""
        return cls.of(design.body, sweep.loads, cls.region_of(sweep, scene), sweep.seed)

    @classmethod
    def of(cls, body: Body, loads: Sweep.Loads, half_mm: tuple[float, float], seed: int) -> Pushes:
        """Return the pushes on a body, at quasi-random places of a region with half sides
        ``half_mm``; `RecipeError` where a patch would lie outside the sensing surface."""
        from scipy.stats import qmc

        # Places: the middle, random presses by a scrambled Halton sequence, and pairs around the
        # middle.
        stream = Purpose.SAMPLING.stream(seed, 1)
        u = qmc.Halton(3, scramble=True, rng=stream).random(loads.presses)
        pair = np.array(() if loads.probe else PAIRS) * loads.pair_mm
        ends = np.column_stack(
            [np.repeat(pair, 2) / 2 * np.tile([-1.0, 1.0], len(pair)), np.zeros(2 * len(pair))]
        )
        chart = np.concatenate([np.zeros((1, 2)), (2 * u[:, :2] - 1) * half_mm, ends])
        points = body.chart_points(chart)
        fits = _fits(body, points, loads.size_mm / 2)
        if not fits[: 1 + loads.presses].all():
            raise RecipeError(
                f"loads.region_mm = {half_mm[0]:.3g}, {half_mm[1]:.3g} mm: some presses of "
                f"loads.size_mm = {loads.size_mm:g} mm hang over the end of the sensing surface; "
                "make region or size smaller"
            )
        # Leave out pairs that hang over the end of the sensing surface.
        pairs = fits[1 + loads.presses :].reshape(-1, 2).all(axis=1)
        keep = np.concatenate([np.ones(1 + loads.presses, bool), np.repeat(pairs, 2)])
        points, pair = points[keep], pair[pairs]
        patches = Rectangles.at(body, points, loads.size_mm / 2)
        frames = patches.frames
        # Loads: the middle along the normal, the presses with a side force in a random direction,
        # and both presses of each pair at once.
        forces = np.zeros((1 + loads.presses + len(pair), len(points), 3))
        forces[0, 0] = frames[0, 2]
        for press, turn in enumerate(2 * np.pi * u[:, 2], start=1):
            sideways = np.array([np.cos(turn), np.sin(turn)]) @ frames[press, :2]
            forces[press, press] = frames[press, 2] + loads.shear * sideways
        for number in range(len(pair)):
            first = 1 + loads.presses + 2 * number
            forces[1 + loads.presses + number, first : first + 2] = frames[first : first + 2, 2]
        return cls(
            patches=patches,
            loads=loads.force_n * forces,
            presses=loads.presses,
            pair_mm=pair,
            probe=loads.probe,
        )


def _fits(body: Body, points: Points, half_mm: float) -> Bools:
    """Return (k,) whether square patches lie on the sensing surface."""
    corners = np.array([(a, b) for a in (-1, 1) for b in (-1, 1)]) * half_mm
    there: Bools = np.asarray(np.isfinite(points).all(axis=1), np.bool_)
    safe = np.where(there[:, None], points, body.chart_points(np.zeros((1, 2))))
    ends = safe[:, None] + corners @ body.frames(safe)[:, :2]
    on_surface = (body.piece_distances(ends.reshape(-1, 3))[:, 1:] > -1e-9).all(axis=1)
    inside = on_surface.reshape(len(points), 4).all(axis=1)
    return np.asarray(there & inside & body.contains(safe, -1e-6))


@dataclass
class Bodies:
    """Compliances, each for one set of patches, so that order changes nothing; how often one was
    needed, and how many were prepared. Between the ends ``thickness_mm`` those of a block are
    interpolated."""

    thickness_mm: tuple[float, float] | None = None
    asked: int = 0
    made: int = 0

    def __post_init__(self) -> None:
        self._kept: dict[str, Compliance] = {}

    @classmethod
    def of(cls, sweep: Sweep) -> Bodies:
        """Return a sweep's bodies: thicknesses of a block are interpolated where there are many.

        Why not always: the tables of a range take as long as some ten bodies, and a body of its
        own is 2e-4 more accurate.
        """
        key = "body.thickness_mm"
        rule = sweep.derived.get(key)
        axis = sweep.axes.get(rule.follows if rule is not None else key)
        if isinstance(axis, Sweep.Range):
            count = axis.steps if sweep.sampling == "grid" else sweep.count
            ends = [axis.low, axis.high]
        elif isinstance(axis, Sweep.Values) and all(
            isinstance(v, int | float) for v in axis.values
        ):
            count = len(set(axis.values))
            ends = [min(axis.values), max(axis.values)]
        else:
            return cls()
        low, high = sorted(
            end * rule.times + rule.plus if rule is not None else end for end in ends
        )
        return cls((low, high) if count > MANY_BODIES and low < high else None)

    @staticmethod
    def refuse(scene: Scene) -> None:
        """Refuse what a sweep does not model: stiff beads, or a cover of its own modulus."""
        if any(layer.stiff for layer in scene.markers.values()):
            raise RecipeError(
                "markers.stiff: sweeps take beads as points that the rubber carries; set "
                "it to false"
            )
        if scene.cover is not None and scene.cover.has_own_material:
            raise RecipeError(
                "cover: sweeps have no cover of its own modulus; leave youngs_modulus_mpa and "
                "poisson_ratio out"
            )

    def unit(self, scene: Scene, role: str, patches: Rectangles) -> Compliance:
        """Return the compliance for E = 1 MPa of a scene's body: ``truth`` or ``nominal``."""
        from twin.world.elasticity.coated import Ladder
        from twin.world.elasticity.compliance import Compliance

        self.refuse(scene)
        nu = scene.material.poisson_ratio
        where = hashlib.sha256(patches.centre_mm.tobytes() + patches.half_mm.tobytes()).hexdigest()
        accuracy = scene.displacement_error if role == "truth" else 0
        facts = [scene.body.geometry(), nu, role, accuracy, where]
        key = json.dumps(facts, sort_keys=True, default=str)
        self.asked += 1
        if key not in self._kept:
            rubber = Material(youngs_modulus_mpa=1.0, poisson_ratio=nu)
            made = (
                Ladder(scene.body, rubber, scene.displacement_error).base
                if role == "truth"
                else Compliance(scene.body, rubber, level="nominal")
            )
            assert isinstance(made, Compliance), "a cover of its own modulus was refused"
            table = self._between(scene.body, made.level)
            if table is not None:
                made = Compliance(scene.body, rubber, level=made.level, table=table)
            self.made += table is None
            while len(self._kept) >= 64:  # a sweep of bodies does not fill the memory
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = made
        return self._kept[key]

    def _between(self, body: Body, level: Level) -> Table | None:
        """Return the interpolated table of a block, where one is as accurate as a level of mesh."""
        from twin.world.elasticity.block_table import MADE, Table

        if self.thickness_mm is None or not isinstance(body, Block):
            return None
        role = next((r for r, made in MADE.items() if made == level and r != "check"), None)
        return Table.between(body, role, *self.thickness_mm) if role is not None else None

    def moved(self, scene: Scene, role: str, points: Points, patches: Rectangles) -> Floats:
        """Return (3 n, 3 k) mm/N of points under unit forces on patches, for the scene's own
        modulus."""
        # Fields serve all designs' points: a design of 96 dots and 551 sites takes 0.15 CPU s so,
        # and 6 if each is read by its own points.
        matrix = self.unit(scene, role, patches).to_points(points, patches, moving=True)
        return matrix / scene.material.youngs_modulus_mpa
