"""The calibration: what the sensor's software knows about its sensor, and the file that holds it.

Its transfer matrix, px/N, comes from a nominal body's compliance seen through the camera
(`from_compliance`), or from measured presses (`from_presses`). Either is (2n, 3k): rows marker by
marker (column, row), columns site by site (force along global x, y, z).
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Picture, Pixels, Points, frozen
from twin.display import html_table, one_line
from twin.errors import InputError, TwinError
from twin.files import read_arrays, write_whole
from twin.parts.camera import Camera
from twin.parts.load import Rectangles
from twin.theory.halfspace import compliance
from twin.theory.optics import project, project_with_jacobian
from twin.theory.relaxation import Relaxation

VERSION = 4
READABLE = (1, 2, 3, 4)
"""Format version that is written, and those that are read."""

SINCE = {
    "compliance": 2,
    "marker_mm": 2,
    "camera": 2,
    "condition": 2,
    "left_out": 2,
    "by_thickness": 3,
    "by_depth": 4,
    "by_load_cell": 4,
}
"""Format version from which on files have these; all others are in each."""

ABOVE, BESIDE = 1.5, 3.0
"""Depth and distance of markers from a site, over the side of its cell, within which they see where
in the cell a force acts: 3 and 6 mm below cells of 2 mm it is 2 % of a field's deviation."""

