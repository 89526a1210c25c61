"""MCAP files with chunks uncompressed or in lz4 or zstd.

The `mcap` package builds an object per message, so messages are located here. Without a valid index, records
are scanned up to the first incomplete one or to zeros left by a crash. Source: MCAP specification 0,
https://mcap.dev/spec.
"""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.records import Channel as ChannelRecord
from mcap.records import ChunkIndex, Footer, Schema, Statistics

from imucal.arrays import IntArray
from imucal.readers.compression import KINDS, check_crc, crc32, decompress
from imucal.readers.containers.container import Batch, Bytes, Channel, Loss, MessageFile, Task, cells, gather
from imucal.readers.files import DamagedError, damaged_if, refused

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 2, 3, 4, 5, 6, 7, 8
STATISTICS, DATA_END = 0x0B, 0x0F

HEAD = struct.Struct("<BQ")
#: Channel and log time of a Message record; the payload starts after `_PAYLOAD` bytes.
_MESSAGE = struct.Struct("<9xH4xq")
_PAYLOAD = 31
#: MessageIndex record: opcode, length, channel, bytes of entries.
_INDEX = struct.Struct("<BQHI")
#: Content size, CRC, length of the compression's name, which follows.
_CHUNK = struct.Struct("<9x16xQII")
_U64 = struct.Struct("<Q")
_TAIL = 9 + 20 + 8
#: A larger summary is damage (ids have 16 bits), in bytes.
_MAX_SUMMARY = 1 << 31
#: Messages outside chunks are loaded in parts of this size, in bytes.
_PART = 1 << 22
#: A longer definition is damage, in bytes.
_MAX_DEFINITION = 1 << 24
#: Bytes read of each record in a scan; the names of compressions fit.
_START = 128


@dataclass(slots=True)
class Chunk:
    """A chunk's place in the file; for messages outside chunks, `compression` is None."""

    start: int
    end: int
    compression: str | None
    #: Channel -> position of its message index.
    indexes: dict[int, int] = field(default_factory=dict)


class _Exact(BytesIO):
    """A stream that raises DamagedError if it ends early."""

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        damaged_if(len(data) < (size or 0), "a record is incomplete")
        return data


def parsed(kind: Any, record: Bytes) -> Any:  # noqa: ANN401 - the classes have no common method
    """Parse a record; raises DamagedError."""
    try:
        return kind.read(ReadDataStream(_Exact(record[HEAD.size :])))
    except (DamagedError, UnicodeDecodeError) as error:
        raise DamagedError(f"a {kind.__name__} record is damaged") from error


