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

from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Interval
from imucal.fleet.log_value import LogValue, LogValues
from imucal.fleet.outliers import FALSE_SHARE, adjusted, leave_one_out
from imucal.fleet.unit_likelihood import (
    Place,
    UnitLikelihoods,
    blur,
    place_of,
    unit_likelihoods,
    weighted_quantiles,
)

#: Fewer units have no spread that could be told.
_FEWEST = 3
#: Grid points of mu, of tau and of omega; the grid is narrowed so many times at most.
_MUS, _TAUS, _OMEGAS, _ROUNDS = 61, 48, 12, 6
#: A scatter within a unit that the logs show so rarely is not considered.
_RARE = 1e-3
#: Median farthest from the first guess, in the logarithm.
_DEEPEST = 4.0
#: Points of the predictive law that a weak unit is judged by.
_DRAWS = 4000
#: Keeps the logarithm of a probability that underflows finite.
_TINY = math.exp(-690)
#: Share of bounds above which they are worth a sentence.
_MOSTLY = 0.5
#: Largest spread between units that is thought of, in the logarithm.
_WIDEST = 2.0
#: What lies so far below the posterior's peak, in the logarithm, weighs nothing.
_NOTHING = 16.0
#: Units of a weak term that are judged by the others alone: the oddest, up to a chance of being so odd.
_SUSPECTS, _SUSPECT = 5, 0.2
#: Units whose terms are added at a time.
_CHUNK = 2048
#: Quantile of the normal law at 95 %, two-sided; and where the interval and the median lie.
_TWO_SIDED = 1.959963984540054
_TAILS = (0.025, 0.5, 0.975)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitValue:
    """One unit of a fleet: its coefficient from all of its logs, None where they only bound it.

    `p_odd` is the adjusted p-value of belonging to the others, None where it was not tested; `odd` says
    that it does not.
    """

    unit: str
    logs: int
    value: float | None
    low: float
    high: float
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
        Coefficient of the median unit, with its 95 % interval.
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
    posterior = _posterior(values, _scatters(values), place)
    within = posterior.quantiles(posterior.omega, _TAILS) if len(posterior.omega) > 1 else None
    spread = posterior.quantiles(posterior.tau, _TAILS)
    scatter = 0.0 if within is None else float(within[1])
    quantile, tolerance = np.exp(posterior.reaches(content, (0.5, confidence)))
    low, high = np.exp(posterior.prediction(_TAILS[::2]))
    return Population(
        units=_judged(values, unit_likelihoods(values, scatter, place), posterior, place),
        logs=len(logs),
        median=_interval(np.exp(posterior.quantiles(posterior.mu, _TAILS))),
        spread=_interval(spread),
        within=None if within is None else _interval(within),
        prediction=(float(low), float(high)),
        quantile=float(quantile),
        tolerance=float(tolerance),
        content=content,
        confidence=confidence,
        findings=_unlabelled(values),
    )


@dataclass(frozen=True, slots=True)
class _Posterior:
    """Weights on a grid of omega, tau and mu, broadcast against each other; they add up to one."""

    omega: FloatArray
    tau: FloatArray
    mu: FloatArray
    weight: FloatArray

    def quantiles(self, values: FloatArray, at: Sequence[float]) -> FloatArray:
        """Return quantiles of a function of the grid."""
        every = np.broadcast_to(values, self.weight.shape)
        keep = self.weight > math.exp(-_NOTHING) * self.weight.max()
        return weighted_quantiles(every[keep], self.weight[keep], at)

    def reaches(self, content: float, at: Sequence[float]) -> FloatArray:
        """Return quantiles of the logarithm that a share `content` of all units stays below."""
        from scipy.special import ndtri

        return self.quantiles(self.mu + float(ndtri(content)) * self.tau, at)

    def prediction(self, at: Sequence[float] | FloatArray) -> FloatArray:
        """Return quantiles of the logarithm of a unit that was not seen."""
        from scipy.special import ndtr

        weight = self.weight.sum(axis=0)
        keep = weight > math.exp(-_NOTHING) * weight.max()
        mu, tau = (np.broadcast_to(x, self.weight.shape)[0][keep] for x in (self.mu, self.tau))
        reach = 6 * float(tau.max())
        grid = np.linspace(float(mu.min()) - reach, float(mu.max()) + reach, 801)
        below = ndtr((grid[:, None] - mu) / tau) @ weight[keep] / weight[keep].sum()
        return np.interp(at, below, grid)

    def p_values(self, variance: FloatArray, sd: FloatArray) -> FloatArray:
        """Return the two-sided chance of squared coefficients like these, known with a normal error."""
        from scipy.special import ndtr

        at = np.linspace(0.5 / _DRAWS, 1 - 0.5 / _DRAWS, _DRAWS)
        square = np.exp(2 * self.prediction(at))
        above = ndtr((square - variance[:, None]) / sd[:, None]).mean(axis=1)
        result: FloatArray = 2 * np.minimum(above, 1 - above)
        return result


