"""The chunks of a ROS 1 bag, byte by byte: by their index records, and walked where they are wrong."""

import bz2
import struct
from collections.abc import Callable

import pytest

from imucal.readers.containers.container import Batch
from imucal.readers.containers.ros1 import BagChunk, load_chunk, unpack, walk
from imucal.readers.files import DamagedError, LogFile
from tests.readers.containers.ros1_bytes import chunk, connection, index, message, record, stamp

Held = Callable[..., LogFile]
SECOND = 10**9
CONNECTION = connection(1)
MESSAGES = [message(1, SECOND + 5, b"abcd"), message(2, 7, b""), message(1, 2 * SECOND + 6, b"efgh")]
RAW = CONNECTION + b"".join(MESSAGES)
FIRST = len(CONNECTION)
SECOND_AT, THIRD = FIRST + len(MESSAGES[0]), FIRST + len(MESSAGES[0]) + len(MESSAGES[1])
ONE, TWO = index(1, (SECOND + 5, FIRST), (2 * SECOND + 6, THIRD)), index(2, (7, SECOND_AT))
WALKED = "an index record is missing; all records of its chunk were read instead"
ELSEWHERE = "an index points to wrong records; all records of its chunk were read instead"


def payloads(batch: Batch) -> list[bytes]:
    """Return what the messages of a batch hold."""
    return [bytes(data) for data in batch.messages()]


def loaded(held: Held, *parts: bytes, indexed: bool = True, cut: bool = False) -> dict[int, Batch]:
    """Return connection -> its messages in a chunk and the index records behind it."""
    data = b"".join(parts)
    about = BagChunk(start=3, size=len(data), counts={1: 2, 2: 1, 3: 5}, indexed=indexed, cut=cut)
    return dict(load_chunk(held(b"???", data), about, frozenset({1, 2})))


def test_a_chunk_gives_the_messages_of_its_index_records(held: Held) -> None:
    """With their times."""
    found = loaded(held, chunk(RAW), ONE, TWO)
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b""]}
    assert found[1].log_ns.tolist() == [SECOND + 5, 2 * SECOND + 6]
    assert found[2].log_ns.tolist() == [7]
    assert {batch.loss for batch in found.values()} == {None}


def test_an_index_record_without_entries_lists_no_messages(held: Held) -> None:
    """The others are there."""
    found = loaded(held, chunk(RAW), index(1), TWO)
    assert (found[1].n, payloads(found[1]), found[1].loss) == (0, [], None)
    assert payloads(found[2]) == [b""]


def test_a_connection_may_stand_in_front_of_its_first_message(held: Held) -> None:
    """Recorders let the index point there; the message behind it is meant."""
    found = loaded(held, chunk(RAW), index(1, (SECOND + 5, 0), (2 * SECOND + 6, THIRD)), TWO)
    assert (payloads(found[1]), found[1].loss) == ([b"abcd", b"efgh"], None)


def test_messages_of_other_sizes_are_each_their_own(held: Held) -> None:
    """Their headers differ, so that each is looked at; nothing is lost, and nothing said."""
    raw = message(1, 5, b"abc") + message(1, 6, b"") + message(1, 7, b"defgh")
    first, second = len(message(1, 5, b"abc")), len(message(1, 5, b"abc") + message(1, 6))
    batch = loaded(held, chunk(raw), index(1, (5, 0), (6, first), (7, second)))[1]
    assert (payloads(batch), batch.loss) == ([b"abc", b"", b"defgh"], None)


@pytest.mark.parametrize(
    ("first", "last"),
    [
        (FIRST + 1, THIRD),
        (FIRST, THIRD - 1),
        (SECOND_AT, THIRD),
        (FIRST, SECOND_AT),
        (SECOND_AT, SECOND_AT),
        (FIRST, len(RAW)),
        (FIRST, 1 << 31),
        (1 << 31, THIRD),
    ],
)
def test_an_index_that_points_elsewhere_is_walked_around(first: int, last: int, held: Held) -> None:
    """Beyond the chunk, into a record, or to messages of another connection."""
    batch = loaded(held, chunk(RAW), index(1, (0, first), (0, last)), TWO)[1]
    assert payloads(batch) == [b"abcd", b"efgh"]
    assert batch.log_ns.tolist() == [SECOND + 5, 2 * SECOND + 6]
    assert batch.loss is not None
    assert (batch.loss.code, batch.loss.text) == ("index", ELSEWHERE)


