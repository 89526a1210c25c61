"""Which columns of a table may be the sensors', from its numbers alone: shown to the user, never taken.

The magnitude of gravity finds the accelerometer of a narrow table at rest, and is wrong on wide or moving
ones.
"""

from collections.abc import Callable, Sequence

import numpy as np

from imucal.arrays import FloatArray
from imucal.readers.tables.dates import is_text_stamp, is_time_of_day, text_kind
from imucal.readers.tables.line_splits import is_number
from imucal.readers.tables.scales import median_size
from imucal.units import G0

#: Beyond this many columns of numbers, three that have the size of gravity may be anything.
_NARROW = 8


def propose_columns(
    cells: Callable[[int], Sequence[str]],
    width: int,
    *,
    time: str = "",
    taken: Sequence[int] = (),
    suffix: str = "",
) -> str:
    """Return a columns text such as ``t=0,g=1:4,a=4:7`` for a table; empty where it has none of numbers.

    Parameters
    ----------
    cells
        First cells of a column, by its index, of `width` columns.
    time
        The time's columns, where they are known; else the first that only goes on.
    taken
        Columns that are of no sensor.
    suffix
        Which rows are meant, such as ``@imu``.
    """
    numeric = [index for index in range(width) if index not in taken and _is_numeric(cells(index))]
    if len(numeric) < 3:
        return _single_axis(numeric, time, suffix)
    table = np.array([[float(cell) for cell in cells(index)] for index in numeric], dtype=np.float64).T
    time = time or _text_time(cells, width)
    onward = None if time else _time_column(table)
    accel = _gravity(table, onward) if len(numeric) <= _NARROW else None
    return _proposal(numeric, onward, accel, time=time, suffix=suffix)


def _single_axis(numeric: Sequence[int], time: str, suffix: str) -> str:
    """Return the columns text of one axis, or of a time and one axis: the last column is it."""
    if not numeric or (len(numeric) == 2 and time):
        return ""
    time = time or (str(numeric[0]) if len(numeric) == 2 else "")
    return (f"t={time}," if time else "") + f"gz={numeric[-1]}{suffix}"


def _is_numeric(cells: Sequence[str]) -> bool:
    return bool(cells) and all(map(is_number, cells))


def _text_time(cells: Callable[[int], Sequence[str]], width: int) -> str:
    """Return the columns of a time that is a text: a date with a time, or a date, a time and AM or PM."""
    for index in range(width):
        column = cells(index)
        if column and all(map(is_text_stamp, column)):
            return str(index)
        if text_kind(column) == "date" and index + 1 < width and all(map(is_time_of_day, cells(index + 1))):
            half = index + 2 < width and text_kind(cells(index + 2)) == "half"
            return "+".join(map(str, range(index, index + 2 + half)))
    return ""


def _proposal(
    numeric: Sequence[int], onward: int | None, accel: int | None, *, time: str = "", suffix: str = ""
) -> str:
    """Return the columns text: time, the accelerometer where gravity showed it, the gyroscope beside it."""
    free = {i for i in range(len(numeric)) if i != onward}
    starts = [i for i in sorted(free) if {i + 1, i + 2} <= free and numeric[i + 2] == numeric[i] + 2]
    if accel is None:
        gyro = next(iter(starts), None)
        accel = next((i for i in starts if i >= starts[0] + 3), None)
    else:
        gyro = _nearest(starts, accel)
    if gyro is None and accel is None:
        return ""
    time = str(numeric[onward]) if onward is not None else time
    parts = [f"t={time}"] if time else []
    for key, first in (("g", gyro), ("a", accel)):
        if first is not None:
            parts.append(f"{key}={numeric[first]}:{numeric[first] + 3}{suffix}")
    return ",".join(parts)


def _nearest(starts: Sequence[int], accel: int) -> int | None:
    """Return the first column of three that stand right beside the accelerometer, or anywhere else."""
    apart = [i for i in starts if abs(i - accel) >= 3]
    return next((i for i in apart if abs(i - accel) == 3), next(iter(apart), None))


def _gravity(table: FloatArray, time: int | None) -> int | None:
    """Return the first column of the only triad with the magnitude of gravity, time left out."""
    free = [i for i in range(table.shape[1]) if i != time]
    found = []
    for i in range(0, len(free) - 2, 3):
        size = median_size(table[:, free[i : i + 3]])
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
