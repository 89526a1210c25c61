"""The limits file: TOML in, checked values out, each limit with the factor of its unit.

A limit stands under the axis (``gyro_x``), the sensor (``gyroscope``: each of its axes) or the log
it is about::

    undecided = "pass"            # or "fail": what an interval that holds the limit means

    [gyroscope]
    N = { max = 0.3, unit = "deg/sqrt(h)" }
    K = { max = 1e-5 }            # SI where no unit is given

    [gyro_z]
    B = { min = 1, max = 10, unit = "deg/h" }

    [log]
    duration = { min = 2, unit = "h" }

    [findings]
    level = "warning"             # forbid findings this grave or graver ("none": forbid none)
    forbid = ["roll-off"]         # and these, however grave
    allow = ["gaps"]              # but not these

    [baseline]
    report = "golden/report.json" # from the folder of this file
    max_increase = 0.2            # a term may be at most 20 % above
"""

import difflib
import math
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NoReturn, TypeAlias

from imucal.errors import LimitsError
from imucal.noise.terms import TERMS, symbol_of
from imucal.recording import Axis, Sensor
from imucal.units import find_unit

Undecided: TypeAlias = Literal["pass", "fail"]

#: Levels of findings, the gravest last.
GRAVE = ("info", "warning", "error")

_CODES = """
absurd-rate axis-missing bad-rows bursts clock-jump clocks-differ coarse-lsb coarse-stamps compression
counter-unused crc cut-line cycle cycle-doubtful damaged definition delay dropouts duplicate-axes
duplicate-stamps encapsulation extra-samples few-units fast-rate file-missing gaps gaps-in-curve
gaps-in-fit held-samples index joined line log-out-of-order log-time-used model-choice model-misfit
motion no-data no-gravity no-result nonstationary not-checked not-drawn not-finite other-vectors
output-filter poor-fit predicts-badly rate-differs rate-given record-length record-length-unknown
records-differ rests roll-off rounding sampling-period saturated sawtooth second-opinion sensor-missing
short-times spectral-ambiguity spikes stamps-out-of-order step stuck swapped-sensors telegraph
temperature time-unused tone touch truncated two-maxima uneven-stamps unindexed unit-assumed unit-suspect
verified wal-ignored warm-up warm-up-fitted weak-term wrapped zero-stamps
"""
#: Every code that a finding may have, so that a limits file can't forbid one that doesn't exist;
#: described in ``docs/findings.md``.
FINDING_CODES = frozenset(_CODES.split())


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """One side of what is allowed.

    Attributes
    ----------
    where
        ``log``, a sensor such as ``gyroscope``, or an axis such as ``gyro_x``.
    quantity
        A term's symbol, or a name in `imucal.checking.limits`.
    side
        ``min`` or ``max``.
    value
        The limit, in `unit`.
    unit
        As the file has it.
    factor
        ``value * factor`` is the limit in SI.
    """

    where: str
    quantity: str
    side: Literal["min", "max"]
    value: float
    unit: str
    factor: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingRules:
    """Which findings fail the check: those of `level` or graver, and `forbid`, but never `allow`."""

    level: str = "error"
    forbid: frozenset[str] = frozenset()
    allow: frozenset[str] = frozenset()

    def forbids(self, level: str, code: str) -> bool:
        """Return whether a finding of this level and code fails the check."""
        if code in self.allow:
            return False
        return code in self.forbid or (self.level != "none" and GRAVE.index(level) >= GRAVE.index(self.level))


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """How far a report may be from an older one.

    Attributes
    ----------
    report
        The older report; None where the caller gives it.
    terms
        Symbols that are compared.
    max_increase, max_decrease
        Largest relative change, such as 0.2; None where any is allowed.
    """

    report: Path | None = None
    terms: tuple[str, ...] = ("N", "B", "K")
    max_increase: float | None = 0.2
    max_decrease: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a limits file asks."""

    limits: tuple[Limit, ...] = ()
    required: Mapping[Sensor, tuple[Axis, ...]] = field(default_factory=dict)
    findings: FindingRules = field(default_factory=FindingRules)
    baseline: Baseline | None = None
    undecided: Undecided = "pass"


#: Terms of the model: their coefficients, sigma for GM.
TERM_QUANTITIES = tuple(TERMS)
#: Quantities in the unit of the samples: the curve's lowest deviation, mean and spread of the samples.
SAMPLE_QUANTITIES = ("minimum", "mean", "std")
_LOG_UNITS: dict[str, dict[str, float]] = {
    "rate": {"Hz": 1.0, "kHz": 1e3},
    "duration": {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "gaps": {"": 1.0},
    "missing": {"": 1.0, "%": 0.01, "ppm": 1e-6},
}
#: Quantities of a recording: rate, length, number of gaps, missing samples as a fraction.
LOG_QUANTITIES = tuple(_LOG_UNITS)


def quantity_units(quantity: str, sensor: Sensor) -> dict[str, float]:
    """Return the units of a quantity, the SI unit first, each with its factor to SI."""
    if quantity in LOG_QUANTITIES:
        return _LOG_UNITS[quantity]
    symbol = "B" if quantity in SAMPLE_QUANTITIES else quantity
    return TERMS[symbol].coefficient_units(sensor)


_AXES: tuple[Axis, ...] = ("x", "y", "z")
_AXIS_NAMES = {f"{sensor.short}_{axis}": sensor for sensor in Sensor for axis in _AXES}
_SENSORS = tuple(sensor.value for sensor in Sensor)
_SECTIONS = ("log", *_SENSORS, *_AXIS_NAMES)


def read_limits(path: Path) -> Limits:
    """Read a limits file.

    Raises
    ------
    LimitsError
        If the file can't be read, is not TOML, or has a key, unit or value that is not known.
    """
    path = Path(path)
    return parse_limits(text_of(path, "a TOML file of limits"), name=str(path), folder=path.parent)


def text_of(path: Path, expected: str) -> str:
    """Return the text of a file that is checked, or checked against; a LimitsError says what was expected."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        msg = f"{path}: can't be read ({reason}), expected {expected}"
        raise LimitsError(msg) from error


