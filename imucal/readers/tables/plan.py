"""What to read from a table: its sensors' columns, their times, the temperature, and why these.

Which columns of a table may be the sensors', from its numbers alone: shown to the user, never taken.

The magnitude of gravity finds the accelerometer of a narrow table at rest, and is wrong on wide or moving
ones.

Columns that were not read: a sensor that was not found may be among them, and that is said.

Rows of several sensors in one table: filtered by the column of text that names them, or refused.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import (
    Cells,
    ColumnsError,
    ColumnSpec,
    NamedTable,
    Triad,
    columns_text,
    find_axes,
    find_bare_triads,
    find_temperature,
    find_triads,
    list_columns,
    parse_columns_text,
    pick,
    sensor_of_name,
    triad_of,
)
from imucal.readers.tables.dates import is_text_stamp, is_time_of_day, text_kind
from imucal.readers.tables.dialects import Dialect, find_dialect
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import NamedColumn, Role, is_of_something_else, parse_column
from imucal.readers.tables.scales import given_unit, median_size
from imucal.readers.tables.stamps import TimeChoice, choose_times, named_time, time_of_columns
from imucal.recording import AXES, Axis, Sensor
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
    return _proposals_proposal(numeric, onward, accel, time=time, suffix=suffix)


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


def _proposals_proposal(
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


#: Columns that are listed.
_MOST = 12


def missing_sensor(table: NamedTable, gyro: Triad | None, accel: Triad | None) -> tuple[Finding, ...]:
    """Return a finding where a sensor, or an axis, was not found and columns of numbers were left over.

    Columns x, y, z, or some of them, that are left over may be the sensor: that is a warning, which says
    what names them. Others are listed in a remark.
    """
    found = {Sensor.GYROSCOPE: gyro, Sensor.ACCELEROMETER: accel}
    used = {index for triad in found.values() if triad is not None for index in triad.indices}
    left = [column for column in table.columns if column.index not in used and _may_be_samples(table, column)]
    if not left:
        return ()
    listed = f"columns that were not read: {_listed(left)}."
    findings = []
    for sensor, triad in found.items():
        if triad is not None and triad.axes != AXES:
            text = f"Only {' and '.join(triad.axes)} of the {sensor} was found in the table; {listed}"
            findings.append(Finding(level="info", code="axis-missing", axis=sensor.short, text=text))
        if triad is None:
            findings.append(_not_found(table, sensor, _candidate(left, sensor), found, listed))
    return tuple(findings)


def _not_found(
    table: NamedTable, sensor: Sensor, candidate: Triad | None, found: dict[Sensor, Triad | None], listed: str
) -> Finding:
    text = f"No {sensor} was found in the table; {listed}"
    if candidate is None:
        return Finding(level="info", code="sensor-missing", axis=sensor.short, text=text)
    both = found | {sensor: candidate}
    ready = columns_text(table.time, both[Sensor.GYROSCOPE], both[Sensor.ACCELEROMETER])
    advice = f"If it is among them, give a columns text such as {ready}."
    return Finding(level="warning", code="sensor-missing", axis=sensor.short, text=text, advice=advice)


def _listed(columns: Sequence[NamedColumn]) -> str:
    """Return some columns with their indices, for a message."""
    shown = ", ".join(f"{column.index} {column.header.strip() or '(no name)'}" for column in columns[:_MOST])
    return shown + (f", … {len(columns) - _MOST} more" if len(columns) > _MOST else "")


def _may_be_samples(table: NamedTable, column: NamedColumn) -> bool:
    if column.role in {Role.TIME, Role.COUNTER, Role.TEMPERATURE} or is_of_something_else(column):
        return False
    filled = [cell.strip("\"'") for cell in table.cells(column.index) if cell]
    return bool(filled) and all(map(is_number, filled))


def _candidate(columns: Sequence[NamedColumn], sensor: Sensor) -> Triad | None:
    """Return the columns x, y, z that a sensor may be in: those named as its own before others."""
    families: dict[tuple[str, ...], dict[Axis, NamedColumn]] = {}
    for column in columns:
        if column.axis in {0, 1, 2} and column.role in {Role(str(sensor)), Role.VECTOR, Role.OTHER}:
            families.setdefault(column.family, {}).setdefault(AXES[column.axis], column)
    own = [axes for family, axes in families.items() if family[0] == sensor]
    whole = [axes for axes in families.values() if len(axes) == len(AXES)]
    axes = next(iter(own or whole), None)
    if axes is None:
        return None
    names = tuple(axis for axis in AXES if axis in axes)
    return triad_of(sensor, [axes[name] for name in names], axes=names)


#: Names of columns that say which of several devices, or which of their sensors, a row is of.
_INSTANCE = frozenset(
    (
        *("i", "instance", "imu", "imu_id", "sensor", "sensor_id", "sensorid", "device", "device_id", "dev"),
        *("source", "src", "id", "unit_id", "topic", "frame", "frame_id", "child_frame_id", "name", "tag"),
        *("type", "stream", "channel"),
    )
)
#: Texts that are more than this many are no names of sensors.
_ROW_TAGS_MOST = 8
#: Ready texts that a message shows.
_SHOWN = 4


def rows_of_sensors(
    table: NamedTable, gyro: Triad | None, accel: Triad | None
) -> tuple[Triad | None, Triad | None, str]:
    """Restrict columns that were found by name to the rows of their sensor, where a column of text names it.

    The accelerometer's rows may use the columns that the header names for the gyroscope, and the other
    way round. Also returns how the rows were found; empty where all rows are of the sensors.

    Raises
    ------
    ChoiceError
        If rows of several sensors can't be told apart; the message says how to choose.
    """
    found = _tag_column(table)
    if found is None:
        _refuse_instances(table, gyro, accel)
        return gyro, accel, ""
    index, tags = found
    both: dict[Sensor, Triad | None] = {}
    for sensor, own, other in (
        (Sensor.GYROSCOPE, gyro, accel),
        (Sensor.ACCELEROMETER, accel, gyro),
    ):
        names = tags[sensor]
        columns = own or (_of_other(other, sensor) if names and other is not None else None)
        if columns is not None and len(names) != 1 and (own is not None or names):
            raise _unclear(table, index, columns, names, tags)
        both[sensor] = replace(columns, rows=(index, names[0])) if columns is not None else None
    header = table.columns[index].header.strip() or str(index)
    return both[Sensor.GYROSCOPE], both[Sensor.ACCELEROMETER], f"in the rows that column {header} names"


def _of_other(triad: Triad, sensor: Sensor) -> Triad:
    """Return the columns of one sensor's rows as those of the other's; the unit of these is open."""
    return replace(triad, sensor=sensor, unit=None)


def _tag_column(table: NamedTable) -> tuple[int, dict[Sensor, list[str]]] | None:
    """Return the column of text that names the sensors of rows, and which text names which."""
    for column in table.columns:
        if column.role is Role.TIME:
            continue
        texts = _texts(table, column.index)
        tags = {sensor: [text for text in texts if sensor_of_name(text) is sensor] for sensor in Sensor}
        if len(texts) <= _ROW_TAGS_MOST and any(tags.values()):
            return column.index, tags
    return None


def _texts(table: NamedTable, index: int) -> list[str]:
    """Return the different texts of a column; none where it holds numbers too."""
    cells = {cell.strip("\"'") for cell in table.cells(index) if cell}
    return [] if any(map(is_number, cells)) else sorted(cells)


def _unclear(
    table: NamedTable,
    index: int,
    triad: Triad,
    names: Sequence[str],
    tags: dict[Sensor, list[str]],
) -> Exception:
    """Return the error for rows of which none, or several kinds, are the sensor's."""
    header = table.columns[index].header.strip() or str(index)
    texts = _texts(table, index)
    rows = list(names) or [text for text in texts if not any(text in of_one for of_one in tags.values())]
    rows = rows or texts
    examples = [columns_text(table.time, *_placed(triad), rows=f"@{index}:{text}") for text in rows[:_SHOWN]]
    found = f"{len(names)} of them name" if names else "none of them names"
    problem = f"column {header} says whose a row is ({', '.join(texts)}); {found} the {triad.sensor}"
    return table.ask(problem, example=" or ".join(examples))


