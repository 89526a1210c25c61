"""The header of a text table: names of its columns, in one row or two, and a row of their units."""

import re
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest

from imucal.readers.tables.dates import is_time_of_day, text_kind
from imucal.readers.tables.line_splits import BLANKS, LineSplit
from imucal.units import is_unit

#: Names of a header's second row, and what stands in brackets beside them.
_AXES = frozenset(("", "w", "x", "y", "z"))
_UNIT_PART = re.compile(r"[\[(][^\])]*[\])]")
#: A date that stands behind this many columns is none of a row's time.
_STAMP_FIRST = 6


def find_header(split: LineSplit) -> tuple[int | None, list[str], list[str | None]]:
    """Return the header's line, its names and the units of a row of units."""
    units: list[str | None] = []
    for line in range(split.start - 1, -1, -1):
        row = split.rows[line]
        row = row[1:] if row and row[0] in {"#", "%", "//"} else row
        # The cells of a date, a time and AM or PM may have one name.
        fewest = -max(1, _stamp_cells(split)[1] - 1)
        if not fewest <= len(row) - split.width <= 1 or len(row) < min(2, split.width):
            continue
        if not units and _is_row_of_units(row):
            units = [unit if is_unit(unit) else None for unit in (cell.strip("[]()") for cell in row)]
        elif any(re.search(r"[^\W\d_]", cell) for cell in row):
            above = split.rows[line - 1] if line else []
            return line, _two_rows(above, row), units
    return None, [], units


def _is_row_of_units(row: Sequence[str]) -> bool:
    units = sum(is_unit(cell.strip("[]()")) for cell in row)
    # One alone may be a name: t is a time and a tesla.
    return units >= max(0.3 * len(row), min(2, len(row))) and not _is_axes(row)


def _is_axes(row: Sequence[str]) -> bool:
    """Return whether a row names axes, perhaps with their units, and only the unit of a time beside them."""
    cells = [_UNIT_PART.sub("", cell).strip("\"' ").lower() for cell in row]
    return {"x", "y", "z"} <= set(cells) and all(cell in _AXES or is_unit(cell) for cell in cells)


def _two_rows(above: Sequence[str], row: list[str]) -> list[str]:
    """Join a header of two lines: groups above, x, y, z below."""
    if not _is_axes(row) or not 2 <= len(above) <= len(row) + 1 or not any(above):
        return _labelled(row)
    group, names = "", []
    for name, axis in zip_longest(above[: len(row)], row, fillvalue=""):
        group = name or group
        names.append(f"{group} {axis}".strip())
    return names


def _labelled(row: list[str]) -> list[str]:
    """Give repeated names x, y, z the name of the column before them, as rosbag_to_csv means it."""
    if Counter(cell.lower() for cell in row)["x"] < 2:
        return row
    label, names = "", []
    for cell in row:
        if cell.lower() in {"x", "y", "z", "w"}:
            names.append(f"{label} {cell}".strip())
        else:
            label = cell
            names.append(cell)
    return names


def _stamp_cells(split: LineSplit) -> tuple[int, int]:
    """Return where the cells of one time start, and their number: blanks cut a date from its time."""
    columns = [[split.rows[i][at] for i in split.fitting] for at in range(min(split.width, _STAMP_FIRST))]
    kinds = [text_kind(cells) for cells in columns]
    for at in range(len(kinds) - 1):
        if split.delimiter == BLANKS and kinds[at] == "date" and all(map(is_time_of_day, columns[at + 1])):
            return at, 3 if kinds[at + 2 : at + 3] == ["half"] else 2
    return 0, 1


def fitted_names(headers: list[str], split: LineSplit) -> tuple[list[str], int | None]:
    """Return as many names as cells, and the number of names where they don't fit."""
    if not headers or len(headers) == split.width:
        return headers, None
    at, cells = _stamp_cells(split)
    named = cells - (split.width - len(headers))
    if 0 < named < cells:
        names = [*(["date"] if named == 1 else []), *headers[at : at + named], "am/pm"][:cells]
        return [*headers[:at], *names, *headers[at + named :]], None
    if len(headers) == split.width + 1 and not headers[-1]:
        return headers[:-1], None
    last_empty = all(not split.rows[i][-1] for i in split.fitting)
    if len(headers) == split.width - 1 and last_empty:
        return [*headers, ""], None
    return [], len(headers)
