"""Allan variances: exact, in cache-sized passes without full-length temporaries, and with gaps.

Small factors are computed block by block, each integrated separately: a second difference cancels the missing
offset and slope. Large factors use the whole integral column by column.

The Allan variance, of maximum overlap (MOAV), is the mean square of x[t+2m] - 2 x[t+m] + x[t] over every t,
divided by 2 m². Here x is the sum of the samples (the angle, for a gyroscope).

Source: NIST SP 1065 (2008), eq. 11.

Missing samples are never interpolated:

windows
    Differences of the means of two neighbouring windows, each at least half as filled as the whole series,
    minus the effect of the losses. A mean of C of m samples has a variance larger by (1/C - 1/m) S² than a
    mean of all m, with S² the variance inside windows. For bursts of losses, S² weights the covariance inside
    windows with the autocorrelation of the losses.
runs
    Between separate rests: complete differences inside unbroken runs.

Source: the finite-population correction, Cochran (1977), Sampling Techniques, ch. 2. The estimator
from all pairs of samples (Mondal & Percival, 2010, Ann. Inst. Stat. Math. 62) is also unbiased, but its
scatter is up to four times as large.
"""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import chain, compress, pairwise
from typing import NamedTuple

import numpy as np
import scipy

from imucal.arrays import FloatArray, IntArray, aligned
from imucal.clock import Clock
from imucal.errors import ArgumentError
from imucal.recording import AxisSeries

#: Samples per block: a few work arrays of this length fit in a second-level cache of 1 MB.
_BLOCK = 32768
#: Factors up to this are computed block by block; the overlap of two blocks is at most half a block.
_SMALL = 8192
#: Row of a sum of squares. OpenBLAS uses threads for dot products of more than 10,000 elements, which are up
#: to 50 times slower while other programs use the processors.
_ROW = 8192
#: Spacing of the windows in `_inside`, times m / worth². This and the next two constants leave out windows
#: that cost less than 1 % of an interval's width (`tests/allan/test_gaps.py`).
_SPACING = 3e-4
#: Largest spacing from `_SPACING`, in samples.
_MAX_SPACING = 64
#: The spacing may grow to m / 4 while at least this many windows are left.
_MIN_WINDOWS = 1 << 18
#: Longer runs use the faster method for series without losses; both agree to rounding.
_LONG = 8 * _ROW
#: Largest lag of the autocorrelation of losses, in mean gaps: of random gaps exp(-4), 2 %, is left.
_MEAN_GAPS = 4
#: Largest lag of the autocorrelation of losses, in samples: it limits the memory and time of long gaps.
_MAX_LAG = 256
#: Places of the grid per FFT of the loss pattern.
_CHUNK = 1 << 17
#: Chunks that are enough to estimate the structure function.
_ENOUGH = 16


def variances(samples: FloatArray, m: IntArray) -> FloatArray:
    """Return the Allan variances of an evenly spaced series, shape (k,), in U².

    The samples, shape (n,), are finite. Averaging factors `m`, shape (k,), are from 1 to n/2; others are a
    ValueError. O(n) per factor. Memory: one full-length array if a factor is above 8192.
    """
    terms = samples.size + 1 - 2 * m
    return square_sums(samples, m) / (2.0 * m.astype(np.float64) ** 2 * terms)


def square_sums(samples: FloatArray, m: IntArray) -> FloatArray:
    """Return the unscaled sums of the squared differences; arguments as in `variances`."""
    largest = samples.size // 2
    if m.size and not (m.min() >= 1 and m.max() <= largest):
        msg = (
            f"averaging factors must be in 1..{largest} for {samples.size} samples, got {m.min()}..{m.max()}"
        )
        raise ArgumentError(msg)
    sums = np.zeros(m.size)
    small = m <= _SMALL
    if small.any():
        sums[small] = _small_sums(samples, m[small])
    if not small.all():
        total = _integral(samples)
        sums[~small] = [_column_sum(total, factor) for factor in m[~small].tolist()]
    return sums


def sum_of_squares(values: FloatArray) -> float:
    """Return the sum of squares of a contiguous array of shape (n,), on one thread."""
    whole = values.size - values.size % _ROW
    rows, tail = values[:whole].reshape(-1, _ROW), values[whole:]
    return float(np.vecdot(rows, rows).sum() + np.vecdot(tail, tail))


