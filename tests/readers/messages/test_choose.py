"""The choice of topics: each test checks one rule."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from imucal.errors import ChoiceError
from imucal.readers.containers import Channel
from imucal.readers.messages.choice import choose
from imucal.readers.messages.topics import Column, Topic
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor
from tests.raising import raises

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
BOTH = (GYRO, ACCEL)


def topic(
    name: str,
    sensors: tuple[Sensor, ...] = BOTH,
    count: int | None = 9,
    reason: str = "",
    *,
    plain: bool = False,
) -> Topic:
    """Return a topic with one channel."""
    channel = Channel(key=0, topic=name, type="p/Imu", encoding="cdr", count=count)
    return Topic(
        name=name,
        type="p/Imu",
        channels=((0, channel),),
        columns=() if reason else (Column("v", "v", "float64"),),
        sensors=sensors,
        plain=plain,
        reason=reason,
    )


def chosen(topics: list[Topic], *named: str, **live: Any) -> list[tuple[str, tuple[Sensor, ...], str]]:  # noqa: ANN401
    """Return name, sensors and reason of each chosen topic; `live` has the sensors that change."""

    def alive(one: Topic) -> frozenset[Sensor]:
        return frozenset(live.get(one.name.strip("/"), {GYRO, ACCEL}))

    found = choose(Path("log"), topics, ReadOptions(topics=named), alive)
    return [(choice.topic.name, choice.sensors, choice.how) for choice in found]


def test_the_only_imu_topic_is_chosen() -> None:
    """Empty topics, other types and plain vectors are ignored."""
    others = [topic("/empty", count=0), topic("/other", ()), topic("/plain", (GYRO,), plain=True)]
    for count in (9, 1, None):
        assert chosen([*others, topic("/imu", count=count)]) == [
            ("/imu", (GYRO, ACCEL), "the only topic with IMU samples")
        ]


def test_the_only_topic_with_changing_samples_is_chosen() -> None:
    """Each sensor can have its own topic; otherwise the user must choose."""
    pair = [topic("/a"), topic("/b")]
    assert chosen(pair, a=()) == [("/b", (GYRO, ACCEL), "the only topic whose samples change")]
    assert chosen(pair, a={ACCEL}, b={GYRO}) == [
        ("/b", (GYRO,), "gyroscope, the only topic of this sensor"),
        ("/a", (ACCEL,), "accelerometer, the only topic of this sensor"),
    ]
    for live in ({}, {"a": {GYRO}}, {"a": {GYRO}, "b": {GYRO}}, {"a": (), "b": ()}):
        with raises(ChoiceError, "2 topics carry IMU samples", place="log", argument="topic"):
            chosen(pair, **live)


def test_a_named_topic_is_chosen() -> None:
    """The leading slash is optional. Of topics with the same name, the one with samples is chosen."""
    topics = [topic("/imu", ()), topic("/imu"), topic("/b")]
    assert chosen(topics, "imu") == [("/imu", (GYRO, ACCEL), "as given")]
    with raises(ChoiceError, "/c of type p/Imu .*: too odd", place="log"):
        chosen([topic("/c", (), reason="too odd")], "/c")
    with raises(ChoiceError, "/e has no messages", place="log", argument="topic"):
        chosen([topic("/e", count=0)], "/e")
    with raises(ChoiceError, r"no topic /d; .*\n  /imu", place="log", argument="topic"):
        chosen(topics, "/d")


@pytest.mark.parametrize("names", [("/a", "/b"), ("/b", "/a")])
def test_two_named_topics_are_one_for_each_sensor(names: tuple[str, str]) -> None:
    """The order is free, and both topics must change."""
    pair = [topic("/a"), topic("/b")]
    first, second = (name.strip("/") for name in names)
    assert [found[:2] for found in chosen(pair, *names, **{first: {GYRO}, second: {ACCEL}})] == [
        (f"/{first}", (GYRO,)),
        (f"/{second}", (ACCEL,)),
    ]
    assert [found[:2] for found in chosen(pair, *names, **{first: {ACCEL}, second: {GYRO}})] == [
        (f"/{second}", (GYRO,)),
        (f"/{first}", (ACCEL,)),
    ]
    for live in (
        {first: {GYRO}, second: {GYRO}},
        {first: {ACCEL}, second: {ACCEL}},
        {first: (), second: {GYRO}},
    ):
        with raises(ChoiceError, "not a gyroscope and an accelerometer", place="log", argument="topic"):
            chosen(pair, *names, **live)
    with raises(ChoiceError, "3 topics", place="log", argument="topic"):
        chosen(pair, *names, "/a")


def test_the_error_lists_the_available_topics() -> None:
    """Cases: plain vectors, an unreadable type, empty topics, and no topics."""
    with raises(ChoiceError, r"vectors without a known meaning; .*\n  /p", place="log", argument="topic"):
        chosen([topic("/p", (GYRO,), plain=True)])
    with raises(ChoiceError, r"no topic carries a gyroscope .*; found\n  /p", place="log"):
        chosen([topic("/p", (GYRO,), count=0, plain=True)])
    broken = topic("/x", (), reason="no definition")
    with raises(ChoiceError, "/x of type p/Imu .*: no definition$", place="log"):
        chosen([topic("/o", ()), broken])
    with raises(ChoiceError, r"; found\n  /x", place="log"):
        chosen([topic("/x", (), count=0, reason="no definition")])
    with raises(ChoiceError, r"\n  no topics$", place="log"):
        chosen([])


def test_a_topic_without_sensor_names_is_chosen_if_named_or_alone() -> None:
    """The error about its columns lists them, as for a table without names."""
    one = topic("/x", ())
    assert chosen([one]) == [("/x", BOTH, "the only topic")]
    assert chosen([one, topic("/y", ())], "/x") == [("/x", BOTH, "as given")]
    with raises(ChoiceError, r"\n  /x.*\n  /y.*\n", place="log", argument="columns"):
        chosen([one, topic("/y", ())])
    with raises(ChoiceError, "/z of type p/Imu .*: its messages contain no num", place="log"):
        chosen([replace(one, name="/z", columns=())], "/z")
