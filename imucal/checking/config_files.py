"""Check the noise parameters in the config file of a filter against the report of the sensor.

A number passes if it is at least the number for the fitted values. Between this and the number for their
limits, the record is too short to decide. A wrong number is compared with likely mistakes, such as degrees.
One mistake that explains all numbers of the file, or of a sensor, is preferred to a separate one for each.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imucal.checking.config_mistakes import RightNumber, shared_mistake
from imucal.checking.limits import text_of
from imucal.checking.verdict import WORST_FIRST, Row, Verdict
from imucal.errors import Fix, LimitsError
from imucal.noise.terms import TERMS
from imucal.prediction.filter_numbers import LEVEL, covered_frequencies
from imucal.prediction.propagation import MEAN, Caution, upper_limit
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import Numbers, read_options
from imucal.report.exports.target import Key, Target, real
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report

#: Sufficient share of the required deviation: NEES is 1.2.
_ENOUGH = 1 / math.sqrt(1.2)
#: Multiple of the required coefficient from which a note says so.
_CAUTIOUS = 10.0
#: Multiple of the required coefficient from which a mistake is searched for.
_SUSPECT = 2.0
#: The fitted values without their limits.
_VALUES = Caution(0.0, 0.0)
#: Share of the right coefficient below which no sensor is so good.
_ABSURD = 1e-3
#: The same share of a bound: no bound is this far above the truth.
_FAR_BELOW_A_BOUND = 1e-5
#: The fitted N or K alone is recognised within this factor.
_AS_FITTED = 1.1
#: Largest relative difference of two equal sampling rates.
_SAME_RATE = 0.01

_COMMENT = re.compile(r"(^|\s)#.*|;.*")
_SETTING = re.compile(
    r"""\s*(?P<vehicle>\d+\s+\d+\s+)?(?:param\s+set(?:-default)?\s+|-\s+)?["']?(?P<name>[A-Za-z_][\w./]*)["']?"""
    r"""(?:\s*[:=,]\s*|\s+)(?P<value>.*)"""
)
_NUMBER = re.compile(r"[^\s,\[\]\"']+")


class Setting(NamedTuple):
    """A key of a config file: line from 1, and numbers as written."""

    file: str
    line: int
    name: str
    written: tuple[str, ...]
    text: str

    @property
    def numbers(self) -> tuple[float, ...]:
        """None if the value contains anything but numbers."""
        found = tuple(map(_number, self.written))
        return found if all(map(math.isfinite, found)) else ()

    @property
    def place(self) -> str:
        return f"{self.file}:{self.line}: {self.name}"

    def is_called(self, name: str) -> bool:
        return self.name == name or self.name.endswith((f"/{name}", f".{name}"))

    def with_number(self, value: str) -> str:
        """Return the line with another number; in a matrix it replaces all numbers except zeros."""
        at = self.text.find(self.name) + len(self.name)
        old = [text for text in self.written if len(self.written) == 1 or _number(text)]
        spelled = "|".join(map(re.escape, dict.fromkeys(old)))
        line = re.sub(rf"(?<![\w.+-])({spelled})(?![\w.])", value, self.text[at:]) if old else f": {value}"
        return f"{self.text[:at]}{line}".strip()


