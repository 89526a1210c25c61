"""How a text table is laid out: delimiter and decimal point, header, units, preamble, where the data start.

The head is cut by each delimiter; the one that gives the most cells of rows of numbers, under a header that
fits them, is taken. A header may take two lines, and a row of units may stand below it.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from typing import TypeAlias

from imucal.readers.tables.dates import is_time_of_day, text_kind
from imucal.units import is_unit

#: The delimiter that stands for runs of blanks and tabs.
BLANKS = " "

_DELIMITERS = (",", ";", "\t", "|", BLANKS)

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_COMMA_NUMBER = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_DOT_NUMBER = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?")

#: Lines of the head that are looked at.
_LINES = 400
#: Cells beyond this many don't make a delimiter more likely.
_WIDE = 50

#: A delimiter is a candidate where it gives this share of the best one's cells.
_CLOSE = 0.5

#: The semicolons that end the lines of MATLAB's matrices.
_ENDS = re.compile(rb"[; \t]+$", re.MULTILINE)

_RATE = re.compile(
    r"(?:update|sampl\w*|output|data)[\s_]*(?:rate|freq\w*)[^0-9\n]{0,12}(?P<rate>\d+(?:\.\d+)?)\s*(?P<kilo>k?)hz\b"
    r"|(?:^|[\s#\"])(?:fs|sampl\w*[\s_]*(?:rate|freq\w*)|update[\s_]*rate|rate_hz|frequency)(?:\s*[(\[]hz[)\]])?"
    r"\s*[\"]?\s*[,;:=\t]\s*[\"]?(?P<plain>\d+(?:\.\d+)?)\s*(?P<kilos>(?:khz)?)",
    re.IGNORECASE | re.MULTILINE,
)

#: A delimiter that fewer lines have is none.
_FEW_LINES = 2
#: A table of one or two columns has rows of numbers in more than this share of its lines.
_MOSTLY = 0.6
#: And at least so many of them: a few numbers are no log.
_ENOUGH = 10


def is_number(cell: str) -> bool:
    """Return whether a cell is a number with a decimal point."""
    return _NUMBER.fullmatch(cell) is not None


#: Rows of a sensor: the index of a column, -1 for any, and the text its cells must hold; None for all rows.
Rows: TypeAlias = tuple[int, str] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLayout:
    """The layout of a text table.

    Attributes
    ----------
    width
        Cells of a row.
    rows
        The first rows of data, as cells without blanks around them.
    headers, units
        Names of the columns, and a row of units; each empty where there is none.
    preamble
        Lines before the header.
    start
        Lines before the first row of data.
    delimiter
        ``,`` ``;`` tab ``|``, or `BLANKS` for runs of blanks and tabs.
    rate_hz
        Sampling rate from the preamble.
    mismatch
        Cells of the header line where they don't fit the rows: names can't be told apart then.
    tag
        The rows that have this layout, where others stand between them.
    prepare
        Turns a block of lines into rows of plain cells, where they are none.
    """

    width: int
    rows: tuple[tuple[str, ...], ...]
    headers: tuple[str, ...] = ()
    units: tuple[str | None, ...] = ()
    preamble: tuple[str, ...] = ()
    start: int = 0
    delimiter: str = ","
    decimal: str = "."
    rate_hz: float | None = None
    quoted: bool = False
    mismatch: int | None = None
    tag: Rows = None
    prepare: Callable[[bytes], bytes] | None = None

    @property
    def score(self) -> int:
        """How many cells of rows the first lines give."""
        return len(self.rows) * min(self.width, _WIDE)

    def cells(self, index: int) -> list[str]:
        """Return the first cells of a column, decimal point in place."""
        cells = [row[index] for row in self.rows if index < len(row)]
        return [cell.replace(",", ".") for cell in cells] if self.decimal == "," else cells


def find_layout(lines: Sequence[str]) -> TextLayout | None:
    """Return the layout of a table from its first lines; None where they hold no rows of numbers."""
    lines = list(lines[:_LINES])
    only = _named_delimiter(lines)
    for delimiters, narrow in (((only,) if only else (), False), (_DELIMITERS, False), (_DELIMITERS, True)):
        found = [layout for delimiter in delimiters if (layout := _layout(lines, delimiter, narrow=narrow))]
        if found:
            found.sort(key=lambda layout: -layout.score)
            likely = [layout for layout in found if layout.score >= _CLOSE * found[0].score]
            # Blanks within dates and names make more cells than there are names.
            return next((layout for layout in likely if layout.headers), likely[0])
    return None


def _named_delimiter(lines: Sequence[str]) -> str | None:
    """Return the delimiter of a line ``sep=;``, which spreadsheets write and read."""
    for line in lines[:2]:
        if line.strip().lower().startswith("sep="):
            value = line.strip("\ufeff\r\n ")[4:].strip('"')
            value = "\t" if value in {"\\t", "\t", ""} else value[:1]
            return value if value in _DELIMITERS else None
    return None


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line, without blanks around them."""
    if delimiter == BLANKS:
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        cells = line.split(delimiter)
    return [cell.strip() for cell in cells]