TEXTS = ("layer", "method", "provenance", "camera")
SCALARS = ("noise_px", "diameter_px", "method", "provenance", "camera", "condition")


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Nominal layout, sites and transfer matrix.

    Attributes
    ----------
    layer
        (n,) layer of every marker, layers in the layout's order.
    layout_px
        (n, 2) nominal rest positions, px.
    site_mm
        (k, 3) places on the sensing surface where forces are reconstructed, mm; s (along x) outer,
        t (along y) inner.
    site_frames
        (k, 3, 3) frames there; rows are tangent s, tangent t and the inward normal.
    site_area_mm2
        (k,) surface area that each site stands for.
    grid
        (columns, rows) of the sites; columns * rows = k.
    transfer
        (2n, 3k) px/N. Rows: marker by marker, column then row; columns: site by site, force along
        global x, y, z. A marker whose rows hold NaN could not be calibrated and is left out of
        every reconstruction.
    noise_px
        Standard deviation of a shift's component where tracking states none, px.
    diameter_px
        Nominal marker width in the picture, px; NaN if not known.
    method
        Where the transfer comes from.
    provenance
        JSON text: how it was made, with a digest of the nominal scene; see `relaxation`,
        `scale_error`, `mesh_error`, `print_error` and `by_camera`.
    by_thickness
        (2n, 3k) px/N, how much `transfer` changes by one standard deviation of the body's
        thickness, or from a half-space to the drawn body; (0, 0) where that isn't known.
    by_depth
        (2n, 3k) px/N, how much it changes by one standard deviation of the depths of the markers'
        layers, which err each on its own; (0, 0) where that isn't known.
    by_load_cell
        (3p, 3k) N/N, from forces at the sites to what each of p times three calibration presses
        adds to every component of their total by the load cell's standard deviation; (0, 0) where
        that isn't known.
    compliance
        (3n, 3k) mm/N, marker motion per site force, where the camera's bend is to be followed; else
        (0, 0).
    marker_mm
        (n, 3) markers at rest that go with it, mm; else (0, 3).
    camera
        JSON text that goes with it: ``camera`` (`twin.parts.camera.Camera`), ``body_index`` and
        ``base_z_mm``; ``{}`` without.
    condition
        Largest over smallest singular value of the transfer matrix; NaN if not known.
    left_out
        (q,) error of every calibrated place's transfer as predicted from the other places, over its
        size; empty where nothing was measured.

    Examples
    --------
    >>> import twin
    >>> from twin.files import SCENES
    >>> calibration = twin.read_calibration(SCENES / "sato_calibration.npz")
    >>> calibration.method, calibration.transfer.shape
    ('sato', (122, 243))
    """

    layer: NDArray[np.str_]
    layout_px: Pixels
    site_mm: Points
    site_frames: Floats
    site_area_mm2: Floats
    grid: tuple[int, int]
    transfer: Floats
    noise_px: float = 0.03
    diameter_px: float = float("nan")
    method: str = "compliance"
    provenance: str = "{}"
    by_thickness: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    by_depth: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    by_load_cell: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    compliance: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    marker_mm: Points = field(default_factory=lambda: np.zeros((0, 3)))
    camera: str = "{}"
    condition: float = float("nan")
    left_out: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        markers, sites = len(self.layer), len(self.site_mm)
        shapes = {
            "layer": (markers,),
            "layout_px": (markers, 2),
            "site_mm": (sites, 3),
            "site_frames": (sites, 3, 3),
            "site_area_mm2": (sites,),
            "transfer": (2 * markers, 3 * sites),
            "left_out": (np.size(self.left_out),),
            "by_thickness": (2 * markers, 3 * sites) if np.size(self.by_thickness) else (0, 0),
            "by_depth": (2 * markers, 3 * sites) if np.size(self.by_depth) else (0, 0),
            "by_load_cell": (len(self.by_load_cell), 3 * sites * bool(len(self.by_load_cell))),
            "compliance": (3 * markers, 3 * sites) if np.size(self.compliance) else (0, 0),
            "marker_mm": (markers, 3) if np.size(self.compliance) else (0, 3),
        }
        single = ("compliance", "by_thickness", "by_depth", "by_load_cell")
        kinds: dict[str, Any] = {"layer": np.str_} | dict.fromkeys(single, np.float32)
        for name, shape in shapes.items():
            array: NDArray[Any] = np.array(getattr(self, name), kinds.get(name, np.float64))
            if array.shape != shape:
                raise InputError(f"calibration: {name} has shape {array.shape}, must be {shape}")
            if name not in ("layer", "transfer") and not np.isfinite(array).all():
                raise InputError(f"calibration: {name} must be finite")
            object.__setattr__(self, name, frozen(array))
        if not markers or not sites:
            raise InputError(f"calibration: needs markers and sites, got {markers} and {sites}")
        if np.isinf(self.transfer).any() or not np.isfinite(self.transfer).any():
            raise InputError(
                "calibration: transfer must hold finite numbers (NaN only for markers not "
                "calibrated)"
            )
        columns, rows = (int(v) for v in self.grid)
        if columns * rows != sites or columns < 1:
            raise InputError(f"calibration: grid {self.grid} does not make {sites} sites")
        object.__setattr__(self, "grid", (columns, rows))
        if not 0 < self.noise_px < 100:
            raise InputError(
                f"calibration: noise_px = {self.noise_px} px must lie between 0 and 100 px"
            )
        for name in ("provenance", "camera"):
            try:
                json.loads(getattr(self, name))
            except (ValueError, RecursionError) as problem:
                raise InputError(f"calibration: {name} must be JSON text ({problem})") from None
        shares = ("scale_error", "mesh_error", "print_error", "read_error")
        for checked in ("relaxation", *shares, "_camera_error", "_picture_px"):
            getattr(self, checked)  # bad ones are refused here
        if self.has_camera:
            self._optics  # noqa: B018  a bad camera is refused here

    def __repr__(self) -> str:
        return one_line("Calibration", list(self._sensor().values()))

    def _repr_html_(self) -> str:
        return html_table("Calibration", self._sensor())

    def __str__(self) -> str:
        """Return the sensor that this is a calibration of, so that a wrong one is noticed."""
        return ", ".join(value for value in self._sensor().values() if value)

    def _sensor(self) -> dict[str, str]:
        stiffness = self.facts.get("youngs_modulus_mpa")
        return {
            "scene": str(self.facts.get("scene") or "of an unnamed sensor"),
            "method": f"method {self.method}",
            "rubber": f"E {stiffness:.3g} MPa" if stiffness is not None else "",
            "markers": f"{len(self.layer)} markers",
            "sites": f"{len(self.site_mm)} sites",
        }

    @cached_property
    def facts(self) -> dict[str, Any]:
        """What `provenance` holds; empty where that is no table."""
        stored = json.loads(self.provenance)
        return stored if isinstance(stored, dict) else {}

    @cached_property
    def relaxation(self) -> Relaxation | None:
        """How the rubber relaxes from the modulus of `transfer`; None if that isn't known.

        The terms stand in `provenance`, as ``relaxation``: pairs of share and time, s.
        """
        terms = self.facts.get("relaxation", [])
        try:
            share, time_s = np.array(terms, np.float64).reshape(len(terms), 2).T
        except (ValueError, TypeError):
            share, time_s = np.full((2, 1), np.nan)
        if not ((share > 0).all() and share.sum() < 1 and (time_s > 0).all()):
            raise InputError(
                f"calibration: relaxation = {terms} must be pairs of a share (above 0, less than "
                "1 together) and a time above 0 s"
            )
        return Relaxation(share, time_s) if len(share) else None

    @cached_property
    def scale_error(self) -> float:
        """Standard deviation of a factor that all forces share, from 0: of the modulus and the
        focal length within their tolerances, or as fitted to presses; 0 if that isn't known. The
        thickness: `by_thickness`; the depths: `by_depth`.

        It stands in `provenance`, as ``scale_error``.
        """
        return self._share("scale_error")

    @cached_property
    def mesh_error(self) -> float:
        """Expected error of the computed response over the largest one: of the mesh. It makes of a
        force one as much smaller, along any axis. 0 if that isn't known.

        It stands in `provenance`, as ``mesh_error``.
        """
        return self._share("mesh_error")

    @cached_property
    def print_error(self) -> float:
        """Standard deviation of a printed marker's place along each axis, over the pitch, within
        the tolerances; 0 if that isn't known.

        It stands in `provenance`, as ``print_error``.
        """
        return self._share("print_error")

    @cached_property
    def read_error(self) -> Floats:
        """(3,) shares of each component of a total force by which this calibration read its own
        presses further off than was stated: where forces are expected, and how they spread between
        sites, err alike in all of them. 0 if that isn't known.

        They stand in `provenance`, as ``read_error``.
        """
        found = self.facts.get("read_error", [0.0] * 3)
        if not (isinstance(found, list) and len(found) == 3):
            raise InputError(f"calibration: read_error = {found!r} must be three shares")
        return frozen(np.array([self._checked_share("read_error", one) for one in found]))

    def _share(self, name: str) -> float:
        return self._checked_share(name, self.facts.get(name, 0.0))

    @staticmethod
    def _checked_share(name: str, found: object) -> float:
        if not (isinstance(found, int | float) and 0.0 <= found < 1.0):
            raise InputError(f"calibration: {name} = {found!r} must lie from 0 to 1")
        return float(found)

    @cached_property
    def by_camera(self) -> Floats:
        """(6, n, 2, 3) how much the markers' derivatives in the picture change by a standard
        deviation of the pupil's x, y and z and of the camera's turns about them, px/mm; (0, n, 2,
        3) if that isn't known.

        The deviations stand in `provenance`, as ``camera_error``: those of a coordinate, mm, and of
        a turn, deg.
        """
        found = self._camera_error
        if not (self.has_camera and any(found)):
            return np.zeros((0, len(self.layer), 2, 3))
        camera, index, base = self._optics
        changes = []
        for moved in np.diag(np.repeat(found, 3)):
            other = camera.deviating(base, moved[:3], moved[3:], 0.0, 0.0)
            there = project_with_jacobian(self.marker_mm, other, index, base)[1]
            changes.append(there - self._seen)
        return frozen(np.nan_to_num(np.stack(changes)))

    @property
    def _camera_error(self) -> tuple[float, float]:
        found = self.facts.get("camera_error", (0.0, 0.0))
        if not (
            isinstance(found, list | tuple)
            and len(found) == 2
            and all(isinstance(one, int | float) and 0.0 <= one <= 10.0 for one in found)
        ):
            raise InputError(f"calibration: camera_error = {found!r} must be two numbers up to 10")
        return found[0], found[1]

    @cached_property
    def calibrated(self) -> Bools:
        """(n,) markers whose transfer is known."""
        return frozen(np.asarray(np.isfinite(self.transfer).all(axis=1).reshape(-1, 2).all(axis=1)))

    @cached_property
    def total_rows(self) -> Floats:
        """(6, 3k): total force, N, and torque about the origin, N mm, of the sites' forces."""
        rows = np.zeros((6, len(self.site_mm), 3))
        rows[:3] = np.eye(3)[:, None, :]
        for axis in range(3):
            rows[3:, :, axis] = np.cross(self.site_mm, np.eye(3)[axis]).T
        return frozen(rows.reshape(6, -1))

    @property
    def has_camera(self) -> bool:
        """Whether `bend_px` can be asked."""
        return self.compliance.size > 0

    def require_size(self, picture: Picture) -> None:
        """Raise an `InputError` where a picture isn't as large as the calibrated camera's, whose
        size `provenance` holds as ``picture_px`` where it is known."""
        height, width = picture.shape[:2]
        known = self._picture_px
        if known is not None and known != (width, height):
            raise InputError(
                f"the picture has {width} x {height} pixels, the calibration is of a camera of "
                f"{known[0]} x {known[1]}: record in that mode, or set camera.width_px and "
                "height_px in the recipe and make a calibration of this one"
            )

    @property
    def _picture_px(self) -> tuple[int, int] | None:
        found = self.facts.get("picture_px")
        if found is None:
            return None
        if not (
            isinstance(found, list)
            and len(found) == 2
            and all(isinstance(one, int) and one > 0 for one in found)
        ):
            raise InputError(f"calibration: picture_px = {found!r} must be a width and a height")
        return found[0], found[1]

    @staticmethod
    def camera_text(camera: Camera, body_index: float, base_z_mm: float) -> str:
        """Return the text `camera` of a camera, the refractive index of the rubber, and the height
        of the base, mm."""
        seen = camera.model_dump(mode="json")
        return json.dumps({"camera": seen, "body_index": body_index, "base_z_mm": base_z_mm})

    @cached_property
    def _optics(self) -> tuple[Camera, float, float]:
        try:
            stored = json.loads(self.camera)
            return (
                Camera.model_validate(stored["camera"]),
                float(stored["body_index"]),
                float(stored["base_z_mm"]),
            )
        except (ValueError, KeyError, TypeError, TwinError) as problem:
            raise InputError(f"calibration: camera can't be read ({problem})") from None

    def shift_px(self, force_n: Floats) -> Pixels:
        """Return (n, 2) shifts under (k, 3) site forces as the camera sees them, not linear in the
        forces, px.

        Markers that would leave the camera's range move linearly.
        """
        linear = (self.transfer @ force_n.ravel()).reshape(-1, 2)
        motion = (self.compliance @ force_n.ravel()).reshape(-1, 3)
        seen = project(self.marker_mm + motion, *self._optics) - project(
            self.marker_mm, *self._optics
        )
        return np.where(np.isfinite(seen), seen, linear)

    def bend_px(self, force_n: Floats) -> Pixels:
        """Return (n, 2) what `shift_px` is more than the linear map, px."""
        return np.asarray(self.shift_px(force_n) - (self.transfer @ force_n.ravel()).reshape(-1, 2))

    def misplaced_px(self, site: int, force_n: Floats) -> Floats:
        """Return (4, n, 2) shifts that a force on one quarter of a site's cell makes beyond those
        of the sites that share it as a lever does, px; (3,) ``force_n`` in N.

        A quarter's own response is that of a half-space in the site's plane, as stiff as the
        calibration's response to the whole cell. Markers far from the cell (`ABOVE`, `BESIDE`), and
        calibrations without a camera, have none.
        """
        off = np.zeros((4, len(self.layer), 2))
        frame, side = self.site_frames[site], float(self.site_area_mm2[site]) ** 0.5
        if not self.has_camera:
            return off
        place = (self.marker_mm - self.site_mm[site]) @ frame.T
        near = np.flatnonzero(
            (place[:, 2] < ABOVE * side) & (np.linalg.norm(place, axis=1) < BESIDE * side)
        )
        if not len(near):
            return off
        middle = (np.arange(6) - 2.5) * side / 2  # of the halves of three cells side by side
        centre = np.array([[x, y, 0.0] for x in middle for y in middle])
        quarters = Rectangles(
            centre_mm=centre,
            frames=np.tile(np.eye(3), (36, 1, 1)),
            half_mm=np.full((36, 2), side / 4),
            force_n=np.zeros((36, 3)),
        )
        single = compliance(place[near], quarters, 1.0, 0.5).reshape(-1, 3, 3, 2, 3, 2, 3)
        cells = single.mean(axis=(3, 5))
        known = self.compliance.reshape(-1, 3, len(self.site_mm), 3)[near, :, site] @ frame.T
        whole = np.einsum("ki,nkj->nij", frame, cells[:, :, 1, 1])
        stiffness = float((known * whole).sum() / (whole**2).sum())
        shares = np.array([[0.25, 0.75, 0.0], [0.0, 0.75, 0.25]])
        lever = np.einsum("ap,bq,nipqj->abnij", shares, shares, cells)
        error = np.moveaxis(single[:, :, 1, :, 1], (2, 3), (0, 1)) - lever
        motion = stiffness * (error @ (frame @ force_n)) @ frame
        off[:, near] = np.einsum("nij,anj->ani", self._seen[near], motion.reshape(4, -1, 3))
        return off

    @cached_property
    def _seen(self) -> Floats:
        """(n, 2, 3) derivatives of the markers' places in the picture by their motion, px/mm."""
        return np.nan_to_num(project_with_jacobian(self.marker_mm, *self._optics)[1])

    @property
    def layout(self) -> dict[str, Pixels]:
        """Nominal rest positions by layer, px: what `track` takes."""
        return {name: np.asarray(self.layout_px[self.layer == name]) for name in self.layers}

    @cached_property
    def of_layers(self) -> NDArray[np.float32]:
        """(l, n, 1) ones for the markers of each of `layers`, else 0."""
        names = np.array(self.layers)[:, None]
        return frozen((self.layer == names)[:, :, None].astype(np.float32))

    @cached_property
    def layers(self) -> tuple[str, ...]:
        """The layers' names."""
        return tuple(dict.fromkeys(str(name) for name in self.layer))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a calibration file (npz), whole or not at all."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(Calibration)}

        def write(stream: IO[bytes]) -> None:
            np.savez_compressed(stream, allow_pickle=False, version=np.array(VERSION), **arrays)

        write_whole(Path(path), write)


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration file.

    Raises
    ------
    InputError
        There is none, it is damaged, or it was written by an incompatible version.

    Examples
    --------
    ``twin calibrate --scene sato_press --out finger.npz`` writes such a file; one is shipped:

    >>> import twin
    >>> from twin.files import SCENES
    >>> twin.read_calibration(SCENES / "sato_calibration.npz").grid
    (9, 9)
    """
    try:
        arrays: dict[str, NDArray[Any]] = {**read_arrays(path)}
    except FileNotFoundError:
        raise InputError(
            f"calibration file {path} does not exist: make one with `twin calibrate`"
        ) from None
    except (OSError, ValueError) as problem:
        raise InputError(
            f"{path}: is no calibration file that can be read ({problem}): give the .npz that "
            "`twin calibrate --out` wrote"
        ) from None
    version = arrays.get("version", np.array(0))
    if "version" in arrays and (version.shape != () or version not in READABLE):
        raise InputError(
            f"{path} has format version {version}, this program reads {READABLE}: make it again"
        )
    names = [f.name for f in fields(Calibration) if SINCE.get(f.name, 1) <= version]
    missing = [name for name in ["version", *names] if name not in arrays]
    if missing:
        raise InputError(
            f"{path} is no calibration file: it lacks {', '.join(missing)}; make one with `twin "
            f"calibrate`"
        )
    for name in names:
        kinds, what = ("U", "text") if name in TEXTS else ("fi", "numbers")
        if arrays[name].dtype.kind not in kinds:
            raise InputError(f"{path}: {name} must be {what}, got {arrays[name].dtype}")
    if arrays["grid"].shape != (2,) or any(
        arrays[name].shape != () for name in names if name in SCALARS
    ):
        raise InputError(
            f"{path}: grid must be two numbers, and {', '.join(SCALARS)} single values"
        )
    stored: dict[str, Any] = {name: arrays[name] for name in names}
    stored |= {
        name: (str if name in TEXTS else float)(stored[name]) for name in names if name in SCALARS
    }
    try:
        return Calibration(**stored | {"grid": (int(stored["grid"][0]), int(stored["grid"][1]))})
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


LARGEST_CONDITION = 1e3
"""Of a site's matrix of measured forces, each press scaled to 1 N: beyond it the three directions
aren't distinguished."""


