"""Rows of a text table -> columns of numbers: polars for each block, a tolerant parser where it fails."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, TypeVar, cast, get_args

import numpy as np
from numpy.typing import NDArray

from imucal.readers.column_store import GrowingColumn
from imucal.readers.tables.dates import NO_STAMP, TextKind, parse_texts
from imucal.readers.tables.layout import Rows, TextLayout
from imucal.readers.tables.line_splits import BLANKS, split_line

#: What the cells of a column are read as: numbers, or one of the texts that tell the time.
Kind: TypeAlias = Literal["integer", "float"] | TextKind
_TEXTS: tuple[Kind, ...] = get_args(TextKind)

_Number = TypeVar("_Number", int, float)

_QUOTED = re.compile(rb'"[^"\n]*"')

_COMMENTS = ("#", "%", "//", ";")


@dataclass(slots=True)
class RowCounts:
    """How many rows were read, how many are none of the table, and the first of those."""

    good: int = 0
    bad: int = 0
    first_bad: str = ""


@dataclass(slots=True, kw_only=True)
class BlockReader:
    """Reads the wanted columns of a text table, block by block.

    `kinds` says by index what the cells of each wanted column are. A row that lacks a cell of a `needed`
    column is bad. `limit` is the bytes of a column to hold in memory, `expected` the rows to make room for.
    Dates with the year last begin with the month, or `by_day`.
    """

    layout: TextLayout
    kinds: dict[int, Kind]
    needed: frozenset[int]
    rows: Rows = None
    limit: int = 1 << 62
    expected: int = 0
    by_day: bool = False
    counts: RowCounts = field(default_factory=RowCounts)
    columns: dict[int, GrowingColumn] = field(init=False)
    _pattern: re.Pattern[bytes] | None = field(init=False)
    _wanted: list[int] = field(init=False)

    def __post_init__(self) -> None:
        self.columns = {
            index: GrowingColumn(
                np.float64 if kind == "float" else np.int64, limit=self.limit, expected=self.expected
            )
            for index, kind in self.kinds.items()
        }
        self._wanted = sorted(self.kinds)
        self._pattern = _row_pattern(self.rows, self.layout.delimiter)

    def add(self, block: bytes) -> None:
        """Read a block of whole lines."""
        if self.layout.prepare is not None:
            block = self.layout.prepare(block)
        if self._pattern is not None:
            block = b"\n".join(self._pattern.findall(block)) + b"\n"
        plain = self._plain(block)
        if not plain or plain.isspace():
            return
        values = self._by_polars(plain)
        if values is None:
            # Blank lines are looked for only now: the search costs as much as the parsing.
            plain = re.sub(rb"\n{2,}", b"\n", plain).lstrip(b"\n")
            values = self._by_polars(plain, last_try=True)
        if values is None:
            values = self._by_hand(plain)
        rows = len(values[self._wanted[0]])
        self.counts.good += rows
        for index, column in self.columns.items():
            column.append(values[index])

    def _plain(self, block: bytes) -> bytes:
        """Return a block that the parser takes: one delimiter, decimal points, no blank lines."""
        if self.layout.delimiter == BLANKS:
            block = re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", block)
            block = re.sub(rb"[ \t]+", b",", block)
        elif b" " in block:
            mark = self.layout.delimiter.encode()
            block = block.replace(mark + b" ", mark)
            # A blank within a cell stays: without it two numbers would become one.
            if b" " in block:
                block = re.sub(rb"(?m)^ +| *(" + re.escape(mark) + rb") *| +$", rb"\1", block)
        if self.layout.decimal == ",":
            block = self._with_points(block)
        return block

    def _with_points(self, block: bytes) -> bytes:
        """Return a block with decimal points for commas; for those in quotes where commas part the cells."""
        if self.layout.delimiter == ",":
            return _QUOTED.sub(lambda match: match[0].replace(b",", b"."), block)
        return block.replace(b",", b".")

    @property
    def _separator(self) -> str:
        return "," if self.layout.delimiter == BLANKS else self.layout.delimiter

    def _by_polars(self, block: bytes, *, last_try: bool = False) -> dict[int, NDArray[Any]] | None:
        """Return the wanted columns of a block; None where it holds something that is no row.

        Rows that lack a cell are such before the last try: they may be blank lines.
        """
        table = self._parsed(block)
        if table is None:
            return None
        values = {index: self._values(table[str(index)], self.kinds[index]) for index in self._wanted}
        empty = self._lacking(table, values)
        if empty.any():
            if not last_try:
                return None
            self._note_bad(int(empty.sum()), lambda: block.split(b"\n")[int(np.flatnonzero(empty)[0])])
            values = {index: array[~empty] for index, array in values.items()}
        return values

    def _parsed(self, block: bytes) -> Any:  # noqa: ANN401 - polars is imported late
        """Return a block as polars' table of the columns that are looked at; None where it can't be one."""
        import polars as pl

        types: dict[Kind | None, Any] = {"integer": pl.Int64, "float": pl.Float64}
        kinds = [self.kinds.get(index) for index in range(self.layout.width)]
        schema = {str(index): types.get(kind, pl.String) for index, kind in enumerate(kinds)}
        looked_at = sorted(self.needed | frozenset(self._wanted))
        try:
            table = pl.read_csv(
                block,
                has_header=False,
                separator=self._separator,
                quote_char='"' if self.layout.quoted else None,
                schema=schema,
                columns=looked_at if len(looked_at) < self.layout.width else None,
            )
        except (pl.exceptions.PolarsError, UnicodeDecodeError):
            return None
        # A quotation mark that stands open may swallow lines.
        if self.layout.quoted and table.height != block.count(b"\n") + (not block.endswith(b"\n")):
            return None
        return table

    def _values(self, series: Any, kind: Kind) -> NDArray[Any]:  # noqa: ANN401 - polars is imported late
        if kind in _TEXTS:
            return self._times(series.fill_null("").to_list(), kind)
        if kind == "integer" and series.null_count():
            series = series.fill_null(0)
        return np.asarray(series.to_numpy())

    def _lacking(self, table: Any, values: dict[int, NDArray[Any]]) -> NDArray[np.bool_]:  # noqa: ANN401
        """Return which rows lack a cell that each must have, or a time that can be read."""
        lacking = np.zeros(table.height, dtype=np.bool_)
        for index in self.needed or self._wanted:
            series = table[str(index)]
            if series.null_count():
                lacking |= series.is_null().to_numpy()
        for index in self._wanted:
            if self.kinds[index] in _TEXTS:
                lacking |= values[index] == NO_STAMP
        return lacking

    def _by_hand(self, block: bytes) -> dict[int, NDArray[Any]]:
        """Return the wanted columns of the good rows of a block, row by row."""
        lines = block.decode("utf-8", "replace").split("\n")
        header = self._separator.join(self.layout.headers).replace(" ", "")
        found: dict[int, list[Any]] = {index: [] for index in self._wanted}
        for line in lines:
            text = line.strip("\r\n")
            if not text.strip() or text.startswith(_COMMENTS) or text.replace(" ", "") == header:
                continue
            row = self._row(split_line(text, self._separator))
            if row is None:
                self._note_bad(1, lambda text=text: text.encode())  # type: ignore[misc]
                continue
            for index, value in zip(self._wanted, row, strict=True):
                found[index].append(value)
        return {index: self._array(index, values) for index, values in found.items()}

    def _row(self, cells: Sequence[str]) -> list[int | float | str] | None:
        """Return the wanted cells of a row as numbers; None for a bad row."""
        if len(cells) > self.layout.width or len(cells) <= max(self.needed, default=0):
            return None
        if any(not cells[index] for index in self.needed):
            return None
        row: list[int | float | str] = []
        for index in self._wanted:
            cell = cells[index] if index < len(cells) else ""
            value = _number(cell, self.kinds[index])
            if value is None:
                return None
            row.append(value)
        return row

    def _array(self, index: int, values: list[Any]) -> NDArray[Any]:
        kind = self.kinds[index]
        if kind in _TEXTS:
            return self._times(values, kind)
        if kind == "integer" and all(isinstance(value, int) for value in values):
            return np.array(values, dtype=np.int64)
        return np.array(values, dtype=np.float64)

    def _times(self, cells: Sequence[str], kind: Kind) -> NDArray[Any]:
        return parse_texts(cells, cast("TextKind", kind), by_day=self.by_day)

    def _note_bad(self, count: int, line: Callable[[], bytes]) -> None:
        if not self.counts.bad:
            self.counts.first_bad = line().decode("utf-8", "replace")[:120]
        self.counts.bad += count


def _number(cell: str, kind: Kind) -> int | float | str | None:
    """Return a cell's value; an empty cell of floats is NaN; None where it has none."""
    if kind in _TEXTS:
        return cell
    if "_" in cell:
        return None
    if kind == "float" and not cell:
        return float("nan")
    if kind == "integer" and (value := _converted(int, cell)) is not None:
        return value if -(2**63) <= value < 2**63 else None
    return _converted(float, cell)


