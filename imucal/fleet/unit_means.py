"""The means of the units' logs, which are the data of a fleet.

In the logarithm of a coefficient, a log is the sum of the fleet's mean, the deviation of its unit (standard
deviation `spread`), the deviation of the log from its unit (`within`) and its error. All are normal. The unit
means scatter with the sum of these variances. So Student's t gives the interval of the mean and of the next
unit, and the noncentral t the tolerance bound of ISO 16269-6 (2014), section 6. The error of the logs makes
the bound larger than necessary, never too small. For weak logs the logarithm is replaced by a `Scale`.
"""

import math

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray
from imucal.fitting.noise_fit import Interval
from imucal.fleet.unit_squares import UnitSquares, typical_square, weak_logs, with_squares
from imucal.fleet.values import LogValues

#: Smallest standard deviation of unit means: equal units differ by rounding.
_LEAST = 1e-9
#: Smallest number of units in a test of one against the others.
_FEWEST_TESTED = 4


class UnitMeans:
    """Means of the units' logs on a `scale`, shape (units,), and their statistics.

    `centre` are the means, and `error` their standard errors with the scatter between logs of a unit. `mean`
    and `sd` describe the means, and `known` is the mean square of the errors. `spread` is the standard
    deviation between units, and `within` between logs of one unit, None if no unit has two; both are in the
    logarithm of the coefficient.
    """

    def __init__(self, logs: LogValues) -> None:
        logs = with_squares(logs)
        mean_square = typical_square(logs)
        self.within = _within(logs, mean_square)
        scatter = self.within.value if self.within else 0.0
        units = UnitSquares(logs, mean_square, scatter)
        self.scale = units.scale
        middle = self.scale.square(float(self.scale.place(units.square).mean()))
        # The errors at the median unit, not at the mean square, which a few large units raise.
        typical = middle if middle > 0 else mean_square
        units = UnitSquares(logs, typical, scatter)
        self.centre, self.error = units.on(self.scale)
        self.dof = self.centre.size - 1
        self.mean = float(self.centre.mean())
        self.sd = max(float(self.centre.std(ddof=1)), _LEAST)
        self.known = float(np.mean(self.error**2))
        slope = float(self.scale.slope(np.array(typical)))
        self.spread = _beyond(self.sd**2 * self.dof, self.dof, self.known, slope)
        # The scale is convex in the logarithm, so the mean place is above the place of the median unit.
        self._middle = self.mean - self.spread.value**2 * slope * (1 - slope**2)
        self._units, self._slope = units, slope
        only_limits = ~logs.weighed & ~logs.narrow
        self._testable = not only_limits.any() and self.centre.size >= _FEWEST_TESTED

    def interval(self, level: float, *, ahead: bool = False) -> Interval:
        """Return the median unit with its interval; with `ahead`, the interval of the next unit."""
        quantile = float(scipy.special.stdtrit(self.dof, (1 + level) / 2))
        reach = quantile * self.sd * math.sqrt(ahead + 1 / (self.dof + 1))
        low, value, high = (self.scale.coefficient(self._middle + sign * reach) for sign in (-1, 0, 1))
        return Interval(value=value, low=low, high=high)

    def quantile(self, content: float) -> float:
        """Return the estimate of the value that a share `content` of all units does not exceed."""
        reach = float(scipy.special.ndtri(content)) * self.spread.value * self._slope
        return self.scale.coefficient(self._middle + reach)

    def tolerance(self, content: float, confidence: float) -> float:
        """Return the upper bound of a share `content` of all units, with a probability `confidence`."""
        factor = tolerance_factor(self.dof + 1, content, confidence)
        return self.scale.coefficient(self.mean + factor * self.sd)

    def p_values(self) -> FloatArray:
        """Return two-sided p-values of the units, each compared with the others by Student's t.

        They are 1 if the test is not valid: for three units, or if a log has nothing but limits.
        """
        if not self._testable:
            return np.ones(self.centre.size)
        found = leave_one_out(self.centre, self.error, self.spread.value * self._slope)
        weak = self._units.weak
        if weak.any():
            # The scale has a long lower tail for weak units, and their squares have a long upper one.
            squares = self._units.square / self._units.square.mean() / 2
            by_square = leave_one_out(squares, self._units.error, self.spread.value)
            found = np.where(weak, np.maximum(found, by_square), found)
        return found


def tolerance_factor(units: int, content: float, confidence: float) -> float:
    """Return the factor k of the one-sided tolerance bound, mean + k standard deviations.

    It is a quantile of the noncentral t distribution. Source: ISO 16269-6 (2014), section 6.
    """
    root = math.sqrt(units)
    shift = float(scipy.special.ndtri(content)) * root
    return float(scipy.special.nctdtrit(units - 1, shift, confidence)) / root


def leave_one_out(centre: FloatArray, deviation: FloatArray, spread: float) -> FloatArray:
    """Return two-sided p-values of four or more units, each against the mean and the spread of the others.

    `centre` and `deviation`, shape (units,), are the value of each unit and its standard error. The standard
    deviation `spread` between units affects only the weights, not the scale of the test.
    """
    w = 1 / (deviation**2 + max(spread, 1e-12) ** 2)
    total = w.sum()
    rest = total - w
    off = centre - np.sum(w * centre) / total
    apart = off * total / rest
    # Squares about the mean of the others: those about the mean of all, less the unit's own share.
    squares = np.sum(w * off**2) - w * off * apart
    dof = centre.size - 2
    scale = np.sqrt(np.maximum(squares, 1e-300) / dof * (1 / w + 1 / rest))
    result: FloatArray = 2 * scipy.special.stdtr(dof, -np.abs(apart) / scale)
    return result


def _within(logs: LogValues, typical: float) -> Interval | None:
    """Return the standard deviation between logs of one unit in the logarithm; None if no unit has two."""
    unit, counts = logs.unit, np.bincount(logs.unit)
    degrees = unit.size - counts.size
    if not degrees:
        return None
    weak: BoolArray = weak_logs(logs, typical)
    # Linear in the squares of weak logs.
    y = np.where(weak, logs.squares.estimate / (2 * typical), logs.centre)
    deviation = np.where(weak, logs.squares.deviation(typical) / (2 * typical), logs.deviation)
    apart = y - (np.bincount(unit, y) / counts)[unit]
    return _beyond(float(apart @ apart), degrees, float(np.mean(deviation**2)))


def _beyond(squares: float, dof: int, known: float, slope: float = 1.0) -> Interval:
    """Return the standard deviation beyond a known variance, with its 95 % interval, divided by a slope.

    `squares` is a sum of squares with `dof` degrees of freedom.
    """
    limits = (float(scipy.special.chdtri(dof, tail)) for tail in (0.025, 0.975))
    low, high = (math.sqrt(max(squares / limit - known, 0.0)) / slope for limit in limits)
    value = math.sqrt(max(squares / dof - known, 0.0)) / slope
    return Interval(value=value, low=low, high=high)