def _placed(triad: Triad) -> tuple[Triad | None, Triad | None]:
    return (triad, None) if triad.sensor is Sensor.GYROSCOPE else (None, triad)


def _refuse_instances(table: NamedTable, gyro: Triad | None, accel: Triad | None) -> None:
    """Refuse rows of several sensors in one table: the column I of ArduPilot's IMU message."""
    first = gyro or accel
    columns = [column for column in table.columns if _plain(column.header) in _INSTANCE]
    for column in columns if first is not None else ():
        devices = _devices(table.cells(column.index), table.cells(first.indices[0] if first else 0))
        if len(devices) < 2:
            continue
        name = column.header.strip().strip("\"'")
        at = name if re.fullmatch(r"\w+", name) else str(column.index)
        texts = [columns_text(table.time, gyro, accel, f"@{at}:{cell}") for cell in devices[:_SHOWN]]
        problem = f"rows of {len(devices)} sensors, told apart by column {name} ({', '.join(devices)})"
        raise table.ask(problem, example=" or ".join(texts))


def _plain(header: str) -> str:
    """Return the last part of a name: ``frame_id`` of ``header.frame_id``."""
    return header.strip().strip("\"'").lstrip("#%").strip().lower().rpartition(".")[2]


def _devices(cells: Sequence[str], samples: Sequence[str]) -> list[str]:
    """Return the numbers or names of several devices in the rows that hold samples; none of a single one."""
    pairs = zip(cells, samples, strict=False)
    found = {cell.strip("\"'") for cell, sample in pairs if cell and sample}
    if not 1 < len(found) <= _ROW_TAGS_MOST:
        return []
    if all(map(str.isdigit, found)):
        return sorted(found, key=int)
    return [] if any(map(is_number, found)) else sorted(found)