def _posterior(values: LogValues, omegas: FloatArray, place: Place) -> _Posterior:
    """Return the posterior on a grid that is narrowed until it fits its support.

    Each tau has a grid of mu of its own: the less the spread, the better the median is known.
    """
    units = [unit_likelihoods(values, float(omega), place) for omega in omegas]
    taus = (math.log(0.01 * place.scale), math.log(max(_WIDEST, 2 * place.scale)))
    for _ in range(_ROUNDS):
        tau = np.exp(np.linspace(*taus, _TAUS))
        mu, height = _over_mu(units, tau, place)
        height -= height.max()
        narrower = _support(np.log(tau), np.any(height > -_NOTHING, axis=(0, 2)))
        if 2 * (narrower[1] - narrower[0]) > taus[1] - taus[0]:
            break
        taus = narrower
    weight = np.exp(height)
    return _Posterior(omegas[:, None, None], tau[None, :, None], mu[None], weight / weight.sum())


def _over_mu(units: list[UnitLikelihoods], tau: FloatArray, place: Place) -> tuple[FloatArray, FloatArray]:
    """Return for each tau the grid of mu that fits it, (tau, mu), and the posterior, (omega, tau, mu)."""
    reach = min(9 * place.scale, _DEEPEST) + 6 * tau
    ends = np.column_stack([place.centre - reach, place.centre + reach])
    for _ in range(_ROUNDS):
        mu = np.linspace(ends[:, 0], ends[:, 1], _MUS, axis=1)
        height = np.array([_log_posterior(of_omega, tau, mu) for of_omega in units])
        own = height - height.max(axis=(0, 2), keepdims=True)
        narrower = np.array(list(map(_support, mu, np.any(own > -_NOTHING, axis=0))))
        if np.all(2 * np.diff(narrower) > np.diff(ends)):
            break
        ends = narrower
    return mu, height + np.log(mu[:, 1] - mu[:, 0])[:, None]


def _support(grid: FloatArray, likely: BoolArray) -> tuple[float, float]:
    """Return the range of the likely points and one more to each side."""
    places = np.flatnonzero(likely)
    return float(grid[max(places[0] - 1, 0)]), float(grid[min(places[-1] + 1, grid.size - 1)])


def _log_posterior(units: UnitLikelihoods, tau: FloatArray, mu: FloatArray) -> FloatArray:
    """Return the logarithm of the posterior, shape (tau, mu), for a flat measure in log tau."""
    s2, all_s2 = units.deviation[units.normal] ** 2, units.deviation**2
    result = np.full(mu.shape, units.constant)
    for row, t in enumerate(tau):
        v = s2 + t * t
        y, offset = units.centre[units.normal] - mu[row, 0], mu[row] - mu[row, 0]
        squares = np.sum(y * y / v) - 2 * offset * np.sum(y / v) + offset**2 * np.sum(1 / v)
        result[row] -= 0.5 * (squares + np.sum(np.log(v)))
        result[row] += _weak_part(units, float(t), mu[row])
        # Jeffreys' prior of tau, and the step from tau to its logarithm.
        result[row] += 2 * math.log(t) + 0.5 * math.log(np.sum(1 / (all_s2 + t * t) ** 2))
    return result


