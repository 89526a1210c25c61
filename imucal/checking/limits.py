"""The limits file: TOML in, checked values out, each limit with the factor of its unit.

A limit is in the table of an axis (``gyro_x``), a sensor (``gyroscope``: all its axes) or the log::

    [gyroscope]
    N = { max = 0.3, unit = "deg/sqrt(h)" }     # SI where no unit is given
    B = { max = 2, sensor = "ADIS16448" }       # times the figure of a part's data sheet
"""

import difflib
import json
import math
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from imucal.errors import ChoiceError, Fix, LimitsError, ReadError
from imucal.findings import code_texts
from imucal.noise.terms import TERMS, symbol_of
from imucal.recording import AXES, Axis, Sensor
from imucal.report.typed_json import Key, Place, from_json, hints_of, is_optional, without_none
from imucal.sensors import find_sensor
from imucal.units import G0, SAMPLE_UNITS, find_unit

Side: TypeAlias = Literal["min", "max"]
Undecided: TypeAlias = Literal["pass", "fail"]
Level: TypeAlias = Literal["info", "warning", "error", "none"]

#: Levels of findings, the most severe last.
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

    level: Level = "error"
    forbid: tuple[str, ...] = ()
    allow: tuple[str, ...] = ()

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
_ACCELERATIONS = {**SAMPLE_UNITS[Sensor.ACCELEROMETER], "mm/s^2": 1e-3}
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
        "bias": _ACCELERATIONS,
        "residual": _ACCELERATIONS,
    },
}


def quantity_units(quantity: str, sensor: Sensor) -> dict[str, float]:
    """Return the units of a quantity, the SI unit first, each with its factor to SI."""
    if quantity in LOG_QUANTITIES:
        return _LOG_UNITS[quantity]
    symbol = "B" if quantity in SAMPLE_QUANTITIES else quantity
    return TERMS[symbol].coefficient_units(sensor)


_SENSORS = tuple(sensor.value for sensor in Sensor)
_SENSOR_OF = {f"{sensor.short}_{axis}": sensor for sensor in Sensor for axis in AXES}
_SENSOR_OF |= {sensor.value: sensor for sensor in Sensor}
#: What a user can do about a wrong file.
_FIX = "'imucal check --help' shows a file of limits"
#: Least similarity of a name that is suggested: 'maks' and 'max' have 0.57, 'axes' and 'gaps' 0.5.
_NEAR = 0.55


@dataclass(frozen=True, kw_only=True)
class _LogRange:
    """A limit such as ``{ max = 0.3, unit = "h" }``."""

    min: float | None = None
    max: float | None = None
    unit: str | None = None


@dataclass(frozen=True, kw_only=True)
class _Range(_LogRange):
    """A limit of a sensor, which may be a multiple of the figure of a part."""

    sensor: str | None = None


_Size: TypeAlias = Annotated[float, Key(least=0.0, null=None)]


@dataclass(frozen=True, kw_only=True)
class _LargestSize:
    """A limit of a calibration. Without a unit, a limit of 2 would allow a scale error of 200 %."""

    max: _Size
    unit: str


@dataclass(frozen=True, kw_only=True)
class _BaselineTable:
    report: str | None = None
    terms: tuple[str, ...] = Baseline().terms
    max_increase: _Size | None = None
    max_decrease: _Size | None = None


def _table(name: str, keys: Mapping[str, Any]) -> Any:  # noqa: ANN401 - a dataclass
    """Return the type of a table whose keys, each with the type of its value, may be missing."""
    return make_dataclass(name, [(key, kind | None, None) for key, kind in keys.items()], frozen=True)


