"""The config file of a filter read back: is each noise parameter what the sensor's report asks for?

The formats, and the formula of each key, are those that `imucal.report.exports` writes; a file is of the
format most of whose keys it has. A number is right from the least that the values of the fit ask for;
between that and what their limits ask for, the record is too short to tell. What else it may be is
looked up among the slips that people make: a factor of the rate, degrees, g, a square, another term.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np

from imucal.checking.verdict import Measured, Row, Verdict
from imucal.errors import LimitsError
from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.exports import TARGETS, AxisPolicy
from imucal.report.exports.config_numbers import Choices, Numbers
from imucal.report.exports.target import Key, Target, entries, real
from imucal.report.result import AxisReport, Report

#: A filter whose deviation is this share of the least is right by NEES of 1.2.
_ENOUGH = 1 / math.sqrt(1.2)
#: Beyond so many times the wanted coefficient a number is remarkable, and a slip is looked for.
_CAUTIOUS, _SUSPECT = 10.0, 2.0
#: A coefficient so many times below the least describes no sensor.
_ABSURD = 1e-3
#: How far from a slip's number a number is taken for it, as a factor on the coefficient: numbers of
#: other records differ; but up to the last factor people make them larger on purpose.
_NEAR, _NEAR_ON_PURPOSE, _ON_PURPOSE = 1.35, 1.1, 30.0
#: Rates that differ by more are not one.
_SAME_RATE = 0.01

_COMMENT = re.compile(r"(^|\s)#.*|;.*")
_SETTING = re.compile(
    r"""\s*(?P<vehicle>\d+\s+\d+\s+)?(?:param\s+set(?:-default)?\s+|-\s+)?["']?(?P<name>[A-Za-z_][\w./]*)["']?"""
    r"""(?:\s*[:=,]\s*|\s+)(?P<value>.*)"""
)
_NUMBER = re.compile(r"[^\s,\[\]\"']+")


class Setting(NamedTuple):
    """A key of a config file: its line, from 1, its name, its numbers (none for a text), and the line's text."""

    line: int
    name: str
    numbers: tuple[float, ...]
    text: str

    def is_called(self, name: str) -> bool:
        """Return whether this is the key of a name, in whatever section."""
        return self.name == name or self.name.endswith((f"/{name}", f".{name}"))

    def with_number(self, value: str) -> str:
        """Return the line with another number in place of its own; of a list in place of each but zeros."""
        start = self.text.find(self.name) + len(self.name)
        other = _NUMBER.sub(lambda found: found[0] if _number(found[0]) in (None, 0) else value, self.text[start:])
        return f"{self.text[:start]}{other}".strip()


