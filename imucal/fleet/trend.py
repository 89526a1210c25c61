"""Drift and temperature of a coefficient over a fleet: per cent a °C and per cent a year.

In the logarithm, each unit has a level and slopes of its own; the slopes of the fleet are their means. What
is said to move, is said with 5 % of false alarms over all units, labels and terms that were looked at.

The logs that tell what temperature or time does: labels that vary within a unit, and logarithms.

Slopes of a coefficient over labels of its logs: a linear mixed model, its posterior summed on a grid.

In the logarithm, a log of unit u has ``a_u + x'(beta + b_u) + omega c``, known to a standard error: each unit
has a level and slopes of its own, the slopes about their mean beta with a spread tau of each label. The level
and beta are flat and integrated out; omega and the spreads, of which few logs tell little, are summed over.

Laird & Ware (1982), Biometrics 38, p. 963, give the model; Harville (1974), Biometrika 61, p. 383, the
likelihood that is left when what is flat is integrated out; Tiao & Tan (1965), Biometrika 52, p. 37, the
prior of a spread.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.fitting.noise_fit import Interval
from imucal.fleet.population import FALSE_SHARE, adjusted, leave_one_out, place_of
from imucal.fleet.values import LogValue, LogValues, Mixtures

#: Label -> what it must vary by within a unit to tell a slope.
NEAREST = {"temperature_c": 1.0, "days": 0.5}
#: A term whose mean square is not so many deviations above zero has no slope that could be told.
_TOLD = 3.0
#: A square is linear in the logarithm up to this error of the coefficient.
_NARROW = 0.1
#: Temperature and time of which so little, relative to themselves, is not shared, are one.
_SAME = 1e-6


@dataclass(frozen=True, slots=True)
class LabelledLogs:
    """Logs of units, sorted by unit.

    Attributes
    ----------
    columns
        The labels that vary in some unit, and what their columns of `x` were divided by.
    names
        Of the units.
    unit
        Index of each log's unit, ascending, shape (logs,).
    x
        Labels about their mean in the unit, shape (logs, labels); 0 where they vary too little in it.
    y, deviation
        Logarithm of the coefficient and its standard error, shape (logs,).
    """

    columns: Mapping[str, float]
    names: tuple[str, ...]
    unit: IntArray
    x: FloatArray
    y: FloatArray
    deviation: FloatArray

    def without(self, unit: int) -> "LabelledLogs":
        """Return the logs of the other units."""
        keep = self.unit != unit
        index = self.unit[keep]
        return self._of(self.names[:unit] + self.names[unit + 1 :], keep, index - (index > unit))

    def only(self, unit: int) -> "LabelledLogs":
        """Return the logs of one unit."""
        keep = self.unit == unit
        return self._of(self.names[unit : unit + 1], keep, np.zeros_like(self.unit[keep]))

    def telling(self, label: int) -> list[int]:
        """Return the units whose logs differ in a label."""
        result: list[int] = np.unique(self.unit[self.x[:, label] != 0]).tolist()
        return result

    def _of(self, names: tuple[str, ...], keep: BoolArray, unit: IntArray) -> "LabelledLogs":
        return LabelledLogs(self.columns, names, unit, self.x[keep], self.y[keep], self.deviation[keep])


def labelled_logs(logs: Sequence[LogValue]) -> LabelledLogs:
    """Return the logs of units that tell a slope.

    A weak log counts by the estimate of its squared coefficient; without one, a log that only bounds the
    coefficient is left out.

    Raises
    ------
    DataError
        If no unit has logs at two temperatures or of two days, if the two always move together, or if the
        logs do not show the term.
    """
    values = LogValues.of(logs)
    y, deviation = _linear(values)
    labels = np.array([[getattr(log, column) for column in NEAREST] for log in logs])
    told = np.zeros_like(labels)
    rows: list[IntArray] = []
    for unit in range(len(values.names)):
        own = np.flatnonzero((values.unit == unit) & np.isfinite(deviation))
        varies = _varying(labels[own])
        own = own[np.isfinite(labels[own][:, varies]).all(axis=1)]
        varies &= _varying(labels[own])
        if varies.any():
            place = np.ix_(own, varies)
            told[place] = labels[place] - labels[place].mean(axis=0)
            rows.append(own)
    if not rows:
        msg = (
            "no unit has logs at two temperatures or of two days: label the logs with temperature_c or "
            "started, two different ones a unit at least"
        )
        raise DataError(msg)
    keep = np.concatenate(rows)
    scale = np.sqrt(np.mean(told[keep] ** 2, axis=0))
    tells = scale > 0
    x = told[keep][:, tells] / scale[tells]
    if np.linalg.matrix_rank(x, tol=_SAME * math.sqrt(len(x))) < x.shape[1]:
        msg = (
            "temperature and time moved together in every unit, so that neither's effect can be told: "
            "record a unit at another temperature on the same day"
        )
        raise DataError(msg)
    return LabelledLogs(
        columns={column: float(one) for column, one in zip(NEAREST, scale, strict=True) if one > 0},
        names=tuple(values.names[int(values.unit[own[0]])] for own in rows),
        unit=np.repeat(np.arange(len(rows)), [own.size for own in rows]),
        x=x,
        y=y[keep],
        deviation=deviation[keep],
    )


def _varying(labels: FloatArray) -> BoolArray:
    """Return which labels, shape (logs, labels), vary by enough over the logs that have them."""
    result = [
        known.size > 1 and float(np.ptp(known)) > near
        for column, near in zip(labels.T, NEAREST.values(), strict=True)
        for known in (column[np.isfinite(column)],)
    ]
    return np.array(result, dtype=np.bool_)


def _linear(values: LogValues) -> tuple[FloatArray, FloatArray]:
    """Return logarithms of the coefficients and their standard errors; infinite where there is none to use.

    A weak log's square may be negative: it is taken as linear about the fleet's mean square.
    """
    squares, at = values.squares(), math.exp(2 * place_of(values).centre)
    # What most logs of the fleet are like decides, or high draws would count otherwise than low ones.
    told = values.narrow & ((squares.deviation(at) <= 2 * _NARROW * at) | (values.deviation <= _NARROW / 2))
    weak = ~told & np.isfinite(values.variance)
    if not weak.any():
        return values.centre, values.deviation
    square = np.where(weak, squares.estimate, np.exp(2 * values.centre))
    error = np.where(weak, squares.deviation(at), 2 * square * values.deviation)
    weight = np.where(np.isfinite(error), 1 / (error**2 + np.median(error) ** 2), 0.0)
    mean = float(np.sum(weight * square) / weight.sum())
    if (
        mean
        < _TOLD * math.sqrt(float(np.sum((weight * np.where(weight > 0, error, 0.0)) ** 2))) / weight.sum()
    ):
        msg = "the logs only bound this term, and so tell nothing of what moves it: record longer logs"
        raise DataError(msg)
    return (
        np.where(weak, 0.5 * math.log(mean) + (square / mean - 1) / 2, values.centre),
        np.where(weak, squares.deviation(mean) / (2 * mean), values.deviation),
    )


#: Grid points of omega and of each spread; the grid is narrowed so many times at most.
_POINTS, _ROUNDS = 10, 4
#: What lies so far below the posterior's peak, in the logarithm, is out of its support; and weighs nothing.
_OUTSIDE, _NOTHING = 10.0, 8.0
#: A scatter or spread of this share of the errors is none.
_NONE = 0.05


@dataclass(frozen=True, slots=True)
class Sums:
    """What the logs of a unit tell of its slopes, its level integrated out.

    Attributes
    ----------
    information
        Shape (…, labels, labels).
    score
        Shape (…, labels).
    height
        Log-likelihood at slopes of zero, shape (…,).
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


