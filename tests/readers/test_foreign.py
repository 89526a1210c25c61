"""Unsupported formats: the error names the format and says what to do."""

import json
import lzma
import pickle
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers import describe, read
from tests.readers.tables.texts import N, truth

UNITS: dict[str, Any] = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}


def columns() -> dict[str, np.ndarray[Any, Any]]:
    names = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    both = np.column_stack([truth().gyro, truth().accel])
    return {"t_s": np.arange(N) / 100, **dict(zip(names, both.T, strict=True))}


def rows() -> list[dict[str, float]]:
    return pl.DataFrame(columns()).to_dicts()


def refused(path: Path) -> str:
    """Return the error message for a file, which is the same for `read` and `describe`."""
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


def is_truth(path: Path, **options: Any) -> None:  # noqa: ANN401 - options of any kind
    recording = read(path, **UNITS, **options)
    assert recording.series[0].rate_hz == pytest.approx(100)
    np.testing.assert_allclose(recording.axis("gyroscope", "y").samples, truth().gyro[:, 1], rtol=1e-12)
    np.testing.assert_allclose(recording.axis("accelerometer", "z").samples, truth().accel[:, 2], rtol=1e-12)


def write_pickle(path: Path) -> None:
    with path.open("wb") as file:
        pickle.dump(columns(), file)


def write_lines(path: Path, line: Callable[[Any], str]) -> None:
    path.write_text("".join(line(row) + "\n" for row in rows()), encoding="utf-8")


def write_long(path: Path, content: object) -> None:
    """Write JSON as one line that is longer than the part of a file that is examined."""
    path.write_text(json.dumps(content, separators=("," + " " * 300, ":")))


def objects() -> np.ndarray[Any, Any]:
    return np.column_stack(list(columns().values())).astype(object)


