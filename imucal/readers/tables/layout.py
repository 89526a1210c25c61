"""How a text table is laid out: delimiter, header, units, preamble, where the data start."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from imucal.readers.tables.line_splits import LineSplit, line_splits, split_line, without_ends
from imucal.readers.tables.table_header import find_header, fitted_names

#: Rows of a sensor: the index of a column, -1 for any, and the text its cells must hold; None for all rows.
Rows: TypeAlias = tuple[int, str] | None

#: A delimiter is a candidate where it gives this share of the best one's cells.
_CLOSE = 0.5

_RATE = re.compile(
    r"(?:update|sampl\w*|output|data)[\s_]*(?:rate|freq\w*)[^0-9\n]{0,12}(?P<rate>\d+(?:\.\d+)?)\s*(?P<kilo>k?)hz\b"
    r"|(?:^|[\s#\"])(?:fs|sampl\w*[\s_]*(?:rate|freq\w*)|update[\s_]*rate|rate_hz|frequency)(?:\s*[(\[]hz[)\]])?"
    r"\s*[\"]?\s*[,;:=\t]\s*[\"]?(?P<plain>\d+(?:\.\d+)?)\s*(?P<kilos>(?:khz)?)",
    re.IGNORECASE | re.MULTILINE,
)


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

    def cells(self, index: int) -> list[str]:
        """Return the first cells of a column, decimal point in place."""
        cells = [row[index] for row in self.rows if index < len(row)]
        return [cell.replace(",", ".") for cell in cells] if self.decimal == "," else cells


def find_layout(lines: Sequence[str]) -> TextLayout | None:
    """Return the layout of a table from its first lines; None where they hold no rows of numbers."""
    splits = line_splits(lines)
    if not splits:
        return None
    layouts = [_finish(lines, split) for split in splits if split.score >= _CLOSE * splits[0].score]
    # Blanks within dates and names make more cells than there are names.
    return next((layout for layout in layouts if layout.headers), layouts[0])


def rows_of_tag(lines: Sequence[str], delimiter: str, rows: tuple[int, str]) -> list[str]:
    """Return the lines whose cell holds a tag."""
    index, tag = rows
    found = []
    for line in lines:
        cells = [cell.strip("\"'") for cell in split_line(line, delimiter)]
        if tag in (cells if index < 0 else cells[index : index + 1]):
            found.append(line)
    return found


def _finish(lines: Sequence[str], split: LineSplit) -> TextLayout:
    line, headers, units = find_header(split)
    before = lines[: line if line is not None else split.start]
    headers, mismatch = fitted_names(headers, split)
    match = _RATE.search("\n".join(lines[: split.start]))
    rate = None
    if match:
        rate = float(match["rate"] or match["plain"]) * (1000 if match["kilo"] or match["kilos"] else 1)
    return TextLayout(
        delimiter=split.delimiter,
        decimal=split.decimal,
        width=split.width,
        headers=tuple(headers),
        units=tuple(units),
        preamble=tuple(text for text in before if text.strip()),
        start=split.start,
        rows=tuple(tuple(split.rows[i]) for i in split.fitting),
        rate_hz=rate if rate and rate > 0 else None,
        quoted=any('"' in lines[i] for i in split.fitting),
        mismatch=mismatch,
        prepare=without_ends if split.ended else None,
    )
