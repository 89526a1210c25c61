"""A ROS 1 bag, byte by byte: the scan of its records, and the counts at its end."""

import struct
from collections.abc import Callable

import pytest

from imucal.errors import ReadError
from imucal.readers.containers import ros1
from imucal.readers.containers.container import Batch
from imucal.readers.containers.ros1 import BagFile, Record
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
    text,
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
    """Return the number of lost bytes at the end in the scan's finding."""
    (finding,) = bag.findings
    _, cut, rest = finding.text.partition("The last ")
    assert finding.text.endswith("All complete chunks were read.")
    if not cut:
        return 0
    assert finding.code == "truncated"
    assert f" of {bag.size} bytes are cut off or damaged." in rest
    return int(rest.split()[0])


def counts(bag: BagFile) -> dict[int, int | None]:
    """Return connection -> number of its messages."""
    return {channel.key: channel.count for channel in bag.channels}


def batches(bag: BagFile, key: int) -> list[Batch]:
    """Return the messages of a connection by chunk."""
    return [batch for task in bag.tasks(frozenset({key})) for _, batch in task.load()]


def test_a_bag_is_described(held: Held) -> None:
    """Times and counts are totals of all chunks."""
    found = bag(held, SECTION + infos(HEAD + len(CHUNK), HEAD))
    assert found.findings == []
    first, second = found.channels
    assert (first.key, first.topic, first.type, first.encoding) == (1, "/imu", "a/B", "ros1")
    assert (first.definition, first.definition_kind) == ("int8 x", "ros1msg")
    assert (first.count, second.count, second.topic) == (4, 2, "/gps")
    assert (first.first_ns, first.last_ns) == (found.start_ns, found.end_ns) == (SECOND + 5, 3 * SECOND)
    assert (second.first_ns, second.last_ns) == (2 * SECOND, 2 * SECOND)
    assert (found.compression, found.parallel, found.format) == ("none", True, "rosbag1")
    tasks = list(found.tasks(frozenset({2})))
    assert [task.keys for task in tasks] == [{2}, {2}]
    assert [task.size for task in tasks] == [len(chunk(RAW))] * 2
    assert list(found.tasks(frozenset({3}))) == []
    found.close()


BOTH = SECTION + infos(HEAD, HEAD + len(CHUNK))


@pytest.mark.parametrize(
    ("section", "options", "code", "text"),
    [
        (SECTION + infos(HEAD), {}, "truncated", "The index at the end of the bag is incomplete."),
        (BOTH, {"connections": 3}, "truncated", "The index at the end of the bag is incomplete."),
        (BOTH, {"chunks": 3}, "truncated", "The index at the end of the bag is incomplete."),
        (SECTION, {"at": 10**6}, "truncated", "The index at the end of the bag is incomplete."),
        (BOTH[:-1], {}, "truncated", "The last "),
        (SECTION + record(6, {}, bytes(7)), {}, "truncated", "The last "),
        (SECTION, {"at": 0}, "unindexed", "The bag was not closed."),
    ],
)
def test_an_incomplete_end_of_a_bag_is_reported(
    section: bytes, options: dict[str, int], code: str, text: str, held: Held
) -> None:
    """Each message is read once."""
    found = bag(held, section, **options)
    (finding,) = found.findings
    assert (finding.level, finding.code) == ("warning", code)
    assert finding.text.startswith(text)
    assert counts(found) == {1: 4, 2: 2}
    assert [batch.n for batch in batches(found, 1)] == [2, 2]
    assert (found.start_ns, found.end_ns) == (SECOND + 5, 3 * SECOND)
    found.close()


