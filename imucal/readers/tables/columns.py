"""Which columns of a table are the sensors: by their names, by tags beside them, or by the file's name.

The text in which a user says which columns are which: ``t=0,g=1:4,a=4:7``, or ``t=0,gz=1``.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from imucal.errors import ChoiceError
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.layout import Rows, is_number
from imucal.readers.tables.names import NamedColumn, Role
from imucal.recording import AXES, Axis, Sensor
from imucal.units import parse_sample_unit

#: A number of more letters is rounded in a message.
_LONG = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """The columns of one sensor, by index: one for each of its axes; and its rows."""

    sensor: Sensor
    indices: tuple[int, ...]
    axes: tuple[Axis, ...] = AXES
    rows: Rows = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec:
    """The columns a user gave, by index; gyroscope first."""

    sensors: tuple[SensorSpec, ...]
    time: tuple[int, ...] = ()
    temperature: int | None = None


_KEYS = {
    **dict.fromkeys(("t", "time"), "t"),
    **dict.fromkeys(("g", "gyro"), "g"),
    **dict.fromkeys(("a", "accel"), "a"),
    **{f"{name}{axis}": f"{name[0]}{axis}" for name in ("g", "gyro_", "a", "accel_") for axis in AXES},
    **dict.fromkeys(("temp", "temperature"), "temp"),
}


class ColumnsError(ChoiceError):
    """Which columns of a table to read is not clear; the message shows them.

    Parameters
    ----------
    problem
        What is not clear.
    found
        The columns, as `list_columns` shows them.
    example
        A columns text that works on this very table; empty where none is known.
    """

    def __init__(self, path: str, problem: str, found: str, example: str = "") -> None:
        self.problem, self.example = problem, example
        how = (
            f"such as {example} (places from 0 with the end left out, or three names joined by +)"
            if example
            else "of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their places from 0)"
        )
        super().__init__(
            f"{path}: {problem}; found columns: {found}; say which are which by a columns text {how}"
        )


def list_columns(
    headers: Sequence[str], cells: Callable[[int], Sequence[str]] | None = None, *, most: int = 60
) -> str:
    """Return the columns of a table with their indices, for a message; first cells for lack of names."""
    shown = []
    for index, header in enumerate(headers[:most]):
        first = next(iter(cells(index)), "") if cells is not None and not any(headers) else ""
        if len(first) > _LONG and is_number(first):
            first = f"{float(first):.6g}"
        shown.append(f"{index} {header.strip() or first or '(no name)'}")
    more = f", … {len(headers) - most} more" if len(headers) > most else ""
    return ", ".join(shown) + more


def parse_columns_text(text: str, headers: Sequence[str], path: str) -> ColumnSpec:
    """Return the columns that a text such as ``t=0,g=1:4,a=4:7`` names.

    ``t`` is the time (``t=0+1`` joins seconds and nanoseconds, or a date and a time of day), ``g`` the
    gyroscope, ``a`` the accelerometer, ``temp`` the temperature. Three columns are indices from 0 with
    the end left out (``1:4``) or indices or names joined by ``+`` (``wx+wy+wz``). ``gx``, ``gy``, ``gz``,
    ``ax``, ``ay`` and ``az`` are single axes, of a log that holds no others. ``a=2:5@imu`` takes only
    the rows that have ``imu`` in one of their cells, ``a=2:5@I:0`` those with 0 in column I.

    Raises
    ------
    ChoiceError
        If the text can't be read, or names a column that isn't there, or one column twice.
    """
    found: dict[str, tuple[int, ...]] = {}
    rows: dict[str, Rows] = {}
    for part in filter(str.strip, text.split(",")):
        name, equals, value = part.partition("=")
        key = _KEYS.get(name.strip().lower())
        if key is None or not equals:
            problem = f"{part.strip()!r} is not t=…, g=…, a=…, gx=… to az=…, or temp=…"
            raise _wrong(text, problem, headers, path)
        if key in found:
            raise _wrong(text, f"{key} is named twice", headers, path)
        value, at, tag = value.partition("@")
        found[key] = _indices(value, headers, path, text)
        rows[key] = _rows(tag, headers, path, text) if at else None
    problem = _problem(found, rows)
    if problem:
        raise _wrong(text, problem, headers, path)
    sensors = (_sensor_spec(sensor, found, rows) for sensor in Sensor)
    return ColumnSpec(
        sensors=tuple(sensor for sensor in sensors if sensor.indices),
        time=found.get("t", ()),
        temperature=next(iter(found.get("temp", ())), None),
    )


def _sensor_spec(
    sensor: Sensor, found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]
) -> SensorSpec:
    letter = sensor.short[0]
    if letter in found:
        return SensorSpec(sensor=sensor, indices=found[letter], rows=rows[letter])
    axes = tuple(axis for axis in AXES if letter + axis in found)
    indices = tuple(found[letter + axis][0] for axis in axes)
    return SensorSpec(
        sensor=sensor, indices=indices, axes=axes, rows=rows[letter + axes[0]] if axes else None
    )


def _wrong(text: str, problem: str, headers: Sequence[str], path: str) -> ChoiceError:
    return ColumnsError(path, f"columns text {text!r}: {problem}", list_columns(headers))


def _problem(found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]) -> str:
    """Return what is wrong with the columns, or an empty text."""
    if not any(key[0] in "ga" for key in found):
        return "names neither gyroscope (g) nor accelerometer (a)"
    if len(found.get("t", ())) > 3 or len(found.get("temp", ())) > 1:
        return "t takes up to three columns, temp one"
    problems = (_problem_of(key, found, rows) for key in ("g", "a"))
    return next(filter(None, problems), "") or _named_twice(found, rows)


def _problem_of(key: str, found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]) -> str:
    """Return what is wrong with the columns of one sensor."""
    single = [key + axis for axis in AXES if key + axis in found]
    if key in found and single:
        return f"{single[0]} is one of the three columns of {key}; name either"
    if any(len(found[one]) != 1 for one in single):
        return f"{single[0]} takes one column"
    if len({rows[one] for one in single}) > 1:
        return f"{' and '.join(single)} are of different rows, expected the same"
    if key in found and len(found[key]) != 3:
        return f"{key} names {len(found[key])} columns, expected 3; one axis alone is {key}z={found[key][0]}"
    return ""


def _named_twice(found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]) -> str:
    """Return which column is named twice: for two axes or purposes, in the same rows."""
    uses: dict[int, list[Rows]] = {}
    for key, indices in found.items():
        for index in indices:
            others = uses.setdefault(index, [])
            # A column may be the gyroscope's in some rows and the accelerometer's in others.
            if any(rows[key] is None or other is None or other == rows[key] for other in others):
                return f"column {index} is named twice; a log of one axis has gz={index} alone"
            others.append(rows[key])
    return ""


def _indices(value: str, headers: Sequence[str], path: str, text: str) -> tuple[int, ...]:
    first, colon, stop = value.strip().partition(":")
    if colon and first.strip().isdigit() and stop.strip().isdigit():
        indices = tuple(range(int(first), min(int(stop), int(first) + len(headers) + 4)))
    else:
        indices = tuple(index_of(name, headers, path, text) for name in value.split("+"))
    for index in indices:
        if index >= len(headers):
            raise _wrong(text, f"there is no column {index}, the last is {len(headers) - 1}", headers, path)
    return indices


def index_of(name: str, headers: Sequence[str], path: str, text: str) -> int:
    """Return the index of a column given by name or index; a ChoiceError if there is none, or several."""
    name = name.strip()
    matches = [index for index, header in enumerate(headers) if _plain(header) == _plain(name)]
    if len(matches) == 1:
        return matches[0]
    if name.isdigit() and not matches and int(name) < len(headers):
        return int(name)
    found = f"{len(matches)} columns are called {name!r}" if matches else f"there is no column {name!r}"
    raise _wrong(text, found, headers, path)


def _rows(tag: str, headers: Sequence[str], path: str, text: str) -> Rows:
    column, colon, value = tag.partition(":")
    return (index_of(column, headers, path, text), value.strip()) if colon else (-1, tag.strip())


def _plain(header: str) -> str:
    return header.strip().strip("\"'\ufeff").lstrip("#%").strip().lower()


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
