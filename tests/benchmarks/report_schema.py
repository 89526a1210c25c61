"""The JSON Schema of report.json, written from the dataclasses of `imucal.report.document`.

    python -m tests.benchmarks.report_schema

Run it after a change of the dataclasses, of the noise terms, or of the descriptions in `report_keys.toml`.
"""

import json
from pathlib import Path
from typing import Any

import imucal
from imucal.findings import Finding
from imucal.fitting.noise_fit import Goodness, Segments
from imucal.noise.terms import ALWAYS
from imucal.recording import Source
from imucal.report import document
from imucal.report.typed_json import hints_of
from tests.benchmarks.json_schema import Schema, SchemaWriter, chosen

__all__ = ["SCHEMA_FILE", "report_schema"]

SCHEMA_FILE = Path(imucal.__file__).parent / "report" / "schema" / "report-4.schema.json"

#: Name of a part of the schema -> its dataclass; docs/json.md has a table of the most important.
_PARTS: dict[str, Any] = {
    "finding": Finding,
    "quantity": document.QuantityEntry,
    "term": document.TermEntry,
    "curve": document.CurveEntry,
    "minimum": document.MinimumEntry,
    "spectrum": document.SpectrumEntry,
    "goodness": Goodness,
    "fit": document.FitEntry,
    "axis": document.AxisEntry,
    "source": Source,
    "segments": Segments,
    "filter_numbers": document.FilterEntry,
}
_WRITER = SchemaWriter.of(_PARTS, file_name="report_keys.toml")
#: A bounded term has no value.
_BOUNDED: Schema = {
    "if": {"properties": {"status": {"const": "bounded"}}},
    "then": {"properties": {"value": {"type": "null"}, "low": {"const": 0}}},
    "else": {"properties": {"value": {"type": "number"}}},
}
_ABOUT = (
    "report.json, and <axis>.json (the header keys and the entry of one axis). SI units; null for unknown "
    "values. Later versions may add keys; a change that breaks a reader increases the number in schema."
)


def report_schema() -> Schema:
    """Return the schema of the report and of the file of an axis."""
    keys = _WRITER.object_schema(document.Document, "report")["properties"]
    keys["schema"]["const"] = document.SCHEMA
    common = list(hints_of(document.Header))
    own = [name for name in keys if name not in common]
    parts = _WRITER.definitions()
    parts["term"] |= _BOUNDED
    parts["term"]["properties"]["alternatives"]["items"] = {"$ref": "#/$defs/term/properties/symbol"}
    parts["fit"]["properties"]["terms"]["required"] = list(ALWAYS)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "imucal report",
        "description": _ABOUT,
        "type": "object",
        **chosen(keys, common),
        "oneOf": [chosen(keys, own), {"allOf": [{"not": {"required": ["axes"]}}, {"$ref": "#/$defs/axis"}]}],
        "$defs": parts,
    }


def main() -> None:
    """Write the schema."""
    SCHEMA_FILE.write_text(json.dumps(report_schema(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
