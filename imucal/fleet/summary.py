"""The store of a fleet -> Fleet: the statistics of each sensor model, which all reports use."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, TypeAlias

from imucal._version import __version__
from imucal.display import Displayed
from imucal.errors import ChoiceError, DataError, Fix
from imucal.fitting.homogeneity import symbol_of
from imucal.fleet.population import Population, UnitValue, population
from imucal.fleet.store import LogRow, read_store
from imucal.fleet.values import LogValue
from imucal.multiple_tests import SIGNIFICANCE, holm
from imucal.noise.terms import TERMS
from imucal.recording import Axis, Sensor

#: Sensor model, sensor, axis and term.
TermKey: TypeAlias = tuple[str, str, str, str]
#: Stored fields of a value, besides the unit.
_OF_VALUE = ("value", "low", "high", "variance", "variance_sd", "level", "correlation_time")


@dataclass(frozen=True, kw_only=True)
class FleetLog:
    """One log of a fleet; without labels `model` is empty and `unit` None.

    `status` is ``ok`` or the kind of failure; `verdict` is good, check, not-noise or empty; `findings` are
    codes. `report` is the folder of its own report, relative to the fleet's folder, or empty. `reason` and
    `code` are the sentence and the code of an error. `left_out` is the reason why its numbers do not count,
    or empty.
    """

    path: str
    model: str
    unit: str | None
    temperature_c: float | None
    started: str | None
    status: str
    reason: str
    code: str
    verdict: str
    findings: tuple[str, ...]
    seconds: float | None
    rate_hz: float | None
    report: str
    left_out: str

    @property
    def counts(self) -> bool:
        """Whether its numbers belong to a unit of a model."""
        return self.unit is not None and not self.left_out


@dataclass(frozen=True, kw_only=True)
class FleetTerm:
    """One noise term of one axis of a sensor model, in the SI `unit`.

    `without_odd` is the tolerance bound without the odd units; None if no unit is odd, or too few are left.
    `sure` are units that are odd among all units of all terms of the fleet, and `differing` those whose logs
    differ from one another, adjusted for the same number of tests.
    """

    sensor: Sensor
    axis: Axis
    term: str
    logs: tuple[LogValue, ...]
    population: Population
    without_odd: float | None
    sure: tuple[str, ...] = ()
    differing: tuple[str, ...] = ()

    @property
    def symbol(self) -> str:
        """``GM`` for ``GM2``."""
        return symbol_of(self.term)

    @property
    def unit(self) -> str:
        return TERMS[self.symbol].unit(self.sensor)

    @property
    def name(self) -> str:
        return f"{self.sensor.short}_{self.axis}"

    @property
    def odd(self) -> tuple[UnitValue, ...]:
        """The units that differ from the others."""
        return tuple(unit for unit in self.population.units if unit.odd)


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """The units of one sensor model; `rate_hz` is the median rate of its logs."""

    name: str
    units: tuple[str, ...]
    logs: tuple[FleetLog, ...]
    rate_hz: float
    terms: tuple[FleetTerm, ...]

    @property
    def title(self) -> str:
        return self.name or "Sensor"

    def __getitem__(self, key: tuple[str, str]) -> FleetTerm:
        """Return a term by axis and key, such as ``("gyro_x", "N")``."""
        for term in self.terms:
            if (term.name, term.term) == key:
                return term
        raise KeyError(f"{key}; {self.title} has {', '.join(f'{t.name} {t.term}' for t in self.terms)}")


@dataclass(frozen=True, kw_only=True, repr=False)
class Fleet(Displayed):
    """The results of a fleet.

    `folder` is the store; `asked` is the number of requested logs. `loose` are logs without a unit label,
    which are in no population; `labels` is a pattern for them.
    """

    drawn_by: ClassVar[str] = "imucal.fleet.page"

    folder: Path
    models: tuple[SensorModel, ...]
    logs: tuple[FleetLog, ...]
    asked: int
    loose: tuple[FleetLog, ...]
    labels: str
    version: str

    @property
    def failures(self) -> dict[tuple[str, str], tuple[FleetLog, ...]]:
        """Logs that do not count, by status and reason; the most frequent first.

        Errors with the same code share the reason of the first one.
        """
        groups: dict[tuple[str, str], list[FleetLog]] = {}
        for log in filter(lambda log: log.left_out, self.logs):
            kind = log.status if log.status != "ok" else log.verdict
            groups.setdefault((kind, log.code or log.left_out), []).append(log)
        ordered = sorted(groups.items(), key=lambda group: (-len(group[1]), group[0]))
        return {(kind, logs[0].left_out): tuple(logs) for (kind, _), logs in ordered}

    def model(self, name: str | None = None) -> SensorModel:
        """Return a sensor model by its name; without one the only model.

        Raises ChoiceError if there is no such model, or several and no name is given.
        """
        chosen = choose_model(self.folder, [model.name for model in self.models], name)
        return next(model for model in self.models if model.name == chosen)


def load_fleet(folder: str | Path, *, content: float = 0.95, confidence: float = 0.95) -> Fleet:
    """Return the statistics of each sensor model of a fleet.

    Parameters
    ----------
    folder
        The folder of ``imucal fleet run``.
    content, confidence
        A share `content` of all units is below the tolerance bound with the probability `confidence`.

    Raises
    ------
    ReadError
        If there is no fleet.
    StoreError
        If it is damaged.
    DataError
        If none of its logs was done.
    """
    stored = read_store(folder)
    stored.refuse_damage()
    rows = stored.logs()
    asked = sum(log.copy_of is None for log in stored.asked.values())
    if not rows:
        problem = f"found {asked} logs, none finished"
        raise DataError(problem, place=stored.folder, fix=Fix("run the fleet first"))
    logs = [_log(row) for row in rows]
    terms = _judged_together(
        {
            key: _term(key, values, content=content, confidence=confidence)
            for key, values in _grouped(rows, logs).items()
        }
    )
    loose = tuple(log for log in logs if log.unit is None and not log.left_out)
    names = sorted({log.model for log in logs if log.counts})
    return Fleet(
        folder=stored.folder,
        models=tuple(_model(name, logs, terms) for name in names),
        logs=tuple(logs),
        asked=asked,
        loose=loose,
        labels=labels_to_type([log.path for log in loose]) if loose else "",
        version=__version__,
    )


def choose_model(folder: str | Path, names: Sequence[str], asked: str | None) -> str:
    """Return the requested sensor model, or the only one; otherwise raise ChoiceError."""
    found = [name for name in names if asked in {None, name}]
    if len(found) == 1:
        return found[0]
    choices = ", ".join(map(repr, names)) or "none: no log has a unit label"
    what = "no model name" if asked is None else repr(asked)
    text = f"found {what}, expected one of the sensor models: {choices}"
    raise ChoiceError(text, place=folder, fix=Fix("", "model", "NAME"))


def labels_to_type(paths: Sequence[str]) -> str:
    """Return a pattern of labels: the unit is the last folder that differs, or the file name."""
    places = [PurePosixPath(path.replace("\\", "/")) for path in paths]
    suffixes = {place.suffix for place in places}
    folders = {place.parent.name for place in places}
    unit = "{unit}/*" if len(folders) > 1 and "" not in folders else "{unit}"
    return unit + (suffixes.pop() if len(suffixes) == 1 else "")


def _log(row: LogRow) -> FleetLog:
    status, verdict = row["status"], row["verdict"] or ""
    left_out = "" if status == "ok" else row["reason"] or status
    findings = tuple(row["findings"] or ())
    if not left_out and verdict in ("not-noise", "empty"):
        left_out = f"not noise at rest: {', '.join(findings) or verdict}"
    values = {name: row[name] for name in ("unit", "temperature_c", "started", "seconds", "rate_hz")}
    texts = ("path", "model", "status", "reason", "code", "verdict", "report")
    values |= {name: row[name] or "" for name in texts}
    return FleetLog(**values, findings=findings, left_out=left_out)


def _grouped(rows: Sequence[LogRow], logs: Sequence[FleetLog]) -> dict[TermKey, list[LogValue]]:
    """Return the values of the logs that count, in the order of a model's terms."""
    found: dict[TermKey, list[LogValue]] = {}
    for row, log in zip(rows, logs, strict=True):
        for value in row["terms"] if log.counts else ():
            key = log.model, value["sensor"], value["axis"], value["term"]
            fields = {name: value[name] for name in _OF_VALUE}
            # A term without a square has no growth either.
            growth = value["variance_growth"] or 0.0
            found.setdefault(key, []).append(LogValue(unit=log.unit or "", variance_growth=growth, **fields))
    order = {str(name): place for place, name in enumerate((*Sensor, *TERMS))}

    def place(key: TermKey) -> tuple[object, ...]:
        return key[0], order[key[1]], order[symbol_of(key[3])], key[3], key[2]

    return {key: found[key] for key in sorted(found, key=place)}


