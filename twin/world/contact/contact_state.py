"""The result of a press: `ContactState`, with its estimated error and the range of linear theory.

The error has up to three parts:

**Body.** Where the surface would move by e more under the forces found (`displacement_errors` of a
compliance), the forces change by df and the probe's free motions by dq:

    C df - M dq = -e,    M^T df = 0 along each motion that is held by force

on the patches in contact, slipping ones along their drag; exact to first order.

**Patches.** The same press is solved on patches twice as wide (half as wide where there are few),
and compared. Under a smooth probe patches cut the contact's border by chance, so the difference may
vanish. Therefore an error that is proportional to the square of the width is added.

**Parts of a path** (friction). The same press is solved on these patches in half as many parts.

Validity: the body's own estimate, to first order. Under a sharp rim or tip the traction grows
without bound. Linear theory's own error is separate (`Validity`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Points, frozen
from twin.display import Table, html_table, new_axes, one_line, plot_patches, vector
from twin.errors import ContactError
from twin.parts.load import Load, Rectangles
from twin.parts.probe import Cone, Cylinder, Pillar, Sphere
from twin.theory import halfspace
from twin.theory.contact import ERROR_BOUND, KNOWN_RADIUS, SHEARED, law_of
from twin.world.contact.active_set import Equilibrium
from twin.world.contact.contact_search import (
    LoadProgramme,
    ProbeSetup,
    compliance_between,
)
from twin.world.contact.friction_law import effective_coefficient
from twin.world.contact.probe_gap import ABOUT_X, MOTIONS, TURN, Z
from twin.world.contact.surface_patches import Patches

_RAYS = 60
_ALONG = 240
_NEAR = 0.3
_FAR = 1.5
"""Rays from a contact's middle along which its end is sought, steps along each, and where over its
size."""

_EVEN = 1.0 + 1e-9
"""Pressures of patches that lie alike are equal up to this."""

_OWN = 1e-9
"""Least singular value of a fit over the largest: terms that others make up (patches in two rows)
are left out."""

_FEWEST = 12
_APART = 0.15
"""Patches from which on a fit is made, and how far it may be from their sum."""


_COUPLED = 0.1
"""(1 - 2 nu) / (2 (1 - nu)) from which on what sticks under a sphere bends the pressure as a cone
does: measured at 16 and 24 patches across, nu = 0.3: 0.3 % of the radius for 1.3 % low; nu = 0: 0.7
for 4. At nu = 0.45 nothing is gained."""


def _contact_area(
    setup: ProbeSetup, patches: Patches, equilibrium: Equilibrium, friction: float
) -> float:
    """Return the area of the contact, mm2.

    Notes
    -----
    Under any smooth probe the squared pressure vanishes linearly at the contact's border. Hertz's
    is a quadratic of the place everywhere, a cone's is near the border, with a fourth-order term,
    and so is a sphere's on compressible rubber that sticks to it (D. A. Spence 1968); where the fit
    vanishes, the contact ends. Validity: contacts near an ellipse, a sphere with a/R below about
    0.6 (0.3 % of the radius, a cone 0.5 %, at 16 patches across); the fit is dropped for the sum of
    the patches, which is 1 to 4 % off, where the two differ by more than 15 %, below 12 patches,
    and under any other probe.
    """
    nu = setup.poisson_ratio
    cone = isinstance(setup.probe, Cone)
    smooth = cone or isinstance(setup.probe, Sphere)
    bent = cone or (friction > 0.0 and 1.0 - 2.0 * nu > _COUPLED * 2.0 * (1.0 - nu))
    rows = np.flatnonzero(equilibrium.active)
    area = patches.area_mm2[rows]
    counted = float(area.sum())
    if not smooth or len(rows) < _FEWEST:
        return counted
    pressure = equilibrium.force_n[rows, 2] / area
    used = pressure <= _EVEN * np.median(pressure) if bent else np.ones(len(rows), bool)
    flat = float(4.0 * np.prod(patches.cell_mm[rows], axis=1).sum())
    fitted = area_under(patches.middle_mm[rows], pressure, used, fourth=bent) * counted / flat
    return fitted if abs(fitted / counted - 1.0) < _APART else counted


def area_under(place: Floats, pressure: Floats, used: Bools, *, fourth: bool) -> float:
    """Return the area of a contact from its pressures at some places, mm2.

    The squared pressures are fitted by least squares with a polynomial of 1, u, v, u^2, u v, v^2
    and, with ``fourth``, (u^2 + v^2)^2, where (u, v) is the place from the mean of all places. The
    contact ends where the polynomial first vanishes on a ray from there.

    Parameters
    ----------
    place
        (k, 2) mm in the plane of contact.
    pressure
        (k,) of any unit.
    used
        (k,) which pressures are fitted.
    fourth
        Whether the polynomial has the term of fourth order.

    Returns
    -------
    The area; inf where a ray has no end between 0.3 and 1.5 of the largest distance from the mean.
    """
    away = place - place.mean(axis=0)
    size = float(np.abs(away).max())
    u, v = away[used].T / size
    squared = u * u + v * v
    terms = np.column_stack(
        [np.ones(len(u)), u, v, u * u, u * v, v * v, squared**2 if fourth else 0.0 * u]
    )
    wanted = (pressure[used] / pressure.max()) ** 2
    found = np.linalg.lstsq(terms, wanted, rcond=_OWN)[0]
    angle = 2.0 * math.pi / _RAYS * np.arange(_RAYS)
    cosine = np.cos(angle)[:, None]
    sine = np.sin(angle)[:, None]
    radius = np.linspace(_NEAR, _FAR, _ALONG)
    first = found[1] * cosine + found[2] * sine
    second = found[3] * cosine**2 + found[4] * cosine * sine + found[5] * sine**2
    height = found[0] + radius * (first + radius * (second + radius**2 * found[6]))
    below = height < 0.0
    end = below.argmax(axis=1)
    if np.any(end == 0):  # a ray that never, or at once, lies below 0
        return math.inf
    rays = np.arange(_RAYS)
    here = height[rays, end]
    before = height[rays, end - 1]
    ends = radius[end] - (radius[1] - radius[0]) * here / (here - before)
    return math.pi * float(size**2 * np.mean(ends**2))


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


@dataclass(frozen=True, kw_only=True)
class Share:
    """Relative error of a press for one cause; inf where unknown.

    Attributes
    ----------
    force, indentation
        Of every probe's total force, and of its indentation; the largest.
    traction
        Root mean square error of the tractions over their root mean square.
    markers
        Largest error of the markers' displacement over the largest displacement; of the surface in
        contact where there are no markers.
    """

    force: float = 0.0
    indentation: float = 0.0
    traction: float = 0.0
    markers: float = 0.0

    @classmethod
    def unknown(cls) -> Share:
        """Return the share of a cause that couldn't be looked into."""
        return cls(force=math.inf, indentation=math.inf, traction=math.inf, markers=math.inf)

    def plus(self, other: Share) -> Share:
        """Return both together."""
        return Share(**{name: getattr(self, name) + getattr(other, name) for name in vars(Share())})

    def at_least(self, other: Share) -> Share:
        """Return the larger of both, each by itself."""
        return Share(
            **{name: max(getattr(self, name), getattr(other, name)) for name in vars(Share())}
        )

    def times(self, factor: float) -> Share:
        """Return this share so many times."""
        return Share(**{name: factor * getattr(self, name) for name in vars(Share())})


