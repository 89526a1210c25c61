"""A ROS 1 bag, byte by byte: its index section, and the scan if the section is missing or wrong."""

import struct
from collections.abc import Callable

import pytest

from imucal.errors import ReadError
from imucal.readers.containers import ros1
from imucal.readers.containers.ros1 import BagFile, Chunk, Record
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
RAW = connection(1) + message(1, SECOND + 5, b"ab") + message(2, 2 * SECOND) + message(1, 3 * SECOND, b"cd")
AT = len(connection(1))
GPS_AT = AT + len(message(1, SECOND + 5, b"ab"))
CHUNK = (
    chunk(RAW)
    + index(1, (SECOND + 5, AT), (3 * SECOND, GPS_AT + len(message(2, 2 * SECOND))))
    + index(2, (2 * SECOND, GPS_AT))
)
HEAD = len(MAGIC + bag_head(0))
SECTION = connection(1) + connection(2, b"/gps")


def bag(held: Held, section: bytes, chunks: int = 2, connections: int = 2, at: int | None = None) -> BagFile:
    """Return a bag of two chunks with an index section, which the first record counts."""
    start = HEAD + 2 * len(CHUNK) if at is None else at
    return BagFile(held(MAGIC, bag_head(start, connections, chunks), CHUNK, CHUNK, section).path)


def infos(*places: int) -> bytes:
    """Return the chunk records of the index section."""
    return b"".join(chunk_info(at, {1: 2, 2: 1}, SECOND + 5 + at, 3 * SECOND + at) for at in places)


def scanned(held: Held, *parts: bytes) -> BagFile:
    """Return a bag that was not closed."""
    return BagFile(held(MAGIC, bag_head(0), *parts).path)


def lost(bag: BagFile) -> int:
    """Return the number of lost bytes in the scan's finding."""
    text = bag.findings[-1].text
    assert text.startswith("The index can't be used (")
    assert ("cut off or damaged" in text) == (bag.findings[-1].code == "truncated" and "The last" in text)
    return int(text.partition("The last ")[2].split()[0]) if "The last" in text else 0


def test_the_index_section_describes_a_bag(held: Held) -> None:
    """Each chunk ends at the next one, the last at the index. Times and counts are totals of all chunks."""
    found = bag(held, SECTION + infos(HEAD + len(CHUNK), HEAD))
    found.close()
    assert found.findings == []
    first, second = found.channels
    assert (first.key, first.topic, first.type, first.encoding) == (1, "/imu", "a/B", "ros1")
    assert (first.definition, first.definition_kind) == ("int8 x", "ros1msg")
    assert (first.count, second.count, second.topic) == (4, 2, "/gps")
    span = (SECOND + 5 + HEAD, 3 * SECOND + HEAD + len(CHUNK))
    assert (first.first_ns, first.last_ns) == (found.start_ns, found.end_ns) == span
    assert sorted(chunk.end - chunk.start for chunk in found._chunks) == [len(CHUNK), len(CHUNK)]
    assert (found.compression, found.parallel, found.format) == ("none", True, "rosbag1")
    found = bag(held, SECTION + infos(HEAD, HEAD + len(CHUNK)))
    tasks = list(found.tasks(frozenset({2})))
    assert [task.keys for task in tasks] == [{2}, {2}]
    assert list(found.tasks(frozenset({3}))) == []
    found.close()


@pytest.mark.parametrize(
    ("section", "options", "reason"),
    [
        (SECTION + infos(HEAD), {}, "the index is cut off"),
        (SECTION + infos(HEAD, HEAD + len(CHUNK)), {"connections": 3}, "the index is cut off"),
        ((SECTION + infos(HEAD, HEAD + len(CHUNK)))[:-1], {}, "the index is cut off"),
        (SECTION + infos(HEAD, HEAD), {}, "the index points to wrong chunks"),
        (SECTION + infos(len(MAGIC), HEAD), {}, "the index points to wrong chunks"),
        (SECTION + infos(HEAD, HEAD + 2 * len(CHUNK)), {}, "the index points to wrong chunks"),
        (SECTION + record(6, {}, bytes(7)), {}, "a chunk's entry in the index is damaged"),
        (
            SECTION + chunk_info(HEAD, {1: 2, 3: 1}) + infos(HEAD + len(CHUNK)),
            {},
            "the index counts messages of unknown connections",
        ),
        (
            SECTION + chunk_info(HEAD, {1: 2, 2: 0}) + infos(HEAD + len(CHUNK)),
            {},
            "a chunk's entry in the index is damaged",
        ),
        (SECTION, {"at": 10**6}, "the index is beyond the end of the file"),
        (SECTION, {"at": len(MAGIC) - 1}, "the index is beyond the end of the file"),
        (SECTION, {"at": 0}, "the bag was not closed and has no index"),
    ],
)
def test_a_damaged_index_section_is_replaced_by_a_scan(
    section: bytes, options: dict[str, int], reason: str, held: Held
) -> None:
    """Each message is read once, and the reason is reported."""
    found = bag(held, section, **options)
    found.close()
    assert found.findings[-1].text.startswith(f"The index can't be used ({reason}); all records were scanned")
    assert {channel.key: channel.count for channel in found.channels} == {1: 4, 2: 2}
    assert (found.start_ns, found.end_ns) == (SECOND + 5, 3 * SECOND)


