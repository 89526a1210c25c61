"""Missing stamps in messages, the description of topics, and logs of very few samples."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.readers import read as read_log
from imucal.readers.candidates import Candidate
from imucal.readers.choose import candidates_of, listing
from imucal.readers.containers import Batch, Channel
from imucal.readers.files import DamagedError
from imucal.readers.formats import open_log
from imucal.readers.messages.topics import Topic
from imucal.readers.messages.trees import TreeDecoder, leaves_of_tree
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor
from tests.readers.logs import CONTAINERS, Message, header, imu_messages, samples, store, write_mcap

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER


def decoded(path: str, *messages: object) -> np.ndarray[Any, np.dtype[Any]]:
    """Return the values at a path in JSON messages."""
    texts = [json.dumps(message).encode() for message in messages]
    sizes = np.array([len(text) for text in texts])
    starts = np.cumsum(sizes) - sizes
    _, found = TreeDecoder([path]).decode(Batch(b"".join(texts), starts, sizes, np.arange(sizes.size)))
    return found


@pytest.mark.parametrize(
    ("message", "leaf", "stamp"),
    [
        ({"header": {"stamp": {"sec": 2, "nanosec": 3}}}, "header.stamp time", 2_000_000_003),
        ({"t": {"secs": 1, "nsecs": 4}}, "t time", 1_000_000_004),
        ({"t": {"nanos": 4, "seconds": 1}}, "t time", 1_000_000_004),
        ({"stamp": 5}, "stamp number", 5),
        ({"time": 1.5}, "time number", 1.5),
        ({"time": None}, "time number", np.nan),
        ({"time": [1, {}, "a"]}, None, None),
        ({"time": {"sec": 1.5, "nsec": 4}}, "time.sec number", None),
        ({"time": {"sec": 1}}, "time.sec number", None),
        ({"time": {"sec": 1, "nsec": 2, "more": 3}}, "time.sec number", None),
    ],
)
def test_seconds_and_nanoseconds_of_json_messages_are_one_time(
    message: dict[str, Any], leaf: str | None, stamp: float | None
) -> None:
    """Other members of the message are separate fields."""
    found = [str(one) for one in leaves_of_tree(message)]
    assert found[:1] == ([leaf] if leaf else [])
    if leaf is not None and stamp is not None:
        np.testing.assert_array_equal(decoded(leaf.partition(" ")[0], message), [stamp])


def test_integers_of_json_messages_keep_their_digits() -> None:
    """A null becomes NaN, and an integer of 65 bits is damage."""
    big = 1_700_000_000_000_000_001
    assert decoded("v[1]", {"v": [0, big]}).tolist() == [big]
    np.testing.assert_array_equal(decoded("a.x", {"a": {"x": 1}}, {"a": {"x": None}}), [1, np.nan])
    assert decoded("a", {"a": "2"}, {"a": 0.5}).tolist() == [2.0, 0.5]
    damaged: list[tuple[str, dict[str, Any]]] = [
        ("a", {"a": 1 << 64}),
        ("a", {"b": 1}),
        ("v[2]", {"v": [1]}),
        ("t", {"t": {"sec": 1}}),
    ]
    for path, message in damaged:
        with pytest.raises(DamagedError, match="a JSON message has no IMU sample: "):
            decoded(path, message)


@pytest.mark.parametrize(("n", "alive"), [(1, {GYRO, ACCEL}), (2, {GYRO}), (3, {GYRO})])
def test_two_samples_decide_whether_a_sensor_has_data(n: int, alive: set[Sensor], tmp_path: Path) -> None:
    truth = samples(n)
    truth = replace(truth, accel=np.ones_like(truth.accel))
    path = CONTAINERS["mcap-none"](tmp_path, truth)
    with open_log(path, ReadOptions()) as log:
        (candidate,) = (one for one in candidates_of(log, ReadOptions()) if one.sensors)
        assert candidate.alive == alive
        assert [sensor.triad.sensor for sensor in candidate.plan.sensors] == [GYRO, ACCEL]


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
def test_properties_of_a_topic(
    channels: list[tuple[int, Channel]],
    count: int | None,
    span: tuple[int, int] | None,
    rate: float | None,
) -> None:
    topic = Topic(name="/imu", type="sensor_msgs/msg/Imu", channels=tuple(channels))
    table = topic.table([], ReadOptions())
    assert (table.count, table.measured_hz) == (count, rate)
    assert table.duration_s == (None if span is None else (span[1] - span[0]) / 1e9)


def candidate(topic: Topic) -> Candidate:
    """Return a topic of a log without files."""
    return Candidate(topic.table([], ReadOptions()), ReadOptions())


def test_the_table_of_topics_has_aligned_columns() -> None:
    known = channel(count=101, first_ns=0, last_ns=10**9)
    topics = [
        Topic(name="/a", type="p/msg/Long", channels=(known,)),
        Topic(name="/longer", type="p/B", channels=(channel(),)),
    ]
    assert listing(list(map(candidate, topics))).splitlines() == [
        "  /a       p/msg/Long  101 messages  100 Hz  1 s",
        "  /longer  p/B           ? messages",
    ]
    assert listing([]) == ""


@pytest.mark.parametrize(("n", "last"), [(24, "  /a  p/B  ? messages"), (25, "  and 1 more")])
def test_a_long_table_of_topics_is_cut(n: int, last: str) -> None:
    one = candidate(Topic(name="/a", type="p/B", channels=(channel(),)))
    lines = listing([one] * n).splitlines()
    assert (len(lines), lines[-1]) == (n, last)


def temperatures(topic: str, degrees: float) -> list[Message]:
    """Return 40 messages of a temperature, or of a text if the topic's name says so."""
    types = store()
    kind = "std_msgs/msg/String" if topic.endswith("text") else "sensor_msgs/msg/Temperature"
    messages = []
    for stamp, log in zip(samples(40).stamps.tolist(), samples(40).log.tolist(), strict=True):
        if kind == "std_msgs/msg/String":
            content = types.types[kind](data="warm")
        else:
            content = types.types[kind](header=header(types, stamp), temperature=degrees, variance=0.0)
        messages.append(
            Message(topic=topic, type=kind, log=log, data=bytes(types.serialize_cdr(content, kind)))
        )
    return messages


@pytest.mark.parametrize(
    ("names", "imu", "read"),
    [
        (["/imu/temp"], "/imu/data", "/imu/temp"),
        (["/imu/temp", "/other/temp"], "/imu/data", "/imu/temp"),
        (["/other/temp"], "/imu/data", None),
        (["/imu2/temp"], "/imu/data", None),
        (["/imu/temp", "/imu/temp2"], "/imu/data", None),
        (["/imu/empty"], "/imu/data", None),
        (["/imu/text"], "/imu/data", None),
        (["/temp"], "/data", None),
    ],
)
def test_the_only_temperature_in_the_imus_namespace_is_read(
    names: list[str], imu: str, read: str | None, tmp_path: Path
) -> None:
    """Temperatures in other namespaces can belong to other devices, and empty topics are ignored."""
    messages = imu_messages(samples(40), topic=imu)
    for number, name in enumerate(names):
        if not name.endswith("empty"):
            messages += temperatures(name, 20.0 + number)
    heat = read_log(write_mcap(tmp_path / "log.mcap", messages)).temperature
    expected = None if read is None else 20.0 + names.index(read)
    assert (None if heat is None else float(heat.samples[0])) == expected
