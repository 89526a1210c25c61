"""MCAP: ROS 2, ROS 1 and JSON messages, chunks uncompressed or in lz4 or zstd.

An intact file is read by the index at its end; a cut, unindexed or damaged one by scanning its records. A
cut file keeps everything before the cut, of its last chunk too; the zeros that a crash leaves end it. The
`mcap` package reads intact files and is the witness in the tests; it refuses every truncated file, and builds
an object for each record. Source: MCAP specification 0, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.findings import Finding
from imucal.readers.compression import KINDS, check_crc, crc32, decompress, decompress_prefix
from imucal.readers.containers.container import Batch, Bytes, Channel, Loss, MessageFile, Task, gather
from imucal.readers.files import DamagedError, LogFile, damaged_if, refused

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 2, 3, 4, 5, 6, 7, 8
STATISTICS, DATA_END = 0x0B, 0x0F
DEFINITIONS = (SCHEMA, CHANNEL)

#: Opcode and length in front of every record.
HEAD = struct.Struct("<BQ")
_PAIR = struct.Struct("<HQ")
#: Opcode, length, channel and so on of a Message record: its payload starts here.
_MESSAGE = 31
_RECORD = struct.Struct("<BQH")
_HEADS = np.dtype(
    {
        "names": ["opcode", "length", "channel", "log"],
        "formats": ["u1", "<i8", "<u2", "<i8"],
        "offsets": [0, 1, 9, 15],
        "itemsize": _MESSAGE,
    }
)
#: A chunk's message index has this many bytes in front of its entries of 16.
_INDEX_HEAD = 15
_FOOTER_SIZE = 9 + 20 + 8
#: Ids of channels and schemas have 16 bits; a summary larger than this can only be damage, in bytes.
_MAX_SUMMARY = 1 << 31
#: Messages outside chunks are loaded in parts of this many bytes.
_PART = 1 << 22
#: Schemas and channels are read whole; a longer one is damage.
_MAX_DEFINITION = 1 << 24
#: Bytes that a scan reads at once.
_WINDOW = 1 << 20
#: Bytes in which the head of a chunk is looked for: names of compressions are short.
_HEAD_BLOCK = 128


@dataclass(slots=True)
class ChunkIndex:
    """Where a chunk lies; `indexes` is channel -> position of its message index."""

    start: int
    length: int
    compression: str
    index_length: int = 0
    indexes: dict[int, int] = field(default_factory=dict)


def each_record(data: Bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, position and length of each record, up to the first that is not whole, or zeros."""
    at, end, head = 0, len(data), HEAD.unpack_from
    while at + 9 <= end:
        opcode, length = head(data, at)
        after = at + 9 + length
        if after > end or not opcode:
            return
        yield opcode, at, length
        at = after


def parse(opcode: int, record: Bytes) -> tuple[list[Any], int]:
    """Return the fields of a record by `RECORDS`, and where the last one ends; raises DamagedError."""
    name, form, at = RECORDS[opcode]
    damage = f"a {name} record is damaged"

    def take(size: int) -> bytes:
        nonlocal at
        start, at = at, at + size
        damaged_if(at > len(record), damage)
        return bytes(record[start:at])

    found: list[Any] = []
    for kind in form:
        data = take(int(kind) if kind.isdigit() else int.from_bytes(take(4), "little"))
        damaged_if(kind == "m" and len(data) % _PAIR.size, damage)
        found.append(_TAKEN[kind](data) if kind in _TAKEN else int.from_bytes(data, "little"))
    return found, at


#: Opcode -> name of the record, its fields, and where they begin. A number stands for an integer of so many
#: bytes; ``t`` for a text, ``b`` for bytes and ``m`` for a map of channels, each behind its length.
RECORDS = {
    SCHEMA: ("schema", "2ttb", 0),
    CHANNEL: ("channel", "22tt", 0),
    # Opcode and length included; it ends where the data start.
    CHUNK: ("chunk", "84t8", 25),
    CHUNK_INDEX: ("chunk index", "88m8t", 16),
    # Messages, four other counts, chunks, first and last time in ns, and messages of each channel.
    STATISTICS: ("statistics", "82444488m", 0),
}
_TAKEN: dict[str, Callable[[bytes], Any]] = {
    "t": lambda data: data.decode("utf-8", "replace"),
    "b": bytes,
    "m": lambda data: dict(_PAIR.iter_unpack(data)),
}


