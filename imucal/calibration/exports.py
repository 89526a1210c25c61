"""Files of other programs with bias, scale and misalignment, and the noise numbers if a file has both.

Formulas were read in the programs' sources: Kalibr (imu models), OpenVINS (State::Dm), PX4
(Accelerometer.cpp), ArduPilot (AP_InertialSensor_Backend.cpp), DLIO (odom.cc), Autoware
(imu_corrector_core.cpp), imu_calib (accel_calib.cpp), Basalt (calib_bias.hpp), Fusion (FusionCalibration.h),
imu_tk (calibration.h), MATLAB (accelparams, gyroparams).
"""

import json
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from imucal._version import __version__
from imucal.arrays import FloatArray
from imucal.atomic import write_configs
from imucal.calibration.document import Intrinsics
from imucal.calibration.frames import FRAMES
from imucal.calibration.parameters import inverse
from imucal.calibration.result import Calibration
from imucal.errors import ArgumentError, DataError, Fix
from imucal.printable import one_line
from imucal.report.exports import find_target
from imucal.report.exports.config_numbers import DEFAULT_OPTIONS, ExportOptions
from imucal.report.exports.target import comment, name_key, template
from imucal.report.result import Report
from imucal.units import G0

__all__ = [
    "CALIBRATION_TARGETS", "CalibrationTarget", "export_calibration", "find_calibration_target",
    "render_calibration",
]  # fmt: skip

#: Topics with samples that a flight stack has corrected.
_CORRECTED = {"sensor_combined", "vehicle_imu", "IMU", "RAW_IMU", "SCALED_IMU", "HIGHRES_IMU"}
_AXES = "XYZ"


@dataclass(frozen=True, kw_only=True)
class CalibrationTarget:
    """One program: name, title, file, formulas, and the template of the text under the comment.

    `sign` starts a comment, or is ``json``. `frame` is the one the program needs, empty for any. `uses` are
    the parts that it has a place for: ``G`` for g-sensitivity, ``gyro`` and ``misalignment`` for the two
    matrices. `parameters` are an autopilot's names of offsets, scales and offsets of the gyroscope.
    """

    name: str
    title: str
    file_name: str
    formulas: tuple[str, ...]
    text: str
    sign: str = "#"
    frame: str = ""
    noise: bool = False
    uses: tuple[str, ...] = ("misalignment", "gyro")
    parameters: tuple[str, ...] = ()


def _targets() -> Iterator[tuple[str, CalibrationTarget]]:
    text = files("imucal.calibration").joinpath("exports.toml").read_text("utf-8")
    for name, own in tomllib.loads(text).items():
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in own.items()
        }
        yield name, CalibrationTarget(name=name, **values)


def find_calibration_target(name: str) -> CalibrationTarget:
    """Return a program by its name, ignoring case and hyphens, or raise an ArgumentError."""
    for target in CALIBRATION_TARGETS.values():
        if name_key(target.name) == name_key(name):
            return target
    fix = Fix(f"choose one of {', '.join(CALIBRATION_TARGETS)}", "target")
    raise ArgumentError(f"no calibration format {name!r}", fix=fix)


def render_calibration(
    found: Intrinsics, name: str, noise: Report | None = None, options: ExportOptions = DEFAULT_OPTIONS
) -> str:
    """Return the text of the file of a program, a key of `CALIBRATION_TARGETS`.

    The numbers of the report `noise` go into the same file if the program has a place for both. A DataError
    is raised if the calibration lacks something, a ValueError for an unknown name or option.
    """
    target = find_calibration_target(name)
    found = found.in_frame(target.frame or found.frame)
    body, lines = _body(target, found), list(_comment(target, found))
    if target.sign == "json":
        document = {"_imucal_calibration": lines, **json.loads(body)}
        if noise is not None and target.noise:
            own = json.loads(find_target(target.name).render(noise, options))
            document = {**own, **document, "value0": {**own["value0"], **document["value0"]}}
        return json.dumps(document, indent=2) + "\n"
    head = comment(lines, target.sign)
    if noise is None or not target.noise:
        missing = f"{target.sign} no noise numbers: calibrate with --noise REPORT\n" if target.noise else ""
        start = ("%YAML:1.0\n", "imu0:\n") if target.name == "openvins" else ("", "")
        return f"{start[0]}{head}\n{missing}{start[1]}{body.rstrip()}\n"
    first = find_target(target.name).render(noise, options, calibrated=True)
    return f"{first.rstrip()}\n{head}\n{body.rstrip()}\n"


def export_calibration(
    found: Calibration,
    name: str,
    path: Path,
    noise: Report | None = None,
    options: ExportOptions = DEFAULT_OPTIONS,
) -> Path:
    """Write the text of `render_calibration` to a file, or into a folder."""
    target = find_calibration_target(name)
    text = render_calibration(Intrinsics.of(found), name, noise, options)
    return write_configs({target.file_name: text}, path)[0]


