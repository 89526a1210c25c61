"""MCAP files with chunks uncompressed or in lz4 or zstd.

The `mcap` package builds an object per message, so messages are located here. Without a valid index, records
are scanned up to the first incomplete one or to zeros left by a crash. Source: MCAP specification 0,
https://mcap.dev/spec.
"""

import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from typing import Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.records import Channel as ChannelRecord
from mcap.records import ChunkIndex, Footer, Schema, Statistics

from imucal.arrays import IntArray
from imucal.findings import Finding
from imucal.readers.compression import check_crc, crc32, decompress
from imucal.readers.containers.chunked import Chunk, ChunkedFile, scan_text
from imucal.readers.containers.container import Batch, Bytes, Channel, cells, gather
from imucal.readers.files import DamagedError, damaged_if, refused

MAGIC = b"\x89MCAP0\r\n"
#: Opcodes of records, in the order of the specification.
FOOTER = 0x02
SCHEMA = 0x03
CHANNEL = 0x04
MESSAGE = 0x05
CHUNK = 0x06
MESSAGE_INDEX = 0x07
CHUNK_INDEX = 0x08
STATISTICS = 0x0B
DATA_END = 0x0F

#: Opcode and length of a record.
HEAD = struct.Struct("<BQ")
#: Channel of a Message record.
_MESSAGE_CHANNEL = struct.Struct("<9xH")
#: Channel and log time of a Message record.
_MESSAGE_HEAD = struct.Struct("<9xH4xq")
#: Bytes of a Message record before its payload.
_PAYLOAD = 31
#: MessageIndex record: opcode, length, channel, bytes of entries.
_INDEX = struct.Struct("<BQHI")
#: Bytes of a message in a MessageIndex record: log time and position.
_ENTRY = 16
#: Chunk record: content size, CRC, length of the compression's name, which follows.
_CHUNK = struct.Struct("<9x16xQII")
#: Size of a chunk's compressed data.
_U64 = struct.Struct("<Q")
#: Footer record and magic at the end of a file.
_TAIL = 9 + 20 + 8
#: A larger summary is damage (ids have 16 bits), in bytes.
_MAX_SUMMARY = 1 << 31
#: Messages outside chunks are loaded in parts of this size, in bytes.
_PART = 1 << 22
#: A larger message outside chunks, such as a picture, is a part of its own, in bytes; it is not loaded with
#: those of an IMU, which have about 300.
_LARGE = 1 << 14
#: A longer definition is damage, in bytes.
_MAX_DEFINITION = 1 << 24
#: Bytes read of each record in a scan; the names of compressions fit.
_START = 128


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
    start = 0
    size = len(data)
    head = HEAD.unpack_from
    while start + HEAD.size <= size:
        opcode, length = head(data, start)
        end = start + HEAD.size + length
        if end > size or not opcode:
            return
        yield opcode, start, end
        start = end


def unpack(record: memoryview) -> memoryview:
    """Return the content of a Chunk record; raises DamagedError."""
    try:
        size, crc, length = _CHUNK.unpack_from(record)
        name_end = _CHUNK.size + length
        (stored,) = _U64.unpack_from(record, name_end)
    except struct.error as error:
        raise DamagedError("a chunk's head is damaged") from error
    data = record[name_end + _U64.size :]
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
    for opcode, start, end in each_record(raw):
        if opcode == MESSAGE and end - start >= _PAYLOAD:
            (key,) = _MESSAGE_CHANNEL.unpack_from(raw, start)
            positions.setdefault(key, []).append(start)
    return positions


def batch_of(raw: Bytes, positions: Sequence[int] | IntArray, key: int) -> Batch:
    """Return the messages of a channel at `positions`; raises DamagedError."""
    starts = np.asarray(positions, np.int64)
    heads = gather(raw, starts, _PAYLOAD)
    sizes = cells(heads, 1, "<i8") - (_PAYLOAD - HEAD.size)
    is_message = (cells(heads, 0, "u1") == MESSAGE) & (cells(heads, 9, "<u2") == key)
    is_complete = (sizes >= 0) & (sizes <= len(raw) - _PAYLOAD - starts)
    damaged_if(not (is_message & is_complete).all(), "a message index points to wrong records")
    return Batch(raw, starts + _PAYLOAD, sizes, cells(heads, 15, "<i8"))


