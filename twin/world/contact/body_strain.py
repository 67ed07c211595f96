"""What linear theory leaves out of a straight press on a curved body: as
`twin.world.contact.finite_strain.FiniteStrain`, on a mesh of the whole body.

The displacement under a press is

    linear answer (`twin.world.contact.pressing`)
        + [finite-strain answer - linear contact answer, both on one coarse mesh],

under the same force. The mesh is the body's coarsest one, refined under the probe. Its own error is
in both answers and mostly cancels. The linear answer's Newton steps begin at the contact of
`pressing`, those of the other one at the linear answer.

Validity: one rigid sphere, pressed along its way without friction on a finger or a dome; nu from
0.45.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Bools, Floats, Points
from twin.errors import ContactError, InputError, NotSettled, SolveError
from twin.parts.body import Body, Dome, Finger
from twin.parts.material import Material
from twin.parts.press import Press
from twin.parts.probe import Sphere
from twin.world.contact.contact_state import ContactState, Share
from twin.world.contact.probe_gap import Z, approach_of
from twin.world.contact.whole_body import Equilibrated, Rubber, SurfaceTouch, pressed_further
from twin.world.elasticity.mixed_rubber import largest, newton
from twin.world.elasticity.strain_law import LEAST_POISSON
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh
from twin.world.mesh.interpolate import Locator, Places

_REACH = 1.6
"""Points so far from the contact's middle, over its radius, may touch."""


@dataclass(frozen=True)
class _Fineness:
    """The longest edge under the probe over the contact's radius, and its growth away from there,
    mm/mm."""

    edge: float
    growth: float


_FINE = _Fineness(0.85, 0.8)
_COARSE = _Fineness(1.1, 0.9)
"""The mesh of the answer, and the one that tells the error."""

_TOLERANCE = 1e-3
_LAST_STEP = 3e-3
"""Newton's steps end at one that moves nothing by more than the second, a share of the largest
displacement; what is left then is below the first."""

_ERROR_OVER_CHANGE = 1.1
"""The error over the change to the coarser mesh (docs/validity.md)."""

MOST_STEPS = 12
"""Newton's steps at most."""


