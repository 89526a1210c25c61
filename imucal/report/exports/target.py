"""One downstream format: its file, its keys and their formulas, and the comment at its head.

The comment says how the numbers came about; numbers are spelled so that the consumers' own parsers
read them.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import NamedTuple, TypeAlias

from imucal.prediction.filter_numbers import HORIZON_S, FilterNumbers
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import COVERING, INFLATABLE, Choices, Number, Numbers
from imucal.report.result import AxisReport, Report

#: The numbers that stand in a file, and its lines without the comment at the head.
Body: TypeAlias = tuple[Sequence[Number], Sequence[str]]
#: Lines of a file that are the same in every one, or follow from the numbers.
Lines: TypeAlias = Sequence[str] | Callable[[Numbers], Sequence[str]]
YAML_LINE = "{name}: {value}  # {remark}"

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


def vector(values: Iterable[float]) -> str:
    """Return ``[1.0, 2.0, 3.0]``."""
    return "[" + ", ".join(real(value) for value in values) + "]"


def matrix(rows: Sequence[Sequence[float]], indent: str) -> list[str]:
    """Return a YAML list of lists, one row a line."""
    return [f"{indent}- {vector(row)}" for row in rows]


def quoted(text: str) -> str:
    """Return a double-quoted scalar, right in YAML, in JSON and for OpenCV."""
    return json.dumps(text, ensure_ascii=False)


def plain(text: str) -> str:
    """Return text that stays on its line: control characters become spaces."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def comment(lines: Iterable[str], sign: str = "#") -> list[str]:
    """Return the lines as comments."""
    return [f"{sign} {plain(line)}".rstrip() for line in lines]


def below_comment(head: Sequence[str], body: Sequence[str], sign: str = "#") -> str:
    """Return the text of a file whose comments start with a sign."""
    return "\n".join([*comment(head, sign), *body]) + "\n"


def beside_json(head: Sequence[str], body: Sequence[str]) -> str:
    """Return the text of a JSON object, which has no comments: they are a list under a key of our own."""
    said = ",\n".join(f"    {quoted(plain(line))}" for line in head)
    return "\n".join(["{", '  "_imucal": [', said, "  ],", *body, "}"]) + "\n"


def opencv_yaml(head: Sequence[str], body: Sequence[str]) -> str:
    """Return the text of a YAML file for OpenCV, which wants a directive on the first line."""
    return "%YAML:1.0\n" + below_comment(head, body)


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A downstream format.

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
    source
        What was read to know what the consumer does with the numbers: files of its source, or its
        documentation; and what was run.
    kind
        Continuous or discrete, in words.
    formulas
        How each value follows from the coefficients.
    body
        Numbers -> those that stand in the file, and its lines; raises `DataError` where one is missing.
    carries
        Symbols of the terms the format has a place for.
    per_axis
        Whether the format holds a number for each axis.
    own_rates
        Whether each sensor has a rate of its own; else the numbers are for one stream of both.
    notes
        What else the comment says.
    layout
        The comment's lines and the body's -> text of the file.
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
    body: Callable[[Numbers], Body]
    heading: str = ""
    carries: str = "N K"
    per_axis: bool = False
    own_rates: bool = False
    notes: tuple[str, ...] = ()
    layout: Callable[[Sequence[str], Sequence[str]], str] = below_comment
    aliases: tuple[str, ...] = ()
    horizon_s: float = HORIZON_S

    @property
    def covers(self) -> bool:
        """Whether white noise and a slow bias stand for all of a sensor's noise here."""
        carries = self.carries.split()
        return "B" not in carries and set(COVERING) <= set(carries)

    @property
    def keys(self) -> "tuple[Key, ...]":
        """Its keys and their formulas, where a formula of one coefficient is all there is to each."""
        return self.body.keys if isinstance(self.body, KeyedBody) else ()

    def is_called(self, name: str) -> bool:
        """Return whether this is its own name, whatever the case and the signs between letters."""
        return name_key(name) == name_key(self.name)

    def __post_init__(self) -> None:
        if not self.heading:
            heading = re.sub(r" \((.+)\)$", r", its \1", self.title)
            object.__setattr__(self, "heading", heading)

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
        used, lines = self.body(numbers)
        return self.layout([*self._head(numbers, used), *self.notes], lines)

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


GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER

#: Units of what a sensor's samples grow by in a second.
_GROWTH = {GYRO: "rad/s^2", ACCEL: "m/s^3"}


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


#: Continuous: c, and its square.
DENSITY = Formula(lambda c, f: c, "{u}/sqrt(Hz)")  # noqa: ARG005 - one signature for all
DENSITY_SQUARED = Formula(lambda c, f: c * c, "({u})^2/Hz")  # noqa: ARG005
#: Discrete: of one sample (N), or of a step as code sees it that multiplies it by dt (K); and its square.
SAMPLE = Formula(lambda c, f: c * math.sqrt(f), "{u}")
SAMPLE_SQUARED = Formula(lambda c, f: c * c * f, "({u})^2")
#: Of one sample, for VINS: it averages two samples but takes half of the variance twice.
HALVED_TWICE = Formula(lambda c, f: c * math.sqrt(2 * f), "{u}")


