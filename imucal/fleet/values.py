"""The result of a log for one coefficient: an estimate with limits, a bound, or the squared coefficient."""

import math

from scipy.special import ndtri

from imucal.frozen import frozen

#: Smallest relative width of a square's limits: they may be rounded to the estimate.
_LEAST = 1e-9


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

    @property
    def square(self) -> float:
        """The estimate of the squared coefficient; the middle of its limits for a bound without one."""
        if self.variance is not None:
            return self.variance
        return self.high**2 / 2 if self.value is None else self.value**2

    def square_deviation(self, square: float) -> float:
        """Return the standard deviation of `square`'s estimate if the squared coefficient is `square`."""
        if self.variance_sd is not None:
            return self.variance_sd + self.variance_growth * square
        z = float(ndtri((1 + self.level) / 2))
        if self.value is None:
            return self.high**2 / (2 * z)
        return max(self.high**2 - self.low**2, _LEAST * self.high**2) / (2 * z)

    def limits(self, level: float) -> tuple[float, float]:
        """Return the limits at another confidence level; the estimate is normal in the logarithm."""
        if level == self.level:
            return self.low, self.high
        ratio = float(ndtri((1 + level) / 2) / ndtri((1 + self.level) / 2))
        if self.value is None:
            # The square of a bounded coefficient is normal about zero.
            return 0.0, self.high * math.sqrt(ratio)
        low = self.value * (self.low / self.value) ** ratio
        return low, self.value * (self.high / self.value) ** ratio
