"""Lines of a text table cut into cells: by which delimiter, with which decimal point, and which are rows."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

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

#: A delimiter that fewer lines have is none.
_FEW_LINES = 2
#: A table of one or two columns has rows of numbers in more than this share of its lines.
_MOSTLY = 0.6
#: And at least so many of them: a few numbers are no log.
_ENOUGH = 10


def is_number(cell: str) -> bool:
    """Return whether a cell is a number with a decimal point."""
    return _NUMBER.fullmatch(cell) is not None


@dataclass(frozen=True, slots=True)
class LineSplit:
    """The head of a table cut by one delimiter: rows by line, which of them fit, and where they start."""

    delimiter: str
    decimal: str
    rows: list[list[str]]
    width: int
    start: int
    fitting: tuple[int, ...]
    #: Whether a semicolon that parts no cells ends each line, as in matrices of MATLAB.
    ended: bool = False

    @property
    def score(self) -> int:
        """How many cells of rows it gives."""
        return len(self.fitting) * min(self.width, _WIDE)


def line_splits(lines: Sequence[str]) -> list[LineSplit]:
    """Return the ways of cutting a table's first lines that give rows of numbers, the likeliest first."""
    lines = list(lines[:_LINES])
    only = _named_delimiter(lines)
    splits = _splits(lines, (only,)) if only else []
    return splits or _splits(lines, _DELIMITERS) or _splits(lines, _DELIMITERS, narrow=True)


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


def _splits(lines: Sequence[str], delimiters: Sequence[str], *, narrow: bool = False) -> list[LineSplit]:
    """Return the ways of cutting the lines that give rows of numbers, the likeliest first."""
    splits = [split for delimiter in delimiters if (split := _split(lines, delimiter, narrow=narrow))]
    return sorted(splits, key=lambda split: -split.score)


def _split(lines: Sequence[str], delimiter: str, *, narrow: bool) -> LineSplit | None:
    if delimiter != BLANKS and sum(delimiter in line for line in lines) < min(_FEW_LINES, len(lines)):
        return None
    ended = delimiter != ";" and _have_ends(lines)
    if ended:
        lines = [line.rstrip("; \t") for line in lines]
    rows = _cells(lines, delimiter)
    # Where commas part the cells, one within a cell stood in quotes.
    decimal = _decimal(rows)
    width, fitting = _narrow(rows, decimal) if narrow else _fitting(rows, decimal)
    if not fitting:
        return None
    if width == 1:
        # A name with blanks is one name: "gz (deg/s)".
        rows = [[" ".join(row)] if row else [] for row in rows]
    start = _start(fitting, len(lines))
    return LineSplit(delimiter, decimal, rows, width, start, tuple(i for i in fitting if i >= start), ended)


def _cells(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    """Return the cells of each line; none of an empty one."""
    return [split_line(line, delimiter) if line.strip() else [] for line in lines]


def _have_ends(lines: Sequence[str]) -> bool:
    """Return whether most lines end with a semicolon."""
    return sum(line.rstrip().endswith(";") for line in lines) > 0.5 * len(lines)


def without_ends(block: bytes) -> bytes:
    """Return a block without the semicolons that end its lines."""
    return re.sub(rb"[; \t]+$", b"", block, flags=re.MULTILINE)


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
    commas = sum(bool(_COMMA_NUMBER.fullmatch(cell)) for row in rows for cell in row)
    points = sum(bool(_DOT_NUMBER.fullmatch(cell)) for row in rows for cell in row)
    return "," if commas > points else "."


def _numbers(row: Sequence[str], decimal: str) -> int:
    plain = sum(1 for cell in row if _NUMBER.fullmatch(cell))
    return plain + (sum(1 for cell in row if _COMMA_NUMBER.fullmatch(cell)) if decimal == "," else 0)
