"""Real bags: every IMU topic is bit-equal to what rosbags decodes."""

from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError
from imucal.readers import read
from imucal.recording import Recording
from tests.real_data import real_data

SAME = ("real", "mpu6050", "same_samples_every_format")


def rows(recording: Recording) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the samples, shape (n, 6)."""
    return np.array([series.samples for series in recording.series]).T


def by_rosbags(path: Path, topic: str) -> tuple[list[int], list[list[float]]]:
    """Return stamps and samples as rosbags decodes them."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    stamps, samples = [], []
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == topic]
        for connection, _, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp  # type: ignore[attr-defined]
            w = message.angular_velocity  # type: ignore[attr-defined]
            a = message.linear_acceleration  # type: ignore[attr-defined]
            stamps.append(stamp.sec * 10**9 + stamp.nanosec)
            samples.append([w.x, w.y, w.z, a.x, a.y, a.z])
    return stamps, samples


@pytest.mark.parametrize(
    ("parts", "topic"),
    [
        ((*SAME, "imu_lz4.bag"), "/imu/data_raw"),
        ((*SAME, "imu_bz2.bag"), "/imu/data_raw"),
        ((*SAME, "ros2_mcap"), "/imu/data_raw"),
        ((*SAME, "ros2_sqlite3"), "/imu/data_raw"),
        (("formats", "novatel_ins1.bag"), "/gps/imu"),
        (("formats", "robot_localization_test1_husky.bag"), "/imu/data"),
    ],
    ids=lambda value: value[-1] if isinstance(value, tuple) else "",
)
def test_samples_of_real_bags_equal_those_of_rosbags(parts: tuple[str, ...], topic: str) -> None:
    path = real_data(*parts)
    stamps, expected = by_rosbags(path, topic)
    recording = read(path, topic=topic if path.name.startswith("novatel") else None)
    assert recording.source.topics == (topic,)
    npt.assert_array_equal(rows(recording), expected)
    assert recording.series[0].clock.start_ns == stamps[0]


def test_a_bag_that_rosbags_refuses_is_read() -> None:
    """One of its two publishers adds a byte to each message; the log has 50 Hz and 61 s."""
    recording = read(real_data("formats", "robot_localization_test2_jackal.bag"))
    series = recording.axis("accelerometer", "z")
    assert series.n == 3061
    assert series.rate_hz == pytest.approx(50, rel=1e-6)
    assert series.samples.mean() == pytest.approx(9.8, abs=0.3)


def test_all_formats_of_one_recording_are_equal() -> None:
    """There are five files; the SQLite bag contains the first 20,000 samples."""
    names = ("imu_si.csv", "imu_lz4.bag", "imu_bz2.bag", "ros2_mcap", "ros2_sqlite3")
    recordings = {name: read(real_data(*SAME, name)) for name in names}
    first = rows(recordings["imu_lz4.bag"])
    assert first.shape == (44_930, 6)
    for name, recording in recordings.items():
        found = rows(recording)
        if name.endswith(".csv"):
            # The CSV has nine digits.
            npt.assert_allclose(found, first, rtol=1e-8, atol=1e-9)
        else:
            assert np.array_equal(found, first[: len(found)]), name
        assert len(found) == (20_000 if name == "ros2_sqlite3" else 44_930)
        # A CSV may contain stamps in ns or in float seconds since 1970.
        assert recording.series[0].rate_hz == pytest.approx(100, rel=1e-9), name


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("foxglove_example.bag", "no topic carries a gyroscope or an accelerometer; found"),
        ("rosbag2_wbag_0.mcap", "no topic carries a gyroscope or an accelerometer; found"),
        ("rosbag2_cdr_test_0.db3", "no topic carries a gyroscope or an accelerometer; found"),
    ],
)
def test_a_bag_without_imu_is_refused_with_the_reason(name: str, message: str) -> None:
    """The error lists the topics of the bag."""
    path = real_data("formats", name)
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: {message}\n  ")
    assert "may be read by" not in str(caught.value)
