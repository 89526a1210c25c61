"""The population that a fleet's units are drawn from: the coefficient of a sensor model, not of one unit.

On the logarithm of a coefficient, each log of unit u has ``mu + tau b_u + omega c_ul`` with b and c standard
normal, known through its own likelihood. mu is flat, tau has Jeffreys' prior, omega is on a short grid; the
posterior is summed on a grid of all three. Where every unit is measured exactly, the tolerance bound is
the noncentral-t factor.

Hardy & Thompson (1996), Statistics in Medicine 15, p. 619, give the likelihood of random effects; Tiao & Tan
(1965), Biometrika 52, p. 37, the prior for a one-way layout; Krishnamoorthy & Mathew (2009), Statistical
Tolerance Regions, chapters 2 and 5, the bound.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Interval
from imucal.fleet.bounded import only_bounded, rms_bound, share_bound
from imucal.fleet.log_value import LogValue, LogValues
from imucal.fleet.outliers import FALSE_SHARE, adjusted, leave_one_out
from imucal.fleet.posterior import Posterior, posterior_of, scatters, whole_posterior
from imucal.fleet.unit_likelihood import (
    Place,
    UnitLikelihoods,
    place_of,
    unit_likelihoods,
)

#: Fewer units have no spread that could be told.
_FEWEST = 3
#: Share of bounds above which they are worth a sentence.
_MOSTLY = 0.5
#: Units that are judged by the others alone: the oddest, up to a chance of being so odd at a quick look.
_SUSPECTS, _SUSPECT = 5, 0.2
#: Quantile of the normal law at 95 %, two-sided; and where the interval and the median lie.
_TWO_SIDED = 1.959963984540054
_TAILS = (0.025, 0.5, 0.975)
#: Probability with which the next unit lies in its limits.
_CONTENT = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Population:
    """What a coefficient is like over the units of one sensor model.

    Attributes
    ----------
    units
        The units in the order of their first log.
    logs
        How many logs there are.
    median
        Coefficient of the median unit, with its 95 % interval. Where it is `bounded`, the interval begins at
        0, and value and high are its upper limit.
    bounded
        Whether the logs, all together, do not tell the median unit from one without this term. The spreads
        are then not known either.
    spread
        Standard deviation between units, in the logarithm (0.1: 10 %); None below three units.
    within
        Standard deviation between logs of one unit; None where no unit has two logs.
    prediction
        Limits that hold the next unit with probability 0.95; None below three units.
    quantile
        The coefficient that a share `content` of all units stays below: its median estimate.
    tolerance
        The value that bounds it with `confidence`: the number for the config of every unit.
    findings
        What should be known of these numbers.
    """

    units: tuple[UnitValue, ...]
    logs: int
    median: Interval
    spread: Interval | None
    within: Interval | None
    prediction: tuple[float, float] | None
    quantile: float | None
    tolerance: float | None
    content: float
    confidence: float
    findings: tuple[Finding, ...]
    bounded: bool = False


def population(logs: Sequence[LogValue], *, content: float = 0.95, confidence: float = 0.95) -> Population:
    """Return what the units of a fleet are like.

    Parameters
    ----------
    logs
        What each log says of the coefficient, any number of logs a unit.
    content, confidence
        The tolerance bound holds a share `content` of all units with probability `confidence`.

    Raises
    ------
    ValueError
        If there is no log, or a probability is not between 0 and 1.
    """
    if not logs:
        msg = "a population needs at least one log"
        raise ValueError(msg)
    if not (0 < content < 1 and 0 < confidence < 1):
        msg = f"content and confidence must be between 0 and 1, got {content} and {confidence}"
        raise ValueError(msg)
    values = LogValues.of(logs)
    place = place_of(values)
    if len(values.names) < _FEWEST:
        return _too_few(values, place, content, confidence)
    posterior = whole_posterior(values, place)
    within = posterior.quantiles(posterior.omega, _TAILS) if len(posterior.omega) > 1 else None
    spread = posterior.quantiles(posterior.tau, _TAILS)
    scatter = 0.0 if within is None else float(within[1])
    units = _judged(values, unit_likelihoods(values, scatter, place), posterior, place)
    if only_bounded(values):
        return _bounded(values, units, content, confidence)
    quantile, tolerance = np.exp(posterior.reaches(content, (0.5, confidence)))
    low, high = np.exp(posterior.prediction(_TAILS[::2]))
    return Population(
        units=units,
        logs=len(logs),
        median=_interval(np.exp(posterior.quantiles(posterior.mu, _TAILS))),
        spread=_interval(spread),
        within=None if within is None else _interval(within),
        prediction=(float(low), float(high)),
        quantile=float(quantile),
        tolerance=float(tolerance),
        content=content,
        confidence=confidence,
        findings=_weakness(values),
    )


def _bounded(
    values: LogValues, units: tuple[UnitValue, ...], content: float, confidence: float
) -> Population:
    """Return how large a coefficient can be that all logs together do not show."""
    text = (
        "All logs together do not show this term: every number is an upper bound, and the spread between "
        "units is not known. Longer logs would say more than more units."
    )
    highest, median = share_bound(values, content, confidence), rms_bound(values, _TAILS[-1])
    return Population(
        units=units,
        logs=values.centre.size,
        median=Interval(value=median, low=0.0, high=median),
        bounded=True,
        spread=None,
        within=None,
        prediction=(0.0, share_bound(values, _CONTENT, _CONTENT)),
        quantile=min(share_bound(values, content, 0.5), highest),
        tolerance=highest,
        content=content,
        confidence=confidence,
        findings=(Finding(level="info", code="weak-term", text=text),),
    )


def _units(values: LogValues, units: UnitLikelihoods) -> tuple[UnitValue, ...]:
    """Return each unit by itself; those that only bound the coefficient have no value."""
    low, middle, high = (units.centre + side * _TWO_SIDED * units.deviation for side in (-1, 0, 1))
    told = units.normal.copy()
    theta = units.theta
    for unit, curve in zip(np.flatnonzero(~units.normal).tolist(), units.weak, strict=True):
        inside = theta[curve > curve.max() - _TWO_SIDED**2 / 2]
        middle[unit], low[unit], high[unit] = theta[curve.argmax()], inside[0], inside[-1]
        told[unit] = inside[0] > theta[0]
    logs = np.bincount(values.unit)
    return tuple(
        UnitValue(
            unit=name,
            logs=int(logs[i]),
            value=float(np.exp(middle[i])) if told[i] else None,
            low=float(np.exp(low[i])) if told[i] else 0.0,
            high=float(np.exp(high[i])),
        )
        for i, name in enumerate(values.names)
    )


def _judged(
    values: LogValues, units: UnitLikelihoods, posterior: Posterior, place: Place
) -> tuple[UnitValue, ...]:
    """Return each unit with the probability of being so odd by chance."""
    alone = _p_values(values, units, posterior, place)
    return tuple(
        replace(unit, p_value=own, p_odd=p, odd=p <= FALSE_SHARE)
        for unit, own, p in zip(_units(values, units), alone.tolist(), adjusted(alone).tolist(), strict=True)
    )


def _p_values(values: LogValues, units: UnitLikelihoods, posterior: Posterior, place: Place) -> FloatArray:
    """Return how probable each unit is: the oddest in the posterior of the others, to which they are new.

    That allows for how badly the spreads between and within units are known. A quick look finds who is to
    be judged so: Student's t of well told units, else the posterior of all. The rest can only pass.
    """
    told = bool(units.normal.all())
    squares = values.unit_squares(place.centre)
    scatter = posterior.quantiles(posterior.omega, [0.5])
    own = scatter / np.sqrt(np.bincount(values.unit))
    if told:
        tau = float(posterior.quantiles(posterior.tau, [0.5])[0])
        quick = leave_one_out(units.centre, units.deviation, tau)
    else:
        quick = posterior.p_values(squares, own)
    result = np.ones(quick.size)
    oddest = np.argsort(quick)[:_SUSPECTS]
    for unit in oddest[quick[oddest] < _SUSPECT].tolist():
        others = values.without(unit)
        if len(others.names) < _FEWEST:
            continue
        if told:
            alone = posterior_of(others, scatters(others), place)
            result[unit] = alone.p_value(*values.unit_centre(unit, alone.omega.ravel()))
        else:
            alone = posterior_of(others, scatter, place)
            result[unit] = alone.p_values(squares.take([unit]), own[[unit]])[0]
    return result


def _too_few(values: LogValues, place: Place, content: float, confidence: float) -> Population:
    """Return one or two units as they are: they tell nothing of a spread between units."""
    n = len(values.names)
    units = _units(values, unit_likelihoods(values, 0.0, place))
    told = [unit.value for unit in units if unit.value is not None]
    high = max(unit.high for unit in units)
    middle = math.exp(sum(map(math.log, told)) / len(told)) if told else high
    text = (
        f"{n} unit{'s' * (n > 1)}: the spread between units, the next unit and a tolerance bound need "
        f"{_FEWEST} at least; 10 are worth testing."
    )
    return Population(
        units=units,
        logs=values.centre.size,
        median=Interval(value=middle, low=min(u.low for u in units), high=high),
        bounded=not told,
        spread=None,
        within=None,
        prediction=None,
        quantile=None,
        tolerance=None,
        content=content,
        confidence=confidence,
        findings=(Finding(level="info", code="few-units", text=text),),
    )


def _weakness(values: LogValues) -> tuple[Finding, ...]:
    """Say where nearly all logs only bound the term: the median then leans on the bounds."""
    share = float(np.mean(~np.isnan(values.bound)))
    if share <= _MOSTLY:
        return ()
    text = (
        f"{100 * share:.0f} % of the logs only bound this term: longer logs would say more than more units."
    )
    return (Finding(level="info", code="weak-term", text=text),)


def _interval(limits: FloatArray) -> Interval:
    low, value, high = map(float, limits)
    return Interval(value=value, low=low, high=high)