def load_chunk(file: LogFile, chunk: ChunkIndex, keys: frozenset[int]) -> Iterator[tuple[int, Batch]]:
    """Yield the messages of some channels in a chunk; see `Task`."""
    raw = _read_chunk(file, chunk)
    counts = index_counts(file, chunk, keys)
    if counts is None:
        for key, positions in walk_records(raw).items():
            yield key, batch_of(raw, positions)
    else:
        for key in counts:
            entries = index_entries(file, chunk, key)
            yield key, _indexed(raw, np.ascontiguousarray(entries[:, 1]), key)


@dataclass(slots=True)
class Loose:
    """Messages that lie in the file itself, or in what is left of a cut chunk."""

    file: LogFile
    #: The part of the file.
    position: int
    size: int = 0
    #: Channel -> positions of records from the start of that part.
    starts: dict[int, list[int]] = field(default_factory=dict)
    #: What is left of the chunk; None where the records lie in the file.
    data: bytes | None = None

    @property
    def counts(self) -> dict[int, int]:
        """Channel -> number of messages."""
        return {key: len(positions) for key, positions in self.starts.items()}

    def load(self) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each channel; see `Task`."""
        raw = self.file.read(self.position, self.size) if self.data is None else self.data
        for key, positions in self.starts.items():
            yield key, batch_of(raw, positions)


def index_count(file: LogFile, key: int, position: int) -> int:
    """Return the messages of a channel by its index at `position`; raises DamagedError if there is none."""
    head = file.read(position, _INDEX_HEAD)
    opcode, length, channel = _RECORD.unpack_from(head, 0)
    size = int.from_bytes(head[11:], "little")
    whole = position + 9 + length <= file.size
    damaged_if(
        opcode != MESSAGE_INDEX or channel != key or size + 6 != length or size % 16 or not whole,
        "a message index is damaged",
        "index",
    )
    return size // 16


def index_counts(
    file: LogFile, chunk: ChunkIndex, keys: frozenset[int] | None = None
) -> dict[int, int] | None:
    """Return the messages of some channels in a chunk, or of all; None where its indexes don't tell."""
    if not chunk.indexes:
        return None
    chosen = [key for key in (chunk.indexes if keys is None else keys) if key in chunk.indexes]
    try:
        return {key: index_count(file, key, chunk.indexes[key]) for key in chosen}
    except DamagedError:
        return None


def index_entries(file: LogFile, chunk: ChunkIndex, key: int) -> IntArray:
    """Return log time and offset of the messages of a channel in a chunk, shape (n, 2), by its index.

    Raises DamagedError if there is none.
    """
    position = chunk.indexes[key]
    data = file.read(position + _INDEX_HEAD, 16 * index_count(file, key, position))
    return np.frombuffer(data, "<i8").reshape(-1, 2)


def _read_chunk(file: LogFile, chunk: ChunkIndex) -> memoryview:
    """Return what a chunk holds; raises DamagedError."""
    return unpack(memoryview(file.read(chunk.start, chunk.length)))


def unpack(record: memoryview, *, cut: bool = False) -> memoryview:
    """Return what a Chunk record holds; of a `cut` one what is left."""
    (size, crc, compression, stored), at = parse(CHUNK, record)
    data = record[at : at + stored]
    if cut:
        return memoryview(decompress_prefix(compression, data, size))
    head = HEAD.unpack_from(record, 0)
    damaged_if(head != (CHUNK, len(record) - 9) or len(data) != stored, "a chunk's head is damaged")
    raw = decompress(compression, data, size)
    check_crc(raw, crc)
    return raw


