"""The camera behind the body: entrance pupil, lens, and the flat transparent layers it looks through."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from twin.parts.part import Part


class Layer(Part):
    """A flat transparent layer between the body's base and the camera.

    Attributes
    ----------
    index
        Refractive index.
    thickness_mm
        Thickness along z.
    """

    index: float = Field(ge=1, le=3)
    thickness_mm: float = Field(gt=0, le=1000)


class Camera(Part):
    """A camera in air that looks along -z through the base, the layers in front of it being flat and normal to z.

    Attributes
    ----------
    width_px, height_px
        Size of the picture.
    lens
        ``pinhole``: radius in px = focal_px tan(angle); ``equidistant``: focal_px times the angle.
    focal_px
        Focal length in px (px per radian on the axis).
    principal_px
        (column, row) of the optical axis; the middle of the picture if not given.
    distortion
        Brown-Conrady radial coefficients (k1, k2) of a pinhole lens; Kannala-Brandt ones of an equidistant lens.
    pupil_mm
        Position of the entrance pupil; its z lies behind the base and the layers, the rest of the way being air.
    tilt_deg
        Small rotations of the camera about x, y and z, applied in this order.
    layers
        Between base and air, in the order in which a ray leaving the body meets them.
    """

    width_px: int = Field(default=640, ge=1, le=8192)
    height_px: int = Field(default=480, ge=1, le=8192)
    lens: Literal["pinhole", "equidistant"] = "pinhole"
    focal_px: float = Field(gt=1, le=1e6)
    principal_px: tuple[float, float] | None = None
    distortion: tuple[float, float] = (0.0, 0.0)
    pupil_mm: tuple[float, float, float]
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    layers: tuple[Layer, ...] = ()

    @property
    def centre_px(self) -> tuple[float, float]:
        """(column, row) of the optical axis."""
        return self.principal_px or ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
