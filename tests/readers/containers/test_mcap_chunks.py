"""Chunks of an MCAP file, byte by byte: read by their index, or record by record if it is wrong."""

import struct
from collections.abc import Callable

import pytest

from imucal.readers.containers.container import Batch
from imucal.readers.containers.mcap import MAGIC, McapFile, each_record, unpack, walk_records
from imucal.readers.files import DamagedError
from tests.readers.containers.mcap_bytes import channel, chunk, index, message, record, schema

McapOf = Callable[..., McapFile]
#: Two channels whose messages alternate; a message without data is the shortest one.
RECORDS = message(1, 10, b"abcd") + message(2, 20) + message(1, 30, b"efgh") + message(2, 40)
FIRST, SECOND = ((10, 0), (30, 66)), ((20, 35), (40, 101))


def payloads(batch: Batch) -> list[bytes]:
    """Return the payloads of a batch."""
    return [bytes(data) for data in batch.messages()]


def loaded(mcap_of: McapOf, raw: bytes, *indexes: bytes) -> dict[int, Batch]:
    """Return channel -> its messages in a chunk that some message indexes follow."""
    file = mcap_of(MAGIC, schema(1), channel(1), channel(2, b"/gps"), chunk(raw), *indexes)
    (task,) = file.tasks(frozenset({1, 2}))
    found = dict(task.load())
    assert found.keys() == task.keys
    return found


def test_a_chunk_gives_the_messages_of_its_index(mcap_of: McapOf) -> None:
    """Each channel has its own index."""
    found = loaded(mcap_of, RECORDS, index(1, *FIRST), index(2, *SECOND))
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b"", b""]}
    assert {key: batch.log_ns.tolist() for key, batch in found.items()} == {1: [10, 30], 2: [20, 40]}
    assert all(batch.loss is None for batch in found.values())


def test_a_chunk_without_an_index_is_read_record_by_record(mcap_of: McapOf) -> None:
    """The result is the same, and nothing is reported."""
    found = loaded(mcap_of, RECORDS)
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b"", b""]}
    assert {key: batch.log_ns.tolist() for key, batch in found.items()} == {1: [10, 30], 2: [20, 40]}
    assert all(batch.loss is None for batch in found.values())
    assert {key: batch.n for key, batch in loaded(mcap_of, message(2, 5)).items()} == {2: 1}


def test_a_chunk_can_contain_a_single_message(mcap_of: McapOf) -> None:
    batch = loaded(mcap_of, message(1, 5, b"a"), index(1, (5, 0)))[1]
    assert (payloads(batch), batch.loss) == ([b"a"], None)


def test_a_channel_without_an_index_has_no_messages_in_a_chunk_with_others(mcap_of: McapOf) -> None:
    """An empty index is treated like a missing one."""
    assert list(loaded(mcap_of, RECORDS, index(1, *FIRST))) == [1]
    assert list(loaded(mcap_of, RECORDS, index(1, *FIRST), index(2))) == [1]


@pytest.mark.parametrize(
    "entries",
    [
        ((10, 0), (30, 65)),  # one byte too early
        ((10, 1), (30, 66)),
        ((10, 0), (30, 35)),  # a message of the other channel
        ((10, 35), (30, 66)),
        ((10, 0), (30, 1 << 40)),  # beyond the chunk
        ((10, 1 << 40), (30, 66)),
        ((10, 0), (30, (1 << 64) - 31)),  # before it
        ((10, (1 << 64) - 31), (30, 66)),
        ((10, len(RECORDS)), (30, 66)),
        ((10, 0), (0, 0)),  # zeros
    ],
)
def test_a_wrong_message_index_is_not_used(entries: tuple[tuple[int, int], ...], mcap_of: McapOf) -> None:
    """All messages are read, and the batch reports the damage."""
    found = loaded(mcap_of, RECORDS, index(1, *entries), index(2, *SECOND))
    assert payloads(found[1]) == [b"abcd", b"efgh"]
    assert found[1].log_ns.tolist() == [10, 30]
    assert found[1].loss is not None
    assert found[1].loss.code == "index"
    assert found[1].loss.text in {
        "a message index points to wrong records; all records of its chunk were read instead",
        "a message extends beyond its chunk; all records of its chunk were read instead",
    }
    assert (payloads(found[2]), found[2].loss) == ([b"", b""], None)


def test_messages_of_a_chunk_can_have_different_sizes(mcap_of: McapOf) -> None:
    raw = message(1, 10, b"abcd") + message(1, 20, b"") + message(1, 30, b"efghi")
    batch = loaded(mcap_of, raw, index(1, (10, 0), (20, 35), (30, 66)))[1]
    assert (payloads(batch), batch.loss) == ([b"abcd", b"", b"efghi"], None)
    assert batch.log_ns.tolist() == [10, 20, 30]


@pytest.mark.parametrize(("length", "complete"), [(21, False), (22, True), (26, True), (27, False)])
def test_a_message_ends_within_its_chunk(length: int, complete: bool, mcap_of: McapOf) -> None:  # noqa: FBT001
    """The last message may end with the chunk; a message has at least 22 bytes."""
    raw = bytearray(message(1, 10, b"abcd") + message(1, 30, b"efgh"))
    struct.pack_into("<Q", raw, 36, length)
    batch = loaded(mcap_of, bytes(raw), index(1, (10, 0), (30, 35)))[1]
    assert payloads(batch) == ([b"abcd", b"efgh"[: length - 22]] if complete else [b"abcd"])
    assert (batch.loss is None) == complete


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (RECORDS, {1: [0, 66], 2: [35, 101]}),
        (RECORDS[:-1], {1: [0, 66], 2: [35]}),
        (RECORDS[:66], {1: [0], 2: [35]}),
        (message(1, 1) + bytes(40) + message(1, 2), {1: [0]}),
        (channel(7) + message(1, 1), {1: [len(channel(7))]}),
        (record(5, bytes(21)) + message(1, 1), {1: [30]}),
        (b"", {}),
    ],
    ids=["whole", "a byte short", "a message short", "zeros", "a channel first", "too short", "empty"],
)
def test_reading_records_stops_at_the_first_incomplete_one(
    raw: bytes, expected: dict[int, list[int]]
) -> None:
    """Zeros end the reading too; other records are skipped."""
    assert walk_records(raw) == expected


def test_records_are_found_by_their_length() -> None:
    raw = channel(7) + message(1, 1)
    assert list(each_record(raw)) == [(4, 0, len(channel(7))), (5, len(channel(7)), len(raw))]


@pytest.mark.parametrize(
    "damaged",
    [
        b"\x07" + chunk(RECORDS)[1:],
        chunk(RECORDS) + b"?",
        chunk(RECORDS)[:-1],
        chunk(RECORDS)[:37] + b"\xff" * 4 + chunk(RECORDS)[41:],
        chunk(RECORDS)[:41] + struct.pack("<Q", len(RECORDS) + 1) + RECORDS,
        chunk(RECORDS)[:40],
    ],
    ids=["other opcode", "longer", "shorter", "long name", "more data", "cut"],
)
def test_a_chunk_with_a_damaged_head_is_not_unpacked(damaged: bytes) -> None:
    assert bytes(unpack(memoryview(chunk(RECORDS)))) == RECORDS
    with pytest.raises(DamagedError, match=r"^a chunk's head is damaged$"):
        unpack(memoryview(damaged))
