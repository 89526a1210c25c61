"""The distribution of a coefficient over the units of a sensor model.

Each unit is compared with the other units, because an outlier would widen a spread that includes it.

If all logs only bound a coefficient, the mean of the units' squares bounds a share p of the units for any
spread t: for a lognormal distribution with root mean square r, the share is below r exp(z t - t²) ≤
r exp(z² / 4), with the normal quantile z of p.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy

from imucal.arguments import takes
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Interval
from imucal.fleet.posterior import TAILS, TWO_SIDED, NextLog, Posterior, UnitLikelihoods, interval_of
from imucal.fleet.values import LogValue, LogValues
from imucal.frozen import frozen
from imucal.multiple_tests import SIGNIFICANCE, holm

#: Minimum number of units for a spread.
MIN_UNITS = 3
#: Percentage of bounded logs above which a finding is reported.
_MANY_BOUNDS = 50.0
#: Most units that are tested exactly: an exact test takes seconds.
_SUSPECTS = 5
#: Largest quick p-value that leads to an exact test.
_SUSPECT = 0.2
#: Probability that the next unit is within its limits.
_CONTENT = 0.95
_MOSTLY_BOUNDED = "{:.0f} % of the logs only bound this term: longer logs would help more than more units."
_ALL_BOUNDED = (
    "This term was not detected in all logs together: every number is an upper bound, and the spread between "
    "units is unknown. Longer logs would help more than more units."
)
_TOO_FEW = (
    "{}: the spread between units, the next unit and a tolerance bound need at least "
    f"{MIN_UNITS}; test about 10."
)
#: Points of the grid of the log-likelihood of a mean square.
_POINTS = 1001
#: Log-likelihood at the end of the grid, relative to the peak.
_NOTHING = -30.0
#: Most doublings of the end of the grid.
_DOUBLINGS = 200
#: Units that are added at a time, which limits the memory.
_CHUNK = 1024


@frozen
class UnitValue:
    """The coefficient of one unit of a fleet, from all of its logs; the value is None if it is only bounded.

    `p_value` is from the comparison with the other units; `p_odd` is adjusted for the number of units.
    """

    unit: str
    logs: int
    value: float | None
    low: float
    high: float
    p_value: float | None = None
    p_odd: float | None = None
    odd: bool = False


@frozen
class Population:
    """The distribution of a coefficient over the units of one sensor model.

    `median` is the coefficient of the median unit with its 95 % interval. It is `bounded` if all logs
    together do not show the term: the interval then begins at 0, value and high are the upper limit, and the
    spreads are None.

    `spread` is the standard deviation between units, in the logarithm (0.1 is 10 %), and `within` the one
    between logs of a unit, None if no unit has two logs. `prediction` are limits that contain the next unit
    with probability 0.95.

    `quantile` is the median estimate of the coefficient below which a share `content` of all units is.
    `tolerance` is its upper bound at `confidence`: the number for a config file that suits every unit. With
    fewer than three units, all but `median` are None.
    """

    units: tuple[UnitValue, ...]
    logs: int
    median: Interval
    spread: Interval | None = None
    within: Interval | None = None
    prediction: tuple[float, float] | None = None
    quantile: float | None = None
    tolerance: float | None = None
    content: float
    confidence: float
    findings: tuple[Finding, ...]
    bounded: bool = False
    next_log: NextLog | None = None

    @property
    def middle(self) -> float | None:
        """The median unit's coefficient; None if it is bounded."""
        return None if self.bounded else self.median.value