def from_compliance(compliance: Floats, jacobian: Floats) -> Floats:
    """Return the transfer matrix of a body of known compliance.

    Parameters
    ----------
    compliance
        (3n, 3k) marker displacement per site force, mm/N, marker by marker and site by site, axes
        x, y, z.
    jacobian
        (n, 2, 3) derivative of every marker's place in the picture, px/mm: the projection of all
        three axes, z included (the flat paper's section 2.5).

    Returns
    -------
    (2n, 3k) px/N
    """
    compliance, jacobian = np.asarray(compliance, float), np.asarray(jacobian, float)
    markers = len(jacobian)
    good = (
        jacobian.shape == (markers, 2, 3)
        and compliance.ndim == 2
        and compliance.shape[0] == 3 * markers
    )
    if not good or compliance.shape[1] % 3:
        raise InputError(
            f"compliance must be (3n, 3k) and jacobian (n, 2, 3), got {compliance.shape} and "
            f"{jacobian.shape}"
        )
    return np.asarray(
        np.matmul(jacobian, compliance.reshape(markers, 3, -1)).reshape(2 * markers, -1)
    )


def from_presses(forces_n: Floats, shifts_px: Floats) -> Floats:
    """Return the transfer matrix from measured presses, h_n = u_n f_n^-1 (finger paper, eqs. 3-5).

    The measured forces are used as they are: a press along x or y follows one along z and still
    carries it.

    Parameters
    ----------
    forces_n
        (k, 3, 3) f_n of every site: ``[:, m, n]`` is the force along m under the n-th press, N (eq.
        3).
    shifts_px
        (k, 3, 2N) movement of the markers under the n-th press, px; NaN where a marker was lost.

    Returns
    -------
    (2N, 3k) px/N, NaN for a marker at a site where it was lost.

    Raises
    ------
    InputError
        The presses of a site don't span three directions, or there are none.
    """
    forces, shifts = np.asarray(forces_n, float), np.asarray(shifts_px, float)
    sites = len(forces)
    if (
        forces.shape != (sites, 3, 3)
        or shifts.ndim != 3
        or shifts.shape[:2] != (sites, 3)
        or shifts.shape[2] % 2
    ):
        raise InputError(
            f"forces must be (k, 3, 3) and shifts (k, 3, 2N), got {forces.shape} and {shifts.shape}"
        )
    if not np.isfinite(forces).all():
        raise InputError("the measured forces of calibration presses must be finite, N")
    if not sites:
        raise InputError("there are no calibration presses")
    length = np.linalg.norm(forces, axis=1, keepdims=True)
    spread = np.linalg.cond(forces / np.where(length > 0.0, length, 1.0))
    if (worst := float(spread.max())) > LARGEST_CONDITION:
        raise InputError(
            f"site {int(spread.argmax())}: the measured forces of its presses have condition "
            f"number {worst:.3g} (allowed up to {LARGEST_CONDITION:.0f}): press along z, then also "
            "along x and along y"
        )
    seen = np.isfinite(shifts.reshape(sites, 3, -1, 2)).all(axis=(1, 3)).repeat(2, axis=1)
    columns = np.linalg.solve(forces.transpose(0, 2, 1), np.nan_to_num(shifts))
    columns = np.where(seen[:, None], columns, np.nan)
    return np.asarray(columns.transpose(2, 0, 1).reshape(shifts.shape[2], -1))


