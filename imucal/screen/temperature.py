"""Does an axis follow the IMU's temperature."""

from collections.abc import Sequence

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.recording import Temperature
from imucal.screen.blocks import blocks
from imucal.screen.profile import Profile
from imucal.screen.words import amount

__all__ = ["check_temperature"]

#: Numbers of blocks tried: few average white noise away, many give more to correlate.
_COUNTS = (12, 24, 48, 96)
#: How often unrelated series may correlate so well by chance, each count of blocks.
_FALSE_ALARM = 1e-5
#: Least change, in degrees: below it the thermometer's own noise is all there is.
_LEAST_CHANGE = 0.3
#: A change that is worth a word of its own, in degrees.
_LARGE_CHANGE = 3.0


def check_temperature(profiles: Sequence[Profile], temperature: Temperature | None) -> tuple[Finding, ...]:
    """Return a finding for each axis that follows the temperature, or one for a large change alone.

    What correlates are the changes from block to block: two random walks correlate in level
    though unrelated, but not in their steps.
    """
    if temperature is None or not np.isfinite(temperature.samples).any():
        return ()
    seconds, degrees = _finite(temperature)
    change = float(np.ptp(np.convolve(degrees, np.full(9, 1 / 9), "valid"))) if degrees.size > 32 else 0.0
    if change < _LEAST_CHANGE:
        return ()
    found = [finding for p in profiles if (finding := _follows(p, seconds, degrees, change))]
    if not found and change > _LARGE_CHANGE:
        text = f"The temperature changes by {change:.1f} degrees C during the log; no axis follows it."
        return (Finding(level="info", code="temperature", text=text),)
    return tuple(found)


def _finite(temperature: Temperature) -> tuple[FloatArray, FloatArray]:
    keep = np.isfinite(temperature.samples)
    seconds = temperature.clock.grid().astype(np.float64) / temperature.clock.rate_hz
    return seconds[keep], temperature.samples[keep]


def _follows(profile: Profile, seconds: FloatArray, degrees: FloatArray, change: float) -> Finding | None:
    best = (1.0, 0.0, 0.0)
    for count in _COUNTS:
        best = min(best, _correlation(profile, seconds, degrees, count))
    chance, correlation, slope = best
    if chance > _FALSE_ALARM:
        return None
    series = profile.series
    return Finding(
        level="warning",
        code="temperature",
        text=(
            f"{series.name} follows the temperature: {amount(abs(slope), series.sensor)} per degree C, "
            f"over {change:.1f} degrees C (correlation {correlation:.2f})."
        ),
        advice="Record at a steady temperature, or compensate first; K and B hold the temperature's drift.",
        axis=series.name,
    )


def _correlation(
    profile: Profile, seconds: FloatArray, degrees: FloatArray, count: int
) -> tuple[float, float, float]:
    """Return probability by chance, correlation and slope, in U per degree, of the blocks' changes."""
    from scipy.special import stdtr

    means = blocks(profile, count)
    if means.mean.size < max(8, 0.75 * count):
        return (1.0, 0.0, 0.0)
    warmth = _block_means(seconds, degrees, means.time_s)
    x, y = np.diff(warmth), np.diff(means.mean)
    x, y = x - x.mean(), y - y.mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if not (xx > 0 and yy > 0):
        return (1.0, 0.0, 0.0)
    correlation = xy / np.sqrt(xx * yy)
    freedom = x.size - 2
    t = abs(correlation) * np.sqrt(freedom / max(1 - correlation**2, 1e-12))
    return (float(2 * stdtr(freedom, -t)), correlation, xy / xx)


def _block_means(seconds: FloatArray, degrees: FloatArray, middle: FloatArray) -> FloatArray:
    """Return the mean temperature around each block's middle, shape of `middle`."""
    half = float(np.median(np.diff(middle))) / 2
    total = np.concatenate([[0.0], np.cumsum(degrees - degrees[0])])
    first = np.searchsorted(seconds, middle - half)
    last = np.maximum(np.searchsorted(seconds, middle + half), first + 1)
    first, last = np.minimum(first, degrees.size - 1), np.minimum(last, degrees.size)
    means: FloatArray = (total[last] - total[first]) / (last - first)
    return means
