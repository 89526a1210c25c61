"""Chunks of a ROS 1 bag, byte by byte: read by their index records, or sequentially if those are wrong."""

import bz2
import struct
from collections.abc import Callable
from contextlib import closing

import pytest

from imucal.readers.containers.container import Batch
from imucal.readers.containers.ros1 import BagFile, unpack, walk
from imucal.readers.files import DamagedError, LogFile
from tests.readers.containers.ros1_bytes import (
    MAGIC,
    bag_head,
    chunk,
    chunk_info,
    connection,
    index,
    message,
    record,
    stamp,
)

Held = Callable[..., LogFile]
SECOND = 10**9
CONNECTION = connection(1)
MESSAGES = [message(1, SECOND + 5, b"abcd"), message(2, 7, b""), message(1, 2 * SECOND + 6, b"efgh")]
RAW = CONNECTION + b"".join(MESSAGES)
FIRST = len(CONNECTION)
SECOND_AT, THIRD = FIRST + len(MESSAGES[0]), FIRST + len(MESSAGES[0]) + len(MESSAGES[1])
ONE, TWO = index(1, (SECOND + 5, FIRST), (2 * SECOND + 6, THIRD)), index(2, (7, SECOND_AT))
ELSEWHERE = "an index record points to wrong records; all records of its chunk were read instead"
BEYOND = "a message extends beyond its chunk; all records of its chunk were read instead"


def payloads(batch: Batch) -> list[bytes]:
    """Return the payloads of a batch."""
    return [bytes(data) for data in batch.messages()]


def bag(held: Held, *parts: bytes, closed: bool = True) -> BagFile:
    """Return a bag of one chunk and its index records; the end of a closed bag counts its messages."""
    start = len(MAGIC + bag_head(0))
    end = start + len(b"".join(parts))
    section = connection(1) + connection(2) + chunk_info(start, {1: 2, 2: 1})
    head = bag_head(end if closed else 0, 2, 1)
    return BagFile(held(MAGIC, head, *parts, *([section] if closed else [])).path)


def messages(file: BagFile) -> dict[int, Batch]:
    """Return connection -> its messages, and close the bag."""
    with closing(file):
        tasks = list(file.tasks(frozenset({1, 2})))
        return {key: batch for task in tasks for key, batch in task.load()}


def loaded(held: Held, *parts: bytes, closed: bool = True) -> dict[int, Batch]:
    """Return connection -> its messages in the chunk of a bag."""
    return messages(bag(held, *parts, closed=closed))


def test_index_records_give_the_messages_and_times_of_a_chunk(held: Held) -> None:
    found = loaded(held, chunk(RAW), ONE, TWO)
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b""]}
    assert found[1].log_ns.tolist() == [SECOND + 5, 2 * SECOND + 6]
    assert found[2].log_ns.tolist() == [7]
    assert {batch.loss for batch in found.values()} == {None}


def test_an_index_entry_can_point_to_a_connection_record(held: Held) -> None:
    """Recorders let the entry point to the connection record before the first message."""
    found = loaded(held, chunk(RAW), index(1, (SECOND + 5, 0), (2 * SECOND + 6, THIRD)), TWO)
    assert (payloads(found[1]), found[1].loss) == ([b"abcd", b"efgh"], None)


def test_messages_of_a_chunk_can_have_different_sizes(held: Held) -> None:
    raw = message(1, 5, b"abc") + message(1, 6, b"") + message(1, 7, b"defgh")
    first, second = len(message(1, 5, b"abc")), len(message(1, 5, b"abc") + message(1, 6))
    batch = loaded(held, chunk(raw), index(1, (5, 0), (6, first), (7, second)))[1]
    assert (payloads(batch), batch.loss) == ([b"abc", b"", b"defgh"], None)


def test_the_fields_of_a_header_can_have_any_order(held: Held) -> None:
    """A message with another order is parsed separately, and nothing is reported."""
    other = record(2, {b"time": stamp(5), b"conn": b"\x01\0\0\0"}, b"abc")
    batch = loaded(held, chunk(other + message(1, 6, b"def")), index(1, (5, 0), (6, len(other))))[1]
    assert (payloads(batch), batch.loss) == ([b"abc", b"def"], None)


