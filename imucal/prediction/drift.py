"""How far dead reckoning drifts after a rest: angles, velocities and positions, with limits.

At rest the mean of the samples is taken for the bias; then nothing aids it. The error of an angle is the
gyroscope's noise summed up, that of a velocity and a position the accelerometer's, once and twice. And a
tilt lets gravity in: g times the gyroscope's noise, summed up twice and three times. It is the sensors'
noise alone, over a flat Earth that stands still, without scale, misalignment or temperature. What comes
through tilt swings with a period of 84 minutes: it is less by 0.7 % at 300 s, by 8 % at 1000 s.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS
from imucal.prediction.propagation import (
    ANGLE,
    POSITION,
    Quantity,
    coasting_variance,
    lower_limit,
    modelled,
    upper_limit,
)
from imucal.recording import Sensor
from imucal.units import G0

#: How long dead reckoning goes on, and the rest before it, where nobody says, in s.
TIMES_S, REST_S = (1.0, 10.0, 60.0, 300.0), 60.0
#: A record has seen a drift if it is so many times as long as rest and coast together: the deviation of as
#: many coasts is known to a third. The curve calls fewer degrees of freedom few.
STRETCHES = 5
#: Rest and coast are summed up in blocks, of which the shorter one has a dozen at this ratio.
_MOST_UNLIKE = 2e4
#: An accelerometer at rest reads g to this share; its axis within acos 0.94 = 20 degrees of it is vertical.
_NEAR_G, _UPRIGHT = 0.1, 0.94


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftPoint:
    """One standard deviation of an error after a time.

    Attributes
    ----------
    time_s
        How long nothing has aided, in s.
    axis
        ``gyro_z``, the one with the largest value of several; ``accel_x gyro_y`` where two parts make it.
    value
        Of the fitted model; None where the record shows no term.
    low, high
        Limits at the fit's level, bounded terms included; 0 and infinity where a term's are not known.
    term, share
        The term that makes most of the value's square, such as ``B``, and its share; empty without a value.
    seen
        Whether the record holds `STRETCHES` such rests and coasts: if not, the model is taken to go on as it
        does; None without a record.
    """

    time_s: float
    axis: str
    value: float | None
    low: float
    high: float
    term: str
    share: float
    seen: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftOf:
    """The drift of one quantity: ``heading``, ``tilt``, ``angle``, ``velocity through tilt``, …, in SI."""

    name: str
    unit: str
    points: tuple[DriftPoint, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """How far dead reckoning drifts after a rest of `rest_s`, with limits of the fits' level.

    `vertical` is the axis that gravity lies along, by the accelerometer's means; empty where those don't
    tell. Angles come first, then velocities and positions: each part, and both together.
    """

    rest_s: float
    level: float
    vertical: str
    quantities: tuple[DriftOf, ...]


class Characterised(Protocol):
    """What is asked of a report, which stands above this room: axes that have `axis`, `mean` and `fit`."""

    @property
    def axes(self) -> Sequence[Any]: ...


class _Axis(NamedTuple):
    axis: str
    mean: float
    fit: NoiseFit


#: What returns the drift of an axis at all times, of so many integrals.
_Integrated: TypeAlias = Callable[[_Axis, int], list[DriftPoint]]


def drift(
    source: Characterised | NoiseFit,
    times_s: Sequence[float] = TIMES_S,
    *,
    rest_s: float = REST_S,
    each_axis: bool = False,
) -> Drift:
    """Return how far dead reckoning drifts after a rest.

    Parameters
    ----------
    source
        A report, or the fit of one axis.
    times_s
        How long it goes on, in s, in whole samples.
    rest_s
        How long the bias is averaged before.
    each_axis
        Of each axis by itself; else of each sensor's worst, and of both sensors together.

    Raises
    ------
    ValueError
        If a time or the rest is shorter than a sample, or one of them 20 000 times the other.
    DataError
        If there is no axis whose sensor is known.
    """
    known = (
        [("", 0.0, source)]
        if isinstance(source, NoiseFit)
        else [(a.axis, a.mean, a.fit) for a in source.axes]
    )
    axes = [axis for axis in map(_Axis._make, known) if axis.fit.sensor is not None]
    if not axes:
        msg = "no axis whose sensor is known, expected a gyroscope's or an accelerometer's"
        raise DataError(msg)
    sample_s = max(1 / axis.fit.rate_hz for axis in axes)
    for time in times_s:
        short, long = min(time, rest_s), max(time, rest_s)
        if not (sample_s < short * (1 + 1e-9) and long <= _MOST_UNLIKE * short < math.inf):
            found = f"rest {rest_s:g} s and time {time:g} s"
            ratio = f"at most {_MOST_UNLIKE:.0f} times the other"
            msg = f"{found}, expected each a sample ({sample_s:.3g} s) at least and {ratio}"
            raise ValueError(msg)

    @cache
    def of_one(symbol: str, shape: tuple[float, ...], rate_hz: float, integrals: int) -> FloatArray:
        """Return the variance of a term whose coefficient is 1: all axes with such a term share it."""
        term, times = TERMS[symbol].of(1.0, *shape), np.array(times_s)
        return coasting_variance(term, times, rest_s=rest_s, rate_hz=rate_hz, integrals=integrals)

    def integrated(axis: _Axis, integrals: int) -> list[DriftPoint]:
        scale = G0 if axis.fit.sensor is Sensor.GYROSCOPE and integrals > ANGLE else 1.0

        def variance(term: NoiseTerm) -> FloatArray:
            unit = of_one(term.symbol, term.values[1:], axis.fit.rate_hz, integrals)
            return (scale * term.coefficient) ** 2 * unit

        return _points(axis, variance, times_s, rest_s)

    vertical = _vertical(axes)
    groups = [[axis] for axis in axes] if each_axis else [axes]
    quantities = [found for group in groups for found in _quantities(group, vertical, integrated)]
    return Drift(rest_s=rest_s, level=axes[0].fit.level, vertical=vertical, quantities=tuple(quantities))


def _vertical(axes: Sequence[_Axis]) -> str:
    """Return the letter of the axis that gravity lies along; empty where the means don't tell."""
    means = {axis.axis: abs(axis.mean) for axis in axes if axis.fit.sensor is Sensor.ACCELEROMETER}
    total = math.hypot(*means.values())
    if len(means) < 3 or not abs(total / G0 - 1) < _NEAR_G:
        return ""
    upright = max(means, key=means.__getitem__)
    return upright if means[upright] > _UPRIGHT * total else ""


