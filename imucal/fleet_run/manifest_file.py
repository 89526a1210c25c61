"""The manifest of a fleet, a table of text: one row a log, with its labels and how to read it."""

import csv
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.errors import ManifestError
from imucal.recording import Sensor
from imucal.remote import is_url
from imucal.remote.addresses import shown
from imucal.units import parse_sample_unit

if TYPE_CHECKING:
    import polars as pl

#: Labels that mean something; other columns are kept as text.
LABELS = ("model", "unit", "temperature_c", "started")


@dataclass(frozen=True, slots=True, kw_only=True)
class LogEntry:
    """A log that is asked for.

    Attributes
    ----------
    path
        Of the log; of a URL what may be shown of it.
    labels
        Its own ones (`LABELS`) and free ones; what is not known is missing.
    reading
        How to read it, where that differs from the other logs.
    url
        Where it is, if that is more than the path may show: a URL with its query, which is never stored.
    """

    path: str
    labels: Mapping[str, str | float] = field(default_factory=dict)
    reading: Mapping[str, object] = field(default_factory=dict)
    url: str = field(default="", repr=False)

    @property
    def place(self) -> str:
        """Where it is: a path, or a URL with its secrets."""
        return self.url or self.path


def shown_and_url(name: str) -> tuple[str, str]:
    """Return what may be shown of a log's name, and the URL where that is more."""
    return shown(name), name if shown(name) != name else ""


def read_manifest(file: Path) -> list[LogEntry]:
    """Read a manifest: comma-separated, with headings, of which ``path`` is needed.

    A relative path begins at the manifest's folder.

    Raises
    ------
    ManifestError
        If it can't be read, has no column ``path``, a log twice, or a value that can't be meant.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeError, csv.Error) as error:
        msg = f"{file}: can't be read ({getattr(error, 'strerror', None) or error}); expected a CSV table"
        raise ManifestError(msg) from error
    heading = [name.strip() for name in rows[0]] if rows else []
    if "path" not in heading or len(set(heading)) < len(heading):
        found = ", ".join(heading) or "nothing"
        msg = f"{file}:1: the headings are {found}; expected each once, and 'path' among them"
        raise ManifestError(msg)
    entries: dict[str, LogEntry] = {}
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(heading):
            msg = f"{file}:{line}: {len(row)} cells, expected {len(heading)} as in the headings"
            raise ManifestError(msg)
        values = {name: cell.strip() for name, cell in zip(heading, row, strict=True) if cell.strip()}
        entry = _entry(values, file, line)
        if entry.path in entries:
            msg = f"{file}:{line}: {entry.path} stands twice; expected one row a log"
            raise ManifestError(msg)
        entries[entry.path] = entry
    return list(entries.values())


def stored_entries(manifest: "pl.DataFrame") -> list[LogEntry]:
    """Return the logs that a store's manifest asks for."""
    entries = []
    for row in manifest.iter_rows(named=True):
        path, options = row.pop("path"), row.pop("options")
        row.pop("copy_of")
        labels = {name: value for name, value in row.items() if value is not None}
        entries.append(LogEntry(path=path, labels=labels, reading=json.loads(options or "{}")))
    return entries


def label_of(name: str, text: str) -> str | float:
    """Return a label as a value.

    Raises
    ------
    ValueError
        If it can't be meant; says what is expected.
    """
    return _VALUES.get(name, str)(text)


def _entry(values: dict[str, str], file: Path, line: int) -> LogEntry:
    if "path" not in values:
        msg = f"{file}:{line}: no path; expected that of a log"
        raise ManifestError(msg)
    path, url = shown_and_url(values.pop("path"))
    if not is_url(path):
        path = str(file.parent / path)
    labels: dict[str, str | float] = {}
    reading: dict[str, object] = {}
    for name, text in values.items():
        try:
            if name in _READING:
                reading[name] = _READING[name](text)
            else:
                labels[name] = label_of(name, text)
        except ValueError as error:
            msg = f"{file}:{line}: column {name!r} is {text!r}, expected {error}"
            raise ManifestError(msg) from error
    return LogEntry(path=path, labels=labels, reading=reading, url=url)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        msg = "a number"
        raise ValueError(msg)
    return value


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0:
        msg = "a number above 0"
        raise ValueError(msg)
    return value


def _duration(text: str) -> float:
    value = _number(text)
    if value < 0:
        msg = "a time in s, 0 or more"
        raise ValueError(msg)
    return value


def _date(text: str) -> str:
    try:
        datetime.fromisoformat(text)
    except ValueError:
        msg = "a date such as 2026-01-31 or 2026-01-31T12:00:00Z"
        raise ValueError(msg) from None
    return text


def _yes(text: str) -> bool:
    known = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    if text.lower() not in known:
        msg = "true or false"
        raise ValueError(msg)
    return known[text.lower()]


def _unit_of(sensor: Sensor) -> Callable[[str], str]:
    def check(text: str) -> str:
        found = parse_sample_unit(text)
        if found is None or found[0] is not sensor:
            msg = f"a unit of the {sensor}, such as {'deg/s' if sensor is Sensor.GYROSCOPE else 'g'}"
            raise ValueError(msg)
        return text

    return check


def _time_unit(text: str) -> str:
    if text not in {"s", "ms", "us", "ns"}:
        msg = "s, ms, us or ns"
        raise ValueError(msg)
    return text


#: Column -> what its text means as an argument of `imucal.read`.
_READING: dict[str, Callable[[str], object]] = {
    "topic": str.split,
    "time": str,
    "time_unit": _time_unit,
    "rate_hz": _positive,
    "gyro_unit": _unit_of(Sensor.GYROSCOPE),
    "accel_unit": _unit_of(Sensor.ACCELEROMETER),
    "gyro_scale": _positive,
    "accel_scale": _positive,
    "columns": str,
    "fields": lambda text: [text],
    "message_definition": lambda text: [text],
    "strict": _yes,
    "skip_s": _duration,
    "take_s": _positive,
}
_VALUES: dict[str, Callable[[str], str | float]] = {"temperature_c": _number, "started": _date}
