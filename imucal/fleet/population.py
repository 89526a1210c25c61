"""The distribution of a coefficient over the units of a sensor model.

A log estimates the squared coefficient without bias, possibly below zero; the weighted mean over the logs of
a unit is the unit's square. The logarithms of the units' coefficients are taken as normal: Student's t gives
the median and the next unit, and the noncentral t the tolerance bound (ISO 16269-6). Their scatter includes
the errors of the logs, so bounds are wider than necessary, never narrower. A unit that is only bounded counts
at its upper limit.

If more than a third of the units are only bounded, the mean of all squares bounds a share p of the units for
any spread t: a lognormal coefficient with root mean square r is below r exp(z t - t²) ≤ r exp(z² / 4), with
the normal quantile z of p.

Units of two batches are not lognormal. A test finds them, and the bound is then that of the larger group.

Sources: Krishnamoorthy & Mathew (2009), Statistical Tolerance Regions, eq. (2.2.3); Cochran (1954),
Biometrics 10, 101 (equal logs); Holm (1979), Scandinavian Journal of Statistics 6, 65.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc, ndtr, ndtri, stdtr, stdtrit

from imucal.arrays import FloatArray
from imucal.errors import ArgumentError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Interval
from imucal.fleet.groups import Groups, find_groups
from imucal.fleet.tolerance import tolerance_factor
from imucal.fleet.values import LogValue
from imucal.multiple_tests import SIGNIFICANCE, holm

#: Minimum number of units for a spread.
MIN_UNITS = 3
#: Largest share of bounded units for which logarithms are used: above it the upper half has too few units.
_MOST_BOUNDED = 1 / 3
#: Level of all intervals.
_LEVEL = 0.95
#: Normal quantile of a two-sided interval at this level.
_Z = float(ndtri((1 + _LEVEL) / 2))
#: Smallest spread of units in the logarithm: equal units would have infinite scores.
_LEAST_SPREAD = 1e-9
#: Multiple of its error from which a square is used for the scatter between logs of a unit.
_SURE = 2.0
#: Fewest degrees of freedom of other units' logs for a comparison with them.
_MIN_OTHERS = 4
_MOSTLY_BOUNDED = (
    "{:.0f} % of the units only bound this term: every number is an upper bound, and the spread is "
    "unknown. Longer logs would help more than more units."
)
_TOO_FEW = (
    "{}: the spread between units, the next unit and a tolerance bound need at least "
    f"{MIN_UNITS}; test about 10."
)
_TWO_GROUPS = (
    "The units form two groups (p = {p:.1g}): {lower}; and {upper}, which are {ratio:.3g} times as large. "
    "The number for the config is the bound of the larger group."
)


@dataclass(frozen=True, kw_only=True)
class UnitValue:
    """The coefficient of one unit of a fleet, from all of its logs; the value is None if it is only bounded.

    `p_value` is from the comparison with the other units; `p_odd` is adjusted for the number of units.
    `p_logs` is the probability that the logs of a unit like the others differ as much; None for one log.
    """

    unit: str
    logs: int
    value: float | None
    low: float
    high: float
    p_value: float | None = None
    p_odd: float | None = None
    odd: bool = False
    p_logs: float | None = None


@dataclass(frozen=True, kw_only=True)
class NextUnit:
    """The law of the logarithm of the next unit: Student's t with mean and standard deviation of `units`.

    `dof` are the degrees of freedom of the deviation; `within` is the deviation between logs of a unit.
    """

    mean: float
    deviation: float
    dof: int
    units: int
    within: float


@dataclass(frozen=True, kw_only=True)
class Population:
    """The distribution of a coefficient over the units of one sensor model.

    `median` is the coefficient of the median unit with its 95 % interval. It is `bounded` if more than a
    third of the units are only bounded: the interval then begins at 0, value and high are the upper limit,
    and the spreads are None.

    `spread` is the standard deviation between units, in the logarithm (0.1 is 10 %), and `within` the one
    between logs of a unit, None if no unit has two logs; both are without the errors of the logs.
    `prediction` are limits that contain the next unit with probability 0.95.

    `quantile` is the median estimate of the coefficient below which a share `content` of all units is, or
    the tolerance bound if the population is bounded.
    `tolerance` is its upper bound at `confidence`: the number for a config file that suits every unit. With
    fewer than three units, all but `median` are None. `groups` are the names of the smaller and of the larger
    units if they form two groups; otherwise it is empty.
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
    groups: tuple[tuple[str, ...], ...] = ()
    next_units: tuple[NextUnit, ...] = ()

    @property
    def middle(self) -> float | None:
        """The median unit's coefficient; None if it is bounded."""
        return None if self.bounded else self.median.value


