"""Sets of text files that are one recording: a gyroscope's and an accelerometer's, perhaps with their times.

Phones' apps write them as a zip or a folder (phyphox, Sensor Logger); simulators as files side by side.
"""

import re
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path, PurePath
from typing import BinaryIO, NamedTuple, cast

import numpy as np

from imucal.errors import ChoiceError, ImucalError, ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import sensor_of_name
from imucal.readers.tables.line_splits import is_number
from imucal.readers.tables.names import Role, parse_column
from imucal.readers.tables.text import TextSource, open_text
from imucal.readers.tables.text_table import EXTERNAL, ExternalTime, plan_of_head, read_head, read_table
from imucal.readers.tables.timing import TimeChoice
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.units import TIME_UNITS_NS, parse_time_unit

_ZIP = b"PK\x03\x04"

_SUFFIXES = (".csv", ".tsv", ".txt")

#: Names of files that are no raw sensor: an app's own estimates, other sensors, notes.
_LEFT_OUT = re.compile(
    r"linear|gravity|orientation|meta|annotation|magnet|baro|location|heart|pedo|step|light"
)


class _Member(NamedTuple):
    """A file of a set: its name and how to open it."""

    name: str
    open: Callable[[], TextSource]


def is_set(path: Path) -> bool:
    """Return whether a path is a zip, or a folder, of text tables."""
    if path.is_dir():
        return any(entry.suffix.lower() in _SUFFIXES for entry in path.iterdir())
    try:
        with path.open("rb") as file:
            return file.read(len(_ZIP)) == _ZIP
    except OSError:
        return False


def unpacked_size(path: Path) -> int:
    """Return how many bytes the tables of a zip, or of a folder, hold unpacked, as they state it.

    Raises
    ------
    ReadError
        If the zip can't be read.
    """
    if path.is_dir():
        return sum(entry.stat().st_size for entry in path.iterdir() if entry.suffix.lower() in _SUFFIXES)
    try:
        with zipfile.ZipFile(path) as archive:
            return sum(info.file_size for info in archive.infolist() if _is_table(info.filename))
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError) as error:
        msg = f"{path}: the zip can't be read: {error}; expected the export of a phone's app"
        raise ReadError(msg) from error


def read_set(path: Path, options: ReadOptions, *, heads: bool = False) -> Recording:
    """Read the gyroscope and the accelerometer of a zip or a folder; of `heads` only the first lines.

    Raises
    ------
    ChoiceError
        If it is not clear which files hold them.
    ReadError
        If a file can't be read.
    """
    if path.is_dir():
        entries = sorted(entry for entry in path.iterdir() if entry.suffix.lower() in _SUFFIXES)
        members = [_Member(entry.name, partial(open_text, entry)) for entry in entries]
        return _read_members(str(path), members, options, heads=heads)
    try:
        with zipfile.ZipFile(path) as archive:
            infos = [info for info in archive.infolist() if _is_table(info.filename)]
            members = [_Member(info.filename, partial(_open_member, path, archive, info)) for info in infos]
            return _read_members(str(path), members, options, heads=heads)
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, RuntimeError) as error:
        msg = f"{path}: the zip can't be read: {error}; expected the export of a phone's app"
        raise ReadError(msg) from error


def _is_table(name: str) -> bool:
    return name.lower().endswith(_SUFFIXES) and not name.startswith("__MACOSX")


def _open_member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> TextSource:
    raw = cast("BinaryIO", archive.open(info))
    return TextSource(f"{path}:{info.filename}", raw, size=None, progress=None)


def _read_members(path: str, members: Sequence[_Member], options: ReadOptions, *, heads: bool) -> Recording:
    chosen = members
    if len(members) != 1:
        both = [_choose(path, members, sensor) for sensor in (Sensor.GYROSCOPE, Sensor.ACCELEROMETER)]
        chosen = [member for member in both if member is not None]
    if not chosen:
        msg = (
            f"{path}: no file is named as a gyroscope or an accelerometer; "
            f"found {_names(members) or 'no text files'}; name the file to read"
        )
        raise ChoiceError(msg)
    parts = []
    for member in chosen:
        name = PurePath(member.name).name
        with member.open() as source:
            lines = source.head
            parts.append(
                read_head(source.name, lines, options, name)
                if heads
                else read_table(source, options, name=name)
            )
    return _merged(parts, [member.name for member in chosen], path)


def _names(members: Sequence[_Member]) -> str:
    return ", ".join(member.name for member in members)


def _choose(path: str, members: Sequence[_Member], sensor: Sensor) -> _Member | None:
    """Return the file of a sensor by its name; raw before corrected, with gravity before without."""
    stems = [(PurePath(member.name).stem.lower(), member) for member in members]
    found = [
        (stem, member)
        for stem, member in stems
        if sensor_of_name(stem) is sensor and not _LEFT_OUT.search(stem)
    ]
    if len(found) <= 1:
        return found[0][1] if found else None
    for preferred in _PREFERRED[sensor]:
        exact = [member for stem, member in found if stem == preferred]
        if len(exact) == 1:
            return exact[0]
    msg = (
        f"{path}: several files hold a {sensor} ({_names([member for _, member in found])}) "
        f"of {_names(members)}; unpack it and name the files to read"
    )
    raise ChoiceError(msg)


