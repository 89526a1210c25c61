"""Find a lasting change of the sampling rate: the user must choose a part.

A change splits windows over the log into two parts with a stable rate each. If only losses begin, the short
steps keep their length.
"""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray, median, percentile

#: Most windows: enough to place a change within a share of the log.
_MAX_WINDOWS = 400
#: Fewest samples in a window.
_MIN_SAMPLES = 32
#: Most samples in a window.
_MAX_SAMPLES = 512
#: Fewest windows of a part with a rate of its own.
_MIN_WINDOWS = 8
#: Least share of the windows in a part with a rate of its own.
_MIN_SHARE = 0.04
#: Least ratio of two rates: a smaller one may be losses.
_MIN_RATIO = 1.4
#: Least ratio of the short steps at two rates.
_MIN_SHORT_RATIO = 1.3
#: A longer step, in long steps, is a gap.
_GAP = 8
#: Least span of a window, in short steps.
_MIN_TICKS = 8
#: A rate is stable if this share of the windows is near the median.
_STABLE = 0.6
#: Relative distance from the median within which a window is near it.
_NEAR = 0.2


@dataclass(frozen=True, kw_only=True)
class Change:
    """A change of the sampling rate."""

    #: Rates before and after, in Hz.
    rates_hz: tuple[float, float]
    #: The first part ends before sample `end`; the second begins at `start`.
    end: int
    start: int


def rate_change(stamps: IntArray) -> Change | None:
    """Return the largest lasting change of the rate of stamps in ns, shape (n,); None if there is none."""
    count = min(_MAX_WINDOWS, stamps.size // _MIN_SAMPLES)
    if count < 2 * _MIN_WINDOWS:
        return None
    # An even number of steps, because steps of two sensors may alternate.
    width = min(stamps.size // count - 1, _MAX_SAMPLES) // 2 * 2
    first = np.linspace(0, stamps.size - 1 - width, count).astype(np.int64)
    steps = np.diff(stamps[first[:, None] + np.arange(width + 1)], axis=1).astype(np.float64)
    every = steps.ravel()
    if every.max() <= 0:
        return None
    counts = np.abs(steps) <= _GAP * max(median(every), percentile(every, 90))
    spans = np.where(counts, steps, 0.0).sum(axis=1)
    means = spans / np.maximum(counts.sum(axis=1), 1)
    short = np.sort(steps, axis=1)[:, width // 4]
    # A rate needs several ticks of a coarse clock.
    good = np.flatnonzero(spans > _MIN_TICKS * percentile(every[every > 0], 10))
    means, short, first = means[good], short[good], first[good]
    if good.size < 2 * _MIN_WINDOWS:
        return None
    at = _split(means)
    least = max(_MIN_WINDOWS, int(_MIN_SHARE * good.size))
    if not least <= at <= good.size - least or not _lasting(means, short, np.arange(good.size) < at):
        return None
    return Change(
        rates_hz=(1e9 / median(means[: at - 1]), 1e9 / median(means[at + 1 :])),
        end=int(first[at - 1]),
        start=int(first[at]) + width,
    )


def _split(means: FloatArray) -> int:
    """Return the first window after the change that best fits the mean steps, shape (m,)."""
    logs = np.log(means)
    sums, before = np.cumsum(logs)[:-1], np.arange(1, logs.size)
    after = logs.size - before
    contrast = (sums / before - (logs.sum() - sums) / after) ** 2 * before * after
    at = int(np.argmax(contrast[_MIN_WINDOWS - 1 : 1 - _MIN_WINDOWS])) + _MIN_WINDOWS
    # Mixed windows and outliers must not move the position.
    middle = (median(logs[:at]) + median(logs[at:])) / 2
    sides = np.where((logs > middle) == (median(logs[at:]) > middle), 1, -1)
    return int(np.argmin(np.cumsum(sides))) + 1


def _lasting(means: FloatArray, short: FloatArray, before: BoolArray) -> bool:
    levels = [(median(means[side]), median(short[side])) for side in (before, ~before)]
    for side, (mean, _) in zip((before, ~before), levels, strict=True):
        if np.mean(np.abs(means[side] / mean - 1) < _NEAR) < _STABLE:
            return False
    (fast, fast_short), (slow, slow_short) = sorted(levels)
    if slow < _MIN_RATIO * fast:
        return False
    # Short steps within batches do not depend on the sensor's rate.
    batches = fast_short < 0.5 * fast and slow_short < 0.5 * slow
    return batches or slow_short > _MIN_SHORT_RATIO * fast_short
