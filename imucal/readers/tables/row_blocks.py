"""Rows of a text table -> columns of numbers: polars for each block, a tolerant parser where it fails."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.readers.column_store import GrowingColumn
from imucal.readers.tables.columns import Rows
from imucal.readers.tables.layout import BLANKS, Layout, split_line
from imucal.readers.tables.stamps import parse_text_stamps

#: What the cells of a column are read as.
Kind: TypeAlias = Literal["integer", "float", "text"]

_COMMENTS = ("#", "%", "//", ";")


@dataclass(slots=True)
class RowCounts:
    """What became of the rows of a text.

    Attributes
    ----------
    good
        Rows read.
    bad
        Rows dropped: too few or too many cells, or text where a number belongs.
    first_bad
        The first of them.
    cut
        The last line, where it has no line end and may therefore be cut.
    """

    good: int = 0
    bad: int = 0
    first_bad: str = ""
    cut: str = ""


@dataclass(slots=True, kw_only=True)
class BlockReader:
    """Reads the wanted columns of a text table, block by block.

    Parameters
    ----------
    layout
        Of the table.
    kinds
        Place of each wanted column -> what its cells are.
    needed
        Places whose cells must not be empty; a row that lacks one is bad.
    optional
        Sets of places; a row is bad if all cells of all sets are empty, or a set is half empty.
    rows
        The rows to read.
    limit
        Bytes of a column to hold in memory.
    expected
        Rows to make room for.
    prepare
        Turns a block of lines into lines of plain cells, where the format needs it.
    """

    layout: Layout
    kinds: dict[int, Kind]
    needed: frozenset[int]
    rows: Rows = None
    limit: int = 1 << 62
    expected: int = 0
    prepare: Callable[[bytes], bytes] | None = None
    counts: RowCounts = field(default_factory=RowCounts)
    columns: dict[int, GrowingColumn] = field(init=False)
    _pattern: re.Pattern[bytes] | None = field(init=False)
    _places: list[int] = field(init=False)

    def __post_init__(self) -> None:
        self.columns = {
            place: GrowingColumn(
                np.float64 if kind == "float" else np.int64, limit=self.limit, expected=self.expected
            )
            for place, kind in self.kinds.items()
        }
        self._places = sorted(self.kinds)
        self._pattern = _row_pattern(self.rows, self.layout.delimiter)

    def add(self, block: bytes) -> None:
        """Read a block of whole lines."""
        if self.prepare is not None:
            block = self.prepare(block)
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
        rows = len(values[self._places[0]])
        self.counts.good += rows
        for place, column in self.columns.items():
            column.append(values[place])

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
            block = block.replace(b",", b".")
        return block

    @property
    def _separator(self) -> str:
        return "," if self.layout.delimiter == BLANKS else self.layout.delimiter

    def _by_polars(self, block: bytes, *, last_try: bool = False) -> dict[int, NDArray[Any]] | None:
        """Return the wanted columns of a block; None where it holds something that is no row.

        Rows that lack a cell are such before the last try: they may be blank lines.
        """
        import polars as pl

        types: dict[Kind, Any] = {"integer": pl.Int64, "float": pl.Float64, "text": pl.String}
        schema = {str(place): types[self.kinds.get(place, "text")] for place in range(self.layout.width)}
        guards = sorted(self.needed | frozenset(self._places))
        try:
            table = pl.read_csv(
                block,
                has_header=False,
                separator=self._separator,
                quote_char='"' if self.layout.quoted else None,
                schema=schema,
                columns=guards if len(guards) < self.layout.width else None,
            )
        except (pl.exceptions.PolarsError, UnicodeDecodeError):
            return None
        # A quotation mark that stands open may swallow lines.
        if self.layout.quoted and table.height != block.count(b"\n") + (not block.endswith(b"\n")):
            return None
        nulls = {int(name): table[name].null_count() for name in table.columns}
        empty = np.zeros(table.height, dtype=np.bool_)
        for place in self.needed or self._places:
            if nulls[place]:
                empty |= table[str(place)].is_null().to_numpy()
        values = {place: self._values(table[str(place)], nulls[place]) for place in self._places}
        for place in self._places:
            if self.kinds[place] == "text":
                empty |= values[place] == _NO_STAMP
        if empty.any():
            if not last_try:
                return None
            self._note_bad(int(empty.sum()), lambda: block.split(b"\n")[int(np.flatnonzero(empty)[0])])
            values = {place: array[~empty] for place, array in values.items()}
        return values

    def _values(self, series: Any, nulls: int) -> NDArray[Any]:  # noqa: ANN401 - polars is imported late
        kind = self.kinds[int(series.name)]
        if kind == "text":
            return parse_text_stamps(series.fill_null("").to_list())
        if kind == "integer":
            return np.asarray(series.fill_null(0).to_numpy() if nulls else series.to_numpy())
        return np.asarray(series.to_numpy())

    def _by_hand(self, block: bytes) -> dict[int, NDArray[Any]]:
        """Return the wanted columns of the good rows of a block, row by row."""
        lines = block.decode("utf-8", "replace").split("\n")
        header = self._separator.join(self.layout.headers)
        found: dict[int, list[Any]] = {place: [] for place in self._places}
        for line in lines:
            text = line.strip("\r\n")
            if (
                not text.strip()
                or text.startswith(_COMMENTS)
                or text.replace(" ", "") == header.replace(" ", "")
            ):
                continue
            cells = split_line(text, self._separator)
            row = self._row(cells)
            if row is None:
                self._note_bad(1, lambda text=text: text.encode())  # type: ignore[misc]
                continue
            for place, value in zip(self._places, row, strict=True):
                found[place].append(value)
        return {place: self._array(place, values) for place, values in found.items()}

    def _row(self, cells: Sequence[str]) -> list[int | float | str] | None:
        """Return the wanted cells of a row as numbers; None for a bad row."""
        if len(cells) > self.layout.width or len(cells) <= max(self.needed, default=0):
            return None
        if any(not cells[place] for place in self.needed):
            return None
        row: list[int | float | str] = []
        for place in self._places:
            cell = cells[place] if place < len(cells) else ""
            value = _number(cell, self.kinds[place])
            if value is None:
                return None
            row.append(value)
        return row

    def _array(self, place: int, values: list[Any]) -> NDArray[Any]:
        kind = self.kinds[place]
        if kind == "text":
            return parse_text_stamps(values)
        if kind == "integer" and all(isinstance(value, int) for value in values):
            return np.array(values, dtype=np.int64)
        return np.array(values, dtype=np.float64)

    def _note_bad(self, count: int, line: Callable[[], bytes]) -> None:
        if not self.counts.bad:
            self.counts.first_bad = line().decode("utf-8", "replace")[:120]
        self.counts.bad += count


#: What a time of day that can't be read becomes.
_NO_STAMP = np.iinfo(np.int64).min


def _number(cell: str, kind: Kind) -> int | float | str | None:
    """Return a cell's value; an empty cell is NaN; None where it is none."""
    if kind == "text":
        return cell
    if "_" in cell:
        return None
    try:
        if kind == "integer":
            value = int(cell)
            return value if -(2**63) <= value < 2**63 else None
        return float(cell) if cell else float("nan")
    except ValueError:
        return _float(cell) if kind == "integer" else None