def population(logs: Sequence[LogValue], *, content: float = 0.95, confidence: float = 0.95) -> Population:
    """Return the distribution of a coefficient over the units of a fleet, from any number of `logs` per unit.

    A share `content` of all units is below the tolerance bound with probability `confidence`, if the units
    are lognormal or show two lognormal groups. Raises a ValueError if there is no log, or if a probability is
    not between 0 and 1.
    """
    if not logs:
        raise ArgumentError("a population needs at least one log")
    if not (0 < content < 1 and 0 < confidence < 1):
        raise ArgumentError(f"content and confidence must be between 0 and 1, got {content} and {confidence}")
    by_unit: dict[str, list[LogValue]] = {}
    for log in logs:
        by_unit.setdefault(log.unit, []).append(log)
    typical = _typical_square(logs)
    scatters = {name: _scatter_of(unit_logs) for name, unit_logs in by_unit.items()}
    whole = _sum_of(scatters.values())
    within = whole.interval
    scatter = within.value if within else 0.0
    units = [
        replace(
            _unit_value(name, unit_logs, typical, scatter),
            p_logs=_p_of_logs(unit_logs, scatters[name], whole) if len(unit_logs) > 1 else None,
        )
        for name, unit_logs in by_unit.items()
    ]
    plain = Population(
        units=tuple(units),
        logs=len(logs),
        median=_middle(units),
        bounded=all(unit.value is None for unit in units),
        content=content,
        confidence=confidence,
        findings=(),
    )
    if len(units) < MIN_UNITS:
        number = f"{len(units)} unit{'s' * (len(units) > 1)}"
        return replace(plain, findings=(Finding("info", "few-units", _TOO_FEW.format(number)),))
    share = sum(unit.value is None for unit in units) / len(units)
    if share <= _MOST_BOUNDED:
        judged = replace(plain, units=_judged(units, _p_values(units)), within=within)
        return _of_logarithms(judged, share, scatter)
    squares, errors = _unit_squares(by_unit, typical)
    judged = replace(plain, units=_judged(units, _p_values_of_bounded(units, squares)))
    return _bounded(judged, squares, errors, share)


def membership(found: Population, new: LogValue) -> float:
    """Return the two-sided p-value of a `new` log of a unit of the fleet `found`; 1 if it is only bounded.

    Raises a ValueError for a fleet of fewer than three units.
    """
    if len(found.units) < MIN_UNITS:
        raise ArgumentError(
            f"a spread between units needs at least {MIN_UNITS} units, got {len(found.units)}"
        )
    if not found.next_units or new.value is None:
        return 1.0
    own = _log_error(new.value, new.low, new.high)
    p_values = []
    for law in found.next_units:
        variance = law.deviation**2 * (1 + 1 / law.units) + law.within**2 + own**2
        score = abs(math.log(new.value) - law.mean) / math.sqrt(variance)
        p_values.append(2 * float(stdtr(law.dof, -score)))
    return max(p_values)


def _typical_square(logs: Sequence[LogValue]) -> float:
    """Return the median square of the logs: weights must not depend on a log's own estimate."""
    return max(float(np.median([log.square for log in logs])), 0.0)


