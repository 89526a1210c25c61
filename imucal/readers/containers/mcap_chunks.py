"""The chunks of an MCAP file: loaded by their message index, walked record by record where it fails."""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.compression import check_crc, decompress, decompress_prefix
from imucal.readers.containers import mcap_records as records
from imucal.readers.containers.container import Batch, Bytes, Loss, gather
from imucal.readers.containers.mcap_records import HEAD, ChunkIndex
from imucal.readers.files import DamagedError, LogFile, Scratch

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
