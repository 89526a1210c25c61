"""Parquet, NPZ, NPY and MAT: samples and stamps of arrays follow the rules of text tables."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import polars as pl
import pytest
import scipy.io

from imucal.errors import ChoiceError, ImucalError, ReadError
from imucal.readers import read as read_any
from imucal.readers.formats import describe_log as describe
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.recording import Recording, Sensor
from tests.raising import raises
from tests.readers.tables.hdf5_logs import write_hdf5
from tests.readers.tables.texts import EPOCH, N, truth

GYRO, ACCEL = truth().gyro, truth().accel
STAMPS = np.array(truth().ns, dtype=np.int64) + EPOCH


def named() -> dict[str, Any]:
    columns: dict[str, Any] = {"timestamp": STAMPS}
    columns |= {f"gyro_{axis}_rads": GYRO[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"accel_{axis}": ACCEL[:, i] for i, axis in enumerate("xyz")}
    return columns


def parquet(path: Path) -> None:
    pl.DataFrame(named()).write_parquet(path)


def parquet_dates(path: Path) -> None:
    stamp = pl.col("timestamp").cast(pl.Datetime("ns")).cast(pl.Datetime("us"))
    pl.DataFrame(named()).with_columns(stamp).write_parquet(path)


def parquet_lists(path: Path) -> None:
    pl.DataFrame({"timestamp": STAMPS, "gyro": GYRO.tolist(), "accel": ACCEL.tolist()}).write_parquet(path)


def parquet_arrays(path: Path) -> None:
    """Write lists of a fixed length, which are a separate type."""
    table = pl.DataFrame({"timestamp": STAMPS, "gyro": GYRO.tolist(), "accel": ACCEL.tolist()})
    table.with_columns(pl.col("gyro", "accel").list.to_array(3)).write_parquet(path)


def parquet_structs(path: Path) -> None:
    def rows(values: Any) -> list[dict[str, float]]:  # noqa: ANN401 - an array
        return [dict(zip("xyz", row, strict=True)) for row in values.tolist()]

    columns = {"stamp": STAMPS, "angular_velocity": rows(GYRO), "linear_acceleration": rows(ACCEL)}
    pl.DataFrame(columns).write_parquet(path)


def npz(path: Path) -> None:
    np.savez(path, t=STAMPS, gyro=GYRO, accel=ACCEL)


def npz_columns(path: Path) -> None:
    np.savez_compressed(path, **named())


def npz_lying(path: Path) -> None:
    np.savez(path, t=STAMPS, gyro=GYRO.T, accel=ACCEL.T, serial=np.array(17))


def npy_records(path: Path) -> None:
    table = np.zeros(N, dtype=[("time_ns", "<i8"), *((f"{s}{axis}", "<f8") for s in "ga" for axis in "xyz")])
    table["time_ns"] = STAMPS
    for i, axis in enumerate("xyz"):
        table[f"g{axis}"], table[f"a{axis}"] = GYRO[:, i], ACCEL[:, i]
    np.save(path, table)


def npy_dates(path: Path) -> None:
    table = np.zeros(N, dtype=[("time", "M8[ns]"), ("gyro", "<f8", 3), ("accel", "<f8", 3)])
    table["time"], table["gyro"], table["accel"] = STAMPS.view("M8[ns]"), GYRO, ACCEL
    np.save(path, table)


def mat(path: Path) -> None:
    scipy.io.savemat(path, {"stamp_ns": STAMPS, "gyro": GYRO, "accel": ACCEL})


def hdf5(path: Path) -> None:
    write_hdf5(path, {"stamp_ns": STAMPS, "gyro": GYRO, "accel": ACCEL})


WRITERS: tuple[tuple[str, Callable[[Path], None]], ...] = (
    ("log.parquet", parquet),
    ("dates.parquet", parquet_dates),
    ("lists.parquet", parquet_lists),
    ("arrays.parquet", parquet_arrays),
    ("structs.parquet", parquet_structs),
    ("log.npz", npz),
    ("columns.npz", npz_columns),
    ("lying.npz", npz_lying),
    ("records.npy", npy_records),
    ("dates.npy", npy_dates),
    ("log.mat", mat),
    ("log.hdf5", hdf5),
)


def check(recording: Recording) -> None:
    """Compare all samples with the truth, bit by bit."""
    for series in recording.series:
        true = GYRO if series.sensor is Sensor.GYROSCOPE else ACCEL
        npt.assert_array_equal(series.samples, true[:, "xyz".index(series.axis)])
    assert len(recording.series) == 6


@pytest.mark.parametrize(("name", "writer"), WRITERS, ids=[name for name, _ in WRITERS])
def test_samples_of_typed_tables_are_exact(name: str, writer: Callable[[Path], None], tmp_path: Path) -> None:
    """Stamps are integers. The result is the same through `imucal.read`."""
    path = tmp_path / name
    writer(path)
    recording = read(path, ReadOptions())
    check(recording)
    check(read_any(path))
    assert recording.source.format == path.suffix[1:]
    assert recording.series[0].rate_hz == pytest.approx(100)
    assert recording.series[0].clock.start_ns == EPOCH
    contents = describe(path, ReadOptions())
    assert (contents.topics[0].count, contents.start_ns) == (N, EPOCH)


def test_the_structure_of_navego_is_read(tmp_path: Path) -> None:
    """NaveGo has fb in m/s^2, wb in rad/s, t in s and freq in Hz."""
    path = tmp_path / "imu.mat"
    scipy.io.savemat(
        path, {"imu": {"t": np.array(truth().ns) * 1e-9, "fb": ACCEL, "wb": GYRO, "freq": 100.0}}
    )
    recording = read(path, ReadOptions())
    check(recording)
    assert recording.findings == ()


def test_a_rate_next_to_the_samples_is_used(tmp_path: Path) -> None:
    """The arrays have no stamps; the decision contains the source."""
    path = tmp_path / "log.npz"
    np.savez(path, gyro=GYRO, accel=ACCEL, fs=250.0)
    recording = read(path, ReadOptions())
    check(recording)
    assert recording.series[0].clock.source == "rate in the log"
    assert recording.series[0].rate_hz == 250.0


def test_arrays_of_two_lengths_are_two_tables(tmp_path: Path) -> None:
    """Each sensor has its own clock."""
    path = tmp_path / "log.npz"
    np.savez(path, gyro_t=STAMPS, gyro=GYRO, accel_t=STAMPS[::2], accel=ACCEL[::2])
    recording = read(path, ReadOptions(gyro_unit="rad/s"))
    assert [(s.n, round(s.rate_hz)) for s in recording.series if s.axis == "x"] == [(N, 100), (N // 2, 50)]
    npt.assert_array_equal(recording.axis("accelerometer", "z").samples, ACCEL[::2, 2])


def test_a_matrix_without_names_needs_a_columns_text(tmp_path: Path) -> None:
    path = tmp_path / "log.npy"
    np.save(path, np.column_stack([STAMPS * 1e-9, GYRO, ACCEL]))
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == (
        f"{path}: array (400, 7): the 7 columns have no names; found columns: 0 = 1.7e+09, 1 = "
        "0.00839614, 2 = -0.0226487, 3 = 0.00450328, 4 = 0.113276, 5 = -0.256524, 6 = 9.79787; "
        "name them in a columns text of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their numbers "
        "from 0)"
    )
    check(read(path, ReadOptions(columns="t=0,g=1:4,a=4:7")))


def test_rows_with_empty_cells_are_skipped(tmp_path: Path) -> None:
    """Rows with empty sensor cells belong to another topic."""
    path = tmp_path / "log.parquet"
    table = pl.DataFrame(named())
    other = pl.DataFrame({"timestamp": STAMPS + 3_000_000})
    pl.concat([table, other], how="diagonal").sort("timestamp").write_parquet(path)
    check(read(path, ReadOptions()))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("log.parquet", b"PAR1 and no more", "not a readable Parquet file"),
        ("log.npy", b"\x93NUMPY\x01\x00", "not a readable NPY file"),
        ("log.npz", b"PK\x03\x04 and no more", "not a readable NPZ file"),
        ("log.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "not a readable MAT file"),
        ("log.mat", b"\x89HDF\r\n\x1a\n" + bytes(8), "not a readable HDF5 file"),
        ("log.h5", b"\x89HDF\r\n\x1a\n" + bytes(800), "not a readable HDF5 file"),
    ],
)
def test_a_damaged_typed_table_is_refused(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    """The error contains the file name, and there is no traceback."""
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ReadError) as caught:
        read(path, ReadOptions())
    assert str(caught.value).startswith(f"{path}: {message}")


def test_pickled_objects_are_not_loaded(tmp_path: Path) -> None:
    """Loading an array of objects could run code."""
    path = tmp_path / "log.npz"
    np.savez(path, gyro=np.array([{"x": 1}] * 3, dtype=object))
    with raises(ReadError, "arrays of Python objects", place="log.npz"):
        read(path, ReadOptions())


def test_a_file_of_single_numbers_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, a=1.0, b=2.0)
    with pytest.raises(ReadError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == (
        f"{path}: no columns of samples, found nothing; expected gyroscope or accelerometer arrays with a "
        "row per sample and up to 64 columns; save only those columns"
    )


@pytest.mark.parametrize(("name", "writer"), WRITERS, ids=[name for name, _ in WRITERS])
def test_a_randomly_damaged_table_is_read_or_refused_with_a_message(
    name: str, writer: Callable[[Path], None], tmp_path: Path
) -> None:
    """Damage: flipped, cut and zeroed bytes."""
    path = tmp_path / name
    writer(path)
    data = path.read_bytes()
    for seed in range(12):
        rng = np.random.default_rng(seed)
        damaged = bytearray(data)
        places = rng.integers(0, len(data), 4)
        if seed % 3 == 0:
            damaged = damaged[: int(places[0])]
        elif seed % 3 == 1:
            for place in places:
                damaged[place] ^= 1 << int(rng.integers(0, 8))
        else:
            damaged[int(places[0]) : int(places[0]) + 64] = bytes(min(64, len(data) - int(places[0])))
        path.write_bytes(bytes(damaged))
        try:
            recording = read(path, ReadOptions(gyro_unit="rad/s", accel_unit="m/s^2"))
        except ImucalError as error:
            assert str(path) in str(error)  # noqa: PT017 - the message is the point
        else:
            assert recording.series
