"""Layouts of public data sets are read, or the advice in the error works."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError, ImucalError
from imucal.readers import read
from imucal.recording import Recording
from tests.raising import raises
from tests.readers.tables.test_converted_first import refused

N, RATE_HZ = 400, 100.0
RNG = np.random.default_rng(271127)
TIME = np.arange(N) / RATE_HZ
GYRO: FloatArray = 1e-3 * RNG.standard_normal((N, 3))
ACCEL: FloatArray = 0.02 * RNG.standard_normal((N, 3)) + [0.0, 0.0, 9.81]
SI: dict[str, Any] = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}


def write(path: Path, *columns: object, header: str = "", separator: str = ",") -> Path:
    """Write columns of numbers or texts below a header."""
    rows = zip(*columns, strict=True)
    texts = (separator.join(cell if isinstance(cell, str) else f"{cell:.9g}" for cell in row) for row in rows)
    path.write_text("\n".join(filter(None, [header, *texts])) + "\n", encoding="utf-8")
    return path


def is_truth(recording: Recording) -> None:
    """Check the samples of both sensors and the rate."""
    for sensor, values in (("gyro", GYRO), ("accel", ACCEL)):
        for index, axis in enumerate("xyz"):
            series = recording.axis(sensor, axis)
            np.testing.assert_allclose(series.samples, values[:, index], rtol=1e-5, atol=1e-9)
            assert series.rate_hz == pytest.approx(RATE_HZ)


def test_a_log_of_empatica_is_named(tmp_path: Path) -> None:
    """Without the first two rows, start time and rate, it is read with the scale of the error."""
    counts = np.round(ACCEL / 9.80665 * 64)
    path = write(tmp_path / "ACC.csv", *([1.7e9, 32.0, *column] for column in counts.T))
    text = path.read_text(encoding="utf-8").split("\n", 2)
    path.write_text("\n".join([", ".join(["1700000000.000000"] * 3), ", ".join(["32.000000"] * 3), text[2]]))
    message = refused(path)
    assert "it is a log of Empatica: row 1 contains the start time" in message
    (scale,) = re.findall(r"the scale (\S+)", message)
    path.write_text("ax,ay,az\n" + re.sub(r"(?m)^[^,]*,[^,]*,", "", text[2]), encoding="utf-8")
    found = read(path, rate_hz=32.0, accel_scale=float(scale))
    np.testing.assert_allclose(found.axis("accel", "z").samples, counts[:, 2] * 0.1532)


def test_json_with_a_list_for_each_row_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a log.json"
    path.write_text(json.dumps(np.column_stack([TIME, GYRO, ACCEL]).tolist()))
    assert "it is JSON with a list for each row; export it as CSV" in refused(path)


@pytest.mark.parametrize("separator", [",", ";"])
def test_a_row_for_each_axis_is_refused(separator: str, tmp_path: Path) -> None:
    """The names are in the first column."""
    names = ["time_s", "gx", "gy", "gz", "ax", "ay", "az"]
    n = 600
    values = np.tile(np.column_stack([GYRO, ACCEL]), (2, 1))[:n]
    rows = [np.arange(n) / RATE_HZ, *values.T]
    lines = [
        separator.join([name, *(f"{cell:.9g}" for cell in row)])
        for name, row in zip(names, rows, strict=True)
    ]
    path = tmp_path / "log.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert "it has a row for each axis, expected a row per sample" in refused(path)


def test_two_separators_become_one(tmp_path: Path) -> None:
    """Time and gyroscope are separated by commas, the accelerometer by semicolons."""
    clock = [f"11:30:{second:05.2f}" for second in TIME]
    gyro = [",".join(f"{value:.9g}" for value in row) for row in GYRO]
    accel = [";".join(f"{value:.9g}" for value in row) for row in ACCEL]
    both = [f"{a},{b}" for a, b in zip(clock, gyro, strict=True)]
    path = write(tmp_path / "log.txt", both, accel, separator=";")
    message = refused(path)
    assert "its rows contain two separators, ';' and ','; replace one by the other" in message
    path.write_text(path.read_text(encoding="utf-8").replace(";", ","), encoding="utf-8")
    is_truth(read(path, columns="t=0,g=1:4,a=4:7", **SI))


def test_decimal_commas_are_not_a_second_separator(tmp_path: Path) -> None:
    """A table of a German spreadsheet without a header is read with its columns."""
    columns = [[f"{value:.9f}".replace(".", ",") for value in column] for column in (TIME, *GYRO.T, *ACCEL.T)]
    path = write(tmp_path / "log.csv", *columns, separator=";")
    assert "the 7 columns have no header" in refused(path)
    is_truth(read(path, columns="t=0,g=1:4,a=4:7", time_unit="s", **SI))


def test_a_header_with_too_few_names_is_reported(tmp_path: Path) -> None:
    """The first row of numbers is listed, and the columns can be given."""
    path = write(tmp_path / "log.csv", TIME, *GYRO.T, *ACCEL.T, header="time,gx,gy,gz")
    assert "the header has 4 names and the rows 7 cells; found columns: 0 = 0, 1 = " in refused(path)
    is_truth(read(path, columns="t=0,g=1:4,a=4:7", time_unit="s", **SI))


def test_a_column_of_sensor_numbers_is_part_of_the_suggestion(tmp_path: Path) -> None:
    """Without it, the rows of two sensors would be read as one."""
    sensors = ["1" if k % 2 else "2" for k in range(2 * N)]
    values = np.stack([ACCEL, GYRO], axis=1).reshape(-1, 3)
    path = write(tmp_path / "log.csv", sensors, np.repeat(TIME, 2), *values.T, header="sensor,time_s,x,y,z")
    message = refused(path, **SI)
    assert "column sensor may number the sensors" in message
    (columns,) = re.findall(r"such as (\S+)", message)
    assert columns == "t=1,g=2:5@0:2,a=2:5@0:1"
    is_truth(read(path, columns="t=1,g=2:5@0:1,a=2:5@0:2", **SI))


def test_a_rate_above_the_table_is_used(tmp_path: Path) -> None:
    """ActiGraph writes it in the first line."""
    head = "--- Data File Created By ActiGraph GT3X+ date format M/d/yyyy at 30 Hz  Filter Normal ---"
    names = "Accelerometer X,Accelerometer Y,Accelerometer Z"
    path = write(tmp_path / "log.csv", *(ACCEL / 9.80665).T, header=f"{head}\nSerial Number: X1\n{names}")
    assert read(path).axis("accel", "x").rate_hz == 30.0


def test_mdeg_is_the_unit_of_a_gyroscope(tmp_path: Path) -> None:
    """A header without the time unit of the rate is understood."""
    names = "Time [s],Gyro X [mDeg],Gyro Y [mDeg],Gyro Z [mDeg],Acc X [m/s2],Acc Y [m/s2],Acc Z [m/s2]"
    path = write(tmp_path / "log.csv", TIME, *(np.degrees(GYRO) * 1000).T, *ACCEL.T, header=names)
    is_truth(read(path))


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m/s^2"), (9.80665, "g")])
def test_gravity_identifies_the_unit_of_uncalibrated_samples(scale: float, unit: str, tmp_path: Path) -> None:
    """Sensor Logger can write them in g or in m/s^2."""
    header = "time,seconds_elapsed,z,y,x"
    stamps = [f"{1_700_000_000_000_000_000 + k * 10_000_000}" for k in range(N)]
    path = write(
        tmp_path / "AccelerometerUncalibrated.csv", stamps, TIME, *(ACCEL[:, ::-1] / scale).T, header=header
    )
    found = read(path)
    np.testing.assert_allclose(found.axis("accel", "z").samples, ACCEL[:, 2], rtol=1e-6)
    assert unit in dict(found.source.decisions)["accelerometer unit"]


@pytest.mark.parametrize(
    ("rate_hz", "accel", "wanted"),
    [
        (100.0, ACCEL, "so deg/s is likely"),
        (20.0, ACCEL, "so it may be either"),
        (100.0, ACCEL + np.cumsum(0.2 * RNG.standard_normal((N, 3)), axis=0), "so it may be either"),
        (100.0, None, "so it may be either"),
    ],
    ids=["at rest", "slow", "moved", "no accelerometer"],
)
def test_deg_per_s_is_suggested_only_at_rest(
    rate_hz: float, accel: FloatArray | None, wanted: str, tmp_path: Path
) -> None:
    """Motion at a low rate looks like white noise, and only a still accelerometer shows rest."""
    force, names = ([], "") if accel is None else ([*accel.T], ",ax (m/s^2),ay (m/s^2),az (m/s^2)")
    header = f"t (s),gx,gy,gz{names}"
    path = write(tmp_path / "log.csv", np.arange(N) / rate_hz, *(300 * GYRO).T, *force, header=header)
    with raises(ChoiceError, re.escape(wanted), place="log.csv", argument="gyro_unit"):
        read(path)


def test_a_noise_of_tens_of_degrees_suggests_a_smaller_unit(tmp_path: Path) -> None:
    """The noise is too large even for deg/s."""
    path = write(
        tmp_path / "log.csv", TIME, *(6e4 * GYRO).T, *ACCEL.T, header="t (s),gx,gy,gz,ax (g),ay (g),az (g)"
    )
    with raises(ImucalError, "for deg/s too", place="log.csv", argument="gyro_unit"):
        read(path)
