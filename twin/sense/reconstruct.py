"""From marker motion to the force field: `reconstruct`.

Why the totals come from the linear solve, also where the field is held to pushes or to friction cones: sums of such a
field are biased, those of the linear estimate hardly are. Why the differences go on past the edge of the grid, to sites
without force: those inside it don't see a force that is the same everywhere, and as that hardly moves a marker in
incompressible rubber, nothing else would hold it. With them the penalty is a proper prior. Measured on the flat design
(636 markers, 15 x 12 sites, .04 px noise, 12 exposures, 5 mm pillar, mean and standard deviation of the total push's
error): centre -1.0 +- 1.6 % (differences inside only: -1.2 +- 1.8 %), corner 2.4 +- 2.1 % (5.8 +- 2.0 %).

Wrong vectors, the camera's bend, and markers that this picture weighs otherwise than the rest picture all come in as
corrections of the data, so that one factorisation serves a whole sequence.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from types import NoneType
from typing import get_args

import numpy as np

from twin.arrays import Bools, Floats, Points, frozen
from twin.errors import InputError, require
from twin.parts.methods import Method
from twin.sense.calibration import Calibration
from twin.sense.linear import MOST, SETTLED, Linear, bend_of, solved
from twin.sense.local import solved_locally
from twin.sense.problem import Problem, problem_of
from twin.sense.track import Found
from twin.sense.weigh import RULES, Rule

DECADE = 0.1
"""Under constraints an automatic weight is rounded to this in its logarithm, so that what was solved serves again."""


@dataclass(frozen=True, kw_only=True)
class Field:
    """The reconstructed force field.

    Attributes
    ----------
    site_mm
        (k, 3) sites, mm.
    force_n
        (k, 3) force at every site, N, global axes; a push is +z.
    total_force_n, total_torque_nmm
        (3,) sum of the forces, and of their moments about the origin (positive about z from x to y); of the linear
        estimate.
    weight
        The papers' omega that was used, px^2/N^2; 0 for the pseudo-inverse.
    noise_px
        Noise of a shift's component as the fit has it, px: measurement and model error together.
    sd_force_n
        (k, 3) standard deviation of the linear estimate's forces, given the prior, N.
    sd_total_n, sd_torque_nmm
        (3,) standard deviations of the totals, N and N mm.
    used
        (n,) which markers took part.
    wrong
        (n,) which of them were found to be wrong by the robust solve.
    method
        How it was solved.
    kkt
        Violation of the optimality conditions of a constrained solve, relative; 0 without constraints.
    """

    site_mm: Points
    force_n: Floats
    total_force_n: Floats
    total_torque_nmm: Floats
    weight: float
    noise_px: float
    sd_force_n: Floats
    sd_total_n: Floats
    sd_torque_nmm: Floats
    used: Bools
    wrong: Bools
    method: str
    kkt: float = 0.0

    def __post_init__(self) -> None:
        for array in (self.force_n, self.total_force_n, self.total_torque_nmm, self.sd_force_n, self.sd_total_n,
                      self.sd_torque_nmm, self.used, self.wrong):  # fmt: skip
            frozen(array)


def reconstruct(
    found: Found,
    calibration: Calibration,
    method: Method = "smooth",
    weight: float | Rule = "auto",
    *,
    push_only: bool = False,
    friction: float | None = None,
    robust: bool = False,
    camera: bool = False,
    previous: Field | None = None,
) -> Field:
    """Reconstruct the forces that moved the markers.

    Parameters
    ----------
    found
        Marker motion, in the calibration's marker order; lost markers are left out.
    calibration
        Sites and transfer matrix.
    method
        ``smooth``: small differences between neighbouring sites (flat paper, eq. 11, in two dimensions and per
        component); ``norm``: small forces (eq. 14); ``pinv``: plain pseudo-inverse, which diverges with noise;
        ``local``: as ``smooth``, with forces expected only where a first solution has some (`twin.sense.local`).
        Where loads cover a part of the surface it is sharper and has better totals, at ten to twenty times the time.
    weight
        The papers' omega, px^2/N^2, or how to choose it: ``likelihood`` (marginal likelihood), ``gcv`` (robust
        generalised cross-validation), ``auto`` (see `weigh.automatic_weight`; for ``local`` marginal likelihood).
    push_only
        No site pulls: F_n >= 0 along the inward normal (eq. 13).
    friction
        Coulomb's coefficient mu: ``|F_t| <= mu F_n`` at every site, which holds F_n >= 0 as well. None for no bound.
    robust
        Leave wrong vectors out, see `twin.sense.robust`.
    camera
        Take the camera's bend into account: shifts are not linear in the forces where markers move far or the lens is
        wide. Needs a calibration with a compliance and a camera.
    previous
        The last frame's field under the same options: its weight is used again where ``weight`` names a rule (not by
        ``local``), and its contact is where a constrained solve starts.

    Raises
    ------
    InputError
        Motion and calibration don't belong together, fewer than 2 markers are left, or options don't go together.

    Notes
    -----
    With Q the method's matrix, F = (H^T H + (w/2) Q)^-1 H^T M (eqs. 12 and 15, corrected); under constraints the same
    objective is minimised (`twin.sense.cone`). The camera's bend g(F) - H F is taken off the data and the solve
    repeated until nothing changes: Gauss-Newton with the derivative kept from the rest state.
    """
    require(found, Found, "the motion", "make it with twin.track")
    require(calibration, Calibration, "the calibration", "read one with twin.read_calibration")
    check_options(method, weight, push_only, friction, camera, calibration)
    problem = problem_of(found, calibration, "smooth" if method == "local" else method)
    rule = weight
    if previous is not None and isinstance(weight, str) and method != "local":
        rule = previous.weight
    whole = problem.whiten(found.shift_px)
    if method == "local":
        linear, sd_force = solved_locally(problem, whole, rule, robust=robust, camera=camera)
    else:
        linear = solved(problem, whole, 0.0 if method == "pinv" else rule, robust=robust, camera=camera)
        sd_force = linear.sd_force_n
    problem, force = linear.problem, linear.force_n
    totals = calibration.total_rows @ force.ravel()
    sd_total = linear.scale * np.sqrt(np.diag(problem.reweighed.covariance(linear.weight, calibration.total_rows)))
    kkt = 0.0
    if push_only or friction is not None:
        at = linear.weight if not isinstance(rule, str) else _rounded(linear.weight)
        force, kkt = _held(linear, at, friction, camera, None if previous is None else previous.force_n)
    everywhere = np.zeros(len(problem.used), np.bool_)
    everywhere[problem.known] = linear.wrong
    return Field(
        site_mm=calibration.site_mm, force_n=force, total_force_n=totals[:3], total_torque_nmm=totals[3:],
        weight=problem.omega * linear.weight, noise_px=linear.scale * (problem.omega / 2) ** 0.5,
        sd_force_n=sd_force, sd_total_n=sd_total[:3], sd_torque_nmm=sd_total[3:],
        used=problem.used.copy(), wrong=everywhere, method=method, kkt=kkt,
    )  # fmt: skip


def check_options(
    method: str, weight: float | str, push_only: bool, friction: float | None, camera: bool, calibration: Calibration
) -> None:
    """Check the options of `reconstruct`.

    Raises
    ------
    InputError
        One is outside its range, or the calibration has not what it needs.
    """
    if method not in get_args(Method):
        raise InputError(f"method = {method!r}: allowed are {', '.join(map(repr, get_args(Method)))}")
    require(weight, (Real, str), "weight", "a number of px^2/N^2, or 'auto', 'likelihood', 'gcv'")
    require(friction, (Real, NoneType), "friction", "a coefficient, or None for no bound")
    if isinstance(weight, str):
        if weight not in RULES:
            raise InputError(f"weight = {weight!r}: allowed are numbers, 'auto', 'likelihood' and 'gcv'")
    elif not (np.isfinite(weight) and weight >= 0):
        raise InputError(f"weight = {weight} px^2/N^2: allowed are finite numbers >= 0, or 'auto'")
    if friction is not None and not (np.isfinite(friction) and 0 < friction <= 100):
        raise InputError(f"friction = {friction}: allowed are numbers above 0 and up to 100, or none for no bound")
    if method == "pinv" and (push_only or friction is not None):
        raise InputError("method = 'pinv' has no weight, so it can't be held to pushes or friction: use 'norm'")
    if camera and not calibration.has_camera:
        raise InputError(
            f"camera: this calibration ({calibration.method}) holds no compliance and camera, only the linear map; use "
            "method compliance or fitted"
        )


def _held(
    linear: Linear, weight: float, friction: float | None, camera: bool, start: Floats | None
) -> tuple[Floats, float]:
    """Return the (k, 3) forces held to pushes or friction cones, and how far from optimal they are."""
    problem, bend = linear.problem, linear.bend
    told = problem.reweighed.filled(linear.data, weight)
    for _ in range(MOST):
        force, kkt = _constrained(problem, told, weight, friction, start)
        if not camera and not len(problem.reweighed.rows):
            break
        start, before = force, told
        bend = bend_of(problem, force) if camera else bend
        told = problem.reweighed.towards(linear.whole - linear.off - bend, problem.shifts_of(force))
        if np.abs(told - before).max() < SETTLED:
            break
    return force, kkt


def _rounded(weight: float) -> float:
    return float(10.0 ** (DECADE * np.round(np.log10(weight) / DECADE)))


def _constrained(
    problem: Problem, data: Floats, weight: float, friction: float | None, start: Floats | None
) -> tuple[Floats, float]:
    """Return (k, 3) forces held to pushes or to friction cones, N, and the violation of the optimality conditions."""
    quadratic, linear = problem.quadratic(weight), problem.linear_term(data)
    begin = None if start is None else np.einsum("kij,kj->ki", problem.calibration.site_frames, start)
    if friction is None:
        local, _, kkt = quadratic.pushes(linear, None if begin is None else begin[:, 2] > 0)
    else:
        local, kkt = quadratic.cone(linear, friction, begin)
    return problem.globally(local), kkt
