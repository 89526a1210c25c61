"""A high-pass filter of the chip: the spectrum falls towards f = 0, so that flicker and drift are lost."""

from dataclasses import replace

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.recording import AxisSeries

#: Octaves above the corner that must be flat; a vibration is narrower.
_FLAT_OCTAVES = 3
#: Largest ratio of the spectrum of flat octaves to their mean.
_FLAT = 1.3
#: Fewest degrees of freedom of a flat octave: its mean is then right to 15 %.
_FLAT_SIZE = 100
#: Largest mean below the corner, in multiples of the flat level; a first-order filter has 0.21.
_LOW = 0.5
#: Chance of a smaller mean in white noise.
_CHANCE = 1e-5
#: Largest ratio of the spectrum below an octave to that in it: 0.42 for filtered flicker, 1 for white noise,
#: to which the spectrum falls below a vibration.
_FALLS = 0.7
#: Spectrum that counts as zero, in multiples of the flat level: the ends of the log leave some.
_ZERO = 0.02
#: Fewest degrees of freedom below such an octave.
_LOWER_SIZE = 12
#: Multiple of the corner from which the spectrum is used: there a first-order filter takes 1.5 %.
_USED_FROM = 8.0
#: Highest start of the band, as a fraction of Nyquist.
_HIGHEST = 0.5


def find_high_pass(whole: Ordinates) -> float | None:
    """Return the corner of a high-pass filter as a fraction of Nyquist; None if there is none."""
    octave = np.floor(-np.log2(np.clip(whole.fraction, 1e-12, 1 - 1e-12))).astype(np.int64)
    size = np.bincount(octave, weights=whole.size).astype(np.float64)
    power = np.bincount(octave, weights=whole.power).astype(np.float64)
    means = power / np.maximum(size, 1e-12)
    for first in range(means.size - _FLAT_OCTAVES):
        flat = slice(first, first + _FLAT_OCTAVES)
        level = float(power[flat].sum() / max(float(size[flat].sum()), 1e-12))
        ratios = np.maximum(means[flat] / level, level / np.maximum(means[flat], 1e-300))
        if size[flat].min() < _FLAT_SIZE or ratios.max() > _FLAT:
            continue
        low = np.flatnonzero(means[first + _FLAT_OCTAVES :] < _LOW * level)
        if low.size:
            corner = first + _FLAT_OCTAVES + int(low[0])
            if _is_filtered(size[corner:], power[corner:], level):
                return float(2.0**-corner)
    return None


def _is_filtered(size: FloatArray, power: FloatArray, level: float) -> bool:
    """Return whether the octaves below a corner, the highest first, fall from the level to zero."""
    total, below = float(size.sum()), float(power.sum()) / level
    if below > _LOW * total or scipy.special.chdtr(total, below) > _CHANCE:
        return False
    lower_size = total - np.cumsum(size)[:-1]
    lower = (float(power.sum()) - np.cumsum(power)[:-1]) / np.maximum(lower_size, 1e-12)
    falls = lower < np.maximum(_FALLS * power[:-1] / np.maximum(size[:-1], 1e-12), _ZERO * level)
    counts = lower_size >= _LOWER_SIZE
    return bool(counts.any() and falls[counts].all())


def above_high_pass(whole: Ordinates, corner: float) -> Ordinates:
    """Return the ordinates, without information below a multiple of the corner."""
    used = whole.fraction >= min(_USED_FROM * corner, _HIGHEST)
    kept = {name: getattr(whole, name) * used for name in ("size", "power", "cross", "gram")}
    return replace(whole, **kept)


def high_pass_finding(corner: float, series: AxisSeries) -> Finding:
    """Return the finding about a filter of this corner, a fraction of Nyquist."""
    nyquist = series.rate_hz / 2
    text = (
        f"The spectrum falls towards zero below about {corner * nyquist:.2g} Hz: a high-pass filter has "
        "removed slow noise. B and K can't be told from this log; N is fitted above "
        f"{min(_USED_FROM * corner, _HIGHEST) * nyquist:.2g} Hz."
    )
    advice = "Switch off the high-pass filter of the sensor and the automatic bias correction of the driver."
    return Finding("warning", "high-pass", text, advice, axis=series.name)
