"""Two readings of the white noise: before and behind a smoothing filter, or beside a vibration.

If the spectrum is flat at its highest frequencies, its level there is a reading of N. A fit that lowers its
band, or fits a response, reads N at lower frequencies: both can be the sensor's. A Gauss-Markov term that is
much stronger than white noise, and too short for a drift, is either noise of its own, or white noise behind a
smoothing filter to which a little noise was added. The samples do not show which one it is, so the limits of
N contain both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate
from imucal.fitting.spectral.maximum import UNLIKELY
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.noise.terms import GaussMarkov

__all__ = [
    "AT_THE_TOP",
    "Level",
    "hidden_levels",
    "level_at_the_top",
    "levels_finding",
    "outside",
    "with_levels",
]

#: Lower end of the highest frequencies, as a fraction of Nyquist: their upper octave.
_TOP = 0.5
#: Parts of the upper octave that must have one level.
_PARTS = 4
#: Least number of ordinates of a part.
_LEAST = 60
#: Largest relative difference of the parts of a flat spectrum besides chance.
_EVEN = 0.1
#: Density of the rounding below which a level is the rounding and not the sensor's noise.
_ROUNDED = 3.0
#: Correlation time, in samples, below which a Gauss-Markov term may be a smoothing filter.
_SHORT = 100.0
#: Ratio of its density to that of the white noise, above which it hides white noise.
_HIDING = 4.0


_SMOOTHING = "a Gauss-Markov term, or white noise behind a smoothing filter to which a little noise was added"
#: Cause of a level at the highest frequencies.
AT_THE_TOP = "a filter, or a vibration beside the white noise"


@dataclass(frozen=True, kw_only=True)
class Level:
    """A reading of N in U/sqrt(Hz), with its limits."""

    value: float
    low: float
    high: float
    #: What else than white noise the spectrum would then contain.
    cause: str


def level_at_the_top(whole: Ordinates, beta: FloatArray, *, rounding: float) -> tuple[float, float] | None:
    """Return the variance per sample of white noise in the upper octave, and its relative standard error.

    None if the spectrum is not flat there, or only the rounding of the samples. `beta`, shape (r,), belongs
    to the regressors, and `rounding` is the variance of the rounding; both in scaled units.
    """
    part = np.floor((whole.fraction - _TOP) / (1 - _TOP) * _PARTS)
    inside = (part >= 0) & (part < _PARTS) & (whole.size > 0)
    number = part[inside].astype(np.int64)
    size = np.bincount(number, whole.size[inside], minlength=_PARTS)
    if size.min() < _LEAST:
        return None
    power = np.bincount(number, whole.rest(beta)[inside], minlength=_PARTS)
    mean = float(power.sum() / size.sum())
    if mean < _ROUNDED * rounding:
        return None
    off = power / size / mean - 1
    by_chance = scipy.special.chdtrc(_PARTS - 1, np.sum(size / 2 * off**2))
    if by_chance < UNLIKELY and np.abs(off).max() > _EVEN:
        return None
    return mean, float(np.sqrt(2 / size.sum()))


def hidden_levels(estimates: Sequence[Estimate], *, tau0: float) -> tuple[Level, ...]:
    """Return the readings of N behind Gauss-Markov terms that a smoothing filter can imitate."""
    white = next(e for e in estimates if e.symbol == "N")
    floor = white.value or 0.0
    found = []
    for one in estimates:
        if one.symbol != GaussMarkov.symbol or one.value is None or one.correlation_time is None:
            continue
        time = one.correlation_time
        hidden = 2 * one.value**2 * time.value
        if time.value < _SHORT * tau0 and hidden > _HIDING * floor**2:
            density = floor**2 + hidden
            limit = floor**2 + 2 * one.high**2 * time.high
            level = density**0.5
            found.append(Level(value=level, low=level, high=limit**0.5, cause=_SMOOTHING))
    return outside(estimates, found)


def outside(estimates: Sequence[Estimate], levels: Sequence[Level]) -> tuple[Level, ...]:
    """Return the levels that the limits of N do not contain."""
    white = next(e for e in estimates if e.symbol == "N")
    return tuple(level for level in levels if not white.low <= level.value <= white.high)


def with_levels(estimates: Sequence[Estimate], levels: Sequence[Level]) -> tuple[Estimate, ...]:
    """Return the estimates with limits of N that contain other levels."""
    if not levels:
        return tuple(estimates)
    least = min(level.low for level in levels)
    most = max(level.high for level in levels)
    return tuple(
        replace(one, low=min(one.low, least), high=max(one.high, most)) if one.symbol == "N" else one
        for one in estimates
    )


def levels_finding(
    estimates: Sequence[Estimate], levels: Sequence[Level], unit: str, axis: str
) -> tuple[Finding, ...]:
    """Return the warning that names all readings of N."""
    if not levels:
        return ()
    white = next(e for e in estimates if e.symbol == "N")
    readings = [f"{level.value:.3g}" for level in levels]
    if white.value is not None:
        readings.insert(0, f"{white.value:.3g}")
    causes = " or ".join(dict.fromkeys(level.cause for level in levels))
    text = (
        f"The spectrum has two explanations, with N = {' or '.join(readings)} {unit}: {causes}. The limits "
        "of N contain both."
    )
    advice = "Switch off filters and smoothing, and record on a firm surface; then one explanation is left."
    return (Finding("warning", "two-levels", text, advice, axis=axis),)