def _converted(number: Callable[[str], _Number], cell: str) -> _Number | None:
    try:
        return number(cell)
    except ValueError:
        return None


def _row_pattern(rows: Rows, delimiter: str) -> re.Pattern[bytes] | None:
    """Return the pattern of the lines whose cell holds a text."""
    if rows is None:
        return None
    index, text = rows
    blanks = delimiter == BLANKS
    mark = rb"[ \t]" if blanks else re.escape(delimiter.encode())
    start = rb"[ \t]*" if blanks else b""
    cell = rb"[^\n \t]*[ \t]+" if blanks else rb"[^\n" + mark + rb"]*" + mark
    before = rb"(?:" + cell + (rb")*?" if index < 0 else rb"){" + str(index).encode() + rb"}")
    tag = rb'[ \t]*"?' + re.escape(text.encode()) + rb'"?[ \t]*'
    return re.compile(rb"(?m)^" + start + before + tag + rb"(?:" + mark + rb"[^\n]*)?$")


def without_start(blocks: Iterable[bytes], lines: int) -> Iterable[bytes]:
    """Yield blocks without the first lines."""
    for block in blocks:
        start = 0
        while lines and (end := block.find(b"\n", start)) >= 0:
            start, lines = end + 1, lines - 1
        if not lines:
            yield block[start:] if start else block
