"""The numbers that go into a file: chosen among the axes, bounded where unknown, inflated on request."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias, get_args

from imucal.errors import DataError
from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.recording import Axis, Sensor
from imucal.report.result import AxisReport, Report

AxisPolicy: TypeAlias = Literal["worst", "rms", "x", "y", "z"]
Unidentified: TypeAlias = Literal["bound", "refuse"]

#: What can be inflated -> the symbols of the terms it multiplies.
INFLATABLE: dict[str, tuple[str, ...]] = {"white": ("N",), "walk": ("K",), "flicker": ("B", "GM")}
#: Correlation time where none was measured, in s: long against the record, so that a walk stays one.
NOMINAL_TIME_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Choices:
    """What the user decides about a downstream file.

    Attributes
    ----------
    axis_policy
        For formats with one number a sensor: ``worst``, the largest of the axes; ``rms``, the root
        of the mean variance; or one axis, ``x``, ``y`` or ``z``.
    inflate
        ``white``, ``walk`` or ``flicker`` -> factor on the coefficient (a deviation, not a variance).
    unidentified
        For a term that the data do not show: write its upper ``bound``, or ``refuse``.
    topic
        Topic to write, for formats that name one; None for the log's own.
    """

    axis_policy: AxisPolicy = "worst"
    inflate: Mapping[str, float] = field(default_factory=dict)
    unidentified: Unidentified = "bound"
    topic: str | None = None

    def __post_init__(self) -> None:
        _require(self.axis_policy, get_args(AxisPolicy), "axis policy")
        _require(self.unidentified, get_args(Unidentified), "choice for unidentified terms")
        for name, factor in self.inflate.items():
            _require(name, tuple(INFLATABLE), "inflation")
            if not (math.isfinite(factor) and factor > 0):
                msg = f"inflation of {name} must be a positive number, got {factor}"
                raise ValueError(msg)

    def factor(self, symbol: str) -> float:
        """Return the factor on a term's coefficient; 1 where nothing was asked."""
        for name, symbols in INFLATABLE.items():
            if symbol in symbols:
                return self.inflate.get(name, 1.0)
        return 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """One coefficient as it goes into a file.

    Attributes
    ----------
    symbol
        Its term.
    value
        The coefficient in SI, positive, inflation included.
    axes
        The axes it was made from: one, or all of the sensor's for ``rms``.
    bounded
        Those of `axes` whose upper bound stands in for a value.
    level
        Confidence level of the bound.
    """

    symbol: str
    value: float
    axes: tuple[str, ...]
    bounded: tuple[str, ...]
    level: float

    @property
    def note(self) -> str:
        """Where the number comes from, for a comment beside it."""
        origin = f"{self.symbol} of {', '.join(self.axes)}"
        if not self.bounded:
            return origin
        if self.bounded == self.axes:
            return f"{origin}, UPPER BOUND ({self.level:.0%}): the data do not show this term"
        return f"{origin}; UPPER BOUND ({self.level:.0%}) on {', '.join(self.bounded)}"


