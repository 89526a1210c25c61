"""A coefficient that the logs of a whole fleet only bound, and how large it can be.

The mean of the units' squared coefficients is measured without bias, whatever the spread between them. It
bounds the median unit's square, and through it each share of the units: of all lognormal laws with root mean
square r, exp(m + t²) = r, a share p lies below exp(m + z t), which is r exp(z t - t²) ≤ r exp(z² / 4) for
the quantile z of p. So the bound needs no spread, which such logs do not tell.
"""

import math

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.log_value import LogValues
from imucal.fleet.random_effects import variance_between
from imucal.fleet.squares import Squares

#: A mean square that is not so many deviations above zero, whichever unit is left out, is only bounded.
_SHOWN = 1.959963984540054
#: Points of the mean square's likelihood, up to where its logarithm is so far below the peak.
_POINTS, _NOTHING = 1001, -30.0
#: How often its reach is doubled at most.
_DOUBLINGS = 200
#: Units that are added at a time.
_CHUNK = 1024


def only_bounded(values: LogValues) -> bool:
    """Return whether all logs together do not show the coefficient; one unit alone does not decide."""
    if np.isnan(np.where(np.isnan(values.variance), values.bound, values.variance)).any():
        return False
    # At zero, as the question is.
    units = values.squares().mean_by(values.unit, 0.0)
    square, weight = units.estimate, units.sd**-2.0
    others = (np.sum(weight * square) - weight * square) / np.sqrt(np.sum(weight) - weight)
    return bool(others.min() < _SHOWN)


def rms_bound(values: LogValues, confidence: float) -> float:
    """Return the value that the units' root mean square stays below with a probability `confidence`.

    Of one square for all units, or of the mean of squares that differ, whichever is larger; neither is below
    zero (flat prior).
    """
    units = values.squares().mean_by(values.unit, 0.0)
    return math.sqrt(max(_of_one(units, confidence), _of_different(units, confidence)))


def _of_one(units: Squares, confidence: float) -> float:
    """Return the bound of a square that is the same for all units, from its likelihood."""
    from scipy.integrate import cumulative_simpson

    reach = float(units.sd.min())
    for _ in range(_DOUBLINGS):
        square = np.linspace(0.0, reach, _POINTS)
        height = _height(units, square)
        height -= height.max()
        if height[-1] < _NOTHING:
            break
        reach *= 2
    total = cumulative_simpson(np.exp(height), x=square, initial=0.0)
    return float(np.interp(confidence, total / total[-1], square))


def _of_different(units: Squares, confidence: float) -> float:
    """Return the bound of the mean of squares that scatter by more than their errors say, else zero."""
    from scipy.special import ndtr, ndtri

    weight = units.sd**-2.0
    error = units.deviation(max(float(np.average(units.estimate, weights=weight)), 0.0))
    between = variance_between(units.estimate, error)
    if not between:
        return 0.0
    weight = 1 / (error**2 + between)
    mean = float(np.average(units.estimate, weights=weight))
    error_of_mean = 1 / math.sqrt(float(np.sum(weight)))
    beyond = (1 - confidence) * float(ndtr(mean / error_of_mean))
    bound: float = mean - error_of_mean * float(ndtri(beyond))
    return bound


def _height(units: Squares, square: FloatArray) -> FloatArray:
    """Return the log-likelihood of squares, all units together."""
    height = np.zeros(square.size)
    for first in range(0, units.sd.size, _CHUNK):
        rows = np.arange(first, min(first + _CHUNK, units.sd.size))
        height += units.take(rows).log_likelihood(square).sum(axis=0)
    return height


def share_bound(values: LogValues, content: float, confidence: float) -> float:
    """Return the value that a share `content` of all units stays below with a probability `confidence`."""
    from scipy.special import ndtri

    return rms_bound(values, confidence) * math.exp(max(float(ndtri(content)), 0.0) ** 2 / 4)