def at_period(seconds: float) -> Formula:
    """Return c / sqrt(dt): discrete at a filter's own period, whatever the rate."""
    return Formula(lambda c, f: c / math.sqrt(seconds), "{u}")  # noqa: ARG005


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a file: the term of a sensor that it holds, by a formula.

    A key for each axis has ``{axis}`` (x, y, z) or ``{i}`` (0, 1, 2) in its name.
    """

    name: str
    sensor: Sensor
    symbol: str
    formula: Formula = DENSITY

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return self.formula.unit.format(u=_GROWTH[self.sensor] if self.symbol == "K" else self.sensor.unit)


class Entry(NamedTuple):
    """A key with its number."""

    name: str
    value: float
    unit: str
    number: Number

    @property
    def remark(self) -> str:
        """Unit and origin."""
        return f"{self.unit}; {self.number.note}"


def four(names: str, white: Formula = DENSITY, walk: Formula | None = None) -> tuple[Key, ...]:
    """Return the four keys that most formats have: N and K of the accelerometer, then of the gyroscope."""
    terms = ((ACCEL, "N"), (ACCEL, "K"), (GYRO, "N"), (GYRO, "K"))
    return tuple(
        Key(name, sensor, symbol, walk or white if symbol == "K" else white)
        for name, (sensor, symbol) in zip(names.split(), terms, strict=True)
    )


def entries(numbers: Numbers, keys: Iterable[Key]) -> list[Entry]:
    """Return the numbers of the keys whose sensor is in the log."""
    found = []
    for key in keys:
        if key.sensor not in numbers.sensors:
            continue
        one_each = "{" in key.name
        chosen = numbers.each(key.sensor, key.symbol) if one_each else (numbers.one(key.sensor, key.symbol),)
        for i, number in enumerate(chosen):
            value = key.formula.of(number.value, numbers.stream_hz)
            found.append(Entry(key.name.format(i=i, axis="xyz"[i]), value, key.unit, number))
    return found


def lines(found: Iterable[Entry], layout: str = YAML_LINE) -> list[str]:
    """Return one line a number; the layout knows name, value and remark (unit and origin)."""
    return [layout.format(name=e.name, value=real(e.value), remark=e.remark) for e in found]


@dataclass(frozen=True, slots=True)
class KeyedBody:
    """The body of a file of keys: the lines follow from their numbers."""

    keys: tuple[Key, ...]
    text: Callable[[Numbers, list[Entry]], Sequence[str]]

    def __call__(self, numbers: Numbers) -> Body:
        """Return the numbers of the keys, and the lines."""
        found = entries(numbers, self.keys)
        return [entry.number for entry in found], self.text(numbers, found)


def keyed_body(
    keys: tuple[Key, ...], *, above: Lines = (), below: Lines = (), indent: str = "", layout: str = YAML_LINE
) -> KeyedBody:
    """Return the body of a file of keys: the lines above, the keys (see `lines`), the lines below."""

    def text(numbers: Numbers, found: list[Entry]) -> Sequence[str]:
        head, tail = (part(numbers) if callable(part) else part for part in (above, below))
        return [*head, *lines(found, indent + layout), *tail]

    return KeyedBody(keys, text)


def stream_rate(key: str, remark: str = "Hz, of the") -> Callable[[Numbers], Sequence[str]]:
    """Return the line of a key that holds the rate of the file's stream; the remark ends with its sensor."""
    return lambda numbers: [f"{key}: {real(numbers.stream_hz)}  # {remark} {numbers.sensors[0]}"]


def json_object(name: str, members: Iterable[tuple[str, str]], indent: str = "  ") -> list[str]:
    """Return a member of a JSON object that is an object, one of its members a line."""
    inside = ",\n".join(f"{indent}  {quoted(key)}: {value}" for key, value in members).split("\n")
    return [f"{indent}{quoted(name)}: {{", *inside, f"{indent}}}"]


def json_origins(said: Iterable[str]) -> list[str]:
    """Return where the numbers of a JSON object are from, which has no comments, as its member."""
    inside = ",\n".join(f"    {quoted(each)}" for each in said).split("\n")
    return ['  "_origin": [', *inside, "  ],"]


def triads(numbers: Numbers, keys: Iterable[Key]) -> tuple[list[Number], list[tuple[str, str]]]:
    """Return the numbers of all axes of the keys, and each key with their list as a file holds it."""
    used, members = list[Number](), []
    for key in keys:
        if key.sensor in numbers.sensors:
            chosen = numbers.each(key.sensor, key.symbol)
            used += chosen
            values = vector(key.formula.of(number.value, numbers.stream_hz) for number in chosen)
            members.append((key.name, values))
    return used, members
