"""Contradictions within Parquet files: checksums of pages, and numbers of rows and values."""

from pathlib import Path
from zlib import crc32

import numpy as np
import polars as pl
import pytest

from imucal.readers import read
from imucal.readers.tables.parquet_pages import damage_of

#: Types of the Thrift compact protocol.
I32, I64, TEXT, LIST, STRUCTURE = 5, 6, 8, 9, 12


def unsigned(value: int) -> bytes:
    """Return a number in groups of seven bits."""
    data = b""
    while value > 127:
        data += bytes((value & 127 | 128,))
        value >>= 7
    return data + bytes((value,))


def number(value: int) -> bytes:
    """Return a signed number: zigzag, in groups of seven bits."""
    return unsigned(value << 1 if value >= 0 else -2 * value - 1)


def field(step: int, kind: int, value: bytes) -> bytes:
    """Return a field whose number is larger by `step` than that of the one before."""
    return bytes((step << 4 | kind,)) + value


def text(value: bytes) -> bytes:
    return unsigned(len(value)) + value


def items(kind: int, *values: bytes) -> bytes:
    return bytes((len(values) << 4 | kind,)) + b"".join(values)


def write_parquet(path: Path, *, change: int = 0, rows: int = 50, counted: int = 50) -> Path:
    """Write a column of 50 numbers as one page with a checksum. Source: parquet.thrift.

    The checksum is larger by `change`; the footer counts `rows`, and the head of the page `counted` values.
    """
    values = np.arange(50, dtype="<f8").tobytes()
    checksum = (crc32(values) + change) & 0xFFFFFFFF
    signed = checksum - (1 << 32) if checksum >> 31 else checksum
    page_of_data = b"".join(field(1, I32, number(value)) for value in (counted, 0, 3, 3)) + b"\0"
    page = b"".join(field(1, I32, number(value)) for value in (0, len(values), len(values), signed))
    page += field(1, STRUCTURE, page_of_data) + b"\0" + values
    about = field(1, I32, number(5)) + field(1, LIST, items(I32, number(0)))
    about += field(1, LIST, items(TEXT, text(b"gyro_x"))) + field(1, I32, number(0))
    about += field(1, I64, number(50)) + field(1, I64, number(len(page))) + field(1, I64, number(len(page)))
    about += field(2, I64, number(4)) + b"\0"
    chunk = field(2, I64, number(4)) + field(1, STRUCTURE, about) + b"\0"
    group = field(1, LIST, items(STRUCTURE, chunk))
    group += field(1, I64, number(len(page))) + field(1, I64, number(50)) + b"\0"
    root = field(4, TEXT, text(b"root")) + field(1, I32, number(1)) + b"\0"
    column = field(1, I32, number(5)) + field(2, I32, number(0)) + field(1, TEXT, text(b"gyro_x")) + b"\0"
    footer = field(1, I32, number(1)) + field(1, LIST, items(STRUCTURE, root, column))
    footer += field(1, I64, number(rows)) + field(1, LIST, items(STRUCTURE, group)) + b"\0"
    path.write_bytes(b"PAR1" + page + footer + len(footer).to_bytes(4, "little") + b"PAR1")
    return path


def test_a_wrong_checksum_of_a_page_is_damage(tmp_path: Path) -> None:
    """Polars neither writes nor verifies checksums."""
    path = write_parquet(tmp_path / "log.parquet")
    assert damage_of(path) == ""
    assert pl.read_parquet(path)["gyro_x"].to_list() == list(range(50))
    write_parquet(path, change=1)
    assert damage_of(path) == "the checksum of page 1 of column gyro_x does not match its content"
    finding = read(path, rate_hz=100, gyro_unit="rad/s").findings[0]
    assert (finding.level, finding.code) == ("warning", "damaged")


def test_numbers_of_rows_and_values_are_compared(tmp_path: Path) -> None:
    path = write_parquet(tmp_path / "log.parquet", rows=51)
    assert damage_of(path) == "its footer counts 51 rows and its groups 50"
    write_parquet(path, counted=49)
    assert damage_of(path) == "column gyro_x counts 50 values and its pages 49"


@pytest.mark.parametrize("compression", ["zstd", "snappy", "uncompressed"])
def test_files_of_polars_are_sound(compression: str, tmp_path: Path) -> None:
    """Lists have more values than rows; texts and missing values have dictionaries and levels."""
    path = tmp_path / "log.parquet"
    frame = pl.DataFrame(
        {
            "time": np.arange(3000) / 100,
            "gyro": [[0.1, 0.2, 0.3]] * 3000,
            "name": ["imu"] * 3000,
            "temperature": [None, 25.0] * 1500,
        }
    )
    frame.write_parquet(path, compression=compression, row_group_size=1000, data_page_size=4000)  # type: ignore[arg-type]
    assert damage_of(path) == ""


def test_every_cut_of_a_file_is_found(tmp_path: Path) -> None:
    """The parser raises no error for bytes that are changed."""
    path = write_parquet(tmp_path / "log.parquet")
    data = path.read_bytes()
    for place in range(4, len(data)):
        path.write_bytes(data[:place])
        assert damage_of(path)
        changed = bytearray(data)
        changed[place] ^= 0xFF
        path.write_bytes(changed)
        damage_of(path)