def _unit_value(name: str, logs: Sequence[LogValue], typical: float, scatter: float) -> UnitValue:
    """Return a unit's coefficient: that of its only log, or the mean square of its logs."""
    if len(logs) == 1:
        (log,) = logs
        low, high = log.limits(_LEVEL)
        return UnitValue(unit=name, logs=1, value=log.value, low=low, high=high)
    square, error, ratio = _mean_square(logs, typical, scatter)
    wide = _Z * error * ratio
    high = math.sqrt(max(square, 0.0) + wide)
    if square <= _Z * error:
        return UnitValue(unit=name, logs=len(logs), value=None, low=0.0, high=high)
    value = math.sqrt(square)
    # Logs that show the coefficient and differ much have limits in the logarithm: it is not zero.
    low = math.sqrt(square - wide) if wide < square else value * math.exp(-wide / (2 * square))
    return UnitValue(unit=name, logs=len(logs), value=value, low=low, high=high)


def _mean_square(logs: Sequence[LogValue], typical: float, scatter: float) -> tuple[float, float, float]:
    """Return the mean square of a unit's logs, its error, and the Birge ratio by which its limits are wider.

    `scatter` is the relative deviation between logs of a unit. The ratio is 1 unless they differ by more than
    this and their errors explain.
    """
    squares = np.array([log.square for log in logs])
    weights = np.array([log.square_deviation(typical) for log in logs]) ** -2.0
    square = float(np.average(squares, weights=weights))
    of_scatter = 2 * scatter * max(square, 0.0)
    deviations = np.array([math.hypot(log.square_deviation(max(square, 0.0)), of_scatter) for log in logs])
    error = math.sqrt(float(np.sum((weights * deviations) ** 2))) / float(weights.sum())
    dof = len(logs) - 1
    statistic = float(np.sum(((squares - square) / deviations) ** 2))
    ratio = math.sqrt(statistic / dof) if float(chdtrc(dof, statistic)) < SIGNIFICANCE else 1.0
    return square, error, ratio


def _middle(units: Sequence[UnitValue]) -> Interval:
    """Return the geometric mean of a few units, with the limits of all."""
    values = [unit.value for unit in units if unit.value is not None]
    low = min(unit.low for unit in units)
    high = max(unit.high for unit in units)
    middle = math.exp(sum(map(math.log, values)) / len(values)) if values else high
    return Interval(value=middle, low=low, high=high)


def _log_error(value: float, low: float, high: float) -> float:
    """Return the standard error of the logarithm of a coefficient with 95 % limits."""
    return math.log(high / low) / (2 * _Z) if low > 0 else math.log(high / value) / _Z


def _judged(units: Sequence[UnitValue], p_values: Sequence[float]) -> tuple[UnitValue, ...]:
    """Return the units with their p-values."""
    return tuple(
        replace(unit, p_value=p, p_odd=p_odd, odd=p_odd <= SIGNIFICANCE)
        for unit, p, p_odd in zip(units, p_values, holm(p_values), strict=True)
    )


def _p_values(units: Sequence[UnitValue]) -> list[float]:
    """Return each unit's p-value by the others alone: an odd unit can't hide behind its own spread."""
    logarithms = _logarithms(units)
    errors = np.array([0.0 if u.value is None else _log_error(u.value, u.low, u.high) for u in units])
    n = logarithms.size
    bounded = any(unit.value is None for unit in units)
    p_values = []
    for number, unit in enumerate(units):
        if unit.value is None or n <= MIN_UNITS:
            p_values.append(1.0)
            continue
        mean, spread = _centre(np.delete(logarithms, number), bounded=bounded)
        # A unit with a larger error than the others scatters more.
        excess = max(float(errors[number] ** 2 - np.mean(np.delete(errors, number) ** 2)), 0.0)
        variance = max(spread, _LEAST_SPREAD) ** 2 * (1 + 1 / (n - 1)) + excess
        score = (float(logarithms[number]) - mean) / math.sqrt(variance)
        # Where small units are only bounded, a low value is not odd.
        tail = -score if bounded else -abs(score)
        p_values.append(min(2 * float(stdtr(n - 2, tail)), 1.0))
    return p_values


