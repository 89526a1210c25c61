"""How far dead reckoning drifts after a rest: angles, velocities and positions, with limits.

At rest the mean of the samples is taken for the bias; then nothing aids it. The error of an angle is the
gyroscope's noise summed up, that of a velocity and a position the accelerometer's, once and twice. And a
tilt lets gravity in: g times the gyroscope's noise, summed up twice and three times. It is the sensors'
noise alone, over a flat Earth that stands still, without scale, misalignment or temperature. What comes
through tilt swings with a period of 84 minutes: it is less by 0.7 % at 300 s, by 8 % at 1000 s.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import field
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from imucal.arguments import takes
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.fitting.noise_fit import NoiseFit
from imucal.frozen import frozen
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


@frozen
class DriftPoint:
    """One standard deviation of an error after a time `time_s`, in s, in which nothing has aided.

    `axis` is such as ``gyro_z``, the one with the largest value of several; ``accel_x gyro_y`` where two
    parts make it. `value` is that of the fitted model, None where the record shows no term; `low` and `high`
    are limits at the fit's level, bounded terms included, 0 and infinity where a term's are not known.
    `term`, such as ``B``, makes most of the value's square, by a share of `share`; empty without a value.
    `seen` says whether the record holds `STRETCHES` such rests and coasts: if not, the model is taken to go
    on as it does; None without a record.
    """

    time_s: float
    axis: str
    value: float | None
    low: float
    high: float
    term: str
    share: float
    seen: bool | None


@frozen
class DriftOf:
    """The drift of one quantity: ``heading``, ``tilt``, ``angle``, ``velocity through tilt``, …, in SI."""

    name: str
    unit: str
    points: tuple[DriftPoint, ...]


@frozen
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


@takes("imucal.drift(report)")
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
    if not isinstance(source, NoiseFit) and not hasattr(source, "axes"):
        raise ArgumentError("drift: expected a report or a fit; type imucal.drift(imucal.fit(recording))")
    given = [_Axis("", 0.0, source)] if isinstance(source, NoiseFit) else source.axes
    axes = [_Axis(axis.axis, axis.mean, axis.fit) for axis in given if axis.fit.sensor is not None]
    if not axes:
        raise DataError("no axis of a known sensor; expected a gyroscope or an accelerometer")
    sample_s = max(1 / axis.fit.rate_hz for axis in axes)
    for time in times_s:
        short, long = min(time, rest_s), max(time, rest_s)
        if not (sample_s < short * (1 + 1e-9) and long <= _MOST_UNLIKE * short < math.inf):
            found = f"rest {rest_s:g} s and time {time:g} s"
            ratio = f"at most {_MOST_UNLIKE:.0f} times the other"
            raise ArgumentError(f"{found}; expected at least a sample ({sample_s:.3g} s) each, and {ratio}")
    vertical, whole = _vertical(axes), _Coasts(times_s=tuple(times_s), rest_s=rest_s)
    groups = [[axis] for axis in axes] if each_axis else [axes]
    quantities = tuple(found for group in groups for found in _quantities(group, vertical, whole))
    return Drift(rest_s=rest_s, level=axes[0].fit.level, vertical=vertical, quantities=quantities)


def _vertical(axes: Sequence[_Axis]) -> str:
    """Return the letter of the axis that gravity lies along; empty where the means don't tell."""
    means = {axis.axis: abs(axis.mean) for axis in axes if axis.fit.sensor is Sensor.ACCELEROMETER}
    total = math.hypot(*means.values())
    if len(means) < 3 or not abs(total / G0 - 1) < _NEAR_G:
        return ""
    upright = max(means, key=means.__getitem__)
    return upright if means[upright] > _UPRIGHT * total else ""


def _quantities(axes: Sequence[_Axis], vertical: str, coasts: "_Coasts") -> Iterator[DriftOf]:
    """Yield what the worst of the axes make, and what both sensors make together."""
    accels = [axis for axis in axes if axis.fit.sensor is Sensor.ACCELEROMETER]
    upright = [axis for axis in axes if axis not in accels and axis.axis == (vertical or None)]
    tilting = [axis for axis in axes if axis not in accels + upright]
    together: dict[str, DriftOf] = {}
    for name, unit, own, integrals in (
        ("heading", "rad", upright, ANGLE),
        ("tilt" if vertical else "angle", "rad", tilting, ANGLE),
        ("velocity from the accelerometer", "m/s", accels, ANGLE),
        ("velocity through tilt", "m/s", tilting, POSITION),
        ("position from the accelerometer", "m", accels, POSITION),
        ("position through tilt", "m", tilting, TILT),
    ):
        if own:
            part = DriftOf(name=name, unit=unit, points=coasts.worst(own, integrals))
            yield part
            if unit != "rad" and unit in together:
                both = tuple(map(_both, together[unit].points, part.points))
                yield DriftOf(name=f"{name.split()[0]}, both", unit=unit, points=both)
            together[unit] = part


@frozen
class _Coasts:
    """Rest and coasts; and the variances of terms whose coefficient is 1, which all axes share."""

    times_s: tuple[float, ...]
    rest_s: float
    units: dict[tuple[NoiseTerm, float, int], FloatArray] = field(default_factory=dict)

    def variance(self, axis: _Axis, integrals: int, term: NoiseTerm) -> FloatArray:
        """Return the variance of a term at all times, shape (t,), through a tilt in m/s or m."""
        scale = G0 if axis.fit.sensor is Sensor.GYROSCOPE and integrals > ANGLE else 1.0
        unit = term.of(1.0, *term.values[1:])
        key = unit, axis.fit.rate_hz, integrals
        if key not in self.units:
            self.units[key] = coasting_variance(
                unit, np.array(self.times_s), rest_s=self.rest_s, rate_hz=key[1], integrals=integrals
            )
        return (scale * term.coefficient) ** 2 * self.units[key]

    def worst(self, axes: Sequence[_Axis], integrals: int) -> tuple[DriftPoint, ...]:
        """Return at each time the drift that has the largest value, or, without one, the largest bound."""
        at_times = zip(*(self.points(axis, integrals) for axis in axes), strict=True)
        return tuple(max(points, key=lambda point: (point.value or 0.0, point.high)) for points in at_times)

    def points(self, axis: _Axis, integrals: int) -> list[DriftPoint]:
        """Return the drift of one axis at all times."""
        fit, variance = axis.fit, partial(self.variance, axis, integrals)
        value = modelled(fit, variance)
        made = {key: own for key, own in shares(fit, variance).items() if own.any()}
        times = [e.correlation_time.high for e in fit.estimates if e.correlation_time]
        low, high = 0 * value, value + math.inf
        if np.isfinite([*times, *(e.high for e in fit.estimates)]).all():
            low, high = lower_limit(fit, variance), upper_limit(fit, variance)
        # A curve without degrees of freedom is a model's, and no record's.
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
    """Return the drift of parts that know nothing of each other: squares add up, and limits as of any sum."""
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