@pytest.mark.parametrize("at", range(len(message(1, 5)) - 4))
def test_a_damaged_header_is_reported(at: int, held: Held) -> None:
    """Any byte of the first of two headers may differ, except the size of the data."""
    raw = bytearray(message(1, 5, b"abc") + message(1, 6, b"def"))
    raw[at] ^= 1
    batch = loaded(held, chunk(bytes(raw)), index(1, (5, 0), (6, len(raw) // 2)))[1]
    # A time of seven bytes is read correctly, because the last byte is zero.
    assert (batch.loss is None) == (at == 25)


@pytest.mark.parametrize(
    ("first", "last"),
    [
        (FIRST + 1, THIRD),
        (FIRST, THIRD - 1),
        (SECOND_AT, THIRD),
        (FIRST, SECOND_AT),
        (SECOND_AT, SECOND_AT),
        (THIRD, THIRD),
        (FIRST, len(RAW)),
        (FIRST, 1 << 31),
        (1 << 31, THIRD),
    ],
)
def test_a_wrong_index_record_is_not_used(first: int, last: int, held: Held) -> None:
    """An entry points beyond the chunk, into a record, to another connection, or twice to a message."""
    batch = loaded(held, chunk(RAW), index(1, (SECOND + 5, first), (2 * SECOND + 6, last)), TWO)[1]
    assert payloads(batch) == [b"abcd", b"efgh"]
    assert batch.log_ns.tolist() == [SECOND + 5, 2 * SECOND + 6]
    assert batch.loss is not None
    assert batch.loss.code == "index"
    assert batch.loss.text in {ELSEWHERE, BEYOND}


def test_only_connections_are_skipped(held: Held) -> None:
    """An index entry must not point to other records before the message."""
    other = record(9, {})
    raw = other + message(1, 5, b"abc") + message(1, 6, b"def")
    entries = index(1, (5, 0), (6, len(other) + len(message(1, 5, b"abc"))))
    batch = loaded(held, chunk(raw), entries)[1]
    assert payloads(batch) == [b"abc", b"def"]
    assert batch.loss is not None


@pytest.mark.parametrize(
    "parts",
    [
        (TWO[:-1],),
        (TWO, ONE[:-1]),
        (TWO, record(9, {}), ONE),
        (TWO, bytes(8), ONE),
        (TWO, record(4, {b"conn": bytes(3), b"count": bytes(4)}, bytes(12)), ONE),
        (TWO, record(4, {b"conn": b"\x01\0\0\0", b"count": b"\x02\0\0\0"}, bytes(23))),
    ],
)
@pytest.mark.parametrize("closed", [False, True])
def test_a_damaged_index_record_is_reported(
    parts: tuple[bytes, ...],
    held: Held,
    closed: bool,  # noqa: FBT001
) -> None:
    """The chunk is read record by record, and the bytes without a following chunk are reported as lost."""
    file = bag(held, chunk(RAW), *parts, closed=closed)
    found = messages(file)
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b""]}
    assert [finding.code for finding in file.findings] == ["truncated"]


@pytest.mark.parametrize("closed", [False, True])
def test_a_chunk_without_index_records_is_read_record_by_record(held: Held, closed: bool) -> None:  # noqa: FBT001
    """Nothing is lost, so nothing is reported."""
    found = loaded(held, chunk(RAW), closed=closed)
    assert payloads(found[1]) == [b"abcd", b"efgh"]
    assert found[1].loss is None
    assert found[1].log_ns.tolist() == [SECOND + 5, 2 * SECOND + 6]


def test_a_chunk_is_unpacked_up_to_the_end_of_its_record() -> None:
    for data in (chunk(RAW), chunk(bz2.compress(RAW), b"bz2", len(RAW))):
        assert bytes(unpack(memoryview(data + b"more"))) == RAW
    without = record(5, {b"size": struct.pack("<I", 3)}, b"abc")
    assert bytes(unpack(memoryview(without))) == b"abc"
    with pytest.raises(DamagedError, match=r"^a chunk's head is damaged$"):
        unpack(memoryview(message(1, 2)))
    with pytest.raises(DamagedError, match=r"^a chunk's head is damaged$"):
        unpack(memoryview(chunk(RAW)[:-1]))
    with pytest.raises(DamagedError, match=r"has a declared size"):
        unpack(memoryview(chunk(RAW, size=len(RAW) + 1)))


@pytest.mark.parametrize("end", [b"", MESSAGES[0][:-1], MESSAGES[0][:3], bytes(8), record(9, {})[:-1]])
def test_reading_records_stops_at_the_first_incomplete_one(end: bytes) -> None:
    """Complete records of all kinds are included."""
    assert [opcode for opcode, _ in walk(memoryview(RAW + end))] == [7, 2, 2, 2]


def test_a_message_without_a_time_is_read(held: Held) -> None:
    """The recording time of the message is 0."""
    bare = record(2, {b"conn": b"\x01\0\0\0"}, b"yz")
    batch = loaded(held, chunk(bare + record(9, {b"conn": b"\x01\0\0\0"})))[1]
    assert (payloads(batch), batch.log_ns.tolist()) == ([b"yz"], [0])