#: Names of the two clocks of a message; for a table they are not columns.
_CLOCKS = ("header", "log")

#: How columns are found that no tags, and no name of the file, had to tell.
_BY_NAME = "by name"


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPlan:
    """The columns of one sensor: its axes, its stamps, and beside them the time of recording."""

    triad: Triad
    time: TimeChoice | None
    log_time: TimeChoice | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePlan:
    """What to read from a table, gyroscope first, and how each choice was made.

    `headers` are the names of all columns, `temperature` is the index of its column, `findings` say what
    was not found.
    """

    headers: tuple[str, ...]
    sensors: tuple[SensorPlan, ...]
    temperature: int | None
    dialect: Dialect | None
    decisions: tuple[tuple[str, str], ...]
    findings: tuple[Finding, ...] = ()

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the sensors' columns."""
        return tuple(header for sensor in self.sensors for header in sensor.triad.headers)


def make_plan(
    path: str,
    headers: Sequence[str],
    cells: Cells,
    options: ReadOptions,
    *,
    units: Sequence[str | None] = (),
    preamble: Sequence[str] = (),
    name: str = "",
    shape: str = "",
) -> TablePlan:
    """Choose the columns of a table, from their names and first cells.

    `units` come from a row of units, `preamble` are the lines before the header, `name`, that of
    the file or the table, may name the sensor, and `shape` says what the columns are, for a message.

    Raises
    ------
    ChoiceError
        If it is not clear which columns to read; the message shows them.
    """
    context = frozenset(header.strip().strip("\"'").lower() for header in headers)
    row_units = [*units, *([None] * len(headers))]
    columns = tuple(
        parse_column(header, index, unit=row_units[index], context=context)
        for index, header in enumerate(headers)
    )
    table = NamedTable(path=path, columns=columns, cells=cells, dialect=find_dialect(headers, preamble))
    try:
        if options.columns is not None:
            return _as_asked(table, parse_columns_text(options.columns, headers, path), options)
        return _by_name(table, options, name or PurePath(path).name, shape)
    except ColumnsError as error:
        if error.example:
            raise
        found = list_columns(table.headers, table.cells)
        raise ColumnsError(path, error.problem, found, _proposal(table, options)) from None


def works(table: NamedTable, options: ReadOptions, text: str) -> bool:
    """Return whether a columns text names columns of numbers, and a time, in a table."""
    try:
        plan = _as_asked(table, parse_columns_text(text, table.headers, table.path), options)
    except ChoiceError:
        return False
    indices = [index for sensor in plan.sensors for index in sensor.triad.indices]
    return all(is_number(cell) for index in indices for cell in table.cells(index) if cell)


def _proposal(table: NamedTable, options: ReadOptions) -> str:
    """Return a columns text that works on a table: by the names, else by the numbers; empty if none does."""
    texts = []
    try:
        triads = find_triads(table, units_given=list(Sensor))
    except ChoiceError:
        triads = []
    if triads:
        first = {triad.sensor: triad for triad in reversed(triads)}
        texts.append(columns_text(table.time, first.get(Sensor.GYROSCOPE), first.get(Sensor.ACCELEROMETER)))
    known = [column.index for column in table.columns if _holds_no_samples(table, column)]
    texts.append(propose_columns(table.cells, len(table.columns), time=table.time, taken=known))
    return next((text for text in texts if text and works(table, options, text)), "")


def _holds_no_samples(table: NamedTable, column: NamedColumn) -> bool:
    """Return whether a column is named as something else than samples; counters must count."""
    if column.role is Role.COUNTER:
        return all(cell.isdecimal() for cell in table.cells(column.index))
    other = column.role is Role.OTHER and is_of_something_else(column)
    return other or column.role in {Role.TIME, Role.TEMPERATURE}