def walk_records(raw: Bytes) -> dict[int, list[int]]:
    """Return channel -> positions of its Message records, up to the first that is not whole."""
    positions: dict[int, list[int]] = {}
    for opcode, at, length in each_record(raw):
        if opcode == MESSAGE and length >= _MESSAGE - 9:
            positions.setdefault(_RECORD.unpack_from(raw, at)[2], []).append(at)
    return positions


def batch_of(raw: Bytes, positions: Sequence[int] | IntArray) -> Batch:
    """Return the messages whose whole records start at `positions`."""
    starts = np.asarray(positions, np.int64)
    return _batch(raw, starts, gather(raw, starts, _MESSAGE).view(_HEADS))


def _batch(raw: Bytes, starts: IntArray, heads: NDArray[Any]) -> Batch:
    return Batch(raw, starts + _MESSAGE, heads["length"] - (_MESSAGE - 9), heads["log"])


def _indexed(raw: memoryview, starts: IntArray, key: int) -> Batch:
    """Return the messages of an index; if a record is not the channel's, walk the chunk."""
    with suppress(DamagedError):
        heads = gather(raw, starts, _MESSAGE).view(_HEADS)
        length = heads["length"]
        right = (heads["opcode"] == MESSAGE) & (heads["channel"] == key)
        right &= (length >= _MESSAGE - 9) & (length <= len(raw) - 9 - starts)
        if right.all():
            return _batch(raw, starts, heads)
    loss = Loss(
        "index", "a message index points to wrong records; all records of its chunk were read instead"
    )
    return replace(batch_of(raw, walk_records(raw).get(key, [])), loss=loss)


@dataclass(slots=True)
class Bookkeeping:
    """What an MCAP file says about itself."""

    #: Number of a schema -> name, encoding and bytes.
    schemas: dict[int, list[Any]] = field(default_factory=dict)
    #: Channel -> the number of its schema (0 for none), topic and encoding.
    channels: dict[int, list[Any]] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    loose: list[Loose] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None
    findings: list[Finding] = field(default_factory=list)

    def define(self, opcode: int, body: Bytes) -> None:
        """Take a Schema or Channel record, unless its number is known."""
        (number, *said), _ = parse(opcode, body)
        (self.schemas if opcode == SCHEMA else self.channels).setdefault(number, said)

    def define_all(self, raw: memoryview) -> None:
        """Take all definitions among the records of a chunk, up to the first that is damaged."""
        with suppress(DamagedError):
            for opcode, at, length in each_record(raw):
                if opcode in DEFINITIONS:
                    self.define(opcode, raw[at + 9 : at + 9 + length])


def scan(file: LogFile, reason: DamagedError) -> Bookkeeping:
    """Return what the records say where the index is of no use; raises ReadError if there is no channel."""
    found = _Scan(file)
    end, book = found.visit_records(), found.book
    found.define_from_chunks()
    if not book.channels:
        raise refused(file.path, f"{reason}, and no whole record was found; expected an MCAP file")
    for chunk in book.chunks:
        counts = index_counts(file, chunk)
        if not counts:
            try:
                walked = walk_records(_read_chunk(file, chunk))
                counts = {key: len(places) for key, places in walked.items()}
            except DamagedError:
                # At least one message, so that the chunk is tried and its loss is reported.
                counts = dict.fromkeys(book.channels, 1)
        book.counts.update(counts)
    for loose in book.loose:
        book.counts.update(loose.counts)
    book.findings.append(file.scan_finding(reason, end))
    return book


