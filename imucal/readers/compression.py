"""Decompress chunks and files, zstd, lz4 and bz2, and compress chunks for ROS 1.

Sizes in damaged or hostile files are checked before memory is allocated.
"""

import bz2
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import IO

from imucal.readers.files import DamagedError, damaged_if, refused

try:
    from zlib_ng.zlib_ng import crc32
except ImportError:  # no wheel for this processor
    from zlib import crc32

__all__ = [
    "KINDS",
    "check_crc",
    "crc32",
    "decompress",
    "keep_freed_memory",
    "lz4_for_ros1",
    "most_unpacked",
    "unpack_file",
]

#: Smaller sizes, in bytes, are not checked.
_SMALL = 1 << 26
#: Largest ratio of larger chunks.
_MAX_RATIO = 400
#: Largest ratio of larger files: a recording is compressed to a tenth, one of constant samples to a fiftieth.
_MAX_FILE_RATIO = 100

#: Longest head of a zstd frame, in bytes.
_ZSTD_HEAD = 18

#: Signature of an lz4 frame.
_LZ4 = b"\x04\x22\x4d\x18"

#: Compression names; MCAP writes "" and ROS bags write "none".
KINDS = ("", "none", "zstd", "lz4", "bz2")


def most_unpacked(packed: int) -> int:
    """Return the largest plausible size of a file of `packed` bytes after unpacking, in bytes."""
    return max(_SMALL, _MAX_FILE_RATIO * packed)


def lz4_for_ros1(data: bytes) -> bytes:
    """Return an lz4 frame that ROS 1 reads: without its size, of independent blocks, with a checksum.

    Source: ros_comm, ``roslz4/src/lz4s.c``, which refuses all other frames.
    """
    import lz4.frame

    packed: bytes = lz4.frame.compress(data, store_size=False, block_linked=False, content_checksum=True)
    return packed


@cache
def keep_freed_memory() -> None:
    """Make glibc keep freed chunk buffers instead of returning each one to the system, once per process.

    Freeing a block of 31 MiB raises glibc's thresholds. Otherwise page faults take six times as long as
    decompressing lz4.
    """
    # `bytes` of zeros take no pages; a bytearray would.
    del_me = bytes(31 << 20)
    del del_me


def decompress(kind: str, data: memoryview, size: int) -> memoryview:
    """Return the `size` bytes of decompressed data.

    Raises DamagedError if the data are damaged, have a different size, or claim an impossible one.
    """
    if kind in {"", "none"}:
        damaged_if(len(data) != size, f"a chunk of {len(data)} bytes has a declared size of {size}")
        return data
    damaged_if(
        size > max(_SMALL, _MAX_RATIO * len(data)),
        f"a chunk of {len(data)} bytes has a declared content of {size}",
    )
    damaged_if(
        kind not in _UNPACK,
        f"compression {kind!r} is unknown; expected one of zstd, lz4, bz2",
        "compression",
    )
    try:
        raw = _UNPACK[kind](data, size)
    except _damage() as error:
        raise DamagedError(f"{'an' if kind == 'lz4' else 'a'} {kind} chunk is damaged: {error}") from error
    damaged_if(len(raw) != size, f"a chunk contains {len(raw)} bytes; its header declares {size}")
    return memoryview(raw)


def _damage() -> tuple[type[Exception], ...]:
    import zstandard

    return ValueError, OSError, EOFError, RuntimeError, MemoryError, zstandard.ZstdError


def check_crc(raw: memoryview, expected: int) -> None:
    """Compare a CRC-32; 0 means that none was stored."""
    damaged_if(expected and crc32(raw) != expected, "a chunk's checksum does not match its content", "crc")


def unpack_file(source: Path, target: IO[bytes], progress: Callable[[int], None]) -> None:
    """Decompress a zstd file into an open file; calls `progress` with the number of bytes read.

    Raises DamagedError if the file is damaged; the part before the damage is written. Raises ReadError if it
    unpacks to more than recordings do.
    """
    import zstandard

    size = source.stat().st_size
    most, written = most_unpacked(size), 0
    with source.open("rb") as file:
        head = file.read(_ZSTD_HEAD)
        file.seek(0)
        with zstandard.ZstdDecompressor().stream_reader(file) as reader:
            try:
                # The size is -1 if the head lacks it.
                _require_plausible(source, zstandard.frame_content_size(head), most)
                while block := reader.read(1 << 22):
                    written += len(block)
                    _require_plausible(source, written, most)
                    target.write(block)
                    progress(file.tell())
            except zstandard.ZstdError as error:
                raise DamagedError(f"the zstd stream is damaged: {error}") from error


def _require_plausible(source: Path, size: int, most: int) -> None:
    if size > most:
        found = f"it unpacks to more than {most} bytes"
        raise refused(
            source, f"{found}; no recording is compressed so much, unpack it yourself with `zstd -d`"
        )


def _unpack_zstd(data: memoryview, size: int) -> bytes:
    import zstandard

    stated = zstandard.frame_content_size(data)
    damaged_if(stated not in {-1, size}, f"a zstd frame states {stated} bytes, its chunk {size}")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def _unpack_lz4(data: memoryview, size: int) -> bytes:
    import lz4.frame

    # Bit 3 of the fifth byte: the header contains a size. Source: LZ4 frame format 1.6.
    has_size = data[:4] == _LZ4 and len(data) > 13 and data[4] & 8
    stated = int.from_bytes(data[6:14], "little") if has_size else 0
    damaged_if(stated > size, f"an lz4 frame states {stated} bytes, its chunk {size}")
    raw, used = lz4.frame.decompress(data, return_bytes_read=True)
    if used == len(data):
        return bytes(raw)
    # ROS bags may contain several frames in a row.
    joined = bytearray(raw)
    while used < len(data) and len(joined) < size:
        raw, more = lz4.frame.decompress(data[used:], return_bytes_read=True)
        used += more
        joined += raw
    return bytes(joined)


def _unpack_bz2(data: memoryview, size: int) -> bytes:
    machine = bz2.BZ2Decompressor()
    # One byte more, because the checksum is verified only at the end of the stream.
    raw = machine.decompress(data, max_length=size + 1)
    damaged_if(not machine.eof, "a bz2 chunk is longer than declared, or cut off")
    return raw


_UNPACK: dict[str, Callable[[memoryview, int], bytes]] = {
    "zstd": _unpack_zstd,
    "lz4": _unpack_lz4,
    "bz2": _unpack_bz2,
}
