"""What linear theory leaves out of straight presses on a curved body, of square pillars and of
several probes on a block: as `twin.world.contact.finite_strain.FiniteStrain`, on a mesh of the
whole body.

The displacement under a press is

    linear answer (`twin.world.contact.pressing`)
        + [finite-strain answer - linear contact answer, both on one coarse mesh],

under the same force. The mesh is the body's coarsest one, refined under the probes and at the rims
of flat faces. Its own error is in both answers and mostly cancels. The linear answer's Newton steps
begin at the contact of `pressing`, those of the other one at the linear answer.

A flat face's rim is rounded by a tenth of its half width at least, on which the difference hardly
depends.

Validity: rigid spheres, upright cylinders, pillars and cones, pressed along their ways without
friction on a block, a finger or a dome, several of them by forces; nu from 0.45.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import ContactError, InputError, NotSettled, SolveError
from twin.parts.body import Block, Body, Dome, Finger
from twin.parts.material import Material
from twin.parts.press import Press
from twin.parts.probe import Cone, Cylinder, Pillar, Sphere
from twin.world.contact.contact_state import ContactState, Share
from twin.world.contact.probe_gap import MOTIONS, Approach, Z, approach_of, half_extent
from twin.world.contact.whole_body import (
    Equilibrated,
    Rubber,
    SurfaceTouch,
    pressed_further,
    rows_of,
)
from twin.world.elasticity.mixed_rubber import largest, newton
from twin.world.elasticity.strain_law import LEAST_POISSON
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator, Places

_REACH = 1.6
"""Points so far from the contact's middle, over its radius, may touch."""


@dataclass(frozen=True)
class _Fineness:
    """The longest edge under the probe over the contact's radius, its growth away from there,
    mm/mm, and the longest edge at a flat face's rim."""

    edge: float
    growth: float
    rim: float


_FINE = _Fineness(0.85, 0.8, 0.3)
_COARSE = _Fineness(1.1, 0.9, 0.4)
"""The mesh of the answer, and the one that tells the error."""

LEAST_RIM = 0.1
"""Least radius of a flat face's rim over its half width: a sharper one is solved with this radius,
on which what linear theory leaves out hardly depends (docs/validity.md)."""

_TOLERANCE = 1e-3
_LAST_STEP = 3e-3
"""Newton's steps end at one that moves nothing by more than the second, a share of the largest
displacement; what is left then is below the first."""

_ERROR_OVER_CHANGE = 1.1
_FLAT_OVER_CHANGE = 1.5
"""The error over the change to the coarser mesh, and that under a flat face (docs/validity.md)."""

MOST_STEPS = 12
"""Newton's steps at most."""


@dataclass(frozen=True)
class _Pair:
    """The linear and the finite-strain answer on one mesh."""

    rubber: Rubber
    linear: Equilibrated
    finite: Equilibrated
    wider: Floats

    @cached_property
    def linear_mm(self) -> Points:
        """(N, 3) the linear displacement of the nodes, mm."""
        return self.rubber.displacement(self.linear.unknowns)

    @cached_property
    def change(self) -> Points:
        """(N, 3) what linear theory leaves out at the nodes, mm."""
        return self.rubber.displacement(self.finite.unknowns) - self.linear_mm

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.rubber.mesh)

    def places(self, points: Points) -> Places:
        """Return where points (n, 3) are in the mesh."""
        return self._locator.locate(points)


def _read(places: Places, field: Points) -> Points:
    """Return (n, 3) the values of a field (N, 3) of the nodes."""
    return np.asarray(np.einsum("qa,qai->qi", places.weights, field[places.nodes]))


