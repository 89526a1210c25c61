"""The start of a text gives its compression and encoding, and its size the approximate number of lines."""

import bz2
import gzip
import io
import lzma
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import BinaryIO, cast

import pytest

from imucal.errors import ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.tables.text_source import (
    CountedStream,
    TextSource,
    compression_of,
    find_encoding,
    open_text,
    read_fully,
)
from tests.raising import raises


def utf16(zeros: int, at: int) -> bytes:
    """Return a hundred bytes with `zeros` zeros at every second place from `at` on."""
    head = bytearray(b"a" * 100)
    head[at : at + 2 * zeros : 2] = bytes(zeros)
    return bytes(head)


@pytest.mark.parametrize(
    ("head", "encoding"),
    [
        (b"", "utf-8"),
        (b"gx,gy", "utf-8"),
        (b"\xef\xbb\xbfgx", "utf-8"),
        (b"\xff\xfeg\0", "utf-16-le"),
        (b"\xfe\xff\0g", "utf-16-be"),
        # More than three of ten bytes are zero, all at odd or all at even places.
        (utf16(31, 1), "utf-16-le"),
        (utf16(31, 0), "utf-16-be"),
        (utf16(30, 1), None),
        (utf16(30, 0), None),
        # A ratio of ten is not enough, eleven is.
        (utf16(40, 1)[:-2] + b"\0a", "utf-16-le"),
        (b"\0\0" * 4 + utf16(40, 1)[8:], None),
        (b"\0a" * 4 + b"a\0" * 40, None),
        (b"\0a" * 4 + b"a\0" * 41, "utf-16-le"),
        (b"a\0" * 4 + b"\0a" * 40, None),
        (b"a\0" * 4 + b"\0a" * 41, "utf-16-be"),
        # One control character in a hundred bytes may be damage.
        (b"\x01" + b"a" * 99, "utf-8"),
        (b"\x01\x02" + b"a" * 98, None),
        (b"\t\r\n\x1b" * 25, "utf-8"),
        # Zeros after a line, or one zero in a hundred bytes, may be damage too.
        (b"\0" + b"a" * 99, "utf-8"),
        (b"\0\0" + b"a" * 98, None),
        (b"a\n" + b"\0" * 2 + b"a" * 96, "utf-8"),
        (b"a" * 96 + b"\0" * 2 + b"a\n", None),
        # The head ends within a character, which is complete in the log.
        ("m/s²".encode()[:-1], "utf-8"),
        ("m/s² ".encode("latin-1"), "latin-1"),
    ],
)
def test_the_first_bytes_determine_the_encoding(head: bytes, encoding: str | None) -> None:
    """Evidence: a byte order mark, zeros at every second place, or invalid UTF-8. Binary data are refused."""
    if encoding is None:
        with raises(ReadError, "binary data, not text", place="log"):
            find_encoding(head, "log")
    else:
        assert find_encoding(head, "log") == encoding


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"\x1f\x8b", "gzip"),
        (b"\x1f", "none"),
        (b"\x28\xb5\x2f\xfd", "zstd"),
        (b"BZh9", "bzip2"),
        (b"\xfd7zXZ\x00", "xz"),
        (b"\x04\x22\x4d\x18", "lz4"),
        (b"", "none"),
    ],
)
def test_the_first_bytes_determine_the_compression(start: bytes, kind: str) -> None:
    assert compression_of(start) == kind


class Drops(io.BytesIO):
    """A stream that returns at most two bytes at a time, like a slow pipe."""

    def read(self, size: int | None = -1) -> bytes:
        return super().read(2 if size is None or size < 0 else min(size, 2))


@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress, lzma.compress])
def test_a_slow_pipe_is_read_completely(pack: Callable[[bytes], bytes]) -> None:
    """The bytes that identify the compression are read again."""
    text = b"1,2\n" * 50
    assert read_fully(Drops(text), 3) == text[:3]
    assert read_fully(Drops(b"abc"), 9) == b"abc"
    source = TextSource("log", Drops(pack(text)))
    assert (source.head, source.findings) == (["1,2"] * 50, [])
    assert b"".join(source.blocks()) == text


def opened(data: bytes, size: int | None) -> TextSource:
    return TextSource("log", io.BytesIO(data), size=size)


@pytest.mark.parametrize(
    ("data", "size", "rows"),
    [
        # Lines have four bytes; five percent are added.
        (b"1,2\n" * 5, 400, 105),
        (b"1,2\n12345\n" * 5, 1000, 210),
        (b"1,2\n" * 5, None, 0),
        (gzip.compress(b"1,2\n" * 5, mtime=0), 400, 0),
        (b"1,2", 400, 105),
        (b"", 400, 0),
    ],
)
def test_the_expected_number_of_lines_is_the_size_divided_by_their_length(
    data: bytes, size: int | None, rows: int
) -> None:
    """The number is unknown if the size or the length of a line is unknown."""
    assert opened(data, size).expected_rows == rows


