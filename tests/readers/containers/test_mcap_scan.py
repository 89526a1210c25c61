"""An MCAP file without an index, record by record: what each record adds, and where the scan ends."""

import struct
from collections.abc import Callable

import pytest

from imucal.errors import ReadError
from imucal.readers.containers import mcap
from imucal.readers.containers.mcap import MAGIC, Bookkeeping, scan
from imucal.readers.files import DamagedError, LogFile
from tests.readers.containers.mcap_bytes import channel, chunk, index, message, record, schema

Held = Callable[..., LogFile]
HEAD = [MAGIC, schema(1), channel(7), channel(8, b"/gps")]
START = len(b"".join(HEAD))
FOOTER = record(2, bytes(20)) + MAGIC
DATA_END = record(15, bytes(4))
MESSAGES = message(7, 10, b"ab") + message(8, 20) + message(7, 30, b"cd")


def scanned(held: Held, *parts: bytes) -> Bookkeeping:
    """Return what a scan finds behind two channels."""
    return scan(held(*HEAD, *parts), DamagedError("no index", code="unindexed"))


def lost(book: Bookkeeping) -> int:
    """Return the bytes that a scan says are lost."""
    (finding,) = book.findings
    start = "The index can't be used (no index); all records were scanned instead."
    assert finding.level == "warning"
    if finding.text == start:
        assert finding.code == "unindexed"
        return 0
    assert finding.code == "truncated"
    assert finding.text.startswith(start + " The last ")
    assert finding.text.endswith(" bytes are cut off or damaged.")
    return int(finding.text.removeprefix(start).split()[2])


def test_definitions_and_messages_outside_chunks(held: Held) -> None:
    """Their places count from the first of them."""
    book = scanned(held, MESSAGES, DATA_END, FOOTER)
    assert lost(book) == 0
    assert {key: topic for key, (_, topic, _) in book.channels.items()} == {7: "/imu", 8: "/gps"}
    assert [(key, name) for key, (name, *_) in book.schemas.items()] == [(1, "a/B")]
    (part,) = book.loose
    assert (part.position, part.size, part.starts) == (START, len(MESSAGES), {7: [0, 64], 8: [33]})
    assert book.counts == {7: 2, 8: 1}
    assert (book.chunks, book.start_ns, book.end_ns) == ([], None, None)


def test_the_first_definition_of_a_number_stands(held: Held) -> None:
    """Writers repeat them; what differs later is damage."""
    book = scanned(held, channel(7, b"/other"), schema(1, b"c/D"), FOOTER)
    assert book.channels[7][1] == "/imu"
    assert book.schemas[1][0] == "a/B"


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
        (record(4, b"?"), 10),
        (record(4, b"?") + message(7, 50), 41),
    ],
)
def test_where_a_scan_ends(end: bytes, left: int, held: Held) -> None:
    """At zeros, at a record that is cut off or damaged; what is unknown is passed over."""
    book = scanned(held, MESSAGES, end)
    assert lost(book) == left
    assert book.counts == {7: 2, 8: 1}


def test_a_short_message_is_passed_over(held: Held) -> None:
    """Twenty-two bytes stand before its data."""
    short, least = record(5, struct.pack("<H", 7) + bytes(19)), record(5, struct.pack("<H", 7) + bytes(20))
    assert scanned(held, short, MESSAGES).counts == {7: 2, 8: 1}
    assert scanned(held, least, MESSAGES).counts == {7: 3, 8: 1}


