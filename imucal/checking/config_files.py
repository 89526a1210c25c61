"""The config file of a filter read back: whether each noise parameter is what the sensor's report asks for.

The formats, and the formula of each key, are those that `imucal.report.exports` writes; a file is of the
format most of whose keys it has. A number is right from the least that the values of the fit ask for;
between that and what their limits ask for, the record is too short to tell. What else it may be is
looked up among the slips that people make: a factor of the rate, degrees, g, a square, another term.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np

from imucal.checking.limits import text_of
from imucal.checking.verdict import WORST_FIRST, Row, Verdict
from imucal.errors import LimitsError
from imucal.noise.terms import TERMS
from imucal.prediction.filter_numbers import LEVEL, STEP_S, covered_frequencies
from imucal.prediction.propagation import MEAN, Caution, upper_limit
from imucal.recording import Sensor
from imucal.report.exports import TARGETS, AxisPolicy
from imucal.report.exports.config_numbers import Choices, Numbers
from imucal.report.exports.target import Key, Target, real
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report
from imucal.units import G0, SAMPLE_UNITS

#: A filter whose deviation is this share of the least is right by NEES of 1.2.
_ENOUGH = 1 / math.sqrt(1.2)
#: Beyond so many times the wanted coefficient a number is remarkable, and a slip is looked for.
_CAUTIOUS, _SUSPECT = 10.0, 2.0
#: The values of the fits, their limits left out.
_VALUES = Caution(0.0, 0.0)
#: A coefficient so many times below the right one describes no sensor; a bound is never so far above.
_ABSURD, _FAR_BELOW_A_BOUND = 1e-3, 1e-5
#: How far from a slip's number a number is taken for it, as a factor on the coefficient: numbers of
#: other records differ; but up to the last factor people make them larger on purpose.
_NEAR, _NEAR_ON_PURPOSE, _ON_PURPOSE = 1.35, 1.1, 30.0
#: What else a number may be that is 9.81 times too large: people multiply by ten.
_ON_HABIT = ", or made ten times as large on purpose"
#: Factors that differ by less, in natural logarithm, are one.
_EQUAL = 1e-6
#: Rates that differ by more are not one.
_SAME_RATE = 0.01

_COMMENT = re.compile(r"(^|\s)#.*|;.*")
_SETTING = re.compile(
    r"""\s*(?P<vehicle>\d+\s+\d+\s+)?(?:param\s+set(?:-default)?\s+|-\s+)?["']?(?P<name>[A-Za-z_][\w./]*)["']?"""
    r"""(?:\s*[:=,]\s*|\s+)(?P<value>.*)"""
)
_NUMBER = re.compile(r"[^\s,\[\]\"']+")


class Setting(NamedTuple):
    """A key of a config file: file and line, from 1, its name, its numbers as written, the line's text."""

    file: str
    line: int
    name: str
    written: tuple[str, ...]
    text: str

    @property
    def numbers(self) -> tuple[float, ...]:
        """Its numbers; none where it holds anything else."""
        found = tuple(map(_number, self.written))
        return found if all(map(math.isfinite, found)) else ()

    def place(self, where: str) -> str:
        """Return what it is about and where it stands, for the start of a sentence."""
        return f"{where}: {self.file}:{self.line}: {self.name}"

    def is_called(self, name: str) -> bool:
        """Return whether this is the key of a name, in whatever section."""
        return self.name == name or self.name.endswith((f"/{name}", f".{name}"))

    def with_number(self, value: str) -> str:
        """Return the line with another number in place of its own; of a matrix in place of all but zeros."""
        at = self.text.find(self.name) + len(self.name)
        old = [text for text in self.written if len(self.written) == 1 or _number(text)]
        spelled = "|".join(map(re.escape, dict.fromkeys(old)))
        line = re.sub(rf"(?<![\w.+-])({spelled})(?![\w.])", value, self.text[at:]) if old else f": {value}"
        return f"{self.text[:at]}{line}".strip()