def test_an_empty_bag_has_an_index_right_after_its_first_record(held: Held) -> None:
    """The bag was opened and closed. A bag that ends at the start of its index is truncated."""
    found = BagFile(held(MAGIC, bag_head(HEAD), connection(1)).path)
    found.close()
    assert (found.findings, found.compression, found.start_ns, found.end_ns) == ([], "none", None, None)
    assert [(c.count, c.first_ns, c.last_ns) for c in found.channels] == [(0, None, None)]
    found = BagFile(held(MAGIC, bag_head(HEAD + len(CHUNK) * 2, 2, 2), connection(2), CHUNK, CHUNK).path)
    found.close()
    assert found.findings[-1].text.startswith("The index can't be used (")


def test_a_scan_counts_the_messages_by_index_records(held: Held) -> None:
    """Connections can be defined between chunks."""
    found = scanned(held, CHUNK, connection(2, b"/gps"), CHUNK)
    found.close()
    assert lost(found) == 0
    (finding,) = found.findings
    assert (finding.level, finding.code) == ("warning", "unindexed")
    assert {c.topic: c.count for c in found.channels} == {"/imu": 4, "/gps": 2}
    assert {(c.first_ns, c.last_ns) for c in found.channels} == {(SECOND + 5, 3 * SECOND)}
    counts, second = {1: 2, 2: 1}, HEAD + len(CHUNK) + len(connection(2, b"/gps"))
    assert found._chunks == [
        Chunk(HEAD, HEAD + len(CHUNK), counts, SECOND + 5, 3 * SECOND),
        Chunk(second, second + len(CHUNK), counts, SECOND + 5, 3 * SECOND),
    ]


def test_a_scan_counts_the_messages_of_a_chunk_without_index_records(held: Held) -> None:
    """An index record after another record belongs to no chunk."""
    found = scanned(held, chunk(RAW), connection(2, b"/gps"), index(1, (SECOND, 0)))
    found.close()
    assert found._chunks == [Chunk(HEAD, HEAD + len(chunk(RAW)), {1: 2, 2: 1}, SECOND + 5, 3 * SECOND)]


def test_a_damaged_index_record_has_no_times(held: Held) -> None:
    """The connection of the record still has messages in the chunk."""
    damaged = record(4, {b"conn": b"\x01\0\0\0"}, bytes(25))
    found = scanned(held, chunk(RAW), damaged)
    found.close()
    assert [(c.counts, c.first_ns, c.last_ns) for c in found._chunks] == [({1: 2}, 0, 0)]
    assert [task.keys for task in found.tasks(frozenset({1, 2}))] == [{1}]


def test_the_first_record_of_a_connection_is_used(held: Held) -> None:
    """Chunks repeat it; a damaged one is ignored."""
    damaged = record(7, {b"conn": bytes(3)})
    found = scanned(held, damaged, connection(1), CHUNK, connection(1, b"/other"))
    found.close()
    assert [channel.topic for channel in found.channels] == ["/imu"]


@pytest.mark.parametrize(
    ("end", "left"),
    [
        (b"", 0),
        (record(9, {}), 0),
        (record(9, {})[:-1], len(record(9, {})) - 1),
        (b"\x03\x02\x01", 3),
        (bytes(8), 8),
        (bytes(100), 100),
        (message(1, 2, b"abc")[:-1], len(message(1, 2, b"abc")) - 1),
        (struct.pack("<I", 1 << 31) + b"?" * 30, 34),
    ],
)
def test_a_scan_ends_at_the_first_incomplete_record(end: bytes, left: int, held: Held) -> None:
    """The rest of the file is lost, and its size is reported."""
    found = scanned(held, CHUNK, end)
    found.close()
    assert lost(found) == left
    assert [channel.count for channel in found.channels] == [2]
    if left:
        assert f" {left} of {found.size} bytes are cut off or damaged." in found.findings[-1].text


def test_a_truncated_chunk_is_lost(held: Held) -> None:
    """The finding counts its bytes; the chunks before it are read."""
    found = scanned(held, CHUNK, chunk(RAW)[:-1])
    found.close()
    assert lost(found) == len(chunk(RAW)) - 1
    assert len(found.findings) == 1
    assert [channel.count for channel in found.channels] == [2]


def test_a_damaged_chunk_without_index_records_is_tried_when_messages_are_read(held: Held) -> None:
    """The loss is reported when reading; the number of lost messages is unknown."""
    found = scanned(held, chunk(RAW, size=1), CHUNK)
    assert [finding.code for finding in found.findings] == ["unindexed"]
    assert [channel.count for channel in found.channels] == [None]
    first, second = found.tasks(frozenset({1}))
    with pytest.raises(DamagedError, match="has a declared size of 1"):
        list(first.load())
    assert [batch.n for _, batch in second.load()] == [2]
    found.close()


def test_a_bag_with_unknown_compression_is_refused(held: Held) -> None:
    """The error contains the name of the compression. With a damaged first record the name is unknown."""
    path = held(MAGIC, bag_head(0), chunk(RAW, b"snappy"), connection(1)).path
    with pytest.raises(ReadError) as caught:
        BagFile(path)
    assert str(caught.value) == f"{path}: chunks are compressed by 'snappy'; expected none, lz4 or bz2"
    found = bag(held, SECTION + infos(HEAD + 1, HEAD + len(CHUNK)))
    found.close()
    assert found.compression == "unknown"


def test_a_time_has_eight_bytes() -> None:
    """The bytes are seconds and nanoseconds; a missing time is 0."""
    assert Record({b"time": stamp(3 * SECOND + 4)}, 0, 0).time_ns(b"time") == 3 * SECOND + 4
    assert Record({}, 0, 0).time_ns(b"time") == 0
    assert ros1._MAX_INDEX == 2**31