class SquareSum:
    """The sum of squares of a work array that is refilled block after block."""

    def __init__(self, work: FloatArray) -> None:
        self.work = work
        self._rows = work[: work.size - work.size % _ROW].reshape(-1, _ROW)
        self._block = np.empty(len(self._rows))
        self._total = np.zeros(len(self._rows))
        self._tails = 0.0

    def add(self, count: int) -> None:
        whole = count // _ROW
        if whole:
            rows, block = self._rows[:whole], self._block[:whole]
            np.vecdot(rows, rows, out=block)
            self._total[:whole] += block
        if count % _ROW:
            tail = self.work[whole * _ROW : count]
            self._tails += float(np.vecdot(tail, tail))

    def total(self) -> float:
        return float(self._total.sum()) + self._tails


def _integral(samples: FloatArray) -> FloatArray:
    """Return the sum of the samples minus their mean, from 0."""
    mean = samples.mean()
    total = aligned(samples.size + 1)
    total[0] = 0.0
    # A new array per block would cost many page faults.
    work = aligned(min(_BLOCK, samples.size))
    for start in range(0, samples.size, _BLOCK):
        block = samples[start : start + _BLOCK]
        part = np.subtract(block, mean, out=work[: block.size])
        np.cumsum(part, out=part)
        part += total[start]
        total[start + 1 : start + 1 + part.size] = part
    return total


def _small_sums(samples: FloatArray, m: IntArray) -> FloatArray:
    factors: list[int] = m.tolist()
    reach = 2 * max(factors)
    end = samples.size + 1
    work = aligned(_BLOCK)
    first_differences = aligned(_BLOCK + reach)
    squares = [SquareSum(work) for _ in factors]
    integral = aligned(min(_BLOCK + reach, end))
    for start in range(0, end - 2 * min(factors), _BLOCK):
        stop = min(start + _BLOCK + reach, end)
        # The integral of the block alone, from 0, with the block's mean removed.
        block, local = samples[start : stop - 1], integral[: stop - start]
        local[0] = 0.0
        part = np.subtract(block, block.mean(), out=local[1:])
        np.cumsum(part, out=part)
        for factor, square in zip(factors, squares, strict=True):
            count = min(_BLOCK, local.size - 2 * factor)
            if count > 0:
                steps = first_differences[: count + factor]
                np.subtract(local[factor : count + 2 * factor], local[: count + factor], out=steps)
                np.subtract(steps[factor:], steps[:count], out=work[:count])
                square.add(count)
    return np.array([square.total() for square in squares])


def _column_sum(total: FloatArray, m: int) -> float:
    """Sum the squared differences over columns of start points in steps of m.

    A step needs one new chunk of the integral: the previous first differences are kept.
    """
    count = total.size - 2 * m
    work = aligned(_BLOCK)
    squares = SquareSum(work)
    previous = aligned(_BLOCK)
    current = aligned(_BLOCK)
    for column in range(0, min(m, count), _BLOCK):
        width = min(_BLOCK, m - column, count - column)
        for step, first in enumerate(range(column, total.size - m, m)):
            size = min(width, total.size - m - first)
            np.subtract(total[first + m : first + m + size], total[first : first + size], out=current[:size])
            if step:
                np.subtract(current[:size], previous[:size], out=work[:size])
                squares.add(size)
            previous, current = current, previous
    return squares.total()


@dataclass(frozen=True, kw_only=True, eq=False)
class GappyVariances:
    """Variances at the averaging factors `m` that the data allow, shape (k,) each, all positive, in U².

    `terms` is the number of differences; `inflation` is the uncorrected mean square divided by `avar`.
    """

    m: IntArray
    avar: FloatArray
    terms: FloatArray
    inflation: FloatArray


def longest_run(clock: Clock) -> int:
    """Return the number of samples of the longest unbroken run."""
    return max((run.stop - run.start for run in runs_of(clock)), default=0)


