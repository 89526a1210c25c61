"""ROS 1 bags of version 2.0, chunks uncompressed or in lz4 or bz2.

`rosbags` refuses unindexed and truncated bags, and builds an object per message. Source:
https://wiki.ros.org/Bags/Format/2.0.
"""

import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imucal.arrays import IntArray
from imucal.readers.compression import KINDS, decompress
from imucal.readers.containers.container import Batch, Bytes, Channel, Loss, MessageFile, Task, cells, gather
from imucal.readers.files import DamagedError, damaged_if, refused

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
U32 = struct.Struct("<I")
PAIR = struct.Struct("<II")
#: Longest header of a record in a chunk; it may contain a topic.
_MAX_HEADER = 1 << 20
#: A larger index section is damage, in bytes.
_MAX_INDEX = 1 << 31
#: Longest header of other records.
_HEAD_BLOCK = 1 << 12
#: Bytes per message in an index record.
_ENTRY = 12


class Record(NamedTuple):
    """A record: fields of its header, start and end of its data."""

    head: Mapping[bytes, bytes]
    start: int
    end: int

    @property
    def opcode(self) -> int:
        return self.number(b"op", 1)

    @property
    def key(self) -> int:
        return self.number(b"conn", 4)

    def text(self, name: bytes, default: bytes = b"") -> str:
        return self.head.get(name, default).decode("utf-8", "replace")

    def number(self, name: bytes, size: int) -> int:
        """Return an integer field of `size` bytes; raises DamagedError."""
        value = self.head.get(name, b"")
        damaged_if(len(value) != size, "a record header is damaged")
        return int.from_bytes(value, "little")

    def time_ns(self, name: bytes) -> int:
        seconds, nanoseconds = PAIR.unpack(self.head.get(name, b"")[:8].ljust(8, b"\0"))
        return int(seconds) * 10**9 + int(nanoseconds)


def record(buffer: Bytes, at: int) -> Record:
    """Return the record at `at`, which may extend beyond the buffer; raises DamagedError."""
    try:
        end = at + 4 + U32.unpack_from(buffer, at)[0]
        damaged_if(end - at - 4 > _MAX_HEADER or end > len(buffer), "a record header is damaged")
        return Record(_head(bytes(buffer[at + 4 : end])), end + 4, end + 4 + U32.unpack_from(buffer, end)[0])
    except struct.error as error:
        raise DamagedError("a record header is damaged") from error


def walk(raw: Bytes, at: int = 0) -> Iterator[tuple[int, Record]]:
    """Yield opcode and record from `at` on, up to the first incomplete record."""
    with suppress(DamagedError):
        while (entry := record(raw, at)).end <= len(raw):
            yield entry.opcode, entry
            at = entry.end


def fields(data: bytes) -> dict[bytes, bytes]:
    """Return name -> value of consecutive fields; raises DamagedError."""
    found, at = {}, 0
    while at + 4 <= len(data):
        start = at + 4
        at = start + U32.unpack_from(data, at)[0]
        name, equals, value = data[start:at].partition(b"=")
        damaged_if(at > len(data) or not equals, "a record header is damaged")
        found[name] = value
    return found


#: Most index records have the same header as in the previous chunk.
_head = lru_cache(maxsize=128)(fields)


def connection(entry: Record, data: Bytes) -> Channel:
    """Return the channel of a connection record; its data are a second header."""
    inner = Record(fields(bytes(data)), 0, 0)
    definition = inner.text(b"message_definition")
    return Channel(
        key=entry.key,
        topic=entry.text(b"topic"),
        type=inner.text(b"type"),
        encoding="ros1",
        definition=definition,
        definition_kind="ros1msg" if definition else "",
    )


def entries_of(data: Bytes) -> tuple[IntArray, IntArray]:
    """Return log times in ns and offsets from an index record; raises DamagedError."""
    damaged_if(len(data) % _ENTRY, "an index record is damaged", "index")
    seconds, nanoseconds, starts = np.frombuffer(data, "<u4").reshape(-1, 3).T.astype(np.int64, order="C")
    return seconds * 10**9 + nanoseconds, starts


@dataclass(slots=True)
class Chunk:
    """A chunk's place in the file, including its index records."""

    start: int
    end: int
    #: Connection -> number of messages; None if unknown.
    counts: dict[int, int] | None
    first_ns: int = 0
    last_ns: int = 0

    def add_times(self, times: list[int]) -> None:
        """Extend first and last time; 0 is an unknown time."""
        known = [time for time in (self.first_ns, self.last_ns, *times) if time]
        self.first_ns, self.last_ns = min(known, default=0), max(known, default=0)


def unpack(region: memoryview) -> tuple[memoryview, int]:
    """Return the content of the chunk at the start of a region, and its end; raises DamagedError."""
    entry = record(region, 0)
    damaged_if(entry.opcode != CHUNK or entry.end > len(region), "a chunk's head is damaged")
    data = region[entry.start : entry.end]
    return decompress(entry.text(b"compression", b"none"), data, entry.number(b"size", 4)), entry.end


