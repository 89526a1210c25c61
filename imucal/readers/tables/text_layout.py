"""The layout of a text log, or the error that proposes which columns are which."""

import re
from collections import Counter
from collections.abc import Sequence

from imucal.errors import ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.column_plan import works
from imucal.readers.tables.columns import NamedTable
from imucal.readers.tables.columns_text import ColumnsError, list_columns
from imucal.readers.tables.dialects import find_messages, name_columns
from imucal.readers.tables.layout import TextLayout, find_layout, rows_of_tag
from imucal.readers.tables.line_splits import is_number, split_line
from imucal.readers.tables.names import parse_column
from imucal.readers.tables.proposals import propose_columns

#: A tag that marks the rows of an inertial sensor.
_INERTIAL = re.compile(
    r"\$?(imu|gyr|acc|raw_?imu|scaled_?imu|inertial|sensor_combined|ins)\w*", re.IGNORECASE
)


def lay_out(path: str, lines: Sequence[str], options: ReadOptions) -> TextLayout:
    """Find the layout of a text: messages of a known dialect, or a table.

    A ReadError where it holds no rows of numbers, a ChoiceError where its header doesn't fit them.
    """
    messages = find_messages(lines)
    if messages is not None:
        return messages
    layout = find_layout(lines)
    if layout is None:
        first = next((line.strip() for line in lines if line.strip()), "")
        msg = (
            f"{path}: no rows of numbers, the first line is {first[:80]!r}; "
            "expected a table with a row per sample"
        )
        raise ReadError(msg)
    layout = name_columns(layout)
    if options.columns is not None or layout.headers:
        return layout
    problem = f"no header names the {layout.width} columns, and an order is not guessed"
    if layout.mismatch is not None:
        problem = (
            f"the header has {layout.mismatch} names and the rows {layout.width} cells, so no name "
            "belongs to a column"
        )
    found = list_columns([""] * layout.width, layout.cells)
    raise ColumnsError(path, problem, found, _propose(path, lines, layout, options))


def _propose(path: str, lines: Sequence[str], layout: TextLayout, options: ReadOptions) -> str:
    """Return a columns text that works on a table without names; empty where there is none."""
    tags = _inertial_tags(lines, layout.delimiter)
    suffix = f"@{tags[0]}" if tags else ""
    if tags:
        layout = find_layout(rows_of_tag(lines, layout.delimiter, (-1, tags[0]))) or layout
    gyro, accel = _first(tags, "gyr"), _first(tags, "acc")
    numeric = [index for index in range(layout.width) if all(map(is_number, layout.cells(index)))]
    texts = []
    if gyro and accel and len(numeric) == 4:
        axes = f"{numeric[1]}:{numeric[1] + 3}"
        texts.append(f"t={numeric[0]},g={axes}@{gyro},a={axes}@{accel}")
    texts.append(propose_columns(layout.cells, layout.width, suffix=suffix))
    columns = tuple(parse_column("", index) for index in range(layout.width))
    table = NamedTable(path=path, columns=columns, cells=layout.cells, dialect=None)
    return next((text for text in texts if text and works(table, options, text)), "")


def _first(tags: Sequence[str], start: str) -> str | None:
    return next((tag for tag in tags if tag.lower().startswith(start)), None)


def _inertial_tags(lines: Sequence[str], delimiter: str) -> list[str]:
    """Return the texts of cells that name an inertial sensor, the most frequent first."""
    cells = (cell.strip("\"'") for line in lines for cell in split_line(line, delimiter)[:3])
    return [tag for tag, _ in Counter(filter(_INERTIAL.fullmatch, cells)).most_common()]
