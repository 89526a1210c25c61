"""Variances of a series with missing samples; nothing is ever interpolated.

windows
    For ``overlapping``: the means of two neighbouring windows of what is there, each at least half
    as filled as the whole series, less what the losses add. A mean of C of m samples scatters more
    than one of all m, by (1/C - 1/m) S² for losses at random, S² the variance inside windows: with
    10 % lost, white noise would read 11 % too high. Where losses come in bursts, S² weighs the
    covariance inside windows with the correlation of the pattern of losses.
runs
    For the other estimators: complete differences inside unbroken runs.

Source: the finite-population correction, Cochran (1977), Sampling Techniques, ch. 2. The estimator
from all pairs of samples (Mondal & Percival, 2010, Ann. Inst. Stat. Math. 62) is unbiased as well,
but where white noise rules at long averaging times it scatters up to four times as much.
"""

from dataclasses import dataclass

import numpy as np

from imucal.allan.estimators import Estimator
from imucal.allan.variance import square_sums, sum_of_squares
from imucal.arrays import FloatArray, IntArray
from imucal.clock import Clock
from imucal.recording import AxisSeries

#: Elements of a work array.
_BLOCK = 32768

#: The pattern of losses is followed for so many mean gaps, and at most so many samples.
_MEAN_GAPS, _LONGEST = 4, 256

#: Places of the grid that one FFT takes when the pattern is correlated.
_CHUNK = 1 << 17


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GappyVariances:
    """Variances at the factors that the data could give.

    Attributes
    ----------
    m
        Averaging factors, shape (k,).
    avar
        Variances, all positive, shape (k,), in U².
    terms
        Number of differences behind each, shape (k,).
    inflation
        Mean square before what the losses add was taken out, over `avar`, shape (k,).
    """

    m: IntArray
    avar: FloatArray
    terms: FloatArray
    inflation: FloatArray


def longest_run(clock: Clock) -> int:
    """Return the number of samples of the longest unbroken run."""
    return max((stop - start for start, stop in _runs(clock)), default=0)


def window_variances(series: AxisSeries, m: IntArray) -> GappyVariances:
    """Return overlapping variances from windows that are at least half as filled as the whole series.

    A value that is not positive after the losses' part is taken out is left out. Cost some 4 ns per
    place of the grid and factor; memory three full-length arrays.
    """
    pattern = _pattern(series)
    integrals = _integrals(series)
    share = series.n / series.clock.grid_size / 2
    raw, added, counts = np.zeros((3, m.size))
    for i, factor in enumerate(m.tolist()):
        found = _windows(integrals, factor, max(share * factor, 1.0))
        counts[i] = found.count
        if found.count:
            raw[i] = found.squares / found.count / 2
            added[i] = found.lost / found.count / 2 * pattern.variance(found.inside, factor)
    return _positive(m, raw - added, counts, raw)


def run_variances(series: AxisSeries, m: IntArray, estimator: Estimator) -> GappyVariances:
    """Return variances of any estimator from the differences that lie inside unbroken runs."""
    sums, counts = np.zeros(m.size), np.zeros(m.size)
    for start, stop in _runs(series.clock):
        fits = m <= estimator.largest(stop - start)
        if fits.any():
            sums[fits] += square_sums(series.samples[start:stop], m[fits], estimator)
            counts[fits] += [estimator.terms(stop - start, mi) for mi in m[fits].tolist()]
    scale = np.array([estimator.scale(mi) for mi in m.tolist()])
    avar = sums / scale / np.maximum(counts, 1)
    return _positive(m, avar, counts, avar)


def _positive(m: IntArray, avar: FloatArray, terms: FloatArray, raw: FloatArray) -> GappyVariances:
    """Leave out what has no difference or came out negative; a constant series is zero throughout."""
    keep = (terms >= 1) & ((avar > 0) | (raw == 0))
    m, avar, terms, raw = m[keep], avar[keep], terms[keep], raw[keep]
    inflation = np.divide(raw, avar, out=np.ones(m.size), where=avar > 0)
    return GappyVariances(m=m, avar=avar, terms=terms, inflation=np.maximum(inflation, 1.0))


def _runs(clock: Clock) -> list[tuple[int, int]]:
    """Return start and stop of every unbroken run; segments that touch on the grid are one."""
    runs: list[tuple[int, int]] = []
    end = -1
    for segment in clock.segments:
        if runs and segment.offset == end:
            runs[-1] = (runs[-1][0], segment.stop)
        else:
            runs.append((segment.start, segment.stop))
        end = segment.offset + segment.size
    return runs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Integrals:
    """Running sums on the even grid, each of shape (grid + 1,): of samples, squares and counts."""

    values: FloatArray
    squares: FloatArray
    filled: FloatArray