def read_settings(text: str, file: str = "") -> list[Setting]:
    """Return the keys of a config file: YAML, OpenCV's YAML, parameters, or assignments.

    Sections are keys without a number.
    """
    lines = iter([(i, _COMMENT.sub("", line).rstrip()) for i, line in enumerate(text.splitlines(), 1)])
    found, section = list[Setting](), ""
    for number, line in lines:
        match = _SETTING.fullmatch(line)
        if match is None:
            continue
        name, value = match["name"], match["value"]
        more: list[str] = []
        while "[" in value and "]" not in "".join([value, *more]) and (following := next(lines, None)):
            more.append(following[1].strip())
        value = " ".join([value, *more])
        if not value or value.startswith("!!"):
            section = name
        written = _NUMBER.findall(value)[: 1 if match["vehicle"] else None]
        # OpenCV's matrices have their numbers under `data`.
        name = section if name == "data" and section else name
        found.append(Setting(file, number, name, tuple(written), " ".join([line, *more])))
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def check_config(path: Path, report: Report) -> tuple[Row, ...]:
    """Return a row for each noise parameter and sampling rate in a config file.

    If imucal wrote the file, the options in its comment are used. Raises LimitsError if the file can't be
    read or has an unknown format, and DataError if the report lacks an axis that the format needs.
    """
    text = text_of(path, "the config file of a filter")
    settings = read_settings(text, path.name)
    try:
        options = read_options(text)
    except ValueError as error:
        problem = "the line of imucal's options in a comment is not valid"
        fix = Fix("remove the line, or export the file again")
        raise LimitsError(problem, place=path, fix=fix) from error
    there = {setting.name for setting in settings}
    # Of several formats with the same keys, choose the one with the most other lines in the file.
    own, target = max(
        ((read_settings(each.render(report, options)), each) for each in _formats(path, settings)),
        key=lambda each: len(there & {setting.name for setting in each[0]}),
    )
    numbers = target.numbers(report, options)
    return (*noise_rows(settings, target.keys, own, numbers), *rate_rows(settings, own, numbers.stream_hz))


def _names(key: Key) -> tuple[str, ...]:
    return tuple(dict.fromkeys(key.name.format(i=i, axis=axis) for i, axis in enumerate("xyz")))


def _formats(path: Path, settings: Sequence[Setting]) -> list[Target]:
    """Return the format with the most keys in a file, or several with the same keys."""
    counts = {
        target.name: sum(s.is_called(name) for s in settings for key in target.keys for name in _names(key))
        for target in TARGETS.values()
        if target.read_back
    }
    most = max(counts.values())
    if not most:
        known = ", ".join(name for name in counts if TARGETS[name].keys)
        raise LimitsError(f"found no noise parameter; expected a file of one of {known}", place=path)
    return [TARGETS[name] for name, count in counts.items() if count == most]


def rate_rows(settings: Sequence[Setting], own: Sequence[Setting], rate_hz: float) -> Iterator[Row]:
    """Judge each sampling rate in a file against the rate of the log; `own` is the exporter's file."""
    names = {each.name: None for each in own if each.numbers == (rate_hz,)}
    for setting in (each for name in names for each in settings if each.name == name):
        if len(setting.numbers) != 1:
            continue
        same = abs(setting.numbers[0] / rate_hz - 1) <= _SAME_RATE
        instead = "" if same else setting.with_number(real(rate_hz))
        found = f"{setting.place} is {setting.numbers[0]:g} Hz, and the log has {rate_hz:g} Hz"
        if instead:
            found += ", perhaps another rate than the IMU"
        verdict: Verdict = "undecided" if instead else "pass"
        yield Row("log", setting.name, verdict, found, instead=instead)


def noise_rows(
    settings: Sequence[Setting], keys: Sequence[Key], own: Sequence[Setting], numbers: Numbers
) -> Iterator[Row]:
    """Judge the noise parameters; `own` are the keys of the exporter's own file."""
    spelled = {each.name: each.written[0] for each in own if each.written}
    there = _settings_of(keys, settings)
    judged: list[tuple[Setting, _Wanted, str]] = []
    for key, i, setting in there:
        if key.sensor not in numbers.sensors:
            found = f"{setting.place}: the report has no {key.sensor}; use a report with one"
            yield Row(key.sensor.short, setting.name, "undecided", found)
            continue
        mates = [(k, s) for k, j, s in there if (k.sensor, j) == (key.sensor, i) and k.symbol != key.symbol]
        wanted = _Wanted.of(key, i, mates, numbers)
        judged.append((setting, wanted, spelled.get(_names(key)[i]) or real(wanted.right.right)))
    wrong = [number for setting, wanted, _ in judged for number in wanted.wrong(setting)]
    of_file = shared_mistake(wrong)
    for setting, wanted, line in judged:
        of_sensor = shared_mistake(
            [(key, number) for key, number in wrong if key.sensor == wanted.key.sensor]
        )
        yield _noise_row(setting, wanted, line, of_file or of_sensor)


