"""MCAP: ROS 2, ROS 1 and JSON messages, chunks uncompressed or in lz4 or zstd.

An intact file is read by the index at its end; a cut, unindexed or damaged one by scanning its records. A
cut file keeps everything before the cut, of its last chunk too; the zeros that a crash leaves end it. The
`mcap` package reads intact files and is the witness in the tests; it refuses every truncated file, and builds
an object for each record. Source: MCAP specification 0, https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.compression import KINDS, check_crc, crc32, decompress, decompress_prefix
from imucal.readers.containers.container import (
    Batch,
    Bytes,
    Channel,
    Loss,
    MessageFile,
    Task,
    gather,
    scan_finding,
)
from imucal.readers.files import DamagedError, LogFile, Scratch, damaged_if

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


@dataclass(frozen=True, slots=True)
class Schema:
    """A message definition."""

    id: int
    name: str
    encoding: str
    text: str
    raw: bytes = field(default=b"", compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkHead:
    """The fields of a chunk in front of its data, which start `data` bytes after the record's start."""

    size: int
    crc: int
    compression: str
    data: int
    stored: int


@dataclass(slots=True, kw_only=True)
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


class _Fields:
    """The fields of a record, taken one behind the other."""

    def __init__(self, record: Bytes, name: str, at: int = 0) -> None:
        self.at = at
        self._record = record
        self._damage = f"a {name} record is damaged"

    def bytes(self, size: int) -> bytes:
        """Take `size` bytes; raises DamagedError where the record ends before."""
        start, self.at = self.at, self.at + size
        damaged_if(self.at > len(self._record), self._damage)
        return bytes(self._record[start : self.at])

    def number(self, size: int) -> int:
        """Take a number of `size` bytes."""
        return int.from_bytes(self.bytes(size), "little")

    def text(self) -> str:
        """Take a text behind its length."""
        return self.bytes(self.number(4)).decode("utf-8", "replace")

    def map(self) -> dict[int, int]:
        """Take a map of channels behind its length."""
        data = self.bytes(self.number(4))
        damaged_if(len(data) % _PAIR.size, self._damage)
        return dict(_PAIR.iter_unpack(data))


def parse_schema(body: Bytes) -> Schema:
    """Parse a Schema record."""
    fields = _Fields(body, "schema")
    number, name, encoding = fields.number(2), fields.text(), fields.text()
    raw = fields.bytes(fields.number(4))
    return Schema(number, name, encoding, raw.decode("utf-8", "replace"), raw)


def parse_channel(body: Bytes) -> tuple[int, Channel]:
    """Return the number of a channel's schema (0 for none), and the channel; its metadata is not needed."""
    fields = _Fields(body, "channel")
    key, number, topic = fields.number(2), fields.number(2), fields.text()
    return number, Channel(key=key, topic=topic, type="", encoding=fields.text())


def parse_chunk_head(record: Bytes) -> ChunkHead:
    """Parse the head of a Chunk record, its opcode and length included."""
    fields = _Fields(record, "chunk", at=25)
    size, crc, compression, stored = fields.number(8), fields.number(4), fields.text(), fields.number(8)
    return ChunkHead(size=size, crc=crc, compression=compression, data=fields.at, stored=stored)


def parse_chunk_index(body: Bytes) -> ChunkIndex:
    """Parse a ChunkIndex record."""
    fields = _Fields(body, "chunk index", at=16)
    start, length, indexes = fields.number(8), fields.number(8), fields.map()
    index_length = fields.number(8)
    return ChunkIndex(
        start=start, length=length, index_length=index_length, indexes=indexes, compression=fields.text()
    )


def parse_statistics(body: Bytes) -> tuple[int, int, int, int, dict[int, int]]:
    """Return messages, chunks, first and last time in ns, and messages of each channel."""
    fields = _Fields(body, "statistics")
    messages = fields.number(8)
    fields.at = 22
    return messages, fields.number(4), fields.number(8), fields.number(8), fields.map()


class ChunkTask:
    """A chunk to load."""

    def __init__(self, file: LogFile, chunk: ChunkIndex, keys: frozenset[int]) -> None:
        self._file = file
        self._chunk = chunk
        self.size = chunk.length + chunk.index_length
        counts = index_counts(file, chunk, keys)
        self._indexed = counts is not None
        if counts is None:
            try:
                walked = walk_records(_read_chunk(file, chunk))
                counts = {key: len(walked[key]) for key in keys if key in walked}
            except DamagedError:
                # One message at least, so that the chunk is tried, and its loss is told.
                counts = dict.fromkeys(keys, 1)
        self.counts = {key: count for key, count in counts.items() if count}

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted channel; see `Task`."""
        chunk = self._chunk
        region = scratch.buffer(self.size)
        self._file.into(chunk.start, region)
        raw = unpack(region[: chunk.length])
        walked = {} if self._indexed else walk_records(raw)
        for key, count in self.counts.items():
            if self._indexed:
                at = chunk.indexes[key] - chunk.start + _INDEX_HEAD
                offsets = np.frombuffer(region, "<i8", 2 * count, at).reshape(count, 2)[:, 1]
                yield key, _indexed(raw, np.ascontiguousarray(offsets), key)
            else:
                yield key, batch_of(raw, walked.get(key, []))


@dataclass(slots=True)
class LooseTask:
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

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each channel; see `Task`."""
        if self.data is not None:
            raw = memoryview(self.data)
        else:
            raw = scratch.buffer(self.size)
            self.file.into(self.position, raw)
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
        code="index",
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


