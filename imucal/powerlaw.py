"""The four power-law noises of one unit per sample, in closed form.

The second-order statistics of a process with stationary increments follow from V(n), the generalised variance
of the sum of n consecutive samples:

    avar(m) = (4 V(m) - V(2m)) / (2 m^2)
    V(n) = n^2 r(0) - sum over k < n of (n - k) D(k)

with the mean square difference D(k) of samples k apart and the variance r(0), which cancels in avar and is 0
for noise without one. Units are per sample and rad/sample.

Source: Guerrier, Molinari, Stebler: Allan variance (MOAV, Def. 4.3); Greenhall & Riley (2003), "Uncertainty
of stability variances based on finite differences".
"""

from collections.abc import Callable
from enum import Enum

import numpy as np

from imucal.arrays import FloatArray, IntArray


def odd_harmonic(n: FloatArray) -> FloatArray:
    """Return O_n = sum of 1/(2j-1) for j = 1 … n; O_0 = 0."""
    from scipy.special import digamma

    n = np.asarray(n, dtype=np.float64)
    positive = np.maximum(n, 1.0)
    value = 0.5 * (digamma(positive + 0.5) + np.euler_gamma) + np.log(2.0)
    return np.where(n > 0, value, 0.0)


class PowerLaw(Enum):
    """A noise with a power-law spectrum, per-sample variance parameter 1.

    QUANTIZATION is the first difference of white noise of unit variance, WHITE has unit variance, FLICKER has
    psd 1/(2 sin(w/2)), WALK sums white steps of unit variance.
    """

    QUANTIZATION = "Q"
    WHITE = "N"
    FLICKER = "B"
    WALK = "K"

    def sum_variance(self, n: FloatArray) -> FloatArray:
        """Return V(n), the generalised variance of the sum of n samples; V is even, V(0) = 0."""
        n = np.abs(np.asarray(n, dtype=np.float64))
        match self:
            case PowerLaw.QUANTIZATION:
                return np.where(n == 0, 0.0, 2.0)
            case PowerLaw.WHITE:
                return n
            case PowerLaw.FLICKER:
                sums = (4 * n * n - 1) * odd_harmonic(n - 1) - (n - 1) * (3 * n + 1)
                return np.where(n == 0, 0.0, -sums / (2 * np.pi))
            case PowerLaw.WALK:
                return -(n**3 - n) / 6.0

    def structure(self, k: FloatArray) -> FloatArray:
        """Return D(k), the mean square difference of samples k apart; D is even, D(0) = 0."""
        k = np.abs(np.asarray(k, dtype=np.float64))
        match self:
            case PowerLaw.QUANTIZATION:
                return np.where(k == 0, 0.0, np.where(k == 1, 6.0, 4.0))
            case PowerLaw.WHITE:
                return np.where(k == 0, 0.0, 2.0)
            case PowerLaw.FLICKER:
                flicker: FloatArray = 4 / np.pi * odd_harmonic(k)
                return flicker
            case PowerLaw.WALK:
                return k

    def avar(self, m: FloatArray) -> FloatArray:
        """Return the exact Allan variance at averaging factors `m`, shape (k,)."""
        return (4 * self.sum_variance(m) - self.sum_variance(2 * m)) / (2 * m * m)

    def psd(self, omega: FloatArray) -> FloatArray:
        """Return the two-sided psd per sample at angular frequencies `omega`, rad/sample."""
        half = 2 * np.abs(np.sin(np.asarray(omega, dtype=np.float64) / 2))
        match self:
            case PowerLaw.QUANTIZATION:
                return half**2
            case PowerLaw.WHITE:
                return np.ones_like(half)
            case PowerLaw.FLICKER:
                return 1.0 / half
            case PowerLaw.WALK:
                return 1.0 / half**2

    def dct_spectrum(self, n: int, first: IntArray, count: IntArray) -> FloatArray:
        """Return the mean over bins of E[X_k²], the expected square of orthonormal DCT-II ordinates; (b,).

        Of n >= 2 samples, per unit variance parameter; `first` and `count`, shape (b,), are the first
        ordinate and the number of ordinates of each bin, of ordinates 1 … n-1.

        White noise and the random walk are exact, and quantization with its two boundary values. The relative
        error of flicker is below 0.05/n². The mean over bins of more than 8 ordinates has relative error
        below 3e-8 if the first ordinate is above 128. Cost O(b).

        Source: E[X_k²] = r_0-weighted cosine sum of the structure function; for flicker summed in closed
        form, with Si for the finite length.
        """
        start: FloatArray = np.asarray(first, dtype=np.float64)
        size: FloatArray = np.asarray(count, dtype=np.float64)
        match self:
            case PowerLaw.QUANTIZATION:
                return _mean_quantization(n, start, size)
            case PowerLaw.WHITE:
                return np.ones(start.shape)
            case PowerLaw.FLICKER:
                return _bin_mean(n, start, size, _flicker_ordinate, _flicker_wide)
            case PowerLaw.WALK:
                return _bin_mean(n, start, size, _walk_ordinate, _walk_wide)


