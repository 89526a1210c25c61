"""ROS 1 bags of version 2.0, chunks uncompressed or in lz4 or bz2.

Records are a header of name=value fields, then data. Chunks are found by the index section or by a scan;
messages by the index records behind their chunk, or by a walk through it.
Source: https://wiki.ros.org/Bags/Format/2.0. `rosbags` reads intact bags and is the witness in the tests; it
refuses unindexed and cut ones, and builds an object for each message when it opens a bag.
"""

import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray
from imucal.findings import Finding
from imucal.readers.compression import KINDS, decompress, decompress_prefix
from imucal.readers.containers.container import (
    Batch,
    Bytes,
    Channel,
    Loss,
    MessageFile,
    Task,
    cells,
    gather,
)
from imucal.readers.files import DamagedError, LogFile, damaged_if, refused

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
U32 = struct.Struct("<I")
PAIR = struct.Struct("<II")
#: Longest header of a record; a connection's is its topic's length.
_MAX_HEADER = 1 << 20
#: The index section has a few bytes for each chunk and connection; a larger one is damage.
_MAX_INDEX = 1 << 31
#: Bytes in which the head of the bag, and that of a chunk, is looked for.
_HEAD_BLOCK = 1 << 12


class Record(NamedTuple):
    """A record: the fields of its header, and where its data start and end."""

    head: Mapping[bytes, bytes]
    start: int
    end: int

    @property
    def opcode(self) -> int:
        """What it is; raises DamagedError where the header doesn't say."""
        return number(self.head, b"op", 1)

    @property
    def key(self) -> int:
        """Its connection; raises DamagedError where the header doesn't say."""
        return number(self.head, b"conn", 4)

    @property
    def compression(self) -> str:
        """How a chunk is compressed."""
        return self.head.get(b"compression", b"none").decode("ascii", "replace")


def record(buffer: Bytes, at: int) -> Record:
    """Return the record at `at`, which may reach beyond the buffer; raises DamagedError without a header."""
    try:
        end = at + 4 + U32.unpack_from(buffer, at)[0]
        if end - at - 4 > _MAX_HEADER or end > len(buffer):
            raise _broken()
        head = _head(bytes(buffer[at + 4 : end]))
        return Record(head, end + 4, end + 4 + U32.unpack_from(buffer, end)[0])
    except struct.error as error:
        raise _broken() from error


def walk(raw: Bytes) -> Iterator[tuple[int, Record]]:
    """Yield opcode and record of each whole record, up to the first that is not."""
    at = 0
    while True:
        try:
            entry = record(raw, at)
            opcode = entry.opcode
        except DamagedError:
            return
        if entry.end > len(raw):
            return
        yield opcode, entry
        at = entry.end


def fields(data: bytes) -> dict[bytes, bytes]:
    """Return name -> value of the fields that stand one behind the other."""
    found, place = {}, 0
    while place + 4 <= len(data):
        start = place + 4
        place = start + U32.unpack_from(data, place)[0]
        name, equals, value = data[start:place].partition(b"=")
        if place > len(data) or not equals:
            raise _broken()
        found[name] = value
    return found


#: The fields of a header; those of index records are mostly what they were in the chunk before.
_head = lru_cache(maxsize=128)(fields)


def number(found: Mapping[bytes, bytes], name: bytes, size: int) -> int:
    """Return a field that holds a little-endian number of `size` bytes."""
    value = found.get(name)
    if value is None or len(value) != size:
        raise _broken()
    return int.from_bytes(value, "little")


def time_ns(found: Mapping[bytes, bytes], name: bytes) -> int:
    """Return a field that holds seconds and nanoseconds, in ns; 0 where it is not eight bytes."""
    value = found.get(name, b"")
    if len(value) != PAIR.size:
        return 0
    seconds, rest = PAIR.unpack(value)
    return int(seconds) * 1_000_000_000 + int(rest)