def read_settings(text: str, file: str = "") -> list[Setting]:
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
        more: list[str] = []
        while "[" in value and "]" not in "".join([value, *more]) and (following := next(lines, None)):
            more.append(following[1].strip())
        value = " ".join([value, *more])
        if not value or value.startswith("!!"):
            section = name
        written = _NUMBER.findall(value)[: 1 if match["vehicle"] else None]
        # OpenCV's matrices keep their numbers under a key of their own.
        name = section if name == "data" and section else name
        found.append(Setting(file, number, name, tuple(written), " ".join([line, *more])))
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def check_config(path: Path, report: Report) -> tuple[Row, ...]:
    """Return a row for each key of a config file that holds a number of the noise, or the sampling rate.

    They are judged by the report of the file's sensor; one that imucal wrote is held to the options that
    its comment names. A LimitsError says that the file can't be read, or is of no format whose keys are
    known, a DataError that the report lacks an axis that the format needs.
    """
    text = text_of(path, "the config file of a filter")
    settings, choices = read_settings(text, path.name), _choices(text)
    there = {setting.name for setting in settings}
    # Of formats with the same keys, that whose other lines are in the file, too.
    own, target = max(
        ((read_settings(each.render(report, choices)), each) for each in _formats(path, settings)),
        key=lambda each: len(there & {setting.name for setting in each[0]}),
    )
    numbers = target.numbers(report, choices)
    return (*_noise_rows(settings, target.keys, own, numbers), *_rate_rows(settings, own, numbers.stream_hz))


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
        step_s=float(times[1]) if times else STEP_S,
        horizon_s=float(times[2]) if times else None,
    )


def _names(key: Key) -> tuple[str, ...]:
    """Return the names of a key: one, or one an axis."""
    return tuple(dict.fromkeys(key.name.format(i=i, axis=axis) for i, axis in enumerate("xyz")))


def _formats(path: Path, settings: Sequence[Setting]) -> list[Target]:
    """Return the formats with most of their keys in a file: one, or several of the same keys."""
    counts = {
        target.name: sum(s.is_called(name) for s in settings for key in target.keys for name in _names(key))
        for target in TARGETS.values()
        if target.read_back
    }
    most = max(counts.values())
    if not most:
        known = ", ".join(name for name in counts if TARGETS[name].keys)
        raise LimitsError(f"{path}: found no noise parameter; expected a file of one of {known}")
    return [TARGETS[name] for name, count in counts.items() if count == most]


def _rate_rows(settings: Sequence[Setting], own: Sequence[Setting], rate_hz: float) -> Iterator[Row]:
    """Judge the keys that hold the rate of the stream: those that the format's own file has it in."""
    names = {each.name: None for each in own if each.numbers == (rate_hz,)}
    for setting in (each for name in names for each in settings if each.name == name):
        if len(setting.numbers) != 1:
            continue
        same = abs(setting.numbers[0] / rate_hz - 1) <= _SAME_RATE
        instead = "" if same else setting.with_number(real(rate_hz))
        text = f"{setting.place('log')} is {setting.numbers[0]:g} Hz, and the log has {rate_hz:g} Hz"
        if instead:
            text += f"; unless the IMU has another rate than the log, write '{instead}'"
        verdict: Verdict = "undecided" if instead else "pass"
        yield Row("log", setting.name, verdict, text, instead=instead)


def _noise_rows(
    settings: Sequence[Setting], keys: Sequence[Key], own: Sequence[Setting], numbers: Numbers
) -> Iterator[Row]:
    """Judge the keys that hold a number of the noise; `own` are those of the format's own file."""
    spelled = {each.name: each.written[0] for each in own if each.written}
    there = [
        (key, i, each)
        for key in keys
        for i, name in enumerate(_names(key))
        for each in settings
        if each.is_called(name)
    ]
    for key, i, setting in there:
        short = key.sensor.short
        if key.sensor not in numbers.sensors:
            text = f"{short}: {setting.name}: the report has no {key.sensor}; use a report with one"
            yield Row(short, setting.name, "undecided", text)
            continue
        mates = [(k, s) for k, j, s in there if (k.sensor, j) == (key.sensor, i) and k.symbol != key.symbol]
        axes = (numbers.triad(key.sensor)[i],) if "{" in key.name else numbers.chosen(key.sensor)
        wanted = _Wanted.of(key, mates, axes, numbers)
        yield _noise_row(setting, wanted, spelled.get(_names(key)[i]) or real(wanted.right))


