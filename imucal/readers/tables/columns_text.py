"""The text in which a user says which columns are which: ``t=0,g=1:4,a=4:7``, or ``t=0,gz=1``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from imucal.errors import ChoiceError
from imucal.readers.tables.layout import Rows
from imucal.readers.tables.line_splits import is_number
from imucal.recording import AXES, Axis, Sensor

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
