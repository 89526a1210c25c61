"""Which columns of a table are the sensors: by their names, by tags beside them, or by the file's name.

Or as a user says it: ``t=0,g=1:4,a=4:7``, or ``t=0,gz=1``.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from typing import Self, TypeAlias

from imucal.errors import ChoiceError
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.layout import Rows, is_number
from imucal.readers.tables.names import NamedColumn, Role, plain_name
from imucal.recording import AXES, Axis, Sensor
from imucal.units import parse_sample_unit

#: First cells of a column, by its index.
Cells: TypeAlias = Callable[[int], Sequence[str]]

#: A number of more letters is rounded in a message.
_LONG = 9

#: Names in a columns text -> what they stand for.
_KEYS = {
    **dict.fromkeys(("t", "time"), "t"),
    **dict.fromkeys(("g", "gyro"), "g"),
    **dict.fromkeys(("a", "accel"), "a"),
    **{f"{name}{axis}": f"{name[0]}{axis}" for name in ("g", "gyro_", "a", "accel_") for axis in AXES},
    **dict.fromkeys(("temp", "temperature"), "temp"),
}

#: Text of a row's tag for the gyroscope -> for the accelerometer.
_PARTNERS = {
    case(gyro): case(accel)
    for gyro, accel in (("gyro", "accel"), ("gyroscope", "accelerometer"), ("gyr", "acc"))
    for case in (str.lower, str.capitalize, str.upper)
}

_SENSORS = frozenset((Role.GYROSCOPE, Role.ACCELEROMETER))


class ColumnsError(ChoiceError):
    """Which columns of a table to read is not clear; the message shows them.

    Attributes
    ----------
    problem
        What is not clear.
    example
        A columns text that works on this very table; empty where none is known.
    """

    def __init__(self, message: str, *, problem: str = "", example: str = "") -> None:
        super().__init__(message)
        self.problem, self.example = problem, example

    @classmethod
    def of(cls, path: str, problem: str, found: str, example: str = "") -> Self:
        """Return the error that shows the columns `found` and perhaps an `example` for them."""
        how = (
            f"such as {example} (places from 0 with the end left out, or three names joined by +)"
            if example
            else "of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their places from 0)"
        )
        message = f"{path}: {problem}; found columns: {found}; say which are which by a columns text {how}"
        return cls(message, problem=problem, example=example)


def list_columns(headers: Sequence[str], cells: Cells | None = None, *, most: int = 60) -> str:
    """Return the columns of a table with their indices, for a message; first cells for lack of names."""
    shown = []
    for index, header in enumerate(headers[:most]):
        first = next(iter(cells(index)), "") if cells is not None and not any(headers) else ""
        if len(first) > _LONG and is_number(first):
            first = f"{float(first):.6g}"
        shown.append(f"{index} {header.strip() or first or '(no name)'}")
    more = f", … {len(headers) - most} more" if len(headers) > most else ""
    return ", ".join(shown) + more


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


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedTable:
    """A table before its columns are chosen: what their names say, and `cells` for the first of each."""

    path: str
    columns: tuple[NamedColumn, ...]
    cells: Cells
    dialect: Dialect | None = None
    preamble: Sequence[str] = ()

    @property
    def headers(self) -> list[str]:
        """Names of the columns."""
        return [column.header for column in self.columns]

    @property
    def time(self) -> str:
        """Index of the first column named as a time, as text; empty where there is none."""
        return next((str(column.index) for column in self.columns if column.role is Role.TIME), "")

    def filled(self, index: int) -> list[str]:
        """Return the first cells of a column that are not empty, without quotation marks."""
        return [cell.strip("\"'") for cell in self.cells(index) if cell]

    def index_of(self, name: str) -> int:
        """Return the index of a column given by name or index; a ValueError if there is none, or several."""
        name = name.strip()
        wanted = plain_name(name)
        matches = [index for index, header in enumerate(self.headers) if plain_name(header) == wanted]
        if len(matches) == 1:
            return matches[0]
        if name.isdigit() and not matches and int(name) < len(self.columns):
            return int(name)
        problem = f"{len(matches)} columns are called {name!r}" if matches else f"there is no column {name!r}"
        raise ValueError(problem)

    def names_of_rows(self, tag: str) -> list[str]:
        """Return the names that a comment gives the cells of tagged rows, or ``column 3`` and the like."""
        comments = ([cell.strip() for cell in line.lstrip("#% ").split(",")] for line in self.preamble)
        plain = [f"column {column.index}" for column in self.columns]
        return next((names for names in comments if names[0] == tag and len(names) >= len(plain)), plain)

    def columns_text(self, *triads: Triad | None, rows: str = "", time: str = "") -> str:
        """Return the ready columns text of a choice; `rows` says which rows, such as ``@I:0``."""
        time = time or self.time
        parts = [f"t={time}"] if time else []
        return ",".join([*parts, *(triad.text(rows) for triad in triads if triad)])

    def ask(self, problem: str, *, example: str = "") -> ColumnsError:
        """Return the error that shows the columns and perhaps a ready text for them."""
        return ColumnsError.of(self.path, problem, list_columns(self.headers, self.cells), example)


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec:
    """The columns a user gave: those of the sensors, gyroscope first; the others by index."""

    sensors: tuple[Triad, ...]
    time: tuple[int, ...] = ()
    temperature: int | None = None


def parse_columns_text(text: str, table: NamedTable) -> ColumnSpec:
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
    try:
        found, rows = _parts(text, table)
        _check(found, rows)
    except ValueError as error:
        problem = f"columns text {text!r}: {error}"
        raise ColumnsError.of(table.path, problem, list_columns(table.headers)) from None
    sensors = []
    for sensor in Sensor:
        letter = sensor.short[0]
        axes = AXES if letter in found else tuple(axis for axis in AXES if letter + axis in found)
        keys = [letter] if letter in found else [letter + axis for axis in axes]
        if keys:
            columns = [table.columns[index] for key in keys for index in found[key]]
            sensors.append(triad_of(sensor, columns, rows[keys[0]], axes))
    temperature = next(iter(found.get("temp", ())), None)
    return ColumnSpec(sensors=tuple(sensors), time=found.get("t", ()), temperature=temperature)


def _parts(text: str, table: NamedTable) -> tuple[dict[str, tuple[int, ...]], dict[str, Rows]]:
    """Return the columns that each part of a columns text names, and their rows; a ValueError if it can't."""
    found: dict[str, tuple[int, ...]] = {}
    rows: dict[str, Rows] = {}
    for part in filter(str.strip, text.split(",")):
        name, equals, value = part.partition("=")
        key = _KEYS.get(name.strip().lower())
        if key is None or not equals:
            problem = f"{part.strip()!r} is not t=…, g=…, a=…, gx=… to az=…, or temp=…"
            raise ValueError(problem)
        if key in found:
            problem = f"{key} is named twice"
            raise ValueError(problem)
        value, at, tag = value.partition("@")
        found[key] = _indices(value, table)
        rows[key] = None
        if at:
            column, colon, cell = tag.partition(":")
            rows[key] = (table.index_of(column), cell.strip()) if colon else (-1, tag.strip())
    return found, rows


