"""HDF5 and MATLAB 7.3: columns are named by their paths, as in NPZ and older MAT files."""

import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.testing as npt
import pytest
import scipy.io

from imucal.errors import ReadError
from imucal.readers import describe, read
from tests.raising import raises
from tests.readers.tables.hdf5_logs import write_hdf5, write_matlab
from tests.readers.tables.texts import EPOCH, N, truth

UNITS: dict[str, Any] = {"gyro_unit": "rad/s"}
STAMPS = np.array(truth().ns, dtype=np.int64) + EPOCH


def is_truth(path: Path, **options: Any) -> None:  # noqa: ANN401 - options of any kind
    recording = read(path, **UNITS, **options)
    assert recording.source.format == "hdf5"
    assert recording.series[0].rate_hz == pytest.approx(100)
    for sensor, values in (("gyroscope", truth().gyro), ("accelerometer", truth().accel)):
        for index, axis in enumerate("xyz"):
            npt.assert_array_equal(recording.axis(sensor, axis).samples, values[:, index])


@pytest.mark.parametrize("compression", [None, "gzip"])
def test_groups_of_arrays_are_read(compression: str | None, tmp_path: Path) -> None:
    """Stamps keep all digits."""
    arrays = {"imu/stamp_ns": STAMPS, "imu/gyro": truth().gyro, "imu/accel": truth().accel}
    path = write_hdf5(tmp_path / "log.h5", arrays | {"camera/exposure": np.ones(7)}, compression=compression)
    is_truth(path)
    assert read(path, **UNITS).series[0].clock.start_ns == EPOCH
    assert (describe(path).topics[0].count, describe(path).start_ns) == (N, EPOCH)


def test_a_table_of_records_is_read(tmp_path: Path) -> None:
    records = np.zeros(
        N, dtype=[("time_ns", "<i8"), *((f"{s}{axis}", "<f8") for s in "ga" for axis in "xyz")]
    )
    records["time_ns"] = STAMPS
    for index, axis in enumerate("xyz"):
        records[f"g{axis}"], records[f"a{axis}"] = truth().gyro[:, index], truth().accel[:, index]
    is_truth(write_hdf5(tmp_path / "log.h5", {"imu": records}))


def test_an_attribute_can_contain_the_rate(tmp_path: Path) -> None:
    """The arrays are transposed and have no stamps."""
    arrays = {"gyro": truth().gyro.T, "accel": truth().accel.T}
    is_truth(write_hdf5(tmp_path / "log.hdf5", arrays, sampling_rate=100.0))


@pytest.mark.parametrize("table", [False, True])
def test_matlab_7_3_files_equal_older_mat_files(table: bool, tmp_path: Path) -> None:  # noqa: FBT001 - a parameter of the case
    """A table next to the arrays is ignored."""
    arrays = {"imu/t": STAMPS * 1e-9, "imu/gyro": truth().gyro, "imu/accel": truth().accel, "imu/fs": 100.0}
    path = write_matlab(tmp_path / "log.mat", arrays, table=table)
    is_truth(path)
    older = tmp_path / "older.mat"
    scipy.io.savemat(older, {"imu": {name.removeprefix("imu/"): array for name, array in arrays.items()}})
    assert read(path, **UNITS).source.topics == read(older, **UNITS).source.topics


def test_the_error_for_a_table_of_matlab_7_3_contains_the_solution(tmp_path: Path) -> None:
    path = write_matlab(tmp_path / "log.mat", {}, table=True)
    with pytest.raises(
        ReadError,
        match=r"T is a table, which only MATLAB can read; in MATLAB type writetable\(T, 'T\.csv'\)$",
    ):
        read(path)


def test_without_the_extra_the_error_explains_the_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_hdf5(tmp_path / "log.h5", {"gyro": truth().gyro})
    monkeypatch.setitem(sys.modules, "h5py", None)
    for action in (read, describe):
        with pytest.raises(ReadError) as caught:
            action(path)
        assert str(caught.value) == (
            f"{path}: an HDF5 or MATLAB 7.3 file, which an extra reads; "
            "type: pip install 'imucal-noise[hdf5]'"
        )


@pytest.mark.parametrize("kind", ["external", "virtual", "link", "nested link"])
def test_data_in_other_files_are_refused(kind: str, tmp_path: Path) -> None:
    """The samples in a report would publish another file of the user."""
    other, path = tmp_path / "other.h5", tmp_path / "log.h5"
    write_hdf5(other, {"gyro": np.ones((900, 3))})
    with h5py.File(path, "w") as file:
        file["accel"] = np.ones((900, 3))
        if kind == "external":
            file.create_dataset("gyro", (600,), "u1", external=[(str(other), 0, 600)])
        elif kind == "virtual":
            layout = h5py.VirtualLayout((900, 3), "f8")
            layout[:] = h5py.VirtualSource(str(other), "gyro", (900, 3))
            file.create_virtual_dataset("gyro", layout)
        else:
            place = "imu/raw/gyro" if "nested" in kind else "gyro"
            file[place] = h5py.ExternalLink(str(other), "/gyro")
            file["soft"] = h5py.SoftLink(place)
    for command in (read, describe):
        with pytest.raises(ReadError, match=r"gyro (has its data|is a virtual|is a link).*other\.h5"):
            command(path)


def test_a_file_longer_than_its_superblock_declares_is_damaged(tmp_path: Path) -> None:
    """The arrays after inserted bytes are shifted."""
    rng = np.random.default_rng(3)
    arrays = {"gyro_rad_s": rng.normal(size=(900, 3)), "time_s": np.arange(900) / 100}
    for path in (write_hdf5(tmp_path / "a.h5", arrays), write_matlab(tmp_path / "b.mat", arrays)):
        assert "damaged" not in {finding.code for finding in read(path, **UNITS).findings}
        size = path.stat().st_size
        with path.open("ab") as file:
            file.write(bytes(512))
        finding = next(finding for finding in read(path, **UNITS).findings if finding.code == "damaged")
        assert f"it has {size + 512} bytes, and its superblock declares {size}" in finding.text


def test_datasets_that_declare_more_than_they_store_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("gyro", (10**9, 3), "f8", chunks=(10**4, 3), compression="gzip")
    with raises(ReadError, "24000000000 bytes and stores 0", place="log.h5"):
        read(path)
    with h5py.File(path, "w") as file:
        for i in range(4001):
            file.create_group(f"g{i}")
    with raises(ReadError, "at least 4002 groups", place="log.h5"):
        read(path)
