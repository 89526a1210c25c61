"""A ROS 2 bag's SQLite file opened: its topics, and its messages in ranges of rows."""

import sqlite3
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, cast
from urllib.parse import quote

import numpy as np

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.batch import Batch
from imucal.readers.container import Channel, Task
from imucal.readers.files import DamagedError, Scratch

__all__ = ["SqliteFile", "SqliteTask", "batch_of_blobs"]

#: Rows of one task.
_RANGE = 1 << 14
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
    parallel = False
    compression = "none"

    def __init__(self, path: Path, counts: Mapping[str, int] | None = None) -> None:
        self.path = path
        self.size = path.stat().st_size
        self.findings: list[Finding] = []
        try:
            self._base = _connect(path, self.findings)
            self.first_id, self.last_id = self._ids()
            self.start_ns, self.end_ns = self._span()
            self.channels = self._channels(counts)
        except (sqlite3.Error, OverflowError) as error:
            msg = (
                f"{path}: the SQLite database can't be read: {error}; expected a ROS 2 bag, "
                "try to recover it with `sqlite3 FILE .recover`"
            )
            raise ReadError(msg) from error

    def close(self) -> None:
        """Close the database."""
        self._base.close()

    def tasks(self, keys: frozenset[int]) -> list[Task]:
        """Return ranges of rows."""
        known = {channel.key for channel in self.channels if channel.count != 0}
        wanted = sorted(keys & known)
        rows = self.last_id - self.first_id + 1
        if not wanted or rows <= 0:
            return []
        # Rows are at least a few bytes: a range of ids beyond that is damage or sparse.
        step = (
            max(_RANGE, rows // max(self.size // (32 * _RANGE), 1) + 1) if rows > self.size // 32 else _RANGE
        )
        size = max(self.size // max(rows // step, 1), 1)
        return [
            cast("Task", SqliteTask(self._base, wanted, (first, min(first + step - 1, self.last_id)), size))
            for first in range(self.first_id, self.last_id + 1, step)
        ]

    def sample(self) -> bytes:
        """Return the start of the first message's payload, which tells whether it is compressed."""
        try:
            row = self._base.execute("select substr(data, 1, 4) from messages limit 1").fetchone()
        except sqlite3.Error:
            return b""
        return bytes(row[0]) if row and isinstance(row[0], bytes) else b""

    def _ids(self) -> tuple[int, int]:
        row = self._base.execute("select min(id), max(id) from messages").fetchone()
        return (int(row[0]), int(row[1])) if row and row[0] is not None else (1, 0)

    def _span(self) -> tuple[int | None, int | None]:
        # Two statements: each takes one step in the index of times, together they would scan the table.
        first = self._base.execute("select min(timestamp) from messages").fetchone()[0]
        last = self._base.execute("select max(timestamp) from messages").fetchone()[0]
        return first, last

    def _channels(self, counts: Mapping[str, int] | None) -> list[Channel]:
        definitions = self._definitions()
        topics = self._base.execute("select id, name, type, serialization_format from topics").fetchall()
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
        if counts is not None and all(name in counts for _, name, _, _ in topics):
            return {key: counts[name] for key, name, _, _ in topics}
        rows = self.last_id - self.first_id + 1
        if len(topics) == 1:
            return {topics[0][0]: max(rows, 0)}
        if rows > _COUNTED:
            return None
        found = dict(
            self._base.execute("select topic_id, count(*) from messages group by topic_id").fetchall()
        )
        return {key: found.get(key, 0) for key, _, _, _ in topics}

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Return type -> kind and text of its definition; bags older than ROS 2 Iron hold none."""
        query = "select topic_type, encoding, encoded_message_definition from message_definitions"
        try:
            return {kind: (encoding, text) for kind, encoding, text in self._base.execute(query)}
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
                raise DamagedError("damaged", msg) from error

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
    same = bool(sizes.size) and bool((sizes == sizes[0]).all())
    return Batch(
        buffer=b"".join(blobs),
        starts=starts,
        header=0,
        sizes=int(sizes[0]) if same else sizes,
        log_ns=np.array(times, dtype=np.int64),
    )


def _connect(path: Path, findings: list[Finding]) -> sqlite3.Connection:
    """Open a database for reading; its write-ahead log is read too where it lies beside it."""
    uri = "file:" + quote(str(path.absolute()))
    base = sqlite3.connect(uri + "?mode=ro", uri=True, check_same_thread=False)
    try:
        base.execute("select count(*) from sqlite_master").fetchone()
    except sqlite3.OperationalError:
        base.close()
        base = sqlite3.connect(uri + "?mode=ro&immutable=1", uri=True, check_same_thread=False)
        base.execute("select count(*) from sqlite_master").fetchone()
        wal = path.with_name(path.name + "-wal")
        if wal.exists() and wal.stat().st_size:
            text = f"{wal.name} can't be read here, so messages that are only in it are left out."
            advice = "Copy the bag to a folder that can be written to."
            findings.append(Finding(level="warning", code="wal-ignored", text=text, advice=advice))
    return base
