"""A coefficient that the logs of a whole fleet only bound, and how large it can be.

The mean of the units' squared coefficients is measured without bias, whatever the spread between them. It
bounds the median unit's square, and through it each share of the units: of all lognormal laws with root mean
square r, exp(m + t²) = r, a share p lies below exp(m + z t), which is r exp(z t - t²) ≤ r exp(z² / 4) for
the quantile z of p. So the bound needs no spread, which such logs do not tell.
"""

import math

import numpy as np

from imucal.fleet.log_value import LogValues

#: A mean square that is not so many deviations above zero, whichever unit is left out, is only bounded.
_SHOWN = 1.959963984540054


def only_bounded(values: LogValues) -> bool:
    """Return whether all logs together do not show the coefficient; one unit alone does not decide."""
    if np.isnan(np.where(np.isnan(values.variance), values.bound, values.variance)).any():
        return False
    square, error = values.unit_variances()
    weight = error**-2
    others = (np.sum(weight * square) - weight * square) / np.sqrt(np.sum(weight) - weight)
    return bool(others.min() < _SHOWN)


def rms_bound(values: LogValues, confidence: float) -> float:
    """Return the value that the units' root mean square stays below with a probability `confidence`.

    A normal law of the mean square, cut at zero (flat prior), its deviation as the units scatter where they
    do so more than their errors say.
    """
    from scipy.special import ndtr, ndtri

    square, error = values.unit_variances()
    weight = error**-2
    mean = float(np.sum(weight * square) / np.sum(weight))
    scatter = float(np.sum(weight * (square - mean) ** 2)) / max(square.size - 1, 1)
    deviation = math.sqrt(max(scatter, 1.0) / float(np.sum(weight)))
    beyond = (1 - confidence) * float(ndtr(mean / deviation))
    return math.sqrt(max(mean - deviation * float(ndtri(beyond)), 1e-300))


def share_bound(values: LogValues, content: float, confidence: float) -> float:
    """Return the value that a share `content` of all units stays below with a probability `confidence`."""
    from scipy.special import ndtri

    return rms_bound(values, confidence) * math.exp(max(float(ndtri(content)), 0.0) ** 2 / 4)
