"""One downstream format, defined in `formats/*.toml`: its file, its keys with formulas, and the comment."""

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

from imucal.errors import DataError, Fix
from imucal.noise.terms import TERMS
from imucal.prediction.filter_numbers import HORIZON_S, FilterNumbers
from imucal.prediction.left_out import causes
from imucal.printable import one_line, printable_json
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import (
    COVERING,
    INFLATABLE,
    ExportOptions,
    Number,
    Numbers,
    WithBias,
    options_line,
)
from imucal.report.given import GIVEN, part_models
from imucal.report.result import AxisReport, Report
from imucal.units import G0

if TYPE_CHECKING:
    from jinja2 import Environment, Template


def name_key(name: str) -> str:
    """Return the letters and digits in lower case, for comparisons."""
    return "".join(sign for sign in name.lower() if sign.isalnum())


def real(value: float) -> str:
    """Return a number with eight digits and a decimal point: ``200.0``, ``1.0e-05``.

    Factors just below 1 keep all digits. Without the point, OpenCV's FileStorage reads ``200`` as an integer,
    and YAML 1.1 reads ``1e-05`` as a string. Raises ValueError if the number is not finite.
    """
    if not math.isfinite(value):
        raise ValueError(f"only finite numbers can be written, got {value}")
    rounded = float(value) if 0.9 < value < 1 else float(f"{value:.8g}")
    mantissa, sign, exponent = repr(rounded).partition("e")
    if "." not in mantissa:
        mantissa += ".0"
    return f"{mantissa}e{int(exponent):+03d}" if sign else mantissa


def decimal(value: float) -> str:
    """Return a number for parsers that reject exponents: ``0.00001``."""
    digits = format(Decimal(real(value)), "f")
    return digits if "." in digits else digits + ".0"


def quoted(text: str) -> str:
    """Return a double-quoted scalar without control characters, valid in YAML, in JSON and for OpenCV."""
    return printable_json(json.dumps(text, ensure_ascii=False))


def comment(lines: Iterable[str], sign: str = "#") -> str:
    """Return the lines as comments."""
    return "\n".join(f"{sign} {one_line(line)}".rstrip() for line in lines)


_GROWTH = {Sensor.GYROSCOPE: "rad/s^2", Sensor.ACCELEROMETER: "m/s^3"}


@dataclass(frozen=True)
class Formula:
    """Compute a number from a coefficient c and the rate f of the file's stream, in Hz.

    ``{u}`` in the unit is replaced by the unit of the samples (N) or of their rate of change (K), and ``{s}``
    by the unit of the samples.
    """

    of: Callable[[float, float], float]
    unit: str

    @property
    def power(self) -> int:
        """Power of the coefficient: 1, or 2 for variances."""
        return round(math.log2(self.of(2.0, 1.0) / self.of(1.0, 1.0)))

    def inverse(self, number: float, f: float) -> float:
        """Return the coefficient of a positive number."""
        return float((number / self.of(1.0, f)) ** (1 / self.power))


