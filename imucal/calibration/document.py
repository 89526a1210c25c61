"""`calibration.json`: the whole result in SI units, and the part that exports read back."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.calibration.frames import FRAMES, rotation_to
from imucal.calibration.parameters import Parameter, inverse, is_si
from imucal.calibration.result import AccelerometerResult, Calibration, CalibrationGrade, GyroscopeResult
from imucal.errors import Fix, ReadError
from imucal.findings import Finding
from imucal.recording import Source
from imucal.report.document import Finite
from imucal.report.typed_json import JsonObject, Key, Place, from_json, picked, to_json

__all__ = [
    "FILE_NAME",
    "SCHEMA",
    "CalibrationDocument",
    "Intrinsics",
    "from_document",
    "intrinsics_of",
    "load_document",
    "load_intrinsics",
    "schema",
    "to_document",
]

#: Name and number of the layout.
SCHEMA = "imucal/calibration/1"
#: Name of the file.
FILE_NAME = "calibration.json"
#: What to do about a wrong file.
_FIX = "run 'imucal calibrate' again"

Matrix: TypeAlias = Annotated[FloatArray, Key(shape=(3, 3))]
Vector: TypeAlias = Annotated[FloatArray, Key(shape=(3,))]


def to_document(found: Calibration) -> JsonObject:
    """Return a calibration as JSON values, SI; null for unknown values."""
    temperature = found.temperature and dict(zip(("mean", "low", "high"), found.temperature, strict=True))
    return {
        "schema": SCHEMA,
        "verdict": found.verdict,
        "source": picked(found.source, "path format topics message_types"),
        "gravity": to_json(found.gravity),
        "frame": found.frame,
        "log_frame": found.source.values.get("frame", ""),
        "accelerometer": _accelerometer(found.accelerometer),
        "gyroscope": found.gyroscope and _gyroscope(found.gyroscope),
        "temperature": to_json(temperature),
        "noise": {
            sensor: {"origin": base.origin, "models": [model.text() for model in base.models]}
            for sensor, base in found.noise.items()
        },
        "rests": to_json(found.rests),
        "turns": to_json(found.turns),
        "findings": [picked(each, "level code axis text advice") for each in found.findings],
    }


def _accelerometer(found: AccelerometerResult) -> JsonObject:
    names = "model C M b diagonal_C diagonal_b covariance chi2 dof p parameters excess suggestion"
    return picked(found, names)


def _gyroscope(found: GyroscopeResult) -> JsonObject:
    return picked(found, "scaled C M b G covariance_C chi2 dof p widening parameters")


def schema() -> JsonObject:
    """Return the JSON Schema of `calibration.json`."""
    text = files("imucal.calibration").joinpath("schema", "calibration-1.schema.json").read_text("utf-8")
    document: JsonObject = json.loads(text)
    return document


@dataclass(frozen=True, kw_only=True)
class GravityEntry:
    """The length of gravity in m/s²."""

    value: Finite


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorEntry:
    """What both sensors have: w = C (raw - b), and the parameters by name."""

    C: Matrix
    b: Vector
    parameters: Mapping[str, Parameter]


@dataclass(frozen=True, kw_only=True, eq=False)
class AccelerometerEntry(SensorEntry):
    """The accelerometer."""

    diagonal_C: Matrix
    diagonal_b: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class GyroscopeEntry(SensorEntry):
    """The gyroscope."""

    G: Matrix
    scaled: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class RestEntry:
    """A rest; `residual` is in m/s²."""

    mean_accel: Vector
    residual: Finite
    used: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class TurnEntry:
    """A turn; `residual_deg` has two or three components, or is None if the turn is not used."""

    residual_deg: FloatArray | None
    used: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationDocument:
    """The part of `calibration.json` that other commands read; attributes are keys."""

    verdict: CalibrationGrade
    source: Source
    gravity: GravityEntry
    frame: Annotated[str, Key(choices=tuple(FRAMES))]
    accelerometer: AccelerometerEntry
    gyroscope: GyroscopeEntry | None
    rests: tuple[RestEntry, ...]
    turns: tuple[TurnEntry, ...]
    findings: tuple[Finding, ...]
    log_frame: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Intrinsics(ReadOnlyArrays):
    """The part of a calibration that other programs need: f = C_a (raw - b_a), w = C_g (raw - b_g - G f).

    `diagonal_C` and `diagonal_b` are the best fit without misalignment. C_g is None if no turn could be used.
    `said_si` is whether both sensors are in SI units; None to judge by the matrices.
    `means`, shape (m, 3), are raw means of the used rests. `weak` are parameters that the log does not
    determine, or only weakly. `warnings` are codes of warnings and errors. `log_frame` is the frame in the
    messages of the log, empty if unknown.
    """

    source: str
    topics: tuple[str, ...]
    kind: str
    frame: str
    C_a: FloatArray
    b_a: FloatArray
    diagonal_C: FloatArray
    diagonal_b: FloatArray
    C_g: FloatArray | None
    b_g: FloatArray | None
    G: FloatArray | None
    gravity: float
    means: FloatArray
    said_si: bool | None = None
    weak: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    log_frame: str = ""

    @classmethod
    def of(cls, found: Calibration) -> "Intrinsics":
        return intrinsics_of(from_document(to_document(found)))

    def in_frame(self, frame: str) -> "Intrinsics":
        if frame == self.frame:
            return self
        R = rotation_to(frame, self.C_a)
        return replace(
            self,
            frame=frame,
            C_a=R @ self.C_a,
            C_g=None if self.C_g is None else R @ self.C_g,
            G=None if self.G is None else self.G @ R.T,
        )

    @property
    def si(self) -> bool:
        """Whether the raw samples are in m/s² and rad/s, and not counts."""
        if self.said_si is not None:
            return self.said_si
        return all(is_si(inverse(C)) for C in (self.C_a, self.C_g) if C is not None)


def load_intrinsics(path: Path) -> Intrinsics:
    """Read the intrinsics of a ``calibration.json`` or its folder, with the errors of `load_document`."""
    return intrinsics_of(load_document(path))


def load_document(path: Path) -> CalibrationDocument:
    """Read a ``calibration.json`` or its folder, or raise a ReadError."""
    file = path / FILE_NAME if path.is_dir() else path
    try:
        document = json.loads(file.read_bytes())
    except (OSError, ValueError) as error:
        raise ReadError(f"can't be read ({error})", place=file, fix=Fix(_FIX)) from error
    return from_document(document, file=str(file))


def from_document(document: object, *, file: str = "calibration") -> CalibrationDocument:
    """Return the entries of a JSON document; raises ReadError, with the name `file`, if one is wrong."""
    place = Place(file, _FIX)
    place.check_schema(document, SCHEMA)
    return from_json(CalibrationDocument, document, place)


def intrinsics_of(document: CalibrationDocument) -> Intrinsics:
    """Return the part of a calibration that other programs need."""
    accel, gyro = document.accelerometer, document.gyroscope
    sensors: dict[str, SensorEntry] = {"accel": accel}
    if gyro is not None:
        sensors["gyro"] = gyro
    units = {parameter.unit for entry in sensors.values() for parameter in entry.parameters.values()}
    weak = [
        f"{sensor} {name.replace('_', ' ')}"
        for sensor, entry in sensors.items()
        for name, parameter in entry.parameters.items()
        if parameter.status in {"weak", "not-observable"}
    ]
    return Intrinsics(
        source=document.source.name,
        topics=document.source.topics,
        kind=document.source.format,
        frame=document.frame,
        C_a=accel.C,
        b_a=accel.b,
        diagonal_C=accel.diagonal_C,
        diagonal_b=accel.diagonal_b,
        C_g=gyro.C if gyro is not None and gyro.scaled else None,
        b_g=None if gyro is None else gyro.b,
        G=None if gyro is None else gyro.G,
        gravity=document.gravity.value,
        means=np.array([rest.mean_accel for rest in document.rests if rest.used]),
        # The unit of a bias in raw counts.
        said_si="raw" not in units,
        weak=tuple(weak),
        warnings=tuple(dict.fromkeys(f.code for f in document.findings if f.level != "info")),
        log_frame=document.log_frame,
    )
