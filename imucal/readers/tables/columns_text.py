"""The text in which a user says which columns are which: ``t=0,g=1:4,a=4:7``."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from imucal.errors import ChoiceError
from imucal.readers.tables.layout import Rows, is_number

#: A number of more letters is rounded in a message.
_LONG = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec:
    """The columns a user gave, by index."""

    time: tuple[int, ...] = ()
    gyro: tuple[int, ...] = ()
    accel: tuple[int, ...] = ()
    temperature: int | None = None
    gyro_rows: Rows = None
    accel_rows: Rows = None


_KEYS = {
    **dict.fromkeys(("t", "time"), "t"),
    **dict.fromkeys(("g", "gyro"), "g"),
    **dict.fromkeys(("a", "accel"), "a"),
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
        self.path, self.problem, self.found, self.example = path, problem, found, example
        how = (
            f"such as {example} (places from 0 with the end left out, or three names joined by +)"
            if example
            else "of the form t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their places from 0)"
        )
        super().__init__(
            f"{path}: {problem}; found columns: {found}; say which are which by a columns text {how}"
        )

    def with_example(self, example: str) -> "ColumnsError":
        """Return the same error with a columns text that works."""
        return ColumnsError(self.path, self.problem, self.found, example)


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
    the end left out (``1:4``) or indices or names joined by ``+`` (``wx+wy+wz``). ``a=2:5@imu`` takes only
    the rows that have ``imu`` in one of their cells, ``a=2:5@I:0`` those with 0 in column I.

    Raises
    ------
    ChoiceError
        If the text can't be read, or names a column that isn't there.
    """
    found: dict[str, tuple[int, ...]] = {}
    rows: dict[str, Rows] = {}
    for part in filter(str.strip, text.split(",")):
        name, equals, value = part.partition("=")
        key = _KEYS.get(name.strip().lower())
        if key is None or not equals:
            raise _wrong(text, f"{part.strip()!r} is not t=…, g=…, a=… or temp=…", headers, path)
        value, at, tag = value.partition("@")
        found[key] = _indices(value, headers, path, text)
        if at:
            rows[key] = _rows(tag, headers, path, text)
    problem = _problem(found)
    if problem:
        raise _wrong(text, problem, headers, path)
    return ColumnSpec(
        time=found.get("t", ()),
        gyro=found.get("g", ()),
        accel=found.get("a", ()),
        temperature=next(iter(found.get("temp", ())), None),
        gyro_rows=rows.get("g"),
        accel_rows=rows.get("a"),
    )


def _wrong(text: str, problem: str, headers: Sequence[str], path: str) -> ChoiceError:
    return ColumnsError(path, f"columns text {text!r}: {problem}", list_columns(headers))


def _problem(found: dict[str, tuple[int, ...]]) -> str:
    """Return what is wrong with the numbers of columns, or an empty text."""
    for key in ("g", "a"):
        if key in found and len(found[key]) != 3:
            return f"{key} names {len(found[key])} columns, expected 3"
    if "g" not in found and "a" not in found:
        return "names neither gyroscope (g) nor accelerometer (a)"
    if len(found.get("t", ())) > 3 or len(found.get("temp", ())) > 1:
        return "t takes up to three columns, temp one"
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
