"""Every known header style gives the right axes, units and rate."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.readers.formats import describe_log as describe
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.recording import Recording, Sensor
from tests.readers.tables.texts import STYLES, N, Style, truth, write


def options(style: Style) -> ReadOptions:
    given: dict[str, Any] = dict(style.options)
    return replace(ReadOptions(), **given)


def layout_of(recording: Recording) -> str:
    return dict(recording.source.decisions).get("layout", "").partition(",")[0]


@pytest.mark.parametrize("style", STYLES, ids=lambda style: style.name)
def test_a_header_style_gives_axes_units_rate_and_layout(style: Style, tmp_path: Path) -> None:
    """The decisions on columns, units and time have a source, which the report shows."""
    recording = read(write(style, tmp_path), options(style))
    expected = [name for name, there in (("gyro", style.gyro), ("accel", style.accel)) if there]
    assert [series.name for series in recording.series] == [f"{s}_{axis}" for s in expected for axis in "xyz"]
    assert layout_of(recording) == style.layout
    true = truth()
    for series in recording.series:
        values = true.gyro if series.sensor is Sensor.GYROSCOPE else true.accel
        column = values[:, "xyz".index(series.axis)]
        assert series.rate_hz == pytest.approx(style.rate, rel=1e-6)
        assert series.clock.missing == 0
        assert series.n == N
        if style.tolerance == 0:
            npt.assert_array_equal(series.samples, column)
        else:
            # The tolerance covers one conversion of units each way, or the digits of the style.
            npt.assert_allclose(series.samples, column, rtol=style.tolerance, atol=style.tolerance)
    decisions = dict(recording.source.decisions)
    for sensor in {series.sensor for series in recording.series}:
        assert decisions[f"{sensor} columns"]
        assert decisions[f"{sensor} unit"]
    assert decisions["time"]


@pytest.mark.parametrize("name", ["EuRoC", "ArduPilot", "VectorNav INSTINCT", "WitMotion", "phyphox zip"])
def test_describe_reports_layout_count_and_rate(name: str, tmp_path: Path) -> None:
    style = next(style for style in STYLES if style.name == name)
    contents = describe(write(style, tmp_path), options(style))
    (topic,) = contents.topics
    assert contents.format == "csv"
    assert topic.type == (style.layout or "table")
    assert topic.count == N
    assert topic.rate_hz == pytest.approx(style.rate, rel=1e-6)
    assert set(topic.sensors) == {Sensor.GYROSCOPE, Sensor.ACCELEROMETER}


def test_each_sensor_of_sensorlog_has_its_own_clock(tmp_path: Path) -> None:
    """The time of logging is not used."""
    style = next(style for style in STYLES if style.name == "SensorLog")
    recording = read(write(style, tmp_path), options(style))
    gyro, accel = recording.axis("gyroscope", "x").clock, recording.axis("accelerometer", "x").clock
    assert gyro.source == "column gyroTimestamp_sinceReboot(s)"
    assert accel.source == "column accelerometerTimestamp_sinceReboot(s)"
    assert (gyro.start_ns, accel.start_ns) == (1_000_000_000_000, 1_000_003_000_000)


def test_sensors_of_one_table_share_a_clock(tmp_path: Path) -> None:
    style = next(style for style in STYLES if style.name == "EuRoC")
    recording = read(write(style, tmp_path), options(style))
    assert len({id(series.clock) for series in recording.series}) == 1
    assert recording.series[0].clock.start_ns == 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("name", "expected"), [("ArduPilot", 31.5), ("WitMotion", 25.1), ("VectorNav INSTINCT", 21.5)]
)
def test_a_temperature_column_is_read(name: str, expected: float, tmp_path: Path) -> None:
    """The temperature has the clock of the sensor."""
    style = next(style for style in STYLES if style.name == name)
    recording = read(write(style, tmp_path), options(style))
    assert recording.temperature is not None
    npt.assert_array_equal(recording.temperature.samples, np.full(N, expected))
    assert recording.temperature.clock is recording.series[0].clock


def test_a_folder_is_read_like_a_zip(tmp_path: Path) -> None:
    """The folder of a phone app contains the gyroscope and the accelerometer with gravity."""
    import zipfile

    style = next(style for style in STYLES if style.name == "Sensor Logger zip")
    folder = tmp_path / "log"
    with zipfile.ZipFile(write(style, tmp_path)) as archive:
        archive.extractall(folder)
    recording = read(folder, ReadOptions())
    npt.assert_array_equal(recording.axis("accelerometer", "z").samples, truth().accel[:, 2])
    assert dict(recording.source.decisions)["files"] == "Gyroscope.csv, TotalAcceleration.csv"
