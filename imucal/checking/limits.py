"""The limits file: TOML in, checked values out, each limit with the factor of its unit.

A limit is in the table of an axis (``gyro_x``), a sensor (``gyroscope``: all its axes) or the log::

    [gyroscope]
    N = { max = 0.3, unit = "deg/sqrt(h)" }     # SI where no unit is given
    B = { max = 2, sensor = "ADIS16448" }       # times the figure of a part's data sheet
"""

import difflib
import math
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NoReturn, TypeAlias, TypeVar

from imucal.errors import ChoiceError, LimitsError
from imucal.findings import code_texts
from imucal.noise.terms import TERMS, symbol_of
from imucal.recording import AXES, Axis, Sensor
from imucal.sensors import find_sensor
from imucal.units import G0, SAMPLE_UNITS, find_unit

T = TypeVar("T")
Side: TypeAlias = Literal["min", "max"]
Undecided: TypeAlias = Literal["pass", "fail"]

#: The most severe last.
GRAVE = ("info", "warning", "error")

FINDING_CODES = frozenset(code_texts())


@dataclass(frozen=True)
class Limit:
    """A lower or upper limit (`side`) with the value and unit of the file; ``value * factor`` is in SI.

    `where` is ``log``, a sensor, an axis such as ``gyro_x``, or ``calibration.gyroscope``.
    """

    where: str
    quantity: str
    side: Side
    value: float
    unit: str
    factor: float


@dataclass(frozen=True, kw_only=True)
class FindingRules:
    """The findings that fail the check: of `level` or more severe, and `forbid`, except `allow`."""

    level: str = "error"
    forbid: frozenset[str] = frozenset()
    allow: frozenset[str] = frozenset()

    def forbids(self, level: str, code: str) -> bool:
        if code in self.allow:
            return False
        return code in self.forbid or (self.level != "none" and GRAVE.index(level) >= GRAVE.index(self.level))


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """Allowed relative changes of the coefficients of `terms`; None allows any change.

    The report is None if the caller gives it.
    """

    report: Path | None = None
    terms: tuple[str, ...] = ("N", "B", "K")
    max_increase: float | None = 0.2
    max_decrease: float | None = None


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The content of a limits file; `calibration` contains the limits of a calibration."""

    limits: tuple[Limit, ...] = ()
    calibration: tuple[Limit, ...] = ()
    required: Mapping[Sensor, tuple[Axis, ...]] = field(default_factory=dict)
    findings: FindingRules = field(default_factory=FindingRules)
    baseline: Baseline | None = None
    undecided: Undecided = "pass"


#: Coefficients of the terms; sigma for GM.
TERM_QUANTITIES = tuple(TERMS)
#: In the unit of the samples.
SAMPLE_QUANTITIES = ("minimum", "mean", "std")
_LOG_UNITS: dict[str, dict[str, float]] = {
    "rate": {"Hz": 1.0, "kHz": 1e3},
    "duration": {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "gaps": {"": 1.0},
    "missing": {"": 1.0, "%": 0.01, "ppm": 1e-6},
}
LOG_QUANTITIES = tuple(_LOG_UNITS)


_ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.radians(1.0)}
#: Units of limits of a calibration, SI first.
CALIBRATION_UNITS: dict[Sensor, dict[str, dict[str, float]]] = {
    Sensor.GYROSCOPE: {
        "scale": {"": 1.0, "%": 0.01, "ppm": 1e-6},
        "misalignment": _ANGLES,
        "bias": SAMPLE_UNITS[Sensor.GYROSCOPE],
        "g_sensitivity": {"(rad/s)/(m/s^2)": 1.0, "deg/s/g": math.radians(1.0) / G0},
        "residual": _ANGLES,
    },
    Sensor.ACCELEROMETER: {
        "scale": {"": 1.0, "%": 0.01, "ppm": 1e-6},
        "misalignment": _ANGLES,
        "bias": (_SIZES := {**SAMPLE_UNITS[Sensor.ACCELEROMETER], "mm/s^2": 1e-3}),
        "residual": _SIZES,
    },
}


def quantity_units(quantity: str, sensor: Sensor) -> dict[str, float]:
    """Return the units of a quantity, the SI unit first, each with its factor to SI."""
    if quantity in LOG_QUANTITIES:
        return _LOG_UNITS[quantity]
    symbol = "B" if quantity in SAMPLE_QUANTITIES else quantity
    return TERMS[symbol].coefficient_units(sensor)


_AXIS_NAMES = {f"{sensor.short}_{axis}": sensor for sensor in Sensor for axis in AXES}
_SENSORS = tuple(sensor.value for sensor in Sensor)
_SECTIONS = ("log", *_SENSORS, *_AXIS_NAMES)


def read_limits(path: Path) -> Limits:
    """Read a limits file; raises LimitsError if it can't be read, is not TOML, or has unknown entries."""
    path = Path(path)
    return parse_limits(text_of(path, "a TOML file of limits"), name=str(path), folder=path.parent)