@dataclass(frozen=True, slots=True)
class SlopePosterior:
    """Points of the posterior of scatter and spreads, and the law of the mean slopes at each.

    Attributes
    ----------
    omega, tau
        Shape (points,) and (points, labels).
    weight
        Shape (points,); adds up to one.
    mean, covariance
        Of the mean slopes, shape (points, labels) and (points, labels, labels).
    """

    omega: FloatArray
    tau: FloatArray
    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray

    def slope(self, label: int) -> Mixtures:
        """Return the mean slope of a label."""
        sd = np.sqrt(self.covariance[:, label, label])
        return Mixtures(self.mean[None, :, label], sd[None], self.weight)

    def own_slopes(self, logs: LabelledLogs, label: int) -> Mixtures:
        """Return the slope of each unit by its own logs; of the other labels, it moves as other units do."""
        sums = self._of(logs, leave=label)
        # A unit whose logs do not differ in the label tells nothing, of no interest to anyone.
        information = np.maximum(sums.information[..., label, label], 1e-300)
        rest = self._beyond(sums, label) / information
        return Mixtures((self.mean[:, None, label] + rest).T, 1 / np.sqrt(information).T, self.weight)

    def beyond(self, unit: LabelledLogs, label: int) -> Mixtures:
        """Return how far a unit that this posterior has not seen lies beyond what it expects, as a score."""
        sums = self._of(unit)
        information = sums.information[..., label]
        error = np.einsum("pui,pij,puj->pu", information, self.covariance, information)
        sd = np.sqrt(information[..., label] + error)
        return Mixtures(self._beyond(sums, label).T, sd.T, self.weight)

    def _of(self, logs: LabelledLogs, leave: int | None = None) -> Sums:
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


