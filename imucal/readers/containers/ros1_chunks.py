"""The chunks of a ROS 1 bag: loaded by their index records, walked where there are none."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from imucal.arrays import IntArray
from imucal.readers.compression import decompress, decompress_prefix
from imucal.readers.containers import ros1_records as records
from imucal.readers.containers.container import Alike, Batch, Guard, Loss, gather
from imucal.readers.containers.ros1_records import number, record, time_ns, walk
from imucal.readers.files import DamagedError, LogFile, Scratch


@dataclass(slots=True, kw_only=True)
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


class BagChunkTask:
    """A chunk to load."""

    def __init__(self, file: LogFile, chunk: BagChunk, keys: frozenset[int]) -> None:
        self._file = file
        self._chunk = chunk
        self.size = chunk.size
        # An index entry has 12 bytes: a count beyond them is not believed.
        most = chunk.size // 12 if chunk.indexed else chunk.size
        self.counts = {key: min(n, most) for key, n in chunk.counts.items() if key in keys and n}

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted connection; see `Task`."""
        region = scratch.buffer(self.size)
        self._file.into(self._chunk.start, region)
        raw, end = unpack(region, cut=self._chunk.cut)
        indexes = self._indexes(region[end:]) if self._chunk.indexed else {}
        for key in self.counts:
            if key in indexes:
                yield key, _indexed(raw, key, indexes[key])
            else:
                loss = Loss(code="index", text="an index record is missing; its chunk was walked instead")
                yield key, _walked(raw, key, loss if self._chunk.indexed else None)

    def _indexes(self, behind: memoryview) -> dict[int, memoryview]:
        """Return connection -> entries of its index record behind the chunk, up to the last wanted one."""
        found: dict[int, memoryview] = {}
        with suppress(DamagedError):
            for opcode, entry in walk(behind):
                size = entry.end - entry.start
                if opcode != records.INDEX or size != 12 * number(entry.head, b"count", 4):
                    break
                found[entry.key] = behind[entry.start : entry.end]
                if self.counts.keys() <= found.keys():
                    break
        return found


def unpack(region: memoryview, *, cut: bool = False) -> tuple[memoryview, int]:
    """Return what the chunk at the start of a region holds, and where it ends; raises DamagedError."""
    entry = record(region, 0)
    data = region[entry.start : entry.end]
    if entry.head.get(b"op") != bytes([records.CHUNK]):
        msg = "a chunk's head is damaged"
        raise DamagedError(msg)
    size = number(entry.head, b"size", 4)
    if cut:
        return memoryview(decompress_prefix(entry.compression, data, size)), entry.end
    if entry.end > len(region):
        msg = "a chunk is cut"
        raise DamagedError(msg, code="truncated")
    return decompress(entry.compression, data, size), entry.end


def _indexed(raw: memoryview, key: int, entries: memoryview) -> Batch:
    """Return the messages that an index record lists.

    All records are compared with the last one, whose header repeats but for the time; the first may have
    the connection's own record in front.
    """
    table = np.frombuffer(entries, "<u4").reshape(-1, 3)
    starts = table[:, 2].astype(np.int64)
    log_ns = table[:, 0].astype(np.int64)
    log_ns *= 1_000_000_000
    log_ns += table[:, 1]

    def check() -> Batch:
        return _checked(raw, key, starts, log_ns)

    if not starts.size:
        return Batch(buffer=raw, starts=starts, header=0, sizes=0, log_ns=log_ns)
    last = int(starts[-1])
    size = int.from_bytes(raw[last : last + 4], "little")
    head = bytes(raw[last : last + size + 8])
    time = head.find(b"time=") + 5
    common = _message_head(head[:time] + bytes(8) + head[time + 8 :]) if time >= 5 else None
    if common is None or common[0] != key:
        return check()
    return Batch(
        buffer=raw,
        starts=starts,
        header=len(head),
        sizes=common[1],
        log_ns=log_ns,
        guards=common[2],
        check=check,
    )


@lru_cache(maxsize=64)
def _message_head(head: bytes) -> tuple[int, int, tuple[Guard, ...]] | None:
    """Return connection, bytes of data and guards by a message's header, its time blank; None for others."""
    guards = _guards(head)
    with suppress(DamagedError):
        entry = record(head, 0)
        if guards is not None and entry.opcode == records.MESSAGE and entry.start == len(head):
            return entry.key, entry.end - entry.start, guards
    return None


def _guards(head: bytes) -> tuple[Guard, ...] | None:
    """Return the bytes of a header, its lengths too, except the value of its time."""
    at = head.find(b"time=") + 5
    if at < 5:
        return None
    return tuple((start, part) for start, part in ((0, head[:at]), (at + 8, head[at + 8 :])) if part)


def _checked(raw: memoryview, key: int, starts: IntArray, log_ns: IntArray) -> Batch:
    """Check the header of every record; skip connection records; walk the chunk where that fails."""
    payloads, sizes = starts.copy(), np.zeros(starts.size, dtype=np.int64)
    try:
        for row in _take_alike(raw, key, payloads, sizes).tolist():
            payloads[row], sizes[row] = _message(raw, key, int(starts[row]))
    except DamagedError:
        loss = Loss(code="index", text="an index points to other records; its chunk was walked instead")
        return _walked(raw, key, loss)
    return Batch(buffer=raw, starts=payloads, header=0, sizes=sizes, log_ns=log_ns)


def _take_alike(raw: memoryview, key: int, payloads: IntArray, sizes: IntArray) -> IntArray:
    """Turn the starts of messages whose header is that of the last into their payloads; return the others.

    Raises DamagedError if the last is no message of the connection.
    """
    last = int(payloads[-1])
    head = bytes(raw[last : _message(raw, key, last)[0]])
    guards = _guards(head[:-4])
    if guards is None:
        return np.arange(payloads.size)
    rows = np.flatnonzero((payloads >= 0) & (payloads <= len(raw) - len(head)))
    heads = gather(raw, payloads[rows], len(head))
    length = np.ndarray(heads.shape, "<u4", buffer=heads, offset=len(head) - 4, strides=heads.strides).copy()
    alike = Alike(guards, len(head)).each(heads) & (payloads[rows] + len(head) + length <= len(raw))
    rows = rows[alike]
    payloads[rows] += len(head)
    sizes[rows] = length[alike]
    return np.delete(np.arange(payloads.size), rows)


def _message(raw: memoryview, key: int, at: int) -> tuple[int, int]:
    """Return payload and size of the message at `at`, or behind the connection records there."""
    while (entry := record(raw, at)).end <= len(raw):
        if entry.opcode == records.MESSAGE and entry.key == key:
            return entry.start, entry.end - entry.start
        if entry.opcode != records.CONNECTION:
            break
        at = entry.end
    msg = "an index points to another record"
    raise DamagedError(msg, code="index")


def _walked(raw: memoryview, key: int, loss: Loss | None) -> Batch:
    """Return the messages of a connection in a chunk, found by walking it."""
    found = [
        (entry.start, entry.end - entry.start, time_ns(entry.head, b"time"))
        for opcode, entry in walk(raw)
        if opcode == records.MESSAGE and int.from_bytes(entry.head.get(b"conn", b""), "little") == key
    ]
    starts, sizes, times = np.array(found, dtype=np.int64).reshape(-1, 3).T.copy()
    return Batch(buffer=raw, starts=starts, header=0, sizes=sizes, log_ns=times, loss=loss)
