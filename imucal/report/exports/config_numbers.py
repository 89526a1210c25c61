"""The numbers that go into a file: what covers the fitted spectrum, or the fit's own; inflated on request.

A filter that takes two numbers a sensor gets the pair of `imucal.prediction.filter_numbers`: N and K of the
fit alone leave out its flicker, and a filter with them trusts itself too much.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias, TypedDict, get_args

import numpy as np

from imucal.errors import DataError
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.prediction.filter_numbers import (
    HORIZON_S,
    STEP_S,
    FilterNumbers,
    correlation_times,
    filter_numbers,
)
from imucal.recording import Axis, Sensor
from imucal.report.result import AxisReport, Report

AxisPolicy: TypeAlias = Literal["worst", "rms", "x", "y", "z"]
Unidentified: TypeAlias = Literal["bound", "refuse"]
Basis: TypeAlias = Literal["covered", "as-fitted"]

#: What can be inflated -> the symbols of the terms it multiplies.
INFLATABLE: dict[str, tuple[str, ...]] = {"white": ("N",), "walk": ("K",), "flicker": ("B", "GM")}
#: The two numbers of a filter.
COVERING = ("N", "K")
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
    numbers
        White noise and walk that have ``covered`` the fitted spectrum, or N and K ``as-fitted``.
    horizon_s
        How long the filter may coast; None for what is usual with the format.
    step_s
        How often it is aided.
    """

    axis_policy: AxisPolicy = "worst"
    inflate: Mapping[str, float] = field(default_factory=dict)
    unidentified: Unidentified = "bound"
    topic: str | None = None
    numbers: Basis = "covered"
    horizon_s: float | None = None
    step_s: float = STEP_S

    def __post_init__(self) -> None:
        _require(self.axis_policy, get_args(AxisPolicy), "axis policy")
        _require(self.unidentified, get_args(Unidentified), "choice for unidentified terms")
        _require(self.numbers, get_args(Basis), "choice of numbers")
        longest = math.inf if self.horizon_s is None else self.horizon_s
        if not 0 < self.step_s < longest:
            msg = f"the horizon must be longer than the step, got {longest:g} s and {self.step_s:g} s"
            raise ValueError(msg)
        for name, factor in self.inflate.items():
            _require(name, tuple(INFLATABLE), "inflation")
            if not (math.isfinite(factor) and factor > 0):
                msg = f"inflation of {name} must be a positive number, got {factor}"
                raise ValueError(msg)

    def factor(self, symbol: str) -> float:
        """Return the factor on a term's coefficient; 1 where nothing was asked."""
        return next((factor for name, factor in self.inflate.items() if symbol in INFLATABLE[name]), 1.0)


