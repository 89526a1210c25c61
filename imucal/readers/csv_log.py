"""Delimited text: CSV, TSV, blanks; plain or compressed; a file, standard input, or an app's set of files.

The head gives the layout, the names of the columns give the sensors, and blocks of rows go through
polars into columns. In doubt nothing is guessed: the error shows the columns and a text to choose them.
"""

from collections.abc import Sequence
from pathlib import Path

from imucal.errors import ImucalError
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.file_sets import is_set, read_set, read_together
from imucal.readers.options import ReadOptions
from imucal.readers.text import STANDARD_INPUT, open_text
from imucal.readers.text_table import plan_of_head, read_table
from imucal.recording import Recording

__all__ = ["describe", "read", "read_many"]

#: Files up to this size are read to be described: they take less than half a second.
_SMALL = 64 << 20


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a text table, or the zip or folder of tables that a phone's app writes.

    Raises
    ------
    ChoiceError
        If files, columns, units or time are not clear.
    ReadError
        If it can't be opened, or is no table.
    DataError
        If it holds no samples.
    """
    if is_set(path):
        return read_set(path, options)
    with open_text(path, progress=options.progress) as source:
        return read_table(source, options)


def read_many(paths: Sequence[Path], options: ReadOptions) -> Recording | None:
    """Read files that hold one sensor each, perhaps with a file of times; None where they are no such files.

    Raises
    ------
    ReadError
        If one of them can't be read.
    """
    return read_together(paths, options)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the table a text holds: its columns, units, rate and what it gives."""
    if is_set(path):
        return _described_by_reading(path, options, None, "zip" if path.is_file() else "none")
    size = path.stat().st_size if str(path) != STANDARD_INPUT and path.is_file() else None
    with open_text(path) as source:
        compression = source.compression
        lines = source.head
    if size is not None and size <= _SMALL:
        return _described_by_reading(path, options, size, compression)
    return _described_by_head(path, options, size, compression, lines)


def _described_by_reading(
    path: Path, options: ReadOptions, size: int | None, compression: str
) -> LogContents:
    try:
        recording = read(path, options)
    except ImucalError as error:
        topic = TopicContents(name=path.name, type="table", count=None, note=str(error))
        return LogContents(
            path=str(path), format="csv", size_bytes=size, topics=(topic,), compression=compression
        )
    first = recording.series[0]
    sensors = tuple(dict.fromkeys(series.sensor for series in recording.series))
    note = "; ".join(f"{what}: {how}" for what, how in recording.source.decisions)
    kind = next(
        (how.partition(",")[0] for what, how in recording.source.decisions if what == "layout"), "table"
    )
    topic = TopicContents(
        name=path.name,
        type=kind,
        count=first.n,
        rate_hz=first.rate_hz,
        duration_s=first.duration_s,
        sensors=sensors,
        note=note,
    )
    return LogContents(
        path=str(path),
        format="csv",
        size_bytes=size,
        topics=(topic,),
        start_ns=first.clock.start_ns,
        duration_s=first.duration_s,
        compression=compression,
        findings=recording.findings,
    )


def _described_by_head(
    path: Path, options: ReadOptions, size: int | None, compression: str, lines: Sequence[str]
) -> LogContents:
    try:
        layout, plan = plan_of_head(str(path), lines, options, path.name)
    except ImucalError as error:
        topic = TopicContents(name=path.name, type="table", note=str(error))
    else:
        kind = plan.signature.name if plan.signature else "table"
        note = "; ".join(f"{what}: {how}" for what, how in plan.decisions)
        sensors = tuple(sensor.triad.sensor for sensor in plan.sensors)
        topic = TopicContents(name=path.name, type=kind, rate_hz=layout.rate_hz, sensors=sensors, note=note)
    return LogContents(
        path=str(path), format="csv", size_bytes=size, topics=(topic,), compression=compression
    )
