"""A referee for large strain: incompressible neo-Hookean rubber pressed by a rigid probe, on felupe's elements.

felupe supplies the elements (quadratic displacement, linear pressure and volume ratio), the material and its tangent;
here are the probe and Newton's steps. The same elements, linear at rest and touched along the undeformed surface's
normals, are what linear theory makes of the same press, so that only linearity differs.

Why a probe and not the traction that linear theory finds: nothing holds the rubber in the probe's shape under a dead
traction, so the answer is another one (9.7 % off at an eighth of Sato's load), and Newton's steps end before all of the
load is on.

The probe pushes each integration point of the surface by a stiff spring per area and follows the force that is asked
for: its motion along the axes held by force belongs to the unknowns.

Validity: the probe slides freely, or is glued to where it touches from the moment `Contact.stick` is called, so that
it may pull a little at its trailing edge. Springs of 60
times Young's modulus per mm act like a film of rubber 17 um thick on the probe, in both answers alike.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import felupe
import numpy as np

from twin.arrays import Floats, Ints
from twin.parts.body import Body
from twin.world.contact.probe_gap import Approach
from twin.world.elasticity.factor import Factor
from twin.world.mesh.elements import quadrature, shapes
from twin.world.mesh.quadratic_mesh import Mesh

BULK = 1e4
"""Bulk modulus over Young's modulus: the volume changes by less than 1e-4."""

SPRING = 60.0
"""Contact pressure per depth of interpenetration over Young's modulus, 1/mm."""

Z = 2

GOAL, STEPS, HALVINGS = 1e-7, 60, 8


class Rubber:
    """Rubber in the shape of a mesh, E = 1 MPa, held on its last piece; linear (as it is at rest) or neo-Hookean."""

    def __init__(self, mesh: Mesh, linear: bool = False) -> None:
        grid = felupe.Mesh(np.array(mesh.points), np.array(mesh.tets), "tetra10")
        region = felupe.RegionQuadraticTetra(grid, quadrature=felupe.TetrahedronQuadrature(order=5))
        self.mesh = mesh
        self._fields = felupe.FieldsMixed(region, n=3)
        law = felupe.NearlyIncompressible(felupe.NeoHooke(mu=1 / 3), bulk=BULK)
        self._solid = felupe.SolidBody(law, self._fields)
        nodes, corners = len(mesh.points), mesh.corners
        held = np.zeros(nodes, bool)
        held[mesh.faces[mesh.piece == mesh.piece.max()]] = True
        self.free = np.flatnonzero(~np.concatenate([np.repeat(held, 3), np.zeros(2 * corners, bool)]))
        self._node = np.concatenate([np.repeat(np.arange(nodes), 3), np.arange(corners), np.arange(corners)])
        self.rest = np.concatenate([np.zeros(3 * nodes + corners), np.ones(corners)])
        self._still = self._solid.assemble.matrix(self._fields).tocsr() if linear else None
        pressure = slice(3 * nodes, 3 * nodes + corners)
        self._scale = np.zeros(len(self.rest))
        self._scale[pressure] = -3.0 * self.tangent(self.rest)[pressure, 3 * nodes + corners :].diagonal()

    def displacement(self, unknowns: Floats) -> Floats:
        """Return the displacement (N, 3), mm, among the unknowns (displacement, pressure, volume ratio)."""
        return unknowns[: 3 * len(self.mesh.points)].reshape(-1, 3)

    def _put(self, unknowns: Floats) -> None:
        start = 0
        for one in self._fields.fields:
            one.values[:] = unknowns[start : start + one.values.size].reshape(one.values.shape)
            start += one.values.size

    def tangent(self, unknowns: Floats) -> Any:
        """Return the sparse tangent at the unknowns."""
        if self._still is not None:
            return self._still
        self._put(unknowns)
        return self._solid.assemble.matrix(self._fields).tocsr()

    def resistance(self, unknowns: Floats) -> Floats:
        """Return the forces with which the rubber resists the unknowns; NaN where it is turned inside out."""
        if self._still is not None:
            return np.asarray(self._still @ (unknowns - self.rest))
        self._put(unknowns)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # roots of negative volumes: such a step is halved
            return np.asarray(self._solid.assemble.vector(self._fields).toarray().ravel())

    def solve(self, matrix: Any, right: Floats) -> Floats:
        """Return the solution (n, m) of a tangent for ``right`` (n, m), zero where the body is held."""
        out, free = np.zeros_like(right), self.free
        out[free] = Factor(matrix[free][:, free], self._scale[free], node=self._node[free]).solve(right[free])
        return out