def _weak_part(units: UnitLikelihoods, tau: float, mu: FloatArray) -> FloatArray | float:
    """Return what the units on the grid say of mu, at one tau."""
    if not units.weak.size:
        return 0.0
    matrix = blur(mu, units.theta, tau)
    total = np.zeros(mu.size)
    for start in range(0, len(units.weak), _CHUNK):
        some = units.weak[start : start + _CHUNK]
        top = some.max(axis=1, keepdims=True)
        total += np.log(matrix @ np.exp(some - top).T + _TINY).sum(axis=1) + top.sum()
    return total


def _scatters(values: LogValues) -> FloatArray:
    """Return the scatters within a unit to consider, evenly spaced; only 0 where no unit has two logs."""
    from scipy.special import chdtri

    counts = np.bincount(values.unit)
    degrees = values.unit.size - counts.size
    if degrees == 0:
        return np.zeros(1)
    means = np.bincount(values.unit, values.centre) / counts
    squares = float(np.sum((values.centre - means[values.unit]) ** 2))
    if not values.narrow.all():
        return np.linspace(0.0, min(3 * math.sqrt(squares / degrees) + 0.3, _WIDEST), _OMEGAS)
    known = float(np.mean(values.deviation**2))
    low, high = (squares / float(chdtri(degrees, tail)) for tail in (_RARE, 1 - _RARE))
    most = 10 * math.sqrt(squares / degrees) + 1e-6
    return np.linspace(math.sqrt(max(low - known, 0.0)), min(math.sqrt(high), most), _OMEGAS)


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
    values: LogValues, units: UnitLikelihoods, posterior: _Posterior, place: Place
) -> tuple[UnitValue, ...]:
    """Return each unit with the probability of being so odd by chance."""
    if units.normal.all():
        tau = float(posterior.quantiles(posterior.tau, [0.5])[0])
        p_values = leave_one_out(units.centre, units.deviation, tau)
    else:
        p_values = _weak_p_values(values, posterior, place)
    return tuple(
        replace(unit, p_odd=float(p), odd=bool(p <= FALSE_SHARE))
        for unit, p in zip(_units(values, units), adjusted(p_values), strict=True)
    )


def _weak_p_values(values: LogValues, posterior: _Posterior, place: Place) -> FloatArray:
    """Return how probable each unit's variances are in the population: of the oddest, that of the others.

    Other units than the oddest are judged with themselves among the others, and can only pass.
    """
    variance, sd = values.unit_variances()
    p_values = posterior.p_values(variance, sd)
    oddest = np.argsort(p_values)[:_SUSPECTS]
    result = np.ones(p_values.size)
    for unit in oddest[p_values[oddest] < _SUSPECT]:
        others = values.without(int(unit))
        if len(others.names) >= _FEWEST:
            alone = _posterior(others, np.array([float(posterior.omega.mean())]), place)
            result[unit] = alone.p_values(variance[[unit]], sd[[unit]])[0]
    return result


def _too_few(values: LogValues, place: Place, content: float, confidence: float) -> Population:
    """Return one or two units as they are: they tell nothing of a spread between units."""
    n = len(values.names)
    units = _units(values, unit_likelihoods(values, 0.0, place))
    told = [unit.value for unit in units if unit.value is not None]
    middle = math.exp(sum(map(math.log, told)) / len(told)) if told else units[0].high / 2
    text = (
        f"{n} unit{'s' * (n > 1)}: the spread between units, the next unit and a tolerance bound need "
        f"{_FEWEST} at least; 10 are worth testing."
    )
    return Population(
        units=units,
        logs=values.centre.size,
        median=Interval(value=middle, low=min(u.low for u in units), high=max(u.high for u in units)),
        spread=None,
        within=None,
        prediction=None,
        quantile=None,
        tolerance=None,
        content=content,
        confidence=confidence,
        findings=(Finding(level="info", code="few-units", text=text),),
    )


def _unlabelled(values: LogValues) -> tuple[Finding, ...]:
    """Say where nearly all logs only bound the term: the median then leans on the bounds."""
    share = float(np.mean(~np.isfinite(values.deviation)))
    if share <= _MOSTLY:
        return ()
    text = (
        f"{100 * share:.0f} % of the logs only bound this term: longer logs would say more than more units."
    )
    return (Finding(level="info", code="weak-term", text=f"{text}."),)


def _interval(limits: FloatArray) -> Interval:
    low, value, high = map(float, limits)
    return Interval(value=value, low=low, high=high)