def _indices(value: str, table: NamedTable) -> tuple[int, ...]:
    first, colon, stop = value.strip().partition(":")
    count = len(table.columns)
    if colon and first.strip().isdigit() and stop.strip().isdigit():
        indices = tuple(range(int(first), min(int(stop), int(first) + count + 4)))
    else:
        indices = tuple(map(table.index_of, value.split("+")))
    missing = next((index for index in indices if index >= count), None)
    if missing is not None:
        problem = f"there is no column {missing}, the last is {count - 1}"
        raise ValueError(problem)
    return indices


def _check(found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]) -> None:
    """Raise a ValueError that says what is wrong with the columns, if anything is."""
    problems = []
    if not any(key[0] in "ga" for key in found):
        problems.append("names neither gyroscope (g) nor accelerometer (a)")
    if len(found.get("t", ())) > 3 or len(found.get("temp", ())) > 1:
        problems.append("t takes up to three columns, temp one")
    problems += [_problem_of(key, found, rows) for key in ("g", "a")]
    uses: dict[int, list[Rows]] = {}
    for key, indices in found.items():
        for index in indices:
            others = uses.setdefault(index, [])
            # A column may be the gyroscope's in some rows and the accelerometer's in others.
            if any(rows[key] is None or other is None or other == rows[key] for other in others):
                problems.append(f"column {index} is named twice; a log of one axis has gz={index} alone")
            others.append(rows[key])
    problem = next(filter(None, problems), "")
    if problem:
        raise ValueError(problem)


def _problem_of(key: str, found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]) -> str:
    """Return what is wrong with the columns of one sensor, or an empty text."""
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


def triad_of(
    sensor: Sensor, columns: Sequence[NamedColumn], rows: Rows = None, axes: tuple[Axis, ...] = AXES
) -> Triad:
    """Return the columns of some axes as those of a sensor; without a unit where theirs differ."""
    units = {_unit_of(sensor, column) for column in columns} - {None}
    return Triad(
        sensor=sensor,
        indices=tuple(column.index for column in columns),
        headers=tuple(column.header for column in columns),
        axes=axes,
        unit=units.pop() if len(units) == 1 else None,
        rows=rows,
    )


def triad_of_axes(sensor: Sensor, columns: Mapping[int, NamedColumn]) -> Triad:
    """Return the columns of some axes, of which 0 is x, as those of a sensor."""
    places = sorted(columns)
    return triad_of(sensor, [columns[at] for at in places], axes=tuple(AXES[at] for at in places))


def _unit_of(sensor: Sensor, column: NamedColumn) -> str | None:
    parsed = parse_sample_unit(column.unit) if column.unit else None
    return parsed[1] if parsed and parsed[0] is sensor else None


