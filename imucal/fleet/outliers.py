"""Odd units of a fleet: leave-one-out residuals, with Benjamini and Hochberg's false discovery rate.

A unit is compared with what the others are like, so that it can't hide by widening the spread that it is
judged by. Benjamini & Hochberg (1995), Journal of the Royal Statistical Society B 57, p. 289.
"""

import numpy as np

from imucal.arrays import FloatArray

#: Expected share of false ones among the units that are called odd.
FALSE_SHARE = 0.05
#: Fewer units leave no degrees of freedom to judge one by the others.
_FEWEST = 4


def leave_one_out(centre: FloatArray, deviation: FloatArray, tau: float) -> FloatArray:
    """Return two-sided p-values of the units, each against the mean and the spread of the others.

    Parameters
    ----------
    centre, deviation
        Logarithm of each unit's coefficient and its standard error, shape (units,).
    tau
        Standard deviation between units: it sets the units' weights, not the scale of the test.
    """
    from scipy.special import stdtr

    n = centre.size
    if n < _FEWEST:
        return np.ones(n)
    w = 1 / (deviation**2 + max(tau, 1e-12) ** 2)
    total = w.sum()
    rest = total - w
    mean = np.sum(w * centre) / total
    apart = (centre - mean) * total / rest
    # Squares about the mean of the others: those about the mean of all, less the unit's own share.
    squares = np.sum(w * (centre - mean) ** 2) - w * (centre - mean) * apart
    scale = np.sqrt(np.maximum(squares, 1e-300) / (n - 2) * (1 / w + 1 / rest))
    result: FloatArray = 2 * stdtr(n - 2, -np.abs(apart) / scale)
    return result


def adjusted(p: FloatArray) -> FloatArray:
    """Return p-values adjusted for the number of tests by Benjamini and Hochberg's step-up procedure."""
    order = np.argsort(p)
    stepped = p[order] * p.size / np.arange(1, p.size + 1)
    result = np.empty(p.size)
    result[order] = np.minimum(np.minimum.accumulate(stepped[::-1])[::-1], 1.0)
    return result
