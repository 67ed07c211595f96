"""The fitted twin: physical parameters of a design, fitted to a few presses and the rest picture.

The unknowns are a handful of numbers that a maker doesn't control (stiffness, depths, camera,
footprint), each with the standard deviation that its drawing allows. Where every marker was printed
follows from the rest picture and them, so it is no unknown of its own: it only has to be as likely
as the print's tolerance states. The load cell's errors, and where and how widely the force acts,
are unknown as well, but nearly linear, so they are eliminated press by press. What is left is
whitened least squares by Gauss-Newton. Differences cost a prediction for every parameter, so they
are taken at the drawing, and again near the solution, not for every step.

The design comes in as something to ask (`_Design`): this module knows neither body nor mesh.

Validity: what the design can't express (cover, contact, mesh) ends up in the residual and is stated
as ``model_px``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twin.arrays import Bools, Floats, Ints, Pixels
from twin.errors import InputError

STEP = 0.05
"""Step of the finite differences, in standard deviations of a parameter."""

ITERATIONS, ROUNDS = 25, 4
"""Gauss-Newton steps at most, and estimates of the model's error."""

FIRST_MODEL_PX = 0.05
"""Error of the model that is assumed until it is estimated, px."""

PLACE_MM = 0.02
"""Standard deviation of where a press acts along the surface, mm: a stage's, and how far pressure
and shear of a stuck sphere lie from where it touched first (.003 to .06 mm)."""

UNKNOWN = 6
"""Numbers that are unknown of each press: the load cell's three errors, how widely the shear is
spread, and where the force acts along two axes."""

LONGEST, NEAR, CONVERGED = 3.0, 0.3, 1e-3
"""In standard deviations: the longest step; how far a derivative holds, which the model's error is
estimated within; the step that ends the fit. On three pads a derivative .2 away changes no standard
deviation by more than 3e-4 of it."""


@dataclass(frozen=True, kw_only=True)
class Presses:
    """Measured presses.

    Attributes
    ----------
    place
        (q,) which of the design's places was pressed.
    force_n
        (q, 3) what the load cell read, N.
    shift_px
        (q, n, 2) motion of the markers since rest, px; NaN where lost.
    rest_px
        (n, 2) markers in the rest picture, px; NaN where lost.
    load_cell_n, noise_px
        Standard deviations of a force component and of a shift's component.
    """

    place: Ints
    force_n: Floats
    shift_px: Floats
    rest_px: Pixels
    load_cell_n: float
    noise_px: float


