"""Fleet <-> ``fleet.json`` and ``fleet.csv``: all numbers in SI, in one fixed order.

The layout is pinned by ``schema/fleet-1.schema.json``; a change that an old reader would misunderstand
raises the number.
"""

import csv
import io
import json
from collections.abc import Iterator
from importlib.resources import files

from imucal.findings import Finding
from imucal.fitting.noise_fit import Interval
from imucal.fleet_report.fleet_verdict import beyond_chance, verdict
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.report.document import plain

SCHEMA = "imucal/fleet/1"

_COLUMNS = (
    *("model", "sensor", "axis", "term", "unit_si", "unit", "logs", "value", "low", "high", "odd", "p_odd"),
    *("logs_differ", "median", "spread", "within", "prediction_low", "prediction_high", "tolerance"),
    *("median_low", "median_high", "bounded"),
)


def fleet_schema() -> dict[str, object]:
    """Return the JSON schema of ``fleet.json``."""
    text = files("imucal.fleet_report").joinpath("schema", "fleet-1.schema.json").read_text(encoding="utf-8")
    schema: dict[str, object] = json.loads(text)
    return schema


def fleet_document(fleet: Fleet) -> dict[str, object]:
    """Return a fleet as JSON values."""
    grade, text = verdict(fleet)
    sure = beyond_chance(fleet)
    return {
        "schema": SCHEMA,
        "version": fleet.version,
        "verdict": {"grade": grade, "text": text},
        "logs": {
            "asked": fleet.asked,
            "done": len(fleet.logs),
            "counted": sum(not log.left_out for log in fleet.logs),
        },
        "models": [_model(model, sure) for model in fleet.models],
        "failures": [
            {"kind": kind, "reason": reason, "logs": [log.path for log in logs]}
            for (kind, reason), logs in fleet.failures.items()
        ],
        "without_unit": {
            "labels": fleet.labels,
            "logs": [
                {
                    "path": one.log.path,
                    "values": [
                        {"axis": axis, "term": term, "value": v.value, "low": v.low, "high": v.high}
                        for (axis, term), v in one.values.items()
                    ],
                }
                for one in fleet.loose
            ],
        },
        "findings": [_finding(finding) for finding in fleet.findings],
    }


def fleet_json(fleet: Fleet) -> str:
    """Return the text of ``fleet.json``."""
    return json.dumps(fleet_document(fleet), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def fleet_csv(fleet: Fleet) -> str:
    """Return the text of ``fleet.csv``: a row a model, term, axis and unit, with its population beside it."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for model in fleet.models:
        for term in model.terms:
            rows.writerows(_rows(model, term))
    return text.getvalue()


def _rows(model: SensorModel, term: FleetTerm) -> Iterator[list[object]]:
    """Yield the row of each unit."""
    found = term.population
    tested = {one.unit: int(one.differs) for one in term.unit_logs}
    shared = [
        None if found.bounded else found.median.value,
        found.spread.value if found.spread else None,
        found.within.value if found.within else None,
        *(found.prediction or (None, None)),
        found.tolerance,
        found.median.low,
        found.median.high,
        int(found.bounded),
    ]
    for unit in found.units:
        yield [
            *(model.name, str(term.sensor), term.axis, term.term, term.unit, unit.unit, unit.logs),
            *(unit.value, unit.low, unit.high, int(unit.odd), unit.p_odd, tested.get(unit.unit)),
            *shared,
        ]


def _model(model: SensorModel, sure: set[tuple[int, str]]) -> dict[str, object]:
    return {
        "name": model.name,
        "units": list(model.units),
        "logs": sum(not log.left_out for log in model.logs),
        "rate_hz": plain(model.rate_hz),
        "terms": [_term(term, sure) for term in model.terms],
    }


def _term(term: FleetTerm, sure: set[tuple[int, str]]) -> dict[str, object]:
    found, trend = term.population, term.trend
    return {
        "sensor": str(term.sensor),
        "axis": term.axis,
        "term": term.term,
        "unit": term.unit,
        "logs": found.logs,
        "content": found.content,
        "confidence": found.confidence,
        "median": _limits(found.median) | ({"value": None} if found.bounded else {}),
        "bounded": found.bounded,
        "spread": _interval(found.spread),
        "within": _interval(found.within),
        "prediction": list(found.prediction) if found.prediction else None,
        "quantile": found.quantile,
        "tolerance": found.tolerance,
        "price": [{"units": units, "ratio": ratio} for units, ratio in term.price],
        "temperature_per_c": _interval(trend.temperature if trend else None),
        "drift_per_year": _interval(trend.drift if trend else None),
        "no_trend": term.no_trend,
        "units": [
            {
                "unit": unit.unit,
                "logs": unit.logs,
                "value": unit.value,
                "low": unit.low,
                "high": unit.high,
                "p_odd": unit.p_odd,
                "odd": unit.odd,
                "odd_overall": unit.odd and (id(term), unit.unit) in sure,
            }
            for unit in found.units
        ],
        "moves": [
            {"label": mean.label, "p_value": mean.p_value, "p_adjusted": mean.p_odd, "moves": mean.odd}
            for mean in (trend.means if trend else ())
        ],
        "slopes": [
            {
                "unit": slope.unit,
                "label": slope.label,
                **_limits(slope.slope),
                "p_odd": slope.p_odd,
                "odd": slope.odd,
            }
            for slope in (trend.slopes if trend else ())
        ],
        "unit_logs": [
            {
                "unit": one.unit,
                "logs": one.logs,
                "p_value": one.p_value,
                "differs": one.differs,
                "spread": one.spread,
                "value": one.value,
                "low": one.low,
                "high": one.high,
            }
            for one in term.unit_logs
        ],
        "findings": [_finding(finding) for finding in found.findings],
    }


def _interval(interval: Interval | None) -> dict[str, float | None] | None:
    return None if interval is None else _limits(interval)


def _limits(interval: Interval) -> dict[str, float | None]:
    return {"value": interval.value, "low": interval.low, "high": interval.high}


def _finding(finding: Finding) -> dict[str, object]:
    return {"level": finding.level, "code": finding.code, "axis": finding.axis, "text": finding.text}
