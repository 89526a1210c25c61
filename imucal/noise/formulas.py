"""Formulas of the terms that need care with rounding, per unit variance and sample."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.powerlaw import odd_harmonic


def gauss_markov_avar(m: FloatArray, a: float) -> FloatArray:
    """Return the Allan variance of a unit-variance AR1 with phi = exp(-a).

    The closed form loses all digits as a -> 0, where the series in a takes over; together they
    are right to about 1e-11 (tested against the sum of autocovariances).
    """
    phi, one_minus_phi = np.exp(-a), -np.expm1(-a)
    d = -np.expm1(-a * m)
    closed = (m * -np.expm1(-2 * a) - phi * d * (2 + d)) / (m * one_minus_phi) ** 2
    p1 = (2 * m**2 + 1) / (6 * m)
    p2 = m**2 / 2
    p3 = (21 * m**4 - 5 * m**2 - 1) / (30 * m)
    p4 = m**4 - m**2 / 2
    series = 2 * (a * p1 - a**2 * p2 / 2 + a**3 * p3 / 6 - a**4 * p4 / 24)
    return np.where(a * m >= 5e-3, closed, series)


def gauss_markov_sum(n: FloatArray, a: float) -> FloatArray:
    """Return V(n) of a unit-variance AR1 with phi = exp(-a), by its closed form or its series in a n."""
    one_minus_phi = -np.expm1(-a)
    closed = (n * -np.expm1(-2 * a) + 2 * np.exp(-a) * np.expm1(-a * n)) / one_minus_phi**2
    first, second, third = (n**3 - n) / 3, (n**4 - n**2) / 12, (3 * n**5 - 5 * n**3 + 2 * n) / 180
    series = n**2 - a * first + a**2 * second - a**3 * third
    return np.where(a * n >= 1e-3, closed, series)


def draw_flicker(n: int, rng: np.random.Generator) -> FloatArray:
    """Return flicker with the exact structure function (4/pi) O_k, by circulant embedding.

    The first differences are stationary; their circulant autocovariance has a non-negative
    spectrum, so the draw is exact. Source: Davies & Harte (1987).
    """
    from scipy.fft import irfft, next_fast_len, rfft

    if n == 0:
        return np.zeros(0)
    size = next_fast_len(2 * n, real=True)
    half = size // 2
    structure = 4 / np.pi * odd_harmonic(np.arange(half + 2, dtype=np.float64))
    covariance = np.empty(half + 1)
    covariance[0] = structure[1]
    covariance[1:] = 0.5 * (structure[2:] + structure[:-2]) - structure[1:-1]
    circulant = np.concatenate([covariance, covariance[1 : size - half][::-1]])
    del structure, covariance
    spectrum = np.sqrt(np.maximum(rfft(circulant).real, 0.0))
    del circulant
    # In place: of a day these arrays are what a simulation holds at most.
    drawn = rfft(rng.standard_normal(size), overwrite_x=True)
    drawn *= spectrum
    del spectrum
    steps = irfft(drawn, size, overwrite_x=True)[:n]
    return np.cumsum(steps)


def gauss_markov_dct(
    log_time: FloatArray, lam: FloatArray, length: FloatArray, sign: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return E[X_k²] of a unit-variance AR1 and its derivative in the log of the correlation time.

    Parameters
    ----------
    log_time
        Logs of correlation times in samples, shape (c, 1).
    lam
        4 sin²(theta_k / 2), averaged over each bin, shape (b,).
    length
        Number of samples of the series each bin belongs to, shape (b,).
    sign
        (-1)^k for bins of a single ordinate, 0 for wider ones, where it averages out, shape (b,).

    Returns
    -------
    expectation, slope
        Shapes (c, b).

    Notes
    -----
    With phi = exp(-1/T), r = (-1)^k phi^n and den = (1 - phi)² + phi lam,

        E = (1 - phi²)/den [1 - (1 - r) (2 phi/n) (1 - phi) (1 + cos theta) / ((1 + phi) den)],

    exact for every T/n: the bracket is what the ends of the series take away.
    """
    a = np.exp(-log_time)
    phi, one_minus = np.exp(-a), -np.expm1(-a)
    power = -np.expm1(-2 * a)
    inverse = 1 / (one_minus**2 + phi * lam)
    share = (2 * phi * one_minus / (1 + phi)) * ((2 - lam / 2) / length) * inverse
    # d/dlog T of a is -a; every factor's logarithmic slope follows from that.
    slope_den = (a * phi) * (lam - 2 * one_minus) * inverse
    slope_power = -2 * a * np.exp(-2 * a) / power
    slope_share = share * (a - a * phi * (1 / one_minus + 1 / (1 + phi)) - slope_den)
    bracket, slope_bracket = 1 - share, -slope_share
    # The end of the series is seen by bins of a single ordinate, which are few.
    single = np.flatnonzero(sign)
    ends = sign[single] * np.exp(-length[single] * a)
    bracket[:, single] += ends * share[:, single]
    slope_bracket[:, single] += ends * (length[single] * a * share[:, single] + slope_share[:, single])
    shape = power * inverse
    return shape * bracket, shape * (bracket * (slope_power - slope_den) + slope_bracket)
