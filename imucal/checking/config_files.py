"""The config file of a filter read back: whether each noise parameter is what the sensor's report asks for.

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
from imucal.prediction.filter_numbers import LEVEL, STEP_S
from imucal.prediction.propagation import MEAN, Caution, upper_limit
from imucal.recording import Sensor
from imucal.report.exports import TARGETS, AxisPolicy
from imucal.report.exports.config_numbers import Choices, Numbers
from imucal.report.exports.target import Key, Target, entries, real
from imucal.report.result import AxisReport, Report
from imucal.units import G0, SAMPLE_UNITS

#: A filter whose deviation is this share of the least is right by NEES of 1.2.
_ENOUGH = 1 / math.sqrt(1.2)
#: Beyond so many times the wanted coefficient a number is remarkable, and a slip is looked for.
_CAUTIOUS, _SUSPECT = 10.0, 2.0
#: The values of the fits, their limits left out.
_VALUES = Caution(0.0, 0.0)
#: A coefficient so many times below the least describes no sensor.
_ABSURD = 1e-3
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
    """A key of a config file: its line, from 1, its name, its numbers as written, and the line's text."""

    line: int
    name: str
    written: tuple[str, ...]
    text: str

    @property
    def numbers(self) -> tuple[float, ...]:
        """Its numbers; none where it holds anything else."""
        found = tuple(map(_number, self.written))
        return found if all(map(math.isfinite, found)) else ()

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
        more: list[str] = []
        while "[" in value and "]" not in "".join([value, *more]) and (following := next(lines, None)):
            more.append(following[1].strip())
        value = " ".join([value, *more])
        if not value or value.startswith("!!"):
            section = name
        written = _NUMBER.findall(value)[: 1 if match["vehicle"] else None]
        # OpenCV's matrices keep their numbers under a key of their own.
        name = section if name == "data" and section else name
        found.append(Setting(number, name, tuple(written), " ".join([line, *more])))
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


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
    there = {setting.name for setting in settings}
    # Of formats with the same keys, that whose other lines are in the file, too.
    own, target = max(
        ((read_settings(each.render(report, choices)), each) for each in _formats(path, settings)),
        key=lambda each: len(there & {setting.name for setting in each[0]}),
    )
    file = _File(path=path, settings=settings, numbers=target.numbers(report, choices), own=own)
    return (*file.noise(target.keys), *file.rates())


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
    return [target for target in TARGETS.values() if counts[target.name] == most]


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """A config file and what its format's own file for the report would be.

    Attributes
    ----------
    path, settings
        The file and its keys.
    numbers
        What the report gives the format.
    own
        The keys of the format's own file.
    """

    path: Path
    settings: Sequence[Setting]
    numbers: Numbers
    own: Sequence[Setting]

    def place(self, sensor: str, setting: Setting) -> str:
        """Return where a key stands, for the start of a sentence."""
        return f"{sensor}: {self.path.name}:{setting.line}: {setting.name}"

    def rates(self) -> Iterator[Row]:
        """Judge the keys that hold the rate of the stream: those that the format's own file has it in."""
        rate_hz = self.numbers.stream_hz
        for name in {own.name: None for own in self.own if own.numbers == (rate_hz,)}:
            for setting in self.settings:
                if setting.name != name or len(setting.numbers) != 1:
                    continue
                same = abs(setting.numbers[0] / rate_hz - 1) <= _SAME_RATE
                instead = "" if same else setting.with_number(real(rate_hz))
                found = f"{setting.numbers[0]:g} Hz"
                text = f"{self.place('log', setting)} is {found}, and the log's {rate_hz:g} Hz"
                if instead:
                    text += f"; unless the IMU runs at another rate than in the log, write '{instead}'"
                verdict: Verdict = "undecided" if instead else "pass"
                yield Row(where="log", subject=name, verdict=verdict, text=text, instead=instead)

    def noise(self, keys: Sequence[Key]) -> Iterator[Row]:
        """Judge the keys that hold a number of the noise."""
        there = [
            (key, i, each)
            for key in keys
            for i, name in enumerate(_names(key))
            for each in self.settings
            if each.is_called(name)
        ]
        judges: dict[tuple[Sensor, int], _Judge] = {}
        for key, i, setting in there:
            short = key.sensor.short
            if key.sensor not in self.numbers.sensors:
                text = f"{short}: {setting.name}: the report has no {key.sensor}; check against one that has"
                yield Row(where=short, subject=setting.name, verdict="undecided", text=text)
                continue
            if (key.sensor, i) not in judges:
                one_each, of = "{" in key.name, self.numbers
                group = (of.triad(key.sensor)[i],) if one_each else of.chosen(key.sensor)
                mates = [(k, s) for k, j, s in there if (k.sensor, j) == (key.sensor, i)]
                judges[key.sensor, i] = _Judge.of(self.numbers, group, mates)
            yield self._row(key, i, setting, judges[key.sensor, i])

    def _row(self, key: Key, i: int, setting: Setting, judge: "_Judge") -> Row:
        """Return the verdict on a key; on a matrix that of the worst on its diagonal."""
        name = _names(key)[i]
        right = next(entry.value for entry in entries(self.numbers, (key,)) if entry.name == name)
        judged = [(*judge.judge(key, number, right), number) for number in _diagonal(setting)]
        verdict, said, number = min(judged, key=lambda each: _WORST_FIRST.index(each[0]))
        spelled = next((own.written[0] for own in reversed(self.own) if own.name == name), real(right))
        # What passes below the number that is right alone has no limit of its own.
        alone = verdict != "pass" or number >= right
        instead = setting.with_number(spelled) if said and alone else ""
        shown = " ".join(setting.written) if math.isnan(number) else f"{number:.4g} {key.unit}"
        text = f"{self.place(key.sensor.short, setting)} is {shown}; {said or 'enough for this sensor'}"
        return Row(
            where=key.sensor.short,
            subject=setting.name,
            side="min" if alone else None,
            limit=right if alone else None,
            unit=key.unit,
            measured=Measured.exactly(number),
            verdict=verdict,
            text=f"{text}; write '{instead}'" if instead else text,
            instead=instead,
        )