def _noise_row(setting: Setting, wanted: "_Wanted", spelled: str) -> Row:
    """Return the verdict on a key; on a matrix that of the worst on its diagonal."""
    judged = [(*wanted.judge(number), number) for number in _diagonal(setting)]
    verdict, said, number = min(judged, key=lambda each: WORST_FIRST.index(each[0]))
    key, right = wanted.key, wanted.right
    # What passes below the number that is right alone has no limit of its own.
    alone = verdict != "pass" or number >= right
    instead = setting.with_number(spelled) if said and alone else ""
    shown = " ".join(setting.written) if math.isnan(number) else f"{number:.4g} {key.unit}"
    text = f"{setting.place(key.sensor.short)} is {shown}; {said or 'enough for this sensor'}"
    return Row(
        key.sensor.short,
        setting.name,
        verdict,
        f"{text}; write '{instead}'" if instead else text,
        side="min" if alone else None,
        limit=right if alone else None,
        unit=key.unit,
        measured=Quantity.exactly(number),
        instead=instead,
    )


def _diagonal(setting: Setting) -> tuple[float, ...]:
    """Return a setting's number, or those on the diagonal of a square matrix; NaN where it has none."""
    numbers = setting.numbers
    size = math.isqrt(len(numbers))
    square = size > 1 and size * size == len(numbers)
    return (numbers[:: size + 1] if square else numbers) or (math.nan,)


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What a key should hold: one of the two numbers, white noise and walk, that some axes have.

    `right` is the number that the exporter writes; `other` the coefficient of the sensor's other number:
    the file's, or the right one where that is larger. `fitted` has the largest coefficient of each term by
    its symbol that the fits of the axes show.
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
        """Return what a key should hold beside the keys of the sensor's other number."""
        rate_hz, pair = numbers.stream_hz, numbers.pair(axes)
        right = {"N": pair.white, "K": pair.walk}
        other = right["K" if key.symbol == "N" else "N"]
        for mate, setting in mates:
            if (least := min(_diagonal(setting))) > 0:
                other = max(other, mate.formula.inverse(least, rate_hz))
        sizes = sorted((e.value or 0.0, e.symbol) for axis in axes for e in axis.fit.estimates)
        fitted = {symbol: size for size, symbol in sizes}
        number = key.formula.of(right[key.symbol], rate_hz)
        return cls(key, axes, numbers, number, other, fitted)

    def judge(self, number: float) -> tuple[Verdict, str]:
        """Return the verdict on a number, and what is to be said of it, if anything."""
        if not 0 < number < math.inf:
            return "fail", "expected a positive number"
        over = (number / self.right) ** (1 / self.key.formula.power)
        slip = self._slip(number)
        if over < _ENOUGH:
            return self._too_small(number, slip, over)
        times = f"{number / self.right:.3g} times too large"
        if over > _SUSPECT and slip:
            return "undecided" if slip.endswith(_ON_HABIT) else "fail", f"{times}: {slip}"
        return "pass", f"{times}: too cautious for a sensor at rest" if over > _CAUTIOUS else ""

    def _too_small(self, number: float, slip: str, over: float) -> tuple[Verdict, str]:
        symbol, c = self.key.symbol, self.key.formula.inverse(number, self.numbers.stream_hz)
        times = f"{self.right / number:.3g} times too small"
        limits = Caution.at(LEVEL, self.axes[0].fit.level) if len(self.axes) == 1 else MEAN
        if self._covers(c, limits):
            return "pass", "too small alone, but the file's other number makes up for it"
        if over > _FAR_BELOW_A_BOUND and self._covers(c, _VALUES):
            said = "unless a term is below its upper bound; record for longer"
            return "undecided", f"{times}, {said}"
        own = self.fitted.get(symbol, 0.0)
        below = "below the values that cover the fitted spectrum"
        if own and 1 / _NEAR_ON_PURPOSE < c / own < _NEAR_ON_PURPOSE:
            return "fail", f"{times}: {symbol} of the fit alone is {below}"
        if over < _ABSURD:
            return "fail", f"{times}, absurd: {slip or 'no sensor is this good'}"
        return "fail", f"{times}: {slip or below}"

    def _covers(self, c: float, caution: Caution) -> bool:
        """Return whether a coefficient and the other number cover the spectra, as near as a filter needs."""
        choices = self.numbers.choices
        white, walk = (c, self.other) if self.key.symbol == "N" else (self.other, c)
        f = covered_frequencies(self.numbers.horizon_s, choices.step_s)
        walks = TERMS["K"].of(walk / choices.factor("K")).psd(f, choices.step_s)
        wanted = [
            upper_limit(axis.fit, lambda term: term.psd(f, choices.step_s), caution) for axis in self.axes
        ]
        given = (white / choices.factor("N")) ** 2 + walks
        return bool(np.all(given >= _ENOUGH**2 * np.max(wanted, axis=0)))

    def _slip(self, number: float) -> str:
        """Return what a number that is not the right one is, by its nearest slip; empty without one."""
        power = self.key.formula.power

        def off(other: float) -> float:
            return abs(math.log(number / other)) / power

        other, said = min(self._slips(), key=lambda each: off(each[0]))
        larger = (other / self.right) ** (1 / power)
        near = _NEAR_ON_PURPOSE if 1 < larger < _ON_PURPOSE else _NEAR
        return said if off(other) < math.log(near) else ""

    def _slips(self) -> Iterator[tuple[float, str]]:
        """Yield the numbers that people write in place of the right one, each with what it is."""
        key, f, formula = self.key, self.numbers.stream_hz, self.key.formula
        symbol = key.symbol
        root, units = math.sqrt(f), TERMS[symbol].coefficient_units(key.sensor)
        wanted, sample = next(iter(units)), SAMPLE_UNITS[key.sensor]
        factors = {f"sqrt(f) at {f:g} Hz": root, f"f = {f:g} Hz": f, "57.3": 180 / math.pi, "9.81": G0}
        for c in {formula.inverse(self.right, f), self.fitted.get(symbol, 0.0)} - {0.0}:
            slips = {
                f"{symbol}*sqrt(f), the deviation of one sample": c * root,
                f"{symbol}/sqrt(f), the step of one sample": c / root,
                f"{symbol}^2*f, the variance of one sample": c * c * f,
                f"{symbol}, the continuous density": c,
                f"{symbol}^2, the square of the continuous density": c * c,
                "one such factor too many": formula.of(c * root, f),
                "one such factor is missing": formula.of(c / root, f),
                "one factor of the rate too many": formula.of(c * f, f),
                "one factor of the rate is missing": formula.of(c / f, f),
                **{f"it is in {unit}, not in {wanted}": formula.of(c / of, f) for unit, of in units.items()},
            }
            turned = (
                f"g into SI twice{_ON_HABIT}" if key.sensor is Sensor.ACCELEROMETER else "deg/s into SI twice"
            )
            slips[f"it was converted from {turned}"] = formula.of(c * sample[turned.split(maxsplit=1)[0]], f)
            for said, other in slips.items():
                by = formula.inverse(other, f) / c
                size = abs(math.log(by))
                name = next((n for n, x in factors.items() if abs(size - math.log(x)) < _EQUAL), "")
                if size > _EQUAL:
                    yield other, f"by {name}: {said}" if name else said
        for other_symbol in {"N": "K", "K": "BN"}[symbol]:
            if other_c := self.fitted.get(other_symbol):
                names = (f"{s}, the {TERMS[s].name(key.sensor)}," for s in (other_symbol, symbol))
                yield formula.of(other_c, f), " in place of ".join(names).removesuffix(",")
