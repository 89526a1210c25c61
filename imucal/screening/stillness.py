"""Which windows of an axis are disturbed: louder than its quiet ones, or off their level.

Every limit comes from the axis's own quiet windows, so that a touch does not hide itself by raising
the yardstick.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.recording import AxisSeries
from imucal.screening.windows import Windows

#: How often an axis at rest may have one disturbed window, by chance.
_FALSE_ALARM = 1e-4
#: Real noise breathes with the temperature: a variance or a jump must pass the limit by this much.
_MARGIN = 1.25
#: A spike stands out by this many robust deviations and is at most two samples long.
_SPIKE = 5 * 1.4826
#: Spikes in more than this part of a window are no spikes.
_MOST_SPIKES = 0.15
#: Fewer windows than this say nothing about what is usual.
_LEAST_WINDOWS = 8
#: Median of chi2(1).
_MEDIAN_CHI2 = 0.4549364


def usual_variance(windows: Windows) -> float:
    """Return the median variance of the windows that are not constant, in U²; 0 if all are."""
    varying = windows.variance[windows.variance > 0]
    return float(np.median(varying)) if varying.size else 0.0


def disturbed(windows: Windows, lsb: float | None) -> NDArray[np.bool_]:
    """Return which windows are disturbed, shape (k,).

    A window is when its variance, or the jump of its mean from the window before, is larger than
    chance allows; both must also exceed the resolution `lsb`, below which values only toggle.
    """
    from scipy.special import ndtri

    if windows.size < _LEAST_WINDOWS:
        return np.zeros(windows.size, dtype=bool)
    p_above = _FALSE_ALARM / windows.size
    least = lsb or 0.0
    varying = windows.variance[windows.variance > 0]
    limit = variance_limit(varying, p_above) if varying.size else 0.0
    loud = windows.variance > max(_MARGIN * limit, least**2)
    jumps = _jumps(windows)
    scale = np.sqrt(np.median(jumps[jumps > 0] ** 2) / _MEDIAN_CHI2) if np.any(jumps > 0) else 0.0
    off = jumps > max(np.sqrt(_MARGIN) * -ndtri(p_above) * scale, least)
    loud[1:] |= off
    loud[:-1] |= off
    return loud


def variance_limit(variances: FloatArray, p_above: float) -> float:
    """Return what the variance of a quiet window exceeds with a probability of at most about `p_above`.

    A variance is a sum of weighted chi-squares: its tail falls as exp(-x/c), where c shows between
    the median and the 80 % quantile, whatever the colour of the noise. Windows in motion, when they
    are more than a fifth, would raise that; so the limit is never above that of two degrees of
    freedom with the same median. Shape of `variances` (k,), k >= 1.
    """
    middle, upper = (float(q) for q in np.quantile(variances, [0.5, 0.8]))
    reach = math.log(0.5 / p_above)
    fitted = middle + (upper - middle) / math.log(0.5 / 0.2) * reach
    return min(fitted, middle * (1 + reach / math.log(2)))


def _jumps(windows: Windows) -> FloatArray:
    """Return how far the mean moves from each window to the next, shape (k - 1,); 0 over a gap."""
    jumps = np.abs(np.diff(windows.mean))
    jumps[np.diff(windows.time_s) > 1.5 * windows.length_s] = 0.0
    return jumps


def without_spikes(series: AxisSeries, windows: Windows, suspects: NDArray[np.bool_]) -> Windows:
    """Return the windows, mean and variance of the suspects taken without outliers of one or two samples.

    Spikes are errors of the data, not of the stillness; the fit cleans and counts them.
    """
    mean, variance = windows.mean.copy(), windows.variance.copy()
    offsets = np.arange(windows.width)
    for index in np.array_split(
        np.flatnonzero(suspects), max(1, suspects.sum() * windows.width // (1 << 18))
    ):
        table = series.samples[windows.start[index, None] + offsets]
        keep = ~_spikes(table)
        rare = (~keep).sum(axis=1) <= max(2, _MOST_SPIKES * windows.width)
        count = keep.sum(axis=1)
        middle = np.where(keep, table, 0).sum(axis=1) / count
        rest = np.where(keep, table - middle[:, None], 0)
        mean[index] = np.where(rare, middle, mean[index])
        variance[index] = np.where(rare, (rest**2).sum(axis=1) / (count - 1), variance[index])
    return replace(windows, mean=mean, variance=variance)


def _spikes(table: FloatArray) -> NDArray[np.bool_]:
    """Return which samples of each row stand out alone or in pairs, shape of `table`."""
    rest = np.abs(table - np.median(table, axis=1, keepdims=True))
    deviation = np.median(rest, axis=1, keepdims=True)
    # Of a coarse axis most samples are equal: then the mean deviation is the yardstick.
    deviation = np.where(deviation > 0, deviation, rest.mean(axis=1, keepdims=True))
    out = np.pad(rest > _SPIKE * deviation, ((0, 0), (2, 2)))
    left, here, right = out[:, 1:-3], out[:, 2:-2], out[:, 3:-1]
    far_left, far_right = out[:, :-4], out[:, 4:]
    longer = (left & right) | (left & far_left) | (right & far_right)
    return here & ~longer