def window_variances(series: AxisSeries, m: IntArray) -> GappyVariances:
    """Return Allan variances from windows that are at least half as filled as the whole series.

    A value that is not positive after the correction is left out.
    """
    correlation, structure = _pattern(series)
    integrals, squares = _integrals(series)
    runs = runs_of(series.clock)
    long = [run for run in runs if run[1] - run[0] >= _LONG]
    edges = [place for run in runs for place in run[2:]]
    share = series.n / series.clock.grid_size / 2
    counts, raw, added = np.zeros((3, m.size))
    for start, stop, *_ in long:
        fits = 2 * m <= stop - start
        counts[fits] += stop - start - 2 * m[fits] + 1
        sums = square_sums(series.samples[start:stop], m[fits])
        raw[fits] += sums / m[fits] ** 2
    for i, factor in enumerate(m.tolist()):
        done = [(first, end - 2 * factor + 1) for *_, first, end in long if 2 * factor <= end - first]
        count, differences, lost = _pairs(integrals, edges, factor, max(share * factor, 1.0), done)
        counts[i] += count
        raw[i] += differences
        if lost:
            inside = _inside(integrals, squares, factor, lost * factor / counts[i] / 2)
            # S²: the covariance inside windows, weighted by the autocorrelation of losses.
            lag = np.arange(min(correlation.size, factor))
            weight = np.where(lag > 0, 2.0, 1.0) * (1 - lag / factor) * correlation[: lag.size]
            added[i] = lost * float(weight @ (inside - structure[: lag.size] / 2))
    half = 1 / np.maximum(2 * counts, 1)
    return _positive(m, (raw - added) * half, counts, raw * half)


def run_variances(series: AxisSeries, m: IntArray) -> GappyVariances:
    """Return Allan variances from the differences inside unbroken runs."""
    sums, counts = np.zeros(m.size), np.zeros(m.size)
    for start, stop, *_ in runs_of(series.clock):
        fits = 2 * m <= stop - start
        if fits.any():
            sums[fits] += square_sums(series.samples[start:stop], m[fits])
            counts[fits] += stop - start + 1 - 2 * m[fits]
    avar = sums / (2.0 * m.astype(np.float64) ** 2) / np.maximum(counts, 1)
    return _positive(m, avar, counts, avar)


def _positive(m: IntArray, avar: FloatArray, terms: FloatArray, raw: FloatArray) -> GappyVariances:
    """Keep positive values with a difference; a constant series is zero throughout."""
    keep = (terms >= 1) & ((avar > 0) | (raw == 0))
    m, avar, terms, raw = m[keep], avar[keep], terms[keep], raw[keep]
    inflation = np.divide(raw, avar, out=np.ones(m.size), where=avar > 0)
    return GappyVariances(m=m, avar=avar, terms=terms, inflation=np.maximum(inflation, 1.0))


class Run(NamedTuple):
    """Samples `start` to `stop` (exclusive), at places `first` to `end` (exclusive) of the grid."""

    start: int
    stop: int
    first: int
    end: int


def runs_of(clock: Clock, *, bridging: int = 0) -> list[Run]:
    """Return the runs without a gap above `bridging` samples; the first sample is at place 0."""
    runs: list[Run] = []
    for segment in clock.segments:
        first = segment.offset - clock.segments[0].offset
        if runs and first - runs[-1].end <= bridging:
            runs[-1] = runs[-1]._replace(stop=segment.stop, end=first + segment.size)
        else:
            runs.append(Run(segment.start, segment.stop, first, first + segment.size))
    return runs


def _integrals(series: AxisSeries) -> tuple[FloatArray, FloatArray]:
    """Return running sums from which the sums over any window of the even grid follow.

    The first array, shape (2, grid + 1), sums the samples minus their mean and their number; the second sums
    the squares.
    """
    clock, mean = series.clock, float(series.samples.mean())
    sums = np.zeros((2, clock.grid_size + 1))
    for start, stop, first, end in runs_of(clock):
        np.subtract(series.samples[start:stop], mean, out=sums[0, first + 1 : end + 1])
        sums[1, first + 1 : end + 1] = 1.0
    squares = np.square(sums[0])
    return np.cumsum(sums, axis=1, out=sums), np.cumsum(squares, out=squares)


