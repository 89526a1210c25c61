"""Recordings from decoded messages: findings about losses, order and repeats, and the index of a topic."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zstandard

from imucal.errors import ReadError
from imucal.readers import describe, message_logs, read
from imucal.readers.containers import Channel, Loss
from imucal.readers.containers.mcap import McapFile
from imucal.readers.message_logs import _loss_findings
from imucal.readers.messages.order import sort_by_log_time
from imucal.readers.messages.topics import Topic
from imucal.readers.read_options import ReadOptions
from tests.readers.logs import TOPIC, imu_messages, samples, write_db3, write_mcap


def test_losses_of_one_kind_become_one_finding() -> None:
    """Findings keep the order of their first loss and contain the total number of messages."""
    losses = [
        Loss(code="crc", text="a bad sum", messages=3),
        Loss(code="index", text="a bad index"),
        Loss(code="crc", text="another", messages=4),
    ]
    assert [(found.level, found.code, found.text) for found in _loss_findings(losses, None)] == [
        ("warning", "crc", "The log is damaged in 2 places: a bad sum; about 7 messages are lost."),
        ("warning", "index", "The log is damaged in one place: a bad index; no message is lost."),
    ]
    assert _loss_findings([], None) == []


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
def test_the_number_of_unreadable_messages_is_the_missing_part_of_the_count(
    codes: str, missing: int | None, counts: dict[str, str]
) -> None:
    """Messages of losses with a known number are subtracted."""
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
def test_the_index_gives_count_duration_and_rate_of_a_topic(
    known: list[tuple[int | None, int | None, int | None]],
    count: int | None,
    duration: float | None,
    rate: float | None,
) -> None:
    """If a file lacks a count, the total is unknown. Files without times are ignored."""
    found = topic(*known).table([], ReadOptions())
    assert (found.count, found.duration_s, found.measured_hz) == (count, duration, rate)


@pytest.mark.parametrize(
    ("stamps", "log", "rows"),
    [
        ([1, 3, 2, 4], [1, 3, 2, 4], [0, 2, 1, 3]),
        ([1, 2, 3, 4], [1, 3, 2, 4], [0, 1, 2, 3]),
        # Sorting changes nothing in the number of steps back, so the log time decides.
        ([2, 1, 4, 3], [1, 3, 2, 4], [0, 2, 1, 3]),
    ],
)
def test_samples_are_sorted_by_log_time(stamps: list[int], log: list[int], rows: list[int]) -> None:
    """Samples keep their order if sorting would increase the number of stamps out of order."""
    times = np.array(stamps), np.array(log)
    samples = [np.arange(4.0), np.arange(4.0)]
    (found,) = sort_by_log_time(*times, [*times, *samples])
    assert (found.level, found.code) == ("info", "log-out-of-order")
    kept = rows == [0, 1, 2, 3]
    assert found.text == (
        "The log time goes back 1 times and the time stamps do not; the order of the file is kept."
        if kept
        else "1 messages were out of order; they were sorted by log time."
    )
    for before, after in zip((stamps, log, range(4), range(4)), (*times, *samples), strict=True):
        assert after.tolist() == [before[row] for row in rows]


def test_a_log_in_order_is_not_changed() -> None:
    """The stamps may equal the log time, and two samples may have equal stamps."""
    times = np.array([1, 1, 2, 2])
    assert sort_by_log_time(times, times, [times, np.arange(4.0)]) == []


def test_samples_without_stamps_are_sorted_once() -> None:
    """The log time is used as their stamps."""
    times, samples = np.array([1, 3, 2, 4]), np.arange(4.0)
    assert len(sort_by_log_time(times, times, [times, samples])) == 1
    assert (times.tolist(), samples.tolist()) == ([1, 2, 3, 4], [0, 2, 1, 3])


def test_a_log_of_too_many_topics_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Finding the sensors of 60 000 topics took a quarter of an hour."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(samples(20)))
    n = len(describe(path).topics)
    monkeypatch.setattr(message_logs, "_MAX_TOPICS", n)
    describe(path)
    monkeypatch.setattr(message_logs, "_MAX_TOPICS", n - 1)
    with pytest.raises(ReadError, match=f"{n} topics; expected at most {n - 1}"):
        describe(path)


def test_fewer_messages_than_the_log_counts_are_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The counts are those of the statistics of an MCAP file."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(samples(20)))
    assert "damaged" not in {finding.code for finding in read(path).findings}
    count = McapFile._count
    monkeypatch.setattr(McapFile, "_count", lambda file, key: (count(file, key) or 0) + 1)
    finding = next(finding for finding in read(path).findings if finding.code == "damaged")
    assert finding.level == "warning"
    assert finding.text == f"The log counts 21 messages of topic {TOPIC}, and 1 of them were not found."
    with pytest.raises(ReadError, match="the log is damaged, and strict reading"):
        read(path, strict=True)


def test_a_compressed_message_of_more_than_a_megabyte_is_damage(tmp_path: Path) -> None:
    """Its head is checked before it is unpacked; messages of an IMU have 300 bytes."""
    path = next(write_db3(tmp_path / "bag", imu_messages(samples(20)), compression="message").glob("*.db3"))
    for size in ((1 << 20) + 1, 1 << 29):
        packed = zstandard.ZstdCompressor().compress(bytes(size))
        with closing(sqlite3.connect(path)) as base, base:
            base.execute("update messages set data = ?", (packed,))
        with pytest.raises(ReadError, match=f"declares {size}"):
            read(path)
