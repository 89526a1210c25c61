"""Drift and temperature of a coefficient over a fleet: per cent a °C and per cent a year.

In the logarithm, each unit has a level and slopes of its own; the slopes of the fleet are their means, with
the spread between units taken in. Paule & Mandel (1982), Journal of Research of the NBS 87, p. 377, give the
weights.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.fitting.noise_fit import Interval
from imucal.fleet.log_value import LogValue, LogValues
from imucal.fleet.outliers import adjusted, leave_one_out

#: Adjusted p-value below which a unit moves otherwise than the others; there are many labels and terms.
_RARE = 0.01
#: Label -> what it must vary by to tell a slope, and the unit of the slope.
_COLUMNS = {"temperature_c": 1.0, "days": 0.5}
_SCALE = {"temperature_c": 1.0, "days": 365.25}


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitSlope:
    """How the coefficient of one unit moves by one label, as `Trend` has it for the fleet.

    `odd` says that the unit does not move as the others do, with Benjamini and Hochberg's adjusted `p_odd`.
    """

    unit: str
    label: str
    slope: Interval
    p_odd: float
    odd: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """How a coefficient moves, as changes of its natural logarithm with 95 % intervals.

    Attributes
    ----------
    temperature
        Change a °C; None where fewer than two temperatures of a unit are known.
    drift
        Change a year; None where no unit has logs of two days.
    units
        How many units the slopes are from.
    slopes
        Those of each unit, by ``temperature_c`` and by ``days``.
    """

    temperature: Interval | None
    drift: Interval | None
    units: int
    slopes: tuple[UnitSlope, ...] = ()


def trend(logs: Sequence[LogValue]) -> Trend:
    """Return drift and temperature coefficient of a fleet.

    Only logs that estimate the coefficient and have a label are used, and only units with at least two
    temperatures, or two days.

    Raises
    ------
    DataError
        If no unit has logs at two temperatures or of two days.
    """
    told = {own[0].unit: design for own in _by_unit(logs) if (design := _design(own))}
    designs = list(told.values())
    if not designs:
        msg = (
            "no unit has logs at two temperatures or of two days: label the logs with temperature_c or "
            "started, two different ones a unit at least"
        )
        raise DataError(msg)
    omega2 = _excess([_residuals(design) for design in designs])
    slopes: dict[str, dict[str, tuple[float, float]]] = {column: {} for column in _COLUMNS}
    for unit, design in told.items():
        for column, slope in _slopes(design, omega2).items():
            slopes[column][unit] = slope
    temperature, drift = (
        _mean(*zip(*found.values(), strict=True)) if found else None for found in slopes.values()
    )
    each = tuple(s for column, found in slopes.items() for s in _each(column, found))
    return Trend(temperature=temperature, drift=drift, units=len(designs), slopes=each)


@dataclass(frozen=True, slots=True)
class _Design:
    """The logs of one unit: regressors (logs × (1 + columns)), logarithms and their standard errors."""

    columns: tuple[str, ...]
    x: FloatArray
    y: FloatArray
    deviation: FloatArray


def _by_unit(logs: Sequence[LogValue]) -> list[list[LogValue]]:
    units: dict[str, list[LogValue]] = {}
    for log in logs:
        if log.value and log.low > 0:
            units.setdefault(log.unit, []).append(log)
    return list(units.values())


def _design(logs: list[LogValue]) -> _Design | None:
    """Return the regressors that vary over the logs of a unit; None where none does."""
    columns = tuple(c for c, near in _COLUMNS.items() if _spans(logs, c) > near)
    logs = [log for log in logs if all(math.isfinite(getattr(log, c)) for c in columns)]
    columns = tuple(c for c in columns if _spans(logs, c) > _COLUMNS[c])
    if not columns:
        return None
    labels = np.array([[getattr(log, c) / _SCALE[c] for c in columns] for log in logs])
    # About their means: days since 1970 that are a week apart are almost a column of ones.
    x = np.column_stack([np.ones(len(logs)), labels - labels.mean(axis=0)])
    if np.linalg.matrix_rank(x) < x.shape[1]:
        return None
    values = LogValues.of(logs)
    return _Design(columns, x, values.centre, values.deviation)


def _spans(logs: list[LogValue], column: str) -> float:
    values = [value for log in logs if math.isfinite(value := getattr(log, column))]
    return max(values) - min(values) if values else 0.0


def _solve(design: _Design, omega2: float) -> tuple[FloatArray, FloatArray]:
    """Return weighted least squares and its covariance."""
    w = 1 / (design.deviation**2 + omega2)
    covariance = np.asarray(np.linalg.inv((design.x.T * w) @ design.x), dtype=np.float64)
    return covariance @ (design.x.T @ (w * design.y)), covariance


def _slopes(design: _Design, omega2: float) -> dict[str, tuple[float, float]]:
    """Return the slopes of one unit and their variances."""
    beta, covariance = _solve(design, omega2)
    variances = np.diag(covariance)
    return {c: (float(beta[i]), float(variances[i])) for i, c in enumerate(design.columns, 1)}


def _each(column: str, found: dict[str, tuple[float, float]]) -> list[UnitSlope]:
    """Return the slopes of the units, and which are odd by leave-one-out."""
    from scipy.special import ndtri

    if not found:
        return []
    y, s2 = np.array(list(found.values())).T

    def squares(t2: float) -> tuple[float, int]:
        w = 1 / (s2 + t2)
        return float(np.sum(w * (y - np.sum(w * y) / w.sum()) ** 2)), y.size - 1

    tau = math.sqrt(_excess([squares])) if y.size > 1 else 0.0
    p_values = adjusted(leave_one_out(y, np.sqrt(s2), tau))
    half = float(ndtri(0.975)) * np.sqrt(s2)
    return [
        UnitSlope(
            unit=unit,
            label=column,
            slope=Interval(value=value, low=value - wide, high=value + wide),
            p_odd=p,
            odd=p <= _RARE,
        )
        for unit, value, wide, p in zip(found, y.tolist(), half.tolist(), p_values.tolist(), strict=True)
    ]


def _residuals(design: _Design) -> Callable[[float], tuple[float, int]]:
    """Return the weighted squares and degrees of freedom of a unit, as a function of omega²."""

    def squares(omega2: float) -> tuple[float, int]:
        beta, _ = _solve(design, omega2)
        score = (design.y - design.x @ beta) ** 2 / (design.deviation**2 + omega2)
        return float(np.sum(score)), design.y.size - beta.size

    return squares


def _mean(slopes: tuple[float, ...], variances: tuple[float, ...]) -> Interval:
    """Return the mean slope with its interval: spread between units included (Hartung & Knapp 2001)."""
    from scipy.special import ndtri, stdtrit

    y, s2 = np.array(slopes), np.array(variances)
    n = y.size

    def squares(t2: float) -> tuple[float, int]:
        w = 1 / (s2 + t2)
        return float(np.sum(w * (y - np.sum(w * y) / w.sum()) ** 2)), n - 1

    w = 1 / (s2 + _excess([squares]))
    mean = float(np.sum(w * y) / w.sum())
    error = 1 / math.sqrt(w.sum())
    half = error * float(ndtri(0.975) if n == 1 else stdtrit(n - 1, 0.975))
    return Interval(value=mean, low=mean - half, high=mean + half)


def _excess(terms: Sequence[Callable[[float], tuple[float, int]]]) -> float:
    """Return the variance beyond the known ones that brings the squares to their degrees of freedom."""
    from scipy.optimize import brentq

    # Where there are no degrees of freedom, the squares are rounding, which no variance brings to zero.
    terms = [term for term in terms if term(0.0)[1] > 0]

    def surplus(t2: float) -> float:
        return sum(square - degrees for square, degrees in (term(t2) for term in terms))

    if surplus(0.0) <= 0:
        return 0.0
    top = 1e-6
    while surplus(top) > 0:
        top *= 10
    return float(brentq(surplus, 0.0, top))
