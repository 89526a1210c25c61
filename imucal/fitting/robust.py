"""Spikes, torn reads and rounding, which make the noise of a log look larger than the sensor's.

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
#: Steps per high byte.
_BYTE = 256
#: Fewest samples of a search for torn reads; 0.1 % of them is then one sample.
_MIN_TORN_SAMPLES = 1000
#: Noise in steps below which torn reads are spikes.
_LEAST_TORN_NOISE = 5.0
#: Noise in steps above which torn reads are within the noise.
_MOST_TORN_NOISE = 200.0
#: Largest distance from the grid of steps, in steps: with an offset the high bytes are unknown.
_ON_GRID = 0.1
#: Largest log odds of one sample, so that one spike alone is no torn read.
_MOST_LOG_ODDS = 9.0
#: Shares of torn reads that are tried.
_TORN_SHARES = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
#: Least share of steps between samples that change the high byte: with fewer, a few outliers would decide.
_PASSING = 0.05
#: Distance of the other places where high bytes might begin, in steps.
_TORN_SHIFT = 32
#: Least gain of the log likelihood: chance exceeds it in 1e-5 of all normal records.
_TORN_GAIN = 12.0
#: Least ratio of that gain to the gain of the nearest two places.
_NEAREST = 1.2
#: Least ratio of that gain to the gain of all other places: with heavy tails it is up to 3.
_OTHERS = 4.0


def clean(series: AxisSeries) -> tuple[AxisSeries, tuple[Finding, ...]]:
    """Return the series with its spikes replaced, and findings about them and about heavy tails.

    Torn reads are corrected before. Without spikes and torn reads the same object is returned.
    """
    series, torn = without_torn_reads(series)
    series, findings = _without_spikes(series)
    return series, torn + findings


def _without_spikes(series: AxisSeries) -> tuple[AxisSeries, tuple[Finding, ...]]:
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


def without_torn_reads(series: AxisSeries) -> tuple[AxisSeries, tuple[Finding, ...]]:
    """Return the series with torn 16-bit reads corrected, and a finding if there are any.

    A torn read has the high byte of the sample before or after it. It is wrong by 256 steps if the value
    passed a multiple of 256 steps in between. For normal noise of density p the low byte l has the density
    sum over j of p(l + 256 j). A mixture of both is compared with that of high bytes that begin elsewhere,
    because heavy tails make all of them likely.
    """
    samples = series.samples
    step = step_size(samples)
    if step is None or samples.size < _MIN_TORN_SAMPLES:
        return series, ()
    counts = np.rint(samples / step)
    distance = counts - _baseline(counts)
    deviation = _DEVIATION * float(np.median(np.abs(distance)))
    on_grid = float(np.abs(samples / step - counts).max()) < _ON_GRID
    passing = 1 - float(np.mean(_same_high_byte(counts, shift=0, side=1)))
    if not (on_grid and passing > _PASSING and _LEAST_TORN_NOISE < deviation < _MOST_TORN_NOISE):
        return series, ()
    chances = np.exp(
        [
            np.clip(-jump * (distance + jump / 2) / deviation**2, -700, _MOST_LOG_ODDS)
            for jump in (-_BYTE, _BYTE)
        ]
    )
    ratio = 1 + chances.sum(axis=0)
    shifts = range(0, _BYTE, _TORN_SHIFT)
    gains = {
        side: [_torn_gain(counts, ratio, shift=shift, side=side) for shift in shifts] for side in (-1, 1)
    }
    side = max(gains, key=lambda side: gains[side][0])
    (gain, share), *elsewhere = gains[side]
    nearest = max(elsewhere[0][0], elsewhere[-1][0])
    others = max(other for other, _ in elsewhere[1:-1])
    if gain < max(_TORN_GAIN, _NEAREST * nearest, _OTHERS * others):
        return series, ()
    wrong = share * chances * _same_high_byte(counts, shift=0, side=side) > 1
    corrected = samples + step * _BYTE * (wrong[1].astype(np.float64) - wrong[0])
    text = (
        f"About {100 * share:.1g} % of the reads are torn: their high byte is that of the sample "
        f"{'after' if side < 0 else 'before'}, which is wrong by 256 steps. {int(wrong.sum())} samples were "
        "corrected; others can't be told from noise, and N may be too large by a percent."
    )
    advice = "Read both bytes of a sample at once (burst read, or block data update of the sensor)."
    finding = Finding("warning", "torn-reads", text, advice, axis=series.name)
    return replace(series, samples=corrected), (finding,)


def _same_high_byte(counts: FloatArray, *, shift: int, side: int) -> BoolArray:
    high = np.floor((counts + shift) / _BYTE)
    return np.asarray(high == np.roll(high, side))


def _torn_gain(counts: FloatArray, ratio: FloatArray, *, shift: int, side: int) -> tuple[float, float]:
    """Return the largest gain of the log likelihood by torn reads, and their share."""
    excess = np.where(_same_high_byte(counts, shift=shift, side=side), ratio, 0.0) - 1
    return max((float(np.log1p(share * excess).sum()), share) for share in _TORN_SHARES)


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
