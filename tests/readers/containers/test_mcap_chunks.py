"""The chunks of an MCAP file, byte by byte: by their index, and walked where that is wrong."""

import struct
from collections.abc import Callable

import pytest

from imucal.readers.containers.container import Batch
from imucal.readers.containers.mcap import (
    ChunkIndex,
    Loose,
    index_count,
    index_entries,
    load_chunk,
    unpack,
    walk_records,
)
from imucal.readers.files import DamagedError, LogFile
from tests.readers.containers.mcap_bytes import channel, chunk, index, message, record

Held = Callable[..., LogFile]
# Two channels that take turns; a message without data is the shortest there is.
RECORDS = message(1, 10, b"abcd") + message(2, 20) + message(1, 30, b"efgh") + message(2, 40)
AT = {1: (0, 66), 2: (35, 101)}


def payloads(batch: Batch) -> list[bytes]:
    """Return what the messages of a batch hold."""
    return [bytes(data) for data in batch.messages()]


def loaded(held: Held, raw: bytes, *indexes: tuple[int, tuple[tuple[int, int], ...]]) -> dict[int, Batch]:
    """Return channel -> its messages in a chunk with some indexes: channel, then entries."""
    places, data = {}, chunk(raw)
    entry = ChunkIndex(start=3, length=len(data), compression="")
    for key, entries in indexes:
        places[key] = 3 + len(data)
        data += index(key, *entries)
    entry.index_length, entry.indexes = len(data) - entry.length, places
    return dict(load_chunk(held(b"???", data), entry, frozenset({1, 2})))


def test_a_chunk_gives_the_messages_of_its_index(held: Held) -> None:
    """Those of each channel, and no others; the entries say where they are."""
    found = loaded(held, RECORDS, (1, ((10, 0), (30, 66))), (2, ((20, 35), (40, 101))))
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b"", b""]}
    assert {key: batch.log_ns.tolist() for key, batch in found.items()} == {1: [10, 30], 2: [20, 40]}
    for batch in found.values():
        assert batch.loss is None


def test_a_chunk_without_an_index_is_walked(held: Held) -> None:
    """The same messages, and their times."""
    found = loaded(held, RECORDS)
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b"", b""]}
    assert {key: batch.log_ns.tolist() for key, batch in found.items()} == {1: [10, 30], 2: [20, 40]}
    assert list(loaded(held, message(2, 5))) == [2]


def test_one_message_may_be_all_there_is(held: Held) -> None:
    """The model of a chunk is its first message."""
    batch = loaded(held, message(1, 5, b"a"), (1, ((5, 0),)))[1]
    assert (payloads(batch), batch.loss) == ([b"a"], None)


def test_a_channel_that_the_index_leaves_out_has_no_messages_there(held: Held) -> None:
    """An empty index is the same."""
    assert list(loaded(held, RECORDS, (1, ((10, 0), (30, 66))))) == [1]
    found = loaded(held, RECORDS, (1, ((10, 0), (30, 66))), (2, ()))
    assert {key: batch.n for key, batch in found.items()} == {1: 2, 2: 0}


@pytest.mark.parametrize(
    "entries",
    [
        ((10, 0), (30, 65)),  # one byte off
        ((10, 1), (30, 66)),
        ((10, 0), (30, 35)),  # a message of the other channel
        ((10, 35), (30, 66)),
        ((10, 0), (30, 1 << 40)),  # beyond the chunk
        ((10, 1 << 40), (30, 66)),
        ((10, 0), (30, (1 << 64) - 31)),  # before it
        ((10, (1 << 64) - 31), (30, 66)),
        ((10, len(RECORDS)), (30, 66)),
    ],
)
def test_an_index_that_points_elsewhere_is_walked_around(
    entries: tuple[tuple[int, int], ...], held: Held
) -> None:
    """All messages are there, and the batch reports it."""
    batch = loaded(held, RECORDS, (1, entries))[1]
    assert payloads(batch) == [b"abcd", b"efgh"]
    assert batch.log_ns.tolist() == [10, 30]
    assert batch.loss is not None
    assert (batch.loss.code, batch.loss.text) == (
        "index",
        "a message index points to wrong records; all records of its chunk were read instead",
    )


def test_messages_may_have_different_sizes(held: Held) -> None:
    """Nothing is lost or reported."""
    raw = message(1, 10, b"abcd") + message(1, 20, b"") + message(1, 30, b"efghi")
    batch = loaded(held, raw, (1, ((10, 0), (20, 35), (30, 66))))[1]
    assert (payloads(batch), batch.loss) == ([b"abcd", b"", b"efghi"], None)
    assert batch.log_ns.tolist() == [10, 20, 30]


