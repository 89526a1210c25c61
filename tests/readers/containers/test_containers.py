"""Every container gives the written samples, bit by bit, and a description of its content."""

from pathlib import Path

import numpy as np
import pytest

from imucal.readers import describe, read
from imucal.recording import Sensor
from tests.readers.logs import CONTAINERS, TOPIC, samples


@pytest.mark.parametrize("name", CONTAINERS)
def test_the_written_messages_are_read(name: str, tmp_path: Path) -> None:
    """Samples are bit-equal, rate and start are those of the stamps, and there are no findings."""
    truth = samples(300)
    recording = read(CONTAINERS[name](tmp_path, truth))
    assert [series.name for series in recording.series] == [
        "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z",
    ]  # fmt: skip
    for series, expected in zip(recording.series, truth.all.T, strict=True):
        assert np.array_equal(series.samples, expected)
        assert series.clock.source == "header stamp"
        assert series.clock.start_ns == truth.stamps[0]
        assert series.rate_hz == pytest.approx(100.0, rel=1e-9)
        assert len(series.clock.segments) == 1
    assert recording.source.topics == (TOPIC,)
    assert [finding.code for finding in recording.findings] == ["delay"]


@pytest.mark.parametrize("name", CONTAINERS)
def test_a_log_is_described_from_its_index(name: str, tmp_path: Path) -> None:
    """The description has topic, type, count, rate, duration and sensors."""
    contents = describe(CONTAINERS[name](tmp_path, samples(300)))
    (topic,) = contents.topics
    assert topic.name == TOPIC
    assert topic.type.replace("/msg/", "/") == "sensor_msgs/Imu"
    assert topic.count == 300
    assert topic.rate_hz == pytest.approx(100.0)
    assert topic.duration_s == pytest.approx(2.99)
    assert topic.sensors == (Sensor.GYROSCOPE, Sensor.ACCELEROMETER)
    assert contents.findings == ()


@pytest.mark.parametrize("name", ["mcap-zstd", "bag-lz4", "db3"])
def test_progress_increases_to_the_total(name: str, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    read(CONTAINERS[name](tmp_path, samples(300)), progress=lambda done, total: seen.append((done, total)))
    assert seen == sorted(seen)
    assert seen[-1][0] == seen[-1][1] > 0


@pytest.mark.parametrize("name", ["mcap-none", "bag-none", "db3"])
def test_the_log_time_can_be_requested(name: str, tmp_path: Path) -> None:
    truth = samples(300)
    recording = read(CONTAINERS[name](tmp_path, truth), time="log")
    assert recording.series[0].clock.source == "log time"
    assert recording.series[0].clock.start_ns == truth.log[0]
