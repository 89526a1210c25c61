"""The store of a fleet -> Fleet: the statistics of each sensor model, which all reports use."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, ClassVar

from imucal._version import __version__
from imucal.arguments import takes
from imucal.display import Displayed
from imucal.errors import ChoiceError, DataError, Fix
from imucal.findings import Finding
from imucal.fitting.homogeneity import symbol_of
from imucal.fleet.population import UnitValue
from imucal.fleet.store import FleetStore
from imucal.fleet.values import LogValue
from imucal.fleet_report import answers
from imucal.fleet_report.answers import Ask, LogRows, TermAnswer, TermKey, UnitLogs
from imucal.frozen import frozen
from imucal.multiple_tests import SIGNIFICANCE, holm
from imucal.noise.terms import TERMS
from imucal.recording import Axis, Sensor

if TYPE_CHECKING:
    import polars as pl


@frozen
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


@frozen
class FleetTerm(TermAnswer):
    """One noise term of one axis of a sensor model, in the SI `unit`."""

    sensor: Sensor
    axis: Axis
    term: str
    logs: Sequence[LogValue]
    unit_logs: tuple[UnitLogs, ...]

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

    @property
    def differing(self) -> tuple[str, ...]:
        """The units whose logs differ from one another."""
        return tuple(unit.unit for unit in self.unit_logs if unit.differs)


@frozen
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


@frozen
class LooseLog:
    """A log without a unit's label, with its values by axis and term."""

    log: FleetLog
    values: Mapping[tuple[str, str], LogValue]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Fleet(Displayed):
    """The results of a fleet.

    `folder` is the store; `asked` is the number of requested logs. `loose` are logs without a unit label,
    which are in no population; `labels` is a pattern for them. `findings` belong to the whole fleet.
    """

    drawn_by: ClassVar[str] = "imucal.fleet_report.pages"

    folder: Path
    models: tuple[SensorModel, ...]
    logs: tuple[FleetLog, ...]
    asked: int
    loose: tuple[LooseLog, ...]
    labels: str
    findings: tuple[Finding, ...]
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


@takes('imucal.load_fleet("fleet")', folder=(str, Path))
def load_fleet(
    folder: str | Path,
    *,
    content: float = 0.95,
    confidence: float = 0.95,
    unit_logs: bool = True,
    model: str | None = None,
    ask: Ask | None = None,
) -> Fleet:
    """Return the statistics of each sensor model of a fleet.

    Statistics of unchanged logs are read from the folder.

    Parameters
    ----------
    folder
        The folder of ``imucal fleet run``.
    content, confidence
        A share `content` of all units is below the tolerance bound with the probability `confidence`.
    unit_logs
        Whether to test if several logs of a unit have one coefficient.
    model
        Name of one sensor model; None for all.
    ask
        Function that computes missing statistics; by default this process and its children do.

    Raises
    ------
    ReadError
        If there is no fleet.
    StoreError
        If it is damaged.
    DataError
        If none of its logs was done.
    """

    def chosen(names: Sequence[str]) -> list[str]:
        return [name for name in names if model in {None, name}]

    return _loaded(FleetStore(folder), chosen, content, confidence, unit_logs=unit_logs, ask=ask)


def load_model(folder: str | Path, model: str | None = None) -> Fleet:
    """Return a fleet with one sensor model, without the tests of its units' logs.

    Raises ChoiceError, as `Fleet.model` does, before any computation.
    """
    return _loaded(FleetStore(folder), lambda names: [choose_model(folder, names, model)], unit_logs=False)


