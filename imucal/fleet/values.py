"""What each log says of one coefficient: an estimate with limits, a bound, or the square of the coefficient.

The power of a few bins is a scaled chi-square on top of a known background, and so is, nearly, an estimate
of a squared coefficient: normal about a weak term, its deviation in proportion to a strong one.
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
#: Logarithms above this are as large as they need to be; keeps their exponentials finite.
_LARGEST = 50.0
#: An estimate is taken as normal in the logarithm up to this standard error; a square's, up to that.
_NARROW, _NARROW_SQUARE = 0.3, 0.1


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

    def __getitem__(self, which: BoolArray | list[int] | slice) -> "Squares":
        return Squares(self.estimate[which], self.sd[which], self.growth[which])

    def deviation(self, square: float) -> FloatArray:
        """Return the standard deviation of each, were its squared coefficient `square`."""
        result: FloatArray = self.sd + self.growth * square
        return result

    def log_likelihood(self, square: FloatArray) -> FloatArray:
        """Return the log-likelihood of squared coefficients, shape (n, squares), against the most likely."""
        estimate, sd, growth = self._columns()

        def depth(square: FloatArray) -> FloatArray:
            apart = (estimate - square) / (sd + growth * square)
            grows = np.maximum(growth, _NO_GROWTH)
            chi_square = (np.log1p(grows * square / sd) + grows * apart) / grows**2
            return np.where(growth < _NO_GROWTH, 0.5 * apart**2, chi_square)

        result: FloatArray = depth(np.maximum(estimate, 0.0)) - depth(square)
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

    def _columns(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.estimate[:, None], self.sd[:, None], self.growth[:, None]


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

    `names` are the units in the order of their first log, `unit` the index of each log's. `centre` and
    `deviation` are the logarithm of the estimate and its standard error, infinite where the log only bounds
    it; `low_sd` and `high_sd` the standard errors below and above it, from its limits. `bounded` logs have no
    value; `weighed` ones have an estimate of the squared coefficient, which is in `squares`: without one
    there is the square of the value, or zero for a bound.
    """

    names: tuple[str, ...]
    unit: IntArray
    centre: FloatArray
    deviation: FloatArray
    low_sd: FloatArray
    high_sd: FloatArray
    bounded: BoolArray
    weighed: BoolArray
    squares: Squares

    @classmethod
    def of(cls, logs: Sequence[LogValue]) -> "LogValues":
        """Return the columns of `logs`."""
        from scipy.special import ndtri

        z = ndtri((1 + _column(log.level for log in logs)) / 2)
        value, low, high = (_column(getattr(log, name) for log in logs) for name in ("value", "low", "high"))
        bounded = np.isnan(value)
        centre = np.log(np.where(bounded, high / 2, value))
        high_sd = np.maximum((np.log(high) - centre) / z, 1e-9)
        told = ~bounded & (low > 0)
        low_sd = np.where(told, np.maximum((centre - np.log(np.where(told, low, 1.0))) / z, 1e-9), high_sd)
        deviation = np.where(told, (high_sd + low_sd) / 2, np.inf)

        variance, sd = _column(log.variance for log in logs), _column(log.variance_sd for log in logs)
        growth = _column(log.variance_growth for log in logs)
        weighed = ~np.isnan(variance)
        # The logarithm of a chi-square has a mean below that of its mean: by half its relative variance.
        positive = weighed & (variance > 0)
        square = np.where(positive, variance, 1.0)
        error = np.where(positive, (sd + growth * variance) / (2 * square), np.inf)
        narrow = error <= _NARROW_SQUARE
        centre = np.where(
            narrow, 0.5 * np.log(square) + np.where(np.isfinite(error), error, 0.0) ** 2, centre
        )
        of_limits = np.where(bounded, 0.0, np.exp(2 * centre))
        names = tuple(dict.fromkeys(log.unit for log in logs))
        place = {name: i for i, name in enumerate(names)}
        return cls(
            names=names,
            unit=np.array([place[log.unit] for log in logs], dtype=np.int64),
            centre=centre,
            deviation=np.where(weighed, error, deviation),
            low_sd=low_sd,
            high_sd=high_sd,
            bounded=bounded,
            weighed=weighed,
            squares=Squares(
                np.where(weighed, variance, of_limits),
                np.where(weighed, sd, np.where(bounded, high**2 / z, of_limits * (low_sd + high_sd))),
                np.where(weighed, growth, 0.0),
            ),
        )

    @property
    def by_limits(self) -> BoolArray:
        """Which logs are known by their value and its limits alone."""
        result: BoolArray = ~(self.weighed | self.bounded)
        return result

    @property
    def narrow(self) -> BoolArray:
        """Which logs are normal in the logarithm."""
        result: BoolArray = self.deviation <= np.where(self.weighed, _NARROW_SQUARE, _NARROW)
        return result

    def log_likelihood(self, which: BoolArray, theta: FloatArray) -> FloatArray:
        """Return the log-likelihoods of logs at logarithms of the coefficient, shape (logs, theta)."""
        centre, low_sd, high_sd, by_limits = (
            column[which, None] for column in (self.centre, self.low_sd, self.high_sd, self.by_limits)
        )
        score = (theta - centre) / np.where(theta >= centre, high_sd, low_sd)
        square = np.exp(2 * np.minimum(theta, _LARGEST))
        result: FloatArray = np.where(by_limits, -0.5 * score**2, self.squares[which].log_likelihood(square))
        return result

    def log_deviation(self, theta: float) -> FloatArray:
        """Return the standard error of each log in the logarithm, were its coefficient exp(theta)."""
        square = math.exp(2 * theta)
        weak = self.squares.deviation(square) / (2 * square)
        result: FloatArray = np.where(self.narrow | self.by_limits, self.deviation, weak)
        return result

    def unit_squares(self, theta: float) -> Squares:
        """Return the squared coefficient of each unit from all of its logs, best for one of exp(theta)."""
        return self.squares.mean_by(self.unit, math.exp(2 * theta))

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


def _column(values: Iterable[float | None]) -> FloatArray:
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)
