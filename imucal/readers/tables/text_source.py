"""Text of a log in blocks of complete lines: any encoding, plain or compressed, file or standard input.

Blocks are UTF-8 (or Latin-1) bytes with line feeds, and few are in memory.
"""

import bz2
import codecs
import gzip
import hashlib
import lzma
import shlex
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from importlib import import_module
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, cast

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.compression import most_unpacked
from imucal.readers.files import refused, refusing, require_file
from imucal.readers.foreign import LOGGERS, TEXTS, advice_on
from imucal.readers.read_options import Progress
from imucal.recording import LogFileInfo

STANDARD_INPUT = "-"

_MAGIC: dict[bytes, str] = {
    b"\x1f\x8b": "gzip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"BZh": "bzip2",
    b"\xfd7zXZ\x00": "xz",
    b"\x04\x22\x4d\x18": "lz4",
}
_MAX_MAGIC = max(map(len, _MAGIC))

_MARKS: dict[bytes, str] = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}

#: Control characters; crashes leave zeros in text.
_CONTROLS = bytes((*range(1, 9), *range(14, 27), *range(28, 32)))

#: Bytes examined to find the layout.
_HEAD = 1 << 18
#: Large for the parser's speed, small for memory, in bytes.
_BLOCK = 4 << 20
#: Fewest lines of a table in the head.
_MIN_LINES = 3
#: More cells on fewer lines are too long rows.
_MAX_CELLS = 1000
#: Longest row of a table, in bytes.
_MAX_LINE = 1 << 20
#: Bytes of a zstd stream unpacked at once: 4 bytes may expand to 128 KiB.
_PIECE = 1 << 12

#: Programs that unpack a compressed text.
_UNPACKERS = {"gzip": "gunzip", "zstd": "unzstd", "bzip2": "bunzip2", "xz": "unxz", "lz4": "unlz4"}

#: Errors of a truncated or damaged stream, and packages with their own error classes.
_DAMAGE = (EOFError, OSError, zlib.error, lzma.LZMAError, ValueError, RuntimeError)
_PACKAGES = {"zstandard", "lz4", "backports"}


def compression_of(start: bytes) -> str:
    """Return the compression of a file from its first bytes, or ``none``."""
    return next((kind for magic, kind in _MAGIC.items() if start.startswith(magic)), "none")


def utf16_order(head: bytes) -> str | None:
    """Return the encoding of UTF-16 without a byte order mark; None for other text."""
    even, odd = head[0::2].count(0), head[1::2].count(0)
    if even + odd <= 0.3 * len(head):
        return None
    if odd > 10 * even:
        return "utf-16-le"
    return "utf-16-be" if even > 10 * odd else None


def find_encoding(head: bytes, name: str) -> str:
    """Return the encoding of a text from its first bytes; raises ReadError for binary data."""
    marked = next((encoding for mark, encoding in _MARKS.items() if head.startswith(mark)), None)
    encoding = marked or utf16_order(head)
    if encoding is not None:
        return encoding
    controls = len(head) - len(head.translate(None, _CONTROLS))
    hollow = head.count(0) > 0.01 * len(head) and b"\n" not in head[: head.find(b"\0")]
    if controls > 0.01 * len(head) or hollow:
        raise refused(name, "binary data, not text; expected a table of numbers, or another format")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def read_fully(raw: BinaryIO, size: int) -> bytes:
    """Read until `size` bytes or the end."""
    data = b""
    while len(data) < size and (piece := raw.read(size - len(data))):
        data += piece
    return data


class CountedStream:
    """A stream that can't be read again: counts and hashes the bytes."""

    def __init__(self, raw: BinaryIO) -> None:
        self._raw = raw
        self._machine = hashlib.blake2b()
        self.size = 0

    def read(self, size: int = -1) -> bytes:
        data = self._raw.read(size)
        self._machine.update(data)
        self.size += len(data)
        return data

    def close(self) -> None:
        self._raw.close()

    def checksum(self) -> str:
        while self.read(1 << 20):
            pass
        return self._machine.hexdigest()


class _Joined:
    """A stream with bytes already read put back."""

    def __init__(self, start: bytes, rest: BinaryIO) -> None:
        self._start = start
        self._rest = rest

    def read(self, size: int) -> bytes:
        data, self._start = self._start[:size], self._start[size:]
        return data or self._rest.read(size)


