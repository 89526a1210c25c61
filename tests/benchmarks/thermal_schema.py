"""The JSON Schema of thermal.json, written from the dataclasses of `temperature.document`.

    python -m tests.benchmarks.thermal_schema

Run it after a change of the dataclasses, or of the descriptions in `thermal_keys.toml`.
"""

import json
from pathlib import Path

import imucal
from imucal.findings import Finding
from imucal.recording import Source
from imucal.temperature import document
from imucal.temperature.curve import Curve
from imucal.temperature.result import AxisThermal, Branch
from tests.benchmarks.json_schema import Schema, SchemaWriter

__all__ = ["SCHEMA_FILE", "thermal_schema"]

SCHEMA_FILE = Path(imucal.__file__).parent / "temperature" / "schema" / "thermal-1.schema.json"

_WRITER = SchemaWriter.of(
    {
        "axis": AxisThermal,
        "curve": Curve,
        "points": document.CurvePoints,
        "branch": Branch,
        "finding": Finding,
        "source": Source,
    },
    file_name="thermal_keys.toml",
)
_ABOUT = (
    "thermal.json, and the output of imucal thermal --json. SI units; null for unknown values. Later "
    "versions may add keys; a change that breaks a reader increases the number in schema."
)


def thermal_schema() -> Schema:
    """Return the schema of a temperature ramp."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "imucal thermal",
        "description": _ABOUT,
        **_WRITER.object_schema(document.ThermalDocument, "ThermalDocument"),
        "$defs": _WRITER.definitions(),
    }


def main() -> None:
    """Write the schema."""
    text = json.dumps(thermal_schema(), indent=2, ensure_ascii=False)
    SCHEMA_FILE.write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
