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
from itertools import chain
from typing import TYPE_CHECKING, Literal, NamedTuple

from imucal.frozen import frozen_alone
from imucal.noise.terms import TERMS
from imucal.prediction.filter_numbers import HORIZON_S, FilterNumbers
from imucal.printable import one_line
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import COVERING, INFLATABLE, Choices, Number, Numbers, WithBias
from imucal.report.result import AxisReport, Report
from imucal.units import G0

if TYPE_CHECKING:
    from jinja2 import Environment, Template


def name_key(name: str) -> str:
    """Return the letters and digits of a name, small: what tells names apart."""
    return "".join(sign for sign in name.lower() if sign.isalnum())


def real(value: float) -> str:
    """Return a number of eight digits with a decimal point: ``200.0``, ``1.0e-05``.

    A factor just below 1, such as phi of a Gauss-Markov process, keeps all: its distance from 1 counts.

    OpenCV's FileStorage takes ``200`` for an integer, and YAML 1.1 takes ``1e-05`` for a string;
    with the point both read a real number.
    """
    if not math.isfinite(value):
        raise ValueError(f"only finite numbers can be written, got {value}")
    rounded = float(value) if 0.9 < value < 1 else float(f"{value:.8g}")
    mantissa, sign, exponent = repr(rounded).partition("e")
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


def comment(lines: Iterable[str], sign: str = "#") -> str:
    """Return the lines as comments."""
    return "\n".join(f"{sign} {one_line(line)}".rstrip() for line in lines)


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
    " in deg/sqrt(h)": Formula(
        lambda c, _: c * TERMS["N"].datasheet_unit(Sensor.GYROSCOPE).factor, "deg/sqrt(h)"
    ),
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


@frozen_alone
class Target:
    """A downstream format, as a table of `formats/*.toml` has it.

    The user asks for it by its `name` or its `aliases`, and gets a file called `file_name` where a folder
    was given. `title` is the consumer and its file, for a list, and `heading` the same for the comment;
    where none is given the title, ``config (IMU part)`` as ``config, its IMU part``. `about` says what the
    consumers of its family do with the numbers, `source` what was read to know it, and what was run, `kind`
    whether it is continuous or discrete, `formulas` how each value follows from the coefficients, `notes`
    what else the comment says. `text` is the file less the comment, as a template (see `Target._known`);
    `layout` is ``json``, ``xml``, ``opencv``, or the sign that comments start with.

    `keys` hold a number of one term each, by a formula; `documented` has the lowest and highest value of a
    key that the consumer documents. `every` are the symbols of the terms that the file has for every axis,
    `carries` of those that it has a place for. `bias` is whether it has each axis as white noise and a bias
    that forgets, with a correlation time for ``each axis``, or one for ``all axes``. With `read_back` a
    user's file is recognised by its keys, and they are judged. A format that is `per_axis` holds a number
    for each axis, and without `own_rates` the numbers are for one stream of both sensors. `horizon_s` is
    how long a filter with them may coast, where the user doesn't say.
    """

    name: str
    title: str
    heading: str
    file_name: str
    source: str
    kind: str
    formulas: tuple[str, ...]
    text: str
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
        numbers, carried = self.numbers(report, choices), self.carries.split()
        known = self._known(numbers)
        body = _template(self.text).render(known).removesuffix("\n")
        estimates = [(axis, e) for axis in report.axes for e in axis.fit.estimates]
        lines = [(axis, line) for axis in report.axes for line in axis.fit.goodness.lines]
        return _template(_format("file.txt")).render(
            known,
            body=body,
            all_sensors=tuple(Sensor),
            rates=[numbers.rate_hz(sensor) for sensor in numbers.sensors],
            lost=[(axis, e) for axis, e in estimates if e.value is not None and e.symbol not in carried],
            swings=[
                (axis.name, line.amplitude / (math.pi * line.frequency_hz), line) for axis, line in lines
            ],
        )

    def _known(self, numbers: Numbers) -> dict[str, object]:
        """Return what the templates know; a float is written as `real` spells it.

        ``keys`` (an `Entry` each), ``every`` (each axis with its numbers), ``biased`` (sensor -> a `WithBias`
        for each axis), ``used`` (the numbers), ``bounds`` (which of them are bounds), the inflation's
        ``factor(symbol)`` and the rate ``f`` of the file.
        """
        keys = list(_entries(numbers, self.keys))
        axes = chain.from_iterable(map(numbers.axes, numbers.sensors)) if self.every else ()
        every = [(axis, [numbers.of(axis, symbol) for symbol in self.every]) for axis in axes]
        biased = _biased(numbers, self.bias) if self.bias else {}
        used = [
            *(number for entry in keys for number in entry.numbers),
            *(number for _, of_axis in every for number in of_axis),
            *(number for of_sensor in biased.values() for axis in of_sensor for number in axis.used),
        ]
        bounds = dict.fromkeys(f"{number.symbol} of {name}" for number in used for name in number.bounded)
        return {
            "target": self,
            "numbers": numbers,
            "sensors": numbers.sensors,
            "factor": numbers.choices.factor,
            "keys": keys,
            "every": every,
            "biased": biased,
            "used": used,
            "bounds": bounds,
            "f": numbers.stream_hz,
        }


