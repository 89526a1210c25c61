"""The numbers that go into a file: what covers the fitted spectrum, or the fit's own; inflated on request.

A filter that takes two numbers a sensor gets the pair of `imucal.prediction.filter_numbers`: N and K of the
fit alone leave out its flicker, and a filter with them trusts itself too much.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Literal, TypeAlias, TypedDict, get_args

import numpy as np

from imucal.errors import DataError
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.frozen import frozen, frozen_alone
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
#: Of a bank of Gauss-Markov processes that stands for flicker: states a decade of correlation time, and how
#: far it reaches below the time at which flicker and white noise are equal.
_PER_DECADE, _MARGIN = 1.5, 10.0
#: Ratio of the limits of N above which it is no number for a filter.
_VAGUE = 10.0
#: Correlation time where none was measured, in s: long against the record, so that a walk stays one.
NOMINAL_TIME_S = 3600.0


@frozen
class Choices:
    """What the user decides about a downstream file.

    `axis_policy` is for formats with one number a sensor: ``worst``, the largest of the axes; ``rms``, the
    root of the mean variance; or one axis, ``x``, ``y`` or ``z``. `inflate` has for ``white``, ``walk`` or
    ``flicker`` a factor on the coefficient (a deviation, not a variance). A term that the data do not show
    is written as its upper ``bound``, or `unidentified` says to ``refuse``. `topic` is the one to write,
    for formats that name one; None for the log's own. `numbers` are white noise and walk that have
    ``covered`` the fitted spectrum, or N and K ``as-fitted``. The filter may coast for `horizon_s`, None
    for what is usual with the format, and is aided every `step_s`.
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
                raise ValueError(f"inflation of {name} must be a positive number, got {factor}")

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


@frozen
class Number:
    """One positive coefficient as it goes into a file, in SI, inflation included; `symbol` is its term.

    It was made from some `axes`: one, or all of the sensor's for ``rms``; of those that are `bounded` the
    upper bound, at a confidence `level`, stands in for a value. Its `interval` is None for a bound or for
    several axes, and so is, for a value too, `excess`: a bound over the largest coefficient whose line
    stays below the measured Allan curve. `alternatives` are symbols of terms that may stand in this one's
    place: the record can't tell which. `origin` says what the number is, where it is no estimate of one
    record. Where it `covers`, `value` is of a pair that covers the spectra of the axes; the rest is of the
    fit's own number.
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
        return f"{text}; {' or '.join((self.symbol, *self.alternatives))}: this record can't distinguish them"

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
        return f"{text}; {self.excess:.2g} x the line that touches the measured curve"


@frozen
class WithBias:
    """An axis as white noise N and a first-order Gauss-Markov bias, dx/dt = -x/T + driving * w(t).

    `driving` is the density of the noise that drives the bias, in U/sqrt(s), T is in s; `used` are the
    numbers it is made of, `note` says where they come from.
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


