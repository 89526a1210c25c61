"""MCAP: ROS 2, ROS 1 and JSON messages, chunks uncompressed or in lz4 or zstd.

An intact file is read by the index at its end; a cut, unindexed or damaged one by scanning its records.

The chunks of an MCAP file: loaded by their message index, walked record by record where it fails.

An MCAP file without a good index, scanned record by record.

A cut file keeps everything before the cut, of its last chunk too; the zeros that a crash leaves end it.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.compression import KINDS, check_crc, crc32, decompress, decompress_prefix
from imucal.readers.containers import mcap_records as records
from imucal.readers.containers.container import Batch, Bytes, Channel, Container, Loss, Task, gather
from imucal.readers.containers.mcap_records import HEAD, MAGIC, ChannelRecord, ChunkIndex, Schema
from imucal.readers.files import DamagedError, LogFile, Scratch
from imucal.readers.read_options import Progress

#: Opcode, length, channel and so on of a Message record: its payload starts here.
_MESSAGE = 31
_RECORD = struct.Struct("<BQH")
#: A chunk's message index has this many bytes in front of its entries of 16.
_INDEX_HEAD = 15


class ChunkTask:
    """A chunk to load."""

    def __init__(self, file: LogFile, chunk: ChunkIndex, keys: frozenset[int]) -> None:
        self._file = file
        self._chunk = chunk
        self.size = chunk.length + chunk.index_length
        self._indexed = bool(chunk.indexes)
        if self._indexed:
            try:
                counts = {
                    key: index_count(file, key, chunk.indexes[key]) for key in keys if key in chunk.indexes
                }
            except DamagedError:
                self._indexed = False
        if not self._indexed:
            counts = self._walked_counts(keys)
        self.counts = {key: count for key, count in counts.items() if count}

    @staticmethod
    def times(file: LogFile, chunk: ChunkIndex, key: int) -> IntArray:
        """Return the log times of a channel in a chunk, by its index, shape (n,)."""
        position = chunk.indexes[key]
        count = index_count(file, key, position)
        data = file.read(position + _INDEX_HEAD, 16 * count)
        return np.frombuffer(data, "<i8").reshape(-1, 2)[:, 0]

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted channel; see `Task`."""
        chunk = self._chunk
        region = scratch.buffer(self.size)
        self._file.into(chunk.start, region)
        raw = unpack(region[: chunk.length])
        if not self._indexed:
            walked = walk_records(raw)
            for key in self.counts:
                yield key, batch_of(raw, walked.get(key, []))
            return
        for key, count in self.counts.items():
            at = chunk.indexes[key] - chunk.start + _INDEX_HEAD
            offsets = np.frombuffer(region, "<i8", 2 * count, at).reshape(count, 2)[:, 1]
            yield key, self._batch(raw, np.ascontiguousarray(offsets), key)

    def _batch(self, raw: memoryview, starts: IntArray, key: int) -> Batch:
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
            guards=((0, _RECORD.pack(records.MESSAGE, length, key)),),
            check=check,
        )

    def _walked_counts(self, keys: frozenset[int]) -> dict[int, int]:
        """Count messages by walking; a damaged chunk counts none, and is reported when it is loaded."""
        try:
            raw = unpack(memoryview(self._file.read(self._chunk.start, self._chunk.length)))
        except DamagedError:
            # One message at least, so that the chunk is tried, and its loss is told.
            return dict.fromkeys(keys, 1)
        walked = walk_records(raw)
        return {key: len(walked[key]) for key in keys if key in walked}