def read_settings(text: str) -> list[Setting]:
    """Return the keys of a config file: YAML, OpenCV's YAML, parameters, or assignments.

    Sections are read as keys without a number, matrices as keys with all of theirs.
    """
    lines = iter([(i, _COMMENT.sub("", line).rstrip()) for i, line in enumerate(text.splitlines(), 1)])
    found, section = list[Setting](), ""
    for number, line in lines:
        match = _SETTING.fullmatch(line)
        if match is None:
            continue
        name, value = match["name"], match["value"]
        while "[" in value and "]" not in value and (more := next(lines, None)):
            value += f" {more[1].strip()}"
            line += f" {more[1].strip()}"
        if not value or value.startswith("!!"):
            section = name
        texts = _NUMBER.findall(value)[: 1 if match["vehicle"] else None]
        numbers = [_number(each) for each in texts]
        known = tuple(each for each in numbers if each is not None)
        # OpenCV's matrices keep their numbers under a key of their own.
        name = section if name == "data" and section else name
        found.append(Setting(number, name, known if len(known) == len(numbers) else (), line))
    return found


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def check_config(path: Path, report: Report) -> tuple[Row, ...]:
    """Judge the noise parameters of a config file by the report of its sensor.

    A file that imucal wrote is held to the options that its comment names.

    Returns
    -------
    tuple of Row
        One for each key that holds a number of the noise, or the sampling rate.

    Raises
    ------
    LimitsError
        If the file can't be read, or is of no format whose keys are known.
    DataError
        If the report lacks an axis that the format needs.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        msg = f"{path}: can't be read ({reason}), expected the config file of a filter"
        raise LimitsError(msg) from error
    settings, choices = read_settings(text), _choices(text)
    target = _format(path, settings, report, choices)
    return (*_noise(path, settings, report, target, choices), *_rates(path, settings, report, target, choices))


def _choices(text: str) -> Choices:
    """Return the options that imucal's own comment in a file names."""
    inflated = re.search(r"inflation: (.*); ALREADY", text)
    factors = re.findall(r"(\w+) \([^)]*\) x ([\d.e+-]+)", inflated[1]) if inflated else []
    axes = re.search(r"axes: (\w+)", text)
    policies: dict[str, AxisPolicy] = {policy: policy for policy in get_args(AxisPolicy)}
    times = re.search(r"aided every (\S+) s or slower, horizon (\S+) s", text)
    return Choices(
        inflate={name: float(factor) for name, factor in factors},
        axis_policy=policies.get(axes[1] if axes else "", "worst"),
        **({"step_s": float(times[1]), "horizon_s": float(times[2])} if times else {}),
    )


def _names(key: Key) -> tuple[str, ...]:
    """Return the names of a key: one, or one an axis."""
    return tuple(dict.fromkeys(key.name.format(i=i, axis=axis) for i, axis in enumerate("xyz")))


def _format(path: Path, settings: Sequence[Setting], report: Report, choices: Choices) -> Target:
    """Return the format with most of its keys in a file; of several, that whose other lines are there too."""
    counts = {
        target.name: sum(
            setting.is_called(name) for setting in settings for key in target.keys for name in _names(key)
        )
        for target in TARGETS.values()
    }
    most = max(counts.values())
    if not most:
        known = ", ".join(target.name for target in TARGETS.values() if target.keys)
        msg = f"{path}: found no key of a noise parameter, expected the file of one of {known}"
        raise LimitsError(msg)
    there = {setting.name for setting in settings}

    def alike(target: Target) -> int:
        return len(there & {setting.name for setting in read_settings(target.render(report, choices))})

    return max((target for target in TARGETS.values() if counts[target.name] == most), key=alike)


def _rates(
    path: Path, settings: Sequence[Setting], report: Report, target: Target, choices: Choices
) -> Iterator[Row]:
    """Judge the keys that hold the rate of the stream: those that the format's own file has it in."""
    rate_hz = target.numbers(report, choices).stream_hz
    for own in read_settings(target.render(report, choices)):
        for setting in settings if own.numbers == (rate_hz,) else ():
            if setting.name != own.name or len(setting.numbers) != 1:
                continue
            same = abs(setting.numbers[0] / rate_hz - 1) <= _SAME_RATE
            instead = "" if same else setting.with_number(real(rate_hz))
            text = f"log: {path.name}:{setting.line}: {setting.name} is {setting.numbers[0]:g} Hz, "
            text += f"and {rate_hz:g} Hz the rate of the log"
            if not same:
                text += f"; unless the IMU runs at another rate than in the log, write '{instead}'"
            yield Row(
                where="log",
                subject=setting.name,
                verdict="pass" if same else "undecided",
                text=text,
                instead=instead,
            )


