"""Variances of a series with missing samples; nothing is ever interpolated.

windows
    The means of two neighbouring windows, each at least half filled. For few losses, or losses in
    bursts: where windows without a loss abound, the partly filled ones hardly count.
pairs
    From the mean square D(k) of y[t+k] - y[t] over all pairs of samples that are there:
    avar(m) = (Φ(2m) - 4 Φ(m)) / (2 m²), Φ(n) = Σ_{k<n} (n - k) D(k). Unbiased whatever is missing,
    as nothing but pairs is averaged; for scattered losses, which leave no window whole.
runs
    Complete differences inside unbroken runs; for the estimators other than ``overlapping``.

Source: Mondal & Percival (2010), "Wavelet variance analysis for gappy time series", Ann. Inst.
Stat. Math. 62, sec. 2 (pairs).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.allan.dct import bin_power, dct_bins, dct_ordinates, fast_length
from imucal.allan.estimators import ESTIMATORS, Estimator
from imucal.allan.response import power_response
from imucal.allan.variance import square_sums, sum_of_squares
from imucal.arrays import FloatArray, IntArray
from imucal.recording import AxisSeries, Clock

__all__ = [
    "GappyVariances",
    "gap_method",
    "longest_run",
    "pair_variances",
    "run_variances",
    "window_variances",
]

#: With a smaller share missing, partly filled windows bias nothing that could be seen.
_FEW = 1e-3

#: Up to so many gaps count as bursts: a run then is 1 % of the log on average.
_BURSTS = 100

#: Elements of a work array.
_BLOCK = 32768


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
    extra
        What the losses add to the relative variance of each where the noise is white, shape (k,).
    """

    m: IntArray
    avar: FloatArray
    terms: FloatArray
    extra: FloatArray


def gap_method(clock: Clock) -> str:
    """Return ``exact``, ``windows`` or ``pairs``: what the overlapping estimator needs here."""
    if not clock.missing:
        return "exact"
    few = clock.missing < _FEW * clock.grid_size
    return "windows" if few or len(clock.gaps) <= _BURSTS else "pairs"


def longest_run(clock: Clock) -> int:
    """Return the number of samples of the longest unbroken run."""
    return max((end - start for start, end in _runs(clock)), default=0)


def window_variances(series: AxisSeries, m: IntArray) -> GappyVariances:
    """Return overlapping variances from windows that are at least half filled.

    Cost some 2 ns per place of the grid and factor; memory two full-length arrays.
    """
    integral, filled = _gridded(series)
    sums, counts = np.zeros(m.size), np.zeros(m.size)
    for i, factor in enumerate(m.tolist()):
        sums[i], counts[i] = _window_sum(integral, filled, factor)
    return _positive(m, sums / (2 * np.maximum(counts, 1)), counts)


def pair_variances(series: AxisSeries, m: IntArray) -> GappyVariances:
    """Return overlapping variances from all pairs of samples, by the FFT.

    O(n log n) for all factors together; memory some ten full-length arrays. A value that comes out
    negative, as it may at long averaging times, is left out.
    """
    structure, pairs = _structure_function(series, 2 * int(m.max()))
    known = np.flatnonzero(pairs[1:] < 0.5)
    reach = int(known[0]) if known.size else pairs.size - 1
    m = m[2 * m - 1 <= reach]
    # A constant part c of D gives c/(2m) exactly; without it the sums keep their digits.
    level = float(structure[1])
    first = np.cumsum(structure[1:] - level)
    weighted = np.concatenate([[0.0, 0.0], np.cumsum(first)])
    factor = m.astype(np.float64)
    avar = (weighted[2 * m] - 4 * weighted[m]) / (2 * factor**2) + level / (2 * factor)
    terms = series.clock.grid_size - 2 * factor + 1
    return _positive(m, avar, terms, _pair_extra(series, m))


def _pair_extra(series: AxisSeries, m: IntArray) -> FloatArray:
    """Return what scattered losses add to the relative variance of `pair_variances` of white noise.

    A value is a quadratic form Σ a_k D(k) with the transform A(w) = 1/m - H(w), H the response of
    the Allan variance. With a share q there, the products of pairs are fewer by q², and the weight
    of each squared sample varies with its neighbours' losses: its variance is that of the pattern
    of losses seen through A.
    """
    n = series.clock.grid_size
    there = np.zeros(n)
    there[series.clock.grid()] = 1.0
    share = series.n / n
    used = fast_length(n)
    bins = dct_bins(used)
    power = bin_power(dct_ordinates(there[:used]), bins) * n / used
    extra = np.empty(m.size)
    for i, factor in enumerate(m.tolist()):
        response, squared = power_response(bins, factor, ESTIMATORS["overlapping"])
        weights = power @ (1 / factor**2 - 2 * response / factor + squared) / (n * share**2) ** 2
        fewer = 4 * factor / (3 * n) * (1 / share**2 - 1)
        extra[i] = fewer + 2 * factor**2 * share * weights
    return extra