def listed(raw: memoryview, key: int, data: Bytes) -> Batch:
    """Return the messages of an index record; raises DamagedError.

    Only headers that differ from the last one, apart from time and size, are parsed.
    """
    log_ns, starts = entries_of(data)
    if not starts.size:
        return Batch(raw, starts, starts, log_ns)
    last = int(starts[-1])
    head = bytes(raw[last : _message(raw, key, last).start])
    time = head.rfind(b"time=", 0, len(head) - PAIR.size) + 5
    payloads, sizes = starts + len(head), np.zeros_like(starts)
    inside = np.flatnonzero(starts <= len(raw) - len(head))
    heads = gather(raw, starts[inside], len(head))
    sizes[inside] = cells(heads, len(head) - 4, "<u4")
    times = cells(heads, time, "<u4").astype(np.int64) * 10**9 + cells(heads, time + 4, "<u4")
    same = heads.view(np.uint8).reshape(-1, len(head)) == np.frombuffer(head, np.uint8)
    same[:, time : time + PAIR.size] = same[:, -U32.size :] = True
    equal = inside[same.all(axis=1) & (times == log_ns[inside])]
    equal = equal[payloads[equal] + sizes[equal] <= len(raw)]
    for row in np.setdiff1d(np.arange(starts.size), equal).tolist() if equal.size < starts.size else ():
        entry = _message(raw, key, int(starts[row]))
        damaged_if(entry.time_ns(b"time") != log_ns[row], "an index record points to wrong records")
        payloads[row], sizes[row] = entry.start, entry.end - entry.start
    return Batch(raw, payloads, sizes, log_ns)


def _message(raw: memoryview, key: int, at: int) -> Record:
    """Return the message at `at`, or after connection records there; raises DamagedError."""
    for opcode, entry in walk(raw, at):
        if opcode == MESSAGE and entry.key == key:
            return entry
        if opcode != CONNECTION:
            break
    raise DamagedError("an index record points to wrong records")


def walked(raw: memoryview) -> dict[int, list[tuple[int, int, int]]]:
    """Return connection -> start, size and log time of each message in a chunk."""
    found: dict[int, list[tuple[int, int, int]]] = {}
    for opcode, entry in walk(raw):
        if opcode == MESSAGE and len(entry.head.get(b"conn", b"")) == U32.size:
            place = entry.start, entry.end - entry.start, entry.time_ns(b"time")
            found.setdefault(entry.key, []).append(place)
    return found