def _noise(
    path: Path, settings: Sequence[Setting], report: Report, target: Target, choices: Choices
) -> Iterator[Row]:
    """Judge the keys that hold a number of the noise."""
    numbers = target.numbers(report, choices)
    for key in target.keys:
        found = [(name, each) for name in _names(key) for each in settings if each.is_called(name)]
        if key.sensor not in numbers.sensors:
            for name, _ in found:
                text = f"{key.sensor.short}: {name}: the report has no {key.sensor}; check against one that has"
                yield Row(where=key.sensor.short, subject=name, verdict="undecided", text=text)
            continue
        right = {entry.name: entry for entry in entries(numbers, (key,))} if found else {}
        for name, setting in found:
            axes = numbers.chosen(key.sensor) if len(right) == 1 else (numbers.axis(key.sensor, "xyz"[_names(key).index(name)]),)
            wanted = _Wanted.of(key, right[name].value, axes, numbers)
            yield _row(path, setting, wanted)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wanted:
    """What a key should hold.

    Attributes
    ----------
    key
        The key.
    right, least
        What the exporter writes; and what covers the values of the fit alone, their limits left out.
    rate_hz
        Of the file's stream.
    fitted
        Symbol -> largest coefficient that the fits of the axes show.
    """

    key: Key
    right: float
    least: float
    rate_hz: float
    fitted: Mapping[str, float]

    @classmethod
    def of(cls, key: Key, right: float, axes: Sequence[AxisReport], numbers: Numbers) -> "_Wanted":
        """Return what the axes ask for."""
        pair = numbers.pair([_at_values(axis) for axis in axes])
        least = {"N": pair.white, "K": pair.walk}[key.symbol] * numbers.choices.factor(key.symbol)
        fitted: dict[str, float] = {}
        for estimate in (estimate for axis in axes for estimate in axis.fit.estimates):
            if estimate.value:
                fitted[estimate.symbol] = max(estimate.value, fitted.get(estimate.symbol, 0.0))
        rate_hz = numbers.stream_hz
        return cls(
            key=key, right=right, least=min(key.formula.of(least, rate_hz), right), rate_hz=rate_hz, fitted=fitted
        )

    def ratio(self, number: float, to: float) -> float:
        """Return the ratio of the coefficients behind two numbers."""
        return float((number / to) ** (1 / self.key.formula.power))

    def slips(self) -> Iterator[tuple[float, str]]:
        """Yield numbers that people write in its place, each with what it is."""
        symbol, rate_hz, of = self.key.symbol, self.rate_hz, self.key.formula.of
        root = math.sqrt(rate_hz)
        for c in dict.fromkeys([self.fitted.get(symbol, 0.0), self.ratio(self.right, of(1.0, rate_hz))]):
            if not c:
                continue
            yield c * root, f"{symbol}*sqrt(f), the deviation of one sample"
            yield c / root, f"{symbol}/sqrt(f), a step from sample to sample"
            yield c * c * rate_hz, f"{symbol}^2*f, the variance of one sample"
            yield c, f"{symbol} itself, a continuous density"
            yield c * c, f"{symbol}^2, the square of a continuous density"
            yield of(c * root, rate_hz), f"a factor sqrt(f), f = {rate_hz:g} Hz, too much"
            yield of(c / root, rate_hz), f"a factor sqrt(f), f = {rate_hz:g} Hz, is missing"
            yield of(c * rate_hz, rate_hz), f"a factor f = {rate_hz:g} Hz too much"
            yield of(c / rate_hz, rate_hz), f"a factor f = {rate_hz:g} Hz is missing"
            units = TERMS[symbol].coefficient_units(self.key.sensor)
            wanted = next(iter(units))
            for unit, factor in units.items():
                if factor != 1:
                    yield of(c / factor, rate_hz), f"it is in {unit}, and {wanted} is wanted"
                    yield of(c * factor, rate_hz), f"it was turned from {unit} into {wanted} twice"
        names = {"N": "white noise", "B": "bias instability", "K": "random walk"}
        for other, name in names.items():
            if other != symbol and (c := self.fitted.get(other)):
                said = f"{other}, the {name}, in place of {symbol}, the {names[symbol]}"
                yield of(c, rate_hz), said
                yield c, said
        if own := self.fitted.get(symbol):
            yield of(own, rate_hz), f"{symbol} of the fit alone, which leaves out its other terms"

    def slip(self, number: float) -> str:
        """Return what a number is that is not the right one, by its nearest slip; empty where none is near."""
        nearest = min(self.slips(), key=lambda each: abs(math.log(self.ratio(number, each[0]))))
        larger = self.ratio(nearest[0], self.right)
        near = _NEAR_ON_PURPOSE if 1 < larger < _ON_PURPOSE else _NEAR
        return nearest[1] if 1 / near < self.ratio(number, nearest[0]) < near else ""

    def judge(self, number: float) -> tuple[Verdict, str]:
        """Return the verdict on a number, and what is to be said of it."""
        if not 0 < number < math.inf:
            return "fail", "no filter takes it; expected a positive number"
        over, above_least, slip = self.ratio(number, self.right), self.ratio(number, self.least), self.slip(number)
        times = self._times(number)
        if above_least < _ENOUGH:
            if not slip and above_least < _ABSURD:
                slip = "absurd, no such sensor is known; a slope was read where the curve has none"
            return "fail", f"{times}: {slip or 'below what covers the fitted spectrum'}"
        if over < _ENOUGH:
            return "undecided", f"{times}, unless terms that the record only bounds are smaller; record for longer"
        if over > _SUSPECT and slip:
            return "fail", f"{times}: {slip}"
        if over > _CAUTIOUS:
            return "pass", f"{times}: too cautious, unless the vehicle shakes"
        return "pass", ""

    def _times(self, number: float) -> str:
        """Return how far a number is off, by which factor where it is a known one."""
        ratio = number / self.right
        off, word = (ratio, "large") if ratio > 1 else (1 / ratio, "small")
        known = {"sqrt(f)": math.sqrt(self.rate_hz), "f": self.rate_hz, "57.3": 180 / math.pi, "9.81": 9.80665}
        power = self.key.formula.power
        by = next((name for name, factor in known.items() if abs(math.log(off) / power - math.log(factor)) < 0.05), "")
        squared = " squared" if by and power == 2 else ""
        return f"{off:.3g} times too {word}{f', by {by}{squared}' if by else ''}"


