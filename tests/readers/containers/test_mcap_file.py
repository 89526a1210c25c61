"""The index of an MCAP file, byte by byte: its content, and the checks that reject it."""

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass

import pytest

from imucal.errors import ReadError
from imucal.readers.containers import mcap
from imucal.readers.containers.mcap import MAGIC, McapFile
from imucal.readers.files import LogFile
from tests.readers.containers.mcap_bytes import channel, chunk, index, message, record, schema, text

Held = Callable[..., LogFile]
FIRST = message(7, 10, b"ab") + message(8, 25) + message(7, 30, b"cd")
SECOND = message(7, 40, b"ef") + message(7, 35, b"gh")
#: The first chunk has indexes of two channels, the second one of one channel.
CHUNKS = (chunk(FIRST), chunk(SECOND))
INDEXES = (index(7, (10, 0), (30, 64)) + index(8, (25, 33)), index(7, (40, 0), (35, 33)))
DATA = MAGIC + CHUNKS[0] + INDEXES[0] + CHUNKS[1] + INDEXES[1]
DATA_END = record(15, bytes(4))
DEFINITIONS = schema(1) + channel(7) + channel(8, b"/gps", of_schema=0)


def chunk_index(
    number: int, at: int | None = None, size: int | None = None, kind: bytes = b"", **places: int
) -> bytes:
    """Return the summary's record of a chunk."""
    start = len(MAGIC) + number * len(CHUNKS[0] + INDEXES[0]) if at is None else at
    behind = start + len(CHUNKS[number])
    found = {7: behind, 8: behind + 47} if number == 0 else {7: behind}
    found |= {int(key[1:]): place for key, place in places.items()}
    pairs = b"".join(struct.pack("<HQ", key, place) for key, place in found.items())
    head = struct.pack("<QQQQ", 10, 30, start, len(CHUNKS[number]) if size is None else size)
    return record(8, head + text(pairs) + struct.pack("<Q", len(INDEXES[number])) + text(kind) + bytes(16))


def statistics(messages: int = 5, chunks: int = 2, counts: Mapping[int, int] | None = None) -> bytes:
    """Return the Statistics record."""
    pairs = b"".join(struct.pack("<HQ", *pair) for pair in (counts or {}).items())
    return record(11, struct.pack("<QHIIIIQQ", messages, 1, 2, 0, 0, chunks, 10, 40) + text(pairs))


SUMMARY = DEFINITIONS + statistics(counts={7: 4, 8: 1}) + chunk_index(0) + chunk_index(1)


@dataclass(kw_only=True)
class Parts:
    """The parts of a file; each can be wrong."""

    data: bytes = DATA
    summary: bytes = SUMMARY
    start: int | None = None
    crc: int | None = 0
    opcode: int = 2
    length: int = 20
    end: bytes = MAGIC

    def bytes(self) -> bytes:
        """Return the file; a checksum of None is replaced by the correct one."""
        start = len(self.data) + len(DATA_END) if self.start is None else self.start
        head = struct.pack("<BQQQ", self.opcode, self.length, start, 0)
        crc = zlib.crc32(self.summary + head) if self.crc is None else self.crc
        return self.data + DATA_END + self.summary + head + struct.pack("<I", crc) + self.end


@contextmanager
def opened(held: Held, **parts: object) -> Iterator[McapFile]:
    """Open a file."""
    with closing(McapFile(held(Parts(**parts).bytes()).path)) as file:  # type: ignore[arg-type]
        yield file


def test_the_index_describes_a_file(held: Held) -> None:
    """The index contains topics, types, counts, and first and last times. The checksum is optional."""
    for crc in (0, None):
        with opened(held, crc=crc) as file:
            assert file.findings == []
            imu, gps = file.channels
            assert (imu.key, imu.topic, imu.type, imu.encoding) == (7, "/imu", "a/B", "cdr")
            assert (imu.definition, imu.definition_kind) == ("int8 x", "ros2msg")
            assert (gps.topic, gps.type, gps.definition) == ("/gps", "", "")
            assert [(c.count, c.first_ns, c.last_ns) for c in (imu, gps)] == [(4, 10, 40), (1, 25, 25)]
            assert (file.start_ns, file.end_ns) == (10, 40)
            assert (file.compression, file.format, file.parallel) == ("none", "mcap", True)
            tasks = list(file.tasks(frozenset({7})))
            assert [task.keys for task in tasks] == [{7}, {7}]
            assert [task.keys for task in file.tasks(frozenset({8, 9}))] == [{8}]
            loaded = [batch for task in tasks for _, batch in task.load()]
            assert [time for batch in loaded for time in batch.log_ns.tolist()] == [10, 30, 40, 35]


