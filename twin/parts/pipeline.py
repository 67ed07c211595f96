"""The sensor's software: calibration, tracking and the inverse problem."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from twin.arrays import Chart, Floats, grid_points
from twin.parts.markers import grid_axes
from twin.parts.methods import CentreMethod, Method, WeightRule
from twin.parts.part import LEAST_MM, Part


class Sites(Part):
    """A grid of places on the sensing surface.

    Attributes
    ----------
    columns, rows, pitch_mm
        Grid along the surface coordinates (s, t), centred.
    """

    columns: int = Field(ge=1, le=64)
    rows: int = Field(ge=1, le=64)
    pitch_mm: float = Field(ge=LEAST_MM, le=50)

    def axes(self) -> tuple[Floats, Floats]:
        """Return the s and the t of the grid, mm."""
        return grid_axes(self.columns, self.rows, self.pitch_mm)

    @property
    def half_mm(self) -> tuple[float, float]:
        """Half extents along s and t, mm."""
        return self.pitch_mm * (self.columns - 1) / 2, self.pitch_mm * (self.rows - 1) / 2

    def chart(self) -> Chart:
        """Return the (columns * rows, 2) surface coordinates, mm, s outer and t inner."""
        return grid_points(*self.axes())


class Tracking(Part):
    """How marker centres are measured.

    Attributes
    ----------
    method
        ``disc-fit``: the marker's picture at rest is fitted, near the Cramer-Rao bound;
        ``soft-window``: centroid in a window with soft edges, on a levelled signal; ``two-pass``:
        the flat paper's mesh centroid of its red-blue difference (sections 2.1 and 4.1), its cell
        as wide as the pitch.
    """

    method: CentreMethod = "disc-fit"


class Calibration(Part):
    """Where the transfer matrix (px/N) comes from.

    Attributes
    ----------
    method
        ``compliance``: the nominal body's compliance seen through the nominal camera;
        ``halfspace``: the papers' half-space formula; ``sato``: measured presses at every site in
        three directions; ``fitted``: the nominal design with stiffness, depths, print, camera and
        footprint fitted to a few presses and the rest picture.
    file
        A calibration file made earlier (``twin calibrate``), relative to the recipe; used only
        while it matches the scene.
    presses
        Where presses are made. If not given, method ``sato`` presses the reconstruction's sites,
        and ``fitted`` their middle and four places halfway to their corners. Under ``sato`` sites
        between the presses are filled by the nominal body's response plus the interpolated
        difference of measurement and nominal response.
    press_force_n
        Force along z of the calibration presses.
    press_probe_mm
        Diameter of the calibration sphere.
    load_cell_n
        Standard deviation of each force component read by the load cell.
    """

    method: Literal["compliance", "halfspace", "sato", "fitted"] = "compliance"
    file: str | None = None
    presses: Sites | None = None
    press_force_n: float = Field(default=0.980665, gt=0, le=100)
    press_probe_mm: float = Field(default=3.0, ge=LEAST_MM, le=100)
    load_cell_n: float = Field(default=0.005, ge=0, le=1)


class Reconstruction(Part):
    """How the inverse problem is solved.

    Attributes
    ----------
    sites
        Where forces are reconstructed.
    method
        ``smooth``: differences of neighbouring forces are kept small (the flat paper's eq. 11 and
        12, corrected); ``norm``: the forces themselves (eq. 14 and 15); ``pinv``: the plain
        pseudo-inverse; ``local``: as ``smooth``, with forces expected only where a first solution
        has some: sharper, better totals, slower.
    weight
        The papers' omega; ``auto`` chooses it by marginal likelihood and robust cross-validation,
        ``likelihood`` and ``gcv`` by one of them.
    push_only
        No site pulls: the force along the inward normal is at least 0 (eq. 13).
    friction
        Coulomb's coefficient that bounds the tangential force at every site; no bound if not given.
    robust
        Leave wrong vectors out.
    camera
        Follow the camera's bend where forces are large (calibration methods compliance and fitted).
    """

    sites: Sites
    method: Method = "smooth"
    weight: Annotated[float, Field(ge=0)] | WeightRule = "auto"
    push_only: bool = False
    friction: float | None = Field(default=None, gt=0, le=100)
    robust: bool = False
    camera: bool = False

    def options(self) -> dict[str, Any]:
        """Return the options of `twin.sense.reconstruct.reconstruct`, by name."""
        return self.model_dump(exclude={"sites", "source", "assumed"})
