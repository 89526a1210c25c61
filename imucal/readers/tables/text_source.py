"""Text of a log in blocks of whole lines: plain or compressed, a file or standard input, in any encoding.

Blocks are bytes of UTF-8 with line feeds. A log compressed a hundredfold takes no more memory than its
blocks, and one cut in the middle gives what is whole.

Streams behind a text log: unpacked by their first bytes, and their encoding.
"""

import bz2
import codecs
import gzip
import hashlib
import io
import lzma
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self, cast

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.read_options import Progress
from imucal.recording import LogFileInfo

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


#: The path that means standard input.
STANDARD_INPUT = "-"

#: Bytes looked at to find the layout.
_HEAD = 1 << 18
#: Bytes of text parsed at once: large enough for the parser, small enough for memory.
_BLOCK = 2 << 20
#: Bytes before the end of a block in which its last line is looked for first.
_TAIL = 1 << 12
#: Errors of a stream that is cut or damaged.
_DAMAGE = (EOFError, OSError, zlib.error, lzma.LZMAError, ValueError, RuntimeError)
#: A line longer than this is no row of a table.
_LONGEST_LINE = 1 << 20


class LongerError(Exception):
    """A text is longer than was wanted of it. Never leaves the readers."""


class TextSource:
    """A log of lines, opened.

    Attributes
    ----------
    name
        As the user named it.
    compression
        ``none``, ``gzip``, ``zstd``, ``bzip2``, ``xz`` or ``lz4``.
    encoding
        ``utf-8``, ``utf-16-le``, ``utf-16-be`` or ``latin-1``.
    head
        The first lines, decoded, without their ends; a line that the head cuts is left out.
    whole
        Whether `head` is all of the log.
    findings
        What reading it has shown so far: a cut end.
    passed
        Bytes of unpacked text that were given out as blocks.
    """

    def __init__(
        self,
        name: str,
        raw: BinaryIO,
        *,
        size: int | None,
        progress: Progress | None,
        most: int | None = None,
    ) -> None:
        self.name = name
        self.size = size
        self.passed = 0
        self._most = most
        self.findings: list[Finding] = []
        self._raw = raw
        self._progress = progress
        start = read_fully(raw, 6)
        self.compression = compression_of(start)
        stream = unpacked(start, raw, self.compression)
        # What was unpacked before a damage is kept only by reads that never wait for more.
        self._take: Callable[[int], bytes] = getattr(stream, "read1", stream.read)
        self._ended = False
        head = self._read(_HEAD)
        self.whole = self._ended
        self.encoding = find_encoding(head, name)
        self._decode = (
            None if self.encoding in {"utf-8", "latin-1"} else codecs.getincrementaldecoder(self.encoding)()
        )
        marked = head.startswith(codecs.BOM_UTF8)
        head = self._plain(head.removeprefix(codecs.BOM_UTF8))
        # Where the text of `_start` begins in a plain file, whose blocks can be read one by one.
        exact = (
            self.compression == "none"
            and self._decode is None
            and b"\r" not in head
            and isinstance(raw, io.FileIO)
        )
        self._exact = (len(codecs.BOM_UTF8) if marked else 0) if exact else None
        self._return_only = b"\r" in head and b"\n" not in head
        self._start = self._line_ends(head)
        self.head = self._head_lines(self._start)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._raw.close()

    @property
    def expected_rows(self) -> int:
        """About how many lines a plain file has, a little more than fewer; 0 where its size says nothing."""
        if self.size is None or self.compression != "none" or not self.head:
            return 0
        length = sum(map(len, self.head)) / len(self.head) + 1
        return int(1.05 * self.size / length)

    def files(self) -> tuple[LogFileInfo, ...]:
        """Return size and checksum of standard input, which nobody can read again; nothing of a file."""
        if not isinstance(self._raw, CountedStream):
            return ()
        checksum = self._raw.checksum()
        return (LogFileInfo(path=self.name, size_bytes=self._raw.size, blake2b=checksum),)

    def blocks(self) -> Iterator[bytes]:
        """Yield all text, in blocks of whole lines; the last line may lack its end.

        Raises
        ------
        ReadError
            If a line is longer than any row of a table.
        """
        rest, self._start = self._start, b""
        if self._exact is not None and not self._ended:
            yield from self._exact_blocks(rest)
            return
        while True:
            data = b"" if self._ended else self._line_ends(self._plain(self._read(_BLOCK)))
            cut = len(data) if self._ended else data.rfind(b"\n") + 1
            # One copy: the block is the rest of the one before and the whole lines of this one.
            block = b"".join((rest, memoryview(data)[:cut])) if cut or self._ended else b""
            rest = data[cut:] if block or not rest else rest + data
            if len(rest) > _LONGEST_LINE:
                raise self._too_long()
            self._report()
            if block:
                yield self._counted(block)
            if self._ended:
                return

    def _exact_blocks(self, head: bytes) -> Iterator[bytes]:
        """Yield the blocks of a plain file, each read where it ends: nothing is copied to join them."""
        cut = head.rfind(b"\n") + 1
        place = (self._exact or 0) + cut
        if cut:
            yield self._counted(head[:cut])
        size = self._raw.seek(0, io.SEEK_END)
        while place < size:
            stop = min(place + _BLOCK, size)
            if stop < size:
                stop = self._line_end(place, stop)
            self._raw.seek(place)
            block = read_fully(self._raw, stop - place)
            if not block:
                return
            place += len(block)
            self._report()
            yield self._counted(self._line_ends(block))

    def _counted(self, block: bytes) -> bytes:
        """Count a block; refuse it where the text is longer than wanted."""
        self.passed += len(block)
        if self._most is not None and self.passed > self._most:
            raise LongerError
        return block

    def _line_end(self, start: int, stop: int) -> int:
        """Return the end of the last line that ends between two places."""
        back = _TAIL
        while True:
            first = max(start, stop - back)
            self._raw.seek(first)
            end = read_fully(self._raw, stop - first).rfind(b"\n")
            if end >= 0:
                return first + end + 1
            if first == start or back > _LONGEST_LINE:
                raise self._too_long()
            back *= 16

    def _too_long(self) -> ReadError:
        msg = f"{self.name}: a line of more than {_LONGEST_LINE} bytes; expected rows of a table"
        return ReadError(msg)

    def _read(self, size: int) -> bytes:
        """Return up to `size` bytes of the unpacked stream; a cut stream ends, with a finding."""
        pieces: list[bytes] = []
        missing = max(size, 1)
        try:
            while missing > 0:
                piece = self._take(missing)
                if not piece:
                    self._ended = True
                    break
                pieces.append(piece)
                missing -= len(piece)
        except Exception as error:
            # zstandard and lz4 have error classes of their own; anything else is a bug and goes on.
            package = type(error).__module__.partition(".")[0]
            if not isinstance(error, _DAMAGE) and package not in {"zstandard", "lz4", "backports"}:
                raise
            self._ended = True
            text = (
                f"The {self.compression} stream is cut or damaged ({error}); what could be unpacked was read."
            )
            self.findings.append(Finding(level="warning", code="truncated", text=text))
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def _plain(self, data: bytes) -> bytes:
        """Return bytes as UTF-8 where they are UTF-16; all other encodings share the digits."""
        if self._decode is None:
            return data
        text = self._decode.decode(data, final=self._ended)
        return text.removeprefix("\ufeff").encode("utf-8", "replace")

    def _line_ends(self, data: bytes) -> bytes:
        if b"\r" not in data:
            return data
        return data.replace(b"\r", b"\n") if self._return_only else data.replace(b"\r\n", b"\n")

    def _head_lines(self, data: bytes) -> list[str]:
        text = data.decode("latin-1" if self.encoding == "latin-1" else "utf-8", "replace")
        lines = text.replace("\x00", "").split("\n")
        # The last piece is cut by the head or by the end of the log, or empty.
        if not self.whole or not lines[-1] or len(lines) > 3:
            lines.pop()
        return [line.rstrip("\r") for line in lines]

    def _report(self) -> None:
        if self._progress is not None and self.size:
            try:
                done = self._raw.tell()
            except (OSError, ValueError):
                return
            self._progress(min(done, self.size), self.size)


def open_text(path: Path, *, progress: Progress | None = None, most: int | None = None) -> TextSource:
    """Open a text log; ``-`` is standard input.

    Of a text that is longer than `most` bytes, unpacked, its blocks raise a LongerError.

    Raises
    ------
    ReadError
        If the file can't be opened, is empty, or is not text.
    """
    if str(path) == STANDARD_INPUT:
        stream = cast("BinaryIO", CountedStream(sys.stdin.buffer))
        source = TextSource("standard input", stream, size=None, progress=None)
    else:
        try:
            # Unbuffered: the blocks are the buffer.
            raw = cast("BinaryIO", path.open("rb", buffering=0))
            size = path.stat().st_size
        except OSError as error:
            msg = f"{path}: can't be opened: {error.strerror or error}"
            raise ReadError(msg) from error
        try:
            source = TextSource(str(path), raw, size=size, progress=progress, most=most)
        except BaseException:
            raw.close()
            raise
    if not any(line.strip() for line in source.head):
        found = "is empty" if source.whole else "has no line end in its first 256 KiB"
        found = f"{found} ({source.findings[0].text})" if source.findings else found
        source.close()
        msg = f"{source.name}: the text {found}; expected a table of numbers"
        raise ReadError(msg)
    return source
