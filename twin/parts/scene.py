"""A scene: everything that is needed to take a press through the whole twin, and nothing else.

The descriptions of sensor and press have modules of their own. Here are what is asked of the
computation (`Accuracy`, `Tolerance`, `Dataset`), the sensor's software (`Tracking`, `Calibration`,
`Reconstruction`), and `Scene` itself.

``auto`` accuracy selects for every stage what the scene needs. The tolerance of Young's modulus
limits how well a force can be known. The error of displacements is set to a third of it, which adds
a tenth to the force's error. Markers at a depth d don't see tractions that vary over less than d,
which decay like exp(-2 pi d / length), so patches need not be narrower. Measured: ``python -m
benchmarks budget`` (docs/budget.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from twin.arrays import Chart, Floats, grid_points
from twin.display import html_table, one_line
from twin.parts.body import AnyBody, Block
from twin.parts.camera import Camera, Ccd, Light
from twin.parts.load import Footprint, Load
from twin.parts.markers import MarkerLayer
from twin.parts.material import Cover, Material
from twin.parts.methods import CentreMethod, Method, WeightRule
from twin.parts.part import LEAST_MM, Flag, Part
from twin.parts.press import FEWEST_PATCHES, INCREMENTS, MOST_PATCHES, PATCHES_ACROSS, Press
from twin.parts.vary import CUT, Distribution, flat

SHARE = 1 / 3
"""Error of displacements over the tolerance of Young's modulus, with ``auto``."""

PER_DEPTH = 1.2
"""Patches on the least depth of a marker, with ``auto``."""

FEWEST, LOOSEST, TIGHTEST = 8, 1e-2, 1e-3


Across = Annotated[int, Field(ge=FEWEST_PATCHES, le=MOST_PATCHES)]
Percent = Annotated[float, Field(ge=0, le=30)]
"""Of a number that is positive, and stays so: the largest, `CUT` times, leaves a quarter of it."""


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
        s, t = (
            self.pitch_mm * (np.arange(count, dtype=np.float64) - (count - 1) / 2)
            for count in (self.columns, self.rows)
        )
        return s, t

    @property
    def half_mm(self) -> tuple[float, float]:
        """Half extents along s and t, mm."""
        return self.pitch_mm * (self.columns - 1) / 2, self.pitch_mm * (self.rows - 1) / 2

    def chart(self) -> Chart:
        """Return the (columns * rows, 2) surface coordinates, mm, s outer and t inner."""
        return grid_points(*self.axes())


