"""ROS 1 bags of version 2.0, chunks uncompressed or in lz4 or bz2; by their index section, or by a scan."""

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.compression import KINDS
from imucal.readers.containers import ros1_records as records
from imucal.readers.containers.container import Bytes, Channel, MessageFile, Task, scan_finding
from imucal.readers.containers.ros1_chunks import BagChunk, BagChunkTask, unpack
from imucal.readers.containers.ros1_records import (
    MAGIC,
    PAIR,
    U32,
    connection,
    number,
    record,
    time_ns,
    walk,
)
from imucal.readers.files import DamagedError

#: The index section has a few bytes for each chunk and connection; a larger one is damage.
_MAX_INDEX = 1 << 31
#: Bytes in which the head of the bag, and that of a chunk, is looked for.
_HEAD_BLOCK = 1 << 12


class BagFile(MessageFile):
    """A container of the messages of a ROS 1 bag."""

    format = "rosbag1"

    def _read_index(self) -> None:
        self._connections: dict[int, Channel] = {}
        self._chunks: list[BagChunk] = []
        magic = bytes(self._file.read(0, min(len(MAGIC), self.size)))
        if magic != MAGIC:
            _refuse(self.path, magic)
        try:
            self._read_section()
        except (DamagedError, struct.error) as error:
            self._connections.clear()
            self._chunks.clear()
            self._scan(error if isinstance(error, DamagedError) else DamagedError("it is damaged"))
        self.compression = self._compression()
        self.channels = self._channels()
        self.start_ns = min((chunk.first_ns for chunk in self._chunks if chunk.first_ns), default=None)
        self.end_ns = max((chunk.last_ns for chunk in self._chunks if chunk.last_ns), default=None)

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some connections."""
        for chunk in self._chunks:
            task = BagChunkTask(self._file, chunk, keys)
            if task.counts:
                yield task

    def _read_section(self) -> None:
        """Read the index section; raises DamagedError if there is none, or it is damaged."""
        head = record(self._file.read(0, min(_HEAD_BLOCK, self.size)), len(MAGIC)).head
        if head.get(b"encryptor"):
            name = head[b"encryptor"].decode("utf-8", "replace")
            msg = f"{self.path}: the bag is encrypted by {name}; expected a plain bag, decrypt it first"
            raise ReadError(msg)
        start = number(head, b"index_pos", 8)
        if not start:
            msg = "the bag was not closed and has no index"
            raise DamagedError(msg, code="unindexed")
        if not len(MAGIC) <= start <= self.size or self.size - start > _MAX_INDEX:
            msg = "the index lies beyond the end of the file"
            raise DamagedError(msg, code="truncated")
        section = memoryview(self._file.read(start, self.size - start))
        at = 0
        while at < len(section):
            at = self._read_entry(section, at)
        chunks, connections = number(head, b"chunk_count", 4), number(head, b"conn_count", 4)
        if len(self._chunks) < chunks or len(self._connections) < connections:
            msg = "the index is cut"
            raise DamagedError(msg, code="truncated")
        self._set_ends(start)

    def _read_entry(self, section: memoryview, at: int) -> int:
        """Take one record of the index section; return where it ends."""
        entry = record(section, at)
        head, data, opcode = entry.head, section[entry.start : entry.end], entry.opcode
        if entry.end > len(section):
            msg = "the index is cut"
            raise DamagedError(msg, code="truncated")
        if opcode == records.CONNECTION:
            found = connection(head, data)
            self._connections[found.key] = found
        elif opcode == records.CHUNK_INFO:
            if len(data) % PAIR.size:
                msg = "a chunk's entry in the index is damaged"
                raise DamagedError(msg)
            self._chunks.append(
                BagChunk(
                    start=number(head, b"chunk_pos", 8),
                    size=0,
                    counts=dict(PAIR.iter_unpack(data)),
                    first_ns=time_ns(head, b"start_time"),
                    last_ns=time_ns(head, b"end_time"),
                )
            )
        return entry.end

    def _set_ends(self, index: int) -> None:
        """Let each chunk reach to the next one, the last to the index section."""
        starts = sorted({chunk.start for chunk in self._chunks})
        if len(starts) != len(self._chunks):
            msg = "the index lists chunks twice"
            raise DamagedError(msg)
        if starts and (starts[0] <= len(MAGIC) or starts[-1] >= index):
            msg = "the index points beyond the file"
            raise DamagedError(msg)
        ends = dict(pairwise([*starts, index]))
        for chunk in self._chunks:
            chunk.size = ends[chunk.start] - chunk.start

    # Without an index

    def _scan(self, reason: DamagedError) -> None:
        """Visit the records of the file."""
        end = self._visit_all()
        if not self._connections:
            msg = f"{self.path}: {reason}, and no whole chunk was found; expected a ROS 1 bag"
            raise ReadError(msg)
        self.findings.append(scan_finding(reason, end, self.size))

    def _visit_all(self) -> int:
        """Visit records up to the first that is not whole; return where that is."""
        at = len(MAGIC)
        while True:
            try:
                (size,) = U32.unpack(self._file.read(at, U32.size))
                entry = record(self._file.read(at, size + 8), 0)
                opcode, after = entry.opcode, at + entry.end
            except DamagedError:
                return at
            if opcode == records.CHUNK:
                self._add_chunk(at, min(after, self.size) - at, cut=after > self.size)
            if after > self.size:
                return at
            if opcode == records.CONNECTION:
                self._add_connection(entry.head, self._file.read(at + entry.start, entry.end - entry.start))
            at = after

    def _add_connection(self, head: Mapping[bytes, bytes], data: Bytes) -> None:
        """Take a connection record; a damaged one is as good as none."""
        with suppress(DamagedError):
            found = connection(head, data)
            self._connections.setdefault(found.key, found)

    def _add_chunk(self, at: int, size: int, *, cut: bool) -> None:
        """Count the messages of a chunk, and learn the connections defined in it."""
        chunk = BagChunk(start=at, size=size, indexed=False, cut=cut)
        self._chunks.append(chunk)
        try:
            raw, _ = unpack(memoryview(self._file.read(at, size)), cut=cut)
            for opcode, entry in walk(raw):
                if opcode == records.CONNECTION:
                    self._add_connection(entry.head, raw[entry.start : entry.end])
                elif opcode == records.MESSAGE:
                    key, time = entry.key, time_ns(entry.head, b"time")
                    chunk.counts[key] = chunk.counts.get(key, 0) + 1
                    chunk.first_ns = min(chunk.first_ns or time, time)
                    chunk.last_ns = max(chunk.last_ns, time)
        except DamagedError as error:
            if not cut:
                text = f"The log is damaged in one place: {error}."
                self.findings.append(Finding(level="warning", code=error.code, text=text))

    def _channels(self) -> list[Channel]:
        counts: Counter[int] = Counter()
        spans: dict[int, tuple[int, int]] = {}
        for chunk in self._chunks:
            counts.update(chunk.counts)
            for key in chunk.counts:
                first, last = spans.get(key, (chunk.first_ns, chunk.last_ns))
                spans[key] = (min(first, chunk.first_ns), max(last, chunk.last_ns))
        none = (None, None)
        return [
            replace(
                found, count=counts[key], first_ns=spans.get(key, none)[0], last_ns=spans.get(key, none)[1]
            )
            for key, found in sorted(self._connections.items())
        ]

    def _compression(self) -> str:
        """Return how the first chunk is compressed; all chunks of a bag are written alike."""
        if not self._chunks:
            return "none"
        try:
            at = self._chunks[0].start
            kind = record(self._file.read(at, min(_HEAD_BLOCK, self.size - at)), 0).compression
        except DamagedError:
            return "unknown"
        if kind not in KINDS:
            msg = f"{self.path}: chunks are compressed by {kind!r}; expected none, lz4 or bz2"
            raise ReadError(msg)
        return kind


def _refuse(path: Path, magic: bytes) -> None:
    if magic.startswith(b"#ROSBAG V"):
        version = magic[9:].split(b"\n")[0].decode("ascii", "replace")
        msg = f"{path}: a bag of version {version}; expected 2.0, convert it with `rosbag fix`"
        raise ReadError(msg)
    msg = f"{path}: not a ROS 1 bag (first bytes {magic[:13]!r}); expected {MAGIC!r}"
    raise ReadError(msg)


open_files = BagFile.open_files