def connection(found: Mapping[bytes, bytes], data: Bytes) -> Channel:
    """Parse a connection record: its header, and the connection's own header as data."""
    inner = fields(bytes(data))
    definition = inner.get(b"message_definition", b"").decode("utf-8", "replace")
    return Channel(
        key=number(found, b"conn", 4),
        topic=found.get(b"topic", b"").decode("utf-8", "replace"),
        type=inner.get(b"type", b"").decode("utf-8", "replace"),
        encoding="ros1",
        definition=definition,
        definition_kind="ros1msg" if definition else "",
    )


def _broken() -> DamagedError:
    return DamagedError("a record header is damaged")


@dataclass(slots=True)
class BagChunk:
    """Where a chunk and its index records lie."""

    #: From the chunk record to the end of its index records, in bytes.
    start: int
    size: int
    #: Connection -> messages, as the file says.
    counts: dict[int, int] = field(default_factory=dict)
    #: Whether index records follow.
    indexed: bool = True
    #: Whether the end of the file cuts the chunk.
    cut: bool = False
    first_ns: int = 0
    last_ns: int = 0


def load_chunk(file: LogFile, chunk: BagChunk, keys: frozenset[int]) -> Iterator[tuple[int, Batch]]:
    """Yield the messages of some connections in a chunk; see `Task`."""
    region = memoryview(file.read(chunk.start, chunk.size))
    raw, end = unpack(region, cut=chunk.cut)
    indexes: dict[int, memoryview] = {}
    # The index records follow the chunk.
    with suppress(DamagedError):
        for opcode, entry in walk(region[end:]) if chunk.indexed else ():
            if opcode != INDEX or entry.end - entry.start != 12 * number(entry.head, b"count", 4):
                break
            indexes[entry.key] = region[end + entry.start : end + entry.end]
            if keys <= indexes.keys():
                break
    for key in keys:
        if key in indexes:
            yield key, _indexed(raw, key, indexes[key])
        else:
            loss = Loss("index", "an index record is missing; all records of its chunk were read instead")
            yield key, _walked(raw, key, loss if chunk.indexed else None)


def unpack(region: memoryview, *, cut: bool = False) -> tuple[memoryview, int]:
    """Return what the chunk at the start of a region holds, and where it ends; raises DamagedError."""
    entry = record(region, 0)
    data = region[entry.start : entry.end]
    damaged_if(entry.head.get(b"op") != bytes([CHUNK]), "a chunk's head is damaged")
    size = number(entry.head, b"size", 4)
    if cut:
        return memoryview(decompress_prefix(entry.compression, data, size)), entry.end
    damaged_if(entry.end > len(region), "a chunk is cut off", "truncated")
    return decompress(entry.compression, data, size), entry.end


def _indexed(raw: memoryview, key: int, entries: memoryview) -> Batch:
    """Return the messages that an index record lists; walk the chunk if an entry is wrong.

    All headers are compared with the last one, which repeats except for the time. Records that differ are
    parsed one by one: the first may have the connection's own record in front.
    """
    seconds, rest, starts = np.frombuffer(entries, "<u4").reshape(-1, 3).T.astype(np.int64, order="C")
    log_ns = seconds * 1_000_000_000 + rest
    if not starts.size:
        return Batch(raw, starts, starts, log_ns)
    try:
        last = int(starts[-1])
        head = bytes(raw[last : _message(raw, key, last)[0]])
        payloads, sizes = starts + len(head), np.zeros_like(starts)
        inside = np.flatnonzero(starts <= len(raw) - len(head))
        heads = gather(raw, starts[inside], len(head))
        sizes[inside] = cells(heads, len(head) - 4, "<u4")
        alike = inside[_alike(heads, head)]
        alike = alike[payloads[alike] + sizes[alike] <= len(raw)]
        for row in np.delete(np.arange(starts.size), alike).tolist() if alike.size < starts.size else ():
            payloads[row], sizes[row] = _message(raw, key, int(starts[row]))
    except DamagedError:
        loss = Loss("index", "an index points to wrong records; all records of its chunk were read instead")
        return _walked(raw, key, loss)
    return Batch(raw, payloads, sizes, log_ns)


