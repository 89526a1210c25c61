"""Files of other programs with bias, scale and misalignment, and the noise numbers where they have both.

Formulas were read in the consumers' sources: Kalibr (imu models), OpenVINS (State::Dm), PX4
(Accelerometer.cpp), ArduPilot (AP_InertialSensor_Backend.cpp), DLIO (odom.cc), imu_calib (accel_calib.cpp),
Basalt (calib_bias.hpp), Fusion (FusionCalibration.h), imu_tk (calibration.h), MATLAB (accelparams,
gyroparams).
"""

import json
import tomllib
from collections.abc import Callable, Iterator, Sequence
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
from imucal.errors import DataError
from imucal.frozen import frozen
from imucal.printable import one_line
from imucal.report.exports import render as render_noise
from imucal.report.exports.config_numbers import DEFAULT_OPTIONS, ExportOptions
from imucal.report.exports.target import comment, name_key
from imucal.report.result import Report
from imucal.units import G0

__all__ = [
    "CALIBRATION_TARGETS", "CalibrationTarget", "export_calibration", "find_calibration_target",
    "render_calibration",
]  # fmt: skip

#: Topics whose samples a flight stack has corrected already.
_CORRECTED = {"sensor_combined", "vehicle_imu", "IMU", "RAW_IMU", "SCALED_IMU", "HIGHRES_IMU"}
_AXES = "XYZ"


@frozen
class CalibrationTarget:
    """One program: name, title, file, formulas, and the function that writes the text under the comment.

    `sign` starts a comment, or is ``json``. `frame` is the one the program needs, empty for any. `noise` is
    whether the file has noise numbers too. `uses` are the parts that it has a place for: ``G`` for
    g-sensitivity, ``gyro`` for scale and misalignment of the gyroscope, ``misalignment`` for that of the
    accelerometer.
    """

    name: str
    title: str
    file_name: str
    formulas: tuple[str, ...]
    body: Callable[[Intrinsics], str]
    sign: str = "#"
    frame: str = ""
    noise: bool = False
    uses: tuple[str, ...] = ("misalignment", "gyro")


def _targets() -> Iterator[tuple[str, CalibrationTarget]]:
    """Yield the programs of ``exports.toml`` by their names."""
    text = files("imucal.calibration").joinpath("exports.toml").read_text("utf-8")
    for name, own in tomllib.loads(text).items():
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in own.items()
        }
        yield name, CalibrationTarget(name=name, body=_BODIES[name], **values)


def find_calibration_target(name: str) -> CalibrationTarget:
    """Return a program by its name, whatever its case and hyphens; a ValueError lists those there are."""
    for target in CALIBRATION_TARGETS.values():
        if name_key(target.name) == name_key(name):
            return target
    raise ValueError(f"no calibration format {name!r}; choose one of {', '.join(CALIBRATION_TARGETS)}")


def render_calibration(
    found: Intrinsics, name: str, noise: Report | None = None, options: ExportOptions = DEFAULT_OPTIONS
) -> str:
    """Return the text of a program's file.

    Parameters
    ----------
    found
        The intrinsics.
    name
        A key of `CALIBRATION_TARGETS`.
    noise, options
        Report whose numbers go into the same file if the program has a place for both, and the options of
        `imucal.report.exports.export`.

    Raises
    ------
    DataError
        If the program needs something that the calibration lacks.
    ValueError
        If the name or an option is unknown.
    """
    target = find_calibration_target(name)
    found = found.in_frame(target.frame or found.frame)
    body, lines = target.body(found), list(_comment(target, found))
    if target.sign == "json":
        document = {"_imucal_calibration": lines, **json.loads(body)}
        if noise is not None and target.noise:
            own = json.loads(render_noise(noise, target.name, options))
            document = {**own, **document, "value0": {**own["value0"], **document["value0"]}}
        return json.dumps(document, indent=2) + "\n"
    head = comment(lines, target.sign)
    if noise is None or not target.noise:
        missing = f"{target.sign} no noise numbers: calibrate with --noise REPORT\n" if target.noise else ""
        start = ("%YAML:1.0\n", "imu0:\n") if target.name == "openvins" else ("", "")
        return f"{start[0]}{head}\n{missing}{start[1]}{body.rstrip()}\n"
    first = render_noise(noise, target.name, options)
    if target.name == "openvins":
        # The file of the noise ends with identity matrices.
        first = first[: first.index("  Tw:\n")]
        first = "\n".join(line for line in first.splitlines() if not line.startswith("# matrices:"))
    return f"{first.rstrip()}\n{head}\n{body.rstrip()}\n"