class Options(TypedDict, total=False):
    """The attributes of `Choices`, each with a usual value where it is not given."""

    axis_policy: AxisPolicy
    inflate: Mapping[str, float]
    unidentified: Unidentified
    topic: str | None
    numbers: Basis
    horizon_s: float | None
    step_s: float


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
        Confidence level of the bound and of the interval.
    interval
        The coefficient's limits, inflation included; None for a bound or for several axes.
    excess
        A bound over the largest coefficient whose line stays below the measured Allan curve; None for
        a value or for several axes.
    alternatives
        Symbols of terms that may stand in this one's place: the record can't tell which.
    origin
        What the number is, where it is no estimate of one record.
    covers
        Whether `value` is of a pair that covers the spectra of `axes`; the rest is of the fit's own number.
    """

    symbol: str
    value: float
    axes: tuple[str, ...]
    bounded: tuple[str, ...]
    level: float
    interval: tuple[float, float] | None = None
    excess: float | None = None
    alternatives: tuple[str, ...] = ()
    origin: str = ""
    covers: bool = False

    @property
    def note(self) -> str:
        """Where the number comes from and how well it is known, for a comment beside it."""
        if self.covers:
            return f"covers {', '.join(self.axes)}{self.origin and f', {self.origin}'}"
        text = f"{self.symbol} of {', '.join(self.axes)}{self._certainty()}"
        if not self.alternatives:
            return text
        return f"{text}; {' or '.join((self.symbol, *self.alternatives))}: this record can't tell which"

    def _certainty(self) -> str:
        if self.origin:
            return f", {self.origin}"
        level = f"{self.level:.0%}"
        if self.interval:
            return f", {level} {self.interval[0]:.4g} to {self.interval[1]:.4g}"
        if not self.bounded:
            return ""
        if self.bounded != self.axes:
            return f"; UPPER BOUND ({level}) on {', '.join(self.bounded)}"
        text = f", UPPER BOUND ({level}): the data do not show this term"
        if not self.excess:
            return text
        return f"{text}; {self.excess:.2g} x its line that touches the measured curve"


@dataclass(frozen=True, slots=True, kw_only=True)
class WithBias:
    """An axis as white noise and a first-order Gauss-Markov bias, dx/dt = -x/T + driving * w(t).

    Attributes
    ----------
    white
        Its N.
    driving
        Density of the noise that drives the bias, in U/sqrt(s).
    correlation_time
        T, in s.
    used
        The numbers it is made of.
    note
        Where they come from.
    """

    white: float
    driving: float
    correlation_time: float
    used: tuple[Number, ...]
    note: str

    @property
    def sigma(self) -> float:
        """Steady-state standard deviation of the bias, in U."""
        return self.driving * math.sqrt(self.correlation_time / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Numbers:
    """A report as a file format sees it.

    Every method raises `DataError` where the report has no number to give: a sensor or an axis is
    missing, or a term was not identified and the user refused its bound. A log of one sensor gives a
    format the half that is about it, so formats go over `sensors`.
    """

    report: Report
    choices: Choices
    target: str
    covers: bool = False
    horizon_s: float = HORIZON_S

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors of the log, the gyroscope first."""
        return tuple(self.report.by_sensor)

    @property
    def stream_hz(self) -> float:
        """The one rate of a file that has but one: the gyroscope's, else the accelerometer's.

        A program with one rate reads both sensors as one stream of messages, the slower one
        interpolated. N and K are densities and stay; what is discrete belongs to the stream.
        """
        return self.rate_hz(self.sensors[0])

    def axes(self, sensor: Sensor) -> tuple[AxisReport, ...]:
        """Return the axes of a sensor; at least one."""
        if sensor not in self.report.by_sensor:
            raise self._missing(str(sensor))
        return tuple(self.report.by_sensor[sensor])

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
        axes = self.chosen(sensor)
        if self.covers and symbol in COVERING:
            return self._covering(axes, symbol)
        numbers = [self.of(axis, symbol) for axis in axes]
        if len(numbers) == 1 or self.choices.axis_policy == "worst":
            return max(numbers, key=lambda number: number.value)
        value = math.sqrt(sum(number.value**2 for number in numbers) / len(numbers))
        return _joined(numbers, value)

    def chosen(self, sensor: Sensor) -> tuple[AxisReport, ...]:
        """Return the axes that one number for a sensor is made of, by the axis policy."""
        policy = self.choices.axis_policy
        return (self.axis(sensor, policy),) if policy in ("x", "y", "z") else self.axes(sensor)

    def each(self, sensor: Sensor, symbol: str) -> tuple[Number, Number, Number]:
        """Return a number for each of the three axes; the axis policy plays no part."""
        covers = self.covers and symbol in COVERING
        x, y, z = (
            self._covering((axis,), symbol) if covers else self.of(axis, symbol)
            for axis in self.triad(sensor)
        )
        return x, y, z

    def pair(self, axes: Sequence[AxisReport], *, time_s: float | None = None) -> FilterNumbers:
        """Return white noise and a walk, or a bias that forgets, which cover the spectra of some axes.

        The inflation of flicker is in it, that of white noise and walk is not.
        """
        return filter_numbers(
            [self._inflated(axis.fit) for axis in axes],
            horizon_s=self.horizon_s,
            step_s=self.choices.step_s,
            joined="rms" if self.choices.axis_policy == "rms" else "worst",
            time_s=time_s,
        )

    def _inflated(self, fit: NoiseFit) -> NoiseFit:
        factor, symbols = self.choices.factor("B"), INFLATABLE["flicker"]
        if factor == 1:
            return fit
        estimates = (
            replace(e, value=e.value and e.value * factor, low=e.low * factor, high=e.high * factor)
            if e.symbol in symbols
            else e
            for e in fit.estimates
        )
        # A term that the table bounds counts with the model's value.
        terms = (
            term.of(term.coefficient * factor, *term.values[1:]) if term.symbol in symbols else term
            for term in fit.model.terms
        )
        return replace(fit, estimates=tuple(estimates), model=NoiseModel(terms=tuple(terms)))

    def _covering(self, axes: Sequence[AxisReport], symbol: str) -> Number:
        pair = self.pair(axes)
        value = {"N": pair.white, "K": pair.walk}[symbol] * self.choices.factor(symbol)
        return replace(_joined([self.of(axis, symbol) for axis in axes], value), covers=True)

    def of(self, axis: AxisReport, symbol: str) -> Number:
        """Return one axis's coefficient of N, B or K, or its upper bound."""
        estimate = axis.fit[symbol]
        # A model that was given is without the terms that it lacks, not uncertain of them.
        bounded, factor = estimate.value is None and estimate.high > 0, self.choices.factor(symbol)
        if bounded and self.choices.unidentified == "refuse":
            raise self._refused(axis, estimate)
        value = factor * (estimate.high if estimate.value is None else estimate.value)
        covered = self.covers and symbol in COVERING
        return Number(
            symbol=symbol,
            value=value if covered else self._positive(value, symbol, axis.name),
            axes=(axis.name,),
            bounded=(axis.name,) if bounded else (),
            level=axis.fit.level,
            interval=None if bounded else (estimate.low * factor, estimate.high * factor),
            excess=_excess(axis, estimate) if bounded else None,
            alternatives=estimate.alternatives,
            origin=estimate.origin,
        )

    def gauss_markov(self, axis: AxisReport) -> tuple[float, float] | None:
        """Return sigma (inflated) and T of an axis's slowest Gauss-Markov term; None where it has none."""
        terms = [
            (estimate.correlation_time.value, estimate.value)
            for estimate in axis.fit.estimates
            if estimate.symbol == GaussMarkov.symbol
            and estimate.value
            and estimate.correlation_time is not None
        ]
        if not terms:
            return None
        correlation_time, sigma = max(terms)
        return sigma * self.choices.factor(GaussMarkov.symbol), correlation_time

    def with_bias(self, axes: Sequence[AxisReport]) -> list[WithBias]:
        """Return each axis as white noise and a bias, all of one correlation time.

        Covered: of the fits' own times and one long against the horizon, the T that costs all axes least. As
        fitted: the longest T; an axis with a shorter one keeps the noise that drives it.
        """
        if not self.covers:
            fitted = [self._fitted_bias(axis) for axis in axes]
            time = max(each.correlation_time for each in fitted)
            return [replace(each, correlation_time=time) for each in fitted]
        pairs = self.timed([[axis] for axis in axes])
        return [
            WithBias(
                white=pair.white * self.choices.factor("N"),
                driving=pair.walk * self.choices.factor("K"),
                correlation_time=pair.correlation_time_s or math.inf,
                used=tuple(self._covering([axis], symbol) for symbol in COVERING),
                note=f"{axis.name}: covered by white noise and a bias of T {pair.correlation_time_s:.4g} s",
            )
            for axis, pair in zip(axes, pairs, strict=True)
        ]

    def timed(self, groups: Sequence[Sequence[AxisReport]]) -> list[FilterNumbers]:
        """Return what covers each group of axes, with a bias of the one T that costs them all least.

        It is that of a term of a fit, or long against the horizon, so that the bias walks.
        """
        fits = [axis.fit for axes in groups for axis in axes]
        tried = (
            [self.pair(axes, time_s=time) for axes in groups]
            for time in correlation_times(fits, horizon_s=self.horizon_s)
        )
        return min(tried, key=lambda pairs: math.prod(pair.price for pair in pairs))

    def forgetful(self, sensor: str) -> dict[str, float]:
        """Return N, K and T of a sensor's white noise and bias that cover; nothing for the fit's own."""
        if not self.covers or sensor not in self.sensors:
            return {}
        (pair,) = self.timed([self.chosen(Sensor(sensor))])
        time = pair.correlation_time_s or NOMINAL_TIME_S
        factor = self.choices.factor
        return {"N": pair.white * factor("N"), "K": pair.walk * factor("K"), "T": time}

    def times(self, sensor: str) -> list[tuple[float, str]]:
        """Return T of each axis's slowest Gauss-Markov term, with the name of the axis."""
        axes = self.axes(Sensor(sensor)) if sensor in self.sensors else ()
        return [(term[1], axis.name) for axis in axes if (term := self.gauss_markov(axis))]

    def _fitted_bias(self, axis: AxisReport) -> WithBias:
        """Return N and the process that best stands for what is slower.

        A random walk that was found wins, with a nominal T: it goes on at the longest times, and a
        short T would stop it. Else the slowest Gauss-Markov term, with its own T, also where that is what the
        walk is. Else the bound on K.
        """
        white, term = self.of(axis, "N"), self.gauss_markov(axis)
        if term is not None and (axis.fit["K"].value is None or axis.fit["K"].drawn is None):
            sigma, time = term
            note = f"{white.note}; Gauss-Markov term of {axis.name}: sigma {sigma:.4g}, T {time:.4g} s"
            return WithBias(
                white=white.value,
                driving=sigma * math.sqrt(2 / time),
                correlation_time=time,
                used=(white,),
                note=note,
            )
        walk = self.of(axis, "K")
        left_out = "" if term is None else f"; a Gauss-Markov term (T {term[1]:.4g} s) is left out"
        return WithBias(
            white=white.value,
            driving=walk.value,
            correlation_time=NOMINAL_TIME_S,
            used=(white, walk),
            note=f"{white.note}; {walk.note}; T is nominal{left_out}",
        )

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

    def _refused(self, axis: AxisReport, estimate: Estimate) -> DataError:
        unit = TERMS[estimate.symbol].unit(axis.sensor)
        msg = (
            f"{self.report.source.path}: {axis.name}: {estimate.symbol} was not identified "
            f"(upper bound {estimate.high:.3g} {unit}), but {self.target} needs a value; "
            "accept the bound, choose an axis that shows the term, or record for longer"
        )
        return DataError(msg)

    def _positive(self, value: float, symbol: str, name: str) -> float:
        if math.isfinite(value) and value > 0:
            return value
        msg = (
            f"{self.report.source.path}: {name}: {symbol} is {value}, "
            f"but {self.target} needs a positive number; choose another axis, or a model that has it"
        )
        raise DataError(msg)

    def _missing(self, what: str) -> DataError:
        found = ", ".join(axis.name for axis in self.report.axes) or "no axis"
        msg = (
            f"{self.report.source.path}: no {what}, which {self.target} needs; found {found}; "
            "use a log that holds both sensors with all their axes"
        )
        return DataError(msg)


def _joined(numbers: Sequence[Number], value: float) -> Number:
    """Return a number that is made of those of several axes."""
    if len(numbers) == 1:
        return replace(numbers[0], value=value)
    return Number(
        symbol=numbers[0].symbol,
        value=value,
        axes=tuple(name for number in numbers for name in number.axes),
        bounded=tuple(name for number in numbers for name in number.bounded),
        level=numbers[0].level,
        alternatives=tuple(dict.fromkeys(each for number in numbers for each in number.alternatives)),
        origin=numbers[0].origin,
    )


def _excess(axis: AxisReport, estimate: Estimate) -> float | None:
    """Return how far a bound lies above the largest coefficient that fits under the measured curve."""
    curve = axis.fit.curve
    unit = TERMS[estimate.symbol].of(1.0).avar(curve.m.astype(np.float64), 1 / axis.fit.rate_hz)
    below = float(np.sqrt(np.min(curve.avar / unit, initial=np.inf)))
    return estimate.high / below if 0 < below < math.inf else None


def _require(value: str, choices: tuple[str, ...], what: str) -> None:
    if value not in choices:
        msg = f"{what} {value!r} is not one of {', '.join(choices)}"
        raise ValueError(msg)
