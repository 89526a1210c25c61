"""The Gauss-Markov term in the DCT domain: expectation of a squared ordinate, and its slope in T."""

import numpy as np

from imucal.arrays import FloatArray


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
    den = one_minus**2 + phi * lam
    ends = sign * np.exp(-length * a)
    share = 2 * phi * one_minus * (2 - lam / 2) / (length * (1 + phi) * den)
    bracket = 1 - (1 - ends) * share
    # d/dlog T of a is -a; every factor's logarithmic slope follows from that.
    slope_den = a * phi * (lam - 2 * one_minus) / den
    slope_power = -2 * a * np.exp(-2 * a) / power
    slope_share = share * (a - a * phi * (1 / one_minus + 1 / (1 + phi)) - slope_den)
    slope_bracket = ends * length * a * share - (1 - ends) * slope_share
    shape = power / den
    return shape * bracket, shape * (bracket * (slope_power - slope_den) + slope_bracket)