def test_only_a_connection_is_passed_over(held: Held) -> None:
    """A record of another kind in front of a message is not where the index should point."""
    other = record(9, {})
    raw = other + message(1, 5, b"abc") + message(1, 6, b"def")
    entries = index(1, (5, 0), (6, len(other) + len(message(1, 5, b"abc"))))
    batch = loaded(held, chunk(raw), entries)[1]
    assert payloads(batch) == [b"abc", b"def"]
    assert batch.loss is not None


@pytest.mark.parametrize(
    "parts",
    [
        (),
        (TWO[:-1],),
        (TWO, ONE[:-1]),
        (TWO, index(1, (0, FIRST), (0, THIRD), count=1)),
        (TWO, record(9, {}), ONE),
        (TWO, bytes(8), ONE),
        (TWO, record(4, {b"conn": bytes(3), b"count": bytes(4)}), ONE),
    ],
)
def test_a_missing_index_record_is_walked_around(parts: tuple[bytes, ...], held: Held) -> None:
    """They end at the first that is cut, damaged, or something else; those before it count."""
    found = loaded(held, chunk(RAW), *parts)
    assert {key: payloads(batch) for key, batch in found.items()} == {1: [b"abcd", b"efgh"], 2: [b""]}
    assert found[1].loss is not None
    assert (found[1].loss.code, found[1].loss.text) == ("index", WALKED)
    assert (found[2].loss is None) == (parts[:1] == (TWO,))


def test_a_chunk_without_index_records_is_walked_in_silence(held: Held) -> None:
    """As those of an unindexed bag are; what stands behind it is not looked at."""
    found = loaded(held, chunk(RAW), index(1, (0, 0)), indexed=False)
    assert payloads(found[1]) == [b"abcd", b"efgh"]
    assert found[1].loss is None
    assert found[1].log_ns.tolist() == [SECOND + 5, 2 * SECOND + 6]


def test_what_is_left_of_a_cut_chunk_is_walked(held: Held) -> None:
    """A cut one that should be whole is damage."""
    found = loaded(held, chunk(RAW)[:-1], indexed=False, cut=True)
    assert payloads(found[1]) == [b"abcd"]
    with pytest.raises(DamagedError, match=r"^a chunk is cut off$") as caught:
        loaded(held, chunk(RAW)[:-1], indexed=False)
    assert caught.value.code == "truncated"


def test_chunks_are_unpacked(held: Held) -> None:
    """And end where their record ends; another record is none."""
    del held
    for data in (chunk(RAW), chunk(bz2.compress(RAW), b"bz2", len(RAW))):
        raw, end = unpack(memoryview(data + b"more"))
        assert (bytes(raw), end) == (RAW, len(data))
    without = record(5, {b"size": struct.pack("<I", 3)}, b"abc")
    assert bytes(unpack(memoryview(without))[0]) == b"abc"
    with pytest.raises(DamagedError, match=r"^a chunk's head is damaged$"):
        unpack(memoryview(message(1, 2)))
    with pytest.raises(DamagedError, match=r"has a declared size"):
        unpack(memoryview(chunk(RAW, size=len(RAW) + 1)))


@pytest.mark.parametrize("end", [b"", MESSAGES[0][:-1], MESSAGES[0][:3], bytes(8), record(9, {})[:-1]])
def test_a_walk_ends_at_the_first_record_that_is_not_whole(end: bytes) -> None:
    """Those before it are given, of whatever kind."""
    assert [opcode for opcode, _ in walk(memoryview(RAW + end))] == [7, 2, 2, 2]


def test_a_walk_takes_a_time_that_is_short_for_none(held: Held) -> None:
    """As where a scan counts it; a message without a time is one of the year 1970."""
    odd = record(2, {b"conn": b"\x01\0\0\0", b"time": stamp(3 * SECOND)[:4]}, b"x")
    bare = record(2, {b"conn": b"\x01\0\0\0"}, b"yz")
    batch = loaded(held, chunk(odd + bare + record(9, {b"conn": b"\x01\0\0\0"})), indexed=False)[1]
    assert (payloads(batch), batch.log_ns.tolist()) == ([b"x", b"yz"], [0, 0])