class Densities(NamedTuple):
    """N and K of both sensors, continuous, by the user's axis policy."""

    accel_n: Number
    accel_k: Number
    gyro_n: Number
    gyro_k: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowNoise:
    """A first-order Gauss-Markov process dx/dt = -x/T + driving * w(t).

    Attributes
    ----------
    driving
        Density of the driving noise, in U/sqrt(s); sigma = driving * sqrt(T/2).
    correlation_time
        T, in s.
    number
        The K it stands for; None where it is a Gauss-Markov term of the fit.
    note
        Where it comes from.
    """

    driving: float
    correlation_time: float
    number: Number | None
    note: str

    @property
    def sigma(self) -> float:
        """Steady-state standard deviation, in U."""
        return self.driving * math.sqrt(self.correlation_time / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Numbers:
    """A report as a file format sees it.

    Every method raises `DataError` where the report has no number to give: a sensor or an axis is
    missing, or a term was not identified and the user refused its bound.
    """

    report: Report
    choices: Choices
    target: str

    def axes(self, sensor: Sensor) -> tuple[AxisReport, ...]:
        """Return the axes of a sensor; at least one."""
        axes = tuple(axis for axis in self.report.axes if axis.sensor is sensor)
        if not axes:
            raise self._missing(str(sensor))
        return axes

    def axis(self, sensor: Sensor, axis: Axis) -> AxisReport:
        """Return one axis."""
        for candidate in self.axes(sensor):
            if candidate.axis == axis:
                return candidate
        name = f"{sensor.short}_{axis}"
        raise self._missing(name)

    def triad(self, sensor: Sensor) -> tuple[AxisReport, AxisReport, AxisReport]:
        """Return all three axes of a sensor."""
        return self.axis(sensor, "x"), self.axis(sensor, "y"), self.axis(sensor, "z")

    def rate_hz(self, sensor: Sensor) -> float:
        """Return the sensor's sampling rate, to nine digits: no clock is known better."""
        return float(f"{self.axes(sensor)[0].rate_hz:.9g}")

    def one(self, sensor: Sensor, symbol: str) -> Number:
        """Return one number for a sensor, by the axis policy."""
        policy = self.choices.axis_policy
        if policy in ("x", "y", "z"):
            return self.of(self.axis(sensor, policy), symbol)
        numbers = [self.of(axis, symbol) for axis in self.axes(sensor)]
        if policy == "worst":
            return max(numbers, key=lambda number: number.value)
        return Number(
            symbol=symbol,
            value=math.sqrt(sum(number.value**2 for number in numbers) / len(numbers)),
            axes=tuple(name for number in numbers for name in number.axes),
            bounded=tuple(name for number in numbers for name in number.bounded),
            level=numbers[0].level,
        )

    def each(self, sensor: Sensor, symbol: str) -> tuple[Number, Number, Number]:
        """Return a number for each of the three axes; the axis policy plays no part."""
        x, y, z = self.triad(sensor)
        return self.of(x, symbol), self.of(y, symbol), self.of(z, symbol)

    def of(self, axis: AxisReport, symbol: str) -> Number:
        """Return one axis's coefficient of N, B or K, or its upper bound."""
        estimate = axis.fit[symbol]
        if estimate.value is None:
            self._refuse_bound(axis, estimate)
        coefficient = estimate.high if estimate.value is None else estimate.value
        return Number(
            symbol=symbol,
            value=self._positive(coefficient * self.choices.factor(symbol), symbol, axis.name),
            axes=(axis.name,),
            bounded=(axis.name,) if estimate.value is None else (),
            level=axis.fit.level,
        )

    def gauss_markov(self, axis: AxisReport) -> tuple[float, float] | None:
        """Return sigma (inflated) and T of an axis's slowest Gauss-Markov term; None where it has none."""
        terms = [
            (estimate.correlation_time.value, estimate.value)
            for estimate in axis.fit.estimates
            if estimate.symbol == "GM" and estimate.value and estimate.correlation_time is not None
        ]
        if not terms:
            return None
        correlation_time, sigma = max(terms)
        return sigma * self.choices.factor("GM"), correlation_time

    def densities(self) -> Densities:
        """Return N and K of both sensors, which most formats hold."""
        return Densities(
            accel_n=self.one(Sensor.ACCELEROMETER, "N"),
            accel_k=self.one(Sensor.ACCELEROMETER, "K"),
            gyro_n=self.one(Sensor.GYROSCOPE, "N"),
            gyro_k=self.one(Sensor.GYROSCOPE, "K"),
        )

    def slow(self, axis: AxisReport) -> SlowNoise:
        """Return the process that best stands for what is slower than white noise.

        A random walk that was found wins, with a nominal T: it goes on at the longest times, and a
        short T would stop it. Else the slowest Gauss-Markov term, with its own T. Else the bound on K.
        """
        term = self.gauss_markov(axis)
        if term is not None and axis.fit["K"].value is None:
            sigma, time = term
            return SlowNoise(
                driving=sigma * math.sqrt(2 / time),
                correlation_time=time,
                number=None,
                note=f"Gauss-Markov term of {axis.name}: sigma {sigma:.4g}, T {time:.4g} s",
            )
        walk = self.of(axis, "K")
        note = f"{walk.note}; T is nominal"
        return SlowNoise(driving=walk.value, correlation_time=NOMINAL_TIME_S, number=walk, note=note)

    def topic(self) -> tuple[str, str]:
        """Return the IMU topic to write, and a remark on where it comes from."""
        if self.choices.topic is not None:
            return self.choices.topic, "as given"
        source = self.report.source
        if not source.message_types:
            return "/imu0", "the log names no topic; set yours"
        # An IMU of a message that holds several is chosen as /topic:part; only the topic is ROS's.
        topic = source.topics[0].partition(":")[0]
        if len(source.topics) > 1:
            return topic, f"one of {', '.join(source.topics)}; set the topic that holds both sensors"
        return topic, "the log's topic"

    def _refuse_bound(self, axis: AxisReport, estimate: Estimate) -> None:
        if self.choices.unidentified != "refuse":
            return
        unit = TERMS[estimate.symbol].unit(axis.sensor)
        msg = (
            f"{self.report.source.path}: {axis.name}: {estimate.symbol} was not identified "
            f"(upper bound {estimate.high:.3g} {unit}), but {self.target} needs a value; "
            "accept the bound, choose an axis that shows the term, or record for longer"
        )
        raise DataError(msg)

    def _positive(self, value: float, symbol: str, name: str) -> float:
        if math.isfinite(value) and value > 0:
            return value
        msg = (
            f"{self.report.source.path}: {name}: {symbol} is {value}, "
            f"but {self.target} needs a positive number; choose another axis or fit again"
        )
        raise DataError(msg)

    def _missing(self, what: str) -> DataError:
        found = ", ".join(axis.name for axis in self.report.axes) or "no axis"
        msg = (
            f"{self.report.source.path}: no {what}, which {self.target} needs; found {found}; "
            "use a log that holds both sensors with all their axes"
        )
        return DataError(msg)


def _require(value: str, choices: tuple[str, ...], what: str) -> None:
    if value not in choices:
        msg = f"{what} {value!r} is not one of {', '.join(choices)}"
        raise ValueError(msg)