def _p_values_of_bounded(units: Sequence[UnitValue], squares: FloatArray) -> list[float]:
    """Return the p-value of each unit by the root mean square of the others, for any spread of units.

    A lognormal coefficient with root mean square r is above c r with probability Φ(-2 √ln c) at most. The
    lower limit of the unit counts, and the upper limit of the others' mean square, shape (units,).
    """
    p_values = []
    for number, unit in enumerate(units):
        others = np.delete(squares, number)
        quantile = float(stdtrit(others.size - 1, _LEVEL))
        largest = float(others.mean()) + quantile * float(others.std(ddof=1)) / math.sqrt(others.size)
        ratio = unit.low / math.sqrt(largest) if largest > 0 else 1.0
        p_values.append(float(ndtr(-2 * math.sqrt(math.log(ratio)))) if ratio > 1 else 1.0)
    return p_values


def _logarithms(units: Sequence[UnitValue]) -> FloatArray:
    return np.log([unit.high if unit.value is None else unit.value for unit in units])


def _centre(logarithms: FloatArray, *, bounded: bool) -> tuple[float, float]:
    """Return mean and standard deviation; with bounded units, which are the small ones, of the upper half."""
    mean = float(logarithms.mean())
    deviation = float(logarithms.std(ddof=1))
    if not bounded:
        return mean, deviation
    median = float(np.median(logarithms))
    above = logarithms[logarithms > median] - median
    if not above.size:
        return mean, deviation
    return max(mean, median), max(deviation, math.sqrt(float(np.mean(above**2))))


def _of_logarithms(judged: Population, share: float, scatter: float) -> Population:
    """Return the population of units whose coefficients are mostly known."""
    logarithms = _logarithms(judged.units)
    groups = find_groups(logarithms) if share == 0 else None
    if groups is not None:
        return _of_groups(judged, groups, scatter)
    n = logarithms.size
    mean, deviation = _centre(logarithms, bounded=share > 0)
    quantile = float(stdtrit(n - 1, (1 + _LEVEL) / 2))
    of_mean = quantile * deviation / math.sqrt(n)
    of_next = quantile * deviation * math.sqrt(1 + 1 / n)
    # A bounded unit may be far below its limit.
    lowest = math.exp(mean - of_mean) * (1 - share / 2)
    spread = _spread(judged.units, deviation**2, n - 1)
    least = math.exp(mean - of_next)
    if share > 0:
        spread = replace(spread, low=0.0, high=_without_errors(deviation**2, n - 1, 0.0).high)
        least = 0.0
    return replace(
        judged,
        median=Interval(value=math.exp(mean), low=lowest, high=math.exp(mean + of_mean)),
        spread=spread,
        prediction=(least, math.exp(mean + of_next)),
        quantile=math.exp(mean + tolerance_factor(n, n - 1, judged.content, 0.5) * deviation),
        tolerance=_bound(judged, mean, deviation),
        next_units=(NextUnit(mean=mean, deviation=deviation, dof=n - 1, units=n, within=scatter),),
    )


def _bound(judged: Population, mean: float, deviation: float) -> float:
    """Return the tolerance bound of lognormal units, at least that of an odd unit that is larger.

    One large unit may be the first of a second batch.
    """
    n = len(judged.units)
    bound = mean + tolerance_factor(n, n - 1, judged.content, judged.confidence) * deviation
    odd = [unit for unit in judged.units if unit.odd and unit.value and math.log(unit.value) > mean]
    for unit in odd:
        others = _logarithms([other for other in judged.units if other is not unit])
        factor = tolerance_factor(1, n - 2, judged.content, judged.confidence)
        bound = max(bound, math.log(unit.value or unit.high) + factor * float(others.std(ddof=1)))
    return math.exp(bound)