def _alike(heads: NDArray[np.void], head: bytes) -> BoolArray:
    """Return which gathered headers are `head`, except for the value of the time and the size at the end."""
    end = len(head) - 4
    time = head.find(b"time=") + 5 if b"time=" in head else end
    same = np.ones(heads.size, np.bool_)
    for start, stop in ((0, time), (time + 8, end)):
        if start < stop:
            code = f"V{stop - start}"
            same &= cells(heads, start, code) == np.frombuffer(head, code, 1, start)
    return same


def _message(raw: memoryview, key: int, at: int) -> tuple[int, int]:
    """Return payload and size of the message at `at`, or behind the connection records there."""
    while (entry := record(raw, at)).end <= len(raw):
        if entry.opcode == MESSAGE and entry.key == key:
            return entry.start, entry.end - entry.start
        if entry.opcode != CONNECTION:
            break
        at = entry.end
    raise DamagedError("an index points to a wrong record", "index")


def _walked(raw: memoryview, key: int, loss: Loss | None) -> Batch:
    """Return the messages of a connection in a chunk, found by walking it."""
    found = [
        (entry.start, entry.end - entry.start, time_ns(entry.head, b"time"))
        for opcode, entry in walk(raw)
        if opcode == MESSAGE and int.from_bytes(entry.head.get(b"conn", b""), "little") == key
    ]
    starts, sizes, times = np.array(found, np.int64).reshape(-1, 3).T.copy()
    return Batch(raw, starts, sizes, times, loss)


