"""Edges of what a message or a topic says: stamps that are missing, and logs of very few samples."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imucal.readers.containers import Channel
from imucal.readers.containers.mcap import open_files
from imucal.readers.messages import topic_streams
from imucal.readers.messages.topic_streams import live_sensors, read_temperature
from imucal.readers.messages.topics import Topic, find_topics, table
from imucal.readers.messages.trees import _steps, _vector, stamp_of
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor
from tests.readers.logs import CONTAINERS, samples

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER


@pytest.mark.parametrize(
    ("message", "stamp"),
    [
        ({}, 0),
        ({"header": {}}, 0),
        # With a header, its stamp counts.
        ({"header": {}, "stamp": 5}, 0),
        ({"header": {"stamp": {"sec": 2, "nanosec": 3}}, "stamp": 5}, 2_000_000_003),
        ({"stamp": 5, "timestamp": 6, "time": 7}, 5),
        ({"timestamp": 6, "time": 7}, 6),
        ({"time": 7}, 7),
        ({"time": {}}, 0),
        ({"time": {"secs": 1}}, 1_000_000_000),
        ({"time": {"seconds": 1, "nanos": 4}}, 1_000_000_004),
        ({"time": {"nsec": 4}}, 4),
        ({"time": {"nsecs": 4}}, 4),
        ({"time": "noon"}, 0),
        ({"time": 1.5}, 0),
    ],
)
def test_the_stamp_of_a_json_message(message: dict[str, Any], stamp: int) -> None:
    assert stamp_of(message) == stamp


def test_the_vector_of_a_json_message() -> None:
    assert _vector({"v": {"z": 3, "x": 1, "y": "2"}}, [_steps("v")]) == [1.0, 2.0, 3.0]
    assert _vector({"v": [1, 2, 3]}, [_steps("v")]) == [1.0, 2.0, 3.0]
    assert _vector({"v": 7}, [_steps("v")]) == [7.0]
    np.testing.assert_array_equal(_vector({"v": [1, None, 3]}, [_steps("v")]), [1.0, np.nan, 3.0])
    with pytest.raises(ValueError, match="a vector of 2 numbers"):
        _vector({"v": [1, 2]}, [_steps("v")])


@pytest.mark.parametrize(("n", "alive"), [(1, {GYRO, ACCEL}), (2, {GYRO}), (3, {GYRO})])
def test_two_samples_tell_whether_a_sensor_has_data(n: int, alive: set[Sensor], tmp_path: Path) -> None:
    truth = samples(n)
    truth = replace(truth, accel=np.ones_like(truth.accel))
    options = ReadOptions()
    containers, _ = open_files(CONTAINERS["mcap-none"](tmp_path, truth))
    with closing(containers[0]):
        (topic,) = (topic for topic in find_topics(containers, options) if topic.imu is not None)
        assert live_sensors(containers, topic) == alive
        assert live_sensors(containers, replace(topic, imu=None)) == frozenset()


def channel(
    *, count: int | None = None, first_ns: int | None = None, last_ns: int | None = None
) -> tuple[int, Channel]:
    return 0, Channel(
        key=0, topic="/imu", type="", encoding="cdr", count=count, first_ns=first_ns, last_ns=last_ns
    )


@pytest.mark.parametrize(
    ("channels", "count", "span", "rate"),
    [
        ([channel()], None, None, None),
        ([channel(count=0)], 0, None, None),
        ([channel(count=1, first_ns=5, last_ns=5)], 1, (5, 5), None),
        ([channel(count=2, first_ns=0, last_ns=500_000_000)], 2, (0, 500_000_000), 2.0),
        ([channel(count=2, first_ns=5, last_ns=5)], 2, (5, 5), None),
        ([channel(count=2), channel(count=1, first_ns=0, last_ns=10**9)], 3, (0, 10**9), 2.0),
        ([channel(count=2, first_ns=0, last_ns=9), channel(first_ns=3, last_ns=12)], None, (0, 12), None),
        ([channel(count=2, first_ns=0)], 2, None, None),
    ],
)
def test_what_is_known_of_a_topic(
    channels: list[tuple[int, Channel]],
    count: int | None,
    span: tuple[int, int] | None,
    rate: float | None,
) -> None:
    topic = Topic(name="/imu", type="sensor_msgs/msg/Imu", channels=tuple(channels))
    assert (topic.count, topic.rate_hz) == (count, rate)
    assert topic.duration_s == (None if span is None else (span[1] - span[0]) / 1e9)


def test_the_table_of_topics() -> None:
    known = channel(count=101, first_ns=0, last_ns=10**9)
    topics = [
        Topic(name="/a", type="p/msg/Long", channels=(known,)),
        Topic(name="/longer", type="p/B", channels=(channel(),)),
    ]
    assert table(topics).splitlines() == [
        "  /a       p/msg/Long  101 messages  100 Hz  1 s",
        "  /longer  p/B           ? messages",
    ]
    assert table([]) == ""


@pytest.mark.parametrize(("n", "last"), [(24, "  /a  p/B  ? messages"), (25, "  and 1 more")])
def test_a_long_table_is_cut(n: int, last: str) -> None:
    lines = table([Topic(name="/a", type="p/B", channels=(channel(),))] * n).splitlines()
    assert (len(lines), lines[-1]) == (n, last)


@pytest.mark.parametrize(
    ("names", "imu", "read"),
    [
        (["/imu/temp"], "/imu/data", ["/imu/temp"]),
        (["/imu/temp", "/other/temp"], "/imu/data", ["/imu/temp"]),
        (["/other/temp"], "/imu/data", []),
        (["/imu2/temp"], "/imu/data", []),
        (["/imu/temp", "/imu/temp2"], "/imu/data", []),
        (["/imu/empty"], "/imu/data", []),
        (["/imu/text"], "/imu/data", []),
        (["/temp"], "/data", []),
    ],
)
def test_the_one_temperature_beside_an_imu_is_read(
    names: list[str], imu: str, read: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In its own namespace; others may be those of other things, and an empty one says nothing."""
    seen: list[str] = []

    def stream(topic: Topic, *_: object) -> None:
        seen.append(topic.name)

    none = SimpleNamespace(columns=SimpleNamespace(temperature=None, n=0))
    monkeypatch.setattr(topic_streams, "stream_of", stream)
    monkeypatch.setattr(topic_streams, "decode", lambda *_: [none])
    found = [
        Topic(
            name=name,
            type="std_msgs/msg/String" if name.endswith("text") else "sensor_msgs/msg/Temperature",
            channels=(channel(count=0 if name.endswith("empty") else None),),
        )
        for name in names
    ]
    assert read_temperature([], found, imu) is None
    assert seen == read