def each_record(data: Bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record, up to zeros or the first incomplete one."""
    at, size, head = 0, len(data), HEAD.unpack_from
    while at + HEAD.size <= size:
        opcode, length = head(data, at)
        end = at + HEAD.size + length
        if end > size or not opcode:
            return
        yield opcode, at, end
        at = end


def unpack(record: memoryview) -> memoryview:
    """Return the content of a Chunk record; raises DamagedError."""
    try:
        size, crc, length = _CHUNK.unpack_from(record)
        at = _CHUNK.size + length
        (stored,) = _U64.unpack_from(record, at)
    except struct.error as error:
        raise DamagedError("a chunk's head is damaged") from error
    data = record[at + _U64.size :]
    damaged_if(HEAD.unpack_from(record) != (CHUNK, len(record) - HEAD.size), "a chunk's head is damaged")
    damaged_if(len(data) < stored, "a chunk's head is damaged")
    raw = decompress(_compression(record), data[:stored], size)
    check_crc(raw, crc)
    return raw


def _compression(record: Bytes) -> str:
    length = int.from_bytes(record[_CHUNK.size - 4 : _CHUNK.size], "little")
    return str(record[_CHUNK.size : _CHUNK.size + length], "utf-8", "replace")


def walk_records(raw: Bytes) -> dict[int, list[int]]:
    """Return channel -> positions of its complete Message records."""
    positions: dict[int, list[int]] = {}
    for opcode, at, end in each_record(raw):
        if opcode == MESSAGE and end - at >= _PAYLOAD:
            positions.setdefault(_MESSAGE.unpack_from(raw, at)[0], []).append(at)
    return positions


def batch_of(raw: Bytes, positions: Sequence[int] | IntArray, key: int) -> Batch:
    """Return the messages of a channel at `positions`; raises DamagedError."""
    starts = np.asarray(positions, np.int64)
    heads = gather(raw, starts, _PAYLOAD)
    sizes = cells(heads, 1, "<i8") - (_PAYLOAD - HEAD.size)
    right = (cells(heads, 0, "u1") == MESSAGE) & (cells(heads, 9, "<u2") == key)
    right &= (sizes >= 0) & (sizes <= len(raw) - _PAYLOAD - starts)
    damaged_if(not right.all(), "a message index points to wrong records")
    return Batch(raw, starts + _PAYLOAD, sizes, cells(heads, 15, "<i8"))


class McapFile(MessageFile):
    """A container of the messages of an MCAP file."""

    format = "mcap"

    def _read_index(self) -> None:
        self._clear()
        try:
            self._read_summary()
        except DamagedError as error:
            self._clear()
            end = self._scan()
            if not self._records:
                text = f"{error}, and no channel was found; expected an MCAP file, copy it again"
                raise refused(self.path, text) from error
            self.findings.append(self._file.scan_finding(error, end))
        found = {chunk.compression or "none" for chunk in self._chunks}
        if not found & set(KINDS) and found:
            raise refused(self.path, f"chunks are compressed by {min(found)!r}; expected none, lz4 or zstd")
        self.compression = ", ".join(sorted(found & set(KINDS))) or "none"
        self.channels = [self._channel(key) for key in sorted(self._records)]

    def _clear(self) -> None:
        self._schemas: dict[int, Any] = {}
        self._records: dict[int, Any] = {}
        self._chunks: list[Chunk] = []
        self._counts: Counter[int] = Counter()
        #: First and last log time by channel, for messages outside chunks.
        self._times: dict[int, list[int]] = {}

    def _summary(self) -> bytes:
        size = self.size
        wrong = size < len(MAGIC) + _TAIL or self._file.read(0, len(MAGIC)) != MAGIC
        damaged_if(wrong, "the file does not start and end as an MCAP file")
        tail = self._file.read(size - _TAIL, _TAIL)
        damaged_if(tail[-8:] != MAGIC, "the end of the file is missing", "truncated")
        damaged_if(HEAD.unpack_from(tail) != (FOOTER, 20), "the footer is damaged")
        footer = parsed(Footer, tail)
        start, crc = footer.summary_start, footer.summary_crc
        damaged_if(not start, "the file has no index", "unindexed")
        wrong = not len(MAGIC) <= start <= size - _TAIL or size - start > _MAX_SUMMARY
        damaged_if(wrong, "the footer points beyond the file")
        summary = self._file.read(start, size - _TAIL - start)
        wrong = crc and crc32(tail[:25], crc32(summary)) != crc
        damaged_if(wrong, "the index's checksum does not match", "crc")
        return summary

    def _read_summary(self) -> None:
        summary, statistics, read = self._summary(), None, 0
        for opcode, at, end in each_record(summary):
            record, read = summary[at:end], end
            self._define(opcode, record)
            if opcode == CHUNK_INDEX:
                one = parsed(ChunkIndex, record)
                first, last = one.chunk_start_offset, one.chunk_start_offset + one.chunk_length
                self._chunks.append(Chunk(first, last, one.compression, one.message_index_offsets))
            elif opcode == STATISTICS:
                statistics = parsed(Statistics, record)
        damaged_if(read < len(summary), "the index is cut off")
        chunks = self._chunks
        wrong = any(chunk.start < len(MAGIC) or chunk.end > self.size for chunk in chunks)
        damaged_if(wrong, "the index points beyond the file")
        damaged_if(len({chunk.start for chunk in chunks}) < len(chunks), "the index lists chunks twice")
        listed = not statistics or len(chunks) >= max(statistics.chunk_count, bool(statistics.message_count))
        damaged_if(not (listed and self._records), "the index does not list all chunks", "unindexed")
        if statistics:
            self.start_ns, self.end_ns = statistics.message_start_time, statistics.message_end_time
            self._counts.update(statistics.channel_message_counts)
        if not self._counts:
            for key, at in [pair for chunk in chunks for pair in chunk.indexes.items()]:
                self._counts[key] += len(self._entries(at, key))

    def _define(self, opcode: int, record: Bytes) -> None:
        if opcode in {SCHEMA, CHANNEL}:
            kind, known = (Schema, self._schemas) if opcode == SCHEMA else (ChannelRecord, self._records)
            found = parsed(kind, record)
            known.setdefault(found.id, found)

    def _scan(self) -> int:
        at, size, ended = len(MAGIC), self.size, False
        while at + HEAD.size <= size:
            start = self._file.read(at, min(_START, size - at))
            opcode, length = HEAD.unpack_from(start)
            end = at + HEAD.size + length
            # Records after the data belong to the summary, even if its checksum is wrong.
            ended |= opcode in {DATA_END, FOOTER}
            if not opcode or opcode == FOOTER or end > size:
                break
            if opcode in {SCHEMA, CHANNEL} and length <= _MAX_DEFINITION:
                with suppress(DamagedError):
                    self._define(opcode, self._file.read(at, end - at))
            else:
                self._visit(opcode, at, end, start)
            at = end
        for chunk in self._chunks:
            if chunk.compression is not None:
                self._search(chunk)
        return size if ended else at

    def _visit(self, opcode: int, at: int, end: int, start: bytes) -> None:
        last = self._chunks[-1] if self._chunks else None
        if opcode == CHUNK:
            self._chunks.append(Chunk(at, end, _compression(start)))
        elif opcode == MESSAGE and end - at >= _PAYLOAD:
            key, time = _MESSAGE.unpack_from(start)
            self._counts[key] += 1
            self._times.setdefault(key, [time, time])[1] = time
            if last is None or last.compression is not None or end - last.start > _PART:
                last = Chunk(at, end, None)
                self._chunks.append(last)
            last.end = end
        elif opcode == MESSAGE_INDEX and end - at > _INDEX.size and last and last.compression is not None:
            key = _INDEX.unpack_from(start)[2]
            # Indexes after a damaged chunk must not replace those of the previous chunk.
            if last.indexes.setdefault(key, at) == at:
                self._counts[key] += (end - at - _INDEX.size) // 16

    def _search(self, chunk: Chunk) -> None:
        """Read definitions from a chunk without index or with an unknown channel; count its messages."""
        if chunk.indexes and self._records.keys() >= chunk.indexes.keys():
            return
        try:
            raw = self._content(chunk)
        except DamagedError:
            if not chunk.indexes:
                # So that loading the chunk reports the loss.
                self._counts.update(self._records.keys())
            return
        for opcode, at, end in each_record(raw):
            with suppress(DamagedError):
                self._define(opcode, raw[at:end])
        if not chunk.indexes:
            self._counts.update({key: len(found) for key, found in walk_records(raw).items()})

    def _channel(self, key: int) -> Channel:
        record = self._records[key]
        schema = self._schemas.get(record.schema_id, Schema(id=0, name="", encoding="", data=b""))
        chunks = [chunk.indexes[key] for chunk in self._chunks if key in chunk.indexes]
        times = self._times.get(key, [])
        with suppress(DamagedError):
            for at in {*chunks[:1], *chunks[-1:]}:
                times += self._entries(at, key)[:, 0].tolist()
        return Channel(
            key=key,
            topic=record.topic,
            type=schema.name,
            encoding=record.message_encoding,
            definition=schema.data.decode("utf-8", "replace"),
            definition_kind=schema.encoding,
            schema=schema.data,
            count=self._counts[key],
            first_ns=min(times, default=None),
            last_ns=max(times, default=None),
        )

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        for chunk in self._chunks:
            if found := keys & chunk.indexes.keys() if chunk.indexes else keys:
                yield Task(chunk.end - chunk.start, found, partial(self._load, chunk, found))

    def _load(self, chunk: Chunk, keys: frozenset[int]) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each channel in a chunk; walk the chunk if the message index is wrong."""
        raw = self._content(chunk)
        for key in keys:
            loss = None
            if key in chunk.indexes:
                try:
                    times, places = self._entries(chunk.indexes[key], key).T
                    batch = batch_of(raw, places, key)
                    damaged_if((batch.log_ns != times).any(), "a message index points to wrong records")
                    yield key, batch
                    continue
                except DamagedError as error:
                    loss = Loss("index", f"{error}; all records of its chunk were read instead")
            yield key, replace(batch_of(raw, walk_records(raw).get(key, []), key), loss=loss)

    def _content(self, chunk: Chunk) -> memoryview:
        record = memoryview(self._file.read(chunk.start, chunk.end - chunk.start))
        return record if chunk.compression is None else unpack(record)

    def _entries(self, at: int, key: int) -> IntArray:
        """Return times and offsets of a channel's messages, shape (n, 2); raises DamagedError."""
        opcode, length, channel, size = _INDEX.unpack(self._file.read(at, _INDEX.size))
        wrong = opcode != MESSAGE_INDEX or channel != key or size + 6 != length or size % 16
        damaged_if(wrong, "a message index is damaged", "index")
        return np.frombuffer(self._file.read(at + _INDEX.size, size), "<i8").reshape(-1, 2)


open_files = McapFile.open_files
