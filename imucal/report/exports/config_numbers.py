"""The numbers that go into a file: covering numbers or fitted coefficients, inflated on request.

A filter with the fitted N and K alone would be overconfident; see `imucal.prediction.filter_numbers`.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from imucal.errors import DataError, Fix
from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.model import NoiseModel
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.prediction.filter_numbers import (
    HORIZON_S,
    STEP_S,
    FilterNumbers,
    correlation_times,
)
from imucal.prediction.left_out import LeftOut, left_out, left_out_of_model
from imucal.recording import Axis, Sensor
from imucal.report.result import AxisReport, Report

AxisPolicy: TypeAlias = Literal["worst", "rms", "x", "y", "z"]
Unidentified: TypeAlias = Literal["bound", "refuse"]
Basis: TypeAlias = Literal["covered", "as-fitted"]

#: Name of an inflation -> symbols of its terms.
INFLATABLE: dict[str, tuple[str, ...]] = {"white": ("N",), "walk": ("K",), "flicker": ("B", "GM")}
COVERING = ("N", "K")
#: States per decade of a flicker bank.
_PER_DECADE = 1.5
#: Ratio of the time at which white noise equals the flicker to the shortest T of the bank.
_MARGIN = 10.0
#: At a larger ratio of its limits, N is too uncertain for a filter.
_VAGUE = 10.0
#: Correlation time if none was measured, in s: long enough that a random walk stays one.
NOMINAL_TIME_S = 3600.0


def _require(value: str, choices: tuple[str, ...], what: str) -> None:
    if value not in choices:
        raise ValueError(f"{what} {value!r} is not one of {', '.join(choices)}")


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """The user's options for a downstream file.

    - `axis_policy`: for formats with one number per sensor: largest axis, root of the mean variance, one axis
    - `inflate`: ``white``, ``walk`` or ``flicker`` -> factor on the coefficient (a deviation, not a variance)
    - `unidentified`: whether to write the upper bound of a term that was not detected
    - `numbers`: ``covered``: white noise and walk that are enough for the fitted spectrum; ``as-fitted``: N
      and K of the fit
    - `horizon_s`: how long the filter may coast
    - `step_s`: interval between two updates of the filter
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
        return next((factor for name, factor in self.inflate.items() if symbol in INFLATABLE[name]), 1.0)


DEFAULT_OPTIONS = ExportOptions()
#: Start of the line in a file's comment that contains the options as JSON, for `read_options`.
_OPTIONS_MARK = "imucal: "


def options_line(options: ExportOptions, horizon_s: float) -> str:
    """Return the options of a file's numbers as one line of its comment, for `read_options`."""
    document = {
        "axis": options.axis_policy,
        "inflate": dict(options.inflate),
        "step_s": options.step_s,
        "horizon_s": horizon_s,
    }
    return _OPTIONS_MARK + json.dumps(document)


def read_options(text: str) -> ExportOptions:
    """Return the options in the comment of a file; the defaults if imucal did not write the file.

    Raises ValueError if the line of the options was changed and is not valid.
    """
    for line in map(str.strip, text.splitlines()):
        if f"{_OPTIONS_MARK}{{" not in line:
            continue
        try:
            # A JSON file has no comments, so its line is a quoted text.
            comment = json.loads(line.removesuffix(",")) if line.startswith('"') else line
            document = json.loads(comment.partition(_OPTIONS_MARK)[2])
            return ExportOptions(
                axis_policy=document["axis"],
                inflate=document["inflate"],
                step_s=document["step_s"],
                horizon_s=document["horizon_s"],
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"its options are not valid: {line}") from error
    return DEFAULT_OPTIONS


