"""The population that a fleet's units are drawn from: the coefficient of a sensor model, not of one unit.

A unit is odd by what the others are like, so that it can't hide by widening the spread that it is judged by;
over all units Benjamini & Hochberg (1995), Journal of the Royal Statistical Society B 57, p. 289, hold the
false discovery rate.

Where the logs of a whole fleet only bound a coefficient, the mean of the units' squares is still measured
without bias, whatever the spread between them. It bounds the median unit's square, and through it each share
of the units: of all lognormal laws with root mean square r, exp(m + t²) = r, a share p lies below
exp(m + z t), which is r exp(z t - t²) ≤ r exp(z² / 4) for the quantile z of p. So the bound needs no spread,
which such logs do not tell.
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

#: Fewer units tell no spread.
MIN_UNITS = 3
#: Expected share of false ones among the units that are called odd.
FALSE_SHARE = 0.05
#: Share of bounds, in per cent, above which they are worth a sentence.
_MANY_BOUNDS = 50.0
#: Units that are judged by the others alone at most, and up to which chance at a quick look.
_SUSPECTS, _SUSPECT = 5, 0.2
#: Probability with which the next unit lies in its limits.
_CONTENT = 0.95
_MOSTLY_BOUNDED = "{:.0f} % of the logs only bound this term: longer logs would help more than more units."
_ALL_BOUNDED = (
    "All logs together do not show this term: every number is an upper bound, and the spread between units "
    "is unknown. Longer logs would help more than more units."
)
_TOO_FEW = (
    "{}: the spread between units, the next unit and a tolerance bound need at least "
    f"{MIN_UNITS}; test about 10."
)
#: Points of a mean square's likelihood, up to where its logarithm is so far below the peak; how often its
#: reach is doubled at most; and units that are added at a time.
_POINTS, _NOTHING, _DOUBLINGS, _CHUNK = 1001, -30.0, 200, 1024


@frozen
class UnitValue:
    """One unit of a fleet: its coefficient from all of its logs, None where they only bound it.

    `p_value` is the chance that one of the others is so far off, None where it was not tested; `p_odd` is
    adjusted for the number of units, and `odd` says that it does not belong to the others.
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
    """What a coefficient is like over the units of one sensor model.

    `units` are in the order of their first log; `logs` is how many there are. `median` is the coefficient of
    the median unit, with its 95 % interval. It is `bounded` where the logs, all together, do not tell it from
    that of a unit without this term: its interval then begins at 0, value and high are its upper limit, and
    the spreads are not known either.

    `spread` is the standard deviation between units, in the logarithm (0.1: 10 %), None below three units;
    `within` that between logs of one unit, None where no unit has two. `prediction` are limits that hold the
    next unit with probability 0.95, and `next_log` is where a log of it lies; None below three units.

    A share `content` of all units stays below `quantile`, by its median estimate, and with `confidence` below
    `tolerance`, which is the number for the config of every unit. `findings` should be known with these.
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
        """The median unit's coefficient; None where the logs only bound it."""
        return None if self.bounded else self.median.value


@takes("imucal.population(values)", logs=[LogValue])
def population(logs: Sequence[LogValue], *, content: float = 0.95, confidence: float = 0.95) -> Population:
    """Return what the units of a fleet are like, by what each log says, any number of `logs` a unit.

    The tolerance bound holds a share `content` of all units with probability `confidence`. It is a ValueError
    if there is no log, or a probability is not between 0 and 1.
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
        # The median then leans on the bounds.
        findings=(Finding("info", "weak-term", _MOSTLY_BOUNDED.format(share)),)
        if share > _MANY_BOUNDS
        else (),
    )


def membership(found: Population, new: LogValue) -> float:
    """Return the two-sided chance that a unit of the fleet `found` gives a log like a `new` one.

    The spread between units, the scatter between logs of a unit and the error of the new log are all in it,
    and how badly the first two are known. A fleet of fewer than three units is a `ValueError`.
    """
    if found.next_log is None:
        raise ArgumentError(
            f"a spread between units needs at least {MIN_UNITS} units, got {len(found.units)}"
        )
    return found.next_log.p_value(LogValues.of([new]))


def _too_few(values: LogValues, answer: Callable[..., Population]) -> Population:
    """Return one or two units as they are: they tell nothing of a spread between units."""
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
    """Return each unit by itself; those that only bound the coefficient have no value."""
    determined, limits = units.limits()
    columns = (determined.tolist(), *np.exp(limits).tolist(), np.bincount(values.unit).tolist())
    return tuple(
        UnitValue(unit=name, logs=logs, value=value if known else None, low=low if known else 0.0, high=high)
        for name, known, low, value, high, logs in zip(values.names, *columns, strict=True)
    )


def _judged(values: LogValues, units: UnitLikelihoods, posterior: Posterior) -> tuple[UnitValue, ...]:
    """Return each unit with the chance of being so odd.

    A unit is new to the posterior of the others, so that allows for how badly the spreads between and within
    units are known. The quick look is Student's t of well told units, else the posterior of all.
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
    chances = zip(p_values, adjusted(p_values), strict=True)
    return tuple(
        replace(unit, p_value=p, p_odd=p_odd, odd=p_odd <= FALSE_SHARE)
        for unit, (p, p_odd) in zip(_units(values, units), chances, strict=True)
    )


