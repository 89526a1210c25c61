"""What is made of decoded messages: losses in words, order, repeats; and what the index of a topic tells."""

import numpy as np
import pytest

from imucal.readers.containers import Channel, Loss
from imucal.readers.message_logs import _loss_findings, in_time_order
from imucal.readers.messages.topics import Topic, _said
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import Columns, Room
from imucal.recording import Sensor

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER


def test_losses_in_words() -> None:
    """One finding for each kind, in the order met, with the places and the messages of all."""
    losses = [
        Loss(code="crc", text="a bad sum", messages=3),
        Loss(code="index", text="a bad index"),
        Loss(code="crc", text="another", messages=4),
    ]
    assert [(found.level, found.code, found.text) for found in _loss_findings(losses)] == [
        ("warning", "crc", "The log is damaged in 2 places: a bad sum; about 7 messages are lost."),
        ("warning", "index", "The log is damaged in one place: a bad index; no message is lost."),
    ]
    assert _loss_findings([]) == []


@pytest.mark.parametrize(
    ("codes", "missing", "counts"),
    [
        ("a", 7, {"a": "about 7 messages are lost"}),
        ("aa", 0, {"a": "no message is lost"}),
        ("a", None, {"a": "the number of lost messages is unknown"}),
        ("ac", 7, {"a": "about 7 messages are lost", "c": "about 3 messages are lost"}),
        ("ab", 7, dict.fromkeys("ab", "about 7 messages are lost in all unreadable parts")),
    ],
)
def test_messages_of_unreadable_parts(codes: str, missing: int | None, counts: dict[str, str]) -> None:
    """Their number is what the file counts and no other part contained."""
    losses = [Loss(code=code, text="bad", messages=3 if code == "c" else None) for code in codes]
    found = {finding.code: finding.text for finding in _loss_findings(losses, missing)}
    assert {code: text.partition("bad; ")[2] for code, text in found.items()} == {
        code: f"{count}." for code, count in counts.items()
    }


def topic(*known: tuple[int | None, int | None, int | None]) -> Topic:
    """Return a topic of channels with count, first and last time."""
    channels = tuple(
        (
            number,
            Channel(
                key=number,
                topic="/imu",
                type="sensor_msgs/msg/Imu",
                encoding="cdr",
                count=count,
                first_ns=first,
                last_ns=last,
            ),
        )
        for number, (count, first, last) in enumerate(known)
    )
    return Topic(name="/imu", type="sensor_msgs/msg/Imu", channels=channels)


@pytest.mark.parametrize(
    ("known", "count", "duration", "rate"),
    [
        ([(11, 0, 10**9)], 11, 1.0, 10.0),
        ([(11, 10**9, 2 * 10**9), (10, 0, 3 * 10**9)], 21, 3.0, 20 / 3),
        ([(11, 0, 10**9), (None, None, None)], None, 1.0, None),
        ([(11, None, None)], 11, None, None),
        ([(11, 0, None)], 11, None, None),
        ([(11, None, 10**9)], 11, None, None),
        ([(2, 5, 5)], 2, 0.0, None),
        ([(1, 0, 10**9)], 1, 1.0, None),
        ([(2, 0, 10**9)], 2, 1.0, 1.0),
        ([(0, None, None)], 0, None, None),
    ],
)
def test_what_an_index_tells(
    known: list[tuple[int | None, int | None, int | None]],
    count: int | None,
    duration: float | None,
    rate: float | None,
) -> None:
    """Over all files; what one of them does not know is not known, except the time."""
    found = topic(*known)
    assert (found.count, found.duration_s, found.rate_hz) == (count, duration, rate)


def test_what_the_caller_says_of_two_topics() -> None:
    """The first is the gyroscope; one alone, or of three, says nothing."""
    two = ReadOptions(topics=("/a", "/b"))
    assert [_said(name, two) for name in ("/a", "/b", "/c")] == [GYRO, ACCEL, None]
    assert _said("/a", ReadOptions(topics=("/a",))) is None
    assert _said("/a", ReadOptions(topics=("/a", "/b", "/c"))) is None


def columns(
    stamps: list[int], log: list[int] | None = None, sensors: tuple[Sensor, ...] = (GYRO, ACCEL)
) -> Columns:
    """Return columns whose samples are the number of the row, from 0."""
    times = [np.array(stamps), np.array(stamps if log is None else log)]
    axes = [np.arange(len(stamps), dtype=np.float64) for _ in range(3 * len(sensors))]
    return Columns([*times, *axes], dict.fromkeys(sensors, 3))


def test_the_order_of_the_log_time() -> None:
    """Samples are sorted, unless that brings more stamps out of order than there were."""
    held = columns([1, 3, 2, 4], [1, 3, 2, 4])
    (found,) = in_time_order(held, Room())
    assert (found.level, found.code) == ("info", "log-out-of-order")
    assert found.text == ("1 messages were out of order; they were sorted by log time.")
    assert held.vectors[GYRO][0].tolist() == [0, 2, 1, 3]
    held = columns([1, 2, 3, 4], [1, 3, 2, 4])
    (found,) = in_time_order(held, Room())
    assert (found.level, found.code) == ("info", "log-out-of-order")
    assert found.text == (
        "The log time goes back 1 times and the time stamps do not; the order of the file is kept."
    )
    assert held.vectors[GYRO][0].tolist() == [0, 1, 2, 3]
    # As many steps back before and behind: the log time decides.
    held = columns([2, 1, 4, 3], [1, 3, 2, 4])
    assert len(in_time_order(held, Room())) == 1
    assert held.vectors[GYRO][0].tolist() == [0, 2, 1, 3]
    assert in_time_order(columns([1, 1, 2, 2]), Room()) == []
