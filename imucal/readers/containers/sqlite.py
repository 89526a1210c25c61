"""A ROS 2 bag's SQLite file: its topics by SQLite, its messages from the pages of the file.

Reading the pages takes half the time of SQLite's own rows, runs in several threads, and reads what is left
of a cut file. What does not fit (overflow pages, a write-ahead log) is left to SQLite.
Source: https://www.sqlite.org/fileformat2.html, sections 1.6 (b-tree pages) and 2.1 (records).
"""

import os
import sqlite3
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import accumulate, chain, pairwise
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.frozen import frozen_alone
from imucal.readers.containers.container import Batch, Bytes, Channel, Loss, MessageFile, Task, gather
from imucal.readers.files import DamagedError, LogFile, Scratch, damaged_if

#: A bag's topics and definitions are written first: they lie in the first pages, in bytes.
_START = 1 << 22
#: Types of the pages that hold rows of a table, and the tree above them.
LEAF, _INTERIOR = 0x0D, 0x05
#: Bytes of a column by its serial type, up to 9; blobs and texts have 12 and more.
_SIZES = np.array([0, 1, 2, 3, 4, 6, 8, 8, 0, 0, 0, 0], np.int64)
#: Serial type -> bits of eight bytes that its integer leaves.
_SPARE = np.array([64, 56, 48, 40, 32, 16, 0, 64], np.int64)
#: Leaf pages of one task: about 2 MB of the usual 4 kB pages.
_GROUP = 512
#: A b-tree deeper than this is damage.
_DEEP = 20
#: Smallest message with its head: what one page can hold is bounded by it, in bytes.
_SMALLEST = 16
#: Rows of one task that SQLite reads.
_RANGE = 1 << 14
#: Columns of `messages`, in the order that the pages are read in.
_COLUMNS = ["id", "topic_id", "timestamp", "data"]
#: Rows fetched at once; more is slower.
_FETCH = 1024
#: Rows up to which messages are counted one by one when the bag doesn't say how many there are.
_COUNTED = 2_000_000
#: Errors of a database whose pages hold what they should not.
_ERRORS = (sqlite3.Error, TypeError, ValueError, OverflowError)


def connect(path: Path, findings: list[Finding]) -> sqlite3.Connection:
    """Open a database for reading, with its write-ahead log unless no file may be made beside it."""
    try:
        return _open(path, "mode=ro")
    except sqlite3.OperationalError:
        return connect_alone(path, findings)


def connect_alone(path: Path, findings: list[Finding]) -> sqlite3.Connection:
    """Open a database without its write-ahead log; a finding says so where there is one."""
    base = _open(path, "mode=ro&immutable=1")
    wal = _write_ahead_log(path)
    if wal is not None:
        text = f"{wal.name} can't be read; messages that are only in it are missing."
        advice = "Copy the bag to a folder with write permission."
        findings.append(Finding("warning", "wal-ignored", text, advice))
    return base


def _open(path: Path, options: str) -> sqlite3.Connection:
    """Open a database and look whether it can be read."""
    uri = "file:" + quote(os.fsencode(path.absolute())) + "?" + options
    base = sqlite3.connect(uri, uri=True, check_same_thread=False)
    try:
        base.execute("select count(*) from sqlite_master").fetchone()
    except sqlite3.Error:
        base.close()
        raise
    return base


def _write_ahead_log(path: Path) -> Path | None:
    """Return the write-ahead log of a database; None where there is none, or nothing in it."""
    wal = path.with_name(path.name + "-wal")
    return wal if wal.exists() and wal.stat().st_size else None


