"""The Allan variance of any noise: an integral of its psd, or a sum of its autocovariance.

For a process y sampled at tau0 and averaging factor m,

    avar(m) = 2 * integral from 0 to 1/(2 tau0) of S(f) 2 sin^4(pi f m tau0) / (m sin(pi f tau0))^2 df
            = sum over k = 1 … 2m-1 of w_k (r_0 - r_k) / m^2,   w_k = (2m - k) - 4 max(m - k, 0)

with the two-sided psd S of the *samples* and their autocovariance r. For a rate in continuous time, averaged
over tau = m tau0, the first equation becomes

    avar(tau) = 2 * integral from 0 to infinity of S(f) 2 sin^4(pi f tau) / (pi f tau)^2 df.

The integral is computed octave by octave until the rest is a geometric tail.

Source: Guerrier, Molinari, Stebler: Allan variance, lemmas 4.1 and 4.2; IEEE Std 952-1997, eq. (C.4).
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray
from imucal.errors import ArgumentError

#: A psd as a function of frequencies in Hz, shape (k,); or increasing frequencies and the psd there.
Psd: TypeAlias = Callable[[FloatArray], ArrayLike] | tuple[ArrayLike, ArrayLike]


def _function_of_points(
    frequency: ArrayLike, density: ArrayLike
) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
    f, s = np.asarray(frequency, dtype=np.float64), np.asarray(density, dtype=np.float64)
    if f.ndim != 1 or f.shape != s.shape or not f.size:
        raise ArgumentError(f"a psd of arrays must be two of one shape (k,), got {f.shape} and {s.shape}")
    if not (f[0] > 0 and np.all(np.diff(f) > 0) and np.all(np.isfinite(f))):
        raise ArgumentError("frequencies of a psd must be positive, finite and increasing")
    if not (np.all(s > 0) and np.all(np.isfinite(s))):
        at = int(np.argmin((s > 0) & np.isfinite(s)))
        raise ArgumentError(
            f"psd given by points must be positive and finite, got {s[at]:g} at {f[at]:.6g} Hz"
        )
    x, y = np.log(f), np.log(s)
    return (lambda at: np.exp(np.interp(np.log(at), x, y))), f


#: Maximum number of octaves in a tail.
_FURTHEST = 448
#: Ratio of neighbouring octaves from which a tail diverges.
_DIVERGENT = 1 - 1e-6
#: A tail ends if its last octave is below this fraction of the whole.
_NEGLIGIBLE = 1e-14
#: Growth of the phase of sin^4 in a piece from which it is integrated with cosines.
_CALM = 4.0
#: Relative error requested.
_TOLERANCE = 1e-11
#: Largest relative error accepted.
_WORST = 1e-6
#: Largest number of subdivisions.
_HALVINGS = 200


#: Distances from a break at which pieces end, relative to its frequency.
_CLOSER = 0.5 ** np.arange(1, 31)


class _InfiniteError(ValueError):
    """The psd is infinite at some frequency."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _PsdIntegral:
    """2 * integral of density * kernel at one m, in cycles per sample.

    `errors` collects the error and start of each piece.
    """

    density: Callable[[float], float]
    m: float
    sampled: bool
    breaks: FloatArray
    tau0: float
    errors: list[tuple[float, float]] = field(default_factory=list)

    def total(self) -> float:
        # The average depends mostly on these frequencies.
        high = 0.5 if self.sampled else 8.0
        low = 2.0 ** -(math.ceil(math.log2(self.m)) + 5)
        total = sum(self._octave(low * 2.0**i) for i in range(round(math.log2(high / low))))
        total += self._tail(low / 2, 0.5, total)
        if not self.sampled:
            total += self._tail(high, 2.0, total)
        error, place = max(self.errors)
        if error > _WORST * total:
            msg = f"psd is too rough near {place / self.tau0:.6g} Hz to be integrated; smooth it first"
            raise ArgumentError(msg)
        return total

    def _tail(self, edge: float, ratio: float, total: float) -> float:
        parts: list[float] = []
        with suppress(_InfiniteError):
            for i in range(_FURTHEST):
                parts.append(self._octave(edge * ratio**i))
                if parts[-1] <= _NEGLIGIBLE * (total + sum(parts)):
                    return sum(parts)
        # The rest is a geometric series, or diverges.
        fall = (sum(parts[-4:]) / sum(parts[-8:-4])) ** 0.25 if len(parts) >= 8 else 1.0
        if not fall < _DIVERGENT:
            where, steep = ("0", "1/f^3") if ratio < 1 else ("infinity", "f")
            msg = (
                f"the Allan variance is infinite: the psd grows like {steep} or faster towards a frequency "
                f"of {where}"
            )
            raise ArgumentError(msg)
        return sum(parts) + parts[-1] * fall / (1 - fall)

    def _octave(self, low: float) -> float:
        inside = self.breaks[(self.breaks > low) & (self.breaks < 2 * low)].tolist()
        return sum(self._piece(a, b) for a, b in pairwise([low, *inside, 2 * low]))

    def _piece(self, low: float, high: float) -> float:
        """Return the integral over a piece, with sin^4 u = 3/8 - cos(2u)/2 + cos(4u)/8 for many periods."""
        if math.pi * self.m * (high - low) < _CALM:
            return self._quad(self._whole, low, high)
        mean = self._quad(self._smooth, low, high)
        if mean == 0:
            return 0.0
        turns = 2 * math.pi * self.m
        two, four = (self._quad(self._smooth, low, high, omega, mean) for omega in (turns, 2 * turns))
        return 0.375 * mean - 0.5 * two + 0.125 * four

    def _quad(
        self,
        function: Callable[[float], float],
        low: float,
        high: float,
        omega: float = 0.0,
        size: float = 0.0,
    ) -> float:
        """Return the integral of a function, times a cosine if `omega`; `size` sets the accuracy."""
        weight = {"weight": "cos", "wvar": omega, "epsrel": 0.0} if omega else {"epsrel": _TOLERANCE}
        value, error, *_ = scipy.integrate.quad(
            function, low, high, epsabs=_TOLERANCE * size, limit=_HALVINGS, full_output=1, **weight
        )
        self.errors.append((error, low))
        return float(value)

    def _lower(self, f: float) -> float:
        return self.m * (math.sin(math.pi * f) if self.sampled else math.pi * f)

    def _smooth(self, f: float) -> float:
        return 4 * self.density(f) / self._lower(f) ** 2

    def _whole(self, f: float) -> float:
        sine = math.sin(math.pi * self.m * f)
        # This order avoids underflow.
        return self.density(f) * sine * sine * (2 * sine / self._lower(f)) ** 2