class _Scan:
    """One scan of a file, which is read a megabyte at a time."""

    def __init__(self, file: LogFile) -> None:
        self.book = Bookkeeping()
        self._file = file
        self._start, self._data = 0, file.read(0, min(_WINDOW, file.size))

    def _take(self, at: int, size: int) -> memoryview:
        """Return `size` bytes from `at` on, never before the last place; fewer at the end of the file."""
        if at + size > self._start + len(self._data):
            self._start = at
            self._data = self._file.read(at, min(max(size, _WINDOW), self._file.size - at))
        return memoryview(self._data)[at - self._start : at - self._start + size]

    def visit_records(self) -> int:
        """Visit the records of the file; return where the last whole one of its data ends."""
        at, size, ended = len(MAGIC), self._file.size, False
        with suppress(DamagedError):
            while at + 9 <= size:
                opcode, length = HEAD.unpack_from(self._take(at, HEAD.size))
                after = at + 9 + length
                if opcode == FOOTER:
                    return size
                if not opcode or after > size:
                    if opcode == CHUNK:
                        self._salvage(at)
                    break
                # The summary behind the data repeats definitions, though its checksum may be wrong.
                ended |= opcode == DATA_END
                self._visit(opcode, at, length)
                at = after
        return size if ended else at

    def _visit(self, opcode: int, at: int, length: int) -> None:
        chunks = self.book.chunks
        if opcode in DEFINITIONS and length <= _MAX_DEFINITION:
            self.book.define(opcode, self._take(at + 9, length))
        elif opcode == CHUNK:
            (_, _, kind, _), _ = parse(CHUNK, self._take(at, min(HEAD.size + length, _HEAD_BLOCK)))
            chunks.append(ChunkIndex(at, 9 + length, kind))
        elif opcode == MESSAGE_INDEX and chunks:
            chunk = chunks[-1]
            key = int.from_bytes(self._take(at + 9, 2), "little")
            if chunk.start + chunk.length + chunk.index_length == at:
                chunk.index_length += 9 + length
                if length > 6:
                    chunk.indexes[key] = at
        elif opcode == MESSAGE and length >= _MESSAGE - 9:
            # A message that lies outside chunks.
            key, end, loose = (
                int.from_bytes(self._take(at + 9, 2), "little"),
                at + 9 + length,
                self.book.loose,
            )
            if not loose or end - loose[-1].position > _PART:
                loose.append(Loose(self._file, at))
            part = loose[-1]
            part.starts.setdefault(key, []).append(at - part.position)
            part.size = end - part.position

    def _salvage(self, at: int) -> None:
        """Keep the whole messages of a chunk that the end of the file cuts."""
        size = self._file.size - at
        with suppress(DamagedError):
            raw = unpack(memoryview(self._file.read(at, size)), cut=True)
            self.book.define_all(raw)
            if starts := walk_records(raw):
                self.book.loose.append(Loose(self._file, at, size, starts, bytes(raw)))

    def define_from_chunks(self) -> None:
        """Read definitions from chunks until every indexed channel is known.

        Without a summary, a channel is defined in the first chunk that has messages of it.
        """
        for chunk in self.book.chunks:
            if not chunk.indexes or not self.book.channels.keys() >= chunk.indexes.keys():
                with suppress(DamagedError):
                    self.book.define_all(_read_chunk(self._file, chunk))