@dataclass(slots=True)
class LooseTask:
    """Messages that lie in the file itself, or in what is left of a cut chunk.

    Attributes
    ----------
    file
        The file; None where `data` holds the records.
    position, size
        The part of the file.
    starts
        Channel -> positions of records from the start of that part.
    """

    file: LogFile
    position: int
    size: int = 0
    starts: dict[int, list[int]] = field(default_factory=dict)
    data: bytes | None = None

    @property
    def counts(self) -> dict[int, int]:
        """Channel -> number of messages."""
        return {key: len(positions) for key, positions in self.starts.items()}

    def only(self, keys: frozenset[int]) -> "LooseTask":
        """Return the same part with some channels only."""
        chosen = {key: positions for key, positions in self.starts.items() if key in keys}
        return LooseTask(self.file, self.position, self.size, chosen, self.data)

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each channel; see `Task`."""
        raw = self._bytes(scratch)
        for key, positions in self.starts.items():
            yield key, batch_of(raw, positions)

    def spans(self) -> dict[int, tuple[int, int]]:
        """Return first and last log time of each channel, in ns."""
        raw = self._bytes(Scratch())
        times = {key: batch_of(raw, positions).log_ns for key, positions in self.starts.items()}
        return {key: (int(values.min()), int(values.max())) for key, values in times.items()}

    def _bytes(self, scratch: Scratch) -> memoryview:
        if self.data is not None:
            return memoryview(self.data)
        region = scratch.buffer(self.size)
        self.file.into(self.position, region)
        return region


def index_count(file: LogFile, key: int, position: int) -> int:
    """Return the number of entries of a message index.

    Raises
    ------
    DamagedError
        If there is no such index at `position`.
    """
    head = file.read(position, _INDEX_HEAD)
    opcode, length, channel = _RECORD.unpack_from(head, 0)
    size = int.from_bytes(head[11:], "little")
    whole = position + 9 + length <= file.size
    if opcode != records.MESSAGE_INDEX or channel != key or size + 6 != length or size % 16 or not whole:
        msg = "a message index is damaged"
        raise DamagedError(msg, code="index")
    return size // 16


def unpack(record: memoryview, *, cut: bool = False) -> memoryview:
    """Return what a Chunk record holds; of a `cut` one what is left."""
    head = records.chunk_head(record)
    data = record[head.data : head.data + head.stored]
    if cut:
        return memoryview(decompress_prefix(head.compression, data, head.size))
    opcode, length = HEAD.unpack_from(record, 0)
    if opcode != records.CHUNK or length + 9 != len(record) or len(data) != head.stored:
        msg = "a chunk's head is damaged"
        raise DamagedError(msg)
    raw = decompress(head.compression, data, head.size)
    check_crc(raw, head.crc)
    return raw


def walk_records(raw: Bytes) -> dict[int, list[int]]:
    """Return channel -> positions of its Message records, up to the first that is not whole."""
    positions: dict[int, list[int]] = {}
    at, end, head = 0, len(raw), _RECORD.unpack_from
    while at + _MESSAGE <= end:
        opcode, length, channel = head(raw, at)
        after = at + 9 + length
        if after > end or not opcode:
            break
        if opcode == records.MESSAGE and length >= _MESSAGE - 9:
            positions.setdefault(channel, []).append(at)
        at = after
    return positions


def batch_of(raw: Bytes, positions: Sequence[int]) -> Batch:
    """Return the messages whose whole records start at `positions`."""
    starts = np.array(positions, dtype=np.int64)
    heads = gather(raw, starts, _MESSAGE)
    sizes = _field(heads, 1, "<i8") - (_MESSAGE - 9)
    return Batch.of(raw, starts, sizes, _field(heads, 15, "<i8"), header=_MESSAGE)


def _checked(raw: memoryview, starts: IntArray, key: int) -> Batch:
    """Check every record of an index; where one is none of the channel's, walk the chunk."""
    try:
        heads = gather(raw, starts, _MESSAGE)
        length = _field(heads, 1, "<i8")
        right = (_field(heads, 0, "u1") == records.MESSAGE) & (_field(heads, 9, "<u2") == key)
        right &= (length >= _MESSAGE - 9) & (length <= len(raw) - starts - 9)
        whole = bool(right.all())
    except DamagedError:
        whole = False
    if whole:
        return batch_of(raw, starts.tolist())
    loss = Loss(code="index", text="a message index points to other records; its chunk was walked instead")
    return replace(batch_of(raw, walk_records(raw).get(key, [])), loss=loss)