@pytest.mark.parametrize(("length", "whole"), [(21, False), (22, True), (26, True), (27, False)])
def test_a_message_ends_within_its_chunk(length: int, whole: bool, held: Held) -> None:  # noqa: FBT001
    """The last may reach to the end and no further; its head alone takes 22 bytes of it."""
    raw = bytearray(message(1, 10, b"abcd") + message(1, 30, b"efgh"))
    struct.pack_into("<Q", raw, 36, length)
    batch = loaded(held, bytes(raw), (1, ((10, 0), (30, 35))))[1]
    assert payloads(batch) == ([b"abcd", b"efgh"[: length - 22]] if whole else [b"abcd"])
    assert (batch.loss is None) == whole


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
def test_a_walk_ends_at_the_first_record_that_is_not_whole(
    raw: bytes, expected: dict[int, list[int]]
) -> None:
    """Or at zeros; what is no message is passed over."""
    assert walk_records(raw) == expected


def test_the_entries_of_an_index(held: Held) -> None:
    """As it says, whatever the messages say."""
    file = held(b"??", index(9, (5, 0), (7, 1), (6, 2)))
    entry = ChunkIndex(start=0, length=2, compression="", indexes={9: 2})
    assert index_entries(file, entry, 9).tolist() == [[5, 0], [7, 1], [6, 2]]


def _with_u32(data: bytes, at: int, value: int) -> bytes:
    return data[:at] + struct.pack("<I", value) + data[at + 4 :]


INDEX = index(9, (5, 0), (7, 1))


@pytest.mark.parametrize(
    "damaged",
    [
        b"\x06" + INDEX[1:],  # another opcode
        INDEX[:-1],  # cut
        INDEX[:1] + struct.pack("<Q", 37) + INDEX[9:] + b"?",  # its length is not that of its entries
        record(7, struct.pack("<HI", 9, 40) + bytes(40)),  # no whole number of entries
        _with_u32(INDEX, 11, 16),
    ],
)
def test_a_damaged_index_counts_nothing(damaged: bytes, held: Held) -> None:
    """So that its chunk is walked."""
    file = held(b"??", INDEX)
    assert index_count(file, 9, 2) == 2
    for key, path in ((8, b"??" + INDEX), (9, b"??" + damaged)):
        with pytest.raises(DamagedError, match=r"^a message index is damaged$") as caught:
            index_count(held(path), key, 2)
        assert caught.value.code == "index"


def test_a_chunk_with_a_damaged_index_is_walked(held: Held) -> None:
    """From the start."""
    data = chunk(RECORDS)
    entry = ChunkIndex(start=0, length=len(data), compression="", index_length=31, indexes={1: len(data)})
    found = dict(load_chunk(held(data, index(5, (1, 0))), entry, frozenset({1})))
    assert payloads(found[1]) == [b"abcd", b"efgh"]


@pytest.mark.parametrize(
    "damaged",
    [
        b"\x07" + chunk(RECORDS)[1:],
        chunk(RECORDS) + b"?",
        chunk(RECORDS)[:-1],
        chunk(RECORDS)[:41] + struct.pack("<Q", len(RECORDS) + 1) + RECORDS,
    ],
)
def test_a_damaged_chunk_is_not_loaded(damaged: bytes, held: Held) -> None:
    """Its head says another kind of record, another length, or data beyond its end."""
    assert bytes(unpack(memoryview(chunk(RECORDS)))) == RECORDS
    with pytest.raises(DamagedError, match=r"^a chunk's head is damaged$"):
        unpack(memoryview(damaged))
    entry = ChunkIndex(start=0, length=len(damaged), compression="")
    with pytest.raises(DamagedError, match=r"^a chunk's head is damaged$"):
        list(load_chunk(held(damaged), entry, frozenset({1, 2})))


def test_what_is_left_of_a_cut_chunk_is_not_checked() -> None:
    """Its checksum and its length belong to what is gone."""
    whole = chunk(RECORDS)
    assert bytes(unpack(memoryview(whole)[:-40], cut=True)) == RECORDS[:-40]


def test_messages_outside_chunks_know_their_times(held: Held) -> None:
    """In the file from a place on, or in bytes; one channel may be taken alone."""
    file = held(b"???", RECORDS)
    starts = {key: list(places) for key, places in AT.items()}
    assert Loose(file, 3).size == 0
    for part in (
        Loose(file, 3, len(RECORDS), starts),
        Loose(file, 3, len(RECORDS), starts, data=RECORDS),
    ):
        assert part.counts == {1: 2, 2: 2}
        times = {key: batch.log_ns.tolist() for key, batch in part.load()}
        assert times == {1: [10, 30], 2: [20, 40]}
        assert {key: payloads(batch) for key, batch in part.load()} == {
            1: [b"abcd", b"efgh"],
            2: [b"", b""],
        }
