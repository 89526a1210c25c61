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
from imucal.fleet.squares import Squares

#: A mean square that is not so many deviations above zero, whichever unit is left out, is only bounded.
_SHOWN = 1.959963984540054
#: Points of the mean square's likelihood, up to where its logarithm is so far below the peak.
_POINTS, _NOTHING = 1001, -30.0
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

    The likelihood of one square for all units (flat prior), wider where they scatter by more than their
    errors say.
    """
    from scipy.integrate import cumulative_simpson

    units = values.squares().mean_by(values.unit, 0.0)
    weight = units.sd**-2.0
    error = 1 / math.sqrt(float(np.sum(weight)))
    mean = max(float(np.sum(weight * units.estimate)) * error**2, 0.0)
    apart = (units.estimate - mean) / units.deviation(mean)
    scatter = max(float(np.sum(apart**2)) / max(apart.size - 1, 1), 1.0)
    reach = mean + error
    while True:
        reach *= 2
        square = np.linspace(0.0, reach, _POINTS)
        height = _height(units, square) / scatter
        height -= height.max()
        if height[-1] < _NOTHING:
            break
    total = cumulative_simpson(np.exp(height), x=square, initial=0.0)
    return math.sqrt(float(np.interp(confidence, total / total[-1], square)))


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