def _settings_of(keys: Sequence[Key], settings: Sequence[Setting]) -> list[tuple[Key, int, Setting]]:
    """Return each key with the index of its axis and its setting in the file."""
    return [
        (key, i, each)
        for key in keys
        for i, name in enumerate(_names(key))
        for each in settings
        if each.is_called(name)
    ]


def _noise_row(setting: Setting, wanted: "_Wanted", spelled: str, shared: str) -> Row:
    """Return the verdict on a key; for a matrix, on the worst number of its diagonal.

    `shared` is the name of a mistake that explains other keys too, or empty.
    """
    judged = [(*wanted.judge(number, shared), number) for number in _diagonal(setting)]
    verdict, message, number = min(judged, key=lambda each: WORST_FIRST.index(each[0]))
    key, right = wanted.key, wanted.right.right
    # A number that passes only with the file's other number has no limit of its own.
    alone = verdict != "pass" or number >= right
    instead = setting.with_number(spelled) if message and alone else ""
    shown = " ".join(setting.written) if math.isnan(number) else f"{number:.4g} {key.unit}"
    enough = f"enough for this sensor, {number / right:.3g} times the needed number"
    return Row(
        key.sensor.short,
        setting.name,
        verdict,
        f"{setting.place} is {shown}; {message or enough}",
        side="min" if alone else None,
        limit=right if alone else None,
        unit=key.unit,
        measured=Quantity.exactly(number),
        instead=instead,
    )


def _diagonal(setting: Setting) -> tuple[float, ...]:
    """Return the numbers of a setting, or the diagonal of a square matrix; NaN if there is none."""
    numbers = setting.numbers
    size = math.isqrt(len(numbers))
    square = size > 1 and size * size == len(numbers)
    return (numbers[:: size + 1] if square else numbers) or (math.nan,)


