"""Drift and temperature of a coefficient over a fleet: per cent a °C and per cent a year.

In the logarithm, a log of unit u has ``a_u + x'(beta + b_u) + omega c``, known to a standard error: each unit
has a level and slopes of its own over the labels x. The slopes lie about their mean beta with a spread tau of
each label. The level and beta are flat and integrated out; omega and the spreads, of which few logs tell
little, are summed over on a grid. What is said to move, is said with 5 % of false alarms over all units,
labels and terms that were looked at.

Laird & Ware (1982), Biometrics 38, p. 963, give the model; Harville (1974), Biometrika 61, p. 383, the
likelihood that is left when what is flat is integrated out; Tiao & Tan (1965), Biometrika 52, p. 37, the
prior of a spread.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress, islice

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.fitting.noise_fit import Interval
from imucal.fleet.population import FALSE_SHARE, adjusted, leave_one_out, oddest_by_others
from imucal.fleet.posterior import TAILS, interval_of, place_of, support, two_sided
from imucal.fleet.values import LogValue, LogValues

#: Label -> what it must vary by within a unit to tell a slope.
NEAREST = {"temperature_c": 1.0, "days": 0.5}
#: How many of each label its slope is for: a °C, a year.
_SCALE = (1.0, 365.25)
#: A term whose mean square is not so many deviations above zero has no slope that could be told.
_TOLD = 3.0
#: A square is linear in the logarithm up to this error of the coefficient.
_NARROW = 0.1
#: Temperature and time of which so little, relative to themselves, is not shared, are one.
_SAME = 1e-6
#: Grid points of omega and of each spread; the grid is narrowed so many times at most.
_POINTS, _ROUNDS = 10, 4
#: What lies so far below the posterior's peak, in the logarithm, is out of its support; and weighs nothing.
_OUTSIDE, _NOTHING = 10.0, 8.0
#: A scatter or spread of this share of the errors is none.
_NONE = 0.05
#: Halvings that find a quantile; points of less weight than this, of the greatest, say nothing of it.
_HALVINGS, _LITTLE = 40, 1e-3
#: The chance of a slope at a quick look up to which its unit is judged by the others alone.
_SUSPECT = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope:
    """How a coefficient moves by one label, of the fleet or of one unit of it.

    `unit` is empty for the mean of the fleet; `label` is ``temperature_c`` or ``days``; `slope` is the change
    of the natural logarithm a °C, or a year, with its 95 % interval. `p_value` is the chance of such a slope
    where the fleet has none, or the unit moves as the others do; `p_odd` is adjusted for all that were looked
    at (Benjamini and Hochberg), and `odd` says that it is not chance.
    """

    unit: str
    label: str
    slope: Interval
    p_value: float
    p_odd: float = 1.0
    odd: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """How a coefficient moves with temperature and time.

    `means` are of the fleet, `slopes` of the units that tell one, for each label that tells a slope; `units`
    is how many units they are from.
    """

    means: tuple[Slope, ...]
    slopes: tuple[Slope, ...]
    units: int

    @property
    def temperature(self) -> Interval | None:
        """Mean change of the logarithm a °C; None where fewer than two temperatures of a unit are known."""
        return self._mean("temperature_c")

    @property
    def drift(self) -> Interval | None:
        """Mean change of the logarithm a year; None where no unit has logs of two days."""
        return self._mean("days")

    def _mean(self, label: str) -> Interval | None:
        return next((mean.slope for mean in self.means if mean.label == label), None)


def trend(logs: Sequence[LogValue]) -> Trend:
    """Return drift and temperature coefficient of a fleet.

    Only logs with a label are used, and only units with at least two temperatures, or two days. A weak log
    counts by the estimate of its squared coefficient, linear about the fleet's; without one, a log that only
    bounds the coefficient is left out.

    Raises
    ------
    DataError
        If no unit has logs at two temperatures or of two days, if the two always move together, or if the
        logs do not show the term.
    """
    labelled, labels = labelled_logs(logs)
    posterior = SlopePosterior(labelled)
    means: list[Slope] = []
    slopes: list[Slope] = []
    for place, label in enumerate(labels):
        units: list[int] = np.unique(labelled.unit[labelled.labels[:, place] != 0]).tolist()
        mean, own = posterior.mean_slope(place), posterior.own_slopes(labelled, place, units)
        names = ("", *(labelled.names[unit] for unit in units))
        limits = (*mean.limits(), *own.limits())
        p_values = (*mean.two_sided(), *_p_values(labelled, posterior, place, own, units))
        found = [
            Slope(unit=name, label=label, slope=interval_of(limit), p_value=p)
            for name, limit, p in zip(names, limits, p_values, strict=True)
        ]
        means.append(found[0])
        slopes += found[1:]
    return adjust([Trend(means=tuple(means), slopes=tuple(slopes), units=len(labelled.names))])[0]


def adjust(trends: Sequence[Trend]) -> tuple[Trend, ...]:
    """Return trends that were looked at together, with what is odd among all of their units and labels.

    The means of the fleet are one family of tests, the units of it another.
    """

    def judged(slopes: Sequence[Slope]) -> Iterator[Slope]:
        p_values = adjusted(np.array([slope.p_value for slope in slopes])).tolist()
        for slope, p in zip(slopes, p_values, strict=True):
            yield replace(slope, p_odd=p, odd=p <= FALSE_SHARE)

    means = judged([mean for one in trends for mean in one.means])
    slopes = judged([slope for one in trends for slope in one.slopes])
    return tuple(
        replace(
            one, means=tuple(islice(means, len(one.means))), slopes=tuple(islice(slopes, len(one.slopes)))
        )
        for one in trends
    )


def _p_values(
    logs: LogValues, posterior: "SlopePosterior", place: int, own: "Normals", units: Sequence[int]
) -> list[float]:
    """Return how probable the slope of each unit is: the oddest in the posterior of the others.

    That allows for how badly the scatter and the spread of slopes are known.
    """
    weight = posterior.weight
    mean, error = own.mean @ weight, np.sqrt(own.sd**2 @ weight)
    quick = leave_one_out(mean, error, float(weight @ posterior.tau[:, place]))

    def by_others(i: int) -> float:
        others = logs.take(logs.unit != units[i])
        if not np.any(others.labels, axis=0).all():
            # What only this unit shows, the others can't tell from its slope.
            return 1.0
        return SlopePosterior(others).beyond(logs.take(logs.unit == units[i]), place).two_sided()[0]

    p_values: list[float] = oddest_by_others(quick, _SUSPECT, by_others).tolist()
    return p_values


def labelled_logs(logs: Sequence[LogValue]) -> tuple[LogValues, tuple[str, ...]]:
    """Return the logs of units that tell a slope, and its labels; raise what `trend` raises.

    The logs are sorted by unit, their labels are about their means in it: 0 where they vary too little in it.
    """
    values = _linear(LogValues.of(logs))
    rows: list[IntArray] = []
    told = np.zeros_like(values.labels)
    for unit in range(len(values.names)):
        own = np.flatnonzero((values.unit == unit) & np.isfinite(values.deviation))
        varies = _varying(values.labels[own])
        own = own[np.isfinite(values.labels[own][:, varies]).all(axis=1)]
        varies &= _varying(values.labels[own])
        if varies.any():
            place = np.ix_(own, varies)
            told[place] = values.labels[place] - values.labels[place].mean(axis=0)
            rows.append(own)
    if not rows:
        msg = (
            "no unit has logs at two temperatures or of two days: label the logs with temperature_c or "
            "started, two different ones a unit at least"
        )
        raise DataError(msg)
    keep, tells = np.concatenate(rows), np.any(told, axis=0)
    x = told[keep][:, tells] / np.array(_SCALE)[tells]
    if np.linalg.matrix_rank(x / np.linalg.norm(x, axis=0), tol=_SAME) < x.shape[1]:
        msg = (
            "temperature and time moved together in every unit, so that neither's effect can be told: "
            "record a unit at another temperature on the same day"
        )
        raise DataError(msg)
    return replace(values.take(keep), labels=x), tuple(compress(NEAREST, tells.tolist()))


def _varying(labels: FloatArray) -> BoolArray:
    """Return which labels, shape (logs, labels), vary by enough over the logs that have them."""
    greatest, least = (of.reduce(labels, axis=0, initial=math.nan) for of in (np.fmax, np.fmin))
    result: BoolArray = greatest - least > [*NEAREST.values()]
    return result


def _linear(values: LogValues) -> LogValues:
    """Return logs that are normal in the logarithm; of infinite deviation where there is none to use.

    A weak log's square may be negative: it is taken as linear about the fleet's mean square.
    """
    squares, at = values.squares, math.exp(2 * place_of(values).centre)
    # What most logs of the fleet are like decides, or high draws would count otherwise than low ones.
    told = values.narrow & ((squares.deviation(at) <= 2 * _NARROW * at) | (values.deviation <= _NARROW / 2))
    weak = ~told & values.weighed
    if not weak.any():
        return values
    square = np.where(weak, squares.estimate, np.exp(2 * values.centre))
    error = np.where(weak, squares.deviation(at), 2 * square * values.deviation)
    weight = np.where(np.isfinite(error), 1 / (error**2 + np.median(error) ** 2), 0.0)
    weight /= weight.sum()
    mean = float(weight @ square)
    if mean < _TOLD * float(np.linalg.norm(weight * np.where(weight > 0, error, 0.0))):
        msg = "the logs only bound this term, and so tell nothing of what moves it: record longer logs"
        raise DataError(msg)
    return replace(
        values,
        centre=np.where(weak, 0.5 * math.log(mean) + (square / mean - 1) / 2, values.centre),
        deviation=np.where(weak, squares.deviation(mean) / (2 * mean), values.deviation),
    )


@dataclass(frozen=True, slots=True)
class Normals:
    """Numbers that are normal at each point of a posterior's grid.

    `mean` and `sd` have the shape (numbers, points); `weight`, shape (points,), adds up to one.
    """

    mean: FloatArray
    sd: FloatArray
    weight: FloatArray

    def two_sided(self) -> list[float]:
        """Return the chance that each number lies beyond zero, from where most of it is, on either side."""
        from scipy.special import ndtr

        chance: list[float] = two_sided(ndtr(self.mean / self.sd) @ self.weight).tolist()
        return chance

    def limits(self) -> FloatArray:
        """Return the 95 % interval of each number about its median, shape (numbers, 3), by bisection."""
        from scipy.special import ndtr

        keep = self.weight > _LITTLE * self.weight.max()
        mean, sd = self.mean[:, None, keep], self.sd[:, None, keep]
        weight = self.weight[keep] / self.weight[keep].sum()
        low, high = np.min(mean - 9 * sd, axis=-1), np.max(mean + 9 * sd, axis=-1)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2 + np.zeros(len(TAILS))
            below = ndtr((middle[..., None] - mean) / sd) @ weight < TAILS
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        result: FloatArray = (low + high) / 2
        return result


@dataclass(frozen=True, slots=True)
class Sums:
    """What the logs of a unit tell of its slopes, its level integrated out.

    `information` has the shape (…, labels, labels), `score` (…, labels), and `height`, the log-likelihood at
    slopes of zero, (…,).
    """

    information: FloatArray
    score: FloatArray
    height: FloatArray

    def spread(self, label: int, tau: FloatArray) -> "Sums":
        """Return the same with slopes that differ between units by `tau`, broadcast against `height`."""
        column, own = self.information[..., label], self.score[..., label]
        scale = 1 + tau**2 * column[..., label]
        gain = tau**2 / scale
        return Sums(
            self.information - (gain[..., None] * column)[..., None] * column[..., None, :],
            self.score - (gain * own)[..., None] * column,
            self.height + 0.5 * gain * own**2 - 0.5 * np.log(scale),
        )


class SlopePosterior:
    """Points of the posterior of scatter and spreads, on a grid that was narrowed until it fits its support.

    Of shapes (points,) and (points, labels) are `omega` and `tau`, of (points,) their `weight`, which adds up
    to one; of (points, labels) and (points, labels, labels) `mean` and `covariance` of the mean slopes there.
    """

    def __init__(self, logs: LogValues) -> None:
        ranges = _ranges(logs)
        for _ in range(_ROUNDS):
            grids = [np.linspace(low, high, _POINTS if high > low else 1) for low, high in ranges]
            omegas, *taus = (np.exp(grid) if grid.size > 1 else np.zeros(1) for grid in grids)
            slices = [_at_scatter(logs, omega, taus) for omega in omegas.tolist()]
            mean, covariance, height = (np.array(part) for part in zip(*slices, strict=True))
            height -= height.max()
            axes = range(height.ndim)
            found = [
                support(grid, np.max(height, axis=tuple(i for i in axes if i != axis)) > -_OUTSIDE)
                for axis, grid in enumerate(grids)
            ]
            if np.all(2 * np.diff(found) >= np.diff(ranges)):
                break
            ranges = found
        keep = height > -_NOTHING
        self.omega, *tau = (np.broadcast_to(grid, height.shape)[keep] for grid in np.ix_(omegas, *taus))
        self.tau = np.column_stack(tau)
        self.weight: FloatArray = np.exp(height[keep]) / np.exp(height[keep]).sum()
        self.mean, self.covariance = mean[keep], covariance[keep]

    def mean_slope(self, label: int) -> Normals:
        """Return the mean slope of a label."""
        sd = np.sqrt(self.covariance[None, :, label, label])
        return Normals(self.mean[None, :, label], sd, self.weight)

    def own_slopes(self, logs: LogValues, label: int, units: Sequence[int]) -> Normals:
        """Return the slopes of some units by their own logs; of other labels, each moves as others do."""
        sums = self._of(logs, leave=label)
        information = sums.information[:, units, label, label]
        rest = self._beyond(sums, label)[:, units] / information
        return Normals((self.mean[:, None, label] + rest).T, 1 / np.sqrt(information).T, self.weight)

    def beyond(self, unit: LogValues, label: int) -> Normals:
        """Return how far a unit that this posterior has not seen lies beyond what it expects, as a score."""
        sums = self._of(unit)
        information = sums.information[..., label]
        error = np.einsum("pui,pij,puj->pu", information, self.covariance, information)
        sd = np.sqrt(information[..., label] + error).T
        return Normals(self._beyond(sums, label).T, sd, self.weight)

    def _of(self, logs: LogValues, leave: int | None = None) -> Sums:
        """Return what each unit tells at each point, (points, units, …), with slopes of its own."""
        found = unit_sums(logs, self.omega)
        for label in range(self.tau.shape[1]):
            found = found if label == leave else found.spread(label, self.tau[:, label, None])
        return found

    def _beyond(self, sums: Sums, label: int) -> FloatArray:
        """Return the score of each unit's slope beyond the mean's, (points, units)."""
        expected = np.einsum("puj,pj->pu", sums.information[..., label], self.mean)
        result: FloatArray = sums.score[..., label] - expected
        return result


def unit_sums(logs: LogValues, omega: FloatArray) -> Sums:
    """Return what each unit tells of its slopes, for each scatter omega, of any shape; (*shape, units, …)."""
    starts = np.flatnonzero(np.diff(logs.unit, prepend=-1))
    w = 1 / (logs.deviation**2 + omega[..., None] ** 2)

    def total(values: FloatArray) -> FloatArray:
        result: FloatArray = np.add.reduceat(values, starts, axis=omega.ndim)
        return result

    whole = total(w)
    x = logs.labels - (total(w[..., None] * logs.labels) / whole[..., None])[..., logs.unit, :]
    y = logs.centre - (total(w * logs.centre) / whole)[..., logs.unit]
    return Sums(
        information=total(w[..., None, None] * x[..., None] * x[..., None, :]),
        score=total((w * y)[..., None] * x),
        height=-0.5 * (total(w * y * y - np.log(w)) + np.log(whole)),
    )


def _at_scatter(
    logs: LogValues, omega: float, spreads: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean slopes, their covariance and the logarithm of the posterior, over a grid of spreads.

    The prior is Jeffreys' of omega and of each spread, for a measure that is flat in their logarithms.
    """
    each = unit_sums(logs, np.full((1,) * len(spreads), omega))
    errors = np.diagonal(each.information, axis1=-2, axis2=-1)
    prior = 2 * math.log(omega) + 0.5 * math.log(np.sum((logs.deviation**2 + omega**2) ** -2.0))
    height = np.full((1,) * len(spreads), prior)
    for label, tau in enumerate(np.ix_(*spreads)):
        if tau.any():
            each = each.spread(label, tau[..., None])
            own = errors[..., label]
            told = np.sum((own / (1 + tau[..., None] ** 2 * own)) ** 2, axis=-1)
            height = height + np.log(tau**2 * np.sqrt(told))
    covariance = np.linalg.inv(each.information.sum(axis=-3))
    score = each.score.sum(axis=-2)
    mean = np.einsum("...ij,...j->...i", covariance, score)
    fit = each.height.sum(axis=-1) + 0.5 * np.einsum("...i,...i->...", score, mean)
    return mean, covariance, height + fit + 0.5 * np.linalg.slogdet(covariance)[1]


def _ranges(logs: LogValues) -> list[tuple[float, float]]:
    """Return the ranges of the logarithms of omega and the spreads; of no width where there is no telling."""
    own = np.diagonal(unit_sums(logs, np.zeros(())).information, axis1=-2, axis2=-1)
    known = float(np.sqrt(np.mean(logs.deviation**2)))
    means = np.bincount(logs.unit, logs.centre) / np.bincount(logs.unit)
    scatter = float(np.sqrt(np.mean((logs.centre - means[logs.unit]) ** 2)))
    ranges = [(math.log(_NONE * known), math.log(2 * known + 3 * scatter))]
    for x, information in zip(logs.labels.T, own.T, strict=True):
        if np.count_nonzero(information > 0) < 2:
            ranges.append((0.0, 0.0))
            continue
        error = 1 / math.sqrt(float(information.max()))
        slope = scatter / math.sqrt(float(np.mean(x**2)))
        ranges.append((math.log(_NONE * error), math.log(3 * error + 10 * slope)))
    return ranges