#: An autocovariance as a function of lags 0, 1, 2 …, shape (k,); or its values there, 0 beyond.
Acvf: TypeAlias = Callable[[FloatArray], ArrayLike] | ArrayLike
#: Values below this are treated as rounding errors of 0, relative to the variance.
_ROUNDING = 1e-9


def avar_from_psd(
    psd: Psd, m: ArrayLike, tau0: float, *, sampled: bool = True, breaks: Sequence[float] = ()
) -> FloatArray:
    """Return the Allan variance of noise with any psd.

    Parameters
    ----------
    psd
        Two-sided density in U²/Hz (half of a one-sided one). Either a function of positive frequencies in
        Hz, shape (k,); or increasing frequencies and the density there, interpolated linearly on logarithmic
        axes and constant outside. Towards 0 the psd must grow less steeply than 1/f³.
    m
        Averaging factors, whole numbers from 1, any shape.
    tau0
        Sampling period in s.
    sampled
        True if the psd describes the samples, up to 1/(2 tau0). False if it describes a rate in continuous
        time, averaged over m tau0; it is then used at all frequencies and must grow less steeply than f.
    breaks
        Frequencies in Hz where the psd jumps, or has a peak narrower than a hundredth of its frequency.

    Returns
    -------
    The Allan variance, shape of `m`, in U², with a relative error of about 1e-9.

    Raises
    ------
    ValueError
        If an argument is out of range, the psd is negative or not finite somewhere, or the integral is
        infinite.

    Examples
    --------
    White noise of variance 1 per sample at 100 Hz has the psd 0.01 U²/Hz:

    >>> round(float(avar_from_psd(lambda f: 0.01 + 0 * f, 4, 0.01)), 9)
    0.25
    """
    factors = _factors(m)
    if not (math.isfinite(tau0) and tau0 > 0):
        raise ArgumentError(f"tau0 must be positive and finite, got {tau0}")
    function, kinks = (psd, np.zeros(0)) if callable(psd) else _function_of_points(*psd)
    # Pieces become shorter towards a break.
    near = np.outer(np.asarray(breaks, dtype=np.float64), 1 + np.outer([-1.0, 0.0, 1.0], _CLOSER))
    kinks = np.concatenate([kinks, near.ravel()]) * tau0
    distinct, place = np.unique(factors, return_inverse=True)
    kinks = np.unique(kinks[np.isfinite(kinks) & (kinks > 0)])

    @cache
    def density(f: float) -> float:
        with np.errstate(over="ignore", divide="ignore"):
            values = np.asarray(function(np.array([f / tau0])), dtype=np.float64)
        if values.shape != (1,):
            raise ArgumentError(
                f"psd must return shape (1,) for frequencies of that shape, got {values.shape}"
            )
        if not values[0] >= 0:
            raise ArgumentError(f"psd must be 0 or more everywhere, got {values[0]:g} at {f / tau0:.6g} Hz")
        if math.isinf(values[0]):
            raise _InfiniteError(f"psd must be finite, got inf at {f / tau0:.6g} Hz")
        return float(values[0]) / tau0

    total = [
        _PsdIntegral(density=density, m=factor, sampled=sampled, breaks=kinks, tau0=tau0).total()
        for factor in distinct.tolist()
    ]
    return np.array(total)[place].reshape(np.shape(m))


