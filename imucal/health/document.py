"""A diagnosis as JSON, and as the cases that continuous integration reads."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Annotated

from imucal.checking.ci_files import Case, Outcome
from imucal.health.diagnosis import Diagnosis, Row, Status
from imucal.recording import Source
from imucal.report.typed_json import JsonObject, Key, to_json

__all__ = ["SCHEMA", "DoctorDocument", "FixEntry", "RowEntry", "cases_of", "schema", "to_document"]

SCHEMA = "imucal/doctor/1"
_OUTCOMES: dict[Status, Outcome] = {"pass": "pass", "warn": "skip", "unknown": "skip", "fail": "fail"}


@dataclass(frozen=True, kw_only=True)
class FixEntry:
    """The argument of `imucal.read`, and its value, that follows the advice."""

    argument: str
    value: str


@dataclass(frozen=True, kw_only=True)
class RowEntry:
    """The answer to one question."""

    name: str
    code: str
    status: Status
    found: str
    advice: str
    fix: FixEntry | None
    values: Mapping[str, object]

    @classmethod
    def of(cls, row: Row) -> "RowEntry":
        fix = FixEntry(argument=row.fix.argument, value=row.fix.value) if row.fix is not None else None
        return cls(
            name=row.name,
            code=row.code,
            status=row.status,
            found=row.found,
            advice=row.advice,
            fix=fix,
            values=row.values,
        )


@dataclass(frozen=True, kw_only=True)
class DoctorDocument:
    """doctor.json; attributes are keys."""

    schema: Annotated[str, Key(choices=(SCHEMA,))]
    version: str
    source: Source
    status: Status
    sentence: str
    rows: tuple[RowEntry, ...]


def to_document(diagnosis: Diagnosis) -> JsonObject:
    """Return a diagnosis as JSON values; numbers in SI, null if unknown."""
    document: JsonObject = to_json(
        DoctorDocument(
            schema=SCHEMA,
            version=diagnosis.version,
            source=diagnosis.source,
            status=diagnosis.status,
            sentence=diagnosis.sentence,
            rows=tuple(map(RowEntry.of, diagnosis.rows)),
        )
    )
    return document


def schema() -> JsonObject:
    """Return the JSON Schema of `doctor.json`."""
    text = files("imucal.health").joinpath("schema", "doctor-1.schema.json").read_text("utf-8")
    document: JsonObject = json.loads(text)
    return document


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
