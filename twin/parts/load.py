"""Loads: what pushes on the sensing surface, and footprints of tractions in recipes.

A `Load` is a sum of terms. A term is a `Traction` (an analytic footprint) or `Rectangles` (the
pieces of a contact solution). ``twin.Traction.rectangle(...)`` and its siblings return a `Load`;
loads add with ``+``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from pydantic import model_validator

from twin.arrays import Bools, Chart, Floats, Points, frozen
from twin.display import one_line, vector
from twin.errors import InputError, RecipeError, require
from twin.parts.part import Force, Part, Place, Size

if TYPE_CHECKING:
    from twin.parts.shape import Body

Vector = tuple[float, float, float]

HAIR_MM = 1e-6
"""Depth at which distances from faces are measured, of bodies with dents."""


@dataclass(frozen=True, kw_only=True)
class Rectangles:
    """Plane rectangles on the sensing surface, each under a uniform traction: (k, 3) centres on the
    outer surface, (k, 3, 3) right-handed frames, whose rows are the two side directions and the
    inward normal, (k, 2) half side lengths along the first two, and (k, 3) total forces, global
    axes."""

    centre_mm: Points
    frames: Floats
    half_mm: Floats
    force_n: Floats

    def __post_init__(self) -> None:
        for array in (self.centre_mm, self.frames, self.half_mm, self.force_n):
            frozen(array)

    def __len__(self) -> int:
        return len(self.centre_mm)

    def __str__(self) -> str:
        return f"{len(self)} patches with {vector(self.total_force_n, 'N')}"

    def __getitem__(self, part: slice | Bools) -> Rectangles:
        return Rectangles(**{name: array[part] for name, array in vars(self).items()})

    @staticmethod
    def joined(parts: Sequence[Rectangles]) -> Rectangles:
        """Return all rectangles of ``parts`` in one, in their order."""
        if len(parts) == 1:
            return parts[0]
        none = {"centre_mm": (0, 3), "frames": (0, 3, 3), "half_mm": (0, 2), "force_n": (0, 3)}
        arrays = {
            name: np.concatenate([np.zeros(shape), *(getattr(part, name) for part in parts)])
            for name, shape in none.items()
        }
        return Rectangles(**arrays)

    @property
    def corner_mm(self) -> Floats:
        """(k, 4, 3) corners, mm, one after the other around each rectangle."""
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        across = self.half_mm[:, None, :] * signs
        turned = np.einsum("kca,kai->kci", across, self.frames[:, :2])
        return np.asarray(self.centre_mm[:, None] + turned)

    def within(self, body: Body) -> Points:
        """Return (k, 3) the rectangles' centres, mm, from where a body's faces are as far as they
        are.

        Of a body with dents they are a hair below the surface: on it the plane of a face that lies
        beyond a dent counts as the face (`twin.geometry.pieces`).
        """
        if body.is_convex:
            return self.centre_mm
        return np.asarray(self.centre_mm + HAIR_MM * self.frames[:, 2])

    def reach_towards(self, body: Body) -> Floats:
        """Return (k, pieces) mm: how far each rectangle reaches from its centre towards a body's
        faces."""
        along = np.einsum("kpi,kai->kpa", body.piece_normals(self.within(body)), self.frames[:, :2])
        return np.asarray(np.einsum("kpa,ka->kp", np.abs(along), self.half_mm))

    def cut_at_edges(self, body: Body, shortest: Callable[[Points], Floats]) -> Rectangles:
        """Return the same load with rectangles that reach near a free face, for their size, halved
        until none is longer than twice its distance from that face.

        What a wide load leaves out of balance there comes from its border, not from its middle.

        Parameters
        ----------
        body
            What is loaded; rectangles on a surface with a smooth border stay whole.
        shortest
            Half sides (k,), mm, by places (k, 3): of rectangles there that aren't halved.
        """
        if not body.edge_pieces:
            return self
        done: list[Rectangles] = []
        left = self
        while len(left):
            gap = body.piece_distances(left.within(body)) - left.reach_towards(body)
            least = np.maximum(gap[:, body.edge_pieces].min(axis=1), shortest(left.centre_mm))
            wide = left.half_mm.max(axis=1) > least
            if len(done) == 0 and not wide.any():
                return self
            done.append(left[~wide])
            left = left[wide]
            row, longer = np.arange(len(left)), left.half_mm.argmax(axis=1)
            half = left.half_mm.copy()
            half[row, longer] /= 2.0
            aside = half[row, longer, None] * left.frames[row, longer]
            one, other = (
                replace(
                    left,
                    centre_mm=left.centre_mm + way * aside,
                    half_mm=half,
                    force_n=left.force_n / 2.0,
                )
                for way in (-1.0, 1.0)
            )
            left = Rectangles.joined([one, other])
        return Rectangles.joined(done)

    @property
    def total_force_n(self) -> Floats:
        """(3,) resultant force, N."""
        return np.asarray(self.force_n.sum(axis=0))

    @property
    def total_torque_nmm(self) -> Floats:
        """(3,) resultant torque about the origin, N mm."""
        return np.asarray(np.cross(self.centre_mm, self.force_n).sum(axis=0))

    @staticmethod
    def on_surface(body: Body, chart: Chart, half_mm: float, key: str) -> Rectangles:
        """Return squares of a half side at (k, 2) surface coordinates, under no force;
        `RecipeError`, beginning with ``key``, where one lies outside the sensing surface."""
        points = body.chart_points(chart)
        if not body.contains(points, -1e-6).all():
            raise RecipeError(
                f"{key}: some lie outside the sensing surface; reduce columns, rows or pitch_mm"
            )
        return Rectangles.at(body, points, half_mm)

    @staticmethod
    def at(body: Body, centre_mm: Points, half_mm: float | Floats) -> Rectangles:
        """Return rectangles under no force at (k, 3) places of a body's surface, in its frames
        there; ``half_mm`` is their half side, or (2,) half sides."""
        return Rectangles(
            centre_mm=centre_mm,
            frames=np.array(body.frames(centre_mm)),
            half_mm=np.full((len(centre_mm), 2), half_mm),
            force_n=np.zeros((len(centre_mm), 3)),
        )


@dataclass(frozen=True, kw_only=True)
class Traction:
    """One analytic footprint on the sensing surface.

    Attributes
    ----------
    kind
        ``rectangle`` and ``disk`` are uniform; ``bump`` is max(0, 1 - r^2/a^2)^2 with the straight
        distance r to the centre; ``twist`` is tangential and proportional to r. Directions are
        constant but for the twist.
    centre_mm
        (x, y): the outer surface met from -z; or a 3-D surface point. On curved bodies the
        footprint is cut along the normal at the centre.
    size_mm
        (along s, along t) of a rectangle; (2 a, 2 a) of the others.
    force_n
        Total force, N; exact.
    torque_nmm
        Total torque of a twist about the inward normal at the centre, N mm, positive from x to y;
        exact.

    Raises
    ------
    InputError
        A number is not finite, a size is not positive, or the centre is neither two numbers nor
        three. Whether the footprint lies on the sensing surface is asked when it meets a body.

    Examples
    --------
    >>> import twin
    >>> load = twin.Traction.rectangle(centre_mm=(0, 0), size_mm=(4, 4), force_n=(0, 0, 1))
    >>> load.terms[0].kind
    'rectangle'
    """

    kind: Literal["rectangle", "disk", "bump", "twist"]
    centre_mm: tuple[float, ...]
    size_mm: tuple[float, float]
    force_n: Vector = (0.0, 0.0, 0.0)
    torque_nmm: float = 0.0

    def __post_init__(self) -> None:
        numbers = np.array([*self.centre_mm, *self.size_mm, *self.force_n, self.torque_nmm], float)
        if not np.isfinite(numbers).all():
            raise InputError(f"{self.kind} traction: every number must be finite, got {self!r}")
        if len(self.centre_mm) not in (2, 3):
            raise InputError(
                f"{self.kind} traction: centre_mm must be (x, y) or (x, y, z), got {self.centre_mm}"
            )
        if min(self.size_mm) <= 0:
            raise InputError(
                f"{self.kind} traction: the size must be positive, got {self.size_mm} mm"
            )

    def __str__(self) -> str:
        turns = self.kind == "twist"
        total = f"{self.torque_nmm:g} N mm" if turns else vector(np.array(self.force_n), "N")
        return f"{self.kind} at {vector(np.array(self.centre_mm), 'mm')} with {total}"

    @staticmethod
    def rectangle(
        centre_mm: tuple[float, ...], size_mm: tuple[float, float], force_n: Vector
    ) -> Load:
        """Return a uniform traction on a rectangle (along x, along y) with total ``force_n``."""
        if np.shape(size_mm) != (2,):
            raise InputError(
                "rectangle traction: size_mm must be two numbers (along x, along y), got "
                f"{size_mm!r}"
            )
        return _single("rectangle", centre_mm, (float(size_mm[0]), float(size_mm[1])), force_n)

    @staticmethod
    def disk(centre_mm: tuple[float, ...], radius_mm: float, force_n: Vector) -> Load:
        """Return a uniform traction on a disk of ``radius_mm`` with total ``force_n``."""
        return _single("disk", centre_mm, _across(radius_mm), force_n)

    @staticmethod
    def bump(centre_mm: tuple[float, ...], radius_mm: float, force_n: Vector) -> Load:
        """Return a traction max(0, 1 - r^2/a^2)^2 in the direction of ``force_n``, its total."""
        return _single("bump", centre_mm, _across(radius_mm), force_n)

    @staticmethod
    def twist(centre_mm: tuple[float, ...], radius_mm: float, torque_nmm: float) -> Load:
        """Return a tangential traction proportional to r with total ``torque_nmm``, from x to y."""
        return _single("twist", centre_mm, _across(radius_mm), (0.0, 0.0, 0.0), torque_nmm)


@dataclass(frozen=True, repr=False)
class Load:
    """A sum of tractions on the sensing surface; loads add with ``+`` and ``sum``.

    Attributes
    ----------
    terms
        Footprints given by `Traction`, and the rectangles that a solved press left
        (`ContactState.load`).
    strained
        What linear theory leaves out of the press that they come from; None for a linear one.
    crept
        The elastic load that moves the body as relaxing rubber moves by now, or by linear theory
        where ``strained`` adds to it; None where that is this load itself.
    probes
        The probes that pictures show.

    Notes
    -----
    *Validity*: small strain, where the displacement under a sum is the sum of the displacements.

    Examples
    --------
    >>> import twin
    >>> push = twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1))
    >>> shear = twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0.3, 0, 0))
    >>> len((push + shear).terms)
    2
    """

    class Strained(Protocol):
        """What a press at finite strain moves more than linear theory, inside the body."""

        def displacement(self, points: Points) -> Points:
            """Return what to add to the displacements of points (n, 3), mm."""

        def gradient(self, points: Points) -> Floats:
            """Return what to add to the gradients (n, 3, 3) there."""

    class Placed(Protocol):
        """A probe where it stands, with its diffuse reflectance."""

        @property
        def albedo(self) -> tuple[float, float, float]:
            """Red, green and blue."""

        def met(self, points: Points, along: Floats) -> tuple[Floats, Floats]:
            """Return how far outwards, against unit vectors ``along`` (n, 3), lines through points
            (n, 3) enter the probe, mm, inf where they miss it; and its outward normals there."""

        def between(self, other: Any, share: float) -> Any:
            """Return the same probe on its way to the place of another."""

    terms: tuple[Traction | Rectangles, ...] = ()
    strained: Strained | None = None
    crept: Load | None = None
    probes: tuple[Placed, ...] = ()

    def __repr__(self) -> str:
        return one_line("Load", [str(term) for term in self.terms])

    @property
    def moving(self) -> Load:
        """The load under which elastic rubber moves so."""
        return self if self.crept is None else self.crept

    def __add__(self, other: Load) -> Load:
        if not isinstance(other, Load):
            return NotImplemented
        crept = None
        if self.crept is not None or other.crept is not None:
            crept = self.moving + other.moving
        probes = self.probes + other.probes
        return Load(self.terms + other.terms, crept=crept, probes=probes)

    def __radd__(self, other: object) -> Load:
        """Let ``sum(loads)`` start from its 0."""
        if other != 0:
            return NotImplemented
        return self


def _across(radius_mm: float) -> tuple[float, float]:
    require(radius_mm, Real, "radius_mm", "one number, mm")
    return 2.0 * float(radius_mm), 2.0 * float(radius_mm)


def _single(
    kind: Literal["rectangle", "disk", "bump", "twist"],
    centre_mm: tuple[float, ...],
    size_mm: tuple[float, float],
    force_n: Vector,
    torque_nmm: float = 0.0,
) -> Load:
    try:
        centre = tuple(float(c) for c in centre_mm)
        fx, fy, fz = (float(f) for f in force_n)
        torque = float(torque_nmm)
    except (TypeError, ValueError):
        raise InputError(
            f"{kind} traction: centre_mm must be two or three numbers, force_n three, torque_nmm "
            f"one, got {centre_mm!r}, {force_n!r} and {torque_nmm!r}"
        ) from None
    term = Traction(
        kind=kind, centre_mm=centre, size_mm=size_mm, force_n=(fx, fy, fz), torque_nmm=torque
    )
    return Load((term,))


Spot = tuple[Place, Place] | tuple[Place, Place, Place]


class Footprint(Part):
    """One footprint under a traction of constant form; see `twin.parts.load.Traction`.

    Attributes
    ----------
    kind
        ``rectangle`` and ``disk`` are uniform, ``bump`` falls smoothly to nothing at its rim;
        ``twist`` is tangential and proportional to the distance from its centre.
    centre_mm
        (x, y), the sensing surface met there from -z; or (x, y, z), a place on it.
    size_mm
        Sides of a rectangle along x and y.
    radius_mm
        Of the others.
    force_n
        Total force on the body; not of a twist.
    torque_nmm
        Total torque of a twist about the surface's inward normal, positive from x to y.
    """

    kind: Literal["rectangle", "disk", "bump", "twist"] = "disk"
    centre_mm: Spot = (0.0, 0.0)
    size_mm: tuple[Size, Size] | None = None
    radius_mm: Size | None = None
    force_n: tuple[Force, Force, Force] | None = None
    torque_nmm: Force | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> Footprint:
        flat, turns = self.kind == "rectangle", self.kind == "twist"
        if (self.size_mm is None) == flat or (self.radius_mm is not None) == flat:
            raise ValueError(
                f"a {self.kind} needs "
                f"{'size_mm and no radius_mm' if flat else 'radius_mm and no size_mm'}"
            )
        if (self.force_n is None) != turns or (self.torque_nmm is None) == turns:
            wanted = "torque_nmm and no force_n" if turns else "force_n and no torque_nmm"
            raise ValueError(f"a {self.kind} needs {wanted}")
        return self

    def load(self) -> Load:
        """Return it as a load."""
        if self.size_mm is not None:
            return Traction.rectangle(self.centre_mm, self.size_mm, self.force_n or (0.0, 0.0, 0.0))
        assert self.radius_mm is not None
        if self.kind == "twist":
            return Traction.twist(self.centre_mm, self.radius_mm, self.torque_nmm or 0.0)
        make = Traction.disk if self.kind == "disk" else Traction.bump
        return make(self.centre_mm, self.radius_mm, self.force_n or (0.0, 0.0, 0.0))
