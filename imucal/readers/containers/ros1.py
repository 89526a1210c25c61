"""ROS 1 bags of version 2.0, chunks uncompressed or in lz4 or bz2.

The heads of all records are scanned, so closed, unclosed, truncated and damaged bags are read alike. The
counts at the end of a closed bag are compared with the records. `rosbags` refuses bags that were not closed,
and builds an object per message. Source: https://wiki.ros.org/Bags/Format/2.0.
"""

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imucal.arrays import IntArray
from imucal.findings import Finding
from imucal.readers.compression import decompress
from imucal.readers.containers.chunked import Chunk, ChunkedFile, scan_text
from imucal.readers.containers.container import Batch, Bytes, Channel, cells, gather
from imucal.readers.files import DamagedError, damaged_if, refused

MAGIC = b"#ROSBAG V2.0\n"
#: Values of the field ``op`` in a record's header.
MESSAGE = 0x02
BAG = 0x03
INDEX = 0x04
CHUNK = 0x05
CHUNK_INFO = 0x06
CONNECTION = 0x07

#: A length, or another number.
U32 = struct.Struct("<I")
#: Seconds and nanoseconds, or connection and number of messages.
PAIR = struct.Struct("<II")
#: Longest header of a record, in bytes; it may contain a topic.
_MAX_HEADER = 1 << 20
#: Bytes read of each record in a scan; the headers of chunks and index records fit.
_START = 256
#: Bytes searched at once for the next chunk after damage.
_SEARCHED = 1 << 20
#: Most bytes from the start of a chunk to the end of its field ``op``: the other fields have about 40.
_CHUNK_HEADER = 64
#: Most places that are tried, so that a file full of such fields takes seconds.
_MAX_CANDIDATES = 10_000
#: The field ``op`` of a chunk.
_OPCODE_OF_CHUNK = b"op=\x05"
#: Bytes per message in an index record: time and position.
_ENTRY = 12


class Record(NamedTuple):
    """A record: its header, start and end of its data."""

    head: bytes
    start: int
    end: int

    @property
    def fields(self) -> Mapping[bytes, bytes]:
        """The fields of the header; raises DamagedError."""
        return fields(self.head)

    @property
    def opcode(self) -> int:
        return self.number(b"op", 1)

    @property
    def key(self) -> int:
        return self.number(b"conn", 4)

    def text(self, name: bytes, default: bytes = b"") -> str:
        return self.fields.get(name, default).decode("utf-8", "replace")

    def number(self, name: bytes, size: int) -> int:
        """Return an integer field of `size` bytes; raises DamagedError."""
        value = self.fields.get(name, b"")
        damaged_if(len(value) != size, "a record header is damaged")
        return int.from_bytes(value, "little")

    def time_ns(self, name: bytes) -> int:
        seconds, nanoseconds = PAIR.unpack(self.fields.get(name, b"")[:8].ljust(8, b"\0"))
        return int(seconds) * 10**9 + int(nanoseconds)


def record(buffer: Bytes, position: int) -> Record:
    """Return the record at a position, whose data may extend beyond the buffer; raises DamagedError."""
    try:
        start = position + U32.size
        end = start + U32.unpack_from(buffer, position)[0]
        is_header = start < end <= min(len(buffer), start + _MAX_HEADER)
        damaged_if(not is_header, "a record header is damaged")
        data = end + U32.size
        return Record(bytes(buffer[start:end]), data, data + U32.unpack_from(buffer, end)[0])
    except struct.error as error:
        raise DamagedError("a record header is damaged") from error


def walk(raw: Bytes, position: int = 0) -> Iterator[tuple[int, Record]]:
    """Yield opcode and record from a position on, up to the first incomplete or damaged record."""
    with suppress(DamagedError):
        while (entry := record(raw, position)).end <= len(raw):
            yield entry.opcode, entry
            position = entry.end