@dataclass(frozen=True)
class _Pair:
    """The linear and the finite-strain answer on one mesh."""

    rubber: Rubber
    linear: Equilibrated
    finite: Equilibrated
    wider: float

    @property
    def deeper_mm(self) -> float:
        return self.finite.deep - self.linear.deep

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
    """What linear theory leaves out of one state of a press on a curved body.

    Parameters, attributes and errors are those of
    `twin.world.contact.finite_strain.FiniteStrain`. It takes about 2 s. With ``like`` the mesh
    is that of a nearly equal press, so that the answers differ by the press alone, and the steps
    begin at its answers.
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
        self._approach = approach_of(press, body)
        if problem := _unsolved(press, body, material, state, self._approach.axes):
            raise InputError(
                f"material.law = {material.law}: {problem} at finite strain; change it, or set "
                "material.law = linear"
            )
        self._body = body
        self._material = material
        self._state = state
        patches = state.patches
        assert patches is not None
        self._centre: Floats = patches.centre_mm.mean(axis=0) if like is None else like._centre
        self._size_mm: float = state.contact_radius_mm if like is None else like._size_mm
        self._watched = watched if len(watched) else self._below_contact()
        self._pair: _Pair = self._solved(
            _COARSE if coarse else _FINE, None if like is None else like._pair
        )
        self.indentation_mm = self._pair.deeper_mm
        self.wider = self._pair.wider

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
        sunk = abs(other.deeper_mm - self.indentation_mm) / self._state.indentation_mm
        return Share(
            indentation=_ERROR_OVER_CHANGE * sunk + _TOLERANCE,
            markers=_ERROR_OVER_CHANGE * there + _TOLERANCE,
        )

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
        deep = self._size_mm * np.linspace(0.3, 1.0, 8)
        inward = self._body.piece_normals(self._centre[None])[0, 0]
        return np.asarray(self._centre + deep[:, None] * inward)

    def _solved(self, fineness: _Fineness, like: _Pair | None = None) -> _Pair:
        """Return both answers on a mesh, or on that of other ones, from where the steps begin."""
        state = self._state
        size = self._size_mm

        # Mesh and contact.
        def wanted(points: Points) -> Floats:
            away = np.linalg.norm(points - self._centre, axis=1) - size
            edges = fineness.edge * size + fineness.growth * np.maximum(away, 0.0)
            return np.asarray(edges)

        if like is None:
            mesh = refined(body_mesh(self._body, "sketch"), self._body, wanted, local=True)
            rubber = Rubber(mesh, self._body, self._material)
        else:
            rubber = like.rubber
        axes = self._approach.axes
        place = axes @ state.move_mm
        reach = _REACH * size
        touch = SurfaceTouch(
            rubber.mesh, self._body, self._approach, place[:Z], self._centre, reach
        )
        force = float(axes[Z] @ state.force_n) / self._material.youngs_modulus_mpa

        # The linear answer, and from there the one at finite strain.
        if like is None:
            none = np.zeros(len(touch.rest_mm))
            start = Equilibrated(
                np.zeros(rubber.size), float(place[Z]), none, self._under_patches(touch.rest_mm)
            )
        else:
            start = like.linear
        linear = self._settled(rubber, touch, start, force, linear=True)
        if like is None:
            start = replace(linear, pressure=linear.pressure * (touch.inward @ axes[Z]))
        else:
            start = like.finite
        finite = self._settled(rubber, touch, start, force, linear=False)
        wider = touch.spread_mm(finite.pressure) / touch.spread_mm(linear.pressure)
        return _Pair(rubber=rubber, linear=linear, finite=finite, wider=wider)

    def _under_patches(self, points: Points) -> Bools:
        """Return (n,) whether points of the surface lie under patches in contact."""
        from scipy.spatial import cKDTree

        patches = self._state.patches
        assert patches is not None
        away, _ = cKDTree(patches.centre_mm).query(points)
        return np.asarray(away < 1.1 * patches.half_mm.max())

    def _settled(
        self,
        rubber: Rubber,
        touch: SurfaceTouch,
        state: Equilibrated,
        force: float,
        *,
        linear: bool,
    ) -> Equilibrated:
        """Take Newton's steps until one moves nothing."""
        problem: Exception | None = None
        still = False
        try:
            state, still = newton(
                lambda one: pressed_further(rubber, touch, one, force, linear=linear),
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
        away = np.linalg.norm(touch.rest_mm - self._centre, axis=1)
        if away[state.pressure > 0.0].max() > _REACH * self._size_mm:
            raise ContactError(
                f"contact: at finite strain it grows beyond {_REACH:g} times its size by linear "
                "theory: press with less force, or set material.law = linear"
            )
        return state


def _unsolved(
    press: Press, body: Body, material: Material, state: ContactState, axes: Floats
) -> str:
    """Return why a press isn't solved at finite strain, and what is; empty if it is."""
    aside = [
        by_force[axis]
        for by_force, _ in press.in_own_axes(axes)
        for axis in range(len(by_force))
        if axis != Z
    ]
    problem = ""
    if press.also:
        problem = "press.also: one probe at a time is solved"
    elif not isinstance(body, Finger | Dome):
        problem = f"body.shape = {body.geometry()['shape']}: blocks, fingers, domes are solved"
    elif not isinstance(press.probe, Sphere):
        problem = f"press.probe.kind = {press.probe.kind}: spheres are solved on curved bodies"
    elif press.friction > 0.0:
        problem = f"press.friction = {press.friction:g}: friction 0 is solved"
    elif np.any(state.turns_deg) or any(aside):
        problem = "press: probes that are guided along their way and don't turn are solved"
    elif material.poisson_ratio < LEAST_POISSON:
        problem = (
            f"material.poisson_ratio = {material.poisson_ratio:g}: {LEAST_POISSON:g} to 0.5 is "
            "solved"
        )
    return problem