def slope_posterior(logs: LabelledLogs) -> SlopePosterior:
    """Return the posterior on a grid that is narrowed until it fits its support."""
    ranges = _ranges(logs)
    for _ in range(_ROUNDS):
        axes = [np.exp(np.linspace(*ends, _POINTS)) if ends[1] > ends[0] else np.zeros(1) for ends in ranges]
        slices = [_at_scatter(logs, omega, axes[1:]) for omega in axes[0].tolist()]
        mean, covariance, height = (np.array(part) for part in zip(*slices, strict=True))
        height -= height.max()
        narrower = [_support(height, axis, ends) for axis, ends in enumerate(ranges)]
        if all(2 * (new[1] - new[0]) >= old[1] - old[0] for new, old in zip(narrower, ranges, strict=True)):
            break
        ranges = narrower
    keep = height > -_NOTHING
    omega, *tau = (np.broadcast_to(grid, height.shape)[keep] for grid in np.ix_(*axes))
    weight = np.exp(height[keep])
    return SlopePosterior(omega, np.column_stack(tau), weight / weight.sum(), mean[keep], covariance[keep])


def unit_sums(logs: LabelledLogs, omega: FloatArray) -> Sums:
    """Return what each unit tells of its slopes, for each scatter omega, shape (omega,)."""
    starts = np.flatnonzero(np.diff(logs.unit, prepend=-1))
    w = 1 / (logs.deviation**2 + omega[:, None] ** 2)

    def total(values: FloatArray) -> FloatArray:
        result: FloatArray = np.add.reduceat(values, starts, axis=1)
        return result

    whole = total(w)
    x = logs.x - (total(w[..., None] * logs.x) / whole[..., None])[:, logs.unit]
    y = logs.y - (total(w * logs.y) / whole)[:, logs.unit]
    return Sums(
        information=total(w[..., None, None] * x[..., None] * x[..., None, :]),
        score=total((w * y)[..., None] * x),
        height=-0.5 * (total(w * y * y - np.log(w)) + np.log(whole)),
    )


