"""Streams behind a text log: unpacked by their first bytes, and their encoding."""

import bz2
import codecs
import gzip
import hashlib
import io
import lzma
from collections.abc import Callable
from typing import BinaryIO, cast

from imucal.errors import ReadError

#: First bytes -> compression.
_MAGIC: dict[bytes, str] = {
    b"\x1f\x8b": "gzip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"BZh": "bzip2",
    b"\xfd7zXZ\x00": "xz",
    b"\x04\x22\x4d\x18": "lz4",
}

#: Bytes of a zstd stream unpacked at once; each may hold blocks of 128 KiB in 4 bytes.
_PIECE = 1 << 12

#: Bytes that no text holds; zeros are what a crash leaves in one.
_CONTROLS = bytes((*range(1, 9), *range(14, 27), *range(28, 32)))

_MARKS: tuple[tuple[bytes, str], ...] = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


def compression_of(start: bytes) -> str:
    """Return the compression that the first bytes of a file show; ``none`` where they show none."""
    return next((kind for magic, kind in _MAGIC.items() if start.startswith(magic)), "none")


def read_fully(raw: BinaryIO, size: int) -> bytes:
    """Read until there are as many bytes as asked for, or no more."""
    data = b""
    while len(data) < size:
        piece = raw.read(size - len(data))
        if not piece:
            break
        data += piece
    return data


def unpacked(start: bytes, raw: BinaryIO, compression: str) -> BinaryIO:
    """Return the stream of what a stream holds packed, its first bytes having been read."""
    joined = cast("BinaryIO", _Joined(start, raw))
    opener = _OPENERS.get(compression)
    return joined if opener is None else cast("BinaryIO", opener(joined))


class CountedStream:
    """A stream whose bytes are counted and hashed as they are read: it can't be read a second time."""

    def __init__(self, raw: BinaryIO) -> None:
        self._raw = raw
        self._machine = hashlib.blake2b()
        self.size = 0

    def read(self, size: int = -1) -> bytes:
        """Return up to `size` bytes, none at the end."""
        data = self._raw.read(size)
        self._machine.update(data)
        self.size += len(data)
        return data

    def close(self) -> None:
        """Close the stream."""
        self._raw.close()

    def checksum(self) -> str:
        """Return the BLAKE2b checksum of all of the stream; reads what is left of it."""
        while self.read(1 << 20):
            pass
        return self._machine.hexdigest()


class _Joined(io.RawIOBase):
    """A stream with the bytes already read put back in front."""

    def __init__(self, start: bytes, rest: BinaryIO) -> None:
        self._start = start
        self._rest = rest

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        if self._start:
            taken = self._start if size < 0 else self._start[:size]
            self._start = self._start[len(taken) :]
            return taken if size >= 0 else taken + self._rest.read()
        return self._rest.read(size)

    def readinto(self, buffer: object) -> int:
        view = memoryview(cast("bytearray", buffer)).cast("B")
        data = self.read(len(view))
        view[: len(data)] = data
        return len(data)


class _Zstd:
    """The text of zstd frames; unlike the package's own reader it tells a cut frame from a whole one."""

    def __init__(self, raw: BinaryIO) -> None:
        import zstandard

        self._new = zstandard.ZstdDecompressor().decompressobj
        self._frame = self._new()
        self._begun = False
        self._raw = raw
        self._packed = b""
        self._held = b""

    def read1(self, size: int) -> bytes:
        """Return up to `size` bytes, at least one before the end; an EOFError if the last frame is cut."""
        while not self._held:
            # Small pieces: a few bytes may unpack to a whole block.
            packed = self._packed or self._raw.read(_PIECE)
            if not packed:
                if self._begun:
                    msg = "compressed file ended within a frame"
                    raise EOFError(msg)
                return b""
            self._held = self._frame.decompress(packed)
            self._begun, self._packed = not self._frame.eof, b""
            if self._frame.eof:
                self._packed = self._frame.unused_data
                self._frame = self._new()
        piece, self._held = self._held[:size], self._held[size:]
        return piece

    #: One read gives what there is.
    read = read1


def _lz4(raw: BinaryIO) -> object:
    import lz4.frame

    return lz4.frame.LZ4FrameFile(raw, "rb")


_OPENERS: dict[str, Callable[[BinaryIO], object]] = {
    "gzip": lambda raw: gzip.GzipFile(fileobj=raw, mode="rb"),
    "bzip2": bz2.BZ2File,
    "xz": lzma.LZMAFile,
    "zstd": _Zstd,
    "lz4": _lz4,
}


def utf16_order(head: bytes) -> str | None:
    """Return the encoding of UTF-16 without a mark by its zeros, every second byte; None of anything else."""
    even, odd = head[0::2].count(0), head[1::2].count(0)
    if even + odd <= 0.3 * len(head):
        return None
    if odd > 10 * even:
        return "utf-16-le"
    return "utf-16-be" if even > 10 * odd else None


def find_encoding(head: bytes, name: str) -> str:
    """Return the encoding of a text from its first bytes; a ReadError if they are no text."""
    for mark, encoding in _MARKS:
        if head.startswith(mark):
            return encoding
    order = utf16_order(head)
    if order is not None:
        return order
    zeros = head.count(0)
    controls = len(head) - len(head.translate(None, _CONTROLS))
    hollow = zeros > 0.01 * len(head) and b"\n" not in head[: head.find(b"\0")]
    if controls > 0.01 * len(head) or hollow:
        msg = f"{name}: binary data, not text; expected a table of numbers, or another format"
        raise ReadError(msg)
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"