def connect_to_start(file: LogFile) -> sqlite3.Connection:
    """Return the database that the first pages of a cut file are: its topics and definitions.

    SQLite refuses a file that is shorter than its first page says. So the start is taken into memory, what
    is missing of it as empty pages, and its first page says how many there are.
    """
    head = file.read(0, min(_START, file.size))
    head += bytes(_START - len(head))
    # Versions 2 would ask for a write-ahead log.
    head[18:20] = b"\1\1"
    head[28:32] = (len(head) // max(_page_bytes(head), 512)).to_bytes(4, "big")
    base = sqlite3.connect(":memory:", check_same_thread=False)
    try:
        base.deserialize(bytes(head))
        base.execute("select count(*) from topics").fetchone()
    except BaseException:
        base.close()
        raise
    return base


def _page_bytes(head: Bytes) -> int:
    """Return the size of a page; 65536 does not fit in two bytes and stands as 1."""
    size = int.from_bytes(head[16:18], "big")
    return 65536 if size == 1 else size


@frozen_alone
class Rows:
    """Rows of `messages`."""

    #: Topic, time in ns, and where the data lie, of each row that a page holds whole, shape (n,).
    topics: IntArray
    times: IntArray
    starts: IntArray
    sizes: IntArray
    #: Row and topic of those that reach over several pages.
    long_ids: IntArray
    long_topics: IntArray
    #: Number of rows that can't be parsed.
    damaged: int


def parse_rows(buffer: memoryview, page: int, usable: int) -> Rows:
    """Parse the cells of leaf pages: payload size, row, then a record of id, topic, time and data."""
    data = np.frombuffer(buffer, np.uint8)
    cells, ends, wrong = _cells(data, page)
    size, at = varint(data, cells)
    ids, record = varint(data, at)
    head, at = varint(data, record)
    kinds = []
    for _ in range(4):
        kind, at = varint(data, at)
        kinds.append(kind)
    identity, topic, time, blob = kinds
    known = (at == record + head) & (identity <= 6) & (topic <= 9) & (time <= 9) & (blob >= 12)
    known &= (blob & 1 == 0) & (blob >> 1 <= size + 6) & (size >= head) & (cells < ends - 8)
    columns = [record + head]
    for kind in (identity, topic, time):
        columns.append(columns[-1] + _SIZES.take(kind, mode="clip"))
    sizes = (blob - 12) >> 1
    known &= columns[3] + sizes == record + size
    long = known & (size > usable - 35)
    whole = np.flatnonzero(known & ~long & (record + size <= ends))
    apart = np.flatnonzero(long & (columns[2] <= ends))
    return Rows(
        topics=_integers(data, columns[1][whole], topic[whole]),
        times=_integers(data, columns[2][whole], time[whole]),
        starts=columns[3][whole],
        sizes=sizes[whole],
        long_ids=ids[apart],
        long_topics=_integers(data, columns[1][apart], topic[apart]),
        damaged=cells.size - whole.size - apart.size + wrong,
    )


def _cells(data: NDArray[np.uint8], page: int) -> tuple[IntArray, IntArray, int]:
    """Return where the cells of leaf pages start, where the page of each ends, and pages that are none."""
    pages = data.reshape(-1, page)
    counts = _pair(pages[:, 3], pages[:, 4])
    wrong = (pages[:, 0] != LEAF) | (counts > (page - 8) // 2)
    counts[wrong] = 0
    firsts = np.arange(counts.size, dtype=np.int64) * page
    total = int(counts.sum())
    within = np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
    base = np.repeat(firsts, counts)
    words = base + 8 + 2 * within
    return base + _pair(data[words], data[words + 1]), base + page, int(np.count_nonzero(wrong))


def _pair(high: NDArray[np.uint8], low: NDArray[np.uint8]) -> IntArray:
    """Return the big-endian numbers of two bytes."""
    return (high.astype(np.int64) << 8) | low


def varint(data: NDArray[np.uint8], at: IntArray) -> tuple[IntArray, IntArray]:
    """Return the big-endian variable-length integers at `at`, and where each ends."""
    byte = data.take(at, mode="clip")
    value = (byte & 0x7F).astype(np.int64)
    end = at + 1
    more = np.flatnonzero(byte > 0x7F)
    for step in range(1, 9):
        if not more.size:
            break
        byte = data.take(at[more] + step, mode="clip")
        whole = step == 8
        value[more] = (value[more] << (8 if whole else 7)) | (byte if whole else byte & 0x7F)
        end[more] += 1
        if whole:
            break
        more = more[byte > 0x7F]
    return value, end


def _integers(data: NDArray[np.uint8], at: IntArray, kinds: IntArray) -> IntArray:
    """Return integer columns of the given serial types, shape (n,); 0 where a type is none."""
    spare = _SPARE.take(kinds, mode="clip")
    # Eight bytes that end with the number, which a page's head allows: what stands before it is shifted out.
    words = gather(data.data, at - (spare >> 3), 8).view(">i8").astype(np.int64)
    words <<= spare
    words >>= spare
    words[kinds == 9] = 1
    return words


@frozen_alone
class Leaves:
    """Leaf pages of a table, in the order of its rows."""

    #: Their numbers, from 1, shape (p,).
    pages: IntArray
    #: The largest row that each may hold, shape (p,).
    last_ids: IntArray
    #: The smallest row of the first.
    first_id: int

    def groups(self) -> Iterator[tuple[IntArray, int]]:
        """Yield pages that one task reads, and the rows they hold at most."""
        before = self.first_id - 1
        for start in range(0, self.pages.size, _GROUP):
            part = self.pages[start : start + _GROUP]
            last = int(self.last_ids[min(start + _GROUP, self.pages.size) - 1])
            yield part, max(last - before, 0)
            before = last


def page_size(file: LogFile) -> tuple[int, int]:
    """Return the size of a page, and how much of it holds data, in bytes."""
    head = file.read(0, 100)
    size = _page_bytes(head)
    damaged_if(size < 512 or size & (size - 1), "the page size is damaged")
    return size, size - head[20]


def find_leaves(file: LogFile, root: int, first_id: int, last_id: int) -> Leaves:
    """Return the leaf pages below the page `root`; raises DamagedError if a page is damaged or missing."""
    size, _ = page_size(file)
    pages, ids = [np.array([root], np.int64)], [np.array([last_id], np.int64)]
    for _ in range(_DEEP):
        level, bounds = pages[-1], ids[-1]
        first = int(level[0])
        damaged_if(first < 1, "a page number is damaged")
        if file.read((first - 1) * size + (100 if first == 1 else 0), 1)[0] == LEAF:
            return Leaves(pages=level, last_ids=bounds, first_id=first_id)
        children = [_children(file, page, size, bound) for page, bound in zip(level, bounds, strict=True)]
        pages.append(np.concatenate([child for child, _ in children]))
        ids.append(np.concatenate([bound for _, bound in children]))
        if pages[-1].size * size > file.size:
            break
    raise DamagedError("the tree of pages is damaged")


def scan_leaves(file: LogFile) -> list[tuple[IntArray, int]]:
    """Return groups of all whole leaf pages of a file, and the cells they hold at most.

    Pages of other tables are among them: their rows do not look like messages.
    """
    size, _ = page_size(file)
    groups = []
    count = file.size // size
    for first in range(0, count, _GROUP):
        part = min(_GROUP, count - first)
        data = np.frombuffer(file.read(first * size, part * size), np.uint8).reshape(part, size)
        chosen = np.flatnonzero(data[:, 0] == LEAF)
        if chosen.size:
            cells = _pair(data[chosen, 3], data[chosen, 4])
            most = int(np.minimum(cells, size // _SMALLEST).sum())
            groups.append((chosen + first + 1, most))
    return groups


#: Asks SQLite for the messages of a topic in a range of rows: (topic, first, last).
Fetch: TypeAlias = Callable[[int, int, int], Batch]


class PageTask:
    """A group of leaf pages to load, which hold `most` rows at most.

    `fetch` asks SQLite for rows that reach over several pages; it is None where the file is cut, and rows
    that can't be parsed belong to other tables.
    """

    def __init__(
        self, file: LogFile, pages: IntArray, keys: Sequence[int], most: int, fetch: Fetch | None
    ) -> None:
        self._file = file
        self._pages = pages
        self._fetch = fetch
        self._page, self._usable = page_size(file)
        self.size = pages.size * self._page
        self.counts = dict.fromkeys(keys, min(most, self.size // _SMALLEST))

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted topic; see `Task`."""
        buffer = self._read(scratch)
        rows = parse_rows(buffer, self._page, self._usable)
        loss = None
        if rows.damaged and self._fetch is not None:
            loss = Loss("damaged", "rows of the database are damaged", rows.damaged)
        for key in self.counts:
            chosen = np.flatnonzero(rows.topics == key)
            batch = Batch.of(buffer, rows.starts[chosen], rows.sizes[chosen], rows.times[chosen])
            long = rows.long_ids[rows.long_topics == key].tolist()
            more = [self._fetch(key, row, row) for row in long] if self._fetch is not None else []
            yield key, replace(_joined([batch, *more]) if more else batch, loss=loss)
            loss = None

    def _read(self, scratch: Scratch) -> memoryview:
        """Read the pages side by side into a buffer: in one go where they are neighbours."""
        buffer = scratch.buffer(self.size)
        steps = np.flatnonzero(np.diff(self._pages) != 1) + 1
        edges = [0, *steps.tolist(), self._pages.size]
        for first, last in pairwise(edges):
            position = (int(self._pages[first]) - 1) * self._page
            self._file.into(position, buffer[first * self._page : last * self._page])
        return buffer


def _joined(parts: Sequence[Batch]) -> Batch:
    """Return the messages of several batches, in order of time."""
    begun = accumulate((len(part.buffer) for part in parts), initial=0)
    starts = np.concatenate([at + part.starts for at, part in zip(begun, parts, strict=False)])
    sizes = np.concatenate([np.broadcast_to(part.sizes, part.n) for part in parts])
    buffer = b"".join(part.buffer for part in parts)
    times = np.concatenate([part.log_ns for part in parts])
    return Batch.of(buffer, starts, sizes, times).part(np.argsort(times, kind="stable"))


def _children(file: LogFile, page: int, size: int, bound: int) -> tuple[IntArray, IntArray]:
    """Return the children of an interior page, and the largest row of each."""
    damaged_if(page <= 1, "a page number is damaged")
    data = np.frombuffer(file.read((page - 1) * size, size), dtype=np.uint8)
    count = int(data[3]) << 8 | int(data[4])
    damaged_if(data[0] != _INTERIOR or 12 + 2 * count > size, "an interior page is damaged")
    cells = _pair(data[12 : 12 + 2 * count : 2], data[13 : 13 + 2 * count : 2])
    damaged_if(count and int(cells.max()) > size - 5, "an interior page is damaged")
    pages = gather(data.data, np.append(cells, 8), 4).view(">u4").astype(np.int64)
    keys, _ = varint(data, cells + 4)
    return pages, np.append(keys, bound)


class SqliteFile(MessageFile):
    """A container of the messages of a `.db3` file; `counts` of each topic where the bag's metadata tells."""

    format = "rosbag2-sqlite3"
    compression = "none"

    def __init__(self, path: Path, counts: Mapping[str, int] | None = None) -> None:
        self._counts = counts
        self._base: sqlite3.Connection | None = None
        self._lock = threading.Lock()
        self._cut = False
        self.first_id, self.last_id = 1, 0
        super().__init__(path)

    def _read_index(self) -> None:
        try:
            self._open()
        except (*_ERRORS, DamagedError) as error:
            msg = (
                f"{self.path}: the SQLite database can't be read: {error}; expected a ROS 2 bag, "
                "try to recover it with `sqlite3 FILE .recover`"
            )
            raise ReadError(msg) from error

    def _open(self) -> None:
        try:
            self._base = connect(self.path, self.findings)
            first, last = self._ends("id")
            if first is not None and last is not None:
                self.first_id, self.last_id = int(first), int(last)
            self.start_ns, self.end_ns = self._ends("timestamp")
            self.channels = self._channels(self._counts)
        except sqlite3.DatabaseError as error:
            if self._base is not None:
                self._base.close()
            self._cut = True
            self._base = connect_to_start(self._file)
            self.first_id, self.last_id = 1, 0
            self.start_ns = self.end_ns = None
            self.channels = self._channels({})
            text = f"SQLite can't read the database ({error}); its pages were scanned for whole messages."
            # The first page says how many pages there are.
            stated = int.from_bytes(self._file.read(28, 4), "big") * page_size(self._file)[0]
            code = "truncated" if stated > self.size else "damaged"
            self.findings.append(Finding("warning", code, text))

    def close(self) -> None:
        """Close the database."""
        super().close()
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
                yield SqliteTask(partial(fetched, self._database, self._lock), wanted, rows, size)
            return
        groups, fetch = self._pages()
        for pages, most in groups:
            yield PageTask(self._file, pages, wanted, most, fetch)

    @property
    def _database(self) -> sqlite3.Connection:
        if self._base is None:
            raise ValueError(f"{self.path}: the database is closed")
        return self._base

    def _needs_sqlite(self) -> bool:
        """Say whether the pages of the file alone don't hold the messages, or hold them in another order."""
        columns = [row[1] for row in self._database.execute("pragma table_info(messages)")]
        needs = _write_ahead_log(self.path) is not None or columns != _COLUMNS
        # SQLite takes a lock that several threads would wait for.
        self.parallel = not needs
        return needs

    def _pages(self) -> tuple[list[tuple[IntArray, int]], Fetch | None]:
        """Return the leaf pages of the messages, by their tree, or all there are where it is damaged."""
        try:
            if not self._cut:
                query = "select rootpage from sqlite_master where type = 'table' and name = 'messages'"
                root = int(self._database.execute(query).fetchone()[0])
                leaves = find_leaves(self._file, root, self.first_id, self.last_id)
                beyond = int(leaves.pages.max()) * page_size(self._file)[0] > self.size
                damaged_if(beyond, "pages beyond the end of the file are missing", "truncated")
                return list(leaves.groups()), partial(fetched, self._database, self._lock)
        except DamagedError as error:
            text = f"The database is damaged: {error}; its pages were scanned for whole messages."
            self.findings.append(Finding("warning", error.code, text))
        return scan_leaves(self._file), None

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

    def _ends(self, column: str) -> tuple[int | None, int | None]:
        """Return the smallest and the largest value of an indexed column of the messages."""
        # Two statements: each takes one step in the index, together they would scan the table.
        queries = (f"select {end}({column}) from messages" for end in ("min", "max"))  # noqa: S608 - our own
        first, last = (self._database.execute(query).fetchone()[0] for query in queries)
        return first, last

    def _channels(self, counts: Mapping[str, int] | None) -> list[Channel]:
        # Type -> kind and text of its definition; bags older than ROS 2 Iron hold none.
        definitions: dict[str, tuple[str, str]] = {}
        query = "select topic_type, encoding, encoded_message_definition from message_definitions"
        with suppress(sqlite3.OperationalError):
            found = self._database.execute(query).fetchall()
            definitions = {row[0]: row[1:] for row in found if all(isinstance(value, str) for value in row)}
        query = "select id, name, type, serialization_format from topics"
        rows = self._database.execute(query).fetchall()
        # A damaged page gives rows of other types.
        topics = [row for row in rows if [type(value) for value in row] == [int, str, str, str]]
        by_key = self._count(counts, topics)
        channels = []
        for key, name, kind, encoding in topics:
            definition_kind, definition = definitions.get(kind, ("", ""))
            channels.append(
                Channel(
                    key=key,
                    topic=name,
                    type=kind,
                    encoding=encoding,
                    definition=definition,
                    definition_kind=definition_kind,
                    count=by_key.get(key, 0) if by_key is not None else None,
                    first_ns=self.start_ns,
                    last_ns=self.end_ns,
                )
            )
        return channels

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
        query = "select topic_id, count(*) from messages group by topic_id"
        return dict(self._database.execute(query).fetchall())


class SqliteTask:
    """A range of rows to load."""

    def __init__(self, fetch: Fetch, keys: list[int], rows: tuple[int, int], size: int) -> None:
        self._fetch = fetch
        self._rows = rows
        self.size = size
        self.counts = dict.fromkeys(keys, rows[1] - rows[0] + 1)

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted topic; see `Task`."""
        del scratch
        for key in self.counts:
            yield key, self._fetch(key, *self._rows)


def fetched(base: sqlite3.Connection, lock: threading.Lock, key: int, first: int, last: int) -> Batch:
    """Return the messages of a topic in the rows `first` to `last`, by SQLite; raises DamagedError."""
    # No `order by`: it would go through the index of times instead of the table.
    query = "select timestamp, data from messages where id between ? and ? and topic_id = ?"
    times: list[int] = []
    blobs: list[bytes] = []
    try:
        with lock:
            cursor = base.execute(query, (first, last, key))
            while rows := cursor.fetchmany(_FETCH):
                flat = list(chain.from_iterable(rows))
                times += flat[0::2]
                blobs += flat[1::2]
        return batch_of_blobs(blobs, times)
    except _ERRORS as error:
        raise DamagedError(f"the SQLite database is damaged: {error}") from error


def batch_of_blobs(blobs: list[bytes], times: list[int]) -> Batch:
    """Return messages that lie apart as one batch."""
    sizes = np.fromiter(map(len, blobs), dtype=np.int64, count=len(blobs))
    starts = np.cumsum(sizes)
    starts -= sizes
    return Batch.of(b"".join(blobs), starts, sizes, np.array(times, np.int64))
