"""The logs that tell what temperature or time does: labels that vary within a unit, and logarithms."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.fleet.log_value import LogValue, LogValues
from imucal.fleet.unit_likelihood import place_of

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