#: Names of files in the order in which they are taken.
_PREFERRED = {
    Sensor.GYROSCOPE: ("gyroscope", "raw data", "gyroscopeuncalibrated"),
    # Sensor Logger: Accelerometer.csv is without gravity, TotalAcceleration.csv is what the sensor measured.
    Sensor.ACCELEROMETER: ("totalacceleration", "accelerometer", "accelerometeruncalibrated"),
}


def read_many(paths: Sequence[Path], options: ReadOptions) -> Recording | None:
    """Read files that hold one sensor each, perhaps with a file of times; None where they are no such files.

    Raises
    ------
    ReadError
        If one of them can't be read.
    """
    times = [path for path in paths if _is_time_file(path)]
    tables = [path for path in paths if path not in times]
    sensors = [_sensors_of(path, options) for path in tables]
    one_each = all(len(found) == 1 for found in sensors) and len(set(sensors)) == len(tables)
    if len(times) > 1 or not tables or not one_each:
        return None
    stamps = _read_times(times[0]) if times else None
    parts = []
    for path in tables:
        with open_text(path, progress=options.progress) as source:
            parts.append(read_table(source, options, stamps=stamps))
    return _merged(parts, [path.name for path in tables], ", ".join(map(str, paths)))


def _sensors_of(path: Path, options: ReadOptions) -> tuple[Sensor, ...]:
    try:
        with open_text(path) as source:
            _, plan = plan_of_head(source, options, path.name)
    except ImucalError:
        return ()
    return tuple(sensor.triad.sensor for sensor in plan.sensors)


def _merged(parts: Sequence[Recording], names: Sequence[str], path: str) -> Recording:
    """Return the sensors of several recordings as one; each keeps its own clock."""
    source = replace(parts[0].source, path=path)
    if len(parts) == 1:
        return replace(parts[0], source=source)
    _refuse_other_times(path, names, parts)
    topics = chain.from_iterable(part.source.topics for part in parts)
    decisions = chain([("files", ", ".join(names))], *(part.source.decisions for part in parts))
    findings = chain.from_iterable(part.findings for part in parts)
    return replace(
        parts[0],
        source=replace(source, topics=tuple(topics), decisions=tuple(dict.fromkeys(decisions))),
        series=_all_series(parts),
        temperature=next((part.temperature for part in parts if part.temperature is not None), None),
        findings=tuple(dict.fromkeys(findings)),
    )


def _refuse_other_times(path: str, names: Sequence[str], parts: Sequence[Recording]) -> None:
    """Refuse files whose stamps share no time: a gyroscope and an accelerometer of different days."""
    clocks = [part.series[0].clock for part in parts]
    spans = [(c.start_ns, c.start_ns + c.duration_s * 1e9) for c in clocks if c.start_ns is not None]
    if len(spans) == len(parts) and min(end for _, end in spans) < max(start for start, _ in spans):
        msg = (
            f"{path}: {' and '.join(names)} were not recorded at the same time; expected one recording; "
            "read one file at a time"
        )
        raise ChoiceError(msg)


def _all_series(parts: Sequence[Recording]) -> tuple[AxisSeries, ...]:
    """Return the axes of all parts, the gyroscope's first; clocks that are equal become one."""
    every = chain.from_iterable(part.series for part in parts)
    series = sorted(every, key=lambda one: one.sensor is Sensor.ACCELEROMETER)
    if all(one.clock == series[0].clock for one in series):
        series = [replace(one, clock=series[0].clock) for one in series]
    return tuple(series)


def _is_time_file(path: Path) -> bool:
    """Return whether a file is one column of times with a header."""
    try:
        with open_text(path) as source:
            lines = [line.strip() for line in source.head if line.strip()]
    except ImucalError:
        return False
    if len(lines) < 3 or parse_column(lines[0], 0).role is not Role.TIME:
        return False
    return all(is_number(line) for line in lines[1:])


def _read_times(path: Path) -> ExternalTime:
    with open_text(path) as source:
        text = b"".join(source.blocks()).split()
        column = parse_column(next(line for line in source.head if line.strip()), 0)
    values = [float(cell) for cell in text if is_number(cell.decode("utf-8", "replace"))]
    unit = parse_time_unit(column.unit) if column.unit else None
    choice = TimeChoice(
        kind="stamp",
        indices=(EXTERNAL,),
        name=column.header,
        ns=TIME_UNITS_NS[unit] if unit else None,
        ns_source=f"from the header of {path.name}" if unit else "",
    )
    return ExternalTime(path=str(path), choice=choice, values=np.array(values, dtype=np.float64))
