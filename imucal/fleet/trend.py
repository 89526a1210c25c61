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
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.fitting.noise_fit import Interval
from imucal.fleet.population import FALSE_SHARE, adjusted, leave_one_out, oddest_by_others
from imucal.fleet.posterior import TAILS, interval_of, support, two_sided
from imucal.fleet.values import LogValue, LogValues
from imucal.frozen import frozen

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


@frozen
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


@frozen
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
        return {mean.label: mean.slope for mean in self.means}.get("temperature_c")

    @property
    def drift(self) -> Interval | None:
        """Mean change of the logarithm a year; None where no unit has logs of two days."""
        return {mean.label: mean.slope for mean in self.means}.get("days")


def trend(logs: Sequence[LogValue]) -> Trend:
    """Return drift and temperature coefficient of a fleet.

    Only logs with a label are used, and only units with at least two temperatures, or two days. A weak log
    counts by the estimate of its squared coefficient, linear about the fleet's; without one, a log that only
    bounds the coefficient is left out. It is a DataError if no unit has logs at two temperatures or of two
    days, if the two always move together, or if the logs do not show the term.
    """
    labelled, labels = labelled_logs(logs)
    posterior = SlopePosterior(labelled)
    means, slopes = list[Slope](), list[Slope]()
    for place, label in enumerate(labels):
        units: list[int] = np.unique(labelled.unit[labelled.labels[:, place] != 0]).tolist()
        sd = np.sqrt(posterior.covariance[None, :, place, place])
        mean = Normals(posterior.mean[None, :, place], sd, posterior.weight)
        own = posterior.own_slopes(labelled, place, units)
        names = ("", *(labelled.names[unit] for unit in units))
        limits = map(interval_of, (*mean.limits(), *own.limits()))
        p_values = (*mean.two_sided(), *_p_values(labelled, posterior, place, own, units))
        rows = zip(names, limits, map(float, p_values), strict=True)
        found = [Slope(unit=name, label=label, slope=slope, p_value=p) for name, slope, p in rows]
        means.append(found[0])
        slopes += found[1:]
    return adjust([Trend(means=tuple(means), slopes=tuple(slopes), units=len(labelled.names))])[0]


def adjust(trends: Sequence[Trend]) -> tuple[Trend, ...]:
    """Return trends that were looked at together, with what is odd among all of their units and labels.

    The means of the fleet are one family of tests, the units of it another.
    """

    def judged(parts: Sequence[Sequence[Slope]]) -> Iterator[tuple[Slope, ...]]:
        p_values = iter(adjusted([slope.p_value for part in parts for slope in part]))
        for part in parts:
            chances = [(slope, next(p_values)) for slope in part]
            yield tuple(replace(slope, p_odd=p, odd=p <= FALSE_SHARE) for slope, p in chances)

    means, slopes = judged([one.means for one in trends]), judged([one.slopes for one in trends])
    return tuple(replace(one, means=m, slopes=s) for one, m, s in zip(trends, means, slopes, strict=True))


def _p_values(
    logs: LogValues, posterior: "SlopePosterior", place: int, own: "Normals", units: Sequence[int]
) -> FloatArray:
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
        alone = SlopePosterior(others).beyond(logs.take(logs.unit == units[i]), place)
        return float(alone.two_sided()[0])

    return oddest_by_others(quick, _SUSPECT, by_others)


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
        advice = "label the logs with temperature_c or started, at least two different values per unit"
        raise DataError(f"no unit has logs at two temperatures or on two days: {advice}")
    keep, tells = np.concatenate(rows), np.any(told, axis=0)
    x = told[keep][:, tells] / np.array(_SCALE)[tells]
    if np.linalg.matrix_rank(x / np.linalg.norm(x, axis=0), tol=_SAME) < x.shape[1]:
        said = "temperature and time changed together in every unit, so their effects can't be separated"
        raise DataError(f"{said}: record a unit at another temperature on the same day")
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
    squares, at = values.squares, math.exp(2 * values.middle)
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
        msg = "the logs only bound this term, so they do not show whether it changes: record longer logs"
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

    def two_sided(self) -> FloatArray:
        """Return the chance that each number lies beyond zero, from where most of it is, on either side."""
        return two_sided(scipy.special.ndtr(self.mean / self.sd) @ self.weight)

    def limits(self) -> FloatArray:
        """Return the 95 % interval of each number about its median, shape (numbers, 3), by bisection."""
        keep = self.weight > _LITTLE * self.weight.max()
        mean, sd = self.mean[:, None, keep], self.sd[:, None, keep]
        weight = self.weight[keep] / self.weight[keep].sum()
        low, high = np.min(mean - 9 * sd, axis=-1), np.max(mean + 9 * sd, axis=-1)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2 + np.zeros(len(TAILS))
            below = scipy.special.ndtr((middle[..., None] - mean) / sd) @ weight < TAILS
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        result: FloatArray = (low + high) / 2
        return result


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
            rows = (np.moveaxis(height, axis, 0).reshape(grid.size, -1) for axis, grid in enumerate(grids))
            found = [*map(support, grids, (np.max(row, axis=1) > -_OUTSIDE for row in rows))]
            if np.all(2 * np.diff(found) >= np.diff(ranges)):
                break
            ranges = found
        keep = height > -_NOTHING
        self.omega, *tau = (np.broadcast_to(grid, height.shape)[keep] for grid in np.ix_(omegas, *taus))
        self.tau = np.column_stack(tau)
        self.weight: FloatArray = np.exp(height[keep]) / np.exp(height[keep]).sum()
        self.mean, self.covariance = mean[keep], covariance[keep]

    def own_slopes(self, logs: LogValues, label: int, units: Sequence[int]) -> Normals:
        """Return the slopes of some units by their own logs; of other labels, each moves as others do."""
        others = self.tau * (np.arange(self.tau.shape[1]) != label)
        information, score, _ = spread(*unit_sums(logs, self.omega), others.T)
        own = information[:, units, label, label]
        rest = self._beyond(information, score, label)[:, units] / own
        return Normals((self.mean[:, None, label] + rest).T, 1 / np.sqrt(own).T, self.weight)

    def beyond(self, unit: LogValues, label: int) -> Normals:
        """Return how far a unit that this posterior has not seen lies beyond what it expects, as a score."""
        information, score, _ = spread(*unit_sums(unit, self.omega), self.tau.T)
        own = information[..., label]
        error = np.einsum("pui,pij,puj->pu", own, self.covariance, own)
        sd = np.sqrt(own[..., label] + error).T
        return Normals(self._beyond(information, score, label).T, sd, self.weight)

    def _beyond(self, information: FloatArray, score: FloatArray, label: int) -> FloatArray:
        """Return the score of each unit's slope beyond the mean's, (points, units)."""
        expected: FloatArray = np.einsum("puj,pj->pu", information[..., label], self.mean)
        return score[..., label] - expected


