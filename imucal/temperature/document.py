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
from imucal.recording import Axis, Sensor, Source
from imucal.report.typed_json import JsonObject, Key, Place, from_json, to_json
from imucal.temperature.curve import Curve, Kind
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
class CurveEntry:
    """A curve, and its values at some temperatures with the half-width of their 95 % intervals."""

    kind: Kind
    reference_c: float
    low_c: float
    high_c: float
    coefficients: FloatArray
    lag_s: float
    gradient: float
    temperature: FloatArray
    bias: FloatArray
    half_width: FloatArray

    @classmethod
    def of(cls, curve: Curve) -> "CurveEntry":
        temperature = np.linspace(curve.low_c, curve.high_c, _POINTS)
        return cls(
            kind=curve.kind,
            reference_c=curve.reference_c,
            low_c=curve.low_c,
            high_c=curve.high_c,
            coefficients=curve.coefficients,
            lag_s=curve.lag_s,
            gradient=curve.gradient,
            temperature=temperature,
            bias=curve.static(temperature),
            half_width=curve.half_width(temperature),
        )

    @property
    def curve(self) -> Curve:
        """The curve; the file does not contain its covariance."""
        return Curve(
            kind=self.kind,
            reference_c=self.reference_c,
            low_c=self.low_c,
            high_c=self.high_c,
            coefficients=self.coefficients,
            covariance=np.zeros((0, 0)),
            lag_s=self.lag_s,
            gradient=self.gradient,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisEntry:
    """One axis, as `AxisThermal` explains it."""

    sensor: Sensor
    axis: Axis
    unit: str
    curve: CurveEntry
    cubic: CurveEntry
    noise: float
    before: float
    left: float
    held_out: float | None
    cubic_held_out: float | None
    hysteresis: float | None
    hysteresis_left: float | None

    @classmethod
    def of(cls, axis: AxisThermal) -> "AxisEntry":
        return cls(
            sensor=axis.sensor,
            axis=axis.axis,
            unit=axis.sensor.unit,
            curve=CurveEntry.of(axis.curve),
            cubic=CurveEntry.of(axis.cubic),
            noise=axis.noise,
            before=axis.before,
            left=axis.left,
            held_out=axis.held_out,
            cubic_held_out=axis.cubic_held_out,
            hysteresis=axis.hysteresis,
            hysteresis_left=axis.hysteresis_left,
        )

    @property
    def thermal(self) -> AxisThermal:
        return AxisThermal(
            sensor=self.sensor,
            axis=self.axis,
            curve=self.curve.curve,
            cubic=self.cubic.curve,
            noise=self.noise,
            before=self.before,
            left=self.left,
            held_out=self.held_out,
            cubic_held_out=self.cubic_held_out,
            hysteresis=self.hysteresis,
            hysteresis_left=self.hysteresis_left,
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
    axes: tuple[AxisEntry, ...]
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
            axes=tuple(map(AxisEntry.of, found.axes)),
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
        axes=tuple(axis.thermal for axis in found.axes),
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
