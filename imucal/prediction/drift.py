"""How far dead reckoning drifts after a rest: angles, velocities and positions, with limits.

The bias is the mean of the samples at rest; afterwards nothing aids dead reckoning. Velocity and position
errors are the accelerometer's noise, integrated once and twice, and g times the gyroscope's noise, integrated
twice and three times. The earth is flat and does not rotate.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise.term import NoiseTerm
from imucal.prediction.propagation import (
    ANGLE,
    POSITION,
    TILT,
    coasting_variance,
    lower_limit,
    modelled,
    shares,
    upper_limit,
)
from imucal.recording import Sensor
from imucal.units import G0, duration

#: Default durations of dead reckoning, in s.
TIMES_S = (1.0, 10.0, 60.0, 300.0)
#: Default duration of the rest before it, in s.
REST_S = 60.0
#: Cause of an error -> its spelling behind the kind.
_THROUGH = {
    "": "",
    "accelerometer": " from the accelerometer",
    "tilt": " through tilt",
    "both": ", both",
}
#: Least length of a record that shows a drift, in lengths of rest plus coast.
STRETCHES = 5
#: Largest ratio of rest and coast: the shorter one then has a dozen blocks.
_MAX_RATIO = 2e4
#: Relative tolerance of g at rest.
_NEAR_G = 0.1
#: Cosine of the largest tilt of a vertical axis.
_UPRIGHT = 0.94


@dataclass(frozen=True, kw_only=True)
class DriftPoint:
    """Standard deviation of an error after `time_s` without aiding.

    `axis` is a name such as ``gyro_z``, the worst of several, or ``accel_x gyro_y`` for the sum of two parts.
    `value` is from the fitted model, None if the record shows no term. `low` and `high` are limits at the
    fit's level, 0 and infinity if unknown. `term` contributes the largest `share` of the value's square.
    `seen` is whether the record is as long as `STRETCHES` such rests and coasts; None without a record.
    """

    time_s: float
    axis: str
    value: float | None
    low: float
    high: float
    term: str
    share: float
    seen: bool | None


@dataclass(frozen=True, kw_only=True)
class DriftOf:
    """The drift of one quantity, in SI.

    `kind` is ``heading``, ``tilt``, ``angle``, ``velocity`` or ``position``. `through` is the cause of an
    error of velocity or position: ``accelerometer``, ``tilt`` or ``both``; empty for angles.
    """

    kind: str
    through: Literal["", "accelerometer", "tilt", "both"]
    unit: str
    points: tuple[DriftPoint, ...]

    @property
    def name(self) -> str:
        """Kind and cause, such as ``velocity through tilt``."""
        return self.kind + _THROUGH[self.through]


@dataclass(frozen=True, kw_only=True)
class Drift:
    """How far dead reckoning drifts after a rest of `rest_s`, with limits of the fits' level.

    `vertical` is the axis parallel to gravity, or empty if unknown. Angles come first, then velocities and
    positions: each part, and both together.
    """

    rest_s: float
    level: float
    vertical: str
    quantities: tuple[DriftOf, ...]

    def __repr__(self) -> str:
        lines = [f"Drift after a rest of {duration(self.rest_s)}, one standard deviation"]
        for quantity in self.quantities:
            values = (p.high if p.value is None else p.value for p in quantity.points)
            times = (duration(point.time_s) for point in quantity.points)
            pairs = (f"{value:.3g} in {time}" for value, time in zip(values, times, strict=True))
            lines.append(f"{quantity.name} ({quantity.unit}): {', '.join(pairs)}")
        return "\n".join(lines)


class Characterised(Protocol):
    """Protocol of a report: axes with `axis`, `mean` and `fit`."""

    @property
    def axes(self) -> Sequence[Any]: ...


class _Axis(NamedTuple):
    axis: str
    mean: float
    fit: NoiseFit


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
        Duration of dead reckoning in s, rounded to whole samples.
    rest_s
        Duration of the rest before it, in s.
    each_axis
        Return each axis by itself instead of each sensor's worst axis and both sensors together.

    Raises
    ------
    ValueError
        If a time or the rest is shorter than a sample, or their ratio is above 20 000.
    DataError
        If there is no axis whose sensor is known.
    """
    if not isinstance(source, NoiseFit) and not hasattr(source, "axes"):
        raise ArgumentError("drift: expected a report or a fit; type imucal.drift(imucal.fit(recording))")
    given = [_Axis("", 0.0, source)] if isinstance(source, NoiseFit) else source.axes
    axes = [_Axis(axis.axis, axis.mean, axis.fit) for axis in given if axis.fit.sensor is not None]
    if not axes:
        raise DataError("no axis of a known sensor; expected a gyroscope or an accelerometer")
    sample_s = max(1 / axis.fit.rate_hz for axis in axes)
    for time in times_s:
        short, long = min(time, rest_s), max(time, rest_s)
        if not (sample_s < short * (1 + 1e-9) and long <= _MAX_RATIO * short < math.inf):
            found = f"rest {rest_s:g} s and time {time:g} s"
            ratio = f"at most {_MAX_RATIO:.0f} times the other"
            raise ArgumentError(f"{found}; expected at least a sample ({sample_s:.3g} s) each, and {ratio}")
    vertical, whole = _vertical(axes), _Coasts(times_s=tuple(times_s), rest_s=rest_s)
    groups = [[axis] for axis in axes] if each_axis else [axes]
    quantities = tuple(found for group in groups for found in _quantities(group, vertical, whole))
    return Drift(rest_s=rest_s, level=axes[0].fit.level, vertical=vertical, quantities=quantities)


