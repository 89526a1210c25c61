"""Delimited text: CSV, TSV, blanks; plain or compressed; a file, standard input, or an app's set of files.

The head gives the layout, the names of the columns give the sensors, and blocks of rows go through
polars into columns. In doubt nothing is guessed: the error shows the columns and a text to choose them.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from imucal.errors import ChoiceError, DataError
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.file_sets import is_set, read_set, unpacked_size
from imucal.readers.tables.tabular import contents_of, refuse_topics
from imucal.readers.tables.text import STANDARD_INPUT, LongerError, open_text
from imucal.readers.tables.text_table import read_head, read_table
from imucal.recording import Recording

#: Texts up to this size, unpacked, are read to be described: they take less than half a second.
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
    refuse_topics(path, options, "a table of text")
    if is_set(path):
        return read_set(path, options)
    with open_text(path, progress=options.progress) as source:
        recording = read_table(source, options)
        return replace(recording, source=replace(recording.source, files=source.files()))


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the table a text holds: its columns, units, rate and what it gives.

    A table whose columns are not clear is described too; why it can't be read is its note.

    Raises
    ------
    ReadError
        If it can't be opened, or is no table.
    """
    if is_set(path):
        compression, unpacked = "zip" if path.is_file() else "none", unpacked_size(path)
        whole = unpacked <= _SMALL
        contents = _described(path, None, compression, partial(read_set, path, options, heads=not whole))
        return replace(contents if whole else _of_a_part(contents), unpacked_bytes=unpacked)
    size = path.stat().st_size if str(path) != STANDARD_INPUT and path.is_file() else None
    with open_text(path) as source:
        compression, lines = source.compression, source.head
    if size is not None and size <= _SMALL:
        try:
            return _described(path, size, compression, partial(_read_short, path, options))
        except LongerError:
            # A few bytes may unpack to very many.
            pass
    contents = _described(path, size, compression, partial(read_head, str(path), lines, options, path.name))
    return replace(_of_a_part(contents), unpacked_bytes=max(size or 0, _SMALL + 1))


def _of_a_part(contents: LogContents) -> LogContents:
    """Return what the head tells: rate and columns, but not how many rows there are."""
    topics = tuple(replace(topic, count=None, duration_s=None) for topic in contents.topics)
    return replace(contents, topics=topics, duration_s=None)


def _read_short(path: Path, options: ReadOptions) -> Recording:
    with open_text(path, progress=options.progress, most=_SMALL) as source:
        return read_table(source, options)


def _described(
    path: Path, size: int | None, compression: str, reading: Callable[[], Recording]
) -> LogContents:
    try:
        recording = reading()
    except (ChoiceError, DataError) as error:
        note = str(error).removeprefix(f"{path}: ")
        topic = TopicContents(name=path.name, type="table", note=note)
        return LogContents(
            path=str(path), format="csv", size_bytes=size, topics=(topic,), compression=compression
        )
    layout = dict(recording.source.decisions).get("layout", "table").partition(",")[0]
    return contents_of(recording, path, size=size, layout=layout, compression=compression)
