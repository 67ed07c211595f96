"""Presses: a rigid probe and the path it takes, held by force or by motion.

Every probe is given as it stands before it is turned: it comes along its own z, its lowest point
(the middle of a flat face, the tip of a cone, the lowest point of a sphere) is the place from which
its motion and its torque count.

Each of the six degrees of freedom, along and about x, y and z, is controlled in every step either
by force (torque) or by motion. A component that is given in ``force_n`` or ``torque_nmm`` is held
by force, one in ``move_mm`` or ``turn_deg`` by motion, and one in neither stays where it is.

Components count along the global axes; with ``axes = "probe"`` along the probe's own, whose z is
its direction of approach (`Press.frame_of`). A probe that comes along a global axis can be
controlled in either; one that comes obliquely and is held by force in some directions and by motion
in others needs its own axes.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from twin.arrays import Floats, frozen
from twin.geometry.closed import PROBE_SIZE_MM
from twin.parts.part import Angle, Force, Part, Place, Share, Size
from twin.parts.shape import StlFile

Component = float | None
Triple = tuple[Component, Component, Component]
Vector = tuple[float, float, float]
Forces = tuple[Force | None, Force | None, Force | None]
Moves = tuple[Place | None, Place | None, Place | None]
Turns = tuple[Angle | None, Angle | None, Angle | None]

BY_AXIS = ("force_n", "move_mm", "torque_nmm", "turn_deg")
"""Keys of a step whose values may be written by axis, such as {z = 1}."""

FEWEST_PATCHES, MOST_PATCHES = 6, 40
"""Contact patches that a contact may have across."""

PATCHES_ACROSS = 16
"""Default number of contact patches across a contact's diameter."""

INCREMENTS = 8
"""Default number of parts of a step with friction: the force of a stuck sphere is then within
0.05 % of that of many parts."""

Tilt = Annotated[float, Field(ge=-60, le=60)]
"""Degrees by which a probe may be tilted against its direction of approach."""

FARTHEST = 1e6
"""How long a direction's vector may be, and its inverse how short."""

LARGEST_FRICTION = 1e6
"""Coulomb's coefficient beyond which a number means nothing that inf doesn't."""


class Sphere(Part):
    """A rigid sphere of ``diameter_mm``.

    Examples
    --------
    >>> import twin
    >>> twin.Sphere(diameter_mm=6)
    Sphere(kind='sphere', diameter_mm=6.0)
    """

    kind: Literal["sphere"] = "sphere"
    diameter_mm: Size


class Cylinder(Part):
    """A rigid flat-ended cylinder, its axis along z.

    Attributes
    ----------
    diameter_mm
        Of the shaft.
    edge_mm
        Radius by which the rim of its face is rounded; 0 is sharp.

    Examples
    --------
    >>> import twin
    >>> twin.Cylinder(diameter_mm=5, edge_mm=0.2).edge_mm
    0.2
    """

    kind: Literal["cylinder"] = "cylinder"
    diameter_mm: Size
    edge_mm: float = Field(default=0.0, ge=0, le=500)

    @model_validator(mode="after")
    def _edge_fits(self) -> Cylinder:
        _refuse_edge(self.edge_mm, self.diameter_mm)
        return self