@frozen_alone
class Numbers:
    """A report as a file format sees it.

    Every method raises `DataError` where the report has no number to give: a sensor or an axis is
    missing, or a term was not detected and the user refused its bound. A log of one sensor gives a
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
        raise self._missing(f"{sensor.short}_{axis}")

    def triad(self, sensor: Sensor) -> tuple[AxisReport, AxisReport, AxisReport]:
        """Return all three axes of a sensor."""
        return self.axis(sensor, "x"), self.axis(sensor, "y"), self.axis(sensor, "z")

    def rate_hz(self, sensor: Sensor) -> float:
        """Return the sensor's sampling rate, to nine digits: no clock is known better."""
        return float(f"{self.axes(sensor)[0].rate_hz:.9g}")

    def one(self, sensor: Sensor, symbol: str) -> Number:
        """Return one number for a sensor, by the axis policy."""
        return self._number(self.chosen(sensor), symbol)

    def _number(self, axes: Sequence[AxisReport], symbol: str) -> Number:
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

    def each(self, sensor: Sensor, symbol: str) -> tuple[Number, ...]:
        """Return a number for each of the three axes; the axis policy plays no part."""
        return tuple(self._number([axis], symbol) for axis in self.triad(sensor))

    def pair(self, axes: Sequence[AxisReport], *, time_s: float | None = None) -> FilterNumbers:
        """Return white noise and a walk, or a bias that forgets, which cover the spectra of some axes.

        They are inflated: by flicker what is covered, by white noise and walk what covers it.
        """
        found = filter_numbers(
            [self._inflated(axis.fit) for axis in axes],
            horizon_s=self.horizon_s,
            step_s=self.choices.step_s,
            joined="rms" if self.choices.axis_policy == "rms" else "worst",
            time_s=time_s,
        )
        factor = self.choices.factor
        return replace(found, white=found.white * factor("N"), walk=found.walk * factor("K"))

    def pairs(self, *, per_axis: bool) -> Iterator[tuple[tuple[AxisReport, ...], FilterNumbers]]:
        """Yield the pair of each axis, or of each sensor by the axis policy, with its axes."""
        for sensor in self.sensors:
            for axes in zip(self.triad(sensor)) if per_axis else [self.chosen(sensor)]:
                yield axes, self.pair(axes)

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
        numbers = [self.of(axis, symbol) for axis in axes]
        return replace(_joined(numbers, pair.white if symbol == "N" else pair.walk), covers=True)

    def of(self, axis: AxisReport, symbol: str) -> Number:
        """Return one axis's coefficient of N, B or K, or its upper bound."""
        estimate = axis.fit[symbol]
        # A model that was given is without the terms that it lacks, not uncertain of them.
        bounded, factor = estimate.value is None and estimate.high > 0, self.choices.factor(symbol)
        if bounded and self.choices.unidentified == "refuse":
            unit = TERMS[symbol].unit(axis.sensor)
            msg = (
                f"{self.report.source.path}: {axis.name}: {symbol} was not detected "
                f"(upper bound {estimate.high:.3g} {unit}), but {self.target} needs a value; "
                "accept the bound, choose an axis that shows the term, or record for longer"
            )
            raise DataError(msg)
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

    def gauss_markov(self, axis: AxisReport) -> dict[str, GaussMarkov]:
        """Return an axis's Gauss-Markov terms (inflated) by their keys."""
        return {
            e.key: GaussMarkov(sigma=e.value * self.choices.factor(e.symbol), T=e.correlation_time.value)
            for e in axis.fit.estimates
            if e.symbol == GaussMarkov.symbol and e.value and e.correlation_time
        }

    def slowest(self, axis: AxisReport) -> GaussMarkov | None:
        """Return an axis's slowest Gauss-Markov term (inflated); None where it has none."""
        return max(self.gauss_markov(axis).values(), key=lambda term: (term.T, term.sigma), default=None)

    def with_bias(self, axes: Sequence[AxisReport]) -> list[WithBias]:
        """Return each axis as white noise and a bias, all of one correlation time.

        Covered: try each fitted T and one far beyond the horizon, and take the cheapest for all axes. As
        fitted: the longest T; an axis with a shorter one keeps the noise that drives it.
        """
        if not self.covers:
            fitted = [self._fitted_bias(axis) for axis in axes]
            time = max(each.correlation_time for each in fitted)
            return [replace(each, correlation_time=time) for each in fitted]
        pairs = self.timed([[axis] for axis in axes])
        return [
            WithBias(
                white=pair.white,
                driving=pair.walk,
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
        return {"N": pair.white, "K": pair.walk, "T": pair.correlation_time_s or NOMINAL_TIME_S}

    def times(self, sensor: str) -> list[tuple[float, str]]:
        """Return T of each axis's slowest Gauss-Markov term, with the name of the axis."""
        axes = self.axes(Sensor(sensor)) if sensor in self.sensors else ()
        return [(term.T, axis.name) for axis in axes if (term := self.slowest(axis))]

    def states(self, axis: AxisReport) -> Iterator[tuple[str, GaussMarkov]]:
        """Yield an axis's slow noise as states x[t+1] = phi x[t] + q w[t], with the name of the term of each.

        These are its Gauss-Markov terms, and a bank of them for its flicker, from where that begins to stand
        out of the white noise to the length of the record.
        """
        yield from self.gauss_markov(axis).items()
        if axis.fit["B"].value is None:
            return
        period = 1 / float(f"{axis.rate_hz:.9g}")
        flicker, white = self.of(axis, "B").value, self.of(axis, "N").value
        equal_s = white**2 / (2 * math.log(2) / math.pi * flicker**2)
        longest = max(axis.duration_s, 10 * period)
        shortest = min(max(period, equal_s / _MARGIN), longest / 2)
        yield from (("B", term) for term in flicker_bank(flicker, shortest, longest))

    def _fitted_bias(self, axis: AxisReport) -> WithBias:
        """Return N and the process that best stands for what is slower.

        A random walk that was found wins, with a nominal T: it goes on at the longest times, and a
        short T would stop it. Else the slowest Gauss-Markov term, with its own T, also where that is what the
        walk is. Else the bound on K.
        """
        used, term, walk = [self.of(axis, "N")], self.slowest(axis), axis.fit["K"]
        if term is not None and (walk.value is None or walk.drawn is None):
            driving, time = term.sigma * math.sqrt(2 / term.T), term.T
            said = f"Gauss-Markov term of {axis.name}: sigma {term.sigma:.4g}, T {term.T:.4g} s"
        else:
            used.append(self.of(axis, "K"))
            driving, time = used[1].value, NOMINAL_TIME_S
            left_out = f"; a Gauss-Markov term (T {term.T:.4g} s) is left out" if term else ""
            said = f"T is nominal{left_out}"
        return WithBias(
            white=used[0].value,
            driving=driving,
            correlation_time=time,
            used=tuple(used),
            note="; ".join([*(number.note for number in used), said]),
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
            return topic, f"one of {', '.join(source.topics)}; set the topic with both sensors"
        return topic, "the log's topic"

    def _positive(self, value: float, symbol: str, name: str) -> float:
        if math.isfinite(value) and value > 0:
            return value
        msg = (
            f"{self.report.source.path}: {name}: {symbol} is {value}, but {self.target} needs a positive "
            "number; choose another axis, or a model with this term"
        )
        raise DataError(msg)

    def _missing(self, what: str) -> DataError:
        found = ", ".join(axis.name for axis in self.report.axes) or "no axis"
        msg = (
            f"{self.report.source.path}: no {what}, which {self.target} needs; found {found}; use a log with "
            "all axes of both sensors"
        )
        return DataError(msg)


def flicker_bank(B: float, shortest_s: float, longest_s: float) -> tuple[GaussMarkov, ...]:
    """Return Gauss-Markov terms whose sum is flicker B for times between `shortest_s` and `longest_s`.

    Their T are log-spaced, their variances ``B^2 ln(r) / pi`` each, r the ratio of neighbours: the sum has
    flicker's psd to 0.7 % at 1.5 states a decade, inside the bank.
    """
    steps = max(1, math.ceil(_PER_DECADE * math.log10(longest_s / shortest_s)))
    ratio = (longest_s / shortest_s) ** (1 / steps)
    sigma = B * math.sqrt(math.log(ratio) / math.pi)
    return tuple(GaussMarkov(sigma=sigma, T=shortest_s * ratio**i) for i in range(steps + 1))


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


def vague_axes(report: Report) -> tuple[str, ...]:
    """Return the names of the axes whose N is known to no better than a factor of 10.

    The interval of N is that wide, or its upper bound is that far above the measured Allan curve.
    """
    found = []
    for axis in report.axes:
        white = axis.fit["N"]
        ratio = white.high / white.low if white.low > 0 else _excess(axis, white)
        if axis.samples and ratio is not None and ratio > _VAGUE:
            found.append(axis.name)
    return tuple(found)


def _excess(axis: AxisReport, estimate: Estimate) -> float | None:
    """Return how far a bound lies above the largest coefficient that fits under the measured curve."""
    curve = axis.fit.curve
    unit = TERMS[estimate.symbol].of(1.0).avar(curve.m.astype(np.float64), 1 / axis.fit.rate_hz)
    below = float(np.sqrt(np.min(curve.avar / unit, initial=np.inf)))
    return estimate.high / below if 0 < below < math.inf else None


def _require(value: str, choices: tuple[str, ...], what: str) -> None:
    if value not in choices:
        raise ValueError(f"{what} {value!r} is not one of {', '.join(choices)}")
