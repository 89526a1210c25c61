"""What to read from a table: its sensors' columns, their times, the temperature, and why these.

Names tell; a column of text may say whose a row is. What else speaks for a sensor only gives a columns text
that is shown to the user, never taken. Columns that were not read are named where a sensor was not found.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess
from imucal.readers.tables.columns import (
    Cells,
    ColumnsError,
    ColumnSpec,
    NamedTable,
    Triad,
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
from imucal.readers.tables.dialects import Dialect, find_dialect
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.names import NamedColumn, Role, parse_column, plain_name
from imucal.readers.tables.proposals import likely, may_be_samples, proposal
from imucal.readers.tables.stamps import TimeChoice, choose_times, named_time, time_of_columns
from imucal.recording import AXES, Sensor

#: Names of the two clocks of a message; for a table they are not columns.
_CLOCKS = ("header", "log")

#: How columns are found that no tags, and no name of the file, had to tell.
_BY_NAME = "by name"

#: Names of columns that say which of several devices, or which of their sensors, a row is of.
_INSTANCE = frozenset(
    (
        *("i", "instance", "imu", "imu_id", "sensor", "sensor_id", "sensorid", "device", "device_id", "dev"),
        *("source", "src", "id", "unit_id", "topic", "frame", "frame_id", "child_frame_id", "name", "tag"),
        *("type", "stream", "channel"),
    )
)

#: Columns that a message lists, and ready texts that it shows.
_LISTED, _SHOWN = 12, 4
#: Texts that are more than this many are no names of sensors.
_MOST_TAGS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPlan:
    """The columns of one sensor: its axes, its stamps, and beside them the time of recording.

    `stated` is the unit of its samples that the header or the dialect says; None where neither does.
    """

    triad: Triad
    time: TimeChoice | None
    log_time: TimeChoice | None = None
    stated: UnitGuess | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePlan:
    """What to read from a table, gyroscope first, and how each choice was made.

    `temperature` is the index of its column, `findings` say what was not found.
    """

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
    dialect = find_dialect(headers, preamble)
    table = NamedTable(path=path, columns=columns, cells=cells, dialect=dialect, preamble=preamble)
    try:
        if options.columns is not None:
            return _as_asked(table, parse_columns_text(options.columns, table), options)
        return _by_name(table, options, name or PurePath(path).name, shape)
    except ColumnsError as error:
        if error.example:
            raise
        found = list_columns(table.headers, table.cells)
        raise ColumnsError.of(path, error.problem, found, propose(table, options)) from None


def _as_asked(table: NamedTable, asked: ColumnSpec, options: ReadOptions) -> TablePlan:
    time = time_of_columns(table, asked.time) if asked.time else None
    sensors = [
        SensorPlan(triad=triad, time=time) if time else _with_time(table, triad, options)
        for triad in asked.sensors
    ]
    return _plan(table, sensors, asked.temperature, "as given")


def _by_name(table: NamedTable, options: ReadOptions, name: str, shape: str) -> TablePlan:
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
    decisions = []
    for triad in (plan.triad for plan in sensors):
        named = zip(triad.headers, triad.indices, strict=True)
        shown = ", ".join(header or f"column {index}" for header, index in named)
        decisions.append((f"{triad.sensor} columns", f"{shown}, {reason}"))
    dialect = table.dialect
    if dialect is not None:
        decisions.append(("layout", f"{dialect.name}, from the column names"))
    return TablePlan(
        sensors=tuple(replace(plan, stated=_stated_unit(plan.triad, dialect)) for plan in sensors),
        temperature=temperature,
        dialect=dialect,
        decisions=tuple(decisions),
    )


def _stated_unit(triad: Triad, dialect: Dialect | None) -> UnitGuess | None:
    if triad.unit is not None:
        return UnitGuess(unit=triad.unit, reason="from the column header")
    usual = dialect.unit_of(triad.sensor) if dialect is not None else None
    return UnitGuess(unit=usual, reason=f"as {dialect.name} logs it") if dialect and usual else None


def _sensors(table: NamedTable, options: ReadOptions, name: str) -> tuple[Triad | None, Triad | None, str]:
    given = [s for s in Sensor if options.unit_of(s) is not None or options.scale_of(s) is not None]
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
    msg = (
        f"{table.path}: there is no log time beside the stamps; found times: "
        f"{', '.join(time.name for time in times) or 'none'}; name the column to take as time"
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
    column, tags = found
    both: dict[Sensor, Triad | None] = {}
    for sensor, own, other in ((Sensor.GYROSCOPE, gyro, accel), (Sensor.ACCELEROMETER, accel, gyro)):
        names = tags[sensor]
        triad = own
        if own is None and other is not None and names:
            # The header names these columns for the other sensor, and not this one's unit.
            own_names = table.names_of_rows(names[0])
            triad = triad_of(sensor, [parse_column(own_names[at], at) for at in other.indices])
        if triad is not None and len(names) != 1:
            raise _unclear(table, column, triad, tags)
        both[sensor] = replace(triad, rows=(column.index, names[0])) if triad is not None else None
    reason = f"in the rows that column {column.header.strip() or column.index} names"
    return both[Sensor.GYROSCOPE], both[Sensor.ACCELEROMETER], reason


def _tag_column(table: NamedTable) -> tuple[NamedColumn, dict[Sensor, list[str]]] | None:
    """Return the column of text that names the sensors of rows, and which text names which."""
    for column in table.columns:
        texts = [] if column.role is Role.TIME else _texts(table, column.index)
        tags = {sensor: [text for text in texts if sensor_of_name(text) is sensor] for sensor in Sensor}
        if len(texts) <= _MOST_TAGS and any(tags.values()):
            return column, tags
    return None


def _unclear(
    table: NamedTable, column: NamedColumn, triad: Triad, tags: dict[Sensor, list[str]]
) -> ColumnsError:
    """Return the error for rows of which none, or several kinds, are the sensor's."""
    names, texts = tags[triad.sensor], _texts(table, column.index)
    rows = names or [text for text in texts if not any(text in named for named in tags.values())] or texts
    examples = [table.columns_text(triad, rows=f"@{column.index}:{row}") for row in rows[:_SHOWN]]
    found = f"{len(names)} of them name" if names else "none of them names"
    header = column.header.strip() or column.index
    problem = f"column {header} says whose a row is ({', '.join(texts)}); {found} the {triad.sensor}"
    return table.ask(problem, example=" or ".join(examples))


