"""Values that no sensor measures: a bit that flipped, a counter in place of a rate, far too small numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucal.allan import allan_curve
from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.errors import ChoiceError, DataError, ReadError
from imucal.fitting import METHODS, fit
from imucal.pipeline import Settings, characterize
from imucal.readers import read
from imucal.recording import AxisSeries, Recording, Sensor
from tests.raising import raises

N = 1500
RATE = 100.0
NOISE = 1e-3 * np.random.default_rng(55101).standard_normal((N, 6)) + (0, 0, 0, 0.1, 0.2, 9.8)
HEADER = "time_s,gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)"


def written(path: Path, values: FloatArray) -> Path:
    rows = np.column_stack([np.arange(N) / RATE, values])
    np.savetxt(path, rows, delimiter=",", header=HEADER, comments="", fmt="%.12g")
    return path


def two_axes(path: Path) -> Recording:
    """Return the axes y and z of the accelerometer, of which z has the strange value."""
    recording = read(path)
    return replace(recording, series=recording.series[4:])


def axis(samples: FloatArray) -> AxisSeries:
    return AxisSeries(
        sensor=Sensor.GYROSCOPE, axis="x", samples=samples, clock=Clock.even(samples.size, RATE)
    )


@pytest.mark.parametrize(
    ("value", "method"),
    [(9.8e78, method) for method in METHODS] + [(1e16, "mle"), (-3e40, "mle"), (1e300, "mle")],
)
def test_a_flipped_bit_is_left_out_and_named(tmp_path: Path, value: float, method: str) -> None:
    """The other samples are fitted as if the sample were missing."""
    values = NOISE.copy()
    values[700, 5] = value
    report = characterize(two_axes(written(tmp_path / "log.csv", values)), Settings(method=method))
    found = [finding for finding in report["accel_z"].findings if finding.code == "not-finite"]
    assert len(found) == 1
    assert report["accel_z"].samples == N - 1
    assert report["accel_z"]["N"].value == pytest.approx(report["accel_y"]["N"].value, rel=0.2)


@pytest.mark.parametrize("value", [1e6, 1e10, 1e14])
def test_a_possible_but_huge_value_is_a_spike(tmp_path: Path, value: float) -> None:
    values = NOISE.copy()
    values[700, 5] = value
    report = characterize(two_axes(written(tmp_path / "log.csv", values)))
    assert "spikes" in {finding.code for finding in report["accel_z"].findings}
    assert report["accel_z"]["N"].value == pytest.approx(report["accel_y"]["N"].value, rel=0.2)


def test_only_huge_values_have_no_result(tmp_path: Path) -> None:
    recording = read(written(tmp_path / "log.csv", NOISE * 1e78), gyro_unit="rad/s", accel_unit="m/s^2")
    with pytest.raises(DataError, match="all are NaN, infinite or absurdly large"):
        characterize(recording)


@pytest.mark.parametrize("size", [1e-40, 1e-100, 1e-150, 1e-300])
@pytest.mark.parametrize("method", METHODS)
def test_far_too_small_values_are_refused(size: float, method: str) -> None:
    """Their fourth powers are zero in double precision."""
    series = axis(NOISE[:, 0] * size)
    with raises(DataError, "all samples are equal", place="gyro_x"):
        allan_curve(series)
    with raises(DataError, "all samples are equal", place="gyro_x"):
        fit(series, method=method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("step", [1.0, 1e-3, -0.25])
def test_a_straight_line_is_a_counter(method: str, step: float) -> None:
    with raises(DataError, "one straight line", place="gyro_x"):
        fit(axis(step * np.arange(N, dtype=np.float64)), method=method)


def test_straight_lines_on_all_axes_of_a_sensor_have_no_result(tmp_path: Path) -> None:
    """The other sensor is fitted."""
    values = NOISE.copy()
    values[:, :3] = np.arange(N)[:, None] * (1e-3, 2e-3, 5e-3)
    report = characterize(read(written(tmp_path / "log.csv", values)))
    without = {finding.axis for finding in report.findings if finding.code == "no-result"}
    assert without == {"gyro_x", "gyro_y", "gyro_z"}
    assert {one.name for one in report.axes} == {"accel_x", "accel_y", "accel_z"}


@pytest.mark.parametrize("columns", [None, "t=0,g=1:4,a=4:7"])
def test_texts_in_the_time_column_are_quoted(tmp_path: Path, columns: str | None) -> None:
    """As MATLAB writes a duration; the proposed columns must not be tried again and again."""
    path = written(tmp_path / "log.csv", NOISE)
    first, *rows = path.read_text(encoding="utf-8").splitlines()
    lines = [row.replace(",", " sec,", 1) for row in rows]
    path.write_text("\n".join([first, *lines]), encoding="utf-8")
    with raises(ChoiceError, "'0 sec'", place="log.csv"):
        read(path, columns=columns)


def test_durations_of_pandas_are_times(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", NOISE)
    first, *rows = path.read_text(encoding="utf-8").splitlines()
    seconds = np.arange(N) / RATE + 86395.0
    days = [
        f"{int(s // 86400)} days {int(s % 86400 // 3600):02d}:{int(s % 3600 // 60):02d}:{s % 60:09.6f}"
        for s in seconds
    ]
    lines = [day + row[row.index(",") :] for day, row in zip(days, rows, strict=True)]
    path.write_text("\n".join([first.replace("time_s", "time"), *lines]), encoding="utf-8")
    recording = read(path)
    assert recording.series[0].rate_hz == pytest.approx(RATE, rel=1e-9)
    assert recording.series[0].clock.missing == 0


def test_an_integer_of_thousands_of_digits_is_no_count(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    line = '{"t":' + "9" * 5000 + ',"gyro":[0.1,0.2,0.3]}\n'
    path.write_text(line * 100, encoding="utf-8")
    with pytest.raises((ReadError, DataError)):
        read(path, gyro_unit="rad/s")
