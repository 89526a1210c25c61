"""What to read from a table: its sensors' columns, their times, the temperature, and why these."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

from imucal.errors import ChoiceError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import (
    Cells,
    Triad,
    columns_text,
    find_bare_triads,
    find_temperature,
    find_triads,
    pick,
    triad_of,
)
from imucal.readers.tables.columns_text import ColumnSpec, ask, parse_columns_text
from imucal.readers.tables.dialects import Dialect, find_dialect
from imucal.readers.tables.names import NamedColumn, Role, parse_column
from imucal.readers.tables.timing import TimeChoice, choose_times, named_time, time_of_columns
from imucal.recording import Sensor

#: Names of the two clocks of a message; for a table they are not columns.
_CLOCKS = ("header", "log")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPlan:
    """The columns of one sensor.

    Attributes
    ----------
    triad
        Its axes.
    time
        Its stamps; None where the table has none.
    log_time
        When the rows were recorded, where the table has that beside the stamps.
    """

    triad: Triad
    time: TimeChoice | None
    log_time: TimeChoice | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePlan:
    """What to read from a table.

    Attributes
    ----------
    headers
        Names of all columns.
    sensors
        Gyroscope first.
    temperature
        Index of its column, or None.
    dialect
        The one the names show, or None.
    decisions
        How each choice was made.
    """

    headers: tuple[str, ...]
    sensors: tuple[SensorPlan, ...]
    temperature: int | None
    dialect: Dialect | None
    decisions: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    """A table before the choice."""

    path: str
    columns: tuple[NamedColumn, ...]
    cells: Cells
    dialect: Dialect | None

    @property
    def headers(self) -> list[str]:
        return [column.header for column in self.columns]

    @property
    def time(self) -> str:
        """Index of the first column named as a time, as text; empty where there is none."""
        return next((str(column.index) for column in self.columns if column.role is Role.TIME), "")


def make_plan(
    path: str,
    headers: Sequence[str],
    cells: Cells,
    options: ReadOptions,
    *,
    units: Sequence[str | None] = (),
    preamble: Sequence[str] = (),
    name: str = "",
) -> TablePlan:
    """Choose the columns of a table.

    Parameters
    ----------
    path
        For messages.
    headers
        Names of the columns.
    cells
        Gives the first cells of a column.
    options
        What the user said.
    units
        From a row of units.
    preamble
        Lines before the header.
    name
        Of the file or the table; it may name the sensor.

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
    table = _Table(path=path, columns=columns, cells=cells, dialect=find_dialect(headers, preamble))
    if options.columns is not None:
        return _as_asked(table, parse_columns_text(options.columns, headers, path), options)
    gyro, accel, reason = _sensors(table, options, name or PurePath(path).name)
    if gyro is None and accel is None:
        raise _nothing_found(table)
    _refuse_instances(table, gyro, accel)
    triads = [triad for triad in (gyro, accel) if triad is not None]
    near = [index for triad in triads for index in triad.indices]
    sensors = tuple(_with_time(table, triad, options) for triad in triads)
    return _plan(table, sensors, find_temperature(columns, near=near), reason)


def _plan(table: _Table, sensors: tuple[SensorPlan, ...], temperature: int | None, reason: str) -> TablePlan:
    decisions = [
        (f"{plan.triad.sensor} columns", f"{', '.join(_shown(table, plan.triad))}, {reason}")
        for plan in sensors
    ]
    if table.dialect is not None:
        decisions.append(("layout", f"{table.dialect.name}, from the column names"))
    return TablePlan(
        headers=tuple(table.headers),
        sensors=sensors,
        temperature=temperature,
        dialect=table.dialect,
        decisions=tuple(decisions),
    )


def _shown(table: _Table, triad: Triad) -> list[str]:
    return [table.headers[index] or f"column {index}" for index in triad.indices]