class BodyStrain:
    """What linear theory leaves out of one state of a press on a whole body.

    Parameters, attributes and errors are those of
    `twin.world.contact.finite_strain.FiniteStrain`. It takes about 2 s under a sphere, 3 to 20 s
    under others; with ``coarse`` the others are refused. With ``like`` the mesh is that of a nearly
    equal press, so that the answers differ by the press alone, and the steps begin at its answers.

    Raises
    ------
    InputError
        The press is not of the kind that is solved at finite strain.
    """

    def __init__(
        self,
        press: Press,
        body: Body,
        material: Material,
        state: ContactState,
        watched: Points,
        *,
        coarse: bool = False,
        like: BodyStrain | None = None,
    ) -> None:
        presses = (press.model_copy(update={"also": ()}), *press.also)
        approaches = [_rounded(approach_of(one, body)) for one in presses]
        self.axes = tuple(approach.axes for approach in approaches)
        problem = _unsolved(press, body, material, state, self.axes)
        if not problem and coarse:
            problem = _too_slow(press, body)
        if problem:
            raise InputError(
                f"material.law = {material.law}: {problem} at finite strain; change it, or set "
                "material.law = linear"
            )
        self._body = body
        self._material = material
        self._state = state
        self._contacts: list[tuple[Approach, Floats, float]] = [
            (approach, _centre(one), one.contact_radius_mm)
            for approach, one in zip(approaches, _probes(state), strict=True)
        ]
        if like is not None:
            self._contacts = like._contacts
        self._watched = watched if len(watched) else self._below_contact()
        self._pair: _Pair = self._solved(
            _COARSE if coarse else _FINE, None if like is None else like._pair
        )
        self.moved = np.zeros((len(presses), MOTIONS))
        self.moved[:, Z] = self._pair.finite.deep - self._pair.linear.deep
        self.wider = self._pair.wider

    @property
    def indentation_mm(self) -> float:
        """How much deeper the first probe sinks than by linear theory, mm."""
        return float(self.moved[0, Z])

    def displacement(self, points: Points) -> Points:
        """Return (n, 3) what to add to the linear displacement of points (n, 3), mm."""
        return _read(self._pair.places(points), self._pair.change)

    def gradient(self, points: Points) -> Floats:
        """Return (n, 3, 3) what to add to the gradients du_i/dx_j."""
        return self._pair.places(points).gradients(self._pair.change)

    @cached_property
    def error(self) -> Share:
        """How far this may be off, over the linear answer: what a coarser mesh changes."""
        other = self._solved(_COARSE)
        moved = _read(other.places(self._watched), other.change)
        there = largest(moved - self.displacement(self._watched)) / largest(self._linear_there)
        deeper = other.finite.deep - other.linear.deep - self.moved[:, Z]
        deep = np.array([one.indentation_mm for one in _probes(self._state)])
        sunk = float(np.max(np.abs(deeper) / deep))
        flat = any(approach.is_flat for approach, _, _ in self._contacts)
        factor = _FLAT_OVER_CHANGE if flat else _ERROR_OVER_CHANGE
        return Share(indentation=factor * sunk + _TOLERANCE, markers=factor * there + _TOLERANCE)

    @cached_property
    def linear_error(self) -> float:
        """How far linear theory is off at the watched points, over the largest displacement."""
        return largest(self.displacement(self._watched)) / largest(self._linear_there)

    @cached_property
    def _linear_there(self) -> Points:
        """The mesh's linear displacement of the watched points: the scale of errors."""
        return _read(self._pair.places(self._watched), self._pair.linear_mm)

    def _below_contact(self) -> Points:
        """Return places below the contact, up to its radius deep."""
        _, centre, size = self._contacts[0]
        inward = self._body.piece_normals(centre[None])[0, 0]
        return np.asarray(centre + size * np.linspace(0.3, 1.0, 8)[:, None] * inward)

    def _solved(self, fineness: _Fineness, like: _Pair | None = None) -> _Pair:
        """Return both answers on a mesh, or on that of other ones, from where the steps begin."""

        # Mesh and contact.
        def wanted(points: Points) -> Floats:
            edges = np.full(len(points), np.inf)
            for approach, centre, size in self._contacts:
                away = np.linalg.norm(points - centre, axis=1) - size
                here = fineness.edge * size + fineness.growth * np.maximum(away, 0.0)
                edges = np.minimum(edges, here)
                if approach.is_flat:
                    at_rim = fineness.rim * size + fineness.growth * _from_rim(points, approach)
                    edges = np.minimum(edges, at_rim)
            return edges

        if like is None:
            mesh = refined(body_mesh(self._body, "sketch"), self._body, wanted, local=True)
            rubber = Rubber(mesh, self._body, self._material)
        else:
            rubber = like.rubber
        probes = _probes(self._state)
        own = [axes @ one.move_mm for axes, one in zip(self.axes, probes, strict=True)]
        touches = [
            SurfaceTouch(rubber.mesh, self._body, approach, place[:Z], centre, _REACH * size)
            for (approach, centre, size), place in zip(self._contacts, own, strict=True)
        ]
        along = [float(axes[Z] @ one.force_n) for axes, one in zip(self.axes, probes, strict=True)]
        force = np.array(along) / self._material.youngs_modulus_mpa

        # The linear answer, and from there the one at finite strain.
        if like is None:
            under = [
                _under_patches(one, touch.rest_mm)
                for one, touch in zip(probes, touches, strict=True)
            ]
            active = np.concatenate(under)
            start = Equilibrated(
                unknowns=np.zeros(rubber.size),
                deep=np.array([place[Z] for place in own]),
                pressure=np.zeros(len(active)),
                active=active,
            )
        else:
            start = like.linear
        linear = self._settled(rubber, touches, start, force, linear=True)
        if like is None:
            lift = np.concatenate([touch.lift for touch in touches])
            start = replace(linear, pressure=linear.pressure * lift)
        else:
            start = like.finite
        finite = self._settled(rubber, touches, start, force, linear=False)
        wider = [
            touch.spread_mm(finite.pressure[rows]) / touch.spread_mm(linear.pressure[rows])
            for touch, rows in zip(touches, rows_of(touches), strict=True)
        ]
        return _Pair(rubber=rubber, linear=linear, finite=finite, wider=np.array(wider))

    def _settled(
        self,
        rubber: Rubber,
        touches: list[SurfaceTouch],
        state: Equilibrated,
        force: Floats,
        *,
        linear: bool,
    ) -> Equilibrated:
        """Take Newton's steps until one moves nothing."""
        problem: Exception | None = None
        still = False
        try:
            state, still = newton(
                lambda one: pressed_further(rubber, touches, one, force, linear=linear),
                lambda one: rubber.displacement(one.unknowns),
                state,
                MOST_STEPS,
                _LAST_STEP,
            )
        except (NotSettled, SolveError) as found:
            problem = found
        if not still:
            raise NotSettled(
                f"contact: at finite strain (material.law = {self._material.law}) Newton's steps "
                f"did not converge in {MOST_STEPS}: press with less force, with a larger probe, or "
                "set material.law = linear"
            ) from problem
        for touch, rows, (_, centre, size) in zip(
            touches, rows_of(touches), self._contacts, strict=True
        ):
            away = np.linalg.norm(touch.rest_mm - centre, axis=1)
            if away[state.pressure[rows] > 0.0].max() > _REACH * size:
                raise ContactError(
                    f"contact: at finite strain it grows beyond {_REACH:g} times its size by "
                    "linear theory: press with less force, or set material.law = linear"
                )
        return state


