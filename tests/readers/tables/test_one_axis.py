"""Logs of one axis, such as a fibre-optic gyroscope on a test bench, and columns named twice."""

import math
from pathlib import Path

import numpy as np
import pytest

from imucal.errors import ChoiceError
from imucal.readers import read
from tests.raising import raises

N = 400
RATES = np.random.default_rng(20_301).normal(0, 0.02, (N, 3))
TIMES = np.arange(N) / 100
DEG = math.radians(1)


def write(folder: Path, header: str, *columns: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Path:
    """Write columns as a CSV."""
    rows = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    path = folder / "log.csv"
    path.write_text("\n".join([*([header] if header else []), *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("header", "options", "name"),
    [
        ("t,gz_dps", {}, "gyro_z"),
        ("time (s),Gyroscope Y (deg/s)", {}, "gyro_y"),
        ("t,gx", {"gyro_unit": "deg/s"}, "gyro_x"),
        ("", {"columns": "t=0,gz=1", "gyro_unit": "deg/s"}, "gyro_z"),
        ("a,b", {"columns": "t=a,gx=b", "gyro_unit": "deg/s"}, "gyro_x"),
    ],
)
def test_a_log_of_a_time_and_one_axis_is_read(
    header: str, options: dict[str, str], name: str, tmp_path: Path
) -> None:
    """The header or a columns text identifies the axis; samples are in SI units."""
    recording = read(write(tmp_path, header, TIMES, RATES[:, 2]), **options)  # type: ignore[arg-type]
    (series,) = recording.series
    assert series.name == name
    assert series.rate_hz == pytest.approx(100)
    np.testing.assert_allclose(series.samples, RATES[:, 2] * DEG, rtol=1e-14)


@pytest.mark.parametrize(("header", "columns"), [("gz_dps", None), ("", "gz=0")])
def test_a_single_column_needs_a_rate(header: str, columns: str | None, tmp_path: Path) -> None:
    path = write(tmp_path, header, RATES[:, 2])
    unit = None if header else "deg/s"
    with raises(ChoiceError, "no time column", place="log.csv", argument="rate_hz"):
        read(path, columns=columns, gyro_unit=unit)
    (series,) = read(path, columns=columns, gyro_unit=unit, rate_hz=100.0).series
    np.testing.assert_allclose(series.samples, RATES[:, 2] * DEG, rtol=1e-14)


def test_some_axes_of_both_sensors_are_read(tmp_path: Path) -> None:
    """A finding reports the missing axes."""
    path = write(tmp_path, "t,gx_dps,gz_dps,az_g,humidity", TIMES, *RATES.T, RATES[:, 0])
    recording = read(path)
    assert [series.name for series in recording.series] == ["gyro_x", "gyro_z", "accel_z"]
    np.testing.assert_allclose(recording.axis("accelerometer", "z").samples, RATES[:, 2] * 9.80665)
    findings = [(finding.code, finding.axis, finding.text) for finding in recording.findings]
    left = "was found in the table; unused columns: 4 humidity."
    assert ("axis-missing", "gyro", f"Only x and z of the gyroscope {left}") in findings
    assert ("axis-missing", "accel", f"Only z of the accelerometer {left}") in findings


def test_a_single_acceleration_axis_needs_a_unit(tmp_path: Path) -> None:
    """The axis can be tilted, so a mean of 1.0 does not prove the unit g."""
    path = write(tmp_path, "t,az", TIMES, RATES[:, 0] + 1)
    with raises(
        ChoiceError,
        "accelerometer is unknown.*without all three axes",
        place="log.csv",
        argument="accel_unit",
    ):
        read(path)
    assert read(path, accel_unit="g").series[0].samples.mean() == pytest.approx(9.80665, rel=1e-3)


def test_a_single_axis_next_to_a_complete_sensor_is_reported(tmp_path: Path) -> None:
    """``az`` next to a gyroscope can be an azimuth. The finding contains the columns text to read it."""
    path = write(tmp_path, "t,gx_dps,gy_dps,gz_dps,az", TIMES, *RATES.T, RATES[:, 0])
    recording = read(path)
    assert [series.name for series in recording.series] == ["gyro_x", "gyro_y", "gyro_z"]
    (finding,) = [finding for finding in recording.findings if finding.code == "sensor-missing"]
    assert (finding.level, finding.axis) == ("warning", "accel")
    assert finding.text == "No accelerometer was found in the table; unused columns: 4 az."
    ready = finding.advice.removesuffix(".").rpartition(" ")[2]
    assert ready == "t=0,g=1:4,az=4"
    assert read(path, columns=ready, accel_unit="m/s^2").series[3].name == "accel_z"


def test_two_axes_with_mixed_units_or_numbers_are_refused(tmp_path: Path) -> None:
    """The wrong unit is unknown, and so is whether the numbers start at 0 or 1."""
    for header in ("t,xRate (rad/s),yRate (deg/s)", "t,gyro_1,gyro_2"):
        with raises(ChoiceError, "x, y and z of one sensor", place="log.csv", argument="columns"):
            read(write(tmp_path, header, TIMES, RATES[:, 0], RATES[:, 1]))


@pytest.mark.parametrize("columns", ["t=0,g=1+1+1", "t=0,g=1+2+1", "t=0,g=1:4,a=1:4"])
def test_a_column_named_twice_is_refused(columns: str, tmp_path: Path) -> None:
    """The column would be scaled twice. The columns text in the error works."""
    path = write(tmp_path, "", TIMES, *RATES.T)
    with raises(ChoiceError, "column 1 is named twice", place="log.csv", argument="columns"):
        read(path, columns=columns, gyro_scale=0.5, accel_scale=0.5)
    (series,) = read(path, columns="t=0,gz=1", gyro_scale=0.5).series
    assert np.array_equal(series.samples, RATES[:, 0] * 0.5)


def test_arrays_of_one_axis_are_read(tmp_path: Path) -> None:
    """Cases: NPZ with a time and one rate, and NPY with one column."""
    np.savez(tmp_path / "log.npz", t=TIMES, gz_dps=RATES[:, 2])
    (series,) = read(tmp_path / "log.npz").series
    assert series.name == "gyro_z"
    np.testing.assert_allclose(series.samples, RATES[:, 2] * DEG, rtol=1e-14)
    np.save(tmp_path / "log.npy", RATES[:, 2])
    (series,) = read(tmp_path / "log.npy", columns="gz=0", gyro_unit="rad/s", rate_hz=50.0).series
    assert np.array_equal(series.samples, RATES[:, 2])