#: Bins of up to this many ordinates are summed.
_NARROW = 8


def _bin_mean(
    n: int,
    first: FloatArray,
    count: FloatArray,
    ordinate: Callable[[int, FloatArray], FloatArray],
    wide: Callable[[int, FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Sum narrow bins term by term; integrate over wide ones."""
    mean = np.empty(first.shape)
    narrow = count <= _NARROW
    start, size = first[narrow], count[narrow]
    total = np.zeros(start.shape)
    for step in range(_NARROW):
        inside = step < size
        total[inside] += ordinate(n, start[inside] + step)
    mean[narrow] = total / size
    mean[~narrow] = wide(n, first[~narrow], count[~narrow])
    return mean


def _mean_quantization(n: int, first: FloatArray, count: FloatArray) -> FloatArray:
    """Mean of 4 sin²(w/2) + (4/n) cos²(w/2) over w = pi k / n, in closed form (Dirichlet kernel)."""
    half = np.pi / (2 * n)
    middle = half * (first + (count - 1) / 2)
    spread = np.sin(count * half) / (count * np.sin(half))
    # 1 - spread loses its digits in narrow bins; its series does not.
    square = (count * half) ** 2
    series = half**2 * (count**2 - 1) / 6 * (1 - (3 * square - 7 * half**2) / 60)
    lost = np.where(square < 1e-4, series, 1 - spread)
    mean: FloatArray = 2 * lost + 4 * (1 - lost) * np.sin(middle) ** 2
    return mean * (1 - 1 / n) + 4 / n


def _bin_ends(n: int, first: FloatArray, count: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return half the angle between ordinates, and at both ends of each bin."""
    step = np.pi / (2 * n)
    return step, step * (first - 0.5), step * (first + count - 0.5)


def _rise_of_slope(step: float, low: FloatArray, high: FloatArray, power: int) -> FloatArray:
    """Return the change of -step cos / (2 sin^power), an ordinate's slope, over each bin."""
    first, last = (-step * np.cos(u) / (2 * np.sin(u) ** power) for u in (low, high))
    return np.asarray(last - first)


def _walk_ordinate(n: int, k: FloatArray) -> FloatArray:
    squared: FloatArray = np.sin(np.pi * k / (2 * n)) ** 2
    return 0.25 / squared


def _walk_wide(n: int, first: FloatArray, count: FloatArray) -> FloatArray:
    """Mean of 1/(4 sin²) by its integral and the first Euler-Maclaurin (midpoint) correction."""
    step, low, high = _bin_ends(n, first, count)
    integral: FloatArray = np.sin(high - low) / (np.sin(low) * np.sin(high)) / (4 * step)
    return (integral - _rise_of_slope(step, low, high, 3) / 24) / count


def _flicker_ordinate(n: int, k: FloatArray) -> FloatArray:
    from scipy.special import sici

    angle = np.pi * k
    odd = np.where(k % 2 == 1, 2.0, 0.0)
    finite: FloatArray = 2 / np.pi * (sici(angle)[0] - (odd - 1) / angle) - 1
    interior: FloatArray = 0.5 / np.sin(angle / (2 * n)) * (1 + finite)
    return interior + _flicker_boundary(n, k)


def _flicker_wide(n: int, first: FloatArray, count: FloatArray) -> FloatArray:
    """Mean of 1/(2 sin) by its integral and first correction, plus the boundary term at the middle."""
    step, low, high = _bin_ends(n, first, count)
    integral = np.log(np.tan(high / 2) / np.tan(low / 2)) / (2 * step)
    mean: FloatArray = (integral - _rise_of_slope(step, low, high, 2) / 24) / count
    return mean + _flicker_boundary(n, first + (count - 1) / 2)


def _flicker_boundary(n: int, k: FloatArray) -> FloatArray:
    """Return the boundary term of ordinate k of flicker in a series of n samples.

    With s, c = sin, cos(w/2): -(1/s - (s/c) ln cot(w/4)) / (pi n) of the spectrum 1/(2 s).
    """
    half = np.pi * k / (2 * n)
    s, c = np.sin(half), np.cos(half)
    share: FloatArray = -(1 / s - s / c * np.log(1 / np.tan(half / 2))) / (np.pi * n)
    return 0.5 / s * share