def _term(key: TermKey, logs: Sequence[LogValue], *, content: float, confidence: float) -> FleetTerm:
    found = population(logs, content=content, confidence=confidence)
    odd = {unit.unit for unit in found.units if unit.odd}
    others = [log for log in logs if log.unit not in odd] if odd else []
    without_odd = population(others, content=content, confidence=confidence).tolerance if others else None
    axis: Any = key[2]
    return FleetTerm(
        sensor=Sensor(key[1]),
        axis=axis,
        term=key[3],
        logs=tuple(logs),
        population=found,
        without_odd=without_odd,
    )


def _judged_together(terms: Mapping[TermKey, FleetTerm]) -> dict[TermKey, FleetTerm]:
    """Return the terms with the units that are odd, or whose logs differ, among all units of all terms.

    Without this correction a fleet with many terms has false alarms.
    """
    sure = _significant(
        {key: {u.unit: u.p_value for u in term.population.units} for key, term in terms.items()}
    )
    differing = _significant(
        {key: {u.unit: u.p_logs for u in term.population.units} for key, term in terms.items()}
    )
    return {key: replace(term, sure=sure[key], differing=differing[key]) for key, term in terms.items()}


def _significant(p_values: Mapping[TermKey, Mapping[str, float | None]]) -> dict[TermKey, tuple[str, ...]]:
    """Return the units of each term whose p-values are significant among all of them."""
    tested = [(key, unit, p) for key, units in p_values.items() for unit, p in units.items() if p is not None]
    adjusted = holm([p for _, _, p in tested])
    found: dict[TermKey, list[str]] = {key: [] for key in p_values}
    for (key, unit, _), p in zip(tested, adjusted, strict=True):
        if p <= SIGNIFICANCE:
            found[key].append(unit)
    return {key: tuple(units) for key, units in found.items()}


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key by which u9 comes before u10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _model(name: str, every: Iterable[FleetLog], terms: Mapping[TermKey, FleetTerm]) -> SensorModel:
    logs = tuple(log for log in every if log.model == name and log.unit is not None)
    rates = sorted(log.rate_hz for log in logs if log.rate_hz)
    return SensorModel(
        name=name,
        units=tuple(sorted({log.unit for log in logs if log.unit and log.counts}, key=_natural)),
        logs=logs,
        rate_hz=rates[len(rates) // 2] if rates else math.nan,
        terms=tuple(term for key, term in terms.items() if key[0] == name),
    )
