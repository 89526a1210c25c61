"""Damaged typed tables and ULogs are read or refused with a message.

NPY and MAT have no checksums, so a changed value is read as it is. The test checks that reading raises no
foreign exception and prints nothing. A parser that does not end is stopped by the time limit of `isolation`.
"""

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import scipy.io

from imucal.errors import ImucalError
from imucal.readers import describe, read
from imucal.readers.flight_logs import ulog_content
from tests.readers.containers.test_mutations import CHANGES
from tests.readers.tables.hdf5_logs import write_hdf5, write_matlab
from tests.readers.ulog.ardupilot_logs import write_dataflash
from tests.readers.ulog.test_ulog import two_sensors
from tests.slow_cases import first_by_default

#: Cases of each format for each change, in parts; 1024 in total.
CASES, PARTS = 8, 2

N = 60


def columns() -> dict[str, np.ndarray[Any, Any]]:
    rng = np.random.default_rng(1)
    gyro = rng.normal(0, 1e-3, (N, 3))
    accel = rng.normal(0, 1e-2, (N, 3)) + np.array([0, 0, 9.8])
    found: dict[str, np.ndarray[Any, Any]] = {"timestamp_ns": np.arange(N) * 10_000_000}
    for name, values in (("gyro", gyro), ("accel", accel)):
        found |= {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}
    return found


def write_records(path: Path) -> None:
    records = np.zeros(N, dtype=[(name, values.dtype) for name, values in columns().items()])
    for name, values in columns().items():
        records[name] = values
    np.save(path, records)


def write_parquet(compression: Any) -> Callable[[Path], object]:  # noqa: ANN401 - polars' own names
    return lambda path: pl.DataFrame(columns()).write_parquet(path, compression=compression)


def nested() -> dict[str, object]:
    """Return the columns as a MATLAB structure."""
    found = columns()
    both = {kind: np.stack([found[f"{kind}_{axis}"] for axis in "xyz"], axis=1) for kind in ("gyro", "accel")}
    return {"imu": {"t": found["timestamp_ns"] * 1e-9, **both, "freq": 100.0}}


FORMATS: dict[str, Callable[[Path], object]] = {
    "plain.npy": lambda path: np.save(path, np.stack(list(columns().values()), axis=1)),
    "records.npy": write_records,
    "plain.npz": lambda path: np.savez(path, **columns()),  # type: ignore[arg-type]
    "compressed.npz": lambda path: np.savez_compressed(path, **columns()),  # type: ignore[arg-type]
    "plain.mat": lambda path: scipy.io.savemat(path, columns()),
    "compressed.mat": lambda path: scipy.io.savemat(path, nested(), do_compression=True),
    "old.mat": lambda path: scipy.io.savemat(path, columns(), format="4"),
    "plain.parquet": write_parquet("uncompressed"),
    "snappy.parquet": write_parquet("snappy"),
    "zstd.parquet": write_parquet("zstd"),
    "plain.h5": lambda path: write_hdf5(path, columns()),
    "packed.h5": lambda path: write_hdf5(path, columns(), compression="gzip"),
    "v73.mat": lambda path: write_matlab(path, columns()),
    "flight.ulg": two_sensors,
    "flight.bin": write_dataflash,
    "batch.bin": lambda path: write_dataflash(path, batch=True),
}
OPTIONS: dict[str, Any] = {"columns": "t=0,g=1:4,a=4:7", "gyro_unit": "rad/s", "accel_unit": "m/s^2"}


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("part", first_by_default(range(PARTS), 1))
def test_a_damaged_table_is_read_or_refused_with_a_message(
    name: str,
    change: Callable[[bytearray, np.random.Generator], None],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    *,
    part: int,
) -> None:
    """The error names the file, and nothing is printed."""
    undamaged = tmp_path / name
    FORMATS[name](undamaged)
    original = undamaged.read_bytes()
    options = OPTIONS if name == "plain.npy" else {}
    assert len(read(undamaged, **options).series) == 6
    for case in range(part, CASES, PARTS):
        rng = np.random.default_rng([case, zlib.crc32(name.encode()), CHANGES.index(change)])
        data = bytearray(original)
        change(data, rng)
        path = tmp_path / f"{case}-{name}"
        path.write_bytes(data)
        for action in (lambda path: read(path, **options), describe):
            try:
                action(path)
            except ImucalError as error:
                assert str(error).startswith(str(path))  # noqa: PT017 - the message is the point
        path.unlink()
    assert capfd.readouterr() == ("", "")


def test_pyulog_reads_the_written_samples(tmp_path: Path) -> None:
    """Every message is read, and nothing is damaged or dropped."""
    content = ulog_content(two_sensors(tmp_path / "flight.ulg"))
    found = [(*instance, columns["x"].size) for instance, columns in content.messages.items()]
    assert found == [("sensor_accel", 0, 200), ("sensor_gyro", 0, 400)]
    assert not content.damaged
    assert not content.dropouts