def _field(heads: NDArray[np.void], at: int, dtype: str) -> IntArray:
    """Return a field of gathered heads, shape (n,), as int64."""
    if not heads.size:
        return np.zeros(0, dtype=np.int64)
    view: IntArray = np.ndarray(heads.shape, dtype, buffer=heads, offset=at, strides=heads.strides)
    return view.astype(np.int64)


#: Messages outside chunks are loaded in parts of this many bytes.
_PART = 1 << 22
#: Schemas and channels are read whole; a longer one is damage.
_MAX_DEFINITION = 1 << 24
_WINDOW = 1 << 20
#: Bytes in which the head of a chunk is looked for: names of compressions are short.
_HEAD_BLOCK = 128


@dataclass(slots=True)
class Bookkeeping:
    """What an MCAP file says about itself."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    loose: list[LooseTask] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    findings: list[Finding] = field(default_factory=list)

    def define(self, opcode: int, body: memoryview) -> None:
        """Take a Schema or Channel record, unless its number is known."""
        if opcode == records.SCHEMA:
            schema = records.schema(body)
            self.schemas.setdefault(schema.id, schema)
        else:
            channel = records.channel(body)
            self.channels.setdefault(channel.id, channel)

    def define_all(self, raw: memoryview) -> None:
        """Take all definitions among the records of a chunk, up to the first that is damaged."""
        at = 0
        while at + 9 <= len(raw):
            opcode, length = HEAD.unpack_from(raw, at)
            if at + 9 + length > len(raw):
                return
            if opcode in {records.SCHEMA, records.CHANNEL}:
                try:
                    self.define(opcode, raw[at + 9 : at + 9 + length])
                except DamagedError:
                    return
            at += 9 + length

    def count(self, counts: dict[int, int]) -> None:
        """Add messages to those of each channel."""
        for key, count in counts.items():
            self.counts[key] = self.counts.get(key, 0) + count


def scan(file: LogFile, reason: DamagedError) -> Bookkeeping:
    """Return what the records of a file say whose index is missing or damaged.

    Raises
    ------
    ReadError
        If the file holds no channel.
    """
    found = _Scan(file)
    end, book = found.visit_records(), found.book
    found.find_channels()
    if not book.channels:
        msg = f"{file.path}: {reason}, and no whole record was found; expected an MCAP file"
        raise ReadError(msg)
    found.count()
    lost = file.size - end
    text = f"The index can't be used ({reason}); all records were scanned instead."
    if lost:
        text += f" The last {lost} of {file.size} bytes are cut or damaged."
    book.findings.append(Finding(level="warning", code="truncated" if lost else reason.code, text=text))
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

    def _head(self, at: int) -> tuple[int, int]:
        """Return opcode and length of the record at `at`."""
        opcode, length = HEAD.unpack_from(self._take(at, HEAD.size))
        return opcode, length

    def visit_records(self) -> int:
        """Visit the records of the file; return where the last whole one ends."""
        file, at = self._file, len(MAGIC)
        while at + 9 <= file.size:
            opcode, length = self._head(at)
            after = at + 9 + length
            if not opcode or opcode == records.FOOTER:
                return file.size if opcode else at
            if after > file.size:
                if opcode == records.CHUNK:
                    self._salvage(at)
                return at
            if opcode == records.DATA_END:
                self._define_from_summary(after)
                return file.size
            try:
                self._visit(opcode, at, length)
            except DamagedError:
                return at
            at = after
        return at

    def _define_from_summary(self, at: int) -> None:
        """Take definitions that the summary repeats, though its checksum is wrong."""
        while at + 9 <= self._file.size:
            opcode, length = self._head(at)
            if at + 9 + length > self._file.size or opcode not in {records.SCHEMA, records.CHANNEL}:
                return
            try:
                self.book.define(opcode, self._take(at + 9, length))
            except DamagedError:
                return
            at += 9 + length

    def _visit(self, opcode: int, at: int, length: int) -> None:
        chunks = self.book.chunks
        if opcode in {records.SCHEMA, records.CHANNEL} and length <= _MAX_DEFINITION:
            self.book.define(opcode, self._take(at + 9, length))
        elif opcode == records.CHUNK:
            head = records.chunk_head(self._take(at, min(HEAD.size + length, _HEAD_BLOCK)))
            chunks.append(ChunkIndex(start=at, length=9 + length, compression=head.compression))
        elif opcode == records.MESSAGE_INDEX and chunks:
            chunk = chunks[-1]
            key = int.from_bytes(self._take(at + 9, 2), "little")
            if chunk.start + chunk.length + chunk.index_length == at:
                chunk.index_length += 9 + length
                if length > 6:
                    chunk.indexes[key] = at
        elif opcode == records.MESSAGE and length >= 22:
            self._add_loose(int.from_bytes(self._take(at + 9, 2), "little"), at, length)

    def _add_loose(self, key: int, at: int, length: int) -> None:
        """Take a message that lies outside chunks."""
        loose = self.book.loose
        part = loose[-1] if loose else None
        if part is None or part.data is not None or at + 9 + length - part.position > _PART:
            part = LooseTask(self._file, at)
            loose.append(part)
        part.starts.setdefault(key, []).append(at - part.position)
        part.size = at + 9 + length - part.position

    def _salvage(self, at: int) -> None:
        """Keep the whole messages of a chunk that the end of the file cuts."""
        size = self._file.size - at
        try:
            raw = unpack(memoryview(self._file.read(at, size)), cut=True)
        except DamagedError:
            return
        self.book.define_all(raw)
        starts = walk_records(raw)
        if starts:
            self.book.loose.append(LooseTask(self._file, at, size, starts, bytes(raw)))

    def find_channels(self) -> None:
        """Read definitions from chunks until every indexed channel is known.

        Without a summary, a channel is defined in the first chunk that has messages of it.
        """
        for chunk in self.book.chunks:
            if chunk.indexes and self.book.channels.keys() >= chunk.indexes.keys():
                continue
            try:
                raw = unpack(memoryview(self._file.read(chunk.start, chunk.length)))
            except DamagedError:
                continue
            self.book.define_all(raw)

    def count(self) -> None:
        """Count the messages of each channel."""
        for chunk in self.book.chunks:
            try:
                counts = {key: index_count(self._file, key, at) for key, at in chunk.indexes.items()}
            except DamagedError:
                counts = {}
            self.book.count(counts or ChunkTask(self._file, chunk, frozenset(self.book.channels)).counts)
        for loose in self.book.loose:
            self.book.count(loose.counts)


_FOOTER_SIZE = 9 + 20 + 8
#: Ids of channels and schemas have 16 bits; a summary larger than this can only be damage, in bytes.
_MAX_SUMMARY = 1 << 31


def open_files(path: Path, progress: Progress | None = None) -> tuple[list[Container], str]:
    """Open an MCAP file; also return the name of its format.

    Raises
    ------
    ReadError
        If it can't be read.
    """
    del progress
    return [McapFile(path)], McapFile.format


class McapFile:
    """A container of the messages of an MCAP file."""

    format = "mcap"
    parallel = True

    def __init__(self, path: Path, file: LogFile | None = None) -> None:
        self.path = path
        self._file = file or LogFile(path)
        self.size = self._file.size
        try:
            self._prepare()
        except BaseException:
            self.close()
            raise

    def _prepare(self) -> None:
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

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some channels."""
        for chunk in self._book.chunks:
            task = ChunkTask(self._file, chunk, keys)
            if task.counts:
                yield cast("Task", task)
        for loose in self._book.loose:
            part = loose.only(keys)
            if part.counts:
                yield cast("Task", part)

    def _summary(self) -> Bookkeeping:
        """Read the summary section.

        Raises
        ------
        DamagedError
            If it is missing, damaged, or does not index all messages.
        """
        size = self._file.size
        if size < len(MAGIC) + _FOOTER_SIZE or self._file.read(0, len(MAGIC)) != MAGIC:
            msg = "the file does not start and end as an MCAP file"
            raise DamagedError(msg)
        tail = self._file.read(size - _FOOTER_SIZE, _FOOTER_SIZE)
        if tail[-8:] != MAGIC:
            msg = "the end of the file is missing"
            raise DamagedError(msg, code="truncated")
        opcode, length = HEAD.unpack_from(tail, 0)
        start = int.from_bytes(tail[9:17], "little")
        crc = int.from_bytes(tail[25:29], "little")
        if opcode != records.FOOTER or length != 20:
            msg = "the footer is damaged"
            raise DamagedError(msg)
        if not start:
            msg = "the file has no index"
            raise DamagedError(msg, code="unindexed")
        if not len(MAGIC) <= start <= size - _FOOTER_SIZE or size - start > _MAX_SUMMARY:
            msg = "the footer points beyond the file"
            raise DamagedError(msg)
        summary = self._file.read(start, size - _FOOTER_SIZE - start)
        if crc and crc32(tail[:25], crc32(summary)) != crc:
            msg = "the index's checksum does not match"
            raise DamagedError(msg, code="crc")
        return self._parse(summary)

    def _parse(self, summary: bytearray) -> Bookkeeping:
        book = Bookkeeping()
        view, at = memoryview(summary), 0
        total = chunks = 0
        while at + 9 <= len(view):
            opcode, length = HEAD.unpack_from(view, at)
            body = view[at + 9 : at + 9 + length]
            if len(body) != length:
                msg = "the index is cut"
                raise DamagedError(msg)
            if opcode == records.SCHEMA:
                parsed = records.schema(body)
                book.schemas[parsed.id] = parsed
            elif opcode == records.CHANNEL:
                channel = records.channel(body)
                book.channels[channel.id] = channel
            elif opcode == records.CHUNK_INDEX:
                book.chunks.append(records.chunk_index(body))
            elif opcode == records.STATISTICS:
                total, chunks, book.start_ns, book.end_ns, book.counts = records.statistics(body)
            at += 9 + length
        self._check(book, total, chunks)
        return book

    def _check(self, book: Bookkeeping, total: int, chunks: int) -> None:
        """Refuse an index that leaves out what the statistics count, or points nowhere."""
        if len(book.chunks) < chunks or (total and not book.chunks) or not book.channels:
            msg = "the index leaves out chunks"
            raise DamagedError(msg, code="unindexed")
        if sum(chunk.length + chunk.index_length for chunk in book.chunks) > self._file.size:
            msg = "the index lists chunks twice"
            raise DamagedError(msg)
        for chunk in book.chunks:
            end = chunk.start + chunk.length + chunk.index_length
            if chunk.start < len(MAGIC) or end > self._file.size:
                msg = "the index points beyond the file"
                raise DamagedError(msg)
        if not book.counts:
            for chunk in book.chunks:
                book.count({key: index_count(self._file, key, at) for key, at in chunk.indexes.items()})

    def _channels(self) -> list[Channel]:
        book = self._book
        spans = self._spans()
        channels = []
        for key, record in sorted(book.channels.items()):
            described = book.schemas.get(record.schema, Schema(0, "", "", ""))
            first, last = spans.get(key, (None, None))
            channels.append(
                Channel(
                    key=key,
                    topic=record.topic,
                    type=described.name,
                    encoding=record.encoding,
                    definition=described.text,
                    definition_kind=described.encoding,
                    schema=described.raw,
                    count=book.counts.get(key, 0),
                    first_ns=first,
                    last_ns=last,
                )
            )
        return channels

    def _spans(self) -> dict[int, tuple[int, int]]:
        """Return first and last time of each channel, from the indexes of its first and last chunk."""
        first: dict[int, ChunkIndex] = {}
        last: dict[int, ChunkIndex] = {}
        for chunk in self._book.chunks:
            for key in chunk.indexes:
                first.setdefault(key, chunk)
                last[key] = chunk
        spans = {}
        for key, chunk in first.items():
            try:
                times = [
                    time for c in (chunk, last[key]) for time in ChunkTask.times(self._file, c, key).tolist()
                ]
            except DamagedError:
                continue
            if times:
                spans[key] = (min(times), max(times))
        for loose in self._book.loose:
            for key, (begin, end) in loose.spans().items():
                held = spans.get(key, (begin, end))
                spans[key] = (min(held[0], begin), max(held[1], end))
        return spans
