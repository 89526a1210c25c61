"""A ROS 2 bag's SQLite file opened: its topics, and its messages in ranges of rows."""

import sqlite3
import threading
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, cast

import numpy as np

from imucal.arrays import IntArray
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.containers.container import Batch, Channel, Task
from imucal.readers.containers.sqlite_connect import connect, connect_to_start
from imucal.readers.containers.sqlite_pages import (
    Fetch,
    Leaves,
    PageTask,
    find_leaves,
    page_size,
    scan_leaves,
)
from imucal.readers.files import DamagedError, LogFile, Scratch

#: Rows of one task.
_RANGE = 1 << 14
#: Columns of `messages`, in the order that the pages are read in.
_COLUMNS = ["id", "topic_id", "timestamp", "data"]
#: Rows fetched at once; more is slower.
_FETCH = 1024
#: Rows up to which messages are counted one by one when the bag doesn't say how many there are.
_COUNTED = 2_000_000


class SqliteFile:
    """A container of the messages of a `.db3` file.

    Parameters
    ----------
    counts
        Topic -> messages, where the bag's metadata tells.
    """

    format = "rosbag2-sqlite3"
    compression = "none"
    parallel = True

    def __init__(self, path: Path, counts: Mapping[str, int] | None = None) -> None:
        self.path = path
        self._file = LogFile(path)
        self.size = self._file.size
        self.findings: list[Finding] = []
        self._base: sqlite3.Connection | None = None
        self._lock = threading.Lock()
        self._cut = False
        try:
            self._open(counts)
        except (sqlite3.Error, OverflowError, TypeError, ValueError, DamagedError) as error:
            self.close()
            msg = (
                f"{path}: the SQLite database can't be read: {error}; expected a ROS 2 bag, "
                "try to recover it with `sqlite3 FILE .recover`"
            )
            raise ReadError(msg) from error

    def _open(self, counts: Mapping[str, int] | None) -> None:
        try:
            self._base = connect(self.path, self.findings)
            self.first_id, self.last_id = self._ids()
            self.start_ns, self.end_ns = self._span()
            self.channels = self._channels(counts)
        except sqlite3.DatabaseError as error:
            if self._base is not None:
                self._base.close()
            self._cut = True
            self._base = connect_to_start(self._file)
            self.first_id, self.last_id = 1, 0
            self.start_ns = self.end_ns = None
            self.channels = self._channels({})
            text = f"SQLite can't read the database ({error}); its pages were scanned for whole messages."
            code = "truncated" if self._is_cut() else "damaged"
            self.findings.append(Finding(level="warning", code=code, text=text))

    def _is_cut(self) -> bool:
        """Say whether the file has fewer pages than its first one says."""
        head = self._file.read(0, 100)
        return int.from_bytes(head[28:32], "big") * page_size(self._file)[0] > self.size

    def close(self) -> None:
        """Close the database."""
        self._file.close()
        if self._base is not None:
            self._base.close()

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield groups of pages; ranges of rows where only SQLite can read them."""
        known = {channel.key for channel in self.channels if channel.count != 0}
        wanted = sorted(keys & known)
        if not wanted or (not self._cut and self.last_id < self.first_id):
            return
        if not self._cut and self._needs_sqlite():
            for rows, size in self._ranges():
                yield cast("Task", SqliteTask(self._database, wanted, rows, size))
            return
        groups, fetch = self._pages()
        for pages, most in groups:
            yield cast("Task", PageTask(self._file, pages, wanted, most, fetch))

    @property
    def _database(self) -> sqlite3.Connection:
        if self._base is None:
            msg = f"{self.path}: the database is closed"
            raise ValueError(msg)
        return self._base

    def _needs_sqlite(self) -> bool:
        """Say whether the pages of the file alone don't hold the messages, or hold them in another order."""
        wal = self.path.with_name(self.path.name + "-wal")
        columns = [row[1] for row in self._database.execute("pragma table_info(messages)")]
        needs = (wal.exists() and wal.stat().st_size > 0) or columns != _COLUMNS
        # SQLite takes a lock that several threads would wait for.
        self.parallel = not needs
        return needs

    def _pages(self) -> tuple[list[tuple[IntArray, int]], Fetch | None]:
        """Return the leaf pages of the messages, by their tree, or all there are where it is damaged."""
        try:
            if not self._cut:
                return list(self._leaves().groups()), self._fetch
        except DamagedError as error:
            text = f"The database is damaged: {error}; its pages were scanned for whole messages."
            self.findings.append(Finding(level="warning", code=error.code, text=text))
        return scan_leaves(self._file), None

    def _leaves(self) -> Leaves:
        query = "select rootpage from sqlite_master where type = 'table' and name = 'messages'"
        root = int(self._database.execute(query).fetchone()[0])
        leaves = find_leaves(self._file, root, self.first_id, self.last_id)
        if int(leaves.pages.max()) * page_size(self._file)[0] > self.size:
            msg = "pages beyond the end of the file are missing"
            raise DamagedError(msg, code="truncated")
        return leaves

    def _fetch(self, rows: list[int]) -> list[tuple[int, int, bytes]]:
        """Return rows that reach over several pages."""
        query = "select topic_id, timestamp, data from messages where id = ?"
        found = []
        with self._lock:
            for row in rows:
                try:
                    values = self._database.execute(query, (row,)).fetchone()
                except (sqlite3.Error, OverflowError) as error:
                    msg = f"the SQLite database is damaged: {error}"
                    raise DamagedError(msg) from error
                if values is not None and isinstance(values[2], bytes):
                    found.append((int(values[0]), int(values[1]), values[2]))
        return found

    def _ranges(self) -> list[tuple[tuple[int, int], int]]:
        """Return ranges of rows, and the bytes of each."""
        rows = self.last_id - self.first_id + 1
        # Rows have a few bytes at least: ids that are further apart are damaged, or sparse.
        step = _RANGE if rows <= self.size // 32 else rows // max(self.size // (32 * _RANGE), 1) + 1
        size = max(self.size // max(rows // step, 1), 1)
        firsts = range(self.first_id, self.last_id + 1, step)
        return [((first, min(first + step - 1, self.last_id)), size) for first in firsts]

    def sample(self) -> bytes:
        """Return the start of the first message's payload, which tells whether it is compressed."""
        try:
            row = self._database.execute("select substr(data, 1, 4) from messages limit 1").fetchone()
        except sqlite3.Error:
            return b""
        return bytes(row[0]) if row and isinstance(row[0], bytes) else b""

    def _ids(self) -> tuple[int, int]:
        first, last = self._ends("id")
        return (int(first), int(last)) if first is not None and last is not None else (1, 0)

    def _span(self) -> tuple[int | None, int | None]:
        return self._ends("timestamp")

    def _ends(self, column: str) -> tuple[int | None, int | None]:
        """Return the smallest and the largest value of an indexed column of the messages."""
        # Two statements: each takes one step in the index, together they would scan the table.
        queries = (f"select {end}({column}) from messages" for end in ("min", "max"))  # noqa: S608 - our own
        first, last = (self._database.execute(query).fetchone()[0] for query in queries)
        return first, last

    def _channels(self, counts: Mapping[str, int] | None) -> list[Channel]:
        definitions = self._definitions()
        query = "select id, name, type, serialization_format from topics"
        rows = self._database.execute(query).fetchall()
        # A damaged page gives rows of other types.
        topics = [row for row in rows if [type(value) for value in row] == [int, str, str, str]]
        by_key = self._count(counts, topics)
        return [
            Channel(
                key=key,
                topic=name,
                type=kind,
                encoding=encoding,
                definition=definitions.get(kind, ("", ""))[1],
                definition_kind=definitions.get(kind, ("", ""))[0],
                count=by_key.get(key) if by_key is not None else None,
                first_ns=self.start_ns,
                last_ns=self.end_ns,
            )
            for key, name, kind, encoding in topics
        ]

    def _count(self, counts: Mapping[str, int] | None, topics: list[Any]) -> dict[int, int] | None:
        """Return messages of each topic; None where only reading all would tell."""
        if self._cut:
            return None
        if counts is not None and all(name in counts for _, name, _, _ in topics):
            return {key: counts[name] for key, name, _, _ in topics}
        rows = self.last_id - self.first_id + 1
        if len(topics) == 1:
            return {topics[0][0]: max(rows, 0)}
        if rows > _COUNTED:
            return None
        found = dict(
            self._database.execute("select topic_id, count(*) from messages group by topic_id").fetchall()
        )
        return {key: found.get(key, 0) for key, _, _, _ in topics}

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Return type -> kind and text of its definition; bags older than ROS 2 Iron hold none."""
        query = "select topic_type, encoding, encoded_message_definition from message_definitions"
        try:
            rows = self._database.execute(query).fetchall()
            return {row[0]: row[1:] for row in rows if all(isinstance(value, str) for value in row)}
        except sqlite3.OperationalError:
            return {}


class SqliteTask:
    """A range of rows to load."""

    def __init__(self, base: sqlite3.Connection, keys: list[int], rows: tuple[int, int], size: int) -> None:
        self._base = base
        self._rows = rows
        self.size = size
        self.counts = dict.fromkeys(keys, rows[1] - rows[0] + 1)

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted topic; see `Task`."""
        del scratch
        for key in self.counts:
            try:
                yield key, self._fetch(key)
            except (sqlite3.Error, TypeError, ValueError, OverflowError) as error:
                msg = f"the SQLite database is damaged: {error}"
                raise DamagedError(msg) from error

    def _fetch(self, key: int) -> Batch:
        # No `order by`: it would go through the index of times instead of the table.
        query = "select timestamp, data from messages where id between ? and ? and topic_id = ?"
        cursor = self._base.execute(query, (*self._rows, key))
        times: list[int] = []
        blobs: list[bytes] = []
        while rows := cursor.fetchmany(_FETCH):
            flat = list(chain.from_iterable(rows))
            times += flat[0::2]
            blobs += flat[1::2]
        return batch_of_blobs(blobs, times)


def batch_of_blobs(blobs: list[bytes], times: list[int]) -> Batch:
    """Return messages that lie apart as one batch."""
    sizes = np.fromiter(map(len, blobs), dtype=np.int64, count=len(blobs))
    starts = np.cumsum(sizes)
    starts -= sizes
    return Batch.of(b"".join(blobs), starts, sizes, np.array(times, dtype=np.int64))
