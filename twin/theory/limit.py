"""The design limit: what two layers of markers can resolve of the force field, with any software,
in closed form.

A force field on an elastic half-space is a sum of waves exp(i k x). Each wave moves the markers of
a layer at depth d by a known amount, the markers sample that motion with noise, and what is left to
learn of the wave is a small least squares problem of its own. With the traction's part along k and
its normal part, t and n, a layer's motion along k is

    [ (2 (1 - nu) - k d) t  +  (k d - (1 - 2 nu)) n ] exp(-k d) / (2 G k)

(n a quarter of a wave ahead; the part across k is exp(-k d) / (G k) alone), from the half-space's
closed forms. The noise of a layer of pitch p and a standard deviation of s of its markers' motion
has the spectral density (s p)^2. With the rows A of all layers, M = A^T N^-1 A and a prior of
spectral density P = F^2 / (pi r^2) for a load of F over a disc of radius r, the best linear
estimate of a wave is W = (M + 1/P)^-1 M of it (N. Wiener 1949). W against k is the sensor's
transfer function, and its Hankel transform the picture of a point force.

Sampling: markers p apart sample waves up to pi / p, and the picture of a point that is made of
these is sin(pi x / p) / (pi x / p), `SAMPLED` p wide. Where noise and sampling both matter their
widths add in squares; a bound that no sensor beats has a floor instead, which is put in by hand.

For depths a < b the determinant of A is k (b - a) exp(-k (a + b)) / (2 G k)^2: one layer alone
can't separate a push from a shear.

Validity: a half-space seen straight on, layers wider than what is resolved, markers no wider than
their pitch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import j0, j1

from twin.arrays import Floats
from twin.errors import InputError
from twin.parts.material import shear_modulus

FLOOR = 1.41
"""Least width of a point force's picture, in pitches."""

SAMPLED = 1.2067
"""Full width at half maximum of sin(pi x) / (pi x)."""

DIP = 0.2
"""Two forces count as two where the estimate between them falls by this share of the peaks."""

_K = np.geomspace(0.02, 30.0, 88)
_R = np.concatenate([[0.0], np.geomspace(0.05, 40.0, 63)])
_STEP = np.log(_K[1] / _K[0])
_HANKEL = (_K**2 * _STEP / (2 * np.pi))[:, None] * j0(np.outer(_K, _R))
"""Weights of the transform from k to r, both in units of the least depth: trapezoids in log k. Five
times as many of each move no result by more than 3 %."""

_HALVES = np.array([np.interp(_R / 2, _R, row) for row in np.eye(len(_R))])
"""Turns profiles at r into profiles at r / 2."""

