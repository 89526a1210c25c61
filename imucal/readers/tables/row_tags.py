"""Rows of several sensors in one table: filtered by the column of text that names them, or refused."""

import re
from collections.abc import Sequence
from dataclasses import replace

from imucal.readers.tables.columns import NamedTable, Triad, columns_text, sensor_of_name
from imucal.readers.tables.line_splits import is_number
from imucal.readers.tables.names import Role
from imucal.recording import Sensor

#: Names of columns that say which of several devices, or which of their sensors, a row is of.
_INSTANCE = frozenset(
    (
        *("i", "instance", "imu", "imu_id", "sensor", "sensor_id", "sensorid", "device", "device_id", "dev"),
        *("source", "src", "id", "unit_id", "topic", "frame", "frame_id", "child_frame_id", "name", "tag"),
        *("type", "stream", "channel"),
    )
)
#: Texts that are more than this many are no names of sensors.
_MOST = 8
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
        if len(texts) <= _MOST and any(tags.values()):
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
    if not 1 < len(found) <= _MOST:
        return []
    if all(map(str.isdigit, found)):
        return sorted(found, key=int)
    return [] if any(map(is_number, found)) else sorted(found)
