"""Which columns of a table are the sensors: by their names, by tags beside them, or by the file's name."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from imucal.errors import ChoiceError
from imucal.readers.tables.columns_text import ColumnsError, list_columns
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.layout import Rows
from imucal.readers.tables.line_splits import is_number
from imucal.readers.tables.names import NamedColumn, Role
from imucal.recording import AXES, Axis, Sensor
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
    """The x, y and z columns of one sensor, or those of its axes that there are, and its rows.

    The unit is a key of `imucal.units.SAMPLE_UNITS`; None where the names don't say.
    """

    sensor: Sensor
    indices: tuple[int, ...]
    headers: tuple[str, ...]
    axes: tuple[Axis, ...] = AXES
    unit: str | None = None
    rows: Rows = None

    def text(self, rows: str = "") -> str:
        """Return the columns as a user gives them: ``g=1:4``, ``g=4+3+2``, ``gz=1``; `rows` is ``@I:0``."""
        letter, first = self.sensor.short[0], self.indices[0]
        if self.axes != AXES:
            named = zip(self.axes, self.indices, strict=True)
            return ",".join(f"{letter}{axis}={index}{rows}" for axis, index in named)
        if self.indices == (first, first + 1, first + 2):
            return f"{letter}={first}:{first + 3}{rows}"
        return f"{letter}={'+'.join(map(str, self.indices))}{rows}"


def triad_of(
    sensor: Sensor, columns: Sequence[NamedColumn], rows: Rows = None, axes: tuple[Axis, ...] = AXES
) -> Triad:
    """Return the columns of some axes as those of a sensor; without a unit where theirs differ."""
    units = {_unit_of(sensor, column) for column in columns}
    return Triad(
        sensor=sensor,
        indices=tuple(column.index for column in columns),
        headers=tuple(column.header for column in columns),
        axes=axes,
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


def find_axes(table: NamedTable) -> tuple[Triad | None, Triad | None]:
    """Return the single axes of sensors of which no triad is complete: a gyroscope about z, say.

    None for a sensor whose axes are numbered, carry different units, or belong to several sets.
    """
    families: dict[tuple[str, ...], list[NamedColumn]] = {}
    for column in table.columns:
        if column.axis is not None and column.role in {Role.GYROSCOPE, Role.ACCELEROMETER}:
            families.setdefault(column.family, []).append(column)
    found = []
    for sensor in (Sensor.GYROSCOPE, Sensor.ACCELEROMETER):
        sets = [members for family, members in families.items() if family[0] == sensor]
        found.append(_single_axes(table, sensor, sets[0]) if len(sets) == 1 else None)
    return found[0], found[1]


def _single_axes(table: NamedTable, sensor: Sensor, members: Sequence[NamedColumn]) -> Triad | None:
    if any(column.numbered for column in members) or len({_unit_of(sensor, c) for c in members}) > 1:
        return None
    axes = _in_order(table, members)
    return triad_of(sensor, [axes[i] for i in sorted(axes)], axes=tuple(AXES[i] for i in sorted(axes)))


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
        gyros, accels = _tags(texts)
        if max(len(gyros), len(accels)) > 1:
            raise _several_tags(table, gyro, gyros, accels)
        gyro_tag, accel_tag = next(iter(gyros), None), next(iter(accels), None)
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


def _several_tags(table: NamedTable, axes: Triad, gyros: Sequence[str], accels: Sequence[str]) -> ChoiceError:
    """Return the error for bare columns whose rows are tagged as those of several sensors of a kind."""
    texts = []
    for k in range(max(len(gyros), len(accels))):
        parts = [f"t={table.time}"] if table.time else []
        for sensor, tags in ((Sensor.GYROSCOPE, gyros), (Sensor.ACCELEROMETER, accels)):
            if tags:
                parts.append(replace(axes, sensor=sensor).text(f"@{tags[min(k, len(tags) - 1)]}"))
        texts.append(",".join(parts))
    return table.ask(f"rows of several sensors: {', '.join([*gyros, *accels])}", example=" or ".join(texts))


def _tags(texts: set[str]) -> tuple[list[str], list[str]]:
    """Return the tags of the gyroscope's rows and the accelerometer's; one of a usual pair tells both."""
    gyros = sorted(text for text in texts if text.lower().startswith("gyr"))
    accels = sorted(text for text in texts if text.lower().startswith("acc"))
    if not gyros:
        gyros = [name for name, other in _PARTNERS.items() if accels == [other]]
    if not accels and len(gyros) == 1 and gyros[0] in _PARTNERS:
        accels = [_PARTNERS[gyros[0]]]
    return gyros, accels


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
    texts = [columns_text(table.time, *pair) for pair in _pairs(table, triads)]
    problem = f"{len(found)} sets of {sensor} columns: " + ", ".join(triad.headers[0] for triad in found)
    raise table.ask(problem, example=" or ".join(texts))


def _pairs(table: NamedTable, triads: Sequence[Triad]) -> list[tuple[Triad | None, Triad | None]]:
    """Return a gyroscope and the accelerometer that goes with it: by the words they share, then by place."""
    gyros = [triad for triad in triads if triad.sensor is Sensor.GYROSCOPE]
    accels = [triad for triad in triads if triad.sensor is Sensor.ACCELEROMETER]

    def likeness(gyro: Triad, accel: Triad) -> tuple[int, int]:
        first, second = (set(table.columns[triad.indices[0]].words) for triad in (gyro, accel))
        return len(first & second) - len(first ^ second), -abs(gyro.indices[0] - accel.indices[0])

    pairs: list[tuple[Triad | None, Triad | None]] = []
    if not gyros or not accels:
        pairs = [(gyro, None) for gyro in gyros] + [(None, accel) for accel in accels]
    elif len(gyros) >= len(accels):
        pairs = [(gyro, max(accels, key=lambda accel, g=gyro: likeness(g, accel))) for gyro in gyros]  # type: ignore[misc]
    else:
        pairs = [(max(gyros, key=lambda gyro, a=accel: likeness(gyro, a)), accel) for accel in accels]  # type: ignore[misc]
    return pairs[:4]


def columns_text(time: str, gyro: Triad | None, accel: Triad | None, rows: str = "") -> str:
    """Return the ready columns text of a choice; `rows` says which rows, such as ``@I:0``."""
    parts = [f"t={time}"] if time else []
    parts += [triad.text(rows) for triad in (gyro, accel) if triad]
    return ",".join(parts)
