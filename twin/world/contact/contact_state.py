"""The result of a press: `ContactState`, its error by causes, and the range of linear theory.

The error is estimated in `twin.world.contact.press_error`; linear theory's own is `Validity`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import add
from typing import Any, ClassVar

import numpy as np

from twin.arrays import Bools, Floats, frozen
from twin.display import Table, new_axes, one_line, plot_patches, vector
from twin.errors import ContactError
from twin.parts.load import Load, Rectangles
from twin.parts.press import Cone, Sphere
from twin.theory.contact import ERROR_BOUND, KNOWN_RADIUS, SHEARED, law_of
from twin.world.contact.active_set import Equilibrium
from twin.world.contact.contact_problem import ProbeSetup
from twin.world.contact.probe_gap import ABOUT_X, TURN, Z
from twin.world.contact.surface_patches import Patches

_COUPLED = 0.1
"""(1 - 2 nu) / (2 (1 - nu)) from which on what sticks under a sphere bends the pressure as a cone
does: measured at 16 and 24 patches across, nu = 0.3: 0.3 % of the radius for 1.3 % low; nu = 0: 0.7
for 4. At nu = 0.45 nothing is gained."""


def _contact_area(
    setup: ProbeSetup, patches: Patches, equilibrium: Equilibrium, friction: float
) -> float:
    """Return the area of the contact, mm2: under a sphere or a cone within the outline that the
    pressures give, else the sum of the patches, which is 1 to 4 % off, at most the flat face."""
    nu = setup.poisson_ratio
    cone = isinstance(setup.probe, Cone)
    rows = np.flatnonzero(equilibrium.active)
    area = patches.area_mm2[rows]
    counted = float(area.sum())
    if not (cone or isinstance(setup.probe, Sphere)):
        flat = 4.0 * float(np.prod(patches.cell_mm[rows], axis=1).sum())
        whole = math.inf if setup.face is None else setup.face.area_mm2
        return counted * min(1.0, whole / flat)  # cells end beyond a sharp rim
    bent = cone or (friction > 0.0 and 1.0 - 2.0 * nu > _COUPLED * 2.0 * (1.0 - nu))
    place, flat = patches.middle_mm[rows], 4.0 * np.prod(patches.cell_mm[rows], axis=1)
    outline = patches.outline(place, flat, equilibrium.force_n[rows, 2] / area, bent=bent)
    if outline is None:
        return counted
    u, v = (outline - place.mean(axis=0)).T
    return math.pi * float(np.mean(u * u + v * v)) * counted / float(flat.sum())


_RATIO_LIMIT = 0.3
_DEPTH_LIMIT = 0.1
_SLOPE_LIMIT = 0.3
_GRAZED = 1e6
"""Largest slope, squared, that is reported."""


MEASURED = "measured"
ESTIMATED = "estimated"
"""Where `Validity.linearisation_error` comes from."""


@dataclass(frozen=True, kw_only=True)
class Validity:
    """How far a press strains linear theory.

    Attributes
    ----------
    contact_over_probe_radius
        a/R of a sphere; None for any other probe.
    steepest_slope
        Largest slope of the probe against the surface where they touch; linear contact takes it for
        small. 0 under a flat face.
    mean_strain
        Mean contact pressure over Young's modulus.
    indentation_over_thickness
        Indentation over the body's extent along z.
    linearisation_error
        How far linear theory is expected to be off at the markers, over the largest displacement
        (`twin.theory.contact`), or how far it is off.
    linearisation_basis
        Where that comes from: ``measured`` under this very press at finite strain, or
        ``estimated``, by the law at most, and why it was not measured.
    notes
        What goes beyond the limits 0.3 (radius) and 1 % (cost of linearity), in words, where its
        cost is known from the study of docs/validity.md.
    warnings
        What goes beyond these limits where the study has no such press, beyond 0.3 (slope), or 0.1
        (thickness).
    """

    contact_over_probe_radius: float | None
    steepest_slope: float
    mean_strain: float
    indentation_over_thickness: float
    linearisation_error: float
    linearisation_basis: str = ESTIMATED
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def linear(self) -> bool:
        """Whether linear contact holds: no limit is passed."""
        return not self.warnings and not self.notes


@dataclass(frozen=True, kw_only=True, repr=False)
class Share:
    """Relative error of a press for one cause; inf where unknown.

    Attributes
    ----------
    force, indentation
        Of every probe's total force, and of its indentation; the largest.
    traction
        Root mean square error of the tractions over their root mean square.
    markers
        Largest error of the markers' displacement over the largest displacement; where there are
        no markers, of points 0.3 mm below the contact.
    """

    force: float = 0.0
    indentation: float = 0.0
    traction: float = 0.0
    markers: float = 0.0

    @classmethod
    def unknown(cls) -> Share:
        """Return the share of a cause that couldn't be looked into."""
        return cls(force=math.inf, indentation=math.inf, traction=math.inf, markers=math.inf)

    def __repr__(self) -> str:
        errors = [f"{name} {100 * getattr(self, name):.2g} %" for name in vars(_NOTHING)]
        return one_line(type(self).__name__, errors)

    def plus(self, other: Share) -> Share:
        """Return both together."""
        return self._each(add, other)

    def at_least(self, other: Share) -> Share:
        """Return the larger of both, each by itself."""
        return self._each(max, other)

    def times(self, factor: float) -> Share:
        """Return this share so many times."""
        return self._each(lambda own, _: factor * own, self)

    def _each(self, of: Callable[[float, float], float], other: Share) -> Share:
        both = {name: (getattr(self, name), getattr(other, name)) for name in vars(_NOTHING)}
        return Share(**{name: float(of(*errors)) for name, errors in both.items()})


