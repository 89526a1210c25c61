"""Which columns of a table are the sensors: by their names, by tags beside them, or by the file's name."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeAlias

from imucal.errors import ChoiceError
from imucal.readers.tables.columns_text import ColumnsError, list_columns
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.layout import Rows, is_number
from imucal.readers.tables.names import NamedColumn, Role
from imucal.recording import Sensor
from imucal.units import parse_sample_unit

#: First cells of a column, by its index.
Cells: TypeAlias = Callable[[int], Sequence[str]]

#: Text of a row's tag for the gyroscope -> for the accelerometer.
_PARTNERS = {
    case(gyro): case(accel)
    for gyro, accel in (("gyro", "accel"), ("gyroscope", "accelerometer"), ("gyr", "acc"))
    for case in (str.lower, str.capitalize, str.upper)
}


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedTable:
    """A table before its columns are chosen: what their names say, and `cells` for the first of each."""

    path: str
    columns: tuple[NamedColumn, ...]
    cells: Cells
    dialect: Dialect | None

    @property
    def headers(self) -> list[str]:
        """Names of the columns."""
        return [column.header for column in self.columns]

    @property
    def time(self) -> str:
        """Index of the first column named as a time, as text; empty where there is none."""
        return next((str(column.index) for column in self.columns if column.role is Role.TIME), "")

    def ask(self, problem: str, *, example: str = "") -> ColumnsError:
        """Return the error that shows the columns and perhaps a ready text for them."""
        return ColumnsError(self.path, problem, list_columns(self.headers, self.cells), example)


@dataclass(frozen=True, slots=True, kw_only=True)
class Triad:
    """The x, y and z columns of one sensor, and the rows that belong to it.

    The unit is a key of `imucal.units.SAMPLE_UNITS`; None where the names don't say.
    """

    sensor: Sensor
    indices: tuple[int, int, int]
    headers: tuple[str, str, str]
    unit: str | None = None
    rows: Rows = None

    @property
    def text(self) -> str:
        """The columns as a user gives them: ``1:4``, or ``4+3+2`` where they don't follow each other."""
        first = self.indices[0]
        if self.indices == (first, first + 1, first + 2):
            return f"{first}:{first + 3}"
        return "+".join(map(str, self.indices))


def triad_of(sensor: Sensor, axes: Sequence[NamedColumn], rows: Rows = None) -> Triad:
    """Return columns x, y, z as those of a sensor; without a unit where theirs differ."""
    x, y, z = axes
    units = {_unit_of(sensor, column) for column in axes}
    return Triad(
        sensor=sensor,
        indices=(x.index, y.index, z.index),
        headers=(x.header, y.header, z.header),
        unit=units.pop() if len(units) == 1 else None,
        rows=rows,
    )


def _unit_of(sensor: Sensor, column: NamedColumn) -> str | None:
    parsed = parse_sample_unit(column.unit) if column.unit else None
    return parsed[1] if parsed and parsed[0] is sensor else None


def find_triads(table: NamedTable, *, units_given: Sequence[Sensor] = ()) -> list[Triad]:
    """Return every complete x, y, z of a sensor, in the order of the table; second choices last.

    A vector without a sensor (bare x, y, z) is not among them. Two columns of the same name are a
    ChoiceError, and so are different units in one triad of which the caller gave none.
    """
    triads = []
    for axes in _complete(table, {Role.GYROSCOPE, Role.ACCELEROMETER}):
        sensor = Sensor(str(axes[0].role))
        if sensor not in units_given:
            _require_one_unit(table, sensor, axes)
        triads.append(triad_of(sensor, axes))
    with_gravity = [triad for triad in triads if not _is_linear(triad)]
    measured = {triad.sensor for triad in with_gravity}
    kept = [triad for triad in triads if triad in with_gravity or triad.sensor not in measured]
    return sorted(kept, key=lambda triad: triad.sensor is Sensor.ACCELEROMETER)


def _complete(table: NamedTable, roles: set[Role]) -> Iterator[tuple[NamedColumn, ...]]:
    """Yield the columns of some roles in sets of x, y, z that differ in nothing else."""
    families: dict[tuple[str, ...], list[NamedColumn]] = {}
    for column in table.columns:
        if column.axis is not None and column.role in roles:
            families.setdefault(column.family, []).append(column)
    for members in families.values():
        axes = _in_order(table, members)
        if {0, 1, 2} <= axes.keys():
            yield axes[0], axes[1], axes[2]


def _in_order(table: NamedTable, members: Sequence[NamedColumn]) -> dict[int, NamedColumn]:
    """Return the columns of a family by axis; refuse two of the same axis."""
    numbers = sorted(column.axis for column in members if column.axis is not None)
    first = 1 if numbers == [1, 2, 3] and all(column.numbered for column in members) else 0
    axes: dict[int, NamedColumn] = {}
    for column in members:
        axis = (column.axis or 0) - first
        if axis in axes:
            problem = f"columns {axes[axis].index} and {column.index} are both {column.header.strip()!r}"
            raise table.ask(problem)
        axes[axis] = column
    return axes