def _at_scatter(
    logs: LabelledLogs, omega: float, spreads: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean slopes, their covariance and the logarithm of the posterior, over a grid of spreads.

    The prior is Jeffreys' of omega and of each spread, for a measure that is flat in their logarithms.
    """
    each = unit_sums(logs, np.array([omega]))
    errors = np.diagonal(each.information[0], axis1=-2, axis2=-1)
    room = [1] * (len(spreads) - 1)
    each = Sums(*(part.reshape(*room, *part.shape) for part in (each.information, each.score, each.height)))
    prior = 2 * math.log(omega) + 0.5 * math.log(np.sum((logs.deviation**2 + omega**2) ** -2.0))
    height = np.full((1,) * len(spreads), prior)
    for label, (tau, own) in enumerate(zip(np.ix_(*spreads), errors.T, strict=True)):
        if tau.any():
            each = each.spread(label, tau[..., None])
            height = height + np.log(
                tau**2 * np.sqrt(np.sum((own / (1 + tau[..., None] ** 2 * own)) ** 2, axis=-1))
            )
    covariance = np.linalg.inv(each.information.sum(axis=-3))
    score = each.score.sum(axis=-2)
    mean = np.einsum("...ij,...j->...i", covariance, score)
    fit = each.height.sum(axis=-1) + 0.5 * np.einsum("...i,...i->...", score, mean)
    return mean, covariance, height + fit + 0.5 * np.linalg.slogdet(covariance)[1]


def _ranges(logs: LabelledLogs) -> list[tuple[float, float]]:
    """Return the ranges of the logarithms of omega and the spreads; of no width where there is no telling."""
    sums = unit_sums(logs, np.zeros(1))
    own = np.diagonal(sums.information[0], axis1=-2, axis2=-1)
    known = float(np.sqrt(np.mean(logs.deviation**2)))
    scatter = math.sqrt(float(np.mean((logs.y - _unit_means(logs, logs.y)) ** 2)))
    ranges = [(math.log(_NONE * known), math.log(2 * known + 3 * scatter))]
    for label in range(logs.x.shape[1]):
        tell = own[:, label] > 0
        if np.count_nonzero(tell) < 2:
            ranges.append((0.0, 0.0))
            continue
        error = 1 / math.sqrt(float(own[tell, label].max()))
        x = logs.x[:, label] - _unit_means(logs, logs.x[:, label])
        slope = scatter / math.sqrt(float(np.mean(x**2)))
        ranges.append((math.log(_NONE * error), math.log(3 * error + 10 * slope)))
    return ranges


def _unit_means(logs: LabelledLogs, values: FloatArray) -> FloatArray:
    """Return for each log the mean of its unit's logs."""
    result: FloatArray = (np.bincount(logs.unit, values) / np.bincount(logs.unit))[logs.unit]
    return result


def _support(height: FloatArray, axis: int, ends: tuple[float, float]) -> tuple[float, float]:
    """Return the range of an axis' likely points and one more to each side."""
    others = tuple(i for i in range(height.ndim) if i != axis)
    places = np.flatnonzero(np.max(height, axis=others) > -_OUTSIDE)
    size = height.shape[axis]
    grid = np.linspace(*ends, size)
    return float(grid[max(places[0] - 1, 0)]), float(grid[min(places[-1] + 1, size - 1)])


#: How many of a label its slope is for.
_SCALE = {"temperature_c": 1.0, "days": 365.25}
#: Units that are judged by the others alone: the oddest, up to a chance of being so odd at a quick look.
_SUSPECTS, _SUSPECT = 5, 0.1
_TAILS = (0.025, 0.5, 0.975)


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope:
    """How a coefficient moves by one label, of the fleet or of one unit of it.

    Attributes
    ----------
    unit
        Which; empty for the mean of the fleet.
    label
        ``temperature_c`` or ``days``.
    slope
        Change of the natural logarithm a °C, or a year, with its 95 % interval.
    p_value
        Of the fleet: the chance of such a slope where there is none. Of a unit: where it moves as the others
        do.
    p_odd
        The same, adjusted for all that were looked at: Benjamini and Hochberg's false discovery rate.
    odd
        Whether it is not chance.
    """

    unit: str
    label: str
    slope: Interval
    p_value: float
    p_odd: float
    odd: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """How a coefficient moves with temperature and time.

    Attributes
    ----------
    means
        Of the fleet, for each label that tells a slope.
    slopes
        Of the units that tell one, for each label.
    units
        How many units the slopes are from.
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
        If no unit has logs at two temperatures or of two days, or the logs do not show the term.
    """
    labelled = labelled_logs(logs)
    posterior = slope_posterior(labelled)
    means: list[Slope] = []
    slopes: list[Slope] = []
    for place, label in enumerate(labelled.columns):
        every = labelled.telling(place)
        mean, own = posterior.slope(place), posterior.own_slopes(labelled, place).take(every)
        limits = _SCALE[label] / labelled.columns[label] * mean.followed_by(own).quantiles(_TAILS)
        p_values = [mean.two_sided().item(), *_p_values(labelled, posterior, place, own, every)]
        names = ["", *(labelled.names[unit] for unit in every)]
        found = list(map(_slope, names, [label] * len(names), limits.tolist(), p_values))
        means.append(found[0])
        slopes += found[1:]
    return adjust([Trend(means=tuple(means), slopes=tuple(slopes), units=len(labelled.names))])[0]


def adjust(trends: Sequence[Trend]) -> tuple[Trend, ...]:
    """Return trends that were looked at together, with what is odd among all of their units and labels.

    The means of the fleet are one family of tests, the units of it another.
    """
    means = iter(_adjusted([mean for one in trends for mean in one.means]))
    slopes = iter(_adjusted([slope for one in trends for slope in one.slopes]))
    return tuple(
        replace(
            one,
            means=tuple(next(means) for _ in one.means),
            slopes=tuple(next(slopes) for _ in one.slopes),
        )
        for one in trends
    )


def _adjusted(slopes: Sequence[Slope]) -> list[Slope]:
    p_values = adjusted(np.array([slope.p_value for slope in slopes]))
    return [
        replace(slope, p_odd=p, odd=p <= FALSE_SHARE)
        for slope, p in zip(slopes, p_values.tolist(), strict=True)
    ]


def _slope(unit: str, label: str, limits: Sequence[float], p_value: float) -> Slope:
    low, value, high = limits
    slope = Interval(value=value, low=low, high=high)
    return Slope(unit=unit, label=label, slope=slope, p_value=p_value, p_odd=1.0, odd=False)


def _p_values(
    logs: LabelledLogs, posterior: SlopePosterior, place: int, own: Mixtures, every: Sequence[int]
) -> list[float]:
    """Return how probable the slope of each unit is: the oddest in the posterior of the others.

    That allows for how badly the scatter and the spread of slopes are known. A quick look finds who is to be
    judged so; the rest can only pass.
    """
    result = np.ones(len(every))
    quick = leave_one_out(*own.moments(), float(posterior.weight @ posterior.tau[:, place]))
    for i in np.argsort(quick)[:_SUSPECTS].tolist():
        if quick[i] < _SUSPECT:
            alone = slope_posterior(logs.without(every[i]))
            result[i] = alone.beyond(logs.only(every[i]), place).two_sided().item()
    p_values: list[float] = result.tolist()
    return p_values