def fill_between(
    measured: Floats,
    nominal_at_presses: Floats,
    nominal_at_sites: Floats,
    press_axes_mm: tuple[Floats, Floats],
    site_chart_mm: Floats,
) -> Floats:
    """Return the transfer matrix at any sites, from one measured on a coarser grid and the nominal
    body's at both.

    What the nominal design gets wrong (stiffness, depths, camera pose) changes slowly from place to
    place, unlike the response itself; so the difference is interpolated linearly and the nominal
    response carries the shape. Beyond the pressed grid the difference of its border is used.

    Parameters
    ----------
    measured, nominal_at_presses
        (2N, 3p) px/N at the pressed places, s outer and t inner.
    nominal_at_sites
        (2N, 3k) px/N at the wanted sites.
    press_axes_mm
        The s and the t of the pressed grid, mm.
    site_chart_mm
        (k, 2) surface coordinates of the wanted sites, mm.

    Returns
    -------
    (2N, 3k) px/N; rows that were not measured are NaN.
    """
    from scipy.interpolate import RegularGridInterpolator

    rows = len(measured)
    columns = [len(axis) for axis in press_axes_mm]
    if (
        measured.shape != nominal_at_presses.shape
        or measured.shape[1] != 3 * columns[0] * columns[1]
    ):
        raise InputError(
            f"measured and nominal transfer at {columns[0]} x {columns[1]} presses must have the "
            f"same shape, got "
            f"{measured.shape} and {nominal_at_presses.shape}"
        )
    difference = (measured - nominal_at_presses).reshape(rows, *columns, 3).transpose(1, 2, 0, 3)
    inside = np.clip(
        site_chart_mm, [axis[0] for axis in press_axes_mm], [axis[-1] for axis in press_axes_mm]
    )
    between = RegularGridInterpolator(press_axes_mm, difference, method="linear")(inside)
    return np.asarray(nominal_at_sites + between.transpose(1, 0, 2).reshape(rows, -1))