class _Zstd:
    """The text of zstd frames; unlike the package's reader, it detects a truncated frame."""

    def __init__(self, raw: BinaryIO) -> None:
        import zstandard

        self._new = zstandard.ZstdDecompressor().decompressobj
        self._frame = self._new()
        self._begun = False
        self._raw = raw
        self._packed = self._held = b""

    def read(self, size: int) -> bytes:
        """Return unpacked bytes; raises EOFError if the last frame is truncated."""
        while not self._held:
            packed = self._packed or self._raw.read(_PIECE)
            if not packed:
                if self._begun:
                    raise EOFError("compressed file ended within a frame")
                return b""
            self._held = self._frame.decompress(packed)
            self._begun, self._packed = not self._frame.eof, b""
            if self._frame.eof:
                self._packed = self._frame.unused_data
                self._frame = self._new()
        piece, self._held = self._held[:size], self._held[size:]
        return piece


_OPENERS: dict[str, Callable[[BinaryIO], Any]] = {
    "gzip": lambda raw: gzip.GzipFile(fileobj=raw, mode="rb"),
    "bzip2": bz2.BZ2File,
    "xz": lzma.LZMAFile,
    "zstd": _Zstd,
    "lz4": lambda raw: import_module("lz4.frame").LZ4FrameFile(raw, "rb"),
}


class LongerError(Exception):
    """A text exceeds the requested length. Caught within the readers."""