def parse_limits(text: str, *, name: str = "limits", folder: Path | None = None) -> Limits:
    """Return the limits of a TOML text; messages name `name`, a baseline is sought from `folder`.

    Raises
    ------
    LimitsError
        As `read_limits`.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        msg = f"{name}: not TOML ({error}), expected limits such as [gyroscope] N = {{ max = 1e-4 }}"
        raise LimitsError(msg) from error
    return _File(name=name, folder=folder or Path()).limits(document)


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """The file being read: what its messages name, and where its relative paths start."""

    name: str
    folder: Path

    def limits(self, document: Mapping[str, object]) -> Limits:
        self._known("", document, (*_SECTIONS, "findings", "baseline", "undecided"))
        limits: list[Limit] = []
        required: dict[Sensor, tuple[Axis, ...]] = {}
        for section in _SECTIONS:
            table = self._by_symbol(section, self._table(section, document.get(section, {})))
            axes = table.pop("axes", None)
            if axes is not None and section in _SENSORS:
                required[Sensor(section)] = self._axes(f"{section}.axes", axes)
            limits += self._section(section, table)
            if axes is not None and section not in _SENSORS:
                self._refuse(f"{section}.axes", "only gyroscope and accelerometer have axes", "remove it")
        findings = self._findings(self._table("findings", document.get("findings", {})))
        baseline = None
        if "baseline" in document:
            baseline = self._baseline(self._table("baseline", document["baseline"]))
        if not (limits or required or baseline or "findings" in document):
            self._refuse("", "no limit", "write one, such as [gyroscope] N = { max = 1e-4 }")
        undecided = document.get("undecided", "pass")
        if undecided not in ("pass", "fail"):
            self._refuse("undecided", repr(undecided), 'expected "pass" or "fail"')
        return Limits(
            limits=tuple(limits),
            required=required,
            findings=findings,
            baseline=baseline,
            undecided="fail" if undecided == "fail" else "pass",
        )

    def _by_symbol(self, section: str, table: Mapping[str, object]) -> dict[str, object]:
        """Return a section with its terms under their symbols: ARW and VRW are N, BI is B, RRW is K."""
        found: dict[str, object] = {}
        for key, value in table.items():
            symbol = symbol_of(key) or key
            if symbol in found:
                self._refuse(f"{section}.{key}", f"{symbol} has limits twice", "write one entry for both")
            found[symbol] = value
        return found

    def _section(self, section: str, table: Mapping[str, object]) -> list[Limit]:
        of_axes = () if section == "log" else (*TERM_QUANTITIES, *SAMPLE_QUANTITIES)
        also = ("axes",) if section in _SENSORS else ()
        self._known(section, table, (*of_axes, *LOG_QUANTITIES), also=also)
        limits: list[Limit] = []
        for quantity, entry in table.items():
            limits += self._limit(section, quantity, self._table(f"{section}.{quantity}", entry))
        return limits

    def _limit(self, section: str, quantity: str, table: Mapping[str, object]) -> list[Limit]:
        place = f"{section}.{quantity}"
        self._known(place, table, ("min", "max", "unit"))
        sensor = _AXIS_NAMES.get(section) or (Sensor.GYROSCOPE if section == "log" else Sensor(section))
        units = quantity_units(quantity, sensor)
        written = table.get("unit", next(iter(units)))
        if not isinstance(written, str):
            self._refuse(f"{place}.unit", repr(written), 'expected text, such as "deg/h"')
        unit = find_unit(written, units)
        if unit is None:
            self._refuse(f"{place}.unit", repr(written), f"expected one of {', '.join(filter(None, units))}")
        limits = [
            Limit(
                where=section,
                quantity=quantity,
                side=side,
                value=self._number(f"{place}.{side}", table[side]),
                unit=unit[0],
                factor=unit[1],
            )
            for side in ("min", "max")
            if side in table
        ]
        if not limits:
            self._refuse(place, "neither min nor max", "expected one of them, such as { max = 1e-4 }")
        if len(limits) > 1 and limits[0].value > limits[1].value:
            self._refuse(place, "min is above max", "swap them")
        return limits

    def _findings(self, table: Mapping[str, object]) -> FindingRules:
        self._known("findings", table, ("level", "forbid", "allow"))
        level = table.get("level", "error")
        if level not in (*GRAVE, "none"):
            self._refuse("findings.level", repr(level), "expected info, warning, error or none")
        forbid = self._codes("findings.forbid", table.get("forbid", []))
        allow = self._codes("findings.allow", table.get("allow", []))
        if both := sorted(forbid & allow):
            self._refuse("findings", f"{', '.join(both)} both forbidden and allowed", "choose one")
        return FindingRules(level=str(level), forbid=forbid, allow=allow)

    def _baseline(self, table: Mapping[str, object]) -> Baseline:
        self._known("baseline", table, ("report", "terms", "max_increase", "max_decrease"))
        report = table.get("report")
        if not isinstance(report, str | None):
            self._refuse("baseline.report", repr(report), "expected the path of a report")
        asked = self._texts("baseline.terms", table.get("terms", list(Baseline().terms)))
        terms = tuple(symbol_of(text) or text for text in asked)
        self._known("baseline.terms", terms, TERM_QUANTITIES)
        changes = {
            side: self._number(f"baseline.{side}", table[side], low=0)
            for side in ("max_increase", "max_decrease")
            if side in table
        }
        return Baseline(
            report=None if report is None else self.folder / report,
            terms=terms,
            max_increase=changes.get("max_increase", None if changes else Baseline().max_increase),
            max_decrease=changes.get("max_decrease"),
        )

    def _axes(self, place: str, value: object) -> tuple[Axis, ...]:
        names = self._texts(place, value)
        self._known(place, names, _AXES)
        return tuple(axis for axis in _AXES if axis in names)

    def _codes(self, place: str, value: object) -> frozenset[str]:
        codes = self._texts(place, value)
        self._known(place, codes, FINDING_CODES)
        return frozenset(codes)

    def _texts(self, place: str, value: object) -> list[str]:
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self._refuse(place, repr(value), 'expected a list of texts, such as ["N", "K"]')
        return value

    def _table(self, place: str, value: object) -> Mapping[str, object]:
        if not isinstance(value, dict):
            self._refuse(place, repr(value), "expected a table, such as { max = 1e-4 }")
        return value

    def _number(self, place: str, value: object, low: float = -math.inf) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self._refuse(place, repr(value), "expected a number")
        if value < low:
            self._refuse(place, repr(value), f"expected {low:g} or more")
        return float(value)

    def _known(
        self, place: str, keys: Collection[str], known: Collection[str], *, also: tuple[str, ...] = ()
    ) -> None:
        for key in keys:
            if key not in known and key not in also:
                near = [name for name in known if name in _SENSORS and key and name.startswith(key)]
                near += difflib.get_close_matches(key, [*known, *also], n=1, cutoff=0.5)
                code = known is FINDING_CODES
                expected = "the code of a finding" if code else ", ".join([*known, *also])
                hint = f"did you mean {near[0]!r}?" if near else f"expected {expected}"
                self._refuse(place, f"unknown {'code' if code else 'key'} {key!r}", hint)

    def _refuse(self, place: str, found: str, expected: str) -> NoReturn:
        where = f"{self.name}: {place}" if place else self.name
        msg = f"{where}: {found}{';' if expected.endswith('?') else ','} {expected}"
        raise LimitsError(msg)