# Most index records have the same header as in the previous chunk.
@lru_cache(maxsize=128)
def fields(data: bytes) -> Mapping[bytes, bytes]:
    """Return name -> value of consecutive fields; raises DamagedError."""
    values = {}
    end = 0
    while end + U32.size <= len(data):
        start = end + U32.size
        end = start + U32.unpack_from(data, end)[0]
        name, equals, value = data[start:end].partition(b"=")
        damaged_if(end > len(data) or not equals, "a record header is damaged")
        values[name] = value
    return values


def connection(entry: Record, data: Bytes) -> Channel:
    """Return the channel of a connection record; its data are a second header."""
    inner = Record(bytes(data), 0, 0)
    definition = inner.text(b"message_definition")
    return Channel(
        key=entry.key,
        topic=entry.text(b"topic"),
        type=inner.text(b"type"),
        encoding="ros1",
        definition=definition,
        definition_kind="ros1msg" if definition else "",
    )


def unpack(chunk: memoryview) -> memoryview:
    """Return the content of a Chunk record; raises DamagedError."""
    entry = record(chunk, 0)
    damaged_if(entry.opcode != CHUNK or entry.end > len(chunk), "a chunk's head is damaged")
    data = chunk[entry.start : entry.end]
    return decompress(entry.text(b"compression", b"none"), data, entry.number(b"size", 4))


def _message(raw: memoryview, key: int, position: int) -> Record:
    """Return the message at a position, or after connection records there; raises DamagedError."""
    for opcode, entry in walk(raw, position):
        if opcode == MESSAGE and entry.key == key:
            return entry
        if opcode != CONNECTION:
            break
    raise DamagedError("an index record points to wrong records")


