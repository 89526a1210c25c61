"""Tables with typed columns: Parquet, NumPy's NPZ and NPY, MATLAB's MAT; chosen by their names like a CSV's.

An array of three columns counts as ``name[0]``, ``name[1]``, ``name[2]`` for x, y, z; columns of others say
nothing by their places. Arrays of different lengths are tables of their own: the gyroscope may have one, the
accelerometer another.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from imucal.errors import ChoiceError, ImucalError, ReadError
from imucal.findings import Finding
from imucal.readers.column_store import join_rows
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.read_options import ReadOptions
from imucal.readers.room import Room
from imucal.readers.tables.column_plan import SensorPlan, TablePlan, make_plan
from imucal.readers.tables.dates import parse_texts, text_kind
from imucal.readers.tables.scales import Work
from imucal.readers.tables.stamps import Numbers
from imucal.readers.tables.table_clock import SensorColumns
from imucal.readers.tables.table_files import TableFile, TypedColumn, open_table
from imucal.readers.tables.tabular import assemble, contents_of, refuse_topics
from imucal.readers.tables.timing import TimeChoice
from imucal.recording import Recording, Sensor
from imucal.resources import column_limit

#: Tables up to this size are read to be described, in bytes: they take less than half a second.
_SMALL = 64 << 20
#: Rows shown to the rules that choose columns.
_HEAD = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """Columns of one length and what was chosen of them."""

    columns: tuple[TypedColumn, ...]
    plan: TablePlan


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a table of typed columns.

    Raises
    ------
    ChoiceError
        If columns, units or time are not clear.
    ReadError
        If the file can't be read.
    DataError
        If it holds no samples.
    """
    refuse_topics(path, options, "a table")
    table = open_table(path, limit=options.memory_limit)
    return _read(path, table, _parts(path, table, options), options)