class Pillar(Part):
    """A rigid flat-ended pillar of ``width_mm`` along x and ``length_mm`` along y (a square one if
    not given).

    ``edge_mm`` is the radius by which the rim of its face, corners included, is rounded; 0 is
    sharp.

    Examples
    --------
    >>> import twin
    >>> twin.Pillar(width_mm=4).size_mm
    (4.0, 4.0)
    """

    kind: Literal["pillar"] = "pillar"
    width_mm: Size
    length_mm: Size | None = None
    edge_mm: float = Field(default=0.0, ge=0, le=500)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Extents along x and y, mm."""
        return self.width_mm, self.length_mm if self.length_mm is not None else self.width_mm

    @model_validator(mode="after")
    def _edge_fits(self) -> Pillar:
        _refuse_edge(self.edge_mm, min(self.size_mm))
        return self


class Cone(Part):
    """A rigid cone, tip first.

    Attributes
    ----------
    apex_deg
        Full angle at the apex.
    diameter_mm
        Of its base; contact must not reach it.
    tip_mm
        Radius by which the tip is rounded; 0 is sharp.

    Examples
    --------
    >>> import twin
    >>> twin.Cone(apex_deg=120, diameter_mm=8).apex_deg
    120.0
    """

    kind: Literal["cone"] = "cone"
    apex_deg: float = Field(ge=20, le=178)
    diameter_mm: Size
    tip_mm: float = Field(default=0.0, ge=0, le=500)

    @model_validator(mode="after")
    def _tip_fits(self) -> Cone:
        most = self.diameter_mm / 2 / math.cos(math.radians(self.apex_deg / 2))
        if self.tip_mm >= most:
            raise ValueError(
                f"tip_mm = {self.tip_mm:g} mm: the rounded tip is as wide as the base (allowed: "
                f"less than {most:.4g} mm); take a smaller one, or a sphere"
            )
        return self


class Stl(StlFile):
    """The inside of a closed STL surface of the user's own.

    Attributes
    ----------
    file
        STL file in mm, relative to the recipe; its z points into the body, its (0, 0) comes where
        ``at_mm`` is, and its highest z touches first on a flat body.
    sha256
        Digest of the file; filled in when it is read, checked when it is given.

    Examples
    --------
    >>> import tempfile
    >>> import trimesh
    >>> import twin
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = f"{folder}/ball.stl"
    ...     _ = trimesh.creation.icosphere(radius=3).export(file)
    ...     twin.Stl(file=file).kind
    'stl'
    """

    largest_mm = PROBE_SIZE_MM

    kind: Literal["stl"] = "stl"


class Object(Part):
    """A rigid everyday object, as an STL file of it would be (`twin.geometry.objects`).

    Attributes
    ----------
    shape
        A letter A, a gear on its face, a coarse screw that lies along x, a toy brick with studs, a
        grating with eight ridges along y, or a ring of round section.
    width_mm
        Extent along x; everything else is in proportion. A grating of 7.5 mm has a pitch of 1 mm.

    Examples
    --------
    >>> import twin
    >>> twin.Object(shape="gear").width_mm
    8.0
    """

    kind: Literal["object"] = "object"
    shape: Literal["letter", "gear", "screw", "brick", "grating", "ring"]
    width_mm: Annotated[float, Field(ge=PROBE_SIZE_MM[0], le=PROBE_SIZE_MM[1])] = 8.0


Probe = Annotated[Sphere | Cylinder | Pillar | Cone | Object | Stl, Field(discriminator="kind")]


def _refuse_edge(edge_mm: float, width_mm: float) -> None:
    if edge_mm > width_mm / 2:
        raise ValueError(
            f"edge_mm = {edge_mm:g} mm: allowed is up to half the width, {width_mm / 2:g} mm; take "
            "a smaller one"
        )


def _triple(value: Any) -> Any:
    if isinstance(value, dict):
        if extra := sorted(set(value) - {"x", "y", "z"}):
            raise ValueError(f"unknown components {', '.join(extra)}: allowed are x, y and z")
        return tuple(value.get(axis) for axis in "xyz")
    return value


class Step(Part):
    """One step of a path; what it gives is the state at its end.

    Attributes
    ----------
    force_n
        Total force of the probe on the body at the end of the step, N: a table ``{z = 1.0}`` or (x,
        y, z) with None for components that are held by motion.
    move_mm
        Motion of the probe during this step, mm, same form.
    torque_nmm
        Total torque about the probe's place, N mm, positive from x to y: one number is about z, or
        a table or three numbers as above.
    turn_deg
        Turn about that place during this step, degrees, same form.
    seconds
        How long the step takes: all that it gives changes linearly in time. 0 is at once, too fast
        for rubber with `Material.relaxation` to relax. A probe that is lifted by a force of 0 is
        lifted at the step's beginning.

    Examples
    --------
    Push with 1 N while the probe is moved 0.1 mm along x:

    >>> import twin
    >>> step = twin.Step(force_n={"z": 1.0}, move_mm={"x": 0.1})
    >>> step.force_n
    (None, None, 1.0)
    """

    force_n: Forces = (None, None, None)
    move_mm: Moves = (None, None, None)
    torque_nmm: Force | Forces | None = None
    turn_deg: Angle | Turns | None = None
    seconds: float = Field(default=0.0, ge=0, le=1e9)

    _tables = field_validator(*BY_AXIS, mode="before")(_triple)

    @model_validator(mode="after")
    def _one_control_each(self) -> Step:
        for axis, force, move in zip("xyz", self.force_n, self.move_mm, strict=True):
            if force is not None and move is not None:
                raise ValueError(
                    f"{axis} is given both as force_n and as move_mm: hold it by one of them"
                )
        for axis, torque, turn in zip("xyz", self.torques_nmm, self.turns_deg, strict=True):
            if torque is not None and turn is not None:
                raise ValueError(
                    f"torque_nmm and turn_deg are both given about {axis}: hold the turn by one of "
                    "them"
                )
        return self

    @property
    def torques_nmm(self) -> Triple:
        """Torques about x, y and z."""
        return _about_z(self.torque_nmm)

    @property
    def turns_deg(self) -> Triple:
        """Turns about x, y and z."""
        return _about_z(self.turn_deg)

    @property
    def by_force(self) -> tuple[bool, ...]:
        """For motion along and turns about x, y and z: whether force or torque holds it."""
        return tuple(value is not None for value in (*self.force_n, *self.torques_nmm))

    @property
    def given(self) -> tuple[float, ...]:
        """The same six: force (torque) where it holds, else motion in mm (turn in radians)."""
        forces = (*self.force_n, *self.torques_nmm)
        moves = [m or 0.0 for m in self.move_mm] + [math.radians(t or 0.0) for t in self.turns_deg]
        return tuple(m if f is None else f for f, m in zip(forces, moves, strict=True))


def _about_z(value: float | Triple | None) -> Triple:
    return value if isinstance(value, tuple) else (None, None, value)


_step = lru_cache(maxsize=64)(
    Step
)  # a press spells its path out when it is made, and whenever it is pressed


class Press(Part):
    """A probe at a place, taken along a path; further probes may be pressed along with it.

    Attributes
    ----------
    probe
        The rigid probe.
    at_mm
        (x, y), the sensing surface met there from -z, or (x, y, z), a place on it: where the
        probe's axis passes.
    direction
        Way of approach: None is +z; any vector in global axes; or ``normal``, the surface's inward
        normal at the place.
    tilt_deg
        Turn of the probe against its direction of approach before it comes: about its own x, then
        y, then z, which stay as its direction of approach makes them (`Press.frame_of`).
    axes
        Axes of the components in the steps: ``global``, or the ``probe``'s own (`Press.frame_of`).
    steps
        The path. ``force_n`` (three numbers) or ``indentation_mm`` (a motion along the direction
        from first touch) are shorthand for a path of one step; without friction a side force of 0
        there means that the probe is guided.
    friction
        Coulomb's coefficient mu, the same at rest and in motion: a patch carries at most mu times
        its normal force sideways, and slips when it would need more. 0 is frictionless, inf sticks
        whatever the force. Values from 1e3 on are solved as inf, whose forces they have.
    albedo
        Diffuse reflectance of the probe, red, green, blue, where the camera sees it through rubber
        without a cover, or through one with ``transmittance``; None: pictures don't show it.
    also
        Further presses at the same time, with probes, places and paths of their own, of as many
        steps as this one, whose seconds are theirs too.

    Examples
    --------
    >>> import twin
    >>> ball = twin.Sphere(diameter_mm=6)
    >>> press = twin.Press(probe=ball, at_mm=(2, 0), force_n=(0, 0, 1.5), friction=0.5)
    >>> press.friction
    0.5
    """

    probe: Probe
    at_mm: tuple[Place, Place] | tuple[Place, Place, Place] = (0.0, 0.0)
    direction: Vector | Literal["normal"] | None = None
    tilt_deg: tuple[Tilt, Tilt, Angle] = (0.0, 0.0, 0.0)
    axes: Literal["global", "probe"] = "global"
    steps: tuple[Step, ...] = ()
    force_n: Forces | None = None
    indentation_mm: Annotated[float, Field(gt=0, le=1e4)] | None = None
    friction: float = Field(default=0.0, allow_inf_nan=True)
    albedo: tuple[Share, Share, Share] | None = None
    also: tuple[Press, ...] = Field(default=(), max_length=7)

    _tables = field_validator("force_n", mode="before")(_triple)

    @field_validator("tilt_deg", mode="before")
    @classmethod
    def _tilt_table(cls, value: Any) -> Any:
        found = _triple(value)
        return tuple(part or 0.0 for part in found) if isinstance(value, dict) else found

    @field_validator("direction")
    @classmethod
    def _points_somewhere(cls, value: Vector | str | None) -> Vector | str | None:
        size = max(map(abs, value)) if isinstance(value, tuple) else 1.0
        if not 1 / FARTHEST <= size <= FARTHEST:
            raise ValueError(
                f"must be three numbers, not all 0 (the largest {1 / FARTHEST:g} to "
                f"{FARTHEST:g}), or 'normal'"
            )
        return value

    @field_validator("friction")
    @classmethod
    def _known_law(cls, value: float) -> float:
        if not (0.0 <= value <= LARGEST_FRICTION or value == math.inf):
            raise ValueError(
                f"allowed are 0 (frictionless) to {LARGEST_FRICTION:g}, or inf (sticking)"
            )
        return value

    @model_validator(mode="after")
    def _one_path(self) -> Press:
        given = [bool(self.steps), self.force_n is not None, self.indentation_mm is not None]
        if sum(given) != 1:
            raise ValueError("give exactly one of steps, force_n and indentation_mm")
        if self.direction != "normal":
            self.in_own_axes(self.frame_of(self.direction or (0.0, 0.0, 1.0)))
        return self

    @model_validator(mode="after")
    def _others_fit(self) -> Press:
        for number, other in enumerate(self.also, start=1):
            if other.also:
                raise ValueError(
                    f"also {number} has further presses itself: list them all in the first one"
                )
            if len(other.path) != len(self.path):
                raise ValueError(
                    f"also {number} has {len(other.path)} steps, the first press {len(self.path)}: "
                    "they are taken at the same time, so give each as many (an empty step holds "
                    "the probe where it is)"
                )
            if any(step.seconds for step in other.path):
                raise ValueError(
                    f"also {number} has seconds: its steps take those of the first press's steps"
                )
        return self

    @property
    def width_mm(self) -> float:
        """How wide the probe is at most, mm; infinite for a user's surface, whose file is not read
        here."""
        probe = self.probe
        if isinstance(probe, Pillar):
            return max(probe.size_mm)
        if isinstance(probe, Object):
            return probe.width_mm
        return math.inf if isinstance(probe, Stl) else probe.diameter_mm

    @staticmethod
    @lru_cache(maxsize=64)
    def frame_of(direction: Vector) -> Floats:
        """Return the (3, 3) axes, as rows, of a probe that comes along a direction: its own z; x is
        the global x, or where that is along z the global y, made perpendicular to z."""
        along = np.array(direction, float) / np.linalg.norm(direction)
        first = np.array([1.0, 0.0, 0.0]) if abs(along[0]) < 0.999 else np.array([0.0, 1.0, 0.0])
        first = first - (first @ along) * along
        first = first / np.linalg.norm(first)
        return frozen(np.stack([first, np.cross(along, first), along]))

    @staticmethod
    def deepest_mm(probe: Probe, thickness_mm: float) -> tuple[float, str]:
        """Return how deep a probe may sink into a body so thick, and what this is."""
        if isinstance(probe, Sphere) and probe.diameter_mm < thickness_mm:
            return probe.diameter_mm / 2, "the probe's radius"
        return thickness_mm / 2, "half the body's thickness"

    @property
    def path(self) -> tuple[Step, ...]:
        """The steps, shorthand spelt out; that of ``indentation_mm`` along the probe's own z."""
        if self.steps:
            return self.steps
        if self.indentation_mm is not None:
            return (_step(move_mm=(None, None, self.indentation_mm)),)
        fx, fy, fz = self.force_n or (None, None, None)
        if self.friction == 0.0:
            # a frictionless probe can't be steered by forces: no side force means guided
            fx, fy = fx or None, fy or None
        return (_step(force_n=(fx, fy, fz)),)

    def in_own_axes(self, frame: Floats) -> tuple[tuple[tuple[bool, ...], tuple[float, ...]], ...]:
        """Return (by_force, given) of every step (see `Step`) along the probe's own axes, the rows
        of ``frame``. ValueError where the first step doesn't push, or oblique axes mix force and
        motion."""
        found = []
        own = frame[0, 0] == frame[2, 2] == 1.0
        for number, step in enumerate(self.path, start=1):
            by_force = step.by_force
            given = tuple(map(float, step.given))
            if self.force_n is not None and self.friction == 0.0 and self.axes == "global":
                force = given[:3] if own else tuple((frame @ given[:3]).tolist())
                least = 1e-12 * math.hypot(*force)  # guided wherever it isn't pushed
                by_force = (*(abs(f) > least for f in force), *by_force[3:])
                given = (*(f if abs(f) > least else 0.0 for f in force), *given[3:])
            elif self.axes == "global" and self.indentation_mm is None and not own:
                by_force, given = _turned(by_force, given, frame, f"step {number}")
            pushed = given[2]
            if number == 1 and not pushed > 0.0:
                push = "a push is +z" if frame[2, 2] == 1.0 else "along the direction of approach"
                if by_force[2]:
                    raise ValueError(
                        f"the first step's force along z must be greater than 0: {push}"
                    )
                raise ValueError(
                    f"the first step must push: force_n.z > 0 or move_mm.z > 0; {push}"
                )
            found.append((by_force, given))
        return tuple(found)


def _turned(
    by_force: tuple[bool, ...], given: tuple[float, ...], frame: Floats, what: str
) -> tuple[tuple[bool, ...], tuple[float, ...]]:
    """Return a step's controls along other axes."""
    forced, values = np.array(by_force), np.array(given)
    for part, words in (
        (slice(0, 3), "force_n and move_mm"),
        (slice(3, 6), "torque_nmm and turn_deg"),
    ):
        held, numbers = np.array(by_force[part]), np.array(given[part])
        for axis, row in enumerate(frame):
            used = np.abs(row) > 1e-12
            if held[used].all() or not held[used].any():
                forced[part][axis] = held[used].all()
                values[part][axis] = row @ numbers
                continue
            force = row @ np.where(held, numbers, 0.0)
            motion = row @ np.where(held, 0.0, numbers)
            raise ValueError(
                f"{what}: the probe comes obliquely, and {words} hold some of x, y and z by "
                f"force and others by motion "
                f"(along its own axis {axis + 1}: {force:g} and {motion:g}); give all three by "
                f"one of them, or set "
                'axes = "probe"'
            )
    return tuple(forced.tolist()), tuple(values.tolist())
