"""One downstream format: its file, its keys and their formulas, and the comment at its head.

What a format is stands in `formats/*.toml`, as data: its words, its keys, and the text of its file as a
template, which is filled with their numbers. The comment says how the numbers came about; numbers are spelled
so that the consumers' own parsers read them.
"""

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Literal, NamedTuple

from imucal.noise.terms import TERMS
from imucal.prediction.filter_numbers import HORIZON_S, FilterNumbers
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import COVERING, INFLATABLE, Choices, Number, Numbers, WithBias
from imucal.report.exports.state_space import states
from imucal.report.result import AxisReport, Report
from imucal.units import G0

if TYPE_CHECKING:
    from jinja2 import Environment, Template

_POLICIES = {
    "worst": "worst: the largest of the sensor's axes",
    "rms": "rms: the root of the mean variance of the sensor's axes",
}


def name_key(name: str) -> str:
    """Return the letters and digits of a name, small: what tells names apart."""
    return "".join(sign for sign in name.lower() if sign.isalnum())


def real(value: float) -> str:
    """Return a number with a decimal point that reads back exactly: ``200.0``, ``1.0e-05``.

    OpenCV's FileStorage takes ``200`` for an integer, and YAML 1.1 takes ``1e-05`` for a string;
    with the point both read a real number.
    """
    if not math.isfinite(value):
        msg = f"only finite numbers can be written, got {value}"
        raise ValueError(msg)
    mantissa, sign, exponent = repr(float(value)).partition("e")
    if "." not in mantissa:
        mantissa += ".0"
    return f"{mantissa}e{int(exponent):+03d}" if sign else mantissa


def decimal(value: float) -> str:
    """Return a number without an exponent, for parsers that know none: ``0.00001``."""
    digits = format(Decimal(real(value)), "f")
    return digits if "." in digits else digits + ".0"


def quoted(text: str) -> str:
    """Return a double-quoted scalar, right in YAML, in JSON and for OpenCV."""
    return json.dumps(text, ensure_ascii=False)


def plain(text: str) -> str:
    """Return text that stays on its line: control characters become spaces."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def comment(lines: Iterable[str], sign: str = "#") -> str:
    """Return the lines as comments."""
    return "\n".join(f"{sign} {plain(line)}".rstrip() for line in lines)


def _json(head: Sequence[str], body: str) -> str:
    """Return a JSON object, which has no comments: they are a list under a key of our own."""
    said = ",\n".join(f"    {quoted(plain(line))}" for line in head)
    return f'{{\n  "_imucal": [\n{said}\n  ],\n{body}\n}}'


def _xml(head: Sequence[str], body: str) -> str:
    """Return an XML file; two hyphens would end its comment."""
    said = "\n".join(f"  {plain(line).replace('--', '- -')}" for line in head)
    return f'<?xml version="1.0"?>\n<!--\n{said}\n-->\n{body}'


#: Kind of a file -> the comment's lines and the body, put together; else its sign of a comment.
_LAYOUTS: dict[str, Callable[[Sequence[str], str], str]] = {
    "json": _json,
    "xml": _xml,
    # OpenCV wants a directive on the first line.
    "opencv": lambda head, body: f"%YAML:1.0\n{comment(head)}\n{body}",
}

#: Units of what a sensor's samples grow by in a second.
_GROWTH = {Sensor.GYROSCOPE: "rad/s^2", Sensor.ACCELEROMETER: "m/s^3"}


@dataclass(frozen=True, slots=True)
class Formula:
    """How a number follows from a coefficient c and the rate f of the file's stream, and its unit.

    In the unit, ``{u}`` stands for that of the samples (N) or of their growth in a second (K).
    """

    of: Callable[[float, float], float]
    unit: str

    @property
    def power(self) -> int:
        """Power of the coefficient: 1, or 2 of variances."""
        return round(math.log2(self.of(2.0, 1.0) / self.of(1.0, 1.0)))

    def inverse(self, number: float, f: float) -> float:
        """Return the coefficient that a positive number stands for."""
        return float((number / self.of(1.0, f)) ** (1 / self.power))


def _times(factor: float, unit: str) -> Formula:
    return Formula(lambda c, _: c * factor, unit)


#: What stands behind a term's symbol in a key -> its number: continuous (c, c²); discrete, of one sample (N)
#: or of a step as code sees it that multiplies it by dt (K).
FORMULAS = {
    "": Formula(lambda c, _: c, "{u}/sqrt(Hz)"),
    "^2": Formula(lambda c, _: c * c, "({u})^2/Hz"),
    " sqrt(f)": Formula(lambda c, f: c * math.sqrt(f), "{u}"),
    "^2 f": Formula(lambda c, f: c * c * f, "({u})^2"),
    # Of one sample, for VINS: it averages two samples but takes half of the variance twice.
    " sqrt(2 f)": Formula(lambda c, f: c * math.sqrt(2 * f), "{u}"),
    # Of a filter's own period, whatever the rate: PX4's and ArduPilot's.
    " / sqrt(0.01 s)": Formula(lambda c, _: c / math.sqrt(0.01), "{u}"),
    " / sqrt(0.012 s)": Formula(lambda c, _: c / math.sqrt(0.012), "{u}"),
    # AirSim's units: its biases are said to be stable for 100 s.
    " in deg/sqrt(h)": _times(TERMS["N"].datasheet_unit(Sensor.GYROSCOPE).factor, "deg/sqrt(h)"),
    " sqrt(100 s) in deg/h": Formula(
        lambda c, _: c * math.sqrt(100.0) * TERMS["B"].datasheet_unit(Sensor.GYROSCOPE).factor, "deg/h"
    ),
    " in mg/sqrt(Hz)": Formula(lambda c, _: c / G0 * 1e3, "mg/sqrt(Hz)"),
    " sqrt(100 s) in ug": Formula(lambda c, _: c * math.sqrt(100.0) / G0 * 1e6, "ug"),
}


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a file: the term of a sensor that it holds, by a formula.

    A key for each axis has ``{axis}`` (x, y, z) or ``{i}`` (0, 1, 2) in its name, one with a list of
    all three ends with ``[]``.
    """

    name: str
    sensor: Sensor
    symbol: str
    formula: Formula

    @classmethod
    def parse(cls, text: str) -> "Key":
        """Return the key of a line such as ``gyr_cov = gyro N^2 f``: a name, and its formula of a term."""
        name, sensor, symbol, formula = re.fullmatch(r"(\S+) = (gyro|accel) ([A-Z])(.*)", text).groups()  # type: ignore[union-attr]
        (own,) = (each for each in Sensor if each.short == sensor)
        return cls(name, own, symbol, FORMULAS[formula])

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return self.formula.unit.format(u=_GROWTH[self.sensor] if self.symbol == "K" else self.sensor.unit)


