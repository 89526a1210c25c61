"""Propose columns for a sensor if their names are ambiguous, by a score of names, numbers and neighbours.

A proposal only appears in a message, and the user types it. Below the threshold there is no proposal: the
x and y of a robot, or latitudes, are no gyroscope.
"""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from imucal.readers.scales import shows_gravity
from imucal.readers.tables.columns import NamedTable, Triad
from imucal.readers.tables.dates import is_text_stamp
from imucal.readers.tables.names import NamedColumn, Role, is_of_something_else, plain_name, sensor_of_name
from imucal.readers.tables.stamps import dates_and_times
from imucal.recording import AXES, Sensor

#: Lowest score of a proposal.
_THRESHOLD = 2
#: Scores: the sensor's own name, a part of that name, an unnamed vector x, y, z if the other sensor is known,
#: and an unknown name.
_NAMED, _HINTED, _VECTOR, _UNKNOWN = 4, 3, 2, -1
#: Scores: the mean vector is gravity, or the columns are next to the other sensor's.
_GRAVITY = _BESIDE = 3
#: Score: the rows have the tag of an inertial sensor.
_TAGGED = 2
#: Neighbours have at most one column, such as the time, between them.
_APART = 2
#: Most numeric columns in which the size of gravity identifies an accelerometer.
_NARROW = 8
#: Parts of names: ``accl0``, ``LN_ACCELX``, ``turnRate1``.
_HINTS = {
    Sensor.GYROSCOPE: re.compile(r"gyr|omega|ang.*(vel|rate)|turn|rot|rate"),
    Sensor.ACCELEROMETER: re.compile(r"acc|force"),
}
#: The name of a vector, then the number of an axis.
_NUMBERED = re.compile(r"(.*\D)(\d)(\W*)")


def may_be_samples(column: NamedColumn) -> bool:
    """Return whether a column contains numbers and its name does not exclude samples."""
    counts = column.role is Role.COUNTER and column.counts
    if counts or column.role in {Role.TIME, Role.TEMPERATURE} or is_of_something_else(column):
        return False
    return column.is_numeric


def likely(
    table: NamedTable,
    found: Mapping[Sensor, Triad | None] | None = None,
    *,
    taken: Sequence[int] = (),
    tagged: bool = False,
) -> dict[Sensor, Triad | None]:
    """Return the columns of each sensor: `found`, or the likeliest; None if the score is too low.

    Columns in `taken` are excluded. `tagged` means that the rows belong to an inertial sensor.
    """
    chosen: dict[Sensor, Triad | None] = dict.fromkeys(Sensor) | dict(found or {})
    # The accelerometer first: gravity identifies it.
    for sensor in reversed(Sensor):
        if chosen[sensor] is None:
            others = list(filter(None, chosen.values()))
            chosen[sensor] = _likeliest(table, sensor, others, taken, tagged=tagged)
    return chosen


def _likeliest(
    table: NamedTable, sensor: Sensor, others: Sequence[Triad], taken: Sequence[int], *, tagged: bool
) -> Triad | None:
    """Return the free columns with the highest score for a sensor; None if it is too low."""
    used = {*taken, *(index for triad in others for index in triad.indices)}
    free = [c for c in table.columns if c.index not in used and may_be_samples(c)]
    by_others = partial(_score, sensor=sensor, others=others, tagged=tagged, several=len(free) > _NARROW)
    scored = [(_name_score(axes, sensor) or by_others(axes), axes) for axes in _sets(free)]
    # If scores are equal, the gyroscope comes first, as is usual.
    scored = scored if sensor is Sensor.GYROSCOPE else scored[::-1]
    score, best = max(scored, key=lambda pair: (pair[0], len(pair[1])), default=(0, {}))
    whole = len(best) == len(AXES) or score >= _NAMED
    return Triad.of(sensor, best) if score >= _THRESHOLD and whole else None


def _sets(free: Sequence[NamedColumn]) -> list[dict[int, NamedColumn]]:
    """Return columns whose names differ only in the axis, then the other columns in threes."""
    lettered: dict[tuple[str, ...], dict[int, NamedColumn]] = {}
    counted: dict[tuple[str, str], dict[int, NamedColumn]] = {}
    for column in free:
        tail = _NUMBERED.fullmatch(plain_name(column.header))
        if column.axis is not None and not column.numbered:
            lettered.setdefault(column.words, {}).setdefault(column.axis, column)
        elif tail:
            counted.setdefault((tail[1], tail[3]), {})[int(tail[2])] = column
    sets = list(lettered.values())
    # Numbers may start at 1, which only a complete set shows.
    whole = [axes for axes in counted.values() if sorted(axes) in ([0, 1, 2], [1, 2, 3])]
    sets += [{number - min(axes): column for number, column in axes.items()} for axes in whole]
    named = {column.index for axes in sets if len(axes) == len(AXES) for column in axes.values()}
    return sets + _threes([column for column in free if column.index not in named])


