"""From marker motion to the force field: `reconstruct`; and the motion of a bumped camera:
`Bump`.

Totals come from the linear solve, also where the field is held to pushes or to friction cones: sums
of such a field are biased. Differences go on past the edge of the grid, to sites without force:
those inside it don't see a force that is the same everywhere, which hardly moves a marker in
incompressible rubber. So the penalty is a proper prior. On the flat design (.04 px of noise, 5 mm
pillar in a corner) the push is 2.4 +- 2.1 % off with them, and 5.8 +- 2.0 % without.

Wrong vectors, the camera's bend, and markers that this picture weighs otherwise than the rest
picture correct the data, so that one factorisation serves a whole sequence.

**Wrong vectors.** If the part of a residual vector above a threshold is subtracted from the data,
the linear solution minimises Huber's loss (Robust Statistics, 1981, sec. 7.8). Vectors far out are
then left out. Valid up to a few per cent of wrong vectors spread over the picture.

**Local prior.** Forces are expected where a first solution has some. With a_k their size around
site k over the largest and A = diag(a_k), the penalty is F^T A^-1 Q A^-1 F, and a site with a_k
below `FAINTEST` has no force. The average over neighbours keeps a load together: without it the
method is FOCUSS (I. F. Gorodnitsky and B. D. Rao, IEEE Trans. Signal Process. 45 (1997) 600), which
concentrates a load in single sites. The weight is the most likely one. Where in a site's cell a
force acts isn't known, so markers next to a load are not believed to their noise (`WITHIN_CELL`).

**Bumped camera.** A shift of the camera adds the same two numbers to every marker: generalised
least squares under the smooth prior estimates them. A load much wider than the view has the same
effect. Turns and zooms of the camera are not estimated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from types import NoneType
from typing import Any, ClassVar, overload

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Bools, Floats, Points, frozen
from twin.blas_threads import one_blas_thread
from twin.display import (
    ForceTable,
    vector,
)
from twin.errors import InputError, require
from twin.parts.methods import Method, WeightRule
from twin.sense.calibration import Calibration
from twin.sense.inverse import METHODS, RULES, Factors, InverseMethod, Problem
from twin.sense.track import Found
from twin.theory.relaxation import Hereditary, Relaxation

_LEVERS = np.array([[0, 0, 0, 0, 1, 1], [0, 0, 0, 1, 0, 1], [0, 0, 0, 1, 1, 0]])
_DIRECT = np.array([1, 1, 1, 0, 0, 0])
"""What squared coordinates add to the squared lever arms of totals, and squares of these without:
a force counts as itself, in torques by its distance from the axis."""

MOST_EVEN = 2.0
"""Noise of the fit over the stated one, up to which it is taken for noise that all markers share.
Residuals beyond it are the model's error, and what they make of totals is found marker by marker:
on a dome they are 10 to 13 times the noise, but those of markers that tell the totals are not. A
weight that is given may be too large, so that all of the residual is taken for noise there."""

BY_BOUNDS = 3.0
"""Squared misfit by which bounded forces exceed the linear ones, in variances of the noise over the
numbers that these fit to it, up to which the bounds may hold: forces that obey them leave what the
linear ones fit of the noise. It is 0.4 to 3.1 where bounds hold (39 presses of two gel pads; 1.1 to
1.7 on rubber of Poisson's ratio 0, where only they show how much is pushed), 110 to 440 of loads
sideways by 0.8 of the push with a coefficient of 0.5. Beyond it the totals' way to the bounded ones
counts by the inverse ratio."""

UNSURE, SIDEWAYS = 0.05, 3.0
"""Stated deviation of the total along z, over its size and over the deviation along x, above which
one layer of markers is named as the cause."""

ONE_LAYER = (
    "one layer of dots hardly shows a push, as rubber that keeps its volume moves down under it "
    "more than sideways, and the camera sees sideways motion only; a second layer at another "
    "depth, or bounds, help (docs/one_layer.md)"
)

DECADE = 0.1
"""Under constraints an automatic weight is rounded to this in its logarithm, so that what was
solved serves again."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Field(ForceTable):
    """The reconstructed force field.

    Attributes
    ----------
    site_mm
        (k, 3) sites, mm.
    force_n
        (k, 3) force at every site, N, global axes; a push is +z.
    total_force_n, total_torque_nmm
        (3,) sum of the forces, and of their moments about the origin (positive about z from x to
        y); of the linear estimate.
    weight
        The papers' omega that was used, px^2/N^2; 0 for the pseudo-inverse.
    noise_px
        Noise of a shift's component as the fit has it, px: measurement and model error together.
    sd_force_n
        (k, 3) standard deviation of the linear estimate's forces, given the prior, N: forces as
        large as the motion shows, where a rule chose the weight. By ``local`` also by where in
        their cells they act (`Calibration.misplaced_px`); by ``smooth`` and ``norm`` of one layer
        also by how far a narrow load lies from them that explains the motion, too.
    sd_total_n, sd_torque_nmm
        (3,) standard deviations of the totals, N and N mm: by the noise, by what the calibration
        leaves open (`Calibration.scale_error`, `Calibration.read_error`,
        `Calibration.by_thickness`, `Calibration.by_depth`,
        `Calibration.by_camera`, `Calibration.by_load_cell`, `Calibration.mesh_error`; recorded
        places leave nothing), and by `Found.gain_error` and `Found.drift_px`. By ``local`` also by
        where forces are expected, and by the misfit of markers next to them
        (`Factors.misfit_variance`), as where residuals are far above the noise. Of one layer also
        by how far those of forces of one direction lie from them: by ``local`` into the surface,
        of forces that spread as those found; by the others of a narrow load. One layer hardly tells
        a wide weak load from a narrow strong one, and hardly sees an even pressure. Under bounds
        also by how far the bounded forces' totals lie from these, unless the motion contradicts the
        bounds (`BY_BOUNDS`).
    used
        (n,) which markers took part.
    wrong
        (n,) which of them were found to be wrong by the robust solve.
    method
        How it was solved.
    kkt
        Violation of the optimality conditions of a constrained solve, relative; 0 without
        constraints.
    """

    _title: ClassVar[str] = "Reconstructed force field"

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
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                frozen(value)

    def _rows(self) -> dict[str, str]:
        largest = float(np.abs(self.force_n[:, 2]).max(initial=0.0))
        return {
            "total force": vector(self.total_force_n, "N", self.sd_total_n),
            "sites": str(len(self.site_mm)),
            "largest along z": f"{largest:.3g} N",
            "markers used": str(int(self.used.sum())),
            "method": self.method,
        }

    def one_layer(self, layer: np.ndarray) -> str:
        """Return why the total along z is uncertain where that is since its markers, of which
        ``layer`` names the layers, are a single layer's; else nothing."""
        along, _, push = self.sd_total_n
        size = np.linalg.norm(self.total_force_n)
        if len(np.unique(layer)) != 1 or push <= max(UNSURE * size, SIDEWAYS * along):
            return ""
        return ONE_LAYER


@overload
def reconstruct(found: Found, calibration: Calibration, *args: Any, **options: Any) -> Field: ...


@overload
def reconstruct(
    found: list[Found] | tuple[Found, ...], calibration: Calibration, *args: Any, **options: Any
) -> list[Field]: ...


@one_blas_thread()
def reconstruct(
    found: Found | list[Found] | tuple[Found, ...],
    calibration: Calibration,
    method: Method = "smooth",
    weight: float | WeightRule = "auto",
    *,
    push_only: bool = False,
    friction: float | None = None,
    robust: bool = False,
    camera: bool = False,
    previous: Field | None = None,
    history: Hereditary | None = None,
    after_s: float = 0.0,
) -> Field | list[Field]:
    """Reconstruct the forces that moved the markers.

    Parameters
    ----------
    found
        Marker motion, in the calibration's marker order; lost markers are left out. Of a list, as
        of several fingers that one calibration serves, the fields are a list, too: those without
        bounds, robust solve, bend and ``local`` are found together, in a third of the time.
    calibration
        Sites and transfer matrix.
    method
        ``smooth``: small differences between neighbouring sites (flat paper, eq. 11); ``norm``:
        small forces (eq. 14); ``pinv``: plain pseudo-inverse, which diverges with noise; ``local``:
        as ``smooth``, with forces expected only where a first solution has some. Where loads cover
        a part of the surface it has better totals, at ten to twenty times the time.
    weight
        The papers' omega, px^2/N^2, or how to choose it: ``likelihood`` (marginal likelihood),
        ``gcv`` (robust generalised cross-validation), ``auto`` (the larger of twice the likely one
        and ``gcv``; for ``local`` marginal likelihood).
    push_only
        No site pulls: F_n >= 0 along the inward normal (eq. 13).
    friction
        Coulomb's coefficient mu: ``|F_t| <= mu F_n`` at every site, which holds F_n >= 0 as well.
        None for no bound.
    robust
        Leave wrong vectors out.
    camera
        Take the camera's bend into account: shifts are not linear in the forces where markers move
        far or the lens is wide. Needs a calibration with a compliance and a camera.
    previous
        The last frame's field, where a constrained solve starts. It changes the time of a solve,
        not its result.
    history
        Of rubber that relaxes: what it remembers of a sequence's fields before this one; it is
        updated. Before the first one make
        ``twin.theory.relaxation.Hereditary(calibration.relaxation)``. None where this field stands
        alone.
    after_s
        Time since the last field of ``history``, s; 0 for the first one.

    Raises
    ------
    InputError
        Motion and calibration don't belong together, fewer than 2 markers are left, or options
        don't go together.

    Notes
    -----
    With Q the method's matrix, F = (H^T H + (w/2) Q)^-1 H^T M (eqs. 12 and 15, corrected); under
    constraints the same objective is minimised (`twin.sense.constraints`). The camera's bend
    g(F) - H F is taken off the data and the solve repeated until nothing changes: Gauss-Newton with
    the derivative kept from the rest state.

    These are the forces of elastic rubber. Of rubber that relaxes they rise under a force that is
    held, and stay after the force has gone, so they are corrected at the end: with ``history`` by
    the convolution over the sequence, with deviations that grow by what happens between pictures
    (`Hereditary.off`); without it by what is known at an unknown time. Under a load that only rises
    or is held, forces lie between the elastic ones and the part of these that is left at last. The
    field is half-way between the two, and the ends are one more standard deviation away: a touch is
    mostly much shorter or much longer than the rubber's times. Bounds hold for the elastic forces.

    Examples
    --------
    Pictures of the simulated finger, read with a stored calibration:

    >>> import twin
    >>> from twin.files import SCENES
    >>> sensor = twin.Sensor(twin.load_scene("sato_press"))
    >>> rest, pressed = sensor.picture(None), sensor.picture(sensor.press().load)
    >>> calibration = twin.read_calibration(SCENES / "sato_calibration.npz")
    >>> field = twin.reconstruct(twin.track(rest, pressed, calibration.layout), calibration)
    >>> bool(0.8 < field.total_force_n[2] < 1.2)  # N; the press is 0.98 N
    True
    """
    several = isinstance(found, list | tuple)
    pictures: list[Found] = [*found] if isinstance(found, list | tuple) else [found]
    for one in pictures:
        require(one, Found, "the motion", "make it with twin.track")
    require(calibration, Calibration, "the calibration", "read one with twin.read_calibration")
    check_options(method, weight, push_only, friction, camera, calibration)
    new = "make one for a sequence by twin.theory.relaxation.Hereditary(calibration.relaxation)"
    require(history, (Hereditary, NoneType), "history", new)
    alone = history is None and calibration.relaxation is not None
    if several and (previous is not None or history is not None):
        raise InputError("previous and history are of one picture, not of a list: give them one")
    if not (isinstance(after_s, Real) and 0.0 <= after_s < np.inf) or (after_s and alone):
        raise InputError(
            f"after_s = {after_s!r}: allowed are finite numbers from 0, s, with a history: {new}"
        )
    problems = [Problem.of(one, calibration, method) for one in pictures]
    options = _Options(
        method=METHODS[method],
        weight=weight if METHODS[method].weighted else 0.0,
        push_only=push_only,
        friction=friction,
        robust=robust,
        camera=camera,
        start=None if previous is None else previous.force_n,
    )
    fields: dict[int, Field] = {}
    for numbers in _stacks(problems, options.stackable(calibration)):
        of_stack = [problems[number] for number in numbers]
        whole = of_stack[0] if len(numbers) == 1 else Problem.together(of_stack)
        solutions = _solutions([pictures[number] for number in numbers], whole, options)
        for number, solution in zip(numbers, solutions, strict=True):
            field = Field(
                site_mm=calibration.site_mm,
                used=problems[number].used.copy(),
                method=method,
                **solution,
            )
            if history is not None:
                field = _relaxed(field, history, after_s)
            elif calibration.relaxation is not None:
                field = _at_unknown_time(field, calibration.relaxation)
            fields[number] = field
    return [fields[number] for number in range(len(pictures))] if several else fields[0]


TOGETHER = 32
"""Pictures that are solved together at most: of more, each takes as long, and all more memory."""


def _stacks(problems: list[Problem], stackable: bool) -> Iterator[list[int]]:
    """Yield the numbers of problems that are solved together; where they aren't ``stackable``, of
    one after the other."""
    alike: dict[int | None, list[int]] = {}
    for number, problem in enumerate(problems):
        alike.setdefault(problem.stack if stackable else None, []).append(number)
    for stack, numbers in alike.items():
        most = 1 if stack is None else TOGETHER
        for first in range(0, len(numbers), most):
            yield numbers[first : first + most]


@dataclass(frozen=True, kw_only=True)
class _Options:
    """How `reconstruct` is to solve; ``start`` (k, 3) is a first guess under bounds, N."""

    method: InverseMethod
    weight: float | WeightRule
    push_only: bool
    friction: float | None
    robust: bool
    camera: bool
    start: Floats | None

    @property
    def bounded(self) -> bool:
        """Whether forces are held to pushes or to friction cones."""
        return self.push_only or self.friction is not None

    def stackable(self, calibration: Calibration) -> bool:
        """Return whether pictures are solved by products alone, which serve many at once."""
        turns = self.method.local or self.bounded or self.robust or self.camera
        return not turns and (len(calibration.layers) > 1 or not self.method.weighted)


def _solutions(found: list[Found], problem: Problem, options: _Options) -> list[dict[str, Any]]:
    """Return the fields of `Field` that motion gives, by their names, of every picture. The problem
    is that of one picture, or of a stack; then all numbers and arrays have the pictures' axis
    first."""
    calibration, local = problem.calibration, options.method.local
    one = len(found) == 1
    shift = found[0].shift_px if one else np.array([each.shift_px for each in found])
    whole = problem.whiten(shift)
    if local:
        linear, sd_force, moved = _solved_locally(problem, whole, options)
    else:
        linear = _solved(problem, whole, options)
        sd_force, moved = linear.sd_force_n, np.zeros(3)
    problem, force = linear.problem, linear.force_n
    rows = calibration.total_rows
    totals = linear.flat_n @ rows.T
    even = linear.scale
    if isinstance(options.weight, str):
        even = np.minimum(even, MOST_EVEN)
    sd_total = _sd_of_totals(found, linear, totals, even, moved, local=local)
    if len(calibration.layers) == 1 and options.method.weighted:
        unseen = _of_one_way(problem, linear, local=local) - force
        if local:  # sideways these see how much they carry
            inward = calibration.site_frames[:, 2]
            unseen = (unseen * inward).sum(axis=1, keepdims=True) * inward
        else:
            sd_force = np.hypot(sd_force, unseen)
        sd_total = np.hypot(sd_total, rows @ unseen.ravel())
    kkt = 0.0
    if options.bounded:
        at = float(linear.weight)
        if isinstance(options.weight, str):
            at = float(10.0 ** (DECADE * np.round(np.log10(at) / DECADE)))
        force, kkt = _held(linear, at, options)
        believed = linear.belief_in(force, options.camera)
        sd_total = np.hypot(sd_total, believed * (rows @ force.ravel() - totals))
    wrong = np.zeros((*shift.shape[:-2], len(problem.known)), np.bool_)
    wrong[..., problem.known] = linear.wrong
    weight, noise_px = problem.omega * linear.weight, linear.scale * (problem.omega / 2) ** 0.5

    def by_picture(values: Floats) -> list[Floats]:
        return [values] if one else list(values)

    return [
        {
            "force_n": force,
            "total_force_n": totals[:3],
            "total_torque_nmm": totals[3:],
            "weight": float(weight),
            "noise_px": float(noise_px),
            "sd_force_n": sd_force,
            "sd_total_n": sd_total[:3],
            "sd_torque_nmm": sd_total[3:],
            "wrong": wrong,
            "kkt": kkt,
        }
        for force, totals, sd_force, sd_total, wrong, weight, noise_px in zip(
            *map(by_picture, (force, totals, sd_force, sd_total, wrong)),
            np.ravel(weight),
            np.ravel(noise_px),
            strict=True,
        )
    ]


def _sd_of_totals(
    found: list[Found],
    linear: _Linear,
    totals: Floats,
    even: float | Floats,
    moved: Floats,
    *,
    local: bool,
) -> Floats:
    """Return the (6,) standard deviations of a linear solution's ``totals``, N and N mm, by all
    that `Field.sd_total_n` lists but bounds. ``even`` is the size of the noise that all markers
    share; ``moved`` (3,) how far the last turn of ``local`` moved the total force, N."""
    problem, weight = linear.problem, linear.weight
    calibration, factors = problem.calibration, problem.factors
    rows = calibration.total_rows
    variance = even**2 * factors.variance(weight, rows)
    if local:
        variance[:3] += moved**2
    worse = local | np.asarray(even < linear.scale)
    if worse.any():
        misfit = factors.misfit_variance(linear.data, weight, rows, even)
        variance += np.where(worse, misfit, 0.0)
    # torques about x and y are mostly made by forces along z
    x, y, z = calibration.read_error**2
    gain = np.array([one.gain_error for one in found])
    factor = calibration.scale_error**2 + (gain[:, None] if len(found) > 1 else gain) ** 2
    share = factor + np.array([x, y, z, z, z, x])
    variance += share * totals**2
    variance += linear.totals_left_open
    if any(np.any(one.drift_px) for one in found):
        drift = np.array([one.drift_px + np.zeros(one.shift_px.shape) for one in found])
        seen = problem.whiten(drift if len(found) > 1 else drift[0])
        variance += factors.sums(rows, seen, weight) ** 2
    return np.asarray(np.sqrt(variance))


def _relaxed(field: Field, history: Hereditary, seconds: float) -> Field:
    """Return an elastic field as that of rubber which remembers ``history``, and update it."""
    count = field.force_n.size
    parts = (field.force_n.ravel(), field.total_force_n, field.total_torque_nmm)
    forces = history.after(seconds, np.concatenate(parts))
    off = history.off
    return replace(
        field,
        force_n=forces[:count].reshape(-1, 3),
        total_force_n=forces[count:-3],
        total_torque_nmm=forces[-3:],
        sd_force_n=np.hypot(field.sd_force_n, off[:count].reshape(-1, 3)),
        sd_total_n=np.hypot(field.sd_total_n, off[count:-3]),
        sd_torque_nmm=np.hypot(field.sd_torque_nmm, off[-3:]),
    )


def _at_unknown_time(field: Field, relaxation: Relaxation) -> Field:
    """Return an elastic field as that of rubber which has relaxed by an unknown part."""
    open_part = float(relaxation.share.sum()) / 2
    share = 1.0 - open_part

    def spread(deviation: Floats, value: Floats) -> Floats:
        return np.hypot(share * deviation, open_part * value)

    return replace(
        field,
        force_n=share * field.force_n,
        total_force_n=share * field.total_force_n,
        total_torque_nmm=share * field.total_torque_nmm,
        sd_force_n=spread(field.sd_force_n, field.force_n),
        sd_total_n=spread(field.sd_total_n, field.total_force_n),
        sd_torque_nmm=spread(field.sd_torque_nmm, field.total_torque_nmm),
    )


def check_options(
    method: str,
    weight: float | WeightRule,
    push_only: bool,
    friction: float | None,
    camera: bool,
    calibration: Calibration,
) -> None:
    """Check the options of `reconstruct`.

    Raises
    ------
    InputError
        One is outside its range, or the calibration has not what it needs.
    """
    if method not in METHODS:
        raise InputError(f"method = {method!r}: allowed are {', '.join(map(repr, METHODS))}")
    require(weight, (Real, str), "weight", "a number of px^2/N^2, or 'auto', 'likelihood', 'gcv'")
    require(friction, (Real, NoneType), "friction", "a coefficient, or None for no bound")
    if isinstance(weight, str):
        if weight not in RULES:
            raise InputError(
                f"weight = {weight!r}: allowed are numbers, 'auto', 'likelihood' and 'gcv'"
            )
    elif not (np.isfinite(weight) and weight >= 0):
        raise InputError(f"weight = {weight} px^2/N^2: allowed are finite numbers >= 0, or 'auto'")
    if friction is not None and not (np.isfinite(friction) and 0 < friction <= 100):
        raise InputError(
            f"friction = {friction}: allowed are numbers above 0 and up to 100, or none for no "
            "bound"
        )
    if not METHODS[method].weighted and (push_only or friction is not None):
        raise InputError(
            f"method = {method!r} has no weight, so it can't be held to pushes or friction: "
            "use 'norm'"
        )
    if camera and not calibration.has_camera:
        raise InputError(
            f"camera: this calibration ({calibration.method}) holds no compliance and camera, "
            "only the linear map; use method compliance or fitted"
        )


def _held(linear: _Linear, weight: float, options: _Options) -> tuple[Floats, float]:
    """Return the (k, 3) forces held to pushes or friction cones, and how far from optimal they
    are."""
    problem, bend, start = linear.problem, linear.bend, options.start
    data = problem.factors.filled(linear.data, weight)
    for _ in range(MOST):
        force, kkt = problem.constrained(data, weight, options.friction, start)
        if not options.camera and not len(problem.factors.rows):
            break
        start, before = force, data
        bend = _bend_of(problem, force) if options.camera else bend
        seen = problem.shifts_of(force)
        data = problem.factors.towards(linear.whole - linear.off - bend, seen)
        if np.abs(data - before).max() < SETTLED:
            break
    return force, kkt


THRESHOLD = 4.0
"""Residual length, over its scale, beyond which the loss is linear and, in the end, a vector is
left out."""

RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two normal components, over their standard deviation."""


def _excess(
    residual: Floats, share: Floats, freedom: float, *, leave_out: bool
) -> tuple[Floats, Bools]:
    """Return what to take off the data, and which vectors it concerns.

    Parameters
    ----------
    residual
        (m,) whitened residuals of the data as measured.
    share
        (m,) information of the data over that by whitening, 0 for lost ones (see
        `twin.sense.inverse`).
    freedom
        Degrees of freedom of the residual over m: residuals are shorter than the noise by its root.
    leave_out
        Take off the whole residual of a wrong vector rather than what is beyond the threshold.

    Returns
    -------
    excess
        (m,) whitened.
    wrong
        (m/2,) vectors beyond the threshold.
    """
    vectors, known = residual.reshape(-1, 2), share[::2] > 0
    length = np.sqrt(share[::2] * (vectors**2).sum(axis=1))
    scale = np.median(length[known]) / RAYLEIGH_MEDIAN / np.sqrt(max(freedom, 0.05))
    limit = THRESHOLD * scale
    wrong = np.asarray(length > limit)
    beyond = np.where(wrong, 1.0 if leave_out else 1.0 - limit / np.where(wrong, length, 1.0), 0.0)
    return (beyond[:, None] * vectors).ravel(), wrong


SOFT, MOST = 6, 40
"""Iterations with Huber's loss before wrong vectors are left out, and iterations at most."""

SETTLED = 1e-4
"""Change of the whitened data that ends the iterations, in units of the noise."""


@dataclass(frozen=True, kw_only=True)
class _Linear:
    """A solution of ``problem`` without bounds, for a whitened weight. ``whole``, ``off`` and
    ``bend`` are (m,) whitened data, and what wrong vectors and the camera's bend add to them;
    ``data`` is what was solved for, without these; ``wrong`` (m/2,) the wrong vectors; ``likely``
    the most likely weight, or a given one."""

    problem: Problem
    whole: Floats
    off: Floats
    bend: Floats
    data: Floats
    weight: float | Floats
    likely: float | Floats
    wrong: Bools

    @cached_property
    def force_n(self) -> Floats:
        """(k, 3) forces, N."""
        return self.problem.factors.forces(self.data, self.weight)

    @cached_property
    def flat_n(self) -> Floats:
        """(3k,) forces, N."""
        return self.force_n.reshape(*self.data.shape[:-1], -1)

    @cached_property
    def scale(self) -> float | Floats:
        """Noise as the fit has it, over the stated one."""
        return self.problem.factors.noise_scale(self.data, self.weight)

    def belief_in(self, bounded: Floats, camera: bool) -> float:
        """Return the share of the totals' way to those of (k, 3) ``bounded`` forces, N, by which
        totals may be off: 1 where these explain the motion as well as forces can that obey the
        bounds."""
        problem, factors = self.problem, self.problem.factors
        bend = _bend_of(problem, bounded) if camera else self.bend
        fields = ((bounded, bend), (self.force_n, self.bend))
        worse, usual = (
            float(factors.share @ (self.whole - self.off - bend - problem.shifts_of(force)) ** 2)
            for force, bend in fields
        )
        fitted = len(self.whole) * (1.0 - factors.freedom(self.weight))
        expected = BY_BOUNDS * fitted * self.scale**2
        more = worse - usual
        return 1.0 if more <= expected else float(expected / more)

    @property
    def totals_left_open(self) -> Floats:
        """(6,) variances of totals, N^2 and N^2 mm^2: by `Calibration.by_thickness`,
        `Calibration.by_depth`, `Calibration.by_camera`, `Calibration.by_load_cell` and
        `Calibration.mesh_error`."""
        problem, known = self.problem, self.problem.calibration
        force, lead = self.force_n, self.data.shape[:-1]
        single = self.flat_n.astype(np.float32)
        lacking: list[NDArray[np.floating[Any]]] = []
        if known.by_thickness.size:
            lacking.append((single @ known.by_thickness.T).reshape(*lead, -1, 2))
        if known.by_depth.size:
            deeper = (single @ known.by_depth.T).reshape(*lead, -1, 2)
            lacking.extend(deeper * own for own in known.of_layers)
        if len(known.by_camera):
            motion = (single @ known.compliance.T).reshape(*lead, -1, 3, 1)
            lacking.extend((one @ motion)[..., 0] for one in known.by_camera)
        variance: Floats | float = 0.0
        if lacking:
            data = problem.whiten(np.array(lacking, np.float64))
            taken = problem.factors.sums(known.total_rows, data, self.weight)
            variance = (taken**2).sum(axis=0)
        squared = known.mesh_error**2 * (force.sum(axis=-2) ** 2).sum(axis=-1, keepdims=True)
        if known.by_load_cell.size:
            lacking_n = single @ known.by_load_cell.T
            squared = squared + (lacking_n**2).sum(axis=-1, keepdims=True)
        share = np.sqrt((force**2).sum(axis=-1))
        whole = np.maximum(share.sum(axis=-1, keepdims=True), np.finfo(float).tiny)
        middle = share @ known.site_mm / whole
        return np.asarray(variance + squared * (middle**2 @ _LEVERS + _DIRECT))

    @property
    def sd_force_n(self) -> Floats:
        """(k, 3) standard deviations given the prior at the likely weight, N."""
        variance = self.problem.factors.site_variance(self.weight, self.likely)
        return np.asarray(self.scale * np.sqrt(variance)).reshape(self.force_n.shape)


def _solved(problem: Problem, whole: Floats, options: _Options) -> _Linear:
    """Solve without bounds, for a weight in px^2/N^2 or by a rule."""
    factors, weight = problem.factors, options.weight
    robust, camera = options.robust, options.camera
    off = bend = np.zeros_like(whole)
    wrong: Bools = np.zeros((*whole.shape[:-1], whole.shape[-1] // 2), np.bool_)
    whitened = likely = 0.0 if isinstance(weight, str) else _over(float(weight), problem.omega)
    data = whole
    for count in range(MOST):
        before = off + bend
        if isinstance(weight, str) and count < 2 * SOFT:  # later it stays, so that this settles
            whitened, likely = factors.weights(weight, data)
        if not robust and not camera:
            break
        if camera:
            bend = _bend_of(problem, factors.forces(data, whitened))
        if robust:
            residual = whole - bend - factors.predicted(data, whitened)
            freedom = factors.freedom(whitened)
            off, wrong = _excess(residual, factors.share, freedom, leave_out=count >= SOFT)
        data = whole - off - bend
        if count > (SOFT if robust else 0) and np.abs(off + bend - before).max() < SETTLED:
            break
    return _Linear(
        problem=problem,
        whole=whole,
        off=off,
        bend=bend,
        data=data,
        weight=whitened,
        likely=likely,
        wrong=wrong,
    )


def _over(weight: float, omega: float | Floats) -> float | Floats:
    """Return a weight in px^2/N^2 as a whitened one; 0 is that of any picture."""
    return weight / omega if weight else 0.0


def _bend_of(problem: Problem, force: Floats) -> Floats:
    """Return (m,) whitened difference of the shifts through the camera to the linear ones."""
    return problem.whiten(problem.calibration.bend_px(force))


TURNS = 3
"""Solutions after the first: of one layer the first finds a quarter to a third of the force, the
next ones 0.75 to 0.86, 0.98 to 1.00 and 1.00 to 1.02 of it."""

AROUND = 1.0
"""Standard deviation of the average over neighbours, sites."""

FAINTEST = 0.03
"""Expected size of a force, over the largest, below which a site carries none: the smooth
solution's noise is about half of it. A press this much weaker than the strongest goes unseen, so it
is not raised for the sake of time."""


NARROWER = (4, 8, 16, 32)
"""Powers of the expected sizes in which a narrow load lies; the one that explains the motion best
is taken. On four pads of 2 to 6 mm with one layer (spheres of 4 to 8 mm) its push is about the true
one; of `smooth` it is -0.15 to 0.34."""


def _of_one_way(problem: Problem, linear: _Linear, *, local: bool) -> Floats:
    """Return (k, 3) forces, N, of one direction that explain the motion best: three numbers times a
    pattern. That is how large the solution's own are where these are ``local``, else a narrow load
    where they are largest.

    A solution's forces differ in direction from site to site, which one layer hardly tells from
    another size of them all.
    """
    found = linear.force_n
    if not found.any():
        return found
    if local:
        patterns = [np.linalg.norm(found, axis=1)]
    else:
        sizes = _expected_sizes(problem, found)
        patterns = [sizes**power for power in NARROWER]
    root = np.sqrt(problem.factors.share)
    least = np.inf
    for pattern in patterns:
        loads = np.kron(pattern[:, None], np.eye(3))
        moves = root[:, None] * (problem.base.transfer @ loads) / problem.size_px
        size = np.linalg.lstsq(moves, root * linear.data, rcond=None)[0]
        left = float(np.linalg.norm(root * linear.data - moves @ size))
        if left < least:
            least, found = left, (loads @ size).reshape(-1, 3)
    return np.asarray(found)


def _expected_sizes(problem: Problem, force_n: Floats) -> Floats:
    """Return (k,) sizes of forces around each site over the largest; ``force_n`` (k, 3) must not be
    zero everywhere."""
    from scipy.ndimage import gaussian_filter

    squared = gaussian_filter(
        ((force_n / np.abs(force_n).max()) ** 2).sum(axis=1).reshape(problem.calibration.grid),
        AROUND,
        mode="constant",
    ).ravel()
    return np.asarray(np.sqrt(squared / squared.max()))


def _localised(problem: Problem, force_n: Floats) -> Problem:
    """Return the problem with forces expected where ``force_n`` (k, 3) has some; it must not be
    zero everywhere."""
    size = _expected_sizes(problem, force_n)
    carries = np.repeat(size > FAINTEST, 3)
    scale = np.repeat(size, 3)[carries]
    whole = problem.base
    penalty = whole.penalty[np.ix_(carries, carries)] / np.outer(scale, scale)
    factors = Factors.of(whole.transfer[:, carries], penalty)
    everywhere = np.eye(len(carries))
    everywhere[np.ix_(carries, carries)] = penalty
    modes = factors.modes
    back, null = (np.zeros((len(carries), part.shape[1])) for part in (modes.back, modes.null))
    back[carries], null[carries] = modes.back, modes.null
    base = replace(
        whole,
        transfer=np.where(carries, whole.transfer, 0.0),
        penalty=everywhere,
        gram={},
        quadratics={},
    )
    factors = Factors(
        modes=replace(modes, back=back, null=null),
        size=problem.size_px,
        share=problem.factors.share,
    )
    return replace(problem, base=base, factors=factors)


WITHIN_CELL = 120**-0.5
"""Error of the response to a force between two sites that share it as a lever does, over the second
difference of the response from site to site: x (1 - x)/2, root mean square over places x."""


NARROW = 0.1
"""What a cell holds beyond its neighbours, over the largest, from which on it counts for the
deviations by place."""


def _with_model_error(problem: Problem, whole: Floats, force_n: Floats) -> tuple[Problem, Floats]:
    """Return the problem and its whitened data with the model error in the noise: where in a site's
    cell its part of ``force_n`` (k, 3) acts isn't known."""
    base = problem.base
    field = np.pad(force_n.reshape(*problem.calibration.grid, 3), ((1, 1), (1, 1), (0, 0)))
    along = np.diff(field, 2, axis=0)[:, 1:-1]
    across = np.diff(field, 2, axis=1)[1:-1]
    change = np.hypot(base.transfer @ along.ravel(), base.transfer @ across.ravel())
    off = WITHIN_CELL / problem.size_px * np.hypot(*change.reshape(-1, 2).T) / 2**0.5
    more = np.hypot(1.0, off)  # of a marker's own noise
    noise = more * problem.noise_px
    less = np.repeat(1.0 / more, 2)
    transfer = base.transfer * (less * float(noise.mean()) / problem.size_px)[:, None]
    base = replace(base, transfer=transfer, gram={}, quadratics={})
    return replace(problem, noise_px=noise, base=base), whole * less


def _solved_locally(
    problem: Problem, whole: Floats, options: _Options
) -> tuple[_Linear, Floats, Floats]:
    """Solve with forces expected where the smooth solution, then the local one, has some. Returns
    the solution; (k, 3) deviations, N; (3,) by how much the last turn moved its total, N."""
    found = smooth = _solved(problem, whole, replace(options, weight="auto"))
    if options.weight == "auto":
        options = replace(options, weight="likelihood")
    for _ in range(TURNS):
        if not found.force_n.any():
            return smooth, smooth.sd_force_n, np.zeros(3)
        before = found.force_n
        part, data = _with_model_error(problem, whole, before)
        found = _solved(_localised(part, before), data, options)
    moved = (found.force_n - before).sum(axis=0)
    carries = found.problem.factors.modes.back.any(axis=1).reshape(-1, 3)
    sd_force = np.hypot(found.sd_force_n, _sd_by_place(found))
    return found, np.where(carries, sd_force, smooth.sd_force_n), moved


def _sd_by_place(linear: _Linear) -> Floats:
    """Return (k, 3) deviations of forces, N, by where in their cells they act: of what cells hold
    beyond the mean of their neighbours."""
    problem, calibration = linear.problem, linear.problem.calibration
    field = np.pad(linear.force_n.reshape(*calibration.grid, 3), ((1, 1), (1, 1), (0, 0)))
    change = np.diff(field, 2, axis=0)[:, 1:-1] + np.diff(field, 2, axis=1)[1:-1]
    narrow = -change.reshape(-1, 3) / 4
    size = np.linalg.norm(narrow, axis=1)
    shifts = [
        calibration.misplaced_px(int(site), narrow[site]) / 2
        for site in np.flatnonzero(size > NARROW * size.max())
    ]
    variance = np.zeros_like(linear.force_n)
    for shift in (one for each in shifts for one in each if one.any()):
        variance += problem.factors.forces(problem.whiten(shift), linear.weight) ** 2
    return np.asarray(np.sqrt(variance))


LEAST_PX = 0.5
"""Bumps below this are not distinguished from forces."""

EXPLAINS = 6.0
"""A bump must be this many of its own standard deviations long."""


@dataclass(frozen=True, kw_only=True)
class Bump:
    """A shift of the whole picture.

    Attributes
    ----------
    shift_px
        (2,) what all markers share, px (column, row).
    sd_px
        Its standard deviation, px.
    """

    shift_px: Floats
    sd_px: float

    @classmethod
    def of(cls, found: Found, calibration: Calibration) -> Bump:
        """Estimate the shift that all markers share in addition to the forces.

        Raises
        ------
        InputError
            Motion and calibration don't belong together, or fewer than 2 markers are left.
        """
        problem = Problem.of(found, calibration, "smooth")
        data, factors = problem.whiten(found.shift_px), problem.factors
        shared = np.column_stack(
            [problem.whiten(np.tile(axis, (len(found.shift_px), 1))) for axis in np.eye(2)]
        )
        usual = np.median(found.shift_px[problem.used], axis=0)
        weight = factors.weight("auto", data - shared @ usual)
        left = shared - factors.predicted(shared.T, weight).T
        weighed = factors.share[:, None] * left
        normal = weighed.T @ shared
        estimate = np.asarray(np.linalg.solve(normal, weighed.T @ data), np.float64)
        scale = factors.noise_scale(data - shared @ estimate, weight)
        sd = float(scale) * float(np.sqrt(np.linalg.inv(normal).diagonal().max()))
        return cls(shift_px=estimate, sd_px=sd)

    @property
    def certain(self) -> bool:
        """Whether it is too long to be noise or forces."""
        length = float(np.hypot(*self.shift_px))
        return length > LEAST_PX and length > EXPLAINS * self.sd_px
