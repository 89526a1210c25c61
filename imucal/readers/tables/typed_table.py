"""Tables with typed columns: Parquet, HDF5, NumPy's NPZ and NPY, MATLAB's MAT; chosen by name like a CSV's.

Arrays of different lengths are tables of their own: the gyroscope may have one, the accelerometer another.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imucal.errors import ChoiceError, ImucalError
from imucal.readers.contents import LogContents
from imucal.readers.files import refused
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import Room, join_rows
from imucal.readers.tables.columns import ColumnsError, NamedTable
from imucal.readers.tables.dates import parse_texts, text_kind
from imucal.readers.tables.foreign_files import TableFile, TypedColumn, open_table
from imucal.readers.tables.plan import SensorPlan, TablePlan, make_plan
from imucal.readers.tables.stamps import Numbers, TimeChoice
from imucal.readers.tables.tabular import (
    SensorColumns,
    assemble,
    contents_of,
    of_a_part,
    refuse_topics,
    with_more,
)
from imucal.recording import Recording, Sensor
from imucal.resources import column_limit

#: Tables up to this size are read to be described, in bytes: they take less than half a second.
_SMALL = 64 << 20


class _Part(NamedTuple):
    """Columns of one length and what was chosen of them."""

    columns: Sequence[TypedColumn]
    plan: TablePlan


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a table of typed columns.

    A ChoiceError if columns, units or time are not clear, a ReadError if the file can't be read, a DataError
    if it holds no samples.
    """
    refuse_topics(path, options, "a table")
    table = open_table(path, limit=options.memory_limit)
    return _read(path, table, _parts(path, table, options), options)


def _read(path: Path, table: TableFile, parts: Sequence[_Part], options: ReadOptions) -> Recording:
    plans = [part.plan for part in parts]
    found = {sensor.triad.sensor.short for plan in plans for sensor in plan.sensors}
    # What one table lacks another may hold.
    findings = [finding for plan in plans for finding in plan.findings if finding.axis not in found]
    sensors = [_columns(part, sensor, options) for part in parts for sensor in part.plan.sensors]
    rate = table.rate_hz
    return assemble(str(path), table.format, options, plans, sensors, findings=findings, rate_hz=rate)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return what a table holds."""
    size = path.stat().st_size
    table = open_table(path, heads_above=_SMALL)
    # As numbers of eight bytes.
    unpacked = 8 * sum(column.size for column in table.columns)
    try:
        parts = _parts(path, table, options)
        read_parts = parts if unpacked <= _SMALL else [_heads(part) for part in parts]
        found = _read(path, table, read_parts, options)
    except ImucalError as error:
        shown = ", ".join(f"{column.name} ({column.size})" for column in table.columns[:60])
        return contents_of(path, table.format, f"{error}; columns: {shown}", size=size)
    contents = contents_of(path, table.format, found, size=size)
    contents = contents if unpacked <= _SMALL else of_a_part(contents, parts[0].columns[0].size)
    return replace(contents, unpacked_bytes=unpacked)


def _heads(part: _Part) -> _Part:
    """Return a part of which all that is read are the heads of its columns."""
    columns = [replace(c, size=len(c.head), values=partial(np.asarray, c.head)) for c in part.columns]
    return part._replace(columns=columns)


def _parts(path: Path, table: TableFile, options: ReadOptions) -> list[_Part]:
    """Choose the columns; of arrays of several lengths each length for itself."""
    groups = _groups(path, table)
    parts: list[_Part] = []
    for group in groups if len(groups) > 1 and options.columns is None else ():
        with suppress(ChoiceError):
            parts.append(_part(path, group, options, table.shapes))
    if not parts:
        # The indices in a columns text, and in the error that proposes one, are those of the widest table.
        widest = max(groups, key=lambda group: (len(group), group[0].size))
        return [_only_part(path, table, widest, options)]
    triads = [sensor.triad for part in parts for sensor in part.plan.sensors]
    for sensor in Sensor:
        names = [triad.headers[0] for triad in triads if triad.sensor is sensor]
        if len(names) > 1:
            two = f"two tables contain a {sensor}: {' and '.join(names[:2])}"
            raise refused(path, f"{two}; expected one; give the columns", ChoiceError)
    return parts


def _groups(path: Path, table: TableFile) -> list[list[TypedColumn]]:
    """Return the columns by their lengths; a ReadError where there are none of samples."""
    lengths = dict.fromkeys(column.size for column in table.columns if column.size > 1)
    if not lengths:
        found = ", ".join(table.shapes or [column.name for column in table.columns]) or "nothing"
        why = table.way or (
            f"no columns of samples, found {found}; expected gyroscope or accelerometer arrays with a row "
            "per sample and up to 64 columns; save only those columns"
        )
        raise refused(path, why)
    return [[column for column in table.columns if column.size == length] for length in lengths]


def _only_part(path: Path, table: TableFile, columns: Sequence[TypedColumn], options: ReadOptions) -> _Part:
    """Choose among the columns of one length; where that is open, ask for all that is."""
    try:
        return _part(path, columns, options, table.shapes)
    except ColumnsError as error:

        def tried(asked: ReadOptions) -> object:
            return _read(path, table, [_heads(_part(path, columns, asked, table.shapes))], asked)

        asking = with_more(str(path), error, options, tried)
        raise type(asking)(f"{asking}; or {table.way}" if table.way else str(asking)) from error


def _part(path: Path, columns: Sequence[TypedColumn], options: ReadOptions, shapes: Sequence[str]) -> _Part:
    names, units = [column.name for column in columns], [column.unit for column in columns]
    table = NamedTable.of(str(path), names, [column.cells for column in columns].__getitem__, units=units)
    return _Part(columns, make_plan(table, options, name=path.name, shape=", ".join(shapes)))


def _columns(part: _Part, sensor: SensorPlan, options: ReadOptions) -> SensorColumns:
    indices, at = sensor.triad.indices, part.plan.temperature
    # Copies, as samples are scaled in place; half of what may be held is for each of two sensors.
    limit = (options.memory_limit or column_limit()) // 2
    columns = SensorColumns(
        plan=sensor,
        axes=join_rows([[part.columns[index].values()] for index in indices], limit=limit),
        time=_times(part, sensor.time),
        log_time=_times(part, sensor.log_time),
        temperature=np.array(part.columns[at].values(), dtype=np.float64) if at is not None else None,
        sparse=any(part.columns[index].has_gaps for index in indices),
    )
    if sensor.triad.rows is None:
        return columns
    index, tag = sensor.triad.rows
    chosen = np.array([str(value) == tag for value in part.columns[index].values()], dtype=np.bool_)
    return columns.rows(chosen, Room(options.memory_limit))


def _times(part: _Part, time: TimeChoice | None) -> list[Numbers]:
    """Return the columns of a time as whole numbers or floats; texts in ns."""
    found: list[Numbers] = []
    for index in time.indices if time else ():
        column = part.columns[index]
        values = column.values()
        if time and time.kind == "text":
            found.append(parse_texts(list(map(str, values)), text_kind(column.cells), by_day=time.by_day))
            continue
        values = values.astype("datetime64[ns]") if values.dtype.kind == "M" else values
        # Stamps may be mended in place, so whole numbers are copied.
        whole = values.dtype.kind in "iuM"
        found.append(values.astype(np.int64) if whole else values.astype(np.float64, copy=False))
    return found