@dataclass(frozen=True, kw_only=True)
class Number:
    """One positive coefficient for a file, in SI, with the inflation applied.

    - `covers`: whether `value` is from a covering pair; the other attributes describe the fitted coefficient
    - `bounded`: the axes whose upper bound replaced the value
    - `excess`: ratio of a bound to the largest coefficient whose line is below the measured Allan curve
    - `alternatives`: symbols of terms that the record can't distinguish from this one
    - `origin`: description of a number that was not estimated from one record
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
        """Origin and uncertainty of the number."""
        if self.covers:
            return f"enough for {', '.join(self.axes)}{self.origin and f', {self.origin}'}"
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
        text = f", UPPER BOUND ({level}): not detected"
        if not self.excess:
            return text
        return f"{text}; {self.excess:.2g} x the line that touches the measured curve"


@dataclass(frozen=True, kw_only=True)
class WithBias:
    """An axis as white noise N and a first-order Gauss-Markov bias, dx/dt = -x/T + driving * w(t).

    `white` is in U/sqrt(Hz), `driving` in U/sqrt(s), and `correlation_time` T in s.
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Numbers:
    """The numbers of a report for one file format.

    Methods raise `DataError` if the report lacks a sensor or an axis, or if a term was not detected and the
    user refused its bound. A log may contain only one sensor.
    """

    report: Report
    options: ExportOptions
    target: str
    covers: bool = False
    horizon_s: float = HORIZON_S

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The gyroscope first, if the log has one."""
        return tuple(self.report.by_sensor)

    @property
    def stream_hz(self) -> float:
        """Rate in Hz of a file with a single rate; such a program interpolates the slower sensor."""
        return self.rate_hz(self.sensors[0])

    def axes(self, sensor: Sensor) -> tuple[AxisReport, ...]:
        if sensor not in self.report.by_sensor:
            raise self._missing(str(sensor))
        return tuple(self.report.by_sensor[sensor])

    def axis(self, sensor: Sensor, axis: Axis) -> AxisReport:
        for candidate in self.axes(sensor):
            if candidate.axis == axis:
                return candidate
        raise self._missing(f"{sensor.short}_{axis}")

    def triad(self, sensor: Sensor) -> tuple[AxisReport, AxisReport, AxisReport]:
        return self.axis(sensor, "x"), self.axis(sensor, "y"), self.axis(sensor, "z")

    def rate_hz(self, sensor: Sensor) -> float:
        """Return the rate in Hz to nine digits: no clock is more accurate."""
        return float(f"{self.axes(sensor)[0].rate_hz:.9g}")

    def one(self, sensor: Sensor, symbol: str) -> Number:
        return self.joined(self.chosen(sensor), symbol)

    def joined(self, axes: Sequence[AxisReport], symbol: str) -> Number:
        """Return one number for some axes, by the axis policy."""
        if self.covers and symbol in COVERING:
            return self._covering(axes, symbol)
        numbers = [self.of(axis, symbol) for axis in axes]
        if len(numbers) == 1 or self.options.axis_policy == "worst":
            return max(numbers, key=lambda number: number.value)
        value = math.sqrt(sum(number.value**2 for number in numbers) / len(numbers))
        return _joined(numbers, value)

    def chosen(self, sensor: Sensor) -> tuple[AxisReport, ...]:
        """Return the axes that the axis policy uses."""
        policy = self.options.axis_policy
        return (self.axis(sensor, policy),) if policy in ("x", "y", "z") else self.axes(sensor)

    def each(self, sensor: Sensor, symbol: str) -> tuple[Number, ...]:
        return tuple(self.joined([axis], symbol) for axis in self.triad(sensor))

    def pair(self, axes: Sequence[AxisReport], *, time_s: float | None = None) -> FilterNumbers:
        """Return white noise and a walk, or with `time_s` a Gauss-Markov bias, that cover some axes.

        The factor for flicker inflates the spectra; those for white noise and walk inflate the pair.
        """
        found = self.report.covering(
            [self._inflated(axis.fit) for axis in axes],
            horizon_s=self.horizon_s,
            step_s=self.options.step_s,
            joined="rms" if self.options.axis_policy == "rms" else "worst",
            time_s=time_s,
        )
        factor = self.options.factor
        return replace(found, white=found.white * factor("N"), walk=found.walk * factor("K"))

    def pairs(self, *, per_axis: bool) -> Iterator[tuple[tuple[AxisReport, ...], FilterNumbers]]:
        """Yield each axis, or the chosen axes of each sensor, with their pair."""
        for sensor in self.sensors:
            for axes in zip(self.triad(sensor)) if per_axis else [self.chosen(sensor)]:
                yield axes, self.pair(axes)

    def left_out(self, *, per_axis: bool) -> Iterator[tuple[AxisReport, LeftOut]]:
        """Yield the axes whose measured noise is clearly larger than that of the file's numbers.

        Of the axes that share numbers, the one that needs the most white noise.
        """
        groups = (
            self.pairs(per_axis=per_axis) if self.covers else (((axis,), None) for axis in self.report.axes)
        )
        for axes, pair in groups:
            found = [(axis, more) for axis in axes if (more := self._beyond(axis.fit, pair)) is not None]
            if found:
                yield max(found, key=lambda each: each[1].white)

    def _beyond(self, fit: NoiseFit, pair: FilterNumbers | None) -> LeftOut | None:
        if pair is not None:
            white = pair.white
            return left_out(fit, lambda t: white**2 / t, pair.slow_avar, step_s=pair.step_s)
        factor = self.options.factor
        terms = [
            term.of(term.coefficient * factor(term.symbol), *term.values[1:]) for term in fit.model.terms
        ]
        return left_out_of_model(fit, terms)

    def white_to_include(self, more: LeftOut) -> str:
        """Return the factor of ``--inflate white=…`` that includes what was left out, rounded up."""
        factor = self.options.factor("N") * more.white
        step = 10.0 ** (math.floor(math.log10(factor)) - 1)
        return f"{math.ceil(factor / step) * step:.3g}"

    def _inflated(self, fit: NoiseFit) -> NoiseFit:
        factor, symbols = self.options.factor("B"), INFLATABLE["flicker"]
        if factor == 1:
            return fit
        estimates = (
            replace(e, value=e.value and e.value * factor, low=e.low * factor, high=e.high * factor)
            if e.symbol in symbols
            else e
            for e in fit.estimates
        )
        # The model may contain a term for which the table lists only a bound.
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
        # A given model has no bounds: terms that it lacks are zero, not unknown.
        bounded, factor = estimate.value is None and estimate.high > 0, self.options.factor(symbol)
        if bounded and self.options.unidentified == "refuse":
            unit = TERMS[symbol].unit(axis.sensor)
            msg = (
                f"{axis.name}: {symbol} was not detected "
                f"(upper bound {estimate.high:.3g} {unit}), but {self.target} needs a value; "
                "accept the bound, choose an axis on which it is detected, or record for longer"
            )
            raise DataError(msg, place=self.report.source.path)
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
        return {
            e.key: GaussMarkov(sigma=e.value * self.options.factor(e.symbol), T=e.correlation_time.value)
            for e in axis.fit.estimates
            if e.symbol == GaussMarkov.symbol and e.value and e.correlation_time
        }

    def slowest(self, axis: AxisReport) -> GaussMarkov | None:
        return max(self.gauss_markov(axis).values(), key=lambda term: (term.T, term.sigma), default=None)

    def with_bias(self, axes: Sequence[AxisReport]) -> list[WithBias]:
        """Return white noise and a bias for each axis; all biases have the same correlation time."""
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
                note=f"{axis.name}: white noise and a bias of T {pair.correlation_time_s:.4g} s are enough",
            )
            for axis, pair in zip(axes, pairs, strict=True)
        ]

    def timed(self, groups: Sequence[Sequence[AxisReport]]) -> list[FilterNumbers]:
        """Return the covering numbers of each group of axes, with the common T that is cheapest for all."""
        fits = [axis.fit for axes in groups for axis in axes]
        tried = (
            [self.pair(axes, time_s=time) for axes in groups]
            for time in correlation_times(fits, horizon_s=self.horizon_s)
        )
        return min(tried, key=lambda pairs: math.prod(pair.excess for pair in pairs))

    def forgetful(self, sensor: str) -> dict[str, float]:
        """Return N, K and T (in s) that cover a sensor's spectrum; empty with fitted numbers."""
        if not self.covers or sensor not in self.sensors:
            return {}
        (pair,) = self.timed([self.chosen(Sensor(sensor))])
        return {"N": pair.white, "K": pair.walk, "T": pair.correlation_time_s or NOMINAL_TIME_S}

    def times(self, sensor: str) -> list[tuple[float, str]]:
        """Return T in s of the slowest Gauss-Markov term of each axis, and the name of the axis."""
        axes = self.axes(Sensor(sensor)) if sensor in self.sensors else ()
        return [(term.T, axis.name) for axis in axes if (term := self.slowest(axis))]

    def states(self, axis: AxisReport) -> Iterator[tuple[str, GaussMarkov]]:
        """Yield key and process of each state x[t+1] = phi x[t] + q w[t] that models an axis's slow noise."""
        yield from self.gauss_markov(axis).items()
        if axis.fit["B"].value is None:
            return
        period = 1 / float(f"{axis.rate_hz:.9g}")
        flicker, white = self.of(axis, "B").value, self.of(axis, "N").value
        equal_s = white**2 / (2 * math.log(2) / math.pi * flicker**2)
        longest = max(axis.duration_s, 10 * period)
        shortest = min(max(period, equal_s / _MARGIN), longest / 2)
        yield from (("B", term) for term in GaussMarkov.bank(flicker, shortest, longest, _PER_DECADE))

    def _fitted_bias(self, axis: AxisReport) -> WithBias:
        """Return N and the process that best approximates the slower noise.

        A detected random walk gets a nominal T, because a short T would limit its growth.
        """
        used, term, walk = [self.of(axis, "N")], self.slowest(axis), axis.fit["K"]
        if term is not None and (walk.value is None or walk.in_model is None):
            driving, time = term.sigma * math.sqrt(2 / term.T), term.T
            message = f"Gauss-Markov term of {axis.name}: sigma {term.sigma:.4g}, T {term.T:.4g} s"
        else:
            used.append(self.of(axis, "K"))
            driving, time = used[1].value, NOMINAL_TIME_S
            left_out = f"; a Gauss-Markov term (T {term.T:.4g} s) is left out" if term else ""
            message = f"T is nominal{left_out}"
        return WithBias(
            white=used[0].value,
            driving=driving,
            correlation_time=time,
            used=tuple(used),
            note="; ".join([*(number.note for number in used), message]),
        )

    def topic(self) -> tuple[str, str]:
        """Return the IMU topic, and a remark on its origin."""
        if self.options.topic is not None:
            return self.options.topic, "as given"
        source = self.report.source
        if not source.message_types:
            return "/imu0", "the log names no topic; set yours"
        # /topic:part is one IMU of a message with several; ROS needs the topic alone.
        topic = source.topics[0].partition(":")[0]
        if len(source.topics) > 1:
            return topic, f"one of {', '.join(source.topics)}; set the topic with both sensors"
        return topic, "the log's topic"

    def _positive(self, value: float, symbol: str, name: str) -> float:
        if math.isfinite(value) and value > 0:
            return value
        msg = (
            f"{name}: {symbol} is {value}, but {self.target} needs a positive "
            "number; choose another axis, or a model with this term"
        )
        raise DataError(msg, place=self.report.source.path)

    def _missing(self, what: str) -> DataError:
        found = ", ".join(axis.name for axis in self.report.axes) or "no axis"
        return DataError(
            f"no {what}, which {self.target} needs; found {found}",
            place=self.report.source.path,
            fix=Fix("use a log with all axes of both sensors"),
        )


def _joined(numbers: Sequence[Number], value: float) -> Number:
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
    """Return the names of the axes whose N is uncertain by more than a factor of 10."""
    found = []
    for axis in report.axes:
        white = axis.fit["N"]
        ratio = white.high / white.low if white.low > 0 else _excess(axis, white)
        if axis.samples and ratio is not None and ratio > _VAGUE:
            found.append(axis.name)
    return tuple(found)


def advice_on_vague(report: Report) -> str:
    """Return how to know N better: a longer record does not decide between two explanations of N."""
    if any(finding.code == "two-levels" for finding in report.all_findings):
        return "switch off filters and smoothing and record again"
    return "record for longer"


def _excess(axis: AxisReport, estimate: Estimate) -> float | None:
    """Return the ratio of a bound to the largest coefficient whose line is below the measured curve."""
    curve = axis.fit.curve
    unit = TERMS[estimate.symbol].of(1.0).avar(curve.m.astype(np.float64), 1 / axis.fit.rate_hz)
    below = float(np.sqrt(np.min(curve.avar / unit, initial=np.inf)))
    return estimate.high / below if 0 < below < math.inf else None