def test_without_statistics_messages_are_counted_by_the_indexes(held: Held) -> None:
    """The times of the complete file are unknown."""
    with opened(held, summary=DEFINITIONS + chunk_index(0) + chunk_index(1)) as file:
        assert file.findings == []
        assert [channel.count for channel in file.channels] == [4, 1]
        assert (file.start_ns, file.end_ns) == (None, None)


def test_a_chunk_with_a_damaged_index_has_no_times(held: Held) -> None:
    """The total times are then unknown too. Unknown records are skipped."""
    wrong = chunk_index(0, k8=9) + chunk_index(1)
    with opened(
        held, summary=record(99, b"?") + DEFINITIONS + statistics(counts={7: 4, 8: 1}) + wrong
    ) as file:
        assert file.findings == []
        assert [(c.first_ns, c.last_ns) for c in file.channels] == [(10, 40), (None, None)]


FOOTER_AT = len(DATA + DATA_END + SUMMARY)
TWICE, BEYOND = "the index lists chunks twice", "the index points beyond the file"
LEFT_OUT, POINTS = "the index does not list all chunks", "the footer points beyond the file"


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ({"data": b"?" + DATA[1:]}, "the file does not start and end as an MCAP file"),
        ({"end": MAGIC[:-1] + b"?"}, "the end of the file is missing"),
        ({"opcode": 3}, "the footer is damaged"),
        ({"length": 21}, "the footer is damaged"),
        ({"start": 0}, "the file has no index"),
        ({"start": 7}, POINTS),
        ({"start": FOOTER_AT + 1}, POINTS),
        ({"start": FOOTER_AT}, LEFT_OUT),
        ({"crc": 1}, "the index's checksum does not match"),
        ({"summary": SUMMARY[:-1]}, "the index is cut off"),
        ({"summary": DEFINITIONS + chunk_index(0) + statistics()}, LEFT_OUT),
        ({"summary": DEFINITIONS + statistics(chunks=0)}, LEFT_OUT),
        ({"data": DATA + DEFINITIONS, "summary": statistics() + chunk_index(0) + chunk_index(1)}, LEFT_OUT),
        ({"summary": SUMMARY + chunk_index(0)}, TWICE),
        ({"summary": SUMMARY + chunk_index(1, at=len(MAGIC) - 1, size=1)}, BEYOND),
        ({"summary": SUMMARY + chunk_index(1, at=1000, size=1)}, BEYOND),
        ({"summary": DEFINITIONS + chunk_index(0, k7=9) + chunk_index(1)}, "a message index is damaged"),
    ],
)
def test_a_contradicting_index_is_ignored(parts: dict[str, object], reason: str, held: Held) -> None:
    """All records are scanned instead, the reason is reported, and no message is lost."""
    with opened(held, **parts) as file:
        (finding,) = file.findings
        assert finding.text.startswith(f"The index can't be used ({reason}); all records were scanned")
        assert {channel.topic: channel.count for channel in file.channels} == {"/imu": 4, "/gps": 1}


def test_an_empty_file_has_channels_and_no_chunks(held: Held) -> None:
    """The recorder was started and stopped at once."""
    with opened(held, data=MAGIC, summary=DEFINITIONS + statistics(messages=0, chunks=0)) as file:
        assert file.findings == []
        assert [(c.count, c.first_ns, c.last_ns) for c in file.channels] == [(0, None, None)] * 2
        assert file.compression == "none"
        assert list(file.tasks(frozenset({7, 8}))) == []


def test_the_shortest_file_has_only_magic_and_footer(held: Held) -> None:
    """The file has no index and no channel; a shorter file is not an MCAP file."""
    for parts, reason in (
        ({"data": MAGIC, "summary": b"", "start": 0}, "the file has no index"),
        ({"data": b"", "summary": b"", "start": 0}, "the file does not start and end as an MCAP file"),
    ):
        path = held(Parts(**parts).bytes()).path  # type: ignore[arg-type]
        with pytest.raises(ReadError) as caught:
            McapFile(path)
        assert (
            str(caught.value)
            == f"{path}: {reason}, and no channel was found; expected an MCAP file, copy it again"
        )


