"""Which topics are taken, from what is known of them: one rule a case."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from imucal.errors import ChoiceError
from imucal.readers.containers import Channel
from imucal.readers.messages.message_types import ImuFields, Vector
from imucal.readers.messages.topics import Topic, choose
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
BOTH = ImuFields(stamp=None, vectors=tuple(Vector(sensor=s, paths=("v",)) for s in (GYRO, ACCEL)))
PLAIN = replace(BOTH, vectors=BOTH.vectors[:1], plain=True)


def topic(name: str, imu: ImuFields | None = BOTH, count: int | None = 9, reason: str = "") -> Topic:
    """Return a topic."""
    channel = Channel(key=0, topic=name, type="p/M", encoding="cdr", count=count)
    return Topic(name=name, type="p/M", channels=((0, channel),), imu=imu, reason=reason)


def chosen(topics: list[Topic], *named: str, **live: Any) -> list[tuple[str, tuple[Sensor, ...], str]]:  # noqa: ANN401
    """Return name, sensors and reason of what is taken; `live` is what changes, all by default."""

    def alive(one: Topic) -> frozenset[Sensor]:
        return frozenset(live.get(one.name.strip("/"), {GYRO, ACCEL}))

    found = choose(Path("log"), topics, ReadOptions(topics=named), alive)
    return [(choice.topic.name, choice.sensors, choice.how) for choice in found]


def test_the_only_one_is_taken() -> None:
    """Empty topics, other types and plain vectors beside it are passed over."""
    others = [topic("/empty", count=0), topic("/other", None), topic("/plain", PLAIN)]
    for count in (9, 1, None):
        assert chosen([*others, topic("/imu", count=count)]) == [
            ("/imu", (GYRO, ACCEL), "the only topic with IMU samples")
        ]


def test_of_several_the_one_whose_samples_change() -> None:
    """Or one for each sensor; else nothing is chosen."""
    pair = [topic("/a"), topic("/b")]
    assert chosen(pair, a=()) == [("/b", (GYRO, ACCEL), "the only topic whose samples change")]
    assert chosen(pair, a={ACCEL}, b={GYRO}) == [
        ("/b", (GYRO,), "gyroscope, the only topic of this sensor"),
        ("/a", (ACCEL,), "accelerometer, the only topic of this sensor"),
    ]
    for live in ({}, {"a": {GYRO}}, {"a": {GYRO}, "b": {GYRO}}, {"a": (), "b": ()}):
        with pytest.raises(ChoiceError, match=r"^log: 2 topics carry IMU samples; choose one"):
            chosen(pair, **live)


def test_a_named_topic_is_taken() -> None:
    """With or without its slash; the one of its name that carries samples."""
    topics = [topic("/imu", None), topic("/imu"), topic("/b")]
    assert chosen(topics, "imu") == [("/imu", (GYRO, ACCEL), "as given")]
    with pytest.raises(ChoiceError, match=r"topic /c of type p/M can't be read: too odd"):
        chosen([topic("/c", None, reason="too odd")], "/c")
    with pytest.raises(ChoiceError, match=r"^log: topic /e has no messages; found"):
        chosen([topic("/e", count=0)], "/e")
    with pytest.raises(ChoiceError, match=r"^log: there is no topic /d; choose one of these topics\n  /imu"):
        chosen(topics, "/d")


@pytest.mark.parametrize("names", [("/a", "/b"), ("/b", "/a")])
def test_two_named_topics_are_one_for_each_sensor(names: tuple[str, str]) -> None:
    """In either order; both must change."""
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
        with pytest.raises(ChoiceError, match="the two topics are not a gyroscope and an accelerometer"):
            chosen(pair, *names, **live)
    with pytest.raises(ChoiceError, match="3 topics are named; expected one, or one for each sensor"):
        chosen(pair, *names, "/a")


def test_what_is_there_instead_is_said() -> None:
    """Vectors that may be anything, a type that can't be read, or the topics there are."""
    with pytest.raises(
        ChoiceError, match="only vectors without a known meaning; choose one of these topics\n  /p"
    ):
        chosen([topic("/p", PLAIN)])
    with pytest.raises(ChoiceError, match=r"no topic carries a gyroscope .*; found\n  /p"):
        chosen([topic("/p", PLAIN, count=0)])
    broken = topic("/x", None, reason="no definition")
    with pytest.raises(ChoiceError, match=r"^log: topic /x of type p/M can't be read: no definition$"):
        chosen([topic("/o", None), broken])
    with pytest.raises(ChoiceError, match=r"; found\n  /x"):
        chosen([topic("/x", None, count=0, reason="no definition")])
    with pytest.raises(ChoiceError, match=r"; found\n  no topics$"):
        chosen([])
