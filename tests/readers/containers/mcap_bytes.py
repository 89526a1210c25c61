"""Records of an MCAP file, built byte by byte, so that tests can damage them on purpose."""

import struct

__all__ = ["channel", "chunk", "index", "message", "record", "schema", "text"]


def text(value: bytes) -> bytes:
    """Return a string after its length."""
    return struct.pack("<I", len(value)) + value


def record(opcode: int, body: bytes) -> bytes:
    """Return a record."""
    return struct.pack("<BQ", opcode, len(body)) + body


def schema(key: int, name: bytes = b"a/B") -> bytes:
    """Return a Schema record."""
    return record(3, struct.pack("<H", key) + text(name) + text(b"ros2msg") + text(b"int8 x"))


def channel(key: int, topic: bytes = b"/imu", of_schema: int = 1) -> bytes:
    """Return a Channel record without metadata."""
    return record(4, struct.pack("<HH", key, of_schema) + text(topic) + text(b"cdr") + text(b""))


def message(key: int, time: int, data: bytes = b"") -> bytes:
    """Return a Message record of 31 bytes plus its data."""
    return record(5, struct.pack("<HIQQ", key, 0, time, time) + data)


def chunk(raw: bytes) -> bytes:
    """Return a Chunk record without compression and checksum, of 49 bytes plus its content."""
    head = struct.pack("<QQQI", 0, 0, len(raw), 0) + text(b"")
    return record(6, head + struct.pack("<Q", len(raw)) + raw)


def index(key: int, *entries: tuple[int, int]) -> bytes:
    """Return a MessageIndex record of times and offsets in the chunk, of 15 bytes plus 16 per entry."""
    return record(7, struct.pack("<H", key) + text(b"".join(struct.pack("<QQ", *entry) for entry in entries)))
