"""What each log says of one coefficient: an estimate with limits, a bound, or a variance with its law.

The estimate of a variance is nearly a scaled chi-square on top of a known background, as the power of a few
bins is: normal about a weak term, its deviation in proportion to a strong one.

Estimates of squared coefficients whose deviation grows with the square.

The power of a few bins is a chi-square of it on top of a background, scaled; an estimate of a squared
coefficient, from weights that do not follow it, is nearly so. It is normal about a weak coefficient, and its
deviation in proportion to a strong one.

Mixtures of normal laws: numbers that are normal at each point of a posterior's grid.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray

#: A deviation that grows by less is constant.
_NO_GROWTH = 1e-4
#: A square that is small beside a deviation, relative to it.
_SMALL = 1e-3


@dataclass(frozen=True, slots=True)
class Squares:
    """Estimates, which may be negative, of squared coefficients; shape (n,) each.

    Attributes
    ----------
    estimate
        Of the square.
    sd, growth
        The standard deviation of an estimate is ``sd + growth * square``.
    """

    estimate: FloatArray
    sd: FloatArray
    growth: FloatArray

    def deviation(self, square: float) -> FloatArray:
        """Return the standard deviation of each, were its squared coefficient `square`."""
        result: FloatArray = self.sd + self.growth * square
        return result

    def log_likelihood(self, square: FloatArray) -> FloatArray:
        """Return the log-likelihood of squared coefficients, shape (n, squares), against the most likely."""
        estimate, sd, growth = self._columns()
        likely = np.maximum(estimate, 0.0)

        def height(square: FloatArray) -> FloatArray:
            apart = (estimate - square) / (sd + growth * square)
            grows = np.maximum(growth, _NO_GROWTH)
            chi_square = (np.log1p(grows * square / sd) + grows * apart) / grows**2
            return np.where(growth < _NO_GROWTH, 0.5 * apart**2, chi_square)

        result: FloatArray = height(likely) - height(square)
        return result

    def below(self, square: FloatArray) -> FloatArray:
        """Return the chance of an estimate below each, were the squares those, shape (n, squares).

        Wilson & Hilferty (1931), Proc. National Academy of Sciences 17, p. 684: the cube root of a
        chi-square is nearly normal. An estimate may lie below what its background alone would be, since
        the other terms are not known: far down it is normal.
        """
        from scipy.special import ndtr

        estimate, sd, growth = self._columns()
        apart = (estimate - square) / (sd + growth * square)
        grows = np.maximum(growth, _NO_GROWTH)
        root = (np.cbrt(1 + grows * apart) - 1) * 3 / grows + grows / 3
        root = np.where(apart < 0, np.maximum(root, apart), root)
        result: FloatArray = ndtr(np.where(growth < _NO_GROWTH, apart, root))
        return result

    def mean_by(self, group: IntArray, at: float) -> "Squares":
        """Return the mean of each group, shape (groups,), with weights that are best at a square `at`."""
        weight = self.deviation(at) ** -2.0
        share = weight / np.bincount(group, weight)[group]

        def error(square: float) -> FloatArray:
            own: FloatArray = (share * self.deviation(square)) ** 2
            return np.sqrt(np.bincount(group, own))

        mean: FloatArray = np.bincount(group, share * self.estimate).astype(np.float64)
        sd = error(0.0)
        # The deviation of a mean is nearly linear too; any small square tells how it begins.
        far = at or _SMALL * float(sd.min())
        return Squares(mean, sd, (error(far) - sd) / far)

    def take(self, which: Sequence[int] | IntArray) -> "Squares":
        """Return some of them."""
        rows = np.asarray(which)
        return Squares(self.estimate[rows], self.sd[rows], self.growth[rows])

    def _columns(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.estimate[:, None], self.sd[:, None], self.growth[:, None]


#: Logarithms above this are as large as they need to be; keeps their exponentials finite.
_LARGEST = 50.0
#: An estimate is taken as normal in the logarithm up to this standard error; a variance's, up to that.
_NARROW, _NARROW_VARIANCE = 0.3, 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class LogValue:
    """What one log of one unit says of a coefficient.

    Attributes
    ----------
    unit
        Which unit was recorded, such as its serial number.
    value
        The coefficient; None where the log only bounds it.
    low, high
        Its limits at `level`; `low` is 0 and `high` the upper limit where it is bounded.
    variance
        The estimate of the squared coefficient, which may be negative. It says more than value and limits,
        which are no more than a first guess where there is one.
    variance_sd, variance_growth
        Its standard deviation is ``variance_sd + variance_growth * v`` where the squared coefficient is v.
        They must not follow the estimate, or weights would: high ones would count for less.
    temperature_c, days
        Temperature in °C, and age in days since any epoch, for `imucal.fleet.trend`; nan where unknown.
    level
        Confidence level of the limits.
    correlation_time
        In s, of a Gauss-Markov term that the log estimates; None otherwise.

    Raises
    ------
    ValueError
        If the limits are out of order, not positive, or a variance comes without its deviation.
    """

    unit: str
    value: float | None
    low: float
    high: float
    variance: float | None = None
    variance_sd: float | None = None
    variance_growth: float = 0.0
    temperature_c: float = math.nan
    days: float = math.nan
    level: float = 0.95
    correlation_time: float | None = None

    def __post_init__(self) -> None:
        inside = self.value is None or 0 <= self.low <= self.value <= self.high
        if not (inside and 0 < self.high < math.inf and 0 < self.level < 1 and self.value != 0):
            msg = (
                f"{self.unit}: limits must hold a positive value, got {self.low} ≤ {self.value} ≤ {self.high}"
            )
            raise ValueError(msg)
        told = 1.0 if self.variance_sd is None else self.variance_sd
        if (self.variance is None) != (self.variance_sd is None) or not (told > 0 <= self.variance_growth):
            msg = f"{self.unit}: a variance needs a positive standard deviation, which does not fall"
            raise ValueError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogValues:
    """The logs of a fleet as columns; logarithms are natural.

    Attributes
    ----------
    names
        The units, in the order of their first log.
    unit
        Index of each log's unit.
    centre, deviation
        Logarithm of the estimate and its standard error; infinite where the log only bounds it.
    variance, variance_sd, growth
        As in `LogValue`; nan where the log has none and its limits speak.
    bound
        Upper limit over its normal quantile, both squared: the deviation of a bounded variance.
    low_sd, high_sd
        Standard errors below and above the estimate.
    """

    names: tuple[str, ...]
    unit: IntArray
    centre: FloatArray
    deviation: FloatArray
    variance: FloatArray
    variance_sd: FloatArray
    growth: FloatArray
    bound: FloatArray
    low_sd: FloatArray
    high_sd: FloatArray

    @classmethod
    def of(cls, logs: Sequence[LogValue]) -> "LogValues":
        """Return the columns of `logs`."""
        from scipy.special import ndtri

        z = ndtri((1 + _column(log.level for log in logs)) / 2)
        value, low, high = (
            _column(log.value for log in logs),
            _column(log.low for log in logs),
            _column(log.high for log in logs),
        )
        centre = np.log(np.where(np.isnan(value), high / 2, value))
        high_sd = np.maximum((np.log(high) - centre) / z, 1e-9)
        told = ~np.isnan(value) & (low > 0)
        low_sd = np.where(told, np.maximum((centre - np.log(np.where(told, low, 1.0))) / z, 1e-9), high_sd)
        deviation = np.where(told, (high_sd + low_sd) / 2, np.inf)
        variance, variance_sd, growth = (
            _column(log.variance for log in logs),
            _column(log.variance_sd for log in logs),
            _column(None if log.variance is None else log.variance_growth for log in logs),
        )
        logarithm, error = _logarithms(variance, variance_sd + growth * variance)
        centre = np.where(error <= _NARROW_VARIANCE, logarithm, centre)
        names = tuple(dict.fromkeys(log.unit for log in logs))
        place = {name: i for i, name in enumerate(names)}
        return cls(
            names=names,
            unit=np.array([place[log.unit] for log in logs], dtype=np.int64),
            centre=centre,
            deviation=np.where(np.isnan(variance), deviation, error),
            variance=variance,
            variance_sd=variance_sd,
            growth=growth,
            bound=np.where(np.isnan(value), high**2 / z, np.nan),
            low_sd=low_sd,
            high_sd=high_sd,
        )

    def log_likelihood(self, which: BoolArray, theta: FloatArray) -> FloatArray:
        """Return the log-likelihoods of logs at logarithms of the coefficient, shape (logs, theta)."""
        rows = np.flatnonzero(which)
        centre, bound, limits = (
            column[rows, None] for column in (self.centre, self.bound, np.isnan(self.variance))
        )
        square = np.exp(2 * np.minimum(theta, _LARGEST))
        side = np.where(theta >= centre, self.high_sd[rows, None], self.low_sd[rows, None])
        score = np.where(np.isnan(bound), (theta - centre) / side, square / np.where(bound > 0, bound, 1.0))
        squares = Squares(self.variance[rows], self.variance_sd[rows], self.growth[rows])
        result: FloatArray = np.where(limits, -0.5 * score**2, squares.log_likelihood(square))
        return result

    def log_deviation(self, theta: float) -> FloatArray:
        """Return the standard error of each log in the logarithm, were its coefficient exp(theta)."""
        square = math.exp(2 * theta)
        limits = np.isnan(self.variance) & np.isnan(self.bound)
        weak = self.squares().deviation(square) / (2 * square)
        result: FloatArray = np.where(self.narrow | limits, self.deviation, weak)
        return result

    def squares(self) -> Squares:
        """Return the squared coefficient of each log; one that it only bounds is zero."""
        square = np.exp(2 * self.centre)
        told, limits = np.isnan(self.bound), np.isnan(self.variance)
        error = np.where(told, square * (self.low_sd + self.high_sd), self.bound)
        return Squares(
            np.where(limits, np.where(told, square, 0.0), self.variance),
            np.where(limits, error, self.variance_sd),
            np.where(limits, 0.0, self.growth),
        )

    def unit_squares(self, theta: float) -> Squares:
        """Return the squared coefficient of each unit from all of its logs, best for one of exp(theta)."""
        return self.squares().mean_by(self.unit, math.exp(2 * theta))

    def unit_centre(self, unit: int, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a unit's logarithm and its variance, for each scatter between its logs, shape (omega,)."""
        own = self.unit == unit
        weight = 1 / (self.deviation[own] ** 2 + omega[:, None] ** 2)
        total = weight.sum(axis=1)
        return weight @ self.centre[own] / total, 1 / total

    def without(self, unit: int) -> "LogValues":
        """Return the logs of the other units."""
        keep = self.unit != unit
        columns = {f.name: getattr(self, f.name)[keep] for f in fields(self) if f.name != "names"}
        columns["unit"] = columns["unit"] - (columns["unit"] > unit)
        return LogValues(names=self.names[:unit] + self.names[unit + 1 :], **columns)

    @property
    def narrow(self) -> BoolArray:
        """Return which logs are normal in the logarithm."""
        result: BoolArray = self.deviation <= np.where(np.isnan(self.variance), _NARROW, _NARROW_VARIANCE)
        return result