def _vertical(axes: Sequence[_Axis]) -> str:
    """Return the letter of the axis parallel to gravity, or empty if unknown."""
    means = {axis.axis: abs(axis.mean) for axis in axes if axis.fit.sensor is Sensor.ACCELEROMETER}
    total = math.hypot(*means.values())
    if len(means) < 3 or not abs(total / G0 - 1) < _NEAR_G:
        return ""
    upright = max(means, key=means.__getitem__)
    return upright if means[upright] > _UPRIGHT * total else ""


#: Kind, cause and unit of an error, the axes that cause it, and the number of integrals of their noise.
_Row: TypeAlias = tuple[str, Literal["accelerometer", "tilt", ""], str, Sequence[_Axis], int]


def _quantities(axes: Sequence[_Axis], vertical: str, coasts: "_Coasts") -> Iterator[DriftOf]:
    accels = [axis for axis in axes if axis.fit.sensor is Sensor.ACCELEROMETER]
    upright = [axis for axis in axes if axis not in accels and axis.axis == (vertical or None)]
    tilting = [axis for axis in axes if axis not in accels + upright]
    together: dict[str, DriftOf] = {}
    rows: tuple[_Row, ...] = (
        ("heading", "", "rad", upright, ANGLE),
        ("tilt" if vertical else "angle", "", "rad", tilting, ANGLE),
        ("velocity", "accelerometer", "m/s", accels, ANGLE),
        ("velocity", "tilt", "m/s", tilting, POSITION),
        ("position", "accelerometer", "m", accels, POSITION),
        ("position", "tilt", "m", tilting, TILT),
    )
    for kind, through, unit, own, integrals in rows:
        if own:
            part = DriftOf(kind=kind, through=through, unit=unit, points=coasts.worst(own, integrals))
            yield part
            if kind in together:
                both = tuple(map(_both, together[kind].points, part.points))
                yield DriftOf(kind=kind, through="both", unit=unit, points=both)
            together[kind] = part


@dataclass(frozen=True, kw_only=True)
class _Coasts:
    """Rest and coasts, with cached variances of terms of coefficient 1, which all axes share."""

    times_s: tuple[float, ...]
    rest_s: float
    units: dict[tuple[NoiseTerm, float, int], FloatArray] = field(default_factory=dict)

    def variance(self, axis: _Axis, integrals: int, term: NoiseTerm) -> FloatArray:
        """Return the variance of a term at all times."""
        scale = G0 if axis.fit.sensor is Sensor.GYROSCOPE and integrals > ANGLE else 1.0
        unit = term.of(1.0, *term.values[1:])
        key = unit, axis.fit.rate_hz, integrals
        if key not in self.units:
            self.units[key] = coasting_variance(
                unit, np.array(self.times_s), rest_s=self.rest_s, rate_hz=key[1], integrals=integrals
            )
        return (scale * term.coefficient) ** 2 * self.units[key]

    def worst(self, axes: Sequence[_Axis], integrals: int) -> tuple[DriftPoint, ...]:
        """Return at each time the drift with the largest value, or without values the largest bound."""
        at_times = zip(*(self.points(axis, integrals) for axis in axes), strict=True)
        return tuple(max(points, key=lambda point: (point.value or 0.0, point.high)) for points in at_times)

    def points(self, axis: _Axis, integrals: int) -> list[DriftPoint]:
        fit, variance = axis.fit, partial(self.variance, axis, integrals)
        value = modelled(fit, variance)
        made = {key: own for key, own in shares(fit, variance).items() if own.any()}
        times = [e.correlation_time.high for e in fit.estimates if e.correlation_time]
        low, high = 0 * value, value + math.inf
        if np.isfinite([*times, *(e.high for e in fit.estimates)]).all():
            low, high = lower_limit(fit, variance), upper_limit(fit, variance)
        # A curve without degrees of freedom comes from a model.
        record_s = fit.curve.n / fit.rate_hz if np.isfinite(fit.curve.edf).any() else 0.0
        name = "_".join(filter(None, (fit.sensor.short if fit.sensor else "", axis.axis)))
        points = []
        for i, time_s in enumerate(self.times_s):
            share, term = max(((own[i] / value[i], key) for key, own in made.items()), default=(0.0, ""))
            points.append(
                DriftPoint(
                    time_s=time_s,
                    axis=name,
                    value=math.sqrt(value[i]) or None,
                    low=math.sqrt(low[i]),
                    high=math.sqrt(high[i]),
                    term=term,
                    share=float(share),
                    seen=record_s >= STRETCHES * (time_s + self.rest_s) if record_s else None,
                )
            )
        return points


def _both(one: DriftPoint, other: DriftPoint) -> DriftPoint:
    """Return the drift of two independent parts."""
    ends = [[getattr(part, end) or 0.0 for part in (one, other)] for end in ("value", "low", "high")]
    value, low, high = np.square(ends)
    total = float(value.sum())
    shares = value * [one.share, other.share] / (total or 1.0)
    most = (one, other)[int(np.argmax(shares))]
    return DriftPoint(
        time_s=one.time_s,
        axis=f"{one.axis} {other.axis}",
        value=math.sqrt(total) or None,
        low=math.sqrt(max(total - float(np.linalg.norm(value - low)), 0.0)),
        high=math.sqrt(total + float(np.linalg.norm(high - value))),
        term=f"{most.axis} {most.term}" if most.term else "",
        share=float(shares.max()),
        seen=one.seen and other.seen,
    )
