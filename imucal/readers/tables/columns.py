"""Columns of a table, and the columns text of users: ``t=0,g=1:4,a=4:7``, or ``t=0,gz=1``."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Self

from imucal.errors import ChoiceError, Fix
from imucal.readers.tables.dialects import Dialect, find_dialect
from imucal.readers.tables.layout import Rows, is_number
from imucal.readers.tables.names import NamedColumn, Role, parse_column, plain_name
from imucal.recording import AXES, Axis, Sensor

#: Longest number, in characters, that is not rounded in a message.
_MAX_DIGITS = 9
#: Longest text of a cell in a message, in characters.
_MAX_TEXT = 24
#: Most columns listed in a message.
_MAX_LISTED = 60

_ENDS = (tuple(f".{axis}" for axis in AXES), ("[0]", "[1]", "[2]"), tuple(f"_{axis}" for axis in AXES))

_KEYS = {
    **dict.fromkeys(("t", "time"), "t"),
    **dict.fromkeys(("g", "gyro"), "g"),
    **dict.fromkeys(("a", "accel"), "a"),
    **{f"{name}{axis}": f"{name[0]}{axis}" for name in ("g", "gyro_", "a", "accel_") for axis in AXES},
    **dict.fromkeys(("temp", "temperature"), "temp"),
}


class ColumnsError(ChoiceError):
    """The choice of columns is ambiguous.

    `wrong` is the problem without the list of columns; `example` is a columns text that works on this table,
    or empty.
    """

    def __init__(
        self,
        problem: str,
        *,
        place: object = "",
        fixes: Iterable[Fix] = (),
        wrong: str = "",
        example: str = "",
    ) -> None:
        super().__init__(problem, place=place, fixes=fixes)
        self.wrong = wrong
        self.example = example


@dataclass(frozen=True, kw_only=True)
class Triad:
    """The x, y and z columns of a sensor, or some of them, and its rows."""

    sensor: Sensor
    columns: tuple[NamedColumn, ...]
    axes: tuple[Axis, ...] = AXES
    rows: Rows = None

    @classmethod
    def of(cls, sensor: Sensor, columns: Mapping[int, NamedColumn]) -> Self:
        places = sorted(columns)
        axes = tuple(AXES[at] for at in places)
        return cls(sensor=sensor, columns=tuple(columns[at] for at in places), axes=axes)

    @property
    def indices(self) -> tuple[int, ...]:
        return tuple(column.index for column in self.columns)

    @property
    def headers(self) -> tuple[str, ...]:
        return tuple(column.header for column in self.columns)

    @property
    def units(self) -> tuple[str | None, ...]:
        """Keys of `imucal.units.LOG_UNITS` or `INCREMENT_UNITS`, or None."""
        return tuple(column.unit_of(self.sensor) for column in self.columns)

    @property
    def unit(self) -> str | None:
        units = {*self.units} - {None}
        return units.pop() if len(units) == 1 else None

    def text(self, rows: str = "") -> str:
        """Return the columns text: ``g=1:4``, ``g=4+3+2``, ``gz=1``; `rows` is such as ``@I:0``."""
        letter, first = self.sensor.short[0], self.indices[0]
        if self.axes != AXES:
            named = zip(self.axes, self.indices, strict=True)
            return ",".join(f"{letter}{axis}={index}{rows}" for axis, index in named)
        if self.indices == (first, first + 1, first + 2):
            return f"{letter}={first}:{first + 3}{rows}"
        return f"{letter}={'+'.join(map(str, self.indices))}{rows}"


@dataclass(frozen=True, kw_only=True)
class NamedTable:
    """A table before columns are chosen: parsed names and first cells."""

    path: str
    columns: tuple[NamedColumn, ...]
    dialect: Dialect | None = None
    preamble: Sequence[str] = ()

    @classmethod
    def of(
        cls,
        path: str,
        headers: Sequence[str],
        cells: Callable[[int], Sequence[str]],
        *,
        units: Sequence[str | None] = (),
        preamble: Sequence[str] = (),
    ) -> Self:
        context = frozenset(header.strip().strip("\"'").lower() for header in headers)
        columns = [
            parse_column(header, index, unit=unit, context=context, cells=cells(index))
            for index, (header, unit) in enumerate(zip_longest(headers, units[: len(headers)]))
        ]
        return cls(
            path=path, columns=tuple(columns), dialect=find_dialect(headers, preamble), preamble=preamble
        )

    @property
    def listed(self) -> str:
        """The columns with indices, names and first values, for a message: ``0 t = 0.01, 1 gx = 0.0012``."""
        entries = [_entry(column) for column in self.columns[:_MAX_LISTED]]
        more = len(self.columns) - _MAX_LISTED
        return ", ".join(entries) + (f", … {more} more" if more > 0 else "")

    @property
    def time(self) -> str:
        return next((str(column.index) for column in self.columns if column.role is Role.TIME), "")

    def index_of(self, name: str) -> int:
        """Return the index of a column; raises ValueError if no or several columns match."""
        name = name.strip()
        matches = [c.index for c in self.columns if plain_name(c.header) == plain_name(name)]
        if len(matches) == 1:
            return matches[0]
        if name.isdigit() and not matches and int(name) < len(self.columns):
            return int(name)
        problem = f"{len(matches)} columns are called {name!r}" if matches else f"there is no column {name!r}"
        raise ValueError(problem)

    def members(self, name: str) -> list[str]:
        """Return the axis names of a vector; another name is returned as it is."""
        known = {plain_name(column.header) for column in self.columns}
        families = [[name.strip() + end for end in ends] for ends in _ENDS]
        whole = (axes for axes in families if known.issuperset(map(plain_name, axes)))
        return [name] if plain_name(name) in known else next(whole, [name])

    def columns_text(self, *triads: Triad | None, rows: str = "", time: str = "") -> str:
        time = time or self.time
        parts = [f"t={time}"] if time else []
        return ",".join([*parts, *(triad.text(rows) for triad in triads if triad)])

    def ask(self, problem: str, *, example: str = "") -> ColumnsError:
        single = sum(column.role is not Role.TIME for column in self.columns) in {1, 2}
        form = "t=TIME,gz=Z" if single else "t=TIME,g=X+Y+Z,a=X+Y+Z"
        how = (
            f"such as {example} (numbers from 0 without the end, or three names joined by +)"
            if example
            else f"of the form {form} (names of columns, or their numbers from 0)"
        )
        return ColumnsError(
            f"{problem}; found columns: {self.listed}",
            place=self.path,
            fixes=[Fix(f"name them in a columns text {how}", "columns", "TEXT")],
            wrong=problem,
            example=example,
        )


def _entry(column: NamedColumn) -> str:
    """Return index, name and first value of a column."""
    name = f"{column.index} {column.header}".rstrip()
    first = next(iter(column.filled), "")
    if len(first) > _MAX_DIGITS and is_number(first):
        first = f"{float(first):.6g}"
    elif len(first) > _MAX_TEXT:
        first = first[:_MAX_TEXT] + "…"
    return f"{name} = {first}" if first else name


def parse_columns_text(text: str, table: NamedTable) -> tuple[tuple[Triad, ...], tuple[int, ...], int | None]:
    """Return the columns named by a text such as ``t=0,g=1:4,a=4:7``.

    The sensors come first, gyroscope before accelerometer; then the indices of time and temperature.

    ``t=0+1`` joins two columns of time; ``temp`` is the temperature. Three columns are a range of indices
    (``1:4``), indices or names joined by ``+``, or the name of a vector. ``gx`` to ``az`` are single axes.
    ``a=2:5@imu`` selects rows with ``imu`` in any cell, ``a=2:5@I:0`` rows with 0 in column I. Raises
    ChoiceError if the text can't be read, or names a missing column, or a column twice.
    """
    try:
        found, rows = _parts(text, table)
        wrong = next(_problems(table, found, rows), "")
    except ValueError as error:
        wrong = str(error)
    if wrong:
        raise table.ask(f"columns text {text!r}: {wrong}")
    sensors = []
    for sensor in Sensor:
        letter = sensor.short[0]
        axes = AXES if letter in found else tuple(axis for axis in AXES if letter + axis in found)
        keys = [letter] if letter in found else [letter + axis for axis in axes]
        if keys:
            columns = tuple(table.columns[index] for key in keys for index in found[key])
            sensors.append(Triad(sensor=sensor, columns=columns, axes=axes, rows=rows[keys[0]]))
    return tuple(sensors), found.get("t", ()), next(iter(found.get("temp", ())), None)


def _parts(text: str, table: NamedTable) -> tuple[dict[str, tuple[int, ...]], dict[str, Rows]]:
    found: dict[str, tuple[int, ...]] = {}
    rows: dict[str, Rows] = {}
    for part in filter(str.strip, text.split(",")):
        name, equals, value = part.partition("=")
        key = _KEYS.get(name.strip().lower())
        if key is None or not equals or key in found:
            how = f"{part.strip()!r} is not t=…, g=…, a=…, gx=… to az=…, or temp=…"
            problem = f"{key} is named twice" if key and equals else how
            raise ValueError(problem)
        value, at, tag = value.partition("@")
        column, colon, cell = tag.partition(":")
        found[key] = _indices(value, table)
        rows[key] = (table.index_of(column), cell.strip()) if colon else (-1, tag.strip()) if at else None
    return found, rows


def _indices(value: str, table: NamedTable) -> tuple[int, ...]:
    first, colon, stop = value.strip().partition(":")
    count = len(table.columns)
    if colon and first.strip().isdigit() and stop.strip().isdigit():
        indices = tuple(range(int(first), min(int(stop), int(first) + count + 4)))
    else:
        names = value.split("+")
        indices = tuple(map(table.index_of, table.members(*names) if len(names) == 1 else names))
    missing = next((index for index in indices if index >= count), None)
    if missing is not None:
        raise ValueError(f"there is no column {missing}; the last is {count - 1}")
    return indices


def _problems(
    table: NamedTable, found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]
) -> Iterator[str]:
    if not any(key[0] in "ga" for key in found):
        yield "names neither gyroscope (g) nor accelerometer (a)"
    if len(found.get("t", ())) > 3 or len(found.get("temp", ())) > 1:
        yield "t takes up to three columns and temp takes one"
    for key in ("g", "a"):
        yield from _problems_of(table, key, found, rows)
    uses = [(index, rows[key]) for key, indices in found.items() for index in indices]
    for at, (index, own) in enumerate(uses):
        # Sensors may share a column in different rows.
        if any(index == other and (None in (own, its) or own == its) for other, its in uses[:at]):
            name = table.columns[index].header
            way = f"for a log of one axis give gz={index} alone"
            if name.strip("\"'").isdigit():
                way = (
                    f"its name is {name.strip()}, and a number that is a name comes first; give a range "
                    "such as a=2:5"
                )
            yield f"column {index} is named twice; {way}"


def _problems_of(
    table: NamedTable, key: str, found: Mapping[str, tuple[int, ...]], rows: Mapping[str, Rows]
) -> Iterator[str]:
    single = [key + axis for axis in AXES if key + axis in found]
    if key in found and single:
        yield f"{single[0]} is one of the three columns of {key}; name one of them"
    if any(len(found[one]) != 1 for one in single):
        yield f"{single[0]} takes one column"
    if len({rows[one] for one in single}) > 1:
        way = ""
        if len(table.columns) == 3:
            way = "; write a table with one value a row as one with a row for each sample"
        yield f"{' and '.join(single)} are of different rows; expected the same{way}"
    if key in found and len(found[key]) != 3:
        yield f"{key} names {len(found[key])} columns, expected 3; for one axis write {key}z={found[key][0]}"
