"""MCAP: ROS 2, ROS 1 and JSON messages, chunks uncompressed or in lz4 or zstd.

An intact file is read by the index at its end; a cut, unindexed or damaged one by scanning its records.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import cast

from imucal.errors import ReadError
from imucal.readers.compression import KINDS, crc32
from imucal.readers.containers import mcap_records as records
from imucal.readers.containers.container import Channel, Container, Task
from imucal.readers.containers.mcap_chunks import ChunkTask, index_count
from imucal.readers.containers.mcap_records import HEAD, MAGIC, ChunkIndex, Schema
from imucal.readers.containers.mcap_scan import Bookkeeping, scan
from imucal.readers.files import DamagedError, LogFile
from imucal.readers.read_options import Progress

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
