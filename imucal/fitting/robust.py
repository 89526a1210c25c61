"""Spikes and rounding, which make the noise of a log look larger than the sensor's.

Spikes are found by their distance from a baseline, which follows the slow parts, and are replaced by baseline
plus noise, because a spike distorts an Allan variance at every averaging time.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy

from imucal.allan.intervals import excess_kurtosis
from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding, Level
from imucal.noise.terms import AngleRandomWalk
from imucal.recording import AxisSeries, Sensor
from imucal.units import pretty

#: Samples in a block, whose median is a point of the baseline.
_BLOCK = 100
#: Blocks processed at a time, to stay in the cache.
_BLOCKS = 512
#: Deviations from the baseline that make a sample a possible spike.
_MIN_SPIKE = 5.0
#: Expected number of false spikes in a series.
_FALSE_ALARMS = 0.01
#: Standard deviation of Gaussian noise, over its median absolute deviation.
_DEVIATION = 1.4826
#: Distance, in standard deviations, that shows heavy tails.
_BODY = 3.0
#: Degrees of freedom of a Student's t that is practically Gaussian.
_GAUSSIAN = 1e4
#: Share of spikes above which the noise itself is in doubt.
_MANY = 0.01
#: Factor on N's interval above which the kurtosis may not be finite.
_UNCERTAIN = 2.0
#: Share of N² above which rounding is reported.
_NOTABLE = 0.02


def clean(series: AxisSeries) -> tuple[AxisSeries, tuple[Finding, ...]]:
    """Return the series with its spikes replaced, and findings about them and about heavy tails.

    Without spikes the same object is returned.
    """
    spike, baseline, deviation = find_spikes(series.samples)
    count = int(spike.sum())
    if not count:
        return series, _tail_finding(series, heavy_tails(series.samples))
    samples = series.samples.copy()
    noise = np.random.default_rng(952).standard_normal(count)
    share, largest = count / series.n, float(np.abs(samples[spike] - baseline[spike]).max())
    samples[spike] = baseline[spike] + deviation * noise
    times = f"{largest / deviation:.0f}" if largest < 1e4 * deviation else "over 10000"
    name = "spike was" if count == 1 else "spikes were"
    rest = heavy_tails(samples, ~(spike[1:] | spike[:-1]))
    text = (
        f"{count} {name} replaced ({100 * share:.2g} % of the samples), the largest "
        f"{largest:.3g} {pretty(series.unit)}, {times} standard deviations."
    )
    level: Level = "info"
    advice = ""
    if share > _MANY or rest > 1:
        level = "warning"
        advice = "Look for loose wiring, a shared bus or a moving sensor."
    if rest > 1:
        louder = float(np.std(np.diff(series.samples)) / np.std(np.diff(samples)) - 1)
        text += (
            " The other samples still have more outliers than normal noise, so N depends on how many are "
            "replaced: if spikes are kept (`imucal.fit(recording, clean=False)`), it is about "
            f"{100 * louder:.2g} % larger."
        )
    found = Finding(level, "spikes", text, advice, axis=series.name)
    return replace(series, samples=samples), (found, *_tail_finding(series, rest))


def find_spikes(samples: FloatArray) -> tuple[BoolArray, FloatArray, float]:
    """Return which samples are spikes, shape (n,), the baseline, and the standard deviation about it.

    If there are clearly no spikes, baseline and deviation are `samples` and 0. The baseline joins the medians
    of blocks by straight lines. A spike is farther from it than nearly all Gaussian records of this length
    reach, and beyond the noise's own tail.

    Source: Hampel (1974), JASA 69, 383 (median and median absolute deviation).
    """
    if samples.size < 20:
        return np.zeros(samples.size, dtype=bool), samples, 0.0
    reach = max(_MIN_SPIKE, -float(scipy.special.ndtri(_FALSE_ALARMS / (2 * samples.size))))
    distance = _distance(samples)
    # If the farthest sample is within reach of the median distance, there is no spike.
    near = float(distance.max()) / (reach * _DEVIATION)
    if 2 * np.count_nonzero(distance < near) < samples.size:
        return np.zeros(samples.size, dtype=bool), samples, 0.0
    baseline = _baseline(samples)
    deviation = _DEVIATION * float(np.median(distance))
    if deviation == 0:
        # More than half of the samples are on the baseline: one coarse step is no spike.
        deviation = step_size(samples) or 0.0
    if deviation == 0:
        return np.zeros(samples.size, dtype=bool), baseline, 0.0
    spike = distance > reach * deviation
    if spike.any():
        # Coarse steps round the median deviation, not the root mean square.
        spread = float(np.sqrt(np.mean(np.square(distance[~spike]))))
        wide = max(deviation, spread)
        spike = distance > _end_of_tail(distance / deviation, reach * wide / deviation) * deviation
        deviation = wide
    return spike, baseline, deviation


def _end_of_tail(distance: FloatArray, reach: float) -> float:
    """Return the end of the noise's own tail, at least `reach`; `distance`, shape (n,), in deviations.

    Beyond it there are more samples than 1.5 times a Student's t has, by more than chance.
    """
    n, count = distance.size, int(np.count_nonzero(distance > _BODY))
    normal = 2 * n * float(scipy.special.ndtr(-_BODY))
    freedom = _GAUSSIAN
    if count > normal + 3 * np.sqrt(normal) + 3:
        grid = np.geomspace(3.0, _GAUSSIAN, 64)
        of_body = 2 * n * scipy.special.stdtr(grid, -_BODY * _median_of_t(grid) * _DEVIATION)
        freedom = float(np.interp(-count, -of_body, grid))
    # The median sets the scale, because only the body is certainly noise.
    far = np.sort(distance[distance > reach])[::-1]
    expected = 2 * n * scipy.special.stdtr(freedom, -far * _median_of_t(freedom) * _DEVIATION)
    number = np.arange(1, far.size + 1)
    beyond = np.flatnonzero(scipy.special.pdtrc(number - 1, 1.5 * expected + 1e-300) < _FALSE_ALARMS)
    return float(np.nextafter(far[beyond[-1]], 0.0)) if beyond.size else np.inf


def _median_of_t(freedom: FloatArray | float) -> FloatArray:
    return np.asarray(scipy.special.stdtrit(freedom, 0.75))


def step_size(samples: FloatArray) -> float | None:
    """Return the step between the values of the samples, or None if they aren't on a grid."""
    values = np.unique(samples[:200_000])
    if not 2 < values.size <= samples[:200_000].size / 4:
        return None
    gaps = np.diff(values)
    step = float(gaps.min())
    # Values may be rounded to single precision.
    rounding = 4 * float(np.abs(values).max()) * 2.0**-23
    off_grid = np.abs(gaps / step - np.round(gaps / step)) * step
    return step if bool(np.all(off_grid <= max(rounding, 1e-6 * step))) else None


