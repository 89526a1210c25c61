"""Check the noise parameters in the config file of a filter against the report of the sensor.

A number passes if it is at least the number for the fitted values. Between this and the number for their
limits, the record is too short to decide. A wrong number is compared with likely mistakes, such as degrees.
One mistake that explains all numbers of the file, or of a sensor, is preferred to a separate one for each.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imucal.checking.limits import text_of
from imucal.checking.verdict import WORST_FIRST, Row, Verdict
from imucal.errors import Fix, LimitsError
from imucal.noise.terms import TERMS
from imucal.prediction.filter_numbers import LEVEL, covered_frequencies
from imucal.prediction.propagation import MEAN, Caution, upper_limit
from imucal.recording import Sensor
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import Numbers, read_options
from imucal.report.exports.target import Key, Target, real
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report
from imucal.units import G0, SAMPLE_UNITS

#: Sufficient share of the required deviation: NEES is 1.2.
_ENOUGH = 1 / math.sqrt(1.2)
#: Multiple of the required coefficient from which a note says so.
_CAUTIOUS = 10.0
#: Multiple of the required coefficient from which a mistake is searched for.
_SUSPECT = 2.0
_VALUES = Caution(0.0, 0.0)
#: Share of the right coefficient below which no sensor is so good.
_ABSURD = 1e-3
#: The same share of a bound: no bound is this far above the truth.
_FAR_BELOW_A_BOUND = 1e-5
#: A number matches a mistake within this factor.
_NEAR = 1.35
#: The same for a small excess, which may be on purpose.
_NEAR_ON_PURPOSE = 1.1
#: Largest excess that may be on purpose, as a factor.
_ON_PURPOSE = 30.0
#: The same for one mistake of several numbers, of which one must match as above. K is often only bounded, and
#: then the exporter's number is up to twice the number of the truth.
_NEAR_SHARED = 2.0
#: People multiply by ten, which is nearly 9.81.
_ON_HABIT = ", or made ten times as large on purpose"
#: Largest difference of the natural logarithms of equal factors.
_EQUAL = 1e-6
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
    judged = list[tuple[Setting, _Wanted, str]]()
    for key, i, setting in there:
        short = key.sensor.short
        if key.sensor not in numbers.sensors:
            found = f"{setting.place}: the report has no {key.sensor}; use a report with one"
            yield Row(short, setting.name, "undecided", found)
            continue
        mates = [(k, s) for k, j, s in there if (k.sensor, j) == (key.sensor, i) and k.symbol != key.symbol]
        axes = (numbers.triad(key.sensor)[i],) if "{" in key.name else numbers.chosen(key.sensor)
        wanted = _Wanted.of(key, mates, axes, numbers)
        judged.append((setting, wanted, spelled.get(_names(key)[i]) or real(wanted.right)))
    shared = _shared_mistake([(wanted, setting) for setting, wanted, _ in judged])
    for setting, wanted, line in judged:
        same_sensor = [(other, s) for s, other, _ in judged if other.key.sensor is wanted.key.sensor]
        yield _noise_row(setting, wanted, line, shared or _shared_mistake(same_sensor))


def _settings_of(keys: Sequence[Key], settings: Sequence[Setting]) -> list[tuple[Key, int, Setting]]:
    """Return each key with the index of its axis and its setting in the file."""
    return [
        (key, i, each)
        for key in keys
        for i, name in enumerate(_names(key))
        for each in settings
        if each.is_called(name)
    ]


def _shared_mistake(numbers: Sequence[tuple["_Wanted", Setting]]) -> str:
    """Return the name of the mistake that explains all numbers of several keys best; empty if none does."""
    if len(numbers) < 2:
        return ""
    distances = [wanted.distances(each) for wanted, setting in numbers for each in _diagonal(setting)]
    common = set.intersection(*map(set, distances))
    totals = {
        name: sum(each[name] for each in distances)
        for name in common
        if min(each[name] for each in distances) < math.log(_NEAR)
    }
    return min(sorted(totals), key=lambda name: totals[name], default="")


def _noise_row(setting: Setting, wanted: "_Wanted", spelled: str, shared: str) -> Row:
    """Return the verdict on a key; for a matrix, on the worst number of its diagonal.

    `shared` is the name of a mistake that explains other keys too, or empty.
    """
    judged = [(*wanted.judge(number, shared), number) for number in _diagonal(setting)]
    verdict, message, number = min(judged, key=lambda each: WORST_FIRST.index(each[0]))
    key, right = wanted.key, wanted.right
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


class _Mistake(NamedTuple):
    """A likely mistake: its name in all keys, the number that it gives, and the message."""

    name: str
    number: float
    message: str


@dataclass(frozen=True)
class _Wanted:
    """The required value of a key: white noise or random walk of some axes.

    `right` is the number that the exporter writes. `other` is the coefficient of the sensor's other number,
    the larger of the file's and the exporter's, or zero if the format has none. `fitted` contains the largest
    fitted coefficients.
    """

    key: Key
    axes: Sequence[AxisReport]
    numbers: Numbers
    right: float
    other: float
    fitted: Mapping[str, float]

    @classmethod
    def of(
        cls, key: Key, mates: Sequence[tuple[Key, Setting]], axes: Sequence[AxisReport], numbers: Numbers
    ) -> "_Wanted":
        rate_hz = numbers.stream_hz
        if numbers.covers:
            pair = numbers.pair(axes)
            right = {"N": pair.white, "K": pair.walk}
            other = right["K" if key.symbol == "N" else "N"]
        else:
            right, other = {key.symbol: numbers.joined(axes, key.symbol).value}, 0.0
        for mate, setting in mates:
            if (least := min(_diagonal(setting))) > 0:
                other = max(other, mate.formula.inverse(least, rate_hz))
        sizes = sorted((e.value or 0.0, e.symbol) for axis in axes for e in axis.fit.estimates)
        fitted = {symbol: size for size, symbol in sizes}
        number = key.formula.of(right[key.symbol], rate_hz)
        return cls(key, axes, numbers, number, other, fitted)

    def judge(self, number: float, shared: str) -> tuple[Verdict, str]:
        if not 0 < number < math.inf:
            return "fail", "expected a positive number"
        over = (number / self.right) ** (1 / self.key.formula.power)
        mistake = self._mistake(number, shared)
        if over < _ENOUGH:
            return self._too_small(number, mistake, over)
        times = f"{number / self.right:.3g} times too large"
        if over > _SUSPECT and mistake:
            return "undecided" if mistake.endswith(_ON_HABIT) else "fail", f"{times}: {mistake}"
        return "pass", f"{times}: too cautious for a sensor at rest" if over > _CAUTIOUS else ""

    def _too_small(self, number: float, mistake: str, over: float) -> tuple[Verdict, str]:
        symbol, c = self.key.symbol, self.key.formula.inverse(number, self.numbers.stream_hz)
        times = f"{self.right / number:.3g} times too small"
        limits = Caution.at(LEVEL, self.axes[0].fit.level) if len(self.axes) == 1 else MEAN
        if self.numbers.covers and self._covers(c, limits):
            return "pass", "too small alone, but the file's other number makes up for it"
        if over > _FAR_BELOW_A_BOUND and self._covers(c, _VALUES):
            message = "unless a term is below its upper bound; record for longer"
            return "undecided", f"{times}, {message}"
        own = self.fitted.get(symbol, 0.0)
        if not self.numbers.covers:
            below = f"below {symbol} of the fit"
        else:
            below = "below the values that are enough for the fitted spectrum"
        if self.numbers.covers and own and 1 / _NEAR_ON_PURPOSE < c / own < _NEAR_ON_PURPOSE:
            return "fail", f"{times}: {symbol} of the fit alone is {below}"
        if over < _ABSURD:
            return "fail", f"{times}, absurd: {mistake or 'no sensor is this good'}"
        return "fail", f"{times}: {mistake or below}"

    def _covers(self, c: float, caution: Caution) -> bool:
        """Return whether a coefficient and the other number cover the spectra closely enough for a filter."""
        options = self.numbers.options
        if not self.numbers.covers:
            # The format has no walk that could replace other noise.
            symbol = self.key.symbol
            return c >= _ENOUGH * self.fitted.get(symbol, 0.0) * options.factor(symbol)
        white, walk = (c, self.other) if self.key.symbol == "N" else (self.other, c)
        f = covered_frequencies(self.numbers.horizon_s, options.step_s)
        walks = TERMS["K"].of(walk / options.factor("K")).psd(f, options.step_s)
        wanted = [
            upper_limit(axis.fit, lambda term: term.psd(f, options.step_s), caution) for axis in self.axes
        ]
        given = (white / options.factor("N")) ** 2 + walks
        return bool(np.all(given >= _ENOUGH**2 * np.max(wanted, axis=0)))

    def distances(self, number: float) -> dict[str, float]:
        """Return the distance of a wrong number from each mistake that may explain it, by its name."""
        if not 0 < number < math.inf:
            return {}
        over = (number / self.right) ** (1 / self.key.formula.power)
        if _ENOUGH <= over <= _SUSPECT:
            return {}
        found: dict[str, float] = {}
        for mistake in self._mistakes():
            distance = self._distance(number, mistake)
            if distance < self._tolerance(mistake, _NEAR_SHARED):
                found[mistake.name] = min(distance, found.get(mistake.name, math.inf))
        return found

    def _distance(self, number: float, mistake: _Mistake) -> float:
        """Return the difference of the natural logarithms of two coefficients."""
        return abs(math.log(number / mistake.number)) / self.key.formula.power

    def _tolerance(self, mistake: _Mistake, near: float) -> float:
        larger = (mistake.number / self.right) ** (1 / self.key.formula.power)
        return math.log(_NEAR_ON_PURPOSE if 1 < larger < _ON_PURPOSE else near)

    def _mistake(self, number: float, shared: str) -> str:
        """Return the message of the shared mistake, or of the nearest; empty if that one is too far."""
        mistakes = [each for each in self._mistakes() if shared in {"", each.name}]
        nearest = min(mistakes, key=lambda each: self._distance(number, each))
        near = _NEAR_SHARED if shared else _NEAR
        return nearest.message if self._distance(number, nearest) < self._tolerance(nearest, near) else ""

    def _mistakes(self) -> Iterator[_Mistake]:
        key, f, formula = self.key, self.numbers.stream_hz, self.key.formula
        symbol = key.symbol
        root, units = math.sqrt(f), TERMS[symbol].coefficient_units(key.sensor)
        wanted, sample = next(iter(units)), SAMPLE_UNITS[key.sensor]
        factors = {f"sqrt(f) at {f:g} Hz": root, f"f = {f:g} Hz": f, "57.3": 180 / math.pi, "9.81": G0}
        for c in {formula.inverse(self.right, f), self.fitted.get(symbol, 0.0)} - {0.0}:
            turned = (
                f"g into SI twice{_ON_HABIT}" if key.sensor is Sensor.ACCELEROMETER else "deg/s into SI twice"
            )
            twice = formula.of(c * sample[turned.split(maxsplit=1)[0]], f)
            slips = [
                _Mistake("deviation", c * root, f"{symbol}*sqrt(f), the deviation of one sample"),
                _Mistake("step", c / root, f"{symbol}/sqrt(f), the step of one sample"),
                _Mistake("variance", c * c * f, f"{symbol}^2*f, the variance of one sample"),
                _Mistake("density", c, f"{symbol}, the continuous density"),
                _Mistake("square", c * c, f"{symbol}^2, the square of the continuous density"),
                _Mistake("one root more", formula.of(c * root, f), "one such factor too many"),
                _Mistake("one root less", formula.of(c / root, f), "one such factor is missing"),
                _Mistake("one rate more", formula.of(c * f, f), "one factor of the rate too many"),
                _Mistake("one rate less", formula.of(c / f, f), "one factor of the rate is missing"),
                _Mistake("SI twice", twice, f"it was converted from {turned}"),
            ]
            for unit, of in units.items():
                message = f"it is in {unit}, not in {wanted}"
                # The units of N and K with the same factor belong together, such as deg/s.
                slips.append(_Mistake(f"unit {of:.3g}", formula.of(c / of, f), message))
            for mistake in slips:
                by = formula.inverse(mistake.number, f) / c
                size = abs(math.log(by))
                name = next((n for n, x in factors.items() if abs(size - math.log(x)) < _EQUAL), "")
                if size > _EQUAL:
                    message = f"by {name}: {mistake.message}" if name else mistake.message
                    yield mistake._replace(message=message)
        for other_symbol in {"N": "K", "K": "BN"}[symbol]:
            if other_c := self.fitted.get(other_symbol):
                names = (f"{s}, the {TERMS[s].name(key.sensor)}," for s in (other_symbol, symbol))
                message = " in place of ".join(names).removesuffix(",")
                yield _Mistake(f"{other_symbol} for {symbol}", formula.of(other_c, f), message)
