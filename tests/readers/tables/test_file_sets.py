"""Files that are read together: their selection, and how they become one recording."""

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError, ReadError
from imucal.readers import describe, read
from imucal.recording import Sensor
from tests.raising import raises
from tests.readers.tables.texts import EPOCH, N, truth


def table(values: FloatArray | None = None, head: str = "time,seconds_elapsed,z,y,x") -> str:
    """Return a table of Sensor Logger at 100 Hz, without rows if there are no values."""
    rows = [] if values is None else values[:, ::-1].tolist()
    lines = [f"{EPOCH + at * 10**7},{at / 100},{','.join(map(repr, row))}" for at, row in enumerate(rows)]
    return "\n".join([head, *lines, ""])


def written(tmp_path: Path, files: dict[str, str], *, packed: bool) -> Path:
    """Write files into a folder, or into a zip."""
    if packed:
        path = tmp_path / "log.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in files.items():
                archive.writestr(name, text)
        return path
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


GYRO, ACCEL = truth().gyro, truth().accel
UNCALIBRATED = {"GyroscopeUncalibrated.csv": table(GYRO), "AccelerometerUncalibrated.csv": table(ACCEL)}
META = {"Metadata.csv": "version,device\n3,phone\n", "Gravity.csv": table(ACCEL)}


def is_truth(path: Path, **options: Any) -> None:  # noqa: ANN401 - options of any kind
    found = read(path, **options)
    assert len(found.series) == 6
    for sensor, values in (("gyroscope", GYRO), ("accelerometer", ACCEL)):
        for index, axis in enumerate("xyz"):
            np.testing.assert_array_equal(found.axis(sensor, axis).samples, values[:, index])


