"""What to read from a table: its sensors' columns, their times, the temperature, and why these."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

from imucal.errors import ChoiceError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import (
    Triad,
    ask,
    find_temperature,
    find_triads,
    find_vector,
    pick,
)
from imucal.readers.tables.columns_text import Asked, parse_columns_text
from imucal.readers.tables.names import Column, Role, parse_column
from imucal.readers.tables.signatures import Signature, find_signature
from imucal.readers.tables.timing import Cells, TimeChoice, choose_times, named_time, time_of_places
from imucal.readers.tables.vectors import of_vector
from imucal.recording import Sensor
from imucal.units import parse_sample_unit

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
        Place of its column, or None.
    signature
        The format the names show, or None.
    decisions
        How each choice was made.
    """

    headers: tuple[str, ...]
    sensors: tuple[SensorPlan, ...]
    temperature: int | None
    signature: Signature | None
    decisions: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    """A table before the choice."""

    path: str
    columns: tuple[Column, ...]
    cells: Cells
    signature: Signature | None

    @property
    def headers(self) -> list[str]:
        return [column.header for column in self.columns]


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
        parse_column(header, place, unit=row_units[place], context=context)
        for place, header in enumerate(headers)
    )
    table = _Table(path=path, columns=columns, cells=cells, signature=find_signature(headers, preamble))
    if options.columns is not None:
        return _as_asked(table, parse_columns_text(options.columns, headers, path), options)
    gyro, accel, reason = _sensors(table, options, name or PurePath(path).name)
    if gyro is None and accel is None:
        raise _nothing_found(table)
    _refuse_instances(table, gyro, accel)
    near = [place for triad in (gyro, accel) if triad for place in triad.places]
    sensors = tuple(_with_time(table, triad, options) for triad in (gyro, accel) if triad)
    return _plan(table, sensors, find_temperature(columns, near=near), reason)


def _plan(table: _Table, sensors: tuple[SensorPlan, ...], temperature: int | None, reason: str) -> TablePlan:
    decisions = [
        (f"{plan.triad.sensor} columns", f"{', '.join(_shown(table, plan.triad))}, {reason}")
        for plan in sensors
    ]
    if table.signature is not None:
        decisions.append(("layout", f"{table.signature.name}, from the column names"))
    return TablePlan(
        headers=tuple(table.headers),
        sensors=sensors,
        temperature=temperature,
        signature=table.signature,
        decisions=tuple(decisions),
    )


def _shown(table: _Table, triad: Triad) -> list[str]:
    return [table.headers[place] or f"column {place}" for place in triad.places]


def _as_asked(table: _Table, asked: Asked, options: ReadOptions) -> TablePlan:
    """Return the plan of a columns text."""
    sensors = []
    wanted = (
        (Sensor.GYROSCOPE, asked.gyro, asked.gyro_rows),
        (Sensor.ACCELEROMETER, asked.accel, asked.accel_rows),
    )
    for sensor, places, rows in wanted:
        if places is None:
            continue
        parsed = [
            parse_sample_unit(unit) if (unit := table.columns[place].unit) else None for place in places
        ]
        units = {entry[1] if entry and entry[0] is sensor else None for entry in parsed}
        headers = table.headers
        triad = Triad(
            sensor=sensor,
            places=places,
            headers=(headers[places[0]], headers[places[1]], headers[places[2]]),
            unit=units.pop() if len(units) == 1 else None,
            rows=rows,
        )
        if asked.time:
            time = time_of_places(asked.time, table.columns, table.cells, table.signature, table.path)
            sensors.append(SensorPlan(triad=triad, time=time))
        else:
            sensors.append(_with_time(table, triad, options))
    return _plan(table, tuple(sensors), asked.temperature, "as given")


def _sensors(table: _Table, options: ReadOptions, name: str) -> tuple[Triad | None, Triad | None, str]:
    """Return gyroscope and accelerometer, and how they were found."""
    given = [
        sensor
        for sensor, unit, scale in (
            (Sensor.GYROSCOPE, options.gyro_unit, options.gyro_scale),
            (Sensor.ACCELEROMETER, options.accel_unit, options.accel_scale),
        )
        if unit is not None or scale is not None
    ]
    triads = find_triads(table.columns, table.path, units_given=given)
    time = next((str(c.place) for c in table.columns if c.role is Role.TIME), "")
    gyro = pick(triads, Sensor.GYROSCOPE, table.path, table.headers, time)
    accel = pick(triads, Sensor.ACCELEROMETER, table.path, table.headers, time)
    if gyro is not None or accel is not None:
        return gyro, accel, "by name"
    axes = find_vector(table.columns, table.path)
    if axes is None:
        return None, None, ""
    return of_vector(table.path, table.columns, table.cells, axes, name)


def _with_time(table: _Table, triad: Triad, options: ReadOptions) -> SensorPlan:
    if options.time is not None and options.time not in _CLOCKS:
        time = named_time(options.time, table.columns, table.cells, table.signature, table.path)
        return SensorPlan(triad=triad, time=time)
    times = choose_times(table.columns, table.cells, table.signature, triad.sensor)
    stamps = [time for time in times if time.kind != "counter"]
    if options.time == "log":
        if len(stamps) < 2:
            names = ", ".join(time.name for time in times) or "none"
            msg = (
                f"{table.path}: there is no log time beside the stamps; found times: {names}; "
                "name the column to take as time"
            )
            raise ChoiceError(msg)
        return SensorPlan(triad=triad, time=stamps[1])
    if table.signature is not None and table.signature.name == "ROS" and len(stamps) > 1:
        # Stamps that stand still are still the first choice: the clock says so and takes the log time.
        header = next((time for time in stamps if "stamp" in time.name.lower()), stamps[0])
        log = next(time for time in stamps if time is not header)
        return SensorPlan(triad=triad, time=header, log_time=log)
    return SensorPlan(triad=triad, time=times[0] if times else None)


def _refuse_instances(table: _Table, gyro: Triad | None, accel: Triad | None) -> None:
    """Refuse rows of several sensors in one table: the column I of ArduPilot's IMU message."""
    for column in table.columns:
        if column.header.strip().strip("\"'").lower() not in {"i", "instance", "imu_id", "sensor_id"}:
            continue
        cells = {cell for cell in table.cells(column.place) if cell}
        if len(cells) > 1 and all(cell.isdigit() for cell in cells):
            shown = sorted(cells, key=int)
            time = next((str(c.place) for c in table.columns if c.role is Role.TIME), "")
            texts = []
            for cell in shown[:4]:
                parts = [f"t={time}"] if time else []
                parts += [f"g={gyro.text}@{column.header.strip()}:{cell}"] if gyro else []
                parts += [f"a={accel.text}@{column.header.strip()}:{cell}"] if accel else []
                texts.append(",".join(parts))
            told = f"column {column.header.strip()} ({', '.join(shown)})"
            problem = f"rows of {len(cells)} sensors, told apart by {told}"
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
    time = next((f"t={c.place}," for c in table.columns if c.role is Role.TIME), "t=0,")
    return ask(table.path, problem, table.headers, example=f"{time}g=1:4,a=4:7")
