"""The result of each log for one coefficient: an estimate with limits, a bound, or the squared coefficient.

An estimate of a squared coefficient is nearly a scaled chi-square plus a known background: it is normal for a
weak term, and its standard deviation is proportional to a strong one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import Any

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.frozen import frozen

#: Growth below which a deviation is constant.
_NO_GROWTH = 1e-4
#: A small square, relative to its deviation.
_SMALL = 1e-3
#: Upper limit of logarithms, so that their exponentials are finite.
_LARGEST = 50.0
#: Largest standard errors of the logarithm, of an estimate and of a square, that are treated as normal.
_NARROW, _NARROW_SQUARE = 0.3, 0.1
#: Numbers of a `LogValue` in `LogValues`.
_NUMBERS = attrgetter("value", "low", "high", "level", "variance", "variance_sd", "variance_growth")


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
        return self.sd + self.growth * square

    def log_likelihood(self, square: FloatArray) -> FloatArray:
        """Return the log-likelihood of squared coefficients minus its maximum, shape (n, squares)."""
        own = self[:, None]

        def depth(square: FloatArray) -> FloatArray:
            apart = (own.estimate - square) / own.deviation(square)
            grows = np.maximum(own.growth, _NO_GROWTH)
            chi_square = (np.log1p(grows * square / own.sd) + grows * apart) / grows**2
            return np.where(own.growth < _NO_GROWTH, 0.5 * apart**2, chi_square)

        return depth(np.maximum(own.estimate, 0.0)) - depth(square)

    def below(self, square: FloatArray) -> FloatArray:
        """Return the probability of a smaller estimate for each true square, shape (n, squares).

        The cube root of a chi-square is nearly normal (Wilson & Hilferty 1931, Proc. National Academy of
        Sciences 17, p. 684). Far below zero the estimate is normal, because the background is estimated.
        """
        own = self[:, None]
        apart = (own.estimate - square) / own.deviation(square)
        grows = np.maximum(own.growth, _NO_GROWTH)
        root = (np.cbrt(1 + grows * apart) - 1) * 3 / grows + grows / 3
        root = np.where(apart < 0, np.maximum(root, apart), root)
        return scipy.special.ndtr(np.where(own.growth < _NO_GROWTH, apart, root))

    def mean_by(self, group: IntArray, at: float) -> "Squares":
        """Return the mean of each group, shape (groups,), with the optimal weights for the square `at`."""
        weight = self.deviation(at) ** -2.0
        share = weight / np.bincount(group, weight)[group]

        def error(square: float) -> FloatArray:
            return np.sqrt(np.bincount(group, (share * self.deviation(square)) ** 2))

        sd = error(0.0)
        # The deviation of a mean is nearly linear in the square, too.
        far = at or _SMALL * float(sd.min())
        mean: FloatArray = np.bincount(group, share * self.estimate).astype(np.float64)
        return Squares(mean, sd, (error(far) - sd) / far)


@frozen
class LogValue:
    """The result of one log of a `unit` (such as its serial number) for a coefficient.

    `value` is the coefficient, None if it is only bounded; `low` and `high` are its limits at the confidence
    `level`, 0 and the upper limit of a bound. Raises a ValueError if the limits are not positive or not in
    order, or if a variance has no deviation.

    `variance` is an estimate of the squared coefficient, which may be negative; value and limits are then
    only a first guess. Its standard deviation is ``variance_sd + variance_growth * v`` if the squared
    coefficient is v. Do not compute these two from the estimate: large estimates would then get less weight.

    `correlation_time`, in s, is the time of an estimated Gauss-Markov term.
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
        known = 1.0 if self.variance_sd is None else self.variance_sd
        if not (inside and 0 < self.high < math.inf and 0 < self.level < 1 and self.value != 0):
            wrong = f"limits must contain a positive value, got {self.low} ≤ {self.value} ≤ {self.high}"
        elif (self.variance is None) != (self.variance_sd is None) or not (known > 0 <= self.variance_growth):
            wrong = "a variance needs a positive standard deviation, and must not shrink"
        if wrong:
            raise ValueError(f"{self.unit}: {wrong}")