def _quantities(axes: Sequence[_Axis], vertical: str, integrated: _Integrated) -> Iterator[DriftOf]:
    """Yield what the worst of the axes make, and what both sensors make together."""
    gyros = [axis for axis in axes if axis.fit.sensor is Sensor.GYROSCOPE]
    accels = [axis for axis in axes if axis.fit.sensor is Sensor.ACCELEROMETER]
    upright = [axis for axis in gyros if vertical and axis.axis == vertical]
    tilting = [axis for axis in gyros if axis not in upright]
    for name, own in (("heading", upright), ("tilt" if vertical else "angle", tilting)):
        if own:
            yield DriftOf(name=name, unit="rad", points=_worst(integrated(axis, ANGLE) for axis in own))
    for name, unit, integrals in (("velocity", "m/s", ANGLE), ("position", "m", POSITION)):
        # Gravity makes an acceleration of an angle: one integral more.
        makers = (("from the accelerometer", accels, integrals), ("through tilt", tilting, integrals + 1))
        parts = [
            DriftOf(name=f"{name} {how}", unit=unit, points=_worst(integrated(axis, order) for axis in own))
            for how, own, order in makers
            if own
        ]
        yield from parts
        if len(parts) == 2:
            both = tuple(map(_both, *(part.points for part in parts)))
            yield DriftOf(name=f"{name}, both", unit=unit, points=both)


def _points(axis: _Axis, variance: Quantity, times_s: Sequence[float], rest_s: float) -> list[DriftPoint]:
    """Return the drift of one axis at all times."""
    fit, sensor = axis.fit, axis.fit.sensor
    value = modelled(fit, variance)
    by_term = {e.key: modelled(replace(fit, estimates=(e,)), variance) for e in fit.estimates if e.value}
    terms = [max(by_term, key=lambda key: by_term[key][i]) if value[i] > 0 else "" for i in range(value.size)]
    low, high = 0 * value, value + math.inf
    times = [e.correlation_time.high for e in fit.estimates if e.correlation_time]
    if np.isfinite([*times, *(e.high for e in fit.estimates)]).all():
        low, high = lower_limit(fit, variance), upper_limit(fit, variance)
    # A curve without degrees of freedom is a model's, and no record's.
    record_s = fit.curve.n / fit.rate_hz if np.isfinite(fit.curve.edf).any() else 0.0
    return [
        DriftPoint(
            time_s=time_s,
            axis="_".join(filter(None, (sensor.short if sensor else "", axis.axis))),
            value=math.sqrt(value[i]) if terms[i] else None,
            low=math.sqrt(low[i]),
            high=math.sqrt(high[i]),
            term=terms[i],
            share=float(by_term[terms[i]][i] / value[i]) if terms[i] else 0.0,
            seen=record_s >= STRETCHES * (time_s + rest_s) if record_s else None,
        )
        for i, time_s in enumerate(times_s)
    ]


def _worst(of_axes: Iterable[list[DriftPoint]]) -> tuple[DriftPoint, ...]:
    """Return at each time that of the axis with the largest value, or, without one, the largest bound."""
    beside = zip(*of_axes, strict=True)
    return tuple(max(points, key=lambda point: (point.value or 0.0, point.high)) for points in beside)


def _both(*parts: DriftPoint) -> DriftPoint:
    """Return the drift of parts that know nothing of each other: squares add up, and limits as of any sum."""
    squares = [(part.value or 0.0) ** 2 for part in parts]
    value = sum(squares)
    below, above = (
        math.hypot(*(getattr(part, end) ** 2 - own for part, own in zip(parts, squares, strict=True)))
        for end in ("low", "high")
    )
    share, most = max(
        ((part.share * own, part) for part, own in zip(parts, squares, strict=True)), key=lambda each: each[0]
    )
    return DriftPoint(
        time_s=most.time_s,
        axis=" ".join(part.axis for part in parts),
        value=math.sqrt(value) if value else None,
        low=math.sqrt(max(value - below, 0.0)),
        high=math.sqrt(value + above),
        term=f"{most.axis} {most.term}" if value else "",
        share=share / value if value else 0.0,
        seen=all(part.seen for part in parts) if None not in {part.seen for part in parts} else None,
    )
