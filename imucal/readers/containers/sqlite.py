"""SQLite file of a ROS 2 bag: its topics, and its messages in ranges of rows."""

import shlex
import sqlite3
import struct
import time
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from imucal.errors import Fix, ReadError
from imucal.findings import Finding
from imucal.readers.containers.container import Batch, Channel, Loss, MessageFile, Task
from imucal.readers.files import first_bytes, refused
from imucal.readers.isolation import patience

Value = TypeVar("Value")

#: Signature of a write-ahead log.
_WAL = b"\x37\x7f\x06"
#: Average bytes of a task.
_PART = 1 << 22
#: Fewest rows of a task.
_ROWS = 256
#: Rows fetched at once; more is slower.
_FETCH = 1024
#: Damaged ranges are halved down to this many rows.
_MIN_RANGE = 16
#: Most rows counted by topic: counting takes 0.1 us a row.
_COUNTED = 2_000_000
#: Larger files are not checked page by page, in bytes: the check takes 0.6 us a row, a quarter of reading it.
_CHECKED_BYTES = 1 << 24
#: Longest value, in bytes; messages of images and point clouds are shorter.
_MAX_VALUE = 1 << 28
#: Instructions of SQLite between checks of the time: about 10 ms.
_INSTRUCTIONS = 100_000
#: Values of `hidden` in SQLite's table_xinfo for columns that SQLite computes.
_GENERATED = frozenset({2, 3})
#: Tables of a bag that are read -> their columns; bags older than ROS 2 Iron have no definitions.
_TABLES = {
    "messages": ("topic_id", "timestamp", "data"),
    "topics": ("id", "name", "type", "serialization_format"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition"),
}
_REQUIRED = ("messages", "topics")
#: The last byte of an error code is its kind; the other bytes are details.
_KIND = 0xFF
#: Kinds of errors of a database that another program writes.
_IN_USE = frozenset({sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED})
#: The last three come from values of a wrong type.
_ERRORS = (sqlite3.Error, TypeError, ValueError, OverflowError)


class SqliteFile(MessageFile):
    """Messages of a `.db3` file; `counts` are from the bag's metadata, used if counting takes too long."""

    format = "rosbag2-sqlite3"
    compression = "none"
    # A connection serves one thread at a time.
    parallel = False

    def __init__(self, path: Path, counts: Mapping[str, int] | None = None) -> None:
        self._counts = counts
        self._opened = ExitStack()
        super().__init__(path)

    def _read_index(self) -> None:
        self._end = time.monotonic() + patience(self.size)
        try:
            self._base = self._connect()
            self._check_tables()
            first, last = self._ends("rowid")
            self._rows = range(0) if first is None or last is None else range(first, last + 1)
            self.start_ns, self.end_ns = _if_whole(lambda: self._ends("timestamp")) or (None, None)
            self.channels = self._channels()
            self._check_pages()
        except _ERRORS as error:
            raise _refusal(self.path, error) from error

    def _connect(self) -> sqlite3.Connection:
        """Open the database without creating files next to it if possible."""
        wal = self.path.with_name(self.path.name + "-wal")
        try:
            log = first_bytes(wal, 3) if wal.exists() else b""
        except ReadError:
            log = b"?"
        head = self._file.read(0, min(self.size, 100)).ljust(100, b"\0")
        if log != _WAL:
            self._check_size(head)
        if log == _WAL or (not log and head[18] != 2):
            try:
                return self._query_only("mode=ro")
            except sqlite3.OperationalError:
                if not log:
                    raise
        base = self._query_only("mode=ro&immutable=1")
        if log:
            text = f"{wal.name} can't be read; messages that are only in it are missing."
            advice = "Copy the bag to a folder with write permission."
            self.findings.append(Finding("warning", "wal-ignored", text, advice))
        return base

    def _check_size(self, head: bytes) -> None:
        """Raise an error for a truncated file, which SQLite would fill with zeros."""
        page, pages = struct.unpack_from(">H10xI", head, 16)
        stated = pages * (page if page > 1 else 1 << 16)
        # Encrypted files lack these constants.
        if stated > self.size and head[21:24] == b"\x40\x20\x20":
            raise sqlite3.DatabaseError(f"it has {self.size} of {stated} bytes")

    def _query_only(self, options: str) -> sqlite3.Connection:
        uri = f"{self.path.absolute().as_uri()}?{options}"
        base = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self._opened.callback(base.close)
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_VALUE)
        base.set_progress_handler(lambda: time.monotonic() > self._end, _INSTRUCTIONS)
        base.execute("pragma trusted_schema=off")
        base.execute("select count(*) from sqlite_master").fetchone()
        return base

    def _check_tables(self) -> None:
        """Raise ReadError if tables or columns of a bag are missing, or are computed by the database.

        Views, virtual tables and computed columns may run forever, or return more than the file contains.
        """
        lacking = set(_REQUIRED)
        for name, kind, page in self._base.execute("select name, type, rootpage from sqlite_master"):
            table = str(name).lower()
            if table not in _TABLES:
                continue
            lacking.discard(table)
            columns = self._base.execute("select name, hidden from pragma_table_xinfo(?)", (name,)).fetchall()
            computed = [str(column) for column, hidden in columns if hidden in _GENERATED]
            there = {str(column).lower() for column, _ in columns}
            missing = [column for column in _TABLES[table] if column not in there]
            found = ""
            if kind != "table":
                found = f"{name} is a {kind}"
            elif not page:
                found = f"{name} is a virtual table"
            elif computed:
                found = f"column {computed[0]} of {name} is computed"
            if found:
                advice = "expected a table that ROS wrote; read a bag that you recorded or trust"
                raise refused(self.path, f"{found}; {advice}")
            if missing:
                raise _incomplete(self.path, f"table {name} has no column {missing[0]}")
        if lacking:
            raise _incomplete(self.path, f"there is no table {min(lacking)}")

    def _check_pages(self) -> None:
        """Add a finding if pages are damaged, or if the table lacks messages that its index lists."""
        problem = ""
        try:
            if self.size <= _CHECKED_BYTES:
                answer = str(self._base.execute("pragma quick_check(1)").fetchone()[0])
                problem = "" if answer == "ok" else answer.splitlines()[-1]
            counted = self._base.execute("select count(*) from messages not indexed").fetchone()[0]
            listed = self._base.execute("select count(*) from messages").fetchone()[0]
            if counted != listed:
                problem = f"the table has {counted} messages and its index {listed}"
        except sqlite3.OperationalError:
            raise
        except sqlite3.Error as error:
            problem = str(error)
        if problem:
            text = f"The SQLite database is damaged: {problem}; messages may be lost."
            self.findings.append(Finding("warning", "damaged", text, "Copy the bag again."))

    def close(self) -> None:
        super().close()
        self._opened.close()

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        wanted = sorted(keys & {channel.key for channel in self.channels if channel.count != 0})
        if not wanted or not self._rows:
            return
        # len() of a range is limited to 63 bits.
        total = self._rows.stop - self._rows.start
        step = max(total * _PART // self.size, _ROWS)
        for first in range(self._rows.start, self._rows.stop, step):
            rows = range(first, min(first + step, self._rows.stop))
            size = max(self.size * (rows.stop - first) // total, 1)
            yield Task(size, frozenset(wanted), partial(self._load, wanted, rows))

    def _load(self, keys: list[int], rows: range) -> Iterator[tuple[int, Batch]]:
        for key in keys:
            yield from ((key, batch) for batch in self._fetch(key, rows))

    def _fetch(self, key: int, rows: range) -> Iterator[Batch]:
        lost, reason = 0, ""
        ranges = [rows]
        while ranges:
            rows = ranges.pop()
            size = rows.stop - rows.start
            try:
                batch = self._fetch_range(key, rows)
            except sqlite3.OperationalError as error:
                raise _refusal(self.path, error) from error
            except _ERRORS as error:
                if size > _MIN_RANGE:
                    middle = rows.start + size // 2
                    ranges += [range(middle, rows.stop), range(rows.start, middle)]
                else:
                    lost, reason = lost + size, reason or f"rows from {rows.start} on: {error}"
            else:
                yield batch
        if lost:
            loss = Loss("damaged", f"the SQLite database can't be read at {reason}", lost)
            yield replace(batch_of_blobs([], []), loss=loss)

    def _fetch_range(self, key: int, rows: range) -> Batch:
        # `order by` would use the index of times.
        query = "select timestamp, data from messages where rowid between ? and ? and topic_id = ?"
        values: list[Any] = []
        cursor = self._base.execute(query, (rows.start, rows.stop - 1, key))
        while found := cursor.fetchmany(_FETCH):
            values += chain.from_iterable(found)
        return batch_of_blobs(values[1::2], values[0::2])

    def sample(self) -> bytes:
        try:
            row = self._base.execute("select substr(data, 1, 4) from messages limit 1").fetchone()
        except sqlite3.Error:
            return b""
        return bytes(row[0]) if row and isinstance(row[0], bytes) else b""

    def _ends(self, column: str) -> tuple[int | None, int | None]:
        # Separate statements use the index; together they scan the table.
        queries = (f"select {end}({column}) from messages" for end in ("min", "max"))  # noqa: S608 - our own
        first, last = (self._base.execute(query).fetchone()[0] for query in queries)
        return (None, None) if first is None or last is None else (int(first), int(last))

    def _channels(self) -> list[Channel]:
        # Bags older than ROS 2 Iron have no definitions.
        definitions: dict[str, tuple[str, str]] = {}
        tables = {name for (name,) in self._base.execute("select name from sqlite_master")}
        if "message_definitions" in tables:
            query = "select topic_type, encoding, encoded_message_definition from message_definitions"
            found = self._base.execute(query).fetchall()
            definitions = {row[0]: row[1:] for row in found if all(isinstance(value, str) for value in row)}
        query = "select id, name, type, serialization_format from topics"
        rows = self._base.execute(query).fetchall()
        # Damaged pages contain rows of other types.
        topics = [row for row in rows if [type(value) for value in row] == [int, str, str, str]]
        counts = self._count(topics)
        return [
            Channel(
                key=key,
                topic=name,
                type=kind,
                encoding=encoding,
                definition_kind=definitions.get(kind, ("", ""))[0],
                definition=definitions.get(kind, ("", ""))[1],
                count=counts.get(key, 0) if counts is not None else None,
                first_ns=self.start_ns,
                last_ns=self.end_ns,
            )
            for key, name, kind, encoding in topics
        ]

    def _count(self, topics: list[Any]) -> dict[int, int] | None:
        span = self._rows.stop - self._rows.start
        # SQLite counts with the index of times, so rows lost in the table are counted.
        total = _if_whole(lambda: int(self._base.execute("select count(*) from messages").fetchone()[0]))
        if len(topics) == 1:
            return {topics[0][0]: span if total is None else total}
        known = self._counts or {}
        stated = {key: known[name] for key, name, _, _ in topics if name in known}
        complete = len(stated) == len(topics)
        if complete and (sum(stated.values()) == total or span > _COUNTED):
            return stated
        if span > _COUNTED:
            return None
        query = "select topic_id, count(*) from messages group by topic_id"
        return _if_whole(lambda: dict(self._base.execute(query).fetchall()))


def batch_of_blobs(blobs: list[bytes], times: list[int]) -> Batch:
    """Return messages as one batch; raises TypeError if a value has another type."""
    sizes = np.fromiter(map(len, blobs), dtype=np.int64, count=len(blobs))
    # Unlike NumPy, `array` refuses floats.
    return Batch(b"".join(blobs), np.cumsum(sizes) - sizes, sizes, np.array(array("q", times)))


def _if_whole(query: Callable[[], Value]) -> Value | None:
    """Return the result of a query; None if rows are damaged, which is reported on reading."""
    try:
        return query()
    except sqlite3.OperationalError:
        raise
    except _ERRORS:
        return None


def _incomplete(path: Path, found: str) -> ReadError:
    problem = f"the SQLite database can't be read: {found}; expected a ROS 2 bag"
    return ReadError(problem, place=path, fix=Fix("check that it is complete"))


def _refusal(path: Path, error: Exception) -> ReadError:
    # .recover needs the virtual table of pages, which Debian's sqlite3 lacks.
    advice = (
        f"copy it again, or recover it with `sqlite3 {shlex.quote(path.name)} .recover | "
        "sqlite3 recovered.db3` (use sqlite3 from sqlite.org if yours prints an SQL error)"
    )
    # Python's own errors have no code.
    kind = getattr(error, "sqlite_errorcode", 0) & _KIND
    if kind == sqlite3.SQLITE_INTERRUPT:
        advice = "a query takes too long, so the file is damaged or was not written by ROS"
    elif kind in _IN_USE:
        advice = "stop the recorder, or copy the bag and read the copy"
    problem = f"the SQLite database can't be read: {error}; expected a ROS 2 bag"
    return ReadError(problem, place=path, fix=Fix(advice))
