"""The spectrum of an axis with few points, whose slope and lines are visible in a plot."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.report.result import AxisReport

#: Ordinates of the lowest point of a smoothed spectrum: more hide the lowest slope.
_MIN_FIRST_ORDINATES = 6.0
#: Ordinates of every other point: fewer show single spikes.
_MIN_ORDINATES = 12.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothSpectrum:
    """Root of a two-sided density with its limits, in U/√Hz, shape (k,); `frequency` in Hz."""

    frequency: FloatArray
    root: FloatArray
    low: FloatArray
    high: FloatArray


def smooth_spectrum(axis: AxisReport) -> SmoothSpectrum:
    """Return an axis's spectrum; neighbouring bins are merged until each point averages 12 ordinates.

    The ratio to the model is averaged, because averages of a steep density would be too high. Limits are
    chi-squared. Source: Blackman & Tukey (1958), The Measurement of Power Spectra, sec. B.18.
    """
    from scipy.special import chdtri

    spectrum, fit = axis.spectrum, axis.fit
    if not spectrum.frequency.size:
        none = np.zeros(0)
        return SmoothSpectrum(frequency=none, root=none, low=none, high=none)
    first = _firsts(spectrum.count)
    count = np.add.reduceat(spectrum.count, first)
    frequency = np.exp(np.add.reduceat(np.log(spectrum.frequency) * spectrum.count, first) / count)
    ratio = np.add.reduceat(spectrum.psd / _shape(axis, spectrum.frequency) * spectrum.count, first) / count
    root = np.sqrt(ratio * _shape(axis, frequency))
    tail = (1 - fit.level) / 2
    low, high = (root * np.sqrt(count / chdtri(count, beyond)) for beyond in (tail, 1 - tail))
    return SmoothSpectrum(frequency=frequency, root=root, low=low, high=high)


def _shape(axis: AxisReport, frequency: FloatArray) -> FloatArray:
    density = axis.fit.model.psd(frequency, rate_hz=axis.fit.rate_hz)
    return density if np.all(density > 0) else np.ones(frequency.size)


def _firsts(count: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the first bin of each merged bin; the last one includes the remainder."""
    firsts, held = [0], 0.0
    for index, ordinates in enumerate(count.tolist()):
        if held >= (_MIN_FIRST_ORDINATES if len(firsts) == 1 else _MIN_ORDINATES):
            firsts.append(index)
            held = 0.0
        held += ordinates
    if held < _MIN_ORDINATES and len(firsts) > 1:
        firsts.pop()
    return np.array(firsts, dtype=np.int64)
