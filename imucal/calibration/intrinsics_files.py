"""Read the calibration of an IMU from imucal or from another program: a file or folder -> Intrinsics.

Formulas: Kalibr (imu models, ``scale-misalignment``), OpenVINS (State::Dm), librealsense
(rs-imu-calibration.py and motion-transform.cpp), imu_tk (calibration.h: corrected = T K (raw - B)).
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.document import FILE_NAME, SCHEMA, Intrinsics, from_document, intrinsics_of
from imucal.errors import ChoiceError, Fix, ReadError
from imucal.units import G0

__all__ = ["load_calibration"]

#: Longest file of a calibration, in bytes: a calibration.json with 1000 rests has 1 MB.
_MAX_BYTES = 1 << 25
#: First line of a file that OpenCV reads as well; YAML 1.2 knows no such version.
_OPENCV = "%YAML:1.0"
_EXPECTED = (
    "expected calibration.json of imucal or librealsense, imu.yaml of Kalibr or OpenVINS, "
    "the two files of imu_tk, or imu_calibration.yaml of imucal"
)
#: Numbers in a file of imu_tk: T and K with nine, B with three.
_IMU_TK_NUMBERS = 21


def load_calibration(path: str | Path) -> Intrinsics:
    """Read a calibration of imucal, Kalibr, OpenVINS, librealsense or imu_tk.

    Parameters
    ----------
    path
        A calibration.json or its folder; a YAML file; or one of the two files of imu_tk, or their folder.

    Raises
    ------
    ReadError
        If it can't be read, or is no calibration.
    ChoiceError
        If a folder contains several calibrations.
    """
    place = Path(path)
    if place.is_dir():
        return _of_folder(place)
    text = _text_of(place)
    stripped = text.lstrip()
    if stripped.startswith("{"):
        return _of_json(place, text)
    if _is_imu_tk(text):
        return _of_imu_tk(place)
    return _of_yaml(place, text)


def _of_folder(folder: Path) -> Intrinsics:
    if (folder / FILE_NAME).is_file():
        return load_calibration(folder / FILE_NAME)
    accelerometers = sorted(folder.glob("*acc*.calib"))
    if len(accelerometers) == 1:
        return _of_imu_tk(accelerometers[0])
    if accelerometers:
        names = ", ".join(file.name for file in accelerometers)
        raise ChoiceError(f"found {names}, expected one; name the file", place=folder)
    raise ReadError(f"found no calibration in this folder; {_EXPECTED}", place=folder)


def _text_of(file: Path) -> str:
    try:
        if file.stat().st_size > _MAX_BYTES:
            raise ReadError(f"has more than {_MAX_BYTES >> 20} MB; {_EXPECTED}", place=file)
        return file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ReadError(f"is no text; {_EXPECTED}", place=file) from error
    except OSError as error:
        raise ReadError(f"can't be read: {error.strerror or error}", place=file) from error


def _of_json(file: Path, text: str) -> Intrinsics:
    try:
        document = json.loads(text)
    except ValueError as error:
        raise ReadError(f"is no JSON ({error}); {_EXPECTED}", place=file) from error
    if isinstance(document, dict) and "imus" in document:
        return _of_librealsense(file, document)
    if isinstance(document, dict) and str(document.get("schema", "")).startswith(SCHEMA.rpartition("/")[0]):
        return intrinsics_of(from_document(document, file=str(file)))
    raise ReadError(f"is no calibration; {_EXPECTED}", place=file)


def _of_librealsense(file: Path, document: Mapping[str, Any]) -> Intrinsics:
    """Return f = Sᵀ raw - bias: the file has S by rows, and the program multiplies rows from the left."""
    imus = document["imus"]
    if not isinstance(imus, list) or len(imus) != 1:
        count = len(imus) if isinstance(imus, list) else "no list"
        raise ReadError(f"imus: found {count}, expected one", place=file)
    matrices: dict[str, tuple[FloatArray, FloatArray]] = {}
    for sensor in ("accelerometer", "gyroscope"):
        entry = _at(file, imus[0] if isinstance(imus[0], Mapping) else {}, sensor)
        scale = _numbers(file, entry, f"imus[0].{sensor}.scale_and_alignment", (3, 3))
        bias = _numbers(file, entry, f"imus[0].{sensor}.bias", (3,))
        matrices[sensor] = scale.T, _inverse(file, scale.T) @ bias
    return _intrinsics(file, "librealsense", *matrices["accelerometer"], *matrices["gyroscope"])


def _of_yaml(file: Path, text: str) -> Intrinsics:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    plain = text.partition("\n")[2] if text.startswith(_OPENCV) else text
    try:
        document = YAML(typ="safe", pure=True).load(plain)
    except MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise ReadError(f"is no YAML ({error.problem}{line}); {_EXPECTED}", place=file) from error
    except (YAMLError, ValueError, RecursionError) as error:
        raise ReadError(f"is no YAML; {_EXPECTED}", place=file) from error
    if not isinstance(document, dict):
        raise ReadError(f"is no calibration; {_EXPECTED}", place=file)
    readers: dict[str, Callable[[Path, Mapping[str, Any]], Intrinsics]] = {
        "calibration": _of_plain,
        "accelerometers": _of_kalibr,
        "Ta": _of_openvins,
    }
    sections = [document, *(value for key, value in document.items() if str(key).startswith("imu"))]
    found = [
        (section, read)
        for section in sections
        if isinstance(section, dict)
        for key, read in readers.items()
        if key in section
    ]
    if len(found) == 1:
        section, read = found[0]
        return read(file, section)
    if not found:
        raise ReadError(
            "contains no scale and misalignment (Kalibr: accelerometers and gyroscopes of the model "
            f"scale-misalignment); {_EXPECTED}",
            place=file,
        )
    raise ChoiceError(f"contains {len(found)} IMUs, expected one; write one of them to a file", place=file)


def _of_plain(file: Path, document: Mapping[str, Any]) -> Intrinsics:
    """Return the numbers of ``imucal export --to yaml``."""
    entry = document["calibration"]
    shapes = {"C_a": (3, 3), "b_a": (3,), "C_g": (3, 3), "b_g": (3,), "G": (3, 3)}
    values = {name: _numbers(file, entry, f"calibration.{name}", shape) for name, shape in shapes.items()}
    return _intrinsics(file, "yaml", **values)


def _of_kalibr(file: Path, document: Mapping[str, Any]) -> Intrinsics:
    """Return the inverse of raw_a = M a, raw_g = M C_gyro_i w + A C_gyro_i a, without biases."""
    gyroscope = _at(file, document, "gyroscopes")
    M_a = _numbers(file, document["accelerometers"], "accelerometers.M", (3, 3))
    M_g = _numbers(file, gyroscope, "gyroscopes.M", (3, 3))
    turn = _numbers(file, gyroscope, "gyroscopes.C_gyro_i", (3, 3))
    A = _numbers(file, gyroscope, "gyroscopes.A", (3, 3)) if "A" in gyroscope else np.zeros((3, 3))
    none = np.zeros(3)
    return _intrinsics(
        file, "Kalibr, without biases", _inverse(file, M_a), none, _inverse(file, M_g @ turn), none, A @ turn
    )


def _of_openvins(file: Path, document: Mapping[str, Any]) -> Intrinsics:
    """Return a = R_IMUtoACCᵀ Ta⁻¹ raw_a, w = R_IMUtoGYROᵀ Tw⁻¹ (raw_g - Tg a), without biases."""
    values = {name: _numbers(file, document, name, (3, 3)) for name in ("Ta", "Tw")}
    turns = {
        name: _numbers(file, document, name, (3, 3)) if name in document else np.eye(3)
        for name in ("R_IMUtoACC", "R_IMUtoGYRO")
    }
    G = _numbers(file, document, "Tg", (3, 3)) if "Tg" in document else np.zeros((3, 3))
    none = np.zeros(3)
    C_a = turns["R_IMUtoACC"].T @ _inverse(file, values["Ta"])
    C_g = turns["R_IMUtoGYRO"].T @ _inverse(file, values["Tw"])
    return _intrinsics(file, "OpenVINS, without biases", C_a, none, C_g, none, G)


def _is_imu_tk(text: str) -> bool:
    words = text.split()
    try:
        return len(words) == _IMU_TK_NUMBERS and bool(np.isfinite(np.array(words, np.float64)).all())
    except ValueError:
        return False


def _of_imu_tk(file: Path) -> Intrinsics:
    """Return T K and B of the two files, whose names differ in ``acc`` and ``gyro``."""
    name = file.name
    if "gyro" in name:
        pair = file.with_name(name.replace("gyro", "acc")), file
    elif "acc" in name:
        pair = file, file.with_name(name.replace("acc", "gyro"))
    else:
        text = "the name contains neither 'acc' nor 'gyro', so the sensor is unknown"
        raise ReadError(text, place=file, fix=Fix("name the two files imu_acc.calib and imu_gyro.calib"))
    matrices = []
    for one in pair:
        text = _text_of(one)
        if not _is_imu_tk(text):
            raise ReadError(f"expected {_IMU_TK_NUMBERS} numbers, as in a file of imu_tk", place=one)
        numbers = np.array(text.split(), np.float64)
        matrices += [numbers[:9].reshape(3, 3) @ numbers[9:18].reshape(3, 3), numbers[18:]]
    return _intrinsics(file, "imu_tk", *matrices)


def _at(file: Path, table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = table.get(name)
    if not isinstance(found, Mapping):
        raise ReadError(f"{name} is missing, expected a table", place=file)
    return found


def _numbers(file: Path, table: Any, name: str, shape: tuple[int, ...]) -> FloatArray:  # noqa: ANN401 - any
    """Return finite numbers of a shape, also in one row; raises ReadError."""
    key = name.rpartition(".")[2]
    try:
        values = np.array(table[key], np.float64).reshape(shape)
    except (KeyError, TypeError, ValueError) as error:
        size = " x ".join(map(str, shape))
        raise ReadError(f"{name} is missing or wrong, expected {size} numbers", place=file) from error
    if not np.isfinite(values).all():
        raise ReadError(f"{name} contains a number that is not finite", place=file)
    return values


def _inverse(file: Path, matrix: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError as error:
        raise ReadError("contains a matrix without an inverse", place=file) from error


def _intrinsics(  # noqa: PLR0917 - the matrices in their usual order
    file: Path,
    kind: str,
    C_a: FloatArray,
    b_a: FloatArray,
    C_g: FloatArray,
    b_g: FloatArray,
    G: FloatArray | None = None,
) -> Intrinsics:
    for matrix in (C_a, C_g):
        _inverse(file, matrix)
    return Intrinsics(
        source=str(file),
        topics=(),
        kind=kind,
        frame="",
        C_a=C_a,
        b_a=b_a,
        diagonal_C=np.diag(np.diag(C_a)),
        diagonal_b=b_a,
        C_g=C_g,
        b_g=b_g,
        G=np.zeros((3, 3)) if G is None else G,
        gravity=G0,
        means=np.zeros((0, 3)),
    )