def read_targets(families: Iterable[str]) -> Iterator[Target]:
    """Yield the formats of ``formats/FAMILY.toml``; its own keys are those of all its formats."""
    for family in families:
        table = tomllib.loads(_format(f"{family}.toml"))
        macros = table.pop("macros", "")
        shared = {key: value for key, value in table.items() if not isinstance(value, dict)}
        for name, own in table.items():
            if name in shared:
                continue
            lists = {key: tuple(value) for key, value in own.items() if isinstance(value, list)}
            keys = tuple(map(Key.parse, own.get("keys", ())))
            heading = re.sub(r" \((.+)\)$", r", its \1", own["title"])
            made = {"heading": heading, **shared, **own, **lists, "keys": keys, "text": macros + own["text"]}
            yield Target(name=name, **made)


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


def _format(name: str) -> str:
    """Return the text of a file of the folder ``formats``."""
    return files("imucal.report.exports").joinpath("formats", name).read_text("utf-8")


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, StrictUndefined

    made = Environment(  # noqa: S701 - configs, not HTML
        undefined=StrictUndefined, finalize=_spelled, trim_blocks=True, lstrip_blocks=True
    )
    made.globals |= {"G0": G0, "TERMS": TERMS, "sqrt": math.sqrt, "inf": math.inf}
    made.globals |= {"INFLATABLE": INFLATABLE, "price": price, "itself": itself}
    made.filters |= {"quoted": quoted, "plain": one_line, "comment": comment, "decimal": decimal}
    made.filters["lines"] = _lines
    # An attribute of each value, times a factor.
    made.filters["times"] = lambda values, factor, name: [getattr(value, name) * factor for value in values]
    return made


def _spelled(value: object) -> object:
    """Return a value as a file has it."""
    if isinstance(value, float):
        return real(value)
    return f"[{', '.join(map(real, value))}]" if isinstance(value, list) else value


def _lines(found: Iterable[Entry], indent: str = "") -> str:
    """Return a line of YAML for each key, with unit and origin."""
    return "\n".join(f"{indent}{e.name}: {_spelled(e.value)}  # {e.remark}" for e in found)


def price(pair: FilterNumbers) -> str:
    """Return what a pair costs: predicted over modelled error at some times of coasting."""
    within = [(t, ratio) for t, ratio in pair.ratios if t <= pair.horizon_s] or list(pair.ratios)
    ratios = " ".join(f"{ratio:.2g}" for _, ratio in within)
    return f"{ratios} x the model's error at {', '.join(f'{t:g}' for t, _ in within)} s"


def itself(axes: Sequence[AxisReport], number: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return the fit's own numbers, each of the axis where it is largest, written by `number`."""
    said = []
    for key in dict.fromkeys(e.key for axis in axes for e in axis.fit.estimates):
        found = [e for axis in axes for e in axis.fit.estimates if e.key == key]
        worst = max(found, key=lambda e: (e.value is not None, e.value or e.high))
        if worst.value is None:
            said += [f"{key} < {number(worst.high)}"] if worst.high else []
        else:
            limits = f" ({number(worst.low)} to {number(worst.high)})" if worst.low < worst.high else ""
            said.append(f"{key} {number(worst.value)}{limits}")
    return ", ".join(said)