#: Suffix of a term's symbol in a key -> formula. Discrete numbers are per sample (N) or per step (K).
FORMULAS = {
    "": Formula(lambda c, _: c, "{u}/sqrt(Hz)"),
    "^2": Formula(lambda c, _: c * c, "({u})^2/Hz"),
    " sqrt(f)": Formula(lambda c, f: c * math.sqrt(f), "{u}"),
    "^2 f": Formula(lambda c, f: c * c * f, "({u})^2"),
    # FusionCore adds the variance of the bias once per IMU message, without dt.
    "^2 / f": Formula(lambda c, f: c * c / f, "({s})^2"),
    # VINS averages two samples, but its covariance propagation adds half of the variance twice.
    " sqrt(2 f)": Formula(lambda c, f: c * math.sqrt(2 * f), "{u}"),
    # PX4 and ArduPilot use the filter's own period, not the IMU's rate.
    " / sqrt(0.01 s)": Formula(lambda c, _: c / math.sqrt(0.01), "{u}"),
    " / sqrt(0.012 s)": Formula(lambda c, _: c / math.sqrt(0.012), "{u}"),
    # AirSim's units; the file's tau is 100 s.
    " in deg/sqrt(h)": Formula(
        lambda c, _: c * TERMS["N"].datasheet_unit(Sensor.GYROSCOPE).factor, "deg/sqrt(h)"
    ),
    " sqrt(100 s) in deg/h": Formula(
        lambda c, _: c * math.sqrt(100.0) * TERMS["B"].datasheet_unit(Sensor.GYROSCOPE).factor, "deg/h"
    ),
    " in mg/sqrt(Hz)": Formula(lambda c, _: c / G0 * 1e3, "mg/sqrt(Hz)"),
    " sqrt(100 s) in ug": Formula(lambda c, _: c * math.sqrt(100.0) / G0 * 1e6, "ug"),
}


@dataclass(frozen=True)
class Key:
    """A key of a file: a sensor, a term, and the formula of the number.

    The name contains ``{axis}`` or ``{i}`` if the file has a key for each axis, and ends with ``[]`` if the
    key contains a list of three axes.
    """

    name: str
    sensor: Sensor
    symbol: str
    formula: Formula

    @classmethod
    def parse(cls, text: str) -> "Key":
        """Return the key of a line such as ``gyr_cov = gyro N^2 f``."""
        name, sensor, symbol, formula = re.fullmatch(r"(\S+) = (gyro|accel) ([A-Z])(.*)", text).groups()  # type: ignore[union-attr]
        (own,) = (each for each in Sensor if each.short == sensor)
        return cls(name, own, symbol, FORMULAS[formula])

    @property
    def unit(self) -> str:
        own = self.sensor.unit
        return self.formula.unit.format(u=_GROWTH[self.sensor] if self.symbol == "K" else own, s=own)

    @property
    def each_axis(self) -> bool:
        """Whether the file has a number for each axis; the others follow the axis policy."""
        return self.name.endswith("[]") or "{" in self.name


class Entry(NamedTuple):
    """A key with its number, or with one number per axis."""

    name: str
    sensor: Sensor
    symbol: str
    value: float | list[float]
    unit: str
    numbers: tuple[Number, ...]

    @property
    def note(self) -> str:
        return self.numbers[0].note

    @property
    def remark(self) -> str:
        return f"{self.unit}; {self.note}"

    @property
    def description(self) -> str:
        """Name, unit and origin, for files without comments."""
        return f"{self.name}: {self.remark}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """A downstream format: one table of `formats/*.toml`.

    - `title`: the consumer and its file, for lists; `heading`: the same for the comment
    - `source`: source code that was read, and programs that were run, to find the meaning of the numbers
    - `kind`: whether the numbers are continuous or discrete
    - `text`: template of the file without the comment
    - `about`: how the consumers of the family use the numbers
    - `every`: symbols of the terms that the file contains for every axis
    - `bias`: whether each axis has a bias with its own T, or all axes share one T; empty without bias
    - `read_back`: whether `imucal` recognises a user's file by its keys and checks them
    - `documented`: key -> lowest and highest value that the consumer documents
    - `carries`: symbols of the terms that the format supports
    - `own_rates`: whether each sensor has its own rate
    - `layout`: ``json``, ``xml``, ``opencv``, or the sign that starts a comment
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
        """Whether the format's white noise and slow bias must cover all other noise."""
        carries = self.carries.split()
        return "B" not in carries and set(COVERING) <= set(carries)

    def is_called(self, name: str) -> bool:
        """Ignore case and punctuation; aliases do not count."""
        return name_key(name) == name_key(self.name)

    def numbers(self, report: Report, options: ExportOptions) -> Numbers:
        return Numbers(
            report=report,
            options=options,
            target=self.name,
            covers=self.covers and options.numbers == "covered",
            horizon_s=options.horizon_s or max(self.horizon_s, 2 * options.step_s),
        )

    def render(self, report: Report, options: ExportOptions, *, calibrated: bool = False) -> str:
        """Return the text of the file; raises `DataError` if a number is missing.

        With `calibrated`, the matrices of the sensors are left out, because a calibration adds them.
        """
        numbers, carried = self.numbers(report, options), self.carries.split()
        if "K" in carried:
            _refuse_without_walk(report, self.title)
        known = self._known(numbers)
        body = template(self.text).render(known, calibrated=calibrated).removesuffix("\n")
        estimates = [(axis, e) for axis in report.axes for e in axis.fit.estimates]
        lines = [(axis, line) for axis in report.axes for line in axis.fit.goodness.lines]
        return template(_format("file.txt")).render(
            known,
            body=body,
            options_line=options_line(options, numbers.horizon_s),
            all_sensors=tuple(Sensor),
            rates=[numbers.rate_hz(sensor) for sensor in numbers.sensors],
            lost=[(axis, e) for axis, e in estimates if e.value is not None and e.symbol not in carried],
            swings=[
                (axis.name, line.amplitude / (math.pi * line.frequency_hz), line) for axis, line in lines
            ],
        )

    def _known(self, numbers: Numbers) -> dict[str, object]:
        """Return the variables of the templates; ``f`` is the rate of the file in Hz."""
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
            "factor": numbers.options.factor,
            "keys": keys,
            "every": every,
            "biased": biased,
            "used": used,
            "bounds": bounds,
            "f": numbers.stream_hz,
        }