def _by_name(table: NamedTable, options: ReadOptions, name: str, shape: str) -> TablePlan:
    """Return the plan that the names of the columns tell."""
    gyro, accel, reason = _sensors(table, options, name)
    if gyro is None and accel is None:
        raise _nothing_found(table, shape)
    if reason == _BY_NAME:
        gyro, accel, rows = rows_of_sensors(table, gyro, accel)
        reason += f", {rows}" if rows else ""
    triads = [triad for triad in (gyro, accel) if triad is not None]
    near = [index for triad in triads for index in triad.indices]
    sensors = [_with_time(table, triad, options) for triad in triads]
    plan = _plan(table, sensors, find_temperature(table.columns, near=near), reason)
    return replace(plan, findings=missing_sensor(table, gyro, accel))


def _plan(
    table: NamedTable, sensors: Sequence[SensorPlan], temperature: int | None, reason: str
) -> TablePlan:
    headers = table.headers
    decisions = []
    for plan in sensors:
        shown = ", ".join(headers[index] or f"column {index}" for index in plan.triad.indices)
        decisions.append((f"{plan.triad.sensor} columns", f"{shown}, {reason}"))
    if table.dialect is not None:
        decisions.append(("layout", f"{table.dialect.name}, from the column names"))
    return TablePlan(
        headers=tuple(headers),
        sensors=tuple(sensors),
        temperature=temperature,
        dialect=table.dialect,
        decisions=tuple(decisions),
    )


def _as_asked(table: NamedTable, asked: ColumnSpec, options: ReadOptions) -> TablePlan:
    """Return the plan of a columns text."""
    time = time_of_columns(table, asked.time) if asked.time else None
    sensors = []
    for spec in asked.sensors:
        columns = [table.columns[index] for index in spec.indices]
        triad = triad_of(spec.sensor, columns, spec.rows, spec.axes)
        plan = SensorPlan(triad=triad, time=time) if time else _with_time(table, triad, options)
        sensors.append(plan)
    return _plan(table, sensors, asked.temperature, "as given")


def _sensors(table: NamedTable, options: ReadOptions, name: str) -> tuple[Triad | None, Triad | None, str]:
    """Return gyroscope and accelerometer, and how they were found."""
    given = [sensor for sensor in Sensor if given_unit(options, sensor) != (None, None)]
    triads = find_triads(table, units_given=given)
    if triads:
        return pick(table, triads, Sensor.GYROSCOPE), pick(table, triads, Sensor.ACCELEROMETER), _BY_NAME
    bare = find_bare_triads(table, name)
    # Single axes count where there is nothing else: beside a whole gyroscope az may be an azimuth.
    return bare if any(bare[:2]) else (*find_axes(table), _BY_NAME)


def _with_time(table: NamedTable, triad: Triad, options: ReadOptions) -> SensorPlan:
    if options.time is not None and options.time not in _CLOCKS:
        return SensorPlan(triad=triad, time=named_time(table, options.time))
    times = choose_times(table, triad.sensor)
    stamps = [time for time in times if time.kind != "counter"]
    if options.time == "log":
        return SensorPlan(triad=triad, time=_log_time(table, times, stamps))
    if table.dialect is not None and table.dialect.has_log_time and len(stamps) > 1:
        # Stamps that stand still are still the first choice: the clock says so and takes the log time.
        header = next((time for time in stamps if "stamp" in time.name.lower()), stamps[0])
        log = next(time for time in stamps if time is not header)
        return SensorPlan(triad=triad, time=header, log_time=log)
    return SensorPlan(triad=triad, time=next(iter(times), None))


def _log_time(table: NamedTable, times: Sequence[TimeChoice], stamps: Sequence[TimeChoice]) -> TimeChoice:
    if len(stamps) > 1:
        return stamps[1]
    names = ", ".join(time.name for time in times) or "none"
    msg = (
        f"{table.path}: there is no log time beside the stamps; found times: {names}; "
        "name the column to take as time"
    )
    raise ChoiceError(msg)


def _nothing_found(table: NamedTable, shape: str) -> ColumnsError:
    """Return the error for a table without a complete triad."""
    partial = [
        f"{column.header} ({column.role})"
        for column in table.columns
        if column.role in {Role.GYROSCOPE, Role.ACCELEROMETER}
    ]
    if not any(header.strip() for header in table.headers):
        problem = f"nothing names the {len(table.headers)} columns, and their order is not guessed"
    elif partial:
        problem = f"x, y and z of one sensor are needed, found only {', '.join(partial)}"
    else:
        problem = "no column is named as an axis of a gyroscope or an accelerometer"
    return table.ask(f"{shape}: {problem}" if shape else problem)
