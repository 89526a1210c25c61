"""Arrays and data frames become named columns: axis of the samples, sampling rates, nested structures."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import scipy.io

from imucal.errors import ChoiceError, ReadError
from imucal.readers import read
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one
from imucal.readers.table import cells_of
from imucal.readers.tables.notes import Notes
from imucal.readers.tables.typed_table import _flatten, _of_array, _of_arrays, _plain, open_table
from tests.raising import raises
from tests.readers.tables.hdf5_logs import write_hdf5


def shapes(name: str, array: Any) -> list[tuple[str, int]]:  # noqa: ANN401 - an array
    """Return name and size of the columns of an array."""
    return [(column.name, column.values.size) for column in _of_array(name, np.asarray(array))]


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((5,), [("v", 5)]),
        ((5, 1), [("v", 5)]),
        ((1, 5), [("v", 5)]),
        ((5, 2), [("v[:,0]", 5), ("v[:,1]", 5)]),
        ((2, 5), [("v[:,0]", 5), ("v[:,1]", 5)]),
        ((3, 3), [("v[0]", 3), ("v[1]", 3), ("v[2]", 3)]),
        ((2, 2, 2), [(f"v[{i},{j}]", 2) for i in range(2) for j in range(2)]),
        ((), []),
        ((70, 65), []),
        ((65, 70), []),
        ((65, 64), [(f"v[:,{i}]", 65) for i in range(64)]),
        ((64, 65), [(f"v[:,{i}]", 65) for i in range(64)]),
    ],
)
def test_the_longer_dimension_of_a_matrix_contains_the_samples(
    shape: tuple[int, ...], expected: list[tuple[str, int]]
) -> None:
    """A matrix has up to 64 columns; a square matrix is not transposed."""
    assert shapes("v", np.zeros(shape)) == expected


def test_a_wide_matrix_is_transposed() -> None:
    """The rows of the matrix become columns; without a name of the matrix, columns have no names."""
    array = np.arange(10.0).reshape(2, 5)
    assert [column.values.tolist() for column in _of_array("v", array)] == array.tolist()
    assert [column.name for column in _of_array("", array)] == ["", ""]
    (alone,) = _of_array("v", np.arange(3.0)[:, None])
    assert alone.values.tolist() == [0.0, 1.0, 2.0]


def test_each_field_of_a_record_is_an_array() -> None:
    """The name of the record, if any, precedes the names of the fields."""
    table = np.zeros(4, dtype=[("t", "<i8"), ("gyro", "<f8", 3)])
    assert shapes("", table) == [("t", 4), ("gyro[0]", 4), ("gyro[1]", 4), ("gyro[2]", 4)]
    assert shapes("imu", table)[0] == ("imu.t", 4)


@pytest.mark.parametrize(
    ("name", "value", "rate"),
    [
        ("fs", np.array(250.0), 250.0),
        ("imu.Sample_Rate", np.array([[100]]), 100.0),
        ("fs", np.array(0.0), None),
        ("fs", np.array(-5), None),
        ("fs", np.array(np.inf), None),
        ("serial", np.array(17), None),
        ("fs", np.array([250.0, 250.0]), None),
    ],
)
def test_a_single_positive_number_named_as_a_rate_is_the_rate(
    name: str,
    value: Any,  # noqa: ANN401
    rate: float | None,
) -> None:
    """A single number is never a column."""
    table = _of_arrays("npz", {name: value, "gyro": np.zeros(9)})
    columns, found = table.columns, table.rate_hz
    assert found == rate
    assert [column.name for column in columns] == ([name] if value.size > 1 else []) + ["gyro"]


def test_a_single_text_is_a_column() -> None:
    table = _of_arrays("npz", {"fs": np.array(["250"])})
    assert ([column.name for column in table.columns], table.rate_hz) == (["fs"], None)


def test_the_names_of_navego_have_units() -> None:
    arrays = {"imu.fb": np.zeros((9, 3)), "imu.WB": np.zeros((9, 3)), "other": np.zeros(9)}
    assert [(column.name, column.unit) for column in _of_arrays("npz", arrays).columns[::3]] == [
        ("imu.fb.accelerometer[0]", "m/s^2"),
        ("imu.WB.gyroscope[0]", "rad/s"),
        ("other", None),
    ]


def nested(depth: int) -> Any:  # noqa: ANN401 - an array of structures
    """Return `depth` nested structures around three numbers."""
    value: Any = np.arange(3.0)
    for _ in range(depth):
        value = np.array((value,), dtype=[("a", object)])
    return value


def test_structures_of_matlab_are_flattened() -> None:
    """The limit is eight levels; texts are omitted."""
    for depth, names in ((0, ["x"]), (8, ["x" + ".a" * 8]), (9, [])):
        assert [name for name, _ in _flatten("x", nested(depth), Notes())] == names
    found: list[str] = []
    for name, value in (
        ("text", "abc"),
        ("cube", np.zeros((2, 2, 2))),
        ("flags", np.ones((2, 2), dtype=bool)),
    ):
        found += [label for label, _ in _flatten(name, value, Notes())]
    assert found == ["cube", "flags"]


def test_hidden_names_of_matlab_are_not_columns(tmp_path: Path) -> None:
    """The hidden names are the version and the header of the file."""
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"gyro": np.zeros((9, 3)), "rate": 100.0})
    found = open_table(path)
    assert [column.name for column in found.columns] == ["gyro[0]", "gyro[1]", "gyro[2]"]
    assert (found.format, found.rate_hz) == ("mat", 100.0)


@pytest.mark.parametrize(("at", "gaps"), [(0, True), (399, True), (400, False)])
def test_gaps_are_searched_in_the_first_400_rows(at: int, gaps: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """Rows without a value there belong to other sensors."""
    values = np.random.default_rng(3).normal(size=(500, 3))
    values[at] = np.nan
    path = save(tmp_path / "log.npz", t_ns=np.arange(500) * 10_000_000, gyro=values)
    found = read_one(path, ReadOptions(gyro_unit="rad/s")).series[0]
    assert (found.n, found.clock.missing if at else 0) == (499 if gaps else 500, int(gaps and at > 0))


def test_dates_and_durations_are_ns() -> None:
    for kind in "mM":
        column = _plain("v", np.array([5, 7], dtype=f"{kind}8[us]"))
        assert (column.values.tolist(), column.unit) == ([5000, 7000], "ns")
    assert _plain("v", np.zeros(5, dtype=np.int64)).unit is None


def test_cells_of_arrays_look_like_cells_of_a_text() -> None:
    """A missing value is an empty cell."""
    assert cells_of(np.array([1.5, np.nan, 2.0])) == ["1.5", "", "2.0"]
    assert cells_of(np.array(["a", None], dtype=object)) == ["a", ""]
    assert cells_of(np.arange(3)) == ["0", "1", "2"]


def test_lists_of_parquet_become_columns(tmp_path: Path) -> None:
    """The number of columns is that of the longest list, at most 64.

    A structure has a column for each field.
    """
    path = tmp_path / "log.parquet"
    lists = [[1.0, 2.0], [3.0], [4.0, 5.0, 6.0]]
    fields = [{"x": 1.0}, {"x": 2.0}, {"x": None}]
    wide = [[0.0] * 70] * 3
    pl.DataFrame({"g": lists, "s": fields, "w": wide, "n": [1, 2, 3]}).write_parquet(path)
    found = {column.name: column for column in open_table(path).columns}
    assert list(found) == ["g[0]", "g[1]", "g[2]", "s.x", *(f"w[{i}]" for i in range(64)), "n"]
    assert found["n"].values.tolist() == [1, 2, 3]
    assert {column.values.size for column in found.values()} == {3}
    for name, values in (("g[0]", [1, 3, 4]), ("g[1]", [2, np.nan, 5]), ("s.x", [1, 2, np.nan])):
        np.testing.assert_array_equal(found[name].values, values)


def save(path: Path, **arrays: Any) -> Path:  # noqa: ANN401
    """Write arrays into a file."""
    np.savez(path, **arrays)
    return path


def test_a_sensor_in_two_tables_requires_a_choice(tmp_path: Path) -> None:
    """The error names both tables, and each name works."""
    values = np.random.default_rng(1).normal(size=(60, 3))
    path = save(tmp_path / "log.npz", gyro=values, gyro_raw=values[:50], accel=values)
    options = ReadOptions(rate_hz=10.0, gyro_unit="rad/s", accel_unit="m/s^2")
    with pytest.raises(ChoiceError) as caught:
        read_one(path, options)
    assert str(caught.value) == (
        f"{path}: 2 topics carry IMU samples; choose one of these topics\n"
        "  60 rows  table  60 messages\n"
        "  50 rows  table  50 messages"
    )
    for n in (60, 50):
        found = read_one(path, replace(options, topics=(f"{n} rows",)))
        assert found.series[0].n == n


def test_a_columns_text_refers_to_the_widest_and_longest_table(tmp_path: Path) -> None:
    """The columns of other arrays have no numbers."""
    values = np.random.default_rng(1).normal(size=(50, 4))
    path = save(tmp_path / "log.npz", one=np.zeros(90), four=values, two=np.zeros((70, 2)))
    found = read_one(path, ReadOptions(columns="g=1:4", rate_hz=10.0, gyro_unit="rad/s"))
    np.testing.assert_array_equal([series.samples for series in found.series], values.T[1:])
    longer = np.random.default_rng(2).normal(size=(60, 4))
    path = save(tmp_path / "log.npz", four=values, more=longer)
    found = read_one(path, ReadOptions(columns="g=1:4", rate_hz=10.0, gyro_unit="rad/s"))
    np.testing.assert_array_equal([series.samples for series in found.series], longer.T[1:])


def test_tables_without_a_sensor_are_skipped(tmp_path: Path) -> None:
    """If none has a sensor, the error describes the widest table."""
    values = np.random.default_rng(1).normal(size=(50, 3))
    path = save(tmp_path / "log.npz", other=np.zeros(90), gyro=values)
    found = read_one(path, ReadOptions(rate_hz=10.0, gyro_unit="rad/s"))
    assert [series.name for series in found.series] == ["gyro_x", "gyro_y", "gyro_z"]
    path = save(tmp_path / "log.npz", other=np.zeros(90), more=np.zeros((70, 2)))
    with raises(ChoiceError, "found columns: 0 more", place="log.npz", argument="columns"):
        read_one(path, ReadOptions(rate_hz=10.0))


def test_numbers_as_texts_are_read(tmp_path: Path) -> None:
    """Texts that are not numbers are refused in the columns of a sensor."""
    values = np.random.default_rng(1).normal(size=50)
    columns = {
        "t_ns": np.arange(50) * 10_000_000,
        **{name: list(map(str, values)) for name in ("gx", "gy", "gz")},
    }
    path = tmp_path / "log.parquet"
    pl.DataFrame(columns).write_parquet(path)
    found = read_one(path, ReadOptions(gyro_unit="rad/s"))
    np.testing.assert_array_equal(found.series[0].samples, values)
    pl.DataFrame(columns | {"gy": ["wrong"] * 50}).write_parquet(path)
    with raises(
        ChoiceError, "column gy does not contain numbers: .*'wrong'", place="log.parquet", argument="columns"
    ):
        read_one(path, ReadOptions(gyro_unit="rad/s"))


@pytest.mark.parametrize("name", ["log.npz", "log.npy", "log.mat", "log.h5"])
def test_complex_columns_are_refused_by_their_type(name: str, tmp_path: Path) -> None:
    """NumPy would leave out the imaginary part."""
    path, values = tmp_path / name, np.ones((600, 3)) * 1j
    if name == "log.npz":
        np.savez(path, gyro=values)
    elif name == "log.npy":
        np.save(path, values)
    elif name == "log.mat":
        scipy.io.savemat(path, {"gyro": values})
    else:
        write_hdf5(path, {"gyro": values})
    with raises(ReadError, r"\(600, 3\) complex128", place=name):
        read(path)


def test_columns_that_can_be_read_next_to_complex_ones_are_read(tmp_path: Path) -> None:
    path = save(tmp_path / "log.npz", gyro=np.ones((600, 3)), spectrum=np.ones(600) * 1j)
    assert [column.name for column in open_table(path).columns] == ["gyro[0]", "gyro[1]", "gyro[2]"]


def test_values_without_bytes_are_refused_by_their_type(tmp_path: Path) -> None:
    """A file of a hundred bytes may declare any number of them."""
    path = save(tmp_path / "log.npz", gyro=np.zeros(10**9, dtype="V0"))
    with raises(ReadError, r"\(1000000000,\) void", place="log.npz"):
        read(path)


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    """The sizes are those of the archive's directory, so nothing is unpacked."""
    path = tmp_path / "log.npz"
    np.savez_compressed(path, gyro=np.zeros((4_000_000, 3)))
    with raises(ReadError, "96000128 bytes of arrays", place="log.npz"):
        open_table(path)
    save(path, **{f"a{i}": np.zeros(1) for i in range(4001)})
    with raises(ReadError, "4001 arrays", place="log.npz"):
        open_table(path)


def test_an_npy_file_is_not_mapped(tmp_path: Path) -> None:
    """If another process cut a mapped file, this one would be killed."""
    path = tmp_path / "log.npy"
    values = np.random.default_rng(1).normal(size=(600, 3))
    np.save(path, values)
    found = open_table(path)
    os.truncate(path, 0)
    np.testing.assert_array_equal(np.stack([column.values for column in found.columns], axis=1), values)
    np.save(path, values)
    os.truncate(path, path.stat().st_size - 8)
    with raises(ReadError, "14400 bytes and contains 14392", place="log.npy"):
        open_table(path)


def test_an_npy_file_longer_than_its_head_declares_is_damaged(tmp_path: Path) -> None:
    """The rows after inserted bytes are shifted."""
    path = tmp_path / "log.npy"
    np.save(path, np.random.default_rng(1).normal(size=(600, 3)))
    assert open_table(path).damage == ""
    with path.open("ab") as file:
        file.write(bytes(5))
    assert open_table(path).damage == "the array declares 14400 bytes and contains 14405"
    finding = read(path, rate_hz=100, columns="g=0:3", gyro_unit="rad/s").findings[0]
    assert (finding.level, finding.code) == ("warning", "damaged")