def read_targets(families: Iterable[str]) -> Iterator[Target]:
    """Yield the formats of ``formats/FAMILY.toml``; its top-level keys apply to the whole family."""
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


#: A slow term of a data sheet, for a message.
_SLOW_TERMS = {Sensor.GYROSCOPE: "B=10deg/h", Sensor.ACCELEROMETER: "B=40ug"}


def _refuse_without_walk(report: Report, title: str) -> None:
    """Raise DataError for a model as given, such as N of a data sheet, without any slow noise.

    A measured record bounds the walk; a model does not.
    """
    for axis in report.axes:
        symbols = {term.symbol for term in axis.fit.model.terms}
        if axis.fit.method == GIVEN and symbols <= {"N", "Q"}:
            if isinstance(part := report.settings.get("sensor"), str):
                raise _without_bias(part, report, title)
            msg = (
                f"the model of the {axis.sensor} has no slow noise, and {title} needs a random walk of its "
                "bias; "
                f"add a term of the data sheet or your own choice, such as '+ {_SLOW_TERMS[axis.sensor]}'"
            )
            raise DataError(msg)


def _without_bias(name: str, report: Report, title: str) -> DataError:
    """Return the error for a data sheet that prints no slow noise, with a command that completes it."""
    from imucal.sensors import find_sensor
    from imucal.sensors.part import WALK_SPREAD

    part = find_sensor(name)
    models = part_models(part)
    missing = [sensor for sensor in models if not part.sensors[sensor].terms.keys() & {"B", "K"}]
    names = " and the ".join(map(str, missing))
    problem = f"the data sheet gives no B of the {names}, and {title} needs a random walk of its bias"
    walks = {sensor: part.typical_walk(sensor) for sensor in missing}
    if None in walks.values():
        advice = "record a log at rest and run 'imucal fit' on it"
        return DataError(problem, place=part.name, fix=Fix(advice))
    for sensor, walk in walks.items():
        models[sensor] += f" + K={walk:g}"
    options = " ".join(f'--{sensor.short} "{text}"' for sensor, text in models.items())
    command = f"imucal export {options} --rate {report.axes[0].rate_hz:g}"
    advice = (
        "record a log at rest and run 'imucal fit' on it, or export with the median K of measured MEMS "
        f"sensors, which is a guess within a factor of {WALK_SPREAD}: {command} --to …"
    )
    return DataError(problem, place=part.name, fix=Fix(advice))