class Entry(NamedTuple):
    """A key with its number, or its numbers for the three axes."""

    name: str
    sensor: Sensor
    symbol: str
    value: float | list[float]
    unit: str
    numbers: tuple[Number, ...]

    @property
    def note(self) -> str:
        """Where the number is from."""
        return self.numbers[0].note

    @property
    def remark(self) -> str:
        """Unit and origin."""
        return f"{self.unit}; {self.note}"

    @property
    def said(self) -> str:
        """Name, unit and origin, where the file has no comments."""
        return f"{self.name}: {self.remark}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """A downstream format, as a table of `formats/*.toml` has it.

    Attributes
    ----------
    name
        What the user asks for.
    title
        The consumer and its file, for a list.
    file_name
        Name of the file where the user gives a folder.
    heading
        The consumer and its file, for the comment; where none is given the title, ``config (IMU part)``
        as ``config, its IMU part``.
    about
        What the consumers of its family do with the numbers.
    source
        What was read to know it: files of its source, or its documentation; and what was run.
    kind
        Continuous or discrete, in words.
    formulas
        How each value follows from the coefficients, in words.
    keys
        The keys that hold a number of one term, each with its formula.
    every
        Symbols of the terms that the file has for every axis.
    bias
        Whether it has each axis as white noise and a bias that forgets, with a correlation time for
        ``each axis``, or one for ``all axes``.
    text
        The file less the comment, as a template; see `Target.body`.
    read_back
        Whether a user's file is recognised by its keys, and they are judged.
    documented
        Key -> the lowest and highest value that the consumer documents.
    carries
        Symbols of the terms the format has a place for.
    per_axis
        Whether the format holds a number for each axis.
    own_rates
        Whether each sensor has a rate of its own; else the numbers are for one stream of both.
    notes
        What else the comment says.
    layout
        ``json``, ``xml``, ``opencv``, or the sign that comments start with.
    aliases
        Other names it goes by.
    horizon_s
        How long a filter with these numbers may coast, where the user doesn't say.
    """

    name: str
    title: str
    file_name: str
    source: str
    kind: str
    formulas: tuple[str, ...]
    text: str
    heading: str = ""
    about: str = ""
    keys: tuple[Key, ...] = ()
    every: tuple[str, ...] = ()
    bias: Literal["", "each axis", "all axes"] = ""
    read_back: bool = True
    documented: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    carries: str = "N K"
    per_axis: bool = False
    own_rates: bool = False
    notes: tuple[str, ...] = ()
    layout: str = "#"
    aliases: tuple[str, ...] = ()
    horizon_s: float = HORIZON_S

    @property
    def covers(self) -> bool:
        """Whether white noise and a slow bias stand for all of a sensor's noise here."""
        carries = self.carries.split()
        return "B" not in carries and set(COVERING) <= set(carries)

    def is_called(self, name: str) -> bool:
        """Return whether this is its own name, whatever the case and the signs between letters."""
        return name_key(name) == name_key(self.name)

    def __post_init__(self) -> None:
        if not self.heading:
            object.__setattr__(self, "heading", re.sub(r" \((.+)\)$", r", its \1", self.title))

    def numbers(self, report: Report, choices: Choices) -> Numbers:
        """Return what a report gives this format."""
        return Numbers(
            report=report,
            choices=choices,
            target=self.name,
            covers=self.covers and choices.numbers == "covered",
            horizon_s=choices.horizon_s or max(self.horizon_s, 2 * choices.step_s),
        )

    def render(self, report: Report, choices: Choices) -> str:
        """Return the text of the file; raises `DataError` where a number is missing."""
        numbers = self.numbers(report, choices)
        used, body = self.body(numbers)
        head = [*self._head(numbers, used), *self.notes]
        if self.layout in _LAYOUTS:
            return f"{_LAYOUTS[self.layout](head, body)}\n"
        return f"{comment(head, self.layout)}\n{body}\n"

    def body(self, numbers: Numbers) -> tuple[list[Number], str]:
        """Return the numbers that stand in the file, and the file less the comment.

        The template knows ``keys`` (an `Entry` each), ``every`` (each axis with its numbers), ``biased``
        (sensor -> a `WithBias` for each axis), ``used`` (the numbers), ``numbers``, ``sensors``, the rate
        ``f`` and the inflation's ``factor(symbol)``. A float is written as `real` spells it.
        """
        keys = list(_entries(numbers, self.keys))
        axes = [axis for sensor in numbers.sensors for axis in numbers.axes(sensor)] if self.every else []
        every = [(axis, [numbers.of(axis, symbol) for symbol in self.every]) for axis in axes]
        biased = _biased(numbers, self.bias) if self.bias else {}
        used = [
            *(number for entry in keys for number in entry.numbers),
            *(number for _, of_axis in every for number in of_axis),
            *(number for of_sensor in biased.values() for axis in of_sensor for number in axis.used),
        ]
        text = _template(self.text).render(
            keys=keys,
            every=every,
            biased=biased,
            used=used,
            numbers=numbers,
            sensors=numbers.sensors,
            f=numbers.stream_hz,
            factor=numbers.choices.factor,
            documented=self.documented,
        )
        return used, text.removesuffix("\n")

    def _head(self, numbers: Numbers, used: Iterable[Number]) -> list[str]:
        """Return the lines of the comment, without comment signs."""
        report = numbers.report
        topics = f", {', '.join(report.source.topics)}" if report.source.message_types else ""
        axes = "each its own number; this format needs no axis policy"
        if not self.per_axis:
            policy = numbers.choices.axis_policy
            axes = _POLICIES.get(policy, f"{policy} alone")
        lines = [
            f"{self.heading}, written by imucal {report.version}",
            f"source log: {report.source.path} ({report.source.format}{topics})",
            *(_sensor_line(numbers, sensor) for sensor in numbers.sensors),
            *(
                f"NO {sensor} in this log: its numbers are left out, and the program needs them from another"
                for sensor in Sensor
                if sensor not in numbers.sensors
            ),
            f"kind: {self.kind}",
            *(f"formula: {formula}" for formula in self.formulas),
            f"axes: {axes}",
            f"inflation: {_inflation(numbers)}",
            *(_coverage(numbers, per_axis=self.per_axis) if self.covers else ()),
        ]
        lines += _bounds(numbers, used)
        rates = [numbers.rate_hz(sensor) for sensor in numbers.sensors]
        if max(rates) > 1.001 * min(rates):
            lines.append(
                "the rates differ: f is each sensor's own"
                if self.own_rates
                else f"the rates differ: every number is for one stream at f = {numbers.stream_hz:.9g} Hz"
            )
        left_out = _uncovered(numbers) if numbers.covers else _left_out(report.axes, self.carries)
        return [*lines, *left_out, *_warnings(numbers)]


