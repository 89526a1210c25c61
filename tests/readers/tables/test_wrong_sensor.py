"""Tables that are easy to misread: rows of several sensors, units in names, unrecognised sensors."""

from pathlib import Path

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError
from imucal.readers import read
from tests.readers.tables.texts import N, cells, lines, seconds, truth, xyz

T = truth()


def refused(path: Path) -> tuple[str, list[str]]:
    """Return the error message and the columns texts that it offers."""
    with pytest.raises(ChoiceError) as caught:
        read(path)
    message = str(caught.value)
    ready = message.partition("such as ")[2].partition(" (numbers")[0].split(" or ")
    return message, ready


def tagged(folder: Path, header: str, *rows: tuple[str, FloatArray]) -> Path:
    """Write rows of several sensors in turn: time, tag and three values."""
    text = [header]
    for i, time in enumerate(seconds(T)):
        text += [f"{tag},{time},{','.join(cells(values[i]))}" for tag, values in rows]
    path = folder / "log.csv"
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    return path


def test_tags_override_a_header_that_fits_only_one_sensor(tmp_path: Path) -> None:
    """Each sensor gets its own rows and rate, whatever the header calls the columns."""
    header = "sensor,time (s),UncalGyroX (rad/s),UncalGyroY (rad/s),UncalGyroZ (rad/s)"
    path = tagged(tmp_path, header, ("UncalAccel", T.accel), ("UncalGyro", T.gyro))
    recording = read(path)
    assert [series.n for series in recording.series] == [N] * 6
    assert np.array_equal(np.array([series.samples for series in recording.series[:3]]).T, T.gyro)
    assert np.array_equal(np.array([series.samples for series in recording.series[3:]]).T, T.accel)
    assert recording.series[0].rate_hz == pytest.approx(100)
    decided = dict(recording.source.decisions)
    assert decided["gyroscope columns"].endswith("by name, in the rows that column sensor names")
    assert decided["accelerometer unit"].startswith("m/s^2, inferred: median magnitude")


def test_tagged_rows_of_two_gyroscopes_are_refused(tmp_path: Path) -> None:
    """The user must choose; the columns texts in the error work."""
    header = "sensor,time (s),gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s)"
    path = tagged(tmp_path, header, ("gyro_left", T.gyro), ("gyro_right", -T.gyro))
    message, ready = refused(path)
    assert "column sensor has tags of rows (gyro_left, gyro_right); 2 tags name the gyroscope" in message
    assert ready == ["t=1,g=2:5@0:gyro_left", "t=1,g=2:5@0:gyro_right"]
    for text, sign in zip(ready, (1, -1), strict=True):
        (x, *_) = read(path, columns=text).series
        assert np.array_equal(x.samples, sign * T.gyro[:, 0])


def test_tags_that_contradict_the_header_are_refused(tmp_path: Path) -> None:
    """The header contains a gyroscope and the tags an accelerometer, so one of them is wrong."""
    header = "sensor,time (s),gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s)"
    path = tagged(tmp_path, header, ("accel", T.accel))
    message, _ = refused(path)
    assert "column sensor has tags of rows (accel); no tag names the gyroscope" in message


@pytest.mark.parametrize("name", ["device", "frame_id", "header.frame_id", "source", "imu"])
def test_rows_of_several_devices_are_refused(name: str, tmp_path: Path) -> None:
    """A column with names or numbers of devices shows that the rows must not be mixed."""
    header = f"{name},time (s),gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s)"
    for tags in (("left", "right"), ("0", "1")):
        path = tagged(tmp_path, header, (tags[0], T.gyro), (tags[1], -T.gyro))
        message, ready = refused(path)
        assert f"rows of 2 sensors, numbered by column {name} ({', '.join(tags)})" in message
        (x, *_) = read(path, columns=ready[1]).series
        assert np.array_equal(x.samples, -T.gyro[:, 0])


def test_a_constant_name_or_a_state_is_not_a_device(tmp_path: Path) -> None:
    """The table has one frame for all rows and a column of remarks; all rows are read."""
    rows = [f"{time},imu_link,{'still' if i % 2 else 'moving'},{','.join(cells(T.gyro[i]))}"
            for i, time in enumerate(seconds(T))]  # fmt: skip
    path = tmp_path / "log.csv"
    header = "time (s),frame_id,state,gx_rads,gy_rads,gz_rads"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    assert [series.n for series in read(path).series] == [N] * 3


@pytest.mark.parametrize(
    "names",
    [
        ("imu1_gx", "imu1_gy", "imu1_gz", "imu1_ax", "imu1_ay", "imu1_az"),
        ("imu1_g_x", "imu1_g_y", "imu1_g_z", "imu1_a_x", "imu1_a_y", "imu1_a_z"),
        ("gx1", "gy1", "gz1", "ax1", "ay1", "az1"),
        ("gx_raw", "gy_raw", "gz_raw", "ax_raw", "ay_raw", "az_raw"),
        ("gx_2", "gy_2", "gz_2", "ax_2", "ay_2", "az_2"),
    ],
)
def test_prefixes_and_suffixes_are_not_units(names: tuple[str, ...], tmp_path: Path) -> None:
    """The g in imu1_gx means gyroscope, not acceleration in g."""
    path = tmp_path / "log.csv"
    content = lines("time (s)," + ",".join(names), seconds(T), *xyz(T.gyro), *xyz(T.accel))
    path.write_text(content, encoding="utf-8")
    recording = read(path, gyro_unit="rad/s")
    assert np.array_equal(np.array([series.samples for series in recording.series]).T,
                          np.hstack([T.gyro, T.accel]))  # fmt: skip


