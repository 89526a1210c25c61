"""`thermal.json`: the whole result in SI units, and the part that exports and corrections read back."""

import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import Fix, ReadError
from imucal.findings import Finding
from imucal.recording import Source
from imucal.report.typed_json import JsonObject, Key, Place, from_json, to_json
from imucal.temperature.result import AxisThermal, Branch, Thermal, ThermalVerdict

__all__ = ["FILE_NAME", "SCHEMA", "ThermalDocument", "from_document", "load_thermal", "schema", "to_document"]

#: Name and number of the layout.
SCHEMA = "imucal/thermal/1"
#: Name of the file.
FILE_NAME = "thermal.json"
#: What to do about a wrong file.
_FIX = "run 'imucal thermal' again"
#: Temperatures at which the curve is written with its intervals.
_POINTS = 21


@dataclass(frozen=True, kw_only=True, eq=False)
class CurvePoints:
    """The curve of an axis at some steady temperatures, with the half-width of its 95 % intervals."""

    axis: str
    unit: str
    temperature: FloatArray
    bias: FloatArray
    half_width: FloatArray

    @classmethod
    def of(cls, axis: AxisThermal) -> "CurvePoints":
        temperature = np.linspace(axis.curve.low_c, axis.curve.high_c, _POINTS)
        return cls(
            axis=axis.name,
            unit=axis.sensor.unit,
            temperature=temperature,
            bias=axis.curve.static(temperature),
            half_width=axis.curve.half_width(temperature),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ThermalDocument:
    """`thermal.json`; attributes are keys."""

    schema: Annotated[str, Key(choices=(SCHEMA,))]
    verdict: ThermalVerdict
    source: Source
    low_c: float
    high_c: float
    fastest_k_per_s: float
    branches: tuple[Branch, ...]
    axes: tuple[AxisThermal, ...]
    points: tuple[CurvePoints, ...]
    findings: tuple[Finding, ...]


def to_document(found: Thermal) -> JsonObject:
    """Return a result as JSON values, SI; null for unknown values."""
    document: JsonObject = to_json(
        ThermalDocument(
            schema=SCHEMA,
            verdict=found.verdict,
            source=found.source,
            low_c=found.low_c,
            high_c=found.high_c,
            fastest_k_per_s=found.fastest_k_per_s,
            branches=found.branches,
            axes=found.axes,
            points=tuple(map(CurvePoints.of, found.axes)),
            findings=found.findings,
        )
    )
    return document


def from_document(document: object, *, file: str = "thermal") -> Thermal:
    """Return the result of a JSON document, without pictures; raise ReadError if it is wrong."""
    place = Place(file, _FIX)
    place.check_schema(document, SCHEMA)
    found = from_json(ThermalDocument, document, place)
    return Thermal(
        source=found.source,
        low_c=found.low_c,
        high_c=found.high_c,
        fastest_k_per_s=found.fastest_k_per_s,
        branches=found.branches,
        axes=found.axes,
        findings=found.findings,
    )


def load_thermal(path: Path) -> Thermal:
    """Read a ``thermal.json`` or its folder, or raise a ReadError."""
    file = path / FILE_NAME if path.is_dir() else path
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError) as error:
        raise ReadError(f"can't be read ({error})", place=file, fix=Fix(_FIX)) from error
    return from_document(document, file=str(file))


def schema() -> JsonObject:
    """Return the JSON Schema of `thermal.json`."""
    text = files("imucal.temperature").joinpath("schema", "thermal-1.schema.json").read_text("utf-8")
    document: JsonObject = json.loads(text)
    return document