def _under_patches(state: ContactState, points: Points) -> Bools:
    """Return (n,) whether points of the surface lie under patches in contact."""
    from scipy.spatial import cKDTree

    patches = state.patches
    assert patches is not None
    away, _ = cKDTree(patches.centre_mm).query(points)
    return np.asarray(away < 1.1 * patches.half_mm.max())


def _rounded(approach: Approach) -> Approach:
    """Return a probe at first touch whose face has a rim that is round enough."""
    probe = approach.probe
    if not isinstance(probe, Cylinder | Pillar):
        return approach
    edge = max(probe.edge_mm, LEAST_RIM * min(half_extent(probe)))
    return replace(approach, probe=probe.model_copy(update={"edge_mm": edge}))


def _from_rim(points: Points, approach: Approach) -> Floats:
    """Return (n,) how far points are from the rim of a flat face at first touch, mm."""
    own = np.abs((points - approach.axis_mm) @ approach.axes.T)
    half = np.array(half_extent(approach.probe))
    if isinstance(approach.probe, Cylinder):
        beside = np.hypot(own[:, 0], own[:, 1]) - half[0]
    else:
        beside = np.max(own[:, :Z] - half, axis=1)
        out = np.linalg.norm(np.maximum(own[:, :Z] - half, 0.0), axis=1)
        beside = np.where(beside > 0.0, out, beside)
    return np.asarray(np.hypot(beside, own[:, Z]))


def _probes(state: ContactState) -> tuple[ContactState, ...]:
    return (state, *state.also)


def _centre(state: ContactState) -> Floats:
    patches = state.patches
    assert patches is not None
    return np.asarray(patches.centre_mm.mean(axis=0))


def _too_slow(press: Press, body: Body) -> str:
    """Return why a press isn't solved to tell the error of linear theory alone: it takes more than
    3 s; empty if it is."""
    single = not press.also and isinstance(press.probe, Sphere)
    return "" if single and not isinstance(body, Block) else "such a press takes 3 to 20 s"


def _unsolved(
    press: Press, body: Body, material: Material, state: ContactState, axes: tuple[Floats, ...]
) -> str:
    """Return why a press isn't solved at finite strain, and what is; empty if it is."""
    if not isinstance(body, Block | Finger | Dome):
        return f"body.shape = {body.geometry()['shape']}: blocks, fingers, domes are solved"
    if material.poisson_ratio < LEAST_POISSON:
        return (
            f"material.poisson_ratio = {material.poisson_ratio:g}: {LEAST_POISSON:g} to 0.5 is "
            "solved"
        )
    for one, own, there in zip((press, *press.also), axes, _probes(state), strict=True):
        held = np.array([by_force for by_force, _ in one.in_own_axes(own)])
        if not isinstance(one.probe, Sphere | Cylinder | Pillar | Cone):
            kind = one.probe.kind
            return f"press.probe.kind = {kind}: spheres, cylinders, pillars, cones are solved"
        if one.friction > 0.0:
            return f"press.friction = {one.friction:g}: friction 0 is solved"
        if any(one.tilt_deg) and not isinstance(one.probe, Sphere):
            return "press.tilt_deg: upright probes are solved"
        if np.any(there.turns_deg) or held[:, np.arange(MOTIONS) != Z].any():
            return "press: probes that are guided along their way and don't turn are solved"
        if press.also and not held[:, Z].all():
            return "press.also: several probes are solved where forces press them all"
        if len(there.pressure_mpa) == 0:
            return "press: several probes are solved where all touch"
    return ""
