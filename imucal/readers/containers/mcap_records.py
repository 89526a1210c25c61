"""The records of an MCAP file that a reader needs: fields by position, nothing decoded twice.

The `mcap` package reads intact files and is the witness in the tests; it refuses every truncated file, and
builds an object for each record. Source: MCAP specification 0, https://mcap.dev/spec.
"""

import struct
from dataclasses import dataclass, field

from imucal.readers.containers.container import Bytes
from imucal.readers.files import DamagedError

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 2, 3, 4, 5, 6, 7, 8
STATISTICS, DATA_END = 0x0B, 0x0F

#: Opcode and length in front of every record.
HEAD = struct.Struct("<BQ")
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_CHUNK = struct.Struct("<QQQII")
_INDEX = struct.Struct("<QQQQI")
_PAIR = struct.Struct("<HQ")


_NAMES = {
    SCHEMA: "schema",
    CHANNEL: "channel",
    CHUNK: "chunk",
    CHUNK_INDEX: "chunk index",
    STATISTICS: "statistics",
}


class _BrokenRecordError(DamagedError):
    """A record is shorter than its fields."""

    def __init__(self, opcode: int) -> None:
        super().__init__(f"a {_NAMES[opcode]} record is damaged")


@dataclass(frozen=True, slots=True)
class Schema:
    """A message definition."""

    id: int
    name: str
    encoding: str
    text: str
    raw: bytes = field(default=b"", compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A channel: its topic, and the number of its schema (0 for none)."""

    id: int
    schema: int
    topic: str
    encoding: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkHead:
    """The fields of a chunk in front of its data, which start `data` bytes after the record's start."""

    size: int
    crc: int
    compression: str
    data: int
    stored: int


@dataclass(slots=True, kw_only=True)
class ChunkIndex:
    """Where a chunk lies; `indexes` is channel -> position of its message index."""

    start: int
    length: int
    compression: str
    index_length: int = 0
    indexes: dict[int, int] = field(default_factory=dict)
    first_ns: int = 0
    last_ns: int = 0


def schema(body: Bytes) -> Schema:
    """Parse a Schema record."""
    try:
        number = _U16.unpack_from(body, 0)[0]
        name, at = _text(body, 2)
        encoding, at = _text(body, at)
        text, end = _text(body, at)
    except struct.error as error:
        raise _BrokenRecordError(SCHEMA) from error
    return Schema(number, name, encoding, text, bytes(body[at + 4 : end]))


def channel(body: Bytes) -> ChannelRecord:
    """Parse a Channel record; its metadata is not needed."""
    try:
        number, of_schema = _U16.unpack_from(body, 0)[0], _U16.unpack_from(body, 2)[0]
        topic, at = _text(body, 4)
        encoding, _ = _text(body, at)
    except struct.error as error:
        raise _BrokenRecordError(CHANNEL) from error
    return ChannelRecord(number, of_schema, topic, encoding)


def chunk_head(record: Bytes) -> ChunkHead:
    """Parse the head of a Chunk record, its opcode and length included."""
    try:
        _, _, size, crc, name = _CHUNK.unpack_from(record, 9)
        compression = bytes(record[41 : 41 + name]).decode("ascii", "replace")
        stored = _U64.unpack_from(record, 41 + name)[0]
    except struct.error as error:
        raise _BrokenRecordError(CHUNK) from error
    return ChunkHead(size=size, crc=crc, compression=compression, data=49 + name, stored=stored)


def chunk_index(body: Bytes) -> ChunkIndex:
    """Parse a ChunkIndex record."""
    try:
        first, last, start, length, size = _INDEX.unpack_from(body, 0)
        if size % 10 or 36 + size + 8 > len(body):
            raise _BrokenRecordError(CHUNK_INDEX)
        indexes = dict(_PAIR.iter_unpack(body[36 : 36 + size]))
        index_length = _U64.unpack_from(body, 36 + size)[0]
        compression, _ = _text(body, 44 + size)
    except struct.error as error:
        raise _BrokenRecordError(CHUNK_INDEX) from error
    return ChunkIndex(
        start=start,
        length=length,
        index_length=index_length,
        indexes=indexes,
        compression=compression,
        first_ns=first,
        last_ns=last,
    )


def statistics(body: Bytes) -> tuple[int, int, int, int, dict[int, int]]:
    """Return messages, chunks, first and last time in ns, and messages of each channel."""
    try:
        messages = _U64.unpack_from(body, 0)[0]
        chunks = _U32.unpack_from(body, 22)[0]
        first, last = _U64.unpack_from(body, 26)[0], _U64.unpack_from(body, 34)[0]
        size = _U32.unpack_from(body, 42)[0]
        if size % 10 or 46 + size > len(body):
            raise _BrokenRecordError(STATISTICS)
        counts = dict(_PAIR.iter_unpack(body[46 : 46 + size]))
    except struct.error as error:
        raise _BrokenRecordError(STATISTICS) from error
    return messages, chunks, first, last, counts


def _text(body: Bytes, at: int) -> tuple[str, int]:
    size = _U32.unpack_from(body, at)[0]
    end = at + 4 + size
    if end > len(body):
        raise _BrokenRecordError(SCHEMA)
    return bytes(body[at + 4 : end]).decode("utf-8", "replace"), end