def read_targets(families: Iterable[str]) -> Iterator[Target]:
    """Yield the formats of ``formats/FAMILY.toml``; its own keys are those of all its formats."""
    for family in families:
        text = files("imucal.report.exports").joinpath("formats", f"{family}.toml").read_text("utf-8")
        table = tomllib.loads(text)
        macros = table.pop("macros", "")
        shared = {key: value for key, value in table.items() if not isinstance(value, dict)}
        for name, own in table.items():
            if name in shared:
                continue
            lists = {key: tuple(value) for key, value in own.items() if isinstance(value, list)}
            keys = tuple(map(Key.parse, own.get("keys", ())))
            yield Target(name=name, **{**shared, **own, **lists, "keys": keys, "text": macros + own["text"]})


def _entries(numbers: Numbers, keys: Iterable[Key]) -> Iterator[Entry]:
    """Yield the numbers of the keys whose sensor is in the log."""
    for key in keys:
        if key.sensor not in numbers.sensors:
            continue
        one_each = key.name.endswith("[]") or "{" in key.name
        chosen = numbers.each(key.sensor, key.symbol) if one_each else (numbers.one(key.sensor, key.symbol),)
        values = [key.formula.of(number.value, numbers.stream_hz) for number in chosen]
        if key.name.endswith("[]"):
            yield Entry(key.name[:-2], key.sensor, key.symbol, values, key.unit, chosen)
            continue
        for i, (number, value) in enumerate(zip(chosen, values, strict=True)):
            name = key.name.format(i=i, axis="xyz"[i])
            yield Entry(name, key.sensor, key.symbol, value, key.unit, (number,))


