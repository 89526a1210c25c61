"""Chosen tables -> the rows of each sensor: what to read, in time order, without rows that are no samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, never_changes
from imucal.errors import ChoiceError, DataError
from imucal.findings import Finding
from imucal.readers.choose import Choice
from imucal.readers.clocks import LOG_TIME
from imucal.readers.files import refused
from imucal.readers.fixes import COLUMNS
from imucal.readers.messages.order import sort_by_log_time
from imucal.readers.repeated_rows import without_first_rows, without_held
from imucal.readers.sensor_rows import SensorRows
from imucal.readers.table import Loaded, Log, Request, Table
from imucal.readers.tables.plan import SensorPlan
from imucal.readers.tables.stamps import TimeChoice
from imucal.readers.work import Work
from imucal.recording import Sensor

#: Name of the time in the header of a message.
HEADER = "header stamp"


@dataclass(frozen=True, eq=False)
class Part:
    """The sensors of a table that share rows, and what to read for them."""

    table: Table
    sensors: tuple[SensorPlan, ...]
    request: Request


def parts_of(choice: Choice) -> list[Part]:
    """Return the sensors of a chosen table by their rows."""
    table, plan = choice.table, choice.plan
    parts = []
    for rows in dict.fromkeys(sensor.triad.rows for sensor in plan.sensors):
        sensors = tuple(sensor for sensor in plan.sensors if sensor.triad.rows == rows)
        times = [time for sensor in sensors for time in (sensor.time, sensor.log_time) if time is not None]
        request = Request(
            table=table,
            samples=tuple(index for sensor in sensors for index in sensor.triad.indices),
            times=tuple(dict.fromkeys(times)),
            temperature=plan.temperature,
            rows=rows,
        )
        parts.append(Part(table, sensors, request))
    return parts


def rows_of_sensors(
    work: Work, log: Log, parts: Sequence[Part], loaded: Sequence[Loaded]
) -> list[SensorRows]:
    """Return the rows of each sensor; findings are about rows left out.

    Raises DataError if no sensor has samples that change.
    """
    sensors: list[SensorRows] = []
    for part, data in zip(parts, loaded, strict=True):
        work.findings += data.findings
        if part.request.rows is not None and not data.n:
            raise _without_rows(log, part)
        sensors += _rows_of(work, log, part, data)
    if not sensors:
        texts = "; ".join(finding.text for finding in work.findings) or "no data"
        raise refused(log.name, f"no sensor has samples that change: {texts}", DataError)
    filled = [_with_values(work, columns) for columns in sensors]
    return [without_held(work, columns) for columns in without_first_rows(work, filled)]


def _without_rows(log: Log, part: Part) -> ChoiceError:
    """Return the error for a tag that no row of a table has."""
    table, rows = part.table, part.request.rows
    index, tag = rows or (-1, "")
    where = "any column" if index < 0 else f"column {table.columns[index].name or index}"
    sensors = " and ".join(sensor.triad.sensor for sensor in part.sensors)
    text = f"no row has {tag!r} in {where}, which selects those of the {sensors}"
    place = f"{log.name}: {table.place}" if table.is_topic else table.place
    return refused(place, text, ChoiceError, COLUMNS)


def _rows_of(work: Work, log: Log, part: Part, data: Loaded) -> list[SensorRows]:
    table, columns = part.table, data.columns
    if table.log_time is not None:
        work.findings += _sort(part, columns, columns[table.log_time])
    axes = {
        sensor.triad.sensor: [np.asarray(columns[index], np.float64) for index in sensor.triad.indices]
        for sensor in part.sensors
    }
    compared = None
    if table.log_time is not None:
        # One sensor alone may repeat values by chance.
        compared = list(chain.from_iterable(axes.values())) if len(axes) > 1 else []
    dead = _without_data(work, table, axes) if table.is_topic else set()
    temperature = _temperature(part.request, columns)
    return [
        SensorRows(
            plan=sensor,
            axes=axes[sensor.triad.sensor],
            time=[columns[index] for index in _indices(sensor.time)],
            log_time=[columns[index] for index in _indices(sensor.log_time)],
            temperature=temperature,
            place=f"{log.name}: {table.place}" if table.is_topic else table.place,
            table=table.name,
            is_topic=table.is_topic,
            rate_hz=table.rate_hz,
            source=_clock_name(table, sensor.time),
            sparse=_is_sparse(table, sensor),
            compared=compared,
        )
        for sensor in part.sensors
        if sensor.triad.sensor not in dead
    ]


def _sort(part: Part, columns: Mapping[int, NDArray[Any]], log_ns: NDArray[Any]) -> list[Finding]:
    """Sort the columns of messages in place."""
    time = part.sensors[0].time
    stamps = log_ns if time is None else columns[time.indices[0]]
    every = {id(column): column for column in columns.values()}
    return sort_by_log_time(stamps, log_ns, every.values())


def _without_data(work: Work, table: Table, axes: Mapping[Sensor, Sequence[FloatArray]]) -> set[Sensor]:
    """Return the sensors of a topic that never change; the screening reports those of files."""
    dead = set()
    for sensor, rows in axes.items():
        if rows[0].size < 2 or not all(map(never_changes, rows)):
            continue
        value = ", ".join(f"{row[0]:g}" for row in rows)
        text = f"The {sensor} of {table.place} is always ({value}): no data."
        work.findings.append(Finding("warning", "no-data", text, axis=sensor.short))
        dead.add(sensor)
    return dead


def _temperature(request: Request, columns: Mapping[int, NDArray[Any]]) -> FloatArray | None:
    """Return the temperature as read; None without one, or if it is always zero."""
    if request.temperature is None:
        return None
    values = np.asarray(columns[request.temperature], np.float64)
    return values if values.any() else None


def _indices(time: TimeChoice | None) -> tuple[int, ...]:
    return () if time is None else time.indices


def _clock_name(table: Table, time: TimeChoice | None) -> str:
    """Return the source of a clock; empty for a column of a file."""
    if not table.is_topic or time is None:
        return ""
    if table.log_time is None:
        return f"{time.name} of {table.name}"
    return LOG_TIME if time.indices == (table.log_time,) else HEADER


def _is_sparse(table: Table, sensor: SensorPlan) -> bool:
    """Return whether a sensor's rows without values belong to another sensor."""
    if table.is_topic:
        return table.sparse
    return table.sparse or any(not all(column.cells) for column in sensor.triad.columns)


def _with_values(work: Work, columns: SensorRows) -> SensorRows:
    """Return the rows with values of a sensor and a finite time."""
    keep = np.ones(columns.n, np.bool_)
    if columns.sparse:
        keep = ~np.all([np.isnan(axis) for axis in columns.axes], axis=0)
    for column in columns.time:
        if column.dtype.kind == "f":
            lost = int(np.count_nonzero(keep & ~np.isfinite(column)))
            keep &= np.isfinite(column)
            if lost:
                text = f"{lost} rows have no finite time; they were dropped."
                work.findings.append(Finding("warning", "bad-rows", text))
    if keep.all():
        return columns
    return columns.where(keep, blake2b(keep.tobytes()).digest())
