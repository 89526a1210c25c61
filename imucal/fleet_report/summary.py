"""The store of a fleet -> Fleet: what many logs say of each sensor model; renderers are functions of it."""

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from imucal._version import __version__
from imucal.errors import ChoiceError, DataError
from imucal.findings import Finding
from imucal.fitting.bins import unpack
from imucal.fleet.pooling import Homogeneity, PooledFit, pool_bins
from imucal.fleet.population import FALSE_SHARE, Population, UnitValue, adjusted, population
from imucal.fleet.store import FleetStore
from imucal.fleet.trend import Trend, adjust, trend
from imucal.fleet.values import LogValue
from imucal.noise.terms import TERMS
from imucal.processes import try_side_work
from imucal.recording import Axis, Sensor

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetLog:
    """One log of a fleet.

    Attributes
    ----------
    path, model, unit, temperature_c, started
        Its labels; `model` is empty and `unit` None where there is none.
    status, reason
        ``ok``, or how it failed and the sentence that says why.
    verdict, findings
        good, look, not-noise or empty; the codes of what was found.
    seconds, rate_hz
        Length and rate of the record; None where it was not read.
    report
        Folder of its own report, relative to the fleet's; empty where there is none.
    left_out
        Why its numbers do not count; empty where they do.
    """

    path: str
    model: str
    unit: str | None
    temperature_c: float | None
    started: str | None
    status: str
    reason: str
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


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitLogs:
    """Several logs of one unit, of one term: whether they have one coefficient.

    `p_value` is of this test alone, `differs` is judged over all units and terms of the fleet (Benjamini &
    Hochberg 1995). `value`, `low` and `high` are those of the joint fit, widened where the logs differ; None
    where the term is only bounded. `spread` is the relative deviation between logs beyond chance, 0 where
    they agree.
    """

    unit: str
    logs: int
    p_value: float
    differs: bool
    spread: float
    value: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetTerm:
    """One noise term of one axis of a sensor model.

    Attributes
    ----------
    sensor, axis, term
        Such as the gyroscope's x and ``N``; the coefficient is in the SI `unit`.
    logs
        What each log says.
    population
        What the units are like.
    trend
        How it moves with temperature and time; None where labels do not tell, and `no_trend` says why.
    unit_logs
        The units with several logs.
    price
        Pairs of a number of units, and the bound that so many give over the quantile that it bounds.
    """

    sensor: Sensor
    axis: Axis
    term: str
    logs: tuple[LogValue, ...]
    population: Population
    trend: Trend | None
    no_trend: str
    unit_logs: tuple[UnitLogs, ...]
    price: tuple[tuple[int, float], ...]

    @property
    def symbol(self) -> str:
        """``GM`` for ``GM2``."""
        return symbol_of(self.term)

    @property
    def unit(self) -> str:
        """SI unit of the coefficient."""
        return TERMS[self.symbol].unit(self.sensor)

    @property
    def name(self) -> str:
        """`gyro_x` … `accel_z`."""
        return f"{self.sensor.short}_{self.axis}"

    @property
    def odd(self) -> tuple[UnitValue, ...]:
        """The units that are not like the others."""
        return tuple(unit for unit in self.population.units if unit.odd)

    @property
    def drifting(self) -> tuple[str, ...]:
        """The units that do not move with time or temperature as the others do."""
        slopes = self.trend.slopes if self.trend else ()
        return tuple(dict.fromkeys(slope.unit for slope in slopes if slope.odd))

    @property
    def differing(self) -> tuple[str, ...]:
        """The units whose logs differ from one another."""
        return tuple(unit.unit for unit in self.unit_logs if unit.differs)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorModel:
    """The units of one sensor model; `name` is empty where no label says which.

    `rate_hz` is the median rate of its logs; `terms` are sorted by sensor, term and axis.
    """

    name: str
    units: tuple[str, ...]
    logs: tuple[FleetLog, ...]
    rate_hz: float
    terms: tuple[FleetTerm, ...]

    @property
    def title(self) -> str:
        """What people call it."""
        return self.name or "Sensor"

    def __getitem__(self, key: tuple[str, str]) -> FleetTerm:
        """Return a term by axis and key, such as ``("gyro_x", "N")``."""
        for term in self.terms:
            if (term.name, term.term) == key:
                return term
        msg = f"{key}; {self.title} has {', '.join(f'{t.name} {t.term}' for t in self.terms)}"
        raise KeyError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class LooseLog:
    """A log without a unit's label: its own values, by axis and term."""

    log: FleetLog
    values: Mapping[tuple[str, str], LogValue]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """What the logs of a fleet say.

    Attributes
    ----------
    folder
        The store.
    models
        Sensor models, by name.
    logs
        Every log that was done, sorted by path; `asked` is how many there were to do.
    loose
        Logs without a unit's label, which are in no population.
    labels
        The text of labels to give for them; empty where every log has a unit.
    findings
        What should be known of all of it.
    version
        imucal's version.
    """

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

        Reasons that differ in numbers alone, such as a place in the file, are one: that of the first log.
        """
        groups: dict[tuple[str, str], list[FleetLog]] = {}
        for log in self.logs:
            if log.left_out:
                kind = log.status if log.status != "ok" else log.verdict
                groups.setdefault((kind, re.sub(r"\d+", "#", log.left_out)), []).append(log)
        ordered = sorted(groups.items(), key=lambda group: (-len(group[1]), group[0]))
        return {(kind, logs[0].left_out): tuple(logs) for (kind, _), logs in ordered}

    def model(self, name: str | None = None) -> SensorModel:
        """Return a sensor model by its name; without one the only model.

        Raises
        ------
        ChoiceError
            If there is no such model, or several and no name.
        """
        found = [model for model in self.models if name is None or model.name == name]
        if len(found) == 1:
            return found[0]
        names = ", ".join(repr(model.name) for model in self.models) or "none: no log has a unit's label"
        asked = "no model's name" if name is None else repr(name)
        msg = f"{self.folder}: found {asked}, expected one of the sensor models: {names}"
        raise ChoiceError(msg)


#: Model, sensor, axis and term.
TermKey: TypeAlias = tuple[str, str, str, str]
#: Relative difference of two sampling rates that is none.
_SAME_RATE = 1e-3
_LEVEL = 0.95
#: So many logs' bins are held at once, 18 kB each.
_AT_ONCE = 5000


def _unit_tests(
    store: FleetStore, logs: Mapping[str, FleetLog], terms: Collection[TermKey]
) -> tuple[dict[TermKey, list[UnitLogs]], tuple[Finding, ...]]:
    """Return for each of the models' terms the units with several logs, and what could not be judged."""
    found: dict[TermKey, list[UnitLogs]] = {}
    findings: list[Finding] = []
    for (model, sensor, axis, unit), every in _packed(store, logs):
        own = {key[3]: key for key in terms if key[:3] == (model, sensor, axis)}
        symbols = tuple(symbol for symbol in TERMS if symbol in set(map(symbol_of, own)))
        where = f"{Sensor(sensor).short}_{axis}"
        pooled, said = try_side_work(
            partial(_pooled, every, symbols, Sensor(sensor)),
            None,
            what=f"{unit}: whether its logs agree in {where} is not known",
            code="not-checked",
            axis=where,
        )
        findings += said
        for test in pooled.homogeneity if pooled else ():
            if pooled and test.key in own:
                found.setdefault(own[test.key], []).append(_unit_logs(pooled, test, unit))
    return found, tuple(findings)


