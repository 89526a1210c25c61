"""Every container gives the samples that were written, bit by bit, and says what it holds."""

from pathlib import Path

import numpy as np
import pytest

from imucal.readers import describe, read
from imucal.recording import Sensor
from tests.readers.logs import CONTAINERS, TOPIC, samples


@pytest.mark.parametrize("name", CONTAINERS)
def test_reads_the_written_messages(name: str, tmp_path: Path) -> None:
    """Samples are bit-equal, the rate and the start are those of the stamps, nothing is found wrong."""
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
def test_describes_a_log(name: str, tmp_path: Path) -> None:
    """Topic, type, count, rate, duration and sensors, from the index."""
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
def test_a_temporary_file_gives_the_same(name: str, tmp_path: Path) -> None:
    """Above the memory limit samples live in a temporary file."""
    truth = samples(300)
    recording = read(CONTAINERS[name](tmp_path, truth), memory_limit=1000)
    for series, expected in zip(recording.series, truth.all.T, strict=True):
        assert np.array_equal(series.samples, expected)
        assert not series.samples.flags.writeable


@pytest.mark.parametrize("name", ["mcap-zstd", "bag-lz4", "db3"])
def test_tells_its_progress(name: str, tmp_path: Path) -> None:
    """Bytes done rise to bytes in all."""
    seen: list[tuple[int, int]] = []
    read(CONTAINERS[name](tmp_path, samples(300)), progress=lambda done, total: seen.append((done, total)))
    assert seen == sorted(seen)
    assert seen[-1][0] == seen[-1][1] > 0


@pytest.mark.parametrize("name", ["mcap-none", "bag-none", "db3"])
def test_log_time_on_request(name: str, tmp_path: Path) -> None:
    """The caller may prefer the time of recording."""
    truth = samples(300)
    recording = read(CONTAINERS[name](tmp_path, truth), time="log")
    assert recording.series[0].clock.source == "log time"
    assert recording.series[0].clock.start_ns == truth.log[0]
