"""The camera's chip by EMVA 1288: gain, dark noise, linearity and saturation from flat fields.

The pictures are the program's own, of even light and of darkness, so that what a recipe states is
compared with what its pictures have. Measured is the chip: without lens, mosaic, gamma, video and
compression, as the standard wants raw data; without failed pixels and `adc_bits`; and above a black
level that keeps dark noise from being cut off at 0.

References
----------
EMVA Standard 1288, Standard for Characterization of Image Sensors and Cameras, release 3.1 (2016),
secs. 6 (sensitivity, linearity, noise) and 8 (spatial nonuniformity).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats
from twin.errors import RecipeError
from twin.files import Fact, fact
from twin.parts.camera import Ccd
from twin.world.picture.ccd import Pattern, expose

SIZE_PX = (512, 512)
"""Pixels that are measured: variances are then known to 0.3 %."""

STACK = 16
"""Pictures whose mean shows the fixed patterns."""

LEAST_DARK_DN2 = 0.24
"""Variance of dark pictures, count^2, below which rounding hides the noise (sec. 6.6)."""

_ROUNDING_DN2 = 1 / 12
_LEVELS = np.concatenate([np.linspace(0, 0.9, 46), np.linspace(0.905, 1.05, 30)])
"""Light of the flat fields, 1 fills the wells."""

_FITTED = 0.7
"""Share of saturation up to which the gain is fitted (sec. 6.5)."""

_LINEAR = (0.05, 0.95)
"""Shares of saturation between which linearity is judged (sec. 6.7)."""


@dataclass(frozen=True, kw_only=True)
class _PhotonTransfer:
    """What flat fields show of a chip.

    Attributes
    ----------
    gain_dn_e
        Counts an electron.
    dark_variance_dn2
        Variance in time of dark pictures, rounding included, count^2.
    dark_noise_e
        The same without rounding, as a standard deviation in electrons; NaN below
        `LEAST_DARK_DN2`, where it can't be measured.
    saturation_e
        Saturation capacity, electrons.
    linearity_pct
        Mean distance of the response from a straight line, percent of the response.
    prnu_pct, dsnu_e
        Standard deviations over the pixels of gain, percent, and of the dark signal, electrons.

    Notes
    -----
    The largest variance, which is at saturation by definition, lies where the brightest pixels
    begin to clip: saturation is 2 to 5 % below the full well.
    """

    gain_dn_e: float
    dark_variance_dn2: float
    dark_noise_e: float
    saturation_e: float
    linearity_pct: float
    prnu_pct: float
    dsnu_e: float

    @property
    def snr_max(self) -> float:
        """Largest ratio of signal to shot noise."""
        return float(np.sqrt(self.saturation_e))

    @property
    def dynamic_range(self) -> float:
        """Saturation over the least signal that differs from darkness (sec. 6.6), as a ratio."""
        least = np.sqrt(self.dark_noise_e**2 + _ROUNDING_DN2 / self.gain_dn_e**2 + 0.25) + 0.5
        return float(self.saturation_e / least)

    def facts(self, ccd: Ccd) -> list[Fact]:
        """Return what was found of a CCD, and what the recipe states of it."""
        full = ccd.spelt_out()
        black = _black_dn(ccd)
        gain = (2**ccd.bits - 1) * (1 - black / 255) / full.full_well_e
        spread = np.hypot(full.dsnu_e or 0.0, full.column_noise_e)
        enough = self.dark_variance_dn2 >= LEAST_DARK_DN2
        dark = (
            f"{'{noise_e:.3g}' if enough else 'unknown'} electrons, stated {{stated_e:.3g}}; "
            f"variance {{variance_dn2:.3g}} counts^2 with rounding, needed {LEAST_DARK_DN2:g}: "
            f"{'enough' if enough else 'too little, hidden by rounding'}"
        )
        pattern = (
            f"PRNU {{prnu_pct:.2g}} %, stated {full.prnu_pct:.2g}; "
            f"DSNU {{dsnu_e:.2g}} electrons, stated {spread:.2g}"
        )
        counts = "{dn_e:.4g} counts an electron, stated {stated_dn_e:.4g} at black level {black:g}"
        electrons = f"{{full_e:.4g}} electrons, stated {full.full_well_e:.4g}"
        decibels = "{db:.3g} dB" if enough else "unknown, as dark noise is"
        about = "bits, by EMVA 1288: without lens, mosaic, gamma, video, compression"
        noise = {"noise_e": self.dark_noise_e, "variance_dn2": self.dark_variance_dn2}
        spreads = {"prnu_pct": self.prnu_pct, "dsnu_e": self.dsnu_e}
        signal = {"ratio": self.snr_max, "db": 20 * np.log10(self.snr_max)}
        line = {"deviation_pct": self.linearity_pct}
        return [
            fact("chip", f"{full.preset}, {ccd.bits} {about}"),
            fact("gain", counts, {"dn_e": self.gain_dn_e, "stated_dn_e": gain, "black": black}),
            fact("dark noise", dark, noise | {"stated_e": _dark_e(ccd)}),
            fact("saturation", electrons, {"full_e": self.saturation_e}),
            fact("SNR", "{ratio:.3g} at most ({db:.3g} dB)", signal),
            fact("dynamic range", decibels, {"db": 20 * np.log10(self.dynamic_range)}, " "),
            fact("linearity", "{deviation_pct:.2g} % mean deviation from a line", line),
            fact("pattern", pattern, spreads),
        ]


def photon_transfer(ccd: Ccd) -> _PhotonTransfer:
    """Measure a chip by EMVA 1288.

    Parameters
    ----------
    ccd
        The CCD of a scene.

    Raises
    ------
    RecipeError
        The CCD has no noise, by which its gain is measured, or rounding hides it.
    """
    if not ccd.spelt_out().noise:
        raise RecipeError(
            "ccd.noise = false: electrons are counted by their noise, so a camera without any "
            "can't be measured; set ccd.noise = true, or another ccd.preset"
        )
    black = _black_dn(ccd)
    off = {"gamma": 1.0, "psf_px": 0.0, "black_dn": black, "bayer": "none", "interlace": False}
    off |= {"bandwidth_mhz": "off", "jpeg_quality": "off", "white_balance": "off"}
    off |= dict.fromkeys(("haze", "ghost", "smear", "flicker", "auto_exposure", "auto_gain"), 0)
    off |= dict.fromkeys(("hot_pixels", "dead_pixels", "adc_bits"), 0)
    chip = ccd.model_copy(update=off)
    rng = np.random.default_rng(1)
    pattern = Pattern.drawn(chip, SIZE_PX, rng)
    response = chip.response.sum(axis=1)
    channel = int(np.argmax(response))

    most = 2**ccd.bits - 1

    def flat(level: float) -> Floats:
        light = np.full((*SIZE_PX, 3), level / response[channel], np.float32)
        counts = expose(light, chip, rng, pattern)[:, :, channel]
        return np.asarray(np.rint(counts * (most / np.iinfo(counts.dtype).max)))

    # Mean and variance in time at every level, of two pictures each: the difference has no pattern.
    pairs = [(flat(level), flat(level)) for level in _LEVELS]
    mean = np.array([(one.mean() + two.mean()) / 2 for one, two in pairs])
    variance = np.array([np.var(one - two) / 2 for one, two in pairs])
    signal, noise = mean - mean[0], variance - max(variance[0], _ROUNDING_DN2)
    top = int(np.argmax(variance))
    # Up to the fit's end, and above the last level whose noise rounding hides.
    last = int(np.searchsorted(signal, _FITTED * signal[top]))
    hidden = np.flatnonzero(variance[:last] < LEAST_DARK_DN2)
    below = slice(hidden[-1] + 1 if len(hidden) else 1, last)
    if below.start > last / 2:
        raise RecipeError(
            f"ccd.bits = {ccd.bits}: rounding hides the noise by which electrons are counted; give "
            "more bits, or a smaller ccd.full_well_e"
        )
    gain = float(signal[below] @ noise[below] / (signal[below] @ signal[below]))
    dark = max(variance[0] - _ROUNDING_DN2, 0.0)
    # A straight line by relative deviations: what is judged is their mean.
    some = (signal >= _LINEAR[0] * signal[top]) & (signal <= _LINEAR[1] * signal[top])
    some &= np.arange(len(signal)) <= top
    weights = 1 / signal[some]
    slope, start = np.polyfit(_LEVELS[some], signal[some], 1, w=weights)
    line = start + slope * _LEVELS[some]
    # Fixed patterns, of means over a stack.
    stacks = [np.mean([flat(level) for _ in range(STACK)], axis=0) for level in (0.0, 0.5)]
    spreads = [
        np.var(stack) - np.interp(level, _LEVELS, variance) / STACK
        for stack, level in zip(stacks, (0.0, 0.5), strict=True)
    ]
    prnu = np.sqrt(max(spreads[1] - spreads[0], 0.0)) / (stacks[1].mean() - stacks[0].mean())
    return _PhotonTransfer(
        gain_dn_e=gain,
        dark_variance_dn2=float(variance[0]),
        dark_noise_e=float(np.sqrt(dark) / gain) if variance[0] >= LEAST_DARK_DN2 else float("nan"),
        saturation_e=float(signal[top] / gain),
        linearity_pct=float(100 * np.mean(np.abs(signal[some] / line - 1))),
        prnu_pct=float(100 * prnu),
        dsnu_e=float(np.sqrt(max(spreads[0], 0.0)) / gain),
    )


def _dark_e(ccd: Ccd) -> float:
    """Return the noise in time of dark pictures that a recipe states, electrons."""
    full = ccd.spelt_out()
    gathered = full.dark_current_e_s * full.exposure_ms / 1000
    return float(np.sqrt(full.read_noise_e**2 + gathered + full.row_noise_e**2))


def _black_dn(ccd: Ccd) -> float:
    """Return a black level at which no dark noise is cut off at 0: six standard deviations, and a
    quarter of a count, where rounding adds its usual variance whatever the noise is."""
    full = ccd.spelt_out()
    spread = np.hypot(full.dsnu_e or 0.0, full.column_noise_e)
    most = 2**ccd.bits - 1
    least = 6 * most * np.hypot(_dark_e(ccd), spread) / full.full_well_e
    return float((np.ceil(least) + 0.25) * 255 / most)
