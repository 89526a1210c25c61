"""Delimited text: CSV, TSV, blanks; plain or compressed; a file, standard input, or an app's set of files.

The head gives the layout, the names of the columns give the sensors, and blocks of rows go through
polars into columns. In doubt nothing is guessed: the error shows the columns and a text to choose them.
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from imucal.errors import ChoiceError, DataError
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.file_sets import is_set, read_set
from imucal.readers.tables.tabular import contents_of, refuse_topics
from imucal.readers.tables.text import STANDARD_INPUT, TextSource, open_text
from imucal.readers.tables.text_table import read_table
from imucal.recording import Recording

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
    refuse_topics(path, options, "a table of text")
    if is_set(path):
        return read_set(path, options)
    with open_text(path, progress=options.progress) as source:
        return read_table(source, options)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the table a text holds: its columns, units, rate and what it gives.

    A table whose columns are not clear is described too; why it can't be read is its note.

    Raises
    ------
    ReadError
        If it can't be opened, or is no table.
    """
    if is_set(path):
        compression = "zip" if path.is_file() else "none"
        return _described(path, None, compression, partial(read, path, options))
    size = path.stat().st_size if str(path) != STANDARD_INPUT and path.is_file() else None
    with open_text(path) as source:
        compression, lines = source.compression, source.head
    if size is not None and size <= (_SMALL if compression == "none" else _SMALL // 8):
        return _described(path, size, compression, partial(read, path, options))
    contents = _described(path, size, compression, partial(_read_head, path, lines, options))
    # The head tells rate and columns; how many rows there are only reading all of them would tell.
    topics = tuple(replace(topic, count=None, duration_s=None) for topic in contents.topics)
    return replace(contents, topics=topics, duration_s=None)


def _read_head(path: Path, lines: Sequence[str], options: ReadOptions) -> Recording:
    text = io.BytesIO(("\n".join(lines) + "\n").encode())
    with TextSource(str(path), text, size=None, progress=None) as source:
        return read_table(source, options, name=path.name)


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