def _inside(integrals: FloatArray, squares: FloatArray, m: int, worth: float) -> float:
    """Return the variance of samples about their means in windows of `m` places, 0 if there is none.

    `worth` is its weight in the result. In a long series the spacing is up to a quarter of a window, because
    windows in between contain almost the same samples.
    """
    apart = max(min(m // 4, squares.size // _MIN_WINDOWS), int(min(_SPACING * m / worth**2, _MAX_SPACING)), 1)
    within, freedom = 0.0, 0.0
    # Windows far from the ends belong to two pairs.
    last = squares.size - 2 * m
    ends = [0, min(m, last), max(m, last), last + m]
    for first, stop, times in zip(ends, ends[1:], (1, 2 * (m < last), 1), strict=False):
        for start in range(first, stop, _ROW * apart):
            begin = slice(start, min(start + _ROW * apart, stop), apart)
            end = slice(begin.start + m, begin.stop + m, apart)
            total, size = integrals[:, end] - integrals[:, begin]
            within += times * float(np.sum(squares[end] - squares[begin] - total**2 / np.maximum(size, 1.0)))
            freedom += times * float(np.maximum(size - 1, 0.0).sum())
    return within / freedom if freedom else 0.0


def _pairs(
    integrals: FloatArray, edges: list[int], m: int, fewest: float, done: list[tuple[int, int]]
) -> tuple[int, float, float]:
    """Return sums over pairs of neighbouring windows of `m` places with `fewest` or more samples each.

    The sums are the number of pairs, the squared differences of means, and 1/C - 1/m of both windows with C
    samples. `edges` are the places where runs begin and end. `done` are ranges of first places that are
    already counted.
    """
    total, filled = integrals
    count, squares, lost, last = 0, 0.0, 0.0, total.size - 2 * m
    cuts = {*range(0, last, _ROW), last, *chain.from_iterable(done)}
    if len(edges) * _ROW <= last:
        cuts.update(edge - shift for edge in edges for shift in (0, m, 2 * m) if shift < edge < last + shift)
    places = np.array(sorted(cuts))
    skipped = np.zeros(places.size, dtype=np.bool_)
    for first, end in done:
        skipped[np.searchsorted(places, first) : np.searchsorted(places, end)] = True
    for start, stop in compress(pairwise(places.tolist()), ~skipped):
        points = [slice(start + shift, stop + shift) for shift in (0, m, 2 * m)]
        if straight := _straight(filled, edges, points):
            sizes = np.array([filled.item(at + m) - filled.item(at) for at in (start, start + m)])
        else:
            sizes = np.array([filled[points[1]] - filled[points[0]], filled[points[2]] - filled[points[1]]])
        both = (sizes >= fewest).all(axis=0)
        if straight and not both:
            continue
        low, high = total[points[1]] - total[points[0]], total[points[2]] - total[points[1]]
        first, second = 1 / np.maximum(sizes, 1.0)
        if straight:
            np.subtract(high if first == second else high * (second / first), low, out=high)
            count += low.size
            lost += low.size * float(first + second - 2 / m)
            squares += float(first**2 * np.vecdot(high, high))
        else:
            count += int(np.count_nonzero(both))
            lost += float((first + second - 2 / m).sum(where=both))
            squares += sum_of_squares((high * second - low * first) * both)
    return count, squares, lost


def _straight(filled: FloatArray, edges: list[int], points: list[slice]) -> bool:
    steps = {filled.item(at.stop - 1) - filled.item(at.start) for at in points}
    return len(steps) == 1 and not any(
        bisect_right(edges, at.start) < bisect_left(edges, at.stop - 1) for at in points
    )


def _pattern(series: AxisSeries) -> tuple[FloatArray, FloatArray]:
    """Return the autocorrelation of losses and the structure function, from lag 0, (j,)."""
    clock = series.clock
    mean_gap = clock.missing / max(len(clock.gaps), 1)
    lags = int(min(max(_MEAN_GAPS * np.ceil(mean_gap), 1), _MAX_LAG, clock.grid_size))
    mean = float(series.samples.mean())
    pairs, squares, seen, possible = np.zeros((4, lags))
    # A few chunks determine the structure function, not the loss pattern.
    every = -(-clock.grid_size // (_ENOUGH * _CHUNK))
    for number, start in enumerate(range(0, clock.grid_size, _CHUNK)):
        size = min(_CHUNK, clock.grid_size - start)
        low, high = clock.index_from(start), clock.index_from(start + size)
        room = np.maximum(size - np.arange(lags), 0)
        possible += room
        if number % every and high - low == size >= lags:
            pairs += room
            continue
        index = clock.grid(low, high) - start
        length = scipy.fft.next_fast_len(size + lags, real=True)
        here, value = np.zeros((2, length))
        here[index] = 1.0
        value[index] = series.samples[low:high] - mean
        there = scipy.fft.rfft(here)
        own = scipy.fft.irfft(np.abs(there) ** 2, length)[:lags]
        if number % every == 0:
            # The sum of w[t] w[t+k] (y[t+k] - y[t])² is even in k: the real part holds both squares.
            products = (
                2 * (there * scipy.fft.rfft(value**2).conj()).real - 2 * np.abs(scipy.fft.rfft(value)) ** 2
            )
            squares += scipy.fft.irfft(products, length)[:lags]
            seen += own
        pairs += own
    share = series.n / clock.grid_size
    covariance = pairs / np.maximum(possible, 1.0) - share**2
    structure = squares / np.maximum(seen, 0.5)
    structure[0] = 0.0
    return covariance / max(covariance[0], 1e-300), structure