def _of_groups(judged: Population, groups: Groups, scatter: float) -> Population:
    """Return the population of units that form two groups: limits and bound are those of the groups."""
    logarithms = _logarithms(judged.units)
    dof = logarithms.size - 2
    lower = logarithms[~groups.is_upper]
    upper = logarithms[groups.is_upper]
    smaller = tuple(judged.units[number].unit for number in np.flatnonzero(~groups.is_upper).tolist())
    larger = tuple(judged.units[number].unit for number in np.flatnonzero(groups.is_upper).tolist())
    reach = float(stdtrit(dof, (1 + _LEVEL) / 2)) * groups.deviation
    lowest = float(lower.mean()) - reach * math.sqrt(1 + 1 / lower.size)
    highest = float(upper.mean()) + reach * math.sqrt(1 + 1 / upper.size)

    def bound(confidence: float) -> float:
        factor = tolerance_factor(upper.size, dof, judged.content, confidence)
        return math.exp(float(upper.mean()) + factor * groups.deviation)

    text = _TWO_GROUPS.format(
        p=groups.p_value,
        lower=", ".join(smaller),
        upper=", ".join(larger),
        ratio=math.exp(float(upper.mean() - lower.mean())),
    )
    advice = "Label batches that differ as separate models."
    laws = [
        NextUnit(
            mean=float(group.mean()), deviation=groups.deviation, dof=dof, units=group.size, within=scatter
        )
        for group in (lower, upper)
    ]
    return replace(
        judged,
        median=_order_interval(logarithms),
        spread=_spread(judged.units, float(logarithms.var(ddof=1)), logarithms.size - 1),
        prediction=(math.exp(lowest), math.exp(highest)),
        quantile=min(bound(0.5), bound(judged.confidence)),
        tolerance=bound(judged.confidence),
        findings=(Finding("warning", "two-groups", text, advice),),
        groups=(smaller, larger),
        next_units=tuple(laws),
    )


def _order_interval(logarithms: FloatArray) -> Interval:
    """Return the median with limits that hold for any distribution: order statistics.

    Source: David & Nagaraja (2003), Order Statistics, section 7.1.
    """
    from scipy.stats import binom

    ordered = np.exp(np.sort(logarithms))
    rank = max(int(binom.ppf((1 - _LEVEL) / 2, ordered.size, 0.5)), 1)
    low, high = float(ordered[rank - 1]), float(ordered[ordered.size - rank])
    return Interval(value=float(np.median(ordered)), low=low, high=high)


def _spread(units: Sequence[UnitValue], variance: float, dof: int) -> Interval:
    """Return the spread between units: the variance of the units minus that of their errors."""
    known = [_log_error(unit.value, unit.low, unit.high) for unit in units if unit.value is not None]
    return _without_errors(variance, dof, float(np.mean(np.square(known))))


def _without_errors(variance: float, dof: int, error: float) -> Interval:
    """Return the root of a variance, minus that of errors, with its chi-square interval."""
    low, high = (dof * variance / float(chdtri(dof, tail)) for tail in ((1 - _LEVEL) / 2, (1 + _LEVEL) / 2))
    value, low, high = (math.sqrt(max(part - error, 0.0)) for part in (variance, low, high))
    return Interval(value=value, low=low, high=high)


@dataclass(frozen=True, kw_only=True)
class _Scatter:
    """The sum of squared deviations of the logarithms of a unit's logs, and its mean by their errors alone.

    `dof` are the degrees of freedom; logs that hardly show the coefficient are left out.
    """

    squares: float
    error: float
    dof: int

    @property
    def interval(self) -> Interval | None:
        """The deviation between logs of a unit; None without degrees of freedom."""
        if not self.dof:
            return None
        return _without_errors(self.squares / self.dof, self.dof, self.error / self.dof)