def _packed(
    store: FleetStore, logs: Mapping[str, FleetLog]
) -> Iterator[tuple[tuple[str, str, str, str], list[bytes]]]:
    """Yield the packed bins of units with several logs, by model, sensor, axis and unit."""
    batches = _batches(logs)
    for frame in store.bins_in_turn(batches) if batches else ():
        found: dict[tuple[str, str, str, str], list[bytes]] = {}
        for row in frame.iter_rows(named=True):
            log = logs[row["key"]]
            if row["bins"] is not None:
                place = (log.model, row["sensor"], row["axis"], log.unit or "")
                found.setdefault(place, []).append(row["bins"])
        yield from ((place, every) for place, every in sorted(found.items()) if len(every) > 1)


def _batches(logs: Mapping[str, FleetLog]) -> list[list[str]]:
    """Return the logs that count of units with several, some units at a time."""
    keys: dict[tuple[str, str], list[str]] = {}
    for key, log in logs.items():
        if log.counts:
            keys.setdefault((log.model, log.unit or ""), []).append(key)
    batches: list[list[str]] = []
    for own in (own for _, own in sorted(keys.items()) if len(own) > 1):
        if batches and len(batches[-1]) < _AT_ONCE:
            batches[-1].extend(own)
        else:
            batches.append(own)
    return batches


def _pooled(packed: Sequence[bytes], symbols: tuple[str, ...], sensor: Sensor) -> PooledFit:
    every = [unpack(data) for data in packed]
    first = every[0].tau0
    rates = sorted({f"{1 / one.tau0:.6g} Hz" for one in every if abs(one.tau0 / first - 1) > _SAME_RATE})
    if rates:
        msg = f"found rates of {1 / first:.6g} Hz and {', '.join(rates)}, expected one"
        raise DataError(msg)
    return pool_bins(every, symbols, sensor=sensor, rate_hz=1 / first, level=_LEVEL)