def index_times(file: LogFile, chunk: ChunkIndex, key: int) -> list[int]:
    """Return the log times of a channel in a chunk, by its index; raises DamagedError."""
    position = chunk.indexes[key]
    data = file.read(position + _INDEX_HEAD, 16 * index_count(file, key, position))
    times: list[int] = np.frombuffer(data, "<i8")[::2].tolist()
    return times


def _read_chunk(file: LogFile, chunk: ChunkIndex) -> memoryview:
    """Return what a chunk holds; raises DamagedError."""
    return unpack(memoryview(file.read(chunk.start, chunk.length)))


def unpack(record: memoryview, *, cut: bool = False) -> memoryview:
    """Return what a Chunk record holds; of a `cut` one what is left."""
    head = parse_chunk_head(record)
    data = record[head.data : head.data + head.stored]
    if cut:
        return memoryview(decompress_prefix(head.compression, data, head.size))
    opcode, length = HEAD.unpack_from(record, 0)
    damaged_if(
        opcode != CHUNK or length + 9 != len(record) or len(data) != head.stored, "a chunk's head is damaged"
    )
    raw = decompress(head.compression, data, head.size)
    check_crc(raw, head.crc)
    return raw


def walk_records(raw: Bytes) -> dict[int, list[int]]:
    """Return channel -> positions of its Message records, up to the first that is not whole."""
    positions: dict[int, list[int]] = {}
    for opcode, at, length in each_record(raw):
        if opcode == MESSAGE and length >= _MESSAGE - 9:
            positions.setdefault(_RECORD.unpack_from(raw, at)[2], []).append(at)
    return positions


def batch_of(raw: Bytes, positions: Sequence[int]) -> Batch:
    """Return the messages whose whole records start at `positions`."""
    starts = np.array(positions, dtype=np.int64)
    heads = gather(raw, starts, _MESSAGE)
    sizes = _column(heads, 1, "<i8") - (_MESSAGE - 9)
    return Batch.of(raw, starts, sizes, _column(heads, 15, "<i8"), header=_MESSAGE)


def _indexed(raw: memoryview, starts: IntArray, key: int) -> Batch:
    """Return the messages of an index, whose records are taken to be like the first."""

    def check() -> Batch:
        return _checked(raw, starts, key)

    try:
        # What else the first record may be is no matter: the guards compare it with a message.
        length: int = _RECORD.unpack_from(raw, int(starts[0]))[1]
    except struct.error:
        return check()
    return Batch(
        buffer=raw,
        starts=starts,
        header=_MESSAGE,
        sizes=length - (_MESSAGE - 9),
        log_ns=starts[:0],
        log_at=15,
        guards=((0, _RECORD.pack(MESSAGE, length, key)),),
        check=check,
    )


def _checked(raw: memoryview, starts: IntArray, key: int) -> Batch:
    """Check every record of an index; where one is none of the channel's, walk the chunk."""
    with suppress(DamagedError):
        heads = gather(raw, starts, _MESSAGE)
        length = _column(heads, 1, "<i8")
        right = (_column(heads, 0, "u1") == MESSAGE) & (_column(heads, 9, "<u2") == key)
        right &= (length >= _MESSAGE - 9) & (length <= len(raw) - starts - 9)
        if right.all():
            return batch_of(raw, starts.tolist())
    loss = Loss(code="index", text="a message index points to other records; its chunk was walked instead")
    return replace(batch_of(raw, walk_records(raw).get(key, [])), loss=loss)


def _column(heads: NDArray[np.void], at: int, dtype: str) -> IntArray:
    """Return a field of gathered heads, shape (n,), as int64."""
    if not heads.size:
        return np.zeros(0, dtype=np.int64)
    view: IntArray = np.ndarray(heads.shape, dtype, buffer=heads, offset=at, strides=heads.strides)
    return view.astype(np.int64)