_CHUNK = 500
"""Designs at a time: their waves stay in the processor's cache."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """What each of m designs can reach: (m,) full width at half maximum of the estimate of a point
    push; least distance of two equal pushes between which it dips by `DIP`; standard deviation of
    the size of one push over the prior's disc at a known place."""

    fwhm_normal_mm: Floats
    two_point_mm: Floats
    force_sd_n: Floats

    @staticmethod
    def of(
        *,
        depth_mm: Floats,
        pitch_mm: Floats,
        noise_mm: Floats,
        youngs_modulus_mpa: Floats,
        poisson_ratio: Floats,
        force_n: Floats,
        radius_mm: Floats,
        sampling: Literal["floor", "squares"] = "floor",
    ) -> Limit:
        """Return what designs can reach.

        Parameters
        ----------
        depth_mm, pitch_mm, noise_mm
            (m, layers) depth of each layer, pitch of its markers along the surface, and standard
            deviation of a component of their motion, mm.
        youngs_modulus_mpa, poisson_ratio, force_n, radius_mm
            (m,) of the rubber, and of the loads that are expected: the prior.
        sampling
            How the pitch counts: as a floor (a bound), or by the sum of squares (what to expect).

        Raises
        ------
        InputError
            A length, modulus or force is not positive.
        """
        depth, pitch, noise = (
            np.atleast_2d(np.asarray(a, float)) for a in (depth_mm, pitch_mm, noise_mm)
        )
        modulus, nu, force, radius = (
            np.broadcast_to(np.asarray(a, float), len(depth))
            for a in (youngs_modulus_mpa, poisson_ratio, force_n, radius_mm)
        )
        if min(a.min() for a in (depth, pitch, noise, modulus, force, radius)) <= 0:
            raise InputError(
                "design limit: depths, pitches, noise, modulus, force and radius must be positive"
            )
        chunks = [
            _limits(
                *(a[i : i + _CHUNK] for a in (depth, pitch, noise, modulus, nu, force, radius)),
                sampling=sampling,
            )
            for i in range(0, len(depth), _CHUNK)
        ]
        return Limit(
            **dict(zip(Limit.__annotations__, np.concatenate(chunks, axis=1), strict=True))
        )

    @staticmethod
    def layer_rows(
        k: Floats, depth_mm: Floats, shear_modulus_mpa: Floats, poisson_ratio: Floats
    ) -> tuple[Floats, Floats]:
        """Return motion of a layer along k per traction along k, and per normal traction a quarter
        of a wave ahead, mm/MPa; ``k`` are wave numbers, 1/mm, and all arguments broadcast."""
        falls = np.exp(-k * depth_mm) / (2 * shear_modulus_mpa * k)
        return (2 * (1 - poisson_ratio) - k * depth_mm) * falls, (
            k * depth_mm - (1 - 2 * poisson_ratio)
        ) * falls


def _limits(
    depth: Floats,
    pitch: Floats,
    noise: Floats,
    modulus: Floats,
    nu: Floats,
    force: Floats,
    radius: Floats,
    *,
    sampling: str,
) -> Floats:
    """Return the rows of a `Limit`."""
    scale = depth.min(axis=1)
    k = _K / scale[:, None]
    g = shear_modulus(modulus, nu)
    tt, tn, nn = np.zeros((3, *k.shape))
    for layer in range(depth.shape[1]):
        along, normal = Limit.layer_rows(k, depth[:, layer, None], g[:, None], nu[:, None])
        weight = 1 / (noise[:, layer] * pitch[:, layer])[:, None] ** 2
        tt += weight * along**2
        tn += weight * along * normal
        nn += weight * normal**2
    prior = (np.pi * radius**2 / force**2)[:, None]
    determinant = (tt + prior) * (nn + prior) - tn**2
    push = (1 - prior * (tt + prior) / determinant) @ _HANKEL
    kr = k * radius[:, None]
    disc = k**2 * _STEP / (2 * np.pi) * (2 * j1(kr) / kr) ** 2  # the transform of an even disc
    half_widths = _crossing(push / push[:, :1] - 0.5)
    # two pushes count as two at the least distance s where 2 p(s/2) is `DIP` below p(0) + p(s)
    two_points = _crossing(2 * (push @ _HALVES) - (1 - DIP) * (push[:, :1] + push))
    widths = np.array([2 * half_widths, two_points]) * scale
    widest = pitch.max(axis=1)
    sampled = (
        np.maximum(widths, FLOOR * widest)
        if sampling == "floor"
        else np.hypot(widths, SAMPLED * widest)
    )
    return np.concatenate([sampled, np.sum(disc * nn, axis=1)[None] ** -0.5])


def _crossing(falling: Floats) -> Floats:
    """Return the first r at which each row falls below zero; infinite where none does."""
    below = falling < 0
    at = np.argmax(below, axis=1)
    rows = np.arange(len(falling))
    high = falling[rows, at - 1]
    low = falling[rows, at]
    share = high / np.where(high == low, 1.0, high - low)
    found = _R[at - 1] + share * (_R[at] - _R[at - 1])
    return np.where(below.any(axis=1), found, np.inf)
