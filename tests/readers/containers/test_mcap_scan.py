"""An MCAP file without an index: the content of each record, and the end of the scan."""

import struct
from collections.abc import Callable
from itertools import chain

import pytest

from imucal.errors import ReadError
from imucal.readers.containers import mcap
from imucal.readers.containers.chunked import Chunk
from imucal.readers.containers.mcap import MAGIC, McapFile
from imucal.readers.files import DamagedError
from tests.readers.containers.mcap_bytes import channel, chunk, index, message, record, schema

McapOf = Callable[..., McapFile]
HEAD = [MAGIC, schema(1), channel(7), channel(8, b"/gps")]
START = len(b"".join(HEAD))
FOOTER = record(2, bytes(20)) + MAGIC
DATA_END = record(15, bytes(4))
MESSAGES = message(7, 10, b"ab") + message(8, 20) + message(7, 30, b"cd")


def lost(file: McapFile) -> int:
    """Return the number of lost bytes in the finding of a scan."""
    (finding,) = file.findings
    start, _, rest = finding.text.partition("; all records were scanned instead.")
    assert finding.level == "warning"
    assert start.startswith("The index can't be used (")
    if not rest:
        return 0
    assert finding.code == "truncated"
    assert rest.startswith(" The last ")
    assert rest.endswith(" bytes are cut off or damaged.")
    return int(rest.split()[2])


def counts(file: McapFile) -> dict[int, int | None]:
    """Return channel -> number of its messages."""
    return {channel.key: channel.count for channel in file.channels}


def times(file: McapFile, key: int) -> list[list[int]]:
    """Return the log times of a channel's messages in each part of the file."""
    return [batch.log_ns.tolist() for task in file.tasks(frozenset({key})) for _, batch in task.load()]


def test_definitions_and_messages_outside_chunks_are_read(mcap_of: McapOf) -> None:
    file = mcap_of(*HEAD, MESSAGES, DATA_END, FOOTER)
    assert lost(file) == 0
    assert file.findings[0].code == "unindexed"
    assert [(c.key, c.topic, c.type) for c in file.channels] == [(7, "/imu", "a/B"), (8, "/gps", "a/B")]
    assert counts(file) == {7: 2, 8: 1}
    assert [(c.first_ns, c.last_ns) for c in file.channels] == [(10, 30), (20, 20)]
    assert (times(file, 7), times(file, 8)) == ([[10, 30]], [[20]])
    assert (file.compression, file.start_ns, file.end_ns) == ("none", None, None)


def test_the_first_definition_of_a_number_is_used(mcap_of: McapOf) -> None:
    """Writers repeat definitions; a later, different one is damage."""
    file = mcap_of(*HEAD, channel(7, b"/other"), schema(1, b"c/D"), FOOTER)
    assert (file.channels[0].topic, file.channels[0].type) == ("/imu", "a/B")


@pytest.mark.parametrize(
    ("end", "left"),
    [
        (b"", 0),
        (bytes(8), 8),
        (bytes(9), 9),
        (bytes(500), 500),
        (record(99, b""), 0),
        (record(99, b"abc"), 0),
        (record(99, b"abc")[:-1], 11),
        (record(99, b"")[:-1], 8),
        (FOOTER, 0),
        (FOOTER[:9], 0),
        (DATA_END + bytes(30), 0),
        (message(7, 50, b"ef")[:-1], 32),
        (channel(9)[:-1], len(channel(9)) - 1),
        (record(4, b"?"), 0),
        (chunk(MESSAGES)[:-1], len(chunk(MESSAGES)) - 1),
    ],
)
def test_a_scan_ends_at_zeros_or_an_incomplete_record(end: bytes, left: int, mcap_of: McapOf) -> None:
    """Unknown and damaged records are skipped."""
    file = mcap_of(*HEAD, MESSAGES, end)
    assert lost(file) == left
    assert counts(file) == {7: 2, 8: 1}
    assert times(file, 7) == [[10, 30]]


def test_a_short_message_is_skipped(mcap_of: McapOf) -> None:
    """A Message record has 22 bytes before its data."""
    short, least = (record(5, struct.pack("<H", 7) + bytes(size)) for size in (19, 20))
    assert counts(mcap_of(*HEAD, short, MESSAGES)) == {7: 2, 8: 1}
    assert counts(mcap_of(*HEAD, least, MESSAGES)) == {7: 3, 8: 1}


