"""The result of a log for one coefficient: an estimate with limits, a bound, or the squared coefficient."""

import math
from dataclasses import dataclass
from typing import Any

from scipy.special import ndtri

from imucal.errors import ArgumentError, DataError, Fix
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.settings import FitSettings
from imucal.fitting.spectral.given_model import fit_bins, squared_coefficients
from imucal.noise.terms import ALWAYS

#: Smallest relative width of a square's limits: they may be rounded to the estimate.
_LEAST = 1e-9


@dataclass(frozen=True, kw_only=True)
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
        if self.low > 0 < square:
            # The estimate is normal in the logarithm: its relative error does not depend on its value.
            return square * max(math.log(self.high / self.low), _LEAST) / z
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


def log_values(
    unit: str,
    fit: NoiseFit,
    *,
    model: str = "N + B + K",
    level: float = 0.95,
) -> dict[str, LogValue]:
    """Return the value of each term in one log, for `population`, from the bins of its fit.

    `model` must be the same for all logs. Each term except the ramp also has an unbiased estimate of its
    squared coefficient, which may be negative. The fit needs bins (`NoiseFit.bins`): from `imucal.fit` or
    `imucal.fit`; a report.json does not contain them.

    Raises a DataError if the fit has no bins, and a ValueError if `model` is not a sum of terms, or if
    `level` is not between 0 and 1.
    """
    structure = FitSettings(model=model, level=level).structure
    if structure is None:
        raise ArgumentError("model 'auto' depends on the record; give the terms, such as 'N + B + K'")
    if fit.bins is None:
        advice = "fit the samples with imucal.fit; a report.json contains no bins"
        problem = f"found no bins in a fit of method {fit.method!r}, expected those of method 'mle'"
        raise DataError(problem, fix=Fix(advice))
    # A fit of the same given terms has already found the band, unless it is flat.
    fraction, poles = (fit.settings.get(name) for name in ("band_fraction", "response_coefficients"))
    same = fit.criterion == "given" and {e.symbol for e in fit.estimates} == {*structure, *ALWAYS}
    near = fraction if isinstance(fraction, float) and same and (poles or fraction < 1) else None
    found = fit_bins(fit.bins, structure, level=level, near=near)
    laws: dict[str, dict[str, Any]] = {
        key: {"variance": law.value, "variance_sd": law.deviation, "variance_growth": law.growth}
        for key, law in squared_coefficients(found).items()
    }
    return {
        e.key: LogValue(
            unit=unit,
            value=e.value,
            low=e.low,
            high=e.high,
            level=level,
            correlation_time=e.correlation_time.value if e.correlation_time else None,
            **laws.get(e.key, {}),
        )
        for e in found.estimates
    }
