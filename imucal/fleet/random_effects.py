"""How far values differ beyond their errors.

Source: DerSimonian & Laird (1986), Controlled Clinical Trials 7, p. 177.
"""

import numpy as np

from imucal.arrays import FloatArray


def variance_between(values: FloatArray, errors: FloatArray) -> float:
    """Return the variance of values, shape (n,), beyond their standard errors: by moments, 0 at least."""
    weight = errors**-2.0
    total = float(weight.sum())
    statistic = float(np.sum(weight * (values - np.average(values, weights=weight)) ** 2))
    return max(statistic - (values.size - 1), 0.0) / (total - float(np.square(weight).sum()) / total)
