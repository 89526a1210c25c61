"""The records of an MCAP file that a reader needs, field by field.

The `mcap` package reads intact files and is the witness in the tests; it refuses every truncated file, and
builds an object for each record. Source: MCAP specification 0, https://mcap.dev/spec.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from imucal.readers.containers.container import Bytes, Channel
from imucal.readers.files import DamagedError

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 2, 3, 4, 5, 6, 7, 8
STATISTICS, DATA_END = 0x0B, 0x0F
DEFINITIONS = (SCHEMA, CHANNEL)

#: Opcode and length in front of every record.
HEAD = struct.Struct("<BQ")
_PAIR = struct.Struct("<HQ")


@dataclass(frozen=True, slots=True)
class Schema:
    """A message definition."""

    id: int
    name: str
    encoding: str
    text: str
    raw: bytes = field(default=b"", compare=False, repr=False)


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


def each_record(data: Bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, position and length of each record, up to the first that is not whole, or zeros."""
    at, end, head = 0, len(data), HEAD.unpack_from
    while at + 9 <= end:
        opcode, length = head(data, at)
        after = at + 9 + length
        if after > end or not opcode:
            return
        yield opcode, at, length
        at = after


class _Fields:
    """The fields of a record, taken one behind the other."""

    def __init__(self, record: Bytes, name: str, at: int = 0) -> None:
        self.at = at
        self._record = record
        self._name = name

    def bytes(self, size: int) -> bytes:
        """Take `size` bytes; raises DamagedError where the record ends before."""
        start, self.at = self.at, self.at + size
        if self.at > len(self._record):
            raise self._damage()
        return bytes(self._record[start : self.at])

    def number(self, size: int) -> int:
        """Take a number of `size` bytes."""
        return int.from_bytes(self.bytes(size), "little")

    def text(self) -> str:
        """Take a text behind its length."""
        return self.bytes(self.number(4)).decode("utf-8", "replace")

    def map(self) -> dict[int, int]:
        """Take a map of channels behind its length."""
        data = self.bytes(self.number(4))
        if len(data) % _PAIR.size:
            raise self._damage()
        return dict(_PAIR.iter_unpack(data))

    def _damage(self) -> DamagedError:
        return DamagedError(f"a {self._name} record is damaged")


def schema(body: Bytes) -> Schema:
    """Parse a Schema record."""
    fields = _Fields(body, "schema")
    number, name, encoding = fields.number(2), fields.text(), fields.text()
    raw = fields.bytes(fields.number(4))
    return Schema(number, name, encoding, raw.decode("utf-8", "replace"), raw)


def channel(body: Bytes) -> tuple[int, Channel]:
    """Return the number of a channel's schema (0 for none), and the channel; its metadata is not needed."""
    fields = _Fields(body, "channel")
    key, number, topic = fields.number(2), fields.number(2), fields.text()
    return number, Channel(key=key, topic=topic, type="", encoding=fields.text())


def chunk_head(record: Bytes) -> ChunkHead:
    """Parse the head of a Chunk record, its opcode and length included."""
    fields = _Fields(record, "chunk", at=25)
    size, crc, compression, stored = fields.number(8), fields.number(4), fields.text(), fields.number(8)
    return ChunkHead(size=size, crc=crc, compression=compression, data=fields.at, stored=stored)


def chunk_index(body: Bytes) -> ChunkIndex:
    """Parse a ChunkIndex record."""
    fields = _Fields(body, "chunk index", at=16)
    start, length, indexes = fields.number(8), fields.number(8), fields.map()
    index_length = fields.number(8)
    return ChunkIndex(
        start=start, length=length, index_length=index_length, indexes=indexes, compression=fields.text()
    )


def statistics(body: Bytes) -> tuple[int, int, int, int, dict[int, int]]:
    """Return messages, chunks, first and last time in ns, and messages of each channel."""
    fields = _Fields(body, "statistics")
    messages = fields.number(8)
    fields.at = 22
    return messages, fields.number(4), fields.number(8), fields.number(8), fields.map()