def _comment(target: CalibrationTarget, found: Intrinsics) -> Iterator[str]:
    yield f"{target.title}, written by imucal {__version__}"
    yield f"calibrated from {one_line(found.source)}, {len(found.means)} rests"
    yield "f = C_a (raw - b_a), w = C_g (raw - b_g - G f)"
    yield from (f"formula: {formula}" for formula in target.formulas)
    if "misalignment" in target.uses:
        yield f"frame: {FRAMES[found.frame]}"
    if not found.si:
        yield "raw samples are counts (or not in m/s^2 and rad/s): the program must use the same unit"
    if found.weak:
        yield f"determined weakly or not at all: {', '.join(found.weak)}"
    if found.warnings:
        yield f"read the calibration before you use these numbers; it warns of: {', '.join(found.warnings)}"
    if target.parameters and "misalignment" not in target.uses:
        yield f"ignored misalignment: error up to {_ignored(found):.3g} m/s^2 in the attitudes of the log"
    if found.b_g is None:
        yield "no gyroscope in this calibration"
    elif found.C_g is None:
        yield "no usable turn: scale and misalignment of the gyroscope are unknown and set to 1 and 0"
    elif "gyro" not in target.uses:
        size = np.linalg.norm(found.C_g - np.eye(3), 2) if found.si else np.nan
        yield f"format has no gyroscope scale and misalignment: error up to {100 * size:.2g} % of the rate"
    if found.G is not None and found.G.any() and "G" not in target.uses:
        yield from _ignored_sensitivity(found, found.G)
    yield "biases are averages over this log; they differ after the next start"


def _ignored_sensitivity(found: Intrinsics, G: FloatArray) -> Iterator[str]:
    size = float(np.linalg.norm(G, 2)) * found.gravity
    unit = "rad/s" if found.si else "counts"
    yield f"format has no g-sensitivity: error up to {size:.2g} {unit} at 1 g"
    bias = np.zeros(3) if found.b_g is None else found.b_g
    level = bias + G @ [0.0, 0.0, found.gravity]
    yield f"gyroscope bias of a vehicle that starts level, b_g + G [0 0 g]: {_list(level)} {unit}"


def _ignored(found: Intrinsics) -> float:
    """Return the largest change of the specific force by a diagonal calibration, in m/s²."""
    full = (found.means - found.b_a) @ found.C_a.T
    return float(np.linalg.norm((found.means - found.diagonal_b) @ found.diagonal_C.T - full, axis=1).max())


def _body(target: CalibrationTarget, found: Intrinsics) -> str:
    """Return the text below the comment, or raise a DataError."""
    C = np.eye(3) if found.C_g is None else found.C_g
    b = np.zeros(3) if found.b_g is None else found.b_g
    G = np.zeros((3, 3)) if found.G is None else found.G
    L, Q = _split(C)
    degree = np.degrees(1.0)
    # Fusion takes g and deg/s; counts stay counts.
    a_unit, g_unit = (G0, 1 / degree) if found.si else (1.0, 1.0)
    own = {"C_a": found.C_a, "b_a": found.b_a, "C_g": C, "b_g": b, "G": G}
    return template(target.text).render(
        **own, own=own, M_a=inverse(found.C_a), M_g=inverse(C), L=L, Q=Q,
        I=np.eye(3), upper=np.triu_indices(3),
        both=(("acc", np.triu(found.C_a), found.b_a), ("gyro", C, b)),
        sensors=(
            ("accelerometer", found.C_a, found.b_a, G0, a_unit),
            ("gyroscope", C, b, 1 / degree, g_unit),
        ),
        parameters=_parameters(target, found) if target.parameters else {},
        flat=_list, rows=_rows, yaml=_yaml,
    )  # fmt: skip


def _split(C: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return L and Q of C⁻¹ = L Q: lower triangular with a positive diagonal, and a rotation."""
    Q, R = np.linalg.qr(inverse(C).T)
    signs = np.sign(np.diag(R))
    return np.asarray(R.T * signs), np.asarray((Q * signs).T)


def _list(values: FloatArray, opened: str = "[]", between: str = ", ") -> str:
    return f"{opened[:1]}{between.join(map(repr, (values.ravel() + 0.0).tolist()))}{opened[1:]}"


def _rows(values: FloatArray, opened: str = "[]") -> str:
    if values.ndim == 1:
        return _list(values, opened)
    return f"{opened[0]}{', '.join(_list(row, opened) for row in values)}{opened[1]}"


def _yaml(matrix: FloatArray) -> str:
    """Return a matrix as a YAML list of rows, which Kalibr and OpenVINS read."""
    return "\n".join(f"    - {_list(row)}" for row in matrix)


def _parameters(target: CalibrationTarget, found: Intrinsics) -> dict[str, str]:
    if not found.si:
        raise DataError(
            "an autopilot corrects samples in m/s² and rad/s, but this log has counts",
            place=found.source,
            fix=Fix("read it with --accel-scale and --gyro-scale"),
        )
    if wrong := sorted(_CORRECTED & {topic.partition("[")[0].strip("/") for topic in found.topics}):
        raise DataError(
            f"the autopilot has already corrected {', '.join(wrong)}",
            place=found.source,
            fix=Fix("calibrate its raw samples, such as sensor_accel and sensor_gyro"),
        )
    offset, scale, turning = target.parameters
    values: dict[str, float] = {}
    for axis, factor, b in zip(_AXES, np.diag(found.diagonal_C), found.diagonal_b, strict=True):
        values |= {offset.format(axis): b, scale.format(axis): factor}
    if found.b_g is not None:
        values |= {turning.format(axis): b for axis, b in zip(_AXES, found.b_g, strict=True)}
    return {name: format(Decimal(repr(float(value))), "f") for name, value in values.items()}


#: Name of a program -> its target.
CALIBRATION_TARGETS: dict[str, CalibrationTarget] = dict(_targets())
