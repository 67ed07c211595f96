"""Rigid probes: what is pressed on a body.

Every shape is given as it stands before it is turned: it comes along its own z, its lowest point
(the middle of a flat face, the tip of a cone, the lowest point of a sphere) is the place from which
its motion and its torque count.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.geometry.closed import PROBE_SIZE_MM
from twin.parts.part import Part, Size
from twin.parts.shape import StlFile


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


def width_mm(probe: Probe) -> float:
    """Return how wide a probe is at most, mm; infinite for a surface of the user's own, whose file
    is not read here."""
    if isinstance(probe, Pillar):
        return max(probe.size_mm)
    if isinstance(probe, Object):
        return probe.width_mm
    return math.inf if isinstance(probe, Stl) else probe.diameter_mm


def _refuse_edge(edge_mm: float, width_mm: float) -> None:
    if edge_mm > width_mm / 2:
        raise ValueError(
            f"edge_mm = {edge_mm:g} mm: allowed is up to half the width, {width_mm / 2:g} mm; take "
            "a smaller one"
        )