#: The writer of each file, and the format's name in the message.
WRITTEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "log.pkl": (
        write_pickle,
        "a Python pickle, which may run any program when it is loaded",
    ),
    "log.feather": (lambda path: pl.DataFrame(columns()).write_ipc(path), r"an Arrow \(Feather\) file"),
    "one log.json": (lambda path: path.write_text(json.dumps(rows())), "JSON in one piece"),
    "pretty.json": (lambda path: path.write_text(json.dumps(rows(), indent=1)), "JSON in one piece"),
    "lists.json": (
        lambda path: path.write_text(json.dumps({k: v.tolist() for k, v in columns().items()})),
        "JSON in one piece",
    ),
    "long rows.json": (lambda path: write_long(path, rows()), "JSON in one piece"),
    "long columns.json": (
        lambda path: write_long(path, {k: v.tolist() for k, v in columns().items()}),
        "JSON in one piece",
    ),
    "dicts.txt": (lambda path: write_lines(path, repr), "lines of Python dicts"),
    "dict.npy": (lambda path: np.save(path, np.array(columns(), dtype=object)), "an array of Python objects"),
    "array.npy": (lambda path: np.save(path, objects()), "an array of Python objects"),
    "objects.npz": (
        lambda path: np.savez(path, **{k: v.astype(object) for k, v in columns().items()}),  # type: ignore[arg-type]
        "arrays of Python objects; save them with numbers as dtype",
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_the_error_for_a_format_of_a_program_names_it(name: str, tmp_path: Path) -> None:
    """The file is written by the program that reads it."""
    write, what = WRITTEN[name]
    path = tmp_path / name
    write(path)
    assert re.search(f"it is {what}|not a readable NPZ file: it is {what}", refused(path))


def write_workbook(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/worksheets/sheet1.xml", "<worksheet/>")


def write_document(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")


#: First bytes of other formats, and a part of the message.
NAMED: dict[str, tuple[bytes, str]] = {
    "log.xls": (
        bytes.fromhex("d0cf11e0a1b11ae1"),
        "an old Excel workbook; export it as CSV, with a row",
    ),
    "LOG00001.BFL": (
        b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n",
        "a blackbox of Betaflight, INAV or Cleanflight; decode it with blackbox_decode, which writes a CSV",
    ),
    "log.tdms": (b"TDSm", "a TDMS file of National Instruments; export it as CSV"),
    "log.mtb": (b"\xfa\xff\x36", "Xsens' binary messages; open it in MT Manager and export it as ASCII"),
    "log.mip": (b"\x75\x65\x80", "MicroStrain's binary packets; export it as CSV from SensorConnect"),
    "log.gps": (b"\xaa\x44\x12", "NovAtel's binary messages; convert them to ASCII with NovAtel Convert"),
    "clip.mp4": (b"\0\0\0\x18ftypmp42", "a video; extract its telemetry as CSV"),
    "logs.7z": (b"7z\xbc\xaf\x27\x1c", "an archive; unpack it, and give the log in it"),
    "logs.tar": (b"a.csv".ljust(257, b"\0") + b"ustar", "an archive; unpack it"),
    "device.dat": (bytes(range(256)), "export it as CSV with the program of the device's maker"),
}


@pytest.mark.parametrize("name", NAMED)
def test_the_error_for_a_foreign_format_contains_a_solution(name: str, tmp_path: Path) -> None:
    start, text = NAMED[name]
    path = tmp_path / name
    path.write_bytes(start + bytes(range(256)) * 8)
    assert re.search(text, refused(path))
    with pytest.raises(ReadError, match=text):
        describe(path)


@pytest.mark.parametrize(
    "header", ["tau,adev", "taus;deviation", '"Averaging time [s]"\tadev', "tau(s),gyro_x"]
)
def test_an_allan_curve_is_refused(header: str, tmp_path: Path) -> None:
    """Also if the deviations have the name of a gyroscope axis, or the table is short."""
    path = tmp_path / "my curve.csv"
    mark = next(mark for mark in ",;\t" if mark in header)
    times = [0.01 * 2**k for k in range(12)]
    lines = [header, *(f"{t:.10g}{mark}{1e-3 / t**0.5:.10g}" for t in times)]
    path.write_text("\n".join(lines[:3]), encoding="utf-8")
    message = refused(path)
    assert "it is a table of Allan deviations; give the log from which it was computed" in message
    path.write_text("\n".join(lines), encoding="utf-8")
    assert refused(path) == message


def test_the_table_of_imucal_adev_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "curves.csv"
    rows = "".join(f"gyro_x,{t},{t},0.1,0.05,0.2,9\n" for t in (1, 2, 4))
    path.write_text(f"axis,tau,m,adev,low,high,edf\n{rows}", encoding="utf-8")
    assert refused(path).endswith("a table of imucal adev; give the log from which it was computed")


@pytest.mark.parametrize("write", [write_workbook, write_document])
def test_the_error_for_a_spreadsheet_advises_csv(write: Callable[[Path], None], tmp_path: Path) -> None:
    """The saved CSV is read, also with semicolons and decimal commas."""
    path = tmp_path / "log.xlsx"
    write(path)
    assert refused(path).endswith("export it as CSV, with a row for each sample")
    pl.DataFrame(columns()).write_csv(tmp_path / "log.csv")
    is_truth(tmp_path / "log.csv")
    text = (tmp_path / "log.csv").read_text().replace(",", ";").replace(".", ",")
    (tmp_path / "comma.csv").write_text(text)
    is_truth(tmp_path / "comma.csv")


def test_the_error_for_a_compressed_binary_log_advises_unpacking(tmp_path: Path) -> None:
    """The unpacked file is read."""
    path, plain = tmp_path / "log.parquet.xz", tmp_path / "log.parquet"
    pl.DataFrame(columns()).write_parquet(plain)
    path.write_bytes(lzma.compress(plain.read_bytes()))
    assert refused(path).endswith("xz of binary data; unpack it, and give the log in it")
    is_truth(plain)


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def write_matlab_object(path: Path, kind: str) -> None:
    """Write the bytes of ``T = table(...)`` in MATLAB, six numbers. Source: scipy.io (mxOPAQUE_CLASS)."""
    texts = b"".join(_element(1, text) for text in (b"T", b"MCOS", kind.encode()))
    numbers = np.array([0xDD000000, 2, 1, 1, 1, 1], dtype="<u4").tobytes()
    shape = _element(5, struct.pack("<ii", 6, 1)) + _element(1, b"")
    inner = _element(14, _element(6, struct.pack("<II", 13, 0)) + shape + _element(6, numbers))
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM"
    path.write_bytes(head + _element(14, _element(6, struct.pack("<II", 17, 0)) + texts + inner))


@pytest.mark.parametrize(
    ("kind", "way"),
    [
        ("table", "writetable(T, 'T.csv')"),
        ("timetable", "writetimetable(T, 'T.csv')"),
        ("timeseries", "writematrix([T.Time squeeze(T.Data)], 'T.csv')"),
        ("MyImu", "its arrays into separate variables, and save those"),
    ],
)
def test_objects_of_matlab_are_refused(kind: str, way: str, tmp_path: Path) -> None:
    """The six numbers of a MATLAB object must not be taken for sensor axes."""
    path = tmp_path / "log.mat"
    write_matlab_object(path, kind)
    assert refused(path) == f"{path}: T is a {kind}, which only MATLAB can read; in MATLAB type {way}"


def test_arrays_next_to_a_matlab_table_are_read_if_they_contain_a_sensor(tmp_path: Path) -> None:
    """If the arrays contain no sensor, the error contains both solutions."""
    path = tmp_path / "log.mat"
    import scipy.io

    scipy.io.savemat(path, {"robot": np.zeros((20, 2))})
    head = path.read_bytes()
    write_matlab_object(path, "table")
    path.write_bytes(head + path.read_bytes()[128:])
    with pytest.raises(ChoiceError, match=r"or T is a table, which only MATLAB.*writetable\(T, 'T\.csv'\)"):
        read(path)
    scipy.io.savemat(path, columns())
    head = path.read_bytes()
    write_matlab_object(path, "table")
    path.write_bytes(head + path.read_bytes()[128:])
    is_truth(path)