def _threes(plain: Sequence[NamedColumn]) -> list[dict[int, NamedColumn]]:
    """Return groups of three adjacent columns."""
    found = []
    while plain:
        run = [column for at, column in enumerate(plain[:3]) if column.index == plain[0].index + at]
        if len(run) == len(AXES):
            found.append(dict(enumerate(run)))
        plain = plain[len(run) :]
    return found


def _name_score(axes: Mapping[int, NamedColumn], sensor: Sensor) -> int:
    """Return the score of the columns' names for a sensor; 0 if they name neither sensor."""
    (opposite,) = set(Sensor) - {sensor}
    names = [plain_name(column.header) for column in axes.values()]
    said = {column.sensor for column in axes.values()}
    if any(map(_HINTS[opposite].search, names)) or opposite in said:
        return -_NAMED
    if said == {sensor}:
        return _NAMED
    # A group's name may be only above its first column.
    own = [name for name in names if not _HINTS[sensor].search(name)]
    return _HINTED if len(own) < len(names) and not any(own) and names[0] else 0


def _score(
    axes: Mapping[int, NamedColumn], sensor: Sensor, others: Sequence[Triad], *, tagged: bool, several: bool
) -> int:
    """Return the score of columns whose names do not help, from the other sensor's columns or gravity.

    With the other sensor known, an unnamed vector scores, or columns next to it with similar names. Gravity
    does not count if the table has `several` candidates.
    """
    if len(axes) != len(AXES):
        return 0
    columns = [axes[at] for at in range(len(AXES))]
    score = _TAGGED * tagged + _unknown(columns)
    if not others:
        told = sensor is Sensor.ACCELEROMETER and not several and _is_gravity(columns)
        return score + _GRAVITY * told
    if all(column.role is Role.VECTOR for column in columns):
        return score + _VECTOR
    theirs = others[0].columns
    near = min(abs(a.index - b.index) for a in columns for b in theirs) <= _APART
    alike = not any(column.sensor for column in theirs) and _unknown(theirs) == _unknown(columns)
    return score + _BESIDE * (near and alike)


def _unknown(columns: Sequence[NamedColumn]) -> int:
    """Return the penalty for columns with unknown names."""
    return _UNKNOWN if any(c.header.strip() and c.role is not Role.VECTOR for c in columns) else 0


def _is_gravity(columns: Sequence[NamedColumn]) -> bool:
    """Return whether the mean vector of three columns is gravity in some unit."""
    cells = [column.filled for column in columns]
    if len({len(column) for column in cells}) > 1:
        return False
    rows = np.array([[float(cell) for cell in column] for column in cells]).T
    return shows_gravity(rows[np.isfinite(rows).all(axis=1)])


def proposal(table: NamedTable, *, name: str = "", rows: str = "") -> str:
    """Return a columns text for a table, such as ``t=0,g=1:4,a=4:7``; empty if no score is high enough.

    `name` is the file name, and `rows` selects rows, such as ``@imu``.
    """
    time = _time(table)
    taken = [int(index) for index in time.split("+") if index]
    chosen = likely(table, taken=taken, tagged=bool(rows))
    if not any(chosen.values()):
        # A log of one axis, taken as z; the file name may name the sensor if the header does not.
        free = [column for column in table.columns if column.index not in taken and column.is_numeric]
        sensor = sensor_of_name(name)
        if len(free) != 1 or (free[0].header and sensor is None):
            return ""
        return table.columns_text(Triad.of(sensor or Sensor.GYROSCOPE, {2: free[0]}), rows=rows, time=time)
    return table.columns_text(*chosen.values(), rows=rows, time=time)


def _time(table: NamedTable) -> str:
    """Return the time columns: by name, by text (date, time, AM or PM), or the first that never decreases."""
    if table.time:
        return table.time
    dated = {columns[0].index: columns for columns in dates_and_times(table)}
    for column in table.columns:
        if column.cells and all(map(is_text_stamp, column.cells)):
            return str(column.index)
        if column.index in dated:
            return "+".join(str(part.index) for part in dated[column.index])
    numeric = [column for column in table.columns if column.is_numeric]
    for column in numeric if len(numeric) > 1 else ():
        steps = [b - a for a, b in pairwise(map(float, column.filled))]
        if steps and min(steps) >= 0 < max(steps):
            return str(column.index)
    return ""