@dataclass
class Contact:
    """Springs between a rigid probe, first at ``approach``, and the q integration points of the surface.

    ``nodes`` and ``weights`` are (q, 6), with shape functions. ``linear``: whether the gap is measured, and the push
    acts, along the undeformed normals. ``moved_mm`` is the probe's motion since first touch, ``anchor_mm`` (q, 3) where
    each stuck point sat on the probe, NaN where it slides freely.
    """

    nodes: Ints
    weights: Floats
    area_mm2: Floats
    rest_mm: Floats
    inward: Floats
    approach: Approach
    linear: bool
    moved_mm: Floats
    anchor_mm: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    @staticmethod
    def on(mesh: Mesh, body: Body, approach: Approach, linear: bool) -> Contact:
        """Return the contact of a probe with the points of the sensing surface that lie under it at rest."""
        places, share = quadrature(2)
        values, slopes = shapes(places)
        faces = mesh.faces[mesh.piece == 0]
        corner = mesh.points[faces]
        points = np.einsum("qa,fai->fqi", values, corner)
        along = np.einsum("qaj,fai->fqji", slopes, corner)
        area = np.linalg.norm(np.cross(along[:, :, 0], along[:, :, 1]), axis=2) * share
        near = np.linalg.norm(points[..., :2] - approach.axis_mm[:2], axis=2) <= approach.probe.diameter_mm / 2
        face, point = np.nonzero(near)
        return Contact(
            nodes=faces[face], weights=values[point], area_mm2=area[near], rest_mm=points[near],
            inward=body.piece_normals(points[near])[:, 0], approach=approach, linear=linear, moved_mm=np.zeros(3),
            anchor_mm=np.full((len(face), 3), np.nan),
        )  # fmt: skip

    def _gap(self, shift: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return (q,) gaps, (q, 3) directions of the push, (q, 3) gap per motion of the probe, (q,) curvatures, 1/mm.

        A curvature tells how much the push turns when the point slides along the probe.
        """
        none = np.zeros(len(shift))
        if self.linear:
            down = np.array([0.0, 0.0, self.moved_mm[Z], 0.0, 0.0, 0.0])
            gap, slope = self.approach.gap(self.rest_mm, self.inward, down)
            # A probe that sticks carries the surface sideways, so only how they move past each other counts; on a flat
            # face no place differs from another.
            past = self.inward * ([1.0, 1.0, 0.0] if self.approach.probe.kind == "sphere" else [0.0, 0.0, 0.0])
            gap = gap + np.einsum("qi,qi->q", shift, self.inward) - past @ self.moved_mm
            return gap, self.inward, slope[:, :3] * [0.0, 0.0, 1.0] - past, none
        away = self.rest_mm + shift - self.approach.axis_mm - self.moved_mm
        if self.approach.probe.kind != "sphere":
            normal = np.broadcast_to([0.0, 0.0, 1.0], away.shape)
            return away[:, 2], normal, -normal, none
        away = away + np.array([0.0, 0.0, self.approach.probe.diameter_mm / 2])
        length = np.linalg.norm(away, axis=1)
        normal = away / length[:, None]
        return length - self.approach.probe.diameter_mm / 2, normal, -normal, 1.0 / length

    def shift(self, displacement: Floats) -> Floats:
        """Return (q, 3) displacements of the integration points from those of the nodes (N, 3)."""
        return np.einsum("qa,qai->qi", self.weights, displacement[self.nodes])

    def stick(self, displacement: Floats) -> None:
        """Let the points in contact stick from now on."""
        shift = self.shift(displacement)
        touching = self._gap(shift)[0] < 0
        self.anchor_mm = np.where(touching[:, None], shift - self.moved_mm, np.nan)

    def springs(self, displacement: Floats) -> tuple[Floats, Floats, Floats]:
        """Return pushes (q, 3), N, and minus their slopes by the points' and by the probe's motion (q, 3, 3), N/mm."""
        shift = self.shift(displacement)
        gap, normal, per_motion, curvature = self._gap(shift)
        stuck = np.isfinite(self.anchor_mm[:, 0])
        touching = (gap < 0) | stuck
        gap = np.where(touching, gap, 0.0)
        strength = np.where(touching, SPRING * self.area_mm2, 0.0)
        across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        bend = (strength * gap * curvature)[:, None, None] * across
        push = -(strength * gap)[:, None] * normal
        by_point = strength[:, None, None] * normal[:, :, None] * normal[:, None, :] + bend
        by_probe = strength[:, None, None] * normal[:, :, None] * per_motion[:, None, :] - bend
        held = np.where(stuck, strength, 0.0)
        slid = shift - self.moved_mm - np.nan_to_num(self.anchor_mm)
        push -= held[:, None] * np.einsum("qij,qj->qi", across, slid)
        return push, by_point + held[:, None, None] * across, by_probe - held[:, None, None] * across


def press(rubber: Rubber, contact: Contact, unknowns: Floats, force_n: dict[int, float]) -> Floats:
    """Return the unknowns in equilibrium under a probe held by force along some axes and by motion along the others.

    The unknowns (n,) and the contact's place are the first guess, the place the answer at the end; forces by axis are
    in N for E = 1 MPa. Raises RuntimeError if Newton's steps don't converge.
    """
    axes, wanted = list(force_n), np.array(list(force_n.values()))
    state = _Balance(rubber, contact, unknowns, axes, wanted)
    for _ in range(STEPS):
        if state.error < GOAL:
            return state.unknowns
        state = state.stepped()
    raise RuntimeError(f"Newton's steps stop at an imbalance of {state.error:.1e} of the force")


@dataclass
class _Balance:
    """One state of Newton's steps, with what is out of balance there."""

    rubber: Rubber
    contact: Contact
    unknowns: Floats
    axes: list[int]
    wanted: Floats

    def __post_init__(self) -> None:
        push, self._by_point, self._by_probe = self.contact.springs(self.rubber.displacement(self.unknowns))
        self._right = -self.rubber.resistance(self.unknowns)
        nodal = self.rubber.displacement(self._right)
        np.add.at(nodal, self.contact.nodes, self.contact.weights[:, :, None] * push[:, None, :])
        self._lack = self.wanted - push.sum(axis=0)[self.axes]
        total = float(np.hypot(np.linalg.norm(self._right[self.rubber.free]), np.linalg.norm(self._lack)))
        self.error = total / float(np.linalg.norm(self.wanted)) if np.isfinite(total) else np.inf

    def stepped(self) -> _Balance:
        """Return the state after one Newton step of the body and the probe together."""
        from scipy.sparse import coo_matrix

        w, nodes, n = self.contact.weights, self.contact.nodes, len(self.unknowns)
        row = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), -1)
        block = np.einsum("qa,qb,qij->qaibj", w, w, self._by_point).reshape(len(nodes), row.shape[1], row.shape[1])
        i, j = np.broadcast_arrays(row[:, :, None], row[:, None, :])
        springs = coo_matrix((block.ravel(), (i.ravel(), j.ravel())), shape=(n, n)).tocsr()
        right, gather = np.column_stack([self._right, np.zeros((n, len(self.axes)))]), np.zeros((n, len(self.axes)))
        for k, axis in enumerate(self.axes):
            by_probe, by_point = self._by_probe[:, :, axis], self._by_point[:, axis]
            np.add.at(right[:, 1 + k], row.ravel(), np.einsum("qa,qi->qai", w, by_probe).ravel())
            np.add.at(gather[:, k], row.ravel(), np.einsum("qa,qi->qai", w, by_point).ravel())
        both = self.rubber.solve(self.rubber.tangent(self.unknowns) + springs, right)
        body, follow = both[:, 0], both[:, 1:]  # the step of the body is: body - follow @ moved
        corner = -self._by_probe.sum(axis=0)[np.ix_(self.axes, self.axes)]
        moved = np.linalg.solve(corner + gather.T @ follow, self._lack + gather.T @ body)
        return self._damped(body - follow @ moved, moved)

    def _damped(self, step: Floats, moved: Floats) -> _Balance:
        start, share = self.contact.moved_mm.copy(), 1.0
        for _ in range(HALVINGS):
            self.contact.moved_mm = start.copy()
            self.contact.moved_mm[self.axes] += share * moved
            tried = _Balance(self.rubber, self.contact, self.unknowns + share * step, self.axes, self.wanted)
            if tried.error < max(1.5 * self.error, 0.3):
                break
            share /= 2.0
        return tried
