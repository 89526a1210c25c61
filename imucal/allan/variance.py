"""Variances of any estimator: exact, in cache-sized passes without full-length temporaries, and with gaps.

Small factors are served block by block, all factors while a block is in the cache; each block is
integrated on its own, because a difference of second order or more does not see the offset and
the slope that this leaves out. Large factors walk over the whole integral in columns, so that
each chunk is read once a step.

Each estimator is the mean square of a difference of the integrated samples.
With x the sum of the samples (the angle, for a gyroscope) and z the sum of x:

==============  ==================================================  =========
overlapping     x[t+2m] - 2 x[t+m] + x[t], every t                   2 m²
standard        the same, every m-th t                               2 m²
modified        z[t+3m] - 3 z[t+2m] + 3 z[t+m] - z[t], every t       2 m⁴
hadamard        x[t+3m] - 3 x[t+2m] + 3 x[t+m] - x[t], every t       6 m²
==============  ==================================================  =========

Source: NIST SP 1065 (2008), eqs. 9, 11, 15 (modified: its inner sum of m second differences of
x is a third difference of z), 22 (overlapping Hadamard).

Where samples are missing, nothing is ever interpolated:

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

from imucal.arrays import FloatArray, IntArray, aligned
from imucal.clock import Clock
from imucal.recording import AxisSeries

#: Elements of a work array: a few of them fit in a second-level cache of 1 MB.
_BLOCK = 32768
#: Factors up to this are served block by block.
_SMALL = 8192
#: Row of a sum of squares. OpenBLAS hands a dot product of more than 10,000 elements to its
#: threads, which stall when others want the processors: up to 50 times slower.
_ROW = 8192
#: The pattern of losses is followed for so many mean gaps, and at most so many samples.
_MEAN_GAPS, _LONGEST = 4, 256
#: Places of the grid that one FFT takes when the pattern is correlated.
_CHUNK = 1 << 17


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimator:
    """One estimator of a deviation.

    Attributes
    ----------
    name
        Its key in `ESTIMATORS`.
    integrations
        How often the samples are summed: 1 (x) or 2 (z).
    order
        Order of the difference.
    overlapping
        Whether every start point is used, or every m-th.
    weight
        Sum of the squared coefficients of the difference that the variance is divided by.
    """

    name: str
    integrations: int
    order: int
    overlapping: bool
    weight: int

    def terms(self, n: int, m: int) -> int:
        """Return the number of differences that `n` samples have at averaging factor `m`."""
        if self.overlapping:
            return n + self.integrations - self.order * m
        return n // m + 1 - self.order

    def largest(self, n: int) -> int:
        """Return the largest averaging factor that `n` samples allow; 0 if they allow none."""
        return max((n + self.integrations - 1) // self.order, 0)

    def drawn(self, n: int) -> int:
        """Return the largest factor of a named set: half the largest, where some 2 to 4 dof are left."""
        return max(self.largest(n) // 2, 1)

    def scale(self, m: int) -> float:
        """Return what the mean square of the differences is divided by."""
        return float(self.weight) * float(m) ** (2 * self.integrations)


#: Name -> estimator.
ESTIMATORS: dict[str, Estimator] = {
    estimator.name: estimator
    for estimator in (
        Estimator(name="overlapping", integrations=1, order=2, overlapping=True, weight=2),
        Estimator(name="standard", integrations=1, order=2, overlapping=False, weight=2),
        Estimator(name="modified", integrations=2, order=3, overlapping=True, weight=2),
        Estimator(name="hadamard", integrations=1, order=3, overlapping=True, weight=6),
    )
}


def estimator_named(name: str) -> Estimator:
    """Return the estimator called `name`.

    Raises
    ------
    ValueError
        If there is none.
    """
    if name not in ESTIMATORS:
        msg = f"estimator {name!r} is not known: expected one of {', '.join(ESTIMATORS)}"
        raise ValueError(msg)
    return ESTIMATORS[name]


def variances(samples: FloatArray, m: IntArray, estimator: Estimator) -> FloatArray:
    """Return the variances of an evenly spaced series.

    Parameters
    ----------
    samples
        Shape (n,), finite, in any unit U.
    m
        Averaging factors, shape (k,), each from 1 to ``estimator.largest(n)``.
    estimator
        Which differences to square.

    Returns
    -------
    Shape (k,), in U².

    Raises
    ------
    ValueError
        If an averaging factor is out of range.

    Notes
    -----
    O(n) per factor; memory one full-length array where a factor is above 8192, else a few blocks.
    The relative error stays below 1e-12 up to 1e8 samples on a mean of a million deviations.
    """
    divisors = [estimator.scale(mi) * estimator.terms(samples.size, mi) for mi in m.tolist()]
    return square_sums(samples, m, estimator) / np.array(divisors, dtype=np.float64).reshape(m.shape)


def square_sums(samples: FloatArray, m: IntArray, estimator: Estimator) -> FloatArray:
    """Return the sums of the squared differences, before scaling; as `variances` otherwise."""
    largest = estimator.largest(samples.size)
    if m.size and not (m.min() >= 1 and m.max() <= largest):
        msg = (
            f"averaging factors must be in 1..{largest} for {samples.size} samples, got {m.min()}..{m.max()}"
        )
        raise ValueError(msg)
    if not estimator.overlapping:
        total = _integral(samples, 1)
        return np.array([sum_of_squares(np.diff(total[::factor], estimator.order)) for factor in m.tolist()])
    sums = np.zeros(m.size)
    small = m <= _SMALL
    if small.any():
        sums[small] = _small_sums(samples, m[small], estimator)
    if not small.all():
        total = _integral(samples, estimator.integrations)
        sums[~small] = [_column_sum(total, factor, estimator.order) for factor in m[~small].tolist()]
    return sums


def sum_of_squares(values: FloatArray) -> float:
    """Return the sum of squares of a contiguous array of shape (n,), on one thread."""
    whole = values.size - values.size % _ROW
    rows, tail = values[:whole].reshape(-1, _ROW), values[whole:]
    return float(np.vecdot(rows, rows).sum() + np.vecdot(tail, tail))


class SquareSum:
    """The sum of squares of what is written to a work array, block after block.

    It is kept row by row until the end, which saves a reduction a block.
    """

    def __init__(self, work: FloatArray) -> None:
        self.work = work
        self._rows = work[: work.size - work.size % _ROW].reshape(-1, _ROW)
        self._block = np.empty(len(self._rows))
        self._total = np.zeros(len(self._rows))
        self._tails = 0.0

    def add(self, count: int) -> None:
        """Add the squares of the first `count` elements of the work array."""
        whole = count // _ROW
        if whole:
            rows, block = self._rows[:whole], self._block[:whole]
            np.vecdot(rows, rows, out=block)
            self._total[:whole] += block
        if count % _ROW:
            tail = self.work[whole * _ROW : count]
            self._tails += float(np.vecdot(tail, tail))

    def total(self) -> float:
        """Return the sum so far."""
        return float(self._total.sum()) + self._tails


def _integral(samples: FloatArray, integrations: int) -> FloatArray:
    """Return the samples, their mean removed, summed once or twice from 0; shape (n + integrations,)."""
    mean = samples.mean()
    total = aligned(samples.size + integrations)
    total[:integrations] = 0.0
    last = [0.0] * integrations
    # One work array for all blocks: fresh ones cost a page fault for every 512 samples.
    work = aligned(min(_BLOCK, samples.size))
    for start in range(0, samples.size, _BLOCK):
        block = samples[start : start + _BLOCK]
        part = np.subtract(block, mean, out=work[: block.size])
        for level in range(integrations):
            np.cumsum(part, out=part)
            part += last[level]
            last[level] = float(part[-1])
        total[start + integrations : start + integrations + part.size] = part
    return total


def _small_sums(samples: FloatArray, m: IntArray, estimator: Estimator) -> FloatArray:
    """Sum the squared differences, blocks outer, factors inner."""
    order, depth = estimator.order, estimator.integrations
    factors: list[int] = m.tolist()
    reach = order * max(factors)
    end = samples.size + depth
    work = aligned(_BLOCK)
    lower = [aligned(_BLOCK + reach) for _ in range(order - 1)]
    squares = [SquareSum(work) for _ in factors]
    integral = aligned(min(_BLOCK + reach, end))
    for start in range(0, end - order * min(factors), _BLOCK):
        stop = min(start + _BLOCK + reach, end)
        local = _local_integral(samples[start : stop - depth], depth, integral[: stop - start])
        for factor, square in zip(factors, squares, strict=True):
            count = min(_BLOCK, local.size - order * factor)
            if count > 0:
                _difference(local[: count + order * factor], factor, lower, work)
                square.add(count)
    return np.array([square.total() for square in squares])


def _local_integral(samples: FloatArray, depth: int, local: FloatArray) -> FloatArray:
    """Write a block's own integral, started at 0 with the block's mean removed, to shape (n + depth,)."""
    local[:depth] = 0.0
    part = local[depth:]
    np.subtract(samples, samples.mean() if samples.size else 0.0, out=part)
    for _ in range(depth):
        np.cumsum(part, out=part)
    return local


def _difference(values: FloatArray, m: int, lower: list[FloatArray], out: FloatArray) -> None:
    """Write the m-step difference of order ``len(lower) + 1`` of a block to the start of `out`."""
    for target in (*lower, out):
        size = values.size - m
        np.subtract(values[m:], values[:size], out=target[:size])
        values = target[:size]


def _column_sum(total: FloatArray, m: int, order: int) -> float:
    """Return the sum of squared differences, walking each column of starts in steps of m.

    A step needs one new chunk of the integral: the lower differences are kept from the step before.
    """
    count = total.size - order * m
    work = aligned(_BLOCK)
    squares = SquareSum(work)
    kept = [aligned(_BLOCK) for _ in range(order - 1)]
    fresh = [aligned(_BLOCK) for _ in range(order - 1)]
    for column in range(0, min(m, count), _BLOCK):
        width = min(_BLOCK, m - column, count - column)
        for step, first in enumerate(range(column, total.size - m, m)):
            size = min(width, total.size - m - first)
            np.subtract(total[first + m : first + m + size], total[first : first + size], out=fresh[0][:size])
            for level in range(1, min(order - 1, step + 1)):
                np.subtract(fresh[level - 1][:size], kept[level - 1][:size], out=fresh[level][:size])
            if step >= order - 1:
                np.subtract(fresh[-1][:size], kept[-1][:size], out=work[:size])
                squares.add(size)
            kept, fresh = fresh, kept
    return squares.total()


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
        counts[i], squares, lost, inside = _windows(integrals, factor, max(share * factor, 1.0))
        if counts[i]:
            raw[i] = squares / counts[i] / 2
            added[i] = lost / counts[i] / 2 * pattern.variance(inside, factor)
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


def _integrals(series: AxisSeries) -> FloatArray:
    """Return running sums on the even grid, shape (3, grid + 1): of samples, squares and counts."""
    clock, mean = series.clock, float(series.samples.mean())
    sums = np.zeros((3, clock.grid_size + 1))
    for segment in clock.segments:
        start = segment.offset - clock.segments[0].offset + 1
        place = slice(start, start + segment.size)
        np.subtract(series.samples[segment.start : segment.stop], mean, out=sums[0, place])
        sums[2, place] = 1.0
    np.square(sums[0], out=sums[1])
    return np.cumsum(sums, axis=1, out=sums)


def _windows(integrals: FloatArray, m: int, fewest: float) -> tuple[float, float, float, float]:
    """Go through all pairs of neighbouring windows of `m` places with at least `fewest` filled.

    Return their number, the sum of squared differences, the sum of 1/C - 1/m over both windows of each,
    and the mean variance inside windows, in U².
    """
    count = squares = lost = scatter = freedom = 0.0
    end = integrals.shape[1] - 2 * m
    for start in range(0, end, _BLOCK):
        stop = min(start + _BLOCK, end)
        means, sizes, both = [], [], np.ones(stop - start, dtype=bool)
        for first, last in ((start, stop), (start + m, stop + m)):
            total, square, size = integrals[:, first + m : last + m] - integrals[:, first:last]
            filled = np.maximum(size, 1.0)
            means.append(total / filled)
            sizes.append(filled)
            both &= size >= fewest
            scatter += float(square.sum()) - float((total * means[-1]).sum())
            freedom += float((filled - 1.0).sum())
        squares += sum_of_squares((means[1] - means[0]) * both)
        count += float(np.count_nonzero(both))
        lost += float((1 / sizes[0] + 1 / sizes[1] - 2 / m).sum(where=both))
    return count, squares, lost, scatter / freedom if freedom > 0 else 0.0


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
