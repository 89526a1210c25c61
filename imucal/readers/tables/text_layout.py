"""The layout of a text log, or the error that proposes which columns are which.

A proposal is only ever shown: the magnitude of gravity finds the accelerometer of a narrow table at
rest, and is wrong on wide or moving ones.
"""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError, ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns_text import EXAMPLE
from imucal.readers.tables.dialects import find_messages, name_columns
from imucal.readers.tables.layout import TextLayout, find_layout, is_number, rows_of_tag, split_line
from imucal.units import G0

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
    if layout.mismatch is not None and options.columns is None:
        msg = (
            f"{path}: the header has {layout.mismatch} names and the rows {layout.width} cells, so no name "
            f"belongs to a column; found the row {', '.join(layout.rows[0][:40])}; "
            f"correct the header, or say which columns are which by a columns text such as {EXAMPLE} "
            "(places from 0 with the end left out)"
        )
        raise ChoiceError(msg)
    layout = name_columns(layout)
    if not layout.headers and options.columns is None:
        shown = ", ".join(f"{index} {cell}" for index, cell in enumerate(layout.rows[0][:40]))
        msg = (
            f"{path}: no header names the {layout.width} columns, and an order is not guessed; "
            f"found the row {shown}; "
            "expected a header, or a columns text that says which are which, such as "
            f"{_propose_columns(lines, layout)} (places from 0 with the end left out; check which is which)"
        )
        raise ChoiceError(msg)
    return layout


def _propose_columns(lines: Sequence[str], layout: TextLayout) -> str:
    """Return a columns text to start from, for a table without a header."""
    tags = _inertial_tags(lines, layout.delimiter)
    suffix = f"@{tags[0]}" if tags else ""
    if tags:
        layout = find_layout(rows_of_tag(lines, layout.delimiter, (-1, tags[0]))) or layout
    numeric = [index for index in range(layout.width) if _is_numeric(layout, index)]
    if len(numeric) < 3:
        # One axis, or a time and one axis: the last column is it.
        before = f"t={numeric[0]}," if len(numeric) == 2 else ""
        return f"{before}gz={numeric[-1]}{suffix}" if numeric else EXAMPLE
    table = np.array([layout.cells(index) for index in numeric], dtype=np.float64).T
    time = _time_column(table)
    gyro_tag, accel_tag = _first(tags, "gyr"), _first(tags, "acc")
    if gyro_tag and accel_tag and len(numeric) == 4 and time == 0:
        axes = f"{numeric[1]}:{numeric[1] + 3}"
        return f"t={numeric[0]},g={axes}@{gyro_tag},a={axes}@{accel_tag}"
    accel = _gravity(table, time) if len(numeric) <= 8 else None
    return _proposal(numeric, time, accel, suffix)


def _first(tags: Sequence[str], start: str) -> str | None:
    return next((tag for tag in tags if tag.lower().startswith(start)), None)


def _proposal(numeric: Sequence[int], time: int | None, accel: int | None, suffix: str) -> str:
    """Return the columns text: time, the accelerometer where gravity showed it, the gyroscope beside it."""
    free = {i for i in range(len(numeric)) if i != time}
    starts = [i for i in sorted(free) if {i + 1, i + 2} <= free and numeric[i + 2] == numeric[i] + 2]
    if accel is None:
        gyro = next(iter(starts), None)
        accel = next((i for i in starts if i >= starts[0] + 3), None)
    else:
        gyro = _nearest(starts, accel)
    if gyro is None and accel is None:
        return EXAMPLE
    parts = [f"t={numeric[time]}"] if time is not None else []
    for key, first in (("g", gyro), ("a", accel)):
        if first is not None:
            parts.append(f"{key}={numeric[first]}:{numeric[first] + 3}{suffix}")
    return ",".join(parts)


def _nearest(starts: Sequence[int], accel: int) -> int | None:
    """Return the first column of three that stand right beside the accelerometer, or anywhere else."""
    apart = [i for i in starts if abs(i - accel) >= 3]
    return next((i for i in apart if abs(i - accel) == 3), next(iter(apart), None))


def _is_numeric(layout: TextLayout, index: int) -> bool:
    cells = layout.cells(index)
    return len(cells) == len(layout.rows) and bool(cells) and all(map(is_number, cells))


def _gravity(table: FloatArray, time: int | None) -> int | None:
    """Return the first column of the only triad with the magnitude of gravity, time left out."""
    free = [i for i in range(table.shape[1]) if i != time]
    found = []
    for i in range(0, len(free) - 2, 3):
        size = float(np.median(np.sqrt((table[:, free[i : i + 3]] ** 2).sum(axis=1))))
        if free[i + 2] == free[i] + 2 and any(abs(size / gravity - 1) < 0.05 for gravity in (G0, 1.0)):
            found.append(free[i])
    return found[0] if len(found) == 1 else None


def _time_column(table: FloatArray) -> int | None:
    """Return the first column that only goes on."""
    if table.shape[0] < 2:
        return None
    steps = np.diff(table, axis=0)
    onward = (steps >= 0).all(axis=0) & (steps > 0).any(axis=0)
    return int(np.flatnonzero(onward)[0]) if onward.any() else None


def _inertial_tags(lines: Sequence[str], delimiter: str) -> list[str]:
    """Return the texts of cells that name an inertial sensor, the most frequent first."""
    cells = (cell.strip("\"'") for line in lines for cell in split_line(line, delimiter)[:3])
    return [tag for tag, _ in Counter(filter(_INERTIAL.fullmatch, cells)).most_common()]