def export_calibration(
    found: Calibration,
    name: str,
    path: Path,
    noise: Report | None = None,
    options: ExportOptions = DEFAULT_OPTIONS,
) -> Path:
    """Write the text of `render_calibration` to a file, or into a folder; return the file."""
    target = find_calibration_target(name)
    text = render_calibration(Intrinsics.of(found), name, noise, options)
    return write_configs({target.file_name: text}, path)[0]


def _comment(target: CalibrationTarget, found: Intrinsics) -> Iterator[str]:
    """Yield the lines at the head of a file: source, formulas, and parts that the program lacks."""
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
    if "misalignment" not in target.uses:
        yield f"ignored misalignment: error up to {_ignored(found):.3g} m/s^2 in the attitudes of the log"
    if found.b_g is None:
        yield "no gyroscope in this calibration"
    elif found.C_g is None:
        yield "no usable turn: scale and misalignment of the gyroscope are unknown and set to 1 and 0"
    elif "gyro" not in target.uses:
        size = np.linalg.norm(found.C_g - np.eye(3), 2) if found.si else np.nan
        yield f"format has no gyroscope scale and misalignment: error up to {100 * size:.2g} % of the rate"
    if found.G is not None and found.G.any() and "G" not in target.uses:
        size = float(np.linalg.norm(found.G, 2)) * found.gravity
        unit = "rad/s" if found.si else "counts"
        yield f"format has no g-sensitivity: error up to {size:.2g} {unit} at 1 g"
    yield "biases are averages over this log; they differ after the next start"


def _ignored(found: Intrinsics) -> float:
    """Return the largest change of the specific force by a diagonal calibration, in m/s²."""
    full = (found.means - found.b_a) @ found.C_a.T
    return float(np.linalg.norm((found.means - found.diagonal_b) @ found.diagonal_C.T - full, axis=1).max())


def _gyro(found: Intrinsics) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return C_g, b_g and G; the identity and 0 where they are not known."""
    C = np.eye(3) if found.C_g is None else found.C_g
    b = np.zeros(3) if found.b_g is None else found.b_g
    return C, b, np.zeros((3, 3)) if found.G is None else found.G


def _split(C: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return L and Q of C⁻¹ = L Q: lower triangular with a positive diagonal, and a rotation."""
    Q, R = np.linalg.qr(inverse(C).T)
    signs = np.sign(np.diag(R))
    return np.asarray(R.T * signs), np.asarray((Q * signs).T)


def _list(values: FloatArray, opened: str = "[]") -> str:
    return f"{opened[0]}{', '.join(map(repr, (values.ravel() + 0.0).tolist()))}{opened[1]}"


def _rows(values: FloatArray, opened: str = "[]") -> str:
    """Return a vector, or a matrix as a list of its rows."""
    if values.ndim == 1:
        return _list(values, opened)
    return f"{opened[0]}{', '.join(_list(row, opened) for row in values)}{opened[1]}"


def _yaml(names: Sequence[tuple[str, FloatArray]], indent: str) -> str:
    """Return matrices as YAML lists of rows, which Kalibr and OpenVINS read."""
    return "".join(
        f"{indent}{name}:\n" + "".join(f"{indent}  - {_list(row)}\n" for row in matrix)
        for name, matrix in names
    )