class McapFile(MessageFile):
    """A container of the messages of an MCAP file."""

    format = "mcap"

    def _read_index(self) -> None:
        try:
            self._book = self._summary()
        except DamagedError as error:
            self._book = scan(self._file, error)
        self.findings = self._book.findings
        self.start_ns, self.end_ns = self._book.start_ns, self._book.end_ns
        kinds = sorted({chunk.compression or "none" for chunk in self._book.chunks})
        self.compression = ", ".join(kinds) or "none"
        unknown = [kind for kind in kinds if kind not in KINDS]
        if unknown:
            raise refused(self.path, f"chunks are compressed by {unknown[0]!r}; expected none, lz4 or zstd")
        self.channels = self._channels()

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some channels."""
        for chunk in self._book.chunks:
            if found := keys & chunk.indexes.keys() if chunk.indexes else keys:
                size = chunk.length + chunk.index_length
                yield Task(size, found, partial(load_chunk, self._file, chunk, found))
        for loose in self._book.loose:
            if found := keys & loose.starts.keys():
                yield Task(loose.size, found, loose.load)

    def _summary(self) -> Bookkeeping:
        """Read the summary; raises DamagedError if it is missing, damaged or does not index all."""
        size = self.size
        damaged_if(
            size < len(MAGIC) + _FOOTER_SIZE or self._file.read(0, len(MAGIC)) != MAGIC,
            "the file does not start and end as an MCAP file",
        )
        tail = self._file.read(size - _FOOTER_SIZE, _FOOTER_SIZE)
        damaged_if(tail[-8:] != MAGIC, "the end of the file is missing", "truncated")
        start, _, crc = struct.unpack_from("<QQI", tail, HEAD.size)
        damaged_if(HEAD.unpack_from(tail, 0) != (FOOTER, 20), "the footer is damaged")
        damaged_if(not start, "the file has no index", "unindexed")
        damaged_if(
            not len(MAGIC) <= start <= size - _FOOTER_SIZE or size - start > _MAX_SUMMARY,
            "the footer points beyond the file",
        )
        summary = self._file.read(start, size - _FOOTER_SIZE - start)
        damaged_if(
            crc and crc32(tail[:25], crc32(summary)) != crc, "the index's checksum does not match", "crc"
        )
        return self._parse(memoryview(summary))

    def _parse(self, summary: memoryview) -> Bookkeeping:
        book = Bookkeeping()
        end = total = chunks = 0
        for opcode, at, length in each_record(summary):
            end = at + 9 + length
            body = summary[at + 9 : end]
            if opcode in DEFINITIONS:
                book.define(opcode, body)
            elif opcode == CHUNK_INDEX:
                (start, size, indexes, behind, kind), _ = parse(opcode, body)
                book.chunks.append(ChunkIndex(start, size, kind, behind, indexes))
            elif opcode == STATISTICS:
                (total, *_, chunks, book.start_ns, book.end_ns, counts), _ = parse(opcode, body)
                book.counts = Counter(counts)
        damaged_if(end + 9 <= len(summary), "the index is cut off")
        # An index that leaves out what the statistics count, or points nowhere, is of no use.
        damaged_if(
            len(book.chunks) < chunks or (total and not book.chunks) or not book.channels,
            "the index does not list all chunks",
            "unindexed",
        )
        damaged_if(
            sum(chunk.length + chunk.index_length for chunk in book.chunks) > self.size,
            "the index lists chunks twice",
        )
        for chunk in book.chunks:
            end = chunk.start + chunk.length + chunk.index_length
            damaged_if(chunk.start < len(MAGIC) or end > self.size, "the index points beyond the file")
        if not book.counts:
            for chunk in book.chunks:
                book.counts.update(
                    {key: index_count(self._file, key, at) for key, at in chunk.indexes.items()}
                )
        return book

    def _channels(self) -> list[Channel]:
        book, spans = self._book, self._spans()
        channels = []
        for key, (number, topic, encoding) in sorted(book.channels.items()):
            name, form, schema = book.schemas.get(number, ("", "", b""))
            times = spans.get(key, ())
            channels.append(
                Channel(
                    key=key,
                    topic=topic,
                    type=name,
                    encoding=encoding,
                    definition=schema.decode("utf-8", "replace"),
                    definition_kind=form,
                    schema=schema,
                    count=book.counts[key],
                    first_ns=min(times, default=None),
                    last_ns=max(times, default=None),
                )
            )
        return channels

    def _spans(self) -> dict[int, list[int]]:
        """Return times of each channel: of its first and last chunk, and outside of chunks."""
        ends: dict[int, tuple[ChunkIndex, ChunkIndex]] = {}
        for chunk in self._book.chunks:
            for key in chunk.indexes:
                ends[key] = (ends[key][0] if key in ends else chunk, chunk)
        times: dict[int, list[int]] = {}
        for key, chunks in ends.items():
            with suppress(DamagedError):
                entries = [index_entries(self._file, chunk, key)[:, 0] for chunk in chunks]
                times[key] = np.concatenate(entries).tolist()
        for loose in self._book.loose:
            for key, batch in loose.load():
                times.setdefault(key, []).extend([int(batch.log_ns.min()), int(batch.log_ns.max())])
        return times


open_files = McapFile.open_files