def unit_sums(logs: LogValues, omega: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what each unit tells of its slopes, its level integrated out, for scatters of any shape.

    Information, shape (…, units, labels, labels), score, (…, units, labels), and the log-likelihood at slopes
    of zero, (…, units).
    """
    starts = np.flatnonzero(np.diff(logs.unit, prepend=-1))
    w = 1 / (logs.deviation**2 + omega[..., None] ** 2)
    total = partial(np.add.reduceat, indices=starts, axis=omega.ndim)
    whole = total(w)
    x = logs.labels - (total(w[..., None] * logs.labels) / whole[..., None])[..., logs.unit, :]
    y = logs.centre - (total(w * logs.centre) / whole)[..., logs.unit]
    information = total(w[..., None, None] * x[..., None] * x[..., None, :])
    height = -0.5 * (total(w * y * y - np.log(w)) + np.log(whole))
    return information, total((w * y)[..., None] * x), height


def spread(
    information: FloatArray, score: FloatArray, height: FloatArray, taus: Iterable[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return `unit_sums` with slopes that differ between units by `taus`, one for each label."""
    for label, tau in enumerate(taus):
        if tau.any():
            t2, column, own = tau[..., None] ** 2, information[..., label], score[..., label]
            scale = 1 + t2 * column[..., label]
            gain = t2 / scale
            part = gain[..., None] * column
            height = height + 0.5 * (gain * own**2 - np.log(scale))
            score = score - own[..., None] * part
            information = information - part[..., None] * column[..., None, :]
    return information, score, height


def _at_scatter(
    logs: LogValues, omega: float, spreads: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean slopes, their covariance and the logarithm of the posterior, over a grid of spreads.

    The prior is Jeffreys' of omega and of each spread, for a measure that is flat in their logarithms.
    """
    taus, sums = np.ix_(*spreads), unit_sums(logs, np.full((1,) * len(spreads), omega))
    own = np.diagonal(sums[0], axis1=-2, axis2=-1)
    prior = 2 * math.log(omega) + 0.5 * math.log(np.sum((logs.deviation**2 + omega**2) ** -2.0))
    for tau, errors in zip(taus, np.moveaxis(own, -1, 0), strict=True):
        if tau.any():
            told = np.sum((errors / (1 + tau[..., None] ** 2 * errors)) ** 2, axis=-1)
            prior = prior + np.log(tau**2 * np.sqrt(told))
    information, score, height = spread(*sums, taus)
    covariance = np.linalg.inv(information.sum(axis=-3))
    total = score.sum(axis=-2)
    mean = np.einsum("...ij,...j->...i", covariance, total)
    fit = height.sum(axis=-1) + 0.5 * np.einsum("...i,...i->...", total, mean)
    return mean, covariance, prior + fit + 0.5 * np.linalg.slogdet(covariance)[1]


def _ranges(logs: LogValues) -> list[tuple[float, float]]:
    """Return the ranges of the logarithms of omega and the spreads; of no width where there is no telling."""
    own = np.diagonal(unit_sums(logs, np.zeros(()))[0], axis1=-2, axis2=-1)
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
