"""Which columns a sensor is likely in, where names don't say: one score of names, numbers and neighbours.

Nothing is read by it: a message shows the columns as a text, and the user types it. Below the threshold
nothing is shown, as the x and y of a robot, or latitudes, are no gyroscope.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from imucal.readers.scales import infer_accel_unit
from imucal.readers.tables.columns import NamedTable, Triad, sensor_of_name, triad_of_axes
from imucal.readers.tables.dates import is_text_stamp, is_time_of_day, text_kind
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import NamedColumn, Role, is_of_something_else, plain_name
from imucal.recording import AXES, Sensor

#: Less speaks for nothing.
_THRESHOLD = 2
#: What speaks for a sensor: a name that is its own, one that has a part of it, and a vector x, y, z of which
#: nothing is said beside the other sensor. A name that says something unknown speaks against it.
_NAMED, _HINTED, _VECTOR, _UNKNOWN = 4, 3, 2, -1
#: The mean vector is gravity, or the columns stand beside those where it is.
_GRAVITY = _BESIDE = 3
#: Neighbours have at most one column, such as the time, between them.
_APART = 2
#: Beyond this many columns of numbers, three that have the size of gravity may be anything.
_NARROW = 8
#: Parts of names: ``accl0``, ``LN_ACCELX``, ``turnRate1``.
_HINTS = {
    Sensor.GYROSCOPE: re.compile(r"gyr|omega|ang.*(vel|rate)|turn|rot|rate"),
    Sensor.ACCELEROMETER: re.compile(r"acc|force"),
}
#: The number of an axis behind the name of a vector.
_NUMBERED = re.compile(r"(.*\D)(\d)(\W*)")


def may_be_samples(table: NamedTable, column: NamedColumn) -> bool:
    """Return whether a column holds numbers, and its name says nothing else than samples."""
    cells = table.filled(column.index)
    counts = column.role is Role.COUNTER and all(map(str.isdecimal, cells))
    if counts or column.role in {Role.TIME, Role.TEMPERATURE} or is_of_something_else(column):
        return False
    return _is_numeric(cells)


def likely(
    table: NamedTable, found: Mapping[Sensor, Triad | None] | None = None, *, taken: Sequence[int] = ()
) -> dict[Sensor, Triad | None]:
    """Return the columns of each sensor: those `found`, or the likeliest; None of less than the threshold."""
    chosen: dict[Sensor, Triad | None] = dict.fromkeys(Sensor) | dict(found or {})
    for sensor in sorted(Sensor, key=lambda sensor: sensor is Sensor.GYROSCOPE):
        if chosen[sensor] is not None:
            continue
        used = {*taken, *(index for triad in chosen.values() if triad for index in triad.indices)}
        free = [c for c in table.columns if c.index not in used and may_be_samples(table, c)]
        other = next((triad for triad in chosen.values() if triad), None)
        scored = [(_score(table, axes, sensor, other, len(free)), axes) for axes in _sets(free)]
        best = max(scored, key=lambda pair: (pair[0], len(pair[1])), default=(0, {}))
        if best[0] >= _THRESHOLD and (len(best[1]) == len(AXES) or best[0] >= _NAMED):
            chosen[sensor] = triad_of_axes(sensor, best[1])
    return chosen


def _sets(free: Sequence[NamedColumn]) -> Iterator[dict[int, NamedColumn]]:
    """Yield columns whose names differ in their axis alone; then those without an axis, three by three."""
    families: dict[tuple[str, ...], dict[int, NamedColumn]] = {}
    for column in free:
        tail = _NUMBERED.fullmatch(plain_name(column.header))
        if column.axis is not None and not column.numbered:
            families.setdefault(column.words, {}).setdefault(column.axis, column)
        elif tail:
            # Numbers may count from 1, which only three of them tell.
            families.setdefault(("", tail[1], tail[3]), {})[int(tail[2])] = column
    sets = [axes for key, axes in families.items() if key[:1] != ("",)]
    counted = [axes for key, axes in families.items() if key[:1] == ("",) and len(axes) == len(AXES)]
    firsts = ((min(axes), axes) for axes in counted if sorted(axes) in ([0, 1, 2], [1, 2, 3]))
    sets += [{number - first: column for number, column in axes.items()} for first, axes in firsts]
    yield from sets
    named = {column.index for axes in sets if len(axes) == len(AXES) for column in axes.values()}
    plain = [column for column in free if column.index not in named]
    while plain:
        run = [column for at, column in enumerate(plain[:3]) if column.index == plain[0].index + at]
        if len(run) == len(AXES):
            yield dict(enumerate(run))
        plain = plain[len(run) :]


def _score(
    table: NamedTable, axes: Mapping[int, NamedColumn], sensor: Sensor, other: Triad | None, free: int
) -> int:
    """Return how much speaks for a sensor in some columns, of `free` that it may be in."""
    columns = list(axes.values())
    (opposite,) = set(Sensor) - {sensor}
    names = [plain_name(column.header) for column in columns]
    if any(map(_HINTS[opposite].search, names)) or Role(str(opposite)) in {c.role for c in columns}:
        return -_NAMED
    if all(column.role is Role(str(sensor)) for column in columns):
        return _NAMED
    # A group's name may stand above the first of its columns alone.
    if _HINTS[sensor].search(names[0]) and all(_HINTS[sensor].search(name) or not name for name in names):
        return _HINTED
    score = _kind_score(columns)
    if other is None:
        # Gravity tells of three columns only, and of a few.
        told = sensor is Sensor.ACCELEROMETER and len(columns) == len(AXES) and free <= _NARROW
        return score + (_GRAVITY if told and _is_gravity(table, [axes[at] for at in range(3)]) else 0)
    theirs = [table.columns[index] for index in other.indices]
    if all(column.role is Role.VECTOR for column in columns):
        return _VECTOR
    near = min(abs(a.index - b.index) for a in columns for b in theirs) <= _APART
    alike = _kind_score(theirs) == score and not any(c.role in {*map(Role, Sensor)} for c in theirs)
    return score + (_BESIDE if near and alike and len(columns) == len(AXES) else 0)


def _kind_score(columns: Sequence[NamedColumn]) -> int:
    return _UNKNOWN if any(c.header.strip() and c.role is not Role.VECTOR for c in columns) else 0


def _is_gravity(table: NamedTable, columns: Sequence[NamedColumn]) -> bool:
    """Return whether the mean vector of three columns is gravity, in some unit."""
    rows = np.array([[float(cell) for cell in table.filled(column.index)] for column in columns]).T
    if rows.ndim != 2:
        return False
    rows = rows[np.isfinite(rows).all(axis=1)]
    guess = infer_accel_unit(rows)
    return guess.unit is not None and float(np.linalg.norm(rows.mean(axis=0))) > 0.6 * np.median(
        np.linalg.norm(rows, axis=1)
    )


def proposal(table: NamedTable, *, name: str = "", rows: str = "") -> str:
    """Return a columns text for a table, such as ``t=0,g=1:4,a=4:7``; empty where not enough speaks for one.

    `name` is the file's, and `rows` says which rows are meant, such as ``@imu``.
    """
    time = table.time or _text_time(table) or _onward(table)
    taken = [int(index) for index in time.split("+") if index]
    chosen = likely(table, taken=taken)
    if not any(chosen.values()):
        chosen = _one_axis(table, taken, name)
    if not any(chosen.values()):
        return ""
    return table.columns_text(*chosen.values(), rows=rows, time=time)


def _one_axis(table: NamedTable, taken: Sequence[int], name: str) -> dict[Sensor, Triad | None]:
    """Return the only column of a log of one axis, about z; of a name that says nothing the file's may."""
    free = [c for c in table.columns if c.index not in taken and _is_numeric(table.filled(c.index))]
    sensor = sensor_of_name(name)
    if len(free) != 1 or (free[0].header.strip() and sensor is None):
        return {}
    sensor = sensor or Sensor.GYROSCOPE
    return {sensor: triad_of_axes(sensor, {2: free[0]})}


def _is_numeric(cells: Sequence[str]) -> bool:
    return bool(cells) and all(map(is_number, cells))


def _onward(table: NamedTable) -> str:
    """Return the first column of numbers that only goes on, beside others."""
    numeric = [c.index for c in table.columns if _is_numeric(table.filled(c.index))]
    for index in numeric if len(numeric) > 1 else ():
        steps = [b - a for a, b in pairwise(map(float, table.filled(index)))]
        if steps and min(steps) >= 0 < max(steps):
            return str(index)
    return ""


def _text_time(table: NamedTable) -> str:
    """Return the columns of a time that is a text: a date with a time, or a date, a time and AM or PM."""
    width = len(table.columns)
    for index in range(width):
        column = table.cells(index)
        if column and all(map(is_text_stamp, column)):
            return str(index)
        if (
            text_kind(column) == "date"
            and index + 1 < width
            and all(map(is_time_of_day, table.cells(index + 1)))
        ):
            half = index + 2 < width and text_kind(table.cells(index + 2)) == "half"
            return "+".join(map(str, range(index, index + 2 + half)))
    return ""