def left_out(measured: Floats, nominal: Floats, chart_mm: Floats) -> Floats:
    """Return (p,) errors of every pressed place's transfer as predicted from the others, over its
    size.

    The prediction is the nominal response plus the others' differences to it, interpolated (linear
    radial functions). Empty for fewer than four places.

    Parameters
    ----------
    measured, nominal
        (2N, 3p) px/N at the pressed places; markers that were not measured hold NaN.
    chart_mm
        (p, 2) surface coordinates of the places, mm.
    """
    from scipy.interpolate import RBFInterpolator

    places = len(chart_mm)
    if places < 4:
        return np.zeros(0)
    known = np.isfinite(measured).all(axis=1)
    truth = measured[known].reshape(-1, places, 3).transpose(1, 0, 2).reshape(places, -1)
    drawn = nominal[known].reshape(-1, places, 3).transpose(1, 0, 2).reshape(places, -1)
    out = np.zeros(places)
    for place in range(places):
        others = np.arange(places) != place
        flat = bool((np.ptp(chart_mm[others], axis=0) > 0).all())
        between = RBFInterpolator(
            chart_mm[others], (truth - drawn)[others], kernel="linear", degree=0 if flat else -1
        )(chart_mm[place : place + 1])[0]
        out[place] = np.linalg.norm(drawn[place] + between - truth[place]) / np.linalg.norm(
            truth[place]
        )
    return out