def _diagonal(setting: Setting) -> tuple[float, ...]:
    """Return a setting's number, or those on the diagonal of a square matrix; NaN where it has none."""
    numbers = setting.numbers
    size = math.isqrt(len(numbers))
    square = size > 1 and size * size == len(numbers)
    return (numbers[:: size + 1] if square else numbers) or (math.nan,)


_WORST_FIRST: tuple[Verdict, ...] = ("fail", "undecided", "pass")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Judge:
    """What is right for the axes that two numbers, white noise and walk, are for.

    Attributes
    ----------
    least
        Symbol -> the coefficient that covers the values of the fits alone, their limits left out.
    fitted
        Symbol -> the largest coefficient that the fits show.
    rate_hz
        Of the file's stream.
    together
        Whether the file's two numbers are enough together, however they are shared out: ``pass`` where they
        cover the limits of the fits, ``undecided`` where they cover the values alone.
    """

    least: Mapping[str, float]
    fitted: Mapping[str, float]
    rate_hz: float
    together: Verdict

    @classmethod
    def of(
        cls, numbers: Numbers, axes: Sequence[AxisReport], keys: Sequence[tuple[Key, Setting]]
    ) -> "_Judge":
        """Return what the axes ask for, and whether the keys of their sensor give it together."""
        pair = numbers.pair([_at_values(axis) for axis in axes])
        least = {s: c * numbers.choices.factor(s) for s, c in (("N", pair.white), ("K", pair.walk))}
        fitted: dict[str, float] = {}
        for estimate in (estimate for axis in axes for estimate in axis.fit.estimates):
            fitted[estimate.symbol] = max(estimate.value or 0.0, fitted.get(estimate.symbol, 0.0))
        given = {
            key.symbol: key.formula.inverse(min(_diagonal(setting)), numbers.stream_hz)
            / numbers.choices.factor(key.symbol)
            for key, setting in keys
            if min(_diagonal(setting)) > 0
        }
        together: Verdict = "fail"
        if len(given) == 2:
            limits = Caution.at(LEVEL, axes[0].fit.level) if len(axes) == 1 else MEAN
            covered = [
                _covers(given["N"], given["K"], axes, numbers, caution) for caution in (limits, _VALUES)
            ]
            together = "pass" if all(covered) else "undecided" if any(covered) else "fail"
        return cls(least=least, fitted=fitted, rate_hz=numbers.stream_hz, together=together)

    def judge(self, key: Key, number: float, right: float) -> tuple[Verdict, str]:
        """Return the verdict on a number, and what is to be said of it, if anything."""
        if not 0 < number < math.inf:
            return "fail", "expected a positive number: no filter takes another"
        power = key.formula.power
        over = (number / right) ** (1 / power)
        least = min(key.formula.of(self.least[key.symbol], self.rate_hz), right)
        above_least = (number / least) ** (1 / power)
        off, word = (number / right, "large") if over > 1 else (right / number, "small")
        times = f"{off:.3g} times too {word}"
        slip = "" if self._is_fitted(key, number) else self._slip(key, number, right)
        if above_least < _ABSURD or (above_least < _ENOUGH and (slip or self.together == "fail")):
            alone = f"{key.symbol} of the fit alone is " if self._is_fitted(key, number) else ""
            below = f"{alone}below the pair that covers the fitted spectrum"
            if above_least < _ABSURD:
                times, below = f"{times}, absurd", "no sensor is so good"
            return "fail", f"{times}: {slip or below}"
        if over < _ENOUGH and self.together != "pass":
            said = "unless a term is smaller that the record only bounds; record for longer"
            return "undecided", f"{times}, {said}"
        if over > _SUSPECT and slip:
            return "undecided" if slip.endswith(_ON_HABIT) else "fail", f"{times}: {slip}"
        if over < _ENOUGH:
            return "pass", "less than is needed alone, but with the sensor's other number it is enough"
        return "pass", f"{times}: too cautious for a sensor at rest" if over > _CAUTIOUS else ""

    def _is_fitted(self, key: Key, number: float) -> bool:
        """Return whether a number is the fit's own."""
        own, c = self.fitted.get(key.symbol), key.formula.inverse(number, self.rate_hz)
        return bool(own) and 1 / _NEAR_ON_PURPOSE < c / (own or 1.0) < _NEAR_ON_PURPOSE

    def _slip(self, key: Key, number: float, right: float) -> str:
        """Return what a number that is not the right one is, by its nearest slip; empty without one."""
        power = key.formula.power

        def off(other: float) -> float:
            return abs(math.log(number / other)) / power

        slips = [each for each in self._slips(key, right) if off(each[0]) < math.log(_NEAR)]
        if not slips:
            return ""
        other, said = min(slips, key=lambda each: off(each[0]))
        larger = (other / right) ** (1 / power)
        on_purpose = 1 < larger < _ON_PURPOSE and off(other) > math.log(_NEAR_ON_PURPOSE)
        return "" if on_purpose else said

    def _slips(self, key: Key, right: float) -> Iterator[tuple[float, str]]:
        """Yield the numbers that people write in place of the right one, each with what it is."""
        f, symbol, formula = self.rate_hz, key.symbol, key.formula
        root, units = math.sqrt(f), TERMS[symbol].coefficient_units(key.sensor)
        wanted, sample = next(iter(units)), SAMPLE_UNITS[key.sensor]
        factors = {f"sqrt(f) at {f:g} Hz": root, f"f = {f:g} Hz": f, "57.3": 180 / math.pi, "9.81": G0}
        for c in {formula.inverse(right, f), self.fitted.get(symbol, 0.0)} - {0.0}:
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
            slips[f"it was turned from {turned}"] = formula.of(c * sample[turned.split(maxsplit=1)[0]], f)
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


def _covers(
    white: float, walk: float, axes: Sequence[AxisReport], numbers: Numbers, caution: Caution
) -> bool:
    """Return whether two numbers cover the spectra of some axes, as near as a filter needs."""
    step_s = numbers.choices.step_s
    f = np.geomspace(0.01 / numbers.horizon_s, 0.5 / step_s, 90)
    given = white**2 + TERMS["K"].of(walk).psd(f, step_s)
    wanted = [upper_limit(axis.fit, lambda term: term.psd(f, step_s), caution) for axis in axes]
    return bool(np.all(given >= _ENOUGH**2 * np.max(wanted, axis=0)))


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