def _layout(lines: Sequence[str], delimiter: str, *, narrow: bool) -> TextLayout | None:
    """Return the layout of lines cut by a delimiter; None where that gives no rows of numbers.

    Rows of one or two cells count only if `narrow`.
    """
    if delimiter != BLANKS and sum(delimiter in line for line in lines) < min(_FEW_LINES, len(lines)):
        return None
    # A semicolon that parts no cells ends the lines, as those of MATLAB's matrices.
    ended = delimiter != ";" and sum(line.rstrip().endswith(";") for line in lines) > 0.5 * len(lines)
    bare = [line.rstrip("; \t") for line in lines] if ended else lines
    rows = [split_line(line, delimiter) if line.strip() else [] for line in bare]
    # Where commas part the cells, one within a cell stood in quotes.
    decimal = _decimal(rows)
    width, fitting = _narrow(rows, decimal) if narrow else _fitting(rows, decimal)
    if not fitting:
        return None
    if width == 1:
        # A name with blanks is one name, such as "gz (deg/s)".
        rows = [[" ".join(row)] if row else [] for row in rows]
    start = _start(fitting, len(lines))
    chosen = [i for i in fitting if i >= start]
    stated = _RATE.search("\n".join(lines[:start]))
    rate = float(stated["rate"] or stated["plain"]) if stated else 0.0
    table = TextLayout(
        delimiter=delimiter,
        decimal=decimal,
        width=width,
        start=start,
        rows=tuple(tuple(rows[i]) for i in chosen),
        rate_hz=(1000 * rate if stated and (stated["kilo"] or stated["kilos"]) else rate) or None,
        quoted=any('"' in lines[i] for i in chosen),
        prepare=partial(_ENDS.sub, b"") if ended else None,
    )
    line, headers, units = _find_header(table, rows[:start])
    headers, mismatch = _fitted_names(headers, table)
    preamble = tuple(text for text in lines[: start if line is None else line] if text.strip())
    return replace(table, headers=tuple(headers), units=tuple(units), preamble=preamble, mismatch=mismatch)


def _fitting(rows: Sequence[Sequence[str]], decimal: str) -> tuple[int, list[int]]:
    """Return the width of the table in some lines, and which of them are its rows."""
    filled = [len(row) - row.count("") for row in rows]
    numbers = [_numbers(row, decimal) for row in rows]
    likely = {i for i, count in enumerate(numbers) if count >= max(3, 0.4 * filled[i])}
    if not likely:
        return 0, []
    widths = Counter(len(rows[i]) for i in likely)
    width = max(widths, key=lambda cells: (widths[cells] * min(cells, _WIDE), cells))
    # A table of several topics has rows with a few cells filled.
    sparse = {i for i, count in enumerate(numbers) if 0 < count == filled[i]}
    return width, sorted(i for i in likely | sparse if len(rows[i]) == width)


def _narrow(rows: Sequence[Sequence[str]], decimal: str) -> tuple[int, list[int]]:
    """Return the width, one or two, of a log of one axis, and which lines are its rows: most of them."""
    filled = [i for i, row in enumerate(rows) if row]
    likely = [i for i in filled if len(rows[i]) <= 2 and _numbers(rows[i], decimal) == len(rows[i])]
    width = max((len(rows[i]) for i in likely), default=0)
    fitting = [i for i in likely if len(rows[i]) == width]
    enough = len(fitting) >= _ENOUGH and len(fitting) > _MOSTLY * len(filled)
    return (width, fitting) if enough else (0, [])


def _start(fitting: Sequence[int], lines: int) -> int:
    """Return the first line from which most lines are rows: a number row in a preamble is not it."""
    chosen = set(fitting)
    for first in fitting:
        window = range(first, min(first + 8, lines))
        if sum(line in chosen for line in window) >= 0.6 * len(window):
            return first
    return fitting[0]


def _decimal(rows: Sequence[Sequence[str]]) -> str:
    cells = [cell for row in rows for cell in row]
    commas, points = (sum(map(bool, map(number.fullmatch, cells))) for number in (_COMMA_NUMBER, _DOT_NUMBER))
    return "," if commas > points else "."