class BagFile(ChunkedFile):
    """A container of the messages of a ROS 1 bag."""

    format = "rosbag1"

    def __init__(self, path: Path) -> None:
        #: Connection -> number of its messages at the end of a closed bag, which lists its chunks.
        self._stated_counts: Counter[int] = Counter()
        self._listed_chunks = 0
        #: Damaged parts before intact chunks.
        self._damages: list[str] = []
        #: Places that were tried as chunks after damage.
        self._candidates = 0
        self._is_closed = False
        #: Numbers in the header of a closed bag.
        self._stated_chunks = 0
        self._stated_connections = 0
        super().__init__(path)

    def _read_index(self) -> None:
        self._check_magic()
        end = self._scan()
        self._search_chunks()
        if 0 < self._stated_chunks <= self._listed_chunks:
            # The end of the bag counts the messages of damaged chunks, too.
            self._is_counted = True
        # Each message has an entry in an index record.
        most = self.size // _ENTRY
        for key, count in self._stated_counts.items():
            self._counts[key] = max(self._counts[key], min(count, most))
        if not self._defined:
            advice = "expected a ROS 1 bag, copy it again"
            raise refused(self.path, f"the bag is cut off or damaged: no connection was found; {advice}")
        self._add_findings(end)
        self.compression = self._compressions("none, lz4 or bz2")
        spans = self._spans()
        self.channels = []
        for key, channel in sorted(self._defined.items()):
            first, last = spans.get(key, (None, None))
            self.channels.append(replace(channel, count=self._count(key), first_ns=first, last_ns=last))
        self.start_ns = min((first for first, _ in spans.values()), default=None)
        self.end_ns = max((last for _, last in spans.values()), default=None)

    def _check_magic(self) -> None:
        magic = self._file.read(0, min(len(MAGIC), self.size))
        if magic == MAGIC:
            return
        why = f"not a ROS 1 bag (first bytes {magic!r}); expected {MAGIC!r}, copy or record it again"
        if magic.startswith(b"#ROSBAG V"):
            version = magic[9:].split(b"\n")[0].decode("ascii", "replace")
            why = f"a bag of version {version}; expected 2.0, convert it with `rosbag fix`"
        raise refused(self.path, why)

    def _scan(self) -> int:
        """Read the heads of all records; return the end of the last complete one."""
        position = len(MAGIC)
        chunk: Chunk | None = None
        while position < self.size:
            try:
                entry = self._record(position)
                chunk = self._add_record(entry, position, chunk)
                position = entry.end
            except DamagedError as error:
                if chunk is not None:
                    # The damaged record may be one of its index records.
                    self._forget_index(chunk)
                    chunk = None
                following = None
                with suppress(DamagedError):
                    following = self._next_chunk(position + 1)
                if following is None:
                    break
                self._damages.append(f"{following - position} bytes at byte {position}: {error}")
                position = following
        return position

    def _forget_index(self, chunk: Chunk) -> None:
        """Let a chunk be searched for its messages."""
        for key, position in chunk.indexes.items():
            with suppress(DamagedError):
                if position is not None:
                    self._counts[key] -= self._entries(position, key)[0].size
        chunk.indexes.clear()

    def _next_chunk(self, position: int) -> int | None:
        """Return the start of the first complete chunk from a position on; None without one.

        Raises DamagedError if the file becomes shorter.
        """
        while position < self.size:
            block = self._file.read(position, min(_SEARCHED, self.size - position))
            place = block.find(_OPCODE_OF_CHUNK)
            while place >= 0 and self._candidates < _MAX_CANDIDATES:
                self._candidates += 1
                for start in range(max(place - _CHUNK_HEADER, 0), place):
                    with suppress(DamagedError):
                        if self._record(position + start).opcode == CHUNK:
                            return position + start
                place = block.find(_OPCODE_OF_CHUNK, place + 1)
            if position + len(block) == self.size:
                break
            # A header may extend over two blocks.
            position += len(block) - _CHUNK_HEADER
        return None

    def _record(self, position: int) -> Record:
        """Return the complete record at a position of the file; raises DamagedError."""
        rest = self.size - position
        head = self._file.read(position, min(_START, rest))
        length = int.from_bytes(head[: U32.size], "little") + 2 * U32.size
        if len(head) < length <= _MAX_HEADER:
            head = self._file.read(position, min(length, rest))
        entry = record(head, 0)
        damaged_if(position + entry.end > self.size, "a record is cut off", "truncated")
        return Record(entry.head, position + entry.start, position + entry.end)

    def _data(self, entry: Record) -> bytes:
        return self._file.read(entry.start, entry.end - entry.start)

    def _add_record(self, entry: Record, position: int, chunk: Chunk | None) -> Chunk | None:
        """Add a record after `chunk`, or elsewhere if that is None; return the chunk of the next record."""
        opcode = entry.opcode
        if opcode == CHUNK:
            # A recorder writes the size of a chunk when it finishes the chunk.
            damaged_if(entry.start == entry.end, "a chunk was not finished", "truncated")
            chunk = Chunk(position, entry.end, entry.text(b"compression", b"none"))
            self._chunks.append(chunk)
            return chunk
        if opcode == INDEX:
            count, rest = divmod(entry.end - entry.start, _ENTRY)
            damaged_if(rest, "an index record is damaged", "index")
            if chunk is not None and count:
                damaged_if(entry.key in chunk.indexes, "an index record is repeated", "index")
                chunk.indexes[entry.key] = position
                self._counts[entry.key] += count
            return chunk
        if opcode == CONNECTION:
            channel = connection(entry, self._data(entry))
            self._defined.setdefault(channel.key, channel)
        elif opcode == CHUNK_INFO:
            data = self._data(entry)
            damaged_if(len(data) % PAIR.size, "a chunk's entry in the index is damaged")
            self._stated_counts.update(dict(PAIR.iter_unpack(data)))
            self._listed_chunks += 1
        elif opcode == BAG:
            self._add_bag_header(entry)
        else:
            # Messages are only in chunks.
            raise DamagedError(f"a record of kind {opcode} is not expected here")
        return None

    def _add_bag_header(self, entry: Record) -> None:
        if name := entry.text(b"encryptor"):
            text = f"the bag is encrypted by {name}; expected a plain bag, decrypt it first"
            raise refused(self.path, text)
        self._is_closed = entry.number(b"index_pos", 8) > 0
        if self._is_closed:
            self._stated_chunks = entry.number(b"chunk_count", 4)
            self._stated_connections = entry.number(b"conn_count", 4)

    def _add_findings(self, end: int) -> None:
        cut = scan_text(self._file, end)
        is_complete = (
            min(len(self._chunks), self._listed_chunks) >= self._stated_chunks
            and len(self._defined) >= self._stated_connections
        )
        code = "damaged"
        problems = []
        if not self._is_closed:
            code = "unindexed"
            problems.append("The bag was not closed.")
        elif not is_complete and not cut:
            code = "truncated"
            problems.append("The index at the end of the bag is incomplete.")
        if self._damages:
            code = "damaged"
            where = f"{len(self._damages)} places" if len(self._damages) > 1 else "one place"
            problems.append(f"The bag is damaged in {where} ({self._damages[0]}).")
        if cut:
            code = "truncated"
            problems.append(cut.strip())
        if problems:
            problems.append("All complete chunks were read.")
            self.findings.append(Finding("warning", code, " ".join(problems)))

    def _define_all(self, raw: memoryview) -> None:
        for opcode, entry in walk(raw):
            if opcode == CONNECTION:
                with suppress(DamagedError):
                    channel = connection(entry, raw[entry.start : entry.end])
                    self._defined.setdefault(channel.key, channel)

    def _content(self, chunk: Chunk) -> memoryview:
        return unpack(memoryview(self._file.read(chunk.start, chunk.end - chunk.start)))

    def _entries(self, position: int, key: int) -> tuple[IntArray, IntArray]:
        entry = self._record(position)
        damaged_if(entry.opcode != INDEX or entry.key != key, "an index record is missing")
        data = self._data(entry)
        damaged_if(len(data) % _ENTRY, "an index record is damaged", "index")
        seconds, nanoseconds, starts = np.frombuffer(data, "<u4").reshape(-1, 3).T.astype(np.int64, order="C")
        return seconds * 10**9 + nanoseconds, starts

    def _listed(self, raw: memoryview, key: int, log_ns: IntArray, positions: IntArray) -> Batch:
        """Return the messages at some positions; only headers that differ from the last one are parsed."""
        last = int(positions[-1])
        head = bytes(raw[last : _message(raw, key, last).start])
        # Time and size of the data differ between messages.
        time = head.rfind(b"time=", 0, len(head) - PAIR.size) + 5
        starts = positions + len(head)
        sizes = np.zeros_like(positions)
        inside = np.flatnonzero(positions <= len(raw) - len(head))
        heads = gather(raw, positions[inside], len(head))
        sizes[inside] = cells(heads, len(head) - 4, "<u4")
        times = cells(heads, time, "<u4").astype(np.int64) * 10**9 + cells(heads, time + 4, "<u4")
        same = heads.view(np.uint8).reshape(-1, len(head)) == np.frombuffer(head, np.uint8)
        same[:, time : time + PAIR.size] = True
        same[:, -U32.size :] = True
        equal = inside[same.all(axis=1) & (times == log_ns[inside])]
        equal = equal[starts[equal] + sizes[equal] <= len(raw)]
        others = np.ones(positions.size, np.bool_)
        others[equal] = False
        for row in np.flatnonzero(others).tolist():
            entry = _message(raw, key, int(positions[row]))
            damaged_if(entry.time_ns(b"time") != log_ns[row], "an index record points to wrong records")
            starts[row] = entry.start
            sizes[row] = entry.end - entry.start
        return Batch(raw, starts, sizes, log_ns)

    def _walk(self, raw: memoryview) -> dict[int, Batch]:
        places: dict[int, list[tuple[int, int, int]]] = {}
        for opcode, entry in walk(raw):
            if opcode == MESSAGE and len(entry.fields.get(b"conn", b"")) == U32.size:
                place = (entry.start, entry.end - entry.start, entry.time_ns(b"time"))
                places.setdefault(entry.key, []).append(place)
        batches = {}
        for key, rows in places.items():
            starts, sizes, log_ns = np.array(rows, np.int64).T.copy()
            batches[key] = Batch(raw, starts, sizes, log_ns)
        return batches


open_files = BagFile.open_files