def _unit_logs(pooled: PooledFit, test: Homogeneity, unit: str) -> UnitLogs:
    joint = pooled[test.key]
    return UnitLogs(
        unit=unit,
        logs=pooled.records,
        p_value=test.p_value,
        differs=test.differs,
        spread=test.spread,
        value=joint.value,
        low=joint.low,
        high=joint.high,
    )


def symbol_of(term: str) -> str:
    """Return ``GM`` of ``GM2``."""
    return term.rstrip("0123456789")


#: The bound that is near enough, and the most units that are thought of.
NEAR = 1.1
_MOST = 10_000


def tolerance_excess(units: int, spread: float, *, content: float = 0.95, confidence: float = 0.95) -> float:
    """Return the median bound of `units` units over the quantile that it bounds: what more units would buy.

    Parameters
    ----------
    units
        At least 2.
    spread
        Standard deviation tau between units, in the logarithm.
    content, confidence
        Of the bound.

    Notes
    -----
    Where units are known well, the bound is k deviations above the mean in the logarithm, and the quantile z:
    exp(tau (k - z)) is the price of having tested so few units.

    Source: Krishnamoorthy & Mathew (2009), Statistical Tolerance Regions, eq. (2.2.3): k is a quantile of the
    noncentral t law.
    """
    from scipy.special import nctdtrit, ndtri

    z = float(ndtri(content))
    root = math.sqrt(units)
    factor = float(nctdtrit(units - 1, z * root, confidence)) / root
    return math.exp(spread * (factor - z))


def _prices(found: Population) -> tuple[tuple[int, float], ...]:
    """Return numbers of units with what they cost: these, twice as many, and those that come near enough.

    Empty where the spread between units is not known.
    """
    if found.spread is None:
        return ()
    n = len(found.units)
    excess = partial(
        tolerance_excess, spread=found.spread.value, content=found.content, confidence=found.confidence
    )
    wanted = {n, 2 * n}
    if excess(n) > NEAR >= excess(_MOST):
        low, high = n, _MOST
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if excess(middle) <= NEAR else (middle, high)
        wanted.add(high)
    return tuple((units, excess(units)) for units in sorted(wanted))


Row = Mapping[str, Any]


def load_fleet(
    folder: str | Path, *, content: float = 0.95, confidence: float = 0.95, unit_logs: bool = True
) -> Fleet:
    """Return what the logs of a fleet say of each sensor model.

    Parameters
    ----------
    folder
        Where ``imucal fleet run`` keeps a fleet.
    content, confidence
        Of the tolerance bounds: a share `content` of all units with probability `confidence`.
    unit_logs
        Whether to test if several logs of a unit have one coefficient, which takes the most time.

    Raises
    ------
    ReadError
        If there is no fleet, or it can't be read.
    DataError
        If none of its logs was done, or some by a version that did not keep enough.
    """
    store = FleetStore(folder)
    # A copy of another log is counted with it.
    asked = store.manifest()["copy_of"].null_count()
    logs = {row["key"]: _log(row) for row in store.logs().iter_rows(named=True)}
    if not logs:
        msg = f"{folder}: found {asked} logs and none done, expected some; run the fleet first"
        raise DataError(msg)
    results = store.results()
    _refuse_old(folder, results)
    groups = _grouped(results, logs)
    tests, findings = _unit_tests(store, logs, groups) if unit_logs else ({}, ())
    models = []
    for name in sorted({log.model for log in logs.values() if log.counts}):
        own = tuple(log for log in logs.values() if log.model == name and log.unit is not None)
        terms = [
            _term(key, rows, tests.get(key, ()), content, confidence)
            for key, rows in groups.items()
            if key[0] == name
        ]
        models.append(_model(name, own, terms))
    loose = _loose(results, logs)
    return Fleet(
        folder=Path(folder),
        models=_judged_together(models),
        logs=tuple(logs.values()),
        asked=asked,
        loose=loose,
        labels=labels_to_type([one.log.path for one in loose]) if loose else "",
        findings=findings,
        version=__version__,
    )


def labels_to_type(paths: Sequence[str]) -> str:
    """Return a text of labels that tells a unit for each path: the last folder that differs, or the name."""
    parts = [path.replace("\\", "/").split("/") for path in paths]
    suffixes = {PurePosixPath(names[-1]).suffix for names in parts}
    suffix = suffixes.pop() if len(suffixes) == 1 else ""
    folders = {names[-2] if len(names) > 1 else "" for names in parts}
    if len(folders) > 1 and "" not in folders:
        return f"{{unit}}/*{suffix}"
    return f"{{unit}}{suffix}"


