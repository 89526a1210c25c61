"""The limits file: TOML in, checked values out.

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
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from imucal.checking.limit_units import (
    LOG_QUANTITIES,
    SAMPLE_QUANTITIES,
    TERM_QUANTITIES,
    plain_unit,
    quantity_units,
)
from imucal.checking.limits import (
    FINDING_CODES,
    GRAVE,
    Baseline,
    FindingRules,
    Limit,
    Limits,
    Undecided,
)
from imucal.errors import LimitsError
from imucal.noise.terms import symbol_of
from imucal.recording import Axis, Sensor

_AXES: tuple[Axis, ...] = ("x", "y", "z")
_AXIS_NAMES = {f"{sensor.short}_{axis}": sensor for sensor in Sensor for axis in _AXES}
_SENSORS = tuple(sensor.value for sensor in Sensor)
_SECTIONS = ("log", *_SENSORS, *_AXIS_NAMES)
_TOP = (*_SECTIONS, "findings", "baseline", "undecided")


def read_limits(path: Path) -> Limits:
    """Read a limits file.

    Raises
    ------
    LimitsError
        If the file can't be read, is not TOML, or has a key, unit or value that is not known.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        msg = f"{path}: can't be read ({reason}), expected a TOML file of limits"
        raise LimitsError(msg) from error
    return parse_limits(text, name=str(path), folder=path.parent)


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
        self._known("", document, _TOP)
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
        return Limits(
            limits=tuple(limits),
            required=required,
            findings=findings,
            baseline=baseline,
            undecided=self._undecided(document.get("undecided", "pass")),
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

    def _undecided(self, value: object) -> Undecided:
        if value not in ("pass", "fail"):
            self._refuse("undecided", repr(value), 'expected "pass" or "fail"')
        return "fail" if value == "fail" else "pass"

    def _section(self, section: str, table: Mapping[str, object]) -> list[Limit]:
        known: tuple[str, ...] = LOG_QUANTITIES
        if section != "log":
            known = (*TERM_QUANTITIES, *SAMPLE_QUANTITIES, *LOG_QUANTITIES)
        self._known(section, table, known, also=("axes",) if section in _SENSORS else ())
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
        unit = plain_unit(written)
        if unit not in units:
            self._refuse(f"{place}.unit", repr(written), f"expected one of {', '.join(filter(None, units))}")
        limits = [
            Limit(
                where=section,
                quantity=quantity,
                side=side,
                value=self._number(f"{place}.{side}", table[side]),
                unit=unit,
                factor=units[unit],
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
        for code in codes:
            if code not in FINDING_CODES:
                near = difflib.get_close_matches(code, FINDING_CODES, n=1, cutoff=0.5)
                hint = f"did you mean {near[0]!r}?" if near else "expected the code of a finding"
                self._refuse(place, f"unknown code {code!r}", hint)
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
        self, place: str, keys: Collection[str], known: Collection[str], also: tuple[str, ...] = ()
    ) -> None:
        for key in keys:
            if key not in known and key not in also:
                near = [name for name in known if name in _SENSORS and key and name.startswith(key)]
                near += difflib.get_close_matches(key, [*known, *also], n=1, cutoff=0.5)
                hint = f"did you mean {near[0]!r}?" if near else f"expected {', '.join([*known, *also])}"
                self._refuse(place, f"unknown key {key!r}", hint)

    def _refuse(self, place: str, found: str, expected: str) -> NoReturn:
        where = f"{self.name}: {place}" if place else self.name
        msg = f"{where}: {found}{';' if expected.endswith('?') else ','} {expected}"
        raise LimitsError(msg)