_NOTHING = Share()


@dataclass(frozen=True, kw_only=True, repr=False)
class PressError(Share):
    """How far a press may be off, all causes together: the module describes the estimate.

    Linear theory's own error is apart: `Validity.linearisation_error`.

    Attributes
    ----------
    body
        What the body's mesh or table leaves.
    patches
        What the contact's patches leave.
    increments
        What the parts leave in which a path with friction is taken.
    strain
        What is left of large strain, where `Material.law` includes it.
    """

    body: Share
    patches: Share
    increments: Share
    strain: Share

    @classmethod
    def of(
        cls,
        *,
        body: Share = _NOTHING,
        patches: Share = _NOTHING,
        increments: Share = _NOTHING,
        strain: Share = _NOTHING,
    ) -> PressError:
        """Return all causes together."""
        whole = body.plus(patches).plus(increments).plus(strain)
        return cls(**vars(whole), body=body, patches=patches, increments=increments, strain=strain)


@dataclass(frozen=True, kw_only=True, repr=False)
class ContactState(Table):
    """A probe and a body in equilibrium; of several probes the first, with the others in ``also``.

    Attributes
    ----------
    load
        One `Rectangles` term with the patches in contact, none when nothing touches; then those of
        the probes in ``also``, so that it is the load of all.
    indentation_mm
        Motion of the probe along its direction of approach from first touch at its present place; 0
        when nothing touches.
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
        (3,) total torque about the place of the probe's lowest point at first touch, moved along
        its x and y if there is no friction, or by how far a flat face slid; global axes.
    contact_radius_mm
        Radius of the disc of the contact's area; of a deep sphere too large, by 1.5 % at 0.43 of
        its radius and 4 % at 0.64.
    area_mm2
        Area of the contact: under a sphere or a cone from a fit to the squared pressures, else the
        sum of the patches in contact.
    peak_pressure_mpa
        Largest pressure of a patch; unbounded under a sharp edge or tip, where it grows with the
        number of patches.
    pressure_mpa
        (k,) pressures of the patches in contact.
    traction_mpa
        (k, 3) tractions on the body of the patches in contact, global axes.
    slip
        (k,) whether each of them slips on the probe; the others stick. All do without friction;
        when sticking only those that were pulled off and pushed back at the end of the step.
    residual
        Largest relative error of gap, sign, friction and balance; at most 1e-8.
    validity
        How far linear theory is strained.
    friction
        Coefficient of friction: 0 is frictionless, inf is sticking.
    elastic_nmm
        Half of force times displacement under this probe, N mm (mJ): the probes' sum is the body's
        elastic energy, but of rubber that relaxes.
    dissipated_nmm
        Work that friction under all probes took from first touch to here, N mm.
    also
        The states of further probes, pressed at the same time.
    path
        The states at the end of every step, in the last of them; empty in those themselves.
    complete, reason
        Whether the path was taken to its end; if not, this is the last state that converged, and
        why it stopped.
    estimate
        Computes ``error``.
    """

    _title: ClassVar[str] = "Contact"

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
    estimate: Callable[[ContactState], PressError] | None = field(
        default=None, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        arrays = (
            self.move_mm,
            self.turns_deg,
            self.force_n,
            self.torques_nmm,
            self.pressure_mpa,
            self.traction_mpa,
        )
        for array in (*arrays, self.slip):
            frozen(array)

    @staticmethod
    def keep_last(refused: ContactError, path: list[ContactState], steps: int) -> None:
        """Give an error the last state before the step that it refuses, as far as there is one."""
        if path:
            reason = (
                f"step {len(path) + 1} of {steps} was refused, the state before it is kept; "
                f"{refused}"
            )
            last = replace(path[-1], path=tuple(path), complete=False, reason=reason)
            refused.last_state = last

    @classmethod
    def lifted(
        cls,
        setup: ProbeSetup,
        pose: Floats,
        *,
        friction: float = 0.0,
        dissipated_nmm: float = 0.0,
    ) -> ContactState:
        """Return the state of a probe that touches nothing."""
        axes = setup.first.axes
        return cls(
            load=Load(probes=setup.placed(pose)),
            indentation_mm=0.0,
            move_mm=pose[: Z + 1] @ axes,
            turn_deg=math.degrees(pose[TURN]),
            turns_deg=np.degrees(pose[ABOUT_X:] @ axes),
            force_n=np.zeros(3),
            torque_nmm=0.0,
            torques_nmm=np.zeros(3),
            contact_radius_mm=0.0,
            area_mm2=0.0,
            peak_pressure_mpa=0.0,
            pressure_mpa=np.zeros(0),
            traction_mpa=np.zeros((0, 3)),
            slip=np.zeros(0, bool),
            residual=0.0,
            validity=_validity(setup, 0.0, 0.0, 0.0, 0.0, sheared=False),
            friction=friction,
            dissipated_nmm=dissipated_nmm,
        )

    @classmethod
    def touching(
        cls,
        setup: ProbeSetup,
        patches: Patches,
        equilibrium: Equilibrium,
        *,
        touch_z_mm: float,
        friction: float,
        dissipated_nmm: float = 0.0,
        slope: Floats | None = None,
    ) -> ContactState:
        """Return the state of a probe in contact.

        ``touch_z_mm`` is its z at first touch at its present place; ``slope`` (k, 6) that of its
        gaps, if it is known.
        """
        axes = setup.first.axes
        pose = equilibrium.pose
        active = np.flatnonzero(equilibrium.active)
        touches = len(active) > 0
        own_force = equilibrium.force_n[active]
        area = patches.area_mm2[active]
        force = np.einsum("kij,ki->kj", patches.frames[active], own_force)
        total = force.sum(axis=0)
        pressure = own_force[:, 2] / area
        push = float(own_force[:, 2].sum())
        # Without friction the patches' motion sideways isn't known, and no force acts along it.
        work = own_force * equilibrium.displacement_mm[active]
        elastic = 0.5 * float((work if friction > 0 else work[:, 2]).sum())
        contact = _contact_area(setup, patches, equilibrium, friction) if touches else 0.0
        radius = math.sqrt(contact / math.pi)
        depth = float(pose[Z]) - touch_z_mm
        sheared = False
        if friction > 0:
            x, y, z = axes @ total
            sheared = math.hypot(x, y) > SHEARED * abs(z)
        steepest = 0.0
        if touches and setup.face is None:
            if slope is None:
                _, slope = setup.first.gap(patches.centre_mm, patches.frames[:, 2], pose)
            # A probe that comes along e meets a surface of its normal n with slopes n / (e . n).
            squared = float(np.max(np.sum(slope[active][:, : Z + 1] ** 2, axis=1)))
            steepest = math.sqrt(min(max(1.0, squared), _GRAZED) - 1.0)
        own = np.concatenate((pose, equilibrium.total[ABOUT_X:])).reshape(3, 3) @ axes
        terms = (patches.rectangles(force, active),) if touches else ()
        return cls(
            load=Load(terms, probes=setup.placed(pose)),
            indentation_mm=depth,
            move_mm=own[0],
            turn_deg=math.degrees(pose[TURN]),
            turns_deg=np.degrees(own[1]),
            force_n=total,
            torque_nmm=float(equilibrium.total[TURN]),
            torques_nmm=own[2],
            contact_radius_mm=radius,
            area_mm2=contact,
            peak_pressure_mpa=float(pressure.max(initial=0.0)),
            pressure_mpa=pressure,
            traction_mpa=force / area[:, None],
            slip=equilibrium.slipping[active] if friction > 0 else np.ones(len(active), bool),
            residual=equilibrium.residual,
            validity=_validity(
                setup, radius, steepest, push / contact if contact else 0.0, depth, sheared=sheared
            ),
            friction=friction,
            elastic_nmm=elastic,
            dissipated_nmm=dissipated_nmm,
        )

    def _rows(self) -> dict[str, str]:
        slips = int(self.slip.sum())
        rows = {
            "force": vector(self.force_n, "N"),
            "indentation": f"{self.indentation_mm:.3g} mm",
            "contact radius": f"{self.contact_radius_mm:.3g} mm",
            "largest pressure": f"{self.peak_pressure_mpa:.3g} MPa",
            "patches": f"{len(self.slip)}" + (f", {slips} slip" if self.friction else ""),
        }
        return rows | ({} if self.complete else {"incomplete": self.reason})

    @property
    def patches(self) -> Rectangles | None:
        """The patches in contact under this probe, the rows of ``pressure_mpa``; None where nothing
        touches."""
        first = self.load.terms[0] if len(self.slip) else None
        return first if isinstance(first, Rectangles) else None

    @property
    def slips(self) -> Bools:
        """(m,) whether each patch under every probe slips, in the order of the load's terms."""
        return np.concatenate([one.slip for one in (self, *self.also)])

    @property
    def slip_share(self) -> float:
        """Share of the contact's area, under all probes, that slips: 0 sticks, 1 slides, what is
        between is incipient slip; 0 where nothing touches."""
        terms = [term for term in self.load.terms if isinstance(term, Rectangles)]
        areas = [one.half_mm.prod(axis=1) for one in terms]
        return float(np.average(self.slips, weights=np.concatenate(areas))) if areas else 0.0

    def columns(self) -> dict[str, np.ndarray]:
        """Return a row for every patch in contact: centre, mm, pressure and traction, MPa, and
        whether it slips."""
        centres = self.patches.centre_mm if self.patches is not None else np.zeros((0, 3))
        table = {f"{a}_mm": centres[:, i] for i, a in enumerate("xyz")}
        table["pressure_mpa"] = self.pressure_mpa
        table |= {f"t{a}_mpa": self.traction_mpa[:, i] for i, a in enumerate("xyz")}
        return table | {"slip": self.slip}

    def plot(self, ax: Any = None) -> Any:
        """Draw the pressures of the patches on matplotlib axes, and return these."""
        corners = self.patches.corner_mm if self.patches is not None else np.zeros((0, 4, 3))
        return plot_patches(new_axes(1, ax), corners, self.pressure_mpa, self.slip)

    @cached_property
    def error(self) -> PressError | None:
        """How far the numbers may be off, computed at the first look; None in ``also``, whose first
        state has it."""
        return self.estimate(self) if self.estimate is not None else None


def _validity(
    setup: ProbeSetup, radius: float, slope: float, pressure: float, depth: float, *, sheared: bool
) -> Validity:
    probe = setup.probe
    modulus = setup.youngs_modulus_mpa
    ratio = 2.0 * radius / probe.diameter_mm if isinstance(probe, Sphere) else None
    low, high = setup.body.bounds_mm
    thickness = high[2] - low[2]
    thin = depth / thickness
    strain = pressure / modulus
    law = law_of(probe.kind, radius / thickness, sheared=sheared)
    error = law.factor * strain
    notes: list[str] = []
    warnings: list[str] = []
    if ratio is not None and ratio > _RATIO_LIMIT:
        known = ratio <= KNOWN_RADIUS
        (notes if known else warnings).append(
            f"contact radius / probe radius = {ratio:.2f} > {_RATIO_LIMIT}: linear contact "
            "understates the indentation" + (", by some per cent" if known else "")
        )
    elif ratio is None and slope > _SLOPE_LIMIT:
        warnings.append(
            f"slope of the probe where it touches = {slope:.2f} > {_SLOPE_LIMIT}: linear contact "
            "takes it for small"
        )
    if thin > _DEPTH_LIMIT:
        warnings.append(
            f"indentation / thickness = {thin:.2f} > {_DEPTH_LIMIT}: the body is squeezed as a "
            "whole"
        )
    if error > ERROR_BOUND:
        cost = (
            f"linear theory may be {100 * error:.1f} % of the largest displacement off at the "
            f"markers (mean pressure / Young's modulus = {strain:.2f}; docs/validity.md)"
        )
        if strain <= law.known_strain:
            notes.append(cost)
        else:
            warnings.append(
                f"{cost}, by a law that is known up to {law.known_strain:g} only: press with less "
                "force"
            )
    return Validity(
        contact_over_probe_radius=ratio,
        steepest_slope=slope,
        mean_strain=strain,
        indentation_over_thickness=thin,
        linearisation_error=error,
        warnings=tuple(warnings),
        notes=tuple(notes),
    )