_LOG_KEYS = dict.fromkeys(LOG_QUANTITIES, _LogRange)
_AXIS_KEYS = {**dict.fromkeys((*TERM_QUANTITIES, *SAMPLE_QUANTITIES), _Range), **_LOG_KEYS}
_LOG = _table("_Log", _LOG_KEYS)
_AXIS = _table("_Axis", _AXIS_KEYS)
_SENSOR = _table("_Sensor", {**_AXIS_KEYS, "axes": tuple[Axis, ...]})
_CALIBRATED = {
    sensor.value: _table("_Calibrated", dict.fromkeys(quantities, _LargestSize))
    for sensor, quantities in CALIBRATION_UNITS.items()
}
#: Tables with limits of a noise report.
_SECTIONS = {
    "log": _LOG,
    **dict.fromkeys(_SENSORS, _SENSOR),
    **dict.fromkeys([name for name in _SENSOR_OF if name not in _SENSORS], _AXIS),
}
_FILE = _table(
    "_File",
    {
        **_SECTIONS,
        "findings": FindingRules,
        "baseline": _BaselineTable,
        "undecided": Undecided,
        "calibration": _table("_Calibration", _CALIBRATED),
    },
)


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
    # JSON has no dates and times; where one is found, the error shows its text.
    document = json.loads(json.dumps(document, default=str))
    try:
        return _limits(document, Place(name, _FIX), folder or Path())
    except ReadError as error:
        raise LimitsError(error.problem, place=error.place, fixes=error.fixes) from error


def _limits(document: object, place: Place, folder: Path) -> Limits:
    file = from_json(_FILE, _known_keys(_FILE, document, place), place)
    limits: list[Limit] = []
    for section in _SECTIONS:
        limits += _section(section, getattr(file, section), place.key(section))
    required = _required(file)
    calibration = tuple(_calibration(file.calibration, place.key("calibration")))
    if file.findings is not None:
        _check_codes(file.findings, place.key("findings"))
    baseline = None
    if file.baseline is not None:
        baseline = _baseline(file.baseline, place.key("baseline"), folder)
    if not (limits or calibration or required or baseline or file.findings):
        place.refuse("no limit", "one such as [gyroscope] N = { max = 1e-4 }")
    return Limits(
        limits=tuple(limits),
        calibration=calibration,
        required=required,
        findings=file.findings or FindingRules(),
        baseline=baseline,
        undecided=file.undecided or "pass",
    )


def _known_keys(kind: Any, value: object, place: Place) -> dict[str, object]:  # noqa: ANN401 - a dataclass
    """Return a table by the symbols of terms, such as N for ARW and VRW; unknown keys are refused."""
    if not isinstance(value, dict):
        place.refuse_value(value, "a table, such as { max = 1e-4 }")
    hints = hints_of(kind)
    table: dict[str, object] = {}
    for key, item in value.items():
        name = symbol_of(key) or key
        _check_name(name, tuple(hints), place, "key")
        if name in table:
            place.key(key).refuse(f"{name} has limits twice", "one entry for both")
        inner = without_none(hints[name]) if is_optional(hints[name]) else hints[name]
        table[name] = _known_keys(inner, item, place.key(name)) if is_dataclass(inner) else item
    return table


def _required(file: object) -> dict[Sensor, tuple[Axis, ...]]:
    """Return the axes that each sensor must have."""
    required: dict[Sensor, tuple[Axis, ...]] = {}
    for sensor in Sensor:
        table = getattr(file, sensor.value)
        if table is not None and table.axes is not None:
            required[sensor] = tuple(axis for axis in AXES if axis in table.axes)
    return required


def _section(section: str, table: object, place: Place) -> Iterator[Limit]:
    """Yield the limits of an axis, a sensor or the log."""
    for quantity, limit in _entries(table):
        if not isinstance(limit, _LogRange):
            continue
        inner = place.key(quantity)
        unit, factor = _unit_and_factor(limit, _SENSOR_OF.get(section), quantity, inner)
        if limit.min is None and limit.max is None:
            inner.refuse("neither min nor max", "a limit such as { max = 1e-4 }")
        if limit.min is not None and limit.max is not None and limit.min > limit.max:
            inner.refuse(f"min {limit.min:g} is above max {limit.max:g}", "the opposite")
        if limit.min is not None:
            yield Limit(section, quantity, "min", limit.min, unit, factor)
        if limit.max is not None:
            yield Limit(section, quantity, "max", limit.max, unit, factor)