def test_messages_are_loaded_in_parts(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part has so many bytes at most, of what lies between its messages too."""
    first = len(message(7, 10, b"ab")) + len(message(8, 20))
    for most, sizes in (
        (len(MESSAGES), [len(MESSAGES)]),
        (len(MESSAGES) - 1, [first, 33]),
        (first, [first, 33]),
        (first - 1, [33, 31, 33]),
    ):
        monkeypatch.setattr(mcap, "_PART", most)
        parts = scanned(held, MESSAGES).loose
        assert [part.size for part in parts] == sizes
        assert parts[0].starts[7][0] == parts[-1].starts[7][-1] - (64 if len(sizes) == 1 else 0) == 0
        assert parts[-1].position + parts[-1].size == START + len(MESSAGES)


def test_a_chunk_and_its_indexes(held: Held) -> None:
    """Indexes belong to the chunk they follow without a gap; an empty one holds no place."""
    whole, seven, eight = chunk(MESSAGES), index(7, (10, 0), (30, 64)), index(8, (20, 33))
    book = scanned(held, whole, seven, eight, index(9), whole, record(99, b""), seven, DATA_END)
    at = START + len(whole)
    first, second = book.chunks
    assert (first.start, first.length, first.compression) == (START, len(whole), "")
    assert first.index_length == len(seven) + len(eight) + 15
    assert first.indexes == {7: at, 8: at + len(seven)}
    assert second.start == START + first.length + first.index_length
    assert (second.index_length, second.indexes) == (0, {})
    assert book.counts == {7: 4, 8: 2}
    # Before any chunk an index is none.
    assert scanned(held, seven, MESSAGES).chunks == []


def test_a_chunk_whose_index_is_damaged_is_counted_by_walking(held: Held) -> None:
    """Another channel's index, or none."""
    wrong = index(7, (10, 0), (30, 64))[:15] + index(8, (10, 0), (30, 64))[15:]
    wrong = wrong[:11] + struct.pack("<I", 5) + wrong[15:]
    assert scanned(held, chunk(MESSAGES), wrong).counts == {7: 2, 8: 1}
    assert scanned(held, chunk(MESSAGES)).counts == {7: 2, 8: 1}


def test_what_a_cut_chunk_holds_is_kept(held: Held) -> None:
    """Its whole messages, and the definitions among them."""
    cut = chunk(channel(9) + MESSAGES)[:-1]
    book = scanned(held, cut)
    assert lost(book) == len(cut)
    assert set(book.channels) == {7, 8, 9}
    assert book.counts == {7: 1, 8: 1}
    (part,) = book.loose
    assert (part.position, part.size) == (START, len(cut))
    ((_, batch), _) = part.load()
    assert batch.log_ns.tolist() == [10]
    # Without a whole message there is nothing to load; without a whole head nothing at all.
    assert scanned(held, chunk(channel(9) + MESSAGES)[: 49 + len(channel(9))]).loose == []
    assert scanned(held, chunk(MESSAGES)[:40]).loose == []


def test_messages_behind_a_cut_chunk_do_not_join_it(held: Held) -> None:
    """Other records that are cut hold no messages, whatever they look like."""
    assert scanned(held, record(99, MESSAGES)[:-1]).loose == []


def test_channels_are_found_in_chunks(held: Held) -> None:
    """In each that has no index, or messages of a channel that is not known; not in the others."""
    file = held(MAGIC, schema(1), chunk(channel(7) + MESSAGES), index(7, (10, len(channel(7)))))
    assert set(scan(file, DamagedError("?")).channels) == {7}
    unindexed = chunk(channel(9) + MESSAGES)
    assert set(scanned(held, unindexed).channels) == {7, 8, 9}
    assert set(scanned(held, unindexed, index(7, (10, 40))).channels) == {7, 8}
    assert set(scanned(held, unindexed, index(9, (10, 40))).channels) == {7, 8, 9}


def test_a_damaged_chunk_does_not_hide_the_channels_of_the_next(held: Held) -> None:
    """Its length is wrong inside, so that nothing of it can be unpacked."""
    damaged = bytearray(chunk(channel(9)))
    struct.pack_into("<Q", damaged, 25, 1)
    assert set(scanned(held, bytes(damaged), chunk(channel(10))).channels) == {7, 8, 10}


def test_definitions_behind_the_data_are_taken(held: Held) -> None:
    """The summary repeats them, among records of other kinds; it ends at a damaged one."""
    more = channel(11, b"/late")
    for end, known in (
        (more, {7, 8, 11}),
        (more[:-1], {7, 8}),
        (schema(2) + more + record(8, bytes(9)) + channel(12), {7, 8, 11, 12}),
        (more + record(4, b"?") + channel(12), {7, 8, 11}),
        (more + bytes(9), {7, 8, 11}),
    ):
        book = scanned(held, DATA_END, end)
        assert set(book.channels) == known
        assert lost(book) == 0


@pytest.mark.parametrize(
    ("raw", "known"),
    [
        (channel(1) + schema(2) + channel(3), {1, 3}),
        (message(1, 2, b"abc") + channel(3), {3}),
        (channel(1) + channel(3)[:-1], {1}),
        (channel(1) + record(4, b"?") + channel(3), {1}),
        (channel(1) + channel(3)[:8], {1}),
        (channel(1) + record(3, schema(2)[9:-1]) + channel(3), {1}),
        (record(99, b"") + channel(1), {1}),
    ],
)
def test_definitions_among_the_records_of_a_chunk(raw: bytes, known: set[int]) -> None:
    """Up to the first that is damaged."""
    book = Bookkeeping()
    book.define_all(memoryview(raw))
    assert set(book.channels) == known


def test_a_definition_of_megabytes_is_damage(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not read; one of the longest size is."""
    size = len(channel(9)) - 9
    for most, known in ((size, {7, 8, 9}), (size - 1, set[int]())):
        monkeypatch.setattr(mcap, "_MAX_DEFINITION", most)
        file = held(*HEAD[:2], channel(7), channel(8), channel(9))
        if known:
            assert set(scan(file, DamagedError("?")).channels) == known
        else:
            with pytest.raises(ReadError, match="no whole record was found"):
                scan(file, DamagedError("?"))
    monkeypatch.undo()
    assert mcap._MAX_DEFINITION == 16 * 2**20


@pytest.mark.parametrize("window", [16, 200, 1 << 20])
def test_the_window_changes_nothing(window: int, held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """Records begin and end in and beyond it."""
    monkeypatch.setattr(mcap, "_WINDOW", window)
    book = scanned(held, chunk(MESSAGES), index(7, (10, 0), (30, 64)), MESSAGES, channel(9), FOOTER)
    assert set(book.channels) == {7, 8, 9}
    assert book.counts == {7: 4, 8: 1}
    assert lost(book) == 0


def test_a_file_without_a_channel_is_none(held: Held) -> None:
    """The reason why its index was not used is said too."""
    file = held(MAGIC, schema(1), MESSAGES)
    with pytest.raises(ReadError) as caught:
        scan(file, DamagedError("the end is missing"))
    assert str(caught.value) == (
        f"{file.path}: the end is missing, and no whole record was found; expected an MCAP file"
    )


def test_a_file_is_read_a_window_at_a_time(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not a record at a time: one read for a small file, up to its last byte."""
    reads: list[tuple[int, int]] = []
    read = LogFile.read

    def noted(file: LogFile, position: int, size: int) -> bytes:
        reads.append((position, size))
        return read(file, position, size)

    monkeypatch.setattr(LogFile, "read", noted)
    file = held(*HEAD)
    scan(file, DamagedError("?"))
    assert reads == [(0, file.size)]