class Scene(Part):
    """A resolved scene: sensor, surroundings, press and what is asked of the computation.

    Attributes
    ----------
    title
        One line for people.
    seed
        Root of every random stream.
    body, material, cover, markers, light, ccd, accuracy, tolerance, tracking, calibration, dataset
        See the part of that name.
    camera
        Without one nothing is rendered.
    renderer
        What makes the picture: ``mitsuba`` (its ray tracing, light by our own sum over the LEDs),
        ``splat`` (closed form, without Mitsuba), ``path`` (Mitsuba's path integrator, with light
        between markers, cover and window: seconds a picture, and noise), or ``auto``: Mitsuba where
        it works, the splat where ``accuracy.centroid_px`` is a number. A recipe may write it as
        ``picture.renderer``.
    press
        Without one the sensor is only at rest.
    reconstruction
        Without one no forces are estimated.
    tractions
        Footprints whose tractions push instead of the press, which is then not computed.
    vary
        Distributions by dotted key of the scene: what differs between the samples of a dataset. A
        single run uses the scene's own values.

    Examples
    --------
    >>> import twin
    >>> scene = twin.load_scene("block_bare")
    >>> scene
    Scene(body block 100 x 90 x 40 mm, material E 0.5 MPa, nu 0.5)
    >>> scene.material.youngs_modulus_mpa
    0.5
    """

    class Accuracy(Part):
        """Error targets.

        Attributes
        ----------
        displacement
            Largest error of a marker's displacement over the largest displacement, or ``auto``.
        centroid_px
            Largest error of a marker's place in the noise-free picture, px; ``auto`` balances it
            against the noise.
        paths
            Paths a pixel of ``renderer = "path"``.
        contact_patches
            Contact patches across the contact's diameter, or ``auto``.
        contact_increments
            With friction: parts of a step in which patches touch or slip, at most.
        surface_table
            Whether a curved body's displacements are interpolated between patches solved all over
            its sensing surface, for many loads: a minute or two once, milliseconds a load
            afterwards, and a thousandth more of error, which the estimate includes.
        """

        displacement: Annotated[float, Field(ge=1e-5, le=0.2)] | Literal["auto"] = 5e-3
        centroid_px: Annotated[float, Field(ge=1e-4, le=1)] | Literal["auto"] = "auto"
        paths: Annotated[int, Field(ge=1, le=100_000)] = 64
        contact_patches: Across | Literal["auto"] = PATCHES_ACROSS
        contact_increments: Annotated[int, Field(ge=1, le=64)] = INCREMENTS
        surface_table: Flag = False

        def displacement_for(self, modulus_pct: float) -> float:
            """Return the largest error of displacements where Young's modulus is known to so many
            percent."""
            if not isinstance(self.displacement, str):
                return self.displacement
            return min(max(SHARE * modulus_pct / 100, TIGHTEST), LOOSEST)

        def patches_for(self, widths_mm: Sequence[float], depths_mm: Sequence[float]) -> int:
            """Return the contact patches across probes of some widths, over markers at depths,
            mm."""
            if not isinstance(self.contact_patches, str):
                return self.contact_patches
            if not widths_mm or not depths_mm:
                return PATCHES_ACROSS
            return math.ceil(
                min(max(PER_DEPTH * max(widths_mm) / min(depths_mm), FEWEST), PATCHES_ACROSS)
            )

    class Tolerance(Part):
        """Standard deviations (normal, cut at 2.5) of what a maker does not control.

        Attributes
        ----------
        preset
            ``standard`` uses the numbers below; ``none`` makes the sensor exactly as drawn (for
            tests).
        youngs_modulus_pct
            Of Young's modulus, percent.
        poisson_ratio
            Of the shortfall of Poisson's ratio below the nominal value (never above 0.5).
        thickness_mm
            Of a block's thickness; the camera moves with its base.
        depth_mm
            Of each marker layer's depth.
        print_mm
            Of each marker's place along the surface.
        print_diameter_pct, print_shade_pct
            Of each marker's diameter and of its reflectance, percent.
        print_oval_pct
            Of how much longer a marker is one way along the surface, and shorter across, percent.
        print_colour_pct
            Of a marker's reflectance in each of red, green and blue by itself, percent.
        missing
            Share of markers that the maker lost (not a standard deviation).
        pupil_mm
            Of each coordinate of the entrance pupil.
        tilt_deg
            Of each of the camera's small rotations.
        focal_pct
            Of the focal length, percent.
        distortion
            Of the lens's first radial coefficient.
        """

        preset: Literal["standard", "none"] = "standard"
        youngs_modulus_pct: Percent = 1.5
        poisson_ratio: float = Field(default=0.001, ge=0, le=0.2)
        thickness_mm: float = Field(default=0.0, ge=0, le=5)
        depth_mm: float = Field(default=0.03, ge=0, le=5)
        print_mm: float = Field(default=0.03, ge=0, le=2)
        print_diameter_pct: Percent = 0.0
        print_shade_pct: Percent = 0.0
        print_oval_pct: Percent = 0.0
        print_colour_pct: Percent = 0.0
        missing: float = Field(default=0.0, ge=0, le=1)
        pupil_mm: float = Field(default=0.1, ge=0, le=10)
        tilt_deg: float = Field(default=0.1, ge=0, le=10)
        focal_pct: float = Field(default=0.3, ge=0, le=10)
        distortion: float = Field(default=0.0, ge=0, le=0.2)

        def most_of_thickness_mm(self, body_mm: float, deepest_mm: float) -> float:
            """Return the largest ``thickness_mm`` with which a block of ``body_mm`` stays 1 mm
            thick and holds markers drawn ``deepest_mm`` deep."""
            least = max(1.0, deepest_mm + CUT * self.depth_mm)
            return max(body_mm - least, 0.0) / CUT

    class Tracking(Part):
        """How marker centres are measured.

        Attributes
        ----------
        method
            ``disc-fit``: the marker's picture at rest is fitted, near the Cramer-Rao bound;
            ``soft-window``: centroid in a window with soft edges, on a levelled signal;
            ``two-pass``: the flat paper's mesh centroid of its red-blue difference (sections 2.1
            and 4.1), its cell as wide as the pitch.
        """

        method: CentreMethod = "disc-fit"

    class Calibration(Part):
        """Where the transfer matrix (px/N) comes from.

        Attributes
        ----------
        method
            ``compliance``: the nominal body's compliance seen through the nominal camera;
            ``halfspace``: the papers' half-space formula; ``sato``: measured presses at every site
            in three directions; ``fitted``: the nominal design with stiffness, depths, print,
            camera and footprint fitted to a few presses and the rest picture.
        file
            A calibration file made earlier (``twin calibrate``), relative to the recipe; used only
            while it matches the scene.
        presses
            Where presses are made. If not given, method ``sato`` presses the reconstruction's
            sites, and ``fitted`` their middle and four places halfway to their corners. Under
            ``sato`` sites between the presses are filled by the nominal body's response plus the
            interpolated difference of measurement and nominal response.
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
            ``smooth``: differences of neighbouring forces are kept small (the flat paper's eq. 11
            and 12, corrected); ``norm``: the forces themselves (eq. 14 and 15); ``pinv``: the plain
            pseudo-inverse; ``local``: as ``smooth``, with forces expected only where a first
            solution has some: sharper, better totals, slower.
        weight
            The papers' omega; ``auto`` chooses it by marginal likelihood and robust
            cross-validation, ``likelihood`` and ``gcv`` by one of them.
        push_only
            No site pulls: the force along the inward normal is at least 0 (eq. 13).
        friction
            Coulomb's coefficient that bounds the tangential force at every site; no bound if not
            given.
        robust
            Leave wrong vectors out.
        camera
            Follow the camera's bend where forces are large (calibration methods compliance and
            fitted).
        frames_per_second
            Rate of pictures that follow each other: forces are found of rubber that relaxes, as
            `material.relaxation` states. Without it every picture is read by itself, as of rubber
            that has relaxed by an unknown part.
        """

        sites: Sites
        method: Method = "smooth"
        weight: Annotated[float, Field(ge=0)] | WeightRule = "auto"
        push_only: Flag = False
        friction: float | None = Field(default=None, gt=0, le=100)
        robust: Flag = False
        camera: Flag = False
        frames_per_second: float | None = Field(default=None, gt=0, le=1e6)

        def options(self) -> dict[str, Any]:
            """Return the options of `twin.sense.reconstruct.reconstruct`, by name."""
            return self.model_dump(exclude={"sites", "frames_per_second", "source", "assumed"})

    class Dataset(Part):
        """How ``twin dataset`` draws and stores samples of a scene.

        Attributes
        ----------
        sampling
            ``stratified``: a scrambled Sobol' sequence, which fills the space of what varies more
            evenly; ``random``: independent draws. Either way a sample is known from the scene's
            seed and its number alone.
        samples_per_sensor
            After how many samples the next sensor is made: keys in ``[vary]`` that do not begin
            with ``press.``, and the tolerances, are drawn once for each sensor. Every sensor has
            one rest picture.
        samples_per_shard
            Samples in one file; what is lost at most when a worker is killed.
        every_step
            Keep the state after every step of a press's path, not just the last.
        sites
            Grid over the surface into whose cells tractions are summed; every contact must lie
            inside it.
        columns
            Which columns are kept (all if empty); what none of them needs is not computed.
        """

        sampling: Literal["stratified", "random"] = "stratified"
        samples_per_sensor: int = Field(default=1000, ge=1, le=10**9)
        samples_per_shard: int = Field(default=64, ge=1, le=100_000)
        every_step: Flag = False
        sites: Sites | None = None
        columns: tuple[str, ...] = ()

    title: str = ""
    seed: int = Field(default=1, ge=0, le=2**63 - 1)
    body: AnyBody
    material: Material
    cover: Cover | None = None
    markers: dict[str, MarkerLayer] = Field(default_factory=dict)
    camera: Camera | None = None
    renderer: Literal["auto", "splat", "mitsuba", "path"] = "auto"
    light: Light | None = None
    ccd: Ccd = Ccd()
    press: Press | None = None
    tractions: tuple[Footprint, ...] = Field(default=(), max_length=64)
    accuracy: Accuracy = Accuracy()
    tolerance: Tolerance = Tolerance()
    tracking: Tracking = Tracking()
    calibration: Calibration = Calibration()
    reconstruction: Reconstruction | None = None
    dataset: Dataset = Dataset()
    vary: dict[str, Distribution] = Field(default_factory=dict)

    @field_validator("vary", mode="before")
    @classmethod
    def _by_dotted_key(cls, value: Any) -> Any:
        return flat(value) if value and isinstance(value, dict) else value

    def __repr__(self) -> str:
        return one_line("Scene", [f"{k} {v}" for k, v in self._rows().items() if v])

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return html_table(self.title or "Scene", self._rows())

    def _rows(self) -> dict[str, str]:
        """Return what a reader wants to know first, by name."""
        low, high = self.body.bounds_mm
        size = " x ".join(f"{b - a:g}" for a, b in zip(low, high, strict=True))
        material, camera, press = self.material, self.camera, self.press
        layers = [
            f"{layer.columns * layer.rows} {name} {layer.depth_mm:g} mm deep"
            for name, layer in self.markers.items()
        ]
        return {
            "body": f"{self.body.shape} {size} mm",
            "material": f"E {material.youngs_modulus_mpa:g} MPa, nu {material.poisson_ratio:g}",
            "markers": ", ".join(layers),
            "camera": f"{camera.width_px} x {camera.height_px} px" if camera is not None else "",
            "press": press.probe.kind if press is not None else "",
        }

    def to_toml(self) -> str:
        """Return the scene as TOML; reading it back gives the same scene."""
        import tomli_w

        return tomli_w.dumps(_plain(self.model_dump(mode="python", exclude_none=True)))

    @property
    def window_middle_mm(self) -> float:
        """Height of the middle of the layers between body and camera, mm."""
        camera, _, base = self.optics
        return base + camera.window_mm / 2

    @property
    def imaging(self) -> tuple[Camera, Light]:
        """Camera and light of a scene that has pictures."""
        assert self.camera is not None
        assert self.light is not None
        return self.camera, self.light

    @property
    def inverse(self) -> Reconstruction:
        """How the inverse problem is solved, of a scene whose forces are reconstructed."""
        assert self.reconstruction is not None
        return self.reconstruction

    @property
    def optics(self) -> tuple[Camera, float, float]:
        """Camera, refractive index and height of the base, mm, as `twin.theory.optics` takes
        them."""
        return self.imaging[0], self.material.refractive_index, self.body.base_z_mm

    def thicker(self, by_mm: float) -> Scene:
        """Return the scene with a block so much thicker; its camera is held by the higher base."""
        if not by_mm:
            return self
        body, camera = self.body, self.camera
        body = body.model_copy(update={"thickness_mm": body.base_z_mm + by_mm})
        if camera is not None:
            x, y, z = camera.pupil_mm
            moved = {"pupil_mm": (x, y, z + by_mm), "focus_z_mm": camera.focus_z_mm + by_mm}
            camera = camera.model_copy(update=moved)
        return self.model_copy(update={"body": body, "camera": camera})

    @property
    def scale_error(self) -> float:
        """Standard deviation of a factor on all forces read by the design, over 1: by the modulus
        and the focal length."""
        room = self.tolerance
        if room.preset == "none":
            return 0.0
        return math.hypot(room.youngs_modulus_pct, room.focal_pct) / 100

    @property
    def load(self) -> Load:
        """What the tractions push with."""
        return sum((each.load() for each in self.tractions), Load())

    @property
    def presses(self) -> tuple[Press, ...]:
        """The press and those of further probes; none without a press."""
        return () if self.press is None else (self.press, *self.press.also)

    @property
    def displacement_error(self) -> float:
        """Largest requested error of a marker's displacement over the largest displacement."""
        made = self.tolerance.preset != "none"
        return self.accuracy.displacement_for(self.tolerance.youngs_modulus_pct if made else 0.0)

    @property
    def contact_patches(self) -> int:
        """Contact patches across the contact's diameter that the scene requests."""
        widths = [each.width_mm for each in self.presses]
        return self.accuracy.patches_for(
            widths, [layer.depth_mm for layer in self.markers.values()]
        )

    @model_validator(mode="after")
    def _fits_together(self) -> Scene:
        if self.camera is not None:
            self._can_be_seen(self.camera)
        self._is_hidden_by_cover()
        self._can_be_made_thinner()
        shortfall = CUT * self.tolerance.poisson_ratio if self.tolerance.preset != "none" else 0.0
        if problems := MarkerLayer.stiff_problems(
            self.body, self.markers, self.material, self.cover, shortfall
        ):
            raise ValueError("; ".join(problems))
        if self.reconstruction is not None:
            self._can_be_reconstructed(self.reconstruction)
        return self

    def _can_be_seen(self, camera: Camera) -> None:
        """Refuse a camera within the body or its window, or one that has nothing to see."""
        front = self.body.base_z_mm + camera.window_mm
        if camera.pupil_mm[2] < front:
            raise ValueError(
                f"camera.pupil_mm: z = {camera.pupil_mm[2]} mm must lie behind the base "
                f"and the layers (z >= {front} mm)"
            )
        if not self.body.has_window:
            raise ValueError(
                f"camera: it looks through a held face at z = {self.body.base_z_mm:.6g} mm, "
                "the body's largest z, but no triangle of body.held lies there: turn the body "
                "so that its held face is at large z, or leave [camera] out"
            )
        if self.light is None:
            raise ValueError(
                "light: a scene with a camera needs a [light] table, or the picture is black"
            )
        if not self.markers:
            raise ValueError(
                "markers: a scene with a camera needs at least one [markers.<layer>] table"
            )

    def _is_hidden_by_cover(self) -> None:
        """Refuse what lies behind a cover that lets no light through."""
        if self.cover is None or self.cover.transmittance > 0:
            return
        behind = {
            "light.outside": self.light is not None and any(self.light.outside),
            "press.albedo": any(one.albedo is not None for one in self.presses),
        }
        if any(behind.values()):
            keys = ", ".join(key for key, given in behind.items() if given)
            raise ValueError(
                f"{keys}: the cover hides it; set cover.transmittance above 0, or leave [cover] out"
            )

    def _can_be_reconstructed(self, inverse: Reconstruction) -> None:
        """Refuse forces without pictures, and a time scale for rubber that has none."""
        if self.camera is None:
            raise ValueError(
                "reconstruction: forces are reconstructed from pictures, add a [camera] table"
            )
        rate = inverse.frames_per_second
        if rate is not None and not self.material.relaxation:
            raise ValueError(
                f"reconstruction.frames_per_second = {rate:g}: this rubber doesn't relax; add "
                "[[material.relaxation]], or leave it out"
            )

    def _can_be_made_thinner(self) -> None:
        """Refuse a tolerance of thickness that the body hasn't, or that cuts into its markers."""
        room = self.tolerance
        if not room.thickness_mm:
            return
        if not isinstance(self.body, Block):
            raise ValueError(
                "tolerance.thickness_mm: only a block has one thickness; leave it out with "
                f"body.shape = '{self.body.shape}'"
            )
        deepest = max((layer.depth_mm for layer in self.markers.values()), default=0.0)
        most = room.most_of_thickness_mm(self.body.thickness_mm, deepest)
        if room.thickness_mm > most and deepest <= self.body.thickness_mm:
            raise ValueError(
                f"tolerance.thickness_mm = {room.thickness_mm:g} mm: {CUT:g} times that leaves no "
                f"room for markers {deepest:g} mm deep, or less than 1 mm; take at most "
                f"{most:.3g} mm, or place them less deep"
            )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            k: _plain(v) for k, v in value.items() if not (k in ("source", "assumed") and not v)
        }
    if isinstance(value, tuple | list):
        # a step's (None, None, 1.0): TOML has no null, the table form leaves components out
        if any(v is None for v in value):
            return {axis: v for axis, v in zip("xyz", value, strict=True) if v is not None}
        return [_plain(v) for v in value]
    return value