def _entries(table: Any) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - a dataclass, or None
    """Yield the keys of a table that the file contains, with their values."""
    for attribute in () if table is None else fields(table):
        value = getattr(table, attribute.name)
        if value is not None:
            yield attribute.name, value


def _unit_and_factor(
    limit: _LogRange, sensor: Sensor | None, quantity: str, place: Place
) -> tuple[str, float]:
    """Return the unit of a limit and its factor to SI; ``x BMI088`` for the figure of a data sheet."""
    if isinstance(limit, _Range) and limit.sensor is not None and sensor is not None:
        if limit.unit is not None:
            place.key("unit").refuse_value(limit.unit, "no unit of a multiple of the data sheet's figure")
        return _figure(limit.sensor, sensor, quantity, place.key("sensor"))
    # A quantity of the log has the same units for both sensors.
    units = quantity_units(quantity, sensor or Sensor.GYROSCOPE)
    return (next(iter(units)), 1.0) if limit.unit is None else _unit(limit.unit, units, place)


def _figure(name: str, sensor: Sensor, quantity: str, place: Place) -> tuple[str, float]:
    try:
        part = find_sensor(name)
    except ChoiceError as error:
        raise error.at(f"{place.file}: {place.path}") from error
    term = part.term(sensor, quantity)
    if term is None:
        own = part.sensors.get(sensor)
        given = ", ".join(own.terms) if own else ""
        found = f"the data sheet of the {part.name} gives no {quantity} of the {sensor}"
        place.refuse(found, f"one of {given}" if given else "a limit without a part")
    return f"x {part.name}", term.reference


def _unit(text: str, units: Mapping[str, float], place: Place) -> tuple[str, float]:
    unit = find_unit(text, units)
    if unit is None:
        place.key("unit").refuse_value(text, f"one of {', '.join(filter(None, units))}")
    return unit


def _calibration(calibration: object, place: Place) -> Iterator[Limit]:
    for sensor, table in _entries(calibration):
        for quantity, limit in _entries(table):
            inner = place.key(sensor).key(quantity)
            unit, factor = _unit(limit.unit, CALIBRATION_UNITS[Sensor(sensor)][quantity], inner)
            yield Limit(f"calibration.{sensor}", quantity, "max", limit.max, unit, factor)


def _check_codes(rules: FindingRules, place: Place) -> None:
    for key, codes in (("forbid", rules.forbid), ("allow", rules.allow)):
        for code in codes:
            _check_name(code, sorted(FINDING_CODES), place.key(key), "code")
    both = sorted({*rules.forbid} & {*rules.allow})
    if both:
        place.refuse(f"{', '.join(both)} both forbidden and allowed", "one of the two")


def _baseline(table: _BaselineTable, place: Place, folder: Path) -> Baseline:
    terms = tuple(symbol_of(name) or name for name in table.terms)
    for term in terms:
        _check_name(term, TERM_QUANTITIES, place.key("terms"), "term")
    rules = Baseline(report=None if table.report is None else folder / table.report, terms=terms)
    if table.max_increase is None and table.max_decrease is None:
        return rules
    return replace(rules, max_increase=table.max_increase, max_decrease=table.max_decrease)


def _check_name(name: str, known: Collection[str], place: Place, what: str) -> None:
    """Refuse an unknown name, with the nearest known one."""
    if name in known:
        return
    # The short name of a sensor is nearer to its axes than to itself.
    near = [sensor for sensor in _SENSORS if sensor in known and name and sensor.startswith(name)]
    near += difflib.get_close_matches(name, known, n=1, cutoff=_NEAR)
    if not near:
        place.refuse(f"unknown {what} {name!r}", f"one of {', '.join(known)}")
    where = f"{place.file}: {place.path}" if place.path else place.file
    raise ReadError(f"unknown {what} {name!r}", place=where, fix=Fix(f"did you mean {near[0]!r}?"))