def _require_one_unit(table: NamedTable, sensor: Sensor, axes: Sequence[NamedColumn]) -> None:
    units = [_unit_of(sensor, column) for column in axes]
    if len(set(units)) == 1:
        return
    named = zip(axes, units, strict=True)
    shown = ", ".join(f"{column.header} in {unit or 'no unit'}" for column, unit in named)
    msg = (
        f"{table.path}: the axes of the {sensor} carry different units ({shown}), so at least one of them "
        f"is wrong; expected one unit; give the unit of the {sensor}, or correct the header; "
        f"found columns: {list_columns(table.headers)}"
    )
    raise ChoiceError(msg)


def _is_linear(triad: Triad) -> bool:
    """Return whether a name says linear acceleration, which phones give without gravity."""
    return triad.sensor is Sensor.ACCELEROMETER and triad.headers[0].lower().lstrip("\"'").startswith("lin")


def find_bare_triads(table: NamedTable, name: str) -> tuple[Triad | None, Triad | None, str]:
    """Return the sensors of bare columns x, y, z: by a column of tags, or by the name of the file.

    Gyroscope, accelerometer, and how they were found; None twice where there are no such columns. A
    ChoiceError where nothing says which sensor they are.
    """
    axes = next(_complete(table, {Role.VECTOR}), None)
    if axes is None:
        return None, None, ""
    gyro = triad_of(Sensor.GYROSCOPE, axes)
    accel = replace(gyro, sensor=Sensor.ACCELEROMETER)
    for column in table.columns:
        texts = {cell.strip("\"'") for cell in table.cells(column.index) if cell and not is_number(cell)}
        gyro_tag, accel_tag = _tags(texts)
        if gyro_tag or accel_tag:
            return (
                replace(gyro, rows=(column.index, gyro_tag)) if gyro_tag else None,
                replace(accel, rows=(column.index, accel_tag)) if accel_tag else None,
                f"by the tags of column {column.header or column.index}",
            )
    sensor = sensor_of_name(name)
    if sensor is None:
        problem = f"x, y and z are there ({', '.join(gyro.headers)}), but not of which sensor"
        choices = (columns_text(table.time, gyro, None), columns_text(table.time, None, accel))
        raise table.ask(problem, example=" or ".join(choices))
    by_name = "by the name of the file"
    return (gyro, None, by_name) if sensor is Sensor.GYROSCOPE else (None, accel, by_name)


def _tags(texts: set[str]) -> tuple[str | None, str | None]:
    """Return the tags of the gyroscope's rows and the accelerometer's; one of a usual pair tells both."""
    gyro = min((text for text in texts if text.lower().startswith("gyr")), default=None)
    accel = min((text for text in texts if text.lower().startswith("acc")), default=None)
    partner = next((name for name, other in _PARTNERS.items() if other == accel), None)
    return gyro or partner, accel or _PARTNERS.get(gyro or "")


def sensor_of_name(name: str) -> Sensor | None:
    """Return the sensor that the name of a file names, if it names one."""
    plain = name.lower()
    gyro = re.search(r"gyr|angular|rotation_?rate", plain) is not None
    accel = re.search(r"acc(?!u)", plain) is not None
    if gyro == accel:
        return None
    return Sensor.GYROSCOPE if gyro else Sensor.ACCELEROMETER


def find_temperature(columns: Sequence[NamedColumn], *, near: Sequence[int] = ()) -> int | None:
    """Return the index of the temperature column; of several, the one nearest the sensors' columns."""
    indices = [column.index for column in columns if column.role is Role.TEMPERATURE]
    return min(indices, key=lambda index: min((abs(index - n) for n in near), default=0), default=None)


def pick(table: NamedTable, triads: Sequence[Triad], sensor: Sensor) -> Triad | None:
    """Return the only triad of a sensor, or None; a ChoiceError where there are several."""
    found = [triad for triad in triads if triad.sensor is sensor]
    if len(found) <= 1:
        return found[0] if found else None
    gyros: list[Triad | None] = [triad for triad in triads if triad.sensor is Sensor.GYROSCOPE]
    accels: list[Triad | None] = [triad for triad in triads if triad.sensor is Sensor.ACCELEROMETER]
    pairs = list(product(gyros or [None], accels or [None]))[:4]
    problem = f"{len(found)} sets of {sensor} columns: " + ", ".join(triad.headers[0] for triad in found)
    raise table.ask(problem, example=" or ".join(columns_text(table.time, *pair) for pair in pairs))


def columns_text(time: str, gyro: Triad | None, accel: Triad | None, rows: str = "") -> str:
    """Return the ready columns text of a choice; `rows` says which rows, such as ``@I:0``."""
    parts = [f"t={time}"] if time else []
    parts += [f"g={gyro.text}{rows}"] if gyro else []
    parts += [f"a={accel.text}{rows}"] if accel else []
    return ",".join(parts)