def _read(path: Path, table: TableFile, parts: Sequence[_Part], options: ReadOptions) -> Recording:
    sensors = [_columns(part, sensor, options) for part in parts for sensor in part.plan.sensors]
    decisions = dict.fromkeys(decision for part in parts for decision in part.plan.decisions)
    topics = [topic for part in parts for topic in part.plan.topics]
    dialect = next((part.plan.dialect for part in parts if part.plan.dialect), None)
    work = Work(
        path=str(path),
        options=options,
        dialect=dialect,
        rate_hz=table.rate_hz,
        decisions=[*decisions],
        findings=_findings(parts),
    )
    return assemble(work, sensors, table.format, topics)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return what a table holds."""
    size = path.stat().st_size
    table = open_table(path, heads_above=_SMALL)
    unpacked = table.unpacked_bytes
    shown = ", ".join(f"{column.name} ({column.size})" for column in table.columns[:60])
    try:
        parts = _parts(path, table, options)
        read_parts = parts if unpacked <= _SMALL else [_heads(part) for part in parts]
        contents = contents_of(_read(path, table, read_parts, options), path, size=size)
    except ImucalError as error:
        topic = TopicContents(name=path.name, type="table", note=f"{error}; columns: {shown}")
        return LogContents(path=str(path), format=table.format, size_bytes=size, topics=(topic,))
    contents = replace(contents, unpacked_bytes=unpacked)
    if unpacked <= _SMALL:
        return contents
    rows = parts[0].columns[0].size
    topics = tuple(replace(topic, count=rows, duration_s=None) for topic in contents.topics)
    return replace(contents, topics=topics, duration_s=None)


def _heads(part: _Part) -> _Part:
    """Return a part of which all that is read are the heads of its columns."""
    columns = tuple(replace(c, size=len(c.head), values=partial(np.asarray, c.head)) for c in part.columns)
    return replace(part, columns=columns)


def _parts(path: Path, table: TableFile, options: ReadOptions) -> list[_Part]:
    """Choose the columns; of arrays of several lengths each length for itself."""
    lengths = dict.fromkeys(column.size for column in table.columns if column.size > 1)
    groups = [tuple(c for c in table.columns if c.size == length) for length in lengths]
    if not groups:
        raise _nothing(path, table)
    parts = []
    for group in groups if len(groups) > 1 and options.columns is None else ():
        with suppress(ChoiceError):
            parts.append(_part(path, group, options, table.shapes))
    if not parts:
        # The indices in a columns text, and in the error that proposes one, are those of the widest table.
        widest = max(groups, key=lambda group: (len(group), group[0].size))
        return [_part(path, widest, options, table.shapes)]
    _refuse_doubles(path, parts)
    return parts


def _nothing(path: Path, table: TableFile) -> ReadError:
    """Return the error of a file without columns of samples."""
    shown = ", ".join(table.shapes or [column.name for column in table.columns]) or "nothing"
    return ReadError(
        f"{path}: no columns of samples, found {shown}; expected arrays of the gyroscope or the "
        "accelerometer with a row per sample and up to 64 columns; save those columns alone"
    )


def _findings(parts: Sequence[_Part]) -> list[Finding]:
    """Return what was not found; what one table lacks another may hold."""
    found = {plan.triad.sensor.short for part in parts for plan in part.plan.sensors}
    return [finding for part in parts for finding in part.plan.findings if finding.axis not in found]


def _refuse_doubles(path: Path, parts: Sequence[_Part]) -> None:
    """Refuse a sensor that stands in two tables."""
    found: dict[Sensor, list[str]] = {}
    for triad in (plan.triad for part in parts for plan in part.plan.sensors):
        names = found.setdefault(triad.sensor, [])
        names.append(triad.headers[0])
        if len(names) > 1:
            msg = (
                f"{path}: two tables hold a {triad.sensor}: {' and '.join(names)}; "
                "expected one; give the columns"
            )
            raise ChoiceError(msg)


def _part(path: Path, columns: Sequence[TypedColumn], options: ReadOptions, shapes: Sequence[str]) -> _Part:
    cells = [column.cells(_HEAD) for column in columns]
    plan = make_plan(
        str(path),
        [column.name for column in columns],
        lambda index: cells[index],
        options,
        units=[column.unit for column in columns],
        name=path.name,
        shape=", ".join(shapes),
    )
    return _Part(columns=tuple(columns), plan=plan)


def _columns(part: _Part, sensor: SensorPlan, options: ReadOptions) -> SensorColumns:
    indices, at = sensor.triad.indices, part.plan.temperature
    # Copies, as samples are scaled in place; half of what may be held is for each of two sensors.
    limit = (options.memory_limit or column_limit()) // 2
    columns = SensorColumns(
        plan=sensor,
        axes=join_rows([[part.columns[index].values()] for index in indices], limit=limit),
        time=_times(part, sensor.time),
        log_time=_times(part, sensor.log_time),
        temperature=_floats(part.columns[at]) if at is not None else None,
        sparse=any(part.columns[index].has_gaps for index in indices),
    )
    if sensor.triad.rows is None:
        return columns
    index, tag = sensor.triad.rows
    return columns.rows(part.columns[index].is_text(tag), Room(options.memory_limit))


def _times(part: _Part, time: TimeChoice | None) -> tuple[Numbers, ...]:
    if time is None:
        return ()
    columns = [part.columns[index] for index in time.indices]
    if time.kind == "text":
        kinds = [text_kind(column.cells(_HEAD)) for column in columns]
        return tuple(
            parse_texts([str(cell) for cell in column.values()], kind, by_day=time.by_day)
            for column, kind in zip(columns, kinds, strict=True)
        )
    return tuple(map(_numbers, columns))


def _numbers(column: TypedColumn) -> Numbers:
    values = column.values()
    if values.dtype.kind == "M":
        return np.asarray(values.astype("datetime64[ns]").astype(np.int64))
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    return np.asarray(values, dtype=np.float64)


def _floats(column: TypedColumn) -> Any:  # noqa: ANN401 - numpy's astype
    return np.array(column.values(), dtype=np.float64)