def _float(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _row_pattern(rows: Rows, delimiter: str) -> re.Pattern[bytes] | None:
    """Return the pattern of the lines whose cell holds a text."""
    if rows is None:
        return None
    place, text = rows
    mark = re.escape(delimiter.encode()) if delimiter != BLANKS else rb"[ \t]"
    tag = rb'[ \t]*"?' + re.escape(text.encode()) + rb'"?[ \t]*'
    many = rb"+" if delimiter == BLANKS else b""
    cell = rb"[^\n" + (mark if delimiter != BLANKS else rb" \t") + rb"]*" + mark + many
    before = rb"(?:" + cell + rb")*?" if place < 0 else rb"(?:" + cell + rb"){" + str(place).encode() + rb"}"
    start = rb"[ \t]*" if delimiter == BLANKS else b""
    return re.compile(rb"(?m)^" + start + before + tag + rb"(?:" + mark + rb"[^\n]*)?$")


def without_start(blocks: Iterable[bytes], lines: int) -> Iterable[bytes]:
    """Yield blocks without the first lines."""
    for block in blocks:
        if lines:
            place = 0
            while lines and (end := block.find(b"\n", place)) >= 0:
                place, lines = end + 1, lines - 1
            if lines:
                continue
            yield block[place:]
        else:
            yield block
