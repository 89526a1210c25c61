"""Drift and temperature of a coefficient over a fleet: per cent a °C and per cent a year.

In the logarithm, each unit has a level and slopes of its own; the slopes of the fleet are their means. What
is said to move, is said with 5 % of false alarms over all units, labels and terms that were looked at.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.fitting.noise_fit import Interval
from imucal.fleet.labelled_logs import LabelledLogs, labelled_logs
from imucal.fleet.log_value import LogValue
from imucal.fleet.mixtures import Mixtures
from imucal.fleet.outliers import FALSE_SHARE, adjusted, leave_one_out
from imucal.fleet.slope_posterior import (
    SlopePosterior,
    slope_posterior,
)

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
