"""The JSON Schema of doctor.json, written from the dataclasses of `imucal.health.document`.

    python -m tests.benchmarks.doctor_schema

Run it after a change of the dataclasses, or of the descriptions in `doctor_keys.toml`.
"""

import json
from pathlib import Path

import imucal
from imucal.health import document
from imucal.recording import Source
from tests.benchmarks.json_schema import Schema, SchemaWriter

__all__ = ["SCHEMA_FILE", "doctor_schema"]

SCHEMA_FILE = Path(imucal.__file__).parent / "health" / "schema" / "doctor-1.schema.json"

_WRITER = SchemaWriter.of(
    {"row": document.RowEntry, "fix": document.FixEntry, "source": Source}, file_name="doctor_keys.toml"
)
_ABOUT = (
    "doctor.json, and the output of imucal doctor --json. SI units; null for unknown values. Later versions "
    "may add keys, rows and values; a change that breaks a reader increases the number in schema."
)


def doctor_schema() -> Schema:
    """Return the schema of a diagnosis."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "imucal doctor",
        "description": _ABOUT,
        **_WRITER.object_schema(document.DoctorDocument, "DoctorDocument"),
        "$defs": _WRITER.definitions(),
    }


def main() -> None:
    """Write the schema."""
    SCHEMA_FILE.write_text(json.dumps(doctor_schema(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
