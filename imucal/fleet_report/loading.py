"""The store of a fleet -> Fleet: logs grouped by model and unit, and the statistics of each term."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from imucal._version import __version__
from imucal.errors import DataError
from imucal.fleet.population import FALSE_SHARE, adjusted, population
from imucal.fleet.store import FleetStore
from imucal.fleet.trend import Trend, adjust, trend
from imucal.fleet.values import LogValue
from imucal.fleet_report.sample_size import prices
from imucal.fleet_report.summary import Fleet, FleetLog, FleetTerm, LooseLog, SensorModel, UnitLogs
from imucal.fleet_report.unit_tests import TermKey, unit_tests
from imucal.noise.terms import TERMS
from imucal.recording import Sensor

if TYPE_CHECKING:
    import polars as pl

Row = Mapping[str, Any]

#: What a log whose record is not noise at rest is left out for.
_NOT_NOISE = "not noise at rest"


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
    tests, findings = unit_tests(store, logs, groups) if unit_logs else ({}, ())
    names = sorted({log.model for log in logs.values() if _counts(log)})
    models = []
    for name in names:
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


def _counts(log: FleetLog) -> bool:
    """Return whether the numbers of a log belong to a unit of a model."""
    return log.unit is not None and not log.left_out


def _model(name: str, logs: tuple[FleetLog, ...], terms: Sequence[FleetTerm]) -> SensorModel:
    rates = sorted(log.rate_hz for log in logs if log.rate_hz)
    return SensorModel(
        name=name,
        units=tuple(sorted({log.unit for log in logs if log.unit and _counts(log)})),
        logs=logs,
        rate_hz=rates[len(rates) // 2] if rates else math.nan,
        terms=tuple(sorted(terms, key=_place)),
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
        left_out = f"{_NOT_NOISE}: {', '.join(findings) or verdict}"
    return FleetLog(
        path=row["path"],
        model=row["model"] or "",
        unit=row["unit"],
        temperature_c=row["temperature_c"],
        started=row["started"],
        status=status,
        reason=row["reason"] or "",
        verdict=verdict,
        findings=findings,
        seconds=row["seconds"],
        rate_hz=row["rate_hz"],
        report=row["report"] or "",
        left_out=left_out,
    )


def _grouped(results: "pl.DataFrame", logs: Mapping[str, FleetLog]) -> dict[TermKey, "pl.DataFrame"]:
    """Return the rows of results that count, by model, sensor, axis and term."""
    import polars as pl

    counted = {key: log.model for key, log in logs.items() if _counts(log)}
    models = pl.DataFrame(list(counted.items()), schema={"key": pl.String, "model": pl.String}, orient="row")
    rows = results.drop("model").join(models, on="key", how="inner", maintain_order="left")
    found = rows.partition_by("model", "sensor", "axis", "term", as_dict=True, maintain_order=True)
    return {(str(key[0]), str(key[1]), str(key[2]), str(key[3])): rows for key, rows in found.items()}


def _value(row: Row, unit: str) -> LogValue:
    names = [field.name for field in fields(LogValue) if field.name != "unit"]
    told = {name: row[name] for name in names}
    # A term without a square has none that could grow.
    return LogValue(unit=unit, **told | {"variance_growth": told["variance_growth"] or 0.0})


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
    key: TermKey, rows: "pl.DataFrame", tests: tuple[UnitLogs, ...], content: float, confidence: float
) -> FleetTerm:
    _, sensor, axis, term = key
    logs = tuple(_value(row, row["unit"]) for row in rows.iter_rows(named=True))
    found = population(logs, content=content, confidence=confidence)
    moves, why = _trend(logs)
    return FleetTerm(
        sensor=Sensor(sensor),
        axis=axis,  # type: ignore[arg-type]  # "x", "y" or "z", from a table
        term=term,
        logs=logs,
        population=found,
        trend=moves,
        no_trend=why,
        unit_logs=tests,
        price=prices(found),
    )


def _trend(logs: Sequence[LogValue]) -> tuple[Trend | None, str]:
    try:
        return trend(logs), ""
    except DataError as error:
        return None, str(error)


def _place(term: FleetTerm) -> tuple[int, int, str, str]:
    sensors, symbols = list(Sensor), list(TERMS)
    return sensors.index(term.sensor), symbols.index(term.symbol), term.term, term.axis


def _loose(results: "pl.DataFrame", logs: Mapping[str, FleetLog]) -> tuple[LooseLog, ...]:
    values: dict[str, dict[tuple[str, str], LogValue]] = {
        key: {} for key, log in logs.items() if log.unit is None and not log.left_out
    }
    for row in results.iter_rows(named=True):
        if row["key"] in values:
            where = (f"{Sensor(row['sensor']).short}_{row['axis']}", row["term"])
            values[row["key"]][where] = _value(row, row["path"])
    return tuple(LooseLog(log=logs[key], values=found) for key, found in values.items())