def _kalibr(found: Intrinsics) -> str:
    C, _, G = _gyro(found)
    L, Q = _split(C)
    gyro = [("M", L), ("C_gyro_i", Q), ("A", G @ Q.T)]
    accel = _yaml([("M", inverse(found.C_a))], "  ")
    return f"model: scale-misalignment\naccelerometers:\n{accel}gyroscopes:\n{_yaml(gyro, '  ')}"


def _openvins(found: Intrinsics) -> str:
    C, _, G = _gyro(found)
    L, Q = _split(C)
    accel = [("Ta", inverse(found.C_a)), ("R_IMUtoACC", np.eye(3))]
    return _yaml([("Tw", L), ("R_IMUtoGYRO", Q), *accel, ("Tg", G)], "  ")


def _autopilot(found: Intrinsics, names: tuple[str, str, str], *, px4: bool) -> str:
    if not found.si:
        msg = (
            f"{found.source}: an autopilot corrects samples in m/s² and rad/s, but this log has counts; "
            "read it with --accel-scale and --gyro-scale"
        )
        raise DataError(msg)
    if wrong := sorted(_CORRECTED & {topic.partition("[")[0].strip("/") for topic in found.topics}):
        msg = (
            f"{found.source}: the autopilot has already corrected {', '.join(wrong)}; calibrate its raw "
            "samples, such as sensor_accel and sensor_gyro"
        )
        raise DataError(msg)
    values: dict[str, float] = {}
    for axis, scale, offset in zip(_AXES, np.diag(found.diagonal_C), found.diagonal_b, strict=True):
        values |= {names[0].format(axis): offset, names[1].format(axis): scale}
    if found.b_g is not None:
        values |= {names[2].format(axis): b for axis, b in zip(_AXES, found.b_g, strict=True)}
    shown = {name: format(Decimal(repr(float(value))), "f") for name, value in values.items()}
    lines = [f"{name} {value}" for name, value in shown.items()]
    tabs = [f"1\t1\t{name}\t{value}\t9" for name, value in shown.items()] if px4 else []
    return "\n".join([*tabs, *lines])


