"""Columns of numbers -> Recording: units, stamps, clocks, temperature, and how each was decided."""

from collections.abc import Sequence
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.clock import Clock
from imucal.errors import ChoiceError, DataError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.read_options import ReadOptions
from imucal.readers.room import count
from imucal.readers.tables.scales import Unscaled, Work, find_scales
from imucal.readers.tables.stamps import Numbers
from imucal.readers.tables.table_clock import SensorColumns, table_clock
from imucal.recording import Recording

#: Time and rows of a sensor -> its clock and the samples to keep: two sensors of one table share them.
_Clocks: TypeAlias = dict[tuple[Any, ...], tuple[Clock, IntArray | None]]

#: Temperatures in which electronics work, in degrees Celsius; others are raw counts.
_TEMPERATURES = (-80.0, 200.0)
#: Of so many of them at least the median is taken.
_LOOKED_AT = 1_000_000


def assemble(work: Work, sensors: Sequence[SensorColumns], form: str, topics: Sequence[str]) -> Recording:
    """Put the recording of a gyroscope, an accelerometer, or both together; `form` is what the log is.

    Raises
    ------
    ChoiceError
        If a unit or the time of the samples is open.
    DataError
        If there are no samples, or no rate.
    """
    clocks: _Clocks = {}
    timed = [_timed(work, columns, clocks) for columns in sensors]
    scales = find_scales(work, timed)
    builder = RecordingBuilder(
        path=work.path, format=form, decisions=work.decisions, findings=work.findings, room=work.room
    )
    for entry in timed:
        sensor = entry.triad.sensor
        names = entry.triad.axes
        builder.add_sensor(sensor, entry.axes, entry.clock, scale=scales[sensor], names=names)
    _add_temperature(builder, work, timed)
    return builder.build(topics=topics)


def refuse_topics(path: Path, options: ReadOptions, what: str) -> None:
    """Refuse topics, as a table has columns, with a ChoiceError."""
    if options.topics:
        msg = (
            f"{path}: {what} has no topics, but {', '.join(options.topics)} was asked for; "
            "expected no topic, or a columns text"
        )
        raise ChoiceError(msg)


def contents_of(
    recording: Recording, path: Path, *, size: int | None, layout: str = "table", compression: str = ""
) -> LogContents:
    """Return what the table of a recording holds: its layout, its units and where they come from."""
    first = recording.series[0]
    units = [f"{what} {how}" for what, how in recording.source.decisions if what.endswith("unit")]
    topic = TopicContents(
        name=path.name,
        type=layout,
        count=first.n,
        rate_hz=first.rate_hz,
        duration_s=first.duration_s,
        sensors=tuple(dict.fromkeys(series.sensor for series in recording.series)),
        note="; ".join(units),
    )
    return LogContents(
        path=str(path),
        format=recording.source.format,
        size_bytes=size,
        topics=(topic,),
        start_ns=first.clock.start_ns,
        duration_s=first.duration_s,
        compression=compression,
    )


def _timed(work: Work, columns: SensorColumns, clocks: _Clocks) -> Unscaled:
    """Drop rows that are none of the sensor's, and read its clock."""
    triad = columns.plan.triad
    keep = _rows_of_sensor(work, columns)
    if keep is not None:
        columns = columns.rows(keep, work.room)
    n = columns.axes[0].size
    if not n:
        names = ", ".join(triad.headers)
        msg = (
            f"{work.path}: the columns of the {triad.sensor} ({names}) hold no samples; "
            "expected a row per sample"
        )
        raise DataError(msg)
    key = (columns.plan.time, triad.rows, None if keep is None else blake2b(keep.data).digest(), n)
    if key not in clocks:
        reading = table_clock(work, columns)
        work.findings.extend(reading.findings)
        clocks[key] = (reading.clock, reading.order)
    clock, order = clocks[key]
    if order is not None:
        columns = columns.rows(order, work.room)
    return Unscaled(triad=triad, axes=columns.axes, temperature=columns.temperature, clock=clock)


def _rows_of_sensor(work: Work, columns: SensorColumns) -> BoolArray | None:
    """Return which rows are samples of the sensor; None where all are."""
    room, n = work.room, columns.axes[0].size
    keep: BoolArray | None = None
    if columns.sparse:
        keep = room.made(n, np.bool_, lambda part: _filled(columns.axes, part), *columns.axes)
    for column in columns.time:
        if column.dtype.kind == "f":
            finite = room.made(n, np.bool_, partial(_finite, column), column)
            before = n if keep is None else count(keep)
            both = partial(_both, finite if keep is None else keep, finite)
            keep = room.made(n, np.bool_, both, finite)
            lost = before - count(keep)
            if lost:
                text = f"{lost} rows have no finite time; they were dropped."
                work.findings.append(Finding(level="warning", code="bad-rows", text=text))
    return None if keep is None or count(keep) == n else keep


def _filled(axes: Sequence[FloatArray], part: slice) -> BoolArray:
    """Return which rows of a block hold a value."""
    empty: BoolArray = np.logical_and.reduce([np.isnan(axis[part]) for axis in axes])
    return ~empty


def _finite(column: Numbers, part: slice) -> BoolArray:
    return np.asarray(np.isfinite(column[part]))


def _both(first: BoolArray, second: BoolArray, part: slice) -> BoolArray:
    return first[part] & second[part]


def _add_temperature(builder: RecordingBuilder, work: Work, timed: Sequence[Unscaled]) -> None:
    """Add the temperature, where its column holds degrees."""
    found = next((entry for entry in timed if entry.temperature is not None), None)
    if found is None:
        return
    values = np.asarray(found.temperature, dtype=np.float64)
    some = values[:: max(1, values.size // _LOOKED_AT)]
    finite = some[np.isfinite(some)]
    if not finite.size:
        return
    usual = float(np.median(finite))
    if _TEMPERATURES[0] <= usual <= _TEMPERATURES[1]:
        builder.add_temperature(values, found.clock)
    else:
        work.decide("temperature", f"left out: a median of {usual:.4g} is not in degrees Celsius")
