"""The JSON Schema of report.json, written from the dataclasses of `imucal.report.document`.

    python -m tests.benchmarks.report_schema

Run it after a change of the dataclasses, of the noise terms, or of the descriptions in `report_keys.toml`.
"""

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args, get_origin

import imucal
from imucal.arrays import FloatArray, IntArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Goodness, Segments
from imucal.noise.terms import ALWAYS
from imucal.recording import Source
from imucal.report import document
from imucal.report.typed_json import Key, choices_of, hints_of, is_optional, without_none

__all__ = ["SCHEMA_FILE", "report_schema"]

Schema: TypeAlias = dict[str, Any]

SCHEMA_FILE = Path(imucal.__file__).parent / "report" / "schema" / "report-4.schema.json"

_DESCRIPTIONS: dict[str, dict[str, str]] = tomllib.loads(
    Path(__file__).with_name("report_keys.toml").read_text(encoding="utf-8")
)
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
_NAMES = {kind: name for name, kind in _PARTS.items()}
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
    keys = _object(document.Document, "report")["properties"]
    keys["schema"]["const"] = document.SCHEMA
    common = list(hints_of(document.Header))
    own = [name for name in keys if name not in common]
    parts = {name: _object(kind, name) for name, kind in _PARTS.items()}
    parts["term"] |= _BOUNDED
    parts["term"]["properties"]["alternatives"]["items"] = {"$ref": "#/$defs/term/properties/symbol"}
    parts["fit"]["properties"]["terms"]["required"] = list(ALWAYS)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "imucal report",
        "description": _ABOUT,
        "type": "object",
        **_chosen(keys, common),
        "oneOf": [_chosen(keys, own), {"allOf": [{"not": {"required": ["axes"]}}, {"$ref": "#/$defs/axis"}]}],
        "$defs": parts,
    }


def _chosen(properties: Schema, names: list[str]) -> Schema:
    return {"required": names, "properties": {name: properties[name] for name in names}}


def _object(kind: Any, name: str) -> Schema:  # noqa: ANN401 - any dataclass
    """Return the schema of a dataclass with the descriptions below `name`."""
    descriptions = _DESCRIPTIONS.get(name, {})
    hints = hints_of(kind)
    if unknown := set(descriptions) - set(hints):
        raise ValueError(f"report_keys.toml describes {', '.join(unknown)}, which {name} does not have")
    properties = {}
    for key, hint in hints.items():
        description = {"description": descriptions[key]} if key in descriptions else {}
        properties[key] = description | _schema(hint)
    return {"type": "object", "required": list(properties), "properties": properties}


def _schema(hint: Any, key: Key = Key()) -> Schema:  # noqa: ANN401, B008 - any type; a key is immutable
    if get_origin(hint) is Annotated:
        return _schema(hint.__origin__, hint.__metadata__[0])
    if is_optional(hint):
        return _or_null(_schema(without_none(hint), Key(null=None)))
    if hint in _NAMES:
        return {"$ref": f"#/$defs/{_NAMES[hint]}"}
    if is_dataclass(hint):
        return _object(hint, hint.__name__)  # type: ignore[union-attr]
    if get_origin(hint) in {tuple, Mapping}:
        return _container(hint)
    return _simple(hint, key)


def _container(hint: object) -> Schema:
    inner = get_args(hint)
    if get_origin(hint) is Mapping:
        items: Schema = {} if inner[1] is object else {"additionalProperties": _schema(inner[1])}
        return {"type": "object"} | items
    sizes = {} if inner[-1] is ... else {"minItems": len(inner), "maxItems": len(inner)}
    return {"type": "array", "items": _schema(inner[0])} | sizes


def _or_null(schema: Schema) -> Schema:
    if "type" in schema:
        return schema | {"type": [schema["type"], "null"]}
    return {"anyOf": [schema, {"type": "null"}]}


def _simple(hint: Any, key: Key) -> Schema:  # noqa: ANN401 - any type
    if hint in (FloatArray, IntArray):
        return {"type": "array", "items": _simple(float if hint == FloatArray else int, key)}
    if hint in (float, int):
        number: Schema = {"type": "number" if hint is float else "integer"}
        limits = {"exclusiveMinimum": key.above, "exclusiveMaximum": key.below, "minimum": key.least}
        number |= {name: limit for name, limit in limits.items() if math.isfinite(limit)}
        return _or_null(number) if hint is float and key.null is not None else number
    choices = choices_of(hint, key)
    return {"enum": list(choices)} if choices else {"type": "string"}


def main() -> None:
    """Write the schema."""
    SCHEMA_FILE.write_text(json.dumps(report_schema(), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