def _loaded(
    store: FleetStore,
    choose: Callable[[Sequence[str]], Sequence[str]],
    content: float = 0.95,
    confidence: float = 0.95,
    *,
    unit_logs: bool,
    ask: Ask | None = None,
) -> Fleet:
    asked = store.manifest()["copy_of"].null_count()
    store.refuse_damage()
    table, ask = store.logs(), ask or answers.here
    logs = {row["key"]: _log(row) for row in table.iter_rows(named=True)}
    if not logs:
        problem = f"found {asked} logs, none finished"
        raise DataError(problem, place=store.folder, fix=Fix("run the fleet first"))
    units = {key: (log.model, log.unit or "") for key, log in logs.items() if log.counts}
    names = choose(sorted({model for model, _ in units.values()}))
    results = store.results(table)
    groups = _grouped(results, {key: own for key, (own, _) in units.items() if own in names})
    tests, findings = answers.unit_tests(store, ask, units, groups) if unit_logs else ({}, ())
    rows = list(map(LogRows, groups.values()))
    asked_of = [answers.TermQuestion(logs=own, content=content, confidence=confidence) for own in rows]
    found = answers.answers_to(asked_of, TermAnswer, store, ask)
    terms = list(_judged_together(dict(zip(groups, zip(rows, found, strict=True), strict=True)), tests))
    loose = _loose(results, logs)
    return Fleet(
        folder=store.folder,
        models=tuple(_model(name, logs.values(), terms) for name in names),
        logs=tuple(logs.values()),
        asked=asked,
        loose=loose,
        labels=labels_to_type([one.log.path for one in loose]) if loose else "",
        findings=findings,
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


def _model(name: str, every: Iterable[FleetLog], terms: Iterable[tuple[str, FleetTerm]]) -> SensorModel:
    logs = tuple(log for log in every if log.model == name and log.unit is not None)
    rates = sorted(log.rate_hz for log in logs if log.rate_hz)
    return SensorModel(
        name=name,
        units=tuple(sorted({log.unit for log in logs if log.unit and log.counts})),
        logs=logs,
        rate_hz=rates[len(rates) // 2] if rates else math.nan,
        terms=tuple(term for model, term in terms if model == name),
    )


def _judged_together(
    found: Mapping[TermKey, tuple[LogRows, TermAnswer]], tests: Mapping[TermKey, Sequence[UnitLogs]]
) -> Iterator[tuple[str, FleetTerm]]:
    """Yield the terms by model; tests of logs are adjusted for all units and terms."""
    chances = iter(holm([test.p_value for key in found for test in tests.get(key, ())]))
    for key, (logs, answer) in found.items():
        values: dict[str, Any] = {field.name: getattr(answer, field.name) for field in fields(TermAnswer)}
        values |= {"axis": key[2], "term": key[3]}
        own = (replace(test, differs=next(chances) <= SIGNIFICANCE) for test in tests.get(key, ()))
        yield key[0], FleetTerm(sensor=Sensor(key[1]), logs=logs, unit_logs=tuple(own), **values)


def _log(row: Mapping[str, Any]) -> FleetLog:
    status, verdict = row["status"], row["verdict"] or ""
    left_out = "" if status == "ok" else row["reason"] or status
    findings = tuple(row["findings"] or ())
    if not left_out and verdict in ("not-noise", "empty"):
        left_out = f"not noise at rest: {', '.join(findings) or verdict}"
    values = {name: row[name] for name in ("unit", "temperature_c", "started", "seconds", "rate_hz")}
    texts = ("path", "model", "status", "reason", "code", "verdict", "report")
    values |= {name: row[name] or "" for name in texts}
    return FleetLog(**values, findings=findings, left_out=left_out)


def _grouped(results: "pl.DataFrame", counted: Mapping[str, str]) -> dict[TermKey, "pl.DataFrame"]:
    """Return the rows of results that count, in the order of a model's terms; `counted` is key -> model."""
    import polars as pl

    models = pl.DataFrame(list(counted.items()), schema={"key": pl.String, "model": pl.String}, orient="row")
    rows = results.drop("model").join(models, on="key", how="inner", maintain_order="left")
    found = rows.partition_by("model", "sensor", "axis", "term", as_dict=True, maintain_order=True)
    order = {str(name): place for place, name in enumerate((*Sensor, *TERMS))}

    def place(key: TermKey) -> tuple[object, ...]:
        return key[0], order[key[1]], order[symbol_of(key[3])], key[3], key[2]

    keys: Any = found.keys()
    return {key: found[key] for key in sorted(keys, key=place)}


def _loose(results: "pl.DataFrame", logs: Mapping[str, FleetLog]) -> tuple[LooseLog, ...]:
    keys = [key for key, log in logs.items() if log.unit is None and not log.left_out]
    values: dict[str, dict[tuple[str, str], LogValue]] = {key: {} for key in keys}
    rows = results.filter(results["key"].is_in(keys)).with_columns(unit="path")
    places = rows.select("key", "sensor", "axis", "term").iter_rows()
    for (key, sensor, axis, term), value in zip(places, LogRows(rows), strict=True):
        values[key][f"{Sensor(sensor).short}_{axis}", term] = value
    return tuple(LooseLog(log=logs[key], values=found) for key, found in values.items())