def _numbers(row: Sequence[str], decimal: str) -> int:
    return sum(
        bool(_NUMBER.fullmatch(cell) or (decimal == "," and _COMMA_NUMBER.fullmatch(cell))) for cell in row
    )


#: Names of a header's second row, and what stands in brackets beside them.
_AXES = frozenset(("", "w", "x", "y", "z"))
_UNIT_PART = re.compile(r"[\[(][^\])]*[\])]")
#: A date that stands behind this many columns is none of a row's time.
_STAMP_FIRST = 6


def _find_header(
    table: TextLayout, above: Sequence[list[str]]
) -> tuple[int | None, list[str], list[str | None]]:
    """Return the header's line among the rows `above` a table, its names and the units of a row of units."""
    units: list[str | None] = []
    # The cells of a date, a time and AM or PM may have one name.
    fewest = -max(1, _stamp_cells(table)[1] - 1)
    for line in range(len(above) - 1, -1, -1):
        row = above[line]
        row = row[1:] if row and row[0] in {"#", "%", "//"} else row
        if not fewest <= len(row) - table.width <= 1 or len(row) < min(2, table.width):
            continue
        if not units and _is_row_of_units(row, above[:line]):
            units = [unit if is_unit(unit) else None for unit in (cell.strip("[]()") for cell in row)]
        elif any(re.search(r"[^\W\d_]", cell) for cell in row):
            return line, _two_rows(above[line - 1] if line else [], row), units
    return None, [], units


def _is_row_of_units(row: Sequence[str], above: Sequence[Sequence[str]]) -> bool:
    units = sum(is_unit(cell.strip("[]()")) for cell in row)
    # With no names above it, it is the names: secs and nsecs are units too. So is one: t is a tesla.
    named = units == len(row) or any(len(other) == len(row) for other in above)
    return named and units >= max(0.3 * len(row), min(2, len(row))) and not _is_axes(row)


def _is_axes(row: Sequence[str]) -> bool:
    """Return whether a row names axes, perhaps with their units, and only the unit of a time beside them."""
    cells = [_UNIT_PART.sub("", cell).strip("\"' ").lower() for cell in row]
    return {"x", "y", "z"} <= set(cells) and all(cell in _AXES or is_unit(cell) for cell in cells)


def _two_rows(above: Sequence[str], row: list[str]) -> list[str]:
    """Join a header of two lines, groups above, x, y, z below; or groups and axes that stand in one line."""
    grouped = _is_axes(row) and 2 <= len(above) <= len(row) + 1 and any(above)
    if not grouped and Counter(cell.lower() for cell in row)["x"] < 2:
        return row
    group, names = "", []
    for label, cell in zip_longest(above[: len(row)] if grouped else (), row, fillvalue=""):
        # rosbag_to_csv names a vector before its axes, which are x, y, z again and again.
        named = grouped or cell.lower() in {"x", "y", "z", "w"}
        group = label or group if named else cell
        names.append(f"{group} {cell}".strip() if named else cell)
    return names


def _stamp_cells(table: TextLayout) -> tuple[int, int]:
    """Return where the cells of one time start, and their number: blanks cut a date from its time."""
    columns = [[row[at] for row in table.rows] for at in range(min(table.width, _STAMP_FIRST))]
    kinds = [text_kind(cells) for cells in columns]
    for at in range(len(kinds) - 1):
        if table.delimiter == BLANKS and kinds[at] == "date" and all(map(is_time_of_day, columns[at + 1])):
            return at, 3 if kinds[at + 2 : at + 3] == ["half"] else 2
    return 0, 1


def _fitted_names(headers: list[str], table: TextLayout) -> tuple[list[str], int | None]:
    """Return as many names as cells, and the number of names where they don't fit."""
    if not headers or len(headers) == table.width:
        return headers, None
    at, cells = _stamp_cells(table)
    named = cells - (table.width - len(headers))
    if 0 < named < cells:
        names = [*(["date"] if named == 1 else []), *headers[at : at + named], "am/pm"][:cells]
        return [*headers[:at], *names, *headers[at + named :]], None
    if len(headers) == table.width + 1 and not headers[-1]:
        return headers[:-1], None
    last_empty = all(not row[-1] for row in table.rows)
    if len(headers) == table.width - 1 and last_empty:
        return [*headers, ""], None
    return [], len(headers)


def rows_of_tag(lines: Sequence[str], delimiter: str, rows: tuple[int, str]) -> list[str]:
    """Return the lines whose cell holds a tag."""
    index, tag = rows
    found = []
    for line in lines:
        cells = [cell.strip("\"'") for cell in split_line(line, delimiter)]
        if tag in (cells if index < 0 else cells[index : index + 1]):
            found.append(line)
    return found
