"""Records of a ROS 1 bag, built byte by byte, so that tests can damage them on purpose."""

import struct
from collections.abc import Mapping

__all__ = [
    "MAGIC",
    "bag_head",
    "chunk",
    "chunk_info",
    "connection",
    "index",
    "message",
    "record",
    "stamp",
    "text",
]

MAGIC = b"#ROSBAG V2.0\n"


def text(value: bytes) -> bytes:
    """Return bytes after their length."""
    return struct.pack("<I", len(value)) + value


def _number(value: int, size: int = 4) -> bytes:
    return value.to_bytes(size, "little")


def stamp(time: int) -> bytes:
    """Return a time in ns in the format of a bag."""
    return struct.pack("<II", *divmod(time, 10**9))


def record(opcode: int, fields: Mapping[bytes, bytes], data: bytes = b"") -> bytes:
    """Return a record."""
    head = {b"op": bytes([opcode]), **fields}
    return text(b"".join(text(name + b"=" + value) for name, value in head.items())) + text(data)


def message(key: int, time: int, data: bytes = b"") -> bytes:
    """Return a message."""
    return record(2, {b"conn": _number(key), b"time": stamp(time)}, data)


def connection(key: int, topic: bytes = b"/imu", kind: bytes = b"a/B") -> bytes:
    """Return a connection."""
    data = text(b"type=" + kind) + text(b"message_definition=int8 x")
    return record(7, {b"conn": _number(key), b"topic": topic}, data)


def chunk(raw: bytes, compression: bytes = b"none", size: int | None = None) -> bytes:
    """Return a chunk with some bytes and a declared size."""
    stated = _number(len(raw) if size is None else size)
    return record(5, {b"compression": compression, b"size": stated}, raw)


def index(key: int, *entries: tuple[int, int], count: int | None = None) -> bytes:
    """Return an index record of times and offsets in the previous chunk."""
    data = b"".join(stamp(time) + _number(at) for time, at in entries)
    stated = _number(len(entries) if count is None else count)
    return record(4, {b"ver": _number(1), b"conn": _number(key), b"count": stated}, data)


def chunk_info(at: int, counts: Mapping[int, int], first: int = 0, last: int = 0) -> bytes:
    """Return a chunk record of the index section."""
    data = b"".join(_number(key) + _number(count) for key, count in counts.items())
    fields = {b"ver": _number(1), b"chunk_pos": _number(at, 8), b"count": _number(len(counts))}
    times = {b"start_time": stamp(first), b"end_time": stamp(last)}
    return record(6, fields | times, data)


def bag_head(index_at: int, connections: int = 0, chunks: int = 0, **more: bytes) -> bytes:
    """Return the first record of a bag: the offset of its index section and its counts."""
    fields = {b"index_pos": _number(index_at, 8), b"conn_count": _number(connections)}
    others = {name.encode(): value for name, value in more.items()}
    return record(3, fields | {b"chunk_count": _number(chunks)} | others, b" " * 10)