class McapFile(ChunkedFile):
    """A container of the messages of an MCAP file."""

    format = "mcap"

    def _read_index(self) -> None:
        self._schemas: dict[int, Any] = {}
        #: End of the last large message outside chunks.
        self._large_end = 0
        try:
            self._read_summary()
        except DamagedError as error:
            self._schemas.clear()
            self._defined.clear()
            end = self._scan()
            self._search_chunks()
            if not self._defined:
                text = f"{error}, and no channel was found; expected an MCAP file, copy it again"
                raise refused(self.path, text) from error
            cut = scan_text(self._file, end)
            text = f"The index can't be used ({error}); all records were scanned instead.{cut}"
            self.findings.append(Finding("warning", "truncated" if cut else error.code, text))
        self.compression = self._compressions("none, lz4 or zstd")
        spans = self._spans()
        self.channels = [self._channel(key, spans.get(key, (None, None))) for key in sorted(self._defined)]

    def _summary(self) -> bytes:
        size = self.size
        is_mcap = size >= len(MAGIC) + _TAIL and self._file.read(0, len(MAGIC)) == MAGIC
        damaged_if(not is_mcap, "the file does not start and end as an MCAP file")
        tail = self._file.read(size - _TAIL, _TAIL)
        damaged_if(tail[-8:] != MAGIC, "the end of the file is missing", "truncated")
        damaged_if(HEAD.unpack_from(tail) != (FOOTER, 20), "the footer is damaged")
        footer = parsed(Footer, tail)
        start = footer.summary_start
        damaged_if(not start, "the file has no index", "unindexed")
        is_inside = len(MAGIC) <= start <= size - _TAIL and size - start <= _MAX_SUMMARY
        damaged_if(not is_inside, "the footer points beyond the file")
        summary = self._file.read(start, size - _TAIL - start)
        crc = footer.summary_crc
        is_wrong = crc and crc32(tail[:25], crc32(summary)) != crc
        damaged_if(is_wrong, "the index's checksum does not match", "crc")
        return summary

    def _read_summary(self) -> None:
        summary = self._summary()
        chunks: list[Chunk] = []
        indexes: list[tuple[int, int]] = []
        statistics = None
        read = 0
        for opcode, start, end in each_record(summary):
            record = summary[start:end]
            read = end
            self._define(opcode, record)
            if opcode == CHUNK_INDEX:
                index = parsed(ChunkIndex, record)
                first = index.chunk_start_offset
                last = first + index.chunk_length
                chunks.append(Chunk(first, last, index.compression, index.message_index_offsets))
                indexes += index.message_index_offsets.items()
            elif opcode == STATISTICS:
                statistics = parsed(Statistics, record)
        damaged_if(read < len(summary), "the index is cut off")
        is_beyond = any(chunk.start < len(MAGIC) or chunk.end > self.size for chunk in chunks)
        damaged_if(is_beyond, "the index points beyond the file")
        damaged_if(len({chunk.start for chunk in chunks}) < len(chunks), "the index lists chunks twice")
        # Messages outside chunks are not in the index.
        fewest = max(statistics.chunk_count, bool(statistics.message_count)) if statistics else 0
        is_complete = self._defined and len(chunks) >= fewest
        damaged_if(not is_complete, "the index does not list all chunks", "unindexed")
        self._counts.update(statistics.channel_message_counts if statistics else {})
        if not self._counts:
            for key, position in indexes:
                self._counts[key] += self._entries(position, key)[0].size
        for chunk in chunks:
            if not chunk.indexes:
                chunk.indexes = dict.fromkeys(self._defined)
                self._is_counted = bool(statistics)
        self._chunks = chunks
        if statistics:
            self.start_ns = statistics.message_start_time
            self.end_ns = statistics.message_end_time

    def _define(self, opcode: int, record: Bytes) -> None:
        """Add a schema or channel; the first one with a number is used. Raises DamagedError."""
        if opcode == SCHEMA:
            schema = parsed(Schema, record)
            self._schemas.setdefault(schema.id, schema)
        elif opcode == CHANNEL:
            channel = parsed(ChannelRecord, record)
            self._defined.setdefault(channel.id, channel)

    def _define_all(self, raw: memoryview) -> None:
        for opcode, start, end in each_record(raw):
            with suppress(DamagedError):
                self._define(opcode, raw[start:end])

    def _scan(self) -> int:
        """Find the chunks, and the messages outside chunks; return the end of the last complete record."""
        position = len(MAGIC)
        size = self.size
        is_data = True
        while position + HEAD.size <= size:
            start = self._file.read(position, min(_START, size - position))
            opcode, length = HEAD.unpack_from(start)
            end = position + HEAD.size + length
            # Records after the data belong to the summary, even if its checksum is wrong.
            if opcode in {DATA_END, FOOTER}:
                is_data = False
            if not opcode or opcode == FOOTER or end > size:
                break
            if opcode in {SCHEMA, CHANNEL} and length <= _MAX_DEFINITION:
                with suppress(DamagedError):
                    self._define(opcode, self._file.read(position, end - position))
            else:
                self._add_record(opcode, position, end, start)
            position = end
        return position if is_data else size

    def _add_record(self, opcode: int, position: int, end: int, start: bytes) -> None:
        last = self._chunks[-1] if self._chunks else None
        if opcode == CHUNK:
            self._chunks.append(Chunk(position, end, _compression(start)))
        elif opcode == MESSAGE and end - position >= _PAYLOAD:
            self._add_message(position, end, start)
        elif opcode == MESSAGE_INDEX and end - position > _INDEX.size:
            if last is None or last.compression is None:
                return
            key = _INDEX.unpack_from(start)[2]
            # Indexes after a damaged chunk must not replace those of the previous chunk.
            if last.indexes.setdefault(key, position) == position:
                self._counts[key] += (end - position - _INDEX.size) // _ENTRY

    def _add_message(self, position: int, end: int, start: bytes) -> None:
        """Add a message outside chunks to the last part, or to a new one, and count it."""
        is_apart = end - position > _LARGE or self._large_end == position
        if end - position > _LARGE:
            self._large_end = end
        last = self._chunks[-1] if self._chunks else None
        if last is None or last.compression is not None or end - last.start > _PART or is_apart:
            last = Chunk(position, end, None)
            self._chunks.append(last)
        last.end = end
        key, log_ns = _MESSAGE_HEAD.unpack_from(start)
        last.indexes[key] = None
        self._counts[key] += 1
        first, latest = self._times.get(key, (log_ns, log_ns))
        self._times[key] = [min(first, log_ns), max(latest, log_ns)]

    def _channel(self, key: int, span: tuple[int | None, int | None]) -> Channel:
        record = self._defined[key]
        schema = self._schemas.get(record.schema_id, Schema(id=0, name="", encoding="", data=b""))
        return Channel(
            key=key,
            topic=record.topic,
            type=schema.name,
            encoding=record.message_encoding,
            definition=schema.data.decode("utf-8", "replace"),
            definition_kind=schema.encoding,
            schema=schema.data,
            count=self._count(key),
            first_ns=span[0],
            last_ns=span[1],
        )

    def _content(self, chunk: Chunk) -> memoryview:
        record = memoryview(self._file.read(chunk.start, chunk.end - chunk.start))
        return record if chunk.compression is None else unpack(record)

    def _entries(self, position: int, key: int) -> tuple[IntArray, IntArray]:
        opcode, length, channel, size = _INDEX.unpack(self._file.read(position, _INDEX.size))
        is_wrong = opcode != MESSAGE_INDEX or channel != key or size + 6 != length or size % _ENTRY
        damaged_if(is_wrong, "a message index is damaged", "index")
        entries = np.frombuffer(self._file.read(position + _INDEX.size, size), "<i8").reshape(-1, 2)
        return entries[:, 0], entries[:, 1]

    def _listed(self, raw: memoryview, key: int, log_ns: IntArray, positions: IntArray) -> Batch:
        batch = batch_of(raw, positions, key)
        damaged_if((batch.log_ns != log_ns).any(), "a message index points to wrong records")
        return batch

    def _walk(self, raw: memoryview) -> dict[int, Batch]:
        return {key: batch_of(raw, positions, key) for key, positions in walk_records(raw).items()}


open_files = McapFile.open_files
