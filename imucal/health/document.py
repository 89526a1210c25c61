"""A diagnosis as JSON, and as the cases that continuous integration reads."""

from imucal.checking.ci_files import Case, Outcome
from imucal.health.diagnosis import Diagnosis, Status
from imucal.report.typed_json import JsonObject, to_json

__all__ = ["SCHEMA", "cases_of", "to_document"]

SCHEMA = "imucal/doctor/1"
_OUTCOMES: dict[Status, Outcome] = {"pass": "pass", "warn": "skip", "unknown": "skip", "fail": "fail"}


def to_document(diagnosis: Diagnosis) -> JsonObject:
    """Return a diagnosis as JSON values; numbers in SI, null if unknown."""
    rows = [
        {
            "name": row.name,
            "code": row.code,
            "status": row.status,
            "found": row.found,
            "advice": row.advice,
            "fix": None if row.fix is None else {"argument": row.fix.argument, "value": row.fix.value},
            "values": to_json(row.values),
        }
        for row in diagnosis.rows
    ]
    return {
        "schema": SCHEMA,
        "version": diagnosis.version,
        "source": to_json(diagnosis.source),
        "status": diagnosis.status,
        "sentence": diagnosis.sentence,
        "rows": rows,
    }


def cases_of(diagnosis: Diagnosis) -> tuple[Case, ...]:
    """Return a case for each row; warnings and what can't be told are skipped."""
    return tuple(
        Case(
            where="doctor",
            rule=row.name,
            text=row.text,
            outcome=_OUTCOMES[row.status],
            kind=row.status,
        )
        for row in diagnosis.rows
    )