def _biased(numbers: Numbers, bias: str) -> dict[Sensor, list[WithBias]]:
    """Return the axes of each sensor as white noise and a bias."""
    triads = {sensor: numbers.triad(sensor) for sensor in numbers.sensors}
    axes = [axis for triad in triads.values() for axis in triad]
    groups = [axes] if bias == "all axes" else [[axis] for axis in axes]
    found = [each for group in groups for each in numbers.with_bias(group)]
    return {sensor: found[3 * i : 3 * i + 3] for i, sensor in enumerate(triads)}


@cache
def _template(text: str) -> "Template":
    return _environment().from_string(text)


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, StrictUndefined

    made = Environment(  # noqa: S701 - configs, not HTML
        undefined=StrictUndefined, finalize=_spelled, trim_blocks=True, lstrip_blocks=True
    )
    made.globals |= {"G0": G0, "TERMS": TERMS, "sqrt": math.sqrt, "inf": math.inf, "states": states}
    made.filters |= {"quoted": quoted, "plain": plain, "comment": comment, "decimal": decimal}
    made.filters |= {"lines": _lines, "times": _all_times}
    return made


def _spelled(value: object) -> object:
    """Return a value as a file has it."""
    if isinstance(value, float):
        return real(value)
    return f"[{', '.join(map(real, value))}]" if isinstance(value, list) else value


def _lines(found: Iterable[Entry], indent: str = "") -> str:
    """Return a line of YAML for each key, with unit and origin."""
    return "\n".join(f"{indent}{e.name}: {_spelled(e.value)}  # {e.remark}" for e in found)


def _all_times(values: Iterable[object], factor: float, name: str) -> list[float]:
    """Return an attribute of each value, times a factor."""
    return [getattr(value, name) * factor for value in values]


def _sensor_line(numbers: Numbers, sensor: Sensor) -> str:
    axis = numbers.axes(sensor)[0]
    given = any(finding.code == "rate-given" for finding in (*numbers.report.findings, *axis.findings))
    origin = "given by the user" if given else "measured"
    recorded = f"{axis.duration_s:.6g} s recorded" if axis.samples else "nothing recorded"
    return f"{sensor}: f = {numbers.rate_hz(sensor):.9g} Hz ({origin}), {recorded}"


def _inflation(numbers: Numbers) -> str:
    asked = {name: factor for name, factor in numbers.choices.inflate.items() if factor != 1}
    if not asked:
        return "none; the numbers are those of the sensor at rest"
    parts = (f"{name} ({'/'.join(INFLATABLE[name])}) x {factor:g}" for name, factor in asked.items())
    return f"{', '.join(parts)}; ALREADY in the numbers below"


def _bounds(numbers: Numbers, used: Iterable[Number]) -> list[str]:
    bounds = dict.fromkeys(f"{number.symbol} of {name}" for number in used for name in number.bounded)
    if not bounds:
        return []
    written = "is covered in part" if numbers.covers else "is written"
    level = f"{numbers.report.axes[0].fit.level:.0%}"
    return [f"not identified, so the {level} upper bound {written}: {', '.join(bounds)}"]


