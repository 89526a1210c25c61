"""Do several sensors share this log? Then the samples alternate between their noises and levels.

Noise whose variance repeats after p samples correlates Fourier coefficients a p-th of the sampling rate
apart. Coefficients of stationary noise are uncorrelated, whatever its spectrum. Only their phases are used,
so that a tone counts no more than any other frequency.

Source: Gardner (1991), IEEE Signal Process. Mag. 8(2), "Exploitation of spectral redundancy".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.recording import AxisSeries, Sensor
from imucal.screening.windows import Profile, amount, name_list

#: Periods of the patterns A B, A B C and A A B B, in samples.
_PERIODS = (2, 3, 4)
#: Number of stretches of a log, spread evenly over it; their scatter gives the limits.
_STRETCHES = 32
#: Fewest samples of a stretch: the mean over its phases is then nearly normal.
_SHORTEST = 128
#: Most samples of a stretch: 32 transforms take about 5 ms.
_LONGEST = 8192
#: Mean over its standard error of 32 stretches: chance exceeds 6 in 1.2e-6 of all cases.
_SURE = 6.0
#: Least mean cosine: variances that differ by 13 %.
_NOTABLE = 0.05
#: Largest correlation of successive samples of two sensors; that of interpolated ones is above 0.3.
_INDEPENDENT = 0.2
#: Share of the frequencies at either end that is left out: slow noise, and pairs of a frequency with itself.
_ENDS = 0.05
#: Least difference of two levels, in standard deviations of the noise: less may be dither.
_APART = 5.0
#: The same, in steps of the values.
_APART_STEPS = 4.0
#: Largest scatter of that difference, relative to it: a tone near the Nyquist frequency drifts.
_CONSTANT = 0.2
#: Largest difference within the pairs of A A B B, relative to it: a tone at a quarter of the rate has none.
_PAIRED = 0.05
#: Number of axes whose levels differ; one may have a tone of its own.
_AXES = 2
#: Share of repeated samples above which the pattern is that of the repetitions.
_REPEATED = 0.05


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """A pattern of `period` samples: noise and level of each place, shape (period,), in U."""

    period: int
    noise: FloatArray
    level: FloatArray
    noise_differs: bool
    level_differs: bool


def check_interleaved(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error for each sensor whose samples alternate between several sensors."""
    findings = []
    for sensor in Sensor:
        group = [p for p in profiles if p.series.sensor is sensor and not p.constant]
        for period in _PERIODS:
            patterns = {p.name: pattern for p in group if (pattern := pattern_of(p, period))}
            noisy = [name for name, pattern in patterns.items() if pattern.noise_differs]
            apart = [name for name, pattern in patterns.items() if pattern.level_differs]
            if noisy:
                findings.append(_finding(sensor, "noise", noisy[0], patterns[noisy[0]].noise))
            elif len(apart) >= _AXES:
                findings.append(_finding(sensor, "level", apart[0], patterns[apart[0]].level))
            else:
                continue
            break
    return tuple(findings)


def _finding(sensor: Sensor, what: str, axis: str, values: FloatArray) -> Finding:
    count = {2: "Two", 3: "Three", 4: "Two"}[values.size]
    text = (
        f"{count} sensors share this log: the {what} of {axis} repeats after {values.size} samples, "
        f"{name_list([amount(value, sensor) for value in values.tolist()])}."
    )
    advice = (
        "Record each sensor in a topic or file of its own, or keep the rows of one of them, for example by "
        "their frame_id."
    )
    return Finding("error", "interleaved-sensors", text, advice, axis=sensor.short)


