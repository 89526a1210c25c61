"""The choice of topics: each test checks one rule."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ChoiceError
from imucal.readers.choose import choose
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import Column, Table
from imucal.readers.tables.column_log import ColumnLog
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
    live: Collection[Sensor] = BOTH,
) -> Table:
    """Return a topic with columns of some sensors, or with one column `v`; those in `live` change."""
    owners = [sensor for sensor in sensors for _ in "xyz"]
    columns = [f"{sensor.short}_{axis}" for sensor in sensors for axis in "xyz"] or ["v"]
    heads = [np.arange(5.0) if sensor in live else np.ones(5) for sensor in owners] or [np.arange(5.0)]
    return Table(
        name=name,
        kind="p/Imu",
        place=f"topic {name}",
        columns=() if reason else tuple(Column(name=one, type="float64") for one in columns),
        head=lambda: heads,
        is_topic=True,
        count=count,
        weak=plain,
        reason=reason,
    )


def chosen(topics: list[Table], *named: str) -> list[tuple[str, tuple[Sensor, ...], str]]:
    """Return name, sensors and reason of each chosen topic."""
    log = ColumnLog(Path("log"), {})
    log.tables = topics
    found = choose(log, ReadOptions(topics=named))
    return [
        (one.table.name, tuple(sensor.triad.sensor for sensor in one.plan.sensors), one.how) for one in found
    ]


def pair(**live: Collection[Sensor]) -> list[Table]:
    """Return two topics, with the sensors of each that change."""
    return [topic(f"/{name}", live=live.get(name, BOTH)) for name in "ab"]


def test_the_only_imu_topic_is_chosen() -> None:
    """Empty topics, other types and plain vectors are ignored."""
    others = [topic("/empty", count=0), topic("/other", ()), topic("/plain", (GYRO,), plain=True)]
    for count in (9, 1, None):
        assert chosen([*others, topic("/imu", count=count)]) == [
            ("/imu", (GYRO, ACCEL), "the only topic with IMU samples")
        ]


def test_the_only_topic_with_changing_samples_is_chosen() -> None:
    """Each sensor can have its own topic; otherwise the user must choose."""
    assert chosen(pair(a=())) == [("/b", (GYRO, ACCEL), "the only topic whose samples change")]
    assert chosen(pair(a={ACCEL}, b={GYRO})) == [
        ("/b", (GYRO,), "gyroscope, the only topic of this sensor"),
        ("/a", (ACCEL,), "accelerometer, the only topic of this sensor"),
    ]
    cases: list[dict[str, Any]] = [{}, {"a": {GYRO}}, {"a": {GYRO}, "b": {GYRO}}, {"a": (), "b": ()}]
    for live in cases:
        with raises(ChoiceError, "2 topics carry IMU samples", place="log", argument="topic"):
            chosen(pair(**live))


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
    first, second = (name.strip("/") for name in names)
    assert [found[:2] for found in chosen(pair(**{first: {GYRO}, second: {ACCEL}}), *names)] == [
        (f"/{first}", (GYRO,)),
        (f"/{second}", (ACCEL,)),
    ]
    assert [found[:2] for found in chosen(pair(**{first: {ACCEL}, second: {GYRO}}), *names)] == [
        (f"/{second}", (GYRO,)),
        (f"/{first}", (ACCEL,)),
    ]
    cases: list[dict[str, Any]] = [
        {first: {GYRO}, second: {GYRO}},
        {first: {ACCEL}, second: {ACCEL}},
        {first: (), second: {GYRO}},
    ]
    for live in cases:
        with raises(ChoiceError, "not a gyroscope and an accelerometer", place="log", argument="topic"):
            chosen(pair(**live), *names)
    with raises(ChoiceError, "3 topics", place="log", argument="topic"):
        chosen(pair(), *names, "/a")


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
    for topics, names in (([one], ()), ([one, topic("/y", ())], ("/x",))):
        with raises(ChoiceError, "found columns: 0 v", place="topic /x", argument="columns"):
            chosen(topics, *names)
    with raises(ChoiceError, r"\n  /x.*\n  /y.*\n", place="log", argument="columns"):
        chosen([one, topic("/y", ())])
    nothing = Table(name="/z", kind="p/Imu", place="topic /z", columns=(), head=list, is_topic=True)
    with raises(ChoiceError, "/z of type p/Imu .*: its messages contain no num", place="log"):
        chosen([nothing], "/z")