def _entries(numbers: Numbers, keys: Iterable[Key]) -> Iterator[Entry]:
    for key in keys:
        if key.sensor not in numbers.sensors:
            continue
        each, one = numbers.each, numbers.one
        chosen = each(key.sensor, key.symbol) if key.each_axis else (one(key.sensor, key.symbol),)
        values = [key.formula.of(number.value, numbers.stream_hz) for number in chosen]
        if key.name.endswith("[]"):
            yield Entry(key.name[:-2], key.sensor, key.symbol, values, key.unit, chosen)
            continue
        for i, (number, value) in enumerate(zip(chosen, values, strict=True)):
            name = key.name.format(i=i, axis="xyz"[i])
            yield Entry(name, key.sensor, key.symbol, value, key.unit, (number,))


def _biased(numbers: Numbers, bias: str) -> dict[Sensor, list[WithBias]]:
    triads = {sensor: numbers.triad(sensor) for sensor in numbers.sensors}
    axes = [axis for triad in triads.values() for axis in triad]
    groups = [axes] if bias == "all axes" else [[axis] for axis in axes]
    found = [each for group in groups for each in numbers.with_bias(group)]
    return {sensor: found[3 * i : 3 * i + 3] for i, sensor in enumerate(triads)}


@cache
def template(text: str) -> "Template":
    """Return the template of a file; see `_environment`."""
    return _environment().from_string(text)


def _format(name: str) -> str:
    return files("imucal.report.exports").joinpath("formats", name).read_text("utf-8")


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, StrictUndefined

    made = Environment(  # noqa: S701 - configs, not HTML
        undefined=StrictUndefined, finalize=_spelled, trim_blocks=True, lstrip_blocks=True
    )
    made.globals |= {"G0": G0, "TERMS": TERMS, "sqrt": math.sqrt, "inf": math.inf}
    made.globals |= {"INFLATABLE": INFLATABLE, "price": price, "itself": itself, "causes": causes}
    made.filters |= {"quoted": quoted, "plain": one_line, "comment": comment, "decimal": decimal}
    made.filters["lines"] = _lines
    made.filters["times"] = lambda values, factor, name: [getattr(value, name) * factor for value in values]
    return made


def _spelled(value: object) -> object:
    if isinstance(value, float):
        return real(value)
    return f"[{', '.join(map(real, value))}]" if isinstance(value, list) else value


def _lines(found: Iterable[Entry], indent: str = "") -> str:
    """Return one line of YAML per key, with unit and origin."""
    return "\n".join(f"{indent}{e.name}: {_spelled(e.value)}  # {e.remark}" for e in found)


def price(pair: FilterNumbers) -> str:
    """Return the predicted over the modelled error after some times of coasting."""
    within = [(t, ratio) for t, ratio in pair.ratios if t <= pair.horizon_s] or list(pair.ratios)
    ratios = " ".join(f"{ratio:.2g}" for _, ratio in within)
    return f"{ratios} x the model's error at {', '.join(f'{t:g}' for t, _ in within)} s"


def itself(axes: Sequence[AxisReport], number: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return the fitted coefficients, each for the axis with the largest."""
    message = []
    for key in dict.fromkeys(e.key for axis in axes for e in axis.fit.estimates):
        found = [e for axis in axes for e in axis.fit.estimates if e.key == key]
        worst = max(found, key=lambda e: (e.value is not None, e.value or e.high))
        if worst.value is None:
            message += [f"{key} < {number(worst.high)}"] if worst.high else []
        else:
            limits = f" ({number(worst.low)} to {number(worst.high)})" if worst.low < worst.high else ""
            message.append(f"{key} {number(worst.value)}{limits}")
    return ", ".join(message)