@dataclass(frozen=True)
class _Wanted:
    """The required value of a key: white noise or random walk of some axes.

    `other` is the coefficient of the sensor's other number, the larger of the file's and the exporter's, or
    zero if the format has none.
    """

    key: Key
    axes: Sequence[AxisReport]
    numbers: Numbers
    right: RightNumber
    other: float

    @classmethod
    def of(cls, key: Key, axis: int, mates: Sequence[tuple[Key, Setting]], numbers: Numbers) -> "_Wanted":
        rate_hz = numbers.stream_hz
        axes = (numbers.triad(key.sensor)[axis],) if "{" in key.name else numbers.chosen(key.sensor)
        right, other = _coefficients(key.symbol, axes, numbers)
        for mate, setting in mates:
            if (least := min(_diagonal(setting))) > 0:
                other = max(other, mate.formula.inverse(least, rate_hz))
        elsewhere: list[float] = []
        for axes_elsewhere in (numbers.chosen(sensor) for sensor in numbers.sensors if sensor != key.sensor):
            elsewhere.append(_coefficients(key.symbol, axes_elsewhere, numbers)[0])
            elsewhere.append(_fitted(axes_elsewhere).get(key.symbol, 0.0))
        number = RightNumber(
            sensor=key.sensor,
            symbol=key.symbol,
            formula=key.formula,
            right=key.formula.of(right, rate_hz),
            rate_hz=rate_hz,
            fitted=_fitted(axes),
            elsewhere=[coefficient for coefficient in elsewhere if coefficient],
        )
        return cls(key, axes, numbers, number, other)

    def wrong(self, setting: Setting) -> list[tuple[RightNumber, float]]:
        """Return the numbers of a setting that are too small, or so large that they may be a mistake."""
        return [
            (self.right, number)
            for number in _diagonal(setting)
            if 0 < number < math.inf and not _ENOUGH <= self.right.over(number) <= _SUSPECT
        ]

    def judge(self, number: float, shared: str) -> tuple[Verdict, str]:
        if not 0 < number < math.inf:
            return "fail", "expected a positive number"
        over = self.right.over(number)
        mistakes = self.right.explanations(number, shared)
        cause = ", or ".join(mistake.message for mistake in mistakes)
        if over < _ENOUGH:
            return self._too_small(number, cause, over)
        times = f"{number / self.right.right:.3g} times too large"
        if over > _SUSPECT and mistakes:
            on_purpose = all(mistake.on_purpose for mistake in mistakes)
            return "undecided" if on_purpose else "fail", f"{times}: {cause}"
        return "pass", f"{times}: too cautious for a sensor at rest" if over > _CAUTIOUS else ""

    def _too_small(self, number: float, cause: str, over: float) -> tuple[Verdict, str]:
        symbol, c = self.key.symbol, self.key.formula.inverse(number, self.numbers.stream_hz)
        times = f"{self.right.right / number:.3g} times too small"
        limits = Caution.at(LEVEL, self.axes[0].fit.level) if len(self.axes) == 1 else MEAN
        if self.numbers.covers and self._covers(c, limits):
            return "pass", "too small alone, but the file's other number makes up for it"
        if over > _FAR_BELOW_A_BOUND and self._covers(c, _VALUES):
            message = "unless a term is below its upper bound; record for longer"
            return "undecided", f"{times}, {message}"
        own = self.right.fitted.get(symbol, 0.0)
        if not self.numbers.covers:
            below = f"below {symbol} of the fit"
        else:
            below = "below the values that are enough for the fitted spectrum"
        if self.numbers.covers and own and 1 / _AS_FITTED < c / own < _AS_FITTED:
            return "fail", f"{times}: {symbol} of the fit alone is {below}"
        if over < _ABSURD:
            return "fail", f"{times}, absurd: {cause or 'no sensor is this good'}"
        return "fail", f"{times}: {cause or below}"

    def _covers(self, c: float, caution: Caution) -> bool:
        """Return whether a coefficient and the other number cover the spectra closely enough for a filter."""
        options = self.numbers.options
        if not self.numbers.covers:
            # The format has no walk that could replace other noise.
            symbol = self.key.symbol
            return c >= _ENOUGH * self.right.fitted.get(symbol, 0.0) * options.factor(symbol)
        white, walk = (c, self.other) if self.key.symbol == "N" else (self.other, c)
        f = covered_frequencies(self.numbers.horizon_s, options.step_s)
        walks = TERMS["K"].of(walk / options.factor("K")).psd(f, options.step_s)
        wanted = [
            upper_limit(axis.fit, lambda term: term.psd(f, options.step_s), caution) for axis in self.axes
        ]
        given = (white / options.factor("N")) ** 2 + walks
        return bool(np.all(given >= _ENOUGH**2 * np.max(wanted, axis=0)))


def _coefficients(symbol: str, axes: Sequence[AxisReport], numbers: Numbers) -> tuple[float, float]:
    """Return the required coefficient of a term and of the other one, zero if the format has no other."""
    if not numbers.covers:
        return numbers.joined(axes, symbol).value, 0.0
    pair = numbers.pair(axes)
    return (pair.white, pair.walk) if symbol == "N" else (pair.walk, pair.white)


def _fitted(axes: Sequence[AxisReport]) -> dict[str, float]:
    """Return the largest fitted coefficient of each term."""
    sizes = sorted((e.value or 0.0, e.symbol) for axis in axes for e in axis.fit.estimates)
    return {symbol: size for size, symbol in sizes}