@pytest.mark.parametrize(
    ("header", "ready"),
    [
        (
            "t," + ",".join(f"imu{i}_{s}{a}" for i in (1, 2) for s in "ga" for a in "xyz"),
            ["t=0,g=1:4,a=4:7", "t=0,g=7:10,a=10:13"],
        ),
        (
            "t," + ",".join(f"{s}{a}{i}" for s in "ga" for i in (1, 2) for a in "xyz"),
            ["t=0,g=1:4,a=7:10", "t=0,g=4:7,a=10:13"],
        ),
        (
            "t,"
            + ",".join(f"imu{i}_{s}{a}" for i, s in ((2, "a"), (1, "g"), (1, "a"), (2, "g")) for a in "xyz"),
            ["t=0,g=4:7,a=7:10", "t=0,g=10:13,a=1:4"],
        ),
    ],
)
def test_two_imus_are_offered_as_pairs(header: str, ready: list[str], tmp_path: Path) -> None:
    """Each text has the gyroscope and the accelerometer of the same device, in any order of columns."""
    is_gyro = ["g" in name.removeprefix("imu") for name in header.split(",")[1::3]]
    columns = [axis for gyro in is_gyro for axis in xyz(T.gyro if gyro else T.accel)]
    path = tmp_path / "log.csv"
    path.write_text(lines(header, seconds(T), *columns), encoding="utf-8")
    message, offered = refused(path)
    assert "2 sets of gyroscope columns" in message
    assert offered == ready
    for text in offered:
        recording = read(path, columns=text, gyro_unit="rad/s")
        assert np.array_equal(recording.axis("gyroscope", "x").samples, T.gyro[:, 0])
        assert np.array_equal(recording.axis("accelerometer", "z").samples, T.accel[:, 2])


def test_an_unrecognised_sensor_is_reported(tmp_path: Path) -> None:
    """The finding lists its columns, and the columns text in its advice works."""
    header = "time (s),turn_x,turn_y,turn_z,ax,ay,az,humidity,mag_x,mag_y,mag_z,qw"
    zero = ["0"] * N
    content = lines(header, seconds(T), *xyz(T.gyro), *xyz(T.accel), zero, *[zero] * 4)
    path = tmp_path / "log.csv"
    path.write_text(content, encoding="utf-8")
    recording = read(path)
    assert {series.sensor for series in recording.series} == {"accelerometer"}
    (finding,) = [finding for finding in recording.findings if finding.code == "sensor-missing"]
    assert (finding.level, finding.axis) == ("warning", "gyro")
    assert finding.text == (
        "No gyroscope was found in the table; unused columns: "
        "1 turn_x, 2 turn_y, 3 turn_z, 7 humidity, 11 qw."
    )
    assert finding.advice == "If it is one of them, give a columns text such as t=0,g=1:4,a=4:7."
    both = read(path, columns="t=0,g=1:4,a=4:7", gyro_unit="rad/s")
    assert np.array_equal(both.axis("gyroscope", "x").samples, T.gyro[:, 0])


def test_other_columns_are_reported_as_info_without_advice(tmp_path: Path) -> None:
    """Known columns, such as a temperature or a magnetometer, cause no finding."""
    path = tmp_path / "log.csv"
    zero = ["0"] * N
    path.write_text(lines("time (s),ax,ay,az,humidity", seconds(T), *xyz(T.accel), zero), encoding="utf-8")
    (finding,) = [finding for finding in read(path).findings if finding.code == "sensor-missing"]
    assert (finding.level, finding.advice) == ("info", "")
    path.write_text(
        lines("time (s),ax,ay,az,temp_c,mag_x", seconds(T), *xyz(T.accel), zero, zero), encoding="utf-8"
    )
    assert not [finding for finding in read(path).findings if finding.code == "sensor-missing"]


def test_raw_and_filtered_columns_require_a_choice(tmp_path: Path) -> None:
    """With ``gx_raw … gx_filt …`` next to ``ax ay az``, the program must not guess which set to use."""
    names = [f"g{axis}_{what}" for what in ("raw", "filt") for axis in "xyz"]
    header = f"t,{','.join(names)},ax,ay,az"
    path = tmp_path / "log.csv"
    path.write_text(
        lines(header, seconds(T), *xyz(T.gyro), *xyz(T.gyro / 2), *xyz(T.accel)), encoding="utf-8"
    )
    message, ready = refused(path)
    assert "2 sets of gyroscope columns: gx_raw, gx_filt" in message
    assert ready == ["t=0,g=1:4,a=7:10", "t=0,g=4:7,a=7:10"]
    filtered = read(path, columns=ready[1], gyro_unit="rad/s")
    assert np.array_equal(filtered.axis("gyroscope", "x").samples, T.gyro[:, 0] / 2)