@dataclass(slots=True)
class Bookkeeping:
    """What an MCAP file says about itself."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    #: Channel -> the number of its schema, and what its record says.
    channels: dict[int, tuple[int, Channel]] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    loose: list[LooseTask] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None
    findings: list[Finding] = field(default_factory=list)

    def define(self, opcode: int, body: Bytes) -> None:
        """Take a Schema or Channel record, unless its number is known."""
        if opcode == SCHEMA:
            schema = parse_schema(body)
            self.schemas.setdefault(schema.id, schema)
        else:
            number, channel = parse_channel(body)
            self.channels.setdefault(channel.key, (number, channel))

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
        msg = f"{file.path}: {reason}, and no whole record was found; expected an MCAP file"
        raise ReadError(msg)
    known = frozenset(book.channels)
    for chunk in book.chunks:
        book.counts.update(index_counts(file, chunk) or ChunkTask(file, chunk, known).counts)
    for loose in book.loose:
        book.counts.update(loose.counts)
    book.findings.append(scan_finding(reason, end, file.size))
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
            head = parse_chunk_head(self._take(at, min(HEAD.size + length, _HEAD_BLOCK)))
            chunks.append(ChunkIndex(start=at, length=9 + length, compression=head.compression))
        elif opcode == MESSAGE_INDEX and chunks:
            chunk = chunks[-1]
            key = int.from_bytes(self._take(at + 9, 2), "little")
            if chunk.start + chunk.length + chunk.index_length == at:
                chunk.index_length += 9 + length
                if length > 6:
                    chunk.indexes[key] = at
        elif opcode == MESSAGE and length >= _MESSAGE - 9:
            self._add_loose(int.from_bytes(self._take(at + 9, 2), "little"), at, at + 9 + length)

    def _add_loose(self, key: int, at: int, end: int) -> None:
        """Take a message that lies outside chunks."""
        loose = self.book.loose
        if not loose or end - loose[-1].position > _PART:
            loose.append(LooseTask(self._file, at))
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
                self.book.loose.append(LooseTask(self._file, at, size, starts, bytes(raw)))

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
            msg = f"{self.path}: chunks are compressed by {unknown[0]!r}; expected none, lz4 or zstd"
            raise ReadError(msg)
        self.channels = self._channels()

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some channels."""
        for chunk in self._book.chunks:
            task = ChunkTask(self._file, chunk, keys)
            if task.counts:
                yield task
        for loose in self._book.loose:
            if starts := {key: starts for key, starts in loose.starts.items() if key in keys}:
                yield replace(loose, starts=starts)

    def _summary(self) -> Bookkeeping:
        """Read the summary; raises DamagedError if it is missing, damaged or does not index all."""
        size = self.size
        damaged_if(
            size < len(MAGIC) + _FOOTER_SIZE or self._file.read(0, len(MAGIC)) != MAGIC,
            "the file does not start and end as an MCAP file",
        )
        tail = self._file.read(size - _FOOTER_SIZE, _FOOTER_SIZE)
        damaged_if(tail[-8:] != MAGIC, "the end of the file is missing", code="truncated")
        start, _, crc = struct.unpack_from("<QQI", tail, HEAD.size)
        damaged_if(HEAD.unpack_from(tail, 0) != (FOOTER, 20), "the footer is damaged")
        damaged_if(not start, "the file has no index", code="unindexed")
        damaged_if(
            not len(MAGIC) <= start <= size - _FOOTER_SIZE or size - start > _MAX_SUMMARY,
            "the footer points beyond the file",
        )
        summary = self._file.read(start, size - _FOOTER_SIZE - start)
        damaged_if(
            crc and crc32(tail[:25], crc32(summary)) != crc, "the index's checksum does not match", code="crc"
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
                book.chunks.append(parse_chunk_index(body))
            elif opcode == STATISTICS:
                total, chunks, book.start_ns, book.end_ns, counts = parse_statistics(body)
                book.counts = Counter(counts)
        damaged_if(end + 9 <= len(summary), "the index is cut")
        self._check(book, total, chunks)
        return book

    def _check(self, book: Bookkeeping, total: int, chunks: int) -> None:
        """Refuse an index that leaves out what the statistics count, or points nowhere."""
        damaged_if(
            len(book.chunks) < chunks or (total and not book.chunks) or not book.channels,
            "the index leaves out chunks",
            code="unindexed",
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

    def _channels(self) -> list[Channel]:
        book, spans = self._book, self._spans()
        channels = []
        for key, (number, channel) in sorted(book.channels.items()):
            schema = book.schemas.get(number, Schema(0, "", "", ""))
            first, last = spans.get(key, (None, None))
            channels.append(
                replace(
                    channel,
                    type=schema.name,
                    definition=schema.text,
                    definition_kind=schema.encoding,
                    schema=schema.raw,
                    count=book.counts[key],
                    first_ns=first,
                    last_ns=last,
                )
            )
        return channels

    def _spans(self) -> dict[int, tuple[int, int]]:
        """Return first and last time of each channel: of its first and last chunk, and outside of chunks."""
        ends: dict[int, tuple[ChunkIndex, ChunkIndex]] = {}
        for chunk in self._book.chunks:
            for key in chunk.indexes:
                ends[key] = (ends[key][0] if key in ends else chunk, chunk)
        times: dict[int, list[int]] = {}
        for key, chunks in ends.items():
            with suppress(DamagedError):
                times[key] = [time for chunk in chunks for time in index_times(self._file, chunk, key)]
        for loose in self._book.loose:
            for key, batch in loose.load(Scratch()):
                times.setdefault(key, []).extend([int(batch.log_ns.min()), int(batch.log_ns.max())])
        return {key: (min(values), max(values)) for key, values in times.items() if values}


open_files = McapFile.open_files
