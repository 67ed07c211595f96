"""A scene: everything that is needed to take a press through the whole twin, and nothing else."""

from __future__ import annotations

from typing import Any

from pydantic import Field, field_validator, model_validator

from twin.parts.accuracy import CUT, Accuracy, Tolerance
from twin.parts.body import AnyBody
from twin.parts.camera import Camera, Ccd, Light
from twin.parts.load import Footprint, Load
from twin.parts.markers import MarkerLayer, stiff_problems
from twin.parts.material import Cover, Material
from twin.parts.part import Part
from twin.parts.pipeline import Calibration, Reconstruction, Tracking
from twin.parts.press import Press
from twin.parts.probe import width_mm
from twin.parts.vary import Dataset, Distribution, flat


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
    press
        Without one the sensor is only at rest.
    reconstruction
        Without one no forces are estimated.
    tractions
        Footprints whose tractions push instead of the press; a press beside them is not done.
    vary
        Distributions by dotted key of the scene: what differs between the samples of a dataset. A
        single run uses the scene's own values.
    """

    title: str = ""
    seed: int = Field(default=1, ge=0, le=2**63 - 1)
    body: AnyBody
    material: Material
    cover: Cover | None = None
    markers: dict[str, MarkerLayer] = Field(default_factory=dict)
    camera: Camera | None = None
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
        return flat(value) if isinstance(value, dict) else value

    @property
    def load(self) -> Load:
        """What the tractions push with."""
        return sum((each.load() for each in self.tractions), Load())

    @property
    def displacement_error(self) -> float:
        """Largest error of a marker's displacement over the largest displacement that is asked
        for."""
        made = self.tolerance.preset != "none"
        return self.accuracy.displacement_for(self.tolerance.youngs_modulus_pct if made else 0.0)

    @property
    def contact_patches(self) -> int:
        """Contact patches across the contact's diameter that are asked for."""
        widths = (
            []
            if self.press is None
            else [width_mm(each.probe) for each in (self.press, *self.press.also)]
        )
        return self.accuracy.patches_for(
            widths, [layer.depth_mm for layer in self.markers.values()]
        )

    @model_validator(mode="after")
    def _fits_together(self) -> Scene:
        if self.camera is not None:
            front = self.body.base_z_mm + sum(layer.thickness_mm for layer in self.camera.layers)
            if self.camera.pupil_mm[2] < front:
                raise ValueError(
                    f"camera.pupil_mm: z = {self.camera.pupil_mm[2]} mm must lie behind the base "
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
        shortfall = CUT * self.tolerance.poisson_ratio if self.tolerance.preset != "none" else 0.0
        if problems := stiff_problems(
            self.body, self.markers, self.material, self.cover, shortfall
        ):
            raise ValueError("; ".join(problems))
        if self.reconstruction is not None and self.camera is None:
            raise ValueError(
                "reconstruction: forces are reconstructed from pictures, add a [camera] table"
            )
        return self
