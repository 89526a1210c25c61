"""Where the sampling rate of a log changes for good.

The rate is measured in windows of many samples, spread over the log. Gaps do not count. A change splits the
windows into two parts with a stable rate each. Losses that begin within a log are no change of the rate: the
short steps stay as long as before.
"""

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray, median, percentile
from imucal.frozen import frozen

#: Most windows, fewest samples in each, and most.
_WINDOWS, _LEAST, _MOST = 400, 32, 512
#: A part has at least so many windows, and this share of them.
_FEWEST, _SHARE = 8, 0.04
#: Least ratio of two rates, and of the short steps at these rates.
_RATIO, _SHORT = 1.4, 1.3
#: A step longer than so many times a long one is a gap.
_GAP = 8
#: A window spans at least so many short steps between different stamps.
_TICKS = 8
#: A rate is stable where this share of the windows is so near to the median.
_STABLE, _NEAR = 0.6, 0.2


@frozen
class Change:
    """A change of the sampling rate."""

    #: Rates before and after, in Hz.
    rates_hz: tuple[float, float]
    #: Samples before which the first part ends, and with which the second part begins.
    end: int
    start: int

    def part(self, n: int, rate_hz: float | None) -> tuple[slice, float]:
        """Return the part whose rate is nearest to the one given, or else the longer one, and its rate."""
        parts = tuple(zip((slice(0, self.end), slice(self.start, n)), self.rates_hz, strict=True))
        if rate_hz is not None:
            return min(parts, key=lambda part: abs(np.log(part[1] / rate_hz)))
        return max(parts, key=lambda part: part[0].stop - part[0].start)


def rate_change(stamps: IntArray) -> Change | None:
    """Return the largest lasting change of the rate of stamps in ns, shape (n,); None where there is none."""
    count = min(_WINDOWS, stamps.size // _LEAST)
    if count < 2 * _FEWEST:
        return None
    # An even number of steps, as the steps of two sensors alternate.
    width = min(stamps.size // count - 1, _MOST) // 2 * 2
    first = np.linspace(0, stamps.size - 1 - width, count).astype(np.int64)
    steps = np.diff(stamps[first[:, None] + np.arange(width + 1)], axis=1).astype(np.float64)
    every = steps.ravel()
    if every.max() <= 0:
        return None
    counts = np.abs(steps) <= _GAP * max(median(every), percentile(every, 90))
    spans = np.where(counts, steps, 0.0).sum(axis=1)
    means = spans / np.maximum(counts.sum(axis=1), 1)
    short = np.sort(steps, axis=1)[:, width // 4]
    # A few ticks of a coarse clock are not enough to measure a rate.
    good = np.flatnonzero(spans > _TICKS * percentile(every[every > 0], 10))
    means, short, first = means[good], short[good], first[good]
    if good.size < 2 * _FEWEST:
        return None
    at = _split(means)
    least = max(_FEWEST, int(_SHARE * good.size))
    if not least <= at <= good.size - least or not _lasting(means, short, np.arange(good.size) < at):
        return None
    return Change(
        rates_hz=(1e9 / median(means[: at - 1]), 1e9 / median(means[at + 1 :])),
        end=int(first[at - 1]),
        start=int(first[at]) + width,
    )


def _split(means: FloatArray) -> int:
    """Return the first window after the change that fits the mean steps best, shape (m,)."""
    logs = np.log(means)
    sums, before = np.cumsum(logs)[:-1], np.arange(1, logs.size)
    after = logs.size - before
    contrast = (sums / before - (logs.sum() - sums) / after) ** 2 * before * after
    at = int(np.argmax(contrast[_FEWEST - 1 : 1 - _FEWEST])) + _FEWEST
    # A mixed window or an outlier does not move the place where most windows are on their own side.
    middle = (median(logs[:at]) + median(logs[at:])) / 2
    sides = np.where((logs > middle) == (median(logs[at:]) > middle), 1, -1)
    return int(np.argmin(np.cumsum(sides))) + 1


def _lasting(means: FloatArray, short: FloatArray, before: BoolArray) -> bool:
    """Say whether the windows before and after differ in their rate and each side has a stable one."""
    levels = [(median(means[side]), median(short[side])) for side in (before, ~before)]
    for side, (mean, _) in zip((before, ~before), levels, strict=True):
        if np.mean(np.abs(means[side] / mean - 1) < _NEAR) < _STABLE:
            return False
    (fast, fast_short), (slow, slow_short) = sorted(levels)
    if slow < _RATIO * fast:
        return False
    # The short steps of batches and of a coarse clock are not those of the sensor.
    batches = fast_short < 0.5 * fast and slow_short < 0.5 * slow
    return batches or slow_short > _SHORT * fast_short