def _logarithms(variance: FloatArray, deviation: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return logarithms of coefficients and their errors, from their squares; infinite where that is none.

    The logarithm of a chi-square has a mean below that of its mean: by half its relative variance.
    """
    positive = np.where(variance > 0, variance, 1.0)
    error = np.where(variance > 0, deviation / (2 * positive), np.inf)
    return 0.5 * np.log(positive) + np.where(np.isfinite(error), error, 0.0) ** 2, error


def _column(values: Iterable[float | None]) -> FloatArray:
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


#: Halvings that find a quantile.
_HALVINGS = 40
#: Points of less weight than this, of the greatest, say nothing of a quantile.
_LITTLE = 1e-3


@dataclass(frozen=True, slots=True)
class Mixtures:
    """Several numbers, each normal at each point of a grid.

    Attributes
    ----------
    mean, sd
        Shape (numbers, points).
    weight
        Shape (points,); adds up to one.
    """

    mean: FloatArray
    sd: FloatArray
    weight: FloatArray

    def take(self, which: Sequence[int]) -> "Mixtures":
        """Return some of the numbers."""
        return Mixtures(self.mean[list(which)], self.sd[list(which)], self.weight)

    def followed_by(self, other: "Mixtures") -> "Mixtures":
        """Return these numbers and others of the same grid."""
        return Mixtures(np.vstack([self.mean, other.mean]), np.vstack([self.sd, other.sd]), self.weight)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return means and the roots of the mean variances at a point, shape (numbers,)."""
        return self.mean @ self.weight, np.sqrt(self.sd**2 @ self.weight)

    def two_sided(self) -> FloatArray:
        """Return the chance that each lies beyond zero, from where most of it is, on either side."""
        from scipy.special import ndtr

        above = ndtr(self.mean / self.sd) @ self.weight
        result: FloatArray = 2 * np.minimum(above, 1 - above)
        return result

    def quantiles(self, at: Sequence[float]) -> FloatArray:
        """Return quantiles, shape (numbers, quantiles), by bisection."""
        from scipy.special import ndtr

        keep = self.weight > _LITTLE * self.weight.max()
        mean, sd, weight = self.mean[:, keep], self.sd[:, keep], self.weight[keep] / self.weight[keep].sum()
        found = []
        for level in at:
            low, high = np.min(mean - 9 * sd, axis=1), np.max(mean + 9 * sd, axis=1)
            for _ in range(_HALVINGS):
                middle = (low + high) / 2
                below = ndtr((middle[:, None] - mean) / sd) @ weight < level
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            found.append((low + high) / 2)
        return np.column_stack(found)