def _sum_of(scatters: Collection[_Scatter]) -> _Scatter:
    return _Scatter(
        squares=sum(one.squares for one in scatters),
        error=sum(one.error for one in scatters),
        dof=sum(one.dof for one in scatters),
    )


def _scatter_of(logs: Sequence[LogValue]) -> _Scatter:
    squares = np.array([log.square for log in logs])
    deviations = np.array([log.square_deviation(max(log.square, 0.0)) for log in logs])
    sure = squares > _SURE * deviations
    count = int(sure.sum())
    if count < 2:
        return _Scatter(squares=0.0, error=0.0, dof=0)
    logarithms = np.log(squares[sure]) / 2
    errors = deviations[sure] / squares[sure] / 2
    return _Scatter(
        squares=float(np.sum((logarithms - logarithms.mean()) ** 2)),
        error=(count - 1) / count * float(np.sum(errors**2)),
        dof=count - 1,
    )


def _p_of_logs(logs: Sequence[LogValue], own: _Scatter, whole: _Scatter) -> float:
    """Return the probability that the logs of a unit like the others differ as much.

    The scatter of all logs minus that of the unit is the reference (F test), but at least the errors of the
    unit's logs. If few other units have several logs, the errors alone are the reference: a test of one
    coefficient in all logs (Cochran 1954).
    """
    others = whole.dof - own.dof
    if own.dof and others >= _MIN_OTHERS:
        reference = max((whole.squares - own.squares) / others, own.error / own.dof)
        return float(fdtrc(own.dof, others, own.squares / own.dof / reference)) if reference > 0 else 1.0
    squares = np.array([log.square for log in logs])
    # All deviations at one square: at its own, a large estimate would get less weight.
    common = max(float(squares.mean()), 0.0)
    weights = np.array([log.square_deviation(common) for log in logs]) ** -2.0
    statistic = float(np.sum(weights * (squares - np.average(squares, weights=weights)) ** 2))
    return float(chdtrc(len(logs) - 1, statistic))


def _unit_squares(by_unit: Mapping[str, Sequence[LogValue]], typical: float) -> tuple[FloatArray, FloatArray]:
    """Return the mean square of each unit and its error, shape (units,) each."""
    means = []
    for logs in by_unit.values():
        if len(logs) > 1:
            square, error, ratio = _mean_square(logs, typical, 0.0)
            means.append((square, error * ratio))
        else:
            means.append((logs[0].square, logs[0].square_deviation(typical)))
    return np.array([square for square, _ in means]), np.array([error for _, error in means])


def _bounded(judged: Population, squares: FloatArray, errors: FloatArray, share: float) -> Population:
    """Return the bounds of a population whose units mostly bound the coefficient: of the mean square."""
    n = squares.size
    # Equal units scatter by their errors alone.
    error = math.sqrt(max(float(squares.var(ddof=1)), float(np.mean(errors**2))) / n)
    mean = max(float(squares.mean()), 0.0)

    def root_mean_square(probability: float) -> float:
        return math.sqrt(mean + max(float(stdtrit(n - 1, probability)), 0.0) * error)

    def bound(content: float, probability: float) -> float:
        return root_mean_square(probability) * math.exp(max(float(ndtri(content)), 0.0) ** 2 / 4)

    known = max((unit.high for unit in judged.units if unit.value is not None), default=0.0)
    tolerance = max(bound(judged.content, judged.confidence), known)
    median = root_mean_square((1 + _LEVEL) / 2)
    return replace(
        judged,
        median=Interval(value=median, low=0.0, high=median),
        bounded=True,
        prediction=(0.0, max(bound(_LEVEL, _LEVEL), known)),
        quantile=tolerance,
        tolerance=tolerance,
        findings=(Finding("info", "weak-term", _MOSTLY_BOUNDED.format(100 * share)),),
    )
