"""Rewrite an MCAP file: the messages of some channels change, all other records stay byte for byte.

Chunks without such messages are copied as they are. Positions in the index are moved. A metadata record tells
that the file was corrected. Source: MCAP specification 0, https://mcap.dev/spec.
"""

from bisect import bisect_right
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.records import (
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)

from imucal.correction.job import MARK, AlreadyCorrectedError, Job
from imucal.readers.compression import crc32
from imucal.readers.containers.mcap import (
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEAD,
    MAGIC,
    MESSAGE,
    STATISTICS,
    batch_of,
    parsed,
    unpack,
    walk_records,
)
from imucal.readers.files import damaged_if

#: Opcodes of records that are only needed here.
ATTACHMENT_INDEX = 0x0A
METADATA = 0x0C
METADATA_INDEX = 0x0D
SUMMARY_OFFSET = 0x0E

#: Bytes of the checksum at the end of a footer.
_CRC_SIZE = 4


def rewrite_mcap(source: BinaryIO, target: BinaryIO, job: Job) -> None:
    """Copy a file with changed messages of some channels.

    Raises DamagedError if the file is incomplete or damaged, and AlreadyCorrectedError.
    """
    _Rewriter(source, target, job).run()


class _Rewriter:
    """Copies the records of a file in their order."""

    def __init__(self, source: BinaryIO, target: BinaryIO, job: Job) -> None:
        self._job = job
        self._source = source
        self._target = target
        self._crc = 0
        self._read = 0
        self._written = 0
        #: Positions in the source from which on records have moved, and by how many bytes.
        self._places = [0]
        self._shifts = [0]
        #: Start of a chunk in the source -> its new lengths: of the record, and of the compressed data.
        self._chunks: dict[int, tuple[int, int]] = {}
        self._marked_at = 0
        self._marked_size = 0

    def run(self) -> None:
        magic = self._source.read(len(MAGIC))
        damaged_if(magic != MAGIC, "the file does not start as an MCAP file")
        self._read = len(magic)
        self._write(magic)
        while True:
            start = self._read
            opcode, record = self._next()
            if opcode == DATA_END:
                self._write_mark()
                end = parsed(DataEnd, record)
                self._write_record(DataEnd(data_section_crc=self._crc if end.data_section_crc else 0))
                break
            damaged_if(opcode == FOOTER, "the end of the data is missing")
            self._write(self._changed(opcode, record, start))
            self._job.progress(self._read)
        self._copy_summary()
        self._job.progress(self._read)

    def _next(self) -> tuple[int, bytes]:
        """Return opcode and bytes of the next record."""
        head = self._source.read(HEAD.size)
        damaged_if(len(head) < HEAD.size, "the file is cut off", "truncated")
        opcode, length = HEAD.unpack(head)
        body = self._source.read(length)
        damaged_if(len(body) < length, "the file is cut off", "truncated")
        self._read += len(head) + length
        return opcode, head + body

    def _write(self, data: bytes) -> None:
        self._target.write(data)
        self._crc = crc32(data, self._crc)
        self._written += len(data)

    def _write_record(self, record: McapRecord) -> int:
        """Write a record; return its length."""
        data = _bytes_of(record)
        self._write(data)
        return len(data)

    def _changed(self, opcode: int, record: bytes, start: int) -> bytes:
        if opcode == MESSAGE:
            return self._changed_message(record)
        if opcode == METADATA and parsed(Metadata, record).name == MARK:
            raise AlreadyCorrectedError
        if opcode != CHUNK:
            return record
        data = self._changed_chunk(record)
        if data is None:
            return record
        chunk = _bytes_of(data)
        self._chunks[start] = len(chunk), len(data.data)
        if len(chunk) != len(record):
            self._places.append(start + 1)
            self._shifts.append(self._shifts[-1] + len(chunk) - len(record))
        return chunk

    def _changed_message(self, record: bytes) -> bytes:
        """Return a message outside chunks, corrected if its channel is."""
        key = int.from_bytes(record[HEAD.size : HEAD.size + 2], "little")
        if key not in self._job.keys:
            return record
        buffer = bytearray(record)
        self._job.patch(key, batch_of(buffer, [0], key))
        return bytes(buffer)

    def _changed_chunk(self, record: bytes) -> Chunk | None:
        """Return a chunk with changed messages; None if it contains none of the channels."""
        raw = bytearray(unpack(memoryview(record)))
        positions = {key: at for key, at in walk_records(raw).items() if key in self._job.keys}
        if not positions:
            return None
        for key, at in positions.items():
            self._job.patch(key, batch_of(raw, at, key))
        old = parsed(Chunk, record)
        return Chunk(
            compression=old.compression,
            data=_compressed(old.compression, bytes(raw)),
            message_start_time=old.message_start_time,
            message_end_time=old.message_end_time,
            uncompressed_crc=crc32(raw) if old.uncompressed_crc else 0,
            uncompressed_size=old.uncompressed_size,
        )

    def _write_mark(self) -> None:
        """Write the metadata record before the end of the data."""
        self._marked_at = self._written
        self._marked_size = self._write_record(Metadata(name=MARK, metadata={"corrected": self._job.mark}))

    def _moved(self, position: int) -> int:
        """Return the new position of a record of the data section."""
        return position + self._shifts[bisect_right(self._places, position) - 1]

    def _copy_summary(self) -> None:
        """Copy the summary with moved positions, and write the footer."""
        groups: dict[int, bytearray] = {}
        while True:
            opcode, record = self._next()
            if opcode == FOOTER:
                break
            groups.setdefault(opcode, bytearray()).extend(self._moved_index(opcode, record))
        footer = parsed(Footer, record)
        damaged_if(self._source.read(len(MAGIC)) != MAGIC, "the end of the file is missing", "truncated")
        self._read += len(MAGIC)
        has_offsets = groups.pop(SUMMARY_OFFSET, None) is not None
        start = self._written
        summary = bytearray()
        offsets = bytearray()
        if footer.summary_start:
            own = MetadataIndex(offset=self._marked_at, length=self._marked_size, name=MARK)
            groups.setdefault(METADATA_INDEX, bytearray()).extend(_bytes_of(own))
            for opcode, records in groups.items():
                place = SummaryOffset(
                    group_opcode=opcode, group_start=start + len(summary), group_length=len(records)
                )
                offsets += _bytes_of(place) if has_offsets else b""
                summary += records
        end = Footer(
            summary_start=start if summary else 0,
            summary_offset_start=start + len(summary) if offsets else 0,
            summary_crc=0,
        )
        if footer.summary_crc:
            # The checksum covers the footer up to itself.
            end.summary_crc = crc32(_bytes_of(end)[:-_CRC_SIZE], crc32(bytes(summary + offsets)))
        self._write(bytes(summary + offsets))
        self._write_record(end)
        self._write(MAGIC)

    def _moved_index(self, opcode: int, record: bytes) -> bytes:
        """Return a record of the summary for the new positions."""
        if opcode == CHUNK_INDEX:
            chunk = parsed(ChunkIndex, record)
            length, size = self._chunks.get(
                chunk.chunk_start_offset, (chunk.chunk_length, chunk.compressed_size)
            )
            chunk.message_index_offsets = {
                key: self._moved(at) for key, at in chunk.message_index_offsets.items()
            }
            chunk.chunk_start_offset = self._moved(chunk.chunk_start_offset)
            chunk.chunk_length = length
            chunk.compressed_size = size
            return _bytes_of(chunk)
        if opcode in {ATTACHMENT_INDEX, METADATA_INDEX}:
            kind = AttachmentIndex if opcode == ATTACHMENT_INDEX else MetadataIndex
            place = parsed(kind, record)
            place.offset = self._moved(place.offset)
            return _bytes_of(place)
        if opcode == STATISTICS:
            statistics = parsed(Statistics, record)
            statistics.metadata_count += 1
            return _bytes_of(statistics)
        return record


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call] # the package has no types here
    return data


def _compressed(kind: str, data: bytes) -> bytes:
    """Return the data of a chunk, compressed as it was; raises DamagedError for an unknown compression."""
    if kind == "zstd":
        import zstandard

        return zstandard.ZstdCompressor().compress(data)
    if kind == "lz4":
        import lz4.frame

        compressed: bytes = lz4.frame.compress(data)
        return compressed
    damaged_if(bool(kind), f"the compression {kind} is unknown", "compression")
    return data