def test_messages_are_loaded_in_parts(mcap_of: McapOf, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part has at most `_PART` bytes, including those between its messages."""
    first = len(message(7, 10, b"ab")) + len(message(8, 20))
    for most, sizes in (
        (len(MESSAGES), [len(MESSAGES)]),
        (len(MESSAGES) - 1, [first, 33]),
        (first, [first, 33]),
        # The part between them has no message of the channel.
        (first - 1, [33, 33]),
    ):
        monkeypatch.setattr(mcap, "_PART", most)
        file = mcap_of(*HEAD, MESSAGES)
        assert [task.size for task in file.tasks(frozenset({7}))] == sizes
        assert list(chain(*times(file, 7))) == [10, 30]
        assert list(chain(*times(file, 8))) == [20]


def test_message_indexes_belong_to_the_previous_chunk(mcap_of: McapOf) -> None:
    """An empty index, or a second one of the same channel, is ignored."""
    complete, seven, eight = chunk(MESSAGES), index(7, (10, 0), (30, 64)), index(8, (20, 33))
    file = mcap_of(
        *HEAD, complete, seven, eight, index(9), record(99, b""), index(7, (10, 0)), complete, DATA_END
    )
    at = START + len(complete)
    assert file._chunks == [
        Chunk(START, at, "", {7: at, 8: at + len(seven)}),
        Chunk(
            at + len(seven + eight) + 15 + 9 + 31,
            at + len(seven + eight) + 15 + 9 + 31 + len(complete),
            "",
            {7: None, 8: None},
        ),
    ]
    assert counts(file) == {7: 4, 8: 2}
    assert (times(file, 7), times(file, 8)) == ([[10, 30]] * 2, [[20]] * 2)


def test_an_index_without_a_chunk_is_ignored(mcap_of: McapOf) -> None:
    """The indexes are at the start of the file, and after messages outside chunks."""
    lonely = index(7, (10, 0))
    file = mcap_of(*HEAD, lonely, MESSAGES, lonely)
    assert counts(file) == {7: 2, 8: 1}
    assert times(file, 7) == [[10, 30]]


def test_the_messages_of_a_chunk_without_index_are_counted(mcap_of: McapOf) -> None:
    assert counts(mcap_of(*HEAD, chunk(MESSAGES))) == {7: 2, 8: 1}


def test_a_damaged_chunk_without_index_is_tried_when_messages_are_read(mcap_of: McapOf) -> None:
    """Each channel may have messages in the chunk, so the loss is reported and its size is unknown."""
    damaged = bytearray(chunk(MESSAGES))
    struct.pack_into("<Q", damaged, 25, 1)
    file = mcap_of(*HEAD, bytes(damaged), chunk(MESSAGES))
    assert counts(file) == {7: None, 8: None}
    first, second = file.tasks(frozenset({7}))
    with pytest.raises(DamagedError, match="declared size of 1"):
        list(first.load())
    assert [batch.n for _, batch in second.load()] == [2]


@pytest.mark.parametrize("size", [1, 40, 49, -1])
def test_a_truncated_chunk_is_lost(size: int, mcap_of: McapOf) -> None:
    """The finding counts its bytes; the chunks before it are read."""
    cut = chunk(channel(9) + MESSAGES)[:size]
    file = mcap_of(*HEAD, chunk(MESSAGES), cut)
    assert lost(file) == len(cut)
    assert counts(file) == {7: 2, 8: 1}
    assert times(file, 7) == [[10, 30]]


def test_channels_are_found_in_chunks(mcap_of: McapOf) -> None:
    """A chunk is searched if it has no index, or an index of an unknown channel."""
    defined = chunk(channel(7) + MESSAGES)
    file = mcap_of(MAGIC, schema(1), defined, index(7, (10, len(channel(7)))))
    assert counts(file) == {7: 1}
    unindexed = chunk(channel(9) + MESSAGES)
    assert set(counts(mcap_of(*HEAD, unindexed))) == {7, 8, 9}
    assert set(counts(mcap_of(*HEAD, unindexed, index(7, (10, 40))))) == {7, 8}
    assert set(counts(mcap_of(*HEAD, unindexed, index(9, (10, 40))))) == {7, 8, 9}


def test_a_damaged_chunk_does_not_hide_the_channels_of_the_next(mcap_of: McapOf) -> None:
    damaged = bytearray(chunk(channel(9)))
    struct.pack_into("<Q", damaged, 25, 1)
    assert set(counts(mcap_of(*HEAD, bytes(damaged), chunk(channel(10))))) == {7, 8, 10}


@pytest.mark.parametrize(
    ("end", "known"),
    [
        (channel(11), {7, 8, 11}),
        (channel(11)[:-1], {7, 8}),
        (schema(2) + channel(11) + record(8, bytes(9)) + channel(12), {7, 8, 11, 12}),
        (channel(11) + record(4, b"?") + channel(12), {7, 8, 11, 12}),
        (channel(11) + bytes(9), {7, 8, 11}),
    ],
)
def test_definitions_after_the_data_are_used(end: bytes, known: set[int], mcap_of: McapOf) -> None:
    """The summary repeats them, although it is damaged."""
    file = mcap_of(*HEAD, DATA_END, end)
    assert set(counts(file)) == known
    assert lost(file) == 0


@pytest.mark.parametrize(
    ("raw", "known"),
    [
        (channel(1) + schema(2) + channel(3), {1, 3}),
        (message(1, 2, b"abc") + channel(3), {3}),
        (channel(1) + channel(3)[:-1], {1}),
        (channel(1) + record(4, b"?") + channel(3), {1, 3}),
        (channel(1) + record(3, schema(2)[9:-1]) + channel(3), {1, 3}),
        (record(99, b"") + channel(1), {1}),
    ],
)
def test_definitions_in_a_chunk_are_used(raw: bytes, known: set[int], mcap_of: McapOf) -> None:
    """Damaged definitions are skipped."""
    assert set(counts(mcap_of(MAGIC, chunk(raw)))) == known


def test_a_definition_above_the_size_limit_is_not_read(
    mcap_of: McapOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A definition of megabytes is damage."""
    size = len(channel(9)) - 9
    monkeypatch.setattr(mcap, "_MAX_DEFINITION", size)
    assert set(counts(mcap_of(MAGIC, channel(9), channel(10, b"/longer")))) == {9}
    monkeypatch.undo()
    assert mcap._MAX_DEFINITION == 16 * 2**20


def test_a_file_without_a_channel_is_refused(mcap_of: McapOf) -> None:
    """The error also contains the reason why the index was not used."""
    with pytest.raises(ReadError) as caught:
        mcap_of(MAGIC, schema(1), MESSAGES)
    assert str(caught.value).endswith(
        ".log: the end of the file is missing, and no channel was found; expected an MCAP file, copy it again"
    )