class _Design(Protocol):
    """What is fitted: parameters, and what they predict."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        ...

    @property
    def print_mm(self) -> float:
        """Standard deviation of a marker's place along the surface, mm."""
        ...

    def unsure_px(self, presses: Presses) -> Floats:
        """Return (q, n) what the design leaves open of a shift's component besides its parameters,
        as a standard deviation, px."""
        ...

    def predict(
        self, scaled: Floats, rest_px: Pixels, place: Ints, force_n: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return what parameters predict.

        Parameters
        ----------
        scaled
            (m,) deviations of the parameters from the drawing, in their standard deviations.
        rest_px
            (n, 2) where the markers are seen at rest.
        place, force_n
            (q,) places and (q, 3) forces of presses.

        Returns
        -------
        print_mm
            (n, 2) print errors that put the markers where they are seen, mm; 0 for markers not
            seen.
        shift_px
            (q, n, 2) motion, px.
        slope
            (q, n, 2, 6) its derivative by the force, px/N; by how widely its shear is spread, px a
            standard deviation; by where the force acts along the surface's two axes, px/mm.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fitted design.

    Attributes
    ----------
    names, scaled
        Parameters and their (m,) deviations from the drawing in standard deviations.
    covariance
        (m, m) of ``scaled``.
    residual_px
        Root mean square of what is left of the shifts' components, px.
    model_px
        The share of it that neither the noise nor the contact's shape explains, px.
    left_out
        (places,) error of a place's shifts when predicted without its presses, noise included, over
        their size.
    """

    names: tuple[str, ...]
    scaled: Floats
    covariance: Floats
    residual_px: float
    model_px: float
    left_out: Floats

    @classmethod
    def of(cls, design: _Design, presses: Presses) -> Fit:
        """Fit a design to measured presses and the rest picture.

        Raises
        ------
        InputError
            There are no presses, shapes don't agree, or no marker was seen both at rest and under a
            press.
        """
        _check(presses)
        scaled, model = np.zeros(len(design.names)), FIRST_MODEL_PX
        known = np.hypot(presses.noise_px, design.unsure_px(presses))
        drawn = scaled
        kept: dict[bytes, _Predicted] = {}
        for _ in range(ROUNDS):
            residuals = _Residuals(design, presses, np.hypot(known, model), kept)
            scaled = _descended(residuals, scaled, residuals.slope(drawn), NEAR)
            left = residuals.press_residual_px(scaled)
            # The model's error has one variance for all shifts: their mean excess, weighted.
            weight = np.where(residuals.seen, residuals.sd_px**-4.0, 0.0)
            excess = weight[:, :, None] * (np.nan_to_num(left) ** 2 - known[:, :, None] ** 2) / 2
            least = (0.2 * presses.noise_px) ** 2
            before, model = model, max(float(excess.sum() / weight.sum()), least) ** 0.5
            if abs(model - before) < 0.1 * before:
                break
        for _ in range(ITERATIONS):
            kept.clear()
            slope = residuals.slope(scaled)
            start, scaled = scaled, _descended(residuals, scaled, slope, CONVERGED)
            if np.abs(scaled - start).max() < NEAR:
                break
        left = residuals.press_residual_px(scaled)
        return cls(
            names=design.names,
            scaled=scaled,
            covariance=np.asarray(np.linalg.inv(slope.T @ slope), float),
            residual_px=float(np.sqrt(np.nanmean(left**2))),
            model_px=model,
            left_out=_left_out(residuals, scaled, slope),
        )


def _check(presses: Presses) -> None:
    count, markers = len(presses.force_n), len(presses.rest_px)
    shapes = (
        presses.force_n.shape,
        presses.shift_px.shape,
        presses.place.shape,
        presses.rest_px.shape,
    )
    if shapes != ((count, 3), (count, markers, 2), (count,), (markers, 2)):
        raise InputError(
            f"presses: force_n, shift_px, place and rest_px must be (q, 3), (q, n, 2), (q,) and "
            f"(n, 2), got {shapes}"
        )
    if not count or not np.isfinite(presses.force_n).all():
        raise InputError("presses: at least one is needed, with finite forces")
    if not np.isfinite(presses.shift_px[:, np.isfinite(presses.rest_px).all(axis=1)]).any():
        raise InputError("presses: no marker was seen both at rest and under a press")


_Predicted = tuple[Floats, Floats, Floats]


@dataclass(frozen=True)
class _Residuals:
    """Whitened residuals: parameters, print errors, shifts and load cell, in this order. What the
    design predicts is ``kept`` by parameters."""

    design: _Design
    presses: Presses
    sd_px: Floats
    kept: dict[bytes, _Predicted]

    @property
    def seen(self) -> Bools:
        """(q, n) shifts that count."""
        at_rest = np.isfinite(self.presses.rest_px).all(axis=1)
        return np.asarray(np.isfinite(self.presses.shift_px).all(axis=2) & at_rest)

    def _predicted(self, scaled: Floats) -> tuple[Floats, Floats, Floats]:
        """Return print errors, (q, n, 2) what is left of the shifts, 0 where lost, and (q, 6) what
        is unknown of every press in its standard deviations."""
        presses, key = self.presses, scaled.tobytes()
        if key not in self.kept:
            self.kept[key] = self.design.predict(
                scaled, presses.rest_px, presses.place, presses.force_n
            )
        prints, shift, slope = self.kept[key]
        seen = self.seen
        left = np.where(seen[:, :, None], presses.shift_px - shift, 0.0)
        spread = np.array([presses.load_cell_n] * 3 + [1.0] + [PLACE_MM] * 2)
        slope = np.where(seen[:, :, None, None], slope * spread, 0.0)
        sd_px = self.sd_px[:, :, None]
        rows = (slope / sd_px[..., None]).reshape(len(left), -1, UNKNOWN)
        across = rows.transpose(0, 2, 1)
        pull = across @ (left / sd_px).reshape(len(left), -1, 1)
        unknown = np.linalg.solve(across @ rows + np.eye(UNKNOWN), pull)[:, :, 0]
        left = left - np.einsum("qnij,qj->qni", slope, unknown)
        return prints, left, np.asarray(unknown, float)

    def __call__(self, scaled: Floats) -> Floats:
        prints, left, unknown = self._predicted(scaled)
        parts = (
            scaled,
            prints / self.design.print_mm,
            left / self.sd_px[:, :, None],
            unknown,
        )
        return np.concatenate([part.ravel() for part in parts])

    def slope(self, scaled: Floats) -> Floats:
        """Return the residuals' derivative by the parameters, by differences."""
        value = self(scaled)
        steps = STEP * np.eye(len(scaled))
        return np.column_stack([(self(scaled + step) - value) / STEP for step in steps])

    def press_residual_px(self, scaled: Floats) -> Floats:
        """Return (q, n, 2) what is left of the shifts, px; NaN where lost."""
        return np.where(self.seen[:, :, None], self._predicted(scaled)[1], np.nan)

    def rows_of(self, place: int) -> Bools:
        """Return which residuals belong to the presses of a place."""
        presses = self.presses
        mine = presses.place == place
        shifts = np.repeat(mine, presses.shift_px[0].size)
        before = np.zeros(len(self.design.names) + presses.rest_px.size, np.bool_)
        return np.concatenate([before, shifts, np.repeat(mine, UNKNOWN)])


def _descended(residuals: _Residuals, scaled: Floats, slope: Floats, enough: float) -> Floats:
    """Return parameters of the least squares near ``scaled``, by steps with one derivative until
    one is short ``enough``."""
    value = residuals(scaled)
    for _ in range(ITERATIONS):
        step = -np.linalg.lstsq(slope, value, rcond=None)[0]
        step *= min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-300))
        for _ in range(5):
            after = residuals(scaled + step)
            if np.isfinite(after).all() and after @ after <= value @ value:
                break
            step = step / 2
        else:
            break
        scaled, value = scaled + step, after
        if np.abs(step).max() < enough:
            break
    return scaled


def _left_out(residuals: _Residuals, scaled: Floats, slope: Floats) -> Floats:
    """Return every place's error when predicted from the others: one Gauss-Newton step without
    it."""
    presses, value = residuals.presses, residuals(scaled)
    errors = []
    for place in np.unique(presses.place):
        keep = ~residuals.rows_of(int(place))
        other = scaled - np.linalg.lstsq(slope[keep], value[keep], rcond=None)[0]
        mine = presses.place == place
        left = residuals.press_residual_px(other)[mine]
        errors.append(
            np.sqrt(
                np.nansum(left**2)
                / np.nansum(np.where(np.isfinite(left), presses.shift_px[mine], 0.0) ** 2)
            )
        )
    return np.array(errors)
