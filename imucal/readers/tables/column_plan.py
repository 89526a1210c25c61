"""What to read from a table: its sensors' columns, their times, the temperature, and why these."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import (
    Cells,
    NamedTable,
    Triad,
    columns_text,
    find_axes,
    find_bare_triads,
    find_temperature,
    find_triads,
    pick,
    triad_of,
)
from imucal.readers.tables.columns_text import ColumnsError, ColumnSpec, list_columns, parse_columns_text
from imucal.readers.tables.dialects import Dialect, find_dialect
from imucal.readers.tables.line_splits import is_number
from imucal.readers.tables.names import NamedColumn, Role, is_of_something_else, parse_column
from imucal.readers.tables.proposals import propose_columns
from imucal.readers.tables.row_tags import rows_of_sensors
from imucal.readers.tables.scales import given_unit
from imucal.readers.tables.timing import TimeChoice, choose_times, named_time, time_of_columns
from imucal.readers.tables.unused_columns import missing_sensor
from imucal.recording import Sensor

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