class BagFile(MessageFile):
    """A container of the messages of a ROS 1 bag."""

    format = "rosbag1"

    def _read_index(self) -> None:
        self._connections: dict[int, Channel] = {}
        self._chunks: list[BagChunk] = []
        magic = bytes(self._file.read(0, min(len(MAGIC), self.size)))
        if magic != MAGIC:
            if magic.startswith(b"#ROSBAG V"):
                version = magic[9:].split(b"\n")[0].decode("ascii", "replace")
                why = f"a bag of version {version}; expected 2.0, convert it with `rosbag fix`"
                raise refused(self.path, why)
            raise refused(self.path, f"not a ROS 1 bag (first bytes {magic[:13]!r}); expected {MAGIC!r}")
        try:
            self._read_section()
        except (DamagedError, struct.error) as error:
            self._connections.clear()
            self._chunks.clear()
            reason = error if isinstance(error, DamagedError) else DamagedError("it is damaged")
            end = self._visit_all()
            if not self._connections:
                why = f"{reason}, and no whole chunk was found; expected a ROS 1 bag"
                raise refused(self.path, why) from None
            self.findings.append(self._file.scan_finding(reason, end))
        self.compression = self._compression()
        self.channels = self._channels()
        self.start_ns = min((chunk.first_ns for chunk in self._chunks if chunk.first_ns), default=None)
        self.end_ns = max((chunk.last_ns for chunk in self._chunks if chunk.last_ns), default=None)

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some connections."""
        for chunk in self._chunks:
            if found := frozenset(key for key in keys if chunk.counts.get(key)):
                yield Task(chunk.size, found, partial(load_chunk, self._file, chunk, found))

    def _read_section(self) -> None:
        """Read the index section; raises DamagedError if there is none, or it is damaged."""
        bag = record(self._file.read(0, min(_HEAD_BLOCK, self.size)), len(MAGIC)).head
        if name := bag.get(b"encryptor", b"").decode("utf-8", "replace"):
            raise refused(
                self.path, f"the bag is encrypted by {name}; expected a plain bag, decrypt it first"
            )
        start = number(bag, b"index_pos", 8)
        damaged_if(not start, "the bag was not closed and has no index", "unindexed")
        damaged_if(
            not len(MAGIC) <= start <= self.size or self.size - start > _MAX_INDEX,
            "the index is beyond the end of the file",
            "truncated",
        )
        section = memoryview(self._file.read(start, self.size - start))
        at = 0
        while at < len(section):
            entry = record(section, at)
            head, data, at, opcode = entry.head, section[entry.start : entry.end], entry.end, entry.opcode
            damaged_if(at > len(section), "the index is cut off", "truncated")
            if opcode == CONNECTION:
                self._connections[entry.key] = connection(head, data)
            elif opcode == CHUNK_INFO:
                damaged_if(len(data) % PAIR.size, "a chunk's entry in the index is damaged")
                first, last = time_ns(head, b"start_time"), time_ns(head, b"end_time")
                counts = dict(PAIR.iter_unpack(data))
                self._chunks.append(
                    BagChunk(number(head, b"chunk_pos", 8), 0, counts, first_ns=first, last_ns=last)
                )
        cut = len(self._chunks) < number(bag, b"chunk_count", 4)
        cut |= len(self._connections) < number(bag, b"conn_count", 4)
        damaged_if(cut, "the index is cut off", "truncated")
        # Each chunk reaches to the next one, the last to the index section.
        starts = sorted({chunk.start for chunk in self._chunks})
        damaged_if(len(starts) != len(self._chunks), "the index lists chunks twice")
        damaged_if(
            starts and (starts[0] <= len(MAGIC) or starts[-1] >= start), "the index points beyond the file"
        )
        ends = dict(pairwise([*starts, start]))
        for chunk in self._chunks:
            chunk.size = ends[chunk.start] - chunk.start

    def _visit_all(self) -> int:
        """Visit records without an index, up to the first that is not whole; return where that is."""
        at = len(MAGIC)
        while True:
            try:
                (size,) = U32.unpack(self._file.read(at, U32.size))
                entry = record(self._file.read(at, size + 8), 0)
                opcode, after = entry.opcode, at + entry.end
            except DamagedError:
                return at
            if opcode == CHUNK:
                self._add_chunk(at, min(after, self.size) - at, cut=after > self.size)
            if after > self.size:
                return at
            if opcode == CONNECTION:
                self._add_connection(entry.head, self._file.read(at + entry.start, entry.end - entry.start))
            at = after

    def _add_connection(self, head: Mapping[bytes, bytes], data: Bytes) -> None:
        """Take a connection record; a damaged one is as good as none."""
        with suppress(DamagedError):
            found = connection(head, data)
            self._connections.setdefault(found.key, found)

    def _add_chunk(self, at: int, size: int, *, cut: bool) -> None:
        """Count the messages of a chunk, and learn the connections defined in it."""
        chunk = BagChunk(at, size, indexed=False, cut=cut)
        self._chunks.append(chunk)
        try:
            raw, _ = unpack(memoryview(self._file.read(at, size)), cut=cut)
            for opcode, entry in walk(raw):
                if opcode == CONNECTION:
                    self._add_connection(entry.head, raw[entry.start : entry.end])
                elif opcode == MESSAGE:
                    key, time = entry.key, time_ns(entry.head, b"time")
                    chunk.counts[key] = chunk.counts.get(key, 0) + 1
                    chunk.first_ns = min(chunk.first_ns or time, time)
                    chunk.last_ns = max(chunk.last_ns, time)
        except DamagedError as error:
            if not cut:
                text = f"The log is damaged in one place: {error}."
                self.findings.append(Finding("warning", error.code, text))

    def _channels(self) -> list[Channel]:
        held: dict[int, list[BagChunk]] = {key: [] for key in self._connections}
        for chunk in self._chunks:
            for key in chunk.counts.keys() & held.keys():
                held[key].append(chunk)
        return [
            replace(
                self._connections[key],
                count=sum(chunk.counts[key] for chunk in chunks),
                first_ns=min((chunk.first_ns for chunk in chunks), default=None),
                last_ns=max((chunk.last_ns for chunk in chunks), default=None),
            )
            for key, chunks in sorted(held.items())
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
            raise refused(self.path, f"chunks are compressed by {kind!r}; expected none, lz4 or bz2")
        return kind


open_files = BagFile.open_files