def avar_from_acvf(acvf: Acvf, m: ArrayLike) -> FloatArray:
    """Return the Allan variance of stationary samples with any autocovariance.

    Parameters
    ----------
    acvf
        Autocovariance in U²: a function of lags 0, 1, 2 … as an array, shape (k,); or its values at
        those lags, 0 beyond the last.
    m
        Averaging factors, whole numbers from 1, any shape.

    Returns
    -------
    The Allan variance, shape of `m`, in U². Cost: 2m values of `acvf` for the largest m.

    Raises
    ------
    ValueError
        If a factor is not a whole number from 1, or `acvf` is not finite or not an autocovariance.

    Examples
    --------
    A moving average y = e[t] + 0.5 e[t-1] of unit white noise: (1.5² m - 1.5) / m².

    >>> avar_from_acvf([1.25, 0.5], [1, 2]).tolist()
    [0.75, 0.75]
    """
    factors = _factors(m)
    variance, fall = _falls(acvf, int(factors.max(initial=1.0)))
    total = np.empty(factors.size)
    for i, factor in enumerate(factors.astype(np.int64).tolist()):
        k = np.arange(1.0, 2 * factor)
        weight = (2 * factor - k) - 4 * np.maximum(factor - k, 0.0)
        total[i] = float(weight @ fall[1 : 2 * factor]) / factor**2
        if total[i] < -_ROUNDING * variance:
            msg = f"acvf is not an autocovariance: the Allan variance at m = {factor} would be {total[i]:.3g}"
            raise ArgumentError(msg)
    return np.maximum(total, 0.0).reshape(np.shape(m))


def _factors(m: ArrayLike) -> FloatArray:
    factors = np.asarray(m, dtype=np.float64).ravel()
    wrong = factors[~(np.isfinite(factors) & (factors >= 1) & (factors == np.round(factors)))]
    if wrong.size:
        raise ArgumentError(f"averaging factors must be whole numbers from 1, got {wrong[0]:g}")
    return factors


def _falls(acvf: Acvf, greatest: int) -> tuple[float, FloatArray]:
    """Return r_0, and r_0 - r_k at k = 0 … 2 m - 1."""
    lags = np.arange(2.0 * greatest)
    if callable(acvf):
        values = np.asarray(acvf(lags), dtype=np.float64)
        if values.shape != lags.shape:
            msg = f"acvf must return shape {lags.shape} for lags of that shape, got {values.shape}"
            raise ArgumentError(msg)
    else:
        given = np.asarray(acvf, dtype=np.float64)
        if given.ndim != 1 or not given.size:
            raise ArgumentError(f"acvf must have shape (k,) with at least lag 0, got {given.shape}")
        values = np.zeros(max(lags.size, given.size))
        values[: given.size] = given
    finite = np.isfinite(values)
    if not finite.all():
        at = int(np.argmin(finite))
        msg = f"acvf must be finite, got {values[at]:g} at lag {at}; a random walk has none: use its psd"
        raise ArgumentError(msg)
    beyond = np.abs(values) > values[0] * (1 + _ROUNDING)
    if values[0] < 0 or beyond.any():
        at = 0 if values[0] < 0 else int(np.argmax(beyond))
        msg = f"acvf is not an autocovariance: {values[at]:g} at lag {at}, but the variance is {values[0]:g}"
        raise ArgumentError(msg)
    return float(values[0]), values[0] - values[: lags.size]