@takes("imucal.population(values)", logs=[LogValue])
def population(logs: Sequence[LogValue], *, content: float = 0.95, confidence: float = 0.95) -> Population:
    """Return the distribution of a coefficient over the units of a fleet, from any number of `logs` per unit.

    A share `content` of all units is below the tolerance bound with probability `confidence`. Raises a
    ValueError if there is no log, or if a probability is not between 0 and 1.
    """
    if not logs:
        raise ArgumentError("a population needs at least one log")
    if not (0 < content < 1 and 0 < confidence < 1):
        raise ArgumentError(f"content and confidence must be between 0 and 1, got {content} and {confidence}")
    values = LogValues.of(logs)
    answer = partial(Population, logs=len(logs), content=content, confidence=confidence)
    if len(values.names) < MIN_UNITS:
        return _too_few(values, answer)
    posterior = Posterior.whole(values)
    within = interval_of(posterior.quantiles(posterior.omega, TAILS))
    units = _judged(values, UnitLikelihoods(values, within.value), posterior)
    answer, square = partial(answer, units=units, next_log=posterior.next_log()), MeanSquare(values)
    if not square.shows:
        highest, median = square.share_bound(content, confidence), square.bound(TAILS[-1])
        return answer(
            median=Interval(value=median, low=0.0, high=median),
            bounded=True,
            prediction=(0.0, square.share_bound(_CONTENT, _CONTENT)),
            quantile=min(square.share_bound(content, 0.5), highest),
            tolerance=highest,
            findings=(Finding("info", "weak-term", _ALL_BOUNDED),),
        )
    share = 100 * float(np.mean(values.bounded))
    reach = posterior.mu + float(scipy.special.ndtri(content)) * posterior.tau
    quantile, tolerance = np.exp(posterior.quantiles(reach, (0.5, confidence))).tolist()
    low, high = np.exp(posterior.prediction(TAILS[::2])).tolist()
    return answer(
        median=interval_of(np.exp(posterior.quantiles(posterior.mu, TAILS))),
        spread=interval_of(posterior.quantiles(posterior.tau, TAILS)),
        within=within if len(posterior.omega) > 1 else None,
        prediction=(low, high),
        quantile=quantile,
        tolerance=tolerance,
        findings=(Finding("info", "weak-term", _MOSTLY_BOUNDED.format(share)),)
        if share > _MANY_BOUNDS
        else (),
    )


def membership(found: Population, new: LogValue) -> float:
    """Return the two-sided p-value of a `new` log of a unit of the fleet `found`.

    Raises a ValueError for a fleet of fewer than three units.
    """
    if found.next_log is None:
        raise ArgumentError(
            f"a spread between units needs at least {MIN_UNITS} units, got {len(found.units)}"
        )
    return found.next_log.p_value(LogValues.of([new]))


def _too_few(values: LogValues, answer: Callable[..., Population]) -> Population:
    units = _units(values, UnitLikelihoods(values, 0.0))
    determined = [unit.value for unit in units if unit.value is not None]
    low, high = min(unit.low for unit in units), max(unit.high for unit in units)
    middle = math.exp(sum(map(math.log, determined)) / len(determined)) if determined else high
    number = f"{len(units)} unit{'s' * (len(units) > 1)}"
    return answer(
        units=units,
        median=Interval(value=middle, low=low, high=high),
        bounded=not determined,
        findings=(Finding("info", "few-units", _TOO_FEW.format(number)),),
    )


def _units(values: LogValues, units: UnitLikelihoods) -> tuple[UnitValue, ...]:
    determined, limits = units.limits()
    columns = (determined.tolist(), *np.exp(limits).tolist(), np.bincount(values.unit).tolist())
    return tuple(
        UnitValue(unit=name, logs=logs, value=value if known else None, low=low if known else 0.0, high=high)
        for name, known, low, value, high, logs in zip(values.names, *columns, strict=True)
    )


def _judged(values: LogValues, units: UnitLikelihoods, posterior: Posterior) -> tuple[UnitValue, ...]:
    """Return each unit with its p-values.

    The quick test uses Student's t or all units' posterior, the exact test the other units' posterior.
    """
    determined = bool(units.normal.all())
    squares = values.squares.mean_by(values.unit, math.exp(2 * values.middle))
    scatter = posterior.quantiles(posterior.omega, [0.5])
    own = scatter / np.sqrt(np.bincount(values.unit))
    if determined:
        tau = float(posterior.quantiles(posterior.tau, [0.5])[0])
        quick = leave_one_out(units.centre, units.deviation, tau)
    else:
        quick = posterior.p_values(squares, own)

    def by_others(unit: int) -> float:
        others = values.take(values.unit != unit)
        if len(others.names) < MIN_UNITS:
            return 1.0
        alone = Posterior(others, None if determined else scatter)
        if determined:
            return alone.p_value(values.take(values.unit == unit))
        return float(alone.p_values(squares[[unit]], own[[unit]])[0])

    p_values = oddest_by_others(quick, _SUSPECT, by_others).tolist()
    chances = zip(p_values, holm(p_values), strict=True)
    return tuple(
        replace(unit, p_value=p, p_odd=p_odd, odd=p_odd <= SIGNIFICANCE)
        for unit, (p, p_odd) in zip(_units(values, units), chances, strict=True)
    )


