"""Warm-up: a drift at the start that dies away, larger than the axis's own later wander."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.screening.profile import Blocks, Profile, blocks
from imucal.screening.words import amount, time
from imucal.solvers import non_negative

#: Numbers of means tried: many see a quick warm-up, few average more noise away. With each, how many
#: deviations of the wander over as long a span the drift must be; few means know that wander less well.
_LIMITS = {64: 7.0, 32: 9.0}
#: Spans, in blocks, over which the start may drift: up to a quarter of the log.
_SPANS = (1, 2, 4, 8, 16)
#: The drift must be this much larger than the largest move of the rest.
_BEYOND = 1.7
#: Drift that has not settled by this part of the log never does.
_LATEST = 0.6
#: A shorter log, in s, warms up by nothing one could tell from a touch.
_LEAST_S = 60.0


def check_warm_up(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding where the mean moves at the start as it never does later.

    The wander over a span of k blocks has variance 2 a + b k, white noise and random walk, fitted
    to the last three quarters of the log, whose steady slope is taken off.
    """
    if profile.series.duration_s < _LEAST_S:
        return ()
    for count, limit in _LIMITS.items():
        means = blocks(profile, count)
        if means.mean.size >= 0.75 * count:
            level = _without_later_slope(means)
            if _drifts(level, limit):
                return (_finding(profile, means, level[level.size // 4 :]),)
    return ()


def _without_later_slope(means: Blocks) -> FloatArray:
    """Return the means less the straight line between the ends of their last three quarters."""
    first = means.mean.size // 4
    seconds, mean = means.time_s, means.mean - means.mean[-1]
    slope = np.polyfit(seconds[first:], mean[first:], 1)[0]
    level: FloatArray = mean - slope * (seconds - seconds[-1])
    return level


def _drifts(level: FloatArray, limit: float) -> bool:
    rest = level[level.size // 4 :]
    spans = [k for k in _SPANS if k <= level.size // 4]
    moves = [np.abs(rest[k:] - rest[:-k]) for k in spans]
    squares = np.array([np.mean(m**2) for m in moves])
    if not squares[0] > 0:
        return False
    deviation = np.sqrt(_wander(np.array(spans, dtype=np.float64), squares))
    largest = np.array([m.max() for m in moves])
    start = np.abs(level[spans] - level[0])
    return bool(np.any((start > limit * deviation) & (start > _BEYOND * largest)))


def _wander(spans: FloatArray, squares: FloatArray) -> FloatArray:
    """Return 2 a + b k fitted to the mean squares over spans k, a and b not negative."""
    # The relative deviation of a mean square grows as sqrt(k): it holds fewer independent spans.
    weight = 1 / (squares * np.sqrt(spans))
    design = np.stack([np.ones_like(spans), spans], axis=1)
    coefficients, _ = non_negative(design * weight[:, None], squares * weight)
    wander: FloatArray = np.maximum(design @ coefficients, squares)
    return wander


def _finding(profile: Profile, means: Blocks, later: FloatArray) -> Finding:
    series = profile.series
    end = means.mean[-means.mean.size // 4 :]
    away = np.abs(means.mean - end.mean())
    settled = away <= max(2 * float(end.std()), 2 * float(later.std()), 0.05 * float(away[0]))
    seconds = float(means.time_s[int(settled.argmax())])
    drift = amount(float(away[0]), series.sensor)
    if seconds > _LATEST * series.duration_s:
        return Finding(
            level="warning",
            code="warm-up",
            text=f"{series.name} drifts by {drift} from the start and has not settled by the end.",
            advice="Let the IMU warm up first: record again after half an hour of power.",
            axis=series.name,
        )
    return Finding(
        level="warning",
        code="warm-up",
        text=f"{series.name} drifts by {drift} during the first {time(seconds)}, then settles: a warm-up.",
        advice=f"Leave the first {time(seconds)} out; the drift would be fitted as a random walk.",
        axis=series.name,
        keep_s=(round(seconds, 1), round(series.duration_s, 1)),
    )