@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("empty", ["", table()], ids=["no bytes", "a header"])
def test_empty_files_are_skipped(empty: str, packed: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """Phones can log only the uncalibrated sensors."""
    files = {"Gyroscope.csv": empty, "Accelerometer.csv": empty, "TotalAcceleration.csv": empty}
    path = written(tmp_path, files | UNCALIBRATED | META, packed=packed)
    is_truth(path)
    assert describe(path).topics[0].count == N
    with raises(ChoiceError, r"Gyroscope\.csv can't be read: (found no rows of numbers|the text is empty)"):
        read(path, topic="Gyroscope.csv")


@pytest.mark.parametrize("packed", [True, False])
def test_a_file_name_can_be_given_as_topic(packed: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """Without a topic the calibrated files are read."""
    files = {"Gyroscope.csv": table(2 * GYRO), "TotalAcceleration.csv": table(2 * ACCEL)}
    path = written(tmp_path, files | UNCALIBRATED | META, packed=packed)
    found = read(path)
    assert dict(found.source.decisions)["files"] == "Gyroscope.csv, TotalAcceleration.csv"
    is_truth(path, topic=list(UNCALIBRATED))
    named = read(path, topic="Gravity.csv", columns="t=time,a=x+y+z", time_unit="ns", accel_unit="m/s^2")
    np.testing.assert_array_equal(named.series[0].samples, ACCEL[:, 0])
    with raises(ChoiceError, r"no topic gyro; .*\n  [AG]", argument="topic"):
        read(path, topic="gyro")


def test_two_files_of_one_sensor_require_a_choice(tmp_path: Path) -> None:
    """No file has a usual name."""
    path = written(tmp_path, {"gyro_a.csv": table(GYRO), "gyro_b.csv": table(2 * GYRO)}, packed=True)
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: 2 topics carry IMU samples; choose one of these topics\n"
        "  gyro_a.csv  table  ? messages\n"
        "  gyro_b.csv  table  ? messages"
    )
    np.testing.assert_array_equal(read(path, topic="gyro_b.csv").series[0].samples, 2 * GYRO[:, 0])


def test_columns_identify_the_sensor_of_a_file_without_a_sensor_name(tmp_path: Path) -> None:
    """The file is ignored if other files have a sensor in their names."""
    both = table(GYRO, "time,seconds_elapsed,gyro_z,gyro_y,gyro_x")
    path = written(tmp_path, {"one.csv": both, "notes.txt": "nothing\n"}, packed=False)
    assert [series.name for series in read(path, gyro_unit="rad/s").series] == ["gyro_x", "gyro_y", "gyro_z"]
    (path / "Gyroscope.csv").write_text(table(2 * GYRO), encoding="utf-8")
    np.testing.assert_array_equal(read(path).series[0].samples, 2 * GYRO[:, 0])
    (path / "Gyroscope.csv").unlink()
    (path / "one.csv").write_text("time,pressure\n1,2\n2,3\n", encoding="utf-8")
    with pytest.raises(ChoiceError, match=r"no topic carries a gyroscope .*\n  notes"):
        read(path)


@pytest.mark.parametrize("packed", [False, True])
def test_many_tables_are_refused_with_their_number(packed: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """Reading the start of each takes a millisecond."""
    path = written(tmp_path, {f"{i}.csv": "1,2,3\n" for i in range(1001)}, packed=packed)
    for read_or_describe in (read, describe):
        with pytest.raises(ReadError, match="1001 tables of text"):
            read_or_describe(path)


def test_a_zip_that_declares_too_large_tables_is_refused(tmp_path: Path) -> None:
    """The declared sizes are compared before a table is read: 70 MB of one row in 70 kB."""
    path = tmp_path / "log.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Gyroscope.csv", "time,x,y,z\n" + "1,2,3,4\n" * 9_000_000)
    with raises(ReadError, "72000011 bytes of tables", place="log.zip"):
        read(path)


@pytest.mark.parametrize("kind", ["pipe", "device", "link to a pipe", "broken link", "folder"])
def test_a_table_that_is_no_file_is_passed_over(kind: str, tmp_path: Path) -> None:
    """Reading a pipe or a device in the folder of an app would never end."""
    folder = Path(written(tmp_path, {"Gyroscope.csv": table(truth().gyro)}, packed=False))
    other = folder / "Magnetometer.csv"
    if kind == "pipe":
        os.mkfifo(other)
    elif kind == "device":
        other.symlink_to("/dev/zero")
    elif kind == "link to a pipe":
        os.mkfifo(tmp_path / "pipe")
        other.symlink_to(tmp_path / "pipe")
    elif kind == "broken link":
        other.symlink_to(tmp_path / "missing.csv")
    else:
        other.mkdir()
    recording = read(folder)
    assert {series.sensor for series in recording.series} == {Sensor.GYROSCOPE}
    assert recording.source.path == str(folder)


@pytest.mark.parametrize("packed", [True, False])
def test_files_of_sensors_become_one_recording(packed: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """The gyroscope comes first, equal times share a clock, and the decisions name the files."""
    path = written(tmp_path, {"Accelerometer.csv": table(ACCEL), "Gyroscope.csv": table(GYRO)}, packed=packed)
    found = read(path)
    assert [series.name for series in found.series][::3] == ["gyro_x", "accel_x"]
    assert len({id(series.clock) for series in found.series}) == 1
    assert found.source.path == str(path)
    assert found.source.decisions[0] == ("files", "Gyroscope.csv, Accelerometer.csv")
    assert found.source.topics == ("x", "y", "z") * 2


def test_files_with_other_times_have_their_own_clocks(tmp_path: Path) -> None:
    """Findings name the sensor only if the clocks differ."""
    later = table(ACCEL).replace(f"{EPOCH}"[:8], f"{EPOCH + 10**12}"[:8])
    path = written(
        tmp_path, {"Accelerometer.csv": table(ACCEL[::2]), "Gyroscope.csv": table(GYRO)}, packed=True
    )
    gyro, accel = (read(path).axis(sensor, "x") for sensor in ("gyroscope", "accelerometer"))
    assert (gyro.n, accel.n) == (N, N // 2)
    assert gyro.clock is not accel.clock
    (tmp_path / "log.zip").unlink()
    path = written(tmp_path, {"Accelerometer.csv": later, "Gyroscope.csv": table(GYRO)}, packed=True)
    with raises(ChoiceError, "not recorded at the same time", place="log.zip"):
        read(path)
