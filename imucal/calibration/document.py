"""`calibration.json`: the whole result in SI units, and the part that exports read back."""

import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.calibration.frames import FRAMES, rotation_to
from imucal.calibration.parameters import Parameter, inverse, is_si
from imucal.calibration.result import AccelerometerResult, Calibration, GyroscopeResult
from imucal.errors import Fix, ReadError
from imucal.frozen import frozen_alone
from imucal.report.json_node import JsonObject, Node, picked, plain

__all__ = [
    "FILE_NAME",
    "SCHEMA",
    "Intrinsics",
    "load_calibration",
    "load_intrinsics",
    "schema",
    "to_document",
]

#: Name and number of the layout.
SCHEMA = "imucal/calibration/1"
#: Name of the file.
FILE_NAME = "calibration.json"


def to_document(found: Calibration) -> JsonObject:
    """Return a calibration as JSON values, SI; null for unknown values."""
    temperature = found.temperature and dict(zip(("mean", "low", "high"), found.temperature, strict=True))
    rest = "start_s end_s mean_accel mean_gyro up residual before sigma z used why"
    turn = "start_s end_s angle_deg known_deg residual_deg before_deg p used why"
    return {
        "schema": SCHEMA,
        "verdict": found.verdict,
        "source": picked(found.source, "path format topics message_types"),
        "gravity": picked(found.gravity, "value sigma origin"),
        "frame": found.frame,
        "accelerometer": _accelerometer(found.accelerometer),
        "gyroscope": found.gyroscope and _gyroscope(found.gyroscope),
        "temperature": plain(temperature),
        "noise": {
            sensor: {"origin": base.origin, "models": [model.text() for model in base.models]}
            for sensor, base in found.noise.items()
        },
        "rests": [picked(each, rest) for each in found.rests],
        "turns": [picked(each, turn) for each in found.turns],
        "findings": [picked(each, "level code axis text advice") for each in found.findings],
    }


def _accelerometer(found: AccelerometerResult) -> JsonObject:
    add = found.suggestion
    return {
        **picked(found, "model C M b diagonal_C diagonal_b covariance chi2 dof p"),
        "parameters": {name: _parameter(each) for name, each in found.parameters.items()},
        "excess": picked(found.excess, "tau kappa walk_share"),
        "suggestion": picked(add, "down text parameter ratio"),
    }


def _gyroscope(found: GyroscopeResult) -> JsonObject:
    return {
        **picked(found, "scaled C M b G covariance_C chi2 dof p widening"),
        "parameters": {name: _parameter(each) for name, each in found.parameters.items()},
    }


def _parameter(found: Parameter) -> JsonObject:
    return picked(found, "value low high unit status")


def schema() -> JsonObject:
    """Return the JSON Schema of `calibration.json`."""
    text = files("imucal.calibration").joinpath("schema", "calibration-1.schema.json").read_text("utf-8")
    document: JsonObject = json.loads(text)
    return document


@frozen_alone
class Intrinsics(ReadOnlyArrays):
    """The part of a calibration that other programs need: f = C_a (raw - b_a), w = C_g (raw - b_g - G f).

    `diagonal_C` and `diagonal_b` are the best fit without misalignment. C_g is None if no turn could be used.
    `said_si` is whether both sensors are in SI units; None to judge by the matrices.
    `means`, shape (m, 3), are raw means of the used rests. `weak` are parameters that the log does not
    determine, or only weakly. `warnings` are codes of warnings and errors.
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

    @classmethod
    def of(cls, found: Calibration) -> "Intrinsics":
        return _intrinsics(Node(plain(to_document(found)), "calibration"))

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
    """Read the intrinsics of a ``calibration.json`` or its folder, with the errors of `load_calibration`."""
    return _intrinsics(load_calibration(path))


def load_calibration(path: Path) -> Node:
    """Read a ``calibration.json`` or its folder, or raise a ReadError."""
    file = path / FILE_NAME if path.is_dir() else path
    try:
        root = Node(json.loads(file.read_bytes()), str(file))
    except (OSError, ValueError) as error:
        problem = f"can't be read ({error})"
        raise ReadError(problem, place=file, fix=Fix("run 'imucal calibrate' again")) from error
    root["schema"].text(SCHEMA)
    return root


def _intrinsics(root: Node) -> Intrinsics:
    accel, source = root["accelerometer"], root["source"]
    sensors = {"accel": accel}
    C_g = b_g = G = None
    if (gyro := root["gyroscope"]).value is not None:
        sensors["gyro"] = gyro
        C_g = gyro["C"].matrix(3) if gyro["scaled"].value else None
        b_g, G = gyro["b"].array(like=3), gyro["G"].matrix(3)
    weak = [
        f"{sensor} {name.replace('_', ' ')}"
        for sensor, node in sensors.items()
        for name in node["parameters"].table()
        if node["parameters"][name]["status"].text() in ("weak", "not-observable")
    ]
    return Intrinsics(
        source=source["path"].text().rstrip("/").rsplit("/", 1)[-1],
        topics=source["topics"].texts(),
        kind=source["format"].text(),
        frame=root["frame"].text(*FRAMES),
        C_a=accel["C"].matrix(3),
        b_a=accel["b"].array(like=3),
        diagonal_C=accel["diagonal_C"].matrix(3),
        diagonal_b=accel["diagonal_b"].array(like=3),
        C_g=C_g,
        b_g=b_g,
        G=G,
        gravity=root["gravity"]["value"].number(),
        means=np.array([rest["mean_accel"].array(like=3) for rest in root["rests"] if rest["used"].value]),
        said_si=all(node["parameters"]["bias_x"]["unit"].text() != "raw" for node in sensors.values()),
        weak=tuple(weak),
        warnings=tuple(
            dict.fromkeys(f["code"].text() for f in root["findings"] if f["level"].text() != "info")
        ),
    )