def resolution_effect(series: AxisSeries, N: float) -> tuple[Finding, ...]:
    """Return a finding on the share of rounding in `N`, if it is large.

    Rounding to steps of LSB adds white noise of variance LSB²/12, so N_sensor² = N² - LSB² tau0 / 12, if the
    noise before rounding spans half a step.

    Source: Sheppard's correction; Widrow & Kollar (2008), "Quantization noise", ch. 4.
    """
    step = step_size(series.samples)
    if step is None or not N > 0:
        return ()
    rounding = step**2 * series.tau0 / 12
    share = rounding / N**2
    if share < _NOTABLE:
        return ()
    ratio = N / np.sqrt(series.tau0) / step
    what = f"Samples come in steps of {step:.3g} {pretty(series.unit)}, {1 / ratio:.2g} times their noise"
    gyroscope, accelerometer = AngleRandomWalk.units
    unit = pretty(gyroscope if series.sensor is Sensor.GYROSCOPE else accelerometer)
    if ratio < 0.5 or share >= 1:
        text = f"{what}. N = {N:.4g} {unit} is mostly rounding; the sensor's own N is unknown."
        advice = "Record with a smaller measuring range or more bits."
        return (Finding("warning", "rounding", text, advice, axis=series.name),)
    text = (
        f"{what}. Rounding is {100 * (1 - np.sqrt(1 - share)):.1f} % of N = {N:.4g}; without it N = "
        f"{np.sqrt(N**2 - rounding):.4g} {unit}."
    )
    return (Finding("info", "rounding", text, axis=series.name),)


def _baseline(samples: FloatArray) -> FloatArray:
    baseline = np.empty(samples.size)
    for part, line in _baseline_parts(samples):
        baseline[part] = line
    return baseline


def _distance(samples: FloatArray) -> FloatArray:
    distance = np.empty(samples.size)
    for part, line in _baseline_parts(samples):
        np.abs(samples[part] - line, out=distance[part])
    return distance


def _baseline_parts(samples: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
    n = samples.size
    block = min(_BLOCK, n)
    medians = _medians(samples, block)
    half = block // 2
    yield slice(0, half), np.full(half, medians[0])
    fraction = (np.arange(block) + 0.5) / block
    for first in range(0, medians.size - 1, _BLOCKS):
        rise = np.diff(medians[first : first + _BLOCKS + 1])
        between = medians[first : first + rise.size, np.newaxis] + fraction * rise[:, np.newaxis]
        start = half + first * block
        yield slice(start, start + between.size), between.ravel()
    start = half + (medians.size - 1) * block
    yield slice(start, n), np.full(n - start, medians[-1])


def _medians(samples: FloatArray, block: int) -> FloatArray:
    """Return the medians of whole blocks; NumPy's median takes four times as long."""
    count, half = samples.size // block, block // 2
    medians = np.empty(count)
    for first in range(0, count, _BLOCKS):
        last = min(first + _BLOCKS, count)
        parted = np.partition(samples[first * block : last * block].reshape(-1, block), half, axis=1)
        middle = parted[:, half]
        medians[first:last] = middle if block % 2 else 0.5 * (parted[:, :half].max(axis=1) + middle)
    return medians


def _tail_finding(series: AxisSeries, factor: float) -> tuple[Finding, ...]:
    if factor < _UNCERTAIN:
        return ()
    text = (
        "Large samples are far more frequent than in normal noise (excess kurtosis "
        f"{2 * factor**2 - 2:.2g}). A few samples determine N, and its interval may be too narrow."
    )
    advice = "Plot a histogram of the samples, and look for an intermittent disturbance."
    return (Finding("warning", "heavy-tails", text, advice, axis=series.name),)


def heavy_tails(samples: FloatArray, neighbours: BoolArray | None = None) -> float:
    """Return the factor by which heavy tails widen N's interval, at least 1.

    The variance of the logarithm of white noise's mean square is (2 + k)/n with its excess kurtosis k; the
    excess kurtosis of its steps is k/2.
    """
    if samples.size < 2:
        return 1.0
    excess = 2 * excess_kurtosis(samples, neighbours)
    chance = 8 * float(np.sqrt(24 / (samples.size - 1)))
    return float(np.sqrt(1 + excess / 2)) if excess > chance else 1.0
