"""The population of a fleet's units: the coefficient of a sensor model.

The unit means are the data (`imucal.fleet.unit_means`). A unit is odd if it differs from the others by
Student's t, with Holm's correction for the number of units.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy

from imucal.arguments import takes
from imucal.errors import ArgumentError
from imucal.findings import Finding
from imucal.fitting.homogeneity import holm
from imucal.fitting.noise_fit import Interval
from imucal.fleet.mean_square import MeanSquare
from imucal.fleet.unit_means import UnitMeans
from imucal.fleet.unit_squares import Scale, UnitSquares, with_squares
from imucal.fleet.values import TWO_SIDED, LogValue, LogValues
from imucal.frozen import frozen

#: Smallest number of units that determines a spread.
FEWEST = 3
#: Probability of a false alarm among the units of a term.
FALSE_ALARM = 0.05
#: Share of bounds in per cent above which a finding is reported.
_MOSTLY = 50.0
#: Probability that the next unit is in its interval.
_CONTENT = 0.95
_MOSTLY_BOUNDED = "{:.0f} % of the logs only bound this term: longer logs would help more than more units."
_ALL_BOUNDED = (
    "All logs together do not show this term: every number is an upper bound, and the spread between units "
    "is unknown. Longer logs would help more than more units."
)
_TOO_FEW = (
    f"{{}}: the spread between units, the next unit and a tolerance bound need at least {FEWEST}; test about "
    "10."
)


@frozen
class UnitValue:
    """One unit of a fleet: its coefficient from all of its logs, None if they only bound it.

    `p_value` is the probability of this difference from the others by chance, None if it was not tested.
    `p_odd` is adjusted for the number of units; the unit is `odd` if it is small.
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
class NextLog:
    """The distribution of a log of a new unit in the logarithm: Student's t.

    `centre`, `scale` and `dof` are its parameters; `scale` includes a log of the error variance `known`.
    `within` is the scatter between logs of one unit. If the fleet only bounds the coefficient, `highest` is
    the upper bound of the next unit, and the other fields are not used.
    """

    centre: float = 0.0
    scale: float = 0.0
    dof: int = 0
    known: float = 0.0
    within: float = 0.0
    floor: float = 1.0
    highest: float | None = None

    def p_value(self, new: LogValues) -> float:
        """Return the two-sided probability of a log that differs as much; one-sided for a bound."""
        if self.highest is not None:
            return float(1 - new.squares.below(np.array([self.highest**2]))[0, 0])
        scale = Scale(self.floor)
        unit = UnitSquares(with_squares(new), scale.square(self.centre), self.within)
        (centre,), (error,) = unit.on(scale)
        sd = math.sqrt(self.scale**2 + max(error**2 - self.known, 0.0))
        return float(2 * scipy.special.stdtr(self.dof, -abs(centre - self.centre) / sd))