def pattern_of(profile: Profile, period: int) -> Pattern | None:
    """Return the pattern of an axis; None if it has too few samples without gaps, or repeats many of them."""
    pieces = _stretches(profile.series, period)
    if pieces is None or float(np.mean(np.diff(pieces, axis=1) == 0)) > _REPEATED:
        return None
    cosines = _cosines(pieces, period)
    mean, error = cosines.mean(axis=0), cosines.std(axis=0, ddof=1) / np.sqrt(len(pieces))
    coherence = float(np.linalg.norm(mean))
    phased = bool(np.any(np.abs(mean) > _SURE * error)) and coherence > _NOTABLE
    places = pieces[:, : pieces.shape[1] // period * period].reshape(len(pieces), -1, period)
    noise = np.sqrt(0.5 * np.median(np.mean(np.square(np.diff(places, axis=1)), axis=1), axis=0))
    level = (places - places.mean(axis=2, keepdims=True)).mean(axis=1)
    apart, scatter = float(np.ptp(level.mean(axis=0))), float(level.std(axis=0).max())
    steps = _APART_STEPS * (profile.lsb or 0.0)
    # Any three levels may be a tone at a third of the rate.
    paired = period % 2 == 0 and _within_pairs(level.mean(axis=0)) < _PAIRED * apart
    stays = paired and scatter < _CONSTANT * apart
    return Pattern(
        period=period,
        noise=noise,
        level=level.mean(axis=0) + float(pieces.mean()),
        noise_differs=phased and abs(_correlation(pieces, period)) < _INDEPENDENT,
        level_differs=stays and apart > max(_APART * float(noise.min()), steps),
    )


def _within_pairs(level: FloatArray) -> float:
    """Return the least difference within the pairs A A and B B; a tone at a quarter of the rate has none."""
    if level.size == 2:
        return 0.0
    return float(min(np.abs(level - np.roll(level, 1)).reshape(2, 2)[:, place].max() for place in (0, 1)))


def _correlation(pieces: FloatArray, period: int) -> float:
    """Return the correlation of samples of different sensors, without slow noise."""
    steps = pieces[:, period:] - pieces[:, :-period]
    apart = period // 2
    one, other = steps[:, apart:], steps[:, :-apart]
    return float(np.vdot(one, other) / np.linalg.norm(one) / np.linalg.norm(other))


def _stretches(series: AxisSeries, period: int) -> FloatArray | None:
    """Return stretches without gaps that begin at multiples of the period, shape (32, m); None if too few."""
    least = 4 * period
    size = min(series.n // _STRETCHES, _LONGEST) // least * least
    while size >= _SHORTEST:
        firsts: list[int] = []
        for segment in series.clock.segments:
            start = segment.start + -segment.offset % period
            firsts += range(start, segment.stop - size + 1, size)
        if len(firsts) >= _STRETCHES:
            chosen = np.linspace(0, len(firsts) - 1, _STRETCHES).astype(np.int64)
            return np.stack([series.samples[firsts[i] : firsts[i] + size] for i in chosen.tolist()])
        size = size // 2 // least * least
    return None


def _cosines(pieces: FloatArray, period: int) -> FloatArray:
    """Return the mean product of phases a p-th of the rate apart, real and imaginary part, shape (32, 2)."""
    size = pieces.shape[1]
    shift = size // period
    # A window, because the ends of a drift would correlate all frequencies.
    taper = np.hanning(size + 1)[:-1]
    deviations = (pieces - pieces.mean(axis=1, keepdims=True)) * taper
    spectra = np.fft.fft(deviations, axis=1)
    sizes = np.abs(spectra)
    phases = np.divide(spectra, sizes, out=np.zeros_like(spectra), where=sizes > 0)
    # Every second one, because the window correlates neighbours.
    first = np.arange(0, size, 2)
    second = (first + shift) % size
    fraction = np.minimum(first, size - first) / size
    partner = np.minimum(second, size - second) / size
    usable = (fraction > _ENDS) & (partner > _ENDS)
    usable &= (np.abs(fraction - 0.5) > _ENDS / 2) & (np.abs(fraction - partner) > _ENDS)
    products = phases[:, first[usable]] * phases[:, second[usable]].conj()
    mean = products.mean(axis=1)
    return np.stack([mean.real, mean.imag], axis=1)
