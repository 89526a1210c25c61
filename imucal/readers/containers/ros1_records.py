"""The records of a ROS 1 bag, version 2.0: headers of name=value fields, then data.

Source: https://wiki.ros.org/Bags/Format/2.0. `rosbags` reads intact bags and is the witness in the tests; it
refuses unindexed and cut ones, and builds an object for each message when it opens a bag.
"""

import struct
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

from imucal.readers.containers.container import Bytes, Channel
from imucal.readers.files import DamagedError

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
U32 = struct.Struct("<I")
PAIR = struct.Struct("<II")
#: Longest header of a record; a connection's is its topic's length.
_MAX_HEADER = 1 << 20


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