def oddest_by_others(quick: FloatArray, suspect: float, by_others: Callable[[int], float]) -> FloatArray:
    """Return p-values of units, shape (units,): of the oddest by the others alone; the rest can only pass.

    The oddest have a p-value below `suspect` at a quick look.
    """
    result = np.ones(quick.size)
    for unit in np.argsort(quick)[:_SUSPECTS].tolist():
        if quick[unit] < suspect:
            result[unit] = by_others(unit)
    return result


def leave_one_out(centre: FloatArray, deviation: FloatArray, tau: float) -> FloatArray:
    """Return two-sided p-values of the units, each against the mean and the spread of the others.

    `centre` and `deviation`, shape (units,), are the logarithm of each unit's coefficient and its standard
    error. The standard deviation `tau` between units sets their weights, not the scale of the test.
    """
    n = centre.size
    if n <= MIN_UNITS:
        # No degrees of freedom are left to judge one by the others.
        return np.ones(n)
    w = 1 / (deviation**2 + max(tau, 1e-12) ** 2)
    total = w.sum()
    rest = total - w
    off = centre - np.sum(w * centre) / total
    apart = off * total / rest
    # Squares about the mean of the others: those about the mean of all, less the unit's own share.
    squares = np.sum(w * off**2) - w * off * apart
    scale = np.sqrt(np.maximum(squares, 1e-300) / (n - 2) * (1 / w + 1 / rest))
    result: FloatArray = 2 * scipy.special.stdtr(n - 2, -np.abs(apart) / scale)
    return result


def adjusted(p_values: Sequence[float] | FloatArray) -> list[float]:
    """Return p-values adjusted for the number of tests by Benjamini and Hochberg's step-up procedure."""
    p, order = np.array(p_values), np.argsort(p_values)
    stepped = p[order] * p.size / np.arange(1, p.size + 1)
    p[order] = np.minimum(np.minimum.accumulate(stepped[::-1])[::-1], 1.0)
    return [*map(float, p)]


def random_mean(values: FloatArray, errors: FloatArray) -> tuple[float, float, float]:
    """Return the mean of values, shape (n,), that differ; its standard error, and their spread.

    The spread beyond their standard errors is by moments, 0 at least; it is in the weights.
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
    """What all logs of a fleet tell of the mean of its units' squared coefficients, at zero and above."""

    def __init__(self, values: LogValues) -> None:
        self._units = values.squares.mean_by(values.unit, 0.0)
        self._known_by_limits = bool(values.by_limits.any())

    @property
    def shows(self) -> bool:
        """Whether all logs together show the coefficient; one unit alone does not decide."""
        weight = self._units.sd**-2.0
        share = weight * self._units.estimate
        others = (np.sum(share) - share) / np.sqrt(np.sum(weight) - weight)
        return self._known_by_limits or bool(others.min() >= TWO_SIDED)

    def share_bound(self, content: float, confidence: float) -> float:
        """Return what a share `content` of all units stays below with a probability `confidence`."""
        return self.bound(confidence) * math.exp(max(float(scipy.special.ndtri(content)), 0.0) ** 2 / 4)

    def bound(self, confidence: float) -> float:
        """Return the value that the units' root mean square stays below with a probability `confidence`.

        Of one square for all units, or of the mean of squares that differ, whichever is larger; neither is
        below zero (flat prior).
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
            if height[-1] < _NOTHING:
                break
            reach *= 2
        total = scipy.integrate.cumulative_simpson(np.exp(height), x=square, initial=0.0)
        return float(np.interp(confidence, total / total[-1], square))

    def _of_different(self, confidence: float) -> float:
        """Return the bound of the mean of squares that scatter by more than their errors say, else zero."""
        units = self._units
        at = max(float(np.average(units.estimate, weights=units.sd**-2.0)), 0.0)
        mean, error, spread = random_mean(units.estimate, units.deviation(at))
        beyond = (1 - confidence) * float(scipy.special.ndtr(mean / error))
        return mean - error * float(scipy.special.ndtri(beyond)) if spread else 0.0