def text_of(path: Path, expected: str) -> str:
    """Return the text of a file; raises LimitsError with what was `expected`."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise LimitsError(f"can't be read ({reason}); expected {expected}", place=path) from error


def parse_limits(text: str, *, name: str = "limits", folder: Path | None = None) -> Limits:
    """Return the limits of a TOML text, with the errors of `read_limits`; `name` is for messages.

    The path of a baseline is relative to `folder`.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        problem = f"not valid TOML ({error}); expected limits such as [gyroscope] N = {{ max = 1e-4 }}"
        raise LimitsError(problem, place=name) from error
    file = _Value(document, name)
    sections: dict[str, object] = {section: {} for section in _SECTIONS}
    others = {"findings": None, "baseline": None, "undecided": "pass"}
    entries = file.entries({**sections, **others, "calibration": {}})
    limits: list[Limit] = []
    required: dict[Sensor, tuple[Axis, ...]] = {}
    for section in _SECTIONS:
        table = entries[section].table()
        if "axes" in table:
            required |= _required(section, table.pop("axes"))
        limits += _section(section, entries[section], table)
    calibration = tuple(_calibration(entries["calibration"]))
    findings = entries["findings"].maybe(_findings)
    baseline = entries["baseline"].maybe(lambda entry: _baseline(entry, folder or Path()))
    if not (limits or calibration or required or baseline or findings):
        file.refuse("no limit", "write one, such as [gyroscope] N = { max = 1e-4 }")
    undecided = entries["undecided"].one_of(("pass", "fail"), '"pass" or "fail"')
    return Limits(
        limits=tuple(limits),
        calibration=calibration,
        required=required,
        findings=findings or FindingRules(),
        baseline=baseline,
        undecided="fail" if undecided == "fail" else "pass",
    )


def _required(section: str, axes: "_Value") -> dict[Sensor, tuple[Axis, ...]]:
    if section not in _SENSORS:
        axes.refuse("only gyroscope and accelerometer have axes", "remove it")
    asked = axes.texts(AXES)
    return {Sensor(section): tuple(axis for axis in AXES if axis in asked)}


def _section(section: str, entry: "_Value", table: Mapping[str, "_Value"]) -> Iterator[Limit]:
    of_axes = () if section == "log" else (*TERM_QUANTITIES, *SAMPLE_QUANTITIES)
    entry.known(table, (*of_axes, *LOG_QUANTITIES), also=("axes",) if section in _SENSORS else ())
    sensor = _AXIS_NAMES.get(section) or (Sensor.GYROSCOPE if section == "log" else Sensor(section))
    for quantity, asked in table.items():
        least, most, written, part = asked.entries(
            {"min": None, "max": None, "unit": None, "sensor": None}
        ).values()
        if part.value is None:
            units = quantity_units(quantity, sensor)
            unit = _unit(written, units) if written.value is not None else (next(iter(units)), 1.0)
        else:
            unit = _times_the_sheet(part, section, quantity, written)
        both: tuple[tuple[Side, _Value], ...] = (("min", least), ("max", most))
        sides = {side: each.number() for side, each in both if each.value is not None}
        if not sides:
            asked.refuse("neither min nor max", "expected a limit, such as { max = 1e-4 }")
        if sides.get("min", -math.inf) > sides.get("max", math.inf):
            asked.refuse("min is above max", "swap them")
        for side, value in sides.items():
            yield Limit(section, quantity, side, value, *unit)


def _times_the_sheet(part: "_Value", section: str, quantity: str, written: "_Value") -> tuple[str, float]:
    """Return ``x BMI088`` as the unit of a limit relative to a data sheet, and the figure in SI."""
    if written.value is not None:
        written.refuse(repr(written.value), "remove it: the limit is a multiple of the data sheet's figure")
    if section == "log":
        part.refuse(
            repr(part.value), "a part in [log] is of no sensor; write it in [gyroscope] or [accelerometer]"
        )
    name = part.text("the name of a part, such as BMI088")
    try:
        found = find_sensor(name)
    except ChoiceError as error:
        part.refuse(error.problem, "; ".join(fix.text for fix in error.fixes))
    sensor = _AXIS_NAMES.get(section) or Sensor(section)
    term = found.term(sensor, quantity)
    if term is None:
        own = found.sensors.get(sensor)
        known = ", ".join(own.terms) if own else ""
        part.refuse(
            f"the data sheet of the {found.name} gives no {quantity} of the {sensor}",
            f"expected one of {known}" if known else "remove the limit, or give a number",
        )
    return f"x {found.name}", term.reference


def _unit(written: "_Value", units: Mapping[str, float]) -> tuple[str, float]:
    unit = find_unit(written.text('text, such as "deg/h"'), units)
    if unit is None:
        written.refuse(repr(written.value), f"expected one of {', '.join(filter(None, units))}")
    return unit


