"""The value of a coefficient in each log: an estimate with limits, a bound, or an estimate of its square.

The estimate of a squared coefficient is nearly a scaled chi-square on a known background: normal for a weak
term, with a deviation in proportion to a strong one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.frozen import frozen

#: A deviation that grows by less is constant.
_NO_GROWTH = 1e-4
#: A small square, relative to a deviation.
_SMALL = 1e-3
#: Largest standard error of a logarithm that is treated as normal: of an estimate, and of a square.
_NARROW, _NARROW_SQUARE = 0.3, 0.1
#: Numbers of a `LogValue` in `LogValues`.
_NUMBERS = attrgetter("value", "low", "high", "level", "variance", "variance_sd", "variance_growth")
#: Quantile of the normal distribution for a two-sided interval of 95 %.
TWO_SIDED = 1.959963984540054


@dataclass(frozen=True, slots=True)
class Squares:
    """Estimates, which may be negative, of squared coefficients; shape (n,) each.

    The standard deviation of an estimate is ``sd + growth * square``.
    """

    estimate: FloatArray
    sd: FloatArray
    growth: FloatArray

    def __getitem__(self, which: Any) -> "Squares":  # noqa: ANN401 - whatever indexes an array
        return Squares(*(part[which] for part in (self.estimate, self.sd, self.growth)))

    def deviation(self, square: float | FloatArray) -> FloatArray:
        """Return the standard deviation of each, were its squared coefficient `square`."""
        return self.sd + self.growth * square

    def log_likelihood(self, square: FloatArray) -> FloatArray:
        """Return the log-likelihood of squared coefficients, shape (n, squares), against the most likely."""
        own = self[:, None]

        def depth(square: FloatArray) -> FloatArray:
            apart = (own.estimate - square) / own.deviation(square)
            grows = np.maximum(own.growth, _NO_GROWTH)
            chi_square = (np.log1p(grows * square / own.sd) + grows * apart) / grows**2
            return np.where(own.growth < _NO_GROWTH, 0.5 * apart**2, chi_square)

        return depth(np.maximum(own.estimate, 0.0)) - depth(square)

    def below(self, square: FloatArray) -> FloatArray:
        """Return the probability of an estimate below each, for given squares, shape (n, squares).

        Wilson & Hilferty (1931), Proc. National Academy of Sciences 17, p. 684: the cube root of a
        chi-square is nearly normal. Far below the mean the estimate itself is normal, because the other
        terms are not known.
        """
        own = self[:, None]
        apart = (own.estimate - square) / own.deviation(square)
        grows = np.maximum(own.growth, _NO_GROWTH)
        root = (np.cbrt(1 + grows * apart) - 1) * 3 / grows + grows / 3
        root = np.where(apart < 0, np.maximum(root, apart), root)
        return scipy.special.ndtr(np.where(own.growth < _NO_GROWTH, apart, root))

    def mean_by(self, group: IntArray, at: float) -> "Squares":
        """Return the mean of each group, shape (groups,), with the best weights for a square `at`."""
        weight = self.deviation(at) ** -2.0
        share = weight / np.bincount(group, weight)[group]

        def error(square: float) -> FloatArray:
            return np.sqrt(np.bincount(group, (share * self.deviation(square)) ** 2))

        sd = error(0.0)
        # The deviation of a mean is nearly linear, too: use its slope at a small square.
        far = at or _SMALL * float(sd.min())
        mean: FloatArray = np.bincount(group, share * self.estimate).astype(np.float64)
        return Squares(mean, sd, (error(far) - sd) / far)


@frozen
class LogValue:
    """The value of a coefficient in one log of the `unit`, such as a serial number.

    `value` is the coefficient, None if the log only bounds it; `low` and `high` are its limits at the
    confidence `level`, 0 and the upper limit if it is bounded. Raises ValueError if the limits are out of
    order or not positive, or a variance has no deviation.

    `variance` is the estimate of the squared coefficient, which may be negative. If it is given, value and
    limits are only a first guess. Its standard deviation is ``variance_sd + variance_growth * v`` for the
    squared coefficient v. Do not compute these two from the estimate: large estimates would get less weight.

    `correlation_time`, in s, belongs to a Gauss-Markov term that the log estimates; None otherwise.
    """

    unit: str
    value: float | None
    low: float
    high: float
    variance: float | None = None
    variance_sd: float | None = None
    variance_growth: float = 0.0
    level: float = 0.95
    correlation_time: float | None = None

    def __post_init__(self) -> None:
        inside, wrong = self.value is None or 0 <= self.low <= self.value <= self.high, ""
        deviation = 1.0 if self.variance_sd is None else self.variance_sd
        if not (inside and 0 < self.high < math.inf and 0 < self.level < 1 and self.value != 0):
            wrong = f"limits must contain a positive value, got {self.low} ≤ {self.value} ≤ {self.high}"
        elif (self.variance is None) != (self.variance_sd is None) or not (
            deviation > 0 <= self.variance_growth
        ):
            wrong = "a variance needs a positive standard deviation, and must not shrink"
        if wrong:
            raise ValueError(f"{self.unit}: {wrong}")


@frozen
class LogValues:
    """The logs of a fleet as columns, shape (logs,); logarithms are natural.

    `names` are the units in the order of their first log, `unit` the index of each log's unit. `middle` is
    the median logarithm. `centre` and `deviation` are the logarithm of the estimate and its standard error,
    infinite if the log only bounds it. `narrow` logs are normal in the logarithm; `bounded` ones have no
    value; `weighed` ones have an estimate of the squared coefficient. `squares` contains it; otherwise the
    square of the value, or zero for a bound. Logs `by_limits` have only a value and its limits.
    """

    names: tuple[str, ...]
    middle: float
    unit: IntArray
    centre: FloatArray
    deviation: FloatArray
    narrow: BoolArray
    bounded: BoolArray
    weighed: BoolArray
    by_limits: BoolArray
    squares: Squares

    @classmethod
    def of(cls, logs: Sequence[LogValue]) -> "LogValues":
        """Return the columns of `logs`."""
        numbers = np.array([*map(_NUMBERS, logs)], dtype=np.float64)
        value, low, high, level, variance, sd, growth = numbers.T
        z = scipy.special.ndtri((1 + level) / 2)
        bounded, weighed = np.isnan(value), ~np.isnan(variance)
        centre = np.log(np.where(bounded, high / 2, value))
        high_sd = np.maximum((np.log(high) - centre) / z, 1e-9)
        two_sided = ~bounded & (low > 0)
        low_sd = np.where(
            two_sided, np.maximum((centre - np.log(np.where(two_sided, low, 1.0))) / z, 1e-9), high_sd
        )
        # The mean logarithm of a chi-square is lower by half its relative variance.
        positive = weighed & (variance > 0)
        square = np.where(positive, variance, 1.0)
        error = np.where(positive, (sd + growth * variance) / (2 * square), np.inf)
        of_square = 0.5 * np.log(square) + np.minimum(error, _NARROW_SQUARE) ** 2
        centre = np.where(error <= _NARROW_SQUARE, of_square, centre)
        deviation = np.where(weighed, error, np.where(two_sided, (high_sd + low_sd) / 2, np.inf))
        of_limits = np.where(bounded, 0.0, np.exp(2 * centre))
        middle = float(np.median(centre))
        place = {name: i for i, name in enumerate(dict.fromkeys(log.unit for log in logs))}
        return cls(
            names=tuple(place),
            middle=middle,
            unit=np.array([place[log.unit] for log in logs], dtype=np.int64),
            centre=centre,
            deviation=deviation,
            narrow=deviation <= np.where(weighed, _NARROW_SQUARE, _NARROW),
            bounded=bounded,
            weighed=weighed,
            by_limits=~(weighed | bounded),
            squares=Squares(
                np.where(weighed, variance, of_limits),
                np.where(weighed, sd, np.where(bounded, high**2 / z, of_limits * (low_sd + high_sd))),
                np.where(weighed, growth, 0.0),
            ),
        )
