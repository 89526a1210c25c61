"""The labels and arguments of logs: from a table of logs, or from their paths."""

import csv
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, TypeAlias

from imucal.errors import ImucalError, ManifestError
from imucal.fleet.logs import LogTask, label_pattern
from imucal.recording import Sensor
from imucal.remote import is_url
from imucal.units import parse_increment_unit, parse_sample_unit, time_unit_ns

#: Description for messages, parser of the text, and test of the parsed value.
Column: TypeAlias = tuple[str, Callable[[Any], Any], Callable[[Any], object]]
#: Labels with a meaning; a table and paths may have others.
LABELS = ("model", "unit", "temperature_c", "started")


def labels_in(path: str, pattern: str | None) -> dict[str, str | float]:
    """Return the labels in a path, or none; raises ManifestError for an invalid label."""
    found = label_pattern(pattern).match(path.replace("\\", "/")) if pattern else None
    columns = {name: _COLUMNS.get(name, _ANY) for name in LABELS}
    return {
        name: meant(columns.get(name, _ANY), text, f"labels: {path}: {name} is", ManifestError)
        for name, text in (found.groupdict() if found else {}).items()
    }


#: Wrong cells of a table that a message names.
_NAMED = 8


def read_manifest(file: Path) -> list[LogTask]:
    """Read a CSV table with headings and a column ``path``; relative paths start at its folder.

    Raises ManifestError if it can't be read or has no column ``path``; for a log twice and for invalid
    values, the error names each wrong cell.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            heading, *rows = [[cell.strip() for cell in row] for row in csv.reader(stream)] or [[]]
    except (OSError, UnicodeError, csv.Error) as error:
        problem = f"can't be read ({getattr(error, 'strerror', None) or error}); expected a CSV table"
        raise ManifestError(problem, place=file) from error
    if "path" not in heading or len(set(heading)) < len(heading):
        found = ", ".join(heading) or "nothing"
        raise ManifestError(f"{file}:1: the headings are {found}; expected each once, and 'path' among them")
    logs: dict[str, LogTask] = {}
    wrong: list[str] = []
    for line, row in enumerate(rows, 2):
        if not any(row):
            continue
        problems = _problems(heading, row)
        if problems:
            wrong.append(f"{file}:{line}: {'; '.join(problems)}")
            continue
        log = _of_row(heading, row, file.parent)
        if log.path in logs:
            wrong.append(f"{file}:{line}: {log.path} is duplicated; expected one row per log")
        logs[log.path] = log
    if wrong:
        more = [f"and {len(wrong) - _NAMED} more rows"] if len(wrong) > _NAMED else []
        raise ManifestError("\n".join([*wrong[:_NAMED], *more]))
    return list(logs.values())


def _problems(heading: Sequence[str], row: Sequence[str]) -> list[str]:
    """Return what is wrong with each cell of a row; nothing for a valid one."""
    if len(row) != len(heading):
        return [f"{len(row)} cells, expected {len(heading)} as in the headings"]
    cells = dict(zip(heading, row, strict=True))
    columns = {name: _COLUMNS.get(name, _ANY) for name in heading}
    wrong = [
        _unlike(columns[name], text, f"column {name!r} is")
        for name, text in cells.items()
        if text and parsed(columns[name], text) is None
    ]
    return wrong if cells["path"] else [*wrong, "no path; expected the path of a log"]


def _of_row(heading: Sequence[str], row: Sequence[str], folder: Path) -> LogTask:
    """Return the log of a valid row."""
    cells = {
        name: parsed(_COLUMNS.get(name, _ANY), text)
        for name, text in zip(heading, row, strict=True)
        if text and name != "path"
    }
    place = row[heading.index("path")]
    reading = {name: cells.pop(name) for name in _COLUMNS if name in cells and name not in LABELS}
    return LogTask(place=place if is_url(place) else str(folder / place), labels=cells, reading=reading)


def parsed(column: Column, text: Any) -> Any:  # noqa: ANN401 - of any column
    """Return the value of a text; None if it does not fit the column."""
    _, parse, fits = column
    with suppress(ValueError, KeyError, TypeError):
        value = parse(text)
        return value if fits(value) else None
    return None


def meant(column: Column, text: Any, name: str, error: type[ImucalError]) -> Any:  # noqa: ANN401
    """Return the parsed value; raise `error` with the name, the value and what was expected."""
    value = parsed(column, text)
    if value is None:
        raise error(_unlike(column, text, name))
    return value


def _unlike(column: Column, text: Any, name: str) -> str:  # noqa: ANN401
    """Return the sentence about a text that does not fit its column."""
    return f"{name} {text!r}, expected {column[0]}"


def _unit_of(sensor: Sensor, such_as: str) -> Column:
    what = f"a unit of the {sensor}, such as {such_as}"
    return (
        what,
        str,
        lambda text: (parse_sample_unit(text) or parse_increment_unit(text) or (None,))[0] is sensor,
    )


_ANY: Column = ("text", str, bool)
_YES = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
#: Labels, then arguments of `imucal.read`.
_COLUMNS: dict[str, Column] = {
    "temperature_c": ("a number", float, math.isfinite),
    "started": ("a date such as 2026-01-31 or 2026-01-31T12:00:00Z", str, datetime.fromisoformat),
    **dict.fromkeys(("time", "columns"), _ANY),
    "topic": ("text", str.split, bool),
    **dict.fromkeys(("fields", "message_definition"), ("text", lambda text: [text], bool)),
    "time_unit": (
        "a unit such as s, ms, us, ns, min or 100ns",
        str,
        lambda text: time_unit_ns(text) is not None,
    ),
    "gyro_unit": _unit_of(Sensor.GYROSCOPE, "deg/s"),
    "accel_unit": _unit_of(Sensor.ACCELEROMETER, "g"),
    "strict": ("true or false", lambda text: _YES[text.lower()], lambda _: True),
    "skip_s": ("a time in s, 0 or more", float, lambda value: 0 <= value < math.inf),
    **dict.fromkeys(
        ("rate_hz", "gyro_scale", "accel_scale", "take_s"),
        ("a number above 0", float, lambda value: 0 < value < math.inf),
    ),
}