def _coverage(numbers: Numbers, *, per_axis: bool) -> list[str]:
    """Say what the pairs cover, what that costs, and what the fit's own numbers are."""
    if not numbers.covers:
        said = "numbers: N and K as fitted; flicker and Gauss-Markov terms are left out, so that a filter"
        return [f"{said} with them is surer than it should be"]
    groups = [
        each
        for sensor in numbers.sensors
        for each in ([(axis,) for axis in numbers.triad(sensor)] if per_axis else [numbers.chosen(sensor)])
    ]
    pairs = [numbers.pair(axes) for axes in groups]
    what = "upper limits of the Allan curve" if pairs[0].basis == "curve" else "fitted spectrum"
    level = "" if pairs[0].level is None else f" ({pairs[0].level:.0%})"
    said = f"numbers: the least white noise and walk that cover the {what}{level}; filter aided every "
    return [
        f"{said}{numbers.choices.step_s:g} s or slower, horizon {numbers.horizon_s:g} s",
        *(
            f"{_named(axes)}: {price(pair)}; the fit's own: {itself(axes)}"
            for axes, pair in zip(groups, pairs, strict=True)
        ),
    ]


def _named(axes: Sequence[AxisReport]) -> str:
    return ", ".join(axis.name for axis in axes)


def price(pair: FilterNumbers) -> str:
    """Return what a pair costs: predicted over modelled error at some times of coasting."""
    within = [(t, ratio) for t, ratio in pair.ratios if t <= pair.horizon_s] or list(pair.ratios)
    ratios = " ".join(f"{ratio:.2g}" for _, ratio in within)
    return f"{ratios} x the model's error at {', '.join(f'{t:g}' for t, _ in within)} s"


def itself(axes: Sequence[AxisReport]) -> str:
    """Return the fit's own numbers, each of the axis where it is largest."""
    said = []
    for key in dict.fromkeys(e.key for axis in axes for e in axis.fit.estimates):
        found = [e for axis in axes for e in axis.fit.estimates if e.key == key]
        worst = max(found, key=lambda e: (e.value is not None, e.value or e.high))
        if worst.value is None:
            said += [f"{key} < {worst.high:.3g}"] if worst.high else []
        else:
            limits = f" ({worst.low:.3g} to {worst.high:.3g})" if worst.low < worst.high else ""
            said.append(f"{key} {worst.value:.3g}{limits}")
    return ", ".join(said)


def _uncovered(numbers: Numbers) -> list[str]:
    """Say what two numbers do not cover: what a rounded signal adds, and spectral lines."""
    said = []
    for axis in numbers.report.axes:
        rounding = next((e.value for e in axis.fit.estimates if e.symbol == "Q" and e.value), None)
        if rounding is not None:
            said.append(f"{axis.name}: quantization adds at most sqrt(2) Q = {math.sqrt(2) * rounding:.3g}")
        if axis.fit.goodness.lines:
            line = max(axis.fit.goodness.lines, key=lambda line: line.amplitude / line.frequency_hz)
            swing = line.amplitude / (math.pi * line.frequency_hz)
            said.append(
                f"{axis.name}: the tone of {line.frequency_hz:.4g} Hz is not covered, it adds {swing:.3g}"
            )
    return said


def _left_out(axes: Iterable[AxisReport], carries: str) -> list[str]:
    """Name the terms that were found but have no place in the format, and the walk that GM looks like."""
    places: dict[str, list[str]] = {}
    walks = []
    for axis in axes:
        for estimate in axis.fit.estimates:
            if estimate.value is None or estimate.symbol in carries.split():
                continue
            places.setdefault(estimate.symbol, []).append(axis.name)
            if estimate.correlation_time is not None:
                time = estimate.correlation_time.value
                walk = estimate.value * math.sqrt(2 / time)
                walks.append(f"{estimate.key} of {axis.name} looks like K = {walk:.3g} below {time:.3g} s")
    if not places:
        return []
    parts = (f"{symbol} ({', '.join(dict.fromkeys(names))})" for symbol, names in places.items())
    return [f"found, but without a place in this format: {', '.join(parts)}", *walks]


def _warnings(numbers: Numbers) -> list[str]:
    codes = ", ".join(dict.fromkeys(f.code for f in numbers.report.all_findings if f.level != "info"))
    return [f"read the report before you use these numbers; it warns of: {codes}"] if codes else []