def run_variances(series: AxisSeries, m: IntArray, estimator: Estimator) -> GappyVariances:
    """Return variances of any estimator from the differences that lie inside unbroken runs."""
    sums, counts = np.zeros(m.size), np.zeros(m.size)
    for start, stop in _runs(series.clock):
        fits = m <= estimator.largest(stop - start)
        if fits.any():
            sums[fits] += square_sums(series.samples[start:stop], m[fits], estimator)
            counts[fits] += [estimator.terms(stop - start, mi) for mi in m[fits].tolist()]
    scale = np.array([estimator.scale(mi) for mi in m.tolist()])
    return _positive(m, sums / scale / np.maximum(counts, 1), counts)


def _positive(
    m: IntArray, avar: FloatArray, terms: FloatArray, extra: FloatArray | None = None
) -> GappyVariances:
    keep: NDArray[np.bool_] = (terms >= 1) & (avar > 0)
    more = np.zeros(m.size) if extra is None else extra
    return GappyVariances(m=m[keep], avar=avar[keep], terms=terms[keep], extra=more[keep])


def _runs(clock: Clock) -> list[tuple[int, int]]:
    """Return start and stop of every unbroken run; segments that touch on the grid are one."""
    runs: list[tuple[int, int]] = []
    place = -1
    for segment in clock.segments:
        if runs and segment.offset == place:
            runs[-1] = (runs[-1][0], segment.stop)
        else:
            runs.append((segment.start, segment.stop))
        place = segment.offset + segment.size
    return runs


def _gridded(series: AxisSeries) -> tuple[FloatArray, FloatArray]:
    """Return the integral of the samples and of their number on the even grid; shape (grid + 1,)."""
    integral = np.zeros(series.clock.grid_size + 1)
    filled = np.zeros(series.clock.grid_size + 1)
    place = series.clock.grid() + 1
    integral[place] = series.samples - series.samples.mean()
    filled[place] = 1.0
    np.cumsum(integral, out=integral)
    np.cumsum(filled, out=filled)
    return integral, filled


def _window_sum(integral: FloatArray, filled: FloatArray, m: int) -> tuple[float, float]:
    """Return the sum of squared differences of neighbouring window means, and their number."""
    count = integral.size - 2 * m
    total, number = 0.0, 0.0
    for start in range(0, count, _BLOCK):
        stop = min(start + _BLOCK, count)
        first, enough = _mean(integral, filled, m, start, stop)
        second, also = _mean(integral, filled, m, start + m, stop + m)
        second -= first
        second *= enough & also
        total += sum_of_squares(second)
        number += float(np.count_nonzero(enough & also))
    return total, number


def _mean(
    integral: FloatArray, filled: FloatArray, m: int, start: int, stop: int
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the means of the windows that start at `start` … `stop`, and which are half filled."""
    mean = integral[start + m : stop + m] - integral[start:stop]
    size: FloatArray = filled[start + m : stop + m] - filled[start:stop]
    enough: NDArray[np.bool_] = size >= m / 2
    mean /= np.maximum(size, 1.0)
    return mean, enough


def _structure_function(series: AxisSeries, lags: int) -> tuple[FloatArray, FloatArray]:
    """Return D(k), the mean square difference of samples k apart, and their number; shape (lags + 1,)."""
    from scipy.fft import irfft, next_fast_len, rfft

    size = next_fast_len(series.clock.grid_size + lags, real=True)
    here, value = np.zeros((2, size))
    place = series.clock.grid()
    here[place] = 1.0
    value[place] = series.samples - series.samples.mean()
    presence, plain, squared = rfft(here), rfft(value), rfft(value**2)
    pairs: FloatArray = np.rint(irfft(np.abs(presence) ** 2, size)[: lags + 1])
    # w[t] w[t+k] (y[t+k] - y[t])², summed over t, is even in k: the real part holds both squares.
    total: FloatArray = irfft(2 * (presence * squared.conj()).real - 2 * np.abs(plain) ** 2, size)[: lags + 1]
    return total / np.maximum(pairs, 1.0), pairs