@pytest.mark.parametrize(
    ("stated", "count"),
    [
        ({1: 2, 2: 0}, 4),
        ({1: 2, 3: 1}, 4),
        ({1: 0}, 4),
        ({1: 3, 2: 1}, 5),
        # Each message takes at least twelve bytes.
        ({1: (1 << 32) - 1, 2: 1}, None),
    ],
)
def test_the_counts_at_the_end_only_raise_the_number_of_messages(
    stated: dict[int, int], count: int | None, held: Held
) -> None:
    """Fewer messages than counted are reported as lost; all messages are read."""
    found = bag(held, SECTION + chunk_info(HEAD, stated) + infos(HEAD + len(CHUNK)))
    assert counts(found) == {1: found.size // 12 if count is None else count, 2: 2}
    assert [batch.n for batch in batches(found, 1)] == [2, 2]
    found.close()


def test_chunks_that_are_listed_at_the_end_and_not_found_are_counted(held: Held) -> None:
    """So that the loss of their messages is reported."""
    found = bag(held, SECTION + infos(HEAD, HEAD + len(CHUNK), HEAD + 5))
    assert counts(found) == {1: 6, 2: 3}
    assert [batch.n for batch in batches(found, 1)] == [2, 2]
    found.close()


def test_counts_at_the_end_of_chunks_at_other_positions_are_compared(held: Held) -> None:
    """Bytes were inserted, so positions at the end are wrong, and no message is lost."""
    found = BagFile(held(MAGIC, bag_head(HEAD + 2 * len(CHUNK), 2, 2), b"?" * 9, CHUNK, CHUNK, BOTH).path)
    assert [finding.code for finding in found.findings] == ["damaged"]
    assert counts(found) == {1: 4, 2: 2}
    assert [batch.n for batch in batches(found, 1)] == [2, 2]
    found.close()


@pytest.mark.parametrize("most", [0, 1])
def test_the_search_for_the_next_chunk_is_limited(
    most: int, held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file full of fields that look like a chunk's would take hours."""
    monkeypatch.setattr(ros1, "_MAX_CANDIDATES", most)
    found = scanned(held, CHUNK, b"?" * 30, CHUNK)
    assert counts(found) == {1: 2 + 2 * most}
    assert [finding.code for finding in found.findings] == ["damaged" if most else "truncated"]
    found.close()


@pytest.mark.parametrize("rest", [b"", index(1)])
def test_the_messages_of_a_connection_without_an_index_record_are_counted(rest: bytes, held: Held) -> None:
    """The end of the bag counts them, so that their loss is reported."""
    lacking = chunk(RAW) + rest + index(2, (2 * SECOND, GPS_AT))
    info = chunk_info(HEAD, {1: 2, 2: 1})
    found = BagFile(held(MAGIC, bag_head(HEAD + len(lacking), 2, 1), lacking, SECTION, info).path)
    assert counts(found) == {1: 2, 2: 1}
    assert batches(found, 1) == []
    assert [batch.n for batch in batches(found, 2)] == [1]
    found.close()


def test_an_empty_bag_has_connections(held: Held) -> None:
    """The bag was opened and closed."""
    found = BagFile(held(MAGIC, bag_head(HEAD), connection(1)).path)
    found.close()
    assert (found.findings, found.compression, found.start_ns, found.end_ns) == ([], "none", None, None)
    assert [(c.count, c.first_ns, c.last_ns) for c in found.channels] == [(0, None, None)]


def test_messages_are_counted_by_index_records(held: Held) -> None:
    """Connections can be defined between chunks."""
    found = scanned(held, CHUNK, connection(2, b"/gps"), CHUNK)
    found.close()
    assert lost(found) == 0
    (finding,) = found.findings
    assert (finding.level, finding.code) == ("warning", "unindexed")
    assert finding.text == "The bag was not closed. All complete chunks were read."
    assert {c.topic: c.count for c in found.channels} == {"/imu": 4, "/gps": 2}


def test_the_messages_of_a_chunk_without_index_records_are_counted(held: Held) -> None:
    """An index record after another record belongs to no chunk."""
    found = scanned(held, chunk(RAW), connection(2, b"/gps"), index(1, (SECOND, 0)))
    assert counts(found) == {1: 2, 2: 1}
    assert [(c.first_ns, c.last_ns) for c in found.channels] == [
        (SECOND + 5, 3 * SECOND),
        (2 * SECOND, 2 * SECOND),
    ]
    assert [(batch.n, batch.loss) for batch in batches(found, 1)] == [(2, None)]
    found.close()


@pytest.mark.parametrize(
    "damaged",
    [
        record(4, {b"conn": b"\x01\0\0\0"}, bytes(25)),
        record(4, {b"conn": b"\x01\0\0"}, bytes(12)),
        record(12, {b"conn": b"\x01\0\0\0"}, bytes(12)),
        record(4, {b"nnoc": b"\x01\0\0\0"}, bytes(12)),
        index(2, (2 * SECOND, GPS_AT)),
        index(9, (SECOND + 5, AT)),
        b"?" * 40,
    ],
)
def test_a_chunk_with_a_damaged_index_record_is_searched(damaged: bytes, held: Held) -> None:
    """All messages of the chunk are read, although the bag was not closed."""
    gps = index(2, (2 * SECOND, GPS_AT))
    found = scanned(held, connection(2, b"/gps"), chunk(RAW), gps, damaged, CHUNK)
    assert counts(found) == {1: 4, 2: 2}
    assert [batch.n for batch in batches(found, 1)] == [2, 2]
    assert [batch.n for batch in batches(found, 2)] == [1, 1]
    found.close()


@pytest.mark.parametrize("damaged", [b"?" * 50, bytes(50), chunk(RAW)[1:], b"op=\x05" * 20])
def test_the_chunks_after_a_damaged_part_are_read(damaged: bytes, held: Held) -> None:
    """Bytes were inserted or deleted, or a sector is damaged; the next chunk is found by its header."""
    found = scanned(held, CHUNK, damaged, CHUNK)
    (finding,) = found.findings
    assert finding.code == "damaged"
    at = HEAD + len(CHUNK)
    assert f"The bag is damaged in one place ({len(damaged)} bytes at byte {at}: " in finding.text
    assert counts(found) == {1: 4}
    assert [batch.n for batch in batches(found, 1)] == [2, 2]
    found.close()


def test_a_chunk_is_found_across_searched_blocks(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """The length of the damaged part decides which block contains the header of the next chunk."""
    monkeypatch.setattr(ros1, "_SEARCHED", 100)
    for size in range(1, 220):
        found = scanned(held, CHUNK, b"?" * size, CHUNK)
        assert counts(found) == {1: 4}
        found.close()


def test_an_unfinished_chunk_is_lost(held: Held) -> None:
    """A killed recorder leaves a chunk of size 0, followed by its messages."""
    rest = chunk(b"") + RAW
    found = scanned(held, CHUNK, rest)
    found.close()
    assert lost(found) == len(rest)
    assert counts(found) == {1: 2}


def test_the_first_record_of_a_connection_is_used(held: Held) -> None:
    """Chunks repeat it; a damaged one is ignored."""
    damaged = record(7, {b"conn": bytes(3)})
    found = scanned(held, damaged, CHUNK, connection(1), CHUNK, connection(1, b"/other"))
    found.close()
    assert [channel.topic for channel in found.channels] == ["/imu"]


@pytest.mark.parametrize(
    ("end", "left"),
    [
        (b"", 0),
        (record(9, {}), len(record(9, {}))),
        (message(1, 2), len(message(1, 2))),
        (record(9, {})[:-1], len(record(9, {})) - 1),
        (b"\x03\x02\x01", 3),
        (bytes(8), 8),
        (bytes(100), 100),
        (message(1, 2, b"abc")[:-1], len(message(1, 2, b"abc")) - 1),
        (struct.pack("<I", 1 << 31) + b"?" * 30, 34),
    ],
)
def test_a_scan_ends_at_the_last_complete_record(end: bytes, left: int, held: Held) -> None:
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
    """The error contains the name of the compression."""
    path = held(MAGIC, bag_head(0), chunk(RAW, b"snappy"), connection(1)).path
    with pytest.raises(ReadError) as caught:
        BagFile(path)
    assert str(caught.value) == f"{path}: chunks are compressed by 'snappy'; expected none, lz4 or bz2"


def test_a_time_has_eight_bytes() -> None:
    """The bytes are seconds and nanoseconds; a missing time is 0."""
    assert Record(text(b"time=" + stamp(3 * SECOND + 4)), 0, 0).time_ns(b"time") == 3 * SECOND + 4
    assert Record(b"", 0, 0).time_ns(b"time") == 0
