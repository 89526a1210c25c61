"""Tables with typed columns: Parquet, HDF5, NumPy's NPZ and NPY, MATLAB's MAT; chosen by name like a CSV's.

Arrays of different lengths are tables of their own: the gyroscope may have one, the accelerometer another.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from imucal.errors import ImucalError
from imucal.readers.contents import LogContents
from imucal.readers.files import refused
from imucal.readers.message_logs import OpenLog, read_log
from imucal.readers.messages.topics import HELD_ROWS, Column, Topic, held_topic
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import ColumnsError
from imucal.readers.tables.foreign_files import TableFile, TypedColumn, open_table
from imucal.readers.tables.tabular import contents_of, refuse_topics, with_more
from imucal.recording import Recording


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a table of typed columns.

    A ChoiceError if columns, units or time are not clear, a ReadError if the file can't be read, a DataError
    if it holds no samples.
    """
    return _read(path, open_table(path), options)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return what a table holds."""
    size, table = path.stat().st_size, open_table(path)
    found: Recording | str
    try:
        found = _read(path, table, options)
    except ImucalError as error:
        shown = ", ".join(f"{column.name} ({column.values.size})" for column in table.columns[:60])
        found = f"{error}; columns: {shown}"
    # As numbers of eight bytes.
    unpacked = 8 * sum(column.values.size for column in table.columns)
    return replace(contents_of(path, table.format, found, size=size), unpacked_bytes=unpacked)


def _read(path: Path, table: TableFile, options: ReadOptions) -> Recording:
    topics = _topics(path, table, options)
    if len(topics) == 1:
        refuse_topics(path, options, "a table")
    try:
        return read_log(_log(path, table, topics), options)
    except ColumnsError as error:

        def tried(asked: ReadOptions) -> object:
            heads = [replace(one, held=tuple(values[:HELD_ROWS] for values in one.held)) for one in topics]
            return read_log(_log(path, table, heads), asked)

        asking = with_more(str(path), error, options, tried)
        raise type(asking)(f"{asking}; or {table.way}" if table.way else str(asking)) from error


def _log(path: Path, table: TableFile, topics: list[Topic]) -> OpenLog:
    return OpenLog(path, table.format, topics, rate_hz=table.rate_hz)


def _topics(path: Path, table: TableFile, options: ReadOptions) -> list[Topic]:
    """Return the columns of each length that have a sensor as a topic; if there are none, the widest.

    The indices in a columns text, and in the error that proposes one, are those of the widest table, or the
    longest of the widest.
    """
    groups = _groups(path, table)
    topics = []
    if len(groups) > 1 and options.columns is None:
        topics = [_topic(path, group, table, options, f"{group[0].values.size} rows") for group in groups]
    widest = max(groups, key=lambda group: (len(group), group[0].values.size))
    return [one for one in topics if one.sensors] or [_topic(path, widest, table, options, path.name)]


def _groups(path: Path, table: TableFile) -> list[list[TypedColumn]]:
    """Return the columns by their lengths; a ReadError where there are none of samples."""
    lengths = dict.fromkeys(column.values.size for column in table.columns if column.values.size > 1)
    if not lengths:
        found = ", ".join(table.shapes or [column.name for column in table.columns]) or "nothing"
        why = table.way or (
            f"no columns of samples, found {found}; expected gyroscope or accelerometer arrays with a row "
            "per sample and up to 64 columns; save only those columns"
        )
        raise refused(path, why)
    return [[column for column in table.columns if column.values.size == n] for n in lengths]


def _topic(path: Path, group: list[TypedColumn], table: TableFile, options: ReadOptions, name: str) -> Topic:
    columns = {
        Column(one.name, str(at), one.values.dtype.name, one.unit): one.values for at, one in enumerate(group)
    }
    heads = [one.values[:HELD_ROWS] for one in group if one.values.dtype.kind == "f"]
    sparse = any(bool(np.isnan(head).any()) for head in heads)
    shapes = ", ".join(table.shapes)
    return held_topic(name, "table", columns, options, file=str(path), shapes=shapes, sparse=sparse)