@frozen
class LogValues:
    """The logs of a fleet as columns, shape (logs,); logarithms are natural.

    `names` are the units in the order of their first log, `unit` the index of each log's unit. `middle` and
    `scale` are robust first guesses of the fleet's median and spread, in the logarithm. `centre` and
    `deviation` are the logarithm of the estimate and its standard error, infinite for a bound; `low_sd` and
    `high_sd` are those below and above it. `narrow` logs are normal in the logarithm, and `weighed` logs have
    an estimate of the squared coefficient in `squares`. Logs `by_limits` have only a value and its limits.
    """

    names: tuple[str, ...]
    middle: float
    scale: float
    unit: IntArray
    centre: FloatArray
    deviation: FloatArray
    low_sd: FloatArray
    high_sd: FloatArray
    narrow: BoolArray
    bounded: BoolArray
    weighed: BoolArray
    by_limits: BoolArray
    squares: Squares

    @classmethod
    def of(cls, logs: Sequence[LogValue]) -> "LogValues":
        numbers = np.array([*map(_NUMBERS, logs)], dtype=np.float64)
        value, low, high, level, variance, sd, growth = numbers.T
        z = scipy.special.ndtri((1 + level) / 2)
        bounded, weighed = np.isnan(value), ~np.isnan(variance)
        centre = np.log(np.where(bounded, high / 2, value))
        high_sd = np.maximum((np.log(high) - centre) / z, 1e-9)
        known = ~bounded & (low > 0)
        low_sd = np.where(known, np.maximum((centre - np.log(np.where(known, low, 1.0))) / z, 1e-9), high_sd)
        # The mean logarithm of a chi-square is below the logarithm of its mean.
        positive = weighed & (variance > 0)
        square = np.where(positive, variance, 1.0)
        error = np.where(positive, (sd + growth * variance) / (2 * square), np.inf)
        of_square = 0.5 * np.log(square) + np.minimum(error, _NARROW_SQUARE) ** 2
        centre = np.where(error <= _NARROW_SQUARE, of_square, centre)
        deviation = np.where(weighed, error, np.where(known, (high_sd + low_sd) / 2, np.inf))
        of_limits = np.where(bounded, 0.0, np.exp(2 * centre))
        middle = float(np.median(centre))
        mad = 1.4826 * float(np.median(np.abs(centre - middle)))
        place = {name: i for i, name in enumerate(dict.fromkeys(log.unit for log in logs))}
        return cls(
            names=tuple(place),
            middle=middle,
            scale=max(mad, float(np.std(centre)) / 2, 0.02),
            unit=np.array([place[log.unit] for log in logs], dtype=np.int64),
            centre=centre,
            deviation=deviation,
            low_sd=low_sd,
            high_sd=high_sd,
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

    def take(self, which: BoolArray | IntArray) -> "LogValues":
        """Return some of the logs and their units; `middle` and `scale` stay those of the whole fleet."""
        units, unit = np.unique(self.unit[which], return_inverse=True)
        columns = {f.name: getattr(self, f.name)[which] for f in fields(self)[4:]}
        return replace(self, names=tuple(self.names[i] for i in units.tolist()), unit=unit, **columns)

    def log_likelihood(self, theta: FloatArray) -> FloatArray:
        """Return the log-likelihood of each log at logarithms of the coefficient, shape (logs, theta)."""
        apart = theta - self.centre[:, None]
        score = apart / np.where(apart >= 0, self.high_sd[:, None], self.low_sd[:, None])
        of_square = self.squares.log_likelihood(np.exp(2 * np.minimum(theta, _LARGEST)))
        return np.where(self.by_limits[:, None], -0.5 * score**2, of_square)