def families(columns: Iterable[NamedColumn], roles: AbstractSet[Role]) -> list[list[NamedColumn]]:
    """Return the columns of some roles that have an axis, in sets whose names differ in nothing else."""
    found: dict[tuple[str, ...], list[NamedColumn]] = {}
    for column in columns:
        if column.axis is not None and column.role in roles:
            found.setdefault(column.family, []).append(column)
    return list(found.values())


def find_triads(table: NamedTable, *, units_given: Sequence[Sensor] = ()) -> list[Triad]:
    """Return every complete x, y, z of a sensor, in the order of the table; second choices last.

    A vector without a sensor (bare x, y, z) is not among them. Two columns of the same name are a
    ChoiceError, and so are different units in one triad of which the caller gave none.
    """
    triads = []
    for axes in _complete(table, _SENSORS):
        sensor = Sensor(str(axes[0].role))
        if sensor not in units_given:
            _require_one_unit(table, sensor, axes)
        triads.append(triad_of(sensor, axes))
    measured = {triad.sensor for triad in triads if not _is_linear(triad)}
    kept = [triad for triad in triads if not _is_linear(triad) or triad.sensor not in measured]
    return sorted(kept, key=lambda triad: triad.sensor is Sensor.ACCELEROMETER)


def find_axes(table: NamedTable) -> tuple[Triad | None, Triad | None]:
    """Return the single axes of sensors of which no triad is complete: a gyroscope about z, say.

    None for a sensor whose axes are numbered, carry different units, or belong to several sets.
    """
    return _single_axes(table, Sensor.GYROSCOPE), _single_axes(table, Sensor.ACCELEROMETER)


def _single_axes(table: NamedTable, sensor: Sensor) -> Triad | None:
    sets = families(table.columns, {Role(str(sensor))})
    if len(sets) != 1:
        return None
    (members,) = sets
    if any(column.numbered for column in members) or len({_unit_of(sensor, c) for c in members} - {None}) > 1:
        return None
    return triad_of_axes(sensor, _in_order(table, members))


def _complete(table: NamedTable, roles: AbstractSet[Role]) -> Iterator[tuple[NamedColumn, ...]]:
    """Yield the columns of some roles in sets of x, y, z that differ in nothing else."""
    for members in families(table.columns, roles):
        axes = _in_order(table, members)
        # Of more numbers than three, such as those of a matrix, none tells an axis.
        if axes.keys() == {0, 1, 2}:
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
    # A unit behind one name is that of the others too: wx(rad/s), wy, wz.
    if len({*units} - {None}) <= 1:
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
        gyros, accels = _tags({cell for cell in table.filled(column.index) if not is_number(cell)})
        several = max(len(gyros), len(accels))
        if several > 1:
            texts = []
            for k in range(several):
                pairs = ((gyro, gyros), (accel, accels))
                parts = [triad.text(f"@{tags[min(k, len(tags) - 1)]}") for triad, tags in pairs if tags]
                texts.append(",".join(filter(None, [table.columns_text(), *parts])))
            problem = f"rows of several sensors: {', '.join([*gyros, *accels])}"
            raise table.ask(problem, example=" or ".join(texts))
        if several:
            return (
                replace(gyro, rows=(column.index, gyros[0])) if gyros else None,
                replace(accel, rows=(column.index, accels[0])) if accels else None,
                f"by the tags of column {column.header or column.index}",
            )
    sensor = sensor_of_name(name)
    if sensor is None:
        problem = f"x, y and z are there ({', '.join(gyro.headers)}), but not of which sensor"
        raise table.ask(problem, example=f"{table.columns_text(gyro)} or {table.columns_text(accel)}")
    by_name = "by the name of the file"
    return (gyro, None, by_name) if sensor is Sensor.GYROSCOPE else (None, accel, by_name)


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
        return next(iter(found), None)
    texts = [table.columns_text(*pair) for pair in _pairs(table, triads)]
    problem = f"{len(found)} sets of {sensor} columns: " + ", ".join(triad.headers[0] for triad in found)
    raise table.ask(problem, example=" or ".join(texts))


def _pairs(table: NamedTable, triads: Sequence[Triad]) -> list[tuple[Triad, ...]]:
    """Return a gyroscope and the accelerometer that goes with it: by the words they share, then by place."""
    gyros = [triad for triad in triads if triad.sensor is Sensor.GYROSCOPE]
    accels = [triad for triad in triads if triad.sensor is Sensor.ACCELEROMETER]

    def likeness(pair: tuple[Triad, ...]) -> tuple[int, int]:
        first, second = (set(table.columns[triad.indices[0]].words) for triad in pair)
        apart = abs(pair[0].indices[0] - pair[1].indices[0])
        return len(first & second) - len(first ^ second), -apart

    pairs: list[tuple[Triad, ...]] = [(triad,) for triad in triads]
    if gyros and len(gyros) >= len(accels) > 0:
        pairs = [max(((gyro, accel) for accel in accels), key=likeness) for gyro in gyros]
    elif gyros and accels:
        pairs = [max(((gyro, accel) for gyro in gyros), key=likeness) for accel in accels]
    return pairs[:4]