def _as_asked(table: _Table, asked: ColumnSpec, options: ReadOptions) -> TablePlan:
    """Return the plan of a columns text."""
    time = None
    if asked.time:
        time = time_of_columns(asked.time, table.columns, table.cells, table.dialect, table.path)
    sensors = []
    for sensor, indices, rows in (
        (Sensor.GYROSCOPE, asked.gyro, asked.gyro_rows),
        (Sensor.ACCELEROMETER, asked.accel, asked.accel_rows),
    ):
        if indices:
            triad = triad_of(sensor, [table.columns[index] for index in indices], rows)
            plan = SensorPlan(triad=triad, time=time) if time else _with_time(table, triad, options)
            sensors.append(plan)
    return _plan(table, tuple(sensors), asked.temperature, "as given")


def _sensors(table: _Table, options: ReadOptions, name: str) -> tuple[Triad | None, Triad | None, str]:
    """Return gyroscope and accelerometer, and how they were found."""
    given = []
    if options.gyro_unit is not None or options.gyro_scale is not None:
        given.append(Sensor.GYROSCOPE)
    if options.accel_unit is not None or options.accel_scale is not None:
        given.append(Sensor.ACCELEROMETER)
    triads = find_triads(table.columns, table.path, units_given=given)
    if not triads:
        return find_bare_triads(table.path, table.columns, table.cells, name)
    gyro = pick(triads, Sensor.GYROSCOPE, table.path, table.headers, table.time)
    accel = pick(triads, Sensor.ACCELEROMETER, table.path, table.headers, table.time)
    return gyro, accel, "by name"


def _with_time(table: _Table, triad: Triad, options: ReadOptions) -> SensorPlan:
    if options.time is not None and options.time not in _CLOCKS:
        time = named_time(options.time, table.columns, table.cells, table.dialect, table.path)
        return SensorPlan(triad=triad, time=time)
    times = choose_times(table.columns, table.cells, table.dialect, triad.sensor)
    stamps = [time for time in times if time.kind != "counter"]
    if options.time == "log":
        return SensorPlan(triad=triad, time=_log_time(table, times, stamps))
    if table.dialect is not None and table.dialect.has_log_time and len(stamps) > 1:
        # Stamps that stand still are still the first choice: the clock says so and takes the log time.
        header = next((time for time in stamps if "stamp" in time.name.lower()), stamps[0])
        log = next(time for time in stamps if time is not header)
        return SensorPlan(triad=triad, time=header, log_time=log)
    return SensorPlan(triad=triad, time=next(iter(times), None))


def _log_time(table: _Table, times: Sequence[TimeChoice], stamps: Sequence[TimeChoice]) -> TimeChoice:
    if len(stamps) > 1:
        return stamps[1]
    names = ", ".join(time.name for time in times) or "none"
    msg = (
        f"{table.path}: there is no log time beside the stamps; found times: {names}; "
        "name the column to take as time"
    )
    raise ChoiceError(msg)


def _refuse_instances(table: _Table, gyro: Triad | None, accel: Triad | None) -> None:
    """Refuse rows of several sensors in one table: the column I of ArduPilot's IMU message."""
    for column in table.columns:
        name = column.header.strip()
        if name.strip("\"'").lower() not in {"i", "instance", "imu_id", "sensor_id"}:
            continue
        cells = {cell for cell in table.cells(column.index) if cell}
        if len(cells) > 1 and all(cell.isdigit() for cell in cells):
            shown = sorted(cells, key=int)
            texts = [columns_text(table.time, gyro, accel, f"@{name}:{cell}") for cell in shown[:4]]
            problem = f"rows of {len(cells)} sensors, told apart by column {name} ({', '.join(shown)})"
            raise ask(table.path, problem, table.headers, example=" or ".join(texts))


def _nothing_found(table: _Table) -> ChoiceError:
    """Return the error for a table without a complete triad."""
    partial = [
        f"{column.header} ({column.role})"
        for column in table.columns
        if column.role in {Role.GYROSCOPE, Role.ACCELEROMETER}
    ]
    if not any(header.strip() for header in table.headers):
        problem = f"no header names the {len(table.headers)} columns, and their order is not guessed"
    elif partial:
        problem = f"x, y and z of one sensor are needed, found only {', '.join(partial)}"
    else:
        problem = "no column is named as a gyroscope or accelerometer axis (such as gyro_x, wx, accel_x, ax)"
    return ask(table.path, problem, table.headers, example=f"t={table.time or 0},g=1:4,a=4:7")