def _px4(found: Intrinsics) -> str:
    return _autopilot(found, ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF"), px4=True)


def _ardupilot(found: Intrinsics) -> str:
    return _autopilot(found, ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}", "INS_GYROFFS_{}"), px4=False)


def _dlio(found: Intrinsics) -> str:
    _, b, _ = _gyro(found)
    bias, sm = _list(found.C_a @ found.b_a), _list(found.C_a)
    return (
        "dlio:\n  imu:\n    calibration: false\n    intrinsics:\n"
        f"      accel:\n        bias: {bias}\n        sm: {sm}\n      gyro:\n        bias: {_list(b)}"
    )


def _imu_calib(found: Intrinsics) -> str:
    return f"SM: {_list(found.C_a)}\nbias: {_list(found.C_a @ found.b_a)}"


def _basalt(found: Intrinsics) -> str:
    C, b, _ = _gyro(found)
    S = found.C_a - np.eye(3)
    lower = [S[0, 0], S[1, 0], S[2, 0], S[1, 1], S[2, 1], S[2, 2]]
    values: dict[str, Any] = {
        "calib_accel_bias": [*(found.C_a @ found.b_a).tolist(), *map(float, lower)],
        "calib_gyro_bias": [*(C @ b).tolist(), *(C - np.eye(3)).T.ravel().tolist()],
    }
    return json.dumps({"value0": values})


def _fusion(found: Intrinsics) -> str:
    C, b, _ = _gyro(found)
    degree = np.degrees(1.0)
    # Fusion takes g and deg/s; counts stay counts and their scale changes.
    units = ((G0, G0), (1 / degree, 1 / degree)) if found.si else ((G0, 1.0), (1 / degree, 1.0))
    lines = []
    for sensor, M, offset, (unit, raw) in (
        ("accelerometer", found.C_a, found.b_a, units[0]),
        ("gyroscope", C, b, units[1]),
    ):
        scaled = M * (raw / unit)
        rows = ", ".join(_list(row, "{}") for row in scaled / np.diag(scaled))
        lines += [
            f"const FusionMatrix {sensor}Misalignment = {{.array = {{{rows}}}}};",
            f"const FusionVector {sensor}Sensitivity = {{.array = {_list(np.diag(scaled), '{}')}}};",
            f"const FusionVector {sensor}Offset = {{.array = {_list(offset / raw, '{}')}}};",
        ]
    return "\n".join(lines)


def _imu_tk(found: Intrinsics) -> str:
    C, b, _ = _gyro(found)
    parts = []
    for name, M, offset in (("acc", np.triu(found.C_a), found.b_a), ("gyro", C, b)):
        scale = np.diag(np.diag(M))
        blocks = [M / np.diag(M), scale, offset[:, None]]
        text = "\n\n".join("\n".join(" ".join(map(repr, row.tolist())) for row in block) for block in blocks)
        parts.append(f"# save the lines below as imu_{name}.calib\n{text}")
    return "\n\n".join(parts)


def _matlab(found: Intrinsics) -> str:
    C, b, G = _gyro(found)
    lines = []
    for name, M, offset in (("accel", found.C_a, found.b_a), ("gyro", C, b)):
        rows = "; ".join(", ".join(map(repr, row)) for row in (100 * inverse(M)).tolist())
        lines += [f"{name}.ConstantBias = {_list(offset)};", f"{name}.AxesMisalignment = [{rows}];"]
    lines.append(f"gyro.AccelerationBias = {_list(np.diag(G))};")
    return "\n".join([*lines, "imu.Accelerometer = accel;", "imu.Gyroscope = gyro;"])


def _matrices(found: Intrinsics) -> dict[str, FloatArray]:
    C, b, G = _gyro(found)
    return {"C_a": found.C_a, "b_a": found.b_a, "C_g": C, "b_g": b, "G": G}


def _own_yaml(found: Intrinsics) -> str:
    lines = ["calibration:"]
    lines += [f"  {name}: {_rows(values)}" for name, values in _matrices(found).items()]
    return "\n".join(lines)


_C_CODE = """
static void imucal_correct(const double raw_a[3], const double raw_g[3], double f[3], double w[3]) {
    for (int i = 0; i < 3; i++) {
        f[i] = 0;
        for (int j = 0; j < 3; j++) f[i] += C_a[i][j] * (raw_a[j] - b_a[j]);
    }
    for (int i = 0; i < 3; i++) {
        w[i] = 0;
        for (int j = 0; j < 3; j++)
            w[i] += C_g[i][j] * (raw_g[j] - b_g[j] - G[j][0] * f[0] - G[j][1] * f[1] - G[j][2] * f[2]);
    }
}
"""


def _c(found: Intrinsics) -> str:
    lines = []
    for name, values in _matrices(found).items():
        sizes = "".join(f"[{size}]" for size in values.shape)
        lines.append(f"static const double {name}{sizes} = {_rows(values, '{}')};")
    return "\n".join(lines) + _C_CODE


def _python(found: Intrinsics) -> str:
    return "\n".join(
        [
            "import numpy as np",
            "",
            *(f"{name} = np.array({_rows(values)})" for name, values in _matrices(found).items()),
            "",
            "",
            "def correct(raw_a, raw_g):",
            "    f = (raw_a - b_a) @ C_a.T",
            "    return f, (raw_g - b_g - f @ G.T) @ C_g.T",
        ]
    )


_BODIES: dict[str, Callable[[Intrinsics], str]] = {
    "kalibr": _kalibr, "openvins": _openvins, "px4": _px4, "ardupilot": _ardupilot, "dlio": _dlio,
    "imu-calib": _imu_calib, "basalt": _basalt, "fusion": _fusion, "imu-tk": _imu_tk, "matlab": _matlab,
    "yaml": _own_yaml, "c": _c, "python": _python,
}  # fmt: skip
#: Name of a program -> how its file is written.
CALIBRATION_TARGETS: dict[str, CalibrationTarget] = dict(_targets())