_NOTHING = Share()


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
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
        its x and y if there is no friction; global axes.
    contact_radius_mm
        Radius of the disc of the contact's area.
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

    def __repr__(self) -> str:
        return one_line("ContactState", [f"{k} {v}" for k, v in self._rows().items()])

    def _repr_html_(self) -> str:
        return html_table("Contact", self._rows())

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
    thin = depth / (high[2] - low[2])
    strain = pressure / modulus
    law = law_of(probe.kind, sheared=sheared)
    error = law.error(strain)
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


def touching_state(
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

    ``touch_z_mm`` is its z at first touch at its present place; ``slope`` (k, 6) that of its gaps,
    if it is known.
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
    return ContactState(
        load=Load((patches.rectangles(force, active),)) if touches else Load(),
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


def lifted_state(
    setup: ProbeSetup, pose: Floats, *, friction: float = 0.0, dissipated_nmm: float = 0.0
) -> ContactState:
    """Return the state of a probe that touches nothing."""
    axes = setup.first.axes
    return ContactState(
        load=Load(),
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


Solve = Callable[[LoadProgramme, int], tuple[list[ContactState], str]]
"""What takes a job's path in so many parts a step: returns the states, and why it stopped before
its end."""

_FEWEST_COMPARED = 6
"""Patches in contact from which on tractions are compared; patches across a contact at least."""

_MOST_RESPONDING = 600
"""Patches in contact from which on the response of the contact is computed on fewer: it takes time
that grows with their cube, and no part of the press's error is as small as what they leave."""

_WIDER = 0.5
_NARROWER = 1.5
"""Error over the change with patches twice, or half, as wide. Measured at 12 and 16 patches across
against 40, under flat faces with sharp rims: 0.46 on the standard block, 0.5 on pads 2 mm thick;
less under other probes."""

_ORDER = 1.8
_ALIKE = 1.3
"""Order of that law, and the least ratio of widths that tells anything."""

_CUT = 0.26
"""Error of a smooth probe's force at a given depth, times the square of the patches across.
Measured against 40 patches across: 0.0004 to 0.00105 at 16, for spheres of 3 to 20 mm radius and a
cone."""

_EDGE = 0.4
"""Error of the force under sharp edges that patches cut anywhere, over the patches' width in radii
of a disc of the contact's area. Measured: 0.1 to 0.25 under an annular punch, up to 0.33 under a
letter whose strokes lie along the grid."""

_CUT_RIM = 0.1
"""The same under a flat face so inclined that it touches with its rim, times the patches across.
Measured at 8 to 32 across, 25 and 30 degrees: 0.05 to 0.14."""

_WALLS = 0.12
"""Error of the force as patches end at the rim of an inclined flat face, whose side wall touches
too, over the square of the inclination. Measured under a pillar at 15 degrees: 0.09."""

_STIFFER = 1.5
"""How much faster a sphere's force grows than its indentation, relatively; a cone's 2."""

_FELT = 1e-9
"""Least pull, for each newton on a patch, by which a probe feels a motion."""


@dataclass(frozen=True, kw_only=True)
class Watched:
    """Points whose displacement's error is of interest, and a function that takes the estimates.

    Attributes
    ----------
    points
        (n, 3), mm; if there are none, those of the contact itself count.
    error
        Returns the estimated error of displacement there under a load, over the largest
        displacement.
    judge
        Called with every estimate.
    """

    points: Points
    error: Callable[[Load], float]
    judge: Callable[[PressError], None]


class Estimates:
    """The errors of the states of one path, computed on the first use of one.

    Parameters
    ----------
    programme, increments, solve
        How the path was taken.
    watched
        Points inside the body, and what is to be done with estimates; None for the contact alone.
    """

    def __init__(
        self, programme: LoadProgramme, increments: int, solve: Solve, watched: Watched | None
    ) -> None:
        self._job = programme
        self._increments = increments
        self._solve = solve
        self._watched = watched
        self._points = np.zeros((0, 3)) if watched is None else watched.points

    def of(self, state: ContactState, step: int) -> PressError:
        """Return the error of the state at the end of a step."""
        if not state.load.terms:
            return self._recovering(state, step)
        other = _state_of(self._other, step) if state.complete else None
        patches = increments = Share.unknown()
        if other is not None:
            change = self._change(state, other)
            factor = self._error_over_change(state, other)
            patches = self._cut(state, step, change.times(factor))
            patches = replace(
                patches, traction=change.traction
            )  # these converge with order 1/2 to 1 only
        if not self._job.friction.any() and self._job.relaxation is None:
            increments = Share()
        elif other is not None and (fewer := _state_of(self._fewer, step)) is not None:
            increments = self._change(other, fewer).times(1.0 if self._increments > 1 else 2.0)
        error = PressError.of(
            body=self._body(state, other, step), patches=patches, increments=increments
        )
        if self._watched is not None:
            known = error if state.complete else PressError.of(body=error.body)
            self._watched.judge(known)
        return error

    def judge_at_once(self, state: ContactState, step: int) -> None:
        """Judge a state by what its patches alone leave, which takes no other solve."""
        if self._watched is None or not state.load.terms:
            return
        patches = self._cut(state, step, Share())
        if any(0 < len(one.pressure_mpa) < _FEWEST_COMPARED for one in (state, *state.also)):
            patches = replace(patches, traction=1.0)
        self._watched.judge(PressError.of(patches=patches))

    def _recovering(self, state: ContactState, step: int) -> PressError:
        """Return the error where no probe touches: of the motion that relaxing rubber still has."""
        body = patches = increments = Share()
        if state.load.moving.terms and self._watched is not None:
            other = _state_of(self._other, step)
            fewer = _state_of(self._fewer, step)
            body = Share(markers=self._watched.error(state.load))
            if other is None or fewer is None:
                patches = Share.unknown()
            else:
                moved, coarse, slow = (self._half_space(s.load) for s in (state, other, fewer))
                patches = Share(markers=_over(coarse - moved, moved))
                increments = Share(markers=_over(slow - coarse, moved))
        error = PressError.of(body=body, patches=patches, increments=increments)
        if self._watched is not None:
            self._watched.judge(error)
        return error

    @cached_property
    def _other_across(self) -> int:
        across = self._job.setups[0].across
        return across // 2 if across // 2 >= _FEWEST_COMPARED else 2 * across

    def _error_over_change(self, state: ContactState, other: ContactState) -> float:
        """Return the error over the change with the other patches: twice or half as wide, but
        under objects, whose largest number of patches may end both alike.

        A power law goes through what is known of twice and half the width. Under objects it is the
        less steep, down to first order, the sharper their edges are.
        """
        free = [one.is_free_form for one in self._job.setups]
        wider = 2.0 if self._other_across < self._job.setups[0].across else 0.5
        sharp = 0.0
        if any(free):
            wider = _patch_mm(other) / _patch_mm(state)
            parts = zip(free, (state, *state.also), strict=True)
            sharp = max(_sharpness(one) for own, one in parts if own and len(one.pressure_mpa))
        ratio = max(wider, 1.0 / wider, _ALIKE)
        known = _NARROWER if wider < 1.0 else _WIDER
        smooth = known * (2.0**_ORDER - 1.0) / (ratio**_ORDER - 1.0)
        first = (ratio if wider < 1.0 else 1.0) / (ratio - 1.0)
        return float(smooth + sharp * max(first - smooth, 0.0))

    @cached_property
    def _other(self) -> list[ContactState]:
        """The states on other patches."""
        return self._on_other_patches(self._increments)

    @cached_property
    def _fewer(self) -> list[ContactState]:
        """The same in half as many parts; in twice as many where there is one only."""
        return self._on_other_patches(self._increments // 2 if self._increments > 1 else 2)

    @cached_property
    def _few(self) -> list[ContactState]:
        """The states on as few patches as can be compared."""
        return self._on_other_patches(self._increments, _FEWEST_COMPARED)

    def _on_other_patches(self, increments: int, across: int = 0) -> list[ContactState]:
        across = across or self._other_across
        others = tuple(replace(one, across=across) for one in self._job.setups)
        try:
            return self._solve(replace(self._job, setups=others), increments)[0]
        except ContactError:
            return []

    def _change(self, one: ContactState, other: ContactState) -> Share:
        """Return what changes from one state to another, over what it is in the first."""
        pairs = list(zip((one, *one.also), (other, *other.also), strict=True))
        moved = self._half_space(one.load)
        return Share(
            force=max(_over(b.force_n - a.force_n, a.force_n) for a, b in pairs),
            indentation=max(
                _over(b.indentation_mm - a.indentation_mm, a.indentation_mm) for a, b in pairs
            ),
            traction=max(_traction_change(a, b) for a, b in pairs),
            markers=_over(self._half_space(other.load) - moved, moved),
        )

    def _cut(self, state: ContactState, step: int, changed: Share) -> Share:
        """Return what patches leave: what other patches change, and where they cut the borders of
        contacts, which may change nothing by chance."""
        smooth = any(isinstance(setup.probe, Sphere | Cone) for setup in self._job.setups)
        across = self._job.setups[0].across
        error = _CUT / across**2 if smooth else 0.0
        for setup in self._job.setups:
            if isinstance(setup.probe, Cylinder | Pillar) and any(setup.first.tilt_deg[:2]):
                incline = math.acos(min(1.0, float(setup.first.tilt[2, 2])))
                rim = _CUT_RIM / across if setup.face is None else _WALLS * math.tan(incline) ** 2
                error = max(error, rim)
        by_force = self._job.steps[step].by_force[Z::MOTIONS].all()
        cut = Share(indentation=error / _STIFFER) if by_force else Share(force=error, markers=error)
        edges = [
            _edge_error(one)
            for setup, one in zip(self._job.setups, (state, *state.also), strict=True)
            if setup.is_free_form and len(one.pressure_mpa)
        ]
        edge = max(edges, default=0.0)
        least = Share(indentation=edge) if by_force else Share(force=edge, markers=edge)
        return changed.plus(cut).at_least(least)

    def _half_space(self, load: Load) -> Points:
        """Return (n, 3) how far a load moves the watched points of a half-space of E = 1 MPa,
        mm."""
        moved = np.zeros_like(self._points)
        for term in load.moving.terms:
            assert isinstance(term, Rectangles)
            moved += halfspace.displacement(
                self._points, term, 1.0, self._job.setups[0].poisson_ratio
            )
        return moved

    def _body(self, state: ContactState, other: ContactState | None, step: int) -> Share:
        """Return the error of the body's mesh or table, by the contact's response on few patches
        if it can."""
        errors_of = getattr(self._job.setups[0].compliance, "displacement_errors", None)
        if errors_of is None:  # a closed form has no mesh
            return Share()
        used = other if other is not None and _alike(state, other) else state
        if _count(used) > _MOST_RESPONDING and state.complete:
            few = _state_of(self._few, step)
            used = few if few is not None and _alike(state, few) else used
        patches = _joined(used.load)
        moved, errors = errors_of(patches.centre_mm, _joined(state.load))
        response = _Response(self._job, step, used, patches)
        found = [response.to(part) for part in errors]
        probes = [one for one in (state, *state.also) if len(one.pressure_mpa)]
        markers = sum(_over(part, moved) for part in errors)
        if len(self._points) and self._watched is not None:
            markers = self._watched.error(state.load)
            markers += sum(
                _over(self._half_space(Load((load,))), self._half_space(used.load))
                for load, _ in found
            )
        return Share(
            force=max(
                sum(_over(response.total(load)[number], probe.force_n) for load, _ in found)
                for number, probe in enumerate(probes)
            ),
            indentation=max(
                sum(_over(motion[number, Z], probe.indentation_mm) for _, motion in found)
                for number, probe in enumerate(probes)
            ),
            traction=sum(_rms_traction(load) for load, _ in found) / _rms_traction(patches),
            markers=markers,
        )


class _Response:
    """How the contact of a state responds to motions of the surface, to first order.

    Parameters
    ----------
    programme, step
        What holds the probes.
    state, patches
        The n patches in contact, of all probes that touch.
    """

    def __init__(
        self, programme: LoadProgramme, step: int, state: ContactState, patches: Rectangles
    ) -> None:
        self._patches = patches
        touching = [(n, one) for n, one in enumerate((state, *state.also)) if len(one.pressure_mpa)]
        self._ends = np.cumsum([0, *(len(one.pressure_mpa) for _, one in touching)])
        n = len(patches)
        probes = len(touching)
        contact_jacobian = np.zeros((n, 3, MOTIONS * probes))
        by_force = np.zeros(MOTIONS * probes, bool)
        friction = np.zeros(n)
        for pose, (number, one) in enumerate(touching):
            rows = slice(*self._ends[pose : pose + 2])
            own = slice(MOTIONS * pose, MOTIONS * (pose + 1))
            first = programme.setups[number].first
            aside = one.move_mm - (one.move_mm @ first.axes[Z]) * first.axes[Z]
            contact_jacobian[rows, :, own] = first.jacobian(
                patches.centre_mm[rows], patches.frames[rows], aside
            )
            by_force[own] = programme.steps[step].by_force[
                MOTIONS * number : MOTIONS * (number + 1)
            ]
            friction[rows] = one.friction
        slips = np.concatenate([one.slip for _, one in touching])
        slips &= np.isfinite(effective_coefficient(friction))
        own_force = np.einsum("kij,kj->ki", patches.frames, patches.force_n)
        # a patch that sticks has three unknowns, one that slips a push that brings its drag along
        along = own_force / np.maximum(own_force[:, 2:], 1e-300) * slips[:, None]
        unknown = np.concatenate([np.flatnonzero(~slips)] * 3 + [np.flatnonzero(slips)])
        axis = np.concatenate(
            [np.full(int((~slips).sum()), a) for a in range(3)] + [np.full(int(slips.sum()), 2)]
        )
        self._force = np.zeros((n, 3, len(unknown)))
        self._force[unknown, axis, np.arange(len(unknown))] = 1.0
        slipping = np.arange(len(unknown)) >= 3 * int((~slips).sum())
        self._force[unknown[slipping], :2, np.flatnonzero(slipping)] = along[slips, :2]
        self._unknown = unknown
        self._axis = axis
        loads = [term for term in state.load.terms if isinstance(term, Rectangles)]
        compliance = compliance_between(programme.setups[0].compliance, loads, patches.frames)
        felt = np.abs(contact_jacobian[unknown, axis]).max(axis=0) > _FELT
        self._free = np.flatnonzero(by_force & felt)
        count = len(unknown)
        free = self._free
        matrix = np.zeros((count + len(free), count + len(free)))
        rows = compliance.reshape(n, 3, 3 * n)[unknown, axis]
        matrix[:count, :count] = rows @ self._force.reshape(3 * n, count)
        matrix[:count, count:] = -contact_jacobian[unknown, axis][:, free]
        matrix[count:, :count] = contact_jacobian.reshape(3 * n, -1)[
            :, free
        ].T @ self._force.reshape(3 * n, count)
        self._matrix = matrix
        self._count = count
        self._motions = MOTIONS * probes

    def to(self, moved: Floats) -> tuple[Rectangles, Floats]:
        """Return the change of the load, and the probes' motions (p, 6), as the surface moves by
        (n, 3) more, mm."""
        own = np.einsum("kij,kj->ki", self._patches.frames, moved)
        right = np.zeros(len(self._matrix))
        right[: self._count] = -own[self._unknown, self._axis]
        scale = np.sqrt(np.abs(np.diag(self._matrix)[: self._count]).mean())
        scales = np.concatenate(
            [np.full(self._count, 1.0 / scale), np.full(len(self._free), scale)]
        )
        scaled = self._matrix * scales[:, None] * scales
        found = scales * np.linalg.lstsq(scaled, scales * right, rcond=1e-12)[0]
        force = self._force @ found[: self._count]
        motion = np.zeros(self._motions)
        motion[self._free] = found[self._count :]
        change = np.einsum("kij,ki->kj", self._patches.frames, force)
        return replace(self._patches, force_n=change), motion.reshape(-1, MOTIONS)

    def total(self, load: Rectangles) -> Floats:
        """Return (p, 3) the forces of the probes that touch, N."""
        return np.add.reduceat(load.force_n, self._ends[:-1], axis=0)


def _state_of(states: list[ContactState], step: int) -> ContactState | None:
    return states[step] if step < len(states) else None


def _patch_mm(state: ContactState) -> float:
    """Return the root mean square side of the patches in contact, mm."""
    return math.sqrt(state.area_mm2 / max(1, len(state.pressure_mpa)))


def _edge_error(state: ContactState) -> float:
    """Return the error of the force as patches cut sharp edges, where pressure doesn't vanish."""
    side = 2.0 * _joined(Load(state.load.terms[:1])).half_mm.mean(axis=0).max()
    return float(_EDGE * _sharpness(state) * side / math.sqrt(state.area_mm2 / math.pi))


def _sharpness(state: ContactState) -> float:
    """Return how sharp the edges of a contact are by its pressure there: 0 where that vanishes, 1
    where it is no less than elsewhere."""
    from scipy.spatial import cKDTree

    load = _joined(Load(state.load.terms[:1]))
    flat = _flattened(load, load) / (2.0 * load.half_mm.mean(axis=0).max())
    inner = np.array([len(near) for near in cKDTree(flat).query_ball_point(flat, 1.1)]) == 5
    if inner.all():
        return 0.0
    return min(1.0, float(state.pressure_mpa[~inner].mean() / state.pressure_mpa.mean()) ** 4)


def _count(state: ContactState) -> int:
    """Return the patches in contact under all probes."""
    return sum(len(one.pressure_mpa) for one in (state, *state.also))


def _alike(one: ContactState, other: ContactState) -> bool:
    """Return whether the same probes touch."""
    pairs = zip((one, *one.also), (other, *other.also), strict=True)
    return all(bool(len(a.pressure_mpa)) == bool(len(b.pressure_mpa)) for a, b in pairs)


def _joined(load: Load) -> Rectangles:
    return Rectangles.joined([term for term in load.terms if isinstance(term, Rectangles)])


def _over(change: Floats | float, whole: Floats | float) -> float:
    """Return the largest length of changes (n, 3), or of one, over the largest of what changes; 0
    of nothing."""
    most = float(np.linalg.norm(np.atleast_2d(change), axis=1).max(initial=0.0))
    return most / (float(np.linalg.norm(np.atleast_2d(whole), axis=1).max(initial=0.0)) or 1.0)


def _rms_traction(load: Rectangles) -> float:
    """Return the root mean square traction of patches, weighted with their areas, MPa."""
    area = 4.0 * np.prod(load.half_mm, axis=1)
    return float(np.sqrt(np.sum(np.sum(load.force_n**2, axis=1) / area) / area.sum()))


def _traction_change(fine: ContactState, coarse: ContactState) -> float:
    """Return the RMS change of the tractions over their RMS, the coarse ones interpolated to the
    finer patches."""
    from scipy.spatial import Delaunay

    if min(len(fine.traction_mpa), len(coarse.traction_mpa)) < _FEWEST_COMPARED:
        return 1.0
    one = fine.load.terms[0]
    other = coarse.load.terms[0]
    assert isinstance(one, Rectangles)
    assert isinstance(other, Rectangles)
    here = _flattened(one, one)
    there = _flattened(other, one)
    triangles = Delaunay(there)
    inside = triangles.find_simplex(here)
    known = inside >= 0
    to_shares = triangles.transform[inside]
    shares = np.einsum("nij,nj->ni", to_shares[:, :2], here - to_shares[:, 2])
    shares = np.column_stack([shares, 1.0 - shares.sum(axis=1)])
    corners = coarse.traction_mpa[triangles.simplices[inside]]
    expected = np.einsum("ni,nij->nj", shares, corners)
    weight = np.prod(one.half_mm, axis=1)[known, None]
    changed = float(np.sum(weight * (expected[known] - fine.traction_mpa[known]) ** 2))
    return (
        float(np.sqrt(changed / np.sum(weight * fine.traction_mpa[known] ** 2)))
        if known.any()
        else 1.0
    )


def _flattened(rectangles: Rectangles, reference: Rectangles) -> Floats:
    """Return (k, 2) centres in the plane that the reference's centres lie nearest to."""
    middle = reference.centre_mm.mean(axis=0)
    _, _, axes = np.linalg.svd(reference.centre_mm - middle, full_matrices=False)
    return np.asarray((rectangles.centre_mm - middle) @ axes[:2].T)
