"""Jumps of the level that stay: a tilted table, a bias that switches.

Warm-up: a drift at the start that dies away, larger than the axis's own later wander.

Does an axis follow the IMU's temperature.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.recording import Temperature
from imucal.screening.windows import Blocks, Profile, amount, blocks, time
from imucal.solvers import non_negative

#: A step must stand out by this many robust deviations: chance gives 5 once in a million.
_LIMIT = 9.0
#: Steps are looked for between means of 2^j windows, while this many of them fit into the log.
_LEAST_MEANS = 40
#: Nearer to the ends of the log than this part of it, a jump is no level that stays.
_CLEAR = 0.05
#: Median of |normal|.
_MEDIAN_NORMAL = 0.6744898


@dataclass(frozen=True, slots=True)
class _Step:
    score: float
    time_s: float
    height: float


def check_steps(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding for the largest jump that stands out of the axis's own wander.

    The mean after each moment minus the mean before it, over spans of doubling length; noise of any
    colour makes these differences normal, with a deviation that their median gives.
    """
    step = _largest(profile)
    if step is None:
        return ()
    series = profile.series
    first = step.time_s > series.duration_s / 2
    keep = (0.0, round(step.time_s - 1, 1)) if first else (round(step.time_s + 1, 1), series.duration_s)
    return (
        Finding(
            level="warning",
            code="step",
            text=(
                f"The level of {series.name} jumps by {amount(abs(step.height), series.sensor)} at "
                f"{step.time_s:.1f} s and stays there."
            ),
            advice=(
                "Fix the IMU so that nothing tilts it, and keep one side of the jump: "
                "the jump would be fitted as a random walk."
            ),
            axis=series.name,
            keep_s=keep,
        ),
    )


def _largest(profile: Profile) -> _Step | None:
    windows = profile.windows
    rest = ~profile.disturbed
    mean, seconds = windows.mean[rest], windows.time_s[rest]
    # Without the noise to dither it, a value toggles by an LSB when its mean moves by none at all.
    lsb = profile.lsb or 0.0
    least = lsb if profile.noise < 0.5 * lsb else 0.0
    best: _Step | None = None
    span = 2
    while span * _LEAST_MEANS <= mean.size:
        jumps, places = _jumps(mean, span)
        scale = float(np.median(np.abs(jumps))) / _MEDIAN_NORMAL
        clear = max(0, int(_CLEAR * mean.size) - span)
        top = clear + int(np.abs(jumps[clear : jumps.size - clear]).argmax())
        height = float(jumps[top])
        score = abs(height) / scale if scale > 0 else 0.0
        if score > _LIMIT and abs(height) > least and (best is None or score > best.score):
            best = _Step(score, float(seconds[places[top]]), height)
        span *= 2
    return best


def _jumps(mean: FloatArray, span: int) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the next `span` windows minus that of the last, and the index between them."""
    total = np.concatenate([[0.0], np.cumsum(mean - mean[0])])
    jumps = (total[2 * span :] - 2 * total[span:-span] + total[: -2 * span]) / span
    return jumps, np.arange(span, span + jumps.size)


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


#: Means compared with the temperature.
_BLOCKS = 64
#: Random walk in a block over the white noise of its mean, in variance, that are tried.
_WALKS = (0.0, *np.logspace(-3, 3, 13).tolist())
#: The slope must be this many standard deviations: the noise it is judged by was itself estimated.
_TEMPERATURE_LIMIT = 7.0
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
    if not abs(slope) > _TEMPERATURE_LIMIT * error:
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
