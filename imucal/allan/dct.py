"""The DCT-II of the samples and its log-spaced bins: the input of intervals and likelihoods.

The DCT-II ordinates of sampled noise are almost uncorrelated; for white noise and a random walk they are
exactly uncorrelated. Long records are split into many short transforms, n = rows * columns, to save memory.

A day at 200 Hz of six axes must fit in 1 GB. For its axes of 17.3 million samples:

=========================================  =========  ==========
measured                                   this one   SciPy's
=========================================  =========  ==========
work memory, bytes per sample              17         32
CPU time of the first transform, s         0.76       1.15
CPU time of a later one, s                 0.39       0.44
largest resident set of `imucal adev`, MB  911        1156
largest resident set of `imucal fit`, MB   940        1204
=========================================  =========  ==========

SciPy caches a table of sines for each length.

Source: the boundary conditions of the DCT-II, Strang (1999), SIAM Review 41, 135; Bailey (1990), "FFTs in
external or hierarchical memory", J. Supercomputing 4, 23; the DCT-II as a real transform of the even samples,
then the odd ones backwards: Makhoul (1980), IEEE Trans. ASSP 28, 27.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.errors import ArgumentError, DataError
from imucal.recording import AxisSeries

ComplexArray: TypeAlias = NDArray[np.complex128]

#: From this length on, transforms are split. Shorter ones need less than 16 MB in SciPy.
LONG = 500_000
#: Values per piece of work: it fits into the cache.
_PIECE = 1 << 16
#: Minimum number of adjacent columns in a piece: access by fewer columns is strided.
_MIN_COLUMNS = 16
#: The exponent of n in `split`, the fastest by measurement.
_SHARE = 0.43
#: Ordinates per group of bins: they fit in the cache.
_BLOCK = 65536
#: Any length up to this one is fast.
_QUICK = 65536
#: Longer lengths are fast without a larger prime factor.
_PRIME = 127
#: Number of computed sines of a ramp; the others follow by angle addition.
_TABLE = 1 << 12
#: Largest fraction of the samples that `fast_length` drops.
_CUT = 1e-4


def dct2(samples: FloatArray, mean: float = 0.0) -> FloatArray:
    """Return the orthonormal DCT-II of `samples` minus `mean`, using little memory."""
    if samples.size >= LONG:
        return four_step_dct(samples, mean)
    return np.asarray(scipy.fft.dct(samples - mean, type=2, norm="ortho", overwrite_x=True))


def idct2(ordinates: FloatArray) -> FloatArray:
    """Return the inverse of the orthonormal DCT-II. Overwrites `ordinates`."""
    if ordinates.size >= LONG:
        return four_step_idct(ordinates)
    return np.asarray(scipy.fft.idct(ordinates, type=2, norm="ortho", overwrite_x=True))


def split(n: int) -> int:
    """Return the divisor of `n` nearest to n^0.43, used as the number of rows.

    It is below the square root because access by column is strided.
    """
    small = [divisor for divisor in range(1, math.isqrt(n) + 1) if n % divisor == 0]
    wanted = n**_SHARE
    return min((*small, n // small[-1]), key=lambda divisor: max(divisor / wanted, wanted / divisor))


def four_step_dct(samples: FloatArray, mean: float) -> FloatArray:
    """Return the orthonormal DCT-II of `samples` minus `mean`; n should have small factors.

    Let v be the even samples followed by the odd ones in reverse order, V its Fourier transform, and W =
    exp(-i pi k / 2n) V[k]. Ordinate k is the real part of W; ordinate n - k is minus its imaginary part.
    """
    n = samples.size
    rows = split(n)
    columns = n // rows
    result = np.empty(n)
    half = (n + 1) // 2
    np.subtract(samples[::2], mean, out=result[:half])
    np.subtract(samples[1::2], mean, out=result[half:][::-1])
    values, inner = result.reshape(rows, columns), np.empty((rows // 2 + 1, columns), dtype=np.complex128)
    step = max(_MIN_COLUMNS, _PIECE // rows)
    for start in range(0, columns, step):
        inner[:, start : start + step] = scipy.fft.rfft(values[:, start : start + step], axis=0)
    # V[r + rows * c] is in row r, column c; rows above the middle are conjugates of the lower ones.
    place = result.reshape(columns, rows)
    shift = np.sqrt(2 / n) * np.exp(-0.5j * np.pi / columns * np.arange(columns))
    step = max(_MIN_COLUMNS, _PIECE // columns)
    for start in range(0, len(inner), step):
        stop = min(start + step, len(inner))
        part = inner[start:stop] * _turns(np.arange(start, stop), n, columns)
        part = scipy.fft.fft(part, axis=1, overwrite_x=True)
        part *= shift
        place[:, start:stop] = part.real.T
        # Row 0 and the middle row already have their mirrored values.
        first, last = max(start, 1), min(stop, (rows + 1) // 2)
        mirrored = place[::-1, rows - last + 1 : rows - first + 1]
        np.negative(part[first - start : last - start][::-1].imag.T, out=mirrored)
    result[0] *= np.sqrt(0.5)
    return result


def four_step_idct(ordinates: FloatArray) -> FloatArray:
    """Return the inverse of `four_step_dct` (the orthonormal DCT-III). Overwrites `ordinates`."""
    n = ordinates.size
    rows = split(n)
    columns = n // rows
    place = ordinates.reshape(columns, rows)
    inner = np.empty((rows // 2 + 1, columns), dtype=np.complex128)
    shift = np.sqrt(n / 2) * np.exp(0.5j * np.pi / columns * np.arange(columns))
    step = max(_MIN_COLUMNS, _PIECE // columns)
    for start in range(0, len(inner), step):
        stop = min(start + step, len(inner))
        part = inner[start:stop]
        part.real = place[:, start:stop].copy().T
        first = max(start, 1)
        part.imag[first - start :] = -place[::-1, rows - stop + 1 : rows - first + 1].copy().T[::-1]
        if start == 0:
            part.real[0, 0] *= np.sqrt(2)
            part.imag[0, 0] = 0.0
            part.imag[0, 1:] = -place[:0:-1, 0]
        part *= shift
        part[:] = scipy.fft.ifft(part, axis=1, overwrite_x=True)
        part *= _turns(np.arange(start, stop), n, columns).conj()
    values = ordinates.reshape(rows, columns)
    step = max(_MIN_COLUMNS, _PIECE // rows)
    for start in range(0, columns, step):
        values[:, start : start + step] = scipy.fft.irfft(inner[:, start : start + step], rows, axis=0)
    del inner, part
    half = (n + 1) // 2
    result = np.empty(n)
    result[::2] = values.ravel()[:half]
    result[1::2] = values.ravel()[half:][::-1]
    return result


def _turns(rows: IntArray, n: int, columns: int) -> ComplexArray:
    """Return exp(-2 pi i r (c + 1/4) / n) for rows r and columns c = 0 … columns - 1, shape (r, columns)."""
    few = math.isqrt(columns) + 1
    angle = (-2 * np.pi / n) * rows[:, np.newaxis]
    near = np.exp(1j * angle * (np.arange(few) + 0.25))
    far = np.exp(1j * angle * (few * np.arange(-(-columns // few))))
    products = far[:, :, np.newaxis] * near[:, np.newaxis, :]
    return np.asarray(products.reshape(rows.size, -1)[:, :columns])


@dataclass(frozen=True, kw_only=True, eq=False)
class DctBins(ReadOnlyArrays):
    """Bins of the ordinates k = 1 … n-1 of n samples: single ordinates first, then bins of constant ratio.

    Each bin starts at ordinate `first` and contains `count` ordinates. `omega` is its mean angular frequency
    in rad/sample. Shape (b,) each.
    """

    n: int
    first: IntArray
    count: IntArray
    omega: FloatArray

    @property
    def size(self) -> int:
        return self.first.size

    def parts(self) -> Iterator[tuple[slice, slice, IntArray]]:
        """Yield groups of bins whose ordinates fit in the cache.

        Each item is the slice of bins, the slice of the ordinates (from 0), and the index in that slice at
        which each bin begins.
        """
        start = 0
        while start < self.size:
            stop = max(int(np.searchsorted(self.first, self.first[start] + _BLOCK)), start + 1)
            low = int(self.first[start]) - 1
            high = int(self.first[stop - 1] + self.count[stop - 1]) - 1
            yield slice(start, stop), slice(low, high), self.first[start:stop] - 1 - low
            start = stop


@lru_cache(maxsize=64)
def dct_bins(n: int, *, singles: int = 128, per_octave: int = 48) -> DctBins:
    """Return the bins for `n` samples, at least 2; an argument below its minimum is a ValueError.

    Each of the ordinates 1 … `singles` has its own bin. Higher bins widen to `per_octave` per octave.
    """
    if n < 2 or singles < 1 or per_octave < 1:
        raise ArgumentError(
            f"need n >= 2, singles >= 1 and per_octave >= 1, got {n}, {singles}, {per_octave}"
        )
    firsts = list(range(1, min(singles, n - 1) + 1))
    edge, wanted = firsts[-1] + 1, float(firsts[-1] + 1)
    while edge < n:
        firsts.append(edge)
        wanted = max(wanted * 2 ** (1 / per_octave), edge + 1)
        edge = round(wanted)
    first = np.array(firsts, dtype=np.int64)
    count = np.diff(first, append=n)
    return DctBins(n=n, first=first, count=count, omega=np.pi * (first + (count - 1) / 2) / n)


@dataclass(frozen=True, kw_only=True, eq=False)
class Transform(ReadOnlyArrays):
    """The DCT of an axis's longest run without a gap, computed once for its curve, its spectrum and its fit.

    Attributes
    ----------
    n
        Number of samples of the axis.
    start
        First sample of the run.
    ordinates
        Orthonormal DCT-II ordinates k = 1 … m-1 of the m transformed samples, shape (m-1,), in U.
    """

    n: int
    start: int
    ordinates: FloatArray

    @classmethod
    def of(cls, series: AxisSeries) -> "Transform | None":
        """Return the transform of finite samples; None without two neighbours."""
        longest = max(series.clock.segments, key=lambda segment: segment.size, default=None)
        if longest is None or longest.size < 2:
            return None
        size = max(fast_length(longest.size), 2)
        ordinates = dct_ordinates(series.samples[longest.start : longest.start + size])
        return cls(n=series.n, start=longest.start, ordinates=ordinates)


def run_ordinates(samples: FloatArray, start: int, size: int, transform: Transform | None) -> FloatArray:
    """Return `dct_ordinates` of `size` samples of an axis from `start` on, from its `transform` if possible.

    A transform of another number of samples is an ArgumentError.
    """
    if transform is not None:
        if transform.n != samples.size:
            raise ArgumentError(f"the transform is of {transform.n} samples, the axis has {samples.size}")
        if (transform.start, transform.ordinates.size + 1) == (start, size):
            return transform.ordinates
    return dct_ordinates(samples[start : start + size])


def dct_ordinates(samples: FloatArray) -> FloatArray:
    """Return the orthonormal DCT-II ordinates k = 1 … n-1 of `samples`, shape (n-1,), in U.

    Fewer than 2 samples, or a value that is not finite, raise a DataError.
    """
    if samples.size < 2:
        raise DataError(f"the spectrum needs at least 2 samples, got {samples.size}")
    mean = float(samples.mean())
    if not np.isfinite(mean):
        msg = "the spectrum needs finite samples; got NaN or infinity: leave those samples out first"
        raise DataError(msg)
    return dct2(samples, mean)[1:]


def bin_power(ordinates: FloatArray, bins: DctBins) -> FloatArray:
    """Return the sum of the squared ordinates of each bin, shape (b,), in U²."""
    if ordinates.shape != (bins.n - 1,):
        raise ArgumentError(f"ordinates must have shape ({bins.n - 1},), got {ordinates.shape}")
    power = np.empty(bins.size)
    for here, seen, starts in bins.parts():
        power[here] = np.add.reduceat(np.square(ordinates[seen]), starts)
    return power


def ramp_ordinates(n: int, count: int, *, first: int = 1) -> FloatArray:
    """Return the orthonormal DCT-II ordinates k = first … first+count-1 of the ramp 0, 1, … n-1.

    -sqrt(2/n) cos(theta/2) / (2 sin²(theta/2)) for odd k, 0 for even k.
    """
    ramp = np.zeros(count)
    odd = ramp[(first + 1) % 2 :: 2]
    lowest, step = np.pi / (2 * n) * (first + (first + 1) % 2), np.pi / n
    table = step * np.arange(min(_TABLE, odd.size), dtype=np.float64)
    sine, cosine = np.sin(table), np.cos(table)
    for start in range(0, odd.size, _TABLE):
        # Computing every sine would take longer than a transform.
        part = odd[start : start + _TABLE]
        angle = lowest + start * step
        s, c = np.sin(angle), np.cos(angle)
        high = s * cosine[: part.size] + c * sine[: part.size]
        part[:] = (c * cosine[: part.size] - s * sine[: part.size]) / (high * high)
    odd *= -np.sqrt(0.5 / n)
    return ramp


def fast_length(n: int) -> int:
    """Return the largest fast transform length up to `n` if it is within 1e-4 of `n`; if not, `n`.

    A large prime factor takes ten times as long. Dropping a fraction e of the samples moves an estimate by
    sqrt(e) of its standard error.
    """
    if n < _QUICK:
        return n
    for length in range(n, n - int(_CUT * n) - 1, -1):
        rest = length
        for factor in range(2, _PRIME + 1):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return length
    return n


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum(ReadOnlyArrays):
    """A two-sided power spectral density, averaged over bins of increasing width.

    Attributes
    ----------
    frequency
        Mean frequency of each bin, shape (k,), in Hz, increasing.
    psd
        Two-sided density, shape (k,), in U²/Hz.
    count
        Degrees of freedom of each bin, shape (k,): the number of averaged ordinates.
    """

    frequency: FloatArray
    psd: FloatArray
    count: FloatArray


def spectrum(series: AxisSeries, *, per_octave: int = 12, transform: Transform | None = None) -> Spectrum:
    """Return the log-binned psd of an axis; missing samples are skipped.

    The squared DCT-II ordinates of each unbroken run estimate the two-sided density without leakage from
    drift. The lowest eight frequencies have their own bins; higher bins widen to `per_octave` per octave. A
    `transform` of the finite samples saves time.

    Raises
    ------
    DataError
        If no run has at least 2 samples.
    """
    series = series.finite()
    runs = [s for s in series.clock.segments if s.size >= 2]
    if not runs:
        msg = f"a spectrum needs at least 2 neighbouring samples, got {series.n} samples"
        raise DataError(msg, place=series.name)
    sizes = [fast_length(run.size) for run in runs]
    grid = dct_bins(max(sizes), singles=8, per_octave=per_octave)
    edges = np.pi * np.append(grid.first - 0.5, grid.n - 0.5) / grid.n
    power, count, omega = np.zeros((3, grid.size))
    for run, size in zip(runs, sizes, strict=True):
        ordinates = run_ordinates(series.samples, run.start, size, transform)
        if size == grid.n:
            power += bin_power(ordinates, grid)
            omega += grid.omega * grid.count
            count += grid.count
            continue
        angle = np.pi * np.arange(1, size) / size
        bins = np.searchsorted(edges, angle) - 1
        power += np.bincount(bins, np.square(ordinates), grid.size)
        omega += np.bincount(bins, angle, grid.size)
        count += np.bincount(bins, minlength=grid.size)
    filled = count > 0
    frequency = omega[filled] / count[filled] * series.rate_hz / (2 * np.pi)
    return Spectrum(frequency=frequency, psd=power[filled] / count[filled] * series.tau0, count=count[filled])