class TextSource(AbstractContextManager["TextSource"]):
    """An open log of lines.

    `head` contains the first complete lines; `whole` is true if they are the entire log. `size` is in bytes,
    None if unknown; `passed` counts the unpacked bytes so far. `packed` is the size of the file that contains
    a compressed text, in bytes; if it is unknown, the bytes read so far limit the unpacked size.
    """

    def __init__(
        self,
        name: str,
        raw: BinaryIO,
        *,
        size: int | None = None,
        packed: int | None = None,
        progress: Progress | None = None,
        most: int | None = None,
    ) -> None:
        self.name, self.size, self.passed = name, size, 0
        self._packed = size if packed is None else packed
        self._unpacked = 0
        self.findings: list[Finding] = []
        self._raw, self._progress, self._most = raw, progress, most
        self._ended = False
        start = read_fully(raw, _MAX_MAGIC)
        self.compression = compression_of(start)
        plain = self.compression == "none"
        stream = raw if plain else _OPENERS[self.compression](cast("BinaryIO", _Joined(start, raw)))
        # `read1` does not wait for more data, so text before a damage is kept.
        self._take: Callable[[int], bytes] = stream.read if plain else getattr(stream, "read1", stream.read)
        head = start + self._read(_HEAD - len(start)) if plain else self._read(_HEAD)
        self.whole = self._ended
        try:
            self.encoding = find_encoding(head, name)
        except ReadError as error:
            if plain:
                raise
            raise refused(
                name, f"{self.compression} of binary data; unpack it, and give the log in it"
            ) from error
        wide = self.encoding.startswith("utf-16")
        self._decode = codecs.getincrementaldecoder(self.encoding)("replace") if wide else None
        text = head.removeprefix(codecs.BOM_UTF8)
        text = self._plain(text)
        self._return_only = b"\r" in text and b"\n" not in text
        self._start = self._line_ends(text)
        lines = self._start.decode("latin-1" if self.encoding == "latin-1" else "utf-8", "replace")
        self.head = [line.rstrip("\r") for line in lines.replace("\x00", "").split("\n")]
        # The last line is empty or incomplete.
        if not self.whole or not self.head[-1] or len(self.head) > 3:
            self.head.pop()

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        self._raw.close()

    @property
    def expected_rows(self) -> int:
        """Number of lines, slightly too high; 0 for compressed or unknown sizes."""
        if self.size is None or self.compression != "none" or not self.head:
            return 0
        length = sum(map(len, self.head)) / len(self.head) + 1
        return int(1.05 * self.size / length)

    def why_no_lines(self) -> str:
        """Return why the head contains too few lines, and the next step."""
        counts = {mark: self._start.count(mark.encode()) for mark in (",", ";", "\t", " ")}
        mark, cells = max(counts.items(), key=itemgetter(1))
        advice = advice_on(self._start, (*TEXTS, *LOGGERS))
        if self.whole or cells < _MAX_CELLS or advice:
            found = "is empty" if self.whole else "has too few line ends in its first 256 KiB"
            found = f"{found} ({self.findings[0].text})" if self.findings else found
            return f"the text {found}; {advice or 'expected a table of numbers'}"
        cut = f"cut -d '{mark}' -f 1-7" if mark != "\t" else "cut -f 1-7"
        return (
            f"its first lines are longer than 256 KiB, or at least {cells} columns; expected the few "
            f"columns of an IMU; write those to another file, the first seven with {cut} "
            f"{shlex.quote(self.name)} > imu.csv"
        )

    def keep_lines(self, count: int) -> str:
        """Return how to write the first lines to another file."""
        if not Path(self.name).is_file():
            return f"keep its first {count} lines"
        path = shlex.quote(self.name)
        if self.compression == "none":
            return f"keep its first {count} lines, with head -n {count} {path} > log.csv"
        command = f"{_UNPACKERS[self.compression]} -c {path} | head -n {count} > log.csv"
        return f"keep its first {count} lines, with {command}"

    def files(self) -> tuple[LogFileInfo, ...]:
        """Return size and checksum of standard input; empty for a file, which can be read again."""
        if not isinstance(self._raw, CountedStream):
            return ()
        checksum = self._raw.checksum()
        return (LogFileInfo(path=self.name, size_bytes=self._raw.size, blake2b=checksum),)

    def blocks(self) -> Iterator[bytes]:
        """Yield all text in blocks of whole lines; the last line may lack its line feed.

        Raises ReadError if a line is too long.
        """
        rest, self._start = self._start, b""
        while True:
            data = b"" if self._ended else self._line_ends(self._plain(self._read(_BLOCK)))
            cut = len(data) if self._ended else data.rfind(b"\n") + 1
            block = b"".join((rest, memoryview(data)[:cut])) if cut or self._ended else b""
            rest = data[cut:] if block or not rest else rest + data
            if len(rest) > _MAX_LINE:
                text = f"a line of more than {_MAX_LINE} bytes; expected rows of a table"
                raise refused(self.name, text)
            if self._progress is not None and self.size:
                # A pipe has no size.
                self._progress(min(self._raw.tell(), self.size), self.size)
            self.passed += len(block)
            if self._most is not None and self.passed > self._most:
                raise LongerError
            if block:
                yield block
            if self._ended:
                return

    def _read(self, size: int) -> bytes:
        """Return up to `size` unpacked bytes; a damaged stream ends with a finding."""
        pieces: list[bytes] = []
        missing = max(size, 1)
        try:
            while missing > 0 and not self._ended:
                pieces.append(self._take(missing))
                missing -= len(pieces[-1])
                self._ended = not pieces[-1]
                self._unpacked += len(pieces[-1])
                if self.compression != "none":
                    self._require_plausible()
        except ReadError:
            raise
        except Exception as error:
            if not isinstance(error, _DAMAGE) and type(error).__module__.partition(".")[0] not in _PACKAGES:
                raise
            self._ended = True
            found = f"The {self.compression} stream is cut off or damaged ({error})"
            text = f"{found}; the part that could be unpacked was read."
            self.findings.append(Finding("warning", "truncated", text))
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def _require_plausible(self) -> None:
        """Raise ReadError if the text unpacks to more than recordings do."""
        packed = self._packed
        if packed is None and isinstance(self._raw, CountedStream):
            packed = self._raw.size
        if packed is None or self._unpacked <= most_unpacked(packed):
            return
        found = f"the {self.compression} stream unpacks to more than {most_unpacked(packed)} bytes"
        way = f"no recording is compressed so much, look at it with {_UNPACKERS[self.compression]}"
        raise refused(self.name, f"{found}; {way}")

    def _plain(self, data: bytes) -> bytes:
        """Convert UTF-16 to UTF-8; other encodings have the same digits."""
        if self._decode is None:
            return data
        text = self._decode.decode(data, final=self._ended)
        return text.removeprefix("\ufeff").encode("utf-8", "replace")

    def _line_ends(self, data: bytes) -> bytes:
        if b"\r" not in data:
            return data
        return data.replace(b"\r", b"\n") if self._return_only else data.replace(b"\r\n", b"\n")


def open_text(path: Path, *, progress: Progress | None = None, most: int | None = None) -> TextSource:
    """Open a text log; ``-`` is standard input.

    Raises ReadError if it can't be opened, is empty, or is not text; `blocks` raises LongerError after `most`
    unpacked bytes.
    """
    if str(path) == STANDARD_INPUT:
        source = TextSource("standard input", cast("BinaryIO", CountedStream(sys.stdin.buffer)))
    else:
        require_file(path)
        with ExitStack() as opened:
            with refusing(path, "can't be opened"):
                # Unbuffered, because blocks are large.
                raw = cast("BinaryIO", opened.enter_context(path.open("rb", buffering=0)))
                size = path.stat().st_size
            source = TextSource(str(path), raw, size=size, progress=progress, most=most)
            opened.pop_all()
    lines = [line for line in source.head if line.strip()]
    if not lines or (len(lines) < _MIN_LINES and not source.whole):
        source.close()
        raise refused(source.name, source.why_no_lines())
    return source