def test_a_chunk_can_end_with_the_file(held: Held) -> None:
    """A chunk that is one byte longer extends beyond the file."""
    size = len(Parts(summary=SUMMARY + chunk_index(1, at=9, size=1)).bytes())
    with opened(held, summary=SUMMARY + chunk_index(1, at=9, size=size - 9)) as file:
        assert file.findings == []
    with opened(held, summary=SUMMARY + chunk_index(1, at=9, size=size - 8)) as file:
        assert BEYOND in file.findings[0].text


def test_a_message_index_without_entries_lists_no_message(held: Held) -> None:
    """A channel without messages has no times."""
    data = DATA + index(9)
    summary = DEFINITIONS + channel(9, b"/none") + statistics(counts={7: 4, 8: 1})
    summary += chunk_index(0) + chunk_index(1, k9=len(DATA))
    with opened(held, data=data, summary=summary) as file:
        assert file.findings == []
        assert [(c.count, c.first_ns, c.last_ns) for c in file.channels][2] == (0, None, None)
        (task,) = file.tasks(frozenset({9}))
        assert [(key, batch.n, batch.loss) for key, batch in task.load()] == [(9, 0, None)]


@pytest.mark.parametrize("known", [False, True])
def test_an_unknown_compression_of_all_chunks_is_refused(held: Held, known: bool) -> None:  # noqa: FBT001
    """If only one chunk has such a name, the name is damaged and the other chunks are read."""
    chunks = chunk_index(0, kind=b"" if known else b"brotli") + chunk_index(1, kind=b"brotli")
    path = held(Parts(summary=DEFINITIONS + chunks).bytes()).path
    if known:
        with closing(McapFile(path)) as file:
            assert file.compression == "none"
    else:
        with pytest.raises(ReadError) as caught:
            McapFile(path)
        assert str(caught.value) == f"{path}: chunks are compressed by 'brotli'; expected none, lz4 or zstd"


def test_a_summary_of_gigabytes_is_damage(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """The summary is not read if it exceeds the limit."""
    assert mcap._MAX_SUMMARY == 2**31
    size = len(SUMMARY) + 37
    for most, believed in ((size, True), (size - 1, False)):
        monkeypatch.setattr(mcap, "_MAX_SUMMARY", most)
        with opened(held) as file:
            assert (file.findings == []) == believed


def test_the_times_of_a_channel_include_messages_outside_chunks(held: Held) -> None:
    data = DATA + message(8, 5) + message(7, 50)
    with opened(held, data=data, start=0, summary=DEFINITIONS) as file:
        assert [(c.topic, c.count, c.first_ns, c.last_ns) for c in file.channels] == [
            ("/imu", 5, 10, 50),
            ("/gps", 2, 5, 25),
        ]
        assert [task.keys for task in file.tasks(frozenset({8}))] == [{8}, {8}]


def test_a_message_index_of_another_channel_is_reported(held: Held) -> None:
    """The chunk is searched record by record instead."""
    behind = len(MAGIC + CHUNKS[0])
    summary = DEFINITIONS + statistics(counts={7: 4, 8: 1}) + chunk_index(0, k8=behind) + chunk_index(1)
    with opened(held, summary=summary) as file:
        (task,) = file.tasks(frozenset({8}))
        ((key, batch),) = task.load()
        assert (key, batch.log_ns.tolist()) == (8, [25])
        assert batch.loss is not None
        assert (batch.loss.code, batch.loss.text) == (
            "index",
            "a message index is damaged; all records of its chunk were read instead",
        )


@pytest.mark.parametrize(
    "damaged",
    [
        b"\x06" + INDEXES[1][1:],
        INDEXES[1][:1] + struct.pack("<Q", 37) + INDEXES[1][9:],
        INDEXES[1][:11] + struct.pack("<I", 16) + INDEXES[1][15:],
        record(7, struct.pack("<HI", 7, 40) + bytes(40)),
        index(9, (40, 0), (35, 33)),
    ],
    ids=["other opcode", "length", "size", "part of an entry", "other channel"],
)
def test_a_damaged_message_index_is_not_read(damaged: bytes, held: Held) -> None:
    """The chunk is searched record by record instead, and the damage is reported."""
    with opened(held, data=DATA[: -len(INDEXES[1])] + damaged) as file:
        assert file.findings == []
        *_, task = file.tasks(frozenset({7}))
        ((_, batch),) = task.load()
        assert batch.log_ns.tolist() == [40, 35]
        assert batch.loss is not None
        assert batch.loss.text.startswith("a message index is damaged;")