def _at_values(axis: AxisReport) -> AxisReport:
    """Return an axis whose fit knows its terms exactly, and knows that there are no others."""

    def exactly(estimate: Estimate) -> Estimate:
        if estimate.value is None:
            return replace(estimate, high=0.0)
        time = estimate.correlation_time
        return replace(
            estimate,
            low=estimate.value,
            high=estimate.value,
            correlation_time=time and replace(time, low=time.value, high=time.value),
        )

    estimates = tuple(map(exactly, axis.fit.estimates))
    fit = replace(axis.fit, estimates=estimates, parameters=(), covariance=np.zeros((0, 0)))
    return replace(axis, fit=fit)


_GRAVITY_OF: Mapping[Verdict, int] = {"fail": 0, "undecided": 1, "pass": 2}


def _row(path: Path, setting: Setting, wanted: _Wanted) -> Row:
    """Return the verdict on a key; on a matrix that of the worst on its diagonal."""
    key, size = wanted.key, math.isqrt(len(setting.numbers))
    several = size > 1 and size * size == len(setting.numbers)
    numbers = setting.numbers[:: size + 1] if several else setting.numbers
    place = f"{key.sensor.short}: {path.name}:{setting.line}: {setting.name}"
    judged = [(*wanted.judge(number), number) for number in numbers] or [("fail", "no number", math.nan)]
    verdict, said, number = min(judged, key=lambda each: _GRAVITY_OF[each[0]])
    instead = setting.with_number(real(wanted.right)) if said else ""
    text = f"{place} is {number:.4g} {key.unit}"
    text += f"; {said}; write '{instead}'" if said else f", the least is {wanted.least:.4g}"
    return Row(
        where=key.sensor.short,
        subject=setting.name,
        side="min",
        limit=wanted.right,
        unit=key.unit,
        measured=Measured.exactly(number),
        verdict=verdict,
        text=text,
        instead=instead,
    )
