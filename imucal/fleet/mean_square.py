"""The mean of the units' squared coefficients, for a term that no single log shows.

If the logs of a whole fleet only bound a coefficient, the mean of the units' squares is still an unbiased
estimate, for any spread between them. It bounds the square of the median unit, and thus any share of the
units: among all lognormal distributions with root mean square r, exp(m + t²) = r, a share p is below
exp(m + z t) = r exp(z t - t²) ≤ r exp(z² / 4), with the normal quantile z of p. So the bound does not need
the spread, which such logs do not determine.
"""

import math

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.fleet.values import TWO_SIDED, LogValues

#: Grid points of the likelihood of a mean square; the grid ends where the log-likelihood is this far below
#: its maximum.
_POINTS, _END = 1001, -30.0
#: Largest number of times the range of the grid is doubled, and number of units evaluated at a time.
_DOUBLINGS, _CHUNK = 200, 1024


def random_mean(values: FloatArray, errors: FloatArray) -> tuple[float, float, float]:
    """Return the mean of values, shape (n,), that differ; its standard error, and their spread.

    The spread beyond the standard errors is estimated by moments, at least 0; the weights include it.
    Source: DerSimonian & Laird (1986), Controlled Clinical Trials 7, p. 177.
    """
    weight = errors**-2.0
    total = float(weight.sum())
    statistic = float(np.sum(weight * (values - np.average(values, weights=weight)) ** 2))
    between = max(statistic - (values.size - 1), 0.0) / (total - float(np.square(weight).sum()) / total)
    weight = 1 / (errors**2 + between)
    mean = float(np.average(values, weights=weight))
    return mean, 1 / math.sqrt(float(weight.sum())), math.sqrt(between)


class MeanSquare:
    """The mean of the units' squared coefficients, at least zero, from all logs of a fleet."""

    def __init__(self, values: LogValues) -> None:
        self._units = values.squares.mean_by(values.unit, 0.0)
        self._known_by_limits = bool(values.by_limits.any())

    @property
    def shows(self) -> bool:
        """Whether all logs together show the coefficient, also without any one unit."""
        weight = self._units.sd**-2.0
        share = weight * self._units.estimate
        others = (np.sum(share) - share) / np.sqrt(np.sum(weight) - weight)
        return self._known_by_limits or bool(others.min() >= TWO_SIDED)

    def share_bound(self, content: float, confidence: float) -> float:
        """Return an upper bound of a share `content` of all units, with a probability `confidence`."""
        return self.bound(confidence) * math.exp(max(float(scipy.special.ndtri(content)), 0.0) ** 2 / 4)

    def bound(self, confidence: float) -> float:
        """Return an upper bound of the units' root mean square, with a probability `confidence`.

        It is the larger of two bounds: for one square of all units, and for the mean of squares that differ.
        The prior is flat from zero.
        """
        return math.sqrt(max(self._of_one(confidence), self._of_different(confidence)))

    def _of_one(self, confidence: float) -> float:
        """Return the bound of a square that is the same for all units, from its likelihood."""
        units, reach = self._units, float(self._units.sd.min())
        for _ in range(_DOUBLINGS):
            square = np.linspace(0.0, reach, _POINTS)
            height = np.zeros(square.size)
            for first in range(0, units.sd.size, _CHUNK):
                height += units[first : first + _CHUNK].log_likelihood(square).sum(axis=0)
            height -= height.max()
            if height[-1] < _END:
                break
            reach *= 2
        total = scipy.integrate.cumulative_simpson(np.exp(height), x=square, initial=0.0)
        return float(np.interp(confidence, total / total[-1], square))

    def _of_different(self, confidence: float) -> float:
        """Return the bound of the mean of squares that scatter beyond their errors; otherwise zero."""
        units = self._units
        at = max(float(np.average(units.estimate, weights=units.sd**-2.0)), 0.0)
        mean, error, spread = random_mean(units.estimate, units.deviation(at))
        beyond = (1 - confidence) * float(scipy.special.ndtr(mean / error))
        return mean - error * float(scipy.special.ndtri(beyond)) if spread else 0.0