def _texts(table: NamedTable, index: int) -> list[str]:
    """Return the different texts of a column; none where it holds numbers too."""
    cells = set(table.filled(index))
    return [] if any(map(is_number, cells)) else sorted(cells)


def _refuse_instances(table: NamedTable, gyro: Triad | None, accel: Triad | None) -> None:
    """Refuse rows of several sensors in one table: the column I of ArduPilot's IMU message."""
    first = gyro or accel
    # The last part of a name counts: frame_id of header.frame_id.
    columns = [c for c in table.columns if plain_name(c.header).rpartition(".")[2] in _INSTANCE]
    for column in columns if first is not None else ():
        devices = _devices(table.cells(column.index), table.cells(first.indices[0] if first else 0))
        if len(devices) < 2:
            continue
        name = column.header.strip().strip("\"'")
        at = name if re.fullmatch(r"\w+", name) else str(column.index)
        texts = [table.columns_text(gyro, accel, rows=f"@{at}:{cell}") for cell in devices[:_SHOWN]]
        problem = f"rows of {len(devices)} sensors, told apart by column {name} ({', '.join(devices)})"
        raise table.ask(problem, example=" or ".join(texts))


def _devices(cells: Sequence[str], samples: Sequence[str]) -> list[str]:
    """Return the numbers or names of several devices in the rows that hold samples; none of a single one."""
    pairs = zip(cells, samples, strict=False)
    found = {cell.strip("\"'") for cell, sample in pairs if cell and sample}
    if not 1 < len(found) <= _MOST_TAGS:
        return []
    if all(map(str.isdigit, found)):
        return sorted(found, key=int)
    return [] if any(map(is_number, found)) else sorted(found)


def missing_sensor(table: NamedTable, gyro: Triad | None, accel: Triad | None) -> tuple[Finding, ...]:
    """Return a finding where a sensor, or an axis, was not found and columns of numbers were left over.

    Columns x, y, z, or some of them, that are left over may be the sensor: that is a warning, which says
    what names them. Others are listed in a remark.
    """
    found = {Sensor.GYROSCOPE: gyro, Sensor.ACCELEROMETER: accel}
    used = {index for triad in found.values() if triad is not None for index in triad.indices}
    left = [column for column in table.columns if column.index not in used and may_be_samples(table, column)]
    if not left:
        return ()
    shown = [f"{column.index} {column.header.strip() or '(no name)'}" for column in left[:_LISTED]]
    shown += [f"… {len(left) - _LISTED} more"] if len(left) > _LISTED else []
    listed = f"columns that were not read: {', '.join(shown)}."
    guessed = likely(table, found)
    findings = []
    for sensor, triad in found.items():
        if triad is None:
            text = f"No {sensor} was found in the table; {listed}"
            missing = Finding(level="info", code="sensor-missing", axis=sensor.short, text=text)
            if guessed[sensor] is not None:
                ready = table.columns_text(*(found | {sensor: guessed[sensor]}).values())
                advice = f"If it is among them, give a columns text such as {ready}."
                missing = replace(missing, level="warning", advice=advice)
            findings.append(missing)
        elif triad.axes != AXES:
            text = f"Only {' and '.join(triad.axes)} of the {sensor} was found in the table; {listed}"
            findings.append(Finding(level="info", code="axis-missing", axis=sensor.short, text=text))
    return tuple(findings)


def works(table: NamedTable, options: ReadOptions, text: str) -> bool:
    """Return whether a columns text names columns of numbers, and a time, in a table."""
    try:
        plan = _as_asked(table, parse_columns_text(text, table), options)
    except ChoiceError:
        return False
    indices = [index for sensor in plan.sensors for index in sensor.triad.indices]
    return all(is_number(cell) for index in indices for cell in table.cells(index) if cell)


def propose(table: NamedTable, options: ReadOptions, *, first: Sequence[str] = (), rows: str = "") -> str:
    """Return a columns text that works on a table: one of those `first`, or the likeliest; or none."""
    texts = (*first, proposal(table, name=PurePath(table.path).name, rows=rows))
    return next((text for text in texts if text and works(table, options, text)), "")