def _calibration(entry: "_Value") -> Iterator[Limit]:
    """Yield the largest size of each parameter of calibrated sensors.

    They need a unit: without one, a limit of 2 would allow a scale error of 200 %.
    """
    for sensor, section in zip(Sensor, entry.entries({name: {} for name in _SENSORS}).values(), strict=True):
        table = section.table()
        section.known(table, CALIBRATION_UNITS[sensor])
        for quantity, asked in table.items():
            units = CALIBRATION_UNITS[sensor][quantity]
            most, written = asked.entries({"max": None, "unit": None}).values()
            if most.value is None:
                asked.refuse("no max", "expected the largest size, such as { max = 2, unit = ... }")
            if written.value is None:
                asked.refuse("no unit", f"expected one of {', '.join(filter(None, units))}")
            yield Limit(section.place, quantity, "max", most.number(low=0), *_unit(written, units))


def _findings(entry: "_Value") -> FindingRules:
    level, *lists = entry.entries({"level": "error", "forbid": [], "allow": []}).values()
    grave = level.one_of((*GRAVE, "none"), "info, warning, error or none")
    forbid, allow = (frozenset(codes.texts(FINDING_CODES)) for codes in lists)
    if both := sorted(forbid & allow):
        entry.refuse(f"{', '.join(both)} both forbidden and allowed", "choose one")
    return FindingRules(level=grave, forbid=forbid, allow=allow)


def _baseline(entry: "_Value", folder: Path) -> Baseline:
    usual = {"report": None, "terms": list(Baseline().terms), "max_increase": None, "max_decrease": None}
    report, terms, *changes = entry.entries(usual).values()
    path = report.maybe(lambda found: found.text("the path of a report"))
    rules = Baseline(report=None if path is None else folder / path, terms=terms.texts(TERM_QUANTITIES))
    up, down = (change.maybe(lambda found: found.number(low=0)) for change in changes)
    return rules if up is None and down is None else replace(rules, max_increase=up, max_decrease=down)


@dataclass(frozen=True)
class _Value:
    """A value of the file and its place, such as ``gyroscope.N.max``."""

    value: object
    file: str
    place: str = ""

    def refuse(self, found: str, expected: str) -> NoReturn:
        where = f"{self.file}: {self.place}" if self.place else self.file
        raise LimitsError(f"{found}{';' if expected.endswith('?') else ','} {expected}", place=where)

    def maybe(self, read: "Callable[[_Value], T]") -> T | None:
        return None if self.value is None else read(self)

    def table(self) -> dict[str, "_Value"]:
        """Return the entries of a table by the symbols of terms, such as N for ARW and VRW."""
        if not isinstance(self.value, dict):
            self.refuse(repr(self.value), "expected a table, such as { max = 1e-4 }")
        found: dict[str, _Value] = {}
        for key, value in self.value.items():
            name = symbol_of(key) or key
            if name in found:
                self._at(key, value).refuse(f"{name} has limits twice", "write one entry for both")
            found[name] = self._at(name, value)
        return found

    def entries(self, usual: Mapping[str, object]) -> dict[str, "_Value"]:
        """Return the entries of a table with the defaults `usual`; other keys are refused."""
        table = self.table()
        self.known(table, usual)
        return {key: table.get(key, self._at(key, value)) for key, value in usual.items()}

    def _at(self, key: str, value: object) -> "_Value":
        return _Value(value, self.file, f"{self.place}.{key}".lstrip("."))

    def known(self, keys: Iterable[str], known: Collection[str], *, also: tuple[str, ...] = ()) -> None:
        """Refuse unknown keys; a suggestion prefers `known` to `also`."""
        for key in keys:
            if key not in known and key not in also:
                near = [name for name in known if name in _SENSORS and key and name.startswith(key)]
                near += difflib.get_close_matches(key, [*known, *also], n=1, cutoff=0.5)
                code = known is FINDING_CODES
                expected = "the code of a finding" if code else ", ".join([*known, *also])
                hint = f"did you mean {near[0]!r}?" if near else f"expected {expected}"
                self.refuse(f"unknown {'code' if code else 'key'} {key!r}", hint)

    def text(self, expected: str) -> str:
        if not isinstance(self.value, str):
            self.refuse(repr(self.value), f"expected {expected}")
        return self.value

    def one_of(self, allowed: tuple[str, ...], expected: str) -> str:
        if self.value not in allowed:
            self.refuse(repr(self.value), f"expected {expected}")
        return str(self.value)

    def texts(self, known: Collection[str]) -> tuple[str, ...]:
        if not isinstance(self.value, list) or not all(isinstance(item, str) for item in self.value):
            self.refuse(repr(self.value), 'expected a list of texts, such as ["N", "K"]')
        texts = tuple(symbol_of(text) or text for text in self.value)
        self.known(texts, known)
        return texts

    def number(self, low: float = -math.inf) -> float:
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.refuse(repr(value), "expected a number")
        if value < low:
            self.refuse(repr(value), f"expected {low:g} or more")
        return float(value)
