"""Rewrite a ROS 1 bag: the messages of some connections change, all other records stay byte for byte.

Chunks without such messages are copied as they are. Positions in the index are moved; the connections there
get a field that tells that the bag was corrected. Source: https://wiki.ros.org/Bags/Format/2.0.
"""

import bz2
from typing import BinaryIO

import numpy as np

from imucal.correction.job import MARK, AlreadyCorrectedError, Job
from imucal.readers.compression import lz4_for_ros1
from imucal.readers.containers.container import Batch
from imucal.readers.containers.ros1 import (
    BAG,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    MAGIC,
    MESSAGE,
    U32,
    Record,
    record,
    unpack,
    walk,
)
from imucal.readers.files import damaged_if

#: Start of the field with the position of the index in the header of a bag; the position has eight bytes.
_INDEX_POSITION = b"index_pos="
#: Start of the field with the position of a chunk in its entry of the index.
_CHUNK_POSITION = b"chunk_pos="
#: Bytes of a position.
_POSITION_SIZE = 8


def rewrite_ros1(source: BinaryIO, target: BinaryIO, job: Job) -> None:
    """Copy a bag with changed messages of some connections.

    `target` can seek. Raises DamagedError if the bag is damaged, or was not closed, and
    AlreadyCorrectedError.
    """
    damaged_if(source.read(len(MAGIC)) != MAGIC, "the file does not start as a ROS 1 bag")
    target.write(MAGIC)
    positions: dict[int, int] = {}
    header: tuple[int, bytes] | None = None
    index_at = 0
    read = len(MAGIC)
    while data := _next(source):
        entry = record(data, 0)
        opcode = entry.opcode
        written = target.tell()
        if opcode == BAG:
            header = written, data
            damaged_if(not entry.number(b"index_pos", 8), "the bag was not closed", "unindexed")
        elif opcode == CHUNK:
            positions[read] = written
            target.write(_changed_chunk(data, entry, job))
        elif opcode in {CONNECTION, CHUNK_INFO}:
            index_at = index_at or written
            if opcode == CONNECTION:
                if MARK.encode() in entry.fields:
                    raise AlreadyCorrectedError
                target.write(_marked(data, entry, job.mark))
            else:
                old = entry.number(b"chunk_pos", _POSITION_SIZE)
                damaged_if(old not in positions, "the index lists a chunk that is not there", "index")
                target.write(_moved(data, _CHUNK_POSITION, positions[old]))
        else:
            target.write(data)
        if opcode == BAG:
            target.write(data)
        read += len(data)
        job.progress(read)
    damaged_if(header is None or not index_at, "the bag has no index", "unindexed")
    if header is not None:
        target.seek(header[0])
        target.write(_moved(header[1], _INDEX_POSITION, index_at))


def _next(source: BinaryIO) -> bytes:
    """Return the next record; nothing at the end."""
    data = b""
    for _ in ("header", "data"):
        length = source.read(U32.size)
        if not length and not data:
            return b""
        damaged_if(len(length) < U32.size, "the bag is cut off", "truncated")
        (size,) = U32.unpack(length)
        part = source.read(size)
        damaged_if(len(part) < size, "the bag is cut off", "truncated")
        data += length + part
    return data


def _moved(data: bytes, name: bytes, position: int) -> bytes:
    """Return a record with a new position in a field of its header."""
    at = data.find(name) + len(name)
    damaged_if(at < len(name), "a record header is damaged")
    return data[:at] + position.to_bytes(_POSITION_SIZE, "little") + data[at + _POSITION_SIZE :]


def _marked(data: bytes, entry: Record, mark: str) -> bytes:
    """Return a connection record with the mark in its header."""
    field = f"{MARK}={mark}".encode()
    head = entry.head + U32.pack(len(field)) + field
    return U32.pack(len(head)) + head + data[U32.size + len(entry.head) :]


def _changed_chunk(data: bytes, entry: Record, job: Job) -> bytes:
    """Return a chunk with changed messages; the same bytes if it contains none of the connections."""
    raw = bytearray(unpack(memoryview(data)))
    places: dict[int, list[tuple[int, int, int]]] = {}
    for opcode, message in walk(raw):
        if opcode == MESSAGE and message.key in job.keys:
            place = message.start, message.end - message.start, message.time_ns(b"time")
            places.setdefault(message.key, []).append(place)
    if not places:
        return data
    for key, rows in places.items():
        starts, sizes, log_ns = np.array(rows, np.int64).T.copy()
        job.patch(key, Batch(raw, starts, sizes, log_ns))
    packed = _compressed(entry.text(b"compression", b"none"), bytes(raw))
    return data[: entry.start - U32.size] + U32.pack(len(packed)) + packed


def _compressed(kind: str, data: bytes) -> bytes:
    if kind == "lz4":
        return lz4_for_ros1(data)
    if kind == "bz2":
        return bz2.compress(data)
    damaged_if(kind != "none", f"the compression {kind} is unknown", "compression")
    return data