class BagFile(MessageFile):
    """A container of the messages of a ROS 1 bag."""

    format = "rosbag1"

    def _read_index(self) -> None:
        self._connections: dict[int, Channel] = {}
        self._chunks: list[Chunk] = []
        magic = self._file.read(0, min(len(MAGIC), self.size))
        if magic != MAGIC:
            why = f"not a ROS 1 bag (first bytes {magic!r}); expected {MAGIC!r}, copy or record it again"
            if magic.startswith(b"#ROSBAG V"):
                version = magic[9:].split(b"\n")[0].decode("ascii", "replace")
                why = f"a bag of version {version}; expected 2.0, convert it with `rosbag fix`"
            raise refused(self.path, why)
        try:
            self._read_section()
        except DamagedError as error:
            self._connections, self._chunks = {}, []
            end = self._scan()
            if not self._connections:
                why = f"{error}, and no connection was found; expected a ROS 1 bag, copy it again"
                raise refused(self.path, why) from None
            self.findings.append(self._file.scan_finding(error, end))
        self.compression = self._compression()
        self.channels = [self._channel(key) for key in sorted(self._connections)]
        self.start_ns = min((chunk.first_ns for chunk in self._chunks if chunk.first_ns), default=None)
        self.end_ns = max((chunk.last_ns for chunk in self._chunks if chunk.last_ns), default=None)

    def _read_section(self) -> None:
        bag = record(self._file.read(0, min(_HEAD_BLOCK, self.size)), len(MAGIC))
        if name := bag.text(b"encryptor"):
            why = f"the bag is encrypted by {name}; expected a plain bag, decrypt it first"
            raise refused(self.path, why)
        start = bag.number(b"index_pos", 8)
        damaged_if(not start, "the bag was not closed and has no index", "unindexed")
        wrong = not len(MAGIC) <= start <= self.size or self.size - start > _MAX_INDEX
        damaged_if(wrong, "the index is beyond the end of the file", "truncated")
        section = memoryview(self._file.read(start, self.size - start))
        end = 0
        for opcode, entry in walk(section):
            data, end = section[entry.start : entry.end], entry.end
            if opcode == CONNECTION:
                self._connections[entry.key] = connection(entry, data)
            elif opcode == CHUNK_INFO:
                damaged_if(len(data) % PAIR.size, "a chunk's entry in the index is damaged")
                first, last = entry.time_ns(b"start_time"), entry.time_ns(b"end_time")
                counts = dict(PAIR.iter_unpack(data))
                wrong = len(counts) * PAIR.size != len(data) or len(counts) != entry.number(b"count", 4)
                damaged_if(wrong or 0 in counts.values(), "a chunk's entry in the index is damaged")
                self._chunks.append(Chunk(entry.number(b"chunk_pos", 8), 0, counts, first, last))
        counted = {key for chunk in self._chunks for key in chunk.counts or ()}
        damaged_if(counted - self._connections.keys(), "the index counts messages of unknown connections")
        cut = end < len(section) or len(self._chunks) < bag.number(b"chunk_count", 4)
        cut |= len(self._connections) < bag.number(b"conn_count", 4)
        damaged_if(cut, "the index is cut off", "truncated")
        ordered = sorted(self._chunks, key=lambda chunk: chunk.start)
        for chunk, after in pairwise([*ordered, Chunk(start, 0, None)]):
            damaged_if(not len(MAGIC) < chunk.start < after.start, "the index points to wrong chunks")
            chunk.end = after.start

    def _define(self, entry: Record, data: Bytes) -> None:
        with suppress(DamagedError):
            channel = connection(entry, data)
            self._connections.setdefault(channel.key, channel)

    def _scan(self) -> int:
        at = len(MAGIC)
        with suppress(DamagedError):
            while at < self.size:
                entry = record(self._file.read(at, min(_HEAD_BLOCK, self.size - at)), 0)
                opcode, end = entry.opcode, at + entry.end
                if end > self.size:
                    break
                if opcode == CHUNK:
                    self._chunks.append(Chunk(at, end, None))
                elif opcode == CONNECTION:
                    self._define(entry, self._file.read(at + entry.start, entry.end - entry.start))
                elif opcode == INDEX and self._chunks and self._chunks[-1].end == at:
                    self._chunks[-1].end = end
                    self._add_index(entry, self._file.read(at + entry.start, entry.end - entry.start))
                at = end
        for chunk in self._chunks:
            if chunk.counts is None or not self._connections.keys() >= chunk.counts.keys():
                with suppress(DamagedError):
                    self._search(chunk)
        return at

    def _add_index(self, entry: Record, data: Bytes) -> None:
        with suppress(DamagedError):
            chunk = self._chunks[-1]
            chunk.counts = (chunk.counts or {}) | {entry.key: len(data) // _ENTRY}
            chunk.add_times(entries_of(data)[0].tolist())

    def _search(self, chunk: Chunk) -> None:
        raw, _ = self._content(chunk)
        for opcode, entry in walk(raw):
            if opcode == CONNECTION:
                self._define(entry, raw[entry.start : entry.end])
        if chunk.counts is None:
            found = walked(raw)
            chunk.counts = {key: len(places) for key, places in found.items()}
            chunk.add_times([time for places in found.values() for _, _, time in places])

    def _channel(self, key: int) -> Channel:
        counts = [chunk.counts and chunk.counts.get(key, 0) for chunk in self._chunks]
        chunks = [chunk for chunk, count in zip(self._chunks, counts, strict=True) if count]
        return replace(
            self._connections[key],
            count=None if None in counts else sum(count or 0 for count in counts),
            first_ns=min((chunk.first_ns for chunk in chunks), default=None),
            last_ns=max((chunk.last_ns for chunk in chunks), default=None),
        )

    def _compression(self) -> str:
        """All chunks of a bag have the same compression."""
        if not self._chunks:
            return "none"
        try:
            at = self._chunks[0].start
            head = record(self._file.read(at, min(_HEAD_BLOCK, self.size - at)), 0)
        except DamagedError:
            return "unknown"
        kind = head.text(b"compression", b"none")
        if kind not in KINDS:
            raise refused(self.path, f"chunks are compressed by {kind!r}; expected none, lz4 or bz2")
        return kind

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        for chunk in self._chunks:
            if found := frozenset(key for key in keys if chunk.counts is None or chunk.counts.get(key)):
                yield Task(chunk.end - chunk.start, found, partial(self._load, chunk, found))

    def _content(self, chunk: Chunk) -> tuple[memoryview, memoryview]:
        """Return the content of a chunk, and the index records after it; raises DamagedError."""
        region = memoryview(self._file.read(chunk.start, chunk.end - chunk.start))
        raw, end = unpack(region)
        return raw, region[end:]

    def _load(self, chunk: Chunk, keys: frozenset[int]) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each connection; walk the chunk if an index record is wrong."""
        raw, rest = self._content(chunk)
        indexes: dict[int, memoryview] = {}
        with suppress(DamagedError):
            for opcode, entry in walk(rest):
                if opcode != INDEX:
                    break
                indexes[entry.key] = rest[entry.start : entry.end]
        for key in keys:
            try:
                damaged_if(key not in indexes, "an index record is missing")
                batch = listed(raw, key, indexes[key])
            except DamagedError as error:
                # Chunks of an unclosed bag may have no index records.
                text = f"{error}; all records of its chunk were read instead"
                starts, sizes, times = np.array(walked(raw).get(key, []), np.int64).reshape(-1, 3).T.copy()
                batch = Batch(raw, starts, sizes, times, Loss("index", text) if rest else None)
            yield key, batch


open_files = BagFile.open_files
