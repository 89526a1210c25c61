"""Does an axis follow the IMU's temperature."""

from collections.abc import Sequence

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.recording import Temperature
from imucal.screening.profile import Profile, blocks
from imucal.screening.words import amount

#: Means compared with the temperature.
_BLOCKS = 64
#: Random walk in a block over the white noise of its mean, in variance, that are tried.
_WALKS = (0.0, *np.logspace(-3, 3, 13).tolist())
#: The slope must be this many standard deviations: the noise it is judged by was itself estimated.
_LIMIT = 7.0
#: Least change, in degrees: below it the thermometer's own noise is all there is.
_LEAST_CHANGE = 0.3
#: A change that is worth a word of its own, in degrees.
_LARGE_CHANGE = 3.0


def check_temperature(profiles: Sequence[Profile], temperature: Temperature | None) -> tuple[Finding, ...]:
    """Return a finding for each axis that follows the temperature, or one for a large change alone.

    The slope is found by generalised least squares, with the residual taken for white noise and a
    random walk: two random walks correlate in level though unrelated, and plain regression would
    say so.
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
    series = profile.series
    means = blocks(profile, _BLOCKS)
    if means.mean.size < 0.5 * _BLOCKS:
        return None
    slope, error = _slope(_block_means(seconds, degrees, means.time_s), means.mean)
    if not abs(slope) > _LIMIT * error:
        return None
    return Finding(
        level="warning",
        code="temperature",
        text=(
            f"{series.name} follows the temperature: {amount(abs(slope), series.sensor)} per degree C, "
            f"over {change:.1f} degrees C."
        ),
        advice="Record at a steady temperature, or compensate first; K and B hold the temperature's drift.",
        axis=series.name,
    )


def _slope(temperature: FloatArray, mean: FloatArray) -> tuple[float, float]:
    """Return the slope, in U per degree, and its standard deviation; shape (k,) both.

    The ratio of random walk to white noise is the one of the largest restricted likelihood
    (Patterson & Thompson 1971, Biometrika 58(3)).
    """
    k = mean.size
    design = np.stack([np.ones(k), temperature - temperature.mean()], axis=1)
    walk = np.minimum.outer(np.arange(1.0, k + 1), np.arange(1.0, k + 1))
    best = (-np.inf, 0.0, np.inf)
    for ratio in _WALKS:
        root = np.linalg.cholesky(np.eye(k) + ratio * walk)
        x, y = np.linalg.solve(root, design), np.linalg.solve(root, mean - mean[0])
        normal = x.T @ x
        if not normal[1, 1] > 0:
            continue
        beta = np.linalg.solve(normal, x.T @ y)
        variance = float(np.sum((y - x @ beta) ** 2)) / (k - 2)
        if not variance > 0:
            return (0.0, np.inf)
        likelihood = (
            -np.log(np.diag(root)).sum()
            - 0.5 * np.linalg.slogdet(normal)[1]
            - 0.5 * (k - 2) * np.log(variance)
        )
        error = float(np.sqrt(variance * np.linalg.inv(normal)[1, 1]))
        best = max(best, (float(likelihood), float(beta[1]), error))
    return best[1], best[2]


def _block_means(seconds: FloatArray, degrees: FloatArray, middle: FloatArray) -> FloatArray:
    """Return the mean temperature around each block's middle, shape of `middle`."""
    half = float(np.median(np.diff(middle))) / 2
    total = np.concatenate([[0.0], np.cumsum(degrees - degrees[0])])
    first = np.searchsorted(seconds, middle - half)
    last = np.maximum(np.searchsorted(seconds, middle + half), first + 1)
    first, last = np.minimum(first, degrees.size - 1), np.minimum(last, degrees.size)
    means: FloatArray = (total[last] - total[first]) / (last - first)
    return means