def oddest_by_others(quick: FloatArray, suspect: float, by_others: Callable[[int], float]) -> FloatArray:
    """Return p-values, shape (units,): `by_others` if the `quick` one is below `suspect`, otherwise 1."""
    result = np.ones(quick.size)
    for unit in np.argsort(quick)[:_SUSPECTS].tolist():
        if quick[unit] < suspect:
            result[unit] = by_others(unit)
    return result


def leave_one_out(centre: FloatArray, deviation: FloatArray, tau: float) -> FloatArray:
    """Return two-sided p-values of the units, each compared with the mean and the spread of the others.

    `centre` and `deviation`, shape (units,), are in the logarithm. `tau`, the deviation between units, only
    sets their weights.
    """
    n = centre.size
    if n <= MIN_UNITS:
        # No degrees of freedom are left.
        return np.ones(n)
    w = 1 / (deviation**2 + max(tau, 1e-12) ** 2)
    total = w.sum()
    rest = total - w
    off = centre - np.sum(w * centre) / total
    apart = off * total / rest
    squares = np.sum(w * off**2) - w * off * apart
    scale = np.sqrt(np.maximum(squares, 1e-300) / (n - 2) * (1 / w + 1 / rest))
    result: FloatArray = 2 * scipy.special.stdtr(n - 2, -np.abs(apart) / scale)
    return result


def random_mean(values: FloatArray, errors: FloatArray) -> tuple[float, float, float]:
    """Return the random-effects mean of values, shape (n,), its standard error, and their spread.

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
    """Bounds of the mean of the units' squared coefficients."""

    def __init__(self, values: LogValues) -> None:
        self._units = values.squares.mean_by(values.unit, 0.0)
        self._known_by_limits = bool(values.by_limits.any())

    @property
    def shows(self) -> bool:
        """Whether all logs together show the coefficient, even without any one unit."""
        weight = self._units.sd**-2.0
        share = weight * self._units.estimate
        others = (np.sum(share) - share) / np.sqrt(np.sum(weight) - weight)
        return self._known_by_limits or bool(others.min() >= TWO_SIDED)

    def share_bound(self, content: float, confidence: float) -> float:
        """Return the bound of a share `content` of all units at a `confidence`."""
        return self.bound(confidence) * math.exp(max(float(scipy.special.ndtri(content)), 0.0) ** 2 / 4)

    def bound(self, confidence: float) -> float:
        """Return the upper bound of the root mean square: the larger of equal and of different squares."""
        return math.sqrt(max(self._of_one(confidence), self._of_different(confidence)))

    def _of_one(self, confidence: float) -> float:
        """Return the bound of a square that is equal for all units, from its likelihood."""
        units, reach = self._units, float(self._units.sd.min())
        for _ in range(_DOUBLINGS):
            square = np.linspace(0.0, reach, _POINTS)
            height = np.zeros(square.size)
            for first in range(0, units.sd.size, _CHUNK):
                height += units[first : first + _CHUNK].log_likelihood(square).sum(axis=0)
            height -= height.max()
            if height[-1] < _NOTHING:
                break
            reach *= 2
        total = scipy.integrate.cumulative_simpson(np.exp(height), x=square, initial=0.0)
        return float(np.interp(confidence, total / total[-1], square))

    def _of_different(self, confidence: float) -> float:
        """Return the bound of the mean of different squares; 0 if they scatter no more than their errors."""
        units = self._units
        at = max(float(np.average(units.estimate, weights=units.sd**-2.0)), 0.0)
        mean, error, spread = random_mean(units.estimate, units.deviation(at))
        beyond = (1 - confidence) * float(scipy.special.ndtr(mean / error))
        return mean - error * float(scipy.special.ndtri(beyond)) if spread else 0.0