@pytest.mark.parametrize(
    ("data", "head"),
    [
        (b"a\nb\n", ["a", "b"]),
        (b"a\nb", ["a", "b"]),
        (b"a\nb\nc", ["a", "b", "c"]),
        (b"a\nb\nc\nd", ["a", "b", "c"]),
        (b"a\r\nb\r\n", ["a", "b"]),
        (b"a\rb\r", ["a", "b"]),
        (b"a\n\0b\n", ["a", "b"]),
        (b"\xef\xbb\xbfa\n", ["a"]),
    ],
)
def test_the_head_has_the_first_lines_without_line_ends(data: bytes, head: list[str]) -> None:
    """If there are more than three lines, the last one may be cut and is omitted."""
    source = opened(data, None)
    assert (source.head, source.whole) == (head, True)


@pytest.mark.parametrize(
    "data", [b"a\nb\nc\nd", b"\xef\xbb\xbfa\nb\nc\nd", b"a\r\nb\r\nc\r\nd", b"a\rb\rc\rd"]
)
def test_blocks_contain_the_complete_text(data: bytes, tmp_path: Path) -> None:
    """The byte order mark is removed and line ends become line feeds, in files and streams."""
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    with open_text(path) as source:
        assert b"".join(source.blocks()) == b"a\nb\nc\nd"
    assert b"".join(opened(data, None).blocks()) == b"a\nb\nc\nd"


LINES = b"t,gx,gy,gz\n" + b"".join(b"%d,1,2,3\n" % i for i in range(100))
#: 1.4 MB of repeated rows, several times as much as a text may unpack to.
REPEATED = b"100,1,2,3\n" * 140_000


@pytest.mark.parametrize("pack", [bz2.compress, lzma.compress])
@pytest.mark.parametrize("counted", [False, True])
def test_a_text_that_unpacks_to_gigabytes_is_refused(
    pack: Callable[[bytes], bytes],
    counted: bool,  # noqa: FBT001
) -> None:
    """Streams in a row unpack to 1.4 GB; the limit applies to a file, and to bytes of standard input."""
    data = pack(LINES) + 1000 * pack(REPEATED)
    raw = io.BytesIO(data)
    stream = cast("BinaryIO", CountedStream(raw)) if counted else raw
    source = TextSource("log", stream, size=None if counted else len(data))
    with pytest.raises(ReadError, match=r"^log: the (xz|bzip2) stream unpacks to more than \d+ bytes; "):
        deque(source.blocks(), maxlen=0)
    assert source.passed < 100e6


def test_a_compressed_text_of_usual_ratio_is_read_completely() -> None:
    """The limit does not apply to 64 MiB or less, nor below a ratio of 100."""
    data = gzip.compress(LINES + 4 * REPEATED)
    source = TextSource("log", io.BytesIO(data), size=len(data))
    assert sum(map(len, source.blocks())) == len(LINES) + 4 * len(REPEATED)


ROWS = "t (s),gx (rad/s),gy,gz\n" + "".join(f"{k / 100},{k % 7},{k % 5},{k % 3}\n" for k in range(5000))
_PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "none": bytes,
    "gzip": partial(gzip.compress, compresslevel=1),
    "xz": partial(lzma.compress, preset=0),
}


@pytest.mark.parametrize(
    ("compression", "line"),
    [
        ("none", ""),
        ("gzip", ""),
        ("xz", ""),
        ("gzip", "# nothing-but-a-comment" * 40),
        ("none", "no numbers" * 99),
    ],
)
def test_a_long_text_without_rows_ends_the_reading(tmp_path: Path, compression: str, line: str) -> None:
    """The error has the place, a line from there, and a command that keeps the rows."""
    path = tmp_path / "log.csv"
    # The first block of 4 MiB contains the rows.
    junk = (line + "\n") * ((13 << 20) // (len(line) + 1))
    path.write_bytes(_PACKERS[compression](f"{ROWS}{junk}".encode()))
    with pytest.raises(ReadError) as error:
        read(path, ReadOptions())
    message = str(error.value)
    count = int(message.partition("below line ")[2].partition(",")[0])
    assert count >= ROWS.count("\n")
    assert f" MiB have no row of 4 numbers, such as {line[:60]!r}; expected a row per sample; " in message
    assert message.endswith(f"head -n {count} {path} > log.csv" if compression == "none" else "> log.csv")


def test_a_compressed_text_of_one_repeated_row_ends_the_reading(tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    row = "50.0,1.2500000,2.5000000,3.500000\n"
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(ROWS.encode())
        for _ in range(48):
            file.write((row * ((1 << 20) // len(row))).encode())
    with raises(ReadError, "MiB repeat the line '50.0,1.25", place="log.csv.gz"):
        read(path, ReadOptions())


def test_lines_without_numbers_between_the_rows_of_a_long_text_are_no_obstacle(tmp_path: Path) -> None:
    """Each block of 4 MiB has rows."""
    path = tmp_path / "log.csv.gz"
    header, *rows = ROWS.splitlines()
    comments = ("#" * 99 + "\n") * 45_000
    middle = len(rows) // 2
    text = "\n".join([header, *rows[:middle], comments, *rows[middle:], comments])
    path.write_bytes(gzip.compress(text.encode(), compresslevel=1))
    assert read(path, ReadOptions()).series[0].n == len(rows)