def _integrals(series: AxisSeries) -> _Integrals:
    clock, mean = series.clock, float(series.samples.mean())
    values, filled = np.zeros(clock.grid_size + 1), np.zeros(clock.grid_size + 1)
    for segment in clock.segments:
        start = segment.offset - clock.segments[0].offset + 1
        place = slice(start, start + segment.size)
        np.subtract(series.samples[segment.start : segment.stop], mean, out=values[place])
        filled[place] = 1.0
    squares = np.square(values)
    for amounts in (values, squares, filled):
        np.cumsum(amounts, out=amounts)
    return _Integrals(values=values, squares=squares, filled=filled)


@dataclass(slots=True)
class _Found:
    """What the windows of one factor hold.

    The sum of squared differences, their number, the sum of 1/C - 1/m over both windows of each, and
    the pooled variance inside windows as its sum of squares and its degrees of freedom.
    """

    squares: float = 0.0
    count: float = 0.0
    lost: float = 0.0
    scatter: float = 0.0
    freedom: float = 0.0

    @property
    def inside(self) -> float:
        """Mean variance inside windows, in U²."""
        return self.scatter / self.freedom if self.freedom > 0 else 0.0


def _windows(integrals: _Integrals, m: int, fewest: float) -> _Found:
    """Go through all pairs of neighbouring windows of `m` places with at least `fewest` filled."""
    found = _Found()
    total = integrals.values.size - 2 * m
    for start in range(0, total, _BLOCK):
        stop = min(start + _BLOCK, total)
        first, first_size = _mean(integrals, m, start, stop, found)
        second, second_size = _mean(integrals, m, start + m, stop + m, found)
        both = (first_size >= fewest) & (second_size >= fewest)
        second -= first
        second *= both
        found.squares += sum_of_squares(second)
        found.count += float(np.count_nonzero(both))
        lost = 1 / np.maximum(first_size, 1.0) + 1 / np.maximum(second_size, 1.0) - 2 / m
        found.lost += float(lost.sum(where=both))
    return found


def _mean(
    integrals: _Integrals, m: int, start: int, stop: int, found: _Found
) -> tuple[FloatArray, FloatArray]:
    """Return mean and number of samples of the windows from `start` to `stop`; count their scatter."""
    values, squares, filled = integrals.values, integrals.squares, integrals.filled
    total = values[start + m : stop + m] - values[start:stop]
    size: FloatArray = filled[start + m : stop + m] - filled[start:stop]
    mean: FloatArray = total / np.maximum(size, 1.0)
    scatter = squares[start + m : stop + m] - squares[start:stop]
    found.scatter += float(scatter.sum()) - float((total * mean).sum())
    found.freedom += float(np.maximum(size - 1.0, 0.0).sum())
    return mean, size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pattern:
    """How losses cluster: their autocorrelation, and D(k) of the samples, each from lag 0; (j,)."""

    correlation: FloatArray
    structure: FloatArray

    def variance(self, inside: float, m: int) -> float:
        """Return S²: the covariance inside windows of m, weighted by the correlation of losses."""
        reach = min(self.correlation.size, m)
        lag = np.arange(reach)
        weight = np.where(lag > 0, 2.0, 1.0) * (1 - lag / m) * self.correlation[:reach]
        return float(weight @ (inside - self.structure[:reach] / 2))


def _pattern(series: AxisSeries) -> _Pattern:
    """Correlate what is there, chunk by chunk, by the FFT."""
    from scipy.fft import irfft, next_fast_len, rfft

    clock = series.clock
    mean_gap = clock.missing / max(len(clock.gaps), 1)
    lags = int(min(max(_MEAN_GAPS * np.ceil(mean_gap), 1), _LONGEST, clock.grid_size))
    mean = float(series.samples.mean())
    pairs, squares, possible = np.zeros((3, lags))
    for start in range(0, clock.grid_size, _CHUNK):
        size = min(_CHUNK, clock.grid_size - start)
        low, high = clock.index_from(start), clock.index_from(start + size)
        part = clock.slice(low, high)
        index = part.grid()
        if index.size:
            index += part.segments[0].offset - clock.segments[0].offset - start
        length = next_fast_len(size + lags, real=True)
        here, value = np.zeros((2, length))
        here[index] = 1.0
        value[index] = series.samples[low:high] - mean
        there, plain, squared = rfft(here), rfft(value), rfft(value**2)
        pairs += irfft(np.abs(there) ** 2, length)[:lags]
        # The sum of w[t] w[t+k] (y[t+k] - y[t])² is even in k: the real part holds both squares.
        cross = 2 * (there * squared.conj()).real - 2 * np.abs(plain) ** 2
        squares += irfft(cross, length)[:lags]
        possible += np.maximum(size - np.arange(lags), 0)
    share = series.n / clock.grid_size
    covariance = pairs / np.maximum(possible, 1.0) - share**2
    structure = squares / np.maximum(pairs, 0.5)
    structure[0] = 0.0
    return _Pattern(correlation=covariance / max(covariance[0], 1e-300), structure=structure)
