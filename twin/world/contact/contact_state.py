"""What a press leaves behind: forces, contact, and how far linear theory may be trusted with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, Ints, frozen
from twin.compiled import njit
from twin.parts.load import Load
from twin.parts.probe import Sphere
from twin.theory.linearity import ERROR_BOUND, SHEARED, law_of
from twin.world.contact.contact_area import contact_area
from twin.world.contact.gap import ABOUT_X, TURN, Z
from twin.world.contact.patches import Patches
from twin.world.contact.together import Setting
from twin.world.contact.unilateral import Equilibrium

_RATIO_LIMIT, _DEPTH_LIMIT, _SLOPE_LIMIT = 0.3, 0.1, 0.3
_GRAZED = 1e6
"""Largest slope, squared, that is told."""


@dataclass(frozen=True, kw_only=True)
class Validity:
    """How far a press strains linear theory.

    Attributes
    ----------
    contact_over_probe_radius
        a/R of a sphere; None for any other probe.
    steepest_slope
        Largest slope of the probe against the surface where they touch; linear contact takes it for small. 0 under a
        flat face.
    mean_strain
        Mean contact pressure over Young's modulus.
    indentation_over_thickness
        Indentation over the body's extent along z.
    linearisation_error
        How far linear theory is expected to be off at the markers, over the largest displacement
        (`twin.theory.linearity`).
    warnings
        What goes beyond the limits 0.3 (radius and slope), 0.1 (thickness) and 1 % (cost of linearity), in words.
    """

    contact_over_probe_radius: float | None
    steepest_slope: float
    mean_strain: float
    indentation_over_thickness: float
    linearisation_error: float
    warnings: tuple[str, ...]

    @property
    def linear(self) -> bool:
        """Whether linear contact holds: no limit is passed."""
        return not self.warnings


@dataclass(frozen=True, kw_only=True)
class PatchError:
    """How much a press changes when every patch is made twice as wide: a bound if it converges with order 1 or more.

    Attributes
    ----------
    traction
        Root mean square change of the tractions over their root mean square.
    peak_pressure, contact_radius, indentation, force
        Relative changes; ``force`` of the largest component, of indentation over itself.
    """

    traction: float
    peak_pressure: float
    contact_radius: float
    indentation: float
    force: float


@dataclass(frozen=True, kw_only=True)
class ContactState:
    """A probe and a body in equilibrium; of several probes the first, with the others in ``also``.

    Attributes
    ----------
    load
        One `Rectangles` term with the patches in contact, none when nothing touches; then those of the probes in
        ``also``, so that it is the load of all.
    indentation_mm
        Motion of the probe along its direction of approach from first touch at its present place; 0 when nothing
        touches.
    move_mm
        (3,) motion of the probe since first touch of the path, global axes.
    turn_deg
        Turn of the probe about its axis, degrees.
    turns_deg
        (3,) the whole turn since first touch as a rotation vector, global axes, degrees.
    force_n
        (3,) total force of the probe on the body, global axes.
    torque_nmm
        Total torque about the probe's axis, positive from x to y.
    torques_nmm
        (3,) total torque about the place of the probe's lowest point at first touch, moved along its x and y if there
        is no friction; global axes.
    contact_radius_mm
        Radius of the disc of the contact's area.
    area_mm2
        Area of the contact: under a sphere or a cone from a fit to the squared pressures (`contact_area`), else the sum
        of the patches in contact.
    peak_pressure_mpa
        Largest pressure of a patch; unbounded under a sharp edge or tip, where it grows with the number of patches.
    pressure_mpa
        (k,) pressures of the patches in contact.
    traction_mpa
        (k, 3) tractions on the body of the patches in contact, global axes.
    slip
        (k,) whether each of them slips on the probe; the others stick. All do without friction; when sticking only
        those that were pulled off and pushed back at the end of the step.
    residual
        Largest relative error of gap, sign, friction and balance; at most 1e-8.
    validity
        How far linear theory is strained.
    friction
        Coefficient of friction: 0 is frictionless, inf is sticking.
    elastic_nmm
        Half of force times displacement under this probe, N mm (mJ): the probes' sum is the body's elastic energy.
    dissipated_nmm
        Work that friction under all probes took from first touch to here, N mm.
    also
        The states of further probes, pressed at the same time.
    path
        The states at the end of every step, in the last of them; empty in those themselves.
    complete, reason
        Whether the path was taken to its end; if not, this is the last state that converged, and why it stopped.
    error
        How far the discretisation may be off, where it was asked for.
    """

    load: Load
    indentation_mm: float
    move_mm: Floats
    turn_deg: float
    turns_deg: Floats
    force_n: Floats
    torque_nmm: float
    torques_nmm: Floats
    contact_radius_mm: float
    area_mm2: float
    peak_pressure_mpa: float
    pressure_mpa: Floats
    traction_mpa: Floats
    slip: Bools
    residual: float
    validity: Validity
    friction: float = 0.0
    elastic_nmm: float = 0.0
    dissipated_nmm: float = 0.0
    also: tuple[ContactState, ...] = ()
    path: tuple[ContactState, ...] = ()
    complete: bool = True
    reason: str = ""
    error: PatchError | None = None

    def __post_init__(self) -> None:
        arrays = (self.move_mm, self.turns_deg, self.force_n, self.torques_nmm, self.pressure_mpa, self.traction_mpa)
        for array in (*arrays, self.slip):
            frozen(array)


@njit(cache=True)
def _longest(slope: Floats, active: Ints) -> float:
    """Return the largest square of 1 / cosine of the angle between probe and surface, where they touch.

    A probe that comes along e meets a surface of the probe's normal n with slopes (k, 6) n / (e . n).
    """
    longest = 1.0
    for i in active:
        longest = max(longest, slope[i, 0] ** 2 + slope[i, 1] ** 2 + slope[i, 2] ** 2)
    return longest


@njit(cache=True)
def _added_up(
    frames: Floats, half: Floats, own_force: Floats, moved: Floats, active: Ints, rubs: bool
) -> tuple[Floats, Floats, Floats, Floats, float, float, float]:
    """Return what the n patches in contact carry: forces (n, 3), pressures (n,) and tractions (n, 3), global axes.

    Then the whole force (3,), what pushes, the largest pressure, and half of force times displacement; without friction
    of what pushes alone, as the patches' motion sideways isn't known.
    """
    n = len(active)
    force, pressure, traction, total = np.zeros((n, 3)), np.empty(n), np.empty((n, 3)), np.zeros(3)
    push, peak, elastic = 0.0, 0.0, 0.0
    for row in range(n):
        i = active[row]
        area = 4.0 * half[i, 0] * half[i, 1]
        for axis in range(3):
            for side in range(3):
                force[row, axis] += frames[i, side, axis] * own_force[i, side]
            total[axis] += force[row, axis]
            traction[row, axis] = force[row, axis] / area
            if rubs or axis == 2:
                elastic += 0.5 * own_force[i, axis] * moved[i, axis]
        pressure[row] = own_force[i, 2] / area
        push, peak = push + own_force[i, 2], max(peak, pressure[row])
    return force, pressure, traction, total, push, peak, elastic


def _validity(
    setting: Setting, radius: float, slope: float, pressure: float, depth: float, *, sheared: bool
) -> Validity:
    probe, modulus = setting.probe, setting.youngs_modulus_mpa
    ratio = 2.0 * radius / probe.diameter_mm if isinstance(probe, Sphere) else None
    low, high = setting.body.bounds_mm
    thin = depth / (high[2] - low[2])
    strain = pressure / modulus
    said = []
    if ratio is not None and ratio > _RATIO_LIMIT:
        said.append(
            f"contact radius / probe radius = {ratio:.2f} > {_RATIO_LIMIT}: linear contact understates the indentation"
        )
    elif ratio is None and slope > _SLOPE_LIMIT:
        said.append(
            f"slope of the probe where it touches = {slope:.2f} > {_SLOPE_LIMIT}: linear contact takes it for small"
        )
    if thin > _DEPTH_LIMIT:
        said.append(f"indentation / thickness = {thin:.2f} > {_DEPTH_LIMIT}: the body is squeezed as a whole")
    law = law_of(probe.kind, sheared=sheared)
    error = law.error(strain)
    if error > ERROR_BOUND:
        beyond = f"; a guess, as the law is known up to {law.known_strain:g} only" if strain > law.known_strain else ""
        said.append(
            f"mean pressure / Young's modulus = {strain:.2f}: linear theory may be {100 * error:.1f} % of the largest "
            f"displacement off at the markers, bound {100 * ERROR_BOUND:g} % (docs/validity.md{beyond}): press with "
            "less force"
        )
    return Validity(
        contact_over_probe_radius=ratio, steepest_slope=slope, mean_strain=strain, indentation_over_thickness=thin,
        linearisation_error=error, warnings=tuple(said),
    )  # fmt: skip


def touching_state(
    setting: Setting, patches: Patches, equilibrium: Equilibrium, *, touch_z_mm: float, friction: float,
    dissipated_nmm: float = 0.0, slope: Floats | None = None,
) -> ContactState:  # fmt: skip
    """Return the state of a probe in contact.

    ``touch_z_mm`` is its z at first touch at its present place; ``slope`` (k, 6) that of its gaps, if it is known.
    """
    axes, place = setting.first.axes, equilibrium.place
    active = np.flatnonzero(equilibrium.active)
    touches = len(active) > 0
    force, pressure, traction, total, push, peak, elastic = _added_up(
        patches.frames, patches.half_mm, equilibrium.force_n, equilibrium.displacement_mm, active, friction > 0
    )
    contact = contact_area(setting, patches, equilibrium) if touches else 0.0
    radius, depth, sheared = math.sqrt(contact / math.pi), float(place[Z]) - touch_z_mm, False
    if friction > 0:
        x, y, z = axes @ total
        sheared = math.hypot(x, y) > SHEARED * abs(z)
    steepest = 0.0
    if touches and setting.face is None:
        if slope is None:
            _, slope = setting.first.gap(patches.centre_mm, patches.frames[:, 2], place)
        steepest = math.sqrt(min(_longest(slope, active), _GRAZED) - 1.0)
    own = np.concatenate((place, equilibrium.total[ABOUT_X:])).reshape(3, 3) @ axes
    return ContactState(
        load=Load((patches.rectangles(force, active),)) if touches else Load(),
        indentation_mm=depth,
        move_mm=own[0],
        turn_deg=math.degrees(place[TURN]),
        turns_deg=np.degrees(own[1]),
        force_n=total,
        torque_nmm=float(equilibrium.total[TURN]),
        torques_nmm=own[2],
        contact_radius_mm=radius,
        area_mm2=contact,
        peak_pressure_mpa=peak,
        pressure_mpa=pressure,
        traction_mpa=traction,
        slip=equilibrium.slipping[active] if friction > 0 else np.ones(len(active), bool),
        residual=equilibrium.residual,
        validity=_validity(setting, radius, steepest, push / contact if contact else 0.0, depth, sheared=sheared),
        friction=friction,
        elastic_nmm=elastic,
        dissipated_nmm=dissipated_nmm,
    )


def lifted_state(
    setting: Setting, place: Floats, *, friction: float = 0.0, dissipated_nmm: float = 0.0
) -> ContactState:
    """Return the state of a probe that touches nothing."""
    axes = setting.first.axes
    return ContactState(
        load=Load(), indentation_mm=0.0, move_mm=place[: Z + 1] @ axes, turn_deg=math.degrees(place[TURN]),
        turns_deg=np.degrees(place[ABOUT_X:] @ axes), force_n=np.zeros(3), torque_nmm=0.0, torques_nmm=np.zeros(3),
        contact_radius_mm=0.0, area_mm2=0.0, peak_pressure_mpa=0.0,
        pressure_mpa=np.zeros(0), traction_mpa=np.zeros((0, 3)), slip=np.zeros(0, bool), residual=0.0,
        validity=Validity(
            contact_over_probe_radius=0.0 if isinstance(setting.probe, Sphere) else None, steepest_slope=0.0,
            mean_strain=0.0, indentation_over_thickness=0.0, linearisation_error=0.0, warnings=(),
        ),
        friction=friction, dissipated_nmm=dissipated_nmm,
    )  # fmt: skip
