"""What a press leaves behind: forces, contact, and how far linear theory may be trusted with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Bools, Floats, frozen
from twin.parts.body import Body
from twin.parts.load import Load
from twin.parts.press import Probe, Sphere
from twin.theory.linearity import ERROR_BOUND, SHEARED, law_of
from twin.world.gap import TURN, Z
from twin.world.patches import Patches
from twin.world.unilateral import Equilibrium

_RATIO_LIMIT, _DEPTH_LIMIT = 0.3, 0.1


@dataclass(frozen=True, kw_only=True)
class Validity:
    """How far a press strains linear theory.

    Attributes
    ----------
    contact_over_probe_radius
        a/R of a sphere; None for a flat-ended probe.
    mean_strain
        Mean contact pressure over Young's modulus.
    indentation_over_thickness
        Indentation over the body's extent along z.
    linearisation_error
        How far linear theory is expected to be off at the markers, over the largest displacement
        (`twin.theory.linearity`).
    warnings
        What goes beyond the limits 0.3 (radius), 0.1 (thickness) and 1 % (cost of linearity), in words.
    """

    contact_over_probe_radius: float | None
    mean_strain: float
    indentation_over_thickness: float
    linearisation_error: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ContactState:
    """A probe and a body in equilibrium.

    Attributes
    ----------
    load
        One `Rectangles` term with the patches in contact; no term when nothing touches.
    indentation_mm
        Motion of the probe along z from first touch at its present (x, y); 0 when nothing touches.
    move_mm
        (3,) motion of the probe since first touch of the path.
    turn_deg
        Turn of the probe about its axis.
    force_n
        (3,) total force of the probe on the body.
    torque_nmm
        Total torque about the probe's axis, positive from x to y.
    contact_radius_mm
        Radius of the disc of the contact's area.
    area_mm2
        Area of the contact. Under a sphere from an ellipse fitted to the squared pressures, as counting patches is a
        few per cent off; under a flat face the sum of the patches in contact.
    peak_pressure_mpa
        Largest pressure of a patch; unbounded under a sharp edge, where it grows with the number of patches.
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
    dissipated_nmm
        Work that friction took from first touch to here, N mm (mJ).
    path
        The states at the end of every step, in the last of them; empty in those themselves.
    """

    load: Load
    indentation_mm: float
    move_mm: Floats
    turn_deg: float
    force_n: Floats
    torque_nmm: float
    contact_radius_mm: float
    area_mm2: float
    peak_pressure_mpa: float
    pressure_mpa: Floats
    traction_mpa: Floats
    slip: Bools
    residual: float
    validity: Validity
    friction: float = 0.0
    dissipated_nmm: float = 0.0
    path: tuple[ContactState, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.move_mm, self.force_n, self.pressure_mpa, self.traction_mpa, self.slip):
            frozen(array)


def contact_area(probe: Probe, patches: Patches, equilibrium: Equilibrium) -> float:
    """Return the area of the contact, mm2.

    Notes
    -----
    Hertz's squared pressure is a quadratic of the place that vanishes on the contact's border; the ellipse on which
    the fitted quadratic vanishes has the contact's area. Validity: a sphere with a/R below about 0.6; the fit is
    dropped for the sum of the patches where the two differ by more than 15 %, and below 12 patches.
    """
    active = equilibrium.active
    counted = float(patches.area_mm2[active].sum())
    if not isinstance(probe, Sphere) or active.sum() < 12:
        return counted
    pressure = equilibrium.force_n[active, 2] / patches.area_mm2[active]
    middle = patches.middle_mm[active]
    size = float(np.abs(middle - middle.mean(axis=0)).max())
    u, v = ((middle - middle.mean(axis=0)) / size).T
    terms = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    c = np.linalg.lstsq(terms, (pressure / pressure.max()) ** 2, rcond=None)[0]
    bend = -np.array([[c[3], c[4] / 2], [c[4] / 2, c[5]]])
    if np.linalg.eigvalsh(bend)[0] <= 0:
        return counted
    top = float(c[0] + np.array(c[1:3]) @ np.linalg.solve(bend, c[1:3]) / 4)
    stretch = counted / float(4.0 * np.prod(patches.cell_mm[active], axis=1).sum())
    fitted = math.pi * top / math.sqrt(float(np.linalg.det(bend))) * size**2 * stretch
    return fitted if abs(fitted / counted - 1.0) < 0.15 else counted


def _validity(
    probe: Probe, body: Body, radius: float, pressure: float, depth: float, modulus: float, *, sheared: bool
) -> Validity:
    ratio = 2.0 * radius / probe.diameter_mm if isinstance(probe, Sphere) else None
    low, high = body.bounds_mm
    thin = depth / (high[2] - low[2])
    strain = pressure / modulus
    said = []
    if ratio is not None and ratio > _RATIO_LIMIT:
        said.append(
            f"contact radius / probe radius = {ratio:.2f} > {_RATIO_LIMIT}: linear contact understates the indentation"
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
        contact_over_probe_radius=ratio, mean_strain=strain, indentation_over_thickness=thin,
        linearisation_error=error, warnings=tuple(said),
    )  # fmt: skip


def touching_state(
    probe: Probe, body: Body, patches: Patches, equilibrium: Equilibrium, *, touch_z_mm: float,
    friction: float, youngs_modulus_mpa: float, dissipated_nmm: float = 0.0,
) -> ContactState:  # fmt: skip
    """Return the state of a probe in contact; ``touch_z_mm`` is its z at first touch at its present (x, y)."""
    active = equilibrium.active
    force = np.einsum("kai,ka->ki", patches.frames, equilibrium.force_n)
    area = patches.area_mm2[active]
    pressure = equilibrium.force_n[active, 2] / area
    contact = contact_area(probe, patches, equilibrium)
    radius = math.sqrt(contact / math.pi)
    depth = float(equilibrium.place[Z]) - touch_z_mm
    mean = float(equilibrium.force_n[active, 2].sum()) / contact
    total = force[active].sum(axis=0)
    sheared = friction > 0 and bool(np.hypot(total[0], total[1]) > SHEARED * abs(total[2]))
    return ContactState(
        load=Load((patches.rectangles(force, active),)),
        indentation_mm=depth,
        move_mm=equilibrium.place[:3].copy(),
        turn_deg=math.degrees(equilibrium.place[TURN]),
        force_n=total,
        torque_nmm=float(equilibrium.total[TURN]),
        contact_radius_mm=radius,
        area_mm2=contact,
        peak_pressure_mpa=float(pressure.max()),
        pressure_mpa=pressure,
        traction_mpa=force[active] / area[:, None],
        slip=equilibrium.slipping[active] if friction > 0 else np.ones(int(active.sum()), bool),
        residual=equilibrium.residual,
        validity=_validity(probe, body, radius, mean, depth, youngs_modulus_mpa, sheared=sheared),
        friction=friction,
        dissipated_nmm=dissipated_nmm,
    )


def lifted_state(probe: Probe, place: Floats, *, friction: float = 0.0, dissipated_nmm: float = 0.0) -> ContactState:
    """Return the state of a probe that touches nothing."""
    return ContactState(
        load=Load(), indentation_mm=0.0, move_mm=place[:3].copy(), turn_deg=math.degrees(place[TURN]),
        force_n=np.zeros(3), torque_nmm=0.0, contact_radius_mm=0.0, area_mm2=0.0, peak_pressure_mpa=0.0,
        pressure_mpa=np.zeros(0), traction_mpa=np.zeros((0, 3)), slip=np.zeros(0, bool), residual=0.0,
        validity=Validity(
            contact_over_probe_radius=0.0 if isinstance(probe, Sphere) else None, mean_strain=0.0,
            indentation_over_thickness=0.0, linearisation_error=0.0, warnings=(),
        ),
        friction=friction, dissipated_nmm=dissipated_nmm,
    )  # fmt: skip