@frozen
class Population:
    """The coefficient of the units of one sensor model.

    `units` are in the order of their first log; `logs` is the number of logs. `median` is the coefficient of
    the median unit, with its 95 % interval. It is `bounded` if all logs together do not show the term: its
    interval then begins at 0, value and high are its upper limit, and the spreads are unknown.

    `spread` is the standard deviation between units, in the logarithm (0.1: 10 %), None below three units.
    `within` is the standard deviation between logs of one unit, None if no unit has two. `prediction` is the
    interval that contains the next unit with a probability of 0.95, and `next_log` the distribution of its
    log; None below three units.

    A share `content` of all units is below `quantile` by the best estimate, and below `tolerance` with the
    probability `confidence`: the number for the config of every unit. `findings` describe weak terms and
    fleets of few units.
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
        """The coefficient of the median unit; None if the logs only bound it."""
        return None if self.bounded else self.median.value


@takes("imucal.population(values)", logs=[LogValue])
def population(logs: Sequence[LogValue], *, content: float = 0.95, confidence: float = 0.95) -> Population:
    """Return the statistics of a coefficient over the units of a fleet, from any number of logs per unit.

    A share `content` of all units is below the tolerance bound with the probability `confidence`. Raises
    ValueError if there is no log, or a probability is not between 0 and 1.
    """
    if not logs:
        raise ArgumentError("a population needs at least one log")
    if not (0 < content < 1 and 0 < confidence < 1):
        raise ArgumentError(f"content and confidence must be between 0 and 1, got {content} and {confidence}")
    values = LogValues.of(logs)
    result = partial(Population, logs=len(logs), content=content, confidence=confidence)
    if len(values.names) < FEWEST:
        return _few_units(values, result)
    square = MeanSquare(values)
    means = UnitMeans(values) if square.shows else None
    if means is None or not means.interval(0.95).value:
        return _bounded(values, square, result)
    next_unit = means.interval(_CONTENT, ahead=True)
    share = 100 * float(np.mean(values.bounded))
    tolerance = means.tolerance(content, confidence)
    return result(
        units=_tested(values, means),
        median=means.interval(0.95),
        spread=means.spread,
        within=means.within,
        prediction=(next_unit.low, next_unit.high),
        quantile=min(means.quantile(content), tolerance),
        tolerance=tolerance,
        findings=(Finding("info", "weak-term", _MOSTLY_BOUNDED.format(share)),) if share > _MOSTLY else (),
        next_log=NextLog(
            centre=means.mean,
            scale=means.sd * math.sqrt(1 + 1 / len(values.names)),
            dof=means.dof,
            known=means.known,
            within=means.within.value if means.within else 0.0,
            floor=means.scale.floor,
        ),
    )


def membership(found: Population, new: LogValue) -> float:
    """Return the probability that a unit of the fleet `found` gives a log that differs as a `new` one does.

    It includes the spread between units, the scatter between logs of a unit, and the error of the new log. A
    fleet of fewer than three units is a `ValueError`.
    """
    if found.next_log is None:
        raise ArgumentError(f"a spread between units needs at least {FEWEST} units, got {len(found.units)}")
    return found.next_log.p_value(LogValues.of([new]))


def _few_units(values: LogValues, result: "partial[Population]") -> Population:
    """Return one or two units, which do not determine a spread."""
    units = _units(values, 0.0)
    known = [unit.value for unit in units if unit.value is not None]
    low, high = min(unit.low for unit in units), max(unit.high for unit in units)
    middle = math.exp(sum(map(math.log, known)) / len(known)) if known else high
    number = f"{len(units)} unit{'s' * (len(units) > 1)}"
    return result(
        units=units,
        median=Interval(value=middle, low=low, high=high),
        bounded=not known,
        findings=(Finding("info", "few-units", _TOO_FEW.format(number)),),
    )


def _bounded(values: LogValues, square: MeanSquare, result: "partial[Population]") -> Population:
    """Return the upper bounds of a coefficient that all logs together do not show."""
    content, confidence = result.keywords["content"], result.keywords["confidence"]
    highest, median = square.share_bound(content, confidence), square.bound(0.975)
    next_unit = square.share_bound(_CONTENT, _CONTENT)
    return result(
        units=_units(values, 0.0),
        median=Interval(value=median, low=0.0, high=median),
        bounded=True,
        prediction=(0.0, next_unit),
        quantile=min(square.share_bound(content, 0.5), highest),
        tolerance=highest,
        findings=(Finding("info", "weak-term", _ALL_BOUNDED),),
        next_log=NextLog(highest=next_unit),
    )


def _units(values: LogValues, within: float) -> tuple[UnitValue, ...]:
    """Return each unit by itself, with a scatter `within` between its logs."""
    counts = np.bincount(values.unit)
    strong = np.bincount(values.unit, ~values.narrow) == 0
    # Strong units in the logarithm.
    weight = 1 / (np.where(values.narrow, values.deviation, 1.0) ** 2 + within**2)
    total = np.bincount(values.unit, weight)
    centre, error = np.bincount(values.unit, weight * values.centre) / total, TWO_SIDED / np.sqrt(total)
    # Weak units by their mean squares.
    square = values.squares.mean_by(values.unit, math.exp(2 * values.middle))
    estimate = np.maximum(square.estimate, 0.0)
    reach = TWO_SIDED * np.hypot(square.deviation(estimate), 2 * estimate * within / np.sqrt(counts))
    shown = strong | (square.estimate > reach)
    value = np.where(strong, np.exp(centre), np.sqrt(estimate))
    low = np.where(strong, np.exp(centre - error), np.sqrt(np.maximum(estimate - reach, 0.0)))
    high = np.where(strong, np.exp(centre + error), np.sqrt(estimate + reach))
    columns = (part.tolist() for part in (counts, shown, value, low, high))
    return tuple(
        UnitValue(unit=name, logs=logs, value=v if known else None, low=lo if known else 0.0, high=hi)
        for name, logs, known, v, lo, hi in zip(values.names, *columns, strict=True)
    )


def _tested(values: LogValues, means: UnitMeans) -> tuple[UnitValue, ...]:
    """Return each unit with the test of its difference from the others."""
    units = _units(values, means.within.value if means.within else 0.0)
    p_values = means.p_values().tolist()
    tested = zip(units, p_values, holm(p_values), strict=True)
    return tuple(replace(unit, p_value=p, p_odd=odd, odd=odd <= FALSE_ALARM) for unit, p, odd in tested)
