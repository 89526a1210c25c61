"""Blocks of rows of a delimited text -> columns of numbers, parsed by polars."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray
from imucal.readers.growing import GrowingColumn
from imucal.readers.tables.dates import NO_STAMP, TextKind, is_text_stamp, parse_texts, text_kind
from imucal.readers.tables.layout import (
    BLANKS,
    Rows,
    TextLayout,
    row_pattern,
)

Kind: TypeAlias = Literal["integer", "float"] | TextKind
_TEXTS: tuple[Kind, ...] = get_args(TextKind)

_QUOTED = re.compile(rb'"[^"\n]*"')
_BLANK_LINES = re.compile(rb"\n\n+")
_UNCLOSED = re.compile(rb'(?m)^[^"\n]*"[^\n]*$')

#: Extra column for cells beyond the layout.
_LONGER = "longer"

_COMMENTS = ("#", "%", "//", ";")


_INTEGER = re.compile(r"[+-]?\d{1,20}")


def kind_of(cells: Sequence[str], *, text: bool) -> Kind:
    """Return the type of a column by its first cells; `text` for times."""
    if text or any(map(is_text_stamp, cells)):
        return text_kind(cells)
    filled = [cell.strip("\"'") for cell in cells if cell]
    integers = filled and all(_INTEGER.fullmatch(cell) and -(2**63) <= int(cell) < 2**63 for cell in filled)
    return "integer" if integers else "float"


@dataclass(kw_only=True)
class BlockReader:
    """Reads the wanted columns of a text table, block by block.

    A row without a cell in a `needed` column is bad. Dates with the year last begin with the day if `by_day`.
    """

    layout: TextLayout
    kinds: dict[int, Kind]
    needed: frozenset[int]
    rows: Rows = None
    expected: int = 0
    by_day: bool = False
    good: int = 0
    bad: int = 0
    first_bad: str = ""
    #: Bytes since the last block with a good row.
    bytes_without_rows: int = 0
    columns: dict[int, GrowingColumn] = field(init=False)
    _pattern: re.Pattern[bytes] | None = field(init=False)
    _mark: str = field(init=False)

    def __post_init__(self) -> None:
        self.kinds = dict(sorted(self.kinds.items()))
        self.columns = {
            index: GrowingColumn(np.float64 if kind == "float" else np.int64, expected=self.expected)
            for index, kind in self.kinds.items()
        }
        self._pattern = row_pattern(self.rows, self.layout.delimiter) if self.rows else None
        self._mark = "," if self.layout.delimiter == BLANKS else self.layout.delimiter

    def add(self, block: bytes) -> None:
        if self.layout.prepare is not None:
            block = self.layout.prepare(block)
        if self._pattern is not None:
            block = b"\n".join(self._pattern.findall(block)) + b"\n"
        self.bytes_without_rows += len(block)
        # A table of many blank lines takes much memory.
        block = _BLANK_LINES.sub(b"\n", self._plain(block))
        if not block or block.isspace():
            return
        values, bad = self._values(self._parsed(block))
        if bad.any():
            self._count_bad(block.split(b"\n"), np.flatnonzero(bad))
            values = {index: array[~bad] for index, array in values.items()}
        good = len(next(iter(values.values())))
        self.good += good
        if good:
            self.bytes_without_rows = 0
        for index, column in self.columns.items():
            column.append(values[index])

    def _values(self, table: Any) -> tuple[dict[int, NDArray[Any]], BoolArray]:  # noqa: ANN401 - of polars
        values: dict[int, NDArray[Any]] = {}
        bad = np.zeros(table.height, np.bool_)
        if table[_LONGER].null_count() < table.height:
            bad |= table[_LONGER].is_not_null().to_numpy()
        for index in self.needed or self.kinds:
            if table[str(index)].null_count():
                bad |= table[str(index)].is_null().to_numpy()
        for index, kind in self.kinds.items():
            series = table[str(index)]
            if kind in _TEXTS:
                cells, text = series.fill_null("").to_list(), cast("TextKind", kind)
                values[index] = parse_texts(cells, text, by_day=self.by_day)
                bad |= values[index] == NO_STAMP
            else:
                full = series.fill_null(0) if series.dtype.is_integer() and series.null_count() else series
                values[index] = np.asarray(full.to_numpy())
        return values, bad

    def _plain(self, block: bytes) -> bytes:
        delimiter, mark = self.layout.delimiter, self._mark.encode()
        commas = self.layout.decimal == ","
        if delimiter == BLANKS:
            block = re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", block)
            block = re.sub(rb"[ \t]+", b",", block)
        elif b" " in block:
            block = block.replace(mark + b" ", mark)
            # Joining two numbers would make another one.
            if b" " in block:
                block = re.sub(rb"(?m)^ +| *(" + re.escape(mark) + rb") *| +$", rb"\1", block)
        if self.layout.quoted:
            inner = b"." if commas else b" "
            block = _QUOTED.sub(lambda match: match[0][1:-1].replace(mark, inner), block)
            # An unclosed quote makes its line one cell, which is not a number.
            block = _UNCLOSED.sub(lambda match: match[0].replace(mark, b" "), block)
        # With a comma as delimiter, decimal commas were in quotes.
        if commas and delimiter != ",":
            block = block.replace(b",", b".")
        return block

    def _parsed(self, block: bytes) -> Any:  # noqa: ANN401 - polars is imported late
        """Return a block as a polars table; unreadable cells are null, and too long rows have `_LONGER`."""
        import polars as pl

        names = [*map(str, range(self.layout.width)), _LONGER]
        looked_at = sorted(self.needed | self.kinds.keys())
        types: dict[Kind | None, Any] = {"integer": pl.Int64, "float": pl.Float64}

        def parsed() -> pl.DataFrame:
            return pl.read_csv(
                self._mark.join(names).encode() + b"\n" + block,
                separator=self._mark,
                quote_char=None,
                schema={name: types.get(self.kinds.get(at), pl.String) for at, name in enumerate(names)},
                columns=[*map(str, looked_at), _LONGER],
                ignore_errors=True,
                truncate_ragged_lines=True,
                encoding="utf8-lossy",
            )

        table = parsed()
        integers = [str(index) for index, kind in self.kinds.items() if kind == "integer"]
        if any(table[name].null_count() for name in integers):
            types["integer"] = pl.Float64
            floats = parsed()
            for name in integers:
                # Integers that a float would round are damaged stamps.
                gained = floats[name].filter(table[name].is_null()).drop_nulls()
                if gained.len() and bool((gained.abs() < 2**53).any()):
                    table = table.with_columns(floats[name])
        return table

    def _count_bad(self, lines: Sequence[bytes], indices: NDArray[np.int64]) -> None:
        """Count bad rows except blank lines, comments and headers; keep the first."""
        header = self._mark.join(self.layout.headers).replace(" ", "")
        texts = (lines[index].decode("utf-8", "replace").strip("\r") for index in indices.tolist())
        found = [t for t in texts if t and not t.startswith(_COMMENTS) and t.replace(" ", "") != header]
        self.first_bad = self.first_bad if self.bad or not found else found[0][:120]
        self.bad += len(found)
