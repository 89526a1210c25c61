"""The Allan variance of any noise: an integral of its psd, or a sum of its autocovariance.

For a process y sampled at tau0 and averaging factor m,

    avar(m) = 2 * integral from 0 to 1/(2 tau0) of S(f) 2 sin^4(pi f m tau0) / (m sin(pi f tau0))^2 df
            = sum over k = 1 … 2m-1 of w_k (r_0 - r_k) / m^2,   w_k = (2m - k) - 4 max(m - k, 0)

with the two-sided psd S of the *samples* and their autocovariance r. For a rate in continuous time,
averaged over tau = m tau0, the first becomes

    avar(tau) = 2 * integral from 0 to infinity of S(f) 2 sin^4(pi f tau) / (pi f tau)^2 df.

Source: Guerrier, Molinari, Stebler: Allan variance, lemmas 4.1 and 4.2; IEEE Std 952-1997, eq. (C.4).
"""

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from imucal.arrays import FloatArray
from imucal.noise.psd_function import Psd, psd_function
from imucal.noise.psd_integral import PsdIntegral

#: An autocovariance of lags 0, 1, 2 …, shape (k,); or its values there, 0 beyond.
Acvf: TypeAlias = Callable[[FloatArray], ArrayLike] | ArrayLike
#: Values that may stand for 0 by rounding, relative to the variance.
_ROUNDING = 1e-9


def avar_from_psd(
    psd: Psd, m: ArrayLike, tau0: float, *, sampled: bool = True, breaks: Sequence[float] = ()
) -> FloatArray:
    """Return the Allan variance of a noise of any psd.

    Parameters
    ----------
    psd
        Two-sided density in U²/Hz (half of a one-sided one): a function of frequencies in Hz, shape
        (k,), called for positive ones only; or two arrays, frequencies that rise and the density
        there, between which it runs straight on logarithmic axes and beyond which it stays as it is.
        It may grow towards 0 less steeply than 1/f³.
    m
        Averaging factors, whole numbers from 1, any shape.
    tau0
        Sampling period in s.
    sampled
        The psd is that of the samples, used up to 1/(2 tau0). False: that of a rate in continuous
        time, averaged over m tau0, used at all frequencies; it may grow less steeply than f.
    breaks
        Frequencies in Hz where the psd jumps or peaks within less than a hundredth of itself, which
        could otherwise be missed.

    Returns
    -------
    The Allan variance, shape of `m`, in U²; right to some 1e-9 of itself.

    Raises
    ------
    ValueError
        If an argument is out of range, the psd is negative or not finite somewhere, or the integral
        is infinite; the message says where.

    Examples
    --------
    White noise of variance 1 per sample at 100 Hz has the psd 0.01 U²/Hz:

    >>> float(avar_from_psd(lambda f: 0.01 + 0 * f, [4], 0.01)[0])
    0.25
    """
    factors = _factors(m)
    if not (math.isfinite(tau0) and tau0 > 0):
        msg = f"tau0 must be positive and finite, got {tau0}"
        raise ValueError(msg)
    density, kinks = psd_function(psd)
    kinks = np.concatenate([kinks, np.asarray(breaks, dtype=np.float64)]) * tau0
    distinct, place = np.unique(factors, return_inverse=True)
    integral = PsdIntegral(
        density=lambda f: density(f / tau0) / tau0,
        m=distinct,
        sampled=sampled,
        breaks=np.unique(kinks[np.isfinite(kinks) & (kinks > 0)]),
        tau0=tau0,
    )
    return integral.total()[place].reshape(np.shape(m))


def avar_from_acvf(acvf: Acvf, m: ArrayLike) -> FloatArray:
    """Return the Allan variance of stationary samples of any autocovariance.

    Parameters
    ----------
    acvf
        Autocovariance in U²: a function of lags 0, 1, 2 … as an array, shape (k,); or its values at
        those lags, 0 beyond the last.
    m
        Averaging factors, whole numbers from 1, any shape.

    Returns
    -------
    The Allan variance, shape of `m`, in U². Cost: 2m values of `acvf` for the greatest m.

    Raises
    ------
    ValueError
        If a factor is no whole number from 1, or `acvf` is not finite or no autocovariance: beyond
        that of lag 0, or such that an Allan variance would be negative.

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
            msg = f"acvf is no autocovariance: the Allan variance at m = {factor} would be {total[i]:.3g}"
            raise ValueError(msg)
    return np.maximum(total, 0.0).reshape(np.shape(m))


def _factors(m: ArrayLike) -> FloatArray:
    """Return averaging factors as shape (k,), which must be whole numbers from 1."""
    factors = np.asarray(m, dtype=np.float64).ravel()
    wrong = factors[~(np.isfinite(factors) & (factors >= 1) & (factors == np.round(factors)))]
    if wrong.size:
        msg = f"averaging factors must be whole numbers from 1, got {wrong[0]:g}"
        raise ValueError(msg)
    return factors


def _falls(acvf: Acvf, greatest: int) -> tuple[float, FloatArray]:
    """Return r_0 and r_0 - r_k at k = 0 … 2 m - 1, the autocovariance checked."""
    lags = np.arange(2.0 * greatest)
    if callable(acvf):
        values = np.asarray(acvf(lags), dtype=np.float64)
        if values.shape != lags.shape:
            msg = f"acvf must return shape {lags.shape} for lags of that shape, got {values.shape}"
            raise ValueError(msg)
    else:
        given = np.asarray(acvf, dtype=np.float64)
        if given.ndim != 1 or not given.size:
            msg = f"acvf must have shape (k,) with at least lag 0, got {given.shape}"
            raise ValueError(msg)
        values = np.zeros(max(lags.size, given.size))
        values[: given.size] = given
    finite = np.isfinite(values)
    if not finite.all():
        at = int(np.argmin(finite))
        msg = f"acvf must be finite, got {values[at]:g} at lag {at}; a random walk has none: use its psd"
        raise ValueError(msg)
    beyond = np.abs(values) > values[0] * (1 + _ROUNDING)
    if values[0] < 0 or beyond.any():
        at = 0 if values[0] < 0 else int(np.argmax(beyond))
        msg = f"acvf is no autocovariance: {values[at]:g} at lag {at} beside a variance of {values[0]:g}"
        raise ValueError(msg)
    return float(values[0]), values[0] - values[: lags.size]
