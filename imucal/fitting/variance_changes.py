"""Noise whose variance changes faster than the segments of a record show.

The mean squares of the samples' steps in short windows are known to within chance alone where the
noise is stationary, whatever its tails and its filter are; then neighbouring windows differ as much
as distant ones. Where they differ less, the variance follows something.

Source: von Neumann (1941), Annals of Mathematical Statistics 12, 367 (the ratio of the mean square
successive difference to the variance).
"""

import math
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.recording import AxisSeries

#: Most windows, fewest, and fewest samples of a window.
_MOST, _FEWEST, _SAMPLES = 1024, 24, 128
#: Steps that are squared at a time.
_PART = 1 << 16
#: Score of von Neumann's ratio from which chance does not explain it.
_SCORE = 5.0
#: Least relative standard deviation of the noise that is worth a word.
_NOTABLE = 0.1
#: Share of the variance in one period from which the change is called a swing of that period.
_PERIODIC = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class VarianceChange:
    """A change of the noise's variance over time.

    Attributes
    ----------
    score
        Of von Neumann's ratio: standard normal where the variance is constant.
    low, high
        10 % and 90 % quantiles of the noise of a window, relative to their median.
    period_s
        Period of its swing, in s; None where it has none.
    """

    score: float
    low: float
    high: float
    period_s: float | None


def find_variance_change(series: AxisSeries) -> VarianceChange | None:
    """Return how the variance of an axis's steps changes; None where chance explains it or it is small.

    Steps across gaps are steps as well. O(n).
    """
    count = min(_MOST, (series.n - 1) // _SAMPLES)
    if count < _FEWEST:
        return None
    edges = np.linspace(0, series.n - 1, count + 1).round().astype(np.int64)
    mean = _square_steps(series.samples, edges) / np.diff(edges)
    if not np.all(mean > 0):
        return None
    logs = np.log(mean) / 2
    logs -= logs.mean()
    square = float(np.sum(logs * logs))
    if not square > 0:
        return None
    ratio = float(np.sum(np.diff(logs) ** 2)) / square / 2
    score = (1 - ratio) / math.sqrt((count - 2) / (count**2 - 1))
    spread = math.sqrt(square / count)
    if score < _SCORE or spread * math.sqrt(max(1 - ratio, 0.0)) < _NOTABLE:
        return None
    low, middle, high = np.quantile(logs, [0.1, 0.5, 0.9]).tolist()
    return VarianceChange(
        score=score,
        low=math.exp(low - middle),
        high=math.exp(high - middle),
        period_s=_period(logs, series.duration_s),
    )


def _square_steps(samples: FloatArray, edges: IntArray) -> FloatArray:
    """Return the sum of squared steps of each window, shape (w,), in parts that stay in the cache."""
    total = np.empty(edges.size - 1)
    first = 0
    while first < total.size:
        last = max(int(np.searchsorted(edges, edges[first] + _PART, side="right")) - 1, first + 1)
        steps = np.diff(samples[edges[first] : edges[last] + 1])
        steps *= steps
        total[first:last] = np.add.reduceat(steps, edges[first:last] - edges[first])
        first = last
    return total


def _period(logs: FloatArray, duration_s: float) -> float | None:
    """Return the period that makes most of the logs' variance, where there are some periods of it."""
    power = np.square(np.abs(np.fft.rfft(logs)))[1:]
    near = np.convolve(power, np.ones(3), "same")
    top = int(np.argmax(near))
    if top < 2 or near[top] < _PERIODIC * power.sum():
        return None
    around = np.arange(top - 1, min(top + 2, power.size))
    frequency = float(np.average(around + 1, weights=power[around]))
    return duration_s / frequency
