"""Verify the checksums and the row counts of a Parquet file, which polars ignores.

Source: the Thrift compact protocol, and parquet.thrift of the Parquet format 2.11.
"""

import struct
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias
from zlib import crc32

from imucal.readers.files import DamagedError, damaged_if

#: Field -> value: a number, bytes, a list, or another structure.
Structure: TypeAlias = dict[int, Any]

#: Types of the Thrift compact protocol.
_TRUE = 1
_FALSE = 2
_BYTE = 3
_I16 = 4
_I32 = 5
_I64 = 6
_DOUBLE = 7
_BINARY = 8
_LIST = 9
_SET = 10
_MAP = 11
_STRUCT = 12
#: Deepest nesting; files have about 6.
_MAX_DEPTH = 16
#: Longest number, in bytes of seven bits.
_MAX_VARINT = 10
#: Bytes read for the head of a page; heads with statistics of long texts may be longer.
_HEAD = 1 << 16
#: Bytes of the length of the footer and of the signature after it.
_TAIL = 8


class _Compact:
    """Decodes values of the Thrift compact protocol from bytes."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def structure(self, depth: int = 0) -> Structure:
        """Return the fields by number; raises DamagedError."""
        damaged_if(depth > _MAX_DEPTH, "a structure is nested too deeply")
        fields: Structure = {}
        number = 0
        while head := self._byte():
            kind, step = head & 15, head >> 4
            number = number + step if step else self._signed()
            fields[number] = kind == _TRUE if kind in {_TRUE, _FALSE} else self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:  # noqa: ANN401 - of any type
        if kind == _STRUCT:
            return self.structure(depth + 1)
        if kind in {_LIST, _SET}:
            return self._list(depth)
        if kind == _BINARY:
            return self._take(self._varint())
        if kind == _DOUBLE:
            return struct.unpack("<d", self._take(8))[0]
        if kind in {_TRUE, _FALSE, _BYTE}:
            return self._byte()
        damaged_if(kind not in {_I16, _I32, _I64}, f"type {kind} is unknown")
        return self._signed()

    def _list(self, depth: int) -> list[Any]:
        head = self._byte()
        kind, size = head & 15, head >> 4
        if size == 15:
            size = self._varint()
        # Each value has at least one byte.
        damaged_if(size > len(self._data) - self.at, "a list is longer than its file")
        return [self._value(kind, depth + 1) for _ in range(size)]

    def _signed(self) -> int:
        number = self._varint()
        return (number >> 1) ^ -(number & 1)

    def _varint(self) -> int:
        number = 0
        for place in range(_MAX_VARINT):
            byte = self._byte()
            number |= (byte & 127) << 7 * place
            if byte < 128:
                return number
        raise DamagedError("a number is too long")

    def _byte(self) -> int:
        return self._take(1)[0]

    def _take(self, size: int) -> bytes:
        piece = self._data[self.at : self.at + size]
        damaged_if(len(piece) < size, "a structure is incomplete")
        self.at += size
        return piece


def damage_of(path: Path) -> str:
    """Return the first contradiction in a Parquet file, or an empty text.

    It compares the rows in the footer with its groups, the values of each column with its pages, and the
    checksum of each page that has one with its bytes.
    """
    try:
        with path.open("rb") as file:
            groups, total = _row_groups(file)
            rows = sum(_number(group, 3) for group in groups)
            damaged_if(rows != total, f"its footer counts {total} rows and its groups {rows}")
            for group in groups:
                for column in group.get(1, []):
                    _check_column(file, column)
    except (DamagedError, AttributeError, KeyError, TypeError) as error:
        # Fields of a wrong type raise the other errors.
        return str(error)
    return ""


def _row_groups(file: BinaryIO) -> tuple[list[Structure], int]:
    end = file.seek(0, 2)
    damaged_if(end < 2 * _TAIL, "it is too short")
    size = int.from_bytes(_read(file, end - _TAIL, 4), "little")
    damaged_if(size > end - _TAIL, "its footer is incomplete")
    footer = _Compact(_read(file, end - _TAIL - size, size)).structure()
    return footer.get(4, []), _number(footer, 3)


def _number(fields: Structure, number: int) -> int:
    value = fields.get(number)
    if not isinstance(value, int):
        raise DamagedError("a structure lacks a number")
    return value


def _check_column(file: BinaryIO, column: Structure) -> None:
    about = column.get(3)
    # Columns in other files, and encrypted ones.
    if about is None or 1 in column:
        return
    name = b".".join(about[3]).decode("utf-8", "replace")
    values, size, first = _number(about, 5), _number(about, 7), _number(about, 9)
    dictionary = about.get(11)
    at = min(first, dictionary) if dictionary else first
    end, found, number = at + size, 0, 0
    while at < end:
        number += 1
        where = f"page {number} of column {name}"
        head = _Compact(_read(file, at, min(_HEAD, end - at)))
        page = head.structure()
        length, checksum = _number(page, 3), page.get(4)
        at += head.at
        damaged_if(length < 0 or at + length > end, f"{where} is incomplete")
        if checksum is not None:
            wrong = crc32(_read(file, at, length)) != checksum & 0xFFFFFFFF
            damaged_if(wrong, f"the checksum of {where} does not match its content")
        at += length
        # Data pages of versions 1 and 2.
        counted = page.get(5) or page.get(8)
        found += _number(counted, 1) if counted else 0
    damaged_if(found != values, f"column {name} counts {values} values and its pages {found}")


def _read(file: BinaryIO, at: int, size: int) -> bytes:
    damaged_if(at < 0 or size < 0, "a place is outside the file")
    file.seek(at)
    data = file.read(size)
    damaged_if(len(data) < size, "a page is beyond the end of the file")
    return data