def _model(name: str, logs: tuple[FleetLog, ...], terms: Sequence[FleetTerm]) -> SensorModel:
    rates = sorted(log.rate_hz for log in logs if log.rate_hz)
    sensors, symbols = list(Sensor), list(TERMS)

    def place(term: FleetTerm) -> tuple[int, int, str, str]:
        return sensors.index(term.sensor), symbols.index(term.symbol), term.term, term.axis

    return SensorModel(
        name=name,
        units=tuple(sorted({log.unit for log in logs if log.unit and log.counts})),
        logs=logs,
        rate_hz=rates[len(rates) // 2] if rates else math.nan,
        terms=tuple(sorted(terms, key=place)),
    )


def _judged_together(models: Sequence[SensorModel]) -> tuple[SensorModel, ...]:
    """Return models judged over all of their terms: what is rare in one of many terms is none of these."""
    every = [term for model in models for term in model.terms]
    moved = iter(adjust([term.trend for term in every if term.trend]))
    tests = [test for term in every for test in term.unit_logs]
    chances = iter(adjusted(np.array([test.p_value for test in tests])).tolist())

    def judged(term: FleetTerm) -> FleetTerm:
        return replace(
            term,
            trend=next(moved) if term.trend else None,
            unit_logs=tuple(replace(test, differs=next(chances) <= FALSE_SHARE) for test in term.unit_logs),
        )

    return tuple(replace(model, terms=tuple(map(judged, model.terms))) for model in models)


def _log(row: Row) -> FleetLog:
    status, verdict = row["status"], row["verdict"] or ""
    # Reasons are grouped: the path, which they begin with, is none.
    left_out = (row["reason"] or status).removeprefix(f"{row['path']}: ") if status != "ok" else ""
    findings = tuple(row["findings"] or ())
    if not left_out and verdict in ("not-noise", "empty"):
        left_out = f"not noise at rest: {', '.join(findings) or verdict}"
    told = {name: row[name] for name in ("unit", "temperature_c", "started", "seconds", "rate_hz")}
    told |= {name: row[name] or "" for name in ("path", "model", "status", "reason", "verdict", "report")}
    return FleetLog(**told, findings=findings, left_out=left_out)


def _grouped(results: "pl.DataFrame", logs: Mapping[str, FleetLog]) -> dict[TermKey, "pl.DataFrame"]:
    """Return the rows of results that count, by model, sensor, axis and term."""
    import polars as pl

    counted = {key: log.model for key, log in logs.items() if log.counts}
    models = pl.DataFrame(list(counted.items()), schema={"key": pl.String, "model": pl.String}, orient="row")
    rows = results.drop("model").join(models, on="key", how="inner", maintain_order="left")
    found = rows.partition_by("model", "sensor", "axis", "term", as_dict=True, maintain_order=True)
    return {(str(key[0]), str(key[1]), str(key[2]), str(key[3])): rows for key, rows in found.items()}


def _value(row: Row, unit: str) -> LogValue:
    told = {field.name: row[field.name] for field in fields(LogValue) if field.name != "unit"}
    # A term without a square has none that could grow.
    told["variance_growth"] = told["variance_growth"] or 0.0
    return LogValue(unit=unit, **told)


def _refuse_old(folder: str | Path, results: "pl.DataFrame") -> None:
    """Refuse squares whose deviations follow the draws: their mean would be too low, and nothing would show.

    Raises
    ------
    DataError
        If there are any.
    """
    old = results.filter(results["variance"].is_not_null() & results["variance_growth"].is_null())
    if old.height:
        logs = old["key"].n_unique()
        msg = (
            f"{folder}: found {logs} log{'s' * (logs > 1)} done by an earlier version, which did not keep "
            "how the error of a term grows with it; run the fleet again with --fresh"
        )
        raise DataError(msg)


def _term(
    key: TermKey, rows: "pl.DataFrame", tests: Sequence[UnitLogs], content: float, confidence: float
) -> FleetTerm:
    _, sensor, axis, term = key
    logs = tuple(_value(row, row["unit"]) for row in rows.iter_rows(named=True))
    found = population(logs, content=content, confidence=confidence)
    moves, why = None, ""
    try:
        moves = trend(logs)
    except DataError as error:
        why = str(error)
    return FleetTerm(
        sensor=Sensor(sensor),
        axis=axis,  # type: ignore[arg-type]  # "x", "y" or "z", from a table
        term=term,
        logs=logs,
        population=found,
        trend=moves,
        no_trend=why,
        unit_logs=tuple(tests),
        price=_prices(found),
    )


def _loose(results: "pl.DataFrame", logs: Mapping[str, FleetLog]) -> tuple[LooseLog, ...]:
    values: dict[str, dict[tuple[str, str], LogValue]] = {
        key: {} for key, log in logs.items() if log.unit is None and not log.left_out
    }
    for row in results.iter_rows(named=True):
        if row["key"] in values:
            where = (f"{Sensor(row['sensor']).short}_{row['axis']}", row["term"])
            values[row["key"]][where] = _value(row, row["path"])
    return tuple(LooseLog(log=logs[key], values=found) for key, found in values.items())
